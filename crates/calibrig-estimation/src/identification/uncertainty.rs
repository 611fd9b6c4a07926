//! The uncertainty of an estimate, what it rests on, and the influence of each pose.
//!
//! Everything is computed from the whitened Jacobian at the minimum: rows of the data (three per observation), then rows of the priors.

use nalgebra::{DMatrix, DVector, Dyn, Matrix3, OMatrix, SymmetricEigen, U3, Vector3};
use serde::{Deserialize, Serialize};

use super::factor::{extended, triangular_factor_of_all};
use super::{Linearisation, analyse_r};
use calibrig_model::ParameterId;

/// A position's derivative with respect to the parameters, 3 x n.
pub type PositionJacobian = OMatrix<f64, U3, Dyn>;

/// Directions with less than this share of the largest scaled eigenvalue of the priors do not count as held by them.
const NEGLIGIBLE_PRIOR: f64 = 1e-12;

/// The uncertainty of parameters that data and priors determine together.
#[derive(Debug, Clone, PartialEq)]
pub struct Uncertainty {
    parameters: Vec<ParameterId>,
    /// `S` with covariance `S Sᵀ`, upper triangular.
    factor: DMatrix<f64>,
    covariance: DMatrix<f64>,
    data_covariance: Option<DMatrix<f64>>,
    prior_part: DMatrix<f64>,
    prior_sigmas: Vec<Option<f64>>,
    effective_parameters: f64,
}

/// The sources of one parameter's standard deviation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ParameterSupport {
    /// Which parameter.
    pub id: ParameterId,
    /// Standard deviation from data and priors together, SI.
    pub sigma: f64,
    /// Standard deviation from the priors alone; `None` where they do not determine it.
    pub prior_sigma: Option<f64>,
    /// Standard deviation from the data alone; `None` where they do not determine all parameters.
    pub data_sigma: Option<f64>,
    /// Share of the knowledge that came with the data, `1 - sigma² / prior_sigma²`: 0 where the data show nothing, 1 without a prior.
    pub data_share: f64,
    /// Part of `sigma` due to the readings' noise, SI: `sigma² = noise_part² + prior_part²`.
    pub noise_part: f64,
    /// Part of `sigma` due to the priors' uncertainty, SI. More readings of the same poses do not reduce it in proportion.
    pub prior_part: f64,
}

/// Influence of an observation on the estimate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PoseInfluence {
    /// Trace of its 3 x 3 block of the hat matrix, 0 to 3: how many parameters it determines on its own.
    pub leverage: f64,
    /// Residuals over their own standard deviations, which are smaller than the readings' because of the fit.
    pub standardised: Vector3<f64>,
    /// `eᵀ (1 - H)⁻¹ e`: chi-square with three degrees of freedom if the stated noise is right. `None` where the observation alone
    /// determines a direction.
    pub chi2: Option<f64>,
    /// Whitened residual if its pose had been left out of the fit (to first order).
    pub left_out: Option<Vector3<f64>>,
    /// Cook's distance: how far the estimate would move without its pose, in the estimate's own uncertainty and per parameter.
    pub cook: Option<f64>,
}

impl Uncertainty {
    /// The uncertainty from the whitened `jacobian` (rows x n), whose first `data_rows` rows are data and whose other rows are priors. `None` where
    /// both together do not determine all `parameters`.
    pub fn new(jacobian: &DMatrix<f64>, data_rows: usize, parameters: &[ParameterId]) -> Option<Self> {
        let n = parameters.len();
        if jacobian.ncols() != n || n == 0 || data_rows > jacobian.nrows() {
            return None;
        }
        let data = triangular_factor_of_all(jacobian.rows(0, data_rows).as_view());
        let priors = jacobian.rows(data_rows, jacobian.nrows() - data_rows);
        let factor = inverse_factor(&extended(data.clone(), priors.as_view()), parameters)?;
        let covariance = &factor * factor.transpose();
        let weighted = priors * &covariance;
        Some(Self {
            parameters: parameters.to_vec(),
            prior_part: weighted.tr_mul(&weighted),
            effective_parameters: (&data * &factor).norm_squared(),
            data_covariance: inverse_factor(&data, parameters).map(|s| &s * s.transpose()),
            prior_sigmas: marginal_sigmas(&priors.tr_mul(&priors)),
            factor,
            covariance,
        })
    }

