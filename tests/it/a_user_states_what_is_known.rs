//! What a user knows beforehand: bounds that are kept and told, statements that the measurements contradict, and what a planned session of a
//! coupled mode can tell.

use std::fmt::Write;

use calibrig::files::load_robot;
use calibrig::identification::{Mode, Warning, identify};
use calibrig::kinematics::forward_kinematics;
use calibrig::pipeline::{PlantKind, simulate};
use calibrig::random::{StreamSource as Stream, stream};
use calibrig::scenario::load_scenario;
use calibrig::statistics::binomial_cdf;

use nalgebra::Point3;
use rand_distr::{Distribution, StandardNormal};

use crate::a_user_makes_a_mistake::with_measurements;
use crate::sandbox::{Ended, ROBOT, SCENARIO, Sandbox, assert_refused};

const MATCHED: &str = "scenarios/matched.toml";
const IDENTIFICATION: &str = "[identification]";

/// Appends lines to the shipped scenario; the number of the last line before them.
fn append(sandbox: &Sandbox, file: &str, lines: &str) -> usize {
    let text = sandbox.read(file);
    sandbox.write(file, format!("{text}{lines}"));
    text.lines().count()
}

/// A scenario with one mode and these bounds.
fn bounded(bounds: &str) -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.set(IDENTIFICATION, "modes", "[\"only_calibration\"]");
    append(&sandbox, SCENARIO, bounds);
    sandbox
}

#[test]
fn a_bound_that_cannot_be_is_refused_at_its_line() {
    let unit = "the unit is part of the key";
    for (lines, line, message, expected) in [
        (
            "parameter = \"delta_q4\"\nmin_mm = -1",
            2,
            "\"delta_q4\", which is not the name of a parameter",
            "such as delta_a2",
        ),
        ("parameter = \"delta_a4\"", 2, "the bound of delta_a4 has no limit", "min_mm, max_mm or both"),
        ("parameter = \"delta_a4\"\nmin_mrad = -1", 3, "bound.min_mrad: delta_a4 is a length", unit),
        (
            "parameter = \"delta_theta4\"\nmax_mm = 1",
            3,
            "bound.max_mm: delta_theta4 is an angle",
            "max_mrad or both",
        ),
        ("parameter = \"compliance_drive3\"\nmax_mm = 1", 3, "is a relative deviation", "min, max or both"),
        ("parameter = \"delta_a4\"\nmin_kg = -1", 3, "unknown key `min_kg`", "`min_mm`"),
        (
            "parameter = \"delta_a4\"\nmin_mm = nan",
            3,
            "identification.bound.min_mm is nan",
            "a finite number",
        ),
        (
            "parameter = \"delta_a4\"\nmin_mm = 5\nmax_mm = -5",
            4,
            "ends at -5 mm, which is not above its start at 5 mm",
            "above the lower",
        ),
        (
            "parameter = \"delta_a4\"\nmin_mm = 0\nmax_mm = 0",
            4,
            "ends at 0 mm, which is not above its start at 0 mm",
            "value, leave it out of the parameters",
        ),
        (
            "parameter = \"delta_a4\"\nmin_mm = 5\nmax_mm = 9",
            3,
            "delta_a4 5 to 9 mm excludes 0, the nominal value",
            "correct it in the file",
        ),
        (
            "parameter = \"delta_a4\"\nmax_mm = -5",
            3,
            "delta_a4 at most -5 mm excludes 0",
            "with 0 between them",
        ),
        (
            "parameter = \"compliance_drive3\"\nmin = -2",
            3,
            "begins at -2",
            "-1 is no compliance or mass at all",
        ),
        (
            "parameter = \"delta_d1\"\nmax_mm = 5\n[[identification.bound]]\nparameter = \"delta_d1\"\nmin_mm = -5",
            5,
            "delta_d1 has a second bound",
            "both limits in it",
        ),
        (
            "parameter = \"delta_beta6\"\nmax_mrad = 5",
            2,
            "delta_beta6 is not fitted in any of the modes (only_calibration)",
            "expected one of: delta_alpha1",
        ),
        ("min_mm = -5", 1, "missing key `parameter` in [identification.bound]", "`parameter`"),
    ] {
        let sandbox = bounded("");
        let before = append(&sandbox, SCENARIO, &format!("\n[[identification.bound]]\n{lines}\n"));
        let place = format!("{SCENARIO}:{}: ", before + 1 + line);
        for arguments in [&["check", SCENARIO][..], &["run", SCENARIO, "--out", "out"]] {
            assert_refused(&sandbox, arguments, &place, message, expected);
        }
    }
    let sandbox = Sandbox::new();
    let prior = "\n[[identification.term_prior]]\nfamily = \"rail\"\nsigma_um = 5\n";
    let before = append(&sandbox, SCENARIO, &format!("{prior}{prior}"));
    let place = format!("{SCENARIO}:{}: ", before + 7);
    assert_refused(
        &sandbox,
        &["check", SCENARIO],
        &place,
        "a second prior of \"rail\"",
        "one prior per family",
    );
}

