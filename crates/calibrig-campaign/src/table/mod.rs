//! Tables of rows in Parquet: written group by group, so that a table of any length takes the same memory, and read back the same way.
//!
//! The bytes of a table depend only on its rows and what is stated about it: every group but the last has the same number of rows, which
//! follows from the number of columns; there is no clock, machine name or number of threads in it.

mod columns;
mod read;
mod write;

pub use read::TableReader;
pub use write::{StagedTable, TableWriter};
pub(crate) use write::{TEMPORARY, hexadecimal, sync_folder_of};

use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// What a column holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// 64 bits, signed.
    Integer,
    /// A double.
    Number,
    /// UTF-8.
    Text,
}

/// A column; every cell may be absent.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Column {
    /// Unique in its table; includes the unit.
    pub name: String,
    /// What it holds.
    pub kind: Kind,
}

impl Column {
    /// A column.
    pub fn new(name: impl Into<String>, kind: Kind) -> Self {
        Self { name: name.into(), kind }
    }
}

/// A cell of a row.
#[derive(Debug, Clone, PartialEq)]
pub enum Cell {
    /// Unknown.
    Absent,
    /// Of a column of integers.
    Integer(i64),
    /// Of a column of numbers.
    Number(f64),
    /// Of a column of texts.
    Text(String),
}

impl Cell {
    /// A number, or nothing.
    pub fn number(value: Option<f64>) -> Self {
        value.map_or(Self::Absent, Self::Number)
    }

    /// A text.
    pub fn text(value: impl Into<String>) -> Self {
        Self::Text(value.into())
    }

    /// A count; absent beyond 2^63.
    pub fn count(value: impl TryInto<i64>) -> Self {
        value.try_into().map_or(Self::Absent, Self::Integer)
    }

    /// As a number, if it is one.
    #[allow(clippy::cast_precision_loss)]
    pub fn as_number(&self) -> Option<f64> {
        match self {
            Self::Number(value) => Some(*value),
            Self::Integer(value) => Some(*value as f64),
            Self::Absent | Self::Text(_) => None,
        }
    }

    /// As a text, if it is one.
    pub fn as_text(&self) -> Option<&str> {
        match self {
            Self::Text(text) => Some(text),
            _ => None,
        }
    }
}

/// Rows that can be visited repeatedly.
pub trait Table {
    /// Its columns.
    fn columns(&self) -> &[Column];

    /// Number of its rows.
    fn rows(&self) -> u64;

    /// Visits some cells of the rows of a range, in order: those of the columns `wanted`, in that order.
    ///
    /// # Errors
    ///
    /// It cannot be read.
    fn visit(
        &self,
        wanted: &[usize],
        rows: Range<u64>,
        show: &mut dyn FnMut(&[Cell]),
    ) -> Result<(), TableError>;

    /// Index of the column of that name.
    fn place_of(&self, name: &str) -> Option<usize> {
        self.columns().iter().position(|column| column.name == name)
    }
}

/// A table in memory.
#[derive(Debug, Clone, PartialEq)]
pub struct MemoryTable {
    columns: Vec<Column>,
    rows: Vec<Vec<Cell>>,
}

impl MemoryTable {
    /// Rows of one cell per column; missing cells are absent.
    pub fn new(columns: Vec<Column>, rows: Vec<Vec<Cell>>) -> Self {
        Self { columns, rows }
    }
}

impl Table for MemoryTable {
    fn columns(&self) -> &[Column] {
        &self.columns
    }

    fn rows(&self) -> u64 {
        self.rows.len() as u64
    }

    fn visit(
        &self,
        wanted: &[usize],
        rows: Range<u64>,
        show: &mut dyn FnMut(&[Cell]),
    ) -> Result<(), TableError> {
        for (place, row) in (0..).zip(&self.rows) {
            if rows.contains(&place) {
                let cell = |column: &usize| row.get(*column).cloned().unwrap_or(Cell::Absent);
                show(&wanted.iter().map(cell).collect::<Vec<_>>());
            }
        }
        Ok(())
    }
}

/// A table that cannot be written or read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum TableError {
    /// An error of the file system.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file or folder.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Not a readable table, or one that cannot be written.
    #[error("{}: {reason}", path.display())]
    Parquet {
        /// Which file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// A row that does not fit this table.
    #[error("{}: a row has {cells} cells for {columns} columns, or a cell of the wrong kind", path.display())]
    Row {
        /// Which file.
        path: PathBuf,
        /// Cells of the row.
        cells: usize,
        /// Columns of the table.
        columns: usize,
    },
}

impl TableError {
    pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        move |source| Self::Io { path: path.to_path_buf(), source }
    }

    pub(crate) fn parquet(path: &Path) -> impl Fn(parquet::errors::ParquetError) -> Self + '_ {
        move |error| {
            // Errors of the disk (no space, no permission) come wrapped.
            match error {
                parquet::errors::ParquetError::External(inner) => match inner.downcast::<std::io::Error>() {
                    Ok(source) => Self::Io { path: path.to_path_buf(), source: *source },
                    Err(other) => Self::Parquet { path: path.to_path_buf(), reason: other.to_string() },
                },
                other => Self::Parquet { path: path.to_path_buf(), reason: other.to_string() },
            }
        }
    }
}

/// Least number of cells in a group of rows: some 32 MB.
const CELLS_A_GROUP: usize = 4 << 20;
/// Most rows of a group, however narrow.
const LEAST_ROWS_A_GROUP: usize = 1024;

/// Rows of every group but the last.
fn rows_a_group(columns: usize) -> usize {
    (CELLS_A_GROUP / columns.max(1)).max(LEAST_ROWS_A_GROUP)
}

#[cfg(test)]
mod tests;
