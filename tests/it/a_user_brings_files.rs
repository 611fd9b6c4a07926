//! A user has files of a tracker's program and of a robot's log, and no wish to convert them.

use std::fmt::Write;

use calibrig::kinematics::target_in_base;
use calibrig::model::nalgebra::{Rotation3, Vector3};
use calibrig::model::{CraigLink, KinematicModel};

use crate::sandbox::{Ended, SCENARIO, Sandbox};

const ROBOT: &str = r#"schema = "calibrig.robot/1"
name = "two axes"
convention = "craig"
[[joint]]
name = "J1"
type = "revolute"
a_mm = 0
alpha_deg = 0
d_m = 0.7
theta_rad = 0
min_rad = -2.97
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
[actuators]
kind = "direct"
"#;

const MAP: &str = r#"schema = "calibrig.columns/1"
[joints]
columns = ["J1", "J2"]
revolute_unit = "deg"
[position]
system = "cartesian"
unit = "mm"
x = "X"
y = "Y"
z = "Z"
"#;

/// Three reflectors on the flange, m.
const TARGETS: [[f64; 3]; 3] = [[0.3, 0.1, 0.2], [0.1, 0.35, 0.05], [-0.1, 0.2, 0.3]];

/// Joints in deg, and where the tracker sees the targets, mm; the robot's lever arm is 0.4 mm longer than its file says.
fn session() -> Vec<([f64; 2], [Vector3<f64>; 3])> {
    let rounded = |value: f64, digits: f64| (value * digits).round() / digits;
    let links = vec![
        CraigLink::revolute("J1").row(0.0, 0.0, 0.7, 0.0),
        CraigLink::revolute("J2").row(0.1504, -90f64.to_radians(), 0.0, 0.0),
    ];
    let model = KinematicModel::new(links).expect("a robot");
    (0..24)
        .map(|k| {
            let k = f64::from(k);
            let joints = [rounded(-140.0 + 37.3 * k % 280.0, 1e3), rounded(-110.0 + 61.7 * k % 220.0, 1e3)];
            let command = joints.map(f64::to_radians);
            let turned = Rotation3::from_euler_angles(0.01, -0.02, 0.7);
            let seen = TARGETS.map(|target| {
                let in_base = target_in_base(&model, &command, &Vector3::from(target)).expect("a pose");
                let point = turned * in_base + Vector3::new(3.0, 0.4, 0.2);
                point.map(|metres| rounded(1e3 * metres, 1e4))
            });
            (joints, seen)
        })
        .collect()
}

/// A row of text for every pose.
fn text(head: &str, row: impl Fn(usize, &[f64; 2], &[Vector3<f64>; 3]) -> String) -> String {
    session().iter().enumerate().fold(head.to_owned(), |mut text, (k, (joints, seen))| {
        writeln!(text, "{}", row(k + 1, joints, seen)).expect("a text");
        text
    })
}

fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.write("r.toml", ROBOT);
    sandbox.write("map.toml", MAP);
    sandbox
}

fn one_file() -> String {
    text("J1,J2,X,Y,Z\n", |_, q, p| format!("{},{},{},{},{}", q[0], q[1], p[0].x, p[0].y, p[0].z))
}

#[track_caller]
fn rms(ended: &Ended, set: &str) -> f64 {
    assert_eq!(ended.code, Some(0), "{ended:?}");
    ended.json()["sets"][set]["rows"]["only_calibration"]["rms_3d_m"].as_f64().expect("a row")
}

/// Exact readings, rounded to 0.1 um: all that is left.
const EXACT: f64 = 2e-7;

const IDENTIFY: [&str; 5] = ["identify", "--model", "r.toml", "--json", "--measurements"];

