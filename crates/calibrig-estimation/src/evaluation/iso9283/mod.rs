//! Pose accuracy (AP) and pose repeatability (RP) of ISO 9283, with their uncertainty for the number of cycles.
//!
//! The formulas are those of ISO 9283:1998, 7.2.1 and 7.2.2, with n cycles at a commanded pose c and attained poses p(1) .. p(n):
//!
//! - barycentre m = mean of p; `AP_P = |m - c|`, `AP_x = m_x - c_x` and so on;
//! - l(j) = |p(j) - m|; `RP_l = mean(l) + 3 S_l`, with `S_l` the standard deviation of l (n - 1);
//! - for the orientation's angles a, b, c: `AP_a = mean(a) - a_c`, `RP_a = 3 S_a`.
//!
//! The text of the standard was not available: formulas, the [cube](TestCube) and the order of a cycle are as commonly quoted. Payload, speed
//! and warm-up, which the standard prescribes as well, are up to whoever measures. Two things are our own:
//!
//! - a, b and c are here the components of the small rotation between two orientations along the axes x, y and z of the frame in which the
//!   measurements are given. They differ from differences of roll, pitch and yaw by products of small angles, and have no singular pose;
//! - the intervals, which the standard does not ask for: those of RP are for normal scatter of any shape, drawn from what was observed; for
//!   few cycles they are wider than necessary, since the shape is uncertain, too.

mod cube;
mod cycles;
mod orientation;
#[cfg(test)]
mod tests;

pub use cube::{CubePlane, TestCube};
pub use cycles::{Iso9283Error, TestPose, test_poses};
pub use orientation::{mean_rotation, turn_of_points, turns_about};

use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

use super::chi2_band;
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::statistics::{chi2_quantile, f_ln_survival, student_t_quantile};

/// Number of cycles that the standard asks for.
pub const ISO_CYCLES: usize = 30;
/// Fewest cycles for RP. Two points are equally far from their barycentre, so that `S_l` is zero however much the machine scatters.
pub const LEAST_CYCLES: usize = 3;
/// Number of poses that the standard asks for.
pub const ISO_POSES: usize = 5;
/// Confidence of all intervals here.
pub const ISO_LEVEL: f64 = 0.95;
/// Number of draws for an interval of RP: with other draws its ends move by some per cent of its width.
const DRAWS: usize = 1000;

/// Distance of the barycentre of the attained positions from the commanded position, m.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PositionAccuracy {
    /// Number of cycles.
    pub cycles: usize,
    /// `AP_x`, `AP_y`, `AP_z`: attained minus commanded.
    pub error: Vector3<f64>,
    /// Half the width of the 95 % interval of each (Student's t).
    pub half_width: Vector3<f64>,
    /// `AP_P`, the length of `error`.
    pub distance: f64,
    /// Radius about the barycentre that holds the barycentre of infinitely many cycles with 95 %. `distance` is off by no more, and mostly by less.
    /// What all cycles have in common, such as the tracker's place, is not included.
    pub radius: f64,
}

/// Scatter of attained positions about their barycentre, m.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PositionRepeatability {
    /// Number of cycles.
    pub cycles: usize,
    /// Mean distance from the barycentre.
    pub mean_distance: f64,
    /// Standard deviation of the distances, `S_l`.
    pub distance_sigma: f64,
    /// `RP_l`.
    pub repeatability: f64,
    /// 95 % interval of `RP_l` for infinitely many cycles, for normal scatter of the observed shape.
    pub interval: [f64; 2],
    /// Standard deviation along each axis.
    pub axis_sigma: Vector3<f64>,
    /// Effective number of directions of the scatter: 1 along a line, 3 for the same in all directions; 0 without scatter.
    pub directions: f64,
}

/// Scatter of all poses of a target against what its readings alone are stated to scatter by.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ScatterOverStated {
    /// Sum of the poses' observed variances over the sum of the stated ones.
    pub ratio: f64,
    /// Band that holds the ratio with 99.9 % if the readings scatter as stated and the machine does not.
    pub band: (f64, f64),
}

/// Angle of the mean orientation from the commanded one, rad.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct OrientationAccuracy {
    /// Number of cycles.
    pub cycles: usize,
    /// `AP_a`, `AP_b`, `AP_c`: about x, y and z.
    pub error: Vector3<f64>,
    /// Half the width of the 95 % interval of each (Student's t).
    pub half_width: Vector3<f64>,
}

