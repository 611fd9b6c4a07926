//! An identified robot, and its predictions.

use nalgebra::{Matrix3, Rotation3, Vector3, Vector6};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::forward_model::{ForwardModel, Prepared};
use super::noise::{ActuatorMotions, MachineNoise};
use super::problem::{in_base_column, left_jacobian};
use super::turns::turn_column;
use super::{Estimate, Mode, PositionJacobian};
use crate::elastostatics::ElasticError;
use calibrig_model::geometry::{Transform, rotation_vector};
use calibrig_model::measurement::{DRIFT_UNIT, InstrumentTerm, MeasurementSet, Observation, Reading};
use calibrig_model::{CalibrationModel, Compliance, ModelError, ParameterId, PoseQuery, TermId};

/// A robot as a mode identified it: everything that is needed to predict where a target is seen.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CalibratedRobot {
    /// Mode by which it was identified; decides what bends the robot.
    pub mode: Mode,
    /// What was known before calibration. The mode "with gravity" takes the deflection from it, terms take the middle of the joints' travel.
    pub nominal: CalibrationModel,
    /// The identified (or nominal) robot.
    pub model: CalibrationModel,
    /// Amplitudes of the terms, m or rad.
    pub terms: Vec<(TermId, f64)>,
    /// `tracker_from_base`, one per station.
    pub stations: Vec<Transform>,
    /// Offsets in the flange frame, m, one per target.
    pub targets: Vec<Vector3<f64>>,
    /// Errors of the instrument at every station, by which its readings are corrected. Empty where none was identified.
    pub instruments: Vec<InstrumentErrors>,
    /// `flange_from_target`, one per target; `None` for a point.
    #[serde(default)]
    pub orientations: Vec<Option<Rotation3<f64>>>,
}

/// Systematic errors of a station's readings.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct InstrumentErrors {
    /// Errors that all readings share, m, rad or 1.
    pub shared: Vec<(InstrumentTerm, f64)>,
    /// Motion of the station per hour, as a displacement of the base as the station sees it, m and rad.
    pub drift: Vector6<f64>,
    /// Time at which the station stood where it was placed, s.
    pub placed_at: f64,
}

impl InstrumentErrors {
    /// Displacement of a reading taken at a time (s) from a station at its place, m in the tracker's axes.
    pub fn displacement(&self, reading: &Reading, time: f64, tracker_from_base: &Transform) -> Vector3<f64> {
        let shared = self.shared.iter().map(|(term, amplitude)| reading.displaced_by(*term) * *amplitude);
        let hours = (time - self.placed_at) / DRIFT_UNIT;
        let seen = reading.position();
        let drift = (0..6)
            .map(|part| drift_displacement(part, &seen, tracker_from_base) * (self.drift[part] * hours));
        shared.chain(drift).sum()
    }
}

/// Displacement of a point that the tracker sees at `seen` per unit of a component of the base's displacement, m in the tracker's axes.
pub(super) fn drift_displacement(
    component: usize,
    seen: &Vector3<f64>,
    tracker_from_base: &Transform,
) -> Vector3<f64> {
    let rotation = &tracker_from_base.rotation;
    let axis = Vector3::ith(component % 3, 1.0);
    if component < 3 {
        return rotation * axis;
    }
    let in_base = rotation.inverse() * (seen - tracker_from_base.translation.vector);
    rotation * axis.cross(&in_base)
}

