mod rows;
mod statements;

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::{DMatrix, DVector, Point3, Vector3};

use super::convention::other_convention;
use super::place::{Cloud, Placed};
use super::session::Session;
use super::*;
use crate::kinematics::{KinematicChain, target_in_base};
use calibrig_model::geometry::{Transform, rotation_x, rotation_z, translation};
use calibrig_model::measurement::{Reading, SphericalReading};
use calibrig_model::{ActuatorMap, AxisMap, CraigLink};

const TOOL: Vector3<f64> = Vector3::new(0.08, -0.05, 0.12);

fn industrial() -> CalibrationModel {
    let rows = [
        (0.0, 0.0, 0.4, 0.0),
        (0.15, -FRAC_PI_2, 0.0, -FRAC_PI_2),
        (0.6, 0.0, 0.0, 0.0),
        (0.1, -FRAC_PI_2, 0.64, 0.0),
        (0.0, FRAC_PI_2, 0.0, 0.0),
        (0.0, -FRAC_PI_2, 0.1, 0.0),
    ];
    robot(&rows, None)
}

fn scara() -> CalibrationModel {
    let rows = [(0.0, 0.0, 0.5, 0.0), (0.35, 0.0, 0.0, 0.0), (0.3, PI, 0.0, 0.0), (0.0, 0.0, 0.05, 0.0)];
    robot(&rows, Some(2))
}

fn robot(rows: &[(f64, f64, f64, f64)], prismatic: Option<usize>) -> CalibrationModel {
    let link = |(i, &(a, alpha, d, theta)): (usize, &(f64, f64, f64, f64))| {
        let name = format!("J{}", i + 1);
        if prismatic == Some(i) {
            CraigLink::prismatic(name).row(a, alpha, d, theta).limits(0.0, 0.4)
        } else {
            CraigLink::revolute(name).row(a, alpha, d, theta).limits(-2.0, 2.0)
        }
    };
    CalibrationModel::new(rows.iter().enumerate().map(link).collect()).expect("a robot")
}

/// Points of a machine whose links are off by `size` (m, rad), seen by a tracker next to it.
fn measure(model: &CalibrationModel, poses: usize, size: f64) -> MeasurementSet {
    let mut machine = model.kinematics.clone();
    for (i, link) in machine.links.iter_mut().enumerate() {
        let sign = if i % 2 == 0 { size } else { -size };
        (link.a, link.theta, link.alpha) = (link.a + sign, link.theta + sign, link.alpha - sign);
    }
    let place: Transform = translation(3.0, -1.0, 0.5) * rotation_z(0.7) * rotation_x(0.02);
    MeasurementSet::of_points((0..poses).map(|k| {
        let command = model.kinematics.links.iter().enumerate().map(|(i, link)| {
            let share = 0.5 + 0.5 * ((1.3 + 0.71 * i as f64) * (k + 1) as f64).sin();
            link.limits[0] + (link.limits[1] - link.limits[0]) * share
        });
        let command = command.collect::<Vec<_>>();
        let point = target_in_base(&machine, &command, &TOOL).expect("a pose");
        let noise = Vector3::from_fn(|axis, _| 20e-6 * ((7.3 + axis as f64) * (k + 1) as f64).sin());
        (command, (place * Point3::from(point)).coords + noise)
    }))
}

fn first(model: &CalibrationModel, set: &MeasurementSet) -> (Diagnosis, Vec<&'static str>) {
    let found = diagnose(model, set).expect("model and set belong together");
    let kinds = found.hypotheses[0].kinds();
    (found, kinds)
}

fn points(set: &mut MeasurementSet, change: impl Fn(Vector3<f64>) -> Vector3<f64>) {
    for observation in &mut set.observations {
        observation.reading =
            Reading::Cartesian { position: change(observation.reading.position()), covariance: None };
    }
}

