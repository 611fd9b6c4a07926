//! Measurements go from a recording to files of text and back, and into a recording from another program's files or from a program of the
//! user's own.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

use calibrig::files::Source;
use calibrig::files::{ColumnMap, parse_column_map, parse_measurements, parse_session, read_measurements};
use calibrig::files::{Robot, load_robot, parse_robot};
use calibrig::identification::{FrameChoice, IdentificationOptions, Mode, ParameterChoice, TargetChoice};
use calibrig::kinematics::forward_kinematics;
use calibrig::measurement::{MeasurementSet, Reading};
use calibrig::model::{JointKind, LinkTerm, ParameterId};
use calibrig::pipeline::{self, InputSummary, ModeOutcome, SetKind, SetOutcome, calibrate};
use calibrig::recording::{
    CsvExport, Preamble, Recording, export_csv, read_recording, write_mcap, write_sets,
};

use nalgebra::Vector3;

use crate::a_user_reproduces_the_paper::paper;
use crate::sandbox::{SCENARIO, Sandbox, assert_refused};

const BY_HAND: &str = "tests/fixtures/recording/by_hand.mcap";
const UR5: &str = "models/ur5/robot.toml";

/// Every bit of measured sets: `{:?}` tells -0.0 from 0.0, and prints enough digits.
fn bits(sets: &[SetOutcome]) -> String {
    format!("{sets:?}")
}

fn joints(robot: &Robot) -> Vec<JointKind> {
    robot.model.kinematics.links.iter().map(|link| link.kind).collect()
}

fn files(export: &CsvExport) -> BTreeMap<&str, Source> {
    export.files.iter().map(|file| (file.name.as_str(), Source::new(&file.name, &file.text))).collect()
}

fn record(path: &Path, robot: &Robot, sources: &[(String, Source)], sets: &[SetOutcome]) -> Recording {
    let input = InputSummary {
        kind: "files",
        name: robot.name.clone(),
        sha256: pipeline::hash_sources(sources),
        seed: None,
        trial: None,
    };
    let preamble =
        Preamble { input: &input, sources, model: &robot.model, visuals: &robot.visuals, truth: None };
    write_sets(path, &preamble, sets).expect("written");
    read_recording(path).expect("read")
}

/// As `identify` does with a file of positions.
fn identified(robot: &Robot, sets: &[SetOutcome], frame: FrameChoice) -> Vec<ModeOutcome> {
    let options = IdentificationOptions {
        parameters: ParameterChoice::Complete,
        frame,
        target: TargetChoice::Identified,
        ..IdentificationOptions::published()
    };
    let modes = [Mode::WithoutCalibration, Mode::OnlyCalibration];
    calibrate(&robot.model, sets, &modes, &options).expect("estimates").1
}

#[test]
fn a_recording_comes_back_from_text_bit_for_bit() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("recording.mcap");
    let mut outcome = pipeline::run(&paper(), 3, |_, _| {}).expect("a run");
    // Its nests are measured more than once: a recording keeps what was read, before the tracker's motion is taken out.
    outcome.as_measured[1].dropped.push((999, "a \"quoted\", long\nreason".to_owned()));
    write_mcap(&outcome.story(), &path).expect("a recording");
    let export = export_csv(&path, None).expect("exported");
    let files = files(&export);
    let names = [
        "identification.csv",
        "paper.toml",
        "parameters.csv",
        "residuals.csv",
        "robot.toml",
        "robot.urdf",
        "session.toml",
        "verification.csv",
    ];
    assert_eq!(files.keys().copied().collect::<Vec<_>>(), names);

    let robot =
        parse_robot(files["robot.toml"].clone(), Some(files["robot.urdf"].clone()), None).expect("whole");
    let session = parse_session(&files["session.toml"]).expect("valid");
    let set = |kind: SetKind| {
        let text = &files[format!("{}.csv", kind.key()).as_str()];
        let mut read = parse_measurements(text, &ColumnMap::default(), &joints(&robot)).expect("valid");
        session.complete(&files["session.toml"], kind, &mut read).expect("described");
        SetOutcome { kind, measurements: read.set, dropped: read.dropped }
    };
    let again = record(&folder.path().join("again.mcap"), &robot, &robot.sources, &SetKind::ALL.map(set));
    let measured = &outcome.as_measured;
    assert!(measured[0].measurements.stations[0].nests.len() > 7, "seven nests, several times");
    assert!(measured[0].measurements.targets[0].covariance.is_some(), "nothing to lose");
    assert_eq!(bits(&again.sets), bits(measured));
    assert!(again.estimates.is_empty() && again.missing.is_empty());
    assert_eq!(again.provenance.expect("calibrig wrote it").input_kind, "files");

    tables_hold_the_estimates(&files, &outcome);
}

