//! One point, three points and full poses at the same poses: a short table on the terminal, a table and a figure on the page, and in JSON.

use maud::{Markup, PreEscaped, html};
use serde::{Deserialize, Serialize};

use super::document::finite;
use super::files::ReportError;
use super::markup::key;
use super::plots::{LOOKS, Look, drawable};
use super::rows::{Dot, Panel, dots};
use super::terminal::{Ink, Style, TITLE, wrap};
use super::words::{number, printed_unit, set_title, significant};
use crate::pipeline::{Outcome, SensorProspect, SensorStudy};
use calibrig_model::ParameterId;

/// Parameters in the figure and beside it.
const MOST: usize = 16;
/// A parameter is of interest where one kind of target tells it so many times as well as another.
const TELLING: f64 = 1.1;
/// What is more than this many times as uncertain as the best is drawn at the edge.
const FARTHEST: f64 = 30.0;

/// What kinds of targets tell at the same poses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonSensors {
    /// Key of the mode whose estimate it rests on.
    pub mode: String,
    /// Key of the set at whose poses the robot is predicted.
    pub predicted: String,
    /// One entry a kind of target.
    pub sensors: Vec<JsonSensor>,
}

/// One of them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonSensor {
    /// `one_smr`, `three_smrs`, `combined_pose`, `probe` or `as_measured`.
    pub sensor: String,
    /// Whether it is what was measured.
    pub measured: bool,
    /// Rank of the fit, with its priors.
    pub rank: usize,
    /// Rank by observations, nests and targets alone.
    pub measured_rank: usize,
    /// Their number.
    pub parameter_count: usize,
    /// Parameters that it does not tell from others, with those.
    pub open: Vec<String>,
    /// RMS uncertainty of the first target's predicted place in the base frame, m; null from a singular system, as what follows.
    pub place_sigma_m: Option<f64>,
    /// The same of how the flange is turned, rad.
    pub turn_sigma_rad: Option<f64>,
    /// Standard deviations.
    pub parameters: Vec<JsonSensorParameter>,
}

/// How well a kind of target tells a parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonSensorParameter {
    /// Its name.
    pub name: String,
    /// `m`, `rad` or `1`.
    pub unit: String,
    /// Standard deviation; null from a singular system, or at a bound.
    pub sigma: Option<f64>,
}

pub(super) fn json_sensors(study: &SensorStudy) -> JsonSensors {
    let of = |prospect: &SensorProspect| JsonSensor {
        sensor: prospect.sensor.key().to_owned(),
        measured: prospect.is_measured,
        rank: prospect.rank,
        measured_rank: prospect.measured_rank,
        parameter_count: prospect.parameters.len(),
        open: prospect.open.clone(),
        place_sigma_m: prospect.spread.and_then(|spread| finite(spread.place)),
        turn_sigma_rad: prospect.spread.and_then(|spread| finite(spread.turn)),
        parameters: prospect
            .parameters
            .iter()
            .map(|(id, sigma)| JsonSensorParameter {
                name: id.to_string(),
                unit: id.unit().to_string(),
                sigma: sigma.and_then(finite),
            })
            .collect(),
    };
    JsonSensors {
        mode: study.mode.key().to_owned(),
        predicted: study.predicted.key().to_owned(),
        sensors: study.sensors.iter().map(of).collect(),
    }
}

/// Titles of the rows of the table.
const ROWS: [&str; 4] =
    ["parameters fitted", "told by measurements", "target's place, \u{b5}m", "flange's angle, \u{b5}rad"];

/// What is told of a kind of target, one a row.
fn cells(prospect: &SensorProspect) -> [String; 4] {
    let [place, turn] = match prospect.spread {
        Some(spread) => [spread.place, spread.turn].map(|sigma| significant(1e6 * sigma)),
        None => ["\u{2013}"; 2].map(str::to_owned),
    };
    [prospect.parameters.len().to_string(), prospect.measured_rank.to_string(), place, turn]
}

/// How a column is headed.
fn heading(prospect: &SensorProspect) -> [&'static str; 2] {
    [prospect.sensor.title(), if prospect.is_measured { "(measured)" } else { "(foreseen)" }]
}

fn explanation(study: &SensorStudy) -> String {
    format!(
        "What one point, three points or a full pose would tell at the same poses and with the same noise, for \u{201c}{}\u{201d} (linearised at its estimate). \
         Targets that were not there are assumed 120 mm from the first and read as well as it. Place and angle are the RMS uncertainty of the \
         predicted robot at the poses of the {} set, without what the machine does beside its model.",
        study.mode.title(),
        study.predicted.key()
    )
}

pub(super) fn sensor_lines(study: &SensorStudy, style: Style) -> Vec<String> {
    const CELL: usize = 13;
    let mut lines = vec![String::new(), style.paint(Ink::Heading, "What the target tells")];
    lines.extend(wrap(&explanation(study), ""));
    for part in 0..2 {
        let cells = study.sensors.iter().map(|prospect| format!("{:>CELL$}", heading(prospect)[part]));
        lines.push(format!("{:TITLE$}{}", "", cells.collect::<String>()));
    }
    let rule = style.paint(Ink::Dim, &"\u{2500}".repeat(TITLE + study.sensors.len() * CELL));
    lines.push(rule.clone());
    let columns: Vec<_> = study.sensors.iter().map(cells).collect();
    for (row, title) in ROWS.iter().enumerate() {
        let cells = columns.iter().map(|column| format!("{:>CELL$}", column[row]));
        lines.push(format!("{title:<TITLE$}{}", cells.collect::<String>()));
    }
    lines.push(rule);
    lines
}

