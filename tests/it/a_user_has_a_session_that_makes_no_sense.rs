//! Files that cannot be of the robot, and readings that cannot be of the session: told before the fit or beside it, never "no pattern", and
//! the exit codes of ADR 0015.

use std::fmt::Write;

use calibrig::kinematics::target_in_base;
use calibrig::model::nalgebra::Vector3;
use calibrig::model::random::{StreamSource, stream};
use calibrig::model::{CraigLink, KinematicModel};
use rand_distr::{Distribution, StandardNormal};

use crate::sandbox::{Ended, SCENARIO, Sandbox};

const MAP: &str = r#"schema = "calibrig.columns/1"
[joints]
columns = ["J1", "J2", "J3"]
revolute_unit = "deg"
[position]
system = "cartesian"
unit = "mm"
x = ["X"]
y = ["Y"]
z = ["Z"]
"#;

const ROBOT: &str = r#"schema = "calibrig.robot/1"
name = "three axes"
convention = "craig"
columns = "map.toml"
[[joint]]
name = "J1"
type = "revolute"
a_mm = 0
alpha_deg = 0
d_mm = 500
theta_deg = 0
min_deg = -170
max_deg = 170
[[joint]]
name = "J2"
type = "revolute"
a_mm = 150
alpha_deg = -90
d_mm = 0
theta_deg = 0
min_deg = -170
max_deg = 170
[[joint]]
name = "J3"
type = "revolute"
a_mm = 600
alpha_deg = 0
d_mm = 0
theta_deg = 0
min_deg = -170
max_deg = 170
[actuators]
kind = "direct"
"#;

/// A line of a file: joints in deg, and the point in mm.
type Line = ([f64; 3], [f64; 3]);

/// What a machine that is a millimetre and a milliradian off gives, with noise of 20 um.
fn session(poses: usize) -> Vec<Line> {
    let row = |name: &str, a, alpha, d, theta| CraigLink::revolute(name).row(a, alpha, d, theta);
    let links = vec![
        row("J1", 0.0, 0.0, 0.5, 0.0),
        row("J2", 0.151, -std::f64::consts::FRAC_PI_2 + 1e-3, 0.0, 1e-3),
        row("J3", 0.599, -1e-3, 1e-3, -1e-3),
    ];
    let machine = KinematicModel::new(links).expect("a robot");
    let mut rng = stream(7, 0, StreamSource::IdentificationNoise);
    (0..poses)
        .map(|k| {
            let angle = |pace: f64, width: f64| (width * (pace * (k + 1) as f64).sin() * 10.0).round() / 10.0;
            let deg = [angle(0.73, 160.0), angle(1.57, 100.0), angle(2.39, 120.0)];
            let point = target_in_base(&machine, &deg.map(f64::to_radians), &Vector3::new(0.2, 0.1, -0.15));
            let point = point.expect("a pose");
            let mut noise = || -> f64 { StandardNormal.sample(&mut rng) };
            (deg, [0, 1, 2].map(|axis| 1e3 * point[axis] + 0.02 * noise()))
        })
        .collect()
}

fn sandbox(lines: &[Line]) -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.write("robot.toml", ROBOT);
    sandbox.write("map.toml", MAP);
    sandbox.write("m.csv", csv(lines));
    sandbox
}

fn csv(lines: &[Line]) -> String {
    lines.iter().fold("J1,J2,J3,X,Y,Z\n".to_owned(), |mut text, ([a, b, c], [x, y, z])| {
        writeln!(text, "{a},{b},{c},{x:.4},{y:.4},{z:.4}").expect("a string");
        text
    })
}

fn identify(sandbox: &Sandbox, more: &[&str]) -> Ended {
    let files = ["identify", "--model", "robot.toml", "--measurements", "m.csv"];
    sandbox.run(files.iter().chain(more))
}

/// [`told`], whatever the residual looks like.
#[track_caller]
fn told_any(ended: &Ended, code: i32, parts: &[&str]) {
    assert_eq!(ended.code, Some(code), "{ended:?}");
    assert!(parts.iter().all(|part| ended.stdout.contains(part)), "{ended:?}");
}

#[track_caller]
fn told(ended: &Ended, code: i32, parts: &[&str]) {
    assert_eq!(ended.code, Some(code), "{ended:?}");
    let text = format!("{}{}", ended.stdout, ended.stderr).split_whitespace().collect::<Vec<_>>().join(" ");
    for part in parts {
        assert!(text.contains(part), "{part:?} is not in {text}");
    }
    if code != 0 {
        assert!(!text.contains("no pattern"), "{text}");
    }
}

