//! What it is good for to leave redundant parameters out: the publication's validation (its section 7.2) on its own robot. All 28
//! parameters of the D-H table and `beta4` are identified, and the 24 that the rules keep; with noise and without.
//!
//! `cargo test --release --test it elimination -- --nocapture` prints the table of docs/elimination.md.

use calibrig::evaluation::accuracy;
use calibrig::identification::{
    Estimate, IdentificationOptions, Mode, ParameterChoice, Predictor, Redundancy, Tolerance, identify,
};
use calibrig::model::{ActuatorMap, LinkTerm, ParameterId};
use calibrig::pipeline::{PlantKind, Simulation, simulate};
use calibrig::scenario::Scenario;

use crate::a_user_reproduces_the_paper::rigid_paper;

const DRAWS: u32 = 10;

/// The paper's machine with the published geometric errors alone: neither springs nor four-bar nor other effects.
fn geometric() -> Scenario {
    let mut scenario = rigid_paper();
    if let ActuatorMap::Parallelogram { linkage, .. } = &mut scenario.robot.model.actuators {
        *linkage = None;
    }
    if let Some(statics) = &mut scenario.robot.model.statics {
        statics.linkage = None;
    }
    scenario.options.mode = Mode::OnlyCalibration;
    scenario.options.unmodelled_sigma = 0.0;
    scenario
}

/// a, alpha, d and theta of all seven rows, and beta of the fourth.
fn all_29() -> Vec<ParameterId> {
    let mut all = ParameterId::all_of_links(7);
    all.retain(|id| match *id {
        ParameterId::Link { link, term } => term != LinkTerm::Beta || link == 3,
        _ => false,
    });
    assert_eq!(all.len(), 29);
    all
}

struct Row {
    name: &'static str,
    links: usize,
    lacking: usize,
    condition: f64,
    iterations: f64,
    /// Largest distance of a link parameter from its truth, m or rad, in the first draw.
    error: f64,
    /// Largest standard deviation of a link parameter over the draws, m or rad.
    spread: f64,
    /// RMS of the 3-D error on the verification set, mean over the draws, m.
    verification: f64,
}

fn row(
    scenario: &Scenario,
    sessions: &[Simulation],
    name: &'static str,
    options: &IdentificationOptions,
) -> Row {
    let draws = sessions.len() as f64;
    let model = &scenario.robot.model;
    let mut estimates: Vec<Estimate> = Vec::new();
    let (mut iterations, mut verification) = (0.0, 0.0);
    for session in sessions {
        let estimate = identify(model, &session.sets[0].measurements, options).expect("an estimate");
        let errors = Predictor::new(&estimate.robot).expect("a robot").errors(&session.sets[1].measurements);
        verification += accuracy(&errors.expect("a rigid robot")).expect("poses").rms_3d / draws;
        iterations += estimate.iterations.len() as f64 / draws;
        estimates.push(estimate);
    }
    let links: Vec<ParameterId> = estimates[0].parameters.iter().map(|p| p.id).collect();
    let links: Vec<_> = links.into_iter().filter(|id| matches!(id, ParameterId::Link { .. })).collect();
    let spread = |id: &ParameterId| {
        let values: Vec<f64> = estimates.iter().map(|e| e.value(*id).expect("in every draw")).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (values.len() - 1).max(1) as f64).sqrt()
    };
    let error = |id: &ParameterId| {
        let ParameterId::Link { link, term } = *id else { return 0.0 };
        let truth =
            scenario.as_built.kinematics.links[link].term(term) - model.kinematics.links[link].term(term);
        (estimates[0].value(*id).expect("in the first draw") - truth).abs()
    };
    let spectrum = &estimates[0].spectrum;
    Row {
        name,
        links: links.len(),
        lacking: estimates[0].parameters.len() - spectrum.rank,
        condition: spectrum.condition,
        iterations,
        error: links.iter().map(error).fold(0.0, f64::max),
        spread: links.iter().map(spread).fold(0.0, f64::max),
        verification,
    }
}

fn table(scenario: &Scenario, draws: u32) -> [Row; 4] {
    let with = |parameters: ParameterChoice, redundant, tolerance| IdentificationOptions {
        parameters,
        redundant,
        tolerance,
        ..scenario.options.clone()
    };
    let session =
        |trial| simulate(scenario, scenario.seed, trial, PlantKind::Rapier, |_, _| {}).expect("a simulation");
    let sessions: Vec<_> = (0..draws).map(session).collect();
    let listed = || ParameterChoice::Listed(all_29());
    let tolerance = Some(Tolerance { length: 0.01, angle: 0.02 });
    [
        ("all 29", with(listed(), Redundancy::Keep, None)),
        ("all 29, prior of 10 mm, 20 mrad", with(listed(), Redundancy::Keep, tolerance)),
        ("all 29, redundant = \"fix\"", with(listed(), Redundancy::Fix, None)),
        ("the 24", with(ParameterChoice::NeighbourAxisRules, Redundancy::Keep, None)),
    ]
    .map(|(name, options)| row(scenario, &sessions, name, &options))
}

fn print(title: &str, rows: &[Row]) {
    println!("{title}");
    println!(
        "| parameters | links | rank lacks | condition | iterations | largest error | spread | verification |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- |");
    for r in rows {
        println!(
            "| {} | {} | {} | {:.0} | {:.1} | {:.2e} | {:.2e} | {:.3} µm |",
            r.name,
            r.links,
            r.lacking,
            r.condition,
            r.iterations,
            r.error,
            r.spread,
            1e6 * r.verification
        );
    }
}

#[test]
fn elimination_gives_a_determined_system_the_true_parameters_and_the_same_accuracy() {
    let mut scenario = geometric();
    let noisy = table(&scenario, DRAWS);
    print("with the tracker's noise", &noisy);
    scenario.tracker.instrument.noise = false;
    scenario.nest_sigma = 1e-9;
    scenario.target_covariance *= 1e-8;
    let exact = table(&scenario, 1);
    print("without noise", &exact);
    for rows in [&noisy, &exact] {
        let [all, held, fixed, kept] = rows;
        // At the nominal robot it is five: delta_d3 and delta_d4 differ where the identified axes are not quite parallel.
        assert_eq!((all.lacking, held.lacking), (4, 4));
        assert_eq!((fixed.lacking, kept.lacking), (0, 0));
        assert_eq!((fixed.links, kept.links), (24, 24), "by rank and by rule");
        assert!(all.condition.is_infinite() && kept.condition < 1e4, "{}", kept.condition);
    }
    let [all, _, _, kept] = &exact;
    assert!(kept.error < 1e-6, "exact data give the 24: {}", kept.error);
    assert!(all.error > 1e-4, "the 29 share the errors out: {}", all.error);
    // What is redundant changes no prediction.
    assert!(all.verification < 1e-6 && kept.verification < 1e-6);
    let [all, held, fixed, kept] = &noisy;
    for other in [all, held, fixed] {
        let ratio = other.verification / kept.verification;
        assert!((0.9..1.1).contains(&ratio), "{}: {ratio}", other.name);
    }
}
