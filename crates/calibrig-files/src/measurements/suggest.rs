//! A column map from what is found in files: every guess with its reason, and no decision that the files do not
//! support.

mod apart;
mod column;
mod names;
mod payload;
mod rotation;
mod surroundings;
mod told;
mod triples;
mod widths;
mod written;

use std::path::Path;

use self::column::{Numbers, Role, SeenColumn};
use super::cells::Delimiter;
use super::columns::RowOptions;
use super::layout::{Decimal, Table, Wanted};
use super::open::{is_bag, open};
use super::rows::{Place, Row};
use super::text::TextFormat;
use super::times::{self, Dates};
use crate::input::InputError;

/// More columns than a table of measurements has.
const MOST_COLUMNS: usize = 2000;

/// A column map that was suggested.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SuggestedMap {
    /// The map, with reasons as comments. If a person must decide something, its key is in a comment.
    pub text: String,
    /// What must be decided before the map can be used.
    pub open: Vec<String>,
}

/// Findings in one file.
pub(super) struct SeenFile {
    pub name: String,
    pub has_header: bool,
    /// In rad and m.
    pub is_bag: bool,
    pub decimal: Decimal,
    pub dates: Dates,
    /// A cell of numbers with nothing between them, as in fixed widths.
    pub glued: Option<String>,
    /// Characters of each column, by which such cells are cut.
    pub widths: Option<Vec<usize>>,
    pub rows: u64,
    pub columns: Vec<SeenColumn>,
    /// Comments of the file that name units, with their places.
    pub unit_comments: Vec<(String, String)>,
    pub found: Vec<String>,
}

/// Suggests a column map for one file, or for several that belong together: joints in one and points in others, or one file per
/// target. Of the options, only the sheet and those of a bag are used.
///
/// # Errors
/// Errors if a file cannot be read as rows.
pub fn suggest_columns(paths: &[&Path], options: &RowOptions) -> Result<SuggestedMap, InputError> {
    let mut files = paths.iter().map(|path| look_at(path, options)).collect::<Result<Vec<_>, _>>()?;
    apart::see_together(&mut files);
    Ok(written::map_of(&files))
}

/// Reads a file, cut at fixed widths if necessary.
fn look_at(path: &Path, options: &RowOptions) -> Result<SeenFile, InputError> {
    let seen = look_as(path, &TextFormat::default(), options)?;
    if seen.glued.is_none() {
        return Ok(seen);
    }
    let Some(widths) = widths::of_file(path) else { return Ok(seen) };
    let format = TextFormat { delimiter: Some(Delimiter::Widths(widths.clone())), ..TextFormat::default() };
    match look_as(path, &format, options) {
        Ok(cut) if cut.glued.is_none() && cut.rows >= seen.rows && cut.columns.len() == widths.len() => {
            Ok(SeenFile { glued: seen.glued, widths: Some(widths), ..cut })
        }
        _ => Ok(seen),
    }
}

/// Reads all rows of a file and keeps what characterises its columns.
fn look_as(path: &Path, format: &TextFormat, options: &RowOptions) -> Result<SeenFile, InputError> {
    let rows = open(path, format, &Wanted::default(), options)?;
    let mut table = Table::find_any(rows)?;
    if table.columns.len() > MOST_COLUMNS {
        return Err(InputError::Place {
            place: table.name().to_owned(),
            message: format!("its rows have {} columns", table.columns.len()),
            help: Some(format!(
                "expected a table of measurements: one row per reading, with at most {MOST_COLUMNS} columns"
            )),
        });
    }
    let mut columns: Vec<SeenColumn> =
        table.columns.iter().enumerate().map(|(index, column)| SeenColumn::new(index, column)).collect();
    let (mut row, mut rows, mut ragged, mut glued) = (Row::default(), 0, None, None);
    while table.next_row(&mut row)? {
        rows += 1;
        if row.len() < columns.len() && ragged.is_none() && !matches!(row.place(), Place::Sheet { .. }) {
            ragged = Some(row.place().of(table.name()));
        }
        for (column, cell) in columns.iter_mut().zip(row.cells()) {
            column.see(cell, table.decimal);
        }
        if glued.is_none() {
            glued = row.cells().find(|cell| is_glued(cell, table.decimal)).map(str::to_owned);
        }
    }
    if columns.iter().all(|column| column.numbers.count == 0) {
        // Which sheet was read, if there are others.
        let sheets = table.remarks().into_iter().find(|remark| remark.contains("--sheet"));
        let sheets = sheets.map_or_else(String::new, |sheets| format!("; {sheets}"));
        return Err(InputError::Place {
            place: table.name().to_owned(),
            message: "it has no row of numbers".to_owned(),
            help: Some(format!("expected one row of numbers per measurement{sheets}")),
        });
    }
    let unit_comments = table
        .comments()
        .iter()
        .filter(|(_, text)| text.to_ascii_lowercase().contains("unit"))
        .map(|(line, text)| (format!("{}:{line}", table.name()), text.clone()))
        .collect();
    let mut found = table.remarks();
    found.extend(ragged.map(|place| format!("{place}: this row has fewer cells than the first")));
    if is_bag(path) {
        column::give_roles_of_a_bag(&mut columns);
    } else {
        column::give_roles(&mut columns, table.has_header, rows);
    }
    Ok(SeenFile {
        name: path.display().to_string(),
        has_header: table.has_header,
        is_bag: is_bag(path),
        decimal: table.decimal,
        dates: table.dates.clone(),
        glued,
        widths: None,
        rows,
        columns,
        unit_comments,
        found,
    })
}

/// Whether a cell is several numbers: `-38.4012-150.3`.
fn is_glued(cell: &str, decimal: Decimal) -> bool {
    let fractions = cell.matches('.').count();
    fractions > 1
        && cell.bytes().all(|byte| byte.is_ascii_digit() || b".+-eE".contains(&byte))
        && cell.len() > 10
        && matches!(times::look_at(cell, decimal), times::Look::Nothing)
}

impl SeenFile {
    /// Columns of a role, in their order.
    pub fn with(&self, role: Role) -> Vec<&SeenColumn> {
        let mut columns: Vec<_> = self.columns.iter().filter(|column| column.role == Some(role)).collect();
        columns.sort_by_key(|column| column.order);
        columns
    }

    pub fn one(&self, role: Role) -> Option<&SeenColumn> {
        self.columns.iter().find(|column| column.role == Some(role))
    }

    /// Columns of the orientation next to the position, in their order.
    pub fn turn(&self) -> Vec<&SeenColumn> {
        let mut columns: Vec<_> = self.columns.iter().filter(|column| column.is_beside).collect();
        columns.sort_by_key(|column| column.order);
        columns
    }

    /// What is not used.
    pub fn unused(&self) -> impl Iterator<Item = &SeenColumn> {
        self.columns.iter().filter(|column| column.role.is_none())
    }

    /// Numbers of some columns together.
    pub fn numbers_of(columns: &[&SeenColumn]) -> Numbers {
        columns.iter().fold(Numbers::default(), |all, column| all.with(&column.numbers))
    }
}

#[cfg(test)]
mod tests;
