//! Where the tracker stands, from the base nests.

use nalgebra::{Cholesky, DMatrix, DVector, Matrix3, Matrix6, SMatrix, Vector3, Vector6};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{NestObservation, StatedInstrument, Station};
use crate::geometry::{Transform, best_fit_transform, cross_matrix, small_displacement};

/// Where a station stands, and how well that is known.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Registration {
    /// `tracker_from_base`.
    pub tracker_from_base: Transform,
    /// Covariance of the displacement `xi` in `tracker_from_base · exp(xi)`: m², m rad, rad².
    pub covariance: Matrix6<f64>,
    /// Weighted sum of squares of the fit, with 3 nests - 6 degrees of freedom.
    pub chi2: f64,
}

/// Nests that do not determine a station.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum RegistrationError {
    /// Too few.
    #[error(
        "{found} base nests were measured, at least 3 that are not on one line are needed to place the tracker"
    )]
    TooFewNests {
        /// Their number.
        found: usize,
    },
    /// On one line.
    #[error("the base nests lie on one line and do not determine the tracker's place")]
    OnOneLine,
    /// A covariance that is missing or not positive definite.
    #[error("nest {nest}: the covariance is missing or not positive definite")]
    Covariance {
        /// Name of the nest.
        nest: String,
    },
}

/// Gauss-Newton passes; from a best fit two reach rounding, the third is for poor geometry.
const PASSES: usize = 3;

/// Fits `tracker_from_base` to a station's nests, weighted with the readings' and the certified coordinates' covariance.
pub fn register(station: &Station) -> Result<Registration, RegistrationError> {
    let nests = &station.nests;
    if nests.len() < 3 {
        return Err(RegistrationError::TooFewNests { found: nests.len() });
    }
    let seen: Vec<_> = nests.iter().map(|n| n.reading.position()).collect();
    let certified: Vec<_> = nests.iter().map(|n| n.in_base).collect();
    let mut tracker_from_base = best_fit_transform(&seen, &certified).ok_or(RegistrationError::OnOneLine)?;
    for pass in 0.. {
        let mut information = Matrix6::zeros();
        let mut gradient = Vector6::zeros();
        let mut chi2 = 0.0;
        for nest in nests {
            let NestRow { covariance, residual, jacobian } = nest_row(nest, &tracker_from_base)?;
            let failed = || RegistrationError::Covariance { nest: nest.name.clone() };
            let weight: Matrix3<f64> = Cholesky::new(covariance).ok_or_else(failed)?.inverse();
            information += jacobian.transpose() * weight * jacobian;
            gradient += jacobian.transpose() * weight * residual;
            chi2 += (residual.transpose() * weight * residual)[0];
        }
        let factor = Cholesky::new(information).ok_or(RegistrationError::OnOneLine)?;
        if pass == PASSES {
            return Ok(Registration { tracker_from_base, covariance: factor.inverse(), chi2 });
        }
        tracker_from_base *= small_displacement(&-factor.solve(&gradient));
    }
    Err(RegistrationError::OnOneLine)
}

/// A nest as a station sees it: covariance of what is seen and certified, m²; predicted minus seen place, m; its derivative by `xi`.
struct NestRow {
    covariance: Matrix3<f64>,
    residual: Vector3<f64>,
    jacobian: SMatrix<f64, 3, 6>,
}

fn nest_row(nest: &NestObservation, tracker_from_base: &Transform) -> Result<NestRow, RegistrationError> {
    let rotation = *tracker_from_base.rotation.matrix();
    let reading = nest.reading.position_covariance();
    let reading = reading.ok_or_else(|| RegistrationError::Covariance { nest: nest.name.clone() })?;
    let mut jacobian = SMatrix::<f64, 3, 6>::zeros();
    jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-rotation * cross_matrix(&nest.in_base)));
    Ok(NestRow {
        covariance: reading + rotation * nest.in_base_covariance * rotation.transpose(),
        residual: rotation * nest.in_base + tracker_from_base.translation.vector - nest.reading.position(),
        jacobian,
    })
}

/// The whitened system that [`register`] solves, three rows a nest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NestSystem {
    /// Derivative by the displacement `xi` in `tracker_from_base · exp(xi)`, 3 nests x 6.
    pub jacobian: DMatrix<f64>,
    /// Predicted minus seen places, in standard deviations.
    pub residuals: DVector<f64>,
    /// Derivative by the errors that the station's instrument is stated to have, 3 nests x their number.
    pub instrument: DMatrix<f64>,
    /// One a nest, lower triangular: takes a displacement in the tracker's frame, m, to standard deviations.
    pub whitening: Vec<Matrix3<f64>>,
}

/// The nests of a station as seen from `tracker_from_base`.
///
/// # Errors
///
/// [`RegistrationError::Covariance`], of a nest without one.
pub fn nest_system(
    station: &Station,
    tracker_from_base: &Transform,
) -> Result<NestSystem, RegistrationError> {
    let rows = 3 * station.nests.len();
    let stated: Vec<_> = station.instrument.iter().flat_map(StatedInstrument::errors).collect();
    let mut system = NestSystem {
        jacobian: DMatrix::zeros(rows, 6),
        residuals: DVector::zeros(rows),
        instrument: DMatrix::zeros(rows, stated.len()),
        whitening: Vec::new(),
    };
    for (index, nest) in station.nests.iter().enumerate() {
        let NestRow { covariance, residual, jacobian } = nest_row(nest, tracker_from_base)?;
        let factor = Cholesky::new(covariance).and_then(|c| c.l().try_inverse());
        let whitening = factor.ok_or_else(|| RegistrationError::Covariance { nest: nest.name.clone() })?;
        system.jacobian.fixed_view_mut::<3, 6>(3 * index, 0).copy_from(&(whitening * jacobian));
        system.residuals.fixed_rows_mut::<3>(3 * index).copy_from(&(whitening * residual));
        for (column, (term, _)) in stated.iter().enumerate() {
            let displaced = whitening * nest.reading.displaced_by(*term);
            system.instrument.fixed_view_mut::<3, 1>(3 * index, column).copy_from(&displaced);
        }
        system.whitening.push(whitening);
    }
    Ok(system)
}
