//! Gross errors: readings far off what the others predict for them.
//!
//! A least squares fit is pulled towards its gross errors, which then hide behind their own leverage and behind each other. So the system,
//! linearised about the fit, is fitted again with weights that gross errors do not move; what looks far off is left out, and each candidate is
//! tested against a fit without it (P. J. Rousseeuw, A. M. Leroy, "Robust Regression and Outlier Detection", 1987, chapter 6; the tests
//! go inwards from all candidates: A. S. Hadi, J. S. Simonoff, JASA 88 (1993) 1264).

mod shifted;

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use super::factor::extended;
use super::scale_of;
use super::summary::{FarOff, Off, outliers};
use super::{Loss, Outlier};
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::statistics::{chi2_survival, f_ln_survival};

/// Probability that any reading of a set with normal noise is called a gross error. The candidates are chosen by the quantity that is tested,
/// which increases it by a factor of up to about two.
const FALSE_ALARM: f64 = 2e-4;
/// A reading within this many standard deviations of a coordinate is never called a gross error, however many readings there are.
const LEAST: f64 = 5.0;
/// Readings beyond this many standard deviations are candidates.
const CANDIDATE: f64 = 3.5;
/// A model that lacks something predicts worse than it states where it extrapolates: there its variance counts this many times.
const EXTRAPOLATED: f64 = 4.0;
/// Readings beyond this many standard deviations look large; at most [`MOST_LARGE`] of them are tested without each other.
const LARGE: f64 = 2.5;
const MOST_LARGE: usize = 20;
/// Where no crowd of gross errors can hide one, a largest reading that occurs by chance in one of twenty sets is not suspicious ...
const SUSPICIOUS: f64 = 0.05;
/// ... that is where the readings scatter by less than this over what was stated.
const UNCROWDED: f64 = 1.25;
/// Weights that change by less than this have converged.
const AT_REST: f64 = 1e-2;
/// Largest share of readings that can be candidates: beyond it, the others give no reliable scale.
const MOST: (usize, usize) = (2, 5);
/// Number of passes with Huber's weights, from which Tukey's start, and of passes with Tukey's.
const PASSES: [usize; 2] = [8, 12];
/// Ridge relative to a column's norm, so that dependent columns do not end the test.
const RIDGE: f64 = 1e-7;
/// Number of rows factorised at a time.
const PART: usize = 1023;

/// A gross error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct GrossError {
    /// Its block: an observation, or, behind all observations, an orientation.
    pub observation: usize,
    /// Distance from what the others predict, in standard deviations of a coordinate.
    pub size: f64,
    /// Residual against a fit without this reading, in stated standard deviations.
    pub left_out: Vector3<f64>,
}

/// A linearised fit: blocks of three rows per observation, then per orientation, then priors. If a reading's position and orientation are
/// correlated, an error of the position is reported for the orientation as well.
pub(super) struct LinearFit<'a> {
    pub jacobian: &'a DMatrix<f64>,
    pub residuals: &'a DVector<f64>,
    pub blocks: usize,
    /// Weight of every block in the fit; empty where all have the same.
    pub weights: &'a [f64],
    /// Poses whose observations depend on each other: the inverse Cholesky factor of their covariance after each is whitened on its own.
    pub joined: &'a [(Vec<usize>, DMatrix<f64>)],
    /// Whether a residual of 1 is one stated standard deviation. Otherwise the scale comes from the fit itself, also for the weight of priors.
    pub is_stated: bool,
}

/// A block compared with a fit without it.
#[derive(Debug, Clone, Copy)]
struct LeftOut {
    /// Residual of the block.
    error: Vector3<f64>,
    /// Square of the residual's size, in standard deviations of reading and prediction.
    square: f64,
    /// Square of the size if the model may lack something.
    cautious: f64,
}

/// Residuals for one set of weights.
struct Fitted {
    /// One entry per block.
    left_out: Vec<LeftOut>,
    /// Variance of a coordinate in the blocks of weight one, and its degrees of freedom.
    variance: f64,
    freedom: f64,
}

