//! What each part of the machine contributes, as a table on the terminal, and as a figure and a table on the page.

use maud::{Markup, html};

use super::files::ReportError;
use super::markup::figure;
use super::plots::look;
use super::rows::{Dot, Panel, dots};
use super::terminal::{Ink, NUMBER, Style, TITLE, aligned, millimetres, wrap};
use super::words::{number, printable, set_title};
use crate::pipeline::{AblatedPart, Ablation, SetKind};
use calibrig_estimation::identification::Mode;

const EXPLANATION: &str = "The run is repeated without one part of the machine at a time, with the same poses and random numbers. A change below zero is the error that the \
                           part causes. Such errors add up as squares, not as lengths.";

/// The judged set's place: the verification set where there is one.
fn judged(ablation: &Ablation) -> usize {
    ablation.sets.iter().position(|set| *set == SetKind::Verification).unwrap_or(0)
}

/// (title, why) of every run that failed.
fn failures(ablation: &Ablation) -> impl Iterator<Item = (&'static str, &str)> {
    ablation.parts.iter().filter_map(|part| Some((part.part.title(), part.rows.as_ref().err()?.as_str())))
}

/// The modes that are doubtful without a part, in words.
fn doubts(ablation: &Ablation) -> impl Iterator<Item = String> {
    ablation.parts.iter().filter(|part| !part.doubtful.is_empty()).map(|part| {
        let modes: Vec<_> = part.doubtful.iter().map(|mode| mode.title()).collect();
        format!(
            "without {}: look at the warnings of the estimate first: {}",
            part.part.title(),
            modes.join(", ")
        )
    })
}

/// What removing means, with the parts of which it is true.
fn removals(ablation: &Ablation) -> Vec<(String, &'static str)> {
    let mut removals: Vec<(String, &str)> = Vec::new();
    for part in ablation.parts.iter().map(|part| part.part) {
        match removals.last_mut() {
            Some((titles, removal)) if *removal == part.removal() => {
                titles.push_str(", ");
                titles.push_str(part.title());
            }
            _ => removals.push((part.title().to_owned(), part.removal())),
        }
    }
    removals
}

/// Mean per axis and RMS of the 3-D error without each part, and their changes, in mm: a table a mode, of the judged set. The other is in
/// the files.
pub(super) fn ablation_lines(ablation: &Ablation, style: Style) -> Vec<String> {
    const COLUMNS: [&str; 8] =
        ["mean x", "mean y", "mean z", "RMS 3D", "\u{394} x", "\u{394} y", "\u{394} z", "\u{394} RMS"];
    let mut lines =
        vec![String::new(), style.paint(Ink::Heading, "What each part of the machine contributes")];
    lines.extend(wrap(EXPLANATION, ""));
    let set = judged(ablation);
    let kind = ablation.sets.get(set).copied().unwrap_or(SetKind::Identification);
    for (mode, name) in ablation.modes.iter().enumerate() {
        let complete = ablation.complete.get(mode).and_then(|rows| rows.get(set).copied().flatten());
        let Some(complete) = complete else { continue };
        lines.push(String::new());
        let title = format!("{}, {}: absolute errors in mm", set_title(kind), name.title());
        lines.push(style.paint(Ink::Heading, &title));
        let header = COLUMNS.map(|column| format!("{column:>NUMBER$}")).concat();
        lines.push(format!("{:<TITLE$}{header}", "without"));
        let rule = style.paint(Ink::Dim, &"\u{2500}".repeat(TITLE + COLUMNS.len() * NUMBER));
        lines.push(rule.clone());
        let numbers = [complete.mean.x, complete.mean.y, complete.mean.z, complete.rms_3d].map(millimetres);
        lines.push(aligned("(nothing)", &numbers));
        for part in &ablation.parts {
            let Some((without, complete)) = ablation.pair(part, mode, set) else { continue };
            let change = without.mean - complete.mean;
            let numbers = [without.mean.x, without.mean.y, without.mean.z, without.rms_3d].map(millimetres);
            let changes = [change.x, change.y, change.z, without.rms_3d - complete.rms_3d].map(signed);
            lines.push(aligned(part.part.title(), &[numbers, changes].concat()));
        }
        lines.push(rule);
    }
    lines.push(String::new());
    for (titles, removal) in removals(ablation) {
        lines.extend(wrap(&format!("  without {titles}: {removal}"), "    "));
    }
    for words in doubts(ablation) {
        lines.extend(style.told(Ink::Warning, &format!("  doubtful {words}"), "    "));
    }
    for (title, why) in failures(ablation) {
        let words = format!("  no run without {title}: {}", printable(why));
        lines.extend(style.told(Ink::Warning, &words, "    "));
    }
    lines
}

