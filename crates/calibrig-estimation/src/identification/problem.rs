//! The weighted residuals of a measurement set, and their Jacobian.

use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Vector3, Vector6};

use super::LeastSquares;
use super::forward_model::{ForwardModel, Prepared};
use super::linearisation::Whitening;
use super::noise::{ActuatorMotions, MachineNoise, Noise};
use super::shared::SharedWhitening;
use super::swept::condensed;
use super::turns::{TurnRow, TurnWhitening};
use crate::elastostatics::{ElasticError, put};
use calibrig_model::geometry::{Transform, cross_matrix, small_displacement};
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::{CalibrationModel, ParameterId};

/// Up to this many readings, their own scatter determines their noise too poorly.
const FEW: usize = 6;

/// One observation, ready for the fit.
#[derive(Debug, Clone)]
pub(super) struct PositionRow {
    /// Number of the pose.
    pub pose: u32,
    /// What the robot was told to do.
    pub told: Prepared,
    /// Measured position in the tracker's frame, m.
    pub seen: Vector3<f64>,
    /// Covariance of the reading as stated, with what the options add to it, m².
    pub reading: Option<Matrix3<f64>>,
    /// Inverse Cholesky factor of the reading's covariance: turns a difference in metres into standard deviations.
    pub whitening: Matrix3<f64>,
    /// Column of every error of its instrument, and of its drift, that is a parameter, with the displacement per unit, m in the tracker's axes.
    pub instrument: Vec<(usize, Vector3<f64>)>,
    /// Time since its station was placed by nests, h.
    pub hours: f64,
    pub station: usize,
    pub target: usize,
}

/// A Gaussian prior on some parameters x: its rows are `whitening · x + offset`.
#[derive(Debug, Clone)]
pub(super) struct Prior {
    /// Columns of its parameters.
    pub columns: Vec<usize>,
    /// Triangular: the inverse Cholesky factor of the parameters' covariance, or the factor of the measurements that determine them.
    pub whitening: DMatrix<f64>,
    /// One number per row: zero, unless the prior has a mean other than zero.
    pub offset: DVector<f64>,
}

/// Observations, priors and the model that joins them. All memory is allocated when it is made; [`evaluate`](LeastSquares::evaluate)
/// allocates none. Where the robot cannot take a pose, its residual is NaN.
#[derive(Debug, Clone)]
pub(super) struct CalibrationProblem {
    pub nominal: CalibrationModel,
    pub parameters: Vec<ParameterId>,
    /// Positions, in blocks of three coordinates: the first rows of the system.
    pub rows: Vec<PositionRow>,
    /// Orientations: the next blocks of three rows. `turn_of` has the index of each observation's own.
    pub turns: Vec<TurnRow>,
    pub turn_of: Vec<Option<usize>>,
    /// Priors of nests and targets: the rows after those of the observations.
    pub priors: Vec<Prior>,
    /// Indices of the priors that come from sweeps, with the readings of the sweeps.
    pub swept: Vec<(usize, Vec<PositionRow>)>,
    /// Sum of squares of the residuals of these readings that no parameter changes, at the current parameters.
    pub left_of_swept: f64,
    /// The next rows: (column, one over the standard deviation) of parameters with a prior of their own, except the links' tolerance.
    pub own_priors: Vec<(usize, f64)>,
    /// Columns whose own prior is on the logarithm of one plus the parameter.
    pub logarithmic: Vec<usize>,
    /// The last rows: (column, one over the standard deviation) of the links' manufacturing tolerance.
    pub tolerances: Vec<(usize, f64)>,
    /// `tracker_from_base` of each station, which the frame parameters displace.
    pub stations: Vec<Transform>,
    /// Offsets of the targets, which the target parameters change.
    pub targets: Vec<Vector3<f64>>,
    /// `flange_from_target`, which the orientation parameters change.
    pub orientations: Vec<Rotation3<f64>>,
    /// Observations of every pose, by index.
    pub poses: Vec<Vec<usize>>,
    /// Derivatives of every observation's target by the actuators, in the base frame; empty where actuator noise is not considered.
    pub motions: Vec<Vec<Vector3<f64>>>,
    /// Like [`motions`](Self::motions), for orientations: how the actuators turn each.
    pub turn_motions: Vec<Vec<Vector3<f64>>>,
    /// Stated standard deviation of what the model leaves out, for every reading, m.
    pub unmodelled: f64,
    /// Stated noise of the actuators.
    pub stated_actuators: Option<MachineNoise>,
    /// The noise that was found.
    pub noise: Noise,
    /// Poses whose observations depend on each other, with the inverse Cholesky factor of their covariance after each is whitened on its own.
    pub joined: Vec<(Vec<usize>, DMatrix<f64>)>,
    /// Whitening of the orientations, pose by pose.
    pub turn_whitening: Vec<TurnWhitening>,
    /// Displacement of the data rows per unit of each error that many readings share, m and rad in the trackers' axes; data rows x errors.
    pub shared: DMatrix<f64>,
    /// Whitening of the shared errors, applied to rows that are whitened pose by pose; `None` where no errors are shared.
    pub shared_whitening: Option<SharedWhitening>,
    pub current: Current,
    /// A known evaluation, kept until it is asked for.
    pub start: Option<Start>,
}

