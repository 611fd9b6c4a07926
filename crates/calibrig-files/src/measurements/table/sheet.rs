//! Sheets of XLSX files.

mod unpacked;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::Path;
use std::sync::Arc;

use calamine::{DataRef, Dimensions, ExcelDateTime, Reader, SheetType, SheetVisible, Xlsx, XlsxError};

use self::unpacked::{TooLarge, too_large};
use super::{Table, TableRow, counted, number_text};
use crate::input::InputError;
use crate::measurements::rows::Place;

/// Most cells of a table, including empty ones between others: within memory, and more than any session has.
const MOST_CELLS: usize = 20_000_000;
/// Bytes that the texts of all cells may take together: one text may stand in a million cells.
const MOST_TEXT: usize = 1 << 29;
/// Characters of a cell, rows and columns of a sheet, by its specification.
const LONGEST_CELL: usize = 32_767;
const LAST_ROW: u32 = 1_048_576;
const LAST_COLUMN: u32 = 16_384;

/// Reads a sheet of the XLSX file at `path`: the one named `sheet`, else the first visible one, with a remark if there are others.
///
/// Numbers are those of the file, to the bit. Dates, truth values and errors become texts, so that a column of numbers refuses them at their cell;
/// they are reported. A formula has the value that the file stores for it. In merged cells the first has the text, and so do those below it in the
/// same column.
///
/// # Errors
/// Errors if the file cannot be read, is not an XLSX file, or has no such sheet.
pub fn read_sheet(path: &Path, sheet: Option<&str>) -> Result<Table, InputError> {
    let file = File::open(path).map_err(|error| unreadable(path, error.to_string()))?;
    let name = path.display().to_string();
    sheet_of(BufReader::new(file), &name, sheet).map_err(|trouble| match trouble {
        Trouble::Xlsx(error) => unreadable(path, words(&error)),
        Trouble::Input(error) => error,
    })
}

fn unreadable(path: &Path, reason: String) -> InputError {
    InputError::Unreadable { path: path.to_path_buf(), reason }
}

enum Trouble {
    Xlsx(XlsxError),
    Input(InputError),
}

impl From<XlsxError> for Trouble {
    fn from(error: XlsxError) -> Self {
        Self::Xlsx(error)
    }
}

/// What is wrong with a file, for people.
fn words(error: &XlsxError) -> String {
    match error {
        XlsxError::Password => "the spreadsheet is protected by a password: save it without".to_owned(),
        XlsxError::Zip(_) | XlsxError::FileNotFound(_) => {
            format!(
                "it is not a readable XLSX file, or is damaged ({error}): save it again as XLSX, or its sheet as CSV"
            )
        }
        error => format!("the spreadsheet is damaged ({error}): save it again as XLSX, or its sheet as CSV"),
    }
}

fn sheet_of<R: Read + Seek>(mut file: R, name: &str, wanted: Option<&str>) -> Result<Table, Trouble> {
    let refuse = |message: String, help: String| {
        Trouble::Input(InputError::Place { place: name.to_owned(), message, help: Some(help) })
    };
    if let Some(TooLarge { part, most }) = too_large(&mut file) {
        return Err(refuse(
            format!("its part {part} unpacks to more than {} MiB, too much for a table of measurements", most >> 20),
            "expected a spreadsheet with only the measurements: copy their sheet into a new file, or save it as CSV".to_owned(),
        ));
    }
    let mut book = Xlsx::new(file)?;
    let sheets: Vec<_> =
        book.sheets_metadata().iter().filter(|sheet| sheet.typ == SheetType::WorkSheet).collect();
    let names: Vec<String> = sheets.iter().map(|sheet| sheet.name.clone()).collect();
    let chosen = match wanted {
        Some(wanted) => names.iter().position(|name| name == wanted).ok_or_else(|| {
            refuse(format!("there is no sheet {wanted}"), format!("expected one of: {}", names.join(", ")))
        })?,
        None => {
            let shown = sheets.iter().position(|sheet| sheet.visible == SheetVisible::Visible);
            shown.or(if names.is_empty() { None } else { Some(0) }).ok_or_else(|| {
                refuse("every sheet is empty".to_owned(), "expected a sheet with a table".to_owned())
            })?
        }
    };
    let sheet: Arc<str> = names[chosen].as_str().into();
    let mut remarks = Vec::new();
    if wanted.is_none() && names.len() > 1 {
        let others = names.iter().filter(|name| **name != *sheet).cloned().collect::<Vec<_>>().join(", ");
        remarks.push(format!(
            "{name}: sheet {sheet} is read; the others, {others}, are not (--sheet NAME chooses)"
        ));
    }
    let merged = book.merge_cells_by_sheet_name(&sheet)?;
    let mut cells = Cells::default();
    let mut reader = book.worksheet_cells_reader(&sheet)?;
    while let Some(cell) = reader.next_cell_with_formula_metadata()? {
        if cell.pos.0 >= LAST_ROW || cell.pos.1 >= LAST_COLUMN {
            let place = format!(
                "{name}, sheet {sheet}, row {}, column {}",
                u64::from(cell.pos.0) + 1,
                u64::from(cell.pos.1) + 1
            );
            let message = "no sheet can have so many rows and columns".to_owned();
            let help = Some("save it again as XLSX, or the sheet as CSV".to_owned());
            return Err(Trouble::Input(InputError::Place { place, message, help }));
        }
        cells.take(cell.pos, &cell.value, cell.formula.is_some()).map_err(|why| {
            let place = format!("{name}, sheet {sheet}, cell {}", cell_name(cell.pos));
            let help = Some("expected a sheet with only the measurements: copy them into a new file, or save the sheet as CSV".to_owned());
            Trouble::Input(InputError::Place { place, message: why.to_owned(), help })
        })?;
    }
    let too_large = || {
        refuse(
            format!("sheet {sheet} is too large"),
            format!("expected at most {MOST_CELLS} cells between the first and the last filled one"),
        )
    };
    cells.fill_down(&merged).ok_or_else(too_large)?;
    remarks.extend(cells.remarks(name, &sheet, &merged));
    let rows = cells.rows(&sheet).ok_or_else(too_large)?;
    Ok(Table { name: name.to_owned(), rows, remarks })
}

