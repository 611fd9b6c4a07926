//! `iso9283.html`: one file that opens anywhere, without scripts and without anything fetched.

use maud::{Markup, PreEscaped, html};

use super::figure::{accuracy_figure, look_of, scatter_figure};
use super::{ANGLES, RECALLED, pose_name, pose_names, sentences, title_of};
use crate::pipeline::{AccuracyAgainst, Iso9283Outcome, Iso9283Pose, Iso9283Target};
use crate::report::files::ReportError;
use crate::report::markup::{key, page};
use crate::report::words::{counted, number};
use calibrig_estimation::evaluation::iso9283::{OrientationAccuracy, OrientationRepeatability};

/// The page of a test.
pub fn iso9283_html(outcome: &Iso9283Outcome) -> Result<String, ReportError> {
    let mut targets = Vec::new();
    for target in &outcome.targets {
        targets.push(target_section(outcome, target)?);
    }
    let body = html! {
        (header(outcome))
        main {
            @if !outcome.doubts.is_empty() {
                aside.doubt role="note" {
                    strong { "Doubtful. " }
                    @for doubt in &outcome.doubts { (doubt) ". " }
                }
            }
            section #summary {
                h2 { "Summary" }
                ul { @for line in sentences(outcome) { li { (line) } } }
                @if !outcome.remarks.is_empty() {
                    ul.warnings { @for line in &outcome.remarks { li { (line) } } }
                }
                p.note { (RECALLED) }
            }
            @for target in &targets { (target) }
            (combined_section(outcome))
        }
    };
    Ok(page(&format!("ISO 9283: {}", outcome.robot), &body))
}

fn header(outcome: &Iso9283Outcome) -> Markup {
    html! {
        header {
            p.eyebrow { "Pose accuracy and repeatability, ISO 9283" }
            h1 { (outcome.robot) }
            dl.facts {
                div { dt { "Input" } dd { (outcome.input.kind) " " (outcome.input.name) } }
                @if let Some(seed) = outcome.input.seed { div { dt { "Seed" } dd { (seed) } } }
                div { dt { "Cycles" } dd { (outcome.cycles) } }
                @if let Some(cube) = outcome.cube {
                    div { dt { "Cube" } dd { (format!("{:.0}", 1e3 * cube.edge)) " mm, plane " (cube.plane.key()) } }
                    div { dt { "Middle in the base frame" } dd {
                        (format!("{:.3}, {:.3}, {:.3} m", cube.centre.x, cube.centre.y, cube.centre.z))
                    } }
                }
                div { dt { "Software" } dd { "calibrig " (env!("CARGO_PKG_VERSION")) } }
                div.wide { dt { "SHA-256 of the input" } dd.hash { (outcome.input.sha256) } }
            }
        }
    }
}

fn target_section(outcome: &Iso9283Outcome, target: &Iso9283Target) -> Result<Markup, ReportError> {
    let scatter = scatter_figure(outcome, target)?;
    let accuracy = if target.rows.is_empty() { None } else { Some(accuracy_figure(outcome, target)?) };
    let turns: Option<Vec<_>> = target.poses.iter().map(|pose| pose.orientation).collect();
    let axis = |axis: usize| move |pose: &Iso9283Pose| mm(pose.position.axis_sigma[axis]);
    Ok(html! {
        section {
            h2 { "Target " (target.name) }
            h3 { "Repeatability" }
            div.scroll { table {
                (heads(outcome, target))
                tbody {
                    (line(target, "RP, mm", |pose| mm(pose.position.repeatability)))
                    (line(target, "95 % interval, from", |pose| mm(pose.position.interval[0])))
                    (line(target, "to", |pose| mm(pose.position.interval[1])))
                    (line(target, "mean distance", |pose| mm(pose.position.mean_distance)))
                    (line(target, "its standard deviation", |pose| mm(pose.position.distance_sigma)))
                    (line(target, &format!("sigma x ({})", outcome.frame), axis(0)))
                    (line(target, "sigma y", axis(1)))
                    (line(target, "sigma z", axis(2)))
                    @if target.poses.iter().all(|pose| pose.stated_sigma.is_some()) {
                        (line(target, "stated noise of a reading (3D)", |pose| pose.stated_sigma.map_or_else(String::new, mm)))
                    }
                    @if let Some(turns) = &turns { (turn_lines(turns)) }
                }
            } }
            p.note { "RP is the mean distance from the barycentre plus three standard deviations of that distance; the scatter of the readings is part of it. The 95 % interval is for the RP of endlessly many cycles, if the scatter is normal." }
            figure {
                div.scroll { (PreEscaped(scatter)) }
                figcaption {
                    "Attained positions about the barycentre of " (counted(outcome.cycles, "cycle")) ", in three views of the " (outcome.frame)
                    " frame. The circle has the radius RP."
                    @if target.poses.len() > 5 { " The first five poses." }
                }
            }
            @if let Some(accuracy) = accuracy {
                h3 { "Accuracy" }
                figure {
                    div.legend { @for row in &target.rows { span { (key(&look_of(row))) (row.title) } } }
                    div.scroll { (PreEscaped(accuracy)) }
                    figcaption { "Distance of the barycentre from where each robot predicts the target at the command." }
                }
                div.scroll { table {
                    (heads(outcome, target))
                    @for row in &target.rows { (accuracy_lines(row)) }
                } }
                p.note {
                    "AP in mm: attained minus predicted position. \u{201c}Known within\u{201d}: the 95 % radius about the barycentre for endlessly many cycles. Errors that all cycles share, such as the tracker's place, are not in it. "
                    "\u{201c}Expected\u{201d} holds them: the RMS length of the 3-D error that the robot's estimate states there. "
                    "The nominal robot states no error of its own; by nests only the tracker's place and the target's offset are counted."
                }
                ul { @for row in &target.rows { li { (row.title) ": " (row.registration) } } }
            }
        }
    })
}

