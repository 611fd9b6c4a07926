//! The noise with which measurements are weighed: that of the readings, as stated or from the residuals, and that of the machine, which its
//! model does not contain.
//!
//! The machine's noise beside its model is common to all targets of a pose: a displacement of the whole flange, and errors of the
//! actuators, `J Σ_q Jᵀ` with J the target's derivative by the commands. Errors of single poses are taken as independent of each other.

use std::ops::Range;

use nalgebra::{Cholesky, DMatrix, DMatrixViewMut, Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::contradiction::Minimum;
use super::factorised::Factorised;
use super::problem::{CalibrationProblem, PositionRow};
use super::shared::with_errors;
use super::solver::Solution;
use super::summary::Size;
use super::variance::{Block, Components, System};
use super::{IdentificationOptions, IdentifyError, LeastSquares, Redundancy};
use crate::kinematics::KinematicChain;
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::statistics::chi2_survival;
use calibrig_model::{CalibrationModel, JointKind, LinkTerm, ParameterId, Payload};

/// Standard deviation that readings without a stated one are given before the residuals are known, m: only ratios matter then.
pub(super) const UNSTATED_SIGMA: f64 = 1e-4;

/// Stated noise is kept unless residuals as large as these have a probability below this.
const DOUBTED: f64 = 0.01;

/// Variances whose total change is below this have converged.
const SETTLED: f64 = 0.05;
const MOST_ROUNDS: usize = 6;
/// With fewer degrees of freedom, residuals do not determine the noise.
pub(super) const LEAST_FREEDOM: f64 = 1.0;

/// Noise of the machine beside its model, as standard deviations of independent errors of single poses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MachineNoise {
    /// Standard deviation of the flange's displacement along each axis, m.
    pub position: f64,
    /// Standard deviation of every actuator, m or rad; empty where actuators are not considered separately.
    pub actuators: Vec<f64>,
    /// Degrees of freedom of the estimated standard deviations; `None` where they were stated.
    pub freedom: Option<f64>,
}

/// What is known of the machine's noise beside its model.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum MachineNoiseChoice {
    /// It is estimated with the parameters where the residuals are larger than the readings' stated noise explains, or where a pose's readings
    /// depend on each other.
    #[default]
    AsNeeded,
    /// It is always estimated.
    Estimated,
    /// It is known: one standard deviation per actuator, m or rad; empty for an error that is the same in all directions
    /// ([`IdentificationOptions::unmodelled_sigma`]).
    Stated(Vec<f64>),
}

impl MachineNoiseChoice {
    /// Checks the numbers; there are as many actuators as `joints`.
    pub(super) fn check(&self, joints: usize) -> Result<(), IdentifyError> {
        let Self::Stated(sigmas) = self else { return Ok(()) };
        let field = "machine_noise";
        if !sigmas.is_empty() && sigmas.len() != joints {
            let value = sigmas.len() as f64;
            return Err(IdentifyError::Number {
                field,
                value,
                expected: "a standard deviation for every actuator, or none",
            });
        }
        let wrong = sigmas.iter().find(|s| !(**s >= 0.0 && s.is_finite()));
        wrong.map_or(Ok(()), |value| {
            Err(IdentifyError::Number {
                field,
                value: *value,
                expected: "finite standard deviations of zero or more",
            })
        })
    }
}

impl MachineNoise {
    /// Covariance of the position of a target, m², in the axes of `motions`, its derivatives by every actuator.
    pub fn covariance(&self, motions: &[Vector3<f64>]) -> Matrix3<f64> {
        let isotropic = Matrix3::identity() * self.position * self.position;
        motions.iter().zip(&self.actuators).fold(isotropic, |sum, (motion, sigma)| {
            let shift = motion * *sigma;
            sum + shift * shift.transpose()
        })
    }

    fn is_none(&self) -> bool {
        self.position == 0.0 && self.actuators.iter().all(|sigma| *sigma == 0.0)
    }
}

/// How actuators move a target, for the ideal and rigid nominal robot, which is accurate enough for the size of an error.
#[derive(Debug, Clone)]
pub(super) struct ActuatorMotions {
    model: CalibrationModel,
    chain: KinematicChain,
    /// Change of the joint variables per unit of every actuator.
    joints: Vec<Vec<f64>>,
}

