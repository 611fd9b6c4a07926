//! Rows of texts, whatever kind of file they come from: the interface between readers of files and the column map.
//!
//! A reader gives rows as they are in its file, the header like any other. Which row is the header, what the columns mean and which rows
//! are measurements is found later.

use std::fmt;
use std::ops::Range;
use std::sync::Arc;

use crate::input::{Excerpt, InputError};

/// A table that is read row by row.
pub trait Rows {
    /// The file, as messages call it.
    fn name(&self) -> &str;

    /// Puts the next row into `row`; false at the end of the table.
    ///
    /// # Errors
    /// Errors if the file cannot be read any further.
    fn next_row(&mut self, row: &mut Row) -> Result<bool, InputError>;

    /// Remarks on the file besides its rows, in words: its encoding, for example.
    fn remarks(&self) -> Vec<String> {
        Vec::new()
    }

    /// Whether the last row given is that of a text whose last line has no line end.
    fn breaks_off(&self) -> bool {
        false
    }

    /// Comments in the file, with line numbers.
    fn comments(&self) -> &[(u64, String)] {
        &[]
    }
}

/// Where a row is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Place {
    /// A line of a text, from 1.
    Line(u64),
    /// A row of a spreadsheet.
    Sheet {
        /// Name of the sheet.
        sheet: Arc<str>,
        /// From 1.
        row: u32,
        /// Column of the first cell, from 1: A.
        first_column: u32,
    },
    /// A message of a bag.
    Message {
        /// Its topic.
        topic: Arc<str>,
        /// From 1.
        number: u64,
    },
}

impl Place {
    /// The place `rows` further on.
    #[must_use]
    pub(super) fn further(&self, rows: u64) -> Self {
        let mut place = self.clone();
        match &mut place {
            Self::Line(number) | Self::Message { number, .. } => *number = number.saturating_add(rows),
            Self::Sheet { row, .. } => *row = row.saturating_add(u32::try_from(rows).unwrap_or(u32::MAX)),
        }
        place
    }

    /// In a file, as messages have it: `m.csv:17`, `book.xlsx, sheet Points, row 7`.
    pub fn of(&self, file: &str) -> String {
        match self {
            Self::Line(line) => format!("{file}:{line}"),
            Self::Sheet { sheet, row, .. } => format!("{file}, sheet {sheet}, row {row}"),
            Self::Message { topic, number } => format!("{file}, {topic}, message {number}"),
        }
    }

    /// The same for the cell of a column, from 0.
    fn of_cell(&self, file: &str, column: usize) -> String {
        match self {
            Self::Sheet { sheet, row, first_column } => {
                let letters = letters(*first_column as usize + column);
                format!("{file}, sheet {sheet}, cell {letters}{row}")
            }
            place => place.of(file),
        }
    }
}

/// The row alone: `line 17`.
impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line(line) => write!(f, "line {line}"),
            Self::Sheet { row, .. } => write!(f, "row {row}"),
            Self::Message { number, .. } => write!(f, "message {number}"),
        }
    }
}

/// As much of a line as a message can show: all of it, or the part around the place.
fn near(line: &str, span: Range<usize>) -> (String, Range<usize>) {
    const LONGEST: usize = 500;
    const AROUND: usize = 100;
    if line.len() <= LONGEST {
        return (line.to_owned(), span);
    }
    let mut from = span.start.saturating_sub(AROUND);
    let mut to = span.end.min(span.start + LONGEST).saturating_add(AROUND).min(line.len());
    while !line.is_char_boundary(from) {
        from -= 1;
    }
    while !line.is_char_boundary(to) {
        to += 1;
    }
    let mark = if from > 0 { "…" } else { "" };
    let text = format!("{mark}{}{}", &line[from..to], if to < line.len() { "…" } else { "" });
    let shift = |at: usize| at.min(to) - from + mark.len();
    (text, shift(span.start)..shift(span.end))
}

/// A column of a spreadsheet, from 1: A, B, ... Z, AA.
fn letters(mut column: usize) -> String {
    let mut letters = Vec::new();
    while column > 0 {
        letters.push(b"ABCDEFGHIJKLMNOPQRSTUVWXYZ"[(column - 1) % 26]);
        column = (column - 1) / 26;
    }
    letters.iter().rev().map(|byte| char::from(*byte)).collect()
}

