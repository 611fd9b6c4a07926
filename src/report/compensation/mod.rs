//! Corrected commands: tables on the terminal, `compensated.csv`, `commands.csv`, `grid.csv`, `compensation.json` and `compensation.html`.

mod figure;
mod json;
mod page;
mod rows;

pub use json::{
    COMPENSATION_SCHEMA, JsonActuator, JsonAtLimit, JsonBeyond, JsonCorrected, JsonCorrectedCommands,
    JsonExcess, JsonGrid, JsonLengths, JsonTool, JsonUnreachable, json_compensation,
};
pub use page::compensation_html;
pub use rows::{commands_csv, compensated_csv, grid_csv};

use std::path::Path;

use crate::compensate::{Actuator, Compensation, Corrected, End, Lengths};
use crate::report::document::json_text;
use crate::report::files::{ReportError, write_all};
use crate::report::terminal::{Ink, Style, TITLE, columns, wrap};
use crate::report::words::{counted, length_words, printable};
use calibrig_estimation::compensation::CompensatedPoint;

/// Names of all files.
pub const COMPENSATION_FILES: [&str; 5] =
    ["compensated.csv", "commands.csv", "compensation.json", "compensation.html", "grid.csv"];

/// Width of a column of numbers.
const CELL: usize = 12;
/// Points that are listed one by one.
const LISTED: usize = 20;

/// The text of `compensation.json`.
pub fn compensation_json_text(made: &Compensation) -> Result<String, ReportError> {
    json_text(&json_compensation(made))
}

/// Writes the files to `folder`, which exists, and tells which: without goals no tables of them, without a grid no `grid.csv`. All are complete before one
/// takes its name.
pub fn write_compensation(made: &Compensation, folder: &Path) -> Result<Vec<&'static str>, ReportError> {
    let mut files = Vec::new();
    if made.asked > 0 {
        files.push(("compensated.csv", compensated_csv(made)?));
        files.push(("commands.csv", commands_csv(made)?));
    }
    files.push(("compensation.json", compensation_json_text(made)?));
    files.push(("compensation.html", compensation_html(made)?));
    if let Some(grid) = &made.grid {
        files.push(("grid.csv", grid_csv(grid)?));
    }
    write_all(folder, &files)?;
    Ok(files.into_iter().map(|(name, _)| name).collect())
}

/// "7 points (panel.csv) as a path", "a grid".
fn title(made: &Compensation) -> String {
    let what = match (made.asked, &made.grid) {
        (0, _) => "a grid of offsets".to_owned(),
        (count, grid) => {
            let way = if made.is_path { "a path of " } else { "" };
            let grid = if grid.is_some() { ", and a grid of offsets" } else { "" };
            format!("{way}{}{grid}", counted(count, "point"))
        }
    };
    format!("Compensation, {}, {}: {what}", made.robot, made.mode.title())
}

/// Millimetres to a hundredth of a micrometre.
fn mm(metres: f64) -> String {
    let mm = 1e3 * metres;
    let text = if mm.is_finite() && mm.abs() < 99_999.0 { format!("{mm:.4}") } else { format!("{mm:.1e}") };
    if text == "-0.0000" { "0.0000".to_owned() } else { text }
}

fn optional(value: Option<f64>, words: impl Fn(f64) -> String) -> String {
    value.map_or_else(|| "-".to_owned(), words)
}

fn row(title: &str, cells: &[String]) -> String {
    columns(title, cells, CELL)
}

