//! Files: robots (TOML and URDF), measurements (delimited text and its column maps), sessions. Every refusal names file, line and key, and
//! says what was expected.

mod input;
mod measurements;
mod robot;
mod session;
mod stated;

pub use input::{InputError, Source, Spanned};
pub use measurements::{
    ColumnMap, CsvError, LoadedMeasurements, load_column_map, measurements_text, parse_column_map,
    parse_measurements, read_measurements, write_measurements,
};
pub use robot::{LoadTable, Robot, StatedTarget, load_robot, parse_robot, read_loads};
pub use session::{SessionFile, SessionSet, load_session, parse_session, session_text};
pub use stated::{MeasuredFile, Statements, state};
