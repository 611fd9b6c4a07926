//! A recording alone gives the same estimate, and the estimate depends on nothing but the measurements.

use std::io::Cursor;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use calibrig::identification::{Loss, Mode, Warning};
use calibrig::pipeline::{self, Outcome, PlantKind, calibrate};
use calibrig::recording::{McapRecorder, Preamble, SessionRecorder, write_mcap};
use calibrig::replay::{Change, ReplayOptions, recorded_truth, replay};
use calibrig::report::json_report;

use crate::a_user_reproduces_the_paper::{paper, rigid_paper};
use crate::repeated;
use crate::sandbox::{SCENARIO, Sandbox};

#[test]
fn replay_finds_the_same_bits_for_every_seed() {
    let scenario = paper();
    let folder = tempfile::tempdir().expect("a temporary folder");
    for seed in 0..u64::from(repeated(20, 5)) {
        let outcome = pipeline::run(&scenario, seed, |_, _| {}).expect("a run");
        let path = folder.path().join(format!("{seed}.mcap"));
        write_mcap(&outcome.story(), &path).expect("a recording");
        let replayed = replay(&path, &ReplayOptions::default()).expect("a replay");
        assert_eq!(replayed.compared, 4);
        assert!(replayed.differences.is_empty(), "{:?}", replayed.differences);
        assert!(replayed.outcome.truth.is_none());
        for (recorded, again) in outcome.modes.iter().zip(&replayed.outcome.modes) {
            assert_eq!(recorded.errors, again.errors, "{:?}", recorded.mode);
        }
    }
}

#[test]
fn one_seed_gives_one_recording() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let write = |name: &str| {
        let path = folder.path().join(name);
        let outcome = pipeline::run(&paper(), 3, |_, _| {}).expect("a run");
        write_mcap(&outcome.story(), &path).expect("a recording");
        std::fs::read(path).expect("the recording")
    };
    assert!(write("a.mcap") == write("b.mcap"), "the bytes differ");
}

#[test]
fn the_golden_recording_is_replayed_bit_for_bit() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/paper.mcap");
    assert!(std::fs::metadata(&path).expect("it is in the repository").len() <= 2_000_000);
    let replayed = replay(&path, &ReplayOptions::default()).expect("a replay");
    assert_eq!(replayed.compared, 4);
    assert!(replayed.differences.is_empty() && replayed.missing.is_empty(), "{:?}", replayed.differences);
    // The truth of a simulation is at hand for its report, and for nothing before it.
    assert!(replayed.outcome.truth.is_none());
    let truth = recorded_truth(&path).expect("read").expect("the machine of the recorded scenario");
    let outcome = Outcome { truth: Some(truth), ..replayed.outcome };
    let json = json_report(&outcome);
    assert!(json.parameters.iter().filter(|parameter| parameter.truth.is_some()).count() > 30);
}

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/recording").join(name)
}

/// Estimates of an earlier version, other in their last bits or by much: told in standard deviations and mm, and no reason for doubt.
#[test]
fn what_another_version_estimated_is_compared_and_no_difference_is_doubted() {
    let sandbox = Sandbox::new();
    for (name, modes) in [("schema1.mcap", 1), ("method1.mcap", 4)] {
        let path = fixture(name);
        let replayed = replay(&path, &ReplayOptions::default()).expect("a replay");
        let made_by = replayed.made_by_another.as_ref().expect("an earlier version");
        assert_eq!((made_by.method, replayed.compared), (1, modes), "{name}");
        assert!(calibrig::METHOD > 1 && replayed.missing.is_empty());
        let ended = sandbox.run(["replay".as_ref(), path.as_os_str()]);
        assert_eq!(ended.code, Some(0), "{name}: {ended:?}");
        if replayed.differences.is_empty() {
            assert!(ended.stdout.contains("identical bit for bit"), "{name}: {ended:?}");
            continue;
        }
        for told in ["made by another version", "method 1", "standard deviations", "rms 3-D error, mm"] {
            assert!(ended.stdout.contains(told), "{name}: {told}: {ended:?}");
        }
        let json = sandbox.run(["replay".as_ref(), path.as_os_str(), "--json".as_ref()]);
        assert!(json.code == Some(0) && json.stderr.contains("made by another version"), "{name}: {json:?}");
        json.json();
    }
    // Its estimates are known to be others than today's.
    assert!(
        !replay(&fixture("schema1.mcap"), &ReplayOptions::default()).expect("read").differences.is_empty()
    );
}

