//! The F test of a group of columns added to a fitted model.

use nalgebra::DVector;

use super::ResidualSet;
use calibrig_model::statistics::f_ln_survival;

/// A column adds nothing new if less than this fraction of it is outside the span of the others.
const NEGLIGIBLE: f64 = 1e-6;

/// The part of a residual vector that is orthogonal to the model's columns.
#[derive(Debug, Clone)]
pub(super) struct ProjectedResidual {
    /// Orthonormal basis of the model's columns.
    basis: Vec<DVector<f64>>,
    residual: DVector<f64>,
    /// Number of rows whose size determines the noise, and their degrees of freedom.
    measured_rows: usize,
    freedom: f64,
}

/// The test of a group of columns.
#[derive(Debug, Clone)]
pub(super) struct GroupTest {
    /// Natural logarithm of the p-value.
    pub ln_p: f64,
    /// The part of the whitened residuals that the group explains.
    pub fitted: DVector<f64>,
    columns: Vec<DVector<f64>>,
}

impl ProjectedResidual {
    /// `None` where the model leaves no degree of freedom or a number is not finite.
    pub fn new(set: &ResidualSet<'_>) -> Option<Self> {
        let (measured_rows, freedom) = (set.measured_rows, set.freedom);
        let mut this = Self { basis: Vec::new(), residual: set.residuals.clone(), measured_rows, freedom };
        for column in set.jacobian.column_iter() {
            if let Some(column) = orthonormal(&[&this.basis], &column.into_owned()) {
                this.take_out_direction(column);
            }
        }
        let usable = freedom > 0.0 && this.sum_of_squares().is_finite();
        (usable && this.sum_of_squares() > 0.0).then_some(this)
    }

    pub fn sum_of_squares(&self) -> f64 {
        self.residual.rows(0, self.measured_rows).norm_squared()
    }

    /// Parameters that rest on their priors cost no degree of freedom.
    pub fn degrees_of_freedom(&self) -> f64 {
        self.freedom
    }

    pub fn residual(&self) -> &DVector<f64> {
        &self.residual
    }

    pub fn basis(&self) -> &[DVector<f64>] {
        &self.basis
    }

    /// Tests `columns` against the residual; `None` where they add nothing to the model or leave no degree of freedom.
    pub fn test(&self, columns: &[DVector<f64>]) -> Option<GroupTest> {
        let mut added: Vec<DVector<f64>> = Vec::new();
        for column in columns {
            if let Some(column) = orthonormal(&[&self.basis, &added], column) {
                added.push(column);
            }
        }
        let left = self.freedom - added.len() as f64;
        if added.is_empty() || !(left > 0.0) {
            return None;
        }
        let mut fitted = DVector::zeros(self.residual.len());
        for column in &added {
            fitted.axpy(column.dot(&self.residual), column, 1.0);
        }
        let explained = fitted.norm_squared();
        // By the difference of vectors: the difference of sums of squares cancels where the group explains all.
        let rest = (&self.residual - &fitted).rows(0, self.measured_rows).norm_squared();
        let (d1, d2) = (added.len() as f64, left);
        let ln_p = f_ln_survival(explained / d1 / (rest / d2), d1, d2);
        (!ln_p.is_nan()).then_some(GroupTest { ln_p, fitted, columns: added })
    }

    /// Adds a tested group to the model.
    pub fn take_out(&mut self, group: GroupTest) {
        self.freedom -= group.columns.len() as f64;
        for column in group.columns {
            self.take_out_direction(column);
        }
    }

    fn take_out_direction(&mut self, column: DVector<f64>) {
        self.residual.axpy(-column.dot(&self.residual), &column, 1.0);
        self.basis.push(column);
    }
}

/// The unit vector of the part of `column` outside the orthonormal `bases`.
fn orthonormal(bases: &[&[DVector<f64>]], column: &DVector<f64>) -> Option<DVector<f64>> {
    let norm = column.norm();
    if !(norm > 0.0 && norm.is_finite()) {
        return None;
    }
    let mut rest = column / norm;
    // Twice, since a single pass leaves rounding errors as large as what it removed.
    for _ in 0..2 {
        for direction in bases.iter().copied().flatten() {
            rest.axpy(-direction.dot(&rest), direction, 1.0);
        }
    }
    let left = rest.norm();
    (left > NEGLIGIBLE).then(|| rest / left)
}
