//! Pose accuracy and repeatability (ISO 9283): on machines whose scatter and errors are known, and from files of cycles.

use std::fmt::Write;
use std::ops::ControlFlow;
use std::path::Path;

use nalgebra::{Matrix3, Rotation3, Vector3};

use calibrig::evaluation::chi2_band;
use calibrig::evaluation::iso9283::{CubePlane, PositionAccuracy};
use calibrig::files::load_robot;
use calibrig::identification::Mode;
use calibrig::kinematics::{forward_kinematics, joints_from_command, target_in_base};
use calibrig::pipeline::{Iso9283Outcome, Iso9283Plan, Iso9283Pose, PlantKind, iso9283_of_scenario};
use calibrig::plant::effects::{Backlash, Effects, Repeatability};
use calibrig::report::{JsonIso9283, iso9283_html, json_iso9283, render_iso9283};
use calibrig::scenario::Scenario;

use crate::a_user_reproduces_the_paper::rigid_paper;
use crate::sandbox::{SCENARIO, Sandbox};

const PLAN: Iso9283Plan =
    Iso9283Plan { cycles: 30, edge: Some(0.4), centre: None, plane: CubePlane::C1C2C7C8 };

/// The rigid machine with the published errors, few poses before the test.
fn machine(effects: Effects) -> Scenario {
    let mut scenario = rigid_paper();
    scenario.as_built.effects = effects;
    scenario.options.unmodelled_sigma = 0.0;
    scenario.modes = vec![Mode::WithoutCalibration, Mode::OnlyCalibration];
    scenario.verification_poses = 0;
    scenario
}

fn test(scenario: &Scenario, plan: &Iso9283Plan) -> Iso9283Outcome {
    let run = (scenario.seed, 0, PlantKind::Rapier);
    iso9283_of_scenario(scenario, run, plan, &mut |_, _| ControlFlow::Continue(())).expect("a test")
}

/// With exact readings AP is the difference of two forward kinematics, and RP nothing.
#[test]
fn accuracy_of_an_exact_machine_is_the_difference_of_two_robots() {
    let mut scenario = machine(Effects::default());
    scenario.tracker.instrument.noise = false;
    let outcome = test(&scenario, &Iso9283Plan { cycles: 3, ..PLAN });
    assert!(outcome.doubts.is_empty(), "{:?}", outcome.doubts);
    let [target] = outcome.targets.as_slice() else { panic!("one target") };
    let cube = outcome.cube.expect("a cube");
    let row = &target.rows[0];
    assert_eq!((row.key, target.poses.len()), ("nominal_by_nests", 5));
    let in_flange = scenario.as_built.target;
    let nominal = &scenario.robot.model.kinematics;
    for ((pose, ap), place) in target.poses.iter().zip(&row.position).zip(cube.poses()) {
        // The nominal robot would bring the target to the corner of the plane; the real one is off by its errors.
        assert!((pose.barycentre - ap.error - place).norm() < 1e-6, "{}", pose.barycentre - ap.error - place);
        assert!(pose.position.repeatability < 1e-9 && ap.radius < 1e-9, "{pose:?}");
        assert!(ap.distance > 1e-3, "{ap:?}");
    }
    // At the middle of the region the commands are known.
    let joints = &scenario.region.centre;
    let at = |kinematics| target_in_base(kinematics, joints, &in_flange).expect("seven joints");
    let expected = at(&scenario.as_built.kinematics) - at(nominal);
    assert!((row.position[0].error - expected).norm() < 1e-7, "{} {expected}", row.position[0].error);
    // The identified robot is the machine.
    let identified = target.rows.iter().find(|row| row.key == "only_calibration").expect("a mode");
    assert!(identified.position.iter().all(|ap| ap.distance < 1e-6), "{:?}", identified.position);
}

