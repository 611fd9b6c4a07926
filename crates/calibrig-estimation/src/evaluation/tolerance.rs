//! What errors at held-out poses say about all other poses: bounds with a stated confidence, not only what was seen.
//!
//! The held-out poses must be drawn at random from the region in question, independently of the fit. Then a bound of a quantile needs no other
//! assumption (S. S. Wilks, Ann. Math. Statist. 12 (1941) 91). The largest error of a region is different: whatever was seen, a larger error may
//! hide in a small part of the region. Without assuming how errors change from pose to pose, one can only state how large that part is at
//! most, and how likely the next poses stay below.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use calibrig_model::statistics::{binomial_cdf, chi2_quantile, ln_gamma, normal_quantile, normal_survival};

/// Largest number of errors or poses that is supported.
const MOST: usize = 1_000_000;

/// Number of nodes of the integral over the distribution of a standard deviation.
const NODES: i32 = 1000;

/// Why a bound cannot be given.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum ToleranceError {
    /// A share is not between zero and one.
    #[error("{field} is {value}: expected a share above zero and below one, such as 0.95")]
    Share {
        /// Name of the share: coverage or confidence.
        field: &'static str,
        /// Its value.
        value: f64,
    },
    /// There are too few errors for a bound.
    #[error(
        "{found} held-out errors give no bound on the {:.6} % quantile with a confidence of {:.6} %: expected {least} or \
         more; hold out more poses, or ask for a smaller share or confidence",
        100.0 * .coverage, 100.0 * .confidence
    )]
    TooFew {
        /// Number of errors.
        found: usize,
        /// Number of errors that would be enough.
        least: usize,
        /// Coverage of the quantile.
        coverage: f64,
        /// Confidence of the bound.
        confidence: f64,
    },
    /// An error is not a finite length.
    #[error("held-out error {} is {value}: expected a finite length of zero or more, m", .index.saturating_add(1))]
    Length {
        /// Index in the list.
        index: usize,
        /// Its value.
        value: f64,
    },
    /// A number of poses is out of range.
    #[error("{value} poses are asked about: expected 1 to {MOST}")]
    Count {
        /// Number of poses.
        value: usize,
    },
}

/// Bounds from the lengths of held-out errors; each of them alone holds with the `confidence`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Acceptance {
    /// Number of errors.
    pub count: usize,
    /// Share of the region's poses that the bounds hold for.
    pub coverage: f64,
    /// Probability that such a bound holds.
    pub confidence: f64,
    /// Length below which `coverage` of the region's poses stay, without an assumption on the distribution of the errors: an order statistic. `None`
    /// for too few errors.
    pub distribution_free: Option<OrderBound>,
    /// Number of errors that would give such a bound.
    pub needed: usize,
    /// Like `distribution_free`, for errors that are [normal, the same along three axes and without bias](isotropic_bound), m. It is sharper, and
    /// exists for few errors, but is wrong where the errors are larger along one axis, or in a part of the region.
    pub isotropic: f64,
    /// What the largest error shows.
    pub largest: LargestError,
}

/// An order statistic that bounds a quantile.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct OrderBound {
    /// The bound, m.
    pub bound: f64,
    /// Rank of the error that is the bound, from the largest, 1.
    pub from_largest: usize,
    /// Confidence of the bound: no less than asked for.
    pub confidence: f64,
}

/// What the largest of a number of errors shows.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LargestError {
    /// The largest error, m.
    pub seen: f64,
    /// Share of the region's poses that stays below it at least, with the confidence: (1 - confidence)^(1/n).
    pub share_below: f64,
    /// Probability that the same number of further poses all stay below it: one half.
    pub as_many_more: f64,
}

