//! Robots that leave part of the tracker's place or of the target undetermined, whatever is measured, and robots whose nominal target does not move.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::Vector3;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::super::*;
use crate::kinematics::target_in_base;
use calibrig_model::geometry::{rotation_x, rotation_z, translation};
use calibrig_model::measurement::{MeasurementSet, Station, Target};
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::{CalibrationModel, CraigLink, LinkTerm, ParameterId};

fn scara() -> CalibrationModel {
    chain(vec![
        CraigLink::revolute("j1").row(0.0, 0.0, 0.3, 0.0).limits(-2.6, 2.6),
        CraigLink::revolute("j2").row(0.325, 0.0, 0.0, 0.0).limits(-2.4, 2.4),
        CraigLink::prismatic("j3").row(0.275, PI, 0.0, 0.0).limits(0.05, 0.25),
        CraigLink::revolute("j4").row(0.0, 0.0, 0.03, 0.0).limits(-3.0, 3.0),
    ])
}

/// Three prismatic joints along x, y and z.
fn slides() -> Vec<CraigLink> {
    vec![
        CraigLink::prismatic("x").row(0.0, FRAC_PI_2, 0.0, FRAC_PI_2).limits(0.0, 2.0),
        CraigLink::prismatic("y").row(0.0, FRAC_PI_2, 0.0, FRAC_PI_2).limits(0.0, 1.5),
        CraigLink::prismatic("z").row(0.0, FRAC_PI_2, 0.0, 0.0).limits(0.0, 1.0),
    ]
}

fn gantry(wrist: usize) -> CalibrationModel {
    let mut links = slides();
    links.push(CraigLink::revolute("c").row(0.0, 0.0, 0.1, 0.0).limits(-3.0, 3.0));
    links.push(CraigLink::revolute("b").row(0.05, FRAC_PI_2, 0.0, 0.0).limits(-1.5, 1.5));
    links.truncate(3 + wrist);
    chain(links)
}

/// Two axes that intersect in the flange's origin.
fn positioner() -> CalibrationModel {
    chain(vec![
        CraigLink::revolute("tilt").row(0.0, 0.0, 0.7, 0.0).limits(-1.7, 1.7),
        CraigLink::revolute("turn").row(0.0, -FRAC_PI_2, 0.0, 0.0).limits(-3.0, 3.0),
    ])
}

fn chain(links: Vec<CraigLink>) -> CalibrationModel {
    CalibrationModel::new(links).expect("a chain")
}

/// The robot with errors of 0.5 mm and 1 mrad in its links, and one target at each offset, seen in every pose from one of the stations.
fn measured(
    nominal: &CalibrationModel,
    offsets: &[Vector3<f64>],
    stations: usize,
    noise: f64,
) -> MeasurementSet {
    let mut random = stream(11, 0, StreamSource::AsBuilt);
    let mut normal = move || -> f64 { StandardNormal.sample(&mut random) };
    let mut real = nominal.kinematics.clone();
    for link in &mut real.links {
        for term in LinkTerm::ALL {
            let sigma = if matches!(term, LinkTerm::A | LinkTerm::D) { 0.5e-3 } else { 1e-3 };
            *link.term_mut(term) += sigma * normal();
        }
    }
    let places = [
        translation(3.0, 0.5, -0.4) * rotation_x(0.3) * rotation_z(2.0),
        translation(-2.0, 1.5, 0.2) * rotation_z(-0.7) * rotation_x(0.2),
    ];
    let mut draw = stream(12, 0, StreamSource::IdentificationPoses);
    let mut set = MeasurementSet::default();
    let mut points = Vec::new();
    for pose in 0..POSES {
        let joint = |link: &CraigLink| draw.random_range(link.limits[0]..link.limits[1]);
        let joints: Vec<f64> = real.links.iter().map(joint).collect();
        for offset in offsets {
            let at = target_in_base(&real, &joints, offset).expect("a pose");
            let seen = places[pose % stations].transform_point(&at.into()).coords;
            points.push((joints.clone(), seen + noise * Vector3::from_fn(|_, _| normal())));
        }
    }
    set.observations = MeasurementSet::of_points(points).with_sigma(noise.max(1e-6)).observations;
    for (index, observation) in set.observations.iter_mut().enumerate() {
        let pose = index / offsets.len();
        (observation.pose, observation.station) =
            (u32::try_from(pose).expect("few poses") + 1, pose % stations);
        observation.target = index % offsets.len();
    }
    let name = |index: usize| (index + 1).to_string();
    set.stations = (0..stations).map(|i| Station { name: name(i), ..Station::default() }).collect();
    let target =
        |i: usize| Target { name: name(i), in_flange: Vector3::zeros(), covariance: None, orientation: None };
    set.targets = (0..offsets.len()).map(target).collect();
    set
}