/// Scatter of the actuators through derivatives of the forward kinematics: chi-square of 5 x 29 x 3 deviations in its 99.9 % band.
#[test]
fn repeatability_is_what_the_actuators_scatter_by() {
    let sigma = [40e-6, 2e-5, 1e-5, 1.5e-5, 30e-6, 5e-5, 5e-5];
    let mut scenario = machine(Effects {
        repeatability: Some(Repeatability { sigma: sigma.to_vec() }),
        ..Effects::default()
    });
    scenario.tracker.instrument.noise = false;
    let outcome = test(&scenario, &PLAN);
    assert_eq!(outcome.cycles, 30);
    let at = |command: &[f64]| {
        let mut joints = vec![0.0; 7];
        let (kinematics, actuators) = (&scenario.as_built.kinematics, &scenario.as_built.actuators);
        joints_from_command(kinematics, actuators, command, &mut joints).expect("a pose");
        target_in_base(kinematics, &joints, &scenario.as_built.target).expect("seven joints")
    };
    let nominal_at_middle = scenario.robot.model.actuators.command_from_joints(&scenario.region.centre);
    let target = &outcome.targets[0];
    // P1 is the middle of the region, whose command is known here.
    let step = 1e-5;
    let mut covariance = Matrix3::zeros();
    for (actuator, sigma) in sigma.iter().enumerate() {
        let mut command = nominal_at_middle.clone();
        command[actuator] += step;
        let ahead = at(&command);
        command[actuator] -= 2.0 * step;
        let column = (ahead - at(&command)) / (2.0 * step) * *sigma;
        covariance += column * column.transpose();
    }
    let weight = covariance.cholesky().expect("seven directions").inverse();
    let chi2: f64 = target.poses[0].deviations.iter().map(|d| d.dot(&(weight * d))).sum();
    let (low, high) = chi2_band(3.0 * 29.0, 0.999);
    assert!((low..=high).contains(&(chi2 / 87.0)), "{} not in {low}..{high}", chi2 / 87.0);
    for pose in &target.poses {
        let rp = pose.position;
        assert!(rp.interval[0] < rp.repeatability && rp.repeatability < rp.interval[1]);
        assert!(rp.repeatability > 1e-5 && rp.repeatability < 1e-3, "{rp:?}");
    }
    assert_eq!(outcome, test(&scenario, &PLAN));
}

/// Every pose has one approach: play shifts the barycentre, and adds nothing to the scatter.
#[test]
fn play_is_in_the_accuracy_and_not_in_the_repeatability() {
    let exact = |effects| {
        let mut scenario = machine(effects);
        scenario.tracker.instrument.noise = false;
        test(&scenario, &Iso9283Plan { cycles: 4, ..PLAN })
    };
    let gap = vec![0.0, 0.0, 4e-4, 0.0, 0.0, 0.0, 0.0];
    let (with, without) = (
        exact(Effects { backlash: Some(Backlash { gap }), ..Effects::default() }),
        exact(Effects::default()),
    );
    let mut moved = 0;
    for (with, without) in with.targets[0].poses.iter().zip(&without.targets[0].poses) {
        assert!(with.position.repeatability < 1e-9, "{:?}", with.position);
        moved += usize::from((with.barycentre - without.barycentre).norm() > 1e-4);
    }
    assert_eq!(moved, 5, "half a gap of 0.4 mrad on an arm of metres");
    assert!(!with.remarks.iter().any(|remark| remark.contains("different sides")), "{:?}", with.remarks);
    assert!(with.remarks.iter().any(|remark| remark.starts_with("4 cycles: the standard asks for 30")));
}

/// A machine without any scatter: what is left is the tracker's, and the page says so.
#[test]
fn the_part_of_the_readings_is_told() {
    let outcome = test(&machine(Effects::default()), &PLAN);
    let target = &outcome.targets[0];
    // Two directions of about equal size: 2 x 5 x 29 degrees of freedom, four standard deviations of their mean square.
    let ratio: f64 = target
        .poses
        .iter()
        .map(|pose| pose.position.axis_sigma.norm_squared() / pose.stated_sigma.expect("stated").powi(2))
        .sum::<f64>()
        / 5.0;
    assert!((ratio - 1.0).abs() < 4.0 * (2.0_f64 / 290.0).sqrt(), "{ratio}");
    let over = target.over_stated.expect("stated");
    assert!((over.band.0..=over.band.1).contains(&over.ratio), "{over:?}");
    let text = render_iso9283(&outcome, calibrig::report::Style::Plain);
    assert!(text.lines().all(|line| line.chars().count() <= 100), "{text}");
    for part in [
        "RP (mean l + 3 S_l)",
        "only calibration",
        "tracker placed by the base nests",
        "its text was not at hand",
        "the machine's own cannot be seen beside it",
    ] {
        assert!(text.contains(part), "{part} in\n{text}");
    }
    let html = iso9283_html(&outcome).expect("a page");
    // A marker a cycle, pose and view.
    assert!(html.matches("<polygon").count() >= 30 * 5 * 3 && html.ends_with("</html>"));
    let json = serde_json::to_string(&json_iso9283(&outcome)).expect("JSON");
    let read: JsonIso9283 = serde_json::from_str(&json).expect("the schema");
    assert_eq!(read, json_iso9283(&outcome));
    assert_eq!(read.targets[0].poses[0].deviations_m.len(), 30);
}

