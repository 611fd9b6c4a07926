//! Offsets over a box of the workspace, for controllers that accept nothing else.

use std::ops::ControlFlow;

use nalgebra::Vector3;
use thiserror::Error;

use super::{CompensationError, Compensator};
use crate::inverse::{Goal, InverseError, InverseOptions};
use calibrig_model::geometry::Transform;

/// The grid for which offsets are computed.
#[derive(Debug, Clone, PartialEq)]
pub struct GridPlan {
    /// Lowest corner of the box along the base's axes, m.
    pub low: Vector3<f64>,
    /// Highest corner of the box, m.
    pub high: Vector3<f64>,
    /// Numbers of points along x, y and z.
    pub counts: [usize; 3],
    /// How the tool is held: as in this goal, whose position does not matter.
    pub held: Goal,
}

/// Why a grid is refused.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[non_exhaustive]
pub enum GridError {
    /// The box has no volume.
    #[error(
        "the box of the grid goes from {low} to {high} m along {axis}: expected finite numbers, the second above the first"
    )]
    Box {
        /// `x`, `y` or `z`.
        axis: char,
        /// Lower end, m.
        low: f64,
        /// Upper end, m.
        high: f64,
    },
    /// There are too few points for interpolation, or too many.
    #[error("the grid has {found} points along {axis}: expected 2 to {most}")]
    Count {
        /// `x`, `y` or `z`.
        axis: char,
        /// Number as stated.
        found: usize,
        /// Largest number that is allowed.
        most: usize,
    },
    /// No point of the grid can be reached.
    #[error("no point of the grid can be reached")]
    OutOfReach,
    /// The caller stopped the computation.
    #[error("the grid was interrupted after {done} of {total} points")]
    Interrupted {
        /// Number of points and cell middles that were done.
        done: usize,
        /// Number of all points and cell middles.
        total: usize,
    },
}

/// Most points along an axis.
const MOST: usize = 200;

/// Errors of places.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct GridSpread {
    /// Number of places that were evaluated.
    pub points: usize,
    /// Mean length of the errors, m.
    pub mean: f64,
    /// Root mean square length, m.
    pub rms: f64,
    /// Largest length, m.
    pub max: f64,
}

/// Offsets at the points of a grid: a controller that is told to go to p + offset puts the identified robot's tool at p, according to the model.
#[derive(Debug, Clone, PartialEq)]
pub struct CorrectionGrid {
    /// The plan as it was given.
    pub plan: GridPlan,
    /// Offsets, m in base axes, x fastest, then y, then z; `None` where the robot does not reach the point.
    pub offsets: Vec<Option<Vector3<f64>>>,
    /// Errors at the middles of the cells, for which no offset was computed, with the offsets of the corners interpolated trilinearly.
    pub interpolated: GridSpread,
    /// Errors at the middles of the cells without offsets.
    pub uncorrected: GridSpread,
    /// Largest angle between the tool and the goal's orientation at the middles, rad: offsets do not correct it.
    pub turned: f64,
}

/// Most iterations until the offset of a point is found, and the error that may be left, m.
const ROUNDS: usize = 12;
const LEFT: f64 = 1e-8;

impl GridPlan {
    fn check(&self) -> Result<(), GridError> {
        for (index, axis) in ['x', 'y', 'z'].into_iter().enumerate() {
            let (low, high, found) = (self.low[index], self.high[index], self.counts[index]);
            if !(low < high && low.is_finite() && high.is_finite()) {
                return Err(GridError::Box { axis, low, high });
            }
            if !(2..=MOST).contains(&found) {
                return Err(GridError::Count { axis, found, most: MOST });
            }
        }
        Ok(())
    }

    /// The place of a point by its indices along x, y and z, which may be fractional, m.
    fn place(&self, at: [f64; 3]) -> Vector3<f64> {
        let share = |axis: usize| at[axis] / (self.counts[axis].max(2) - 1) as f64;
        Vector3::from_fn(|axis, _| self.low[axis] + share(axis) * (self.high[axis] - self.low[axis]))
    }

    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        x + self.counts[0] * (y + self.counts[1] * z)
    }

    fn numbers(counts: [usize; 3]) -> impl Iterator<Item = [usize; 3]> {
        let [nx, ny, nz] = counts;
        (0..nz).flat_map(move |z| (0..ny).flat_map(move |y| (0..nx).map(move |x| [x, y, z])))
    }
}

impl CorrectionGrid {
    /// Places of the points in the order of their offsets, m.
    pub fn places(&self) -> impl Iterator<Item = Vector3<f64>> + '_ {
        GridPlan::numbers(self.plan.counts).map(|numbers| self.plan.place(numbers.map(|n| n as f64)))
    }

    /// The offset at a place of the box, m, interpolated between the eight points around it; `None` outside, and where one of the points is out of
    /// reach.
    pub fn offset(&self, place: &Vector3<f64>) -> Option<Vector3<f64>> {
        let plan = &self.plan;
        let (mut first, mut share) = ([0; 3], [0.0; 3]);
        for axis in 0..3 {
            let cells = plan.counts[axis].checked_sub(1)?;
            let at = (place[axis] - plan.low[axis]) / (plan.high[axis] - plan.low[axis]) * cells as f64;
            if !(at >= 0.0 && at <= cells as f64) {
                return None;
            }
            // Counts are small numbers.
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
            let cell = (at.floor() as usize).min(cells.checked_sub(1)?);
            (first[axis], share[axis]) = (cell, at - cell as f64);
        }
        let mut sum = Vector3::zeros();
        for corner in GridPlan::numbers([2; 3]) {
            let weights = (0..3).map(|axis| if corner[axis] == 1 { share[axis] } else { 1.0 - share[axis] });
            let numbers = [0, 1, 2].map(|axis| first[axis] + corner[axis]);
            let offset = self.offsets.get(plan.index(numbers)).copied().flatten()?;
            sum += weights.product::<f64>() * offset;
        }
        Some(sum)
    }
}

