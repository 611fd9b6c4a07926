//! A user says how the session is carried out: stations, targets, visits, nests again and again, what hides what.

use std::io::Cursor;
use std::ops::ControlFlow;
use std::path::Path;

use calibrig::identification::Mode;
use calibrig::measurement::{DriftVerdict, MeasurementSet, remove_drift};
use calibrig::montecarlo::Campaign;
use calibrig::pipeline::{self, PlantKind, calibrate, simulate, without_drift};
use calibrig::plant::session::{NestRounds, SessionPlan, Timing};
use calibrig::plant::tracker::{Conditions, DriftLaw, Motion};
use calibrig::recording::{
    McapRecorder, Preamble, ReadOptions, SessionRecorder, read_recording_with, write_mcap,
};
use calibrig::replay::{ReplayOptions, recorded_truth, replay};
use calibrig::report::{Style, html_report, json_report, render_tables};
use calibrig::scenario::{Scenario, load_scenario, parse_scenario};

use crate::sandbox::{Sandbox, assert_refused};

const SESSION: &str = "scenarios/session.toml";

fn shipped() -> Scenario {
    load_scenario(Path::new(SESSION)).expect("the shipped scenario")
}

/// The session of the recorded scenario is what was recorded: nothing that was added to sessions since moves a bit of it.
#[test]
fn the_recorded_session_is_measured_again_bit_for_bit() {
    let path = Path::new("recordings/paper.mcap");
    let recording = read_recording_with(path, &ReadOptions::default()).expect("the golden recording");
    let robot = recording.robot().expect("read").expect("a robot");
    let source = recording.source("scenario").cloned().expect("a scenario");
    let scenario = parse_scenario(source, robot).expect("a scenario");
    let told = simulate(&scenario, scenario.seed, 0, PlantKind::Rapier, |_, _| {}).expect("a session");
    assert_eq!(told.sets.len(), 2);
    for (now, then) in told.sets.iter().zip(&recording.sets) {
        assert_eq!(now.measurements.observations, then.measurements.observations);
        assert_eq!(now.measurements.stations, then.measurements.stations);
        assert_eq!(now.measurements.targets, then.measurements.targets);
    }
}