#[test]
fn a_cube_out_of_reach_is_refused_with_the_pose_and_the_distance() {
    let sandbox = Sandbox::new();
    let refused = |arguments: &[&str], parts: &[&str]| {
        let ended = sandbox.run([&["iso9283", SCENARIO][..], arguments].concat());
        assert_eq!((ended.code, ended.stdout.as_str()), (Some(1), ""), "{ended:?}");
        for part in parts {
            assert!(ended.stderr.contains(part), "{part} in {}", ended.stderr);
        }
    };
    refused(
        &["--cube-mm", "3000"],
        &[
            "the test cube: P",
            "of the cube of 3000 mm",
            "the nearest point found is",
            "mm away",
            "expected a smaller cube",
        ],
    );
    refused(
        &["--cube-centre-mm", "9000,0,0"],
        &["no cube of 10 mm or more about (9.000, 0.000, 0.000) m", "--cube-centre-mm"],
    );
    for (arguments, message) in [
        (&["iso9283"][..], "required arguments"),
        (&["iso9283", SCENARIO, "--cycles", "1"], "--cycles"),
        (&["iso9283", SCENARIO, "--cube-mm", "nan"], "expected a number of mm from 1 to 20000"),
        (&["iso9283", SCENARIO, "--cube-centre-mm", "1,2"], "expected three numbers of mm"),
        (&["iso9283", "--model", "models/ur5/robot.toml"], "required arguments"),
        (&["iso9283", SCENARIO, "--measurements", "m.csv"], "cannot be used with"),
        (
            &["iso9283", "--model", "models/ur5/robot.toml", "--measurements", "m.csv", "--trial", "3"],
            "cannot be used with",
        ),
    ] {
        let ended = sandbox.run(arguments);
        assert_eq!(ended.code, Some(2), "{arguments:?}: {ended:?}");
        assert!(ended.stderr.contains(message), "{message} in {}", ended.stderr);
    }
}

const MODEL: &str = "models/ur5/robot.toml";
/// Offsets of the targets on the flange, m.
const TARGETS: [(&str, [f64; 3]); 3] =
    [("A", [0.05, 0.0, 0.1]), ("B", [0.0, 0.06, 0.1]), ("C", [0.0, 0.0, 0.02])];
/// What every reading is off from the nominal robot, m.
const SHIFT: [f64; 3] = [3e-4, -4e-4, 0.0];

/// Five poses in four cycles each, seen in the base frame: the flange is off by [`SHIFT`], by 10 um along x, -x, y and -y, and turned by 1 mrad
/// about z of the base, to and fro.
fn cycles(targets: &[(&str, [f64; 3])]) -> Vec<String> {
    let robot = load_robot(Path::new(MODEL)).expect("the shipped robot");
    let mut rows = vec!["q1_rad,q2_rad,q3_rad,q4_rad,q5_rad,q6_rad,x_m,y_m,z_m,target,pose".to_owned()];
    let around = [Vector3::x(), -Vector3::x(), Vector3::y(), -Vector3::y()];
    for (cycle, off) in around.iter().enumerate() {
        for pose in 1..=5 {
            let k = f64::from(pose);
            let q = [0.3, -1.1, 1.2, -0.4, 0.9, 0.2].map(|q: f64| q + 0.2 * (q + k).sin());
            let flange = forward_kinematics(&robot.model.kinematics, &q).expect("a pose");
            let turn = Rotation3::new(Vector3::z() * if cycle % 2 == 0 { 1e-3 } else { -1e-3 });
            for (name, in_flange) in targets {
                let p: Vector3<f64> = flange.translation.vector
                    + Vector3::from(SHIFT)
                    + 1e-5 * off
                    + turn * (flange.rotation * Vector3::from(*in_flange));
                let mut row = q.map(|q| format!("{q:.12},")).concat();
                let _ = write!(row, "{:.10},{:.10},{:.10},{name},{pose}", p.x, p.y, p.z);
                rows.push(row);
            }
        }
    }
    rows
}

