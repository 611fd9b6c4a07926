//! The published experiment: all rows about as published, and what a model with more terms makes of the same machine.

use std::path::Path;

use calibrig::evaluation::AccuracyRow;
use calibrig::identification::{Mode, neighbour_axis_rules};
use calibrig::model::{ActuatorMap, ParameterId};
use calibrig::montecarlo::{AccuracySet, Campaign, summarise_trials};
use calibrig::pipeline::{self, Outcome, PlantKind, SetKind};
use calibrig::plant::effects::{EffectKind, Effects};
use calibrig::scenario::{Scenario, load_scenario};
use calibrig::tracker::Conditions;

pub fn paper() -> Scenario {
    load_scenario(Path::new("scenarios/paper.toml")).expect("the shipped scenario")
}

/// The same robot with only repeatability, quantisation and the tracker on.
fn floor() -> Scenario {
    load_scenario(Path::new("scenarios/paper_floor.toml")).expect("the shipped scenario")
}

/// The paper's robot as "only calibration" takes it to be: rigid, its elbow driven by an exact parallelogram, with the published errors and
/// no others; the readings of its tracker scatter, and nothing else.
pub fn rigid_paper() -> Scenario {
    let mut scenario = paper();
    scenario.tracker.instrument.systematic_fraction = 0.0;
    scenario.tracker.conditions = Conditions::default();
    let machine = &mut scenario.as_built;
    machine.effects = Effects::default();
    machine.statics.make_rigid();
    machine.statics.linkage = None;
    if let ActuatorMap::Parallelogram { linkage, .. } = &mut machine.actuators {
        *linkage = None;
    }
    let nominal = &scenario.robot.model.kinematics;
    let published = neighbour_axis_rules(nominal).0;
    for id in ParameterId::all_of_links(nominal.joint_count()) {
        let ParameterId::Link { link, term } = id else { continue };
        if !published.contains(&id) {
            *machine.kinematics.links[link].term_mut(term) = nominal.links[link].term(term);
        }
    }
    scenario
}

fn row(outcome: &Outcome, set: usize, mode: Mode) -> AccuracyRow {
    let mode = outcome.modes.iter().find(|m| m.mode == mode).expect("a mode of the scenario");
    mode.rows[set].expect("measured poses")
}

/// Mean over the draws of (max x, mean x, max y, ...), m.
fn average(outcomes: &[Outcome], set: usize, mode: Mode) -> [f64; 6] {
    let mut sum = [0.0; 6];
    for outcome in outcomes {
        let row = row(outcome, set, mode);
        for axis in 0..3 {
            sum[2 * axis] += row.max[axis];
            sum[2 * axis + 1] += row.mean[axis];
        }
    }
    sum.map(|s| s / outcomes.len() as f64)
}

#[test]
fn the_rows_over_20_seeds_are_about_the_published() {
    let outcomes = &over_20_seeds(&paper());
    let limits = [
        // Means of row one were what the working region was chosen by; those of the other rows, what the effects were sized by.
        (Mode::WithoutCalibration, 0.15),
        (Mode::OnlyCalibration, 0.35),
        (Mode::WithGravity, 0.35),
    ];
    let scenario = paper();
    for (set, kind) in SetKind::ALL.into_iter().enumerate() {
        for (mode, tolerance) in limits {
            let found = average(outcomes, set, mode);
            println!("{} {}: {:?} mm", kind.key(), mode.key(), found.map(|v| (v * 1e5).round() / 100.0));
            let published = scenario.published.iter().find(|(s, m, _)| (*s, *m) == (kind, mode));
            let published = published.expect("the published row").2;
            for entry in [1, 3, 5] {
                let ratio = found[entry] / published[entry];
                assert!(
                    (ratio - 1.0).abs() <= tolerance,
                    "{} {}, figure {entry}: {ratio:.3} of the published",
                    kind.key(),
                    mode.key()
                );
            }
        }
        let [without, only, gravity] = limits.map(|(mode, _)| average(outcomes, set, mode));
        assert!([1, 3, 5].iter().all(|&i| only[i] < without[i]), "{}", kind.key());
        assert!(gravity[1] < only[1] && gravity[3] < only[3], "{}: {gravity:?} {only:?}", kind.key());
        assert!(gravity[5] <= 1.05 * only[5], "{}: {gravity:?} {only:?}", kind.key());
    }
}

