//! Real measurements of a UR5 and a Barrett WAM, where they are at hand (`CALIBRIG_DATA`).

use std::path::{Path, PathBuf};
use std::process::Command;

use calibrig::report::{JsonReport, JsonSplitRow};
use serde_json::Value;

const UR5: [&str; 2] =
    ["UR5/3D_UR5_uncalibrated_grid_cleaned.csv", "UR5/3D_UR5_uncalibrated_random_cleaned.csv"];
const WAM: [&str; 2] =
    ["WAM/3D_WAM_uncalibrated_grid_cleaned.csv", "WAM/3D_WAM_uncalibrated_random_cleaned.csv"];

fn data(files: [&str; 2]) -> Option<[PathBuf; 2]> {
    let Some(folder) = std::env::var_os("CALIBRIG_DATA") else {
        eprintln!("SKIPPED: CALIBRIG_DATA is not set, the real measurements are not at hand");
        return None;
    };
    let paths = files.map(|file| PathBuf::from(&folder).join("ur5_wam").join(file));
    for path in &paths {
        assert!(path.is_file(), "{} is not there", path.display());
    }
    Some(paths)
}

/// In the modes of the default, with random splits. A drive that shows no compliance is told, and no reason to doubt the rest.
fn identify(model: &str, [fit, verify]: [PathBuf; 2], fitted: &str) -> JsonReport {
    let output = Command::new(env!("CARGO_BIN_EXE_calibrig"))
        .args(["identify", "--json", "--model", model, "--splits", "20", "--fit", fitted, "--measurements"])
        .arg(fit)
        .arg("--verify")
        .arg(verify)
        .output()
        .expect("the binary runs");
    let said = String::from_utf8_lossy(&output.stderr);
    // Of some small parts of the WAM's data a stated compliance is doubted; of all of them none is.
    let doubts: Vec<_> = said.lines().filter(|line| line.starts_with("doubtful")).collect();
    let expected: &[&str] = if model.contains("wam") {
        &["doubtful: geometry and stiffness: 3 of 20 splits (contradicted: 3)"]
    } else {
        &[]
    };
    assert_eq!(doubts, expected, "{said}");
    assert_eq!(output.status.code(), Some(if expected.is_empty() { 0 } else { 3 }), "{said}");
    let report: JsonReport = serde_json::from_slice(&output.stdout).expect("a calibrig.report/1 document");
    let warnings = &report.estimates["elasto_geometric"].warnings;
    assert!(
        warnings.iter().any(|warning| warning.contains("no compliance is visible there")),
        "{warnings:?}"
    );
    // The readings of real robots have tails, and no gross errors.
    let mut judged = report.estimates.values();
    assert!(judged.all(|estimate| estimate.outliers.is_empty() && estimate.reasons.is_empty()));
    report
}

/// RMS of the 3-D error of the verification set, mm.
fn rms(report: &JsonReport, mode: &str) -> f64 {
    report.sets["verification"].rows[mode].rms_3d_m.expect("a number") * 1e3
}

/// Row of a mode on the random splits, its mean RMS in mm, and its gain with the interval, mm.
fn split<'a>(report: &'a JsonReport, mode: &str) -> (&'a JsonSplitRow, f64, [f64; 3]) {
    let rows = &report.splits.as_ref().expect("as asked for").rows;
    let row = rows.iter().find(|row| row.mode == mode).expect("the mode");
    let gain = row.gain_m.expect("an interval");
    let mm = |metres: Option<f64>| metres.expect("a number") * 1e3;
    (row, mm(row.mean_rms_3d_m), [gain.value, gain.low, gain.high].map(mm))
}

/// (name, relative deviation from the assumed value, its standard deviation) of every identified compliance.
fn compliances(report: &JsonReport) -> Vec<(&str, f64, Option<f64>)> {
    let identified =
        report.parameters.iter().filter(|p| p.mode == "elasto_geometric" && p.name.starts_with("compliance"));
    identified.map(|p| (p.name.as_str(), p.estimate.expect("a number"), p.sigma)).collect()
}

/// None is negative; what is zero is held there and has no spread.
fn assert_not_negative(compliances: &[(&str, f64, Option<f64>)]) {
    for (name, deviation, sigma) in compliances {
        assert!(*deviation >= -1.0, "{name}: {deviation}");
        assert_eq!(sigma.is_none(), *deviation == -1.0, "{name}: {deviation}, {sigma:?}");
    }
}

