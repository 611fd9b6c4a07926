//! Poses that are measured more than once: how well the machine and its tracker repeat.

use std::collections::HashMap;
use std::hash::Hash;

use nalgebra::Vector3;

use super::{MeasurementSet, Observation};
use crate::Payload;

/// What repeats of a pose say about a set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Repeats {
    /// Poses (of a station and a target) with more than one reading.
    pub poses: usize,
    /// Readings of them beyond the first: degrees of freedom of the scatter, times three.
    pub repeats: usize,
    /// RMS distance of one reading from the mean of its pose, m: root of the summed squares over the repeats. No model that depends only on
    /// the command leaves less on single readings.
    pub rms_3d: f64,
}

/// Commands of one pose that differ by up to this move the target by less than readings scatter, m or rad: for joints that were read, not
/// commanded.
const SAME_COMMAND: f64 = 1e-5;

impl MeasurementSet {
    /// The scatter of its repeats; `None` if no pose is measured twice from the same sides. Repeats have the same approach, station,
    /// target and payload, and the same command: to the last bit, or within 1e-5 m or rad if they have the same pose number.
    #[must_use]
    pub fn repeats(&self) -> Option<Repeats> {
        let groups = self.repeated_readings();
        let repeats: usize = groups.iter().map(|group| group.len() - 1).sum();
        let scatter = |group: &Vec<usize>| {
            let points = || group.iter().map(|i| self.observations[*i].reading.position());
            let mean = points().sum::<Vector3<f64>>() / group.len() as f64;
            points().map(|point| (point - mean).norm_squared()).sum::<f64>()
        };
        // In a fixed order, so that the sum is the same every time.
        let mut squares: Vec<f64> = groups.iter().map(scatter).collect();
        squares.sort_by(f64::total_cmp);
        let rms_3d = (squares.iter().sum::<f64>() / repeats as f64).sqrt();
        (repeats > 0).then_some(Repeats { poses: groups.len(), repeats, rms_3d })
    }

    /// The observations that are [repeats](Self::repeats) of each other, by index: a list of two or more per pose, in the order of their first
    /// ones.
    #[must_use]
    pub fn repeated_readings(&self) -> Vec<Vec<usize>> {
        let groups = self.grouped(|o| (o.approach.as_slice(), o.station, o.target));
        groups.into_iter().filter(|group| group.len() > 1).collect()
    }

    /// The observations of one target at one command and with one payload, regardless of approach and station, by index; includes poses that were
    /// measured once.
    #[must_use]
    pub fn same_commands(&self) -> Vec<Vec<usize>> {
        self.grouped(|o| o.target)
    }

    fn grouped<'a, K: Hash + Eq>(&'a self, also: impl Fn(&'a Observation) -> K) -> Vec<Vec<usize>> {
        let mut groups: Vec<Vec<usize>> = Vec::new();
        let mut places: HashMap<_, usize> = HashMap::new();
        let mut of_poses: HashMap<u32, &[f64]> = HashMap::new();
        for (index, o) in self.observations.iter().enumerate() {
            let first = *of_poses.entry(o.pose).or_insert(&o.command);
            let is_same = first.iter().zip(&o.command).all(|(a, b)| (a - b).abs() <= SAME_COMMAND);
            let command = if is_same { first } else { &o.command };
            let command: Vec<u64> = command.iter().map(|value| value.to_bits()).collect();
            let payload = o.payload.as_ref().filter(|payload| !payload.is_none()).map(Payload::bits);
            let place = *places.entry((command, payload, also(o))).or_insert(groups.len());
            match groups.get_mut(place) {
                Some(group) => group.push(index),
                None => groups.push(vec![index]),
            }
        }
        groups
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Joints that were measured differ in their last digits, and the pose says what belongs together.
    #[test]
    fn readings_of_one_pose_are_repeats_although_their_joints_scatter() {
        let point = |command: f64, x: f64| (vec![command], Vector3::new(x, 0.0, 1.0));
        let mut set = MeasurementSet::of_points([
            point(0.1, 1.0),
            point(0.1 + 1e-7, 1.2),
            point(0.4, 2.0),
            point(0.1, 1.4),
        ]);
        let mut numbered = |poses: [u32; 4]| {
            for (o, pose) in set.observations.iter_mut().zip(poses) {
                o.pose = pose;
            }
            set.repeats().map(|repeats| (repeats.poses, repeats.repeats))
        };
        assert_eq!(numbered([1, 1, 2, 3]), Some((1, 2)));
        assert_eq!(numbered([1, 2, 3, 4]), Some((1, 1)));
        // A pose is never two.
        assert_eq!(numbered([1, 1, 1, 2]), Some((1, 2)));
    }

    #[test]
    fn repeats_scatter_about_the_mean_of_their_pose() {
        let point = |command: f64, x: f64, y: f64| (vec![command], Vector3::new(x, y, 1.0));
        let set = MeasurementSet::of_points([
            point(0.1, 1.0, 0.0),
            point(0.2, 3.0, 0.0),
            point(0.1, 1.2, 0.0),
            point(0.2, 3.0, 0.3),
            point(0.2, 3.0, -0.3),
            point(0.3, 9.0, 9.0),
        ]);
        let repeats = set.repeats().expect("two poses");
        assert_eq!((repeats.poses, repeats.repeats), (2, 3));
        // 2 x 0.1^2 of the first, 2 x 0.3^2 of the second, over three degrees of freedom.
        assert!((repeats.rms_3d - (0.2_f64 / 3.0).sqrt()).abs() < 1e-15);
        assert_eq!(MeasurementSet::of_points([point(0.1, 1.0, 0.0), point(0.2, 1.0, 0.0)]).repeats(), None);
    }
}
