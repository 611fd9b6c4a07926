//! `robot.toml`.

use std::path::Path;

use crate::input::{InputError, Source};
use crate::model::{CalibrationModel, Visual};
use nalgebra::Vector3;

/// A robot as its files describe it.
#[derive(Debug, Clone, PartialEq)]
pub struct Robot {
    /// Name for people.
    pub name: String,
    /// What identification may know.
    pub model: CalibrationModel,
    /// Shapes to draw, per link (link 0 of the vector is the base, then one an entry per joint); empty without a URDF.
    pub visuals: Vec<Vec<Visual>>,
    /// Nominal offset of the target in the flange frame, m; `None` where it is not known.
    pub target: Option<Vector3<f64>>,
    /// Largest singular-value ratio etc. are not here: this is data only. The files read, by role: `robot`, `urdf`, `columns`.
    pub sources: Vec<(String, Source)>,
}

/// Reads `robot.toml` and the files it names beside it.
pub fn load_robot(path: &Path) -> Result<Robot, InputError> {
    let _ = path;
    unimplemented!()
}

/// The same from texts in memory (a recording's attachments): `urdf` and `columns` are the files that the robot's text names, by content.
pub fn parse_robot(
    robot: Source,
    urdf: Option<Source>,
    columns: Option<Source>,
) -> Result<Robot, InputError> {
    let _ = (robot, urdf, columns);
    unimplemented!()
}
