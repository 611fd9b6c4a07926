//! Statistics of a table's columns, with their uncertainty. All of them take values one at a time, in order, in bounded memory; the same values in
//! the same order give the same bits. A value that is not finite counts as absent: it is left out and counted.
//!
//! Intervals are those of independent trials. Trials of a plain design are independent. With [Sobol points](crate::design::Sampling::Sobol) they are
//! not: the scatter of the factors is then counted as if it were random, so that for outputs that vary smoothly with the factors intervals are too
//! wide rather than too narrow (conservative: of a hundred trials of a sum of two factors the 95 % interval of the mean contained it in 1000 of 1000
//! studies), and those of outputs that the draws scatter are right (967 of 1000 with six times the variance of noise). Trials of different
//! combinations of a sweep share their draws: compare them by [`PairedDifference`].

mod convergence;
mod histogram;
mod moments;
mod proportion;
mod quantiles;
mod ratio;

pub use convergence::{Convergence, trials_for, trials_for_mean, trials_for_proportion};
pub use histogram::{Histogram, HistogramError};
pub use moments::Moments;
pub use proportion::Proportion;
pub use quantiles::{Quantile, QuantileError, Quantiles, quantile_of_sorted, quantiles};
pub use ratio::{PairedDifference, RatioOfMeans};

use serde::Serialize;

/// Between two values.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Interval {
    /// Its lower end.
    pub low: f64,
    /// Its upper end.
    pub high: f64,
}

impl Interval {
    pub(crate) fn around(value: f64, half: f64) -> Self {
        Self { low: value - half, high: value + half }
    }

    /// Half of its width.
    pub fn half_width(&self) -> f64 {
        0.5 * (self.high - self.low)
    }

    /// Whether it contains `value`, its ends included.
    pub fn contains(&self, value: f64) -> bool {
        self.low <= value && value <= self.high
    }

    /// The interval of the root, if this is one of a non-negative figure.
    fn root(self) -> Self {
        Self { low: self.low.max(0.0).sqrt(), high: self.high.max(0.0).sqrt() }
    }
}

/// A figure with its confidence interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimated {
    /// The figure.
    pub value: f64,
    /// `None` if there are too few values for one.
    pub interval: Option<Interval>,
}

/// The upper of the two points of Student's distribution between which lies the share `level`.
pub(crate) fn student(level: f64, dof: f64) -> f64 {
    calibrig_model::statistics::student_t_quantile(0.5 + 0.5 * level, dof)
}

#[cfg(test)]
pub(crate) mod tests {
    use calibrig_model::random::{StreamSource, stream};
    use calibrig_model::statistics::binomial_cdf;
    use rand::RngExt;
    use rand::distr::Open01;

    /// Independent numbers between 0 and 1.
    pub(crate) fn uniform(seed: u32, replicate: u32, count: usize) -> impl Iterator<Item = f64> {
        stream(seed.into(), replicate, StreamSource::Factors).sample_iter(Open01).take(count)
    }

    /// How many of the replicates contain the truth; every one must have an interval.
    pub(crate) fn covered(replicates: u32, holds: impl Fn(u32) -> Option<bool>) -> u64 {
        (0..replicates).map(|r| u64::from(holds(r).expect("an interval"))).sum()
    }

    /// Checks that intervals contain the truth as often as `nominal` says: so few hits occur in one of two thousand runs of exact intervals. There
    /// is no upper bound: an interval may be conservative.
    pub(crate) fn assert_covers(replicates: u32, nominal: f64, holds: impl Fn(u32) -> Option<bool>) {
        let hits = covered(replicates, holds);
        let chance = binomial_cdf(hits, replicates.into(), nominal);
        println!("{hits} of {replicates} intervals of {nominal} hold the truth");
        assert!(chance > 5e-4, "{hits} of {replicates} intervals of {nominal} hold the truth: {chance:e}");
    }
}
