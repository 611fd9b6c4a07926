//! The problem evaluated at one place, and its scaled normal equations.

use nalgebra::{Cholesky, DMatrix, DVector};

use super::LeastSquares;
use super::bounds::Side;
use super::loss::Loss;

/// A loss with the scale that it is used at.
#[derive(Debug, Clone, Copy)]
pub(super) struct Robust {
    pub loss: Loss,
    pub scale: f64,
    /// Number of three-row blocks, first in the residual vector.
    pub blocks: usize,
}

/// Residuals, derivatives and cost at one place.
pub(super) struct Point {
    pub residuals: DVector<f64>,
    pub jacobian: DMatrix<f64>,
    pub cost: f64,
    /// Of the cost what no row holds.
    pub beside: f64,
    /// One a block; empty in plain least squares.
    pub weights: Vec<f64>,
    /// Of every block the one that counts with it; empty where each counts by itself.
    partners: Vec<usize>,
}

impl Point {
    pub fn new(m: usize, n: usize) -> Self {
        Self {
            residuals: DVector::zeros(m),
            jacobian: DMatrix::zeros(m, n),
            cost: f64::NAN,
            beside: 0.0,
            weights: Vec::new(),
            partners: Vec::new(),
        }
    }

    /// Of a problem, with the blocks that count together.
    pub fn of(problem: &impl LeastSquares) -> Self {
        let partners: Vec<usize> = (0..problem.blocks()).map(|block| problem.partner(block)).collect();
        let is_single = partners.iter().enumerate().all(|(block, partner)| block == *partner);
        let partners = if is_single { Vec::new() } else { partners };
        Self { partners, ..Self::new(problem.rows(), problem.parameters()) }
    }

    pub fn place(&mut self, problem: &mut impl LeastSquares, x: &[f64], robust: Option<Robust>) {
        problem.evaluate(x, &mut self.residuals, Some(&mut self.jacobian));
        self.beside = problem.beside();
        self.weigh(robust);
    }

    /// Has beside its rows what another point has.
    pub fn stay_beside(&mut self, other: &Self) {
        self.beside = other.beside;
    }

    /// Cost and weights of the residuals that are there.
    pub fn weigh(&mut self, robust: Option<Robust>) {
        let Some(robust @ Robust { loss, scale, blocks }) = robust else {
            self.cost = self.beside + self.residuals.norm_squared();
            return;
        };
        self.weights.clear();
        for i in 0..blocks {
            self.weights.push(loss.weight(self.square(i) / (scale * scale)));
        }
        self.cost = self.beside + robust_cost(&self.residuals, &self.partners, robust);
    }

    pub fn is_finite(&self) -> bool {
        self.cost.is_finite() && are_finite(self.jacobian.as_slice())
    }

    /// The square of a block's length, or the mean of those that count together.
    pub fn square(&self, i: usize) -> f64 {
        square(&self.residuals, &self.partners, i)
    }

    /// Derivative of half the cost by one parameter.
    pub fn gradient(&self, parameter: usize) -> f64 {
        self.against(parameter, &self.residuals)
    }

    /// The weighted product of one parameter's column with `rows`, one number a residual.
    pub fn against(&self, parameter: usize, rows: &DVector<f64>) -> f64 {
        let weight = |row: usize| self.weights.get(row / 3).copied().unwrap_or(1.0);
        let column = self.jacobian.column(parameter);
        column.iter().zip(rows).enumerate().map(|(row, (j, r))| weight(row) * j * r).sum()
    }

    /// Number of parameters that the blocks determine: the trace of their part of the hat matrix. What priors determine does not count, nor
    /// what nothing determines.
    pub fn fitted(&self, blocks: usize) -> f64 {
        let n = self.jacobian.ncols();
        let mut scale = DVector::zeros(n);
        let Some(mut normal) = NormalEquations::new(self) else { return n as f64 };
        normal.rescale(&mut scale);
        // What a squared matrix of unit diagonal cannot tell from zero.
        const LEAST: f64 = 1e-12;
        for j in 0..n {
            normal.matrix[(j, j)] += LEAST;
        }
        let Some(factor) = Cholesky::new(normal.matrix) else { return n as f64 };
        let inverse = factor.inverse();
        let mut elsewhere = self.jacobian.rows_range(3 * blocks..).into_owned();
        for (mut column, scale) in elsewhere.column_iter_mut().zip(&scale) {
            column /= *scale;
        }
        let from_elsewhere = (&elsewhere * &inverse).component_mul(&elsewhere).sum();
        (n as f64 - LEAST * inverse.trace() - from_elsewhere).max(0.0)
    }
}

fn square(residuals: &DVector<f64>, partners: &[usize], i: usize) -> f64 {
    let own = |i: usize| residuals.fixed_rows::<3>(3 * i).norm_squared();
    match partners.get(i) {
        Some(&partner) if partner != i => 0.5 * (own(i) + own(partner)),
        _ => own(i),
    }
}

