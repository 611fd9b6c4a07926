//! Writing.

use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use parquet::basic::{Compression, Encoding, LogicalType, Repetition, Type as Physical, ZstdLevel};
use parquet::data_type::{ByteArrayType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::types::{ColumnPath, Type, TypePtr};
use sha2::{Digest, Sha256};
use tempfile::NamedTempFile;

use super::columns::{ColumnRows, Values};
use super::{Cell, Column, Kind, TableError, rows_a_group};

/// What is written, summed on its way.
struct Summed {
    file: BufWriter<NamedTempFile>,
    sum: Sha256,
}

impl Write for Summed {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.file.write(bytes)?;
        self.sum.update(&bytes[..written]);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

/// A table that is being written, in a file without its final name.
pub struct TableWriter {
    /// For errors.
    folder: PathBuf,
    writer: SerializedFileWriter<Summed>,
    columns: Vec<ColumnRows>,
    /// In `columns`.
    waiting: usize,
    rows: u64,
}

impl TableWriter {
    /// Begins a table of these columns in `folder`.
    pub fn create(folder: &Path, columns: &[Column]) -> Result<Self, TableError> {
        let failed = TableError::parquet(folder);
        let file = tempfile::Builder::new().prefix(TEMPORARY).tempfile_in(folder);
        let file = file.map_err(TableError::io(folder))?;
        let sink = Summed { file: BufWriter::new(file), sum: Sha256::new() };
        let schema = schema(columns).map_err(&failed)?;
        let properties = Arc::new(properties(columns).map_err(&failed)?);
        let writer = SerializedFileWriter::new(sink, schema, properties).map_err(&failed)?;
        let folder = folder.to_path_buf();
        Ok(Self { folder, writer, columns: ColumnRows::of(columns), waiting: 0, rows: 0 })
    }

    /// Adds a row: one cell per column.
    pub fn push(&mut self, row: &[Cell]) -> Result<(), TableError> {
        let columns = self.columns.len();
        let takes = |(column, cell): (&ColumnRows, &Cell)| column.takes(cell);
        if row.len() != columns || !self.columns.iter().zip(row).all(takes) {
            return Err(TableError::Row { path: self.folder.clone(), cells: row.len(), columns });
        }
        self.columns.iter_mut().zip(row).for_each(|(column, cell)| column.push(cell));
        self.waiting += 1;
        self.rows += 1;
        if self.waiting == rows_a_group(columns) { self.write_group() } else { Ok(()) }
    }

    fn write_group(&mut self) -> Result<(), TableError> {
        if self.waiting == 0 {
            return Ok(());
        }
        self.waiting = 0;
        put_group(&mut self.writer, &self.columns).map_err(TableError::parquet(&self.folder))?;
        self.columns.iter_mut().for_each(ColumnRows::clear);
        Ok(())
    }

    /// States something about the table.
    pub fn say(&mut self, key: &str, text: String) {
        self.writer.append_key_value_metadata(KeyValue::new(key.to_owned(), text));
    }

    /// Completes the file, and syncs it to the disk.
    pub fn finish(mut self) -> Result<StagedTable, TableError> {
        self.write_group()?;
        let rows = self.rows;
        let folder = self.folder;
        let Summed { file, sum } = self.writer.into_inner().map_err(TableError::parquet(&folder))?;
        let file = file
            .into_inner()
            .map_err(std::io::IntoInnerError::into_error)
            .map_err(TableError::io(&folder))?;
        file.as_file().sync_all().map_err(TableError::io(&folder))?;
        Ok(StagedTable { file, sum: hexadecimal(&sum.finalize()), rows })
    }
}

/// Prefix of the names of incomplete files.
pub(crate) const TEMPORARY: &str = ".calibrig-trials-";

/// A complete table without its name. It is removed if dropped.
#[derive(Debug)]
pub struct StagedTable {
    file: NamedTempFile,
    sum: String,
    rows: u64,
}

impl StagedTable {
    /// SHA-256 of the file, hexadecimal.
    pub fn sum(&self) -> &str {
        &self.sum
    }

    /// Rows in it.
    pub fn rows(&self) -> u64 {
        self.rows
    }

    /// Its place until it has its name.
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// Gives it its name, in the folder in which it was made; a file of that name is replaced.
    pub fn name(self, path: &Path) -> Result<(), TableError> {
        // A temporary file is private; a result is not.
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            let readable = std::fs::Permissions::from_mode(0o644);
            self.file.as_file().set_permissions(readable).map_err(TableError::io(path))?;
        }
        self.file.persist(path).map_err(|error| error.error).map_err(TableError::io(path))?;
        sync_folder_of(path)
    }
}

/// Syncs the name of a file to the disk.
pub(crate) fn sync_folder_of(path: &Path) -> Result<(), TableError> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // If folders cannot be opened (Windows), there is nothing to do.
    match File::open(folder) {
        Ok(folder) => folder.sync_all().or_else(|error| match error.kind() {
            // Some network file systems have no such call.
            io::ErrorKind::InvalidInput | io::ErrorKind::Unsupported => Ok(()),
            _ => Err(error),
        }),
        Err(_) => Ok(()),
    }
    .map_err(TableError::io(folder))
}

