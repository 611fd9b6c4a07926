//! How many digits a figure has, and how its interval is written: the same on the terminal and on the page.

use calibrig_campaign::statistics::Interval;

use super::MeanWithInterval;

/// So many decimals that what is uncertain by `half` has two digits of it.
pub fn decimals(half: f64) -> usize {
    if !(half.is_finite() && half > 0.0) {
        return 4;
    }
    // Between 0 and 7.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let decimals = (1.0 - half.log10().floor()).clamp(0.0, 7.0) as usize;
    decimals
}

/// A figure with its interval, both times `factor`: "1.25 ± 0.12" where the interval lies as far below as above, else with its ends, "1.25 [1.05, 1.80]".
pub fn with_interval(
    value: f64,
    interval: Option<Interval>,
    factor: f64,
    number: impl Fn(f64, usize) -> String,
) -> String {
    let interval = interval.filter(|interval| interval.half_width().is_finite());
    let Some(Interval { low, high }) = interval else { return number(factor * value, 4) };
    let digits = decimals(factor * 0.5 * (high - low));
    let text = |value: f64| number(factor * value, digits);
    let (below, above) = (text(value - low), text(high - value));
    if below == above {
        format!("{} \u{b1} {above}", text(value))
    } else {
        format!("{} [{}, {}]", text(value), text(low), text(high))
    }
}

impl MeanWithInterval {
    /// The interval of the mean; `None` from one trial.
    pub fn interval(&self) -> Option<Interval> {
        self.half_width.map(|half| Interval { low: self.mean - half, high: self.mean + half })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interval_that_is_not_symmetrical_is_told_by_its_ends() {
        let text = |value, low, high, factor| {
            with_interval(value, Some(Interval { low, high }), factor, |v, digits| format!("{v:.digits$}"))
        };
        assert_eq!(text(1.25e-3, 1.13e-3, 1.37e-3, 1e3), "1.25 \u{b1} 0.12");
        assert_eq!(text(1.25, 1.05, 1.8, 1.0), "1.25 [1.05, 1.80]");
        // What rounding makes of the ends is no asymmetry.
        assert_eq!(text(0.5, 0.3 + 1e-12, 0.7, 1.0), "0.50 \u{b1} 0.20");
    }
}
