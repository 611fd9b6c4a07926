//! Tests whether errors and residuals are as large as stated: chi-square, NEES, coverage.

use serde::{Deserialize, Serialize};
use std::fmt;

use nalgebra::{Cholesky, DMatrix, DVector};

use super::{PatternReport, ResidualSet, find_patterns};
use calibrig_model::statistics::{binomial_cdf, chi2_cdf, chi2_quantile, chi2_survival, clopper_pearson};

/// A chi-square value with the probability of a larger one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ChiSquareTest {
    /// Sum of squares, of independent standard normal variables if the statement holds.
    pub chi2: f64,
    /// Degrees of freedom.
    pub dof: f64,
    /// Probability of a larger chi-square if the statement holds.
    pub p_value: f64,
}

impl ChiSquareTest {
    /// The test of `chi2` with `dof` degrees of freedom; `None` without a degree of freedom.
    pub fn new(chi2: f64, dof: f64) -> Option<Self> {
        (dof > 0.0).then(|| Self { chi2, dof, p_value: chi2_survival(chi2, dof) })
    }

    /// Probability of a smaller chi-square if the statement holds.
    pub fn p_of_less(&self) -> f64 {
        chi2_cdf(self.chi2, self.dof)
    }

    /// Actual over stated standard deviation.
    pub fn ratio(&self) -> f64 {
        (self.chi2 / self.dof).sqrt()
    }
}

/// Whether residuals have the size and shape that the stated noise leaves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ConsistencyReport {
    /// Test of their size in the stated noise; `None` where the noise was taken from the residuals themselves, or without a degree of freedom.
    pub size: Option<ChiSquareTest>,
    /// Test of their shape; `None` without a degree of freedom.
    pub shape: Option<PatternReport>,
    /// Probability of a false alarm of each of the two tests; the test of the size divides it between its two tails.
    pub level: f64,
}

/// Tests size and shape of the residuals of a fit at the false-alarm rate `level` (such as 0.001) each. `size` is the chi-square test in the stated
/// noise, if any was stated.
pub fn check_consistency(
    set: &ResidualSet<'_>,
    size: Option<ChiSquareTest>,
    level: f64,
) -> ConsistencyReport {
    ConsistencyReport { size, shape: find_patterns(set, level), level }
}

impl ConsistencyReport {
    /// Whether the residuals are larger than stated.
    pub fn too_large(&self) -> bool {
        self.size.is_some_and(|test| test.p_value < 0.5 * self.level)
    }

    /// Whether they are smaller than stated: the stated noise is too large.
    pub fn too_small(&self) -> bool {
        self.size.is_some_and(|test| test.p_of_less() < 0.5 * self.level)
    }

    /// Whether nothing speaks against the model and the stated noise.
    pub fn is_consistent(&self) -> bool {
        !self.too_large()
            && !self.too_small()
            && self.shape.as_ref().is_none_or(|shape| shape.patterns.is_empty())
    }
}

impl fmt::Display for ConsistencyReport {
    /// One sentence per line.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(size) = self.size.filter(|_| self.too_large()) {
            write!(f, "the residuals are {:.1} times what the stated noise explains", size.ratio())?;
        } else if let Some(size) = self.size.filter(|_| self.too_small()) {
            write!(
                f,
                "the residuals are {:.2} times what the stated noise leaves: the noise is stated too large",
                size.ratio()
            )?;
        } else {
            f.write_str(match self.size {
                Some(_) => "the residuals are as large as the stated noise explains",
                None => "the size of the residuals is not tested: no noise was stated",
            })?;
        }
        match &self.shape {
            None => f.write_str("\ntheir shape is not tested: no degrees of freedom remain"),
            Some(shape) if shape.patterns.is_empty() => {
                f.write_str("\nthey have no pattern against joints, approach, time or sequence")
            }
            Some(shape) => shape.patterns.iter().try_for_each(|pattern| write!(f, "\n{pattern}")),
        }
    }
}

/// The two-sided band that holds chi-square per degree of freedom, with `dof` degrees of freedom, with probability `level`.
pub fn chi2_band(dof: f64, level: f64) -> (f64, f64) {
    let tail = 0.5 * (1.0 - level);
    (chi2_quantile(tail, dof) / dof, chi2_quantile(1.0 - tail, dof) / dof)
}

/// The normalised estimation error squared `eᵀ C⁻¹ e`: chi-square with n degrees of freedom if C is the true n x n covariance of the error e.
/// `None` if C is not n x n and positive definite.
///
/// Source: Y. Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with Applications to Tracking and Navigation" (2001), section 5.4.2.
pub fn nees(error: &DVector<f64>, covariance: &DMatrix<f64>) -> Option<f64> {
    if covariance.shape() != (error.len(), error.len()) {
        return None;
    }
    // Parameters have different units: scaled, the factorisation keeps the small ones.
    let scale = covariance.diagonal().map(|v| 1.0 / v.sqrt());
    let scaled = DMatrix::from_fn(error.len(), error.len(), |i, j| covariance[(i, j)] * scale[i] * scale[j]);
    let whitened = Cholesky::new(scaled)?.l().solve_lower_triangular(&error.component_mul(&scale))?;
    let nees = whitened.norm_squared();
    nees.is_finite().then_some(nees)
}

