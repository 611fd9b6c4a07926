//! What a run tells people and programs: tables on the terminal, `report.json` and `report.html`. A sink: nothing upstream imports it.

mod ablation;
mod acceptance;
mod acceptance_bounds;
mod campaign;
mod closed_loop;
mod compensation;
mod drift;
mod forest;
mod html;
mod iso9283;
mod json;
mod judgement;
mod parameters;
mod plots;
mod pose_plan;
mod region;
mod residuals;
#[cfg(test)]
mod sample;
mod scatter;
mod sensors;
mod splits;
mod summary;
mod sweeps;
mod tables;

pub use acceptance::{acceptance_html, acceptance_json, acceptance_svg, acceptance_text};
pub use acceptance_bounds::JsonAcceptance;
pub use calibrig_campaign::plan::quoted;
pub use campaign::campaign_html;
pub use closed_loop::{
    JsonCompensation, JsonDriveFailure, JsonDrivenCriterion, JsonDrivenPath, JsonDrivenPose,
    JsonDrivenPoseTest,
};
pub use compensation::{
    COMPENSATION_FILES, COMPENSATION_SCHEMA, JsonActuator, JsonAtLimit, JsonBeyond, JsonCorrected,
    JsonCorrectedCommands, JsonExcess, JsonGrid, JsonLengths, JsonTool, JsonUnreachable, commands_csv,
    compensated_csv, compensation_html, compensation_json_text, grid_csv, json_compensation,
    render_compensation, write_compensation,
};
pub use html::html_report;
pub use iso9283::{
    ISO9283_SCHEMA, JsonCombined, JsonCube, JsonIso9283, JsonIsoAccuracy, JsonIsoOrientation, JsonIsoPose,
    JsonIsoRow, JsonIsoTarget, JsonIsoTurn, iso9283_html, iso9283_json_text, json_iso9283, render_iso9283,
    write_iso9283,
};
pub use json::{
    JsonAblated, JsonAblation, JsonAblationRow, JsonDropped, JsonEstimate, JsonInput, JsonOrientationRow,
    JsonParameter, JsonRegistration, JsonReport, JsonRow, JsonSet, JsonSoftware, SCHEMA, json_report,
};
pub use judgement::{
    JsonConfidence, JsonCorrelation, JsonInfluence, JsonJudgement, JsonPattern, JsonPoint, JsonRegion,
    JsonSupport,
};
pub use pose_plan::{PLAN_SCHEMA, json_plan, plan_html, plan_json_text, render_plan, write_plan};
pub use residuals::{JsonResidual, residuals_csv};
pub use scatter::{JsonRepeatScatter, JsonScatter};
pub use sensors::{JsonSensor, JsonSensorParameter, JsonSensors};
pub use splits::{JsonInterval, JsonSplitRow, JsonSplits};
pub use tables::{Style, render_tables};

use std::collections::BTreeSet;
use std::io::Write;
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;
use thiserror::Error;

use crate::pipeline::{CarriedReport, Outcome, SetKind, SetOutcome};
use calibrig_estimation::evaluation::AccuracyRow;
use calibrig_estimation::identification::{Estimate, LeftOutReason, Mode};
use calibrig_model::Payload;

/// A report that could not be made or written.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ReportError {
    /// A file could not be written; nothing is left behind under its name.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A value has no JSON form.
    #[error("cannot express the report as JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// A table could not be made.
    #[error("cannot write residuals.csv: {0}")]
    Table(#[from] csv::Error),
    /// A figure could not be drawn.
    #[error("cannot draw the figure of {figure}: {reason}")]
    Plot {
        /// What it shows.
        figure: &'static str,
        /// Why.
        reason: String,
    },
}

/// The text of `report.json`.
pub fn json_text(outcome: &Outcome) -> Result<String, ReportError> {
    let mut json = serde_json::to_string_pretty(&json_report(outcome))?;
    json.push('\n');
    Ok(json)
}

/// Writes `report.json`, `report.html` and `residuals.csv` to `folder`, which exists.
///
/// All are written in full beside their final names before one is renamed, so that a failed run leaves no half-written report.
pub fn write_reports(outcome: &Outcome, folder: &Path) -> Result<(), ReportError> {
    let json = json_text(outcome)?;
    let html = html_report(outcome)?;
    let residuals = residuals_csv(outcome)?;
    let staged = [
        stage(folder, "report.json", &json)?,
        stage(folder, "report.html", &html)?,
        stage(folder, residuals::FILE, &residuals)?,
    ];
    for (file, path) in staged {
        file.persist(&path).map_err(|e| ReportError::Write { path, source: e.error })?;
    }
    Ok(())
}

fn stage(folder: &Path, name: &str, text: &str) -> Result<(NamedTempFile, PathBuf), ReportError> {
    let path = folder.join(name);
    let mut builder = tempfile::Builder::new();
    builder.prefix(".report-");
    // A temporary file is private by default; a report is as readable as the user's umask allows.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let written = builder.tempfile_in(folder).and_then(|mut file| {
        file.write_all(text.as_bytes())?;
        file.as_file().sync_all()?;
        Ok(file)
    });
    match written {
        Ok(file) => Ok((file, path)),
        Err(source) => Err(ReportError::Write { path, source }),
    }
}

