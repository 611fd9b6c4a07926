//! A user has no base nests: rail and waist are swept, and circle point analysis places the tracker.

use crate::sandbox::{Ended, Sandbox, assert_refused};

const SWEPT: &str = "scenarios/swept.toml";
const SWEEPS: &str = "[[session.sweep]]\njoint = \"rail\"\n[[session.sweep]]\njoint = \"waist\"\nfrom_deg = -50\nto_deg = 55\nplaces = 21\n";

/// The matched scenario without its nests.
fn without_nests() -> Sandbox {
    let sandbox = Sandbox::new();
    let text = sandbox.read("scenarios/matched.toml");
    let (before, nests) = text.split_once("[[tracker.nest]]").expect("nests");
    let (_, identification) = nests.split_once("# --- Identification").expect("the identification");
    let identification = identification.replace("frame = \"nests\"", "frame = \"sweeps\"");
    sandbox.write(SWEPT, format!("{before}[session]\n{SWEEPS}# --- Identification{identification}"));
    sandbox
}

fn ended_well(ended: Ended) -> Ended {
    assert_eq!(ended.code, Some(0), "{ended:?}");
    ended
}

#[test]
fn rail_and_waist_place_the_tracker_in_run_replay_and_files() {
    let sandbox = without_nests();
    let explained = ended_well(sandbox.run(["check", SWEPT]));
    assert!(explained.stdout.contains("sweeps of two axes"), "{explained:?}");
    let run = ended_well(sandbox.run(["run", SWEPT, "--json", "--out", "out"])).json();
    let sweeps = &run["sweeps"][0];
    assert_eq!(
        [&sweeps["axes"][0]["joint"], &sweeps["axes"][1]["joint"], &sweeps["axes"][1]["readings"]],
        [&serde_json::json!("rail"), &serde_json::json!("waist"), &serde_json::json!(21)]
    );
    assert_eq!(sweeps["directions_from_nominal"], 1);
    let number = |of: &serde_json::Value, key: &str| of[key].as_f64().expect(key);
    // Lines and circles within the tracker's scatter of some 10 um.
    assert!(sweeps["axes"].as_array().expect("two").iter().all(|axis| number(axis, "rms_m") < 15e-6));
    let parameters = run["parameters"].as_array().expect("parameters");
    assert!(parameters.iter().any(|p| p["name"] == "frame_x" && p["truth"].is_f64()));
    for parameter in parameters.iter().filter(|p| p["truth"].is_f64()) {
        let off = number(parameter, "estimate") - number(parameter, "truth");
        assert!(off.abs() < 4.5 * number(parameter, "sigma"), "{parameter}");
    }
    assert!(sandbox.read("out/report.html").contains("Sweeps of single axes"));

    let replayed = ended_well(sandbox.run(["replay", "out/recording.mcap"]));
    assert!(replayed.stdout.contains("identical bit for bit"), "{replayed:?}");
    assert!(replayed.stdout.contains("sweeps of rail"), "{replayed:?}");

    ended_well(sandbox.run(["export", "csv", "out/recording.mcap", "--out", "text"]));
    let files = [
        "identify",
        "--model",
        "text/robot.toml",
        "--measurements",
        "text/identification.csv",
        "--session",
        "text/session.toml",
        "--sweeps",
        "text/sweeps.csv",
        "--mode",
        "only_calibration",
        "--json",
    ];
    let identified = sandbox.run(files);
    assert!(matches!(identified.code, Some(0 | 3)), "{identified:?}");
    let identified = identified.json();
    assert_eq!(identified["sweeps"], run["sweeps"]);
    let said = &identified["estimates"]["only_calibration"]["assumptions"];
    assert!(said.to_string().contains("rail") || identified.to_string().contains("frame_x"), "{said}");
}

