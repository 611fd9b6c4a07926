//! Criteria whose change by an exchange has a closed form: the determinant, and what is linear in the covariance.
//!
//! With the covariance C and rows U = (entering; leaving) with the signs J = (1; -1), `M + Uᵀ J U` has the determinant `det M det(1 + J U C Uᵀ)` and the inverse
//! `C - C Uᵀ (J + U C Uᵀ)⁻¹ U C` (V. V. Fedorov, Theory of Optimal Experiments (1972), section 3.2, for single rows; A. C. Atkinson et al. 2007, 12.5).
//! Blocks `A = 1 + C_ee`, `B = C_el` and `S = 1 - C_ll + Bᵀ A⁻¹ B`, of as many rows as the poses have, are all that is factorised.

use nalgebra::{DMatrix, DMatrixView};

use super::small::{factorise, solve_lower, solve_upper, trace_of_quotient};
use super::space::DesignSpace;

/// A design that is searched, with what every candidate would do to it.
#[derive(Debug, Clone)]
pub(super) struct Closed<'s> {
    space: &'s DesignSpace,
    /// G of a criterion `tr(C GᵀG)`, and `GᵀG`; without, the criterion is the determinant.
    linear: Option<(DMatrix<f64>, DMatrix<f64>)>,
    /// C.
    covariance: DMatrix<f64>,
    /// `C GᵀG C`, where the criterion is linear.
    weighted: DMatrix<f64>,
    /// Blocks of every candidate's rows with C, by columns, one behind the other; and where each begins.
    own: Vec<f64>,
    own_weighted: Vec<f64>,
    squares: Vec<usize>,
    pub cost: f64,
    cross: DMatrix<f64>,
    cross_weighted: DMatrix<f64>,
    scratch: Scratch,
}

/// Memory for blocks of as many rows as a pose has at most.
#[derive(Debug, Clone, Default)]
struct Scratch {
    a: Vec<f64>,
    x: Vec<f64>,
    s: Vec<f64>,
    f: Vec<f64>,
    column: Vec<f64>,
}

impl<'s> Closed<'s> {
    /// The search of a space by the determinant, or by `tr(C GᵀG)`; [`refresh`](Self::refresh) gives it a design.
    pub fn new(space: &'s DesignSpace, linear: Option<DMatrix<f64>>) -> Self {
        let p = space.parameters().len();
        let mut squares = vec![0];
        let mut most = 0;
        for candidate in 0..space.candidates() {
            let rows = space.of(candidate).len();
            most = most.max(rows);
            squares.push(squares[candidate] + rows * rows);
        }
        let blocks = squares[space.candidates()];
        let block = || vec![0.0; most * most];
        Self {
            space,
            own: vec![0.0; blocks],
            own_weighted: vec![0.0; if linear.is_some() { blocks } else { 0 }],
            linear: linear.map(|g| {
                let square = g.tr_mul(&g);
                (g, square)
            }),
            covariance: DMatrix::zeros(p, p),
            weighted: DMatrix::zeros(0, 0),
            squares,
            cost: f64::INFINITY,
            cross: DMatrix::zeros(0, 0),
            cross_weighted: DMatrix::zeros(0, 0),
            scratch: Scratch { a: block(), x: block(), s: block(), f: block(), column: vec![0.0; most] },
        }
    }

    /// Takes a design, computed anew; `false` where it is singular.
    pub fn refresh(&mut self, design: &[usize]) -> bool {
        let p = self.space.parameters().len();
        let factor = self.space.factor(design.iter().copied(), true);
        let Some(inverse) = factor.solve_upper_triangular(&DMatrix::identity(p, p)) else {
            self.cost = f64::INFINITY;
            return false;
        };
        self.covariance = &inverse * inverse.transpose();
        let spread = inverse.tr_mul(&self.space.rows);
        fill(&mut self.own, &spread, self.space, &self.squares);
        self.cost = match &self.linear {
            None => -2.0 * (0..p).map(|i| factor[(i, i)].abs().ln()).sum::<f64>(),
            Some((g, square)) => {
                self.weighted = &self.covariance * square * &self.covariance;
                let spread = (g * &self.covariance) * &self.space.rows;
                fill(&mut self.own_weighted, &spread, self.space, &self.squares);
                (g * inverse).norm_squared()
            }
        };
        self.cost.is_finite()
    }