/// Residuals and Jacobian at given parameters.
#[derive(Debug, Clone)]
pub(super) struct Start {
    x: Vec<f64>,
    residuals: DVector<f64>,
    jacobian: DMatrix<f64>,
}

/// The model at the parameters of one evaluation.
#[derive(Debug, Clone)]
pub(super) struct Current {
    pub model: CalibrationModel,
    pub stations: Vec<Transform>,
    pub targets: Vec<Vector3<f64>>,
    /// `flange_from_target`, and the displacement of each.
    pub orientations: Vec<Rotation3<f64>>,
    pub(super) turned: Vec<Vector3<f64>>,
    pub(super) displacements: Vec<Displacement>,
    amplitudes: Vec<f64>,
    /// Errors of the instruments by the parameters' columns; empty where none is a parameter.
    pub(super) errors: Vec<f64>,
    pub forward: ForwardModel,
}

/// How a station's frame is displaced.
#[derive(Debug, Clone, Copy)]
pub(super) struct Displacement {
    xi: Vector6<f64>,
    rotation: Rotation3<f64>,
    pub left: Matrix3<f64>,
}

impl Displacement {
    fn new(xi: Vector6<f64>) -> Self {
        let rotation_vector = xi.fixed_rows::<3>(3).into_owned();
        Self { xi, rotation: Rotation3::new(rotation_vector), left: left_jacobian(&rotation_vector) }
    }
}

impl Current {
    /// The model at the start; `forward` knows the terms, in the order of their parameters.
    pub fn new(
        nominal: &CalibrationModel,
        forward: ForwardModel,
        stations: &[Transform],
        targets: &[Vector3<f64>],
        orientations: &[Rotation3<f64>],
    ) -> Self {
        Self {
            orientations: orientations.to_vec(),
            turned: vec![Vector3::zeros(); orientations.len()],
            model: nominal.clone(),
            stations: stations.to_vec(),
            targets: targets.to_vec(),
            displacements: vec![Displacement::new(Vector6::zeros()); stations.len()],
            amplitudes: Vec::new(),
            errors: Vec::new(),
            forward,
        }
    }
}