/// The truth is 14.8 mrad.
#[test]
fn a_bound_in_a_scenario_is_kept_told_and_replayed() {
    let sandbox = bounded(
        "\n[[identification.bound]]\nparameter = \"delta_beta4\"\nmax_mrad = 5\n\
         [[identification.bound]]\nparameter = \"delta_a4\"\nmin_mm = -30\nmax_mm = 30\n",
    );
    let check = sandbox.run(["check", SCENARIO]);
    assert!(check.stdout.contains("bounds       delta_beta4 at most 5 mrad\n"), "{}", check.stdout);
    assert!(check.stdout.contains(" delta_a4 -30 to 30 mm\n"), "{}", check.stdout);
    let ended = sandbox.run(["run", SCENARIO, "--out", "out"]);
    assert_eq!(ended.code, Some(3), "{ended:?}");
    assert!(
        ended.stderr.contains("doubtful: only calibration: delta_beta4 ended at its bound 5 mrad"),
        "{ended:?}"
    );
    assert!(!ended.stderr.contains("delta_a4 ended"), "{ended:?}");
    let text = ended.stdout.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(text.contains("held within bounds: delta_beta4 at most 5 mrad, delta_a4 -30 to 30 mm"), "{text}");
    let report: serde_json::Value = serde_json::from_str(&sandbox.read("out/report.json")).expect("JSON");
    let estimate = &report["estimates"]["only_calibration"];
    assert_eq!(estimate["status"], "at_bound");
    let of = |name: &str| {
        let parameters = report["parameters"].as_array().expect("a list");
        parameters.iter().find(|p| p["name"] == name).expect("the parameter")["estimate"].as_f64()
    };
    assert_eq!((of("delta_beta4"), estimate["bounds"][0]["max"].as_f64()), (Some(5e-3), Some(5e-3)));
    assert!(estimate["bounds"][0]["min"].is_null());
    assert_eq!(estimate["bounds"][1]["unit"], "m");
    assert!(sandbox.read("out/report.html").contains("Held within bounds: delta_beta4 at most 5 mrad"));
    // The recording holds the scenario, and with it the bounds.
    let replayed = sandbox.run(["replay", "out/recording.mcap"]);
    assert_eq!(replayed.code, Some(3), "{replayed:?}");
    assert!(replayed.stdout.contains("1 recorded estimate, identical bit for bit"), "{replayed:?}");
    assert!(replayed.stderr.contains("delta_beta4 ended at its bound 5 mrad"), "{replayed:?}");
}

#[test]
fn a_bound_on_the_command_line_is_kept_or_refused() {
    let sandbox = with_measurements("set.csv");
    let identify = |more: &[&str]| {
        let mut arguments = vec!["identify", "--model", ROBOT, "--measurements", "set.csv"];
        arguments.extend(["--mode", "only_calibration"]);
        arguments.extend(more);
        sandbox.run(arguments)
    };
    let syntax = "expected a parameter and its limits, such as delta_a4=-5mm..5mm";
    for (bounds, message) in [
        (&["delta_a4"][..], syntax),
        (&["delta_a4=5mm"], syntax),
        (
            &["delta_q4=0mm..5mm"],
            "\"delta_q4\" is not the name of a parameter: expected a name such as delta_a2",
        ),
        (
            &["delta_a4=-5..5mm"],
            "\"-5\" of delta_a4: expected a number of mm, such as 5mm, or nothing for an open end",
        ),
        (&["delta_a4=-5mrad..5mm"], "\"-5mrad\" of delta_a4: expected a number of mm"),
        (&["delta_theta4=..5mm"], "\"5mm\" of delta_theta4: expected a number of mrad"),
        (&["compliance_drive3=0..5%"], "\"5%\" of compliance_drive3: expected a number without unit"),
        (&["delta_a4=nanmm..5mm"], "\"nanmm\" of delta_a4"),
        (&["delta_a4=..inf mm"], "\"inf mm\" of delta_a4"),
        (&["delta_a4=.."], "the bound of delta_a4 has no limit"),
        (&["delta_a4=5mm..-5mm"], "ends at -5 mm, which is not above its start at 5 mm"),
        (&["delta_a4=1mm..5mm"], "delta_a4 1 to 5 mm excludes 0, the nominal value"),
        (&["delta_a4=..5mm", "delta_a4=-5mm.."], "--bound delta_a4: delta_a4 has a second bound"),
        (
            &["frame_x=-5mm..5mm"],
            "--bound frame_x: frame_x is relative to the best fit of the nominal robot to",
        ),
        (
            &["compliance_drive3=0.."],
            "compliance_drive3 is not fitted in any of the modes (only_calibration)",
        ),
    ] {
        let flags: Vec<_> = bounds.iter().flat_map(|bound| ["--bound", bound]).collect();
        let ended = identify(&flags);
        assert_eq!((ended.code, ended.stdout.as_str()), (Some(2), ""), "{bounds:?}: {ended:?}");
        assert!(ended.stderr.contains(message), "{message:?}: {}", ended.stderr);
    }
    let free = identify(&["--json"]);
    assert_eq!(free.code, Some(0), "{free:?}");
    let value = |ended: &crate::sandbox::Ended, name: &str| {
        let report = ended.json();
        let parameters = report["parameters"].as_array().expect("a list").clone();
        parameters.iter().find(|p| p["name"] == name).and_then(|p| p["estimate"].as_f64()).expect("a number")
    };
    assert!(value(&free, "delta_beta4") > 10e-3);
    let ended = identify(&["--bound", "delta_beta4=..5mrad", "--bound", "delta_a4=-90mm..90mm", "--json"]);
    assert_eq!(ended.code, Some(3), "{ended:?}");
    assert!(ended.stderr.contains("delta_beta4 ended at its bound 5 mrad"), "{ended:?}");
    assert_eq!(value(&ended, "delta_beta4"), 5e-3);
}

