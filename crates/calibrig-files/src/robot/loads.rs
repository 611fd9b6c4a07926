//! `[[load]]`: payload, hoses, tool forces.

use nalgebra::Vector3;
use serde::Deserialize;

use crate::input::{InputError, Source, Spanned};
use calibrig_model::PointLoad;

/// A mass or a force at a point of a link, as robot and scenario files give it.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoadTable {
    name: Spanned<String>,
    joint: Spanned<String>,
    x_mm: Spanned<f64>,
    y_mm: Spanned<f64>,
    z_mm: Spanned<f64>,
    mass_kg: Option<Spanned<f64>>,
    force_x_n: Option<Spanned<f64>>,
    force_y_n: Option<Spanned<f64>>,
    force_z_n: Option<Spanned<f64>>,
}

/// The loads of `tables`, after those of `known`, whose names they must not repeat; `joints` are the names of the
/// joints.
pub fn read_loads(
    source: &Source,
    tables: &[Spanned<LoadTable>],
    joints: &[&str],
    known: &[PointLoad],
) -> Result<Vec<PointLoad>, InputError> {
    let mut loads = known.to_vec();
    for table in tables {
        let load = table.get_ref().read(source, table.span(), joints)?;
        if loads.iter().any(|other| other.name == load.name) {
            let message = format!("a second load {:?}", load.name);
            let help = Some("expected a different name for each load".to_owned());
            return Err(source.error(table.get_ref().name.span(), message, help));
        }
        loads.push(load);
    }
    Ok(loads)
}

impl LoadTable {
    fn read(
        &self,
        source: &Source,
        span: std::ops::Range<usize>,
        joints: &[&str],
    ) -> Result<PointLoad, InputError> {
        let name = self.name.get_ref();
        if name.trim().is_empty() {
            let help = Some("expected a name that is not empty".to_owned());
            return Err(source.error(self.name.span(), "name is empty", help));
        }
        let Some(link) = joints.iter().position(|joint| joint == self.joint.get_ref()) else {
            let message = format!("load {name:?}: no joint is named {:?}", self.joint.get_ref());
            let help = Some(format!("expected one of {}", joints.join(", ")));
            return Err(source.error(self.joint.span(), message, help));
        };
        let mass = self.mass_kg.as_ref().map_or(Ok(0.0), |mass| source.not_negative("mass_kg", mass))?;
        let newton = |key, value: &Option<Spanned<f64>>| {
            value.as_ref().map_or(Ok(0.0), |value| source.finite(key, value))
        };
        let force = Vector3::new(
            newton("force_x_n", &self.force_x_n)?,
            newton("force_y_n", &self.force_y_n)?,
            newton("force_z_n", &self.force_z_n)?,
        );
        if mass == 0.0 && force == Vector3::zeros() {
            let message = format!("load {name:?} has neither mass nor force");
            let help = Some("expected mass_kg, or force_x_n, force_y_n or force_z_n".to_owned());
            return Err(source.error(span, message, help));
        }
        let at = Vector3::new(
            source.finite("x_mm", &self.x_mm)?,
            source.finite("y_mm", &self.y_mm)?,
            source.finite("z_mm", &self.z_mm)?,
        ) / 1e3;
        Ok(PointLoad { name: name.clone(), link, at, mass, force })
    }
}
