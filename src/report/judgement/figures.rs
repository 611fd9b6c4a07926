//! Residuals against what they depend on, and the map of the predicted uncertainty.

use std::ops::Range;

use nalgebra::Vector3;
use plotters::prelude::*;

use crate::pipeline::{Judgement, ModeOutcome, Outcome, PredictedPosition};
use crate::report::files::ReportError;
use crate::report::plots::look;
use crate::report::plots::{
    Area, Axes, Drawn, INK, WIDTH, centred, drawable, finite_range, foot, ink, largest, markers, padded,
    place_axes, px, svg, thinned, three_views,
};
use calibrig_estimation::evaluation::{Cause, ResidualPattern};
use calibrig_model::JointKind;

const TITLE: i32 = 22;
const FOOT: i32 = 20;
/// Points in a panel; of more, those of `thinned`.
pub(super) const MARKED: usize = 120;
/// Classes of the mean curve.
const CLASSES: usize = 8;

/// Errors of the identification set against a pattern's variable: along the actuator's motion where it is one's, and along the axes.
pub(super) fn pattern_figure(
    outcome: &Outcome,
    mode: &ModeOutcome,
    judgement: &Judgement,
    pattern: &ResidualPattern,
) -> Result<String, ReportError> {
    const PANEL: i32 = 170;
    let panels = panels(outcome, mode, judgement, pattern.cause);
    let label = format!("Error against what it {}", pattern.description.replace(['<', '>', '&', '"'], " "));
    svg("residual patterns", &label, (WIDTH, TITLE + PANEL + FOOT), |area| {
        let (body, _) = area.split_vertically(px(TITLE + PANEL));
        let reach = 1.08 * largest(panels.iter().flat_map(|(_, points)| points.iter().map(|p| p.1)));
        for (place, (panel, (title, points))) in
            body.split_evenly((1, panels.len().max(1))).iter().zip(&panels).enumerate()
        {
            let (head, plot) = panel.split_vertically(px(TITLE));
            centred(&head, title)?;
            scatter(&plot, mode, points, reach, place == 0)?;
        }
        foot(area, &variable_words(outcome, pattern.cause))
    })
}

/// Title and points of every panel: (variable, mm).
fn panels(
    outcome: &Outcome,
    mode: &ModeOutcome,
    judgement: &Judgement,
    cause: Cause,
) -> Vec<(&'static str, Vec<(f64, f64)>)> {
    let errors = mode.errors.first().map_or(&[][..], Vec::as_slice);
    let along_axis = |axis: usize| {
        let value = |i: usize| match cause {
            Cause::Sequence => i.checked_sub(1).map(|before| 1e3 * errors[before][axis]),
            _ => variable(outcome, cause, i),
        };
        let points = errors.iter().enumerate().filter_map(|(i, e)| Some((value(i)?, 1e3 * e[axis])));
        points.filter(|(x, y)| drawable(*x) && drawable(*y)).collect::<Vec<_>>()
    };
    let mut panels = Vec::new();
    if let Cause::Joint(joint) | Cause::MotorTurn(joint) | Cause::Approach(joint) = cause {
        let point = |(i, error): (usize, &Vector3<f64>)| {
            let direction = judgement.sensitivity.get(i)?.get(joint)?.try_normalize(1e-9)?;
            Some((variable(outcome, cause, i)?, 1e3 * error.dot(&direction)))
        };
        let points: Vec<_> = errors.iter().enumerate().filter_map(point).collect();
        if !points.is_empty() {
            panels.push(("along the motion", points));
        }
    }
    panels.extend(["x", "y", "z"].into_iter().enumerate().map(|(axis, title)| (title, along_axis(axis))));
    panels
}

/// What the horizontal axis shows of an observation.
fn variable(outcome: &Outcome, cause: Cause, index: usize) -> Option<f64> {
    let observation = outcome.sets.first()?.measurements.observations.get(index)?;
    match cause {
        Cause::Joint(joint) => {
            let command = observation.command.get(joint)?;
            Some(command * command_unit(outcome, joint).1)
        }
        Cause::MotorTurn(joint) => {
            let turns = outcome.model.motor_turns.get(joint).copied().flatten()?;
            Some((turns * observation.command.get(joint)?).rem_euclid(1.0))
        }
        Cause::Approach(joint) => observation.approach.get(joint).map(|sign| f64::from(*sign)),
        Cause::Payload => Some(observation.payload.as_ref().map_or(0.0, |payload| payload.mass)),
        Cause::Time => Some(observation.time),
        Cause::Temperature => observation.temperature,
        _ => Some(f64::from(observation.pose)),
    }
}

fn variable_words(outcome: &Outcome, cause: Cause) -> String {
    let name =
        |joint: usize| outcome.model.kinematics.links.get(joint).map_or("a joint", |link| link.name.as_str());
    match cause {
        Cause::Joint(joint) => format!("command of {}, {}", name(joint), command_unit(outcome, joint).0),
        Cause::MotorTurn(joint) => format!("turn of the motor of {}", name(joint)),
        Cause::Approach(joint) => format!("sign of the last motion of {}", name(joint)),
        Cause::Payload => "mass of the payload, kg".to_owned(),
        Cause::Time => "time, s".to_owned(),
        Cause::Temperature => "temperature, \u{b0}C".to_owned(),
        Cause::Sequence => "error of the pose before, mm".to_owned(),
        _ => "pose".to_owned(),
    }
}

