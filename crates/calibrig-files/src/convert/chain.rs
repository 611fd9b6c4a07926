//! Which joints of a tree lie between base and tip, and how each moves.

use std::fmt;
use std::ops::Range;

use nalgebra::{Rotation3, Unit, Vector3};

use super::element::origin;
use super::tree::{Joint, Tree};
use crate::input::{InputError, Source};
use calibrig_model::JointKind;
use calibrig_model::geometry::Transform;

/// The joints from base to tip.
#[derive(Debug, Clone)]
pub(super) struct Chain {
    pub base: String,
    pub tip: String,
    /// How base and tip were found, if not named.
    pub chosen: Vec<String>,
    pub joints: Vec<MovingJoint>,
    /// From the last joint's moving side to the tip.
    pub last_from_tip: Transform,
    /// The largest number of an `rpy` on the way, as the file has it.
    pub largest_angle: f64,
}

/// A joint of the chain.
#[derive(Debug, Clone)]
pub(super) struct MovingJoint {
    pub name: String,
    pub kind: JointKind,
    pub continuous: bool,
    /// From the moving side of the joint before (the base) to where the joint turns or slides, at zero.
    pub previous_from_joint: Transform,
    /// Along or about it in that frame, in the sense in which the tip moves.
    pub axis: Unit<Vector3<f64>>,
    /// rad or m; `None` if the file states none.
    pub limits: Option<[f64; 2]>,
    /// The joint that it follows, with factor and offset (rad or m).
    pub mimic: Option<Mimic>,
    pub span: Range<usize>,
}

/// `q = ratio · q of the leader + offset`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Mimic {
    pub leader: String,
    pub ratio: f64,
    pub offset: f64,
}

impl MovingJoint {
    /// What the joint does at its variable.
    fn motion(&self, q: f64) -> Transform {
        match self.kind {
            JointKind::Revolute => {
                Transform::from_parts(Vector3::zeros().into(), Rotation3::from_axis_angle(&self.axis, q))
            }
            JointKind::Prismatic => {
                Transform::from_parts((self.axis.into_inner() * q).into(), Rotation3::identity())
            }
        }
    }
}

impl Chain {
    /// `base_from_tip` at these joint variables: the joints of the file, one after the other.
    pub fn tip_at(&self, q: &[f64]) -> Transform {
        let joints = self.joints.iter().zip(q);
        let last = joints
            .fold(Transform::identity(), |at, (joint, q)| at * joint.previous_from_joint * joint.motion(*q));
        last * self.last_from_tip
    }
}

/// Limits beyond this mean that there are none, rad or m.
const ENDLESS: f64 = 1e5;

/// A step of the path from base to tip: a joint, and whether it is traversed from its child to its parent.
pub(super) type Step = (usize, bool);

pub(super) struct Finder<'a> {
    pub source: &'a Source,
    pub tree: &'a Tree,
}