#[test]
fn three_reflectors_and_two_stations_go_through_run_replay_campaign_and_report() {
    let scenario = shipped();
    let input = pipeline::input_of(&scenario, 2, 0, PlantKind::Rapier);
    let preamble = Preamble {
        input: &input,
        sources: &scenario.sources,
        model: &scenario.robot.model,
        visuals: &scenario.robot.visuals,
        truth: None,
    };
    let mut live = Cursor::new(Vec::new());
    let mut recorder = SessionRecorder::new(preamble, McapRecorder::new(&mut live).expect("begun"));
    let outcome = pipeline::run_trial(&scenario, 2, 0, PlantKind::Rapier, &mut |event| {
        recorder.hear(event).expect("recorded");
        ControlFlow::Continue(())
    })
    .expect("a run");
    recorder.evaluated(&outcome.story()).and_then(McapRecorder::finish).expect("finished");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("session.mcap");
    write_mcap(&outcome.story(), &path).expect("a recording");
    assert!(live.into_inner() == std::fs::read(&path).expect("the recording"), "live and after differ");

    let set = &outcome.sets[0].measurements;
    let used = |of: fn(&calibrig::measurement::Observation) -> usize| {
        let mut all: Vec<usize> = set.observations.iter().map(of).collect();
        all.sort_unstable();
        all.dedup();
        all
    };
    assert_eq!((used(|o| o.station), used(|o| o.target)), (vec![0, 1], vec![0, 1, 2]));
    // Two visits of up to three targets, some of them hidden.
    assert!((120..=180).contains(&set.observations.len()), "{}", set.observations.len());
    assert_eq!(set.stations[0].nests.len(), 7);
    assert!(outcome.as_measured[0].measurements.stations[0].nests.len() > 7 * 8);
    assert_eq!(outcome.drift.len(), 2);

    let replayed = replay(&path, &ReplayOptions::default()).expect("a replay");
    assert!(replayed.compared > 0 && replayed.differences.is_empty(), "{:?}", replayed.differences);
    assert_eq!(replayed.outcome.drift, outcome.drift);
    let truth = recorded_truth(&path).expect("read").expect("the machine of the recorded scenario");
    assert_eq!(truth.stations, outcome.truth.as_ref().expect("simulated").stations);
    assert_eq!((truth.stations.len(), truth.further_targets.len()), (2, 2));

    let json = json_report(&outcome);
    assert_eq!(json.drift.len(), 2);
    for name in ["target_x", "target2_y", "target3_z", "frame_x", "frame2_rz"] {
        let parameter =
            json.parameters.iter().find(|p| p.name == name).unwrap_or_else(|| panic!("no {name}"));
        let (truth, sigma) = (parameter.truth.expect(name), parameter.sigma.expect(name));
        let estimate = parameter.estimate.expect(name);
        assert!((estimate - truth).abs() < 5.0 * sigma, "{name}: {estimate} is {truth} +- {sigma}");
    }
    let page = html_report(&outcome).expect("a page");
    assert!(page.contains("The tracker's own motion") || page.contains("The tracker&#39;s own motion"));
    assert!(render_tables(&outcome, Style::Plain).contains("rounds of 7 nests"));

    let trial = Campaign::of_draws(&scenario, 2, PlantKind::Analytic).trial(1);
    let fit = trial.outcome.expect("a trial").modes.remove(1).fit.expect("an estimate");
    assert!(
        fit.sound && (0.5..1.5).contains(&fit.chi2_per_dof.expect("covariances")),
        "{:?}",
        fit.chi2_per_dof
    );
    assert_eq!(fit.predictions.1 % 3, 0);
}

/// The publication's robot with exactly its stated errors (a matched model), 300 poses, and a tracker whose stand moves.
fn drifting(motion: Option<DriftLaw>) -> Scenario {
    let mut scenario = load_scenario(Path::new("scenarios/matched.toml")).expect("the shipped scenario");
    scenario.identification_poses = 300;
    scenario.verification_poses = 0;
    scenario.modes = vec![Mode::ElastoGeometric];
    scenario.tracker.conditions = Conditions { drift: motion, ..Conditions::default() };
    scenario.plan = SessionPlan {
        timing: Timing { nest: 4.0, ..Timing::default() },
        rounds: NestRounds { every: 20, after: true, two_faces: false, timed: true },
        ..SessionPlan::default()
    };
    scenario
}

/// Through the fit of a matched robot: what is left after the correction is what is left of a tracker that stands still.
#[test]
fn drift_is_removed_before_the_fit_and_an_uncorrected_one_would_show() {
    let still = Motion { shift: 0.0, turn: 0.0 };
    let hours = f64::from(300 * 10 + 16 * 28) / 3600.0;
    let moving = Motion { shift: 50e-6, turn: 5e-6 };
    let ramp = Motion { shift: moving.shift / hours, turn: moving.turn / hours };
    let walk = Motion { shift: moving.shift / hours.sqrt(), turn: moving.turn / hours.sqrt() };
    let law = |ramp, walk| DriftLaw { ramp, warm_up: [still; 2], warm_up_time: 1.0, walk };
    let rms = |scenario: &Scenario, corrected: bool| {
        let told = simulate(scenario, 3, 0, PlantKind::Analytic, |_, _| {}).expect("a session");
        let sets = if corrected {
            let steady = without_drift(told.sets).expect("sound nests");
            assert_eq!(steady.drift.len(), 1);
            steady.sets
        } else {
            let mut sets = told.sets;
            // As a session without rounds: the nests of the first alone.
            let station = &mut sets[0].measurements.stations[0];
            station.nests.truncate(scenario.nests.len());
            // And nothing said of its drift, which the fit could look for.
            station.instrument = None;
            sets
        };
        let (_, modes) =
            calibrate(&scenario.robot.model, &sets, &scenario.modes, &scenario.options).expect("a fit");
        1e6 * modes[0].rows[0].expect("a row").rms_3d
    };
    let free = rms(&drifting(None), true);
    for (name, law, allowed) in [("ramp", law(ramp, still), 1.10), ("walk", law(still, walk), 1.40)] {
        let scenario = drifting(Some(law));
        let [uncorrected, corrected] = [false, true].map(|corrected| rms(&scenario, corrected));
        println!(
            "{name}: drift-free {free:.2} um, uncorrected {uncorrected:.2}, corrected {corrected:.2} um"
        );
        assert!(corrected < allowed * free, "{name}: {corrected} of {free} um");
        assert!(uncorrected > 1.3 * free, "{name}: {uncorrected} of {free} um");
    }
}

