//! Sessions that are several in one: readings of several targets under one name, and a station that was moved between its readings.
//!
//! Either leaves residuals in a few compact groups, which nothing that a robot lacks in its model does. So an offset of the target (a
//! displacement of the station) is fitted for each group beside all parameters, to first order, and every reading goes to the group that
//! leaves less of it, by turns (S. P. Lloyd, "Least squares quantization in PCM", IEEE Trans. Inf. Theory 28 (1982) 129). It is told where
//! the residuals fall by more than those of one cloud can: a Gaussian one by a factor of 1.7 along one axis, the sines of a turning joint by
//! 2.3.

use std::ops::Range;

use nalgebra::{DMatrix, DVector, Matrix3, Matrix3x6, SymmetricEigen, Vector3, Vector6};

use super::Warning;
use super::contradiction::Minimum;
use super::problem::CalibrationProblem;
use super::solver::Solution;
use calibrig_model::ParameterId;
use calibrig_model::geometry::cross_matrix;
use calibrig_model::measurement::MeasurementSet;

/// Standard deviations that fall to this share are those of several sessions.
const SHARE: f64 = 0.25;
/// Groups that leave more than this share of the squares in them are not looked at any further.
const COMPACT: f64 = 0.5;
/// The fewest readings of a group.
const LEAST: usize = 4;
/// The fewest degrees of freedom beside parameters and the choice of the groups.
const LEAST_FREEDOM: f64 = 6.0;
const MOST_TURNS: usize = 12;

/// A reading at the solution.
struct Seen {
    /// `tracker_from_flange`, the axes alone.
    axes: Matrix3<f64>,
    /// Predicted position in the tracker's frame, m.
    predicted: Vector3<f64>,
    /// Predicted less measured, in the tracker's frame, m.
    off: Vector3<f64>,
}

/// The linear system at the solution, with all rows in standard deviations and no weights of a loss in them.
struct System<'a> {
    problem: &'a CalibrationProblem,
    jacobian: &'a DMatrix<f64>,
    residuals: &'a DVector<f64>,
    free: Vec<usize>,
    seen: Vec<Seen>,
    /// Sum of squares of the observations that the parameters leave, and its degrees of freedom.
    squares: f64,
    freedom: f64,
    /// RMS of the 3-D residual, m.
    rms: f64,
}

/// Warnings of what makes several sessions of one; `jacobian` is the solution's without the weights of a loss.
pub(super) fn divided(
    problem: &mut CalibrationProblem,
    solution: &Solution,
    jacobian: &DMatrix<f64>,
    bounded: &[usize],
    set: &MeasurementSet,
) -> Vec<Warning> {
    let Some(seen) = look(problem, &solution.x) else { return Vec::new() };
    let Some(system) = System::new(problem, solution, jacobian, bounded, seen) else { return Vec::new() };
    let mut warnings = Vec::new();
    for (target, stated) in set.targets.iter().enumerate() {
        let own = (0..system.seen.len()).filter(|i| problem.rows[*i].target == target).collect::<Vec<_>>();
        if let Some((targets, apart, share)) = system.several_targets(&own) {
            warnings.push(Warning::SeveralTargets {
                target: stated.name.clone(),
                targets,
                apart,
                rms: [system.rms, share * system.rms],
            });
        }
    }
    for (station, stated) in set.stations.iter().enumerate() {
        let own = (0..system.seen.len()).filter(|i| problem.rows[*i].station == station).collect::<Vec<_>>();
        if let Some((first, by, share)) = system.moved_station(&own) {
            warnings.push(Warning::StationMoved {
                station: stated.name.clone(),
                poses: [problem.rows[own[first - 1]].pose, problem.rows[own[first]].pose],
                by,
                rms: [system.rms, share * system.rms],
            });
        }
    }
    warnings
}

/// The readings at parameters `x`; `None` where the robot cannot take a pose.
fn look(problem: &mut CalibrationProblem, x: &[f64]) -> Option<Vec<Seen>> {
    problem.set(x);
    let now = &mut problem.current;
    let see = |row: &super::problem::Row| {
        now.machine.place(&row.told).ok()?;
        let in_base = now.machine.target(&now.targets[row.target]);
        let column = |axis| now.machine.column(ParameterId::Target { target: row.target, axis }, &in_base);
        let station = &now.stations[row.station];
        let axes = station.rotation.matrix() * Matrix3::from_columns(&[column(0), column(1), column(2)]);
        let predicted = station.rotation * in_base + station.translation.vector;
        Some(Seen { axes, predicted, off: predicted - row.seen })
    };
    problem.rows.iter().map(see).collect()
}

