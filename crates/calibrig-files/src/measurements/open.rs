//! Which reader a file gets: told by its first bytes, not by its name.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::columns::RowOptions;
use super::layout::Wanted;
use super::rows::{MemoryRows, Rows};
use super::table::Table;
use super::table::bag::{BagOptions, read_bag};
use super::table::sheet::read_sheet;
use super::text::{TextFormat, TextRows};
use crate::input::InputError;

/// How a bag in MCAP begins.
const BAG: &[u8] = b"\x89MCAP0\r\n";

fn first_bytes(path: &Path) -> std::io::Result<Vec<u8>> {
    let mut start = Vec::new();
    File::open(path)?.take(BAG.len() as u64).read_to_end(&mut start)?;
    Ok(start)
}

/// Whether a file is a bag, or another MCAP file; false where it cannot be read, which is told by whoever reads it.
pub fn is_bag(path: &Path) -> bool {
    first_bytes(path).is_ok_and(|start| start == BAG)
}

impl From<Table> for MemoryRows {
    fn from(Table { name, rows, remarks }: Table) -> Self {
        let rows = rows.into_iter().map(|row| (row.place, row.cells)).collect();
        Self::new(name, rows).with_remarks(remarks)
    }
}

/// Opens a file of measurements, in which the columns `wanted` are looked for.
pub(super) fn open(
    path: &Path,
    format: &TextFormat,
    wanted: &Wanted,
    options: &RowOptions,
) -> Result<Box<dyn Rows>, InputError> {
    let unreadable = |reason: String| InputError::Unreadable { path: path.to_path_buf(), reason };
    if path.is_dir() {
        return Err(unreadable("it is a folder, a file was expected".to_owned()));
    }
    match first_bytes(path).map_err(|error| unreadable(error.to_string()))?.as_slice() {
        [b'P', b'K', 3, 4, ..] => Ok(Box::new(MemoryRows::from(read_sheet(path, options.sheet.as_deref())?))),
        [0xd0, 0xcf, 0x11, 0xe0, ..] => Err(unreadable(
            "it is a spreadsheet of the old kind (XLS), or one with a password: save it as XLSX without, or its sheet as CSV".to_owned(),
        )),
        BAG => {
            let bag = BagOptions { enough: wanted.names.clone(), ..options.bag.clone() };
            Ok(Box::new(MemoryRows::from(read_bag(path, &bag)?)))
        }
        [b'#', b'R', b'O', b'S', b'B', b'A', b'G', ..] => {
            Err(unreadable("it is a bag of ROS 1: convert it to MCAP with ROS 2's messages, or write its points as CSV".to_owned()))
        }
        [b'S', b'Q', b'L', b'i', b't', b'e', ..] => Err(unreadable(
            "it is an SQLite file, as ROS 2's bags were once: convert it to MCAP (`ros2 bag convert`)".to_owned(),
        )),
        _ => Ok(Box::new(TextRows::open(path, format, wanted)?)),
    }
}
