//! The machine as built: the truth, and its rapier multibody. Only the pipeline, the evaluation and the recorder may look.

mod chain;
pub mod effects;
mod multibody;
mod validation;

#[cfg(test)]
mod tests;

pub use multibody::{Plant, SettleOptions};
pub use validation::PlantError;

use effects::Effects;
use nalgebra::Vector3;

use crate::geometry::Transform;
use crate::model::{ActuatorMap, KinematicModel, StaticProperties};

/// The robot as it really is.
#[derive(Debug, Clone, PartialEq)]
pub struct AsBuilt {
    /// Kinematics with their errors.
    pub kinematics: KinematicModel,
    /// The real transmission.
    pub actuators: ActuatorMap,
    /// Real masses and drive stiffnesses. An infinite stiffness is a rigid drive.
    pub statics: StaticProperties,
    /// Real offset of the target in the flange frame, m.
    pub target: Vector3<f64>,
    /// What it does beside its geometry and its elasticity.
    pub effects: Effects,
}

/// A pose at rest.
#[derive(Debug, Clone, PartialEq)]
pub struct SettledPose {
    /// The target in the base frame, m.
    pub target: Vector3<f64>,
    /// `base_from_link` of every link.
    pub links: Vec<Transform>,
    /// Deflection of every drive, rad or m.
    pub deflection: Vec<f64>,
    /// Largest generalised force left over, as the displacement (rad or m) that it would cause on its drive.
    pub residual: f64,
    /// Steps of the simulation.
    pub steps: u32,
}
