//! What a solution tells: parameters, covariance, what is determined and what is not.

use nalgebra::DMatrix;

use super::build::{Built, redundant};
use super::factor::{extended, triangular_factor, triangular_factor_of_all};
use super::solver::Solution;
use super::{
    CalibratedRobot, DependentGroup, Estimate, IdentificationOptions, LeastSquares, NoiseScale, Outlier,
    ParameterEstimate, Redundancy, Spectrum, Warning, analyse_r,
};
use crate::measurement::MeasurementSet;
use crate::model::ParameterId;
use crate::statistics::chi2_survival;

/// Probability of a larger chi-square below which the residuals are larger than the stated noise explains.
const INCONSISTENT: f64 = 1e-3;

pub(super) fn summarise(
    built: Built,
    solution: Solution,
    noise: NoiseScale,
    set: &MeasurementSet,
    options: &IdentificationOptions,
) -> Estimate {
    let Built { mut problem, sigmas, unexcited, fixed } = built;
    let rows = problem.rows();
    let n = problem.parameters.len();
    let degrees_of_freedom = rows - n;
    let below = |first: usize, count: usize| solution.jacobian.rows(first, count);
    let (measured_rows, priors) = (problem.measured_rows(), problem.own_priors.len());
    let measured = triangular_factor_of_all(below(0, measured_rows).as_view());
    let with_priors = extended(measured.clone(), below(measured_rows, priors).as_view());
    let spectrum = match options.redundant {
        Redundancy::Keep => analyse_r(&measured, &problem.parameters),
        Redundancy::Fix | Redundancy::Prior => analyse_r(&with_priors, &problem.parameters),
    };
    let tolerances = below(measured_rows + priors, problem.tolerances.len());
    let r = extended(with_priors, tolerances.as_view());
    let held = if problem.own_priors.is_empty() || options.redundant != Redundancy::Prior {
        Vec::new()
    } else {
        let has_prior = |group: &DependentGroup| {
            problem.own_priors.iter().any(|(column, _)| problem.parameters[*column] == group.redundant)
        };
        redundant(&measured, &problem.parameters).into_iter().filter(has_prior).collect()
    };
    let bounded: Vec<usize> = solution.at_bound.iter().map(|at| at.parameter).collect();
    let covariance = covariance(r, &spectrum, &bounded);
    problem.set(&solution.x);
    let mut warnings = warnings(&solution, &spectrum, n, degrees_of_freedom, noise);
    let at_bound: Vec<_> = bounded.iter().map(|place| problem.parameters[*place]).collect();
    warnings
        .extend(bounded.iter().map(|place| at_bound_warning(problem.parameters[*place], solution.x[*place])));
    let outliers = outliers(&solution, set);
    if !outliers.is_empty() {
        warnings.push(Warning::Outliers(outliers.clone()));
    }
    if solution.minima > 1 {
        warnings.push(Warning::SeveralMinima { minima: solution.minima });
    }
    let names = |groups: &[DependentGroup]| groups.iter().map(ToString::to_string).collect::<Vec<_>>();
    if !held.is_empty() {
        warnings.push(Warning::HeldByPrior { groups: names(&held) });
    }
    if !fixed.is_empty() {
        warnings.push(Warning::Fixed { groups: names(&fixed) });
    }
    warnings.extend(unexcited.iter().map(|id| Warning::Unexcited { name: id.to_string() }));
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
            model: problem.current.model,
            terms,
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
        held,
        fixed,
        at_bound,
        outliers,
        warnings,
    }
}

/// Residuals longer than this many standard deviations of a coordinate are named: one in 65,000 is where the noise is normal.
const OUTLIER: f64 = 5.0;

fn outliers(solution: &Solution, set: &MeasurementSet) -> Vec<Outlier> {
    let outlier = |observation: usize| Outlier {
        pose: set.observations[observation].pose,
        observation,
        size: solution.residuals.fixed_rows::<3>(3 * observation).norm() / solution.scale,
        weight: solution.weights[observation],
    };
    solution.outliers(OUTLIER).into_iter().map(outlier).collect()
}

/// `(Jᵀ J)⁻¹` from `J = Q R`, only from a system of full rank. What is `bounded` is held there: it has no spread, and none of it is in the
/// others'.
fn covariance(r: DMatrix<f64>, spectrum: &Spectrum, bounded: &[usize]) -> Option<DMatrix<f64>> {
    let n = r.ncols();
    if spectrum.rank < n {
        return None;
    }
    let free: Vec<usize> = (0..n).filter(|place| !bounded.contains(place)).collect();
    let r = if bounded.is_empty() { r } else { triangular_factor(r.as_view(), &free) };
    let inverse = r.solve_upper_triangular(&DMatrix::identity(free.len(), free.len()))?;
    let of_free = &inverse * inverse.transpose();
    if bounded.is_empty() {
        return Some(of_free);
    }
    let mut covariance = DMatrix::zeros(n, n);
    for (i, row) in free.iter().enumerate() {
        for (j, column) in free.iter().enumerate() {
            covariance[(*row, *column)] = of_free[(i, j)];
        }
    }
    Some(covariance)
}

fn at_bound_warning(id: ParameterId, bound: f64) -> Warning {
    let name = id.to_string();
    match id {
        ParameterId::Compliance(_) => Warning::Rigid { name },
        _ => Warning::AtBound { name, bound },
    }
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
    // A loss tells the noise of the good observations by its scale.
    let per_dof = if solution.weights.is_empty() {
        solution.cost / degrees_of_freedom.max(1) as f64
    } else {
        solution.scale * solution.scale
    };
    let dof = degrees_of_freedom as f64;
    if noise == NoiseScale::Stated && dof > 0.0 && chi2_survival(per_dof * dof, dof) < INCONSISTENT {
        warnings.push(Warning::Inconsistent { ratio: per_dof.sqrt() });
    }
    warnings
}
