//! Campaigns: the estimator is as good as the bound, as certain as it says, and the same bits in any order; the command keeps what is done.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use calibrig::campaign::table::Cell;
use calibrig::evaluation::chi2_band;
use calibrig::identification::{Estimate, IdentificationOptions, Loss, Mode, identify};
use calibrig::montecarlo::{Campaign, TrialColumns, summarise_trials};
use calibrig::pipeline::{KnownTruth, PlantKind, Simulation, simulate};
use calibrig::scenario::{Scenario, load_scenario};
use calibrig::tracker::Outliers;

use crate::a_user_reproduces_the_paper::rigid_paper;
use crate::sandbox::{Sandbox, assert_refused};

const MATCHED: &str = "scenarios/matched.toml";

fn matched() -> Scenario {
    load_scenario(Path::new(MATCHED)).expect("the shipped scenario")
}

/// Enough poses for 38 parameters.
fn short() -> Scenario {
    Scenario { identification_poses: 12, verification_poses: 4, ..matched() }
}

fn analytic(scenario: &Scenario) -> Campaign<'_> {
    Campaign::of_draws(scenario, scenario.seed, PlantKind::Analytic)
}

/// False alarms of every test here, over all of its parameters.
const LEVEL: f64 = 0.001;

/// `calibrig montecarlo scenarios/matched.toml --trials 10000 --plant analytic` is the same with narrower bounds.
#[test]
fn errors_are_as_large_as_the_bound_and_as_stated() {
    let trials = 1000;
    let scenario = matched();
    let campaign = analytic(&scenario);
    let done = campaign.trials(0..trials).expect("threads");
    let summary = summarise_trials(&campaign, &done).expect("a table");
    let mode = &summary.modes()[0];
    assert_eq!((summary.trials, summary.failed), (1000, 0));
    // What was stated is doubted at a level of 0.1 % a trial: 6 and more of 1000 come once in 1700 campaigns.
    println!("{} of {trials} doubted", mode.doubtful);
    assert!(mode.doubtful <= 5, "{}", mode.doubtful);

    // Bonferroni: each of the parameters is tested at the level over their number.
    let parameters = mode.parameters.len();
    assert_eq!(parameters, 24 + 5 + 6 + 3);
    let each = LEVEL / parameters as f64;
    // Errors are normal with the stated variance: (RMSE / bound)² is chi-square over its degrees of freedom.
    let (low, high) = chi2_band(f64::from(trials), 1.0 - each);
    for p in &mode.parameters {
        let ratio = p.consistency.value;
        assert!((low.sqrt()..=high.sqrt()).contains(&ratio), "{}: RMSE / stated {ratio}", p.id);
        // No estimator is below the bound; this one is hardly above it.
        let bound = p.bayesian.expect("machines drawn from the priors");
        let ratio = p.rmse.value / bound;
        assert!((low.sqrt()..=1.02 * high.sqrt()).contains(&ratio), "{}: RMSE / bound {ratio}", p.id);
        // The measurements alone tell less.
        assert!(p.cramer_rao.is_some_and(|alone| alone > bound * (1.0 - 1e-3)), "{}: {p:?}", p.id);
        assert_eq!(p.coverage.trials, u64::from(trials));
        assert!(p.coverage.p_value(0.95) >= each, "{}: {:?}", p.id, p.coverage);
    }
    // The square of a normal vector of that length, over all trials.
    let (low_square, high_square) = chi2_band(f64::from(trials) * parameters as f64, 1.0 - LEVEL);
    let squared = mode.squared_over_bound.expect("every truth is known").mean;
    assert!((low_square..=1.02 * high_square).contains(&squared), "{squared}");
    let ratios = || mode.parameters.iter().filter_map(|p| Some(p.rmse.value / p.bayesian?));
    let (least, most) = (ratios().fold(f64::INFINITY, f64::min), ratios().fold(0.0, f64::max));
    println!("RMSE / bound {least:.3} to {most:.3}, bounds {:.3} to {:.3}", low.sqrt(), high.sqrt());

    let nees = mode.nees.expect("every truth is known");
    println!("mean NEES {:.3} of {parameters}, band {:?}", nees.mean, nees.band);
    assert_eq!((nees.parameters, nees.trials), (parameters as f64, 1000));
    assert!((nees.band.0..=nees.band.1).contains(&nees.mean), "{nees:?}");

    // 99.9 % from the scatter between trials.
    let predictions = mode.predictions.expect("verification poses");
    assert_eq!(predictions.coverage.trials, u64::from(trials * 3 * scenario.verification_poses));
    println!(
        "coverage of predicted coordinates {:.4} +- {:?}",
        predictions.coverage.fraction(),
        predictions.half_width
    );
    let half = predictions.half_width.expect("many trials");
    assert!(half < 0.01 && (predictions.coverage.fraction() - 0.95).abs() <= half, "{predictions:?}");
}

