//! What the correction of a drift leaves open, as errors that the readings of a station share.
//!
//! At the sightings next to readings the motion is known up to errors that are joint normal; in between, readings stand on a line between two of these
//! and a Brownian bridge, whose first Karhunen-Loève modes they share as well. What is left of the bridge changes faster than it is read, and stays with each
//! reading by itself.

use std::f64::consts::PI;

use nalgebra::{DMatrix, Dyn, Matrix6, OMatrix, U6, Vector3, Vector6};
use serde::{Deserialize, Serialize};

use super::WalkFrame;
use super::walk::Smoothed;

/// Modes of a bridge that readings share; of its variance 1 - 6/π² Σ 1/k² stays with each reading.
const SHARED: usize = 3;
/// Variance of a factor, relative to the largest, that is not worth a mode.
const NEGLIGIBLE: f64 = 1e-6;

/// Displacement of a reading (m) and its turn (rad), one column an independent standard normal error.
type Modes = OMatrix<f64, U6, Dyn>;

/// Errors that the readings of a station share, because one motion of its tracker was taken off all of them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OpenMotion {
    /// Times of the sightings next to readings, s, ascending.
    knots: Vec<f64>,
    /// L with `L Lᵀ` the covariance of the walk there, of its mean over all sightings, six rows a knot, m.
    spread: DMatrix<f64>,
    /// Variances of the walk, m²/s.
    rates: [f64; 2],
    frame: WalkFrame,
    /// Intervals that hold readings: before the first knot (0), behind the first (1) and so on.
    gaps: Vec<usize>,
    /// First and last of knots and readings, s.
    ends: [f64; 2],
}

/// Where a time is.
struct Place {
    /// The knots about it, with their shares.
    about: [(usize, f64); 2],
    gap: usize,
    /// Since the knot before (until the one behind, where there is none before), over the length of the interval, s.
    part: f64,
    length: f64,
    /// Whether a knot holds it on both sides.
    is_held: bool,
}

impl OpenMotion {
    /// Of readings at finite `times`; `told` is joint at `knots`, near which are these `shares` of all sightings.
    pub(super) fn new(
        told: &Smoothed,
        frame: WalkFrame,
        (knots, shares): (Vec<f64>, Vec<f64>),
        times: &[f64],
    ) -> Self {
        let all = || knots.iter().chain(times).copied();
        let ends = [all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max)];
        let mut gaps: Vec<usize> =
            times.iter().map(|time| knots.partition_point(|knot| knot <= time)).collect();
        gaps.sort_unstable();
        gaps.dedup();
        let spread = factor(about_mean(told.joint.clone(), &shares));
        Self { knots, spread, rates: told.rates, frame, gaps, ends }
    }

    /// Number of errors.
    pub fn modes(&self) -> usize {
        self.spread.ncols() + 6 * SHARED * self.gaps.len()
    }

    fn place(&self, time: f64) -> Place {
        let gap = self.knots.partition_point(|knot| *knot <= time);
        let (before, behind) = (gap.checked_sub(1), (gap < self.knots.len()).then_some(gap));
        match (before, behind) {
            (Some(before), Some(behind)) => {
                let length = self.knots[behind] - self.knots[before];
                let part = (time - self.knots[before]) / length;
                Place { about: [(before, 1.0 - part), (behind, part)], gap, part, length, is_held: true }
            }
            (end, other) => {
                let knot = end.or(other).unwrap_or(0);
                let at = self.knots.get(knot).copied().unwrap_or(time);
                let length = (self.ends[usize::from(end.is_some())] - at).abs();
                let part = if length > 0.0 { (time - at).abs() / length } else { 0.0 };
                Place { about: [(knot, 1.0), (knot, 0.0)], gap, part, length, is_held: false }
            }
        }
    }

    /// What the errors displace a reading by, of a point `seen` (m, in the tracker's frame) at a `time`, s.
    pub fn displacements(&self, time: f64, seen: &Vector3<f64>) -> Modes {
        let place = self.place(time);
        let mut walk = Modes::zeros(self.modes());
        let of_knots = self.spread.ncols();
        for (knot, share) in place.about.into_iter().filter(|(_, share)| *share != 0.0) {
            let mut columns = walk.columns_mut(0, of_knots);
            columns += self.spread.fixed_rows::<6>(6 * knot) * share;
        }
        if let Ok(gap) = self.gaps.binary_search(&place.gap) {
            for (mode, size) in place.modes().into_iter().enumerate() {
                for state in 0..6 {
                    let column = of_knots + 6 * (SHARED * gap + mode) + state;
                    walk[(state, column)] = size * self.rates[state / 3].sqrt();
                }
            }
        }
        self.frame.jacobian(seen) * walk
    }

    /// Covariance of the whole displacement (m) and turn (rad) of such a reading by itself.
    pub fn covariance(&self, time: f64, seen: &Vector3<f64>) -> Matrix6<f64> {
        let shared = self.displacements(time, seen);
        let place = self.place(time);
        let of_modes = place.modes().map(|size| size * size).iter().sum::<f64>();
        let left = (place.variance() - of_modes).max(0.0);
        let jacobian = self.frame.jacobian(seen);
        let own = Matrix6::from_diagonal(&Vector6::from_fn(|state, _| self.rates[state / 3] * left));
        &shared * shared.transpose() + jacobian * own * jacobian.transpose()
    }

    pub(super) fn frame(&self) -> WalkFrame {
        self.frame
    }
}

