//! Whether estimates are as certain as they say.

use std::collections::BTreeMap;

use maud::{Markup, html};

use super::sweep::{MOST_ROWS, group_words};
use super::words::{NONE, count, drawn, estimate, mean, share};
use crate::montecarlo::{BAND, CampaignSummary, GroupSummary, ModeSummary, ParameterSummary};
use crate::report::files::ReportError;
use crate::report::markup::key;
use crate::report::plots::look;
use crate::report::rows::{Dot, FAR, Panel, dots};
use crate::report::words::{number, parameter_words, printed_unit};
use calibrig_campaign::statistics::{Estimated, Interval};
use calibrig_model::ParameterId;

/// Parameters that are drawn and listed.
const MOST_PARAMETERS: usize = 120;
/// Combinations that are drawn.
const MOST_DRAWN: usize = 40;

fn fitted(group: &GroupSummary) -> impl Iterator<Item = &ModeSummary> {
    group.modes.iter().filter(|mode| mode.chi2_per_dof.is_some() || mode.nees.is_some())
}

/// Whether there is something to tell.
pub(super) fn is_told(summary: &CampaignSummary) -> bool {
    summary.groups.iter().any(|group| fitted(group).next().is_some())
}

/// The section.
pub(super) fn section(summary: &CampaignSummary) -> Markup {
    let mut modes: Vec<_> =
        summary.groups.iter().flat_map(|group| fitted(group).map(|mode| mode.mode)).collect();
    modes.sort_unstable_by_key(|mode| {
        calibrig_estimation::identification::Mode::ALL.iter().position(|known| known == mode)
    });
    modes.dedup();
    let is_one = matches!(&summary.groups[..], [group] if group.levels.is_empty());
    html! {
        section #consistency {
            h2 { "Are the stated uncertainties true?" }
            figure {
                div.legend { @for mode in &modes { span { (key(&look(*mode))) (mode.title()) } } }
                (drawn(overview(summary, is_one)))
                figcaption {
                    "About 1 (coverage: 95 %) where the model and the stated uncertainties are right. NEES: squared error of all parameters in units of the stated covariance, over their number; "
                    "grey is the band in which 99.9 % of sound campaigns lie. Chi-square: of the residuals, over the degrees of freedom, mean over the trials with its 95 % interval. "
                    "Coverage: share of the true coordinates of held-out poses inside their stated 95 % intervals, with its 99.9 % interval from the scatter between trials."
                }
            }
            (table(summary, is_one))
            @if is_one { @for group in &summary.groups { (parameters(group)) } }
            @else { p.note { "The parameters of every combination are in " code { "summary.json" } "." } }
        }
    }
}

fn overview(summary: &CampaignSummary, is_one: bool) -> Result<String, ReportError> {
    let step = summary.groups.len().div_ceil(MOST_DRAWN).max(1);
    let groups: Vec<_> = summary.groups.iter().step_by(step).collect();
    // Rows are modes, or combinations with all modes in one row.
    let rows: Vec<(String, Vec<&ModeSummary>)> = if is_one {
        groups
            .iter()
            .flat_map(|group| fitted(group).map(|mode| (mode.mode.title().to_owned(), vec![mode])))
            .collect()
    } else {
        groups.iter().map(|group| (group_words(group), fitted(group).collect())).collect()
    };
    let names: Vec<_> = rows.iter().map(|(name, _)| name.clone()).collect();
    let panel = |title: &str, zero: f64, dot: &dyn Fn(&ModeSummary) -> Option<Dot>| {
        let rows =
            rows.iter().map(|(_, modes)| modes.iter().filter_map(|mode| dot(mode)).collect()).collect();
        Panel { far: FAR, ..Panel::of(title, zero, rows) }
    };
    let panels: Vec<_> = [
        panel("NEES a parameter", 1.0, &nees_dot),
        panel("chi-square per dof", 1.0, &chi2_dot),
        panel("coverage, %", 95.0, &prediction_dot),
    ]
    .into_iter()
    .filter(|panel| panel.rows.iter().any(|row| !row.is_empty()))
    .collect();
    dots("consistency", "Consistency of the stated uncertainties", &names, &panels)
}

fn nees_dot(mode: &ModeSummary) -> Option<Dot> {
    let nees = mode.nees?;
    let n = nees.parameters;
    Some(Dot {
        look: look(mode.mode),
        value: nees.mean / n,
        interval: None,
        band: Some((nees.band.0 / n, nees.band.1 / n)),
    })
}

