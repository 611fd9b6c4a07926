use nalgebra::{Matrix3, Rotation3, Vector3, Vector6};
use rand::{Rng, RngExt};

use super::random_walk::BEFORE;
use super::*;
use crate::geometry::{best_fit_transform, rotation_x, rotation_z, small_displacement, translation};
use crate::measurement::{MeasurementSet, Observation, SphericalReading, Station, Target, register};
use crate::random::{StreamSource, stream};

/// Poses, s from one to the next, poses between two rounds of nests, s from one nest to the next.
const POSES: u32 = 1000;
const PER_POSE: f64 = 10.0;
const EVERY: u32 = 20;
const PER_NEST: f64 = 4.0;
/// Of one coordinate, m, and of the nests' certificate.
const NOISE: f64 = 5e-6;
const CERTIFIED: f64 = 25e-6;

/// How the tracker of a test moves: of the whole motion, m or rad, over all poses.
#[derive(Clone, Copy)]
enum Motion {
    Still,
    Ramp,
    Walk,
}

struct Session {
    set: MeasurementSet,
    /// True places of the target in the base frame, m.
    points: Vec<Vector3<f64>>,
    /// True `tracker_from_base` at every observation.
    places: Vec<Transform>,
}

fn normal(rng: &mut impl Rng) -> f64 {
    // Irwin-Hall of twelve: variance one, and no dependency for it.
    (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0
}

fn normals(rng: &mut impl Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| normal(rng))
}

fn spherical(position: Vector3<f64>, sigma: f64) -> Reading {
    let [range, azimuth, elevation] = Reading::Cartesian { position, covariance: None }.spherical();
    let across = (sigma / range).powi(2);
    let covariance =
        Matrix3::from_diagonal(&Vector3::new(sigma.powi(2), across / elevation.cos().powi(2), across));
    Reading::Spherical(SphericalReading {
        range,
        azimuth,
        elevation,
        covariance: Some(covariance),
        face: Face::Front,
    })
}

/// A session with rounds of eight nests before, between and after the poses, whose tracker stands 4 m off.
fn session(motion: Motion, noise: f64, trial: u32) -> Session {
    let mut rng = stream(17, trial, StreamSource::IdentificationNoise);
    let mut walk = stream(17, trial, StreamSource::NestNoise);
    let stand = translation(0.4, -0.3, -4.0) * rotation_z(0.7) * rotation_x(-1.2);
    let duration = f64::from(POSES) * PER_POSE;
    let direction = Vector6::new(30e-6, -30e-6, 26e-6, 5e-6, -6e-6, 6e-6);
    let mut state = Vector6::zeros();
    let mut at = 0.0;
    let mut place = |time: f64| {
        match motion {
            Motion::Still => {}
            Motion::Ramp => state = direction * (time / duration),
            Motion::Walk => {
                let part = ((time - at) / duration).sqrt();
                at = time;
                let [v, w] = [normals(&mut walk) * (50e-6 * part), normals(&mut walk) * (10e-6 * part)];
                state += Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z);
            }
        }
        small_displacement(&state) * stand
    };
    let true_nests: Vec<Vector3<f64>> = (0..8)
        .map(|k| {
            let side = |bit: i32| if k >> bit & 1 == 1 { 1.0 } else { -1.0 };
            Vector3::new(1.3 * side(0), 0.6 * side(1) + 0.1, 0.9 * side(2))
        })
        .collect();
    let certified: Vec<_> = true_nests.iter().map(|nest| nest + CERTIFIED * normals(&mut rng)).collect();
    let mut nests = Vec::new();
    let mut observations = Vec::new();
    let (mut points, mut places) = (Vec::new(), Vec::new());
    let mut time = 0.0;
    let see = |from: &Transform, point: &Vector3<f64>, rng: &mut _| {
        spherical(from.rotation * point + from.translation.vector + noise * normals(rng), NOISE)
    };
    for pose in 0..=POSES {
        if pose % EVERY == 0 {
            for (index, (nest, in_base)) in true_nests.iter().zip(&certified).enumerate() {
                nests.push(NestObservation {
                    name: format!("N{index}"),
                    in_base: *in_base,
                    in_base_covariance: Matrix3::identity() * CERTIFIED.powi(2),
                    reading: see(&place(time), nest, &mut rng),
                    time: Some(time),
                });
                time += PER_NEST;
            }
        }
        if pose == POSES {
            break;
        }
        let point = Vector3::from_fn(|axis, _| [2.0, 1.2, 1.2][axis] * rng.random_range(-1.0..1.0));
        let from = place(time);
        observations.push(Observation {
            pose,
            command: vec![0.0],
            approach: vec![0],
            since_reversal: Vec::new(),
            temperature: None,
            time,
            station: 0,
            target: 0,
            payload: None,
            reading: see(&from, &point, &mut rng),
        });
        points.push(point);
        places.push(from);
        time += PER_POSE;
    }
    let stations = vec![Station { name: "1".to_owned(), nests, ..Station::default() }];
    let targets = vec![Target { name: "SMR".to_owned(), ..Target::default() }];
    Session { set: MeasurementSet { stations, targets, observations }, points, places }
}