/// Scatter of orientations about their mean, rad.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct OrientationRepeatability {
    /// Number of cycles.
    pub cycles: usize,
    /// `RP_a`, `RP_b`, `RP_c`, which the standard writes with a sign ±.
    pub repeatability: Vector3<f64>,
    /// Lower ends of the 95 % intervals (chi-square).
    pub low: Vector3<f64>,
    /// Upper ends of the 95 % intervals.
    pub high: Vector3<f64>,
}

/// Mean and covariance (n - 1) of two or more finite vectors.
fn moments(values: &[Vector3<f64>]) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    if values.len() < 2 || !values.iter().all(|value| value.iter().all(|v| v.is_finite())) {
        return None;
    }
    let n = values.len() as f64;
    let mean = values.iter().sum::<Vector3<f64>>() / n;
    let square = |value: &Vector3<f64>| (value - mean) * (value - mean).transpose();
    Some((mean, values.iter().map(square).sum::<Matrix3<f64>>() / (n - 1.0)))
}

fn half_widths(covariance: &Matrix3<f64>, n: f64) -> Vector3<f64> {
    let t = student_t_quantile(0.5 + 0.5 * ISO_LEVEL, n - 1.0);
    covariance.diagonal().map(|variance| t * (variance / n).sqrt())
}

/// AP of the position from attained minus commanded positions of every cycle at a pose, m; `None` for fewer than two cycles, or if a
/// number is not finite.
///
/// The radius: the squared distance of two barycentres is a sum of squares of normal variables. It is approximated by a chi-square with the
/// same mean and variance (Satterthwaite), and its scale is estimated from the same cycles, which gives an F distribution.
pub fn position_accuracy(errors: &[Vector3<f64>]) -> Option<PositionAccuracy> {
    let (error, covariance) = moments(errors)?;
    let n = errors.len() as f64;
    let trace = covariance.trace();
    let radius = if trace > 0.0 {
        let dof = directions(&covariance);
        (trace / n * f_quantile(ISO_LEVEL, dof, dof * (n - 1.0))).sqrt()
    } else {
        0.0
    };
    Some(PositionAccuracy {
        cycles: errors.len(),
        error,
        half_width: half_widths(&covariance, n),
        distance: error.norm(),
        radius,
    })
}

/// RP of the position from attained positions of every cycle at a pose, in one frame, m; `None` for fewer than [`LEAST_CYCLES`], or if a
/// number is not finite.
pub fn position_repeatability(attained: &[Vector3<f64>]) -> Option<PositionRepeatability> {
    let (mean, covariance) = moments(attained).filter(|_| attained.len() >= LEAST_CYCLES)?;
    let distances: Vec<f64> = attained.iter().map(|p| (p - mean).norm()).collect();
    let (mean_distance, distance_sigma) = mean_and_sigma(&distances);
    let repeatability = mean_distance + 3.0 * distance_sigma;
    let [low, high] = ratio_band(&covariance, attained.len());
    Some(PositionRepeatability {
        cycles: attained.len(),
        mean_distance,
        distance_sigma,
        repeatability,
        interval: [repeatability / high, repeatability / low],
        axis_sigma: covariance.diagonal().map(f64::sqrt),
        directions: directions(&covariance),
    })
}

/// Number of equal directions of a scatter whose squared length has the same relative variance as with this positive semidefinite covariance
/// (Satterthwaite); 0 for a zero covariance.
fn directions(covariance: &Matrix3<f64>) -> f64 {
    let trace = covariance.trace();
    // Of the normalised shape: squares of very small or large numbers are not finite or vanish.
    let shape = covariance / trace;
    if trace > 0.0 { 1.0 / (shape * shape).trace() } else { 0.0 }
}

/// Whether poses scatter by more than their readings state, from RP and the stated standard deviation (root of the mean squared length of a
/// reading's error, m) of each pose. `None` without poses, and where nothing scatters or nothing is stated.
pub fn scatter_over_stated(poses: &[(PositionRepeatability, f64)]) -> Option<ScatterOverStated> {
    let (mut seen, mut stated, mut square) = (0.0, 0.0, 0.0);
    for (rp, sigma) in poses.iter().filter(|(rp, _)| rp.directions > 0.0) {
        let variance = rp.axis_sigma.norm_squared();
        seen += variance;
        stated += sigma * sigma;
        square += variance * variance / (rp.directions * (rp.cycles as f64 - 1.0));
    }
    let (ratio, dof) = (seen / stated, seen * seen / square);
    let is_told = ratio.is_finite() && dof.is_finite() && dof > 0.0;
    is_told.then(|| ScatterOverStated { ratio, band: chi2_band(dof, 0.999) })
}

