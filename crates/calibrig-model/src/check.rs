//! Whether a robot's data are consistent: lengths that fit, finite numbers, limits in order.

use thiserror::Error;

use super::{
    ActuatorMap, BeamError, Bearing, Body, CalibrationModel, CraigLink, ElbowDrive, JointKind,
    KinematicModel, LinkageArm, ParameterId, PointLoad, StaticProperties,
};
use crate::geometry::Transform;

/// What is wrong with a robot. Joints count from zero here and from one in messages.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[non_exhaustive]
pub enum ModelError {
    /// A chain without joints.
    #[error("the robot has no joints")]
    NoJoints,
    /// A list without exactly one entry per joint.
    #[error("{field} has {found} entries: expected {expected}, one per joint")]
    Length {
        /// The list.
        field: &'static str,
        /// Its length.
        found: usize,
        /// The number of joints.
        expected: usize,
    },
    /// A number outside its valid range.
    #[error("{field}{} is {value}: expected {expected}", of_joint(*joint))]
    Number {
        /// What it is.
        field: &'static str,
        /// Of which joint, if it belongs to one.
        joint: Option<usize>,
        /// The number.
        value: f64,
        /// What was expected.
        expected: &'static str,
    },
    /// Limits that leave no valid joint variable.
    #[error("the limits of joint {} cross, {low} to {high}: expected the lower one first", joint.saturating_add(1))]
    Limits {
        /// Index of the joint.
        joint: usize,
        /// Lowest joint variable, rad or m.
        low: f64,
        /// Highest.
        high: f64,
    },
    /// Something that belongs to a joint that does not exist.
    #[error("{field} refers to joint {}, but the robot has {joints} joints", joint.saturating_add(1))]
    Joint {
        /// What it is.
        field: &'static str,
        /// Index of the joint.
        joint: usize,
        /// The number of joints.
        joints: usize,
    },
    /// An elbow that is not right after its shoulder.
    #[error(
        "the parallelogram joins joints {} and {}: expected an elbow right after its shoulder",
        shoulder.saturating_add(1), elbow.saturating_add(1)
    )]
    Parallelogram {
        /// Index of the shoulder.
        shoulder: usize,
        /// Index of the elbow.
        elbow: usize,
    },
    /// Axes whose shown values do not determine the positions of the actuators.
    #[error(
        "the coupling of the axes cannot be inverted: the shown values do not determine where each actuator is; check sign, \
         ratio and coupling of [joint.shown]"
    )]
    Coupling,
    /// An invalid flexible link.
    #[error("the beam of link {}: {source}", link.saturating_add(1))]
    Beam {
        /// Index of the link.
        link: usize,
        /// Why.
        source: BeamError,
    },
    /// Statics of a four-bar, but the actuators have none.
    #[error("statics.linkage is stated: expected it only if actuators has the lengths of a four-bar")]
    Linkage,
    /// Masses and stiffnesses without any load.
    #[error(
        "statics.gravity is zero and no load has a force, so nothing deflects: state gravity (m/s², in the base frame), or \
         leave statics out"
    )]
    NoGravity,
    /// A parameter that the robot does not have.
    #[error("the robot has no parameter {id}")]
    Parameter {
        /// Which.
        id: ParameterId,
    },
    /// A model that is built differently from the one it should replace.
    #[error("{field} differs from the model that the chain was made from: only values may differ")]
    Structure {
        /// What differs.
        field: &'static str,
    },
}

fn of_joint(joint: Option<usize>) -> String {
    joint.map_or_else(String::new, |joint| format!(" of joint {}", joint.saturating_add(1)))
}

const FINITE: &str = "a finite number";
const POSITIVE: &str = "a finite number above zero";
const STIFF: &str = "a number above zero, infinite if rigid";
const MASS: &str = "a finite number of zero or more";

fn number(
    field: &'static str,
    joint: Option<usize>,
    value: f64,
    holds: impl Fn(f64) -> bool,
    expected: &'static str,
) -> Result<(), ModelError> {
    if holds(value) { Ok(()) } else { Err(ModelError::Number { field, joint, value, expected }) }
}

