//! Parameters that are listed, fixed and freed by name, in `identify` as in scenarios; and the residuals of what was fitted.

use std::collections::HashMap;

use crate::a_user_makes_a_mistake::with_measurements;
use crate::sandbox::{Ended, ROBOT, SCENARIO, Sandbox};

fn identify(sandbox: &Sandbox, more: &[&str]) -> Ended {
    let measured = ["identify", "--model", ROBOT, "--measurements", "set.csv", "--mode", "only_calibration"];
    sandbox.run([&measured[..], more].concat())
}

/// Names of the parameters of a listed mode by what becomes of them.
fn listed(ended: &Ended) -> HashMap<String, Vec<String>> {
    let json = ended.json();
    assert_eq!(json["schema"], "calibrig.parameters/1");
    let mut by_state: HashMap<String, Vec<String>> = HashMap::new();
    for parameter in json["modes"][0]["parameters"].as_array().expect("a list") {
        let text = |key: &str| parameter[key].as_str().expect("a text").to_owned();
        by_state.entry(text("state")).or_default().push(text("name"));
    }
    by_state
}

fn fitted(ended: &Ended) -> Vec<String> {
    let json = ended.json();
    let parameters = json["parameters"].as_array().expect("a list");
    parameters.iter().map(|p| p["name"].as_str().expect("a name").to_owned()).collect()
}

#[test]
fn they_are_listed_and_what_is_listed_is_fitted() {
    let sandbox = with_measurements("set.csv");
    for more in [&[][..], &["--parameters", "neighbour_axis_rules"], &["--parameters", "delta_a2,delta_d3"]] {
        let ended = identify(&sandbox, &[more, &["--list-parameters", "--json"]].concat());
        assert_eq!(ended.code, Some(0), "{ended:?}");
        let listed = listed(&ended);
        let fitted = fitted(&identify(&sandbox, &[more, &["--json"]].concat()));
        assert_eq!(listed["fitted"], fitted, "{more:?}");
        assert!(!listed["not_chosen"].is_empty());
    }
    let text = identify(&sandbox, &["--list-parameters", "--fix", "delta_a2"]).stdout;
    for line in [
        "only calibration (only_calibration): ",
        "delta_a2      left out: fixed by name",
        "not chosen: fit it with --free",
    ] {
        assert!(text.contains(line), "{line}: {text}");
    }
}

#[test]
fn they_are_fixed_and_freed() {
    let sandbox = with_measurements("set.csv");
    let fixed = identify(&sandbox, &["--fix", "delta_a2,target_z", "--json"]);
    let names = fitted(&fixed);
    assert!(!names.contains(&"delta_a2".to_owned()) && !names.contains(&"target_z".to_owned()), "{names:?}");
    assert!(names.contains(&"target_x".to_owned()));
    let left_out = fixed.json()["estimates"]["only_calibration"]["left_out"].clone();
    let by_name = left_out.as_array().expect("a list").iter().filter(|left| left["reason"] == "fixed");
    assert_eq!(by_name.map(|left| &left["name"]).collect::<Vec<_>>(), ["delta_a2", "target_z"]);
    let whole = identify(&sandbox, &["--target", "fixed", "--json"]);
    assert!(fitted(&whole).iter().all(|name| !name.starts_with("target")), "{whole:?}");
    let not_chosen = listed(&identify(&sandbox, &["--list-parameters", "--json"]))["not_chosen"][0].clone();
    let freed = fitted(&identify(&sandbox, &["--free", &not_chosen, "--json"]));
    assert!(freed.contains(&not_chosen), "{not_chosen}: {freed:?}");
}

#[test]
fn a_wrong_name_is_wrong_usage() {
    let sandbox = with_measurements("set.csv");
    for (more, message) in [
        (&["--fix", "delta_q2"][..], "expected a name such as delta_a2"),
        (&["--fix", "delta_a9"], "--fix delta_a9: delta_a9 is not a parameter of this robot"),
        (&["--fix", "frame_x"], "fixed or free as a whole"),
        (&["--free", "compliance_drive3"], "cannot be fitted in any of the modes (only_calibration)"),
        (&["--fix", "delta_a2", "--free", "delta_a2"], "listed both as fixed and as free"),
        (&["--parameters", "delta_a2,best"], "'best' for '--parameters <WHICH,..>': expected complete"),
        (&["--target", "loose"], "possible values"),
    ] {
        let ended = identify(&sandbox, more);
        assert_eq!((ended.code, ended.stdout.as_str()), (Some(2), ""), "{more:?}: {ended:?}");
        assert!(ended.stderr.contains(message), "{message}: {}", ended.stderr);
    }
}

