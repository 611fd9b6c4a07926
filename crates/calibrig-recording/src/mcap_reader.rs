//! Reads a recording back: completely and as it was written, or not at all. The recorded truth of a simulation is never read.

mod contents;

use std::io::{Read, Seek};
use std::path::Path;

use nalgebra::Vector3;

use self::contents::Contents;
use super::framing::{ReadError, with_file};
use super::messages::lies_below;
use super::records::{Unprotected, read_records};
use super::{Provenance, RecordingError};
use calibrig_files::{InputError, Source};
use calibrig_files::{Robot, parse_robot};
use calibrig_model::geometry::Transform;
use calibrig_model::measurement::{SetKind, SetOutcome};

/// What a replay needs of a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// Where it comes from; `None` if another program recorded it.
    pub provenance: Option<Provenance>,
    /// The input files by role, named without their folder.
    pub sources: Vec<(String, Source)>,
    /// What was measured: the identification set first, with at least one observation.
    pub sets: Vec<SetOutcome>,
    /// What is missing from the session, in a recording that was cut short.
    pub missing: Vec<MissingPart>,
    /// Whether `recover` saved it from a damaged file.
    pub recovered: bool,
    /// What in the file no checksum covers.
    pub unprotected: Unprotected,
    /// The recorded estimates, by mode.
    pub estimates: Vec<RecordedEstimate>,
}

impl Recording {
    /// The robot in it, if there is one.
    pub fn robot(&self) -> Result<Option<Robot>, InputError> {
        let Some(robot) = self.source("robot") else { return Ok(None) };
        // A column map that was given separately does not belong to the robot.
        let named = |key: &str| self.source(key).filter(|_| !robot.place_of(key).is_empty()).cloned();
        parse_robot(robot.clone(), named("urdf"), named("columns")).map(Some)
    }

    /// The input file of a role.
    pub fn source(&self, role: &str) -> Option<&Source> {
        self.sources.iter().find(|(known, _)| known == role).map(|(_, source)| source)
    }
}

/// A set that was not recorded to the end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MissingPart {
    /// The set.
    pub kind: SetKind,
    /// Number of observations in the file.
    pub found: usize,
    /// Number of observations that were made, or else of poses that were planned; `None` if the file states neither.
    pub expected: Option<usize>,
}

/// The recorded result of a mode.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedEstimate {
    /// Key of the mode.
    pub mode: String,
    /// What was identified.
    pub parameters: Vec<RecordedParameter>,
    /// Weighted sum of squares at the minimum; `None` where nothing was identified.
    pub chi2: Option<f64>,
    /// Its degrees of freedom.
    pub degrees_of_freedom: Option<f64>,
    /// Key of the termination reason; empty where nothing was identified.
    pub termination: String,
    /// Number of iterations.
    pub iterations: usize,
    /// `tracker_from_base`, one a station.
    pub stations: Vec<Transform>,
    /// Offsets in the flange frame, m, one a target.
    pub targets: Vec<Vector3<f64>>,
    /// Root mean square of the 3-D errors over each set, m.
    pub rms_3d: Vec<(SetKind, f64)>,
}

/// A recorded parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedParameter {
    /// Name, as [`ParameterId`](calibrig_model::ParameterId) prints it.
    pub name: String,
    /// Deviation from the nominal value, m or rad.
    pub value: f64,
    /// Standard deviation, m or rad; `None` from a singular system.
    pub sigma: Option<f64>,
}

/// Which parts of a recording are read.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ReadOptions {
    /// Topics to leave out, each with everything below it: `/nest`, `/measurement/verification`.
    pub dropped_topics: Vec<String>,
}

impl ReadOptions {
    /// Whether the messages on `topic` are left out.
    fn drop(&self, topic: &str) -> bool {
        self.dropped_topics.iter().any(|dropped| lies_below(topic, dropped))
    }
}

/// Reads the recording at `path`. Messages under a checksum, as in every file of calibrig, are returned exactly as they were written;
/// [`Recording::unprotected`] counts those without.
///
/// # Errors
/// The file is not an MCAP file, breaks off, is damaged, was written by another program or a later version, or lacks input files or
/// measurements: each error says what is missing and what was expected.
pub fn read_recording(path: &Path) -> Result<Recording, RecordingError> {
    read_recording_with(path, &ReadOptions::default())
}

/// The same, without the topics that `options` leaves out. Each of them must exist.
pub fn read_recording_with(path: &Path, options: &ReadOptions) -> Result<Recording, RecordingError> {
    with_file(path, |file| read_from(file, options))
}

pub(super) fn read_from(
    file: &mut (impl Read + Seek),
    options: &ReadOptions,
) -> Result<Recording, ReadError> {
    let mut contents = Contents::new(options);
    let unprotected = read_records(file, &mut |record| Ok(contents.record(record)?))?;
    Ok(Recording { unprotected, ..contents.finish()? })
}

#[cfg(test)]
mod tests;
