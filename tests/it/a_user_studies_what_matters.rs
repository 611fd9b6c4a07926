//! Campaigns in which something varies: sweeps with the same draws, sensitivities, and factors that can be impossible.

use calibrig::montecarlo::Campaign;
use calibrig::pipeline::PlantKind;
use calibrig::scenario::load_scenario;

use crate::sandbox::{Ended, Sandbox, assert_refused};

const SCENARIO: &str = "scenarios/matched.toml";

/// A scenario of few poses with a section [campaign].
fn with(section: &str) -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.replace_line(SCENARIO, "", "identification = ", "identification = 20");
    sandbox.replace_line(SCENARIO, "", "verification = ", "verification = 6");
    let text = sandbox.read(SCENARIO);
    sandbox.write(SCENARIO, format!("{text}\n{section}"));
    sandbox
}

fn run(sandbox: &Sandbox, more: &[&str]) -> Ended {
    let arguments = ["montecarlo", SCENARIO, "--plant", "analytic", "--out", "out", "--json"];
    let ended = sandbox.run(arguments.iter().chain(more));
    assert_eq!(ended.code, Some(0), "{ended:?}");
    ended
}

const NOISE: &str = "[campaign]\ndesign = \"sweep\"\nrepeats = 8\n[[campaign.factor]]\nname = \"noise\"\nkey = \"tracker.random_fraction\"\n\
    levels = [0.125, 0.25, 0.5]\n";

#[test]
fn a_sweep_has_the_same_draws_in_every_combination() {
    let sandbox = with(NOISE);
    let ended = run(&sandbox, &["--csv"]);
    let json = ended.json();
    let groups = json["groups"].as_array().expect("groups");
    assert_eq!(groups.len(), 3);
    let rms: Vec<f64> = groups
        .iter()
        .map(|g| g["modes"][0]["sets"]["truth"]["rms_3d_m"]["mean"].as_f64().expect("a mean"))
        .collect();
    // The estimator is linear in the noise to first order, and draws are the same: errors grow with it, trial by trial.
    for (level, factor) in [(1, 2.0), (2, 4.0)] {
        let ratio = rms[level] / rms[0];
        assert!((ratio / factor - 1.0).abs() < 0.1, "{ratio} for {factor} times the noise");
        let more = &groups[level]["modes"][0]["sets"]["truth"]["rms_against_first_combination_m"];
        let low = more["interval_95"][0].as_f64().expect("an interval");
        assert!(low > 0.0, "{more}");
    }
    let table = sandbox.read("out/trials.csv");
    let draws: Vec<&str> =
        table.lines().skip(1).map(|line| line.split(',').nth(1).expect("a draw")).collect();
    assert!(draws.iter().enumerate().all(|(n, draw)| *draw == (n % 8).to_string()), "{draws:?}");

    // A trial of it alone, by the command that the summary tells of.
    let ended = sandbox.run([
        "run", SCENARIO, "--plant", "analytic", "--trial", "17", "--trials", "24", "--out", "one", "--json",
    ]);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let rms = ended.json()["sets"]["verification"]["rows"]["elasto_geometric"]["rms_3d_m"].as_f64();
    let header = table.lines().next().expect("a header");
    let place = header.split(',').position(|name| name == "elasto_geometric.verification.rms_3d_m");
    let cell = table.lines().nth(18).and_then(|row| row.split(',').nth(place.expect("the column")));
    let cell = cell.and_then(|cell| cell.parse::<f64>().ok()).expect("a cell");
    assert_eq!(cell.to_bits(), rms.expect("a row").to_bits());
    // Its recording holds the scenario with the factor's value, and replays.
    let replayed = sandbox.run(["replay", "one/recording.mcap"]);
    assert_eq!(replayed.code, Some(0), "{replayed:?}");
    assert!(sandbox.read("one/report.html").contains("--trial 17 --trials 24"));
}

