//! Parameters that are fixed and freed by name.

use nalgebra::{Matrix3, Vector3};

use super::super::*;
use super::{SHOULDER, geometric_errors, measure, options, painter, truth};
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::{CalibrationModel, CraigLink, LinkTerm, ParameterId};

fn id(name: &str) -> ParameterId {
    ParameterId::parse(name).unwrap_or_else(|| panic!("{name}"))
}

/// Neighbouring axes 2 and 3 are parallel: only the sum of their d can be determined.
fn parallel() -> CalibrationModel {
    CalibrationModel::new(vec![
        CraigLink::revolute("j1").row(0.0, 0.0, 0.4, 0.0).limits(-2.9, 2.9),
        CraigLink::revolute("j2").row(0.05, -std::f64::consts::FRAC_PI_2, 0.0, 0.0).limits(-1.8, 1.8),
        CraigLink::revolute("j3").row(0.6, 0.0, 0.1, 0.0).limits(-2.5, 2.5),
        CraigLink::revolute("j4").row(0.5, std::f64::consts::FRAC_PI_2, 0.2, 0.0).limits(-2.9, 2.9),
    ])
    .expect("a chain")
}

fn fitted(model: &CalibrationModel, set: &MeasurementSet, fix: &[&str], free: &[&str]) -> Estimate {
    let list = |names: &[&str]| names.iter().map(|name| id(name)).collect();
    let options = IdentificationOptions {
        mode: Mode::OnlyCalibration,
        fix: list(fix),
        free: list(free),
        target: TargetChoice::Measured,
        frame: FrameChoice::Nests,
        tolerance: None,
        ..IdentificationOptions::default()
    };
    identify(model, set, &options).expect("an estimate")
}

#[test]
fn of_parameters_that_do_the_same_the_freed_one_is_taken_and_nothing_else_changes() {
    let nominal = parallel();
    let deviations = [(ParameterId::link(2, LinkTerm::D), 2e-3), (ParameterId::link(3, LinkTerm::A), -1e-3)];
    let set = measure(&truth(&nominal, &deviations, Vec::new()), 60, 1.0);
    let [taken, left] = ["delta_d3", "delta_d2"];
    let [default, other] = [&[][..], &[left]].map(|free| fitted(&nominal, &set, &[], free));
    let has = |estimate: &Estimate, name: &str| estimate.value(id(name)).is_some();
    assert!(has(&default, taken) && !has(&default, left));
    assert!(has(&other, left) && !has(&other, taken));
    assert!((default.chi2 - other.chi2).abs() < 1e-4 * default.chi2, "{} {}", default.chi2, other.chi2);
    // If one is fixed, the other takes the sum: the robot is the same.
    let fixed = fitted(&nominal, &set, &[taken], &[]);
    assert!(has(&fixed, left) && !has(&fixed, taken));
    assert_eq!(fixed.chi2, other.chi2);
}

#[test]
fn what_is_fixed_stays_and_is_listed() {
    let nominal = parallel();
    let deviations = [(ParameterId::link(3, LinkTerm::Alpha), 1e-3)];
    let set = measure(&truth(&nominal, &deviations, Vec::new()), 60, 0.0);
    let estimate = fitted(&nominal, &set, &["delta_a2", "delta_theta4"], &[]);
    for name in ["delta_a2", "delta_theta4"] {
        assert_eq!(estimate.value(id(name)), None);
        let left = estimate.left_out.iter().find(|left| left.id == id(name)).expect("listed");
        assert_eq!(left.reason, LeftOutReason::ByName);
    }
    let links = |estimate: &Estimate, link: usize| estimate.robot.model.kinematics.links[link].clone();
    assert_eq!(links(&estimate, 1).a, nominal.kinematics.links[1].a);
    assert!((estimate.value(deviations[0].0).expect("fitted") - 1e-3).abs() < 1e-9);
}