/// Cells with something in them, as texts.
#[derive(Default)]
struct Cells {
    rows: BTreeMap<u32, BTreeMap<u32, String>>,
    odd: Vec<(Odd, usize, (u32, u32))>,
    count: usize,
    /// Bytes of all texts.
    bytes: usize,
}

/// Cells that are neither numbers nor text.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Odd {
    Date,
    Truth,
    Error,
    NoValue,
}

impl Odd {
    fn words(self) -> &'static str {
        match self {
            Self::Date => "a date or a time, not a number",
            Self::Truth => "a truth value, not a number",
            Self::Error => "an error",
            Self::NoValue => {
                "a formula without its value: open the file in a spreadsheet program and save it there"
            }
        }
    }
}

impl Cells {
    /// Adds a cell, or says why that is too much.
    fn take(
        &mut self,
        (row, column): (u32, u32),
        value: &DataRef<'_>,
        is_formula: bool,
    ) -> Result<(), &'static str> {
        if let DataRef::String(text) = value
            && text.len() > 4 * LONGEST_CELL
        {
            return Err("a text of more than 32767 characters, the limit of a cell");
        }
        if let DataRef::SharedString(text) = value
            && text.len() > 4 * LONGEST_CELL
        {
            return Err("a text of more than 32767 characters, the limit of a cell");
        }
        let (text, odd) = match value {
            DataRef::Int(number) => (number.to_string(), None),
            DataRef::Float(number) => (number_text(*number), None),
            DataRef::String(text) => (text.clone(), None),
            DataRef::SharedString(text) => ((*text).to_owned(), None),
            DataRef::Bool(truth) => (if *truth { "TRUE" } else { "FALSE" }.to_owned(), Some(Odd::Truth)),
            DataRef::DateTime(time) => (time_text(*time), Some(Odd::Date)),
            DataRef::DateTimeIso(text) | DataRef::DurationIso(text) => (text.clone(), Some(Odd::Date)),
            DataRef::Error(error) => (error.to_string(), Some(Odd::Error)),
            DataRef::Empty if is_formula => ("formula without value".to_owned(), Some(Odd::NoValue)),
            DataRef::Empty => return Ok(()),
        };
        // A line break in a header's cell would be one in its name.
        let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
        if text.is_empty() {
            return Ok(());
        }
        self.count += 1;
        self.bytes += text.len();
        if self.count > MOST_CELLS || self.bytes > MOST_TEXT {
            return Err(
                "with this cell the sheet is too large: more than twenty million cells, or 512 MiB of text",
            );
        }
        if let Some(odd) = odd {
            match self.odd.iter_mut().find(|(known, ..)| *known == odd) {
                Some((_, count, _)) => *count += 1,
                None => self.odd.push((odd, 1, (row, column))),
            }
        }
        self.rows.entry(row).or_default().insert(column, text);
        Ok(())
    }

    /// The content of a downward merged region applies to every row of it; `None` if that is too much, as only overlapping regions
    /// can be.
    fn fill_down(&mut self, merged: &[Dimensions]) -> Option<()> {
        let mut left = MOST_CELLS;
        for Dimensions { start, end } in merged {
            let Some(text) = self.rows.get(&start.0).and_then(|row| row.get(&start.1)).cloned() else {
                continue;
            };
            // Rows that hold nothing else are left out.
            let below = (std::ops::Bound::Excluded(start.0), std::ops::Bound::Included(end.0.max(start.0)));
            for (_, row) in self.rows.range_mut(below) {
                left = left.checked_sub(1)?;
                self.bytes += text.len();
                row.entry(start.1).or_insert_with(|| text.clone());
            }
            if self.bytes > MOST_TEXT {
                return None;
            }
        }
        Some(())
    }

    fn remarks(&self, name: &str, sheet: &str, merged: &[Dimensions]) -> Vec<String> {
        let mut remarks = Vec::new();
        for (odd, count, first) in &self.odd {
            let others =
                if *count == 1 { String::new() } else { format!(" and {} more", counted(count - 1, "cell")) };
            remarks.push(format!("{name}: {sheet}!{}{others}: {}", cell_name(*first), odd.words()));
        }
        let held = |region: &&Dimensions| {
            self.rows.get(&region.start.0).is_some_and(|row| row.contains_key(&region.start.1))
        };
        let wide: Vec<_> =
            merged.iter().filter(held).filter(|region| region.end.1 > region.start.1).collect();
        if let Some(region) = wide.first() {
            let range = format!("{}:{}", cell_name(region.start), cell_name(region.end));
            let more = if wide.len() > 1 { format!(" and {} more", wide.len() - 1) } else { String::new() };
            remarks.push(format!(
                "{name}: {sheet}!{range}{more}: merged cells; their content is taken for their first column only"
            ));
        }
        remarks
    }

    /// Rows from the first used column on; `None` if they have too many cells.
    fn rows(self, sheet: &Arc<str>) -> Option<Vec<TableRow>> {
        let first = self.rows.values().filter_map(|row| row.keys().next()).min().copied().unwrap_or(0);
        let width = |row: &BTreeMap<u32, String>| {
            row.keys().next_back().map_or(0, |last| (last - first + 1) as usize)
        };
        if self.rows.values().map(width).sum::<usize>() > MOST_CELLS {
            return None;
        }
        let row = |(row, cells): (u32, BTreeMap<u32, String>)| {
            let mut texts = vec![String::new(); width(&cells)];
            for (column, text) in cells {
                texts[(column - first) as usize] = text;
            }
            let place = Place::Sheet { sheet: Arc::clone(sheet), row: row + 1, first_column: first + 1 };
            TableRow { place, cells: texts }
        };
        Some(self.rows.into_iter().map(row).collect())
    }
}

