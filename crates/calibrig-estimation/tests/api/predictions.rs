//! What an estimate, and a robot that was read from somewhere, predict where they are asked for what is not theirs.

use std::sync::LazyLock;

use calibrig_estimation::identification::{
    CalibratedRobot, Estimate, IdentificationOptions, Mode, Predictor, identify, linearise,
};
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::nalgebra::{DMatrix, Matrix3, Vector3};
use calibrig_model::{CalibrationModel, Compliance, LinkTerm, ParameterId, PoseQuery, TermId};
use proptest::prelude::*;

use crate::names;
use crate::robots::{arm, bad};

/// An estimate with parameters of every kind.
static EXTENDED: LazyLock<(CalibrationModel, MeasurementSet, IdentificationOptions, Estimate)> =
    LazyLock::new(|| {
        let (model, set) = arm();
        let options = IdentificationOptions {
            mode: Mode::Extended,
            terms: Some(vec!["ratio".to_owned(), "hysteresis".to_owned()]),
            ..IdentificationOptions::default()
        };
        let estimate = identify(&model, &set, &options).expect("an estimate");
        (model, set, options, estimate)
    });

const COMMAND: [f64; 4] = [1.0, 0.2, -0.3, 0.4];

#[test]
fn poses_of_another_robot_are_refused() {
    let estimate = &EXTENDED.3;
    let mut many = Predictor::new(&estimate.robot).expect("a robot");
    let mut of_estimate = estimate.predictor().expect("an estimate");
    for command in [&[][..], &COMMAND[1..], &[0.0; 5]] {
        names(estimate.predict(PoseQuery::at(command)), "command", "Estimate::predict");
        names(of_estimate.predict(PoseQuery::at(command)), "command", "EstimatePredictor");
        names(many.in_base(PoseQuery::at(command)), "command", "Predictor::in_base");
        names(many.links(PoseQuery::at(command)), "command", "Predictor::links");
    }
    names(estimate.predict(PoseQuery::at(&COMMAND).approached(&[1, 1])), "approach", "Estimate::predict");
    names(estimate.predict(PoseQuery::at(&COMMAND).with_target(1)), "target index 1", "Estimate::predict");
    names(
        many.in_base(PoseQuery::at(&COMMAND).with_target(usize::MAX)),
        "target index",
        "Predictor::in_base",
    );
    let mut observation = EXTENDED.1.observations[0].clone();
    observation.station = 3;
    names(many.error_in_base(&observation), "station index 3", "Predictor::error_in_base");
    observation.station = 0;
    observation.command.pop();
    names(many.error_in_base(&observation), "command", "Predictor::error_in_base");
    let set = MeasurementSet { observations: vec![observation], ..MeasurementSet::default() };
    names(many.errors(&set), "pose 1", "Predictor::errors");
    assert!(many.errors(&MeasurementSet::default()).expect("nothing").is_empty());
}

#[test]
fn parameters_that_are_not_the_robots_are_refused() {
    let (model, set, options, estimate) = &*EXTENDED;
    for id in [
        ParameterId::link(4, LinkTerm::A),
        ParameterId::Mass { link: 9 },
        ParameterId::Compliance(Compliance::Drive { joint: 4 }),
        ParameterId::Compliance(Compliance::Bearing { joint: 1, axis: 6 }),
        ParameterId::Compliance(Compliance::Beam { link: 4 }),
        ParameterId::Target { target: 1, axis: 0 },
        ParameterId::Target { target: 0, axis: 3 },
        ParameterId::Frame { station: 1, component: 0 },
        ParameterId::Frame { station: 0, component: 6 },
        ParameterId::Term(TermId::parse("ratio_theta9").expect("a name")),
    ] {
        let mut other = estimate.clone();
        other.parameters[0].id = id;
        names(other.predictor(), &id.to_string(), "Estimate::predictor");
        names(other.predict(&COMMAND), &id.to_string(), "Estimate::predict");
        names(linearise(model, set, options, &other), &id.to_string(), "linearise");
    }
    // A term that the parameters have and the robot does not.
    let mut other = estimate.clone();
    other.robot.terms.pop();
    names(other.predict(&COMMAND), "the robot has no parameter", "Estimate::predict");
    // The same parameters in another order.
    let mut other = estimate.clone();
    other.parameters.swap(0, 1);
    names(linearise(model, set, options, &other), "delta_", "linearise");
    // The factor of another estimate says nothing of this one.
    let mut other = estimate.clone();
    other.factor = Some(DMatrix::identity(2, 2));
    assert_eq!(other.predict(&COMMAND).expect("a position").sigma(), None);
}

