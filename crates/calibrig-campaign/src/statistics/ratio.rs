//! Two columns of the same trials.

use super::{Estimated, Interval, Moments, student};

/// The ratio of the means of two columns, such as mean squared error over mean bound.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RatioOfMeans {
    count: u64,
    skipped: u64,
    /// Of numerator and denominator.
    means: [f64; 2],
    /// Sums of the products of distances from the means: of the numerator's squares, of both, of the denominator's squares.
    products: [f64; 3],
}

impl RatioOfMeans {
    /// Takes in both values of a trial; a pair of which one is absent or not finite is counted as skipped.
    pub fn add(&mut self, numerator: impl Into<Option<f64>>, denominator: impl Into<Option<f64>>) {
        let Some([x, y]) = pair(numerator, denominator) else {
            self.skipped += 1;
            return;
        };
        self.count += 1;
        let n = self.count as f64;
        let before = [x - self.means[0], y - self.means[1]];
        self.means = [self.means[0] + before[0] / n, self.means[1] + before[1] / n];
        let after = [x - self.means[0], y - self.means[1]];
        let products = [before[0] * after[0], before[0] * after[1], before[1] * after[1]];
        self.products = std::array::from_fn(|i| self.products[i] + products[i]);
    }

    /// How many pairs there are.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// How many pairs were not whole.
    pub fn skipped(&self) -> u64 {
        self.skipped
    }

    /// The ratio with its interval of confidence `level`; `None` without pairs, and if the denominator's mean is zero. Without an interval for one
    /// pair, and if the denominator's mean does not differ significantly from zero.
    ///
    /// Source: E. C. Fieller, "Some problems in interval estimation", J. Royal Statistical Society B 16 (1954), 175-185.
    pub fn interval(&self, level: f64) -> Option<Estimated> {
        let [x, y] = self.means;
        let value = x / y;
        (self.count > 0 && value.is_finite()).then(|| Estimated { value, interval: self.fieller(level) })
    }

    /// The root of the ratio, such as RMSE over bound, with its interval, whose ends are the roots of the ratio's; `None` also for a ratio below zero.
    pub fn root(&self, level: f64) -> Option<Estimated> {
        let ratio = self.interval(level).filter(|r| r.value >= 0.0)?;
        Some(Estimated { value: ratio.value.sqrt(), interval: ratio.interval.map(Interval::root) })
    }

    /// Between the roots in r of `(x - r y)² = t² var(x - r y)`.
    fn fieller(&self, level: f64) -> Option<Interval> {
        let dof = self.count.checked_sub(2)? as f64 + 1.0;
        let scale = student(level, dof).powi(2) / (self.count as f64 * dof);
        let [xx, xy, yy] = self.products.map(|p| scale * p);
        let [x, y] = self.means;
        let (a, b, c) = (y * y - yy, x * y - xy, x * x - xx);
        if !(a > 0.0) {
            return None;
        }
        // Rounding can make it negative if the ratio does not scatter.
        let half = (b * b - a * c).max(0.0).sqrt();
        Some(Interval { low: (b - half) / a, high: (b + half) / a })
    }
}

/// The mean difference between two columns of the same trials, or of trials with the same draws: what they share cancels in its interval.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PairedDifference(Moments);

impl PairedDifference {
    /// Takes in both values of a trial; a pair of which one is absent or not finite is counted as skipped.
    pub fn add(&mut self, first: impl Into<Option<f64>>, second: impl Into<Option<f64>>) {
        self.0.add(pair(first, second).map(|[first, second]| second - first));
    }

    /// The second minus the first: its moments.
    pub fn moments(&self) -> &Moments {
        &self.0
    }

    /// The mean of the second minus the first with its interval of confidence `level` (Student's t); `None` without pairs.
    pub fn interval(&self, level: f64) -> Option<Estimated> {
        self.0.mean_interval(level)
    }
}

fn pair(first: impl Into<Option<f64>>, second: impl Into<Option<f64>>) -> Option<[f64; 2]> {
    let pair = [first.into()?, second.into()?];
    pair.iter().all(|v| v.is_finite()).then_some(pair)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::tests::{assert_covers, uniform};
    use calibrig_model::statistics::normal_quantile;

    #[test]
    fn a_ratio_by_hand() {
        let mut ratio = RatioOfMeans::default();
        assert_eq!((ratio.interval(0.95), ratio.root(0.95)), (None, None));
        ratio.add(f64::NAN, 1.0);
        ratio.add(1.0, None);
        ratio.add(8.0, 2.0);
        assert_eq!(ratio.root(0.95), Some(Estimated { value: 2.0, interval: None }));
        ratio.add(12.0, 3.0);
        // The same ratio in every trial: nothing is left to chance.
        let interval = ratio.interval(0.5).and_then(|r| r.interval).expect("two pairs");
        assert!((interval.low - 4.0).abs() < 1e-7 && (interval.high - 4.0).abs() < 1e-7, "{interval:?}");
        assert_eq!((ratio.count(), ratio.skipped()), (2, 2));
        // A denominator that may be zero.
        let mut wild = RatioOfMeans::default();
        wild.add(1.0, -1.0);
        wild.add(1.0, 2.0);
        assert_eq!(wild.interval(0.95), Some(Estimated { value: 2.0, interval: None }));
        // A constant denominator leaves the interval of the mean.
        let (mut constant, mut mean) = (RatioOfMeans::default(), Moments::default());
        for value in [1.0, 2.0, 4.0] {
            constant.add(value, 2.0);
            mean.add(value / 2.0);
        }
        let (found, expected) =
            (constant.interval(0.9).expect("three"), mean.mean_interval(0.9).expect("three"));
        let (found, expected) = (found.interval.expect("three"), expected.interval.expect("three"));
        assert!((found.low - expected.low).abs() < 1e-12 && (found.high - expected.high).abs() < 1e-12);
    }

    #[test]
    fn the_interval_of_a_ratio_covers_it() {
        assert_covers(2000, 0.95, |replicate| {
            let mut ratio = RatioOfMeans::default();
            let normal: Vec<f64> = uniform(31, replicate, 30).map(normal_quantile).collect();
            for z in normal.chunks_exact(2) {
                ratio.add(3.0 + z[0], 2.0 + 0.5 * z[0] + 0.5 * z[1]);
            }
            ratio.interval(0.95)?.interval.map(|i| i.contains(1.5))
        });
    }

    #[test]
    fn what_pairs_share_does_not_count() {
        let mut difference = PairedDifference::default();
        for (shared, own) in [(100.0, 1.0), (-400.0, 3.0), (900.0, 2.0)] {
            difference.add(shared, shared + own);
        }
        difference.add(None, 1.0);
        let estimate = difference.interval(0.95).expect("three");
        assert_eq!(
            (estimate.value, difference.moments().count(), difference.moments().skipped()),
            (2.0, 3, 1)
        );
        // t(0.975, 2) = 4.302653, s = 1.
        let half = estimate.interval.expect("three").half_width();
        assert!((half - 4.302_653 / 3.0_f64.sqrt()).abs() < 1e-6);
    }
}