/// Cells of a row, and their places. One is reused for every row of a table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Row {
    place: Place,
    /// The line of a text as it is; after it, cells that are not verbatim in the line.
    buffer: String,
    /// Length of that line.
    line: usize,
    cells: Vec<CellRange>,
    /// From which cell on they come from another file's row, with that file and row.
    joined: Option<(usize, Arc<str>, Place)>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct CellRange {
    /// In the buffer.
    text: Range<usize>,
    /// In the line, quotes included.
    span: Range<usize>,
}

impl Default for Row {
    fn default() -> Self {
        Self { place: Place::Line(0), buffer: String::new(), line: 0, cells: Vec::new(), joined: None }
    }
}

impl Row {
    /// Empties it for a row at this place.
    pub fn start(&mut self, place: Place) {
        self.place = place;
        self.buffer.clear();
        self.line = 0;
        self.cells.clear();
        self.joined = None;
    }

    /// Adds a cell; blanks around it are not part of it.
    pub fn push(&mut self, text: &str) {
        self.push_at(text.trim(), 0..0);
    }

    /// The same of a cell at a place in the line.
    pub(super) fn push_at(&mut self, text: &str, span: Range<usize>) {
        let start = self.buffer.len();
        self.buffer.push_str(text);
        self.cells.push(CellRange { text: start..self.buffer.len(), span });
    }

    /// Empties it for a line of a text at this place.
    pub(super) fn start_line(&mut self, number: u64, line: &str) {
        self.start(Place::Line(number));
        self.buffer.push_str(line);
        self.line = line.len();
    }

    /// The line as it stands in the text.
    pub(super) fn line(&self) -> &str {
        &self.buffer[..self.line]
    }

    /// The line, to be cut while there are no cells.
    pub(super) fn line_mut(&mut self) -> &mut String {
        &mut self.buffer
    }

    /// Cuts the line at every delimiter byte; blanks around a cell are not part of it. `runs` of delimiters count as one, and those at the ends
    /// are ignored. For lines of ASCII without quotes, the usual case.
    pub(super) fn cut(&mut self, is_delimiter: impl Fn(u8) -> bool, runs: bool) {
        let bytes = self.buffer.as_bytes();
        let is_blank = |byte: u8| matches!(byte, b' ' | b'\t') && !is_delimiter(byte);
        let mut start = 0;
        loop {
            let length = bytes[start..].iter().position(|byte| is_delimiter(*byte));
            let end = length.map_or(bytes.len(), |length| start + length);
            let (mut from, mut to) = (start, end);
            while from < to && is_blank(bytes[from]) {
                from += 1;
            }
            while from < to && is_blank(bytes[to - 1]) {
                to -= 1;
            }
            if !runs || from < to {
                self.cells.push(CellRange { text: from..to, span: from..to });
            }
            if length.is_none() {
                return;
            }
            start = end + 1;
        }
    }

    /// Adds what stands behind the line.
    pub(super) fn append(&mut self, behind: &str) {
        self.buffer.push_str(behind);
    }

    /// Adds a cell whose text is not in the line, which is `line` long and taken out, but follows it.
    pub(super) fn push_behind(&mut self, text: &str, line: usize, span: Range<usize>) {
        let start = line + self.buffer.len();
        self.buffer.push_str(text);
        self.cells.push(CellRange { text: start..start + text.len(), span });
    }

    /// Adds a cell that stands in the line as it is.
    pub(super) fn push_span(&mut self, text: Range<usize>, span: Range<usize>) {
        self.cells.push(CellRange { text, span });
    }

    /// Where the row is.
    pub fn place(&self) -> &Place {
        &self.place
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.cells.len()
    }

    /// Whether all cells are empty.
    pub fn is_empty(&self) -> bool {
        self.cells.iter().all(|cell| cell.text.is_empty())
    }

    /// Text of a cell, from 0.
    pub fn cell(&self, column: usize) -> Option<&str> {
        self.cells.get(column).map(|cell| &self.buffer[cell.text.clone()])
    }

    /// All cells.
    pub fn cells(&self) -> impl Iterator<Item = &str> {
        self.cells.iter().map(|cell| &self.buffer[cell.text.clone()])
    }

    /// Makes it `count` cells long, by adding empty ones or removing some.
    pub(super) fn resize(&mut self, count: usize) {
        let end = self.line;
        self.cells.resize(count, CellRange { text: 0..0, span: end..end });
    }

