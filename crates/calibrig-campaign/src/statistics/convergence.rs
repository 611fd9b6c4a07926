//! Whether the trials are enough.

use calibrig_model::statistics::clopper_pearson;
use serde::Serialize;

use super::{Estimated, Moments, Proportion, student};

/// No study has as many trials.
const MOST: u64 = 1_000_000_000;

/// How precisely the trials determine a figure, and how many more are needed for the wanted precision.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Convergence {
    /// Trials for which the figure is known.
    pub trials: u64,
    /// Half the width of its interval over the figure itself.
    pub reached: f64,
    /// Its wanted maximum.
    pub wanted: f64,
    /// Sufficient number of trials, if further ones are like these: an estimate, with a relative error of about twice that of the standard
    /// deviation.
    pub needed: u64,
}

impl Convergence {
    /// How many more trials are needed; none if there are enough.
    pub fn more(&self) -> u64 {
        self.needed.saturating_sub(self.trials)
    }

    /// Whether the interval is as narrow as wanted.
    pub fn is_enough(&self) -> bool {
        self.reached <= self.wanted
    }

    /// For a figure with an interval; `narrows` says whether a number of trials is enough.
    fn of(trials: u64, estimate: &Estimated, wanted: f64, narrows: impl Fn(u64) -> bool) -> Option<Self> {
        let reached = estimate.interval?.half_width() / estimate.value.abs();
        if !(reached.is_finite() && wanted > 0.0 && trials < MOST) {
            return None;
        }
        let needed = if reached <= wanted { trials } else { search(trials, narrows)? };
        Some(Self { trials, reached, wanted, needed })
    }
}

/// The first number above `trials` for which `enough` holds; `None` above a thousand million.
fn search(trials: u64, enough: impl Fn(u64) -> bool) -> Option<u64> {
    let (mut low, mut high) = (trials, MOST);
    if !enough(high) {
        return None;
    }
    while high - low > 1 {
        let middle = low.midpoint(high);
        if enough(middle) {
            high = middle;
        } else {
            low = middle;
        }
    }
    Some(high)
}

/// How many trials bring half the width of a mean's interval of confidence `level` to the share `wanted` of the mean. `None` if no number does: for a
/// mean of zero, for one trial, above a thousand million.
pub fn trials_for_mean(moments: &Moments, level: f64, wanted: f64) -> Option<Convergence> {
    let (mean, variance) = (moments.mean()?, moments.variance()?);
    let narrows =
        |n: u64| student(level, (n - 1) as f64) * (variance / n as f64).sqrt() <= wanted * mean.abs();
    Convergence::of(moments.count(), &moments.mean_interval(level)?, wanted, narrows)
}

/// How many trials bring half the width of a share's interval of confidence `level` to the share `wanted` of it. `None` if no number does: if it
/// never happened, above a thousand million.
pub fn trials_for_proportion(proportion: &Proportion, level: f64, wanted: f64) -> Option<Convergence> {
    let estimate = proportion.interval(level)?;
    let narrows = |n: u64| {
        // Rounded down, at most `n`.
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let hits = (estimate.value * n as f64) as u64;
        let (low, high) = clopper_pearson(hits, n, level);
        0.5 * (high - low) <= wanted * estimate.value
    };
    Convergence::of(proportion.trials(), &estimate, wanted, narrows)
}

/// How many trials bring half the width of any other figure's interval to the share `wanted` of the figure, if it falls with the root of their
/// number, as for quantiles, ratios and indices. `None` without an interval, for a figure of zero, above a thousand million.
pub fn trials_for(estimate: &Estimated, trials: u64, wanted: f64) -> Option<Convergence> {
    let half = estimate.interval?.half_width();
    let narrows = |n: u64| half * (trials as f64 / n as f64).sqrt() <= wanted * estimate.value.abs();
    Convergence::of(trials, estimate, wanted, narrows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::Interval;

    #[test]
    fn a_mean_by_hand() {
        let mut moments = Moments::default();
        // Mean 10, variance 4 · 100 / 99.
        (0..100).for_each(|i| moments.add(if i % 2 == 0 { 8.0 } else { 12.0 }));
        let coarse = trials_for_mean(&moments, 0.95, 0.05).expect("scatter");
        assert!(coarse.is_enough() && coarse.more() == 0 && coarse.needed == 100);
        let fine = trials_for_mean(&moments, 0.95, 0.01).expect("scatter");
        // (1.96 · 2.01 / 0.1)² = 1552, and Student's t a little more.
        assert!(!fine.is_enough() && (1552..=1560).contains(&fine.needed), "{fine:?}");
        assert_eq!(fine.more(), fine.needed - 100);
        let half = |n: u64| student(0.95, (n - 1) as f64) * (400.0 / 99.0 / n as f64).sqrt();
        assert!(half(fine.needed) <= 0.1 && half(fine.needed - 1) > 0.1);
        assert_eq!(trials_for_mean(&moments, 0.95, 1e-7), None);
        assert_eq!(trials_for_mean(&moments, 0.95, 0.0), None);
        let mut centred = Moments::default();
        centred.add(-1.0);
        centred.add(1.0);
        assert_eq!(
            (trials_for_mean(&centred, 0.95, 0.1), trials_for_mean(&Moments::default(), 0.95, 0.1)),
            (None, None)
        );
    }

    #[test]
    fn a_share_and_another_figure_by_hand() {
        let mut share = Proportion::default();
        (0..50).for_each(|i| share.add(i % 5 == 0));
        let found = trials_for_proportion(&share, 0.95, 0.1).expect("some hits");
        // z² (1 - p) / (p f²) = 1536, and an exact interval is wider by half a trial on either side.
        assert!((1536..=1600).contains(&found.needed), "{found:?}");
        let mut never = Proportion::default();
        never.add(false);
        assert_eq!(trials_for_proportion(&never, 0.95, 0.1), None);
        let estimate = Estimated { value: -2.0, interval: Some(Interval { low: -2.5, high: -1.5 }) };
        let found = trials_for(&estimate, 10, 0.03125).expect("an interval");
        assert_eq!((found.reached, found.needed, found.more()), (0.25, 640, 630));
        assert_eq!(trials_for(&Estimated { interval: None, ..estimate }, 10, 0.1), None);
        assert_eq!(trials_for(&Estimated { value: 0.0, ..estimate }, 10, 0.1), None);
    }
}
