//! A user who measures with and without a load on the flange, so that stiffnesses can be told.

use std::ops::ControlFlow;
use std::path::Path;

use calibrig::evaluation::Cause;
use calibrig::identification::{Estimate, IdentificationOptions, Mode, Warning, identify};
use calibrig::model::{CalibrationModel, Compliance, ParameterId};
use calibrig::pipeline::{Outcome, PlantKind, run_trial};
use calibrig::plant::session::{PayloadOrder, PayloadPlan};
use calibrig::scenario::{Scenario, load_scenario};

use crate::sandbox::Sandbox;

const SCENARIO: &str = "scenarios/payloads.toml";

fn scenario() -> Scenario {
    load_scenario(Path::new(SCENARIO)).expect("a shipped scenario")
}

fn run(scenario: &Scenario, seed: u64) -> Outcome {
    run_trial(scenario, seed, 0, PlantKind::Rapier, &mut |_| ControlFlow::Continue(())).expect("a run")
}

fn coupled(outcome: &Outcome) -> &Estimate {
    outcome.modes.last().and_then(|mode| mode.estimate.as_ref()).expect("an estimate")
}

/// Of the compliance of a drive: estimate and standard deviation, relative.
fn of(estimate: &Estimate, compliance: Compliance) -> (f64, f64) {
    let id = ParameterId::Compliance(compliance);
    let found = estimate.parameters.iter().find(|p| p.id == id);
    found.and_then(|p| Some((p.value, p.sigma?))).unwrap_or_else(|| panic!("{id}"))
}

/// Of 60 poses a third each with nothing, 25 and 50 kg: the drives that gravity loads are known to 2 % (one sigma), from guesses that may be off by their own
/// size; all are within five standard deviations of the machine's.
#[test]
fn payloads_tell_stiffnesses_that_poses_alone_do_not() {
    let loaded = scenario();
    let mut bare = loaded.clone();
    bare.plan.payloads = PayloadPlan::default();
    let drives = [2, 3, 4, 5, 6].map(|joint| Compliance::Drive { joint });
    let all: Vec<_> = drives.into_iter().chain([Compliance::Rod]).collect();
    let [with, without] = [&loaded, &bare].map(|scenario| run(scenario, scenario.seed));
    let json = serde_json::to_value(calibrig::report::json_report(&with)).expect("a report");
    let truth = json["parameters"].as_array().expect("a list");
    println!("standard deviation of compliances, % of their stated values; 60 poses, prior 100 %");
    println!("{:<20} {:>12} {:>18} {:>8}", "", "no payload", "0, 25 and 50 kg", "gain");
    for compliance in &all {
        let [(value, loaded), (_, bare)] = [&with, &without].map(|outcome| of(coupled(outcome), *compliance));
        let id = ParameterId::Compliance(*compliance);
        println!("{id:<20} {:>12.2} {:>18.2} {:>8.1}", 1e2 * bare, 1e2 * loaded, bare / loaded);
        assert!(loaded < bare, "{id}: a load tells of every drive");
        let truth = truth.iter().find(|p| p["name"] == id.to_string()).expect("in the report");
        let error = value - truth["truth"].as_f64().expect("a simulation");
        assert!(error.abs() < 5.0 * loaded, "{id}: off by {error}, stated {loaded}");
    }
    // The telescope carries little of any load along itself, and the rod stands behind the elbow's drive: these are the others.
    for joint in [2, 3, 5, 6] {
        let drive = Compliance::Drive { joint };
        assert!(of(coupled(&with), drive).1 <= 0.02, "{drive:?}");
    }
    assert!(of(coupled(&without), Compliance::Drive { joint: 6 }).1 > 0.02, "poses alone tell the wrist's");
    for (outcome, title) in [(&with, "with payloads"), (&without, "without")] {
        let row = outcome.modes.last().and_then(|mode| mode.rows[1]).expect("held-out poses");
        println!("held-out RMS {title}: {:.4} mm", 1e3 * row.rms_3d);
    }
}