    /// Adds the cells of a row of another file.
    pub(super) fn join(&mut self, file: &Arc<str>, other: &Self) {
        self.joined = Some((self.cells.len(), Arc::clone(file), other.place.clone()));
        for cell in other.cells() {
            self.push_at(cell, 0..0);
        }
    }

    /// An error at a cell of this row of the file `name`, or at the whole row.
    pub fn refuse(
        &self,
        name: &str,
        column: Option<usize>,
        message: impl fmt::Display,
        expected: &str,
    ) -> InputError {
        let help = Some(format!("expected {expected}"));
        let joined = self.joined.as_ref().filter(|(first, ..)| column.is_some_and(|column| column >= *first));
        if let (Some((first, file, place)), Some(column)) = (joined, column) {
            return InputError::Place {
                place: place.of_cell(file, column - first),
                message: message.to_string(),
                help,
            };
        }
        match self.place {
            Place::Line(number) => {
                // An empty cell has nothing to underline.
                let span = column.and_then(|column| self.cells.get(column)).map(|cell| cell.span.clone());
                let span = span.filter(|span| !span.is_empty()).unwrap_or(0..self.line);
                let first_line = usize::try_from(number).unwrap_or(usize::MAX);
                let (text, span) = near(self.line(), span);
                InputError::in_excerpt(name, Excerpt::new(text, first_line), span, message, help)
            }
            _ => {
                let place = column.map_or_else(|| self.place.of(name), |c| self.place.of_cell(name, c));
                InputError::Place { place, message: message.to_string(), help }
            }
        }
    }
}

/// Rows that are in memory.
#[derive(Debug, Clone, Default)]
pub struct MemoryRows {
    name: String,
    rows: std::vec::IntoIter<(Place, Vec<String>)>,
    remarks: Vec<String>,
}

impl MemoryRows {
    /// Rows of a file, each with its place and its cells.
    pub fn new(name: impl Into<String>, rows: Vec<(Place, Vec<String>)>) -> Self {
        Self { name: name.into(), rows: rows.into_iter(), remarks: Vec::new() }
    }

    /// The same with remarks on them.
    #[must_use]
    pub fn with_remarks(self, remarks: Vec<String>) -> Self {
        Self { remarks, ..self }
    }
}

impl Rows for MemoryRows {
    fn name(&self) -> &str {
        &self.name
    }

    fn next_row(&mut self, row: &mut Row) -> Result<bool, InputError> {
        let Some((place, cells)) = self.rows.next() else { return Ok(false) };
        row.start(place);
        for cell in &cells {
            row.push(cell);
        }
        Ok(true)
    }

    fn remarks(&self) -> Vec<String> {
        self.remarks.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_a_long_line_what_is_near_is_shown() {
        let line = format!("{}é,x1,{}", "1,".repeat(5000), "2,é".repeat(5000));
        let at = line.find("x1").expect("there");
        let (text, span) = near(&line, at..at + 2);
        assert_eq!(&text[span], "x1");
        assert!(text.len() < 400 && text.starts_with('…') && text.ends_with('…'), "{text}");
        let (text, span) = near(&line, 0..line.len());
        assert!(text.len() < 800 && text.get(span).is_some(), "{text}");
        assert_eq!(near("1,2", 2..3), ("1,2".to_owned(), 2..3));
    }

    #[test]
    fn a_cell_of_a_sheet_is_called_as_people_call_it() {
        assert_eq!([1, 26, 27, 52, 703].map(letters), ["A", "Z", "AA", "AZ", "AAA"]);
        let place = Place::Sheet { sheet: "Points".into(), row: 7, first_column: 2 };
        let mut rows = MemoryRows::new("book.xlsx", vec![(place, vec![" a ".to_owned(), "b".to_owned()])]);
        let mut row = Row::default();
        assert!(rows.next_row(&mut row).expect("in memory"));
        assert_eq!((row.cell(0), row.cell(1), row.cell(2)), (Some("a"), Some("b"), None));
        let refused = row.refuse("book.xlsx", Some(1), "column y is \"b\"", "a number");
        assert_eq!(refused.to_string(), "book.xlsx, sheet Points, cell C7: column y is \"b\"");
        assert!(!rows.next_row(&mut row).expect("the end"));
    }
}
