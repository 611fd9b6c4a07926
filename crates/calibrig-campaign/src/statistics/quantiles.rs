//! Exact quantiles of a column of any length, from a few passes over it.

use std::error::Error;

use calibrig_model::statistics::binomial_cdf;
use serde::Serialize;

use super::{Estimated, Interval};

/// Bits of a key that a pass tells apart.
const DIGIT_BITS: u32 = 16;
const DIGITS: usize = 1 << DIGIT_BITS;

/// A quantile with a confidence interval that holds for any continuous distribution.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Quantile {
    /// Which: the share of values below.
    pub share: f64,
    /// Linear between the order statistics; the interval's ends are order statistics, so that it contains the quantile at least as often as its
    /// level says. `None` if there are too few values for that: fewer than 6 for a median at 95 %, than 72 for the 5 % quantile.
    pub estimate: Estimated,
}

/// Quantiles of a column.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Quantiles {
    /// How many values there are.
    pub count: u64,
    /// How many were not finite numbers.
    pub skipped: u64,
    /// As they were asked for; none without values.
    pub quantiles: Vec<Quantile>,
}

/// Why there are no quantiles.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum QuantileError<E: Error + 'static> {
    /// The column could not be read.
    #[error(transparent)]
    Read(E),
    /// The passes saw different values.
    #[error("the values changed while their quantiles were computed")]
    Changed,
    /// Not a valid share.
    #[error("no quantile at the share {share}: it must be between 0 and 1")]
    Share {
        /// As it was given.
        share: f64,
    },
}

/// The quantiles `shares` of a column with their intervals of confidence `level`: exact, without holding the column.
///
/// `visit` passes every value of the column to its argument, and is called four times: each pass resolves 16 more bits of the values, for all
/// quantiles at once. That takes half a megabyte for each of up to four order statistics per quantile. Values that are not finite are skipped.
///
/// ```
/// use calibrig_campaign::statistics::quantiles;
/// use std::convert::Infallible;
///
/// let column = [3.0, 1.0, f64::NAN, 2.0, 5.0, 4.0];
/// let visit = |take: &mut dyn FnMut(f64)| Ok::<_, Infallible>(column.iter().for_each(|v| take(*v)));
/// let found = quantiles(visit, &[0.5, 0.05], 0.95)?;
/// assert_eq!((found.count, found.skipped), (5, 1));
/// assert_eq!((found.quantiles[0].estimate.value, found.quantiles[1].estimate.value), (3.0, 1.2));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn quantiles<E: Error + 'static>(
    mut visit: impl FnMut(&mut dyn FnMut(f64)) -> Result<(), E>,
    shares: &[f64],
    level: f64,
) -> Result<Quantiles, QuantileError<E>> {
    if let Some(share) = shares.iter().copied().find(|share| !(0.0..=1.0).contains(share)) {
        return Err(QuantileError::Share { share });
    }
    let (first, skipped) = Pass::over(&mut visit, 0, vec![0])?;
    let count = first.counts.iter().sum();
    if count == 0 {
        return Ok(Quantiles { count, skipped, quantiles: Vec::new() });
    }
    let wanted: Vec<Ranks> = shares.iter().map(|share| Ranks::of(*share, count, level)).collect();
    let found = OrderStatistics::find(&mut visit, first, skipped, wanted.iter().flat_map(Ranks::all))?;
    let quantiles =
        shares.iter().zip(&wanted).map(|(share, r)| Quantile { share: *share, estimate: r.estimate(&found) });
    Ok(Quantiles { count, skipped, quantiles: quantiles.collect() })
}

/// The quantile `share` of values in their order: linear between them. `None` without values or for a share that is not between 0 and 1.
pub fn quantile_of_sorted(sorted: &[f64], share: f64) -> Option<f64> {
    if sorted.is_empty() || !(0.0..=1.0).contains(&share) {
        return None;
    }
    let (below, part) = place(share, sorted.len() as u64);
    let below = usize::try_from(below).ok()?;
    let low = *sorted.get(below)?;
    Some(between(low, sorted.get(below + 1).copied().unwrap_or(low), part))
}

/// Rank, from zero, of the order statistic below a quantile, and the quantile's position between it and the next.
fn place(share: f64, count: u64) -> (u64, f64) {
    let place = share * count.saturating_sub(1) as f64;
    // Not negative, and far below 2^52.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let below = place.floor() as u64;
    (below, place - below as f64)
}