impl CalibratedRobot {
    /// Numbers of the robot outside its two models, each with a name for error messages.
    fn numbers(&self) -> impl Iterator<Item = (&'static str, f64)> + '_ {
        let terms = self.terms.iter().map(|(_, amplitude)| ("an amplitude of terms", *amplitude));
        let targets =
            self.targets.iter().flat_map(|offset| offset.iter()).map(|v| ("an offset of targets", *v));
        let placed = |station: &Transform| {
            let rotation = station.rotation.matrix().iter().copied().collect::<Vec<_>>();
            rotation.into_iter().chain(station.translation.vector.iter().copied().collect::<Vec<_>>())
        };
        let stations = self.stations.iter().flat_map(placed).map(|v| ("a place of stations", v));
        let of_station = |own: &InstrumentErrors| {
            let shared = own.shared.iter().map(|(_, value)| *value);
            shared.chain(own.drift.iter().copied()).chain([own.placed_at]).collect::<Vec<_>>()
        };
        let errors = self.instruments.iter().flat_map(of_station).map(|v| ("an error of instruments", v));
        let turned = self.orientations.iter().flatten().flat_map(|rotation| rotation.matrix().iter());
        let turned = turned.map(|v| ("an orientation of targets", *v));
        terms.chain(targets).chain(stations).chain(turned).chain(errors)
    }

    /// Whether an estimate of this robot can have this parameter; `terms` counts the terms before it.
    fn has(&self, id: ParameterId, terms: &mut usize) -> bool {
        let joints = self.nominal.kinematics.joint_count();
        match id {
            ParameterId::Link { link, .. }
            | ParameterId::Mass { link }
            | ParameterId::Compliance(Compliance::Beam { link }) => link < joints,
            ParameterId::Compliance(Compliance::Drive { joint }) => joint < joints,
            ParameterId::Compliance(Compliance::Bearing { joint, axis }) => joint < joints && axis < 6,
            ParameterId::Compliance(Compliance::Rod) | ParameterId::Linkage(_) => true,
            ParameterId::Centre { link, axis } => link < joints && axis < 3,
            ParameterId::Frame { station, component } => station < self.stations.len() && component < 6,
            ParameterId::Target { target, axis } => target < self.targets.len() && axis < 3,
            ParameterId::Instrument { term, .. } => {
                let has = |own: &InstrumentErrors| own.shared.iter().any(|(known, _)| *known == term);
                self.instruments.iter().any(has)
            }
            ParameterId::Drift { station, component } => station < self.instruments.len() && component < 6,
            ParameterId::Orientation { target, axis } => {
                self.orientations.get(target).is_some_and(Option::is_some) && axis < 3
            }
            ParameterId::Term(term) => {
                *terms += 1;
                self.mode == Mode::Extended && self.terms.get(*terms - 1).is_some_and(|(own, _)| *own == term)
            }
        }
    }
}

/// Why a robot's position cannot be predicted.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum PredictionError {
    /// The robot's model is not valid, or the command does not fit the robot.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The robot does not carry this target.
    #[error("target index {target}: the robot has {targets} targets")]
    Target {
        /// Index that was asked for.
        target: usize,
        /// Number of targets.
        targets: usize,
    },
    /// The robot was not identified from this station.
    #[error("station index {station}: the robot was identified from {stations} stations")]
    Station {
        /// Index that was asked for.
        station: usize,
        /// Number of stations.
        stations: usize,
    },
    /// The linkage does not close, or the robot has no stable equilibrium.
    #[error(transparent)]
    Machine(#[from] ElasticError),
    /// A measured pose cannot be predicted.
    #[error("pose {pose}: {source}")]
    Pose {
        /// Number of the pose.
        pose: u32,
        /// Why.
        source: Box<PredictionError>,
    },
}

/// Predicts where the targets of a [`CalibratedRobot`] are. It is made once for many poses.
#[derive(Debug, Clone)]
pub struct Predictor<'a> {
    pub(crate) robot: &'a CalibratedRobot,
    pub(super) forward: ForwardModel,
}

impl<'a> Predictor<'a> {
    /// The predictor of a robot.
    ///
    /// # Errors
    ///
    /// [`PredictionError::Model`], where the identified or the nominal robot is not valid, or the two have different structures.
    pub fn new(robot: &'a CalibratedRobot) -> Result<Self, PredictionError> {
        robot.nominal.check()?;
        for (field, value) in robot.numbers() {
            if !value.is_finite() {
                return Err(
                    ModelError::Number { field, joint: None, value, expected: "a finite number" }.into()
                );
            }
        }
        let mut forward = ForwardModel::new(robot.mode, &robot.nominal);
        forward.fits(&robot.model)?;
        let joints = robot.nominal.kinematics.joint_count();
        if let Some((term, _)) = robot.terms.iter().find(|(term, _)| term.joint() >= joints) {
            return Err(ModelError::Parameter { id: ParameterId::Term(*term) }.into());
        }
        forward.set_terms(robot.terms.iter().map(|(id, _)| *id));
        forward.set_model(&robot.model, robot.terms.iter().map(|(_, amplitude)| *amplitude));
        Ok(Self { robot, forward })
    }

