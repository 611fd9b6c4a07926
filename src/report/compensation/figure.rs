//! The way with what nominal commands miss, how sure it is, and what every actuator does along it.

use std::ops::Range;

use nalgebra::Vector3;
use plotters::prelude::*;

use super::{is_to_be_looked_at, with_unit};
use crate::compensate::{Compensation, Corrected, End};
use crate::report::files::ReportError;
use crate::report::plots::{
    Area, Axes, Chart, Drawn, INK, LOOKS, Look, WIDTH, centred, drawable, finite_range, foot, ink, largest,
    log_range, marker, one_two_five, padded, place_axes, px, round_below, sampled, svg, three_views,
};
use calibrig_estimation::compensation::CompensatedPoint;

const TITLE: i32 = 22;
const FOOT: i32 = 20;
/// Arrows in a view, and points of a line: more are not told apart.
const ARROWS: usize = 250;
const DRAWN: usize = 800;
/// Share of a view that the longest arrow takes.
const LONGEST: f64 = 0.12;

/// What nominal commands miss.
pub(super) const BEFORE: Look = LOOKS[0];
/// How sure the corrected position is.
pub(super) const SURE: Look = LOOKS[1];
/// What has a mark.
pub(super) const MARKED: Look = LOOKS[3];

/// By how much arrows are drawn longer than they are: 1, 2 or 5 times a power of ten.
pub(super) fn arrow_factor(made: &Compensation) -> f64 {
    let extent = (0..3).map(|axis| {
        let range = finite_range(made.points.iter().map(|point| point.goal.position()[axis]));
        range.end - range.start
    });
    let extent = extent.fold(0.0, f64::max);
    let longest = made.before().map_or(0.0, |before| before.max);
    let wanted = LONGEST * extent / longest;
    round_below(wanted).unwrap_or(1.0)
}

/// Ranges about the middles of two, in which a metre is as long across as up in a plot of these pixels.
fn square(x: &Range<f64>, y: &Range<f64>, [width, height]: [f64; 2]) -> [Range<f64>; 2] {
    let scale = ((x.end - x.start) / width).max((y.end - y.start) / height);
    let about = |range: &Range<f64>, pixels: f64| {
        let middle = 0.5 * (range.start + range.end);
        middle - 0.5 * scale * pixels..middle + 0.5 * scale * pixels
    };
    [about(x, width), about(y, height)]
}

/// The goals in three views of the base frame, with arrows to where nominal commands are predicted to put the tool, m.
pub(super) fn way_figure(made: &Compensation) -> Result<String, ReportError> {
    const PANEL: i32 = 300;
    let factor = arrow_factor(made);
    let tips: Vec<(Vector3<f64>, Vector3<f64>)> = made
        .corrected()
        .map(|(point, found)| (point.goal.position(), point.goal.position() + factor * found.uncompensated))
        .filter(|(_, tip)| tip.iter().all(|v| drawable(*v)))
        .collect();
    let marked: Vec<Vector3<f64>> = made
        .points
        .iter()
        .filter(|point| is_to_be_looked_at(point))
        .map(|point| point.goal.position())
        .filter(|place| place.iter().all(|v| drawable(*v)))
        .collect();
    svg("the way", "Goals, and where nominal commands put the tool", (WIDTH, TITLE + PANEL + FOOT), |area| {
        let (body, _) = area.split_vertically(px(TITLE + PANEL));
        three_views(&body, |panel, (across, up)| {
            let all = |axis: usize| {
                let goals = made.points.iter().map(move |point| point.goal.position()[axis]);
                padded(&finite_range(goals.chain(tips.iter().map(move |(_, tip)| tip[axis]))))
            };
            let (width, height) = panel.dim_in_pixel();
            let inner = [f64::from(width) - f64::from(px(56)), f64::from(height) - f64::from(px(30))];
            let [x, y] = square(&all(across), &all(up), inner);
            let chart = place_axes(panel, x, y)?;
            let plot = chart.plotting_area();
            if made.is_path {
                let line: Vec<_> = sampled(made.points.len(), DRAWN)
                    .map(|index| made.points[index].goal.position())
                    .filter(|place| place.iter().all(|v| drawable(*v)))
                    .map(|place| (place[across], place[up]))
                    .collect();
                plot.draw(&PathElement::new(line, INK.mix(0.5).stroke_width(2)))?;
            }
            for index in sampled(tips.len(), ARROWS) {
                let (goal, tip) = &tips[index];
                let (from, to) = ((goal[across], goal[up]), (tip[across], tip[up]));
                plot.draw(&PathElement::new(vec![from, to], BEFORE.light.stroke_width(3)))?;
                plot.draw(&marker(&BEFORE, to, 2))?;
                if !made.is_path {
                    plot.draw(&Circle::new(from, 3, INK.filled()))?;
                }
            }
            for index in sampled(marked.len(), ARROWS) {
                let place = &marked[index];
                plot.draw(&marker(&MARKED, (place[across], place[up]), 7))?;
            }
            Ok(())
        })?;
        foot(area, "base frame, m")
    })
}

