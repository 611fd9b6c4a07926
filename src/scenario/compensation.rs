//! `[compensation]`: corrected commands that are driven and measured after the session.

use nalgebra::Vector3;
use serde::Deserialize;

use calibrig_estimation::compensation::{Raster, ToolPath};
use calibrig_estimation::identification::Mode;
use calibrig_estimation::inverse::{Criterion, Goal};
use calibrig_files::{InputError, Robot, Source, Spanned};

/// What a goal constrains.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GoalKind {
    /// The tool's point.
    #[default]
    Position,
    /// The point and the direction of one axis.
    Axis,
    /// Point and orientation.
    Pose,
}

/// What is driven with corrected commands.
#[derive(Debug, Clone, PartialEq)]
pub struct CompensationPlan {
    /// What a goal constrains.
    pub goal: GoalKind,
    /// The axis that is directed, a unit vector in the flange frame.
    pub axis: Vector3<f64>,
    /// How nominal commands for a goal are chosen; `None` for the planned ones.
    pub redundancy: Option<Criterion>,
    /// Other criteria, for comparison.
    pub compare: Vec<Option<Criterion>>,
    /// Cycles of a pose test; `None` for none.
    pub cycles: Option<u32>,
    /// A path over a panel.
    pub path: Option<PathPlan>,
}

/// A path of the tool.
#[derive(Debug, Clone, PartialEq)]
pub struct PathPlan {
    /// In their order.
    pub goals: Vec<Goal>,
    /// m/s
    pub speed: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CompensationFile {
    #[serde(default)]
    goal: GoalKind,
    tool_axis: Option<Spanned<[Spanned<f64>; 3]>>,
    redundancy: Option<Spanned<String>>,
    #[serde(default)]
    compare: Vec<Spanned<String>>,
    pose_test_cycles: Option<Spanned<u32>>,
    path: Option<Spanned<PathFile>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PathFile {
    corners_mm: [[Spanned<f64>; 3]; 4],
    pitch_mm: Spanned<f64>,
    spacing_mm: Spanned<f64>,
    standoff_mm: Option<Spanned<f64>>,
    speed_mm_per_s: Spanned<f64>,
}

/// The name that selects the planned command of every pose.
const AS_PLANNED: &str = "as_planned";
const MOST_CYCLES: u32 = 1000;
/// Every mode drives all of them.
const MOST_POINTS: usize = 10_000;

pub(super) fn compensation(
    source: &Source,
    section: &Spanned<CompensationFile>,
    robot: &Robot,
    (verification_poses, modes): (u32, &[Mode]),
) -> Result<CompensationPlan, InputError> {
    let file = section.get_ref();
    if !modes.contains(&Mode::WithoutCalibration) {
        let help = "expected \"without_calibration\" among identification.modes: its commands are those that are corrected".to_owned();
        let message = "[compensation] without the nominal robot's row";
        return Err(source.error(section.span(), message, Some(help)));
    }
    if verification_poses == 0 {
        let help = "expected poses.verification of one or more: the goals are the places of the nominal robot at these poses".to_owned();
        return Err(source.error(
            section.span(),
            "[compensation] without a pose to verify it at",
            Some(help),
        ));
    }
    let axis = match &file.tool_axis {
        None => Vector3::z(),
        Some(given) => {
            let [x, y, z] =
                given.get_ref().each_ref().map(|value| source.finite("compensation.tool_axis", value));
            Vector3::new(x?, y?, z?).try_normalize(1e-9).ok_or_else(|| {
                let help = Some("expected a direction in the flange's axes, such as [0, 0, 1]".to_owned());
                source.error(given.span(), "compensation.tool_axis has no direction", help)
            })?
        }
    };
    let criterion = |key: &str, text: &Spanned<String>| criterion(source, key, text, robot);
    let redundancy =
        file.redundancy.as_ref().map(|text| criterion("redundancy", text)).transpose()?.flatten();
    let compare = file.compare.iter().map(|text| criterion("compare", text)).collect::<Result<_, _>>()?;
    let cycles = file.pose_test_cycles.as_ref().map(|cycles| {
        let count = *cycles.get_ref();
        if (3..=MOST_CYCLES).contains(&count) {
            return Ok(count);
        }
        let help = Some(format!("expected 3 to {MOST_CYCLES} cycles; ISO 9283 asks for 30"));
        Err(source.error(cycles.span(), format!("compensation.pose_test_cycles is {count}"), help))
    });
    Ok(CompensationPlan {
        goal: file.goal,
        axis,
        redundancy,
        compare,
        cycles: cycles.transpose()?,
        path: file.path.as_ref().map(|table| path(source, table, file.goal)).transpose()?,
    })
}

fn criterion(
    source: &Source,
    key: &str,
    text: &Spanned<String>,
    robot: &Robot,
) -> Result<Option<Criterion>, InputError> {
    if text.get_ref() == AS_PLANNED {
        return Ok(None);
    }
    let criterion: Criterion = text.get_ref().parse().map_err(|error| {
        let help = Some(format!("or {AS_PLANNED}: the command that was planned for the pose"));
        source.error(text.span(), format!("compensation.{key}: {error}"), help)
    })?;
    if criterion.deflection > 0.0 && robot.model.statics.is_none() {
        let help = Some("expected these in the robot's file, or another criterion".to_owned());
        let message = format!(
            "compensation.{key} asks for the least deflection, but the robot's file states no masses and stiffnesses"
        );
        return Err(source.error(text.span(), message, help));
    }
    Ok(Some(criterion))
}

fn path(source: &Source, table: &Spanned<PathFile>, goal: GoalKind) -> Result<PathPlan, InputError> {
    let file = table.get_ref();
    let mut corners = [Vector3::zeros(); 4];
    for (corner, given) in corners.iter_mut().zip(&file.corners_mm) {
        for (value, given) in corner.iter_mut().zip(given) {
            *value = 1e-3 * source.finite("compensation.path.corners_mm", given)?;
        }
    }
    let length = |key: &str, value: &Spanned<f64>| {
        Ok::<_, InputError>(1e-3 * source.positive(&format!("compensation.path.{key}"), value)?)
    };
    let standoff = file.standoff_mm.as_ref();
    let raster = Raster {
        corners,
        pitch: length("pitch_mm", &file.pitch_mm)?,
        spacing: length("spacing_mm", &file.spacing_mm)?,
        standoff: standoff
            .map_or(Ok(0.0), |own| Ok(1e-3 * source.finite("compensation.path.standoff_mm", own)?))?,
    };
    let speed = length("speed_mm_per_s", &file.speed_mm_per_s)?;
    let refused = |message: String, help: &str| source.error(table.span(), message, Some(help.to_owned()));
    let goals = raster.goals().map_err(|error| {
        refused(
            format!("compensation.path: {error}"),
            "expected four corners in order around a panel, and distances that cover it",
        )
    })?;
    if goals.len() > MOST_POINTS {
        let message = format!("compensation.path has {} points", goals.len());
        return Err(refused(message, "expected at most 10000: a wider pitch_mm or spacing_mm"));
    }
    // For a path without an orientation, only positions matter.
    let goals: Vec<Goal> = match goal {
        GoalKind::Position => goals.iter().map(|goal| Goal::Position(goal.position())).collect(),
        GoalKind::Axis | GoalKind::Pose => goals,
    };
    ToolPath::at_speed(&goals, speed).map_err(|error| {
        refused(format!("compensation.path: {error}"), "expected a panel whose four corners differ")
    })?;
    Ok(PathPlan { goals, speed })
}
