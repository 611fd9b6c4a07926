//! Controllers count their axes with other signs, zeros and units than the table, and couple them; the robot's file says how.

use std::fmt::Write;

use calibrig::files::{Source as Text, parse_robot};
use calibrig::kinematics::{command_from_joints, forward_kinematics};
use calibrig::model::JointKind;
use calibrig::model::random::{StreamSource, stream};
use nalgebra::Vector3;
use rand::RngExt;
use serde_json::Value;

use crate::sandbox::Sandbox;

/// A rail, a turntable on it and an arm.
const ROWS: [(&str, &str, [f64; 4], [f64; 2]); 8] = [
    ("E1", "prismatic", [0.0, 0.0, 0.0, 0.0], [0.0, 3000.0]),
    ("E2", "revolute", [120.0, 90.0, 150.0, 20.0], [-170.0, 170.0]),
    ("J1", "revolute", [300.0, 90.0, 400.0, 0.0], [-160.0, 160.0]),
    ("J2", "revolute", [150.0, -90.0, 0.0, -90.0], [-60.0, 120.0]),
    ("J3", "revolute", [700.0, 0.0, 0.0, 0.0], [-80.0, 160.0]),
    ("J4", "revolute", [130.0, -90.0, 720.0, 0.0], [-180.0, 180.0]),
    ("J5", "revolute", [0.0, 90.0, 0.0, 0.0], [-120.0, 120.0]),
    ("J6", "revolute", [0.0, -90.0, 110.0, 0.0], [-300.0, 300.0]),
];

fn robot(shown: impl Fn(&str) -> &'static str, actuators: &str) -> String {
    let mut text = "schema = \"calibrig.robot/1\"\nname = \"cell\"\nconvention = \"craig\"\n".to_owned();
    for (name, kind, [a, alpha, d, theta], [low, high]) in ROWS {
        let unit = if kind == "prismatic" { "mm" } else { "deg" };
        let _ = write!(
            text,
            "[[joint]]\nname = \"{name}\"\ntype = \"{kind}\"\na_mm = {a}\nalpha_deg = {alpha}\nd_mm = {d}\ntheta_deg = {theta}\n\
             min_{unit} = {low}\nmax_{unit} = {high}\n{}\n",
            shown(name)
        );
    }
    text + "[actuators]\n" + actuators
}

const DIRECT: &str = "kind = \"direct\"\n";
const PARALLELOGRAM: &str = "kind = \"parallelogram\"\nshoulder = \"J2\"\nelbow = \"J3\"\noffset_deg = 0\n";
const FOUR_BAR: &str = "kind = \"parallelogram\"\nshoulder = \"J2\"\nelbow = \"J3\"\noffset_deg = -60\n[actuators.linkage]\ncrank_mm = 300\nlever_mm = 302\nrod_mm = 703\nangle_deg = 180\n";

/// What a controller that counts as the robot's file says shows at poses, and where the target is seen then, with 20 um of noise.
fn session(text: &str, poses: u32) -> String {
    let robot = parse_robot(Text::new("robot.toml", text), None, None).expect("a robot").model;
    let mut random = stream(31, 0, StreamSource::AsBuilt);
    let mut file = String::new();
    for (number, link) in (1..).zip(&robot.kinematics.links) {
        let unit = if link.kind == JointKind::Revolute { "rad" } else { "m" };
        let _ = write!(file, "q{number}_{unit},");
    }
    file += "x_m,y_m,z_m\n";
    let mut done = 0;
    while done < poses {
        let links = robot.kinematics.links.iter();
        let joints: Vec<f64> =
            links.map(|link| random.random_range(link.limits[0]..link.limits[1])).collect();
        // Where a four-bar cannot go, nothing is measured.
        let Ok(shown) = command_from_joints(&robot.kinematics, &robot.actuators, &joints) else { continue };
        let flange = forward_kinematics(&robot.kinematics, &joints).expect("a pose");
        let point = flange.rotation * Vector3::new(0.1, 0.05, 0.15) + flange.translation.vector;
        for value in shown {
            let _ = write!(file, "{value},");
        }
        let seen = point.map(|value| {
            value + 2.0 + 14e-6 * (random.random_range(-1.0..1.0) + random.random_range(-1.0..1.0))
        });
        let _ = writeln!(file, "{},{},{}", seen.x, seen.y, seen.z);
        done += 1;
    }
    file
}

/// Exit code, and RMS (m) of the nominal robot and of the calibrated one.
fn identified(robot: &str, measurements: &str) -> (Option<i32>, Option<[f64; 2]>) {
    let sandbox = Sandbox::new();
    sandbox.write("cell.toml", robot);
    sandbox.write("m.csv", measurements);
    let ended = sandbox.run(["identify", "--json", "--model", "cell.toml", "--measurements", "m.csv"]);
    let rows = serde_json::from_str::<Value>(&ended.stdout).ok();
    let rms = |report: &Value, row: &str| report["sets"]["identification"]["rows"][row]["rms_3d_m"].as_f64();
    let both = rows
        .and_then(|report| Some([rms(&report, "without_calibration")?, rms(&report, "only_calibration")?]));
    (ended.code, both)
}

#[test]
fn what_the_file_says_of_the_axes_is_what_the_controller_shows() {
    let fanuc = |name: &str| if name == "J3" { "[joint.shown]\ncoupling = { J2 = -1 }" } else { "" };
    let wrist = |name: &str| match name {
        "E1" => "[joint.shown]\nsign = -1\noffset_mm = 1500",
        "E2" => "[joint.shown]\nratio = 80",
        "J2" => "[joint.shown]\noffset_deg = 90",
        "J5" => "[joint.shown]\nsign = -1\ncoupling = { J4 = 0.01 }",
        "J6" => "[joint.shown]\ncoupling = { J4 = 0.02, J5 = -0.5 }",
        _ => "",
    };
    let palletizer = |name: &str| match name {
        "J2" => "[joint.shown]\nsign = -1\noffset_deg = 90",
        "J3" => "[joint.shown]\nsign = -1\nratio = 1.5",
        _ => "",
    };
    for (what, text) in [
        ("the third axis against the horizontal", robot(fanuc, DIRECT)),
        ("signs, zeros, a ratio and a coupled wrist", robot(wrist, DIRECT)),
        ("a parallelogram", robot(palletizer, PARALLELOGRAM)),
        ("a four-bar", robot(palletizer, FOUR_BAR)),
    ] {
        let measurements = session(&text, 80);
        let (code, rms) = identified(&text, &measurements);
        let [nominal, calibrated] = rms.unwrap_or([f64::NAN; 2]);
        assert_eq!(code, Some(0), "{what}");
        // 14 um twice uniform: 11.4 um an axis, 20 um in 3-D.
        assert!(nominal < 25e-6 && calibrated < 20e-6, "{what}: {nominal} {calibrated}");
        // Without it the robot does not lie on the points.
        let (code, _) = identified(&robot(|_| "", DIRECT), &measurements);
        assert_eq!(code, Some(1), "{what}");
    }
}
