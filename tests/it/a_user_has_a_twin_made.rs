//! Whoever brings a robot gets its simulated twin with one command: it is checked, runs, repeats and replays.

use std::f64::consts::FRAC_PI_2;
use std::fmt::Write;
use std::fs;
use std::path::Path;

use calibrig::model::CrankAxis;
use calibrig::model::visibility::stance_at;
use calibrig::nalgebra::Vector3;
use calibrig::random::{StreamSource, stream};
use calibrig::scenario::{Scenario, load_scenario};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::repeated;
use crate::sandbox::{Ended, Sandbox, assert_refused};

/// The robots of the repository, by the folder of each.
fn zoo() -> Vec<String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("models");
    let entries = fs::read_dir(folder).expect("the models").map(|entry| entry.expect("a folder").path());
    let with_robot = entries.filter(|path| path.join("robot.toml").is_file());
    let mut names: Vec<_> =
        with_robot.map(|path| path.file_name().expect("a name").to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

fn made(sandbox: &Sandbox, model: &str, out: &str, more: &[&str]) -> Ended {
    let ended = sandbox.run([&["scenario", "new", "--model", model, "--out", out], more].concat());
    assert_eq!(ended.code, Some(0), "{model}: {ended:?}");
    ended
}

/// As many poses as a test can wait for.
fn shorten(sandbox: &Sandbox, scenario: &str, poses: [u32; 2]) {
    let [fitted, held_out] = poses.map(|poses| poses.to_string());
    sandbox.replace_line(scenario, "[poses]", "identification = ", &format!("identification = {fitted}"));
    sandbox.replace_line(scenario, "[poses]", "verification = ", &format!("verification = {held_out}"));
}

/// Done, or with a reason to look at it.
#[track_caller]
fn assert_told(ended: &Ended, what: &str) {
    let has_reason = ended.stderr.lines().any(|line| line.starts_with("doubtful: "));
    let sound = ended.code == Some(0) || ended.code == Some(3) && has_reason;
    assert!(sound, "{what} ended with {:?}: {}", ended.code, ended.stderr);
}

/// No pose that can be drawn has the target below the floor, or out of the limits.
fn check_region(scenario: &Scenario, name: &str) {
    let model = &scenario.robot.model;
    let sight = scenario.plan.sight.as_ref().expect("lines of sight");
    let mut rng = stream(9, 0, StreamSource::Twin);
    for _ in 0..400 {
        let mut joints = scenario.region.draw(&mut rng);
        let command = model.actuators.command_from_joints(&joints);
        model.actuators.joints_from_command(&command, &mut joints);
        for (q, link) in joints.iter().zip(&model.kinematics.links) {
            assert!((link.limits[0]..=link.limits[1]).contains(q), "{name}: {} at {q}", link.name);
        }
        let (_, flange) = stance_at(&model.kinematics, &joints);
        let target = flange.rotation * scenario.robot.target().expect("stated") + flange.translation.vector;
        assert_eq!(sight.obstacles.below_floor(&target), None, "{name}: {joints:?}");
    }
}

/// What is in the scenario's region, where its tracker stands, and that all commands work on it.
fn check_twin(sandbox: &Sandbox, name: &str, scenario: &str, commands: bool) {
    let checked = sandbox.run(["check", scenario]);
    assert_eq!(checked.code, Some(0), "{name}: {checked:?}");
    check_region(&load_scenario(&sandbox.path(scenario)).expect("checked"), name);
    shorten(sandbox, scenario, [50, 12]);
    let out = format!("{name}-run");
    let ran = sandbox.run(["run", scenario, "--out", &out, "--json"]);
    assert_told(&ran, &format!("run of {name}"));
    let report = ran.json();
    let measured = report["sets"]["identification"]["poses"].as_u64().expect("a number");
    assert!(measured >= 40, "{name}: {measured} of 50 poses were measured");
    // It calibrates: what is left is less than what the nominal robot leaves, on poses that no fit has seen. Of a robot that sags, with its stiffness.
    let rows = &report["sets"]["verification"]["rows"];
    let rms = |mode: &str| rows[mode]["rms_3d_m"].as_f64();
    let before = rms("without_calibration").expect("a row");
    let after = rms("elasto_geometric").or_else(|| rms("only_calibration")).expect("a row");
    println!("{name}: {:.3} mm before, {:.3} mm after, exit {:?}", 1e3 * before, 1e3 * after, ran.code);
    assert!(after < before, "{name}: {before} {after}");
    if commands {
        let replayed = sandbox.run(["replay", &format!("{out}/recording.mcap")]);
        assert_told(&replayed, &format!("replay of {name}"));
        assert!(replayed.stdout.contains("bit"), "{name}: {}", replayed.stdout);
        assert_told(&sandbox.run(["identifiability", scenario]), "identifiability");
        let folder = format!("{name}-campaign");
        let campaign = sandbox.run(["montecarlo", scenario, "--trials", "2", "--out", &folder, "--json"]);
        assert_eq!(campaign.code, Some(0), "{name}: {campaign:?}");
    }
}

#[test]
fn every_robot_of_the_zoo_has_a_twin_that_runs() {
    let sandbox = Sandbox::new();
    let zoo = zoo();
    assert!(zoo.len() >= 3, "{zoo:?}");
    for name in zoo {
        let scenario = format!("{name}.toml");
        let ended = made(&sandbox, &format!("models/{name}/robot.toml"), &scenario, &[]);
        for next in ["calibrig check", "calibrig run", "calibrig montecarlo", "calibrig identifiability"] {
            assert!(ended.stdout.contains(&format!("{next} {scenario}")), "{}", ended.stdout);
        }
        check_twin(&sandbox, &name, &scenario, true);
    }
}

/// A chain of links with joints of all kinds, with a branch beside it; every third without masses, every fourth without limits.
fn random_urdf(seed: u64) -> String {
    let mut rng: ChaCha8Rng = stream(seed, 0, StreamSource::AsBuilt);
    let mut text = format!("<robot name=\"made {seed}\">\n<link name=\"root\"/>\n");
    let joints = rng.random_range(3..=7);
    let has_masses = !seed.is_multiple_of(3);
    let has_limits = !seed.is_multiple_of(4);
    let mut parent = "root".to_owned();
    let mut moving = 0;
    let scale = rng.random_range(0.15..0.8);
    for joint in 1..=joints {
        let child = format!("link{joint}");
        let kind = match rng.random_range(0..10) {
            6..=7 => "continuous",
            8 => "prismatic",
            // Two joints move at least.
            9 if joints - joint >= 2 || moving >= 2 => "fixed",
            _ => "revolute",
        };
        moving += u32::from(kind != "fixed");
        let mut number = |low: f64, high: f64| rng.random_range(low..high);
        let origin = [number(-0.2, 0.2), number(-0.2, 0.2), number(0.3, 1.0)].map(|v| v * scale);
        let turn = [0.0, FRAC_PI_2, -FRAC_PI_2, 0.3][joint % 4];
        let axis = ["0 0 1", "0 1 0", "1 0 0"][(joint + usize::try_from(seed).expect("small")) % 3];
        let limit = match kind {
            "revolute" if has_limits => {
                format!(
                    "<limit lower=\"{:.3}\" upper=\"{:.3}\" effort=\"1\" velocity=\"1\"/>",
                    number(-3.0, -1.0),
                    number(1.0, 3.0)
                )
            }
            "prismatic" => {
                format!("<limit lower=\"0\" upper=\"{:.3}\" effort=\"1\" velocity=\"1\"/>", number(0.2, 1.5))
            }
            "revolute" => "<limit lower=\"0\" upper=\"0\" effort=\"0\" velocity=\"0\"/>".to_owned(),
            _ => String::new(),
        };
        let inertial = if has_masses {
            let mass = number(1.0, 60.0) * scale;
            let i = 0.02 * mass;
            format!(
                "<inertial><origin xyz=\"0 {:.3} {:.3}\"/><mass value=\"{mass:.3}\"/><inertia ixx=\"{i:.4}\" ixy=\"0\" ixz=\"0\" iyy=\"{i:.4}\" iyz=\"0\" izz=\"{i:.4}\"/></inertial>",
                number(-0.1, 0.1),
                number(0.0, 0.3)
            )
        } else {
            String::new()
        };
        let [x, y, z] = origin;
        writeln!(
            text,
            "<link name=\"{child}\">{inertial}</link>\n<joint name=\"j{joint}\" type=\"{kind}\"><origin xyz=\"{x:.4} {y:.4} {z:.4}\" rpy=\"{turn} 0 0\"/>\
             <parent link=\"{parent}\"/><child link=\"{child}\"/><axis xyz=\"{axis}\"/>{limit}</joint>"
        )
        .expect("a text");
        parent = child;
    }
    // A camera beside the chain, and the tool at its end.
    writeln!(
        text,
        "<link name=\"camera\"/><joint name=\"to camera\" type=\"revolute\"><origin xyz=\"0.1 0 0\"/><parent link=\"link1\"/><child link=\"camera\"/>\
         <axis xyz=\"0 0 1\"/><limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"1\"/></joint>\n\
         <link name=\"tool\"/><joint name=\"to tool\" type=\"fixed\"><origin xyz=\"0 0 {:.3}\"/><parent link=\"{parent}\"/><child link=\"tool\"/></joint>\n</robot>",
        0.2 * scale
    )
    .expect("a text");
    text
}

#[test]
fn twenty_generated_urdfs_have_twins_that_run() {
    let sandbox = Sandbox::new();
    for seed in 1..=u64::from(repeated(60, 20)) {
        let (urdf, folder, scenario) =
            (format!("{seed}.urdf"), format!("robot{seed}"), format!("twin{seed}.toml"));
        sandbox.write(&urdf, random_urdf(seed));
        let model = ["model", "from-urdf", &urdf, "--base", "root", "--tip", "tool", "--out", &folder];
        let ended = sandbox.run(model);
        assert_eq!(ended.code, Some(0), "{seed}: {ended:?}");
        made(&sandbox, &format!("{folder}/robot.toml"), &scenario, &[]);
        check_twin(&sandbox, &format!("urdf{seed}"), &scenario, false);
        let text = sandbox.read(&scenario);
        assert_eq!(text.contains("drives = \"rigid\""), seed.is_multiple_of(3), "{seed}");
    }
}

/// A four-bar is not built with its crank's axis on the shoulder's: every trial draws where it is, with the reason beside the size.
#[test]
fn a_four_bar_is_drawn_with_an_axis_of_the_crank_of_its_own() {
    let sandbox = Sandbox::new();
    for (name, class, sizes) in
        [("irb460", "class K", [0.05, 0.25]), ("spray_painter", "class L", [0.125, 0.3])]
    {
        let file = format!("{name}.toml");
        made(&sandbox, &format!("models/{name}/robot.toml"), &file, &[]);
        let text = sandbox.read(&file);
        let reason = format!("# The crank's axis relative to the shoulder's. ISO 2768-2, {class}: ");
        let keys = format!("crank_axis_mm = {}\ncrank_tilts_mrad = {}\n", sizes[0], sizes[1]);
        assert!(text.contains(&reason) && text.contains(&keys), "{text}");
        let mut scenario = load_scenario(&sandbox.path(&file)).expect("a scenario");
        assert_eq!(scenario.as_built.linkage_mut().expect("a four-bar").axis, CrankAxis::default());
        let drawn = scenario.drawn.as_ref().expect("drawn");
        // Of so many draws the mean square is that of the size within 10 % (five standard deviations of a chi-square of 5000).
        let mut squares = [0.0; 4];
        let trials = 5000;
        for trial in 0..trials {
            let mut machine = drawn.draw(&scenario.as_built, &mut stream(1, trial, StreamSource::AsBuilt));
            let CrankAxis { x, y, rx, ry } = machine.linkage_mut().expect("a four-bar").axis;
            for (sum, value) in squares.iter_mut().zip([x, y, rx, ry]) {
                *sum += value * value / f64::from(trials);
            }
        }
        let expected = [sizes[0], sizes[0], sizes[1], sizes[1]].map(|size| 1e-6 * size * size);
        for (found, expected) in squares.into_iter().zip(expected) {
            assert!((found / expected - 1.0).abs() < 0.1, "{name}: {squares:?}");
        }
    }
    made(&sandbox, "models/ur5/robot.toml", "ur5.toml", &[]);
    assert!(!sandbox.read("ur5.toml").contains("crank"));
}

#[test]
fn what_is_asked_for_is_in_the_file_and_the_same_is_written_again() {
    let sandbox = Sandbox::new();
    let ur5 = "models/ur5/robot.toml";
    made(&sandbox, ur5, "twins/a.toml", &[]);
    made(&sandbox, ur5, "twins/b.toml", &[]);
    let text = sandbox.read("twins/a.toml");
    assert_eq!(text, sandbox.read("twins/b.toml"));
    assert!(
        text.contains("robot = \"../models/ur5/robot.toml\"")
            && text.contains("Size class \"small\", by size")
    );
    // The guesses of its file give way to the class; gravity loads neither the first drive of an upright robot nor the last, on whose axis the hand is.
    assert_eq!(text.matches("stiffness_factor = ").count(), 4, "{text}");
    assert!(text.contains("[target]") && !text.contains("[gravity]"), "{text}");
    let upright = load_scenario(&sandbox.path("twins/a.toml")).expect("a scenario");
    assert!(upright.robot.target().expect("stated").norm() > 0.05);

    for (mounting, gravity) in
        [("ceiling", Vector3::new(0.0, 0.0, 9.80665)), ("wall", Vector3::new(-9.80665, 0.0, 0.0))]
    {
        let file = format!("{mounting}.toml");
        made(
            &sandbox,
            ur5,
            &file,
            &["--mounting", mounting, "--tracker", "gts3800", "--class", "medium", "--seed", "7"],
        );
        let scenario = load_scenario(&sandbox.path(&file)).expect("a scenario");
        let statics = scenario.robot.model.statics.as_ref().expect("masses");
        assert_eq!((statics.gravity, scenario.as_built.statics.gravity), (gravity, gravity));
        // The tracker stands upright on the floor, and the robot hangs above it.
        let up = -gravity.normalize();
        let place = scenario.tracker.tracker_from_base.inverse();
        assert!((place.rotation * Vector3::z() - up).norm() < 1e-9);
        let at = place.translation.vector;
        assert!(up.dot(&at) < 0.0 && at.z > 0.0, "{mounting}: {at}");
        assert_eq!(scenario.seed, 7);
        assert!(sandbox.read(&file).contains("Size class \"medium\", as asked for"));
        shorten(&sandbox, &file, [40, 10]);
        assert_told(&sandbox.run(["run", &file, "--out", mounting]), mounting);
    }
    let lower = made(&sandbox, ur5, "low.toml", &["--floor-mm", "-800"]);
    assert!(!lower.stderr.contains("--floor-mm"), "{}", lower.stderr);
    assert!(sandbox.read("low.toml").contains("floor_mm = -800"));
}

#[test]
fn what_cannot_be_written_or_read_is_refused_with_what_to_do() {
    let sandbox = Sandbox::new();
    let ur5 = "models/ur5/robot.toml";
    let new =
        |model: &'static str, out: &'static str| vec!["scenario", "new", "--model", model, "--out", out];
    made(&sandbox, ur5, "mine.toml", &[]);
    sandbox.write("mine.toml", "edited");
    assert_refused(&sandbox, &new(ur5, "mine.toml"), "mine.toml", "is there already", "--force");
    made(&sandbox, ur5, "mine.toml", &["--force"]);
    assert_ne!(sandbox.read("mine.toml"), "edited");
    assert_refused(
        &sandbox,
        &new(ur5, "models"),
        "cannot write",
        "models is a folder",
        "the name of a file in it",
    );
    assert_refused(
        &sandbox,
        &new(ur5, "mine.toml/a.toml"),
        "cannot write",
        "mine.toml is no folder",
        "a folder",
    );
    assert_refused(
        &sandbox,
        &new("none.toml", "a.toml"),
        "cannot read none.toml",
        "",
        "a text file in UTF-8",
    );
    let urdf = new("models/ur5/robot.urdf", "a.toml");
    assert_refused(
        &sandbox,
        &urdf,
        "models/ur5/robot.urdf",
        "not a robot's file",
        "calibrig model from-urdf models/ur5/robot.urdf",
    );
}

#[test]
fn poses_of_a_measurement_file_are_measured_again_and_replay_needs_no_file() {
    let sandbox = Sandbox::new();
    made(&sandbox, "models/wam/robot.toml", "wam.toml", &[]);
    let text = sandbox.read("wam.toml");
    // The commands of a first run, as `identify` would read them.
    shorten(&sandbox, "wam.toml", [60, 20]);
    assert_told(&sandbox.run(["run", "wam.toml", "--out", "first"]), "first");
    let exported = sandbox.run(["export", "csv", "first/recording.mcap", "--out", "csv"]);
    assert_eq!(exported.code, Some(0), "{exported:?}");
    let (head, rest) = text.split_once("[poses]").expect("poses");
    let (_, behind) = rest.split_once("[[poses.region]]").expect("a region");
    let (_, tracker) = behind.split_once("# --- The tracker").expect("the tracker");
    let listed = "[poses]\nidentification_from = \"csv/identification.csv\"\nverification_from = \"csv/verification.csv\"\n";
    sandbox.write(
        "again.toml",
        format!("{head}{listed}# --- The tracker{tracker}")
            .replace("order = \"short_travel\"", "order = \"as_drawn\""),
    );
    let ran = sandbox.run(["run", "again.toml", "--out", "second"]);
    assert_told(&ran, "second");
    assert_eq!(sandbox.run(["export", "csv", "second/recording.mcap", "--out", "csv2"]).code, Some(0));
    let commands = |file: &str| -> Vec<Vec<String>> {
        let rows = sandbox.read(file);
        rows.lines().skip(1).map(|row| row.split(',').take(10).map(str::to_owned).collect()).collect()
    };
    for set in ["identification", "verification"] {
        let (first, second) = (commands(&format!("csv/{set}.csv")), commands(&format!("csv2/{set}.csv")));
        assert!(first.len() > 15 && first.len() == second.len(), "{set}");
        let column = |rows: &[Vec<String>], index: usize| {
            rows.iter().map(|row| row[index].clone()).collect::<Vec<_>>()
        };
        let names = sandbox.read(&format!("csv/{set}.csv"));
        let of_joints: Vec<usize> = names
            .lines()
            .next()
            .expect("a header")
            .split(',')
            .enumerate()
            .filter(|(_, name)| name.starts_with('q') && name.ends_with("_rad"))
            .map(|(index, _)| index)
            .collect();
        assert_eq!(of_joints.len(), 7);
        for joint in of_joints {
            assert_eq!(column(&first, joint), column(&second, joint), "{set} {joint}");
        }
    }
    // The recording holds the files.
    fs::remove_dir_all(sandbox.path("csv")).expect("removed");
    assert_told(&sandbox.run(["replay", "second/recording.mcap"]), "replay");
    let beyond = sandbox.read("csv2/identification.csv");
    let (header, rows) = beyond.split_once('\n').expect("rows");
    let first = header.split(',').position(|name| name == "q1_rad").expect("a column");
    let mut cells: Vec<&str> = rows.lines().next().expect("a row").split(',').collect();
    cells[first] = "9.0";
    sandbox.make_folder("csv");
    sandbox.write("csv/identification.csv", format!("{header}\n{}\n", cells.join(",")));
    sandbox.write("csv/verification.csv", &beyond);
    assert_refused(
        &sandbox,
        &["check", "again.toml"],
        "again.toml:",
        "has joint \"base yaw\" at 515.662 deg",
        "within the limits",
    );
    sandbox.replace_line(
        "again.toml",
        "[poses]",
        "identification_from",
        "identification_from = \"none.csv\"",
    );
    assert_refused(
        &sandbox,
        &["check", "again.toml"],
        "again.toml:",
        "cannot read none.csv",
        "relative to this file",
    );
    sandbox.replace_line(
        "again.toml",
        "[poses]",
        "identification_from",
        "identification_from = \"csv/verification.csv\"\nidentification = 5",
    );
    assert_refused(&sandbox, &["check", "again.toml"], "again.toml:", "both given", "one of them");
    sandbox.replace_line("again.toml", "[poses]", "identification_from", "");
    assert_refused(
        &sandbox,
        &["check", "again.toml"],
        "again.toml:",
        "poses.region is missing",
        "[[poses.region]]",
    );
}

const MAP: &str = "schema = \"calibrig.columns/1\"
[joints]
columns = [\"q1_rad\", \"q2_rad\", \"q3_rad\", \"q4_rad\", \"q5_rad\", \"q6_rad\"]
revolute_unit = \"rad\"
[position]
system = \"spherical\"
range = \"range_m\"
range_unit = \"m\"
azimuth = \"az_rad\"
elevation = \"el_rad\"
angle_unit = \"rad\"
[columns]
pose = \"pose\"
";

/// docs/guide/sim-against-real.md: the twin of the UR5 at the poses of the real one leaves as much as that did, and knows its parameters as well.
#[test]
fn the_twin_of_the_ur5_leaves_what_the_real_one_left() {
    let Some(data) = std::env::var_os("CALIBRIG_DATA") else {
        eprintln!("SKIPPED: CALIBRIG_DATA is not set, the real measurements are not at hand");
        return;
    };
    let sandbox = Sandbox::new();
    let file = |set: &str| {
        let name = format!("ur5_wam/UR5/3D_UR5_uncalibrated_{set}_cleaned.csv");
        fs::canonicalize(Path::new(&data).join(name)).expect("the data").display().to_string()
    };
    let (grid, random) = (file("grid"), file("random"));
    let ur5 = "models/ur5/robot.toml";
    made(&sandbox, ur5, "twin.toml", &["--tracker", "gts3800"]);
    let text = sandbox.read("twin.toml");
    let (before, rest) = text.split_once("[target]").expect("a target");
    let (_, rest) = rest.split_once("# --- The machine").expect("the machine");
    let (machine, rest) = rest.split_once("[poses]").expect("poses");
    let (_, rest) = rest.split_once("# --- The tracker").expect("the tracker");
    let (tracker, rest) = rest.split_once("[session.line_of_sight]").expect("lines of sight");
    let (_, fit) = rest.split_once("# --- Identification").expect("the identification");
    let listed = format!("[poses]\nidentification_from = {grid:?}\nverification_from = {random:?}\n");
    let tracker = tracker.replace("order = \"short_travel\"", "order = \"as_drawn\"");
    let target = "[target]\nx_mm = 0.13\ny_mm = 0.19\nz_mm = 33.74\n";
    sandbox.write("twin.toml", format!("{before}{target}# {machine}{listed}# {tracker}\n# {fit}"));
    assert_told(&sandbox.run(["run", "twin.toml", "--out", "twin"]), "run");
    assert_eq!(sandbox.run(["export", "csv", "twin/recording.mcap", "--out", "csv"]).code, Some(0));
    sandbox.write("map.toml", MAP);
    let identify = |more: &[&str]| {
        let ended = sandbox.run([&["identify", "--json", "--model", ur5], more].concat());
        assert_eq!(ended.code, Some(0), "{ended:?}");
        ended.json()
    };
    let real = identify(&["--measurements", &grid, "--verify", &random]);
    let twin = identify(&[
        "--columns",
        "map.toml",
        "--measurements",
        "csv/identification.csv",
        "--verify",
        "csv/verification.csv",
    ]);
    let rms = |report: &serde_json::Value, set: &str, mode: &str| {
        report["sets"][set]["rows"][mode]["rms_3d_m"].as_f64().expect("a row")
    };
    for mode in ["only_calibration", "elasto_geometric"] {
        let [real, twin] = [&real, &twin].map(|report| rms(report, "identification", mode));
        println!("{mode}: real {:.4} mm, twin {:.4} mm", 1e3 * real, 1e3 * twin);
        // Over five seeds 0.101 to 0.113 mm, the real one 0.105 and 0.112.
        assert!((0.85..1.15).contains(&(twin / real)), "{mode}: {real} {twin}");
    }
    let sigmas = |report: &serde_json::Value| -> Vec<f64> {
        let names = [
            "delta_a2",
            "delta_a3",
            "delta_a4",
            "delta_alpha2",
            "delta_theta2",
            "delta_alpha3",
            "delta_theta4",
        ];
        let parameters = report["parameters"].as_array().expect("parameters");
        let of = |name: &&str| {
            let found = parameters.iter().find(|p| p["mode"] == "only_calibration" && p["name"] == **name);
            found.expect("a parameter")["sigma"].as_f64().expect("a number")
        };
        names.iter().map(of).collect()
    };
    for (real, twin) in sigmas(&real).iter().zip(sigmas(&twin)) {
        assert!((0.9..1.1).contains(&(twin / real)), "{real} {twin}");
    }
    // What it lacks: residuals of neighbours in the session are alike on the real robot.
    let serial = |report: &serde_json::Value| {
        report["estimates"]["elasto_geometric"]["judgement"]["serial_correlation"].as_f64().expect("a number")
    };
    assert!(serial(&real) > 0.25 && serial(&twin) < 0.15, "{} {}", serial(&real), serial(&twin));
}
