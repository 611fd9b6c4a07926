//! What the levels of one or two factors do to the accuracy.

use std::collections::BTreeSet;

use maud::{Markup, html};

use super::sweep_figure::curves;
use super::words::{
    NONE, count, drawn, estimate, level, levels, mean, millimetres, name, rate, set_words, unit,
};
use crate::montecarlo::{CampaignSummary, GroupSummary, SetSummary, decimals};
use crate::report::markup::key;
use crate::report::plots::look;
use crate::report::words::number;
use calibrig_estimation::identification::Mode;

/// Rows of a table; what is beyond is in the files.
pub(super) const MOST_ROWS: usize = 150;
/// Tables longer than this are folded.
const LONG: usize = 12;
/// Rows and columns of a table of two factors.
const MOST_LEVELS: usize = 30;

/// The accuracy of a mode in a combination.
pub(super) fn set_of(group: &GroupSummary, place: usize) -> Option<&SetSummary> {
    group.modes.get(place)?.told()
}

/// The modes, in the order of every group.
pub(super) fn modes(summary: &CampaignSummary) -> Vec<Mode> {
    summary.modes().iter().map(|mode| mode.mode).collect()
}

/// Different texts in the order in which they come.
pub(super) fn distinct<'a>(texts: impl Iterator<Item = &'a String>) -> Vec<&'a str> {
    let mut seen = BTreeSet::new();
    texts.map(String::as_str).filter(|text| seen.insert(*text)).collect()
}

/// The section of a sweep.
pub(super) fn section(summary: &CampaignSummary) -> Markup {
    let modes = modes(summary);
    let told =
        summary.groups.iter().flat_map(|group| group.modes.iter().filter_map(|mode| mode.told())).next();
    let Some(told) = told else {
        return html! { section #sweep { h2 { "Sweep" } p { "No trial has an accuracy." } (combinations(summary, &modes)) } };
    };
    html! {
        section #sweep {
            h2 { "Sweep" }
            figure {
                div.legend { @for mode in &modes { span { (key(&look(*mode))) (mode.title()) } } }
                (drawn(curves(summary)))
                figcaption {
                    "Mean over the trials of the RMS of the 3-D error, mm, " (set_words(told.kind)) ": a line a mode. Narrow strong bands are the 95 % intervals of the means, "
                    "wide faint ones reach from the 5 % to the 95 % quantile of single trials."
                    @if let Some(tolerance) = summary.tolerance { " Dashed, where it is in reach: the tolerance, " (millimetres(tolerance)) "." }
                }
            }
            @if summary.study.factors.len() == 2 { div.columns { @for place in 0..modes.len() { (matrix(summary, place, modes[place])) } } }
            (combinations(summary, &modes))
        }
    }
}

/// The means of a mode over two factors, darker where they are larger.
fn matrix(summary: &CampaignSummary, place: usize, mode: Mode) -> Markup {
    let [first, second] = &summary.study.factors[..] else { return html! {} };
    let rows = distinct(summary.groups.iter().filter_map(|group| group.levels.first()));
    let columns = distinct(summary.groups.iter().filter_map(|group| group.levels.get(1)));
    let (rows, columns) = (&rows[..rows.len().min(MOST_LEVELS)], &columns[..columns.len().min(MOST_LEVELS)]);
    let cell = |row: &str, column: &str| {
        let group = summary.groups.iter().find(|group| group.levels == [row, column])?;
        Some(set_of(group, place)?.rms_3d.mean)
    };
    let all: Vec<f64> =
        summary.groups.iter().filter_map(|group| Some(set_of(group, place)?.rms_3d.mean)).collect();
    let (low, high) = all.iter().fold((f64::INFINITY, 0.0_f64), |(l, h), v| (l.min(*v), h.max(*v)));
    let (unit, factor) = unit(high);
    html! {
        div.scroll { table.heat {
            caption { (key(&look(mode))) (mode.title()) ": mean RMS, " (unit) }
            thead {
                tr { th rowspan="2" { (name(&first.name)) } th.group colspan=(columns.len()) { (name(&second.name)) } }
                tr { @for column in columns { th { (level(column)) } } }
            }
            tbody { @for row in rows { tr {
                th scope="row" { (level(row)) }
                @for column in columns {
                    @match cell(row, column) {
                        Some(value) => td style=(shade(mode, value, (low, high))) { (number(factor * value, digits(factor * low))) },
                        None => td { (NONE) },
                    }
                }
            } } }
        } }
    }
}

