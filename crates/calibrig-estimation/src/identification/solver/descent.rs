//! The iteration: damping by the gain ratio, within bounds, on the true cost of a loss at a fixed scale.
//!
//! A step that is refused is bent along the valley before it is shortened: geodesic acceleration, M. K. Transtrum, J. P. Sethna, "Improvements
//! to the Levenberg-Marquardt algorithm for nonlinear least-squares minimization" (2012), arXiv:1201.5885, sections 2.3 and 3.1. It costs
//! nothing where no step is refused.

use nalgebra::DVector;

use super::bounds::{AtBound, Bounds, Side};
use super::point::{NormalEquations, Point, Robust};
use super::{IterationRecord, LeastSquares, SolverOptions, TerminationReason};

const FIRST_DAMPING: f64 = 1e-6;
/// Damping below this vanishes in the rounding of the scaled normal matrix, whose diagonal is one.
const LEAST_DAMPING: f64 = 1e-15;
const MOST_DAMPING: f64 = 1e12;
/// With damping above this, a step may be short only because of it, which says nothing about the minimum.
const SHORTENING_DAMPING: f64 = 1e-3;
/// If the gain of a step differs from one by less, the remaining problem is linear.
const EXACT_GAIN: f64 = 1e-2;
/// Least share of the predicted decrease for which a step is accepted: Moré (1978), algorithm 7.1, p0001 of MINPACK's lmder.
const SUFFICIENT_GAIN: f64 = 1e-4;
/// A predicted decrease below this share of the cost vanishes in the rounding of its sum, and so does the gain.
const ROUNDING: f64 = 64.0 * f64::EPSILON;
/// The share of a refused step at which its second derivative is taken, as in the source.
const BEND_AT: f64 = 0.1;
/// Largest ratio of twice the bend to the step: beyond it, the step is too long for a second-order correction (the source's alpha).
const MOST_BEND: f64 = 0.75;

/// A search from one start. A single object serves all passes of a robust fit, so that they share their memory.
pub(super) struct Descent<'a, P> {
    problem: &'a mut P,
    options: &'a SolverOptions,
    bounds: Option<&'a Bounds>,
    pub x: Vec<f64>,
    pub now: Point,
    trial: Point,
    scale: DVector<f64>,
    pub iterations: Vec<IterationRecord>,
}

/// A scaled step, and the parameters that it holds at bounds.
struct Step {
    scaled: DVector<f64>,
    held: Vec<Option<Side>>,
}

impl<'a, P: LeastSquares> Descent<'a, P> {
    /// Evaluates the problem at `x`, which must lie within the bounds.
    pub fn new(
        problem: &'a mut P,
        x: Vec<f64>,
        options: &'a SolverOptions,
        bounds: Option<&'a Bounds>,
    ) -> Self {
        let n = problem.parameters();
        let mut now = Point::of(problem);
        now.place(problem, &x, None);
        Self {
            trial: Point::of(problem),
            scale: DVector::zeros(n),
            iterations: Vec::new(),
            problem,
            options,
            bounds,
            x,
            now,
        }
    }

