//! Minimises a criterion over the poses in which the tool stays where it is.
//!
//! Sequential quadratic programming on the self-motion: a quasi-Newton step (damped BFGS, M. J. D. Powell 1978) in the null space of the goal's rows
//! and of the limits that are touched, as far as the next limit, back onto the goal by least squares, and shortened until the criterion decreases
//! (L. Armijo 1966). Limits are released where the criterion pulls away from them.

use nalgebra::{DMatrix, DVector};

use super::arm::Arm;
use super::criterion::{Judge, Question};
use super::joint_space::JointSpace;
use super::solver::{Ended, Search};
use crate::identification::PredictionError;

/// Most steps.
const MOST: usize = 100;
/// The criterion counts as minimal where a step promises no more than this share of it, plus one.
const LEAST: f64 = 1e-13;
/// A step that is shortened below this leads nowhere.
const SHORTEST: f64 = 1e-6;
/// Share of the promised decrease that a step has to achieve; [`NOISE`] is the uncertainty of a value: equilibria are found to 1e-13 m.
const ARMIJO: f64 = 1e-4;
const NOISE: f64 = 1e-10;
/// Where no step decreases the criterion, it counts as minimal if no more than this share was promised.
const ROUNDED: f64 = 1e-7;
/// Distance within which an unknown counts as at its bound, in halves of its range.
const AT_BOUND: f64 = 1e-12;
/// A bound is released where the criterion pulls by more than this.
const PULLS: f64 = 1e-12;
/// Most steps back onto the goal.
const BACK: usize = 12;
/// The longest step, in halves of the joints' ranges.
const LONGEST: f64 = 0.25;

/// Result of the minimisation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Least {
    pub value: f64,
    pub steps: usize,
    /// Whether a local minimum was found, to the accuracy of the arithmetic.
    pub converged: bool,
}

/// Moves from `y`, where the goal is met, along the self-motion; leaves `y` and the arm where the criterion is least.
pub(super) fn minimise<A: Arm>(
    search: &mut Search<'_, A>,
    judge: &mut Judge,
    asked: &Question<'_>,
    y: &mut [f64],
) -> Result<Least, PredictionError> {
    let space = search.space;
    let n = y.len();
    let mut gradient = DVector::zeros(n);
    let mut value = judge.value(space, asked, y, Some(&mut gradient))?;
    let mut hessian = first_hessian(space, asked, value);
    let mut held = vec![false; n];
    search.go_to(y)?;
    let mut rows = rows_at(search, y)?;
    let mut steps = 0;
    while steps < MOST {
        let Some((direction, multipliers)) = direction(search, &gradient, &hessian, &rows, y, &mut held)
        else {
            break;
        };
        // The gradient's own prediction is less exact, since rows are kept only to rounding.
        let promised = direction.dot(&(&hessian * &direction));
        if !(promised > LEAST * (1.0 + value.abs())) {
            return Ok(Least { value, steps, converged: true });
        }
        steps += 1;
        let Some(next) = step(search, judge, asked, y, (&direction, promised, value)) else {
            search.go_to(y)?;
            return Ok(Least { value, steps, converged: promised <= ROUNDED * (1.0 + value.abs()) });
        };
        let before = gradient.clone();
        value = judge.value(space, asked, &next, Some(&mut gradient))?;
        let moved = DVector::from_iterator(n, next.iter().zip(y.iter()).map(|(a, b)| a - b));
        y.copy_from_slice(&next);
        let now = rows_at(search, y)?;
        if now.nrows() == multipliers.len() {
            let change = (&gradient - now.tr_mul(&multipliers)) - (before - rows.tr_mul(&multipliers));
            update(&mut hessian, &moved, &change);
        }
        rows = now;
    }
    Ok(Least { value, steps, converged: false })
}