fn between(low: f64, high: f64, part: f64) -> f64 {
    low + part * (high - low)
}

/// The order statistics that determine a quantile and its interval, from zero.
struct Ranks {
    below: u64,
    above: u64,
    part: f64,
    interval: Option<(u64, u64)>,
}

impl Ranks {
    fn of(share: f64, count: u64, level: f64) -> Self {
        let (below, part) = place(share, count);
        Self { below, above: (below + 1).min(count - 1), part, interval: interval_ranks(share, count, level) }
    }

    fn all(&self) -> impl Iterator<Item = u64> {
        let ends = self.interval.into_iter().flat_map(|(low, high)| [low, high]);
        [self.below, self.above].into_iter().chain(ends)
    }

    fn estimate(&self, found: &OrderStatistics) -> Estimated {
        let value = between(found.at(self.below), found.at(self.above), self.part);
        let interval = self.interval.map(|(low, high)| Interval { low: found.at(low), high: found.at(high) });
        Estimated { value, interval }
    }
}

/// Ranks, from zero, between whose values the quantile lies with probability `level` at least, with half of the rest at most on either side. The number
/// of values below the quantile is binomial.
///
/// Source: H. A. David, H. N. Nagaraja, "Order Statistics", 3rd ed. (2003), section 7.1.
fn interval_ranks(share: f64, count: u64, level: f64) -> Option<(u64, u64)> {
    let tail = 0.5 * (1.0 - level);
    // At most `tail` that at most `low` values are below the quantile, so that the value of rank `low` is not.
    let low = first(count, |hits| binomial_cdf(hits, count, share) > tail)?.checked_sub(1)?;
    let high = first(count, |hits| binomial_cdf(hits, count, share) >= 1.0 - tail)?;
    Some((low, high))
}

/// The first number below `count` from which on `holds` does; `None` without one.
fn first(count: u64, holds: impl Fn(u64) -> bool) -> Option<u64> {
    let (mut low, mut high) = (0, count);
    while low < high {
        let middle = low.midpoint(high);
        if holds(middle) {
            high = middle;
        } else {
            low = middle + 1;
        }
    }
    (low < count).then_some(low)
}

/// A number that is ordered as the values are.
fn key(value: f64) -> u64 {
    let bits = value.to_bits();
    if bits >> 63 == 1 { !bits } else { bits | 1 << 63 }
}

/// The value of a key.
fn value(key: u64) -> f64 {
    f64::from_bits(if key >> 63 == 1 { key & !(1 << 63) } else { !key })
}

/// How many values there are with each next digit after known leading digits.
struct Pass {
    /// How many digits are known.
    known: u32,
    /// The known digits, in order.
    prefixes: Vec<u64>,
    /// Digit by digit, prefix by prefix.
    counts: Vec<u64>,
}

impl Pass {
    /// With the number of values that were skipped.
    fn over<E: Error + 'static>(
        visit: &mut impl FnMut(&mut dyn FnMut(f64)) -> Result<(), E>,
        known: u32,
        prefixes: Vec<u64>,
    ) -> Result<(Self, u64), QuantileError<E>> {
        let mut pass = Self { known, counts: vec![0; prefixes.len() * DIGITS], prefixes };
        let mut skipped = 0;
        visit(&mut |value| {
            if value.is_finite() {
                pass.count(key(value));
            } else {
                skipped += 1;
            }
        })
        .map_err(QuantileError::Read)?;
        Ok((pass, skipped))
    }

    fn count(&mut self, key: u64) {
        let rest = u64::BITS - DIGIT_BITS * (self.known + 1);
        let digits = key >> rest;
        if let Ok(prefix) = self.prefixes.binary_search(&(digits >> DIGIT_BITS)) {
            self.counts[prefix * DIGITS + digit(digits)] += 1;
        }
    }

    /// The result of one more digit of the value of `rank`, among those that share the known digits: the digits, and the rank among those that share
    /// them all. `None` if there are fewer values.
    fn narrow(&self, digits: u64, mut rank: u64) -> Option<(u64, u64)> {
        let prefix = self.prefixes.binary_search(&digits).ok()?;
        for (next, count) in (0..).zip(&self.counts[prefix * DIGITS..(prefix + 1) * DIGITS]) {
            if rank < *count {
                return Some((digits << DIGIT_BITS | next, rank));
            }
            rank -= count;
        }
        None
    }
}

