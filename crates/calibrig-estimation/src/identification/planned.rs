//! The system that a fit would solve for planned measurements, pose by pose, at the nominal robot or another one.

use nalgebra::{DMatrix, Matrix3, Vector3};
use rand::RngExt;

use super::build::start;
use super::foresight::at_estimate;
use super::noise::ActuatorMotions;
use super::problem::{CalibrationProblem, in_base_column};
use super::prospect::at_nominal;
use super::{Estimate, IdentificationOptions, IdentifyError, MachineNoise, Tolerance};
use crate::elastostatics::ElasticError;
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::statistics::normal_quantile;
use calibrig_model::{CalibrationModel, ParameterId, PoseQuery, Unit};

/// Least value of a drawn relative deviation of a compliance or mass; below -1 there is no physical robot.
const LEAST_RELATIVE: f64 = -0.9;

/// A planned system.
#[derive(Debug, Clone)]
pub(crate) struct PlannedSystem {
    problem: CalibrationProblem,
    /// Parameters at which the system is evaluated.
    x: Vec<f64>,
    sigmas: Vec<Option<f64>>,
    /// Number of every pose, and its blocks of three data rows.
    poses: Vec<(u32, Vec<usize>)>,
    beside: Vec<MachineNoise>,
    motions: ActuatorMotions,
}

/// The whitened rows of a planned system.
#[derive(Debug, Clone)]
pub(crate) struct PlannedRows {
    /// Rows of every pose; those of different poses are independent.
    pub poses: Vec<DMatrix<f64>>,
    /// Change of these rows per displacement of the base along each of its axes, 1/m; rows x 3.
    pub shifts: Vec<DMatrix<f64>>,
    /// Rows of nests, targets and priors.
    pub priors: DMatrix<f64>,
}

/// Predicted position of a target.
#[derive(Debug, Clone)]
pub(crate) struct PlannedPlace {
    /// Derivative of the position in the base frame by the parameters, 3 x n.
    pub jacobian: DMatrix<f64>,
    /// Covariance due to the machine's noise beside its model, m².
    pub of_machine: Matrix3<f64>,
}

impl PlannedSystem {
    /// The system of `set` at the nominal robot; with an `estimate`, at its parameters and in the noise that it found.
    pub fn new(
        model: &CalibrationModel,
        set: &MeasurementSet,
        options: &IdentificationOptions,
        estimate: Option<&Estimate>,
    ) -> Result<Self, IdentifyError> {
        let (built, x) = match estimate {
            Some(estimate) => at_estimate(model, set, options, estimate)?,
            None => {
                let built = at_nominal(model, set, options)?;
                let x = built.x.clone();
                (built, x)
            }
        };
        let problem = built.problem;
        let mut places = std::collections::BTreeMap::new();
        let mut poses: Vec<(u32, Vec<usize>)> = Vec::new();
        for own in &problem.poses {
            let number = problem.rows[own[0]].pose;
            let place = *places.entry(number).or_insert(poses.len());
            if place == poses.len() {
                poses.push((number, Vec::new()));
            }
            poses[place].1.extend(problem.blocks_of(own));
        }
        let mut beside: Vec<_> = estimate.map(Estimate::beside).unwrap_or_default();
        if estimate.is_none() {
            beside.extend(problem.stated_actuators.clone());
        }
        if options.unmodelled_sigma > 0.0 {
            let position = options.unmodelled_sigma;
            beside.push(MachineNoise { position, actuators: Vec::new(), freedom: None });
        }
        let motions = ActuatorMotions::new(model);
        Ok(Self { problem, x, sigmas: built.sigmas, poses, beside, motions })
    }

    pub fn parameters(&self) -> &[ParameterId] {
        &self.problem.parameters
    }

