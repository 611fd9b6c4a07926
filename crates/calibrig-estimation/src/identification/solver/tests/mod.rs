//! Tests of the solver against `SciPy`'s solutions, and against the conditions of a minimum.

mod bounded;
mod reference;
mod robust;
mod starts;
mod terminations;

use nalgebra::{DMatrix, DVector};

use super::*;

/// A problem from a function that gives the residuals and their derivatives, row by row.
pub(super) struct Formula<F> {
    pub n: usize,
    pub m: usize,
    pub blocks: usize,
    pub f: F,
}

impl<F: FnMut(&[f64]) -> Rows> LeastSquares for Formula<F> {
    fn parameters(&self) -> usize {
        self.n
    }
    fn rows(&self) -> usize {
        self.m
    }
    fn blocks(&self) -> usize {
        self.blocks
    }
    fn evaluate(&mut self, x: &[f64], residuals: &mut DVector<f64>, jacobian: Option<&mut DMatrix<f64>>) {
        let rows = (self.f)(x);
        assert_eq!(rows.len(), self.m);
        for (i, (residual, _)) in rows.iter().enumerate() {
            residuals[i] = *residual;
        }
        if let Some(jacobian) = jacobian {
            *jacobian = DMatrix::from_fn(self.m, self.n, |i, j| rows[i].1[j]);
        }
    }
}

/// A residual with its gradient, row after row.
pub(super) type Rows = Vec<(f64, Vec<f64>)>;

pub(super) fn rosenbrock() -> Formula<impl FnMut(&[f64]) -> Rows> {
    Formula {
        n: 2,
        m: 2,
        blocks: 0,
        f: |x: &[f64]| {
            vec![(10.0 * (x[1] - x[0] * x[0]), vec![-20.0 * x[0], 10.0]), (1.0 - x[0], vec![-1.0, 0.0])]
        },
    }
}

/// Stops only at the limit of double precision.
pub(super) fn tight() -> SolverOptions {
    SolverOptions {
        max_iterations: 5000,
        relative_decrease: 1e-11,
        absolute_decrease: 1e-14,
        gradient: 1e-14,
        ..SolverOptions::default()
    }
}
