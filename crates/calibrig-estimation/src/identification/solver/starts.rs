//! Several starts, for problems that may have more than one minimum.

use nalgebra::DVector;
use rand::RngExt;

use super::bounds::{Bounds, BoundsError};
use super::point::{Robust, robust_cost};
use super::robust::solve;
use super::{LeastSquares, Solution, SolverOptions};
use calibrig_model::random::{StreamSource, stream};

/// Two results are the same minimum if the residuals between them change, to first order, by less than this many times the solver's tolerance.
const SAME: f64 = 100.0;

pub(super) fn check(spread: &[f64], n: usize) -> Result<(), BoundsError> {
    if spread.len() != n {
        return Err(BoundsError::Length { what: "widths of the starts", found: spread.len(), expected: n });
    }
    match spread.iter().position(|s| !(s.is_finite() && *s >= 0.0)) {
        Some(parameter) => Err(BoundsError::Spread { parameter, spread: spread[parameter] }),
        None => Ok(()),
    }
}

/// The lowest of the minima that all starts lead to; if none converged, the result with the lowest cost.
pub(super) fn best_of_many(
    problem: &mut impl LeastSquares,
    x: &[f64],
    options: &SolverOptions,
    bounds: &Bounds,
    spread: &[f64],
) -> Solution {
    let first = solve(problem, x.to_vec(), options, Some(bounds));
    let mut minima: Vec<Solution> = Vec::new();
    let mut unfinished: Option<Solution> = None;
    let others = (1..options.starts).map(|k| draw(x, spread, bounds, options.seed, k));
    let mut keep = |found: Solution| {
        if !found.termination.converged() {
            // A NaN cost counts as the worst.
            if unfinished.as_ref().is_none_or(|best| found.cost < best.cost || !best.cost.is_finite()) {
                unfinished = Some(found);
            }
        } else if let Some(known) = minima.iter_mut().find(|known| is_same(known, &found, options)) {
            if found.cost < known.cost {
                *known = found;
            }
        } else {
            minima.push(found);
        }
    };
    keep(first);
    for start in others {
        keep(solve(problem, start, options, Some(bounds)));
    }
    let count = u32::try_from(minima.len()).unwrap_or(u32::MAX);
    // Costs at different scales of a loss cannot be compared: all are evaluated at the smallest scale.
    let scale = minima.iter().map(|s| s.scale).fold(f64::INFINITY, f64::min);
    let partners: Vec<usize> = (0..problem.blocks()).map(|block| problem.partner(block)).collect();
    let lowest = minima
        .into_iter()
        .min_by(|a, b| {
            let cost = |of| cost_at(of, scale, options, &partners);
            cost(a).total_cmp(&cost(b))
        })
        .or(unfinished);
    match lowest {
        Some(solution) => Solution { minima: count, ..solution },
        None => solve(problem, x.to_vec(), options, Some(bounds)),
    }
}

/// Start number k, the same for any number of starts: k takes the place of a trial's number.
fn draw(x: &[f64], spread: &[f64], bounds: &Bounds, seed: u64, k: u32) -> Vec<f64> {
    let mut random = stream(seed, k, StreamSource::SolverStarts);
    x.iter()
        .zip(spread)
        .enumerate()
        .map(|(j, (x, spread))| bounds.nearest(j, x + spread * random.random_range(-1.0..=1.0)))
        .collect()
}

fn is_same(a: &Solution, b: &Solution, options: &SolverOptions) -> bool {
    let between = DVector::from_iterator(a.x.len(), a.x.iter().zip(&b.x).map(|(a, b)| b - a));
    let least = options.absolute_decrease + options.relative_decrease * a.cost.sqrt();
    (&a.jacobian * between).norm() <= SAME * least
}

fn cost_at(solution: &Solution, scale: f64, options: &SolverOptions, partners: &[usize]) -> f64 {
    let robust = Robust { loss: options.loss, scale, blocks: solution.weights.len() };
    solution.beside + robust_cost(&solution.residuals, partners, robust)
}