impl ActuatorMotions {
    pub fn new(model: &CalibrationModel) -> Self {
        let count = model.kinematics.joint_count();
        let at = |command: &[f64]| {
            let mut joints = vec![0.0; count];
            model.actuators.joints_from_command(command, &mut joints);
            joints
        };
        let still = at(&vec![0.0; count]);
        // Ideal maps are linear: a step of one gives the derivative.
        let by = |actuator: usize| {
            let mut command = vec![0.0; count];
            command[actuator] = 1.0;
            at(&command).iter().zip(&still).map(|(to, from)| to - from).collect()
        };
        Self {
            chain: KinematicChain::new(&model.kinematics),
            joints: (0..count).map(by).collect(),
            model: model.clone(),
        }
    }

    /// How every actuator turns the flange: rotation vectors in the base frame, rad/m or rad/rad.
    pub fn turns(&mut self, command: &[f64]) -> Vec<Vector3<f64>> {
        let mut joints = vec![0.0; self.joints.len()];
        self.model.actuators.joints_from_command(command, &mut joints);
        self.chain.place(&joints);
        let of_joint = |link: usize| match self.model.kinematics.links[link].kind {
            JointKind::Prismatic => Vector3::zeros(),
            JointKind::Revolute => self.chain.turn(ParameterId::Link { link, term: LinkTerm::Theta }),
        };
        let columns: Vec<_> = (0..joints.len()).map(of_joint).collect();
        let sum =
            |shares: &Vec<f64>| shares.iter().zip(&columns).map(|(share, column)| *share * column).sum();
        self.joints.iter().map(sum).collect()
    }

    /// Derivatives of a target at `in_flange` by every actuator, in the base frame, m/m or m/rad.
    pub fn at(&mut self, command: &[f64], in_flange: &Vector3<f64>) -> Vec<Vector3<f64>> {
        let mut joints = vec![0.0; self.joints.len()];
        self.model.actuators.joints_from_command(command, &mut joints);
        self.chain.place(&joints);
        let target = self.chain.target(in_flange);
        let of_joint = |link: usize| {
            let term = match self.model.kinematics.links[link].kind {
                JointKind::Prismatic => LinkTerm::D,
                JointKind::Revolute => LinkTerm::Theta,
            };
            self.chain.column(ParameterId::Link { link, term }, &target)
        };
        let columns: Vec<_> = (0..joints.len()).map(of_joint).collect();
        let sum =
            |shares: &Vec<f64>| shares.iter().zip(&columns).map(|(share, column)| *share * column).sum();
        self.joints.iter().map(sum).collect()
    }
}

/// The noise of a fit.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Noise {
    /// Noise of readings that state none, m.
    pub unstated: Option<f64>,
    /// Noise of the other readings over what they state; `None` where it was not looked for.
    pub scale: Option<f64>,
    pub machine: Option<MachineNoise>,
    /// Noise of every orientation about each axis beside what its reading states, rad.
    pub turn: Option<f64>,
    /// Degrees of freedom of Student's distribution; `None` where nothing was estimated.
    pub freedom: Option<f64>,
}

impl Noise {
    /// The variances that [`find`] found, in its order; `None` where it found nothing of what is `unknown`. Readings state noise of the size
    /// `stated`, m.
    fn variances(&self, unknown: Unknown, stated: f64) -> Option<Vec<f64>> {
        let mut variances = Vec::new();
        if unknown.readings {
            variances.push(self.unstated?.powi(2));
        }
        if unknown.scale {
            variances.push((self.scale?.powi(2) - 1.0).max(0.0) * stated * stated);
        }
        if unknown.machine {
            let machine = self.machine.as_ref()?;
            variances.push(machine.position.powi(2));
            variances.extend(machine.actuators.iter().map(|sigma| sigma * sigma));
        }
        if unknown.turn {
            variances.push(self.turn?.powi(2));
        }
        Some(variances)
    }
}

