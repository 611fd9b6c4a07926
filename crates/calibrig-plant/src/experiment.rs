//! Which poses are measured.

use rand::{Rng, RngExt};

/// A box of joint variables (SI, one entry a joint), from which poses are drawn uniformly.
#[derive(Debug, Clone, PartialEq)]
pub struct WorkingRegion {
    /// Middle of the box.
    pub centre: Vec<f64>,
    /// Half its width.
    pub half_width: Vec<f64>,
}

impl WorkingRegion {
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
