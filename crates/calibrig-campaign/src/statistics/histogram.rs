//! Counts for a plot.

use serde::Serialize;
use thiserror::Error;

/// The most bins: more than a plot shows.
const MOST_BINS: usize = 1 << 20;

/// How many values are in each of equally wide bins. A value between two bins counts in the upper one, `high` itself in the last.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Histogram {
    low: f64,
    high: f64,
    counts: Vec<u64>,
    below: u64,
    above: u64,
    skipped: u64,
}

/// Why a histogram is invalid.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[non_exhaustive]
pub enum HistogramError {
    /// Ends in the wrong order, at the same place, or not finite.
    #[error(
        "a histogram from {low} to {high} has no width; both must be finite numbers and the first must be smaller"
    )]
    Range {
        /// As it was given.
        low: f64,
        /// As it was given.
        high: f64,
    },
    /// No bins, or too many.
    #[error("a histogram has {bins} bins; it needs 1 to {MOST_BINS}")]
    Bins {
        /// As it was given.
        bins: usize,
    },
}

impl Histogram {
    /// Without values, from `low` to `high`.
    pub fn new(low: f64, high: f64, bins: usize) -> Result<Self, HistogramError> {
        if !((high - low).is_finite() && low < high) {
            return Err(HistogramError::Range { low, high });
        }
        if !(1..=MOST_BINS).contains(&bins) {
            return Err(HistogramError::Bins { bins });
        }
        Ok(Self { low, high, counts: vec![0; bins], below: 0, above: 0, skipped: 0 })
    }

    /// Takes in a value; an absent or non-finite one is counted as skipped.
    pub fn add(&mut self, value: impl Into<Option<f64>>) {
        let Some(value) = value.into().filter(|v| v.is_finite()) else {
            self.skipped += 1;
            return;
        };
        if value < self.low {
            self.below += 1;
        } else if value > self.high {
            self.above += 1;
        } else {
            let place = (value - self.low) / (self.high - self.low) * self.counts.len() as f64;
            // Between 0 and the number of bins.
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
            let bin = (place as usize).min(self.counts.len() - 1);
            self.counts[bin] += 1;
        }
    }

    /// Bin by bin.
    pub fn counts(&self) -> &[u64] {
        &self.counts
    }

    /// Where bin `bin` begins and ends.
    pub fn edges(&self, bin: usize) -> (f64, f64) {
        let edge =
            |place: usize| self.low + (self.high - self.low) * (place as f64 / self.counts.len() as f64);
        (edge(bin), edge(bin.saturating_add(1)))
    }

    /// Values below the first bin.
    pub fn below(&self) -> u64 {
        self.below
    }

    /// Values above the last bin.
    pub fn above(&self) -> u64 {
        self.above
    }

    /// Values that were absent or not finite.
    pub fn skipped(&self) -> u64 {
        self.skipped
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn bins_by_hand() {
        let mut histogram = Histogram::new(-1.0, 1.0, 4).expect("a range");
        for value in [-1.0, -0.5, -0.1, 0.0, 0.6, 1.0, 1.1, -7.0, f64::NAN, f64::INFINITY] {
            histogram.add(value);
        }
        histogram.add(None);
        assert_eq!(histogram.counts(), [1, 2, 1, 2]);
        assert_eq!((histogram.below(), histogram.above(), histogram.skipped()), (1, 1, 3));
        assert_eq!((histogram.edges(0), histogram.edges(3)), ((-1.0, -0.5), (0.5, 1.0)));
        let refused = |low, high, bins| Histogram::new(low, high, bins).expect_err("refused").to_string();
        assert_eq!(
            refused(1.0, 1.0, 4),
            "a histogram from 1 to 1 has no width; both must be finite numbers and the first must be smaller"
        );
        assert_eq!(refused(0.0, 1.0, 0), "a histogram has 0 bins; it needs 1 to 1048576");
        assert!(Histogram::new(f64::NAN, 1.0, 4).is_err() && Histogram::new(f64::MIN, f64::MAX, 4).is_err());
    }

    proptest! {
        #[test]
        fn every_value_is_counted_once(values in prop::collection::vec(any::<f64>(), 0..50), low in -1e3..1e3, width in 1e-9..1e3, bins in 1_usize..40) {
            let mut histogram = Histogram::new(low, low + width, bins).expect("a range");
            for value in &values {
                histogram.add(*value);
            }
            let inside: u64 = histogram.counts().iter().sum();
            prop_assert_eq!(inside + histogram.below() + histogram.above() + histogram.skipped(), values.len() as u64);
        }
    }
}
