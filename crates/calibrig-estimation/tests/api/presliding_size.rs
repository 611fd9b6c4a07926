//! Experiment: is the size of presliding better found or fixed?

use calibrig_estimation::identification::{IdentificationOptions, Mode, identify, predict_readings};
use calibrig_estimation::kinematics::target_in_base;
use calibrig_model::measurement::{MeasurementSet, Motion};
use calibrig_model::nalgebra::Vector3;
use calibrig_model::random::{Source, stream};
use calibrig_model::{LinkTerm, ParameterId};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use crate::coverage::{NOISE, robots};

const TARGET: Vector3<f64> = Vector3::new(0.05, 0.08, 0.12);

/// Friction by Dahl over ways of its own, rad behind at most; on so many joints.
#[derive(Debug, Clone, Copy)]
struct Friction {
    size: f64,
    band: f64,
    joints: usize,
}

fn session(friction: Friction, poses: usize, trial: u32, noise: f64) -> MeasurementSet {
    let mut rng = stream(57, trial, Source::IdentificationNoise);
    let [model, _] = robots();
    let mut machine = model.kinematics.clone();
    for link in 0..6 {
        machine.add(ParameterId::Link { link, term: LinkTerm::Alpha }, 1e-3 * (1.9 * link as f64).sin());
        machine.add(ParameterId::Link { link, term: LinkTerm::A }, 5e-4 * (2.3 * link as f64 + 1.0).sin());
    }
    let mut command = [0.2, -0.4, 0.6, 0.1, 0.5, 0.0];
    let mut followed = command;
    let mut motion = Motion::default();
    let mut told = Vec::new();
    let points: Vec<_> = (0..poses)
        .map(|_| {
            for command in &mut command {
                let step = 10_f64.powf(rng.random_range(-2.0..0.2));
                let to = *command + if rng.random::<bool>() { step } else { -step };
                *command = if to.abs() < 1.5 { to } else { rng.random_range(-1.5..1.5) };
            }
            motion.go_to(&command, 0.0);
            told.push((motion.approach.clone(), motion.since_reversal.clone()));
            let mut there = command;
            for joint in 0..friction.joints {
                let band = friction.band;
                followed[joint] = followed[joint].clamp(command[joint] - band, command[joint] + band);
                there[joint] += friction.size * (followed[joint] - command[joint]) / band;
            }
            let by = Vector3::from_fn(|_, _| {
                let unit: f64 = StandardNormal.sample(&mut rng);
                noise * NOISE * unit
            });
            (command.to_vec(), target_in_base(&machine, &there, &TARGET).expect("a pose") + by)
        })
        .collect();
    let mut set = MeasurementSet::of_points(points).with_sigma(NOISE);
    for (observation, (approach, since)) in set.observations.iter_mut().zip(told) {
        (observation.approach, observation.since_reversal) = (approach, since);
    }
    set
}

#[test]
fn experiment() {
    let how = if std::env::var_os("PRESLIDING_UNKNOWN").is_some() { "found" } else { "fixed" };
    let [model, _] = robots();
    let trials = 30;
    let none = Friction { size: 0.0, band: 0.1, joints: 0 };
    let cases = [
        ("none", none),
        ("30 urad", Friction { size: 3e-5, band: 0.1, joints: 6 }),
        ("100 urad", Friction { size: 1e-4, band: 0.1, joints: 6 }),
        ("300 urad, 2 joints", Friction { size: 3e-4, band: 0.14, joints: 2 }),
        ("300 urad", Friction { size: 3e-4, band: 0.14, joints: 6 }),
        ("1 mrad", Friction { size: 1e-3, band: 0.14, joints: 6 }),
        ("3 mrad", Friction { size: 3e-3, band: 0.05, joints: 6 }),
    ];
    for poses in [60, 150] {
        for (name, friction) in cases {
            let (mut squares, mut held, mut all, mut plain) = (0.0, 0, 0, 0.0);
            for trial in 0..trials {
                let set = session(friction, poses, trial, 1.0);
                let exact = session(friction, 100, 1000 + trial, 0.0);
                for families in [&["hysteresis"][..], &["hysteresis", "presliding"][..]] {
                    let options = IdentificationOptions {
                        mode: Mode::Extended,
                        terms: Some(families.iter().map(|key| (*key).to_owned()).collect()),
                        ..IdentificationOptions::default()
                    };
                    let estimate = identify(&model, &set, &options).expect("an estimate");
                    let Some(predicted) =
                        predict_readings(&model, &exact, &options, &estimate).expect("poses")
                    else {
                        println!("no covariance");
                        continue;
                    };
                    let rms: f64 = predicted.iter().map(|p| p.error.norm_squared()).sum();
                    if families.len() == 1 {
                        plain += rms;
                        continue;
                    }
                    squares += rms;
                    let factor = estimate.interval_factor(0.95);
                    for p in &predicted {
                        for axis in 0..3 {
                            let sigma = (p.of_parameters + p.of_machine)[(axis, axis)].sqrt();
                            held += usize::from(p.error[axis].abs() <= factor * sigma);
                            all += 1;
                        }
                    }
                }
            }
            let mean = |squares: f64| 1e6 * (squares / f64::from(trials) / 100.0).sqrt();
            println!(
                "{how} {poses} poses, {name}: {:.1} um held out ({:.1} without), coverage {:.4}",
                mean(squares),
                mean(plain),
                held as f64 / all as f64
            );
        }
    }
}