#[test]
fn sweeps_that_cannot_be_are_refused_with_their_key() {
    let sandbox = without_nests();
    let text = sandbox.read(SWEPT);
    for (from, to, message, expected) in [
        (
            "joint = \"waist\"\nfrom_deg",
            "joint = \"hip\"\nfrom_deg",
            "session.sweep.joint is \"hip\"",
            "rail, waist",
        ),
        ("from_deg = -50", "from_mm = -50", "joint \"waist\" turns", "from_deg and to_deg"),
        ("from_deg = -50", "from_deg = -80", "session.sweep.from_deg is -80.000", "-60.000 to 60.000"),
        ("places = 21", "places = 4", "session.sweep.places is 4", "5 to 1000"),
        ("to_deg = 55", "to_deg = -50", "does not move", "differ"),
        (
            "joint = \"waist\"\nfrom_deg = -50\nto_deg = 55",
            "joint = \"rail\"",
            "1 joints are swept",
            "rail and waist",
        ),
    ] {
        assert!(text.contains(from), "{from}");
        sandbox.write(SWEPT, text.replace(from, to));
        assert_refused(&sandbox, &["check", SWEPT], SWEPT, message, expected);
    }
    sandbox.write(SWEPT, text.replace("frame = \"sweeps\"", "frame = \"nests\""));
    assert_refused(&sandbox, &["check", SWEPT], SWEPT, "0 base nests", "sweeps");
}

/// Intervals hold as often as stated, with no nest: 150 machines drawn from the priors.
#[test]
fn intervals_hold_where_sweeps_place_the_tracker() {
    let sandbox = without_nests();
    let campaign = ["montecarlo", SWEPT, "--trials", "150", "--plant", "analytic", "--json"];
    let json = ended_well(sandbox.run(campaign)).json();
    let found =
        json["modes"].as_array().and_then(|modes| modes.iter().find(|mode| mode["parameters"].is_array()));
    let parameters = found.and_then(|mode| mode["parameters"].as_array()).unwrap_or_else(|| panic!("{json}"));
    assert!(parameters.len() > 30, "{}", parameters.len());
    for parameter in parameters {
        let interval = parameter["coverage"]["interval_99_9"].as_array().expect("an interval");
        let [least, most] = [0, 1].map(|end| interval[end].as_f64().expect("a number"));
        assert!((least..=most).contains(&0.95), "{}: {}", parameter["name"], parameter["coverage"]);
    }
}

/// What sweeps leave that no parameter explains changes along the way: it counts where steps are judged, or the fit ends short of its minimum.
#[test]
fn short_sweeps_lead_to_the_minimum_too() {
    let sandbox = without_nests();
    let text = sandbox.read(SWEPT).replace("from_deg = -50\nto_deg = 55\nplaces = 21\n", "");
    sandbox.write(SWEPT, text);
    let run = ended_well(sandbox.run(["run", SWEPT, "--json", "--out", "out"])).json();
    let stand = |key: &str, axis: usize| run["sweeps"][0][key][axis].as_f64().expect("a number");
    // The machine's axes are some mm and mrad off.
    for (axis, place) in [6.0, 1.5, 1.5].into_iter().enumerate() {
        assert!((stand("stand_m", axis) - place).abs() < 0.02, "{}", run["sweeps"]);
    }
    assert!(stand("stand_sigma_m", 0) < 1e-4 && stand("stand_sigma_m", 1) > 0.09, "{}", run["sweeps"]);
}

#[test]
fn sweeps_that_a_station_does_not_see_are_told_with_what_hides_them() {
    let sandbox = Sandbox::new();
    let text = sandbox.read("scenarios/session.toml").replace("frame = \"nests\"", "frame = \"sweeps\"");
    sandbox.write(SWEPT, format!("{text}\n{SWEEPS}"));
    let refused = sandbox.run(["run", SWEPT]);
    assert_eq!(refused.code, Some(1), "{refused:?}");
    for told in [
        "of the 36 places of the sweeps",
        "wrist hides the target from the tracker",
        "each of two sweeps needs 5 places",
    ] {
        assert!(refused.stderr.contains(told), "{told}: {refused:?}");
    }
}