fn tables_hold_the_estimates(files: &BTreeMap<&str, Source>, outcome: &pipeline::Outcome) {
    let rows = |name: &str| -> Vec<Vec<String>> {
        let lines = files[name].text.lines().skip(1);
        lines.map(|line| line.split(',').map(str::to_owned).collect()).collect()
    };
    let number = |cell: &String| cell.parse::<f64>().map(f64::to_bits).ok();
    let mut parameters = rows("parameters.csv").into_iter();
    for mode in &outcome.modes {
        for parameter in mode.estimate.iter().flat_map(|estimate| &estimate.parameters) {
            let row = parameters.next().expect("a row a parameter");
            let texts =
                [mode.mode.key().to_owned(), parameter.id.to_string(), parameter.id.unit().to_string()];
            assert_eq!(row[..3], texts);
            assert_eq!(number(&row[3]), Some(parameter.value.to_bits()));
            assert_eq!(number(&row[4]), parameter.sigma.map(f64::to_bits));
        }
    }
    assert_eq!(parameters.next(), None);
    let mut residuals = 0;
    for row in rows("residuals.csv") {
        let mode = outcome.modes.iter().find(|mode| mode.mode.key() == row[0]).expect("a mode");
        let set = outcome.sets.iter().position(|set| set.kind.key() == row[1]).expect("a set");
        let error = mode.errors[set][row[2].parse::<usize>().expect("an index")];
        for (cell, value) in row[4..].iter().zip(error.iter().copied().chain([error.norm()])) {
            assert_eq!(number(cell), Some(value.to_bits()));
        }
        residuals += 1;
    }
    assert_eq!(residuals, outcome.modes.iter().flat_map(|mode| &mode.errors).flatten().count());
}

/// The same sets through a recording: not one bit of the estimate may change.
fn assert_same_estimate(model: &Path, columns: Option<&str>, paths: [&Path; 2]) {
    let robot = load_robot(model).expect("a robot");
    let map = columns.map_or_else(ColumnMap::default, |name| {
        let source = Source::read(&model.with_file_name(name)).expect("a map");
        parse_column_map(&source).expect("valid")
    });
    let set = |(kind, path): (SetKind, &Path)| {
        let read = read_measurements(path, &map, &joints(&robot)).expect("measurements");
        SetOutcome { kind, measurements: read.set, dropped: read.dropped }
    };
    let sets: Vec<_> = SetKind::ALL.into_iter().zip(paths).map(set).collect();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let recording = record(&folder.path().join("files.mcap"), &robot, &robot.sources, &sets);
    assert_eq!(bits(&recording.sets), bits(&sets));
    let attached = |role: &str| {
        recording.sources.iter().find(|(known, _)| known == role).map(|(_, source)| source.clone())
    };
    let recorded = parse_robot(attached("robot").expect("attached"), attached("urdf"), attached("columns"))
        .expect("whole");
    let [a, b] = [(&robot, &sets), (&recorded, &recording.sets)]
        .map(|(robot, sets)| format!("{:?}", identified(robot, sets, FrameChoice::Free)));
    assert!(a == b, "{}: the estimates differ", model.display());
}

