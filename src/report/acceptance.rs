//! What a virtual acceptance test found: for the terminal, as JSON, as a picture and as a page.

use std::fmt::Write;

use maud::{PreEscaped, html};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use serde_json::{Value, json};

use super::files::ReportError;
use super::markup::page;
use super::plots;
use super::plots::{Drawn, GRID, LOOKS, foot, ink, px, text_style, values_below};
use crate::pipeline::{AcceptanceOutcome, Finding, Ratios, Test};

/// Instruments whose largest errors are drawn; of more, these many first ones are.
const MOST_DRAWN: usize = 300;

fn name(outcome: &AcceptanceOutcome) -> &'static str {
    outcome.kind.preset_key().unwrap_or("own figures")
}

/// What is tested, in lines.
fn about(outcome: &AcceptanceOutcome) -> Vec<String> {
    let instrument = &outcome.kind.instrument;
    let um = |metres: f64| 1e6 * metres;
    let mut lines = vec![format!(
        "MPE transverse {:.1} um + {:.1} um/m, range {:.1} um + {:.1} um/m; of it random {:.3}, systematic {:.3} (standard deviations)",
        um(instrument.transverse.offset),
        um(instrument.transverse.per_metre),
        um(instrument.range.offset),
        um(instrument.range.per_metre),
        instrument.random_fraction,
        instrument.systematic_fraction
    )];
    if let Some(preset) = instrument.preset {
        lines.push(format!("after {}", preset.source()));
        lines.push(format!("no source gives {}", preset.left_out()));
    }
    lines
}

/// Which of the errors of a test is the largest share of what is permitted.
fn worst(findings: &[Finding], test: Test) -> Option<&Finding> {
    findings.iter().filter(|f| f.test == test).max_by(|a, b| a.ratio().total_cmp(&b.ratio()))
}

fn place(finding: &Finding) -> String {
    format!("{:.2} m, azimuth {:.0} deg", finding.range, finding.azimuth.to_degrees())
}

fn verdict(outcome: &AcceptanceOutcome) -> String {
    let figures = format!(
        "lengths {:.2}, two faces {:.2}, range intervals {:.2} of the MPE",
        outcome.lengths.median_of_max, outcome.two_faces.median_of_max, outcome.ranging.median_of_max
    );
    if outcome.instruments == 1 {
        let word = if outcome.passed == 1 { "passes" } else { "does not pass" };
        return format!("{word}: largest errors: {figures}");
    }
    format!(
        "{} of {} pass ({:.1} %); median of the largest errors: {figures}",
        outcome.passed,
        outcome.instruments,
        1e2 * outcome.pass_fraction()
    )
}

/// The table for the terminal.
pub fn acceptance_text(outcome: &AcceptanceOutcome) -> String {
    let mut text = String::new();
    let count = if outcome.instruments == 1 {
        "one instrument".to_owned()
    } else {
        format!("{} instruments", outcome.instruments)
    };
    // Writing to a String cannot fail.
    let _ = writeln!(
        text,
        "Virtual acceptance test (B89.4.19-style) of {count}: {}, seed {}",
        name(outcome),
        outcome.seed
    );
    for line in about(outcome) {
        let _ = writeln!(text, "  {line}");
    }
    if outcome.instruments == 1 {
        let _ = writeln!(
            text,
            "\n  {:<28}{:>6}{:>10}{:>10}{:>8}  largest at",
            "test", "number", "error um", "MPE um", "ratio"
        );
    } else {
        let _ = writeln!(text, "\n  {:<28}{:>6}{:>15}{:>10}", "test", "number", "median of max", "max");
    }
    for test in &outcome.tests {
        let title = test.test.title();
        match worst(&outcome.first, test.test) {
            Some(finding) if outcome.instruments == 1 => {
                let _ = writeln!(
                    text,
                    "  {title:<28}{:>6}{:>10.1}{:>10.1}{:>8.2}  {}",
                    test.findings,
                    1e6 * finding.error,
                    1e6 * finding.mpe,
                    finding.ratio(),
                    place(finding)
                );
            }
            _ => {
                let Ratios { median_of_max, max } = test.ratios;
                let _ = writeln!(text, "  {title:<28}{:>6}{median_of_max:>15.2}{max:>10.2}", test.findings);
            }
        }
    }
    let _ = writeln!(text, "\n{}", verdict(outcome));
    text
}

