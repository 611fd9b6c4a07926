//! Commands with which an identified robot puts its tool where it should be.
//!
//! A controller computes its commands for the rigid nominal robot. [`Compensator`] starts from these, with the redundancy resolved by a
//! [`Criterion`](crate::inverse::Criterion) as for the nominal robot, and makes the smallest change that brings the *identified* robot's tool to the
//! goal: with its deflection as its mode predicts it, and its terms. So corrected commands are as smooth as the nominal ones. A
//! [path](Compensator::path) accounts for the side from which every actuator comes; a [grid](Compensator::grid) is for controllers that accept only
//! offsets.

mod grid;
mod path;
mod point;
mod raster;
mod speed;
mod travel;

use thiserror::Error;

pub use grid::{CorrectionGrid, GridError, GridPlan, GridSpread};
pub use path::{CompensatedPath, PathError, PathOptions, PathPoint, PathReport, PointStatus, ToolPath};
pub use point::CompensatedPoint;
pub use raster::{Raster, RasterError};
pub use speed::SpeedExcess;
pub use travel::Travel;

use crate::identification::{CalibratedRobot, Estimate, EstimatePredictor, Mode, PredictionError};
use crate::inverse::{
    Circumstances, Goal, InverseError, InverseKinematics, InverseOptions, Tool, Unreachable,
};
use calibrig_model::geometry::Transform;

/// Why commands cannot be corrected.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum CompensationError {
    /// The goal cannot be met, or goal or options are refused.
    #[error(transparent)]
    Inverse(#[from] InverseError),
    /// The rigid nominal robot meets the goal, but the identified one does not, within the limits.
    #[error("the nominal robot reaches the goal, but the identified one does not: {0}")]
    OutOfCorrection(Box<Unreachable>),
    /// The robot is refused, or has no equilibrium.
    #[error(transparent)]
    Prediction(#[from] PredictionError),
    /// The path is refused.
    #[error(transparent)]
    Path(#[from] PathError),
    /// The grid is refused.
    #[error(transparent)]
    Grid(#[from] GridError),
}

/// Corrects commands of an identified robot with a tool. It is made once for many goals.
#[derive(Debug, Clone)]
pub struct Compensator<'a> {
    inverse: InverseKinematics<'a>,
    certainty: Option<EstimatePredictor<'a>>,
}

impl<'a> Compensator<'a> {
    /// A compensator for a robot only: without the uncertainty of its corrected points.
    ///
    /// # Errors
    ///
    /// [`CompensationError::Inverse`], where the robot is refused.
    pub fn new(robot: &'a CalibratedRobot, tool: Tool) -> Result<Self, CompensationError> {
        Ok(Self { inverse: InverseKinematics::of_robot(robot, tool)?, certainty: None })
    }

    /// A compensator for an estimate, whose covariance gives the uncertainty of every corrected point.
    ///
    /// # Errors
    ///
    /// As [`new`](Self::new); and [`CompensationError::Prediction`], where the estimate does not belong to its robot.
    pub fn of_estimate(estimate: &'a Estimate, tool: Tool) -> Result<Self, CompensationError> {
        Ok(Self { certainty: Some(estimate.predictor()?), ..Self::new(&estimate.robot, tool)? })
    }

    /// Mode of the robot for which commands are corrected.
    pub fn mode(&self) -> Mode {
        self.inverse.mode()
    }

    /// The corrected command for one goal.
    ///
    /// # Errors
    ///
    /// [`CompensationError::Inverse`], also for a goal that the nominal robot cannot meet; [`CompensationError::OutOfCorrection`].
    pub fn point(
        &mut self,
        goal: &Goal,
        options: &InverseOptions,
    ) -> Result<CompensatedPoint, CompensationError> {
        let nominal = self.inverse.solve_nominal(goal, options)?.command;
        self.correct(goal, nominal, options)
    }

    /// The corrected command for a goal that a nominal command meets: the one nearest to it, by least squares, at which the identified robot meets
    /// the goal.
    ///
    /// # Errors
    ///
    /// As [`point`](Self::point).
    pub fn corrected(
        &mut self,
        goal: &Goal,
        nominal: Vec<f64>,
        options: &InverseOptions,
    ) -> Result<CompensatedPoint, CompensationError> {
        options.circumstances.payload.as_ref().map_or(Ok(()), |payload| {
            payload.check().map_err(|error| CompensationError::Inverse(InverseError::Payload(error)))
        })?;
        self.correct(goal, nominal, options)
    }

    /// Corrects a nominal command that meets the goal.
    fn correct(
        &mut self,
        goal: &Goal,
        nominal: Vec<f64>,
        options: &InverseOptions,
    ) -> Result<CompensatedPoint, CompensationError> {
        let corrected = self.inverse.correct(goal, &nominal, options)?;
        let corrected = match corrected {
            Ok(corrected) => corrected,
            // Where the shortest correction ends at a limit, another one may not.
            Err(told) => match self
                .inverse
                .solve(goal, &InverseOptions { reference: Some(nominal.clone()), ..options.clone() })
            {
                Ok(found) => found,
                Err(InverseError::Unreachable(_)) => return Err(CompensationError::OutOfCorrection(told)),
                Err(other) => return Err(other.into()),
            },
        };
        let before = self.place(&nominal, &options.circumstances)?;
        let covariance = match &mut self.certainty {
            Some(predictor) => {
                let in_flange = self.inverse.tool().flange_from_tool().translation.vector;
                predictor.covariance_of(options.circumstances.at(&corrected.command), &in_flange)?
            }
            None => None,
        };
        Ok(CompensatedPoint {
            goal: *goal,
            uncompensated: before.translation.vector - goal.position(),
            nominal,
            base_from_tool: corrected.base_from_tool,
            command: corrected.command,
            limits: corrected.limits,
            approach: options.circumstances.approach.clone(),
            covariance,
        })
    }

    /// Place of the identified robot's tool at a command.
    fn place(
        &mut self,
        command: &[f64],
        circumstances: &Circumstances,
    ) -> Result<Transform, PredictionError> {
        self.inverse.predicted(command, circumstances)
    }
}