/// A model in which nothing yields leaves what the loads do, and it is named.
#[test]
fn what_a_load_does_is_named_where_the_model_does_not_know_it() {
    let mut scenario = scenario();
    scenario.plan.payloads.order = PayloadOrder::Cycle;
    scenario.modes = vec![Mode::WithoutCalibration, Mode::OnlyCalibration];
    let outcome = run(&scenario, scenario.seed);
    let consistency = &outcome.judgements[0].consistency;
    let shape = consistency.shape.as_ref().expect("degrees of freedom");
    println!("{consistency}");
    assert_eq!(shape.patterns.first().map(|pattern| pattern.cause), Some(Cause::Payload), "{consistency}");
    let page = calibrig::report::html_report(&outcome).expect("a page");
    assert!(page.contains("varies with the payload") && page.contains("mass of the payload, kg"));
    // The same without loads has no such cause.
    scenario.plan.payloads = PayloadPlan::default();
    let bare = run(&scenario, scenario.seed);
    let shape = bare.judgements[0].consistency.shape.as_ref().expect("degrees of freedom");
    assert!(shape.tested.iter().all(|(cause, _)| *cause != Cause::Payload));
}

/// The loads that poses carried are told, on the terminal and in JSON.
#[test]
fn reports_say_which_loads_were_carried() {
    let outcome = run(&scenario(), 1);
    let text = calibrig::report::render_tables(&outcome, calibrig::report::Style::Plain);
    let words = text.split_whitespace().collect::<Vec<_>>().join(" ");
    let expected =
        "the flange carried nothing at 20 poses, 25 kg (25.0 kg) at 20 poses, 50 kg (50.0 kg) at 20 poses";
    assert!(words.contains(expected), "{text}");
    let json = serde_json::to_value(calibrig::report::json_report(&outcome)).expect("a report");
    let payloads = json["sets"]["identification"]["payloads"].as_array().expect("a list");
    assert_eq!(payloads.len(), 3);
    assert!(payloads[0]["name"].is_null() && payloads[0]["poses"] == 20, "{payloads:?}");
    assert_eq!((&payloads[2]["mass_kg"], &payloads[2]["poses"]), (&50.0.into(), &20.into()));
    assert_eq!(payloads[1]["centre_m"][2], 0.12);
}

/// Bad payloads of scenarios are refused with the place, the reason and what to do.
#[test]
fn bad_payloads_of_a_scenario_are_refused() {
    let sandbox = Sandbox::new();
    let text = sandbox.read(SCENARIO);
    for (from, to, message, help) in [
        ("mass_kg = 25\n", "", "payload \"25 kg\" has no mass", "expected mass_kg"),
        ("mass_kg = 25\n", "mass_kg = -25\n", "mass_kg is -25", "zero or more"),
        ("mass_kg = 25\n", "mass_kg = inf\n", "mass_kg is inf", "a finite number"),
        ("mass_kg = 25\n", "mass = 25\n", "unknown key `mass`", "mass_kg"),
        ("z_mm = 120\n", "", "payload \"25 kg\" has no centre", "z_mm"),
        ("mass_kg = 25\n", "mass_kg = 25\nmass_factor = 0\n", "mass_factor is 0", "above zero"),
        (
            "identification = [\"none\", \"25 kg\"",
            "identification = [\"none\", \"25kg\"",
            "names \"25kg\"",
            "most likely \"25 kg\"",
        ),
        (
            "[carried]\nidentification = [\"none\", \"25 kg\", \"50 kg\"]\nverification = [\"none\", \"25 kg\", \"50 kg\"]\norder = \"blocks\"\n",
            "",
            "no pose carries this payload",
            "[carried]",
        ),
        (
            "name = \"50 kg\"",
            "name = \"25 kg\"",
            "a second payload \"25 kg\"",
            "a different name for each payload",
        ),
        ("order = \"blocks\"", "order = \"block\"", "block", "blocks"),
    ] {
        assert!(text.contains(from), "{from}");
        sandbox.write(SCENARIO, text.replacen(from, to, 1));
        let ended = sandbox.run(["check", SCENARIO]);
        let told = ended.stderr.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(ended.code == Some(2) || ended.code == Some(1), "{ended:?}");
        assert!(told.contains(message) && told.contains(help) && told.contains("payloads.toml:"), "{told}");
    }
}