#[test]
fn a_prior_that_the_measurements_contradict_ends_with_3_and_is_named() {
    let sandbox = Sandbox::new();
    // The machine is drawn with compliances 10 % off.
    sandbox.replace_line(MATCHED, IDENTIFICATION, "compliance_sigma", "compliance_sigma = 0.002");
    let ended = sandbox.run(["run", MATCHED, "--out", "out", "--json"]);
    assert_eq!(ended.code, Some(3), "{ended:?}");
    let doubts: Vec<_> = ended.stderr.lines().filter(|line| line.starts_with("doubtful: ")).collect();
    let [doubt] = doubts.as_slice() else { panic!("one for all: {}", ended.stderr) };
    for part in [
        "geometry and stiffness",
        "contradict what was stated about compliance_drive",
        "sigma",
        "Check these values",
        "0.1 %",
    ] {
        assert!(doubt.contains(part), "{part}: {doubt}");
    }
    let report = ended.json();
    let estimate = &report["estimates"]["elasto_geometric"];
    assert_eq!(estimate["status"], "contradicted");
    let named = estimate["contradicted"].as_array().expect("a list");
    assert!(!named.is_empty() && named.len() <= 5, "{named:?}");
    for one in named {
        assert!(one["name"].as_str().is_some_and(|name| name.starts_with("compliance_")), "{one}");
        assert!(one["chi2"].as_f64() > Some(10.0) && one["coordinates"] == 1, "{one}");
    }
    // As it was stated before, nothing is wrong.
    let sound = Sandbox::new().run(["run", MATCHED, "--out", "out"]);
    assert_eq!(sound.code, Some(0), "{sound:?}");
}

/// The level is 0.1 % an estimate: over all trials the number of false alarms is binomial.
#[test]
fn sound_priors_are_seldom_doubted() {
    const TRIALS: u32 = 300;
    let scenario = load_scenario(std::path::Path::new(MATCHED)).expect("the shipped scenario");
    let options = calibrig::identification::IdentificationOptions {
        mode: Mode::ElastoGeometric,
        ..scenario.options.clone()
    };
    let mut alarms = 0;
    for trial in 0..TRIALS {
        let simulation =
            simulate(&scenario, 11, trial, PlantKind::Analytic, |_, _| {}).expect("a simulation");
        let measured = &simulation.sets[0].measurements;
        let estimate = identify(&scenario.robot.model, measured, &options).expect("an estimate");
        let told = estimate.warnings.iter().any(|w| matches!(w, Warning::Contradicted(_)));
        assert_eq!(told, !estimate.contradicted.is_empty());
        alarms += u32::from(told);
    }
    println!("{alarms} false alarms in {TRIALS} trials");
    // 0.3 are expected; so many or more come but once in a thousand runs.
    assert!(alarms == 0 || binomial_cdf(u64::from(alarms - 1), u64::from(TRIALS), 1e-3) < 0.999, "{alarms}");
}