fn finite(
    field: &'static str,
    joint: Option<usize>,
    values: impl IntoIterator<Item = f64>,
) -> Result<(), ModelError> {
    values.into_iter().try_for_each(|value| number(field, joint, value, f64::is_finite, FINITE))
}

fn stiff(field: &'static str, joint: Option<usize>, value: f64) -> Result<(), ModelError> {
    number(field, joint, value, |v| v > 0.0, STIFF)
}

fn length(field: &'static str, found: usize, expected: usize) -> Result<(), ModelError> {
    if found == expected { Ok(()) } else { Err(ModelError::Length { field, found, expected }) }
}

fn transform(field: &'static str, transform: &Transform) -> Result<(), ModelError> {
    let rotation = transform.rotation.matrix().iter();
    finite(field, None, rotation.chain(transform.translation.vector.iter()).copied())
}

impl KinematicModel {
    /// Whether `values`, such as `joint variables`, are one finite number per joint.
    ///
    /// # Errors
    ///
    /// [`ModelError::Length`] and [`ModelError::Number`] with that field.
    pub fn check_joints(&self, field: &'static str, values: &[f64]) -> Result<(), ModelError> {
        length(field, values.len(), self.joint_count())?;
        (0..).zip(values).try_for_each(|(joint, value)| finite(field, Some(joint), [*value]))
    }

    /// Whether the chain is valid.
    ///
    /// # Errors
    ///
    /// [`ModelError`] with the field, for a chain without joints, a number that is not finite, or limits that cross.
    pub fn check(&self) -> Result<(), ModelError> {
        if self.links.is_empty() {
            return Err(ModelError::NoJoints);
        }
        self.links.iter().enumerate().try_for_each(|(joint, link)| check_link(joint, link))?;
        transform("base_from_first", &self.base_from_first)?;
        transform("last_from_flange", &self.last_from_flange)
    }
}

fn check_link(joint: usize, link: &CraigLink) -> Result<(), ModelError> {
    let of = Some(joint);
    for (field, value) in
        [("a", link.a), ("alpha", link.alpha), ("beta", link.beta), ("d", link.d), ("theta", link.theta)]
    {
        finite(field, of, [value])?;
    }
    let [low, high] = link.limits;
    // Written this way round, it also refuses NaN; infinite limits are no limits.
    if low <= high { Ok(()) } else { Err(ModelError::Limits { joint, low, high }) }
}

impl CalibrationModel {
    /// Whether the robot is valid. Whatever takes a model checks this first.
    ///
    /// # Errors
    ///
    /// [`ModelError`] with the field.
    pub fn check(&self) -> Result<(), ModelError> {
        self.kinematics.check()?;
        let joints = self.kinematics.joint_count();
        self.actuators.check(joints)?;
        length("motor_turns", self.motor_turns.len(), joints)?;
        for (joint, turns) in self.motor_turns.iter().enumerate() {
            if let Some(turns) = turns {
                number("motor_turns", Some(joint), *turns, |v| v > 0.0 && v.is_finite(), POSITIVE)?;
            }
        }
        if !self.spans.is_empty() {
            length("spans", self.spans.len(), joints)?;
        }
        for (joint, [low, high]) in self.spans.iter().copied().enumerate() {
            finite("spans", Some(joint), [low, high])?;
            number("spans", Some(joint), high - low, |v| v >= 0.0, "an end that is not below the begin")?;
        }
        let Some(statics) = &self.statics else { return Ok(()) };
        statics.check(&self.kinematics)?;
        // A four-bar without statics is rigid and weighs nothing; statics without a four-bar are a mistake.
        let stray = statics.linkage.is_some() && self.actuators.four_bar().is_none();
        if stray { Err(ModelError::Linkage) } else { Ok(()) }
    }
}