/// One machine, without priors: the bound is that of the measurements alone.
#[test]
fn errors_without_priors_are_as_large_as_the_cramer_rao_bound() {
    let trials = 400;
    let mut scenario = Scenario { verification_poses: 0, ..rigid_paper() };
    scenario.options.unmodelled_sigma = 0.0;
    scenario.modes = vec![Mode::OnlyCalibration];
    let campaign = analytic(&scenario);
    let done = campaign.trials(0..trials).expect("threads");
    let summary = summarise_trials(&campaign, &done).expect("a table");
    let mode = &summary.modes()[0];
    let each = LEVEL / mode.parameters.len() as f64;
    let (low, high) = chi2_band(f64::from(trials), 1.0 - each);
    assert_eq!(mode.parameters.len(), 24 + 6 + 3);
    for p in &mode.parameters {
        let ratio = p.rmse.value / p.cramer_rao.expect("determined");
        assert!((low.sqrt()..=high.sqrt()).contains(&ratio), "{}: RMSE / bound {ratio}", p.id);
        assert_eq!((p.bayesian, p.least()), (None, p.cramer_rao));
    }
}

#[test]
fn a_trial_is_the_same_bits_alone_and_among_others_on_any_number_of_threads() {
    let scenario = short();
    for plant in [PlantKind::Analytic, PlantKind::Rapier] {
        let campaign = Campaign { plant, ..analytic(&scenario) };
        let columns = TrialColumns::of(&campaign);
        let rows = |threads| {
            let mut done = Vec::new();
            let take = |trial, _| {
                done.push(trial);
                true
            };
            let stop = AtomicBool::new(false);
            campaign.run(0..10, threads, &stop, &|| 0.0, take).expect("threads");
            let told: Vec<_> = done.iter().map(|trial| columns.row(trial)).collect();
            (done, told)
        };
        let (trials, one) = rows(1);
        assert_eq!(one.len(), 10);
        assert!(one.iter().all(|cells| cells[2] == Cell::text("ok")), "{one:?}");
        assert!(
            one.windows(2).all(|pair| pair[0][6..] != pair[1][6..]),
            "every trial has numbers of its own"
        );
        for threads in [2, 8] {
            assert!((trials.clone(), one.clone()) == rows(threads), "{} on {threads} threads", plant.key());
        }
        for index in [0, 7] {
            assert_eq!(campaign.trial(index as u64), trials[index], "{} alone", plant.key());
        }
    }
}

fn estimate(scenario: &Scenario, trial: u32) -> (Simulation, Estimate) {
    let simulation =
        simulate(scenario, scenario.seed, trial, PlantKind::Analytic, |_, _| {}).expect("a session");
    let options = IdentificationOptions { mode: Mode::ElastoGeometric, ..scenario.options.clone() };
    let estimate = identify(&scenario.robot.model, &simulation.sets[0].measurements, &options);
    (simulation, estimate.expect("an estimate"))
}

/// Adds the squares of estimate minus truth.
fn add_squares(sums: &mut Vec<f64>, scenario: &Scenario, (simulation, estimate): &(Simulation, Estimate)) {
    let known = KnownTruth {
        orientation: None,
        as_built: &simulation.truth.as_built,
        nominal: &scenario.robot.model,
        stations: &simulation.truth.stations,
        instrument: &simulation.truth.instrument,
        further_targets: &simulation.truth.further_targets,
        targets: &simulation.sets[0].measurements.targets,
        settled: &simulation.truth.poses[0],
    };
    sums.resize(estimate.parameters.len(), 0.0);
    for (sum, p) in sums.iter_mut().zip(&estimate.parameters) {
        *sum += (p.value - known.of(estimate, p.id).expect("matched")).powi(2);
    }
}