/// Before a pose is measured: the same rank and the same parameters as the estimate then has, and nearly its condition.
#[test]
fn a_planned_session_tells_what_the_estimate_will() {
    let sandbox = Sandbox::new();
    for mode in ["elasto_geometric", "extended"] {
        sandbox.set(IDENTIFICATION, "modes", &format!("[\"{mode}\"]"));
        // What a plan knows: the noise that is stated.
        sandbox.set(IDENTIFICATION, "unmodelled_sigma_um", "100");
        sandbox.set(IDENTIFICATION, "machine_noise", "\"stated\"");
        let planned = sandbox.run(["identifiability", SCENARIO, "--mode", mode, "--json"]);
        assert_eq!(planned.code, Some(0), "{planned:?}");
        let planned = planned.json();
        assert_eq!(
            (&planned["schema"], &planned["mode"]),
            (&"calibrig.identifiability/1".into(), &mode.into())
        );
        let coupled = &planned["coupled"];
        let report = sandbox.run(["run", SCENARIO, "--out", "out", "--json"]).json();
        let estimate = &report["estimates"][mode];
        let names = |list: &serde_json::Value, key: Option<&str>| -> Vec<String> {
            let name =
                |v: &serde_json::Value| key.map_or(v, |key| &v[key]).as_str().expect("a name").to_owned();
            list.as_array().expect("a list").iter().map(name).collect()
        };
        assert_eq!(names(&coupled["parameters"], None), names(&report["parameters"], Some("name")));
        assert_eq!(coupled["rank"], estimate["rank"]);
        let [condition, then] =
            [&coupled["condition"], &estimate["condition"]].map(|v| v.as_f64().expect("a number"));
        assert!((0.5..2.0).contains(&(condition / then)), "{mode}: {condition} {then}");
        assert!(coupled["measured_rank"].as_u64() <= coupled["rank"].as_u64());
        let text = sandbox.run(["identifiability", SCENARIO, "--mode", mode]);
        let n = coupled["rank"].as_u64().expect("a number");
        for part in [
            format!("mode {mode} at the scenario's 60"),
            format!("Rank {n} of {n}"),
            "  compliances".to_owned(),
        ] {
            assert!(text.stdout.contains(&part), "{part}: {}", text.stdout);
        }
        for warning in names(&coupled["warnings"], None) {
            assert!(text.stdout.contains(&warning), "{warning}: {}", text.stdout);
        }
    }
}

#[test]
fn a_plan_that_cannot_tell_everything_names_what_it_cannot() {
    let sandbox = Sandbox::new();
    // The waist's axis is vertical.
    sandbox.set(IDENTIFICATION, "parameters", "\"neighbour_axis_rules\"\nredundant = \"keep\"");
    let ended = sandbox.run([
        "identifiability",
        SCENARIO,
        "--mode",
        "elasto_geometric",
        "--compliances",
        "compliance_drive2,compliance_drive3",
    ]);
    assert!(
        ended.stdout.contains("warning: gravity hardly loads compliance_drive2 in these poses"),
        "{ended:?}"
    );
    // Along the rail and along the base: the same.
    sandbox.set(IDENTIFICATION, "parameters", "[\"delta_d1\", \"delta_a2\"]");
    sandbox.set(IDENTIFICATION, "frame", "\"free\"");
    let ended = sandbox.run([
        "identifiability",
        SCENARIO,
        "--mode",
        "elasto_geometric",
        "--compliances",
        "compliance_drive3",
    ]);
    assert_eq!(ended.code, Some(3), "{ended:?}");
    assert!(
        ended.stdout.contains("rank 11 of 12 parameters: frame_z with delta_d1 cannot be distinguished"),
        "{ended:?}"
    );
    let spread =
        sandbox.run(["identifiability", "--model", "models/ur5/robot.toml", "--mode", "elasto_geometric"]);
    assert_eq!(spread.code, Some(0), "{spread:?}");
    assert!(spread.stdout.contains("200 poses spread over the joint limits"), "{spread:?}");
}

#[test]
fn a_plan_of_what_the_robot_does_not_have_is_refused() {
    let sandbox = Sandbox::new();
    for (flags, message) in [
        (
            &["--compliances", "all"][..],
            "--compliances: expected --mode elasto_geometric or --mode extended with it",
        ),
        (&["--mode", "elasto_geometric", "--terms", "rail"], "--terms: expected --mode extended with it"),
        (&["--mode", "extended", "--terms", "growth"], "expected some of: none, linkage"),
        (&["--mode", "rigid"], "possible values: geometry, elasto_geometric, extended"),
        (
            &["--mode", "extended", "--compliances", "compliance_drive9"],
            "--compliances compliance_drive9: expected drives, all",
        ),
    ] {
        let ended = sandbox.run([&["identifiability", SCENARIO], flags].concat());
        assert_eq!((ended.code, ended.stdout.as_str()), (Some(2), ""), "{flags:?}: {ended:?}");
        assert!(ended.stderr.contains(message), "{message:?}: {}", ended.stderr);
    }
    let ur5 = "models/ur5/robot.toml";
    let stated = [
        "stiffness_nm_per_rad",
        "compliance_percent",
        "urdf",
        "[gravity]",
        "x_m_per_s2",
        "y_m_per_s2",
        "z_m_per_s2",
    ];
    let text = sandbox.read(ur5);
    let bare: Vec<_> = text.lines().filter(|line| !stated.iter().any(|key| line.starts_with(key))).collect();
    sandbox.write(ur5, bare.join("\n") + "\n");
    let ended = sandbox.run(["identifiability", "--model", ur5, "--mode", "elasto_geometric"]);
    assert_eq!((ended.code, ended.stdout.as_str()), (Some(1), ""), "{ended:?}");
    assert!(ended.stderr.contains("needs masses, stiffnesses and gravity"), "{ended:?}");
    // Its terms do not need them.
    let ended =
        sandbox.run(["identifiability", "--model", ur5, "--mode", "extended", "--terms", "hysteresis"]);
    assert!(
        [Some(0), Some(3)].contains(&ended.code) && ended.stdout.contains("hysteresis_theta1"),
        "{ended:?}"
    );
}