impl LinearFit<'_> {
    /// The gross errors, in the order of the observations.
    ///
    /// `spread` is S with `S Sᵀ` the covariance of the fit in which all blocks have the same weight, if known.
    pub fn gross_errors(&self, spread: Option<&DMatrix<f64>>) -> Vec<GrossError> {
        let n = self.jacobian.ncols();
        if self.blocks < 4 || 3 * self.blocks < n + 6 || self.residuals.iter().any(|v| !v.is_finite()) {
            return Vec::new();
        }
        let spread = spread.filter(|_| self.weights.is_empty());
        if let (Some(spread), false) = (spread, self.joined.is_empty()) {
            return self.shifted(spread);
        }
        let ones = vec![1.0; self.blocks];
        let weights = if self.weights.is_empty() { &ones } else { self.weights };
        let now = match spread {
            Some(spread) => Some(self.seen(&ones, spread, None)),
            None => self.fitted(weights, 1.0, false),
        };
        let Some(now) = now else { return Vec::new() };
        // With few poses, the others give no scale, but a single reading can still be tested.
        let one = spread.filter(|_| self.has_one(&now));
        let candidates = if self.is_suspicious(&now, spread) { self.candidates(now) } else { None };
        let found = candidates.map_or_else(Vec::new, |candidates| self.tested(candidates));
        match one {
            Some(spread) if found.is_empty() => self.shifted(spread),
            _ => found,
        }
    }

    /// Whether the fit that gross errors pull shows any sign of them. `spread` is as in [`gross_errors`](Self::gross_errors).
    fn is_suspicious(&self, now: &Fitted, spread: Option<&DMatrix<f64>>) -> bool {
        let scale = now.scale();
        if !(now.largest() > CANDIDATE * scale) {
            return false;
        }
        // Residuals no larger than stated cannot contain a crowd of gross errors, and a few show when tested without each other.
        let is_crowded = !self.is_stated || scale > UNCROWDED;
        let Some(spread) = spread.filter(|_| !is_crowded) else { return true };
        self.largest_without_each_other(now, scale, spread)
            .is_none_or(|size| self.blocks as f64 * chi2_survival((size / scale).powi(2), 3.0) < SUSPICIOUS)
    }

    /// The largest size among the readings that look largest, against a fit without all of them; `None` where they determine something that
    /// the others do not.
    fn largest_without_each_other(&self, now: &Fitted, scale: f64, spread: &DMatrix<f64>) -> Option<f64> {
        let mut large: Vec<(usize, f64)> = now.left_out.iter().map(|out| out.square).enumerate().collect();
        large.retain(|(_, square)| *square > (LARGE * scale).powi(2));
        large.sort_by(|a, b| b.1.total_cmp(&a.1));
        large.truncate(MOST_LARGE);
        let rows: Vec<usize> = large.iter().flat_map(|(i, _)| 3 * i..3 * i + 3).collect();
        let count = rows.len();
        let spread = self.jacobian.select_rows(&rows) * spread;
        let hat = &spread * spread.transpose();
        let rest = (DMatrix::identity(count, count) - &hat).lu();
        let (errors, hat) = (rest.solve(&self.residuals.select_rows(&rows))?, rest.solve(&hat)?);
        let square = |first: usize| {
            let error: Vector3<f64> = errors.fixed_rows::<3>(first).into_owned();
            let spread: Matrix3<f64> = hat.fixed_view::<3, 3>(first, first).into_owned();
            Some(error.dot(&(Matrix3::identity() + spread).lu().solve(&error)?))
        };
        let largest =
            (0..count).step_by(3).map(square).try_fold(0.0, |most, one| Some(f64::max(most, one?)))?;
        largest.is_finite().then(|| largest.sqrt())
    }

    /// Readings far off a fit with weights that they do not move; `None` where no such fit is found.
    fn candidates(&self, mut now: Fitted) -> Option<Vec<usize>> {
        for (loss, passes) in [Loss::huber(), Loss::tukey()].into_iter().zip(PASSES) {
            let mut before: Vec<f64> = Vec::new();
            for _ in 0..passes {
                let scale = now.scale().max(f64::MIN_POSITIVE);
                let weight = |out: &LeftOut| loss.weight(out.square / (scale * scale));
                let weights: Vec<f64> = now.left_out.iter().map(weight).collect();
                let still = |(a, b): (&f64, &f64)| (a - b).abs() < AT_REST;
                if !before.is_empty() && before.iter().zip(&weights).all(still) {
                    break;
                }
                now = self.fitted(&weights, scale, true)?;
                before = weights;
            }
        }
        let limit = (CANDIDATE * now.scale()).powi(2);
        let mut far: Vec<usize> = (0..self.blocks).filter(|i| now.left_out[*i].square > limit).collect();
        far.sort_by(|a, b| now.left_out[*b].square.total_cmp(&now.left_out[*a].square));
        let enough = (3 * self.blocks).saturating_sub(self.jacobian.ncols() + 6) / 3;
        far.truncate(enough.min(self.blocks * MOST.0 / MOST.1));
        Some(far)
    }

    /// The candidates that are too far off a fit without them for the noise of the others.
    fn tested(&self, mut candidates: Vec<usize>) -> Vec<GrossError> {
        let mut scale = 1.0;
        while !candidates.is_empty() {
            let mut weights = vec![1.0; self.blocks];
            for i in &candidates {
                weights[*i] = 0.0;
            }
            let Some(fitted) = self.fitted(&weights, scale, true) else { return Vec::new() };
            let least = if self.is_stated { 1.0 } else { f64::MIN_POSITIVE };
            let variance = fitted.variance.max(least);
            scale = variance.sqrt();
            let is_gross = |i: &usize| {
                let square = fitted.left_out[*i].cautious / variance;
                let ln_p = f_ln_survival(square / 3.0, 3.0, fitted.freedom);
                square > LEAST * LEAST && ln_p + (self.blocks as f64).ln() < FALSE_ALARM.ln()
            };
            let before = candidates.len();
            candidates.retain(is_gross);
            if candidates.len() == before {
                let gross = |&observation: &usize| {
                    let LeftOut { error, square, .. } = fitted.left_out[observation];
                    GrossError { observation, size: (square / variance).sqrt(), left_out: error }
                };
                candidates.sort_unstable();
                return candidates.iter().map(gross).collect();
            }
        }
        Vec::new()
    }

    /// The fit with these weights of the blocks; if it `moves`, one step from where the residuals were taken. `scale` is the standard
    /// deviation of a coordinate.
    fn fitted(&self, weights: &[f64], scale: f64, moves: bool) -> Option<Fitted> {
        let (rows, n) = self.jacobian.shape();
        // Residuals that set their own scale must not outweigh a prior.
        let of_priors = if self.is_stated { 1.0 } else { scale.min(1.0) };
        let norms: Vec<f64> = self.jacobian.column_iter().map(|c| c.norm().max(f64::MIN_POSITIVE)).collect();
        // In parts, so that a long session needs no second matrix.
        let mut r = DMatrix::from_fn(n, n + 1, |i, j| if i == j { RIDGE } else { 0.0 });
        for first in (0..rows).step_by(PART) {
            let part = DMatrix::from_fn(PART.min(rows - first), n + 1, |row, column| {
                let row = first + row;
                let weight = weights.get(row / 3).filter(|_| row < 3 * self.blocks);
                let factor = weight.map_or(of_priors, |w| w.sqrt());
                factor
                    * norms
                        .get(column)
                        .map_or_else(|| self.residuals[row], |norm| self.jacobian[(row, column)] / norm)
            });
            r = extended(r, part.as_view());
        }
        let mut spread = match n {
            0 => DMatrix::zeros(0, 0),
            _ => r.view((0, 0), (n, n)).solve_upper_triangular(&DMatrix::identity(n, n))?,
        };
        let mut step = -&spread * r.view((0, n), (n, 1)).column(0);
        for (i, norm) in norms.iter().enumerate() {
            spread.row_mut(i).scale_mut(1.0 / norm);
            step[i] /= norm;
        }
        Some(self.seen(weights, &spread, moves.then_some(&step)))
    }

    /// The blocks against the fit with the covariance `S Sᵀ`, S the `spread`, after a `step` from where the residuals were taken.
    fn seen(&self, weights: &[f64], spread: &DMatrix<f64>, step: Option<&DVector<f64>>) -> Fitted {
        let (mut sum, mut leverage, mut count) = (0.0, 0.0, 0.0);
        let mut left_out = Vec::with_capacity(self.blocks);
        for first in (0..self.blocks).step_by(PART / 3) {
            let blocks = (PART / 3).min(self.blocks - first);
            let rows = self.jacobian.rows(3 * first, 3 * blocks);
            let spread = rows * spread;
            let mut residuals = self.residuals.rows(3 * first, 3 * blocks).into_owned();
            if let Some(step) = step {
                residuals.gemv(1.0, &rows, step, 1.0);
            }
            for i in 0..blocks {
                let weight = weights[first + i];
                let residual: Vector3<f64> = residuals.fixed_rows::<3>(3 * i).into_owned();
                let hat = hat(&spread, 3 * i);
                if weight >= 1.0 {
                    sum += residual.norm_squared();
                    leverage += hat.trace();
                    count += 3.0;
                }
                left_out.push(without(&hat, weight, &residual));
            }
        }
        let freedom = count - leverage;
        Fitted { left_out, variance: sum / freedom.max(f64::MIN_POSITIVE), freedom }
    }
}

