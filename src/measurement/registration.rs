//! Where the tracker stands, from the base nests.
use nalgebra::Matrix6;
use thiserror::Error;

use super::Station;
use crate::geometry::Transform;

/// Where a station stands, and how well that is known.
#[derive(Debug, Clone, PartialEq)]
pub struct Registration {
    /// `tracker_from_base`.
    pub tracker_from_base: Transform,
    /// Covariance of the displacement `xi` in `tracker_from_base · exp(xi)`: m², m rad, rad².
    pub covariance: Matrix6<f64>,
    /// Weighted sum of squares of the fit.
    pub chi2: f64,
}

/// Nests that do not determine a station.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RegistrationError {}

/// Fits a station to its nests.
pub fn register(station: &Station) -> Result<Registration, RegistrationError> {
    let _ = station;
    unimplemented!()
}
