//! Information of candidate poses about parameters, as pure linear algebra.

use nalgebra::DMatrix;

use super::figures::{Accuracy, DesignFigures, Spread};
use super::{Criterion, Observability, PlanError};
use crate::identification::{analyse_r, triangular_factor_of_all};
use calibrig_model::ParameterId;

/// Information, relative to the mean candidate's, that is added to a singular start: far below what a candidate contributes to anything it shows.
const RIDGE: f64 = 1e-9;

/// Most iterations of a singular value decomposition.
const SVD_ITERATIONS: usize = 10_000;

/// Unit of every parameter for criteria that depend on the scaling.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum ParameterScale {
    /// The change that displaces the readings of the mean candidate by one standard deviation (root of the sum of their squares); for a parameter
    /// that no candidate shows, the standard deviation of its prior alone. For robots whose parameters are metres, radians and fractions.
    #[default]
    Effect,
    /// Given units, SI, above zero, such as the standard deviations that matter.
    Given(Vec<f64>),
}

/// Rows of a linear(ised) problem. A candidate's row belongs to a reading with unit noise, and is independent of other rows.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DesignRows {
    /// Rows of every candidate, r x p with any number of rows.
    pub candidates: Vec<DMatrix<f64>>,
    /// Rows that count whatever is chosen: priors, nests, poses that are already measured; m x p.
    pub fixed: DMatrix<f64>,
    /// Derivatives of the positions (or anything else) to predict, one matrix per pose of the region, r x p.
    pub region: Vec<DMatrix<f64>>,
    /// Variance there that does not depend on parameters, summed over the rows: one per pose of the region, or empty.
    pub beside: Vec<f64>,
}

/// The candidates, what is known without them, and what will be predicted.
#[derive(Debug, Clone, PartialEq)]
pub struct DesignSpace {
    parameters: Vec<ParameterId>,
    scale: Vec<f64>,
    /// The candidates' rows in scaled parameters, as columns, one candidate after the other.
    pub(super) rows: DMatrix<f64>,
    /// The first column of every candidate, and at the end the number of columns.
    pub(super) first: Vec<usize>,
    /// Triangular factor of the fixed rows (or fewer rows).
    fixed: DMatrix<f64>,
    /// Rows that hold what no fixed row holds; empty if `fixed` has full rank.
    ridge: DMatrix<f64>,
    pub(super) region: DMatrix<f64>,
    pub(super) first_of_region: Vec<usize>,
    beside: Vec<f64>,
}

fn finite(what: impl Fn() -> String, matrix: &DMatrix<f64>, columns: usize) -> Result<(), PlanError> {
    if matrix.ncols() != columns {
        return Err(PlanError::Length { what: what(), found: matrix.ncols(), expected: columns });
    }
    if matrix.iter().all(|v| v.is_finite()) { Ok(()) } else { Err(PlanError::NotFinite { what: what() }) }
}

/// The rows of all matrices as columns, multiplied by the scale; and where each matrix begins.
fn joined(matrices: &[DMatrix<f64>], scale: &[f64]) -> (DMatrix<f64>, Vec<usize>) {
    let mut first = vec![0];
    for matrix in matrices {
        first.push(first[first.len() - 1] + matrix.nrows());
    }
    let mut rows = DMatrix::zeros(scale.len(), first[matrices.len()]);
    for (matrix, first) in matrices.iter().zip(&first) {
        for i in 0..matrix.nrows() {
            for (j, scale) in scale.iter().enumerate() {
                rows[(j, first + i)] = matrix[(i, j)] * scale;
            }
        }
    }
    (rows, first)
}

impl DesignSpace {
    /// The space of `rows` about `parameters`, one per column.
    ///
    /// # Errors
    ///
    /// [`PlanError`], without candidates or parameters, for matrices of another width, and for numbers that are not finite.
    pub fn new(
        parameters: Vec<ParameterId>,
        rows: &DesignRows,
        scale: &ParameterScale,
    ) -> Result<Self, PlanError> {
        let p = parameters.len();
        if p == 0 {
            let field = "the number of parameters";
            return Err(PlanError::Number { field, value: 0.0, expected: "one or more to plan for" });
        }
        if rows.candidates.is_empty() {
            return Err(PlanError::NoCandidates);
        }
        for (index, matrix) in rows.candidates.iter().enumerate() {
            finite(|| format!("a row of candidate {}", index + 1), matrix, p)?;
        }
        finite(|| "a row of what is known beforehand".to_owned(), &rows.fixed, p)?;
        for (index, matrix) in rows.region.iter().enumerate() {
            finite(|| format!("a row of pose {} of the region", index + 1), matrix, p)?;
        }
        let known = rows.beside.len();
        if known != 0 && known != rows.region.len() {
            let what = "the machine's variances over the region".to_owned();
            return Err(PlanError::Length { what, found: known, expected: rows.region.len() });
        }
        if let Some(value) = rows.beside.iter().copied().find(|v| !(*v >= 0.0 && v.is_finite())) {
            let field = "the machine's variance in the region";
            return Err(PlanError::Number { field, value, expected: "a finite number of zero or more" });
        }
        let scale = scales(rows, p, scale)?;
        let (scaled, first) = joined(&rows.candidates, &scale);
        let (region, first_of_region) = joined(&rows.region, &scale);
        let mut fixed = rows.fixed.clone();
        for (mut column, scale) in fixed.column_iter_mut().zip(&scale) {
            column *= *scale;
        }
        let fixed = triangular_factor_of_all(fixed.as_view());
        let ridge = if analyse_r(&fixed, &parameters).rank == p {
            DMatrix::zeros(0, p)
        } else {
            let mean = |j: usize| scaled.row(j).norm_squared() / rows.candidates.len() as f64;
            DMatrix::from_fn(p, p, |i, j| if i == j { (RIDGE * mean(j)).sqrt() } else { 0.0 })
        };
        let beside = if known == 0 { vec![0.0; rows.region.len()] } else { rows.beside.clone() };
        Ok(Self { parameters, scale, rows: scaled, first, fixed, ridge, region, first_of_region, beside })
    }

