//! Repeated random splits, as a table on the terminal and on the page, and in JSON.

use std::fmt::Write;

use maud::{Markup, html};
use serde::{Deserialize, Serialize};

use super::document::finite;
use super::terminal::{Ink, Style, TITLE, millimetres, wrap};
use super::words::{counted, number};
use crate::pipeline::{SplitMode, SplitStudy};
use calibrig_estimation::evaluation::Interval;

const EXPLANATION: &str = "The poses are divided at random again and again; each time some are fitted and the others held out. The table has the RMS of the 3-D error \
                           of the held-out poses in mm: its mean, least and largest over the splits. Gain: how much smaller the mean is than in the row above, with \
                           the 95 % interval of the mean gain after Nadeau and Bengio, which allows for splits that share poses.";

/// Repeated random splits of the identification set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonSplits {
    /// Their number.
    pub splits: usize,
    /// Poses fitted in each.
    pub fitted: usize,
    /// Poses held out in each.
    pub held_out: usize,
    /// Seed of the draws.
    pub seed: u64,
    /// One entry a mode, in the order of the tables.
    pub rows: Vec<JsonSplitRow>,
}

/// One mode on all splits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonSplitRow {
    /// Key of the mode.
    pub mode: String,
    /// RMS of the 3-D error of the held-out poses, m: the mean over the splits.
    pub mean_rms_3d_m: Option<f64>,
    /// The same, one a split.
    pub rms_3d_m: Vec<Option<f64>>,
    /// Splits whose estimate has no rank, did not converge or ended at a bound.
    pub doubtful: usize,
    /// By how much it is smaller than in the entry before, m; null for the first.
    pub gain_m: Option<JsonInterval>,
}

/// A number with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct JsonInterval {
    /// The number.
    pub value: Option<f64>,
    /// Lower end.
    pub low: Option<f64>,
    /// Upper end.
    pub high: Option<f64>,
}

pub(super) fn json_splits(study: &SplitStudy) -> JsonSplits {
    let interval = |gain: Interval| JsonInterval {
        value: finite(gain.value),
        low: finite(gain.low),
        high: finite(gain.high),
    };
    let row = |mode: &SplitMode| JsonSplitRow {
        mode: mode.mode.key().to_owned(),
        mean_rms_3d_m: finite(mode.mean_rms()),
        rms_3d_m: mode.rms.iter().map(|rms| finite(*rms)).collect(),
        doubtful: mode.doubtful,
        gain_m: mode.gain.map(interval),
    };
    JsonSplits {
        splits: study.plan.splits,
        fitted: study.plan.fitted,
        held_out: study.held_out,
        seed: study.plan.seed,
        rows: study.modes.iter().map(row).collect(),
    }
}

fn title(study: &SplitStudy) -> String {
    format!(
        "{}: {} fitted, {} held out",
        counted(study.plan.splits, "random split"),
        counted(study.plan.fitted, "pose"),
        study.held_out
    )
}

/// Whether a gain is more than chance.
fn words(gain: Interval) -> &'static str {
    if !gain.excludes_zero() {
        "may be chance"
    } else if gain.value > 0.0 {
        "better"
    } else {
        "worse"
    }
}

pub(super) fn split_lines(study: &SplitStudy, style: Style) -> Vec<String> {
    const CELL: usize = 10;
    const COLUMNS: [&str; 6] = ["mean", "least", "largest", "gain", "from", "to"];
    let mut lines = vec![String::new(), style.paint(Ink::Heading, &title(study))];
    lines.extend(wrap(EXPLANATION, ""));
    let header = COLUMNS.map(|column| format!("{column:>CELL$}")).concat();
    lines.push(format!("{:TITLE$}{header}", ""));
    let rule = "\u{2500}".repeat(TITLE + COLUMNS.len() * CELL);
    lines.push(style.paint(Ink::Dim, &rule));
    for mode in &study.modes {
        let (least, largest) = mode.range();
        let mut line = format!("{:<TITLE$}", mode.mode.title());
        let gain = mode.gain.map(|gain| [gain.value, gain.low, gain.high]);
        for metres in [mode.mean_rms(), least, largest].into_iter().chain(gain.into_iter().flatten()) {
            let _ = write!(line, "{:>CELL$}", fine(metres));
        }
        lines.push(line);
    }
    lines.push(style.paint(Ink::Dim, &rule));
    lines.extend(remarks(study).iter().flat_map(|remark| wrap(&format!("  {remark}"), "    ")));
    lines
}

