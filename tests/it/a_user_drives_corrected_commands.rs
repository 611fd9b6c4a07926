//! From an estimate to an accurate robot: commands that every identified robot corrects, driven on the machine and measured again.

use std::ops::ControlFlow;
use std::path::Path;

use calibrig::evaluation::AccuracyRow;
use calibrig::evaluation::closed_loop::{ClosedLoop, row};
use calibrig::identification::Mode;
use calibrig::inverse::Criterion;
use calibrig::pipeline::{Outcome, PlantKind, SessionEvent, SetKind, close_loop, run_trial};
use calibrig::scenario::{CompensationPlan, GoalKind, Scenario, load_scenario};
use rayon::prelude::*;

use crate::a_user_reproduces_the_paper::paper;
use crate::sandbox::{SCENARIO, Sandbox, assert_refused};

/// The verification set alone, its planned commands corrected.
fn plain(goal: GoalKind) -> CompensationPlan {
    CompensationPlan {
        goal,
        axis: nalgebra::Vector3::z(),
        redundancy: None,
        compare: Vec::new(),
        cycles: None,
        path: None,
    }
}

fn run(scenario: &Scenario, trial: u32, plant: PlantKind) -> (Outcome, ClosedLoop) {
    let outcome = run_trial(scenario, 1, trial, plant, &mut |_: SessionEvent<'_>| ControlFlow::Continue(()))
        .expect("a session");
    let driven = close_loop(scenario, (1, trial, plant), &outcome, &mut |_, _| ControlFlow::Continue(()));
    let driven = driven.expect("[compensation]");
    assert!(driven.failures.is_empty(), "{:?}", driven.failures);
    (outcome, driven)
}

fn driven_row(driven: &ClosedLoop, mode: Mode) -> AccuracyRow {
    let own = driven.modes.iter().find(|own| own.mode == mode).expect("a mode of the scenario");
    own.row().expect("measured poses")
}

fn predicted_row(outcome: &Outcome, mode: Mode) -> AccuracyRow {
    let own = outcome.modes.iter().find(|own| own.mode == mode).expect("a mode of the scenario");
    own.rows[1].expect("measured poses")
}

/// The machine that the model describes, exact readings: what is corrected is where it should be, and a probe of the machine says so, which no part of the
/// identification has touched.
#[test]
fn a_robot_that_the_model_describes_comes_to_its_goals() {
    let mut scenario = load_scenario(Path::new("scenarios/matched.toml")).expect("the shipped scenario");
    scenario.tracker.instrument.noise = false;
    scenario.modes = vec![Mode::WithoutCalibration, Mode::ElastoGeometric];
    for goal in [GoalKind::Position, GoalKind::Axis, GoalKind::Pose] {
        scenario.compensation = Some(plain(goal));
        let (_, driven) = run(&scenario, 3, PlantKind::Analytic);
        let before = driven_row(&driven, Mode::WithoutCalibration);
        let after = driven_row(&driven, Mode::ElastoGeometric);
        println!("{goal:?}: {:.3} mm before, {:.2e} mm after", 1e3 * before.rms_3d, 1e3 * after.rms_3d);
        assert!(driven.modes.iter().all(|mode| mode.uncorrected.is_empty()));
        assert_eq!(after.count, 40);
        // What exact readings leave of the parameters is some nanometres; the correction closes to one.
        assert!(after.max_3d < 1e-6, "{}", after.max_3d);
        assert!(before.rms_3d > 1e-3, "{}", before.rms_3d);
    }
}

/// Nominal commands are those of the set: what is measured with them again is what was measured.
#[test]
fn the_set_measured_again_with_its_own_commands_is_the_same() {
    let mut scenario = paper();
    scenario.compensation = Some(plain(GoalKind::Axis));
    let (outcome, driven) = run(&scenario, 5, PlantKind::Rapier);
    let (again, once) =
        (driven_row(&driven, Mode::WithoutCalibration), predicted_row(&outcome, Mode::WithoutCalibration));
    assert!((again.mean - once.mean).norm() < 1e-9, "{again:?} {once:?}");
    assert!((again.max_3d - once.max_3d).abs() < 1e-9, "{again:?} {once:?}");
}

/// The row: over 20 draws, the mean error per axis after compensation is the model's own prediction error at poses that it has not seen.
#[test]
fn over_20_draws_compensated_commands_err_as_much_as_their_model_predicts() {
    let scenario = &mut paper();
    scenario.compensation = Some(plain(GoalKind::Axis));
    let floor = &mut load_scenario(Path::new("scenarios/paper_floor.toml")).expect("the shipped scenario");
    floor.compensation = Some(plain(GoalKind::Axis));
    let of = |scenario: &Scenario, trials: u32| -> Vec<(Outcome, ClosedLoop)> {
        (1..=trials).into_par_iter().map(|trial| run(scenario, trial, PlantKind::Rapier)).collect()
    };
    let (all, lowest) = (of(scenario, 20), of(floor, crate::repeated(20, 5)));
    let mean = |rows: &dyn Fn(&(Outcome, ClosedLoop)) -> AccuracyRow, of: &[(Outcome, ClosedLoop)]| {
        of.iter().map(|run| rows(run).mean).sum::<nalgebra::Vector3<f64>>() / of.len() as f64
    };
    for mode in scenario.modes.clone() {
        let after = mean(&|(_, driven)| driven_row(driven, mode), &all);
        let predicted = mean(&|(outcome, _)| predicted_row(outcome, mode), &all);
        let least = mean(&|(_, driven)| driven_row(driven, mode), &lowest);
        let published =
            scenario.published.iter().find(|(kind, own, _)| (*kind, *own) == (SetKind::Verification, mode));
        let mm = |v: nalgebra::Vector3<f64>| format!("{:.3} {:.3} {:.3}", 1e3 * v.x, 1e3 * v.y, 1e3 * v.z);
        println!(
            "{:24} after compensation {} mm, own prediction error {}, floor {}, published {:?}",
            mode.key(),
            mm(after),
            mm(predicted),
            mm(least),
            published.map(|(.., row)| [1e3 * row[1], 1e3 * row[3], 1e3 * row[5]])
        );
        for axis in 0..3 {
            let ratio = after[axis] / predicted[axis];
            assert!((ratio - 1.0).abs() <= 0.2, "{} axis {axis}: {ratio:.3}", mode.key());
        }
    }
}

/// The publication's point: of the commands that meet the same goals, those with the least predicted deflection droop least, and a model that does not know its
/// deflection errs least with them.
#[test]
fn the_load_criterion_takes_droop_out() {
    let scenario = &mut paper();
    let mut plan = plain(GoalKind::Axis);
    plan.compare = vec![None, Some(Criterion::LEAST_MOTION), Some(Criterion::LEAST_DEFLECTION)];
    scenario.compensation = Some(plan);
    scenario.modes = vec![Mode::WithoutCalibration, Mode::OnlyCalibration, Mode::WithGravity];
    let (_, driven) = run(scenario, 1, PlantKind::Rapier);
    let mean_droop: Vec<f64> = driven
        .criteria
        .iter()
        .map(|own| {
            let [mean, most] = own.droop.expect("a robot that bends");
            let row = own.corrected.expect("measured poses");
            println!(
                "{:12} droop {:.2} mm (most {:.2}), measured {:.3} {:.3} {:.3} mm, RMS {:.3}; {} missed",
                own.criterion.map_or_else(|| "as planned".to_owned(), |c| c.to_string()),
                1e3 * mean,
                1e3 * most,
                1e3 * row.mean.x,
                1e3 * row.mean.y,
                1e3 * row.mean.z,
                1e3 * row.rms_3d,
                own.missed
            );
            mean
        })
        .collect();
    let [planned, motion, deflection] = mean_droop.as_slice() else { panic!("three criteria") };
    // Nothing moves less than staying where one is planned to be.
    assert!((planned - motion).abs() < 1e-6, "{planned} {motion}");
    assert!(deflection < &(0.97 * planned), "{deflection} of {planned}");
}

#[test]
fn a_path_and_a_pose_test_are_driven_in_every_mode() {
    let scenario = &mut paper();
    let plan = scenario.compensation.as_mut().expect("the shipped scenario has it");
    plan.compare.clear();
    let (outcome, driven) = run(scenario, 2, PlantKind::Rapier);
    let path = driven.path.expect("a path");
    assert_eq!(path.modes.len(), outcome.modes.len());
    assert!(path.unreachable.is_empty(), "{:?}", path.unreachable);
    let rms: Vec<f64> = path.modes.iter().map(|mode| row(&mode.points).expect("points").rms_3d).collect();
    println!("path: {:?} mm", rms.iter().map(|v| 1e3 * v).collect::<Vec<_>>());
    assert!(rms[1] < 0.5 * rms[0] && rms[4] < rms[1], "{rms:?}");
    let test = driven.pose_test.expect("a pose test");
    let mean_ap = |index: usize| {
        let poses = &test.modes[index].1;
        assert_eq!(poses.len(), 5);
        poses.iter().map(|(ap, _)| ap.distance).sum::<f64>() / 5.0
    };
    println!("AP: {:?} mm", (0..5).map(|mode| 1e3 * mean_ap(mode)).collect::<Vec<_>>());
    assert!(mean_ap(1) < 0.5 * mean_ap(0) && mean_ap(4) < mean_ap(1));
    // Repeatability is the machine's: no command changes it.
    let rp = |index: usize| test.modes[index].1[0].1.repeatability;
    assert!((rp(4) / rp(0) - 1.0).abs() < 0.2, "{} {}", rp(4), rp(0));
}

#[test]
fn whoever_stops_is_told_how_far_it_came() {
    let mut scenario = paper();
    scenario.compensation = Some(plain(GoalKind::Position));
    let outcome =
        run_trial(&scenario, 1, 0, PlantKind::Rapier, &mut |_: SessionEvent<'_>| ControlFlow::Continue(()))
            .expect("a session");
    let mut seen = 0;
    let stopped = close_loop(&scenario, (1, 0, PlantKind::Rapier), &outcome, &mut |done, total| {
        assert_eq!(total, 200);
        assert!(done >= seen, "{done} after {seen}");
        seen = done;
        if done < 55 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    });
    let stopped = stopped.expect("what was driven");
    assert_eq!(seen, 55);
    assert_eq!(stopped.modes.len(), 1);
    let [failure] = stopped.failures.as_slice() else { panic!("{:?}", stopped.failures) };
    assert_eq!(failure.what, Mode::OnlyCalibration.title());
    assert_eq!(failure.why, "interrupted after 55 of 200 poses");
}

#[test]
fn the_report_and_the_recording_have_it() {
    let sandbox = Sandbox::driving_again();
    let run = sandbox.run(["run", SCENARIO, "--out", "out", "--json"]);
    let json: serde_json::Value = serde_json::from_str(&run.stdout).expect("JSON");
    let rows = json["sets"]["compensated"]["rows"].as_object().expect("the set `compensated`");
    assert_eq!(rows.len(), 5);
    assert_eq!(rows["extended"]["n"], 40);
    assert!(rows["extended"]["acceptance"]["isotropic_m"].as_f64().expect("a bound") > 0.0);
    let compensation = &json["compensation"];
    assert_eq!(compensation["goal"], "axis");
    assert_eq!(compensation["pose_test"]["modes"]["extended"].as_array().map(Vec::len), Some(5));
    assert!(compensation["path"]["rows"]["without_calibration"]["rms_3d_m"].as_f64().expect("a row") > 1e-3);
    let inspected = sandbox.run(["inspect", "out/recording.mcap", "--json"]).stdout;
    let inspected: serde_json::Value = serde_json::from_str(&inspected).expect("JSON");
    let topics: Vec<&str> = inspected["topics"]
        .as_array()
        .expect("topics")
        .iter()
        .filter_map(|topic| topic["topic"].as_str())
        .collect();
    for topic in [
        "/compensated/extended",
        "/compensated/path/without_calibration",
        "/scene/path",
        "/scene/path_x100/extended",
    ] {
        assert!(topics.contains(&topic), "{topic} in {topics:?}");
    }
    let replayed = sandbox.run(["replay", "out/recording.mcap"]);
    assert_eq!(replayed.code, Some(0), "{replayed:?}");
}

/// What cannot be driven costs no more than itself: the run has its reports, and says what failed.
#[test]
fn a_pose_test_that_cannot_be_is_told_and_the_rest_is_there() {
    let sandbox = Sandbox::driving_again();
    let narrow = |line: &str| match line.split_once(" = ") {
        Some(("half_width_mm", _)) => "half_width_mm = 2".to_owned(),
        Some(("half_width_rad", _)) => "half_width_rad = 0.001".to_owned(),
        Some(("modes", _)) => "modes = [\"without_calibration\", \"only_calibration\"]".to_owned(),
        _ => line.to_owned(),
    };
    let text: Vec<String> = sandbox.read(SCENARIO).lines().map(narrow).collect();
    sandbox.write(SCENARIO, text.join("\n"));
    let run = sandbox.run(["run", SCENARIO, "--out", "out", "--json"]);
    assert_eq!(run.code, Some(3), "{}", run.stderr);
    assert!(run.stderr.contains("not driven: the pose test"), "{}", run.stderr);
    let json = run.json();
    assert_eq!(
        json["compensation"]["failures"][0]["what"], "the pose test",
        "{}",
        json["compensation"]["failures"]
    );
    assert!(json["sets"]["compensated"]["rows"]["without_calibration"]["n"].as_u64() > Some(0));
    assert!(sandbox.path("out/recording.mcap").exists());
}

/// A section with one thing wrong.
#[test]
fn a_section_that_cannot_be_is_refused_at_its_line() {
    let mistakes = [
        (
            "goal =",
            "goal = \"place\"",
            "compensation.goal is \"place\"",
            "expected one of `position`, `axis`, `pose`",
        ),
        ("redundancy =", "redundancy = \"droop\"", "\"droop\" is not a criterion", "as_planned"),
        (
            "pose_test_cycles",
            "pose_test_cycles = 2",
            "compensation.pose_test_cycles is 2",
            "expected 3 to 1000 cycles",
        ),
        (
            "tool_axis =",
            "tool_axis = [0, 0, 0]",
            "compensation.tool_axis has no direction",
            "expected a direction",
        ),
        ("pitch_mm", "pitch_mm = 0", "compensation.path.pitch_mm is 0", "expected"),
        ("spacing_mm", "spacing_mm = 0.001", "compensation.path", "expected"),
        ("speed_mm_per_s", "speed_mm_per_s = nan", "compensation.path.speed_mm_per_s", "expected"),
    ];
    for (start, with, message, expected) in mistakes {
        let sandbox = Sandbox::driving_again();
        let changed = sandbox.replace_line(SCENARIO, "[compensation]", start, with);
        let place = format!("{SCENARIO}:");
        assert!(changed > 1);
        assert_refused(&sandbox, &["check", SCENARIO], &place, message, expected);
    }
}
