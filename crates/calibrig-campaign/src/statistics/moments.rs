//! Mean, standard deviation, root mean square.

use calibrig_model::statistics::normal_quantile;

use super::{Estimated, Interval, student};

/// Mean, central moments and ends of a column.
///
/// Sources of the recursions: B. P. Welford, "Note on a method for calculating corrected sums of squares and products", Technometrics 4 (1962),
/// 419-420; for the higher moments P. Pébay, "Formulas for robust, one-pass parallel computation of covariances and arbitrary-order statistical
/// moments", Sandia report SAND2008-6212 (2008).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moments {
    count: u64,
    skipped: u64,
    mean: f64,
    /// Sums of the second, third and fourth power of the distance from the mean.
    powers: [f64; 3],
    low: f64,
    high: f64,
}

impl Default for Moments {
    fn default() -> Self {
        let (low, high) = (f64::INFINITY, f64::NEG_INFINITY);
        Self { count: 0, skipped: 0, mean: 0.0, powers: [0.0; 3], low, high }
    }
}

impl Moments {
    /// Takes in a value; an absent or non-finite one is counted as skipped.
    pub fn add(&mut self, value: impl Into<Option<f64>>) {
        let Some(value) = value.into().filter(|v| v.is_finite()) else {
            self.skipped += 1;
            return;
        };
        let before = self.count as f64;
        self.count += 1;
        let n = self.count as f64;
        let [second, third, fourth] = self.powers;
        let delta = value - self.mean;
        let part = delta / n;
        let added = delta * part * before;
        self.mean += part;
        self.powers = [
            second + added,
            third + added * part * (n - 2.0) - 3.0 * part * second,
            fourth + added * part * part * (n * n - 3.0 * n + 3.0) + 6.0 * part * part * second
                - 4.0 * part * third,
        ];
        self.low = self.low.min(value);
        self.high = self.high.max(value);
    }

    /// How many values there are.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// How many were absent or not finite.
    pub fn skipped(&self) -> u64 {
        self.skipped
    }

    /// `None` without values.
    pub fn mean(&self) -> Option<f64> {
        self.known(self.mean)
    }

    /// The smallest; `None` without values.
    pub fn min(&self) -> Option<f64> {
        self.known(self.low)
    }

    /// The largest; `None` without values.
    pub fn max(&self) -> Option<f64> {
        self.known(self.high)
    }

    fn known(&self, figure: f64) -> Option<f64> {
        (self.count > 0).then_some(figure)
    }

    /// Of single values, with n - 1; `None` for one value.
    pub fn variance(&self) -> Option<f64> {
        (self.count > 1).then(|| self.powers[0] / (self.count - 1) as f64)
    }

    /// The mean with its interval of confidence `level` (Student's t); `None` without values. For values that are not normal it holds in the limit:
    /// from some tens of values on if they are not very skew.
    pub fn mean_interval(&self, level: f64) -> Option<Estimated> {
        let value = self.mean()?;
        let half =
            |variance: f64| student(level, (self.count - 1) as f64) * (variance / self.count as f64).sqrt();
        Some(Estimated { value, interval: self.variance().map(|v| Interval::around(value, half(v))) })
    }

    /// Of a column of squares: the root of their mean (RMS) with its interval, whose ends are the roots of the mean's; `None` without values and for a
    /// mean below zero.
    pub fn root_mean(&self, level: f64) -> Option<Estimated> {
        let mean = self.mean_interval(level).filter(|m| m.value >= 0.0)?;
        Some(Estimated { value: mean.value.sqrt(), interval: mean.interval.map(Interval::root) })
    }

    /// The standard deviation of single values with its interval of confidence `level`; `None` for one value, without an interval for fewer than ten
    /// values and if nothing scatters.
    ///
    /// The interval takes the kurtosis from the values, so that it does not need them to be normal. It is too narrow for few values with long tails:
    /// at 95 % it held in 94 to 97 % of studies of ten or a hundred normal or uniform values, and in 90 % of a hundred exponential ones (measured in its
    /// test).
    ///
    /// Source: D. G. Bonett, "Approximate confidence interval for standard deviation of nonnormal distributions", Computational Statistics & Data
    /// Analysis 50 (2006), 775-782, with the mean in place of the trimmed mean, which cannot be computed in one pass.
    pub fn deviation_interval(&self, level: f64) -> Option<Estimated> {
        let value = self.variance()?.sqrt();
        let enough = self.count >= 10 && value > 0.0;
        Some(Estimated { value, interval: enough.then(|| self.bonett(level, value)) })
    }