/// As a spreadsheet calls a cell: C7.
fn cell_name((row, column): (u32, u32)) -> String {
    let mut letters = Vec::new();
    let mut rest = u64::from(column) + 1;
    while rest > 0 {
        letters.push(char::from(b'A' + u8::try_from((rest - 1) % 26).unwrap_or(0)));
        rest = (rest - 1) / 26;
    }
    let letters: String = letters.iter().rev().collect();
    format!("{letters}{}", u64::from(row) + 1)
}

/// A date as people write it, and a length of time in hours.
fn time_text(time: ExcelDateTime) -> String {
    if time.is_duration() {
        let seconds = 86_400.0 * time.as_f64();
        return format!(
            "{}:{:02}:{:06.3} h",
            (seconds / 3600.0).trunc(),
            (seconds / 60.0).trunc().abs() % 60.0,
            seconds.abs() % 60.0
        );
    }
    let (year, month, day, hour, minute, second, milli) = time.to_ymd_hms_milli();
    // A time of the day without a date.
    if (0.0..1.0).contains(&time.as_f64()) {
        return format!("{hour:02}:{minute:02}:{second:02}.{milli:03}");
    }
    format!("{year:04}-{month:02}-{day:02} {hour:02}:{minute:02}:{second:02}.{milli:03}")
}

/// What a table in memory is read as: for tests.
#[cfg(test)]
pub(super) fn parse_sheet(bytes: &[u8], name: &str, sheet: Option<&str>) -> Result<Table, String> {
    sheet_of(std::io::Cursor::new(bytes), name, sheet).map_err(|trouble| match trouble {
        Trouble::Xlsx(error) => words(&error),
        Trouble::Input(error) => error.to_string(),
    })
}
