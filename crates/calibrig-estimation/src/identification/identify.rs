//! The one way from measurements to parameters, shared by simulated, replayed and real data.

use nalgebra::Vector3;
use thiserror::Error;

use super::build::{Built, build, reconsider};
use super::factorised::Factorised;
use super::limits::limits;
use super::noise::{Noise, UNSTATED_SIGMA, Unknown, find, is_without_freedom};
use super::place::best_fit_stations;
use super::problem::CalibrationProblem;
use super::sizes::resize;
use super::summary::{Fitted, Size, is_misfit, summarise};
use super::{
    Bounds, BoundsError, CalibratedRobot, Estimate, FrameChoice, IdentificationOptions, LeastSquares, Loss,
    MachineNoiseChoice, Mode, ParameterBoundError, ParameterChoice, Predictor, Solution, SolverOptions,
    TargetChoice, minimise, minimise_within,
};
use crate::circle_points::SweepError;
use crate::elastostatics::ElasticError;
use calibrig_model::measurement::{MeasurementError, MeasurementSet, RegistrationError, Target};
use calibrig_model::{CalibrationModel, ModelError, ParameterId, Unit};

/// Why measurements cannot be used with the given model and options.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum IdentifyError {
    /// The robot's model is not valid.
    #[error("the robot: {0}")]
    Model(#[from] ModelError),
    /// The measurements do not belong to this robot.
    #[error(transparent)]
    Measurements(#[from] MeasurementError),
    /// There are fewer measured coordinates and priors than parameters.
    #[error("{rows} measured coordinates and priors for {parameters} parameters: more poses are needed")]
    TooFewRows {
        /// Rows of the system: measured coordinates and priors.
        rows: usize,
        /// Columns of the system: parameters.
        parameters: usize,
    },
    /// The nests do not place a station.
    #[error("station {station}: {source}")]
    Registration {
        /// Name of the station.
        station: String,
        /// Why.
        source: RegistrationError,
    },
    /// The sweeps do not place a station.
    #[error(transparent)]
    Sweeps(#[from] SweepError),
    /// The measured points do not determine the tracker's place.
    #[error("the measured points do not determine the tracker's place: fewer than three, or all on one line")]
    BestFit,
    /// A covariance is not positive definite.
    #[error("{what}: the covariance is not positive definite")]
    Covariance {
        /// What the covariance belongs to.
        what: String,
    },
    /// An option, or a number of an estimate, is outside its range.
    #[error("{field} is {value}: expected {expected}")]
    Number {
        /// Name of the option or number.
        field: &'static str,
        /// Its value, SI.
        value: f64,
        /// What is expected.
        expected: &'static str,
    },
    /// The mode needs masses, stiffnesses and gravity, and the model has none.
    #[error("\"{}\" needs masses, stiffnesses and gravity, but the robot's files do not give them", .mode.title())]
    NoStatics {
        /// The mode.
        mode: Mode,
    },
    /// A listed compliance is not in the robot's model, or is rigid there.
    #[error("{name}: the robot's files give no finite stiffness there, so it cannot be identified")]
    RigidOrUnknown {
        /// Its name.
        name: String,
    },
    /// A stated bound cannot be applied.
    #[error("{source}: {}", .source.help())]
    Bound {
        /// Why.
        #[from]
        source: ParameterBoundError,
    },
    /// The bounds leave the solver no point to start from.
    #[error(transparent)]
    Bounds {
        /// Why.
        #[from]
        source: BoundsError,
    },
    /// There is no family of terms with this key.
    #[error("there are no terms \"{key}\"")]
    UnknownTerms {
        /// Its key.
        key: String,
    },
    /// The nominal robot cannot take a pose: its linkage does not close, or it has no stable equilibrium.
    #[error("pose {pose}: the nominal robot cannot reach it: {source}")]
    Machine {
        /// Number of the pose.
        pose: u32,
        /// Why.
        source: ElasticError,
    },
    /// A listed parameter is not a parameter of the robot.
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
    let start = built.x.clone();
    let mut fitted = fit(&mut built, start, model, set, options)?;
    for round in 0..MOST_ROUNDS {
        let next = reconsider(model, set, options, &built, &fitted.solution, round == 0)?;
        let Some((next, x)) = next else { break };
        built = next;
        fitted = fit(&mut built, x, model, set, options)?;
    }
    for _ in 0..MOST_SIZES {
        if !(fitted.solution.termination.converged() && resize(&mut built, &fitted.solution, options)) {
            break;
        }
        built.goes_on = false;
        built.problem.start = None;
        built.problem.weigh(&Noise::default())?;
        fitted = fit(&mut built, fitted.solution.x, model, set, options)?;
    }
    Ok(summarise(built, fitted, set, options))
}

/// Most fits after which the choice of compliances is revised: some that were fitted are left out, some that were left out are fitted.
const MOST_ROUNDS: usize = 4;
/// Most fits after which the sizes of terms are revised.
const MOST_SIZES: usize = 6;

/// Minimises from `x` and determines the noise: as stated by the readings, otherwise from the residuals.
fn fit(
    built: &mut Built,
    x: Vec<f64>,
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
) -> Result<Fitted, IdentifyError> {
    let rows = built.problem.rows();
    let parameters = built.problem.parameters();
    // A tolerance holds weak directions; it cannot replace missing poses.
    let measured = rows - built.problem.tolerances.len();
    if measured < parameters {
        return Err(IdentifyError::TooFewRows { rows: measured, parameters });
    }
    if built.goes_on {
        if let Some(fitted) = fit_on(built, x.clone(), set, options)? {
            return Ok(fitted);
        }
        built.problem.weigh(&Noise::default())?;
    }
    let mut solution = solve(built, x, options)?;
    if built.problem.stated_actuators.is_some() {
        // Where a target was not known beforehand, its fitted place decides how actuators move it.
        built.problem.prepare_motions_at(set, &solution.x);
        built.problem.weigh(&Noise::default())?;
        solution = solve(built, solution.x, options)?;
    }
    let factorised = Factorised::new(&built.problem, &solution, options.redundant);
    let stated = Size::of(&built.problem, &solution, &factorised);
    let mut unknown = Unknown::of(&built.problem, options);
    let as_needed = options.machine_noise == MachineNoiseChoice::AsNeeded;
    let is_misfit = || is_misfit(&built.problem, set, (&solution, &factorised), options.frame);
    unknown.machine |= as_needed && !unknown.readings && is_misfit();
    // Before the minimum is reached, residuals show the remaining way to it rather than the noise.
    unknown.machine &= solution.termination.converged() || unknown.readings;
    // The stated machine noise does not include how the machine turns its flange.
    unknown.turn |=
        !as_needed && !built.problem.turns.is_empty() && solution.termination.converged() && is_misfit();
    if unknown.machine {
        unknown = unknown.with_machine(&built.problem);
    }
    if !unknown.any() || !solution.cost.is_finite() {
        return Ok(Fitted { solution, factorised, size: stated, stated_sigmas: None });
    }
    if unknown.machine {
        built.problem.prepare_motions_at(set, &solution.x);
    }
    let stated_sigmas = unknown.machine.then(|| factorised.sigmas()).flatten();
    let solution = find_noise(built, solution, unknown, options)?;
    // The nominal robot has no simpler model below it from which the noise could be taken.
    let is_nominal = options.mode == Mode::WithoutCalibration;
    let solution = if !is_nominal && is_without_freedom(&built.problem, &solution, unknown, options.redundant)
    {
        let most = most_noise(model, set)?;
        built.problem.weigh(&Noise { unstated: Some(most), ..Noise::default() })?;
        solve(built, solution.x, options)?
    } else {
        solution
    };
    let factorised = Factorised::new(&built.problem, &solution, options.redundant);
    // Where no noise is stated, the size of the residuals in stated noise means nothing.
    let size = if unknown.readings { Size::of(&built.problem, &solution, &factorised) } else { stated };
    Ok(Fitted { solution, factorised, size, stated_sigmas })
}

/// Refits with another choice of compliances, weighed from the start with the machine noise of the fit before. `None` where this is not
/// possible, or where with these compliances the readings' own noise explains the residuals.
fn fit_on(
    built: &mut Built,
    x: Vec<f64>,
    set: &MeasurementSet,
    options: &IdentificationOptions,
) -> Result<Option<Fitted>, IdentifyError> {
    let solution = solve(built, x, options)?;
    if !solution.termination.converged() {
        return Ok(None);
    }
    let unknown = Unknown::of(&built.problem, options).with_machine(&built.problem);
    let solution = find_noise(built, solution, Unknown { readings: false, ..unknown }, options)?;
    let found = built.problem.noise.clone();
    let Some(plain) = built.problem.in_stated_noise(&solution)? else { return Ok(None) };
    let factorised = Factorised::new(&built.problem, &plain, options.redundant);
    let is_needed = options.machine_noise == MachineNoiseChoice::Estimated
        || is_misfit(&built.problem, set, (&plain, &factorised), options.frame);
    if !is_needed {
        return Ok(None);
    }
    let (size, stated_sigmas) = (Size::of(&built.problem, &plain, &factorised), factorised.sigmas());
    built.problem.weigh(&found)?;
    let factorised = Factorised::new(&built.problem, &solution, options.redundant);
    Ok(Some(Fitted { solution, factorised, size, stated_sigmas }))
}

fn find_noise(
    built: &mut Built,
    solution: Solution,
    unknown: Unknown,
    options: &IdentificationOptions,
) -> Result<Solution, IdentifyError> {
    let (parameters, sigmas) = (built.problem.parameters.clone(), built.sigmas.clone());
    let mut fit =
        |problem: &mut CalibrationProblem, x| solve_problem(problem, &parameters, &sigmas, x, options);
    find(&mut built.problem, solution, unknown, &mut fit)
}

fn solve(built: &mut Built, x: Vec<f64>, options: &IdentificationOptions) -> Result<Solution, IdentifyError> {
    let parameters = built.problem.parameters.clone();
    solve_problem(&mut built.problem, &parameters, &built.sigmas, x, options)
}

fn solve_problem(
    problem: &mut CalibrationProblem,
    parameters: &[ParameterId],
    sigmas: &[Option<f64>],
    x: Vec<f64>,
    options: &IdentificationOptions,
) -> Result<Solution, IdentifyError> {
    let is_bounded = options.bounds.iter().any(|bound| parameters.contains(&bound.id));
    if !options.mode.is_coupled() && options.solver.starts <= 1 && !is_bounded {
        return Ok(minimise(problem, x, &options.solver));
    }
    let (mut lower, upper) = limits(parameters, &options.bounds);
    for column in &problem.logarithmic {
        lower[*column] = lower[*column].max(LEAST_OF_UNKNOWN);
    }
    let spread: Vec<f64> = parameters.iter().zip(sigmas).map(spread).collect();
    let bounds = Bounds::new(lower, upper)?;
    Ok(minimise_within(problem, x, &options.solver, &bounds, &spread)?)
}

/// The lowest value of a compliance whose logarithm has a prior: a millionth of the stated compliance.
pub(super) const LEAST_OF_UNKNOWN: f64 = 1e-6 - 1.0;

/// How far about the start further starts are drawn: two standard deviations of the parameter's own prior, otherwise as far as a machine can
/// be off.
fn spread((id, sigma): (&ParameterId, &Option<f64>)) -> f64 {
    match (sigma, id.unit()) {
        (Some(sigma), _) => 2.0 * sigma,
        (None, Unit::Metre | Unit::Radian) => 0.02,
        (None, Unit::One) => 0.5,
    }
}

/// Standard deviation of a coordinate that the nominal robot leaves in its best fit to the measurements, m: an upper bound of the noise.
fn most_noise(model: &CalibrationModel, set: &MeasurementSet) -> Result<f64, IdentifyError> {
    let robot = without_calibration(model, set, Loss::Squared)?;
    let errors = Predictor::new(&robot).and_then(|mut predictor| predictor.errors(set)).unwrap_or_default();
    let fitted = 6 * set.stations.len() + 3 * set.targets.len();
    let freedom = (3 * errors.len()).saturating_sub(fitted).max(1);
    let sigma = (errors.iter().map(Vector3::norm_squared).sum::<f64>() / freedom as f64).sqrt();
    Ok(if sigma > 0.0 && sigma.is_finite() { sigma } else { UNSTATED_SIGMA })
}

/// Fits the nominal robot to the measurements by its placement alone.
///
/// Where the target's offset was measured, this is the rigid transform that fits best (one per station, equal weights). Where it is unknown,
/// the offset is fitted together with the tracker's place, and measured offsets of other targets are a prior. A robust `loss` applies to both.
pub fn without_calibration(
    model: &CalibrationModel,
    set: &MeasurementSet,
    loss: Loss,
) -> Result<CalibratedRobot, IdentifyError> {
    let is_turned = |target: &Target| target.orientation.as_ref().is_some_and(|o| o.covariance.is_none());
    let is_unknown = set.targets.iter().any(|target| target.covariance.is_none())
        || set.has_poses() && set.targets.iter().any(is_turned);
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
    let targets: Vec<_> = set.targets.iter().map(|target| target.in_flange).collect();
    Ok(CalibratedRobot {
        mode: Mode::WithoutCalibration,
        nominal: model.clone(),
        model: model.clone(),
        terms: Vec::new(),
        stations: best_fit_stations(model, set, &targets)?,
        targets,
        instruments: Vec::new(),
        orientations: set
            .targets
            .iter()
            .map(|t| t.orientation.as_ref().map(|o| o.flange_from_target))
            .collect(),
    })
}

pub(super) fn check(model: &CalibrationModel, set: &MeasurementSet) -> Result<(), IdentifyError> {
    model.check()?;
    Ok(set.check(model.kinematics.joint_count())?)
}
