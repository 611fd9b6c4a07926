//! Accuracy against number, where the poses are, and which joint ranges they cover.

use std::ops::Range;

use plotters::element::DashedPathElement;
use plotters::prelude::*;

use super::super::plots::{
    Area, Chart, Drawn, GRID, INK, LOOKS, SCALE, VIEWS, WIDTH, centred, drawable, finite_range, foot, ink,
    marker, padded, place_axes, px, svg, text_style, tick, values_below,
};
use crate::pose_plan::PosePlan;
use crate::report::ReportError;
use calibrig_model::JointKind;
use calibrig_model::nalgebra::Vector3;

/// Candidates that are drawn; more would be a blot.
const DOTS: usize = 600;

/// Standard deviation over the region against the number of poses.
pub(super) fn curve(plan: &PosePlan) -> Result<String, ReportError> {
    const PANEL: i32 = 270;
    let um = |metres: f64| 1e6 * metres;
    let of =
        |point: &calibrig_estimation::planning::GrowthPoint| um(plan.figure.of(&point.accuracy.with_machine));
    let points: Vec<(f64, f64)> = plan
        .growth
        .points
        .iter()
        .map(|point| (point.count as f64, of(point)))
        .filter(|(_, y)| drawable(*y))
        .collect();
    let own = |point: &calibrig_estimation::planning::GrowthPoint| {
        um(plan.figure.of(&point.accuracy.of_parameters))
    };
    let calibration: Vec<(f64, f64)> = plan
        .growth
        .points
        .iter()
        .map(|point| (point.count as f64, own(point)))
        .filter(|(_, y)| drawable(*y))
        .collect();
    let floor = um(plan.figure.of(&plan.growth.floor.with_machine));
    let random: Vec<(f64, f64)> = plan
        .random
        .iter()
        .map(|drawn| (drawn.poses as f64, um(drawn.medians()[0])))
        .filter(|(_, y)| drawable(*y))
        .collect();
    let random_calibration: Vec<(f64, f64)> = plan
        .random
        .iter()
        .map(|drawn| (drawn.poses as f64, um(drawn.medians()[1])))
        .filter(|(_, y)| drawable(*y))
        .collect();
    let asked = plan.accuracy.map(um).filter(|y| drawable(*y));
    let most_x = points.iter().chain(&random).map(|(x, _)| *x).fold(1.0, f64::max);
    // What few poses reach would stretch the axis so that nothing is seen of the rest.
    let usual = points.get(points.len() / 4).map_or(1.0, |(_, y)| 1.6 * y);
    let most_y = random.iter().map(|(_, y)| 1.1 * y).chain(asked.map(|y| 1.1 * y)).fold(usual, f64::max);
    svg(
        "accuracy against number",
        "Predicted accuracy against the number of poses",
        (WIDTH, PANEL + 20),
        |area| {
            let (body, _) = area.split_vertically(px(PANEL));
            let (x, y) = (0.0..1.04 * most_x, 0.0..most_y);
            let chart = axes(&body, x.clone(), y)?;
            let plot = chart.plotting_area();
            let level = |value: f64, look: usize| -> Drawn {
                let line = vec![(x.start, value), (x.end, value)];
                let (dash, gap) = LOOKS[look].dash.unwrap_or((8, 4));
                let scale = SCALE.unsigned_abs();
                plot.draw(&DashedPathElement::new(
                    line,
                    dash * scale,
                    gap * scale,
                    LOOKS[look].light.stroke_width(3),
                ))
            };
            if drawable(floor) && floor <= most_y {
                level(floor, 4)?;
            }
            if let Some(asked) = asked {
                level(asked, 3)?;
            }
            let inside: Vec<_> = points.iter().copied().filter(|(_, y)| *y <= most_y).collect();
            plot.draw(&PathElement::new(inside.clone(), LOOKS[2].light.stroke_width(4)))?;
            for at in &inside {
                plot.draw(&marker(&LOOKS[2], *at, 6))?;
            }
            let beside: Vec<_> = calibration.iter().copied().filter(|(_, y)| *y <= most_y).collect();
            let (dash, gap) = LOOKS[1].dash.unwrap_or((8, 4));
            let scale = SCALE.unsigned_abs();
            plot.draw(&DashedPathElement::new(
                beside.clone(),
                dash * scale,
                gap * scale,
                LOOKS[1].light.stroke_width(4),
            ))?;
            for at in &beside {
                plot.draw(&marker(&LOOKS[1], *at, 6))?;
            }
            for at in random.iter().chain(&random_calibration) {
                plot.draw(&marker(&LOOKS[0], *at, 7))?;
            }
            if let Some((x, y)) =
                plan.growth.knee.and_then(|knee| inside.iter().find(|(x, _)| *x == knee as f64))
            {
                plot.draw(&Circle::new((*x, *y), px(8), ink(3)))?;
            }
            foot(area, "poses")
        },
    )
}

/// The axes of the curve.
fn axes<'a, 'b>(area: &'b Area<'a>, x: Range<f64>, y: Range<f64>) -> Drawn<Chart<'a, 'b>> {
    let mut chart = ChartBuilder::on(area)
        .margin_top(px(6))
        .margin_right(px(12))
        .x_label_area_size(px(24))
        .y_label_area_size(px(62))
        .build_cartesian_2d(x, y)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .x_labels(10)
        .y_labels(6)
        .bold_line_style(GRID.stroke_width(2))
        .light_line_style(TRANSPARENT)
        .axis_style(INK.mix(0.6).stroke_width(2))
        .label_style(text_style())
        .axis_desc_style(text_style())
        .y_desc("standard deviation, \u{b5}m")
        .x_label_formatter(&|v| tick(*v))
        .y_label_formatter(&|v| tick(*v))
        .draw()?;
    Ok(chart)
}

/// Candidates, region, poses and trackers in three views, m.
pub(super) fn places(plan: &PosePlan) -> Result<String, ReportError> {
    const TITLE: i32 = 22;
    const PANEL: i32 = 280;
    let step = plan.places.len().div_ceil(DOTS).max(1);
    let candidates: Vec<&Vector3<f64>> = plan.places.iter().step_by(step).collect();
    let all = || {
        let chosen = plan.poses.iter().map(|own| &own.target);
        candidates.iter().copied().chain(&plan.region_places).chain(chosen).chain(&plan.trackers)
    };
    svg("places of the poses", "Where the poses are, in three views", (WIDTH, TITLE + PANEL), |area| {
        for (panel, (title, across, up)) in area.split_evenly((1, 3)).iter().zip(VIEWS) {
            let (head, body) = panel.split_vertically(px(TITLE));
            centred(&head, &format!("{title}, m"))?;
            let range = |axis: usize| padded(&finite_range(all().map(|place| place[axis])));
            let chart = place_axes(&body, range(across), range(up))?;
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
        }
        Ok(())
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
            name_at(&body, plot.map_coordinate(&(0.0, y)).1, &label(name, *kind, whole))?;
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

fn name_at(area: &Area, row: i32, text: &str) -> Drawn {
    let style = text_style().pos(plotters::style::text_anchor::Pos::new(
        plotters::style::text_anchor::HPos::Left,
        plotters::style::text_anchor::VPos::Center,
    ));
    let top = area.get_base_pixel().1;
    area.draw(&Text::new(text.to_owned(), (px(2), row - top), style))
}