/// The likelihood by its definition: a normal distribution of all coordinates with the links' covariance, with places integrated out.
#[test]
fn the_evidence_is_the_marginal_likelihood() {
    let model = industrial();
    let set = measure(&model, 14, 1e-3);
    let session = Session::new(&model, &set);
    let view = session.view(&[]).expect("a view");
    let cloud = Cloud::new(&view, &mut KinematicChain::new(&model.kinematics));
    let placed: Placed = cloud.refined(cloud.best(None));
    let kept = vec![true; view.rows.len()];
    let fit = evidence::fit(&view, &placed, &kept).expect("a fit");
    // The same system at the fit, with full matrices, over a grid of both sizes.
    let (jacobian, y, places) = evidence::dense(&view, &fit.placed);
    let freedom = y.len() - places;
    let x = jacobian.columns(0, places).into_owned();
    let z = jacobian.columns(places, jacobian.ncols() - places).into_owned();
    let mut least = f64::INFINITY;
    for i in 0..60 {
        for j in 0..40 {
            let (sigma, tau) = (2e-6 * 1.15_f64.powi(i), 0.1 * 1.12_f64.powi(j));
            let v = DMatrix::identity(y.len(), y.len()) * (sigma * sigma) + &z * z.transpose() * (tau * tau);
            let factor = v.cholesky().expect("a covariance");
            let log_v: f64 = 2.0 * factor.l().diagonal().iter().map(|d: &f64| d.ln()).sum::<f64>();
            let inner = x.tr_mul(&factor.solve(&x));
            let solved: DVector<f64> = factor.solve(&y);
            let b = x.tr_mul(&solved);
            let inner = inner.cholesky().expect("places are determined");
            let log_inner: f64 = 2.0 * inner.l().diagonal().iter().map(|d: &f64| d.ln()).sum::<f64>();
            let squares = y.dot(&solved) - b.dot(&inner.solve(&b));
            let usual = f64::ln(tau) / if tau > 1.0 { 1.2 } else { 4.0 };
            least = least.min(log_v + log_inner + squares + freedom as f64 * TAU.ln() + usual * usual);
        }
    }
    assert!((fit.score - least).abs() < 1.5, "{} {least}", fit.score);
    assert!((10e-6..30e-6).contains(&fit.sigma), "{}", fit.sigma);
}

#[test]
fn the_other_convention_is_that_of_the_same_table() {
    let chain = industrial().kinematics;
    let standard = other_convention(&chain, true).expect("a table");
    // Rz(theta) Tz(d) Tx(a) Rx(alpha), row by row, from the table as given.
    let q = [0.3, -0.8, 1.1, 0.4, -1.3, 2.0];
    let rows = chain.links.iter().zip(q).map(|(link, q)| {
        rotation_z(link.theta + q)
            * translation(0.0, 0.0, link.d)
            * translation(link.a, 0.0, 0.0)
            * rotation_x(link.alpha)
    });
    let expected = rows.fold(Transform::identity(), |all, row| all * row);
    let found = crate::kinematics::forward_kinematics(&standard, &q).expect("a pose");
    assert!((found.to_homogeneous() - expected.to_homogeneous()).norm() < 1e-12);
    let back = other_convention(&standard, false).expect("a table");
    for (a, b) in back.links.iter().zip(&chain.links) {
        assert!((a.a - b.a).abs() < 1e-12 && (a.alpha - b.alpha).abs() < 1e-12);
    }
}

/// Hypotheses that no measurement separates are in one class: the rest of the wrist turned by half a turn with its bend the other way; a mirror
/// image of a robot with upright axes, with its slide the other way.
#[test]
fn what_is_the_same_by_symmetry_is_of_one_class() {
    let model = industrial();
    let mut set = measure(&model, 30, 0.0);
    set.observations.iter_mut().for_each(|o| o.command[4] = -o.command[4]);
    let (found, _) = first(&model, &set);
    let class = |part: &Part| found.hypotheses.iter().find(|h| h.parts == [part.clone()]).map(|h| h.class);
    assert_eq!(class(&Part::Sign { joint: 4 }), Some(0), "{found:?}");
    assert_eq!(class(&Part::Offset { joint: 3, quarters: 2 }), Some(0), "{found:?}");
    let model = scara();
    let mut set = measure(&model, 30, 0.0);
    points(&mut set, |p| Vector3::new(p.y, p.x, p.z));
    let (found, _) = first(&model, &set);
    let class = |part: &Part| found.hypotheses.iter().find(|h| h.parts == [part.clone()]).map(|h| h.class);
    assert_eq!(class(&Part::Mirrored), Some(0), "{found:?}");
    assert_eq!(class(&Part::Sign { joint: 2 }), Some(0), "{found:?}");
}

