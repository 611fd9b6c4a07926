//! Gross errors: readings far off what the others say of them.
//!
//! A fit of squares is drawn to its gross errors, which then hide behind their own leverage and behind each other. So the system, taken
//! as linear about the fit, is fitted again with weights that gross errors do not move; what looks far off is left out, and each is
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

/// Probability that any of a set's readings is called a gross error where the noise is normal. The candidates are chosen by what is tested,
/// which multiplies it by up to about two.
const FALSE_ALARM: f64 = 2e-4;
/// No reading nearer than this many standard deviations of a coordinate is called so, however many there are.
const LEAST: f64 = 5.0;
/// Readings beyond so many are candidates.
const CANDIDATE: f64 = 3.5;
/// A model that lacks something predicts worse than it says where it extrapolates: there its variance counts so many times.
const EXTRAPOLATED: f64 = 4.0;
/// Readings beyond so many look large, and so many of them are looked at without each other.
const LARGE: f64 = 2.5;
const MOST_LARGE: usize = 20;
/// Where no crowd of gross errors can hide any, a largest reading that one set of twenty has by chance is none ...
const SUSPICIOUS: f64 = 0.05;
/// ... which is where the readings scatter by less than this over what was stated.
const UNCROWDED: f64 = 1.25;
/// Weights that change less are at rest.
const AT_REST: f64 = 1e-2;
/// Largest share of readings that can be candidates: beyond it, it is not for a scale from the others to say.
const MOST: (usize, usize) = (2, 5);
/// Passes with Huber's weights, from which Tukey's start, and with those.
const PASSES: [usize; 2] = [8, 12];
/// Ridge, relative to a column's norm: columns that depend on each other must not end the test.
const RIDGE: f64 = 1e-7;
/// Rows that are factorised at a time.
const PART: usize = 1023;

/// A reading that is one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct GrossError {
    /// Its block: an observation, or behind all of them an orientation.
    pub observation: usize,
    /// Distance from what the others say of it, in standard deviations of a coordinate.
    pub size: f64,
    /// Residual against a fit without it, in stated standard deviations.
    pub left_out: Vector3<f64>,
}

/// A fit, as linear: blocks of three rows an observation, the same of orientations, then priors. Of readings that correlate the two, an error of
/// the place is told of the orientation as well.
pub(super) struct LinearFit<'a> {
    pub jacobian: &'a DMatrix<f64>,
    pub residuals: &'a DVector<f64>,
    pub blocks: usize,
    /// What every block counts for in the fit; empty where all count alike.
    pub weights: &'a [f64],
    /// Poses whose observations depend on each other: the inverse Cholesky factor of their covariance, once each is whitened by itself.
    pub joined: &'a [(Vec<usize>, DMatrix<f64>)],
    /// Whether a residual of 1 is what was stated of a reading. Else the scale is the fit's own, and with it what the priors weigh against.
    pub is_stated: bool,
}

/// A block against a fit without it.
#[derive(Debug, Clone, Copy)]
struct LeftOut {
    /// Its residual.
    error: Vector3<f64>,
    /// The square of its size, in standard deviations of reading and prediction.
    square: f64,
    /// The same where the model may lack something.
    cautious: f64,
}

/// Residuals against one set of weights.
struct Fitted {
    /// Of every block.
    left_out: Vec<LeftOut>,
    /// Variance of a coordinate in the blocks of weight one, and its degrees of freedom.
    variance: f64,
    freedom: f64,
}

impl LinearFit<'_> {
    /// The gross errors, in the order of the observations.
    ///
    /// `spread` is S with `S Sᵀ` the covariance of the fit where all blocks count alike, if it is known.
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
        // Few poses leave no scale from the others, and one reading is still worth a test.
        let one = spread.filter(|_| self.has_one(&now));
        let candidates = if self.is_suspicious(&now, spread) { self.candidates(now) } else { None };
        let found = candidates.map_or_else(Vec::new, |candidates| self.tested(candidates));
        match one {
            Some(spread) if found.is_empty() => self.shifted(spread),
            _ => found,
        }
    }

    /// Whether the fit that gross errors draw shows anything of them. `spread` is as in [`gross_errors`](Self::gross_errors).
    fn is_suspicious(&self, now: &Fitted, spread: Option<&DMatrix<f64>>) -> bool {
        let scale = now.scale();
        if !(now.largest() > CANDIDATE * scale) {
            return false;
        }
        // Residuals no larger than stated hold no crowd of gross errors, and a few show without each other.
        let is_crowded = !self.is_stated || scale > UNCROWDED;
        let Some(spread) = spread.filter(|_| !is_crowded) else { return true };
        self.largest_without_each_other(now, scale, spread)
            .is_none_or(|size| self.blocks as f64 * chi2_survival((size / scale).powi(2), 3.0) < SUSPICIOUS)
    }

    /// The largest size that those of the readings which look largest have against a fit without all of them; `None` where they determine
    /// something by themselves.
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

    /// Those of the candidates that are too far off a fit without them for the noise of the others.
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

    /// The fit with these weights of the blocks, one step from where the residuals were taken if it `moves`. `scale` is the standard
    /// deviation of a coordinate.
    fn fitted(&self, weights: &[f64], scale: f64, moves: bool) -> Option<Fitted> {
        let (rows, n) = self.jacobian.shape();
        // Residuals whose scale is their own weigh no more against a prior than they should.
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

    /// The blocks against the fit whose covariance is `S Sᵀ`, S the `spread`; a `step` from where the residuals were taken.
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

/// Three rows of a matrix by themselves, from `first`.
fn hat(spread: &DMatrix<f64>, first: usize) -> Matrix3<f64> {
    let mut hat = Matrix3::zeros();
    for column in spread.column_iter() {
        let own: Vector3<f64> = column.fixed_rows::<3>(first).into_owned();
        hat.ger(1.0, &own, &own, 1.0);
    }
    hat
}

/// The block of these weights and hat matrix: `e = (1 - wH)⁻¹ r`, whose covariance is `1 + S` with `S = (1 - wH)⁻¹ H` that of its prediction.
fn without(hat: &Matrix3<f64>, weight: f64, residual: &Vector3<f64>) -> LeftOut {
    // A block that determines a direction by itself says nothing against itself there.
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
        // The sizes are those of single readings: no parameter has made them smaller.
        scale_of(&mut self.left_out.iter().map(|out| out.square.sqrt()).collect::<Vec<_>>(), 0.0)
    }

    fn largest(&self) -> f64 {
        self.left_out.iter().map(|out| out.square.sqrt()).fold(0.0, f64::max)
    }
}

/// Gross errors among held-out `errors` (measured minus predicted in the base frame, m, one an observation of the set), by a scale of their
/// own: what a model lacks is in all of them. They carry no weight in any fit.
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
