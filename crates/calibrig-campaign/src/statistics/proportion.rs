//! How often something happens.

use calibrig_model::statistics::clopper_pearson;

use super::{Estimated, Interval};

/// A share of trials.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Proportion {
    hits: u64,
    trials: u64,
    skipped: u64,
}

impl Proportion {
    /// Takes in whether it happened; `None`, if unknown, is counted as skipped.
    pub fn add(&mut self, happened: impl Into<Option<bool>>) {
        match happened.into() {
            Some(happened) => {
                self.trials += 1;
                self.hits += u64::from(happened);
            }
            None => self.skipped += 1,
        }
    }

    /// Takes in whether a value is at most `limit`; one that is not a finite number is skipped.
    pub fn add_within(&mut self, value: impl Into<Option<f64>>, limit: f64) {
        self.add(value.into().filter(|v| v.is_finite()).map(|v| v <= limit));
    }

    /// How often it happened.
    pub fn hits(&self) -> u64 {
        self.hits
    }

    /// For how many it is known.
    pub fn trials(&self) -> u64 {
        self.trials
    }

    /// For how many it is unknown.
    pub fn skipped(&self) -> u64 {
        self.skipped
    }

    /// The share with its exact interval of confidence `level` (Clopper and Pearson), which holds for any number of trials and is rather too wide;
    /// `None` without trials, without an interval for more than 1e9.
    pub fn interval(&self, level: f64) -> Option<Estimated> {
        (self.trials > 0).then(|| {
            let (low, high) = clopper_pearson(self.hits, self.trials, level);
            let interval = (low <= high).then_some(Interval { low, high });
            Estimated { value: self.hits as f64 / self.trials as f64, interval }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_share_by_hand() {
        let mut within = Proportion::default();
        assert_eq!(within.interval(0.95), None);
        for value in [0.1, 0.2, 0.3, f64::NAN] {
            within.add_within(value, 0.2);
        }
        within.add_within(None, 0.2);
        within.add(None);
        assert_eq!((within.hits(), within.trials(), within.skipped()), (2, 3, 3));
        let mut never = Proportion::default();
        (0..10).for_each(|_| never.add(false));
        let estimate = never.interval(0.95).expect("ten trials");
        let interval = estimate.interval.expect("ten trials");
        assert_eq!((estimate.value, interval.low), (0.0, 0.0));
        assert!((interval.high - (1.0 - 0.025_f64.powf(0.1))).abs() < 1e-12);
    }
}
