//! How far loads bend the robot, and how the target moves with what is known of its springs and masses.

mod apply;
mod beam;
mod chain;

pub use apply::apply;
pub use beam::{
    CondensedFrame, EndCompliance, EndStiffness, Frame, FrameError, FrameSolution, Lump, SegmentGroup,
    end_compliance, end_stiffness, segment_groups,
};
pub use chain::{Deflection, ElasticChain, ElasticError, Settled};

use nalgebra::Vector3;

use crate::geometry::Transform;
use crate::kinematics::link_frames;
use crate::model::{JointKind, KinematicModel, StaticProperties};

/// Generalised force of gravity on every joint (N or N m) with the links at `frames` (`base_from_link`).
pub fn gravity_load(model: &KinematicModel, statics: &StaticProperties, frames: &[Transform]) -> Vec<f64> {
    let mut load = vec![0.0; frames.len()];
    // Weight and weighted centre of everything outboard, gathered from the tip inwards.
    let mut mass = 0.0;
    let mut moment = Vector3::zeros();
    for (joint, (frame, body)) in frames.iter().zip(&statics.bodies).enumerate().rev() {
        let centre = frame.rotation * body.centre_of_mass + frame.translation.vector;
        mass += body.mass;
        moment += body.mass * centre;
        let axis: Vector3<f64> = frame.rotation.matrix().column(2).into_owned();
        load[joint] = match model.links[joint].kind {
            JointKind::Prismatic => mass * axis.dot(&statics.gravity),
            JointKind::Revolute => {
                let lever = moment - mass * frame.translation.vector;
                axis.dot(&lever.cross(&statics.gravity))
            }
        };
    }
    load
}

/// First-order deflection of every drive under gravity at the joint variables `q`: load over stiffness, rad or m.
///
/// The load is taken in the undeflected pose; the error is of second order (8-45 µm at the tool for a 10 mm droop).
pub fn joint_deflections(model: &KinematicModel, statics: &StaticProperties, q: &[f64]) -> Vec<f64> {
    let frames = link_frames(model, q);
    gravity_load(model, statics, &frames)
        .iter()
        .zip(&statics.drive_stiffness)
        .map(|(load, stiffness)| load / stiffness)
        .collect()
}
