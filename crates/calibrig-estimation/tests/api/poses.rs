//! Full poses: what they determine, whether stated uncertainties hold, and what becomes of bad ones.

use calibrig_estimation::evaluation::ChiSquareTest;
use calibrig_estimation::identification::{
    Estimate, FrameChoice, IdentificationOptions, Loss, MachineNoiseChoice, ParameterChoice, SolverOptions,
    TargetChoice, identify, linearise, predict_readings, prospect,
};
use calibrig_estimation::kinematics::forward_kinematics;
use calibrig_model::geometry::{Transform, rotation_vector, rotation_x, rotation_z, translation};
use calibrig_model::measurement::{
    MeasurementSet, Observation, PoseReading, Reading, Station, Target, TargetOrientation, combine,
};
use calibrig_model::nalgebra::{Cholesky, Matrix3, Matrix6, Rotation3, Vector3, Vector6};
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::statistics::chi2_survival;
use calibrig_model::{CalibrationModel, LinkTerm, ParameterId};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal, StandardNormal};

use crate::coverage::{links, p_value, robots};

const PLACE: f64 = 20e-6;
const TURN: f64 = 60e-6;
const OFFSET: Vector3<f64> = Vector3::new(0.05, 0.08, 0.12);

/// How the target is turned on the flange: far from how nobody said that it is.
fn mounted() -> Rotation3<f64> {
    Rotation3::new(Vector3::new(0.4, -1.1, 2.2))
}

