//! The uncertainty that a fit assigns to a reading.

use nalgebra::Matrix3;

use super::noise::ActuatorMotions;
use super::{Estimate, IdentificationOptions};
use calibrig_model::CalibrationModel;
use calibrig_model::measurement::{MeasurementSet, Observation};

/// Covariance of every reading of a `set`, fitted or not, as the fit of `estimate` weighs readings, in the tracker's frame, m²: as stated,
/// otherwise from the residuals, plus the machine's noise beside its model. The weights of a robust loss are not included.
pub fn weighed_covariances(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
    estimate: &Estimate,
) -> Vec<Matrix3<f64>> {
    let unmodelled = Matrix3::identity() * options.unmodelled_sigma * options.unmodelled_sigma;
    let mut motions = ActuatorMotions::new(model);
    let of = |observation: &Observation| {
        let stated = observation.reading.position_covariance().map(|stated| stated + unmodelled);
        let reading = estimate.reading_covariance(stated);
        if estimate.machine_noise.is_empty() {
            return reading;
        }
        let axes = estimate.robot.stations.get(observation.station).map(|place| *place.rotation.matrix());
        let axes = axes.unwrap_or_else(Matrix3::identity);
        let target = estimate.robot.targets.get(observation.target).copied().unwrap_or_default();
        let motions = motions.at(&observation.command, &target);
        let machine =
            estimate.machine_noise.iter().map(|part| part.covariance(&motions)).sum::<Matrix3<f64>>();
        reading + axes * machine * axes.transpose()
    };
    set.observations.iter().map(of).collect()
}
