//! Accuracy against number, where the poses are, and which joint ranges they cover.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};

use crate::pose_plan::PosePlan;
use crate::report::files::ReportError;
use crate::report::plots::{
    Axes, GRID, LOOKS, WIDTH, curve as curve_of, drawable, finite_range, foot, ink, marker, markers, padded,
    place_axes, px, svg, text_at, three_views, values_below,
};
use calibrig_estimation::planning::{Accuracy as PlannedAccuracy, Spread};
use calibrig_model::JointKind;
use calibrig_model::nalgebra::Vector3;

/// Candidates that are drawn; more would be a blot.
const DOTS: usize = 600;

/// Standard deviation over the region against the number of poses.
pub(super) fn curve(plan: &PosePlan) -> Result<String, ReportError> {
    const PANEL: i32 = 270;
    let um = |metres: f64| 1e6 * metres;
    let grown = |of: fn(&PlannedAccuracy) -> &Spread| -> Vec<(f64, f64)> {
        let points = plan.growth.points.iter();
        let points = points.map(|point| (point.count as f64, um(plan.figure.of(of(&point.accuracy)))));
        points.filter(|(_, y)| drawable(*y)).collect()
    };
    let (points, calibration) = (grown(|all| &all.with_machine), grown(|all| &all.of_parameters));
    let drawn = |which: usize| -> Vec<(f64, f64)> {
        let medians = plan.random.iter().map(|drawn| (drawn.poses as f64, um(drawn.medians()[which])));
        medians.filter(|(_, y)| drawable(*y)).collect()
    };
    let (random, random_calibration) = (drawn(0), drawn(1));
    let floor = um(plan.figure.of(&plan.growth.floor.with_machine));
    let asked = plan.accuracy.map(um).filter(|y| drawable(*y));
    let most_x = points.iter().chain(&random).map(|(x, _)| *x).fold(1.0, f64::max);
    // What few poses reach would stretch the axis so that nothing is seen of the rest.
    let usual = points.get(points.len() / 4).map_or(1.0, |(_, y)| 1.6 * y);
    let most_y = random.iter().map(|(_, y)| 1.1 * y).chain(asked.map(|y| 1.1 * y)).fold(usual, f64::max);
    let label = "Predicted accuracy against the number of poses";
    svg("accuracy against number", label, (WIDTH, PANEL + 20), |area| {
        let (body, _) = area.split_vertically(px(PANEL));
        let x = 0.0..1.04 * most_x;
        let title = "standard deviation, \u{b5}m";
        let axes = Axes { top: 6, right: 12, room: (24, 62), title, ..Axes::default() };
        let chart = axes.draw(&body, x.clone(), 0.0..most_y)?;
        for (value, look) in [(Some(floor), &LOOKS[4]), (asked, &LOOKS[3])] {
            if let Some(value) = value.filter(|value| *value <= most_y) {
                curve_of(&chart, look, vec![(x.start, value), (x.end, value)])?;
            }
        }
        let below =
            |all: &[(f64, f64)]| all.iter().copied().filter(|(_, y)| *y <= most_y).collect::<Vec<_>>();
        let inside = below(&points);
        for (points, look) in [(&inside, &LOOKS[2]), (&below(&calibration), &LOOKS[1])] {
            curve_of(&chart, look, points.clone())?;
            markers(&chart, look, points)?;
        }
        markers(&chart, &LOOKS[0], &[random, random_calibration].concat())?;
        if let Some(at) = plan.growth.knee.and_then(|knee| inside.iter().find(|(x, _)| *x == knee as f64)) {
            chart.plotting_area().draw(&Circle::new(*at, px(8), ink(3)))?;
        }
        foot(area, "poses")
    })
}

