//! Real measurements of a UR5, where they are at hand (`CALIBRIG_DATA`).

use std::path::PathBuf;
use std::process::Command;

use calibrig::report::JsonReport;

fn data(file: &str) -> Option<PathBuf> {
    let Some(folder) = std::env::var_os("CALIBRIG_DATA") else {
        eprintln!("SKIPPED: CALIBRIG_DATA is not set, the real measurements are not at hand");
        return None;
    };
    let path = PathBuf::from(folder).join("ur5_wam").join(file);
    assert!(path.is_file(), "{} is not there", path.display());
    Some(path)
}

fn identify(model: &str, fit: PathBuf, verify: PathBuf) -> JsonReport {
    let output = Command::new(env!("CARGO_BIN_EXE_calibrig"))
        .args(["identify", "--json", "--model", model, "--measurements"])
        .arg(fit)
        .arg("--verify")
        .arg(verify)
        .output()
        .expect("the binary runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("a calibrig.report/1 document")
}

#[test]
fn ur5_from_1000_poses_to_20() {
    let (Some(fit), Some(verify)) = (
        data("UR5/3D_UR5_uncalibrated_grid_cleaned.csv"),
        data("UR5/3D_UR5_uncalibrated_random_cleaned.csv"),
    ) else {
        return;
    };
    let report = identify("models/ur5/robot.toml", fit, verify);
    let rms = |mode: &str| report.sets["verification"].rows[mode].rms_3d_m.expect("a number");
    let estimate = &report.estimates["only_calibration"];
    println!(
        "UR5, 20 poses: nominal {:.4} mm, geometric {:.4} mm, rank {}",
        rms("without_calibration") * 1e3,
        rms("only_calibration") * 1e3,
        estimate.rank
    );
    assert!(rms("only_calibration") <= 0.106e-3);
    assert_eq!((estimate.rank, estimate.parameter_count), (27, 27));
    let weak = estimate.warnings.iter().filter(|w| w.contains("weak")).count();
    assert_eq!(weak, 2, "{:?}", estimate.warnings);
}

#[test]
fn wam_from_216_poses_to_20() {
    let (Some(fit), Some(verify)) = (
        data("WAM/3D_WAM_uncalibrated_grid_cleaned.csv"),
        data("WAM/3D_WAM_uncalibrated_random_cleaned.csv"),
    ) else {
        return;
    };
    let report = identify("models/wam/robot.toml", fit, verify);
    let rms = |mode: &str| report.sets["verification"].rows[mode].rms_3d_m.expect("a number");
    println!(
        "WAM, 20 poses: nominal {:.3} mm, geometric {:.3} mm",
        rms("without_calibration") * 1e3,
        rms("only_calibration") * 1e3
    );
    assert!(rms("only_calibration") <= 3.3e-3);
    assert_eq!(report.estimates["only_calibration"].rank, 31);
}
