//! Errors as arrows over the working region, and the session that they come from.

use maud::{Markup, html};
use nalgebra::Vector3;
use plotters::prelude::*;

use super::plots::{
    Area, Drawn, VIEWS, WIDTH, centred, finite_range, ink, look, padded, place_axes, px, svg,
};
use super::{ReportError, payload_words, set_title};
use crate::pipeline::{ModeOutcome, Outcome, SetOutcome};
use calibrig_model::measurement::{Observation, Reading};

const TITLE: i32 = 22;
const PANEL: i32 = 260;
/// Length of the longest arrow, as a part of the region's diagonal.
const LONGEST: f64 = 0.1;
/// An error at its place in the base frame, m.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Arrow {
    from: Vector3<f64>,
    error: Vector3<f64>,
}

/// The errors of a mode over all sets in three views, and how much longer than life their arrows are. `None` without a finite error.
pub(super) fn arrows(outcome: &Outcome, mode: &ModeOutcome) -> Result<Option<(String, f64)>, ReportError> {
    let arrows = arrows_of(outcome, mode);
    let Some(scale) = scale(&arrows) else { return Ok(None) };
    let label =
        format!("Errors of {} over the working region in three views, {scale} times", mode.mode.title());
    let figure = svg("errors over the region", &label, (WIDTH, TITLE + PANEL), |area| {
        for (panel, (title, across, up)) in area.split_evenly((1, 3)).iter().zip(VIEWS) {
            let (head, plot) = panel.split_vertically(px(TITLE));
            centred(&head, &format!("{title}, m"))?;
            view(&plot, mode, &arrows, (across, up), scale)?;
        }
        Ok(())
    })?;
    Ok(Some((figure, scale)))
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
    let low = arrows.iter().fold(Vector3::repeat(f64::INFINITY), |low, a| low.inf(&a.from));
    let high = arrows.iter().fold(Vector3::repeat(f64::NEG_INFINITY), |high, a| high.sup(&a.from));
    let wanted = LONGEST * (high - low).norm().max(1e-3) / most;
    let decade = 10_f64.powf(wanted.log10().floor());
    let step = [5.0, 2.0, 1.0].into_iter().find(|step| step * decade <= wanted).unwrap_or(1.0);
    Some(step * decade).filter(|scale| scale.is_finite())
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
                    _ => ", base not measured",
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
    use crate::report::sample;

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
            let (figure, scale) = arrows(&outcome, mode).expect("drawn").expect("errors");
            assert!(figure.contains(&format!("{scale} times")) && figure.contains("<polyline"), "{scale}");
        }
        let facts = session_facts(&outcome).into_string();
        assert!(facts.contains("Temperature"), "{facts}");
    }
}
