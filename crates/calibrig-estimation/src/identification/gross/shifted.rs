//! Finds gross errors one at a time: the reading that is best explained by its own displacement, as long as that is more than chance.
//!
//! A displacement of a reading adds three columns to the system, which is the same as leaving the reading out. It also works where readings of
//! one pose depend on each other, so that the error of one is in the rows of the others (R. D. Cook, S. Weisberg, "Residuals
//! and Influence in Regression", 1982, section 2.2.2, the mean-shift model; its F test is exact for normal noise, even with few poses).

use std::ops::Range;

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use super::super::factor::triangular_factor_of_all;
use super::{EXTRAPOLATED, FALSE_ALARM, Fitted, GrossError, LEAST, LinearFit, MOST};
use calibrig_model::statistics::f_ln_survival;

/// Fewest degrees of freedom that determine a scale.
const LEAST_FREEDOM: f64 = 6.0;
const MOST_NAMED: usize = 20;

/// The system with displacements of some readings.
struct Shifted {
    residuals: DVector<f64>,
    /// S with `S Sᵀ` the covariance of parameters and displacements.
    spread: DMatrix<f64>,
    jacobian: DMatrix<f64>,
    /// Sum of squares of the residuals in the readings' rows, and its degrees of freedom.
    squares: f64,
    freedom: f64,
}

/// Effect of a displacement of a reading.
struct Explained {
    /// Decrease of the sum of squares.
    square: f64,
    /// The decrease if the model may lack something.
    cautious: f64,
}