impl CalibrationProblem {
    /// Sets the current model to the parameters `x`.
    pub fn set(&mut self, x: &[f64]) {
        let now = &mut self.current;
        now.targets.copy_from_slice(&self.targets);
        now.turned.fill(Vector3::zeros());
        for displacement in &mut now.displacements {
            displacement.xi.fill(0.0);
        }
        now.amplitudes.clear();
        now.errors.clear();
        if self.rows.iter().any(|row| !row.instrument.is_empty()) {
            now.errors.extend_from_slice(x);
        }
        for (id, &value) in self.parameters.iter().zip(x) {
            match *id {
                ParameterId::Frame { station, component } => now.displacements[station].xi[component] = value,
                ParameterId::Target { target, axis } => now.targets[target][axis] += value,
                ParameterId::Orientation { target, axis } => now.turned[target][axis] = value,
                ParameterId::Term(_) => now.amplitudes.push(value),
                ParameterId::Instrument { .. } | ParameterId::Drift { .. } => {}
                ParameterId::Link { .. }
                | ParameterId::Compliance(_)
                | ParameterId::Mass { .. }
                | ParameterId::Centre { .. }
                | ParameterId::Linkage(_) => put(&mut now.model, &self.nominal, *id, value),
            }
        }
        now.forward.set_model(&now.model, now.amplitudes.iter().copied());
        let turned = self.orientations.iter().zip(&now.turned);
        for (orientation, (origin, turned)) in now.orientations.iter_mut().zip(turned) {
            *orientation =
                if *turned == Vector3::zeros() { *origin } else { origin * Rotation3::new(*turned) };
        }
        let stations = now.stations.iter_mut().zip(&self.stations);
        for ((station, origin), displacement) in stations.zip(&mut now.displacements) {
            *station = origin * small_displacement(&displacement.xi);
            *displacement = Displacement::new(displacement.xi);
        }
        self.linearise_sweeps(x);
    }

    /// Linearises the sweeps at `x` and updates the priors that come from them.
    fn linearise_sweeps(&mut self, x: &[f64]) {
        self.left_of_swept = 0.0;
        for (prior, rows) in &self.swept {
            let mut residuals = DVector::zeros(3 * rows.len());
            let mut jacobian = DMatrix::zeros(3 * rows.len(), x.len());
            for (index, row) in rows.iter().enumerate() {
                let at = Evaluation {
                    now: &mut self.current,
                    parameters: &self.parameters,
                    stations: &self.stations,
                };
                at.fill(row, index, &mut residuals, Some(&mut jacobian));
            }
            // Where the robot cannot take a pose of its sweeps, the prior stays as it is.
            if residuals.iter().all(|v| v.is_finite()) {
                let (now, left) = condensed(&residuals, &jacobian, x);
                self.priors[*prior] = now;
                self.left_of_swept += left;
            }
        }
    }

    /// Keeps an evaluation at `x` for the next one there. In both, the first rows are those of the observations, and the columns those of the
    /// parameters.
    pub fn start_from(&mut self, x: &[f64], residuals: DVector<f64>, jacobian: DMatrix<f64>) {
        let m = self.rows();
        let mut residuals = residuals.resize_vertically(m, 0.0);
        let mut jacobian = jacobian.resize_vertically(m, 0.0);
        self.fill_priors(x, &mut residuals, Some(&mut jacobian));
        self.start = Some(Start { x: x.to_vec(), residuals, jacobian });
    }

    /// Turns rows of observations in m and rad, in the trackers' axes, into the whitened rows of the fit.
    pub fn whiten(&self, residuals: &mut DVector<f64>, jacobian: &mut DMatrix<f64>) {
        self.whiten_apart(residuals, jacobian);
        self.whiten_shared(residuals, Some(jacobian));
    }

    /// Like [`whiten`](Self::whiten), but pose by pose, without the errors that poses share.
    pub(super) fn whiten_apart(&self, residuals: &mut DVector<f64>, jacobian: &mut DMatrix<f64>) {
        for (i, row) in self.rows.iter().enumerate() {
            let own = row.whitening * residuals.fixed_rows::<3>(3 * i);
            residuals.fixed_rows_mut::<3>(3 * i).copy_from(&own);
        }
        for mut column in jacobian.column_iter_mut() {
            for (i, row) in self.rows.iter().enumerate() {
                let own = row.whitening * column.fixed_rows::<3>(3 * i);
                column.fixed_rows_mut::<3>(3 * i).copy_from(&own);
            }
        }
        self.whiten_joined(residuals, Some(jacobian));
        self.whiten_turns(residuals, Some(jacobian));
    }