/// The shift of one value: exit code 3 where this version recorded it. In the words of a replay of another version, its size.
#[test]
fn a_difference_within_a_version_is_doubted() {
    let sandbox = Sandbox::new();
    let mut outcome = pipeline::run(&paper(), 3, |_, _| {}).expect("a run");
    let path = sandbox.path("same.mcap");
    write_mcap(&outcome.story(), &path).expect("a recording");
    let replayed = replay(&path, &ReplayOptions::default()).expect("a replay");
    assert!(
        replayed.made_by_another.is_none() && replayed.parameters.is_empty(),
        "{:?}",
        replayed.made_by_another
    );

    let estimate = outcome.modes[1].estimate.as_mut().expect("an estimate");
    let p = &mut estimate.parameters[4];
    p.value += 0.25 * p.sigma.expect("regular");
    let name = p.id.to_string();
    let path = sandbox.path("moved.mcap");
    write_mcap(&outcome.story(), &path).expect("a recording");
    let replayed = replay(&path, &ReplayOptions::default()).expect("a replay");
    let [change] = replayed.parameters.as_slice() else { panic!("{:?}", replayed.parameters) };
    assert_eq!((&change.name, change.mode, replayed.differences.len()), (&name, Mode::OnlyCalibration, 1));
    assert!((change.in_sigmas().expect("regular") + 0.25).abs() < 1e-6, "{change:?}");
    let ended = sandbox.run(["replay", "moved.mcap"]);
    assert!(
        ended.code == Some(3) && ended.stderr.contains(&format!("replay differs: only_calibration, {name}"))
    );
}

#[test]
fn other_options_ask_what_if() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/paper.mcap");
    let ask = |options: ReplayOptions| replay(&path, &options).expect("a replay");
    let only = vec![Mode::OnlyCalibration];
    let same = ask(ReplayOptions { modes: only.clone(), ..ReplayOptions::default() });
    assert_eq!((same.compared, same.differences.len()), (1, 0));
    assert_eq!(same.outcome.modes.len(), 2, "the robot without calibration is always shown");
    let same = same.changes.iter().filter(|change| change.mode == Mode::OnlyCalibration);
    assert!(same.clone().count() == 2 && same.clone().all(|change| change.recorded == change.replayed));

    let dropped_topics = vec!["/nest".to_owned()];
    let free = ask(ReplayOptions { modes: only.clone(), dropped_topics, ..ReplayOptions::default() });
    assert!(free.what_if && free.compared == 0);
    let moved = |change: &Change| {
        change.mode == Mode::OnlyCalibration
            && change.replayed.is_some()
            && change.recorded != change.replayed
    };
    assert!(free.changes.iter().any(moved), "{:?}", free.changes);

    let robust = ask(ReplayOptions { modes: only, loss: Some(Loss::tukey()), ..ReplayOptions::default() });
    let weights = robust.outcome.modes[1].estimate.as_ref().expect("an estimate");
    assert!(robust.changes.iter().any(moved), "{:?}", weights.outliers);
}

#[test]
fn the_report_is_made_again_from_the_recording() {
    let sandbox = Sandbox::new();
    assert_eq!(sandbox.run(["run", SCENARIO, "--out", "out"]).code, Some(0));
    let again = sandbox.run(["report", "out/recording.mcap", "--out", "again"]);
    assert_eq!(again.code, Some(0), "{again:?}");
    let report = |folder: &str| {
        let text = sandbox.read(&format!("{folder}/report.json"));
        let mut json: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        // One came from a scenario, the other from its recording.
        json["input"]["kind"].take();
        json
    };
    assert!(report("out") == report("again"), "the reports differ");
    assert!(sandbox.read("again/report.html").contains("truth"), "the truth is shown");
}

