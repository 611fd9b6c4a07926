//! A probe, a camera or motion capture sees place and rotation of a target: its export becomes a map, a recording and text again, and what is
//! no pose is refused where it stands.

use crate::sandbox::{Sandbox, assert_refused};
use std::fmt::Write;

const UR5: &str = "models/ur5/robot.toml";

/// Rows of a probe's export: name, place in mm, quaternion with the scalar first, commands in deg.
fn export() -> String {
    let mut text = "Point;TMac_X [mm];TMac_Y [mm];TMac_Z [mm];Q0;Q1;Q2;Q3;J1;J2;J3;J4;J5;J6\n".to_owned();
    for row in 1..=12 {
        let k = f64::from(row);
        let (half, angle) = (0.02 * k, |joint: i32| 120.0 * (1.3 * k + 0.7 * f64::from(joint)).sin());
        let place =
            [2500.0 + 400.0 * k.sin(), 500.0 * (2.0 * k).cos() - 700.0, 900.0 + 300.0 * (3.0 * k).sin()];
        let turn = [half.cos(), 0.36 * half.sin(), 0.48 * half.sin(), 0.8 * half.sin()];
        write!(text, "P{row}").expect("in memory");
        for number in place.into_iter().chain(turn).chain((1..=6).map(angle)) {
            write!(text, ";{number:.6}").expect("in memory");
        }
        text.push('\n');
    }
    text
}

const SESSION: &str = "schema = \"calibrig.session/1\"\n[[station]]\nname = \"front\"\n[station.instrument]\nname = \"AT 1\"\n\
    collimation_urad = 2.5\nrange_offset_um = 5\n[[target]]\nname = \"probe\"\nin_flange_m = [0, 0, 0.1]\nrotation_euler_deg = [90, 0, 0]\n\
    rotation_sequence = \"zyx intrinsic\"\nrotation_sigma_mrad = 1\n";

/// The map that is suggested for the export, with its open decisions filled in.
fn decided(sandbox: &Sandbox) -> String {
    let ended = sandbox.run(["columns", "suggest", "tmac.csv", "--out", "open.toml"]);
    assert_eq!(ended.code, Some(3), "{ended:?}");
    let open = sandbox.read("open.toml");
    let mut decided = String::new();
    let mut decisions = Vec::new();
    for line in open.lines() {
        match line.strip_prefix("# DECIDE: ") {
            Some(decision) => {
                decisions.push(decision.split(' ').next().unwrap_or_default().to_owned());
                decided.push_str(decision);
            }
            None => decided.push_str(line),
        }
        decided.push('\n');
    }
    assert_eq!(decisions, ["transform", "order"], "{open}");
    decided
}

#[test]
fn a_probes_export_becomes_a_recording_and_text_again() {
    let sandbox = Sandbox::new();
    sandbox.write("tmac.csv", export());
    sandbox.write("session.toml", SESSION);
    let map = decided(&sandbox);
    sandbox.write("map.toml", map);
    let record = [
        "export",
        "mcap",
        "--model",
        UR5,
        "--measurements",
        "tmac.csv",
        "--columns",
        "map.toml",
        "--session",
        "session.toml",
        "--out",
        "r.mcap",
    ];
    // A map with an open decision is refused at its line, as long as it is one.
    let undecided = record.map(|argument| if argument == "map.toml" { "open.toml" } else { argument });
    let line = sandbox.read("open.toml").lines().position(|line| line.starts_with("# DECIDE: transform"));
    let place = format!("open.toml:{}", line.expect("open") + 1);
    assert_refused(&sandbox, &undecided, &place, "transform is still to be decided", "with the right value");
    let ended = sandbox.run(record);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let inspected = sandbox.run(["inspect", "r.mcap", "--json"]).json();
    let set = &inspected["sets"][0];
    assert_eq!((set["observations"].as_u64(), set["full_poses"].as_u64()), (Some(12), Some(12)), "{set}");
    let ended = sandbox.run(["export", "csv", "r.mcap", "--out", "tables"]);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let table = sandbox.read("tables/identification.csv");
    let mut rows = table.lines();
    let header: Vec<&str> = rows.next().expect("a header").split(',').collect();
    let at = |name: &str| {
        header.iter().position(|column| *column == name).unwrap_or_else(|| panic!("{name}: {header:?}"))
    };
    for (row, line) in (1..=12).zip(rows) {
        let cells: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap_or(f64::NAN)).collect();
        let trace = cells[at("r11")] + cells[at("r22")] + cells[at("r33")];
        let angle = (0.5 * (trace - 1.0)).acos();
        // The quaternion of the export has six decimals.
        assert!((angle - 0.04 * f64::from(row)).abs() < 1e-4, "row {row}: {angle}");
        assert!(
            (cells[at("x_m")] - 1e-3 * (2500.0 + 400.0 * f64::from(row).sin())).abs() < 1e-8,
            "row {row}"
        );
    }
    let session = sandbox.read("tables/session.toml");
    for part in [
        "[station.instrument]",
        "name = \"AT 1\"",
        "range_offset_m = 5e-6",
        "rotation_matrix = [[",
        "rotation_covariance_rad2 = [[",
    ] {
        assert!(session.contains(part), "{part}\n{session}");
    }
}

#[test]
fn what_is_no_pose_is_refused_at_its_row() {
    let sandbox = Sandbox::new();
    sandbox.write("tmac.csv", export());
    let map = decided(&sandbox);
    sandbox.write("map.toml", &map);
    let record = [
        "export",
        "mcap",
        "--model",
        UR5,
        "--measurements",
        "bad.csv",
        "--columns",
        "map.toml",
        "--out",
        "r.mcap",
    ];
    let changed = |cells: [&str; 4]| {
        let lines = export().lines().enumerate().fold(String::new(), |mut text, (index, line)| {
            let mut all: Vec<&str> = line.split(';').collect();
            if index == 5 {
                all[4..8].copy_from_slice(&cells);
            }
            text.push_str(&all.join(";"));
            text.push('\n');
            text
        });
        sandbox.write("bad.csv", lines);
    };
    for (cells, message, expected) in [
        (
            ["0", "0", "0", "0"],
            "the quaternion has length 0 (columns Q0, Q1, Q2, Q3)",
            "a quaternion of length 1",
        ),
        (
            ["0.9", "0.1", "0", "0"],
            "the quaternion has length 0.905539, which differs from 1 by 9.4e-2",
            "a quaternion of length 1",
        ),
        (["", "", "", ""], "the rotation is empty (Q0, Q1, Q2, Q3)", "a rotation in every row"),
    ] {
        changed(cells);
        assert_refused(&sandbox, &record, "bad.csv:6", message, expected);
    }
    // Without [rotation] the same file is one of points.
    let points: String =
        map.split("# If the rotation is not wanted").next().expect("in front of it").to_owned();
    sandbox.write("map.toml", points);
    let ended = sandbox.run(record);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let inspected = sandbox.run(["inspect", "r.mcap", "--json"]).json();
    assert_eq!(inspected["sets"][0]["full_poses"].as_u64(), Some(0));
}