/// AP of the orientation from the rotation between commanded and attained orientation of every cycle (rotation vectors, rad); `None` as in
/// [`position_accuracy`].
pub fn orientation_accuracy(turns: &[Vector3<f64>]) -> Option<OrientationAccuracy> {
    let (error, covariance) = moments(turns)?;
    let n = turns.len() as f64;
    Some(OrientationAccuracy { cycles: turns.len(), error, half_width: half_widths(&covariance, n) })
}

/// RP of the orientation from rotations about any common orientation (rotation vectors, rad), such as their [mean](mean_rotation); `None` as in
/// [`position_accuracy`].
pub fn orientation_repeatability(turns: &[Vector3<f64>]) -> Option<OrientationRepeatability> {
    let (_, covariance) = moments(turns)?;
    let dof = turns.len() as f64 - 1.0;
    let repeatability = covariance.diagonal().map(|variance| 3.0 * variance.sqrt());
    let at = |p: f64| repeatability * (dof / chi2_quantile(p, dof)).sqrt();
    Some(OrientationRepeatability {
        cycles: turns.len(),
        repeatability,
        low: at(0.5 + 0.5 * ISO_LEVEL),
        high: at(0.5 - 0.5 * ISO_LEVEL),
    })
}

fn mean_and_sigma(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (mean, (squares / (n - 1.0)).sqrt())
}

/// Factors on RP of infinitely many cycles between which RP of `cycles` lies with 95 %, for normal scatter with a covariance of this shape.
/// The ratio does not depend on the size of the scatter, so that it can be turned into an interval. It is drawn from its own random stream: the
/// same for the same cycles, whatever else is drawn.
fn ratio_band(covariance: &Matrix3<f64>, cycles: usize) -> [f64; 2] {
    let scale = covariance.trace();
    if !(scale > 0.0) {
        return [1.0, 1.0];
    }
    // For cycles on one line or plane the covariance is singular, and a Cholesky factorisation may fail.
    let eigen = SymmetricEigen::new(covariance / scale);
    let sigmas = eigen.eigenvalues.map(|value| value.max(0.0).sqrt());
    let mut rng = stream(0, 0, StreamSource::Iso9283Intervals);
    let mut ratios = Vec::with_capacity(DRAWS);
    let (mut sum, mut squares) = (0.0, 0.0);
    let mut drawn = vec![Vector3::zeros(); cycles];
    let mut distances = vec![0.0; cycles];
    for _ in 0..DRAWS {
        for point in &mut drawn {
            *point = normal(&mut rng).component_mul(&sigmas);
            let distance = point.norm();
            sum += distance;
            squares += distance * distance;
        }
        let mean = drawn.iter().sum::<Vector3<f64>>() / cycles as f64;
        for (distance, point) in distances.iter_mut().zip(&drawn) {
            *distance = (point - mean).norm();
        }
        let (mean, sigma) = mean_and_sigma(&distances);
        ratios.push(mean + 3.0 * sigma);
    }
    let count = (DRAWS * cycles) as f64;
    let mean = sum / count;
    let endless = mean + 3.0 * (squares / count - mean * mean).max(0.0).sqrt();
    ratios.sort_by(f64::total_cmp);
    let tail = DRAWS / 40;
    [ratios[tail] / endless, ratios[DRAWS - 1 - tail] / endless]
}

/// Three independent standard normal numbers (Box and Muller 1958).
fn normal(rng: &mut impl Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| {
        // In (0, 1]: the logarithm is finite.
        let (u, turn) = (1.0 - rng.random::<f64>(), rng.random::<f64>());
        (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * turn).cos()
    })
}

/// Quantile of the F distribution with (`d1`, `d2`) degrees of freedom for a probability `p` of 1/2 or more.
fn f_quantile(p: f64, d1: f64, d2: f64) -> f64 {
    let target = (1.0 - p).ln();
    let (mut low, mut high) = (0.0, 1.0);
    while f_ln_survival(high, d1, d2) > target && high < 1e300 {
        high *= 2.0;
    }
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if f_ln_survival(middle, d1, d2) > target { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}