#[test]
fn ur5_from_1000_poses_to_20_and_from_200_to_800() {
    let Some(files) = data(UR5) else { return };
    let report = identify("models/ur5/robot.toml", files, "200");
    let estimate = &report.estimates["only_calibration"];
    let [nominal, geometric, elastic] =
        ["without_calibration", "only_calibration", "elasto_geometric"].map(|mode| rms(&report, mode));
    println!(
        "UR5, 20 poses: nominal {nominal:.4} mm, geometric {geometric:.4} mm, rank {}, with stiffness {elastic:.4} mm",
        estimate.rank
    );
    assert!(geometric <= 0.106 && elastic <= 0.106);
    assert_eq!((estimate.rank, estimate.parameter_count), (27, 27));
    let weak = estimate.warnings.iter().filter(|w| w.contains("weak")).count();
    assert_eq!(weak, 2, "{:?}", estimate.warnings);

    let compliances = compliances(&report);
    println!("UR5: {compliances:?}");
    assert_not_negative(&compliances);
    // An independent fit has 2.9e-5 rad/(N m) at the shoulder; gravity cannot load the base, whose axis it is along.
    let shoulder = compliances.iter().find(|(name, ..)| *name == "compliance_drive2").expect("loaded");
    let compliance = (1.0 + shoulder.1) / 5e4;
    assert!((2.4e-5..3.7e-5).contains(&compliance), "{compliance}");
    assert!(compliances.iter().all(|(name, ..)| *name != "compliance_drive1"));

    let (_, before, _) = split(&report, "only_calibration");
    let (row, after, [gain, low, high]) = split(&report, "elasto_geometric");
    println!(
        "UR5, 20 splits 200/800: geometric {before:.4} mm, with stiffness {after:.4} mm, {gain:.4} mm [{low:.4}, {high:.4}] less"
    );
    assert_eq!(row.rms_3d_m.len(), 20);
    assert!(after <= 0.110 && (before - 0.116).abs() < 0.003);
    assert!((before - after - gain).abs() < 1e-9 && low > 0.0 && high > gain);
}

#[test]
fn wam_from_216_poses_to_20_and_from_150_to_66() {
    let Some(files) = data(WAM) else { return };
    let report = identify("models/wam/robot.toml", files, "150");
    let [nominal, geometric, elastic] =
        ["without_calibration", "only_calibration", "elasto_geometric"].map(|mode| rms(&report, mode));
    println!(
        "WAM, 20 poses: nominal {nominal:.3} mm, geometric {geometric:.3} mm, with stiffness {elastic:.3} mm"
    );
    assert!((3.26..3.3).contains(&geometric) && elastic < geometric);
    assert_eq!(report.estimates["only_calibration"].rank, 31);
    let compliances = compliances(&report);
    println!("WAM: {compliances:?}");
    assert_not_negative(&compliances);
    let (_, before, _) = split(&report, "only_calibration");
    let (_, after, [gain, low, high]) = split(&report, "elasto_geometric");
    println!(
        "WAM, 20 splits 150/66: geometric {before:.3} mm, with stiffness {after:.3} mm, {gain:.3} mm [{low:.3}, {high:.3}] less"
    );
    assert!(gain > 0.0 && low < gain && gain < high);
}

/// Models of a robot compared on poses that were held out in five parts, on the command line.
fn choose(model: &str, grid: &Path, more: &[&str]) -> (Value, String) {
    let run = |json: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_calibrig"))
            .args(["choose", "--folds", "5", "--model", model, "--measurements"])
            .arg(grid)
            .args(more)
            .args(json)
            .output()
            .expect("the binary runs");
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8_lossy(&output.stdout).into_owned()
    };
    (serde_json::from_str(&run(&["--json"])).expect("a calibrig.choice/1 document"), run(&[]))
}

/// Held-out RMS of a model and of the one that it is compared with, and its gain with the paired interval, all in mm; its verdict.
fn worth<'a>(choice: &'a Value, key: &str) -> ([f64; 2], [f64; 3], &'a str) {
    let models = choice["models"].as_array().expect("a list");
    let row = models.iter().find(|row| row["key"] == key).expect("the model");
    let other = models.iter().find(|other| other["name"] == row["against"]).expect("the model before it");
    let mm = |value: &Value| 1e3 * value.as_f64().expect("a number");
    let interval = &row["gain_interval_m"];
    let rms = [other, row].map(|row| mm(&row["held_out_rms_m"]));
    let gain = [&row["gain_m"], &interval[0], &interval[1]].map(mm);
    println!(
        "{}, {key}: {:.4} mm -> {:.4} mm on held-out poses, {:.4} mm [{:.4}, {:.4}] less",
        choice["name"], rms[0], rms[1], gain[0], gain[1], gain[2]
    );
    assert!((rms[0] - rms[1] - gain[0]).abs() < 1e-9);
    (rms, gain, row["verdict"].as_str().expect("a word"))
}