/// Nests in the tracker's own frame, which is that of the base, and offsets as they are.
fn session(targets: &[(&str, [f64; 3])]) -> String {
    let mut text = "schema = \"calibrig.session/1\"\n[[station]]\nname = \"1\"\n".to_owned();
    for (name, at) in [
        ("left", [1.0, 0.0, 0.0]),
        ("right", [0.0, 1.0, 0.0]),
        ("top", [0.0, 0.0, 1.0]),
        ("foot", [-1.0, -1.0, 0.0]),
    ] {
        let _ = writeln!(
            text,
            "[[station.nest]]\nname = \"{name}\"\nin_base_m = {at:?}\nin_base_sigma_m = 1e-5\nposition_m = {at:?}\nsigma_m = 1e-5"
        );
    }
    for (name, in_flange) in targets {
        let _ = writeln!(text, "[[target]]\nname = \"{name}\"\nin_flange_m = {in_flange:?}\nsigma_m = 1e-5");
    }
    text
}

fn files(rows: &[String]) -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.write("cycles.csv", rows.join("\n") + "\n");
    sandbox.write("session.toml", session(&TARGETS));
    sandbox
}

const FROM_FILE: [&str; 5] = ["iso9283", "--model", MODEL, "--measurements", "cycles.csv"];

fn number(value: &serde_json::Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("no number: {value}"))
}

#[test]
fn a_file_of_cycles_gives_its_figures() {
    let sandbox = files(&cycles(&TARGETS));
    let more = ["--session", "session.toml", "--json", "--out", "iso"];
    let ended = sandbox.run([&FROM_FILE[..], &more].concat());
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let json = ended.json();
    assert_eq!(
        (&json["schema"], &json["cycles"], &json["frame"]),
        (&"calibrig.iso9283/1".into(), &4.into(), &"base".into())
    );
    let written: serde_json::Value = serde_json::from_str(&sandbox.read("iso/iso9283.json")).expect("JSON");
    assert_eq!(written, json);
    assert!(sandbox.read("iso/iso9283.html").contains("Orientation from targets together"));
    let targets = json["targets"].as_array().expect("targets");
    assert_eq!(targets.len(), 3);
    // Turns of +-1 mrad about z: 3 sqrt(4 / 3) mrad, and no mean turn.
    for rp in json["combined"]["repeatability"].as_array().expect("poses") {
        let [a, b, c] = [0, 1, 2].map(|axis| number(&rp["rp_rad"][axis]));
        assert!(
            a.abs() < 1e-6 && b.abs() < 1e-6 && (c - 3e-3 * (4.0_f64 / 3.0).sqrt()).abs() < 1e-6,
            "{a} {b} {c}"
        );
    }
    let by_nests = &json["combined"]["accuracy"][0];
    assert_eq!(by_nests[0], "nominal_by_nests");
    for ap in by_nests[1].as_array().expect("poses") {
        assert!((0..3).all(|axis| number(&ap["ap_rad"][axis]).abs() < 1e-6), "{ap}");
    }
    for target in targets {
        let row = &target["accuracy"][0];
        assert_eq!(row["registration"], "tracker placed by the base nests");
        for ap in row["poses"].as_array().expect("poses") {
            // (0.3, -0.4, 0) mm, and 0.5 urad mm of the turn's curvature.
            assert!((number(&ap["ap_m"]) - 5e-4).abs() < 1e-6, "{ap}");
        }
        // A best fit of 15 numbers to 45 coordinates is told.
        let fitted = target["accuracy"].as_array().expect("rows").len();
        assert!(fitted <= 2);
    }
}

