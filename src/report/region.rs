//! Errors as arrows over the working region, and the session that they come from.

use std::collections::BTreeMap;

use maud::{Markup, html};
use nalgebra::Vector3;
use plotters::prelude::*;

use super::files::ReportError;
use super::plots::{
    Area, Drawn, WIDTH, finite_range, ink, look, padded, place_axes, px, round_below, svg, three_views,
};
use super::words::{payload_words, set_title};
use crate::pipeline::{ModeOutcome, Outcome, SetOutcome};
use calibrig_model::measurement::{Observation, Reading};

/// Cells along each axis of which one arrow is drawn where there are many errors, and how many are many.
const CELLS: usize = 6;
const MANY: usize = 200;
const HEIGHT: i32 = 282;
/// Length of the longest arrow, as a part of the region's diagonal.
const LONGEST: f64 = 0.1;
/// An error at its place in the base frame, m.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Arrow {
    from: Vector3<f64>,
    error: Vector3<f64>,
}

/// The errors of a mode over all sets in three views.
pub(super) struct Arrows {
    pub figure: String,
    /// How much longer than life they are drawn.
    pub scale: f64,
    /// How many there are.
    pub drawn: usize,
}

/// `None` without a finite error.
pub(super) fn arrows(outcome: &Outcome, mode: &ModeOutcome) -> Result<Option<Arrows>, ReportError> {
    let arrows = largest_by_cell(arrows_of(outcome, mode));
    let Some(scale) = scale(&arrows) else { return Ok(None) };
    let label =
        format!("Errors of {} over the working region in three views, {scale} times", mode.mode.title());
    let figure = svg("errors over the region", &label, (WIDTH, HEIGHT), |area| {
        three_views(area, |panel, axes| view(panel, mode, &arrows, axes, scale))
    })?;
    Ok(Some(Arrows { figure, scale, drawn: arrows.len() }))
}

/// Of many arrows the longest in every cell of the region, so that the largest error is always among them.
fn largest_by_cell(arrows: Vec<Arrow>) -> Vec<Arrow> {
    if arrows.len() <= MANY {
        return arrows;
    }
    let (low, high) = corners(&arrows);
    let mut cells: BTreeMap<[usize; 3], Arrow> = BTreeMap::new();
    for arrow in arrows {
        let cell = [0, 1, 2].map(|axis| {
            let share = (arrow.from[axis] - low[axis]) / (high[axis] - low[axis]).max(1e-9);
            (1..CELLS).filter(|edge| share * CELLS as f64 >= *edge as f64).count()
        });
        let longest = cells.entry(cell).or_insert(arrow);
        if arrow.error.norm() > longest.error.norm() {
            *longest = arrow;
        }
    }
    cells.into_values().collect()
}

fn corners(arrows: &[Arrow]) -> (Vector3<f64>, Vector3<f64>) {
    let [low, high] = [f64::INFINITY, f64::NEG_INFINITY].map(Vector3::repeat);
    arrows.iter().fold((low, high), |(low, high), a| (low.inf(&a.from), high.sup(&a.from)))
}

fn arrows_of(outcome: &Outcome, mode: &ModeOutcome) -> Vec<Arrow> {
    let place = |observation: &Observation| {
        let base_from_tracker = mode.robot.stations.get(observation.station)?.inverse();
        Some(base_from_tracker * nalgebra::Point3::from(observation.reading.position()))
    };
    let sets = outcome.sets.iter().zip(&mode.errors);
    let arrow = |(observation, error): (&Observation, &Vector3<f64>)| {
        let from = place(observation)?.coords - error;
        (from + error).iter().all(|v| v.is_finite()).then_some(Arrow { from, error: *error })
    };
    sets.flat_map(|(set, errors)| set.measurements.observations.iter().zip(errors).filter_map(arrow))
        .collect()
}

/// 1, 2 or 5 times a power of ten, so that the longest arrow stays below its part of the region.
fn scale(arrows: &[Arrow]) -> Option<f64> {
    let most = arrows.iter().map(|a| a.error.norm()).filter(|n| *n > 0.0).reduce(f64::max)?;
    let (low, high) = corners(arrows);
    round_below(LONGEST * (high - low).norm().max(1e-3) / most)
}

