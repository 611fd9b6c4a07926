//! Whether the nominal robot touches itself or goes below a plane.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{UnitVector3, Vector3};

use super::{Hull, Obstacles, Stance, stance_at};
use crate::geometry::Transform;
use crate::{ActuatorMap, KinematicModel};

/// A robot in its room.
#[derive(Debug, Clone, Copy)]
pub struct Room<'a> {
    /// Its chain.
    pub kinematics: &'a KinematicModel,
    /// Which of its joints follow others.
    pub actuators: &'a ActuatorMap,
    /// Its links.
    pub obstacles: &'a Obstacles,
    /// The target in the flange frame, m.
    pub target: Vector3<f64>,
    /// Planes that nothing may go below: the direction up from each, in the base frame, and its height along it from the base's origin,
    /// m.
    pub planes: &'a [(UnitVector3<f64>, f64)],
}

/// Contacts at every pose, due to how the robot is built or described; they are ignored.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Built {
    /// Parts of the robot that touch each other: 0 is the base, then the number of the joint.
    pub pairs: BTreeSet<[usize; 2]>,
    /// Parts that are below a plane, by its index.
    pub below: BTreeSet<[usize; 2]>,
}

/// What touches what.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Contact {
    /// Two parts, by their numbers as in [`Hull::link`].
    Parts([usize; 2]),
    /// A part, and the plane that it is below, by its index.
    Below([usize; 2]),
}

/// Share of the surveyed poses from which on a contact counts as due to how the robot is built.
const BY_BUILD: f64 = 0.95;
/// Radius about the target that is kept above the planes, m: a reflector and a hand.
const TARGET_RADIUS: f64 = 0.05;

impl Room<'_> {
    /// The joint variables with those of joints that follow others.
    pub fn completed(&self, mut joints: Vec<f64>) -> Vec<f64> {
        self.actuators.follow(&mut joints);
        joints
    }

    /// The parts of the robot at joint variables, and the target behind the last of them.
    fn parts(&self, joints: &[f64]) -> Vec<Hull> {
        let (links, flange) = stance_at(self.kinematics, joints);
        let mut parts = self.obstacles.hulls(Stance { links: &links, flange: &flange });
        let at = self.place(&flange);
        parts.push(Hull { link: links.len(), ends: [at, at], radius: TARGET_RADIUS });
        parts
    }

    fn place(&self, flange: &Transform) -> Vector3<f64> {
        flange.rotation * self.target + flange.translation.vector
    }

    /// The target's place in the base frame at joint variables, m.
    pub fn target_at(&self, joints: &[f64]) -> Vector3<f64> {
        self.place(&stance_at(self.kinematics, joints).1)
    }

    /// All contacts at a pose: pairs of parts that are not neighbours, and parts below planes.
    fn contacts(&self, joints: &[f64]) -> Built {
        let parts = self.parts(joints);
        let mut found = Built::default();
        for (index, part) in parts.iter().enumerate() {
            for (plane, (up, height)) in self.planes.iter().enumerate() {
                if part.lowest(up) < *height {
                    found.below.insert([part.link, plane]);
                }
            }
            let touching = parts[..index]
                .iter()
                .filter(|other| part.link.abs_diff(other.link) > 1 && part.distance(other) < 0.0);
            found.pairs.extend(touching.map(|other| [other.link.min(part.link), other.link.max(part.link)]));
        }
        found
    }

    /// The contacts in nearly all of `poses` (joint variables).
    pub fn survey(&self, poses: &[Vec<f64>]) -> Built {
        let (mut pairs, mut below) = (BTreeMap::new(), BTreeMap::new());
        for joints in poses {
            let found = self.contacts(joints);
            found.pairs.into_iter().for_each(|pair| *pairs.entry(pair).or_insert(0_usize) += 1);
            found.below.into_iter().for_each(|part| *below.entry(part).or_insert(0_usize) += 1);
        }
        let by_build = |counts: BTreeMap<[usize; 2], usize>| {
            let often = |(_, count): &([usize; 2], usize)| *count as f64 >= BY_BUILD * poses.len() as f64;
            counts.into_iter().filter(often).map(|(parts, _)| parts).collect()
        };
        Built { pairs: by_build(pairs), below: by_build(below) }
    }

    /// The first contact at joint variables that is not due to how the robot is built.
    pub fn contact(&self, joints: &[f64], built: &Built) -> Option<Contact> {
        let found = self.contacts(joints);
        let below = found.below.difference(&built.below).next().copied().map(Contact::Below);
        below.or_else(|| found.pairs.difference(&built.pairs).next().copied().map(Contact::Parts))
    }

    /// Whether there is no contact at joint variables except those due to how the robot is built.
    pub fn is_clear(&self, joints: &[f64], built: &Built) -> bool {
        let found = self.contacts(joints);
        found.pairs.is_subset(&built.pairs) && found.below.is_subset(&built.below)
    }
}
