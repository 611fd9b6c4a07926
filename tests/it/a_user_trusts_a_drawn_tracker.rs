//! A matched machine under a tracker that has errors of its own: with the instrument's terms, what is stated of parameters and positions holds.

use std::path::Path;

use calibrig::identification::{InstrumentChoice, Mode};
use calibrig::model::ParameterId;
use calibrig::montecarlo::{Campaign, ModeSummary, summarise_trials};
use calibrig::pipeline::{PlantKind, run};
use calibrig::scenario::{Scenario, load_scenario};
use calibrig::tracker::Preset;

use crate::repeated;
use crate::sandbox::{Ended, Sandbox};

/// `scenarios/matched.toml` with `preset = "at500"` and `systematic_fraction = 0.2` in place of the four figures.
fn matched() -> Scenario {
    let mut scenario = load_scenario(Path::new("scenarios/matched.toml")).expect("the shipped scenario");
    scenario.tracker.instrument = Preset::At500.instrument();
    assert!((scenario.tracker.instrument.systematic_fraction - 0.2).abs() < 1e-15);
    scenario.outliers = None;
    scenario
}

fn campaign_of(scenario: &Scenario, trials: u32) -> ModeSummary {
    let campaign = Campaign::of_draws(scenario, scenario.seed, PlantKind::Analytic);
    let done = campaign.trials(0..trials).expect("threads");
    let mut summary = summarise_trials(&campaign, &done).expect("a table");
    assert!(summary.failed == 0, "{:?}", summary.reasons);
    summary.groups.remove(0).modes.remove(0)
}

/// Lowest and highest coverage over the parameters that `is_one` takes, and of predicted coordinates.
fn print(name: &str, mode: &ModeSummary) {
    let range = |is_one: &dyn Fn(ParameterId) -> bool| {
        let shares = mode
            .parameters
            .iter()
            .filter(|p| is_one(p.id))
            .map(|p| (p.coverage.fraction(), p.id.to_string()));
        let mut shares: Vec<_> = shares.collect();
        shares.sort_by(|a, b| a.0.total_cmp(&b.0));
        match (shares.first(), shares.last()) {
            (Some(low), Some(high)) => {
                format!("{:.1} % ({}) to {:.1} % ({})", 1e2 * low.0, low.1, 1e2 * high.0, high.1)
            }
            _ => "none".to_owned(),
        }
    };
    let predictions = mode.predictions.expect("verification poses");
    println!(
        "{name}: tracker_* {}; frame {}; others {}; predicted coordinates {:.2} % +- {:.2}; NEES {:.3} a parameter",
        range(&|id| matches!(id, ParameterId::Instrument { .. })),
        range(&|id| matches!(id, ParameterId::Frame { .. })),
        range(&|id| !matches!(id, ParameterId::Instrument { .. } | ParameterId::Frame { .. })),
        1e2 * predictions.coverage.fraction(),
        1e2 * predictions.half_width.expect("trials"),
        mode.nees.map_or(f64::NAN, |nees| nees.mean / nees.parameters)
    );
}

#[test]
fn with_the_instruments_terms_intervals_hold_as_stated() {
    let trials = repeated(1000, 100);
    let scenario = matched();
    let mode = campaign_of(&scenario, trials);
    print("with the instrument's terms", &mode);
    let mut ignored = scenario.clone();
    ignored.options.instrument = InstrumentChoice::Ignored;
    print("without", &campaign_of(&ignored, trials));

    assert_eq!(mode.parameters.len(), 24 + 5 + 6 + 3 + 16);
    for p in &mode.parameters {
        assert_eq!(p.coverage.trials, u64::from(trials), "{}", p.id);
        // Binomial, 99.9 %.
        assert!(p.coverage.p_value(0.95) >= 0.001, "{}: {:?}", p.id, p.coverage);
    }
    let nees = mode.nees.expect("every truth is known");
    assert!((nees.band.0..=nees.band.1).contains(&nees.mean), "{nees:?}");
    // Coordinates of a trial depend on one estimate, so that the scatter between trials says how far the share is known: 99.9 %.
    let predictions = mode.predictions.expect("verification poses");
    let (share, half) = (predictions.coverage.fraction(), predictions.half_width.expect("trials"));
    assert!(half < 0.05 && (share - 0.95).abs() <= half, "{predictions:?}");
}

