//! Variance components of a linearised system: sizes of errors of given shapes, by restricted maximum likelihood.
//!
//! The data have the covariance `V = Σ_known + Σ_k v_k Z_k Z_kᵀ`, block by block, and the parameters have a normal prior (flat where there is
//! none). With the parameters integrated out, the likelihood depends on the variances `v_k` alone, so that fitted parameters cost the degrees
//! of freedom that they take. It is maximised by steps with the average information, or, where such a step would decrease it, by a step that
//! never does.
//!
//! Source: H. D. Patterson, R. Thompson, "Recovery of inter-block information when block sizes are unequal", Biometrika 58 (1971), 545-554
//! (the likelihood); A. R. Gilmour, R. Thompson, B. R. Cullis, "Average information REML", Biometrics 51 (1995), 1440-1450 (the step);
//! H. Zhou et al., "MM algorithms for variance components models", J. Comput. Graph. Stat. 28 (2019), 350-361 (the other step).

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Observations whose errors depend on each other, and not on those of any other block.
#[derive(Debug, Clone)]
pub(super) struct Block {
    /// Indices of their blocks in the system, three rows each.
    pub blocks: Vec<usize>,
    /// The known part of their covariance, m².
    pub known: DMatrix<f64>,
    /// The columns of all `Z_k` next to each other, one row per coordinate.
    pub shapes: DMatrix<f64>,
    /// Component of every column.
    pub components: Vec<usize>,
}

/// A linearised system: rows of data in metres, and whitened rows of priors.
#[derive(Debug, Clone)]
pub(super) struct System {
    pub residuals: DVector<f64>,
    pub jacobian: DMatrix<f64>,
    /// Columns that are not held at a bound: the others are not parameters here.
    pub free: Vec<usize>,
    pub prior_residuals: DVector<f64>,
    pub prior_jacobian: DMatrix<f64>,
    /// Blocks of observations; an observation in none of them is ignored.
    pub blocks: Vec<Block>,
    /// Number of components.
    pub count: usize,
}

/// The variances that explain the residuals best.
#[derive(Debug, Clone)]
pub(super) struct Components {
    /// In the order of the shapes, in squared units of each; zero where the data show none.
    pub variances: Vec<f64>,
    /// Degrees of freedom of their sum, as a mean square over the coordinates: twice its square over its own variance (F. E. Satterthwaite, "An
    /// approximate distribution of estimates of variance components", Biometrics Bulletin 2 (1946), 110-114).
    pub freedom: f64,
    /// Logarithm of their likelihood, up to a constant.
    pub likelihood: f64,
}

/// An error that moves targets by a smaller mean square than this, m² per unit, is ignored: that of an actuator on whose axis they lie.
const UNSEEN: f64 = 1e-9;
/// Accuracy of the likelihood's logarithm: with it, a variance is off by a seventh of its own standard deviation.
const NEGLIGIBLE: f64 = 1e-2;
const MOST_STEPS: usize = 50;
/// Added to the unit diagonal of a normal matrix, which cannot distinguish it from zero, so that no direction is left free.
const LEAST: f64 = 1e-12;

impl System {
    fn coordinates(&self) -> usize {
        self.blocks.iter().map(|block| 3 * block.blocks.len()).sum()
    }

    /// Mean square of the residuals of the coordinates in the blocks, m².
    fn mean_square(&self) -> f64 {
        let rows = self.blocks.iter().flat_map(|block| &block.blocks);
        let sum: f64 = rows.map(|i| self.residuals.fixed_rows::<3>(3 * i).norm_squared()).sum();
        sum / self.coordinates() as f64
    }

    /// Mean square that a unit of each component makes.
    pub fn mean_squares(&self) -> Vec<f64> {
        let mut sums = vec![0.0; self.count];
        for block in &self.blocks {
            for (column, component) in block.shapes.column_iter().zip(&block.components) {
                sums[*component] += column.norm_squared();
            }
        }
        let coordinates = self.coordinates() as f64;
        sums.iter().map(|sum| sum / coordinates).collect()
    }