/// The shipped run, told in files of text.
fn exported() -> Sandbox {
    let sandbox = bounded("");
    let ended = sandbox.run(["run", SCENARIO, "--out", "out"]);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let ended = sandbox.run(["export", "csv", "out/recording.mcap", "--out", "t"]);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    sandbox
}

/// What the report says of the measurements; numbers in it read back to the bit.
fn found(ended: &Ended) -> [serde_json::Value; 4] {
    let mut report = ended.json();
    // Names of files and of what was measured are not found.
    let estimates = report["estimates"].as_object_mut().expect("by mode");
    for residuals in estimates.values_mut().filter_map(|estimate| estimate["residuals"].as_object_mut()) {
        for reading in residuals.values_mut().filter_map(|set| set.as_array_mut()).flatten() {
            let reading = reading.as_object_mut().expect("a reading");
            reading.retain(|name, _| !["row", "target", "station"].contains(&name.as_str()));
        }
    }
    ["parameters", "estimates", "sets", "registration"].map(|key| report[key].clone())
}

/// `identify` and, through a recording, `replay` of the same files.
fn both_ways(sandbox: &Sandbox, files: &[&str]) -> [Ended; 2] {
    let mode = ["--mode", "only_calibration", "--json"];
    let identified = sandbox.run([&["identify"], files, &mode].concat());
    let ended = sandbox.run([&["export", "mcap", "--force", "--out", "again.mcap"], files].concat());
    assert_eq!(ended.code, Some(0), "{ended:?}");
    [identified, sandbox.run([&["replay", "again.mcap"][..], &mode].concat())]
}

#[test]
fn a_session_file_makes_identify_the_replay_of_the_same_recording() {
    let sandbox = exported();
    let files = [
        "--model",
        "t/robot.toml",
        "--measurements",
        "t/identification.csv",
        "--verify",
        "t/verification.csv",
        "--session",
        "t/session.toml",
    ];
    let [identified, replayed] = both_ways(&sandbox, &files);
    assert_eq!(identified.code, replayed.code, "{identified:?}");
    assert!(found(&identified) == found(&replayed), "the estimates differ");
    for line in [
        "station 1: placed by 7 nests of t/session.toml, 77 readings\n",
        "target SMR: stated by t/session.toml, +- 0.01 mm per axis\n",
        "targets are taken from t/session.toml, not from t/robot.toml\n",
    ] {
        assert!(identified.stderr.contains(line), "{line}: {}", identified.stderr);
    }
    // It is another question than without: the base's own parameters are told by the nests.
    let [identified, replayed] = both_ways(&sandbox, &files[..6]);
    assert!(found(&identified) == found(&replayed), "the estimates differ");
    let told =
        "target SMR: identified, starting from the offset that t/robot.toml states without an uncertainty\n";
    assert!(identified.stderr.contains(told), "{}", identified.stderr);
    assert!(
        identified.stderr.contains("station 1: identified, because no nests are stated\n"),
        "{}",
        identified.stderr
    );
    let base =
        |ended: &Ended| ended.stdout.contains("\"delta_theta1\"") || ended.stdout.contains("\"delta_a1\"");
    assert!(!base(&identified), "along with the frame it has no meaning");
}

#[test]
fn a_session_file_tells_choose_what_it_tells_identify() {
    let sandbox = exported();
    let files = ["--model", "t/robot.toml", "--measurements", "t/identification.csv"];
    let session = ["--session", "t/session.toml"];
    let [with, without] = [&session[..], &[]]
        .map(|session| sandbox.run([&["choose"][..], &files, session, &["--folds", "3", "--json"]].concat()));
    for ended in [&with, &without] {
        assert_eq!(ended.code, Some(0), "{ended:?}");
    }
    for line in [
        "station 1: placed by 7 nests of t/session.toml, 77 readings\n",
        "target SMR: stated by t/session.toml, +- 0.01 mm",
    ] {
        assert!(with.stderr.contains(line) && !without.stderr.contains(line), "{line}: {with:?}");
    }
    // The nests tell the base's own parameters from the frame: without them they have no meaning.
    let parameters = |ended: &Ended| ended.json()["models"][0]["parameters"].as_u64().expect("a number");
    assert!(parameters(&with) > parameters(&without), "{with:?}");
}

const UR5: &str = "models/ur5/robot.toml";
/// Where three reflectors are on the flange, m.
const REFLECTORS: [(&str, [f64; 3]); 3] =
    [("A", [0.05, 0.03, 0.12]), ("B", [-0.06, 0.01, 0.08]), ("C", [0.01, -0.07, 0.1])];

