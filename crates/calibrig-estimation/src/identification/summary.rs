//! What a solution tells: parameters, covariance, what is determined and what is not.

use nalgebra::{DMatrix, Vector3};

use super::build::{Built, redundant};
use super::contradiction::{Checks, Found};
use super::factor::{extended, triangular_factor, triangular_factor_of_all};
use super::gross::{GrossError, LinearFit};
use super::limits::lowest;
use super::problem::CalibrationProblem;
use super::solver::Solution;
use super::{
    Assumption, CalibratedRobot, Contradiction, DependentGroup, Estimate, FrameChoice, IdentificationOptions,
    LeastSquares, NoiseScale, Outlier, ParameterEstimate, Redundancy, Spectrum, Stated, TargetChoice,
    Warning, analyse_r,
};
use calibrig_model::ParameterId;
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::statistics::chi2_survival;

/// Probability of a larger chi-square below which the residuals are larger than the stated noise explains.
const INCONSISTENT: f64 = 1e-3;

pub(super) fn summarise(
    built: Built,
    solution: Solution,
    noise: NoiseScale,
    set: &MeasurementSet,
    options: &IdentificationOptions,
) -> Estimate {
    let Built { mut problem, sigmas, unexcited, fixed, left_out } = built;
    let rows = problem.rows();
    let n = problem.parameters.len();
    let degrees_of_freedom = rows - n;
    let factors = Factors::new(&problem, &solution.jacobian);
    let spectrum = factors.spectrum(&problem, options.redundant);
    let held = factors.held(&problem, options.redundant);
    let bounded: Vec<usize> = solution.at_bound.iter().map(|at| at.parameter).collect();
    let (covariance, factor) = covariance(factors.all, &spectrum, &bounded).unzip();
    let checks =
        covariance.as_ref().map(|c| Checks::new(&problem, set, &solution, c, &bounded, options.frame));
    let (contradicted, doubts) = doubts(&solution, noise, degrees_of_freedom, checks.as_ref());
    problem.set(&solution.x);
    let mut warnings = Vec::new();
    if !solution.termination.converged() {
        warnings.push(Warning::NotConverged(solution.termination));
    }
    warnings.extend(rank_warnings(&spectrum, n));
    warnings.extend(doubts);
    let at_bound: Vec<_> = bounded.iter().map(|place| problem.parameters[*place]).collect();
    warnings
        .extend(bounded.iter().map(|place| at_bound_warning(problem.parameters[*place], solution.x[*place])));
    let (bounds, unused): (Vec<_>, Vec<_>) = options
        .bounds
        .iter()
        .copied()
        .filter(|bound| problem.parameters.contains(&bound.id) || left_out.contains(&bound.id))
        .partition(|bound| problem.parameters.contains(&bound.id));
    warnings.extend(unused.into_iter().map(|bound| Warning::UnusedBound { bound }));
    let outliers = gross_errors(&mut problem, &solution, &bounded, noise, set);
    if !outliers.is_empty() {
        warnings.push(Warning::Outliers(outliers.clone()));
    }
    warnings.extend(off_the_points(&problem, &solution, set, &outliers));
    if solution.minima > 1 {
        warnings.push(Warning::SeveralMinima { minima: solution.minima });
    }
    warnings.extend(left_open_warnings(&held, &fixed, &unexcited));
    let values = problem.parameters.iter().zip(&solution.x);
    let terms = values.filter_map(|(id, value)| match id {
        ParameterId::Term(term) => Some((*term, *value)),
        _ => None,
    });
    let terms = terms.collect();
    Estimate {
        parameters: problem
            .parameters
            .iter()
            .zip(&solution.x)
            .enumerate()
            .map(|(i, (id, value))| ParameterEstimate {
                id: *id,
                value: *value,
                sigma: covariance.as_ref().filter(|_| !bounded.contains(&i)).map(|c| c[(i, i)].sqrt()),
                prior_sigma: sigmas[i],
            })
            .collect(),
        robot: CalibratedRobot {
            mode: options.mode,
            nominal: problem.nominal,
            model: problem.current.model,
            terms,
            stations: problem.current.stations,
            targets: problem.current.targets,
        },
        assumptions: assumptions(set, options, noise),
        covariance,
        factor,
        weights: solution.weights,
        noise,
        chi2: solution.cost,
        degrees_of_freedom,
        termination: solution.termination,
        iterations: solution.iterations,
        spectrum,
        held,
        fixed,
        bounds,
        at_bound,
        contradicted,
        outliers,
        warnings,
    }
}