/// Moves along a direction as far as the criterion decreases, and back onto the goal; the arm is left there. `None` where it does not decrease.
fn step<A: Arm>(
    search: &mut Search<'_, A>,
    judge: &mut Judge,
    asked: &Question<'_>,
    y: &[f64],
    (direction, promised, value): (&DVector<f64>, f64, f64),
) -> Option<Vec<f64>> {
    let mut share = longest_share(search, direction, y);
    while share > SHORTEST {
        let mut tried: Vec<f64> = y.iter().zip(direction.iter()).map(|(y, d)| y + share * d).collect();
        pin_to_bounds(search, &mut tried);
        let most = value - ARMIJO * share * promised + NOISE * (1.0 + value.abs());
        let back = search.descend(&mut tried, BACK, false);
        search.pinned.fill(false);
        if let Some((Ended::Reached, _)) = back
            && judge.value(search.space, asked, &tried, None).is_ok_and(|now| now <= most)
        {
            return Some(tried);
        }
        share *= 0.5;
    }
    None
}

/// Initial second derivatives: exact for the quadratic parts, a rough scale for the others, which is improved by the updates.
fn first_hessian(space: &JointSpace, asked: &Question<'_>, value: f64) -> DMatrix<f64> {
    let criterion = &asked.criterion;
    let n = space.len() as f64;
    let known = criterion.limits + criterion.motion;
    // The curvature of a squared deflection is of the order of its value.
    let bent = if criterion.deflection > 0.0 { value.abs() } else { 0.0 };
    let weight = known + 0.3 * criterion.manipulability + criterion.deflection + bent;
    let entry = |unknown: usize| 2.0 * weight / (n * space.scale(unknown).powi(2));
    DMatrix::from_diagonal(&DVector::from_fn(space.len(), |unknown, _| entry(unknown)))
}

/// Rows that a self-motion keeps at the current pose: those of the goal, and those of joints at a limit that is not a bound of an unknown.
fn rows_at<A: Arm>(search: &mut Search<'_, A>, y: &[f64]) -> Result<DMatrix<f64>, PredictionError> {
    search.linearise(y)?;
    let goal = search.aim.rows();
    let space = search.space;
    let rows = search.rows.rows(0, goal).into_owned();
    if space.sides.is_empty() {
        return Ok(rows);
    }
    let mut joints = vec![0.0; space.kinematics.joint_count()];
    space.joints(y, &mut joints).map_err(super::arm::no_pose)?;
    let rates = space.joint_rates(y).map_err(super::arm::no_pose)?;
    let at_limit = |joint: &&usize| {
        let [low, high] = space.kinematics.links[**joint].limits;
        joints[**joint] <= low + 1e-9 || joints[**joint] >= high - 1e-9
    };
    let sides: Vec<usize> = space.sides.iter().filter(at_limit).copied().collect();
    let mut all = rows.resize_vertically(goal + sides.len(), 0.0);
    for (side, joint) in sides.iter().enumerate() {
        all.set_row(goal + side, &rates.row(*joint));
    }
    Ok(all)
}

/// The step, the rows' multipliers, and the bounds that hold: all that are touched, except those that the criterion pulls away from.
fn direction<A: Arm>(
    search: &Search<'_, A>,
    gradient: &DVector<f64>,
    hessian: &DMatrix<f64>,
    rows: &DMatrix<f64>,
    y: &[f64],
    held: &mut [bool],
) -> Option<(DVector<f64>, DVector<f64>)> {
    let (low, high) = (search.low, search.high);
    for (unknown, held) in held.iter_mut().enumerate() {
        *held = y[unknown] <= low[unknown] || y[unknown] >= high[unknown];
    }
    let mut found = step_within(hessian, gradient, rows, held)?;
    for _ in 0..y.len() {
        let force = gradient + hessian * &found.0 - rows.tr_mul(&found.1);
        // Decrease of the criterion if the bound were released.
        let pull = |unknown: usize| {
            let inwards = if y[unknown] <= low[unknown] { -force[unknown] } else { force[unknown] };
            if held[unknown] && low[unknown] < high[unknown] { inwards } else { 0.0 }
        };
        let strongest = (0..y.len()).max_by(|a, b| pull(*a).total_cmp(&pull(*b)));
        let Some(unknown) = strongest.filter(|unknown| pull(*unknown) > PULLS) else { break };
        held[unknown] = false;
        found = step_within(hessian, gradient, rows, held)?;
    }
    // A step that would leave the bound it is on is kept on it.
    for _ in 0..y.len() {
        let leaves = |unknown: &usize| {
            let step = found.0[*unknown];
            let out =
                (y[*unknown] <= low[*unknown] && step < 0.0) || (y[*unknown] >= high[*unknown] && step > 0.0);
            out && !held[*unknown]
        };
        let Some(unknown) = (0..y.len()).find(leaves) else { break };
        held[unknown] = true;
        found = step_within(hessian, gradient, rows, held)?;
    }
    Some(found)
}

