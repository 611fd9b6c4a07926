//! Stated bounds are kept, reported, or refused in words.

use super::*;
use crate::identification::tests::{SHOULDER, WAIST, geometric_errors, measure, options, painter, truth};
use crate::identification::{ComplianceChoice, IdentifyError, MachineNoiseChoice, Warning, identify};
use calibrig_model::{ActuatorMap, LinkTerm};

const A4: ParameterId = ParameterId::link(3, LinkTerm::A);
const ELBOW_ANGLE: ParameterId = ParameterId::link(3, LinkTerm::Theta);

fn bound(id: ParameterId, lower: f64, upper: f64) -> ParameterBound {
    ParameterBound { id, lower, upper }
}

fn with(bounds: &[ParameterBound], mode: Mode) -> IdentificationOptions {
    // The misfit that a bound leaves must not be taken for noise of the machine.
    let machine_noise = MachineNoiseChoice::Stated(Vec::new());
    IdentificationOptions { bounds: bounds.to_vec(), machine_noise, ..options(mode) }
}

#[test]
fn bounds_are_told_in_the_units_of_people() {
    for (of, words) in [
        (bound(A4, -5e-3, 7e-3), "delta_a4 -5 to 7 mm"),
        (bound(ELBOW_ANGLE, f64::NEG_INFINITY, 0.3e-3), "delta_theta4 at most 0.3 mrad"),
        (bound(ParameterId::Compliance(SHOULDER), 0.0, f64::INFINITY), "compliance_drive3 at least 0"),
    ] {
        assert_eq!(of.to_string(), words);
    }
}

/// In every mode: the solver with and without bounds ends at the same place if no bound is reached, and at the bound if one is. Then the other
/// parameters are as if that one were known to be there.
#[test]
fn a_bound_is_kept_and_told_and_one_that_is_not_reached_changes_nothing() {
    let nominal = painter();
    let truths = geometric_errors(&nominal);
    let set = measure(&truth(&nominal, &truths, Vec::new()), 60, 1.0);
    for mode in [Mode::OnlyCalibration, Mode::ElastoGeometric] {
        let free = identify(&nominal, &set, &with(&[], mode)).expect("an estimate");
        assert!(free.bounds.is_empty());
        let value = free.value(A4).expect("identified");
        let wide = [bound(A4, -0.1, 0.1)];
        let inside = identify(&nominal, &set, &with(&wide, mode)).expect("an estimate");
        assert!(inside.at_bound.is_empty());
        assert_eq!(inside.bounds, wide);
        for (a, b) in free.parameters.iter().zip(&inside.parameters) {
            let sigma = a.sigma.expect("full rank");
            assert!((a.value - b.value).abs() < 1e-3 * sigma, "{}: {} {}", a.id, a.value, b.value);
        }
        // A little short of it: far from it, compliances would reach their own bounds.
        let sigma = free.parameters.iter().find(|p| p.id == A4).and_then(|p| p.sigma).expect("full rank");
        let short = value - 5.0 * sigma * value.signum();
        let narrow = [bound(A4, short.min(0.0), short.max(0.0))];
        let at = identify(&nominal, &set, &with(&narrow, mode)).expect("an estimate");
        assert_eq!((at.at_bound.as_slice(), at.value(A4)), (&[A4][..], Some(short)));
        assert!(!at.is_sound());
        let told = at.warnings.iter().find(|w| matches!(w, Warning::AtBound { .. })).expect("told");
        assert!(told.to_string().contains(&shown(Unit::Metre, short)), "{told}");
        let mut known = nominal.clone();
        known.kinematics.add(A4, short);
        if let (Mode::OnlyCalibration, ActuatorMap::Parallelogram { linkage, .. }) =
            (mode, &mut known.actuators)
        {
            // In this mode the parameter does not move the linkage; in the robot itself, it would make the parallelogram inexact.
            *linkage = None;
            known.statics = None;
        }
        let ids = free.parameters.iter().map(|p| p.id).filter(|id| *id != A4);
        let links = ids.filter(|id| matches!(id, ParameterId::Link { .. })).collect();
        let parameters = crate::identification::ParameterChoice::Listed(links);
        let without = IdentificationOptions { parameters, ..with(&[], mode) };
        let without = identify(&known, &set, &without).expect("an estimate");
        for p in &without.parameters {
            let (sigma, value) = (p.sigma.expect("full rank"), at.value(p.id).expect("in both"));
            assert!((p.value - value).abs() < 0.01 * sigma, "{}: {} {value}", p.id, p.value);
        }
    }
}

