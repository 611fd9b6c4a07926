//! `compensation.json`, schema `calibrig.compensation/1`. It only grows.

use serde::{Deserialize, Serialize};

use crate::compensate::{Beyond, Compensation, Corrected, End, Lengths};
use crate::report::document::{Axes, JsonSoftware, axes, finite};
use calibrig_estimation::compensation::{CompensatedPoint, CorrectionGrid, GridSpread, SpeedExcess};
use calibrig_estimation::inverse::{Goal, JointAtLimit, LimitEnd, Unreachable};

/// The schema's name.
pub const COMPENSATION_SCHEMA: &str = "calibrig.compensation/1";

/// The whole document, in SI. Numbers that are not finite are `null`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonCorrectedCommands {
    /// [`COMPENSATION_SCHEMA`].
    pub schema: String,
    /// What wrote it.
    pub software: JsonSoftware,
    /// Name of the file of the goals.
    pub targets: String,
    /// Name of the robot.
    pub robot: String,
    /// Key of the estimate's mode.
    pub mode: String,
    /// Hash of the nominal model, hexadecimal.
    pub model_sha256: String,
    /// Program that made the estimate.
    pub estimated_by: String,
    /// What is at the goals.
    pub tool: JsonTool,
    /// What decided between commands.
    pub criterion: String,
    /// `points` or `path`.
    pub kind: String,
    /// How many goals there are; `points` are fewer where it was interrupted.
    pub asked: usize,
    /// What nominal commands miss by.
    pub before: Option<JsonLengths>,
    /// What is left on the model.
    pub left: Option<JsonLengths>,
    /// Standard deviations in space.
    pub sigma: Option<JsonLengths>,
    /// Largest standard deviation that is to be trusted, as asked.
    pub trust_m: Option<f64>,
    /// One an actuator; commands are in their order.
    pub actuators: Vec<JsonActuator>,
    /// One a goal.
    pub points: Vec<JsonCorrected>,
    /// Steps that are too fast.
    pub exceeded: Vec<JsonExcess>,
    /// Offsets over a box; absent where none are asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub grid: Option<JsonGrid>,
    /// What is to be known beside, in words.
    pub remarks: Vec<String>,
    /// What a person must look at: with any, exit code 3.
    pub doubts: Vec<String>,
}

/// The tool.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonTool {
    /// Of the target, or `as stated`.
    pub name: String,
    /// Its point.
    pub in_flange_m: Axes,
    /// `flange_from_tool`, by rows.
    pub rotation: [[Option<f64>; 3]; 3],
    /// The axis that goals direct, in the tool's axes.
    pub axis: Axes,
}

/// Some lengths.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct JsonLengths {
    /// How many.
    pub count: usize,
    /// m
    pub mean_m: Option<f64>,
    /// m
    pub rms_m: Option<f64>,
    /// m
    pub max_m: Option<f64>,
}

/// An actuator, and what the commands ask of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonActuator {
    /// Of its joint.
    pub name: String,
    /// `m` or `rad`.
    pub unit: String,
    /// False of a joint that follows others, whose command is zero.
    pub commanded: bool,
    /// Lowest and highest command of the measured poses.
    pub measured: [Option<f64>; 2],
    /// Largest change by the correction.
    pub largest_correction: Option<f64>,
    /// Largest speed along a path, per second.
    pub largest_speed: Option<f64>,
    /// Its limit, per second; null where not known.
    pub speed_limit: Option<f64>,
    /// Largest second difference of the commands along a path, nominal and corrected.
    pub bends: Option<[Option<f64>; 2]>,
}

/// What became of a goal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonCorrected {
    /// From 1.
    pub point: usize,
    /// Its name; empty where it has none.
    pub name: String,
    /// File and line; empty where it is made.
    pub place: String,
    /// Of a path.
    pub time_s: Option<f64>,
    /// Goal of the tool's point.
    pub position_m: Axes,
    /// Direction of the tool's axis, where one is asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub axis: Option<Axes>,
    /// `base_from_tool` by rows, where one is asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation: Option<[[Option<f64>; 3]; 3]>,
    /// `met`, `jumped`, `unreachable` or `failed`.
    pub status: String,
    /// What the nominal robot's controller commands; null where nothing meets the goal.
    pub nominal: Option<Vec<Option<f64>>>,
    /// What is to be commanded.
    pub command: Option<Vec<Option<f64>>>,
    /// Signs of last motions that it counts on; empty where not known.
    pub approach: Vec<i8>,
    /// How far the nominal command is predicted to put the tool beside the goal.
    pub before_m: Option<Axes>,
    /// What is left of the position.
    pub left_m: Option<f64>,
    /// What is left of the rotation.
    pub left_rad: Option<f64>,
    /// Standard deviations along the base's axes.
    pub sigma_m: Option<Axes>,
    /// The same in space.
    pub sigma_3d_m: Option<f64>,
    /// Joints at their limits.
    pub limits: Vec<JsonAtLimit>,
    /// Commands beyond what was measured.
    pub extrapolated: Vec<JsonBeyond>,
    /// Less sure than what is to be trusted.
    pub unsure: bool,
    /// The step to it is too fast.
    pub too_fast: bool,
    /// An actuator comes from another side than the correction counts on.
    pub wavers: bool,
    /// Why there is no command.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unreachable: Option<JsonUnreachable>,
    /// The same in words.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub note: String,
}

