//! What is wrong with a session does not hide in the noise that is found with it.

use calibrig_estimation::identification::{
    Estimate, IdentificationOptions, NoiseScale, Outlier, ParameterBound, Warning, identify,
};
use calibrig_estimation::kinematics::target_in_base;
use calibrig_model::measurement::{MeasurementSet, Observation, Reading, Target};
use calibrig_model::nalgebra::{Matrix3, Vector3};
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::{CalibrationModel, LinkTerm, ParameterId};
use rand::RngExt;
use rand_distr::{Distribution, Normal};

use crate::coverage::{NOISE, links, robots, session};

fn arm() -> CalibrationModel {
    let [arm, _] = robots();
    arm
}

/// A sound session of an arm with six axes whose links are off by 0.5 mm and 1 mrad.
fn sound(model: &CalibrationModel, poses: usize, trial: u32) -> MeasurementSet {
    let any = session(model, &[], 60, 0).1.with_sigma(NOISE);
    let ids = links(&estimate(model, &any));
    session(model, &ids, poses, trial).1
}

fn estimate(model: &CalibrationModel, set: &MeasurementSet) -> Estimate {
    identify(model, set, &IdentificationOptions::default()).expect("an estimate")
}

fn shift(set: &mut MeasurementSet, observation: usize, by: Vector3<f64>) {
    let Reading::Cartesian { position, .. } = &mut set.observations[observation].reading else { panic!() };
    *position += by;
}

/// Indices of the readings that are named, and whether they are a reason to look.
fn named(estimate: &Estimate) -> (Vec<usize>, bool) {
    let named = estimate.outliers.iter().map(|outlier| outlier.observation).collect();
    (named, Outlier::are_a_reason(&estimate.outliers))
}

/// From few poses on, whatever the noise is: stated, in which the machine's is found with the error in it, or from the residuals.
#[test]
fn one_gross_error_is_named_from_few_poses_on() {
    let model = arm();
    let direction = Vector3::new(0.6, -0.64, 0.48);
    let (mut missed, mut trials) = (Vec::new(), 0);
    for trial in 0..8 {
        for poses in [12, 14, 20, 40] {
            for size in [5e-3, 20e-3, 100e-3] {
                for stated in [true, false] {
                    let mut set = sound(&model, poses, trial);
                    let wrong = (3 + 5 * trial as usize) % poses;
                    shift(&mut set, wrong, size * direction);
                    let set = if stated { set.with_sigma(NOISE) } else { set };
                    trials += 1;
                    let found = named(&estimate(&model, &set));
                    if found != (vec![wrong], true) {
                        missed.push((trial, poses, size, stated, found));
                    }
                }
            }
        }
    }
    // At twelve poses a reading can determine a direction by itself, and nothing else speaks against it there.
    assert!(missed.iter().all(|(_, poses, ..)| *poses <= 14), "{missed:?}");
    assert!(missed.len() * 20 <= trials, "{} of {trials}: {missed:?}", missed.len());
}

/// Three targets a pose, which share an error of the joints: the reading that is wrong, and not those beside it.
#[test]
fn of_readings_of_one_pose_the_wrong_one_is_named() {
    let model = arm();
    let targets = [[0.05, 0.08, 0.12], [-0.1, 0.05, 0.15], [0.02, -0.12, 0.1]].map(Vector3::from);
    for trial in 0..6 {
        for stated in [true, false] {
            let mut rng = stream(31, trial, StreamSource::IdentificationNoise);
            let (joint, own) =
                (Normal::new(0.0, 1e-4).expect("a width"), Normal::new(0.0, NOISE).expect("a width"));
            let mut set = MeasurementSet::of_points([]);
            set.targets = targets
                .iter()
                .zip(["A", "B", "C"])
                .map(|(_, name)| Target {
                    orientation: None,
                    name: name.to_owned(),
                    in_flange: Vector3::zeros(),
                    covariance: None,
                })
                .collect();
            for pose in 1..=40 {
                let command: Vec<f64> = (0..6).map(|_| rng.random_range(-2.5..2.5)).collect();
                let reached: Vec<f64> = command.iter().map(|q| q + joint.sample(&mut rng)).collect();
                for (target, in_flange) in targets.iter().enumerate() {
                    let position = target_in_base(&model.kinematics, &reached, in_flange).expect("a pose")
                        + Vector3::from_fn(|_, _| own.sample(&mut rng));
                    set.observations.push(Observation {
                        pose,
                        command: command.clone(),
                        approach: vec![0; 6],
                        since_reversal: Vec::new(),
                        temperature: None,
                        time: 0.0,
                        station: 0,
                        target,
                        payload: None,
                        reading: Reading::Cartesian { position, covariance: None },
                    });
                }
            }
            let wrong = 20 + 13 * trial as usize;
            shift(&mut set, wrong, 20e-3 * Vector3::new(0.6, -0.64, 0.48));
            let set = if stated { set.with_sigma(NOISE) } else { set };
            let found = named(&estimate(&model, &set));
            assert_eq!(found, (vec![wrong], true), "{trial} {stated}");
        }
    }
}

