//! Detects sessions that consist of several: readings of several targets under one name, and a station that was moved between its readings.
//!
//! Both leave residuals in a few compact groups, which no deficiency of a robot's model does. So an offset of the target (a displacement of the
//! station) is fitted for each group beside all parameters, to first order, and every reading is assigned to the group in which its residual
//! is smaller, alternately (S. P. Lloyd, "Least squares quantization in PCM", IEEE Trans. Inf. Theory 28 (1982) 129). It is reported where the
//! residuals decrease by more than those of a single cloud can: a Gaussian cloud by a factor of 1.7 along one axis, the sines of a revolute
//! joint by 2.3.

use std::ops::Range;

use nalgebra::{DMatrix, DVector, Matrix3, Matrix3x6, Matrix6, SymmetricEigen, Vector3, Vector6};

use super::Warning;
use super::contradiction::Minimum;
use super::problem::CalibrationProblem;
use super::solver::Solution;
use calibrig_model::ParameterId;
use calibrig_model::geometry::cross_matrix;
use calibrig_model::measurement::MeasurementSet;

/// Standard deviations that decrease to this share indicate several sessions.
const SHARE: f64 = 0.15;
/// Groups that leave more than this share of the sum of squares within them are not examined further.
const COMPACT: f64 = 0.65;
/// Neither is a division that leaves more than this share of the residuals after two iterations.
const HARDLY: f64 = 0.8;
/// Fewest readings of a group.
const LEAST: usize = 4;
/// Fewest degrees of freedom that remain beside parameters and the choice of the groups.
const LEAST_FREEDOM: f64 = 6.0;
const MOST_TURNS: usize = 12;

/// A reading, evaluated at the solution.
struct Seen {
    /// Rotation of `tracker_from_flange`.
    axes: Matrix3<f64>,
    /// Predicted position in the tracker's frame, m.
    predicted: Vector3<f64>,
    /// Predicted less measured, in the tracker's frame, m.
    off: Vector3<f64>,
}

/// A division of readings into several targets.
struct Targets {
    groups: Vec<usize>,
    /// Largest distance between two targets, m.
    apart: f64,
    share: f64,
    /// RMS of the 3-D residual, m.
    rms: f64,
    /// Residual of every reading, in the flange's axes, m.
    left: Vec<Vector3<f64>>,
}

impl Seen {
    /// Change of the predicted position per displacement of the station's frame.
    fn displaced(&self) -> Matrix3x6<f64> {
        let mut columns = Matrix3x6::zeros();
        columns.fixed_columns_mut::<3>(0).copy_from(&Matrix3::identity());
        columns.fixed_columns_mut::<3>(3).copy_from(&-cross_matrix(&self.predicted));
        columns
    }
}

/// The linear system at the solution, with all rows in standard deviations and without the weights of a loss.
struct System<'a> {
    problem: &'a CalibrationProblem,
    jacobian: &'a DMatrix<f64>,
    residuals: &'a DVector<f64>,
    free: Vec<usize>,
    seen: Vec<Seen>,
    /// Sum of squares of the observations' residuals, and its degrees of freedom.
    squares: f64,
    freedom: f64,
    /// RMS of the 3-D residual, m.
    rms: f64,
}

/// Warnings about a set that consists of several; `jacobian` is the solution's without the weights of a loss.
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
        if let Some((targets, apart, rms)) = system.several_targets(&own) {
            warnings.push(Warning::SeveralTargets {
                target: stated.name.clone(),
                targets,
                apart,
                rms: [system.rms, rms],
            });
        }
    }
    for (station, stated) in set.stations.iter().enumerate() {
        let own = (0..system.seen.len()).filter(|i| problem.rows[*i].station == station).collect::<Vec<_>>();
        if let Some((first, by, rms)) = system.moved_station(&own) {
            warnings.push(Warning::StationMoved {
                station: stated.name.clone(),
                poses: [problem.rows[own[first - 1]].pose, problem.rows[own[first]].pose],
                by,
                rms: [system.rms, rms],
            });
        }
    }
    warnings
}

