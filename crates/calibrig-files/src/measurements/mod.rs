//! Measurement files, and the maps that describe their columns.
//!
//! Whatever kind of file it is ([open]), it becomes [rows](rows) of texts: of [text], or of a spreadsheet or a bag by another reader. Then the
//! [layout] separates header from measurements, the [map file](map_file) states which [columns] mean what, the [header] finds them, [join] adds the
//! commands of another file, and the [reader] turns rows into observations, whose [times] may be written in any way. [suggest] writes a map from what
//! it finds. [goals] are tables of points where a tool is to be.

mod cells;
mod columns;
mod commands;
mod faces;
mod files;
mod goals;
mod header;
mod join;
mod layout;
mod loaded;
mod map_file;
mod open;
mod own_columns;
mod places;
mod pose_list;
mod reader;
mod repeats;
mod rows;
mod suggest;
mod table;
#[cfg(test)]
mod tests;
mod text;
mod times;
mod units;
mod writer;

pub use columns::{ColumnMap, MissedCode, RowOptions};
pub use commands::parse_commands;
pub use files::{MeasurementFiles, PointsFile, parse_measurements, read_files, read_measurements, read_rows};
pub use goals::{parse_goals, read_goals};
pub use loaded::LoadedMeasurements;
pub use map_file::{load_column_map, parse_column_map};
pub use open::is_bag;
pub use places::Places;
pub use pose_list::PoseList;
pub use rows::{MemoryRows, Place, Row, Rows};
pub use suggest::{SuggestedMap, suggest_columns};
pub use table::bag::{BagOptions, DEFAULT_TOLERANCE_S, read_bag};
pub use table::sheet::read_sheet;
pub use table::{Table, TableRow};
pub use writer::{CsvError, measurements_text, write_measurements};