/// The hat matrix of three rows, beginning at `first`.
fn hat(spread: &DMatrix<f64>, first: usize) -> Matrix3<f64> {
    let mut hat = Matrix3::zeros();
    for column in spread.column_iter() {
        let own: Vector3<f64> = column.fixed_rows::<3>(first).into_owned();
        hat.ger(1.0, &own, &own, 1.0);
    }
    hat
}

/// The block with this weight and hat matrix: `e = (1 - wH)⁻¹ r`, with covariance `1 + S`, where `S = (1 - wH)⁻¹ H` is that of its prediction.
fn without(hat: &Matrix3<f64>, weight: f64, residual: &Vector3<f64>) -> LeftOut {
    // A block that alone determines a direction cannot be tested in that direction.
    let rest = (Matrix3::identity() * (1.0 + 1e-9) - hat * weight).lu();
    let found = rest.solve(residual).zip(rest.solve(hat)).and_then(|(error, spread)| {
        let square = |times: f64| {
            let square = error.dot(&(Matrix3::identity() + spread * times).lu().solve(&error)?);
            square.is_finite().then_some(square.max(0.0))
        };
        Some(LeftOut { error, square: square(1.0)?, cautious: square(EXTRAPOLATED)? })
    });
    let square = residual.norm_squared();
    found.unwrap_or(LeftOut { error: *residual, square, cautious: square })
}