/// The published figures beside a row, m: max x, mean x, max y, mean y, max z, mean z.
fn published(outcome: &Outcome, set: SetKind, mode: Mode) -> Option<&[f64; 6]> {
    outcome.published.iter().find(|(s, m, _)| (*s, *m) == (set, mode)).map(|(_, _, figures)| figures)
}

/// A row of a table of errors, for the terminal and the page.
struct ErrorRow<'a> {
    mode: Mode,
    /// Whose errors.
    title: &'a str,
    row: AccuracyRow,
    /// Published figures below it, as [`published`] gives them.
    published: Option<&'a [f64; 6]>,
    /// What these are called.
    published_as: &'static str,
}

/// Number of distinct poses of a set.
fn pose_count(set: &SetOutcome) -> usize {
    set.measurements.observations.iter().map(|o| o.pose).collect::<BTreeSet<_>>().len()
}

/// "60 poses", or "60 poses (120 observations)" where several targets or stations are seen at a pose.
fn pose_words(set: &SetOutcome) -> String {
    let (poses, observations) = (pose_count(set), set.measurements.observations.len());
    if poses == observations {
        counted(poses, "pose")
    } else {
        format!("{} ({})", counted(poses, "pose"), counted(observations, "observation"))
    }
}

/// What the flange carried: "nothing at 20 poses, 25 kg (25.0 kg) at 20 poses"; `None` where it never carried anything.
fn payload_words(set: &SetOutcome) -> Option<String> {
    let carried = set.measurements.payloads();
    let words =
        |(payload, poses): &(Option<&Payload>, usize)| CarriedReport::of(*payload, *poses).to_string();
    (!carried.is_empty()).then(|| carried.iter().map(words).collect::<Vec<_>>().join(", "))
}

/// "1 pose", "2 poses".
fn counted(n: usize, noun: &str) -> String {
    if n == 1 { format!("1 {noun}") } else { format!("{n} {noun}s") }
}

/// What was left out of a fit, reason by reason. What cannot be told from others is a warning of its own.
fn left_out_words(estimate: &Estimate) -> Vec<String> {
    let mut reasons: Vec<(&str, Vec<String>)> = Vec::new();
    for left in estimate.left_out.iter().filter(|left| left.reason != LeftOutReason::Redundant) {
        let (name, words) = (left.id.to_string(), left.reason.words());
        match reasons.iter_mut().find(|(known, _)| *known == words) {
            Some((_, names)) => names.push(name),
            None => reasons.push((words, vec![name])),
        }
    }
    reasons.into_iter().map(|(reason, names)| format!("{}: {reason}", names.join(", "))).collect()
}

fn set_title(kind: SetKind) -> &'static str {
    match kind {
        SetKind::Identification => "Identification set",
        SetKind::Verification => "Verification set",
    }
}

/// A condition number for people.
fn condition_words(condition: f64) -> String {
    if !condition.is_finite() {
        "infinite".to_owned()
    } else if condition < 1e5 {
        format!("{condition:.0}")
    } else {
        format!("{condition:.1e}")
    }
}

/// `sqrt(chi2 / dof)` where the readings state their noise; from residual-scaled noise it would say nothing.
fn consistency_ratio(estimate: &Estimate) -> Option<f64> {
    match estimate.noise {
        calibrig_estimation::identification::NoiseScale::Stated => estimate.chi2_per_dof().map(f64::sqrt),
        calibrig_estimation::identification::NoiseScale::Residuals(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_files_are_written_and_no_other() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        write_reports(&sample::simulated(), folder.path()).expect("a report");
        write_reports(&sample::simulated(), folder.path()).expect("a report over an older one");
        let mut names: Vec<_> = std::fs::read_dir(folder.path())
            .expect("the folder")
            .map(|entry| entry.expect("an entry").file_name().into_string().expect("UTF-8"))
            .collect();
        names.sort();
        assert_eq!(names, ["report.html", "report.json", "residuals.csv"]);
        let read = |name| std::fs::read_to_string(folder.path().join(name)).expect("readable");
        assert!(read("report.html").ends_with("</html>"));
        let json: JsonReport = serde_json::from_str(&read("report.json")).expect("the schema");
        assert_eq!(json.schema, SCHEMA);
    }

    #[test]
    fn a_folder_that_cannot_be_written_to_keeps_nothing() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let missing = folder.path().join("missing");
        let error = write_reports(&sample::measured(), &missing).expect_err("there is no folder");
        assert!(error.to_string().contains("report.json"), "{error}");
        // A folder stands in the way of the second file: the first may be there, but no temporary file is.
        std::fs::create_dir(folder.path().join("report.html")).expect("a folder");
        assert!(write_reports(&sample::measured(), folder.path()).is_err());
        for entry in std::fs::read_dir(folder.path()).expect("the folder") {
            let name = entry.expect("an entry").file_name().into_string().expect("UTF-8");
            assert!(
                ["report.html", "report.json", "residuals.csv"].contains(&name.as_str()),
                "{name} is left behind"
            );
        }
    }

    #[cfg(unix)]
    #[test]
    fn others_may_read_what_the_umask_allows() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().expect("a temporary folder");
        let plain = folder.path().join("plain");
        std::fs::write(&plain, "").expect("a file");
        write_reports(&sample::measured(), folder.path()).expect("a report");
        let mode = |path: &Path| std::fs::metadata(path).expect("a file").permissions().mode();
        assert_eq!(mode(&folder.path().join("report.json")), mode(&plain));
    }
}
