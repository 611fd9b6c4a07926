//! The coupled modes on data from the model itself: the true values are found, and what cannot be determined is reported.

use std::path::Path;

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::*;
use crate::elastostatics::put;
use calibrig_files::load_robot;
use calibrig_model::geometry::{rotation_x, translation};
use calibrig_model::measurement::{MeasurementSet, NestObservation, Observation, Reading, Station, Target};
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::{CalibrationModel, Compliance, LinkageTerm, ParameterId, PointLoad, TermId};

const SIGMA: f64 = 1e-5;
/// Indices of shoulder, elbow (which turns the crank) and waist.
pub(super) const SHOULDER: Compliance = Compliance::Drive { joint: 2 };
pub(super) const ELBOW: Compliance = Compliance::Drive { joint: 3 };
pub(super) const WAIST: Compliance = Compliance::Drive { joint: 1 };

pub(super) fn painter() -> CalibrationModel {
    load_robot(Path::new("../../models/spray_painter/robot.toml")).expect("the shipped robot").model
}

pub(super) fn truth(
    nominal: &CalibrationModel,
    deviations: &[(ParameterId, f64)],
    terms: Vec<(TermId, f64)>,
) -> CalibratedRobot {
    let mut model = nominal.clone();
    for (id, value) in deviations {
        put(&mut model, nominal, *id, *value);
    }
    CalibratedRobot {
        instruments: Vec::new(),
        mode: Mode::Extended,
        nominal: model.clone(),
        model,
        terms,
        stations: vec![translation(5.0, 1.0, 1.5) * rotation_x(0.4)],
        targets: vec![Vector3::new(0.1, 0.15, 0.2)],
        orientations: vec![None],
    }
}

/// Poses about the middle of the limits, approached from both sides, as `robot` takes them, with `noise` standard deviations of noise.
pub(super) fn measure(robot: &CalibratedRobot, poses: usize, noise: f64) -> MeasurementSet {
    let links = &robot.model.kinematics.links;
    let mut rng = stream(5, 0, StreamSource::IdentificationNoise);
    let covariance = Matrix3::identity() * SIGMA * SIGMA;
    let station = robot.stations[0];
    let mut set = MeasurementSet {
        stations: vec![Station { name: "T1".to_owned(), ..Station::default() }],
        targets: vec![Target {
            orientation: None,
            name: "S1".to_owned(),
            in_flange: robot.targets[0],
            covariance: Some(covariance),
        }],
        observations: Vec::new(),
    };
    for in_base in [Vector3::zeros(), Vector3::x(), Vector3::y(), 4.0 * Vector3::z()] {
        set.stations[0].nests.push(NestObservation {
            time: None,
            name: format!("{in_base:?}"),
            in_base,
            in_base_covariance: covariance,
            reading: Reading::Cartesian {
                position: station * nalgebra::Point3::from(in_base) - nalgebra::Point3::origin(),
                covariance: Some(covariance),
            },
        });
    }
    for (pose, joints) in (0..).zip(structural_poses(&robot.model.kinematics, poses)) {
        let near = joints.iter().zip(links).map(|(q, link)| {
            let middle = 0.5 * (link.limits[0] + link.limits[1]);
            middle + 0.7 * (q - middle)
        });
        let command = robot.model.actuators.command_from_joints(&near.collect::<Vec<_>>());
        set.observations.push(Observation {
            pose,
            approach: command.iter().map(|_| if rng.random::<bool>() { 1 } else { -1 }).collect(),
            since_reversal: Vec::new(),
            command,
            temperature: None,
            time: f64::from(pose),
            station: 0,
            target: 0,
            payload: None,
            reading: Reading::Cartesian { position: Vector3::zeros(), covariance: Some(covariance) },
        });
    }
    let mut predictor = Predictor::new(robot).expect("a robot");
    for observation in &mut set.observations {
        let in_base = predictor.in_base(&*observation).expect("a pose that the robot can take");
        let seen = station.rotation * in_base + station.translation.vector;
        let error = Vector3::from_fn(|_, _| {
            noise * SIGMA * {
                let unit: f64 = StandardNormal.sample(&mut rng);
                unit
            }
        });
        observation.reading = Reading::Cartesian { position: seen + error, covariance: Some(covariance) };
    }
    set
}

/// Some millimetres and milliradians in all parameters that the rules keep.
pub(super) fn geometric_errors(nominal: &CalibrationModel) -> Vec<(ParameterId, f64)> {
    let kept = neighbour_axis_rules(&nominal.kinematics).0.into_iter().enumerate();
    kept.map(|(i, id)| (id, 4e-3 * (2.3 * i as f64 + 0.4).sin())).collect()
}