pub(crate) fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing to a String cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

fn schema(columns: &[Column]) -> Result<TypePtr, ParquetError> {
    let fields = columns
        .iter()
        .map(|column| {
            let (physical, logical) = match column.kind {
                Kind::Integer => (Physical::INT64, None),
                Kind::Number => (Physical::DOUBLE, None),
                Kind::Text => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
            };
            Type::primitive_type_builder(&column.name, physical)
                .with_repetition(Repetition::OPTIONAL)
                .with_logical_type(logical)
                .build()
                .map(Arc::new)
        })
        .collect::<Result<Vec<_>, _>>()?;
    Ok(Arc::new(Type::group_type_builder("trials").with_fields(fields).build()?))
}

fn properties(columns: &[Column]) -> Result<WriterProperties, ParquetError> {
    let mut builder = WriterProperties::builder()
        .set_created_by(concat!("calibrig version ", env!("CARGO_PKG_VERSION")).to_owned())
        .set_compression(Compression::ZSTD(ZstdLevel::try_new(1)?))
        // We close groups ourselves; a page may have any size.
        .set_max_row_group_row_count(None)
        .set_statistics_enabled(EnabledStatistics::Chunk)
        .set_offset_index_disabled(true);
    for column in columns.iter().filter(|column| column.kind == Kind::Number) {
        // Measured values do not repeat: a dictionary would be larger than the values. Bytes at the same place of the
        // numbers are similar.
        let path = ColumnPath::new(vec![column.name.clone()]);
        builder = builder
            .set_column_dictionary_enabled(path.clone(), false)
            .set_column_encoding(path, Encoding::BYTE_STREAM_SPLIT);
    }
    Ok(builder.build())
}

fn put_group(writer: &mut SerializedFileWriter<Summed>, columns: &[ColumnRows]) -> Result<(), ParquetError> {
    let mut group = writer.next_row_group()?;
    for column in columns {
        let Some(mut place) = group.next_column()? else { break };
        put_column(&mut place, column)?;
        place.close()?;
    }
    group.close()?;
    Ok(())
}

fn put_column(place: &mut SerializedColumnWriter<'_>, column: &ColumnRows) -> Result<(), ParquetError> {
    let levels = Some(column.levels.as_slice());
    match &column.values {
        Values::Integer(values) => place.typed::<Int64Type>().write_batch(values, levels, None)?,
        Values::Number(values) => place.typed::<DoubleType>().write_batch(values, levels, None)?,
        Values::Text(values) => place.typed::<ByteArrayType>().write_batch(values, levels, None)?,
    };
    Ok(())
}
