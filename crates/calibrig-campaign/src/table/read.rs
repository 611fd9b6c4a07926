//! Reading.

use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};

use parquet::basic::Type as Physical;
use parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use parquet::data_type::DataType;
use parquet::errors::ParquetError;
use parquet::file::reader::{FileReader, SerializedFileReader};

use super::columns::{ColumnRows, Values};
use super::{Cell, Column, Kind, Table, TableError};

/// A table in a file.
pub struct TableReader {
    path: PathBuf,
    file: SerializedFileReader<File>,
    columns: Vec<Column>,
}

impl TableReader {
    /// Opens a table as [`TableWriter`](super::TableWriter) writes them.
    pub fn open(path: &Path) -> Result<Self, TableError> {
        let file = File::open(path).map_err(TableError::io(path))?;
        let file = SerializedFileReader::new(file).map_err(TableError::parquet(path))?;
        let columns = file
            .metadata()
            .file_metadata()
            .schema_descr()
            .columns()
            .iter()
            .map(|column| {
                let kind = match column.physical_type() {
                    Physical::INT64 => Kind::Integer,
                    Physical::DOUBLE => Kind::Number,
                    Physical::BYTE_ARRAY => Kind::Text,
                    other => {
                        return Err(format!("column {} has the unsupported type {other}", column.name()));
                    }
                };
                if column.max_def_level() != 1 || column.max_rep_level() != 0 {
                    return Err(format!("column {} is not a plain column of optional values", column.name()));
                }
                Ok(Column::new(column.name(), kind))
            })
            .collect::<Result<_, _>>()
            .map_err(|reason| TableError::Parquet { path: path.to_path_buf(), reason })?;
        Ok(Self { path: path.to_path_buf(), file, columns })
    }

    /// What is stated about it under `key`.
    pub fn about(&self, key: &str) -> Option<&str> {
        let entries = self.file.metadata().file_metadata().key_value_metadata()?;
        entries.iter().find(|entry| entry.key == key)?.value.as_deref()
    }

    /// Shows every row, in order; holds one group of rows at a time.
    pub fn for_each_row<E: From<TableError>>(
        &self,
        mut show: impl FnMut(&[Cell]) -> Result<(), E>,
    ) -> Result<(), E> {
        let all: Vec<usize> = (0..self.columns.len()).collect();
        let mut failed = None;
        for group in 0..self.file.num_row_groups() {
            self.show_group(group, &all, |row| {
                if failed.is_none() {
                    failed = show(row).err();
                }
            })?;
            if let Some(error) = failed {
                return Err(error);
            }
        }
        Ok(())
    }

    /// Shows some cells of all rows of a group.
    fn show_group(
        &self,
        group: usize,
        wanted: &[usize],
        mut show: impl FnMut(&[Cell]),
    ) -> Result<(), TableError> {
        let columns =
            wanted.iter().map(|column| self.group(group, *column)).collect::<Result<Vec<_>, _>>()?;
        let rows = columns.first().map_or(0, |column| column.levels.len());
        let mut cells: Vec<_> = columns.iter().map(ColumnRows::cells).collect();
        let mut row = vec![Cell::Absent; wanted.len()];
        for _ in 0..rows {
            for (cell, next) in row.iter_mut().zip(&mut cells) {
                *cell = next.next().unwrap_or(Cell::Absent);
            }
            show(&row);
        }
        Ok(())
    }

    /// A column in a group of rows.
    fn group(&self, group: usize, column: usize) -> Result<ColumnRows, TableError> {
        let failed = TableError::parquet(&self.path);
        let group = self.file.get_row_group(group).map_err(&failed)?;
        let rows = usize::try_from(group.metadata().num_rows()).unwrap_or(0);
        let mut read = match group.get_column_reader(column).map_err(&failed)? {
            ColumnReader::Int64ColumnReader(reader) => all(reader, rows, Values::Integer),
            ColumnReader::DoubleColumnReader(reader) => all(reader, rows, Values::Number),
            ColumnReader::ByteArrayColumnReader(reader) => all(reader, rows, Values::Text),
            _ => Err(ParquetError::General(format!("column {column} has the wrong type"))),
        }
        .map_err(&failed)?;
        // A shorter one would shift its neighbours.
        if read.levels.len() != rows {
            let reason = format!("column {column} has {} rows of {rows}", read.levels.len());
            return Err(TableError::Parquet { path: self.path.clone(), reason });
        }
        read.levels.shrink_to_fit();
        Ok(read)
    }
}

impl Table for TableReader {
    fn columns(&self) -> &[Column] {
        &self.columns
    }

    fn rows(&self) -> u64 {
        self.file.metadata().file_metadata().num_rows().try_into().unwrap_or(0)
    }

    fn visit(
        &self,
        wanted: &[usize],
        rows: Range<u64>,
        show: &mut dyn FnMut(&[Cell]),
    ) -> Result<(), TableError> {
        let mut first = 0;
        for group in 0..self.file.num_row_groups() {
            let count = self.file.metadata().row_group(group).num_rows().try_into().unwrap_or(0);
            let own = first..first + count;
            first = own.end;
            if own.end <= rows.start || own.start >= rows.end {
                continue;
            }
            let mut place = own.start;
            self.show_group(group, wanted, |row| {
                if rows.contains(&place) {
                    show(row);
                }
                place += 1;
            })?;
        }
        Ok(())
    }
}

fn all<T: DataType>(
    mut reader: ColumnReaderImpl<T>,
    rows: usize,
    make: impl FnOnce(Vec<T::T>) -> Values,
) -> Result<ColumnRows, ParquetError> {
    let (mut values, mut levels) = (Vec::new(), Vec::new());
    while levels.len() < rows {
        let (records, _, _) =
            reader.read_records(rows - levels.len(), Some(&mut levels), None, &mut values)?;
        if records == 0 {
            break;
        }
    }
    Ok(ColumnRows { values: make(values), levels })
}
