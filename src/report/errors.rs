//! The errors pose by pose, how they are distributed, and where in the region they lie.

use maud::{Markup, html};

use super::files::ReportError;
use super::markup::{figure, key};
use super::plots::look;
use super::plots::{
    Area, Axes, MARKS, WIDTH, centred, curve, drawable, finite_range, foot, ink, largest, markers,
    one_two_five, px, sampled, svg, thinned, thinned_words, vertical_ticks,
};
use super::region;
use super::words::{counted, number, set_title};
use crate::pipeline::{ModeOutcome, Outcome};
use plotters::prelude::*;

pub(super) fn errors_section(outcome: &Outcome) -> Result<Markup, ReportError> {
    let all: Vec<_> = outcome.modes.iter().collect();
    let after: Vec<_> = outcome.modes.iter().filter(|m| m.estimate.is_some()).collect();
    let titles = |modes: &[&crate::pipeline::ModeOutcome]| modes.iter().map(|m| m.mode).collect::<Vec<_>>();
    let before_and_after = residuals(outcome, &all)?;
    let zoomed =
        if after.is_empty() || after.len() == all.len() { None } else { Some(residuals(outcome, &after)?) };
    let distribution = distribution(outcome)?;
    let readings = || outcome.sets.iter().map(|set| set.measurements.observations.len());
    let (most, all_points) = (readings().max().unwrap_or(0), readings().sum());
    // Before, and after with the best model: those between show the same more faintly.
    let mut arrows = Vec::new();
    for mode in
        outcome.modes.first().into_iter().chain(outcome.modes.last().filter(|_| outcome.modes.len() > 1))
    {
        if let Some(drawn) = region::arrows(outcome, mode)? {
            arrows.push((mode.mode, drawn));
        }
    }
    Ok(html! {
        section #errors {
            h2 { "Errors" }
            (figure(&titles(&all), &before_and_after, &html! {
                "Measured minus predicted position of every reading, along each axis, before and after calibration."
                (thinned_words(most, MARKS))
                @if most > MARKS { " All are in residuals.csv." }
            }, false))
            @if let Some(zoomed) = zoomed {
                (figure(&titles(&after), &zoomed, &html! {
                    "The same after calibration only, on a scale of its own. A pattern over the poses is something that the "
                    "model lacks; measurement noise alone would look like noise."
                    (thinned_words(most, MARKS))
                    @if most > MARKS { " All are in residuals.csv." }
                }, false))
            }
            (figure(&titles(&all), &distribution, &html! {
                "Share of the observations whose 3-D error is at most the given one. Curves further to the left are better."
            }, true))
            (percentile_table(outcome))
            @for (mode, region::Arrows { figure: drawing, scale, drawn }) in &arrows {
                (figure(&[*mode], drawing, &html! {
                    "Errors of \u{201c}" (mode.title()) "\u{201d} over the working region, in three views of the base frame: from the predicted "
                    "position (small dot) towards the measured one (large dot), drawn " (scale) " times as long as they are. Arrows that agree with "
                    "their neighbours show something that the model lacks."
                    @if *drawn < all_points { " Of " (counted(all_points, "reading")) " these are " (drawn) ": the largest error in each part of the region." }
                }, false))
            }
        }
    })
}

