//! Numerical rank of a system whose columns are scaled to unit norm.

use nalgebra::{DMatrix, DVector};

use super::{DependentGroup, Spectrum, WeakDirection};
use crate::identification::factor::triangular_factor_of_all;
use calibrig_model::ParameterId;

/// A scaled singular value below this fraction of the largest counts as zero. Exact dependence leaves some 1e-15; the weakest direction that data
/// are known to determine has 1e-6.
pub const RANK_TOLERANCE: f64 = 1e-8;

/// A scaled singular value below this fraction of the largest makes its direction weak: such a direction is kept and reported.
pub const WEAK_TOLERANCE: f64 = 1e-3;

/// A column below this fraction of the largest one is rounding error, which scaling would amplify.
const NEGLIGIBLE_COLUMN: f64 = 1e-12;

/// A member of a dependent group has a scaled coefficient above this.
const NEGLIGIBLE_COEFFICIENT: f64 = 1e-6;

/// A member of a weak direction has a weight above this fraction of the largest.
const LEADING_WEIGHT: f64 = 0.15;

/// Most members by which a direction is described.
const MOST_MEMBERS: usize = 6;

/// Most iterations of a singular value decomposition, which needs about two per column.
const SVD_ITERATIONS: usize = 10_000;

/// Spectrum of the columns of `jacobian` (rows x n, weighted, priors included), one per parameter.
pub(crate) fn analyse_columns(jacobian: &DMatrix<f64>, parameters: &[ParameterId]) -> Spectrum {
    analyse_r(&triangular_factor(jacobian), parameters)
}

/// Spectrum from the triangular factor `r` of the system (n x n, or any matrix with the same `rᵀ r`), one column per parameter.
pub(crate) fn analyse_r(r: &DMatrix<f64>, parameters: &[ParameterId]) -> Spectrum {
    let n = r.ncols();
    if n == 0 {
        return Spectrum { condition: 1.0, ..Spectrum::default() };
    }
    let scaled = ScaledColumns::new(r);
    let Some(singular_values) = scaled.singular_values() else {
        return Spectrum {
            condition: f64::INFINITY,
            singular_values: vec![f64::NAN; n],
            ..Spectrum::default()
        };
    };
    let largest = singular_values[0];
    let rank = singular_values.iter().filter(|s| **s > RANK_TOLERANCE * largest).count();
    let smallest = singular_values[n - 1];
    let condition = if rank == n { largest / smallest } else { f64::INFINITY };
    // Singular vectors are expensive and computed only where there is something to report.
    let weak = if rank > 0 && singular_values[rank - 1] < WEAK_TOLERANCE * largest {
        weak_directions(&scaled, rank, parameters)
    } else {
        Vec::new()
    };
    let dependent = if rank == n { Vec::new() } else { dependent_groups(&scaled, rank, parameters) };
    Spectrum { rank, condition, singular_values, weak, dependent }
}

/// The largest set of independent columns of `jacobian` (rows x n) that prefers earlier ones, and the dependence of each left-out column.
///
/// A column is left out if less than [`RANK_TOLERANCE`] of it, scaled to unit norm, is orthogonal to the columns kept before it.
pub(crate) fn select_independent(
    jacobian: &DMatrix<f64>,
    parameters: &[ParameterId],
) -> (Vec<usize>, Vec<DependentGroup>) {
    let scaled = ScaledColumns::new(&triangular_factor(jacobian));
    select(&scaled, &[RANK_TOLERANCE], parameters)
}

/// Selects in one round per tolerance: first the columns whose independent part exceeds `tolerances[0]`, then, of the rest, those that exceed the
/// next.
pub(super) fn select_in_rounds(
    jacobian: &DMatrix<f64>,
    tolerances: &[f64],
    parameters: &[ParameterId],
) -> (Vec<usize>, Vec<DependentGroup>) {
    select(&ScaledColumns::new(&triangular_factor(jacobian)), tolerances, parameters)
}

/// How well a combination of parameters (`direction`, SI) is determined: the inverse of its standard deviation for unit noise, with
/// the combination scaled to unit norm, over the largest scaled singular value. For a singular vector, its relative singular value.
pub(super) fn determination(jacobian: &DMatrix<f64>, direction: &[f64]) -> f64 {
    let scaled = ScaledColumns::new(&triangular_factor(jacobian));
    let weights = DVector::from_iterator(
        direction.len(),
        direction.iter().zip(&scaled.norms).map(|(p, norm)| p * norm),
    );
    let Some((singular_values, vectors)) = scaled.right_singular_vectors() else { return 0.0 };
    let largest = singular_values[0];
    if weights.norm() <= 0.0 || largest <= 0.0 {
        return 0.0;
    }
    let in_vectors = vectors * weights.normalize();
    let variance: f64 =
        in_vectors.iter().zip(&singular_values).map(|(w, s)| (w / (s / largest).max(1e-15)).powi(2)).sum();
    variance.sqrt().recip()
}

