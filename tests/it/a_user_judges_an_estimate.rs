//! What the residuals still contain, which poses an estimate rests on, and which of two models pays.

use std::f64::consts::PI;

use calibrig::evaluation::{Cause, Verdict, leave_one_out};
use calibrig::identification::{
    IdentificationOptions, Mode, ParameterChoice, Predictor, TermPrior, identify,
};
use calibrig::pipeline::{self, Judgement, Outcome, PlantKind, calibrate, choose, judge, simulate};
use calibrig::plant::effects::{Backlash, Effects, Harmonic, Harmonics};
use calibrig::report::{Style, html_report, json_report, render_tables};
use calibrig::scenario::Scenario;
use calibrig::validation::held_out_errors;
use calibrig_model::{FAMILIES, ParameterId};

use crate::a_user_reproduces_the_paper::{paper, rigid_paper};

const SHOULDER: usize = 2;
const ARCSEC: f64 = PI / 648_000.0;

/// A rigid machine as the model, but for `effects`.
fn rigid(effects: Effects) -> Scenario {
    let mut scenario = rigid_paper();
    scenario.as_built.effects = effects;
    scenario.options.unmodelled_sigma = 0.0;
    scenario.modes = vec![Mode::WithoutCalibration, Mode::OnlyCalibration];
    scenario
}

/// Once a turn of the shoulder's motor; 10 arcsec are 0.1 mm at the target, where the tracker's sigma is about 5 um.
fn harmonics(scenario: &Scenario) -> Effects {
    let turns = scenario.robot.model.motor_turns[SHOULDER].expect("the shipped robot's gears");
    let mut actuators = vec![None; 7];
    actuators[SHOULDER] = Some(Harmonic { turns, amplitude: [10.0 * ARCSEC, 0.0], phase: [0.5, 0.0] });
    Effects { harmonics: Some(Harmonics { actuators }), ..Effects::default() }
}

fn backlash(gap: f64) -> Effects {
    let gap = (0..7).map(|joint| if joint == SHOULDER { gap } else { 0.0 }).collect();
    Effects { backlash: Some(Backlash { gap }), ..Effects::default() }
}

fn run(scenario: &Scenario) -> Outcome {
    pipeline::run(scenario, scenario.seed, |_, _| {}).expect("a run")
}

fn causes(judgement: &Judgement) -> Vec<Cause> {
    let shape = judgement.consistency.shape.as_ref().expect("degrees of freedom");
    shape.patterns.iter().map(|pattern| pattern.cause).collect()
}

/// Neither size nor shape, the likeness of one residual to the next included.
#[test]
fn a_machine_as_the_model_is_not_doubted() {
    let outcome = run(&rigid(Effects::default()));
    let [judgement] = outcome.judgements.as_slice() else { panic!("one mode has an estimate") };
    assert!(judgement.consistency.is_consistent(), "{}", judgement.consistency);
    assert!(causes(judgement).is_empty());
    let confidence = judgement.confidence.as_ref().expect("full rank");
    assert_eq!(confidence.support.len(), outcome.modes[1].estimate.as_ref().expect("one").parameters.len());
    // Leverages add up to the parameters that the data determine.
    let sum: f64 = confidence.influences.iter().map(|i| i.leverage).sum();
    assert!((sum - confidence.effective_parameters).abs() < 1e-6, "{sum}");
    assert_eq!(confidence.map.len() + confidence.out_of_reach, 400);
    let text = render_tables(&outcome, Style::Plain);
    assert!(text.contains("the residual has no pattern"), "{text}");
}

/// The truth is known: predicted positions are off by as much as they say, over the held-out poses of 20 sessions.
#[test]
fn predicted_positions_are_as_sure_as_they_say() {
    let scenario = rigid(Effects::default());
    let (mut sum, mut count) = (0.0, 0);
    for trial in 0..20 {
        let simulation = simulate(&scenario, 77, trial, PlantKind::Rapier, |_, _| {}).expect("a simulation");
        let model = &scenario.robot.model;
        let (_, modes) =
            calibrate(model, &simulation.sets, &scenario.modes, &scenario.options).expect("modes");
        let judged = judge(model, &simulation.sets, &modes, &scenario.options).expect("judgements");
        let predicted = &judged[0].confidence.as_ref().expect("full rank").at_poses[1];
        for (place, settled) in predicted.iter().zip(&simulation.truth.poses[1]) {
            let place = place.expect("a pose of the robot");
            sum += (place.position - settled.target).component_div(&place.sigma).norm_squared() / 3.0;
            count += 1;
        }
    }
    // Poses of one session share its estimate, so that 20 sessions count, each with at least the three coordinates of one place: chi-square
    // of 60 over 60 is within 0.5 and 1.7 but once in a thousand times.
    let mean = sum / f64::from(count);
    assert!((0.5..1.7).contains(&mean), "{mean}");
}

#[test]
fn what_the_model_lacks_is_named() {
    let plain = rigid(Effects::default());
    for (effects, cause) in [
        (harmonics(&plain), Cause::MotorTurn(SHOULDER)),
        (backlash(20.0 * ARCSEC), Cause::Approach(SHOULDER)),
    ] {
        let outcome = run(&rigid(effects));
        let judgement = &outcome.judgements[0];
        assert!(!judgement.consistency.is_consistent());
        assert_eq!(causes(judgement).first(), Some(&cause), "{}", judgement.consistency);

        let words = cause
            .describe(&outcome.model.kinematics.links.iter().map(|l| l.name.clone()).collect::<Vec<_>>());
        let text = render_tables(&outcome, Style::Plain);
        assert!(text.lines().all(|line| line.chars().count() <= 100), "{text}");
        let text = text.replace("\n           ", " ");
        assert!(text.contains(&format!("warning: the residual {words}")), "{text}");
        let page = html_report(&outcome).expect("a page");
        for part in ["id=\"residual\"", "id=\"sure\"", "No parameter of the robot has a prior", &words] {
            assert!(page.contains(part), "{part}");
        }
        let json = json_report(&outcome);
        let judged = json.estimates["only_calibration"].judgement.as_ref().expect("a judgement");
        assert!(!judged.consistent);
        assert_eq!(judged.patterns[0].cause, cause.key());
        let confidence = judged.confidence.as_ref().expect("full rank");
        assert_eq!(confidence.predicted_sigma_m["verification"].len(), json.sets["verification"].poses);
    }
}