fn fit(nominal: &CalibrationModel, set: &MeasurementSet) -> (Estimate, f64) {
    let estimate = identify(nominal, set, &IdentificationOptions::default()).expect("an estimate");
    assert!(estimate.is_sound(), "{:?} {:?}", estimate.termination, estimate.warnings);
    assert_eq!(estimate.spectrum.rank, estimate.parameters.len());
    let errors = Predictor::new(&estimate.robot).expect("a robot").errors(set).expect("poses");
    let squares: f64 = errors.iter().map(Vector3::norm_squared).sum();
    let rms = (squares / errors.len() as f64).sqrt();
    (estimate, rms)
}

fn ids(estimate: &Estimate) -> Vec<ParameterId> {
    estimate.parameters.iter().map(|p| p.id).collect()
}

const OFFSET: Vector3<f64> = Vector3::new(0.12, -0.07, 0.15);
const POSES: usize = 40;
const NOISE: f64 = 20e-6;

#[test]
fn what_identifiability_selects_is_what_is_fitted() {
    for (nominal, open) in [(scara(), 1), (gantry(0), 3), (gantry(1), 1), (gantry(2), 0), (positioner(), 0)] {
        let (estimate, rms) = fit(&nominal, &measured(&nominal, &[OFFSET], 1, NOISE));
        let selected = complete_set(&nominal.kinematics, true, true).expect("a chain").selected;
        assert_eq!(ids(&estimate), selected);
        // Three coordinates per point, less what the fit takes.
        let expected = NOISE * (3.0 - selected.len() as f64 / POSES as f64).sqrt();
        assert!((rms / expected - 1.0).abs() < 0.3, "{rms} {expected}");
        assert_eq!(estimate.fixed.len(), open, "{:?}", estimate.fixed);
        let told = estimate.warnings.iter().any(|w| matches!(w, Warning::Fixed { .. }));
        assert_eq!(told, open > 0);
    }
}

/// Only what a shift of the station can do is left out: nothing of the second target.
#[test]
fn of_several_targets_one_is_left_at_its_place() {
    for stations in [1, 2] {
        let set = measured(&scara(), &[OFFSET, -OFFSET], stations, NOISE);
        let (estimate, _) = fit(&scara(), &set);
        let fixed: Vec<_> = estimate.fixed.iter().map(|group| group.redundant.to_string()).collect();
        assert_eq!(fixed, ["target_z"]);
        let apart = estimate.robot.targets[1].z - estimate.robot.targets[0].z;
        assert!((apart + 2.0 * OFFSET.z).abs() < 1e-4, "{apart}");
    }
}

/// Neither the listed nor the published parameters change which components of the ends are undetermined.
#[test]
fn a_target_along_an_axis_is_open_with_any_link_parameters() {
    let set = measured(&scara(), &[OFFSET], 1, NOISE);
    let listed = ParameterId::parse("delta_a2").expect("a name");
    let options = IdentificationOptions {
        parameters: ParameterChoice::Listed(vec![listed]),
        ..IdentificationOptions::default()
    };
    let estimate = identify(&scara(), &set, &options).expect("an estimate");
    assert_eq!(estimate.spectrum.rank, estimate.parameters.len());
    assert_eq!(estimate.parameters.len(), 9);
}

#[test]
fn a_target_at_rest_on_crossing_axes_is_sought() {
    for offset in [OFFSET, Vector3::new(-0.4, 0.1, 0.2), Vector3::new(0.0, 0.3, -0.05)] {
        let set = measured(&positioner(), &[offset], 1, 0.0);
        let (estimate, rms) = fit(&positioner(), &set);
        assert!(rms < 1e-9, "{rms}");
        assert_eq!(estimate.parameters.len(), 11);
        let mut stated = set.clone();
        stated.targets[0].in_flange = offset + Vector3::new(2e-3, -3e-3, 1e-3);
        let (from_stated, rms) = fit(&positioner(), &stated);
        assert!(rms < 1e-9, "{rms}");
        let apart = (from_stated.robot.targets[0] - estimate.robot.targets[0]).norm();
        assert!(apart < 1e-9, "{apart}");
    }
}
