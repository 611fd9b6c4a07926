//! Where a robot can be measured: a box of joint variables in which the nominal robot touches neither itself nor what it stands on.

use rand::{Rng, RngExt};

use super::WorkingRegion;
use calibrig_model::visibility::{Built, Room};
use calibrig_model::{JointKind, KinematicModel};

/// Steps in which a side of the box grows over the whole range of its joint.
const STEPS: f64 = 16.0;
/// Poses checked in the part that a step adds.
const OF_STEP: usize = 48;
/// Poses of the whole box that are checked at the end.
const OF_BOX: usize = 2000;
/// Factor by which the box shrinks if one of them touches.
const SHRINK: f64 = 0.95;

/// The largest box found within `ranges` (rad or m, one per joint) in which nothing touches: grown from each clear pose of `starts` on all
/// sides alike, as long as no pose drawn in the added part touches. `None` if no start is clear.
///
/// Its numbers are rounded to mrad and mm, and none of 2000 poses drawn in it touches.
pub fn clear_region(
    room: &Room<'_>,
    ranges: &[[f64; 2]],
    starts: &[Vec<f64>],
    built: &Built,
    rng: &mut impl Rng,
) -> Option<WorkingRegion> {
    let inside = |joints: &[f64]| {
        let mut moved = joints.iter().zip(ranges).enumerate();
        moved.all(|(joint, (q, [low, high]))| !moves(room, ranges, joint) || (*low..=*high).contains(q))
    };
    let starts = starts.iter().filter(|start| inside(start) && room.is_clear(start, built));
    let boxes = starts.map(|start| grown(room, ranges, start, built, rng));
    let size = |sides: &[[f64; 2]]| -> f64 {
        let parts = sides.iter().zip(ranges).enumerate().filter(|(joint, _)| moves(room, ranges, *joint));
        parts.map(|(_, (side, range))| ((side[1] - side[0]) / (range[1] - range[0])).max(1e-3).ln()).sum()
    };
    let best = boxes.max_by(|a, b| size(a).total_cmp(&size(b)))?;
    let mut region = rounded(room, &best);
    loop {
        let clear = (0..OF_BOX).all(|_| room.is_clear(&room.completed(region.draw(rng)), built));
        if clear || region.half_width.iter().all(|half| *half == 0.0) {
            return Some(region);
        }
        let sides = region.centre.iter().zip(&region.half_width);
        let smaller: Vec<_> = sides.map(|(c, h)| [c - SHRINK * h, c + SHRINK * h]).collect();
        region = rounded(room, &smaller);
    }
}

/// Whether the box has a side for a joint.
fn moves(room: &Room<'_>, ranges: &[[f64; 2]], joint: usize) -> bool {
    room.actuators.is_commanded(joint) && ranges[joint][1] > ranges[joint][0]
}

fn grown(
    room: &Room<'_>,
    ranges: &[[f64; 2]],
    start: &[f64],
    built: &Built,
    rng: &mut impl Rng,
) -> Vec<[f64; 2]> {
    let mut sides: Vec<[f64; 2]> = start.iter().map(|q| [*q, *q]).collect();
    let mut step: Vec<[f64; 2]> = ranges.iter().map(|range| [(range[1] - range[0]) / STEPS; 2]).collect();
    let mut growing = true;
    while growing {
        growing = false;
        for joint in (0..sides.len()).filter(|joint| moves(room, ranges, *joint)) {
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
                    room.is_clear(&room.completed(drawn.collect()), built)
                });
                if free {
                    sides[joint][side] = next;
                }
                // A refused step is also refused for any larger box: it is tried in smaller steps, then given up.
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

/// A box in whole mrad and mm, within the given one. Joints that follow others are at their place in its middle.
pub(super) fn rounded(room: &Room<'_>, sides: &[[f64; 2]]) -> WorkingRegion {
    let whole = |value: f64| (1e3 * value).round() / 1e3;
    let down = |value: f64| ((1e3 * value).floor() / 1e3).max(0.0);
    let centre: Vec<f64> = sides.iter().map(|[low, high]| whole(0.5 * (low + high))).collect();
    let half = |(joint, ([low, high], centre)): (usize, (&[f64; 2], &f64))| {
        if room.actuators.is_commanded(joint) { down((high - centre).min(centre - low)) } else { 0.0 }
    };
    let half_width = sides.iter().zip(&centre).enumerate().map(half).collect();
    WorkingRegion { centre: room.completed(centre), half_width }
}

/// The ranges that are searched: a hundredth inside the joints' limits on either side, and at most `turn` (rad) and `travel` (m) about their
/// middle, even without limits.
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