    /// The system without shapes that hardly move anything.
    pub fn without_unseen(self) -> Self {
        let units = self.mean_squares();
        let is_seen = |component: usize| units[component] >= UNSEEN;
        if (0..units.len()).all(is_seen) { self } else { self.with_components(is_seen) }
    }

    /// The system with the shapes of the components that are `kept`.
    pub fn with_components(mut self, kept: impl Fn(usize) -> bool) -> Self {
        for block in &mut self.blocks {
            let columns: Vec<usize> =
                (0..block.components.len()).filter(|column| kept(block.components[*column])).collect();
            block.shapes = block.shapes.select_columns(&columns);
            block.components = columns.iter().map(|column| block.components[*column]).collect();
        }
        self
    }

    /// Variances with equal shares of the residuals' mean square.
    fn shares(&self) -> Vec<f64> {
        let units = self.mean_squares();
        let share = self.mean_square() / units.iter().filter(|unit| **unit > 0.0).count().max(1) as f64;
        units.iter().map(|unit| if *unit > 0.0 { share / unit } else { 0.0 }).collect()
    }

    /// The variances of largest likelihood; `start` are earlier values, if known. `None` where residuals and shapes determine none, or only
    /// rounding is left.
    pub fn components(&self, start: Option<&[f64]>) -> Option<Components> {
        let units = self.mean_squares();
        if !(self.mean_square() > 0.0 && self.mean_square().is_finite()) || units.iter().all(|u| !(*u > 0.0))
        {
            return None;
        }
        let stacked = Stacked::new(self);
        let state = |variances: &[f64]| self.state(&stacked, variances);
        let start = start.map_or_else(|| self.shares(), <[f64]>::to_vec);
        let mut now = state(&start).or_else(|| state(&self.shares()))?;
        for _ in 0..MOST_STEPS {
            let Some((step, gain)) = now.newton() else { break };
            if gain < NEGLIGIBLE {
                break;
            }
            let ahead = |share: f64| -> Vec<f64> {
                now.variances.iter().zip(&step).map(|(v, s)| (v + share * s).max(0.0)).collect()
            };
            let better = |next: &State| next.likelihood >= now.likelihood;
            let next = state(&ahead(1.0))
                .filter(better)
                .or_else(|| state(&ahead(0.25)).filter(better))
                .or_else(|| state(&now.uphill()).filter(better));
            let Some(next) = next else { break };
            let negligible = next.likelihood - now.likelihood < NEGLIGIBLE;
            now = next;
            if negligible {
                break;
            }
        }
        let likelihood = now.likelihood;
        Some(Components { freedom: self.freedom(&now, &units), variances: now.variances, likelihood })
    }

    fn freedom(&self, now: &State, units: &[f64]) -> f64 {
        let known: f64 = self.blocks.iter().map(|block| block.known.trace()).sum();
        let known = known / self.coordinates() as f64;
        let free: Vec<usize> = (0..units.len()).filter(|k| now.variances[*k] > 0.0).collect();
        let total = known + free.iter().map(|k| now.variances[*k] * units[*k]).sum::<f64>();
        let weights = DVector::from_iterator(free.len(), free.iter().map(|k| units[*k] * now.variances[*k]));
        // In relative units of each, so that metres and radians do not mix.
        let information = DMatrix::from_fn(free.len(), free.len(), |i, j| {
            now.information[(free[i], free[j])] * now.variances[free[i]] * now.variances[free[j]]
        });
        let variance = Cholesky::new(information).map(|c| weights.dot(&c.solve(&weights)));
        match variance {
            Some(variance) if variance > 0.0 => 2.0 * total * total / variance,
            _ => f64::INFINITY,
        }
    }

