//! Damped least squares within bounds.
//!
//! Levenberg's method on the squared miss, damped by a multiple of the miss itself, which makes it converge quadratically also where the
//! Jacobian loses rank (N. Yamashita and M. Fukushima, Computing Suppl. 15 (2001) 239; T. Sugihara, IEEE Trans. Robotics 27 (2011) 984). A step
//! that would leave the limits puts the joint on its limit, and the other joints make up for it.

use nalgebra::{DMatrix, Matrix6xX};

use super::arm::Arm;
use super::joint_space::JointSpace;
use super::task::{Aim, Miss};
use crate::identification::PredictionError;

/// Initial and least damping, relative to the squared miss.
const DAMPING: f64 = 1e-2;
const LEAST_DAMPING: f64 = 1e-4;
/// Factor by which the damping grows where a step does not reduce the miss, and how often.
const HARDER: f64 = 8.0;
const TRIES: usize = 12;
/// The longest step of an unknown, m or rad.
const LONGEST: f64 = 1.0;
/// Where there are other starts, a search is given up if the miss decreases by less than a tenth in this many steps.
const PATIENCE: usize = 5;
const SLOW: f64 = 0.81;
/// Ratio of the gradient to miss and Jacobian at which nothing reduces the miss.
const FLAT: f64 = 1e-9;
/// Metres that a metre or radian beyond a limit counts, for limits that are not bounds of an unknown.
const SIDE: f64 = 10.0;

/// How a search ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Ended {
    /// The miss is within the tolerance.
    Reached,
    /// Nothing reduces the miss, or not fast enough.
    Stuck,
}

/// A search for the unknowns at which an arm meets an aim.
pub(super) struct Search<'a, A: Arm> {
    pub arm: &'a mut A,
    pub space: &'a JointSpace,
    pub aim: Aim,
    /// Bounds of the unknowns: the limits, or narrower ones.
    pub low: &'a [f64],
    pub high: &'a [f64],
    /// The goal counts as met if the miss is no longer than this, m.
    pub tolerance: f64,
    /// Unknowns that must not move.
    pub pinned: Vec<bool>,
    miss: Miss,
    /// The miss, row by row: rows of the aim, then one per joint whose limits are not bounds, m.
    errors: Vec<f64>,
    /// Jacobian, rows by unknowns.
    pub rows: DMatrix<f64>,
    motions: Matrix6xX<f64>,
    joints: Vec<f64>,
    gram: Vec<f64>,
    right: Vec<f64>,
    step: Vec<f64>,
    fixed: Vec<Option<f64>>,
}

impl<'a, A: Arm> Search<'a, A> {
    pub fn new(arm: &'a mut A, space: &'a JointSpace, aim: Aim, tolerance: f64) -> Self {
        let (rows, n) = (aim.rows() + space.sides.len(), space.len());
        let miss = aim.miss(&arm.base_from_tool());
        Self {
            arm,
            space,
            aim,
            low: &space.low,
            high: &space.high,
            tolerance,
            pinned: vec![false; n],
            miss,
            errors: vec![0.0; rows],
            rows: DMatrix::zeros(rows, n),
            motions: Matrix6xX::zeros(n),
            joints: vec![0.0; space.kinematics.joint_count()],
            gram: vec![0.0; rows * rows],
            right: vec![0.0; rows],
            step: vec![0.0; n],
            fixed: vec![None; n],
        }
    }

    /// Moves to `y`; returns the squared miss, m².
    pub fn go_to(&mut self, y: &[f64]) -> Result<f64, PredictionError> {
        self.arm.place(self.space, y)?;
        self.miss = self.aim.miss(&self.arm.base_from_tool());
        self.aim.errors(&self.miss, &mut self.errors);
        let rows = self.aim.rows();
        if !self.space.sides.is_empty() {
            self.space.joints(y, &mut self.joints).map_err(super::arm::no_pose)?;
            for (side, joint) in self.space.sides.iter().enumerate() {
                let [low, high] = self.space.kinematics.links[*joint].limits;
                self.errors[rows + side] =
                    SIDE * (self.joints[*joint].clamp(low, high) - self.joints[*joint]);
            }
        }
        Ok(self.errors.iter().map(|e| e * e).sum())
    }

    /// Derivatives of the rows by the unknowns at the arm's current pose; joints whose limits are not bounds count only beyond a limit.
    pub fn linearise(&mut self, y: &[f64]) -> Result<(), PredictionError> {
        self.arm.differentiate(self.space, &mut self.motions)?;
        self.aim.project(&self.miss, &self.motions, &mut self.rows);
        let first = self.aim.rows();
        if !self.space.sides.is_empty() {
            let rates = self.space.joint_rates(y).map_err(super::arm::no_pose)?;
            for (side, joint) in self.space.sides.iter().enumerate() {
                let share = if self.errors[first + side] == 0.0 { 0.0 } else { SIDE };
                self.rows.set_row(first + side, &(rates.row(*joint) * share));
            }
        }
        Ok(())
    }

    /// Whether the miss is small enough.
    pub fn is_reached(&self, cost: f64) -> bool {
        cost <= self.tolerance * self.tolerance
    }

