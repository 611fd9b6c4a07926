//! Information that measurements contain on parameters at given values, such as the true ones, and the resulting bounds for any estimator.

use nalgebra::{DMatrix, DVector};

use super::factor::triangular_factor_of_all;
use super::linearisation::linearise_at;
use super::{Estimate, IdentificationOptions, IdentifyError, bayesian_cramer_rao_bound, cramer_rao_bound};
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::{CalibrationModel, ParameterId};

/// The information about parameters, in the square-root form `Rᵀ R`.
#[derive(Debug, Clone, PartialEq)]
pub struct Information {
    parameters: Vec<ParameterId>,
    measured: DMatrix<f64>,
    prior: DMatrix<f64>,
}

/// Information on the parameters of `estimate` at `values` (in their order, SI), from all measurements with their stated noise, and from the
/// priors that are not measurements.
///
/// # Errors
///
/// [`IdentifyError`], where the estimate does not belong to model, set and options, `values` does not have one finite value per parameter, or
/// the robot with these values cannot take a pose.
pub fn information_at(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
    estimate: &Estimate,
    values: &[f64],
) -> Result<Information, IdentifyError> {
    let parameters: Vec<_> = estimate.parameters.iter().map(|p| p.id).collect();
    if values.len() != parameters.len() {
        let (field, value) = ("the number of values", values.len() as f64);
        return Err(IdentifyError::Number { field, value, expected: "one per parameter of the estimate" });
    }
    let system = linearise_at(model, set, options, estimate, values)?;
    let (rows, measured) = (system.jacobian.nrows(), system.measured_rows);
    Ok(Information {
        parameters,
        measured: triangular_factor_of_all(system.jacobian.rows(0, measured).as_view()),
        prior: triangular_factor_of_all(system.jacobian.rows(measured, rows - measured).as_view()),
    })
}

impl Information {
    /// The parameters, in the order of the columns.
    pub fn parameters(&self) -> &[ParameterId] {
        &self.parameters
    }

    /// Whether a parameter has a prior that is not a measurement: a tolerance, or a prior of its own.
    pub fn has_prior(&self) -> bool {
        self.prior.iter().any(|value| *value != 0.0)
    }

    /// The least standard deviations, SI, of any unbiased estimator that uses the measurements alone (observations, nests, targets): the
    /// Cramér-Rao bound. `None` where they do not determine all parameters.
    pub fn cramer_rao_sigmas(&self) -> Option<Vec<f64>> {
        sigmas(&cramer_rao_bound(&self.measured, &self.parameters)?)
    }

    /// The least root mean squared errors, SI, of any estimator, for parameters that are drawn from the priors: the Bayesian Cramér-Rao bound. The
    /// information at these values takes the place of its mean over the priors, from which it differs in second order. `None` where no parameter
    /// has a prior, or where measurements and priors together do not determine all parameters.
    pub fn bayesian_cramer_rao_sigmas(&self) -> Option<Vec<f64>> {
        if !self.has_prior() {
            return None;
        }
        let measured = std::iter::once(&self.measured);
        sigmas(&bayesian_cramer_rao_bound(measured, &self.prior, &self.parameters)?)
    }

    /// `eᵀ I e` of an `error` of the parameters (SI, in their order), with the information of measurements and priors. If the parameters are drawn
    /// from the priors, its mean is at least their number, and equal to it for the best estimator. `None` where the error has another length.
    pub fn squared(&self, error: &[f64]) -> Option<f64> {
        if error.len() != self.parameters.len() {
            return None;
        }
        let error = DVector::from_column_slice(error);
        Some((&self.measured * &error).norm_squared() + (&self.prior * &error).norm_squared())
    }
}

