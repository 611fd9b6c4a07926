//! Criteria with a closed form for their change by an exchange: the determinant, and those linear in the covariance.
//!
//! With the covariance C and rows U = (entering; leaving) with the signs J = (1; -1), `M + Uᵀ J U` has the determinant `det M det(1 + J U C Uᵀ)` and
//! the inverse `C - C Uᵀ (J + U C Uᵀ)⁻¹ U C` (V. V. Fedorov, Theory of Optimal Experiments (1972), section 3.2, for single rows; A. C. Atkinson et
//! al. 2007, 12.5). Only the blocks `A = 1 + C_ee`, `B = C_el` and `S = 1 - C_ll + Bᵀ A⁻¹ B`, with as many rows as the poses have, are factorised.

use nalgebra::DMatrix;

use super::small::{factorise, solve_lower, solve_upper, trace_of_quotient};
use super::space::DesignSpace;

/// A design during the search, with the effect that every candidate would have.
#[derive(Debug, Clone)]
pub(super) struct Closed<'s> {
    space: &'s DesignSpace,
    /// G of a criterion `tr(C GᵀG)`, and `GᵀG`; `None` if the criterion is the determinant.
    linear: Option<(DMatrix<f64>, DMatrix<f64>)>,
    /// The covariance C.
    covariance: DMatrix<f64>,
    /// `C GᵀG C`, if the criterion is linear.
    weighted: DMatrix<f64>,
    /// Blocks of every candidate's rows with C, by columns, one after the other; and where each begins.
    own: Vec<f64>,
    own_weighted: Vec<f64>,
    squares: Vec<usize>,
    /// Figures of every candidate.
    alone: Vec<Alone>,
    pub cost: f64,
    scratch: Scratch,
}

/// Figures of a candidate on its own.
#[derive(Debug, Clone, Copy, Default)]
struct Alone {
    /// Decrease of the cost if it is added.
    gain: f64,
    /// Upper bound of the largest eigenvalue of its block: the norm of its entries.
    size: f64,
}

/// Memory for blocks with the most rows of any pose.
#[derive(Debug, Clone, Default)]
struct Scratch {
    a: Vec<f64>,
    x: Vec<f64>,
    s: Vec<f64>,
    f: Vec<f64>,
    column: Vec<f64>,
    cross: Vec<f64>,
    cross_weighted: Vec<f64>,
}

