//! The matched model: exact data give exact parameters, noisy data give errors as large as stated.

use calibrig::identification::{FrameChoice, IdentificationOptions, Mode, TargetChoice, Warning, identify};
use calibrig::model::ParameterId;
use calibrig::pipeline::{PlantKind, simulate, without_drift};
use calibrig::plant::effects::{
    Ambient, Backlash, Effects, Encoder, Friction, GrowingPart, Growth, Harmonic, Harmonics, Rail,
    RailProfile, Ratio, Repeatability, Thermal,
};
use calibrig::scenario::Scenario;

use crate::a_user_reproduces_the_paper::{paper, rigid_paper};

/// Nothing in the machine that the model does not contain.
fn matched() -> Scenario {
    let mut scenario = rigid_paper();
    scenario.options.mode = Mode::OnlyCalibration;
    scenario.options.unmodelled_sigma = 0.0;
    scenario.verification_poses = 0;
    scenario
}

fn truth(scenario: &Scenario, id: ParameterId) -> Option<f64> {
    match id {
        ParameterId::Link { link, term } => Some(
            scenario.as_built.kinematics.links[link].term(term)
                - scenario.robot.model.kinematics.links[link].term(term),
        ),
        _ => None,
    }
}

#[test]
fn exact_measurements_give_the_24_parameters() {
    let mut scenario = matched();
    scenario.tracker.instrument.noise = false;
    let options = IdentificationOptions {
        frame: FrameChoice::Fixed,
        target: TargetChoice::Fixed,
        ..scenario.options.clone()
    };
    let simulation =
        simulate(&scenario, scenario.seed, 0, PlantKind::Rapier, |_, _| {}).expect("a simulation");
    let estimate =
        identify(&scenario.robot.model, &simulation.sets[0].measurements, &options).expect("an estimate");
    assert!(estimate.is_sound());
    assert_eq!(estimate.parameters.len(), 24);
    let worst = estimate
        .parameters
        .iter()
        .map(|p| (p.value - truth(&scenario, p.id).expect("a link parameter")).abs())
        .fold(0.0, f64::max);
    println!("largest error of the 24: {worst:.2e} m or rad");
    assert!(worst <= 1e-9, "{worst}");
}

/// Chi-square and coverage over 1000 sessions in which the nests, the target and every reading are drawn anew.
#[test]
fn noise_gives_the_stated_chi_square_and_coverage() {
    let scenario = matched();
    let trials = 1000;
    let (mut chi2, mut dof, mut doubted) = (0.0, 0.0, 0);
    let mut covered = [0_u32; 24];
    for trial in 0..trials {
        let simulation =
            simulate(&scenario, 2024, trial, PlantKind::Rapier, |_, _| {}).expect("a simulation");
        let estimate = identify(&scenario.robot.model, &simulation.sets[0].measurements, &scenario.options)
            .expect("an estimate");
        doubted += u32::from(!estimate.is_sound());
        chi2 += estimate.chi2;
        dof += estimate.degrees_of_freedom;
        for (hits, parameter) in covered.iter_mut().zip(&estimate.parameters) {
            let truth = truth(&scenario, parameter.id).expect("the links come first");
            let sigma = parameter.sigma.expect("full rank");
            *hits += u32::from((parameter.value - truth).abs() <= 1.959_964 * sigma);
        }
    }
    // What was stated is doubted at a level of 0.1 %: 1 of 1000 is expected, 6 and more come once in 1700 such tests.
    println!("{doubted} of {trials} doubted");
    assert!(doubted <= 5, "{doubted}");
    let per_dof = chi2 / dof;
    // The sum of all trials is chi-square with `dof` degrees of freedom, which is normal for so many: 99.9 % band.
    let band = 3.291 * (2.0_f64 / dof).sqrt();
    println!("pooled chi-square per degree of freedom {per_dof:.4}, band 1 +- {band:.4}");
    assert!((per_dof - 1.0).abs() <= band, "{per_dof} +- {band}");
    let coverage: Vec<_> = covered.iter().map(|hits| f64::from(*hits) / f64::from(trials)).collect();
    let (low, high) = coverage.iter().fold((1.0_f64, 0.0_f64), |(l, h), c| (l.min(*c), h.max(*c)));
    println!("coverage of the 95 % intervals of the 24 parameters: {low:.3} to {high:.3}");
    // Binomial(1000, 0.95), family of 24: 0.920 and 0.976 are exceeded by chance about once in a thousand families.
    assert!(low >= 0.920 && high <= 0.976, "{coverage:?}");
}