/// What the tables say, in sentences.
fn sentences(made: &Compensation) -> Vec<String> {
    let mut lines = Vec::new();
    if made.asked > 0 {
        let met = made.count(|point| point.end == End::Met);
        let jumped = made.count(|point| point.end == End::Jumped);
        let jumps = if jumped > 0 { format!(", {jumped} with a jump") } else { String::new() };
        lines.push(format!("{} of {} are met{jumps}", met + jumped, counted(made.asked, "point")));
    }
    if let (Some(before), Some(left)) = (made.before(), made.left()) {
        lines.push(format!(
            "nominal commands would miss them by {} RMS and {} at worst; on the model, corrected ones miss them by {} at worst",
            length_words(before.rms),
            length_words(before.max),
            // Below, digits say nothing.
            if left.max < 1e-9 { "less than 0.001\u{a0}\u{b5}m".to_owned() } else { length_words(left.max) }
        ));
    }
    if let Some(sigmas) = made.sigmas() {
        let worst = made.points.iter().enumerate().filter_map(|(at, point)| Some((at, point.sigma()?)));
        let at = worst.max_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(at, _)| at);
        lines.push(format!(
            "RMS length of the 3-D error expected of the robot's mean position there: {} RMS, {} at worst, at point {}",
            length_words(sigmas.rms),
            length_words(sigmas.max),
            at + 1
        ));
    }
    if let Some(grid) = &made.grid {
        let out = grid.offsets.iter().filter(|offset| offset.is_none()).count();
        let reach = if out > 0 { format!("; {} out of reach", counted(out, "point")) } else { String::new() };
        lines.push(format!(
            "offsets of the grid, laid between its points, leave {} RMS and {} at worst of {} RMS and {} (at the middles of {}){reach}",
            length_words(grid.interpolated.rms),
            length_words(grid.interpolated.max),
            length_words(grid.uncorrected.rms),
            length_words(grid.uncorrected.max),
            counted(grid.interpolated.points, "cell")
        ));
        if grid.turned > 1e-7 {
            lines.push(format!(
                "they do not correct how the tool is turned: up to {:.3} mrad",
                1e3 * grid.turned
            ));
        }
    }
    lines
}

/// Marks of a point in words.
fn marks(made: &Compensation, point: &Corrected) -> Vec<String> {
    let mut marks = Vec::new();
    if point.end != End::Met {
        marks.push(point.end.key().to_owned());
    }
    if point.is_too_fast {
        marks.push("too fast".to_owned());
    }
    if point.is_untrusted {
        marks.push("unsure".to_owned());
    }
    if !point.beyond.is_empty() {
        marks.push("extrapolated".to_owned());
    }
    if point.wavers {
        marks.push("wavers".to_owned());
    }
    let limits = point.point.iter().flat_map(|found| &found.limits);
    marks.extend(limits.map(|limit| {
        let name = made.actuators.get(limit.joint).map_or("", |actuator| actuator.name.as_str());
        format!("{name} at its limit")
    }));
    marks
}

/// Tables for the terminal.
pub fn render_compensation(made: &Compensation, style: Style) -> String {
    let mut lines = vec![style.paint(Ink::Heading, &printable(&title(made)))];
    let [x, y, z] = made.tool.flange_from_tool().translation.vector.data.0[0].map(|v| 1e3 * v);
    let tool = format!(
        "  tool {} at ({x:.3}, {y:.3}, {z:.3}) mm in the flange, criterion {}",
        made.tool_name, made.criterion
    );
    lines.push(style.paint(Ink::Dim, &printable(&tool)));
    lines.push(String::new());
    if made.asked > 0 {
        lines.extend(length_lines(made, style));
        lines.push(String::new());
        lines.extend(actuator_lines(made, style));
        lines.push(String::new());
        lines.extend(point_lines(made, style));
    }
    lines.extend(grid_lines(made, style));
    lines.extend(sentences(made).iter().flat_map(|words| wrap(&format!("  {}", printable(words)), "    ")));
    for words in &made.remarks {
        let words = format!("  {}", printable(words));
        lines.extend(style.told(Ink::Warning, &words, "    "));
    }
    lines.push(String::new());
    lines.join("\n")
}

fn rule(style: Style, cells: usize) -> String {
    style.paint(Ink::Dim, &"\u{2500}".repeat(TITLE + CELL * cells))
}

fn length_lines(made: &Compensation, style: Style) -> Vec<String> {
    let heads = ["mean", "RMS", "max"].map(str::to_owned);
    let cells = |lengths: Option<Lengths>, words: &dyn Fn(f64) -> String| {
        let of = |pick: fn(Lengths) -> f64| optional(lengths.map(pick), words);
        [of(|l| l.mean), of(|l| l.rms), of(|l| l.max)]
    };
    vec![
        row("Tool's point, in space", &heads),
        rule(style, 3),
        row("nominal command misses by, mm", &cells(made.before(), &mm)),
        row("left by the corrected one, um", &cells(made.left(), &|m| format!("{:.4}", 1e6 * m))),
        row("standard deviation, mm", &cells(made.sigmas(), &mm)),
    ]
}

