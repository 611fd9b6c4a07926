//! Explains why a place cannot be reached.

use std::fmt;

use nalgebra::Vector3;

use super::arm::{Arm, RigidArm};
use super::joint_space::JointSpace;
use super::solver::{Ended, Search};
use super::starts::Starts;
use super::task::Aim;
use calibrig_model::geometry::Transform;
use calibrig_model::{JointKind, KinematicModel};

/// One end of a joint's range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LimitEnd {
    /// The lowest joint variable.
    Low,
    /// The highest.
    High,
}

/// A joint at one of its limits.
#[derive(Debug, Clone, PartialEq)]
pub struct JointAtLimit {
    /// Index of the joint.
    pub joint: usize,
    /// Name of the joint.
    pub name: String,
    /// Which end of the range.
    pub end: LimitEnd,
    /// The limit, m or rad.
    pub limit: f64,
    /// How far beyond the limit, m or rad; zero for a joint on it.
    pub beyond: f64,
    /// Revolute or prismatic.
    pub kind: JointKind,
}

impl fmt::Display for JointAtLimit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let end = if self.end == LimitEnd::Low { "lower" } else { "upper" };
        let (limit, beyond, unit) = match self.kind {
            JointKind::Revolute => (self.limit.to_degrees(), self.beyond.to_degrees(), "deg"),
            JointKind::Prismatic => (1e3 * self.limit, 1e3 * self.beyond, "mm"),
        };
        let name = if self.name.is_empty() { format!("joint {}", self.joint + 1) } else { self.name.clone() };
        if self.beyond > 0.0 {
            write!(f, "{name} {beyond:.3} {unit} beyond its {end} limit of {limit:.3} {unit}")
        } else {
            write!(f, "{name} at its {end} limit of {limit:.3} {unit}")
        }
    }
}

/// The best result for a goal that cannot be met.
#[derive(Debug, Clone, PartialEq)]
pub struct Unreachable {
    /// The command that brings the tool nearest among those found, with angles multiplied by the lever.
    pub command: Vec<f64>,
    /// `base_from_tool` there.
    pub base_from_tool: Transform,
    /// Missing part of the position, m, base axes.
    pub missed: Vector3<f64>,
    /// Missing part of the rotation, rad; zero if the goal asks for none.
    pub missed_angle: f64,
    /// Limits that hold the tool back at this command.
    pub limits: Vec<JointAtLimit>,
    /// Limits that would be passed if the goal could be met without limits, and by how much, for the smallest excess found. `None` where
    /// no solution was found even then: the place is beyond the reach of the links.
    pub without_limits: Option<Vec<JointAtLimit>>,
}

impl fmt::Display for Unreachable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (off, angle) = (1e3 * self.missed.norm(), self.missed_angle.to_degrees());
        write!(f, "the nearest command found misses it by {off:.3} mm")?;
        if angle > 1e-6 {
            write!(f, " and {angle:.3} deg")?;
        }
        list(f, ", with ", &self.limits)?;
        match &self.without_limits {
            Some(limits) => list(f, "; it could be reached with ", limits),
            None => write!(f, "; without limits it could not be reached either"),
        }
    }
}

fn list(f: &mut fmt::Formatter<'_>, before: &str, limits: &[JointAtLimit]) -> fmt::Result {
    for (index, limit) in limits.iter().enumerate() {
        write!(f, "{}{limit}", if index == 0 { before } else { " and " })?;
    }
    Ok(())
}

/// Distance within which a joint counts as at its limit, m or rad.
const AT_LIMIT: f64 = 1e-9;
/// Number of solutions without limits that are compared, and of starts from which they are sought.
const COMPARED: usize = 8;
const SOUGHT: usize = 40;