/// The step to the minimum of the quadratic model with rows and bounds kept, and the multipliers of the rows.
fn step_within(
    hessian: &DMatrix<f64>,
    gradient: &DVector<f64>,
    rows: &DMatrix<f64>,
    held: &[bool],
) -> Option<(DVector<f64>, DVector<f64>)> {
    // Held unknowns have their own equation: they do not move.
    let mut curvature = hessian.clone();
    let mut right = -gradient;
    let mut free = rows.clone();
    for unknown in (0..held.len()).filter(|unknown| held[*unknown]) {
        curvature.row_mut(unknown).fill(0.0);
        curvature.column_mut(unknown).fill(0.0);
        curvature[(unknown, unknown)] = 1.0;
        right[unknown] = 0.0;
        free.column_mut(unknown).fill(0.0);
    }
    // B d = right + Jᵀ λ, J d = 0
    let factor = curvature.cholesky()?;
    let towards = factor.solve(&right);
    let across = factor.solve(&free.transpose());
    let mut product = &free * &across;
    let trace = product.trace();
    // Enough for rows along which nothing free moves.
    for row in 0..product.nrows() {
        product[(row, row)] += (1e-13 * trace).max(f64::MIN_POSITIVE);
    }
    let multipliers = product.cholesky()?.solve(&(-(&free * &towards)));
    let step = towards + across * &multipliers;
    step.iter().all(|v| v.is_finite()).then_some((step, multipliers))
}

/// Share of a step that leads to the first bound and is not too long.
fn longest_share<A: Arm>(search: &Search<'_, A>, direction: &DVector<f64>, y: &[f64]) -> f64 {
    let mut share = 1.0_f64;
    for (unknown, d) in direction.iter().enumerate().filter(|(_, d)| **d != 0.0) {
        let room =
            if *d > 0.0 { search.high[unknown] - y[unknown] } else { y[unknown] - search.low[unknown] };
        if room > 0.0 {
            share = share.min(room / d.abs());
        }
        share = share.min(LONGEST * search.space.scale(unknown) / d.abs());
    }
    share
}

/// Clamps unknowns to their bounds. Those that reach a bound stay there on the way back onto the goal, so that the bound is finally reached.
fn pin_to_bounds<A: Arm>(search: &mut Search<'_, A>, y: &mut [f64]) {
    for (unknown, y) in y.iter_mut().enumerate() {
        let (low, high) = (search.low[unknown], search.high[unknown]);
        let near = AT_BOUND * search.space.scale(unknown);
        *y = if *y <= low + near {
            low
        } else if *y >= high - near {
            high
        } else {
            *y
        };
        search.pinned[unknown] = *y == low || *y == high;
    }
}

/// Powell's damped BFGS update: the matrix stays positive definite.
fn update(hessian: &mut DMatrix<f64>, moved: &DVector<f64>, change: &DVector<f64>) {
    let by_model = &*hessian * moved;
    let curved = moved.dot(&by_model);
    if !(curved > 0.0) || !change.iter().all(|v| v.is_finite()) {
        return;
    }
    let seen = moved.dot(change);
    let share = if seen >= 0.2 * curved { 1.0 } else { 0.8 * curved / (curved - seen) };
    let blended = change * share + &by_model * (1.0 - share);
    let along = moved.dot(&blended);
    if along > f64::MIN_POSITIVE {
        *hessian += &blended * blended.transpose() / along - &by_model * by_model.transpose() / curved;
    }
}
