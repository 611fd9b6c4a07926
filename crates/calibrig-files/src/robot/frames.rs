//! `[base]`, `[flange]` and `[joint.body]`: fixed frames at both ends of the table, and what the joints carry.

use nalgebra::{Matrix3, Rotation3, Vector3};
use serde::Deserialize;

use super::joints::JointTable;
use super::{Convention, Reader};
use crate::input::{InputError, Spanned};
use calibrig_model::Body;
use calibrig_model::geometry::{Transform, rotation_x, translation};

/// A frame in another one: shifted, then turned about the fixed x, y and z, as an `<origin>` of a URDF.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FrameTable {
    x_mm: Option<Spanned<f64>>,
    y_mm: Option<Spanned<f64>>,
    z_mm: Option<Spanned<f64>>,
    roll_deg: Option<Spanned<f64>>,
    pitch_deg: Option<Spanned<f64>>,
    yaw_deg: Option<Spanned<f64>>,
}

/// What a joint carries, in the frame of its row.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BodyTable {
    mass_kg: Spanned<f64>,
    x_mm: Spanned<f64>,
    y_mm: Spanned<f64>,
    z_mm: Spanned<f64>,
    ixx_kg_m2: Option<Spanned<f64>>,
    iyy_kg_m2: Option<Spanned<f64>>,
    izz_kg_m2: Option<Spanned<f64>>,
    ixy_kg_m2: Option<Spanned<f64>>,
    ixz_kg_m2: Option<Spanned<f64>>,
    iyz_kg_m2: Option<Spanned<f64>>,
}

/// A body without a stated inertia is taken as a solid sphere of this density, kg/m³. It has no effect at rest.
const DENSITY: f64 = 2700.0;

impl Reader<'_> {
    /// The identity if the file has no such table.
    pub(super) fn frame(
        &self,
        name: &str,
        table: Option<&Spanned<FrameTable>>,
    ) -> Result<Transform, InputError> {
        let Some(table) = table else { return Ok(Transform::identity()) };
        let table = table.get_ref();
        let length = |key: &str, value: &Option<Spanned<f64>>| {
            value.as_ref().map_or(Ok(0.0), |value| self.millimetres(&format!("{name}.{key}"), value))
        };
        let angle = |key: &str, value: &Option<Spanned<f64>>| {
            value.as_ref().map_or(Ok(0.0), |value| self.degrees(&format!("{name}.{key}"), value))
        };
        let place = Vector3::new(
            length("x_mm", &table.x_mm)?,
            length("y_mm", &table.y_mm)?,
            length("z_mm", &table.z_mm)?,
        );
        let turn = Rotation3::from_euler_angles(
            angle("roll_deg", &table.roll_deg)?,
            angle("pitch_deg", &table.pitch_deg)?,
            angle("yaw_deg", &table.yaw_deg)?,
        );
        Ok(Transform::from_parts(place.into(), turn))
    }

    /// The joint's `[joint.body]`, in the link's frame; `None` if there is no such table.
    pub(super) fn stated_body(&self, table: &Spanned<JointTable>) -> Result<Option<Body>, InputError> {
        let joint = table.get_ref();
        let Some(stated) = &joint.body else { return Ok(None) };
        let (body, name) = (stated.get_ref(), joint.name.get_ref());
        let mass = self.source.positive("body.mass_kg", &body.mass_kg)?;
        let centre = Vector3::new(
            self.millimetres("body.x_mm", &body.x_mm)?,
            self.millimetres("body.y_mm", &body.y_mm)?,
            self.millimetres("body.z_mm", &body.z_mm)?,
        );
        let entry = |key: &str, value: &Option<Spanned<f64>>| {
            value.as_ref().map_or(Ok(0.0), |value| self.source.finite(&format!("body.{key}"), value))
        };
        let moments = [&body.ixx_kg_m2, &body.iyy_kg_m2, &body.izz_kg_m2];
        let products = [&body.ixy_kg_m2, &body.ixz_kg_m2, &body.iyz_kg_m2];
        let inertia = if moments.iter().all(|moment| moment.is_some()) {
            let [xx, yy, zz] = [
                entry("ixx_kg_m2", moments[0])?,
                entry("iyy_kg_m2", moments[1])?,
                entry("izz_kg_m2", moments[2])?,
            ];
            let [xy, xz, yz] = [
                entry("ixy_kg_m2", products[0])?,
                entry("ixz_kg_m2", products[1])?,
                entry("iyz_kg_m2", products[2])?,
            ];
            let inertia = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
            if let Some(fault) = inertia_fault(&inertia) {
                let message = format!("the inertia of joint {name:?} {fault}");
                return self.error(
                    stated.span(),
                    message,
                    "that of a real body, or no inertia: it has no effect at rest",
                );
            }
            inertia
        } else if moments.iter().chain(&products).any(|value| value.is_some()) {
            let message = format!("joint {name:?} has only part of an inertia");
            return self.error(stated.span(), message, "ixx_kg_m2, iyy_kg_m2 and izz_kg_m2, or none of them");
        } else {
            sphere(mass)
        };
        // The frame of a standard row lies behind its a and alpha.
        let link_from_row = match self.file.convention {
            Convention::Craig => Transform::identity(),
            Convention::Standard => {
                translation(self.millimetres("a_mm", &joint.a_mm)?, 0.0, 0.0)
                    * rotation_x(self.degrees("alpha_deg", &joint.alpha_deg)?)
            }
        };
        let turn = link_from_row.rotation.matrix();
        Ok(Some(Body {
            mass,
            centre_of_mass: (link_from_row * nalgebra::Point3::from(centre)).coords,
            inertia: turn * inertia * turn.transpose(),
        }))
    }
}

/// The inertia of a solid sphere.
pub(crate) fn sphere(mass: f64) -> Matrix3<f64> {
    let radius = (mass / DENSITY * 0.75 / std::f64::consts::PI).cbrt();
    Matrix3::identity() * (0.4 * mass * radius * radius)
}

/// Why an inertia is impossible, kg m².
pub(crate) fn inertia_fault(inertia: &Matrix3<f64>) -> Option<String> {
    let scale = inertia.amax();
    if !scale.is_finite() {
        return Some("is too large".to_owned());
    }
    // Scaled, because the eigenvalue iteration squares its numbers.
    let mut moments = (inertia / scale.max(f64::MIN_POSITIVE)).symmetric_eigenvalues() * scale;
    moments.as_mut_slice().sort_by(f64::total_cmp);
    let [low, middle, high] = moments.into();
    let definite = low > 0.0;
    if !definite {
        return Some(format!("is not positive definite (smallest moment {low:.3e} kg m²)"));
    }
    // A flat body is at the limit: rounding of the file's numbers must not refuse it.
    (low + middle < high * (1.0 - 1e-9)).then(|| {
        format!("is not that of a real body: of the principal moments {low:.6e}, {middle:.6e}, {high:.6e} kg m², the two \
                 smaller sum to less than the largest")
    })
}
