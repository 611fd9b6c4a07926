//! Errors that many readings share: a whitening that makes their rows independent, or the same errors as parameters where every row has to belong
//! to one reading.
//!
//! Beside the covariance of single poses, the data have the covariance `1 + U Uᵀ`, with one column of U per shared error. With `C Cᵀ = 1 + Uᵀ U`
//! (Cholesky), `W = 1 - U (C + 1)⁻ᵀ C⁻¹ Uᵀ` has `W (1 + U Uᵀ) Wᵀ = 1` (A. Andrews, "A square root formulation of the Kalman covariance
//! equations", AIAA J. 6 (1968) 1165). The fit is the same as with all these errors as parameters with priors, but without their columns.

use nalgebra::{Cholesky, DMatrix, DVector, Dim, Dyn, Matrix, StorageMut, Vector3};

use super::IdentifyError;
use super::problem::{CalibrationProblem, PositionRow};
use super::turns::TurnRow;
use calibrig_model::measurement::MeasurementSet;

/// Largest share of a row's variance that shared errors which are not treated as such may have.
const LITTLE: f64 = 0.005;
/// Largest product of the number of rows and the square of the number of shared errors, with which a fit's time grows: up to 250 errors for 100
/// poses, 80 for 1000. The smallest errors beyond it are treated as each reading's own.
const MOST: f64 = 2e7;
/// Least noise of rows that state none, m and rad.
const LEAST_NOISE: f64 = 1e-6;
const LEAST_TURN: f64 = 1e-5;

/// The map that makes rows with shared errors independent.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SharedWhitening {
    /// U: data rows x errors, in standard deviations.
    errors: DMatrix<f64>,
    /// C, lower triangular.
    factor: DMatrix<f64>,
}

impl SharedWhitening {
    /// `None` where a number is not finite.
    pub fn new(errors: DMatrix<f64>) -> Option<Self> {
        let n = errors.ncols();
        let factor = Cholesky::<f64, Dyn>::new(errors.tr_mul(&errors) + DMatrix::identity(n, n))?.unpack();
        Some(Self { errors, factor })
    }

    /// Number of data rows.
    pub fn rows(&self) -> usize {
        self.errors.nrows()
    }

    /// Applies W to the first rows of `columns`.
    pub fn apply<C: Dim, S: StorageMut<f64, Dyn, C>>(&self, columns: &mut Matrix<f64, Dyn, C, S>) {
        let mut own = columns.rows_mut(0, self.errors.nrows());
        let mut inner = self.errors.tr_mul(&own);
        self.factor.solve_lower_triangular_mut(&mut inner);
        self.plus_one().tr_solve_lower_triangular_mut(&mut inner);
        own.gemm(-1.0, &self.errors, &inner, 1.0);
    }

    /// Applies the inverse, `(1 + U Uᵀ) Wᵀ = 1 + U (C + 1)⁻¹ Uᵀ`.
    pub fn undo<C: Dim, S: StorageMut<f64, Dyn, C>>(&self, columns: &mut Matrix<f64, Dyn, C, S>) {
        let mut own = columns.rows_mut(0, self.errors.nrows());
        let mut inner = self.errors.tr_mul(&own);
        self.plus_one().solve_lower_triangular_mut(&mut inner);
        own.gemm(1.0, &self.errors, &inner, 1.0);
    }

    fn plus_one(&self) -> DMatrix<f64> {
        &self.factor + DMatrix::identity(self.factor.nrows(), self.factor.nrows())
    }
}

/// Covariance of all data rows with one of them due to the corrections of the stations' drifts, m² (rad² or m rad with orientations).
struct Motions<'a> {
    set: &'a MeasurementSet,
    /// The observation of every block, and whether it is an orientation.
    blocks: Vec<(usize, bool)>,
}

impl<'a> Motions<'a> {
    fn new(set: &'a MeasurementSet, turns: &[TurnRow]) -> Self {
        let places = (0..set.observations.len()).map(|i| (i, false));
        Self { set, blocks: places.chain(turns.iter().map(|turn| (turn.observation, true))).collect() }
    }

    /// Covariance of the rows of a block with coordinate `axis` of another.
    fn between(&self, block: usize, other: usize, axis: usize) -> Vector3<f64> {
        let [(i, turn), (j, of_turn)] = [block, other].map(|block| self.blocks[block]);
        let [a, b] = [i, j].map(|i| &self.set.observations[i]);
        match &self.set.stations[a.station].motion {
            Some(motion) if a.station == b.station => {
                let (at, of) = (a.reading.position(), b.reading.position());
                let covariance = motion.covariance((a.time, &at), (b.time, &of));
                let column = axis + if of_turn { 3 } else { 0 };
                covariance.fixed_view::<3, 1>(if turn { 3 } else { 0 }, column).into_owned()
            }
            _ => Vector3::zeros(),
        }
    }

