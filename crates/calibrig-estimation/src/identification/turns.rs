//! The orientations of full poses: three rows each, after those of all positions.
//!
//! A residual is the rotation vector φ of predicted · measured⁻¹ in the tracker's axes, rad. Positions are weighed on their own, like those of
//! points; an orientation is weighed together with the positions of its pose, by the remaining rows of the lower-triangular Cholesky factor of
//! their common covariance. So the rows of all observations stay where they are, and all rows together are independent.

use nalgebra::{Cholesky, DMatrix, DVector, Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::LeastSquares;
use super::forward_model::ForwardModel;
use super::problem::{CalibrationProblem, Displacement, left_jacobian};
use calibrig_model::ParameterId;
use calibrig_model::geometry::{Transform, rotation_vector};
use calibrig_model::measurement::{MeasurementSet, Reading};

/// Standard deviation that rotations without a stated one are given before the residuals are known, rad.
pub(super) const UNSTATED_TURN: f64 = 1e-4;

/// The orientation of an observation.
#[derive(Debug, Clone)]
pub(super) struct TurnRow {
    /// Index of the observation.
    pub observation: usize,
    /// Measured `tracker_from_target`.
    pub seen: Rotation3<f64>,
    /// Stated covariance of the orientation's error, rad², and of that with the position's error, m rad: one row per component of the rotation.
    pub reading: Option<[Matrix3<f64>; 2]>,
}

/// The map that makes the orientations of a pose independent of its positions and of each other.
#[derive(Debug, Clone)]
pub(super) struct TurnWhitening {
    /// Observations of the pose.
    observations: Vec<usize>,
    /// Blocks of its orientations.
    blocks: Vec<usize>,
    /// Applies to the orientations, rad.
    own: DMatrix<f64>,
    /// Applies to the whitened rows of the positions; the result is subtracted.
    coupling: DMatrix<f64>,
}

impl TurnWhitening {
    /// Applies the map to every column of `rows` numbers, whose positions are whitened already.
    pub fn apply(&self, columns: &mut [f64], rows: usize) {
        let places = |blocks: &[usize]| blocks.iter().flat_map(|b| 3 * b..3 * b + 3).collect::<Vec<_>>();
        let (positions, turns) = (places(&self.observations), places(&self.blocks));
        for column in columns.chunks_exact_mut(rows) {
            let take =
                |places: &[usize]| DVector::from_iterator(places.len(), places.iter().map(|i| column[*i]));
            let whitened = &self.own * take(&turns) - &self.coupling * take(&positions);
            for (place, value) in turns.iter().zip(&whitened) {
                column[*place] = *value;
            }
        }
    }
}

/// The orientations of a set, in the order of its observations.
pub(super) fn turns(set: &MeasurementSet) -> Vec<TurnRow> {
    let turn = |(observation, of): (usize, &calibrig_model::measurement::Observation)| {
        let Reading::Pose(pose) = &of.reading else { return None };
        let reading = pose
            .covariance
            .map(|c| [c.fixed_view::<3, 3>(3, 3).into_owned(), c.fixed_view::<3, 3>(3, 0).into_owned()]);
        Some(TurnRow { observation, seen: pose.rotation, reading })
    };
    set.observations.iter().enumerate().filter_map(turn).collect()
}

/// Stated orientations of the targets on the flange; the flange's own where none is stated.
pub(super) fn stated_orientations(set: &MeasurementSet) -> Vec<Rotation3<f64>> {
    let of = |target: &calibrig_model::measurement::Target| {
        target.orientation.as_ref().map_or_else(Rotation3::identity, |o| o.flange_from_target)
    };
    set.targets.iter().map(of).collect()
}

/// Initial deviation ξ of a target's orientation from its stated one, rad, from the readings, with the nominal robot (`flanges` are
/// `base_from_flange`, one per observation) and the `stations` at their places; `None` for a target without a reading of its orientation. It is
/// the mean of the single readings as rotation matrices (M. Moakher, "Means and averaging in the group of rotations", SIAM J. Matrix
/// Anal. Appl. 24 (2002) 1, section 3.1).
pub(super) fn starting_turn(
    set: &MeasurementSet,
    flanges: &[Transform],
    stations: &[Transform],
    target: usize,
    stated: &Rotation3<f64>,
) -> Option<Vector3<f64>> {
    let mut sum = Matrix3::zeros();
    for (observation, flange) in set.observations.iter().zip(flanges) {
        let Reading::Pose(pose) = &observation.reading else { continue };
        if observation.target == target {
            let tracker_from_flange = stations.get(observation.station)?.rotation * flange.rotation;
            sum += (tracker_from_flange.inverse() * pose.rotation).matrix();
        }
    }
    let svd = sum.try_svd(true, true, f64::EPSILON, 1000)?;
    let (u, v_t) = (svd.u?, svd.v_t?);
    let mut handedness = Matrix3::identity();
    let smallest = svd.singular_values.imin();
    handedness[(smallest, smallest)] = (u * v_t).determinant().signum();
    let found = Rotation3::from_matrix_unchecked(u * handedness * v_t);
    // By a quaternion, whose logarithm is exact also for half a turn.
    let turn = UnitQuaternion::from_rotation_matrix(&(stated.inverse() * found)).scaled_axis();
    (svd.singular_values[0] > 0.0 && turn.iter().all(|v| v.is_finite())).then_some(turn)
}

impl CalibrationProblem {
    /// Number of rows of the observations: three for every position, then three for every orientation.
    pub fn data_rows(&self) -> usize {
        3 * self.blocks()
    }

    /// Index of the block of an orientation.
    pub fn turn_block(&self, turn: usize) -> usize {
        self.rows.len() + turn
    }

    /// Blocks of observations of one pose: first their positions, then the orientations.
    pub fn blocks_of(&self, observations: &[usize]) -> Vec<usize> {
        let turns = observations.iter().filter_map(|i| self.turn_of[*i]).map(|turn| self.turn_block(turn));
        observations.iter().copied().chain(turns).collect()
    }

    /// The observation of a block, and its orientation if the block is one.
    pub fn owner(&self, block: usize) -> (usize, Option<usize>) {
        match block.checked_sub(self.rows.len()) {
            Some(turn) => (self.turns[turn].observation, Some(turn)),
            None => (block, None),
        }
    }

    /// Fills the rows of an observation's orientation, in rad; its position must have been filled before.
    pub(super) fn fill_turn(
        &mut self,
        index: usize,
        residuals: &mut DVector<f64>,
        jacobian: Option<&mut DMatrix<f64>>,
    ) {
        let Some(turn) = self.turn_of[index] else { return };
        let first = 3 * (self.rows.len() + turn);
        let row = &self.rows[index];
        let now = &mut self.current;
        let is_placed = residuals[3 * index].is_finite();
        if !is_placed || jacobian.is_some() && now.forward.differentiate_turn(&row.told).is_err() {
            residuals.fixed_rows_mut::<3>(3 * index).fill(f64::NAN);
            residuals.fixed_rows_mut::<3>(first).fill(f64::NAN);
            return;
        }
        let station = &now.stations[row.station];
        let flange = now.forward.rotation();
        // A drift rotates the base as the tracker sees it; the instrument's other errors concern positions only.
        let drift = |(column, _): &(usize, Vector3<f64>)| match self.parameters[*column] {
            ParameterId::Drift { component, .. } if component >= 3 => {
                Vector3::ith(component - 3, row.hours * now.errors[*column])
            }
            _ => Vector3::zeros(),
        };
        let drifted = Rotation3::new(row.instrument.iter().map(drift).sum::<Vector3<f64>>());
        let predicted = station.rotation * drifted * flange * now.orientations[row.target];
        let off = rotation_vector(&(predicted * self.turns[turn].seen.inverse()));
        residuals.fixed_rows_mut::<3>(first).copy_from(&off);
        let Some(jacobian) = jacobian else { return };
        // From a small rotation of the prediction to the change of the difference's rotation vector.
        let inverse = left_jacobian(&off).try_inverse().unwrap_or_else(Matrix3::identity);
        let from_base = inverse * station.rotation.matrix();
        let Displacement { left, .. } = &now.displacements[row.station];
        let by_frame = inverse * self.stations[row.station].rotation.matrix() * left;
        let by_target = from_base
            * flange.matrix()
            * self.orientations[row.target].matrix()
            * left_jacobian(&now.turned[row.target]);
        let mut term = 0;
        for (column, id) in self.parameters.iter().enumerate() {
            let derivative = match *id {
                ParameterId::Frame { station, component } if station == row.station && component >= 3 => {
                    by_frame.column(component - 3).into_owned()
                }
                ParameterId::Drift { station, component } if station == row.station && component >= 3 => {
                    from_base.column(component - 3) * row.hours
                }
                ParameterId::Orientation { target, axis } if target == row.target => {
                    by_target.column(axis).into_owned()
                }
                id => from_base * turn_column(&now.forward, id, &mut term),
            };
            jacobian.fixed_view_mut::<3, 1>(first, column).copy_from(&derivative);
        }
    }

    /// The known covariance of an orientation's own error, rad².
    fn own_turn_covariance(&self, turn: usize) -> Matrix3<f64> {
        let stated = self.turns[turn].reading.map(|[own, _]| own);
        let found = self.noise.turn.filter(|sigma| *sigma > 0.0);
        let beside = found.unwrap_or(if stated.is_none() { UNSTATED_TURN } else { 0.0 });
        stated.unwrap_or_default() + Matrix3::identity() * beside * beside
    }

    /// Adds the stated covariances of orientations, and of these with the positions of their readings, to the covariance of these `blocks`.
    pub(super) fn add_stated_turns(&self, blocks: &[usize], covariance: &mut DMatrix<f64>) {
        for (k, block) in blocks.iter().enumerate() {
            let (observation, Some(turn)) = self.owner(*block) else { continue };
            let Some([own, with_position]) = self.turns[turn].reading else { continue };
            let mut place = covariance.fixed_view_mut::<3, 3>(3 * k, 3 * k);
            place += own;
            if let Some(position) = blocks.iter().position(|other| *other == observation) {
                let mut below = covariance.fixed_view_mut::<3, 3>(3 * k, 3 * position);
                below += with_position;
                let mut right = covariance.fixed_view_mut::<3, 3>(3 * position, 3 * k);
                right += with_position.transpose();
            }
        }
    }

    /// Weighs the orientations of a pose whose positions, each with covariance `known`, are weighed already.
    pub(super) fn weigh_turns(&mut self, pose: &[usize], known: &[Matrix3<f64>]) -> Option<()> {
        let blocks = self.blocks_of(pose);
        let positions = 3 * pose.len();
        let size = 3 * blocks.len();
        if size == positions {
            return Some(());
        }
        let common = self.common_covariance(&blocks);
        let mut covariance = common.unwrap_or_else(|| DMatrix::zeros(size, size));
        for (k, known) in known.iter().enumerate() {
            let mut own = covariance.fixed_view_mut::<3, 3>(3 * k, 3 * k);
            own += known;
        }
        self.add_stated_turns(&blocks, &mut covariance);
        for (k, block) in blocks.iter().enumerate().skip(pose.len()) {
            if let (_, Some(turn)) = self.owner(*block) {
                let stated = self.turns[turn].reading.map_or_else(Matrix3::zeros, |[own, _]| own);
                let mut own = covariance.fixed_view_mut::<3, 3>(3 * k, 3 * k);
                own += self.own_turn_covariance(turn) - stated;
            }
        }
        let factor = Cholesky::new(covariance)?.l();
        let turns = size - positions;
        let own = factor
            .view((positions, positions), (turns, turns))
            .solve_lower_triangular(&DMatrix::identity(turns, turns))?;
        let coupling = &own * factor.view((positions, 0), (turns, positions));
        let is_finite = own.iter().chain(&coupling).all(|v| v.is_finite());
        is_finite.then(|| {
            let (observations, blocks) = (pose.to_vec(), blocks[pose.len()..].to_vec());
            self.turn_whitening.push(TurnWhitening { observations, blocks, own, coupling });
        })
    }

    /// Weighs all orientations the same, with this standard deviation, rad.
    pub(super) fn weigh_turns_alike(&mut self, sigma: f64) {
        let alike = |turn: usize| TurnWhitening {
            observations: Vec::new(),
            blocks: vec![self.turn_block(turn)],
            own: DMatrix::identity(3, 3) / sigma,
            coupling: DMatrix::zeros(3, 0),
        };
        self.turn_whitening = (0..self.turns.len()).map(alike).collect();
    }

    /// Whitens the rows of orientations, rad, in columns whose positions are whitened.
    pub(super) fn whiten_turns(&self, residuals: &mut DVector<f64>, mut jacobian: Option<&mut DMatrix<f64>>) {
        let rows = residuals.len();
        for whitening in &self.turn_whitening {
            whitening.apply(residuals.as_mut_slice(), rows);
            if let Some(jacobian) = jacobian.as_deref_mut() {
                whitening.apply(jacobian.as_mut_slice(), rows);
            }
        }
    }

    /// Turns a singly whitened orientation residual back into a difference, rad.
    pub(super) fn turned_back(&self, turn: usize, whitened: &Vector3<f64>) -> Option<Vector3<f64>> {
        let block = self.turn_block(turn);
        let whitening = self.turn_whitening.iter().find(|w| w.blocks.contains(&block))?;
        let place = whitening.blocks.iter().position(|own| *own == block)?;
        whitening.own.fixed_view::<3, 3>(3 * place, 3 * place).into_owned().lu().solve(whitened)
    }

    /// The length that makes rotations (rad) as large as positions (m) in the residuals, from the medians of both, which gross errors do not move;
    /// 1 where there is nothing to compare.
    pub(super) fn lever(&self, residuals: &DVector<f64>) -> f64 {
        let (positions, turns) = (self.rows.len(), self.turns.len());
        let median = |first: usize, count: usize| {
            let blocks = first..first + count;
            let mut sizes: Vec<f64> = blocks.map(|b| residuals.fixed_rows::<3>(3 * b).norm()).collect();
            *sizes.select_nth_unstable_by(count / 2, f64::total_cmp).1
        };
        if positions == 0 || turns == 0 {
            return 1.0;
        }
        let lever = median(0, positions) / median(positions, turns);
        if lever > 0.0 && lever.is_finite() { lever } else { 1.0 }
    }

    /// Multiplies the rows of orientations by a factor.
    pub(super) fn scale_turns(&self, by: f64, residuals: &mut DVector<f64>, jacobian: &mut DMatrix<f64>) {
        let (first, count) = (3 * self.rows.len(), 3 * self.turns.len());
        residuals.rows_mut(first, count).scale_mut(by);
        jacobian.rows_mut(first, count).scale_mut(by);
    }
}

/// Rotation of the flange per unit of a parameter, in base axes, rad per unit; zero for the tracker's place and for a target's orientation on the
/// flange. `term` counts the terms so far.
pub(super) fn turn_column(forward: &ForwardModel, id: ParameterId, term: &mut usize) -> Vector3<f64> {
    match id {
        ParameterId::Frame { .. }
        | ParameterId::Target { .. }
        | ParameterId::Orientation { .. }
        | ParameterId::Instrument { .. }
        | ParameterId::Drift { .. } => Vector3::zeros(),
        ParameterId::Term(_) => {
            *term += 1;
            forward.term_column(*term - 1)
        }
        ParameterId::Link { .. }
        | ParameterId::Compliance(_)
        | ParameterId::Mass { .. }
        | ParameterId::Centre { .. }
        | ParameterId::Linkage(_) => forward.turn(id),
    }
}