    /// Likelihood and its derivatives at some variances; `None` where these leave a block without noise, or are not finite.
    fn state(&self, stacked: &Stacked, variances: &[f64]) -> Option<State> {
        let n = self.free.len();
        let (whitened, determinant) = stacked.whitened(variances)?;
        let jacobian = whitened.rows(0, n).into_owned();
        let mut residuals = whitened.row(n).transpose();
        let fit = GlsSolution::new(&jacobian, &mut residuals, &stacked.priors, &self.prior_residuals)?;
        let likelihood = -0.5 * (determinant + fit.determinant + residuals.norm_squared() + fit.priors);
        likelihood.is_finite().then_some(())?;
        // Qᵀ with Q Qᵀ the part of the hat matrix between the data; a product is several times as fast as solving for as many columns.
        let hat = fit.root.solve_lower_triangular(&DMatrix::identity(n, n))? * jacobian;
        let (explained, expected, working) = stacked.scores(&whitened, &residuals, &hat, variances.len());
        let fitted = hat * &working;
        let information = 0.5 * (working.tr_mul(&working) - fitted.tr_mul(&fitted));
        Some(State { variances: variances.to_vec(), likelihood, explained, expected, information })
    }
}

/// `Jᵀ`, `rᵀ` and the `Zᵀ` of every block on top of each other, with the blocks next to each other: the numbers of a coordinate are contiguous.
struct Stacked<'a> {
    /// The stacked rows; columns are coordinates.
    rows: DMatrix<f64>,
    /// Row of the residuals; the rows of the shapes follow.
    residuals: usize,
    /// The priors' rows in the free columns.
    priors: DMatrix<f64>,
    blocks: Vec<Slice<'a>>,
}

/// The coordinates of a block.
struct Slice<'a> {
    first: usize,
    known: &'a DMatrix<f64>,
    /// Component of every row of its `Zᵀ`.
    components: &'a [usize],
}

impl<'a> Stacked<'a> {
    fn new(system: &'a System) -> Self {
        let n = system.free.len();
        let most = system.blocks.iter().map(|block| block.components.len()).max().unwrap_or(0);
        let transposed = system.jacobian.select_columns(&system.free).transpose();
        let mut rows = DMatrix::zeros(n + 1 + most, system.coordinates());
        let mut blocks = Vec::with_capacity(system.blocks.len());
        let mut first = 0;
        for block in &system.blocks {
            for (k, observation) in block.blocks.iter().enumerate() {
                let (from, to) = (3 * observation, first + 3 * k);
                rows.view_mut((0, to), (n, 3)).copy_from(&transposed.columns(from, 3));
                rows.view_mut((n, to), (1, 3)).tr_copy_from(&system.residuals.rows(from, 3));
            }
            let (size, width) = block.shapes.shape();
            rows.view_mut((n + 1, first), (width, size)).tr_copy_from(&block.shapes);
            blocks.push(Slice { first, known: &block.known, components: &block.components });
            first += 3 * block.blocks.len();
        }
        Self { rows, residuals: n, priors: system.prior_jacobian.select_columns(&system.free), blocks }
    }

    /// All rows in standard deviations, and the logarithm of the covariance's determinant; `None` where a block has no noise.
    fn whitened(&self, variances: &[f64]) -> Option<(DMatrix<f64>, f64)> {
        let mut rows = self.rows.clone();
        let mut determinant = 0.0;
        // Blocks of one size share their memory.
        let mut memory = DMatrix::zeros(0, 0);
        for block in &self.blocks {
            self.covariance(block, variances, &mut memory);
            let cholesky = Cholesky::new(memory)?;
            let factor = cholesky.l_dirty();
            for row in 0..factor.nrows() {
                let place = block.first + row;
                let (above, mut own) = rows.columns_range_pair_mut(block.first..place, place);
                for (k, column) in above.column_iter().enumerate() {
                    own.axpy(-factor[(row, k)], &column, 1.0);
                }
                own /= factor[(row, row)];
                determinant += 2.0 * factor[(row, row)].ln();
            }
            memory = cholesky.unpack_dirty();
        }
        Some((rows, determinant))
    }