    fn column(&self, row: usize) -> DVector<f64> {
        let own = (0..self.blocks.len()).flat_map(|block| self.between(block, row / 3, row % 3).data.0[0]);
        DVector::from_iterator(3 * self.blocks.len(), own)
    }

    /// Variances of all rows.
    fn variances(&self) -> DVector<f64> {
        let rows = 3 * self.blocks.len();
        DVector::from_iterator(rows, (0..rows).map(|row| self.between(row / 3, row / 3, row % 3)[row % 3]))
    }
}

/// The errors that readings of a station share, as displacements of all data rows per unit, m and rad in the trackers' axes. Errors that add little
/// to the readings' own noise are treated as part of that.
pub(super) fn shared_errors(set: &MeasurementSet, rows: &[PositionRow], turns: &[TurnRow]) -> DMatrix<f64> {
    if set.stations.iter().all(|station| station.motion.is_none()) {
        return DMatrix::zeros(3 * (rows.len() + turns.len()), 0);
    }
    let motions = Motions::new(set, turns);
    let variances = motions.variances();
    let sigma = |row: usize| {
        let (stated, least) = match (row / 3).checked_sub(rows.len()) {
            Some(turn) => (turns[turn].reading.map(|[own, _]| own), LEAST_TURN),
            None => (rows[row / 3].reading, LEAST_NOISE),
        };
        stated.map_or(variances[row].max(least * least), |stated| stated[(row % 3, row % 3)]).sqrt()
    };
    let sigmas = DVector::from_iterator(variances.len(), (0..variances.len()).map(sigma));
    most_of(&variances, |row| motions.column(row), &sigmas)
}

/// Removes shared errors from the stated covariances of readings.
pub(super) fn take_out(shared: &DMatrix<f64>, rows: &mut [PositionRow], turns: &mut [TurnRow]) {
    if shared.ncols() == 0 {
        return;
    }
    let of = |block: usize| shared.fixed_rows::<3>(3 * block).into_owned();
    for (turn, row) in turns.iter_mut().enumerate() {
        if let Some([own, with_position]) = &mut row.reading {
            let by = of(rows.len() + turn);
            *own -= &by * by.transpose();
            *with_position -= &by * of(row.observation).transpose();
        }
    }
    for (i, row) in rows.iter_mut().enumerate() {
        if let Some(reading) = &mut row.reading {
            let by = of(i);
            *reading -= &by * by.transpose();
        }
    }
}

/// Columns whose product with their transpose is a covariance, up to a small share of every row's `sigmas²`. The covariance is given by its
/// `variances` and one `column` at a time. Cholesky's method, with the largest remaining variance first (H. Harbrecht, M. Peters, R. Schneider,
/// Appl. Numer. Math. 62 (2012) 428).
fn most_of(
    variances: &DVector<f64>,
    column: impl Fn(usize) -> DVector<f64>,
    sigmas: &DVector<f64>,
) -> DMatrix<f64> {
    let mut left = variances.component_div(&sigmas.component_mul(sigmas));
    let mut columns: Vec<DVector<f64>> = Vec::new();
    let most = (MOST / variances.len() as f64).sqrt();
    while columns.len() < variances.len() && (columns.len() as f64) < most {
        let (pivot, largest) = left.argmax();
        if !(largest > LITTLE) {
            break;
        }
        let mut next = column(pivot).component_div(sigmas) / sigmas[pivot];
        for known in &columns {
            next.axpy(-known[pivot], known, 1.0);
        }
        next /= largest.sqrt();
        left.zip_apply(&next, |left, shared| *left -= shared * shared);
        columns.push(next);
    }
    let mut most = DMatrix::zeros(variances.len(), columns.len());
    for (mut to, column) in most.column_iter_mut().zip(&columns) {
        to.copy_from(&column.component_mul(sigmas));
    }
    most
}

impl CalibrationProblem {
    /// Prepares the map that makes rows independent that are whitened pose by pose.
    pub(super) fn weigh_shared(&mut self) -> Result<(), IdentifyError> {
        self.shared_whitening = None;
        if self.shared.ncols() > 0 {
            let mut errors = self.shared.clone();
            self.whiten_apart(&mut DVector::zeros(errors.nrows()), &mut errors);
            let whitening = SharedWhitening::new(errors);
            let failed = || IdentifyError::Covariance { what: "the drift of the stations".to_owned() };
            self.shared_whitening = Some(whitening.ok_or_else(failed)?);
        }
        Ok(())
    }

    /// Makes rows independent that are whitened pose by pose.
    pub(super) fn whiten_shared(&self, residuals: &mut DVector<f64>, jacobian: Option<&mut DMatrix<f64>>) {
        // The rows of a pose that the robot cannot take must stay recognisable.
        let Some(shared) = &self.shared_whitening else { return };
        if residuals.iter().all(|v| v.is_finite()) {
            shared.apply(residuals);
            if let Some(jacobian) = jacobian {
                shared.apply(jacobian);
            }
        }
    }
}

