//! A robot that was sent to goals with corrected commands: where its tool came, against where it was to be.

use nalgebra::Vector3;

use super::iso9283::{PositionAccuracy, PositionRepeatability, TestCube};
use super::{AccuracyRow, accuracy};
use crate::identification::{CalibratedRobot, Mode, PredictionError, Predictor};
use crate::inverse::Criterion;
use calibrig_model::measurement::{MeasurementSet, SetOutcome};

/// What came of the commands of every mode at the same goals. The mode [`WithoutCalibration`](Mode::WithoutCalibration) stands for the nominal commands.
#[derive(Debug, Clone, PartialEq)]
pub struct ClosedLoop {
    /// Coordinates of a goal that are met: 3 of a position, 5 with the direction of one axis, 6 of a pose.
    pub rows_of_goal: usize,
    /// What decides between the commands that meet a goal; `None` where the planned command of a pose does.
    pub redundancy: Option<Criterion>,
    /// At the poses of the verification set, nominal commands first.
    pub modes: Vec<DrivenMode>,
    /// The same poses with the redundancy resolved otherwise, with the commands of one mode.
    pub criteria: Vec<DrivenCriterion>,
    /// Cycles over the poses of ISO 9283, where these were asked for.
    pub pose_test: Option<DrivenPoseTest>,
    /// A path, where one was asked for.
    pub path: Option<DrivenPath>,
    /// What of it could not be driven, and why.
    pub failures: Vec<DriveFailure>,
}

/// Something that could not be driven.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DriveFailure {
    /// What, in words.
    pub what: String,
    /// Why.
    pub why: String,
}

/// Commands of one mode, and what was measured with them.
#[derive(Debug, Clone, PartialEq)]
pub struct DrivenMode {
    /// Which.
    pub mode: Mode,
    /// What was measured, as in the session: of every target.
    pub set: SetOutcome,
    /// The tool at its goals, one entry a reading of it.
    pub points: Vec<DrivenPoint>,
    /// Poses whose goal the mode cannot meet, with the reason: they were driven with their nominal command and count nowhere.
    pub uncorrected: Vec<(u32, String)>,
    /// Poses whose position alone is corrected, with the reason: all of the goal would have asked for another pose of the arm.
    pub position_alone: Vec<(u32, String)>,
}

/// A reading of the tool at a goal.
#[derive(Debug, Clone, PartialEq)]
pub struct DrivenPoint {
    /// Number of the pose, or place of the point in its path, from 0.
    pub pose: u32,
    /// Where the tool was to be, in the base frame, m.
    pub goal: Vector3<f64>,
    /// Where it was measured, in the base frame as the mode has it, m.
    pub measured: Vector3<f64>,
    /// What was commanded, m or rad.
    pub command: Vec<f64>,
    /// Standard deviations of the tool's place that the estimate states beforehand, along the base's axes, m; `None` where it states none.
    pub sigma: Option<Vector3<f64>>,
}

impl DrivenPoint {
    /// Measured minus wanted, m.
    pub fn error(&self) -> Vector3<f64> {
        self.measured - self.goal
    }
}

impl DrivenMode {
    /// The row of the table: measured minus wanted; `None` where nothing was measured.
    pub fn row(&self) -> Option<AccuracyRow> {
        row(&self.points)
    }
}

/// The row of a table: measured minus wanted; `None` without a point.
pub fn row(points: &[DrivenPoint]) -> Option<AccuracyRow> {
    accuracy(&points.iter().map(DrivenPoint::error).collect::<Vec<_>>())
}

/// What another way to resolve the redundancy does.
#[derive(Debug, Clone, PartialEq)]
pub struct DrivenCriterion {
    /// What is least; `None` of the commands as planned.
    pub criterion: Option<Criterion>,
    /// Whose commands.
    pub mode: Mode,
    /// How far the tool is predicted to be deflected at the commands: mean and largest, m. `None` of a robot without known masses and stiffnesses.
    pub droop: Option<[f64; 2]>,
    /// Nominal commands: measured minus wanted.
    pub nominal: Option<AccuracyRow>,
    /// Corrected commands.
    pub corrected: Option<AccuracyRow>,
    /// Goals that could not be met.
    pub missed: usize,
    /// Goals whose position alone was corrected.
    pub position_alone: usize,
}

/// Cycles over the poses of a test cube (ISO 9283), against where they were commanded to be.
#[derive(Debug, Clone, PartialEq)]
pub struct DrivenPoseTest {
    /// The cube.
    pub cube: TestCube,
    /// Cycles.
    pub cycles: usize,
    /// Nominal commands first.
    pub modes: Vec<(Mode, Vec<(PositionAccuracy, PositionRepeatability)>)>,
}

/// A path that was driven with the commands of every mode.
#[derive(Debug, Clone, PartialEq)]
pub struct DrivenPath {
    /// Of the way of the tool, m.
    pub length: f64,
    /// m/s
    pub speed: f64,
    /// Points that the nominal robot cannot reach, with the reason.
    pub unreachable: Vec<(u32, String)>,
    /// Nominal commands first.
    pub modes: Vec<DrivenMode>,
}

/// Where a target was measured in the base frame of a robot, m, an entry an observation: its readings freed from what was identified of the instrument.
///
/// # Errors
///
/// [`PredictionError`], for measurements that are not of this robot.
pub fn measured_in_base(
    robot: &CalibratedRobot,
    set: &MeasurementSet,
) -> Result<Vec<Vector3<f64>>, PredictionError> {
    let mut predictor = Predictor::new(robot)?;
    let mut of = |observation| {
        let error = predictor.error_in_base(observation)?;
        Ok(predictor.in_base(observation)? + error)
    };
    set.observations.iter().map(&mut of).collect()
}