/// A joint at its limit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonAtLimit {
    /// Name of the joint.
    pub joint: String,
    /// `low` or `high`.
    pub end: String,
    /// m or rad
    pub limit: Option<f64>,
    /// m or rad; zero where it stands on it.
    pub beyond: Option<f64>,
}

/// A command beyond what was measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonBeyond {
    /// Name of the actuator's joint.
    pub actuator: String,
    /// Above the highest or, negative, below the lowest, m or rad.
    pub by: Option<f64>,
}

/// Why a goal is out of reach.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonUnreachable {
    /// The nearest command that was found.
    pub nearest_command: Vec<Option<f64>>,
    /// What it misses.
    pub missed_m: Axes,
    /// The same of the rotation.
    pub missed_rad: Option<f64>,
    /// What holds it back.
    pub limits: Vec<JsonAtLimit>,
    /// Which limits would have to be passed; null where that does not help either.
    pub without_limits: Option<Vec<JsonAtLimit>>,
}

/// A step that is too fast.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonExcess {
    /// That it leads to, from 1.
    pub point: usize,
    /// Name of the actuator's joint.
    pub actuator: String,
    /// m/s or rad/s
    pub speed: Option<f64>,
    /// m/s or rad/s
    pub limit: Option<f64>,
}

/// Offsets over a box.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JsonGrid {
    /// Corner.
    pub low_m: Axes,
    /// The opposite one.
    pub high_m: Axes,
    /// Along x, y and z.
    pub points: [usize; 3],
    /// x fastest, then y, then z; null where the robot does not reach.
    pub offsets_m: Vec<Option<Axes>>,
    /// At the middles of the cells, with offsets laid between the points.
    pub interpolated: JsonLengths,
    /// The same without offsets.
    pub uncorrected: JsonLengths,
    /// The largest turn of the tool that offsets do not correct.
    pub turned_rad: Option<f64>,
}

fn lengths(of: Lengths) -> JsonLengths {
    JsonLengths { count: of.count, mean_m: finite(of.mean), rms_m: finite(of.rms), max_m: finite(of.max) }
}

fn spread(of: &GridSpread) -> JsonLengths {
    JsonLengths { count: of.points, mean_m: finite(of.mean), rms_m: finite(of.rms), max_m: finite(of.max) }
}

fn rows(matrix: &nalgebra::Matrix3<f64>) -> [[Option<f64>; 3]; 3] {
    [0, 1, 2].map(|row| [0, 1, 2].map(|column| finite(matrix[(row, column)])))
}

fn command(of: &[f64]) -> Vec<Option<f64>> {
    of.iter().copied().map(finite).collect()
}

fn at_limit(of: &JointAtLimit) -> JsonAtLimit {
    JsonAtLimit {
        joint: of.name.clone(),
        end: if of.end == LimitEnd::Low { "low" } else { "high" }.to_owned(),
        limit: finite(of.limit),
        beyond: finite(of.beyond),
    }
}

fn unreachable(told: &Unreachable) -> JsonUnreachable {
    JsonUnreachable {
        nearest_command: command(&told.command),
        missed_m: axes(told.missed),
        missed_rad: finite(told.missed_angle),
        limits: told.limits.iter().map(at_limit).collect(),
        without_limits: told.without_limits.as_ref().map(|all| all.iter().map(at_limit).collect()),
    }
}

fn name(made: &Compensation, actuator: usize) -> String {
    made.actuators.get(actuator).map_or_else(String::new, |known| known.name.clone())
}

