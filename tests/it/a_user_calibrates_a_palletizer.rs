//! A palletizer whose loop is off in every axis and length: what the four-bar's own parameters are for.

use std::path::Path;

use calibrig::evaluation::accuracy;
use calibrig::identification::{
    ComplianceChoice, FrameChoice, IdentificationOptions, InstrumentChoice, LINKAGE, Mode, ParameterChoice,
    Predictor, TargetChoice, identify,
};
use calibrig::measurement::{MeasurementSet, Reading};
use calibrig::model::random::{StreamSource, stream};
use calibrig::model::{LinkTerm, LinkageTerm};
use calibrig::pipeline::{PlantKind, simulate};
use calibrig::scenario::{Scenario, load_scenario};
use nalgebra::{Matrix3, Vector3};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

/// By how much every length is off, m, and every axis that is a metre long at its ends, rad.
const OFF: f64 = 1e-4;
/// Of each coordinate of a reading, m.
const NOISE: f64 = 20e-6;
const TRIALS: u64 = 20;

/// The palletizer of the zoo, each parameter of the rows of shoulder and elbow and each of the four-bar off by plus or minus 0.1 mm or
/// 0.1 mrad. Its springs are those of the file.
fn palletizer(seed: u64) -> Scenario {
    let mut scenario = load_scenario(Path::new("scenarios/zoo/irb460.toml")).expect("a scenario of the zoo");
    scenario.drawn = None;
    scenario.identification_poses = 60;
    scenario.verification_poses = 40;
    scenario.tracker.instrument.noise = false;
    let mut rng = stream(seed, 0, StreamSource::AsBuilt);
    let mut off = || if rng.random::<bool>() { OFF } else { -OFF };
    for link in &mut scenario.as_built.kinematics.links[1..3] {
        for term in LinkTerm::ALL {
            *link.term_mut(term) += off();
        }
    }
    let linkage = scenario.as_built.linkage_mut().expect("a four-bar");
    for term in LinkageTerm::ALL {
        *linkage.term_mut(term) += off();
    }
    scenario
}

/// The same poses with readings of white noise.
fn noisy(set: &MeasurementSet, rng: &mut impl Rng) -> MeasurementSet {
    let mut set = set.clone();
    for observation in &mut set.observations {
        let noise = NOISE * Vector3::from_fn(|_, _| -> f64 { StandardNormal.sample(rng) });
        observation.reading = Reading::Cartesian {
            position: observation.reading.position() + noise,
            covariance: Some(Matrix3::from_diagonal_element(NOISE * NOISE)),
        };
    }
    set
}

/// Held-out RMS of 40 poses by a fit to 60, with and without the loop's parameters, against that of the noise. One machine after another, each
/// with its own signs; the bound is on their mean square.
#[test]
fn the_loops_own_parameters_leave_the_noise() {
    let (mut with, mut without) = (0.0, 0.0);
    let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
    for seed in 1..=TRIALS {
        let scenario = palletizer(seed);
        let session = simulate(&scenario, seed, 0, PlantKind::Rapier, |_, _| {}).expect("a session");
        let mut rng = stream(seed, 0, StreamSource::IdentificationNoise);
        let [fitted, held_out] = [0, 1].map(|set: usize| noisy(&session.sets[set].measurements, &mut rng));
        let rms = |terms: Vec<String>| {
            let options = IdentificationOptions {
                mode: Mode::Extended,
                parameters: ParameterChoice::Complete,
                compliances: ComplianceChoice::Listed(Vec::new()),
                instrument: InstrumentChoice::Ignored,
                frame: FrameChoice::Fixed,
                target: TargetChoice::Fixed,
                terms: Some(terms),
                ..scenario.options.clone()
            };
            let estimate = identify(&scenario.robot.model, &fitted, &options).expect("an estimate");
            let errors = Predictor::new(&estimate.robot).expect("a robot").errors(&held_out);
            accuracy(&errors.expect("poses of the robot")).expect("poses").rms_3d
        };
        let (own, lacking) = (rms(vec![LINKAGE.to_owned()]), rms(Vec::new()));
        println!(
            "machine {seed}: {:.1} um with the loop's parameters, {:.1} um without",
            1e6 * own,
            1e6 * lacking
        );
        with += own * own / TRIALS as f64;
        without += lacking * lacking / TRIALS as f64;
        (least, most) = (least.min(lacking), most.max(lacking));
    }
    let floor = NOISE * 3.0_f64.sqrt();
    let ratios = [with, without].map(|square: f64| square.sqrt() / floor);
    println!(
        "held-out RMS over the noise's {:.1} um: {:.3} with the loop's parameters, {:.2} without ({:.0} to {:.0} um)",
        1e6 * floor,
        ratios[0],
        ratios[1],
        1e6 * least,
        1e6 * most
    );
    assert!(ratios[0] <= 1.15, "{ratios:?}");
    assert!(ratios[1] > 1.3, "{ratios:?}: without them something is left");
}