#[test]
fn a_recorded_file_gives_the_estimate_of_the_file() {
    let sandbox = Sandbox::new();
    write_ur5_files(&sandbox);
    let [grid, random] = ["grid.csv", "random.csv"].map(|name| sandbox.path(name));
    assert_same_estimate(&sandbox.path(UR5), Some("columns.toml"), [&grid, &random]);
    let Some(data) = std::env::var_os("CALIBRIG_DATA") else {
        eprintln!("SKIPPED: CALIBRIG_DATA is not set, the real measurements are not at hand");
        return;
    };
    for (robot, name) in [("ur5", "UR5"), ("wam", "WAM")] {
        let [grid, random] = ["grid", "random"].map(|part| {
            let file = format!("ur5_wam/{name}/3D_{name}_uncalibrated_{part}_cleaned.csv");
            PathBuf::from(&data).join(file)
        });
        let model = PathBuf::from(format!("models/{robot}/robot.toml"));
        assert_same_estimate(&model, Some("columns.toml"), [&grid, &random]);
    }
}

/// Two files in the columns of the UR5's map, of a robot whose upper arm is longer than its table says.
fn write_ur5_files(sandbox: &Sandbox) {
    let mut real = load_robot(&sandbox.path(UR5)).expect("the shipped robot").model.kinematics;
    real.links[2].a += 1e-3;
    let mut number = 0.0;
    for (name, poses) in [("grid.csv", 60), ("random.csv", 20)] {
        let columns = ",joint_1,joint_2,joint_3,joint_4,joint_5,joint_6";
        let mut text = format!("step_order,x_t,y_t,z_t,x_dif,y_dif,z_dif{columns}\n");
        for pose in 0..poses {
            number += 1.0;
            let q: Vec<f64> = [0.8731, 0.7623, 0.6655, 0.5810, 0.5072, 0.4428]
                .iter()
                .map(|step| 120.0 * ((number * step) % 1.0) - 60.0)
                .collect();
            let radians: Vec<f64> = q.iter().map(|angle| angle.to_radians()).collect();
            let at = 1e3 * forward_kinematics(&real, &radians).expect("six joints").translation.vector;
            let _ = write!(text, "{pose},{:.4},{:.4},{:.4},0,0,0", at.x, at.y, at.z);
            for angle in q {
                let _ = write!(text, ",{angle:.6}");
            }
            text.push('\n');
        }
        sandbox.write(name, text);
    }
}

#[test]
fn exported_files_are_all_that_identify_needs() {
    let sandbox = Sandbox::new();
    write_ur5_files(&sandbox);
    let to_mcap = [
        "export",
        "mcap",
        "--model",
        UR5,
        "--measurements",
        "grid.csv",
        "--verify",
        "random.csv",
        "--out",
        "ur5.mcap",
    ];
    let ended = sandbox.run(to_mcap);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert!(ended.stderr.contains("60 of the identification set, 20 of the verification set"), "{ended:?}");
    let to_csv = ["export", "csv", "ur5.mcap", "--out", "tables"];
    let ended = sandbox.run(to_csv);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert!(ended.stderr.contains("the recording holds no estimates"), "{ended:?}");
    // The robot names a map of other columns, and it is there too.
    assert!(sandbox.path("tables/columns.toml").is_file());
    assert_eq!(sandbox.read("tables/grid.csv"), sandbox.read("grid.csv"));
    let identify = |model: &str, fit: &str, verify: &str| {
        let arguments = ["identify", "--json", "--mode", "only_calibration", "--model", model];
        let ended = sandbox.run(arguments.into_iter().chain(["--measurements", fit, "--verify", verify]));
        assert!(matches!(ended.code, Some(0 | 3)), "{ended:?}");
        let mut report = ended.json();
        // The files are others: so are the rows in them.
        let sets = report["estimates"]["only_calibration"]["residuals"].as_object_mut().expect("by set");
        for residual in sets.values_mut().flat_map(|set| set.as_array_mut().expect("a list")) {
            residual.as_object_mut().and_then(|residual| residual.remove("row")).expect("of a file");
        }
        (ended.code, report["parameters"].clone(), report["sets"].clone(), report["estimates"].clone())
    };
    let given = identify(UR5, "grid.csv", "random.csv");
    let exported = identify("tables/robot.toml", "tables/identification.csv", "tables/verification.csv");
    assert_eq!(given, exported);

    // Neither writes over anything unasked.
    assert_refused(&sandbox, &to_csv, "tables/identification.csv, ", "are there already", "--force");
    assert_refused(&sandbox, &to_mcap, "ur5.mcap is there", "already", "--force");
    let before = sandbox.content();
    for arguments in [&to_csv[..], &to_mcap[..]] {
        let ended = sandbox.run(arguments.iter().chain(&["--force"]));
        assert_eq!(ended.code, Some(0), "{ended:?}");
    }
    assert!(sandbox.content() == before, "the same input gives the same files");
}

