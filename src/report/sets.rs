//! Sets of poses and their rows in `report.json`.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::acceptance_bounds::{JsonAcceptance, json_acceptance};
use super::document::{JsonDropped, axes, finite};
use crate::pipeline::CarriedReport;
use calibrig_estimation::evaluation::AccuracyRow;

/// A set of poses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonSet {
    /// Distinct poses measured.
    pub poses: usize,
    /// Poses planned but not measured.
    pub dropped: Vec<JsonDropped>,
    /// Readings of measured poses that were planned and did not come; absent where none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub missing: Vec<JsonMissing>,
    /// What repeats of a pose scatter by; absent where no pose is measured more than once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeats: Option<JsonRepeats>,
    /// What the flange carried, in the order of the first pose with it; absent where it never carried anything.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub payloads: Vec<CarriedReport>,
    /// By the key of the mode; rows that do not apply are absent.
    pub rows: BTreeMap<String, JsonRow>,
}

/// A reading that did not come.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonMissing {
    /// Number of the pose.
    pub pose: u32,
    /// Name of the station.
    pub station: String,
    /// Name of the target.
    pub target: String,
    /// Why, such as the link that hides it.
    pub why: String,
}

/// Poses that are measured more than once.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonRepeats {
    /// Their number.
    pub poses: usize,
    /// Readings of them beyond the first.
    pub repeats: usize,
    /// RMS distance of a reading from the mean of its pose, m: the least that rows of single readings can have.
    pub rms_3d_m: Option<f64>,
}

/// A row of the accuracy table, m, in the base frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonRow {
    /// Largest absolute error per axis.
    pub max_m: [Option<f64>; 3],
    /// Mean absolute error per axis.
    pub mean_m: [Option<f64>; 3],
    /// Mean signed error per axis.
    pub bias_m: [Option<f64>; 3],
    /// RMS of the 3-D error.
    pub rms_3d_m: Option<f64>,
    /// Largest 3-D error.
    pub max_3d_m: Option<f64>,
    /// Number of observations.
    pub n: usize,
    /// What held-out errors say of all poses of the region; absent of other sets.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acceptance: Option<JsonAcceptance>,
    /// Errors of orientations; absent where none was measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub orientation: Option<JsonOrientationRow>,
}

/// Angles between measured and predicted orientations, rad.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonOrientationRow {
    /// Root mean square.
    pub rms_rad: Option<f64>,
    /// Largest.
    pub max_rad: Option<f64>,
    /// Number of orientations.
    pub n: usize,
}

/// A row, and what it says of the region where its poses were held out, by the largest error of each, m.
pub(super) fn json_row(row: &AccuracyRow, held_out: Option<&[f64]>) -> JsonRow {
    JsonRow {
        max_m: axes(row.max),
        mean_m: axes(row.mean),
        bias_m: axes(row.bias),
        rms_3d_m: finite(row.rms_3d),
        max_3d_m: finite(row.max_3d),
        n: row.count,
        acceptance: held_out.and_then(json_acceptance),
        orientation: None,
    }
}