/// A whitened system with the shared errors as parameters behind the others, each with a row for its prior below all. The rows are whitened pose
/// by pose, so that the error of a reading stays in its own rows.
pub(super) fn as_parameters(
    shared: &SharedWhitening,
    residuals: &DVector<f64>,
    jacobian: &DMatrix<f64>,
) -> (DVector<f64>, DMatrix<f64>) {
    let (mut residuals, mut jacobian) = (residuals.clone(), jacobian.clone());
    shared.undo(&mut residuals);
    shared.undo(&mut jacobian);
    with_errors(&shared.errors, &mut residuals, &mut jacobian);
    (residuals, jacobian)
}

/// Appends columns for `errors` of the first rows, and rows for their priors.
pub(super) fn with_errors(errors: &DMatrix<f64>, residuals: &mut DVector<f64>, jacobian: &mut DMatrix<f64>) {
    let ((m, n), count) = (jacobian.shape(), errors.ncols());
    *residuals = residuals.clone().resize_vertically(m + count, 0.0);
    *jacobian = jacobian.clone().resize(m + count, n + count, 0.0);
    jacobian.view_mut((0, n), errors.shape()).copy_from(errors);
    jacobian.view_mut((m, n), (count, count)).fill_with_identity();
}

#[cfg(test)]
mod tests {
    use super::*;

    fn matrix(rows: usize, columns: usize) -> DMatrix<f64> {
        DMatrix::from_fn(rows, columns, |i, j| ((i * i * 5 + 3 * j * i + j * j * 17 + 2) as f64).sin())
    }

    #[test]
    fn whitened_rows_are_independent_and_come_back() {
        let errors = matrix(12, 5) * 1.7;
        let shared = SharedWhitening::new(errors.clone()).expect("numbers");
        let mut whitening = DMatrix::identity(12, 12);
        shared.apply(&mut whitening);
        let covariance = DMatrix::identity(12, 12) + &errors * errors.transpose();
        let independent = &whitening * covariance * whitening.transpose();
        assert!((independent - DMatrix::identity(12, 12)).amax() < 1e-12);
        // The rows below are priors and stay unchanged.
        let rows = matrix(15, 3);
        let mut there = rows.clone();
        shared.apply(&mut there);
        assert_eq!(there.rows(12, 3), rows.rows(12, 3));
        assert!((there.rows(0, 12) - &whitening * rows.rows(0, 12)).amax() < 1e-12);
        shared.undo(&mut there);
        assert!((there - rows).amax() < 1e-12);
    }

    #[test]
    fn errors_as_parameters_have_the_same_minimum() {
        let (errors, mut jacobian) = (matrix(15, 4), matrix(18, 3));
        let mut residuals = matrix(18, 7).column(6).into_owned();
        let shared = SharedWhitening::new(errors).expect("numbers");
        let (with_residuals, with_jacobian) = {
            shared.apply(&mut residuals);
            shared.apply(&mut jacobian);
            as_parameters(&shared, &residuals, &jacobian)
        };
        let solve = |jacobian: &DMatrix<f64>, residuals: &DVector<f64>| {
            let step = -jacobian.clone().svd(true, true).solve(residuals, 1e-12).expect("a solution");
            let left = (residuals + jacobian * &step).norm_squared();
            (step, left)
        };
        let (step, left) = solve(&jacobian, &residuals);
        let (with, left_with) = solve(&with_jacobian, &with_residuals);
        assert!((with.rows(0, 3) - step).amax() < 1e-10);
        assert!((left - left_with).abs() < 1e-10);
    }

    #[test]
    fn what_is_left_out_is_little_of_every_row() {
        let sigmas = DVector::from_fn(30, |i, _| if i < 15 { 1.0 } else { 1e-3 });
        let mut all = DMatrix::from_fn(30, 40, |i, j| {
            ((i * i * 5 + 3 * j * i + j) as f64).sin() * 0.5_f64.powf(j as f64)
        });
        for (mut row, sigma) in all.row_iter_mut().zip(&sigmas) {
            row *= *sigma;
        }
        let whole = &all * all.transpose();
        let most = most_of(&whole.diagonal(), |row| whole.column(row).into_owned(), &sigmas);
        assert!(most.ncols() < 12, "{}", most.ncols());
        let left = whole - &most * most.transpose();
        for (i, sigma) in sigmas.iter().enumerate() {
            let share = left[(i, i)] / (sigma * sigma);
            assert!((-1e-12..=LITTLE).contains(&share), "{share}");
        }
        assert!(left.symmetric_eigenvalues().min() > -1e-12);
    }
}
