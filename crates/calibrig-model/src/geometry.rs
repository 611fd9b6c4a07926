//! Rigid transforms and their small perturbations.
//!
//! A transform is named `a_from_b`: it takes coordinates in frame B to coordinates in frame A. Perturbations of a frame act on
//! its right (the B side): `a_from_b · exp(ξ)`, with `ξ = (translation, rotation vector)` in B, metres and radians.

use nalgebra::{IsometryMatrix3, Matrix3, Rotation3, Translation3, Vector3, Vector6};

/// A rigid transform with a rotation matrix.
pub type Transform = IsometryMatrix3<f64>;

/// Rotation about x by `angle` rad.
pub fn rotation_x(angle: f64) -> Transform {
    Transform::from_parts(Translation3::identity(), Rotation3::from_axis_angle(&Vector3::x_axis(), angle))
}

/// Rotation about y by `angle` rad.
pub fn rotation_y(angle: f64) -> Transform {
    Transform::from_parts(Translation3::identity(), Rotation3::from_axis_angle(&Vector3::y_axis(), angle))
}

/// Rotation about z by `angle` rad.
pub fn rotation_z(angle: f64) -> Transform {
    Transform::from_parts(Translation3::identity(), Rotation3::from_axis_angle(&Vector3::z_axis(), angle))
}

/// Translation by `(x, y, z)` m.
pub fn translation(x: f64, y: f64, z: f64) -> Transform {
    Transform::from_parts(Translation3::new(x, y, z), Rotation3::identity())
}

/// `exp(ξ)` with the rotation about the frame's own origin: translation `ξ[0..3]` m, rotation vector `ξ[3..6]` rad.
pub fn small_displacement(xi: &Vector6<f64>) -> Transform {
    Transform::from_parts(
        Translation3::new(xi[0], xi[1], xi[2]),
        Rotation3::new(Vector3::new(xi[3], xi[4], xi[5])),
    )
}

/// The matrix of `v ×`.
pub fn cross_matrix(v: &Vector3<f64>) -> Matrix3<f64> {
    v.cross_matrix()
}

/// The rigid transform `a_from_b` that best maps `points_b` onto `points_a` (least squares, equal weights).
///
/// Source: K. S. Arun, T. S. Huang, S. D. Blostein, PAMI 9 (1987) 698, with the reflection case of S. Umeyama, PAMI 13 (1991) 376.
/// Returns `None` for fewer than three points or points on one line, whose rotation is not determined.
pub fn best_fit_transform(points_a: &[Vector3<f64>], points_b: &[Vector3<f64>]) -> Option<Transform> {
    let n = points_a.len();
    if n < 3 || n != points_b.len() {
        return None;
    }
    let centroid = |points: &[Vector3<f64>]| points.iter().sum::<Vector3<f64>>() / n as f64;
    let (centre_a, centre_b) = (centroid(points_a), centroid(points_b));
    let correlation: Matrix3<f64> =
        points_a.iter().zip(points_b).map(|(a, b)| (a - centre_a) * (b - centre_b).transpose()).sum();
    let svd = correlation.try_svd(true, true, f64::EPSILON, 1000)?;
    let (u, v_t) = (svd.u?, svd.v_t?);
    let mut values = svd.singular_values;
    values.as_mut_slice().sort_by(|a, b| b.total_cmp(a));
    // The second singular value vanishes when the points lie on one line.
    if !(values[1] > 1e-12 * values[0].max(f64::MIN_POSITIVE)) {
        return None;
    }
    let mut handedness = Matrix3::identity();
    let smallest = svd.singular_values.imin();
    handedness[(smallest, smallest)] = (u * v_t).determinant().signum();
    let rotation = Rotation3::from_matrix_unchecked(u * handedness * v_t);
    Some(Transform::from_parts(Translation3::from(centre_a - rotation * centre_b), rotation))
}

/// The logarithm of a rotation of less than half a turn, rad. nalgebra's uses the arc cosine, which loses half the digits near zero.
pub fn rotation_vector(rotation: &Rotation3<f64>) -> Vector3<f64> {
    let r = rotation.matrix();
    let sine_axis = 0.5 * Vector3::new(r.m32 - r.m23, r.m13 - r.m31, r.m21 - r.m12);
    let sine = sine_axis.norm();
    let angle = sine.atan2(0.5 * (r.trace() - 1.0));
    if sine > 0.0 { sine_axis * (angle / sine) } else { sine_axis }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn best_fit_recovers_a_known_transform_and_refuses_a_line() {
        let truth = translation(1.0, -2.0, 0.5) * rotation_z(2.5) * rotation_x(-0.7);
        let points: Vec<_> = (0..6)
            .map(|i| {
                let t = f64::from(i);
                Vector3::new(t.sin(), (2.0 * t).cos(), 0.3 * t)
            })
            .collect();
        let moved: Vec<_> = points.iter().map(|p| truth.rotation * p + truth.translation.vector).collect();
        let found = best_fit_transform(&moved, &points).expect("six points in general position");
        assert!((found.to_homogeneous() - truth.to_homogeneous()).norm() < 1e-13);
        let line: Vec<_> = (0..6).map(|i| Vector3::new(f64::from(i), 0.0, 0.0)).collect();
        assert!(best_fit_transform(&line, &line).is_none());
    }

    #[test]
    fn the_rotation_vector_undoes_the_exponential_from_tiny_to_large_angles() {
        for angle in [0.0, 1e-12, 1e-6, 0.1, 3.0] {
            let expected = angle * Vector3::new(2.0, -1.0, 2.0) / 3.0;
            let found = rotation_vector(&Rotation3::new(expected));
            assert!(
                (found - expected).norm() <= 1e-14 * (1.0 + 1.0 / (std::f64::consts::PI - angle)),
                "{angle}"
            );
        }
    }
}