/// A quarter of what geometry and stiffness leave of a UR5 is smooth in its commands: 0.106 mm became 0.078 mm when it was first fitted.
#[test]
fn splines_pay_on_the_ur5() {
    let Some([grid, _]) = data(UR5) else { return };
    let (choice, text) = choose("models/ur5/robot.toml", &grid, &[]);
    assert_eq!((choice["poses"].as_u64(), choice["folds"].as_u64()), (Some(1000), Some(5)));
    let ([before, after], [_, low, high], verdict) = worth(&choice, "spline");
    assert_eq!(verdict, "pays");
    assert!(low > 0.0 && low < 0.028 && 0.028 < high, "{low} {high}");
    // With the spread of the gain about each.
    let half = 0.5 * (high - low);
    assert!((before - 0.106).abs() < half && (after - 0.078).abs() < half, "{before} {after}");
    // What was not measured is not compared, nor advised; how it can be is said.
    for words in [
        "+ spline: pays (predicts held-out poses better, by 0.028 mm RMS; against + stiffness)",
        "+ hysteresis: not compared: nothing that was measured depends on it: no signs of approach are stated \
         (--approach-from-order",
        "Worth fitting: --mode extended --terms ratio,spline: 0.07",
    ] {
        assert!(text.contains(words), "{text}");
    }
}

/// Cables hold what they were wound up to: the side from which each axis of a WAM came, by the order of its rows, is worth a sixth of the error.
#[test]
fn signs_of_approach_pay_on_the_wam() {
    let Some([grid, _]) = data(WAM) else { return };
    let (choice, text) = choose("models/wam/robot.toml", &grid, &["--approach-from-order"]);
    let ([before, after], [_, low, high], verdict) = worth(&choice, "hysteresis");
    assert_eq!(verdict, "pays");
    assert!(low > 0.0 && low < 0.40 && 0.40 < high, "{low} {high}");
    let half = 0.5 * (high - low);
    assert!((before - 2.28).abs() < half && (after - 1.88).abs() < half, "{before} {after}");
    assert!(text.contains("Worth fitting: --mode extended --terms hysteresis"), "{text}");
    // Of 216 poses the smooth error of each axis cannot be told yet.
    assert_ne!(worth(&choice, "spline").2, "hurts");
}

/// From a URDF in a vendor's manner alone, without a robot file: the drives' stiffnesses are guesses that it makes.
fn identify_urdf(robot: &str, [fit, verify]: [PathBuf; 2], fitted: &str) -> JsonReport {
    let output = Command::new(env!("CARGO_BIN_EXE_calibrig"))
        .args(["identify", "--json", "--splits", "20", "--fit", fitted])
        .args(["--urdf", &format!("tests/fixtures/urdf/real/{robot}.urdf")])
        .args(["--columns", &format!("models/{robot}/columns.toml"), "--measurements"])
        .arg(fit)
        .arg("--verify")
        .arg(verify)
        .output()
        .expect("the binary runs");
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{said}");
    assert!(said.contains("ignored: ") && said.contains("assumed: gravity along -z"), "{said}");
    serde_json::from_slice(&output.stdout).expect("a calibrig.report/1 document")
}

#[test]
fn ur5_from_its_urdf_alone() {
    let Some(files) = data(UR5) else { return };
    let report = identify_urdf("ur5", files, "200");
    assert_eq!(report.estimates["only_calibration"].rank, 27);
    let (_, before, _) = split(&report, "only_calibration");
    let (_, after, [gain, low, _]) = split(&report, "elasto_geometric");
    println!("UR5 from its URDF, 20 splits 200/800: geometric {before:.4} mm, with stiffness {after:.4} mm");
    assert!((before - 0.1149).abs() < 0.0005 && (after - 0.108).abs() < 0.001 && low > 0.0 && gain > low);
}

#[test]
fn wam_from_its_urdf_alone() {
    let Some(files) = data(WAM) else { return };
    let report = identify_urdf("wam", files, "150");
    assert_eq!(report.estimates["only_calibration"].rank, 31);
    let (_, before, _) = split(&report, "only_calibration");
    let (_, after, [gain, low, _]) = split(&report, "elasto_geometric");
    println!("WAM from its URDF, 20 splits 150/66: geometric {before:.3} mm, with stiffness {after:.3} mm");
    assert!((before - 2.355).abs() < 0.005 && (after - 2.259).abs() < 0.02 && low > 0.0 && gain > low);
}