/// Millimetres with their sign; what rounds to zero has none.
fn signed(metres: f64) -> String {
    if (99.9995e-3..1.0).contains(&metres.abs()) {
        // With its sign it would touch its neighbour.
        return format!("{:+.1}", 1e3 * metres);
    }
    let text = millimetres(metres);
    match text.trim_start_matches('-') {
        "0.000" => "0.000".to_owned(),
        _ if metres > 0.0 => format!("+{text}"),
        _ => text,
    }
}

/// The section of the page.
pub(super) fn ablation_section(ablation: &Ablation) -> Result<Markup, ReportError> {
    let set = judged(ablation);
    let plot = changes(ablation, set)?;
    let kind = ablation.sets.get(set).copied().unwrap_or(SetKind::Identification);
    Ok(html! {
        section #ablation {
            h2 { "What each part of the machine contributes" }
            p { (EXPLANATION) }
            (figure(&ablation.modes, &plot, &html! {
                "Change of the RMS of the 3-D error when a part is removed, " (set_title(kind)) ", mm, a panel a mode on its own scale. The further left, the more error the part causes. "
                "Doubtful runs are not drawn; they are named below."
            }, false))
            @for (set, kind) in ablation.sets.iter().enumerate() { (table(ablation, set, *kind)) }
            h3 { "What removing means" }
            ul {
                @for (titles, removal) in removals(ablation) { li { "without " (titles) ": " (removal) "." } }
            }
            @for words in doubts(ablation) { p.note { "Doubtful " (words) "." } }
            @for (title, why) in failures(ablation) { p.note { "No run without " (title) ": " (why) } }
        }
    })
}

fn table(ablation: &Ablation, set: usize, kind: SetKind) -> Markup {
    let mm = |metres: f64| number(1e3 * metres, 3);
    html! {
        div.scroll {
            table {
                caption { (set_title(kind)) ": mean absolute errors and RMS of the 3-D error, with its change, mm" }
                thead {
                    tr {
                        th rowspan="2" { "without" }
                        @for mode in &ablation.modes { th.group colspan="5" { (mode.title()) } }
                    }
                    tr {
                        @for _ in &ablation.modes {
                            th.first { "x" } th { "y" } th { "z" } th { "RMS" } th { "change" }
                        }
                    }
                }
                tbody {
                    tr {
                        th scope="row" { "(nothing)" }
                        @for rows in &ablation.complete {
                            @if let Some(row) = rows.get(set).copied().flatten() {
                                td.first { (mm(row.mean.x)) } td { (mm(row.mean.y)) } td { (mm(row.mean.z)) }
                                td { (mm(row.rms_3d)) } td {}
                            } @else { td.first colspan="5" {} }
                        }
                    }
                    @for part in &ablation.parts {
                        tr {
                            th scope="row" { (part.part.title()) }
                            @for mode in 0..ablation.modes.len() {
                                @if let Some((row, complete)) = ablation.pair(part, mode, set) {
                                    td.first { (mm(row.mean.x)) } td { (mm(row.mean.y)) } td { (mm(row.mean.z)) }
                                    td { (mm(row.rms_3d)) } td { (mm(row.rms_3d - complete.rms_3d)) }
                                } @else { td.first colspan="5" { "\u{2013}" } }
                            }
                        }
                    }
                }
            }
        }
    }
}