/// The report tells the drawn instrument's errors beside what is identified of them, and a scenario without noise has none.
#[test]
fn a_report_tells_the_instruments_real_errors() {
    let mut scenario = Scenario { verification_poses: 0, ..matched() };
    scenario.modes = vec![Mode::ElastoGeometric];
    let outcome = run(&scenario, 1, |_, _| {}).expect("a run");
    let real = &outcome.truth.as_ref().expect("simulated").instrument;
    assert!(real.len() == 16 && real.iter().all(|(_, amplitude)| *amplitude != 0.0));
    let json = calibrig::report::json_report(&outcome);
    for (term, amplitude) in real {
        let name = ParameterId::Instrument { instrument: 0, term: *term }.to_string();
        let row = json.parameters.iter().find(|p| p.name == name).expect(&name);
        assert_eq!(row.truth, Some(*amplitude), "{name}");
    }
    assert_eq!(outcome.bounds.len(), 1, "every truth is known");
}

/// The matched scenario with a line of `[tracker]` in place of another, and more behind it.
fn checked(sandbox: &Sandbox, line: &str, instead: &str, more: &str) -> Ended {
    let text = sandbox.read("scenarios/matched.toml");
    assert!(text.contains(line), "{line}");
    sandbox.write("scenarios/own.toml", format!("{}\n{more}", text.replace(line, instead)));
    sandbox.run(["check", "scenarios/own.toml"])
}

/// An instrument that no maker would sell, stations in one place, readings of two kinds: simulated, and told before.
#[test]
fn what_is_simulated_all_the_same_is_told() {
    const NOISE: &str = "random_fraction = 0.125";
    let sandbox = Sandbox::new();
    let sound = checked(&sandbox, NOISE, NOISE, "");
    assert!(sound.stderr.is_empty(), "{sound:?}");
    assert!(sound.stdout.contains("of 50 such instruments 50 pass their acceptance test"), "{sound:?}");
    let station = "[[session.station]]\nname = \"2\"\nx_mm = 6000\ny_mm = 1500\nz_mm = 1500\nyaw_deg = 90\n";
    let probe = "[[session.target]]\nname = \"B\"\nx_mm = 100\ny_mm = 0\nz_mm = 100\n[tracker.pose]\nrotation_sigma_deg = 0.003\n";
    for (instead, more, told) in [
        ("random_fraction = 0.5", "", "pass their own acceptance test"),
        (NOISE, station, "stations \"1\" and \"2\" are at the same place"),
        (NOISE, probe, "refuses a recording of both"),
    ] {
        let ended = checked(&sandbox, NOISE, instead, more);
        assert_eq!(ended.code, Some(0), "{told}: {ended:?}");
        assert!(ended.stderr.contains(told), "{told}: {}", ended.stderr);
    }
}

/// Nests beyond the angles of the instrument are refused where the file is read, for every station.
#[test]
fn nests_beyond_the_angles_of_an_instrument_are_refused() {
    const NOISE: &str = "random_fraction = 0.125";
    let sandbox = Sandbox::new();
    let station = "[[session.station]]\nname = \"2\"\nx_mm = 6000\ny_mm = 1500\nz_mm = 1000\nyaw_deg = 0\n";
    for (limits, more, who) in [
        ("elevation_limits_deg = [5, 50]", "", "the tracker cannot see nest \"rail left\": elevation"),
        ("azimuth_limits_deg = [-10, 10]", "", "the tracker cannot see nest \"rail left\": azimuth"),
        ("azimuth_limits_deg = [-90, 90]", station, "station \"2\" cannot see nest \"rail left\": azimuth"),
    ] {
        let ended = checked(&sandbox, NOISE, &format!("{NOISE}\n{limits}"), more);
        assert_eq!(ended.code, Some(1), "{limits}: {ended:?}");
        let told = ended.stderr.split_whitespace().collect::<Vec<_>>().join(" ").replace("\u{2502} ", "");
        assert!(told.contains(who) && told.contains("yaw_deg"), "{who}: {told}");
    }
}