    fn whiten_joined(&self, residuals: &mut DVector<f64>, mut jacobian: Option<&mut DMatrix<f64>>) {
        let rows = residuals.len();
        for (pose, whitening) in &self.joined {
            whiten_together(pose, whitening, residuals.as_mut_slice(), rows);
            if let Some(jacobian) = jacobian.as_deref_mut() {
                whiten_together(pose, whitening, jacobian.as_mut_slice(), rows);
            }
        }
    }

    /// Why the robot at the current parameters cannot take the pose of an observation: the pose's number, and the reason.
    pub fn failure(&mut self, index: usize) -> Option<(u32, ElasticError)> {
        let row = &self.rows[index];
        let now = &mut self.current;
        let placed = now.forward.place(&row.told);
        let ready = placed.and_then(|()| now.forward.differentiate(&now.targets[row.target], &row.told));
        let ready = match self.turn_of[index] {
            Some(_) => ready.and_then(|()| now.forward.differentiate_turn(&row.told)),
            None => ready,
        };
        ready.err().map(|error| (row.pose, error))
    }

    /// The map from displacements of the observations' targets in the base frame, m, to standard deviations.
    pub fn whitening(&self) -> Whitening {
        let of = |row: &PositionRow| row.whitening * self.current.stations[row.station].rotation.matrix();
        Whitening {
            single: self.rows.iter().map(of).collect(),
            joined: self.joined.clone(),
            shared: self.shared_whitening.clone(),
        }
    }

    /// Prepares the derivatives by the actuators, for the nominal robot with the given `targets`.
    pub fn prepare_motions(&mut self, set: &MeasurementSet, targets: &[Vector3<f64>]) {
        let mut motions = ActuatorMotions::new(&self.nominal);
        let at = |index: usize| targets.get(index).copied().unwrap_or_default();
        self.motions = set.observations.iter().map(|o| motions.at(&o.command, &at(o.target))).collect();
        let turned = self.turns.iter().map(|turn| motions.turns(&set.observations[turn.observation].command));
        self.turn_motions = turned.collect();
    }

    /// Like [`prepare_motions`](Self::prepare_motions), with the targets that the parameters `x` give.
    pub fn prepare_motions_at(&mut self, set: &MeasurementSet, x: &[f64]) {
        self.set(x);
        let targets = self.current.targets.clone();
        self.prepare_motions(set, &targets);
    }

    /// Number of rows of observations, nests and targets.
    pub fn measured_rows(&self) -> usize {
        let priors: usize = self.priors.iter().map(|p| p.whitening.nrows()).sum();
        self.data_rows() + priors
    }

    /// Standard deviation of a parameter's prior from what was stated for it: an instrument's error, a drift, a target or a body. What nests show
    /// of a station is a measurement and not included.
    pub fn stated_sigma(&self, column: usize) -> Option<f64> {
        let is_place = |own: &usize| matches!(self.parameters[*own], ParameterId::Frame { .. });
        let stated = self.priors.iter().filter(|prior| !prior.columns.iter().any(is_place));
        stated.into_iter().find_map(|prior| {
            let place = prior.columns.iter().position(|own| *own == column)?;
            Some(prior.whitening.clone().try_inverse()?.row(place).norm())
        })
    }

    fn fill_observation(
        &mut self,
        index: usize,
        residuals: &mut DVector<f64>,
        jacobian: Option<&mut DMatrix<f64>>,
    ) {
        let at =
            Evaluation { now: &mut self.current, parameters: &self.parameters, stations: &self.stations };
        at.fill(&self.rows[index], index, residuals, jacobian);
    }

    /// Readings that state no noise among others that do, where they are too few to separate a gross error from noise. Each comes with the factor
    /// that converts its rows from the noise it was given to the median of the others.
    pub fn few_unstated(&self) -> Vec<(usize, f64)> {
        let unstated: Vec<usize> = (0..self.rows.len()).filter(|i| self.rows[*i].reading.is_none()).collect();
        let mut stated: Vec<f64> =
            self.rows.iter().filter_map(|row| row.reading).map(|c| (c.trace() / 3.0).sqrt()).collect();
        if unstated.is_empty() || unstated.len() > FEW || stated.len() <= FEW || !self.joined.is_empty() {
            return Vec::new();
        }
        let middle = stated.len() / 2;
        let middle = *stated.select_nth_unstable_by(middle, f64::total_cmp).1;
        let given =
            |i: usize| self.rows[i].whitening.try_inverse().map(|root| (root.norm_squared() / 3.0).sqrt());
        unstated.into_iter().filter_map(|i| Some((i, given(i)? / middle))).collect()
    }

