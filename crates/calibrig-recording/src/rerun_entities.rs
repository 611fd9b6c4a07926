//! What the parts of a Rerun recording have in common: the names of its entities, and numbers, places and colours as Rerun has them.

use nalgebra::{UnitQuaternion, Vector3};
use rerun::Quaternion;
use rerun::components::Color;

use super::scene::Colour;
use calibrig_estimation::identification::Mode;
use calibrig_model::geometry::Transform;
use calibrig_model::measurement::SetKind;

pub(super) const APPLICATION: &str = "calibrig";
/// Root of all that is drawn in the base frame.
pub(super) const SCENE: &str = "scene";
/// Residual arrows; the scale is [`super::RESIDUAL_SCALE`].
pub(super) const ARROWS: &str = "scene/residual_x100";
pub(super) const AXES: [&str; 3] = ["x", "y", "z"];
pub(super) const NORM: &str = "norm";
/// The machine with its deflections enlarged; the scale is [`super::DEFLECTION_SCALE`].
pub(super) const DEFLECTED: &str = "scene/deflection_x100";
/// The robot as identified.
pub(super) const CALIBRATED: &str = "scene/calibrated";
/// A driven path as it was planned.
pub(super) const PATH: &str = "scene/path";
/// The same path as measured; the scale of the errors is [`super::RESIDUAL_SCALE`].
pub(super) const DRIVEN_PATH: &str = "scene/path_x100";
/// Deflection of the target, by everything that yields.
pub(super) const DEFLECTION: &str = "machine/deflection_mm";
pub(super) const ROD_FORCE: &str = "machine/rod_force_n";
pub(super) const TEMPERATURE: &str = "machine/temperature_c";
pub(super) const CORRELATION: &str = "correlation";
pub(super) const CONVERGENCE: &str = "convergence";
pub(super) const COST: &str = "cost_log10";

/// The histogram of a mode's errors.
pub(super) fn histogram_path(set: SetKind, mode: Mode, axis: &str) -> String {
    format!("error_histogram/{}/{}/{axis}", set.key(), mode.key())
}

/// Pictures are in single precision: 0.2 µm at 4 m.
#[allow(clippy::cast_possible_truncation)]
pub(super) fn single(value: f64) -> f32 {
    value as f32
}

pub(super) fn xyz(v: &Vector3<f64>) -> [f32; 3] {
    [single(v.x), single(v.y), single(v.z)]
}

pub(super) fn quaternion(transform: &Transform) -> Quaternion {
    let q = UnitQuaternion::from_rotation_matrix(&transform.rotation);
    Quaternion::from_xyzw([q.i, q.j, q.k, q.w].map(single))
}

pub(super) fn color([r, g, b, a]: Colour) -> Color {
    Color::from_unmultiplied_rgba(r, g, b, a)
}
