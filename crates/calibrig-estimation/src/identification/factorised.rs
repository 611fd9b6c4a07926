//! The rows of a solution, factorised once: rank, covariance and degrees of freedom all come from the same small triangles.

use nalgebra::DMatrix;

use super::build::redundant;
use super::factor::{extended, triangular_factor, triangular_factor_of_all};
use super::problem::CalibrationProblem;
use super::solver::Solution;
use super::{DependentGroup, Redundancy, Spectrum, analyse_r};

/// Triangular factors of the rows of a Jacobian.
pub(super) struct Factors {
    /// Rows of observations, nests and targets.
    measured: DMatrix<f64>,
    /// These rows and the parameters' own priors.
    with_priors: DMatrix<f64>,
    /// All rows, including the manufacturing tolerances.
    all: DMatrix<f64>,
}

impl Factors {
    pub fn new(problem: &CalibrationProblem, jacobian: &DMatrix<f64>) -> Self {
        let below = |first: usize, count: usize| jacobian.rows(first, count);
        let (measured_rows, priors) = (problem.measured_rows(), problem.own_priors.len());
        let measured = triangular_factor_of_all(below(0, measured_rows).as_view());
        let with_priors = extended(measured.clone(), below(measured_rows, priors).as_view());
        let tolerances = below(measured_rows + priors, problem.tolerances.len());
        let all = extended(with_priors.clone(), tolerances.as_view());
        Self { measured, with_priors, all }
    }

    /// Spectrum of the rows by which a fit is judged.
    pub fn spectrum(&self, problem: &CalibrationProblem, redundant: Redundancy) -> Spectrum {
        let judged = match redundant {
            Redundancy::Keep => &self.measured,
            Redundancy::Fix | Redundancy::Prior => &self.with_priors,
        };
        analyse_r(judged, &problem.parameters)
    }

    /// Parameters that the measurements leave to their priors.
    pub fn held(&self, problem: &CalibrationProblem, choice: Redundancy) -> Vec<DependentGroup> {
        if problem.own_priors.is_empty() || choice != Redundancy::Prior {
            return Vec::new();
        }
        let has_prior = |group: &DependentGroup| {
            problem.own_priors.iter().any(|(column, _)| problem.parameters[*column] == group.redundant)
        };
        redundant(&self.measured, &problem.parameters).into_iter().filter(has_prior).collect()
    }
}

/// How many of the free parameters some rows determine; the others are held by the other rows. `above` is the triangular factor of those
/// rows, `spread` S with `S Sᵀ` the covariance from all rows (n x free). Without `spread`, for a singular system, as many as rows allow.
fn determined(above: &DMatrix<f64>, spread: Option<&DMatrix<f64>>, rows: usize, free: usize) -> f64 {
    match spread.map(|spread| (above * spread).norm_squared()) {
        Some(determined) if determined.is_finite() => determined,
        _ => free.min(rows) as f64,
    }
}

/// How many of the `free` parameters the first `rows` of a whitened `jacobian` determine; the others are held by the rows below.
pub(super) fn determined_by(jacobian: &DMatrix<f64>, rows: usize, free: &[usize]) -> f64 {
    let above = triangular_factor(jacobian.rows(0, rows), free);
    let below = jacobian.rows(rows, jacobian.nrows() - rows).select_columns(free);
    let spread = inverse(&extended(above.clone(), below.as_view()));
    determined(&above, spread.as_ref(), rows, free.len())
}

/// `R⁻¹`, with `R⁻¹ R⁻ᵀ` the covariance; `None` where R is not square, or singular.
fn inverse(r: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = r.ncols();
    r.is_square().then(|| r.solve_upper_triangular(&DMatrix::identity(n, n))).flatten()
}

/// The rows of a solution, factorised.
pub(super) struct Factorised {
    pub factors: Factors,
    pub spectrum: Spectrum,
    /// Columns held at a bound.
    pub bounded: Vec<usize>,
    /// S with `S Sᵀ` the covariance: n rows, one column for every parameter that is not at a bound. Parameters at a bound have no spread, and add
    /// none to the others.
    spread: Option<DMatrix<f64>>,
}

impl Factorised {
    pub fn new(problem: &CalibrationProblem, solution: &Solution, redundant: Redundancy) -> Self {
        let factors = Factors::new(problem, &solution.jacobian);
        let spectrum = factors.spectrum(problem, redundant);
        let bounded: Vec<usize> = solution.at_bound.iter().map(|at| at.parameter).collect();
        let spread = if bounded.is_empty() { inverse(&factors.all) } else { held(&factors.all, &bounded) };
        Self { factors, spectrum, bounded, spread }
    }

    /// S with `S Sᵀ` the covariance; `None` unless the system has full rank.
    pub fn spread(&self) -> Option<&DMatrix<f64>> {
        self.spread.as_ref().filter(|spread| self.spectrum.rank == spread.nrows())
    }

    pub fn covariance(&self) -> Option<DMatrix<f64>> {
        self.spread().map(|spread| spread * spread.transpose())
    }

    /// The parameters' standard deviations; `None` for a singular system.
    pub fn sigmas(&self) -> Option<Vec<f64>> {
        self.spread().map(|spread| spread.row_iter().map(|row| row.norm()).collect())
    }

    /// How many parameters the observations, nests and targets determine; `with_priors`, together with what was stated of the parameters.
    pub fn determined(&self, problem: &CalibrationProblem, with_priors: bool) -> f64 {
        let (above, rows) = if with_priors {
            (&self.factors.with_priors, problem.measured_rows() + problem.own_priors.len())
        } else {
            (&self.factors.measured, problem.measured_rows())
        };
        determined(above, self.spread.as_ref(), rows, above.ncols() - self.bounded.len())
    }
}

/// S with the columns `bounded` held.
fn held(r: &DMatrix<f64>, bounded: &[usize]) -> Option<DMatrix<f64>> {
    let free: Vec<usize> = (0..r.ncols()).filter(|place| !bounded.contains(place)).collect();
    let inverse = inverse(&triangular_factor(r.as_view(), &free))?;
    let mut spread = DMatrix::zeros(r.ncols(), free.len());
    for (row, place) in inverse.row_iter().zip(&free) {
        spread.row_mut(*place).copy_from(&row);
    }
    Some(spread)
}
