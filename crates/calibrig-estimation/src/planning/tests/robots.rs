//! Compares the planned system with the one that is fitted.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Matrix3, Vector3};

use crate::identification::{
    CalibratedRobot, Estimate, FrameChoice, IdentificationOptions, MachineNoiseChoice, Mode, Predictor,
    Tolerance, identify,
};
use crate::planning::{
    Choice, Criterion, Over, ParameterScale, PlanError, PlannedSession, candidate_commands, choose,
};
use calibrig_model::geometry::Transform;
use calibrig_model::measurement::{MeasurementSet, NestObservation, Observation, Reading, Station, Target};
use calibrig_model::{Body, CalibrationModel, CraigLink, ParameterId, Payload, PoseQuery, StaticProperties};

/// A rail and three axes, whose drives sag.
pub(super) fn arm() -> CalibrationModel {
    let mut model = CalibrationModel::new(vec![
        CraigLink::prismatic("rail").row(0.0, 0.0, 0.0, 0.0).limits(0.0, 3.0),
        CraigLink::revolute("shoulder").row(0.2, FRAC_PI_2, 0.0, 0.0).limits(-1.5, 1.5),
        CraigLink::revolute("elbow").row(0.9, 0.0, 0.0, 0.0).limits(-2.0, 2.0),
        CraigLink::revolute("wrist").row(0.1, -FRAC_PI_2, 0.7, 0.0).limits(-3.0, 3.0),
    ])
    .expect("a robot");
    let body = |mass| Body {
        mass,
        centre_of_mass: Vector3::new(0.3, 0.0, 0.05),
        inertia: Matrix3::identity() * 0.1,
    };
    let bodies = vec![body(50.0), body(30.0), body(20.0), body(5.0)];
    let gravity = Vector3::new(0.0, -9.80665, 0.0);
    model.statics = Some(StaticProperties::of_drives(bodies, vec![1e7, 5e4, 5e4, 2e4], gravity));
    model
}

pub(super) const LIMITS: [[f64; 2]; 4] = [[0.0, 3.0], [-1.2, 1.2], [-1.8, 1.8], [-2.5, 2.5]];

/// Readings of the nominal robot, with two targets at every pose, and noise of 20 um.
pub(super) fn set(model: &CalibrationModel, commands: &[Vec<f64>]) -> MeasurementSet {
    set_of(Mode::ElastoGeometric, model, commands)
}

fn set_of(mode: Mode, model: &CalibrationModel, commands: &[Vec<f64>]) -> MeasurementSet {
    let covariance = Matrix3::identity() * 20e-6_f64.powi(2);
    let away = Vector3::new(4.0, 1.0, 1.5);
    let offsets = [Vector3::new(0.1, 0.05, 0.2), Vector3::new(-0.15, 0.1, 0.05)];
    let robot = CalibratedRobot {
        mode,
        nominal: model.clone(),
        model: model.clone(),
        terms: Vec::new(),
        stations: vec![Transform::identity()],
        targets: offsets.to_vec(),
        instruments: Vec::new(),
        orientations: vec![None; 2],
    };
    let mut predictor = Predictor::new(&robot).expect("a robot");
    let nest = |in_base: Vector3<f64>| NestObservation {
        time: None,
        name: format!("{in_base:?}"),
        in_base,
        in_base_covariance: covariance,
        reading: Reading::Cartesian { position: in_base + away, covariance: Some(covariance) },
    };
    let places = [Vector3::zeros(), 2.0 * Vector3::x(), 2.0 * Vector3::y(), 3.0 * Vector3::z()];
    let mut observations = Vec::new();
    for (pose, command) in (1..).zip(commands) {
        for target in 0..2 {
            let in_base = predictor.in_base(PoseQuery::at(command).with_target(target)).expect("a pose");
            observations.push(Observation {
                pose,
                command: command.clone(),
                approach: vec![0; 4],
                since_reversal: Vec::new(),
                temperature: None,
                time: 0.0,
                station: 0,
                target,
                payload: None,
                reading: Reading::Cartesian { position: in_base + away, covariance: Some(covariance) },
            });
        }
    }
    MeasurementSet {
        stations: vec![Station {
            name: "T".to_owned(),
            nests: places.map(nest).to_vec(),
            ..Station::default()
        }],
        targets: offsets
            .map(|in_flange| Target {
                name: format!("{in_flange:?}"),
                in_flange,
                covariance: Some(covariance),
                orientation: None,
            })
            .to_vec(),
        observations,
    }
}

