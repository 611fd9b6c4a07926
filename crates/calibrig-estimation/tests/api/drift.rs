//! Trackers that drift, and nests that are measured again: what the correction is off by is common to readings, in the fit as in the data.

use std::f64::consts::PI;

use calibrig_estimation::identification::{
    DEFAULT_TOLERANCE, Estimate, IdentificationOptions, Warning, identify, predict_places,
};
use calibrig_estimation::kinematics::target_in_base;
use calibrig_model::geometry::{
    Transform, cross_matrix, rotation_x, rotation_z, small_displacement, translation,
};
use calibrig_model::measurement::{
    DriftVerdict, MeasurementSet, NestObservation, Observation, Reading, Station, Steady, Target,
    remove_drift,
};
use calibrig_model::nalgebra::{DMatrix, DVector, Matrix3, Matrix3x6, Vector3, Vector6};
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::statistics::chi2_survival;
use calibrig_model::{CalibrationModel, KinematicModel, LinkTerm, ParameterId};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

use super::coverage::{links, p_value, robots};

/// Of a coordinate of a reading, of a nest's certified place and of the target's offset, m.
const NOISE: f64 = 5e-6;
const CERTIFIED: f64 = 10e-6;
const TARGET: Vector3<f64> = Vector3::new(0.05, 0.08, 0.12);
/// Walk of the tracker's place and of its turn after an hour, m and rad.
const WALK: [f64; 2] = [30e-6, 8e-6];
/// s, from pose to pose and from nest to nest.
const PER_POSE: f64 = 40.0;
const PER_NEST: f64 = 5.0;

fn normals(rng: &mut impl Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| StandardNormal.sample(rng))
}

fn options() -> IdentificationOptions {
    IdentificationOptions { tolerance: Some(DEFAULT_TOLERANCE), ..IdentificationOptions::published() }
}

/// A session of a machine that is as its model, whose tracker walks on its stand; every so many poses the nests are measured, and before and after
/// all. Beside it where the tracker stood on the average of the nests' readings.
fn session(machine: &KinematicModel, (poses, every): (u32, u32), trial: u32) -> (MeasurementSet, Transform) {
    let mut rng = stream(31, trial, StreamSource::IdentificationNoise);
    let stand = translation(0.3, -0.2, 2.2) * rotation_z(0.7) * rotation_x(1.3);
    let (mut walk, mut at, mut sum) = (Vector6::zeros(), 0.0, Vector6::zeros());
    let mut see = |point: &Vector3<f64>, time: f64, share: f64, rng: &mut _| {
        let passed = ((time - at) / 3600.0_f64).sqrt();
        at = time;
        let [v, w] = [normals(rng) * (WALK[0] * passed), normals(rng) * (WALK[1] * passed)];
        walk += Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z);
        sum += walk * share;
        let seen = small_displacement(&walk) * stand;
        let position = seen.rotation * point + seen.translation.vector + NOISE * normals(rng);
        Reading::Cartesian { position, covariance: Some(Matrix3::identity() * NOISE.powi(2)) }
    };
    let places: Vec<Vector3<f64>> = (0..6)
        .map(|k| {
            let (sin, cos) = (f64::from(k) * PI / 3.0).sin_cos();
            Vector3::new(1.2 * cos, 1.2 * sin, if k % 2 == 0 { 0.0 } else { 0.7 })
        })
        .collect();
    let certified: Vec<_> = places.iter().map(|place| place + CERTIFIED * normals(&mut rng)).collect();
    let joints = machine.joint_count();
    let (mut nests, mut observations, mut time) = (Vec::new(), Vec::new(), 0.0);
    for pose in 0..=poses {
        if pose % every == 0 || pose == poses {
            for (k, (place, in_base)) in places.iter().zip(&certified).enumerate() {
                time += PER_NEST;
                nests.push(NestObservation {
                    name: format!("N{k}"),
                    in_base: *in_base,
                    in_base_covariance: Matrix3::identity() * CERTIFIED.powi(2),
                    reading: see(place, time, 1.0, &mut rng),
                    time: Some(time),
                });
            }
        }
        if pose < poses {
            time += PER_POSE;
            let command: Vec<f64> = (0..joints).map(|_| rng.random_range(-0.8 * PI..0.8 * PI)).collect();
            let point = target_in_base(machine, &command, &TARGET).expect("a pose");
            let reading = see(&point, time, 0.0, &mut rng);
            let approach = vec![0; joints];
            let (station, target) = (0, 0);
            observations.push(Observation {
                since_reversal: Vec::new(),
                pose,
                command,
                approach,
                temperature: None,
                time,
                station,
                target,
                payload: None,
                reading,
            });
        }
    }
    let place = small_displacement(&(sum / nests.len() as f64)) * stand;
    let in_flange = TARGET + CERTIFIED * normals(&mut rng);
    let covariance = Some(Matrix3::identity() * CERTIFIED.powi(2));
    let stations = vec![Station { name: "T".to_owned(), nests, ..Station::default() }];
    let targets = vec![Target { name: "SMR".to_owned(), in_flange, covariance, orientation: None }];
    (MeasurementSet { stations, targets, observations }, place)
}