/// Coordinates that another program computed from a zenith angle, or from exchanged angles, can still be converted back.
#[test]
fn angles_are_found_in_coordinates_as_well() {
    let model = industrial();
    for (kind, exchanged) in [("zenith_elevation", false), ("axes_exchanged", true)] {
        let mut set = measure(&model, 40, 1e-3);
        points(&mut set, |p| {
            let (range, azimuth, elevation) = (p.norm(), p.y.atan2(p.x), p.z.atan2(p.x.hypot(p.y)));
            let (az, el) = if exchanged { (elevation, azimuth) } else { (azimuth, FRAC_PI_2 - elevation) };
            range * Vector3::new(el.cos() * az.cos(), el.cos() * az.sin(), el.sin())
        });
        let (found, kinds) = first(&model, &set);
        assert_eq!(kinds, [kind], "{found:?}");
        assert!(found.hypotheses[0].rms < 5e-3);
    }
}

#[test]
fn a_sound_session_is_sound_and_says_how_sure() {
    let model = industrial();
    for (poses, size) in [(15, 0.0), (15, 1e-3), (60, 5e-3), (700, 1e-3)] {
        let (found, kinds) = first(&model, &measure(&model, poses, size));
        assert_eq!((kinds, found.finding()), (vec!["sound"], Finding::Sound), "{poses} {size}: {found:?}");
        assert!(found.hypotheses[0].probability > 0.5);
    }
}

#[test]
fn what_cannot_be_told_is_named() {
    let model = industrial();
    let mut set = measure(&model, 30, 1e-3);
    assert_eq!(diagnose(&model, &set).expect("a set").undetermined, []);
    set.observations.iter_mut().for_each(|o| o.command[3] = 0.4);
    let told = |set: &MeasurementSet| diagnose(&model, set).expect("a set").undetermined;
    assert!(told(&set).contains(&Undetermined::NeverMoved { joints: vec![3] }));
    let (a, mut b) = (set.observations[0].clone(), set.observations[1].clone());
    b.command.clone_from(&a.command);
    set.observations[1] = b;
    assert!(told(&set).contains(&Undetermined::EqualPoses { poses: 1, observations: 2 }));
    for (change, is_it) in [
        ((|p| Vector3::new(p.x, 0.0, 0.0)) as fn(Vector3<f64>) -> Vector3<f64>, Undetermined::Line),
        (|p| Vector3::new(p.x, p.y, 0.1 * p.x), Undetermined::Plane),
        (|p| 0.8 * p.normalize(), Undetermined::Sphere { radius: 0.8 }),
    ] {
        let mut set = set.clone();
        points(&mut set, change);
        let found = told(&set);
        let is_there = found.iter().any(|what| match (what, &is_it) {
            (Undetermined::Sphere { radius }, Undetermined::Sphere { radius: expected }) => {
                (radius - expected).abs() < 1e-3
            }
            (what, expected) => what == expected,
        });
        assert!(is_there, "{is_it:?}: {found:?}");
    }
    set.observations.truncate(4);
    assert!(told(&set).iter().any(|what| matches!(what, Undetermined::FewPoses { distinct: 3, .. })));
}