#[test]
fn files_with_rounds_of_nests_are_freed_from_drift_in_the_same_way() {
    let told = simulate(&shipped(), 4, 0, PlantKind::Analytic, |_, _| {}).expect("a session");
    let alone: MeasurementSet = told.sets[0].measurements.clone();
    let steady = remove_drift(&alone).expect("sound nests");
    let DriftVerdict::Removed(size) = &steady.stations[0].verdict else { panic!("{:?}", steady.stations[0]) };
    assert!(size.motion > 10e-6 && size.correction_rms > 1e-6);
    // The poses of the verification set have their nests behind those of the first.
    let both = without_drift(told.sets).expect("sound nests");
    assert_eq!(both.drift[0].rounds, steady.stations[0].rounds);
    assert_eq!(both.sets[0].measurements.observations, steady.measurements.observations);
}

#[test]
fn check_explains_the_session() {
    let sandbox = Sandbox::new();
    let text = sandbox.run(["check", SESSION]).stdout;
    for line in [
        "  session      ",
        "    stations   1, left; each pose from the station that sees most targets, of these the nearest",
        "    targets    SMR, SMR 2, SMR 3",
        "    poses      by short paths, 2 visits each, approached from below and above in turn, 30.0 mm or 2.00 deg; 34.0 s a pose",
        "    nests      before the first pose, again every 5 poses, and after the last",
        "    sight      blocked by the shapes of all links, targets turned to the tracker",
    ] {
        assert!(text.contains(line), "{line}\n{text}");
    }
    let json = sandbox.run(["check", SESSION, "--json"]).json();
    assert_eq!(json["session"]["targets"], 3);
    assert_eq!(json["session"]["readings_per_visit"], 3);
    // A scenario without the section says nothing of it.
    assert!(!sandbox.run(["check", "scenarios/matched.toml"]).stdout.contains("session"));
}

/// Behind the line `marker`, the first line that begins with `start` becomes `with`: the message, and what was expected.
#[test]
fn what_cannot_be_planned_is_refused_with_its_place() {
    let (session, nests, station, target, sight) = (
        "[session]",
        "[session.nests]",
        "[[session.station]]",
        "[[session.target]]",
        "[session.line_of_sight]",
    );
    for (marker, start, with, message, expected) in [
        (session, "repeats", "repeats = 0", "session.repeats is 0", "1 to 1000 visits"),
        (session, "approach ", "approach = \"sideways\"", "session.approach is \"sideways\"", "`both_sides`"),
        (session, "approach_mm", "approach_mm = 0", "session.approach_mm is 0", "above"),
        (session, "settling_s", "settling_s = -1", "session.settling_s is -1", "zero"),
        (session, "averaging_s", "averaging_s = 0", "session.averaging_s is 0", "above"),
        (session, "warm_up_s", "warm_up_h = 1", "unknown key `warm_up_h`", "`warm_up_s`"),
        (session, "order", "opening = [0, 0, 0]", "session.opening is [0.0, 0.0, 0.0]", "not all zero"),
        (nests, "every_poses", "every_poses = 0", "session.nests.every_poses is 0", "no such key"),
        (
            station,
            "name",
            "name = \"1\"",
            "session.station.name is \"1\", which is used already",
            "a different name",
        ),
        (station, "x_mm", "x_mm = 60000", "from station \"left\"", "the tracker's range"),
        (target, "name", "name = \" \"", "session.target.name is empty", "a different name"),
        (target, "y_mm", "y_mm = inf", "session.target.y_mm is inf", "finite"),
        (
            sight,
            "links",
            "links = \"capsules\"",
            "session.line_of_sight.capsule_radius_mm is missing",
            "radius of the capsules that stand for the links",
        ),
        (sight, "margin_mm", "capsule_radius_mm = 90", "links are not capsules", "links = \"capsules\""),
        (
            sight,
            "margin_mm",
            "acceptance_deg = 120",
            "session.line_of_sight.acceptance_deg is 120",
            "at most 90 deg",
        ),
    ] {
        let sandbox = Sandbox::new();
        let line = sandbox.replace_line(SESSION, marker, start, with);
        assert_refused_on(&sandbox, line, message, expected);
    }
}

