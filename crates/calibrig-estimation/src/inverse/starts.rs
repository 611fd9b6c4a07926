//! Starts of a search: poses spread evenly over the range of the joints, the nearest ones first.

use super::arm::{Arm, RigidArm};
use super::joint_space::JointSpace;
use super::task::Aim;
use calibrig_model::geometry::Transform;

/// Number of poses.
const POSES: u32 = 1500;

/// Poses of the rigid robot over the range of its joints.
#[derive(Debug, Clone)]
pub(super) struct Starts {
    poses: Vec<(Vec<f64>, Transform)>,
}

impl Starts {
    /// Points of the additive recurrence with the smallest known discrepancy in this number of dimensions (M. Roberts, "The unreasonable
    /// effectiveness of quasirandom sequences", 2018), without those that the robot cannot take.
    pub fn new(space: &JointSpace, arm: &mut RigidArm) -> Self {
        let ratio = (0..64).fold(1.5_f64, |x, _| (1.0 + x).powf(1.0 / (1.0 + space.len() as f64)));
        let steps: Vec<f64> = (1..).take(space.len()).map(|power| ratio.powi(-power)).collect();
        let pose = |index: u32| {
            let at = |(unknown, step): (usize, &f64)| {
                let share = (0.5 + f64::from(index) * step).fract();
                space.middle[unknown] + space.half[unknown] * (2.0 * share - 1.0)
            };
            let mut y: Vec<f64> = steps.iter().enumerate().map(at).collect();
            space.clamp(&mut y);
            arm.place(space, &y).ok()?;
            Some((y, arm.base_from_tool()))
        };
        Self { poses: (0..POSES).filter_map(pose).collect() }
    }

    /// The pose whose tool is nearest to an aim.
    pub fn nearest(&self, aim: &Aim) -> Option<&[f64]> {
        let mut nearest: (f64, Option<&[f64]>) = (f64::INFINITY, None);
        for (y, tool) in &self.poses {
            let distance = aim.distance_squared(tool);
            if distance < nearest.0 {
                nearest = (distance, Some(y));
            }
        }
        nearest.1
    }

    /// All poses, the nearest first.
    pub fn by_distance(&self, aim: &Aim) -> impl Iterator<Item = &[f64]> {
        let mut order: Vec<(f64, &[f64])> =
            self.poses.iter().map(|(y, tool)| (aim.distance_squared(tool), y.as_slice())).collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        order.into_iter().map(|(_, y)| y)
    }
}