/// RMS distance of the readings from the points, laid over them as a fit with a free frame does.
fn residual(set: &MeasurementSet, points: &[Vector3<f64>]) -> f64 {
    let seen: Vec<_> = set.observations.iter().map(|o| o.reading.position()).collect();
    let frame = best_fit_transform(&seen, points).expect("points in space");
    let off = |(seen, point): (&Vector3<f64>, &Vector3<f64>)| {
        (frame.rotation * point + frame.translation.vector - seen).norm_squared()
    };
    (seen.iter().zip(points).map(off).sum::<f64>() / points.len() as f64).sqrt()
}

#[test]
fn a_ramp_and_a_random_walk_of_50_um_are_removed() {
    let free = session(Motion::Still, NOISE, 0);
    let free = residual(&free.set, &free.points);
    for (name, motion, allowed) in [("ramp", Motion::Ramp, 1.10), ("walk", Motion::Walk, 1.40)] {
        let Session { set, points, .. } = session(motion, NOISE, 0);
        let steady = remove_drift(&set).expect("sound nests");
        let [drifting, corrected] = [&set, &steady.measurements].map(|set| 1e6 * residual(set, &points));
        let free = 1e6 * free;
        println!(
            "{name}: drift-free {free:.2} um, uncorrected {drifting:.2}, corrected {corrected:.2} ({:.3})",
            corrected / free
        );
        println!("{:?}", steady.stations[0]);
        assert!(corrected < allowed * free, "{name}: {corrected} of {free} um");
        assert!(drifting > 1.5 * free, "{name}: nothing to remove, {drifting} of {free} um");
        let DriftVerdict::Removed(size) = &steady.stations[0].verdict else { panic!("{name}: not found") };
        assert!((25e-6..150e-6).contains(&size.motion), "{name}: {}", size.motion);
        assert_eq!((size.outside, steady.stations[0].rounds, steady.stations[0].nests), (0, 51, 8));
    }
}

#[test]
fn what_a_correction_leaves_open_is_what_it_states() {
    // Error of the correction itself: of a point that is seen without noise, while nests have theirs.
    let (mut squares, mut stated, mut chi2) = (0.0, 0.0, Vec::new());
    for trial in 0..6 {
        let Session { set, points, places } = session(Motion::Walk, NOISE, trial);
        let mut exact = set.clone();
        for ((observation, point), from) in exact.observations.iter_mut().zip(&points).zip(&places) {
            let position = from.rotation * point + from.translation.vector;
            observation.reading = Reading::Cartesian { position, covariance: Some(Matrix3::zeros()) };
        }
        let steady = remove_drift(&exact).expect("sound nests").measurements;
        let seen: Vec<_> = steady.observations.iter().map(|o| o.reading.position()).collect();
        let frame = best_fit_transform(&seen, &points).expect("points in space");
        // Every 50th: neighbours share their rounds.
        for (o, point) in steady.observations.iter().zip(&points).step_by(50) {
            let error = frame.rotation * point + frame.translation.vector - o.reading.position();
            let covariance = o.reading.position_covariance().expect("stated");
            squares += error.norm_squared();
            stated += covariance.trace();
            chi2.push(error.dot(&(covariance.try_inverse().expect("positive") * error)));
        }
    }
    let ratio = (squares / stated).sqrt();
    let per_dof = chi2.iter().sum::<f64>() / (3.0 * chi2.len() as f64);
    println!(
        "error of the correction over its stated sigma: {ratio:.3}, chi-square per degree of freedom {per_dof:.3} of {}",
        chi2.len()
    );
    // 360 degrees of freedom that share little: 99.9 % of chi-square / 360 within 1 +- 0.25; the rates are estimated on top.
    assert!((0.70..1.30).contains(&per_dof), "{per_dof}");
}