/// A panel a mode, each on its own scale: a bar a part from zero to the change of the RMS, with the mode's marker at its end. What is doubtful
/// is left out.
fn changes(ablation: &Ablation, set: usize) -> Result<String, ReportError> {
    let names: Vec<_> = ablation.parts.iter().map(|part| part.part.title().to_owned()).collect();
    let panel = |(place, mode): (usize, &Mode)| {
        let change = |part: &AblatedPart| {
            let pair = ablation.pair(part, place, set).filter(|_| !part.doubtful.contains(mode));
            pair.map(|(without, complete)| Dot::at(look(*mode), 1e3 * (without.rms_3d - complete.rms_3d)))
        };
        let rows = ablation.parts.iter().map(|part| change(part).into_iter().collect()).collect();
        Panel { bars: true, ..Panel::of(mode.title(), 0.0, rows) }
    };
    let panels: Vec<_> = ablation.modes.iter().enumerate().map(panel).collect();
    dots("contributions", "Change of the RMS error without each part", &names, &panels)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::tests::sample;
    use crate::report::{html_report, json_report, render_tables};

    #[test]
    fn every_part_is_told_with_its_change_in_every_mode() {
        let outcome = sample::ablated();
        let ablation = outcome.ablation.as_ref().expect("an ablation");
        let text = render_tables(&outcome, Style::Plain);
        assert!(text.lines().all(|line| line.chars().count() <= 100), "{text}");
        // Half of every error is gone without the rail's: -50 % of the RMS.
        let rms = outcome.modes[1].rows[1].expect("a verification row").rms_3d;
        let lines: Vec<_> = text.lines().filter(|line| line.starts_with("rail straightness ")).collect();
        assert_eq!(lines.len(), ablation.modes.len());
        let last: f64 = lines[1].split_whitespace().last().expect("a number").parse().expect("a number");
        assert!((last + 0.5e3 * rms).abs() <= 0.5e-3 + 1e-12, "{last} against {rms}");
        assert!(text.contains("no run without backlash: not at rest\u{fffd}"), "{text}");
        assert!(text.contains("bearings rigid in the machine"));
        assert!(text.contains("doubtful without bearing compliance"), "{text}");
    }

    #[test]
    fn the_page_shows_a_bar_a_part_and_mode_and_the_numbers_of_both_sets() {
        let page = html_report(&sample::ablated()).expect("a page");
        let section = page.split("<section id=\"ablation\">").nth(1).expect("the section");
        let section = section.split("</section>").next().expect("its end");
        for part in ["rail straightness", "bearing compliance", "without backlash: not at rest"] {
            assert!(section.contains(part), "{part}");
        }
        // Markers tell the modes apart without colour: two triangles in the figure, one in its key, for the mode with triangles.
        let colour = crate::report::plots::hex(crate::report::plots::LOOKS[1].light);
        let triangles = section.matches("<polygon").count();
        assert!(triangles >= 3 && section.contains(&colour), "{triangles}");
        assert_eq!(section.matches("<table>").count(), 2);
        assert!(!html_report(&sample::simulated()).expect("a page").contains("ablation"));
    }

    #[test]
    fn json_holds_rows_and_changes_in_metres_and_the_failures() {
        let outcome = sample::ablated();
        let json = json_report(&outcome).ablation.expect("an ablation");
        let keys: Vec<_> = json.parts.iter().map(|part| part.key.as_str()).collect();
        assert_eq!(keys, ["bearing_compliance", "rail", "backlash"]);
        let row = &json.parts[1].rows["identification"]["with_gravity"];
        let complete = outcome.modes[2].rows[0].expect("a row");
        assert_eq!(
            row.mean_m,
            [0.5 * complete.mean.x, 0.5 * complete.mean.y, 0.5 * complete.mean.z].map(Some)
        );
        assert_eq!(row.rms_3d_change_m, Some(0.5 * complete.rms_3d - complete.rms_3d));
        assert_eq!(json.parts[0].doubtful, ["with_gravity"]);
        assert!(json.parts[2].failure.is_some() && json.parts[2].rows["verification"].is_empty());
        let text = serde_json::to_string(&json_report(&sample::simulated())).expect("JSON");
        assert!(!text.contains("ablation"));
    }

    #[test]
    fn changes_keep_their_sign_and_their_distance() {
        assert_eq!(signed(-0.4e-6), "0.000");
        assert_eq!([signed(1.5e-3), signed(-1.5e-3)], ["+1.500", "-1.500"]);
        for metres in [-99.9994e-3, 99.9996e-3, -0.16, 0.9, -12.3, 4.5e5, -1e300, f64::NAN] {
            assert!(signed(metres).len() < NUMBER, "{}", signed(metres));
        }
    }

    #[test]
    fn no_row_stops_the_figure() {
        for bad in [0.0, -1e300, f64::NAN, f64::INFINITY] {
            let mut outcome = sample::ablated();
            let ablation = outcome.ablation.as_mut().expect("an ablation");
            for row in ablation.complete.iter_mut().flatten().flatten() {
                row.rms_3d = bad;
            }
            assert!(changes(ablation, 1).expect("a figure").ends_with("</svg>\n"), "{bad}");
            ablation.parts.clear();
            assert!(changes(ablation, 1).expect("a figure").ends_with("</svg>\n"), "{bad}");
        }
    }
}
