//! Recordings of a run: for viewers, and as the only thing that a replay needs.
//!
//! A [`Recorder`] is told a run in two parts: the session while it is measured ([`SessionRecorder`]), then what was made of it, pose by
//! pose ([`record_evaluation`]). [`record`] tells both of a finished [`Story`]: every sink holds the same story.
//! There are two: MCAP ([`McapRecorder`]), which Foxglove and Rerun open and [`read_recording`] reads back without loss, and, with the
//! feature `rerun`, Rerun's own format with a layout of its views (`write_rrd`).
//!
//! Times are simulated: the observations' own where they increase, else one second a pose. The same story gives the same bytes of MCAP.
//!
//! Not in here: what is made of measurements (`calibrig-estimation`), and the simulated machine itself (`calibrig-plant`); both are only shown.
//!
//! ```
//! use std::path::Path;
//!
//! use calibrig_recording::read_recording;
//!
//! // From a disk, whole: every chunk has its checksum, and every input file lies in it with its hash.
//! let recording = read_recording(Path::new("../../recordings/paper.mcap"))?;
//! for set in &recording.sets {
//!     println!("{}: {} observations", set.kind.key(), set.measurements.observations.len());
//! }
//! assert!(recording.missing.is_empty());
//! assert!(recording.sources.iter().any(|(role, _)| role == "robot"));
//! # Ok::<(), calibrig_recording::RecordingError>(())
//! ```

mod carried;
mod clock;
mod directory;
mod error;
mod estimate;
mod exchange;
#[cfg(feature = "rerun")]
mod figures;
mod file;
mod foxglove_scene;
mod health;
mod inspect;
mod inspection;
mod live;
mod machine;
mod mcap_reader;
mod mcap_writer;
mod messages;
mod provenance;
mod records;
mod recover;
#[cfg(feature = "rerun")]
mod rerun_analysis;
#[cfg(feature = "rerun")]
mod rerun_columns;
#[cfg(feature = "rerun")]
mod rerun_layout;
#[cfg(feature = "rerun")]
mod rerun_live;
#[cfg(feature = "rerun")]
mod rerun_scene;
#[cfg(feature = "rerun")]
mod rerun_sink;
#[cfg(feature = "rerun")]
mod rerun_views;
mod scene;
pub mod schema;
mod story;
mod survey;
#[cfg(test)]
mod synthetic;
#[cfg(feature = "rerun")]
mod tables;
mod truth;

pub use carried::CarriedReport;
pub use error::RecordingError;
pub use exchange::{CsvExport, ExportError, ExportedFile, export_csv, write_sets};
pub use file::UnfinishedFile;
pub use health::{Fault, FaultyPart, Health, State};
pub use inspect::{Progress, inspect};
pub use inspection::{
    AttachmentReport, EstimateReport, INSPECT_SCHEMA, Inspection, NotReplayed, ProvenanceReport,
    ProvenanceState, Recoverable, SetReport, TopicReport,
};
pub use live::SessionRecorder;
pub use machine::{RecordedMachine, read_recorded_machine};
pub use mcap_reader::{
    MissingPart, ReadOptions, RecordedEstimate, RecordedParameter, Recording, read_recording,
    read_recording_with,
};
pub use mcap_writer::{McapRecorder, write_mcap};
pub use provenance::{Provenance, SCHEMA};
pub use records::Unprotected;
pub use recover::{Recovered, recover};
#[cfg(feature = "rerun")]
pub use rerun_live::{LiveRecorder, VIEWER_URL, Viewer, viewer_url};
#[cfg(feature = "rerun")]
pub use rerun_sink::{RerunRecorder, rrd_of, save_rrd, write_rrd};
pub use scene::{Chain, ChainKind, Sighting};
pub use story::{
    InputSummary, LogEntry, LogLevel, Measured, PoseStep, Preamble, Recorder, Residuals, Story, TrueSetting,
    record, record_evaluation,
};

/// How much longer than life residual arrows are drawn.
pub const RESIDUAL_SCALE: f64 = 100.0;
/// How much longer than life deflections under load are drawn.
pub const DEFLECTION_SCALE: f64 = 100.0;
