//! Pose accuracy and repeatability (ISO 9283): tables on the terminal, `iso9283.json` and `iso9283.html`.

mod figure;
mod json;
mod page;

pub use json::{
    ISO9283_SCHEMA, JsonCombined, JsonCube, JsonIso9283, JsonIsoAccuracy, JsonIsoOrientation, JsonIsoPose,
    JsonIsoRow, JsonIsoTarget, JsonIsoTurn, json_iso9283,
};
pub use page::iso9283_html;

use std::path::Path;

use nalgebra::Vector3;

use crate::pipeline::{Iso9283Outcome, Iso9283Pose, Iso9283Target};
use crate::report::document::json_text;
use crate::report::files::{ReportError, write_all};
use crate::report::terminal::{Ink, Style, TITLE, columns, wrap};
use crate::report::words::percent;
use crate::report::words::{counted, length_words, printable, significant};
use calibrig_estimation::evaluation::iso9283::{OrientationAccuracy, OrientationRepeatability};

/// Width of a column of numbers.
const CELL: usize = 11;
/// What no row is about.
const RECALLED: &str =
    "AP and RP as ISO 9283:1998 (7.2) is commonly quoted; its text was not at hand. Intervals: 95 %, ours.";

/// The text of `iso9283.json`.
pub fn iso9283_json_text(outcome: &Iso9283Outcome) -> Result<String, ReportError> {
    json_text(&json_iso9283(outcome))
}

/// Writes `iso9283.html` and `iso9283.json` to `folder`, which exists. Both are complete before one takes its name.
pub fn write_iso9283(outcome: &Iso9283Outcome, folder: &Path) -> Result<(), ReportError> {
    let (page, document) = (iso9283_html(outcome)?, iso9283_json_text(outcome)?);
    write_all(folder, &[("iso9283.html", page), ("iso9283.json", document)])
}

/// P1 to P5 of a cube; of a file, its own numbers.
fn pose_name(outcome: &Iso9283Outcome, pose: u32) -> String {
    if outcome.cube.is_some() { format!("P{pose}") } else { format!("pose {pose}") }
}

/// "30 cycles at 5 poses of the cube of 400 mm".
fn title(outcome: &Iso9283Outcome) -> String {
    let poses = outcome.targets.iter().map(|target| target.poses.len()).max().unwrap_or(0);
    let of_cube = outcome.cube.map_or_else(String::new, |cube| {
        let [x, y, z] = [cube.centre.x, cube.centre.y, cube.centre.z].map(|v| format!("{v:.3}"));
        format!(", plane {} of a cube of {:.0} mm about ({x}, {y}, {z}) m", cube.plane.key(), 1e3 * cube.edge)
    });
    format!(
        "ISO 9283, {}: {} at {}{of_cube}",
        outcome.robot,
        counted(outcome.cycles, "cycle"),
        counted(poses, "pose")
    )
}

/// Millimetres to a tenth of a micrometre; of a failed fit in fewer digits.
fn mm(metres: f64) -> String {
    let mm = 1e3 * metres;
    let text = if mm.is_finite() && mm.abs() < 9999.0 { format!("{mm:.4}") } else { format!("{mm:.0e}") };
    // What rounds to zero has no sign.
    if text == "-0.0000" { "0.0000".to_owned() } else { text }
}

/// Of a target's poses the one with the largest RP.
fn worst(target: &Iso9283Target) -> Option<&Iso9283Pose> {
    target.poses.iter().max_by(|a, b| a.position.repeatability.total_cmp(&b.position.repeatability))
}