#[test]
fn three_files_of_points_and_one_of_joints_are_one_session() {
    let sandbox = sandbox();
    let comma = |value: f64| format!("{value:.4}").replace('.', ",");
    sandbox.write(
        "joints.csv",
        text("Pose;J1 [deg];J2 [deg]\n", |k, q, _| format!("P{k};{};{}", comma(q[0]), comma(q[1]))),
    );
    for (index, name) in ["a", "b", "c"].iter().enumerate() {
        let rows = text("", |k, _, p| format!("P{k} {:.4} {:.4} {:.4}", p[index].x, p[index].y, p[index].z));
        sandbox.write(&format!("{name}.txt"), rows);
    }
    let map = "schema = \"calibrig.columns/1\"\n[joints]\ncolumns = [\"J1\", \"J2\"]\n[position]\nsystem = \"cartesian\"\nunit = \"mm\"\nx = 2\n\
               y = 3\nz = 4\n";
    let by_name = format!("{map}[join]\nby = \"name\"\njoints = \"Pose\"\npoints = 1\n");
    for map in [map.to_owned(), by_name] {
        sandbox.write("three.toml", &map);
        let rest = [
            "A=a.txt",
            "--measurements",
            "B=b.txt",
            "--measurements",
            "C=c.txt",
            "--joints",
            "joints.csv",
            "--columns",
            "three.toml",
        ];
        let ended = sandbox.run(IDENTIFY.iter().chain(&rest));
        assert!(rms(&ended, "identification") < EXACT, "{ended:?}");
        assert!(ended.stderr.contains("targets A, B, C: identified"), "{}", ended.stderr);
        assert!(ended.stderr.contains("a.txt and joints.csv are joined"), "{}", ended.stderr);
        assert_eq!(ended.json()["sets"]["identification"]["poses"], 24);
    }
}

#[test]
fn codes_of_missed_shots_are_named_on_the_command_line_or_in_the_map() {
    let sandbox = sandbox();
    let sound = one_file();
    let row = sound.lines().nth(5).expect("a row");
    let joints: Vec<_> = row.split(',').take(2).collect();
    sandbox.write("m.csv", sound.replace(row, &format!("{},-9999,-9999,-9999", joints.join(","))));
    let plain = sandbox.run(IDENTIFY.iter().chain(&["m.csv", "--columns", "map.toml"]));
    assert_eq!(plain.code, Some(1));
    assert!(
        plain.stderr.contains("m.csv:6: no point that the robot could reach")
            && plain.stderr.contains("--missed"),
        "{}",
        plain.stderr
    );
    let by_flag =
        sandbox.run(IDENTIFY.iter().chain(&["m.csv", "--columns", "map.toml", "--missed", "-9999"]));
    sandbox.write("coded.toml", MAP.replace("unit = \"mm\"", "unit = \"mm\"\nmissed = -9999"));
    let by_key = sandbox.run(IDENTIFY.iter().chain(&["m.csv", "--columns", "coded.toml"]));
    for ended in [by_flag, by_key] {
        assert!(rms(&ended, "identification") < EXACT);
        let why = ended.json()["sets"]["identification"]["dropped"][0]["why"]
            .as_str()
            .expect("a reason")
            .to_owned();
        assert_eq!(why, "missed shot: X is -9999 (m.csv:6)");
    }
}

#[test]
fn held_out_rows_stand_in_the_same_file() {
    let sandbox = sandbox();
    sandbox.write("m.csv", one_file());
    let ended =
        sandbox.run(IDENTIFY.iter().chain(&["m.csv", "--columns", "map.toml", "--verify-poses", "3..6,20"]));
    assert!(rms(&ended, "verification") < EXACT);
    let json = ended.json();
    assert_eq!(
        (&json["sets"]["verification"]["poses"], &json["sets"]["identification"]["poses"]),
        (&5.into(), &19.into())
    );
    let none =
        sandbox.run(IDENTIFY.iter().chain(&["m.csv", "--columns", "map.toml", "--verify-poses", "300"]));
    assert_eq!(none.code, Some(2), "{none:?}");
    let beyond = sandbox.run(IDENTIFY.iter().chain(&[
        "m.csv",
        "--columns",
        "map.toml",
        "--verify-poses",
        "20..30,99",
    ]));
    let said = format!("{}{}", beyond.stdout, beyond.stderr);
    assert!(said.contains("that no row has: 25..30, 99"), "{said}");
    let all =
        sandbox.run(IDENTIFY.iter().chain(&["m.csv", "--columns", "map.toml", "--verify-poses", "1..99"]));
    assert_eq!(all.code, Some(1));
    assert!(all.stderr.contains("all poses are held out"), "{}", all.stderr);
    let twice = ["m.csv", "--columns", "map.toml", "--verify-poses", "3", "--verify", "m.csv"];
    let twice = sandbox.run(IDENTIFY.iter().chain(&twice));
    assert_eq!(twice.code, Some(1));
    assert!(twice.stderr.contains("m.csv:4: this row is held out"), "{}", twice.stderr);
}

