//! From a robot, candidate poses and a region to rows: the system that a fit of these poses would solve.

use nalgebra::{DMatrix, SymmetricEigen};

use super::order::DriftCoupling;
use super::{DesignRows, DesignSpace, ParameterScale, PlanError};
use crate::identification::{
    Estimate, IdentificationOptions, NoiseScale, PlannedRows, PlannedSystem, PredictionError, Tolerance,
};
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::{CalibrationModel, ModelError, ParameterId, PoseQuery};

/// Number of rows of a point that is seen once.
const ROWS_OF_A_READING: usize = 3;
/// Share of the largest eigenvalue below which a combination of rows counts as rounding.
const SAME_ROW: f64 = 1e-13;
/// Most iterations of an eigenvalue decomposition.
const MOST_TURNS: usize = 1000;
/// How far a joint may be beyond its limits because of rounding, m or rad.
const ROUNDING: f64 = 1e-9;

/// Candidate poses of a robot, poses that are already measured, and the region where the robot will work. All observations with the same pose number
/// are one pose: several targets or stations, with and without a payload.
#[derive(Debug, Clone)]
pub struct PlannedSession<'a> {
    system: PlannedSystem,
    rows: PlannedRows,
    /// Indices of the candidates among the poses of the system, and their numbers.
    places: Vec<usize>,
    candidates: Vec<u32>,
    region: Vec<PoseQuery<'a>>,
}

impl<'a> PlannedSession<'a> {
    /// The session of `set`: candidates with the readings that a fit would get, and poses that are already `measured` (by number), which count
    /// whatever is chosen. Of a candidate's readings only the covariance is used, and at most their place, to place a free tracker. Terms of
    /// hysteresis depend on the signs of approach that the candidates state. The target is predicted at the poses of the `region`, which may be
    /// empty.
    ///
    /// Without an `estimate`, the nominal robot is examined. With the `estimate` of a previous fit of some poses, it is the robot that this fit
    /// found, in the noise that it found, with the compliances and terms that it fitted.
    ///
    /// The parameters are those that a fit of all candidates would have; a fit of the chosen ones may leave out a compliance that gravity hardly
    /// loads there. Errors that readings share through the correction of a drift are treated as each reading's own.
    ///
    /// # Errors
    ///
    /// [`PlanError`]: as in [`identify`](crate::identification::identify) for a set that does not fit this robot; without candidates; for a planned
    /// reading without a covariance; for poses beyond the robot's limits, or that it cannot take.
    pub fn new(
        model: &CalibrationModel,
        set: &MeasurementSet,
        options: &IdentificationOptions,
        estimate: Option<&Estimate>,
        measured: &[u32],
        region: &[PoseQuery<'a>],
    ) -> Result<Self, PlanError> {
        let is_measured = |pose: u32| measured.contains(&pose);
        if set.observations.iter().all(|observation| is_measured(observation.pose)) {
            return Err(PlanError::NoCandidates);
        }
        let known = |pose: &&u32| !set.observations.iter().any(|observation| observation.pose == **pose);
        if let Some(pose) = measured.iter().find(known) {
            return Err(PlanError::UnknownMeasured { pose: *pose });
        }
        let mut apart = set.clone();
        apart.stations.iter_mut().for_each(|station| station.motion = None);
        let mut system = PlannedSystem::new(model, &apart, options, estimate)?;
        let finds_noise = estimate.is_some_and(|estimate| matches!(estimate.noise, NoiseScale::Residuals(_)));
        for observation in &set.observations {
            let pose = observation.pose;
            if observation.reading.position_covariance().is_none() && !finds_noise {
                return Err(PlanError::NoNoise { pose });
            }
            if !is_measured(pose) {
                within_limits(model, &observation.command, || format!("candidate pose {pose}"))?;
            }
        }
        for (index, pose) in region.iter().enumerate() {
            check_pose(model, pose, system.targets())
                .map_err(|source| PlanError::Region { index, source })?;
            within_limits(model, pose.command, || format!("pose {} of the region", index + 1))?;
        }
        let rows = merged(system.rows(None)?);
        let numbers: Vec<u32> = system.poses().collect();
        let places: Vec<usize> = (0..numbers.len()).filter(|place| !is_measured(numbers[*place])).collect();
        let candidates = places.iter().map(|place| numbers[*place]).collect();
        Ok(Self { system, rows, places, candidates, region: region.to_vec() })
    }

    /// The parameters that a fit of all candidates would have.
    pub fn parameters(&self) -> &[ParameterId] {
        self.system.parameters()
    }

    /// Number of every candidate pose, in the order of the space's candidates.
    pub fn candidates(&self) -> &[u32] {
        &self.candidates
    }

    /// The space of the candidates.
    ///
    /// # Errors
    ///
    /// [`PlanError`], as [`DesignSpace::new`], and for a pose of the region that the robot cannot take.
    pub fn space(&mut self, scale: &ParameterScale) -> Result<DesignSpace, PlanError> {
        let rows = self.rows.clone();
        self.space_of(None, &rows, scale)
    }

    /// First the space of the nominal robot, then those of `robots` robots as they could have been made, with the same scale: every parameter
    /// deviates as in its own prior, link parameters without one by `tolerance`; tracker and targets do not deviate. A plan over these does not rely
    /// on the nominal robot.
    ///
    /// # Errors
    ///
    /// As [`space`](Self::space), and [`PlanError::Drawn`] where a drawn robot cannot take a pose.
    pub fn spaces_of_robots(
        &mut self,
        robots: u32,
        tolerance: Tolerance,
        seed: u64,
        scale: &ParameterScale,
    ) -> Result<Vec<DesignSpace>, PlanError> {
        for (field, value) in
            [("the tolerance of lengths", tolerance.length), ("the tolerance of angles", tolerance.angle)]
        {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(PlanError::Number { field, value, expected: "a finite number of zero or more" });
            }
        }
        let mut spaces = vec![self.space(scale)?];
        let scale = ParameterScale::Given(spaces[0].scale().to_vec());
        for robot in 0..robots {
            let x = self.system.drawn(tolerance, &mut stream(seed, robot, StreamSource::PlannedRobots));
            let robot = robot as usize;
            let rows = self.system.rows(Some(&x)).map_err(|source| PlanError::Drawn { robot, source })?;
            spaces.push(self.space_of(Some(&x), &merged(rows), &scale)?);
        }
        Ok(spaces)
    }

