use std::path::Path;

use super::*;
use crate::identification::{Mode, structural_poses};
use calibrig_files::load_robot;
use calibrig_model::geometry::{rotation_x, rotation_y, translation};
use calibrig_model::measurement::{InstrumentTerm, Reading};
use calibrig_model::{CraigLink, FAMILIES, JointKind, PoseQuery, TermId, Unit};

/// Signs of the approach to a command.
fn signs(command: &[f64]) -> Vec<i8> {
    command.iter().map(|c| if *c < 0.0 { -1 } else { 1 }).collect()
}

fn problem() -> CalibrationProblem {
    let link = |kind, a, alpha, d| {
        let link = match kind {
            JointKind::Prismatic => CraigLink::prismatic(""),
            JointKind::Revolute => CraigLink::revolute(""),
        };
        link.row(a, alpha, d, 0.0).limits(-3.0, 3.0)
    };
    let links = vec![
        link(JointKind::Prismatic, 0.0, 0.0, 0.0),
        link(JointKind::Revolute, 0.3, -1.57, 0.6),
        link(JointKind::Revolute, 1.3, 0.0, 0.1),
    ];
    let nominal = CalibrationModel::new(links).expect("a robot");
    let mut forward = ForwardModel::new(Mode::OnlyCalibration, &nominal);
    let mut parameters = ParameterId::all_of_links(3);
    parameters.extend(ParameterId::all_of_frame(0));
    parameters.extend(ParameterId::all_of_frame(1));
    parameters.extend(ParameterId::all_of_target(0));
    let errors = [InstrumentTerm::RangeScale, InstrumentTerm::Collimation];
    let first = parameters.len();
    parameters.extend(errors.map(|term| ParameterId::Instrument { instrument: 0, term }));
    let stations =
        vec![translation(1.0, 2.0, 3.0) * rotation_x(0.3), translation(-2.0, 0.0, 1.0) * rotation_y(2.0)];
    let targets = vec![Vector3::new(0.1, 0.2, 0.3)];
    let mut row = |station, seen: Vector3<f64>, command: [f64; 3]| PositionRow {
        hours: 0.0,
        // One tracker at both stations.
        instrument: (first..)
            .zip(errors)
            .map(|(column, term)| {
                (column, Reading::Cartesian { position: seen, covariance: None }.displaced_by(term))
            })
            .collect(),
        pose: 0,
        told: forward
            .prepare(&PoseQuery::at(&command).approached(&signs(&command)))
            .expect("an ideal machine"),
        seen,
        reading: None,
        whitening: Matrix3::new(3.0, 0.0, 0.0, 1.0, 2.0, 0.0, -0.5, 0.3, 4.0),
        station,
        target: 0,
    };
    let rows = vec![
        row(0, Vector3::new(1.0, 1.0, 1.0), [0.4, -0.3, 1.2]),
        row(1, Vector3::new(0.0, -1.0, 2.0), [1.1, 0.8, -0.9]),
    ];
    CalibrationProblem {
        swept: Vec::new(),
        left_of_swept: 0.0,
        // A frame on its own, and one that nests determine together with an error of the instrument, from fewer rows than unknowns.
        priors: vec![
            Prior {
                columns: (15..21).collect(),
                whitening: DMatrix::from_fn(6, 6, |i, j| if i < j { 0.0 } else { 1.0 + i as f64 - j as f64 }),
                offset: DVector::zeros(6),
            },
            Prior {
                columns: (21..27).chain([first + 1]).collect(),
                whitening: DMatrix::from_fn(
                    5,
                    7,
                    |i, j| {
                        if i > j { 0.0 } else { 1.0 + j as f64 - 0.5 * i as f64 }
                    },
                ),
                offset: DVector::from_fn(5, |i, _| i as f64 - 1.5),
            },
        ],
        own_priors: vec![(3, 0.5)],
        logarithmic: Vec::new(),
        tolerances: vec![(0, 2.0), (1, 3.0), (2, 4.0)],
        current: Current::new(&nominal, forward, &stations, &targets, &[Rotation3::identity()]),
        turns: Vec::new(),
        turn_of: vec![None; rows.len()],
        orientations: vec![Rotation3::identity()],
        turn_motions: Vec::new(),
        turn_whitening: Vec::new(),
        shared: DMatrix::zeros(0, 0),
        shared_whitening: None,
        rows,
        nominal,
        parameters,
        stations,
        targets,
        poses: Vec::new(),
        motions: Vec::new(),
        unmodelled: 0.0,
        stated_actuators: None,
        noise: Noise::default(),
        joined: Vec::new(),
        start: None,
    }
}