pub(super) fn options(mode: Mode) -> IdentificationOptions {
    IdentificationOptions {
        mode,
        extended_parameters: ParameterChoice::NeighbourAxisRules,
        terms: Some(Vec::new()),
        ..IdentificationOptions::published()
    }
}

fn assert_found(estimate: &Estimate, truths: &[(ParameterId, f64)], tolerance: f64) {
    for (id, truth) in truths {
        let value = estimate.value(*id).unwrap_or_else(|| panic!("{id} is not identified"));
        assert!((value - truth).abs() <= tolerance, "{id}: {value} instead of {truth}");
    }
}

#[test]
fn exact_data_give_geometry_and_stiffness_through_the_closed_four_bar() {
    let nominal = painter();
    let mut deviations = geometric_errors(&nominal);
    deviations.push((ParameterId::Compliance(SHOULDER), 0.15));
    deviations.push((ParameterId::Compliance(ELBOW), -0.12));
    let set = measure(&truth(&nominal, &deviations, Vec::new()), 80, 0.0);
    let options = IdentificationOptions {
        compliances: ComplianceChoice::Listed(vec![SHOULDER, ELBOW]),
        // So wide that the prior has no effect.
        compliance_sigma: 1e3,
        ..options(Mode::ElastoGeometric)
    };
    let estimate = identify(&nominal, &set, &options).expect("an estimate");
    assert!(estimate.is_sound(), "{:?}", estimate.warnings);
    assert!(estimate.held.is_empty() && estimate.fixed.is_empty());
    assert_found(&estimate, &deviations, 1e-6);
    let errors = Predictor::new(&estimate.robot).expect("a robot").errors(&set).expect("poses");
    assert!(errors.iter().all(|error| error.norm() < 1e-8));
}

#[test]
fn exact_data_give_the_linkage_and_every_family_of_terms() {
    let nominal = painter();
    let mut deviations = vec![(ParameterId::Linkage(LinkageTerm::Lever), 1.5e-3)];
    let amplitudes = ["hysteresis_theta3", "harmonic_theta4_cos1", "ratio_d5", "rail_d1_y2", "rail_d1_rz1"];
    let terms = amplitudes.iter().zip(1..).map(|(name, i)| {
        let id = TermId::parse(name).unwrap_or_else(|| panic!("{name}"));
        (id, 1e-4 * f64::from(i))
    });
    let terms: Vec<_> = terms.collect();
    let set = measure(&truth(&nominal, &deviations, terms.clone()), 150, 0.0);
    deviations.extend(terms.iter().map(|(id, value)| (ParameterId::Term(*id), *value)));
    let families = ["hysteresis", "harmonic", "ratio", "rail", LINKAGE];
    let weak = |family: &str| TermPrior { family: family.to_owned(), length: Some(1.0), angle: Some(1.0) };
    let options = IdentificationOptions {
        compliances: ComplianceChoice::Listed(Vec::new()),
        terms: Some(families.map(str::to_owned).to_vec()),
        term_priors: families.map(weak).to_vec(),
        ..options(Mode::Extended)
    };
    let estimate = identify(&nominal, &set, &options).expect("an estimate");
    assert!(estimate.termination.converged());
    println!("{} parameters, held: {:?}", estimate.parameters.len(), estimate.held.len());
    assert_found(&estimate, &deviations[1..], 2e-6);
    let errors = Predictor::new(&estimate.robot).expect("a robot").errors(&set).expect("poses");
    assert!(errors.iter().all(|error| error.norm() < 1e-6));
}

#[test]
fn the_compliances_are_those_that_gravity_loads() {
    let nominal = painter();
    let set = measure(&truth(&nominal, &[], Vec::new()), 40, 1.0);
    let estimate = identify(&nominal, &set, &options(Mode::ElastoGeometric)).expect("an estimate");
    let has = |compliance| estimate.value(ParameterId::Compliance(compliance)).is_some();
    assert!(has(SHOULDER) && has(ELBOW) && has(Compliance::Rod));
    // The axis is vertical.
    assert!(!has(WAIST));
    let shoulder = estimate.parameters.iter().find(|p| p.id == ParameterId::Compliance(SHOULDER));
    assert_eq!(shoulder.and_then(|p| p.prior_sigma), Some(0.1));
}

