//! The published experiment: row "without calibration" near the published one, and every step an improvement.

use std::path::Path;

use calibrig::evaluation::AccuracyRow;
use calibrig::identification::Mode;
use calibrig::model::ActuatorMap;
use calibrig::pipeline::{self, Outcome, SetKind};
use calibrig::scenario::{Scenario, load_scenario};

pub fn paper() -> Scenario {
    load_scenario(Path::new("scenarios/paper.toml")).expect("the shipped scenario")
}

/// The paper's robot as "only calibration" takes it to be: rigid, its elbow driven by an exact parallelogram.
pub fn rigid_paper() -> Scenario {
    let mut scenario = paper();
    let machine = &mut scenario.as_built;
    machine.statics.make_rigid();
    machine.statics.linkage = None;
    if let ActuatorMap::Parallelogram { linkage, .. } = &mut machine.actuators {
        *linkage = None;
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
fn the_rows_over_50_pose_draws() {
    let scenario = paper();
    let draws: Vec<u64> = (0..50).collect();
    assert!(draws.contains(&scenario.seed), "the shipped seed is one of the draws");
    let outcomes: Vec<_> =
        draws.iter().map(|seed| pipeline::run(&scenario, *seed, |_, _| {}).expect("a run")).collect();
    for (set, kind) in SetKind::ALL.into_iter().enumerate() {
        let published = [Mode::WithoutCalibration, Mode::OnlyCalibration, Mode::WithGravity];
        let rows = published.map(|mode| average(&outcomes, set, mode));
        for (mode, row) in published.iter().zip(rows) {
            println!("{} {}: {:?} mm", kind.key(), mode.key(), row.map(|v| (v * 1e5).round() / 100.0));
        }
        let published = scenario
            .published
            .iter()
            .find(|(s, m, _)| (*s, *m) == (kind, Mode::WithoutCalibration))
            .expect("the published row")
            .2;
        for entry in 0..6 {
            let (ratio, tolerance) = (rows[0][entry] / published[entry], [0.25, 0.15][entry % 2]);
            assert!(
                (ratio - 1.0).abs() <= tolerance,
                "{} figure {entry}: {ratio:.3} of the published",
                kind.key()
            );
        }
        for axis in [1, 3, 5] {
            let [without, only, gravity] = [rows[0][axis], rows[1][axis], rows[2][axis]];
            assert!(gravity < only && only < without, "{}: {without} {only} {gravity}", kind.key());
        }
    }
}
