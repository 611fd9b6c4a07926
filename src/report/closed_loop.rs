//! Corrected commands on the machine: the table of the publication, the pose test and the path, for people and programs.

use std::collections::BTreeMap;

use maud::{Markup, html};
use serde::{Deserialize, Serialize};

use super::acceptance_bounds::by_pose;
use super::accuracy::{ErrorRow, error_lines, error_table, published};
use super::document::{JsonDropped, dropped, finite};
use super::files::ReportError;
use super::markup::{figure, key};
use super::plots::{self, Curve, MOST, look, thinned_words};
use super::sets::{JsonRow, JsonSet, json_row};
use super::terminal::{Ink, Style, aligned, millimetres, wrap};
use super::words::{counted, number, pose_count, printable};
use crate::pipeline::{Outcome, SetKind};
use calibrig_estimation::evaluation::AccuracyRow;
use calibrig_estimation::evaluation::closed_loop::{ClosedLoop, DrivenMode, DrivenPath, DrivenPoseTest};
use calibrig_estimation::evaluation::iso9283::{PositionAccuracy, PositionRepeatability};
use calibrig_estimation::identification::Mode;
use calibrig_estimation::inverse::Criterion;

/// What corrected commands did on the machine. Its table is the set `compensated`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonCompensation {
    /// What a goal holds: `position`, `axis` or `pose`.
    pub goal: String,
    /// What decides between the commands that meet a goal: `as_planned`, or a criterion.
    pub redundancy: String,
    /// By the key of the mode: poses that it cannot correct; absent where none.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub uncorrected: BTreeMap<String, Vec<JsonDropped>>,
    /// By the key of the mode: poses whose position alone it corrects; absent where none.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub position_alone: BTreeMap<String, Vec<JsonDropped>>,
    /// The same goals with the redundancy resolved otherwise; absent where not asked for.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub criteria: Vec<JsonDrivenCriterion>,
    /// Cycles of a pose test; absent where not asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pose_test: Option<JsonDrivenPoseTest>,
    /// A path; absent where not asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub path: Option<JsonDrivenPath>,
    /// What could not be driven; absent where all was.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub failures: Vec<JsonDriveFailure>,
}

/// Something that could not be driven.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct JsonDriveFailure {
    /// What, in words.
    pub what: String,
    /// Why.
    pub why: String,
}

/// A way to resolve the redundancy.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonDrivenCriterion {
    /// `as_planned`, or a criterion.
    pub criterion: String,
    /// Key of the mode whose commands are driven.
    pub mode: String,
    /// Mean predicted deflection of the tool, m; null where nothing is known of it.
    pub droop_mean_m: Option<f64>,
    /// Largest predicted deflection, m.
    pub droop_max_m: Option<f64>,
    /// Nominal commands.
    pub nominal: Option<JsonRow>,
    /// Corrected ones.
    pub compensated: Option<JsonRow>,
    /// Goals that could not be met.
    pub missed: usize,
    /// Goals whose position alone was corrected.
    pub position_alone: usize,
}

/// Cycles over the poses of a cube (ISO 9283).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonDrivenPoseTest {
    /// Edge of the cube, m.
    pub edge_m: Option<f64>,
    /// Cycles.
    pub cycles: usize,
    /// By the key of the mode, one entry a pose from P1 on.
    pub modes: BTreeMap<String, Vec<JsonDrivenPose>>,
}

/// A pose of the test.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonDrivenPose {
    /// AP of the position, m.
    pub accuracy_m: Option<f64>,
    /// Its components, m.
    pub error_m: [Option<f64>; 3],
    /// RP of the position, m.
    pub repeatability_m: Option<f64>,
}

