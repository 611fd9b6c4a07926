//! Text files: [robots](load_robot) (TOML and URDF), [measurements](read_measurements) (delimited text and its [column maps](ColumnMap)),
//! [sessions](load_session).
//!
//! Contents become types of `calibrig-model`, in SI and radians; the unit of every number is part of its key and is converted here, once.
//! Written files read back to the same bits. Every error names file, line and key and says what was expected; no file can cause a panic. Keys
//! and columns are described in `docs/formats.md`.
//!
//! This crate does not contain the evaluation of a robot and its measurements; scenarios, which also describe the truth and are in the
//! root package; or recordings, which are in `calibrig-recording`.
//!
//! ```
//! use calibrig_files::{Source, parse_robot};
//!
//! let text = r#"
//! schema = "calibrig.robot/1"
//! name = "one joint"
//! convention = "craig"
//! [[joint]]
//! name = "slide"
//! type = "prismatic"
//! a_mm = 0
//! alpha_deg = 90
//! d_mm = 100
//! theta_deg = 0
//! min_mm = 0
//! max_mm = 500
//! [actuators]
//! kind = "direct"
//! "#;
//! let robot = parse_robot(Source::new("robot.toml", text), None, None)?;
//! assert_eq!(robot.model.kinematics.links[0].limits, [0.0, 0.5]);
//!
//! let without_unit = Source::new("robot.toml", text.replace("d_mm", "d"));
//! let refusal = parse_robot(without_unit, None, None).unwrap_err().to_string();
//! assert!(refusal.starts_with("robot.toml:10: "), "{refusal}");
//! # Ok::<(), calibrig_files::InputError>(())
//! ```

mod convert;
mod followers;
mod goals;
mod input;
pub mod mcap_chunk;
mod measurements;
mod orientation;
mod payloads;
mod robot;
mod rotation;
mod session;
mod springs;
mod stated;

pub use convert::{AGREEMENT, Convention, Converted, UrdfOptions, robot_from_dh, robot_from_urdf};
pub use convert::{StandardRow, StandardTable, craig_table, standard_table};
pub use followers::{add_followers, commanded_joints, with_followers, without_followers};
pub use goals::{
    GoalFile, GoalTable, StatedGoal, StatedGrid, StatedHold, StatedRaster, load_goal_file, parse_goal_file,
};
pub use input::{Excerpt, InputError, Source, Spanned};
pub use measurements::{BagOptions, DEFAULT_TOLERANCE_S, Table, TableRow, read_bag, read_sheet};
pub use measurements::{
    ColumnMap, CsvError, LoadedMeasurements, MeasurementFiles, MemoryRows, MissedCode, Place, Places,
    PointsFile, PoseList, Row, RowOptions, Rows, SuggestedMap, is_bag, load_column_map, measurements_text,
    parse_column_map, parse_commands, parse_measurements, read_files, read_measurements, read_rows,
    suggest_columns, write_measurements,
};
pub use measurements::{parse_goals, read_goals};
pub use payloads::{NO_PAYLOAD, PayloadFile, PayloadTable, payload_by_name, read_payloads};
pub use robot::{LoadTable, Robot, StatedTarget, load_robot, parse_robot, read_loads};
pub use robot::{RobotFiles, RobotText, TargetText, actuator_speeds, write_robot};
pub use rotation::{RotationError, rotation_of_matrix};
pub use session::{SessionFile, SessionSet, SessionTextError, load_session, parse_session, session_text};
pub use stated::{MeasuredFile, Statements, state};
