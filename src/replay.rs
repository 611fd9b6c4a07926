//! Identification from a recording alone: no scenario, no model folder, the same `calibrate`, the same bits.

use std::path::Path;

use miette::Diagnostic;
use thiserror::Error;

use crate::identification::Estimate;
use crate::input::InputError;
use crate::model::parse_robot;
use crate::pipeline::{InputSummary, Outcome, PipelineError, calibrate, judge};
use crate::recording::{RecordedEstimate, RecordingError, read_recording};
use crate::scenario::parse_scenario;

/// A recording that cannot be replayed.
#[derive(Debug, Error, Diagnostic)]
#[non_exhaustive]
pub enum ReplayError {
    /// The file.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Recording(#[from] RecordingError),
    /// An attached scenario or model.
    #[error("an attachment of the recording: {0}")]
    #[diagnostic(transparent)]
    Attachment(#[from] InputError),
    /// One is missing.
    #[error("the recording holds no attachment \"{role}\", which replay needs")]
    #[diagnostic(help("expected a recording written by `calibrig run`"))]
    Missing {
        /// Its role.
        role: &'static str,
    },
    /// The identification.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
}

/// Where a replayed estimate is not the recorded one.
#[derive(Debug, Clone, PartialEq)]
pub enum Difference {
    /// None was recorded.
    Missing {
        /// Key of the mode.
        mode: &'static str,
    },
    /// Other parameters.
    Set {
        /// Key of the mode.
        mode: &'static str,
    },
    /// Another value or standard deviation.
    Parameter {
        /// Key of the mode.
        mode: &'static str,
        /// Name of the parameter.
        name: String,
        /// m or rad
        recorded: f64,
        /// m or rad
        replayed: f64,
    },
    /// Another sum of squares.
    ChiSquare {
        /// Key of the mode.
        mode: &'static str,
        /// Recorded.
        recorded: f64,
        /// Replayed.
        replayed: f64,
    },
}

/// A replay and its comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct Replayed {
    /// As of a run, without the truth.
    pub outcome: Outcome,
    /// Number of estimates compared.
    pub compared: usize,
    /// Empty if every bit is the same.
    pub differences: Vec<Difference>,
}

/// Identifies again from the measurements, the scenario's choices and the nominal robot that `path` holds.
pub fn replay(path: &Path) -> Result<Replayed, ReplayError> {
    let recording = read_recording(path)?;
    let attachment =
        |role: &str| recording.sources.iter().find(|(r, _)| r == role).map(|(_, source)| source.clone());
    let required = |role: &'static str| attachment(role).ok_or(ReplayError::Missing { role });
    let robot = parse_robot(required("robot")?, attachment("urdf"), attachment("columns"))?;
    let scenario = parse_scenario(required("scenario")?, robot)?;
    let sets = recording.sets;
    let model = scenario.robot.model;
    let (registration, modes) = calibrate(&model, &sets, &scenario.modes, &scenario.options)?;
    let judgements = judge(&model, &sets, &modes, &scenario.options)?;
    let mut differences = Vec::new();
    let mut compared = 0;
    for outcome in &modes {
        let Some(estimate) = &outcome.estimate else { continue };
        let mode = outcome.mode.key();
        match recording.estimates.iter().find(|recorded| recorded.mode == mode) {
            Some(recorded) => {
                compared += 1;
                compare(mode, recorded, estimate, &mut differences);
            }
            None => differences.push(Difference::Missing { mode }),
        }
    }
    let outcome = Outcome {
        input: InputSummary {
            kind: "recording",
            name: scenario.name,
            sha256: recording.provenance.as_ref().map(|p| p.input_sha256.clone()).unwrap_or_default(),
            seed: recording.provenance.as_ref().and_then(|p| p.seed),
            trial: None,
        },
        sources: recording.sources,
        model,
        visuals: scenario.robot.visuals,
        registration,
        sets,
        modes,
        truth: None,
        published: scenario.published,
        judgements,
        ablation: None,
        splits: None,
    };
    Ok(Replayed { outcome, compared, differences })
}

fn compare(
    mode: &'static str,
    recorded: &RecordedEstimate,
    replayed: &Estimate,
    differences: &mut Vec<Difference>,
) {
    let names: Vec<_> = replayed.parameters.iter().map(|p| p.id.to_string()).collect();
    if recorded.parameters.len() != names.len()
        || recorded.parameters.iter().zip(&names).any(|(recorded, name)| &recorded.name != name)
    {
        differences.push(Difference::Set { mode });
        return;
    }
    for (recorded, replayed) in recorded.parameters.iter().zip(&replayed.parameters) {
        let pairs = [(Some(recorded.value), Some(replayed.value)), (recorded.sigma, replayed.sigma)];
        for (a, b) in pairs {
            if a.map(f64::to_bits) != b.map(f64::to_bits) {
                differences.push(Difference::Parameter {
                    mode,
                    name: recorded.name.clone(),
                    recorded: a.unwrap_or(f64::NAN),
                    replayed: b.unwrap_or(f64::NAN),
                });
            }
        }
    }
    if recorded.chi2.map(f64::to_bits) != Some(replayed.chi2.to_bits()) {
        let recorded = recorded.chi2.unwrap_or(f64::NAN);
        differences.push(Difference::ChiSquare { mode, recorded, replayed: replayed.chi2 });
    }
}
