//! Differences between repeated approaches of the same pose.

use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use super::error::{Range, check_all};
use super::{EffectError, EffectKind};

/// Unidirectional repeatability: independent normal errors, drawn anew for every pose and actuator.
#[derive(Debug, Clone, PartialEq)]
pub struct Repeatability {
    /// Standard deviation, one entry per actuator, m or rad.
    pub sigma: Vec<f64>,
}

impl Repeatability {
    pub(super) fn check(&self, actuators: usize) -> Result<(), EffectError> {
        check_all(EffectKind::Repeatability, "standard deviation", &self.sigma, actuators, Range::NotNegative)
    }

    /// The errors of one pose, m or rad. The size of one actuator's does not change the others' draws.
    pub fn draw(&self, rng: &mut impl Rng) -> Vec<f64> {
        let normal = |sigma: &f64| -> f64 {
            let drawn: f64 = StandardNormal.sample(rng);
            sigma * drawn
        };
        self.sigma.iter().map(normal).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_model::random::{StreamSource, stream_at};

    #[test]
    fn errors_are_normal_independent_and_each_poses_own() {
        let repeatability = Repeatability { sigma: vec![2e-5, 0.0, 5e-5] };
        let n = 20_000_u32;
        let draw =
            |pose| repeatability.draw(&mut stream_at(3, 0, StreamSource::Repeatability, u64::from(pose)));
        let draws: Vec<_> = (0..n).map(draw).collect();
        let mean = |f: &dyn Fn(&[f64]) -> f64| draws.iter().map(|d| f(d)).sum::<f64>() / f64::from(n);
        let root = f64::from(n).sqrt();
        for (actuator, sigma) in [(0, 2e-5), (2, 5e-5)] {
            // Four standard deviations of the mean, of the mean square, and of the mean product of neighbouring poses.
            assert!((mean(&|d| d[actuator] / sigma)).abs() < 4.0 / root);
            let square = mean(&|d| (d[actuator] / sigma).powi(2));
            assert!((square - 1.0).abs() < 4.0 * 2.0_f64.sqrt() / root, "{square}");
            let lag: f64 =
                draws.windows(2).map(|d| d[0][actuator] * d[1][actuator]).sum::<f64>() / (sigma * sigma);
            assert!(lag.abs() < 4.0 * root, "{lag}");
        }
        assert!(mean(&|d| d[0] * d[2] / 1e-9).abs() < 4.0 / root);
        assert!(draws.iter().all(|d| d[1] == 0.0));
        assert_eq!(draw(77), draws[77], "whatever was drawn before");
    }
}