/// A path that was driven.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonDrivenPath {
    /// Of the way of the tool, m.
    pub length_m: Option<f64>,
    /// m/s
    pub speed_m_per_s: Option<f64>,
    /// Points that the nominal robot cannot reach; absent where none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unreachable: Vec<JsonDropped>,
    /// By the key of the mode: points that it cannot correct; absent where none.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub uncorrected: BTreeMap<String, Vec<JsonDropped>>,
    /// By the key of the mode: points whose position alone it corrects; absent where none.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub position_alone: BTreeMap<String, Vec<JsonDropped>>,
    /// By the key of the mode: measured minus wanted.
    pub rows: BTreeMap<String, JsonRow>,
}

fn criterion_key(criterion: Option<Criterion>) -> String {
    criterion.map_or_else(|| "as_planned".to_owned(), |criterion| criterion.to_string())
}

fn criterion_words(criterion: Option<Criterion>) -> String {
    match criterion {
        None => "as planned".to_owned(),
        Some(Criterion::NONE) => "any that meets the goal".to_owned(),
        Some(Criterion::FAR_FROM_LIMITS) => "far from limits".to_owned(),
        Some(Criterion::MANIPULABILITY) => "far from singular poses".to_owned(),
        Some(criterion) => format!("least {criterion}"),
    }
}

/// The largest error of every pose, m.
fn lengths(mode: &DrivenMode) -> Vec<f64> {
    let errors: Vec<_> = mode.points.iter().map(|point| (point.pose, point.error())).collect();
    by_pose(errors.iter().map(|(pose, error)| (*pose, error)))
}

/// The set `compensated`.
pub(super) fn json_set(driven: &ClosedLoop) -> JsonSet {
    let nominal = driven.modes.first();
    let rows = driven
        .modes
        .iter()
        .filter_map(|mode| Some((mode.mode.key().to_owned(), json_row(&mode.row()?, Some(&lengths(mode))))));
    JsonSet {
        poses: nominal.map_or(0, |mode| pose_count(&mode.set)),
        dropped: nominal.map(|mode| dropped(&mode.set.dropped)).unwrap_or_default(),
        missing: Vec::new(),
        repeats: None,
        payloads: Vec::new(),
        rows: rows.collect(),
    }
}

/// What belongs to no set.
pub(super) fn json_compensation(driven: &ClosedLoop) -> JsonCompensation {
    let plain = |row: &AccuracyRow| json_row(row, None);
    let pose = |(ap, rp): &(PositionAccuracy, PositionRepeatability)| JsonDrivenPose {
        accuracy_m: finite(ap.distance),
        error_m: [0, 1, 2].map(|axis| finite(ap.error[axis])),
        repeatability_m: finite(rp.repeatability),
    };
    JsonCompensation {
        goal: goal_words(driven).0.to_owned(),
        redundancy: criterion_key(driven.redundancy),
        uncorrected: by_mode(&driven.modes, |mode| &mode.uncorrected),
        position_alone: by_mode(&driven.modes, |mode| &mode.position_alone),
        criteria: driven
            .criteria
            .iter()
            .map(|own| JsonDrivenCriterion {
                criterion: criterion_key(own.criterion),
                mode: own.mode.key().to_owned(),
                droop_mean_m: own.droop.and_then(|[mean, _]| finite(mean)),
                droop_max_m: own.droop.and_then(|[_, most]| finite(most)),
                nominal: own.nominal.as_ref().map(plain),
                compensated: own.corrected.as_ref().map(plain),
                missed: own.missed,
                position_alone: own.position_alone,
            })
            .collect(),
        pose_test: driven.pose_test.as_ref().map(|test| JsonDrivenPoseTest {
            edge_m: finite(test.cube.edge),
            cycles: test.cycles,
            modes: test
                .modes
                .iter()
                .map(|(mode, poses)| (mode.key().to_owned(), poses.iter().map(pose).collect()))
                .collect(),
        }),
        path: driven.path.as_ref().map(|path| JsonDrivenPath {
            length_m: finite(path.length),
            speed_m_per_s: finite(path.speed),
            unreachable: dropped(&path.unreachable),
            uncorrected: by_mode(&path.modes, |mode| &mode.uncorrected),
            position_alone: by_mode(&path.modes, |mode| &mode.position_alone),
            rows: path
                .modes
                .iter()
                .filter_map(|mode| Some((mode.mode.key().to_owned(), plain(&mode.row()?))))
                .collect(),
        }),
        failures: driven
            .failures
            .iter()
            .map(|failure| JsonDriveFailure { what: failure.what.clone(), why: failure.why.clone() })
            .collect(),
    }
}