#[track_caller]
fn assert_refused_on(sandbox: &Sandbox, line: usize, message: &str, expected: &str) {
    let ended = sandbox.run(["check", SESSION]);
    assert_eq!(ended.code, Some(1), "{ended:?}");
    assert!(ended.stderr.contains(message) && ended.stderr.contains(expected), "{message}\n{}", ended.stderr);
    // A section as a whole begins above the line of its key.
    let places: Vec<usize> = (line.saturating_sub(12)..=line).collect();
    let told = places.iter().any(|line| ended.stderr.contains(&format!("{SESSION}:{line}:")));
    assert!(told, "line {line}\n{}", ended.stderr);
    assert!(!ended.stderr.contains("panicked"));
}

#[test]
fn a_station_inside_the_robot_or_below_the_floor_is_refused() {
    for (x, y, z, message) in [
        (
            "0",
            "-150",
            "2000",
            "station \"left\" stands inside the robot, in base, at the middle of the working region",
        ),
        ("5200", "-900", "3200", "station \"left\" stands 500.0 mm below the floor"),
        ("-900", "-200", "2000", "base nests with the robot in the middle of its working region: "),
    ] {
        let sandbox = Sandbox::new();
        for (key, value) in [("x_mm", x), ("y_mm", y), ("z_mm", z)] {
            sandbox.replace_line(SESSION, "[[session.station]]", key, &format!("{key} = {value}"));
        }
        let text = sandbox.read(SESSION);
        let line = 1 + text.lines().position(|line| line == "[[session.station]]").expect("the station");
        let place = format!("{SESSION}:{line}:");
        assert_refused(&sandbox, &["check", SESSION], &place, message, "expected");
    }
}

/// A robot without shapes is told to have none, and seen past capsules or past nothing.
#[test]
fn a_robot_without_shapes_needs_a_choice() {
    let sandbox = Sandbox::new();
    let file = "models/spray_painter/robot.urdf";
    let text = sandbox.read(file);
    let bare: Vec<&str> = text
        .split("<visual")
        .enumerate()
        .map(
            |(i, part)| {
                if i == 0 { part } else { part.split_once("</visual>").map_or("", |(_, rest)| rest) }
            },
        )
        .collect();
    sandbox.write(file, bare.concat());
    let refused = sandbox.run(["check", SESSION]);
    assert!(
        refused.stderr.contains("has no box, cylinder or sphere")
            && refused.stderr.contains("links = \"capsules\""),
        "{refused:?}"
    );
    sandbox.replace_line(
        SESSION,
        "[session.line_of_sight]",
        "links",
        "links = \"capsules\"\ncapsule_radius_mm = 120",
    );
    let text = sandbox.run(["check", SESSION]);
    assert!(text.stdout.contains("blocked by links as capsules along the chain"), "{text:?}");
}