/// Whichever columns were left out before.
#[test]
fn the_first_system_of_the_solver_is_that_of_the_start() {
    let nominal = painter();
    let set = measure(&truth(&nominal, &geometric_errors(&nominal), Vec::new()), 30, 1.0);
    for redundant in Redundancy::ALL {
        let options = IdentificationOptions {
            compliances: ComplianceChoice::All,
            redundant,
            tolerance: Some(Tolerance { length: 0.1, angle: 0.1 }),
            ..options(Mode::ElastoGeometric)
        };
        let build::Built { mut problem, x: start, .. } =
            build::build(&nominal, &set, &options).expect("a problem");
        let n = problem.parameters.len();
        assert!(n < 24 + nominal.compliances().len(), "some are not loaded");
        let mut evaluate = || {
            let mut residuals = DVector::zeros(LeastSquares::rows(&problem));
            let mut jacobian = DMatrix::zeros(residuals.len(), n);
            problem.evaluate(&start, &mut residuals, Some(&mut jacobian));
            (residuals, jacobian, problem.start.is_some())
        };
        let (kept, anew) = (evaluate(), evaluate());
        assert!(kept == anew);
    }
}

#[test]
fn a_compliance_that_was_asked_for_and_is_not_loaded_is_handled_as_chosen() {
    let nominal = painter();
    let set = measure(&truth(&nominal, &[], Vec::new()), 40, 1.0);
    let id = ParameterId::Compliance(WAIST);
    let with = |redundant| IdentificationOptions {
        compliances: ComplianceChoice::Listed(vec![WAIST, SHOULDER]),
        redundant,
        ..options(Mode::ElastoGeometric)
    };
    let prior = identify(&nominal, &set, &with(Redundancy::Prior)).expect("an estimate");
    assert!(prior.is_sound(), "{:?}", prior.warnings);
    let sigma = prior.parameters.iter().find(|p| p.id == id).and_then(|p| p.sigma).expect("full rank");
    assert!((sigma / 0.1 - 1.0).abs() < 0.01, "its prior's: {sigma}");
    let said = |estimate: &Estimate| {
        estimate.warnings.iter().any(|w| matches!(w, Warning::Unexcited { name } if *name == id.to_string()))
    };
    assert!(said(&prior));
    let keep = identify(&nominal, &set, &with(Redundancy::Keep)).expect("an estimate");
    assert!(said(&keep));
    let fix = identify(&nominal, &set, &with(Redundancy::Fix)).expect("an estimate");
    assert!(fix.value(ParameterId::Compliance(SHOULDER)).is_some());
}

#[test]
fn what_the_measurements_leave_open_is_fixed_held_or_counted_as_lacking() {
    let mut nominal = painter();
    // Without weight, and with a force along the rail only, the shoulder does not bend: its compliance has no effect at all.
    let statics = nominal.statics.as_mut().expect("statics");
    statics.gravity = Vector3::zeros();
    let (at, force) = (Vector3::zeros(), Vector3::x());
    statics.loads.push(PointLoad { name: "push".to_owned(), link: 0, at, mass: 0.0, force });
    let set = measure(&truth(&nominal, &[], Vec::new()), 40, 1.0);
    let id = ParameterId::Compliance(SHOULDER);
    let with = |redundant| IdentificationOptions {
        compliances: ComplianceChoice::Listed(vec![SHOULDER]),
        redundant,
        ..options(Mode::ElastoGeometric)
    };
    let prior = identify(&nominal, &set, &with(Redundancy::Prior)).expect("an estimate");
    assert!(prior.is_sound() && prior.fixed.is_empty());
    assert_eq!(prior.held.iter().map(|group| group.redundant).collect::<Vec<_>>(), [id]);
    assert!(prior.warnings.iter().any(|w| matches!(w, Warning::HeldByPrior { .. })));
    let fix = identify(&nominal, &set, &with(Redundancy::Fix)).expect("an estimate");
    assert!(fix.is_sound() && fix.value(id).is_none() && fix.held.is_empty());
    assert_eq!(fix.fixed.iter().map(|group| group.redundant).collect::<Vec<_>>(), [id]);
    let keep = identify(&nominal, &set, &with(Redundancy::Keep)).expect("an estimate");
    assert!(!keep.is_sound() && keep.covariance.is_none());
    assert_eq!(keep.spectrum.rank + 1, keep.parameters.len());
}