fn actuator_lines(made: &Compensation, style: Style) -> Vec<String> {
    let mut heads = vec!["correction".to_owned()];
    if made.is_path {
        heads.extend(["speed/s", "limit/s", "bend"].map(str::to_owned));
    }
    let mut lines = vec![row("Actuator, at most", &heads), rule(style, heads.len())];
    for (index, actuator) in made.actuators.iter().enumerate().filter(|(_, actuator)| actuator.is_commanded) {
        let shown = |value: f64| format!("{:.4}", actuator.shown(value));
        let mut cells = vec![optional(made.largest_change(index), shown)];
        if made.is_path {
            cells.push(optional(made.largest_speed(index), |v| format!("{:.2}", actuator.shown(v))));
            let limit = made.speed_limits.get(index).copied().filter(|limit| limit.is_finite());
            cells.push(optional(limit, |v| format!("{:.2}", actuator.shown(v))));
            cells.push(optional(made.bends(index).map(bend_ratio), |ratio| format!("{ratio:.3}")));
        }
        lines.push(row(&format!("{}, {}", actuator.name, actuator.unit()), &cells));
    }
    if made.is_path {
        let words =
            "    bend: the largest second difference of the corrected commands over that of the nominal ones";
        lines.push(style.paint(Ink::Dim, words));
    }
    lines
}

/// By how much more the corrected path bends than the nominal one.
fn bend_ratio([nominal, corrected]: [f64; 2]) -> f64 {
    // Below this both are straight but for rounding, m or rad.
    const STRAIGHT: f64 = 1e-9;
    (corrected + STRAIGHT) / (nominal + STRAIGHT)
}

/// Whether a point is one of those that the exit code is about.
fn is_to_be_looked_at(point: &Corrected) -> bool {
    point.end != End::Met || point.is_too_fast || point.is_untrusted
}

/// Points that are told one by one: all where there are few, else the first of those to be looked at, and how many more there are.
fn listed(made: &Compensation) -> (Vec<usize>, usize) {
    if made.points.len() <= LISTED {
        return ((0..made.points.len()).collect(), 0);
    }
    let marked: Vec<usize> =
        (0..made.points.len()).filter(|index| is_to_be_looked_at(&made.points[*index])).collect();
    let rest = marked.len().saturating_sub(LISTED);
    (marked.into_iter().take(LISTED).collect(), rest)
}

fn point_lines(made: &Compensation, style: Style) -> Vec<String> {
    let (shown, rest) = listed(made);
    if shown.is_empty() {
        return Vec::new();
    }
    let heads = ["before, mm", "left, um", "sigma, mm"].map(str::to_owned);
    let title = if made.points.len() <= LISTED { "Points" } else { "Points to be looked at" };
    let mut lines = vec![row(title, &heads), rule(style, 3)];
    for index in shown {
        let point = &made.points[index];
        let found = point.point.as_ref();
        let cells = [
            optional(found.map(|found| found.uncompensated.norm()), mm),
            optional(found.map(CompensatedPoint::missed), |m| format!("{:.4}", 1e6 * m)),
            optional(point.sigma(), mm),
        ];
        let name = [(index + 1).to_string(), point.name.name.clone(), point.name.place.clone()];
        let name = name.iter().filter(|part| !part.is_empty()).cloned().collect::<Vec<_>>().join(" ");
        let line = row(&format!("  {name}"), &cells);
        let marks = marks(made, point).join(", ");
        lines.push(if marks.is_empty() {
            line
        } else {
            format!("{line}  {}", style.paint(Ink::Warning, &printable(&marks)))
        });
    }
    if rest > 0 {
        lines.push(style.paint(Ink::Dim, &format!("    and {rest} more (compensated.csv)")));
    }
    lines.push(String::new());
    lines
}

fn grid_lines(made: &Compensation, style: Style) -> Vec<String> {
    let Some(grid) = &made.grid else { return Vec::new() };
    let [nx, ny, nz] = grid.plan.counts;
    let heads = ["mean", "RMS", "max"].map(str::to_owned);
    let cells = |spread: &calibrig_estimation::compensation::GridSpread| {
        [mm(spread.mean), mm(spread.rms), mm(spread.max)]
    };
    vec![
        row(&format!("Grid of {nx} x {ny} x {nz} offsets, mm"), &heads),
        rule(style, 3),
        row("between its points, uncorrected", &cells(&grid.uncorrected)),
        row("with offsets laid between", &cells(&grid.interpolated)),
        String::new(),
    ]
}

/// "A4, deg".
fn with_unit(actuator: &Actuator) -> String {
    format!("{}, {}", actuator.name, actuator.unit())
}
