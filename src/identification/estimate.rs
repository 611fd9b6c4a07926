//! What an identification returns.

use nalgebra::{DMatrix, Vector3};
use thiserror::Error;

use super::Spectrum;
use crate::elastostatics::joint_deflections;
use crate::geometry::Transform;
use crate::kinematics::target_in_base;
use crate::measurement::Observation;
use crate::model::{CalibrationModel, KinematicModel, ParameterId};

/// Which model is fitted: the rows of the published comparison.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Mode {
    /// The nominal robot after registration of the tracker.
    WithoutCalibration,
    /// Geometric parameters.
    OnlyCalibration,
    /// Geometric parameters on top of the deflection that gravity is predicted to cause.
    WithGravity,
}

impl Mode {
    /// All modes, in the order of the published tables.
    pub const ALL: [Self; 3] = [Self::WithoutCalibration, Self::OnlyCalibration, Self::WithGravity];

    /// The key in JSON and in topic names.
    pub fn key(self) -> &'static str {
        match self {
            Self::WithoutCalibration => "without_calibration",
            Self::OnlyCalibration => "only_calibration",
            Self::WithGravity => "with_gravity",
        }
    }

    /// The row's title as published.
    pub fn title(self) -> &'static str {
        match self {
            Self::WithoutCalibration => "without calibration",
            Self::OnlyCalibration => "only calibration",
            Self::WithGravity => "calibration considering gravity",
        }
    }

    /// The mode of a [`key`](Self::key).
    pub fn parse(key: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|mode| mode.key() == key)
    }
}

/// A robot as a mode believes it to be: enough to predict where a target is seen.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibratedRobot {
    /// Which mode it comes from; decides whether the predicted deflection is added.
    pub mode: Mode,
    /// The identified (or nominal) chain.
    pub kinematics: KinematicModel,
    /// `tracker_from_base`, one a station.
    pub stations: Vec<Transform>,
    /// Offsets in the flange frame, m, one a target.
    pub targets: Vec<Vector3<f64>>,
}

impl CalibratedRobot {
    /// Joint variables at a command: the actuator map, and the predicted deflection where the mode has one. SI.
    pub fn joints(&self, model: &CalibrationModel, command: &[f64]) -> Vec<f64> {
        let mut joints = vec![0.0; command.len()];
        model.actuators.joints_from_command(command, &mut joints);
        if let (Mode::WithGravity, Some(statics)) = (self.mode, &model.statics) {
            let deflection = joint_deflections(&model.kinematics, statics, &joints);
            for (q, dq) in joints.iter_mut().zip(deflection) {
                *q += dq;
            }
        }
        joints
    }

    /// Where the observation's target is predicted to be, in the base frame, m.
    pub fn predict_in_base(&self, model: &CalibrationModel, observation: &Observation) -> Vector3<f64> {
        let joints = self.joints(model, &observation.command);
        target_in_base(&self.kinematics, &joints, &self.targets[observation.target])
    }

    /// Measured minus predicted position, in the base frame, m: the error that the tables are made of.
    pub fn error_in_base(&self, model: &CalibrationModel, observation: &Observation) -> Vector3<f64> {
        let tracker_from_base = &self.stations[observation.station];
        let seen = observation.reading.position() - tracker_from_base.translation.vector;
        tracker_from_base.rotation.inverse() * seen - self.predict_in_base(model, observation)
    }
}

/// One identified parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParameterEstimate {
    /// Which.
    pub id: ParameterId,
    /// Deviation from the nominal (links), prior (frame) or stated (target) value, m or rad.
    pub value: f64,
    /// Standard deviation, m or rad; `None` where the system is singular.
    pub sigma: Option<f64>,
}

/// Why the solver stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum TerminationReason {
    /// The gradient vanished within its tolerance.
    SmallGradient,
    /// The step became negligible against the parameters' scale.
    SmallStep,
    /// The predicted and the actual decrease of the cost became negligible.
    SmallDecrease,
    /// The iteration limit was reached first: not converged.
    IterationLimit,
    /// No damping led to a lower cost: not converged.
    NoDecrease,
    /// The cost or its derivatives stopped being finite numbers: not converged.
    NotFinite,
}

