//! The problem evaluated at one point, and its scaled normal equations.

use nalgebra::{Cholesky, DMatrix, DVector};

use super::LeastSquares;
use super::bounds::Side;
use super::loss::Loss;

/// A loss with its scale.
#[derive(Debug, Clone, Copy)]
pub(super) struct Robust {
    pub loss: Loss,
    pub scale: f64,
    /// Number of three-row blocks, first in the residual vector.
    pub blocks: usize,
}

/// Residuals, derivatives and cost at one point.
pub(super) struct Point {
    pub residuals: DVector<f64>,
    pub jacobian: DMatrix<f64>,
    pub cost: f64,
    /// The part of the cost that is in no row.
    pub beside: f64,
    /// Weight of every block; empty in plain least squares.
    pub weights: Vec<f64>,
    /// For every block, the block that is weighted together with it; empty where each is weighted on its own.
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

    /// The point of a problem, with the blocks that are weighted together.
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

    /// Takes over `beside` from another point.
    pub fn stay_beside(&mut self, other: &Self) {
        self.beside = other.beside;
    }

    /// Computes the cost and weights of the current residuals.
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

    /// The squared norm of a block, or the mean of those that are weighted together.
    pub fn square(&self, i: usize) -> f64 {
        square(&self.residuals, &self.partners, i)
    }

    /// Derivative of half the cost by one parameter.
    pub fn gradient(&self, parameter: usize) -> f64 {
        self.against(parameter, &self.residuals)
    }

    /// The weighted product of one parameter's column with `rows`, one number per residual.
    pub fn against(&self, parameter: usize, rows: &DVector<f64>) -> f64 {
        let weight = |row: usize| self.weights.get(row / 3).copied().unwrap_or(1.0);
        let column = self.jacobian.column(parameter);
        column.iter().zip(rows).enumerate().map(|(row, (j, r))| weight(row) * j * r).sum()
    }

    /// Number of parameters that the blocks determine: the trace of their part of the hat matrix. Parameters that priors determine do not count,
    /// nor do undetermined ones.
    pub fn fitted(&self, blocks: usize) -> f64 {
        let n = self.jacobian.ncols();
        let mut scale = DVector::zeros(n);
        let Some(mut normal) = NormalEquations::new(self) else { return n as f64 };
        normal.rescale(&mut scale);
        // Smallest value that is distinguishable from zero in a squared matrix of unit diagonal.
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

/// Cost of rows: by the loss for blocks, by their squares for the rows below.
pub(super) fn robust_cost(residuals: &DVector<f64>, partners: &[usize], robust: Robust) -> f64 {
    let Robust { loss, scale, blocks } = robust;
    let cost: f64 = (0..blocks).map(|i| loss.rho(square(residuals, partners, i) / (scale * scale))).sum();
    scale * scale * cost + residuals.rows_range(3 * blocks..).norm_squared()
}

/// `Jᵀ W J` and `Jᵀ W r`, with W the weights of the blocks, and with the columns divided by their scale.
///
/// They cost half as much as a QR factorisation. Their squared condition loses digits of a step, not of the minimum: the next step starts from
/// newly computed residuals. Rank and covariance are taken from the Jacobian itself.
pub(super) struct NormalEquations {
    matrix: DMatrix<f64>,
    gradient: DVector<f64>,
}

/// Number of rows that are multiplied at a time, a whole number of blocks: with some dozen columns they fit into the processor's cache.
const ROWS: usize = 768;

impl NormalEquations {
    /// The unscaled normal equations; `None` where an entry is not finite.
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

    /// Lets `scale` grow to the column norms, never shrink (Moré), and divides by it; the scale of a zero column stays one.
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

    /// The scaled p of `(JᵀWJ + damping) p = right`, zero where a bound is `held` (nowhere if `held` is empty); `None` as in
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

    /// Decrease of the cost for a linear problem with constant weights; `curvature` is that of [`curvature`](Self::curvature).
    pub fn predicted_decrease(&self, step: &DVector<f64>, curvature: f64) -> f64 {
        -2.0 * self.gradient.dot(step) - curvature
    }

    /// Squared change of the weighted residuals for a linear problem.
    pub fn curvature(&self, step: &DVector<f64>) -> f64 {
        step.dot(&(&self.matrix * step))
    }
}

/// Without an early exit, so that several numbers are checked at a time.
fn are_finite(values: &[f64]) -> bool {
    values.iter().fold(true, |all, v| all & v.is_finite())
}