/// The last digit.
fn digit(digits: u64) -> usize {
    // What is cut off are the digits before it.
    #[allow(clippy::cast_possible_truncation)]
    let last = digits as u16;
    usize::from(last)
}

/// Values by their ranks, in the order of the ranks.
struct OrderStatistics(Vec<(u64, f64)>);

impl OrderStatistics {
    /// Those of `ranks`, from the first pass and three more.
    fn find<E: Error + 'static>(
        visit: &mut impl FnMut(&mut dyn FnMut(f64)) -> Result<(), E>,
        first: Pass,
        skipped: u64,
        ranks: impl Iterator<Item = u64>,
    ) -> Result<Self, QuantileError<E>> {
        let mut ranks: Vec<u64> = ranks.collect();
        ranks.sort_unstable();
        ranks.dedup();
        // Known digits of every rank's value, and its rank among the values that share them.
        let mut places: Vec<(u64, u64)> = ranks.iter().map(|rank| (0, *rank)).collect();
        let mut pass = first;
        loop {
            places = narrow_all(&pass, &places).ok_or(QuantileError::Changed)?;
            if pass.known + 1 == u64::BITS / DIGIT_BITS {
                let values = places.into_iter().map(|(digits, _)| value(digits));
                return Ok(Self(ranks.into_iter().zip(values).collect()));
            }
            let mut prefixes: Vec<u64> = places.iter().map(|(digits, _)| *digits).collect();
            prefixes.dedup();
            let (next, skipped_now) = Pass::over(visit, pass.known + 1, prefixes)?;
            if skipped_now != skipped || !next.refines(&pass) {
                return Err(QuantileError::Changed);
            }
            pass = next;
        }
    }

    /// The value of a rank that was looked for.
    fn at(&self, rank: u64) -> f64 {
        self.0.binary_search_by_key(&rank, |(rank, _)| *rank).map_or(f64::NAN, |place| self.0[place].1)
    }
}

fn narrow_all(pass: &Pass, places: &[(u64, u64)]) -> Option<Vec<(u64, u64)>> {
    places.iter().map(|(digits, rank)| pass.narrow(*digits, *rank)).collect()
}

impl Pass {
    /// Whether this pass found as many values with every prefix as the one before.
    fn refines(&self, before: &Self) -> bool {
        let mut counts = self.prefixes.iter().zip(self.counts.chunks_exact(DIGITS));
        counts.all(|(prefix, counts)| {
            let place = before.prefixes.binary_search(&(prefix >> DIGIT_BITS));
            place.is_ok_and(|place| {
                before.counts[place * DIGITS + digit(*prefix)] == counts.iter().sum::<u64>()
            })
        })
    }
}

#[cfg(test)]
#[allow(clippy::cast_possible_truncation)]
mod tests {
    use super::*;
    use crate::statistics::tests::{assert_covers, uniform};
    use proptest::prelude::*;
    use std::convert::Infallible;

    fn of(values: &[f64], shares: &[f64]) -> Quantiles {
        let visit = |take: &mut dyn FnMut(f64)| {
            for value in values {
                take(*value);
            }
            Ok::<_, Infallible>(())
        };
        quantiles(visit, shares, 0.95).expect("nothing to fail")
    }

    #[test]
    fn keys_are_ordered_as_values_and_lead_back() {
        let tiny = f64::from_bits(1);
        let ordered = [f64::MIN, -1.5, -1.0, -tiny, -0.0, 0.0, tiny, 1.0, 1.5, f64::MAX];
        assert!(ordered.windows(2).all(|pair| key(pair[0]) < key(pair[1])));
        assert!(ordered.iter().all(|v| value(key(*v)).to_bits() == v.to_bits()));
    }

