//! Fits the robot, as it is read, to the points by the tracker's place and the target's offset, in closed form.
//!
//! With any affine map in place of the tracker's rotation the problem is linear: the part of the points that the flange's position and axes explain
//! is projected out, and the offsets follow from a system of three unknowns per target. From there the rigid transform for given offsets
//! (K. S. Arun and others, PAMI 9 (1987) 698) and the offsets for a given rotation are computed alternately.

use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Vector3};

use super::session::View;
use super::tried::LENGTHS;
use crate::kinematics::KinematicChain;
use calibrig_model::geometry::cross_matrix;

/// Iterations that alternate between rotation and offsets.
const ROUNDS: usize = 5;
/// Gauss-Newton steps after them, where it matters.
const REFINED: usize = 12;
/// A column adds nothing new if less than this share of its length is outside the span of those before it.
const DEPENDENT: f64 = 1e-7;
/// Another unit is considered where the points are too large or too small by at least this factor.
const OTHER_UNIT: f64 = 3.0;
/// A unit is accepted where it agrees within this factor.
const UNIT_WITHIN: f64 = 1.6;

/// The flange according to the robot, and the measured points.
pub(super) struct Cloud {
    /// Flange's origin in the base frame, m.
    x: Vec<Vector3<f64>>,
    /// The flange's axes in the base frame.
    axes: Vec<Matrix3<f64>>,
    seen: Vec<Vector3<f64>>,
    station: Vec<usize>,
    target: Vec<usize>,
    stations: usize,
    offsets: Vec<Vector3<f64>>,
}

/// Places of the tracker and the targets.
#[derive(Debug, Clone)]
pub(super) struct Placed {
    /// `tracker_from_base` of every station, for points in the robot's unit that are not mirrored.
    pub stations: Vec<(Matrix3<f64>, Vector3<f64>)>,
    /// Offset of each target, m.
    pub offsets: Vec<Vector3<f64>>,
    /// RMS distance, m.
    pub rms: f64,
    /// RMS distance as a share of the points' spread.
    pub share: f64,
}

impl Placed {
    /// The same placement with the offsets of two targets exchanged.
    pub fn with_exchanged(mut self, a: usize, b: usize) -> Self {
        self.offsets.swap(a, b);
        self
    }
}

impl Cloud {
    pub fn new(view: &View, chain: &mut KinematicChain) -> Self {
        chain.set_model(&view.chain);
        let n = view.chain.links.len();
        let (mut x, mut axes) = (Vec::with_capacity(view.rows.len()), Vec::with_capacity(view.rows.len()));
        for joints in view.joints.chunks_exact(n) {
            chain.place(joints);
            let flange = chain.base_from_flange();
            x.push(flange.translation.vector);
            axes.push(flange.rotation.into_inner());
        }
        Self {
            x,
            axes,
            seen: view.seen.clone(),
            station: view.station.clone(),
            target: view.target.clone(),
            stations: view.stations,
            offsets: view.offsets.clone(),
        }
    }

    pub fn len(&self) -> usize {
        self.seen.len()
    }

    /// The cloud with its points converted from another unit, and mirrored.
    pub fn read(&self, factor: f64, mirrored: bool) -> Self {
        let hand = Vector3::new(factor, factor, if mirrored { -factor } else { factor });
        Self {
            x: self.x.clone(),
            axes: self.axes.clone(),
            seen: self.seen.iter().map(|seen| seen.component_mul(&hand)).collect(),
            station: self.station.clone(),
            target: self.target.clone(),
            stations: self.stations,
            offsets: self.offsets.clone(),
        }
    }

    /// The cloud with the given target for each observation, and these offsets of the targets.
    fn with_targets(&self, target: &[usize], offsets: Vec<Vector3<f64>>) -> Self {
        Self { target: target.to_vec(), offsets, ..self.read(1.0, false) }
    }