/// With so many identification poses in a session that takes as long and is as warm: faster, by as much heat.
pub fn with_poses(mut scenario: Scenario, identification: u32) -> Scenario {
    let poses = |scenario: &Scenario| f64::from(scenario.identification_poses + scenario.verification_poses);
    let before = poses(&scenario);
    scenario.identification_poses = identification;
    let faster = before / poses(&scenario);
    let timing = &mut scenario.plan.timing;
    (timing.motion, timing.settling) = (faster * timing.motion, faster * timing.settling);
    for growth in scenario.as_built.effects.thermal.iter_mut().flat_map(|thermal| &mut thermal.growths) {
        growth.heat.iter_mut().for_each(|heat| heat.per_motion *= faster);
    }
    scenario
}

/// Mean absolute errors of the extended model per axis, m, over so many trials.
fn extended(mut scenario: Scenario, trials: u32, kind: AccuracySet) -> [f64; 3] {
    scenario.modes = vec![Mode::Extended];
    let campaign = Campaign::of_draws(&scenario, scenario.seed, PlantKind::Rapier);
    let done = campaign.trials(0..trials).expect("threads");
    let summary = summarise_trials(&campaign, &done).expect("a table");
    assert!(summary.failed == 0, "{:?}", summary.reasons);
    let set = summary.modes()[0].sets.iter().find(|set| set.kind == kind).expect("measured poses");
    set.mean.map(|figure| figure.mean)
}

/// What the extended model cannot follow of the shipped machine's effects, mean absolute per axis, m: what a fit leaves that poses no longer limit, of exact
/// readings, without what has no shape (repeatability and the encoders' steps).
fn what_no_term_takes_up() -> [f64; 3] {
    let mut scenario = with_poses(paper(), 1000);
    scenario.tracker.instrument.noise = false;
    let effects = &mut scenario.as_built.effects;
    (effects.repeatability, effects.encoder) = (None, None);
    extended(scenario, 1, AccuracySet::Identification)
}

#[test]
fn the_extended_model_comes_near_the_floor_of_the_machine() {
    let beyond = what_no_term_takes_up();
    // From 60 poses some 76 parameters are determined: what the model cannot follow is spread over them. With three times the poses this is small.
    for (poses, trials, most) in [(60, 20, 1.3), (180, 10, 1.15)] {
        let [all, floor] = [paper(), floor()]
            .map(|scenario| extended(with_poses(scenario, poses), trials, AccuracySet::Verification));
        for axis in 0..3 {
            let [all, floor, beyond] = [all, floor, beyond].map(|figures| 1e3 * figures[axis]);
            let ratio = all / floor.hypot(beyond);
            println!(
                "{poses} poses, axis {axis}: {all:.3} mm held out, floor {floor:.3} mm, beyond the terms {beyond:.3} mm: {ratio:.3}"
            );
            assert!(ratio <= most, "{poses} poses, axis {axis}: {ratio}");
        }
    }
}

#[test]
fn the_floor_is_the_same_robot_with_less_on() {
    let (all, mut floor) = (paper(), floor());
    assert!(floor.as_built.effects.repeatability.is_some() && floor.as_built.effects.encoder.is_some());
    assert_eq!(floor.as_built.effects.active().len(), 2);
    assert_eq!(floor.as_built.effects.repeatability, all.as_built.effects.repeatability);
    assert_eq!(floor.as_built.effects.encoder, all.as_built.effects.encoder);
    assert_eq!(all.as_built.effects.active(), EffectKind::ALL);
    floor.as_built.effects = all.as_built.effects.clone();
    floor.name.clone_from(&all.name);
    floor.sources.clone_from(&all.sources);
    assert_eq!(floor, all);
}

fn over_20_seeds(scenario: &Scenario) -> Vec<Outcome> {
    (0..20).map(|seed| pipeline::run(scenario, seed, |_, _| {}).expect("a run")).collect()
}