#[test]
fn an_exported_scenario_finds_its_robot() {
    let sandbox = Sandbox::new();
    let ended = sandbox.run(["run", SCENARIO, "--out", "out"]);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let ended = sandbox.run(["export", "csv", "out/recording.mcap", "--out", "tables"]);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert!(ended.stderr.contains("which lies beside it"), "{ended:?}");
    let ended = sandbox.run(["check", "tables/paper.toml"]);
    assert_eq!(ended.code, Some(0), "{ended:?}");
}

#[test]
fn a_recording_made_by_hand_is_read_and_identified() {
    let recording = read_recording(Path::new(BY_HAND)).expect("read");
    assert_made_by_hand(&recording);
    let (_, robot) = recording.sources.first().expect("an attachment");
    let robot = parse_robot(robot.clone(), None, None).expect("a robot");
    for frame in [FrameChoice::Free, FrameChoice::Nests] {
        let modes = identified(&robot, &recording.sets, frame);
        let [before, after] = [0, 1].map(|mode| modes[mode].rows[1].expect("a verification set").rms_3d);
        assert!(before > 1e-4 && after < 1e-7, "{frame:?}: {before}, {after}");
        let estimate = modes[1].estimate.as_ref().expect("fitted");
        let arm = ParameterId::Link { link: 2, term: LinkTerm::A };
        let arm = estimate.parameters.iter().find(|parameter| parameter.id == arm).expect("identified");
        assert!((arm.value - 0.8e-3).abs() < 1e-7, "{frame:?}: {}", arm.value);
    }
}

/// What `docs/record_by_hand.py` says that robot and tracker do.
fn assert_made_by_hand(recording: &Recording) {
    assert_eq!(recording.provenance, None);
    assert!(recording.missing.is_empty() && recording.estimates.is_empty());
    let counts: Vec<_> =
        recording.sets.iter().map(|set| (set.kind, set.measurements.observations.len())).collect();
    assert_eq!(counts, [(SetKind::Identification, 30), (SetKind::Verification, 10)]);
    let mut time = 0.0;
    for set in &recording.sets {
        let MeasurementSet { stations, targets, observations } = &set.measurements;
        assert_eq!((stations.len(), stations[0].nests.len(), targets.len()), (1, 4, 1));
        assert_eq!(stations[0].nests[3].in_base, Vector3::new(0.6, -0.5, 0.1));
        assert_seen(&stations[0].nests[3].reading, [0.6, -0.5, 0.1]);
        for observation in observations {
            time += 5.0;
            assert_eq!((observation.time, observation.temperature), (time, None));
            assert_eq!(observation.approach, [0, 0, 0], "what nobody states is not known");
            let [waist, shoulder, elbow] = observation.command[..] else { panic!("three joints") };
            let ((s, c), (su, cu), (sb, cb)) =
                (waist.sin_cos(), shoulder.sin_cos(), (shoulder + elbow).sin_cos());
            let radius = 0.5008 * cu + 0.371 * cb - 0.002 * sb;
            let place =
                [c * radius + 0.05 * s, s * radius - 0.05 * c, 0.4 + 0.5008 * su + 0.371 * sb + 0.002 * cb];
            assert_seen(&observation.reading, place);
        }
    }
}