    /// RMS distance of the points from their mean (each station's own), m.
    pub fn spread(&self) -> f64 {
        let mut squares = 0.0;
        for station in 0..self.stations {
            let own = || self.seen.iter().zip(&self.station).filter(|(_, s)| **s == station).map(|(p, _)| p);
            let mean = own().sum::<Vector3<f64>>() / own().count().max(1) as f64;
            squares += own().map(|p| (p - mean).norm_squared()).sum::<f64>();
        }
        (squares / self.len().max(1) as f64).sqrt()
    }

    /// The unit of the points from their size relative to the robot's, if it is another one.
    pub fn unit(&self, offsets: &[Vector3<f64>]) -> Option<f64> {
        let mut squares = 0.0;
        for station in 0..self.stations {
            let own: Vec<usize> = (0..self.len()).filter(|i| self.station[*i] == station).collect();
            let at = |i: usize| self.x[i] + self.axes[i] * offsets[self.target[i]];
            let mean = own.iter().map(|i| at(*i)).sum::<Vector3<f64>>() / own.len().max(1) as f64;
            squares += own.iter().map(|i| (at(*i) - mean).norm_squared()).sum::<f64>();
        }
        let factor = (squares / self.len().max(1) as f64).sqrt() / self.spread();
        let is_other = factor.is_finite() && !(1.0 / OTHER_UNIT..OTHER_UNIT).contains(&factor);
        let away = |unit: f64| (unit / factor).ln().abs();
        let nearest = LENGTHS.into_iter().min_by(|a, b| away(*a).total_cmp(&away(*b)));
        nearest.filter(|unit| is_other && away(*unit) < UNIT_WITHIN.ln())
    }

    /// Offsets of the targets with an affine map in place of every station's rotation, m; `None` where nothing determines them.
    pub fn relaxed(&self, weights: Option<&[f64]>) -> Option<Vec<Vector3<f64>>> {
        self.affine(weights).map(|(offsets, _)| offsets)
    }

    /// Lower bound for all rigid placements: the RMS distance with an affine map in place of the rotation, m.
    pub fn bound(&self) -> Option<f64> {
        self.affine(None).map(|(_, squares)| (squares / self.len().max(1) as f64).sqrt())
    }

    fn affine(&self, weights: Option<&[f64]>) -> Option<(Vec<Vector3<f64>>, f64)> {
        let targets = self.offsets.len();
        let columns = 3 * targets;
        let mut normal = DMatrix::<f64>::zeros(columns, columns);
        let mut right = DVector::<f64>::zeros(columns);
        let mut squares = 0.0;
        let weight = |i: usize| weights.map_or(1.0, |w| w[i]).sqrt();
        for station in 0..self.stations {
            let own: Vec<usize> =
                (0..self.len()).filter(|i| self.station[*i] == station && weight(*i) > 0.0).collect();
            if own.is_empty() {
                continue;
            }
            let basis = self.basis(&own, &weight);
            let project = |column: &mut Vec<f64>| {
                for q in &basis {
                    let along: f64 = q.iter().zip(column.iter()).map(|(a, b)| a * b).sum();
                    column.iter_mut().zip(q).for_each(|(value, q)| *value -= along * q);
                }
            };
            for row in 0..3 {
                let mut y: Vec<f64> = own.iter().map(|i| weight(*i) * self.x[*i][row]).collect();
                project(&mut y);
                squares += y.iter().map(|v| v * v).sum::<f64>();
                let mut all: Vec<(usize, Vec<f64>)> = Vec::with_capacity(columns);
                for target in 0..targets {
                    if targets > 1 && own.iter().all(|i| self.target[*i] != target) {
                        continue;
                    }
                    for axis in 0..3 {
                        let value = |i: &usize| {
                            let is_own = self.target[*i] == target;
                            if is_own { weight(*i) * self.axes[*i][(row, axis)] } else { 0.0 }
                        };
                        let mut column: Vec<f64> = own.iter().map(value).collect();
                        project(&mut column);
                        all.push((3 * target + axis, column));
                    }
                }
                let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
                for (i, a) in &all {
                    right[*i] -= dot(a, &y);
                    for (j, b) in all.iter().filter(|(j, _)| j >= i) {
                        let value = dot(a, b);
                        normal[(*i, *j)] += value;
                        if i != j {
                            normal[(*j, *i)] += value;
                        }
                    }
                }
            }
        }
        // An undetermined offset stays as stated.
        let stated = DVector::from_iterator(columns, self.offsets.iter().flat_map(|o| o.iter().copied()));
        let whole = right.clone();
        let right = right - &normal * &stated;
        let ridge = 1e-9 * normal.diagonal().amax().max(f64::MIN_POSITIVE);
        for i in 0..columns {
            normal[(i, i)] += ridge;
        }
        let step = normal.cholesky()?.solve(&right);
        let found = stated + step;
        let is_finite = found.iter().all(|v| v.is_finite());
        let offsets = || (0..targets).map(|t| Vector3::from_fn(|axis, _| found[3 * t + axis])).collect();
        is_finite.then(|| (offsets(), (squares - whole.dot(&found)).max(0.0)))
    }