#[test]
fn a_sound_session_ends_with_0() {
    let ended = identify(&sandbox(&session(40)), &[]);
    told(&ended, 0, &["no pattern"]);
    assert!(!ended.stderr.contains("doubtful") && !ended.stderr.contains("limits"), "{ended:?}");
}

#[test]
fn exchanged_rows_are_refused_and_named() {
    let mut lines = session(40);
    (lines[4].1, lines[13].1) = (lines[13].1, lines[4].1);
    let sandbox = sandbox(&lines);
    let parts = ["rows 5 and 14 have each other's points", "does not fit the points", "--fit-anyway"];
    told(&identify(&sandbox, &[]), 1, &parts);
    assert_eq!(identify(&sandbox, &[]).stdout, "");
    told(&identify(&sandbox, &["--fit-anyway"]), 3, &["doubtful: the nominal robot does not fit the points"]);
    // A robust loss leaves them aside: a warning that names them.
    let parts = ["its point and that of pose 14 are exchanged", "its point and that of pose 5"];
    told(&identify(&sandbox, &["--loss", "tukey"]), 0, &parts);
    let choose = ["choose", "--model", "robot.toml", "--measurements", "m.csv"];
    told(&sandbox.run(choose), 1, &["rows 5 and 14"]);
    told(&sandbox.run(choose.iter().chain(&["--fit-anyway"])), 3, &["doubtful: the nominal robot"]);
    assert_eq!(sandbox.run(choose.iter().chain(&["--loss", "tukey"])).code, Some(0));
}

#[test]
fn a_wrong_unit_of_the_joints_is_told_with_their_spans() {
    let lines: Vec<_> = session(40).into_iter().map(|(deg, p)| (deg.map(f64::to_radians), p)).collect();
    told(
        &identify(&sandbox(&lines), &[]),
        1,
        &["the joints' angles span 5.", "read as radians", "revolute_unit"],
    );
    let lines: Vec<_> = session(40).into_iter().map(|(deg, p)| (deg.map(f64::to_degrees), p)).collect();
    let parts = ["joint J1: the commands take it to", "its limits are -170 to 170 deg", "does not fit"];
    told(&identify(&sandbox(&lines), &[]), 1, &parts);
}

#[test]
fn a_home_offset_and_mirrored_points_are_told() {
    let lines: Vec<_> = session(40).into_iter().map(|([a, b, c], p)| ([a, b - 90.0, c], p)).collect();
    told(&identify(&sandbox(&lines), &[]), 1, &["J2 + 90 deg: RMS", "instead of", "theta_deg"]);
    let lines: Vec<_> = session(40).into_iter().map(|(deg, [x, y, z])| (deg, [y, x, z])).collect();
    told(&identify(&sandbox(&lines), &[]), 1, &["mirror image: exchanging x and y fits"]);
}

fn diagnose(sandbox: &Sandbox, more: &[&str]) -> Ended {
    let files = ["diagnose", "--model", "robot.toml", "--measurements", "m.csv"];
    sandbox.run(files.iter().chain(more))
}

/// The first hypothesis of a diagnosis, with its exit code.
#[track_caller]
fn diagnosed(sandbox: &Sandbox, code: i32, more: &[&str]) -> serde_json::Value {
    let ended = diagnose(sandbox, &[&["--json"], more].concat());
    assert_eq!(ended.code, Some(code), "{ended:?}");
    let json = ended.json();
    assert_eq!(json["schema"], "calibrig.diagnosis/1");
    json["hypotheses"][0].clone()
}