/// To first order in the noise, which is a millionth of the robot.
#[test]
fn errors_of_left_out_poses_are_those_of_refits() {
    let mut scenario = rigid(Effects::default());
    scenario.identification_poses = 20;
    scenario.verification_poses = 0;
    let simulation =
        simulate(&scenario, scenario.seed, 0, PlantKind::Rapier, |_, _| {}).expect("a simulation");
    let model = &scenario.robot.model;
    let (_, modes) = calibrate(model, &simulation.sets, &scenario.modes, &scenario.options).expect("modes");
    let judged = judge(model, &simulation.sets, &modes, &scenario.options).expect("judgements");
    let left_out = &judged[0].confidence.as_ref().expect("full rank").left_out;

    let options = IdentificationOptions { mode: Mode::OnlyCalibration, ..scenario.options.clone() };
    let set = &simulation.sets[0].measurements;
    let refitted = held_out_errors(set, &leave_one_out(20), |fitted, held_out| {
        let estimate = identify(model, fitted, &options).map_err(|e| e.to_string())?;
        let predictor = Predictor::new(&estimate.robot);
        predictor.and_then(|mut predictor| predictor.errors(held_out)).map_err(|e| e.to_string())
    })
    .expect("refits");
    for (pose, (linear, exact)) in left_out.iter().zip(refitted.iter().flatten()).enumerate() {
        let linear = linear.expect("other poses determine every direction");
        assert!((linear - exact).norm() <= 1e-2 * exact.norm() + 1e-8, "{pose}: {linear} {exact}");
    }
}

/// An elastic machine as the model, but that its shoulder lags behind by a minute of arc: the approach direction is worth a term, the
/// motor's turn is not.
#[test]
fn a_term_pays_where_the_machine_has_what_it_describes() {
    let mut scenario = paper();
    let nominal = &scenario.robot.model;
    scenario.as_built.statics = nominal.statics.clone().expect("the shipped robot's statics");
    scenario.as_built.actuators = nominal.actuators.clone();
    scenario.as_built.effects = backlash(60.0 * ARCSEC);
    // What the published 24 leave of the links would hide so small a backlash.
    scenario.options.parameters = ParameterChoice::Complete;
    scenario.verification_poses = 0;
    let simulation =
        simulate(&scenario, scenario.seed, 0, PlantKind::Rapier, |_, _| {}).expect("a simulation");
    let measured = &simulation.sets[0].measurements;
    let mut named = Vec::new();
    let choice = choose(&scenario.robot.model, measured, &scenario.options, 6, 1, |_, _, name| {
        named.push(name.to_owned());
    })
    .expect("a choice");
    assert!(choice.failures.is_empty() && choice.rows.len() == named.len());
    for row in &choice.rows {
        println!("{:<20} {:?} {:?}", row.key, row.row.verdict, row.row.gain);
    }
    let verdict = |key: &str| choice.rows.iter().find(|row| row.key == key).expect(key).row.verdict;
    assert_eq!(verdict("geometry"), Verdict::Reference);
    assert_eq!(verdict("gravity"), Verdict::Pays);
    assert_eq!(verdict("hysteresis"), Verdict::Pays);
    assert!(matches!(verdict("harmonic"), Verdict::DoesNotPay | Verdict::Hurts), "{:?}", verdict("harmonic"));
}

/// A machine without any of the effects that the extended model has terms for: with priors that know this they do no harm; with priors that
/// let them be anything they follow the noise, which poses that were not fitted show.
#[test]
fn terms_that_make_other_poses_worse_are_named() {
    let mut scenario = rigid(Effects::default());
    scenario.modes = vec![Mode::WithoutCalibration, Mode::Extended];
    scenario.robot.model.statics = None;
    let mut with_priors_of = |sigma| {
        let families = FAMILIES.iter().map(|family| family.key().to_owned());
        let prior = |family| TermPrior { family, length: Some(sigma), angle: Some(sigma) };
        scenario.options.term_priors = families.map(prior).collect();
        run(&scenario)
    };
    let sound = with_priors_of(1e-8);
    assert!(sound.judgements[0].worse.is_empty(), "{:?}", sound.judgements[0].worse);
    let outcome = with_priors_of(1.0);
    let [judgement] = outcome.judgements.as_slice() else { panic!("one mode has an estimate") };
    assert!(judgement.worse.iter().any(|worse| worse.is_doubtful), "{:?}", judgement.worse);
    for worse in &judgement.worse {
        assert!(worse.parameters.iter().all(|id| matches!(id, ParameterId::Term(_))), "{worse}");
        assert!(worse.gain.low <= worse.gain.value && worse.gain.high < 0.0, "{worse}");
    }
    let text = render_tables(&outcome, Style::Plain);
    assert!(text.contains("makes predictions of poses that were not fitted worse"), "{text}");
    let json = serde_json::to_value(json_report(&outcome)).expect("a document");
    let named = &json["estimates"]["extended"]["worse"][0];
    assert!(named["names"].is_array() && named["gain_m"].as_f64() < Some(0.0), "{json:#}");
}
