//! What was identified is handed over: a file of the estimate that predicts the same, the robot in calibrig's own form and as a URDF, tables and
//! offsets with what they lose.

use std::path::Path;
use std::sync::LazyLock;

use calibrig::files::{Robot, RobotText, Source, TargetText, load_robot, parse_robot, write_robot};
use calibrig::geometry::Transform;
use calibrig::handover::{EstimateFile, FILES, Handover, hand_over, model_sha256};
use calibrig::identification::{CalibratedRobot, Mode, Predictor};
use calibrig::kinematics::forward_kinematics;
use calibrig::measurement::MeasurementSet;
use calibrig::model::random::{StreamSource as Stream, stream};
use calibrig::model::{ActuatorMap, CalibrationModel, JointKind, LinkTerm, LinkageTerm, PoseQuery};
use calibrig::nalgebra::Vector3;
use calibrig::pipeline::{self, Outcome};
use calibrig::recording::write_mcap;
use calibrig::scenario::load_scenario;
use rand::RngExt;
use serde_json::{Value, json};

use crate::a_user_brings_a_robot::asked;
use crate::a_user_reproduces_the_paper::paper;
use crate::sandbox::{Sandbox, assert_refused};

/// The published session: four-bar, deflection, terms.
static PAINTER: LazyLock<Outcome> = LazyLock::new(|| pipeline::run(&paper(), 3, |_, _| {}).expect("a run"));

fn outcome_of(scenario: &str) -> Outcome {
    let scenario = load_scenario(Path::new(scenario)).expect("a shipped scenario");
    pipeline::run(&scenario, 1, |_, _| {}).expect("a run")
}

fn robot_of(outcome: &Outcome) -> Robot {
    let source = |role: &str| {
        let found = outcome.sources.iter().find(|(known, _)| known == role);
        found.map(|(_, source)| source.clone())
    };
    parse_robot(source("robot").expect("attached"), source("urdf"), source("columns")).expect("a robot")
}

fn estimates(outcome: &Outcome) -> impl Iterator<Item = EstimateFile> + '_ {
    let fitted = outcome.modes.iter().filter(|mode| mode.estimate.is_some());
    fitted.map(|mode| EstimateFile::of(outcome, Some(mode.mode)).expect("an estimate of that mode"))
}

fn file<'a>(handover: &'a Handover, name: &str) -> &'a str {
    &handover.files.iter().find(|file| file.name == name).expect("a file of that name").text
}

fn read_back(handover: &Handover) -> Robot {
    let source = |name: &str| Source::new(name, file(handover, name));
    parse_robot(source("robot.toml"), Some(source("robot.urdf")), None).expect("as written")
}

/// A robot that predicts by a model alone.
fn alone(model: &CalibrationModel, mode: Mode, target: Vector3<f64>) -> CalibratedRobot {
    CalibratedRobot {
        mode,
        nominal: model.clone(),
        model: model.clone(),
        terms: Vec::new(),
        stations: Vec::new(),
        targets: vec![target],
        instruments: Vec::new(),
        orientations: Vec::new(),
    }
}

/// The same rigid, with the ideal map of the commands.
fn rigid(model: &CalibrationModel, target: Vector3<f64>) -> CalibratedRobot {
    let mut ideal = model.clone();
    (ideal.statics, ideal.actuators) = (None, ideal.actuators.without_linkage());
    alone(&ideal, Mode::OnlyCalibration, target)
}

/// Largest distance of two robots' predictions, m.
fn apart(robots: [&CalibratedRobot; 2], commands: &[Vec<f64>]) -> f64 {
    let [mut one, mut other] = robots.map(|robot| Predictor::new(robot).expect("a robot"));
    let mut compared = 0;
    let mut worst: f64 = 0.0;
    for command in commands {
        if let (Ok(one), Ok(other)) = (one.in_base(command), other.in_base(command)) {
            worst = worst.max((one - other).norm());
            compared += 1;
        }
    }
    assert!(2 * compared > commands.len(), "{compared} poses compared");
    worst
}