    /// An orthonormal basis of the constant one and the points' coordinates over the observations `own`.
    fn basis(&self, own: &[usize], weight: &impl Fn(usize) -> f64) -> Vec<Vec<f64>> {
        let mean = own.iter().map(|i| self.seen[*i]).sum::<Vector3<f64>>() / own.len() as f64;
        let mut basis: Vec<Vec<f64>> = Vec::with_capacity(4);
        for column in 0..4 {
            let value = |i: &usize| match column {
                0 => weight(*i),
                axis => weight(*i) * (self.seen[*i][axis - 1] - mean[axis - 1]),
            };
            let mut q: Vec<f64> = own.iter().map(value).collect();
            let length = norm(&q);
            for other in &basis {
                let along: f64 = q.iter().zip(other).map(|(a, b)| a * b).sum();
                q.iter_mut().zip(other).for_each(|(value, other)| *value -= along * other);
            }
            let left = norm(&q);
            if left > DEPENDENT * length {
                for value in &mut q {
                    *value /= left;
                }
                basis.push(q);
            }
        }
        basis
    }

    /// Rotation and offsets, alternately, starting from `offsets`.
    pub fn placed(&self, mut offsets: Vec<Vector3<f64>>, weights: Option<&[f64]>) -> Placed {
        let mut stations = self.rigid(&offsets, weights);
        for _ in 0..ROUNDS {
            let Some(next) = self.offsets_for(&stations, &offsets, weights) else { break };
            let moved = next.iter().zip(&offsets).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
            offsets = next;
            stations = self.rigid(&offsets, weights);
            if moved < 1e-6 {
                break;
            }
        }
        let mut placed = Placed { stations, offsets, rms: 0.0, share: 0.0 };
        let (mut squares, mut total) = (0.0, 0.0);
        for i in 0..self.len() {
            let weight = weights.map_or(1.0, |w| w[i]);
            squares += weight * self.residual(&placed, i).norm_squared();
            total += weight;
        }
        placed.rms = (squares / total.max(f64::MIN_POSITIVE)).sqrt();
        placed.share = placed.rms / self.spread().max(f64::MIN_POSITIVE);
        placed
    }

    /// The least squares placement next to `placed`, by Gauss and Newton.
    pub fn refined(&self, placed: Placed) -> Placed {
        self.moved(placed, None)
    }

    /// The least squares placement with stated offsets and stations held.
    pub fn held(&self, view: &View) -> Placed {
        let mut placed = self.best(None);
        for (offset, (stated, sigma)) in
            placed.offsets.iter_mut().zip(view.offsets.iter().zip(&view.offset_sigma))
        {
            if sigma.is_some() {
                *offset = *stated;
            }
        }
        placed.stations = self.rigid(&placed.offsets, None);
        for (station, known) in placed.stations.iter_mut().zip(&view.registered) {
            *station = known.unwrap_or(*station);
        }
        self.told(&mut placed);
        self.moved(placed, Some(view))
    }