/// A fixed coordinate is the limit of one that was measured without error; a freed one is the limit of one that was not measured.
#[test]
fn coordinates_of_a_target_are_limits_of_what_was_measured_of_it() {
    let nominal = parallel();
    let mut set = measure(&truth(&nominal, &[], Vec::new()), 40, 1.0);
    let mixed = Matrix3::new(4.0, 1.0, 0.5, 1.0, 3.0, -0.8, 0.5, -0.8, 2.0) * 1e-10;
    set.targets[0].covariance = Some(mixed);
    let with = |scale: Vector3<f64>| {
        let mut set = set.clone();
        let scale = Matrix3::from_diagonal(&scale);
        // Widening must not leave correlations with the other coordinates.
        set.targets[0].covariance = Some(scale * mixed * scale);
        fitted(&nominal, &set, &[], &[])
    };
    let near = |found: &Estimate, limit: &Estimate, fixed: Option<ParameterId>| {
        for parameter in limit.parameters.iter().filter(|p| Some(p.id) != fixed) {
            let value = found.value(parameter.id).expect("in both");
            let sigma = parameter.sigma.expect("determined");
            assert!((value - parameter.value).abs() < 2e-3 * sigma, "{}: {value}", parameter.id);
        }
    };
    let free = fitted(&nominal, &set, &[], &["target_y"]);
    near(&free, &with(Vector3::new(1.0, 1e5, 1.0)), None);
    let fixed = fitted(&nominal, &set, &["target_x"], &[]);
    assert_eq!(fixed.value(id("target_x")), None);
    // Conditioned on x: the covariance of y and z less the part that x determines.
    let mut conditioned = set.clone();
    let information =
        mixed.try_inverse().expect("regular") + Matrix3::from_diagonal(&Vector3::new(1e18, 0.0, 0.0));
    conditioned.targets[0].covariance = information.try_inverse();
    near(&fixed, &fitted(&nominal, &conditioned, &[], &[]), Some(id("target_x")));
    let all = fitted(&nominal, &set, &["target_x", "target_y", "target_z"], &[]);
    assert!(all.parameters.iter().all(|p| !matches!(p.id, ParameterId::Target { .. })));
}

#[test]
fn compliances_and_terms_are_fixed_and_freed() {
    let nominal = painter();
    let set = measure(&truth(&nominal, &geometric_errors(&nominal), Vec::new()), 40, 1.0);
    let shoulder = ParameterId::Compliance(SHOULDER);
    let with = |mode, fix: &[ParameterId], free: &[ParameterId]| IdentificationOptions {
        fix: fix.to_vec(),
        free: free.to_vec(),
        ..options(mode)
    };
    let estimate =
        identify(&nominal, &set, &with(Mode::ElastoGeometric, &[shoulder], &[])).expect("an estimate");
    assert_eq!(estimate.value(shoulder), None);
    let waist = id("compliance_drive2");
    let estimate =
        identify(&nominal, &set, &with(Mode::ElastoGeometric, &[], &[waist])).expect("an estimate");
    // Gravity does not load it: it is fitted nevertheless, and this is reported.
    assert!(estimate.value(waist).is_some());
    assert!(
        estimate
            .warnings
            .iter()
            .any(|w| matches!(w, Warning::Unexcited { name } if *name == waist.to_string()))
    );
    let term = id("ratio_d5");
    let estimate = identify(&nominal, &set, &with(Mode::Extended, &[], &[term])).expect("an estimate");
    let terms = estimate.parameters.iter().filter(|p| matches!(p.id, ParameterId::Term(_)));
    assert_eq!(terms.map(|p| p.id).collect::<Vec<_>>(), [term]);
}

#[test]
fn what_cannot_be_is_refused() {
    let nominal = painter();
    let set = measure(&nominal_truth(&nominal), 10, 0.0);
    let modes = [Mode::OnlyCalibration];
    let refused = |fix: &[&str], free: &[&str]| {
        let list = |names: &[&str]| names.iter().map(|name| id(name)).collect();
        let options =
            IdentificationOptions { fix: list(fix), free: list(free), ..options(Mode::OnlyCalibration) };
        check_named(&nominal, &modes, &options, &set.stations, &set.targets)
    };
    assert_eq!(refused(&["delta_a2", "target_z"], &["delta_beta3"]), Ok(()));
    assert!(matches!(refused(&["frame_x"], &[]), Err(ByNameError::Frame { .. })));
    assert!(matches!(refused(&["delta_a2"], &["delta_a2"]), Err(ByNameError::Both { .. })));
    assert!(matches!(refused(&["delta_a9"], &[]), Err(ByNameError::Unknown { .. })));
    assert!(matches!(refused(&[], &["target2_x"]), Err(ByNameError::Unknown { .. })));
    assert!(matches!(refused(&[], &["compliance_drive3"]), Err(ByNameError::NotFitted { .. })));
}

fn nominal_truth(nominal: &CalibrationModel) -> CalibratedRobot {
    truth(nominal, &[], Vec::new())
}