    /// The uncertainty of a solved system. Parameters at a bound have no spread, and add none to the others.
    pub fn of(system: &Linearisation, parameters: &[ParameterId]) -> Option<Self> {
        if system.bounded.is_empty() {
            return Self::new(&system.jacobian, system.data_rows, parameters);
        }
        let n = parameters.len();
        let free: Vec<usize> = system.free();
        let names: Option<Vec<_>> = free.iter().map(|place| parameters.get(*place).copied()).collect();
        let of_free = Self::new(&system.jacobian.select_columns(&free), system.data_rows, &names?)?;
        let rows = |matrix: &DMatrix<f64>| {
            let mut all = DMatrix::zeros(n, matrix.ncols());
            free.iter().zip(matrix.row_iter()).for_each(|(place, row)| all.row_mut(*place).copy_from(&row));
            all
        };
        let both = |matrix: &DMatrix<f64>| rows(&rows(matrix).transpose());
        let mut prior_sigmas = vec![None; n];
        free.iter().zip(&of_free.prior_sigmas).for_each(|(place, sigma)| prior_sigmas[*place] = *sigma);
        Some(Self {
            parameters: parameters.to_vec(),
            factor: rows(&of_free.factor),
            covariance: both(&of_free.covariance),
            data_covariance: of_free.data_covariance.as_ref().map(both),
            prior_part: both(&of_free.prior_part),
            prior_sigmas,
            effective_parameters: of_free.effective_parameters,
        })
    }

    /// Covariance from data and priors together, n x n, SI.
    pub fn covariance(&self) -> &DMatrix<f64> {
        &self.covariance
    }

    /// Covariance from the data alone; `None` where they do not determine all parameters.
    pub fn data_covariance(&self) -> Option<&DMatrix<f64>> {
        self.data_covariance.as_ref()
    }

    /// Part of the covariance due to the priors' uncertainty, `C P C` with P the priors' information; the rest is due to the readings.
    pub fn prior_part(&self) -> &DMatrix<f64> {
        &self.prior_part
    }

    /// How many parameters the data determine: the trace of their share of the information, n without priors.
    ///
    /// Source: D. J. C. `MacKay`, "Bayesian interpolation", Neural Computation 4 (1992), 415-447, section 4.
    pub fn effective_parameters(&self) -> f64 {
        self.effective_parameters
    }

    /// The sources of every parameter's standard deviation.
    pub fn support(&self) -> Vec<ParameterSupport> {
        self.parameters
            .iter()
            .enumerate()
            .map(|(i, id)| {
                let variance = self.covariance[(i, i)];
                let from_priors = self.prior_part[(i, i)];
                let prior_sigma = self.prior_sigmas[i];
                ParameterSupport {
                    id: *id,
                    sigma: variance.sqrt(),
                    prior_sigma,
                    data_sigma: self.data_covariance.as_ref().map(|c| c[(i, i)].sqrt()),
                    data_share: prior_sigma.map_or(1.0, |s| (1.0 - variance / (s * s)).clamp(0.0, 1.0)),
                    noise_part: (variance - from_priors).max(0.0).sqrt(),
                    prior_part: from_priors.sqrt(),
                }
            })
            .collect()
    }

    /// Correlation matrix, n x n.
    pub fn correlations(&self) -> DMatrix<f64> {
        let sigma = self.covariance.diagonal().map(f64::sqrt);
        DMatrix::from_fn(sigma.len(), sigma.len(), |i, j| self.covariance[(i, j)] / (sigma[i] * sigma[j]))
    }