#[test]
fn an_estimate_predicts_the_same_from_its_file() {
    let mut terms = 0;
    for outcome in
        [&*PAINTER, &outcome_of("scenarios/zoo/ur5.toml"), &outcome_of("scenarios/zoo/irb460.toml")]
    {
        for written in estimates(outcome) {
            let text = written.text().expect("JSON");
            let read = EstimateFile::parse(&Source::new("estimate.json", text.as_str())).expect("as written");
            // `{:?}` tells every bit of a number.
            assert!(format!("{read:?}") == format!("{written:?}"), "{}", written.robot.name);
            assert_eq!(read.text().expect("JSON"), text);
            let [mut ours, mut theirs] =
                [&written, &read].map(|file| file.estimate.predictor().expect("a robot"));
            let set: &MeasurementSet = &outcome.sets[0].measurements;
            for observation in &set.observations {
                let [ours, theirs] =
                    [&mut ours, &mut theirs].map(|own| own.predict(observation).expect("placed"));
                assert_eq!(ours, theirs);
                assert!(ours.covariance.is_some());
            }
            terms += written.estimate.robot.terms.len();
        }
    }
    assert!(terms > 0, "no estimate had terms");
}

fn commands(model: &CalibrationModel, count: usize) -> Vec<Vec<f64>> {
    let mut random = stream(21, 0, Stream::AsBuilt);
    let limits: Vec<_> = model.kinematics.links.iter().map(|link| link.limits).collect();
    // The middle of the limits: a four-bar closes there.
    let draw = |_| {
        let joints = limits.iter().map(|[low, high]| {
            let (middle, half) = (0.5 * (low + high), 0.4 * (high - low));
            middle + half.min(2.0) * random.random_range(-1.0..1.0)
        });
        let mut joints: Vec<f64> = joints.collect();
        model.actuators.follow(&mut joints);
        model.actuators.command_from_joints(&joints)
    };
    (0..count).map(draw).collect()
}

/// Shipped robots, of which nothing is as drawn.
fn calibrated_models() -> Vec<(String, Robot, CalibrationModel)> {
    let mut folders: Vec<_> =
        std::fs::read_dir("models").expect("models").map(|e| e.expect("one").path()).collect();
    folders.retain(|folder| folder.is_dir());
    folders.sort();
    let mut random = stream(22, 0, Stream::AsBuilt);
    let changed = folders.into_iter().map(|folder| {
        let robot = load_robot(&folder.join("robot.toml")).expect("a shipped robot");
        let mut model = robot.model.clone();
        for link in &mut model.kinematics.links {
            for term in LinkTerm::ALL {
                *link.term_mut(term) += random.random_range(-1e-3..1e-3);
            }
        }
        if let Some(statics) = &mut model.statics {
            statics.drive_stiffness.iter_mut().for_each(|k| *k *= random.random_range(0.5..2.0));
            statics.drive_stiffness[0] = f64::INFINITY;
            for body in &mut statics.bodies {
                let factor = random.random_range(0.9..1.1);
                body.mass *= factor;
                body.inertia *= factor;
                body.centre_of_mass.x += 1e-3;
            }
            for bearing in &mut statics.bearings {
                bearing.stiffness.iter_mut().for_each(|k| *k *= random.random_range(0.5..2.0));
            }
            for segment in statics.beams.iter_mut().flatten().flat_map(|beam| &mut beam.segments) {
                segment.section = segment.section.map_stiffness(|k| k / 1.37);
            }
            if let Some(linkage) = &mut statics.linkage {
                linkage.rod_stiffness /= 1.21;
            }
        }
        if let Some(four_bar) = model.actuators.linkage_mut() {
            for (term, change) in
                LinkageTerm::ALL.into_iter().zip([1e-3, -7e-4, 3e-4, 2e-4, -3e-4, 4e-4, -2e-4])
            {
                *four_bar.term_mut(term) += change;
            }
        }
        (folder.display().to_string(), robot, model)
    });
    changed.collect()
}

fn written<'a>(robot: &'a Robot, model: &'a CalibrationModel, remarks: &'a [String]) -> RobotText<'a> {
    let urdf = robot.sources.iter().find(|(role, _)| role == "urdf");
    RobotText {
        name: &robot.name,
        model,
        targets: &[],
        visuals: &robot.visuals,
        urdf: urdf.map(|(_, source)| source),
        remarks,
    }
}