#[test]
fn a_diagnosis_names_what_was_broken_and_what_applies_it() {
    let sound = diagnosed(&sandbox(&session(40)), 0, &[]);
    assert_eq!((&sound["kinds"], &sound["where"]), (&serde_json::json!(["sound"]), &serde_json::json!([])));
    assert!(sound["rms_m"].as_f64().is_some_and(|rms| rms < 5e-3));
    told(&diagnose(&sandbox(&session(40)), &[]), 0, &["Sound: the robot fits the points as they were read"]);

    let broken = |change: &dyn Fn(&mut Vec<Line>)| {
        let mut lines = session(40);
        change(&mut lines);
        sandbox(&lines)
    };
    type Change = Box<dyn Fn(&mut Vec<Line>)>;
    let each = |change: fn(&mut Line)| -> Change { Box::new(move |lines| lines.iter_mut().for_each(change)) };
    let cases: Vec<(Change, serde_json::Value, serde_json::Value, &str)> = vec![
        (
            each(|(deg, _)| *deg = deg.map(f64::to_radians)),
            serde_json::json!(["angle_unit"]),
            serde_json::json!(["J1", "J2", "J3"]),
            "revolute_unit = \"rad\"",
        ),
        (
            each(|(_, p)| *p = p.map(|v| 1e-3 * v)),
            serde_json::json!(["length_unit"]),
            serde_json::json!([]),
            "`unit`",
        ),
        (
            each(|(deg, _)| deg[2] = -deg[2]),
            serde_json::json!(["joint_sign"]),
            serde_json::json!(["J3"]),
            "\"-J3\"",
        ),
        (
            each(|(deg, _)| deg[1] -= 90.0),
            serde_json::json!(["joint_offset"]),
            serde_json::json!(["J2"]),
            "raise `theta_deg` of J2",
        ),
        (
            each(|(deg, _)| deg[2] += deg[1]),
            serde_json::json!(["coupling"]),
            serde_json::json!(["J3", "J2"]),
            "\"J3 - J2\"",
        ),
        (
            Box::new(|lines| (lines[4].1, lines[13].1) = (lines[13].1, lines[4].1)),
            serde_json::json!(["rows_exchanged"]),
            serde_json::json!([5, 14]),
            "--leave-out 5,14",
        ),
        (
            Box::new(|lines| lines[7].1 = [-9999.0; 3]),
            serde_json::json!(["missed_shot_code"]),
            serde_json::json!([8]),
            "--leave-out 8",
        ),
        (
            Box::new(|lines| lines[7].1[0] += 5.0),
            serde_json::json!(["gross_error"]),
            serde_json::json!([8]),
            "--leave-out 8",
        ),
    ];
    for (change, kinds, places, remedy) in cases {
        let first = diagnosed(&broken(&change), 3, &[]);
        assert_eq!((&first["kinds"], &first["where"]), (&kinds, &places), "{first:#}");
        assert!(first["remedy"].as_str().is_some_and(|told| told.contains(remedy)), "{first:#}");
        assert!(first["probability"].as_f64().is_some_and(|p| p > 0.9), "{first:#}");
    }
}

/// Two parts that are about one column are told as the columns are with both, which makes the session sound.
#[test]
fn columns_that_two_parts_are_about_are_told_once() {
    let mut lines = session(40);
    for (deg, _) in &mut lines {
        deg[2] = -(deg[2] + deg[1]);
    }
    let both = sandbox(&lines);
    let found = diagnosed(&both, 3, &[]);
    assert_eq!(found["kinds"].as_array().map(Vec::len), Some(2), "{found:#}");
    let remedy = found["remedy"].as_str().expect("a remedy");
    let columns = remedy.split('`').nth(1).expect("a key");
    assert_eq!(columns, "columns = [\"J1\", \"J2\", \"-J2 - J3\"]", "{remedy}");
    both.write("map.toml", MAP.replace("columns = [\"J1\", \"J2\", \"J3\"]", columns));
    assert_eq!(diagnosed(&both, 0, &[])["kinds"][0], "sound");
}

/// Poses that are all one are no robot that lies beside its points.
#[test]
fn a_session_of_one_pose_tells_nothing() {
    let one = session(1);
    let lines: Vec<Line> = (0..20).map(|i| (one[0].0, one[0].1.map(|v| v + 0.01 * f64::from(i)))).collect();
    told(
        &diagnose(&sandbox(&lines), &[]),
        0,
        &["say too little about the robot", "all poses are the same one: fewer than 5"],
    );
}

/// What a diagnosis asks for that no column map says is a flag, and makes the session sound.
#[test]
fn flags_apply_what_a_diagnosis_found() {
    let mut lines = session(40);
    let points: Vec<_> = lines.iter().map(|(_, point)| *point).collect();
    for (line, point) in lines[1..].iter_mut().zip(points) {
        line.1 = point;
    }
    lines.remove(0);
    let shifted = sandbox(&lines);
    assert_eq!(diagnosed(&shifted, 3, &[])["remedy"], "--shift-points 1");
    assert_eq!(diagnosed(&shifted, 0, &["--shift-points", "1"])["kinds"][0], "sound");
    told(&identify(&shifted, &["--shift-points", "1"]), 0, &[]);
    told(&identify(&shifted, &[]), 1, &["one row lower", "--shift-points 1"]);

    let mut lines = session(40);
    (lines[4].1, lines[13].1) = (lines[13].1, lines[4].1);
    let exchanged = sandbox(&lines);
    assert_eq!(diagnosed(&exchanged, 0, &["--leave-out", "5,14"])["kinds"][0], "sound");
    told(&identify(&exchanged, &["--leave-out", "5,14"]), 0, &[]);
    let ended = diagnose(&exchanged, &["--leave-out", "77"]);
    told(&ended, 2, &["--leave-out 77: no point of this pose was read"]);
}