/// Joints at their limits or beyond.
pub(super) fn at_limits(kinematics: &KinematicModel, joints: &[f64]) -> Vec<JointAtLimit> {
    let links = kinematics.links.iter().zip(joints).enumerate();
    let at = |(joint, (link, q)): (usize, (&calibrig_model::CraigLink, &f64))| {
        let [low, high] = link.limits;
        let (end, limit, beyond) = if low - q >= q - high {
            (LimitEnd::Low, low, low - q)
        } else {
            (LimitEnd::High, high, q - high)
        };
        let (name, kind) = (link.name.clone(), link.kind);
        let beyond = if beyond > AT_LIMIT {
            beyond
        } else if beyond >= -AT_LIMIT {
            0.0
        } else {
            return None;
        };
        Some(JointAtLimit { joint, name, end, limit, beyond, kind })
    };
    links.filter_map(at).collect()
}

/// Turns joints by whole turns to bring them as near to the middle of their ranges as possible.
pub(super) fn unwind(space: &JointSpace, y: &mut [f64]) {
    // Joints that follow others do not turn by whole turns with them.
    if !space.is_plain {
        return;
    }
    for (unknown, joint) in space.free.iter().enumerate() {
        if space.kinematics.links[*joint].kind == JointKind::Revolute {
            let turns = ((y[unknown] - space.middle[unknown]) / std::f64::consts::TAU).round();
            y[unknown] -= turns * std::f64::consts::TAU;
        }
    }
}

/// Unknowns that meet the aim without limits, with the smallest excess over the limits; and that excess.
pub(super) fn without_limits(
    space: &JointSpace,
    arm: &mut RigidArm,
    starts: &Starts,
    aim: Aim,
    nearest: &[f64],
    tolerance: f64,
) -> Option<(Vec<f64>, Vec<JointAtLimit>)> {
    let unlimited = space.without_limits();
    let mut best: Option<(f64, Vec<f64>, Vec<JointAtLimit>)> = None;
    let mut found = 0;
    let mut joints = vec![0.0; space.kinematics.joint_count()];
    let from = std::iter::once(nearest).chain(starts.by_distance(&aim)).take(SOUGHT);
    for start in from {
        let mut y = start.to_vec();
        let mut search = Search::new(arm, &unlimited, aim, tolerance);
        if !matches!(search.descend(&mut y, 60, true), Some((Ended::Reached, _))) {
            continue;
        }
        unwind(space, &mut y);
        if space.joints(&y, &mut joints).is_err() {
            continue;
        }
        let beyond = at_limits(&space.kinematics, &joints);
        let passed: Vec<JointAtLimit> = beyond.into_iter().filter(|limit| limit.beyond > 0.0).collect();
        // As shares of the joints' ranges.
        let share = |limit: &JointAtLimit| {
            let [low, high] = space.kinematics.links[limit.joint].limits;
            let way = high - low;
            limit.beyond / if way.is_finite() && way > 0.0 { way } else { 1.0 }
        };
        let size: f64 = passed.iter().map(share).sum();
        if best.as_ref().is_none_or(|(least, ..)| size < *least) {
            best = Some((size, y, passed));
        }
        found += 1;
        if found == COMPARED || best.as_ref().is_some_and(|(least, ..)| *least == 0.0) {
            break;
        }
    }
    best.map(|(_, y, passed)| (y, passed))
}

/// Describes the nearest pose.
pub(super) fn told<A: Arm>(
    search: &mut Search<'_, A>,
    y: &[f64],
    without_limits: Option<Vec<JointAtLimit>>,
) -> Unreachable {
    let space = search.space;
    let _ = search.go_to(y);
    let base_from_tool = search.arm.base_from_tool();
    let miss = search.aim.miss(&base_from_tool);
    let mut joints = vec![0.0; space.kinematics.joint_count()];
    let limits = match space.joints(y, &mut joints) {
        Ok(()) => at_limits(&space.kinematics, &joints),
        Err(_) => Vec::new(),
    };
    Unreachable {
        command: space.command(y),
        base_from_tool,
        missed: miss.position,
        missed_angle: miss.turn.norm(),
        limits,
        without_limits,
    }
}