/// Where a point stands along the way: at its time, or its number.
fn along(made: &Compensation, index: usize) -> f64 {
    made.points[index].time.filter(|_| made.is_path).unwrap_or(index as f64 + 1.0)
}

fn along_words(made: &Compensation) -> &'static str {
    if made.is_path { "time along the path, s" } else { "point" }
}

fn along_range(made: &Compensation) -> Range<f64> {
    let range = finite_range((0..made.points.len()).map(|index| along(made, index)));
    if made.is_path { range } else { range.start - 0.5..range.end + 0.5 }
}

/// Values along the way, cut where there are none or the robot jumps.
fn pieces(
    made: &Compensation,
    value: impl Fn(&Corrected, &CompensatedPoint) -> Option<f64>,
) -> Vec<Vec<(f64, f64)>> {
    let mut pieces: Vec<Vec<(f64, f64)>> = vec![Vec::new()];
    for index in sampled(made.points.len(), DRAWN) {
        let point = &made.points[index];
        let found = point.point.as_ref().and_then(|found| value(point, found)).filter(|v| drawable(*v));
        let cut = found.is_none() || point.end == End::Jumped;
        if cut && pieces.last().is_some_and(|last| !last.is_empty()) {
            pieces.push(Vec::new());
        }
        if let (Some(value), Some(last)) = (found, pieces.last_mut()) {
            last.push((along(made, index), value));
        }
    }
    pieces.retain(|piece| !piece.is_empty());
    pieces
}

fn draw_pieces(chart: &Chart, made: &Compensation, look: &Look, pieces: Vec<Vec<(f64, f64)>>) -> Drawn {
    let plot = chart.plotting_area();
    for piece in pieces {
        if made.is_path && piece.len() > 1 {
            plot.draw(&PathElement::new(piece, look.light.stroke_width(3)))?;
        } else {
            for at in piece {
                plot.draw(&marker(look, at, 5))?;
            }
        }
    }
    Ok(())
}

