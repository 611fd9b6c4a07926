//! Commands corrected by an estimate from a file or recording: the result for every goal, its uncertainty, and what a person must look at.

mod judge;

use std::ops::ControlFlow;

use nalgebra::Vector3;

use crate::handover::{EstimateFile, Region};
use calibrig_estimation::compensation::{
    CompensatedPoint, CompensationError, Compensator, CorrectionGrid, GridError, GridPlan, PathOptions,
    PathReport, PointStatus, SpeedExcess, ToolPath,
};
use calibrig_estimation::identification::Mode;
use calibrig_estimation::inverse::{Criterion, Goal, InverseError, Tool, Unreachable};
use calibrig_model::JointKind;

/// Largest remaining error of a goal that counts as met, m.
pub const CLOSED: f64 = 1e-6;

/// Goals, and whether they are a path.
#[derive(Debug, Clone, PartialEq)]
pub enum Way {
    /// Separate points, each from the start command.
    Points(Vec<Goal>),
    /// A path: each from the one before, in time.
    Path(ToolPath),
}

impl Way {
    /// How many there are.
    pub fn len(&self) -> usize {
        match self {
            Self::Points(goals) => goals.len(),
            Self::Path(path) => path.points().len(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// What a goal is called.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct GoalName {
    /// Its name; empty if it has none.
    pub name: String,
    /// Its place in its file, such as `points.csv:7`; empty if it was generated.
    pub place: String,
}

/// What is to be corrected, and how.
#[derive(Debug, Clone, PartialEq)]
pub struct CompensationPlan {
    /// Name of the file of the goals.
    pub file: String,
    /// Goals.
    pub way: Way,
    /// One per goal; may be shorter.
    pub names: Vec<GoalName>,
    /// The part of the robot that goals place.
    pub tool: Tool,
    /// Its name for people.
    pub tool_name: String,
    /// How commands are searched; for points, only the part for single points applies.
    pub options: PathOptions,
    /// The largest standard deviation of a corrected position in space that is trusted, m.
    pub trust: Option<f64>,
    /// Offsets that are wanted as well.
    pub grid: Option<GridPlan>,
}

/// An actuator as it is displayed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Actuator {
    /// That of its joint.
    pub name: String,
    /// That of its joint.
    pub kind: JointKind,
    /// False for a joint that follows others: it has no command.
    pub is_commanded: bool,
}

impl Actuator {
    /// `deg` or `mm`.
    pub fn unit(&self) -> &'static str {
        match self.kind {
            JointKind::Revolute => "deg",
            JointKind::Prismatic => "mm",
        }
    }

    /// One m or rad in that unit.
    pub fn shown(&self, value: f64) -> f64 {
        match self.kind {
            JointKind::Revolute => value.to_degrees(),
            JointKind::Prismatic => 1e3 * value,
        }
    }
}

/// How a goal ended.
#[derive(Debug, Clone, PartialEq)]
pub enum End {
    /// Met; on a path, from the point before.
    Met,
    /// Met, but with a jump from the point before.
    Jumped,
    /// Not met.
    Unreachable(Box<Unreachable>),
    /// The robot has no pose there.
    Failed(String),
}

impl End {
    /// `met`, `jumped`, `unreachable` or `failed`.
    pub fn key(&self) -> &'static str {
        match self {
            Self::Met => "met",
            Self::Jumped => "jumped",
            Self::Unreachable(_) => "unreachable",
            Self::Failed(_) => "failed",
        }
    }
}

/// A command outside the measured range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Beyond {
    /// Index of the actuator.
    pub actuator: usize,
    /// By how much it is above the highest or, negative, below the lowest command of the measured poses, m or rad.
    pub by: f64,
}

/// The result for a goal.
#[derive(Debug, Clone, PartialEq)]
pub struct Corrected {
    /// Its name.
    pub name: GoalName,
    /// As asked.
    pub goal: Goal,
    /// On a path, s.
    pub time: Option<f64>,
    /// How it ended.
    pub end: End,
    /// The corrected command, if there is one.
    pub point: Option<CompensatedPoint>,
    /// The remaining error of the rotation, rad; zero if none is asked for.
    pub left_angle: f64,
    /// Whether an actuator arrives from another side with the corrected commands than the correction assumes.
    pub wavers: bool,
    /// Whether the step to it is too fast for an actuator.
    pub is_too_fast: bool,
    /// Actuators outside the measured range there.
    pub beyond: Vec<Beyond>,
    /// Whether its standard deviation is larger than the trusted one.
    pub is_untrusted: bool,
}

