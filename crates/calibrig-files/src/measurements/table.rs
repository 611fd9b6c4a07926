//! Tables from files that are not text: sheets of spreadsheets, and bags.

pub(super) mod bag;
mod cdr;
mod mcap_records;
pub(super) mod sheet;
#[cfg(test)]
mod tests;

use super::rows::Place;

/// Rows of texts as they are in a file, the header like any other.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Table {
    /// The file, as messages call it.
    pub name: String,
    /// From the first.
    pub rows: Vec<TableRow>,
    /// Remarks on the file besides its rows, in words.
    pub remarks: Vec<String>,
}

/// A row of a table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TableRow {
    /// Where it is.
    pub place: Place,
    /// One text per cell. Numbers read back to the same bits.
    pub cells: Vec<String>,
}

/// A number as text that reads back to the same bits; whole ones without a point, as pose numbers are written.
fn number_text(number: f64) -> String {
    if number.fract() == 0.0 && number.abs() < 1e15 && !(number == 0.0 && number.is_sign_negative()) {
        format!("{number:.0}")
    } else {
        format!("{number:?}")
    }
}

/// "1 row", "2 rows".
fn counted(count: usize, noun: &str) -> String {
    if count == 1 { format!("1 {noun}") } else { format!("{count} {noun}s") }
}
