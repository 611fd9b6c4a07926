//! What both sides of a measurement may know: robots, measurements, and the mathematics that they share.
//!
//! The estimator (`calibrig-estimation`) and the simulated machine (`calibrig-plant`) depend on this crate and not on each other, so that
//! the one cannot look at the truth and the other cannot be made with the model that is fitted to it.

pub mod float;
pub mod geometry;
pub mod measurement;
pub mod random;
pub mod statistics;

mod actuators;
mod beam;
mod bodies;
mod check;
mod closure;
mod compliances;
mod parameter;
mod pose;
mod robot;
mod terms;

pub use actuators::{ActuatorMap, FourBar, LinkageArm};
pub use beam::BeamError;
pub use bodies::{
    Beam, BeamRun, BeamSegment, Bearing, BearingSide, Body, LinkageStatics, PointLoad, RIGID, Section,
    SegmentLength, SixStiffness, StaticProperties, Visual, VisualShape,
};
pub use check::ModelError;
pub use closure::{LEAST_TRANSMISSION_ANGLE, LinkageFault, linkage_fault};
pub use parameter::{Compliance, LinkTerm, LinkageLength, ParameterId, Unit};
pub use pose::PoseQuery;
pub use robot::{CalibrationModel, CraigLink, JointKind, KinematicModel};
pub use terms::{FAMILIES, TermFamily, TermId, TermPlace};

pub use nalgebra;