#[test]
fn every_shipped_robot_is_the_same_from_its_calibrated_files() {
    let remarks = ["told -- first".to_owned()];
    let mut elastic = 0;
    for (name, robot, model) in calibrated_models() {
        let targets = [TargetText { name: "smr", in_flange: Vector3::new(0.1, -0.2, 0.3), rotation: None }];
        let text = RobotText { targets: &targets, ..written(&robot, &model, &remarks) };
        let files = write_robot(&text).unwrap_or_else(|error| panic!("{name}: {error}"));
        let read = &files.read;
        assert_eq!(read.targets[0].name.as_deref(), Some("smr"));
        assert_eq!(read.visuals.len(), robot.visuals.len().max(1 + model.kinematics.joint_count()));
        if !robot.visuals.is_empty() {
            assert_eq!(read.visuals, robot.visuals, "{name}: the shapes are others");
        }
        let target = targets[0].in_flange;
        let commands = commands(&model, 100);
        let rigid = apart([&model, &read.model].map(|model| rigid(model, target)).each_ref(), &commands);
        let own = apart(
            [&model, &read.model].map(|model| alone(model, Mode::Extended, target)).each_ref(),
            &commands,
        );
        println!("{name}: rigid {rigid:.1e} m, at its own equilibrium {own:.1e} m");
        assert!(rigid <= 1e-12 && own <= 1e-12, "{name}: {rigid:.1e} {own:.1e}");
        elastic += usize::from(model.statics.is_some());
        // Written again from what was read, nothing changes any more.
        let again = write_robot(&RobotText { model: &read.model, ..text }).expect("written again");
        assert!(
            apart(
                [&read.model, &again.read.model].map(|m| alone(m, Mode::Extended, target)).each_ref(),
                &commands
            ) <= 1e-12
        );
    }
    assert!(elastic >= 2, "nothing yielded");
}

#[test]
fn the_calibrated_robot_file_predicts_what_was_identified() {
    for outcome in [&*PAINTER, &outcome_of("scenarios/zoo/ur5.toml")] {
        let robot = robot_of(outcome);
        for estimate in estimates(outcome) {
            let full = &estimate.estimate.robot;
            let handover = hand_over(&estimate, Some(&robot)).expect("handed over");
            assert_eq!(handover.files.iter().map(|file| file.name).collect::<Vec<_>>(), FILES);
            let read = read_back(&handover);
            let commands: Vec<_> =
                outcome.sets[0].measurements.observations.iter().map(|o| o.command.clone()).collect();
            let target = full.targets[0];
            assert!((read.target().expect("stated") - target).norm() < 1e-15);
            let rigid =
                apart([&full.model, &read.model].map(|model| rigid(model, target)).each_ref(), &commands);
            assert!(rigid <= 1e-12, "{}: {rigid:.1e}", full.mode.key());
            if full.mode.is_coupled() {
                let models = [&full.model, &read.model];
                let off =
                    apart(models.map(|model| alone(model, Mode::Extended, target)).each_ref(), &commands);
                assert!(off <= 1e-12, "{}: {off:.1e}", full.mode.key());
                assert!(read.model.statics.is_some() || full.model.statics.is_none());
            }
            // In the terms' place, the robot with them predicts the same as well.
            let with_terms = CalibratedRobot { model: read.model.clone(), ..full.clone() };
            let off = apart([full, &with_terms], &commands);
            assert!(off <= 1e-12, "{off:.1e}");
            losses_are_those_of_the_files(&estimate, &handover);
        }
    }
}

/// Losses fall with what a form holds, and where nothing is lost, they are none.
fn losses_are_those_of_the_files(estimate: &EstimateFile, handover: &Handover) {
    let full = &estimate.estimate.robot;
    let loss = |index: usize| handover.losses.files[index].loss.rms_3d_m;
    println!("{}\n{}", estimate.robot.name, calibrig::handover::losses_text(&handover.losses));
    assert!(handover.losses.files.iter().all(|kept| kept.loss.poses == 400));
    if full.terms.is_empty() && full.mode != Mode::WithGravity {
        assert!(loss(0) <= 1e-12, "{}", loss(0));
    }
    if full.mode == Mode::OnlyCalibration {
        assert!(loss(1) <= 1e-9, "{}", loss(1));
    }
    // Fitted to other poses of the same region, more offsets do better.
    assert!(loss(4) <= 1.05 * loss(5) && loss(4) <= 1.05 * loss(6), "{:?}", handover.losses);
}

