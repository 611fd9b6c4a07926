//! `report.html`: one file that opens anywhere, without scripts and without anything fetched.

use maud::{Markup, html};

use super::ablation::ablation_section;
use super::accuracy::{accuracy_section, judged_set, row};
use super::closed_loop::closed_loop_section;
use super::errors::errors_section;
use super::files::ReportError;
use super::json::SCHEMA;
use super::judgement::{residual_section, sure_section};
use super::markup::{key, page};
use super::parameter_section::parameters_section;
use super::parameters::fitted;
use super::plots::look;
use super::region;
use super::scatter::{has_scatter, scatter_section};
use super::sensors::sensor_section;
use super::splits::split_section;
use super::summary::summarise;
use super::trust::trust_section;
use super::words::{counted, factor_words, length_words, pose_words, set_title};
use crate::pipeline::{Outcome, PlantKind};
use calibrig_campaign::plan::quoted;
use calibrig_estimation::identification::Mode;

/// The page of a run.
pub fn html_report(outcome: &Outcome) -> Result<String, ReportError> {
    let errors = errors_section(outcome)?;
    let parameters = parameters_section(outcome)?;
    let (residual, sure) = (residual_section(outcome)?, sure_section(outcome)?);
    let ablation = outcome.ablation.as_ref().map(ablation_section).transpose()?;
    let target = sensor_section(outcome)?;
    let compensated = closed_loop_section(outcome)?;
    let body = html! {
        (header(outcome))
        main {
            (doubts(outcome))
            (summary_section(outcome))
            (accuracy_section(outcome))
            (errors)
            (compensated)
            (residual)
            (scatter_section(outcome))
            (parameters)
            @if let Some(study) = &outcome.splits { (split_section(study)) }
            (sure)
            (target)
            @if let Some(ablation) = ablation { (ablation) }
            (trust_section(outcome))
            (reproduce_section(outcome))
        }
    };
    Ok(page(&format!("Calibration of {}", outcome.input.name), &body))
}

fn header(outcome: &Outcome) -> Markup {
    let input = &outcome.input;
    let registration = &outcome.registration;
    html! {
        header {
            p.eyebrow { "Calibration report" }
            h1 { (input.name) }
            dl.facts {
                div { dt { "Input" } dd { (input.kind) } }
                @if let Some(seed) = input.seed { div { dt { "Seed" } dd { (seed) } } }
                @for set in &outcome.sets {
                    div { dt { (set_title(set.kind)) } dd { (pose_words(set)) } }
                }
                div { dt { "Robot" } dd { (counted(outcome.model.kinematics.joint_count(), "joint")) } }
                (region::session_facts(outcome))
                div { dt { "Software" } dd { "calibrig " (env!("CARGO_PKG_VERSION")) } }
                div.wide {
                    dt { "Registration of \u{201c}" (Mode::WithoutCalibration.title()) "\u{201d}" }
                    dd {
                        (registration.how) ", " (counted(registration.poses, "pose"))
                        ", RMS " (length_words(registration.rms))
                    }
                }
                div.wide { dt { "SHA-256 of the input" } dd.hash { (input.sha256) } }
            }
            nav {
                a href="#summary" { "Summary" } " "
                a href="#accuracy" { "Accuracy" } " "
                a href="#errors" { "Errors" } " "
                @if outcome.closed_loop.is_some() { a href="#compensated" { "Compensated" } " " }
                @if !outcome.judgements.is_empty() { a href="#residual" { "Residual" } " " }
                @if has_scatter(outcome) { a href="#scatter" { "Scatter" } " " }
                a href="#parameters" { "Parameters" } " "
                @if outcome.splits.is_some() { a href="#splits" { "Splits" } " " }
                @if outcome.judgements.iter().any(|j| j.confidence.is_some()) { a href="#sure" { "How sure" } " " }
                @if outcome.sensors.is_some() { a href="#target" { "Target" } " " }
                @if outcome.ablation.is_some() { a href="#ablation" { "Contributions" } " " }
                a href="#trust" { "Trust" } " "
                a href="#reproduce" { "Reproduce" }
            }
        }
    }
}

