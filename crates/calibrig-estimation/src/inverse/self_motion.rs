//! Along the poses in which the tool stays where it is, to where a criterion is least.
//!
//! Sequential quadratic programming on the self-motion: a quasi-Newton step (damped BFGS, M. J. D. Powell 1978) in the null space of the goal's rows
//! and of the limits that are touched, as far as the next limit, back onto the goal by least squares, and shorter until the criterion falls
//! (L. Armijo 1966). Limits are let go where the criterion pulls away from them.

use nalgebra::{DMatrix, DVector};

use super::arm::Arm;
use super::criterion::{Judge, Question};
use super::joint_space::JointSpace;
use super::solver::{Ended, Search};
use crate::identification::PredictionError;

/// Steps before giving up.
const MOST: usize = 100;
/// The criterion is least where a step promises no more than this share of it and of one.
const LEAST: f64 = 1e-13;
/// A step that is shortened to less leads nowhere.
const SHORTEST: f64 = 1e-6;
/// Share of the promised fall that a step has to bring.
const ARMIJO: f64 = 1e-4;
/// Steps back onto the goal.
const BACK: usize = 12;
/// The longest step, in halves of the joints' ways.
const LONGEST: f64 = 0.25;

/// What was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Least {
    pub value: f64,
    pub steps: usize,
    /// Whether a local minimum was found, to the accuracy of numbers.
    pub converged: bool,
}

/// Goes from `y`, where the goal is met, along the self-motion; leaves `y` and the arm where the criterion is least.
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
    let mut hessian = first_hessian(space, asked);
    let mut held = vec![false; n];
    let mut steps = 0;
    while steps < MOST {
        search.go_to(y)?;
        search.linearise(y)?;
        let rows = rows_of(search, y)?;
        touch(search, &gradient, &hessian, &rows, y, &mut held);
        let Some((direction, multipliers)) = step_within(&hessian, &gradient, &rows, &held) else { break };
        let promised = -gradient.dot(&direction);
        if !(promised > LEAST * (1.0 + value.abs())) {
            return Ok(Least { value, steps, converged: true });
        }
        steps += 1;
        let mut share = longest_share(search, &direction, y);
        let mut next = None;
        while share > SHORTEST {
            let mut tried: Vec<f64> = y.iter().zip(direction.iter()).map(|(y, d)| y + share * d).collect();
            clamp(search, &mut tried);
            if let Some((Ended::Reached, _)) = search.descend(&mut tried, BACK, false)
                && let Ok(now) = judge.value(space, asked, &tried, None)
                && now <= value - ARMIJO * share * promised
            {
                next = Some(tried);
                break;
            }
            share *= 0.5;
        }
        let Some(next) = next else {
            search.go_to(y)?;
            // Where not even rounding lets it fall.
            return Ok(Least { value, steps, converged: promised <= 1e-7 * (1.0 + value.abs()) });
        };
        let before = std::mem::replace(&mut gradient, DVector::zeros(n));
        value = judge.value(space, asked, &next, Some(&mut gradient))?;
        let moved = DVector::from_iterator(n, next.iter().zip(y.iter()).map(|(a, b)| a - b));
        y.copy_from_slice(&next);
        search.go_to(y)?;
        search.linearise(y)?;
        let now = rows_of(search, y)?;
        if now.nrows() == multipliers.len() {
            let change = (&gradient - now.tr_mul(&multipliers)) - (before - rows.tr_mul(&multipliers));
            update(&mut hessian, &moved, &change);
        }
    }
    search.go_to(y)?;
    Ok(Least { value, steps, converged: false })
}

/// Second derivatives of the quadratic parts; of the others a share of them, which is learnt.
fn first_hessian(space: &JointSpace, asked: &Question<'_>) -> DMatrix<f64> {
    let criterion = &asked.criterion;
    let n = space.len() as f64;
    let known = criterion.limits + criterion.motion;
    let weight = known + 0.3 * criterion.manipulability + criterion.deflection;
    let entry = |unknown: usize| 2.0 * weight / (n * space.scale(unknown).powi(2));
    DMatrix::from_diagonal(&DVector::from_fn(space.len(), |unknown, _| entry(unknown)))
}

/// Rows that a self-motion keeps: the goal's, and those of joints that are at a limit which is no bound of an unknown.
fn rows_of<A: Arm>(search: &Search<'_, A>, y: &[f64]) -> Result<DMatrix<f64>, PredictionError> {
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

/// Decides which bounds hold: all that are touched, without those that the criterion pulls away from.
fn touch<A: Arm>(
    search: &Search<'_, A>,
    gradient: &DVector<f64>,
    hessian: &DMatrix<f64>,
    rows: &DMatrix<f64>,
    y: &[f64],
    held: &mut [bool],
) {
    for (unknown, held) in held.iter_mut().enumerate() {
        *held = y[unknown] <= search.low[unknown] || y[unknown] >= search.high[unknown];
    }
    for _ in 0..y.len() {
        let Some((direction, multipliers)) = step_within(hessian, gradient, rows, held) else { return };
        let force = gradient + hessian * &direction - rows.tr_mul(&multipliers);
        // What the criterion would fall by if the bound were let go.
        let pull = |unknown: usize| {
            let fixed = search.low[unknown] == search.high[unknown];
            let inwards = if y[unknown] <= search.low[unknown] { -force[unknown] } else { force[unknown] };
            if held[unknown] && !fixed { inwards } else { 0.0 }
        };
        let strongest = (0..y.len()).max_by(|a, b| pull(*a).total_cmp(&pull(*b)));
        match strongest.filter(|unknown| pull(*unknown) > 1e-12) {
            Some(unknown) => held[unknown] = false,
            None => break,
        }
    }
    // A step that would leave a bound it stands on keeps to it.
    for _ in 0..y.len() {
        let Some((direction, _)) = step_within(hessian, gradient, rows, held) else { return };
        let leaves = |unknown: &usize| {
            !held[*unknown]
                && ((y[*unknown] <= search.low[*unknown] && direction[*unknown] < 0.0)
                    || (y[*unknown] >= search.high[*unknown] && direction[*unknown] > 0.0))
        };
        match (0..y.len()).find(leaves) {
            Some(unknown) => held[unknown] = true,
            None => break,
        }
    }
}

/// The step to where the quadratic model is least with rows and bounds kept, and the multipliers of the rows.
fn step_within(
    hessian: &DMatrix<f64>,
    gradient: &DVector<f64>,
    rows: &DMatrix<f64>,
    held: &[bool],
) -> Option<(DVector<f64>, DVector<f64>)> {
    // Unknowns that are held have an equation of their own: they do not move.
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
    // Enough for rows that nothing free moves along.
    for row in 0..product.nrows() {
        product[(row, row)] += (1e-13 * trace).max(f64::MIN_POSITIVE);
    }
    let multipliers = product.cholesky()?.solve(&(-(&free * &towards)));
    let step = towards + across * &multipliers;
    step.iter().all(|v| v.is_finite()).then_some((step, multipliers))
}

/// How much of a step leads to the first bound, and is not too long.
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

fn clamp<A: Arm>(search: &Search<'_, A>, y: &mut [f64]) {
    for (y, (low, high)) in y.iter_mut().zip(search.low.iter().zip(search.high)) {
        *y = y.clamp(*low, *high);
    }
}

/// Powell's damped BFGS update: the matrix stays positive.
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
