//! Which reader a file gets: decided by its first bytes, not by its name.

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

/// How a bag in MCAP begins, and its first bytes, which no text has.
const BAG: &[u8] = b"\x89MCAP0\r\n";
const CUT_BAG: &[u8] = b"\x89MC";

/// Files of other kinds by their first bytes, and what to do with them.
const OTHER_KINDS: [(&[u8], &str); 6] = [
    (&[0x1f, 0x8b], "it is packed (gzip): unpack it first"),
    (b"BZh", "it is packed (bzip2): unpack it first"),
    (&[0x28, 0xb5, 0x2f, 0xfd], "it is packed (zstd): unpack it first"),
    (b"7z\xbc\xaf", "it is packed (7z): unpack it first"),
    (&[0xfd, b'7', b'z', b'X', b'Z'], "it is packed (xz): unpack it first"),
    (b"%PDF", "it is a PDF: export the measurements as text or XLSX"),
];

fn first_bytes(path: &Path) -> std::io::Result<Vec<u8>> {
    let mut start = Vec::new();
    File::open(path)?.take(BAG.len() as u64).read_to_end(&mut start)?;
    Ok(start)
}

/// Whether a file is a bag, or another MCAP file; false if it cannot be read, which its reader reports.
pub fn is_bag(path: &Path) -> bool {
    first_bytes(path).is_ok_and(|start| start.starts_with(CUT_BAG))
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
        return Err(unreadable("it is a folder; expected a file".to_owned()));
    }
    let start = first_bytes(path).map_err(|error| unreadable(error.to_string()))?;
    if let Some((_, what)) = OTHER_KINDS.iter().find(|(begin, _)| start.starts_with(begin)) {
        return Err(unreadable((*what).to_owned()));
    }
    match start.as_slice() {
        [b'P', b'K', 3, 4, ..] => Ok(Box::new(MemoryRows::from(read_sheet(path, options.sheet.as_deref())?))),
        [0xd0, 0xcf, 0x11, 0xe0, ..] => Err(unreadable(
            "it is a spreadsheet of the old kind (XLS), or one with a password: save it as XLSX without a password, or its \
             sheet as CSV".to_owned(),
        )),
        start if start.starts_with(CUT_BAG) => {
            let bag = BagOptions { enough: wanted.names.clone(), ..options.bag.clone() };
            Ok(Box::new(MemoryRows::from(read_bag(path, &bag)?)))
        }
        [b'#', b'R', b'O', b'S', b'B', b'A', b'G', ..] => {
            Err(unreadable("it is a ROS 1 bag: convert it to MCAP with ROS 2 messages, or write its points as CSV".to_owned()))
        }
        [b'S', b'Q', b'L', b'i', b't', b'e', ..] => Err(unreadable(
            "it is an SQLite file, the old format of ROS 2 bags: convert it to MCAP (`ros2 bag convert`)".to_owned(),
        )),
        _ => Ok(Box::new(TextRows::open(path, format, wanted)?)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_other_kinds_are_called_by_their_kind() {
        let folder = tempfile::tempdir().expect("a folder");
        let refused = |bytes: &[u8]| {
            let path = folder.path().join("m.csv");
            std::fs::write(&path, bytes).expect("written");
            let opened = open(&path, &TextFormat::default(), &Wanted::default(), &RowOptions::default());
            opened.err().expect("refused").to_string()
        };
        assert!(refused(b"\x1f\x8b\x08\x00rest").contains("packed (gzip): unpack it"));
        assert!(refused(b"%PDF-1.7").contains("a PDF"));
        assert!(refused(&[0xd0, 0xcf, 0x11, 0xe0]).contains("old kind"));
        for cut in 3..=BAG.len() {
            assert!(refused(&BAG[..cut]).contains("the bag cannot be read: it breaks off"), "{cut}");
        }
    }
}