/// Lists of poses by the key of the mode, those that hold any.
fn by_mode(
    modes: &[DrivenMode],
    of: impl Fn(&DrivenMode) -> &Vec<(u32, String)>,
) -> BTreeMap<String, Vec<JsonDropped>> {
    let lists = modes.iter().map(|mode| (mode.mode.key().to_owned(), dropped(of(mode))));
    lists.filter(|(_, list)| !list.is_empty()).collect()
}

/// Key of what a goal holds, and the same in words.
fn goal_words(driven: &ClosedLoop) -> (&'static str, &'static str) {
    match driven.rows_of_goal {
        3 => ("position", "the position of the tool"),
        5 => ("axis", "the position of the tool and the direction of its axis"),
        _ => ("pose", "the pose of the tool"),
    }
}

/// A row's name: whose commands.
fn title(mode: Mode) -> &'static str {
    match mode {
        Mode::WithoutCalibration => "nominal commands",
        mode => mode.title(),
    }
}

const HEADING: &str = "Commands corrected and driven again: measured minus wanted, absolute errors in mm";

/// What the terminal says.
pub(super) fn closed_loop_lines(outcome: &Outcome, driven: &ClosedLoop, style: Style) -> Vec<String> {
    let mut lines = vec![style.paint(Ink::Heading, HEADING)];
    lines.extend(error_lines(rows(&driven.modes, Some(outcome), "  published, verification"), style));
    for words in remarks(driven) {
        lines.extend(wrap(&printable(&words), "    "));
    }
    for mode in &driven.modes {
        for words in uncorrected_words(mode, "pose") {
            lines.extend(style.told(Ink::Warning, &words, "    "));
        }
    }
    if !driven.criteria.is_empty() {
        lines.extend(criterion_lines(driven, style));
    }
    if let Some(test) = &driven.pose_test {
        lines.push(style.paint(Ink::Dim, &pose_test_words(test)));
        lines.push(aligned("", &pose_columns(test)));
        for (mode, poses) in &test.modes {
            lines.push(aligned(title(*mode), &pose_figures(poses).map(millimetres)));
        }
    }
    if let Some(path) = &driven.path {
        lines.push(style.paint(Ink::Dim, &path_words(path)));
        lines.extend(error_lines(rows(&path.modes, None, ""), style));
        for words in path_remarks(path) {
            lines.extend(style.told(Ink::Warning, &words, "    "));
        }
    }
    for words in failure_words(driven) {
        lines.extend(style.told(Ink::Warning, &words, "    "));
    }
    lines.push(String::new());
    lines
}

fn failure_words(driven: &ClosedLoop) -> impl Iterator<Item = String> + '_ {
    driven.failures.iter().map(|failure| format!("not driven: {}: {}", failure.what, failure.why))
}

/// What was driven, in words.
fn remarks(driven: &ClosedLoop) -> Vec<String> {
    vec![format!(
        "the goal at each verification pose is {}, as the nominal robot has it there; redundancy: {}; every row drives and measures the whole set once more, under the same conditions and with the same random numbers, in the frame of its mode",
        goal_words(driven).1,
        criterion_words(driven.redundancy)
    )]
}

/// What was not corrected, or not all of it, or not read, a sentence a reason.
fn uncorrected_words(mode: &DrivenMode, noun: &str) -> Vec<String> {
    let kinds = [
        ("not corrected and not counted", &mode.uncorrected),
        ("corrected in position alone", &mode.position_alone),
        ("not measured", &mode.set.dropped),
    ];
    let words = |(what, poses): (&str, &Vec<(u32, String)>)| {
        let (pose, why) = poses.first()?;
        let which =
            if poses.len() == 1 { format!("{noun} {pose}") } else { format!("the first is {noun} {pose}") };
        Some(format!("{}: {} {what}, {which} ({why})", title(mode.mode), counted(poses.len(), noun)))
    };
    kinds.into_iter().filter_map(words).collect()
}