    /// The pairs whose correlation is at least `least` in size, strongest first.
    pub fn strongest_correlations(&self, least: f64) -> Vec<(ParameterId, ParameterId, f64)> {
        let correlations = self.correlations();
        let mut pairs = Vec::new();
        for j in 0..self.parameters.len() {
            for i in 0..j {
                let correlation = correlations[(i, j)];
                if correlation.abs() >= least {
                    pairs.push((self.parameters[i], self.parameters[j], correlation));
                }
            }
        }
        pairs.sort_by(|a, b| b.2.abs().total_cmp(&a.2.abs()));
        pairs
    }

    /// Covariance of a predicted position with derivative `jacobian` (3 x n), m²; `None` where `jacobian` has another number of columns.
    pub fn position_covariance(&self, jacobian: &PositionJacobian) -> Option<Matrix3<f64>> {
        if jacobian.ncols() != self.parameters.len() {
            return None;
        }
        let spread = jacobian * &self.factor;
        Some(&spread * spread.transpose())
    }

    /// The influence of every observation on the estimate, from the same `jacobian` and the whitened `residuals` at the minimum, for whole blocks of
    /// the data rows (observations, then orientations); empty where the Jacobian has other parameters. Observations of one of the `poses` share its
    /// errors and are left out together; an observation in none of them is a pose of its own.
    pub fn influences(
        &self,
        jacobian: &DMatrix<f64>,
        residuals: &[f64],
        data_rows: usize,
        poses: &[Vec<usize>],
    ) -> Vec<PoseInfluence> {
        let rows = if jacobian.ncols() == self.parameters.len() { jacobian.nrows() } else { 0 };
        let observations = data_rows.min(rows).min(residuals.len()) / 3;
        let mut influences: Vec<PoseInfluence> = (0..observations)
            .map(|i| {
                let spread = jacobian.fixed_rows::<3>(3 * i) * &self.factor;
                let hat: Matrix3<f64> = &spread * spread.transpose();
                let residual = Vector3::from_column_slice(&residuals[3 * i..3 * i + 3]);
                self.influence(&hat, &residual)
            })
            .collect();
        for pose in poses.iter().filter(|pose| pose.len() > 1 && pose.iter().all(|i| *i < observations)) {
            self.leave_out(pose, jacobian, residuals, &mut influences);
        }
        influences
    }

    /// The effect of leaving out the observations of a pose together.
    fn leave_out(
        &self,
        pose: &[usize],
        jacobian: &DMatrix<f64>,
        residuals: &[f64],
        influences: &mut [PoseInfluence],
    ) {
        let rows: Vec<usize> = pose.iter().flat_map(|i| 3 * i..3 * i + 3).collect();
        let spread = jacobian.select_rows(&rows) * &self.factor;
        let hat = &spread * spread.transpose();
        let residual = DVector::from_iterator(rows.len(), rows.iter().map(|row| residuals[*row]));
        let rest = DMatrix::identity(rows.len(), rows.len()) - &hat;
        let left_out =
            rest.cholesky().map(|c| c.solve(&residual)).filter(|v| v.iter().all(|v| v.is_finite()));
        let cook = left_out.as_ref().map(|v| v.dot(&(hat * v)) / self.parameters.len() as f64);
        for (k, i) in pose.iter().enumerate() {
            influences[*i].left_out = left_out.as_ref().map(|v| v.fixed_rows::<3>(3 * k).into_owned());
            influences[*i].cook = cook;
        }
    }

    fn influence(&self, hat: &Matrix3<f64>, residual: &Vector3<f64>) -> PoseInfluence {
        let rest = Matrix3::identity() - hat;
        let left_out = rest.cholesky().map(|c| c.solve(residual)).filter(|v| v.iter().all(|v| v.is_finite()));
        PoseInfluence {
            leverage: hat.trace(),
            standardised: residual.zip_map(&rest.diagonal(), |e, v| if v > 0.0 { e / v.sqrt() } else { 0.0 }),
            chi2: left_out.map(|v| residual.dot(&v)),
            left_out,
            cook: left_out.map(|v| v.dot(&(hat * v)) / self.parameters.len() as f64),
        }
    }
}