/// Bounds of the 95 % quantile (or another `coverage`) and of what lies beyond, from the lengths of errors (m) at held-out poses that were drawn
/// at random from the region.
///
/// # Errors
///
/// [`ToleranceError`], without errors, for an error that is not a finite length, and for shares that are not between zero and one.
pub fn accept(errors: &[f64], coverage: f64, confidence: f64) -> Result<Acceptance, ToleranceError> {
    let sorted = sorted(errors)?;
    let needed = least_sample(coverage, confidence, 1)?;
    let distribution_free = match quantile_bound(errors, coverage, confidence) {
        Ok(bound) => Some(bound),
        Err(ToleranceError::TooFew { .. }) => None,
        Err(error) => return Err(error),
    };
    let largest = LargestError {
        seen: *sorted.last().ok_or(ToleranceError::Count { value: 0 })?,
        share_below: share_below_largest(sorted.len(), confidence)?,
        as_many_more: stays_largest(sorted.len(), sorted.len())?,
    };
    let isotropic = isotropic_bound(errors, coverage, confidence)?;
    Ok(Acceptance {
        count: sorted.len(),
        coverage,
        confidence,
        distribution_free,
        needed,
        isotropic,
        largest,
    })
}

fn sorted(errors: &[f64]) -> Result<Vec<f64>, ToleranceError> {
    count(errors.len())?;
    if let Some((index, value)) =
        errors.iter().copied().enumerate().find(|(_, error)| !(*error >= 0.0 && error.is_finite()))
    {
        return Err(ToleranceError::Length { index, value });
    }
    let mut sorted = errors.to_vec();
    sorted.sort_by(f64::total_cmp);
    Ok(sorted)
}

fn count(value: usize) -> Result<(), ToleranceError> {
    if (1..=MOST).contains(&value) { Ok(()) } else { Err(ToleranceError::Count { value }) }
}

fn shares(coverage: f64, confidence: f64) -> Result<(), ToleranceError> {
    for (field, value) in [("the coverage", coverage), ("the confidence", confidence)] {
        if !(value > 0.0 && value < 1.0) {
            return Err(ToleranceError::Share { field, value });
        }
    }
    Ok(())
}

/// Confidence with which the error of rank `from_largest` (1: the largest) out of `errors` bounds a quantile: the probability that at least that
/// many errors lie above the quantile.
fn confidence_of(errors: usize, coverage: f64, from_largest: usize) -> f64 {
    // At least `from_largest` of all errors lie above the quantile.
    1.0 - binomial_cdf(from_largest as u64 - 1, errors as u64, 1.0 - coverage)
}

/// The least order statistic of `errors` below which a share `coverage` of the population lies with the `confidence`. The only assumption is
/// that the errors are drawn independently from the population.
///
/// # Errors
///
/// [`ToleranceError::TooFew`] where even the largest error has less confidence; otherwise as [`accept`].
pub fn quantile_bound(errors: &[f64], coverage: f64, confidence: f64) -> Result<OrderBound, ToleranceError> {
    shares(coverage, confidence)?;
    let sorted = sorted(errors)?;
    let n = sorted.len();
    let holds = |from_largest: usize| confidence_of(n, coverage, from_largest) >= confidence;
    if !holds(1) {
        let least = least_sample(coverage, confidence, 1)?;
        return Err(ToleranceError::TooFew { found: n, least, coverage, confidence });
    }
    // The confidence decreases with the rank.
    let (mut good, mut bad) = (1, n + 1);
    while bad - good > 1 {
        let middle = usize::midpoint(good, bad);
        if holds(middle) { good = middle } else { bad = middle }
    }
    Ok(OrderBound {
        bound: sorted[n - good],
        from_largest: good,
        confidence: confidence_of(n, coverage, good),
    })
}

/// Number of errors needed for the one of rank `from_largest` (1: the largest) to bound a quantile: 59 for 95 % with a confidence of 95 %, 93 for the
/// second largest.
///
/// # Errors
///
/// [`ToleranceError`], for shares that are not between zero and one, a rank of zero, or where a million errors are not enough.
pub fn least_sample(coverage: f64, confidence: f64, from_largest: usize) -> Result<usize, ToleranceError> {
    shares(coverage, confidence)?;
    count(from_largest)?;
    let holds = |n: usize| confidence_of(n, coverage, from_largest) >= confidence;
    if !holds(MOST) {
        let least = MOST.saturating_add(1);
        return Err(ToleranceError::TooFew { found: MOST, least, coverage, confidence });
    }
    let (mut bad, mut good) = (from_largest - 1, MOST);
    while good - bad > 1 {
        let middle = usize::midpoint(good, bad);
        if holds(middle) { good = middle } else { bad = middle }
    }
    Ok(good)
}