    /// What the cost would be with each candidate on top.
    pub fn costs_of_entering(&mut self, costs: &mut [f64]) {
        for (candidate, cost) in costs.iter_mut().enumerate() {
            let rows = self.space.of(candidate).len();
            let square = self.squares[candidate]..self.squares[candidate + 1];
            let Scratch { a, column, .. } = &mut self.scratch;
            a[..rows * rows].copy_from_slice(&self.own[square.clone()]);
            (0..rows).for_each(|i| a[i + i * rows] += 1.0);
            *cost = match (factorise(a, rows), &self.linear) {
                (None, _) => f64::INFINITY,
                (Some(log_determinant), None) => self.cost - log_determinant,
                (Some(_), Some(_)) => {
                    self.cost - trace_of_quotient(a, rows, &self.own_weighted[square], column)
                }
            };
        }
    }

    /// What the cost would be with each candidate in the place of one of the design.
    pub fn costs_of_exchange(&mut self, leaving: usize, costs: &mut [f64]) {
        let left = &self.covariance * self.space.block(leaving);
        let (total, rows) = (self.space.rows.ncols(), left.ncols());
        if self.cross.ncols() != rows {
            self.cross = DMatrix::zeros(total, rows);
        }
        self.space.rows.tr_mul_to(&left, &mut self.cross);
        if self.linear.is_some() {
            let left = &self.weighted * self.space.block(leaving);
            if self.cross_weighted.ncols() != rows {
                self.cross_weighted = DMatrix::zeros(total, rows);
            }
            self.space.rows.tr_mul_to(&left, &mut self.cross_weighted);
        }
        for (candidate, cost) in costs.iter_mut().enumerate() {
            *cost = self.cost - self.gain(leaving, candidate);
        }
    }

    /// How much smaller the cost becomes by an exchange whose `cross` products are known; minus infinity where nothing regular is left.
    fn gain(&mut self, leaving: usize, entering: usize) -> f64 {
        let (first, last) = (self.space.first[entering], self.space.first[entering + 1]);
        let (e, l) = (last - first, self.space.of(leaving).len());
        let of_entering = self.squares[entering]..self.squares[entering + 1];
        let of_leaving = self.squares[leaving]..self.squares[leaving + 1];
        let Scratch { a, x, s, f, column } = &mut self.scratch;
        a[..e * e].copy_from_slice(&self.own[of_entering.clone()]);
        (0..e).for_each(|i| a[i + i * e] += 1.0);
        let Some(of_a) = factorise(a, e) else { return f64::NEG_INFINITY };
        // X = L⁻¹ B, and S.
        for j in 0..l {
            let own = &mut x[j * e..(j + 1) * e];
            own.copy_from_slice(&self.cross.column(j).as_slice()[first..last]);
            solve_lower(a, e, own);
        }
        for j in 0..l {
            for i in j..l {
                let known: f64 = (0..e).map(|k| x[k + i * e] * x[k + j * e]).sum();
                s[i + j * l] = known - self.own[of_leaving.start + i + j * l];
            }
            s[j + j * l] += 1.0;
        }
        let Some(of_s) = factorise(s, l) else { return f64::NEG_INFINITY };
        if self.linear.is_none() {
            return of_a + of_s;
        }
        let weighted = &self.own_weighted[of_entering];
        let gained = trace_of_quotient(a, e, weighted, column);
        // Y = A⁻¹ B; F = E_ll - Yᵀ E_el - E_leᵀ Y + Yᵀ E_ee Y.
        (0..l).for_each(|j| solve_upper(a, e, &mut x[j * e..(j + 1) * e]));
        let cross = |k: usize, j: usize| self.cross_weighted[(first + k, j)];
        for j in 0..l {
            for (i, own) in column.iter_mut().enumerate().take(e) {
                *own = (0..e).map(|k| weighted[i + k * e] * x[k + j * e]).sum::<f64>();
            }
            for i in 0..l {
                let mut sum = self.own_weighted[of_leaving.start + i + j * l];
                for k in 0..e {
                    sum += x[k + i * e] * (column[k] - cross(k, j)) - x[k + j * e] * cross(k, i);
                }
                f[i + j * l] = sum;
            }
        }
        gained - trace_of_quotient(s, l, f, column)
    }

