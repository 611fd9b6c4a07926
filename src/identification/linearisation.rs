//! The whitened system at an estimate, for what is read from it: uncertainty, leverage, residual patterns.

use nalgebra::{DMatrix, DVector};

use super::build::{UNSTATED_SIGMA, rebuild};
use super::{Estimate, IdentificationOptions, IdentifyError, LeastSquares, NoiseScale};
use crate::measurement::MeasurementSet;
use crate::model::CalibrationModel;

/// Residuals and Jacobian of a fit at its estimate. A residual of 1 is one standard deviation.
#[derive(Debug, Clone, PartialEq)]
pub struct Linearisation {
    /// m x n, in the order of the estimate's parameters; rows of the observations, then of nests and target, then of the other priors.
    pub jacobian: DMatrix<f64>,
    /// Predicted minus measured, and the priors; m.
    pub residuals: DVector<f64>,
    /// The first rows: three an observation.
    pub data_rows: usize,
}

/// The system that `estimate` solves, evaluated where it ended: with the noise that it was given or found, and without the weights of a
/// robust loss.
///
/// # Errors
///
/// [`IdentifyError`], where the estimate does not belong to model, set and options.
pub fn linearise(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
    estimate: &Estimate,
) -> Result<Linearisation, IdentifyError> {
    let kept: Vec<_> = estimate.parameters.iter().map(|p| p.id).collect();
    let mut problem = rebuild(model, set, options, &kept)?;
    if problem.parameters != kept {
        let names = problem.parameters.iter().chain(&kept);
        let foreign = names.filter(|id| !(problem.parameters.contains(id) && kept.contains(id)));
        let name = foreign.map(ToString::to_string).collect::<Vec<_>>().join(", ");
        return Err(IdentifyError::UnknownParameter { name });
    }
    if let NoiseScale::Residuals(sigma) = estimate.noise
        && sigma > 0.0
        && sigma.is_finite()
    {
        for row in &mut problem.rows {
            row.whitening *= UNSTATED_SIGMA / sigma;
        }
    }
    let x: Vec<f64> = estimate.parameters.iter().map(|p| p.value).collect();
    let (m, n) = (problem.rows(), problem.parameters());
    let mut linearisation = Linearisation {
        jacobian: DMatrix::zeros(m, n),
        residuals: DVector::zeros(m),
        data_rows: 3 * problem.rows.len(),
    };
    problem.evaluate(&x, &mut linearisation.residuals, Some(&mut linearisation.jacobian));
    Ok(linearisation)
}