    /// Numbers of the poses, in the order of their rows.
    pub fn poses(&self) -> impl Iterator<Item = u32> + '_ {
        self.poses.iter().map(|(number, _)| *number)
    }

    /// Parameters of a robot as it could have been made: deviations drawn from the parameters' own priors, and from `tolerance` for links without
    /// one. Tracker and targets stay where they are.
    pub fn drawn(&self, tolerance: Tolerance, rng: &mut impl RngExt) -> Vec<f64> {
        let mut x = self.x.clone();
        for ((value, id), sigma) in x.iter_mut().zip(&self.problem.parameters).zip(&self.sigmas) {
            let sigma = match (sigma, *id) {
                (Some(sigma), _) => *sigma,
                (None, id @ ParameterId::Link { .. }) if id.unit() == Unit::Metre => tolerance.length,
                (None, ParameterId::Link { .. }) => tolerance.angle,
                (None, _) => continue,
            };
            let normal: f64 = standard_normal(rng);
            *value += sigma * normal;
        }
        for column in &self.problem.logarithmic {
            x[*column] = x[*column].exp_m1();
        }
        for (value, id) in x.iter_mut().zip(&self.problem.parameters) {
            if matches!(id, ParameterId::Compliance(_) | ParameterId::Mass { .. }) {
                *value = value.max(LEAST_RELATIVE);
            }
        }
        x
    }

    /// The rows at the parameters `x`; with `None`, at those of the system.
    pub fn rows(&mut self, x: Option<&[f64]>) -> Result<PlannedRows, IdentifyError> {
        let own = self.x.clone();
        let (_, jacobian) = start(&mut self.problem, x.unwrap_or(&own))?;
        let problem = &self.problem;
        let whitening = problem.whitening();
        let along = |axis: usize| {
            let displacements = std::iter::repeat_n(Vector3::ith(axis, 1.0), problem.rows.len());
            whitening.rows(displacements).resize_vertically(problem.data_rows(), 0.0)
        };
        let along = [along(0), along(1), along(2)];
        let shifts = DMatrix::from_columns(&along);
        let of = |matrix: &DMatrix<f64>, blocks: &[usize]| {
            matrix.select_rows(&blocks.iter().flat_map(|block| 3 * block..3 * block + 3).collect::<Vec<_>>())
        };
        let data = problem.data_rows();
        Ok(PlannedRows {
            poses: self.poses.iter().map(|(_, blocks)| of(&jacobian, blocks)).collect(),
            shifts: self.poses.iter().map(|(_, blocks)| of(&shifts, blocks)).collect(),
            priors: jacobian.rows(data, jacobian.nrows() - data).into_owned(),
        })
    }

    /// Number of targets of the system.
    pub fn targets(&self) -> usize {
        self.problem.targets.len()
    }

    /// Position of a target for the parameters `x`. The pose must have one number per joint of the robot, and its target must be one of the system's.
    pub fn place(&mut self, x: Option<&[f64]>, pose: &PoseQuery<'_>) -> Result<PlannedPlace, ElasticError> {
        let own = self.x.clone();
        self.problem.set(x.unwrap_or(&own));
        let now = &mut self.problem.current;
        let in_flange = now.targets[pose.target];
        let told = now.forward.place_at(pose)?;
        now.forward.differentiate(&in_flange, &told)?;
        let in_base = now.forward.target(&in_flange);
        let mut jacobian = DMatrix::zeros(3, self.problem.parameters.len());
        let mut term = 0;
        for (mut column, id) in jacobian.column_iter_mut().zip(&self.problem.parameters) {
            column.copy_from(&in_base_column(&now.forward, *id, pose.target, &in_base, &mut term));
        }
        let motions = self.motions.at(pose.command, &in_flange);
        let of_machine = self.beside.iter().map(|part| part.covariance(&motions)).sum();
        Ok(PlannedPlace { jacobian, of_machine })
    }
}

/// A number from the standard normal distribution.
fn standard_normal(rng: &mut impl RngExt) -> f64 {
    // Strictly between zero and one.
    normal_quantile((f64::from(rng.random::<u32>()) + 0.5) / 4_294_967_296.0)
}
