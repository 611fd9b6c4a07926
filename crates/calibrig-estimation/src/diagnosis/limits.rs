//! What a session cannot determine, whatever is tried: joints that never moved, poses that are all equal, points on a line, in a plane, on a sphere.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use calibrig_model::measurement::{MeasurementSet, Observation};
use calibrig_model::{CalibrationModel, Payload};

/// A joint that moves by less counts as not moved, rad or m.
const NO_MOTION: f64 = 1e-6;
/// Share of their spread within which points count as on a line, in a plane or on a sphere.
const WITHIN: f64 = 5e-3;

/// Something that a session does not determine.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Undetermined {
    /// Joints never moved: their sign, unit, order, zero and links are not determined.
    NeverMoved {
        /// Which joints.
        joints: Vec<usize>,
    },
    /// There are fewer different poses than needed.
    FewPoses {
        /// Number of different poses.
        distinct: usize,
        /// Number that is needed to separate anything from the tracker's place and the target's offset.
        needed: usize,
    },
    /// Several observations of one target are at the same pose: they only show its repeatability.
    EqualPoses {
        /// Number of poses that were measured more than once.
        poses: usize,
        /// Number of observations at these poses.
        observations: usize,
    },
    /// All points are on one line.
    Line,
    /// All points are in one plane: a mirror image cannot be detected.
    Plane,
    /// All points are on one sphere: what is in front of its centre is not determined.
    Sphere {
        /// Radius of the sphere, m.
        radius: f64,
    },
}

pub(super) fn undetermined(model: &CalibrationModel, set: &MeasurementSet) -> Vec<Undetermined> {
    let mut found = Vec::new();
    let joints: Vec<usize> = (0..model.kinematics.joint_count())
        .filter(|joint| model.actuators.is_commanded(*joint))
        .filter(|joint| {
            let values = set.observations.iter().map(|o| o.command[*joint]);
            let (low, high) =
                values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (v.min(l), v.max(h)));
            high - low < NO_MOTION
        })
        .collect();
    if !joints.is_empty() {
        found.push(Undetermined::NeverMoved { joints });
    }
    found.extend(poses(set));
    found.extend(shape(set));
    found
}

fn poses(set: &MeasurementSet) -> Vec<Undetermined> {
    let key = |o: &Observation| {
        let command: Vec<u64> = o.command.iter().map(|v| ((v / NO_MOTION).round() + 0.0).to_bits()).collect();
        (o.station, o.target, o.payload.as_ref().map(Payload::bits), command)
    };
    let mut keys: Vec<_> = set.observations.iter().map(key).collect();
    keys.sort();
    let counts: Vec<usize> = keys.chunk_by(|a, b| a == b).map(<[_]>::len).collect();
    let repeated: Vec<usize> = counts.iter().copied().filter(|count| *count > 1).collect();
    let mut found = Vec::new();
    let needed = 2 + (6 * set.stations.len() + 3 * set.targets.len()).div_ceil(3);
    if counts.len() < needed {
        found.push(Undetermined::FewPoses { distinct: counts.len(), needed });
    }
    if !repeated.is_empty() {
        let observations = repeated.iter().sum();
        found.push(Undetermined::EqualPoses { poses: repeated.len(), observations });
    }
    found
}

fn shape(set: &MeasurementSet) -> Option<Undetermined> {
    let points: Vec<Vector3<f64>> = set.observations.iter().map(|o| o.reading.position()).collect();
    if set.stations.len() > 1 || points.len() < 4 {
        return None;
    }
    let mean = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    let inertia: Matrix3<f64> =
        points.iter().map(|p| (p - mean) * (p - mean).transpose()).sum::<Matrix3<f64>>()
            / points.len() as f64;
    let mut sizes: Vec<f64> = inertia.symmetric_eigenvalues().iter().map(|v| v.max(0.0).sqrt()).collect();
    sizes.sort_by(|a, b| b.total_cmp(a));
    let spread = set.spread();
    if !(spread > 0.0) {
        return None;
    }
    if sizes[1] < WITHIN * spread {
        return Some(Undetermined::Line);
    }
    if sizes[2] < WITHIN * spread {
        return Some(Undetermined::Plane);
    }
    sphere(&points, &mean, spread)
}

/// The sphere that fits best: |p|² - 2 c·p + (|c|² - r²) = 0 is linear in c and the last term.
fn sphere(points: &[Vector3<f64>], mean: &Vector3<f64>, spread: f64) -> Option<Undetermined> {
    if points.len() < 6 {
        return None;
    }
    let matrix =
        DMatrix::from_fn(points.len(), 4, |i, j| if j < 3 { 2.0 * (points[i][j] - mean[j]) } else { 1.0 });
    let right = DVector::from_iterator(points.len(), points.iter().map(|p| (p - mean).norm_squared()));
    let solved = matrix.try_svd(true, true, f64::EPSILON, 500)?.solve(&right, 1e-12).ok()?;
    let centre = Vector3::new(solved[0], solved[1], solved[2]);
    let radius = (solved[3] + centre.norm_squared()).max(0.0).sqrt();
    let off = points.iter().map(|p| ((p - mean - centre).norm() - radius).powi(2)).sum::<f64>();
    let is_on = (off / points.len() as f64).sqrt() < WITHIN * spread && radius < 10.0 * spread;
    is_on.then_some(Undetermined::Sphere { radius })
}
