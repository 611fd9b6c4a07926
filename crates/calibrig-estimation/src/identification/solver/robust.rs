//! Minimisation with a loss: passes of the iteration at fixed scales, and the effect of the weights on the covariance.
//!
//! Weights are iterated (P. W. Holland, R. E. Welsch, "Robust regression using iteratively reweighted least-squares", 1977) rather than
//! the normal matrix corrected by the loss's second derivative (B. Triggs et al., "Bundle adjustment", 2000, section 4.3): every ρ here is
//! concave in the square, so that the weighted squares lie above the true cost and a full step of a linear problem never raises it, while
//! the corrected matrix is indefinite for the blocks of Cauchy and Tukey that matter and would have to be cut. The price is linear
//! convergence, with a quotient of about the share of curvature that the loss takes away.

use super::bounds::Bounds;
use super::descent::Descent;
use super::loss::{Loss, LossScale, freedom_factor, scale_of};
use super::point::{Point, Robust};
use super::{LeastSquares, Solution, SolverOptions, TerminationReason};

/// Most passes that determine the scale. The median jumps from block to block and may not converge.
const SCALE_PASSES: usize = 30;

/// Minimises from one start.
pub(super) fn solve(
    problem: &mut impl LeastSquares,
    x: Vec<f64>,
    options: &SolverOptions,
    bounds: Option<&Bounds>,
) -> Solution {
    let blocks = problem.blocks().min(problem.rows() / 3);
    let mut descent = Descent::new(problem, x, options, bounds);
    if options.loss == Loss::Squared || blocks == 0 {
        let termination = descent.run(None);
        return finish(descent, termination, None);
    }
    let (termination, robust) = passes(&mut descent, options, blocks);
    finish(descent, termination, Some(robust))
}

/// Runs the loss to its end. Cauchy's and Tukey's losses have many minima: they start from Huber's, which has a single one in a linear problem.
fn passes<P: LeastSquares>(
    descent: &mut Descent<'_, P>,
    options: &SolverOptions,
    blocks: usize,
) -> (TerminationReason, Robust) {
    let losses: &[Loss] = match options.loss {
        Loss::Squared | Loss::Huber { .. } => &[options.loss],
        Loss::Cauchy { .. } | Loss::Tukey { .. } => &[Loss::huber(), options.loss],
    };
    let estimated = options.loss_scale == LossScale::Estimated;
    let mut robust = Robust {
        loss: options.loss,
        scale: match options.loss_scale {
            // Nothing is fitted yet.
            LossScale::Estimated => estimate(&descent.now, blocks, 0.0, options),
            LossScale::Fixed(scale) if scale > 0.0 => scale,
            LossScale::Fixed(_) => f64::NAN,
        },
        blocks,
    };
    let mut termination = TerminationReason::NotFinite;
    for &loss in losses {
        robust.loss = loss;
        for pass in 0..SCALE_PASSES {
            termination = descent.run(Some(robust));
            if !termination.converged() {
                robust.loss = options.loss;
                return (termination, robust);
            }
            if !estimated || pass + 1 == SCALE_PASSES {
                break;
            }
            let scale = estimate(&descent.now, blocks, descent.now.fitted(blocks), options);
            if (scale - robust.scale).abs() <= options.relative_decrease * robust.scale {
                break;
            }
            robust.scale = scale;
        }
    }
    (termination, robust)
}

/// The scale of the residuals; for data without noise it is still large enough to divide by.
fn estimate(now: &Point, blocks: usize, fitted: f64, options: &SolverOptions) -> f64 {
    let mut norms: Vec<f64> = (0..blocks).map(|i| now.square(i).sqrt()).collect();
    scale_of(&mut norms, fitted).max(options.absolute_decrease).max(f64::EPSILON)
}

fn finish<P: LeastSquares>(
    mut descent: Descent<'_, P>,
    termination: TerminationReason,
    robust: Option<Robust>,
) -> Solution {
    let at_bound = descent.at_bound();
    let mut variance_factor = 1.0;
    if let Some(robust) = robust {
        // A pass that failed may have used another loss.
        descent.now.weigh(Some(robust));
        variance_factor = variance_of(&descent.now, robust);
        let mean = mean(descent.now.weights.iter().copied());
        for (i, weight) in descent.now.weights.iter().enumerate() {
            let factor = (weight / (mean * variance_factor)).sqrt();
            let factor = if factor.is_finite() { factor } else { 0.0 };
            descent.now.jacobian.rows_mut(3 * i, 3).scale_mut(factor);
        }
    }
    let Descent { x, now, iterations, .. } = descent;
    Solution {
        x,
        cost: now.cost,
        beside: now.beside,
        residuals: now.residuals,
        jacobian: now.jacobian,
        termination,
        iterations,
        at_bound,
        weights: now.weights,
        scale: robust.map_or(1.0, |robust| robust.scale),
        variance_factor,
        minima: u32::from(termination.converged()),
    }
}

/// Variance of the estimate over that of least squares in the stated noise (P. J. Huber, E. M. Ronchetti, "Robust Statistics", 2nd ed. 2009,
/// section 7.6, with blocks for coordinates).
fn variance_of(now: &Point, Robust { loss, scale, blocks }: Robust) -> f64 {
    let squares = || (0..blocks).map(|i| now.square(i));
    let slope = mean(squares().map(|v2| loss.mean_slope(v2 / (scale * scale))));
    let spread = mean(squares().zip(&now.weights).map(|(v2, w)| w * w * v2)) / 3.0;
    let factor = spread * freedom_factor(blocks, now.fitted(blocks)) / (slope * slope);
    if slope > 0.0 { factor.max(1.0) } else { f64::INFINITY }
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0_usize), |(sum, count), value| (sum + value, count + 1));
    sum / count as f64
}
