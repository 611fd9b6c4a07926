//! What readings of one pose say beside each other: how far they scatter by themselves, and whether the machine does more than its model.
//!
//! Of the likelihood that the noise was found with ([`variance`](super::variance)), twice the fall without a part of it is chi-square, a mixture of
//! as many degrees of freedom as the part has variances, none of which is negative (S. G. Self, K.-Y. Liang, JASA 82 (1987) 605, case 9).

use super::noise::{Unknown, system};
use super::problem::CalibrationProblem;
use super::solver::Solution;
use calibrig_model::statistics::chi2_survival;

/// A part of the noise is told where the data would have so much of it by chance in less than one of so many sets.
const BY_CHANCE: f64 = 1e-3;

/// What the noise is made of, gross errors aside.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Parts {
    /// Noise of a reading over what it states, where the data show that it is more.
    pub readings: Option<f64>,
    /// Whether they show that the machine does something beside its model.
    pub machine: bool,
}

/// The parts of the noise that was found with a solution; `None` where nothing tells them apart. The blocks `aside` are not looked at.
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

/// Probability of a fall as large where none of so many variances is there.
fn by_chance(fall: f64, variances: usize) -> f64 {
    let mut share = 0.5_f64.powi(i32::try_from(variances).unwrap_or(i32::MAX));
    let mut sum = 0.0;
    for freedom in 1..=variances {
        share *= (variances + 1 - freedom) as f64 / freedom as f64;
        sum += share * chi2_survival(fall.max(0.0), freedom as f64);
    }
    sum
}
