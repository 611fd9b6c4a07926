//! Cholesky factors of small blocks, in place: a search needs a million of them.

/// Replaces the lower triangle of a symmetric matrix (n x n, by columns) by its Cholesky factor; returns the logarithm of its determinant, or `None`
/// where it is not positive definite.
pub(super) fn factorise(a: &mut [f64], n: usize) -> Option<f64> {
    let mut log_determinant = 0.0;
    for j in 0..n {
        for k in 0..j {
            let factor = a[j + k * n];
            for i in j..n {
                a[i + j * n] -= a[i + k * n] * factor;
            }
        }
        let pivot = a[j + j * n];
        if !(pivot > 0.0 && pivot.is_finite()) {
            return None;
        }
        log_determinant += pivot.ln();
        let root = pivot.sqrt();
        for i in j..n {
            a[i + j * n] /= root;
        }
    }
    Some(log_determinant)
}

/// `x := L⁻¹ x` for the factor of [`factorise`].
pub(super) fn solve_lower(l: &[f64], n: usize, x: &mut [f64]) {
    for i in 0..n {
        let known: f64 = (0..i).map(|k| l[i + k * n] * x[k]).sum();
        x[i] = (x[i] - known) / l[i + i * n];
    }
}

/// `x := L⁻ᵀ x`.
pub(super) fn solve_upper(l: &[f64], n: usize, x: &mut [f64]) {
    for i in (0..n).rev() {
        let known: f64 = (i + 1..n).map(|k| l[k + i * n] * x[k]).sum();
        x[i] = (x[i] - known) / l[i + i * n];
    }
}

/// Trace of `(L Lᵀ)⁻¹ e` for a symmetric `e` (n x n, by columns).
pub(super) fn trace_of_quotient(l: &[f64], n: usize, e: &[f64], column: &mut [f64]) -> f64 {
    let mut trace = 0.0;
    for j in 0..n {
        column[..n].copy_from_slice(&e[j * n..(j + 1) * n]);
        solve_lower(l, n, &mut column[..n]);
        solve_upper(l, n, &mut column[..n]);
        trace += column[j];
    }
    trace
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    #[test]
    fn blocks_are_factorised_as_nalgebra_has_it() {
        for n in 1..7 {
            let root = DMatrix::from_fn(n + 2, n, |i, j| ((i * 5 + j * 11 + 2) as f64).sin());
            let a = root.tr_mul(&root) + DMatrix::identity(n, n);
            let e = DMatrix::from_fn(n, n, |i, j| ((i + j) as f64).cos());
            let mut own = a.as_slice().to_vec();
            let log_determinant = factorise(&mut own, n).expect("positive definite");
            assert!((log_determinant - a.determinant().ln()).abs() < 1e-12);
            let expected = (a.clone().try_inverse().expect("regular") * &e).trace();
            let trace = trace_of_quotient(&own, n, e.as_slice(), &mut vec![0.0; n]);
            assert!((trace - expected).abs() < 1e-12);
            let mut singular = vec![0.0; n * n];
            assert_eq!(factorise(&mut singular, n), None);
        }
    }
}
