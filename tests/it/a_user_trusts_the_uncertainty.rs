//! The matched model: exact data give exact parameters, noisy data give errors as large as stated.

use calibrig::identification::{FrameChoice, IdentificationOptions, Mode, TargetChoice, identify};
use calibrig::model::ParameterId;
use calibrig::pipeline::{PlantKind, simulate};
use calibrig::scenario::Scenario;

use crate::a_user_reproduces_the_paper::paper;

/// The paper's robot with rigid drives: nothing in the machine that the model does not contain.
fn matched() -> Scenario {
    let mut scenario = paper();
    scenario.as_built.statics.drive_stiffness.fill(f64::INFINITY);
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
    let simulation = simulate(&scenario, scenario.seed, 0, PlantKind::Rapier, |_, _| {}).expect("a simulation");
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
    let (mut chi2, mut dof) = (0.0, 0);
    let mut covered = [0_u32; 24];
    for trial in 0..trials {
        let simulation = simulate(&scenario, 2024, trial, PlantKind::Rapier, |_, _| {}).expect("a simulation");
        let estimate = identify(&scenario.robot.model, &simulation.sets[0].measurements, &scenario.options)
            .expect("an estimate");
        assert!(estimate.is_sound(), "trial {trial}: {:?}", estimate.warnings);
        chi2 += estimate.chi2;
        dof += estimate.degrees_of_freedom;
        for (hits, parameter) in covered.iter_mut().zip(&estimate.parameters) {
            let truth = truth(&scenario, parameter.id).expect("the links come first");
            let sigma = parameter.sigma.expect("full rank");
            *hits += u32::from((parameter.value - truth).abs() <= 1.959_964 * sigma);
        }
    }
    let per_dof = chi2 / dof as f64;
    // The sum of all trials is chi-square with `dof` degrees of freedom, which is normal for so many: 99.9 % band.
    let band = 3.291 * (2.0 / dof as f64).sqrt();
    println!("pooled chi-square per degree of freedom {per_dof:.4}, band 1 +- {band:.4}");
    assert!((per_dof - 1.0).abs() <= band, "{per_dof} +- {band}");
    let coverage: Vec<_> = covered.iter().map(|hits| f64::from(*hits) / f64::from(trials)).collect();
    let (low, high) = coverage.iter().fold((1.0_f64, 0.0_f64), |(l, h), c| (l.min(*c), h.max(*c)));
    println!("coverage of the 95 % intervals of the 24 parameters: {low:.3} to {high:.3}");
    // Binomial(1000, 0.95), family of 24: 0.920 and 0.976 are exceeded by chance about once in a thousand families.
    assert!(low >= 0.920 && high <= 0.976, "{coverage:?}");
}
