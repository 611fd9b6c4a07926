//! Corrections that are not constants of the geometry: each has an amplitude that can be identified, and a basis function that depends on
//! the pose, its approach, the temperature of the air or its time.
//!
//! A family of such terms is one file here and one line in [`FAMILIES`].

mod harmonic;
mod hysteresis;
mod presliding;
mod rail;
mod ratio;
mod spline;

use std::fmt;

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::{ActuatorMap, CalibrationModel, CraigLink, JointKind, PoseQuery, Unit};

/// Every family that can be switched on.
pub const FAMILIES: &[&dyn TermFamily] = &[
    &hysteresis::HysteresisTerms,
    &harmonic::HarmonicTerms,
    &ratio::RatioTerms,
    &rail::RailTerms,
    &presliding::PreslidingTerms,
    &spline::SplineTerms,
];

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
    /// Its key, by which a user switches it on.
    fn key(&self) -> &'static str;

    /// What it stands for, for people.
    fn about(&self) -> &'static str;

    /// (joint, index, whether the amplitude is a length) of every term that a robot can have.
    fn terms(&self, model: &CalibrationModel) -> Vec<(usize, usize, bool)>;

    /// Where the term acts.
    fn place(&self, joint: usize, index: usize) -> TermPlace;

    /// Displacement of the place per unit of amplitude.
    fn basis(&self, model: &CalibrationModel, joint: usize, index: usize, input: &PoseQuery<'_>) -> f64;

    /// Standard deviation of the amplitude's zero-mean prior, m or rad: a typical size on real machines.
    fn prior_sigma(&self, linear: bool) -> f64;

    /// The term's name after `key_`, such as `theta3` or `d1`; joints count from one.
    fn suffix(&self, joint: usize, index: usize, linear: bool) -> String;

    /// Reads a [`suffix`](Self::suffix).
    fn parse(&self, suffix: &str) -> Option<(usize, usize, bool)>;

    /// Whether it is fitted only if its key is given: it has more amplitudes than a session that was not planned for it can support.
    fn is_on_request(&self) -> bool {
        false
    }

    /// Whether its basis functions are spread over [`CalibrationModel::spans`].
    fn is_of_spans(&self) -> bool {
        false
    }

    /// Whether machines differ so much that the size of its prior is found with the fit if it is not stated: `prior_sigma` is then where the search
    /// begins.
    fn is_of_unknown_size(&self) -> bool {
        false
    }

    /// Key of the family without which it is meaningless.
    fn extends(&self) -> Option<&'static str> {
        None
    }
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
    pub fn basis(self, model: &CalibrationModel, input: &PoseQuery<'_>) -> f64 {
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

/// By its name.
impl Serialize for TermId {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for TermId {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        Self::parse(&name).ok_or_else(|| {
            D::Error::custom(format_args!("{name:?}: expected the name of a term, such as ratio_d5"))
        })
    }
}

/// Whether a displacement along or about a joint's axis is a length.
fn is_linear(model: &CalibrationModel, joint: usize) -> bool {
    model.kinematics.links.get(joint).is_some_and(|link| link.kind == JointKind::Prismatic)
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

/// Reads a [`joint_variable`] and, behind `_`, a number from one to `count`: (joint, number less one, linear).
fn parse_counted(text: &str, count: usize) -> Option<(usize, usize, bool)> {
    let (variable, number) = text.split_once('_')?;
    let (joint, linear) = parse_joint_variable(variable)?;
    let index = number.parse::<usize>().ok()?.checked_sub(1)?;
    // A name is read only as it is written: without extra zeros or signs.
    (index < count && number == (index + 1).to_string()).then_some((joint, index, linear))
}

/// Half of the range between a joint's limits, m or rad; half a turn or one metre without limits.
fn half_travel(link: &CraigLink) -> f64 {
    let half = 0.5 * (link.limits[1] - link.limits[0]);
    match link.kind {
        _ if half.is_finite() && half > 0.0 => half,
        JointKind::Revolute => std::f64::consts::PI,
        JointKind::Prismatic => 1.0,
    }
}

/// The joint variable half-way between the limits, zero without limits.
fn middle_of_travel(link: &CraigLink) -> f64 {
    let middle = 0.5 * (link.limits[0] + link.limits[1]);
    if middle.is_finite() { middle } else { 0.0 }
}

/// The actuator's command with every joint half-way between its limits.
fn middle_command(model: &CalibrationModel, actuator: usize) -> f64 {
    let middle = |joint: usize| model.kinematics.links.get(joint).map_or(0.0, middle_of_travel);
    match &model.actuators {
        ActuatorMap::Parallelogram { shoulder, elbow, offset, .. } if *elbow == actuator => {
            middle(*shoulder) + middle(*elbow) - offset
        }
        ActuatorMap::Axes { .. } => {
            let middle: Vec<f64> = model.kinematics.links.iter().map(middle_of_travel).collect();
            model.actuators.command_from_joints(&middle).get(actuator).copied().unwrap_or(0.0)
        }
        _ => middle(actuator),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::KinematicModel;
    use crate::geometry::Transform;

    fn model() -> CalibrationModel {
        let link = |kind, limits| CraigLink {
            name: String::new(),
            kind,
            a: 0.0,
            alpha: 0.0,
            beta: 0.0,
            d: 0.0,
            theta: 0.0,
            limits,
        };
        CalibrationModel {
            kinematics: KinematicModel {
                links: vec![
                    link(JointKind::Prismatic, [0.0, 4.0]),
                    link(JointKind::Revolute, [-2.0, 1.0]),
                    link(JointKind::Revolute, [-1.0, 2.0]),
                    link(JointKind::Revolute, [f64::NEG_INFINITY, f64::INFINITY]),
                ],
                base_from_first: Transform::identity(),
                last_from_flange: Transform::identity(),
            },
            actuators: ActuatorMap::Parallelogram { shoulder: 1, elbow: 2, offset: 0.25, linkage: None },
            statics: None,
            motor_turns: vec![Some(10.0), None, Some(16.0), None],
            spans: Vec::new(),
        }
    }

    #[test]
    fn every_term_has_a_name_of_its_own_and_is_read_back() {
        let model = model();
        let mut seen = Vec::new();
        for family in FAMILIES {
            let all = TermId::all_of(family.key(), &model).expect("a family of the list");
            assert!(!all.is_empty(), "{}", family.key());
            for id in all {
                assert_eq!(TermId::parse(&id.to_string()), Some(id), "{id}");
                assert!(!seen.contains(&id.to_string()), "{id} twice");
                seen.push(id.to_string());
                assert!(id.prior_sigma() > 0.0 && id.joint() < 4);
            }
        }
        assert!(TermId::all_of("growth", &model).is_none());
        for wrong in [
            "harmonic_theta2_sin3",
            "rail_theta1_x2",
            "rail_d1_z2",
            "rail_d1_x1",
            "ratio_",
            "hysteresis_d0",
            "spline_theta1",
            "spline_theta1_0",
            "spline_theta1_8",
            "spline_theta1_01",
            "presliding_d1_4",
            "presliding_d1_+1",
        ] {
            assert_eq!(TermId::parse(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn the_basis_functions_by_hand() {
        let model = model();
        let input =
            PoseQuery::at(&[3.0, -0.5, 0.3, 0.1]).approached(&[1, -1, 0, 1]).moved(&[4e-3, 0.01, 0.02, 0.0]);
        let turn = std::f64::consts::TAU * 16.0 * 0.3;
        for (name, basis, place) in [
            ("hysteresis_theta2", -1.0, TermPlace::Actuator(1)),
            ("presliding_d1_2", (-2.0_f64).exp(), TermPlace::Actuator(0)),
            ("presliding_theta2_1", -(-0.01 / 0.5_f64.to_radians()).exp(), TermPlace::Actuator(1)),
            ("presliding_theta3_1", 0.0, TermPlace::Actuator(2)),
            ("presliding_theta4_3", 1.0, TermPlace::Actuator(3)),
            ("harmonic_theta3_sin1", turn.sin(), TermPlace::Actuator(2)),
            ("harmonic_theta3_cos2", (2.0 * turn).cos(), TermPlace::Actuator(2)),
            ("ratio_d1", 0.5, TermPlace::Actuator(0)),
            // The elbow's command is shoulder + elbow - offset: -0.5 + 0.5 - 0.25 in the middle.
            ("ratio_theta3", (0.3 + 0.25) / 1.5, TermPlace::Actuator(2)),
            ("ratio_theta4", 0.1 / std::f64::consts::PI, TermPlace::Actuator(3)),
            ("rail_d1_x2", -0.125, TermPlace::Frame { joint: 0, component: 0 }),
            ("rail_d1_rz1", 0.5, TermPlace::Frame { joint: 0, component: 5 }),
        ] {
            let id = TermId::parse(name).expect(name);
            assert!((id.basis(&model, &input) - basis).abs() < 1e-14, "{name}");
            assert_eq!(id.place(), place, "{name}");
        }
    }

    /// Half a turn of travel has a (1/2)^(3/2) of what a whole one has; over the span of a session it is the same spline as over limits there.
    #[test]
    fn splines_are_spread_over_limits_or_spans_and_close_where_a_joint_turns_round() {
        let of = |model: &CalibrationModel, name: &str, command: [f64; 4]| {
            TermId::parse(name).expect(name).basis(model, &PoseQuery::at(&command))
        };
        let plain = model();
        // The commands of the second joint go from -2 to 1.
        let ends = [-2.0, 1.0].map(|end| of(&plain, "spline_theta2_1", [0.0, end, 0.0, 0.0]));
        assert!((ends[0] - ends[1]).abs() < 1e-12 && ends[0] > 0.0);
        let spans = vec![[0.0, 4.0], [-0.8, 0.7], [0.0, 1.0], [0.5, 0.5]];
        let narrow = plain.clone().with_spans(spans).expect("spans");
        let end = of(&narrow, "spline_theta2_1", [0.0, 0.7, 0.0, 0.0]);
        assert!((end / ends[0] - 0.5_f64.powf(1.5)).abs() < 1e-12);
        // One that did not move shows nothing.
        assert_eq!(of(&narrow, "spline_theta4_1", [0.0, 0.0, 0.0, 0.5]).to_bits(), 0.0_f64.to_bits());
        for index in 1..=7 {
            let name = format!("spline_theta4_{index}");
            let [a, b] = [-2.0, -2.0 + std::f64::consts::TAU].map(|c| of(&plain, &name, [0.0, 0.0, 0.0, c]));
            assert!((a - b).abs() < 1e-12, "{name}");
        }
        for bad in [vec![[0.0, 1.0]], vec![[1.0, 0.0]; 4], vec![[0.0, f64::NAN]; 4]] {
            assert!(plain.clone().with_spans(bad.clone()).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn harmonics_need_known_motor_turns_and_rails_come_first() {
        let names = |key| -> Vec<String> {
            TermId::all_of(key, &model()).expect("a family").iter().map(ToString::to_string).collect()
        };
        assert_eq!(names("harmonic").len(), 8);
        assert!(names("harmonic").iter().all(|n| n.contains("_d1_") || n.contains("_theta3_")));
        assert!(names("rail").iter().all(|n| n.starts_with("rail_d1_")));
    }
}