impl ActuatorMap {
    /// Whether the map is valid for a robot with this many joints.
    ///
    /// # Errors
    ///
    /// [`ModelError`] with the field, for joints that do not exist, an elbow in front of its shoulder, or invalid lengths of a four-bar.
    pub fn check(&self, joints: usize) -> Result<(), ModelError> {
        if let Self::Axes { axes, .. } = self {
            length("actuators.axes", axes.axes(), joints)?;
        }
        let Some(ElbowDrive { shoulder, elbow, offset, linkage }) = self.elbow() else { return Ok(()) };
        for (field, joint) in [("actuators.shoulder", shoulder), ("actuators.elbow", elbow)] {
            if joint >= joints {
                return Err(ModelError::Joint { field, joint, joints });
            }
        }
        if shoulder >= elbow || (linkage.is_some() && shoulder.saturating_add(1) != elbow) {
            return Err(ModelError::Parallelogram { shoulder, elbow });
        }
        finite("actuators.offset", None, [offset])?;
        let Some(linkage) = linkage else { return Ok(()) };
        let arm = |field, arm: LinkageArm| {
            finite(field, None, [arm.angle, arm.along])?;
            number(field, None, arm.length, |v| v > 0.0 && v.is_finite(), POSITIVE)
        };
        arm("actuators.linkage.crank", linkage.crank)?;
        arm("actuators.linkage.lever", linkage.lever)?;
        number("actuators.linkage.rod", None, linkage.rod, |v| v > 0.0 && v.is_finite(), POSITIVE)?;
        let axis = linkage.axis;
        finite("actuators.linkage.axis", None, [axis.x, axis.y, axis.rx, axis.ry])
    }
}

impl StaticProperties {
    fn check(&self, kinematics: &KinematicModel) -> Result<(), ModelError> {
        let joints = kinematics.joint_count();
        length("statics.bodies", self.bodies.len(), joints)?;
        length("statics.drive_stiffness", self.drive_stiffness.len(), joints)?;
        length("statics.bearings", self.bearings.len(), joints)?;
        length("statics.beams", self.beams.len(), joints)?;
        for (joint, link) in kinematics.links.iter().enumerate() {
            let of = Some(joint);
            check_body("statics.bodies", of, &self.bodies[joint])?;
            stiff("statics.drive_stiffness", of, self.drive_stiffness[joint])?;
            let Bearing { stiffness, at, .. } = &self.bearings[joint];
            // The stiffness about the joint's own axis is its drive's: the value here is ignored.
            let own = match link.kind {
                JointKind::Prismatic => 2,
                JointKind::Revolute => 5,
            };
            let mut others = stiffness.iter().enumerate().filter(|(axis, _)| *axis != own);
            others.try_for_each(|(_, k)| stiff("statics.bearings.stiffness", of, *k))?;
            finite("statics.bearings.at", of, [*at])?;
            if let Some(beam) = &self.beams[joint] {
                // Whether it is long enough depends on the pose: limits may be wider than any command.
                beam.check_sections().map_err(|source| ModelError::Beam { link: joint, source })?;
            }
        }
        if let Some(linkage) = &self.linkage {
            stiff("statics.linkage.rod_stiffness", None, linkage.rod_stiffness)?;
            number("statics.linkage.rod_mass", None, linkage.rod_mass, is_mass, MASS)?;
            check_body("statics.linkage.crank", None, &linkage.crank)?;
        }
        self.loads.iter().try_for_each(|load| check_load(load, joints))?;
        finite("statics.gravity", None, self.gravity.iter().copied())?;
        let has_force = self.loads.iter().any(|load| load.force.norm() > 0.0);
        if self.gravity.norm() > 0.0 || has_force { Ok(()) } else { Err(ModelError::NoGravity) }
    }
}

fn is_mass(value: f64) -> bool {
    value >= 0.0 && value.is_finite()
}

fn check_body(field: &'static str, joint: Option<usize>, body: &Body) -> Result<(), ModelError> {
    number(field, joint, body.mass, is_mass, MASS)?;
    finite(field, joint, body.centre_of_mass.iter().chain(body.inertia.iter()).copied())
}

fn check_load(load: &PointLoad, joints: usize) -> Result<(), ModelError> {
    if load.link >= joints {
        return Err(ModelError::Joint { field: "statics.loads", joint: load.link, joints });
    }
    let of = Some(load.link);
    number("statics.loads.mass", of, load.mass, is_mass, MASS)?;
    finite("statics.loads", of, load.at.iter().chain(load.force.iter()).copied())
}