/// The Cramér-Rao bound: no unbiased estimator from data with this whitened Jacobian at the truth has a smaller covariance. `None` where
/// the data do not determine all parameters.
pub fn cramer_rao_bound(jacobian: &DMatrix<f64>, parameters: &[ParameterId]) -> Option<DMatrix<f64>> {
    inverse_factor(&triangular_factor_of_all(jacobian.as_view()), parameters).map(|s| &s * s.transpose())
}

/// The Bayesian Cramér-Rao bound on the mean squared error of any estimator, where the truth is drawn from the normal prior with the whitening
/// `prior` (rows x n): `(E[Jᵀ J] + Lᵀ L)⁻¹`, with the mean over the data's Jacobians J at truths drawn from it. `None` where data and prior
/// together do not determine all parameters, or a matrix has another number of columns.
///
/// Source: H. L. Van Trees, "Detection, Estimation, and Modulation Theory, Part I" (1968), section 2.4.3.
pub fn bayesian_cramer_rao_bound<'a>(
    jacobians: impl ExactSizeIterator<Item = &'a DMatrix<f64>>,
    prior: &DMatrix<f64>,
    parameters: &[ParameterId],
) -> Option<DMatrix<f64>> {
    let count = jacobians.len() as f64;
    if prior.ncols() != parameters.len() || parameters.is_empty() {
        return None;
    }
    // Triangular factors instead of normal matrices, which would halve the digits of weak directions.
    let mut stacked = prior.clone();
    for jacobian in jacobians {
        if jacobian.ncols() != stacked.ncols() {
            return None;
        }
        let below = jacobian / count.sqrt();
        let rows = stacked.nrows();
        let mut joined = stacked.insert_rows(rows, below.nrows(), 0.0);
        joined.rows_mut(rows, below.nrows()).copy_from(&below);
        stacked = if joined.nrows() > joined.ncols() { joined.qr().unpack_r() } else { joined };
    }
    inverse_factor(&stacked, parameters).map(|s| &s * s.transpose())
}

/// `S` with `S Sᵀ = (Jᵀ J)⁻¹`; `None` where `Jᵀ J` is singular.
fn inverse_factor(jacobian: &DMatrix<f64>, parameters: &[ParameterId]) -> Option<DMatrix<f64>> {
    let n = jacobian.ncols();
    if n != parameters.len() || n == 0 || jacobian.nrows() < n || jacobian.iter().any(|v| !v.is_finite()) {
        return None;
    }
    let scale = DVector::from_iterator(n, jacobian.column_iter().map(|c| c.norm()));
    if scale.iter().any(|s| !(*s > 0.0)) {
        return None;
    }
    let mut scaled = jacobian.clone();
    for (mut column, s) in scaled.column_iter_mut().zip(&scale) {
        column /= *s;
    }
    let r = scaled.qr().unpack_r();
    if analyse_r(&r, parameters).rank < n {
        return None;
    }
    let mut inverse = r.solve_upper_triangular(&DMatrix::identity(n, n))?;
    for (mut row, s) in inverse.row_iter_mut().zip(&scale) {
        row /= *s;
    }
    Some(inverse)
}