/// One reading alone says nothing of its own noise.
#[test]
fn a_reading_without_a_sigma_among_others_with_one_is_no_noise_of_its_own() {
    let model = arm();
    let mut set = sound(&model, 40, 4).with_sigma(NOISE);
    let Reading::Cartesian { covariance, .. } = &mut set.observations[17].reading else { panic!() };
    *covariance = None;
    assert_eq!(named(&estimate(&model, &set)), (vec![], false));
    shift(&mut set, 17, Vector3::new(3e-3, 0.0, 0.0));
    assert_eq!(named(&estimate(&model, &set)), (vec![17], true));
}

/// The residuals that a wrong statement makes are not taken for the noise that it is tested in.
#[test]
fn a_target_that_was_stated_wrong_does_not_hide_in_its_own_residuals() {
    let model = arm();
    for (off, is_told) in [(0.0, false), (2e-3, true), (10e-3, true), (20e-3, true), (60e-3, true)] {
        for stated in [true, false] {
            let mut set = sound(&model, 30, 2);
            if stated {
                set = set.with_sigma(NOISE);
            }
            set.targets[0].in_flange = Vector3::new(0.05 + off, 0.08, 0.12);
            set.targets[0].covariance = Some(Matrix3::identity() * 25e-10);
            let estimate = estimate(&model, &set);
            let told = estimate.contradicted.iter().any(|c| c.stated.name().contains("target"));
            assert_eq!(told, is_told, "{off} {stated}: {:?}", estimate.warnings);
            assert_eq!(estimate.is_sound(), !is_told, "{off} {stated}: {:?}", estimate.warnings);
        }
    }
}

/// What a bound keeps a parameter from is in the residuals, and in the noise that is taken from them: as where the parameter is fixed there.
#[test]
fn noise_is_that_of_the_fit_within_its_bounds() {
    let model = arm();
    let set = sound(&model, 40, 1);
    let id = ParameterId::Link { link: 2, term: LinkTerm::A };
    let free = estimate(&model, &set);
    let away = free.parameters.iter().find(|p| p.id == id).expect("identified").value;
    let (lower, upper) = if away > 0.0 { (-1e-3, 1e-6) } else { (-1e-6, 1e-3) };
    let bounded =
        IdentificationOptions { bounds: vec![ParameterBound { id, lower, upper }], ..Default::default() };
    let fixed = IdentificationOptions { fix: vec![id], ..Default::default() };
    let sigma =
        |options: &IdentificationOptions| match identify(&model, &set, options).expect("an estimate").noise {
            NoiseScale::Residuals(sigma) => sigma,
            NoiseScale::Stated => panic!("no noise is stated"),
        };
    let (bounded, fixed) = (sigma(&bounded), sigma(&fixed));
    // The bound lies a micrometre from where the parameter is fixed.
    assert!((bounded / fixed - 1.0).abs() < 0.05 && fixed > 1.4 * NOISE, "{bounded} {fixed}");
}

/// Nine poses for 27 parameters: nothing is left to tell whether the noise is right, and the stated one holds.
#[test]
fn too_few_rows_to_test_the_stated_noise_are_told() {
    let model = arm();
    for trial in 0..20 {
        let estimate = estimate(&model, &sound(&model, 9, trial).with_sigma(NOISE));
        assert!(estimate.interval_factor(0.95).is_finite(), "{:?}", estimate.warnings);
        let told = estimate.warnings.iter().any(|warning| matches!(warning, Warning::Untested { .. }));
        assert_eq!(told, estimate.degrees_of_freedom < 1.0, "{}", estimate.degrees_of_freedom);
    }
}