/// The observations of every pose, in the order of each pose's first one. With another payload the machine has moved in between.
pub(super) fn poses(set: &MeasurementSet) -> Vec<Vec<usize>> {
    let mut places = std::collections::HashMap::new();
    let mut poses: Vec<Vec<usize>> = Vec::new();
    for (index, observation) in set.observations.iter().enumerate() {
        let payload = observation.payload.as_ref().map(Payload::bits);
        let place = *places.entry((observation.pose, payload)).or_insert(poses.len());
        if place == poses.len() {
            poses.push(Vec::new());
        }
        poses[place].push(index);
    }
    poses
}

/// The parts of the noise that are to be found with the fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(clippy::struct_excessive_bools, reason = "any of the four can be unknown")]
pub(super) struct Unknown {
    /// Noise of readings that state none.
    pub readings: bool,
    /// Noise of readings beside what they state, where several per pose separate it from the machine's noise.
    pub scale: bool,
    pub machine: bool,
    /// Noise of orientations beside what their readings state.
    pub turn: bool,
}

impl Unknown {
    /// The unknown parts for a set under some options, before anything is fitted.
    pub fn of(problem: &CalibrationProblem, options: &IdentificationOptions) -> Self {
        let unstated = problem.rows.iter().filter(|row| row.reading.is_none()).count();
        let several = problem.poses.iter().any(|pose| pose.len() > 1);
        let mixed = unstated > 0 && unstated < problem.rows.len();
        let unknown = Self {
            readings: unstated > 0,
            scale: false,
            turn: problem.turns.iter().any(|turn| turn.reading.is_none()),
            machine: match options.machine_noise {
                MachineNoiseChoice::Stated(_) => false,
                MachineNoiseChoice::Estimated => true,
                MachineNoiseChoice::AsNeeded => unstated > 0 && (several || mixed),
            },
        };
        if unknown.machine { unknown.with_machine(problem) } else { unknown }
    }

    /// Adds the machine's noise, and with it the noise of orientations, since the machine also turns the flange, and of readings, since what readings
    /// of one pose differ by is not the machine's.
    pub fn with_machine(self, problem: &CalibrationProblem) -> Self {
        let states = |i: &&usize| problem.rows[**i].reading.is_some();
        let scale = problem.poses.iter().any(|pose| pose.iter().filter(states).count() > 1);
        Self { machine: true, scale, turn: !problem.turns.is_empty(), ..self }
    }

    pub fn any(self) -> bool {
        self.readings || self.machine || self.turn
    }

    /// Number of variances: of the readings, of the flange's position, of every actuator, and of orientations.
    fn components(self, problem: &CalibrationProblem) -> usize {
        let actuators = problem.motions.first().map_or(0, Vec::len);
        self.of_machine() + if self.machine { 1 + actuators } else { 0 } + usize::from(self.turn)
    }

    /// Index of the machine's first variance: those of the readings come before.
    fn of_machine(self) -> usize {
        usize::from(self.readings) + usize::from(self.scale)
    }

    /// Indices of the machine's variances.
    pub fn machine_components(self, problem: &CalibrationProblem) -> Range<usize> {
        self.of_machine()..self.components(problem) - usize::from(self.turn)
    }

    /// The parts of a noise that were found.
    pub fn found(noise: &Noise) -> Self {
        Self {
            readings: noise.unstated.is_some(),
            scale: noise.scale.is_some(),
            machine: noise.machine.is_some(),
            turn: noise.turn.is_some(),
        }
    }
}

/// Whether residuals are larger than their stated noise explains.
pub(super) fn is_doubted(chi2: f64, freedom: f64) -> bool {
    freedom >= LEAST_FREEDOM && chi2_survival(chi2, freedom) < DOUBTED
}