fn criterion_lines(driven: &ClosedLoop, style: Style) -> Vec<String> {
    let mode = driven.criteria.first().map_or(Mode::WithoutCalibration, |own| own.mode);
    let heading = format!(
        "redundancy resolved otherwise: predicted droop, and errors by commands of \"{}\", mm",
        title(mode)
    );
    let mut lines: Vec<String> = style.told(Ink::Dim, &heading, "    ");
    lines.push(aligned(
        "",
        &["droop", "(max)", "mean x", "mean y", "mean z", "RMS 3D", "nominal"].map(str::to_owned),
    ));
    for own in &driven.criteria {
        let [mean, most] = own.droop.unwrap_or([f64::NAN; 2]);
        let row = own.corrected.as_ref();
        let of = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), millimetres);
        let droop = |value: f64| if value.is_finite() { millimetres(value) } else { "-".to_owned() };
        let mut numbers = vec![droop(mean), droop(most)];
        numbers.extend((0..3).map(|axis| of(row.map(|row| row.mean[axis]))));
        numbers.push(of(row.map(|row| row.rms_3d)));
        numbers.push(of(own.nominal.as_ref().map(|row| row.rms_3d)));
        lines.push(aligned(&criterion_words(own.criterion), &numbers));
    }
    lines
}

fn pose_test_words(test: &DrivenPoseTest) -> String {
    format!(
        "pose test (ISO 9283): {} over five poses in a cube of {:.0} mm; errors in mm",
        counted(test.cycles, "cycle"),
        1e3 * test.cube.edge
    )
}

fn pose_columns(_: &DrivenPoseTest) -> [String; 4] {
    ["AP mean", "AP max", "RP mean", "RP max"].map(str::to_owned)
}

/// AP mean and largest, RP mean and largest, m.
fn pose_figures(poses: &[(PositionAccuracy, PositionRepeatability)]) -> [f64; 4] {
    let mean_and_most = |values: &[f64]| {
        let most = values.iter().copied().fold(0.0, f64::max);
        [values.iter().sum::<f64>() / values.len().max(1) as f64, most]
    };
    let [a, b] = mean_and_most(&poses.iter().map(|(ap, _)| ap.distance).collect::<Vec<_>>());
    let [c, d] = mean_and_most(&poses.iter().map(|(_, rp)| rp.repeatability).collect::<Vec<_>>());
    [a, b, c, d]
}

/// What of a path was not driven as it was asked.
fn path_remarks(path: &DrivenPath) -> Vec<String> {
    let unreachable = path.unreachable.first().map(|(point, why)| {
        let count = counted(path.unreachable.len(), "point");
        format!("{count} of the path out of reach, the first is point {point} ({why})")
    });
    let of_modes = path.modes.iter().flat_map(|mode| uncorrected_words(mode, "point"));
    unreachable.into_iter().chain(of_modes).collect()
}

fn path_words(path: &DrivenPath) -> String {
    let points = path.modes.first().map_or(0, |mode| pose_count(&mode.set));
    format!(
        "path of {:.2} m at {:.0} mm/s, read at {}: measured minus wanted, mm",
        path.length,
        1e3 * path.speed,
        counted(points, "point")
    )
}