/// The document of schema `calibrig.acceptance/1`.
pub fn acceptance_json(outcome: &AcceptanceOutcome) -> Value {
    let instrument = &outcome.kind.instrument;
    let ratios = |ratios: &Ratios| json!({ "median_of_max": ratios.median_of_max, "max": ratios.max });
    let tests: Vec<_> = outcome
        .tests
        .iter()
        .map(|test| {
            json!({
                "test": test.test.key(),
                "title": test.test.title(),
                "findings": test.findings,
                "error_over_mpe": ratios(&test.ratios),
            })
        })
        .collect();
    let finding = |finding: &Finding| {
        json!({
            "test": finding.test.key(),
            "repeat": finding.repeat,
            "range_m": finding.range,
            "azimuth_rad": finding.azimuth,
            "error_m": finding.error,
            "mpe_m": finding.mpe,
        })
    };
    json!({
        "schema": "calibrig.acceptance/1",
        "software": { "version": env!("CARGO_PKG_VERSION") },
        "instrument": {
            "preset": outcome.kind.preset_key(),
            "transverse_m": instrument.transverse.offset,
            "transverse_m_per_m": instrument.transverse.per_metre,
            "range_m": instrument.range.offset,
            "range_m_per_m": instrument.range.per_metre,
            "random_fraction": instrument.random_fraction,
            "systematic_fraction": instrument.systematic_fraction,
        },
        "seed": outcome.seed,
        "instruments": outcome.instruments,
        "passed": outcome.passed,
        "pass_fraction": outcome.pass_fraction(),
        "length_error_over_mpe": ratios(&outcome.lengths),
        "two_face_over_mpe": ratios(&outcome.two_faces),
        "ranging_error_over_mpe": ratios(&outcome.ranging),
        "tests": tests,
        "first": outcome.first.iter().map(finding).collect::<Vec<_>>(),
    })
}

/// Every error over the permissible one, a row a test: of one instrument with its sign, of many the largest of each.
pub fn acceptance_svg(outcome: &AcceptanceOutcome) -> Result<String, ReportError> {
    const ROW: i32 = 24;
    const FOOT: i32 = 46;
    const NAMES: i32 = 190;
    let rows = i32::try_from(outcome.tests.len()).unwrap_or(i32::MAX);
    let one = outcome.instruments == 1;
    let points: Vec<(usize, f64)> = outcome
        .tests
        .iter()
        .enumerate()
        .flat_map(|(row, test)| {
            let signed = |f: &Finding| f.error / f.mpe;
            let values: Vec<f64> = if one {
                outcome.first.iter().filter(|f| f.test == test.test).map(signed).collect()
            } else {
                test.worst.iter().take(MOST_DRAWN).copied().collect()
            };
            values.into_iter().filter(|v| plots::drawable(*v)).map(move |value| (row, value))
        })
        .collect();
    let reach = 1.05 * points.iter().fold(1.0, |most: f64, (_, value)| most.max(value.abs()));
    let low = if one { -reach } else { 0.0 };
    plots::svg("acceptance", "Errors over what is permitted", (plots::WIDTH, rows * ROW + FOOT), |area| {
        let (names, plot) = area.split_horizontally(px(NAMES));
        let mut chart = ChartBuilder::on(&plot)
            .margin_right(px(10))
            .x_label_area_size(px(26))
            .margin_bottom(px(FOOT - 26))
            .build_cartesian_2d(low..reach, f64::from(rows) - 0.5..-0.5)?;
        values_below(&mut chart, plot.dim_in_pixel().0, 4..=12)?;
        let inside = chart.plotting_area();
        for (row, test) in outcome.tests.iter().enumerate() {
            let level = row as f64;
            inside.draw(&PathElement::new(vec![(low, level), (reach, level)], GRID.stroke_width(1)))?;
            let (_, height) = inside.map_coordinate(&(0.0, level));
            let style = text_style().pos(Pos::new(HPos::Right, VPos::Center));
            names.draw(&Text::new(test.test.title(), (px(NAMES - 10), height), style))?;
        }
        for limit in if one { vec![-1.0, 1.0] } else { vec![1.0] } {
            let ends = vec![(limit, -0.5), (limit, f64::from(rows) - 0.5)];
            inside.draw(&PathElement::new(ends, ink(4)))?;
        }
        for (row, value) in &points {
            let look = &LOOKS[usize::from(value.abs() <= 1.0)];
            inside.draw(&plots::marker(look, (*value, *row as f64), 5))?;
        }
        let label = if one {
            "error over the permissible error; the lines are the limits"
        } else {
            "largest error of each instrument over the permissible one; the line is the limit"
        };
        foot(&plot, label) as Drawn
    })
}

