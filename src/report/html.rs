//! `report.html`: one file that opens anywhere, without scripts and without anything fetched.

use std::fmt::Write;

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::ablation::ablation_section;
use super::acceptance_bounds::acceptance_table;
use super::closed_loop::closed_loop_section;
use super::drift::drift_section;
use super::judgement::{residual_section, sure_section};
use super::parameters::{ParameterCell, ParameterRow, fitted, parameter_rows, parameter_words, printed_unit};
use super::plots::{self, GRID, INK, LOOKS, Look, Marker, hex, look};
use super::scatter::{has_scatter, scatter_section};
use super::sensors::sensor_section;
use super::splits::split_section;
use super::summary::{factor_words, judged_set, length_words, row, significant, summarise};
use super::sweeps::sweep_section;
use super::{
    ErrorRow, ReportError, condition_words, consistency_ratio, counted, forest, left_out_words, pose_words,
    published, region, set_title,
};
use crate::pipeline::{ModeOutcome, Outcome, PlantKind, SetKind};
use calibrig_campaign::plan::quoted;
use calibrig_estimation::identification::{
    Assumption, DependentGroup, Estimate, Mode, NoiseScale, Warning, WeakDirection,
};
use calibrig_model::statistics::NORMAL_95;
use calibrig_model::{ParameterId, Unit};

const CSS: &str = include_str!("report.css");

/// The head of every page, which needs no file beside it.
pub(super) fn head(title: &str) -> Markup {
    html! {
        head {
            meta charset="utf-8";
            meta name="viewport" content="width=device-width, initial-scale=1";
            meta name="color-scheme" content="light dark";
            meta name="generator" content={ "calibrig " (env!("CARGO_PKG_VERSION")) };
            title { (title) }
            style { (PreEscaped(CSS)) (PreEscaped(figure_css())) }
        }
    }
}

/// The page of a run.
pub fn html_report(outcome: &Outcome) -> Result<String, ReportError> {
    let errors = errors_section(outcome)?;
    let parameters = parameters_section(outcome)?;
    let (residual, sure) = (residual_section(outcome)?, sure_section(outcome)?);
    let ablation = outcome.ablation.as_ref().map(ablation_section).transpose()?;
    let target = sensor_section(outcome)?;
    let compensated = closed_loop_section(outcome)?;
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            (head(&format!("Calibration of {}", outcome.input.name)))
            body {
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
            }
        }
    };
    Ok(page.into_string())
}

/// The figures' colours on a dark page; on a light one their own attributes hold.
fn figure_css() -> String {
    let (ink, grid) = (hex(INK), hex(GRID));
    let mut css = format!(
        "figure svg [fill=\"{ink}\"]{{fill:currentColor}}figure svg [stroke=\"{ink}\"]{{stroke:currentColor}}\
         figure svg [stroke=\"{grid}\"]{{stroke:var(--grid)}}\n@media screen and (prefers-color-scheme:dark){{"
    );
    for look in LOOKS {
        let (light, dark) = (hex(look.light), hex(look.dark));
        let _ = write!(css, "svg [fill=\"{light}\"]{{fill:{dark}}}svg [stroke=\"{light}\"]{{stroke:{dark}}}");
    }
    css.push('}');
    css
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

fn accuracy_section(outcome: &Outcome) -> Markup {
    html! {
        section #accuracy {
            h2 { "Accuracy" }
            p {
                "Absolute error of the target position in the base frame, measured minus predicted, in mm."
                @if !outcome.published.is_empty() { " Below each row, the published figures for comparison." }
            }
            @for (index, set) in outcome.sets.iter().enumerate() {
                (accuracy_table(outcome, index, set.kind, &pose_words(set)))
                (orientation_table(outcome, index, set.kind))
                (acceptance_table(outcome, index))
            }
        }
    }
}

