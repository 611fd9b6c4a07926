//! Robots that are as their model: how often stated intervals hold what was put in, and how often the size of residuals is doubted.

use std::f64::consts::{FRAC_PI_2, PI};

use calibrig_estimation::evaluation::ChiSquareTest;
use calibrig_estimation::identification::{
    Estimate, IdentificationOptions, NoiseScale, identify, predict_readings,
};
use calibrig_estimation::kinematics::target_in_base;
use calibrig_model::measurement::{MeasurementSet, Observation, Reading, Target};
use calibrig_model::nalgebra::Vector3;
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::statistics::binomial_cdf;
use calibrig_model::{CalibrationModel, CraigLink, LinkTerm, ParameterId};
use rand::RngExt;
use rand_distr::{Distribution, Normal};

pub const NOISE: f64 = 20e-6;
const TARGET: Vector3<f64> = Vector3::new(0.05, 0.08, 0.12);

/// Six and seven axes, in the shape of common arms; m and rad.
pub fn robots() -> [CalibrationModel; 2] {
    let arm = |rows: &[[f64; 3]]| {
        let link = |(i, [a, alpha, d]): (usize, &[f64; 3])| {
            CraigLink::revolute(format!("j{}", i + 1)).row(*a, *alpha, *d, 0.0).limits(-2.8, 2.8)
        };
        CalibrationModel::new(rows.iter().enumerate().map(link).collect()).expect("a robot")
    };
    let turn = FRAC_PI_2;
    [
        arm(&[
            [0.0, 0.0, 0.4],
            [0.05, -turn, 0.0],
            [0.5, 0.0, 0.0],
            [0.04, -turn, 0.6],
            [0.0, turn, 0.0],
            [0.0, -turn, 0.1],
        ]),
        arm(&[
            [0.0, 0.0, 0.34],
            [0.0, -turn, 0.0],
            [0.0, turn, 0.4],
            [0.0, turn, 0.0],
            [0.0, -turn, 0.4],
            [0.0, -turn, 0.0],
            [0.0, turn, 0.126],
        ]),
    ]
}

/// What of the links is identified, in the order of every estimate.
pub fn links(estimate: &Estimate) -> Vec<ParameterId> {
    let ids = estimate.parameters.iter().map(|p| p.id);
    ids.filter(|id| matches!(id, ParameterId::Link { .. })).collect()
}

/// A session of a robot whose identified links are off by draws of 0.5 mm and 1 mrad.
pub fn session(
    model: &CalibrationModel,
    ids: &[ParameterId],
    poses: usize,
    trial: u32,
) -> (Vec<f64>, MeasurementSet) {
    let mut rng = stream(11, trial, StreamSource::AsBuilt);
    let mut machine = model.kinematics.clone();
    let mut truth = Vec::new();
    for id in ids {
        let ParameterId::Link { term, .. } = id else { continue };
        let size = if matches!(term, LinkTerm::A | LinkTerm::D) { 0.5e-3 } else { 1e-3 };
        let value = Normal::new(0.0, size).expect("a width").sample(&mut rng);
        machine.add(*id, value);
        truth.push(value);
    }
    let noise = Normal::new(0.0, NOISE).expect("a width");
    let joints = model.kinematics.joint_count();
    let point = |_| {
        let command: Vec<f64> = (0..joints).map(|_| rng.random_range(-0.8 * PI..0.8 * PI)).collect();
        let position = target_in_base(&machine, &command, &TARGET).expect("a pose");
        (command, position + Vector3::from_fn(|_, _| noise.sample(&mut rng)))
    };
    (truth, MeasurementSet::of_points((0..poses).map(point).collect::<Vec<_>>()))
}

/// Intervals that held the truth of each parameter, and sizes that were doubted as too small and too large at 5 % each.
struct Counts {
    trials: u64,
    held: Vec<u64>,
    small: u64,
    large: u64,
}

fn count(model: &CalibrationModel, poses: usize, stated: bool, trials: u32) -> Counts {
    let options = IdentificationOptions::default();
    let any = session(model, &[], 60, 0).1.with_sigma(NOISE);
    let ids = links(&identify(model, &any, &options).expect("an estimate"));
    let mut counts = Counts { trials: u64::from(trials), held: vec![0; ids.len()], small: 0, large: 0 };
    for trial in 0..trials {
        let (truth, mut set) = session(model, &ids, poses, trial);
        if stated {
            set = set.with_sigma(NOISE);
        }
        let estimate = identify(model, &set, &options).expect("an estimate");
        let factor = estimate.interval_factor(0.95);
        for ((held, id), truth) in counts.held.iter_mut().zip(&ids).zip(&truth) {
            let parameter = estimate.parameters.iter().find(|p| p.id == *id).expect("identified");
            *held +=
                u64::from((parameter.value - truth).abs() <= factor * parameter.sigma.expect("full rank"));
        }
        if let Some(size) = ChiSquareTest::new(estimate.chi2, estimate.degrees_of_freedom).filter(|_| stated)
        {
            counts.small += u64::from(size.p_of_less() < 0.05);
            counts.large += u64::from(size.p_value < 0.05);
        }
    }
    counts
}