fn sigmas(bound: &DMatrix<f64>) -> Option<Vec<f64>> {
    let sigmas: Vec<_> = bound.diagonal().iter().map(|variance| variance.sqrt()).collect();
    sigmas.iter().all(|sigma| sigma.is_finite()).then_some(sigmas)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identification::{Redundancy, Tolerance, identify};
    use calibrig_model::CraigLink;
    use calibrig_model::nalgebra::Vector3;

    /// Two revolute links about parallel axes, and a third.
    fn robot() -> CalibrationModel {
        let link = |name, a| CraigLink::revolute(name).row(a, 0.0, 0.0, 0.0).limits(-3.0, 3.0);
        let tilted = CraigLink::revolute("c").row(0.3, 1.2, 0.1, 0.0).limits(-3.0, 3.0);
        CalibrationModel::new(vec![link("a", 0.0), link("b", 0.5), tilted]).expect("a robot")
    }

    fn set(sigma: f64) -> MeasurementSet {
        let target = Vector3::new(0.1, 0.05, 0.2);
        let model = robot();
        let points = (0..40).map(|k| {
            let command: Vec<f64> = [0.7, 1.1, 1.9].map(|pace| 1.3 * (pace * f64::from(k)).sin()).into();
            let place = crate::kinematics::target_in_base(&model.kinematics, &command, &target);
            (command, place.expect("a pose"))
        });
        MeasurementSet::of_points(points).with_sigma(sigma)
    }

    /// Compared with the normal matrix of residuals that are differentiated numerically at the same values.
    #[test]
    fn the_information_is_that_of_the_residuals_at_the_values_and_not_at_the_estimate() {
        let (model, set) = (robot(), set(2e-5));
        let tolerance = Some(Tolerance { length: 1e-3, angle: 2e-3 });
        let options = IdentificationOptions { tolerance, ..IdentificationOptions::default() };
        let estimate = identify(&model, &set, &options).expect("an estimate");
        let n = estimate.parameters.len();
        // Far from the estimate, so that the Jacobian differs.
        let values: Vec<_> = (0..n).map(|i| 0.05 * ((3 * i + 1) as f64).sin()).collect();
        let at = |x: &[f64]| linearise_at(&model, &set, &options, &estimate, x).expect("a system");
        let columns: Vec<_> = (0..n)
            .map(|i| {
                let moved = |step: f64| {
                    let mut x = values.clone();
                    x[i] += step;
                    at(&x).residuals
                };
                (moved(1e-6) - moved(-1e-6)) / 2e-6
            })
            .collect();
        let numeric = DMatrix::from_columns(&columns);
        let information = information_at(&model, &set, &options, &estimate, &values).expect("known");
        assert!(information.has_prior());
        let error: Vec<_> = (0..n).map(|i| 1e-3 * ((7 * i + 2) as f64).cos()).collect();
        let expected = (&numeric * DVector::from_column_slice(&error)).norm_squared();
        let found = information.squared(&error).expect("its length");
        assert!((found / expected - 1.0).abs() < 1e-6, "{found} against {expected}");

        let covariance = numeric.tr_mul(&numeric).try_inverse().expect("regular");
        let bayesian = information.bayesian_cramer_rao_sigmas().expect("determined");
        for (i, sigma) in bayesian.iter().enumerate() {
            assert!((sigma / covariance[(i, i)].sqrt() - 1.0).abs() < 1e-4, "{}", estimate.parameters[i].id);
        }
        let there: Vec<_> = estimate.parameters.iter().map(|p| p.value).collect();
        let elsewhere = information_at(&model, &set, &options, &estimate, &there).expect("known");
        let elsewhere = elsewhere.bayesian_cramer_rao_sigmas().expect("determined");
        let off = bayesian.iter().zip(&elsewhere).map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f64::max);
        assert!(off > 1e-3, "the values make a difference: {off}");
        for sigma in bayesian.iter().zip(information.cramer_rao_sigmas().unwrap_or(vec![f64::INFINITY; n])) {
            assert!(*sigma.0 <= sigma.1 * (1.0 + 1e-9), "a prior adds information");
        }
    }

    #[test]
    fn what_does_not_fit_the_estimate_is_refused() {
        let (model, set) = (robot(), set(2e-5));
        let options = IdentificationOptions {
            tolerance: None,
            redundant: Redundancy::Fix,
            ..IdentificationOptions::default()
        };
        let estimate = identify(&model, &set, &options).expect("an estimate");
        let mut values = vec![0.0; estimate.parameters.len()];
        let information = information_at(&model, &set, &options, &estimate, &values).expect("known");
        assert_eq!((information.squared(&[1.0]), information.has_prior()), (None, false));
        assert_eq!(information.bayesian_cramer_rao_sigmas(), None);
        assert!(information.cramer_rao_sigmas().is_some_and(|s| s.iter().all(|s| *s > 0.0)));
        values[0] = f64::NAN;
        assert!(information_at(&model, &set, &options, &estimate, &values).is_err());
        values.pop();
        assert!(information_at(&model, &set, &options, &estimate, &values).is_err());
    }
}
