//! A robot as vendors describe it becomes a model: the kinematics are those that another reader of URDFs has.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use calibrig::files::{Robot, UrdfOptions, robot_from_urdf};
use calibrig::files::{Source as Text, load_robot};
use calibrig::kinematics::{forward_kinematics, joints_from_command};
use calibrig::model::random::{StreamSource, stream};
use rand::RngExt;
use serde_json::{Value, json};

use crate::sandbox::Sandbox;

const FOLDER: &str = "tests/fixtures/urdf";

/// Base and tip where the file does not have one chain.
fn ends(name: &str) -> (Option<&'static str>, Option<&'static str>) {
    match &name[..2] {
        "01" => (Some("base"), Some("tool0")),
        "03" | "06" => (Some("base"), None),
        "08" => (None, Some("panda_hand_tcp")),
        "13" => (Some("left_hand"), Some("right_hand")),
        _ => (None, None),
    }
}

fn fixtures() -> Vec<PathBuf> {
    let entries = std::fs::read_dir(FOLDER).expect("the fixtures").map(|entry| entry.expect("a file").path());
    let mut files: Vec<_> =
        entries.filter(|path| path.extension().is_some_and(|ext| ext == "urdf")).collect();
    files.sort();
    files
}

/// What the other reader has for the tips: a matrix a pose, of every question.
pub fn asked(questions: &Value) -> Option<Vec<Vec<Vec<f64>>>> {
    let python = || Command::new("python3");
    let has = python().args(["-c", "import yourdfpy"]).output();
    if !has.is_ok_and(|output| output.status.success()) {
        eprintln!("SKIPPED: no python3 with yourdfpy (pip install yourdfpy)");
        return None;
    }
    let mut child = python()
        .arg("tests/tools/urdf_poses.py")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("it starts");
    serde_json::to_writer(child.stdin.take().expect("piped"), questions).expect("it reads");
    let output = child.wait_with_output().expect("it ends");
    assert!(output.status.success());
    Some(serde_json::from_slice(&output.stdout).expect("matrices"))
}

/// Twenty files, a thousand poses each.
#[test]
fn vendors_urdfs_move_as_another_reader_has_them() {
    let sandbox = Sandbox::new();
    let mut robots: Vec<(Robot, Vec<Vec<f64>>)> = Vec::new();
    let mut questions = Vec::new();
    for (number, path) in (0..).zip(fixtures()) {
        let name = path.file_stem().expect("a name").to_string_lossy().into_owned();
        let (base, tip) = ends(&name);
        let folder = sandbox.path(&name);
        let mut command = Command::new(env!("CARGO_BIN_EXE_calibrig"));
        command.args(["model", "from-urdf", "--json", "--out"]).arg(&folder).arg(&path);
        command.args(base.map(|base| ["--base", base]).into_iter().flatten());
        command.args(tip.map(|tip| ["--tip", tip]).into_iter().flatten());
        let output = command.output().expect("the binary runs");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{name}: {said}");
        assert!(said.contains("ignored: "), "{name}: {said}");
        let document: Value = serde_json::from_slice(&output.stdout).expect("a calibrig.model/1 document");
        assert!(document["largest_difference_m"].as_f64().expect("compared") <= 1e-10, "{name}: {document}");

        let robot = load_robot(&folder.join("robot.toml")).expect("as written");
        let (links, actuators) = (&robot.model.kinematics.links, &robot.model.actuators);
        let mut random = stream(12, number, StreamSource::AsBuilt);
        let commands: Vec<Vec<f64>> = (0..1000)
            .map(|_| {
                let joint = |(joint, link): (usize, &calibrig::model::CraigLink)| {
                    let [low, high] = link.limits;
                    let commanded = actuators.is_commanded(joint);
                    if commanded { random.random_range(low..high) } else { 0.0 }
                };
                links.iter().enumerate().map(joint).collect()
            })
            .collect();
        let pose = |command: &Vec<f64>| -> Value {
            let named = links.iter().zip(command).enumerate();
            let commanded = named.filter(|(joint, _)| actuators.is_commanded(*joint));
            commanded
                .map(|(_, (link, q))| (link.name.clone(), json!(q)))
                .collect::<serde_json::Map<_, _>>()
                .into()
        };
        // The ends, as the file names what it did not ask for.
        let text = std::fs::read_to_string(folder.join("robot.toml")).expect("as written");
        let head = text.lines().next().expect("a comment").trim_end_matches('.');
        let (base, tip) =
            head.split_once("from link ").and_then(|(_, ends)| ends.split_once(" to link ")).expect("ends");
        questions.push(json!({
            "file": path.display().to_string(), "base": base, "tip": tip, "poses": commands.iter().map(pose).collect::<Vec<_>>(),
        }));
        robots.push((robot, commands));
    }
    assert_eq!(robots.len(), 20);
    let Some(answers) = asked(&Value::from(questions.clone())) else { return };
    for ((question, answers), (robot, commands)) in questions.iter().zip(answers).zip(&robots) {
        let mut worst = 0.0_f64;
        assert_eq!(answers.len(), 1000);
        for (matrix, command) in answers.iter().zip(commands) {
            let model = &robot.model;
            let mut joints = vec![0.0; command.len()];
            joints_from_command(&model.kinematics, &model.actuators, command, &mut joints).expect("a pose");
            let found = forward_kinematics(&model.kinematics, &joints).expect("a pose").to_homogeneous();
            for row in 0..3 {
                for column in 0..4 {
                    worst = worst.max((found[(row, column)] - matrix[4 * row + column]).abs());
                }
            }
        }
        println!("{}: {worst:.1e} m", question["file"]);
        assert!(worst <= 1e-10, "{}: {worst:e}", question["file"]);
    }
}