#[test]
fn knots_are_known_together_about_the_mean_of_all_sightings() {
    let mut station = session(Motion::Walk, NOISE, 1).set.stations.remove(0);
    station.nests.truncate(8 * 6);
    let times: Vec<f64> = station.nests.iter().filter_map(|nest| nest.time).collect();
    let walk = rounds_of(&station, &[]).expect("nests").walk;
    let all = walk.smooth(false, &times).expect("six rounds").joint;
    let mean: nalgebra::DMatrix<f64> =
        (0..times.len()).map(|k| all.rows(6 * k, 6) / times.len() as f64).sum();
    assert!(mean.amax() < 1e-8 * all.amax(), "{} of {}", mean.amax(), all.amax());
    assert_eq!(all, all.transpose());
    let least = all.symmetric_eigenvalues().min();
    // It is what is left of a wide variance known beforehand: singular but for the rounding of that in some fifty updates.
    assert!(least > -1e3 * f64::EPSILON * BEFORE, "{least}");
    // Whichever of them are asked for.
    let few = walk.smooth(false, &times[3..9]).expect("six rounds").joint;
    assert_eq!(few, all.view((18, 18), (36, 36)));
}

#[test]
fn errors_of_certificates_are_no_drift_and_a_still_tracker_is_left_alone() {
    let mut false_alarms = 0;
    for trial in 0..20 {
        let mut still = session(Motion::Still, NOISE, trial).set;
        // Half a millimetre off: as far as certificates can be, and the same in every round.
        still.stations[0].nests.iter_mut().for_each(|nest| {
            if nest.name == "N3" {
                nest.in_base.x += 0.5e-3;
            }
        });
        let steady = remove_drift(&still).expect("sound nests");
        match steady.stations[0].verdict {
            DriftVerdict::None { .. } => {
                assert_eq!(steady.measurements.observations, still.observations);
                let ratio = steady.stations[0].noise_ratio.expect("51 rounds");
                // 3 * 8 * 50 degrees of freedom.
                assert!((ratio - 1.0).abs() < 3.3 / (2.0 * 1200.0_f64).sqrt(), "{ratio}");
            }
            _ => false_alarms += 1,
        }
        assert_eq!(steady.measurements.stations[0].nests.len(), 8);
    }
    // Binomial(20, 0.01): more than two in one of a thousand tries.
    assert!(false_alarms <= 2, "{false_alarms} of 20");
}

#[test]
fn merged_nests_place_the_tracker_as_well_as_their_number_says() {
    // The nests' certificate is common to all rounds: it must not shrink with them.
    let still = session(Motion::Still, NOISE, 3).set;
    let merged = remove_drift(&still).expect("sound nests").measurements;
    let one = NestObservation { time: None, ..still.stations[0].nests[0].clone() };
    let first_round = Station { nests: still.stations[0].nests[..8].to_vec(), ..still.stations[0].clone() };
    let [once, all] = [&first_round, &merged.stations[0]].map(|station| register(station).expect("nests"));
    let [once, all] = [once, all].map(|r| r.covariance[(0, 0)].sqrt());
    // One round: sqrt(25² + 5²) / sqrt(8); all: 25 / sqrt(8).
    println!(
        "{:.3} um by one round, {:.3} um by all; certificate alone {:.3}",
        1e6 * once,
        1e6 * all,
        25.0 / 8.0_f64.sqrt()
    );
    assert!(all < once && all > 0.99 * CERTIFIED / 8.0_f64.sqrt());
    let own = merged.stations[0].nests[0].reading.position_covariance().expect("stated").trace();
    let of_one = one.reading.position_covariance().expect("stated").trace();
    assert!((own * 51.0 / of_one - 1.0).abs() < 1e-3, "{own} of {of_one}");
}

#[test]
fn a_nest_that_was_not_seated_in_one_round_is_named_and_left_out() {
    for motion in [Motion::Still, Motion::Walk] {
        for off in [60e-6, 1e-3] {
            let mut set = session(motion, NOISE, 5).set;
            let which = 8 * 20 + 6;
            let sound = remove_drift(&set).expect("sound").measurements.stations[0].nests[6].clone();
            let at = set.stations[0].nests[which].reading.position() + off * Vector3::new(0.6, 0.0, 0.8);
            set.stations[0].nests[which].reading = spherical(at, NOISE);
            let steady = remove_drift(&set).expect("one bad reading");
            let found = &steady.stations[0].contradictions;
            assert_eq!(found.len(), 1, "{off}: {found:?}");
            assert_eq!(
                (found[0].nest.as_str(), found[0].time),
                ("N6", set.stations[0].nests[which].time.unwrap())
            );
            assert!((found[0].distance / off - 1.0).abs() < 0.35, "{off}: {}", found[0].distance);
            let merged = &steady.measurements.stations[0].nests[6];
            let moved = (merged.reading.position() - sound.reading.position()).norm();
            assert!(moved < 1e-6, "{off}: {moved}");
        }
    }
}