/// The problem with an orientation at every position, for a target that is turned on the flange, and its parameters.
fn with_turns(mut problem: CalibrationProblem) -> CalibrationProblem {
    problem.parameters.extend(ParameterId::all_of_orientation(0));
    problem.orientations = vec![Rotation3::new(Vector3::new(0.7, -0.4, 1.3))];
    let reading = Some([
        Matrix3::new(5.0, 1.0, 0.0, 1.0, 4.0, 1.0, 0.0, 1.0, 6.0),
        Matrix3::new(0.1, 0.2, 0.0, -0.1, 0.0, 0.1, 0.2, 0.0, 0.1),
    ]);
    for observation in 0..problem.rows.len() {
        let seen = Rotation3::new(Vector3::new(0.3, 0.2 * observation as f64, -0.9));
        problem.turn_of[observation] = Some(problem.turns.len());
        problem.turns.push(TurnRow { observation, seen, reading });
        problem.weigh_turns(&[observation], &[Matrix3::identity()]).expect("definite");
    }
    problem
}

/// Also at displaced frames, where the components of a rotation vector do not act one after the other.
#[test]
fn the_jacobian_is_the_central_difference_far_from_zero() {
    check_jacobian(problem());
    check_jacobian(with_turns(problem()));
}

fn check_jacobian(mut problem: CalibrationProblem) {
    let n = problem.parameters.len();
    assert_eq!(problem.rows[0].instrument.len(), 2);
    let x: Vec<f64> = (0..n).map(|i| 0.3 * (1.7 * i as f64).sin()).collect();
    let m = LeastSquares::rows(&problem);
    let mut residuals = DVector::zeros(m);
    let mut jacobian = DMatrix::from_element(m, n, f64::NAN);
    problem.evaluate(&x, &mut residuals, Some(&mut jacobian));
    let step = 1e-6;
    for column in 0..n {
        let mut at = |sign: f64| {
            let mut moved = x.clone();
            moved[column] += sign * step;
            let mut r = DVector::zeros(m);
            problem.evaluate(&moved, &mut r, None);
            r
        };
        let difference = (at(1.0) - at(-1.0)) / (2.0 * step);
        let error = (jacobian.column(column) - difference).amax();
        assert!(error < 1e-7 * jacobian.amax(), "{}: {error}", problem.parameters[column]);
    }
}

#[test]
fn evaluation_takes_no_memory() {
    let mut problem = problem();
    let x = vec![0.01; problem.parameters.len()];
    problem.set(&x);
    let mut residuals = DVector::zeros(LeastSquares::rows(&problem));
    let mut jacobian = DMatrix::zeros(residuals.len(), x.len());
    let info = allocation_counter::measure(|| problem.evaluate(&x, &mut residuals, Some(&mut jacobian)));
    assert_eq!(info.count_total, 0);
}

/// The spray painter with all springs, its four-bar and every term.
fn coupled() -> CalibrationProblem {
    let robot = load_robot(Path::new("../../models/spray_painter/robot.toml")).expect("the shipped robot");
    let target = robot.target().expect("a target");
    let mut nominal = robot.model;
    nominal.motor_turns.iter_mut().for_each(|turns| *turns = turns.or(Some(5.0)));
    let links = nominal.kinematics.joint_count();
    let mut parameters = ParameterId::all_of_links(links);
    let compliances = nominal.compliances();
    assert!(compliances.len() > links, "bearings or beams: {compliances:?}");
    parameters.extend(compliances.into_iter().map(ParameterId::Compliance));
    parameters.extend((0..links).map(|link| ParameterId::Mass { link }));
    parameters.extend(nominal.linkage_terms().into_iter().map(ParameterId::Linkage));
    let terms: Vec<_> = FAMILIES
        .iter()
        .flat_map(|family| TermId::all_of(family.key(), &nominal).expect("a family of the list"))
        .collect();
    parameters.extend(terms.iter().copied().map(ParameterId::Term));
    parameters.extend(ParameterId::all_of_frame(0));
    parameters.extend(ParameterId::all_of_target(0));
    let mut forward = ForwardModel::new(Mode::Extended, &nominal);
    forward.set_terms(terms.into_iter());
    let rows = structural_poses(&nominal.kinematics, 3)
        .into_iter()
        .map(|joints| {
            // In the middle of the limits, where the four-bar closes.
            let middle = nominal.kinematics.links.iter().map(|l| 0.5 * (l.limits[0] + l.limits[1]));
            let near: Vec<_> =
                joints.iter().zip(middle).map(|(q, middle)| middle + 0.5 * (q - middle)).collect();
            let command = nominal.actuators.command_from_joints(&near);
            let ways: Vec<f64> = (1..).map(|i| 0.004 * f64::from(i)).take(command.len()).collect();
            PositionRow {
                hours: 0.0,
                instrument: Vec::new(),
                pose: 0,
                told: forward
                    .prepare(&PoseQuery::at(&command).approached(&signs(&command)).moved(&ways))
                    .expect("a machine that stands"),
                seen: Vector3::zeros(),
                reading: None,
                whitening: Matrix3::identity(),
                station: 0,
                target: 0,
            }
        })
        .collect::<Vec<_>>();
    let stations = vec![translation(1.0, 2.0, 3.0) * rotation_x(0.3)];
    let targets = vec![target];
    CalibrationProblem {
        swept: Vec::new(),
        left_of_swept: 0.0,
        priors: Vec::new(),
        own_priors: vec![(40, 10.0)],
        logarithmic: Vec::new(),
        tolerances: vec![(1, 2.0)],
        current: Current::new(&nominal, forward, &stations, &targets, &[Rotation3::identity()]),
        turns: Vec::new(),
        turn_of: vec![None; rows.len()],
        orientations: vec![Rotation3::identity()],
        turn_motions: Vec::new(),
        turn_whitening: Vec::new(),
        shared: DMatrix::zeros(0, 0),
        shared_whitening: None,
        rows,
        nominal,
        parameters,
        stations,
        targets,
        poses: Vec::new(),
        motions: Vec::new(),
        unmodelled: 0.0,
        stated_actuators: None,
        noise: Noise::default(),
        joined: Vec::new(),
        start: None,
    }
}