    /// Predicted position of the target in the base frame, m.
    pub fn in_base<'q>(&mut self, pose: impl Into<PoseQuery<'q>>) -> Result<Vector3<f64>, PredictionError> {
        let (target, _) = self.place(&pose.into())?;
        Ok(self.forward.target(&target))
    }

    /// Measured minus predicted position in the base frame, m: the error of the tables.
    pub fn error_in_base(&mut self, observation: &Observation) -> Result<Vector3<f64>, PredictionError> {
        let of_pose = |source| PredictionError::Pose { pose: observation.pose, source: Box::new(source) };
        let (station, stations) = (observation.station, self.robot.stations.len());
        let Some(tracker_from_base) = self.robot.stations.get(station) else {
            return Err(of_pose(PredictionError::Station { station, stations }));
        };
        let errors = self.robot.instruments.get(station);
        let off =
            errors.map(|own| own.displacement(&observation.reading, observation.time, tracker_from_base));
        let read = observation.reading.position() - off.unwrap_or_default();
        let seen = read - tracker_from_base.translation.vector;
        Ok(tracker_from_base.rotation.inverse() * seen - self.in_base(observation).map_err(of_pose)?)
    }

    /// `base_from_target` at a pose, rotation only; `None` for a target that is a point.
    pub fn orientation_in_base<'q>(
        &mut self,
        pose: impl Into<PoseQuery<'q>>,
    ) -> Result<Option<Rotation3<f64>>, PredictionError> {
        let pose = pose.into();
        self.place(&pose)?;
        let mounted = self.robot.orientations.get(pose.target).copied().flatten();
        Ok(mounted.map(|flange_from_target| self.forward.rotation() * flange_from_target))
    }

    /// Measured against predicted orientation: φ with `exp(φ) · predicted = measured`, in the axes of the base frame, rad. `None` for a reading
    /// without an orientation, or a target that is a point.
    pub fn turn_in_base(
        &mut self,
        observation: &Observation,
    ) -> Result<Option<Vector3<f64>>, PredictionError> {
        let Reading::Pose(reading) = &observation.reading else { return Ok(None) };
        let of_pose = |source| PredictionError::Pose { pose: observation.pose, source: Box::new(source) };
        let (station, stations) = (observation.station, self.robot.stations.len());
        let Some(tracker_from_base) = self.robot.stations.get(station) else {
            return Err(of_pose(PredictionError::Station { station, stations }));
        };
        let predicted = self.orientation_in_base(observation).map_err(of_pose)?;
        let seen = tracker_from_base.rotation.inverse() * reading.rotation;
        Ok(predicted.map(|predicted| rotation_vector(&(seen * predicted.inverse()))))
    }

    /// [`turn_in_base`](Self::turn_in_base) for every observation.
    pub fn turns(&mut self, set: &MeasurementSet) -> Result<Vec<Option<Vector3<f64>>>, PredictionError> {
        set.observations.iter().map(|observation| self.turn_in_base(observation)).collect()
    }

    /// [`error_in_base`](Self::error_in_base) for every observation.
    pub fn errors(&mut self, set: &MeasurementSet) -> Result<Vec<Vector3<f64>>, PredictionError> {
        set.observations.iter().map(|observation| self.error_in_base(observation)).collect()
    }

    /// `base_from_link` of every link at the pose.
    pub fn links<'q>(&mut self, pose: impl Into<PoseQuery<'q>>) -> Result<Vec<Transform>, PredictionError> {
        let (_, told) = self.place(&pose.into())?;
        Ok(self.forward.links(&told, &self.robot.model.kinematics))
    }

    /// Moves the robot to a pose; returns the offset of its target.
    fn place(&mut self, pose: &PoseQuery<'_>) -> Result<(Vector3<f64>, Prepared), PredictionError> {
        let (target, targets) = (pose.target, self.robot.targets.len());
        let Some(in_flange) = self.robot.targets.get(target) else {
            return Err(PredictionError::Target { target, targets });
        };
        Ok((*in_flange, self.place_robot(pose)?))
    }

    /// Moves the robot to a pose.
    pub(super) fn place_robot(&mut self, pose: &PoseQuery<'_>) -> Result<Prepared, PredictionError> {
        let chain = &self.robot.model.kinematics;
        chain.check_joints("command", pose.command)?;
        let (found, expected) = (pose.approach.len(), chain.joint_count());
        if found != 0 && found != expected {
            return Err(ModelError::Length { field: "approach", found, expected }.into());
        }
        Ok(self.forward.place_at(pose)?)
    }
}

