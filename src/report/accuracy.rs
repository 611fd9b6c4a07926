//! The tables of errors, row by row.

use maud::{Markup, html};

use super::acceptance_bounds::acceptance_table;
use super::markup::key;
use super::plots::look;
use super::terminal::{Ink, Style, aligned, millimetres, wrap};
use super::words::{counted, number, payload_words, pose_words, printable, set_title};
use crate::pipeline::{ModeOutcome, Outcome, SetKind, SetOutcome};
use calibrig_estimation::evaluation::AccuracyRow;
use calibrig_estimation::identification::Mode;

/// The published figures beside a row, m: max x, mean x, max y, mean y, max z, mean z.
pub(super) fn published(outcome: &Outcome, set: SetKind, mode: Mode) -> Option<&[f64; 6]> {
    outcome.published.iter().find(|(s, m, _)| (*s, *m) == (set, mode)).map(|(_, _, figures)| figures)
}

/// A row of a table of errors, for the terminal and the page.
pub(super) struct ErrorRow<'a> {
    pub mode: Mode,
    /// Whose errors.
    pub title: &'a str,
    pub row: AccuracyRow,
    /// Published figures below it, as [`published`] gives them.
    pub published: Option<&'a [f64; 6]>,
    /// What these are called.
    pub published_as: &'static str,
}

/// The set that a run is judged by: the held-out one where there is one.
pub(super) fn judged_set(outcome: &Outcome) -> Option<usize> {
    let measured =
        |kind| outcome.sets.iter().position(|s| s.kind == kind && !s.measurements.observations.is_empty());
    measured(SetKind::Verification).or_else(|| measured(SetKind::Identification))
}

pub(super) fn row(mode: &ModeOutcome, set: usize) -> Option<AccuracyRow> {
    mode.rows.get(set).copied().flatten()
}

pub(super) fn accuracy_section(outcome: &Outcome) -> Markup {
    html! {
        section #accuracy {
            h2 { "Accuracy" }
            p {
                "Absolute error of the target\u{2019}s position in the base frame (measured minus predicted), over all readings, in mm."
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

pub(super) fn accuracy_table(outcome: &Outcome, index: usize, kind: SetKind, poses: &str) -> Markup {
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
pub(super) fn orientation_table(outcome: &Outcome, index: usize, kind: SetKind) -> Markup {
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

/// Poses that were not measured and are named.
const NAMED: usize = 20;
const COLUMNS: [&str; 8] = ["max x", "mean x", "max y", "mean y", "max z", "mean z", "RMS 3D", "max 3D"];

pub(super) fn table(outcome: &Outcome, index: usize, set: &SetOutcome, style: Style) -> Vec<String> {
    let mut lines = vec![style.paint(
        Ink::Heading,
        &format!("{}, {}: absolute errors in mm", set_title(set.kind), pose_words(set)),
    )];
    let of_mode = |mode: &ModeOutcome| {
        Some(ErrorRow {
            mode: mode.mode,
            title: mode.mode.title(),
            row: mode.rows.get(index).copied().flatten()?,
            published: published(outcome, set.kind, mode.mode),
            published_as: "  published",
        })
    };
    lines.extend(error_lines(outcome.modes.iter().filter_map(of_mode), style));
    lines.extend(orientation_lines(outcome, index, style));
    if let Some(carried) = payload_words(set) {
        lines.extend(wrap(&printable(&format!("the flange carried {carried}")), "    "));
    }
    if let Some(repeats) = set.measurements.repeats() {
        let words = format!(
            "repeats of {} scatter by {} mm (RMS 3D of a reading about the mean of its pose, {} more): no model can leave less on these readings",
            counted(repeats.poses, "pose"),
            millimetres(repeats.rms_3d),
            counted(repeats.repeats, "reading")
        );
        lines.extend(wrap(&words, "    "));
    }
    if !set.dropped.is_empty() {
        let poses: Vec<_> = set
            .dropped
            .iter()
            .take(NAMED)
            .map(|(pose, why)| format!("{pose} ({})", printable(why)))
            .collect();
        let more = set.dropped.len().saturating_sub(NAMED);
        let more = if more > 0 { format!(", and {more} more: report.json") } else { String::new() };
        let words =
            format!("{} not measured: {}{more}", counted(set.dropped.len(), "pose"), poses.join(", "));
        lines.extend(style.told(Ink::Warning, &words, "    "));
    }
    lines
}

/// A table of errors in mm, between rules.
pub(super) fn error_lines<'a>(rows: impl Iterator<Item = ErrorRow<'a>>, style: Style) -> Vec<String> {
    let header = aligned("", &COLUMNS.map(str::to_owned));
    let rule = style.paint(Ink::Dim, &"\u{2500}".repeat(header.len()));
    let mut lines = vec![header, rule.clone()];
    for own in rows {
        lines.push(aligned(own.title, &row_values(&own.row).map(millimetres)));
        if let Some(figures) = own.published {
            let numbers = figures.map(as_published);
            lines.push(style.paint(Ink::Dim, aligned(own.published_as, &numbers).trim_end()));
        }
    }
    lines.push(rule);
    lines
}

/// Orientation errors of a set, where any were measured.
pub(super) fn orientation_lines(outcome: &Outcome, index: usize, style: Style) -> Vec<String> {
    let rows = outcome.modes.iter().filter_map(|mode| Some((mode.mode, mode.orientation_row(index)?)));
    let mut lines: Vec<String> =
        rows.map(|(mode, row)| aligned(mode.title(), &[row.rms, row.max].map(millimetres))).collect();
    if let Some(row) = outcome.modes.iter().find_map(|mode| mode.orientation_row(index)) {
        let title = format!("angle to the measured orientation of {}, mrad", counted(row.count, "reading"));
        lines.insert(0, style.paint(Ink::Dim, &aligned("", &["RMS", "max"].map(str::to_owned))));
        lines.insert(0, title);
    }
    lines
}

/// Maximum and mean by axis, then RMS and maximum of the 3-D error, m.
pub(super) fn row_values(row: &AccuracyRow) -> [f64; 8] {
    [row.max.x, row.mean.x, row.max.y, row.mean.y, row.max.z, row.mean.z, row.rms_3d, row.max_3d]
}

/// Millimetres without the digits that were not published, aligned on the point.
pub(super) fn as_published(metres: f64) -> String {
    let text = millimetres(metres);
    let Some(point) = text.find('.') else { return text };
    let kept = text.trim_end_matches('0').len().max(point + 2);
    format!("{:<width$}", &text[..kept], width = text.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn published_figures_align_on_the_point_without_invented_digits() {
        assert_eq!(millimetres(0.0147), "14.700");
        assert_eq!(as_published(0.0147), "14.7  ");
        assert_eq!(as_published(0.0020), "2.0  ");
        assert_eq!(as_published(0.000_123), "0.123");
    }
}
