//! A robot as it was identified, and what it predicts.

use nalgebra::Vector3;
use thiserror::Error;

use super::Mode;
use super::machine::{Machine, MachineError, Prepared};
use calibrig_model::geometry::Transform;
use calibrig_model::measurement::{MeasurementSet, Observation};
use calibrig_model::{CalibrationModel, TermId};

/// A robot as a mode believes it to be: enough, with the nominal model, to predict where a target is seen.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibratedRobot {
    /// Which mode it comes from; decides what bends it.
    pub mode: Mode,
    /// The identified (or nominal) robot.
    pub model: CalibrationModel,
    /// Amplitudes of the terms, m or rad.
    pub terms: Vec<(TermId, f64)>,
    /// `tracker_from_base`, one a station.
    pub stations: Vec<Transform>,
    /// Offsets in the flange frame, m, one a target.
    pub targets: Vec<Vector3<f64>>,
}

/// A pose that a robot cannot take.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum PredictionError {
    /// The observation does not belong to this robot.
    #[error("pose {pose}: its commands, its station or its target are not those of the robot")]
    Foreign {
        /// The pose.
        pose: u32,
    },
    /// The linkage does not close, or the robot finds no rest.
    #[error("pose {pose}: {source}")]
    Machine {
        /// The pose.
        pose: u32,
        /// Why.
        source: MachineError,
    },
}

/// Where a [`CalibratedRobot`] is predicted to be. It is made once for many observations.
#[derive(Debug, Clone)]
pub struct Predictor<'a> {
    robot: &'a CalibratedRobot,
    machine: Machine,
}

impl<'a> Predictor<'a> {
    /// `nominal` is what was known before calibration: the mode "with gravity" takes the deflection from it.
    pub fn new(nominal: &CalibrationModel, robot: &'a CalibratedRobot) -> Self {
        let mut machine = Machine::new(robot.mode, nominal);
        machine.set_terms(robot.terms.iter().map(|(id, _)| *id));
        machine.set_model(&robot.model, robot.terms.iter().map(|(_, amplitude)| *amplitude));
        Self { robot, machine }
    }

    /// Where the observation's target is predicted to be, in the base frame, m.
    pub fn in_base(&mut self, observation: &Observation) -> Result<Vector3<f64>, PredictionError> {
        let pose = observation.pose;
        let Some(target) = self.robot.targets.get(observation.target) else {
            return Err(PredictionError::Foreign { pose });
        };
        self.place(observation)?;
        Ok(self.machine.target(target))
    }

    /// Measured minus predicted position, in the base frame, m: the error that the tables are made of.
    pub fn error_in_base(&mut self, observation: &Observation) -> Result<Vector3<f64>, PredictionError> {
        let Some(tracker_from_base) = self.robot.stations.get(observation.station) else {
            return Err(PredictionError::Foreign { pose: observation.pose });
        };
        let seen = observation.reading.position() - tracker_from_base.translation.vector;
        Ok(tracker_from_base.rotation.inverse() * seen - self.in_base(observation)?)
    }

    /// [`error_in_base`](Self::error_in_base) of every observation.
    pub fn errors(&mut self, set: &MeasurementSet) -> Result<Vec<Vector3<f64>>, PredictionError> {
        set.observations.iter().map(|observation| self.error_in_base(observation)).collect()
    }

    /// `base_from_link` of every link at the observation.
    pub fn links(&mut self, observation: &Observation) -> Result<Vec<Transform>, PredictionError> {
        let told = self.place(observation)?;
        Ok(self.machine.links(&told, &self.robot.model.kinematics))
    }

    fn place(&mut self, observation: &Observation) -> Result<Prepared, PredictionError> {
        let pose = observation.pose;
        if observation.command.len() != self.robot.model.kinematics.joint_count() {
            return Err(PredictionError::Foreign { pose });
        }
        self.machine
            .place_observation(observation)
            .map_err(|source| PredictionError::Machine { pose, source })
    }
}