#[test]
fn a_suggested_map_is_used_as_it_is_and_never_written_over() {
    let sandbox = sandbox();
    // As a program in another country writes it, in Latin-1.
    let german = text("J1 [\u{b0}];J2 [\u{b0}];X [\u{b5}m];Y [mm];Z [mm]\n", |_, q, p| {
        format!("{};{};{:.1};{:.4};{:.4}", q[0], q[1], 1e3 * p[0].x, p[0].y, p[0].z).replace('.', ",")
    });
    let latin: Vec<u8> = german.chars().map(|c| u8::try_from(u32::from(c)).expect("Latin-1")).collect();
    sandbox.write("m.csv", latin);
    let suggested = sandbox.run(["columns", "suggest", "m.csv", "--out", "new.toml"]);
    assert_eq!((suggested.code, suggested.stdout.as_str()), (Some(0), ""), "{suggested:?}");
    let ended = sandbox.run(IDENTIFY.iter().chain(&["m.csv", "--columns", "new.toml"]));
    assert!(rms(&ended, "identification") < EXACT);
    assert!(ended.stderr.contains("m.csv:1: not UTF-8 (the byte 0xB0): read as Latin-1"), "{}", ended.stderr);
    let before = sandbox.read("new.toml");
    let again = sandbox.run(["columns", "suggest", "m.csv", "--out", "new.toml"]);
    assert_eq!((again.code, sandbox.read("new.toml")), (Some(1), before));
    assert!(again.stderr.contains("new.toml exists already"), "{}", again.stderr);
    // Where something is left to decide, that is the exit code, and the map is refused until it is decided.
    sandbox.write("m.csv", one_file().replace("J1,J2,X,Y,Z", "c1,c2,c3,c4,c5"));
    let open = sandbox.run(["columns", "suggest", "m.csv"]);
    assert_eq!(open.code, Some(3), "{open:?}");
    assert!(
        open.stdout.contains("# DECIDE: columns") && open.stderr.contains("to decide: columns"),
        "{open:?}"
    );
    sandbox.write("open.toml", &open.stdout);
    let refused = sandbox.run(IDENTIFY.iter().chain(&["m.csv", "--columns", "open.toml"]));
    assert!(refused.code == Some(1) && refused.stderr.contains("open.toml:"), "{refused:?}");
}

#[test]
fn repeats_say_what_no_model_can_do_better() {
    let sandbox = sandbox();
    let off = [[0.03, 0.0, 0.0], [-0.03, 0.0, 0.0], [0.0, 0.04, 0.0], [0.0, -0.04, 0.0]];
    let rows = text("No,J1,J2,X,Y,Z\n", |k, q, p| {
        let row = |o: &[f64; 3]| {
            format!("{k},{},{},{:.4},{:.4},{:.4}", q[0], q[1], p[0].x + o[0], p[0].y + o[1], p[0].z)
        };
        off.iter().map(row).collect::<Vec<_>>().join("\n")
    });
    sandbox.write("m.csv", rows);
    sandbox.write("numbered.toml", format!("{MAP}[columns]\npose = \"No\"\n"));
    let arguments = ["m.csv", "--columns", "numbered.toml"];
    let kept = sandbox.run(IDENTIFY.iter().chain(&arguments));
    assert_eq!(kept.code, Some(0), "{kept:?}");
    let repeats = &kept.json()["sets"]["identification"]["repeats"];
    assert_eq!((&repeats["poses"], &repeats["repeats"]), (&24.into(), &72.into()));
    // Two squares of 0.03 and two of 0.04 mm a pose, over three degrees of freedom.
    let expected = (0.005_f64 / 3.0).sqrt() * 1e-3;
    assert!(
        (repeats["rms_3d_m"].as_f64().expect("a number") - expected).abs() < 1e-6 * expected,
        "{repeats}"
    );
    let shown = sandbox.run(["identify", "--model", "r.toml", "--measurements"].iter().chain(&arguments));
    assert!(shown.stdout.contains("repeats of 24 poses scatter by 0.041 mm"), "{}", shown.stdout);
    let averaged = sandbox.run(IDENTIFY.iter().chain(&arguments).chain(&["--average-repeats"]));
    assert!(rms(&averaged, "identification") < EXACT);
    assert!(averaged.stderr.contains("96 readings are averaged to 24"), "{}", averaged.stderr);
}

