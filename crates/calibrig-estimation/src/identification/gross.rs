//! Gross errors: readings far off what the others say of them.
//!
//! A fit of squares is drawn to its gross errors, which then hide behind their own leverage and behind each other. So the system, taken
//! as linear about the fit, is fitted again with weights that gross errors do not move; what looks far off is left out, and each is
//! tested against a fit without it (P. J. Rousseeuw, A. M. Leroy, "Robust Regression and Outlier Detection", 1987, chapter 6; the tests
//! go inwards from all candidates: A. S. Hadi, J. S. Simonoff, JASA 88 (1993) 1264).

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use super::factor::extended;
use super::scale_of;
use super::summary::outliers;
use super::{Loss, Outlier};
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::statistics::f_ln_survival;

/// Probability that any of a set's readings is called a gross error where the noise is normal. The candidates are chosen by what is tested,
/// which multiplies it by up to about two.
const FALSE_ALARM: f64 = 2e-4;
/// No reading nearer than this many standard deviations of a coordinate is called so, however many there are.
const LEAST: f64 = 5.0;
/// Readings beyond so many are candidates.
const CANDIDATE: f64 = 3.5;
/// A model that lacks something predicts worse than it says where it extrapolates: there its variance counts so many times.
const EXTRAPOLATED: f64 = 4.0;
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
    pub observation: usize,
    /// Distance from what the others say of it, in standard deviations of a coordinate.
    pub size: f64,
    /// Residual against a fit without it, in stated standard deviations.
    pub left_out: Vector3<f64>,
}

/// A fit, as linear: blocks of three rows an observation, then priors.
pub(super) struct LinearFit<'a> {
    pub jacobian: &'a DMatrix<f64>,
    pub residuals: &'a DVector<f64>,
    pub blocks: usize,
    /// What every block counts for in the fit; empty where all count alike.
    pub weights: &'a [f64],
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
    pub fn gross_errors(&self) -> Vec<GrossError> {
        let n = self.jacobian.ncols();
        if self.blocks < 4 || 3 * self.blocks < n + 6 || self.residuals.iter().any(|v| !v.is_finite()) {
            return Vec::new();
        }
        let ones = vec![1.0; self.blocks];
        let weights = if self.weights.is_empty() { &ones } else { self.weights };
        let Some(now) = self.fitted(weights, 1.0, false) else { return Vec::new() };
        let scale = now.scale();
        // What even the fit that it draws shows nothing of is no gross error.
        if !(now.largest() > CANDIDATE * scale) {
            return Vec::new();
        }
        let Some(candidates) = self.candidates(now) else { return Vec::new() };
        self.tested(candidates)
    }

    /// Readings far off a fit with weights that they do not move; `None` where no such fit is found.
    fn candidates(&self, mut now: Fitted) -> Option<Vec<usize>> {
        for (loss, passes) in [Loss::huber(), Loss::tukey()].into_iter().zip(PASSES) {
            for _ in 0..passes {
                let scale = now.scale().max(f64::MIN_POSITIVE);
                let weight = |out: &LeftOut| loss.weight(out.square / (scale * scale));
                let weights: Vec<f64> = now.left_out.iter().map(weight).collect();
                now = self.fitted(&weights, scale, true)?;
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
        let inverse = match n {
            0 => DMatrix::zeros(0, 0),
            _ => r.view((0, 0), (n, n)).solve_upper_triangular(&DMatrix::identity(n, n))?,
        };
        let step = -&inverse * r.view((0, n), (n, 1));
        let (mut sum, mut leverage, mut count) = (0.0, 0.0, 0.0);
        let mut left_out = Vec::with_capacity(self.blocks);
        for (i, weight) in weights.iter().enumerate().take(self.blocks) {
            let mut rows = self.jacobian.fixed_rows::<3>(3 * i).into_owned();
            rows.column_iter_mut().zip(&norms).for_each(|(mut column, norm)| column /= *norm);
            let mut residual = self.residuals.fixed_rows::<3>(3 * i).into_owned();
            if moves {
                residual += &rows * &step;
            }
            let spread = rows * &inverse;
            let hat: Matrix3<f64> = &spread * spread.transpose();
            if *weight >= 1.0 {
                (sum, leverage, count) = (sum + residual.norm_squared(), leverage + hat.trace(), count + 3.0);
            }
            left_out.push(without(&hat, *weight, &residual));
        }
        let freedom = count - leverage;
        Some(Fitted { left_out, variance: sum / freedom.max(f64::MIN_POSITIVE), freedom })
    }
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
        is_stated: false,
    };
    let found: Vec<_> = fit.gross_errors().into_iter().map(|e| (e, e.left_out, 0.0)).collect();
    outliers(set, &found)
}

#[cfg(test)]
mod tests;