#[test]
fn a_compliance_stops_at_rigid_and_says_so() {
    let nominal = painter();
    let mut machine = truth(&nominal, &[], Vec::new());
    // A machine that rises under its weight would need a negative compliance.
    machine.model.statics.as_mut().expect("statics").gravity *= -0.5;
    let set = measure(&machine, 40, 1.0);
    let options = IdentificationOptions {
        compliances: ComplianceChoice::Listed(vec![SHOULDER, ELBOW]),
        compliance_sigma: 10.0,
        // The test is about the bounds, not about the misfit that they leave.
        machine_noise: MachineNoiseChoice::Stated(Vec::new()),
        ..options(Mode::ElastoGeometric)
    };
    let estimate = identify(&nominal, &set, &options).expect("an estimate");
    // A drive without visible compliance is a warning, but no reason to doubt the rest.
    assert!(!estimate.at_bound.is_empty() && estimate.is_sound());
    for id in &estimate.at_bound {
        assert_eq!(estimate.value(*id), Some(-1.0));
    }
    let stiffness = estimate.robot.model.statics.as_ref().expect("statics").drive_stiffness[3];
    assert!(estimate.value(ParameterId::Compliance(ELBOW)) > Some(-1.0) || stiffness.is_infinite());
    assert!(estimate.warnings.iter().any(|w| matches!(w, Warning::Rigid { .. })));
    // The others are as certain as where the rigid drives are not parameters.
    let covariance = estimate.covariance.as_ref().expect("full rank");
    let free = ComplianceChoice::Listed(
        [SHOULDER, ELBOW]
            .into_iter()
            .filter(|c| !estimate.at_bound.contains(&ParameterId::Compliance(*c)))
            .collect(),
    );
    let mut rigid = nominal.clone();
    for id in &estimate.at_bound {
        let ParameterId::Compliance(Compliance::Drive { joint }) = *id else { panic!("{id}") };
        rigid.statics.as_mut().expect("statics").drive_stiffness[joint] = f64::INFINITY;
    }
    let without =
        identify(&rigid, &set, &IdentificationOptions { compliances: free, ..options }).expect("an estimate");
    for (place, parameter) in estimate.parameters.iter().enumerate() {
        match without.parameters.iter().find(|p| p.id == parameter.id).and_then(|p| p.sigma) {
            Some(expected) => {
                let sigma = parameter.sigma.expect("not at a bound");
                assert!((sigma / expected - 1.0).abs() < 1e-6, "{}: {sigma}, {expected}", parameter.id);
            }
            None => {
                assert!(estimate.at_bound.contains(&parameter.id) && parameter.sigma.is_none());
                assert_eq!(covariance.column(place).norm(), 0.0);
            }
        }
    }
}

#[test]
fn outliers_are_named_and_do_not_move_the_estimate() {
    let nominal = painter();
    let deviations = [(ParameterId::Compliance(SHOULDER), 0.1)];
    let mut set = measure(&truth(&nominal, &deviations, Vec::new()), 80, 1.0);
    let mut options = IdentificationOptions {
        compliances: ComplianceChoice::Listed(vec![SHOULDER]),
        ..options(Mode::ElastoGeometric)
    };
    let clean = identify(&nominal, &set, &options).expect("an estimate");
    for pose in [7, 31] {
        let Reading::Cartesian { position, .. } = &mut set.observations[pose].reading else { continue };
        position.x += 3e-3;
    }
    options.solver.loss = Loss::tukey();
    let robust = identify(&nominal, &set, &options).expect("an estimate");
    assert_eq!(robust.outliers.iter().map(|o| o.pose).collect::<Vec<_>>(), [7, 31]);
    assert!(robust.outliers.iter().all(|o| o.weight < 1e-6 && o.size > 50.0));
    let id = ParameterId::Compliance(SHOULDER);
    let sigma = clean.parameters.iter().find(|p| p.id == id).and_then(|p| p.sigma).expect("full rank");
    let difference = robust.value(id).expect("identified") - clean.value(id).expect("identified");
    assert!(difference.abs() < 2.0 * sigma, "{difference} against {sigma}");
    assert!(robust.warnings.iter().any(|w| w.to_string().contains("pose 31")));
}