/// The triangular factor: it has the column norms and singular values of the whole matrix, but is small.
fn triangular_factor(jacobian: &DMatrix<f64>) -> DMatrix<f64> {
    if jacobian.nrows() > jacobian.ncols() && jacobian.ncols() > 0 {
        triangular_factor_of_all(jacobian.as_view())
    } else {
        jacobian.clone()
    }
}

/// A system whose columns are divided by their norms, with at least as many rows as columns.
struct ScaledColumns {
    matrix: DMatrix<f64>,
    /// Column norms; zero where the column is negligible, and then also zero in the matrix.
    norms: Vec<f64>,
}

impl ScaledColumns {
    fn new(r: &DMatrix<f64>) -> Self {
        let mut matrix = r.clone();
        if matrix.nrows() < matrix.ncols() {
            let n = matrix.ncols();
            matrix = matrix.resize_vertically(n, 0.0);
        }
        let mut norms: Vec<f64> = matrix.column_iter().map(|c| c.norm()).collect();
        let largest = norms.iter().copied().fold(0.0, f64::max);
        for (mut column, norm) in matrix.column_iter_mut().zip(&mut norms) {
            if *norm <= NEGLIGIBLE_COLUMN * largest {
                *norm = 0.0;
                column.fill(0.0);
            } else {
                column /= *norm;
            }
        }
        Self { matrix, norms }
    }

    fn is_finite(&self) -> bool {
        self.matrix.iter().all(|v| v.is_finite())
    }

    /// Singular values, largest first.
    fn singular_values(&self) -> Option<Vec<f64>> {
        if !self.is_finite() {
            return None;
        }
        let svd = self.matrix.clone().try_svd(false, false, 5.0 * f64::EPSILON, SVD_ITERATIONS)?;
        Some(svd.singular_values.iter().copied().collect())
    }

    /// Singular values, largest first, and the right singular vectors as rows.
    fn right_singular_vectors(&self) -> Option<(Vec<f64>, DMatrix<f64>)> {
        if self.matrix.is_empty() || !self.is_finite() {
            return None;
        }
        let svd = self.matrix.clone().try_svd(false, true, 5.0 * f64::EPSILON, SVD_ITERATIONS)?;
        Some((svd.singular_values.iter().copied().collect(), svd.v_t?))
    }
}

fn weak_directions(scaled: &ScaledColumns, rank: usize, parameters: &[ParameterId]) -> Vec<WeakDirection> {
    let Some((singular_values, vectors)) = scaled.right_singular_vectors() else { return Vec::new() };
    let largest = singular_values[0];
    (0..rank)
        .filter(|i| singular_values[*i] < WEAK_TOLERANCE * largest)
        .map(|i| WeakDirection {
            singular_value: singular_values[i] / largest,
            members: leading_members(parameters, vectors.row(i).iter().copied()),
        })
        .collect()
}

fn leading_members(
    parameters: &[ParameterId],
    weights: impl Iterator<Item = f64>,
) -> Vec<(ParameterId, f64)> {
    let mut members: Vec<_> = parameters.iter().copied().zip(weights).collect();
    members.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
    let Some(&(_, first)) = members.first() else { return members };
    members.truncate(MOST_MEMBERS);
    members.retain(|(_, weight)| weight.abs() >= LEADING_WEIGHT * first.abs());
    for (_, weight) in &mut members {
        *weight *= first.signum();
    }
    members
}

/// As many groups as the rank lacks: for a singular value close to the threshold, a coarser orthogonalisation may be needed to find its group.
fn dependent_groups(scaled: &ScaledColumns, rank: usize, parameters: &[ParameterId]) -> Vec<DependentGroup> {
    let mut tolerance = RANK_TOLERANCE;
    loop {
        let (kept, groups) = select(scaled, &[tolerance], parameters);
        if kept.len() <= rank || tolerance > 0.1 {
            return groups;
        }
        tolerance *= 3.0;
    }
}

fn select(
    scaled: &ScaledColumns,
    tolerances: &[f64],
    parameters: &[ParameterId],
) -> (Vec<usize>, Vec<DependentGroup>) {
    let mut basis = Basis::new(scaled);
    let mut left: Vec<usize> = (0..scaled.matrix.ncols()).collect();
    for tolerance in tolerances {
        left.retain(|column| !basis.take(*column, *tolerance));
    }
    let groups = left.iter().map(|column| basis.group(*column, parameters)).collect();
    let mut kept = basis.kept;
    kept.sort_unstable();
    (kept, groups)
}

