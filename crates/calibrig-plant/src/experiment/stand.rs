//! Where to place a tracker so that it sees the most of a robot's poses.

use std::f64::consts::{FRAC_PI_4, PI, TAU};

use nalgebra::{Point3, Rotation3, UnitVector3, Vector3};

use super::WorkingRegion;
use super::room::rounded;
use calibrig_model::geometry::Transform;
use calibrig_model::visibility::{FreeSight, Hidden, Reflector, Room, Stance, TrackerReach, stance_at};
use rand::Rng;

/// The search for a tracker's place around a robot.
#[derive(Debug, Clone, Copy)]
pub struct Stand<'a> {
    /// The robot.
    pub room: Room<'a>,
    /// What the tracker can point at.
    pub reach: TrackerReach,
    /// Against gravity, in the base frame.
    pub up: UnitVector3<f64>,
    /// The floor's height along it, m.
    pub floor: f64,
    /// Nothing is nearer than this (m) to `robot`, a point of the base frame, measured across `up`.
    pub keep_off: f64,
    /// m
    pub robot: Vector3<f64>,
}

/// A place, and what the tracker sees from it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// Of the tracker in the base frame, m, in whole centimetres.
    pub position: Vector3<f64>,
    /// Direction in which it looks, as azimuth about up, rad, in whole degrees.
    pub yaw: f64,
    /// Share of the poses that are seen.
    pub seen: f64,
    /// Mean distance to those that are seen, m.
    pub range: f64,
}

/// Directions around the robot that are tried.
const DIRECTIONS: u32 = 24;
/// Heights above the floor at which trackers stand, m; and as shares of the height of the robot's targets.
const HEIGHTS: [f64; 3] = [0.8, 1.2, 1.6];
/// Angle above and below level within which trackers work well, rad.
const ELEVATION: f64 = FRAC_PI_4;
/// Share of the seen poses that a metre of distance costs: readings scatter more, and air bends the beam.
const OF_A_METRE: f64 = 0.015;
/// Share of a joint's range that is cut off where the least is seen.
const TRIM: f64 = 0.1;
/// Rounds of cutting off.
const MOST_TRIMS: usize = 60;
/// Width below which no joint's range is cut, as a share of the original.
const LEAST_WIDTH: f64 = 0.25;

