//! Fits the nominal robot to measured points by the tracker's place and the target's offset, without changing the robot.

use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Vector3};

use calibrig_model::geometry::{Transform, best_fit_transform, cross_matrix};

/// Most iterations of one fit; few are enough where the robot fits at all.
const ITERATIONS: usize = 40;
/// Number of observations on which starts are tried.
const SOUGHT_ON: usize = 300;
/// Relative decrease of the sum of squares that ends a fit.
const DECREASE: f64 = 1e-6;
/// Damping that holds directions without any effect, relative to the largest diagonal entry.
const RIDGE: f64 = 1e-12;

/// Flange of the nominal robot, and where the tracker saw its target.
#[derive(Debug, Clone, Default)]
pub(super) struct Points {
    /// `base_from_flange` of every observation.
    pub flange: Vec<Transform>,
    /// Measured position in the tracker's frame, m.
    pub seen: Vec<Vector3<f64>>,
    pub station: Vec<usize>,
    pub target: Vec<usize>,
    /// Start of the search for every target's offset, m.
    pub offsets: Vec<Vector3<f64>>,
    pub stations: usize,
}

/// Places of the tracker and the targets.
#[derive(Debug, Clone)]
pub(super) struct Placement {
    /// `tracker_from_base` of each station.
    stations: Vec<Transform>,
    /// Offset of each target, m.
    offsets: Vec<Vector3<f64>>,
}

impl Points {
    pub fn len(&self) -> usize {
        self.seen.len()
    }

    /// The observations with these indices.
    pub fn part(&self, indices: &[usize]) -> Self {
        Self {
            flange: indices.iter().map(|i| self.flange[*i]).collect(),
            seen: indices.iter().map(|i| self.seen[*i]).collect(),
            station: indices.iter().map(|i| self.station[*i]).collect(),
            target: indices.iter().map(|i| self.target[*i]).collect(),
            offsets: self.offsets.clone(),
            stations: self.stations,
        }
    }

    /// Degrees of freedom that remain after fitting tracker and targets; zero where these explain any measurement.
    pub fn freedom(&self) -> usize {
        let stations = (0..self.stations).filter(|s| self.station.contains(s)).count();
        let targets = (0..self.offsets.len()).filter(|t| self.target.contains(t)).count();
        (3 * self.len()).saturating_sub(6 * stations + 3 * targets)
    }

    /// RMS distance of the points from their mean (each station's own), m.
    pub fn spread(&self) -> f64 {
        let mut squares = 0.0;
        for station in 0..self.stations {
            let own: Vec<_> = (0..self.len()).filter(|i| self.station[*i] == station).collect();
            let mean = own.iter().map(|i| self.seen[*i]).sum::<Vector3<f64>>() / own.len().max(1) as f64;
            squares += own.iter().map(|i| (self.seen[*i] - mean).norm_squared()).sum::<f64>();
        }
        (squares / self.len().max(1) as f64).sqrt()
    }

    /// Predicted position of observation `i` in the tracker's frame.
    pub fn predicted(&self, placement: &Placement, i: usize) -> Vector3<f64> {
        let in_base = self.flange[i] * nalgebra::Point3::from(placement.offsets[self.target[i]]);
        (placement.stations[self.station[i]] * in_base).coords
    }

    /// Measured minus predicted, m.
    pub fn residual(&self, placement: &Placement, i: usize) -> Vector3<f64> {
        self.seen[i] - self.predicted(placement, i)
    }

    pub fn lengths(&self, placement: &Placement) -> Vec<f64> {
        (0..self.len()).map(|i| self.residual(placement, i).norm()).collect()
    }

    /// RMS length of the residuals, m; `None` where tracker and targets explain any measurement.
    pub fn rms(&self, placement: &Placement) -> Option<f64> {
        let squares: f64 = self.lengths(placement).iter().map(|v| v * v).sum();
        let rms = (squares / self.len() as f64).sqrt();
        (self.freedom() > 0 && rms.is_finite()).then_some(rms)
    }

    /// This RMS length over the points' spread, corrected for the remaining degrees of freedom.
    pub fn share(&self, rms: f64) -> f64 {
        let factor = (3.0 * self.len() as f64 / self.freedom().max(1) as f64).sqrt();
        factor * rms / self.spread().max(f64::MIN_POSITIVE)
    }

    /// The least squares placement from the first start, nearly always the best where the robot fits the points.
    pub fn nearest(&self) -> Option<Placement> {
        let stations = (0..self.stations).map(|s| self.rigid(s)).collect::<Option<_>>()?;
        Some(self.fit(Placement { stations, offsets: self.offsets.clone() }, &vec![1.0; self.len()]))
    }