/// Every effect that is more than three times the tracker's sigma must be found out, in a machine that is otherwise as the model.
#[test]
fn every_effect_that_the_model_lacks_fails_the_consistency_test() {
    const SECONDS: f64 = std::f64::consts::PI / 648_000.0;
    let doubted_in = |scenario: &Scenario, effects: Effects| {
        let mut scenario = scenario.clone();
        scenario.as_built.effects = effects;
        let simulation =
            simulate(&scenario, scenario.seed, 0, PlantKind::Rapier, |_, _| {}).expect("a simulation");
        let model = &scenario.robot.model;
        let steady = without_drift(simulation.sets).expect("sound nests");
        let measured = &steady.sets[0].measurements;
        let estimate = identify(model, measured, &scenario.options).expect("an estimate");
        estimate.warnings.iter().any(|w| matches!(w, Warning::Inconsistent { .. }))
    };
    let rigid = matched();
    let doubted = |effects| doubted_in(&rigid, effects);
    assert!(!doubted(Effects::default()), "a machine as the model");

    let at =
        |joint: usize, value: f64| (0..7).map(|j| if j == joint { value } else { 0.0 }).collect::<Vec<_>>();
    let none = Effects::default;
    // At 3 m the tracker's sigma is 4 um across the line of sight; 10 arcsec at the shoulder are 0.1 mm at the target.
    let wave = RailProfile { polynomial: Vec::new(), wave: 50e-6, phase: 0.3 };
    let straight = RailProfile::default;
    let rail = Rail {
        joint: 0,
        range: [0.0, 4.0],
        wavelength: 0.71,
        vertical: nalgebra::Vector3::y(),
        horizontal_error: straight(),
        vertical_error: wave,
        roll: straight(),
        pitch: straight(),
        yaw: straight(),
    };
    let harmonic = Harmonic { turns: 25.0, amplitude: [10.0 * SECONDS, 0.0], phase: [0.5, 0.0] };
    let arm = GrowingPart::Link { joint: 2, axis: 0 };
    let arm =
        Growth { part: arm, length: 1.35, with_travel: false, expansion: 12e-6, lag: 300.0, heat: None };
    let air = Ambient { start: 20.0, drift: 0.0, swing: 5.0, period: 400.0, phase: 0.0 };
    let mut actuators = vec![None; 7];
    actuators[2] = Some(harmonic);
    for (name, effects) in [
        ("harmonics", Effects { harmonics: Some(Harmonics { actuators }), ..none() }),
        ("ratio", Effects { ratio: Some(Ratio { relative: at(1, 1e-3) }), ..none() }),
        ("rail", Effects { rail: Some(rail), ..none() }),
        ("backlash", Effects { backlash: Some(Backlash { gap: at(2, 20.0 * SECONDS) }), ..none() }),
        (
            "encoder",
            Effects { encoder: Some(Encoder { step: at(2, 30.0 * SECONDS), offset: at(0, 0.0) }), ..none() },
        ),
        (
            "thermal",
            Effects {
                thermal: Some(Thermal { ambient: air, reference: 20.0, growths: vec![arm] }),
                ..none()
            },
        ),
        (
            "repeatability",
            Effects { repeatability: Some(Repeatability { sigma: at(2, 10.0 * SECONDS) }), ..none() },
        ),
    ] {
        assert!(doubted(effects), "{name}");
    }

    // Friction leaves something in elastic drives alone: the whole machine, as the model that closes its linkage and bends.
    let mut elastic = Scenario { verification_poses: 0, ..paper() };
    let nominal = &elastic.robot.model;
    elastic.as_built.kinematics = rigid.as_built.kinematics.clone();
    elastic.as_built.statics = nominal.statics.clone().expect("the shipped robot's statics");
    elastic.as_built.actuators = nominal.actuators.clone();
    elastic.options.mode = Mode::ElastoGeometric;
    elastic.options.unmodelled_sigma = 0.0;
    assert!(!doubted_in(&elastic, Effects::default()), "an elastic machine as the model");
    let friction = Friction { constant: at(2, 60.0), per_load: at(2, 0.01), presliding: at(2, 0.05) };
    assert!(doubted_in(&elastic, Effects { friction: Some(friction), ..none() }), "friction");
}
