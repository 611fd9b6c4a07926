//! Which poses are measured.

use rand::{Rng, RngExt};
use thiserror::Error;

/// A box of joint variables (SI, one entry a joint), from which poses are drawn uniformly.
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
    #[error("{field} has {found} entries: expected {expected}, one a joint")]
    Length {
        /// `centre` or `half_width`.
        field: &'static str,
        /// Its length.
        found: usize,
        /// The number of joints.
        expected: usize,
    },
    /// A number that cannot be.
    #[error("{field} of joint {} is {value}: expected a finite number, and no width below zero", joint.saturating_add(1))]
    Number {
        /// `centre` or `half_width`.
        field: &'static str,
        /// Index of the joint.
        joint: usize,
        /// rad or m
        value: f64,
    },
}

impl WorkingRegion {
    /// Whether poses of a machine with so many joints can be drawn.
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_model::random::{Source, stream};

    #[test]
    fn poses_stay_in_the_box_and_fill_it() {
        let region = WorkingRegion { centre: vec![1.0, -2.0], half_width: vec![0.5, 0.0] };
        let mut rng = stream(1, 0, Source::IdentificationPoses);
        let poses: Vec<_> = (0..1000).map(|_| region.draw(&mut rng)).collect();
        assert!(poses.iter().all(|p| (0.5..=1.5).contains(&p[0]) && p[1] == -2.0));
        let mean = poses.iter().map(|p| p[0]).sum::<f64>() / 1000.0;
        // Four standard deviations of the mean of a uniform variable.
        assert!((mean - 1.0).abs() < 4.0 * 0.5 / (3.0_f64 * 1000.0).sqrt());
    }
}
