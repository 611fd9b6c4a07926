//! Information criteria: how much a parameter must improve the fit.

use serde::{Deserialize, Serialize};

/// What is known of the noise when models are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NoiseLevel {
    /// The residuals are whitened with the true noise.
    Known,
    /// The noise is known up to one common scale, which is estimated with the parameters. What a machine leaves that no model explains is then
    /// noise, and a model gains nothing by explaining it.
    Estimated,
}

/// The fit of one model.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Fit {
    /// Sum of squares of the whitened residuals of the data, priors excluded.
    pub chi2: f64,
    /// Number of measured coordinates.
    pub rows: usize,
    /// Effective number of parameters. With priors, it is the trace of the data's share of the information (see
    /// `identification::Uncertainty::effective_parameters`); without priors, their number.
    pub parameters: f64,
}

/// Criteria of a fit; only differences between models of the same data have a meaning. The smallest value is the best.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Criteria {
    /// Akaike's criterion.
    pub aic: f64,
    /// Akaike's criterion, corrected for few data; infinite where there are too few.
    pub aicc: f64,
    /// Schwarz's criterion.
    pub bic: f64,
}

impl Fit {
    /// The criteria of this fit.
    ///
    /// Source: K. P. Burnham, D. R. Anderson, "Model Selection and Multimodel Inference", 2nd ed. (2002), sections 2.2 to 2.4 and 6.4.1.
    pub fn criteria(&self, noise: NoiseLevel) -> Criteria {
        let n = self.rows as f64;
        let (deviance, k) = match noise {
            NoiseLevel::Known => (self.chi2, self.parameters),
            NoiseLevel::Estimated => (n * (self.chi2 / n).ln(), self.parameters + 1.0),
        };
        let aic = deviance + 2.0 * k;
        let left = n - k - 1.0;
        let correction = if left > 0.0 { 2.0 * k * (k + 1.0) / left } else { f64::INFINITY };
        Criteria { aic, aicc: aic + correction, bic: deviance + k * n.ln() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn criteria_by_hand() {
        let fit = Fit { chi2: 80.0, rows: 100, parameters: 9.0 };
        let known = fit.criteria(NoiseLevel::Known);
        assert!((known.aic - 98.0).abs() < 1e-12);
        assert!((known.aicc - 100.0).abs() < 1e-12);
        assert!((known.bic - (80.0 + 9.0 * 100.0_f64.ln())).abs() < 1e-12);
        let estimated = fit.criteria(NoiseLevel::Estimated);
        assert!((estimated.aic - (100.0 * 0.8_f64.ln() + 20.0)).abs() < 1e-12);
        assert_eq!(Fit { rows: 10, ..fit }.criteria(NoiseLevel::Known).aicc, f64::INFINITY);
    }

    /// With an estimated scale, the difference between the criteria of two models does not change if the noise was stated too small.
    #[test]
    fn an_estimated_scale_forgives_a_wrong_statement() {
        let difference = |factor: f64, noise| {
            let aic = |chi2: f64, parameters| {
                Fit { chi2: factor * chi2, rows: 180, parameters }.criteria(noise).aic
            };
            aic(170.0, 24.0) - aic(169.0, 30.0)
        };
        assert!(
            (difference(1.0, NoiseLevel::Estimated) - difference(400.0, NoiseLevel::Estimated)).abs() < 1e-9
        );
        assert!(difference(1.0, NoiseLevel::Known) < 0.0 && difference(400.0, NoiseLevel::Known) > 0.0);
    }
}
