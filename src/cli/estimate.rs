//! An estimate given as a command's argument: an `estimate.json`, or a recording that is identified again.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::output::verdict;
use super::{CliError, Verdict, replay, say};
use crate::handover::EstimateFile;
use crate::pipeline::Outcome;
use crate::replay::{ReplayOptions, Replayed, replay as identify_again};
use calibrig_estimation::identification::Mode;
use calibrig_files::{InputError, Robot, Source, load_robot, parse_robot};

/// What the argument names.
#[derive(Debug, Clone, Copy)]
pub(super) struct Asked<'a> {
    /// A recording, or an estimate.json.
    pub input: &'a Path,
    /// Which estimate; the fullest one if not given.
    pub mode: Option<Mode>,
    /// The nominal robot's file.
    pub model: Option<&'a Path>,
}

/// An estimate, with what is available of its robot.
#[derive(Debug)]
pub(super) struct Found {
    pub estimate: EstimateFile,
    /// The nominal robot, if its files are available.
    pub robot: Option<Robot>,
    /// How the identification of a recording ended.
    pub ended: Verdict,
    /// Whether it was identified again, and its doubts were reported.
    pub is_said: bool,
}

/// Finds an estimate; measurements of a recording are identified again, and doubts are reported.
pub(super) fn find(asked: Asked<'_>) -> Result<Found, CliError> {
    let model = asked.model.map(load_robot).transpose()?;
    if is_recording(asked.input)? { from_recording(asked, model) } else { from_estimate(asked, model) }
}

/// The first bytes of every MCAP file.
const MAGIC: &[u8] = b"\x89MCAP";

fn is_recording(path: &Path) -> Result<bool, CliError> {
    let unreadable = |error: std::io::Error| InputError::Unreadable {
        path: path.to_path_buf(),
        reason: error.to_string(),
    };
    let mut start = Vec::new();
    File::open(path)
        .map_err(unreadable)?
        .take(MAGIC.len() as u64)
        .read_to_end(&mut start)
        .map_err(unreadable)?;
    Ok(start == MAGIC || path.extension().is_some_and(|extension| extension == "mcap"))
}

fn from_estimate(asked: Asked<'_>, model: Option<Robot>) -> Result<Found, CliError> {
    let estimate = EstimateFile::read(asked.input)?;
    if asked.mode.is_some_and(|mode| mode != estimate.estimate.robot.mode) {
        return Err(CliError::NoEstimate { file: asked.input.to_path_buf(), mode: asked.mode });
    }
    if let (Some(robot), Some(file)) = (&model, &asked.model) {
        estimate
            .check_model(&robot.model)
            .map_err(|source| CliError::AnotherModel { file: file.to_path_buf(), source })?;
    }
    Ok(Found { estimate, robot: model, ended: Verdict::Done, is_said: false })
}

fn from_recording(asked: Asked<'_>, model: Option<Robot>) -> Result<Found, CliError> {
    let options = ReplayOptions {
        modes: asked.mode.into_iter().collect(),
        robot: model.clone(),
        ..ReplayOptions::default()
    };
    let replayed =
        identify_again(asked.input, &options).map_err(|error| replay::failed(error, asked.input))?;
    let Replayed { outcome, differences, made_by_another, missing, unprotected, .. } = &replayed;
    let mut ended = verdict(outcome);
    if let Some(line) = replay::unnoticed(unprotected) {
        say(&line);
    }
    for part in missing {
        say(&replay::cut_short(part));
        ended = Verdict::Doubtful;
    }
    if !differences.is_empty() {
        let places = differences.len();
        match made_by_another {
            Some(made_by) => say(&format!(
                "the recorded estimates were made by {made_by}; the files are written from those of this version"
            )),
            None => {
                say(&format!(
                    "doubtful: what was identified again differs from the recording in {places} places (calibrig replay lists \
                     them)"
                ));
                ended = Verdict::Doubtful;
            }
        }
    }
    let estimate = EstimateFile::of(outcome, asked.mode)
        .ok_or_else(|| CliError::NoEstimate { file: asked.input.to_path_buf(), mode: asked.mode })?;
    let robot = match model {
        Some(robot) => Some(robot),
        None => recorded_robot(outcome)?,
    };
    Ok(Found { estimate, robot, ended, is_said: true })
}

/// The robot from the files that the recording holds.
fn recorded_robot(outcome: &Outcome) -> Result<Option<Robot>, InputError> {
    let source = |role: &str| {
        let found = outcome.sources.iter().find(|(known, _)| known == role);
        found.map(|(_, source): &(String, Source)| source.clone())
    };
    source("robot").map(|robot| parse_robot(robot, source("urdf"), source("columns"))).transpose()
}
