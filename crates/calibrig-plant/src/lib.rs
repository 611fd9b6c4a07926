//! The machine as built, and the tracker that measures it: the truth behind simulated measurements.
//!
//! [`AsBuilt`] is the robot with all its errors, [`Plant`] its multibody in rapier, which [settles](Plant::settle) under gravity at a command.
//! [`effects`] are errors besides geometry and elasticity: backlash, friction, heat. [`tracker`] measures the target; [`session`] goes through
//! the poses that [`experiment`] drew, for any [`session::Machine`], and returns the measurements together with the truth.
//!
//! This crate contains neither what is known about the machine beforehand nor the evaluation of its measurements. The root package joins
//! the two, and it alone compares an estimate with the truth.
//!
//! Units are SI and radians. The base frame is rapier's world frame. The order and the places of the springs are defined in
//! `docs/notation.md`.
//!
//! ```
//! use calibrig_model::geometry::Transform;
//! use calibrig_model::nalgebra::{Matrix3, Point3, Vector3};
//! use calibrig_model::random::{StreamSource, stream};
//! use calibrig_model::{ActuatorMap, Body, CraigLink, JointKind, KinematicModel, StaticProperties};
//! use calibrig_plant::effects::Effects;
//! use calibrig_plant::tracker::{ErrorLine, Instrument, LaserTracker, Shot};
//! use calibrig_plant::{AsBuilt, Plant, SettleOptions};
//!
//! // Two arms of 1 m and 20 kg, stretched out level; y is up, and the drives give.
//! let link = |a| CraigLink {
//!     name: String::new(),
//!     kind: JointKind::Revolute,
//!     a,
//!     alpha: 0.0,
//!     beta: 0.0,
//!     d: 0.0,
//!     theta: 0.0,
//!     limits: [-3.0, 3.0],
//! };
//! let arm = Body { mass: 20.0, centre_of_mass: Vector3::new(0.5, 0.0, 0.0), inertia: Matrix3::identity() };
//! let gravity = Vector3::new(0.0, -9.80665, 0.0);
//! let robot = AsBuilt {
//!     kinematics: KinematicModel { links: vec![link(0.0), link(1.0)], base_from_first: Transform::identity(), last_from_flange: Transform::identity() },
//!     actuators: ActuatorMap::Direct,
//!     statics: StaticProperties::of_drives(vec![arm.clone(), arm], vec![1e5, 1e5], gravity),
//!     target: Vector3::new(1.0, 0.0, 0.0),
//!     effects: Effects::default(),
//! };
//! let pose = Plant::new(&robot, SettleOptions::default())?.settle(&[0.0, 0.0])?;
//! assert!((-0.010..-0.008).contains(&pose.target.y), "it hangs 9 mm low");
//!
//! let transverse = ErrorLine { offset: 15e-6, per_metre: 6e-6 };
//! let instrument = Instrument::of_noise(transverse, ErrorLine { offset: 10e-6, per_metre: 0.3e-6 }, 0.125);
//! let tracker = LaserTracker::levelled(instrument, Vector3::new(1.0, 0.5, 3.0), 0.0, &Vector3::y());
//! let reading = tracker.measure(&pose.target, &Shot::default(), &mut stream(1, 0, StreamSource::IdentificationNoise))?;
//! let seen = tracker.tracker_from_base.inverse() * Point3::from(reading.position());
//! assert!((seen.coords - pose.target).norm() < 50e-6);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # What this crate cannot see
//!
//! The estimator and its model are not reachable: data simulated with the model that is fitted would fit too well. This
//! does not compile:
//!
//! ```compile_fail,E0433
//! use calibrig_estimation::identification::identify;
//! ```

mod carried;
mod chain;
mod confirmation;
mod deviations;
mod distribution;
pub mod effects;
mod error;
pub mod experiment;
mod linkage;
mod multibody;
mod options;
pub mod session;
mod statics;
pub mod tracker;
mod tree;
mod validation;

#[cfg(test)]
mod tests;

pub use distribution::{AsBuiltDistribution, Spread};
pub use error::PlantError;
pub use multibody::Plant;
pub use options::SettleOptions;

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
    /// Errors besides geometry and elasticity.
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
    /// Deflection of all springs besides the drives, in the order of the chain, then the rod.
    pub elastic: Vec<ElasticDeflection>,
    /// Origin of the crank's frame (at the shoulder), crank end, lever end and elbow of the four-bar in the base frame, m.
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

/// What deflects besides the drives.
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
    /// The floor under the base.
    Foundation,
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
