//! Pose accuracy and repeatability (ISO 9283): on the simulated machine, and of measured cycles.

mod reach;

pub use reach::ReachError;

use std::ops::ControlFlow;

use nalgebra::{Matrix3x6, Matrix6, Rotation3, Vector3};
use thiserror::Error;

use self::reach::Reach;
pub(super) use self::reach::within;
use super::machine::AnalyticMachine;
use super::simulate::settle_options;
use super::{
    CalibrateError, InputSummary, PipelineError, PlantKind, SetKind, SetOutcome, calibrate, input_of,
    measure_session, without_drift,
};
use crate::scenario::Scenario;
use calibrig_estimation::evaluation::iso9283::{
    CubePlane, ISO_CYCLES, ISO_POSES, Iso9283Error, OrientationAccuracy, OrientationRepeatability,
    PositionAccuracy, PositionRepeatability, ScatterOverStated, TestCube, TestPose, mean_rotation,
    orientation_accuracy, orientation_repeatability, position_accuracy, position_repeatability,
    scatter_over_stated, test_poses, turn_of_points, turns_about,
};
use calibrig_estimation::identification::{
    CalibratedRobot, IdentificationOptions, IdentifyError, Loss, Mode, PredictionError, Predictor,
    predict_readings, without_calibration,
};
use calibrig_model::geometry::{Transform, cross_matrix, rotation_vector};
use calibrig_model::measurement::{MeasurementSet, Reading, RegistrationError, register};
use calibrig_model::{CalibrationModel, ModelError};
use calibrig_plant::Plant;
use calibrig_plant::session::{CycleError, CycleMeasurements, SessionEvent};
use calibrig_plant::tracker::TrackerError;

/// Settings of a test on the simulated machine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Iso9283Plan {
    /// Cycles: 30 in the standard.
    pub cycles: u32,
    /// Edge of the cube, m; `None` for the largest found in the working region.
    pub edge: Option<f64>,
    /// Its centre in the base frame, m; `None` for the target's place in the middle of the region.
    pub centre: Option<Vector3<f64>>,
    /// The plane of the poses.
    pub plane: CubePlane,
}