/// Share of a population that stays below the largest of `errors` errors at least, with the `confidence`.
///
/// # Errors
///
/// [`ToleranceError`], for no errors, or a confidence that is not between zero and one.
pub fn share_below_largest(errors: usize, confidence: f64) -> Result<f64, ToleranceError> {
    shares(0.5, confidence)?;
    count(errors)?;
    Ok((1.0 - confidence).powf(1.0 / errors as f64))
}

/// Probability that `further` errors all stay below the largest of `errors`: each of all these errors is equally likely to be the largest.
///
/// # Errors
///
/// [`ToleranceError`], for no errors.
pub fn stays_largest(errors: usize, further: usize) -> Result<f64, ToleranceError> {
    count(errors)?;
    Ok(errors as f64 / (errors as f64 + further as f64))
}

/// The factor k with which `mean + k s` of a normal sample is above the share `coverage` of its population with the `confidence`: a quantile of the
/// noncentral t distribution over √n (G. J. Lieberman, Industrial Quality Control 14 (1958) 7; ISO 16269-6).
///
/// # Errors
///
/// [`ToleranceError`], for fewer than two errors, or shares that are not between zero and one.
pub fn normal_tolerance_factor(errors: usize, coverage: f64, confidence: f64) -> Result<f64, ToleranceError> {
    shares(coverage, confidence)?;
    count(errors)?;
    if errors < 2 {
        return Err(ToleranceError::TooFew { found: errors, least: 2, coverage, confidence });
    }
    let n = errors as f64;
    let beyond = n.sqrt() * normal_quantile(coverage);
    let reached = |k: f64| below_noncentral(k * n.sqrt(), n - 1.0, beyond);
    let (mut low, mut high) = (-1.0, 1.0);
    while reached(low) > confidence {
        low *= 2.0;
    }
    while reached(high) < confidence && high < 1e9 {
        high *= 2.0;
    }
    while high - low > 1e-12 * (1.0 + high.abs()) {
        let middle = 0.5 * (low + high);
        if reached(middle) < confidence { low = middle } else { high = middle }
    }
    Ok(0.5 * (low + high))
}

/// Probability that a noncentral t lies below `t`: E Φ(t S - δ), with S² chi-square over its degrees of freedom; by Simpson's rule over the range
/// of S.
fn below_noncentral(t: f64, freedom: f64, shift: f64) -> f64 {
    let half_width = 12.0 / (2.0 * freedom).sqrt();
    let (low, high) = ((1.0 - half_width).max(0.0), 1.0 + half_width);
    let half = 0.5 * freedom;
    let log_constant = std::f64::consts::LN_2 + half * half.ln() - ln_gamma(half);
    let density = |s: f64| {
        if s > 0.0 { (log_constant + (freedom - 1.0) * s.ln() - half * s * s).exp() } else { 0.0 }
    };
    let step = (high - low) / f64::from(NODES);
    let mut sum = 0.0;
    let mut mass = 0.0;
    for node in 0..=NODES {
        let weight = match node {
            0 | NODES => 1.0,
            node if node % 2 == 1 => 4.0,
            _ => 2.0,
        };
        let s = low + step * f64::from(node);
        let own = weight * density(s);
        mass += own;
        sum += own * normal_survival(shift - t * s);
    }
    sum / mass
}

