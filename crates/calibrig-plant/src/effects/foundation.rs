//! A floor that yields under the robot, and a rail that bends between its feet.

use nalgebra::Vector3;

use super::error::{Range, check};
use super::{EffectError, EffectKind};
use calibrig_model::SixStiffness;

/// The base on an elastic foundation: it sinks and tilts as carriage and arm move. The base frame is its position without a load.
#[derive(Debug, Clone, PartialEq)]
pub struct Foundation {
    /// Point of the base frame about which it tilts, m.
    pub at: Vector3<f64>,
    /// Along and about the base's axes at that point, N/m and N m/rad; infinite if rigid.
    pub stiffness: SixStiffness,
    /// The rail that carries the robot.
    pub rail: Option<RailSpan>,
}

/// A rail on equally spaced feet, bending under its carriage as a beam that is clamped at both feet next to it (Young and Budynas,
/// Roark's Formulas for Stress and Strain, table 8.1, case 1d).
#[derive(Debug, Clone, PartialEq)]
pub struct RailSpan {
    /// Index of the rail's joint.
    pub joint: usize,
    /// Position of the carriage above one of the feet, m.
    pub first_foot: f64,
    /// Distance of the feet, m.
    pub span: f64,
    /// Compliance halfway between two feet along x and y of the carriage's frame, m/N.
    pub compliance: [f64; 2],
}

/// Stiffness of a rail right above a foot, where its carriage is rigid too, N/m: a thousand tonnes sink by 10 nm.
const ABOVE_FOOT: f64 = 1e15;

impl RailSpan {
    /// The stiffness of the carriage's bearing along x and y (given without the rail) in series with that of the rail below it.
    pub(crate) fn carry(&self, position: f64, bearing: &mut SixStiffness) {
        let from_foot = (position - self.first_foot).rem_euclid(self.span) / self.span;
        // Of a load at a with b to the other foot: a³ b³ / (3 EI l³), with its largest value, l³ / (192 EI), as one.
        let share = 64.0 * (from_foot * (1.0 - from_foot)).powi(3);
        for (stiffness, compliance) in bearing.iter_mut().zip(self.compliance) {
            if compliance > 0.0 {
                *stiffness = (1.0 / (1.0 / *stiffness + share * compliance)).min(ABOVE_FOOT);
            }
        }
    }
}

impl Foundation {
    pub(super) fn check(&self, actuators: usize) -> Result<(), EffectError> {
        let kind = EffectKind::Foundation;
        for (axis, &stiffness) in self.stiffness.iter().enumerate() {
            // Infinity is accepted: it is rigid.
            if stiffness != f64::INFINITY {
                check(kind, ("stiffness", axis), stiffness, Range::Positive)?;
            }
        }
        self.at.iter().try_for_each(|at| check(kind, ("place", 0), *at, Range::Finite))?;
        let Some(rail) = &self.rail else { return Ok(()) };
        if rail.joint >= actuators {
            return Err(EffectError::NoSuchPart { effect: kind, part: "joint of the rail's index" });
        }
        check(kind, ("foot's place", rail.joint), rail.first_foot, Range::Finite)?;
        check(kind, ("span", rail.joint), rail.span, Range::Positive)?;
        rail.compliance
            .iter()
            .try_for_each(|c| check(kind, ("compliance", rail.joint), *c, Range::NotNegative))
    }
}
