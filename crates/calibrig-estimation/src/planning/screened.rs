//! Criteria of eigenvalues and of the worst pose, whose change by an exchange has no closed form. Candidates are ranked by their first-order effect
//! on the criterion and on a smooth one similar to it, and the first of both rankings are computed exactly.

use nalgebra::{Cholesky, DMatrix, DVector, SymmetricEigen};

use super::Criterion;
use super::space::DesignSpace;

/// Number of candidates of each ranking that are computed.
const COMPUTED: usize = 16;

/// Power of a variance, relative to the largest one, with which a pose of the region counts in the ranking: a smooth maximum.
const SHARPNESS: i32 = 8;

/// Least eigenvalue in the ranking, as a share of the largest.
const LEAST: f64 = 1e-12;

/// A design during the search.
#[derive(Debug, Clone)]
pub(super) struct Screened<'s> {
    space: &'s DesignSpace,
    criterion: Criterion,
    poses: usize,
    information: DMatrix<f64>,
    pub cost: f64,
}

impl<'s> Screened<'s> {
    pub fn new(space: &'s DesignSpace, criterion: Criterion, poses: usize) -> Self {
        Self { space, criterion, poses, information: DMatrix::zeros(0, 0), cost: f64::INFINITY }
    }

    /// Sets a design and computes everything anew.
    pub fn refresh(&mut self, design: &[usize]) -> bool {
        self.information = self.space.information(design);
        self.cost = self.cost_of(self.information.clone());
        self.cost.is_finite()
    }

    fn cost_of(&self, information: DMatrix<f64>) -> f64 {
        if self.criterion == Criterion::G {
            let Some(factor) = Cholesky::new(information) else { return f64::INFINITY };
            let variances = self.space.predicted(&factor.l().transpose());
            return variances.map_or(f64::INFINITY, |all| all.into_iter().fold(0.0, f64::max));
        }
        let eigenvalues = information.symmetric_eigenvalues();
        self.criterion.of_eigenvalues(eigenvalues.as_slice(), self.poses)
    }

    /// The information without one pose of the design.
    fn without(&self, leaving: Option<usize>) -> DMatrix<f64> {
        let mut rest = self.information.clone();
        if let Some(candidate) = leaving {
            let block = self.space.block(candidate);
            rest.gemm(-1.0, &block, &block.transpose(), 1.0);
        }
        rest
    }

    /// First-order effect of every candidate, the larger the better: on the criterion, and on one similar to it. Each is relative to the largest.
    pub fn orders(&self, leaving: Option<usize>) -> [Vec<f64>; 2] {
        let SymmetricEigen { eigenvalues, eigenvectors } = SymmetricEigen::new(self.without(leaving));
        let largest = eigenvalues.max().max(f64::MIN_POSITIVE);
        let eigenvalues = eigenvalues.map(|v| v.max(LEAST * largest));
        let (least, most) = (eigenvalues.imin(), eigenvalues.imax());
        let with = |weights: DVector<f64>| {
            &eigenvectors * DMatrix::from_diagonal(&weights) * eigenvectors.transpose()
        };
        let inverse = with(eigenvalues.map(f64::recip));
        let only = |place: usize, value: f64| {
            let mut weights = DVector::zeros(eigenvalues.len());
            weights[place] = value;
            weights
        };
        let sharp = match self.criterion {
            Criterion::G => self.of_region(&inverse, SHARPNESS),
            Criterion::O2 => {
                with(only(least, 1.0 / eigenvalues[least]) - only(most, 1.0 / eigenvalues[most]))
            }
            Criterion::O4 => {
                with(only(least, 1.0 / eigenvalues[least]) - only(most, 0.5 / eigenvalues[most]))
            }
            Criterion::O5 => with(eigenvalues.map(|v| v.powf(-1.5))),
            _ => with(only(least, 1.0)),
        };
        let smooth =
            if self.criterion == Criterion::G { self.of_region(&inverse, 0) } else { &inverse * &inverse };
        [sharp, smooth].map(|score| self.scores(&score))
    }

    /// `C W C` with W from the region's poses, each weighted by a power of its variance.
    fn of_region(&self, covariance: &DMatrix<f64>, power: i32) -> DMatrix<f64> {
        let mut region = covariance * &self.space.region;
        let of = |pose: usize| self.space.first_of_region[pose]..self.space.first_of_region[pose + 1];
        let variance = |pose: usize| {
            of(pose).map(|column| self.space.region.column(column).dot(&region.column(column))).sum::<f64>()
        };
        let variances: Vec<f64> = (0..self.space.region()).map(variance).collect();
        let largest = variances.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        for (pose, variance) in variances.iter().enumerate() {
            region.columns_range_mut(of(pose)).scale_mut((variance / largest).powi(power).sqrt());
        }
        &region * region.transpose()
    }

    /// Trace of the product of a symmetric matrix and every candidate's information.
    fn scores(&self, matrix: &DMatrix<f64>) -> Vec<f64> {
        let products = matrix * &self.space.rows;
        let of = |candidate: usize| {
            let columns = self.space.of(candidate);
            columns.map(|column| products.column(column).dot(&self.space.rows.column(column))).sum()
        };
        let scores: Vec<f64> = (0..self.space.candidates()).map(of).collect();
        let largest = scores.iter().fold(f64::MIN_POSITIVE, |most: f64, score| most.max(score.abs()));
        scores.into_iter().map(|score| score / largest).collect()
    }

    /// The cost with a candidate, in place of one of the design or added to it.
    pub fn cost_with(&self, leaving: Option<usize>, entering: usize) -> f64 {
        let mut information = self.without(leaving);
        let block = self.space.block(entering);
        information.gemm(1.0, &block, &block.transpose(), 1.0);
        self.cost_of(information)
    }
}

/// The `allowed` candidates to compute: the first of each ranking, which are the sums over all spaces.
pub(super) fn first_of(orders: &[Vec<f64>], allowed: impl Fn(usize) -> bool) -> Vec<usize> {
    let mut first = Vec::new();
    for order in orders {
        let mut places: Vec<usize> = (0..order.len()).filter(|candidate| allowed(*candidate)).collect();
        let better = |a: &usize, b: &usize| order[*b].total_cmp(&order[*a]).then(a.cmp(b));
        if places.len() > COMPUTED {
            places.select_nth_unstable_by(COMPUTED - 1, better);
            places.truncate(COMPUTED);
        }
        first.extend(places);
    }
    first.sort_unstable();
    first.dedup();
    first
}
