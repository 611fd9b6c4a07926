//! Measurement files: delimited text, and the maps that tell what its columns hold.

mod columns;
mod csv;
mod csv_text;

pub use columns::{ColumnMap, load_column_map, parse_column_map};
pub use csv::{
    CsvError, LoadedMeasurements, measurements_text, parse_measurements, read_measurements,
    write_measurements,
};
