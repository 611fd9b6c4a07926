use std::f64::consts::FRAC_PI_2;

use nalgebra::Vector3;

use super::*;
use crate::kinematics::target_in_base;
use calibrig_model::geometry::{Transform, rotation_x, rotation_z, translation};
use calibrig_model::{CraigLink, KinematicModel};

/// Two axes; the offset of the target is larger than the links.
fn two_axes() -> CalibrationModel {
    let links = vec![
        CraigLink::revolute("J1").row(0.0, 0.0, 0.7, 0.0).limits(-3.0, 3.0),
        CraigLink::revolute("J2").row(0.15, -FRAC_PI_2, 0.0, 0.0).limits(-3.0, 3.0),
    ];
    CalibrationModel::new(links).expect("a robot")
}

fn six_axes() -> CalibrationModel {
    let rows = [
        (0.0, 0.0, 0.09),
        (0.0, FRAC_PI_2, 0.0),
        (-0.42, 0.0, 0.0),
        (-0.39, 0.0, 0.11),
        (0.0, FRAC_PI_2, 0.095),
        (0.0, -FRAC_PI_2, 0.08),
    ];
    let link = |(i, (a, alpha, d)): (usize, (f64, f64, f64))| {
        CraigLink::revolute(format!("J{}", i + 1)).row(a, alpha, d, 0.0).limits(-6.3, 6.3)
    };
    CalibrationModel::new(rows.into_iter().enumerate().map(link).collect()).expect("a robot")
}

fn on_a_rail() -> CalibrationModel {
    let links = vec![
        CraigLink::prismatic("rail").row(0.0, 0.0, 0.0, 0.0).limits(0.0, 3.0),
        CraigLink::revolute("shoulder").row(0.2, FRAC_PI_2, 0.0, 0.0).limits(-2.0, 2.0),
        CraigLink::revolute("elbow").row(0.9, 0.0, 0.0, 0.0).limits(-2.0, 2.0),
        CraigLink::revolute("wrist").row(0.1, -FRAC_PI_2, 0.7, 0.0).limits(-3.0, 3.0),
    ];
    CalibrationModel::new(links).expect("a robot")
}

const OFFSET: Vector3<f64> = Vector3::new(0.1, -0.25, 0.3);

/// Links of a machine that is off by millimetres and milliradians in turn, in proportion to `size`.
fn as_built(model: &CalibrationModel, size: f64) -> KinematicModel {
    let mut machine = model.kinematics.clone();
    for (i, link) in machine.links.iter_mut().enumerate() {
        let sign = if i % 2 == 0 { size } else { -size };
        link.a += sign;
        link.theta += sign;
        link.alpha -= sign;
    }
    machine
}

/// Points of a machine that is off by `size` (m, rad), seen by a tracker at another place.
fn measure(model: &CalibrationModel, poses: usize, size: f64) -> MeasurementSet {
    let machine = as_built(model, size);
    let place: Transform = translation(2.0, -3.0, 0.5) * rotation_z(2.0) * rotation_x(0.3);
    MeasurementSet::of_points((0..poses).map(|k| {
        let command: Vec<f64> = model
            .kinematics
            .links
            .iter()
            .enumerate()
            .map(|(i, link)| {
                let share = 0.5 + 0.5 * ((1.3 + 0.71 * i as f64) * (k + 1) as f64).sin();
                let (low, high) = (link.limits[0].max(-3.0), link.limits[1].min(3.0));
                low + (high - low) * share
            })
            .collect();
        let point = target_in_base(&machine, &command, &OFFSET).expect("a pose");
        let seen = (place * nalgebra::Point3::from(point)).coords;
        (command, seen)
    }))
}

fn look(model: &CalibrationModel, set: &MeasurementSet) -> Plausibility {
    plausibility(model, set).expect("model and set belong together")
}

fn move_point(set: &mut MeasurementSet, i: usize, to: impl FnOnce(Vector3<f64>) -> Vector3<f64>) {
    if let Reading::Cartesian { position, .. } = &mut set.observations[i].reading {
        *position = to(*position);
    }
}

#[test]
fn robots_that_are_off_by_millimetres_and_by_centimetres_are_fitted() {
    for model in [two_axes(), six_axes(), on_a_rail()] {
        for (size, poses) in [(0.0, 20), (1e-3, 8), (1e-3, 30), (10e-3, 30), (30e-3, 60)] {
            let found = look(&model, &measure(&model, poses, size));
            assert!(found.is_plausible(false) && found.is_plausible(true), "{size}, {poses}: {found:?}");
            assert!(found.explanation().is_none() && found.unreachable.is_empty());
        }
        // Tracker and target can explain whatever three poses show.
        assert_eq!(look(&model, &measure(&model, 3, 30e-3)).rms, None);
    }
}