fn station() -> Transform {
    translation(3.0, 1.0, 0.5) * rotation_x(0.4) * rotation_z(2.0)
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// Position and rotation depend on each other.
fn covariance(turn: f64) -> Matrix6<f64> {
    let mut root = Matrix6::from_diagonal(&Vector6::new(PLACE, 1.5 * PLACE, PLACE, turn, 0.7 * turn, turn));
    root[(3, 1)] = 0.8 * turn;
    root[(5, 0)] = -0.5 * turn;
    root[(4, 3)] = 0.4 * turn;
    root[(1, 0)] = 0.3 * PLACE;
    root * root.transpose()
}

/// A machine whose identified links are off by draws of 0.5 mm and 1 mrad.
fn machine(
    model: &CalibrationModel,
    ids: &[ParameterId],
    rng: &mut ChaCha8Rng,
) -> (Vec<f64>, CalibrationModel) {
    let mut machine = model.clone();
    let mut truth = Vec::new();
    for id in ids {
        let ParameterId::Link { term, .. } = id else { continue };
        let size = if matches!(term, LinkTerm::A | LinkTerm::D) { 0.5e-3 } else { 1e-3 };
        let value = Normal::new(0.0, size).expect("a width").sample(rng);
        machine.kinematics.add(*id, value);
        truth.push(value);
    }
    (truth, machine)
}

fn target(known: Option<f64>) -> Target {
    Target {
        name: "probe".to_owned(),
        in_flange: OFFSET,
        covariance: None,
        orientation: Some(TargetOrientation {
            flange_from_target: known.map_or_else(Rotation3::identity, |_| mounted()),
            covariance: known.map(|sigma| Matrix3::identity() * sigma * sigma),
        }),
    }
}

fn empty(targets: Vec<Target>) -> MeasurementSet {
    let stations = vec![Station { name: "T1".to_owned(), ..Station::default() }];
    MeasurementSet { stations, targets, observations: Vec::new() }
}

fn observation(pose: u32, command: &[f64], target: usize, reading: Reading) -> Observation {
    Observation {
        pose,
        command: command.to_vec(),
        approach: Vec::new(),
        since_reversal: Vec::new(),
        temperature: None,
        time: f64::from(pose),
        station: 0,
        target,
        payload: None,
        reading,
    }
}

/// Full poses of a machine, with the noise of `root` and what is `stated` of it.
fn measured(
    machine: &CalibrationModel,
    poses: u32,
    noise: Option<&Matrix6<f64>>,
    stated: Option<&Matrix6<f64>>,
    rng: &mut ChaCha8Rng,
) -> MeasurementSet {
    let mut set = empty(vec![target(None)]);
    let root = noise.map(|covariance| Cholesky::new(*covariance).expect("definite").l());
    for pose in 1..=poses {
        let command: Vec<f64> =
            (0..machine.kinematics.joint_count()).map(|_| rng.random_range(-2.5..2.5)).collect();
        let flange = station() * forward_kinematics(&machine.kinematics, &command).expect("a pose");
        let error = root.map_or_else(Vector6::zeros, |root| root * Vector6::from_fn(|_, _| normal(rng)));
        let reading = Reading::Pose(Box::new(PoseReading {
            position: flange.rotation * OFFSET + flange.translation.vector - error.fixed_rows::<3>(0),
            rotation: Rotation3::new(-error.fixed_rows::<3>(3)) * flange.rotation * mounted(),
            covariance: stated.copied(),
        }));
        set.observations.push(observation(pose, &command, 0, reading));
    }
    set
}

/// Nothing is known of the tracker's place and of the target.
fn free() -> IdentificationOptions {
    IdentificationOptions { tolerance: None, ..IdentificationOptions::default() }
}

fn selected(model: &CalibrationModel, options: &IdentificationOptions) -> Vec<ParameterId> {
    let mut rng = stream(2, 0, StreamSource::IdentificationPoses);
    let set = measured(model, 40, None, Some(&covariance(TURN)), &mut rng);
    links(&identify(model, &set, options).expect("an estimate"))
}

#[test]
fn exact_poses_give_exact_parameters_and_an_orientation_that_nobody_stated() {
    for model in robots() {
        let ids = selected(&model, &free());
        // Four a turning joint and six in all, less the ends'.
        let expected = 4 * model.kinematics.joint_count() + 6 - 12;
        assert_eq!(ids.len(), expected, "{ids:?}");
        let mut rng = stream(3, 0, StreamSource::AsBuilt);
        let (truth, machine) = machine(&model, &ids, &mut rng);
        let set = measured(&machine, 40, None, Some(&covariance(TURN)), &mut rng);
        let estimate = identify(&model, &set, &free()).expect("an estimate");
        assert!(estimate.termination.converged() && estimate.spectrum.rank == estimate.parameters.len());
        for (id, truth) in ids.iter().zip(&truth) {
            let found = estimate.value(*id).expect("identified");
            assert!((found - truth).abs() < 1e-10, "{id}: {found} instead of {truth}");
        }
        let found = estimate.robot.orientations[0].expect("turned");
        assert!(rotation_vector(&(found * mounted().inverse())).norm() < 1e-10);
        assert!((estimate.robot.targets[0] - OFFSET).norm() < 1e-10);
        assert!(estimate.chi2 < 1e-6, "{}", estimate.chi2);
    }
}

/// Half a turn, where a rotation vector has no sign.
#[test]
fn an_unknown_orientation_may_be_half_a_turn_from_the_stated_one() {
    let [model, _] = robots();
    let mut rng = stream(4, 0, StreamSource::AsBuilt);
    let mut set = measured(&model, 30, None, Some(&covariance(TURN)), &mut rng);
    let half = Rotation3::new(std::f64::consts::PI * Vector3::y());
    let orientation = TargetOrientation { flange_from_target: mounted() * half, covariance: None };
    set.targets[0].orientation = Some(orientation);
    let estimate = identify(&model, &set, &free()).expect("an estimate");
    let found = estimate.robot.orientations[0].expect("turned");
    assert!(rotation_vector(&(found * mounted().inverse())).norm() < 1e-9);
}

/// The intervals of every link parameter, the size of the residuals, and what is predicted of the orientation elsewhere.
#[test]
fn stated_intervals_of_full_poses_hold_as_often_as_they_say() {
    let [model, _] = robots();
    let ids = selected(&model, &free());
    let trials = 200;
    let mut held = vec![0; ids.len()];
    let (mut small, mut large, mut turned) = (0, 0, 0.0);
    for trial in 0..trials {
        let mut rng = stream(12, trial, StreamSource::AsBuilt);
        let (truth, machine) = machine(&model, &ids, &mut rng);
        let noise = covariance(TURN);
        let set = measured(&machine, 30, Some(&noise), Some(&noise), &mut rng);
        let estimate = identify(&model, &set, &free()).expect("an estimate");
        let size = ChiSquareTest::new(estimate.chi2, estimate.degrees_of_freedom).expect("rows to spare");
        small += u64::from(size.p_of_less() < 0.05);
        large += u64::from(size.p_value < 0.05);
        // Where the noise was found in the residuals, the intervals are Student's.
        let factor = estimate.interval_factor(0.95);
        for ((held, id), truth) in held.iter_mut().zip(&ids).zip(&truth) {
            let parameter = estimate.parameters.iter().find(|p| p.id == *id).expect("identified");
            *held +=
                u64::from((parameter.value - truth).abs() <= factor * parameter.sigma.expect("full rank"));
        }
        let command = [0.5, -0.4, 0.9, 1.2, -0.7, 0.3];
        let predicted = estimate.predict(&command[..]).expect("a pose").orientation.expect("axes");
        let real = forward_kinematics(&machine.kinematics, &command).expect("a pose").rotation * mounted();
        let off = rotation_vector(&(real * predicted.rotation.inverse()));
        let spread = Cholesky::new(predicted.covariance.expect("full rank")).expect("definite");
        turned += off.dot(&spread.solve(&off));
    }
    let trials = u64::from(trials);
    for (held, id) in held.iter().zip(&ids) {
        let p = p_value(*held, trials, 0.95);
        assert!(p > 1e-3 / ids.len() as f64, "{id}: {held} of {trials}, p {p:.1e}");
    }
    for (count, which) in [(small, "small"), (large, "large")] {
        assert!(p_value(count, trials, 0.05) > 1e-3, "too {which}: {count} of {trials}");
    }
    let p = chi2_survival(turned, 3.0 * trials as f64);
    assert!((5e-4..1.0 - 5e-4).contains(&p), "orientation: {turned} of {}, p {p:.1e}", 3 * trials);
}

/// Three points of a rigid tool, and the poses that they combine to, hold the same information: values and standard deviations agree although
/// they come by other rows and another covariance.
#[test]
fn three_points_and_their_combined_pose_say_the_same() {
    let [model, _] = robots();
    let places =
        [Vector3::new(0.1, 0.0, 0.02), Vector3::new(-0.05, 0.09, 0.0), Vector3::new(-0.06, -0.07, -0.01)];
    let mut rng = stream(6, 0, StreamSource::AsBuilt);
    let ids = selected(&model, &free());
    let (_, machine) = machine(&model, &ids, &mut rng);
    let point = |place: &Vector3<f64>| Target {
        name: format!("{place}"),
        in_flange: OFFSET + mounted() * place,
        covariance: None,
        orientation: None,
    };
    let mut points = empty(places.iter().map(point).collect());
    let mut poses = empty(vec![target(Some(1.0))]);
    let noise = Matrix3::from_diagonal(&Vector3::new(1e-10, 9e-10, 4e-10));
    for pose in 1..=40 {
        let command: Vec<f64> = (0..6).map(|_| rng.random_range(-2.5..2.5)).collect();
        let flange = station() * forward_kinematics(&machine.kinematics, &command).expect("a pose");
        let read = |target: &Target| {
            let error = noise.map(f64::sqrt) * Vector3::from_fn(|_, _| normal(&mut rng));
            let position = flange.rotation * target.in_flange + flange.translation.vector + error;
            Reading::Cartesian { position, covariance: Some(noise) }
        };
        let readings: Vec<_> = points.targets.iter().map(read).collect();
        let seen: Vec<_> = places.iter().copied().zip(&readings).collect();
        let combined = combine(&seen).expect("a pose");
        poses.observations.push(observation(pose, &command, 0, Reading::Pose(Box::new(combined))));
        let of_points = readings.into_iter().enumerate();
        points
            .observations
            .extend(of_points.map(|(target, reading)| observation(pose, &command, target, reading)));
    }
    let options = IdentificationOptions {
        target: TargetChoice::Fixed,
        parameters: ParameterChoice::Listed(ids),
        // The three points' targets are known here, and so is all of the tool.
        fix: Vec::new(),
        frame: FrameChoice::Free,
        ..free()
    };
    let [by_points, by_poses] =
        [&points, &poses].map(|set| identify(&model, set, &options).expect("an estimate"));
    assert_eq!(by_points.parameters.len(), by_poses.parameters.len());
    assert!(by_points.found_machine().is_none() && by_poses.turn_noise.is_none());
    for (a, b) in by_points.parameters.iter().zip(&by_poses.parameters) {
        let (sigma, other) = (a.sigma.expect("full rank"), b.sigma.expect("full rank"));
        assert_eq!(a.id, b.id);
        assert!((sigma / other - 1.0).abs() < 1e-3, "{}: sigma {sigma} and {other}", a.id);
        // A free station's parameters count from where the points, or the poses, lie best on the nominal robot.
        let is_frame = matches!(a.id, ParameterId::Frame { .. });
        assert!(
            is_frame || (a.value - b.value).abs() < 0.02 * sigma,
            "{}: {} and {}",
            a.id,
            a.value,
            b.value
        );
    }
    let [a, b] = [&by_points, &by_poses].map(|estimate| estimate.robot.stations[0]);
    assert!((a.translation.vector - b.translation.vector).norm() < 1e-6);
    assert!(rotation_vector(&(a.rotation * b.rotation.inverse())).norm() < 1e-6);
}

fn within(found: f64, expected: f64, relative: f64) {
    assert!((found / expected - 1.0).abs() < relative, "{found} instead of {expected}");
}

/// Neither of the two noises is stated; both are found, and intervals are Student's.
#[test]
fn noise_that_nobody_stated_is_found_of_places_and_of_orientations() {
    let [model, _] = robots();
    let ids = selected(&model, &free());
    let sigmas = Vector6::new(PLACE, PLACE, PLACE, 2e-4, 2e-4, 2e-4);
    let noise = Matrix6::from_diagonal(&sigmas.component_mul(&sigmas));
    let trials = 100;
    let (mut held, mut squares) = (vec![0; ids.len()], 0.0);
    for trial in 0..trials {
        let mut rng = stream(13, trial, StreamSource::AsBuilt);
        let (truth, machine) = machine(&model, &ids, &mut rng);
        let set = measured(&machine, 40, Some(&noise), None, &mut rng);
        let estimate = identify(&model, &set, &free()).expect("an estimate");
        squares += estimate.turn_noise.expect("looked for").powi(2) / f64::from(trials);
        let factor = estimate.interval_factor(0.95);
        for ((held, id), truth) in held.iter_mut().zip(&ids).zip(&truth) {
            let parameter = estimate.parameters.iter().find(|p| p.id == *id).expect("identified");
            *held +=
                u64::from((parameter.value - truth).abs() <= factor * parameter.sigma.expect("full rank"));
        }
    }
    // A variance from 120 coordinates less some dozen, the mean of 100 of them: 1.4 % of standard deviation.
    within(squares.sqrt(), 2e-4, 0.03);
    for (held, id) in held.iter().zip(&ids) {
        let p = p_value(*held, u64::from(trials), 0.95);
        assert!(p > 1e-3 / ids.len() as f64, "{id}: {held} of {trials}, p {p:.1e}");
    }
}

/// A machine turns its flange by more than the sensor states: the rotations count for what they are worth.
#[test]
fn orientations_that_scatter_by_more_than_stated_do_not_drag_the_fit() {
    let [model, _] = robots();
    let ids = selected(&model, &free());
    let mut rng = stream(14, 0, StreamSource::AsBuilt);
    let (truth, machine) = machine(&model, &ids, &mut rng);
    let diagonal = |turn: f64| {
        let sigmas = Vector6::new(PLACE, PLACE, PLACE, turn, turn, turn);
        Matrix6::from_diagonal(&sigmas.component_mul(&sigmas))
    };
    let set = measured(&machine, 80, Some(&diagonal(5e-4)), Some(&diagonal(2e-5)), &mut rng);
    // What is stated of the machine's actuators, nothing, is not stated of its flange.
    for machine_noise in [MachineNoiseChoice::AsNeeded, MachineNoiseChoice::Stated(Vec::new())] {
        let options = IdentificationOptions { machine_noise, ..free() };
        let estimate = identify(&model, &set, &options).expect("an estimate");
        within(estimate.turn_noise.expect("found"), 5e-4, 0.15);
        let mut squares = 0.0;
        for (id, truth) in ids.iter().zip(&truth) {
            let parameter = estimate.parameters.iter().find(|p| p.id == *id).expect("identified");
            squares += ((parameter.value - truth) / parameter.sigma.expect("full rank")).powi(2);
        }
        // Correlated, so that the band is wide; weighed as stated they would be hundreds.
        assert!(squares < 5.0 * ids.len() as f64, "{squares} of {}", ids.len());
    }
}

/// Errors of the actuators move a target and turn it: both are explained by them, and nothing is left for a scatter of orientations.
#[test]
fn errors_of_actuators_explain_places_and_orientations_together() {
    let [model, _] = robots();
    let mut rng = stream(17, 0, StreamSource::AsBuilt);
    let sigmas = Vector6::new(PLACE, PLACE, PLACE, 2e-5, 2e-5, 2e-5);
    let noise = Matrix6::from_diagonal(&sigmas.component_mul(&sigmas));
    let mut set = empty(vec![target(None)]);
    let joints = model.kinematics.joint_count();
    for pose in 1..=120 {
        let command: Vec<f64> = (0..joints).map(|_| rng.random_range(-2.5..2.5)).collect();
        let real: Vec<f64> = command.iter().map(|q| q + 1e-4 * normal(&mut rng)).collect();
        let flange = station() * forward_kinematics(&model.kinematics, &real).expect("a pose");
        let error = Vector6::from_fn(|i, _| sigmas[i] * normal(&mut rng));
        let reading = Reading::Pose(Box::new(PoseReading {
            position: flange.rotation * OFFSET + flange.translation.vector + error.fixed_rows::<3>(0),
            rotation: Rotation3::new(error.fixed_rows::<3>(3).into_owned()) * flange.rotation * mounted(),
            covariance: Some(noise),
        }));
        set.observations.push(observation(pose, &command, 0, reading));
    }
    let estimate = identify(&model, &set, &free()).expect("an estimate");
    let found = estimate.found_machine().expect("more than was stated");
    let mean = found.actuators.iter().map(|sigma| sigma * sigma).sum::<f64>() / joints as f64;
    // 120 errors of each of six actuators: 3 % of their common standard deviation.
    within(mean.sqrt(), 1e-4, 0.1);
    let turn = estimate.turn_noise.expect("looked for");
    assert!(turn < 3e-5 && found.position < 3e-5, "{turn} {found:?}");
}

fn spoiled() -> (CalibrationModel, Vec<ParameterId>, Vec<f64>, MeasurementSet) {
    let [model, _] = robots();
    let ids = selected(&model, &free());
    let mut rng = stream(15, 0, StreamSource::AsBuilt);
    let (truth, machine) = machine(&model, &ids, &mut rng);
    let sigmas = Vector6::new(PLACE, PLACE, PLACE, TURN, TURN, TURN);
    let noise = Matrix6::from_diagonal(&sigmas.component_mul(&sigmas));
    let mut set = measured(&machine, 60, Some(&noise), Some(&noise), &mut rng);
    let Reading::Pose(pose) = &mut set.observations[17].reading else { panic!("a pose") };
    pose.rotation = Rotation3::new(Vector3::new(0.0, 0.02, 0.0)) * pose.rotation;
    (model, ids, truth, set)
}

#[test]
fn an_orientation_that_is_a_gross_error_is_named() {
    let (model, _, _, set) = spoiled();
    let estimate = identify(&model, &set, &free()).expect("an estimate");
    let [outlier] = &estimate.outliers[..] else { panic!("{:?}", estimate.outliers) };
    assert_eq!((outlier.pose, outlier.observation), (18, 17));
    assert!(outlier.turn.is_some_and(|turn| (turn - 0.02).abs() < 2e-3), "{outlier:?}");
    assert!(outlier.to_string().contains("turned by"), "{outlier}");
}

/// The position of a bad pose is not believed, either.
#[test]
fn a_robust_loss_leaves_out_a_bad_pose_as_a_whole() {
    let (model, ids, truth, set) = spoiled();
    let solver = SolverOptions { loss: Loss::tukey(), ..SolverOptions::default() };
    let options = IdentificationOptions { solver, ..free() };
    let estimate = identify(&model, &set, &options).expect("an estimate");
    assert_eq!(estimate.weights.len(), 60);
    let least = estimate.weights.iter().copied().fold(1.0, f64::min);
    assert!(estimate.weights[17] <= least && least < 1e-6, "{:?}", estimate.weights);
    for (id, truth) in ids.iter().zip(&truth) {
        let parameter = estimate.parameters.iter().find(|p| p.id == *id).expect("identified");
        let off = (parameter.value - truth) / parameter.sigma.expect("full rank");
        assert!(off.abs() < 5.0, "{id}: {off} sigma");
    }
    let system = linearise(&model, &set, &options, &estimate).expect("its own").weighted(&estimate);
    // Rows 51..54 are its position, 180 + 51.. its orientation.
    for rows in [51, 180 + 51] {
        assert!(system.residuals.rows(rows, 3).norm() < 0.1, "{}", system.residuals.rows(rows, 3));
    }
}

/// The published set of the spray painter where the target is at the wrist's centre: points miss four of it.
#[test]
fn full_poses_determine_the_published_set_at_the_wrist_centre() {
    let robot = calibrig_files::load_robot(std::path::Path::new("../../models/spray_painter/robot.toml"));
    let model = robot.expect("the shipped robot").model;
    let exact = Some(Matrix3::identity() * 1e-12);
    let orientation = TargetOrientation { flange_from_target: mounted(), covariance: exact };
    let probe = Target {
        name: "probe".to_owned(),
        in_flange: Vector3::zeros(),
        covariance: exact,
        orientation: Some(orientation),
    };
    let mut set = empty(vec![probe]);
    let links = &model.kinematics.links;
    for (pose, q) in (1..).zip(calibrig_estimation::identification::structural_poses(&model.kinematics, 40)) {
        let middle = links.iter().map(|link| 0.5 * (link.limits[0] + link.limits[1]));
        let joints: Vec<_> = q.iter().zip(middle).map(|(q, middle)| middle + 0.5 * (q - middle)).collect();
        let flange = station() * forward_kinematics(&model.kinematics, &joints).expect("a pose");
        let reading = Reading::Pose(Box::new(PoseReading {
            position: flange.translation.vector,
            rotation: flange.rotation * mounted(),
            covariance: Some(covariance(TURN)),
        }));
        let command = model.actuators.command_from_joints(&joints);
        set.observations.push(observation(pose, &command, 0, reading));
    }
    let options = IdentificationOptions {
        frame: FrameChoice::Fixed,
        target: TargetChoice::Fixed,
        ..IdentificationOptions::published()
    };
    // Placed by three nests that are seen where they are.
    for in_base in [Vector3::zeros(), Vector3::x(), Vector3::y()] {
        let position = station().rotation * in_base + station().translation.vector;
        set.stations[0].nests.push(calibrig_model::measurement::NestObservation {
            name: format!("{in_base}"),
            in_base,
            in_base_covariance: Matrix3::identity() * 1e-12,
            reading: Reading::Cartesian { position, covariance: exact },
            time: None,
        });
    }
    let of_poses = prospect(&model, &set, &options).expect("a session");
    assert_eq!((of_poses.parameters.len(), of_poses.measured_rank), (24, 24));
    let mut points = set.clone();
    for observation in &mut points.observations {
        let covariance = observation.reading.position_covariance();
        observation.reading = Reading::Cartesian { position: observation.reading.position(), covariance };
    }
    let of_points = prospect(&model, &points, &options).expect("a session");
    assert_eq!((of_points.parameters.len(), of_points.measured_rank), (24, 20));
}

/// What the estimate makes of its set again: linearised, and predicted reading by reading.
#[test]
fn an_estimate_from_poses_is_linearised_and_predicts() {
    let [model, _] = robots();
    let mut rng = stream(16, 0, StreamSource::AsBuilt);
    let noise = covariance(TURN);
    let set = measured(&model, 30, Some(&noise), Some(&noise), &mut rng);
    let estimate: Estimate = identify(&model, &set, &free()).expect("an estimate");
    let system = linearise(&model, &set, &free(), &estimate).expect("its own");
    assert_eq!((system.data_rows, system.orientations.len()), (180, 30));
    within(system.residuals.rows(0, system.measured_rows).norm_squared(), estimate.chi2, 1e-9);
    let predicted = predict_readings(&model, &set, &free(), &estimate).expect("its own").expect("full rank");
    assert_eq!(predicted.len(), 30);
    let read = estimate.robot.clone();
    let mut predictor = calibrig_estimation::identification::Predictor::new(&read).expect("a robot");
    let turns = predictor.turns(&set).expect("poses");
    assert!(turns.iter().all(|turn| turn.is_some_and(|turn| turn.norm() < 10.0 * TURN)));
}

/// Rotations that were written the other way round scatter as no robot's do: that is told, and a reason to look at the result.
#[test]
fn a_wrong_convention_of_rotations_is_told() {
    let [model, _] = robots();
    let mut rng = stream(71, 0, StreamSource::IdentificationPoses);
    let known = covariance(TURN);
    let mut set = measured(&model, 40, Some(&known), Some(&known), &mut rng);
    let reasons = |set: &MeasurementSet| -> Vec<_> {
        let estimate = identify(&model, set, &free()).expect("an estimate");
        estimate.reasons().filter_map(calibrig_estimation::identification::Warning::reason).collect()
    };
    assert!(!reasons(&set).contains(&"orientations_off"));
    for observation in &mut set.observations {
        if let Reading::Pose(pose) = &mut observation.reading {
            pose.rotation = pose.rotation.inverse();
        }
    }
    assert!(reasons(&set).contains(&"orientations_off"), "{:?}", reasons(&set));
}
