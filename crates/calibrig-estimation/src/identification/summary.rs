//! Results of a solution: parameters, covariance, what is determined and what is not.

use nalgebra::{DMatrix, DVector, Rotation3, Vector3};

use super::build::Built;
use super::contradiction::{Checks, Found, Minimum, free_columns};
use super::divided::divided;
use super::factorised::Factorised;
use super::gross::{GrossError, LinearFit};
use super::identify::LEAST_OF_UNKNOWN;
use super::instrument::Instruments;
use super::noise::{LEAST_FREEDOM, Noise, is_doubted};
use super::problem::CalibrationProblem;
use super::shared::as_parameters;
use super::solver::Solution;
use super::within::{Parts, parts};
use super::{
    Assumption, CalibratedRobot, Contradiction, DependentGroup, Estimate, FrameChoice, IdentificationOptions,
    LeastSquares, Mode, NoiseScale, Outlier, ParameterBound, ParameterEstimate, Spectrum, Stated,
    TargetChoice, Warning,
};
use crate::circle_points::place_by_sweeps;
use calibrig_model::measurement::{MeasurementSet, StatedInstrument};
use calibrig_model::statistics::chi2_survival;
use calibrig_model::{BodyUncertainty, ParameterId};

/// Two-sided probability of residuals as large or as small as these, below which they contradict the stated noise.
const INCONSISTENT: f64 = 1e-3;

/// Size of the residuals of observations, nests and targets, in the standard deviations with which they were weighed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Size {
    /// Sum of squares; with a loss, computed from its scale.
    pub chi2: f64,
    /// Rows less the trace of their part of the hat matrix. Parameters held by priors or bounds cost no degree of freedom.
    pub freedom: f64,
}

impl Size {
    pub fn of(problem: &CalibrationProblem, solution: &Solution, factorised: &Factorised) -> Self {
        Self::of_rows(problem, solution, factorised, false)
    }

    /// Size over the rows of observations, nests and targets, and `with_priors` of what was stated of the parameters.
    fn of_rows(
        problem: &CalibrationProblem,
        solution: &Solution,
        factorised: &Factorised,
        with_priors: bool,
    ) -> Self {
        let rows = problem.measured_rows() + if with_priors { problem.own_priors.len() } else { 0 };
        let freedom = (rows as f64 - factorised.determined(problem, with_priors)).max(0.0);
        let chi2 = if solution.weights.is_empty() {
            solution.residuals.rows(0, rows).norm_squared()
        } else {
            // With a loss, its scale gives the noise of the good observations.
            solution.scale * solution.scale * freedom
        };
        Self { chi2, freedom }
    }

    fn ratio(self) -> f64 {
        (self.chi2 / self.freedom.max(1.0)).sqrt()
    }

    /// Whether it is larger than chance makes it in one of a thousand cases.
    fn is_too_large(self) -> bool {
        self.freedom >= LEAST_FREEDOM && chi2_survival(self.chi2, self.freedom) < 0.5 * INCONSISTENT
    }

    fn is_too_small(self) -> bool {
        self.freedom >= LEAST_FREEDOM && 1.0 - chi2_survival(self.chi2, self.freedom) < 0.5 * INCONSISTENT
    }
}

/// Whether the residuals are larger than the readings' stated noise explains, and not because of what was stated of parameters, nests and
/// targets.
pub(super) fn is_misfit(
    problem: &CalibrationProblem,
    set: &MeasurementSet,
    (solution, factorised): (&Solution, &Factorised),
    frame: FrameChoice,
) -> bool {
    let size = Size::of(problem, solution, factorised);
    if !is_doubted(size.chi2, size.freedom) {
        return false;
    }
    let Some(covariance) = factorised.covariance() else { return true };
    let bounded = &factorised.bounded;
    let found =
        Checks::new(problem, set, solution, &covariance, bounded, frame, NoiseScale::Stated).of_priors(1.0);
    let stated = Size::of_rows(problem, solution, factorised, true);
    is_doubted(stated.chi2 - found.chi2, (stated.freedom - found.freedom as f64).max(0.0))
}

/// A solution with its final weights.
pub(super) struct Fitted {
    pub solution: Solution,
    pub factorised: Factorised,
    /// Size of the residuals in the stated noise.
    pub size: Size,
    /// Standard deviations from the stated noise, where the fit was weighed with more.
    pub stated_sigmas: Option<Vec<f64>>,
}