/// The section of the page; nothing where no command was corrected.
pub(super) fn closed_loop_section(outcome: &Outcome) -> Result<Markup, ReportError> {
    let Some(driven) = &outcome.closed_loop else { return Ok(html! {}) };
    let path = driven.path.as_ref().map(path_figure).transpose()?;
    let bars = goal_figure(driven)?;
    let modes: Vec<Mode> = driven.modes.iter().map(|mode| mode.mode).collect();
    Ok(html! {
        section #compensated {
            h2 { "Compensated" }
            p {
                "Each identified robot corrects the commands; the machine drives them and is measured again. The table has where the tool was measured minus where it was to be."
            }
            (goal_table(outcome, driven))
            @for words in remarks(driven) { p.note { (capital(&words)) "." } }
            @for mode in &driven.modes {
                @for words in uncorrected_words(mode, "pose") { p.note { (capital(&words)) "." } }
            }
            @for words in failure_words(driven) { p.note { strong { (capital(&words)) "." } } }
            (figure(&modes, &bars, &html! {
                "Distance of the measured tool from its goal, pose by pose. "
                "\u{201c}" (Mode::WithoutCalibration.title()) "\u{201d} are the nominal commands."
                (thinned_words(driven.modes.first().map_or(0, |mode| mode.points.len()), MOST))
            }, false))
            @if !driven.criteria.is_empty() { (criterion_table(driven)) }
            @if let Some(test) = &driven.pose_test { (pose_test_table(test)) }
            @if let (Some(path), Some(drawn)) = (&driven.path, path) {
                (path_table(path))
                (figure(&modes, &drawn, &html! {
                    "Distance of the measured tool from the path over the panel, along its way."
                    (thinned_words(path.modes.first().map_or(0, |mode| mode.points.len()), MOST))
                }, true))
            }
        }
    })
}

fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

fn mm(metres: f64) -> String {
    number(1e3 * metres, 3)
}

fn goal_table(outcome: &Outcome, driven: &ClosedLoop) -> Markup {
    let poses = driven.modes.first().map_or(0, |mode| pose_count(&mode.set));
    let rows: Vec<_> = rows(&driven.modes, Some(outcome), "published, verification").collect();
    error_table(&format!("{} of the verification set, mm", counted(poses, "pose")), &rows)
}

/// Rows of what was driven, with the published figures of an outcome's verification set.
fn rows<'a>(
    modes: &'a [DrivenMode],
    beside: Option<&'a Outcome>,
    published_as: &'static str,
) -> impl Iterator<Item = ErrorRow<'a>> {
    modes.iter().filter_map(move |own| {
        Some(ErrorRow {
            mode: own.mode,
            title: title(own.mode),
            row: own.row()?,
            published: beside.and_then(|outcome| published(outcome, SetKind::Verification, own.mode)),
            published_as,
        })
    })
}

fn criterion_table(driven: &ClosedLoop) -> Markup {
    let of = |row: Option<&AccuracyRow>, value: fn(&AccuracyRow) -> f64| mm(row.map_or(f64::NAN, value));
    let mode = driven.criteria.first().map_or(Mode::WithoutCalibration, |own| own.mode);
    html! {
        div.scroll {
            table {
                caption { "The same goals with the redundancy resolved otherwise, commands of \u{201c}" (title(mode)) "\u{201d}, mm" }
                thead {
                    tr {
                        th {} th.first { "predicted droop, mean" } th { "largest" }
                        th.first { "mean x" } th { "mean y" } th { "mean z" } th { "RMS 3-D" }
                        th.first { "RMS 3-D, nominal commands" }
                    }
                }
                tbody {
                    @for own in &driven.criteria {
                        tr {
                            th scope="row" {
                                (criterion_words(own.criterion))
                                @if own.missed > 0 { " (" (counted(own.missed, "goal")) " missed)" }
                            }
                            td.first { (mm(own.droop.map_or(f64::NAN, |droop| droop[0]))) }
                            td { (mm(own.droop.map_or(f64::NAN, |droop| droop[1]))) }
                            td.first { (of(own.corrected.as_ref(), |row| row.mean.x)) }
                            td { (of(own.corrected.as_ref(), |row| row.mean.y)) }
                            td { (of(own.corrected.as_ref(), |row| row.mean.z)) }
                            td { (of(own.corrected.as_ref(), |row| row.rms_3d)) }
                            td.first { (of(own.nominal.as_ref(), |row| row.rms_3d)) }
                        }
                    }
                }
            }
        }
    }
}