impl<'s> Closed<'s> {
    /// The search of a space by the determinant, or by `tr(C GᵀG)`; [`refresh`](Self::refresh) sets its design.
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
            alone: vec![Alone::default(); space.candidates()],
            cost: f64::INFINITY,
            scratch: Scratch {
                a: block(),
                x: block(),
                s: block(),
                f: block(),
                column: vec![0.0; most],
                cross: block(),
                cross_weighted: block(),
            },
        }
    }

    /// Sets a design and computes everything anew; `false` where it is singular.
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
        self.look_alone();
        self.cost.is_finite()
    }

    /// Computes the figures of every candidate on its own.
    fn look_alone(&mut self) {
        for candidate in 0..self.space.candidates() {
            let rows = self.space.of(candidate).len();
            let square = self.squares[candidate]..self.squares[candidate + 1];
            let Scratch { a, column, .. } = &mut self.scratch;
            let own = &self.own[square.clone()];
            a[..rows * rows].copy_from_slice(own);
            (0..rows).for_each(|i| a[i + i * rows] += 1.0);
            let gain = match (factorise(a, rows), &self.linear) {
                (None, _) => f64::NEG_INFINITY,
                (Some(log_determinant), None) => log_determinant,
                (Some(_), Some(_)) => trace_of_quotient(a, rows, &self.own_weighted[square], column),
            };
            let size = own.iter().map(|v| v * v).sum::<f64>().sqrt();
            self.alone[candidate] = Alone { gain, size };
        }
    }

    /// The cost with each candidate added.
    pub fn costs_of_entering(&self, costs: &mut [f64]) {
        costs.iter_mut().zip(&self.alone).for_each(|(cost, alone)| *cost = self.cost - alone.gain);
    }

    /// Lower bounds of the cost with each candidate in place of one of the design.
    ///
    /// With λ at least the largest eigenvalue of `C_ee`, `Bᵀ A⁻¹ B` is at most `λ/(1+λ) C_ll`: so `ln det S` is at most `-tr C_ll / (1+λ)`. For a
    /// linear criterion, the leaving candidate increases the cost by at least `|G C'Rᵀ|²`, with C' after the other has entered; its root is at most
    /// `√(g λ/(1+λ) |C_ll|)` less than `|G C Rᵀ|`, with g the gain of the entering candidate.
    pub fn bounds_of_exchange(&self, leaving: usize, bounds: &mut [f64]) {
        let rows = self.space.of(leaving).len();
        let first = self.squares[leaving];
        let trace = |blocks: &[f64]| (0..rows).map(|i| blocks[first + i + i * rows]).sum::<f64>();
        let (of_leaving, size) = (trace(&self.own), self.alone[leaving].size.min(1.0));
        let taken = if self.linear.is_some() { trace(&self.own_weighted).max(0.0).sqrt() } else { 0.0 };
        for (bound, alone) in bounds.iter_mut().zip(&self.alone) {
            let loss = if self.linear.is_some() {
                let shared = (alone.gain.max(0.0) * size * alone.size / (1.0 + alone.size)).sqrt();
                (taken - shared).max(0.0).powi(2)
            } else {
                of_leaving / (1.0 + alone.size)
            };
            *bound = self.cost - (alone.gain - loss);
        }
    }

    /// Products for the leaving candidate that [`cost_of_exchange`](Self::cost_of_exchange) needs: `C Rᵀ`, and `C GᵀG C Rᵀ`.
    pub fn leaver(&self, leaving: usize) -> (DMatrix<f64>, Option<DMatrix<f64>>) {
        let block = self.space.block(leaving);
        (&self.covariance * block, self.linear.is_some().then(|| &self.weighted * block))
    }

    /// The cost with a candidate in place of one of the design, for which `leaver` was computed.
    pub fn cost_of_exchange(
        &mut self,
        leaving: usize,
        entering: usize,
        (left, left_weighted): &(DMatrix<f64>, Option<DMatrix<f64>>),
    ) -> f64 {
        products(&self.space.rows, self.space.of(entering), left, &mut self.scratch.cross);
        if let Some(left) = left_weighted {
            products(&self.space.rows, self.space.of(entering), left, &mut self.scratch.cross_weighted);
        }
        self.cost - self.gain(leaving, entering)
    }

    /// Decrease of the cost by an exchange whose `cross` products are known; minus infinity where the result is singular.
    fn gain(&mut self, leaving: usize, entering: usize) -> f64 {
        let (e, l) = (self.space.of(entering).len(), self.space.of(leaving).len());
        let of_entering = self.squares[entering]..self.squares[entering + 1];
        let of_leaving = self.squares[leaving]..self.squares[leaving + 1];
        let Scratch { a, x, s, f, column, cross, cross_weighted } = &mut self.scratch;
        a[..e * e].copy_from_slice(&self.own[of_entering.clone()]);
        (0..e).for_each(|i| a[i + i * e] += 1.0);
        let Some(of_a) = factorise(a, e) else { return f64::NEG_INFINITY };
        // X = L⁻¹ B, and S.
        for j in 0..l {
            let own = &mut x[j * e..(j + 1) * e];
            own.copy_from_slice(&cross[j * e..(j + 1) * e]);
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
        let cross = |k: usize, j: usize| cross_weighted[k + j * e];
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

    /// Adds a candidate to the design.
    pub fn enter(&mut self, candidate: usize) -> bool {
        let Some(change) = self.change(candidate, 1.0) else { return false };
        self.follow(&[change]);
        true
    }

    /// Adds a candidate to the design and removes another; `false` where the rest is singular.
    pub fn exchange(&mut self, entering: usize, leaving: usize) -> bool {
        let Some(entered) = self.change(entering, 1.0) else { return false };
        let Some(left) = self.change(leaving, -1.0) else { return false };
        self.follow(&[entered, left]);
        true
    }

    /// `C := C - sign Z Zᵀ`, Z = C Uᵀ L⁻ᵀ with `L Lᵀ = 1 + sign U C Uᵀ` for the rows U of a candidate; also updates the cost.
    fn change(&mut self, candidate: usize, sign: f64) -> Option<Change> {
        let block = self.space.block(candidate);
        let left = &self.covariance * block;
        let mut k = block.tr_mul(&left) * sign;
        let rows = k.nrows();
        (0..rows).for_each(|i| k[(i, i)] += 1.0);
        let log_determinant = factorise(k.as_mut_slice(), rows)?;
        let mut z = left.transpose();
        for mut column in z.column_iter_mut() {
            solve_lower(k.as_slice(), rows, column.as_mut_slice());
        }
        let z = z.transpose();
        let mut half = None;
        if let Some((_, square)) = &self.linear {
            let of_z = square * &z;
            let inner = z.tr_mul(&of_z);
            // C W C changes by H Zᵀ + Z Hᵀ, H = Z ZᵀWZ / 2 - sign C W Z.
            let h = &z * &inner * 0.5 - &self.covariance * of_z * sign;
            self.weighted.gemm(1.0, &h, &z.transpose(), 1.0);
            self.weighted.gemm(1.0, &z, &h.transpose(), 1.0);
            self.cost -= sign * inner.trace();
            half = Some(h);
        } else {
            self.cost -= log_determinant;
        }
        self.covariance.gemm(-sign, &z, &z.transpose(), 1.0);
        Some(Change { z, half, sign })
    }

    /// Updates the blocks of all candidates.
    fn follow(&mut self, changes: &[Change]) {
        let most = self.scratch.column.len();
        for Change { z, half, sign } in changes {
            let mut y = vec![0.0; most * z.ncols()];
            let mut h = vec![0.0; if half.is_some() { y.len() } else { 0 }];
            for candidate in 0..self.space.candidates() {
                let columns = self.space.of(candidate);
                let rows = columns.len();
                let square = self.squares[candidate]..self.squares[candidate + 1];
                products(&self.space.rows, columns.clone(), z, &mut y);
                let own = &mut self.own[square.clone()];
                for m in 0..z.ncols() {
                    let y = &y[m * rows..(m + 1) * rows];
                    for j in 0..rows {
                        for i in 0..rows {
                            own[i + j * rows] -= sign * y[i] * y[j];
                        }
                    }
                }
                let Some(half) = half else { continue };
                products(&self.space.rows, columns, half, &mut h);
                let own = &mut self.own_weighted[square];
                for m in 0..z.ncols() {
                    let (y, h) = (&y[m * rows..(m + 1) * rows], &h[m * rows..(m + 1) * rows]);
                    for j in 0..rows {
                        for i in 0..rows {
                            own[i + j * rows] += h[i] * y[j] + y[i] * h[j];
                        }
                    }
                }
            }
        }
        self.look_alone();
    }
}

/// A change of the covariance.
struct Change {
    z: DMatrix<f64>,
    /// H, for a linear criterion.
    half: Option<DMatrix<f64>>,
    sign: f64,
}

/// Inner products of some columns of `rows` with those of `left`, ordered by columns of the latter.
fn products(rows: &DMatrix<f64>, columns: std::ops::Range<usize>, left: &DMatrix<f64>, out: &mut [f64]) {
    let p = rows.nrows();
    let own = &rows.as_slice()[columns.start * p..columns.end * p];
    let mut out = out.iter_mut();
    for left in left.as_slice().chunks_exact(p) {
        for (own, out) in own.chunks_exact(p).zip(out.by_ref()) {
            *out = dot(own, left);
        }
    }
}

/// Four sums at a time, so that none waits for another.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (mut sums, mut rest) = ([0.0; 4], 0.0);
    let (fours_a, fours_b) = (a.chunks_exact(4), b.chunks_exact(4));
    for (a, b) in fours_a.remainder().iter().zip(fours_b.remainder()) {
        rest += a * b;
    }
    for (a, b) in fours_a.zip(fours_b) {
        for i in 0..4 {
            sums[i] += a[i] * b[i];
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

/// For every candidate, the products of its columns of `spread` with each other.
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
