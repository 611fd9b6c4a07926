//! The one way from measurements to parameters, for simulated, replayed and real data alike.

use nalgebra::{Cholesky, DMatrix, Matrix3, Vector3};
use thiserror::Error;

use super::problem::{CalibrationProblem, Current, Prior, Row};
use super::solver::{Solution, minimise};
use super::{
    CalibratedRobot, Estimate, Mode, NoiseScale, ParameterEstimate, SolverOptions, Spectrum, Warning,
    analyse_columns, analyse_r, complete_set, neighbour_axis_rules,
};
use crate::geometry::{Transform, best_fit_transform};
use crate::kinematics::target_in_base;
use crate::measurement::{MeasurementSet, RegistrationError, register};
use crate::model::{CalibrationModel, LinkTerm, ParameterId, Unit};

/// What is known of the tracker's place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrameChoice {
    /// The base nests place the tracker; their uncertainty is a prior in the fit.
    Nests,
    /// Nothing: six free parameters a station.
    Free,
    /// The nests' result is taken as exact.
    Fixed,
}

/// What is known of the target's offset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TargetChoice {
    /// It was measured; its uncertainty is a prior in the fit.
    Measured,
    /// Nothing: three free parameters a target.
    Identified,
    /// The stated value is taken as exact.
    Fixed,
}

/// Which link parameters are identified.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ParameterChoice {
    /// What the published rules on neighbouring axes leave (24 for the spray-painting robot).
    NeighbourAxisRules,
    /// A complete independent set of all five parameters a link, found by rank.
    Complete,
    /// These.
    Listed(Vec<ParameterId>),
}

/// What to fit, and how.
#[derive(Debug, Clone, PartialEq)]
pub struct IdentificationOptions {
    /// With or without the predicted deflection.
    pub mode: Mode,
    /// Link parameters.
    pub parameters: ParameterChoice,
    /// The tracker's place.
    pub frame: FrameChoice,
    /// The target's offset.
    pub target: TargetChoice,
    /// Standard deviation of what the model leaves out, per axis, m; added to the readings' covariance. A stated choice.
    pub unmodelled_sigma: f64,
    /// A prior on every link parameter, where stated.
    pub tolerance: Option<Tolerance>,
    /// When the solver stops.
    pub solver: SolverOptions,
}

/// Standard deviation of a zero-mean normal prior on the link parameters' deviations: how well the robot was made. It holds directions
/// that the measurements hardly show at values that a machine can have; rank and weak directions are those of the data without it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tolerance {
    /// Of lengths, m.
    pub length: f64,
    /// Of angles, rad.
    pub angle: f64,
}

impl Default for IdentificationOptions {
    fn default() -> Self {
        Self {
            mode: Mode::OnlyCalibration,
            parameters: ParameterChoice::NeighbourAxisRules,
            frame: FrameChoice::Nests,
            target: TargetChoice::Measured,
            unmodelled_sigma: 0.0,
            tolerance: None,
            solver: SolverOptions::default(),
        }
    }
}

/// Measurements that cannot be used with these options.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum IdentifyError {
    /// No observation.
    #[error("there is no measurement to identify from")]
    Empty,
    /// An observation does not belong to this robot.
    #[error("pose {pose}: {found} commands, the robot has {expected} joints")]
    JointCount {
        /// The pose.
        pose: u32,
        /// Its number of commands.
        found: usize,
        /// The robot's number of joints.
        expected: usize,
    },
    /// An observation names a station or target that the set does not hold.
    #[error("pose {pose} names a station or a target that the measurements do not describe")]
    UnknownStationOrTarget {
        /// The pose.
        pose: u32,
    },
    /// A number that is none.
    #[error("pose {pose}: a command or reading is not a finite number")]
    NotFinite {
        /// The pose.
        pose: u32,
    },
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
    /// A covariance that is none.
    #[error("{what}: the covariance is not positive definite")]
    Covariance {
        /// Whose.
        what: String,
    },
    /// A mode that needs what the model does not have.
    #[error(
        "calibration considering gravity needs masses and drive stiffnesses, and the robot's files give none"
    )]
    NoStatics,
    /// A listed parameter that the robot does not have.
    #[error("{name} is not a parameter of this robot's links")]
    UnknownParameter {
        /// Its name.
        name: String,
    },
}