/// What nominal commands miss, and the standard deviation of corrected positions, mm, on a logarithmic axis.
pub(super) fn size_figure(made: &Compensation) -> Result<String, ReportError> {
    const PANEL: i32 = 240;
    let before = |_: &Corrected, found: &CompensatedPoint| Some((1e3 * found.uncompensated.norm()).max(1e-6));
    let sigma = |point: &Corrected, _: &CompensatedPoint| Some((1e3 * point.sigma()?).max(1e-6));
    let trust = made.trust.map(|most| 1e3 * most);
    let (before, sigma) = (pieces(made, before), pieces(made, sigma));
    let values = || before.iter().chain(&sigma).flatten().map(|(_, value)| *value).chain(trust);
    let ticks = one_two_five(values().fold(f64::INFINITY, f64::min), values().fold(0.0, f64::max));
    let x = along_range(made);
    let logarithms = |pieces: &[Vec<(f64, f64)>]| -> Vec<Vec<(f64, f64)>> {
        pieces.iter().map(|piece| piece.iter().map(|(x, y)| (*x, y.log10())).collect()).collect()
    };
    let label = "Predicted error and its uncertainty along the way";
    svg("errors and their uncertainty", label, (WIDTH, PANEL + FOOT), |area| {
        let (body, _) = area.split_vertically(px(PANEL));
        let axes = Axes { top: 6, room: (24, 62), title: "mm (logarithmic)", ..Axes::default() };
        let chart = axes.draw_log(&body, x.clone(), log_range(&ticks), &ticks)?;
        draw_pieces(&chart, made, &BEFORE, logarithms(&before))?;
        draw_pieces(&chart, made, &SURE, logarithms(&sigma))?;
        let plot = chart.plotting_area();
        if let Some(most) = trust {
            plot.draw(&PathElement::new(vec![(x.start, most.log10()), (x.end, most.log10())], ink(3)))?;
        }
        // What is extrapolated has a mark at the foot.
        let heights = log_range(&ticks);
        let foot_of = heights.start + 0.03 * (heights.end - heights.start);
        let out: Vec<usize> =
            (0..made.points.len()).filter(|index| !made.points[*index].beyond.is_empty()).collect();
        for place in sampled(out.len(), DRAWN) {
            plot.draw(&marker(&MARKED, (along(made, out[place]), foot_of), 4))?;
        }
        foot(area, along_words(made))
    })
}

/// Corrected commands, and what the correction changes of them, a row an actuator.
pub(super) fn command_figure(made: &Compensation) -> Result<String, ReportError> {
    const PANEL: i32 = 96;
    let rows: Vec<_> =
        made.actuators.iter().enumerate().filter(|(_, actuator)| actuator.is_commanded).collect();
    let count = rows.len().max(1);
    let height = PANEL * i32::try_from(count).unwrap_or(1);
    let x = along_range(made);
    svg("commands", "Commands of every actuator along the way", (WIDTH, TITLE + height + FOOT), |area| {
        let (heads, rest) = area.split_vertically(px(TITLE));
        for (head, words) in heads.split_evenly((1, 2)).iter().zip(["command", "correction"]) {
            centred(head, words)?;
        }
        let (panels, _) = rest.split_vertically(px(height));
        let panels = panels.split_evenly((count, 2));
        for (row, (index, actuator)) in rows.iter().enumerate() {
            let command =
                |_: &Corrected, found: &CompensatedPoint| Some(actuator.shown(*found.command.get(*index)?));
            let change = |_: &Corrected, found: &CompensatedPoint| {
                Some(actuator.shown(found.command.get(*index)? - found.nominal.get(*index)?))
            };
            for (column, (label, values)) in
                [(with_unit(actuator), pieces(made, command)), (String::new(), pieces(made, change))]
                    .into_iter()
                    .enumerate()
            {
                let y = if column == 0 {
                    padded(&finite_range(values.iter().flatten().map(|(_, value)| *value)))
                } else {
                    let reach = 1.08 * largest(values.iter().flatten().map(|(_, value)| *value));
                    -reach..reach
                };
                let last = row + 1 == count;
                let panel = &panels[2 * row + column];
                let look = if column == 0 { SURE } else { BEFORE };
                command_panel(panel, made, (&label, last), [x.clone(), y], &look, values)?;
            }
        }
        foot(area, along_words(made))
    })
}

fn command_panel(
    area: &Area<'_>,
    made: &Compensation,
    (label, is_last): (&str, bool),
    [x, y]: [Range<f64>; 2],
    look: &Look,
    values: Vec<Vec<(f64, f64)>>,
) -> Drawn {
    let (below, numbers) = if is_last { (22, 6) } else { (8, 0) };
    let axes = Axes { top: 3, room: (below, 66), labels: (numbers, 3), title: label, ..Axes::default() };
    draw_pieces(&axes.draw(area, x, y)?, made, look, values)
}
