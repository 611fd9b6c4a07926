//! Orientations as rotations about a common one.

use nalgebra::{Rotation3, Vector3};

use calibrig_model::geometry::{best_fit_transform, rotation_vector};

/// Most steps to the mean of rotations; the error after each is the square of the one before.
const STEPS: usize = 20;

/// The rotation about which all rotation vectors sum to zero; `None` without rotations. They must lie within a quarter turn of each other.
pub fn mean_rotation(rotations: &[Rotation3<f64>]) -> Option<Rotation3<f64>> {
    let mut mean = *rotations.first()?;
    for _ in 0..STEPS {
        let turn = turns_about(rotations, &mean).iter().sum::<Vector3<f64>>() / rotations.len() as f64;
        mean = Rotation3::new(turn) * mean;
        if turn.norm() < 1e-15 {
            break;
        }
    }
    Some(mean)
}

/// Rotation vectors that turn `reference` into each rotation, along the axes of the outer frame, rad.
pub fn turns_about(rotations: &[Rotation3<f64>], reference: &Rotation3<f64>) -> Vec<Vector3<f64>> {
    rotations.iter().map(|rotation| rotation_vector(&(rotation * reference.inverse()))).collect()
}

/// The rotation vector (rad) that turns the nominal points of a rigid body into the measured points, along the axes of their frame: the best
/// fit for three or more targets. `None` where they lie on one line, or the lists have different lengths.
pub fn turn_of_points(measured: &[Vector3<f64>], should_be: &[Vector3<f64>]) -> Option<Vector3<f64>> {
    if measured.len() != should_be.len() || measured.len() < 3 {
        return None;
    }
    best_fit_transform(measured, should_be).map(|fit| rotation_vector(&fit.rotation))
}