/// Finds what is `unknown` of the noise with the fit, alternating between the variances that explain the residuals of a fit and the fit that is
/// weighed with them.
pub(super) fn find(
    problem: &mut CalibrationProblem,
    mut solution: Solution,
    unknown: Unknown,
    fit: &mut impl FnMut(&mut CalibrationProblem, Vec<f64>) -> Result<Solution, IdentifyError>,
) -> Result<Solution, IdentifyError> {
    let mut before = problem.noise.variances(unknown, problem.reading_sigma());
    for _ in 0..MOST_ROUNDS {
        let (system, lever) = system(problem, &solution, unknown);
        let Some(found) = system.components(before.as_deref()) else { break };
        if before.as_ref().is_some_and(|before| is_settled(before, &found.variances, &system)) {
            break;
        }
        problem.weigh(&named(&found, unknown, problem.reading_sigma()))?;
        let System { mut residuals, jacobian, .. } = system;
        let (rows, parameters) = (problem.rows(), problem.parameters());
        residuals = residuals.resize_vertically(rows, 0.0);
        let mut jacobian = jacobian.resize(rows, parameters, 0.0);
        problem.scale_turns(1.0 / lever, &mut residuals, &mut jacobian);
        problem.whiten(&mut residuals, &mut jacobian);
        problem.start_from(&solution.x, residuals, jacobian);
        let first = std::mem::take(&mut solution.iterations);
        solution = fit(problem, solution.x)?;
        solution.iterations.splice(0..0, first);
        before = Some(found.variances);
    }
    Ok(solution)
}

/// Whether a fit leaves no degree of freedom from which to determine the noise of the readings.
pub(super) fn is_without_freedom(
    problem: &CalibrationProblem,
    solution: &Solution,
    unknown: Unknown,
    redundant: Redundancy,
) -> bool {
    let freedom = || Size::of(problem, solution, &Factorised::new(problem, solution, redundant)).freedom;
    unknown.readings && !unknown.machine && freedom() < LEAST_FREEDOM
}

/// Whether the total variance of the blocks has converged.
fn is_settled(before: &[f64], now: &[f64], system: &System) -> bool {
    let units = system.mean_squares();
    let total: f64 = now.iter().zip(&units).map(|(v, u)| v * u).sum();
    let moved: f64 = now.iter().zip(before).zip(&units).map(|((a, b), u)| (a - b).abs() * u).sum();
    moved <= SETTLED * total
}

fn named(found: &Components, unknown: Unknown, stated: f64) -> Noise {
    let mut sigmas = found.variances.iter().map(|variance| variance.sqrt());
    let unstated = if unknown.readings { sigmas.next() } else { None };
    let beside = if unknown.scale { sigmas.next() } else { None };
    let scale = beside.map(|beside| 1.0_f64.hypot(beside / stated));
    let turn = if unknown.turn { sigmas.next_back() } else { None };
    let machine = unknown.machine.then(|| MachineNoise {
        position: sigmas.next().unwrap_or(0.0),
        actuators: sigmas.collect(),
        freedom: Some(found.freedom),
    });
    Noise { unstated, scale, machine, turn, freedom: Some(found.freedom) }
}

/// Observations with a smaller weight are not used to determine the noise.
const REJECTED: f64 = 0.5;

/// The system at a solution, in metres, with the shapes of the unknown parts; rotations are multiplied by the length that is returned.
pub(super) fn system(
    problem: &mut CalibrationProblem,
    solution: &Solution,
    unknown: Unknown,
) -> (System, f64) {
    let (mut residuals, mut jacobian) = problem.metres(solution);
    if problem.shared.ncols() > 0 {
        // They are integrated out with the parameters, and belong to the known part of the noise.
        with_errors(&problem.shared, &mut residuals, &mut jacobian);
    }
    let lever = problem.lever(&residuals);
    problem.scale_turns(lever, &mut residuals, &mut jacobian);
    let data = problem.data_rows();
    let below = residuals.len() - data;
    let used = |index: &usize| solution.weights.get(*index).is_none_or(|weight| *weight >= REJECTED);
    let is_free = |column: &usize| solution.at_bound.iter().all(|at| at.parameter != *column);
    let poses = problem.poses.iter().map(|pose| pose.iter().copied().filter(used).collect::<Vec<_>>());
    let blocks =
        poses.filter(|pose| !pose.is_empty()).map(|pose| block(problem, &pose, unknown, lever)).collect();
    let system = System {
        prior_residuals: residuals.rows(data, below).into_owned(),
        prior_jacobian: jacobian.rows(data, below).into_owned(),
        residuals,
        free: (0..jacobian.ncols()).filter(is_free).collect(),
        jacobian,
        blocks,
        count: unknown.components(problem),
    }
    .without_unseen();
    (system, lever)
}