/// The columns kept so far, orthogonalised.
struct Basis<'a> {
    scaled: &'a ScaledColumns,
    /// Columns in the order in which they were taken.
    kept: Vec<usize>,
    orthonormal: Vec<DVector<f64>>,
    /// Coordinates of every kept column in the orthonormal vectors up to its own.
    coordinates: Vec<Vec<f64>>,
}

impl<'a> Basis<'a> {
    fn new(scaled: &'a ScaledColumns) -> Self {
        Self { scaled, kept: Vec::new(), orthonormal: Vec::new(), coordinates: Vec::new() }
    }

    /// Coordinates of a column in the basis, and the remainder.
    fn split(&self, column: usize) -> (Vec<f64>, DVector<f64>) {
        let mut rest = self.scaled.matrix.column(column).into_owned();
        let mut coordinates = vec![0.0; self.orthonormal.len()];
        // Twice is enough: W. Kahan, in B. N. Parlett, The Symmetric Eigenvalue Problem (1980), section 6-9.
        for _ in 0..2 {
            for (coordinate, q) in coordinates.iter_mut().zip(&self.orthonormal) {
                let along = q.dot(&rest);
                rest.axpy(-along, q, 1.0);
                *coordinate += along;
            }
        }
        (coordinates, rest)
    }

    fn take(&mut self, column: usize, tolerance: f64) -> bool {
        let (mut coordinates, rest) = self.split(column);
        let norm = rest.norm();
        if norm.is_nan() || norm <= tolerance {
            return false;
        }
        coordinates.push(norm);
        self.kept.push(column);
        self.orthonormal.push(rest / norm);
        self.coordinates.push(coordinates);
        true
    }