fn corrected(made: &Compensation, index: usize, point: &Corrected) -> JsonCorrected {
    let found = point.point.as_ref();
    let beyond =
        |beyond: &Beyond| JsonBeyond { actuator: name(made, beyond.actuator), by: finite(beyond.by) };
    JsonCorrected {
        point: index + 1,
        name: point.name.name.clone(),
        place: point.name.place.clone(),
        time_s: point.time.and_then(finite),
        position_m: axes(point.goal.position()),
        axis: match &point.goal {
            Goal::Axis { direction, .. } => Some(axes(*direction)),
            _ => None,
        },
        rotation: match &point.goal {
            Goal::Pose(pose) => Some(rows(pose.rotation.matrix())),
            _ => None,
        },
        status: point.end.key().to_owned(),
        nominal: found.map(|found| command(&found.nominal)),
        command: found.map(|found| command(&found.command)),
        approach: found.map(|found| found.approach.clone()).unwrap_or_default(),
        before_m: found.map(|found| axes(found.uncompensated)),
        left_m: found.and_then(|found| finite(found.missed())),
        left_rad: found.and_then(|_| finite(point.left_angle)),
        sigma_m: found.and_then(CompensatedPoint::sigma).map(axes),
        sigma_3d_m: point.sigma().and_then(finite),
        limits: found.iter().flat_map(|found| &found.limits).map(at_limit).collect(),
        extrapolated: point.beyond.iter().map(beyond).collect(),
        unsure: point.is_untrusted,
        too_fast: point.is_too_fast,
        wavers: point.wavers,
        unreachable: match &point.end {
            End::Unreachable(told) => Some(unreachable(told)),
            _ => None,
        },
        note: match &point.end {
            End::Unreachable(told) => told.to_string(),
            End::Failed(why) => why.clone(),
            End::Met | End::Jumped => String::new(),
        },
    }
}

fn grid(of: &CorrectionGrid) -> JsonGrid {
    JsonGrid {
        low_m: axes(of.plan.low),
        high_m: axes(of.plan.high),
        points: of.plan.counts,
        offsets_m: of.offsets.iter().map(|offset| offset.map(axes)).collect(),
        interpolated: spread(&of.interpolated),
        uncorrected: spread(&of.uncorrected),
        turned_rad: finite(of.turned),
    }
}

fn excess(made: &Compensation, of: &SpeedExcess) -> JsonExcess {
    JsonExcess {
        point: of.point + 1,
        actuator: name(made, of.actuator),
        speed: finite(of.speed),
        limit: finite(of.limit),
    }
}

/// The document of corrected commands.
pub fn json_compensation(made: &Compensation) -> JsonCorrectedCommands {
    let flange_from_tool = made.tool.flange_from_tool();
    let actuators = made.actuators.iter().enumerate().map(|(index, actuator)| JsonActuator {
        name: actuator.name.clone(),
        unit: if actuator.unit() == "deg" { "rad" } else { "m" }.to_owned(),
        commanded: actuator.is_commanded,
        measured: [&made.region.command_min, &made.region.command_max]
            .map(|of| of.get(index).copied().and_then(finite)),
        largest_correction: made.largest_change(index).and_then(finite),
        largest_speed: made.largest_speed(index).and_then(finite),
        speed_limit: made.speed_limits.get(index).copied().and_then(finite),
        bends: made.bends(index).map(|bends| bends.map(finite)),
    });
    let points = made.points.iter().enumerate().map(|(index, point)| corrected(made, index, point));
    JsonCorrectedCommands {
        schema: COMPENSATION_SCHEMA.to_owned(),
        software: JsonSoftware::own(),
        targets: made.file.clone(),
        robot: made.robot.clone(),
        mode: made.mode.key().to_owned(),
        model_sha256: made.model_sha256.clone(),
        estimated_by: made.estimated_by.clone(),
        tool: JsonTool {
            name: made.tool_name.clone(),
            in_flange_m: axes(flange_from_tool.translation.vector),
            rotation: rows(flange_from_tool.rotation.matrix()),
            axis: axes(*made.tool.axis()),
        },
        criterion: made.criterion.to_string(),
        kind: if made.is_path { "path" } else { "points" }.to_owned(),
        asked: made.asked,
        before: made.before().map(lengths),
        left: made.left().map(lengths),
        sigma: made.sigmas().map(lengths),
        trust_m: made.trust.and_then(finite),
        actuators: actuators.collect(),
        points: points.collect(),
        exceeded: made.exceeded.iter().map(|of| excess(made, of)).collect(),
        grid: made.grid.as_ref().map(grid),
        remarks: made.remarks.clone(),
        doubts: made.doubts.clone(),
    }
}
