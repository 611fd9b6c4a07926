//! Which compliances are fitted for a stiffness that is stated well, badly, or not at all; and masses that are known with an uncertainty.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Matrix3, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::elastostatics::put;
use crate::identification::{
    Assumption, CalibratedRobot, ComplianceChoice, Estimate, IdentificationOptions, LeftOutReason, Mode,
    Predictor, Stated, Tolerance, Warning, identify,
};
use calibrig_model::geometry::{rotation_x, translation};
use calibrig_model::measurement::{MeasurementSet, Observation, Reading, Station, Target};
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::statistics::{NORMAL_95, binomial_cdf};
use calibrig_model::{
    Body, BodyUncertainty, CalibrationModel, Compliance, CraigLink, ParameterId, StaticProperties, TermId,
};

/// Standard deviation of a coordinate, m.
const NOISE: f64 = 20e-6;

fn drive(joint: usize) -> ParameterId {
    ParameterId::Compliance(Compliance::Drive { joint })
}

fn body(mass: f64, centre: [f64; 3]) -> Body {
    Body { mass, centre_of_mass: Vector3::from(centre), inertia: Matrix3::identity() * 0.1 }
}

/// A waist and two parallel axes with drives of `stiffness`, N m/rad: with 2e4 they sag by half a millimetre.
fn three_axes(stiffness: f64) -> CalibrationModel {
    let link = |name, a, alpha, d| CraigLink::revolute(name).row(a, alpha, d, 0.0).limits(-PI, PI);
    let mut robot = CalibrationModel::new(vec![
        link("waist", 0.0, 0.0, 0.3),
        link("shoulder", 0.0, -FRAC_PI_2, 0.0),
        link("elbow", 0.5, 0.0, 0.0),
    ])
    .expect("a robot");
    let bodies = vec![body(5.0, [0.0; 3]), body(10.0, [0.25, 0.0, 0.0]), body(5.0, [0.2, 0.0, 0.0])];
    let gravity = -9.80665 * Vector3::z();
    robot.statics = Some(StaticProperties::of_drives(bodies, vec![stiffness; 3], gravity));
    robot
}

