//! The elbow's four-bar without deflection: the plant's starting point, and what the plant refuses.

use std::f64::consts::PI;

use nalgebra::{Point3, Vector3};

use super::tree::Loop;
use super::{AsBuilt, PlantError};
use calibrig_model::LEAST_TRANSMISSION_ANGLE;
use calibrig_model::geometry::{Transform, rotation_z};

/// The passive coordinates of the closed loop, rad.
#[derive(Debug, Clone, Copy)]
pub(super) struct Closed {
    pub(super) elbow: f64,
    /// Of the rod about the crank's z, then about its own y.
    pub(super) rod: [f64; 2],
}

/// Closes the loop of the unloaded robot at the joint variables of the exact parallelogram; the elbow's variable selects one of the two
/// ways to close.
pub(super) fn close(robot: &AsBuilt, joints: &[f64], closure: &Loop) -> Result<Closed, PlantError> {
    let (shoulder, elbow) = (closure.shoulder, closure.elbow);
    let (crank, lever, rod) = (closure.linkage.crank.end(), closure.linkage.lever.end(), closure.linkage.rod);
    let links = &robot.kinematics.links;
    // From the shoulder's motion, which crank and upper arm share, to the elbow's.
    let upper_arm = (shoulder + 1..elbow)
        .fold(rotation_z(joints[shoulder]), |arm, link| arm * links[link].transform(joints[link]));
    let shoulder_from_elbow: Transform = upper_arm * links[elbow].fixed_part();
    let crank_angle = joints[shoulder] + joints[elbow] + links[elbow].theta;
    let shoulder_from_crank = closure.linkage.axis.shoulder_from_axis() * rotation_z(crank_angle);
    let crank_in_elbow = shoulder_from_elbow.inverse() * (shoulder_from_crank * Point3::from(crank));

    // The lever's end is on a circle about the elbow's axis, where the distance to the crank's end is the rod's length.
    let c = crank_in_elbow.coords;
    let radii = c.xy().norm() * lever.xy().norm();
    let mean_square = c.norm_squared() + lever.norm_squared() - 2.0 * c.z * lever.z;
    let cosine = (mean_square - rod * rod) / (2.0 * radii);
    if !(cosine.abs() <= 1.0) {
        let distances = [mean_square - 2.0 * radii, mean_square + 2.0 * radii];
        return Err(PlantError::OpenLoop { rod, distances: distances.map(|square| square.max(0.0).sqrt()) });
    }
    let (middle, half) = (c.y.atan2(c.x) - lever.y.atan2(lever.x), cosine.acos());
    let [one, other] = [middle - half, middle + half].map(|angle| nearest(angle, joints[elbow]));
    let elbow = if (one - joints[elbow]).abs() <= (other - joints[elbow]).abs() { one } else { other };

    let lever_in_shoulder = shoulder_from_elbow * Point3::from(rotation_z(elbow) * lever);
    let lever_motion = Vector3::new(-lever.y, lever.x, 0.0);
    check_transmission(&(rotation_z(elbow) * lever - c), &(rotation_z(elbow) * lever_motion))?;
    let rod_in_crank = shoulder_from_crank.inverse_transform_point(&lever_in_shoulder).coords - crank;
    let rod = rod_in_crank / rod_in_crank.norm();
    Ok(Closed { elbow, rod: [rod.y.atan2(rod.x), -rod.z.clamp(-1.0, 1.0).asin()] })
}

/// The angle plus the whole turns that bring it nearest to the other.
fn nearest(angle: f64, to: f64) -> f64 {
    let turn = 2.0 * PI;
    angle - turn * ((angle - to) / turn).round()
}

/// Refuses a four-bar that transmits hardly any moment to the forearm; `lever_motion` is how the elbow moves the lever's end.
pub(super) fn check_transmission(rod: &Vector3<f64>, lever_motion: &Vector3<f64>) -> Result<(), PlantError> {
    let sine = (rod.dot(lever_motion) / (rod.norm() * lever_motion.norm())).abs();
    let angle = sine.min(1.0).asin();
    // A NaN is left to the steps, which do not converge with one.
    if angle < LEAST_TRANSMISSION_ANGLE { Err(PlantError::Singular { angle }) } else { Ok(()) }
}