    proptest! {
        #[test]
        fn quantiles_are_those_of_the_sorted_values(
            mut values in prop::collection::vec(prop_oneof![any::<f64>(), -2.0..2.0, Just(1.0), Just(-0.0)], 0..80),
            share in 0.0..=1.0,
        ) {
            let found = of(&values, &[share, 0.5, 0.0, 1.0, 0.5]);
            values.retain(|v| v.is_finite());
            values.sort_by(f64::total_cmp);
            prop_assert_eq!(found.count, values.len() as u64);
            prop_assert_eq!(found.quantiles.len(), if values.is_empty() { 0 } else { 5 });
            for q in &found.quantiles {
                let expected = quantile_of_sorted(&values, q.share).expect("values");
                prop_assert_eq!(q.estimate.value.to_bits(), expected.to_bits());
                let Some((low, high)) = interval_ranks(q.share, values.len() as u64, 0.95) else { continue };
                let ends = Interval { low: values[low as usize], high: values[high as usize] };
                prop_assert_eq!(q.estimate.interval, Some(ends));
            }
        }
    }

    /// A value in a million, all within a millionth of each other: the last digits decide.
    #[test]
    fn values_that_hardly_differ_are_told_apart() {
        let values: Vec<f64> = uniform(3, 0, 100_000).map(|u| 1.0 + 1e-12 * u).collect();
        let mut sorted = values.clone();
        sorted.sort_by(f64::total_cmp);
        for q in of(&values, &[0.001, 0.05, 0.5, 0.95, 0.999]).quantiles {
            assert_eq!(Some(q.estimate.value), quantile_of_sorted(&sorted, q.share));
            assert!(q.estimate.interval.expect("many").contains(q.estimate.value));
        }
    }

    /// Published ranks (from one) of 95 % intervals of the median: W. J. Conover, "Practical Nonparametric Statistics", 3rd ed. (1999), table A3; for 6, 10
    /// and 20 values the first and last, the second and ninth, the sixth and fifteenth.
    #[test]
    fn ranks_of_intervals_are_the_published_ones() {
        for (count, low, high) in [(6, 1, 6), (10, 2, 9), (20, 6, 15)] {
            assert_eq!(interval_ranks(0.5, count, 0.95), Some((low - 1, high - 1)), "{count}");
        }
        assert_eq!(interval_ranks(0.5, 5, 0.95), None);
        // 0.95^n is below 0.025 from 72 on.
        assert_eq!(interval_ranks(0.05, 71, 0.95), None);
        assert_eq!(interval_ranks(0.05, 72, 0.95).map(|(low, _)| low), Some(0));
        assert_eq!(interval_ranks(0.95, 72, 0.95).map(|(_, high)| high), Some(71));
        assert_eq!((interval_ranks(0.0, 1000, 0.95), interval_ranks(1.0, 1000, 0.95)), (None, None));
    }

    #[test]
    fn the_interval_of_a_quantile_covers_it() {
        for share in [0.1, 0.5, 0.95] {
            assert_covers(500, 0.95, |replicate| {
                let values: Vec<f64> = uniform(41, replicate, 150).collect();
                of(&values, &[share]).quantiles[0].estimate.interval.map(|i| i.contains(share))
            });
        }
    }

    #[test]
    fn what_cannot_be_read_or_changes_is_an_error() {
        let failing = |_: &mut dyn FnMut(f64)| Err(std::fmt::Error);
        assert_eq!(quantiles(failing, &[0.5], 0.95), Err(QuantileError::Read(std::fmt::Error)));
        let mut passes = 0.0;
        let changing = |take: &mut dyn FnMut(f64)| {
            passes += 1.0;
            take(passes);
            Ok::<_, Infallible>(())
        };
        assert_eq!(quantiles(changing, &[0.5], 0.95), Err(QuantileError::Changed));
        let mut passes = 0;
        let emptied = |take: &mut dyn FnMut(f64)| {
            passes += 1;
            (passes..4).for_each(|_| take(1.0));
            Ok::<_, Infallible>(())
        };
        assert_eq!(quantiles(emptied, &[0.5], 0.95), Err(QuantileError::Changed));
        let visit = |_: &mut dyn FnMut(f64)| Ok::<_, Infallible>(());
        let error = quantiles(visit, &[0.5, 95.0], 0.95).expect_err("a share above one").to_string();
        assert_eq!(error, "no quantile at the share 95: it must be between 0 and 1");
        assert!(quantiles(visit, &[f64::NAN], 0.95).is_err());
        assert_eq!((quantile_of_sorted(&[], 0.5), quantile_of_sorted(&[1.0], 2.0)), (None, None));
    }
}