/// A test that cannot be carried out or evaluated.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Iso9283Failure {
    /// The cube is out of reach.
    #[error("the test cube: {0}")]
    Reach(#[from] ReachError),
    /// The session before it, or the machine.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// The machine cannot reach a pose.
    #[error("P{pose} in cycle {cycle}: {source}")]
    Pose {
        /// Number of the pose.
        pose: u32,
        /// Number of the cycle.
        cycle: u32,
        /// Why.
        source: Box<PipelineError>,
    },
    /// An identified robot has no command for a pose.
    #[error("P{pose} has no corrected command, {}: {why}", mode.title())]
    Uncorrected {
        /// Number of the pose.
        pose: u32,
        /// Of which robot.
        mode: Mode,
        /// Why.
        why: String,
    },
    /// Something hides a target from the tracker.
    #[error("P{pose} in cycle {cycle}: {why}")]
    Hidden {
        /// Number of the pose.
        pose: u32,
        /// Number of the cycle.
        cycle: u32,
        /// What.
        why: String,
    },
    /// The tracker cannot read a pose.
    #[error("P{pose} in cycle {cycle}: {source}")]
    Reading {
        /// Number of the pose.
        pose: u32,
        /// Number of the cycle.
        cycle: u32,
        /// Why.
        source: TrackerError,
    },
    /// The measurements are not cycles.
    #[error(transparent)]
    Cycles(#[from] Iso9283Error),
    /// There is no such target.
    #[error("there is no target {asked:?}: expected one of {known}")]
    Target {
        /// Asked for.
        asked: String,
        /// Those that there are.
        known: String,
    },
    /// A reading or a prediction is not a finite number.
    #[error("pose {pose} of target {target}: a position is not a finite number")]
    NotFinite {
        /// The pose.
        pose: u32,
        /// Name of the target.
        target: String,
    },
}

/// The measurements and their evaluation.
#[derive(Debug, Clone, PartialEq)]
pub struct Iso9283Outcome {
    /// Origin of the measurements.
    pub input: InputSummary,
    /// Of the robot.
    pub robot: String,
    /// Cycles at every pose.
    pub cycles: usize,
    /// The cube, if known.
    pub cube: Option<TestCube>,
    /// In which frame positions and axes are.
    pub frame: &'static str,
    /// One per target.
    pub targets: Vec<Iso9283Target>,
    /// Orientation from three or more targets together; `None` if there are fewer, or readings include it.
    pub combined: Option<CombinedOrientation>,
    /// What is left open or was left out, in words.
    pub remarks: Vec<String>,
    /// What a person must look at, in words.
    pub doubts: Vec<String>,
}

/// Results of one target.
#[derive(Debug, Clone, PartialEq)]
pub struct Iso9283Target {
    /// Its name.
    pub name: String,
    /// By their numbers.
    pub poses: Vec<Iso9283Pose>,
    /// Scatter of all poses against the stated noise; `None` if a reading states none.
    pub over_stated: Option<ScatterOverStated>,
    /// Accuracy, one row per robot that it refers to.
    pub rows: Vec<AccuracyAgainst>,
}

/// A pose of a target.
#[derive(Debug, Clone, PartialEq)]
pub struct Iso9283Pose {
    /// Its number as recorded.
    pub pose: u32,
    /// Barycentre of the attained positions, m.
    pub barycentre: Vector3<f64>,
    /// Attained positions about the barycentre, one per cycle, m.
    pub deviations: Vec<Vector3<f64>>,
    /// RP of the position.
    pub position: PositionRepeatability,
    /// RP of the orientation, if readings are full poses.
    pub orientation: Option<OrientationRepeatability>,
    /// Root of the mean squared length of the readings' stated error, m; `None` if a reading states none. It is part of RP.
    pub stated_sigma: Option<f64>,
}

/// Accuracy against what one robot predicts.
#[derive(Debug, Clone, PartialEq)]
pub struct AccuracyAgainst {
    /// `nominal_by_nests`, or the key of a mode.
    pub key: &'static str,
    /// For people.
    pub title: String,
    /// How the tracker's frame is tied to the base.
    pub registration: String,
    /// One per pose.
    pub position: Vec<PositionAccuracy>,
    /// The robot's stated error at each pose, with the tracker's place and the target's offset, which all cycles share: root of the mean squared
    /// length, m. `None` if unknown.
    pub expected_sigma: Vec<Option<f64>>,
    /// One per pose, if readings are full poses; else empty.
    pub orientation: Vec<OrientationAccuracy>,
}

/// Orientation from targets together.
#[derive(Debug, Clone, PartialEq)]
pub struct CombinedOrientation {
    /// Names of the targets.
    pub targets: Vec<String>,
    /// One per pose.
    pub repeatability: Vec<OrientationRepeatability>,
    /// By the key of the row: one per pose.
    pub accuracy: Vec<(&'static str, Vec<OrientationAccuracy>)>,
}

/// A robot whose predictions are the reference of the accuracy.
struct Against {
    key: &'static str,
    title: String,
    registration: String,
    robot: CalibratedRobot,
    states: Stated,
}

/// A robot's stated errors.
enum Stated {
    Nothing,
    /// Covariance of the displacement of each station by its nests: the robot itself is taken as exact.
    Stations(Vec<Matrix6<f64>>),
    /// Mean squared length of the error, one entry per observation, m².
    Observations(Vec<f64>),
}

impl Stated {
    /// For a target in the base frame.
    fn sigma(&self, set: &MeasurementSet, index: usize, in_base: &Vector3<f64>) -> Option<f64> {
        match self {
            Self::Nothing => None,
            Self::Observations(squares) => squares.get(index).map(|square| square.max(0.0).sqrt()),
            Self::Stations(covariances) => {
                let observation = set.observations.get(index)?;
                let covariance = covariances.get(observation.station)?;
                let mut jacobian = Matrix3x6::zeros();
                jacobian.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
                jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&-cross_matrix(in_base));
                let of_target = set.targets.get(observation.target).and_then(|target| target.covariance);
                let of_target = of_target.map_or(0.0, |covariance| covariance.trace());
                Some(((jacobian * covariance * jacobian.transpose()).trace() + of_target).max(0.0).sqrt())
            }
        }
    }
}

/// Simulates the session of a scenario, identifies in every mode, and then drives the cycles of a pose test on the same machine with the same set-up
/// of the tracker: a pure function of (scenario, seed, trial, plant, plan). `progress` receives the number of poses done and of all poses, and may
/// end the test.
///
/// # Errors
///
/// [`Iso9283Failure`].
pub fn iso9283_of_scenario(
    scenario: &Scenario,
    (seed, trial, plant): (u64, u32, PlantKind),
    plan: &Iso9283Plan,
    progress: &mut dyn FnMut(u32, u32) -> ControlFlow<()>,
) -> Result<Iso9283Outcome, Iso9283Failure> {
    let (cube, poses) = cube_of(scenario, plan)?;
    let before = scenario.identification_poses.saturating_add(scenario.verification_poses);
    let total = before.saturating_add(plan.cycles.saturating_mul(5));
    let mut done = 0;
    let simulation = measure_session(scenario, seed, trial, plant, &mut |event| match event {
        SessionEvent::Measured(_) | SessionEvent::Dropped { .. } => {
            done += 1;
            progress(done, total)
        }
        SessionEvent::Begin { .. } | SessionEvent::Set { .. } | SessionEvent::SetEnd { .. } => {
            ControlFlow::Continue(())
        }
    })?;
    let model = &scenario.robot.model;
    let measured = measure_cycles(scenario, (seed, trial, plant), &poses, plan.cycles, &mut |done, _| {
        progress(before.saturating_add(done), total)
    })?;
    let cycles =
        SetOutcome { kind: SetKind::Verification, measurements: measured.measurements, dropped: Vec::new() };
    let mut sets = simulation.sets;
    sets.push(cycles);
    let mut steady = without_drift(sets)?.sets;
    let cycles = steady.pop().map(|set| set.measurements).unwrap_or_default();
    let (registration, modes) =
        calibrate(model, &steady, &scenario.modes, &scenario.options).map_err(PipelineError::from)?;
    let set = &cycles;
    let mut remarks = Vec::new();
    let mut against = Vec::new();
    match by_nests(model, set) {
        Ok(robot) => against.push(robot),
        Err(why) => remarks.push(why),
    }
    let mut doubts = Vec::new();
    for outcome in modes {
        let registration = match &outcome.estimate {
            None => registration.how.clone(),
            Some(estimate) => {
                doubts.extend(estimate.reasons().map(|reason| format!("{}: {reason}", outcome.mode.title())));
                "identified with the robot from the identification set".to_owned()
            }
        };
        let (key, title) = (outcome.mode.key(), outcome.mode.title().to_owned());
        let options = IdentificationOptions { mode: outcome.mode, ..scenario.options.clone() };
        let predicted = outcome
            .estimate
            .as_ref()
            .and_then(|estimate| predict_readings(model, set, &options, estimate).ok()?);
        let states = predicted.map_or(Stated::Nothing, |predicted| {
            Stated::Observations(predicted.iter().map(|p| (p.of_parameters + p.of_machine).trace()).collect())
        });
        against.push(Against { key, title, registration, robot: outcome.robot, states });
    }
    let input = input_of(scenario, seed, trial, plant);
    let facts = Facts { input, robot: scenario.robot.name.clone(), cube: Some(cube), remarks, doubts };
    let targets: Vec<usize> = (0..set.targets.len()).collect();
    evaluate(set, &targets, None, &against, facts)
}

/// The test cube of a scenario and the joint variables of its poses, as the controller believes them to be.
pub(crate) fn cube_of(
    scenario: &Scenario,
    plan: &Iso9283Plan,
) -> Result<(TestCube, Vec<Vec<f64>>), ReachError> {
    let model = &scenario.robot.model;
    let in_flange = scenario.robot.target().unwrap_or(scenario.as_built.target);
    let mut reach = Reach::new(model, &scenario.region, in_flange)?;
    let gravity = model.statics.as_ref().map_or_else(Vector3::zeros, |statics| statics.gravity);
    let up = TestCube::upright(&gravity);
    let centre = plan.centre.unwrap_or_else(|| reach.middle());
    match plan.edge {
        None => reach.largest(centre, up, plan.plane),
        Some(edge) => {
            let cube = TestCube { centre, edge, up, plane: plan.plane };
            reach.poses(&cube).map(|poses| (cube, poses))
        }
    }
}

/// The cycles on the machine of a trial.
pub(crate) fn measure_cycles(
    scenario: &Scenario,
    (seed, trial, plant): (u64, u32, PlantKind),
    poses: &[Vec<f64>],
    cycles: u32,
    progress: &mut dyn FnMut(u32, u32) -> ControlFlow<()>,
) -> Result<CycleMeasurements, Iso9283Failure> {
    let scenario = &*scenario.of_trial(seed, trial);
    let session = scenario.session();
    let at = (seed, trial);
    match plant {
        PlantKind::Rapier => {
            let mut machine =
                Plant::new(&scenario.as_built, settle_options(trial)).map_err(PipelineError::from)?;
            session.measure_cycles(&mut machine, at, poses, cycles, progress).map_err(cycles_failed)
        }
        PlantKind::Analytic => {
            let mut machine = AnalyticMachine::new(&scenario.as_built)?;
            session.measure_cycles(&mut machine, at, poses, cycles, progress).map_err(cycles_failed)
        }
    }
}

pub(super) fn cycles_failed<E: Into<PipelineError>>(error: CycleError<E>) -> Iso9283Failure {
    match error {
        CycleError::Session(error) => Iso9283Failure::Pipeline(error.into()),
        CycleError::Joints { found, expected, .. } => {
            ReachError::Model(ModelError::Length { field: "a pose of the test", found, expected }).into()
        }
        CycleError::Pose { pose, cycle, source } => {
            Iso9283Failure::Pose { pose, cycle, source: Box::new(source.into()) }
        }
        CycleError::Hidden { pose, cycle, why } => Iso9283Failure::Hidden { pose, cycle, why },
        CycleError::Reading { pose, cycle, source } => Iso9283Failure::Reading { pose, cycle, source },
    }
}

/// What is known besides the measurements.
struct Facts {
    input: InputSummary,
    robot: String,
    cube: Option<TestCube>,
    remarks: Vec<String>,
    doubts: Vec<String>,
}

/// Evaluates measured cycles: of the target with this name, else of every one; of the first `cycles` if given. Accuracy is that of the nominal robot,
/// with the tracker tied to the base by its nests and, if enough coordinates remain, by a best fit.
///
/// # Errors
///
/// [`Iso9283Failure`].
pub fn iso9283_of_set(
    input: InputSummary,
    (name, model): (String, &CalibrationModel),
    set: &MeasurementSet,
    target: Option<&str>,
    cycles: Option<usize>,
) -> Result<Iso9283Outcome, Iso9283Failure> {
    set.check(model.kinematics.joint_count())
        .map_err(|error| CalibrateError::Identify { mode: Mode::WithoutCalibration, source: error.into() })
        .map_err(PipelineError::from)?;
    let seen = |index: &usize| set.observations.iter().any(|o| o.target == *index);
    let targets: Vec<usize> = match target {
        None => (0..set.targets.len()).filter(seen).collect(),
        Some(asked) => match set.targets.iter().position(|target| target.name == asked) {
            Some(index) => vec![index],
            None => {
                let known: Vec<_> = set.targets.iter().map(|target| target.name.as_str()).collect();
                return Err(Iso9283Failure::Target { asked: asked.to_owned(), known: known.join(", ") });
            }
        },
    };
    let mut facts = Facts { input, robot: name, cube: None, remarks: Vec::new(), doubts: Vec::new() };
    let mut against = Vec::new();
    let unknown: Vec<_> =
        targets.iter().filter(|i| is_unknown(set, **i)).map(|i| set.targets[*i].name.as_str()).collect();
    if unknown.is_empty() {
        match by_nests(model, set) {
            Ok(robot) => against.push(robot),
            Err(why) => facts.remarks.push(why),
        }
    } else {
        facts.remarks.push(format!(
            "no accuracy by nests: the offset of target {} on the flange is not stated ([target] of the robot's file, or \
             --session)",
            unknown.join(", ")
        ));
    }
    match by_best_fit(model, set) {
        Ok(robot) => against.push(robot),
        Err(why) => facts.remarks.push(why),
    }
    evaluate(set, &targets, cycles, &against, facts)
}

/// Whether the offset of a target is only a starting value.
fn is_unknown(set: &MeasurementSet, target: usize) -> bool {
    set.targets.get(target).is_none_or(|t| t.covariance.is_none() && t.in_flange.norm() == 0.0)
}

/// The nominal robot with its stations placed by their nests; or why not, in words.
fn by_nests(model: &CalibrationModel, set: &MeasurementSet) -> Result<Against, String> {
    let stations: Result<Vec<_>, RegistrationError> = set.stations.iter().map(register).collect();
    let stations = stations.map_err(|why| match why {
        RegistrationError::TooFewNests { found: 0 } => {
            "no accuracy by nests: no base nests were measured, so nothing ties the tracker to the base (--session)".to_owned()
        }
        why => format!("no accuracy by nests: {why}"),
    })?;
    Ok(Against {
        key: "nominal_by_nests",
        title: format!("{}, by nests", Mode::WithoutCalibration.title()),
        registration: "tracker placed by the base nests".to_owned(),
        robot: CalibratedRobot {
            mode: Mode::WithoutCalibration,
            nominal: model.clone(),
            model: model.clone(),
            terms: Vec::new(),
            stations: stations.iter().map(|station| station.tracker_from_base).collect(),
            targets: set.targets.iter().map(|target| target.in_flange).collect(),
            orientations: set
                .targets
                .iter()
                .map(|target| target.orientation.as_ref().map(|turned| turned.flange_from_target))
                .collect(),
            instruments: Vec::new(),
        },
        states: Stated::Stations(stations.iter().map(|station| station.covariance).collect()),
    })
}

/// A best fit needs at least this many coordinates of distinct poses per number that it fits: otherwise it absorbs most of the
/// accuracy.
const COORDINATES_PER_NUMBER: usize = 3;

/// The nominal robot fitted to the measurements; or why not, in words.
fn by_best_fit(model: &CalibrationModel, set: &MeasurementSet) -> Result<Against, String> {
    let fitted = 6 * set.stations.len() + 3 * set.targets.iter().filter(|t| t.covariance.is_none()).count();
    let coordinates = 3 * set.same_commands().len();
    if coordinates < COORDINATES_PER_NUMBER * fitted {
        return Err(format!(
            "no accuracy by a best fit: it would fit {fitted} numbers to the {coordinates} coordinates of these poses, and \
             absorb most of the errors"
        ));
    }
    let robot = without_calibration(model, set, Loss::Squared)
        .map_err(|why: IdentifyError| format!("no accuracy by a best fit: {why}"))?;
    Ok(Against {
        key: Mode::WithoutCalibration.key(),
        title: Mode::WithoutCalibration.title().to_owned(),
        registration: format!(
            "best fit of the nominal robot to these cycles, {fitted} numbers free: smaller than the standard's accuracy"
        ),
        robot,
        states: Stated::Nothing,
    })
}

/// The cycles of every target against every robot.
fn evaluate(
    set: &MeasurementSet,
    targets: &[usize],
    cycles: Option<usize>,
    against: &[Against],
    facts: Facts,
) -> Result<Iso9283Outcome, Iso9283Failure> {
    let Facts { input, robot, cube, mut remarks, doubts } = facts;
    let stations = against.first().map(|first| first.robot.stations.as_slice());
    let mut tests = Vec::new();
    for target in targets {
        let (poses, once) = test_poses(set, *target, cycles)?;
        remarks.extend(remarks_on(&set.targets[*target].name, &poses, once));
        tests.push((*target, poses));
    }
    let cycles =
        tests.iter().flat_map(|(_, poses)| poses).map(|pose| pose.observations.len()).min().unwrap_or(0);
    if cycles < ISO_CYCLES {
        remarks.push(format!(
            "{cycles} cycles: the standard asks for {ISO_CYCLES}; the intervals are those of {cycles}"
        ));
    }
    let mut rows = Vec::new();
    for against in against {
        match errors_against(&against.robot, set, &tests) {
            Ok(errors) => rows.push((against, errors)),
            Err(why) => remarks.push(format!("no accuracy of {}: {why}", against.title)),
        }
    }
    let frames = Frames { set, stations };
    let mut evaluated = Vec::new();
    for (target, poses) in &tests {
        let name = set.targets[*target].name.clone();
        let missing = |pose: &TestPose| Iso9283Failure::NotFinite { pose: pose.pose, target: name.clone() };
        let of_pose = |pose: &TestPose| frames.pose(pose).ok_or_else(|| missing(pose));
        let of_row = |(against, errors): &(&Against, Errors)| {
            let position = |pose: &TestPose| {
                let own: Vec<_> = pose.observations.iter().map(|i| errors.position[*i]).collect();
                position_accuracy(&own).ok_or_else(|| missing(pose))
            };
            let orientation = |pose: &TestPose| {
                let own: Option<Vec<_>> = pose.observations.iter().map(|i| errors.turn[*i]).collect();
                own.and_then(|turns| orientation_accuracy(&turns))
            };
            let expected = |pose: &TestPose| {
                let index = *pose.observations.first()?;
                against.states.sigma(set, index, &errors.predicted[index])
            };
            Ok(AccuracyAgainst {
                key: against.key,
                title: against.title.clone(),
                registration: against.registration.clone(),
                position: poses.iter().map(position).collect::<Result<_, Iso9283Failure>>()?,
                expected_sigma: poses.iter().map(expected).collect(),
                orientation: poses.iter().map(orientation).collect::<Option<_>>().unwrap_or_default(),
            })
        };
        let poses_of_target: Vec<Iso9283Pose> = poses.iter().map(of_pose).collect::<Result<_, _>>()?;
        let stated: Option<Vec<_>> =
            poses_of_target.iter().map(|pose| Some((pose.position, pose.stated_sigma?))).collect();
        evaluated.push(Iso9283Target {
            poses: poses_of_target,
            over_stated: stated.and_then(|poses| scatter_over_stated(&poses)),
            rows: rows.iter().map(of_row).collect::<Result<_, Iso9283Failure>>()?,
            name: name.clone(),
        });
    }
    let combined = combined(&frames, &tests, &rows);
    let frame = if stations.is_some() { "base" } else { "tracker" };
    Ok(Iso9283Outcome { input, robot, cycles, cube, frame, targets: evaluated, combined, remarks, doubts })
}

/// How the cycles of a target differ from the standard.
fn remarks_on(target: &str, poses: &[TestPose], once: usize) -> Vec<String> {
    let mut remarks = Vec::new();
    if poses.len() != ISO_POSES {
        remarks.push(format!(
            "target {target}: {} poses, but the standard asks for {ISO_POSES} in a plane of the cube",
            poses.len()
        ));
    }
    if once > 0 {
        remarks.push(format!("target {target}: {once} poses that were measured only once are left out"));
    }
    let mixed: Vec<_> =
        poses.iter().filter(|pose| pose.mixed_approach).map(|pose| pose.pose.to_string()).collect();
    if !mixed.is_empty() {
        remarks.push(format!(
            "target {target}: poses {} are approached from different sides, but the standard asks for one: play of the drives \
             adds to their scatter",
            mixed.join(", ")
        ));
    }
    remarks
}

/// Measured minus predicted in the base frame, one per observation; zero if no test needs it.
struct Errors {
    position: Vec<Vector3<f64>>,
    /// Rotation vectors of full poses, rad.
    turn: Vec<Option<Vector3<f64>>>,
    /// Where the targets are predicted, m.
    predicted: Vec<Vector3<f64>>,
}

fn errors_against(
    robot: &CalibratedRobot,
    set: &MeasurementSet,
    tests: &[(usize, Vec<TestPose>)],
) -> Result<Errors, PredictionError> {
    let count = set.observations.len();
    let mut errors = Errors {
        position: vec![Vector3::zeros(); count],
        turn: vec![None; count],
        predicted: vec![Vector3::zeros(); count],
    };
    let mut predictor = Predictor::new(robot)?;
    for index in tests.iter().flat_map(|(_, poses)| poses).flat_map(|pose| &pose.observations) {
        let observation = &set.observations[*index];
        errors.position[*index] = predictor.error_in_base(observation)?;
        errors.predicted[*index] = predictor.in_base(observation)?;
        let orientation = set.targets.get(observation.target).and_then(|target| target.orientation.as_ref());
        if let (Reading::Pose(pose), Some(on_flange)) = (&observation.reading, orientation)
            && let Some(last) = predictor.links(observation)?.last()
        {
            let flange = last.rotation * robot.model.kinematics.last_from_flange.rotation;
            let predicted = flange * on_flange.flange_from_target;
            let measured = robot.stations[observation.station].rotation.inverse() * pose.rotation;
            errors.turn[*index] = Some(rotation_vector(&(measured * predicted.inverse())));
        }
    }
    Ok(errors)
}

/// Readings in one frame: the base's if stations are placed, else the tracker's.
struct Frames<'a> {
    set: &'a MeasurementSet,
    stations: Option<&'a [Transform]>,
}