impl Compensator<'_> {
    /// Computes offsets over a box.
    ///
    /// The controller is assumed to resolve its redundancy at every place as [`point`](Self::point) does with the same options, so they should state
    /// a reference. The side from which actuators come is that of the circumstances; if it is not stated, offsets are for the middle of both sides.
    ///
    /// # Errors
    ///
    /// [`CompensationError::Grid`], also where no point can be reached; other variants for invalid input.
    pub fn grid(
        &mut self,
        plan: &GridPlan,
        options: &InverseOptions,
    ) -> Result<CorrectionGrid, CompensationError> {
        self.grid_told(plan, options, &mut |_, _| ControlFlow::Continue(()))
    }

    /// Like [`grid`](Self::grid), with a callback for the number of points and middles done; if it returns a break, the result is
    /// [`GridError::Interrupted`].
    ///
    /// # Errors
    ///
    /// As [`grid`](Self::grid).
    pub fn grid_told(
        &mut self,
        plan: &GridPlan,
        options: &InverseOptions,
        tell: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
    ) -> Result<CorrectionGrid, CompensationError> {
        plan.check()?;
        let total =
            plan.counts.iter().product::<usize>() + plan.counts.iter().map(|n| n - 1).product::<usize>();
        let mut done = 0;
        let mut next = || {
            done += 1;
            match tell(done - 1, total) {
                ControlFlow::Continue(()) => Ok(()),
                ControlFlow::Break(()) => Err(GridError::Interrupted { done: done - 1, total }),
            }
        };
        plan.held.moved_to(plan.low).check().map_err(InverseError::from)?;
        let mut offsets = Vec::new();
        for numbers in GridPlan::numbers(plan.counts) {
            next()?;
            let place = plan.place(numbers.map(|n| n as f64));
            offsets.push(self.offset_at(plan, &place, options)?);
        }
        if offsets.iter().all(Option::is_none) {
            return Err(GridError::OutOfReach.into());
        }
        let mut grid = CorrectionGrid {
            plan: plan.clone(),
            offsets,
            interpolated: GridSpread::default(),
            uncorrected: GridSpread::default(),
            turned: 0.0,
        };
        let (mut left, mut before) = (Vec::new(), Vec::new());
        for numbers in GridPlan::numbers(plan.counts.map(|n| n - 1)) {
            next()?;
            let place = plan.place(numbers.map(|n| n as f64 + 0.5));
            let Some(offset) = grid.offset(&place) else { continue };
            let told = [place + offset, place].map(|to| self.told(plan, &to, options));
            let [Some(there), Some(without)] = [told[0].clone()?, told[1].clone()?] else { continue };
            left.push((there.translation.vector - place).norm());
            before.push((without.translation.vector - place).norm());
            let aim = self.inverse.aim(&plan.held.moved_to(place), options)?;
            grid.turned = grid.turned.max(aim.miss(&there).turn.norm());
        }
        (grid.interpolated, grid.uncorrected) = (spread(&left), spread(&before));
        Ok(grid)
    }

    /// Place of the identified robot's tool when its controller is told to go to a place; `None` where that is out of reach.
    fn told(
        &mut self,
        plan: &GridPlan,
        place: &Vector3<f64>,
        options: &InverseOptions,
    ) -> Result<Option<Transform>, CompensationError> {
        match self.inverse.solve_nominal(&plan.held.moved_to(*place), options) {
            Ok(found) => Ok(Some(self.place(&found.command, &options.circumstances)?)),
            Err(InverseError::Unreachable(_)) => Ok(None),
            Err(other) => Err(other.into()),
        }
    }

    fn offset_at(
        &mut self,
        plan: &GridPlan,
        place: &Vector3<f64>,
        options: &InverseOptions,
    ) -> Result<Option<Vector3<f64>>, CompensationError> {
        let mut offset = Vector3::zeros();
        for _ in 0..ROUNDS {
            let Some(there) = self.told(plan, &(place + offset), options)? else { return Ok(None) };
            let off = place - there.translation.vector;
            if off.norm() <= LEFT {
                return Ok(Some(offset));
            }
            offset += off;
        }
        Ok(None)
    }
}

fn spread(lengths: &[f64]) -> GridSpread {
    let n = lengths.len().max(1) as f64;
    GridSpread {
        points: lengths.len(),
        mean: lengths.iter().sum::<f64>() / n,
        rms: (lengths.iter().map(|l| l * l).sum::<f64>() / n).sqrt(),
        max: lengths.iter().copied().fold(0.0, f64::max),
    }
}