impl Stand<'_> {
    fn level(&self) -> Rotation3<f64> {
        // With its standing axis upright.
        Rotation3::rotation_between(&Vector3::z(), &self.up)
            .unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::x_axis(), PI))
    }

    /// A tracker at a place of the base frame (m), turned by `yaw` (rad) about up.
    pub fn base_from_tracker(&self, position: &Vector3<f64>, yaw: f64) -> Transform {
        let turned = self.level() * Rotation3::from_axis_angle(&Vector3::z_axis(), yaw);
        Transform::from_parts((*position).into(), turned)
    }

    /// Whether it sees the target from there at joint variables.
    ///
    /// # Errors
    ///
    /// [`Hidden`], with what hides it.
    pub fn look(&self, base_from_tracker: &Transform, joints: &[f64]) -> Result<FreeSight, Hidden> {
        let room = &self.room;
        let reflector = Reflector { in_flange: room.target, opening: None, acceptance: PI };
        room.obstacles.look_at_joints(base_from_tracker, &self.reach(), room.kinematics, joints, &reflector)
    }

    fn reach(&self) -> TrackerReach {
        let [low, high] = self.reach.elevation;
        TrackerReach { elevation: [low.max(-ELEVATION), high.min(ELEVATION)], ..self.reach }
    }

    /// The place from which most of `poses` (joint variables) are seen, the nearer one among equals. `None` if no place sees any.
    pub fn best(&self, poses: &[Vec<f64>]) -> Option<Place> {
        let level = self.level();
        let local = |point: Vector3<f64>| level.inverse() * point;
        let targets: Vec<_> = poses.iter().map(|joints| local(self.room.target_at(joints))).collect();
        let middle = targets.iter().sum::<Vector3<f64>>() / targets.len().max(1) as f64;
        let across = |v: &Vector3<f64>| v.x.hypot(v.y);
        let spread = targets.iter().map(|target| across(&(target - middle))).fold(0.0, f64::max);
        let robot = local(self.robot);
        let heights =
            HEIGHTS.iter().map(|height| self.floor + height).chain([middle.z.max(self.floor + 0.3)]);
        let heights: Vec<f64> = heights.collect();
        let mut best: Option<(f64, Place)> = None;
        for direction in 0..DIRECTIONS {
            let (sin, cos) = (TAU * f64::from(direction) / f64::from(DIRECTIONS)).sin_cos();
            for height in &heights {
                for farther in [0.8, 1.3, 2.0, 3.0, 5.0] {
                    let mut at = Vector3::new(
                        middle.x + cos * (spread + farther),
                        middle.y + sin * (spread + farther),
                        *height,
                    );
                    let off = across(&(at - robot));
                    if off < self.keep_off {
                        // On the same line, but out of the robot's reach.
                        let more = self.keep_off - off;
                        at += more * Vector3::new(cos, sin, 0.0);
                    }
                    let at = (100.0 * (level * at)).map(f64::round) / 100.0;
                    // A tracker cannot see through a wall.
                    if self.room.planes.iter().any(|(up, height)| up.dot(&at) < *height) {
                        continue;
                    }
                    let towards = level.inverse() * -at + middle;
                    let yaw = towards.y.atan2(towards.x).to_degrees().round().to_radians();
                    let place = self.seen_from(at, yaw, poses);
                    let worth = place.seen - OF_A_METRE * place.range;
                    if place.seen > 0.0 && best.as_ref().is_none_or(|(of_best, _)| worth > *of_best) {
                        best = Some((worth, place));
                    }
                }
            }
        }
        best.map(|(_, place)| place)
    }

    /// What is seen from a place, m and rad.
    pub fn seen_from(&self, position: Vector3<f64>, yaw: f64, poses: &[Vec<f64>]) -> Place {
        let from = self.base_from_tracker(&position, yaw);
        let ranges = poses.iter().filter_map(|joints| Some(self.look(&from, joints).ok()?.range));
        let (count, sum) = ranges.fold((0_usize, 0.0), |(count, sum), range| (count + 1, sum + range));
        let seen = count as f64 / poses.len().max(1) as f64;
        Place { position, yaw, seen, range: sum / count.max(1) as f64 }
    }

    /// The region, after cutting off the ends of ranges that are least visible from `place`, until `wanted` of the poses drawn in it are seen, or
    /// nothing more is gained; with the result at `place`.
    pub fn trimmed(
        &self,
        region: &WorkingRegion,
        place: &Place,
        wanted: f64,
        rng: &mut impl Rng,
    ) -> (WorkingRegion, Place) {
        let from = self.base_from_tracker(&place.position, place.yaw);
        let mut region = region.clone();
        let first = region.half_width.clone();
        for _ in 0..MOST_TRIMS {
            let poses: Vec<_> = (0..500).map(|_| self.room.completed(region.draw(rng))).collect();
            let seen: Vec<bool> = poses.iter().map(|joints| self.look(&from, joints).is_ok()).collect();
            let share = |of: &dyn Fn(&[f64]) -> bool| {
                let chosen: Vec<bool> =
                    poses.iter().zip(&seen).filter(|(joints, _)| of(joints)).map(|(_, seen)| *seen).collect();
                let count = chosen.iter().filter(|seen| **seen).count();
                (!chosen.is_empty()).then(|| count as f64 / chosen.len() as f64)
            };
            let all = share(&|_| true).unwrap_or(0.0);
            if all >= wanted {
                break;
            }
            let wide = |joint: &usize| region.half_width[*joint] > LEAST_WIDTH * first[*joint];
            let ends = (0..first.len()).filter(wide).flat_map(|joint| [(joint, -1.0), (joint, 1.0)]);
            let seen_there = ends.filter_map(|(joint, sign)| {
                let (centre, half) = (region.centre[joint], region.half_width[joint]);
                let beyond = |joints: &[f64]| sign * (joints[joint] - centre) > (1.0 - 2.0 * TRIM) * half;
                Some((share(&beyond)?, joint, sign))
            });
            let Some((least, joint, sign)) = seen_there.min_by(|a, b| a.0.total_cmp(&b.0)) else { break };
            if least >= all {
                break;
            }
            let mut sides: Vec<[f64; 2]> =
                region.centre.iter().zip(&region.half_width).map(|(c, half)| [c - half, c + half]).collect();
            sides[joint][usize::from(sign > 0.0)] -= sign * 2.0 * TRIM * region.half_width[joint];
            region = rounded(&self.room, &sides);
        }
        let poses: Vec<_> = (0..500).map(|_| self.room.completed(region.draw(rng))).collect();
        let place = self.seen_from(place.position, place.yaw, &poses);
        (region, place)
    }

    /// Places for base nests, m: up to `most` of `candidates` that the tracker sees with the robot at every one of `poses`, and that no link
    /// passes over, each as far as possible from the ones before.
    pub fn nests(
        &self,
        place: &Place,
        poses: &[Vec<f64>],
        candidates: &[Vector3<f64>],
        most: usize,
    ) -> Vec<Vector3<f64>> {
        let from = self.base_from_tracker(&place.position, place.yaw);
        let tracker = place.position;
        let stances: Vec<_> = poses.iter().map(|joints| stance_at(self.room.kinematics, joints)).collect();
        let free = |nest: &&Vector3<f64>| {
            self.reach().point_at(&from, nest).is_ok()
                && stances.iter().all(|(links, flange)| {
                    let stance = Stance { links, flange };
                    let obstacles = self.room.obstacles;
                    obstacles.free(stance, &tracker, nest).is_ok()
                        && obstacles.holding(stance, nest).is_none()
                })
        };
        let mut left: Vec<Vector3<f64>> = candidates.iter().filter(free).copied().collect();
        let mut chosen: Vec<Vector3<f64>> = Vec::new();
        while chosen.len() < most {
            let apart = |nest: &Vector3<f64>| match chosen.as_slice() {
                [] => -(Point3::from(*nest) - Point3::from(tracker)).norm(),
                chosen => chosen.iter().map(|other| (nest - other).norm()).fold(f64::INFINITY, f64::min),
            };
            let farthest = left
                .iter()
                .enumerate()
                .max_by(|a, b| apart(a.1).total_cmp(&apart(b.1)))
                .map(|(index, _)| index);
            let Some(index) = farthest else { break };
            chosen.push(left.swap_remove(index));
        }
        chosen
    }
}