/// The verification set is looked at as well; a joint that never moved is named.
#[test]
fn a_diagnosis_is_of_both_sets_and_says_what_cannot_be_told() {
    let mut lines = session(40);
    for (deg, _) in &mut lines {
        deg[2] = -deg[2];
    }
    let both = sandbox(&session(40));
    both.write("v.csv", csv(&lines));
    let ended = diagnose(&both, &["--verify", "v.csv", "--json"]);
    assert_eq!(ended.code, Some(3));
    let json = ended.json();
    assert_eq!(json["hypotheses"][0]["kinds"][0], "sound");
    assert_eq!(json["verification"]["hypotheses"][0]["kinds"][0], "joint_sign");
    let mut lines = session(40);
    for (deg, _) in &mut lines {
        deg[2] = 10.0;
    }
    told(
        &diagnose(&sandbox(&lines), &[]),
        3,
        &["J3 never moved: sign, unit, order and zero of it cannot be determined"],
    );
}

#[test]
fn the_code_of_a_missed_shot_is_refused_in_a_short_file_and_in_a_long_one() {
    for poses in [20, 300] {
        for code in [-9999.0, 999_999.0] {
            let mut lines = session(poses);
            lines[4].1 = [code; 3];
            let ended = identify(&sandbox(&lines), &[]);
            told(&ended, 1, &["no point that the robot could reach", "row 5 by", "missed"]);
        }
    }
    // Held out, too.
    let sandbox = sandbox(&session(40));
    let mut lines = session(20);
    lines[7].1 = [-9999.0; 3];
    sandbox.write("v.csv", csv(&lines));
    told(&identify(&sandbox, &["--verify", "v.csv"]), 1, &["verification set: no point", "row 8 by"]);
}

#[test]
fn a_gross_error_is_named_with_its_size_under_every_loss() {
    let mut lines = session(40);
    lines[7].1[0] += 5.0;
    let sandbox = sandbox(&lines);
    let ended = identify(&sandbox, &["--out", "out"]);
    told(
        &ended,
        3,
        &[
            "pose 8 (",
            "--loss tukey",
            "doubtful: only calibration: far from what the others say",
            "not searched for",
        ],
    );
    let report: serde_json::Value = serde_json::from_str(&sandbox.read("out/report.json")).expect("JSON");
    let estimate = &report["estimates"]["only_calibration"];
    assert_eq!(estimate["status"], "gross_errors");
    assert_eq!(estimate["outliers"][0]["pose"], 8);
    let distance = estimate["outliers"][0]["distance_m"].as_f64().expect("a number");
    assert!((distance - 5e-3).abs() < 2e-4, "{distance}");
    assert!(estimate["reasons"][0].as_str().is_some_and(|reason| reason.contains("pose 8")));
    assert_eq!(estimate["judgement"]["consistent"], false);
    for loss in ["huber", "cauchy", "tukey"] {
        told(
            &identify(&sandbox, &["--loss", loss]),
            0,
            &["warning: far from what the others say", "pose 8 ("],
        );
    }
}

/// A hundred times the noise, in a set that no fit sees: told, and nothing of the fit is doubted for it.
#[test]
fn a_gross_error_in_the_verification_set_is_a_warning() {
    let sandbox = sandbox(&session(40));
    let mut lines = session(30);
    lines[9].1[2] -= 3.0;
    sandbox.write("v.csv", csv(&lines));
    let ended = identify(&sandbox, &["--verify", "v.csv"]);
    told(&ended, 0, &["verification set, gross errors, far from what the other readings say: pose 10 ("]);
}