/// Measured by the URDF alone: what the tip's target would be seen at, in another frame.
fn measured(file: &Path, options: &UrdfOptions, poses: u32, noise: f64) -> (Robot, String) {
    let robot = robot_from_urdf(&Text::read(file).expect("a fixture"), options).expect("a chain").robot;
    let model = &robot.model;
    let mut random = stream(3, 1, StreamSource::AsBuilt);
    let columns: Vec<String> = model
        .kinematics
        .links
        .iter()
        .enumerate()
        .filter(|(joint, _)| model.actuators.is_commanded(*joint))
        .zip(1..)
        .map(|((_, link), number)| {
            let unit = if link.kind == calibrig::model::JointKind::Revolute { "rad" } else { "m" };
            format!("q{number}_{unit}")
        })
        .collect();
    let mut text = format!("{},x_m,y_m,z_m\n", columns.join(","));
    for _ in 0..poses {
        let mut command = Vec::new();
        for (joint, link) in model.kinematics.links.iter().enumerate() {
            let [low, high] = link.limits;
            command.push(if model.actuators.is_commanded(joint) {
                random.random_range(low..high)
            } else {
                0.0
            });
        }
        let mut joints = vec![0.0; command.len()];
        joints_from_command(&model.kinematics, &model.actuators, &command, &mut joints).expect("a pose");
        let flange = forward_kinematics(&model.kinematics, &joints).expect("a pose");
        let point = flange.rotation * nalgebra::Vector3::new(0.1, -0.05, 0.12) + flange.translation.vector;
        let seen: Vec<f64> = [point.y - 4.0, -point.x + 1.0, point.z + 0.5]
            .iter()
            .map(|value| value + noise * (random.random_range(-1.0..1.0) + random.random_range(-1.0..1.0)))
            .collect();
        let commanded = command.iter().enumerate().filter(|(joint, _)| model.actuators.is_commanded(*joint));
        let numbers: Vec<String> =
            commanded.map(|(_, value)| *value).chain(seen).map(|value| value.to_string()).collect();
        text += &numbers.join(",");
        text.push('\n');
    }
    (robot, text)
}

/// Without a file between: a rail, a gantry, a positioner, followers, and both of hands. All fit to the noise.
#[test]
fn robots_of_all_kinds_are_calibrated_from_their_urdf_alone() {
    for (name, base, tip) in [
        ("11_gantry", None, None),
        ("12_rail_and_robot", None, None),
        ("14_palletizer", None, None),
        ("15_positioner", None, None),
        ("13_two_arms", Some("left_hand"), Some("right_hand")),
        ("04_industrial_negative_axes", None, Some("cell_tool0")),
        ("02_cobot_along_y", None, None),
        ("05_elbow_against_horizontal", None, None),
        ("09_continuous_joints", None, None),
        ("10_scara", None, None),
        ("20_cable_arm", None, None),
    ] {
        let file = Path::new(FOLDER).join(name).with_extension("urdf");
        let options = UrdfOptions {
            base: base.map(str::to_owned),
            tip: tip.map(str::to_owned),
            ..UrdfOptions::default()
        };
        let (_, text) = measured(&file, &options, 60, 20e-6);
        let sandbox = Sandbox::new();
        sandbox.write("m.csv", &text);
        let mut command = Command::new(env!("CARGO_BIN_EXE_calibrig"));
        command.args(["identify", "--json", "--mode", "only_calibration", "--urdf"]).arg(&file);
        command.args(base.map(|base| ["--base", base]).into_iter().flatten());
        command.args(tip.map(|tip| ["--tip", tip]).into_iter().flatten());
        let output =
            command.arg("--measurements").arg(sandbox.path("m.csv")).output().expect("the binary runs");
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{name}: {said}");
        let report: Value = serde_json::from_slice(&output.stdout).expect("a report");
        let rows = &report["sets"]["identification"]["rows"];
        for row in ["without_calibration", "only_calibration"] {
            // Uniform sums of that size have 16 um an axis.
            let rms = rows[row]["rms_3d_m"].as_f64().expect("a number");
            assert!(rms < 40e-6, "{name}: {row} {rms}");
        }
    }
}