    /// The lower triangle of a block's covariance.
    fn covariance(&self, block: &Slice<'_>, variances: &[f64], covariance: &mut DMatrix<f64>) {
        covariance.clone_from(block.known);
        let size = covariance.nrows();
        for (row, component) in (self.residuals + 1..).zip(block.components) {
            let variance = variances[*component];
            if variance > 0.0 {
                for j in 0..size {
                    let scaled = variance * self.rows[(row, block.first + j)];
                    for i in j..size {
                        covariance[(i, j)] += scaled * self.rows[(row, block.first + i)];
                    }
                }
            }
        }
    }

    /// From whitened rows, the `residuals` of the fit and the hat matrix's root: `uᵀ Z Zᵀ u` of each component, its expectation, and the working
    /// variates of the average information.
    fn scores(
        &self,
        whitened: &DMatrix<f64>,
        residuals: &DVector<f64>,
        hat: &DMatrix<f64>,
        count: usize,
    ) -> (Vec<f64>, Vec<f64>, DMatrix<f64>) {
        let (mut explained, mut expected) = (vec![0.0; count], vec![0.0; count]);
        let mut working = DMatrix::zeros(residuals.len(), count);
        let mut left = Vec::new();
        for block in &self.blocks {
            let (first, size) = (block.first, block.known.nrows());
            let own = hat.columns(first, size);
            // What the fit leaves of unit noise of each coordinate: the lower triangle.
            left.clear();
            for j in 0..size {
                for i in 0..size {
                    let kept = if i == j { 1.0 } else { 0.0 };
                    left.push(if i < j { 0.0 } else { kept - own.column(i).dot(&own.column(j)) });
                }
            }
            let left = |i: usize, j: usize| left[j * size + i];
            for (row, component) in (self.residuals + 1..).zip(block.components) {
                let shape = |i: usize| whitened[(row, first + i)];
                let along: f64 = (0..size).map(|i| shape(i) * residuals[first + i]).sum();
                explained[*component] += along * along;
                for i in 0..size {
                    let across: f64 = (0..i).map(|j| left(i, j) * shape(j)).sum();
                    expected[*component] += shape(i) * (left(i, i) * shape(i) + 2.0 * across);
                    working[(first + i, *component)] += along * shape(i);
                }
            }
        }
        (explained, expected, working)
    }
}

/// The solution of a whitened system by generalised least squares (GLS).
struct GlsSolution {
    /// Lower factor of the scaled normal matrix, in the parameters' own units.
    root: DMatrix<f64>,
    /// Logarithm of the determinant of the normal matrix, up to a constant.
    determinant: f64,
    /// Sum of squares of the priors at the solution.
    priors: f64,
}

impl GlsSolution {
    /// Replaces `residuals` by those of the solution; `whitened` is the transposed Jacobian.
    fn new(
        whitened: &DMatrix<f64>,
        residuals: &mut DVector<f64>,
        prior_jacobian: &DMatrix<f64>,
        prior_residuals: &DVector<f64>,
    ) -> Option<Self> {
        let n = whitened.nrows();
        let mut normal = DMatrix::zeros(n, n);
        normal.gemm(1.0, whitened, &whitened.transpose(), 0.0);
        normal.gemm(1.0, &prior_jacobian.transpose(), prior_jacobian, 1.0);
        let gradient = whitened * &*residuals + prior_jacobian.tr_mul(prior_residuals);
        let scale: Vec<f64> =
            (0..n).map(|j| if normal[(j, j)] > 0.0 { normal[(j, j)].sqrt() } else { 1.0 }).collect();
        for (j, mut column) in normal.column_iter_mut().enumerate() {
            for (i, entry) in column.iter_mut().enumerate() {
                *entry /= scale[i] * scale[j];
            }
            column[j] += LEAST;
        }
        let cholesky: Cholesky<f64, Dyn> = Cholesky::new(normal)?;
        let scaled = DVector::from_iterator(n, gradient.iter().zip(&scale).map(|(g, s)| g / s));
        let mut step = -cholesky.solve(&scaled);
        for (step, scale) in step.iter_mut().zip(&scale) {
            *step /= *scale;
        }
        residuals.gemv_tr(1.0, whitened, &step, 1.0);
        let mut root = cholesky.unpack();
        let determinant = root.diagonal().iter().zip(&scale).map(|(v, s)| 2.0 * (v.ln() + s.ln())).sum();
        for (mut row, scale) in root.row_iter_mut().zip(&scale) {
            row *= *scale;
        }
        let priors = (prior_jacobian * &step + prior_residuals).norm_squared();
        Some(Self { root, determinant, priors })
    }
}