pub(super) fn options(mode: Mode) -> IdentificationOptions {
    IdentificationOptions {
        mode,
        tolerance: Some(Tolerance { length: 2e-3, angle: 2e-3 }),
        machine_noise: MachineNoiseChoice::Stated(vec![30e-6, 20e-6, 20e-6, 50e-6]),
        ..IdentificationOptions::default()
    }
}

fn of_poses(set: &MeasurementSet, poses: &[u32]) -> MeasurementSet {
    let observations = set.observations.iter().filter(|o| poses.contains(&o.pose)).cloned().collect();
    MeasurementSet { observations, ..set.clone() }
}

/// The fit of the nominal robot's readings ends at the nominal robot: its covariance is the planned one, and so is that of its predictions.
fn compare(estimate: &Estimate, session: &mut PlannedSession<'_>, chosen: &[u32], region: &[Vec<f64>]) {
    let space = session.space(&ParameterScale::Effect).expect("a space");
    let place = |pose: &u32| session.candidates().iter().position(|own| own == pose).expect("a candidate");
    let chosen: Vec<usize> = chosen.iter().map(place).collect();
    let figures = space.figures(&chosen).expect("determined");
    // A free frame counts from where the rigid robot fits best, which is not where the sagging robot is.
    let own = estimate.parameters.iter().filter(|p| !matches!(p.id, ParameterId::Frame { .. }));
    for p in own {
        assert!(p.value.abs() < 0.01 * p.sigma.expect("determined"), "{}: {} {:?}", p.id, p.value, p.sigma);
    }
    assert_eq!(estimate.parameters.iter().map(|p| p.id).collect::<Vec<_>>(), session.parameters());
    for (parameter, sigma) in estimate.parameters.iter().zip(&figures.sigmas) {
        let fitted = parameter.sigma.expect("determined");
        assert!((fitted / sigma - 1.0).abs() < 1e-5, "{}: {fitted} for {sigma}", parameter.id);
    }
    let accuracy = figures.accuracy.expect("a region");
    let (mut own, mut with) = (0.0_f64, 0.0_f64);
    for command in region {
        let there = estimate.predict(command).expect("a pose");
        let covariance = there.covariance.expect("determined");
        own += (covariance - there.of_machine).trace();
        with += covariance.trace();
    }
    let mean = region.len() as f64;
    assert!((accuracy.of_parameters.rms.powi(2) / (own / mean) - 1.0).abs() < 1e-4);
    assert!((accuracy.with_machine.rms.powi(2) / (with / mean) - 1.0).abs() < 1e-4);
    assert!(accuracy.of_machine.rms > 1e-5);
}

#[test]
fn what_is_planned_is_what_a_fit_of_the_chosen_poses_knows() {
    let model = arm();
    let commands = candidate_commands(&model, &LIMITS, 60).expect("candidates");
    let region = candidate_commands(&model, &LIMITS, 25).expect("a region");
    let queries: Vec<PoseQuery<'_>> = region.iter().map(PoseQuery::from).collect();
    for (mode, frame) in [
        (Mode::OnlyCalibration, FrameChoice::Nests),
        (Mode::WithGravity, FrameChoice::Nests),
        (Mode::ElastoGeometric, FrameChoice::Nests),
        (Mode::ElastoGeometric, FrameChoice::Free),
    ] {
        let set = set_of(mode, &model, &commands);
        let options = IdentificationOptions { frame, ..options(mode) };
        let mut session =
            PlannedSession::new(&model, &set, &options, None, &[], &queries).expect("a session");
        let space = session.space(&ParameterScale::Effect).expect("a space");
        assert_eq!(space.candidates(), 60);
        let design = choose(&[space], &Choice::of(25)).expect("a design");
        let chosen: Vec<u32> = design.chosen.iter().map(|i| session.candidates()[*i]).collect();
        let estimate = identify(&model, &of_poses(&set, &chosen), &options).expect("an estimate");
        compare(&estimate, &mut session, &chosen, &region);
    }
}