/// What was there is not written over; what is refused leaves nothing.
#[test]
fn a_robot_file_is_never_written_over_unasked() {
    let sandbox = Sandbox::new();
    sandbox.write("arm.urdf", include_str!("../fixtures/urdf/10_scara.urdf"));
    let made = ["model", "from-urdf", "arm.urdf", "--out", "arm"];
    let ended = sandbox.run(made);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert!(ended.stdout.starts_with("arm/robot.toml: scara_400, 4 joints, at most "), "{ended:?}");
    sandbox.write("arm/robot.toml", "mine");
    let ended = sandbox.run(made);
    assert_eq!((ended.code, sandbox.read("arm/robot.toml").as_str()), (Some(1), "mine"));
    assert!(
        ended.stderr.contains("robot.toml is there already") && ended.stderr.contains("--force"),
        "{ended:?}"
    );
    let ended = sandbox.run(made.iter().copied().chain(["--force"]));
    assert_eq!(ended.code, Some(0));
    assert!(sandbox.read("arm/robot.toml").contains("[joint.body]"));

    sandbox.write(
        "arm.urdf.xacro",
        "<robot name=\"a\" xmlns:xacro=\"http://www.ros.org/wiki/xacro\"><xacro:arm/></robot>",
    );
    let ended = sandbox.run(["model", "from-urdf", "arm.urdf.xacro", "--out", "new"]);
    assert_eq!(ended.code, Some(1));
    assert!(ended.stderr.contains("run `xacro arm.urdf.xacro > arm.urdf`"), "{ended:?}");
    assert!(!sandbox.path("new").exists());
}

#[test]
fn a_table_of_a_manual_is_calibrated() {
    let sandbox = Sandbox::new();
    sandbox.write(
        "ur.csv",
        "name,a_mm,alpha_deg,d_mm,theta_deg\nbase,0,90,89.159,q1\nshoulder,-425,0,0,q2\nelbow,-392.25,0,0,q3\nwrist 1,0,90,109.15,q4\n\
         wrist 2,0,-90,94.65,q5\nwrist 3,0,0,82.3,q6\n",
    );
    let ended = sandbox.run([
        "model",
        "from-dh",
        "ur.csv",
        "--convention",
        "standard",
        "--out",
        "ur",
        "--target-mm",
        "50,20,60",
    ]);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert!(ended.stderr.contains("assumed: limits of base, shoulder"), "{ended:?}");
    let made = load_robot(&sandbox.path("ur/robot.toml")).expect("as written");
    let known = load_robot(Path::new("models/ur5/robot.toml")).expect("the model of the repository");
    for q in [[0.1, -1.0, 0.7, 2.0, -0.4, 1.3], [2.0, 0.3, -1.2, 0.6, 1.5, -2.2]] {
        let [one, other] =
            [&made, &known].map(|robot| forward_kinematics(&robot.model.kinematics, &q).expect("a pose"));
        assert!((one.to_homogeneous() - other.to_homogeneous()).norm() < 1e-14);
    }
    let ended = sandbox.run(["identifiability", "--model", "ur/robot.toml"]);
    assert_eq!(ended.code, Some(0), "{ended:?}");
}

/// A robot without masses has no gravity modes; asked for one, the command says why.
#[test]
fn gravity_without_masses_is_refused_where_it_is_asked_for() {
    let file = Path::new(FOLDER).join("04_industrial_negative_axes.urdf");
    let (_, text) = measured(
        &file,
        &UrdfOptions { tip: Some("cell_tool0".to_owned()), ..UrdfOptions::default() },
        40,
        2e-5,
    );
    let sandbox = Sandbox::new();
    sandbox.write("m.csv", &text);
    let mut command = Command::new(env!("CARGO_BIN_EXE_calibrig"));
    command.args(["identify", "--mode", "with_gravity", "--tip", "cell_tool0", "--urdf"]).arg(&file);
    let output = command.arg("--measurements").arg(sandbox.path("m.csv")).output().expect("the binary runs");
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("no mass: links cell_link_1, cell_link_2") && said.contains("masses"), "{said}");
}

/// A recording of a robot with followers is a file of text without their columns, and back.
#[test]
fn followers_have_no_columns_in_files() {
    let file = Path::new(FOLDER).join("14_palletizer.urdf");
    let (_, text) = measured(&file, &UrdfOptions::default(), 30, 2e-5);
    let sandbox = Sandbox::new();
    sandbox.write("m.csv", &text);
    sandbox.write("palletizer.urdf", std::fs::read_to_string(&file).expect("a fixture"));
    let ended = sandbox.run([
        "export",
        "mcap",
        "--urdf",
        "palletizer.urdf",
        "--measurements",
        "m.csv",
        "--out",
        "m.mcap",
    ]);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let ended = sandbox.run(["export", "csv", "m.mcap", "--out", "tables"]);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let header = sandbox.read("tables/identification.csv");
    let header = header.lines().next().expect("a header");
    assert!(header.contains("q4_rad") && !header.contains("q5_rad"), "{header}");
    let ended = sandbox.run([
        "identify",
        "--urdf",
        "palletizer.urdf",
        "--measurements",
        "tables/identification.csv",
        "--mode",
        "only_calibration",
    ]);
    assert_eq!(ended.code, Some(0), "{ended:?}");
}
