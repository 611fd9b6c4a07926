//! Figures of merit of chosen poses.

use serde::{Deserialize, Serialize};

use super::{Criterion, Observability};

/// Share of a region's poses of the quantile.
const MOST: f64 = 0.95;

/// Standard deviations of predicted positions over a region, each the root of the variances summed over three axes, m.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Root of the mean variance.
    pub rms: f64,
    /// Value that 95 % of the region's poses do not exceed.
    pub quantile_95: f64,
    /// Largest.
    pub largest: f64,
}

impl Spread {
    /// The spread from variances; `None` without any.
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

/// Accuracy of the target's predicted position over a region.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Accuracy {
    /// Due to the parameters: the robot's mean position.
    pub of_parameters: Spread,
    /// Including the machine's noise beside its model, pose by pose.
    pub with_machine: Spread,
    /// Due to the machine's noise alone, which no calibration removes.
    pub of_machine: Spread,
}

/// Figures of chosen poses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DesignFigures {
    /// Number of poses, without those that were measured before.
    pub poses: usize,
    /// `ln det(M)` in scaled parameters.
    pub log_determinant: f64,
    /// Singular values of the rows in scaled parameters, including priors; largest first.
    pub singular_values: Vec<f64>,
    /// Observability indices of these singular values.
    pub observability: Observability,
    /// Standard deviation of every parameter, SI.
    pub sigmas: Vec<f64>,
    /// Accuracy over the region; `None` without a region.
    pub accuracy: Option<Accuracy>,
}

impl DesignFigures {
    /// The value of a criterion, the smaller the better; `None` for a criterion of a region without a region.
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
        // 95 % of twenty values are nineteen.
        let spread = Spread::of((1..=20).map(|i| f64::from(i * i))).expect("some");
        assert_eq!(spread.quantile_95, 19.0);
        assert!(Spread::of(std::iter::empty()).is_none());
    }
}