fn block(problem: &CalibrationProblem, observations: &[usize], unknown: Unknown, lever: f64) -> Block {
    let blocks = problem.blocks_of(observations);
    let (positions, size) = (3 * observations.len(), 3 * blocks.len());
    let stated = problem.stated_actuators.as_ref().map(|machine| problem.common(&blocks, machine));
    let mut known = stated.unwrap_or_else(|| DMatrix::zeros(size, size));
    problem.add_stated_turns(&blocks, &mut known);
    let unstated: Vec<_> = observations.iter().map(|i| problem.rows[*i].reading.is_none()).collect();
    for (k, i) in observations.iter().enumerate() {
        if let Some(reading) = &problem.rows[*i].reading {
            let mut own = known.fixed_view_mut::<3, 3>(3 * k, 3 * k);
            own += reading;
        }
    }
    let own: Vec<usize> =
        if unknown.readings { (0..positions).filter(|row| unstated[row / 3]).collect() } else { Vec::new() };
    let mut components = vec![0; own.len()];
    let scaled: Vec<usize> =
        if unknown.scale { (0..observations.len()).filter(|k| !unstated[*k]).collect() } else { Vec::new() };
    components.resize(own.len() + 3 * scaled.len(), usize::from(unknown.readings));
    let first = components.len();
    if unknown.machine {
        let place = unknown.of_machine();
        components.extend([place; 3]);
        components.extend(place + 1..unknown.components(problem) - usize::from(unknown.turn));
    }
    let of_machine = first..components.len();
    if unknown.turn {
        components.extend(std::iter::repeat_n(unknown.components(problem) - 1, size - positions));
    }
    let mut shapes = DMatrix::zeros(size, components.len());
    for (column, row) in own.iter().enumerate() {
        shapes[(*row, column)] = 1.0;
    }
    let sigma = if scaled.is_empty() { 1.0 } else { problem.reading_sigma() };
    for (place, k) in scaled.iter().enumerate() {
        let root = problem.rows[observations[*k]].reading.and_then(Cholesky::new).map(|root| root.l());
        shapes
            .fixed_view_mut::<3, 3>(3 * k, own.len() + 3 * place)
            .copy_from(&(root.unwrap_or_default() / sigma));
    }
    if unknown.machine {
        problem.fill_motions(&blocks, shapes.columns_range_mut(of_machine.clone()));
    }
    if unknown.turn {
        for (column, row) in (of_machine.end..).zip(positions..size) {
            shapes[(row, column)] = 1.0;
        }
    }
    let turns = size - positions;
    known.rows_mut(positions, turns).scale_mut(lever);
    known.columns_mut(positions, turns).scale_mut(lever);
    shapes.rows_mut(positions, turns).scale_mut(lever);
    Block { blocks, known, shapes, components }
}

impl CalibrationProblem {
    /// Weighs the observations with `noise`.
    pub(super) fn weigh(&mut self, noise: &Noise) -> Result<(), IdentifyError> {
        self.noise = noise.clone();
        self.start = None;
        self.joined.clear();
        self.turn_whitening.clear();
        for place in 0..self.poses.len() {
            let pose = self.poses[place].clone();
            let known = pose.iter().map(|i| self.own_covariance(*i)).collect::<Vec<_>>();
            let common = self.common_covariance(&pose);
            let weighed = match (pose.as_slice(), common) {
                ([i], Some(common)) => inverse_factor(known[0] + common.fixed_view::<3, 3>(0, 0))
                    .map(|w| self.rows[*i].whitening = w),
                (_, None) => self.weigh_apart(&pose, &known),
                (_, Some(common)) => self.weigh_together(&pose, &known, common),
            };
            let weighed = weighed.and_then(|()| self.weigh_turns(&pose, &known));
            weighed.ok_or_else(|| IdentifyError::Covariance {
                what: format!("pose {}", self.rows[pose[0]].pose),
            })?;
        }
        self.weigh_shared()
    }

    /// Weighs the observations as if none stated its noise: the same in all directions, and independently; orientations are weighed to count as much
    /// as positions in the `residuals` (m and rad).
    pub(super) fn weigh_alike(&mut self, residuals: &nalgebra::DVector<f64>) {
        self.weigh_turns_alike(UNSTATED_SIGMA / self.lever(residuals));
        self.start = None;
        self.joined.clear();
        self.shared_whitening = None;
        for row in &mut self.rows {
            row.whitening = Matrix3::identity() / UNSTATED_SIGMA;
        }
    }

