//! Difference of every single reading from an estimate's prediction.

use std::f64::consts::PI;

use nalgebra::{Matrix3, Vector3};

use crate::identification::{Estimate, IdentificationOptions, weighed_covariances};
use calibrig_model::CalibrationModel;
use calibrig_model::measurement::{MeasurementSet, Observation, Reading};

/// Residual of a reading, measured minus predicted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObservationResidual {
    /// In range (m), azimuth and elevation (rad), if the instrument read these.
    pub spherical: Option<Vector3<f64>>,
    /// Root mean square of its three coordinates in standard deviations, with the covariance by which the fit weighs readings; `None` without
    /// one.
    pub standardised: Option<f64>,
    /// The reading's weight in the fit, from 1 down to 0; `None` if it was not fitted.
    pub weight: Option<f64>,
}

/// Residuals of a set whose errors in the base frame (measured minus predicted, m) are known. `fitted`: the estimate was identified from this set.
pub(super) fn residuals(
    model: &CalibrationModel,
    (set, errors): (&MeasurementSet, &[Vector3<f64>]),
    options: &IdentificationOptions,
    estimate: &Estimate,
    fitted: bool,
) -> Vec<ObservationResidual> {
    let covariances = weighed_covariances(model, set, options, estimate);
    let of = |(i, (observation, error)): (usize, (&Observation, &Vector3<f64>))| {
        let axes = estimate.robot.stations.get(observation.station).map(|place| *place.rotation.matrix());
        let in_tracker = axes.unwrap_or_else(Matrix3::identity) * error;
        ObservationResidual {
            spherical: spherical(&observation.reading, &in_tracker),
            standardised: covariances.get(i).and_then(|covariance| standardised(covariance, &in_tracker)),
            weight: fitted.then(|| estimate.weights.get(i).copied().unwrap_or(1.0)),
        }
    };
    set.observations.iter().zip(errors).enumerate().map(of).collect()
}

fn standardised(covariance: &Matrix3<f64>, error: &Vector3<f64>) -> Option<f64> {
    let squares = error.dot(&covariance.cholesky()?.solve(error));
    Some((squares / 3.0).sqrt()).filter(|size| size.is_finite())
}

/// Range, azimuth and elevation less those of the predicted point.
fn spherical(reading: &Reading, error: &Vector3<f64>) -> Option<Vector3<f64>> {
    let Reading::Spherical(read) = reading else { return None };
    let predicted = reading.position() - error;
    let azimuth = read.azimuth - predicted.y.atan2(predicted.x);
    let elevation = read.elevation - predicted.z.atan2(predicted.x.hypot(predicted.y));
    let turned = |angle: f64| angle - 2.0 * PI * (angle / (2.0 * PI)).round();
    Some(Vector3::new(read.range - predicted.norm(), turned(azimuth), turned(elevation)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_model::measurement::SphericalReading;

    #[test]
    fn a_spherical_residual_is_that_of_the_instrument_also_across_the_cut() {
        let reading = |range, azimuth, elevation| SphericalReading {
            face: calibrig_model::measurement::Face::Front,
            range,
            azimuth,
            elevation,
            covariance: Some(Matrix3::identity()),
        };
        for azimuth in [0.3, PI - 1e-4, 1e-4 - PI, 6.0] {
            let (measured, predicted) = (reading(4.0, azimuth, 0.4), reading(3.999, azimuth - 2e-4, 0.4003));
            let error = measured.position() - predicted.position();
            let residual = spherical(&Reading::Spherical(measured), &error).expect("spherical");
            assert!((residual - Vector3::new(1e-3, 2e-4, -3e-4)).norm() < 1e-12, "{residual}");
        }
    }

    #[test]
    fn a_standardised_residual_is_one_where_every_coordinate_is_off_by_its_sigma() {
        let sigma = Vector3::new(1e-5, 3e-5, 2e-5);
        let covariance = Matrix3::from_diagonal(&sigma.component_mul(&sigma));
        let one = standardised(&covariance, &sigma).expect("positive definite");
        assert!((one - 1.0).abs() < 1e-12);
        assert_eq!(standardised(&Matrix3::zeros(), &sigma), None);
    }
}
