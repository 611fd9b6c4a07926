//! Whether identifying a parameter makes held-out poses better or worse, by nested fits of a linearised system.

use nalgebra::{DMatrix, DVector, Vector3};

use super::{Interval, Split, paired_rms_difference};
use crate::identification::Linearisation;
use crate::identification::triangular_factor_of_all;

/// A fit, linearised at its end, whose observations are held out in parts.
#[derive(Debug, Clone)]
pub struct NestedFits<'a> {
    system: &'a Linearisation,
    /// Differences of the parameters from their prior means at the end of the fit.
    values: &'a [f64],
    /// Columns that are free; parameters at a bound stay there.
    free: Vec<usize>,
    splits: &'a [Split],
    /// Pose number of every observation.
    poses: &'a [u32],
    /// Square root of every observation's weight.
    weights: Vec<f64>,
    /// Triangular factor of each part's rows, the residuals in the last column.
    parts: Vec<DMatrix<f64>>,
    with: Vec<Vector3<f64>>,
}

impl<'a> NestedFits<'a> {
    /// Nested fits of `system` at `values`, with the columns `bounded` held, the observations' robust `weights` (empty where all count the same) and
    /// the number of every observation's pose. Each observation is held out in one split. `None` where the sizes do not fit together, or where all
    /// but one part do not determine the parameters.
    pub fn new(
        system: &'a Linearisation,
        values: &'a [f64],
        bounded: &[usize],
        weights: &[f64],
        poses: &'a [u32],
        splits: &'a [Split],
    ) -> Option<Self> {
        let (observations, n) =
            ((system.data_rows / 3).saturating_sub(system.orientations.len()), system.jacobian.ncols());
        let held_out: usize = splits.iter().map(|split| split.held_out.len()).sum();
        let fits = poses.len() == observations
            && system.whitening.observations() == observations
            && values.len() == n
            && held_out == observations
            && splits.len() > 1;
        if !fits || system.jacobian.iter().chain(&system.residuals).any(|v| !v.is_finite()) {
            return None;
        }
        let weights: Vec<_> =
            (0..observations).map(|i| weights.get(i).map_or(1.0, |w| w.max(0.0).sqrt())).collect();
        let part = |split: &Split| {
            // An orientation is held out together with its observation.
            let turned = system.orientations.iter().enumerate().filter(|(_, i)| split.held_out.contains(i));
            let blocks = split.held_out.iter().map(|i| (*i, *i));
            let blocks: Vec<_> = blocks.chain(turned.map(|(turn, i)| (observations + turn, *i))).collect();
            let mut rows = DMatrix::zeros(3 * blocks.len(), n + 1);
            for (place, (block, i)) in blocks.iter().enumerate() {
                rows.view_mut((3 * place, 0), (3, n))
                    .copy_from(&(system.jacobian.rows(3 * block, 3) * weights[*i]));
                rows.view_mut((3 * place, n), (3, 1))
                    .copy_from(&(system.residuals.rows(3 * block, 3) * weights[*i]));
            }
            triangular_factor_of_all(rows.as_view())
        };
        let mut nested = Self {
            system,
            values,
            free: (0..n).filter(|column| !bounded.contains(column)).collect(),
            splits,
            poses,
            parts: splits.iter().map(part).collect(),
            weights,
            with: Vec::new(),
        };
        nested.with = nested.held_out(&[])?;
        Some(nested)
    }

    /// By how much the RMS of held-out poses, m, is smaller with the parameters in the columns `group` identified than with them at their prior
    /// means, with its interval of confidence `level`; pairs are formed by pose, not by observation. `None` where the other parameters are not
    /// determined.
    pub fn gain(&self, group: &[usize], level: f64) -> Option<Interval> {
        paired_by_pose(&self.held_out(group)?, &self.with, self.poses, level)
    }

