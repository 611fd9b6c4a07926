//! Smooth errors of drives and hysteresis that builds up: chosen where held-out poses show them, and not where they do not. The machines here err by
//! laws of their own, which no family of terms contains.

use calibrig::pipeline::{ModelChoice, choose};
use calibrig_estimation::evaluation::Verdict;
use calibrig_estimation::identification::{IdentificationOptions, ParameterChoice};
use calibrig_estimation::kinematics::target_in_base;
use calibrig_model::measurement::{MeasurementSet, Motion};
use calibrig_model::nalgebra::Vector3;
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::statistics::binomial_cdf;
use calibrig_model::{CalibrationModel, CraigLink, LinkTerm, ParameterId};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

const NOISE: f64 = 20e-6;
const TARGET: Vector3<f64> = Vector3::new(0.05, 0.08, 0.12);
/// Shoulder and elbow err.
const ERRING: [usize; 2] = [1, 2];

fn arm() -> CalibrationModel {
    let turn = std::f64::consts::FRAC_PI_2;
    let rows = [
        [0.0, 0.0, 0.4],
        [0.05, -turn, 0.0],
        [0.5, 0.0, 0.0],
        [0.04, -turn, 0.6],
        [0.0, turn, 0.0],
        [0.0, -turn, 0.1],
    ];
    let link = |(i, [a, alpha, d]): (usize, [f64; 3])| {
        CraigLink::revolute(format!("j{}", i + 1)).row(a, alpha, d, 0.0).limits(-2.8, 2.8)
    };
    CalibrationModel::new(rows.into_iter().enumerate().map(link).collect()).expect("a robot")
}

/// What a machine does beside its geometry, rad.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Law {
    None,
    /// A bump where a bearing's seat is dented: 0.3 mrad, half a radian wide.
    Bump,
    /// Play of a drive that winds up: it follows within a band of 8 degrees, and stays behind by up to 0.3 mrad (a Prandtl element).
    WindUp,
}

const BAND: f64 = 0.14;

/// A path of steps most of which are small, as over a grid of poses.
fn session(law: Law, poses: usize, trial: u32) -> MeasurementSet {
    let mut rng = stream(31, trial, StreamSource::IdentificationNoise);
    let model = arm();
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
            for joint in ERRING {
                followed[joint] = followed[joint].clamp(command[joint] - BAND, command[joint] + BAND);
                there[joint] += match law {
                    Law::None => 0.0,
                    Law::Bump => 3e-4 * (-((command[joint] - 0.3) / 0.5).powi(2)).exp(),
                    Law::WindUp => 3e-4 * (followed[joint] - command[joint]) / BAND,
                };
            }
            let noise = Vector3::from_fn(|_, _| {
                let unit: f64 = StandardNormal.sample(&mut rng);
                NOISE * unit
            });
            (command.to_vec(), target_in_base(&machine, &there, &TARGET).expect("a pose") + noise)
        })
        .collect();
    let mut set = MeasurementSet::of_points(points).with_sigma(NOISE);
    for (observation, (approach, since)) in set.observations.iter_mut().zip(told) {
        (observation.approach, observation.since_reversal) = (approach, since);
    }
    set
}

fn chosen(law: Law, trial: u32) -> ModelChoice {
    let options =
        IdentificationOptions { parameters: ParameterChoice::Complete, ..IdentificationOptions::default() };
    let choice = choose(&arm(), &session(law, 120, trial), &options, 6, 1, |_, _, _| {}).expect("a choice");
    println!("{law:?}, trial {trial}");
    for row in &choice.rows {
        println!("  {:<12} {:?} {:?} {:?}", row.key, row.row.held_out_rms, row.row.verdict, row.row.gain);
    }
    assert!(choice.failures.is_empty(), "{:?}", choice.failures);
    choice
}

fn pays(choice: &ModelChoice, key: &str) -> bool {
    choice.rows.iter().find(|row| row.key == key).expect(key).row.verdict == Verdict::Pays
}

#[test]
fn a_smooth_error_is_chosen_and_explains_what_it_can() {
    let choice = chosen(Law::Bump, 0);
    assert!(pays(&choice, "spline") && !pays(&choice, "presliding"));
    let rms = |key: &str| choice.rows.iter().find(|row| row.key == key).and_then(|row| row.row.held_out_rms);
    let (without, with) = (rms("geometry").expect("a number"), rms("spline").expect("a number"));
    // In three coordinates the noise alone is sqrt(3) of 20 um, and parameters cost some of it.
    assert!(without > 100e-6 && with < 1.35 * 3.0_f64.sqrt() * NOISE, "{without} {with}");
}

#[test]
fn hysteresis_that_builds_up_is_chosen_beside_its_sign() {
    let choice = chosen(Law::WindUp, 0);
    assert!(pays(&choice, "hysteresis") && pays(&choice, "presliding") && !pays(&choice, "spline"));
    let row = choice.rows.iter().find(|row| row.key == "presliding").expect("a row");
    assert_eq!(row.row.against.as_deref(), Some("+ hysteresis"));
}

/// An interval of 95 % lies above zero by chance in less than one of forty choices.
#[test]
fn neither_is_chosen_where_there_is_nothing() {
    let trials = 8;
    let count =
        |key: &str, choices: &[ModelChoice]| choices.iter().filter(|choice| pays(choice, key)).count() as u64;
    let choices: Vec<_> = (0..trials).map(|trial| chosen(Law::None, trial)).collect();
    let (spline, presliding) = (count("spline", &choices), count("presliding", &choices));
    println!("of {trials}: spline {spline}, presliding {presliding}");
    for paid in [spline, presliding] {
        assert!(paid == 0 || 1.0 - binomial_cdf(paid - 1, trials.into(), 0.025) > 1e-3, "{paid} of {trials}");
    }
}

/// Poses at random have hardly a short way, and without an order of poses no way at all: then there is nothing to compare.
#[test]
fn without_ways_since_reversals_presliding_is_not_compared() {
    let mut set = session(Law::WindUp, 60, 1);
    set.observations.iter_mut().for_each(|observation| observation.since_reversal.clear());
    let choice =
        choose(&arm(), &set, &IdentificationOptions::default(), 4, 1, |_, _, _| {}).expect("a choice");
    assert_eq!(choice.without_basis.iter().filter(|name| name.contains("presliding")).count(), 1);
    assert!(choice.rows.iter().all(|row| row.key != "presliding"));
}