/// Readings far off what the others say of them, whatever the loss.
fn gross_errors(
    problem: &mut CalibrationProblem,
    solution: &Solution,
    bounded: &[usize],
    noise: NoiseScale,
    set: &MeasurementSet,
) -> Vec<Outlier> {
    let (residuals, mut jacobian) = (&solution.residuals, solution.jacobian.clone());
    if !solution.weights.is_empty() {
        // The rows of the solution's Jacobian have the weights of the loss in them.
        let mut again = residuals.clone();
        problem.evaluate(&solution.x, &mut again, Some(&mut jacobian));
    }
    for column in bounded {
        jacobian.column_mut(*column).fill(0.0);
    }
    let fit = LinearFit {
        jacobian: &jacobian,
        residuals,
        blocks: set.observations.len(),
        weights: &solution.weights,
        is_stated: noise == NoiseScale::Stated,
    };
    let place = |error: &GrossError| {
        let whitening = problem.rows[error.observation].whitening;
        // Measured minus predicted, in the tracker's frame.
        let off = whitening.lu().solve(&-error.left_out).unwrap_or_default();
        (*error, off, solution.weights.get(error.observation).copied().unwrap_or(1.0))
    };
    outliers(set, &fit.gross_errors().iter().map(place).collect::<Vec<_>>())
}

/// Gross errors in words that a person finds in the file: the error, what the reading is off by in the tracker's frame (m), and its weight.
pub(super) fn outliers(set: &MeasurementSet, found: &[(GrossError, Vector3<f64>, f64)]) -> Vec<Outlier> {
    let seen = |error: &GrossError| set.observations[error.observation].reading.position();
    let exchanged = |(error, off, _): &(GrossError, Vector3<f64>, f64)| {
        let observation = &set.observations[error.observation];
        // The point lies where the other's should be, and the other's where this one should be.
        let partner = found.iter().filter(|(other, ..)| other.observation != error.observation);
        let mut partner = partner.filter(|(other, other_off, _)| {
            let apart = seen(error) - seen(other);
            let near = NEAR_PARTNER * off.norm().min(other_off.norm());
            set.observations[other.observation].station == observation.station
                && (apart - off).norm() < near
                && (apart + other_off).norm() < near
        });
        partner.next().map(|(other, ..)| set.observations[other.observation].pose)
    };
    let outlier = |entry: &(GrossError, Vector3<f64>, f64)| {
        let (error, off, weight) = entry;
        let observation = &set.observations[error.observation];
        let of_several = |name: &str, count: usize| (count > 1).then(|| name.to_owned());
        Outlier {
            pose: observation.pose,
            observation: error.observation,
            target: of_several(&set.targets[observation.target].name, set.targets.len()),
            station: of_several(&set.stations[observation.station].name, set.stations.len()),
            distance: off.norm(),
            size: error.size,
            weight: *weight,
            exchanged_with: exchanged(entry),
        }
    };
    found.iter().map(outlier).collect()
}

/// How near to each other's place two readings are that were exchanged, as a share of what they are off by.
const NEAR_PARTNER: f64 = 0.1;

/// Share of the robot's reach, and of the points' spread, that no robot leaves which was measured as it was commanded.
const OFF_THE_POINTS: (f64, f64) = (0.02, 0.03);

/// That the identified robot does not lie on the points either, gross errors aside.
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
    let is_off = rms > OFF_THE_POINTS.0 * size && rms > OFF_THE_POINTS.1 * spread;
    is_off.then_some(Warning::OffThePoints { rms, spread })
}

/// `(Jᵀ J)⁻¹` from `J = Q R`, and S with `S Sᵀ` equal to it; only from a system of full rank. What is `bounded` is held there: it has no
/// spread, and none of it is in the others'.
fn covariance(
    r: DMatrix<f64>,
    spectrum: &Spectrum,
    bounded: &[usize],
) -> Option<(DMatrix<f64>, DMatrix<f64>)> {
    let n = r.ncols();
    if spectrum.rank < n {
        return None;
    }
    let free: Vec<usize> = (0..n).filter(|place| !bounded.contains(place)).collect();
    let r = if bounded.is_empty() { r } else { triangular_factor(r.as_view(), &free) };
    let inverse = r.solve_upper_triangular(&DMatrix::identity(free.len(), free.len()))?;
    let of_free = &inverse * inverse.transpose();
    if bounded.is_empty() {
        return Some((of_free, inverse));
    }
    let mut covariance = DMatrix::zeros(n, n);
    let mut factor = DMatrix::zeros(n, free.len());
    for (i, row) in free.iter().enumerate() {
        factor.row_mut(*row).copy_from(&inverse.row(i));
        for (j, column) in free.iter().enumerate() {
            covariance[(*row, *column)] = of_free[(i, j)];
        }
    }
    Some((covariance, factor))
}

