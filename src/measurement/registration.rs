//! Where the tracker stands, from the base nests.

use nalgebra::{Cholesky, Matrix3, Matrix6, SMatrix, Vector6};
use thiserror::Error;

use super::Station;
use crate::geometry::{Transform, best_fit_transform, cross_matrix, small_displacement};

/// Where a station stands, and how well that is known.
#[derive(Debug, Clone, PartialEq)]
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
    /// A covariance that is none.
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
        let rotation = *tracker_from_base.rotation.matrix();
        for (nest, seen) in nests.iter().zip(&seen) {
            let failed = || RegistrationError::Covariance { nest: nest.name.clone() };
            let reading = nest.reading.position_covariance().ok_or_else(failed)?;
            let covariance = reading + rotation * nest.in_base_covariance * rotation.transpose();
            let weight: Matrix3<f64> = Cholesky::new(covariance).ok_or_else(failed)?.inverse();
            let residual = rotation * nest.in_base + tracker_from_base.translation.vector - seen;
            let mut jacobian = SMatrix::<f64, 3, 6>::zeros();
            jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
            jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-rotation * cross_matrix(&nest.in_base)));
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
