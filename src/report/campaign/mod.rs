//! The page of a campaign: one file that opens anywhere, without scripts and without anything fetched, and of bounded size at any number of trials.

mod consistency;
mod distribution;
mod sensitivity;
mod sweep;
mod sweep_figure;
#[cfg(test)]
mod tests;
mod words;

use std::fmt::Write;

use maud::{Markup, html};
use words::{count, level, millimetres, name, shown};

use crate::montecarlo::{CampaignSummary, GroupSummary, ModeSummary};
use crate::report::markup::page;
use crate::report::words::{cut, length_words};
use calibrig_campaign::design::Design;
use calibrig_campaign::plan::quoted;
use calibrig_campaign::statistics::Convergence;

/// Kinds of reasons that are told.
const REASONS: usize = 20;

/// The page. A figure that cannot be drawn is a line that says so: the numbers are there all the same.
pub fn campaign_html(summary: &CampaignSummary) -> String {
    let body = html! {
        (header(summary))
        main {
            (matched(summary))
            (summary_section(summary))
            @match &summary.groups[..] {
                [group] if group.levels.is_empty() => (distribution::section(summary, group)),
                [] => {},
                _ => (sweep::section(summary)),
            }
            @if tells_sensitivity(summary) { (sensitivity::section(summary)) }
            @if consistency::is_told(summary) { (consistency::section(summary)) }
            (worst_section(summary))
            (reproduce_section(summary))
        }
    };
    page(&format!("Campaign: {}", shown(&summary.name)), &body)
}

fn is_sweep(summary: &CampaignSummary) -> bool {
    matches!(summary.study.design, Design::Sweep { .. })
}

fn tells_sensitivity(summary: &CampaignSummary) -> bool {
    matches!(summary.study.design, Design::Indices { .. } | Design::Screening { .. })
}

fn is_matched(summary: &CampaignSummary) -> bool {
    summary.study.plant == crate::pipeline::PlantKind::Analytic.key()
}

fn header(summary: &CampaignSummary) -> Markup {
    let last = (summary.first + summary.trials).saturating_sub(1);
    html! {
        header {
            p.eyebrow { "Monte Carlo campaign" }
            h1 { (shown(&summary.name)) }
            dl.facts {
                div { dt { "Trials" } dd { (count(summary.trials)) @if summary.first > 0 { ", from " (count(summary.first)) " to " (count(last)) } } }
                div { dt { "Failed" } dd.far[summary.failed > 0] { (count(summary.failed)) } }
                div { dt { "Doubtful" } dd { (count(summary.doubtful)) } }
                div { dt { "Drawn again" } dd { (count(summary.redrawn)) } }
                div { dt { "Seed" } dd { (summary.seed) } }
                div { dt { "Plant" } dd { (plant_words(summary)) } }
                @if let Some(tolerance) = summary.tolerance { div { dt { "Tolerance" } dd { (millimetres(tolerance)) } } }
                div { dt { "Software" } dd { "calibrig " (env!("CARGO_PKG_VERSION")) } }
                div.wide { dt { "Design" } dd { (design_words(summary)) } }
                div.wide { dt { "SHA-256 of the input" } dd.hash { (summary.sha256) } }
            }
            nav {
                a href="#summary" { "Summary" } " "
                @if is_sweep(summary) { @if !summary.groups.is_empty() { a href="#sweep" { "Sweep" } " " } }
                @else if !summary.groups.is_empty() { a href="#distribution" { "Accuracy" } " " }
                @if tells_sensitivity(summary) { a href="#sensitivity" { "What it depends on" } " " }
                @if consistency::is_told(summary) { a href="#consistency" { "Uncertainties" } " " }
                @if !summary.worst.is_empty() { a href="#worst" { "Worst trials" } " " }
                a href="#reproduce" { "Reproduce" }
            }
        }
    }
}

fn plant_words(summary: &CampaignSummary) -> String {
    match summary.study.plant.as_str() {
        "rapier" => "rapier, the multibody simulation".to_owned(),
        _ if is_matched(summary) => "analytic, a matched model".to_owned(),
        other => shown(other),
    }
}