pub(super) fn summarise(
    built: Built,
    fitted: Fitted,
    set: &MeasurementSet,
    options: &IdentificationOptions,
) -> Estimate {
    let Fitted { solution, factorised, size, stated_sigmas } = fitted;
    let Built { mut problem, sigmas, named, fixed, left_out, .. } = built;
    let (n, observations) = (problem.parameters.len(), problem.rows.len());
    let noise = noise_scale(&problem);
    let jacobian = unweighted(&mut problem, &solution);
    let (outliers, found) = far_off_and_noise(&mut problem, &solution, &jacobian, &factorised, set);
    let held = factorised.factors.held(&problem, options.redundant);
    let bounded = &factorised.bounded;
    let covariance = factorised.covariance();
    let checks =
        covariance.as_ref().map(|c| Checks::new(&problem, set, &solution, c, bounded, options.frame, noise));
    let is_stated = noise == NoiseScale::Stated;
    let accounted = problem.noise.machine.is_some() || problem.noise.turn.is_some();
    let is_misfit = is_stated
        && !accounted
        && size.is_too_large()
        && is_misfit(&problem, set, (&solution, &factorised), options.frame);
    let (contradicted, doubts) = doubts(size, is_stated, (accounted, is_misfit), found, checks.as_ref());
    problem.set(&solution.x);
    let mut warnings = Vec::new();
    if !solution.termination.converged() {
        warnings.push(Warning::NotConverged(solution.termination));
    }
    warnings.extend(freedom_warning(&problem, noise, size, options.mode));
    warnings.extend(rank_warnings(&factorised.spectrum, n));
    warnings.extend(doubts);
    let at_bound: Vec<_> = bounded.iter().map(|place| problem.parameters[*place]).collect();
    warnings
        .extend(bounded.iter().map(|place| at_bound_warning(problem.parameters[*place], solution.x[*place])));
    let has = |bound: &ParameterBound| problem.parameters.contains(&bound.id);
    let known = |bound: &&ParameterBound| has(bound) || left_out.iter().any(|left| left.id == bound.id);
    let (bounds, unused): (Vec<_>, Vec<_>) = options.bounds.iter().filter(known).copied().partition(has);
    warnings.extend(unused.into_iter().map(|bound| Warning::UnusedBound { bound }));
    if !outliers.is_empty() {
        warnings.push(Warning::Outliers(outliers.clone()));
    }
    warnings.extend(off_the_points(&problem, &solution, set, &outliers));
    warnings.extend(orientations_off(&problem.noise).into_iter().chain(idle_payloads(&problem, set)));
    if solution.termination.converged() && (!is_stated || accounted || is_misfit) {
        warnings.extend(divided(&mut problem, &solution, &jacobian, &factorised.bounded, set));
    }
    if solution.minima > 1 {
        warnings.push(Warning::SeveralMinima { minima: solution.minima });
    }
    let unexcited = unexcited(&problem, &named, covariance.as_ref(), &sigmas, &solution.x);
    warnings.extend(left_open_warnings(&held, &fixed, &unexcited));
    let assumptions = assumptions(&problem, set, options, noise);
    let machine_noise = problem.stated_machine().into_iter().chain(problem.noise.machine.clone()).collect();
    let of_term = |(id, value): (&ParameterId, &f64)| match id {
        ParameterId::Term(term) => Some((*term, *value)),
        _ => None,
    };
    let terms = problem.parameters.iter().zip(&solution.x).filter_map(of_term).collect();
    let orientations = orientations(&problem, set);
    let parameter = |(i, (id, value)): (usize, (&ParameterId, &f64))| {
        let is_free = !bounded.contains(&i);
        ParameterEstimate {
            id: *id,
            value: *value,
            sigma: covariance.as_ref().filter(|_| is_free).map(|c| c[(i, i)].sqrt()),
            stated_sigma: stated_sigmas.as_ref().filter(|_| is_free).and_then(|s| s.get(i).copied()),
            prior_sigma: sigmas[i].or_else(|| problem.stated_sigma(i)),
        }
    };
    Estimate {
        parameters: problem.parameters.iter().zip(&solution.x).enumerate().map(parameter).collect(),
        robot: CalibratedRobot {
            mode: options.mode,
            nominal: problem.nominal,
            model: problem.current.model,
            terms,
            stations: problem.current.stations,
            targets: problem.current.targets,
            instruments: Instruments::at(set, &problem.parameters, &solution.x),
            orientations,
        },
        assumptions,
        factor: factorised.spread().cloned(),
        covariance,
        weight_unit: weight_unit(&solution),
        // An orientation has the weight of its observation.
        weights: solution.weights.iter().copied().take(observations).collect(),
        noise,
        reading_scale: problem.noise.scale,
        machine_noise,
        turn_noise: problem.noise.turn,
        interval_freedom: problem.noise.freedom,
        chi2: size.chi2,
        degrees_of_freedom: size.freedom,
        termination: solution.termination,
        iterations: solution.iterations,
        spectrum: factorised.spectrum,
        held,
        fixed,
        left_out,
        bounds,
        at_bound,
        contradicted,
        outliers,
        warnings,
    }
}