/// Readings of these reflectors in turn, with a noise of 20 um that they state, by a UR5 whose upper arm is 1 mm longer than drawn.
fn write_readings(sandbox: &Sandbox, file: &str, reflectors: &[usize], first: u32, column: bool) {
    let mut real = load_robot(&sandbox.path(UR5)).expect("the shipped robot").model.kinematics;
    real.links[2].a += 1e-3;
    let mut text =
        "pose,q1_rad,q2_rad,q3_rad,q4_rad,q5_rad,q6_rad,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m".to_owned();
    text += if column { ",target\n" } else { "\n" };
    let mut noise = stream(5, first, Stream::IdentificationNoise);
    for (pose, reflector) in (first..).zip(reflectors) {
        let q: Vec<f64> = [0.8731, 0.7623, 0.6655, 0.5810, 0.5072, 0.4428]
            .iter()
            .map(|step| 2.4 * ((f64::from(pose) * step) % 1.0) - 1.2)
            .collect();
        let (name, at) = REFLECTORS[*reflector];
        let at = forward_kinematics(&real, &q).expect("six joints") * Point3::from(at);
        let _ = write!(text, "{pose}");
        for value in q {
            let _ = write!(text, ",{value:?}");
        }
        for value in at.iter() {
            let error: f64 = StandardNormal.sample(&mut noise);
            let _ = write!(text, ",{:?}", value + 2e-5 * error);
        }
        text += ",2e-5,2e-5,2e-5";
        let _ = if column { writeln!(text, ",{name}") } else { writeln!(text) };
    }
    sandbox.write(file, text);
}

/// Adds this to the UR5's file.
fn state(sandbox: &Sandbox, lines: &str) -> String {
    let text = sandbox.read(UR5);
    sandbox.write("models/ur5/stated.toml", format!("{text}\n{lines}"));
    "models/ur5/stated.toml".to_owned()
}

/// Estimate, standard deviation and that of its prior, of a parameter of a report.
fn parameter(ended: &Ended, name: &str) -> (f64, Option<f64>) {
    let report = ended.json();
    let parameters = report["parameters"].as_array().expect("a list").clone();
    let one = parameters.iter().find(|p| p["name"] == name).unwrap_or_else(|| panic!("no {name}"));
    (one["estimate"].as_f64().expect("a number"), one["sigma"].as_f64())
}

#[test]
fn measured_targets_are_priors_beside_others_that_are_identified() {
    let sandbox = Sandbox::new();
    let turns: Vec<usize> = (0..90).map(|pose| pose % 3).collect();
    write_readings(&sandbox, "fit.csv", &turns, 1, true);
    // The order in which they are first seen is another one.
    let others: Vec<usize> = (0..30).map(|pose| 2 - pose % 3).collect();
    write_readings(&sandbox, "verify.csv", &others, 200, true);
    let model = state(
        &sandbox,
        "[[target]]\nname = \"A\"\nx_mm = 50.01\ny_mm = 30\nz_mm = 120\nsigma_mm = 0.02\n\
         [[target]]\nname = \"B\"\nx_mm = -60\ny_mm = 12\nz_mm = 80\n\
         [[target]]\nname = \"spare\"\nx_mm = 0\ny_mm = 0\nz_mm = 90\nsigma_mm = 0.01\n",
    );
    let files = ["--model", &model, "--measurements", "fit.csv", "--verify", "verify.csv"];
    let [identified, replayed] = both_ways(&sandbox, &files);
    assert_eq!(identified.code, Some(0), "{identified:?}");
    assert!(found(&identified) == found(&replayed), "the estimates differ");
    for line in [
        "target A: stated by models/ur5/stated.toml, +- 0.02 mm per axis\n",
        "target B: identified, starting from the offset that models/ur5/stated.toml states without an uncertainty\n",
        "target C: identified, because nothing is stated about it\n",
        "target spare of models/ur5/stated.toml: no reading names it, and it is left out\n",
    ] {
        assert!(identified.stderr.contains(line), "{line}: {}", identified.stderr);
    }
    let (a, sigma) = parameter(&identified, "target_x");
    assert!(a.abs() < 6e-5 && sigma < Some(2.01e-5), "{a} {sigma:?}");
    let (b, sigma) = parameter(&identified, "target2_y");
    assert!((b + 2e-3).abs() < 5.0 * sigma.expect("a regular system"), "{b} {sigma:?}");
    let (c, sigma) = parameter(&identified, "target3_z");
    assert!((c - 0.1).abs() < 5.0 * sigma.expect("a regular system"), "{c} {sigma:?}");
    // 20 um an axis, also of poses that were held out: names tell which target it is.
    let report = identified.json();
    let rms = &report["sets"]["verification"]["rows"]["only_calibration"]["rms_3d_m"];
    assert!(rms.as_f64() < Some(6e-5), "{rms}");
}