/// Ten poses are measured, more follow: the fit of all is as planned, both at the nominal robot and at the result of a first fit.
#[test]
fn further_poses_count_beside_those_that_are_measured() {
    let model = arm();
    let set = set(&model, &candidate_commands(&model, &LIMITS, 60).expect("candidates"));
    let region = candidate_commands(&model, &LIMITS, 25).expect("a region");
    let queries: Vec<PoseQuery<'_>> = region.iter().map(PoseQuery::from).collect();
    let options = options(Mode::ElastoGeometric);
    let measured: Vec<u32> = (1..=20).collect();
    let first = identify(&model, &of_poses(&set, &measured), &options).expect("an estimate");
    for estimate in [None, Some(&first)] {
        let mut session =
            PlannedSession::new(&model, &set, &options, estimate, &measured, &queries).expect("a session");
        assert_eq!(session.candidates(), (21..=60).collect::<Vec<_>>());
        let space = session.space(&ParameterScale::Effect).expect("a space");
        let design = choose(&[space], &Choice::of(8)).expect("a design");
        let chosen: Vec<u32> = design.chosen.iter().map(|i| session.candidates()[*i]).collect();
        let all = [measured.as_slice(), &chosen].concat();
        let fitted = identify(&model, &of_poses(&set, &all), &options).expect("an estimate");
        compare(&fitted, &mut session, &chosen, &region);
    }
}

/// The rows of a drawn robot are those of a fit for which it is the nominal robot.
#[test]
fn drawn_robots_are_robots_of_their_own() {
    let model = arm();
    let set = set(&model, &candidate_commands(&model, &LIMITS, 40).expect("candidates"));
    let region = candidate_commands(&model, &LIMITS, 10).expect("a region");
    let queries: Vec<PoseQuery<'_>> = region.iter().map(PoseQuery::from).collect();
    let options = options(Mode::ElastoGeometric);
    let mut session = PlannedSession::new(&model, &set, &options, None, &[], &queries).expect("a session");
    let tolerance = Tolerance { length: 5e-3, angle: 5e-3 };
    let spaces = session.spaces_of_robots(3, tolerance, 7, &ParameterScale::Effect).expect("spaces");
    assert_eq!(spaces.len(), 4);
    assert_eq!(spaces[0], session.space(&ParameterScale::Effect).expect("a space"));
    assert_eq!(spaces, session.spaces_of_robots(3, tolerance, 7, &ParameterScale::Effect).expect("spaces"));
    assert!(spaces.windows(2).all(|pair| pair[0] != pair[1] && pair[0].scale() == pair[1].scale()));
    // They are similar: robots are made within some millimetres.
    let all: Vec<usize> = (0..40).collect();
    let rms = |i: usize| spaces[i].figures(&all).expect("told").accuracy.expect("a region").of_parameters.rms;
    for robot in 1..4 {
        let ratio = rms(robot) / rms(0);
        assert!((ratio - 1.0).abs() < 0.05 && ratio != 1.0, "{ratio}");
    }
    for over in [Over::Mean, Over::Worst] {
        let choice = Choice { over, starts: 3, ..Choice::of(15) };
        let robust = choose(&spaces, &choice).expect("a design");
        let nominal = choose(&spaces[..1], &choice).expect("a design");
        let value = |design: &[usize]| {
            let values = spaces
                .iter()
                .map(|space| space.figures(design).expect("told").value(Criterion::I).expect("a region"));
            match over {
                Over::Mean => values.sum::<f64>() / 4.0,
                Over::Worst => values.fold(0.0, f64::max),
            }
        };
        assert!((value(&robust.chosen) / robust.value - 1.0).abs() < 1e-9);
        assert!(value(&robust.chosen) <= value(&nominal.chosen) * 1.01);
    }
    // Without tolerances every robot is the nominal one except for the compliances' own priors.
    let none = Tolerance { length: -1.0, angle: 0.0 };
    assert!(matches!(
        session.spaces_of_robots(1, none, 7, &ParameterScale::Effect),
        Err(PlanError::Number { .. })
    ));
}