/// Six axes whose drives sag.
fn six_axes() -> CalibrationModel {
    let link = |name, a, alpha, d| CraigLink::revolute(name).row(a, alpha, d, 0.0).limits(-2.5, 2.5);
    let mut robot = CalibrationModel::new(vec![
        link("1", 0.0, 0.0, 0.45),
        link("2", 0.15, -FRAC_PI_2, 0.0),
        link("3", 0.6, 0.0, 0.0),
        link("4", 0.12, -FRAC_PI_2, 0.62),
        link("5", 0.0, FRAC_PI_2, 0.0),
        link("6", 0.0, -FRAC_PI_2, 0.1),
    ])
    .expect("a robot");
    let bodies = vec![
        body(40.0, [0.05, 0.0, -0.1]),
        body(30.0, [0.3, 0.0, 0.1]),
        body(20.0, [0.06, 0.0, 0.05]),
        body(10.0, [0.0, 0.0, -0.2]),
        body(6.0, [0.0, -0.05, 0.03]),
        body(4.0, [0.05, 0.02, 0.1]),
    ];
    let stiffness = vec![4e5, 3e5, 1.5e5, 3e4, 2e4, 1e4];
    robot.statics = Some(StaticProperties::of_drives(bodies, stiffness, -9.80665 * Vector3::z()));
    robot
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// Readings of a machine from a tracker at an unknown place, with [`NOISE`], whose covariance is `stated` or not.
fn measured(
    machine: &CalibrationModel,
    poses: u32,
    limit: f64,
    stated: Option<f64>,
    rng: &mut ChaCha8Rng,
) -> MeasurementSet {
    let station = translation(3.0, 0.5, 0.2) * rotation_x(0.3);
    let target = Vector3::new(0.35, 0.04, 0.06);
    let robot = CalibratedRobot {
        instruments: Vec::new(),
        mode: Mode::ElastoGeometric,
        nominal: machine.clone(),
        model: machine.clone(),
        terms: Vec::new(),
        stations: vec![station],
        targets: vec![target],
        orientations: Vec::new(),
    };
    let mut predictor = Predictor::new(&robot).expect("a robot");
    let covariance = stated.map(|sigma| Matrix3::identity() * sigma * sigma);
    let observation = |pose| {
        let command: Vec<f64> =
            (0..machine.kinematics.joint_count()).map(|_| rng.random_range(-limit..limit)).collect();
        let seen =
            station.rotation * predictor.in_base(&command[..]).expect("a pose") + station.translation.vector;
        let position = seen + NOISE * Vector3::from_fn(|_, _| normal(rng));
        Observation {
            pose,
            command,
            approach: Vec::new(),
            since_reversal: Vec::new(),
            time: f64::from(pose),
            temperature: None,
            station: 0,
            target: 0,
            payload: None,
            reading: Reading::Cartesian { position, covariance },
        }
    };
    MeasurementSet {
        observations: (0..poses).map(observation).collect(),
        stations: vec![Station { name: "T".to_owned(), ..Station::default() }],
        targets: vec![Target {
            name: "S".to_owned(),
            in_flange: target,
            covariance: None,
            orientation: None,
        }],
    }
}

/// The three axes with drives whose stiffness is 2e4 N m/rad, where `stated` is known of it.
fn sagging(stated: Option<f64>) -> MeasurementSet {
    measured(&three_axes(2e4), 60, 1.2, stated, &mut stream(3, 0, StreamSource::IdentificationNoise))
}

fn elastic(compliance_sigma: f64) -> IdentificationOptions {
    IdentificationOptions {
        mode: Mode::ElastoGeometric,
        compliance_sigma,
        ..IdentificationOptions::default()
    }
}

fn rms(estimate: &Estimate, set: &MeasurementSet) -> f64 {
    let errors = Predictor::new(&estimate.robot).expect("a robot").errors(set).expect("poses");
    (errors.iter().map(Vector3::norm_squared).sum::<f64>() / errors.len() as f64).sqrt()
}

fn found(estimate: &Estimate, id: ParameterId) -> (f64, f64) {
    let parameter =
        estimate.parameters.iter().find(|p| p.id == id).unwrap_or_else(|| panic!("{id} is left out"));
    (parameter.value, parameter.sigma.expect("a standard deviation"))
}

fn words(estimate: &Estimate) -> String {
    estimate.warnings.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n")
}

/// Drives ten times softer than stated, whether the noise is stated or has to be found from residuals that contain the sag.
#[test]
fn drives_that_are_much_softer_than_stated_are_fitted_all_of_them() {
    for stated in [None, Some(NOISE)] {
        let set = sagging(stated);
        let estimate = identify(&three_axes(2e5), &set, &elastic(10.0)).expect("an estimate");
        for joint in [1, 2] {
            let (value, sigma) = found(&estimate, drive(joint));
            assert!((value - 9.0).abs() < 4.0 * sigma && sigma < 1.0, "{joint}: {value} +- {sigma}");
        }
        // Three coordinates of the noise, less the share that 17 parameters take.
        let expected = NOISE * (3.0_f64 - 17.0 / 60.0).sqrt();
        let ratio = rms(&estimate, &set) / expected;
        assert!((ratio - 1.0).abs() < 0.2, "{ratio}");
        assert!(estimate.is_sound(), "{}", words(&estimate));
        // The waist turns about the vertical axis.
        let [left] = estimate.left_out.as_slice() else { panic!("{:?}", estimate.left_out) };
        assert!(left.id == drive(0) && matches!(left.reason, LeftOutReason::Unloaded { .. }));
        assert!(left.reason.to_string().contains("hardly loads it"), "{}", left.reason);
    }
}

/// Named compliances are kept, and are reported to rest on their priors only if they do: judged by the fit, not by the assumed drive.
#[test]
fn advice_to_leave_a_drive_out_goes_by_what_the_fit_tells_of_it() {
    let listed = |joints: &[usize]| {
        ComplianceChoice::Listed(joints.iter().map(|joint| Compliance::Drive { joint: *joint }).collect())
    };
    let advised = |estimate: &Estimate| {
        let name = |warning: &Warning| match warning {
            Warning::Unexcited { name } => Some(name.clone()),
            _ => None,
        };
        estimate.warnings.iter().filter_map(name).collect::<Vec<_>>()
    };
    let options = IdentificationOptions { compliances: listed(&[0, 1, 2]), ..elastic(10.0) };
    let estimate = identify(&three_axes(2e5), &sagging(None), &options).expect("an estimate");
    assert_eq!(advised(&estimate), [drive(0).to_string()]);
    let (_, sigma) = found(&estimate, drive(2));
    assert!(1.0 - (sigma / 10.0).powi(2) > 0.9);
}

/// From a hundred times too stiff to a hundred times too soft, with a load that is still carried.
#[test]
fn an_unknown_stiffness_is_found_from_far_off_on_either_side() {
    let set = sagging(None);
    let options = IdentificationOptions { stiffness_unknown: true, ..elastic(0.1) };
    let reference = identify(&three_axes(2e4), &set, &options).expect("an estimate");
    for factor in [100.0, 10.0, 1.0, 0.1, 0.03] {
        let estimate = identify(&three_axes(2e4 * factor), &set, &options).expect("an estimate");
        assert!(estimate.is_sound(), "{factor}: {}", words(&estimate));
        for joint in [1, 2] {
            let (value, sigma) = found(&estimate, drive(joint));
            let (ratio, truth) = ((1.0 + value) / factor, 1.0);
            assert!((ratio - truth).abs() < 4.0 * sigma / factor, "{factor}, {joint}: {ratio}");
            let (same, _) = found(&reference, drive(joint));
            // Only the prior differs, and it is weak.
            assert!((ratio - 1.0 - same).abs() < 0.02, "{factor}, {joint}: {ratio} {same}");
        }
        assert!(estimate.assumptions.contains(&Assumption::StiffnessUnknown));
    }
}

/// The prior keeps the drives stiff, so that their sag looks like noise: this must not hide that the prior is wrong.
#[test]
fn a_stiffness_stated_a_hundred_times_too_high_is_told_with_what_to_do() {
    for stated in [None, Some(NOISE)] {
        let estimate = identify(&three_axes(2e6), &sagging(stated), &elastic(1.0)).expect("an estimate");
        assert!(!estimate.is_sound());
        let told = words(&estimate);
        for part in [
            "much softer drives than the prior allows",
            "compliance_drive2",
            "compliance_percent = \"unknown\"",
        ] {
            assert!(told.contains(part), "{part} in\n{told}");
        }
        for contradiction in &estimate.contradicted {
            let Stated::Parameter { id, found, prior_sigma, .. } = contradiction.stated else { continue };
            // To first order from where the prior kept it.
            assert!((found / 99.0 - 1.0).abs() < 0.15 && prior_sigma == 1.0, "{id}: {found}");
        }
    }
}

/// As above with a tight prior, violated by eleven of its standard deviations, while the noise is stated six times too small.
#[test]
fn a_prior_that_is_violated_by_far_is_told_although_the_model_is_doubted() {
    let set = sagging(Some(NOISE / 6.0));
    let estimate = identify(&three_axes(2e4 * 2.64), &set, &elastic(0.15)).expect("an estimate");
    let told = words(&estimate);
    assert!(told.contains("the measurements contradict what was stated about compliance_drive"), "{told}");
}

#[test]
fn terms_that_nothing_measured_acts_on_are_left_out() {
    let options = IdentificationOptions {
        mode: Mode::Extended,
        terms: Some(vec!["hysteresis".to_owned()]),
        ..elastic(1.0)
    };
    let mut set = sagging(None);
    let without = identify(&three_axes(2e4), &set, &options).expect("an estimate");
    assert!(without.robot.terms.is_empty() && without.held.is_empty());
    let terms: Vec<_> = without
        .left_out
        .iter()
        .filter(|left| left.reason == LeftOutReason::NoBasis)
        .map(|left| left.id)
        .collect();
    let expected = TermId::all_of("hysteresis", &three_axes(2e4)).expect("a family");
    assert_eq!(terms, expected.into_iter().map(ParameterId::Term).collect::<Vec<_>>());
    for (observation, sign) in set.observations.iter_mut().zip([1, -1].into_iter().cycle()) {
        observation.approach = vec![sign, 1, -sign];
    }
    let with = identify(&three_axes(2e4), &set, &options).expect("an estimate");
    assert_eq!(with.robot.terms.len(), 3);
}

/// Machines drawn as stated: links, compliances, and masses and centres of which the estimator knows the nominal values.
#[test]
fn intervals_of_compliances_hold_where_masses_and_centres_are_uncertain() {
    let trials: u32 = if std::env::var_os("CALIBRIG_FULL").is_some() { 500 } else { 60 };
    let nominal = six_axes();
    let uncertainty = BodyUncertainty { mass: 0.03, centre: 5e-3 };
    let options = |bodies| IdentificationOptions {
        bodies,
        tolerance: Some(Tolerance { length: 5e-4, angle: 1e-3 }),
        ..elastic(0.3)
    };
    let (known, exact) = (options(vec![uncertainty; 6]), options(Vec::new()));
    let joints = [1, 2, 3, 4];
    let mut held = [[0_u64; 4]; 2];
    for trial in 0..trials {
        let mut rng = stream(17, trial, StreamSource::AsBuilt);
        let mut machine = nominal.clone();
        for id in ParameterId::all_of_links(6) {
            let sigma = if id.unit() == calibrig_model::Unit::Metre { 5e-4 } else { 1e-3 };
            put(&mut machine, &nominal, id, sigma * normal(&mut rng));
        }
        for link in 0..6 {
            put(&mut machine, &nominal, ParameterId::Mass { link }, 0.03 * normal(&mut rng));
            for axis in 0..3 {
                put(&mut machine, &nominal, ParameterId::Centre { link, axis }, 5e-3 * normal(&mut rng));
            }
        }
        let truths = joints.map(|_| 0.3 * normal(&mut rng).max(-3.0));
        for (joint, truth) in joints.iter().zip(truths) {
            put(&mut machine, &nominal, drive(*joint), truth);
        }
        let set = measured(&machine, 40, 2.2, Some(NOISE), &mut rng);
        for (options, held) in [&known, &exact].into_iter().zip(&mut held) {
            let estimate = identify(&nominal, &set, options).expect("an estimate");
            for ((joint, truth), held) in joints.iter().zip(truths).zip(held) {
                let (value, sigma) = found(&estimate, drive(*joint));
                *held += u64::from((value - truth).abs() <= NORMAL_95 * sigma);
            }
        }
    }
    println!(
        "{trials} trials, inside 95 %: with the uncertainty stated {:?}, taken as exact {:?}",
        held[0], held[1]
    );
    // Each within the 99.9 % band for all four together.
    let tail = 0.5e-3 / 4.0;
    let n = u64::from(trials);
    let is_inside = |hits: &u64| {
        let above = if *hits == 0 { 1.0 } else { 1.0 - binomial_cdf(hits - 1, n, 0.95) };
        binomial_cdf(*hits, n, 0.95) > tail && above > tail
    };
    assert!(held[0].iter().all(is_inside), "{:?}", held[0]);
    assert!(!held[1].iter().all(is_inside), "{:?}", held[1]);
}

#[test]
fn what_is_taken_of_masses_and_centres_is_told() {
    let set = sagging(None);
    let told = |bodies| {
        let options = IdentificationOptions { bodies, ..elastic(1.0) };
        identify(&three_axes(2e4), &set, &options).expect("an estimate").assumptions
    };
    assert!(told(Vec::new()).contains(&Assumption::BodiesExact));
    let known = vec![BodyUncertainty { mass: 0.03, centre: 5e-3 }; 3];
    assert!(told(known).contains(&Assumption::BodiesStated));
    let few = IdentificationOptions { bodies: vec![BodyUncertainty::default()], ..elastic(1.0) };
    let refused = identify(&three_axes(2e4), &set, &few).expect_err("one of three").to_string();
    assert!(refused.contains("1 uncertainties for 3 bodies"), "{refused}");
    let wrong = IdentificationOptions {
        bodies: vec![BodyUncertainty { mass: -0.1, centre: 0.0 }; 3],
        ..elastic(1.0)
    };
    assert!(identify(&three_axes(2e4), &set, &wrong).expect_err("negative").to_string().contains("mass1"));
}