    /// Moves from `y` to where nothing reduces the miss, in at most `most` steps; an `impatient` search ends where progress is slow. The arm is left
    /// at `y`. `None` where the robot cannot even take the first pose.
    pub fn descend(&mut self, y: &mut [f64], most: usize, impatient: bool) -> Option<(Ended, f64)> {
        let mut cost = self.go_to(y).ok()?;
        let mut damping = DAMPING;
        let mut tried = y.to_vec();
        let mut since = (cost, 0);
        for _ in 0..most {
            if self.is_reached(cost) {
                return Some((Ended::Reached, cost));
            }
            self.linearise(y).ok()?;
            if self.is_flat(y, cost) {
                return Some((Ended::Stuck, cost));
            }
            let before = cost;
            for _ in 0..TRIES {
                self.set_step(y, damping * cost);
                for (tried, (y, step)) in tried.iter_mut().zip(y.iter().zip(&self.step)) {
                    *tried = y + step;
                }
                self.clamp(&mut tried);
                match self.go_to(&tried) {
                    Ok(nearer) if nearer < cost => {
                        damping = (damping / HARDER).max(LEAST_DAMPING);
                        cost = nearer;
                        y.copy_from_slice(&tried);
                        break;
                    }
                    _ => damping *= HARDER,
                }
            }
            if cost == before {
                // As close as rounding allows.
                self.go_to(y).ok()?;
                return Some((if self.is_reached(cost) { Ended::Reached } else { Ended::Stuck }, cost));
            }
            since.1 += 1;
            if since.1 == PATIENCE {
                if impatient && cost > SLOW * since.0 {
                    return Some((Ended::Stuck, cost));
                }
                since = (cost, 0);
            }
        }
        Some((if self.is_reached(cost) { Ended::Reached } else { Ended::Stuck }, cost))
    }

    fn clamp(&self, y: &mut [f64]) {
        for (y, (low, high)) in y.iter_mut().zip(self.low.iter().zip(self.high)) {
            *y = y.clamp(*low, *high);
        }
    }

    /// Decrease of half the squared miss per unit of an unknown.
    fn gain(&self, unknown: usize) -> f64 {
        self.rows.column(unknown).iter().zip(&self.errors).map(|(row, error)| row * error).sum()
    }

    /// Whether an unknown that would move in this direction is pinned, or held by a limit.
    fn is_held(&self, unknown: usize, y: f64, towards: f64) -> bool {
        self.pinned[unknown]
            || (y <= self.low[unknown] && towards <= 0.0)
            || (y >= self.high[unknown] && towards >= 0.0)
    }

    fn is_flat(&self, y: &[f64], cost: f64) -> bool {
        let held = |unknown: usize| {
            let gain = self.gain(unknown);
            if self.is_held(unknown, y[unknown], gain) { 0.0 } else { gain.abs() }
        };
        let steepest = (0..y.len()).map(held).fold(0.0, f64::max);
        steepest <= FLAT * cost.sqrt() * self.rows.amax()
    }

    /// Sets the damped step within the bounds.
    fn set_step(&mut self, y: &[f64], damping: f64) {
        for (unknown, at) in y.iter().enumerate() {
            let held = self.is_held(unknown, *at, self.gain(unknown));
            self.fixed[unknown] = held.then_some(0.0);
        }
        for _ in 0..=y.len() {
            self.solve(damping);
            let excess = |unknown: usize| {
                let to = y[unknown] + self.step[unknown];
                (self.low[unknown] - to).max(to - self.high[unknown])
            };
            let outside =
                (0..y.len()).filter(|unknown| self.fixed[*unknown].is_none() && excess(*unknown) > 0.0);
            let Some(worst) = outside.max_by(|a, b| excess(*a).total_cmp(&excess(*b))) else { break };
            let bound = if self.step[worst] > 0.0 { self.high[worst] } else { self.low[worst] };
            self.fixed[worst] = Some(bound - y[worst]);
        }
        let longest = self.step.iter().fold(0.0_f64, |longest, step| longest.max(step.abs()));
        if longest > LONGEST {
            self.step.iter_mut().for_each(|step| *step *= LONGEST / longest);
        }
    }

    /// `Jᵀ (J Jᵀ + damping)⁻¹ e` over the unknowns that are free.
    fn solve(&mut self, damping: f64) {
        let count = self.errors.len();
        self.right.copy_from_slice(&self.errors);
        self.gram.fill(0.0);
        let mut trace = 0.0;
        for (unknown, fixed) in self.fixed.iter().enumerate() {
            let column = self.rows.column(unknown);
            if let Some(by) = fixed {
                for (right, row) in self.right.iter_mut().zip(column.iter()) {
                    *right -= row * by;
                }
                continue;
            }
            for i in 0..count {
                for j in 0..=i {
                    self.gram[i * count + j] += column[i] * column[j];
                }
                trace += column[i] * column[i];
            }
        }
        // Enough for rows that no joint moves.
        let least = (1e-14 * trace).max(f64::MIN_POSITIVE);
        for i in 0..count {
            self.gram[i * count + i] += damping + least;
        }
        solve_positive(&mut self.gram, &mut self.right);
        for (unknown, fixed) in self.fixed.iter().enumerate() {
            self.step[unknown] = fixed.unwrap_or_else(|| {
                self.rows.column(unknown).iter().zip(&self.right).map(|(row, right)| row * right).sum()
            });
        }
    }
}

/// Solves in place with the lower triangle of a positive definite matrix, row by row (Cholesky).
fn solve_positive(matrix: &mut [f64], right: &mut [f64]) {
    let n = right.len();
    for i in 0..n {
        for j in 0..=i {
            let sum: f64 = (0..j).map(|k| matrix[i * n + k] * matrix[j * n + k]).sum();
            let left = matrix[i * n + j] - sum;
            matrix[i * n + j] =
                if i == j { left.max(f64::MIN_POSITIVE).sqrt() } else { left / matrix[j * n + j] };
        }
    }
    for i in 0..n {
        let sum: f64 = (0..i).map(|k| matrix[i * n + k] * right[k]).sum();
        right[i] = (right[i] - sum) / matrix[i * n + i];
    }
    for i in (0..n).rev() {
        let sum: f64 = (i + 1..n).map(|k| matrix[k * n + i] * right[k]).sum();
        right[i] = (right[i] - sum) / matrix[i * n + i];
    }
}