/// Every reading of a session with its place (m) in the tracker's frame and its time (s): those of the nests first.
fn all_readings(set: &MeasurementSet) -> Vec<(Vector3<f64>, f64)> {
    let nests = set.stations[0].nests.iter().map(|nest| (nest.reading.position(), nest.time.expect("timed")));
    nests.chain(set.observations.iter().map(|o| (o.reading.position(), o.time))).collect()
}

/// Covariance of parameters, and how far their values are from those of greatest likelihood: by generalised least squares of all that was read, nests and target,
/// with the covariance of all readings as one dense matrix, at the estimate.
fn generalised(
    model: &CalibrationModel,
    set: &MeasurementSet,
    (rates, noise_ratio): ([f64; 2], f64),
    estimate: &Estimate,
) -> (DMatrix<f64>, DVector<f64>) {
    let nests = &set.stations[0].nests;
    let readings = all_readings(set);
    let n = estimate.parameters.len();
    let of_link = |id: ParameterId| matches!(id, ParameterId::Link { .. });
    let place = estimate.robot.stations[0];
    let x: Vec<f64> = estimate.parameters.iter().map(|p| p.value).collect();
    // Predicted places in the tracker's frame, of parameters that are off by one step.
    let predicted = |column: Option<(usize, f64)>| -> DVector<f64> {
        let mut machine = model.kinematics.clone();
        let (mut frame, mut target) = (Vector6::zeros(), set.targets[0].in_flange);
        for (i, parameter) in estimate.parameters.iter().enumerate() {
            let step = column.filter(|(own, _)| *own == i).map_or(0.0, |(_, step)| step);
            match parameter.id {
                id @ ParameterId::Link { .. } => machine.add(id, parameter.value + step),
                ParameterId::Frame { component, .. } => frame[component] += step,
                ParameterId::Target { axis, .. } => target[axis] += parameter.value + step,
                other => panic!("{other}"),
            }
        }
        let from_base = place * small_displacement(&frame);
        let of_target = |o: &Observation| target_in_base(&machine, &o.command, &target).expect("a pose");
        let points = nests.iter().map(|nest| nest.in_base).chain(set.observations.iter().map(of_target));
        let seen = points.flat_map(|p| (from_base.rotation * p + from_base.translation.vector).data.0[0]);
        DVector::from_iterator(3 * readings.len(), seen)
    };
    let columns: Vec<_> =
        (0..n).map(|i| (predicted(Some((i, 1e-6))) - predicted(Some((i, -1e-6)))) / 2e-6).collect();
    let jacobian = DMatrix::from_columns(&columns);
    let seen = DVector::from_iterator(3 * readings.len(), readings.iter().flat_map(|(p, _)| p.data.0[0]));
    let residuals = predicted(None) - seen;
    // Every pair of readings: the walk since the first, the place of a nest, noise.
    let centre = readings[..nests.len()].iter().map(|(p, _)| p).sum::<Vector3<f64>>() / nests.len() as f64;
    let radius = (readings[..nests.len()].iter().map(|(p, _)| (p - centre).norm_squared()).sum::<f64>()
        / nests.len() as f64)
        .sqrt();
    let walk = |i: usize| {
        let mut by = Matrix3x6::zeros();
        by.fixed_columns_mut::<3>(0).copy_from(&Matrix3::identity());
        by.fixed_columns_mut::<3>(3).copy_from(&(-cross_matrix(&(readings[i].0 - centre)) / radius));
        by
    };
    let mut covariance = DMatrix::zeros(residuals.len(), residuals.len());
    for i in 0..readings.len() {
        for j in 0..readings.len() {
            let since = readings[i].1.min(readings[j].1) - readings[0].1;
            let spread = Vector6::from_fn(|k, _| rates[k / 3] * since);
            let mut block = walk(i) * Matrix3x6::from_fn(|r, c| walk(j)[(r, c)] * spread[c]).transpose();
            if i < nests.len() && j < nests.len() && nests[i].name == nests[j].name {
                block += Matrix3::identity() * CERTIFIED.powi(2);
            }
            if i == j {
                let own = if i < nests.len() { noise_ratio * NOISE } else { NOISE };
                block += Matrix3::identity() * own.powi(2);
            }
            covariance.view_mut((3 * i, 3 * j), (3, 3)).copy_from(&block);
        }
    }
    let factor = covariance.cholesky().expect("positive definite").l();
    let jacobian = factor.solve_lower_triangular(&jacobian).expect("regular");
    let residuals = factor.solve_lower_triangular(&residuals).expect("regular");
    let mut information = jacobian.tr_mul(&jacobian);
    let mut gradient = jacobian.tr_mul(&residuals);
    for (i, parameter) in estimate.parameters.iter().enumerate() {
        let sigma = match parameter.id {
            ParameterId::Link { term, .. } => match term {
                LinkTerm::A | LinkTerm::D => DEFAULT_TOLERANCE.length,
                _ => DEFAULT_TOLERANCE.angle,
            },
            ParameterId::Target { .. } => CERTIFIED,
            _ => continue,
        };
        information[(i, i)] += sigma.powi(-2);
        gradient[i] += x[i] / sigma.powi(2);
    }
    let covariance = information.cholesky().expect("determined").inverse();
    let step = -&covariance * gradient;
    // The frame is that of the first reading here, and that of the rounds' mean there.
    let own: Vec<usize> = (0..n).filter(|i| of_link(estimate.parameters[*i].id)).collect();
    (covariance.select_rows(&own).select_columns(&own), step.select_rows(&own))
}