/// The likelihood at some variances.
struct State {
    variances: Vec<f64>,
    likelihood: f64,
    /// `uᵀ Z Zᵀ u` with `u = V⁻¹ r`, per component ...
    explained: Vec<f64>,
    /// ... and its expectation if the variances are right.
    expected: Vec<f64>,
    /// Average information.
    information: DMatrix<f64>,
}

impl State {
    fn slope(&self, k: usize) -> f64 {
        0.5 * (self.explained[k] - self.expected[k])
    }

    /// The step with the average information, and its predicted gain. A component that would become negative goes to zero, and stays there while the
    /// likelihood falls towards positive values.
    fn newton(&self) -> Option<(Vec<f64>, f64)> {
        let count = self.variances.len();
        let mut free: Vec<usize> = (0..count)
            .filter(|k| self.expected[*k] > 0.0 && (self.variances[*k] > 0.0 || self.slope(*k) > 0.0))
            .collect();
        let mut step = vec![0.0; count];
        let mut held: Vec<usize> = Vec::new();
        loop {
            if free.is_empty() && held.is_empty() {
                return None;
            }
            let size: Vec<f64> = free.iter().map(|k| self.information[(*k, *k)].sqrt()).collect();
            if size.iter().any(|s| !(*s > 0.0)) {
                return None;
            }
            let matrix = DMatrix::from_fn(free.len(), free.len(), |i, j| {
                let ridge = if i == j { 1e-9 } else { 0.0 };
                self.information[(free[i], free[j])] / (size[i] * size[j]) + ridge
            });
            // Components that go to zero change the slope of the others.
            let right = DVector::from_iterator(
                free.len(),
                free.iter().zip(&size).map(|(k, s)| {
                    let moved: f64 = held.iter().map(|h| self.information[(*k, *h)] * step[*h]).sum();
                    (self.slope(*k) - moved) / s
                }),
            );
            let found = Cholesky::new(matrix)?.solve(&right);
            for ((k, found), size) in free.iter().zip(&found).zip(&size) {
                step[*k] = found / size;
            }
            let negative = |k: &usize| self.variances[*k] + step[*k] < 0.0;
            let Some(place) = free.iter().position(negative) else { break };
            // To hold all negative components at once would hold too many: the worst goes first.
            let depth = |k: usize| {
                (self.variances[k] + step[k]) / (self.variances[k] - step[k]).abs().max(f64::MIN_POSITIVE)
            };
            let worst = (place..free.len())
                .filter(|i| negative(&free[*i]))
                .min_by(|a, b| depth(free[*a]).total_cmp(&depth(free[*b])))?;
            let k = free.remove(worst);
            step[k] = -self.variances[k];
            held.push(k);
        }
        let gain: f64 = (0..count).map(|k| self.slope(k) * step[k]).sum::<f64>() * 0.5;
        Some((step, gain.abs()))
    }