/// What such a plant can tell, in front of its figures.
fn matched(summary: &CampaignSummary) -> Markup {
    html! {
        @if is_matched(summary) {
            aside.doubt role="note" {
                strong { "A matched model. " }
                "The identification\u{2019}s own elastostatics stand for the machine: this campaign tests the estimator, not the method. How accurate a real robot gets is not told here."
            }
        }
    }
}

fn design_words(summary: &CampaignSummary) -> String {
    let names: Vec<_> = summary
        .study
        .factors
        .iter()
        .map(|factor| format!("\u{201c}{}\u{201d}", name(&factor.name)))
        .take(12)
        .collect();
    let more = summary.study.factors.len().saturating_sub(names.len());
    let mut names = names.join(", ");
    if more > 0 {
        // Writing to a String cannot fail.
        let _ = write!(names, " and {more} others");
    }
    match &summary.study.design {
        Design::Plain { .. } if names.is_empty() => "plain: every trial is drawn for itself".to_owned(),
        Design::Plain { .. } => format!("plain: every trial is drawn for itself; varied are {names}"),
        Design::Sweep { levels, repeats } => {
            let levels = levels.iter().map(ToString::to_string).collect::<Vec<_>>().join(" \u{d7} ");
            format!(
                "sweep of {names}: {levels} levels with {} draws each, the same ones at every level",
                count(*repeats)
            )
        }
        Design::Indices { base, .. } => {
            format!("Sobol's indices of {names}: a base of {} rows", count(*base))
        }
        Design::Screening { trajectories, .. } => {
            format!("Morris screening of {names}: {} trajectories", count(*trajectories))
        }
    }
}

fn summary_section(summary: &CampaignSummary) -> Markup {
    html! {
        section #summary {
            h2 { "Summary" }
            ul { @for line in sentences(summary) { li { (line) } } }
            (failures(summary))
        }
    }
}

fn sentences(summary: &CampaignSummary) -> Vec<String> {
    let mut lines = vec![match summary.failed {
        0 => format!("All {} trials were carried out to the end.", count(summary.trials)),
        failed => format!("{} of {} trials failed.", count(failed), count(summary.trials)),
    }];
    if let Some(answer) = summary.answer() {
        lines.insert(0, answer);
    }
    if summary.doubtful > 0 {
        lines.push(format!("{} trials are doubtful: the estimate of a mode did not converge, lacks rank, is at a bound or contradicts what was stated. They are in the figures.", count(summary.doubtful)));
    }
    if summary.redrawn > 0 {
        lines.push(format!(
            "{} times something impossible was drawn, and drawn again (column redrawn).",
            count(summary.redrawn)
        ));
    }
    lines.extend(convergence(summary));
    lines
}

/// Whether the trials are enough, by the figure that is known worst.
fn convergence(summary: &CampaignSummary) -> Option<String> {
    let known = |group: &'_ GroupSummary| -> Vec<(String, Convergence)> {
        let place = place_words(summary, group);
        let of = |mode: &ModeSummary| {
            Some((format!("\u{201c}{}\u{201d}{place}", mode.mode.title()), mode.told()?.convergence?))
        };
        group.modes.iter().filter_map(of).collect()
    };
    let all: Vec<_> = summary.groups.iter().flat_map(known).collect();
    let wanted = all.first()?.1.wanted;
    let wanting = all
        .iter()
        .filter(|(_, convergence)| !convergence.is_enough())
        .max_by_key(|(_, convergence)| convergence.more());
    let Some((name, most)) = wanting else {
        return Some(format!(
            "The trials are enough: every mean RMS is known within {}\u{a0}% (95\u{a0}%).",
            1e2 * wanted
        ));
    };
    let what = if is_sweep(summary) { "further trials of every combination" } else { "further trials" };
    Some(format!(
        "The mean RMS of {name} is known within {:.1}\u{a0}% (95\u{a0}%): some {} {what} would bring it to {}\u{a0}%.",
        1e2 * most.reached,
        count(most.more()),
        1e2 * wanted
    ))
}

/// " at poses = 20, noise = 0.1"; nothing of all trials.
fn place_words(summary: &CampaignSummary, group: &GroupSummary) -> String {
    let pairs: Vec<_> = summary
        .study
        .factors
        .iter()
        .zip(&group.levels)
        .map(|(factor, text)| format!("{} = {}", name(&factor.name), level(text)))
        .collect();
    if pairs.is_empty() { String::new() } else { format!(" at {}", pairs.join(", ")) }
}

