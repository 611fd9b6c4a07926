//! What a factor of a study is drawn from.

use calibrig_model::statistics::normal_quantile;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The distribution of a factor's values, in the factor's own unit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "distribution", rename_all = "snake_case", deny_unknown_fields)]
pub enum Distribution {
    /// Every value between two is as likely as another.
    Uniform {
        /// The smallest.
        low: f64,
        /// The largest.
        high: f64,
    },
    /// The logarithm is uniform: every order of magnitude is as likely as another.
    LogUniform {
        /// The smallest, above zero.
        low: f64,
        /// The largest.
        high: f64,
    },
    /// Gaussian.
    Normal {
        /// Its centre.
        mean: f64,
        /// Standard deviation, above zero.
        sigma: f64,
    },
    /// The logarithm is normal.
    #[serde(rename = "lognormal")]
    LogNormal {
        /// The median, above zero.
        median: f64,
        /// Standard deviation of the natural logarithm, above zero: about the relative scatter if it is small.
        sigma_ln: f64,
    },
    /// From a smallest via a most likely to a largest value.
    Triangular {
        /// The smallest.
        low: f64,
        /// The most likely; it may be the smallest or the largest.
        mode: f64,
        /// The largest.
        high: f64,
    },
}

/// What is wrong with a distribution.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[non_exhaustive]
pub enum DistributionError {
    /// A number that is not valid.
    #[error("`{name}` is {value}; it must be a finite number")]
    NotFinite {
        /// Which.
        name: &'static str,
        /// As it was given.
        value: f64,
    },
    /// A number that must be above zero.
    #[error("`{name}` is {value}; it must be above zero")]
    NotPositive {
        /// Which.
        name: &'static str,
        /// As it was given.
        value: f64,
    },
    /// A range without width.
    #[error("`low` is {low} and `high` is {high}; `low` must be below `high`")]
    Order {
        /// As it was given.
        low: f64,
        /// As it was given.
        high: f64,
    },
    /// A range whose width no number can express.
    #[error("the range from {low} to {high} is too wide for a floating-point number")]
    TooWide {
        /// As it was given.
        low: f64,
        /// As it was given.
        high: f64,
    },
    /// A most likely value outside the range.
    #[error("`mode` is {mode}; it must be between `low`, {low}, and `high`, {high}")]
    Mode {
        /// As it was given.
        low: f64,
        /// As it was given.
        mode: f64,
        /// As it was given.
        high: f64,
    },
}

fn finite(name: &'static str, value: f64) -> Result<(), DistributionError> {
    if value.is_finite() { Ok(()) } else { Err(DistributionError::NotFinite { name, value }) }
}

fn positive(name: &'static str, value: f64) -> Result<(), DistributionError> {
    finite(name, value)?;
    if value > 0.0 { Ok(()) } else { Err(DistributionError::NotPositive { name, value }) }
}

fn range(low: f64, high: f64) -> Result<(), DistributionError> {
    finite("low", low)?;
    finite("high", high)?;
    if low >= high {
        return Err(DistributionError::Order { low, high });
    }
    if (high - low).is_finite() { Ok(()) } else { Err(DistributionError::TooWide { low, high }) }
}

impl Distribution {
    /// Whether the distribution is valid.
    pub fn check(&self) -> Result<(), DistributionError> {
        match *self {
            Self::Uniform { low, high } => range(low, high),
            Self::LogUniform { low, high } => {
                positive("low", low)?;
                range(low, high)?;
                // Its width is a factor.
                if (high / low).is_finite() { Ok(()) } else { Err(DistributionError::TooWide { low, high }) }
            }
            Self::Normal { mean, sigma } => {
                finite("mean", mean)?;
                positive("sigma", sigma)
            }
            Self::LogNormal { median, sigma_ln } => {
                positive("median", median)?;
                positive("sigma_ln", sigma_ln)
            }
            Self::Triangular { low, mode, high } => {
                range(low, high)?;
                finite("mode", mode)?;
                let between = low <= mode && mode <= high;
                if between { Ok(()) } else { Err(DistributionError::Mode { low, mode, high }) }
            }
        }
    }

    /// The value below which the share `u` lies. A share closer to 0 or 1 than 2^-53 is moved to 2^-53, so that the value is finite: a normal
    /// one is at most 8.2 standard deviations off. NaN if `u` is NaN.
    pub fn quantile(&self, u: f64) -> f64 {
        const NEXT_TO_NOTHING: f64 = 0.5 * f64::EPSILON;
        let u = u.clamp(NEXT_TO_NOTHING, 1.0 - NEXT_TO_NOTHING);
        match *self {
            Self::Uniform { low, high } => (low + u * (high - low)).min(high),
            Self::LogUniform { low, high } => (low * (high / low).powf(u)).clamp_to(low, high),
            Self::Normal { mean, sigma } => mean + sigma * normal_quantile(u),
            Self::LogNormal { median, sigma_ln } => median * (sigma_ln * normal_quantile(u)).exp(),
            Self::Triangular { low, mode, high } => {
                let (width, below) = (high - low, mode - low);
                if u * width < below {
                    (low + (u * width).sqrt() * below.sqrt()).clamp_to(low, high)
                } else {
                    (high - ((1.0 - u) * width).sqrt() * (high - mode).sqrt()).clamp_to(low, high)
                }
            }
        }
    }
}

/// `f64::clamp` panics if the limits are in the wrong order.
trait ClampTo {
    fn clamp_to(self, low: f64, high: f64) -> f64;
}