/// Orientations on the flange of the targets that have axes.
fn orientations(problem: &CalibrationProblem, set: &MeasurementSet) -> Vec<Option<Rotation3<f64>>> {
    let turned = set.targets.iter().zip(&problem.current.orientations);
    turned.map(|(target, now)| target.orientation.as_ref().map(|_| *now)).collect()
}

/// Number by which weights are divided in the covariance, which is made from the Jacobian's rows times the root of the quotient.
fn weight_unit(solution: &Solution) -> f64 {
    let mean = solution.weights.iter().sum::<f64>() / solution.weights.len().max(1) as f64;
    if solution.weights.is_empty() { 1.0 } else { mean * solution.variance_factor }
}

fn noise_scale(problem: &CalibrationProblem) -> NoiseScale {
    match problem.noise.unstated {
        Some(sigma) => NoiseScale::Residuals(sigma),
        None if problem.rows.iter().any(|row| row.reading.is_none()) => NoiseScale::Residuals(0.0),
        None => NoiseScale::Stated,
    }
}

/// Warning where no degree of freedom is left.
fn freedom_warning(
    problem: &CalibrationProblem,
    noise: NoiseScale,
    size: Size,
    mode: Mode,
) -> Option<Warning> {
    match noise {
        // The residuals' size relative to an upper bound of their noise says nothing.
        NoiseScale::Residuals(sigma) => {
            (sigma > 0.0 && problem.noise.freedom.is_none()).then_some(Warning::NoFreedom { sigma })
        }
        NoiseScale::Stated => (size.freedom < LEAST_FREEDOM && mode != Mode::WithoutCalibration)
            .then_some(Warning::Untested { freedom: size.freedom }),
    }
}

/// The Jacobian of a solution without the weights that a loss puts into its rows.
fn unweighted(problem: &mut CalibrationProblem, solution: &Solution) -> DMatrix<f64> {
    let mut jacobian = solution.jacobian.clone();
    if !solution.weights.is_empty() {
        problem.evaluate(&solution.x, &mut solution.residuals.clone(), Some(&mut jacobian));
    }
    jacobian
}

/// The rows of a solution without the weights of a loss.
struct Rows<'a> {
    residuals: &'a DVector<f64>,
    jacobian: &'a DMatrix<f64>,
    /// Weight of every observation; empty where all have the same.
    weights: &'a [f64],
    /// Observations whose rows are in a different noise from the others', with the ratio.
    few: &'a [(usize, f64)],
}

/// Readings far off what the others predict for them, and the parts of the noise without them.
fn far_off_and_noise(
    problem: &mut CalibrationProblem,
    solution: &Solution,
    jacobian: &DMatrix<f64>,
    factorised: &Factorised,
    set: &MeasurementSet,
) -> (Vec<Outlier>, Option<Parts>) {
    let outliers = outliers_of(problem, solution, jacobian, factorised, set);
    let found = parts(problem, solution, outliers.iter().map(|outlier| outlier.observation));
    (outliers, found)
}