/// What the tables say, in sentences.
fn sentences(outcome: &Iso9283Outcome) -> Vec<String> {
    let mut lines = Vec::new();
    for target in &outcome.targets {
        let of = if outcome.targets.len() > 1 { format!("{}: ", target.name) } else { String::new() };
        if let Some(pose) = worst(target) {
            let [low, high] = pose.position.interval;
            lines.push(format!(
                "{of}repeatability RP is {} at worst ({}); 95 % interval for endlessly many cycles: {} to {}",
                length_words(pose.position.repeatability),
                pose_name(outcome, pose.pose),
                length_words(low),
                length_words(high)
            ));
        }
        if let Some(over) = target.over_stated {
            let noise = format!("{of}the readings' stated noise");
            lines.push(if over.ratio > over.band.1 {
                let share = percent(1.0 / over.ratio);
                format!("{noise} makes {share} of the variance of that scatter, the machine the rest")
            } else if over.ratio < over.band.0 {
                let ratio = significant(over.ratio.sqrt());
                format!(
                    "{noise} is stated too large: the scatter seen is only {ratio} times as large; state less"
                )
            } else {
                format!("{noise} explains all of that scatter: the machine's own cannot be seen beside it")
            });
        }
        let worst = |row: &crate::pipeline::AccuracyAgainst| {
            row.position.iter().map(|ap| ap.distance).fold(0.0, f64::max)
        };
        if let (Some(first), Some(best)) =
            (target.rows.first(), target.rows.iter().min_by(|a, b| worst(a).total_cmp(&worst(b))))
        {
            lines.push(format!("{of}accuracy AP at worst: {} ({})", length_words(worst(first)), first.title));
            if best.key != first.key {
                lines.push(format!("{of}and best: {} ({})", length_words(worst(best)), best.title));
            }
        }
    }
    lines
}

fn row(title: &str, cells: &[String]) -> String {
    columns(title, cells, CELL)
}

/// Poses a table has room for beside each other.
const COLUMNS: usize = 6;

/// The tables in mm and mrad; at most 100 columns wide.
pub fn render_iso9283(outcome: &Iso9283Outcome, style: Style) -> String {
    let mut lines: Vec<String> = style.told(Ink::Heading, &title(outcome), "    ");
    for target in &outcome.targets {
        lines.push(String::new());
        lines.extend(target_lines(outcome, target, style));
    }
    if let Some(combined) = &outcome.combined {
        lines.push(String::new());
        let words = format!("Orientation from targets {} together, mrad", combined.targets.join(", "));
        lines.extend(style.told(Ink::Heading, &words, "    "));
        let names: Vec<String> = pose_names(outcome);
        for place in chunks(names.len()) {
            lines.push(row("", &names[place.clone()]));
            lines.extend(turn_rows(&combined.repeatability[place.clone()]));
            for (key, accuracy) in &combined.accuracy {
                lines.extend(turn_accuracy_rows(title_of(outcome, key), &accuracy[place.clone()]));
            }
        }
    }
    lines.push(String::new());
    lines.extend(sentences(outcome).iter().flat_map(|words| wrap(&printable(words), "    ")));
    let note = |ink, words: &str| -> Vec<String> { style.told(ink, words, "    ") };
    lines.extend(outcome.remarks.iter().flat_map(|words| note(Ink::Warning, words)));
    lines.extend(note(Ink::Dim, RECALLED));
    lines.push(String::new());
    lines.join("\n")
}

fn title_of<'a>(outcome: &'a Iso9283Outcome, key: &str) -> &'a str {
    let rows = outcome.targets.iter().flat_map(|target| &target.rows);
    rows.into_iter().find(|row| row.key == key).map_or("", |row| &row.title)
}

fn pose_names(outcome: &Iso9283Outcome) -> Vec<String> {
    let first = outcome.targets.first().map_or(&[][..], |target| &target.poses);
    first.iter().map(|pose| pose_name(outcome, pose.pose)).collect()
}

fn chunks(count: usize) -> impl Iterator<Item = std::ops::Range<usize>> {
    (0..count).step_by(COLUMNS).map(move |start| start..(start + COLUMNS).min(count))
}