#[test]
fn the_same_statement_in_either_file_is_the_same() {
    let sandbox = Sandbox::new();
    write_readings(&sandbox, "fit.csv", &[0; 60], 1, false);
    let model = state(&sandbox, "[target]\nx_mm = 50\ny_mm = 30\nz_mm = 120\nsigma_mm = 0.02\n");
    let of_robot = sandbox.run([
        "identify",
        "--json",
        "--model",
        &model,
        "--measurements",
        "fit.csv",
        "--mode",
        "only_calibration",
    ]);
    assert!(
        of_robot.stderr.contains("target 1: stated by models/ur5/stated.toml, +- 0.02 mm per axis\n"),
        "{of_robot:?}"
    );
    sandbox.write(
        "s.toml",
        "schema = \"calibrig.session/1\"\n[[target]]\nname = \"SMR\"\nin_flange_m = [0.05, 0.03, 0.12]\nsigma_m = 2e-5\n",
    );
    let arguments =
        ["identify", "--json", "--model", UR5, "--measurements", "fit.csv", "--mode", "only_calibration"];
    let of_session = sandbox.run([&arguments[..], &["--session", "s.toml"]].concat());
    assert!(
        of_session.stderr.contains("target SMR: stated by s.toml, +- 0.02 mm per axis\n"),
        "{of_session:?}"
    );
    assert!(found(&of_robot) == found(&of_session), "the estimates differ");
    let free = sandbox.run(arguments);
    assert!(free.stderr.contains("target 1: identified, because nothing is stated about it\n"), "{free:?}");
    assert!(found(&free) != found(&of_robot));
}

/// Its nominal flange's origin does not move: the stated target does.
#[test]
fn a_positioner_with_crossing_axes_starts_from_its_target() {
    let sandbox = Sandbox::new();
    let joint = |name: &str, alpha: &str, d: &str| {
        format!(
            "[[joint]]\nname = \"{name}\"\ntype = \"revolute\"\na_mm = 0\nalpha_deg = {alpha}\nd_mm = {d}\ntheta_deg = 0\n\
             min_deg = -360\nmax_deg = 360\n"
        )
    };
    let bare = format!(
        "schema = \"calibrig.robot/1\"\nname = \"positioner\"\nconvention = \"craig\"\n{}{}[actuators]\nkind = \"direct\"\n",
        joint("J1", "0", "700"),
        joint("J2", "-90", "0")
    );
    sandbox.write("bare.toml", &bare);
    sandbox.write("p.toml", format!("{bare}[target]\nx_mm = 400\ny_mm = 100\nz_mm = 200\n"));
    // The tracker at (-3, 0.5, 0) of the base, turned by nothing; the target 1 mm from where it is stated in x.
    let mut text = "q1_rad,q2_rad,x_m,y_m,z_m\n".to_owned();
    for (q1, q2) in (0..12).map(|pose| (f64::from(pose % 3) - 1.0, f64::from(pose / 3) - 1.0)) {
        let [x, y, z] = [0.401, 0.1, 0.2];
        let radius = x * q2.cos() - y * q2.sin();
        let height = 0.7 - (x * q2.sin() + y * q2.cos());
        let _ = writeln!(
            text,
            "{q1},{q2},{:.6},{:.6},{height:.6}",
            3.0 + radius * q1.cos() - z * q1.sin(),
            -0.5 + radius * q1.sin() + z * q1.cos()
        );
    }
    sandbox.write("m.csv", text);
    let ended = sandbox.run(["identify", "--model", "p.toml", "--measurements", "m.csv", "--json"]);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let report = ended.json();
    let estimate = &report["estimates"]["only_calibration"];
    assert_eq!((&estimate["rank"], &estimate["parameter_count"]), (&11.into(), &11.into()));
    let rms = &report["sets"]["identification"]["rows"]["only_calibration"]["rms_3d_m"];
    // The readings have six digits.
    assert!(rms.as_f64() < Some(1e-6), "{rms}");
}

/// Readings of one reflector that no column names, and of two that one names.
fn of_one_and_of_two() -> Sandbox {
    let sandbox = Sandbox::new();
    write_readings(&sandbox, "one.csv", &[0; 40], 1, false);
    let turns: Vec<usize> = (0..40).map(|pose| pose % 2).collect();
    write_readings(&sandbox, "two.csv", &turns, 1, true);
    sandbox
}

