use nalgebra::{DMatrix, DVector};

use super::*;

/// Rosenbrock's valley as a sum of squares, from its usual start.
struct Rosenbrock;

impl LeastSquares for Rosenbrock {
    fn parameters(&self) -> usize {
        2
    }
    fn rows(&self) -> usize {
        2
    }
    fn evaluate(&mut self, x: &[f64], residuals: &mut DVector<f64>, jacobian: Option<&mut DMatrix<f64>>) {
        residuals[0] = 10.0 * (x[1] - x[0] * x[0]);
        residuals[1] = 1.0 - x[0];
        if let Some(j) = jacobian {
            j.copy_from_slice(&[-20.0 * x[0], -1.0, 10.0, 0.0]);
        }
    }
}

#[test]
fn rosenbrock_is_solved_and_the_cost_never_rises() {
    let solution = minimise(&mut Rosenbrock, vec![-1.2, 1.0], &SolverOptions::default());
    assert!(solution.termination.converged(), "{:?}", solution.termination);
    assert!((solution.x[0] - 1.0).abs() < 1e-7 && (solution.x[1] - 1.0).abs() < 1e-7);
    assert!(solution.iterations.windows(2).all(|w| w[1].cost <= w[0].cost));
}

/// An exponential decay with known data and a parameter that does nothing: the minimum must be found all the same.
struct Decay;

impl LeastSquares for Decay {
    fn parameters(&self) -> usize {
        3
    }
    fn rows(&self) -> usize {
        20
    }
    fn evaluate(&mut self, x: &[f64], residuals: &mut DVector<f64>, mut jacobian: Option<&mut DMatrix<f64>>) {
        for i in 0..20 {
            let t = i as f64 * 0.1;
            residuals[i] = x[0] * (-x[1] * t).exp() - 3.0 * (-1.7 * t).exp();
            if let Some(j) = jacobian.as_deref_mut() {
                j[(i, 0)] = (-x[1] * t).exp();
                j[(i, 1)] = -t * x[0] * (-x[1] * t).exp();
                j[(i, 2)] = 0.0;
            }
        }
    }
}

#[test]
fn a_useless_parameter_does_not_stop_the_others() {
    let solution = minimise(&mut Decay, vec![1.0, 0.1, 5.0], &SolverOptions::default());
    assert!(solution.termination.converged());
    assert!((solution.x[0] - 3.0).abs() < 1e-9 && (solution.x[1] - 1.7).abs() < 1e-9);
    assert!((solution.x[2] - 5.0).abs() < 1e-12);
}

struct NotANumber;

impl LeastSquares for NotANumber {
    fn parameters(&self) -> usize {
        1
    }
    fn rows(&self) -> usize {
        1
    }
    fn evaluate(&mut self, _: &[f64], residuals: &mut DVector<f64>, jacobian: Option<&mut DMatrix<f64>>) {
        residuals[0] = f64::NAN;
        if let Some(j) = jacobian {
            j[(0, 0)] = 1.0;
        }
    }
}

#[test]
fn numbers_that_are_not_end_the_search_with_their_reason() {
    let solution = minimise(&mut NotANumber, vec![1.0], &SolverOptions::default());
    assert_eq!(solution.termination, TerminationReason::NotFinite);
}
