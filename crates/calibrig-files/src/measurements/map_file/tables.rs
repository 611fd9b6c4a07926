//! The tables of a column map as they stand in the file.

use std::ops::Range;

use serde::Deserialize;

use super::entries::{Codes, RawEntry};
use crate::input::Spanned;
use crate::measurements::units::{AngleUnit, LengthUnit};
use crate::payloads::PayloadTable;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MapFile {
    pub schema: Spanned<String>,
    pub joints: Spanned<JointsTable>,
    pub position: Spanned<CoordinateTable>,
    pub sigma: Option<Spanned<CoordinateTable>>,
    pub rotation: Option<Spanned<RotationTable>>,
    pub covariance: Option<Spanned<CovarianceTable>>,
    pub noise: Option<Spanned<NoiseTable>>,
    pub face: Option<Spanned<FaceTable>>,
    #[serde(default)]
    pub payload: Vec<Spanned<PayloadTable>>,
    #[serde(default)]
    pub columns: ColumnsTable,
    #[serde(default)]
    pub rows: RowsTable,
    pub sets: Option<Spanned<SetsTable>>,
    pub join: Option<Spanned<JoinTable>>,
    #[serde(default)]
    pub text: TextTable,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct JointsTable {
    pub columns: Spanned<RawEntry>,
    pub revolute_unit: Option<AngleUnit>,
    pub prismatic_unit: Option<LengthUnit>,
}

#[derive(Deserialize, Clone, Copy, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub(super) enum System {
    Cartesian,
    Spherical,
}

/// The columns of three coordinates. `x`, `y`, `z` and `unit` belong to the Cartesian system, the others to the spherical one; `missed` to
/// positions, `k` to sigmas.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CoordinateTable {
    pub system: Option<Spanned<System>>,
    pub unit: Option<Spanned<LengthUnit>>,
    pub x: Option<Spanned<RawEntry>>,
    pub y: Option<Spanned<RawEntry>>,
    pub z: Option<Spanned<RawEntry>>,
    pub range: Option<Spanned<RawEntry>>,
    pub range_unit: Option<Spanned<LengthUnit>>,
    pub azimuth: Option<Spanned<RawEntry>>,
    pub elevation: Option<Spanned<RawEntry>>,
    pub zenith: Option<Spanned<RawEntry>>,
    pub angle_unit: Option<Spanned<AngleUnit>>,
    pub missed: Option<Spanned<Codes>>,
    pub k: Option<Spanned<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct NoiseTable {
    pub range_um: Option<Spanned<f64>>,
    pub range_um_per_m: Option<Spanned<f64>>,
    pub transverse_um: Option<Spanned<f64>>,
    pub transverse_um_per_m: Option<Spanned<f64>>,
    pub k: Option<Spanned<f64>>,
    pub tracker_mm: Option<[Spanned<f64>; 3]>,
    pub rotation_urad: Option<Spanned<f64>>,
}

/// The rotation of a target with axes of its own.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RotationTable {
    pub transform: Option<Spanned<String>>,
    pub form: Option<Spanned<String>>,
    pub order: Option<Spanned<String>>,
    pub sequence: Option<Spanned<String>>,
    pub columns: Option<Spanned<RawEntry>>,
    pub unit: Option<Spanned<AngleUnit>>,
    pub sigma: Option<Spanned<RawEntry>>,
    pub sigma_unit: Option<AngleUnit>,
    pub k: Option<Spanned<f64>>,
}

/// The covariance of a full pose.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CovarianceTable {
    pub columns: Spanned<RawEntry>,
    pub unit: Option<LengthUnit>,
    pub angle_unit: Option<AngleUnit>,
}