impl Fitted {
    /// Standard deviation of a coordinate, from the median.
    fn scale(&self) -> f64 {
        // Each size belongs to a single reading and has not been reduced by fitted parameters.
        scale_of(&mut self.left_out.iter().map(|out| out.square.sqrt()).collect::<Vec<_>>(), 0.0)
    }

    fn largest(&self) -> f64 {
        self.left_out.iter().map(|out| out.square.sqrt()).fold(0.0, f64::max)
    }
}

/// Gross errors among held-out `errors` (measured minus predicted in the base frame, m, one per observation of the set), in a scale of
/// their own: all of them contain what the model lacks. They carry no weight in any fit.
pub fn held_out_outliers(set: &MeasurementSet, errors: &[Vector3<f64>]) -> Vec<Outlier> {
    let count = errors.len();
    if count != set.observations.len() {
        return Vec::new();
    }
    let residuals = DVector::from_iterator(3 * count, errors.iter().flat_map(|e| [e.x, e.y, e.z]));
    let jacobian = DMatrix::zeros(3 * count, 0);
    let fit = LinearFit {
        jacobian: &jacobian,
        residuals: &residuals,
        blocks: count,
        weights: &[],
        joined: &[],
        is_stated: false,
    };
    let far = |error: GrossError| FarOff {
        observation: error.observation,
        size: error.size,
        off: Off::Place(error.left_out),
        weight: 0.0,
    };
    outliers(set, &fit.gross_errors(None).into_iter().map(far).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests;