/// The page: the picture above the table.
pub fn acceptance_html(outcome: &AcceptanceOutcome) -> Result<String, ReportError> {
    let figure = acceptance_svg(outcome)?;
    let one = outcome.instruments == 1;
    let title = format!("Virtual acceptance test: {}", name(outcome));
    let drawn = outcome.tests.first().map_or(0, |test| test.worst.len()).min(MOST_DRAWN);
    let body = html! {
        main {
            h1 { (title) }
            p { strong { (verdict(outcome)) } }
            @for line in about(outcome) { p.note { (line) } }
            figure {
                div.scroll { (PreEscaped(&figure)) }
                figcaption {
                    @if one { "Every error of the instrument: round and orange where it is beyond the limit, blue within." }
                    @else { "The largest error in each test of " (drawn) " instruments: round and orange beyond the limit, blue within." }
                }
            }
            div.scroll { table {
                thead { tr {
                    th scope="col" { "test" }
                    th scope="col" { "number" }
                    th scope="col" { "median of the largest error / MPE" }
                    th scope="col" { "largest error / MPE" }
                } }
                tbody {
                    @for test in &outcome.tests {
                        tr {
                            th scope="row" { (test.test.title()) }
                            td { (test.findings) }
                            td { (format!("{:.2}", test.ratios.median_of_max)) }
                            td { (format!("{:.2}", test.ratios.max)) }
                        }
                    }
                }
            } }
            p.note {
                "In the style of ASME B89.4.19, whose text was not at hand: docs/formats.md says which places are our own choice."
            }
        }
    };
    Ok(page(&title, &body))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::{TestedKind, test_instruments};

    #[test]
    fn table_document_and_picture_show_every_test() {
        let kind = TestedKind::of_preset("at500").expect("a preset");
        for instruments in [1, 30] {
            let outcome = test_instruments(kind, 1, instruments, || {}).expect("all in reach");
            let (text, page) = (acceptance_text(&outcome), acceptance_html(&outcome).expect("a page"));
            for test in Test::ALL {
                assert!(text.contains(test.title()) && page.contains(test.title()), "{test:?}");
            }
            let json = acceptance_json(&outcome);
            assert_eq!(json["instruments"], instruments);
            assert_eq!(json["first"].as_array().map(Vec::len), Some(151));
            assert_eq!(json["length_error_over_mpe"]["max"], outcome.lengths.max);
            let marks = page.matches("<polygon").count() + page.matches("<circle").count();
            let expected = if instruments == 1 { 151 } else { 30 * Test::ALL.len() };
            assert_eq!(marks, expected, "one a point");
        }
    }

    #[test]
    fn numbers_out_of_all_proportion_stop_no_picture() {
        let mut kind = TestedKind::of_preset("at500").expect("a preset");
        kind.instrument.random_fraction = 1e3;
        let outcome = test_instruments(kind, 1, 3, || {}).expect("all in reach");
        assert_eq!(outcome.passed, 0);
        assert!(acceptance_html(&outcome).is_ok() && acceptance_text(&outcome).contains("0 of 3 pass"));
    }
}
