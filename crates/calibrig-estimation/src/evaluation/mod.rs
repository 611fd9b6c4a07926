//! How good an estimate is: accuracy, consistency with what was stated, and which of two models is better.

pub mod closed_loop;
mod comparison;
mod consistency;
mod criteria;
pub mod iso9283;
mod model_choice;
mod nested;
mod outcome;
mod patterns;
mod scatter;
mod splits;
mod tolerance;

pub use comparison::{Interval, paired_rms_difference, resampled_difference};
pub use consistency::{
    ChiSquareTest, ConsistencyReport, Coverage, check_consistency, chi2_band, mean_nees_band, nees,
};
pub use criteria::{Criteria, Fit, NoiseLevel};
pub use model_choice::{Variant, VariantRow, Verdict, compare_variants};
pub use nested::{NestedFits, paired_by_pose};
pub use outcome::{ModeOutcome, RegistrationSummary};
pub use patterns::{Cause, PatternReport, PoseConditions, ResidualPattern, ResidualSet, find_patterns};
pub use scatter::{REPEATS_LEVEL, RepeatScatter, ScatterComparison, compare_scatter};
use serde::{Deserialize, Serialize};
pub use splits::{Split, k_fold, leave_one_out, repeated_splits};
pub use tolerance::{
    Acceptance, LargestError, OrderBound, ToleranceError, accept, isotropic_bound, least_sample,
    normal_interval, normal_tolerance_factor, quantile_bound, share_below_largest, stays_largest,
};

use nalgebra::Vector3;

/// One row of an accuracy table: errors at the target over a set of poses, in the base frame, m.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AccuracyRow {
    /// Largest absolute error per axis, as published.
    pub max: Vector3<f64>,
    /// Mean absolute error per axis, as published.
    pub mean: Vector3<f64>,
    /// Mean signed error per axis.
    pub bias: Vector3<f64>,
    /// Root mean square of the 3-D error.
    pub rms_3d: f64,
    /// Largest 3-D error.
    pub max_3d: f64,
    /// Number of observations.
    pub count: usize,
}

/// The row of `errors` (measured minus predicted, m); `None` without errors.
pub fn accuracy(errors: &[Vector3<f64>]) -> Option<AccuracyRow> {
    if errors.is_empty() {
        return None;
    }
    let n = errors.len() as f64;
    let mut max = Vector3::zeros();
    for error in errors {
        max = error.abs().sup(&max);
    }
    Some(AccuracyRow {
        max,
        mean: errors.iter().map(Vector3::abs).sum::<Vector3<f64>>() / n,
        bias: errors.iter().sum::<Vector3<f64>>() / n,
        rms_3d: (errors.iter().map(Vector3::norm_squared).sum::<f64>() / n).sqrt(),
        max_3d: errors.iter().map(Vector3::norm).fold(0.0, f64::max),
        count: errors.len(),
    })
}

/// One row of a table of orientation errors, rad.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct OrientationRow {
    /// Root mean square of the angle between measured and predicted orientation.
    pub rms: f64,
    /// Largest such angle.
    pub max: f64,
    /// Number of orientations.
    pub count: usize,
}

/// The row of `turns` (rotation vectors of measured against predicted, rad); `None` where no reading has an orientation.
pub fn orientation_accuracy(turns: &[Option<Vector3<f64>>]) -> Option<OrientationRow> {
    let angles: Vec<f64> = turns.iter().flatten().map(Vector3::norm).collect();
    let squares: f64 = angles.iter().map(|angle| angle * angle).sum();
    (!angles.is_empty()).then(|| OrientationRow {
        rms: (squares / angles.len() as f64).sqrt(),
        max: angles.iter().copied().fold(0.0, f64::max),
        count: angles.len(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_of_orientations_by_hand() {
        let turns = [Some(Vector3::new(0.0, 3e-3, 4e-3)), None, Some(Vector3::new(-1e-3, 0.0, 0.0))];
        let row = orientation_accuracy(&turns).expect("two orientations");
        assert!((row.rms - 13e-6_f64.sqrt()).abs() < 1e-15 && (row.max - 5e-3).abs() < 1e-15);
        assert_eq!(row.count, 2);
        assert!(orientation_accuracy(&[None, None]).is_none());
    }

    #[test]
    fn a_row_by_hand() {
        let errors = [Vector3::new(3.0, -4.0, 0.0), Vector3::new(-1.0, 0.0, 2.0)];
        let row = accuracy(&errors).expect("two errors");
        assert_eq!(row.max, Vector3::new(3.0, 4.0, 2.0));
        assert_eq!(row.mean, Vector3::new(2.0, 2.0, 1.0));
        assert_eq!(row.bias, Vector3::new(1.0, -2.0, 1.0));
        assert!((row.rms_3d - (15.0_f64).sqrt()).abs() < 1e-15);
        assert!((row.max_3d - 5.0).abs() < 1e-15);
        assert!(accuracy(&[]).is_none());
    }
}