/// Unit of an actuator's command for people, and its factor from SI.
fn command_unit(outcome: &Outcome, joint: usize) -> (&'static str, f64) {
    match outcome.model.kinematics.links.get(joint).map(|link| link.kind) {
        Some(JointKind::Prismatic) => ("mm", 1e3),
        _ => ("deg", 180.0 / std::f64::consts::PI),
    }
}

/// Points in the mode's look, and the mean of every class of the variable as a line.
fn scatter(area: &Area, mode: &ModeOutcome, points: &[(f64, f64)], reach: f64, first: bool) -> Drawn {
    let x = padded(&finite_range(points.iter().map(|p| p.0)));
    let title = if first { "error, mm" } else { "" };
    let axes = Axes { room: (24, 52), labels: (4, 5), title, ..Axes::default() };
    let chart = axes.draw(area, x.clone(), -reach..reach)?;
    let look = look(mode.mode);
    let plot = chart.plotting_area();
    plot.draw(&PathElement::new(vec![(x.start, 0.0), (x.end, 0.0)], ink(1)))?;
    markers(&chart, &look, &thinned(points.to_vec(), MARKED))?;
    let means = class_means(points);
    if means.len() < 2 { Ok(()) } else { plot.draw(&PathElement::new(means, ink(5))) }
}

/// In which of so many classes of equal width a value of the range lies.
fn class(value: f64, range: &Range<f64>, classes: usize) -> usize {
    let share = (value - range.start) / (range.end - range.start);
    (1..classes).filter(|edge| share * classes as f64 >= *edge as f64).count()
}

/// The mean point of every class of equal width that has any.
fn class_means(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let range = finite_range(points.iter().map(|p| p.0));
    let mut sums = [(0.0, 0.0, 0.0); CLASSES];
    for (x, y) in points {
        let sum = &mut sums[class(*x, &range, CLASSES)];
        *sum = (sum.0 + x, sum.1 + y, sum.2 + 1.0);
    }
    sums.iter().filter(|sum| sum.2 > 0.0).map(|(x, y, n)| (x / n, y / n)).collect()
}

/// Three views of the predicted positions: a square a cell, its side in proportion to the largest standard deviation in it.
pub(super) fn map_figure(map: &[PredictedPosition]) -> Result<String, ReportError> {
    const PANEL: i32 = 300;
    let most = map.iter().map(PredictedPosition::length).fold(0.0, f64::max);
    let label = "Uncertainty of the predicted position in three views";
    svg("predicted uncertainty", label, (WIDTH, TITLE + PANEL), |area| {
        three_views(area, |panel, axes| view(panel, map, axes, most))
    })
}

fn view(area: &Area, map: &[PredictedPosition], (across, up): (usize, usize), most: f64) -> Drawn {
    const COLUMNS: usize = 14;
    const ROWS: usize = 14;
    let x = padded(&finite_range(map.iter().map(|p| p.position[across])));
    let y = padded(&finite_range(map.iter().map(|p| p.position[up])));
    let chart = place_axes(area, x.clone(), y.clone())?;
    let plot = chart.plotting_area();
    let (width, height) = plot.dim_in_pixel();
    let half = i32::try_from((width / 14).min(height / 14) / 2).unwrap_or(1).max(2) - 1;
    let step = ((x.end - x.start) / COLUMNS as f64, (y.end - y.start) / ROWS as f64);
    let mut cells = [[0.0_f64; ROWS]; COLUMNS];
    for place in map {
        let (column, row) = (class(place.position[across], &x, COLUMNS), class(place.position[up], &y, ROWS));
        cells[column][row] = cells[column][row].max(place.length());
    }
    for (column, cells) in cells.iter().enumerate() {
        for (row, sigma) in cells.iter().enumerate().filter(|(_, sigma)| **sigma > 0.0) {
            let at = (x.start + (column as f64 + 0.5) * step.0, y.start + (row as f64 + 0.5) * step.1);
            let wanted = f64::from(half) * sigma / most + 0.5;
            let side = (1..=half).rev().find(|side| f64::from(*side) <= wanted).unwrap_or(1);
            let square = EmptyElement::at(at) + Rectangle::new([(-side, -side), (side, side)], INK.filled());
            plot.draw(&square)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn class_means_follow_a_line_and_keep_every_point() {
        let points: Vec<_> = (0..80).map(|i| (f64::from(i), 2.0 * f64::from(i))).collect();
        let means = class_means(&points);
        assert_eq!(means.len(), CLASSES);
        assert!(means.iter().all(|(x, y)| (y - 2.0 * x).abs() < 1e-9));
        assert_eq!(class_means(&[(1.0, 5.0), (1.0, 7.0)]), [(1.0, 6.0)]);
        assert!(class_means(&[]).is_empty());
    }

    #[test]
    fn a_square_is_as_wide_as_the_uncertainty_in_its_cell() {
        let place = |x: f64, sigma: f64| PredictedPosition {
            position: Vector3::new(x, 0.0, 2.0),
            sigma: Vector3::new(0.0, sigma, 0.0),
        };
        let figure = map_figure(&[place(0.0, 1e-3), place(1.0, 0.5e-3)]).expect("a figure");
        let sides: Vec<f64> = figure
            .match_indices("<rect ")
            .filter_map(|(at, _)| {
                let width = figure[at..].split("width=\"").nth(1)?;
                width.split('"').next()?.parse().ok()
            })
            .collect();
        let (most, least) =
            (sides.iter().copied().fold(0.0, f64::max), sides.iter().copied().fold(1e9, f64::min));
        assert!((most / least - 2.0).abs() < 0.15, "{sides:?}");
        assert!(map_figure(&[]).is_ok());
    }
}