/// Candidates, region, poses and trackers in three views, m.
pub(super) fn places(plan: &PosePlan) -> Result<String, ReportError> {
    let step = plan.places.len().div_ceil(DOTS).max(1);
    let candidates: Vec<&Vector3<f64>> = plan.places.iter().step_by(step).collect();
    let all = || {
        let chosen = plan.poses.iter().map(|own| &own.target);
        candidates.iter().copied().chain(&plan.region_places).chain(chosen).chain(&plan.trackers)
    };
    svg("places of the poses", "Where the poses are, in three views", (WIDTH, 302), |area| {
        three_views(area, |panel, (across, up)| {
            let range = |axis: usize| padded(&finite_range(all().map(|place| place[axis])));
            let chart = place_axes(panel, range(across), range(up))?;
            let plot = chart.plotting_area();
            let at = |place: &Vector3<f64>| (place[across], place[up]);
            for place in &candidates {
                plot.draw(&Circle::new(at(place), 1, GRID.stroke_width(3)))?;
            }
            for place in &plan.region_places {
                plot.draw(&Circle::new(at(place), 3, LOOKS[4].light.stroke_width(2)))?;
            }
            for own in &plan.poses {
                plot.draw(&marker(&LOOKS[2], at(&own.target), 6))?;
            }
            for place in &plan.trackers {
                plot.draw(&marker(&LOOKS[0], at(place), 9))?;
            }
            Ok(())
        })
    })
}

/// Limits, region and planned values of every commanded joint, as parts of its range.
pub(super) fn joints(plan: &PosePlan) -> Result<String, ReportError> {
    const ROW: i32 = 34;
    const NAME: i32 = 176;
    let rows: Vec<usize> = (0..plan.links.len()).filter(|joint| plan.commanded[*joint]).collect();
    let height = ROW * i32::try_from(rows.len()).unwrap_or(1);
    svg("joint ranges", "Joint ranges that the poses cover", (WIDTH, height + 44), |area| {
        let (body, _) = area.split_vertically(px(height + 24));
        let count = rows.len() as f64;
        let mut chart = ChartBuilder::on(&body)
            .margin_right(px(16))
            .margin_left(px(NAME))
            .x_label_area_size(px(24))
            .build_cartesian_2d(-0.02..1.02, 0.0..count)?;
        values_below(&mut chart, body.dim_in_pixel().0, 3..=6)?;
        let plot = chart.plotting_area();
        for (row, joint) in rows.iter().enumerate() {
            let y = count - row as f64 - 0.5;
            let (name, kind, limits) = &plan.links[*joint];
            let values: Vec<f64> = plan.poses.iter().map(|own| own.joints[*joint]).collect();
            let region = plan.region_ranges.get(*joint).copied().unwrap_or(*limits);
            let whole = if limits.iter().all(|limit| limit.is_finite()) {
                *limits
            } else {
                let all = finite_range(values.iter().copied().chain(region));
                [all.start, all.end]
            };
            let part = |value: f64| ((value - whole[0]) / (whole[1] - whole[0]).max(1e-9)).clamp(-0.02, 1.02);
            plot.draw(&PathElement::new(vec![(0.0, y), (1.0, y)], GRID.stroke_width(6)))?;
            let ends = region.map(part);
            plot.draw(&PathElement::new(vec![(ends[0], y), (ends[1], y)], LOOKS[4].light.stroke_width(6)))?;
            for value in values {
                let x = part(value);
                plot.draw(&PathElement::new(
                    vec![(x, y - 0.22), (x, y + 0.22)],
                    LOOKS[2].light.stroke_width(3),
                ))?;
            }
            let row = plot.map_coordinate(&(0.0, y)).1 - body.get_base_pixel().1;
            text_at(&body, &label(name, *kind, whole), (px(2), row), (HPos::Left, VPos::Center))?;
        }
        foot(area, "part of the joint's range")
    })
}

fn label(name: &str, kind: JointKind, [low, high]: [f64; 2]) -> String {
    let short: String = name.chars().take(12).collect();
    match kind {
        JointKind::Prismatic => format!("{short}, {:.0}\u{2026}{:.0} mm", 1e3 * low, 1e3 * high),
        JointKind::Revolute => {
            format!("{short}, {:.0}\u{2026}{:.0}\u{b0}", low.to_degrees(), high.to_degrees())
        }
    }
    .replace('-', "\u{2212}")
}