#[test]
fn threads_and_folders_leave_no_mark_in_a_recording() {
    let bytes = |threads: &str| {
        let sandbox = Sandbox::new();
        // As shipped: without its effects, the terms for them do harm and are doubted.
        sandbox.write(SCENARIO, std::fs::read_to_string(SCENARIO).expect("the shipped scenario"));
        let mut run = sandbox.command(["run", SCENARIO, "--out", "out", "--seed", "7"]);
        assert!(run.env("RAYON_NUM_THREADS", threads).output().expect("the binary starts").status.success());
        std::fs::read(sandbox.path("out/recording.mcap")).expect("the recording")
    };
    let once = bytes("1");
    assert!(once == bytes("8"), "the bytes differ");
}

/// What is recorded while the session goes on is what is recorded of it afterwards.
#[test]
fn a_session_recorded_while_it_is_measured_gives_the_same_bytes() {
    let scenario = paper();
    let seed = 3;
    let input = pipeline::input_of(&scenario, seed, 0, PlantKind::Rapier);
    let preamble = Preamble {
        input: &input,
        sources: &scenario.sources,
        model: &scenario.robot.model,
        visuals: &scenario.robot.visuals,
        truth: None,
    };
    let mut live = Cursor::new(Vec::new());
    let mcap = McapRecorder::new(&mut live).expect("begun");
    let mut recorder = SessionRecorder::new(preamble, mcap);
    let outcome = pipeline::run_trial(&scenario, seed, 0, PlantKind::Rapier, &mut |event| {
        recorder.hear(event).expect("recorded");
        ControlFlow::Continue(())
    })
    .expect("a run");
    recorder.evaluated(&outcome.story()).and_then(McapRecorder::finish).expect("finished");
    let live = live.into_inner();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("recording.mcap");
    write_mcap(&outcome.story(), &path).expect("a recording");
    assert!(live == std::fs::read(path).expect("the recording"), "the bytes differ");
}

/// The hypocrisy check: with the measurements held fixed, another truth must not move one bit of any estimate.
#[test]
fn the_truth_does_not_reach_the_estimate() {
    let scenario = paper();
    let told =
        pipeline::simulate(&scenario, 5, 0, pipeline::PlantKind::Rapier, |_, _| {}).expect("a simulation");
    let estimates = |scenario: &calibrig::scenario::Scenario| {
        calibrate(&scenario.robot.model, &told.sets, &scenario.modes, &scenario.options).expect("estimates").1
    };
    let mut other = paper();
    for link in &mut other.as_built.kinematics.links {
        link.a += 0.1;
        link.theta += 0.1;
    }
    other.as_built.statics.drive_stiffness.fill(1e4);
    other.tracker.instrument.noise = false;
    let (a, b) = (estimates(&scenario), estimates(&other));
    assert_eq!(a, b);
}

/// A machine with something that the model lacks must be found out.
#[test]
fn an_effect_that_the_model_lacks_fails_the_consistency_test() {
    let scenario = paper();
    let outcome = pipeline::run(&scenario, scenario.seed, |_, _| {}).expect("a run");
    let warned = |mode: Mode| {
        let estimate = outcome.modes.iter().find(|m| m.mode == mode).and_then(|m| m.estimate.as_ref());
        estimate.expect("an estimate").warnings.iter().any(|w| matches!(w, Warning::Inconsistent { .. }))
    };
    assert!(warned(Mode::OnlyCalibration), "gravity is not in the model");

    let rigid = rigid_paper();
    let outcome = pipeline::run(&rigid, rigid.seed, |_, _| {}).expect("a run");
    let estimate = outcome.modes[1].estimate.as_ref().expect("an estimate");
    assert!(
        !estimate.warnings.iter().any(|w| matches!(w, Warning::Inconsistent { .. })),
        "{:?}",
        estimate.warnings
    );
}
