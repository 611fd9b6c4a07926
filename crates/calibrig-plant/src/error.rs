//! Why a plant cannot be built or does not settle.

use thiserror::Error;

use super::effects::EffectError;

/// A plant that cannot be built or does not settle. Joints count from 0, as in [`KinematicModel::links`](calibrig_model::KinematicModel::links).
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum PlantError {
    /// The chain is empty.
    #[error("the robot has no joints")]
    NoJoints,
    /// Not one entry per joint.
    #[error("{quantity}: {found} entries: expected one for each of {expected} joints")]
    Length {
        /// What is listed.
        quantity: &'static str,
        /// Number of joints.
        expected: usize,
        /// Number of entries.
        found: usize,
    },
    /// A number that is not finite.
    #[error("{quantity}{} is {value}: expected a finite number", of_joint(*joint))]
    NotFinite {
        /// What it is.
        quantity: &'static str,
        /// Of which joint, if it belongs to one.
        joint: Option<usize>,
        /// The number.
        value: f64,
    },
    /// A negative mass. The crank counts as a body on the elbow.
    #[error("the mass of the body on joint index {joint} is {mass} kg: expected zero or more")]
    Mass {
        /// Index of the joint that carries the body.
        joint: usize,
        /// kg
        mass: f64,
    },
    /// An inertia matrix that is not symmetric.
    #[error(
        "the inertia of the body on joint index {joint} is asymmetric by {asymmetry} kg m²: expected a symmetric matrix"
    )]
    AsymmetricInertia {
        /// Index of the joint that carries the body.
        joint: usize,
        /// Largest difference of two mirrored entries, kg m².
        asymmetry: f64,
    },
    /// Principal moments that are not those of a body: one is not positive, or one exceeds the sum of the other two.
    #[error(
        "the principal moments of inertia {principal:?} kg m² (joint index {joint}) are not those of a body: expected each \
         above zero and none above the sum of the others"
    )]
    Inertia {
        /// Index of the joint that carries the body.
        joint: usize,
        /// In ascending order, kg m².
        principal: [f64; 3],
    },
    /// A drive without a positive stiffness.
    #[error("the drive stiffness of joint index {joint} is {stiffness}: expected more than zero")]
    Stiffness {
        /// Index of the joint.
        joint: usize,
        /// N/m or N m/rad
        stiffness: f64,
    },
    /// A bearing, beam or rod without a positive stiffness, or a negative weight of a beam.
    #[error("{field} of joint index {joint} is {value}: expected more than zero")]
    NotPositive {
        /// Index of the joint; the elbow's for the four-bar.
        joint: usize,
        /// What it is.
        field: &'static str,
        /// SI
        value: f64,
    },
    /// A beam that is heavier than the body that it is part of.
    #[error("the beam of joint index {joint} weighs {beam} kg: expected at most the {body} kg of its body")]
    HeavyBeam {
        /// Index of the joint that carries it.
        joint: usize,
        /// kg
        beam: f64,
        /// kg
        body: f64,
    },
    /// A telescope that is pulled into its housing.
    #[error(
        "segment {segment} of the beam of joint index {joint} is {length} m long at the command: expected more than zero"
    )]
    BeamLength {
        /// Index of the joint that carries it.
        joint: usize,
        /// Index of the segment, from the root.
        segment: usize,
        /// m
        length: f64,
    },
    /// A load on a link that the chain does not have.
    #[error("load index {load} is on link index {link}, but the robot has {joints} links")]
    Load {
        /// Index of the load.
        load: usize,
        /// Index of its link.
        link: usize,
        /// Number of links.
        joints: usize,
    },
    /// The four-bar cannot be closed.
    #[error("the loop does not close: the rod is {rod} m long, but the ends of crank and lever are {} to {} m apart", distances[0], distances[1])]
    OpenLoop {
        /// Length of the rod, m.
        rod: f64,
        /// Least and greatest distance between the ends of crank and lever, m.
        distances: [f64; 2],
    },
    /// The four-bar is close to its dead point.
    #[error("the four-bar is close to its singularity: the angle between rod and lever is {:.2} degrees", angle.to_degrees())]
    Singular {
        /// Between rod and lever, rad.
        angle: f64,
    },
    /// The loads overpower the springs.
    #[error(
        "unstable equilibrium after {steps} steps: under its loads, the least stiffness of the robot is {margin:.1e} of its \
         springs'; use stiffer springs or smaller loads"
    )]
    Unstable {
        /// Steps taken.
        steps: u32,
        /// Smallest eigenvalue of the tangent stiffness, every coordinate scaled by its own spring; zero or negative.
        margin: f64,
    },
    /// A transmission between joints that the chain does not have.
    #[error(
        "the parallelogram joins joint indices {shoulder} and {elbow}, but the robot has {joints} joints"
    )]
    Transmission {
        /// Index of the shoulder.
        shoulder: usize,
        /// Index of the elbow.
        elbow: usize,
        /// Number of joints.
        joints: usize,
    },
    /// A setting that is not a finite number above zero.
    #[error("{option} is {value}: expected a finite number above zero")]
    Option {
        /// Field of [`SettleOptions`](super::SettleOptions).
        option: &'static str,
        /// Its value.
        value: f64,
    },
    /// An invalid floor, hose or stiffening drive.
    #[error(transparent)]
    Effect(#[from] EffectError),
    /// The pose did not come to rest.
    #[error(
        "not at rest after {steps} steps: the target still moves {tip_motion:.1e} m per step, the remaining forces would move \
         a spring by {residual:.1e} (rad or m), and the loop is open by {closure:.1e} m"
    )]
    NotSettled {
        /// Steps taken.
        steps: u32,
        /// Motion of the target in the last step, m.
        tip_motion: f64,
        /// As in [`super::SettledPose::residual`].
        residual: f64,
        /// As in [`super::SettledPose::closure`].
        closure: f64,
    },
}

fn of_joint(joint: Option<usize>) -> String {
    joint.map_or_else(String::new, |joint| format!(" of joint index {joint}"))
}