/// Standard deviation that readings without a stated one are given before the residuals tell, m: only ratios matter then.
const UNSTATED_SIGMA: f64 = 1e-4;

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
    if options.mode == Mode::WithGravity && model.statics.is_none() {
        return Err(IdentifyError::NoStatics);
    }
    let mut problem = build(model, set, options)?;
    let rows = super::LeastSquares::rows(&problem);
    let parameters = problem.parameters.len();
    // A tolerance holds weak directions; it does not stand for poses that are not there.
    let measured = rows - problem.tolerances.len();
    if measured < parameters {
        return Err(IdentifyError::TooFewRows { rows: measured, parameters });
    }
    let solution = minimise(&mut problem, vec![0.0; parameters], &options.solver);
    let stated = set.observations.iter().all(|o| o.reading.position_covariance().is_some());
    if stated || rows == parameters {
        return Ok(summarise(problem, solution, NoiseScale::Stated, options.mode));
    }
    // The first pass tells the noise that the readings do not state; the second weighs the priors against it.
    let sigma = UNSTATED_SIGMA * (solution.cost / (rows - parameters) as f64).sqrt();
    if !(sigma.is_finite() && sigma > 0.0) {
        return Ok(summarise(problem, solution, NoiseScale::Residuals(sigma), options.mode));
    }
    for row in &mut problem.rows {
        row.whitening *= UNSTATED_SIGMA / sigma;
    }
    let first = solution.iterations;
    let mut solution = minimise(&mut problem, solution.x, &options.solver);
    solution.iterations.splice(0..0, first);
    Ok(summarise(problem, solution, NoiseScale::Residuals(sigma), options.mode))
}

/// The nominal robot, laid over the measurements.
///
/// Where the target's offset was measured, by the rigid transform that fits best (one a station, equal weights); where it is unknown,
/// the offset is fitted together with the tracker's place.
pub fn without_calibration(
    model: &CalibrationModel,
    set: &MeasurementSet,
) -> Result<CalibratedRobot, IdentifyError> {
    if set.targets.iter().any(|target| target.covariance.is_none()) {
        let options = IdentificationOptions {
            mode: Mode::WithoutCalibration,
            parameters: ParameterChoice::Listed(Vec::new()),
            frame: FrameChoice::Free,
            target: TargetChoice::Identified,
            ..IdentificationOptions::default()
        };
        return Ok(identify(model, set, &options)?.robot);
    }
    check(model, set)?;
    Ok(CalibratedRobot {
        mode: Mode::WithoutCalibration,
        kinematics: model.kinematics.clone(),
        stations: best_fit_stations(model, set)?,
        targets: set.targets.iter().map(|t| t.in_flange).collect(),
    })
}

fn check(model: &CalibrationModel, set: &MeasurementSet) -> Result<(), IdentifyError> {
    if set.observations.is_empty() {
        return Err(IdentifyError::Empty);
    }
    let expected = model.kinematics.joint_count();
    for observation in &set.observations {
        let pose = observation.pose;
        if observation.command.len() != expected {
            return Err(IdentifyError::JointCount { pose, found: observation.command.len(), expected });
        }
        if observation.station >= set.stations.len() || observation.target >= set.targets.len() {
            return Err(IdentifyError::UnknownStationOrTarget { pose });
        }
        let finite = observation.command.iter().all(|v| v.is_finite())
            && observation.reading.position().iter().all(|v| v.is_finite());
        if !finite {
            return Err(IdentifyError::NotFinite { pose });
        }
    }
    Ok(())
}

fn best_fit_stations(
    model: &CalibrationModel,
    set: &MeasurementSet,
) -> Result<Vec<Transform>, IdentifyError> {
    let mut joints = vec![0.0; model.kinematics.joint_count()];
    (0..set.stations.len())
        .map(|station| {
            let (mut seen, mut nominal) = (Vec::new(), Vec::new());
            for observation in set.observations.iter().filter(|o| o.station == station) {
                model.actuators.joints_from_command(&observation.command, &mut joints);
                seen.push(observation.reading.position());
                nominal.push(target_in_base(
                    &model.kinematics,
                    &joints,
                    &set.targets[observation.target].in_flange,
                ));
            }
            best_fit_transform(&seen, &nominal).ok_or(IdentifyError::BestFit)
        })
        .collect()
}