/// The face in which a reading was taken.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FaceTable {
    pub column: Spanned<RawEntry>,
    pub front: Option<Spanned<Codes>>,
    pub back: Option<Spanned<Codes>>,
    pub angles: Option<Spanned<String>>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub(super) struct ColumnsTable {
    pub pose: Option<Spanned<RawEntry>>,
    pub station: Option<Spanned<RawEntry>>,
    pub target: Option<Spanned<RawEntry>>,
    pub time_s: Option<Spanned<RawEntry>>,
    pub time_ms: Option<Spanned<RawEntry>>,
    pub time_us: Option<Spanned<RawEntry>>,
    pub time_ns: Option<Spanned<RawEntry>>,
    pub temperature_c: Option<Spanned<RawEntry>>,
    pub temperature_k: Option<Spanned<RawEntry>>,
    pub temperature_f: Option<Spanned<RawEntry>>,
    pub pressure_hpa: Option<Spanned<RawEntry>>,
    pub pressure_pa: Option<Spanned<RawEntry>>,
    pub pressure_kpa: Option<Spanned<RawEntry>>,
    pub pressure_mmhg: Option<Spanned<RawEntry>>,
    pub pressure_inhg: Option<Spanned<RawEntry>>,
    pub humidity_percent: Option<Spanned<RawEntry>>,
    pub approach: Option<Spanned<RawEntry>>,
    pub payload: Option<Spanned<RawEntry>>,
    pub payload_mass_kg: Option<Spanned<RawEntry>>,
    pub payload_x_mm: Option<Spanned<RawEntry>>,
    pub payload_y_mm: Option<Spanned<RawEntry>>,
    pub payload_z_mm: Option<Spanned<RawEntry>>,
    pub payload_force_x_n: Option<Spanned<RawEntry>>,
    pub payload_force_y_n: Option<Spanned<RawEntry>>,
    pub payload_force_z_n: Option<Spanned<RawEntry>>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub(super) struct RowsTable {
    pub approach_from: Option<ApproachFrom>,
    #[serde(default)]
    pub repeats: Repeats,
    /// Of readings in both faces.
    #[serde(default)]
    pub faces: Repeats,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "lowercase")]
pub(super) enum ApproachFrom {
    Order,
}

#[derive(Deserialize, Clone, Copy, Default, PartialEq)]
#[serde(rename_all = "lowercase")]
pub(super) enum Repeats {
    #[default]
    Keep,
    Average,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SetsTable {
    pub column: Option<Spanned<RawEntry>>,
    #[serde(default)]
    pub identification: Vec<String>,
    #[serde(default)]
    pub verification: Vec<String>,
    pub verification_poses: Option<Spanned<Codes>>,
}

#[derive(Deserialize, Clone, Copy, PartialEq)]
#[serde(rename_all = "lowercase")]
pub(super) enum By {
    Row,
    Name,
    Time,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct JoinTable {
    pub by: By,
    pub joints: Option<Spanned<RawEntry>>,
    pub points: Option<Spanned<RawEntry>>,
    pub within_s: Option<Spanned<f64>>,
    pub offset_s: Option<Spanned<f64>>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub(super) struct TextTable {
    pub delimiter: Option<Spanned<String>>,
    pub decimal: Option<Spanned<String>>,
    pub date: Option<Spanned<String>>,
    pub header: Option<bool>,
    #[serde(default)]
    pub comments: Vec<String>,
    #[serde(default)]
    pub skip_lines: u32,
    pub widths: Option<Spanned<Vec<u32>>>,
}

pub(super) type KeySpan = (&'static str, Option<Range<usize>>);

fn key_span<T>(key: &'static str, value: Option<&Spanned<T>>) -> KeySpan {
    (key, value.map(Spanned::span))
}

impl CoordinateTable {
    pub fn cartesian_keys(&self) -> Vec<KeySpan> {
        vec![
            key_span("x", self.x.as_ref()),
            key_span("y", self.y.as_ref()),
            key_span("z", self.z.as_ref()),
            key_span("unit", self.unit.as_ref()),
        ]
    }

    pub fn spherical_keys(&self) -> Vec<KeySpan> {
        vec![
            key_span("range", self.range.as_ref()),
            key_span("range_unit", self.range_unit.as_ref()),
            key_span("azimuth", self.azimuth.as_ref()),
            key_span("elevation", self.elevation.as_ref()),
            key_span("zenith", self.zenith.as_ref()),
            key_span("angle_unit", self.angle_unit.as_ref()),
        ]
    }
}