    /// Takes a candidate into the design.
    pub fn enter(&mut self, candidate: usize) -> bool {
        let block = self.space.block(candidate);
        let own = block.tr_mul(&(&self.covariance * block));
        self.update(block.into_owned().as_view(), own, 1.0)
    }

    /// Takes one out of it; `false` where the rest is singular.
    pub fn leave(&mut self, candidate: usize) -> bool {
        let block = self.space.block(candidate);
        let own = -block.tr_mul(&(&self.covariance * block));
        self.update(block.into_owned().as_view(), own, -1.0)
    }

    /// `C := C - sign C Uᵀ (1 + k)⁻¹ U C` for the columns Uᵀ.
    fn update(&mut self, block: DMatrixView<'_, f64>, mut k: DMatrix<f64>, sign: f64) -> bool {
        let rows = k.nrows();
        (0..rows).for_each(|i| k[(i, i)] += 1.0);
        let Some(log_determinant) = factorise(k.as_mut_slice(), rows) else { return false };
        // Z = C Uᵀ L⁻ᵀ.
        let mut z = (&self.covariance * block).transpose();
        for mut column in z.column_iter_mut() {
            solve_lower(k.as_slice(), rows, column.as_mut_slice());
        }
        let z = z.transpose();
        let y = self.space.rows.tr_mul(&z);
        if let Some((_, square)) = &self.linear {
            let q = &self.covariance * (square * &z);
            let inner = z.tr_mul(&(square * &z));
            let of_q = self.space.rows.tr_mul(&q);
            self.weighted.gemm(-sign, &q, &z.transpose(), 1.0);
            self.weighted.gemm(-sign, &z, &q.transpose(), 1.0);
            self.weighted.gemm(1.0, &(&z * &inner), &z.transpose(), 1.0);
            // y N yᵀ / 2 on either side of a symmetric sum.
            let half = of_q * -sign + &y * inner * 0.5;
            add_products(&mut self.own_weighted, self.space, &self.squares, (&half, &y), 1.0);
            add_products(&mut self.own_weighted, self.space, &self.squares, (&y, &half), 1.0);
            self.cost -= sign * z.dot(&(square * &z));
        } else {
            self.cost -= log_determinant;
        }
        add_products(&mut self.own, self.space, &self.squares, (&y, &y), -sign);
        self.covariance.gemm(-sign, &z, &z.transpose(), 1.0);
        true
    }
}

/// Of every candidate the products of its columns of `spread` with each other.
fn fill(own: &mut [f64], spread: &DMatrix<f64>, space: &DesignSpace, squares: &[usize]) {
    for (candidate, first) in squares.iter().enumerate().take(space.candidates()) {
        let columns = space.of(candidate);
        let rows = columns.len();
        for j in 0..rows {
            for i in j..rows {
                let product = spread.column(columns.start + i).dot(&spread.column(columns.start + j));
                own[first + i + j * rows] = product;
                own[first + j + i * rows] = product;
            }
        }
    }
}

/// Adds `factor · left rightᵀ` to the block of every candidate, with its rows of both.
fn add_products(
    own: &mut [f64],
    space: &DesignSpace,
    squares: &[usize],
    (left, right): (&DMatrix<f64>, &DMatrix<f64>),
    factor: f64,
) {
    let total = left.nrows();
    for m in 0..left.ncols() {
        let left = &left.as_slice()[m * total..(m + 1) * total];
        let right = &right.as_slice()[m * total..(m + 1) * total];
        for (candidate, first) in squares.iter().enumerate().take(space.candidates()) {
            let columns = space.of(candidate);
            let rows = columns.len();
            for j in 0..rows {
                let of_j = factor * right[columns.start + j];
                for i in 0..rows {
                    own[first + i + j * rows] += left[columns.start + i] * of_j;
                }
            }
        }
    }
}
