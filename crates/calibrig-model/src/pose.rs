//! What a prediction depends on.

use super::Payload;
use super::measurement::Observation;

/// A pose to predict: the command, and the circumstances that corrections may depend on. SI.
///
/// ```
/// use calibrig_model::PoseQuery;
///
/// let pose = PoseQuery::at(&[0.1, -0.4]).approached(&[1, -1]).with_target(1);
/// assert_eq!((pose.command, pose.target, pose.time), (&[0.1, -0.4][..], 1, 0.0));
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseQuery<'a> {
    /// Actuator commands, m or rad.
    pub command: &'a [f64],
    /// Sign of each actuator's last motion, 0 if unknown; may be empty if all are unknown.
    pub approach: &'a [i8],
    /// How far each actuator has moved since it last reversed, m or rad; empty if unknown, which is treated as far.
    pub since_reversal: &'a [f64],
    /// Of the air at the robot, °C, if known.
    pub temperature: Option<f64>,
    /// Since the session began, s.
    pub time: f64,
    /// Index of the target on the flange.
    pub target: usize,
    /// What the flange carries in addition to its permanent loads.
    pub payload: Option<&'a Payload>,
}

impl<'a> PoseQuery<'a> {
    /// The first target at a command, approached from an unknown side, at time zero, without a payload.
    pub fn at(command: &'a [f64]) -> Self {
        Self {
            command,
            approach: &[],
            since_reversal: &[],
            temperature: None,
            time: 0.0,
            target: 0,
            payload: None,
        }
    }

    /// The same with the signs of the last motions.
    #[must_use]
    pub fn approached(self, approach: &'a [i8]) -> Self {
        Self { approach, ..self }
    }

    /// The same with the distances since the last reversals, m or rad.
    #[must_use]
    pub fn moved(self, since_reversal: &'a [f64]) -> Self {
        Self { since_reversal, ..self }
    }

    /// The same of another target.
    #[must_use]
    pub fn with_target(self, target: usize) -> Self {
        Self { target, ..self }
    }

    /// The same with a payload.
    #[must_use]
    pub fn carrying(self, payload: &'a Payload) -> Self {
        Self { payload: Some(payload), ..self }
    }
}

impl<'a> From<&'a [f64]> for PoseQuery<'a> {
    fn from(command: &'a [f64]) -> Self {
        Self::at(command)
    }
}

impl<'a, const N: usize> From<&'a [f64; N]> for PoseQuery<'a> {
    fn from(command: &'a [f64; N]) -> Self {
        Self::at(command)
    }
}

impl<'a> From<&'a Vec<f64>> for PoseQuery<'a> {
    fn from(command: &'a Vec<f64>) -> Self {
        Self::at(command)
    }
}

impl<'a> From<&'a Observation> for PoseQuery<'a> {
    fn from(observation: &'a Observation) -> Self {
        Self {
            command: &observation.command,
            approach: &observation.approach,
            since_reversal: &observation.since_reversal,
            temperature: observation.temperature,
            time: observation.time,
            target: observation.target,
            payload: observation.payload.as_ref(),
        }
    }
}