    /// A step that never lowers the likelihood.
    fn uphill(&self) -> Vec<f64> {
        let of = |k: usize| {
            if self.expected[k] > 0.0 {
                self.variances[k] * (self.explained[k] / self.expected[k]).sqrt()
            } else {
                0.0
            }
        };
        (0..self.variances.len()).map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    fn normal(rows: usize, columns: usize, rng: &mut ChaCha8Rng) -> DMatrix<f64> {
        DMatrix::from_fn(rows, columns, |_, _| StandardNormal.sample(rng))
    }

    /// Observations in pairs, with a common shape of each pair, a common direction and independent noise; three parameters, one with a prior.
    fn system(pairs: usize, sigmas: [f64; 3], rng: &mut ChaCha8Rng) -> System {
        let rows = 6 * pairs;
        let jacobian = normal(rows, 3, rng);
        let mut residuals = DVector::zeros(rows);
        let mut blocks = Vec::new();
        for pair in 0..pairs {
            let own = DMatrix::identity(6, 6);
            let common = DMatrix::from_fn(6, 3, |i, j| if i % 3 == j { 1.0 } else { 0.0 });
            let shapes = [own, common, normal(6, 1, rng)];
            let mut error = DVector::zeros(6);
            for (shape, sigma) in shapes.iter().zip(sigmas) {
                error += sigma * shape * normal(shape.ncols(), 1, rng);
            }
            residuals.rows_mut(6 * pair, 6).copy_from(&error);
            let columns: Vec<_> = shapes.iter().flat_map(DMatrix::column_iter).collect();
            blocks.push(Block {
                blocks: vec![2 * pair, 2 * pair + 1],
                known: DMatrix::identity(6, 6) * 1e-4,
                shapes: DMatrix::from_columns(&columns),
                components: [vec![0; 6], vec![1; 3], vec![2]].concat(),
            });
        }
        let mut prior_jacobian = DMatrix::zeros(1, 3);
        prior_jacobian[(0, 2)] = 2.0;
        let prior_residuals = DVector::from_element(1, 0.3);
        System { residuals, jacobian, free: vec![0, 1, 2], prior_residuals, prior_jacobian, blocks, count: 3 }
    }

    /// From full matrices: minus half of `ln |V| + ln |A| + rᵀ P r`, with the priors as data rows of known variance.
    fn dense(system: &System, variances: &[f64]) -> f64 {
        let rows = system.residuals.len();
        let mut v = DMatrix::identity(rows + 1, rows + 1);
        for block in &system.blocks {
            let first = 3 * block.blocks[0];
            let mut own = block.known.clone();
            for (shape, component) in block.shapes.column_iter().zip(&block.components) {
                own += variances[*component] * shape * shape.transpose();
            }
            v.view_mut((first, first), own.shape()).copy_from(&own);
        }
        let mut jacobian = system.jacobian.clone().insert_rows(rows, 1, 0.0);
        jacobian.row_mut(rows).copy_from(&system.prior_jacobian.row(0));
        let residuals = system.residuals.clone().insert_row(rows, system.prior_residuals[0]);
        let inverse = v.clone().try_inverse().expect("regular");
        let normal = jacobian.transpose() * &inverse * &jacobian;
        let p = &inverse
            - &inverse
                * &jacobian
                * normal.clone().try_inverse().expect("regular")
                * jacobian.transpose()
                * &inverse;
        -0.5 * (v.determinant().ln()
            + normal.determinant().ln()
            + (residuals.transpose() * p * &residuals)[(0, 0)])
    }

    #[test]
    fn the_likelihood_and_its_slope_are_those_of_whole_matrices() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let system = system(5, [0.5, 0.8, 0.3], &mut rng);
        let at = [0.3, 0.5, 0.2];
        let state = system.state(&Stacked::new(&system), &at).expect("regular");
        assert!(
            (state.likelihood - dense(&system, &at)).abs() < 1e-8,
            "{} {}",
            state.likelihood,
            dense(&system, &at)
        );
        for k in 0..3 {
            let moved = |step: f64| {
                let mut moved = at;
                moved[k] += step;
                dense(&system, &moved)
            };
            let slope = (moved(1e-5) - moved(-1e-5)) / 2e-5;
            assert!(
                (state.slope(k) - slope).abs() < 1e-5 * slope.abs().max(1.0),
                "{k}: {} {slope}",
                state.slope(k)
            );
        }
    }

