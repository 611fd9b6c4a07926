//! Where a robot can be measured: a box of joint variables in which it touches neither itself nor what it stands on. The nominal robot is asked.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{UnitVector3, Vector3};
use rand::{Rng, RngExt};

use super::WorkingRegion;
use calibrig_model::geometry::Transform;
use calibrig_model::visibility::{Hull, Obstacles, Stance, stance_at};
use calibrig_model::{ActuatorMap, JointKind, KinematicModel};

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
    /// Planes that nothing goes below: the direction up from each, in the base frame, and its height along it from the base's origin, m.
    pub planes: &'a [(UnitVector3<f64>, f64)],
}

/// What touches whatever the pose, by the way the robot is built or described, and tells nothing.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Built {
    /// Parts of the robot that touch each other: 0 is the base, then the number of the joint.
    pub pairs: BTreeSet<[usize; 2]>,
    /// Parts that are below a plane, by its index.
    pub below: BTreeSet<[usize; 2]>,
}

/// Part of the surveyed poses in which parts that touch do so by the way they are built.
const BY_BUILD: f64 = 0.95;
/// Radius about the target that is kept above the planes, m: a reflector and a hand.
const TARGET_RADIUS: f64 = 0.05;
/// Steps in which a side of the box grows over the whole range of its joint.
const STEPS: f64 = 16.0;
/// Poses looked at in what a step adds.
const OF_STEP: usize = 48;
/// Poses of the whole box that are looked at in the end.
const OF_BOX: usize = 2000;
/// The box is made so much smaller where one of them touches.
const SHRINK: f64 = 0.95;

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

    /// All that touches at a pose: pairs of parts that are no neighbours, and parts below planes.
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

    /// What touches in nearly all of `poses` (joint variables).
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

    /// Whether nothing touches at joint variables but what does so by build.
    pub fn is_clear(&self, joints: &[f64], built: &Built) -> bool {
        let found = self.contacts(joints);
        found.pairs.is_subset(&built.pairs) && found.below.is_subset(&built.below)
    }

    /// The largest box that is found between `ranges` (rad or m, one a joint) in which nothing touches: grown from each clear pose of `starts` on
    /// all sides alike, as long as no pose drawn in what is added touches. `None` where no start is clear.
    ///
    /// Its numbers are rounded to mrad and mm, and none of 2000 poses drawn in it touches.
    pub fn clear_region(
        &self,
        ranges: &[[f64; 2]],
        starts: &[Vec<f64>],
        built: &Built,
        rng: &mut impl Rng,
    ) -> Option<WorkingRegion> {
        let inside = |joints: &[f64]| {
            let mut moved = joints.iter().zip(ranges).enumerate();
            moved.all(|(joint, (q, [low, high]))| !self.moves(ranges, joint) || (*low..=*high).contains(q))
        };
        let starts = starts.iter().filter(|start| inside(start) && self.is_clear(start, built));
        let boxes = starts.map(|start| self.grown(ranges, start, built, rng));
        let size = |sides: &[[f64; 2]]| -> f64 {
            let parts = sides.iter().zip(ranges).enumerate().filter(|(joint, _)| self.moves(ranges, *joint));
            parts.map(|(_, (side, range))| ((side[1] - side[0]) / (range[1] - range[0])).max(1e-3).ln()).sum()
        };
        let best = boxes.max_by(|a, b| size(a).total_cmp(&size(b)))?;
        let mut region = self.rounded(&best);
        loop {
            let clear = (0..OF_BOX).all(|_| self.is_clear(&self.completed(region.draw(rng)), built));
            if clear || region.half_width.iter().all(|half| *half == 0.0) {
                return Some(region);
            }
            let sides = region.centre.iter().zip(&region.half_width);
            let smaller: Vec<_> = sides.map(|(c, h)| [c - SHRINK * h, c + SHRINK * h]).collect();
            region = self.rounded(&smaller);
        }
    }

    /// Whether a joint is one of those that the box has a side for.
    fn moves(&self, ranges: &[[f64; 2]], joint: usize) -> bool {
        self.actuators.is_commanded(joint) && ranges[joint][1] > ranges[joint][0]
    }

    fn grown(&self, ranges: &[[f64; 2]], start: &[f64], built: &Built, rng: &mut impl Rng) -> Vec<[f64; 2]> {
        let mut sides: Vec<[f64; 2]> = start.iter().map(|q| [*q, *q]).collect();
        let mut step: Vec<[f64; 2]> = ranges.iter().map(|range| [(range[1] - range[0]) / STEPS; 2]).collect();
        let mut growing = true;
        while growing {
            growing = false;
            for joint in (0..sides.len()).filter(|joint| self.moves(ranges, *joint)) {
                for side in 0..2 {
                    let at = sides[joint][side];
                    let limit = ranges[joint][side];
                    let length = step[joint][side].min((limit - at).abs());
                    if length <= 0.0 {
                        continue;
                    }
                    let next = if side == 0 { at - length } else { at + length };
                    let mut added = sides.clone();
                    added[joint] = [at.min(next), at.max(next)];
                    let free = (0..OF_STEP).all(|_| {
                        let drawn = added.iter().map(|[low, high]| low + (high - low) * rng.random::<f64>());
                        self.is_clear(&self.completed(drawn.collect()), built)
                    });
                    if free {
                        sides[joint][side] = next;
                    }
                    // What is refused once is refused of any larger box: smaller steps come nearer to it, then it is let be.
                    let least = (ranges[joint][1] - ranges[joint][0]) / STEPS / 4.0;
                    step[joint][side] = match () {
                        () if free => step[joint][side],
                        () if step[joint][side] > least => 0.5 * step[joint][side],
                        () => 0.0,
                    };
                    growing |= step[joint][side] > 0.0;
                }
            }
        }
        sides
    }

    /// A box in whole mrad and mm, within the given one. Joints that follow others stand where they are in its middle.
    pub(super) fn rounded(&self, sides: &[[f64; 2]]) -> WorkingRegion {
        let whole = |value: f64| (1e3 * value).round() / 1e3;
        let down = |value: f64| ((1e3 * value).floor() / 1e3).max(0.0);
        let centre: Vec<f64> = sides.iter().map(|[low, high]| whole(0.5 * (low + high))).collect();
        let half = |(joint, ([low, high], centre)): (usize, (&[f64; 2], &f64))| {
            if self.actuators.is_commanded(joint) { down((high - centre).min(centre - low)) } else { 0.0 }
        };
        let half_width = sides.iter().zip(&centre).enumerate().map(half).collect();
        WorkingRegion { centre: self.completed(centre), half_width }
    }
}

/// The ranges in which joints are sought: within their limits by a hundredth of them on either side, and no more than `turn` (rad) and `travel` (m)
/// about their middle, also where they have no limits.
pub fn usable_ranges(kinematics: &KinematicModel, turn: f64, travel: f64) -> Vec<[f64; 2]> {
    let range = |link: &calibrig_model::CraigLink| {
        let most = match link.kind {
            JointKind::Revolute => turn,
            JointKind::Prismatic => travel,
        };
        let [low, high] = link.limits;
        if !(low.is_finite() && high.is_finite()) {
            let near = [low, high].into_iter().find(|limit| limit.is_finite());
            let middle = near.map_or(0.0, |limit| if limit == low { limit + most } else { limit - most });
            return [middle - most, middle + most];
        }
        let half = (0.49 * (high - low)).min(most);
        let middle = 0.5 * (low + high);
        [middle - half, middle + half]
    };
    kinematics.links.iter().map(range).collect()
}
