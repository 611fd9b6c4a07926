//! CSV.
use std::path::Path;

use thiserror::Error;

use super::{ColumnMap, MeasurementSet};
use crate::model::JointKind;

/// A measurement file that cannot be used.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum CsvError {}

/// Reads a measurement file. `joints` are the kinds of the robot's joints, in order.
pub fn read_measurements(
    path: &Path,
    map: &ColumnMap,
    joints: &[JointKind],
) -> Result<MeasurementSet, CsvError> {
    let _ = (path, map, joints);
    unimplemented!()
}

/// Writes a measurement file in calibrig's own columns.
pub fn write_measurements(path: &Path, set: &MeasurementSet, joints: &[JointKind]) -> Result<(), CsvError> {
    let _ = (path, set, joints);
    unimplemented!()
}