impl TerminationReason {
    /// Whether the minimum was reached.
    pub fn converged(self) -> bool {
        matches!(self, Self::SmallGradient | Self::SmallStep | Self::SmallDecrease)
    }

    /// The key in JSON and recordings.
    pub fn key(self) -> &'static str {
        match self {
            Self::SmallGradient => "small_gradient",
            Self::SmallStep => "small_step",
            Self::SmallDecrease => "small_decrease",
            Self::IterationLimit => "iteration_limit",
            Self::NoDecrease => "no_decrease",
            Self::NotFinite => "not_finite",
        }
    }
}

/// One iteration of the solver.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IterationRecord {
    /// Weighted sum of squares after the iteration.
    pub cost: f64,
    /// Levenberg-Marquardt damping that was tried.
    pub damping: f64,
    /// Norm of the scaled step.
    pub step: f64,
    /// Actual over predicted decrease.
    pub gain: f64,
    /// Whether the step was taken.
    pub accepted: bool,
}

/// Where the standard deviations get their scale from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NoiseScale {
    /// From the covariances stated with the readings.
    Stated,
    /// From the residuals: the readings state none. Standard deviation of one coordinate, m.
    Residuals(f64),
}

/// What a user must know of an estimate before trusting it.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum Warning {
    /// The solver stopped before the minimum.
    #[error("not converged: {}", .0.key())]
    NotConverged(TerminationReason),
    /// The parameters cannot all be determined.
    #[error("rank {rank} of {parameters} parameters: {} cannot be told apart", .groups.join("; "))]
    RankDeficient {
        /// Numerical rank.
        rank: usize,
        /// Number of parameters.
        parameters: usize,
        /// Dependent groups by name.
        groups: Vec<String>,
    },
    /// A combination that the data hardly excite.
    #[error("weak direction ({singular_value:.1e} of the largest): {direction}")]
    Weak {
        /// Scaled singular value over the largest.
        singular_value: f64,
        /// The combination in words.
        direction: String,
    },
    /// The residuals are larger than the stated noise explains.
    #[error(
        "the residuals are {ratio:.1} times what the stated noise explains: the model lacks something, and the standard deviations do not include it"
    )]
    Inconsistent {
        /// Square root of chi-square per degree of freedom.
        ratio: f64,
    },
}

/// The result of an identification. Non-convergence and rank deficiency are in here as data, not errors.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// The robot as identified.
    pub robot: CalibratedRobot,
    /// The parameters in the column order of the covariance.
    pub parameters: Vec<ParameterEstimate>,
    /// Covariance of the parameters (m², m rad, rad²); `None` from a singular system.
    pub covariance: Option<DMatrix<f64>>,
    /// What scales the covariance.
    pub noise: NoiseScale,
    /// Weighted sum of squares at the minimum, priors included.
    pub chi2: f64,
    /// Rows (data and priors) minus parameters.
    pub degrees_of_freedom: usize,
    /// Why the solver stopped.
    pub termination: TerminationReason,
    /// Its history.
    pub iterations: Vec<IterationRecord>,
    /// Rank, condition and weak directions of the scaled system.
    pub spectrum: Spectrum,
    /// What a user must know.
    pub warnings: Vec<Warning>,
}

impl Estimate {
    /// Chi-square per degree of freedom, about 1 where model and stated noise are right.
    pub fn chi2_per_dof(&self) -> Option<f64> {
        (self.degrees_of_freedom > 0).then(|| self.chi2 / self.degrees_of_freedom as f64)
    }

    /// Whether it may be used without a second look: converged and of full rank.
    pub fn is_sound(&self) -> bool {
        self.termination.converged() && self.spectrum.rank == self.parameters.len()
    }

    /// The value of a parameter, if it was identified.
    pub fn value(&self, id: ParameterId) -> Option<f64> {
        self.parameters.iter().find(|p| p.id == id).map(|p| p.value)
    }
}