/// A column smaller than this, m per unit, is rounding of the difference.
const LEAST_COLUMN: f64 = 2e-6;

#[test]
fn every_column_of_the_coupled_jacobian_is_the_central_difference() {
    check_coupled(coupled());
    check_coupled(with_turns(coupled()));
}

fn check_coupled(mut problem: CalibrationProblem) {
    let n = problem.parameters.len();
    let size = |id: &ParameterId| match id {
        ParameterId::Compliance(_) | ParameterId::Mass { .. } => 0.1,
        _ => 3e-3,
    };
    let x: Vec<f64> =
        problem.parameters.iter().enumerate().map(|(i, id)| size(id) * (1.7 * i as f64).sin()).collect();
    let m = LeastSquares::rows(&problem);
    let mut residuals = DVector::zeros(m);
    let mut jacobian = DMatrix::from_element(m, n, f64::NAN);
    problem.evaluate(&x, &mut residuals, Some(&mut jacobian));
    assert!(residuals.iter().all(|r| r.is_finite()));
    let mut worst = 0.0_f64;
    for column in 0..n {
        let id = problem.parameters[column];
        // Compliances and masses move the target little and nearly in proportion.
        let step = if id.unit() == Unit::One { 5e-2 } else { 1e-4 };
        let mut at = |steps: f64| {
            let mut moved = x.clone();
            moved[column] += steps * step;
            let mut r = DVector::zeros(m);
            problem.evaluate(&moved, &mut r, None);
            r
        };
        // Fourth-order difference.
        let difference = (8.0 * (at(1.0) - at(-1.0)) - (at(2.0) - at(-2.0))) / (12.0 * step);
        let largest = jacobian.column(column).amax();
        let error = (jacobian.column(column) - difference).amax();
        worst = worst.max(error / largest.max(LEAST_COLUMN));
        assert!(error <= 1e-6 * largest.max(LEAST_COLUMN), "{id}: {error:.1e} of {largest:.1e}");
    }
    println!("{n} columns, worst {worst:.1e} of the column's largest entry");
}

#[test]
fn coupled_evaluation_takes_no_memory() {
    let mut problem = coupled();
    let x = vec![1e-3; problem.parameters.len()];
    let mut residuals = DVector::zeros(LeastSquares::rows(&problem));
    let mut jacobian = DMatrix::zeros(residuals.len(), x.len());
    problem.evaluate(&x, &mut residuals, Some(&mut jacobian));
    let info = allocation_counter::measure(|| problem.evaluate(&x, &mut residuals, Some(&mut jacobian)));
    assert_eq!(info.count_total, 0);
}

#[test]
fn a_linkage_that_does_not_close_makes_residuals_that_are_no_numbers() {
    let mut problem = coupled();
    let mut x = vec![0.0; problem.parameters.len()];
    let rod = ParameterId::Linkage(calibrig_model::LinkageTerm::Rod);
    let Some(column) = problem.parameters.iter().position(|id| *id == rod) else { panic!("a four-bar") };
    x[column] = 10.0;
    let mut residuals = DVector::zeros(LeastSquares::rows(&problem));
    problem.evaluate(&x, &mut residuals, None);
    assert!(residuals[0].is_nan());
    let (_, reason) = problem.failure(0).expect("a rod of 10 m too much");
    assert!(!reason.to_string().is_empty());
}
