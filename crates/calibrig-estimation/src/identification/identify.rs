//! The one way from measurements to parameters, for simulated, replayed and real data alike.

use thiserror::Error;

use super::build::{Built, UNSTATED_SIGMA, best_fit_stations, build};
use super::limits::limits;
use super::machine::MachineError;
use super::summary::summarise;
use super::{
    Bounds, BoundsError, CalibratedRobot, Estimate, FrameChoice, IdentificationOptions, LeastSquares, Loss,
    Mode, NoiseScale, ParameterBoundError, ParameterChoice, Solution, SolverOptions, TargetChoice, minimise,
    minimise_within,
};
use calibrig_model::measurement::{MeasurementError, MeasurementSet, RegistrationError};
use calibrig_model::{CalibrationModel, ModelError, ParameterId, Unit};

/// Measurements that cannot be used with these options.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum IdentifyError {
    /// The robot cannot be one.
    #[error("the robot: {0}")]
    Model(#[from] ModelError),
    /// The measurements cannot be of this robot.
    #[error(transparent)]
    Measurements(#[from] MeasurementError),
    /// Too little data.
    #[error("{rows} measured coordinates and priors for {parameters} parameters: more poses are needed")]
    TooFewRows {
        /// Rows of the system.
        rows: usize,
        /// Its columns.
        parameters: usize,
    },
    /// The station cannot be placed.
    #[error("station {station}: {source}")]
    Registration {
        /// Name of the station.
        station: String,
        /// Why.
        source: RegistrationError,
    },
    /// The nominal robot cannot be laid over the measurements.
    #[error("the measured points do not determine the tracker's place: fewer than three, or all on one line")]
    BestFit,
    /// A covariance that is not positive definite.
    #[error("{what}: the covariance is not positive definite")]
    Covariance {
        /// Whose.
        what: String,
    },
    /// An option, or a value of an estimate, that cannot be.
    #[error("{field} is {value}: expected {expected}")]
    Number {
        /// Which.
        field: &'static str,
        /// Its value, SI.
        value: f64,
        /// What it has to be.
        expected: &'static str,
    },
    /// A mode that needs what the model does not have.
    #[error("\"{}\" needs masses, stiffnesses and gravity, and the robot's files give none", .mode.title())]
    NoStatics {
        /// The mode.
        mode: Mode,
    },
    /// A listed compliance that the robot does not have.
    #[error("{name}: the robot's files give no finite stiffness there, so that there is none to identify")]
    RigidOrUnknown {
        /// Its name.
        name: String,
    },
    /// A stated bound that cannot be kept.
    #[error("{source}: {}", .source.help())]
    Bound {
        /// Why.
        #[from]
        source: ParameterBoundError,
    },
    /// Limits that leave no start.
    #[error(transparent)]
    Bounds {
        /// Why.
        #[from]
        source: BoundsError,
    },
    /// A family of terms that there is not.
    #[error("there are no terms \"{key}\"")]
    UnknownTerms {
        /// Its key.
        key: String,
    },
    /// The nominal robot cannot take a pose: its linkage does not close, or it finds no rest.
    #[error("pose {pose}: the nominal robot cannot take it: {source}")]
    Machine {
        /// The pose.
        pose: u32,
        /// Why.
        source: MachineError,
    },
    /// A listed parameter that the robot does not have.
    #[error("{name} is not a parameter of this robot")]
    UnknownParameter {
        /// Its name.
        name: String,
    },
}

/// Identifies the parameters of `options` from `set`.
///
/// Solves `min Σ ‖Wᵢ (p(x, commandᵢ) - measuredᵢ)‖² + Σ ‖priors(x)‖²`, with `Wᵢ` the inverse Cholesky factor of the reading's covariance.
/// The tracker's place, the target and the link parameters are fitted together.
pub fn identify(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
) -> Result<Estimate, IdentifyError> {
    check(model, set)?;
    options.check()?;
    if options.mode.needs_statics() && model.statics.is_none() {
        return Err(IdentifyError::NoStatics { mode: options.mode });
    }
    for bound in &options.bounds {
        bound.check()?;
    }
    let mut built = build(model, set, options)?;
    let rows = built.problem.rows();
    let parameters = built.problem.parameters();
    // A tolerance holds weak directions; it does not stand for poses that are not there.
    let measured = rows - built.problem.tolerances.len();
    if measured < parameters {
        return Err(IdentifyError::TooFewRows { rows: measured, parameters });
    }
    let solution = solve(&mut built, vec![0.0; parameters], options)?;
    let stated = set.observations.iter().all(|o| o.reading.position_covariance().is_some());
    if stated || rows == parameters {
        return Ok(summarise(built, solution, NoiseScale::Stated, set, options));
    }
    // The first pass tells the noise that the readings do not state; the second weighs the priors against it.
    let sigma = UNSTATED_SIGMA
        * if solution.weights.is_empty() {
            (solution.cost / (rows - parameters) as f64).sqrt()
        } else {
            solution.scale
        };
    if !(sigma.is_finite() && sigma > 0.0) {
        return Ok(summarise(built, solution, NoiseScale::Residuals(sigma), set, options));
    }
    for row in &mut built.problem.rows {
        row.whitening *= UNSTATED_SIGMA / sigma;
    }
    let first = solution.iterations;
    let mut solution = solve(&mut built, solution.x, options)?;
    solution.iterations.splice(0..0, first);
    Ok(summarise(built, solution, NoiseScale::Residuals(sigma), set, options))
}

fn solve(built: &mut Built, x: Vec<f64>, options: &IdentificationOptions) -> Result<Solution, IdentifyError> {
    let parameters = &built.problem.parameters;
    let is_bounded = options.bounds.iter().any(|bound| parameters.contains(&bound.id));
    if !options.mode.is_coupled() && options.solver.starts <= 1 && !is_bounded {
        return Ok(minimise(&mut built.problem, x, &options.solver));
    }
    let (lower, upper) = limits(parameters, &options.bounds);
    let spread: Vec<f64> = parameters.iter().zip(&built.sigmas).map(spread).collect();
    let bounds = Bounds::new(lower, upper)?;
    Ok(minimise_within(&mut built.problem, x, &options.solver, &bounds, &spread)?)
}

/// How far about the start other starts are drawn: two standard deviations of the parameter's own prior, else what a machine can be off.
fn spread((id, sigma): (&ParameterId, &Option<f64>)) -> f64 {
    match (sigma, id.unit()) {
        (Some(sigma), _) => 2.0 * sigma,
        (None, Unit::Metre | Unit::Radian) => 0.02,
        (None, Unit::One) => 0.5,
    }
}

/// The nominal robot, laid over the measurements.
///
/// Where the target's offset was measured, by the rigid transform that fits best (one a station, equal weights); where it is unknown,
/// the offset is fitted together with the tracker's place, and those that were measured are a prior. A robust `loss` is that of both.
pub fn without_calibration(
    model: &CalibrationModel,
    set: &MeasurementSet,
    loss: Loss,
) -> Result<CalibratedRobot, IdentifyError> {
    let is_unknown = set.targets.iter().any(|target| target.covariance.is_none());
    if is_unknown || loss != Loss::Squared {
        let options = IdentificationOptions {
            mode: Mode::WithoutCalibration,
            parameters: ParameterChoice::Listed(Vec::new()),
            frame: FrameChoice::Free,
            target: if is_unknown { TargetChoice::AsStated } else { TargetChoice::Fixed },
            solver: SolverOptions { loss, ..SolverOptions::default() },
            ..IdentificationOptions::published()
        };
        return Ok(identify(model, set, &options)?.robot);
    }
    check(model, set)?;
    Ok(CalibratedRobot {
        mode: Mode::WithoutCalibration,
        nominal: model.clone(),
        model: model.clone(),
        terms: Vec::new(),
        stations: best_fit_stations(model, set)?,
        targets: set.targets.iter().map(|t| t.in_flange).collect(),
    })
}

pub(super) fn check(model: &CalibrationModel, set: &MeasurementSet) -> Result<(), IdentifyError> {
    model.check()?;
    Ok(set.check(model.kinematics.joint_count())?)
}