/// Predicted place of a target in the robot's own base frame; the tracker's place and its uncertainty do not enter.
#[derive(Debug, Clone, PartialEq)]
pub struct Prediction {
    /// Predicted position, m.
    pub position: Vector3<f64>,
    /// Covariance of the robot's mean position, m², from the parameters and the machine's noise beside its model. The noise of a reading
    /// there comes on top. `None` where the estimate has no covariance.
    pub covariance: Option<Matrix3<f64>>,
    /// The part of the covariance that comes from the machine's noise beside its model, m².
    pub of_machine: Matrix3<f64>,
    /// Derivative of the position with respect to the estimate's parameters, 3 x n.
    pub jacobian: PositionJacobian,
    /// Predicted orientation; `None` for a point.
    pub orientation: Option<PredictedOrientation>,
}

/// Predicted orientation of a target in the robot's base frame.
#[derive(Debug, Clone, PartialEq)]
pub struct PredictedOrientation {
    /// `base_from_target`.
    pub rotation: Rotation3<f64>,
    /// Covariance of the rotation vector φ in `exp(φ) · rotation`, base axes, rad², from the parameters and the machine's noise beside its
    /// model. `None` where the estimate has no covariance.
    pub covariance: Option<Matrix3<f64>>,
    /// Derivative of φ with respect to the estimate's parameters, 3 x n.
    pub jacobian: PositionJacobian,
}

impl PredictedOrientation {
    /// Standard deviations about the base's axes, rad.
    pub fn sigma(&self) -> Option<Vector3<f64>> {
        self.covariance.map(|covariance| covariance.diagonal().map(f64::sqrt))
    }
}

impl Prediction {
    /// Standard deviations along the base's axes, m.
    pub fn sigma(&self) -> Option<Vector3<f64>> {
        self.covariance.map(|covariance| covariance.diagonal().map(f64::sqrt))
    }

    /// Covariance of a new reading about the position, m²; `noise` is the covariance of the reading alone in the base frame, m².
    pub fn reading_covariance(&self, noise: &Matrix3<f64>) -> Option<Matrix3<f64>> {
        self.covariance.map(|covariance| covariance + noise)
    }
}

/// Predictions of an [`Estimate`] with their uncertainty. It is made once for many poses.
#[derive(Debug, Clone)]
pub struct EstimatePredictor<'a> {
    pub(super) estimate: &'a Estimate,
    pub(super) predictor: Predictor<'a>,
    pub(super) beside: Vec<MachineNoise>,
    pub(super) motions: ActuatorMotions,
}

impl Estimate {
    /// Predicted place of the target at a pose, such as a command (m or rad, one number per actuator).
    ///
    /// # Errors
    ///
    /// [`PredictionError`], for a command that does not fit this robot, a target that it does not carry, or a pose that it cannot take.
    pub fn predict<'q>(&self, pose: impl Into<PoseQuery<'q>>) -> Result<Prediction, PredictionError> {
        self.predictor()?.predict(pose)
    }

    /// A predictor for many poses.
    ///
    /// # Errors
    ///
    /// As [`Predictor::new`]; and [`PredictionError::Model`] where a parameter does not belong to the robot.
    pub fn predictor(&self) -> Result<EstimatePredictor<'_>, PredictionError> {
        let predictor = Predictor::new(&self.robot)?;
        let mut terms = 0;
        if let Some(parameter) = self.parameters.iter().find(|p| !self.robot.has(p.id, &mut terms)) {
            return Err(ModelError::Parameter { id: parameter.id }.into());
        }
        let motions = ActuatorMotions::new(&self.robot.nominal);
        Ok(EstimatePredictor { estimate: self, predictor, beside: self.beside(), motions })
    }
}

