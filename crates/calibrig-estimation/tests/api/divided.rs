//! Sessions that are several in one are told, and no other is.

use calibrig_estimation::identification::{Estimate, IdentificationOptions, Warning, identify};
use calibrig_estimation::kinematics::forward_kinematics;
use calibrig_model::CalibrationModel;
use calibrig_model::measurement::{MeasurementSet, Reading};
use calibrig_model::nalgebra::{Rotation3, Vector3};
use calibrig_model::random::{StreamSource, stream};
use rand::RngExt;

use crate::coverage::{NOISE, links, robots, session};

const POSES: usize = 40;

/// A sound session of an arm with six axes: links off by 0.5 mm and 1 mrad.
fn sound(trial: u32, poses: usize) -> (CalibrationModel, MeasurementSet) {
    let [model, _] = robots();
    let any = session(&model, &[], 60, 0).1.with_sigma(NOISE);
    let ids = links(&identify(&model, &any, &IdentificationOptions::default()).expect("an estimate"));
    let (_, set) = session(&model, &ids, poses, trial);
    (model, set)
}

fn moved(set: &mut MeasurementSet, of: impl Fn(usize, &[f64], Vector3<f64>) -> Vector3<f64>) {
    for (index, observation) in set.observations.iter_mut().enumerate() {
        let Reading::Cartesian { position, .. } = &mut observation.reading else { panic!("Cartesian") };
        *position = of(index, &observation.command, *position);
    }
}

fn estimate(model: &CalibrationModel, set: &MeasurementSet, stated: bool) -> Estimate {
    let set = if stated { set.clone().with_sigma(NOISE) } else { set.clone() };
    identify(model, &set, &IdentificationOptions::default()).expect("an estimate")
}

fn reasons(estimate: &Estimate) -> Vec<&'static str> {
    estimate.warnings.iter().filter_map(Warning::reason).collect()
}

/// Offsets of a target far apart and near, half and half or a few, two and three of them.
#[test]
fn several_targets_under_one_name_are_told() {
    let off = Vector3::new(0.6, -0.64, 0.48);
    let other = Vector3::new(-off.y, off.z, off.x);
    for (trial, (distance, modulus)) in (0_u32..).zip([(10e-3, 2), (10e-3, 4), (1e-3, 2), (70e-3, 3)]) {
        // Which of three targets every reading is of takes two of its degrees of freedom: that costs resolution.
        for targets in if distance > 5e-3 { 2..=3 } else { 2..=2 } {
            for stated in [true, false] {
                let (model, mut set) = sound(trial, POSES);
                // In the flange's axes, and the third on the other side.
                moved(&mut set, |index, command, position| {
                    let flange = forward_kinematics(&model.kinematics, command).expect("a pose").rotation;
                    let by = match (index * 7 + index / 3) % (modulus * (targets - 1)) {
                        0 => off,
                        1 if targets == 3 => other,
                        _ => Vector3::zeros(),
                    };
                    position + flange * (distance * by)
                });
                let estimate = estimate(&model, &set, stated);
                let case = format!("{distance} {modulus} {targets} {stated}: {:?}", estimate.warnings);
                let told = estimate.warnings.iter().find_map(|warning| match warning {
                    Warning::SeveralTargets { targets, apart, rms, .. } => Some((*targets, *apart, *rms)),
                    _ => None,
                });
                // A few that are far off are gross errors, which is as good a reason to look.
                if told.is_none() && reasons(&estimate).contains(&"gross_errors") {
                    continue;
                }
                let (found, apart, rms) = told.expect(&case);
                let expected = if targets == 3 { distance * (off - other).norm() } else { distance };
                assert_eq!(found, targets, "{case}");
                assert!((apart / expected - 1.0).abs() < 0.2, "{case}: {apart} {expected}");
                // To first order in the offsets.
                assert!(rms[1] < 4.0 * NOISE + 1e-2 * distance, "{case}");
            }
        }
    }
}

#[test]
fn a_station_that_was_moved_is_told_with_the_place() {
    let turn = Rotation3::new(Vector3::new(2e-3, -1e-3, 4e-3));
    for (size, first) in [(1.0, 20), (0.05, 13), (10.0, 33)] {
        for stated in [true, false] {
            let (model, mut set) = sound(3, POSES);
            let shift = size * Vector3::new(6e-3, -3e-3, 4e-3);
            moved(
                &mut set,
                |index, _, position| {
                    if index < first { position } else { turn * position + shift }
                },
            );
            let estimate = estimate(&model, &set, stated);
            let case = format!("{size} {first} {stated}: {:?}", estimate.warnings);
            let poses = estimate.warnings.iter().find_map(|warning| match warning {
                Warning::StationMoved { poses, .. } => Some(*poses),
                _ => None,
            });
            let place = poses.expect(&case).map(|pose| set.observations.iter().position(|o| o.pose == pose));
            assert_eq!(place, [Some(first - 1), Some(first)], "{case}");
        }
    }
}

/// Neither in sound sessions, nor where a robot has what its model lacks: play in every joint, a drift, a term that turns with a joint.
#[test]
fn a_misfit_is_not_taken_for_several_sessions() {
    let trials = if std::env::var_os("CALIBRIG_FULL").is_some() { 200 } else { 30 };
    for trial in 0..trials {
        for lack in ["nothing", "play", "drift", "sines"] {
            let (model, mut set) = sound(trial, [20, 40, 80][trial as usize % 3]);
            let mut rng = stream(23, trial, StreamSource::IdentificationNoise);
            let count = set.observations.len() as f64;
            for (index, observation) in set.observations.iter_mut().enumerate() {
                let shares: Vec<f64> = (0..observation.command.len())
                    .map(|joint| match lack {
                        "play" => 3e-4 * f64::from(rng.random_range(0..=1) * 2 - 1),
                        "drift" if joint == 0 => 3e-3 * index as f64 / count,
                        "sines" => 1e-3 * (2.0 * observation.command[joint]).sin(),
                        _ => 0.0,
                    })
                    .collect();
                let off: Vec<f64> =
                    observation.command.iter().zip(&shares).map(|(q, share)| q + share).collect();
                let at = |command: &[f64]| {
                    let flange = forward_kinematics(&model.kinematics, command).expect("a pose");
                    flange.rotation * Vector3::new(0.05, 0.08, 0.12) + flange.translation.vector
                };
                let by = at(&off) - at(&observation.command);
                let Reading::Cartesian { position, .. } = &mut observation.reading else {
                    panic!("Cartesian")
                };
                *position += by;
            }
            for stated in [true, false] {
                let estimate = estimate(&model, &set, stated);
                let told = reasons(&estimate);
                assert!(
                    !told.contains(&"several_targets") && !told.contains(&"station_moved"),
                    "{trial} {lack} {stated}: {:?}",
                    estimate.warnings
                );
            }
        }
    }
}