impl Place {
    /// What the first modes of a walk of unit variance a second are here: of a bridge, or of a walk from the end on.
    fn modes(&self) -> [f64; SHARED] {
        std::array::from_fn(|mode| {
            let order = PI * (mode as f64 + if self.is_held { 1.0 } else { 0.5 });
            (2.0 * self.length).sqrt() / order * (order * self.part).sin()
        })
    }

    /// Variance of the whole, s.
    fn variance(&self) -> f64 {
        self.length * self.part * if self.is_held { 1.0 - self.part } else { 1.0 }
    }
}

/// The covariance of differences from the mean: how far that is off is in the places of the nests.
fn about_mean(mut covariance: DMatrix<f64>, shares: &[f64]) -> DMatrix<f64> {
    for _ in 0..2 {
        let mut mean = DMatrix::zeros(6, covariance.ncols());
        for (knot, share) in shares.iter().enumerate() {
            mean += covariance.rows(6 * knot, 6) * *share;
        }
        for knot in 0..shares.len() {
            let mut rows = covariance.rows_mut(6 * knot, 6);
            rows -= &mean;
        }
        covariance.transpose_mut();
    }
    covariance
}

/// L with `L Lᵀ` a positive semidefinite matrix, but for what is negligible: Cholesky's with the largest of what is left first (N. J. Higham, "Analysis of the
/// Cholesky decomposition of a semi-definite matrix", 1990).
fn factor(mut left: DMatrix<f64>) -> DMatrix<f64> {
    let mut columns = Vec::new();
    let first = left.diagonal().max();
    while columns.len() < left.nrows() {
        let (largest, variance) = left.diagonal().argmax();
        if !(variance > NEGLIGIBLE * first) {
            break;
        }
        let column = left.column(largest) / variance.sqrt();
        left.ger(-1.0, &column, &column, 1.0);
        columns.push(column);
    }
    if columns.is_empty() { DMatrix::zeros(left.nrows(), 0) } else { DMatrix::from_columns(&columns) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modes_and_what_is_left_are_the_whole_variance_of_bridge_and_walk() {
        for is_held in [true, false] {
            let at = |part: f64| Place { about: [(0, 1.0), (0, 0.0)], gap: 0, part, length: 7.0, is_held };
            let cells = 1000;
            let parts = (0..cells).map(|k| (f64::from(k) + 0.5) / f64::from(cells));
            let (mut of_modes, mut whole) = (0.0, 0.0);
            for place in parts.map(at) {
                let squares = place.modes().map(|size| size * size).iter().sum::<f64>();
                assert!(squares <= place.variance() * (1.0 + 1e-12) + 1e-12, "{}", place.part);
                of_modes += squares / f64::from(cells);
                whole += place.variance() / f64::from(cells);
            }
            // Karhunen-Loève: mean variance T/6 and T/2, of which a mode has T / order².
            let order = |mode: usize| PI * (mode as f64 + if is_held { 1.0 } else { 0.5 });
            let expected: f64 = (0..SHARED).map(|mode| 7.0 / order(mode).powi(2)).sum();
            assert!((of_modes / expected - 1.0).abs() < 1e-6, "{of_modes} {expected}");
            assert!((whole / if is_held { 7.0 / 6.0 } else { 3.5 } - 1.0).abs() < 1e-3, "{whole}");
        }
    }

    #[test]
    fn the_factor_of_a_singular_matrix_has_its_rank() {
        let root = DMatrix::from_fn(9, 4, |i, j| (1.3 * ((i + 1) * (j + 2)) as f64).sin());
        let matrix = &root * root.transpose();
        let found = factor(matrix.clone());
        assert_eq!(found.ncols(), 4);
        assert!((&found * found.transpose() - &matrix).amax() < 1e-5 * matrix.amax());
        assert_eq!(factor(DMatrix::zeros(3, 3)).ncols(), 0);
    }
}
