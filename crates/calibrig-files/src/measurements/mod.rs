//! Measurement files: delimited text, and the maps that tell what its columns hold.

mod columns;
mod csv;
mod csv_text;
mod table;

pub use columns::{ColumnMap, load_column_map, parse_column_map};
pub use csv::{
    CsvError, LoadedMeasurements, measurements_text, parse_measurements, read_measurements,
    write_measurements,
};
pub use table::bag::{BagOptions, DEFAULT_TOLERANCE_S, read_bag};
pub use table::sheet::read_sheet;
pub use table::{Table, TablePlace, TableRow};