impl<'a> System<'a> {
    fn new(
        problem: &'a CalibrationProblem,
        solution: &'a Solution,
        jacobian: &'a DMatrix<f64>,
        bounded: &[usize],
        seen: Vec<Seen>,
    ) -> Option<Self> {
        let free: Vec<usize> = (0..jacobian.ncols()).filter(|column| !bounded.contains(column)).collect();
        let data = 3 * seen.len();
        let squares = if solution.weights.is_empty() {
            solution.residuals.rows(0, data).norm_squared()
        } else {
            // A loss has its minimum elsewhere.
            Minimum::of(&solution.residuals, jacobian, &free)?.residuals.rows(0, data).norm_squared()
        };
        let rms = (seen.iter().map(|seen| seen.off.norm_squared()).sum::<f64>() / seen.len() as f64).sqrt();
        let freedom = data as f64 - free.len() as f64;
        let is_fit = squares > 0.0 && squares.is_finite() && rms > 0.0;
        is_fit.then_some(Self {
            problem,
            jacobian,
            residuals: &solution.residuals,
            free,
            seen,
            squares,
            freedom,
            rms,
        })
    }

    /// What parameters and further `columns` leave (rows in standard deviations), and the values of those columns. The columns are given in
    /// metres in the trackers' axes, three rows an observation.
    fn with(&self, columns: &DMatrix<f64>) -> Option<(DVector<f64>, DVector<f64>)> {
        let (rows, n) = self.jacobian.shape();
        let mut columns = columns.clone().resize_vertically(rows, 0.0);
        self.problem.whiten(&mut DVector::zeros(rows), &mut columns);
        let mut jacobian = self.jacobian.clone().resize_horizontally(n + columns.ncols(), 0.0);
        jacobian.columns_mut(n, columns.ncols()).copy_from(&columns);
        let free: Vec<usize> = self.free.iter().copied().chain(n..n + columns.ncols()).collect();
        let minimum = Minimum::of(self.residuals, &jacobian, &free)?;
        let values = minimum.step.rows(self.free.len(), columns.ncols()).into_owned();
        Some((minimum.residuals, values))
    }

    /// To which share standard deviations fall that have these residuals, with so many parameters more and so many choices.
    fn share(&self, residuals: &DVector<f64>, parameters: usize, choices: usize) -> Option<f64> {
        let freedom = self.freedom - (parameters + choices) as f64;
        let squares = residuals.rows(0, 3 * self.seen.len()).norm_squared();
        let share = ((squares / freedom) / (self.squares / self.freedom)).sqrt();
        (freedom >= LEAST_FREEDOM && share < SHARE).then_some(share)
    }

    /// How many targets the readings `own` are of, how far these are apart (m), and to which share the residuals fall.
    fn several_targets(&self, own: &[usize]) -> Option<(usize, f64, f64)> {
        // In the flange's axes, where an offset is the same in all poses.
        let offs: Vec<_> = own.iter().map(|i| self.seen[*i].axes.tr_mul(&self.seen[*i].off)).collect();
        let mut groups = vec![0; own.len()];
        (2..=3).find_map(|count| {
            groups = split(&offs, &groups, count)?;
            self.as_targets(own, groups.clone(), count)
        })
    }

    fn as_targets(&self, own: &[usize], mut groups: Vec<usize>, count: usize) -> Option<(usize, f64, f64)> {
        let of_group = |groups: &[usize], group| groups.iter().filter(|own| **own == group).count();
        for _ in 0..MOST_TURNS {
            if (0..count).any(|group| of_group(&groups, group) < LEAST) {
                return None;
            }
            let mut columns = DMatrix::zeros(3 * self.seen.len(), 3 * (count - 1));
            for (i, group) in own.iter().zip(&groups).filter(|(_, group)| **group > 0) {
                columns.fixed_view_mut::<3, 3>(3 * i, 3 * (group - 1)).copy_from(&self.seen[*i].axes);
            }
            let (left, values) = self.with(&columns)?;
            let offset = |group: usize| match group {
                0 => Vector3::zeros(),
                _ => values.fixed_rows::<3>(3 * (group - 1)).into_owned(),
            };
            let nearest = |(i, now): (&usize, &usize)| {
                let axes = self.problem.rows[*i].whitening * self.seen[*i].axes;
                let own: Vector3<f64> = left.fixed_rows::<3>(3 * i).into_owned();
                let square = |group| (own - axes * (offset(*now) - offset(group))).norm_squared();
                (0..count).min_by(|a, b| square(*a).total_cmp(&square(*b))).unwrap_or(*now)
            };
            let next: Vec<usize> = own.iter().zip(&groups).map(nearest).collect();
            if next == groups {
                let share = self.share(&left, values.len(), own.len() * (count - 1))?;
                let pairs = (0..count).flat_map(|a| (0..a).map(move |b| (a, b)));
                let apart = pairs.map(|(a, b)| (offset(a) - offset(b)).norm()).fold(0.0, f64::max);
                return Some((count, apart, share));
            }
            groups = next;
        }
        None
    }