/// Readings far off what the others predict for them; `jacobian` is the solution's without the weights of a loss.
fn outliers_of(
    problem: &mut CalibrationProblem,
    solution: &Solution,
    jacobian: &DMatrix<f64>,
    factorised: &Factorised,
    set: &MeasurementSet,
) -> Vec<Outlier> {
    let bounded = &factorised.bounded;
    // With a common covariance, the error of one reading is spread over the rows of others of its pose.
    if problem.noise.machine.is_some() && (solution.weights.is_empty() || !problem.joined.is_empty()) {
        return gross_errors_beside_the_machine(problem, solution, bounded, set);
    }
    let few = problem.few_unstated();
    let (residuals, weights) = (&solution.residuals, solution.weights.as_slice());
    let is_stated = noise_scale(problem) == NoiseScale::Stated;
    if let Some(shared) = &problem.shared_whitening {
        let (residuals, jacobian) = as_parameters(shared, residuals, jacobian);
        let free = free_columns(&jacobian, bounded);
        let minimum = Minimum::of(&residuals, &jacobian, &free);
        return minimum.map_or_else(Vec::new, |minimum| {
            let spread = minimum.spread(jacobian.ncols(), &free);
            let rows = Rows { residuals: &minimum.residuals, jacobian: &jacobian, weights, few: &few };
            gross_errors(problem, &rows, spread.as_ref(), bounded, is_stated, set)
        });
    }
    let rows = Rows { residuals, jacobian, weights, few: &few };
    gross_errors(problem, &rows, factorised.spread(), bounded, is_stated, set)
}

/// Gross errors where the noise was found with the fit, and with them in it. They are sought among readings that all have the same weight in all
/// directions, like those that state no noise, against the scatter of the others; after a robust loss from the weights that it left. The problem
/// keeps its weights.
fn gross_errors_beside_the_machine(
    problem: &mut CalibrationProblem,
    solution: &Solution,
    bounded: &[usize],
    set: &MeasurementSet,
) -> Vec<Outlier> {
    let found = problem.noise.clone();
    let (mut residuals, mut jacobian) = problem.metres(solution);
    problem.weigh_alike(&residuals);
    problem.whiten(&mut residuals, &mut jacobian);
    let free = free_columns(&jacobian, bounded);
    let mut outliers = Vec::new();
    if !solution.weights.is_empty() {
        let weights = solution.weights.as_slice();
        let seen = Rows { residuals: &residuals, jacobian: &jacobian, weights, few: &[] };
        outliers = gross_errors(problem, &seen, None, bounded, false, set);
    } else if let Some(minimum) = Minimum::of(&residuals, &jacobian, &free)
        && let Some(spread) = minimum.spread(jacobian.ncols(), &free)
    {
        let seen = Rows { residuals: &minimum.residuals, jacobian: &jacobian, weights: &[], few: &[] };
        outliers = gross_errors(problem, &seen, Some(&spread), bounded, false, set);
    }
    // It was weighed in this way before, so this cannot fail.
    let _ = problem.weigh(&found);
    outliers
}

/// Readings far off what the others predict for them, with any loss.
fn gross_errors(
    problem: &CalibrationProblem,
    rows: &Rows<'_>,
    spread: Option<&DMatrix<f64>>,
    bounded: &[usize],
    is_stated: bool,
    set: &MeasurementSet,
) -> Vec<Outlier> {
    let (mut residuals, mut jacobian) = (rows.residuals.clone(), rows.jacobian.clone());
    let few = rows.few;
    for (i, factor) in few {
        residuals.fixed_rows_mut::<3>(3 * i).scale_mut(*factor);
        jacobian.fixed_rows_mut::<3>(3 * i).scale_mut(*factor);
    }
    for column in bounded {
        jacobian.column_mut(*column).fill(0.0);
    }
    let fit = LinearFit {
        jacobian: &jacobian,
        residuals: &residuals,
        blocks: problem.blocks(),
        weights: rows.weights,
        joined: &problem.joined,
        is_stated: is_stated || !few.is_empty(),
    };
    let place = |error: &GrossError| {
        let (observation, turn) = problem.owner(error.observation);
        let weight = rows.weights.get(observation).copied().unwrap_or(1.0);
        if let Some(turn) = turn {
            let off = problem.turned_back(turn, &error.left_out).unwrap_or_default();
            return FarOff { observation, size: error.size, off: Off::Turn(-off), weight };
        }
        let whitening = problem.rows[observation].whitening;
        let scaled = few.iter().find(|(i, _)| *i == error.observation).map_or(1.0, |(_, factor)| *factor);
        // Measured minus predicted, in the tracker's frame.
        let off = whitening.lu().solve(&-error.left_out).unwrap_or_default() / scaled;
        FarOff { observation, size: error.size, off: Off::Place(off), weight }
    };
    // The spread belongs to the rows as they were weighed.
    let spread = spread.filter(|_| few.is_empty());
    outliers(set, &fit.gross_errors(spread).iter().map(place).collect::<Vec<_>>())
}