/// One target without turn: distances of 10 um from the barycentre in every cycle, so that RP is 10 um.
#[test]
fn repeatability_needs_no_registration_and_accuracy_says_why_it_is_left_out() {
    let centre = [("SMR", [0.0, 0.0, 0.0])];
    let sandbox = files(&cycles(&centre));
    let ended = sandbox.run([&FROM_FILE[..], &["--json"]].concat());
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let json = ended.json();
    let target = &json["targets"][0];
    for pose in target["poses"].as_array().expect("poses") {
        assert!((number(&pose["rp_m"]) - 1e-5).abs() < 1e-9, "{pose}");
        assert!(pose["stated_sigma_3d_m"].is_null());
    }
    assert_eq!(target["accuracy"].as_array().map(Vec::len), Some(0));
    let remarks = json["remarks"].to_string();
    for part in [
        "no accuracy by nests: the offset of target SMR",
        "no accuracy by a best fit: it would fit 9 numbers to the 15 coordinates",
        "4 cycles: the standard asks for 30",
    ] {
        assert!(remarks.contains(part), "{part} in {remarks}");
    }
    assert_eq!(json["frame"], "tracker");
    assert!(json.get("combined").is_none() && json.get("cube").is_none());
}

#[test]
fn cycles_that_are_none_are_refused_with_what_to_do() {
    let rows = cycles(&[("SMR", [0.0, 0.0, 0.1])]);
    let refused = |rows: &[String], more: &[&str], parts: &[&str]| {
        let sandbox = files(rows);
        let ended = sandbox.run([&FROM_FILE[..], more].concat());
        assert_eq!((ended.code, ended.stdout.as_str()), (Some(1), ""), "{ended:?}");
        for part in parts {
            assert!(ended.stderr.contains(part), "{part} in {}", ended.stderr);
        }
    };
    refused(
        &rows[..6],
        &[],
        &["none of the 5 poses of target SMR was measured more than once", "expected one row per cycle"],
    );
    refused(&rows[..7], &[], &["only pose 1 of target SMR was measured more than once"]);
    refused(
        &rows[..20],
        &[],
        &["pose 5 was measured in 3 cycles, but pose 1 in 4", "--cycles N uses the first N of every pose"],
    );
    refused(
        &rows[..20],
        &["--cycles", "4"],
        &["pose 5 was measured in 3 cycles, but 4 were asked for", "expected a smaller --cycles"],
    );
    refused(&rows, &["--target", "B"], &["there is no target \"B\": expected one of SMR"]);
    refused(&rows, &["--average-repeats"], &["none of the 5 poses", "no --average-repeats"]);
    let sandbox = files(&rows[..20]);
    let ended = sandbox.run([&FROM_FILE[..], &["--cycles", "3"]].concat());
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert!(
        ended.stdout.contains("3 cycles at 5 poses") && ended.stdout.contains("the standard asks for 30"),
        "{}",
        ended.stdout
    );
}

/// What an identified robot expects to be off by is what it is off by at poses that it has not seen, on average over 30 sessions. A ratio of squares with one degree of
/// freedom has variance 2: the mean of 30 is within four standard deviations of at most 0.26, although the poses of one session depend on each other.
#[test]
fn an_identified_robot_is_as_accurate_as_it_says() {
    let scenario = machine(Effects::default());
    let plan = Iso9283Plan { cycles: 5, ..PLAN };
    let mut sum = 0.0;
    for seed in 1..=30 {
        let run = (seed, 0, PlantKind::Analytic);
        let outcome = iso9283_of_scenario(&scenario, run, &plan, &mut |_, _| ControlFlow::Continue(()))
            .expect("a test");
        let target = &outcome.targets[0];
        let row = target.rows.iter().find(|row| row.key == "only_calibration").expect("a mode");
        let ratio = |((pose, ap), expected): ((&Iso9283Pose, &PositionAccuracy), &Option<f64>)| {
            let of_cycles = pose.position.axis_sigma.norm_squared() / 5.0;
            ap.distance.powi(2) / (expected.expect("full rank").powi(2) + of_cycles)
        };
        sum += target.poses.iter().zip(&row.position).zip(&row.expected_sigma).map(ratio).sum::<f64>() / 5.0;
    }
    let mean = sum / 30.0;
    eprintln!("squares of AP over what is expected: {mean:.2}");
    assert!((mean - 1.0).abs() < 4.0 * (2.0_f64 / 30.0).sqrt(), "{mean}");
}