fn chi2_dot(mode: &ModeSummary) -> Option<Dot> {
    let chi2 = mode.chi2_per_dof.as_ref()?;
    let interval = chi2.interval().map(|interval| (interval.low, interval.high));
    Some(Dot { look: look(mode.mode), value: chi2.mean, interval, band: None })
}

fn prediction_dot(mode: &ModeSummary) -> Option<Dot> {
    let predictions = mode.predictions?;
    let Estimated { value, interval } = predictions.estimate();
    Some(Dot {
        look: look(mode.mode),
        value: 1e2 * value,
        interval: interval.map(|interval| (1e2 * interval.low, 1e2 * interval.high)),
        band: None,
    })
}

fn table(summary: &CampaignSummary, is_one: bool) -> Markup {
    let rows: Vec<_> =
        summary.groups.iter().flat_map(|group| fitted(group).map(move |mode| (group, mode))).collect();
    let body = html! {
        div.scroll { table {
            thead { tr {
                @if !is_one { th.words { "combination" } }
                th {} th { "NEES a parameter" br; "and its 99.9 % band" } th { "chi-square" br; "per dof" }
                th { "squared error" br; "over the bound" } th { "coverage of" br; "predictions, %" } th { "iterations" } th { "doubtful" }
            } }
            tbody { @for (group, mode) in rows.iter().take(MOST_ROWS) {
                tr {
                    @if !is_one { th scope="row" { (group_words(group)) } }
                    (row(mode))
                }
            } }
        } }
    };
    html! {
        @if rows.len() > 12 { details { summary { "Figures of every combination" } (body) } } @else { (body) }
        @if rows.len() > MOST_ROWS { p.note { "and " (rows.len() - MOST_ROWS) " other rows: " code { "summary.json" } } }
        p.note {
            "Bold: outside its band. Chi-square, squared error and iterations are means over the trials with their 95 % intervals, coverage has its 99.9 % interval. "
            "Squared error over the bound: at the true machine, a parameter; in the mean at least 1 for machines that are drawn from the priors. "
            @if super::tells_sensitivity(summary) { "Trials of this design have draws in common: bands and intervals, which are of independent trials, are a guide only. " }
            "Doubtful: trials whose estimate did not converge, lacks rank, is at a bound or contradicts what was stated."
        }
    }
}

fn row(mode: &ModeSummary) -> Markup {
    let outside = mode.nees.is_some_and(|nees| !(nees.band.0..=nees.band.1).contains(&nees.mean));
    html! {
        th scope="row" { (key(&look(mode.mode))) (mode.mode.title()) }
        @match &mode.nees {
            Some(nees) => {
                @let n = nees.parameters;
                td {
                    span.far[outside] { (number(nees.mean / n, if nees.mean > 100.0 * n { 0 } else { 4 })) } br;
                    span.note { "[" (number(nees.band.0 / n, 4)) ", " (number(nees.band.1 / n, 4)) "]" }
                }
            },
            None => td { (NONE) },
        }
        td { @match &mode.chi2_per_dof { Some(chi2) => (mean(chi2, 1.0)), None => (NONE) } }
        td { @match &mode.squared_over_bound { Some(squared) => (mean(squared, 1.0)), None => (NONE) } }
        td { @match &mode.predictions {
            Some(predictions) => (estimate(&predictions.estimate(), 1e2)),
            None => (NONE),
        } }
        td { @match &mode.iterations { Some(iterations) => (mean(iterations, 1.0)), None => (NONE) } }
        td.far[mode.doubtful > 0] { (count(mode.doubtful)) }
    }
}

/// The parameters of all modes, each once, with what the modes say of it.
fn by_parameter(group: &GroupSummary) -> Vec<(ParameterId, Vec<(&ModeSummary, &ParameterSummary)>)> {
    let mut places: BTreeMap<String, usize> = BTreeMap::new();
    let mut rows: Vec<(ParameterId, Vec<_>)> = Vec::new();
    for mode in &group.modes {
        for parameter in &mode.parameters {
            let place = *places.entry(parameter.id.to_string()).or_insert_with(|| {
                rows.push((parameter.id, Vec::new()));
                rows.len() - 1
            });
            rows[place].1.push((mode, parameter));
        }
    }
    rows
}

