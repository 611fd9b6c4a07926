//! Results of a robot that was sent to goals with corrected commands: where its tool arrived, against where it should be.

use nalgebra::Vector3;

use super::iso9283::{PositionAccuracy, PositionRepeatability, TestCube};
use super::{AccuracyRow, accuracy};
use crate::identification::{CalibratedRobot, Mode, PredictionError, Predictor};
use crate::inverse::Criterion;
use calibrig_model::measurement::{MeasurementSet, SetOutcome};

/// Results of the commands of every mode at the same goals. The mode [`WithoutCalibration`](Mode::WithoutCalibration) stands for the nominal
/// commands.
#[derive(Debug, Clone, PartialEq)]
pub struct ClosedLoop {
    /// Number of coordinates of a goal: 3 for a position, 5 with the direction of one axis, 6 for a pose.
    pub rows_of_goal: usize,
    /// Criterion that chooses among the commands that meet a goal; `None` where the planned command of a pose decides.
    pub redundancy: Option<Criterion>,
    /// Results at the poses of the verification set, nominal commands first.
    pub modes: Vec<DrivenMode>,
    /// Results at the same poses with the redundancy resolved in other ways, with the commands of one mode.
    pub criteria: Vec<DrivenCriterion>,
    /// Results of cycles over the poses of ISO 9283, if these were asked for.
    pub pose_test: Option<DrivenPoseTest>,
    /// Results on a path, if one was asked for.
    pub path: Option<DrivenPath>,
    /// What could not be driven, and why.
    pub failures: Vec<DriveFailure>,
}

/// Something that could not be driven.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DriveFailure {
    /// What could not be driven, in words.
    pub what: String,
    /// Why.
    pub why: String,
}

/// The commands of one mode, and what was measured with them.
#[derive(Debug, Clone, PartialEq)]
pub struct DrivenMode {
    /// Which mode.
    pub mode: Mode,
    /// Measurements of every target, as in the session.
    pub set: SetOutcome,
    /// The tool at its goals, one entry per reading of it.
    pub points: Vec<DrivenPoint>,
    /// Poses whose goal the mode cannot meet, with the reason: they were driven with their nominal command and are not counted.
    pub uncorrected: Vec<(u32, String)>,
    /// Poses of which only the position is corrected, with the reason: the complete goal would have needed another pose of the arm.
    pub position_alone: Vec<(u32, String)>,
}

/// A reading of the tool at a goal.
#[derive(Debug, Clone, PartialEq)]
pub struct DrivenPoint {
    /// Number of the pose, or index of the point in its path, from 0.
    pub pose: u32,
    /// Where the tool should be, in the base frame, m.
    pub goal: Vector3<f64>,
    /// Where the tool was measured, in the base frame that the mode identified, m.
    pub measured: Vector3<f64>,
    /// Command, m or rad.
    pub command: Vec<f64>,
    /// Standard deviations of the tool's position that the estimate predicts, along the base's axes, m; `None` without a prediction.
    pub sigma: Option<Vector3<f64>>,
}

impl DrivenPoint {
    /// Measured minus goal, m.
    pub fn error(&self) -> Vector3<f64> {
        self.measured - self.goal
    }
}

impl DrivenMode {
    /// The row of the table, measured minus goal; `None` where nothing was measured.
    pub fn row(&self) -> Option<AccuracyRow> {
        row(&self.points)
    }
}

/// The row of a table, measured minus goal; `None` without points.
pub fn row(points: &[DrivenPoint]) -> Option<AccuracyRow> {
    accuracy(&points.iter().map(DrivenPoint::error).collect::<Vec<_>>())
}

/// Results of another way to resolve the redundancy.
#[derive(Debug, Clone, PartialEq)]
pub struct DrivenCriterion {
    /// Criterion that is minimised; `None` for the commands as planned.
    pub criterion: Option<Criterion>,
    /// Mode of the corrected commands.
    pub mode: Mode,
    /// Predicted deflection of the tool at the commands: mean and largest, m. `None` for a robot without known masses and stiffnesses.
    pub droop: Option<[f64; 2]>,
    /// Nominal commands: measured minus goal.
    pub nominal: Option<AccuracyRow>,
    /// Corrected commands: measured minus goal.
    pub corrected: Option<AccuracyRow>,
    /// Number of goals that could not be met.
    pub missed: usize,
    /// Number of goals whose position alone was corrected.
    pub position_alone: usize,
}

/// Cycles over the poses of a test cube (ISO 9283), against the commanded positions.
#[derive(Debug, Clone, PartialEq)]
pub struct DrivenPoseTest {
    /// The cube.
    pub cube: TestCube,
    /// Number of cycles.
    pub cycles: usize,
    /// Accuracy and repeatability at each pose, nominal commands first.
    pub modes: Vec<(Mode, Vec<(PositionAccuracy, PositionRepeatability)>)>,
}

/// A path that was driven with the commands of every mode.
#[derive(Debug, Clone, PartialEq)]
pub struct DrivenPath {
    /// Length of the tool's path, m.
    pub length: f64,
    /// Speed of the tool, m/s.
    pub speed: f64,
    /// Points that the nominal robot cannot reach, with the reason.
    pub unreachable: Vec<(u32, String)>,
    /// Results of every mode, nominal commands first.
    pub modes: Vec<DrivenMode>,
}

/// Measured positions of the targets in the base frame of a robot, m, one entry per observation; readings are corrected for the identified errors
/// of the instrument.
///
/// # Errors
///
/// [`PredictionError`], for measurements that do not belong to this robot.
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