#[test]
fn indices_tell_the_factor_that_matters_from_one_that_does_not() {
    let sandbox = with(
        "[campaign]\ndesign = \"indices\"\nbase = 32\n\
         [[campaign.factor]]\nname = \"noise\"\nkey = \"tracker.random_fraction\"\ndistribution = \"log_uniform\"\nlow = 0.02\nhigh = 0.5\n\
         [[campaign.factor]]\nname = \"yaw\"\nkey = \"tracker.yaw_deg\"\ndistribution = \"uniform\"\nlow = 179\nhigh = 181\n",
    );
    let json = run(&sandbox, &[]).json();
    // N (k + 2), the draws counted as one of k.
    assert_eq!(json["trials"].as_u64(), Some(32 * 5));
    let effects = json["sensitivity"][0]["effects"].as_array().expect("effects").clone();
    let names: Vec<_> = effects.iter().map(|e| e["factor"].as_str().expect("a name")).collect();
    assert_eq!(names, ["noise", "yaw", "draws"]);
    let index = |n: usize, which: &str, key: &str| effects[n][which][key].clone();
    let value = |n, which| index(n, which, "value").as_f64().expect("an index");
    println!("total indices: {names:?} {} {} {}", value(0, "total"), value(1, "total"), value(2, "total"));
    // Nine tenths of the noise's distribution span a factor of 20. Where the tracker looks says nothing of an instrument whose noise is alike in every
    // direction; which noise and machine are drawn says less than how large the noise is.
    let least = index(0, "total", "interval_95")[0].as_f64().expect("an interval");
    assert!(least > 0.5 && value(0, "first_order") > value(2, "first_order"), "{effects:?}");
    assert!(value(1, "total") < 1e-6 && value(2, "total") > 1e-3, "{effects:?}");
}

#[test]
fn a_screening_ranks_factors() {
    let sandbox = with(
        "[campaign]\ndesign = \"screening\"\ntrajectories = 12\n\
         [[campaign.factor]]\nname = \"noise\"\nkey = \"tracker.random_fraction\"\ndistribution = \"uniform\"\nlow = 0.02\nhigh = 0.5\n\
         [[campaign.factor]]\nname = \"yaw\"\nkey = \"tracker.yaw_deg\"\ndistribution = \"uniform\"\nlow = 179\nhigh = 181\n",
    );
    let json = run(&sandbox, &[]).json();
    assert_eq!(json["trials"].as_u64(), Some(12 * 3));
    let size =
        |n: usize| json["sensitivity"][0]["effects"][n]["mean_absolute_m"]["value"].as_f64().expect("mu*");
    assert!(size(0) > 10.0 * size(1), "{} {}", size(0), size(1));
}

#[test]
fn a_trial_of_a_campaign_on_sobol_points_is_opened() {
    let sandbox = with(
        "[campaign]\nsampling = \"sobol\"\n[[campaign.factor]]\nkey = \"tracker.random_fraction\"\ndistribution = \"uniform\"\nlow = 0.02\nhigh = 0.5\n",
    );
    run(&sandbox, &["--trials", "6", "--csv"]);
    let table = sandbox.read("out/trials.csv");
    let column = |name: &str| {
        let place = table.lines().next().and_then(|header| header.split(',').position(|own| own == name));
        table.lines().nth(5).and_then(|row| row.split(',').nth(place.expect("the column"))).expect("a cell")
    };
    let ended =
        sandbox.run(["run", SCENARIO, "--plant", "analytic", "--trial", "4", "--out", "one", "--json"]);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let rms = ended.json()["sets"]["verification"]["rows"]["elasto_geometric"]["rms_3d_m"].as_f64();
    let cell: f64 = column("elasto_geometric.verification.rms_3d_m").parse().expect("a number");
    assert_eq!(
        rms.map(f64::to_bits),
        Some(cell.to_bits()),
        "factor {}",
        column("factor.tracker.random_fraction")
    );
}

#[test]
fn what_is_impossible_is_drawn_again_and_counted_up_to_a_tenth() {
    // Above 0.5 of a fraction of gross errors is refused: 4 % of these draws.
    let factor = |high: f64| {
        format!(
            "[campaign]\ntrials = 60\n[[campaign.factor]]\nkey = \"tracker.outliers.fraction\"\ndistribution = \"uniform\"\nlow = 0.0\nhigh = {high}\n"
        )
    };
    let outliers = "[tracker.outliers]\nfraction = 0.01\nleast_mm = 1\nmost_mm = 2\n";
    let sandbox = with(&format!("{outliers}{}", factor(0.52)));
    let scenario = load_scenario(&sandbox.path(SCENARIO)).expect("the scenario");
    let campaign = Campaign::new(&scenario, 1, PlantKind::Analytic, None).expect("a design");
    let mut redrawn = 0;
    for trial in 0..60 {
        let case = campaign.case(trial).expect("possible in the end");
        let fraction = case.scenario.outliers.as_ref().expect("outliers").fraction;
        assert!((0.0..=0.5).contains(&fraction), "{fraction}");
        assert_eq!(case.values, campaign.case(trial).expect("the same").values);
        redrawn += case.redrawn;
    }
    println!("{redrawn} of 60 drawn again");
    // Binomial(60, 0.04): none comes once in 12 campaigns, 9 and more once in 1000; of this seed it is known.
    assert!((1..9).contains(&redrawn), "{redrawn}");

    let sandbox = with(&format!("{outliers}{}", factor(1.0)));
    let arguments = ["montecarlo", SCENARIO, "--plant", "analytic", "--out", "out"];
    assert_refused(&sandbox, &arguments, SCENARIO, "draws of the factors are impossible", "nine of ten");
    assert!(!sandbox.path("out").exists());
}