impl EstimatePredictor<'_> {
    /// Predicted place of the target at a pose.
    ///
    /// # Errors
    ///
    /// As [`Estimate::predict`].
    pub fn predict<'q>(&mut self, pose: impl Into<PoseQuery<'q>>) -> Result<Prediction, PredictionError> {
        self.predict_at(&pose.into())
    }

    /// Not generic: a generic function is compiled in the caller's crate, with the caller's optimisation.
    fn predict_at(&mut self, pose: &PoseQuery<'_>) -> Result<Prediction, PredictionError> {
        let (target, told) = self.predictor.place(pose)?;
        let forward = &mut self.predictor.forward;
        forward.differentiate(&target, &told)?;
        let position = forward.target(&target);
        let parameters = &self.estimate.parameters;
        let mut jacobian = PositionJacobian::zeros(parameters.len());
        let mut term = 0;
        for (mut column, parameter) in jacobian.column_iter_mut().zip(parameters) {
            column.copy_from(&in_base_column(forward, parameter.id, pose.target, &position, &mut term));
        }
        let factor = self.estimate.factor.as_ref().filter(|factor| factor.nrows() == parameters.len());
        let motions = self.motions.at(pose.command, &target);
        let of_machine = self.beside.iter().map(|part| part.covariance(&motions)).sum::<Matrix3<f64>>();
        let covariance = factor.map(|factor| {
            let spread = &jacobian * factor;
            &spread * spread.transpose() + of_machine
        });
        let orientation = self.orientation(pose, &told)?;
        Ok(Prediction { position, covariance, of_machine, jacobian, orientation })
    }

    /// Predicted orientation of a pose's target; the robot has been moved to the pose.
    fn orientation(
        &mut self,
        pose: &PoseQuery<'_>,
        told: &Prepared,
    ) -> Result<Option<PredictedOrientation>, PredictionError> {
        let mounted = self.estimate.robot.orientations.get(pose.target).copied().flatten();
        let Some(flange_from_target) = mounted else { return Ok(None) };
        let forward = &mut self.predictor.forward;
        forward.differentiate_turn(told)?;
        let parameters = &self.estimate.parameters;
        let turned = |axis: usize| {
            let id = ParameterId::Orientation { target: pose.target, axis };
            self.estimate.value(id).unwrap_or(0.0)
        };
        let turned = Vector3::from_fn(|axis, _| turned(axis));
        let rotation = forward.rotation() * flange_from_target;
        // The parameters displace the stated orientation, and `flange_from_target` is already displaced: it is turned back first.
        let by_target =
            rotation.matrix() * Rotation3::new(turned).inverse().matrix() * left_jacobian(&turned);
        let mut jacobian = PositionJacobian::zeros(parameters.len());
        let mut term = 0;
        for (mut column, parameter) in jacobian.column_iter_mut().zip(parameters) {
            column.copy_from(&match parameter.id {
                ParameterId::Orientation { target, axis } if target == pose.target => {
                    by_target.column(axis).into_owned()
                }
                id => turn_column(forward, id, &mut term),
            });
        }
        let factor = self.estimate.factor.as_ref().filter(|factor| factor.nrows() == parameters.len());
        let turns = self.motions.turns(pose.command);
        let beside = self.estimate.turn_noise.unwrap_or(0.0);
        let of_actuators = |part: &MachineNoise| {
            let turned = turns.iter().zip(&part.actuators).map(|(turn, sigma)| turn * *sigma);
            turned.map(|turn| turn * turn.transpose()).sum::<Matrix3<f64>>()
        };
        let of_machine = Matrix3::identity() * beside * beside
            + self.beside.iter().map(of_actuators).sum::<Matrix3<f64>>();
        let covariance = factor.map(|factor| {
            let spread = &jacobian * factor;
            &spread * spread.transpose() + of_machine
        });
        Ok(Some(PredictedOrientation { rotation, covariance, jacobian }))
    }
}