/// A robot whose joints' zeros and tool alone are off: the offsets are these.
#[test]
fn offsets_that_are_all_there_is_are_found() {
    let outcome = outcome_of("scenarios/zoo/ur5.toml");
    let mut estimate = EstimateFile::of(&outcome, None).expect("an estimate");
    let robot = &mut estimate.estimate.robot;
    (robot.mode, robot.terms) = (Mode::OnlyCalibration, Vec::new());
    let offsets = [2e-3, -1e-3, 3e-3, 1.5e-3, -2e-3, 0.0];
    robot.model = robot.nominal.clone();
    for (link, offset) in robot.model.kinematics.links.iter_mut().zip(offsets) {
        link.theta += offset;
    }
    let handover = hand_over(&estimate, None).expect("handed over");
    let rows: Vec<_> =
        file(&handover, "offsets.csv").lines().filter(|line| line.starts_with("joint,")).collect();
    assert_eq!(rows.len(), 6);
    // The last joint's zero and the tool turned about its axis do the same.
    for (row, offset) in rows.iter().zip(offsets).take(5) {
        let found: f64 = row.split(',').nth(3).expect("a column").parse().expect("a number");
        assert!((found - offset).abs() < 1e-9, "{row}");
    }
    let kept = &handover.losses.files[5];
    assert!(kept.holds == "joint offsets and tool" && kept.loss.max_3d_m < 1e-9, "{kept:?}");
    // What the tool alone cannot do is told.
    assert!(handover.losses.files[6].loss.rms_3d_m > 1e-4);
}

#[test]
fn another_reader_of_urdfs_has_the_calibrated_positions() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let remarks = ["a remark".to_owned()];
    let mut questions = Vec::new();
    let mut expected: Vec<Vec<Transform>> = Vec::new();
    for (number, (name, robot, model)) in calibrated_models().into_iter().enumerate() {
        let files =
            write_robot(&written(&robot, &model, &remarks)).unwrap_or_else(|error| panic!("{name}: {error}"));
        let path = folder.path().join(format!("{number}.urdf"));
        std::fs::write(&path, &files.urdf.text).expect("written");
        let chain = &model.kinematics;
        let mut poses = Vec::new();
        let mut frames = Vec::new();
        for command in commands(&model, 200) {
            let mut joints = vec![0.0; chain.joint_count()];
            model.actuators.joints_from_command(&command, &mut joints);
            let named = chain.links.iter().zip(&joints).enumerate();
            // Joints that follow others do so by themselves.
            let follows = |name: &str| {
                let behind =
                    files.urdf.text.split(&format!("<joint name=\"{name}\"")).nth(1).expect("a joint");
                behind.split("</joint>").next().is_some_and(|joint| joint.contains("<mimic"))
            };
            let commanded = named.filter(|(_, (link, _))| !follows(&link.name));
            let pose: serde_json::Map<_, _> =
                commanded.map(|(_, (link, q))| (link.name.clone(), json!(q))).collect();
            poses.push(Value::from(pose));
            frames.push(forward_kinematics(chain, &joints).expect("joints"));
        }
        let base = files
            .urdf
            .text
            .split("<link name=\"")
            .nth(1)
            .and_then(|rest| rest.split('"').next())
            .expect("a link");
        let tip =
            if files.urdf.text.contains("\"calibrated_flange\"") { "calibrated_flange" } else { "flange" };
        questions
            .push(json!({ "file": path.display().to_string(), "base": base, "tip": tip, "poses": poses }));
        expected.push(frames);
    }
    let Some(answers) = asked(&Value::from(questions)) else { return };
    for ((answers, expected), question) in answers.iter().zip(&expected).zip(0..) {
        for (found, expected) in answers.iter().zip(expected) {
            let matrix = expected.to_homogeneous();
            let off = (0..16).map(|i| (found[i] - matrix[(i / 4, i % 4)]).abs()).fold(0.0, f64::max);
            assert!(off <= 1e-9, "robot {question}: {off:.1e}");
        }
    }
}

