//! The machine as built: the truth, and its rapier multibody. Only the pipeline, the evaluation and the recorder may look.

mod chain;
mod deviations;
mod distribution;
pub mod effects;
mod error;
pub mod experiment;
mod linkage;
mod multibody;
pub mod session;
mod statics;
pub mod tracker;
mod tree;
mod validation;

#[cfg(test)]
mod tests;

pub use distribution::{AsBuiltDistribution, Spread};
pub use error::PlantError;
pub use multibody::{Plant, SettleOptions};

use effects::Effects;
use nalgebra::Vector3;

use calibrig_model::geometry::Transform;
use calibrig_model::{ActuatorMap, KinematicModel, StaticProperties};

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
    /// `base_from_link` of every link, behind its bearing and its beam.
    pub links: Vec<Transform>,
    /// Deflection of every drive, rad or m. With a four-bar, the elbow's drive is the crank's.
    pub deflection: Vec<f64>,
    /// Deflection of all that yields beside the drives, in the order of the chain, then the rod.
    pub elastic: Vec<ElasticDeflection>,
    /// Shoulder, crank end, lever end and elbow of the four-bar in the base frame, m.
    pub linkage: Option<[Vector3<f64>; 4]>,
    /// Tension of the four-bar's rod, N.
    pub rod_force: Option<f64>,
    /// Largest generalised force left over, as the displacement (rad or m) that it would cause on its spring.
    pub residual: f64,
    /// Distance left between the ends of the four-bar's rod and lever, m; zero without one.
    pub closure: f64,
    /// Steps of the simulation.
    pub steps: u32,
}

/// What yields beside the drives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ElasticPlace {
    /// The bearing of a joint.
    Bearing {
        /// Index of the joint.
        joint: usize,
    },
    /// A segment of a flexible link.
    Beam {
        /// Index of the link.
        link: usize,
        /// Index of the segment, from the root.
        segment: usize,
    },
    /// The rod of the four-bar.
    Rod,
}

/// The deflection of one elementary spring.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ElasticDeflection {
    /// Where it is.
    pub place: ElasticPlace,
    /// Along (0..3) or about (3..6) x, y, z of its group's frame; the rod's is along x.
    pub axis: usize,
    /// rad or m
    pub value: f64,
}