    /// The best placement found from several starts, with `every_turn` also from each of the cube's rotations.
    pub fn best(&self, every_turn: bool) -> Placement {
        let step = self.len().div_ceil(SOUGHT_ON).max(1);
        let part = self.part(&(0..self.len()).step_by(step).collect::<Vec<_>>());
        let weights = vec![1.0; part.len()];
        let fitted = part.starts(every_turn).into_iter().map(|start| part.fit(start, &weights));
        let fitted = fitted.map(|placement| (part.cost(&placement, &weights), placement));
        let best = fitted.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, placement)| placement);
        let best = best.unwrap_or_else(|| Placement {
            stations: vec![Transform::identity(); self.stations],
            offsets: self.offsets.clone(),
        });
        if step > 1 { self.fit(best, &vec![1.0; self.len()]) } else { best }
    }

    /// The least squares placement from `start`, by Levenberg and Marquardt's method.
    pub fn fit(&self, start: Placement, weights: &[f64]) -> Placement {
        let mut now = start;
        let mut cost = self.cost(&now, weights);
        let mut damping = 1e-4;
        for _ in 0..ITERATIONS {
            let (matrix, gradient) = self.normal(&now, weights);
            let Some(step) = damped(&matrix, &gradient, damping) else { break };
            let next = moved(&now, &step);
            let reached = self.cost(&next, weights);
            if !(reached < cost) {
                if damping > 1e6 || !(reached > cost) {
                    break;
                }
                damping *= 10.0;
                continue;
            }
            let decrease = cost - reached;
            (now, cost, damping) = (next, reached, 0.1 * damping);
            if decrease <= DECREASE * cost {
                break;
            }
        }
        now
    }

    fn cost(&self, placement: &Placement, weights: &[f64]) -> f64 {
        let terms = weights.iter().enumerate().filter(|(_, w)| **w > 0.0);
        terms.map(|(i, w)| w * self.residual(placement, i).norm_squared()).sum()
    }

    /// Normal matrix and right-hand side: for each station a rotation about the tracker's axes at the base's origin and a translation, for each
    /// target its offset.
    fn normal(&self, now: &Placement, weights: &[f64]) -> (DMatrix<f64>, DVector<f64>) {
        let n = 6 * self.stations + 3 * self.offsets.len();
        let (mut matrix, mut right) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for (i, weight) in weights.iter().enumerate().filter(|(_, w)| **w > 0.0) {
            let (station, target) = (6 * self.station[i], 6 * self.stations + 3 * self.target[i]);
            let place = &now.stations[self.station[i]];
            let residual = self.residual(now, i);
            let arm = self.predicted(now, i) - place.translation.vector;
            let turned = (place.rotation * self.flange[i].rotation).into_inner();
            let blocks =
                [(station, -cross_matrix(&arm)), (station + 3, Matrix3::identity()), (target, turned)];
            for (at, block) in &blocks {
                let mut part = right.fixed_rows_mut::<3>(*at);
                part += *weight * block.tr_mul(&residual);
                for (beside, other) in &blocks {
                    let mut part = matrix.fixed_view_mut::<3, 3>(*at, *beside);
                    part += *weight * block.tr_mul(other);
                }
            }
        }
        (matrix, right)
    }

    /// Places to start from: the rigid transform that fits best with the initial offsets; that of a linear system with any matrix in place of the
    /// rotation; and, for a single station, each rotation of a cube: where one or two axes are poorly determined, both other starts can lead to a
    /// wrong place.
    fn starts(&self, every_turn: bool) -> Vec<Placement> {
        let with = |stations: Vec<Transform>, offsets| Placement { stations, offsets };
        let mut starts = Vec::new();
        if let Some(stations) = (0..self.stations).map(|s| self.rigid(s)).collect() {
            starts.push(with(stations, self.offsets.clone()));
        }
        if let Some((stations, offsets)) = self.relaxed() {
            starts.push(with(stations, offsets));
        }
        if self.stations == 1 && (every_turn || starts.is_empty()) {
            let centre = self.seen.iter().sum::<Vector3<f64>>() / self.len().max(1) as f64;
            let nominal = self.flange.iter().map(|f| f.translation.vector).sum::<Vector3<f64>>();
            let nominal = nominal / self.len().max(1) as f64;
            starts.extend(turns().into_iter().map(|rotation| {
                let shift = nalgebra::Translation3::from(centre - rotation * nominal);
                with(vec![Transform::from_parts(shift, rotation)], self.offsets.clone())
            }));
        }
        starts
    }

    fn rigid(&self, station: usize) -> Option<Transform> {
        let own: Vec<_> = (0..self.len()).filter(|i| self.station[*i] == station).collect();
        let seen: Vec<_> = own.iter().map(|i| self.seen[*i]).collect();
        let nominal = own
            .iter()
            .map(|i| (self.flange[*i] * nalgebra::Point3::from(self.offsets[self.target[*i]])).coords);
        if own.is_empty() {
            return Some(Transform::identity());
        }
        best_fit_transform(&seen, &nominal.collect::<Vec<_>>())
    }

    /// Solves `base_from_tracker · seen = flange · offset`, which is linear with any matrix for the rotation, then makes the matrix a rotation.
    fn relaxed(&self) -> Option<(Vec<Transform>, Vec<Vector3<f64>>)> {
        const OF_STATION: usize = 12;
        let columns = OF_STATION * self.stations + 3 * self.offsets.len();
        if 3 * self.len() < columns || self.stations > 4 || self.offsets.len() > 8 {
            return None;
        }
        let scale = self.spread().max(f64::MIN_POSITIVE);
        let centre = self.seen.iter().sum::<Vector3<f64>>() / self.len() as f64;
        let mut system = DMatrix::zeros(3 * self.len(), columns);
        let mut right = DVector::zeros(3 * self.len());
        for i in 0..self.len() {
            let (station, target) =
                (OF_STATION * self.station[i], OF_STATION * self.stations + 3 * self.target[i]);
            let seen = (self.seen[i] - centre) / scale;
            for row in 0..3 {
                for column in 0..3 {
                    system[(3 * i + row, station + 3 * row + column)] = seen[column];
                }
                system[(3 * i + row, station + 9 + row)] = 1.0;
            }
            let rotation = self.flange[i].rotation.matrix();
            system.fixed_view_mut::<3, 3>(3 * i, target).copy_from(&-rotation);
            right.fixed_rows_mut::<3>(3 * i).copy_from(&self.flange[i].translation.vector);
        }
        let solved = system.try_svd(true, true, f64::EPSILON, 1000)?.solve(&right, 1e-10).ok()?;
        let place = |station: usize| {
            let at = OF_STATION * station;
            let matrix = Matrix3::from_fn(|row, column| solved[at + 3 * row + column]);
            let svd = matrix.try_svd(true, true, f64::EPSILON, 1000)?;
            let (u, v_t) = (svd.u?, svd.v_t?);
            let mut hand = Matrix3::identity();
            hand[(2, 2)] = (u * v_t).determinant().signum();
            let rotation = Rotation3::from_matrix_unchecked((u * hand * v_t).transpose());
            let shift = centre - rotation * solved.fixed_rows::<3>(at + 9).into_owned();
            Some(Transform::from_parts(nalgebra::Translation3::from(shift), rotation))
        };
        let stations = (0..self.stations).map(place).collect::<Option<Vec<_>>>()?;
        let offsets = (0..self.offsets.len())
            .map(|t| solved.fixed_rows::<3>(OF_STATION * self.stations + 3 * t).into_owned())
            .collect();
        Some((stations, offsets))
    }
}

