//! Column maps.
use std::path::Path;

use crate::input::{InputError, Source};

/// Which columns of a file mean what, and in which unit.
#[derive(Debug, Clone, PartialEq)]
pub struct ColumnMap {}

/// Reads a column map.
pub fn load_column_map(path: &Path) -> Result<(ColumnMap, Source), InputError> {
    let _ = path;
    unimplemented!()
}