#[test]
fn scenarios_have_the_same_words() {
    let sandbox = Sandbox::new();
    let modes = "modes = [\"without_calibration\", \"only_calibration\"]";
    let write = |keys: &str| {
        let text = sandbox.read(SCENARIO);
        let (before, behind) = text.split_once("[identification]\n").expect("the section");
        let (_, behind) = behind.split_once('\n').expect("its modes");
        sandbox.write(
            "s.toml",
            format!("{before}[identification]\n{modes}\n{keys}\n{behind}").replace("\"../models", "\"models"),
        );
    };
    write("fix = [\"delta_a2\"]\nfree = [\"delta_d3\"]");
    let json = sandbox.run(["run", "s.toml", "--out", "out", "--json"]);
    let names = fitted(&json);
    assert!(!names.contains(&"delta_a2".to_owned()) && names.contains(&"delta_d3".to_owned()), "{names:?}");
    for (keys, message) in [
        ("fix = [\"delta_q2\"]", "identification.fix: \"delta_q2\" is not the name of a parameter"),
        ("free = [\"ratio_d5\"]", "ratio_d5 cannot be fitted in any of the modes"),
    ] {
        write(keys);
        let ended = sandbox.run(["check", "s.toml"]);
        assert_eq!(ended.code, Some(1), "{ended:?}");
        assert!(
            ended.stderr.contains(message) && ended.stderr.contains("s.toml:"),
            "{message}: {}",
            ended.stderr
        );
    }
}

#[test]
fn every_reading_has_its_residual() {
    let sandbox = with_measurements("set.csv");
    let ended = identify(&sandbox, &["--verify", "set.csv", "--loss", "huber", "--out", "out", "--json"]);
    let json = ended.json();
    let mut reader = csv::Reader::from_path(sandbox.path("out/residuals.csv")).expect("a table");
    let rows: Vec<HashMap<String, String>> = reader.deserialize().map(|row| row.expect("a row")).collect();
    let of = |mode: &str, set: &str| {
        rows.iter().filter(|row| row["mode"] == mode && row["set"] == set).collect::<Vec<_>>()
    };
    for (mode, set) in [
        ("without_calibration", "identification"),
        ("only_calibration", "identification"),
        ("only_calibration", "verification"),
    ] {
        let rows = of(mode, set);
        let number = |row: &HashMap<String, String>, key: &str| row[key].parse::<f64>().expect("a number");
        let squares: f64 = rows.iter().map(|row| number(row, "norm_m").powi(2)).sum();
        let rms = (squares / rows.len() as f64).sqrt();
        let stated = json["sets"][set]["rows"][mode]["rms_3d_m"].as_f64().expect("a row");
        assert!((rms - stated).abs() < 1e-12, "{mode} {set}: {rms} {stated}");
        if mode != "only_calibration" {
            assert!(rows.iter().all(|row| row["standardised"].is_empty()));
            continue;
        }
        for (row, listed) in
            rows.iter().zip(json["estimates"][mode]["residuals"][set].as_array().expect("a list"))
        {
            assert_eq!(number(row, "x_m"), listed["error_m"][0].as_f64().expect("a number"));
            assert_eq!(number(row, "pose"), listed["pose"].as_f64().expect("a number"));
            // The shipped set holds what a tracker reads.
            let (range, norm) = (number(row, "range_m"), number(row, "norm_m"));
            assert!(range.abs() <= norm + 1e-9 && listed["range_m"].as_f64() == Some(range), "{row:?}");
            let weight = listed["weight"].as_f64();
            assert_eq!(weight.is_some(), set == "identification");
            assert!(weight.is_none_or(|weight| weight > 0.0 && weight <= 1.0));
        }
        // In standard deviations by which the fit weighs readings; of 24 and more parameters some of the size is taken by the fit.
        let sizes: f64 = rows.iter().map(|row| number(row, "standardised").powi(2)).sum();
        let size = (sizes / rows.len() as f64).sqrt();
        assert!((0.4..1.6).contains(&size), "{mode} {set}: {size}");
    }
}

#[test]
fn a_loss_is_called_so_in_every_command() {
    let sandbox = Sandbox::new();
    let recording = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/paper.mcap");
    std::fs::copy(recording, sandbox.path("r.mcap")).expect("copied");
    let replay = |flag: &str| sandbox.run(["replay", "r.mcap", "--mode", "only_calibration", flag, "huber"]);
    let [now, before] = ["--loss", "--robust"].map(replay);
    assert_eq!((now.code, &now.stdout), (before.code, &before.stdout));
    assert!(!now.stderr.contains("--robust"), "{}", now.stderr);
    assert!(before.stderr.contains("--robust is now called --loss,"), "{}", before.stderr);
}
