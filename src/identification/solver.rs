//! Levenberg-Marquardt on a weighted problem, with column scaling and the gain ratio taken on the true cost.
//!
//! Source of the method: J. J. Moré, "The Levenberg-Marquardt algorithm: implementation and theory" (1978), for the scaling and the
//! damped system solved by QR; the damping follows the gain ratio.

use nalgebra::{DMatrix, DVector};

use super::{IterationRecord, TerminationReason};

/// A sum of squares to minimise. Rows are weighted: a residual of 1 is one standard deviation.
pub trait LeastSquares {
    /// Number of parameters n.
    fn parameters(&self) -> usize;

    /// Number of rows m: data and priors.
    fn rows(&self) -> usize;

    /// Fills the m residuals at the n parameters `x` and, where asked, the m x n Jacobian of the residuals.
    fn evaluate(&mut self, x: &[f64], residuals: &mut DVector<f64>, jacobian: Option<&mut DMatrix<f64>>);
}

/// When the solver stops.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SolverOptions {
    /// Most iterations, rejected steps included.
    pub max_iterations: usize,
    /// Stop when the step changes the residual vector by less than this fraction of it ...
    pub relative_decrease: f64,
    /// ... or by less than this many standard deviations.
    pub absolute_decrease: f64,
}

impl Default for SolverOptions {
    fn default() -> Self {
        Self { max_iterations: 100, relative_decrease: 1e-7, absolute_decrease: 1e-7 }
    }
}

/// Where the solver ended.
#[derive(Debug, Clone)]
pub(super) struct Solution {
    pub x: Vec<f64>,
    pub cost: f64,
    /// Upper-triangular n x n factor of the Jacobian at `x`.
    pub r: DMatrix<f64>,
    pub termination: TerminationReason,
    pub iterations: Vec<IterationRecord>,
}

const FIRST_DAMPING: f64 = 1e-6;
const LEAST_DAMPING: f64 = 1e-18;
const MOST_DAMPING: f64 = 1e12;

/// Minimises from `x`.
pub(super) fn minimise(
    problem: &mut impl LeastSquares,
    mut x: Vec<f64>,
    options: &SolverOptions,
) -> Solution {
    let (m, n) = (problem.rows(), problem.parameters());
    let mut residuals = DVector::zeros(m);
    let mut trial_residuals = DVector::zeros(m);
    let mut jacobian = DMatrix::zeros(m, n);
    let mut scale = DVector::zeros(n);
    let mut iterations = Vec::new();
    let mut damping = FIRST_DAMPING;

    problem.evaluate(&x, &mut residuals, Some(&mut jacobian));
    let mut cost = residuals.norm_squared();
    let (mut r, mut q_residuals) = factorise(&jacobian, &residuals);
    let termination = loop {
        if !(cost.is_finite() && r.iter().all(|v| v.is_finite())) {
            break TerminationReason::NotFinite;
        }
        grow_scale(&mut scale, &r);
        if iterations.len() >= options.max_iterations {
            break TerminationReason::IterationLimit;
        }
        let Some(step) = damped_step(&r, &q_residuals, &scale, damping) else {
            break TerminationReason::NotFinite;
        };
        let linear_change = (&r * &step).norm();
        let predicted = predicted_decrease(&r, &q_residuals, &step);
        let trial: Vec<f64> = x.iter().zip(step.iter()).map(|(x, p)| x + p).collect();
        problem.evaluate(&trial, &mut trial_residuals, None);
        let trial_cost = trial_residuals.norm_squared();
        // A cost that is not a number compares as no decrease.
        let accepted = trial_cost <= cost;
        let gain = if predicted > 0.0 { (cost - trial_cost) / predicted } else { 0.0 };
        iterations.push(IterationRecord {
            cost: if accepted { trial_cost } else { cost },
            damping,
            step: step.component_mul(&scale).norm(),
            gain,
            accepted,
        });
        let negligible = linear_change <= options.absolute_decrease
            || linear_change <= options.relative_decrease * cost.sqrt();
        if accepted {
            x = trial;
            cost = trial_cost;
            problem.evaluate(&x, &mut residuals, Some(&mut jacobian));
            (r, q_residuals) = factorise(&jacobian, &residuals);
            if negligible {
                break TerminationReason::SmallDecrease;
            }
            damping = next_damping(damping, gain);
        } else if negligible {
            // The cost is at the floor of its rounding errors.
            break TerminationReason::SmallStep;
        } else {
            damping *= 10.0;
            if damping > MOST_DAMPING {
                break TerminationReason::NoDecrease;
            }
        }
    };
    Solution { x, cost, r, termination, iterations }
}

fn next_damping(damping: f64, gain: f64) -> f64 {
    if gain > 0.75 {
        (damping * 1e-3).max(LEAST_DAMPING)
    } else if gain < 0.25 {
        damping * 4.0
    } else {
        damping
    }
}

/// R and the first n entries of Qᵀ r.
fn factorise(jacobian: &DMatrix<f64>, residuals: &DVector<f64>) -> (DMatrix<f64>, DVector<f64>) {
    let n = jacobian.ncols();
    let qr = jacobian.clone().qr();
    let mut projected = residuals.clone();
    qr.q_tr_mul(&mut projected);
    (qr.r(), projected.rows(0, n).into_owned())
}

/// Column norms, never shrinking (Moré's scaling); a column of zeros keeps a scale of one.
fn grow_scale(scale: &mut DVector<f64>, r: &DMatrix<f64>) {
    for (s, column) in scale.iter_mut().zip(r.column_iter()) {
        *s = s.max(column.norm());
        if *s == 0.0 {
            *s = 1.0;
        }
    }
}

/// The step p that minimises ‖R p + Qᵀr‖² + damping ‖D p‖².
fn damped_step(
    r: &DMatrix<f64>,
    q_residuals: &DVector<f64>,
    scale: &DVector<f64>,
    damping: f64,
) -> Option<DVector<f64>> {
    let n = r.ncols();
    let mut system = DMatrix::zeros(2 * n, n);
    system.rows_mut(0, n).copy_from(r);
    for (j, s) in scale.iter().enumerate() {
        system[(n + j, j)] = damping.sqrt() * s;
    }
    let qr = system.qr();
    let mut right = DVector::zeros(2 * n);
    right.rows_mut(0, n).copy_from(&(-q_residuals));
    qr.q_tr_mul(&mut right);
    let mut step = right.rows(0, n).into_owned();
    qr.r().solve_upper_triangular_mut(&mut step).then_some(step).filter(|p| p.iter().all(|v| v.is_finite()))
}

fn predicted_decrease(r: &DMatrix<f64>, q_residuals: &DVector<f64>, step: &DVector<f64>) -> f64 {
    q_residuals.norm_squared() - (q_residuals + r * step).norm_squared()
}

#[cfg(test)]
mod tests {
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
        fn evaluate(
            &mut self,
            x: &[f64],
            residuals: &mut DVector<f64>,
            mut jacobian: Option<&mut DMatrix<f64>>,
        ) {
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
}