/// The robot's parameters that kinds of targets tell most differently, each with its standard deviation of every kind, SI.
fn telling(study: &SensorStudy) -> Vec<(ParameterId, Vec<Option<f64>>)> {
    let mut ids: Vec<ParameterId> = Vec::new();
    for (id, _) in study.sensors.iter().flat_map(|prospect| &prospect.parameters) {
        let is_robot = !matches!(
            id,
            ParameterId::Frame { .. }
                | ParameterId::Target { .. }
                | ParameterId::Orientation { .. }
                | ParameterId::Instrument { .. }
                | ParameterId::Drift { .. }
        );
        if is_robot && !ids.contains(id) {
            ids.push(*id);
        }
    }
    let of = |id: ParameterId| {
        let sigmas =
            study.sensors.iter().map(|prospect| prospect.sigma(id).filter(|s| *s > 0.0 && drawable(*s)));
        (id, sigmas.collect::<Vec<_>>())
    };
    let range = |sigmas: &[Option<f64>]| {
        let least = sigmas.iter().flatten().copied().fold(f64::INFINITY, f64::min);
        let most = sigmas.iter().flatten().copied().fold(0.0, f64::max);
        if least.is_finite() { most / least } else { 0.0 }
    };
    let mut all: Vec<_> = ids.iter().copied().map(of).filter(|(_, s)| range(s) >= TELLING).collect();
    all.sort_by(|a, b| range(&b.1).total_cmp(&range(&a.1)));
    all.truncate(MOST);
    // In the order of the robot.
    all.sort_by_key(|(id, _)| ids.iter().position(|own| own == id));
    all
}

fn look_of(place: usize) -> Look {
    LOOKS[place % LOOKS.len()]
}

/// The section of the page.
pub(super) fn sensor_section(outcome: &Outcome) -> Result<Markup, ReportError> {
    let Some(study) = &outcome.sensors else { return Ok(html! {}) };
    let telling = telling(study);
    let plot = if telling.is_empty() { None } else { Some(drawn(&telling)?) };
    let open: Vec<_> = study.sensors.iter().filter(|prospect| !prospect.open.is_empty()).collect();
    let columns: Vec<_> = study.sensors.iter().map(cells).collect();
    let row = |(row, title): (usize, &&str)| {
        ((*title).to_owned(), columns.iter().map(|column| column[row].clone()).collect())
    };
    let told: Vec<(String, Vec<String>)> = ROWS.iter().enumerate().map(row).collect();
    let sigma_row = |(id, sigmas): &(ParameterId, Vec<Option<f64>>)| {
        let (unit, factor) = printed_unit(id.unit());
        let cell = |sigma: &Option<f64>| sigma.map_or("\u{2013}".to_owned(), |s| number(factor * s, 5));
        (format!("{id}, {unit}"), sigmas.iter().map(cell).collect())
    };
    let sigmas: Vec<(String, Vec<String>)> = telling.iter().map(sigma_row).collect();
    let caption = format!("At the poses of the {}", set_title(study.predicted).to_lowercase());
    Ok(html! {
        section #target {
            h2 { "What the target tells" }
            p { (explanation(study)) }
            (table(study, &caption, &told))
            @for prospect in open {
                p.note { "Not identifiable with " (prospect.sensor.title()) ": " (prospect.open.join("; ")) "." }
            }
            @if let Some(plot) = &plot {
                figure {
                    div.legend {
                        @for (place, prospect) in study.sensors.iter().enumerate() {
                            span { (key(&look_of(place))) (prospect.sensor.title()) }
                        }
                    }
                    div.scroll { (PreEscaped(plot)) }
                    figcaption {
                        "Standard deviations of parameters, as multiples of the smallest among the kinds of targets, for the "
                        (telling.len()) " parameters that differ most. Further left is better."
                    }
                }
                (table(study, "The same standard deviations", &sigmas))
                p.note { "All parameters are in report.json, under \u{201c}sensors\u{201d}." }
            } @else {
                p.note { "No parameter of the robot is identified better with one kind of target than with another." }
            }
        }
    })
}

fn table(study: &SensorStudy, caption: &str, rows: &[(String, Vec<String>)]) -> Markup {
    html! {
        div.scroll {
            table {
                caption { (caption) }
                thead {
                    tr {
                        th {}
                        @for prospect in &study.sensors {
                            @let [title, how] = heading(prospect);
                            th { (title) br; (how) }
                        }
                    }
                }
                tbody {
                    @for (title, cells) in rows {
                        tr { th scope="row" { (title) } @for cell in cells { td { (cell) } } }
                    }
                }
            }
        }
    }
}

/// A row a parameter, a marker a kind of target.
fn drawn(rows: &[(ParameterId, Vec<Option<f64>>)]) -> Result<String, ReportError> {
    let names: Vec<_> = rows.iter().map(|(id, _)| id.to_string()).collect();
    let row = |(_, sigmas): &(ParameterId, Vec<Option<f64>>)| {
        let least = sigmas.iter().flatten().copied().fold(f64::INFINITY, f64::min);
        let dot = |(place, sigma): (usize, &Option<f64>)| {
            Some(Dot::at(look_of(place), ((*sigma)? / least).min(FARTHEST)))
        };
        sigmas.iter().enumerate().filter_map(dot).collect()
    };
    let title = "standard deviation over the smallest";
    let panel = Panel { far: TELLING, ..Panel::of(title, 1.0, rows.iter().map(row).collect()) };
    dots("what the target tells", "Standard deviations by kind of target", &names, &[panel])
}
