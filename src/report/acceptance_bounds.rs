//! What held-out errors say of all poses of the region: bounds with a confidence, not only the largest that was seen.

use std::collections::BTreeMap;
use std::fmt::Write;

use maud::{Markup, html};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::document::finite;
use super::markup::key;
use super::plots::look;
use super::terminal::{Ink, Style, aligned, millimetres};
use super::words::{capital, counted, number};
use crate::pipeline::{Outcome, SetKind};
use calibrig_estimation::evaluation::{Acceptance, accept};
use calibrig_estimation::identification::Mode;

const COVERAGE: f64 = 0.95;
const CONFIDENCE: f64 = 0.95;

/// Bounds of the 3-D errors of the poses of the region that the held-out poses were drawn in at random, m; of a pose with several readings its largest counts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonAcceptance {
    /// The share of the region's poses that the bounds are of.
    pub coverage: f64,
    /// How often such bounds hold.
    pub confidence: f64,
    /// Whatever the distribution of the errors; null of too few errors.
    pub distribution_free_m: Option<f64>,
    /// How many errors would have such a bound.
    pub needed: usize,
    /// Where errors are normal, alike along the axes and without bias.
    pub isotropic_m: Option<f64>,
    /// The share of the region's poses that stays below the largest error seen at least, with the confidence.
    pub share_below_largest: f64,
}

/// The largest error of every pose, m, from the pose and the error of each reading: readings of one pose are not held out independently.
pub(super) fn by_pose<'a>(readings: impl Iterator<Item = (u32, &'a Vector3<f64>)>) -> Vec<f64> {
    let mut largest: BTreeMap<u32, f64> = BTreeMap::new();
    for (pose, error) in readings {
        let own = largest.entry(pose).or_default();
        *own = own.max(error.norm());
    }
    largest.into_values().collect()
}

/// Bounds from the errors of poses that were held out, m; `None` where they bound nothing.
fn bounds(errors: &[f64]) -> Option<Acceptance> {
    accept(errors, COVERAGE, CONFIDENCE).ok()
}

pub(super) fn json_acceptance(errors: &[f64]) -> Option<JsonAcceptance> {
    let found = bounds(errors)?;
    Some(JsonAcceptance {
        coverage: found.coverage,
        confidence: found.confidence,
        distribution_free_m: found.distribution_free.and_then(|order| finite(order.bound)),
        needed: found.needed,
        isotropic_m: finite(found.isotropic),
        share_below_largest: found.largest.share_below,
    })
}

/// Lengths of the errors of a set that was held out, by mode; empty of other sets.
fn held_out(outcome: &Outcome, index: usize) -> Vec<(Mode, Acceptance)> {
    let Some(set) = outcome.sets.get(index).filter(|set| set.kind == SetKind::Verification) else {
        return Vec::new();
    };
    let of = |mode: &crate::pipeline::ModeOutcome| {
        let readings = set.measurements.observations.iter().zip(mode.errors.get(index)?);
        let errors = by_pose(readings.map(|(observation, error)| (observation.pose, error)));
        Some((mode.mode, bounds(&errors)?))
    };
    outcome.modes.iter().filter_map(of).collect()
}

const NAMES: [&str; 3] = ["any", "normal", "largest"];

/// Lines below the table of a held-out set.
pub(super) fn acceptance_lines(outcome: &Outcome, index: usize, style: Style) -> Vec<String> {
    let rows = held_out(outcome, index);
    let Some((_, first)) = rows.first() else { return Vec::new() };
    let mut lines = vec![
        "bounds of the 3-D error that 95 % of the region's poses stay below, with 95 % confidence, mm"
            .to_owned(),
        style.paint(Ink::Dim, &aligned("  if errors are distributed", &NAMES.map(str::to_owned))),
    ];
    for (mode, found) in &rows {
        let free = found.distribution_free.map_or_else(|| "-".to_owned(), |order| millimetres(order.bound));
        lines.push(aligned(
            mode.title(),
            &[free, millimetres(found.isotropic), millimetres(found.largest.seen)],
        ));
    }
    lines.extend(style.told(Ink::Dim, &note(first), "    "));
    lines
}

fn note(found: &Acceptance) -> String {
    let mut words = format!(
        "  from {}, taken as drawn at random in the region: {:.1} % of its poses stay below the largest error seen, with the same confidence",
        counted(found.count, "held-out pose"),
        100.0 * found.largest.share_below
    );
    if found.distribution_free.is_none() {
        // Writing to a String cannot fail.
        let _ = write!(
            words,
            "; a bound for 95 % that holds for any distribution needs {} poses: hold out more",
            found.needed
        );
    }
    words
}

/// The same on the page.
pub(super) fn acceptance_table(outcome: &Outcome, index: usize) -> Markup {
    let rows = held_out(outcome, index);
    let mm = |metres: f64| number(1e3 * metres, 3);
    html! {
        @if let Some((_, first)) = rows.first() {
            div.scroll {
                table {
                    caption { "3-D error that 95 % of the region\u{2019}s poses stay below, with 95 % confidence, mm" }
                    thead {
                        tr {
                            th {} th { "for any distribution of errors" } th { "if errors are normal and alike along the axes" } th { "largest seen" }
                        }
                    }
                    tbody {
                        @for (mode, found) in &rows {
                            tr {
                                th scope="row" { (key(&look(*mode))) (mode.title()) }
                                td { (mm(found.distribution_free.map_or(f64::NAN, |order| order.bound))) }
                                td { (mm(found.isotropic)) }
                                td { (mm(found.largest.seen)) }
                            }
                        }
                    }
                }
            }
            p.note { (capital(note(first).trim_start())) "." }
        }
    }
}
