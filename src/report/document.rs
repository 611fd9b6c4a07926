//! What the JSON documents have in common. Numbers that are not finite are `null`.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::files::ReportError;
use crate::pipeline::InputSummary;

/// Along x, y and z.
pub(super) type Axes = [Option<f64>; 3];

pub(super) fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

pub(super) fn axes(v: Vector3<f64>) -> Axes {
    [finite(v.x), finite(v.y), finite(v.z)]
}

/// The text of a document.
pub(super) fn json_text(document: &impl Serialize) -> Result<String, ReportError> {
    let mut json = serde_json::to_string_pretty(document)?;
    json.push('\n');
    Ok(json)
}

/// What wrote the report.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonSoftware {
    /// Version of calibrig.
    pub version: String,
}

impl JsonSoftware {
    pub(super) fn own() -> Self {
        Self { version: env!("CARGO_PKG_VERSION").to_owned() }
    }
}

/// Where the measurements came from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonInput {
    /// `scenario`, `files` or `recording`.
    pub kind: String,
    /// Its name for people.
    pub name: String,
    /// Hash over every input file, hexadecimal.
    pub sha256: String,
    /// The seed of a simulation, else null.
    pub seed: Option<u64>,
}

impl From<&InputSummary> for JsonInput {
    fn from(input: &InputSummary) -> Self {
        Self {
            kind: input.kind.to_owned(),
            name: input.name.clone(),
            sha256: input.sha256.clone(),
            seed: input.seed,
        }
    }
}

/// A pose that was not measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonDropped {
    /// Its number.
    pub pose: u32,
    /// Why.
    pub why: String,
}

pub(super) fn dropped(poses: &[(u32, String)]) -> Vec<JsonDropped> {
    poses.iter().map(|(pose, why)| JsonDropped { pose: *pose, why: why.clone() }).collect()
}
