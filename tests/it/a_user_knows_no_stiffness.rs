//! A robot whose drives are not as stiff as its file says, identified from files.

use std::fmt::Write;

use calibrig::identification::{CalibratedRobot, Mode, Predictor};
use calibrig_files::load_robot;
use calibrig_model::geometry::{rotation_x, translation};
use calibrig_model::random::{StreamSource, stream};
use nalgebra::Vector3;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::sandbox::{Ended, Sandbox};

const ROBOT: &str = "three.toml";
/// N m/rad, of the machine.
const STIFFNESS: f64 = 2e4;

/// A waist and two parallel axes. `stiffness`: as the file states it, N m/rad; `lines` stand in the head of the file.
fn write_robot(sandbox: &Sandbox, stiffness: f64, lines: &str) {
    let mut text = format!(
        "schema = \"calibrig.robot/1\"\nname = \"three\"\nconvention = \"craig\"\nurdf = \"three.urdf\"\n{lines}\n"
    );
    for (name, a, alpha, d) in [("j1", 0, 0, 300), ("j2", 0, -90, 0), ("j3", 500, 0, 0)] {
        let _ = write!(
            text,
            "[[joint]]\nname = \"{name}\"\ntype = \"revolute\"\na_mm = {a}\nalpha_deg = {alpha}\nd_mm = {d}\ntheta_deg = 0\n\
             min_deg = -180\nmax_deg = 180\nstiffness_nm_per_rad = {stiffness}\n"
        );
    }
    text +=
        "[actuators]\nkind = \"direct\"\n[gravity]\nx_m_per_s2 = 0\ny_m_per_s2 = 0\nz_m_per_s2 = -9.80665\n";
    sandbox.write(ROBOT, text);
    let mut urdf = "<robot name=\"three\"><link name=\"base\"/>\n".to_owned();
    for (link, x, mass) in [("1", 0.0, 5.0), ("2", 0.25, 10.0), ("3", 0.2, 5.0)] {
        let _ = writeln!(
            urdf,
            "<link name=\"{link}\"><inertial><origin xyz=\"{x} 0 0\"/><mass value=\"{mass}\"/><inertia ixx=\"0.1\" ixy=\"0\" ixz=\"0\" \
             iyy=\"0.1\" iyz=\"0\" izz=\"0.1\"/></inertial></link>"
        );
    }
    for (joint, parent, child, origin) in [
        ("j1", "base", "1", "xyz=\"0 0 0.3\""),
        ("j2", "1", "2", "xyz=\"0 0 0\" rpy=\"-1.5707963267948966 0 0\""),
        ("j3", "2", "3", "xyz=\"0.5 0 0\""),
    ] {
        let _ = writeln!(
            urdf,
            "<joint name=\"{joint}\" type=\"revolute\"><parent link=\"{parent}\"/><child link=\"{child}\"/><origin {origin}/><axis xyz=\"0 0 \
             1\"/><limit lower=\"-3.141592653589793\" upper=\"3.141592653589793\" effort=\"1\" velocity=\"1\"/></joint>"
        );
    }
    sandbox.write("three.urdf", urdf + "</robot>\n");
}

/// Sixty poses of the machine with 20 um of noise an axis, in calibrig's own columns.
fn write_measurements(sandbox: &Sandbox) {
    write_robot(sandbox, STIFFNESS, "");
    let machine = load_robot(&sandbox.path(ROBOT)).expect("a robot").model;
    let station = translation(2.5, 0.4, 0.1) * rotation_x(0.2);
    let target = Vector3::new(0.4, 0.03, 0.05);
    let robot = CalibratedRobot {
        instruments: Vec::new(),
        mode: Mode::ElastoGeometric,
        nominal: machine.clone(),
        model: machine,
        terms: Vec::new(),
        stations: vec![station],
        targets: vec![target],
        orientations: vec![None],
    };
    let mut predictor = Predictor::new(&robot).expect("a robot");
    let mut rng = stream(2, 0, StreamSource::IdentificationNoise);
    let mut text = "pose,q1_rad,q2_rad,q3_rad,x_m,y_m,z_m\n".to_owned();
    for pose in 0..60 {
        let command = [0; 3].map(|_| rng.random_range(-1.2..1.2_f64));
        let seen =
            station.rotation * predictor.in_base(&command[..]).expect("a pose") + station.translation.vector;
        let noise = Vector3::from_fn(|_, _| -> f64 { StandardNormal.sample(&mut rng) }) * 20e-6;
        let seen = seen + noise;
        let [j1, j2, j3] = command;
        let _ = writeln!(text, "{pose},{j1},{j2},{j3},{},{},{}", seen.x, seen.y, seen.z);
    }
    sandbox.write("sag.csv", text);
}

fn identify(sandbox: &Sandbox, flags: &[&str]) -> Ended {
    sandbox.run([&["identify", "--model", ROBOT, "--measurements", "sag.csv"], flags].concat())
}

