//! Recordings of a run: for viewers, and for a replay, which needs nothing else.
//!
//! A [`Recorder`] is told about a run in two parts: the session while it is measured ([`SessionRecorder`]), then its evaluation, pose by
//! pose ([`record_evaluation`]). [`record`] tells both of a finished [`Story`], so that every recording holds the same.
//! There are two kinds: MCAP ([`McapRecorder`]), which Foxglove and Rerun open and [`read_recording`] reads back without loss, and, with the
//! feature `rerun`, Rerun's own format with a layout of its views (`write_rrd`).
//!
//! Times are simulated: the observations' own where they increase, else one second a pose. The same story gives the same bytes of MCAP.
//!
//! Estimation (`calibrig-estimation`) and the simulated machine (`calibrig-plant`) are not part of this crate: it only shows their results.
//!
//! ```
//! use std::path::Path;
//!
//! use calibrig_recording::read_recording;
//!
//! // Every chunk is checked against its checksum, and every attached input file against the hash over all of them.
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
mod framing;
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
mod rerun_entities;
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
#[cfg(feature = "rerun")]
mod rerun_writer;
mod scene;
pub mod schema;
mod story;
mod survey;
#[cfg(test)]
#[path = "tests/synthetic.rs"]
mod synthetic;
#[cfg(feature = "rerun")]
mod tables;
mod truth;

pub use carried::CarriedReport;
pub use error::RecordingError;
pub use exchange::{CsvExport, ExportError, export_csv, write_sets};
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

/// How many times residual arrows are enlarged.
pub const RESIDUAL_SCALE: f64 = 100.0;
/// How many times deflections under load are enlarged.
pub const DEFLECTION_SCALE: f64 = 100.0;