    fn weigh_apart(&mut self, pose: &[usize], known: &[Matrix3<f64>]) -> Option<()> {
        for (i, known) in pose.iter().zip(known) {
            self.rows[*i].whitening = inverse_factor(*known)?;
        }
        Some(())
    }

    fn weigh_together(
        &mut self,
        pose: &[usize],
        known: &[Matrix3<f64>],
        mut common: DMatrix<f64>,
    ) -> Option<()> {
        self.weigh_apart(pose, known)?;
        for (k, i) in pose.iter().enumerate() {
            let whitening = self.rows[*i].whitening;
            let rows = whitening * common.fixed_rows::<3>(3 * k);
            common.fixed_rows_mut::<3>(3 * k).copy_from(&rows);
            let columns = common.fixed_columns::<3>(3 * k) * whitening.transpose();
            common.fixed_columns_mut::<3>(3 * k).copy_from(&columns);
        }
        let n = common.nrows();
        let factor = Cholesky::new(common + DMatrix::identity(n, n))?.l();
        let whitening = factor.solve_lower_triangular(&DMatrix::identity(n, n))?;
        self.joined.push((pose.to_vec(), whitening));
        Some(())
    }

    /// Root mean square of the standard deviations that readings state, m.
    pub(super) fn reading_sigma(&self) -> f64 {
        let stated = || self.rows.iter().filter_map(|row| row.reading);
        (stated().map(|covariance| covariance.trace() / 3.0).sum::<f64>() / stated().count().max(1) as f64)
            .sqrt()
    }

    /// The part of an observation's covariance that it does not share with the others of its pose, m².
    fn own_covariance(&self, index: usize) -> Matrix3<f64> {
        let sigma = self.noise.unstated.filter(|sigma| *sigma > 0.0).unwrap_or(UNSTATED_SIGMA);
        let unstated = || Matrix3::identity() * (sigma * sigma + self.unmodelled * self.unmodelled);
        let scale = self.noise.scale.unwrap_or(1.0);
        self.rows[index].reading.map_or_else(unstated, |stated| stated * scale * scale)
    }

    /// The machine's noise that the options state.
    pub(super) fn stated_machine(&self) -> Vec<MachineNoise> {
        let position = self.unmodelled;
        let isotropic = MachineNoise { position, actuators: Vec::new(), freedom: None };
        (position > 0.0).then_some(isotropic).into_iter().chain(self.stated_actuators.clone()).collect()
    }

    /// The covariance that blocks of one pose share, m² (rad² for orientations); `None` where they share none.
    pub(super) fn common_covariance(&self, blocks: &[usize]) -> Option<DMatrix<f64>> {
        let found = self.noise.machine.iter().filter(|machine| !machine.is_none());
        let parts = self.stated_actuators.iter().chain(found).map(|machine| self.common(blocks, machine));
        parts.reduce(|sum, part| sum + part)
    }

    /// The covariance that some machine noise gives to blocks of one pose, in the trackers' axes, m² (rad² for orientations).
    fn common(&self, blocks: &[usize], machine: &MachineNoise) -> DMatrix<f64> {
        let size = 3 * blocks.len();
        let mut spread = DMatrix::zeros(size, 3 + machine.actuators.len());
        self.fill_motions(blocks, spread.as_view_mut());
        let sigmas = std::iter::repeat_n(&machine.position, 3).chain(&machine.actuators);
        for (mut column, sigma) in spread.column_iter_mut().zip(sigmas) {
            column *= *sigma;
        }
        &spread * spread.transpose()
    }

    /// How blocks of one pose move, in the trackers' axes: with the flange along each axis, and then with as many actuators as there are columns
    /// left. Orientations turn with the actuators only.
    fn fill_motions(&self, blocks: &[usize], mut shapes: DMatrixViewMut<'_, f64>) {
        for (k, block) in blocks.iter().enumerate() {
            let (observation, turn) = self.owner(*block);
            let axes = self.stations[self.rows[observation].station].rotation;
            let motions = match turn {
                Some(turn) => &self.turn_motions[turn],
                None => {
                    shapes.fixed_view_mut::<3, 3>(3 * k, 0).copy_from(axes.matrix());
                    &self.motions[observation]
                }
            };
            let columns = 3..shapes.ncols();
            for (column, motion) in columns.zip(motions) {
                shapes.fixed_view_mut::<3, 1>(3 * k, column).copy_from(&(axes * motion));
            }
        }
    }