/// A reading that is a gross error: in which way, and its weight.
pub(super) struct FarOff {
    pub observation: usize,
    /// Size in standard deviations.
    pub size: f64,
    pub off: Off,
    pub weight: f64,
}

/// Measured minus predicted, in the tracker's frame.
pub(super) enum Off {
    /// Of the position, m.
    Place(Vector3<f64>),
    /// Of the orientation, rad.
    Turn(Vector3<f64>),
}

/// Gross errors in terms that a person finds in the file; a reading whose position and orientation are both off is listed once.
pub(super) fn outliers(set: &MeasurementSet, found: &[FarOff]) -> Vec<Outlier> {
    let seen = |far: &FarOff| set.observations[far.observation].reading.position();
    let displaced = |far: &FarOff| match far.off {
        Off::Place(off) => Some(off),
        Off::Turn(_) => None,
    };
    let exchanged = |far: &FarOff| {
        let off = displaced(far)?;
        let observation = &set.observations[far.observation];
        // Each of the two points lies where the other should be.
        let others = found.iter().filter(|other| other.observation != far.observation);
        let partner = others.filter_map(|other| Some((other, displaced(other)?)));
        let mut partner = partner.filter(|(other, other_off)| {
            let apart = seen(far) - seen(other);
            let near = NEAR_PARTNER * off.norm().min(other_off.norm());
            set.observations[other.observation].station == observation.station
                && (apart - off).norm() < near
                && (apart + other_off).norm() < near
        });
        partner.next().map(|(other, _)| set.observations[other.observation].pose)
    };
    let outlier = |far: &FarOff| {
        let (distance, turn) = match far.off {
            Off::Place(off) => (off.norm(), None),
            Off::Turn(off) => (0.0, Some(off.norm())),
        };
        let observation = &set.observations[far.observation];
        let of_several = |name: &str, count: usize| (count > 1).then(|| name.to_owned());
        Outlier {
            pose: observation.pose,
            observation: far.observation,
            target: of_several(&set.targets[observation.target].name, set.targets.len()),
            station: of_several(&set.stations[observation.station].name, set.stations.len()),
            distance,
            turn,
            size: far.size,
            weight: far.weight,
            exchanged_with: exchanged(far),
        }
    };
    let mut told: Vec<Outlier> = Vec::new();
    for other in found.iter().map(outlier) {
        // Orientations come after all positions.
        match told.iter_mut().find(|known| known.observation == other.observation) {
            Some(known) => {
                known.turn = known.turn.or(other.turn);
                known.size = known.size.max(other.size);
            }
            None => told.push(other),
        }
    }
    told.sort_by_key(|outlier| outlier.observation);
    told
}

/// How close exchanged readings are to each other's place, as a share of their error.
const NEAR_PARTNER: f64 = 0.1;

/// Scatter of orientations about the identified robot, rad, that is impossible where rotations are read as they were written: a robot that
/// repeats to a millimetre at the end of a tool of 50 mm is within half of it.
const MOST_TURNED: f64 = 0.04;

fn orientations_off(noise: &Noise) -> Option<Warning> {
    noise.turn.filter(|sigma| *sigma > MOST_TURNED).map(|sigma| Warning::OrientationsOff { sigma })
}

/// Share of the robot's reach, and of the points' spread, that a correctly measured nominal robot never leaves ...
const NOMINAL_OFF: (f64, f64) = (0.02, 0.03);
/// ... and a robot with identified links never leaves: calibrated robots are within a tenth of it.
const IDENTIFIED_OFF: (f64, f64) = (0.005, 0.0075);

/// Warns where the identified robot does not fit the points either, gross errors aside.
fn off_the_points(
    problem: &CalibrationProblem,
    solution: &Solution,
    set: &MeasurementSet,
    outliers: &[Outlier],
) -> Option<Warning> {
    let (mut squares, mut sum) = (0.0, 0.0);
    for (i, row) in problem.rows.iter().enumerate() {
        if outliers.iter().any(|outlier| outlier.observation == i) {
            continue;
        }
        let weight = solution.weights.get(i).copied().unwrap_or(1.0);
        let off = row.whitening.lu().solve(&solution.residuals.fixed_rows::<3>(3 * i).into_owned());
        squares += weight * off.map_or(0.0, |off| off.norm_squared());
        sum += weight;
    }
    let rms = (squares / sum).sqrt();
    let size = problem.nominal.kinematics.characteristic_length();
    let spread = set.spread();
    let has_links = problem.parameters.iter().any(|id| matches!(id, ParameterId::Link { .. }));
    let (of_size, of_spread) = if has_links { IDENTIFIED_OFF } else { NOMINAL_OFF };
    let is_off = rms > of_size * size && rms > of_spread * spread;
    is_off.then_some(Warning::OffThePoints { rms, spread })
}