impl Corrected {
    /// Standard deviation of the corrected position in space, m.
    pub fn sigma(&self) -> Option<f64> {
        self.point.as_ref()?.covariance.map(|covariance| covariance.trace().sqrt())
    }
}

/// Mean, root mean square and largest of some lengths, m.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Lengths {
    /// How many.
    pub count: usize,
    /// m
    pub mean: f64,
    /// m
    pub rms: f64,
    /// m
    pub max: f64,
}

impl Lengths {
    /// Of these; `None` if there are none.
    pub fn of(lengths: impl Iterator<Item = f64>) -> Option<Self> {
        let (mut count, mut sum, mut squares, mut max) = (0_usize, 0.0, 0.0, 0.0_f64);
        for length in lengths {
            (count, sum, squares, max) =
                (count + 1, sum + length, squares + length * length, max.max(length));
        }
        let n = count as f64;
        (count > 0).then(|| Self { count, mean: sum / n, rms: (squares / n).sqrt(), max })
    }
}

/// Corrected commands, with remarks.
#[derive(Debug, Clone, PartialEq)]
pub struct Compensation {
    /// Name of the file of the goals.
    pub file: String,
    /// Name of the robot.
    pub robot: String,
    /// Of the estimate.
    pub mode: Mode,
    /// Hash of the nominal model, hexadecimal.
    pub model_sha256: String,
    /// Program that made the estimate.
    pub estimated_by: String,
    /// In their order.
    pub actuators: Vec<Actuator>,
    /// Where the estimate was measured.
    pub region: Region,
    /// As asked.
    pub tool: Tool,
    /// Its name for people.
    pub tool_name: String,
    /// As asked.
    pub criterion: Criterion,
    /// Whether the goals are a path.
    pub is_path: bool,
    /// How many goals there are.
    pub asked: usize,
    /// As many, or fewer if it was interrupted.
    pub points: Vec<Corrected>,
    /// Steps that are too fast for an actuator.
    pub exceeded: Vec<SpeedExcess>,
    /// Of every actuator, m/s or rad/s, infinite if unknown; empty if all are.
    pub speed_limits: Vec<f64>,
    /// As asked, m.
    pub trust: Option<f64>,
    /// Offsets over a box.
    pub grid: Option<CorrectionGrid>,
    /// What a person must look at.
    pub doubts: Vec<String>,
    /// Further remarks.
    pub remarks: Vec<String>,
}

impl Compensation {
    /// Goals with a corrected command.
    pub fn corrected(&self) -> impl Iterator<Item = (&Corrected, &CompensatedPoint)> {
        self.points.iter().filter_map(|point| point.point.as_ref().map(|found| (point, found)))
    }

    /// Predicted errors of the nominal commands.
    pub fn before(&self) -> Option<Lengths> {
        Lengths::of(self.corrected().map(|(_, point)| point.uncompensated.norm()))
    }

    /// Remaining errors on the model.
    pub fn left(&self) -> Option<Lengths> {
        Lengths::of(self.corrected().map(|(_, point)| point.missed()))
    }

    /// Standard deviations in space.
    pub fn sigmas(&self) -> Option<Lengths> {
        Lengths::of(self.points.iter().filter_map(Corrected::sigma))
    }

    /// How many goals have this property.
    pub fn count(&self, is: impl Fn(&Corrected) -> bool) -> usize {
        self.points.iter().filter(|point| is(point)).count()
    }

    /// The largest correction of an actuator's command, m or rad.
    pub fn largest_change(&self, actuator: usize) -> Option<f64> {
        let change = |(_, point): (_, &CompensatedPoint)| {
            Some((point.command.get(actuator)? - point.nominal.get(actuator)?).abs())
        };
        self.corrected().filter_map(change).reduce(f64::max)
    }

