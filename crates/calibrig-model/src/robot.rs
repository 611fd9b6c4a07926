//! The chain of links, and all that identification is told of a robot beforehand.

use super::{ActuatorMap, LinkTerm, ParameterId, StaticProperties};
use crate::geometry::{Transform, rotation_x, rotation_y, rotation_z, translation};

/// How a joint moves along or about the z axis of its link frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JointKind {
    /// The joint variable is added to theta, rad.
    Revolute,
    /// The joint variable is added to d, m.
    Prismatic,
}

/// One row of Craig's D-H table with Hayati's beta:
/// `T(i-1,i) = Rx(alpha) · Tx(a) · Ry(beta) · Rz(theta + q) · Tz(d)` (revolute) or `· Rz(theta) · Tz(d + q)` (prismatic).
///
/// Beta acts before the joint's rotation, as in Hayati (1983) for nearly parallel axes. SI units and radians.
#[derive(Debug, Clone, PartialEq)]
pub struct CraigLink {
    /// The joint's name, as in the model file and the URDF.
    pub name: String,
    /// Revolute or prismatic.
    pub kind: JointKind,
    /// Link length a(i-1), m.
    pub a: f64,
    /// Link twist alpha(i-1), rad.
    pub alpha: f64,
    /// Hayati's rotation about y, rad.
    pub beta: f64,
    /// Link offset, m (without the joint variable).
    pub d: f64,
    /// Joint angle, rad (without the joint variable).
    pub theta: f64,
    /// Lowest and highest joint variable, rad or m.
    pub limits: [f64; 2],
}

impl CraigLink {
    /// The parameter's value, SI.
    pub fn term(&self, term: LinkTerm) -> f64 {
        match term {
            LinkTerm::A => self.a,
            LinkTerm::Alpha => self.alpha,
            LinkTerm::Beta => self.beta,
            LinkTerm::D => self.d,
            LinkTerm::Theta => self.theta,
        }
    }

    /// The parameter, to change it.
    pub fn term_mut(&mut self, term: LinkTerm) -> &mut f64 {
        match term {
            LinkTerm::A => &mut self.a,
            LinkTerm::Alpha => &mut self.alpha,
            LinkTerm::Beta => &mut self.beta,
            LinkTerm::D => &mut self.d,
            LinkTerm::Theta => &mut self.theta,
        }
    }

    /// The part of the link transform in front of the joint's motion: for both kinds the joint then moves along or about z.
    pub fn fixed_part(&self) -> Transform {
        rotation_x(self.alpha)
            * translation(self.a, 0.0, 0.0)
            * rotation_y(self.beta)
            * rotation_z(self.theta)
            * translation(0.0, 0.0, self.d)
    }

    /// `previous_from_this` at joint variable `q` (rad or m).
    pub fn transform(&self, q: f64) -> Transform {
        let motion = match self.kind {
            JointKind::Revolute => rotation_z(q),
            JointKind::Prismatic => translation(0.0, 0.0, q),
        };
        self.fixed_part() * motion
    }
}

/// An open chain of revolute and prismatic joints, from the base frame B to the flange F.
#[derive(Debug, Clone, PartialEq)]
pub struct KinematicModel {
    /// The links in order from the base.
    pub links: Vec<CraigLink>,
    /// From the last link's frame to the flange; the identity but for tables that end with a link of their own (standard D-H).
    pub last_from_flange: Transform,
}

impl KinematicModel {
    /// Number of joints.
    pub fn joint_count(&self) -> usize {
        self.links.len()
    }

    /// Adds `delta` (SI) to a link parameter. Parameters that are not of a link do not change the chain.
    pub fn add(&mut self, id: ParameterId, delta: f64) {
        if let ParameterId::Link { link, term } = id {
            *self.links[link].term_mut(term) += delta;
        }
    }

    /// A length that is typical of the robot, m: what scales angles to lengths in conditioning.
    pub fn characteristic_length(&self) -> f64 {
        let reach: f64 = self
            .links
            .iter()
            .map(|l| {
                let travel = match l.kind {
                    JointKind::Prismatic => l.limits[1].abs().max(l.limits[0].abs()),
                    JointKind::Revolute => 0.0,
                };
                l.a.abs() + l.d.abs() + travel
            })
            .sum();
        if reach > 0.0 { reach } else { 1.0 }
    }
}

/// All that identification is told about a robot beforehand. The truth of a simulated robot is not in here.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibrationModel {
    /// Nominal kinematics.
    pub kinematics: KinematicModel,
    /// From commands to joint variables.
    pub actuators: ActuatorMap,
    /// Masses, stiffnesses and gravity, where known; without them no deflection can be predicted.
    pub statics: Option<StaticProperties>,
    /// Motor turns per metre or per radian of every actuator, where known: the period of its transmission's errors.
    pub motor_turns: Vec<Option<f64>>,
}
