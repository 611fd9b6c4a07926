//! Compares two models on the same poses: how much better one is, and whether the difference is more than chance.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use calibrig_model::statistics::student_t_quantile;

/// A difference with its confidence interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// The difference itself.
    pub value: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl Interval {
    fn around(value: f64, standard_error: f64, dof: f64, level: f64) -> Self {
        let half = standard_error * student_t_quantile(0.5 + 0.5 * level, dof);
        Self { value, low: value - half, high: value + half }
    }

    /// Whether chance alone does not explain the difference.
    pub fn excludes_zero(&self) -> bool {
        self.low > 0.0 || self.high < 0.0
    }
}

/// RMS of the 3-D errors `a` minus that of `b`, m, paired by pose; `None` for fewer than two errors, or lists of different lengths.
///
/// The interval is that of the mean influence of a pose on the difference (delta method) with Student's t: poses that are hard for both models
/// cancel. Where the errors are held-out errors, the fits behind them are taken as given.
pub fn paired_rms_difference(a: &[Vector3<f64>], b: &[Vector3<f64>], level: f64) -> Option<Interval> {
    if a.len() != b.len() || a.len() < 2 {
        return None;
    }
    let n = a.len() as f64;
    let rms = |errors: &[Vector3<f64>]| (errors.iter().map(Vector3::norm_squared).sum::<f64>() / n).sqrt();
    let (rms_a, rms_b) = (rms(a), rms(b));
    let share = |error: &Vector3<f64>, rms: f64| {
        if rms > 0.0 { (error.norm_squared() - rms * rms) / (2.0 * rms) } else { 0.0 }
    };
    let variance =
        a.iter().zip(b).map(|(a, b)| (share(a, rms_a) - share(b, rms_b)).powi(2)).sum::<f64>() / (n - 1.0);
    Some(Interval::around(rms_a - rms_b, (variance / n).sqrt(), n - 1.0, level))
}

/// Mean of `differences`, one per random split of the same data; `held_out_per_fitted` is the size of the held-out part over that of the fitted
/// part. Splits share data, so that an interval from their spread alone would be too narrow: it is widened by Nadeau and Bengio's factor.
/// `None` for fewer than two splits.
///
/// Source: C. Nadeau, Y. Bengio, "Inference for the generalization error", Machine Learning 52 (2003), 239-281.
pub fn resampled_difference(differences: &[f64], held_out_per_fitted: f64, level: f64) -> Option<Interval> {
    if differences.len() < 2 {
        return None;
    }
    let n = differences.len() as f64;
    let mean = differences.iter().sum::<f64>() / n;
    let variance = differences.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0);
    Some(Interval::around(mean, (variance * (1.0 / n + held_out_per_fitted)).sqrt(), n - 1.0, level))
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_model::statistics::binomial_cdf;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    fn draw(rng: &mut ChaCha8Rng) -> Vector3<f64> {
        Vector3::from_fn(|_, _| StandardNormal.sample(rng))
    }

    /// For errors that are mostly common to both models, the interval holds the true difference as often as stated.
    #[test]
    fn paired_intervals_hold_the_true_difference() {
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let truth = 1.04_f64.sqrt() * 3.0_f64.sqrt() - 1.01_f64.sqrt() * 3.0_f64.sqrt();
        let trials = 1000;
        let (mut held, mut found) = (0, 0);
        for _ in 0..trials {
            let (mut a, mut b) = (Vec::new(), Vec::new());
            for _ in 0..100 {
                let common = draw(&mut rng);
                a.push(common + 0.2 * draw(&mut rng));
                b.push(common + 0.1 * draw(&mut rng));
            }
            let interval = paired_rms_difference(&a, &b, 0.95).expect("two sets");
            held += u64::from(interval.low <= truth && truth <= interval.high);
            found += u64::from(interval.excludes_zero());
        }
        // 95 % to first order: between 94 % and 96 %, with the exact binomial tails of 0.05 %.
        let (few, many) = (binomial_cdf(held, trials, 0.94), binomial_cdf(held - 1, trials, 0.96));
        assert!(few > 0.000_5 && many < 0.999_5, "{held}");
        // The difference is 1.5 % of errors that scatter by 40 % from pose to pose.
        assert!(found > 100, "{found}");
    }

    #[test]
    fn equal_errors_differ_by_nothing() {
        let a = [Vector3::new(1.0, 2.0, 3.0), Vector3::new(0.0, -1.0, 2.0)];
        let interval = paired_rms_difference(&a, &a, 0.95).expect("two sets");
        assert_eq!((interval.value, interval.low, interval.high), (0.0, 0.0, 0.0));
        assert!(!interval.excludes_zero());
        assert_eq!(paired_rms_difference(&a, &a[..1], 0.95), None);
    }

    #[test]
    fn splits_of_the_same_data_are_not_independent() {
        // Mean 2, variance 1: t(0.975, 2) = 4.303 (NIST table).
        let differences = [1.0, 2.0, 3.0];
        let interval = resampled_difference(&differences, 0.25, 0.95).expect("three splits");
        let half = 4.3027 * (1.0_f64 / 3.0 + 0.25).sqrt();
        assert!((interval.value - 2.0).abs() < 1e-15);
        assert!((interval.high - 2.0 - half).abs() < 1e-3 && (interval.low - 2.0 + half).abs() < 1e-3);
        assert_eq!(resampled_difference(&differences[..1], 0.25, 0.95), None);
    }
}