    /// Continues to the minimum of one cost.
    pub fn run(&mut self, robust: Option<Robust>) -> TerminationReason {
        self.now.weigh(robust);
        self.scale.fill(0.0);
        let mut damping = FIRST_DAMPING;
        let (mut model_holds, mut easy) = (false, true);
        let first = self.iterations.len();
        let Some(mut normal) = self.now.cost.is_finite().then(|| self.normal_equations()).flatten() else {
            return TerminationReason::NotFinite;
        };
        loop {
            if self.steepest(&normal) <= self.options.gradient * self.now.cost.sqrt() {
                return TerminationReason::SmallGradient;
            }
            if self.iterations.len() - first >= self.options.max_iterations {
                return TerminationReason::IterationLimit;
            }
            let Some(step) = self.step(&normal, damping) else {
                damping *= 10.0;
                if damping > MOST_DAMPING {
                    return TerminationReason::NoDecrease;
                }
                continue;
            };
            let mut moved = self.moved(&step);
            let curvature = normal.curvature(&step.scaled);
            let predicted = normal.predicted_decrease(&step.scaled, curvature);
            let negligible = self.is_negligible(&normal, curvature, damping);
            if negligible && model_holds && self.follow(&moved, robust) {
                self.x = moved;
                self.record(damping, &step, 1.0, true);
                return TerminationReason::SmallDecrease;
            }
            self.trial.place(self.problem, &moved, robust);
            let mut gain = self.gain(predicted);
            if !negligible && !self.suffices(gain, predicted) {
                easy = false;
                if let Some(bent) = self.bent(&normal, damping, &step, &moved) {
                    self.trial.place(self.problem, &bent, robust);
                    (moved, gain) = (bent, self.gain(predicted));
                }
            }
            let falls =
                if negligible { self.trial.cost <= self.now.cost } else { self.suffices(gain, predicted) };
            let accepted = falls && self.go_on(&mut normal, negligible);
            if accepted {
                self.x = moved;
            }
            self.record(damping, &step, gain, accepted);
            model_holds = accepted && (gain - 1.0).abs() <= EXACT_GAIN;
            if accepted {
                if negligible {
                    return TerminationReason::SmallDecrease;
                }
                damping = next_damping(damping, gain, easy);
            } else if negligible {
                // The cost cannot decrease further because of rounding.
                return TerminationReason::SmallStep;
            } else {
                damping *= 10.0;
                if damping > MOST_DAMPING {
                    return TerminationReason::NoDecrease;
                }
            }
        }
    }

    /// Actual over predicted decrease of the trial.
    fn gain(&self, predicted: f64) -> f64 {
        if predicted > 0.0 { (self.now.cost - self.trial.cost) / predicted } else { 0.0 }
    }

    /// Whether the cost decreases enough at the trial point. A NaN cost counts as no decrease.
    fn suffices(&self, gain: f64, predicted: f64) -> bool {
        self.trial.cost <= self.now.cost && (gain >= SUFFICIENT_GAIN || predicted <= ROUNDING * self.now.cost)
    }

    /// End of a step that follows the curvature of the residuals; `None` where the bend is not small against the step. The
    /// trial's residuals are overwritten.
    fn bent(
        &mut self,
        normal: &NormalEquations,
        damping: f64,
        step: &Step,
        moved: &[f64],
    ) -> Option<Vec<f64>> {
        let part = DVector::from_iterator(
            moved.len(),
            moved.iter().zip(&self.x).map(|(to, from)| BEND_AT * (to - from)),
        );
        let at: Vec<f64> = self.x.iter().zip(&part).map(|(x, part)| x + part).collect();
        // Half of the second derivative along the whole step.
        let curvature = &mut self.trial.residuals;
        self.problem.evaluate(&at, curvature, None);
        *curvature -= &self.now.residuals;
        curvature.gemv(-1.0, &self.now.jacobian, &part, 1.0);
        *curvature /= BEND_AT * BEND_AT;
        let pull = (0..at.len()).map(|j| -self.now.against(j, &self.trial.residuals) / self.scale[j]);
        let bend = normal.solve(damping, &DVector::from_iterator(at.len(), pull), &step.held)?;
        if 2.0 * bend.norm() > MOST_BEND * step.scaled.norm() {
            return None;
        }
        let bent =
            moved.iter().zip(bend.iter().zip(&self.scale)).enumerate().map(|(j, (x, (bend, scale)))| {
                let x = x + bend / scale;
                self.bounds.map_or(x, |bounds| bounds.nearest(j, x))
            });
        Some(bent.collect())
    }

    fn record(&mut self, damping: f64, step: &Step, gain: f64, accepted: bool) {
        self.iterations.push(IterationRecord {
            cost: self.now.cost,
            damping,
            step: step.scaled.norm(),
            gain,
            accepted,
            parameters: self.x.clone(),
        });
    }

    /// Takes a negligible step after a step that showed the problem to be linear: residuals follow from the Jacobian, which stays. Returns false,
    /// and changes nothing, where rounding would increase the cost.
    fn follow(&mut self, moved: &[f64], robust: Option<Robust>) -> bool {
        let change =
            DVector::from_iterator(moved.len(), moved.iter().zip(&self.x).map(|(to, from)| to - from));
        self.trial.residuals.copy_from(&self.now.residuals);
        self.trial.residuals.gemv(1.0, &self.now.jacobian, &change, 1.0);
        self.trial.stay_beside(&self.now);
        self.trial.weigh(robust);
        let falls = self.trial.cost <= self.now.cost;
        if falls {
            std::mem::swap(&mut self.trial.jacobian, &mut self.now.jacobian);
            std::mem::swap(&mut self.trial, &mut self.now);
        }
        falls
    }

