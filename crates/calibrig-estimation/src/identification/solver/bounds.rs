//! Bounds of parameters, and the step of a damped quadratic model within them.

use nalgebra::{Cholesky, DMatrix, DVector};
use thiserror::Error;

/// Lowest and highest value of every parameter; infinite where there is no bound.
#[derive(Debug, Clone, PartialEq)]
pub struct Bounds {
    lower: Vec<f64>,
    upper: Vec<f64>,
}

/// Why bounds cannot be applied, or starting points cannot be drawn.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum BoundsError {
    /// A list does not have one value per parameter.
    #[error("{what}: {found} values for {expected} parameters")]
    Length {
        /// Which list.
        what: &'static str,
        /// Its length.
        found: usize,
        /// Number of parameters.
        expected: usize,
    },
    /// No value lies between two bounds.
    #[error("parameter {parameter}: no value lies between the bounds {lower} and {upper}")]
    Empty {
        /// Index of the parameter.
        parameter: usize,
        /// Lower limit.
        lower: f64,
        /// Upper limit.
        upper: f64,
    },
    /// The start is outside the bounds.
    #[error("parameter {parameter}: the bounds {lower} to {upper} exclude its start {start}")]
    ExcludesStart {
        /// Index of the parameter.
        parameter: usize,
        /// Start of the search.
        start: f64,
        /// Lower limit.
        lower: f64,
        /// Upper limit.
        upper: f64,
    },
    /// Starting points cannot be drawn with this width.
    #[error("parameter {parameter}: starting points cannot be spread by {spread}")]
    Spread {
        /// Index of the parameter.
        parameter: usize,
        /// The width.
        spread: f64,
    },
}

impl Bounds {
    /// No bounds on n parameters.
    #[cfg(test)]
    pub fn none(n: usize) -> Self {
        Self { lower: vec![f64::NEG_INFINITY; n], upper: vec![f64::INFINITY; n] }
    }

    /// Bounds from these limits, which are allowed values themselves; equal limits hold a parameter.
    pub fn new(lower: Vec<f64>, upper: Vec<f64>) -> Result<Self, BoundsError> {
        if lower.len() != upper.len() {
            return Err(BoundsError::Length {
                what: "upper bounds",
                found: upper.len(),
                expected: lower.len(),
            });
        }
        for (parameter, (&lower, &upper)) in lower.iter().zip(&upper).enumerate() {
            if !(lower <= upper && lower < f64::INFINITY && upper > f64::NEG_INFINITY) {
                return Err(BoundsError::Empty { parameter, lower, upper });
            }
        }
        Ok(Self { lower, upper })
    }

    /// Whether `x` has the right length and lies inside.
    pub fn check(&self, x: &[f64]) -> Result<(), BoundsError> {
        if self.lower.len() != x.len() {
            return Err(BoundsError::Length { what: "bounds", found: self.lower.len(), expected: x.len() });
        }
        for (parameter, &start) in x.iter().enumerate() {
            let (lower, upper) = (self.lower[parameter], self.upper[parameter]);
            if !(lower <= start && start <= upper) {
                return Err(BoundsError::ExcludesStart { parameter, start, lower, upper });
            }
        }
        Ok(())
    }

    /// The nearest allowed value.
    pub(super) fn nearest(&self, parameter: usize, value: f64) -> f64 {
        value.max(self.lower[parameter]).min(self.upper[parameter])
    }

    /// The bound at which a parameter is, if any. Where both bounds are equal, the sign of `gradient` decides.
    pub(super) fn side(&self, parameter: usize, x: f64, gradient: f64) -> Option<Side> {
        let (at_lower, at_upper) = (x <= self.lower[parameter], x >= self.upper[parameter]);
        match (at_lower, at_upper) {
            (false, false) => None,
            (true, true) => Some(if gradient < 0.0 { Side::Upper } else { Side::Lower }),
            (true, false) => Some(Side::Lower),
            (false, true) => Some(Side::Upper),
        }
    }

    /// Bounds of a step from `x`, with each component multiplied by its `scale`.
    pub(super) fn of_step(&self, x: &[f64], scale: &DVector<f64>) -> StepBox {
        let from = |limits: &[f64]| {
            DVector::from_iterator(x.len(), (0..x.len()).map(|j| (limits[j] - x[j]) * scale[j]))
        };
        StepBox { lower: from(&self.lower), upper: from(&self.upper) }
    }

    /// The value of a bound.
    pub(super) fn at(&self, parameter: usize, side: Side) -> f64 {
        match side {
            Side::Lower => self.lower[parameter],
            Side::Upper => self.upper[parameter],
        }
    }
}

