//! Calibrates measured sets in every mode, and judges each result. Nothing here knows the truth.

mod choice;
mod judgement;
mod residuals;
mod splits;
mod worth;

pub use choice::{ALL_TERMS, ChosenRow, DEFAULT_TERMS, FailedVariant, ModelChoice, choose};
pub use judgement::{Confidence, FALSE_ALARM, Judgement, Outside, PredictedPosition, judge};
pub use residuals::ObservationResidual;
pub use splits::{SplitMode, SplitPlan, SplitStudy, pose_count, repeat_splits, without_gross_errors};
pub use worth::Worse;

use nalgebra::Vector3;
use thiserror::Error;

use crate::evaluation::{ModeOutcome, RegistrationSummary, accuracy};
use crate::identification::{
    CalibratedRobot, IdentificationOptions, IdentifyError, Mode, PredictionError, Predictor, identify,
    without_calibration,
};
use calibrig_model::CalibrationModel;
use calibrig_model::measurement::{MeasurementSet, SetOutcome};

/// Why sets cannot be calibrated.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum CalibrateError {
    /// A mode cannot be identified.
    #[error("{}: {source}", mode.title())]
    Identify {
        /// Which mode.
        mode: Mode,
        /// Why.
        source: IdentifyError,
    },
    /// An identified robot cannot take a measured pose.
    #[error("{}: {source}", mode.title())]
    Predict {
        /// Which mode.
        mode: Mode,
        /// Why.
        source: PredictionError,
    },
    /// A random split cannot be calibrated.
    #[error("split {split}: {source}")]
    Split {
        /// Number of the split, from one.
        split: usize,
        /// Why.
        source: Box<CalibrateError>,
    },
}

impl CalibrateError {
    /// Why a mode could not be identified, also in a split; `None` where a prediction failed.
    pub fn cause(&self) -> Option<&IdentifyError> {
        match self {
            Self::Identify { source, .. } => Some(source),
            Self::Split { source, .. } => source.cause(),
            Self::Predict { .. } => None,
        }
    }
}

/// Identifies the robot in every mode and evaluates it on every set. The first set is the one that is fitted.
///
/// It sees only measurements and the nominal model: simulated, replayed and real data are treated the same.
pub fn calibrate(
    model: &CalibrationModel,
    sets: &[SetOutcome],
    modes: &[Mode],
    options: &IdentificationOptions,
) -> Result<(RegistrationSummary, Vec<ModeOutcome>), CalibrateError> {
    let empty = MeasurementSet::default();
    let fitted = sets.first().map_or(&empty, |set| &set.measurements);
    let registered = without_calibration(model, fitted, options.solver.loss)
        .map_err(|source| CalibrateError::Identify { mode: Mode::WithoutCalibration, source })?;
    let rms = accuracy(&errors(&registered, fitted)?).map_or(0.0, |row| row.rms_3d);
    let registration = RegistrationSummary {
        how: if fitted.targets.iter().all(|t| t.covariance.is_none()) {
            "best fit of the nominal robot to the identification set, tracker frame and target offset free"
        } else if fitted.targets.iter().any(|t| t.covariance.is_none()) {
            "best fit of the nominal robot to the identification set, tracker frame and offsets of targets that were not measured free"
        } else {
            "best fit of the nominal robot to the identification set, tracker frame free"
        }
        .to_owned(),
        poses: pose_count(fitted),
        rms,
    };
    let outcomes = modes
        .iter()
        .map(|&mode| {
            let estimate = match mode {
                Mode::WithoutCalibration => None,
                _ => {
                    let options = IdentificationOptions { mode, ..options.clone() };
                    Some(
                        identify(model, fitted, &options)
                            .map_err(|source| CalibrateError::Identify { mode, source })?,
                    )
                }
            };
            let robot = estimate.as_ref().map_or_else(|| registered.clone(), |e| e.robot.clone());
            let errors: Vec<_> = sets
                .iter()
                .map(|set| errors(&robot, &set.measurements))
                .collect::<Result<_, CalibrateError>>()?;
            let rows = errors.iter().map(|e| accuracy(e)).collect();
            let turns = sets.iter().map(|set| turns(&robot, &set.measurements)).collect::<Result<_, _>>()?;
            Ok(ModeOutcome { mode, robot, estimate, errors, rows, turns })
        })
        .collect::<Result<_, CalibrateError>>()?;
    Ok((registration, outcomes))
}

/// Measured minus predicted positions in the base frame, m, one per observation.
pub fn errors(robot: &CalibratedRobot, set: &MeasurementSet) -> Result<Vec<Vector3<f64>>, CalibrateError> {
    Predictor::new(robot)
        .and_then(|mut predictor| predictor.errors(set))
        .map_err(|source| CalibrateError::Predict { mode: robot.mode, source })
}

/// Measured against predicted orientations, rotation vectors in base axes, rad, one per observation; `None` where a reading has no orientation.
pub fn turns(
    robot: &CalibratedRobot,
    set: &MeasurementSet,
) -> Result<Vec<Option<Vector3<f64>>>, CalibrateError> {
    if !set.has_poses() {
        return Ok(vec![None; set.observations.len()]);
    }
    Predictor::new(robot)
        .and_then(|mut predictor| predictor.turns(set))
        .map_err(|source| CalibrateError::Predict { mode: robot.mode, source })
}