    /// Residuals and Jacobian of a solution with the observations in metres and rad, in the trackers' axes; priors as they are.
    pub(super) fn metres(&mut self, solution: &Solution) -> (nalgebra::DVector<f64>, DMatrix<f64>) {
        let is_apart = self.joined.is_empty() && self.turns.is_empty() && self.shared_whitening.is_none();
        if solution.weights.is_empty() && is_apart {
            self.unweighed(solution)
        } else {
            self.in_metres(&solution.x)
        }
    }

    /// The solution of least squares in the stated noise, to first order from the given solution; the problem is weighed with that noise from now
    /// on. `None` where the system is singular.
    pub(super) fn in_stated_noise(&mut self, solution: &Solution) -> Result<Option<Solution>, IdentifyError> {
        let (mut residuals, mut jacobian) = self.metres(solution);
        self.weigh(&Noise::default())?;
        self.whiten(&mut residuals, &mut jacobian);
        let is_free = |column: &usize| solution.at_bound.iter().all(|at| at.parameter != *column);
        let free: Vec<usize> = (0..jacobian.ncols()).filter(is_free).collect();
        let minimum = Minimum::of(&residuals, &jacobian, &free);
        Ok(minimum.map(|minimum| Solution {
            cost: minimum.residuals.norm_squared(),
            residuals: minimum.residuals,
            jacobian,
            ..solution.clone()
        }))
    }

    fn unweighed(&self, solution: &Solution) -> (nalgebra::DVector<f64>, DMatrix<f64>) {
        let (mut residuals, mut jacobian) = (solution.residuals.clone(), solution.jacobian.clone());
        // Whitening is the inverse of a factor.
        let factor = |row: &PositionRow| row.whitening.try_inverse().unwrap_or_else(Matrix3::identity);
        let factors: Vec<_> = self.rows.iter().map(factor).collect();
        for (i, factor) in factors.iter().enumerate() {
            let own = factor * residuals.fixed_rows::<3>(3 * i);
            residuals.fixed_rows_mut::<3>(3 * i).copy_from(&own);
        }
        for mut column in jacobian.column_iter_mut() {
            for (i, factor) in factors.iter().enumerate() {
                let own = factor * column.fixed_rows::<3>(3 * i);
                column.fixed_rows_mut::<3>(3 * i).copy_from(&own);
            }
        }
        (residuals, jacobian)
    }

    /// Residuals and Jacobian with the observations in metres, in the trackers' axes; priors as they are.
    fn in_metres(&mut self, x: &[f64]) -> (nalgebra::DVector<f64>, DMatrix<f64>) {
        let whitenings: Vec<_> = self
            .rows
            .iter_mut()
            .map(|row| std::mem::replace(&mut row.whitening, Matrix3::identity()))
            .collect();
        let joined = std::mem::take(&mut self.joined);
        let turn_whitening = std::mem::take(&mut self.turn_whitening);
        let shared_whitening = self.shared_whitening.take();
        let mut residuals = nalgebra::DVector::zeros(self.rows());
        let mut jacobian = DMatrix::zeros(self.rows(), self.parameters());
        self.start = None;
        self.evaluate(x, &mut residuals, Some(&mut jacobian));
        for (row, whitening) in self.rows.iter_mut().zip(whitenings) {
            row.whitening = whitening;
        }
        self.joined = joined;
        self.turn_whitening = turn_whitening;
        self.shared_whitening = shared_whitening;
        (residuals, jacobian)
    }
}

/// W with `W C Wᵀ = 1`.
fn inverse_factor(covariance: Matrix3<f64>) -> Option<Matrix3<f64>> {
    let whitening = Cholesky::new(covariance)?.l().try_inverse()?;
    whitening.iter().all(|v| v.is_finite()).then_some(whitening)
}