/// The band that holds the mean NEES of `trials` estimates of `parameters` parameters each with probability `level`.
pub fn mean_nees_band(trials: usize, parameters: usize, level: f64) -> (f64, f64) {
    let (low, high) = chi2_band(trials as f64 * parameters as f64, level);
    (low * parameters as f64, high * parameters as f64)
}

/// How often stated intervals held the truth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Coverage {
    /// Number of intervals that held the truth.
    pub hits: u64,
    /// Number of intervals.
    pub trials: u64,
}

impl Coverage {
    /// Counts one more interval.
    pub fn count(&mut self, held: bool) {
        self.hits += u64::from(held);
        self.trials += 1;
    }

    /// Share of the intervals that held the truth; NaN without intervals.
    pub fn fraction(&self) -> f64 {
        self.hits as f64 / self.trials as f64
    }

    /// Exact confidence interval of the underlying probability (Clopper-Pearson).
    pub fn interval(&self, level: f64) -> (f64, f64) {
        clopper_pearson(self.hits, self.trials, level)
    }

    /// Two-sided p-value of the hypothesis that the probability is `nominal`: twice the smaller exact binomial tail.
    pub fn p_value(&self, nominal: f64) -> f64 {
        let at_most = binomial_cdf(self.hits, self.trials, nominal);
        let at_least =
            if self.hits == 0 { 1.0 } else { 1.0 - binomial_cdf(self.hits - 1, self.trials, nominal) };
        (2.0 * at_most.min(at_least)).min(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nees_is_the_quadratic_form_in_any_units() {
        let a = DMatrix::from_fn(4, 4, |i, j| ((i * 3 + j) as f64).sin() + if i == j { 2.0 } else { 0.0 });
        let covariance = &a * a.transpose();
        let error = DVector::from_vec(vec![0.3, -1.0, 0.2, 0.8]);
        let expected =
            (error.transpose() * covariance.clone().try_inverse().expect("regular") * &error)[(0, 0)];
        let units = DVector::from_vec(vec![1.0, 1e-9, 1e7, 1e-4]);
        let scaled = DMatrix::from_fn(4, 4, |i, j| covariance[(i, j)] * units[i] * units[j]);
        let found = nees(&error.component_mul(&units), &scaled).expect("positive definite");
        assert!((found - expected).abs() < 1e-12 * expected, "{found} {expected}");
        assert_eq!(nees(&error, &DMatrix::from_element(4, 4, 1.0)), None);
    }

    /// The factor 1.96 holds 95 % of a normal variable, and the bands hold draws from the stated distribution.
    #[test]
    fn the_band_of_a_mean_is_narrower_than_that_of_one() {
        // chi-square 10 at 2.5 % and 97.5 %: 3.247 and 20.483 (NIST table).
        let (low, high) = chi2_band(10.0, 0.95);
        assert!((low - 0.3247).abs() < 5.1e-5 && (high - 2.0483).abs() < 5.1e-5, "{low} {high}");
        let (low, high) = mean_nees_band(2, 5, 0.95);
        assert!((low - 5.0 * 0.3247).abs() < 3e-4 && (high - 5.0 * 2.0483).abs() < 3e-4, "{low} {high}");
        let test = ChiSquareTest::new(29.588, 10.0).expect("degrees of freedom");
        assert!((test.p_value - 0.001).abs() < 1e-6, "{test:?}");
        assert_eq!(ChiSquareTest::new(1.0, 0.0), None);
    }

    #[test]
    fn coverage_is_doubted_from_where_the_exact_tail_says_so() {
        let of = |hits| Coverage { hits, trials: 1000 };
        assert!(of(950).p_value(0.95) > 0.9);
        assert!(of(920).p_value(0.95) < 1e-3 && of(980).p_value(0.95) < 1e-3);
        let (low, high) = of(950).interval(0.95);
        assert!(low < 0.95 && high > 0.95 && high - low < 0.03);
        let mut coverage = Coverage::default();
        coverage.count(true);
        coverage.count(false);
        assert_eq!(coverage, Coverage { hits: 1, trials: 2 });
        assert_eq!(coverage.fraction(), 0.5);
        // Neither of two coins: one quarter, in either direction.
        assert!((Coverage { hits: 0, trials: 2 }.p_value(0.5) - 0.5).abs() < 1e-15);
    }
}