fn percentile_table(outcome: &Outcome) -> Markup {
    html! {
        div.scroll {
            table {
                caption { "3-D error that a share of the observations stays below, mm" }
                thead {
                    tr { th rowspan="2" {} @for set in &outcome.sets { th.group colspan="3" { (set_title(set.kind)) } } }
                    tr { @for _ in &outcome.sets { th.first { "50 %" } th { "95 %" } th { "all" } } }
                }
                tbody {
                    @for mode in &outcome.modes {
                        tr {
                            th scope="row" { (key(&look(mode.mode))) (mode.mode.title()) }
                            @for errors in &mode.errors {
                                @let sorted = sorted_norms(errors);
                                @for (i, share) in [0.5, 0.95, 1.0].into_iter().enumerate() {
                                    td.first[i == 0] {
                                        @if let Some(value) = quantile(&sorted, share) { (number(1e3 * value, 3)) }
                                    }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn sorted_norms(errors: &[nalgebra::Vector3<f64>]) -> Vec<f64> {
    let mut norms: Vec<_> = errors.iter().map(nalgebra::Vector3::norm).collect();
    norms.sort_by(f64::total_cmp);
    norms
}

/// The smallest value that at least `share` of the sorted values do not exceed.
fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    let n = sorted.len() as f64;
    sorted.iter().enumerate().find(|(i, _)| (*i as f64 + 1.0) >= share * n - 1e-9).map(|(_, v)| *v)
}

/// Signed errors per axis against the pose number, a column of panels a set; mm.
fn residuals(outcome: &Outcome, modes: &[&ModeOutcome]) -> Result<String, ReportError> {
    const TITLE: i32 = 22;
    const PANEL: i32 = 140;
    const FOOT: i32 = 20;
    let size = (WIDTH, TITLE + 3 * PANEL + FOOT);
    svg("residuals", "Errors per axis against the pose number", size, |area| {
        for (column, (set, cell)) in set_columns(outcome, area).into_iter().enumerate() {
            let (title, rest) = cell.split_vertically(px(TITLE));
            centred(&title, set_title(outcome.sets[set].kind))?;
            let observations = &outcome.sets[set].measurements.observations;
            let poses = finite_range(observations.iter().map(|o| f64::from(o.pose)));
            let poses = poses.start - 1.0..poses.end + 1.0;
            let (panels, _) = rest.split_vertically(px(3 * PANEL));
            for (axis, panel) in panels.split_evenly((3, 1)).iter().enumerate() {
                let all = modes.iter().flat_map(|m| m.errors.iter().flatten());
                let reach = 1.08 * largest(all.map(|e| 1e3 * e[axis]));
                let title = format!("{} error, mm", ["x", "y", "z"][axis]);
                let axes = Axes { title: if column == 0 { &title } else { "" }, ..Axes::default() };
                let chart = axes.draw(panel, poses.clone(), -reach..reach)?;
                let zero = vec![(poses.start, 0.0), (poses.end, 0.0)];
                chart.plotting_area().draw(&PathElement::new(zero, ink(1)))?;
                for mode in modes {
                    let errors = mode.errors.get(set).map_or(&[][..], Vec::as_slice);
                    let points =
                        observations.iter().zip(errors).map(|(o, e)| (f64::from(o.pose), 1e3 * e[axis]));
                    let points = points.filter(|(_, error)| drawable(*error)).collect();
                    markers(&chart, &look(mode.mode), &thinned(points, MARKS))?;
                }
            }
            foot(&rest, "pose")?;
        }
        Ok(())
    })
}

/// Share of observations whose 3-D error is at most so large, a panel a set; logarithmic in mm.
fn distribution(outcome: &Outcome) -> Result<String, ReportError> {
    const TITLE: i32 = 22;
    const PANEL: i32 = 280;
    const FOOT: i32 = 20;
    svg("error magnitudes", "Cumulative share of 3-D errors", (WIDTH, TITLE + PANEL + FOOT), |area| {
        let magnitudes = |mode: &ModeOutcome, set: usize| -> Vec<f64> {
            let mut values: Vec<_> = mode
                .errors
                .get(set)
                .into_iter()
                .flatten()
                .map(|e| 1e3 * e.norm())
                .filter(|v| drawable(*v))
                .collect();
            values.sort_by(f64::total_cmp);
            values
        };
        let everything: Vec<Vec<f64>> = outcome
            .modes
            .iter()
            .flat_map(|m| (0..outcome.sets.len()).map(move |set| magnitudes(m, set)))
            .filter(|v| !v.is_empty())
            .collect();
        // The lowest twentieth of the best curve may run off the page: it would stretch the axis over decades.
        let low = everything.iter().map(|v| v[v.len() / 20]).fold(f64::INFINITY, f64::min);
        let high = everything.iter().filter_map(|v| v.last()).fold(0.0, |a: f64, b| a.max(*b));
        let ticks = one_two_five(low, high);
        let (Some(first), Some(last)) = (ticks.first(), ticks.last()) else { return Ok(()) };
        let x = first.log10()..last.log10();
        for (column, (set, cell)) in set_columns(outcome, area).into_iter().enumerate() {
            let (title, rest) = cell.split_vertically(px(TITLE));
            centred(&title, set_title(outcome.sets[set].kind))?;
            let (panel, _) = rest.split_vertically(px(PANEL));
            let title = if column == 0 { "share of observations, %" } else { "" };
            let axes = Axes { labels: (0, 6), title, ..Axes::default() };
            let chart = axes.draw(&panel, x.clone(), 0.0..102.0)?;
            vertical_ticks(&panel, &chart, &ticks, &(0.0..102.0))?;
            for mode in &outcome.modes {
                let values = magnitudes(mode, set);
                // The largest errors all have a step of their own.
                let tail = values.len().saturating_sub(20);
                let kept = sampled(tail, 2 * MARKS).chain(tail..values.len());
                let mut steps = Vec::new();
                let mut before = 0.0;
                for place in kept {
                    let at = values[place].log10().max(x.start);
                    let share = 100.0 * (place + 1) as f64 / values.len() as f64;
                    steps.extend([(at, before), (at, share)]);
                    before = share;
                }
                steps.extend(values.last().map(|_| (x.end, 100.0)));
                curve(&chart, &look(mode.mode), steps)?;
            }
            foot(&rest, "3-D error, mm (logarithmic)")?;
        }
        Ok(())
    })
}

/// A column a measured set, as wide as its share of the observations allows.
fn set_columns<'a>(outcome: &Outcome, area: &Area<'a>) -> Vec<(usize, Area<'a>)> {
    let counts: Vec<_> = outcome
        .sets
        .iter()
        .enumerate()
        .map(|(index, set)| (index, set.measurements.observations.len()))
        .filter(|(_, count)| *count > 0)
        .collect();
    if let [(first, a), (second, b)] = counts.as_slice() {
        let share = (*a as f64 / (a + b) as f64).clamp(0.4, 0.6);
        let (left, right) = area.split_horizontally((100.0 * share).percent_width());
        return vec![(*first, left), (*second, right)];
    }
    let columns = area.split_evenly((1, counts.len().max(1)));
    counts.iter().map(|(set, _)| *set).zip(columns).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::plots::{LOOKS, hex};
    use crate::report::tests::sample;
    use nalgebra::Vector3;

    #[test]
    fn quantiles_by_hand() {
        let values = [1.0, 2.0, 3.0, 4.0];
        assert_eq!(
            [0.25, 0.5, 0.51, 0.95, 1.0].map(|s| quantile(&values, s)),
            [1.0, 2.0, 3.0, 4.0, 4.0].map(Some)
        );
        assert_eq!(quantile(&[], 0.5), None);
    }

    #[test]
    fn every_pose_is_drawn_in_the_colour_of_its_mode() {
        let outcome = sample::simulated();
        let modes: Vec<_> = outcome.modes.iter().collect();
        let figure = residuals(&outcome, &modes).expect("a figure");
        let circles = figure.matches("<circle").count();
        assert_eq!(circles, 3 * 98, "one a pose and axis");
        let blue = format!("<polygon opacity=\"1\" fill=\"{}\"", hex(LOOKS[1].light));
        assert_eq!(figure.matches(&blue).count(), 3 * 98);
        assert!(!figure.contains("#FFFFFF"), "no background");
    }

    #[test]
    fn nothing_that_a_run_can_hold_stops_a_figure() {
        for bad in [0.0, 1e-300, 1e12, f64::NAN, f64::INFINITY] {
            let mut outcome = sample::simulated();
            for mode in &mut outcome.modes {
                for error in mode.errors.iter_mut().flatten() {
                    *error = Vector3::repeat(bad);
                }
            }
            let modes: Vec<_> = outcome.modes.iter().collect();
            for figure in [residuals(&outcome, &modes), distribution(&outcome)] {
                assert!(figure.expect("a figure").ends_with("</svg>\n"), "{bad}");
            }
            outcome.sets.clear();
            assert!(residuals(&outcome, &[]).is_ok() && distribution(&outcome).is_ok());
        }
    }

    #[test]
    fn the_page_of_a_large_session_is_bounded_and_shows_the_worst_errors() {
        let mut outcome = sample::simulated();
        let own = outcome.sets[0].measurements.observations.clone();
        let count = 100 * own.len();
        outcome.sets[0].measurements.observations = (0..count)
            .map(|place| {
                let mut observation = own[place % own.len()].clone();
                observation.pose = u32::try_from(place).expect("few poses");
                observation
            })
            .collect();
        for mode in &mut outcome.modes {
            let errors = mode.errors[0].clone();
            mode.errors[0] = (0..count).map(|place| errors[place % errors.len()]).collect();
            mode.errors[0][777] = Vector3::new(0.5, -0.4, 0.3);
        }
        let modes: Vec<_> = outcome.modes.iter().collect();
        let figure = residuals(&outcome, &modes).expect("a figure");
        let drawn = figure.matches("<circle").count();
        assert!(drawn <= 3 * (MARKS + 38) && drawn > 3 * MARKS / 2, "{drawn} of {}", 3 * count);
        assert!(distribution(&outcome).expect("a figure").len() < 400_000);
        let page = crate::report::html_report(&outcome).expect("a page");
        assert!(page.contains("of equal width the lowest, the middle and the highest"));
        assert!(page.len() < 3_000_000, "{} bytes", page.len());
    }
}