fn assert_seen(reading: &Reading, [x, y, z]: [f64; 3]) {
    let Reading::Spherical(reading) = reading else { panic!("{reading:?} is not spherical") };
    let (dx, dy, dz) = (x - 3.0, y + 0.5, z - 1.2);
    let (sin, cos) = 0.7_f64.sin_cos();
    let expected = [cos * dx + sin * dy, cos * dy - sin * dx, dz];
    for (found, expected) in reading.position().iter().zip(expected) {
        assert!((found - expected).abs() < 1e-12, "{found} where {expected} was expected");
    }
    let sigmas = reading.covariance.expect("stated").diagonal().map(f64::sqrt);
    assert!((sigmas - Vector3::new(8e-6, 4e-6, 4e-6)).norm() < 1e-18, "{sigmas}");
}

#[test]
fn the_example_for_python_runs() {
    let python = |arguments: &[&str]| Command::new("python3").args(arguments).output();
    let packages = python(&["-c", "import mcap, mcap_protobuf, google.protobuf, zstandard"]);
    if !packages.is_ok_and(|output| output.status.success()) {
        eprintln!(
            "SKIPPED: no python3 with mcap and mcap-protobuf-support (pip install mcap mcap-protobuf-support)"
        );
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("new.mcap");
    let ended = python(&["docs/record_by_hand.py", BY_HAND, &path.display().to_string()]).expect("it starts");
    assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
    assert_made_by_hand(&read_recording(&path).expect("read"));
}

/// A recording without a robot, of 3 joints.
fn without_robot(sandbox: &Sandbox, name: &str) {
    let recording = read_recording(Path::new(BY_HAND)).expect("read");
    let (_, robot) = recording.sources.first().expect("an attachment");
    let robot = parse_robot(robot.clone(), None, None).expect("a robot");
    record(&sandbox.path(name), &robot, &[], &recording.sets);
}

#[test]
fn recordings_that_cannot_become_text_are_refused() {
    let sandbox = Sandbox::new();
    let by_hand = std::fs::read(BY_HAND).expect("the fixture");
    sandbox.write("whole.mcap", &by_hand);
    sandbox.write("half.mcap", &by_hand[..by_hand.len() / 2]);
    sandbox.write("file", "");
    without_robot(&sandbox, "bare.mcap");
    let export = ["export", "csv", "--out", "tables"];
    let refused = |arguments: &[&str], place: &str, message: &str, expected: &str| {
        assert_refused(&sandbox, &[&export, arguments].concat(), place, message, expected);
    };
    refused(&[SCENARIO], "scenarios/paper.toml: ", "not an MCAP file", "that `calibrig run` writes");
    refused(&["none.mcap"], "cannot read none.mcap", "No such file", "recording.mcap");
    refused(&["half.mcap"], "half.mcap: ", "ends before its footer", "a complete file");
    refused(&["bare.mcap"], "bare.mcap: ", "holds no robot", "--model ROBOT.toml");
    refused(&["whole.mcap", "--model", UR5], "whole.mcap: ", "robot/robot.toml", "leave out --model");
    let place = "bare.mcap: /measurement/identification: pose 1: ";
    refused(&["bare.mcap", "--model", UR5], place, "3 commands for 6 joints", "one per joint");
    refused(
        &["bare.mcap", "--model", "none.toml"],
        "cannot read none.toml",
        "No such file",
        "a text file in UTF-8",
    );
    let over_a_file = ["export", "csv", "whole.mcap", "--out", "file"];
    assert_refused(&sandbox, &over_a_file, "cannot write to the folder file", "no folder", "a folder");

    let robot = recording_robot(&sandbox, "arm.toml");
    let ended = sandbox.run([&export[..], &["bare.mcap", "--model", &robot]].concat());
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert_eq!(sandbox.read("tables/arm.toml"), sandbox.read("arm.toml"));
}

fn recording_robot(sandbox: &Sandbox, name: &str) -> String {
    let recording = read_recording(Path::new(BY_HAND)).expect("read");
    sandbox.write(name, &recording.sources[0].1.text);
    name.to_owned()
}

#[test]
fn files_that_cannot_become_a_recording_are_refused() {
    let sandbox = Sandbox::new();
    recording_robot(&sandbox, "arm.toml");
    let own = "pose,q1_rad,q2_rad,q3_rad,x_m,y_m,z_m,station\n";
    sandbox.write("own.csv", format!("{own}1,0.1,0.2,-0.1,1,2,3,front\n2,0.3,0.2,-0.1,1,2,3.5,back\n"));
    sandbox.write("missed.csv", format!("{own}1,0.1,0.2,-0.1,0,0,0,front\n"));
    sandbox.write("more.csv", "q1_rad,q2_rad,q3_rad,q4_rad,x_m,y_m,z_m\n1,1,1,1,1,1,1\n");
    sandbox.write("foreign.csv", "A,B,C\n1,2,3\n");
    let schema = "schema = \"calibrig.session/1\"\n";
    sandbox.write("session.toml", format!("{schema}[[station]]\nname = \"front\"\n"));
    sandbox.write("typo.toml", format!("{schema}[[station]]\nname = \"front\"\nnests = 3\n"));
    let export = ["export", "mcap", "--model", "arm.toml", "--out", "new.mcap"];
    let refused = |arguments: &[&str], place: &str, message: &str, expected: &str| {
        assert_refused(&sandbox, &[&export, arguments].concat(), place, message, expected);
    };
    refused(
        &["--measurements", "foreign.csv"],
        "foreign.csv:1: ",
        "column q1_rad is missing",
        "found A, B, C",
    );
    refused(
        &["--measurements", "more.csv"],
        "more.csv:1: ",
        "the robot has 3 joints",
        "calibrig's own columns",
    );
    let every = "every row of the identification set is a missed shot; the first: missed shot: the position is (0, 0, 0) (missed.csv:2)";
    refused(&["--measurements", "missed.csv"], "missed.csv: ", every, "(0, 0, 0)");
    refused(&["--measurements", "none.csv"], "cannot read none.csv", "No such file", "a text file in UTF-8");
    let with = ["--measurements", "own.csv", "--session"];
    let missing = "station \"back\" of the identification set is not described";
    refused(&[&with[..], &["session.toml"]].concat(), "session.toml:3: ", missing, "name = \"back\"");
    refused(&[&with[..], &["typo.toml"]].concat(), "typo.toml:4: ", "unknown key `nests`", "nest");
    let nowhere = ["export", "mcap", "--model", "arm.toml", "--measurements", "own.csv", "--out"];
    let to = |name| [&nowhere[..], &[name]].concat();
    assert_refused(
        &sandbox,
        &to("none/new.mcap"),
        "cannot write to the folder none",
        "no folder",
        "an existing folder",
    );
    assert_refused(
        &sandbox,
        &to("models"),
        "cannot write to the folder",
        "models is a folder",
        "name of a file",
    );
}

#[test]
fn help_shows_examples_that_are_accepted() {
    let sandbox = Sandbox::new();
    for command in [&["export"][..], &["export", "csv"], &["export", "mcap"]] {
        let help = sandbox.run([command, &["--help"]].concat());
        assert_eq!((help.code, help.stderr.as_str()), (Some(0), ""));
        let examples: Vec<_> = help.stdout.lines().filter(|line| line.starts_with("  calibrig ")).collect();
        assert!(examples.len() >= 2, "{}", help.stdout);
        for example in examples {
            assert!(example.len() < 100, "{example}");
            // A remark stands behind several blanks.
            let used = example.trim().split("   ").next().expect("not empty");
            let ended = sandbox.run(used.split_whitespace().skip(1));
            assert_ne!(ended.code, Some(2), "{example}: {}", ended.stderr);
        }
    }
}
