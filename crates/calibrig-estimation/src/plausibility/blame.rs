//! Which rows are to blame where most of the points lie where the nominal robot puts them.

use super::fit::{Placement, Points};
use super::{FarOff, FewRows};
use crate::identification::scale_of;

/// Observations of a subset that is fitted: more than tracker and one target need.
const SUBSET: usize = 6;
/// Subsets that are tried. With a quarter of the rows in error, one of 60 is free of it but for once in 50,000.
const SUBSETS: usize = 60;
/// Rows whose residuals give the median of a subset's fit.
const JUDGES: usize = 500;
/// A row farther off than this many standard deviations of a coordinate is to blame: what a robot as drawn leaves is not normal.
const FAR: f64 = 10.0;
/// Where Tukey's weight becomes zero, in standard deviations of a coordinate (as of the loss).
const TUKEY: f64 = 5.49;
/// Largest share of rows that can be to blame; beyond it, it is not a few rows.
const FEW: f64 = 0.25;
const PASSES: usize = 12;

/// The robust fit of the points, and the rows that are far off it, farthest first; `None` where it is not a few rows.
///
/// Least median of squares over subsets, then Tukey's weights: P. J. Rousseeuw, "Least median of squares regression", JASA 79 (1984) 871;
/// P. J. Rousseeuw, A. M. Leroy, "Robust Regression and Outlier Detection" (1987), section 5.
pub(super) fn few_rows(points: &Points, start: &Placement) -> Option<FewRows> {
    let n = points.len();
    let fitted = (3 * n - points.freedom()) as f64;
    if points.freedom() == 0 || n <= SUBSET {
        return None;
    }
    let scale = |placement: &Placement| {
        let step = n.div_ceil(JUDGES);
        let mut lengths: Vec<_> =
            (0..n).step_by(step).map(|i| points.residual(placement, i).norm()).collect();
        let fitted = fitted.min(2.0 * lengths.len() as f64);
        scale_of(&mut lengths, fitted)
    };
    let mut best = start.clone();
    let mut least = scale(&best);
    if points.stations == 1 && points.offsets.len() == 1 {
        for subset in 0..SUBSETS {
            let part = points.part(&drawn(subset, n));
            let placed = part.fit(start.clone(), &[1.0; SUBSET]);
            let reached = scale(&placed);
            if reached < least {
                (best, least) = (placed, reached);
            }
        }
    }
    for _ in 0..PASSES {
        let k = TUKEY * least;
        let weight = |i| (1.0 - (points.residual(&best, i).norm() / k).powi(2)).max(0.0).powi(2);
        let weights: Vec<f64> = (0..n).map(weight).collect();
        best = points.fit(best, &weights);
        least = scale(&best).max(f64::MIN_POSITIVE);
    }
    let lengths = points.lengths(&best);
    let is_far = |i: &usize| lengths[*i] > FAR * least;
    let (mut far, near): (Vec<usize>, Vec<usize>) = (0..n).partition(is_far);
    if far.is_empty() || far.len() as f64 > FEW * n as f64 {
        return None;
    }
    far.sort_by(|a, b| lengths[*b].total_cmp(&lengths[*a]));
    let rest = points.part(&near);
    let placed = rest.fit(best.clone(), &vec![1.0; near.len()]);
    let rms_without = rest.rms(&placed)?;
    Some(FewRows {
        rms_without,
        share_without: rest.share(rms_without),
        exchanged: exchanged(points, &placed, &far, FAR * least),
        rows: far
            .iter()
            .map(|&i| FarOff { observation: i, distance: points.residual(&placed, i).norm() })
            .collect(),
    })
}

/// Pairs whose points lie where the other's joints put them.
fn exchanged(points: &Points, placed: &Placement, far: &[usize], near: f64) -> Vec<(usize, usize)> {
    let fits =
        |joints: usize, point: usize| (points.seen[point] - points.predicted(placed, joints)).norm() <= near;
    let mut far = far.to_vec();
    far.sort_unstable();
    let mut pairs = Vec::new();
    for (place, &i) in far.iter().enumerate() {
        pairs.extend(far[place + 1..].iter().filter(|&&j| fits(i, j) && fits(j, i)).map(|&j| (i, j)));
    }
    pairs
}

/// Indices of a subset, spread evenly over the rows: multiples of the golden ratio, which meet no period of a file.
fn drawn(subset: usize, n: usize) -> Vec<usize> {
    const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;
    let mut drawn = Vec::with_capacity(SUBSET);
    let mut turns = GOLDEN.wrapping_mul(1 + 64 * subset as u64);
    while drawn.len() < SUBSET.min(n) {
        let i = usize::try_from(((turns >> 32) * n as u64) >> 32).unwrap_or(0);
        if !drawn.contains(&i) {
            drawn.push(i);
        }
        turns = turns.wrapping_add(GOLDEN);
    }
    drawn
}