    fn moved(&self, mut placed: Placed, held: Option<&View>) -> Placed {
        for _ in 0..REFINED {
            let Some(next) = self.stepped(&placed, held) else { break };
            if !(next.rms < placed.rms) {
                break;
            }
            let is_there = next.rms > (1.0 - 1e-6) * placed.rms;
            placed = next;
            if is_there {
                break;
            }
        }
        placed
    }

    /// One step; offsets and stations that are stated in `held` stay.
    fn stepped(&self, placed: &Placed, held: Option<&View>) -> Option<Placed> {
        let size = 6 * self.stations + 3 * placed.offsets.len();
        let mut normal = DMatrix::<f64>::zeros(size, size);
        let mut right = DVector::<f64>::zeros(size);
        for i in 0..self.len() {
            let rotation = &placed.stations[self.station[i]].0;
            let at = self.x[i] + self.axes[i] * placed.offsets[self.target[i]];
            let left = rotation.tr_mul(&self.residual(placed, i));
            let (s, t) = (6 * self.station[i], 6 * self.stations + 3 * self.target[i]);
            // In the base frame: shift and rotation of the base, and the target's offset.
            let blocks = [(s, Matrix3::identity()), (s + 3, -cross_matrix(&at)), (t, self.axes[i])];
            for (a, block) in &blocks {
                let mut part = right.fixed_rows_mut::<3>(*a);
                part += block.tr_mul(&left);
                for (b, other) in &blocks {
                    let mut part = normal.fixed_view_mut::<3, 3>(*a, *b);
                    part += block.tr_mul(other);
                }
            }
        }
        let largest = normal.diagonal().amax().max(f64::MIN_POSITIVE);
        let is_held = |i: usize| {
            let targets = 6 * self.stations;
            held.is_some_and(|view| {
                if i < targets {
                    view.registered[i / 6].is_some()
                } else {
                    view.offset_sigma[(i - targets) / 3].is_some()
                }
            })
        };
        for i in 0..size {
            normal[(i, i)] += if is_held(i) { 1e12 * largest } else { 1e-10 * largest };
        }
        let step = normal.cholesky()?.solve(&right);
        let part = |at: usize| Vector3::from_fn(|k, _| step[at + k]);
        let mut next = placed.clone();
        for (s, (rotation, shift)) in next.stations.iter_mut().enumerate() {
            *shift += *rotation * part(6 * s);
            *rotation *= Rotation3::new(part(6 * s + 3)).into_inner();
        }
        for (t, offset) in next.offsets.iter_mut().enumerate() {
            *offset += part(6 * self.stations + 3 * t);
        }
        self.told(&mut next);
        next.rms.is_finite().then_some(next)
    }

    /// Sets the residual figures of a placement.
    fn told(&self, placed: &mut Placed) {
        let squares = self.lengths(placed).iter().map(|v| v * v).sum::<f64>();
        placed.rms = (squares / self.len().max(1) as f64).sqrt();
        placed.share = placed.rms / self.spread().max(f64::MIN_POSITIVE);
    }

    /// The better of the placements from the stated offsets and from those of the relaxed problem.
    pub fn best(&self, weights: Option<&[f64]>) -> Placed {
        let stated = self.placed(self.offsets.clone(), weights);
        match self.relaxed(weights).map(|offsets| self.placed(offsets, weights)) {
            Some(relaxed) if !(stated.rms <= relaxed.rms) => relaxed,
            _ => stated,
        }
    }

    /// The target out of `among` to which an observation is nearest.
    pub fn nearest(&self, placed: &Placed, i: usize, among: &[usize]) -> usize {
        let (rotation, shift) = &placed.stations[self.station[i]];
        let length = |target: usize| {
            (self.seen[i] - rotation * (self.x[i] + self.axes[i] * placed.offsets[target]) - shift).norm()
        };
        let nearest = among.iter().copied().min_by(|a, b| length(*a).total_cmp(&length(*b)));
        nearest.unwrap_or(self.target[i])
    }