/// Every degenerate session has an answer, without a panic.
#[test]
fn degenerate_sessions_have_an_answer() {
    for model in [industrial(), scara()] {
        for poses in 1..8 {
            assert!(diagnose(&model, &measure(&model, poses, 1e-3)).is_ok());
        }
        let mut set = measure(&model, 20, 1e-3);
        points(&mut set, |_| Vector3::new(1.0, 2.0, 3.0));
        assert!(diagnose(&model, &set).is_ok_and(|found| found.finding() == Finding::Sound));
        points(&mut set, |_| Vector3::zeros());
        assert!(diagnose(&model, &set).is_ok());
        let mut set = measure(&model, 20, 1e-3);
        points(&mut set, |p| 1e12 * p);
        assert!(diagnose(&model, &set).is_ok());
    }
    let one = robot(&[(0.0, 0.0, 0.4, 0.0)], None);
    assert!(diagnose(&one, &measure(&one, 20, 1e-3)).is_ok());
}

/// Readings with angles, both in another unit, with either reference of the second angle.
#[test]
fn the_unit_of_angles_is_found_whichever_way_they_are_counted() {
    let model = industrial();
    for (to, from_zenith) in [
        (1.0_f64.to_radians(), false),
        (1.0_f64.to_radians(), true),
        (1.0_f64.to_degrees(), false),
        (1.0_f64.to_degrees(), true),
    ] {
        let mut set = measure(&model, 30, 1e-3);
        for observation in &mut set.observations {
            let p = observation.reading.position();
            let (azimuth, elevation) = (p.y.atan2(p.x), p.z.atan2(p.x.hypot(p.y)));
            let from = if from_zenith { FRAC_PI_2 } else { 0.0 };
            observation.reading = Reading::Spherical(SphericalReading {
                face: calibrig_model::measurement::Face::Front,
                range: p.norm(),
                azimuth: azimuth * to,
                elevation: from + (elevation - from) * to,
                covariance: Some(nalgebra::Matrix3::identity() * 1e-10),
            });
        }
        let (found, kinds) = first(&model, &set);
        assert_eq!(kinds, ["angle_unit"], "{to} {from_zenith}: {found:?}");
        assert!(found.hypotheses[0].rms < 5e-3);
    }
}

/// The fifth axis turns back what the fourth turns, the sixth what the fifth does: if the table lacks the latter, a single coupling is reported.
#[test]
fn a_coupling_with_an_axis_that_is_coupled_itself_is_one() {
    let coupled = |shares: &[(usize, usize, f64)]| {
        let mut map = DMatrix::identity(6, 6);
        for (axis, other, share) in shares {
            map[(*axis, *other)] = *share;
        }
        let axes = AxisMap::new(map, DVector::zeros(6)).expect("a map");
        let mut model = industrial();
        model.actuators = ActuatorMap::Axes { axes, elbow: None };
        model
    };
    let (machine, table) = (coupled(&[(4, 3, -1.0), (5, 4, 1.0)]), coupled(&[(4, 3, -1.0)]));
    let mut set = measure(&machine, 40, 1e-3);
    for observation in &mut set.observations {
        observation.command = machine.actuators.command_from_joints(&observation.command);
    }
    assert_eq!(first(&machine, &set).1, ["sound"]);
    let (found, _) = first(&table, &set);
    assert_eq!(
        found.hypotheses[0].parts,
        [Part::Coupling { joint: 5, with: 4, share: -1.0, of_joint: true }],
        "{found:?}"
    );
}

/// All columns in reverse order, or the first one at the end, is a common mistake: it is found also next to another one.
#[test]
fn all_columns_in_another_order_are_found_beside_another_part() {
    let model = industrial();
    for from in [[5, 4, 3, 2, 1, 0], [5, 0, 1, 2, 3, 4], [1, 2, 3, 4, 5, 0]] {
        let mut set = measure(&model, 40, 1e-3);
        for observation in &mut set.observations {
            let joints = observation.command.clone();
            for (joint, column) in from.iter().enumerate() {
                observation.command[*column] = joints[joint];
            }
        }
        points(&mut set, |p| 1e3 * p);
        let (found, kinds) = first(&model, &set);
        let order = found.hypotheses[0].parts.iter().find_map(|part| match part {
            Part::Order { from, .. } => Some(from.clone()),
            _ => None,
        });
        assert_eq!(order.as_deref(), Some(&from[..]), "{kinds:?}");
        assert!(kinds.contains(&"length_unit"), "{kinds:?}");
    }
}