/// What the nests say of the walk: variances a second of centroid and of turn times radius, and the noise of nests over the stated one.
fn told(steady: &Steady, set: &MeasurementSet) -> ([f64; 2], f64) {
    let DriftVerdict::Removed(size) = &steady.stations[0].verdict else { panic!("{:?}", steady.stations) };
    let readings = all_readings(set);
    let nests = &readings[..set.stations[0].nests.len()];
    let centre = nests.iter().map(|(p, _)| p).sum::<Vector3<f64>>() / nests.len() as f64;
    let radius = nests.iter().map(|(p, _)| (p - centre).norm_squared()).sum::<f64>() / nests.len() as f64;
    let rates = [size.motion_per_hour.powi(2) / 3600.0, size.turn_per_hour.powi(2) * radius / 3600.0];
    (rates, steady.stations[0].noise_ratio.expect("rounds"))
}

/// Relative to generalised least squares: the worst standard deviation of a link's parameter, low and high, the eigenvalues of the whole covariance, and
/// the worst value, in standard deviations.
struct Against {
    sigmas: [f64; 2],
    spread: [f64; 2],
    value: f64,
}

fn against(reference: &(DMatrix<f64>, DVector<f64>), estimate: &Estimate) -> Against {
    let own: Vec<usize> = (0..estimate.parameters.len())
        .filter(|i| matches!(estimate.parameters[*i].id, ParameterId::Link { .. }))
        .collect();
    let covariance = estimate.covariance.as_ref().expect("full rank").select_rows(&own).select_columns(&own);
    let range = |values: Vec<f64>| {
        [values.iter().copied().fold(f64::INFINITY, f64::min), values.iter().copied().fold(0.0, f64::max)]
    };
    let sigma = |i: usize| reference.0[(i, i)].sqrt();
    let ratios = (0..own.len()).map(|i| covariance[(i, i)].sqrt() / sigma(i)).collect();
    let factor = reference.0.clone().cholesky().expect("regular").l();
    let half = factor.solve_lower_triangular(&covariance).expect("regular");
    let whole = factor.solve_lower_triangular(&half.transpose()).expect("regular");
    let whole = (&whole + whole.transpose()) * 0.5;
    let eigenvalues = whole.symmetric_eigenvalues().iter().copied().collect();
    let value = (0..own.len()).map(|i| (reference.1[i] / sigma(i)).abs()).fold(0.0, f64::max);
    Against { sigmas: range(ratios), spread: range(eigenvalues), value }
}