impl ClampTo for f64 {
    fn clamp_to(self, low: f64, high: f64) -> f64 {
        // `max` and `min` drop NaN.
        if self.is_nan() { self } else { self.max(low).min(high) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_model::statistics::normal_survival;
    use proptest::prelude::*;

    /// The closed form of the share below `x`.
    fn share_below(distribution: &Distribution, x: f64) -> f64 {
        match *distribution {
            Distribution::Uniform { low, high } => (x - low) / (high - low),
            Distribution::LogUniform { low, high } => (x / low).ln() / (high / low).ln(),
            Distribution::Normal { mean, sigma } => normal_survival((mean - x) / sigma),
            Distribution::LogNormal { median, sigma_ln } => normal_survival((median / x).ln() / sigma_ln),
            Distribution::Triangular { low, mode, high } if x < mode => {
                (x - low).powi(2) / ((high - low) * (mode - low))
            }
            Distribution::Triangular { low, mode, high } => {
                1.0 - (high - x).powi(2) / ((high - low) * (high - mode))
            }
        }
    }

    fn any() -> impl Strategy<Value = Distribution> {
        prop_oneof![
            (-1e3..1e3, 1e-3..1e3).prop_map(|(low, w)| Distribution::Uniform { low, high: low + w }),
            (1e-6..1e3, 1.01..1e4).prop_map(|(low, f)| Distribution::LogUniform { low, high: low * f }),
            (-1e3..1e3, 1e-3..1e3).prop_map(|(mean, sigma)| Distribution::Normal { mean, sigma }),
            (1e-6..1e3, 1e-3..2.0)
                .prop_map(|(median, sigma_ln)| Distribution::LogNormal { median, sigma_ln }),
            (-1e3..1e3, 1e-3..1e3, 0.0..=1.0).prop_map(|(low, w, at): (f64, f64, f64)| {
                Distribution::Triangular { low, mode: low + at * w, high: low + w }
            }),
        ]
    }

    proptest! {
        /// The value's own rounding is magnified by the density: a part in 2^52 of 1e3 over a width of 1e-3 is 2e-10; ten times that.
        #[test]
        fn the_quantile_is_the_inverse_of_the_closed_form(distribution in any(), u in 1e-4..0.9999) {
            prop_assert_eq!(distribution.check(), Ok(()));
            let found = share_below(&distribution, distribution.quantile(u));
            prop_assert!((found - u).abs() <= 2e-9, "{} instead of {}", found, u);
        }

        #[test]
        fn the_quantile_never_falls_and_is_finite(distribution in any(), a in 0.0..=1.0, b in 0.0..=1.0) {
            let (low, high) = (distribution.quantile(f64::min(a, b)), distribution.quantile(f64::max(a, b)));
            prop_assert!(low.is_finite() && high.is_finite() && low <= high);
            prop_assert!(distribution.quantile(0.0) <= low && high <= distribution.quantile(1.0));
        }

        #[test]
        fn a_file_keeps_every_bit(distribution in any()) {
            let text = serde_json::to_string(&distribution).expect("plain numbers");
            prop_assert_eq!(serde_json::from_str::<Distribution>(&text).expect("as written"), distribution);
        }
    }

    #[test]
    fn values_by_hand() {
        let triangle = Distribution::Triangular { low: 0.0, mode: 1.0, high: 4.0 };
        for (u, expected) in [(0.0625, 0.5), (0.25, 1.0), (0.75, 4.0 - 3.0_f64.sqrt())] {
            assert!((triangle.quantile(u) - expected).abs() < 1e-15);
        }
        let decades = Distribution::LogUniform { low: 1e-2, high: 1e2 };
        assert!((decades.quantile(0.25) - 0.1).abs() < 1e-15);
        let normal = Distribution::Normal { mean: 5.0, sigma: 2.0 };
        assert_eq!(normal.quantile(0.5), 5.0);
        assert!((normal.quantile(0.975) - 8.919_927_969_080_108).abs() < 1e-12);
        assert!((5.0 - normal.quantile(0.0)) / 2.0 < 8.3 && normal.quantile(f64::NAN).is_nan());
        assert_eq!(Distribution::LogNormal { median: 3.0, sigma_ln: 0.1 }.quantile(0.5), 3.0);
    }

    #[test]
    fn impossible_ones_are_refused() {
        let message = |distribution: Distribution| distribution.check().expect_err("impossible").to_string();
        assert_eq!(
            message(Distribution::Uniform { low: 1.0, high: 1.0 }),
            "`low` is 1 and `high` is 1; `low` must be below `high`"
        );
        assert_eq!(
            message(Distribution::LogUniform { low: 0.0, high: 1.0 }),
            "`low` is 0; it must be above zero"
        );
        assert_eq!(
            message(Distribution::Normal { mean: f64::NAN, sigma: 1.0 }),
            "`mean` is NaN; it must be a finite number"
        );
        assert_eq!(
            message(Distribution::Normal { mean: 0.0, sigma: 0.0 }),
            "`sigma` is 0; it must be above zero"
        );
        assert_eq!(
            message(Distribution::LogNormal { median: 1.0, sigma_ln: -0.5 }),
            "`sigma_ln` is -0.5; it must be above zero"
        );
        assert_eq!(
            message(Distribution::Triangular { low: 0.0, mode: 3.0, high: 2.0 }),
            "`mode` is 3; it must be between `low`, 0, and `high`, 2"
        );
        let wide = Distribution::Uniform { low: f64::MIN, high: f64::MAX };
        assert!(matches!(wide.check(), Err(DistributionError::TooWide { .. })));
        let decades = Distribution::LogUniform { low: 1e-300, high: 1e300 };
        assert!(matches!(decades.check(), Err(DistributionError::TooWide { .. })));
        // Unchecked, it ends nothing.
        assert!(Distribution::LogUniform { low: 2.0, high: 1.0 }.quantile(0.5).is_finite());
    }
}