    fn fill_priors(&self, x: &[f64], residuals: &mut DVector<f64>, mut jacobian: Option<&mut DMatrix<f64>>) {
        let mut first = self.data_rows();
        for prior in &self.priors {
            let n = prior.whitening.nrows();
            for i in 0..n {
                let columns = prior.columns.iter().enumerate();
                let row = columns.map(|(j, column)| prior.whitening[(i, j)] * x[*column]);
                residuals[first + i] = row.sum::<f64>() + prior.offset[i];
            }
            if let Some(jacobian) = jacobian.as_deref_mut() {
                jacobian.rows_mut(first, n).fill(0.0);
                for (j, column) in prior.columns.iter().enumerate() {
                    jacobian.view_mut((first, *column), (n, 1)).copy_from(&prior.whitening.column(j));
                }
            }
            first += n;
        }
        for (row, (column, weight)) in (first..).zip(self.own_priors.iter().chain(&self.tolerances)) {
            let (value, slope) = if self.logarithmic.contains(column) {
                (x[*column].ln_1p(), 1.0 / (1.0 + x[*column]))
            } else {
                (x[*column], 1.0)
            };
            residuals[row] = weight * value;
            if let Some(jacobian) = jacobian.as_deref_mut() {
                jacobian.row_mut(row).fill(0.0);
                jacobian[(row, *column)] = weight * slope;
            }
        }
    }
}

/// What the rows of a reading are computed from.
struct Evaluation<'a> {
    now: &'a mut Current,
    parameters: &'a [ParameterId],
    /// `tracker_from_base` of each station, which the frame parameters displace.
    stations: &'a [Transform],
}

impl Evaluation<'_> {
    /// Fills block `index`, three rows.
    fn fill(
        self,
        row: &PositionRow,
        index: usize,
        residuals: &mut DVector<f64>,
        jacobian: Option<&mut DMatrix<f64>>,
    ) {
        let now = self.now;
        let target = &now.targets[row.target];
        let ready = now.forward.place(&row.told).and_then(|()| match jacobian {
            Some(_) => now.forward.differentiate(target, &row.told),
            None => Ok(()),
        });
        if ready.is_err() {
            residuals.fixed_rows_mut::<3>(3 * index).fill(f64::NAN);
            return;
        }
        let in_base = now.forward.target(target);
        let tracker_from_base = &now.stations[row.station];
        let mut predicted = tracker_from_base.rotation * in_base + tracker_from_base.translation.vector;
        for (column, displacement) in &row.instrument {
            predicted += displacement * now.errors[*column];
        }
        residuals.fixed_rows_mut::<3>(3 * index).copy_from(&(row.whitening * (predicted - row.seen)));
        let Some(jacobian) = jacobian else { return };
        let from_base = row.whitening * tracker_from_base.rotation.matrix();
        let from_origin = row.whitening * self.stations[row.station].rotation.matrix();
        let Displacement { rotation, left, .. } = &now.displacements[row.station];
        let turned = rotation * in_base;
        let mut term = 0;
        for (column, id) in self.parameters.iter().enumerate() {
            let derivative = match *id {
                ParameterId::Frame { station, component } if station == row.station => {
                    if component < 3 {
                        from_origin.column(component).into_owned()
                    } else {
                        from_origin * left.column(component - 3).cross(&turned)
                    }
                }
                id => from_base * in_base_column(&now.forward, id, row.target, &in_base, &mut term),
            };
            jacobian.fixed_view_mut::<3, 1>(3 * index, column).copy_from(&derivative);
        }
        for (column, displacement) in &row.instrument {
            jacobian.fixed_view_mut::<3, 1>(3 * index, *column).copy_from(&(row.whitening * displacement));
        }
    }
}