    /// Regression of a column that was not taken on those that were.
    fn group(&self, column: usize, parameters: &[ParameterId]) -> DependentGroup {
        let (mut coefficients, rest) = self.split(column);
        for k in (0..coefficients.len()).rev() {
            coefficients[k] /= self.coordinates[k][k];
            let (before, from_k) = coefficients.split_at_mut(k);
            for (c, along) in before.iter_mut().zip(&self.coordinates[k]) {
                *c -= from_k[0] * along;
            }
        }
        let length = (1.0 + coefficients.iter().map(|c| c * c).sum::<f64>()).sqrt();
        let norms = &self.scaled.norms;
        let mut members: Vec<_> = self
            .kept
            .iter()
            .zip(&coefficients)
            .filter(|(_, c)| c.abs() > NEGLIGIBLE_COEFFICIENT)
            .map(|(kept, c)| (*kept, c * norms[column] / norms[*kept]))
            .collect();
        members.sort_unstable_by_key(|(kept, _)| *kept);
        DependentGroup {
            redundant: parameters[column],
            with: members.into_iter().map(|(kept, c)| (parameters[kept], c)).collect(),
            singular_value: rest.norm() / length,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_model::random::{StreamSource, stream};
    use rand::RngExt;

    fn random_matrix(rows: usize, columns: usize, trial: u32) -> DMatrix<f64> {
        let mut rng = stream(7, trial, StreamSource::AsBuilt);
        DMatrix::from_fn(rows, columns, |_, _| rng.random_range(-1.0..1.0))
    }

    fn ids(count: usize) -> Vec<ParameterId> {
        ParameterId::all_of_links(count.div_ceil(5)).into_iter().take(count).collect()
    }

    #[test]
    fn the_spectrum_is_that_of_the_scaled_normal_matrix() {
        for trial in 0..10 {
            let n = 3 + 3 * trial as usize;
            let mut jacobian = random_matrix(120, n, trial);
            jacobian.column_mut(0).scale_mut(1e5);
            jacobian.column_mut(n - 1).scale_mut(1e-5);
            let spectrum = analyse_columns(&jacobian, &ids(n));
            let mut scaled = jacobian.clone();
            for mut column in scaled.column_iter_mut() {
                column.normalize_mut();
            }
            let mut squares: Vec<f64> =
                (scaled.transpose() * scaled).symmetric_eigenvalues().iter().copied().collect();
            squares.sort_by(|a, b| b.total_cmp(a));
            for (value, square) in spectrum.singular_values.iter().zip(&squares) {
                assert!((value * value - square).abs() < 1e-12, "trial {trial}");
            }
            assert_eq!(spectrum.rank, n);
            assert!((spectrum.condition - (squares[0] / squares[n - 1]).sqrt()).abs() < 1e-9);
            assert!(spectrum.weak.is_empty() && spectrum.dependent.is_empty());
            let of_r = analyse_r(&jacobian.qr().unpack_r(), &ids(n));
            for (a, b) in of_r.singular_values.iter().zip(&spectrum.singular_values) {
                assert!((a - b).abs() < 1e-13);
            }
        }
    }

    #[test]
    fn a_planted_dependence_is_found_with_its_coefficients_and_a_planted_weakness_is_named() {
        let mut jacobian = random_matrix(60, 8, 1);
        let combination = 2.0 * jacobian.column(1) - 300.0 * jacobian.column(4);
        jacobian.set_column(6, &combination);
        let nearly = jacobian.column(0) * 3.0 + 1e-5 * jacobian.column(7);
        jacobian.set_column(7, &nearly);
        let ids = ids(8);
        let (kept, groups) = select_independent(&jacobian, &ids);
        assert_eq!(kept, [0, 1, 2, 3, 4, 5, 7]);
        let spectrum = analyse_columns(&jacobian, &ids);
        assert_eq!(spectrum.rank, 7);
        assert!(spectrum.condition.is_infinite());
        for groups in [&groups, &spectrum.dependent] {
            assert_eq!(groups.len(), 1);
            assert_eq!(groups[0].redundant, ids[6]);
            let [(first, two), (second, minus)] = groups[0].with[..] else { panic!("{:?}", groups[0].with) };
            assert_eq!((first, second), (ids[1], ids[4]));
            assert!((two - 2.0).abs() < 1e-9 && (minus + 300.0).abs() < 1e-9);
            assert!(groups[0].singular_value < 1e-14);
        }
        let [weak] = &spectrum.weak[..] else { panic!("{:?}", spectrum.weak) };
        assert!((1e-7..1e-5).contains(&weak.singular_value));
        let members: Vec<_> = weak.members.iter().map(|(id, _)| *id).collect();
        assert!(members.len() == 2 && members.contains(&ids[0]) && members.contains(&ids[7]));
        assert!(weak.members[0].1 > 0.0 && weak.members[1].1 < 0.0);
    }

    #[test]
    fn determination_of_a_singular_vector_is_its_singular_value() {
        let jacobian = random_matrix(40, 6, 2);
        let scaled = ScaledColumns::new(&triangular_factor(&jacobian));
        let (values, vectors) = scaled.right_singular_vectors().expect("a decomposition");
        for (i, value) in values.iter().enumerate() {
            let direction: Vec<f64> =
                vectors.row(i).iter().zip(&scaled.norms).map(|(v, norm)| v / norm).collect();
            assert!((determination(&jacobian, &direction) - value / values[0]).abs() < 1e-12);
        }
    }

    #[test]
    fn rounding_error_is_no_column() {
        let mut jacobian = random_matrix(30, 4, 3);
        let noise = jacobian.column(3) * 1e-16;
        jacobian.set_column(2, &noise);
        let spectrum = analyse_columns(&jacobian, &ids(4));
        assert_eq!(spectrum.rank, 3);
        assert_eq!(spectrum.dependent[0].redundant, ids(4)[2]);
        assert!(spectrum.dependent[0].with.is_empty());
    }

    #[test]
    fn a_system_that_is_empty_short_or_not_finite_is_reported_as_such() {
        let nothing = analyse_columns(&DMatrix::zeros(10, 0), &[]);
        assert_eq!((nothing.rank, nothing.condition), (0, 1.0));
        for rows in [0, 1, 2, 5] {
            let spectrum = analyse_columns(&random_matrix(rows, 5, 4), &ids(5));
            assert_eq!(spectrum.rank, rows);
            assert_eq!(spectrum.singular_values.len(), 5);
            assert_eq!(spectrum.dependent.len(), 5 - rows);
        }
        let zero = analyse_columns(&DMatrix::zeros(10, 3), &ids(3));
        assert_eq!((zero.rank, zero.dependent.len()), (0, 3));
        for bad in [f64::NAN, f64::INFINITY] {
            let mut jacobian = random_matrix(10, 3, 5);
            jacobian[(4, 1)] = bad;
            let spectrum = analyse_columns(&jacobian, &ids(3));
            assert_eq!(spectrum.rank, 0);
            assert!(spectrum.condition.is_infinite());
            assert!(spectrum.singular_values.iter().all(|s| s.is_nan()));
            // Only finite columns can be kept, and the call must return.
            let (kept, _) = select_independent(&jacobian, &ids(3));
            assert!(kept.len() < 3);
        }
    }
}