    /// A parameter at a bound costs no degree of freedom, and absorbs none of the residuals.
    #[test]
    fn what_a_bound_holds_explains_nothing() {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let mut bounded = system(8, [0.7, 0.4, 0.0], &mut rng);
        let mut without = bounded.clone();
        bounded.free = vec![0, 2];
        without.jacobian = without.jacobian.remove_column(1);
        without.prior_jacobian = without.prior_jacobian.remove_column(1);
        without.free = vec![0, 1];
        let [bounded, without] = [bounded, without].map(|s| s.components(None).expect("residuals").variances);
        assert_eq!(bounded, without);
    }

    /// Without priors, one variance is the sum of squares over rows less parameters.
    #[test]
    fn one_variance_is_the_mean_square_per_degree_of_freedom() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut system = system(8, [0.7, 0.0, 0.0], &mut rng);
        system.prior_jacobian.fill(0.0);
        for block in &mut system.blocks {
            block.known.fill(0.0);
            block.shapes = block.shapes.columns(0, 6).into_owned();
            block.components.truncate(6);
        }
        system.count = 1;
        let (q, _) = system.jacobian.clone().qr().unpack();
        let left = &system.residuals - &q * q.tr_mul(&system.residuals);
        let expected = left.norm_squared() / 45.0;
        let found = system.components(None).expect("residuals");
        assert!((found.variances[0] / expected - 1.0).abs() < 1e-2, "{found:?} {expected}");
        assert!((found.freedom / 45.0 - 1.0).abs() < 1e-2, "{found:?}");
    }

    /// It is a maximum: no step along any component leads higher, and a component that would be negative is zero. Over many draws the mean is the
    /// true value, and the scatter is as the average information says.
    #[test]
    fn variances_are_those_that_were_put_in() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let truth = [0.25, 0.64, 0.09];
        let trials = 300;
        let mut sums = [0.0; 3];
        let mut squares = [0.0; 3];
        for _ in 0..trials {
            let system = system(30, truth.map(f64::sqrt), &mut rng);
            let found = system.components(None).expect("residuals").variances;
            let most = dense(&system, &found);
            for k in 0..3 {
                for factor in [0.9, 1.1] {
                    let mut moved = found.clone();
                    moved[k] = (moved[k] * factor).max(1e-3);
                    assert!(dense(&system, &moved) <= most + 2.0 * NEGLIGIBLE, "{found:?} {moved:?}");
                }
                sums[k] += found[k];
                squares[k] += found[k] * found[k];
            }
        }
        for k in 0..3 {
            let mean = sums[k] / f64::from(trials);
            let deviation = (squares[k] / f64::from(trials) - mean * mean).sqrt();
            // Four standard deviations of the mean; as variances are cut off at zero, the smallest is a little larger on average.
            let bound = 4.0 * deviation / f64::from(trials).sqrt() + if k == 2 { 0.01 } else { 0.0 };
            assert!((mean - truth[k]).abs() < bound, "{k}: {mean} {bound}");
        }
        let none = system(30, [0.5, 0.0, 0.0], &mut rng).components(None).expect("residuals").variances;
        assert!(none[1] < 0.03 && none[2] < 0.05 && none.iter().all(|v| *v >= 0.0), "{none:?}");
    }

    #[test]
    fn nothing_is_found_where_nothing_is() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut silent = system(3, [0.0; 3], &mut rng);
        silent.residuals.fill(0.0);
        assert!(silent.components(None).is_none());
        silent.residuals.fill(f64::NAN);
        assert!(silent.components(None).is_none());
        silent.blocks.clear();
        assert!(silent.components(None).is_none());
    }
}