/// Two-sided: so seldom are as many or as few hits.
pub fn p_value(hits: u64, trials: u64, p: f64) -> f64 {
    let less = binomial_cdf(hits, trials, p);
    let more = if hits == 0 { 1.0 } else { 1.0 - binomial_cdf(hits - 1, trials, p) };
    2.0 * less.min(more)
}

/// With the default tolerance, which is far looser than the robots are made. The tests of a table share one false alarm in a thousand.
#[test]
fn intervals_of_matched_robots_hold_as_often_as_stated() {
    let trials = if std::env::var_os("CALIBRIG_FULL").is_some() { 1000 } else { 150 };
    let mut tests = Vec::new();
    for model in robots() {
        for poses in [20, 30, 60] {
            for stated in [true, false] {
                let counts = count(&model, poses, stated, trials);
                let all: u64 = counts.held.iter().sum();
                let (n, joints) = (counts.held.len() as u64, model.kinematics.joint_count());
                let share = |hits: u64, of: u64| 1e2 * hits as f64 / of as f64;
                println!(
                    "{joints}R, {poses} poses, noise {}: {:.1} % ({:.1} .. {:.1}) of {n} parameters inside; size too small {:.1} %, too large {:.1} %",
                    if stated { "stated" } else { "estimated" },
                    share(all, n * counts.trials),
                    share(*counts.held.iter().min().expect("some"), counts.trials),
                    share(*counts.held.iter().max().expect("some"), counts.trials),
                    share(counts.small, counts.trials),
                    share(counts.large, counts.trials),
                );
                let case = format!("{joints}R {poses} {stated}");
                tests.extend(
                    counts.held.iter().map(|hits| (p_value(*hits, counts.trials, 0.95), case.clone())),
                );
                if stated {
                    tests.push((p_value(counts.small, counts.trials, 0.05), format!("{case}: too small")));
                    tests.push((p_value(counts.large, counts.trials, 0.05), format!("{case}: too large")));
                }
            }
        }
    }
    let level = 1e-3 / tests.len() as f64;
    let failed: Vec<_> = tests.iter().filter(|(p, _)| *p < level).collect();
    assert!(failed.is_empty(), "{failed:?}");
}

/// Few poses: every parameter costs a degree of freedom, and hardly any are left.
#[test]
fn intervals_hold_from_few_poses() {
    let trials = if std::env::var_os("CALIBRIG_FULL").is_some() { 1000 } else { 200 };
    for model in robots() {
        // Coordinates for every parameter, of which the arm with seven axes has 31.
        let fewest = if model.kinematics.joint_count() == 7 { 11 } else { 10 };
        for poses in [fewest, 14] {
            for stated in [true, false] {
                let counts = count(&model, poses, stated, trials);
                let share = counts.held.iter().sum::<u64>() as f64
                    / (counts.held.len() as u64 * counts.trials) as f64;
                println!(
                    "{}R, {poses} poses, stated {stated}: {:.1} % inside",
                    model.kinematics.joint_count(),
                    1e2 * share
                );
                assert!((0.90..=0.99).contains(&share), "{share}");
            }
        }
    }
}

/// Three targets, seen at every pose of an arm whose joints repeat to 0.2 mrad.
fn three_targets(model: &CalibrationModel, ids: &[ParameterId], trial: u32) -> (Vec<f64>, MeasurementSet) {
    let (truth, plain) = session(model, ids, 40, trial);
    let mut machine = model.kinematics.clone();
    ids.iter().zip(&truth).for_each(|(id, value)| machine.add(*id, *value));
    let mut rng = stream(12, trial, StreamSource::IdentificationNoise);
    let (joints, noise) =
        (Normal::new(0.0, 0.2e-3).expect("a width"), Normal::new(0.0, NOISE).expect("a width"));
    let targets = [TARGET, Vector3::new(-0.1, 0.05, 0.05), Vector3::new(0.0, -0.1, 0.15)];
    let mut set = MeasurementSet { observations: Vec::new(), ..plain.clone() };
    set.targets = (1..=3).map(|k| Target { name: format!("T{k}"), ..plain.targets[0].clone() }).collect();
    for observation in &plain.observations {
        let there: Vec<f64> = observation.command.iter().map(|q| q + joints.sample(&mut rng)).collect();
        for (target, in_flange) in targets.iter().enumerate() {
            let position = target_in_base(&machine, &there, in_flange).expect("a pose");
            let position = position + Vector3::from_fn(|_, _| noise.sample(&mut rng));
            let reading = Reading::Cartesian { position, covariance: None };
            set.observations.push(Observation {
                target,
                reading,
                time: f64::from(observation.pose),
                ..observation.clone()
            });
        }
    }
    (truth, set)
}