/// The readings at parameters `x`; `None` where the robot cannot take a pose.
fn look(problem: &mut CalibrationProblem, x: &[f64]) -> Option<Vec<Seen>> {
    problem.set(x);
    let now = &mut problem.current;
    let see = |row: &super::problem::PositionRow| {
        now.forward.place(&row.told).ok()?;
        let in_base = now.forward.target(&now.targets[row.target]);
        let column = |axis| now.forward.column(ParameterId::Target { target: row.target, axis }, &in_base);
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
            // With a loss, the least squares minimum is elsewhere.
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

    /// Residuals with the parameters and further `columns` fitted (rows in standard deviations), and the values of those columns. The columns are
    /// given in metres in the trackers' axes, three rows per observation.
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

    /// RMS of the 3-D residual if it decreases as these residuals do, m.
    fn rms_of(&self, residuals: &DVector<f64>) -> f64 {
        self.rms * (residuals.rows(0, 3 * self.seen.len()).norm_squared() / self.squares).sqrt()
    }

    /// Whether the residuals decrease enough to continue.
    fn falls(&self, residuals: &DVector<f64>) -> bool {
        self.rms_of(residuals) < HARDLY * self.rms
    }

    /// Share to which standard deviations decrease with these residuals, for this many additional parameters and choices.
    fn share(&self, residuals: &DVector<f64>, parameters: usize, choices: usize) -> Option<f64> {
        let freedom = self.freedom - (parameters + choices) as f64;
        let squares = residuals.rows(0, 3 * self.seen.len()).norm_squared();
        let share = ((squares / freedom) / (self.squares / self.freedom)).sqrt();
        (freedom >= LEAST_FREEDOM && share.is_finite()).then_some(share)
    }

    /// Number of targets among the readings `own`, the distance between them (m), and the remaining RMS (m).
    fn several_targets(&self, own: &[usize]) -> Option<(usize, f64, f64)> {
        // In the flange's axes, in which an offset is the same in all poses.
        let offs: Vec<_> = own.iter().map(|i| self.seen[*i].axes.tr_mul(&self.seen[*i].off)).collect();
        let mut groups = vec![0; own.len()];
        part(&offs, &mut groups, 1);
        if !is_compact(&offs, &groups) {
            return None;
        }
        let mut found = self.as_targets(own, groups, 2)?;
        if found.share < SHARE {
            return Some((2, found.apart, found.rms));
        }
        part(&found.left, &mut found.groups, 2);
        let found = self.as_targets(own, found.groups, 3)?;
        (found.share < SHARE).then_some((3, found.apart, found.rms))
    }

    /// The readings `own` divided into `count` targets, starting from `groups`; `None` where that explains little.
    fn as_targets(&self, own: &[usize], mut groups: Vec<usize>, count: usize) -> Option<Targets> {
        for turn in 0..MOST_TURNS {
            if (0..count).any(|group| groups.iter().filter(|own| **own == group).count() < LEAST) {
                return None;
            }
            let mut columns = DMatrix::zeros(3 * self.seen.len(), 3 * (count - 1));
            for (i, group) in own.iter().zip(&groups).filter(|(_, group)| **group > 0) {
                columns.fixed_view_mut::<3, 3>(3 * i, 3 * (group - 1)).copy_from(&self.seen[*i].axes);
            }
            let (left, values) = self.with(&columns)?;
            let share = self.share(&left, values.len(), own.len() * (count - 1))?;
            if turn > 1 && !self.falls(&left) {
                return None;
            }
            let offset = |group: usize| match group {
                0 => Vector3::zeros(),
                _ => values.fixed_rows::<3>(3 * (group - 1)).into_owned(),
            };
            let own_left = |i: usize| -> Vector3<f64> { left.fixed_rows::<3>(3 * i).into_owned() };
            let nearest = |(i, now): (&usize, &usize)| {
                let axes = self.problem.rows[*i].whitening * self.seen[*i].axes;
                let square = |group| (own_left(*i) - axes * (offset(*now) - offset(group))).norm_squared();
                (0..count).min_by(|a, b| square(*a).total_cmp(&square(*b))).unwrap_or(*now)
            };
            let next: Vec<usize> = own.iter().zip(&groups).map(nearest).collect();
            if next == groups || turn + 1 == MOST_TURNS {
                let pairs = (0..count).flat_map(|a| (0..a).map(move |b| (a, b)));
                let apart = pairs.map(|(a, b)| (offset(a) - offset(b)).norm()).fold(0.0, f64::max);
                let rms = self.rms_of(&left);
                let in_flange = |i: &usize| {
                    let metres = self.problem.rows[*i].whitening.lu().solve(&own_left(*i))?;
                    Some(self.seen[*i].axes.tr_mul(&metres))
                };
                let left = own.iter().map(in_flange).collect::<Option<_>>()?;
                return Some(Targets { groups, apart, share, rms, left });
            }
            groups = next;
        }
        None
    }

    /// The position among `own` where two displacements, one before and one after it, explain most of the residuals on their own; `None` where
    /// they leave most of them.
    fn step(&self, own: &[usize]) -> Option<usize> {
        let mut sums = vec![(Matrix6::zeros(), Vector6::zeros())];
        for i in own {
            let (columns, (normal, right)) = (self.seen[*i].displaced(), sums[sums.len() - 1]);
            sums.push((normal + columns.tr_mul(&columns), right + columns.tr_mul(&self.seen[*i].off)));
        }
        let all = sums[own.len()];
        let explained = |(normal, right): (Matrix6<f64>, Vector6<f64>)| {
            normal.cholesky().map_or(0.0, |factor| factor.solve(&right).dot(&right))
        };
        let at = |place: usize| {
            let (normal, right) = sums[place];
            explained((normal, right)) + explained((all.0 - normal, all.1 - right))
        };
        let places = within(own.len()).map(|place| (place, at(place)));
        let (place, most) = places.max_by(|a, b| a.1.total_cmp(&b.1))?;
        let squares: f64 = own.iter().map(|i| self.seen[*i].off.norm_squared()).sum();
        (most > (1.0 - COMPACT) * squares).then_some(place)
    }

    /// The position among `own` from which on their station stood elsewhere, how far that moved the points (m), and the remaining RMS (m).
    fn moved_station(&self, own: &[usize]) -> Option<(usize, f64, f64)> {
        let mut first = self.step(own)?;
        let displaced = |i: usize| self.seen[i].displaced();
        for turn in 0..MOST_TURNS {
            let mut columns = DMatrix::zeros(3 * self.seen.len(), 6);
            for i in &own[first..] {
                columns.fixed_view_mut::<3, 6>(3 * i, 0).copy_from(&displaced(*i));
            }
            let (left, values) = self.with(&columns)?;
            let share = self.share(&left, 6, 2)?;
            if turn > 1 && !self.falls(&left) {
                return None;
            }
            let by: Vector6<f64> = values.fixed_rows::<6>(0).into_owned();
            let mut gains = vec![0.0];
            for (place, i) in own.iter().enumerate() {
                let shift = self.problem.rows[*i].whitening * displaced(*i) * by;
                let now: Vector3<f64> = left.fixed_rows::<3>(3 * i).into_owned();
                let [before, behind] = if place < first { [now, now - shift] } else { [now + shift, now] };
                // Decrease of the sum of squares if the station moves after this reading.
                gains.push(gains[place] + behind.norm_squared() - before.norm_squared());
            }
            let next = within(own.len()).max_by(|a, b| gains[*a].total_cmp(&gains[*b]))?;
            if next == first {
                let moved = own[first..].iter().map(|i| (displaced(*i) * by).norm()).sum::<f64>();
                let by = moved / (own.len() - first) as f64;
                return (share < SHARE).then_some((first, by, self.rms_of(&left)));
            }
            first = next;
        }
        None
    }
}

/// Possible positions of a step: with enough readings on both sides.
fn within(count: usize) -> Range<usize> {
    LEAST..(count + 1).saturating_sub(LEAST)
}

fn squares_about_mean(points: &[Vector3<f64>]) -> f64 {
    let mean = points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
    points.iter().map(|point| (point - mean).norm_squared()).sum()
}

fn members(points: &[Vector3<f64>], groups: &[usize], group: usize) -> Vec<Vector3<f64>> {
    points.iter().zip(groups).filter(|(_, own)| **own == group).map(|(point, _)| *point).collect()
}

/// Divides the group with the largest sum of squares, out of `count`, along the axis along which it is longest.
fn part(points: &[Vector3<f64>], groups: &mut [usize], count: usize) {
    let squares = |group: usize| squares_about_mean(&members(points, groups, group));
    let Some(largest) = (0..count).max_by(|a, b| squares(*a).total_cmp(&squares(*b))) else { return };
    let own = members(points, groups, largest);
    let mean = own.iter().sum::<Vector3<f64>>() / own.len().max(1) as f64;
    let spread: Matrix3<f64> = own.iter().map(|point| (point - mean) * (point - mean).transpose()).sum();
    // The iteration for eigenvalues may not end for numbers that are not finite.
    if spread.iter().any(|entry| !entry.is_finite()) {
        return;
    }
    let eigen = SymmetricEigen::new(spread);
    let longest = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
    for (group, point) in groups.iter_mut().zip(points) {
        if *group == largest && (point - mean).dot(&longest) > 0.0 {
            *group = count;
        }
    }
}

/// Whether two groups leave little of the sum of squares.
fn is_compact(points: &[Vector3<f64>], groups: &[usize]) -> bool {
    let left: f64 = (0..2).map(|group| squares_about_mean(&members(points, groups, group))).sum();
    left < COMPACT * squares_about_mean(points)
}