/// So many decimals that the least value has three digits, all in a table alike.
fn digits(least: f64) -> usize {
    decimals(0.1 * least).min(5)
}

fn shade(mode: Mode, value: f64, (low, high): (f64, f64)) -> String {
    let share = if low > 0.0 && high > low { (value / low).ln() / (high / low).ln() } else { 0.0 };
    let plotters::style::RGBColor(r, g, b) = look(mode).light;
    format!("background:rgb({r} {g} {b} / {:.2})", 0.06 + 0.44 * share.clamp(0.0, 1.0))
}

/// Every combination, mode by mode.
fn combinations(summary: &CampaignSummary, modes: &[Mode]) -> Markup {
    let tables = html! { @for (place, mode) in modes.iter().enumerate() { (combination_table(summary, place, *mode)) } };
    let left = summary.groups.len().saturating_sub(MOST_ROWS);
    html! {
        @if summary.groups.len() > LONG || summary.study.factors.len() > 1 { details { summary { "All combinations" } (tables) } } @else { (tables) }
        @if left > 0 { p.note { "and " (count(left as u64)) " other combinations: " code { "summary.json" } } }
        p.note {
            "All combinations have the same draws: \u{201c}more than the first\u{201d} is the mean of the differences of single trials with the same draw, with its 95 % interval. "
            "The intervals of means are of 95 % (Student's t), those of shares exact ones of 95 %; shares are of all trials, so that one that failed is no success."
        }
    }
}

fn combination_table(summary: &CampaignSummary, place: usize, mode: Mode) -> Markup {
    let names = summary.study.factors.iter().map(|factor| name(&factor.name));
    let means = summary.groups.iter().filter_map(|group| Some(set_of(group, place)?.rms_3d.mean));
    let (unit, factor) = unit(means.fold(0.0, f64::max));
    html! {
        div.scroll { table {
            caption { (key(&look(mode))) (mode.title()) ": RMS 3-D error, " (unit) }
            thead { tr {
                @for text in names { th { (text) } }
                th.first { "trials" } th { "failed" } th { "mean" } th { "5 % to 95 %" br; "of single trials" } th { "more than" br; "the first" }
                @if let Some(tolerance) = summary.tolerance { th.first { "RMS within" br; (millimetres(tolerance)) } th { "every pose" br; "within it" } }
            } }
            tbody { @for group in summary.groups.iter().take(MOST_ROWS) {
                tr {
                    @for text in &group.levels { th scope="row" { (level(text)) } }
                    td.first { (count(group.trials)) }
                    td.far[group.failed > 0] { (count(group.failed)) }
                    (figures(set_of(group, place), factor, summary.tolerance.is_some()))
                }
            } }
        } }
    }
}

fn figures(set: Option<&SetSummary>, factor: f64, with_rates: bool) -> Markup {
    let Some(set) = set else {
        return html! { td { (NONE) } td { (NONE) } td { (NONE) } @if with_rates { td.first { (NONE) } td { (NONE) } } };
    };
    let [low, _, high] = set.rms_3d.quantiles;
    let places = digits(factor * low);
    html! {
        td { (mean(&set.rms_3d, factor)) }
        td { (number(factor * low, places)) " to " (number(factor * high, places)) }
        td { @match &set.against_first { Some(difference) => (estimate(difference, factor)), None => (NONE) } }
        @if with_rates {
            @for share in [&set.rms_within, &set.max_within] { td { @match share { Some(share) => (rate(share)), None => (NONE) } } }
        }
    }
}

/// The levels of a group in words, where it has some.
pub(super) fn group_words(group: &GroupSummary) -> String {
    if group.levels.is_empty() { "all trials".to_owned() } else { levels(group) }
}