    /// Makes the trial point the current one. Returns false, and changes nothing, where its derivatives are not finite. The last point needs
    /// no normal equations.
    fn go_on(&mut self, normal: &mut NormalEquations, last: bool) -> bool {
        std::mem::swap(&mut self.now, &mut self.trial);
        let finite = if last {
            self.now.is_finite()
        } else if let Some(next) = self.normal_equations() {
            *normal = next;
            true
        } else {
            false
        };
        if !finite {
            std::mem::swap(&mut self.now, &mut self.trial);
        }
        finite
    }

    /// Parameters at their bounds.
    pub fn at_bound(&self) -> Vec<AtBound> {
        let Some(bounds) = self.bounds else { return Vec::new() };
        (0..self.x.len())
            .filter_map(|parameter| {
                let gradient = self.now.gradient(parameter);
                let side = bounds.side(parameter, self.x[parameter], gradient)?;
                Some(AtBound { parameter, side, gradient })
            })
            .collect()
    }

    fn normal_equations(&mut self) -> Option<NormalEquations> {
        let mut normal = NormalEquations::new(&self.now)?;
        normal.rescale(&mut self.scale);
        Some(normal)
    }

    /// Largest derivative that is not held by a bound: the cosine of the angle between residuals and column times the norm of the residuals.
    fn steepest(&self, normal: &NormalEquations) -> f64 {
        let gradient = normal.gradient();
        let held = |j: usize| {
            self.bounds
                .and_then(|bounds| bounds.side(j, self.x[j], gradient[j]))
                .is_some_and(|side| side.holds(gradient[j]))
        };
        (0..gradient.len()).filter(|&j| !held(j)).map(|j| gradient[j].abs()).fold(0.0, f64::max)
    }

    fn step(&self, normal: &NormalEquations, damping: f64) -> Option<Step> {
        let Some(bounds) = self.bounds else {
            return Some(Step { scaled: normal.damped_step(damping)?, held: Vec::new() });
        };
        let inside = bounds.of_step(&self.x, &self.scale);
        let bounded = inside.minimise(&normal.damped(damping), normal.gradient())?;
        Some(Step { scaled: bounded.step, held: bounded.held })
    }

    fn moved(&self, step: &Step) -> Vec<f64> {
        let mut moved: Vec<f64> = self
            .x
            .iter()
            .zip(step.scaled.iter().zip(&self.scale))
            .map(|(x, (step, scale))| x + step / scale)
            .collect();
        if let Some(bounds) = self.bounds {
            // Exactly, so that a parameter either is at its bound or is not.
            for (j, value) in moved.iter_mut().enumerate() {
                *value = match step.held[j] {
                    Some(side) => bounds.at(j, side),
                    None => bounds.nearest(j, *value),
                };
            }
        }
        moved
    }

    /// Whether the step, or, if damping shortened it, the step with little damping, is too small to matter.
    fn is_negligible(&self, normal: &NormalEquations, curvature: f64, damping: f64) -> bool {
        let curvature = if damping <= SHORTENING_DAMPING {
            Some(curvature)
        } else {
            self.step(normal, FIRST_DAMPING).map(|step| normal.curvature(&step.scaled))
        };
        let Some(square) = curvature else { return false };
        // Where the cost cannot distinguish the step from rounding, further steps would only follow the last digit.
        let floor = (4.0 * f64::EPSILON).max(self.options.relative_decrease.powi(2));
        square <= self.options.absolute_decrease.powi(2) || square <= floor * self.now.cost
    }
}

/// `easy`: no step has been refused so far.
fn next_damping(damping: f64, gain: f64, easy: bool) -> f64 {
    if gain > 0.75 {
        (damping * if easy { 1e-3 } else { 0.1 }).max(LEAST_DAMPING)
    } else if gain < 0.25 {
        damping * 4.0
    } else {
        damping
    }
}
