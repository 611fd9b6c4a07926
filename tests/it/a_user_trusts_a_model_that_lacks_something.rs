//! The whole simulated machine, which no model contains: intervals of the robot's mean position hold, and knowing the tracker's noise does no harm.

use calibrig::evaluation::accuracy;
use calibrig::identification::{IdentificationOptions, Mode, Predictor, identify};
use calibrig::measurement::{MeasurementSet, Reading};
use calibrig::montecarlo::{Campaign, summarise_trials};
use calibrig::pipeline::{PlantKind, simulate};
use calibrig::statistics::student_t_quantile;

use crate::a_user_reproduces_the_paper::paper;
use crate::repeated;

/// `calibrig montecarlo scenarios/paper.toml --trials 200` prints the same.
#[test]
fn true_positions_lie_in_their_intervals_in_every_model() {
    let trials = repeated(200, 16);
    let scenario = paper();
    let campaign = Campaign::of_draws(&scenario, scenario.seed, PlantKind::Rapier);
    let done = campaign.trials(0..trials).expect("threads");
    let summary = summarise_trials(&campaign, &done).expect("a table");
    assert!(summary.failed == 0);
    for mode in summary.modes().iter().filter(|mode| mode.mode != Mode::WithoutCalibration) {
        let predictions = mode.predictions.expect("held-out poses");
        let (held, half) = (predictions.coverage.fraction(), predictions.half_width.expect("trials"));
        println!(
            "{}: {:.2} % +- {:.2} of the true coordinates in their 95 % intervals",
            mode.mode.title(),
            1e2 * held,
            1e2 * half
        );
        // Of so few trials the share itself is known to its own interval (99.9 %) only.
        let loose = if trials < 200 { half } else { 0.0 };
        assert!((0.92 - loose..=0.98 + loose).contains(&held), "{}: {held}", mode.mode.title());
    }
}

/// Readings whose noise is stated as the tracker has it weigh the data no worse than equal weights do, row by row.
#[test]
fn the_trackers_own_noise_does_no_harm() {
    let trials = repeated(20, 8);
    let scenario = paper();
    let modes: Vec<Mode> =
        scenario.modes.iter().copied().filter(|mode| *mode != Mode::WithoutCalibration).collect();
    let mut differences = vec![Vec::new(); modes.len()];
    for trial in 0..trials {
        let simulation =
            simulate(&scenario, scenario.seed, trial, PlantKind::Rapier, |_, _| {}).expect("a session");
        let [fitted, held_out] = simulation.sets.as_slice() else { panic!("two sets") };
        for (mode, differences) in modes.iter().zip(&mut differences) {
            let options = IdentificationOptions { mode: *mode, ..scenario.options.clone() };
            let rms = |set: &MeasurementSet| {
                let estimate = identify(&scenario.robot.model, set, &options).expect("an estimate");
                let errors = Predictor::new(&estimate.robot)
                    .and_then(|mut predictor| predictor.errors(&held_out.measurements))
                    .expect("poses of the robot");
                accuracy(&errors).expect("poses").rms_3d
            };
            differences.push(rms(&fitted.measurements) - rms(&without_covariances(&fitted.measurements)));
        }
    }
    for (mode, differences) in modes.iter().zip(&differences) {
        let n = differences.len() as f64;
        let mean = differences.iter().sum::<f64>() / n;
        let variance = differences.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0);
        let half = student_t_quantile(0.975, n - 1.0) * (variance / n).sqrt();
        println!(
            "{}: held-out RMS with the tracker's noise less that with equal weights: {:.4} +- {:.4} mm",
            mode.title(),
            1e3 * mean,
            1e3 * half
        );
        assert!(mean - half <= 0.0, "{}: {mean} +- {half}", mode.title());
    }
}

fn without_covariances(set: &MeasurementSet) -> MeasurementSet {
    let mut set = set.clone();
    for observation in &mut set.observations {
        let position = observation.reading.position();
        observation.reading = Reading::Cartesian { position, covariance: None };
    }
    set
}
