//! Finds actuators that would have to be faster than they can.

use std::fmt;

use calibrig_model::{JointKind, KinematicModel};

/// A step of a path that exceeds an actuator's speed limit.
#[derive(Debug, Clone, PartialEq)]
pub struct SpeedExcess {
    /// Index of the point at the end of the step.
    pub point: usize,
    /// Index of the actuator.
    pub actuator: usize,
    /// Name of the actuator's joint.
    pub name: String,
    /// Kind of the joint.
    pub kind: JointKind,
    /// Speed that the step needs, m/s or rad/s.
    pub speed: f64,
    /// Speed limit, m/s or rad/s.
    pub limit: f64,
}

impl fmt::Display for SpeedExcess {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (size, unit) = match self.kind {
            JointKind::Revolute => (1_f64.to_degrees(), "deg/s"),
            JointKind::Prismatic => (1e3, "mm/s"),
        };
        let (speed, limit) = (size * self.speed, size * self.limit);
        let (point, name) = (self.point + 1, &self.name);
        write!(
            f,
            "to point {point}: {name} at {speed:.3} {unit}, {:.3} above its limit of {limit:.3}",
            speed - limit
        )
    }
}

/// Relative tolerance within which a limit counts as kept.
const KEPT: f64 = 1e-9;

/// Excess of a step of this many seconds over the limits, one per actuator; empty without limits.
pub(super) fn exceeded(
    kinematics: &KinematicModel,
    limits: &[f64],
    point: usize,
    [from, to]: [&[f64]; 2],
    seconds: f64,
) -> Vec<SpeedExcess> {
    let steps = from.iter().zip(to).zip(limits.iter().zip(&kinematics.links)).enumerate();
    let faster = |(actuator, ((from, to), (limit, link))): (usize, ((&f64, &f64), (&f64, _)))| {
        let link: &calibrig_model::CraigLink = link;
        let speed = (to - from).abs() / seconds;
        let excess =
            SpeedExcess { point, actuator, name: link.name.clone(), kind: link.kind, speed, limit: *limit };
        (speed > limit * (1.0 + KEPT)).then_some(excess)
    };
    steps.filter_map(faster).collect()
}