/// One gross error spoils the fit of squares that the nominal robot is placed by, and with it what calibration seems to improve.
#[test]
fn the_loss_holds_for_the_row_without_calibration() {
    let mut lines = session(40);
    lines[7].1[0] += 60.0;
    let sandbox = sandbox(&lines);
    sandbox.write("v.csv", csv(&session(30)));
    let rms = |loss: &str| {
        let ended = identify(&sandbox, &["--verify", "v.csv", "--loss", loss, "--json"]);
        let row = &ended.json()["sets"]["verification"]["rows"]["without_calibration"];
        row["rms_3d_m"].as_f64().expect("a number")
    };
    let clean = {
        sandbox.write("m.csv", csv(&session(40)));
        let clean = rms("squared");
        sandbox.write("m.csv", csv(&lines));
        clean
    };
    assert!(rms("squared") > 2.0 * clean, "{} {clean}", rms("squared"));
    assert!(rms("tukey") < 1.2 * clean, "{} {clean}", rms("tukey"));
}

#[test]
fn the_report_names_the_command_that_gives_it() {
    let sandbox = sandbox(&session(40));
    let options = [
        "--mode",
        "only_calibration",
        "--loss",
        "huber",
        "--tolerance-mm",
        "5",
        "--tolerance-mrad",
        "7",
        "--splits",
        "3",
        "--fit",
        "20",
        "--out",
        "out",
    ];
    told(&identify(&sandbox, &options), 0, &[]);
    let page = sandbox.read("out/report.html");
    let command = page
        .split("<code>calibrig ")
        .skip(1)
        .filter_map(|rest| rest.split("</code>").next())
        .find(|command| command.starts_with("identify "))
        .expect("a command");
    assert!(command.ends_with("--fit 20 --out DIR"), "{command}");
    // It is run as it stands.
    let arguments: Vec<_> =
        command.split(' ').map(|word| if word == "DIR" { "again" } else { word }).collect();
    assert_eq!(sandbox.run(arguments).code, Some(0));
    assert!(
        sandbox.read("again/report.html") == page
            && sandbox.read("again/report.json") == sandbox.read("out/report.json")
    );
}

#[test]
fn commands_beyond_the_limits_draw_a_remark() {
    let mut lines = session(40);
    lines[3].0[0] += 360.0;
    told(
        &identify(&sandbox(&lines), &[]),
        0,
        &["joint J1: the commands take it to", "its limits are -170 to 170 deg"],
    );
}

/// The same words wherever the codes are told.
#[test]
fn the_exit_codes_are_told_in_the_same_words() {
    let root = |name: &str| {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(name);
        let text = std::fs::read_to_string(path).expect("a document").replace(['*', '|', '`'], " ");
        text.split_whitespace().collect::<Vec<_>>().join(" ").replace(" .", ".")
    };
    let help = Sandbox::new().run(["--help"]).stdout.split_whitespace().collect::<Vec<_>>().join(" ");
    for text in [root("README.md"), root("docs/adr/0015-one-table-of-exit-codes.md"), help] {
        for words in [
            "done: the stated intervals hold as far as the data can tell; warnings may stand, also of a misfit that the intervals account for, and \
             of drives without visible compliance",
            "no result: input refused, or the nominal robot does not fit the points",
            "a result that a person must look at: not converged; rank-deficient in what was asked for; a stated prior, nest or target contradicted; \
             a bound of the user reached; a parameter whose identification makes held-out poses worse than leaving it; gross errors that carry \
             weight in the fit; replay differs; acceptance missed; shards missing",
        ] {
            assert!(text.contains(words), "{words:?} is not in {text}");
        }
    }
}

#[test]
fn the_published_experiment_ends_with_0() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(SCENARIO);
    let sandbox = Sandbox::new();
    let path = root.to_str().expect("a path");
    told(&sandbox.run(["run", path, "--out", "out"]), 0, &[]);
}

/// What a model lacks has heavier tails than noise: the weights of a robust loss settle slowly, and have the time for it.
#[test]
fn a_robust_loss_converges_where_the_model_lacks_something() {
    let mut lines = session(60);
    for ([_, b, c], point) in lines.iter_mut().map(|(deg, point)| (*deg, point)) {
        let sag = 0.6 * b.to_radians().cos() + 0.3 * (b + c).to_radians().cos();
        point[2] -= sag;
        point[0] += 0.5 * (3.0 * c.to_radians()).sin();
    }
    let sandbox = sandbox(&lines);
    for loss in ["huber", "cauchy", "tukey"] {
        let ended = identify(&sandbox, &["--loss", loss]);
        told_any(&ended, 0, &["converged after"]);
    }
}