#[test]
fn a_scenario_takes_its_regions_in_either_unit() {
    let sandbox = Sandbox::new();
    let before = sandbox.run(["check", SCENARIO]);
    assert_eq!(before.code, Some(0), "{before:?}");
    let changed = |line: &str| {
        for (key, other, factor) in [("_rad = ", "_deg", 1f64.to_degrees()), ("_mm = ", "_m", 1e-3)] {
            for stem in ["centre", "half_width"] {
                if let Some(value) = line.strip_prefix(&format!("{stem}{key}")) {
                    let value: f64 =
                        value.split('#').next().unwrap_or_default().trim().parse().expect("a number");
                    return format!("{stem}{other} = {}", value * factor);
                }
            }
        }
        line.to_owned()
    };
    let text = sandbox.read(SCENARIO);
    let lines: Vec<String> = text.lines().map(changed).collect();
    let count = lines.iter().zip(text.lines()).filter(|(new, old)| new != old).count();
    assert_eq!(count, 14, "two for each of seven joints");
    sandbox.write(SCENARIO, lines.join("\n"));
    let after = sandbox.run(["check", SCENARIO]);
    assert_eq!((after.code, after.stdout), (Some(0), before.stdout));
}

/// Three shots at every stop, without a column that numbers the poses: what they share is not counted three times.
#[test]
fn rows_of_one_stop_are_one_pose() {
    let sandbox = sandbox();
    let shots = |numbered: bool| {
        let head = if numbered { "No,J1,J2,X,Y,Z\n" } else { "J1,J2,X,Y,Z\n" };
        text(head, |k, q, p| {
            // Of the stop, and of each shot.
            let shared = if k % 2 == 0 { 0.2 } else { -0.2 };
            let row = |off: f64| {
                let number = if numbered { format!("{k},") } else { String::new() };
                format!(
                    "{number}{},{},{:.4},{:.4},{:.4}",
                    q[0],
                    q[1],
                    p[0].x + shared + off,
                    p[0].y,
                    p[0].z - off
                )
            };
            [-0.01, 0.0, 0.01].map(row).join("\n")
        })
    };
    sandbox.write("plain.csv", shots(false));
    sandbox.write("numbered.csv", shots(true));
    sandbox.write("numbered.toml", format!("{MAP}[columns]\npose = \"No\"\n"));
    let plain = sandbox.run(IDENTIFY.iter().chain(&["plain.csv", "--columns", "map.toml"]));
    let numbered = sandbox.run(IDENTIFY.iter().chain(&["numbered.csv", "--columns", "numbered.toml"]));
    assert!(
        plain.stderr.contains("rows with the same command are one pose: 24 poses from 72 rows"),
        "{}",
        plain.stderr
    );
    let sigmas = |ended: &Ended| {
        let json = ended.json();
        let parameters = json["parameters"].as_array().expect("a list").clone();
        parameters.iter().map(|p| p["sigma"].as_f64().unwrap_or(0.0)).collect::<Vec<_>>()
    };
    assert_eq!(sigmas(&plain), sigmas(&numbered));
}

/// A session that was held out is no longer the robot's: every point 5 mm beside, along one axis of the tracker.
#[test]
fn a_held_out_set_beside_its_intervals_is_a_reason_to_look() {
    let sandbox = sandbox();
    let points = |off: f64| {
        text("J1,J2,X,Y,Z\n", |_, q, p| {
            format!("{},{},{:.4},{:.4},{:.4}", q[0], q[1], p[0].x + off, p[0].y, p[0].z)
        })
    };
    sandbox.write("m.csv", points(0.0));
    sandbox.write("moved.csv", points(5.0));
    for (file, code) in [("m.csv", 0), ("moved.csv", 3)] {
        let ended = sandbox.run(IDENTIFY.iter().chain(&["m.csv", "--columns", "map.toml", "--verify", file]));
        assert_eq!(ended.code, Some(code), "{ended:?}");
        let estimate = &ended.json()["estimates"]["only_calibration"];
        assert_eq!(estimate["status"], if code == 0 { "ok" } else { "held_out" }, "{}", ended.stdout);
    }
}

/// The map that was given beside the robot's file goes into the recording, which is read back without it.
#[test]
fn a_recording_of_files_with_a_map_is_read_back() {
    let sandbox = sandbox();
    sandbox.write("m.csv", one_file());
    let exported = [
        "export",
        "mcap",
        "--model",
        "r.toml",
        "--measurements",
        "m.csv",
        "--columns",
        "map.toml",
        "--out",
        "m.mcap",
    ];
    assert_eq!(sandbox.run(exported).code, Some(0));
    let replayed = sandbox.run(["replay", "m.mcap"]);
    assert_eq!(replayed.code, Some(0), "{replayed:?}");
}