impl LeastSquares for CalibrationProblem {
    fn parameters(&self) -> usize {
        self.parameters.len()
    }

    fn rows(&self) -> usize {
        self.measured_rows() + self.own_priors.len() + self.tolerances.len()
    }

    fn blocks(&self) -> usize {
        self.rows.len() + self.turns.len()
    }

    fn partner(&self, block: usize) -> usize {
        match self.owner(block) {
            (observation, Some(_)) => observation,
            (observation, None) => self.turn_of[observation].map_or(block, |turn| self.turn_block(turn)),
        }
    }

    fn beside(&self) -> f64 {
        self.left_of_swept
    }

    fn evaluate(&mut self, x: &[f64], residuals: &mut DVector<f64>, mut jacobian: Option<&mut DMatrix<f64>>) {
        self.set(x);
        if let Some(jacobian) = jacobian.as_deref_mut()
            && let Some(start) = self.start.take_if(|start| start.x == x)
        {
            (*residuals, *jacobian) = (start.residuals, start.jacobian);
            return;
        }
        for index in 0..self.rows.len() {
            self.fill_observation(index, residuals, jacobian.as_deref_mut());
            self.fill_turn(index, residuals, jacobian.as_deref_mut());
        }
        self.whiten_joined(residuals, jacobian.as_deref_mut());
        self.whiten_turns(residuals, jacobian.as_deref_mut());
        self.whiten_shared(residuals, jacobian.as_deref_mut());
        self.fill_priors(x, residuals, jacobian);
    }
}

/// Turns the rows of a pose's observations, each whitened on its own, into independent rows, in every column of `rows` numbers.
pub(super) fn whiten_together(pose: &[usize], whitening: &DMatrix<f64>, columns: &mut [f64], rows: usize) {
    let places: Vec<usize> = pose.iter().flat_map(|i| 3 * i..3 * i + 3).collect();
    let mut own = DVector::zeros(places.len());
    for column in columns.chunks_exact_mut(rows) {
        for (own, place) in own.iter_mut().zip(&places) {
            *own = column[*place];
        }
        for (whitened, place) in (whitening * &own).iter().zip(&places) {
            column[*place] = *whitened;
        }
    }
}

/// Change of `target` at `in_base` per unit of a parameter, in the base frame; zero for the tracker's place and errors, and for other targets.
/// `term` counts the terms so far.
pub(super) fn in_base_column(
    forward: &ForwardModel,
    id: ParameterId,
    target: usize,
    in_base: &Vector3<f64>,
    term: &mut usize,
) -> Vector3<f64> {
    match id {
        ParameterId::Frame { .. }
        | ParameterId::Orientation { .. }
        | ParameterId::Instrument { .. }
        | ParameterId::Drift { .. } => Vector3::zeros(),
        ParameterId::Target { target: other, .. } if other != target => Vector3::zeros(),
        ParameterId::Term(_) => {
            *term += 1;
            forward.term_column(*term - 1)
        }
        ParameterId::Target { .. }
        | ParameterId::Link { .. }
        | ParameterId::Compliance(_)
        | ParameterId::Mass { .. }
        | ParameterId::Centre { .. }
        | ParameterId::Linkage(_) => forward.column(id, in_base),
    }
}

/// The matrix J with `R(r + dr) ≈ exp(J dr) R(r)`.
pub(super) fn left_jacobian(r: &Vector3<f64>) -> Matrix3<f64> {
    let angle = r.norm();
    let cross = cross_matrix(r);
    // Below 1e-3 rad the series is exact to rounding, and the quotients are not.
    let (a, b) = if angle < 1e-3 {
        (0.5 - angle * angle / 24.0, 1.0 / 6.0 - angle * angle / 120.0)
    } else {
        ((1.0 - angle.cos()) / (angle * angle), (angle - angle.sin()) / (angle * angle * angle))
    };
    Matrix3::identity() + a * cross + b * cross * cross
}

#[cfg(test)]
mod tests;
