//! Attained positions about their barycentres, and accuracy pose by pose.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};

use super::pose_name;
use crate::pipeline::{AccuracyAgainst, Iso9283Outcome, Iso9283Target};
use crate::report::files::ReportError;
use crate::report::plots::{
    Area, Axes, Drawn, Grid, LOOKS, Look, Marker, VIEWS, WIDTH, centred, drawable, foot, ink, largest, look,
    marker, px, svg, text_at,
};
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
    let axes = Axes { top: 3, right: 6, room: (20, 46), labels: (3, 3), grid: Grid::Both, title: label };
    let chart = axes.draw(area, -reach..reach, -reach..reach)?;
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
        let decades: Vec<f64> =
            (0..64).map(|step| low + f64::from(step)).take_while(|at| *at <= high).collect();
        let ticks: Vec<f64> = decades.iter().map(|at| 10.0_f64.powf(*at)).collect();
        let axes =
            Axes { top: 6, room: (22, 62), labels: (0, 0), title: "AP, mm (logarithmic)", ..Axes::default() };
        let chart = axes.draw_log(&body, 0.0..columns, low..high, &ticks)?;
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
            let (left, top) = body.get_base_pixel();
            let place = (x - left, y - top + px(4));
            text_at(&body, &pose_name(outcome, pose.pose), place, (HPos::Center, VPos::Top))?;
        }
        foot(area, "pose")
    })
}