/// With the variances of the walk that the nests tell, which both are given.
#[test]
fn the_fit_is_that_of_generalised_least_squares_with_all_readings_in_one_covariance() {
    let model = &robots()[0];
    for plan in [(24, 6), (40, 20)] {
        for trial in 0..3 {
            let (set, _) = session(&model.kinematics, plan, trial);
            let steady = remove_drift(&set).expect("sound nests");
            let estimate = identify(model, &steady.measurements, &options()).expect("an estimate");
            let reference = generalised(model, &set, told(&steady, &set), &estimate);
            let found = against(&reference, &estimate);
            let mut apart = steady.measurements.clone();
            apart.stations[0].motion = None;
            let apart = identify(model, &apart, &options()).expect("an estimate");
            let as_own = against(&generalised(model, &set, told(&steady, &set), &apart), &apart);
            println!(
                "{plan:?}: sigmas {:.3?}, covariance {:.3?}, values within {:.3} sigma; as each reading's own {:.3?}, {:.3?}, {:.3}",
                found.sigmas, found.spread, found.value, as_own.sigmas, as_own.spread, as_own.value
            );
            assert!(found.sigmas.iter().all(|ratio| (ratio - 1.0).abs() < 0.02), "{:?}", found.sigmas);
            assert!(found.spread.iter().all(|ratio| (ratio - 1.0).abs() < 0.05), "{:?}", found.spread);
            assert!(found.value < 0.1, "{}", found.value);
            // So that the bounds above can tell the two apart.
            assert!(as_own.spread[1] > 1.2, "nothing to share: {:?}", as_own.spread);
        }
    }
}

/// Links that are off by draws of 0.5 mm and 1 mrad.
fn drawn(model: &CalibrationModel, ids: &[ParameterId], trial: u32) -> (KinematicModel, Vec<f64>) {
    let mut rng = stream(32, trial, StreamSource::AsBuilt);
    let mut machine = model.kinematics.clone();
    let mut draw = |id: &ParameterId| {
        let ParameterId::Link { term, .. } = id else { return 0.0 };
        let size = if matches!(term, LinkTerm::A | LinkTerm::D) { 0.5e-3 } else { 1e-3 };
        let normal: f64 = StandardNormal.sample(&mut rng);
        machine.add(*id, size * normal);
        size * normal
    };
    let truth = ids.iter().map(&mut draw).collect();
    (machine, truth)
}

/// Where the tracker would see a target at commands that were not measured, had it stood still.
fn elsewhere(
    machine: &KinematicModel,
    set: &MeasurementSet,
    place: &Transform,
    trial: u32,
) -> MeasurementSet {
    let mut rng = stream(33, trial, StreamSource::VerificationNoise);
    let mut places = MeasurementSet { observations: set.observations[..1].to_vec(), ..set.clone() };
    let observation = &mut places.observations[0];
    observation.command.fill_with(|| rng.random_range(-0.8 * PI..0.8 * PI));
    let point = target_in_base(machine, &observation.command, &TARGET).expect("a pose");
    let position = place.rotation * point + place.translation.vector;
    observation.reading = Reading::Cartesian { position, covariance: None };
    places
}