/// Lowest and highest value of an interval that holds a share `coverage` of a normal population with at least the `confidence`, from signed
/// errors (along one axis, m). On either side at most half of the rest lies beyond (equal tails, each a one-sided bound with half of the allowed
/// failure probability). Errors are assumed to be normal and independent; nothing is assumed of their mean and variance.
///
/// # Errors
///
/// [`ToleranceError`], for fewer than two errors, an error that is not finite, or shares that are not between zero and one.
pub fn normal_interval(errors: &[f64], coverage: f64, confidence: f64) -> Result<[f64; 2], ToleranceError> {
    shares(coverage, confidence)?;
    if let Some((index, value)) = errors.iter().copied().enumerate().find(|(_, error)| !error.is_finite()) {
        return Err(ToleranceError::Length { index, value });
    }
    let factor = normal_tolerance_factor(errors.len(), 0.5 + 0.5 * coverage, 0.5 + 0.5 * confidence)?;
    let n = errors.len() as f64;
    let mean = errors.iter().sum::<f64>() / n;
    let spread = (errors.iter().map(|error| (error - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
    Ok([mean - factor * spread, mean + factor * spread])
}

/// A bound of a quantile of the lengths of errors that are normal along three axes, with mean zero and the same variance along each: σ is at most
/// √(Σ l² / χ²) with the lower quantile for 3 n degrees of freedom. It is the sharpest bound, with the strongest assumption.
///
/// # Errors
///
/// As [`accept`].
pub fn isotropic_bound(errors: &[f64], coverage: f64, confidence: f64) -> Result<f64, ToleranceError> {
    shares(coverage, confidence)?;
    let sorted = sorted(errors)?;
    let squares: f64 = sorted.iter().map(|error| error * error).sum();
    let least = chi2_quantile(1.0 - confidence, 3.0 * sorted.len() as f64);
    Ok((squares / least * chi2_quantile(coverage, 3.0)).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_model::random::{StreamSource, stream};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// Published: S. S. Wilks 1941; A. Guba, M. Makai, L. Pál, Reliability Engineering and System Safety 80 (2003) 217: 59, 93, 124, 153, 181 runs.
    #[test]
    fn samples_are_as_large_as_the_tables_have_them() {
        for (from_largest, expected) in [(1, 59), (2, 93), (3, 124), (4, 153), (5, 181)] {
            assert_eq!(least_sample(0.95, 0.95, from_largest), Ok(expected));
        }
        for (coverage, confidence, expected) in [
            (0.90, 0.90, 22),
            (0.90, 0.95, 29),
            (0.95, 0.90, 45),
            (0.95, 0.99, 90),
            (0.99, 0.95, 299),
            (0.99, 0.99, 459),
        ] {
            assert_eq!(least_sample(coverage, confidence, 1), Ok(expected));
        }
        let errors: Vec<f64> = (1..=93).map(f64::from).collect();
        let bound = quantile_bound(&errors, 0.95, 0.95).expect("enough");
        assert_eq!((bound.bound, bound.from_largest), (92.0, 2));
        let bound = quantile_bound(&errors[..59], 0.95, 0.95).expect("enough");
        assert_eq!((bound.bound, bound.from_largest), (59.0, 1));
        assert!((bound.confidence - (1.0 - 0.95_f64.powi(59))).abs() < 1e-12);
        let few = quantile_bound(&errors[..58], 0.95, 0.95).expect_err("too few");
        assert_eq!(few, ToleranceError::TooFew { found: 58, least: 59, coverage: 0.95, confidence: 0.95 });
        assert!(
            few.to_string().contains("58 held-out errors give no bound on the 95.000000 % quantile"),
            "{few}"
        );
    }

    /// Published one-sided factors (D. B. Owen 1962; ISO 16269-6, table of k for unknown mean and deviation).
    #[test]
    fn normal_factors_are_as_the_tables_have_them() {
        for (n, coverage, confidence, expected) in [
            (5, 0.95, 0.95, 4.203),
            (10, 0.95, 0.95, 2.911),
            (20, 0.95, 0.95, 2.396),
            (30, 0.95, 0.95, 2.220),
            (50, 0.95, 0.95, 2.065),
            (100, 0.95, 0.95, 1.927),
            (10, 0.90, 0.95, 2.355),
            (10, 0.99, 0.95, 3.981),
            (20, 0.95, 0.99, 2.808),
        ] {
            let k = normal_tolerance_factor(n, coverage, confidence).expect("a factor");
            assert!((k - expected).abs() < 1.1e-3, "{n} {coverage} {confidence}: {k} for {expected}");
        }
        assert!(normal_tolerance_factor(1, 0.95, 0.95).is_err());
    }

    fn length(rng: &mut ChaCha8Rng, sigmas: [f64; 3], mean: f64) -> f64 {
        let squares = sigmas.map(|sigma| {
            let normal: f64 = StandardNormal.sample(rng);
            (mean + sigma * normal).powi(2)
        });
        squares.iter().sum::<f64>().sqrt()
    }

    /// Number of 4000 samples in which a bound is above the quantile of a population, which a million other draws give.
    fn held(sigmas: [f64; 3], mean: f64, n: usize, bound: impl Fn(&[f64]) -> f64) -> u64 {
        let mut rng = stream(11, 0, StreamSource::Splits);
        let mut all: Vec<f64> = (0..1_000_000).map(|_| length(&mut rng, sigmas, mean)).collect();
        all.sort_by(f64::total_cmp);
        let quantile = all[950_000];
        let mut rng = stream(12, 0, StreamSource::Splits);
        let holds = |_: &usize| {
            let errors: Vec<f64> = (0..n).map(|_| length(&mut rng, sigmas, mean)).collect();
            bound(&errors) >= quantile
        };
        (0..4000).filter(holds).count() as u64
    }

    /// Checks that a count out of 4000 fits the probability `p`, within what chance leaves in 999 of 1000 cases.
    #[track_caller]
    fn as_often(hits: u64, p: f64, name: &str) {
        let (below, above) =
            (binomial_cdf(hits, 4000, p), 1.0 - binomial_cdf(hits.saturating_sub(1), 4000, p));
        assert!(below > 5e-4 && above > 5e-4, "{name}: {hits} of 4000 for {p}");
    }

    #[test]
    fn bounds_hold_as_often_as_they_say() {
        for (n, p) in [
            (59, 1.0 - 0.95_f64.powi(59)),
            (93, confidence_of(93, 0.95, 2)),
            (200, confidence_of(200, 0.95, 5)),
        ] {
            for sigmas in [[1.0; 3], [1.0, 0.2, 0.1]] {
                let bound = |errors: &[f64]| quantile_bound(errors, 0.95, 0.95).expect("enough").bound;
                as_often(held(sigmas, 0.3, n, bound), p, "distribution-free");
            }
            assert!(p >= 0.95);
        }
        let isotropic = |errors: &[f64]| isotropic_bound(errors, 0.95, 0.95).expect("a bound");
        for n in [5, 40] {
            as_often(held([0.7; 3], 0.0, n, isotropic), 0.95, "isotropic");
        }
    }

    /// Normal errors with a bias: either end bounds its tail as often as its half of the confidence says, and both together at least as often as
    /// stated.
    #[test]
    fn normal_intervals_hold_as_often_as_they_say() {
        let mut rng = stream(14, 0, StreamSource::Splits);
        let far = normal_quantile(0.975);
        let (mut low, mut high, mut both) = (0, 0, 0);
        for _ in 0..4000 {
            let errors: Vec<f64> = (0..12)
                .map(|_| {
                    let normal: f64 = StandardNormal.sample(&mut rng);
                    0.7 + 0.3 * normal
                })
                .collect();
            let [lowest, highest] = factor_of_twelve(&errors);
            let holds = [lowest <= 0.7 - 0.3 * far, highest >= 0.7 + 0.3 * far];
            low += u64::from(holds[0]);
            high += u64::from(holds[1]);
            both += u64::from(holds[0] && holds[1]);
        }
        as_often(low, 0.975, "the lower end");
        as_often(high, 0.975, "the upper end");
        // Not below 95 % by more than chance leaves in 999 of 1000 cases.
        assert!(binomial_cdf(both, 4000, 0.95) > 1e-3, "{both} of 4000");
        assert!(
            normal_interval(&[1.0], 0.95, 0.95).is_err()
                && normal_interval(&[1.0, f64::NAN], 0.95, 0.95).is_err()
        );
    }

    /// The interval of twelve errors; its factor is computed once.
    fn factor_of_twelve(errors: &[f64]) -> [f64; 2] {
        use std::sync::OnceLock;
        static FACTOR: OnceLock<f64> = OnceLock::new();
        let factor = *FACTOR.get_or_init(|| {
            let [low, high] = normal_interval(&[-1.0, 1.0], 0.95, 0.95).expect("an interval");
            // Two errors that differ by two have a standard deviation of sqrt(2).
            let two = normal_tolerance_factor(2, 0.975, 0.975).expect("a factor");
            assert!((high - two * 2.0_f64.sqrt()).abs() < 1e-9 && low == -high);
            normal_tolerance_factor(12, 0.975, 0.975).expect("a factor")
        });
        let mean = errors.iter().sum::<f64>() / 12.0;
        let variance = errors.iter().map(|error| (error - mean).powi(2)).sum::<f64>() / 11.0;
        [mean - factor * variance.sqrt(), mean + factor * variance.sqrt()]
    }

    #[test]
    fn the_largest_error_bounds_a_share_and_the_next_ones() {
        assert!((share_below_largest(59, 0.95).expect("a share") - 0.95).abs() < 1e-3);
        assert!(share_below_largest(59, 0.95).expect("a share") >= 0.95);
        assert!(share_below_largest(58, 0.95).expect("a share") < 0.95);
        assert_eq!(stays_largest(40, 40), Ok(0.5));
        // Forty errors, then ten: counts how often the ten stay below.
        let mut rng = stream(13, 0, StreamSource::Splits);
        let stays = |_: &usize| {
            let mut largest = |n: usize| (0..n).map(|_| length(&mut rng, [1.0; 3], 0.0)).fold(0.0, f64::max);
            largest(40) > largest(10)
        };
        as_often((0..4000).filter(stays).count() as u64, 0.8, "the next ten");
    }

    #[test]
    fn an_acceptance_states_what_it_can() {
        let errors: Vec<f64> = (1..=40).map(|i| 1e-5 * f64::from(i)).collect();
        let acceptance = accept(&errors, 0.95, 0.95).expect("bounds");
        assert_eq!((acceptance.count, acceptance.needed, acceptance.distribution_free), (40, 59, None));
        assert_eq!(acceptance.largest.seen, 4e-4);
        assert!((acceptance.largest.share_below - 0.05_f64.powf(1.0 / 40.0)).abs() < 1e-15);
        // By hand: the root of 2214e-9 over the 5 % quantile of chi-square with 120 degrees, times that of 7.815.
        let by_hand = (22140.0 * 1e-10 / 95.705 * 7.8147_f64).sqrt();
        assert!((acceptance.isotropic / by_hand - 1.0).abs() < 1e-4, "{}", acceptance.isotropic);
        let more: Vec<f64> = (1..=100).map(|i| 1e-5 * f64::from(i)).collect();
        let acceptance = accept(&more, 0.95, 0.95).expect("bounds");
        assert!(acceptance.distribution_free.is_some_and(|bound| (bound.bound - 9.9e-4).abs() < 1e-18));
        assert_eq!(accept(&[], 0.95, 0.95), Err(ToleranceError::Count { value: 0 }));
        for bad in [f64::NAN, -1.0, f64::INFINITY] {
            let error = accept(&[1.0, bad], 0.95, 0.95).expect_err("refused").to_string();
            assert!(error.contains("held-out error 2 is"), "{error}");
        }
        for bad in [0.0, 1.0, f64::NAN, -0.5] {
            assert!(accept(&errors, bad, 0.95).is_err() && accept(&errors, 0.95, bad).is_err());
        }
        assert!(least_sample(1.0 - 1e-9, 0.95, 1).is_err());
    }
}
