//! Parameters on the page and on the terminal: figures, tables, and the corrected D-H table.

use maud::{Markup, html};

use super::files::ReportError;
use super::forest;
use super::markup::{figure, key};
use super::parameters::{ParameterCell, ParameterRow, fitted, parameter_rows};
use super::plots::look;
use super::terminal::{Ink, Style};
use super::words::{number, parameter_words, printable, printed_unit};
use crate::pipeline::Outcome;
use calibrig_estimation::identification::Mode;
use calibrig_model::statistics::NORMAL_95;
use calibrig_model::{CraigLink, ParameterId, Unit};

/// What parameters are of: each kind has a heading of its own.
const KINDS: [&str; 3] =
    ["Geometry: links, base and target", "Compliances and masses", "Terms beside geometry and elasticity"];

fn kind_of(id: ParameterId) -> &'static str {
    match id {
        ParameterId::Compliance(_) | ParameterId::Mass { .. } | ParameterId::Centre { .. } => KINDS[1],
        ParameterId::Term(_) | ParameterId::Instrument { .. } | ParameterId::Drift { .. } => KINDS[2],
        _ => KINDS[0],
    }
}

/// Parameters of one kind and unit, in the order of `rows`.
fn grouped(rows: &[ParameterRow]) -> Vec<(&'static str, Unit, Vec<&ParameterRow>)> {
    let of = |kind: &'static str, unit: Unit| {
        let own: Vec<_> =
            rows.iter().filter(|row| kind_of(row.id) == kind && row.id.unit() == unit).collect();
        (!own.is_empty()).then_some((kind, unit, own))
    };
    let units = [Unit::Metre, Unit::Radian, Unit::One];
    KINDS.into_iter().flat_map(|kind| units.map(|unit| of(kind, unit))).flatten().collect()
}