fn build(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
) -> Result<CalibrationProblem, IdentifyError> {
    let mut parameters = link_parameters(model, options)?;
    let tolerances = tolerances(&parameters, options.tolerance)?;
    let mut priors = Vec::new();
    let stations = match options.frame {
        FrameChoice::Free => {
            for station in 0..set.stations.len() {
                parameters.extend(ParameterId::all_of_frame(station));
            }
            best_fit_stations(model, set)?
        }
        FrameChoice::Nests | FrameChoice::Fixed => {
            let mut stations = Vec::new();
            for (index, station) in set.stations.iter().enumerate() {
                let registration = register(station).map_err(|source| IdentifyError::Registration {
                    station: station.name.clone(),
                    source,
                })?;
                if options.frame == FrameChoice::Nests {
                    let covariance = DMatrix::from_iterator(6, 6, registration.covariance.iter().copied());
                    priors.push(prior(&format!("station {}", station.name), parameters.len(), covariance)?);
                    parameters.extend(ParameterId::all_of_frame(index));
                }
                stations.push(registration.tracker_from_base);
            }
            stations
        }
    };
    for (index, target) in set.targets.iter().enumerate() {
        match (options.target, target.covariance) {
            (TargetChoice::Fixed, _) => continue,
            (TargetChoice::Measured, Some(covariance)) => {
                let covariance = DMatrix::from_iterator(3, 3, covariance.iter().copied());
                priors.push(prior(&format!("target {}", target.name), parameters.len(), covariance)?);
            }
            (TargetChoice::Measured, None) => {
                return Err(IdentifyError::Covariance {
                    what: format!("target {} has no measured uncertainty", target.name),
                });
            }
            (TargetChoice::Identified, _) => {}
        }
        parameters.extend(ParameterId::all_of_target(index));
    }
    let targets: Vec<Vector3<f64>> = set.targets.iter().map(|t| t.in_flange).collect();
    let robot = CalibratedRobot {
        mode: options.mode,
        kinematics: model.kinematics.clone(),
        stations: Vec::new(),
        targets: Vec::new(),
    };
    Ok(CalibrationProblem {
        nominal: model.kinematics.clone(),
        joints: set.observations.iter().flat_map(|o| robot.joints(model, &o.command)).collect(),
        rows: weighted_rows(set, options.unmodelled_sigma)?,
        current: Current::new(&model.kinematics, &stations, &targets),
        parameters,
        priors,
        tolerances,
        stations,
        targets,
    })
}

fn link_parameters(
    model: &CalibrationModel,
    options: &IdentificationOptions,
) -> Result<Vec<ParameterId>, IdentifyError> {
    let joints = model.kinematics.joint_count();
    let mut chosen = match &options.parameters {
        ParameterChoice::NeighbourAxisRules => neighbour_axis_rules(&model.kinematics).0,
        ParameterChoice::Complete => {
            let report = complete_set(
                &model.kinematics,
                options.frame == FrameChoice::Free,
                options.target == TargetChoice::Identified,
            );
            report.selected.into_iter().filter(|id| matches!(id, ParameterId::Link { .. })).collect()
        }
        ParameterChoice::Listed(listed) => listed.clone(),
    };
    for id in &chosen {
        match *id {
            ParameterId::Link { link, .. } if link < joints => {}
            _ => return Err(IdentifyError::UnknownParameter { name: id.to_string() }),
        }
    }
    let order = |id: &ParameterId| match *id {
        ParameterId::Link { link, term } => (link, LinkTerm::ALL.iter().position(|t| *t == term)),
        _ => (joints, None),
    };
    chosen.sort_by_key(order);
    chosen.dedup();
    Ok(chosen)
}

/// One over the prior standard deviation of every link parameter, in the order of the columns; empty without a prior.
fn tolerances(links: &[ParameterId], tolerance: Option<Tolerance>) -> Result<Vec<f64>, IdentifyError> {
    let Some(tolerance) = tolerance else { return Ok(Vec::new()) };
    let positive = |sigma: f64| sigma.is_finite() && sigma > 0.0;
    if !(positive(tolerance.length) && positive(tolerance.angle)) {
        return Err(IdentifyError::Covariance { what: "the tolerance of the link parameters".to_owned() });
    }
    Ok(links
        .iter()
        .map(|id| match id.unit() {
            Unit::Metre => 1.0 / tolerance.length,
            Unit::Radian | Unit::One => 1.0 / tolerance.angle,
        })
        .collect())
}

