//! Levenberg-Marquardt for a weighted problem, with column scaling and with the gain ratio of the true cost; with bounds, robust losses and
//! several starts on request.
//!
//! Source of the method: J. J. Moré, "The Levenberg-Marquardt algorithm: implementation and theory" (1978), for the scaling and the decrease
//! for which a step is accepted. The damping follows the gain ratio; refused steps are bent (geodesic acceleration). Within bounds, a step is the
//! minimum of the damped quadratic model inside them, so that the first-order conditions hold where no step is left. Priors (MAP, Tikhonov) are
//! rows of the problem like any other.

mod bounds;
mod descent;
mod loss;
mod point;
mod robust;
mod starts;
#[cfg(test)]
mod tests;

use nalgebra::{DMatrix, DVector};

pub use bounds::BoundsError;
pub(crate) use bounds::{AtBound, Bounds, Side};
pub(crate) use loss::scale_of;
pub use loss::{Loss, LossScale};

use super::{IterationRecord, TerminationReason};

/// A sum of squares to minimise. Rows are weighted: a residual of 1 is one standard deviation.
pub trait LeastSquares {
    /// Number of parameters n.
    fn parameters(&self) -> usize;

    /// Number of rows m: data and priors.
    fn rows(&self) -> usize;

    /// Number of leading blocks of three rows to which a robust loss applies, at most m / 3. The rows below them, priors above all, stay
    /// quadratic. Zero by default: then a loss changes nothing.
    fn blocks(&self) -> usize {
        0
    }

    /// The block that is weighted together with this one: a reading of six coordinates is two blocks. The block itself by default. Both blocks get
    /// the weight for the mean of their squares.
    fn partner(&self, block: usize) -> usize {
        block
    }

    /// Sum of squares, at the parameters evaluated last, that is in no row and that no step changes to first order: it counts where costs are
    /// compared.
    fn beside(&self) -> f64 {
        0.0
    }

    /// Fills the m residuals at the n parameters `x` and, if asked for, the m x n Jacobian of the residuals.
    fn evaluate(&mut self, x: &[f64], residuals: &mut DVector<f64>, jacobian: Option<&mut DMatrix<f64>>);
}

/// What is minimised, and when the solver stops.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SolverOptions {
    /// Most iterations from one start, rejected steps included; with a robust loss, of each of its passes.
    pub max_iterations: usize,
    /// Stop when the step changes the residual vector by less than this fraction of it ...
    pub relative_decrease: f64,
    /// ... or by less than this many standard deviations ...
    pub absolute_decrease: f64,
    /// ... or when no column of the Jacobian that a bound does not hold has a larger cosine with the residuals.
    pub gradient: f64,
    /// Cost of a block of rows.
    pub loss: Loss,
    /// Scale relative to which the loss measures residuals.
    pub loss_scale: LossScale,
    /// Number of starting points: the given one, and others drawn about it.
    pub starts: u32,
    /// Seed of the drawn starting points.
    pub seed: u64,
}

impl Default for SolverOptions {
    fn default() -> Self {
        Self {
            max_iterations: 100,
            relative_decrease: 1e-4,
            absolute_decrease: 1e-7,
            gradient: 1e-10,
            loss: Loss::Squared,
            loss_scale: LossScale::Estimated,
            starts: 1,
            seed: 0,
        }
    }
}

/// Result of the solver.
#[derive(Debug, Clone)]
pub struct Solution {
    /// The n parameters.
    pub x: Vec<f64>,
    /// The cost at `x`: the sum of squares, or with a loss `Σ s² ρ(v²/s²)` over the blocks of norm v plus the squares of the other rows; both
    /// including `beside`.
    pub cost: f64,
    /// The part of the cost that is in no row ([`LeastSquares::beside`]).
    pub beside: f64,
    /// The m residuals at `x`, without the weights of a loss.
    pub residuals: DVector<f64>,
    /// The m x n matrix J whose `(JᵀJ)⁻¹` is the covariance of `x` (without parameters at a bound). In least squares it is the Jacobian. With
    /// a loss, the rows of block i are those of the Jacobian times `sqrt(weights[i] / (mean weight · variance_factor))`.
    pub jacobian: DMatrix<f64>,
    /// Why the solver stopped.
    pub termination: TerminationReason,
    /// History of the solver. With a loss, it covers all passes, each of which has another cost.
    pub iterations: Vec<IterationRecord>,
    /// Parameters at a bound, in ascending order.
    pub at_bound: Vec<AtBound>,
    /// Final weight of every block, from 1 down to 0; empty without a loss.
    pub weights: Vec<f64>,
    /// The scale of the loss: standard deviation of one coordinate over the stated one. 1 without a loss.
    pub scale: f64,
    /// Variance with the loss over the least that the stated noise allows: `b / a²` with `a` and `b` as in [`Loss`] but taken from
    /// the residuals, b in units of the stated variance and per degree of freedom. Never below 1; 1 without a loss; infinite where the loss
    /// rejects so much that the rest determines nothing.
    pub variance_factor: f64,
    /// Number of distinct minima that the starts reached, including this one; 0 if none converged.
    pub minima: u32,
}

impl Solution {
    /// Blocks whose residual is longer than `limit` times the scale. For normal noise, their share is chi's upper tail (three degrees of
    /// freedom): 1.5e-5 above 5.
    #[cfg(test)]
    pub fn outliers(&self, limit: f64) -> Vec<usize> {
        (0..self.weights.len())
            .filter(|&i| self.residuals.fixed_rows::<3>(3 * i).norm() > limit * self.scale)
            .collect()
    }
}

/// Minimises without bounds, from the single start `x`.
pub fn minimise(problem: &mut impl LeastSquares, x: Vec<f64>, options: &SolverOptions) -> Solution {
    robust::solve(problem, x, options, None)
}

/// Minimises within `bounds`, from `x` and from the other starts that `options` ask for.
///
/// `spread` has one width per parameter: starts are drawn evenly from `x ± spread` and moved to the nearest point within the bounds. It may be
/// empty for a single start. The lowest minimum is returned; start k is the same for any number of starts.
pub fn minimise_within(
    problem: &mut impl LeastSquares,
    x: Vec<f64>,
    options: &SolverOptions,
    bounds: &Bounds,
    spread: &[f64],
) -> Result<Solution, BoundsError> {
    bounds.check(&x)?;
    if options.starts <= 1 {
        return Ok(robust::solve(problem, x, options, Some(bounds)));
    }
    starts::check(spread, x.len())?;
    Ok(starts::best_of_many(problem, &x, options, bounds, spread))
}