    /// Consecutive points of a path without a gap or a jump, in threes or so.
    fn runs(&self, length: usize) -> impl Iterator<Item = &[Corrected]> {
        self.points.windows(length).filter(|points| {
            points.iter().all(|point| point.point.is_some())
                && points.iter().skip(1).all(|point| point.end == End::Met)
        })
    }

    /// The largest speed of an actuator between points of a path, m/s or rad/s.
    pub fn largest_speed(&self, actuator: usize) -> Option<f64> {
        let speed = |pair: &[Corrected]| {
            let at = |index: usize| pair[index].point.as_ref()?.command.get(actuator).copied();
            Some((at(1)? - at(0)?).abs() / (pair[1].time? - pair[0].time?))
        };
        self.is_path.then(|| self.runs(2).filter_map(speed).reduce(f64::max)).flatten()
    }

    /// Largest second differences of an actuator's commands along a path, nominal and corrected, m or rad: how smooth they are.
    pub fn bends(&self, actuator: usize) -> Option<[f64; 2]> {
        let second = |run: &[Corrected], of: fn(&CompensatedPoint) -> &Vec<f64>| {
            let at = |index: usize| of(run[index].point.as_ref()?).get(actuator).copied();
            Some((at(0)? - 2.0 * at(1)? + at(2)?).abs())
        };
        let largest = |of: fn(&CompensatedPoint) -> &Vec<f64>| {
            self.runs(3).filter_map(|run| second(run, of)).reduce(f64::max)
        };
        if self.is_path { Some([largest(|p| &p.nominal)?, largest(|p| &p.command)?]) } else { None }
    }
}