fn weighted_rows(set: &MeasurementSet, unmodelled_sigma: f64) -> Result<Vec<Row>, IdentifyError> {
    let stated = set.observations.iter().all(|o| o.reading.position_covariance().is_some());
    set.observations
        .iter()
        .map(|observation| {
            let reading = observation.reading.position_covariance().filter(|_| stated);
            let covariance = reading.unwrap_or(Matrix3::identity() * UNSTATED_SIGMA * UNSTATED_SIGMA)
                + Matrix3::identity() * unmodelled_sigma * unmodelled_sigma;
            let whitening = Cholesky::new(covariance)
                .and_then(|c| c.l().try_inverse())
                .filter(|w| w.iter().all(|v| v.is_finite()))
                .ok_or_else(|| IdentifyError::Covariance { what: format!("pose {}", observation.pose) })?;
            Ok(Row {
                seen: observation.reading.position(),
                whitening,
                station: observation.station,
                target: observation.target,
            })
        })
        .collect()
}

fn prior(what: &str, column: usize, covariance: DMatrix<f64>) -> Result<Prior, IdentifyError> {
    let whitening = Cholesky::new(covariance)
        .and_then(|c| c.l().try_inverse())
        .ok_or_else(|| IdentifyError::Covariance { what: what.to_owned() })?;
    Ok(Prior { column, whitening })
}

fn summarise(mut problem: CalibrationProblem, solution: Solution, noise: NoiseScale, mode: Mode) -> Estimate {
    let rows = super::LeastSquares::rows(&problem);
    let degrees_of_freedom = rows - problem.parameters.len();
    let r = solution.jacobian.clone().qr().unpack_r();
    let measured_rows = rows - problem.tolerances.len();
    let spectrum = if measured_rows == rows {
        analyse_r(&r, &problem.parameters)
    } else {
        analyse_columns(&solution.jacobian.rows(0, measured_rows).into_owned(), &problem.parameters)
    };
    let covariance = covariance(&r, &spectrum);
    problem.set(&solution.x);
    let warnings = warnings(&solution, &spectrum, problem.parameters.len(), degrees_of_freedom, noise);
    Estimate {
        parameters: problem
            .parameters
            .iter()
            .zip(&solution.x)
            .enumerate()
            .map(|(i, (id, value))| ParameterEstimate {
                id: *id,
                value: *value,
                sigma: covariance.as_ref().map(|c| c[(i, i)].sqrt()),
            })
            .collect(),
        robot: CalibratedRobot {
            mode,
            kinematics: problem.current.kinematics,
            stations: problem.current.stations,
            targets: problem.current.targets,
        },
        covariance,
        noise,
        chi2: solution.cost,
        degrees_of_freedom,
        termination: solution.termination,
        iterations: solution.iterations,
        spectrum,
        warnings,
    }
}

/// `(Rᵀ R)⁻¹`, only from a system of full rank.
fn covariance(r: &DMatrix<f64>, spectrum: &Spectrum) -> Option<DMatrix<f64>> {
    let n = r.ncols();
    if spectrum.rank < n {
        return None;
    }
    let inverse = r.solve_upper_triangular(&DMatrix::identity(n, n))?;
    Some(&inverse * inverse.transpose())
}

fn warnings(
    solution: &Solution,
    spectrum: &Spectrum,
    parameters: usize,
    degrees_of_freedom: usize,
    noise: NoiseScale,
) -> Vec<Warning> {
    let mut warnings = Vec::new();
    if !solution.termination.converged() {
        warnings.push(Warning::NotConverged(solution.termination));
    }
    if spectrum.rank < parameters {
        warnings.push(Warning::RankDeficient {
            rank: spectrum.rank,
            parameters,
            groups: spectrum.dependent.iter().map(ToString::to_string).collect(),
        });
    }
    warnings.extend(
        spectrum
            .weak
            .iter()
            .map(|weak| Warning::Weak { singular_value: weak.singular_value, direction: weak.to_string() }),
    );
    let per_dof = solution.cost / degrees_of_freedom.max(1) as f64;
    // 99.9 % point of chi-square per degree of freedom, by Wilson and Hilferty (1931).
    let spread = 2.0 / (9.0 * degrees_of_freedom.max(1) as f64);
    let limit = (1.0 - spread + 3.09 * spread.sqrt()).powi(3);
    if noise == NoiseScale::Stated && degrees_of_freedom > 0 && per_dof > limit {
        warnings.push(Warning::Inconsistent { ratio: per_dof.sqrt() });
    }
    warnings
}