fn pose_test_table(test: &DrivenPoseTest) -> Markup {
    html! {
        div.scroll {
            table {
                caption { (capital(&pose_test_words(test))) }
                thead {
                    tr {
                        th {}
                        @for column in pose_columns(test) { th { (column) } }
                    }
                }
                tbody {
                    @for (mode, poses) in &test.modes {
                        tr {
                            th scope="row" { (key(&look(*mode))) (title(*mode)) }
                            @for value in pose_figures(poses) { td { (mm(value)) } }
                        }
                    }
                }
            }
        }
        p.note {
            "AP is the distance of the barycentre of all cycles from the commanded position. RP is the radius about the barycentre that the standard defines from the scatter of the cycles. "
            "All cycles approach from one side."
        }
    }
}

fn path_table(path: &DrivenPath) -> Markup {
    let rows: Vec<_> = rows(&path.modes, None, "").collect();
    html! {
        (error_table(&capital(&path_words(path)), &rows))
        @for words in path_remarks(path) { p.note { (capital(&words)) "." } }
    }
}

/// Distance from the goal, a marker a pose; logarithmic.
fn goal_figure(driven: &ClosedLoop) -> Result<String, ReportError> {
    let curve = |mode: &DrivenMode| Curve {
        look: look(mode.mode),
        points: mode.points.iter().map(|p| (f64::from(p.pose), 1e3 * p.error().norm())).collect(),
        joined: false,
    };
    let curves: Vec<Curve> = driven.modes.iter().map(curve).collect();
    plots::magnitudes(("compensated poses", "Distance from the goal of every pose"), "pose", &curves)
}

/// Distance from the path, along it.
fn path_figure(path: &DrivenPath) -> Result<String, ReportError> {
    let curve = |mode: &DrivenMode| {
        let mut way = 0.0;
        let mut last = None;
        let mut at = |place: nalgebra::Vector3<f64>| {
            way += last.replace(place).map_or(0.0, |before: nalgebra::Vector3<f64>| (place - before).norm());
            way
        };
        Curve {
            look: look(mode.mode),
            points: mode.points.iter().map(|p| (at(p.goal), 1e3 * p.error().norm())).collect(),
            joined: true,
        }
    };
    let curves: Vec<Curve> = path.modes.iter().map(curve).collect();
    plots::magnitudes(("compensated path", "Distance from the path along its way"), "way, m", &curves)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::tests::sample;
    use crate::report::{html_report, json_report, render_tables};

    /// The figures of the rows are those of the driven points, wherever they are told.
    #[test]
    fn rows_are_the_same_in_the_document_on_the_terminal_and_on_the_page() {
        let outcome = sample::driven();
        let driven = outcome.closed_loop.as_ref().expect("driven");
        let row = driven.modes[2].row().expect("points");
        let json = json_report(&outcome);
        let set = &json.sets["compensated"];
        assert_eq!(set.rows["with_gravity"].mean_m, [0, 1, 2].map(|axis| Some(row.mean[axis])));
        assert_eq!(set.rows["with_gravity"].n, 38);
        let told = json.compensation.expect("the section");
        assert_eq!((told.goal.as_str(), told.redundancy.as_str()), ("axis", "as_planned"));
        assert_eq!(told.uncorrected["with_gravity"][0].pose, 3);
        assert!(!told.uncorrected.contains_key("without_calibration"));
        assert_eq!(told.criteria[1].criterion, "deflection");
        let rms = millimetres(row.rms_3d);
        let text = render_tables(&outcome, Style::Plain);
        let behind = text.split_once(HEADING).expect("the table").1;
        let line = behind.lines().find(|line| line.starts_with(Mode::WithGravity.title())).expect("its row");
        assert!(line.contains(&rms), "{line}");
        assert!(behind.contains("1 pose not corrected and not counted, pose 3"), "{behind}");
        let page = html_report(&outcome).expect("a page");
        let section = page.split_once("id=\"compensated\"").expect("the section").1;
        assert!(section.contains(&number(1e3 * row.rms_3d, 3)));
        assert!(!page.contains("<script>"));
    }
}