#[test]
fn files_are_made_from_a_recording_and_again_from_the_estimate() {
    let sandbox = Sandbox::new();
    write_mcap(&PAINTER.story(), &sandbox.path("recording.mcap")).expect("a recording");
    let export = ["export", "calibrated", "recording.mcap", "--out", "calibrated"];
    let ended = sandbox.run(export);
    assert!(matches!(ended.code, Some(0 | 3)), "{ended:?}");
    assert!(ended.stdout.contains("offsets.csv"), "{ended:?}");
    for name in FILES {
        assert!(sandbox.path("calibrated").join(name).is_file(), "{name}");
    }
    assert!(!ended.stderr.contains("differs from the recording"), "{ended:?}");
    let estimate = EstimateFile::read(&sandbox.path("calibrated/estimate.json")).expect("as written");
    assert_eq!(estimate.estimate.robot, PAINTER.modes.last().expect("modes").robot);
    assert_eq!(estimate.robot.model_sha256, model_sha256(&PAINTER.model));

    assert_refused(&sandbox, &export, "calibrated/estimate.json", "there already", "--force");
    let model = "models/spray_painter/robot.toml";
    let again =
        ["export", "calibrated", "calibrated/estimate.json", "--model", model, "--out", "again", "--json"];
    let ended = sandbox.run(again);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert_eq!(ended.json()["schema"], "calibrig.losses/1");
    for name in FILES {
        assert!(
            sandbox.read(&format!("calibrated/{name}")) == sandbox.read(&format!("again/{name}")),
            "{name}"
        );
    }
    let mode = ["export", "calibrated", "recording.mcap", "--mode", "only_calibration", "--out", "rigid"];
    let ended = sandbox.run(mode);
    assert!(matches!(ended.code, Some(0 | 3)), "{ended:?}");
    let rigid = EstimateFile::read(&sandbox.path("rigid/estimate.json")).expect("as written");
    assert_eq!(rigid.estimate.robot.mode, Mode::OnlyCalibration);

    let file = "calibrated/estimate.json";
    let other = "models/ur5/robot.toml";
    let hash = model_sha256(&load_robot(&sandbox.path(other)).expect("a robot").model);
    let refused = ["export", "calibrated", file, "--model", other, "--out", "other"];
    assert_refused(&sandbox, &refused, other, &hash, "the robot file that the estimate was made with");
    assert_refused(&sandbox, &refused, other, &estimate.robot.model_sha256, "the robot file");
    let refused = ["export", "calibrated", file, "--mode", "only_calibration", "--out", "other"];
    assert_refused(&sandbox, &refused, file, "no estimate of mode only_calibration", "its own mode");
    sandbox.write("taken", "a file");
    let refused = ["export", "calibrated", file, "--out", "taken"];
    assert_refused(&sandbox, &refused, "cannot write to the folder taken", "no folder", "a folder");
    let half = sandbox.read(file);
    sandbox.write("half.json", &half[..half.len() / 2]);
    let refused = ["export", "calibrated", "half.json", "--out", "other"];
    assert_refused(&sandbox, &refused, "half.json:", "EOF", "a whole file");
    sandbox.write("wrong.json", half.replacen("\"value\": ", "\"value\": true, \"x\": ", 1));
    let refused = ["export", "calibrated", "wrong.json", "--out", "other"];
    assert_refused(&sandbox, &refused, "wrong.json:", "expected a number", "the keys of calibrig.estimate/1");
    let ended = sandbox.run(["export", "calibrated", "not.json", "--out", "other"]);
    assert!(ended.code == Some(1) && ended.stderr.contains("not.json"), "{ended:?}");
}

#[test]
fn a_file_that_is_no_estimate_is_refused_with_its_place() {
    let text = EstimateFile::of(&PAINTER, Some(Mode::ElastoGeometric)).expect("one").text().expect("JSON");
    let refusal = |text: &str| {
        EstimateFile::parse(&Source::new("estimate.json", text))
            .err()
            .map(|error| format!("{error} {error:?}"))
    };
    let assert_says = |text: &str, words: &[&str]| {
        let said = refusal(text).expect("refused");
        for word in words.iter().chain(&["estimate.json"]) {
            assert!(said.contains(word), "{word}: {}", &said[..said.len().min(400)]);
        }
    };
    assert_eq!(refusal(&text), None);
    assert_says("", &["cut short or empty"]);
    for part in 1..16 {
        let end =
            (text.len() * part / 16..=text.len()).find(|end| text.is_char_boundary(*end)).expect("an end");
        assert_says(&text[..end], &["cut short or empty"]);
    }
    assert_says(
        &text.replace("calibrig.estimate/1", "calibrig.estimate/9"),
        &["calibrig.estimate/9", "calibrig.estimate/1"],
    );
    assert_says("{}", &["schema is missing"]);
    assert_says("[1, 2]", &["expected"]);
    assert_says(
        &text.replacen("\"chi2\": ", "\"chi2\": NaN, \"x\": ", 1),
        &["expected JSON; numbers are finite"],
    );
    assert_says(&text.replacen("\"covariance\": ", "\"covariance\": 1, \"x\": ", 1), &["invalid type"]);
    assert_says(
        &text.replacen("\"covariance\": ", "\"covariance\": [[1.0]], \"x\": ", 1),
        &["covariance: 1 rows for"],
    );
    assert_says(&text.replacen("\"region\": ", "\"elsewhere\": ", 1), &["missing field `region`"]);
    assert_says(&text.replacen("\"name\": \"delta_", "\"name\": \"gamma_", 1), &["gamma_", "delta_a2"]);
    assert_says(&text.replacen("\"unit\": \"m\"", "\"unit\": \"mm\"", 1), &["has the unit"]);
    // The nominal model changed: both hashes are told.
    let at = text.find("\"nominal\": {").expect("the nominal model");
    let changed = format!("{}{}", &text[..at], text[at..].replacen("0.626", "0.627", 1));
    assert_ne!(changed, text);
    assert_says(&changed, &["the nominal model has the hash", &model_sha256(&PAINTER.model)]);
}