/// Assumptions that the options left to the set.
fn assumptions(
    problem: &CalibrationProblem,
    set: &MeasurementSet,
    options: &IdentificationOptions,
    noise: NoiseScale,
) -> Vec<Assumption> {
    let (parameters, found) = (&problem.parameters, &problem.noise);
    let mut made = Vec::new();
    for (index, station) in set.stations.iter().enumerate() {
        let (name, nests) = (station.name.clone(), station.distinct_nests().len());
        made.extend(match options.frame.of(station) {
            FrameChoice::Sweeps => place_by_sweeps(&problem.nominal, set, index).ok().map(|(_, swept)| {
                Assumption::StationBySweeps { station: name, axes: swept.axes.map(|axis| axis.name) }
            }),
            _ if options.frame != FrameChoice::AsStated => None,
            FrameChoice::Free => Some(Assumption::StationFree { station: name, nests }),
            _ => Some(Assumption::StationByNests { station: name, nests }),
        });
    }
    for target in set.targets.iter().filter(|_| options.target == TargetChoice::AsStated) {
        let name = target.name.clone();
        made.push(match &target.covariance {
            None => Assumption::TargetFree { target: name },
            Some(covariance) => {
                let sigma = (covariance.trace() / 3.0).max(0.0).sqrt();
                Assumption::TargetStated { target: name, sigma }
            }
        });
    }
    let (instruments, _) = StatedInstrument::of_stations(&set.stations);
    for (index, stated) in instruments.into_iter().enumerate() {
        let is_own = |id: &&ParameterId| matches!(id, ParameterId::Instrument { instrument, .. } if *instrument == index);
        let (name, errors) = (stated.name.clone(), parameters.iter().filter(is_own).count());
        made.push(match errors {
            0 => Assumption::InstrumentIgnored { name },
            errors => Assumption::InstrumentStated { name, errors },
        });
    }
    for target in set.targets.iter().filter(|_| options.target == TargetChoice::AsStated && set.has_poses()) {
        let name = target.name.clone();
        made.extend(target.orientation.as_ref().map(|orientation| match &orientation.covariance {
            None => Assumption::OrientationFree { target: name },
            Some(covariance) => {
                let sigma = (covariance.trace() / 3.0).max(0.0).sqrt();
                Assumption::OrientationStated { target: name, sigma }
            }
        }));
    }
    made.extend(options.tolerance.map(Assumption::LinksWithin));
    if parameters.iter().any(|id| matches!(id, ParameterId::Compliance(_))) {
        made.extend(options.stiffness_unknown.then_some(Assumption::StiffnessUnknown));
        let stated = options.bodies.iter().any(|body| *body != BodyUncertainty::default());
        made.push(if stated { Assumption::BodiesStated } else { Assumption::BodiesExact });
    }
    if let NoiseScale::Residuals(sigma) = noise {
        made.push(Assumption::NoiseOfResiduals { sigma });
    }
    let scale = found.scale.filter(|scale| *scale > 1.0);
    made.extend(scale.map(|scale| Assumption::NoiseOfReadings { scale }));
    made.extend(found.machine.clone().map(Assumption::NoiseOfMachine));
    made.extend(found.turn.map(|sigma| Assumption::NoiseOfOrientations { sigma }));
    made
}

/// A named compliance is reported to rest on its prior if the measurements contribute less than this share to what is known.
const LITTLE: f64 = 0.2;

/// The `named` compliances that the fit leaves to their priors.
fn unexcited(
    problem: &CalibrationProblem,
    named: &[ParameterId],
    covariance: Option<&DMatrix<f64>>,
    sigmas: &[Option<f64>],
    x: &[f64],
) -> Vec<ParameterId> {
    let is_left = |(place, id): &(usize, &ParameterId)| {
        let (Some(covariance), Some(sigma)) = (covariance, sigmas[*place]) else { return false };
        let slope = if problem.logarithmic.contains(place) { 1.0 + x[*place] } else { 1.0 };
        named.contains(id) && 1.0 - covariance[(*place, *place)] / (sigma * slope).powi(2) < LITTLE
    };
    problem.parameters.iter().enumerate().filter(is_left).map(|(_, id)| *id).collect()
}