fn target_lines(outcome: &Iso9283Outcome, target: &Iso9283Target, style: Style) -> Vec<String> {
    let mut lines = Vec::new();
    let heading = format!("Target {}: repeatability and accuracy of the position, mm", target.name);
    lines.push(style.paint(Ink::Heading, &printable(&heading)));
    for place in chunks(target.poses.len()) {
        let poses = &target.poses[place.clone()];
        let cells = |of: &dyn Fn(&Iso9283Pose) -> String| poses.iter().map(of).collect::<Vec<_>>();
        let names = cells(&|pose| pose_name(outcome, pose.pose));
        lines.push(row("", &names));
        lines.push(style.paint(Ink::Dim, &"\u{2500}".repeat(TITLE + CELL * names.len())));
        lines.push(row("RP (mean l + 3 S_l)", &cells(&|pose| mm(pose.position.repeatability))));
        lines.push(row("  95 % interval, from", &cells(&|pose| mm(pose.position.interval[0]))));
        lines.push(row("  to", &cells(&|pose| mm(pose.position.interval[1]))));
        lines.push(row("  mean distance l", &cells(&|pose| mm(pose.position.mean_distance))));
        lines.push(row("  S_l", &cells(&|pose| mm(pose.position.distance_sigma))));
        for (axis, name) in ["x", "y", "z"].iter().enumerate() {
            let words = format!("  sigma {name} ({})", outcome.frame);
            lines.push(row(&words, &cells(&|pose| mm(pose.position.axis_sigma[axis]))));
        }
        if poses.iter().all(|pose| pose.stated_sigma.is_some()) {
            let stated = |pose: &Iso9283Pose| pose.stated_sigma.map_or_else(String::new, mm);
            lines.push(row("  stated noise of a reading (3D)", &cells(&stated)));
        }
        let turns: Option<Vec<_>> = poses.iter().map(|pose| pose.orientation).collect();
        lines.extend(turns.iter().flat_map(|turns| turn_rows(turns)));
        if !target.rows.is_empty() {
            lines.push(row("AP against", &[]));
        }
        for against in &target.rows {
            let accuracy = &against.position[place.clone()];
            lines.push(row(&against.title, &accuracy.iter().map(|ap| mm(ap.distance)).collect::<Vec<_>>()));
            for (axis, name) in ["x", "y", "z"].iter().enumerate() {
                let along: Vec<_> = accuracy.iter().map(|ap| mm(ap.error[axis])).collect();
                lines.push(row(&format!("  AP {name}"), &along));
            }
            let radius: Vec<_> = accuracy.iter().map(|ap| mm(ap.radius)).collect();
            lines.push(row("  known within", &radius));
            let expected: Option<Vec<_>> = against
                .expected_sigma
                .get(place.clone())
                .and_then(|all| all.iter().map(|sigma| sigma.map(mm)).collect());
            lines.extend(expected.map(|cells| row("  expected by it (sigma 3D)", &cells)));
            if let Some(turns) = against.orientation.get(place.clone()).filter(|turns| !turns.is_empty()) {
                lines.extend(turn_accuracy_rows("", turns));
            }
        }
        lines.push(style.paint(Ink::Dim, &"\u{2500}".repeat(TITLE + CELL * names.len())));
    }
    for against in &target.rows {
        let words = format!("{}: {}", against.title, against.registration);
        lines.extend(style.told(Ink::Dim, &words, "    "));
    }
    lines
}

const ANGLES: [&str; 3] = ["a, about x", "b, about y", "c, about z"];

fn milli(of: &[Vector3<f64>], axis: usize) -> Vec<String> {
    of.iter().map(|value| format!("{:.4}", 1e3 * value[axis])).collect()
}

fn turn_rows(turns: &[OrientationRepeatability]) -> Vec<String> {
    let values: Vec<_> = turns.iter().map(|turn| turn.repeatability).collect();
    let line = |(axis, name): (usize, &&str)| row(&format!("RP {name}, +- mrad"), &milli(&values, axis));
    ANGLES.iter().enumerate().map(line).collect()
}

fn turn_accuracy_rows(title: &str, turns: &[OrientationAccuracy]) -> Vec<String> {
    let values: Vec<_> = turns.iter().map(|turn| turn.error).collect();
    let line = |(axis, name): (usize, &&str)| row(&format!("  AP {name}, mrad"), &milli(&values, axis));
    let head = (!title.is_empty()).then(|| row(title, &[]));
    head.into_iter().chain(ANGLES.iter().enumerate().map(line)).collect()
}