/// What the options left to the set, and what came of it.
fn assumptions(set: &MeasurementSet, options: &IdentificationOptions, noise: NoiseScale) -> Vec<Assumption> {
    let mut made = Vec::new();
    for station in set.stations.iter().filter(|_| options.frame == FrameChoice::AsStated) {
        let (name, nests) = (station.name.clone(), station.nests.len());
        made.push(match options.frame.of(station) {
            FrameChoice::Free => Assumption::StationFree { station: name, nests },
            _ => Assumption::StationByNests { station: name, nests },
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
    made.extend(options.tolerance.map(Assumption::LinksWithin));
    if let NoiseScale::Residuals(sigma) = noise {
        made.push(Assumption::NoiseOfResiduals { sigma });
    }
    made
}

fn at_bound_warning(id: ParameterId, bound: f64) -> Warning {
    let name = id.to_string();
    match id {
        ParameterId::Compliance(_) if bound <= lowest(id) => Warning::Rigid { name },
        _ => Warning::AtBound { name, bound, unit: id.unit() },
    }
}

/// Triangular factors of the rows of a Jacobian.
pub(super) struct Factors {
    /// Observations, nests and targets.
    measured: DMatrix<f64>,
    /// The same with the parameters' own priors.
    with_priors: DMatrix<f64>,
    /// All rows, the making's tolerances too.
    all: DMatrix<f64>,
}

impl Factors {
    pub(super) fn new(problem: &CalibrationProblem, jacobian: &DMatrix<f64>) -> Self {
        let below = |first: usize, count: usize| jacobian.rows(first, count);
        let (measured_rows, priors) = (problem.measured_rows(), problem.own_priors.len());
        let measured = triangular_factor_of_all(below(0, measured_rows).as_view());
        let with_priors = extended(measured.clone(), below(measured_rows, priors).as_view());
        let tolerances = below(measured_rows + priors, problem.tolerances.len());
        let all = extended(with_priors.clone(), tolerances.as_view());
        Self { measured, with_priors, all }
    }

    /// Spectrum of the rows that a fit is judged by.
    pub(super) fn spectrum(&self, problem: &CalibrationProblem, redundant: Redundancy) -> Spectrum {
        let judged = match redundant {
            Redundancy::Keep => &self.measured,
            Redundancy::Fix | Redundancy::Prior => &self.with_priors,
        };
        analyse_r(judged, &problem.parameters)
    }

    /// What the measurements leave to its prior.
    pub(super) fn held(&self, problem: &CalibrationProblem, choice: Redundancy) -> Vec<DependentGroup> {
        if problem.own_priors.is_empty() || choice != Redundancy::Prior {
            return Vec::new();
        }
        let has_prior = |group: &DependentGroup| {
            problem.own_priors.iter().any(|(column, _)| problem.parameters[*column] == group.redundant)
        };
        redundant(&self.measured, &problem.parameters).into_iter().filter(has_prior).collect()
    }
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

/// What is told of parameters that the measurements say nothing of.
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

/// Whether it is the model or what was stated beforehand that does not fit the measurements: what of the latter, and the warnings.
///
/// Priors that are contradicted make chi-square large, too. So the model is doubted only where chi-square fails without them; and where it
/// is, priors are looked at with the noise that the residuals have, told in one sentence, and not held against the estimate: what a model
/// lacks pulls at all of them. The place of a station is not held against it either: its nests confirm each other, and a shift of the base
/// stands in for much that a model can lack.
fn doubts(
    solution: &Solution,
    noise: NoiseScale,
    degrees_of_freedom: usize,
    checks: Option<&Checks>,
) -> (Vec<Contradiction>, Vec<Warning>) {
    // A loss tells the noise of the good observations by its scale.
    let per_dof = |chi2: f64, freedom: usize| {
        if solution.weights.is_empty() {
            chi2 / freedom.max(1) as f64
        } else {
            solution.scale * solution.scale
        }
    };
    let fits = |chi2: f64, freedom: usize| {
        let dof = freedom as f64;
        noise != NoiseScale::Stated
            || freedom == 0
            || chi2_survival(per_dof(chi2, freedom) * dof, dof) >= INCONSISTENT
    };
    let found = checks.map_or_else(Found::default, |checks| checks.of_priors(1.0));
    let left = |chi2: f64, out: usize| (solution.cost - chi2, degrees_of_freedom.saturating_sub(out));
    let (chi2, freedom) = left(found.chi2, found.freedom);
    let is_place = |c: &Contradiction| matches!(c.stated, Stated::Nests { .. });
    let mut warnings = Vec::new();
    let mut contradicted = checks.map_or_else(Vec::new, Checks::of_nests);
    let inconsistent = Warning::Inconsistent { ratio: per_dof(solution.cost, degrees_of_freedom).sqrt() };
    if fits(chi2, freedom) {
        let (places, others): (Vec<_>, Vec<_>) = found.contradictions.into_iter().partition(is_place);
        let sum = |list: &[Contradiction]| {
            (list.iter().map(|c| c.chi2).sum(), list.iter().map(|c| c.freedom).sum())
        };
        let (of_others, out) = sum(&others);
        let (chi2, freedom) = left(of_others, out);
        if !fits(chi2, freedom) {
            warnings.push(inconsistent);
        }
        warnings.extend(places.into_iter().map(Warning::Moved));
        contradicted.splice(0..0, others);
    } else {
        warnings.push(inconsistent);
        let strained = checks.map_or_else(Vec::new, |c| c.of_priors(per_dof(chi2, freedom)).contradictions);
        let count = strained.len();
        warnings.extend(strained.into_iter().next().map(|worst| {
            if is_place(&worst) { Warning::Moved(worst) } else { Warning::Strained { count, worst } }
        }));
    }
    if !contradicted.is_empty() {
        warnings.push(Warning::Contradicted(contradicted.clone()));
    }
    (contradicted, warnings)
}