#[test]
fn a_certificate_that_stations_share_counts_once() {
    let mut set = session(Motion::Still, NOISE, 0).set;
    set.stations[0].nests.truncate(8);
    assert!(!set.clone().share_certificates());
    let mut second = set.stations[0].clone();
    second.nests[7].name = "another".to_owned();
    second.nests[6].in_base.x += 1e-6;
    set.stations.push(second);
    assert!(set.share_certificates());
    for station in &set.stations {
        let factors: Vec<f64> = station
            .nests
            .iter()
            .map(|n| (n.in_base_covariance[(0, 0)] / CERTIFIED.powi(2)).round())
            .collect();
        assert_eq!(factors, [2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 1.0, 1.0]);
    }
}

#[test]
fn a_session_without_rounds_is_as_it_was() {
    let mut once = session(Motion::Walk, NOISE, 0).set;
    once.stations[0].nests.truncate(8);
    let steady = remove_drift(&once).expect("one round");
    assert_eq!((steady.measurements, steady.stations), (once, vec![]));
}

#[test]
fn rounds_without_times_are_merged_and_told() {
    let mut set = session(Motion::Walk, NOISE, 0).set;
    set.stations[0].nests[9].time = None;
    let steady = remove_drift(&set).expect("nests");
    assert_eq!(steady.stations[0].verdict, DriftVerdict::Unknown { missing: MissingForDrift::Times });
    assert_eq!(steady.measurements.stations[0].nests.len(), 8);
    assert_eq!(steady.measurements.observations, set.observations);
}

#[test]
fn rounds_that_make_no_sense_are_refused() {
    let sound = session(Motion::Walk, NOISE, 0).set;
    let refusal = |change: &dyn Fn(&mut Vec<NestObservation>)| {
        let mut set = sound.clone();
        change(&mut set.stations[0].nests);
        remove_drift(&set).expect_err("no sense").to_string()
    };
    let two_places = refusal(&|nests| nests[11].in_base.z += 2e-4);
    assert!(two_places.contains("nest N3 is certified at two places, 0.2000 mm apart"), "{two_places}");
    let one_line = refusal(&|nests| {
        for nest in nests.iter_mut() {
            let index: f64 = nest.name[1..].parse().expect("a digit");
            nest.reading = spherical(Vector3::new(2.0 + 0.3 * index, 1.0, 0.5), NOISE);
        }
    });
    assert!(one_line.contains("station 1: the base nests lie on one line"), "{one_line}");
    let few = refusal(&|nests| nests.retain(|nest| ["N1", "N2"].contains(&nest.name.as_str())));
    assert!(few.contains("2 base nests were measured"), "{few}");
    let moved = refusal(&|nests| {
        for nest in nests.iter_mut().skip(8 * 10) {
            nest.reading = spherical(nest.reading.position() + Vector3::new(5e-3, 0.0, 0.0), NOISE);
        }
    });
    assert!(moved.contains("the tracker moved by 5.0") && moved.contains("a separate station"), "{moved}");
}

#[test]
fn full_poses_turn_with_the_tracker() {
    let Session { mut set, places, .. } = session(Motion::Ramp, NOISE, 0);
    for (observation, from) in set.observations.iter_mut().zip(&places) {
        observation.reading = Reading::Pose(Box::new(crate::measurement::PoseReading {
            position: observation.reading.position(),
            rotation: from.rotation,
            covariance: Some(nalgebra::Matrix6::identity() * 1e-12),
        }));
    }
    let steady = remove_drift(&set).expect("sound").measurements;
    let turn = |set: &MeasurementSet| {
        let rotations: Vec<Rotation3<f64>> = set
            .observations
            .iter()
            .map(|o| if let Reading::Pose(pose) = &o.reading { pose.rotation } else { Rotation3::identity() })
            .collect();
        (rotations[0].inverse() * rotations[999]).angle()
    };
    let [before, after] = [&set, &steady].map(turn);
    assert!(before > 9e-6 && after < 2e-6, "{before} {after}");
}