fn view(
    area: &Area,
    mode: &ModeOutcome,
    arrows: &[Arrow],
    (across, up): (usize, usize),
    scale: f64,
) -> Drawn {
    let tip = |arrow: &Arrow| arrow.from + scale * arrow.error;
    let range = |axis: usize| padded(&finite_range(arrows.iter().flat_map(|a| [a.from[axis], tip(a)[axis]])));
    let chart = place_axes(area, range(across), range(up))?;
    let plot = chart.plotting_area();
    let line = look(mode.mode).light.stroke_width(3);
    for arrow in arrows {
        let ends = [arrow.from, tip(arrow)].map(|place| (place[across], place[up]));
        plot.draw(&PathElement::new(ends.to_vec(), line))?;
        // The end is told by a dot, also on paper and without colour.
        plot.draw(&Circle::new(ends[1], px(2), look(mode.mode).light.filled()))?;
        plot.draw(&Circle::new(ends[0], px(1), ink(2)))?;
    }
    Ok(())
}

/// What the session says of itself: how it was measured, how long it took, and how warm it was.
pub(super) fn session_facts(outcome: &Outcome) -> Markup {
    let observations = || outcome.sets.iter().flat_map(|set| &set.measurements.observations);
    let span = |values: Vec<f64>| {
        let low = values.iter().copied().filter(|v| v.is_finite()).reduce(f64::min)?;
        Some((low, values.into_iter().filter(|v| v.is_finite()).reduce(f64::max)?))
    };
    let minutes = span(observations().map(|o| o.time / 60.0).collect()).filter(|(first, last)| last > first);
    let air = span(observations().filter_map(|o| o.temperature).collect());
    let spherical = observations().filter(|o| matches!(o.reading, Reading::Spherical(_))).count();
    let nests =
        |set: &SetOutcome| set.measurements.stations.iter().map(|s| s.distinct_nests().len()).sum::<usize>();
    html! {
        div {
            dt { "Tracker" }
            dd {
                @if spherical > 0 { "range and angles" } @else { "positions" }
                @match outcome.sets.first().map(nests) {
                    Some(count) if count > 0 => { ", " (count) " base nests" },
                    _ => ", no base nests",
                }
            }
        }
        @if let Some((first, last)) = minutes {
            div { dt { "Session" } dd { (format!("{:.0} min", last - first)) } }
        }
        @for set in &outcome.sets {
            @if let Some(carried) = payload_words(set) {
                div { dt { "Payload, " (set_title(set.kind).to_lowercase()) } dd { (carried) } }
            }
        }
        div {
            dt { "Temperature of the air" }
            dd {
                @match air {
                    Some((low, high)) => (format!("{low:.1} to {high:.1} \u{b0}C")),
                    None => "not recorded",
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::tests::sample;

    #[test]
    fn arrows_lead_from_the_predicted_towards_the_measured_point() {
        let outcome = sample::simulated();
        let mode = &outcome.modes[0];
        let arrows = arrows_of(&outcome, mode);
        let count: usize = outcome.sets.iter().map(|set| set.measurements.observations.len()).sum();
        assert_eq!(arrows.len(), count);
        let observation = &outcome.sets[0].measurements.observations[0];
        let in_tracker = mode.robot.stations[0] * nalgebra::Point3::from(arrows[0].from + arrows[0].error);
        assert!((in_tracker.coords - observation.reading.position()).norm() < 1e-12);
        assert_eq!(arrows[0].error, mode.errors[0][0]);
    }

    #[test]
    fn the_scale_is_round_and_fits_the_region() {
        let arrow =
            |x: f64, error: f64| Arrow { from: Vector3::new(x, 0.0, 0.0), error: Vector3::y() * error };
        for (width, error, expected) in [(2.5, 1e-3, 200.0), (2.5, 20e-3, 10.0), (1.1, 1e-6, 1e5)] {
            assert_eq!(scale(&[arrow(0.0, error), arrow(width, 0.5 * error)]), Some(expected));
        }
        assert_eq!(scale(&[]), None);
        assert_eq!(scale(&[arrow(0.0, 0.0)]), None);
    }

    #[test]
    fn every_mode_has_its_figure() {
        let outcome = sample::simulated();
        for mode in &outcome.modes {
            let Arrows { figure, scale, .. } = arrows(&outcome, mode).expect("drawn").expect("errors");
            assert!(figure.contains(&format!("{scale} times")) && figure.contains("<polyline"), "{scale}");
        }
        let facts = session_facts(&outcome).into_string();
        assert!(facts.contains("Temperature"), "{facts}");
    }
}