#[test]
fn gross_errors_are_named_and_cost_little() {
    // Fewer leave the ratio of two RMSE too uncertain for its limit.
    const TRIALS: u32 = 200;
    let clean = Scenario { verification_poses: 0, ..matched() };
    let mut hit = clean.clone();
    hit.outliers = Some(Outliers { fraction: 0.05, least: 1e-3, most: 10e-3 });
    hit.options.solver.loss = Loss::tukey();
    let (mut without, mut with) = (Vec::new(), Vec::new());
    let (mut outliers, mut false_alarms, mut readings) = (0, 0, 0);
    for trial in 0..TRIALS {
        let sound = estimate(&clean, trial);
        assert!(sound.1.is_sound() && sound.0.truth.outliers[0].is_empty());
        add_squares(&mut without, &clean, &sound);

        let found = estimate(&hit, trial);
        let (simulation, estimate) = &found;
        assert!(estimate.is_sound(), "trial {trial}: {:?}", estimate.warnings);
        let poses: Vec<u32> = simulation.truth.outliers[0].iter().map(|(pose, _)| *pose).collect();
        for pose in &poses {
            let named = estimate.outliers.iter().find(|outlier| outlier.pose == *pose);
            assert!(named.is_some_and(|o| o.size > 5.0), "trial {trial}, pose {pose}: {named:?}");
        }
        outliers += poses.len();
        false_alarms += estimate.outliers.len() - poses.len();
        readings += simulation.sets[0].measurements.observations.len();
        add_squares(&mut with, &hit, &found);
    }
    let ratios: Vec<f64> = with.iter().zip(&without).map(|(a, b)| (a / b).sqrt()).collect();
    let worst = ratios.iter().copied().fold(0.0, f64::max);
    println!(
        "{outliers} gross errors in {readings} readings, all named; {false_alarms} others named; RMSE at most {worst:.3} of clean"
    );
    // Binomial(60 poses a trial, 0.05), within 3.3 standard deviations.
    let (mean, sigma) = (3.0 * f64::from(TRIALS), (2.85 * f64::from(TRIALS)).sqrt());
    assert!((outliers as f64 - mean).abs() <= 3.3 * sigma, "{outliers}");
    assert!(worst <= 1.15, "{ratios:?}");
    // Beyond 5 sigma by chance: 1.5e-5 of normal blocks of three, more where the scale is estimated.
    assert!(false_alarms * 1000 <= readings, "{false_alarms}");
}

#[test]
fn a_trial_that_fails_is_a_row_with_its_reason() {
    let sandbox = Sandbox::new();
    sandbox.replace_line(MATCHED, "", "identification = ", "identification = 5");
    let ended = sandbox.run([
        "montecarlo",
        MATCHED,
        "--trials",
        "3",
        "--plant",
        "analytic",
        "--out",
        "out",
        "--json",
        "--csv",
    ]);
    assert_eq!(ended.code, Some(3), "{ended:?}");
    assert!(ended.stderr.contains("doubtful: 3 of 3 trials failed"), "{}", ended.stderr);
    assert_eq!(ended.json()["schema"], "calibrig.campaign/1");
    assert_eq!(ended.json()["failed"].as_u64(), Some(3));
    // They fail for one reason.
    assert_eq!(ended.json()["failures"][0]["trials"].as_u64(), Some(3));
    assert_eq!(sandbox.read("out/summary.json"), ended.stdout);
    let table = sandbox.read("out/trials.csv");
    for (index, line) in table.lines().skip(1).enumerate() {
        assert!(line.starts_with(&format!("{index},{index},failed,")), "{line}");
        assert!(line.contains("more poses are needed"), "{line}");
    }
    assert_eq!(table.lines().count(), 4);
}

#[test]
fn one_trial_of_a_campaign_is_opened() {
    let sandbox = Sandbox::new();
    sandbox.replace_line(MATCHED, "", "identification = ", "identification = 12");
    let campaign = |more: &[&str], out| {
        let arguments = ["montecarlo", MATCHED, "--plant", "analytic", "--csv", "--out", out];
        let ended = sandbox.run(arguments.iter().chain(more));
        assert_eq!(ended.code, Some(0), "{ended:?}");
        sandbox.read(&format!("{out}/trials.csv"))
    };
    let all = campaign(&["--trials", "5", "--threads", "2"], "all");
    let alone = campaign(&["--trials", "1", "--first", "3"], "alone");
    let row = all.lines().nth(4).expect("trial 3");
    assert_eq!(alone.lines().collect::<Vec<_>>(), [all.lines().next().expect("a header"), row]);

    let ended =
        sandbox.run(["run", MATCHED, "--trial", "3", "--plant", "analytic", "--out", "run", "--json"]);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let report = ended.json();
    assert_eq!(report["input"]["name"], "matched, trial 3");
    let rms = report["sets"]["verification"]["rows"]["elasto_geometric"]["rms_3d_m"].as_f64().expect("a row");
    let place = all.lines().next().and_then(|header| {
        header.split(',').position(|name| name == "elasto_geometric.verification.rms_3d_m")
    });
    let cell = row.split(',').nth(place.expect("the column")).expect("a cell");
    assert_eq!(cell.parse::<f64>().expect("a number").to_bits(), rms.to_bits());
    let html = sandbox.read("run/report.html");
    assert!(html.contains("--trial 3 --plant analytic"), "the report does not say how to repeat it");
}

