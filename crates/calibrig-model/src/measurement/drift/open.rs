//! The remaining uncertainty of a drift correction, as errors that the readings of a station share.

use nalgebra::{DMatrix, Matrix6, Vector3, Vector6};
use serde::{Deserialize, Serialize};

use super::WalkFrame;
use super::random_walk::{Rates, Smoothed};

/// Errors that the readings of a station share, because one motion of its tracker was removed from all of them: joint normal at the sightings of
/// nests next to readings; between two of these, readings lie on a line plus a Brownian bridge, before the first and after the last on a random walk.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OpenMotion {
    /// Times of the sightings next to readings, s, ascending.
    knots: Vec<f64>,
    /// Covariance of the walk there, about its mean over all sightings, six rows per knot, m².
    covariance: DMatrix<f64>,
    /// Variances of the walk, m²/s.
    rates: Rates,
    frame: WalkFrame,
}

/// Place of a time among the knots.
struct Place {
    /// The knots around it, with their weights.
    about: [(usize, f64); 2],
    /// Number of knots that are not after it.
    gap: usize,
    time: f64,
}

impl OpenMotion {
    /// `told` is joint at `knots`.
    pub(super) fn new(told: &Smoothed, frame: WalkFrame, knots: Vec<f64>) -> Self {
        Self { knots, covariance: told.joint.clone(), rates: told.rates, frame }
    }

    pub(super) fn frame(&self) -> WalkFrame {
        self.frame
    }

    /// Covariance of the errors of two readings, each of a point seen at a time (s) at a place (m, in the tracker's frame): rows are the displacement
    /// (m) and the turn (rad) of the first, columns those of the second.
    pub fn covariance(&self, first: (f64, &Vector3<f64>), second: (f64, &Vector3<f64>)) -> Matrix6<f64> {
        let (a, b) = (self.place(first.0), self.place(second.0));
        let mut walk = Matrix6::zeros();
        for (knot, share) in a.about {
            for (other, of_other) in b.about {
                if share * of_other != 0.0 {
                    walk += self.covariance.fixed_view::<6, 6>(6 * knot, 6 * other) * (share * of_other);
                }
            }
        }
        let since = self.since(&a, &b);
        walk += Matrix6::from_diagonal(&Vector6::from_fn(|state, _| self.rates[state / 3] * since));
        self.frame.jacobian(first.1) * walk * self.frame.jacobian(second.1).transpose()
    }

    fn place(&self, time: f64) -> Place {
        let gap = self.knots.partition_point(|knot| *knot <= time);
        let about = match gap.checked_sub(1).zip((gap < self.knots.len()).then_some(gap)) {
            Some((before, behind)) => {
                let part = (time - self.knots[before]) / (self.knots[behind] - self.knots[before]);
                [(before, 1.0 - part), (behind, part)]
            }
            None if self.knots.is_empty() => [(0, 0.0); 2],
            None => [(gap.saturating_sub(1), 1.0), (0, 0.0)],
        };
        Place { about, gap, time }
    }

    /// Covariance at two times of a walk of unit variance a second that the knots hold, s.
    fn since(&self, a: &Place, b: &Place) -> f64 {
        if a.gap != b.gap {
            return 0.0;
        }
        let (early, late) = (a.time.min(b.time), a.time.max(b.time));
        match (a.gap.checked_sub(1).map(|before| self.knots[before]), self.knots.get(a.gap)) {
            (Some(before), Some(behind)) => (early - before) * (behind - late) / (behind - before),
            (Some(last), None) => early - last,
            (None, Some(first)) => first - late,
            (None, None) => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against walks that are drawn step by step and pinned at the knots.
    #[test]
    fn between_knots_and_beyond_them_is_a_walk_that_they_hold() {
        let frame = WalkFrame { centre: Vector3::zeros(), radius: 1.0 };
        let knots = vec![2.0, 6.0];
        let motion = OpenMotion { covariance: DMatrix::zeros(12, 12), knots, rates: [1.0, 0.0], frame };
        let at = |a: f64, b: f64| motion.covariance((a, &Vector3::zeros()), (b, &Vector3::zeros()))[(0, 0)];
        // A walk w from 2 on, known at 2 and 6, has Cov(a, b) - Cov(a, 6) Cov(6, b) / Cov(6, 6) with Cov(a, b) = min(a, b) - 2.
        let walk = |a: f64, b: f64| a.min(b) - 2.0;
        for (a, b) in [(3.0, 3.0), (3.0, 5.5), (5.0, 2.5)] {
            assert!((at(a, b) - (walk(a, b) - walk(a, 6.0) * walk(6.0, b) / walk(6.0, 6.0))).abs() < 1e-12);
        }
        assert_eq!([at(7.0, 9.0), at(1.5, 0.5), at(3.0, 7.0), at(1.0, 8.0)], [1.0, 0.5, 0.0, 0.0]);
    }
}