/// Millimetres to a tenth of a micrometre: means are surer than single numbers.
fn fine(metres: f64) -> String {
    if metres.abs() < 0.1 { format!("{:.4}", 1e3 * metres) } else { millimetres(metres) }
}

fn remarks(study: &SplitStudy) -> Vec<String> {
    let gains = study.modes.iter().filter_map(|mode| Some((mode, mode.gain?)));
    let mut remarks: Vec<_> =
        gains.map(|(mode, gain)| format!("{}: {}", mode.mode.title(), words(gain))).collect();
    let doubtful = study.modes.iter().filter(|mode| mode.doubtful > 0);
    remarks.extend(doubtful.map(|mode| {
        format!("{}: doubtful in {} of {} splits", mode.mode.title(), mode.doubtful, study.plan.splits)
    }));
    remarks
}

/// The section of the page.
pub(super) fn split_section(study: &SplitStudy) -> Markup {
    let mm = |metres: f64| number(1e3 * metres, 4);
    html! {
        section #splits {
            h2 { "Repeated splits" }
            p { (EXPLANATION) }
            div.scroll {
                table {
                    caption { (title(study)) ", seed " (study.plan.seed) }
                    thead { tr { th {} th { "mean" } th { "least" } th { "largest" } th { "gain" } th { "from" } th { "to" } } }
                    tbody {
                        @for mode in &study.modes {
                            @let (least, largest) = mode.range();
                            tr {
                                th scope="row" { (mode.mode.title()) }
                                td { (mm(mode.mean_rms())) } td { (mm(least)) } td { (mm(largest)) }
                                @if let Some(gain) = mode.gain {
                                    td { (mm(gain.value)) } td { (mm(gain.low)) } td { (mm(gain.high)) }
                                } @else { td colspan="3" {} }
                            }
                        }
                    }
                }
            }
            @for remark in remarks(study) { p.note { (remark) "." } }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::SplitPlan;
    use crate::report::tests::sample;
    use crate::report::{html_report, json_text, render_tables};
    use calibrig_estimation::identification::Mode;

    #[test]
    fn splits_are_in_every_form_of_the_report() {
        let mut outcome = sample::measured();
        let mode = |mode, rms: [f64; 2], doubtful, gain| SplitMode {
            mode,
            rms: rms.to_vec(),
            doubtful,
            reasons: std::collections::BTreeMap::new(),
            gain,
        };
        let gain = Interval { value: 3e-4, low: -1e-5, high: 6.1e-4 };
        outcome.splits = Some(SplitStudy {
            plan: SplitPlan { splits: 2, fitted: 20, seed: 7 },
            held_out: 40,
            modes: vec![
                mode(Mode::WithoutCalibration, [5e-4, 7e-4], 0, None),
                mode(Mode::OnlyCalibration, [2e-4, 4e-4], 1, Some(gain)),
            ],
        });
        let text = render_tables(&outcome, Style::Plain);
        assert!(text.contains("2 random splits: 20 poses fitted, 40 held out"));
        let row = "0.3000    0.2000    0.4000    0.3000   -0.0100    0.6100";
        assert!(text.contains(row), "{text}");
        assert!(text.contains("only calibration: may be chance") && text.contains("doubtful in 1 of 2"));
        assert!(text.lines().all(|line| line.chars().count() <= 100));
        let json: crate::report::JsonReport =
            serde_json::from_str(&json_text(&outcome).expect("JSON")).expect("the schema");
        let splits = json.splits.expect("as asked for");
        assert_eq!((splits.splits, splits.fitted, splits.held_out, splits.seed), (2, 20, 40, 7));
        assert_eq!(splits.rows[1].rms_3d_m, [Some(2e-4), Some(4e-4)]);
        assert_eq!(splits.rows[1].gain_m.and_then(|gain| gain.low), Some(-1e-5));
        assert!(splits.rows[0].gain_m.is_none());
        assert!(html_report(&outcome).expect("a page").contains("id=\"splits\""));
    }
}