    /// The place among `own` from where on their station stood elsewhere, by how much that moved the points (m), and to which share the
    /// residuals fall.
    fn moved_station(&self, own: &[usize]) -> Option<(usize, f64, f64)> {
        let offs: Vec<_> = own.iter().map(|i| self.seen[*i].off).collect();
        let mut first = step(&offs)?;
        let displaced = |i: usize| {
            let mut columns = Matrix3x6::zeros();
            columns.fixed_columns_mut::<3>(0).copy_from(&Matrix3::identity());
            columns.fixed_columns_mut::<3>(3).copy_from(&-cross_matrix(&self.seen[i].predicted));
            columns
        };
        for _ in 0..MOST_TURNS {
            let mut columns = DMatrix::zeros(3 * self.seen.len(), 6);
            for i in &own[first..] {
                columns.fixed_view_mut::<3, 6>(3 * i, 0).copy_from(&displaced(*i));
            }
            let (left, values) = self.with(&columns)?;
            let by: Vector6<f64> = values.fixed_rows::<6>(0).into_owned();
            let mut gains = vec![0.0];
            for (place, i) in own.iter().enumerate() {
                let shift = self.problem.rows[*i].whitening * displaced(*i) * by;
                let now: Vector3<f64> = left.fixed_rows::<3>(3 * i).into_owned();
                let [before, behind] = if place < first { [now, now - shift] } else { [now + shift, now] };
                // Squares that are saved where the station moves behind this reading.
                gains.push(gains[place] + behind.norm_squared() - before.norm_squared());
            }
            let next = within(own.len()).max_by(|a, b| gains[*a].total_cmp(&gains[*b]))?;
            if next == first {
                let share = self.share(&left, 6, 2)?;
                let moved = own[first..].iter().map(|i| (displaced(*i) * by).norm()).sum::<f64>();
                return Some((first, moved / (own.len() - first) as f64, share));
            }
            first = next;
        }
        None
    }
}

/// Where a step may be: enough readings on both sides.
fn within(count: usize) -> Range<usize> {
    LEAST..(count + 1).saturating_sub(LEAST)
}

fn squares_about_mean(points: &[Vector3<f64>]) -> f64 {
    let mean = points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
    points.iter().map(|point| (point - mean).norm_squared()).sum()
}

/// One group more: the one with the largest sum of squares is parted along the axis along which it is longest, and all are brought to rest.
/// `None` where the groups are not compact.
fn split(points: &[Vector3<f64>], groups: &[usize], count: usize) -> Option<Vec<usize>> {
    let of = |group: usize| -> Vec<Vector3<f64>> {
        points.iter().zip(groups).filter(|(_, own)| **own == group).map(|(point, _)| *point).collect()
    };
    let largest =
        (0..count - 1).max_by(|a, b| squares_about_mean(&of(*a)).total_cmp(&squares_about_mean(&of(*b))))?;
    let members = of(largest);
    let mean = members.iter().sum::<Vector3<f64>>() / members.len().max(1) as f64;
    let spread: Matrix3<f64> = members.iter().map(|point| (point - mean) * (point - mean).transpose()).sum();
    if spread.iter().any(|entry| !entry.is_finite()) {
        return None;
    }
    let eigen = SymmetricEigen::new(spread);
    let longest = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
    let mut groups: Vec<usize> = points
        .iter()
        .zip(groups)
        .map(
            |(point, group)| {
                if *group == largest && (point - mean).dot(&longest) > 0.0 { count - 1 } else { *group }
            },
        )
        .collect();
    for _ in 0..MOST_TURNS {
        let mut centres = vec![(Vector3::zeros(), 0.0); count];
        for (point, group) in points.iter().zip(&groups) {
            centres[*group].0 += point;
            centres[*group].1 += 1.0;
        }
        let square = |point: &Vector3<f64>, group: usize| {
            let (sum, members) = centres[group];
            if members > 0.0 { (point - sum / members).norm_squared() } else { f64::INFINITY }
        };
        let nearest = |point: &Vector3<f64>| {
            (0..count).min_by(|a, b| square(point, *a).total_cmp(&square(point, *b))).unwrap_or(0)
        };
        let next: Vec<usize> = points.iter().map(nearest).collect();
        if next == groups {
            break;
        }
        groups = next;
    }
    let of = |group: usize| -> Vec<Vector3<f64>> {
        points.iter().zip(&groups).filter(|(_, own)| **own == group).map(|(point, _)| *point).collect()
    };
    let left: f64 = (0..count).map(|group| squares_about_mean(&of(group))).sum();
    (left < COMPACT * squares_about_mean(points)).then_some(groups)
}

/// The place of the largest step between two means; `None` where the means leave most of the squares.
fn step(points: &[Vector3<f64>]) -> Option<usize> {
    let total: Vector3<f64> = points.iter().sum();
    let count = points.len() as f64;
    let (mut sum, mut best) = (Vector3::zeros(), (0.0, None));
    for (place, point) in points.iter().enumerate() {
        if within(points.len()).contains(&place) {
            let (before, behind) = (place as f64, count - place as f64);
            let between = (sum / before - (total - sum) / behind).norm_squared() * before * behind / count;
            if between > best.0 {
                best = (between, Some(place));
            }
        }
        sum += point;
    }
    best.1.filter(|_| best.0 > (1.0 - COMPACT) * squares_about_mean(points))
}
