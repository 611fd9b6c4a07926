//! The chain of links, and all that identification knows about a robot beforehand.

use super::{ActuatorMap, LinkTerm, ModelError, ParameterId, StaticProperties};
use crate::geometry::{Transform, rotation_x, rotation_y, rotation_z, translation};
use serde::{Deserialize, Serialize};

/// How a joint moves along or about the z axis of its link frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
    #[serde(with = "crate::float::array")]
    pub limits: [f64; 2],
}

impl CraigLink {
    /// A joint that turns: no offsets, no limits.
    pub fn revolute(name: impl Into<String>) -> Self {
        Self::new(name.into(), JointKind::Revolute)
    }

    /// A joint that slides: no offsets, no limits.
    pub fn prismatic(name: impl Into<String>) -> Self {
        Self::new(name.into(), JointKind::Prismatic)
    }

    fn new(name: String, kind: JointKind) -> Self {
        let limits = [f64::NEG_INFINITY, f64::INFINITY];
        Self { name, kind, a: 0.0, alpha: 0.0, beta: 0.0, d: 0.0, theta: 0.0, limits }
    }

    /// The same with this row of Craig's table: a(i-1) m, alpha(i-1) rad, d m, theta rad.
    #[must_use]
    pub fn row(self, a: f64, alpha: f64, d: f64, theta: f64) -> Self {
        Self { a, alpha, d, theta, ..self }
    }

    /// The same with Hayati's rotation, rad.
    #[must_use]
    pub fn with_beta(self, beta: f64) -> Self {
        Self { beta, ..self }
    }

    /// The same between these joint variables, rad or m.
    #[must_use]
    pub fn limits(self, low: f64, high: f64) -> Self {
        Self { limits: [low, high], ..self }
    }

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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KinematicModel {
    /// The links in order from the base.
    pub links: Vec<CraigLink>,
    /// From the base to the frame from which the first row starts; the identity for a table that starts at the base. It is needed for
    /// an axis anywhere in the base: a row alone reaches only axes that meet the base's x axis.
    pub base_from_first: Transform,
    /// From the last link's frame to the flange; the identity except for tables that end with a transform of their own
    /// (standard D-H).
    pub last_from_flange: Transform,
}

impl KinematicModel {
    /// The chain of these links, whose last frame is the flange.
    ///
    /// # Errors
    ///
    /// [`ModelError`], for a chain without joints, a number that is not finite, or limits that cross.
    pub fn new(links: Vec<CraigLink>) -> Result<Self, ModelError> {
        let identity = Transform::identity();
        let chain = Self { links, base_from_first: identity, last_from_flange: identity };
        chain.check()?;
        Ok(chain)
    }

    /// Number of joints.
    pub fn joint_count(&self) -> usize {
        self.links.len()
    }

    /// Adds `delta` (SI) to a link parameter. Other parameters do not change the chain.
    pub fn add(&mut self, id: ParameterId, delta: f64) {
        if let ParameterId::Link { link, term } = id
            && let Some(link) = self.links.get_mut(link)
        {
            *link.term_mut(term) += delta;
        }
    }

    /// A typical length of the robot, m: it scales angles to lengths in conditioning.
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

/// All that identification knows about a robot beforehand. It does not include the truth of a simulated robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CalibrationModel {
    /// Nominal kinematics.
    pub kinematics: KinematicModel,
    /// From commands to joint variables.
    pub actuators: ActuatorMap,
    /// Masses, stiffnesses and gravity, if known; without them no deflection can be predicted.
    pub statics: Option<StaticProperties>,
    /// Motor turns per metre or per radian of every actuator, if known: the period of its transmission's errors.
    pub motor_turns: Vec<Option<f64>>,
    /// Lowest and highest command of every actuator, the range of smooth terms, m or rad. If empty, the identification takes the range of the
    /// measurements, and a prediction that of the limits.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub spans: Vec<[f64; 2]>,
}

impl CalibrationModel {
    /// A robot of which only the links are known; every actuator moves its own joint.
    ///
    /// # Errors
    ///
    /// [`ModelError`], as [`KinematicModel::new`].
    pub fn new(links: Vec<CraigLink>) -> Result<Self, ModelError> {
        let kinematics = KinematicModel::new(links)?;
        let motor_turns = vec![None; kinematics.joint_count()];
        Ok(Self { kinematics, actuators: ActuatorMap::Direct, statics: None, motor_turns, spans: Vec::new() })
    }

    /// The same with another map from commands to joints.
    ///
    /// # Errors
    ///
    /// [`ModelError`], if the map names joints that the robot does not have.
    pub fn with_actuators(self, actuators: ActuatorMap) -> Result<Self, ModelError> {
        Self { actuators, ..self }.checked()
    }

    /// The same with masses, stiffnesses and gravity.
    ///
    /// # Errors
    ///
    /// [`ModelError`] with the field, if a list does not have one entry per joint, a number is invalid, or nothing loads the
    /// springs.
    pub fn with_statics(self, statics: StaticProperties) -> Result<Self, ModelError> {
        Self { statics: Some(statics), ..self }.checked()
    }

    /// The same with motor turns per metre or radian of every actuator, if known.
    ///
    /// # Errors
    ///
    /// [`ModelError`], for a number of entries other than that of the joints, or an entry that is not above zero.
    pub fn with_motor_turns(self, motor_turns: Vec<Option<f64>>) -> Result<Self, ModelError> {
        Self { motor_turns, ..self }.checked()
    }

    /// The same with the lowest and highest command of every actuator, the range of smooth terms, m or rad.
    ///
    /// # Errors
    ///
    /// [`ModelError`], for a number of entries other than that of the joints, or a range that is not finite or ends
    /// before it begins.
    pub fn with_spans(self, spans: Vec<[f64; 2]>) -> Result<Self, ModelError> {
        Self { spans, ..self }.checked()
    }

    fn checked(self) -> Result<Self, ModelError> {
        self.check()?;
        Ok(self)
    }
}