fn failures(summary: &CampaignSummary) -> Markup {
    let counted: u64 = summary.reasons.iter().take(REASONS).map(|reason| reason.count).sum();
    html! {
        @if !summary.reasons.is_empty() {
            div.scroll { table {
                caption { "Why trials failed" }
                thead { tr { th.words { "reason of the first" } th { "trials" } th { "first" } } }
                tbody { @for reason in summary.reasons.iter().take(REASONS) {
                    tr { td.words { (shown(&reason.text)) } td { (count(reason.count)) } td { (reason.trial) } }
                } }
            } }
            p.note {
                "Reasons that differ in numbers alone are one. "
                @if counted < summary.failed { (count(summary.failed - counted)) " trials failed for other reasons. " }
                "The column " code { "reason" } " of the table has all of them."
            }
        }
    }
}

fn worst_section(summary: &CampaignSummary) -> Markup {
    let first = summary.worst.first();
    html! {
        @if let Some(first) = first {
            section #worst {
                h2 { "Worst trials" }
                p { "The largest RMS 3-D errors of \u{201c}" (first.mode.title()) "\u{201d}. The command carries out the trial again, and leaves a report and " code { "recording.rrd" } ", which Rerun opens; with " code { "--live" } " it is shown while it goes on." }
                div.scroll { table.files {
                    thead { tr { th { "trial" } th { "RMS" } th { "command" } } }
                    tbody { @for worst in &summary.worst {
                        tr { th scope="row" { (worst.trial) } td { (length_words(worst.rms_3d)) } td { code { (cut(&summary.rerun_command(worst.trial), 2000)) } } }
                    } }
                } }
            }
        }
    }
}

/// The command of this campaign, for a POSIX shell.
fn command(summary: &CampaignSummary) -> String {
    let study = &summary.study;
    let trials = match study.design {
        Design::Plain { .. } => summary.trials,
        _ => study.design.trials(),
    };
    let first = if summary.first > 0 { format!(" --first {}", summary.first) } else { String::new() };
    let tolerance = match summary.tolerance {
        Some(tolerance) if summary.tolerance != study.tolerance => {
            format!(" --tolerance {}", millimetres(tolerance).replace(' ', ""))
        }
        _ => String::new(),
    };
    let (scenario, seed, plant) = (quoted(&summary.scenario), summary.seed, quoted(&study.plant));
    cut(
        &format!(
            "calibrig montecarlo {scenario} --trials {trials} --seed {seed} --plant {plant}{first}{tolerance} --out DIR"
        ),
        4000,
    )
}

fn reproduce_section(summary: &CampaignSummary) -> Markup {
    let of = |mode: &ModeSummary| Some(format!("{}.{}.rms_3d_m", mode.mode.key(), mode.told()?.kind.key()));
    let column = summary.modes().iter().rev().find_map(of);
    let mean = column.as_ref().map_or_else(String::new, |column| format!(", avg(\"{column}\")"));
    let column = column.unwrap_or_else(|| "status".to_owned());
    let lines = [
        format!("pandas.read_parquet(\"trials.parquet\")[\"{column}\"].describe()    # pandas"),
        format!("polars.read_parquet(\"trials.parquet\")[\"{column}\"].describe()    # Polars"),
        format!("SELECT status, count(*){mean} FROM 'trials.parquet' GROUP BY status;    -- DuckDB"),
    ];
    html! {
        section #reproduce {
            h2 { "How to reproduce" }
            pre { code { (command(summary)) } }
            p {
                "With calibrig " (env!("CARGO_PKG_VERSION")) " and the same input, every trial is the same to the bit on the same machine, on any number of threads and in any shards. "
                "The SHA-256 of the input is " span.hash { (summary.sha256) } "."
            }
            h3 { "The table" }
            p { "Every trial is a row of " code { "trials.parquet" } ", in SI units; what is on this page is in " code { "summary.json" } " in full precision." }
            pre { code { (lines.join("\n")) } }
        }
    }
}
