//! How good chosen poses are.

use serde::{Deserialize, Serialize};

use super::{Criterion, Observability};

/// Share of the poses of a region that a quantile is of.
const MOST: f64 = 0.95;

/// Standard deviations of predicted places over a region, each the root of the variances of three axes in sum, m.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Root of the mean variance.
    pub rms: f64,
    /// What 95 % of the region's poses stay below (or at).
    pub quantile_95: f64,
    /// Largest.
    pub largest: f64,
}

impl Spread {
    /// Of the variances; `None` without any.
    pub(super) fn of(variances: impl Iterator<Item = f64>) -> Option<Self> {
        let mut sorted: Vec<f64> = variances.collect();
        sorted.sort_by(f64::total_cmp);
        let n = sorted.len();
        let largest = sorted.last()?.sqrt();
        let place = (1..=n).find(|place| *place as f64 >= MOST * n as f64).unwrap_or(n);
        Some(Self {
            mean: sorted.iter().map(|v| v.sqrt()).sum::<f64>() / n as f64,
            rms: (sorted.iter().sum::<f64>() / n as f64).sqrt(),
            quantile_95: sorted[place - 1].sqrt(),
            largest,
        })
    }
}

/// How well the target's place is predicted over a region.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Accuracy {
    /// What the parameters leave open: the robot's mean place.
    pub of_parameters: Spread,
    /// With what the machine does beside its model, pose by pose.
    pub with_machine: Spread,
    /// That alone, which no calibration takes away.
    pub of_machine: Spread,
}

/// What chosen poses tell.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DesignFigures {
    /// How many, those that were measured before aside.
    pub poses: usize,
    /// `ln det(M)` in scaled parameters.
    pub log_determinant: f64,
    /// Of the rows in scaled parameters, priors among them; largest first.
    pub singular_values: Vec<f64>,
    /// The indices of these.
    pub observability: Observability,
    /// Standard deviation of every parameter, SI.
    pub sigmas: Vec<f64>,
    /// Over the region; `None` without one.
    pub accuracy: Option<Accuracy>,
}

impl DesignFigures {
    /// The value of a criterion, the smaller the better; `None` for one of a region without one.
    pub fn value(&self, criterion: Criterion) -> Option<f64> {
        let spread = self.accuracy.map(|accuracy| accuracy.of_parameters);
        match criterion {
            Criterion::G => spread.map(|spread| spread.largest.powi(2)),
            Criterion::I => spread.map(|spread| spread.rms.powi(2)),
            Criterion::D => Some(-self.log_determinant / self.singular_values.len().max(1) as f64),
            _ => {
                let eigenvalues: Vec<f64> = self.singular_values.iter().map(|s| s * s).collect();
                Some(criterion.of_eigenvalues(&eigenvalues, self.poses))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spread_by_hand() {
        let spread = Spread::of([4.0, 1.0, 9.0, 0.0].into_iter()).expect("some");
        assert_eq!((spread.mean, spread.largest, spread.quantile_95), (1.5, 3.0, 3.0));
        assert!((spread.rms - 3.5_f64.sqrt()).abs() < 1e-15);
        // Of twenty values 95 % are nineteen.
        let spread = Spread::of((1..=20).map(|i| f64::from(i * i))).expect("some");
        assert_eq!(spread.quantile_95, 19.0);
        assert!(Spread::of(std::iter::empty()).is_none());
    }
}
