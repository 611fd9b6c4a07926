//! Spreadsheets in XLSX.

use std::io::{Cursor, Read, Write};
use std::sync::LazyLock;

use calibrig::files::{ColumnMap, MemoryRows, read_rows, read_sheet};
use calibrig::model::JointKind;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

use super::choices::Choices;
use super::edit::Seed;
use super::file;
use super::mcap_file::damage;
use super::measurements::use_measurements;

/// Names and contents of the parts of a spreadsheet.
static PARTS: LazyLock<Vec<(String, Seed)>> = LazyLock::new(|| {
    let book = Cursor::new(include_bytes!("../../fixtures/tables/points.xlsx"));
    let mut archive = ZipArchive::new(book).expect("a ZIP file");
    let mut parts = Vec::new();
    for index in 0..archive.len() {
        let mut part = archive.by_index(index).expect("a part");
        let mut text = String::new();
        part.read_to_string(&mut text).expect("text");
        // Of long sheets the first rows.
        if let Some((at, _)) = text.match_indices("</row>").nth(5) {
            text.replace_range(at + "</row>".len()..text.find("</sheetData>").expect("its end"), "");
        }
        // Themes are not looked at.
        if text.contains("<a:theme") {
            continue;
        }
        let name = part.name().expect("a name").into_owned();
        parts.push((name, Seed::xml(&text)));
    }
    parts
});

/// A spreadsheet of which a part or two are edited.
pub fn xlsx(data: &[u8]) {
    let choices = &mut Choices::new(data);
    let parts = &*PARTS;
    let mut bytes = match choices.below(8) {
        7 => std::mem::replace(choices, Choices::new(&[])).rest().to_vec(),
        _ => zipped(parts, choices),
    };
    damage(&mut bytes, choices);
    let sheet = [None, None, None, Some("Sheet"), Some("x")][choices.below(5)];
    let Ok(table) = file::with(&bytes, |path, _| read_sheet(path, sheet)) else { return };
    let joints = [JointKind::Revolute, JointKind::Revolute, JointKind::Prismatic];
    if let Ok(loaded) = read_rows(Box::new(MemoryRows::from(table)), &ColumnMap::default(), &joints) {
        use_measurements(&loaded, choices);
    }
}

fn zipped(parts: &[(String, Seed)], choices: &mut Choices<'_>) -> Vec<u8> {
    let mut texts: Vec<(&str, String)> =
        parts.iter().map(|(name, seed)| (name.as_str(), seed.text.clone())).collect();
    for _ in 0..choices.below(3) {
        let at = choices.below(parts.len());
        let seed = &parts[at].1;
        texts[at].1 = seed.edited(choices, std::slice::from_ref(seed));
    }
    if choices.below(16) == 15 {
        texts.remove(choices.below(texts.len()));
    }
    let method = if choices.below(4) == 3 { CompressionMethod::Deflated } else { CompressionMethod::Stored };
    let options = SimpleFileOptions::default().compression_method(method);
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, text) in texts {
        archive.start_file(name, options).expect("begun");
        archive.write_all(text.as_bytes()).expect("written");
    }
    archive.finish().expect("finished").into_inner()
}
