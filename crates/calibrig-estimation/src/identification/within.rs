//! What several readings per pose show: how far readings scatter on their own, and whether the machine has errors beside its model.
//!
//! The noise maximises a likelihood ([`variance`](super::variance)). Twice its decrease without one part of the noise is distributed as a
//! mixture of chi-squares with up to as many degrees of freedom as the part has variances, none of which is negative (S. G. Self, K.-Y.
//! Liang, JASA 82 (1987) 605, case 9).

use super::noise::{Unknown, system};
use super::problem::CalibrationProblem;
use super::solver::Solution;
use calibrig_model::statistics::chi2_survival;

/// A part of the noise is reported where data without it would show as much in fewer than one of a thousand sets.
const BY_CHANCE: f64 = 1e-3;

/// The parts of the noise, gross errors aside.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Parts {
    /// Noise of a reading over what it states, if the data show that it is larger.
    pub readings: Option<f64>,
    /// Whether the data show that the machine has errors beside its model.
    pub machine: bool,
}

/// The parts of the noise that was found with a solution; `None` where nothing separates them. The blocks `aside` are left out.
pub(super) fn parts(
    problem: &mut CalibrationProblem,
    solution: &Solution,
    aside: impl Iterator<Item = usize>,
) -> Option<Parts> {
    let unknown = Unknown::found(&problem.noise);
    if !unknown.scale || !unknown.machine {
        return None;
    }
    let mut solution = solution.clone();
    if solution.weights.is_empty() {
        solution.weights = vec![1.0; problem.rows.len()];
    }
    aside.for_each(|block| solution.weights[block] = 0.0);
    let (system, _) = system(problem, &solution, unknown);
    let found = system.components(None)?;
    let of_readings = usize::from(unknown.readings);
    let of_machine = unknown.machine_components(problem);
    let is_there = |parts: std::ops::Range<usize>| {
        let without =
            system.clone().with_components(|component| !parts.contains(&component)).components(None);
        without.is_none_or(|without| {
            by_chance(2.0 * (found.likelihood - without.likelihood), parts.len()) < BY_CHANCE
        })
    };
    let scale = (1.0 + found.variances[of_readings] / problem.reading_sigma().powi(2)).sqrt();
    let readings = is_there(of_readings..of_readings + 1).then_some(scale);
    Some(Parts { readings, machine: is_there(of_machine) })
}

/// Probability of a decrease at least this large where none of these variances is there.
fn by_chance(fall: f64, variances: usize) -> f64 {
    let mut share = 0.5_f64.powi(i32::try_from(variances).unwrap_or(i32::MAX));
    let mut sum = 0.0;
    for freedom in 1..=variances {
        share *= (variances + 1 - freedom) as f64 / freedom as f64;
        sum += share * chi2_survival(fall.max(0.0), freedom as f64);
    }
    sum
}