    /// The errors of all observations, m, each from a fit without this observation, with `group` at its prior means.
    fn held_out(&self, group: &[usize]) -> Option<Vec<Vector3<f64>>> {
        let Linearisation { jacobian, residuals, data_rows, whitening, .. } = self.system;
        let n = jacobian.ncols();
        let columns: Vec<usize> = self.free.iter().copied().filter(|c| !group.contains(c)).collect();
        // Parameters that are not fitted stay at their prior means.
        let mut held = DVector::zeros(n);
        for column in group {
            held[*column] = -self.values[*column];
        }
        let first = *data_rows;
        let priors = jacobian.nrows() - first;
        let mut of_priors = jacobian.rows(first, priors).insert_column(n, 0.0);
        of_priors.column_mut(n).copy_from(&residuals.rows(first, priors));
        let mut rows = DVector::zeros(*data_rows);
        for (fold, split) in self.splits.iter().enumerate() {
            let others =
                self.parts.iter().enumerate().filter(|(part, _)| *part != fold).map(|(_, part)| part);
            let blocks: Vec<&DMatrix<f64>> = others.chain([&of_priors]).collect();
            let mut system = DMatrix::zeros(blocks.iter().map(|b| b.nrows()).sum(), columns.len() + 1);
            let mut row = 0;
            for block in blocks {
                let count = block.nrows();
                for (place, column) in columns.iter().enumerate() {
                    system.view_mut((row, place), (count, 1)).copy_from(&block.column(*column));
                }
                let right = block.column(n) + block.columns(0, n) * &held;
                system.view_mut((row, columns.len()), (count, 1)).copy_from(&right);
                row += count;
            }
            let mut step = held.clone();
            let solved = minimum(&system)?;
            for (column, value) in columns.iter().zip(&solved) {
                step[*column] = *value;
            }
            for i in &split.held_out {
                let error = residuals.rows(3 * i, 3) + jacobian.rows(3 * i, 3) * &step;
                rows.rows_mut(3 * i, 3).copy_from(&error);
            }
        }
        let mut errors = whitening.displacements(&rows);
        for (error, weight) in errors.iter_mut().zip(&self.weights) {
            *error *= *weight;
        }
        errors.iter().all(|error| error.iter().all(|v| v.is_finite())).then_some(errors)
    }
}

/// RMS by pose of the errors `a` less that of `b`, as in [`paired_rms_difference`].
pub fn paired_by_pose(a: &[Vector3<f64>], b: &[Vector3<f64>], poses: &[u32], level: f64) -> Option<Interval> {
    let lengths = |errors: &[Vector3<f64>]| {
        let mut of_poses: Vec<(u32, f64, f64)> = Vec::new();
        let mut places = std::collections::BTreeMap::new();
        for (pose, error) in poses.iter().zip(errors) {
            let place = *places.entry(*pose).or_insert_with(|| {
                of_poses.push((*pose, 0.0, 0.0));
                of_poses.len() - 1
            });
            of_poses[place].1 += error.norm_squared();
            of_poses[place].2 += 1.0;
        }
        of_poses.into_iter().map(|(_, squares, n)| Vector3::x() * (squares / n).sqrt()).collect::<Vec<_>>()
    };
    paired_rms_difference(&lengths(a), &lengths(b), level)
}