pub(super) fn parameters_section(outcome: &Outcome) -> Result<Markup, ReportError> {
    let rows = parameter_rows(outcome);
    let modes: Vec<_> = fitted(outcome).iter().map(|(mode, _)| *mode).collect();
    let truth_known = rows.iter().any(|row| row.truth().is_some());
    let mut parts: Vec<(&str, bool, Unit, String, Vec<&ParameterRow>)> = Vec::new();
    for (kind, unit, selected) in grouped(&rows) {
        if let Some(plot) = forest::parameters(&selected, &modes, unit)? {
            let heading = parts.last().is_none_or(|(known, ..)| *known != kind);
            parts.push((kind, heading, unit, plot, selected));
        }
    }
    Ok(html! {
        section #parameters {
            h2 { "Parameters" }
            @if parts.is_empty() {
                p { "No parameter was identified." }
            } @else {
                p {
                    "Link parameters are deviations from the nominal robot. Frame parameters displace the base in the tracker\u{2019}s frame from where its registration puts it. "
                    "Target parameters are deviations from the stated offset. Compliances and masses are deviations from their nominal values, as a part of them."
                }
                (dh_table(outcome))
            }
            @for (kind, heading, unit, plot, selected) in &parts {
                @if *heading { h3 { (kind) } }
                (figure(&modes, plot, &html! {
                    (unit_title(*unit)) " in " (printed_unit(*unit).0) "."
                    @if selected.iter().any(|row| row.cells.iter().flatten().any(|c| c.sigma.is_some())) {
                        " Horizontal bars are the 95 % intervals of single parameters, from the covariance of the fit."
                    } @else {
                        " The system is singular: it has no standard deviations."
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

fn unit_title(unit: Unit) -> &'static str {
    match unit {
        Unit::Metre => "Lengths",
        Unit::Radian => "Angles",
        Unit::One => "Fractions",
    }
}

/// A number of the D-H table: its letter, its unit, and what an SI value is multiplied with.
type DhColumn = (&'static str, &'static str, f64, fn(&CraigLink) -> f64);

const DH_COLUMNS: [DhColumn; 5] = [
    ("a", "mm", 1e3, |link| link.a),
    ("\u{3b1}", "deg", DEGREES, |link| link.alpha),
    ("d", "mm", 1e3, |link| link.d),
    ("\u{3b8}", "deg", DEGREES, |link| link.theta),
    ("\u{3b2}", "deg", DEGREES, |link| link.beta),
];

const DEGREES: f64 = 180.0 / std::f64::consts::PI;

/// The links of the nominal robot and of the last mode that was fitted, and that mode.
fn corrected_links(outcome: &Outcome) -> Option<(Mode, Vec<(&CraigLink, &CraigLink)>)> {
    let last = outcome.modes.iter().rev().find(|mode| mode.estimate.is_some())?;
    let corrected = &last.robot.model.kinematics.links;
    let pairs = outcome.model.kinematics.links.iter().zip(corrected).collect();
    Some((last.mode, pairs))
}

/// The D-H table as the last mode corrects it: nominal, corrected and their difference.
fn dh_table(outcome: &Outcome) -> Markup {
    let Some((mode, links)) = corrected_links(outcome) else { return html! {} };
    html! {
        h3 { "Corrected D-H table" }
        div.scroll { table.parameters {
            caption { (key(&look(mode))) (mode.title()) ": nominal, corrected, difference" }
            thead {
                tr { th rowspan="2" { "joint" } @for (letter, unit, ..) in DH_COLUMNS { th.group colspan="3" { (letter) ", " (unit) } } }
                tr { @for _ in DH_COLUMNS { th.first { "nominal" } th { "corrected" } th { "difference" } } }
            }
            tbody { @for (nominal, corrected) in &links {
                tr {
                    th scope="row" { (nominal.name) }
                    @for (_, unit, factor, of) in DH_COLUMNS {
                        @let decimals = if unit == "mm" { 3 } else { 4 };
                        @let (before, after) = (factor * of(nominal), factor * of(corrected));
                        td.first { (number(before, decimals)) } td { (number(after, decimals)) } td { (number(after - before, decimals)) }
                    }
                }
            } }
        } }
        p.note {
            "Craig\u{2019}s (modified) D-H parameters, with Hayati\u{2019}s \u{3b2} about y, without the joint variables. A controller that takes this table still lacks compliances and terms. "
            code { "calibrig export calibrated" } " writes the robot with them."
        }
    }
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

/// The parameters of all modes, and the corrected D-H table, for the terminal.
pub(super) fn parameter_lines(outcome: &Outcome, style: Style) -> Vec<String> {
    const NAME: usize = 30;
    const CELL: usize = 12;
    /// Modes that have room beside each other.
    const MODES: usize = 2;
    let rows = parameter_rows(outcome);
    let modes: Vec<_> = fitted(outcome).iter().map(|(mode, _)| *mode).collect();
    let mut lines = Vec::new();
    let cell = |value: Option<f64>| {
        format!("{:>CELL$}", value.map_or_else(|| "-".to_owned(), |v| format!("{v:.4}")))
    };
    for (place, own) in modes.chunks(MODES).enumerate() {
        let slots = place * MODES..place * MODES + own.len();
        let titles: Vec<_> = own.iter().map(|mode| mode.title()).collect();
        lines.push(style.paint(Ink::Heading, &format!("Parameters: {}", titles.join(" | "))));
        let columns = slots.clone().map(|_| format!("{:>CELL$}{:>CELL$}", "estimate", "sigma"));
        lines.push(format!("{:<NAME$}{:>CELL$}{}", "", "truth", columns.collect::<String>()));
        for (kind, unit, selected) in grouped(&rows) {
            let (unit, factor) = printed_unit(unit);
            let selected: Vec<_> = selected
                .into_iter()
                .filter(|row| slots.clone().any(|slot| row.cell(slot).is_some()))
                .collect();
            if !selected.is_empty() {
                lines.push(style.paint(Ink::Dim, &format!("  {kind}, {unit}")));
            }
            for row in selected {
                let figures = slots.clone().flat_map(|slot| {
                    let own = row.cell(slot);
                    [own.map(|own| factor * own.value), own.and_then(|own| Some(factor * own.sigma?))]
                        .map(cell)
                });
                let truth = cell(row.truth().map(|truth| factor * truth));
                lines.push(format!("{:<NAME$}{truth}{}", row.id.to_string(), figures.collect::<String>()));
            }
        }
    }
    lines.extend(dh_lines(outcome, style));
    lines
}

/// The D-H table: for every joint the nominal, the corrected row and their difference.
fn dh_lines(outcome: &Outcome, style: Style) -> Vec<String> {
    let Some((mode, links)) = corrected_links(outcome) else { return Vec::new() };
    let mut lines = vec![style.paint(Ink::Heading, &format!("Corrected D-H table: {}", mode.title()))];
    let row = |name: &str, what: &str, cells: [String; 5]| {
        let cells = cells.map(|cell| format!("{cell:>14}")).concat();
        format!("{:<18.18}{what:<12}{cells}", printable(name))
    };
    lines.push(row("joint", "", DH_COLUMNS.map(|(letter, unit, ..)| format!("{letter}, {unit}"))));
    for (nominal, corrected) in links {
        let cells = |value: &dyn Fn(&DhColumn) -> f64| {
            DH_COLUMNS.each_ref().map(|column| {
                let text = format!("{:.*}", if column.1 == "mm" { 3 } else { 4 }, value(column));
                if text.trim_start_matches('-').chars().all(|c| "0.".contains(c)) {
                    text.replace('-', "")
                } else {
                    text
                }
            })
        };
        let of = |link: &CraigLink, (_, _, factor, of): &DhColumn| factor * of(link);
        lines.push(row(&nominal.name, "nominal", cells(&|column| of(nominal, column))));
        lines.push(row("", "corrected", cells(&|column| of(corrected, column))));
        lines.push(row("", "difference", cells(&|column| of(corrected, column) - of(nominal, column))));
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::tests::sample;

    #[test]
    fn every_parameter_is_in_the_tables_of_page_and_terminal() {
        let outcome = sample::simulated();
        let page = parameters_section(&outcome).expect("a section").into_string();
        let lines = parameter_lines(&outcome, Style::Plain);
        for row in parameter_rows(&outcome) {
            assert!(page.contains(&format!("<code>{}</code>", row.id)), "{}", row.id);
            assert!(
                lines.iter().any(|line| line.split_whitespace().next() == Some(&row.id.to_string())),
                "{}",
                row.id
            );
        }
        assert!(lines.iter().all(|line| line.chars().count() <= 100));
    }

    #[test]
    fn the_corrected_table_is_the_nominal_one_and_the_difference() {
        let outcome = sample::simulated();
        let lines = dh_lines(&outcome, Style::Plain);
        let (_, links) = corrected_links(&outcome).expect("a fitted mode");
        assert_eq!(lines.len(), 2 + 3 * links.len());
        let numbers = |line: &str| -> Vec<f64> {
            line[30..].split_whitespace().map(|n| n.parse().expect("a number")).collect()
        };
        for rows in lines[2..].chunks(3) {
            let [nominal, corrected, difference] = [0, 1, 2].map(|row| numbers(&rows[row]));
            for column in 0..5 {
                let sum = nominal[column] + difference[column];
                assert!((sum - corrected[column]).abs() < 1.6e-3, "{rows:?}");
            }
        }
        assert!(dh_lines(&sample::measured(), Style::Plain).len() > 2);
    }
}