fn heads(outcome: &Iso9283Outcome, target: &Iso9283Target) -> Markup {
    html! {
        thead { tr { th {} @for pose in &target.poses { th { (pose_name(outcome, pose.pose)) } } } }
    }
}

fn line(target: &Iso9283Target, title: &str, cell: impl Fn(&Iso9283Pose) -> String) -> Markup {
    html! { tr { th scope="row" { (title) } @for pose in &target.poses { td { (cell(pose)) } } } }
}

fn accuracy_lines(row: &AccuracyAgainst) -> Markup {
    html! {
        tbody {
            tr { th scope="row" { strong { (row.title) } } @for ap in &row.position { td { strong { (mm(ap.distance)) } } } }
            @for (axis, name) in ["x", "y", "z"].iter().enumerate() {
                tr { th scope="row" { "AP " (name) } @for ap in &row.position { td { (mm(ap.error[axis])) } } }
            }
            tr { th scope="row" { "known within" } @for ap in &row.position { td { (mm(ap.radius)) } } }
            @if row.expected_sigma.iter().any(Option::is_some) {
                tr { th scope="row" { "expected, sigma 3D" } @for sigma in &row.expected_sigma { td { @if let Some(sigma) = sigma { (mm(*sigma)) } } } }
            }
            @if !row.orientation.is_empty() { (turn_accuracy_lines(&row.orientation)) }
        }
    }
}

fn mm(metres: f64) -> String {
    number(1e3 * metres, 4)
}

fn milli(value: f64) -> String {
    number(1e3 * value, 4)
}

fn turn_lines(turns: &[OrientationRepeatability]) -> Markup {
    html! {
        @for (axis, name) in ANGLES.iter().enumerate() {
            tr { th scope="row" { "RP " (name) ", \u{b1} mrad" } @for turn in turns { td { (milli(turn.repeatability[axis])) } } }
        }
    }
}

fn turn_accuracy_lines(turns: &[OrientationAccuracy]) -> Markup {
    html! {
        @for (axis, name) in ANGLES.iter().enumerate() {
            tr { th scope="row" { "AP " (name) ", mrad" } @for turn in turns { td { (milli(turn.error[axis])) } } }
        }
    }
}

fn combined_section(outcome: &Iso9283Outcome) -> Markup {
    let Some(combined) = &outcome.combined else { return html! {} };
    html! {
        section {
            h2 { "Orientation from targets together" }
            p { "Targets " (combined.targets.join(", ")) ": the turn that brings the points of each cycle nearest to where they should be." }
            div.scroll { table {
                thead { tr { th {} @for name in pose_names(outcome) { th { (name) } } } }
                tbody { (turn_lines(&combined.repeatability)) }
                @for (key, turns) in &combined.accuracy {
                    tbody {
                        tr { th scope="row" colspan=(turns.len() + 1) { strong { (title_of(outcome, key)) } } }
                        (turn_accuracy_lines(turns))
                    }
                }
            } }
        }
    }
}
