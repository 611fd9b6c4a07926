//! Robots and sessions at the ends of what there is: joints that are the same, links of no length, sixty joints, one pose, a hundred thousand.

use std::f64::consts::FRAC_PI_2;

use calibrig_estimation::identification::{Estimate, IdentificationOptions, Mode, identify};
use calibrig_estimation::kinematics::target_in_base;
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::nalgebra::Vector3;
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::{CalibrationModel, CraigLink};
use rand::RngExt;

const IN_FLANGE: Vector3<f64> = Vector3::new(0.1, 0.05, 0.2);

fn robot(links: Vec<CraigLink>) -> CalibrationModel {
    CalibrationModel::new(links).expect("a robot")
}

fn turning(a: f64, alpha: f64, d: f64) -> CraigLink {
    CraigLink::revolute("r").row(a, alpha, d, 0.0).limits(-2.0, 2.0)
}

fn six_axes() -> CalibrationModel {
    robot(vec![
        turning(0.0, 0.0, 0.8),
        turning(0.3, -FRAC_PI_2, 0.0),
        turning(1.1, 0.0, 0.0),
        turning(0.2, -FRAC_PI_2, 1.2),
        turning(0.0, FRAC_PI_2, 0.0),
        turning(0.0, -FRAC_PI_2, 0.1),
    ])
}

/// Exact readings of a machine whose links are longer by `off`, m.
fn measured(model: &CalibrationModel, poses: usize, off: f64) -> MeasurementSet {
    let mut real = model.kinematics.clone();
    for (index, link) in (0_u32..).zip(&mut real.links) {
        link.a += off * f64::from(index % 3);
        link.d -= off * f64::from(index % 2);
    }
    let mut rng = stream(14, 0, StreamSource::Splits);
    let points = (0..poses).map(|_| {
        let limits = real.links.iter().map(|link| link.limits);
        let q: Vec<f64> = limits.map(|[low, high]| rng.random_range(low..=high)).collect();
        let target = target_in_base(&real, &q, &IN_FLANGE).expect("a place");
        (q, target)
    });
    MeasurementSet::of_points(points.collect::<Vec<_>>()).with_sigma(1e-5)
}

/// Every number of an estimate is one, and it predicts what it was fitted to within `within`, m.
fn holds(estimate: &Estimate, set: &MeasurementSet, within: f64) {
    for parameter in &estimate.parameters {
        assert!(parameter.value.is_finite(), "{parameter:?}");
        assert!(parameter.sigma.is_none_or(f64::is_finite), "{parameter:?}");
    }
    assert!(estimate.chi2.is_finite(), "{}", estimate.chi2);
    let mut predictor = estimate.predictor().expect("an estimate predicts");
    for observation in set.observations.iter().take(50) {
        let there = predictor.predict(observation.command.as_slice()).expect("a pose that was measured");
        let station = &estimate.robot.stations[0];
        let seen = station.rotation * there.position + station.translation.vector;
        let off = (seen - observation.reading.position()).norm();
        assert!(off < within, "{off} m");
    }
}

#[test]
fn strange_robots_are_fitted_or_refused() {
    let nothing = || CraigLink::revolute("r").limits(-2.0, 2.0);
    let chains = [
        // The same joint again and again: only the sum of their angles counts.
        vec![turning(0.3, 0.5, 0.1); 6],
        vec![turning(0.0, 0.0, 0.0); 6],
        vec![nothing(); 3],
        vec![nothing()],
        // Rails along one line.
        vec![CraigLink::prismatic("p").limits(-1.0, 1.0); 4],
        // Links of a nanometre's millionth, and of a light second's thousandth.
        vec![turning(1e-15, FRAC_PI_2, 1e-15); 4],
        vec![turning(3e5, FRAC_PI_2, 0.0), turning(1.0, -FRAC_PI_2, 3e5), turning(0.5, FRAC_PI_2, 0.2)],
        vec![turning(5e-324, 5e-324, 5e-324), turning(0.4, FRAC_PI_2, -0.0), turning(0.3, -0.0, 1e-300)],
    ];
    for links in chains {
        let model = robot(links);
        for poses in [1, 2, 7, 60] {
            let set = measured(&model, poses, 0.0);
            for mode in [Mode::OnlyCalibration, Mode::Extended] {
                let options = IdentificationOptions { mode, ..IdentificationOptions::default() };
                if let Ok(estimate) = identify(&model, &set, &options) {
                    // Rounding of the places themselves.
                    let reach =
                        set.observations.iter().map(|o| o.reading.position().norm()).fold(1.0, f64::max);
                    holds(&estimate, &set, 1e-6 + 1e-12 * reach);
                }
            }
        }
    }
}

#[test]
fn one_pose_gives_an_estimate_that_says_how_little_it_knows() {
    let model = six_axes();
    let set = measured(&model, 1, 1e-3);
    if let Ok(estimate) = identify(&model, &set, &IdentificationOptions::default()) {
        holds(&estimate, &set, 1e-3);
        assert!(!estimate.is_sound(), "{:?}", estimate.warnings);
    }
}

#[test]
fn sixty_joints_are_identified() {
    let mut rng = stream(60, 0, StreamSource::Splits);
    let mut link = |_| {
        let turns = [0.0, FRAC_PI_2, -FRAC_PI_2];
        turning(rng.random_range(0.0..0.2), turns[rng.random_range(0..3)], rng.random_range(-0.1..0.1))
    };
    let model = robot((0..60).map(&mut link).collect());
    let set = measured(&model, 250, 1e-4);
    let estimate = identify(&model, &set, &IdentificationOptions::default()).expect("an estimate");
    assert!(estimate.parameters.len() > 120, "{}", estimate.parameters.len());
    holds(&estimate, &set, 20e-6);
}

#[test]
fn a_hundred_thousand_poses_take_no_more_passes_than_a_hundred() {
    let model = six_axes();
    let fitted = |poses| {
        let set = measured(&model, poses, 1e-3);
        let memory = allocation_counter::measure(|| {
            let estimate = identify(&model, &set, &IdentificationOptions::default()).expect("an estimate");
            holds(&estimate, &set, 1e-6);
            assert!(estimate.iterations.len() <= 12, "{} passes", estimate.iterations.len());
        });
        memory.bytes_max
    };
    let (few, many) = (fitted(1000), fitted(100_000));
    // Nothing grows with the square of the poses: what all take together is what each takes.
    assert!(many < 120 * few, "{few} bytes for a thousand poses, {many} for a hundred thousand");
}
