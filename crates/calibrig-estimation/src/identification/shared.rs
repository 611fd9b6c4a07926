//! Errors that many readings share: what makes their rows independent, and the same errors as parameters where every row has to be its reading's own.
//!
//! Beside what is known pose by pose, the data have the covariance `1 + U Uᵀ`, with a column of U for each shared error. With `C Cᵀ = 1 + Uᵀ U` (Cholesky),
//! `W = 1 - U (C + 1)⁻ᵀ C⁻¹ Uᵀ` has `W (1 + U Uᵀ) Wᵀ = 1` (A. Andrews, "A square root formulation of the Kalman covariance equations", AIAA J. 6
//! (1968) 1165): the fit is the one in which all these errors are parameters with their priors, without their columns.

use nalgebra::{Cholesky, DMatrix, DVector, Dim, Dyn, Matrix, StorageMut};

use super::IdentifyError;
use super::problem::{CalibrationProblem, Row};
use super::turns::TurnRow;
use calibrig_model::measurement::{MeasurementSet, OpenMotion};

/// Share of a row's variance that errors which are not taken for shared may have.
const LITTLE: f64 = 0.02;
/// The least noise of rows that state none, m and rad.
const LEAST_NOISE: f64 = 1e-6;
const LEAST_TURN: f64 = 1e-5;

/// What makes rows with shared errors independent.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SharedWhitening {
    /// U: data rows x errors, in standard deviations.
    errors: DMatrix<f64>,
    /// Lower triangular: C.
    factor: DMatrix<f64>,
}

impl SharedWhitening {
    /// `None` where a number is none.
    pub fn new(errors: DMatrix<f64>) -> Option<Self> {
        let n = errors.ncols();
        let factor = Cholesky::<f64, Dyn>::new(errors.tr_mul(&errors) + DMatrix::identity(n, n))?.unpack();
        Some(Self { errors, factor })
    }

    /// Number of data rows.
    pub fn rows(&self) -> usize {
        self.errors.nrows()
    }

    /// Acts on the first rows of `columns`.
    pub fn apply<C: Dim, S: StorageMut<f64, Dyn, C>>(&self, columns: &mut Matrix<f64, Dyn, C, S>) {
        let mut own = columns.rows_mut(0, self.errors.nrows());
        let mut inner = self.errors.tr_mul(&own);
        self.factor.solve_lower_triangular_mut(&mut inner);
        self.plus_one().tr_solve_lower_triangular_mut(&mut inner);
        own.gemm(-1.0, &self.errors, &inner, 1.0);
    }

    /// The inverse, `(1 + U Uᵀ) Wᵀ = 1 + U (C + 1)⁻¹ Uᵀ`.
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

/// Of every mode of what the corrections of the stations' drifts leave open, the displacement of all data rows, m and rad in the trackers' axes.
fn of_motions(set: &MeasurementSet, turns: &[TurnRow]) -> DMatrix<f64> {
    let places = set.observations.len();
    let motions = || set.stations.iter().map(|station| station.motion.as_ref());
    let modes = motions().map(|motion| motion.map_or(0, OpenMotion::modes)).sum();
    let mut all = DMatrix::zeros(3 * (places + turns.len()), modes);
    let mut first = 0;
    for (station, motion) in motions().enumerate() {
        let Some(motion) = motion else { continue };
        let by = |i: usize| {
            let observation = &set.observations[i];
            let is_own = observation.station == station;
            is_own.then(|| motion.displacements(observation.time, &observation.reading.position()))
        };
        for (i, by) in (0..places).filter_map(|i| Some((i, by(i)?))) {
            all.view_mut((3 * i, first), (3, by.ncols())).copy_from(&by.fixed_rows::<3>(0));
        }
        for (turn, by) in turns.iter().enumerate().filter_map(|(turn, of)| Some((turn, by(of.observation)?)))
        {
            let row = 3 * (places + turn);
            all.view_mut((row, first), (3, by.ncols())).copy_from(&by.fixed_rows::<3>(3));
        }
        first += motion.modes();
    }
    all
}

/// The errors that readings of a station share, of all data rows; what a reading states is less by them afterwards. Modes that add little to what readings have
/// by themselves stay with these.
pub(super) fn shared_errors(set: &MeasurementSet, rows: &mut [Row], turns: &mut [TurnRow]) -> DMatrix<f64> {
    let all = of_motions(set, turns);
    let stated = |block: usize| match block.checked_sub(rows.len()) {
        Some(turn) => turns[turn].reading.map(|[own, _]| own),
        None => rows[block].reading,
    };
    let least = [LEAST_NOISE, LEAST_TURN];
    let sigma = |row: usize| match stated(row / 3) {
        Some(stated) => stated[(row % 3, row % 3)].sqrt(),
        None => all.row(row).norm().max(least[usize::from(row / 3 >= rows.len())]),
    };
    let sigmas = DVector::from_iterator(all.nrows(), (0..all.nrows()).map(sigma));
    let shared = most_of(all, &sigmas);
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
    shared
}

/// Fewer columns whose product with themselves is that of `all`, but for a small share of every row's variance `sigmas²`: Cholesky's, the largest of what is left first (H.
/// Harbrecht, M. Peters, R. Schneider, Appl. Numer. Math. 62 (2012) 428).
fn most_of(mut all: DMatrix<f64>, sigmas: &DVector<f64>) -> DMatrix<f64> {
    for mut column in all.column_iter_mut() {
        column.component_div_assign(sigmas);
    }
    let mut left = DVector::from_iterator(all.nrows(), all.row_iter().map(|row| row.norm_squared()));
    let mut columns: Vec<DVector<f64>> = Vec::new();
    while columns.len() < all.ncols() {
        let (pivot, largest) = left.argmax();
        if !(largest > LITTLE) {
            break;
        }
        let mut column = &all * all.row(pivot).transpose();
        for known in &columns {
            column.axpy(-known[pivot], known, 1.0);
        }
        column /= largest.sqrt();
        left.zip_apply(&column, |left, shared| *left -= shared * shared);
        columns.push(column);
    }
    let mut most = DMatrix::zeros(all.nrows(), columns.len());
    for (mut to, column) in most.column_iter_mut().zip(&columns) {
        to.copy_from(&column.component_mul(sigmas));
    }
    most
}

impl CalibrationProblem {
    /// Makes ready what takes rows that are whitened pose by pose to independent ones.
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

    /// Takes rows that are whitened pose by pose to independent ones.
    pub(super) fn whiten_shared(&self, residuals: &mut DVector<f64>, jacobian: Option<&mut DMatrix<f64>>) {
        // A pose that cannot be taken is to be found by its own rows.
        let Some(shared) = &self.shared_whitening else { return };
        if residuals.iter().all(|v| v.is_finite()) {
            shared.apply(residuals);
            jacobian.into_iter().for_each(|jacobian| shared.apply(jacobian));
        }
    }
}

/// A whitened system with the shared errors as parameters behind the others, each with a row for its prior below all: its rows are whitened pose by pose, so that what a
/// reading is off by is in its own.
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