/// A pose with and without a payload is one candidate, and its rows are all its readings.
#[test]
fn all_readings_of_a_pose_are_one_candidate() {
    let model = arm();
    let mut set = set(&model, &candidate_commands(&model, &LIMITS, 30).expect("candidates"));
    let options = options(Mode::ElastoGeometric);
    let rows = |set: &MeasurementSet| {
        let mut session = PlannedSession::new(&model, set, &options, None, &[], &[]).expect("a session");
        session
            .space(&ParameterScale::Effect)
            .expect("a space")
            .figures(&[0, 5, 9, 11, 20, 25])
            .expect("told")
            .sigmas
    };
    let without = rows(&set);
    let payload = Payload { mass: 30.0, centre: Vector3::new(0.0, 0.1, 0.1), ..Payload::default() };
    let loaded = set.observations.iter().map(|o| Observation { payload: Some(payload.clone()), ..o.clone() });
    let both: Vec<_> = set.observations.iter().cloned().chain(loaded).collect();
    set.observations = both;
    let with = rows(&set);
    assert_eq!(with.len(), without.len());
    assert!(with.iter().zip(&without).all(|(with, without)| with < without));
}

/// Drift is best separated from parameters by an order that is not sorted by a joint.
#[test]
fn drift_is_spread_over_the_poses() {
    let model = arm();
    let commands = candidate_commands(&model, &LIMITS, 60).expect("candidates");
    let set = set(&model, &commands);
    let options = options(Mode::ElastoGeometric);
    let mut session = PlannedSession::new(&model, &set, &options, None, &[], &[]).expect("a session");
    let space = session.space(&ParameterScale::Effect).expect("a space");
    let choice = Choice { criterion: Criterion::D, ..Choice::of(20) };
    let design = choose(std::slice::from_ref(&space), &choice).expect("a design");
    let coupling = session.drift_coupling(&space, &design.chosen).expect("told");
    let chosen: Vec<Vec<f64>> = design.chosen.iter().map(|i| commands[*i].clone()).collect();
    let way = |drift| crate::planning::Way {
        commands: &chosen,
        home: None,
        speeds: &[0.3; 4],
        drift: Some(&coupling),
        weights: crate::planning::OrderWeights { balance: 0.0, drift },
    };
    let mut by_rail: Vec<usize> = (0..20).collect();
    by_rail.sort_by(|a, b| chosen[*a][0].total_cmp(&chosen[*b][0]));
    let sorted = crate::planning::order_cost(&way(1.0), &by_rail).expect("an order");
    let short = crate::planning::ordered(&way(0.0)).expect("an order");
    let spread = crate::planning::ordered(&way(300.0)).expect("an order");
    eprintln!("by rail {sorted:?}\nshort {:?}\nspread {:?}", short.cost, spread.cost);
    assert!(spread.cost.drift < 0.7 * sorted.drift && spread.cost.drift < short.cost.drift);
    assert!((0.0..1.0).contains(&spread.cost.drift));
}

/// Poses that are visited twice need no more rows than those visited once, and give the information of a fit of all visits.
#[test]
fn visits_of_a_pose_are_merged() {
    let model = arm();
    let once = set(&model, &candidate_commands(&model, &LIMITS, 40).expect("candidates"));
    let later = once.observations.iter().map(|own| Observation { time: 60.0, ..own.clone() });
    let twice = MeasurementSet {
        observations: once.observations.iter().cloned().chain(later).collect(),
        ..once.clone()
    };
    let region = candidate_commands(&model, &LIMITS, 20).expect("a region");
    let queries: Vec<PoseQuery<'_>> = region.iter().map(PoseQuery::from).collect();
    let options = options(Mode::ElastoGeometric);
    let mut rms = Vec::new();
    for set in [&once, &twice] {
        let mut session = PlannedSession::new(&model, set, &options, None, &[], &queries).expect("a session");
        let space = session.space(&ParameterScale::Effect).expect("a space");
        assert_eq!((space.candidates(), space.most_rows()), (40, 6));
        let chosen: Vec<u32> = (1..=20).collect();
        let estimate = identify(&model, &of_poses(set, &chosen), &options).expect("an estimate");
        compare(&estimate, &mut session, &chosen, &region);
        let drift = session.drift_coupling(&space, &(0..20).collect::<Vec<_>>());
        assert!(drift.is_ok(), "{drift:?}");
        let figures = space.figures(&(0..20).collect::<Vec<_>>()).expect("told");
        rms.push(figures.accuracy.expect("a region").of_parameters.rms);
    }
    assert!(rms[1] < rms[0], "{rms:?}");
}