/// Reports what is being done, and how much of how much is done; asks whether to go on.
pub type Tell<'t> = &'t mut dyn FnMut(&'static str, usize, usize) -> ControlFlow<()>;

/// Corrects commands. Points that cannot be met are part of the result, and so is what was done before an interruption.
///
/// # Errors
///
/// [`CompensationError`] for an invalid request.
pub fn compensate(
    estimate: &EstimateFile,
    plan: &CompensationPlan,
    tell: Tell<'_>,
) -> Result<Compensation, CompensationError> {
    let robot = &estimate.estimate.robot;
    let mut compensator = Compensator::of_estimate(&estimate.estimate, plan.tool)?;
    let name = |index: usize| plan.names.get(index).cloned().unwrap_or_default();
    let (mut points, exceeded) = match &plan.way {
        Way::Points(goals) => (each(&mut compensator, goals, plan, tell, &name)?, Vec::new()),
        Way::Path(path) => {
            let total = path.points().len();
            let mut told = |done| tell("correcting", done, total);
            let followed = compensator.path_told(path, &plan.options, &mut told)?;
            let reports = followed.points.into_iter().enumerate();
            (reports.map(|(index, report)| of_report(report, name(index))).collect(), followed.exceeded)
        }
    };
    for point in &mut points {
        finish(point, estimate, plan);
    }
    for excess in &exceeded {
        if let Some(point) = points.get_mut(excess.point) {
            point.is_too_fast = true;
        }
    }
    let stopped = points.len() < plan.way.len();
    let mut unfinished = None;
    let grid = match plan.grid.as_ref().filter(|_| !stopped) {
        Some(grid) => {
            let mut told = |done, total| tell("grid", done, total);
            match compensator.grid_told(grid, &plan.options.inverse, &mut told) {
                Ok(grid) => Some(grid),
                Err(CompensationError::Grid(
                    error @ (GridError::Interrupted { .. } | GridError::OutOfReach),
                )) => {
                    unfinished = Some(error);
                    None
                }
                Err(other) => return Err(other),
            }
        }
        None => None,
    };
    let links = robot.nominal.kinematics.links.iter().enumerate();
    let actuators = links.map(|(index, link)| Actuator {
        name: if link.name.is_empty() { format!("joint {}", index + 1) } else { link.name.clone() },
        kind: link.kind,
        is_commanded: robot.nominal.actuators.is_commanded(index),
    });
    let mut made = Compensation {
        file: plan.file.clone(),
        robot: estimate.robot.name.clone(),
        mode: robot.mode,
        model_sha256: estimate.robot.model_sha256.clone(),
        estimated_by: estimate.software.clone(),
        actuators: actuators.collect(),
        region: estimate.region.clone(),
        tool: plan.tool,
        tool_name: plan.tool_name.clone(),
        criterion: plan.options.inverse.criterion,
        is_path: matches!(plan.way, Way::Path(_)),
        asked: plan.way.len(),
        points,
        exceeded,
        speed_limits: plan.options.speed_limits.clone(),
        trust: plan.trust,
        grid,
        doubts: Vec::new(),
        remarks: Vec::new(),
    };
    made.doubts = judge::doubts(&made, &estimate.estimate, unfinished);
    made.remarks = judge::remarks(&made, estimate, plan);
    Ok(made)
}

/// Every goal separately.
fn each(
    compensator: &mut Compensator<'_>,
    goals: &[Goal],
    plan: &CompensationPlan,
    tell: Tell<'_>,
    name: &dyn Fn(usize) -> GoalName,
) -> Result<Vec<Corrected>, CompensationError> {
    let mut points = Vec::with_capacity(goals.len());
    for (index, goal) in goals.iter().enumerate() {
        if tell("correcting", index, goals.len()).is_break() {
            break;
        }
        let (end, point) = match compensator.point(goal, &plan.options.inverse) {
            Ok(point) => (End::Met, Some(point)),
            Err(
                CompensationError::OutOfCorrection(told)
                | CompensationError::Inverse(InverseError::Unreachable(told)),
            ) => (End::Unreachable(told), None),
            Err(
                CompensationError::Prediction(error)
                | CompensationError::Inverse(InverseError::Prediction(error)),
            ) => (End::Failed(error.to_string()), None),
            Err(other) => return Err(other),
        };
        points.push(begun(name(index), *goal, None, end, point));
    }
    Ok(points)
}

fn begun(
    name: GoalName,
    goal: Goal,
    time: Option<f64>,
    end: End,
    point: Option<CompensatedPoint>,
) -> Corrected {
    Corrected {
        name,
        goal,
        time,
        end,
        point,
        left_angle: 0.0,
        wavers: false,
        is_too_fast: false,
        beyond: Vec::new(),
        is_untrusted: false,
    }
}

fn of_report(report: PathReport, name: GoalName) -> Corrected {
    let (end, point) = match report.status {
        PointStatus::Met(point) => (End::Met, Some(*point)),
        PointStatus::Jumped(point) => (End::Jumped, Some(*point)),
        PointStatus::Unreachable(told) => (End::Unreachable(told), None),
        PointStatus::Failed(why) => (End::Failed(why), None),
        other => (End::Failed(format!("{other:?}")), None),
    };
    let wavers = report.wavers;
    Corrected { wavers, ..begun(name, report.asked.goal, Some(report.asked.time), end, point) }
}

/// A command beyond the measured ones by less counts as at their edge, m or rad.
const EDGE: f64 = 1e-9;

/// Remarks on a corrected point.
fn finish(point: &mut Corrected, estimate: &EstimateFile, plan: &CompensationPlan) {
    let Some(found) = &point.point else { return };
    point.left_angle = left_angle(&point.goal, &plan.tool, found);
    let Region { command_min, command_max, .. } = &estimate.region;
    let ends = command_min.iter().zip(command_max).zip(&found.command).enumerate();
    let beyond = |(actuator, ((low, high), at)): (usize, ((&f64, &f64), &f64))| {
        let by = if at > high { at - high } else { (at - low).min(0.0) };
        (by.abs() > EDGE).then_some(Beyond { actuator, by })
    };
    point.beyond = ends.filter_map(beyond).collect();
    point.is_untrusted = plan.trust.is_some_and(|most| point.sigma().is_none_or(|sigma| sigma > most));
}

fn left_angle(goal: &Goal, tool: &Tool, found: &CompensatedPoint) -> f64 {
    let there = &found.base_from_tool.rotation;
    match goal {
        Goal::Position(_) => 0.0,
        Goal::Axis { direction, .. } => {
            let axis: Vector3<f64> = there * tool.axis();
            axis.cross(direction).norm().atan2(axis.dot(direction))
        }
        Goal::Pose(pose) => (pose.rotation * there.inverse()).angle(),
    }
}