/// Every number and word of a file in turn at the extremes: refused, or an estimate whose predictions are numbers or errors.
#[test]
fn no_value_of_an_estimate_causes_a_panic() {
    let mut outcome = outcome_of("scenarios/zoo/irb460.toml");
    for mode in &mut outcome.modes {
        if let Some(estimate) = &mut mode.estimate {
            (estimate.iterations, estimate.weights) = (Vec::new(), Vec::new());
        }
    }
    let file = EstimateFile::of(&outcome, None).expect("an estimate");
    let text = file.text().expect("JSON");
    let command = outcome.sets[0].measurements.observations[0].command.clone();
    let mut values = Vec::new();
    let mut from = 0;
    for (at, mark) in text.char_indices() {
        if [',', ':', '[', ']', '{', '}', '\n'].contains(&mark) {
            if text[from..at]
                .trim()
                .starts_with(|c: char| c.is_ascii_digit() || c == '-' || c == 'n' || c == '"')
            {
                values.push(from..at);
            }
            from = at + 1;
        }
    }
    let extremes =
        ["0", "-1", "1e300", "-1e300", "5e-324", "4294967296", "null", "\"inf\"", "[]", "{}", "true"];
    let stride = super::repeated(1, 37) as usize;
    let (mut read, mut refused) = (0, 0);
    for (number, value) in values.iter().enumerate().filter(|(number, _)| number % stride == 0) {
        let extreme = extremes[(number / stride) % extremes.len()];
        let edited = format!("{}{extreme}{}", &text[..value.start], &text[value.end..]);
        match EstimateFile::parse(&Source::new("estimate.json", edited)) {
            Ok(file) => {
                read += 1;
                if let Ok(there) = file.estimate.predict(PoseQuery::at(&command)) {
                    assert!(there.position.iter().all(|v| !v.is_nan()), "{extreme} at {value:?}");
                }
            }
            Err(_) => refused += 1,
        }
    }
    println!("{read} read, {refused} refused");
    assert!(read > 0 && refused > 0);
}

/// What a form of the robot cannot hold is told in it.
#[test]
fn what_a_file_cannot_hold_is_said_in_it() {
    let estimate = EstimateFile::of(&PAINTER, Some(Mode::Extended)).expect("an estimate");
    let handover = hand_over(&estimate, Some(&robot_of(&PAINTER))).expect("handed over");
    assert!(matches!(estimate.estimate.robot.model.actuators, ActuatorMap::Parallelogram { .. }));
    for name in ["robot.toml", "robot.urdf", "dh_craig.csv", "dh_standard.csv", "offsets.csv"] {
        let text = file(&handover, name);
        for said in ["estimate.json", "The elbow is driven by a parallelogram", &estimate.robot.model_sha256]
        {
            assert!(text.contains(said), "{name} does not say {said}");
        }
    }
    for name in ["dh_craig.csv", "dh_standard.csv", "offsets.csv"] {
        assert!(file(&handover, name).contains("Against the full model, at 400 poses"), "{name}");
    }
    let kinds: Vec<_> = estimate.estimate.robot.model.kinematics.links.iter().map(|link| link.kind).collect();
    assert_eq!(kinds.iter().filter(|kind| **kind == JointKind::Prismatic).count(), 2);
}