impl Finder<'_> {
    pub(super) fn error<T>(
        &self,
        span: Range<usize>,
        message: impl fmt::Display,
        expected: &str,
    ) -> Result<T, InputError> {
        Err(self.source.error(span, message, Some(format!("expected {expected}"))))
    }

    /// The chain between links of these names; if one is not named, the only possible one.
    pub fn chain(&self, base: Option<&str>, tip: Option<&str>) -> Result<(Chain, Vec<Step>), InputError> {
        self.check_no_loops()?;
        let mut chosen = Vec::new();
        let tip = tip.map(|name| self.named("--tip", name)).transpose()?;
        let base = match (base, tip) {
            (Some(name), _) => self.named("--base", name)?,
            (None, Some(tip)) => self.root_of(tip),
            (None, None) => self.only_root()?,
        };
        let tip = match tip {
            Some(tip) => tip,
            None => self.only_tip(base, &mut chosen)?,
        };
        let name = |link: usize| self.tree.links[link].name.clone();
        let steps = self.way(base, tip)?;
        let mut chain = Chain {
            base: name(base),
            tip: name(tip),
            chosen,
            joints: Vec::new(),
            last_from_tip: Transform::identity(),
            largest_angle: 0.0,
        };
        let mut since = Transform::identity();
        for (index, upwards) in &steps {
            let joint = &self.tree.joints[*index];
            let parent_from_joint = origin(self.source, joint.origin.as_ref())?;
            let rpy = joint
                .origin
                .as_ref()
                .map(|origin| origin.numbers(self.source, "rpy", 3))
                .transpose()?
                .flatten();
            let angles = rpy.into_iter().flatten().map(f64::abs);
            chain.largest_angle = angles.fold(chain.largest_angle, f64::max);
            let Some(mut moving) = self.moving(joint)? else {
                since *= if *upwards { parent_from_joint.inverse() } else { parent_from_joint };
                continue;
            };
            if *upwards {
                // Seen from the child, the parent moves the other way.
                moving.axis = -moving.axis;
                moving.previous_from_joint = since;
                since = parent_from_joint.inverse();
            } else {
                moving.previous_from_joint = since * parent_from_joint;
                since = Transform::identity();
            }
            chain.joints.push(moving);
        }
        chain.last_from_tip = since;
        if chain.joints.is_empty() {
            let message = format!("no joint between {} and {} moves", chain.base, chain.tip);
            let expected = format!("--base and --tip with moving joints between them; {}", self.ends(base));
            return self.error(self.tree.links[tip].span.clone(), message, &expected);
        }
        Ok((chain, steps))
    }

    fn joint_above(&self, link: usize) -> Option<usize> {
        self.tree.above[link]
    }

    /// Joints from a link up to its root.
    fn up(&self, mut link: usize) -> Vec<usize> {
        let mut joints = Vec::new();
        while let Some(joint) = self.joint_above(link) {
            if joints.len() > self.tree.joints.len() {
                break;
            }
            joints.push(joint);
            link = self.tree.joints[joint].parent;
        }
        joints
    }

    fn check_no_loops(&self) -> Result<(), InputError> {
        for (link, entry) in self.tree.links.iter().enumerate() {
            if self.up(link).len() > self.tree.joints.len() {
                let message = format!("link {} hangs on a loop of joints", entry.name);
                return self.error(entry.span.clone(), message, "a tree: every link connected to one root");
            }
        }
        Ok(())
    }

    fn named(&self, flag: &str, name: &str) -> Result<usize, InputError> {
        if let Some(link) = self.tree.link(name) {
            return Ok(link);
        }
        let names: Vec<_> = self.tree.links.iter().map(|link| link.name.as_str()).collect();
        let hint = match self.tree.joints.iter().find(|joint| joint.name == name) {
            Some(joint) => format!(
                "the name of a link; {name} is the joint from link {} to link {}",
                self.tree.links[joint.parent].name, self.tree.links[joint.child].name
            ),
            None => format!("one of the links {}", listed(&names)),
        };
        self.error(self.tree.span.clone(), format!("{flag} {name}: no link has this name"), &hint)
    }

    fn root_of(&self, link: usize) -> usize {
        self.up(link).last().map_or(link, |joint| self.tree.joints[*joint].parent)
    }

    /// The root of all that moves.
    fn only_root(&self) -> Result<usize, InputError> {
        let roots: Vec<usize> =
            (0..self.tree.links.len()).filter(|link| self.joint_above(*link).is_none()).collect();
        let with_joints: Vec<usize> =
            roots.iter().copied().filter(|root| self.tree.joints.iter().any(|j| j.parent == *root)).collect();
        match (with_joints.as_slice(), roots.as_slice()) {
            ([root], _) => Ok(*root),
            ([], _) => {
                self.error(self.tree.span.clone(), "no joint connects two links", "a robot with joints")
            }
            (several, _) => {
                let names: Vec<_> = several.iter().map(|root| self.tree.links[*root].name.as_str()).collect();
                let message =
                    format!("{} links are not connected to any joint: {}", names.len(), listed(&names));
                self.error(self.tree.links[several[1]].span.clone(), message, "--base with one of them")
            }
        }
    }

    pub(super) fn is_moving(&self, joint: usize) -> bool {
        self.tree.joints[joint].kind != "fixed"
    }

    /// Ends of the tree with a joint that moves between them and the base, with the moving joints that lead there.
    fn tips(&self, base: usize) -> Vec<(usize, Vec<usize>)> {
        let ends =
            (0..self.tree.links.len()).filter(|link| self.tree.joints.iter().all(|j| j.parent != *link));
        let led = |link: usize| {
            let way = self.way(base, link).ok()?;
            let moving: Vec<usize> =
                way.into_iter().map(|(joint, _)| joint).filter(|joint| self.is_moving(*joint)).collect();
            (!moving.is_empty()).then_some((link, moving))
        };
        ends.filter_map(led).collect()
    }

    /// Candidates for the tip, in words.
    fn ends(&self, base: usize) -> String {
        let tips = self.tips(base);
        let named: Vec<_> = tips
            .iter()
            .map(|(link, joints)| {
                let count = joints.len();
                format!(
                    "{} ({count} moving joint{})",
                    self.tree.links[*link].name,
                    if count == 1 { "" } else { "s" }
                )
            })
            .collect();
        let names: Vec<_> = named.iter().map(String::as_str).collect();
        format!("ends of the tree: {}", listed(&names))
    }

    /// The end that must be meant: the only one, or the tool0 of ROS-Industrial if all others are attached to the same link or nearer to the
    /// base.
    fn only_tip(&self, base: usize, chosen: &mut Vec<String>) -> Result<usize, InputError> {
        let tips = self.tips(base);
        let name = |link: usize| self.tree.links[link].name.as_str();
        if let [(tip, _)] = tips.as_slice() {
            return Ok(*tip);
        }
        let tool0 = tips.iter().find(|(link, _)| name(*link) == "tool0");
        if let Some((tip, way)) = tool0
            && tips.iter().all(|(_, joints)| joints.iter().all(|joint| way.contains(joint)))
        {
            let others: Vec<_> =
                tips.iter().filter(|(link, _)| link != tip).map(|(link, _)| name(*link)).collect();
            chosen.push(format!("tip: tool0, not {} (--tip)", listed(&others)));
            return Ok(*tip);
        }
        let message = if tips.is_empty() {
            format!("no moving joint follows {}", name(base))
        } else {
            format!("{} links can be the tip of the chain from {}", tips.len(), name(base))
        };
        let expected = format!("--tip with the link that carries the target; {}", self.ends(base));
        self.error(self.tree.links[base].span.clone(), message, &expected)
    }

    /// The joints from base to tip: up to the common link, and down again.
    fn way(&self, base: usize, tip: usize) -> Result<Vec<Step>, InputError> {
        let (mut up, mut down) = (self.up(base), self.up(tip));
        if self.root_of(base) != self.root_of(tip) {
            let [base, tip] = [base, tip].map(|link| self.tree.links[link].name.as_str());
            let message = format!("links {base} and {tip} belong to different trees");
            return self.error(self.tree.span.clone(), message, "--base and --tip in one tree");
        }
        while let (Some(above), Some(other)) = (up.last(), down.last()) {
            if above != other {
                break;
            }
            up.pop();
            down.pop();
        }
        let up = up.into_iter().map(|joint| (joint, true));
        Ok(up.chain(down.into_iter().rev().map(|joint| (joint, false))).collect())
    }

    /// A joint of the chain; `None` if it is fixed.
    fn moving(&self, joint: &Joint) -> Result<Option<MovingJoint>, InputError> {
        let (kind, continuous) = match joint.kind.as_str() {
            "fixed" => return Ok(None),
            "revolute" => (JointKind::Revolute, false),
            "continuous" => (JointKind::Revolute, true),
            "prismatic" => (JointKind::Prismatic, false),
            other => {
                let message = format!("joint {} is {other}", joint.name);
                return self.error(
                    joint.span.clone(),
                    message,
                    "revolute, continuous, prismatic or fixed joints between base and tip; choose --base and --tip so that \
                     this joint is not between them",
                );
            }
        };
        Ok(Some(MovingJoint {
            name: joint.name.clone(),
            kind,
            continuous,
            previous_from_joint: Transform::identity(),
            axis: self.axis(joint)?,
            limits: self.limits(joint, continuous)?,
            mimic: self.mimic(joint)?,
            span: joint.span.clone(),
        }))
    }

    /// x if the file states nothing, as in URDF.
    fn axis(&self, joint: &Joint) -> Result<Unit<Vector3<f64>>, InputError> {
        let Some(element) = &joint.axis else { return Ok(Vector3::x_axis()) };
        let axis = element
            .numbers(self.source, "xyz", 3)?
            .map_or_else(Vector3::x, |xyz| Vector3::from_row_slice(&xyz));
        match Unit::try_new(axis, 1e-6) {
            Some(axis) => Ok(axis),
            None => {
                let message = format!("the axis of joint {} has length zero", joint.name);
                self.error(element.span.clone(), message, "<axis xyz=\"0 0 1\"/> or another direction")
            }
        }
    }

    fn limits(&self, joint: &Joint, continuous: bool) -> Result<Option<[f64; 2]>, InputError> {
        let Some(element) = joint.limit.as_ref().filter(|_| !continuous) else { return Ok(None) };
        // Some files write infinity, or a number that stands for it.
        let endless = |name| {
            let value = element.attribute(name).and_then(|(text, _)| text.trim().parse::<f64>().ok());
            value.is_some_and(|value| value.abs() > ENDLESS)
        };
        if endless("lower") || endless("upper") {
            return Ok(None);
        }
        let number = |name| element.number(self.source, name).map(|value| value.unwrap_or(0.0));
        let [low, high] = [number("lower")?, number("upper")?];
        if low > high {
            let message = format!("the lower limit of joint {} is above its upper limit", joint.name);
            return self.error(
                element.span.clone(),
                message,
                "lower below upper; for a joint without limits, type=\"continuous\"",
            );
        }
        // If a joint cannot move, its limits were never filled in.
        Ok((low < high).then_some([low, high]))
    }

    /// What the joint of that name follows.
    pub fn mimic_of(&self, name: &str) -> Result<Option<Mimic>, InputError> {
        let joint = self.tree.joints.iter().find(|joint| joint.name == name);
        joint.map_or(Ok(None), |joint| self.mimic(joint))
    }

    fn mimic(&self, joint: &Joint) -> Result<Option<Mimic>, InputError> {
        let Some(element) = &joint.mimic else { return Ok(None) };
        let Some((leader, place)) = element.attribute("joint") else {
            let message = format!("the <mimic> of joint {} does not name a joint", joint.name);
            return self.error(element.span.clone(), message, "joint=\"...\"");
        };
        let leader = leader.trim().to_owned();
        if self.tree.joints.iter().all(|other| other.name != leader) {
            let message = format!("joint {} follows joint {leader}, which does not exist", joint.name);
            return self.error(place, message, "the name of a joint");
        }
        let number =
            |name, otherwise: f64| element.number(self.source, name).map(|value| value.unwrap_or(otherwise));
        Ok(Some(Mimic { leader, ratio: number("multiplier", 1.0)?, offset: number("offset", 0.0)? }))
    }
}

/// Names with commas between, the first twenty.
pub(super) fn listed(names: &[&str]) -> String {
    let more = names.len().saturating_sub(20);
    let shown = names.iter().take(20).copied().collect::<Vec<_>>().join(", ");
    if more > 0 { format!("{shown} and {more} more") } else { shown }
}
