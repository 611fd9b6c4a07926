//! What a plant refuses.

use nalgebra::{Matrix3, Vector3};
use thiserror::Error;

use super::{AsBuilt, SettleOptions};
use crate::model::{ActuatorMap, Body, KinematicModel};

/// Relative slack of the triangle inequality, for a lamina or a rod whose inertia was rounded.
const TRIANGLE_SLACK: f64 = 1e-6;
/// Relative slack of the symmetry of an inertia.
const SYMMETRY_SLACK: f64 = 1e-9;

/// A plant that cannot be built or does not settle. Joints count from 0, as in [`KinematicModel::links`].
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum PlantError {
    /// The chain is empty.
    #[error("the robot has no joints")]
    NoJoints,
    /// There is not one entry a joint.
    #[error("{quantity}: {found} entries, one for each of {expected} joints was expected")]
    Length {
        /// What is listed.
        quantity: &'static str,
        /// Number of joints.
        expected: usize,
        /// Number of entries.
        found: usize,
    },
    /// A number is infinite or not a number.
    #[error("{quantity}{} is {value}, a finite number was expected", of_joint(*joint))]
    NotFinite {
        /// What it is.
        quantity: &'static str,
        /// Of which joint, where it is of one.
        joint: Option<usize>,
        /// The number.
        value: f64,
    },
    /// A body without mass.
    #[error("the mass of the body on joint index {joint} is {mass} kg, more than zero was expected")]
    Mass {
        /// Index of the joint that carries the body.
        joint: usize,
        /// kg
        mass: f64,
    },
    /// An inertia matrix that is not symmetric.
    #[error("the inertia of the body on joint index {joint} is asymmetric by {asymmetry} kg m²")]
    AsymmetricInertia {
        /// Index of the joint that carries the body.
        joint: usize,
        /// Largest difference of two mirrored entries, kg m².
        asymmetry: f64,
    },
    /// Principal moments that no body has: one is not positive, or one exceeds the sum of the other two.
    #[error("no body has the principal moments of inertia {principal:?} kg m² (joint index {joint})")]
    Inertia {
        /// Index of the joint that carries the body.
        joint: usize,
        /// In ascending order, kg m².
        principal: [f64; 3],
    },
    /// A drive that does not hold.
    #[error("the drive stiffness of joint index {joint} is {stiffness}, more than zero was expected")]
    Stiffness {
        /// Index of the joint.
        joint: usize,
        /// N/m or N m/rad
        stiffness: f64,
    },
    /// A transmission between joints that the chain does not have.
    #[error("a parallelogram between joint indices {shoulder} and {elbow} of {joints} joints")]
    Transmission {
        /// Index of the shoulder.
        shoulder: usize,
        /// Index of the elbow.
        elbow: usize,
        /// Number of joints.
        joints: usize,
    },
    /// A setting that is not a finite number above zero.
    #[error("{option} is {value}, a finite number above zero was expected")]
    Option {
        /// Field of [`SettleOptions`].
        option: &'static str,
        /// Its value.
        value: f64,
    },
    /// The pose did not come to rest.
    #[error(
        "not at rest after {steps} steps: the target still moves {tip_motion:.1e} m a step and the forces left over would move \
         a drive by {residual:.1e} (rad or m)"
    )]
    NotSettled {
        /// Steps taken.
        steps: u32,
        /// Motion of the target in the last step, m.
        tip_motion: f64,
        /// As in [`super::SettledPose::residual`].
        residual: f64,
    },
}

fn of_joint(joint: Option<usize>) -> String {
    joint.map_or_else(String::new, |joint| format!(" of joint index {joint}"))
}

