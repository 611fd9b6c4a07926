//! Which poses are measured, and from where.

mod room;
#[cfg(test)]
mod room_tests;
mod stand;

pub use room::{clear_region, usable_ranges};
pub use stand::{Place, Stand};

use rand::{Rng, RngExt};
use thiserror::Error;

/// A box of joint variables (SI, one entry per joint), from which poses are drawn uniformly.
#[derive(Debug, Clone, PartialEq)]
pub struct WorkingRegion {
    /// Middle of the box.
    pub centre: Vec<f64>,
    /// Half its width.
    pub half_width: Vec<f64>,
}

/// A region from which no pose of the machine can be drawn.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[non_exhaustive]
pub enum RegionError {
    /// More or fewer entries than joints.
    #[error("{field} has {found} entries: expected {expected}, one per joint")]
    Length {
        /// `centre`, `half_width` or a listed pose.
        field: &'static str,
        /// Its length.
        found: usize,
        /// The number of joints.
        expected: usize,
    },
    /// A number outside its valid range.
    #[error("{field} of joint {} is {value}: expected a finite number, and no negative width", joint.saturating_add(1))]
    Number {
        /// `centre` or `half_width`.
        field: &'static str,
        /// Index of the joint.
        joint: usize,
        /// rad or m
        value: f64,
    },
}

/// Whether a listed pose has one finite number per joint.
pub(crate) fn check_listed(pose: &[f64], joints: usize) -> Result<(), RegionError> {
    if pose.len() != joints {
        return Err(RegionError::Length { field: "a listed pose", found: pose.len(), expected: joints });
    }
    match pose.iter().position(|value| !value.is_finite()) {
        Some(joint) => Err(RegionError::Number { field: "a listed pose", joint, value: pose[joint] }),
        None => Ok(()),
    }
}

impl WorkingRegion {
    /// Whether poses can be drawn for a machine with this many joints.
    ///
    /// # Errors
    ///
    /// [`RegionError`].
    pub fn check(&self, joints: usize) -> Result<(), RegionError> {
        for (field, values, least) in
            [("centre", &self.centre, f64::NEG_INFINITY), ("half_width", &self.half_width, 0.0)]
        {
            if values.len() != joints {
                return Err(RegionError::Length { field, found: values.len(), expected: joints });
            }
            let wrong = |value: &f64| !(value.is_finite() && *value >= least);
            if let Some(joint) = values.iter().position(wrong) {
                return Err(RegionError::Number { field, joint, value: values[joint] });
            }
        }
        Ok(())
    }

    /// Draws one pose, rad and m.
    pub fn draw(&self, rng: &mut impl Rng) -> Vec<f64> {
        self.centre
            .iter()
            .zip(&self.half_width)
            .map(|(centre, half)| centre + half * rng.random_range(-1.0..=1.0))
            .collect()
    }

    /// Poses (rad and m) in an order with a short path through them, from the middle of the region: the nearest pose next, then pieces of the path
    /// reversed as long as that shortens it (2-opt: G. A. Croes, Oper. Res. 6 (1958) 791). The length of a step is the largest motion of a joint, in
    /// units of its half width.
    pub fn by_short_ways(&self, poses: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
        let step = |a: &[f64], b: &[f64]| {
            let parts = a.iter().zip(b).zip(&self.half_width);
            parts
                .map(|((a, b), half)| if *half > 0.0 { (a - b).abs() / half } else { 0.0 })
                .fold(0.0, f64::max)
        };
        let mut left = poses;
        let mut way: Vec<Vec<f64>> = vec![self.centre.clone()];
        while let Some(here) = way.last() {
            let lengths = left.iter().map(|pose| step(here, pose)).enumerate();
            let Some((next, _)) = lengths.min_by(|a, b| a.1.total_cmp(&b.1)) else { break };
            way.push(left.swap_remove(next));
        }
        for _ in 0..MOST_PASSES {
            let mut shortened = false;
            for start in 1..way.len() {
                for end in start + 1..way.len() {
                    // The path may end anywhere: reversing its tail changes only one step.
                    let behind = |from: &[f64]| way.get(end + 1).map_or(0.0, |next| step(from, next));
                    let before = step(&way[start - 1], &way[start]) + behind(&way[end]);
                    let turned = step(&way[start - 1], &way[end]) + behind(&way[start]);
                    if turned < before - 1e-12 {
                        way[start..=end].reverse();
                        shortened = true;
                    }
                }
            }
            if !shortened {
                break;
            }
        }
        way.split_off(1)
    }
}

/// Passes over the whole path: after ten, the gain is below a percent.
const MOST_PASSES: usize = 10;

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_model::random::{StreamSource, stream};

    #[test]
    fn a_short_way_goes_through_the_same_poses_and_is_shorter() {
        let region = WorkingRegion { centre: vec![0.0, 0.0, 5.0], half_width: vec![1.0, 2.0, 0.0] };
        let mut rng = stream(4, 0, StreamSource::IdentificationPoses);
        let drawn: Vec<_> = (0..200).map(|_| region.draw(&mut rng)).collect();
        let ordered = region.by_short_ways(drawn.clone());
        let length = |poses: &[Vec<f64>]| -> f64 {
            let step = |pair: &[Vec<f64>]| {
                (pair[0][0] - pair[1][0]).abs().max(0.5 * (pair[0][1] - pair[1][1]).abs())
            };
            poses.windows(2).map(step).sum()
        };
        // The optimum of n random points in a square of area 4 is about 0.71 sqrt(4 n) = 20 in the Euclidean norm, less in this one; drawn, it is
        // about 0.93 a step.
        let [before, after] = [&drawn, &ordered].map(|poses| length(poses));
        assert!(before > 150.0 && after < 24.0, "{before} {after}");
        let sorted = |mut poses: Vec<Vec<f64>>| {
            poses.sort_by(|a, b| a[0].total_cmp(&b[0]));
            poses
        };
        assert_eq!(sorted(drawn), sorted(ordered));
        assert!(region.by_short_ways(Vec::new()).is_empty());
    }

    #[test]
    fn poses_stay_in_the_box_and_fill_it() {
        let region = WorkingRegion { centre: vec![1.0, -2.0], half_width: vec![0.5, 0.0] };
        let mut rng = stream(1, 0, StreamSource::IdentificationPoses);
        let poses: Vec<_> = (0..1000).map(|_| region.draw(&mut rng)).collect();
        assert!(poses.iter().all(|p| (0.5..=1.5).contains(&p[0]) && p[1] == -2.0));
        let mean = poses.iter().map(|p| p[0]).sum::<f64>() / 1000.0;
        // Four standard deviations of the mean of a uniform variable.
        assert!((mean - 1.0).abs() < 4.0 * 0.5 / (3.0_f64 * 1000.0).sqrt());
    }
}