    fn bonett(&self, level: f64, deviation: f64) -> Interval {
        let n = self.count as f64;
        let z = normal_quantile(0.5 + 0.5 * level);
        let kurtosis = n * self.powers[2] / (self.powers[0] * self.powers[0]);
        let correction = n / (n - z);
        let error = correction * ((kurtosis - (n - 3.0) / n).max(0.0) / (n - 1.0)).sqrt();
        // Of the logarithm of the variance.
        let bound = |side: f64| deviation * (correction * (side * z * error).exp()).sqrt();
        Interval { low: bound(-1.0), high: bound(1.0) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::design::{Coordinate, Design, Sampling};
    use crate::statistics::tests::{assert_covers, uniform};
    use proptest::prelude::*;

    fn of(values: &[f64]) -> Moments {
        let mut moments = Moments::default();
        for value in values {
            moments.add(*value);
        }
        moments
    }

    #[test]
    fn moments_by_hand() {
        let mut moments = of(&[1.0, 2.0, 3.0, 4.0, 5.0]);
        moments.add(f64::NAN);
        moments.add(f64::INFINITY);
        moments.add(None);
        assert_eq!((moments.count(), moments.skipped()), (5, 3));
        assert_eq!((moments.mean(), moments.variance()), (Some(3.0), Some(2.5)));
        assert_eq!((moments.min(), moments.max()), (Some(1.0), Some(5.0)));
        // t(0.975, 4) = 2.776445.
        let interval = moments.mean_interval(0.95).and_then(|m| m.interval).expect("five values");
        assert!((interval.half_width() - 2.776_445 * 0.5_f64.sqrt()).abs() < 1e-5);
        let root = of(&[9.0, 16.0]).root_mean(0.5).expect("two values");
        assert_eq!(root.value, 12.5_f64.sqrt());
        // t(0.75, 1) = 1: 12.5 -+ 3.5.
        let ends = root.interval.expect("two values");
        assert!((ends.low - 3.0).abs() < 1e-9 && (ends.high - 4.0).abs() < 1e-9, "{ends:?}");
        let none = Moments::default();
        assert_eq!(
            (none.mean(), none.min(), none.mean_interval(0.95), none.root_mean(0.95)),
            (None, None, None, None)
        );
        let one = of(&[2.0]);
        assert_eq!(one.mean_interval(0.95), Some(Estimated { value: 2.0, interval: None }));
        assert_eq!((one.variance(), one.deviation_interval(0.95)), (None, None));
        assert_eq!(of(&[7.0; 20]).deviation_interval(0.95), Some(Estimated { value: 0.0, interval: None }));
        assert_eq!(of(&[-1.0, -3.0]).root_mean(0.95), None);
    }

    #[test]
    fn a_large_offset_costs_no_more_digits_than_the_values_have() {
        // Deviations are halves around 1e9: exact in the values.
        let values: Vec<f64> = (0..1000).map(|i| 1e9 + f64::from(i % 10) * 0.5).collect();
        let moments = of(&values);
        let exact = 0.25 * 8.25 * 1000.0 / 999.0;
        assert!((moments.variance().expect("many") / exact - 1.0).abs() < 1e-9);
        // Numbers of this size are 1.2e-7 apart.
        assert!((moments.mean().expect("many") - (1e9 + 2.25)).abs() < 1e-6);
    }

    proptest! {
        #[test]
        fn the_recursion_is_the_two_pass_sum(values in prop::collection::vec(-1e3..1e3, 2..60)) {
            let n = values.len() as f64;
            let mean = values.iter().sum::<f64>() / n;
            let moments = of(&values);
            let scale = values.iter().map(|v: &f64| (v - mean).abs()).fold(1e-9, f64::max);
            prop_assert!((moments.mean - mean).abs() <= 1e-10);
            for (power, found) in (2..).zip(moments.powers) {
                let exact = values.iter().map(|v| (v - mean).powi(power)).sum::<f64>();
                prop_assert!((found - exact).abs() <= 1e-9 * n * (scale + 1.0).powi(power), "{}: {} {}", power, found, exact);
            }
        }
    }

    /// Of a smooth function of two factors and of that with noise of the draws, whose variance is 1 beside 1/6.
    #[test]
    fn the_interval_of_the_mean_covers_it_for_either_sampling() {
        for (sampling, noise, least) in [
            (Sampling::Random, 0.0, 0.95),
            (Sampling::Random, 1.0, 0.95),
            (Sampling::Sobol, 0.0, 0.9999),
            (Sampling::Sobol, 1.0, 0.95),
        ] {
            let design = Design::Plain { trials: 100, factors: 2, sampling };
            assert_covers(1000, least, |replicate| {
                let mut moments = Moments::default();
                let normal = uniform(71, replicate, 100).map(normal_quantile);
                for (n, z) in (0..design.trials()).zip(normal) {
                    let at = design.point(replicate.into(), n)?.at;
                    let unit = |c: &Coordinate| if let Coordinate::Unit(u) = c { *u } else { f64::NAN };
                    moments.add(at.iter().map(unit).sum::<f64>() + noise * z);
                }
                moments.mean_interval(0.95)?.interval.map(|i| i.contains(1.0))
            });
        }
    }

    #[test]
    fn the_interval_of_the_deviation_covers_it() {
        let exponential = |u: f64| -(-u).ln_1p();
        type Quantile = fn(f64) -> f64;
        let cases: [(Quantile, f64, usize, f64); 4] = [
            (normal_quantile, 1.0, 10, 0.95),
            (|u| u, (1.0_f64 / 12.0).sqrt(), 10, 0.95),
            (normal_quantile, 1.0, 100, 0.95),
            (exponential, 1.0, 100, 0.90),
        ];
        for (case, (quantile, truth, n, nominal)) in (0_u32..).zip(cases) {
            assert_covers(2000, nominal, |replicate| {
                let values: Vec<f64> = uniform(100 * case + 1, replicate, n).map(quantile).collect();
                of(&values).deviation_interval(0.95)?.interval.map(|i| i.contains(truth))
            });
        }
    }
}