/// All tests share one false alarm in a thousand. How often the size of a single session's residuals is doubted is shown and not tested: the walk's variances
/// are estimates from seven rounds, which chi-square does not know of.
#[test]
fn intervals_of_parameters_and_places_hold_beside_a_drift() {
    let trials = if std::env::var_os("CALIBRIG_FULL").is_some() { 1000 } else { 250 };
    let model = &robots()[0];
    let options = options();
    let mut tests = Vec::new();
    for plan in [(30, 5), (60, 10)] {
        let any = remove_drift(&session(&model.kinematics, plan, 0).0).expect("sound nests").measurements;
        let ids = links(&identify(model, &any, &options).expect("an estimate"));
        let (mut held, mut at_places) = (vec![0; ids.len()], [0; 3]);
        let (mut chi2, mut freedom, mut nees, mut doubted) = (0.0, 0.0, 0.0, 0);
        for trial in 0..trials {
            let (machine, truth) = drawn(model, &ids, trial);
            let (set, place) = session(&machine, plan, 1000 + trial);
            let steady = remove_drift(&set).expect("sound nests").measurements;
            let estimate = identify(model, &steady, &options).expect("an estimate");
            let factor = estimate.interval_factor(0.95);
            let own: Vec<usize> = (0..estimate.parameters.len())
                .filter(|i| ids.contains(&estimate.parameters[*i].id))
                .collect();
            let error = DVector::from_fn(ids.len(), |i, _| estimate.parameters[own[i]].value - truth[i]);
            let covariance = estimate.covariance.as_ref().expect("full rank");
            let covariance = covariance.select_rows(&own).select_columns(&own);
            for (i, held) in held.iter_mut().enumerate() {
                *held += u64::from(error[i].abs() <= factor * covariance[(i, i)].sqrt());
            }
            nees += error.dot(&covariance.cholesky().expect("regular").solve(&error));
            (chi2, freedom) = (chi2 + estimate.chi2, freedom + estimate.degrees_of_freedom);
            let doubts = |w: &Warning| matches!(w, Warning::Overstated { .. } | Warning::Inconsistent { .. });
            doubted += u64::from(estimate.warnings.iter().any(doubts));
            let there = elsewhere(&machine, &steady, &place, trial);
            let predicted =
                predict_places(model, &there, &options, &estimate).expect("its own").expect("known");
            for (axis, inside) in at_places.iter_mut().enumerate() {
                let sigma = predicted[0].of_parameters[(axis, axis)].sqrt();
                *inside += u64::from(predicted[0].error[axis].abs() <= factor * sigma);
            }
        }
        let count = u64::from(trials);
        let n = (trials as usize * ids.len()) as f64;
        let share = |hits: u64, of: f64| 1e2 * hits as f64 / of;
        println!(
            "{plan:?}: chi-square per degree of freedom {:.3}, NEES per parameter {:.3}; {:.1} % of parameters and {:.1} % of places inside; {doubted} doubted",
            chi2 / freedom,
            nees / n,
            share(held.iter().sum(), n),
            share(at_places.iter().sum(), 3.0 * f64::from(trials))
        );
        for hits in held.iter().chain(&at_places) {
            tests.push((p_value(*hits, count, 0.95), format!("{plan:?}: {hits} of {count}")));
        }
        let of_square = |square: f64, dof: f64| {
            let less = 1.0 - chi2_survival(square, dof);
            2.0 * less.min(1.0 - less)
        };
        tests.push((of_square(chi2, freedom), format!("{plan:?}: chi-square {}", chi2 / freedom)));
        tests.push((of_square(nees, n), format!("{plan:?}: NEES {}", nees / n)));
    }
    let level = 1e-3 / tests.len() as f64;
    let failed: Vec<_> = tests.iter().filter(|(p, _)| *p < level).collect();
    assert!(failed.is_empty(), "{failed:?}");
}