fn rms_mm(report: &serde_json::Value) -> f64 {
    let row = &report["sets"]["identification"]["rows"]["elasto_geometric"];
    1e3 * row["rms_3d_m"].as_f64().unwrap_or_else(|| panic!("{report:#}"))
}

#[test]
fn drives_far_from_what_the_file_states_are_found_and_what_is_left_out_is_listed() {
    let sandbox = Sandbox::new();
    write_measurements(&sandbox);
    for (stated, flags) in [
        (10.0, ["--compliance-percent", "1000"]),
        (10.0, ["--compliance-percent", "unknown"]),
        (100.0, ["--compliance-percent", "unknown"]),
        (0.1, ["--compliance-percent", "unknown"]),
    ] {
        write_robot(&sandbox, stated * STIFFNESS, "compliance_percent = 100");
        let ended = identify(&sandbox, &[&flags[..], &["--json"]].concat());
        assert_eq!(ended.code, Some(0), "{stated} {flags:?}: {}", ended.stderr);
        let report = ended.json();
        // 20 um an axis is 0.0346 mm.
        assert!(rms_mm(&report) < 0.038, "{stated} {flags:?}: {}", rms_mm(&report));
        let left = &report["estimates"]["elasto_geometric"]["left_out"];
        assert_eq!(
            (left[0]["name"].as_str(), left[0]["reason"].as_str()),
            (Some("compliance_drive1"), Some("unloaded"))
        );
        assert_eq!(left.as_array().map(Vec::len), Some(1));
        let text = identify(&sandbox, &flags).stdout;
        assert!(text.contains("left out: compliance_drive1: gravity hardly loads it"), "{text}");
        assert!(!text.contains("hardly loads compliance"), "{text}");
    }
    write_robot(&sandbox, 100.0 * STIFFNESS, "compliance_percent = 100");
    let ended = identify(&sandbox, &[]);
    assert_eq!(ended.code, Some(3), "{ended:?}");
    for part in
        ["much softer drives than the prior allows", "--compliance-percent unknown", "compliance_drive3"]
    {
        assert!(ended.stderr.contains(part), "{part}: {}", ended.stderr);
    }
    let refused = identify(&sandbox, &["--compliance-percent", "none"]);
    assert!(refused.code == Some(2) && refused.stderr.contains("\"unknown\""), "{refused:?}");
}

/// What is stated of masses makes compliances less sure; what is not, is said.
#[test]
fn the_uncertainty_of_masses_is_in_the_compliances() {
    let sandbox = Sandbox::new();
    write_measurements(&sandbox);
    write_robot(&sandbox, STIFFNESS, "compliance_percent = 100");
    let sigma = |ended: &Ended| {
        let report = ended.json();
        let parameters = report["parameters"].as_array().cloned().unwrap_or_default();
        let shoulder = parameters
            .into_iter()
            .find(|p| p["name"] == "compliance_drive2" && p["mode"] == "elasto_geometric");
        shoulder.and_then(|p| p["sigma"].as_f64()).unwrap_or_else(|| panic!("{report:#}"))
    };
    let exact = identify(&sandbox, &["--json"]);
    assert!(
        exact.stderr.contains("taken as exact") && exact.stderr.contains("mass_percent"),
        "{}",
        exact.stderr
    );
    let flags = identify(&sandbox, &["--json", "--mass-percent", "3", "--centre-mm", "5"]);
    assert!(!flags.stderr.contains("taken as exact") && flags.code == Some(0), "{}", flags.stderr);
    write_robot(&sandbox, STIFFNESS, "compliance_percent = 100\nmass_percent = 3\ncentre_mm = 5");
    let file = identify(&sandbox, &["--json"]);
    // A load of two bodies of 3 % each, and of 5 mm in some 300.
    assert!(
        sigma(&flags) > 1.2 * sigma(&exact) && sigma(&flags) > 0.015,
        "{} {}",
        sigma(&flags),
        sigma(&exact)
    );
    assert_eq!(sigma(&flags), sigma(&file));
}

/// A prior that is stated in the robot's file is that of `choose`, as it is that of `identify`.
#[test]
fn choose_takes_what_the_robots_file_states_of_stiffnesses() {
    let sandbox = Sandbox::new();
    write_measurements(&sandbox);
    let held_out = |percent: &str| {
        write_robot(&sandbox, 10.0 * STIFFNESS, &format!("compliance_percent = {percent}"));
        let ended = sandbox.run(["choose", "--model", ROBOT, "--measurements", "sag.csv", "--json"]);
        let models = ended.json()["models"].as_array().cloned().unwrap_or_default();
        let stiffness = models.iter().find(|model| model["key"] == "stiffness").cloned().unwrap_or_default();
        1e3 * stiffness["held_out_rms_m"].as_f64().unwrap_or_else(|| panic!("{ended:?}"))
    };
    let (tight, loose, unknown) = (held_out("10"), held_out("1000"), held_out("\"unknown\""));
    assert!(tight > 3.0 * loose && loose < 0.05 && unknown < 0.05, "{tight} {loose} {unknown}");
}
