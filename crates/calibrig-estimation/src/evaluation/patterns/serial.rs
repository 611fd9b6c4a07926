//! Correlation of neighbouring residuals.

use nalgebra::{DMatrix, DVector};

use super::regression::ProjectedResidual;
use super::{PoseConditions, ResidualSet};
use calibrig_model::statistics::normal_survival;

/// Correlation of the whitened residuals of one pose and the next.
#[derive(Debug, Clone, Copy)]
pub(super) struct SerialCorrelation {
    pub correlation: f64,
    /// Natural logarithm of the two-sided p-value.
    pub ln_p: f64,
}

/// Tests pairs in the order of time. Mean and variance under independence are exact for the residuals of a fit, which the fit itself
/// correlates; the tail is taken as normal.
///
/// Source: J. Durbin, G. S. Watson, "Testing for serial correlation in least squares regression I", Biometrika 37 (1950), 409-428.
pub(super) fn serial_correlation(
    residual: &ProjectedResidual,
    set: &ResidualSet<'_>,
) -> Option<SerialCorrelation> {
    let pairs = neighbours(set.poses);
    if pairs.len() < 2 {
        return None;
    }
    // L couples every coordinate with those of the poses before and after: half of each product.
    let neighbours = |v: &DVector<f64>| {
        let mut sum = DVector::zeros(v.len());
        for (one, other) in &pairs {
            for axis in 0..3 {
                let (a, b) = (3 * one + axis, 3 * other + axis);
                sum[a] += 0.5 * v[b];
                sum[b] += 0.5 * v[a];
            }
        }
        sum
    };
    let ratio = residual.residual().dot(&neighbours(residual.residual())) / residual.sum_of_squares();

    // Traces of M L and (M L)² with M = 1 - Q Qᵀ.
    let coupled: Vec<_> = residual.basis().iter().map(neighbours).collect();
    let k = coupled.len();
    let projected = DMatrix::from_fn(k, k, |i, j| residual.basis()[i].dot(&coupled[j]));
    let trace_of_squares = 1.5 * pairs.len() as f64;
    let first = -projected.trace();
    let second = trace_of_squares - 2.0 * coupled.iter().map(DVector::norm_squared).sum::<f64>()
        + projected.norm_squared();

    let dof = residual.degrees_of_freedom();
    let mean = first / dof;
    let variance = (2.0 * second + first * first) / (dof * (dof + 2.0)) - mean * mean;
    if !(variance > 0.0) {
        return None;
    }
    let z = (ratio - mean) / variance.sqrt();
    let ln_p = (2.0 * normal_survival(z.abs())).ln();
    Some(SerialCorrelation { correlation: ratio - mean, ln_p })
}

/// Pairs of observations of the same target from the same station at one pose and the next, in the order of time. Observations of one
/// pose share its errors, and are not counted as neighbours of each other.
fn neighbours(observations: &[PoseConditions<'_>]) -> Vec<(usize, usize)> {
    let mut order: Vec<usize> = (0..observations.len()).collect();
    order.sort_by(|a, b| observations[*a].time.total_cmp(&observations[*b].time));
    let mut poses: Vec<(u32, Vec<usize>)> = Vec::new();
    for i in order {
        let pose = observations[i].pose;
        match poses.iter().rposition(|(known, _)| *known == pose) {
            Some(place) => poses[place].1.push(i),
            None => poses.push((pose, vec![i])),
        }
    }
    let mut pairs = Vec::new();
    for pair in poses.windows(2) {
        for one in &pair[0].1 {
            let same = |other: &&usize| observations[**other].seen == observations[*one].seen;
            pairs.extend(pair[1].1.iter().find(same).map(|other| (*one, *other)));
        }
    }
    pairs
}
