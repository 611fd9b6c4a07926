//! The triangular factor of a tall system, block by block: time per row and memory do not grow with the number of rows.

use nalgebra::{DMatrix, DMatrixView};

/// Number of rows factorised at a time; with some dozen columns they fit into the processor's cache.
const BLOCK: usize = 1024;

/// R with `Rᵀ R = Aᵀ A`, where A has the given `columns` of `matrix` (rows x any) in that order. R is upper triangular, or trapezoidal where A
/// has fewer rows than columns.
pub(super) fn triangular_factor(matrix: DMatrixView<'_, f64>, columns: &[usize]) -> DMatrix<f64> {
    let (rows, n) = (matrix.nrows(), columns.len());
    let mut r = DMatrix::zeros(0, n);
    for first in (0..rows).step_by(BLOCK) {
        let count = BLOCK.min(rows - first);
        let above = r.nrows();
        let mut stacked = r.resize_vertically(above + count, 0.0);
        for (mut to, from) in stacked.column_iter_mut().zip(columns) {
            to.rows_mut(above, count).copy_from(&matrix.column(*from).rows(first, count));
        }
        r = if n > 0 { stacked.qr().unpack_r() } else { stacked };
    }
    r
}

/// The factor of all columns of `matrix`.
pub(crate) fn triangular_factor_of_all(matrix: DMatrixView<'_, f64>) -> DMatrix<f64> {
    let all: Vec<usize> = (0..matrix.ncols()).collect();
    triangular_factor(matrix, &all)
}

/// The factor of a system with the factor `r`, with `rows` appended.
pub(super) fn extended(r: DMatrix<f64>, rows: DMatrixView<'_, f64>) -> DMatrix<f64> {
    if rows.nrows() == 0 {
        return r;
    }
    let (above, count) = (r.nrows(), rows.nrows());
    let mut stacked = r.resize_vertically(above + count, 0.0);
    stacked.rows_mut(above, count).copy_from(&rows);
    triangular_factor_of_all(stacked.as_view())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn matrix(rows: usize, columns: usize) -> DMatrix<f64> {
        DMatrix::from_fn(rows, columns, |i, j| ((i * 31 + j * j * 17 + 5) as f64).sin())
    }

    #[test]
    fn the_factor_has_the_normal_matrix_of_the_columns_asked_for() {
        for rows in [0, 1, 4, 5, 300, BLOCK, BLOCK + 1, 3 * BLOCK + 7] {
            let whole = matrix(rows, 7);
            let columns = [6, 0, 2, 5, 3];
            let r = triangular_factor(whole.as_view(), &columns);
            let chosen = whole.select_columns(&columns);
            assert_eq!(r.nrows(), rows.min(5));
            assert!((0..r.nrows()).all(|i| (0..i).all(|j| r[(i, j)] == 0.0)));
            let error = (r.tr_mul(&r) - chosen.tr_mul(&chosen)).amax();
            assert!(error <= 1e-13 * (1.0 + rows as f64), "{rows} rows: {error}");
        }
        assert_eq!(triangular_factor_of_all(matrix(9, 0).as_view()).ncols(), 0);
    }

    #[test]
    fn rows_below_a_factor_are_rows_below_its_system() {
        let whole = matrix(40, 6);
        for first in [3, 20, 40] {
            let above = triangular_factor_of_all(whole.rows(0, first).as_view());
            let r = extended(above, whole.rows(first, 40 - first).as_view());
            assert!((r.tr_mul(&r) - whole.tr_mul(&whole)).amax() < 1e-12);
        }
    }
}