type RobotFault = (fn(&mut CalibratedRobot, f64), &'static str);

const ROBOT_FAULTS: [RobotFault; 13] = [
    (|robot, bad| robot.targets[0].x = bad, "targets"),
    (|robot, bad| robot.stations[0].translation.y = bad, "stations"),
    (|robot, bad| robot.terms[0].1 = bad, "terms"),
    (|robot, _| robot.terms[0].0 = TermId::parse("ratio_theta9").expect("a name"), "ratio_theta9"),
    (|robot, bad| robot.model.kinematics.links[1].theta = bad, "theta of joint 2"),
    (|robot, bad| robot.nominal.kinematics.links[3].a = bad, "a of joint 4"),
    (|robot, _| robot.nominal.kinematics.links.clear(), "no joints"),
    (|robot, _| robot.model.motor_turns.clear(), "motor_turns"),
    (|robot, _| robot.model.statics.as_mut().expect("statics").bodies.clear(), "statics.bodies"),
    (
        |robot, _| {
            robot.model = CalibrationModel::new(robot.model.kinematics.links[..2].to_vec()).expect("a chain");
        },
        "links",
    ),
    (
        |robot, _| robot.model.kinematics.links[0].kind = calibrig_model::JointKind::Revolute,
        "kinds of joints",
    ),
    (|robot, _| robot.model.statics.as_mut().expect("statics").loads.clear(), "statics.loads"),
    (|robot, _| robot.model.statics.as_mut().expect("statics").beams[0] = None, "statics.beams"),
];

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, ..ProptestConfig::default() })]

    #[test]
    fn robots_that_cannot_be_predict_nothing(fault in 0..ROBOT_FAULTS.len(), bad in bad(), mode in 0..Mode::ALL.len()) {
        let (change, field) = ROBOT_FAULTS[fault];
        let mut estimate = EXTENDED.3.clone();
        change(&mut estimate.robot, bad);
        names(Predictor::new(&estimate.robot).map(drop), field, "Predictor::new");
        names(estimate.predict(&COMMAND), field, "Estimate::predict");
        // In a mode that looks at less of it, it must return all the same.
        estimate.robot.mode = Mode::ALL[mode];
        let _ = Predictor::new(&estimate.robot).and_then(|mut predictor| predictor.in_base(&COMMAND));
        let _ = estimate.predict(&COMMAND);
    }

    #[test]
    fn commands_that_are_no_numbers_are_refused(joint in 0..4_usize, bad in bad()) {
        let mut command = COMMAND;
        command[joint] = bad;
        names(EXTENDED.3.predict(&command), "command of joint", "Estimate::predict");
    }

    #[test]
    fn values_that_are_no_numbers_are_no_linearisation(bad in bad()) {
        let (model, set, options, estimate) = &*EXTENDED;
        let mut estimate = estimate.clone();
        estimate.parameters[2].value = bad;
        names(linearise(model, set, options, &estimate), "estimate.parameters", "linearise");
    }
}

#[test]
fn the_covariance_of_a_prediction_is_that_of_its_jacobian() {
    let (model, set, options, estimate) = &*EXTENDED;
    let there = estimate.predict(&COMMAND).expect("a pose");
    let covariance = estimate.covariance.as_ref().expect("full rank");
    let expected: Matrix3<f64> = &there.jacobian * covariance * there.jacobian.transpose();
    let found = there.covariance.expect("full rank");
    assert!((found - expected).norm() <= 1e-9 * expected.norm(), "{found} {expected}");
    assert!(there.sigma().is_some_and(|sigma| sigma.iter().all(|s| *s > 0.0 && *s < 1e-3)));
    let told = linearise(model, set, options, estimate).expect("its own");
    assert_eq!(told.jacobian.ncols(), estimate.parameters.len());
    assert!(Vector3::from(there.position).norm() < 10.0);
}
