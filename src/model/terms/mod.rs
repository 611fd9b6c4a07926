//! Corrections that are not constants of the geometry: each has an amplitude that can be identified, and a basis function that depends on
//! the pose, its approach, its temperature or its time.
//!
//! A family of such terms is one file here and one line in [`FAMILIES`].

mod hysteresis;

use std::fmt;

use super::{CalibrationModel, JointKind, Unit};

/// Every family that can be switched on.
pub const FAMILIES: &[&dyn TermFamily] = &[&hysteresis::Hysteresis];

/// What is known of an observation before it is explained. SI.
#[derive(Debug, Clone, Copy)]
pub struct TermInput<'a> {
    /// Actuator commands.
    pub command: &'a [f64],
    /// Sign of each actuator's last motion, 0 where unknown.
    pub approach: &'a [i8],
    /// °C, where known.
    pub temperature: Option<f64>,
    /// Since the session began, s.
    pub time: f64,
}

/// What a term displaces.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TermPlace {
    /// An actuator: its joint, or the crank of a four-bar.
    Actuator(usize),
    /// The frame of a link, behind its joint's motion.
    Frame {
        /// Index of the joint.
        joint: usize,
        /// 0..3 along, 3..6 about x, y, z.
        component: usize,
    },
}

/// One term of a family.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TermId {
    /// Index into [`FAMILIES`].
    family: u8,
    /// Index of the joint.
    joint: u8,
    /// Which term of the family at that joint.
    index: u8,
    /// Whether the amplitude is a length.
    linear: bool,
}

/// Terms of one kind, such as the hysteresis of every actuator.
pub trait TermFamily: Sync {
    /// How a user switches it on.
    fn key(&self) -> &'static str;

    /// What it stands for, for people.
    fn about(&self) -> &'static str;

    /// (joint, index, whether the amplitude is a length) of every term that a robot can have.
    fn terms(&self, model: &CalibrationModel) -> Vec<(usize, usize, bool)>;

    /// Where the term acts.
    fn place(&self, joint: usize, index: usize) -> TermPlace;

    /// Displacement of the place per unit of amplitude.
    fn basis(&self, model: &CalibrationModel, joint: usize, index: usize, input: &TermInput<'_>) -> f64;

    /// Standard deviation of the amplitude's zero-mean prior, m or rad: what such machines have.
    fn prior_sigma(&self, linear: bool) -> f64;

    /// The term's name behind `key_`, such as `theta3` or `d1`; joints count from one.
    fn suffix(&self, joint: usize, index: usize, linear: bool) -> String;

    /// Reads a [`suffix`](Self::suffix).
    fn parse(&self, suffix: &str) -> Option<(usize, usize, bool)>;
}

impl TermId {
    /// Every term that `model` can have of the family of that key; `None` if there is no such family.
    pub fn all_of(key: &str, model: &CalibrationModel) -> Option<Vec<Self>> {
        let family = FAMILIES.iter().position(|family| family.key() == key)?;
        let ids = FAMILIES[family].terms(model).into_iter();
        ids.map(|(joint, index, linear)| Self::new(family, joint, index, linear)).collect()
    }

    fn new(family: usize, joint: usize, index: usize, linear: bool) -> Option<Self> {
        let small = |n: usize| u8::try_from(n).ok();
        Some(Self { family: small(family)?, joint: small(joint)?, index: small(index)?, linear })
    }

    /// Reads the name that `Display` prints.
    pub fn parse(name: &str) -> Option<Self> {
        FAMILIES.iter().enumerate().find_map(|(family, terms)| {
            let suffix = name.strip_prefix(terms.key())?.strip_prefix('_')?;
            let (joint, index, linear) = terms.parse(suffix)?;
            Self::new(family, joint, index, linear)
        })
    }

    /// m or rad.
    pub fn unit(self) -> Unit {
        if self.linear { Unit::Metre } else { Unit::Radian }
    }

    /// The kind of term.
    pub fn family(self) -> &'static dyn TermFamily {
        FAMILIES[usize::from(self.family)]
    }

    /// Index of its joint.
    pub fn joint(self) -> usize {
        usize::from(self.joint)
    }

    /// Where it acts.
    pub fn place(self) -> TermPlace {
        self.family().place(usize::from(self.joint), usize::from(self.index))
    }

    /// Displacement of its place per unit of amplitude.
    pub fn basis(self, model: &CalibrationModel, input: &TermInput<'_>) -> f64 {
        self.family().basis(model, usize::from(self.joint), usize::from(self.index), input)
    }

    /// Standard deviation of the amplitude's prior, m or rad.
    pub fn prior_sigma(self) -> f64 {
        self.family().prior_sigma(self.linear)
    }
}

impl fmt::Display for TermId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (joint, index) = (usize::from(self.joint), usize::from(self.index));
        f.pad(&format!("{}_{}", self.family().key(), self.family().suffix(joint, index, self.linear)))
    }
}

/// Whether a displacement along or about a joint's axis is a length.
fn is_linear(model: &CalibrationModel, joint: usize) -> bool {
    model.kinematics.links[joint].kind == JointKind::Prismatic
}

/// `d3` or `theta3`: the joint variable by its name in the D-H table, joints counted from one.
fn joint_variable(joint: usize, linear: bool) -> String {
    format!("{}{}", if linear { "d" } else { "theta" }, joint + 1)
}

/// Reads [`joint_variable`]: (joint, linear).
fn parse_joint_variable(text: &str) -> Option<(usize, bool)> {
    let (number, linear) = match text.strip_prefix("theta") {
        Some(number) => (number, false),
        None => (text.strip_prefix('d')?, true),
    };
    Some((number.parse::<usize>().ok()?.checked_sub(1)?, linear))
}