/// One of two bounds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// The lowest value.
    Lower,
    /// The highest value.
    Upper,
}

impl Side {
    /// Whether a cost with this derivative decreases beyond the bound.
    pub(super) fn holds(self, gradient: f64) -> bool {
        match self {
            Self::Lower => gradient >= 0.0,
            Self::Upper => gradient <= 0.0,
        }
    }
}

/// A parameter that ended at a bound.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AtBound {
    /// Index of the parameter.
    pub parameter: usize,
    /// Which bound it is at.
    pub side: Side,
    /// Derivative of half the cost by the parameter: how hard the data push against the bound. At a minimum it is not negative at a lower
    /// bound, and not positive at an upper one.
    pub gradient: f64,
}

/// Bounds of a scaled step; zero lies inside.
pub(super) struct StepBox {
    lower: DVector<f64>,
    upper: DVector<f64>,
}

/// A step, and the parameters that it takes to a bound or keeps there.
pub(super) struct BoundedStep {
    pub step: DVector<f64>,
    pub held: Vec<Option<Side>>,
}

impl StepBox {
    fn at(&self, j: usize, side: Side) -> f64 {
        match side {
            Side::Lower => self.lower[j],
            Side::Upper => self.upper[j],
        }
    }

    /// Minimises `½ pᵀ H p + gᵀ p` in the box by the primal active-set method (J. Nocedal, S. Wright, "Numerical Optimization", 2nd ed. 2006,
    /// algorithm 16.3). `None` where rounding leaves H indefinite.
    pub(super) fn minimise(&self, hessian: &DMatrix<f64>, gradient: &DVector<f64>) -> Option<BoundedStep> {
        let n = gradient.len();
        let mut step = DVector::zeros(n);
        let mut held: Vec<Option<Side>> = (0..n)
            .map(|j| {
                [Side::Lower, Side::Upper]
                    .into_iter()
                    .find(|&side| self.at(j, side) == 0.0 && side.holds(gradient[j]))
            })
            .collect();
        // Each round adds or releases one bound and decreases the model; the limit only guards against rounding. Every p on the way is inside
        // the box and no worse than zero.
        for _ in 0..10 * n + 10 {
            let wanted = self.free_minimum(hessian, gradient, &held)?;
            if let Some((fraction, j, side)) = self.first_crossing(&step, &wanted, &held) {
                step += fraction * (&wanted - &step);
                step[j] = self.at(j, side);
                held[j] = Some(side);
                continue;
            }
            step = wanted;
            let slope = hessian * &step + gradient;
            let worst = (0..n)
                .filter(|&j| held[j].is_some_and(|side| !side.holds(slope[j])))
                .filter(|&j| self.lower[j] < self.upper[j])
                .max_by(|&a, &b| slope[a].abs().total_cmp(&slope[b].abs()));
            match worst {
                Some(j) => held[j] = None,
                None => break,
            }
        }
        step.iter().all(|v| v.is_finite()).then_some(BoundedStep { step, held })
    }

    /// The minimum with some components held at their bounds, ignoring the bounds of the others.
    fn free_minimum(
        &self,
        hessian: &DMatrix<f64>,
        gradient: &DVector<f64>,
        held: &[Option<Side>],
    ) -> Option<DVector<f64>> {
        let mut matrix = hessian.clone();
        let mut right = -gradient;
        let values: Vec<_> =
            held.iter().enumerate().filter_map(|(j, side)| side.map(|side| (j, self.at(j, side)))).collect();
        for &(j, value) in &values {
            right.axpy(-value, &hessian.column(j), 1.0);
        }
        for &(j, value) in &values {
            matrix.row_mut(j).fill(0.0);
            matrix.column_mut(j).fill(0.0);
            matrix[(j, j)] = 1.0;
            right[j] = value;
        }
        Some(Cholesky::new(matrix)?.solve(&right))
    }

    /// The first bound on the way from one step to another: fraction of the way, component, side.
    fn first_crossing(
        &self,
        from: &DVector<f64>,
        to: &DVector<f64>,
        held: &[Option<Side>],
    ) -> Option<(f64, usize, Side)> {
        let mut first: Option<(f64, usize, Side)> = None;
        for j in (0..from.len()).filter(|&j| held[j].is_none()) {
            let side = if to[j] < self.lower[j] {
                Side::Lower
            } else if to[j] > self.upper[j] {
                Side::Upper
            } else {
                continue;
            };
            let fraction = ((self.at(j, side) - from[j]) / (to[j] - from[j])).clamp(0.0, 1.0);
            if first.is_none_or(|(least, ..)| fraction < least) {
                first = Some((fraction, j, side));
            }
        }
        first
    }
}