impl Frames<'_> {
    fn base_from_tracker(&self, station: usize) -> Transform {
        self.stations
            .and_then(|stations| stations.get(station))
            .map_or_else(Transform::identity, Transform::inverse)
    }

    fn position(&self, index: usize) -> Vector3<f64> {
        let observation = &self.set.observations[index];
        let base_from_tracker = self.base_from_tracker(observation.station);
        base_from_tracker.rotation * observation.reading.position() + base_from_tracker.translation.vector
    }

    fn rotation(&self, index: usize) -> Option<Rotation3<f64>> {
        let observation = &self.set.observations[index];
        match &observation.reading {
            Reading::Pose(pose) => Some(self.base_from_tracker(observation.station).rotation * pose.rotation),
            Reading::Spherical(_) | Reading::Cartesian { .. } => None,
        }
    }

    fn pose(&self, pose: &TestPose) -> Option<Iso9283Pose> {
        let attained: Vec<_> = pose.observations.iter().map(|i| self.position(*i)).collect();
        let position = position_repeatability(&attained)?;
        let barycentre = attained.iter().sum::<Vector3<f64>>() / attained.len() as f64;
        let rotations: Option<Vec<_>> = pose.observations.iter().map(|i| self.rotation(*i)).collect();
        let orientation = rotations.and_then(|rotations| {
            orientation_repeatability(&turns_about(&rotations, &mean_rotation(&rotations)?))
        });
        let stated: Option<Vec<f64>> = pose
            .observations
            .iter()
            .map(|i| Some(self.set.observations[*i].reading.position_covariance()?.trace()))
            .collect();
        Some(Iso9283Pose {
            pose: pose.pose,
            barycentre,
            deviations: attained.iter().map(|p| p - barycentre).collect(),
            position,
            orientation,
            stated_sigma: stated.map(|traces| (traces.iter().sum::<f64>() / traces.len() as f64).sqrt()),
        })
    }
}