/// Against the rigid fit with the true offset and the known error of the machine.
#[test]
fn what_is_left_is_the_error_of_the_robot() {
    let model = six_axes();
    let exact = look(&model, &measure(&model, 30, 0.0));
    assert!(exact.rms.is_some_and(|rms| rms < 1e-9), "{exact:?}");
    let set = measure(&model, 30, 0.0);
    let mut off = set.clone();
    for (i, sign) in [1.0, -1.0].into_iter().cycle().take(30).enumerate() {
        move_point(&mut off, i, |p| p + Vector3::new(0.0, sign * 2e-3, 0.0));
    }
    let left = look(&model, &off).rms.expect("degrees of freedom");
    assert!((1.5e-3..2e-3).contains(&left), "{left}");
    assert!((exact.spread / set.spread() - 1.0).abs() < 1e-12);
}

#[test]
fn exchanged_rows_are_named() {
    for model in [two_axes(), six_axes()] {
        let mut set = measure(&model, 30, 1e-3);
        let (a, b) = (set.observations[4].reading.clone(), set.observations[13].reading.clone());
        (set.observations[4].reading, set.observations[13].reading) = (b, a);
        let found = look(&model, &set);
        let explained = found.explanation().expect("rows to blame");
        assert_eq!(explained, [Part::ExchangedRows { cycles: vec![vec![4, 13]] }]);
        assert!(found.first_rms() < Some(10e-3) && found.rms > Some(50e-3), "{found:?}");
        assert!(!found.is_plausible(false) && found.is_plausible(true));
    }
}

#[test]
fn a_row_far_off_is_named_with_its_size_and_leaves_the_rest_plausible() {
    let model = six_axes();
    let mut set = measure(&model, 30, 1e-3);
    move_point(&mut set, 7, |p| p + Vector3::new(0.15, 0.0, 0.0));
    let found = look(&model, &set);
    let Some([Part::GrossErrors { rows }]) = found.explanation() else { panic!("{found:?}") };
    let [row] = rows[..] else { panic!("{rows:?}") };
    assert!(row.observation == 7 && (row.distance - 0.15).abs() < 0.02, "{row:?}");
    assert!(found.is_plausible(false));
    // Large enough to spoil the whole least squares fit.
    move_point(&mut set, 7, |p| p + Vector3::new(2.0, 0.0, 0.0));
    let found = look(&model, &set);
    assert!(!found.is_plausible(false) && found.is_plausible(true), "{found:?}");
}

#[test]
fn codes_of_missed_shots_are_points_that_no_pose_reaches() {
    for code in [[-9999.0; 3], [999_999.0; 3], [0.0; 3], [-9.999; 3]] {
        for poses in [12, 200] {
            let model = six_axes();
            let mut set = measure(&model, poses, 1e-3);
            for i in [3, 8] {
                move_point(&mut set, i, |_| Vector3::from(code));
            }
            let found = look(&model, &set);
            let far: Vec<_> = found.unreachable.iter().map(|far| far.observation).collect();
            assert_eq!(far, [3, 8], "{code:?}");
            assert!(!found.is_plausible(true) && found.rms < Some(10e-3), "{found:?}");
        }
    }
}

#[test]
fn a_wrong_convention_is_no_reason_to_fit_with_any_loss() {
    let model = six_axes();
    let mut set = measure(&model, 60, 1e-3);
    set.observations.iter_mut().for_each(|observation| observation.command[2] *= -1.0);
    let found = look(&model, &set);
    assert_eq!(found.explanation(), Some(&[Part::Sign { joint: 2 }][..]));
    assert!(!found.is_plausible(false) && !found.is_plausible(true));
}

#[test]
fn commands_beyond_the_limits_are_told() {
    let model = two_axes();
    let mut set = measure(&model, 20, 0.0);
    assert!(look(&model, &set).beyond_limits.is_empty());
    set.observations[3].command[1] = 166.0;
    let [beyond] = look(&model, &set).beyond_limits[..] else { panic!("one joint") };
    assert_eq!((beyond.joint, beyond.reached[1], beyond.limits), (1, 166.0, [-3.0, 3.0]));
}

#[test]
fn a_set_of_another_robot_is_an_error() {
    let set = measure(&two_axes(), 10, 0.0);
    assert!(plausibility(&six_axes(), &set).is_err());
    assert!(plausibility(&two_axes(), &MeasurementSet::default()).is_err());
}
