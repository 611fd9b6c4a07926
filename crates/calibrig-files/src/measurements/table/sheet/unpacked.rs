//! How much the parts of a packed file unpack to, before anything of them is kept.

use std::borrow::Cow;
use std::io::{self, Read, Seek};

use zip::ZipArchive;

/// Limit for a part that is read as a whole: texts, styles and lists.
const MOST_OF_A_PART: u64 = 256 << 20;
/// The same for a sheet, which is read cell by cell: twenty million cells take less.
const MOST_OF_A_SHEET: u64 = 2 << 30;

/// A part that is too large: its name and its bound, bytes.
pub(super) struct TooLarge {
    pub part: String,
    pub most: u64,
}

/// Unpacks every part that a sheet reader uses, and keeps nothing: the sizes stated in a file need not be true.
///
/// `None` if all are within bounds, or the archive cannot be read, which its reader reports.
pub(super) fn too_large(file: &mut (impl Read + Seek)) -> Option<TooLarge> {
    let mut archive = ZipArchive::new(file).ok()?;
    for index in 0..archive.len() {
        let Ok(part) = archive.by_index(index) else { continue };
        let Ok(name) = part.name().map(Cow::into_owned) else { continue };
        let is_read = [".xml", ".rels"].iter().any(|end| name.to_ascii_lowercase().ends_with(end));
        if !is_read {
            continue;
        }
        let most = if name.contains("worksheets/") { MOST_OF_A_SHEET } else { MOST_OF_A_PART };
        // A damaged part is reported by its reader.
        if part.size() > most
            || io::copy(&mut part.take(most + 1), &mut io::sink()).is_ok_and(|bytes| bytes > most)
        {
            return Some(TooLarge { part: name, most });
        }
    }
    None
}