#[test]
fn the_linearisation_is_that_of_the_estimate() {
    let nominal = painter();
    let mut set = measure(&truth(&nominal, &[], Vec::new()), 40, 1.0);
    for stated in [true, false] {
        if !stated {
            for observation in &mut set.observations {
                let position = observation.reading.position();
                observation.reading = Reading::Cartesian { position, covariance: None };
            }
        }
        let options = options(Mode::ElastoGeometric);
        let estimate = identify(&nominal, &set, &options).expect("an estimate");
        let values: Vec<f64> = estimate.parameters.iter().map(|p| p.value).collect();
        assert_eq!(estimate.iterations.last().map(|last| &last.parameters), Some(&values));
        let system = linearise(&nominal, &set, &options, &estimate).expect("the same system");
        assert_eq!(system.data_rows, 3 * set.observations.len());
        let measured = system.residuals.rows(0, system.measured_rows);
        assert!((measured.norm_squared() / estimate.chi2 - 1.0).abs() < 1e-9);
        assert!((system.freedom() / estimate.degrees_of_freedom - 1.0).abs() < 1e-9);
        let covariance = estimate.covariance.as_ref().expect("full rank");
        let n = covariance.nrows();
        let scale = DMatrix::from_diagonal(&covariance.diagonal().map(f64::sqrt));
        let whole = &scale
            * (system.jacobian.tr_mul(&system.jacobian) * covariance)
            * scale.try_inverse().expect("no zero");
        assert!((whole - DMatrix::identity(n, n)).amax() < 1e-5);
    }
}

#[test]
fn a_robot_without_statics_has_terms_but_no_stiffness() {
    let mut nominal = painter();
    nominal.statics = None;
    let id = TermId::parse("hysteresis_theta3").expect("a term");
    let set = measure(&truth(&nominal, &[], vec![(id, 3e-4)]), 60, 0.0);
    let refused = identify(&nominal, &set, &options(Mode::ElastoGeometric));
    assert_eq!(refused, Err(IdentifyError::NoStatics { mode: Mode::ElastoGeometric }));
    let options =
        IdentificationOptions { terms: Some(vec!["hysteresis".to_owned()]), ..options(Mode::Extended) };
    let estimate = identify(&nominal, &set, &options).expect("an estimate");
    // The prior has a small effect.
    assert_found(&estimate, &[(ParameterId::Term(id), 3e-4)], 1e-7);
    assert_eq!(estimate.robot.terms.len(), 7);
}

#[test]
fn what_cannot_be_is_refused_in_words() {
    let nominal = painter();
    let set = measure(&truth(&nominal, &[], Vec::new()), 40, 1.0);
    let refused =
        |options: IdentificationOptions| identify(&nominal, &set, &options).expect_err("refused").to_string();
    let rigid = Compliance::Bearing { joint: 0, axis: 2 };
    let listed = ComplianceChoice::Listed(vec![rigid]);
    let words = refused(IdentificationOptions { compliances: listed, ..options(Mode::ElastoGeometric) });
    assert!(words.contains("compliance_bearing1_z") && words.contains("finite stiffness"), "{words}");
    let unknown = Some(vec!["growth".to_owned()]);
    let words = refused(IdentificationOptions { terms: unknown, ..options(Mode::Extended) });
    assert!(words.contains("\"growth\""), "{words}");
    let words = refused(IdentificationOptions { compliance_sigma: 0.0, ..options(Mode::ElastoGeometric) });
    assert!(words.contains("prior of the compliances"), "{words}");
    let mut open = nominal.clone();
    put(&mut open, &nominal, ParameterId::Linkage(LinkageTerm::Rod), 10.0);
    let error = identify(&open, &set, &options(Mode::ElastoGeometric)).expect_err("an open four-bar");
    assert!(matches!(error, IdentifyError::Machine { pose: 0, .. }), "{error}");
    let mut robot = truth(&nominal, &[], Vec::new());
    robot.model = open;
    let error = Predictor::new(&robot).expect("a robot").errors(&set).expect_err("an open four-bar");
    assert!(matches!(error, PredictionError::Pose { pose: 0, .. }), "{error}");
    let few = MeasurementSet { observations: set.observations[..3].to_vec(), ..set.clone() };
    let error = identify(&nominal, &few, &options(Mode::ElastoGeometric)).expect_err("three poses");
    assert!(matches!(error, IdentifyError::TooFewRows { .. }), "{error}");
}

/// Constant deflections of the nominal robot, including bearings and beams: an exact nominal machine has no error left.
#[test]
fn with_gravity_an_exact_machine_is_predicted_exactly() {
    let nominal = painter();
    let set = measure(&truth(&nominal, &[], Vec::new()), 40, 0.0);
    let gravity = identify(&nominal, &set, &options(Mode::WithGravity)).expect("an estimate");
    let largest = gravity.parameters.iter().map(|p| p.value.abs()).fold(0.0, f64::max);
    assert!(largest < 1e-9, "{largest}");
    let only = identify(&nominal, &set, &options(Mode::OnlyCalibration)).expect("an estimate");
    assert!(only.chi2 > 1e4 * gravity.chi2.max(1e-12), "{} {}", only.chi2, gravity.chi2);
}