/// What rows cost: blocks by the loss, the rows below them by their squares.
pub(super) fn robust_cost(residuals: &DVector<f64>, partners: &[usize], robust: Robust) -> f64 {
    let Robust { loss, scale, blocks } = robust;
    let cost: f64 = (0..blocks).map(|i| loss.rho(square(residuals, partners, i) / (scale * scale))).sum();
    scale * scale * cost + residuals.rows_range(3 * blocks..).norm_squared()
}

/// `Jᵀ W J` and `Jᵀ W r`, with W the weights of the blocks, and the columns divided by their scale.
///
/// They cost half of a QR factorisation. Their squared condition costs digits of a step, not of the minimum: the next step starts from
/// residuals that are computed anew. Rank and covariance are taken from the Jacobian itself.
pub(super) struct NormalEquations {
    matrix: DMatrix<f64>,
    gradient: DVector<f64>,
}

/// Rows that are multiplied at a time, a whole number of blocks: with some dozen columns they stay in the processor's cache.
const ROWS: usize = 768;

impl NormalEquations {
    /// Of columns as they are; `None` where an entry is not finite.
    pub fn new(point: &Point) -> Option<Self> {
        let (m, n) = point.jacobian.shape();
        let (mut matrix, mut gradient) = (DMatrix::zeros(n, n), DVector::zeros(n));
        // nalgebra multiplies in blocks only where nothing is transposed on the fly.
        let mut memory = DMatrix::zeros(n, ROWS.min(m));
        for first in (0..m).step_by(ROWS) {
            let count = ROWS.min(m - first);
            let rows = point.jacobian.rows(first, count);
            let mut transposed = memory.columns_mut(0, count);
            rows.transpose_to(&mut transposed);
            let end = point.weights.len().min((first + count) / 3);
            for i in first / 3..end {
                transposed.columns_mut(3 * i - first, 3).scale_mut(point.weights[i]);
            }
            matrix.gemm(1.0, &transposed, &rows, 1.0);
            gradient.gemm(1.0, &transposed, &point.residuals.rows(first, count), 1.0);
        }
        (are_finite(gradient.as_slice()) && are_finite(matrix.as_slice()))
            .then_some(Self { matrix, gradient })
    }

    /// Lets `scale` grow to the column norms, never shrink (Moré), and divides by it; a column of zeros keeps a scale of one.
    pub fn rescale(&mut self, scale: &mut DVector<f64>) {
        for (j, s) in scale.iter_mut().enumerate() {
            *s = s.max(self.matrix[(j, j)].sqrt());
            if *s == 0.0 {
                *s = 1.0;
            }
        }
        self.gradient.component_div_assign(scale);
        for (j, mut column) in self.matrix.column_iter_mut().enumerate() {
            for (i, entry) in column.iter_mut().enumerate() {
                *entry /= scale[i] * scale[j];
            }
        }
    }

    pub fn gradient(&self) -> &DVector<f64> {
        &self.gradient
    }

    pub fn damped(&self, damping: f64) -> DMatrix<f64> {
        let mut damped = self.matrix.clone();
        for j in 0..damped.nrows() {
            damped[(j, j)] += damping;
        }
        damped
    }

    /// The scaled step p of `(JᵀWJ + damping) p = -JᵀWr`; `None` where rounding leaves the matrix indefinite.
    pub fn damped_step(&self, damping: f64) -> Option<DVector<f64>> {
        let step = -Cholesky::new(self.damped(damping))?.solve(&self.gradient);
        step.iter().all(|v| v.is_finite()).then_some(step)
    }

    /// The scaled p of `(JᵀWJ + damping) p = right`, zero where a side is `held` (none where that is empty); `None` as in
    /// [`damped_step`](Self::damped_step).
    pub fn solve(&self, damping: f64, right: &DVector<f64>, held: &[Option<Side>]) -> Option<DVector<f64>> {
        let (mut matrix, mut right) = (self.damped(damping), right.clone());
        for j in (0..held.len()).filter(|j| held[*j].is_some()) {
            matrix.row_mut(j).fill(0.0);
            matrix.column_mut(j).fill(0.0);
            matrix[(j, j)] = 1.0;
            right[j] = 0.0;
        }
        let solution = Cholesky::new(matrix)?.solve(&right);
        solution.iter().all(|v| v.is_finite()).then_some(solution)
    }

    /// Decrease of the cost if the problem were linear and the weights stayed: `curvature` is that of [`curvature`](Self::curvature).
    pub fn predicted_decrease(&self, step: &DVector<f64>, curvature: f64) -> f64 {
        -2.0 * self.gradient.dot(step) - curvature
    }

    /// Square of the change of the weighted residuals if the problem were linear.
    pub fn curvature(&self, step: &DVector<f64>) -> f64 {
        step.dot(&(&self.matrix * step))
    }
}

/// Without an early end, so that it is done several numbers at a time.
fn are_finite(values: &[f64]) -> bool {
    values.iter().fold(true, |all, v| all & v.is_finite())
}