fn parameters(group: &GroupSummary) -> Markup {
    let rows = by_parameter(group);
    if rows.is_empty() {
        return html! { p { "The truth of no parameter is known." } };
    }
    let left = rows.len().saturating_sub(MOST_PARAMETERS);
    let rows = &rows[..rows.len().min(MOST_PARAMETERS)];
    let mut modes: Vec<_> = group.modes.iter().filter(|mode| !mode.parameters.is_empty()).collect();
    modes.dedup_by_key(|mode| mode.mode);
    html! {
        h3 { "Parameters" }
        figure {
            div.legend { @for mode in &modes { span { (key(&look(mode.mode))) (mode.mode.title()) } } }
            (drawn(parameter_figure(rows)))
            figcaption {
                "RMSE over stated: root mean square error over what the estimate states as its standard deviation; about 1 for an honest estimator. RMSE over bound: over the least that is possible, where that is known; "
                "about 1 for a good one. Both with 95 % intervals. Coverage: how often the stated 95 % interval held the truth, with its exact 99.9 % interval."
            }
        }
        details {
            summary { "Figures of every parameter" }
            @for mode in modes { (parameter_table(mode)) }
        }
        @if left > 0 { p.note { "and " (left) " other parameters: " code { "summary.json" } } }
    }
}

fn parameter_figure(
    rows: &[(ParameterId, Vec<(&ModeSummary, &ParameterSummary)>)],
) -> Result<String, ReportError> {
    let names: Vec<_> = rows.iter().map(|(id, _)| id.to_string()).collect();
    let ratio = |mode: &ModeSummary, estimate: &Estimated| Dot {
        look: look(mode.mode),
        value: estimate.value,
        interval: estimate.interval.map(|interval| (interval.low, interval.high)),
        band: None,
    };
    let panel = |title: &str, zero: f64, dot: &dyn Fn(&ModeSummary, &ParameterSummary) -> Option<Dot>| {
        let rows = rows
            .iter()
            .map(|(_, cells)| cells.iter().filter_map(|(mode, p)| dot(mode, p)).collect())
            .collect();
        Panel { far: FAR, ..Panel::of(title, zero, rows) }
    };
    let covered = |mode: &ModeSummary, p: &ParameterSummary| {
        let (low, high) = p.coverage.interval(BAND);
        Some(Dot {
            look: look(mode.mode),
            value: 1e2 * p.coverage.fraction(),
            interval: Some((1e2 * low, 1e2 * high)),
            band: None,
        })
    };
    let panels: Vec<_> = [
        panel("RMSE over stated", 1.0, &|mode, p| Some(ratio(mode, &p.consistency))),
        panel("RMSE over bound", 1.0, &|mode, p| p.over_bound.as_ref().map(|over| ratio(mode, over))),
        panel("coverage, %", 95.0, &covered),
    ]
    .into_iter()
    .filter(|panel| panel.rows.iter().any(|row| !row.is_empty()))
    .collect();
    dots(
        "parameters",
        "Errors of the parameters over what is stated and possible, and coverage",
        &names,
        &panels,
    )
}

fn parameter_table(mode: &ModeSummary) -> Markup {
    let bayesian = mode.parameters.iter().any(|p| p.bayesian.is_some());
    html! {
        div.scroll { table.parameters {
            caption {
                (key(&look(mode.mode))) (mode.mode.title()) "; bound: "
                @if bayesian { "the Bayesian Cram\u{e9}r-Rao bound" } @else { "the Cram\u{e9}r-Rao bound of the measurements alone" }
            }
            thead { tr {
                th { "parameter" } th { "unit" } th { "bias" } th { "RMSE" } th { "stated" } th { "RMSE over" br; "stated" } th { "bound" } th { "RMSE over" br; "bound" } th { "truth inside the 95 %" br; "interval [99.9 %]" }
            } }
            tbody { @for p in mode.parameters.iter().take(MOST_PARAMETERS) { (parameter_row(p)) } }
        } }
    }
}

fn parameter_row(p: &ParameterSummary) -> Markup {
    let (unit, factor) = printed_unit(p.id.unit());
    let (low, high) = p.coverage.interval(BAND);
    let coverage = Estimated { value: p.coverage.fraction(), interval: Some(Interval { low, high }) };
    html! {
        tr {
            th scope="row" title=(parameter_words(p.id)) { (p.id) }
            td { (unit) }
            td { (estimate(&p.bias, factor)) }
            td { (estimate(&p.rmse, factor)) }
            td { (number(factor * p.stated, 5)) }
            td { (estimate(&p.consistency, 1.0)) }
            td { @match p.least() { Some(bound) => (number(factor * bound, 5)), None => (NONE) } }
            td { @match &p.over_bound { Some(over) => (estimate(over, 1.0)), None => (NONE) } }
            td { (share(&coverage)) }
        }
    }
}