    /// Measured minus predicted, m.
    pub fn residual(&self, placed: &Placed, i: usize) -> Vector3<f64> {
        let (rotation, shift) = &placed.stations[self.station[i]];
        self.seen[i] - rotation * (self.x[i] + self.axes[i] * placed.offsets[self.target[i]]) - shift
    }

    pub fn lengths(&self, placed: &Placed) -> Vec<f64> {
        (0..self.len()).map(|i| self.residual(placed, i).norm()).collect()
    }

    fn rigid(&self, offsets: &[Vector3<f64>], weights: Option<&[f64]>) -> Vec<(Matrix3<f64>, Vector3<f64>)> {
        let place = |station: usize| {
            let own = || (0..self.len()).filter(move |i| self.station[*i] == station);
            let weight = |i: usize| weights.map_or(1.0, |w| w[i]);
            let at = |i: usize| self.x[i] + self.axes[i] * offsets[self.target[i]];
            let (mut total, mut seen, mut robot) = (0.0, Vector3::zeros(), Vector3::zeros());
            for i in own() {
                total += weight(i);
                seen += weight(i) * self.seen[i];
                robot += weight(i) * at(i);
            }
            let total = total.max(f64::MIN_POSITIVE);
            let (seen, robot) = (seen / total, robot / total);
            let mut correlation = Matrix3::zeros();
            for i in own() {
                correlation += weight(i) * (self.seen[i] - seen) * (at(i) - robot).transpose();
            }
            let rotation = nearest_rotation(&correlation);
            (rotation, seen - rotation * robot)
        };
        (0..self.stations).map(place).collect()
    }

    /// Offsets for given rotations; the stations' shifts are free.
    fn offsets_for(
        &self,
        stations: &[(Matrix3<f64>, Vector3<f64>)],
        stated: &[Vector3<f64>],
        weights: Option<&[f64]>,
    ) -> Option<Vec<Vector3<f64>>> {
        let targets = stated.len();
        let size = 3 * (targets + self.stations);
        let mut normal = DMatrix::<f64>::zeros(size, size);
        let mut right = DVector::<f64>::zeros(size);
        for i in 0..self.len() {
            let weight = weights.map_or(1.0, |w| w[i]);
            let (rotation, shift) = &stations[self.station[i]];
            // In the base frame: seen - shift - x = axes offset + (error of the shift).
            let left =
                rotation.tr_mul(&(self.seen[i] - shift)) - self.x[i] - self.axes[i] * stated[self.target[i]];
            let (t, s) = (3 * self.target[i], 3 * (targets + self.station[i]));
            let axes = &self.axes[i];
            let mut part = right.fixed_rows_mut::<3>(t);
            part += weight * axes.tr_mul(&left);
            let mut part = right.fixed_rows_mut::<3>(s);
            part += weight * left;
            let mut part = normal.fixed_view_mut::<3, 3>(t, s);
            part += weight * axes.transpose();
            let mut part = normal.fixed_view_mut::<3, 3>(s, t);
            part += weight * axes;
            for k in 0..3 {
                normal[(t + k, t + k)] += weight;
                normal[(s + k, s + k)] += weight;
            }
        }
        let ridge = 1e-9 * normal.diagonal().amax().max(f64::MIN_POSITIVE);
        for i in 0..size {
            normal[(i, i)] += ridge;
        }
        let step = normal.cholesky()?.solve(&right);
        step.iter().all(|v| v.is_finite()).then(|| {
            let moved = |t: usize| stated[t] + step.fixed_rows::<3>(3 * t);
            (0..targets).map(moved).collect()
        })
    }

    /// The placement with approximately the least sum of distances, by weights that decrease with the distance, and these weights: a few far-off
    /// points hardly move it. From there, the loss of Geman and `McClure`, which far-off points do not move at all.
    pub fn robust(&self, rounds: usize) -> (Placed, Vec<f64>) {
        let mut weights = vec![1.0; self.len()];
        let mut placed = self.best(None);
        for round in 0..2 * rounds {
            let lengths = self.lengths(&placed);
            let middle = median(lengths.clone()).max(1e-9);
            for (weight, length) in weights.iter_mut().zip(&lengths) {
                let size = length / middle;
                *weight =
                    if round < rounds { 1.0 / size.max(0.3) } else { (1.0 + (size / 3.0).powi(2)).powi(-2) };
            }
            placed = self.best(Some(&weights));
        }
        (placed, weights)
    }