    fn space_of(
        &mut self,
        x: Option<&[f64]>,
        rows: &PlannedRows,
        scale: &ParameterScale,
    ) -> Result<DesignSpace, PlanError> {
        let measured = (0..rows.poses.len()).filter(|place| self.places.binary_search(place).is_err());
        let mut fixed = vec![&rows.priors];
        fixed.extend(measured.map(|place| &rows.poses[place]));
        let mut design = DesignRows {
            candidates: self.places.iter().map(|place| rows.poses[*place].clone()).collect(),
            fixed: stacked(&fixed, self.system.parameters().len()),
            ..DesignRows::default()
        };
        for (index, pose) in self.region.iter().enumerate() {
            let place = self
                .system
                .place(x, pose)
                .map_err(|source| PlanError::Region { index, source: source.into() })?;
            design.region.push(place.jacobian);
            design.beside.push(place.of_machine.trace());
        }
        DesignSpace::new(self.system.parameters().to_vec(), &design, scale)
    }

    /// How strongly a drift of the tracker (or of the base) along each axis, proportional to time, would be absorbed by parameters, for chosen
    /// candidates of a nominal `space`.
    ///
    /// # Errors
    ///
    /// [`PlanError::Singular`], where the chosen poses do not determine the parameters.
    pub fn drift_coupling(&self, space: &DesignSpace, chosen: &[usize]) -> Result<DriftCoupling, PlanError> {
        space.figures(chosen)?;
        let shift = |candidate: &usize| &self.rows.shifts[self.places[*candidate]];
        let shifts: Vec<_> = chosen.iter().map(shift).collect();
        Ok(DriftCoupling::new(space, chosen, &shifts))
    }
}

/// Reduces rows of poses that are read more than once to as few as have the same information: repeated visits repeat rows, and the time of the search
/// grows with the square of their number. An orthogonal transformation changes neither the information nor its coupling with drift.
fn merged(mut rows: PlannedRows) -> PlannedRows {
    for (pose, shift) in rows.poses.iter_mut().zip(&mut rows.shifts) {
        if pose.nrows() <= ROWS_OF_A_READING {
            continue;
        }
        let products = &*pose * pose.transpose();
        let Some(turns) = SymmetricEigen::try_new(products, f64::EPSILON, MOST_TURNS) else { continue };
        let largest = turns.eigenvalues.max();
        let told: Vec<usize> =
            (0..pose.nrows()).filter(|row| turns.eigenvalues[*row] > SAME_ROW * largest).collect();
        if told.len() == pose.nrows() {
            continue;
        }
        let turn = turns.eigenvectors.select_columns(&told);
        let (turned, left) = (turn.tr_mul(pose), turn.tr_mul(shift));
        *pose = turned;
        *shift = left;
    }
    rows
}

fn stacked(matrices: &[&DMatrix<f64>], columns: usize) -> DMatrix<f64> {
    let mut all = DMatrix::zeros(matrices.iter().map(|matrix| matrix.nrows()).sum(), columns);
    let mut first = 0;
    for matrix in matrices {
        all.rows_mut(first, matrix.nrows()).copy_from(matrix);
        first += matrix.nrows();
    }
    all
}

fn check_pose(model: &CalibrationModel, pose: &PoseQuery<'_>, targets: usize) -> Result<(), PredictionError> {
    model.kinematics.check_joints("command", pose.command)?;
    let (found, expected) = (pose.approach.len(), pose.command.len());
    if found != 0 && found != expected {
        return Err(ModelError::Length { field: "approach", found, expected }.into());
    }
    let found = pose.since_reversal.len();
    if found != 0 && found != expected {
        return Err(ModelError::Length { field: "since_reversal", found, expected }.into());
    }
    let numbers = [("time", Some(pose.time)), ("temperature", pose.temperature)];
    for (field, value) in numbers {
        if let Some(value) = value.filter(|value| !value.is_finite()) {
            return Err(ModelError::Number { field, joint: None, value, expected: "a finite number" }.into());
        }
    }
    if pose.target >= targets {
        return Err(PredictionError::Target { target: pose.target, targets });
    }
    Ok(())
}

/// Whether a command keeps every joint within its limits.
pub(super) fn within_limits(
    model: &CalibrationModel,
    command: &[f64],
    what: impl Fn() -> String,
) -> Result<(), PlanError> {
    let mut joints = vec![0.0; model.kinematics.joint_count()];
    model.actuators.joints_from_command(command, &mut joints);
    for (joint, (value, link)) in joints.iter().zip(&model.kinematics.links).enumerate() {
        let [low, high] = link.limits;
        if !(*value >= low - ROUNDING && *value <= high + ROUNDING) {
            return Err(PlanError::OutsideLimits { what: what(), joint, value: *value, limits: link.limits });
        }
    }
    Ok(())
}
