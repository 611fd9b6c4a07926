//! What both sides of a measurement may know: robots, measurements, and the mathematics that they share.
//!
//! The estimator (`calibrig-estimation`) and the simulated machine (`calibrig-plant`) depend on this crate and not on each other: the
//! estimator cannot see the truth, and the machine cannot be built from the model that is fitted to it.
//!
//! This crate holds definitions: the [chain of links](CraigLink) and its [transmission](ActuatorMap), [masses and
//! stiffnesses](StaticProperties), the [names of parameters](ParameterId) and [families of terms](FAMILIES), the results of a tracker
//! session ([`measurement::MeasurementSet`]), [rigid transforms](geometry), [distributions](statistics) and [random streams](random). It
//! does not compute where a robot comes to rest: estimator and machine each do that on their own, and tests compare them. Nothing here reads
//! or writes a file.
//!
//! Units are SI and radians; a transform `a_from_b` takes coordinates in b to coordinates in a. Frames, signs and names are in
//! `docs/notation.md`.
//!
//! ```
//! use calibrig_model::{CraigLink, JointKind};
//!
//! let elbow = CraigLink {
//!     name: "elbow".to_owned(),
//!     kind: JointKind::Revolute,
//!     a: 1.35,
//!     alpha: 0.0,
//!     beta: 0.0,
//!     d: 0.0,
//!     theta: 0.0,
//!     limits: [-3.0, 3.0],
//! };
//! // However far the elbow turns, its axis stays where the upper arm ends.
//! let upper_arm_from_elbow = elbow.transform(0.5);
//! assert_eq!(upper_arm_from_elbow.translation.vector.x, 1.35);
//! assert!((upper_arm_from_elbow.rotation.angle() - 0.5).abs() < 1e-15);
//! ```

pub mod float;
pub mod geometry;
pub mod measurement;
pub mod random;
pub mod statistics;
pub mod visibility;

mod actuators;
mod beam;
mod bodies;
mod check;
mod closure;
mod compliances;
mod parameter;
mod payload;
mod pose;
mod robot;
mod terms;

pub use actuators::{ActuatorMap, AxisMap, CrankAxis, ElbowDrive, FourBar, LinkageArm};
pub use beam::BeamError;
pub use bodies::{
    Beam, BeamRun, BeamSegment, Bearing, BearingSide, Body, BodyUncertainty, LinkageStatics, PointLoad,
    RIGID, STANDARD_GRAVITY, Section, SegmentLength, SixStiffness, StaticProperties, Visual, VisualShape,
};
pub use check::ModelError;
pub use closure::{LEAST_TRANSMISSION_ANGLE, LinkageFault, linkage_fault};
pub use parameter::{Compliance, LinkTerm, LinkageTerm, ParameterId, Unit};
pub use payload::{Payload, PayloadError};
pub use pose::PoseQuery;
pub use robot::{CalibrationModel, CraigLink, JointKind, KinematicModel};
pub use terms::{FAMILIES, TermFamily, TermId, TermPlace};

pub use nalgebra;