/// The standard deviation of every parameter from the information matrix `p` alone; `None` where it leaves the parameter free.
fn marginal_sigmas(p: &DMatrix<f64>) -> Vec<Option<f64>> {
    let n = p.nrows();
    let held: Vec<_> = (0..n).filter(|i| p[(*i, *i)] > 0.0).collect();
    if held.is_empty() {
        return vec![None; n];
    }
    let scale: Vec<_> = held.iter().map(|i| p[(*i, *i)].sqrt()).collect();
    let scaled =
        DMatrix::from_fn(held.len(), held.len(), |a, b| p[(held[a], held[b])] / (scale[a] * scale[b]));
    let eigen = SymmetricEigen::new(scaled);
    let limit = NEGLIGIBLE_PRIOR * eigen.eigenvalues.iter().copied().fold(0.0, f64::max);
    let mut sigmas = vec![None; n];
    for (a, i) in held.iter().enumerate() {
        let (mut variance, mut free) = (0.0, 0.0);
        for (k, eigenvalue) in eigen.eigenvalues.iter().enumerate() {
            let share = eigen.eigenvectors[(a, k)].powi(2);
            if *eigenvalue > limit { variance += share / eigenvalue } else { free += share }
        }
        sigmas[*i] = (free <= NEGLIGIBLE_PRIOR).then(|| variance.sqrt() / scale[a]);
    }
    sigmas
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_model::statistics::chi2_quantile;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    const POSES: usize = 8;

    fn normal(rows: usize, columns: usize, rng: &mut ChaCha8Rng) -> DMatrix<f64> {
        DMatrix::from_fn(rows, columns, |_, _| StandardNormal.sample(rng))
    }

    fn names(n: usize) -> Vec<ParameterId> {
        ParameterId::all_of_links(n.div_ceil(5)).into_iter().take(n).collect()
    }

    /// Eight poses, seven parameters of different size; the last three have a prior, two of them a common one.
    fn system(rng: &mut ChaCha8Rng) -> (DMatrix<f64>, Vec<ParameterId>) {
        let mut jacobian = normal(3 * POSES + 3, 7, rng);
        for (column, size) in [1e4, 1.0, 30.0, 1e-3, 5.0, 1e3, 2.0].into_iter().enumerate() {
            jacobian.column_mut(column).scale_mut(size);
        }
        jacobian.rows_mut(3 * POSES, 3).fill(0.0);
        jacobian[(3 * POSES, 4)] = 8.0;
        jacobian[(3 * POSES + 1, 5)] = 3e3;
        jacobian[(3 * POSES + 2, 5)] = 1e3;
        jacobian[(3 * POSES + 2, 6)] = 5.0;
        (jacobian, names(7))
    }

    fn solve(jacobian: &DMatrix<f64>, right: &DVector<f64>) -> DVector<f64> {
        jacobian.clone().svd(true, true).solve(right, 1e-14).expect("a solution")
    }

    #[test]
    fn covariances_are_those_of_the_normal_equations() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let (jacobian, ids) = system(&mut rng);
        let uncertainty = Uncertainty::new(&jacobian, 3 * POSES, &ids).expect("full rank");
        let data = jacobian.rows(0, 3 * POSES).into_owned();
        let all = jacobian.tr_mul(&jacobian).try_inverse().expect("regular");
        let of_data = data.tr_mul(&data).try_inverse().expect("regular");
        let close = |a: &DMatrix<f64>, b: &DMatrix<f64>| {
            for i in 0..7 {
                for j in 0..7 {
                    let size = (b[(i, i)] * b[(j, j)]).abs().sqrt();
                    assert!((a[(i, j)] - b[(i, j)]).abs() <= 1e-9 * size, "{i} {j}");
                }
            }
        };
        close(uncertainty.covariance(), &all);
        close(uncertainty.data_covariance().expect("enough data"), &of_data);
        let noise_part = &all * data.tr_mul(&data) * &all;
        close(&(uncertainty.covariance() - uncertainty.prior_part()), &noise_part);
        let effective = (&all * data.tr_mul(&data)).trace();
        assert!((uncertainty.effective_parameters() - effective).abs() < 1e-9, "{effective}");
        for support in uncertainty.support() {
            let variance = support.noise_part.powi(2) + support.prior_part.powi(2);
            assert!((variance - support.sigma.powi(2)).abs() < 1e-12 * variance);
            assert!(support.data_sigma.expect("enough data") >= support.sigma);
        }
        let correlations = uncertainty.strongest_correlations(0.0);
        assert_eq!(correlations.len(), 21);
        assert!(correlations.windows(2).all(|w| w[0].2.abs() >= w[1].2.abs()));
        let (first, second, value) = correlations[0];
        let place = |id| ids.iter().position(|i| *i == id).expect("a parameter");
        let (i, j) = (place(first), place(second));
        assert!((value - all[(i, j)] / (all[(i, i)] * all[(j, j)]).sqrt()).abs() < 1e-9);
    }

    #[test]
    fn the_share_of_the_data_is_one_without_a_prior_and_zero_without_data() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let (jacobian, ids) = system(&mut rng);
        let support = Uncertainty::new(&jacobian, 3 * POSES, &ids).expect("full rank").support();
        assert!(support[..4].iter().all(|s| s.prior_sigma.is_none() && s.data_share == 1.0));
        assert!((support[4].prior_sigma.expect("a prior") - 1.0 / 8.0).abs() < 1e-12);
        // The two with a common prior: inverse of [[1e7, 5e3], [5e3, 25]].
        let determinant = 1e7 * 25.0 - 25e6_f64;
        let expected = [(25.0 / determinant).sqrt(), (1e7 / determinant).sqrt()];
        for (support, expected) in support[5..].iter().zip(expected) {
            let found = support.prior_sigma.expect("a prior");
            assert!((found / expected - 1.0).abs() < 1e-9, "{found} {expected}");
            assert!(support.data_share > 0.0 && support.data_share < 1.0);
        }

        // A parameter that the data do not show stays at its prior; without a prior, there is no covariance.
        let mut blind = jacobian.clone();
        blind.view_mut((0, 4), (3 * POSES, 1)).fill(0.0);
        let uncertainty = Uncertainty::new(&blind, 3 * POSES, &ids).expect("the prior holds it");
        assert!(uncertainty.data_covariance().is_none());
        let support = uncertainty.support()[4];
        assert!(support.data_share < 1e-12 && support.noise_part < 1e-7 * support.sigma, "{support:?}");
        blind[(3 * POSES, 4)] = 0.0;
        assert!(Uncertainty::new(&blind, 3 * POSES, &ids).is_none());
        blind[(0, 0)] = f64::NAN;
        assert!(Uncertainty::new(&blind, 3 * POSES, &ids).is_none());
    }

    /// A prior on the sum of two parameters holds neither.
    #[test]
    fn a_prior_on_a_combination_leaves_its_members_free() {
        let p = DMatrix::from_row_slice(3, 3, &[4.0, 4.0, 0.0, 4.0, 4.0, 0.0, 0.0, 0.0, 9.0]);
        let sigmas = marginal_sigmas(&p);
        assert_eq!(sigmas[..2], [None, None]);
        assert!((sigmas[2].expect("held") - 1.0 / 3.0).abs() < 1e-15);
        assert_eq!(marginal_sigmas(&DMatrix::zeros(2, 2)), [None, None]);
    }

    /// Compared with fits that actually leave out the pose.
    #[test]
    fn influence_is_what_leaving_the_pose_out_does() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let (jacobian, ids) = system(&mut rng);
        let right = DVector::from_fn(jacobian.nrows(), |_, _| -> f64 { StandardNormal.sample(&mut rng) });
        let x = solve(&jacobian, &right);
        let residuals = &right - &jacobian * &x;
        let uncertainty = Uncertainty::new(&jacobian, 3 * POSES, &ids).expect("full rank");
        let influences = uncertainty.influences(&jacobian, residuals.as_slice(), 3 * POSES, &[]);
        assert_eq!(influences.len(), POSES);
        let information = jacobian.tr_mul(&jacobian);
        for (i, influence) in influences.iter().enumerate() {
            let fitted = jacobian.clone().remove_rows(3 * i, 3);
            let without = solve(&fitted, &right.clone().remove_rows(3 * i, 3));
            let left_out = right.rows(3 * i, 3) - jacobian.rows(3 * i, 3) * &without;
            let found = influence.left_out.expect("others determine all");
            assert!((found - left_out).norm() < 1e-9, "{i}");
            let moved = &x - without;
            let cook = moved.dot(&(&information * &moved)) / 7.0;
            assert!((influence.cook.expect("a distance") - cook).abs() < 1e-9 * cook, "{i}");
            assert!(influence.chi2.expect("a statistic") >= residuals.rows(3 * i, 3).norm_squared());
        }
        let leverage: f64 = influences.iter().map(|i| i.leverage).sum();
        assert!((leverage - uncertainty.effective_parameters()).abs() < 1e-9);
    }

    /// Random sessions: the truth is drawn from the prior, the readings from their noise. Estimates, predicted positions and standardised residuals
    /// scatter as stated, and as the bound allows.
    #[test]
    fn drawn_estimates_scatter_as_stated() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let (jacobian, ids) = system(&mut rng);
        let uncertainty = Uncertainty::new(&jacobian, 3 * POSES, &ids).expect("full rank");
        let point = PositionJacobian::from_fn(7, |_, j| {
            let drawn: f64 = StandardNormal.sample(&mut rng);
            drawn * jacobian.column(j).norm()
        });
        let stated = uncertainty.position_covariance(&point).expect("its parameters");
        let trials = 4000;
        let (mut position, mut chi2, mut standardised) = (Vector3::zeros(), 0.0, 0.0);
        for _ in 0..trials {
            // Errors of readings and of priors: the estimate's error is linear in them.
            let errors =
                DVector::from_fn(jacobian.nrows(), |_, _| -> f64 { StandardNormal.sample(&mut rng) });
            let x = uncertainty.covariance() * jacobian.tr_mul(&errors);
            let moved = &point * &x;
            position += moved.component_mul(&moved);
            let residuals = errors - &jacobian * x;
            let first = uncertainty.influences(&jacobian, residuals.as_slice(), 3 * POSES, &[])[0];
            chi2 += first.chi2.expect("others determine all");
            standardised += first.standardised[1].powi(2);
        }
        let band = |dof: usize| {
            let n = dof as f64;
            (chi2_quantile(0.000_5, n) / n, chi2_quantile(0.999_5, n) / n)
        };
        let within = |ratio: f64, dof: usize| {
            let (low, high) = band(dof);
            assert!(ratio > low && ratio < high, "{ratio} not in {low}..{high}");
        };
        for axis in 0..3 {
            within(position[axis] / (trials as f64 * stated[(axis, axis)]), trials);
        }
        within(chi2 / (3 * trials) as f64, 3 * trials);
        within(standardised / trials as f64, trials);
    }

    #[test]
    fn bounds_are_the_covariance_of_a_linear_model_and_the_mean_information_of_another() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let (jacobian, ids) = system(&mut rng);
        let data = jacobian.rows(0, 3 * POSES).into_owned();
        let prior = jacobian.rows(3 * POSES, 3).into_owned();
        let uncertainty = Uncertainty::new(&jacobian, 3 * POSES, &ids).expect("full rank");
        let same = |a: &DMatrix<f64>, b: &DMatrix<f64>| {
            let worst = (0..7).map(|i| (a[(i, i)] / b[(i, i)] - 1.0).abs()).fold(0.0, f64::max);
            assert!(worst < 1e-9, "{worst}");
        };
        let bound = cramer_rao_bound(&data, &ids).expect("full rank");
        same(&bound, uncertainty.data_covariance().expect("full rank"));
        let bayesian =
            bayesian_cramer_rao_bound([&data, &data].into_iter(), &prior, &ids).expect("full rank");
        same(&bayesian, uncertainty.covariance());
        assert!(cramer_rao_bound(&prior, &ids).is_none());

        // y = x² + noise with x drawn from the standard normal distribution: the mean of (2x)² is 4, so the bound is 1/5. The points are those of
        // three-point Gauss-Hermite quadrature, exact here, with weights 1/6, 4/6, 1/6.
        let at = |x: f64| DMatrix::from_element(1, 1, 2.0 * x);
        let root = 3.0_f64.sqrt();
        let points = [at(root), at(-root), at(0.0), at(0.0), at(0.0), at(0.0)];
        let bound =
            bayesian_cramer_rao_bound(points.iter(), &DMatrix::identity(1, 1), &ids[..1]).expect("a prior");
        assert!((bound[(0, 0)] - 0.2).abs() < 1e-12, "{bound}");
    }
}