#[test]
fn what_is_wrong_with_a_campaign_is_told_at_its_place() {
    let factor = "[[campaign.factor]]\n";
    let noise = "key = \"tracker.random_fraction\"\n";
    for (section, message, expected) in [
        ("[campaign]\ntrials = 0\n".to_owned(), "campaign.trials is 0", "1 or more"),
        (
            "[campaign]\nrepeats = 3\n".to_owned(),
            "campaign.repeats belongs to another design",
            "design = \"sweep\"",
        ),
        ("[campaign]\ndesign = \"sweep\"\n".to_owned(), "nothing varies", "[[campaign.factor]]"),
        ("[campaign]\ndesign = \"grid\"\n".to_owned(), "campaign.design is \"grid\"", "sweep"),
        (
            format!("[campaign]\n{factor}levels = [1]\n"),
            "it does not state which value varies",
            "tracker.random_fraction",
        ),
        (format!("[campaign]\n{factor}{noise}"), "it states no values", "distribution = \"uniform\""),
        (
            format!("[campaign]\n{factor}key = \"tracker.no_key\"\nlevels = [1]\n"),
            "this file has no value of tracker.no_key",
            "write it with its usual value first",
        ),
        (
            format!("[campaign]\n{factor}key = \"poses.region.half_width_mm\"\nlevels = [1]\n"),
            "2 values of poses.region.half_width_mm",
            "poses.region[rail].half_width_mm",
        ),
        (
            format!("[campaign]\n{factor}key = \"seed\"\nlevels = [1]\n"),
            "seed cannot vary",
            "a session depends on",
        ),
        (
            format!("[campaign]\n{factor}{noise}distribution = \"uniform\"\nlow = 0.5\nhigh = 0.1\n"),
            "campaign.factor: ",
            "the distribution that is stated",
        ),
        (
            format!("[campaign]\n{factor}{noise}distribution = \"gauss\"\n"),
            "distribution is \"gauss\"",
            "normal",
        ),
        (
            format!("[campaign]\n{factor}{noise}distribution = \"normal\"\nmean = 1\n"),
            "without sigma",
            "in the unit of the key",
        ),
        (
            format!("[campaign]\n{factor}{noise}distribution = \"normal\"\nmean = 1\nsigma = 1\nhigh = 2\n"),
            "\"normal\" has no high",
            "mean and sigma",
        ),
        (
            format!(
                "[campaign]\n{factor}{noise}levels = [0.1]\n{factor}name = \"b\"\n{noise}levels = [0.2]\n"
            ),
            "change the same value",
            "one factor per value",
        ),
        (format!("[campaign]\n{factor}{noise}levels = []\n"), "levels is empty", "one value"),
        (
            format!("[campaign]\n{factor}key = \"tracker.nest\"\nlevels = [1]\n"),
            "tracker.nest is a table",
            "tracker.nest[1].x_mm",
        ),
        (
            format!("[campaign]\n{factor}key = \"tracker\"\nlevels = [1]\n"),
            "tracker is a table",
            "one of its keys",
        ),
        (format!("[campaign]\n{factor}{noise}levels = [0.1, nan]\n"), "nan", "finite numbers"),
        (
            format!("[campaign]\n{factor}key = \"robot\"\nlevels = [\"x\"]\n"),
            "robot cannot vary",
            "a session depends on",
        ),
        ("[campaign]\ntolerance_mm = -1\n".to_owned(), "campaign.tolerance_mm is -1", "above zero"),
    ] {
        let sandbox = with(&section);
        assert_refused(&sandbox, &["check", SCENARIO], SCENARIO, message, expected);
    }
    // Of a design in which nothing is drawn again, one impossible level is the end.
    let sandbox = with(
        "[campaign]\ndesign = \"sweep\"\n[[campaign.factor]]\nkey = \"poses.identification\"\nlevels = [20, -3]\n",
    );
    let arguments = ["montecarlo", SCENARIO, "--plant", "analytic", "--out", "out"];
    assert_refused(&sandbox, &arguments, SCENARIO, "poses.identification is -3", "all possible");
    // A number of trials that the design does not have.
    let sandbox = with(NOISE);
    let arguments = ["montecarlo", SCENARIO, "--plant", "analytic", "--trials", "7", "--out", "out"];
    assert_refused(&sandbox, &arguments, "--trials", "does not fit", "a multiple of 3 trials");
    let arguments = ["run", SCENARIO, "--plant", "analytic", "--trial", "1000"];
    assert_refused(
        &sandbox,
        &arguments,
        SCENARIO,
        "no trial 1000",
        "a trial number below the number of trials",
    );
}
