//! Attained positions about their barycentres, and accuracy pose by pose.

use plotters::prelude::*;

use super::super::plots::{
    Area, Drawn, GRID, INK, LOOKS, Look, Marker, VIEWS, WIDTH, centred, drawable, foot, ink, largest, look,
    marker, px, svg, text_style, tick,
};
use super::pose_name;
use crate::pipeline::{AccuracyAgainst, Iso9283Outcome, Iso9283Target};
use crate::report::ReportError;
use calibrig_estimation::identification::Mode;

const TITLE: i32 = 22;
const FOOT: i32 = 20;
/// Poses in one figure; more are in the tables.
const DRAWN: usize = 5;

/// Deviations from the barycentre, a column a pose and a row a view, µm, with the circle of RP.
pub(super) fn scatter_figure(
    outcome: &Iso9283Outcome,
    target: &Iso9283Target,
) -> Result<String, ReportError> {
    const PANEL: i32 = 178;
    let poses = &target.poses[..target.poses.len().min(DRAWN)];
    let sizes = poses.iter().flat_map(|pose| {
        let deviations = pose.deviations.iter().flat_map(|d| d.iter().copied());
        deviations.chain([pose.position.repeatability])
    });
    let reach = 1.1 * largest(sizes.map(|size| 1e6 * size));
    let columns = poses.len().max(1);
    svg("repeatability", "Attained positions about their barycentres", (WIDTH, TITLE + 3 * PANEL), |area| {
        let (heads, body) = area.split_vertically(px(TITLE));
        for (head, pose) in heads.split_evenly((1, columns)).iter().zip(poses) {
            centred(head, &format!("{}, \u{b5}m", pose_name(outcome, pose.pose)))?;
        }
        let panels = body.split_evenly((3, columns));
        for (row, (view, across, up)) in VIEWS.iter().enumerate() {
            for (column, pose) in poses.iter().enumerate() {
                let points: Vec<_> =
                    pose.deviations.iter().map(|d| (1e6 * d[*across], 1e6 * d[*up])).collect();
                let label = if column == 0 { view } else { "" };
                panel(
                    &panels[row * columns + column],
                    label,
                    &points,
                    1e6 * pose.position.repeatability,
                    reach,
                )?;
            }
        }
        Ok(())
    })
}

fn panel(area: &Area, label: &str, points: &[(f64, f64)], rp: f64, reach: f64) -> Drawn {
    let mut chart = ChartBuilder::on(area)
        .margin_top(px(3))
        .margin_right(px(6))
        .x_label_area_size(px(20))
        .y_label_area_size(px(46))
        .build_cartesian_2d(-reach..reach, -reach..reach)?;
    chart
        .configure_mesh()
        .x_labels(3)
        .y_labels(3)
        .bold_line_style(GRID.stroke_width(2))
        .light_line_style(TRANSPARENT)
        .axis_style(INK.mix(0.6).stroke_width(2))
        .label_style(text_style())
        .axis_desc_style(text_style())
        .y_desc(label)
        .x_label_formatter(&|v| tick(*v))
        .y_label_formatter(&|v| tick(*v))
        .draw()?;
    let plot = chart.plotting_area();
    if drawable(rp) {
        let circle = (0..=72).map(|i| {
            let (sin, cos) = (f64::from(i) * std::f64::consts::PI / 36.0).sin_cos();
            (rp * cos, rp * sin)
        });
        plot.draw(&PathElement::new(circle.collect::<Vec<_>>(), ink(2)))?;
    }
    for point in points.iter().filter(|(x, y)| drawable(*x) && drawable(*y)) {
        plot.draw(&marker(&LOOKS[1], *point, 5))?;
    }
    Ok(())
}

/// How a row is drawn.
pub(super) fn look_of(against: &AccuracyAgainst) -> Look {
    // Of the same robot as without calibration, placed otherwise.
    let by_nests = Look { marker: Marker::Cross, ..LOOKS[0] };
    Mode::ALL.into_iter().find(|mode| mode.key() == against.key).map_or(by_nests, look)
}

/// AP of every row pose by pose, mm, on a logarithmic axis.
pub(super) fn accuracy_figure(
    outcome: &Iso9283Outcome,
    target: &Iso9283Target,
) -> Result<String, ReportError> {
    const PANEL: i32 = 220;
    let poses = &target.poses[..target.poses.len().min(DRAWN)];
    let sizes: Vec<f64> = target
        .rows
        .iter()
        .flat_map(|row| row.position.iter().take(DRAWN).map(|ap| 1e3 * ap.distance))
        .filter(|v| drawable(*v) && *v > 0.0)
        .collect();
    let low = sizes.iter().copied().fold(f64::INFINITY, f64::min).max(1e-6).log10().floor();
    let high = sizes.iter().copied().fold(0.0, f64::max).max(1e-5).log10().ceil().max(low + 1.0);
    svg("accuracy", "Pose accuracy pose by pose", (WIDTH, PANEL + FOOT), |area| {
        let (body, _) = area.split_vertically(px(PANEL));
        let columns = poses.len().max(1) as f64;
        let mut chart = ChartBuilder::on(&body)
            .margin_top(px(6))
            .margin_right(px(10))
            .x_label_area_size(px(22))
            .y_label_area_size(px(62))
            .build_cartesian_2d(0.0..columns, low..high)?;
        chart
            .configure_mesh()
            .disable_x_mesh()
            .x_labels(0)
            .y_labels(usize::try_from(tick_count(high - low)).unwrap_or(3))
            .bold_line_style(GRID.stroke_width(2))
            .light_line_style(TRANSPARENT)
            .axis_style(INK.mix(0.6).stroke_width(2))
            .label_style(text_style())
            .axis_desc_style(text_style())
            .y_desc("AP, mm (logarithmic)")
            .y_label_formatter(&|v| tick(10.0_f64.powf(*v)))
            .draw()?;
        let plot = chart.plotting_area();
        for (column, pose) in poses.iter().enumerate() {
            let at = column as f64;
            for (place, row) in target.rows.iter().enumerate() {
                let share = (place as f64 + 1.0) / (target.rows.len() as f64 + 1.0);
                let Some(ap) = row.position.get(column) else { continue };
                let value = 1e3 * ap.distance;
                if drawable(value) && value > 0.0 {
                    let y = value.log10().clamp(low, high);
                    plot.draw(&marker(&look_of(row), (at + share, y), 7))?;
                }
            }
            let (x, y) = plot.map_coordinate(&(at + 0.5, low));
            let style = text_style().pos(plotters::style::text_anchor::Pos::new(
                plotters::style::text_anchor::HPos::Center,
                plotters::style::text_anchor::VPos::Top,
            ));
            let (left, top) = body.get_base_pixel();
            body.draw(&Text::new(pose_name(outcome, pose.pose), (x - left, y - top + px(4)), style))?;
        }
        foot(area, "pose")
    })
}

/// A label a decade.
fn tick_count(decades: f64) -> i64 {
    (1..=12).find(|n| *n as f64 >= decades).unwrap_or(12) + 1
}
