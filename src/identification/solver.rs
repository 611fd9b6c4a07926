//! Levenberg-Marquardt on a weighted problem, with column scaling and the gain ratio taken on the true cost.
//!
//! Source of the method: J. J. Moré, "The Levenberg-Marquardt algorithm: implementation and theory" (1978), for the scaling; the damping
//! follows the gain ratio.

use nalgebra::{Cholesky, DMatrix, DVector};

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
        Self { max_iterations: 100, relative_decrease: 1e-4, absolute_decrease: 1e-7 }
    }
}

/// Where the solver ended.
#[derive(Debug, Clone)]
pub(super) struct Solution {
    pub x: Vec<f64>,
    pub cost: f64,
    /// The weighted m x n Jacobian at `x`.
    pub jacobian: DMatrix<f64>,
    pub termination: TerminationReason,
    pub iterations: Vec<IterationRecord>,
}

const FIRST_DAMPING: f64 = 1e-6;
/// Below this the damping is lost in the rounding of the scaled normal matrix, whose diagonal is one.
const LEAST_DAMPING: f64 = 1e-15;
const MOST_DAMPING: f64 = 1e12;

/// Minimises from `x`.
pub(super) fn minimise(
    problem: &mut impl LeastSquares,
    mut x: Vec<f64>,
    options: &SolverOptions,
) -> Solution {
    let (m, n) = (problem.rows(), problem.parameters());
    let mut now = Point::new(m, n);
    let mut trial = Point::new(m, n);
    let mut scale = DVector::zeros(n);
    let mut iterations = Vec::new();
    let mut damping = FIRST_DAMPING;

    now.place(problem, &x);
    let mut normal = NormalEquations::new(&now, &mut scale);
    let termination = loop {
        if !(now.cost.is_finite() && normal.is_finite()) {
            break TerminationReason::NotFinite;
        }
        if iterations.len() >= options.max_iterations {
            break TerminationReason::IterationLimit;
        }
        let Some(step) = normal.damped_step(damping) else {
            damping *= 10.0;
            if damping > MOST_DAMPING {
                break TerminationReason::NoDecrease;
            }
            continue;
        };
        let moved: Vec<f64> =
            x.iter().zip(step.iter().zip(&scale)).map(|(x, (step, scale))| x + step / scale).collect();
        trial.place(problem, &moved);
        // A cost that is not a number compares as no decrease.
        let accepted = trial.cost <= now.cost;
        let predicted = normal.predicted_decrease(&step);
        let gain = if predicted > 0.0 { (now.cost - trial.cost) / predicted } else { 0.0 };
        let linear_change = normal.linear_change(&step);
        let negligible = linear_change <= options.absolute_decrease
            || linear_change <= options.relative_decrease * now.cost.sqrt();
        iterations.push(IterationRecord {
            cost: if accepted { trial.cost } else { now.cost },
            damping,
            step: step.norm(),
            gain,
            accepted,
        });
        if accepted {
            x = moved;
            std::mem::swap(&mut now, &mut trial);
            if negligible {
                break TerminationReason::SmallDecrease;
            }
            normal = NormalEquations::new(&now, &mut scale);
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
    Solution { x, cost: now.cost, jacobian: now.jacobian, termination, iterations }
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

/// The problem evaluated at one place.
struct Point {
    residuals: DVector<f64>,
    jacobian: DMatrix<f64>,
    cost: f64,
}

impl Point {
    fn new(m: usize, n: usize) -> Self {
        Self { residuals: DVector::zeros(m), jacobian: DMatrix::zeros(m, n), cost: f64::NAN }
    }

    fn place(&mut self, problem: &mut impl LeastSquares, x: &[f64]) {
        problem.evaluate(x, &mut self.residuals, Some(&mut self.jacobian));
        self.cost = self.residuals.norm_squared();
    }
}

/// `Jᵀ J` and `Jᵀ r` of the system with scaled columns.
///
/// They cost half of a QR factorisation. Their squared condition costs digits of a step, not of the minimum: the next step starts from
/// residuals that are computed anew. Rank and covariance are taken from the Jacobian itself.
struct NormalEquations {
    matrix: DMatrix<f64>,
    gradient: DVector<f64>,
}

impl NormalEquations {
    /// Lets `scale` grow to the column norms, never shrink (Moré); a column of zeros keeps a scale of one.
    fn new(point: &Point, scale: &mut DVector<f64>) -> Self {
        // nalgebra multiplies in blocks only where nothing is transposed on the fly.
        let transposed = point.jacobian.transpose();
        let mut matrix = &transposed * &point.jacobian;
        let mut gradient = &transposed * &point.residuals;
        for (j, s) in scale.iter_mut().enumerate() {
            *s = s.max(matrix[(j, j)].sqrt());
            if *s == 0.0 {
                *s = 1.0;
            }
        }
        gradient.component_div_assign(scale);
        for (j, mut column) in matrix.column_iter_mut().enumerate() {
            for (i, entry) in column.iter_mut().enumerate() {
                *entry /= scale[i] * scale[j];
            }
        }
        Self { matrix, gradient }
    }

    fn is_finite(&self) -> bool {
        self.gradient.iter().all(|v| v.is_finite()) && self.matrix.iter().all(|v| v.is_finite())
    }

    /// The scaled step p of `(JᵀJ + damping) p = -Jᵀr`; `None` where rounding leaves the matrix indefinite.
    fn damped_step(&self, damping: f64) -> Option<DVector<f64>> {
        let mut damped = self.matrix.clone();
        for j in 0..damped.nrows() {
            damped[(j, j)] += damping;
        }
        let step = -Cholesky::new(damped)?.solve(&self.gradient);
        step.iter().all(|v| v.is_finite()).then_some(step)
    }

    /// Decrease of the cost if the problem were linear.
    fn predicted_decrease(&self, step: &DVector<f64>) -> f64 {
        -2.0 * self.gradient.dot(step) - step.dot(&(&self.matrix * step))
    }

    /// Norm of the change of the residuals if the problem were linear.
    fn linear_change(&self, step: &DVector<f64>) -> f64 {
        step.dot(&(&self.matrix * step)).max(0.0).sqrt()
    }
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