#[test]
fn a_compliance_at_a_stated_bound_is_not_told_to_be_rigid() {
    let nominal = painter();
    let id = ParameterId::Compliance(SHOULDER);
    let set = measure(&truth(&nominal, &[(id, -0.2)], Vec::new()), 60, 1.0);
    let options = IdentificationOptions {
        compliances: ComplianceChoice::Listed(vec![SHOULDER]),
        compliance_sigma: 1.0,
        ..with(&[bound(id, 0.0, f64::INFINITY)], Mode::ElastoGeometric)
    };
    let estimate = identify(&nominal, &set, &options).expect("an estimate");
    assert_eq!(estimate.value(id), Some(0.0));
    let told: Vec<_> = estimate.warnings.iter().map(ToString::to_string).collect();
    assert!(told.iter().any(|w| w.contains("compliance_drive3 ended at its bound 0:")), "{told:?}");
    assert!(!told.iter().any(|w| w.contains("rigid")), "{told:?}");
}

#[test]
fn a_bound_without_effect_is_told() {
    let nominal = painter();
    let set = measure(&truth(&nominal, &[], Vec::new()), 40, 1.0);
    // The axis is vertical, so that gravity does not load the drive.
    let of = bound(ParameterId::Compliance(WAIST), 0.0, 1.0);
    let estimate = identify(&nominal, &set, &with(&[of], Mode::ElastoGeometric)).expect("an estimate");
    assert!(estimate.warnings.contains(&Warning::UnusedBound { bound: of }), "{:?}", estimate.warnings);
    // In a mode without compliances there is nothing to report.
    let rigid = identify(&nominal, &set, &with(&[of], Mode::OnlyCalibration)).expect("an estimate");
    assert!(!rigid.warnings.iter().any(|w| matches!(w, Warning::UnusedBound { .. })));
}

#[test]
fn bounds_that_cannot_be_are_refused_in_words() {
    let nominal = painter();
    let compliance = ParameterId::Compliance(SHOULDER);
    let frame = ParameterId::Frame { station: 0, component: 0 };
    let check = |bounds: &[ParameterBound], choice: FrameChoice| {
        let options = IdentificationOptions { frame: choice, ..with(bounds, Mode::OnlyCalibration) };
        let refused = check_bounds(
            &nominal,
            &[Mode::OnlyCalibration],
            &options,
            &[Station::default()],
            &[Target::default()],
        )
        .expect_err("refused");
        (refused.index, refused.to_string(), refused.error.help())
    };
    let wide = bound(A4, -1.0, 1.0);
    for (bounds, choice, index, message, help) in [
        (vec![bound(A4, f64::NAN, 1.0)], FrameChoice::Nests, 0, "not a number", "finite"),
        (vec![bound(A4, f64::NEG_INFINITY, f64::INFINITY)], FrameChoice::Nests, 0, "no limit", "lower or"),
        (
            vec![bound(A4, 0.0, 0.0)],
            FrameChoice::Nests,
            0,
            "ends at 0 mm, which is not above",
            "leave it out",
        ),
        (
            vec![bound(A4, 0.01, -0.01)],
            FrameChoice::Nests,
            0,
            "ends at -10 mm, which is not above its start at 10 mm",
            "above",
        ),
        (vec![bound(compliance, -2.0, 0.0)], FrameChoice::Nests, 0, "begins at -2", "-1 or more"),
        (
            vec![bound(A4, 5e-3, 6e-3)],
            FrameChoice::Nests,
            0,
            "delta_a4 5 to 6 mm excludes 0, the nominal",
            "correct it",
        ),
        (vec![wide, wide], FrameChoice::Nests, 1, "delta_a4 has a second bound", "one bound per parameter"),
        (vec![bound(frame, -1.0, 1.0)], FrameChoice::Free, 0, "best fit of the nominal robot", "not known"),
        (
            vec![wide, bound(compliance, -0.1, 1.0)],
            FrameChoice::Nests,
            1,
            "fitted in any of the modes (only_calibration)",
            "delta_a2",
        ),
    ] {
        let (at, said, told) = check(&bounds, choice);
        assert_eq!(at, index, "{said}");
        assert!(said.contains(message) && told.contains(help), "{said} / {told}");
    }
    let fine = with(&[wide, bound(frame, -1.0, 1.0)], Mode::OnlyCalibration);
    assert_eq!(
        check_bounds(&nominal, &[Mode::OnlyCalibration], &fine, &[Station::default()], &[Target::default()]),
        Ok(())
    );
    let set = measure(&truth(&nominal, &[], Vec::new()), 40, 1.0);
    let excluded = with(&[bound(A4, 5e-3, 6e-3)], Mode::OnlyCalibration);
    let error = identify(&nominal, &set, &excluded).expect_err("refused");
    assert!(
        matches!(error, IdentifyError::Bound { .. }) && error.to_string().contains("expected"),
        "{error}"
    );
}