    /// Number of candidates.
    pub fn candidates(&self) -> usize {
        self.first.len() - 1
    }

    /// Number of rows of the candidate that has the most.
    pub fn most_rows(&self) -> usize {
        (0..self.candidates()).map(|candidate| self.of(candidate).len()).max().unwrap_or(0)
    }

    /// Number of poses of the region.
    pub fn region(&self) -> usize {
        self.first_of_region.len() - 1
    }

    /// The parameters, in the order of the columns.
    pub fn parameters(&self) -> &[ParameterId] {
        &self.parameters
    }

    /// The unit of every parameter, SI.
    pub fn scale(&self) -> &[f64] {
        &self.scale
    }

    /// Range of a candidate's columns.
    pub(super) fn of(&self, candidate: usize) -> std::ops::Range<usize> {
        self.first[candidate]..self.first[candidate + 1]
    }

    /// Rows of a candidate as columns, p x r.
    pub(super) fn block(&self, candidate: usize) -> nalgebra::DMatrixView<'_, f64> {
        self.rows.columns_range(self.of(candidate))
    }

    /// The information matrix of the fixed rows (with the ridge for a singular start) and a design.
    pub(super) fn information(&self, design: &[usize]) -> DMatrix<f64> {
        let mut m = self.fixed.tr_mul(&self.fixed) + self.ridge.tr_mul(&self.ridge);
        for candidate in design {
            let block = self.block(*candidate);
            m.gemm(1.0, &block, &block.transpose(), 1.0);
        }
        m
    }

    /// The triangular factor R of a design, p x p: `RᵀR = M`. With `hold`, it includes the ridge that keeps a search regular.
    pub(super) fn factor(&self, design: impl Iterator<Item = usize>, hold: bool) -> DMatrix<f64> {
        let p = self.parameters.len();
        let columns: Vec<usize> = design.flat_map(|candidate| self.of(candidate)).collect();
        let ridge = if hold { self.ridge.nrows() } else { 0 };
        let known = self.fixed.nrows() + ridge;
        let mut stacked = DMatrix::zeros((known + columns.len()).max(p), p);
        stacked.rows_mut(0, self.fixed.nrows()).copy_from(&self.fixed);
        stacked.rows_mut(self.fixed.nrows(), ridge).copy_from(&self.ridge.rows(0, ridge));
        for (row, column) in (known..).zip(&columns) {
            stacked.row_mut(row).tr_copy_from(&self.rows.column(*column));
        }
        triangular_factor_of_all(stacked.as_view())
    }

    /// Checks that all candidates together, with what is known, determine all parameters.
    pub(super) fn check(&self) -> Result<(), PlanError> {
        self.regular(&self.factor(0..self.candidates(), false), "the candidate poses")
    }

    fn regular(&self, factor: &DMatrix<f64>, what: &'static str) -> Result<(), PlanError> {
        let spectrum = analyse_r(factor, &self.parameters);
        if spectrum.rank == self.parameters.len() {
            return Ok(());
        }
        Err(PlanError::Singular { what, groups: spectrum.dependent })
    }

    /// Checks that `count` poses can have enough rows.
    pub(super) fn check_count(&self, count: usize) -> Result<(), PlanError> {
        let most = self.most_rows();
        let parameters = self.parameters.len();
        let known = analyse_r(&self.fixed, &self.parameters).rank;
        let determined = known + count * most;
        if determined >= parameters {
            return Ok(());
        }
        let least = (parameters - known).div_ceil(most.max(1));
        Err(PlanError::TooFewPoses { count, rows: count * most, determined, parameters, least })
    }

    /// Figures of a design (indices of candidates, in any order, possibly repeated), for the parameters and the region.
    ///
    /// # Errors
    ///
    /// [`PlanError::Singular`] with the parameters that it does not determine, and [`PlanError::Number`] for a candidate that does not exist.
    pub fn figures(&self, design: &[usize]) -> Result<DesignFigures, PlanError> {
        if let Some(index) = design.iter().find(|index| **index >= self.candidates()) {
            let field = "the index of a chosen candidate";
            return Err(PlanError::Number {
                field,
                value: *index as f64,
                expected: "one below their number",
            });
        }
        let factor = self.factor(design.iter().copied(), false);
        self.regular(&factor, "the chosen poses")?;
        self.of_factor(&factor, design.len())
    }

    /// The limit for any number of poses: as if every candidate had been measured a million times.
    pub(super) fn floor(&self) -> Result<Option<Accuracy>, PlanError> {
        const OFTEN: f64 = 1e3;
        let mut often = self.clone();
        often.rows *= OFTEN;
        let factor = often.factor(0..often.candidates(), false);
        self.regular(&factor, "the candidate poses")?;
        Ok(often.of_factor(&factor, self.candidates())?.accuracy)
    }

    fn of_factor(&self, factor: &DMatrix<f64>, poses: usize) -> Result<DesignFigures, PlanError> {
        let p = self.parameters.len();
        let failed = || PlanError::NotFinite { what: "the information of the chosen poses".to_owned() };
        let svd =
            factor.clone().try_svd(false, false, 5.0 * f64::EPSILON, SVD_ITERATIONS).ok_or_else(failed)?;
        let singular_values: Vec<f64> = svd.singular_values.iter().copied().collect();
        let inverse = factor.solve_upper_triangular(&DMatrix::identity(p, p)).ok_or_else(failed)?;
        let variances = inverse.row_iter().map(|row| row.norm_squared());
        let sigmas = variances.zip(&self.scale).map(|(variance, scale)| variance.sqrt() * scale).collect();
        Ok(DesignFigures {
            poses,
            observability: Observability::of(&singular_values, poses),
            log_determinant: 2.0 * (0..p).map(|i| factor[(i, i)].abs().ln()).sum::<f64>(),
            singular_values,
            sigmas,
            accuracy: self.accuracy(factor),
        })
    }

    /// Accuracy over the region; `None` without a region.
    fn accuracy(&self, factor: &DMatrix<f64>) -> Option<Accuracy> {
        let variances = self.predicted(factor)?;
        let with = variances.iter().zip(&self.beside).map(|(own, beside)| own + beside);
        let with_machine = Spread::of(with)?;
        let of_machine = Spread::of(self.beside.iter().copied())?;
        Some(Accuracy { of_parameters: Spread::of(variances.into_iter())?, with_machine, of_machine })
    }

    /// Variance of every prediction of the region, summed over its rows.
    pub(super) fn predicted(&self, factor: &DMatrix<f64>) -> Option<Vec<f64>> {
        let mut spread = self.region.clone();
        if !factor.tr_solve_upper_triangular_mut(&mut spread) {
            return None;
        }
        let of = |pose: &[usize]| spread.columns_range(pose[0]..pose[1]).norm_squared();
        Some(self.first_of_region.windows(2).map(of).collect())
    }

    /// G for which `tr(C GᵀG)` is the criterion, for those that are linear in the covariance.
    pub(super) fn linear(&self, criterion: Criterion) -> Option<DMatrix<f64>> {
        let p = self.parameters.len();
        match criterion {
            Criterion::A => Some(DMatrix::identity(p, p)),
            Criterion::I => {
                let rows = self.region.transpose() / (self.region() as f64).sqrt();
                Some(triangular_factor_of_all(rows.as_view()))
            }
            _ => None,
        }
    }
}

fn scales(rows: &DesignRows, p: usize, scale: &ParameterScale) -> Result<Vec<f64>, PlanError> {
    match scale {
        ParameterScale::Given(given) => {
            if given.len() != p {
                let what = "the scale of the parameters".to_owned();
                return Err(PlanError::Length { what, found: given.len(), expected: p });
            }
            if let Some(value) = given.iter().copied().find(|v| !(*v > 0.0 && v.is_finite())) {
                let field = "the scale of a parameter";
                return Err(PlanError::Number { field, value, expected: "a finite number above zero" });
            }
            Ok(given.clone())
        }
        ParameterScale::Effect => {
            let shown = |j: usize| {
                let squares: f64 = rows.candidates.iter().map(|block| block.column(j).norm_squared()).sum();
                (squares / rows.candidates.len() as f64).sqrt()
            };
            let known = |j: usize| rows.fixed.column(j).norm();
            let of =
                |j: usize| [shown(j), known(j)].into_iter().find(|v| v.is_normal()).map_or(1.0, f64::recip);
            Ok((0..p).map(of).collect())
        }
    }
}