/// The 24 rotations of a cube.
fn turns() -> Vec<Rotation3<f64>> {
    let quarter = std::f64::consts::FRAC_PI_2;
    let mut turns = Vec::with_capacity(24);
    let faces = [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (3.0, 0.0), (0.0, 1.0), (0.0, 3.0)];
    for (pitch, roll) in faces {
        for yaw in [0.0, 1.0, 2.0, 3.0] {
            turns.push(Rotation3::from_euler_angles(roll * quarter, pitch * quarter, yaw * quarter));
        }
    }
    turns
}

/// The solution of `(M + damping diag M + ridge) step = right`.
fn damped(matrix: &DMatrix<f64>, right: &DVector<f64>, damping: f64) -> Option<DVector<f64>> {
    let largest = matrix.diagonal().amax();
    let mut damped = matrix.clone();
    for i in 0..damped.nrows() {
        damped[(i, i)] += damping * matrix[(i, i)] + RIDGE * largest;
    }
    let step = damped.cholesky()?.solve(right);
    step.iter().all(|v| v.is_finite()).then_some(step)
}

fn moved(now: &Placement, step: &DVector<f64>) -> Placement {
    let stations = now.stations.iter().enumerate().map(|(s, place)| {
        let turn = Rotation3::new(step.fixed_rows::<3>(6 * s).into_owned());
        let shift = place.translation.vector + step.fixed_rows::<3>(6 * s + 3);
        Transform::from_parts(nalgebra::Translation3::from(shift), turn * place.rotation)
    });
    let first = 6 * now.stations.len();
    let offsets =
        now.offsets.iter().enumerate().map(|(t, offset)| offset + step.fixed_rows::<3>(first + 3 * t));
    Placement { stations: stations.collect(), offsets: offsets.collect() }
}