/// By files alone: recorded and replayed bit for bit, written as text and identified again to the same bits; a robot without springs says that it
/// does not use them.
#[test]
fn payloads_go_through_recordings_and_files() {
    let sandbox = Sandbox::new();
    let checked = sandbox.run(["check", SCENARIO]);
    let expected = "payloads     identification: nothing, 25 kg (25.0 kg), 50 kg (50.0 kg); in sequence";
    assert!(checked.stdout.contains(expected), "{checked:?}");
    let ran = sandbox.run(["run", SCENARIO, "--out", "out", "--json"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    assert!(sandbox.read("out/report.html").contains("Payload, identification set"));
    let inspected = sandbox.run(["inspect", "out/recording.mcap"]);
    let carried = "identification carried nothing at 20 poses, 25 kg (25.0 kg) at 20 poses, 50 kg (50.0 kg) at 20 poses";
    assert!(inspected.stdout.contains(carried), "{inspected:?}");
    let json = sandbox.run(["inspect", "out/recording.mcap", "--json"]).json();
    assert_eq!(json["sets"][0]["payloads"], ran.json()["sets"]["identification"]["payloads"]);
    let replayed = sandbox.run(["replay", "out/recording.mcap"]);
    assert_eq!(replayed.code, Some(0), "{replayed:?}");
    let exported = sandbox.run(["export", "csv", "out/recording.mcap", "--out", "tables"]);
    assert_eq!(exported.code, Some(0), "{exported:?}");
    let rows = sandbox.read("tables/identification.csv");
    assert!(
        rows.lines().next().is_some_and(|header| header.contains("payload,payload_mass_kg,payload_x_m")),
        "{rows}"
    );
    assert_eq!(rows.lines().filter(|row| row.contains(",50 kg,50.0,0.2,0.0,0.145,")).count(), 20, "{rows}");
    let back = "export mcap --model tables/robot.toml --measurements tables/identification.csv --verify tables/verification.csv \
                --session tables/session.toml --out back.mcap";
    let back = sandbox.run(back.split_whitespace());
    assert_eq!(back.code, Some(0), "{back:?}");
    let again = sandbox.run(["export", "csv", "back.mcap", "--out", "again"]);
    assert_eq!(again.code, Some(0), "{again:?}");
    assert_eq!(sandbox.read("again/identification.csv"), rows);

    // What all poses carry stands in the session file, and not in the measurements as well.
    let session = sandbox.read("tables/session.toml");
    let plate = "\n[[payload]]\nname = \"plate\"\nmass_kg = 10\nx_mm = 0\ny_mm = 0\nz_mm = 60\n";
    sandbox.write("tables/loaded.toml", session + plate);
    let loaded = "export mcap --model tables/robot.toml --measurements tables/identification.csv --session tables/loaded.toml --out loaded.mcap";
    let twice = sandbox.run(loaded.split_whitespace());
    let words = twice.stderr.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(
        words.contains("payload \"plate\" is said to be carried by all poses of the identification set"),
        "{twice:?}"
    );
    sandbox.write("tables/identification.csv", without_payloads(&rows));
    let ended = sandbox.run(loaded.split_whitespace());
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let inspected = sandbox.run(["inspect", "loaded.mcap"]);
    assert!(inspected.stdout.contains("identification carried plate (10.0 kg) at 60 poses"), "{inspected:?}");
}

/// The same rows, of which no column says what the flange carries.
fn without_payloads(rows: &str) -> String {
    let header = rows.lines().next().expect("a header");
    let kept: Vec<bool> = header.split(',').map(|name| !name.starts_with("payload")).collect();
    let keep = |row: &str| {
        let cells = row.split(',').zip(&kept).filter(|(_, kept)| **kept).map(|(cell, _)| cell);
        cells.collect::<Vec<_>>().join(",") + "\n"
    };
    rows.lines().map(keep).collect()
}

/// A robot whose model has nothing that yields is not moved by a payload, which is told once; one that yields is silent.
#[test]
fn a_robot_without_springs_says_that_it_does_not_use_payloads() {
    let scenario = scenario();
    let outcome = run(&scenario, 1);
    let set = &outcome.sets[0].measurements;
    let told = |model: &CalibrationModel| {
        let options = IdentificationOptions { mode: Mode::OnlyCalibration, ..scenario.options.clone() };
        let estimate = identify(model, set, &options).expect("an estimate");
        let idle = estimate.warnings.iter().filter(|w| matches!(w, Warning::IdlePayloads { .. }));
        idle.map(ToString::to_string).collect::<Vec<_>>()
    };
    let mut rigid = scenario.robot.model.clone();
    rigid.statics.as_mut().expect("statics").make_rigid();
    let unknown = CalibrationModel { statics: None, ..rigid.clone() };
    for model in [&rigid, &unknown] {
        let words = told(model);
        assert_eq!(words.len(), 1, "{words:?}");
        assert!(
            words[0].contains("poses carry payloads (25 kg, 50 kg)") && words[0].contains("not used"),
            "{words:?}"
        );
    }
    assert!(told(&scenario.robot.model).is_empty());
}