/// Refuses a robot whose numbers make no machine.
pub(super) fn check_robot(robot: &AsBuilt) -> Result<(), PlantError> {
    let joints = robot.kinematics.joint_count();
    if joints == 0 {
        return Err(PlantError::NoJoints);
    }
    check_length("bodies", joints, robot.statics.bodies.len())?;
    check_length("drive stiffnesses", joints, robot.statics.drive_stiffness.len())?;
    check_kinematics(&robot.kinematics)?;
    check_actuators(&robot.actuators, joints)?;
    for (joint, body) in robot.statics.bodies.iter().enumerate() {
        check_body(joint, body)?;
    }
    for (joint, &stiffness) in robot.statics.drive_stiffness.iter().enumerate() {
        // Infinity passes: it is a rigid drive.
        if stiffness.is_nan() || stiffness <= 0.0 {
            return Err(PlantError::Stiffness { joint, stiffness });
        }
    }
    check_finite("gravity", None, robot.statics.gravity.as_slice())?;
    check_finite("target", None, robot.target.as_slice())
}

/// Refuses options with which nothing would settle.
pub(super) fn check_options(options: &SettleOptions) -> Result<(), PlantError> {
    let positive = [
        ("dt", options.dt),
        ("max_steps", f64::from(options.max_steps)),
        ("tip_tolerance", options.tip_tolerance),
        ("residual_tolerance", options.residual_tolerance),
    ];
    match positive.into_iter().find(|(_, value)| !value.is_finite() || *value <= 0.0) {
        Some((option, value)) => Err(PlantError::Option { option, value }),
        None => Ok(()),
    }
}

/// Refuses a command that is not one finite number an actuator.
pub(super) fn check_command(joints: usize, command: &[f64]) -> Result<(), PlantError> {
    check_length("command", joints, command.len())?;
    command.iter().enumerate().try_for_each(|(joint, &value)| check_finite("command", Some(joint), &[value]))
}

fn check_length(quantity: &'static str, expected: usize, found: usize) -> Result<(), PlantError> {
    if found == expected { Ok(()) } else { Err(PlantError::Length { quantity, expected, found }) }
}

fn check_finite(quantity: &'static str, joint: Option<usize>, values: &[f64]) -> Result<(), PlantError> {
    match values.iter().find(|value| !value.is_finite()) {
        Some(&value) => Err(PlantError::NotFinite { quantity, joint, value }),
        None => Ok(()),
    }
}

fn check_kinematics(model: &KinematicModel) -> Result<(), PlantError> {
    for (joint, link) in model.links.iter().enumerate() {
        for (quantity, value) in
            [("a", link.a), ("alpha", link.alpha), ("beta", link.beta), ("d", link.d), ("theta", link.theta)]
        {
            check_finite(quantity, Some(joint), &[value])?;
        }
    }
    check_finite("last_from_flange", None, model.last_from_flange.to_homogeneous().as_slice())
}

fn check_actuators(map: &ActuatorMap, joints: usize) -> Result<(), PlantError> {
    if let ActuatorMap::Parallelogram { shoulder, elbow, offset, .. } = *map {
        if shoulder >= joints || elbow >= joints || shoulder == elbow {
            return Err(PlantError::Transmission { shoulder, elbow, joints });
        }
        check_finite("parallelogram offset", None, &[offset])?;
    }
    Ok(())
}

fn check_body(joint: usize, body: &Body) -> Result<(), PlantError> {
    check_finite("mass", Some(joint), &[body.mass])?;
    check_finite("centre of mass", Some(joint), body.centre_of_mass.as_slice())?;
    check_finite("inertia", Some(joint), body.inertia.as_slice())?;
    if body.mass <= 0.0 {
        return Err(PlantError::Mass { joint, mass: body.mass });
    }
    check_inertia(joint, &body.inertia)
}

fn check_inertia(joint: usize, inertia: &Matrix3<f64>) -> Result<(), PlantError> {
    let asymmetry = (inertia - inertia.transpose()).amax();
    if asymmetry > SYMMETRY_SLACK * inertia.amax() {
        return Err(PlantError::AsymmetricInertia { joint, asymmetry });
    }
    let mut moments: Vector3<f64> = inertia.symmetric_eigenvalues();
    moments.as_mut_slice().sort_by(f64::total_cmp);
    let [least, middle, greatest] = moments.into();
    if least > 0.0 && greatest <= (least + middle) * (1.0 + TRIANGLE_SLACK) {
        Ok(())
    } else {
        Err(PlantError::Inertia { joint, principal: [least, middle, greatest] })
    }
}