/// An error of a pose is common to its targets: taken for three, sigmas would be 1.3 to 2.3 times too small.
#[test]
fn targets_of_one_pose_share_its_error() {
    let trials = if std::env::var_os("CALIBRIG_FULL").is_some() { 500 } else { 100 };
    let [model, _] = robots();
    let options = IdentificationOptions::default();
    let ids = links(&identify(&model, &three_targets(&model, &[], 0).1, &options).expect("an estimate"));
    let mut held = vec![0; ids.len()];
    let mut joints = 0.0;
    for trial in 0..trials {
        let (truth, set) = three_targets(&model, &ids, trial);
        let estimate = identify(&model, &set, &options).expect("an estimate");
        let factor = estimate.interval_factor(0.95);
        for ((held, id), truth) in held.iter_mut().zip(&ids).zip(&truth) {
            let parameter = estimate.parameters.iter().find(|p| p.id == *id).expect("identified");
            *held +=
                u64::from((parameter.value - truth).abs() <= factor * parameter.sigma.expect("full rank"));
        }
        let found = estimate.found_machine().expect("readings of a pose depend on each other");
        joints += found.actuators.iter().map(|sigma| sigma * sigma).sum::<f64>() / 6.0 / f64::from(trials);
        if trial == 0 {
            let mut sorted = set.clone();
            sorted.observations.sort_by_key(|observation| observation.target);
            let again = identify(&model, &sorted, &options).expect("an estimate");
            for (a, b) in estimate.parameters.iter().zip(&again.parameters) {
                // The order of rows is the order of sums, and of when the variances are found to stand still.
                assert!((a.value - b.value).abs() <= 1e-2 * a.sigma.expect("full rank"), "{}", a.id);
            }
        }
    }
    println!("joints {:.3} mrad; held {held:?} of {trials}", 1e3 * joints.sqrt());
    assert!((joints.sqrt() / 0.2e-3 - 1.0).abs() < 0.1, "{joints}");
    let level = 1e-3 / held.len() as f64;
    let failed: Vec<_> =
        held.iter().zip(&ids).filter(|(hits, _)| p_value(**hits, u64::from(trials), 0.95) < level).collect();
    assert!(failed.is_empty(), "{failed:?}");
}

/// As many coordinates as parameters: nothing tells the noise, which is said, and what is predicted is as unsure as it is.
#[test]
fn without_a_degree_of_freedom_that_is_said_and_intervals_still_hold() {
    let [model, _] = robots();
    let options = IdentificationOptions::default();
    let ids = links(&identify(&model, &session(&model, &[], 60, 0).1, &options).expect("an estimate"));
    let (mut held, mut all) = (0_u32, 0_u32);
    for trial in 0..20 {
        let (_, set) = session(&model, &ids, 49, trial);
        let fitted = MeasurementSet { observations: set.observations[..9].to_vec(), ..set.clone() };
        let estimate = identify(&model, &fitted, &options).expect("an estimate");
        assert!(3 * fitted.observations.len() == estimate.parameters.len());
        let told =
            estimate.warnings.iter().any(|w| w.to_string().starts_with("no degrees of freedom remain"));
        assert!(told, "{:?}", estimate.warnings);
        let factor = estimate.interval_factor(0.95);
        let held_out = MeasurementSet { observations: set.observations[9..].to_vec(), ..set };
        let predicted =
            predict_readings(&model, &held_out, &options, &estimate).expect("poses").expect("a covariance");
        for reading in predicted {
            let variance = (reading.of_parameters + reading.of_machine).diagonal();
            held += u32::from(reading.error.iter().zip(&variance).all(|(e, v)| e.abs() <= factor * v.sqrt()));
            all += 1;
        }
    }
    // An upper bound of the noise makes intervals that are too wide, never too narrow.
    assert!(held * 100 >= all * 95, "{held} of {all}");
}

/// Of a pose whose readings state their noise beside others that do not, each keeps what it has.
#[test]
fn readings_that_state_their_noise_keep_it_beside_others() {
    let [model, _] = robots();
    let options = IdentificationOptions::default();
    let (_, set) = session(&model, &[], 60, 3);
    let mut mixed = set.clone().with_sigma(NOISE);
    for observation in mixed.observations.iter_mut().skip(30) {
        let position = observation.reading.position();
        // Twenty times as noisy, and nothing said of it.
        let odd = f64::from(observation.pose);
        let off = Vector3::new((3.1 * odd).sin(), (4.7 * odd).sin(), (5.9 * odd).sin())
            * 20.0
            * NOISE
            * 2.0_f64.sqrt();
        observation.reading = Reading::Cartesian { position: position + off, covariance: None };
    }
    let estimate = identify(&model, &mixed, &options).expect("an estimate");
    let NoiseScale::Residuals(sigma) = estimate.noise else { panic!("{:?}", estimate.noise) };
    // 60 poses leave 153 coordinates; the sines have a standard deviation of one over the root of two.
    assert!((sigma / (20.0 * NOISE) - 1.0).abs() < 0.3, "{sigma}");
    let stated = MeasurementSet { observations: mixed.observations[..30].to_vec(), ..mixed.clone() };
    let alone = identify(&model, &stated, &options).expect("an estimate");
    for (both, one) in estimate.parameters.iter().zip(&alone.parameters) {
        let (both, one) = (both.sigma.expect("full rank"), one.sigma.expect("full rank"));
        assert!(both <= 1.3 * one, "{both} {one}");
    }
}