/// Orientation from three or more points that were measured in the same poses and cycles; `None` if they are fewer, on one line, or have orientations
/// of their own.
fn combined(
    frames: &Frames<'_>,
    tests: &[(usize, Vec<TestPose>)],
    rows: &[(&Against, Errors)],
) -> Option<CombinedOrientation> {
    let (first, others) = tests.split_first()?;
    let alike = |other: &(usize, Vec<TestPose>)| {
        let ends =
            |test: &[TestPose]| test.iter().map(|p| (p.pose, p.observations.len())).collect::<Vec<_>>();
        ends(&other.1) == ends(&first.1)
    };
    let is_pose = |index: usize| matches!(frames.set.observations[index].reading, Reading::Pose(_));
    let any_pose = first.1.iter().flat_map(|p| &p.observations).any(|i| is_pose(*i));
    if others.len() < 2 || !others.iter().all(alike) || any_pose {
        return None;
    }
    // The readings of the targets in one cycle of one pose.
    let cycle = |pose: usize, cycle: usize| {
        tests.iter().map(move |(_, poses)| poses[pose].observations[cycle]).collect::<Vec<usize>>()
    };
    let points = |indices: &[usize]| indices.iter().map(|i| frames.position(*i)).collect::<Vec<_>>();
    let mut repeatability = Vec::new();
    for (place, pose) in first.1.iter().enumerate() {
        let cycles = pose.observations.len();
        let all: Vec<Vec<_>> = (0..cycles).map(|c| points(&cycle(place, c))).collect();
        let mean: Vec<Vector3<f64>> = (0..tests.len())
            .map(|target| all.iter().map(|points| points[target]).sum::<Vector3<f64>>() / cycles as f64)
            .collect();
        let turns: Option<Vec<_>> = all.iter().map(|points| turn_of_points(points, &mean)).collect();
        repeatability.push(orientation_repeatability(&turns?)?);
    }
    let of_row = |(against, errors): &(&Against, Errors)| {
        let of_pose = |(place, pose): (usize, &TestPose)| {
            let turn = |c: usize| {
                let indices = cycle(place, c);
                let predicted: Vec<_> = indices.iter().map(|i| errors.predicted[*i]).collect();
                let measured: Vec<_> =
                    indices.iter().map(|i| errors.predicted[*i] + errors.position[*i]).collect();
                turn_of_points(&measured, &predicted)
            };
            let turns: Option<Vec<_>> = (0..pose.observations.len()).map(turn).collect();
            orientation_accuracy(&turns?)
        };
        Some((against.key, first.1.iter().enumerate().map(of_pose).collect::<Option<Vec<_>>>()?))
    };
    Some(CombinedOrientation {
        targets: tests.iter().map(|(target, _)| frames.set.targets[*target].name.clone()).collect(),
        repeatability,
        accuracy: rows.iter().filter_map(of_row).collect(),
    })
}
