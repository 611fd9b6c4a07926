//! Options of a solution, and why a goal has no solution.

use thiserror::Error;

use super::arm::Circumstances;
use super::criterion::Criterion;
use super::reach::Unreachable;
use super::task::GoalError;
use crate::identification::PredictionError;
use calibrig_model::PayloadError;

/// How a command is sought.
#[derive(Debug, Clone, PartialEq)]
pub struct InverseOptions {
    /// Chooses among the commands that meet the goal.
    pub criterion: Criterion,
    /// Command at which the search begins, and from which the criterion counts motion. If `None`, motion counts from the middle of the joints'
    /// ranges.
    pub reference: Option<Vec<f64>>,
    /// Circumstances for which the identified robot is predicted. For a rigid nominal robot, only the payload counts, and only for the predicted
    /// deflection.
    pub circumstances: Circumstances,
    /// Number of further starts if the first search fails.
    pub starts: usize,
    /// Largest miss of an identified robot, m, with angles multiplied by the lever.
    pub tolerance: f64,
    /// Length that a radian counts as where angles and lengths are compared, m: for distances and for manipulability. A quarter of the robot's
    /// [characteristic length](calibrig_model::KinematicModel::characteristic_length) if not stated.
    pub lever: Option<f64>,
}

impl Default for InverseOptions {
    fn default() -> Self {
        Self {
            criterion: Criterion::default(),
            reference: None,
            circumstances: Circumstances::default(),
            starts: 100,
            tolerance: 1e-9,
            lever: None,
        }
    }
}

/// Why there is no command.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum InverseError {
    /// The goal or the tool is refused.
    #[error(transparent)]
    Goal(#[from] GoalError),
    /// No search met the goal.
    #[error("the goal is out of reach: {0}")]
    Unreachable(Box<Unreachable>),
    /// The robot is refused, the reference is not a command of the robot, or the robot has no equilibrium.
    #[error(transparent)]
    Prediction(#[from] PredictionError),
    /// The payload is refused.
    #[error(transparent)]
    Payload(#[from] PayloadError),
    /// A number is out of its range.
    #[error("{field} is {value}: expected {expected}")]
    Number {
        /// Name of the number.
        field: &'static str,
        /// Value as stated.
        value: f64,
        /// What is expected.
        expected: &'static str,
    },
    /// The criterion asks for a deflection, but the robot's masses and stiffnesses are unknown.
    #[error(
        "the criterion asks for the least deflection, but the robot has no masses and stiffnesses: state them in its file, or \
         choose another criterion"
    )]
    NoStatics,
}

impl InverseError {
    pub(crate) fn of_model(error: calibrig_model::ModelError) -> Self {
        PredictionError::from(error).into()
    }
}

impl InverseOptions {
    pub(super) fn check(&self, bends: bool) -> Result<(), InverseError> {
        for (field, value) in self.criterion.parts() {
            let expected = "a finite weight of zero or more";
            number(field, value, value >= 0.0, expected)?;
        }
        if self.criterion.deflection > 0.0 && !bends {
            return Err(InverseError::NoStatics);
        }
        let least = 1e-12;
        number("tolerance", self.tolerance, self.tolerance >= least, "a length of 1e-12 m or more")?;
        self.lever.map_or(Ok(()), |lever| number("lever", lever, lever > 0.0, "a length above zero, m"))
    }
}

fn number(field: &'static str, value: f64, holds: bool, expected: &'static str) -> Result<(), InverseError> {
    if holds && value.is_finite() { Ok(()) } else { Err(InverseError::Number { field, value, expected }) }
}
