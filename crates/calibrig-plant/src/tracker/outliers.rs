//! Gross errors: readings of another place than the target's.

use nalgebra::Vector3;
use rand::{Rng, RngExt};
use rand_distr::{Distribution, UnitSphere};

/// How often a reading is a gross error, for example because the target was not seated in its nest, and how large it then
/// is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outliers {
    /// Probability of one.
    pub fraction: f64,
    /// Least distance, m.
    pub least: f64,
    /// Largest distance, m.
    pub most: f64,
}

impl Outliers {
    /// Error of a reading, m: in a random direction, with a length uniform between the two. `None` for a sound one.
    ///
    /// Takes the same numbers from `rng` whatever the fraction and the distances are.
    pub fn draw(&self, rng: &mut impl Rng) -> Option<Vector3<f64>> {
        let hit = rng.random::<f64>() < self.fraction;
        let distance = self.least + (self.most - self.least) * rng.random::<f64>();
        let direction: [f64; 3] = UnitSphere.sample(rng);
        hit.then(|| distance * Vector3::from(direction))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_model::random::{StreamSource, stream};

    #[test]
    fn gross_errors_are_as_many_and_as_large_as_stated_and_point_anywhere() {
        let outliers = Outliers { fraction: 0.05, least: 1e-3, most: 10e-3 };
        let mut rng = stream(5, 0, StreamSource::Outliers);
        let n = 20_000;
        let drawn: Vec<_> = (0..n).filter_map(|_| outliers.draw(&mut rng)).collect();
        // Binomial(20000, 0.05): 1000 +- 3.3 * 30.8.
        assert!((900..=1100).contains(&drawn.len()), "{}", drawn.len());
        assert!(drawn.iter().all(|shift| (1e-3..10e-3).contains(&shift.norm())));
        let k = drawn.len() as f64;
        let mean = drawn.iter().map(nalgebra::Vector3::norm).sum::<f64>() / k;
        assert!((mean - 5.5e-3).abs() < 3.3 * 9e-3 / (12.0 * k).sqrt(), "{mean}");
        let direction = drawn.iter().map(nalgebra::Vector3::normalize).sum::<Vector3<f64>>() / k;
        assert!(direction.amax() < 4.0 / (3.0 * k).sqrt(), "{direction}");
        assert_eq!(Outliers { fraction: 0.0, ..outliers }.draw(&mut rng), None);
    }
}