impl LinearFit<'_> {
    /// The gross errors, in the order of the observations. `spread` belongs to the fit.
    pub(super) fn shifted(&self, spread: &DMatrix<f64>) -> Vec<GrossError> {
        if !self.weights.is_empty() {
            return Vec::new();
        }
        let mut named: Vec<usize> = Vec::new();
        let first = (self.residuals.clone(), spread.clone(), self.jacobian.clone());
        let mut now = self.judged(first.0, first.1, first.2);
        let most = (self.blocks * MOST.0 / MOST.1).min(MOST_NAMED);
        while named.len() < most && now.freedom - 3.0 >= LEAST_FREEDOM {
            let others = (0..self.blocks).filter(|i| !named.contains(i));
            let told = others.filter_map(|i| Some((i, self.explained(&now, i)?)));
            let Some((worst, explained)) = told.max_by(|a, b| a.1.square.total_cmp(&b.1.square)) else {
                break;
            };
            let variance = self.variance(now.squares - explained.square, now.freedom - 3.0);
            if !self.is_gross(explained.square, explained.cautious, variance, now.freedom - 3.0) {
                break;
            }
            named.push(worst);
            let Some(next) = self.with_shifts(&named) else { break };
            now = next;
        }
        self.confirmed(named, &now)
    }

    /// Whether the reading that explains most on its own is a gross error, in a fit where all readings are independent and have the same weight.
    pub(super) fn has_one(&self, fit: &Fitted) -> bool {
        let Some(worst) = fit.left_out.iter().max_by(|a, b| a.square.total_cmp(&b.square)) else {
            return false;
        };
        let freedom = fit.freedom - 3.0;
        freedom >= LEAST_FREEDOM && {
            let variance = self.variance(fit.variance * fit.freedom - worst.square, freedom);
            self.is_gross(worst.square, worst.cautious, variance, freedom)
        }
    }

    /// The readings that are still gross errors beside the others.
    fn confirmed(&self, named: Vec<usize>, now: &Shifted) -> Vec<GrossError> {
        let n = self.jacobian.ncols();
        if named.is_empty() || now.spread.nrows() != n + 3 * named.len() {
            return Vec::new();
        }
        let variance = self.variance(now.squares, now.freedom);
        let gross = |(place, observation): (usize, usize)| {
            let own = now.spread.fixed_rows::<3>(n + 3 * place);
            let covariance: Matrix3<f64> = own * own.transpose();
            let columns = self.columns(observation);
            let alone = columns.tr_mul(&columns);
            let alone: Matrix3<f64> = alone.fixed_view::<3, 3>(0, 0).into_owned();
            let left_out = self.shift(now, place)?;
            let square = left_out.dot(&covariance.lu().solve(&left_out)?);
            let cautious = cautious(&left_out, &covariance, &alone)?;
            let size = (square / variance).sqrt();
            self.is_gross(square, cautious, variance, now.freedom).then_some(GrossError {
                observation,
                size,
                left_out,
            })
        };
        let mut found: Vec<GrossError> = named.into_iter().enumerate().filter_map(gross).collect();
        found.sort_by_key(|error| error.observation);
        found
    }

    fn is_gross(&self, square: f64, cautious: f64, variance: f64, freedom: f64) -> bool {
        let ln_p = f_ln_survival(cautious / variance / 3.0, 3.0, freedom);
        square > LEAST * LEAST * variance && ln_p + (self.blocks as f64).ln() < FALSE_ALARM.ln()
    }

    fn variance(&self, squares: f64, freedom: f64) -> f64 {
        let least = if self.is_stated { 1.0 } else { f64::MIN_POSITIVE };
        (squares / freedom).max(least)
    }

    /// The rows of a reading's pose, and the effect of a displacement of the reading on them.
    fn pose_of(&self, observation: usize) -> (Vec<usize>, Option<(&DMatrix<f64>, usize)>) {
        let joined = self.joined.iter().find_map(|(pose, whitening)| {
            let place = pose.iter().position(|other| *other == observation)?;
            Some((pose, whitening, place))
        });
        let rows = |observation: usize| -> Range<usize> { 3 * observation..3 * observation + 3 };
        match joined {
            Some((pose, whitening, place)) => {
                (pose.iter().flat_map(|i| rows(*i)).collect(), Some((whitening, place)))
            }
            None => (rows(observation).collect(), None),
        }
    }

    /// The effect of a displacement of a reading on the rows of its pose.
    fn columns(&self, observation: usize) -> DMatrix<f64> {
        match self.pose_of(observation).1 {
            Some((whitening, place)) => whitening.columns(3 * place, 3).into_owned(),
            None => DMatrix::identity(3, 3),
        }
    }

    fn explained(&self, now: &Shifted, observation: usize) -> Option<Explained> {
        let (rows, _) = self.pose_of(observation);
        let columns = self.columns(observation);
        let own = now.jacobian.select_rows(&rows) * &now.spread;
        let against = columns.tr_mul(&now.residuals.select_rows(&rows));
        let fitted = own.tr_mul(&columns);
        let alone = columns.tr_mul(&columns);
        let left = &alone - fitted.tr_mul(&fitted);
        let three = |matrix: &DMatrix<f64>| -> Matrix3<f64> { matrix.fixed_view::<3, 3>(0, 0).into_owned() };
        let against: Vector3<f64> = against.fixed_rows::<3>(0).into_owned();
        // A reading that alone determines a direction cannot be tested in that direction.
        let covariance = (three(&left) + three(&alone) * 1e-9).try_inverse()?;
        // The sign is that of predicted minus measured.
        let shift = covariance * against;
        let square = against.dot(&shift);
        let cautious = cautious(&shift, &covariance, &three(&alone))?;
        (square.is_finite() && cautious.is_finite()).then_some(Explained { square, cautious })
    }

    fn judged(&self, residuals: DVector<f64>, spread: DMatrix<f64>, jacobian: DMatrix<f64>) -> Shifted {
        let data = 3 * self.blocks;
        let squares = residuals.rows(0, data).norm_squared();
        let leverage = (jacobian.rows(0, data) * &spread).norm_squared();
        Shifted { residuals, spread, jacobian, squares, freedom: data as f64 - leverage }
    }

    /// The fit with displacements of the `named` readings.
    fn with_shifts(&self, named: &[usize]) -> Option<Shifted> {
        let (rows, n) = self.jacobian.shape();
        let all = n + 3 * named.len();
        let mut system = self.jacobian.clone().resize_horizontally(all + 1, 0.0);
        for (place, observation) in named.iter().enumerate() {
            let columns = self.columns(*observation);
            for (row, own) in self.pose_of(*observation).0.into_iter().zip(columns.row_iter()) {
                // The displacement reduces the residual, hence the sign.
                system.view_mut((row, n + 3 * place), (1, 3)).copy_from(&-own);
            }
        }
        system.column_mut(all).copy_from(self.residuals);
        let r = triangular_factor_of_all(system.as_view());
        if r.nrows() < all {
            return None;
        }
        let spread = r.view((0, 0), (all, all)).solve_upper_triangular(&DMatrix::identity(all, all))?;
        let step = -&spread * r.view((0, all), (all, 1)).column(0);
        let jacobian = system.columns(0, all).into_owned();
        let residuals = self.residuals + &jacobian * &step;
        let is_finite = rows == residuals.len() && residuals.iter().all(|v| v.is_finite());
        is_finite.then(|| self.judged(residuals, spread, jacobian))
    }

    /// The displacement of the reading named at `place`, in the reading's own standard deviations: its residual in a fit without it.
    fn shift(&self, now: &Shifted, place: usize) -> Option<Vector3<f64>> {
        let n = self.jacobian.ncols();
        // The step is what changes the residuals of the fit into the current ones.
        let change = &now.residuals - self.residuals;
        let step = now.spread.clone() * now.spread.tr_mul(&now.jacobian.tr_mul(&change));
        let shift: Vector3<f64> = step.fixed_rows::<3>(n + 3 * place).into_owned();
        shift.iter().all(|v| v.is_finite()).then_some(shift)
    }
}

/// The squared size of a displacement with a larger variance of the prediction; `alone` is the information on the displacement from the reading
/// itself.
fn cautious(shift: &Vector3<f64>, covariance: &Matrix3<f64>, alone: &Matrix3<f64>) -> Option<f64> {
    let own = alone.try_inverse()?;
    Some(shift.dot(&(own + (covariance - own) * EXTRAPOLATED).lu().solve(shift)?))
}