mod by_name;
mod ends;
mod tables;
mod valleys;

/// The system that is judged is the one that was solved: also with a robust loss, and with a parameter at its bound.
#[test]
fn the_solved_system_has_the_covariance_of_its_estimate() {
    let nominal = painter();
    let mut set = measure(&truth(&nominal, &[], Vec::new()), 60, 1.0);
    for pose in [5, 40] {
        let Reading::Cartesian { position, .. } = &mut set.observations[pose].reading else { continue };
        position.z += 2e-3;
    }
    let a4 = ParameterId::link(3, calibrig_model::LinkTerm::A);
    let bound = ParameterBound { id: a4, lower: 0.0, upper: 1e-9 };
    for (loss, bounds) in
        [(Loss::huber(), Vec::new()), (Loss::tukey(), vec![bound]), (Loss::Squared, vec![bound])]
    {
        let mut options = IdentificationOptions { bounds, ..options(Mode::ElastoGeometric) };
        options.machine_noise = MachineNoiseChoice::Stated(Vec::new());
        options.solver.loss = loss;
        let estimate = identify(&nominal, &set, &options).expect("an estimate");
        let system = linearise(&nominal, &set, &options, &estimate).expect("its system").weighted(&estimate);
        let ids: Vec<_> = estimate.parameters.iter().map(|p| p.id).collect();
        let solved = Uncertainty::of(&system, &ids).expect("full rank");
        let stated = estimate.covariance.as_ref().expect("full rank");
        let size = stated.diagonal().map(f64::sqrt);
        for i in 0..ids.len() {
            for j in 0..ids.len() {
                let apart = (solved.covariance()[(i, j)] - stated[(i, j)]).abs();
                assert!(apart <= 1e-4 * size[i] * size[j], "{loss:?} {} {}: {apart}", ids[i], ids[j]);
            }
        }
    }
}

/// A drive is fitted at first and left out once the misfit is known: its fitted value must not stay in the system of the next fit.
#[test]
fn a_fit_that_goes_on_with_other_parameters_ends_at_its_own_minimum() {
    let nominal = painter();
    let off = [(ParameterId::link(2, calibrig_model::LinkTerm::A), 2e-3)];
    let mut set = measure(&truth(&nominal, &off, Vec::new()), 60, 1.0);
    for observation in &mut set.observations {
        let Reading::Cartesian { position, .. } = &mut observation.reading else { continue };
        let q = &observation.command;
        *position += 1e-3 * Vector3::new((3.0 * q[1]).sin(), (4.0 * q[2]).cos(), (3.0 * q[3]).sin());
    }
    let drives = [SHOULDER, ELBOW].map(ParameterId::Compliance);
    let mut dropped = 0;
    for compliance_sigma in [0.03, 0.01, 0.003] {
        let options = IdentificationOptions { compliance_sigma, ..options(Mode::ElastoGeometric) };
        let estimate = identify(&nominal, &set, &options).expect("an estimate");
        assert!(estimate.found_machine().is_some());
        dropped += estimate.left_out.iter().filter(|left| drives.contains(&left.id)).count();
        let system = linearise(&nominal, &set, &options, &estimate).expect("its system");
        for (column, parameter) in system.jacobian.column_iter().zip(&estimate.parameters) {
            let cosine = column.dot(&system.residuals) / (column.norm() * system.residuals.norm());
            assert!(cosine.abs() < 1e-3, "{compliance_sigma} {}: {cosine}", parameter.id);
        }
        // In the stated noise, the residuals have the size of a fit without the others.
        let left = estimate.parameters.iter().filter_map(|p| match p.id {
            ParameterId::Compliance(compliance) => Some(compliance),
            _ => None,
        });
        let alone = IdentificationOptions {
            machine_noise: MachineNoiseChoice::Stated(Vec::new()),
            compliances: ComplianceChoice::Listed(left.collect()),
            ..options
        };
        let alone = identify(&nominal, &set, &alone).expect("an estimate");
        assert!((alone.chi2 / estimate.chi2 - 1.0).abs() < 1e-3, "{} {}", alone.chi2, estimate.chi2);
    }
    assert!(dropped > 0);
}
