//! The whitened system at an estimate, for what is read from it: uncertainty, leverage, residual patterns.

use nalgebra::{DMatrix, DVector, Matrix3};

use super::build::{UNSTATED_SIGMA, rebuild};
use super::identify::check;
use super::problem::CalibrationProblem;
use super::{Estimate, IdentificationOptions, IdentifyError, LeastSquares, NoiseScale};
use calibrig_model::CalibrationModel;
use calibrig_model::measurement::MeasurementSet;

/// Residuals and Jacobian of a fit at its estimate. A residual of 1 is one standard deviation.
#[derive(Debug, Clone, PartialEq)]
pub struct Linearisation {
    /// m x n, in the order of the estimate's parameters; rows of the observations, then of nests and target, then of the other priors.
    pub jacobian: DMatrix<f64>,
    /// Predicted minus measured, and the priors; m.
    pub residuals: DVector<f64>,
    /// The first rows: three an observation.
    pub data_rows: usize,
    /// Rows of all that was measured: those, and of nests and target.
    pub measured_rows: usize,
    /// One an observation: takes a displacement of its target in the base frame, m, to standard deviations.
    pub whitening: Vec<Matrix3<f64>>,
}

impl Linearisation {
    /// Standard deviations that the parameters' `covariance` (n x n) predicts for the data rows; `None` where it is of another size.
    pub fn predicted_sigmas(&self, covariance: &DMatrix<f64>) -> Option<Vec<f64>> {
        let n = self.jacobian.ncols();
        if covariance.shape() != (n, n) {
            return None;
        }
        let sigma = |row| {
            let row = self.jacobian.row(row);
            (row * covariance).dot(&row).sqrt()
        };
        Some((0..self.data_rows.min(self.jacobian.nrows())).map(sigma).collect())
    }
}

/// The system that `estimate` solves, evaluated where it ended: with the noise that it was given or found, and without the weights of a
/// robust loss.
///
/// # Errors
///
/// [`IdentifyError`], where the estimate does not belong to model, set and options, or the estimated robot cannot take a pose.
pub fn linearise(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
    estimate: &Estimate,
) -> Result<Linearisation, IdentifyError> {
    let x: Vec<_> = estimate.parameters.iter().map(|p| p.value).collect();
    linearise_at(model, set, options, estimate, &x)
}

/// The same system at `x`, values of the estimate's parameters in their order, SI.
pub(super) fn linearise_at(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
    estimate: &Estimate,
    x: &[f64],
) -> Result<Linearisation, IdentifyError> {
    check(model, set)?;
    options.check()?;
    if let Some(value) = x.iter().copied().find(|value| !value.is_finite()) {
        let field = "a value of the parameters";
        return Err(IdentifyError::Number { field, value, expected: "a finite number" });
    }
    let mut problem = solved(model, set, options, estimate)?;
    let (m, n) = (problem.rows(), problem.parameters());
    let mut linearisation = Linearisation {
        jacobian: DMatrix::zeros(m, n),
        residuals: DVector::zeros(m),
        data_rows: 3 * problem.rows.len(),
        measured_rows: problem.measured_rows(),
        whitening: Vec::new(),
    };
    problem.evaluate(x, &mut linearisation.residuals, Some(&mut linearisation.jacobian));
    let failed = (0..problem.rows.len()).find(|row| !linearisation.residuals[3 * row].is_finite());
    if let Some((pose, source)) = failed.and_then(|row| problem.failure(row)) {
        return Err(IdentifyError::Machine { pose, source });
    }
    linearisation.whitening = (0..problem.rows.len()).map(|row| problem.whitening(row)).collect();
    Ok(linearisation)
}

/// The problem that `estimate` solves.
fn solved(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
    estimate: &Estimate,
) -> Result<CalibrationProblem, IdentifyError> {
    let kept: Vec<_> = estimate.parameters.iter().map(|p| p.id).collect();
    let mut problem = rebuild(model, set, options, &kept)?;
    if problem.parameters != kept {
        let names = problem.parameters.iter().chain(&kept);
        let foreign: Vec<_> =
            names.filter(|id| !(problem.parameters.contains(id) && kept.contains(id))).collect();
        // The same ones in another order, or one of them twice, are not this estimate's, either.
        let named = if foreign.is_empty() { kept.iter().collect() } else { foreign };
        let name = named.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
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
    Ok(problem)
}