    /// Divides the observations of `target` into those of two targets, by clusters of the residuals in the flange's frame; returns the
    /// placement, and which observations belong to the second target. It starts with a split along the direction in which they differ most.
    pub fn split(&self, target: usize, from: &Placed) -> Option<(Placed, Vec<bool>)> {
        let own: Vec<usize> = (0..self.len()).filter(|i| self.target[*i] == target).collect();
        let in_flange = |placed: &Placed, i: usize| {
            let rotation = placed.stations[self.station[i]].0 * self.axes[i];
            rotation.tr_mul(&self.residual(placed, i))
        };
        let left: Vec<_> = own.iter().map(|i| in_flange(from, *i)).collect();
        let mean = left.iter().sum::<Vector3<f64>>() / own.len().max(1) as f64;
        let inertia: Matrix3<f64> = left.iter().map(|v| (v - mean) * (v - mean).transpose()).sum();
        let eigen = inertia.symmetric_eigen();
        let axis = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
        let along: Vec<f64> = left.iter().map(|v| axis.dot(v)).collect();
        let middle = 0.5 * along.iter().fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(*v), h.max(*v))).sum();
        let mut second = vec![false; self.len()];
        own.iter().zip(&along).for_each(|(i, along)| second[*i] = *along > middle);
        let other = self.offsets.len();
        let mut offsets = from.offsets.clone();
        offsets.push(from.offsets[target]);
        let mut best: Option<(Placed, Vec<bool>)> = None;
        for _ in 0..25 {
            let count = own.iter().filter(|i| second[**i]).count();
            if count < 2 || own.len() - count < 2 {
                break;
            }
            let targets: Vec<usize> =
                (0..self.len()).map(|i| if second[i] { other } else { self.target[i] }).collect();
            let cloud = self.with_targets(&targets, offsets.clone());
            let placed = match cloud.relaxed(None).filter(|_| best.is_none()) {
                Some(relaxed) => cloud.placed(relaxed, None),
                None => cloud.placed(offsets.clone(), None),
            };
            offsets.clone_from(&placed.offsets);
            let length = |i: usize, which: usize| {
                let (rotation, shift) = &placed.stations[self.station[i]];
                (self.seen[i] - rotation * (self.x[i] + self.axes[i] * placed.offsets[which]) - shift).norm()
            };
            let next: Vec<bool> = (0..self.len())
                .map(|i| self.target[i] == target && length(i, other) < length(i, target))
                .collect();
            let is_same = next == second;
            if best.as_ref().is_none_or(|(b, _)| placed.rms < b.rms) {
                best = Some((placed, second.clone()));
            }
            if is_same {
                break;
            }
            second = next;
        }
        best
    }
}

trait Sum {
    fn sum(self) -> f64;
}

impl Sum for (f64, f64) {
    fn sum(self) -> f64 {
        self.0 + self.1
    }
}

fn norm(v: &[f64]) -> f64 {
    v.iter().map(|v| v * v).sum::<f64>().sqrt()
}

pub(super) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

/// The rotation that fits a correlation matrix best.
fn nearest_rotation(correlation: &Matrix3<f64>) -> Matrix3<f64> {
    let Some(svd) = correlation.try_svd(true, true, f64::EPSILON, 100) else { return Matrix3::identity() };
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return Matrix3::identity() };
    let mut hand = Matrix3::identity();
    let smallest = svd.singular_values.imin();
    hand[(smallest, smallest)] = (u * v_t).determinant().signum();
    let rotation = u * hand * v_t;
    if rotation.iter().all(|v| v.is_finite()) { rotation } else { Matrix3::identity() }
}