#[test]
fn what_cannot_be_done_is_refused_before_the_first_trial() {
    let sandbox = Sandbox::new();
    sandbox.write("file", "mine");
    let before = sandbox.content();
    for (more, message) in [
        (&["--trials", "0"][..], "0 is not in 1..=4000000000"),
        (&["--trials", "-1"], "unexpected argument '-1'"),
        (&["--trials", "3", "--first", "4000000001"], "4000000001 is not in 0..=4000000000"),
        (&["--trials", "3", "--plant", "paper"], "[possible values: rapier, analytic]"),
        (&["--resume"], "--out <DIR>"),
        (&["--shard", "0/4"], "--out <DIR>"),
        (&["--shard", "4/4", "--out", "out"], "there is no shard 4 of 4: the last one is 3"),
        (&["--shard", "-1/4", "--out", "out"], "unexpected argument '-1'"),
        (&["--shard", "x/4", "--out", "out"], "expected I/N"),
        (&["--shard", "0/0", "--out", "out"], "expected I/N"),
        (&["--shard", "1", "--out", "out"], "expected I/N"),
        (&["--plan", "slurm", "--out", "out"], "--shards <N>"),
        (
            &["--plan", "pbs", "--shards", "4", "--out", "out"],
            "[possible values: slurm, hyperqueue, kubernetes]",
        ),
        (&["--tolerance", "0.2"], "a length with its unit"),
        (&["--tolerance", "0mm"], "not a number above zero"),
        (&["--resume", "--shard", "0/4", "--out", "out"], "cannot be used with"),
    ] {
        let ended = sandbox.run(["montecarlo", MATCHED].iter().chain(more));
        assert_eq!((ended.code, ended.stdout.as_str()), (Some(2), ""), "{ended:?}");
        assert!(ended.stderr.contains(message), "{message:?} is not in {}", ended.stderr);
        assert!(sandbox.content() == before);
    }
    let ended = sandbox.run(["run", MATCHED, "--trial", "3", "--ablate"]);
    assert_eq!(ended.code, Some(2), "{ended:?}");
    assert!(ended.stderr.contains("cannot be used with"), "{}", ended.stderr);

    let campaign = ["montecarlo", MATCHED, "--trials", "3", "--out", "file/out"];
    assert_refused(&sandbox, &campaign, "cannot write", "file is no folder", "the name of a new one");
    let whole = "scenarios/whole.toml";
    let shipped = std::fs::read_to_string("scenarios/paper.toml").expect("the shipped scenario");
    sandbox.write(whole, &shipped);
    let section = "[[effects.stiffening.joint]]";
    let line = 1 + shipped.lines().position(|line| line == section).expect("a drive that stiffens");
    let message = "the analytic plant has no stiffening drives";
    for start in [["montecarlo", whole, "--trials", "3"], ["run", whole, "--trial", "3"]] {
        let arguments = [&start[..], &["--plant", "analytic"]].concat();
        let place = format!("{whole}:{line}: ");
        assert_refused(&sandbox, &arguments, &place, message, "switch [effects.stiffening] off");
    }
    for (start, lines, below, message, expected) in [
        ("tolerance_mm = ", "", 0, "tolerance_mrad is given without its counterpart", "tolerance_mm as well"),
        ("tolerance_mm = ", "tolerance_mm = 0", 0, "tolerance_mm is 0", "above zero"),
        (
            "compliances = [",
            "compliances = [\"mass3\"]",
            0,
            "is not a compliance of this robot",
            "compliance_rod",
        ),
        (
            "[identification]",
            "[tracker.outliers]\nfraction = 0.6\nleast_mm = 1\nmost_mm = 2\n[identification]",
            1,
            "fraction is 0.6",
            "at most 0.5",
        ),
        (
            "[identification]",
            "[tracker.outliers]\nfraction = 0.1\nleast_mm = 3\nmost_mm = 2\n[identification]",
            3,
            "most_mm is 2",
            "least_mm (3) or more",
        ),
        (
            "[identification]",
            "[tracker.outliers]\nfraction = 0.1\nleast_mm = 3\n[identification]",
            0,
            "missing key `most_mm`",
            "most_mm",
        ),
    ] {
        let sandbox = Sandbox::new();
        let line = sandbox.replace_line(MATCHED, "", start, lines) + below;
        let place = format!("{MATCHED}:{line}: ");
        assert_refused(&sandbox, &["check", MATCHED], &place, message, expected);
    }
}
