//! Which reader a file gets: told by its first bytes, not by its name.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::layout::Wanted;
use super::rows::Rows;
use super::text::{TextFormat, TextRows};
use crate::input::InputError;

/// Opens a file of measurements, in which the columns `wanted` are looked for.
pub(super) fn open(path: &Path, format: &TextFormat, wanted: &Wanted) -> Result<Box<dyn Rows>, InputError> {
    let unreadable = |reason: String| InputError::Unreadable { path: path.to_path_buf(), reason };
    if path.is_dir() {
        return Err(unreadable("it is a folder, a file was expected".to_owned()));
    }
    let mut start = Vec::new();
    let file = File::open(path).map_err(|error| unreadable(error.to_string()))?;
    file.take(8).read_to_end(&mut start).map_err(|error| unreadable(error.to_string()))?;
    match start.as_slice() {
        [b'P', b'K', 3, 4, ..] => {
            Err(unreadable("it is a ZIP archive, as XLSX files are: save the sheet as text (CSV)".to_owned()))
        }
        [0x89, b'M', b'C', b'A', b'P', b'0', ..] => {
            Err(unreadable("it is an MCAP file: `calibrig replay` reads recordings".to_owned()))
        }
        _ => Ok(Box::new(TextRows::open(path, format, wanted)?)),
    }
}
