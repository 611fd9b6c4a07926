//! What a run tells people and programs: tables on the terminal, `report.json` and `report.html`. A sink: nothing upstream imports it.

mod ablation;
mod acceptance;
mod acceptance_bounds;
mod accuracy;
mod campaign;
mod closed_loop;
mod compensation;
mod document;
mod drift;
mod errors;
mod files;
mod forest;
mod html;
mod iso9283;
mod json;
mod judgement;
mod markup;
mod parameter_section;
mod parameters;
mod plots;
mod pose_plan;
mod region;
mod residuals;
mod rows;
mod scatter;
mod sensors;
mod sets;
mod splits;
mod summary;
mod sweeps;
mod tables;
mod terminal;
#[cfg(test)]
mod tests;
mod trust;
mod words;

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
pub use document::{JsonDropped, JsonInput, JsonSoftware};
pub use files::ReportError;
pub use html::html_report;
pub use iso9283::{
    ISO9283_SCHEMA, JsonCombined, JsonCube, JsonIso9283, JsonIsoAccuracy, JsonIsoOrientation, JsonIsoPose,
    JsonIsoRow, JsonIsoTarget, JsonIsoTurn, iso9283_html, iso9283_json_text, json_iso9283, render_iso9283,
    write_iso9283,
};
pub use json::{
    JsonAblated, JsonAblation, JsonAblationRow, JsonEstimate, JsonParameter, JsonRegistration, JsonReport,
    SCHEMA, json_report,
};
pub use judgement::{
    JsonConfidence, JsonCorrelation, JsonInfluence, JsonJudgement, JsonPattern, JsonPoint, JsonRegion,
    JsonSupport,
};
pub use pose_plan::{PLAN_SCHEMA, json_plan, plan_html, plan_json_text, render_plan, write_plan};
pub use residuals::{JsonResidual, residuals_csv};
pub use scatter::{JsonRepeatScatter, JsonScatter};
pub use sensors::{JsonSensor, JsonSensorParameter, JsonSensors};
pub use sets::{JsonOrientationRow, JsonRow, JsonSet};
pub use splits::{JsonInterval, JsonSplitRow, JsonSplits};
pub use tables::render_tables;
pub use terminal::Style;

use std::path::Path;

use self::files::write_all;
use crate::pipeline::Outcome;

/// The text of `report.json`.
pub fn json_text(outcome: &Outcome) -> Result<String, ReportError> {
    document::json_text(&json_report(outcome))
}

/// Writes `report.json`, `report.html` and `residuals.csv` to `folder`, which exists.
pub fn write_reports(outcome: &Outcome, folder: &Path) -> Result<(), ReportError> {
    let files = [
        ("report.json", json_text(outcome)?),
        ("report.html", html_report(outcome)?),
        (residuals::FILE, residuals_csv(outcome)?),
    ];
    write_all(folder, &files)
}