#[test]
fn a_session_file_that_cannot_be_used_is_refused_at_its_line() {
    let sandbox = of_one_and_of_two();
    let nest = |x: u8| {
        format!(
            "[[station.nest]]\nname = \"n{x}\"\nin_base_m = [{x}, 0, 0]\nin_base_sigma_m = 1e-5\nposition_m = [{x}, 0, 0]\nsigma_m = 1e-5\n"
        )
    };
    let target = |name: &str, more: &str| {
        format!("[[target]]\nname = \"{name}\"\nin_flange_m = [0, 0, 0.1]\n{more}\n")
    };
    for (measured, session, place, message, expected) in [
        (
            "one.csv",
            format!("[[station]]\nname = \"s\"\n{}{}", nest(1), nest(2)),
            "s.toml:3: ",
            "2 base nests were measured: placing the tracker needs at least 3",
            "or no nests",
        ),
        (
            "one.csv",
            format!("[[station]]\nname = \"s\"\n{}{}{}", nest(1), nest(2), nest(3)),
            "s.toml:3: ",
            "the base nests lie on one line",
            "not on one line",
        ),
        ("one.csv", target("A", "sigma_m = -1e-5"), "s.toml:5: ", "sigma_m is -1e-5", "zero or more"),
        ("one.csv", target("A", "sigma_m = nan"), "s.toml:5: ", "sigma_m is nan", "a finite number"),
        (
            "one.csv",
            target("A", "sigma_m = 0"),
            "s.toml:3: ",
            "its uncertainty is not above zero",
            "or neither",
        ),
        ("one.csv", target("A", "sigma_kg = 0.02"), "s.toml:5: ", "unknown key `sigma_kg`", "`sigma_m`"),
        (
            "one.csv",
            target("A", "") + &target("A", ""),
            "s.toml:7: ",
            "target \"A\" appears twice",
            "distinct names",
        ),
        (
            "one.csv",
            target("A", "") + &target("B", ""),
            "s.toml:3: ",
            "does not name its target, but 2 are described",
            "a column target",
        ),
        (
            "two.csv",
            target("A", ""),
            "s.toml:3: ",
            "target \"B\" of the identification set is not described",
            "name = \"B\"; described are A",
        ),
        (
            "two.csv",
            target("SMR-1", ""),
            "s.toml:3: ",
            "target \"A\" of the identification set is not described",
            "described are SMR-1",
        ),
    ] {
        sandbox.write("s.toml", format!("schema = \"calibrig.session/1\"\n{session}"));
        let arguments = ["identify", "--model", UR5, "--measurements", measured, "--session", "s.toml"];
        assert_refused(&sandbox, &arguments, place, message, expected);
    }
    let arguments = ["identify", "--model", UR5, "--measurements", "one.csv", "--session", "none.toml"];
    assert_refused(&sandbox, &arguments, "cannot read none.toml", "No such file", "a text file in UTF-8");
}

#[test]
fn targets_of_the_robots_file_that_cannot_be_used_are_refused_at_their_line() {
    let sandbox = of_one_and_of_two();
    let lines = sandbox.read(UR5).lines().count();
    let at = "x_mm = 1\ny_mm = 2\nz_mm = 3\n";
    for (measured, stated, line, message, expected) in [
        ("one.csv", format!("[target]\n{at}sigma_mm = -1\n"), 6, "target.sigma_mm is -1", "above zero"),
        (
            "one.csv",
            format!("[[target]]\nname = \"A\"\n{at}[[target]]\nname = \"B\"\n{at}"),
            2,
            "one.csv does not name which one",
            "a column target",
        ),
        (
            "two.csv",
            format!("[[target]]\nname = \"SMR\"\n{at}"),
            2,
            "no reading names a stated target, SMR; measured are A, B",
            "--session",
        ),
        (
            "two.csv",
            format!("[target]\n{at}sigma_mm = 0.02\n"),
            3,
            "the target has no name, but 2 are measured: A, B",
            "name = ",
        ),
    ] {
        let model = state(&sandbox, &stated);
        let found = sandbox.run(["identify", "--model", &model, "--measurements", measured]);
        assert_eq!((found.code, found.stdout.as_str()), (Some(1), ""), "{stated}: {found:?}");
        let first = found.stderr.lines().next().unwrap_or_default();
        let number = first.split(':').nth(2).and_then(|number| number.parse::<usize>().ok());
        let number = number.unwrap_or_else(|| panic!("no line in {first}"));
        assert_eq!(number, lines + line, "{stated}: {first}");
        assert!(first.contains(message), "{message}: {first}");
        assert!(found.stderr.contains(expected), "{expected}: {}", found.stderr);
    }
}

#[test]
fn a_column_that_names_every_shot_is_refused() {
    let sandbox = of_one_and_of_two();
    let text = sandbox.read("two.csv");
    let mut shot = 0;
    let named: Vec<String> = text
        .lines()
        .map(|line| match line.rsplit_once(',') {
            Some((rest, "A" | "B")) => {
                shot += 1;
                format!("{rest},P{shot}")
            }
            _ => line.to_owned(),
        })
        .collect();
    sandbox.write("shots.csv", named.join("\n") + "\n");
    assert_refused(
        &sandbox,
        &["identify", "--model", UR5, "--measurements", "shots.csv"],
        "shots.csv:2: ",
        "40 targets with one reading each say nothing about the robot: the column target names the shot",
        "no target column",
    );
}