/// What forbids using the numbers without a second look, in front of them.
fn doubts(outcome: &Outcome) -> Markup {
    let unsound: Vec<_> = fitted(outcome).into_iter().filter(|(_, e)| !e.is_sound()).collect();
    html! {
        @if !unsound.is_empty() {
            aside.doubt role="note" {
                strong { "Doubtful. " }
                @for (mode, estimate) in unsound {
                    @for reason in estimate.reasons() { "\u{201c}" (mode.title()) "\u{201d}: " (reason) ". " }
                }
                a href="#trust" { "Details" }
            }
        }
    }
}

fn summary_section(outcome: &Outcome) -> Markup {
    let summary = summarise(outcome);
    html! {
        section #summary {
            h2 { "Summary" }
            (tiles(outcome))
            div.columns {
                div { h3 { "What improved" } ul { @for line in &summary.improved { li { (line) } } } }
                div { h3 { "What remains" } ul { @for line in &summary.remains { li { (line) } } } }
            }
        }
    }
}

fn tiles(outcome: &Outcome) -> Markup {
    let Some(set) = judged_set(outcome) else { return html! {} };
    let before = outcome
        .modes
        .iter()
        .find(|m| m.mode == Mode::WithoutCalibration)
        .and_then(|m| row(m, set))
        .map(|r| r.rms_3d);
    html! {
        div.tiles {
            @for mode in &outcome.modes {
                @if let Some(row) = row(mode, set) {
                    div.tile {
                        div.name { (key(&look(mode.mode))) (mode.mode.title()) }
                        div.figure { (length_words(row.rms_3d)) }
                        div.note {
                            "RMS of the 3-D error, at worst " (length_words(row.max_3d))
                            @if let (Some(before), true) = (before, mode.estimate.is_some()) {
                                br; (factor_words(before, row.rms_3d, "without calibration"))
                            }
                        }
                    }
                }
            }
        }
        p.note { (set_title(outcome.sets[set].kind)) ", " (pose_words(&outcome.sets[set])) "." }
    }
}

fn reproduce_section(outcome: &Outcome) -> Markup {
    html! {
        section #reproduce {
            h2 { "How to reproduce" }
            pre { code { (command(outcome)) } }
            p {
                "With calibrig " (env!("CARGO_PKG_VERSION")) ", the same input and the same options, the numbers are the same on the same machine, bit by bit. "
                "The numbers of this page in full precision, in metres and radians, are in " code { "report.json" }
                " beside it (schema " code { (SCHEMA) } ")."
            }
            @if !outcome.sources.is_empty() {
                table.files {
                    thead { tr { th { "role" } th { "file" } } }
                    tbody { @for (role, source) in &outcome.sources { tr { td { (role) } td { code { (source.name) } } } } }
                }
            }
        }
    }
}

/// The command line that was run, with every option, for a POSIX shell; of an outcome that no command made, one that gives it.
fn command(outcome: &Outcome) -> String {
    if let Some(command) = &outcome.command {
        return command.clone();
    }
    let source =
        |wanted: &str| outcome.sources.iter().find(|(role, _)| role == wanted).map(|(_, s)| quoted(&s.name));
    match outcome.input.kind {
        "scenario" => {
            let seed = outcome.input.seed.map_or_else(String::new, |seed| format!(" --seed {seed}"));
            let scenario = source("scenario").unwrap_or_else(|| "SCENARIO.toml".to_owned());
            let trial = match outcome.input.trial {
                None | Some((0, PlantKind::Rapier)) => String::new(),
                Some((trial, plant)) => format!(" --trial {trial} --plant {}", plant.key()),
            };
            let ablate = if outcome.ablation.is_some() { " --ablate" } else { "" };
            format!("calibrig run {scenario}{seed}{trial}{ablate} --out DIR")
        }
        "recording" => {
            format!("calibrig replay {}", source("recording").unwrap_or_else(|| "RECORDING.mcap".to_owned()))
        }
        _ => "calibrig identify".to_owned(),
    }
}