fn accuracy_table(outcome: &Outcome, index: usize, kind: SetKind, poses: &str) -> Markup {
    let of_mode = |mode: &'_ ModeOutcome| {
        Some(ErrorRow {
            mode: mode.mode,
            title: mode.mode.title(),
            row: row(mode, index)?,
            published: published(outcome, kind, mode.mode),
            published_as: "published",
        })
    };
    let rows: Vec<_> = outcome.modes.iter().filter_map(of_mode).collect();
    error_table(&format!("{}, {poses}, mm", set_title(kind)), &rows)
}

/// A table of errors in mm.
pub(super) fn error_table(caption: &str, rows: &[ErrorRow<'_>]) -> Markup {
    let mm = |metres: f64| number(1e3 * metres, 3);
    html! {
        div.scroll {
            table.accuracy {
                caption { (caption) }
                thead {
                    tr {
                        th rowspan="2" {}
                        @for axis in ["x", "y", "z", "3-D"] { th.group colspan="2" { (axis) } }
                    }
                    tr {
                        @for _ in 0..3 { th.first { "max" } th { "mean" } }
                        th.first { "RMS" } th { "max" }
                    }
                }
                tbody {
                    @for ErrorRow { mode, title, row, published, published_as } in rows {
                        tr {
                            th scope="row" { (key(&look(*mode))) (title) }
                            @for axis in 0..3 { td.first { (mm(row.max[axis])) } td { (mm(row.mean[axis])) } }
                            td.first { (mm(row.rms_3d)) } td { (mm(row.max_3d)) }
                        }
                        @if let Some(figures) = published {
                            tr.published {
                                th scope="row" { (published_as) }
                                @for pair in figures.chunks(2) {
                                    @for (i, metres) in pair.iter().enumerate() {
                                        td.first[i == 0] { (number(1e3 * metres, 1)) }
                                    }
                                }
                                td.first {} td {}
                            }
                        }
                    }
                }
            }
        }
    }
}

/// Angles between measured and predicted orientations; nothing where none was measured.
fn orientation_table(outcome: &Outcome, index: usize, kind: SetKind) -> Markup {
    let mrad = |angle: f64| number(1e3 * angle, 3);
    let rows: Vec<_> =
        outcome.modes.iter().filter_map(|mode| Some((mode, mode.orientation_row(index)?))).collect();
    html! {
        @if let Some((_, first)) = rows.first() {
            div.scroll {
                table {
                    caption { (set_title(kind)) ", " (first.count) " orientations: angle between measured and predicted, mrad" }
                    thead { tr { th {} th.first { "RMS" } th { "max" } } }
                    tbody {
                        @for (mode, row) in &rows {
                            tr {
                                th scope="row" { (key(&look(mode.mode))) (mode.mode.title()) }
                                td.first { (mrad(row.rms)) } td { (mrad(row.max)) }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn errors_section(outcome: &Outcome) -> Result<Markup, ReportError> {
    let all: Vec<_> = outcome.modes.iter().collect();
    let after: Vec<_> = outcome.modes.iter().filter(|m| m.estimate.is_some()).collect();
    let titles = |modes: &[&crate::pipeline::ModeOutcome]| modes.iter().map(|m| m.mode).collect::<Vec<_>>();
    let before_and_after = plots::residuals(outcome, &all)?;
    let zoomed = if after.is_empty() || after.len() == all.len() {
        None
    } else {
        Some(plots::residuals(outcome, &after)?)
    };
    let distribution = plots::distribution(outcome)?;
    // Before, and after with the best model: those between show the same more faintly.
    let mut arrows = Vec::new();
    for mode in
        outcome.modes.first().into_iter().chain(outcome.modes.last().filter(|_| outcome.modes.len() > 1))
    {
        if let Some((drawn, scale)) = region::arrows(outcome, mode)? {
            arrows.push((mode.mode, drawn, scale));
        }
    }
    Ok(html! {
        section #errors {
            h2 { "Errors" }
            (figure(&titles(&all), &before_and_after, &html! {
                "Measured minus predicted position of every pose, per axis, before and after calibration."
            }, false))
            @if let Some(zoomed) = zoomed {
                (figure(&titles(&after), &zoomed, &html! {
                    "The same after calibration only, on a scale of its own. A pattern over the poses is something that the "
                    "model lacks; measurement noise alone would look like noise."
                }, false))
            }
            (figure(&titles(&all), &distribution, &html! {
                "Share of the observations whose 3-D error is at most the given one. Curves further to the left are better."
            }, true))
            (percentile_table(outcome))
            @for (mode, arrows, scale) in &arrows {
                (figure(&[*mode], arrows, &html! {
                    "Errors of \u{201c}" (mode.title()) "\u{201d} over the working region, in three views of the base frame: from the predicted "
                    "position (small dot) towards the measured one (large dot), drawn " (scale) " times as long as they are. Arrows that agree with "
                    "their neighbours show something that the model lacks."
                }, false))
            }
        }
    })
}

fn percentile_table(outcome: &Outcome) -> Markup {
    html! {
        div.scroll {
            table {
                caption { "3-D error that a share of the observations stays below, mm" }
                thead {
                    tr { th rowspan="2" {} @for set in &outcome.sets { th.group colspan="3" { (set_title(set.kind)) } } }
                    tr { @for _ in &outcome.sets { th.first { "50 %" } th { "95 %" } th { "all" } } }
                }
                tbody {
                    @for mode in &outcome.modes {
                        tr {
                            th scope="row" { (key(&look(mode.mode))) (mode.mode.title()) }
                            @for errors in &mode.errors {
                                @let sorted = sorted_norms(errors);
                                @for (i, share) in [0.5, 0.95, 1.0].into_iter().enumerate() {
                                    td.first[i == 0] {
                                        @if let Some(value) = quantile(&sorted, share) { (number(1e3 * value, 3)) }
                                    }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn sorted_norms(errors: &[nalgebra::Vector3<f64>]) -> Vec<f64> {
    let mut norms: Vec<_> = errors.iter().map(nalgebra::Vector3::norm).collect();
    norms.sort_by(f64::total_cmp);
    norms
}

/// The smallest value that at least `share` of the sorted values do not exceed.
fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    let n = sorted.len() as f64;
    sorted.iter().enumerate().find(|(i, _)| (*i as f64 + 1.0) >= share * n - 1e-9).map(|(_, v)| *v)
}

fn parameters_section(outcome: &Outcome) -> Result<Markup, ReportError> {
    let rows = parameter_rows(outcome);
    let modes: Vec<_> = fitted(outcome).iter().map(|(mode, _)| *mode).collect();
    let truth_known = rows.iter().any(|row| row.truth().is_some());
    let mut parts = Vec::new();
    for (unit, name) in [(Unit::Metre, "Lengths"), (Unit::Radian, "Angles")] {
        if let Some(plot) = forest::parameters(&rows, &modes, unit)? {
            let selected: Vec<_> = rows.iter().filter(|row| row.id.unit() == unit).collect();
            parts.push((unit, name, plot, selected));
        }
    }
    Ok(html! {
        section #parameters {
            h2 { "Parameters" }
            @if parts.is_empty() {
                p { "No parameter was identified." }
            } @else {
                p {
                    "Link parameters are deviations from the nominal robot; frame parameters displace the base in the tracker's "
                    "frame from where its registration puts it; target parameters are deviations from the stated offset."
                }
            }
            @for (unit, name, plot, selected) in &parts {
                h3 { (name) }
                (figure(&modes, plot, &html! {
                    (name) " in " (printed_unit(*unit).0) "."
                    @if selected.iter().any(|row| row.cells.iter().flatten().any(|c| c.sigma.is_some())) {
                        " Horizontal bars are 95 % intervals from the covariance of the fit."
                    } @else {
                        " A singular system has no standard deviations."
                    }
                    @if truth_known {
                        " On the left, a vertical bar in each row is the truth of the simulated robot. On the right, the error is estimate minus truth, each model on its own scale."
                    }
                }, false))
                (parameter_table(selected, &modes, *unit, truth_known))
            }
        }
    })
}

fn parameter_table(rows: &[&ParameterRow], modes: &[Mode], unit: Unit, truth_known: bool) -> Markup {
    let (unit, factor) = printed_unit(unit);
    let scaled = |value: Option<f64>| value.map_or("\u{2013}".to_owned(), |v| number(factor * v, 4));
    let far = |cell: &ParameterCell| cell.error_over_sigma().is_some_and(|r| r.abs() > NORMAL_95);
    let columns = if truth_known { "3" } else { "2" };
    html! {
        div.scroll {
            table.parameters {
                thead {
                    tr {
                        th rowspan="2" { "parameter" }
                        @if truth_known { th rowspan="2" { "truth" br; (unit) } }
                        @for mode in modes { th.group colspan=(columns) { (key(&look(*mode))) (mode.title()) } }
                    }
                    tr {
                        @for _ in modes {
                            th.first { "estimate" br; (unit) }
                            th { "sigma" br; (unit) }
                            @if truth_known { th { "error" br; "/ sigma" } }
                        }
                    }
                }
                tbody {
                    @for row in rows {
                        tr {
                            th scope="row" { code { (row.id) } " " span.note { (parameter_words(row.id)) } }
                            @if truth_known { td { (scaled(row.truth())) } }
                            @for cell in &row.cells {
                                td.first { (scaled(cell.map(|c| c.value))) }
                                td { (scaled(cell.and_then(|c| c.sigma))) }
                                @if truth_known {
                                    td.far[cell.as_ref().is_some_and(far)] {
                                        @if let Some(ratio) = cell.and_then(|c| c.error_over_sigma()) { (number(ratio, 1)) }
                                    }
                                }
                            }
                        }
                    }
                }
            }
        }
        @if truth_known {
            p.note { "Bold: the truth lies outside the 95 % interval." }
        }
    }
}

fn trust_section(outcome: &Outcome) -> Markup {
    let fitted = fitted(outcome);
    html! {
        section #trust {
            h2 { "Can the numbers be trusted?" }
            @if fitted.is_empty() {
                p { "No model was fitted." }
            } @else {
                (estimate_table(&fitted))
                p.note {
                    "The condition number is that of the system with scaled columns. \u{221a}(\u{3c7}\u{b2}/dof) compares the residuals with the stated noise: "
                    "1 where model and noise are right; dof are the degrees of freedom."
                }
            }
            @for (mode, estimate) in &fitted {
                (mode_trust(*mode, estimate))
            }
            (sweep_section(outcome))
            (drift_section(outcome))
            @for set in outcome.sets.iter().filter(|s| !s.dropped.is_empty()) {
                h3 { (set_title(set.kind)) ": " (counted(set.dropped.len(), "pose")) " not measured" }
                ul { @for (pose, why) in &set.dropped { li { "pose " (pose) ": " (why) } } }
            }
        }
    }
}

fn estimate_table(fitted: &[(Mode, &Estimate)]) -> Markup {
    html! {
        div.scroll {
            table {
                thead {
                    tr {
                        th {} th.words { "state" } th { "iterations" } th { "rank" } th { "condition" }
                        th { "\u{3c7}\u{b2}" } th { "dof" } th { "\u{221a}(\u{3c7}\u{b2}/dof)" }
                    }
                }
                tbody {
                    @for (mode, estimate) in fitted {
                        tr {
                            th scope="row" { (key(&look(*mode))) (mode.title()) }
                            td.words {
                                @if estimate.termination.converged() { "converged: " } @else { strong { "not converged: " } }
                                (estimate.termination.words())
                            }
                            td { (estimate.iterations.len()) }
                            td { (estimate.spectrum.rank) " of " (estimate.parameters.len()) }
                            td { (condition_words(estimate.spectrum.condition)) }
                            @match estimate.noise {
                                NoiseScale::Stated => td { (significant(estimate.chi2)) },
                                NoiseScale::Residuals(_) => td { "\u{2013}" },
                            }
                            td { (format!("{:.1}", estimate.degrees_of_freedom)) }
                            td {
                                @if let Some(ratio) = consistency_ratio(estimate) { (significant(ratio)) } @else { "\u{2013}" }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn mode_trust(mode: Mode, estimate: &Estimate) -> Markup {
    let spectrum = &estimate.spectrum;
    // Weak directions have a list of their own below.
    let warnings: Vec<_> = estimate.warnings.iter().filter(|w| !matches!(w, Warning::Weak { .. })).collect();
    html! {
        h3 { (key(&look(mode))) (mode.title()) }
        @if warnings.is_empty() && spectrum.weak.is_empty() && spectrum.dependent.is_empty() {
            p { "No warning; every parameter is determined." }
        }
        @if !warnings.is_empty() {
            ul.warnings { @for warning in &warnings { li { (warning) } } }
        }
        @for words in left_out_words(estimate) { p { "Left out: " (words) "." } }
        @if !estimate.bounds.is_empty() {
            p { "Held within bounds: " (estimate.bounds.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")) "." }
        }
        (machine_noise(estimate))
        @if let NoiseScale::Residuals(sigma) = estimate.noise {
            p { "The readings state no uncertainty; from the residuals, one coordinate has a standard deviation of " (length_words(sigma)) "." }
        }
        @if !spectrum.dependent.is_empty() {
            p { "Not identifiable from these measurements:" }
            ul { @for group in &spectrum.dependent { li { (dependent_words(group)) } } }
        }
        @if !spectrum.weak.is_empty() {
            p { "Poorly determined:" }
            ul { @for weak in &spectrum.weak { li { (weak_words(weak)) } } }
        }
        @if !(spectrum.dependent.is_empty() && spectrum.weak.is_empty()) {
            p.note { code { "calibrig identifiability" } " says what to fix or to measure." }
        }
    }
}

/// What readings and machine were found to do beside what is stated, and what that makes of intervals.
fn machine_noise(estimate: &Estimate) -> Markup {
    let is_found =
        |a: &&Assumption| matches!(a, Assumption::NoiseOfReadings { .. } | Assumption::NoiseOfMachine(_));
    html! {
        @for found in estimate.assumptions.iter().filter(is_found) { p { (found) "." } }
        @if let Some(freedom) = estimate.interval_freedom.filter(|freedom| freedom.is_finite()) {
            p {
                "A 95 % interval is " (format!("{:.2}", estimate.interval_factor(0.95))) " standard deviations to either side (Student\u{2019}s t, "
                (format!("{freedom:.1}")) " degrees of freedom of the estimated noise)."
            }
        }
    }
}

fn dependent_words(group: &DependentGroup) -> String {
    if group.with.is_empty() {
        return format!(
            "{} ({}) changes nothing that was measured.",
            group.redundant,
            parameter_words(group.redundant)
        );
    }
    format!(
        "{} ({}) does the same as {} (m and rad): only the combination is determined.",
        group.redundant,
        parameter_words(group.redundant),
        combination(&group.with)
    )
}

fn weak_words(weak: &WeakDirection) -> String {
    format!(
        "{} (scaled weights): changed together in these proportions, they show {} of what the best determined combination shows in the \
         measurements.",
        combination(&weak.members),
        fraction_words(weak.singular_value)
    )
}

/// "1/530" with two significant digits; "1/1.7e5" beyond ten thousand.
fn fraction_words(share: f64) -> String {
    let factor = 1.0 / share;
    if factor < 1e4 {
        let unit = 10.0_f64.powf(factor.log10().floor() - 1.0);
        format!("1/{:.0}", (factor / unit).round() * unit)
    } else {
        format!("1/{factor:.1e}")
    }
}

fn combination(members: &[(ParameterId, f64)]) -> String {
    let mut text = String::new();
    for (i, (id, weight)) in members.iter().enumerate() {
        let sign = match (i, *weight < 0.0) {
            (0, false) => "",
            (0, true) => "\u{2212}",
            (_, false) => " + ",
            (_, true) => " \u{2212} ",
        };
        let weight = weight.abs();
        if (weight - 1.0).abs() < 5e-4 {
            let _ = write!(text, "{sign}{id}");
        } else {
            let _ = write!(text, "{sign}{} {id}", significant(weight));
        }
    }
    text
}

fn reproduce_section(outcome: &Outcome) -> Markup {
    html! {
        section #reproduce {
            h2 { "How to reproduce" }
            pre { code { (command(outcome)) } }
            p {
                "With calibrig " (env!("CARGO_PKG_VERSION")) ", the same input and the same options, the numbers are the same on the same machine, bit by bit. "
                "The numbers of this page in full precision, in metres and radians, are in " code { "report.json" }
                " beside it (schema " code { (super::SCHEMA) } ")."
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

/// The command line of this run, for a POSIX shell.
fn command(outcome: &Outcome) -> String {
    let source =
        |wanted: &str| outcome.sources.iter().find(|(role, _)| role == wanted).map(|(_, s)| quoted(&s.name));
    match outcome.input.kind {
        "scenario" if outcome.command.is_none() => {
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
        _ => outcome.command.clone().unwrap_or_else(|| "calibrig identify".to_owned()),
    }
}

pub(super) fn figure(modes: &[Mode], plot: &str, caption: &Markup, lines: bool) -> Markup {
    html! {
        figure {
            div.legend {
                @for mode in modes {
                    span {
                        @if lines { (line_key(&look(*mode))) } @else { (key(&look(*mode))) }
                        (mode.title())
                    }
                }
            }
            div.scroll { (PreEscaped(plot)) }
            figcaption { (caption) }
        }
    }
}

/// The marker of a mode, to stand beside its title.
pub(super) fn key(look: &Look) -> Markup {
    let colour = hex(look.light);
    html! {
        svg.key width="14" height="14" viewBox="-7 -7 14 14" aria-hidden="true" {
            @match look.marker {
                Marker::Circle => circle r="4" fill="none" stroke=(colour) stroke-width="2" {},
                Marker::Triangle => polygon points="0,-5 5,4 -5,4" fill=(colour) {},
                Marker::Square => rect x="-4" y="-4" width="8" height="8" fill=(colour) {},
                Marker::Cross => path d="M-4-4 4 4M-4 4 4-4" stroke=(colour) stroke-width="2" {},
                Marker::Diamond => polygon points="0,-5 5,0 0,5 -5,0" fill=(colour) {},
            }
        }
    }
}

/// The line of a mode.
fn line_key(look: &Look) -> Markup {
    let dashes = look.dash.map(|(dash, gap)| format!("{dash} {gap}"));
    html! {
        svg.key width="34" height="14" viewBox="0 -7 34 14" aria-hidden="true" {
            line x1="0" y1="0" x2="34" y2="0" stroke=(hex(look.light)) stroke-width="2" stroke-dasharray=[dashes] {}
        }
    }
}

/// A number for a table.
pub(super) fn number(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return "\u{2013}".to_owned();
    }
    if value.abs() >= 1e6 {
        return format!("{value:.1e}").replace('-', "\u{2212}");
    }
    let text = format!("{value:.decimals$}");
    // What rounds to zero has no sign.
    match text.strip_prefix('-') {
        Some(digits) if digits.contains(|c| ('1'..='9').contains(&c)) => format!("\u{2212}{digits}"),
        Some(digits) => digits.to_owned(),
        None => text,
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::report::sample;

    /// Every element that is opened is closed, in order.
    pub(in crate::report) fn assert_balanced(page: &str) {
        const VOID: [&str; 3] = ["meta", "br", "!DOCTYPE"];
        let mut open: Vec<&str> = Vec::new();
        let mut rest = page;
        while let Some(start) = rest.find('<') {
            rest = &rest[start + 1..];
            let end = rest.find('>').expect("a closed tag");
            let tag = &rest[..end];
            let name = tag.trim_start_matches('/').split([' ', '/']).next().expect("a name");
            if name == "style" && !tag.starts_with('/') {
                rest = &rest[rest.find("</style>").expect("the end of the style sheet") + 8..];
                continue;
            }
            if tag.starts_with('/') {
                assert_eq!(open.pop(), Some(name), "before {}", &rest[..rest.len().min(80)]);
            } else if !tag.ends_with('/') && !VOID.contains(&name) {
                open.push(name);
            }
            rest = &rest[end + 1..];
        }
        assert!(open.is_empty(), "{open:?} stay open");
    }

    #[test]
    fn pages_are_well_formed_and_fetch_nothing() {
        for outcome in [sample::simulated(), sample::measured(), sample::driven()] {
            let page = html_report(&outcome).expect("a page");
            assert_balanced(&page);
            for wrong in ["<script", "<link", "<img", "src=", "@import", "url(", "NaN", ">inf<", ">-inf<"] {
                assert!(!page.contains(wrong), "{wrong}");
            }
            let addresses = page.matches("http").count();
            assert_eq!(addresses, page.matches("http://www.w3.org/2000/svg").count(), "only the name of SVG");
            for (at, _) in page.match_indices("href=\"#") {
                let id = page[at + 7..].split('"').next().expect("an anchor");
                assert!(page.contains(&format!("id=\"{id}\"")), "{id}");
            }
        }
    }

    #[test]
    fn no_string_of_a_user_reaches_the_page_as_it_is() {
        let page = html_report(&sample::measured()).expect("a page");
        assert!(!page.contains("alert(\"1\")"));
        let escaped = "&lt;script&gt;alert(&quot;1&quot;)&lt;/script&gt; &amp; 'co'";
        // Title, heading, registration, dropped pose, warning, file, and the command with its quotes quoted.
        assert!(page.matches(escaped).count() >= 6, "{}", page.matches(escaped).count());
        assert!(page.contains("calibrig identify --model '&lt;script&gt;"));
        assert!(page.contains("--measurements grid.csv"));
    }

    #[test]
    fn the_tables_hold_the_numbers_in_mm_and_mrad() {
        let outcome = sample::simulated();
        let page = html_report(&outcome).expect("a page");
        for mode in &outcome.modes {
            for row in mode.rows.iter().flatten() {
                for metres in [row.max.x, row.mean.y, row.max.z, row.rms_3d, row.max_3d] {
                    let cell = format!("{:.3}</td>", 1e3 * metres);
                    assert!(page.contains(&cell), "{cell}");
                }
            }
        }
        assert!(page.contains(">26.2</td>"), "published");
        assert!(page.contains("\u{2212}17.1000</td>"), "true delta_theta4 in mrad");
        assert!(page.contains("calibrig run 'scenarios/spray painting.toml' --seed 42 --out DIR"));
    }

    #[test]
    fn zero_has_no_sign_and_what_is_no_number_is_a_dash() {
        assert_eq!(
            [-4e-5, -6e-5, 0.0, f64::NAN].map(|v| number(v, 4)),
            ["0.0000", "\u{2212}0.0001", "0.0000", "\u{2013}"]
        );
    }

    #[test]
    fn fractions_have_two_digits() {
        assert_eq!([1.9e-3, 0.01, 5.9e-6].map(fraction_words), ["1/530", "1/100", "1/1.7e5"]);
    }

    #[test]
    fn quantiles_by_hand() {
        let values = [1.0, 2.0, 3.0, 4.0];
        assert_eq!(
            [0.25, 0.5, 0.51, 0.95, 1.0].map(|s| quantile(&values, s)),
            [1.0, 2.0, 3.0, 4.0, 4.0].map(Some)
        );
        assert_eq!(quantile(&[], 0.5), None);
    }

    #[test]
    fn doubts_stand_in_front() {
        let page = html_report(&sample::measured()).expect("a page");
        let (doubt, summary) = (page.find("Doubtful."), page.find("id=\"summary\""));
        assert!(doubt.expect("a doubt") < summary.expect("a summary"));
        assert!(page.contains("delta_d6 (link 6, offset d) does the same as delta_d5"));
        assert!(!html_report(&sample::simulated()).expect("a page").contains("Doubtful."));
    }
}