/// The `x` that minimises `|A x + b|`, where b is the last column of the system.
fn minimum(system: &DMatrix<f64>) -> Option<Vec<f64>> {
    let n = system.ncols() - 1;
    let r = triangular_factor_of_all(system.as_view());
    if r.nrows() < n {
        return None;
    }
    let right = -r.view((0, n), (n, 1)).into_owned();
    let step = r.view((0, 0), (n, n)).into_owned().solve_upper_triangular(&right)?;
    step.iter().all(|v| v.is_finite()).then(|| step.iter().copied().collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::k_fold;
    use crate::identification::Whitening;
    use nalgebra::Matrix3;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    const OBSERVATIONS: usize = 60;

    /// A linear fit of `y` on `basis` with a prior of `sigma` on the last columns, solved at its minimum.
    fn fitted(
        basis: &DMatrix<f64>,
        y: &DVector<f64>,
        priors: usize,
        sigma: f64,
    ) -> (Linearisation, Vec<f64>) {
        let n = basis.ncols();
        let mut a = basis.clone().resize_vertically(3 * OBSERVATIONS + priors, 0.0);
        let mut b = y.clone().resize_vertically(3 * OBSERVATIONS + priors, 0.0);
        for k in 0..priors {
            a[(3 * OBSERVATIONS + k, n - priors + k)] = 1.0 / sigma;
            b[3 * OBSERVATIONS + k] = 0.0;
        }
        let x = a.clone().svd(true, true).solve(&b, 1e-14).expect("a solution");
        let system = Linearisation {
            residuals: &a * &x - b,
            jacobian: a,
            data_rows: 3 * OBSERVATIONS,
            orientations: Vec::new(),
            measured_rows: 3 * OBSERVATIONS,
            poses: (0..OBSERVATIONS).map(|i| vec![i]).collect(),
            bounded: Vec::new(),
            whitening: Whitening::apart(vec![Matrix3::identity() * 2.0; OBSERVATIONS]),
        };
        (system, x.iter().copied().collect())
    }

    /// Held-out errors of fits that are actually repeated, with and without the last column.
    #[test]
    fn nested_fits_are_those_that_are_made_again() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let basis = DMatrix::from_fn(3 * OBSERVATIONS, 6, |_, _| rng.random_range(-1.0..1.0));
        let y = DVector::from_fn(3 * OBSERVATIONS, |_, _| StandardNormal.sample(&mut rng))
            + basis.column(5) * 0.4;
        let (system, values) = fitted(&basis, &y, 1, 0.5);
        let splits = k_fold(OBSERVATIONS, 10, &mut rng);
        let poses: Vec<u32> = (0..).take(OBSERVATIONS).collect();
        let nested = NestedFits::new(&system, &values, &[], &[], &poses, &splits).expect("a system");
        for (group, columns) in [(vec![], 6), (vec![5], 5)] {
            let found = nested.held_out(&group).expect("errors");
            for split in &splits {
                let rows: Vec<usize> = split.fitted.iter().flat_map(|i| 3 * i..3 * i + 3).collect();
                let mut a = basis.select_rows(&rows).columns(0, columns).into_owned();
                let mut b = y.select_rows(&rows);
                if columns == 6 {
                    a = a.insert_row(rows.len(), 0.0);
                    a[(rows.len(), 5)] = 2.0;
                    b = b.insert_row(rows.len(), 0.0);
                }
                let x = a.svd(true, true).solve(&b, 1e-14).expect("a solution");
                for i in &split.held_out {
                    let of = basis.rows(3 * i, 3).columns(0, columns).into_owned();
                    let expected = (of * &x - y.rows(3 * i, 3)) / 2.0;
                    assert!((found[*i] - expected).norm() < 1e-10, "{group:?} {i}");
                }
            }
        }
    }

    /// Columns with an effect make held-out poses better; many without one, with a prior that is far too wide, make them worse; both beyond chance.
    #[test]
    fn what_acts_is_better_and_what_does_not_is_worse() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let basis = DMatrix::from_fn(3 * OBSERVATIONS, 44, |_, _| rng.random_range(-1.0..1.0));
        let y = DVector::from_fn(3 * OBSERVATIONS, |_, _| StandardNormal.sample(&mut rng))
            + basis.column(3) * 2.0;
        let (system, values) = fitted(&basis, &y, 40, 100.0);
        let splits = k_fold(OBSERVATIONS, 10, &mut rng);
        let poses: Vec<u32> = (0..).take(OBSERVATIONS).collect();
        let nested = NestedFits::new(&system, &values, &[], &[], &poses, &splits).expect("a system");
        assert!(nested.gain(&[3], 0.95).expect("an interval").low > 0.0);
        let useless: Vec<usize> = (4..44).collect();
        let worse = nested.gain(&useless, 0.95).expect("an interval");
        assert!(worse.high < 0.0, "{worse:?}");
        assert!(NestedFits::new(&system, &values[1..], &[], &[], &poses, &splits).is_none());
        // A column that is held is not fitted in either of the two fits.
        let nested = NestedFits::new(&system, &values, &[3], &[], &poses, &splits).expect("a system");
        assert!(nested.gain(&useless, 0.95).is_some());
    }

    /// Three observations of a pose share its error: counted singly, there would seem to be three times as many as there are.
    #[test]
    fn poses_are_paired_not_observations() {
        let a: Vec<_> = (0..30).map(|i| Vector3::x() * f64::from(1 + i / 3 % 5)).collect();
        let b: Vec<_> = a.iter().map(|e| 0.9 * e).collect();
        let poses: Vec<u32> = (0..30).map(|i| i / 3).collect();
        let by_pose = paired_by_pose(&a, &b, &poses, 0.95).expect("poses");
        let once: Vec<usize> = (0..30).step_by(3).collect();
        let pick = |errors: &[Vector3<f64>]| once.iter().map(|i| errors[*i]).collect::<Vec<_>>();
        let expected = paired_rms_difference(&pick(&a), &pick(&b), 0.95).expect("poses");
        assert!((by_pose.low - expected.low).abs() < 1e-12 && (by_pose.high - expected.high).abs() < 1e-12);
    }
}
