//! Orientations as turns about a common one.

use nalgebra::{Rotation3, Vector3};

use calibrig_model::geometry::{best_fit_transform, rotation_vector};

/// Steps to the mean of rotations; each leaves the square of what the one before left.
const STEPS: usize = 20;

/// The rotation about which the turns of all sum up to zero; `None` of none. They lie within a quarter turn of each other.
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

/// Rotation vectors that turn `reference` into each, along the axes of the outer frame, rad.
pub fn turns_about(rotations: &[Rotation3<f64>], reference: &Rotation3<f64>) -> Vec<Vector3<f64>> {
    rotations.iter().map(|rotation| rotation_vector(&(rotation * reference.inverse()))).collect()
}

/// The rotation vector (rad) that turns points of a rigid body as they should be into the points as measured, along the axes of their frame: the best fit of
/// three or more targets. `None` where they lie on one line, and for lists of unlike length.
pub fn turn_of_points(measured: &[Vector3<f64>], should_be: &[Vector3<f64>]) -> Option<Vector3<f64>> {
    if measured.len() != should_be.len() || measured.len() < 3 {
        return None;
    }
    best_fit_transform(measured, should_be).map(|fit| rotation_vector(&fit.rotation))
}