fn at_bound_warning(id: ParameterId, bound: f64) -> Warning {
    let name = id.to_string();
    match id {
        ParameterId::Compliance(_) if bound <= LEAST_OF_UNKNOWN => Warning::Rigid { name },
        _ => Warning::AtBound { name, bound, unit: id.unit() },
    }
}

/// Payloads of poses where no spring yields.
fn idle_payloads(problem: &CalibrationProblem, set: &MeasurementSet) -> Option<Warning> {
    let carried = set.payloads();
    let payloads: Vec<String> =
        carried.iter().filter_map(|(payload, _)| Some(payload.as_ref()?.name.clone())).collect();
    let yields = !problem.nominal.compliances().is_empty();
    (!payloads.is_empty() && !yields).then_some(Warning::IdlePayloads { payloads })
}

pub(super) fn rank_warnings(spectrum: &Spectrum, parameters: usize) -> Vec<Warning> {
    let mut warnings = Vec::new();
    if spectrum.rank < parameters {
        warnings.push(Warning::RankDeficient {
            rank: spectrum.rank,
            parameters,
            groups: spectrum.dependent.iter().map(ToString::to_string).collect(),
        });
    }
    let weak = spectrum.weak.iter();
    warnings.extend(
        weak.map(|weak| Warning::Weak { singular_value: weak.singular_value, direction: weak.to_string() }),
    );
    warnings
}

/// Warnings about parameters that the measurements do not determine.
pub(super) fn left_open_warnings(
    held: &[DependentGroup],
    fixed: &[DependentGroup],
    unexcited: &[ParameterId],
) -> Vec<Warning> {
    let names = |groups: &[DependentGroup]| groups.iter().map(ToString::to_string).collect::<Vec<_>>();
    let mut warnings = Vec::new();
    if !held.is_empty() {
        warnings.push(Warning::HeldByPrior { groups: names(held) });
    }
    if !fixed.is_empty() {
        warnings.push(Warning::Fixed { groups: names(fixed) });
    }
    warnings.extend(unexcited.iter().map(|id| Warning::Unexcited { name: id.to_string() }));
    warnings
}

/// What the measurements contradict, and the warnings of that and of the residuals' size.
///
/// Priors are tested in the noise with which the fit was weighed. With a misfit, the place of a station is not held against an estimate: its nests
/// confirm each other, and a shift of the base can replace much that a model lacks. Where the fit was not weighed with an existing misfit, the
/// parameters are not held against it either.
fn doubts(
    size: Size,
    is_stated: bool,
    (accounted, is_misfit): (bool, bool),
    found_parts: Option<Parts>,
    checks: Option<&Checks>,
) -> (Vec<Contradiction>, Vec<Warning>) {
    // Where the readings' own noise explains the residuals, a shift of the base does not replace anything.
    let explained = is_stated && !accounted && !is_misfit;
    let found = checks.map_or_else(Found::default, |checks| checks.of_priors(1.0));
    let is_place =
        |c: &Contradiction| !explained && matches!(c.stated, Stated::Nests { .. } | Stated::Sweeps { .. });
    let (places, mut contradicted): (Vec<_>, Vec<_>) = found.contradictions.into_iter().partition(is_place);
    let mut warnings = Vec::new();
    let is_too_large = is_stated && size.is_too_large();
    if is_too_large && !accounted && is_misfit {
        // What a model lacks pulls at everything that was stated, with unknown strength.
        contradicted.clear();
    }
    contradicted.extend(checks.map_or_else(Vec::new, Checks::of_nests));
    if is_too_large && (accounted || contradicted.is_empty()) {
        // Where neither is found, gross errors are the only explanation.
        if found_parts.is_none_or(|parts| parts.machine) {
            warnings.push(Warning::Inconsistent { ratio: size.ratio(), accounted });
        }
        let scale = found_parts.and_then(|parts| parts.readings);
        warnings.extend(scale.map(|ratio| Warning::Understated { ratio }));
    }
    if is_stated && size.is_too_small() {
        warnings.push(Warning::Overstated { ratio: size.ratio() });
    }
    warnings.extend(places.into_iter().map(Warning::Moved));
    if !contradicted.is_empty() {
        warnings.push(Warning::Contradicted(contradicted.clone()));
    }
    (contradicted, warnings)
}
