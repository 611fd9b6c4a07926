//! A user whose target has axes: a probe, or three points that make a pose.

use std::ops::ControlFlow;
use std::path::Path;

use calibrig::identification::Mode;
use calibrig::model::ParameterId;
use calibrig::nalgebra::{Rotation3, Vector3};
use calibrig::pipeline::{PlantKind, Sensor, SensorResult, compare_sensors, run_trial};
use calibrig::scenario::{Scenario, load_scenario};
use calibrig::tracker::Probe;

use crate::sandbox::{ROBOT, Sandbox};

/// The matched machine with a probe that is turned by some 100 degrees from how nobody said that it is.
fn scenario() -> Scenario {
    let mut scenario = load_scenario(Path::new("scenarios/matched.toml")).expect("a shipped scenario");
    scenario.probe = Some(Probe {
        flange_from_target: Rotation3::new(Vector3::new(0.3, -0.4, 1.7)),
        turn_sigma: 5e-5,
        mounting_sigma: None,
        noise: true,
    });
    scenario.modes = vec![Mode::WithoutCalibration, Mode::ElastoGeometric];
    scenario
}

/// The true orientation of the probe and all else within its stated uncertainty; held-out orientations within what the sensor scatters by.
#[test]
fn a_simulated_probe_is_identified_with_its_orientation() {
    let scenario = scenario();
    let outcome =
        run_trial(&scenario, scenario.seed, 0, PlantKind::Rapier, &mut |_| ControlFlow::Continue(()));
    let outcome = outcome.expect("a run");
    let mode = &outcome.modes[1];
    let estimate = mode.estimate.as_ref().expect("an estimate");
    let json = serde_json::to_value(calibrig::report::json_report(&outcome)).expect("a report");
    let parameters = json["parameters"].as_array().expect("a list");
    for axis in 0..3 {
        let id = ParameterId::Orientation { target: 0, axis };
        let found = parameters.iter().find(|p| p["name"] == id.to_string()).expect("in the report");
        let [value, sigma, truth] = ["estimate", "sigma", "truth"].map(|key| found[key].as_f64().expect(key));
        assert!((value - truth).abs() < 5.0 * sigma && sigma < 1e-3, "{id}: {found}");
    }
    assert!(
        estimate.chi2_per_dof().is_some_and(|ratio| (0.8..1.25).contains(&ratio)),
        "{:?}",
        estimate.chi2_per_dof()
    );
    let row = mode.orientation_row(1).expect("held-out orientations");
    // Three angles of 50 urad, and what the fit leaves.
    assert!((7e-5..1.4e-4).contains(&row.rms), "{row:?}");
    let nominal = outcome.modes[0].orientation_row(1).expect("orientations");
    assert!(nominal.rms > 5.0 * row.rms, "{nominal:?} against {row:?}");
    let of_json = &json["sets"]["verification"]["rows"]["elasto_geometric"]["orientation"];
    assert_eq!(of_json["rms_rad"].as_f64(), Some(row.rms));
    let text = calibrig::report::render_tables(&outcome, calibrig::report::Style::Plain);
    assert!(text.contains("angle to the measured orientation of"), "{text}");
    assert!(text.lines().all(|line| line.chars().count() <= 100), "{text}");
}

fn sigma(result: &SensorResult, id: ParameterId) -> f64 {
    let found = result.parameters.iter().find(|(own, _)| *own == id);
    found.and_then(|(_, sigma)| *sigma).unwrap_or_else(|| panic!("{id} of {:?}", result.sensor))
}

/// The rows of parameters in the table of `docs/sensors.md`: name, and the numbers of the four columns, mm, mrad or %.
fn documented() -> Vec<(String, Vec<f64>)> {
    let text = std::fs::read_to_string("docs/sensors.md").expect("the document");
    let row = |line: &str| {
        let (name, rest) = line.strip_prefix("    ")?.split_once(", ")?;
        let numbers: Vec<f64> =
            rest.split_whitespace().skip(1).filter_map(|word| word.parse().ok()).collect();
        (name.starts_with("delta_") && numbers.len() == 4).then(|| (name.to_owned(), numbers))
    };
    text.lines().filter_map(row).collect()
}

/// Three points say more than one of every parameter; their pose says as much, but of the last joint's own offset and angle, which the stated
/// mounting of the tool limits. The document says so, with the same figures.
#[test]
fn more_points_tell_more_and_their_pose_as_much() {
    let mut scenario = scenario();
    scenario.probe = Some(Probe {
        flange_from_target: Rotation3::new(100.0_f64.to_radians() * Vector3::z()),
        turn_sigma: 0.003_f64.to_radians(),
        mounting_sigma: Some(0.01_f64.to_radians()),
        noise: true,
    });
    let results = compare_sensors(&scenario, scenario.seed, Mode::ElastoGeometric, |_, _| {});
    let results = results.expect("a comparison");
    let kinds: Vec<_> = results.iter().map(|result| result.sensor).collect();
    assert_eq!(kinds, Sensor::ALL);
    let [one, three, combined, probe] = &results[..] else { panic!("four") };
    for result in &results {
        assert_eq!(result.rank, result.parameters.len(), "{:?}", result.sensor);
        assert!(result.held_out.is_some_and(|rms| rms > 0.0));
        let has_axes = matches!(result.sensor, Sensor::CombinedPose | Sensor::Probe);
        assert_eq!(result.held_out_turn.is_some(), has_axes);
    }
    let is_link = |id: &ParameterId| matches!(id, ParameterId::Link { .. });
    let links: Vec<_> = one.parameters.iter().map(|(id, _)| *id).filter(is_link).collect();
    let rows = documented();
    assert_eq!(rows.len(), links.len());
    for (id, (name, stated)) in links.into_iter().zip(rows) {
        assert_eq!(id.to_string(), name);
        let found = [one, three, combined, probe].map(|result| sigma(result, id));
        for (found, stated) in found.iter().zip(&stated) {
            // Five digits are printed.
            assert!((1e3 * found - stated).abs() <= 0.02 * stated + 1e-5, "{id}: {found} against {stated}");
        }
        let [one, three, combined, probe] = found;
        assert!(three < one && probe < one, "{id}: {found:?}");
        let is_mounting = ["delta_d7", "delta_theta7"].contains(&name.as_str());
        let limits = if is_mounting { 1.0..3.0 } else { 0.95..1.05 };
        assert!(limits.contains(&(combined / three)), "{id}: {found:?}");
    }
}

const SHORT: &str = "scenarios/probe.toml";

/// The matched scenario with a probe and fewer poses.
fn with_probe(sandbox: &Sandbox, section: &str) {
    let text = sandbox.read("scenarios/matched.toml");
    let text = text.replace("verification = 40", "verification = 20");
    sandbox.write(SHORT, format!("{text}\n[tracker.pose]\n{section}\n"));
}

/// From the session of one point the report foresees what three and their pose would tell: their standard deviations are those of fits to simulated
/// sessions with three points at the same poses, and those of what was measured are the estimate's own.
#[test]
fn the_report_foresees_what_three_points_and_their_pose_tell() {
    let mut scenario = load_scenario(Path::new("scenarios/matched.toml")).expect("a shipped scenario");
    scenario.modes = vec![Mode::WithoutCalibration, Mode::ElastoGeometric];
    let outcome =
        run_trial(&scenario, scenario.seed, 0, PlantKind::Rapier, &mut |_| ControlFlow::Continue(()));
    let outcome = outcome.expect("a run");
    let study = outcome.sensors.as_ref().expect("a study");
    let seen: Vec<_> = study.sensors.iter().map(|s| (s.sensor, s.is_measured)).collect();
    assert_eq!(seen, [(Sensor::OneSmr, true), (Sensor::ThreeSmrs, false), (Sensor::CombinedPose, false)]);
    let estimate = outcome.modes[1].estimate.as_ref().expect("an estimate");
    assert_eq!(study.sensors[0].parameters.len(), estimate.parameters.len());
    for parameter in &estimate.parameters {
        let (own, foreseen) = (parameter.sigma.expect("regular"), study.sensors[0].sigma(parameter.id));
        let foreseen = foreseen.expect("the same parameters");
        // The tracker's place is displaced from where it was found, and not from where it was looked for.
        assert!((foreseen / own - 1.0).abs() < 1e-3, "{}: {own} against {foreseen}", parameter.id);
    }
    let simulated = compare_sensors(&scenario, scenario.seed, Mode::ElastoGeometric, |_, _| {});
    let simulated = simulated.expect("three sensors");
    for (foreseen, measured) in study.sensors.iter().zip(&simulated) {
        assert_eq!((foreseen.sensor, foreseen.rank), (measured.sensor, measured.rank));
        for (id, sigma) in &measured.parameters {
            // How well three places say how their tool is turned is taken there as two points an arm apart have it, and here as all three do: of the pose,
            // what the mounting decides is another.
            let name = id.to_string();
            if foreseen.sensor == Sensor::CombinedPose && (name.starts_with("target") || name.ends_with('7'))
            {
                continue;
            }
            let (sigma, own) = (sigma.expect("regular"), foreseen.sigma(*id).expect("the same parameters"));
            assert!((own / sigma - 1.0).abs() < 0.05, "{:?}, {id}: {sigma} against {own}", foreseen.sensor);
        }
    }
    let at_poses = &outcome.judgements[0].confidence.as_ref().expect("regular").at_poses[1];
    let squares: Vec<_> = at_poses.iter().flatten().map(|place| place.length().powi(2)).collect();
    let own = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    let foreseen = study.sensors[0].spread.expect("regular").place;
    assert!((foreseen / own - 1.0).abs() < 1e-3, "{own} as the estimate predicts, {foreseen} foreseen");
    let spreads: Vec<_> = study.sensors.iter().filter_map(|s| s.spread).collect();
    assert!(spreads[1].turn < 0.7 * spreads[0].turn && spreads[1].place < spreads[0].place, "{spreads:?}");
    let text = calibrig::report::render_tables(&outcome, calibrig::report::Style::Plain);
    let told = text.split("What the target tells").nth(1).expect("a section");
    assert!(told.contains("three SMRs") && told.contains("(foreseen)"), "{told}");
    assert!(text.lines().all(|line| line.chars().count() <= 100), "{text}");
    let json = calibrig::report::json_report(&outcome).sensors.expect("in the report");
    let keys: Vec<_> = json.sensors.iter().map(|s| (s.sensor.as_str(), s.measured)).collect();
    assert_eq!(keys, [("one_smr", true), ("three_smrs", false), ("combined_pose", false)]);
    assert_eq!((json.mode.as_str(), json.predicted.as_str()), ("elasto_geometric", "verification"));
    let page = calibrig::report::html_report(&outcome).expect("a page");
    assert!(page.contains("<section id=\"target\">") && page.contains("href=\"#target\""), "no section");
}

/// By files alone: what is simulated, recorded, replayed bit for bit, tried many times, and chosen from.
#[test]
fn commands_take_a_scenario_with_a_probe() {
    let sandbox = Sandbox::new();
    with_probe(&sandbox, "rotation_sigma_deg = 0.003\nmounted_rz_deg = 100\nmounting_sigma_deg = 0.01");
    let checked = sandbox.run(["check", SHORT]);
    assert!(checked.stdout.contains("probe        orientations within 0.0030 deg"), "{checked:?}");
    let ran = sandbox.run(["run", SHORT, "--out", "out", "--json"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let report = ran.json();
    let row = &report["sets"]["verification"]["rows"]["elasto_geometric"]["orientation"];
    // Three times 0.003 degrees squared, and what the fit leaves.
    let rms = row["rms_rad"].as_f64().expect("a number");
    assert!((7e-5..1.4e-4).contains(&rms), "{row}");
    let names: Vec<_> =
        report["parameters"].as_array().expect("a list").iter().map(|p| p["name"].clone()).collect();
    assert!(names.contains(&"target_rz".into()), "{names:?}");
    assert!(sandbox.read("out/report.html").contains("orientations: angle between measured and predicted"));
    let sensors = report["sensors"]["sensors"].as_array().expect("in the report");
    let measured: Vec<_> = sensors.iter().map(|s| (s["sensor"].as_str(), s["measured"].as_bool())).collect();
    let expected = [("one_smr", false), ("three_smrs", false), ("probe", true)];
    assert_eq!(measured, expected.map(|(key, measured)| (Some(key), Some(measured))));
    let replayed = sandbox.run(["replay", "out/recording.mcap"]);
    assert_eq!(replayed.code, Some(0), "{replayed:?}");
    let campaign = sandbox.run(["montecarlo", SHORT, "--trials", "4", "--plant", "analytic", "--json"]);
    assert_eq!(campaign.code, Some(0), "{campaign:?}");
    let planned = sandbox.run(["identifiability", SHORT, "--mode", "elasto_geometric", "--json"]);
    assert_eq!(planned.code, Some(0), "{planned:?}");
    let parameters = planned.json()["coupled"]["parameters"].to_string();
    assert!(parameters.contains("target_rx"), "{parameters}");
    let sensors = sandbox.run(["identifiability", SHORT, "--sensors", "--mode", "elasto_geometric"]);
    assert_eq!(sensors.code, Some(0), "{sensors:?}");
    for part in
        ["one SMR", "three SMRs", "their pose", "probe", "held-out angle RMS, mrad", "target_rz, mrad"]
    {
        assert!(sensors.stdout.contains(part), "{part} in {}", sensors.stdout);
    }
    println!("{}", sensors.stdout);
}

#[test]
fn a_probe_that_cannot_be_is_refused_with_its_key() {
    let sandbox = Sandbox::new();
    for (section, message) in [
        ("mounted_rz_deg = 10", "rotation_sigma_deg"),
        ("rotation_sigma_deg = 0", "tracker.pose.rotation_sigma_deg is 0"),
        ("rotation_sigma_deg = 0.01\nmounting_sigma_deg = -1", "tracker.pose.mounting_sigma_deg is -1"),
        ("rotation_sigma_deg = 0.01\nmounted_rx_deg = nan", "tracker.pose.mounted_rx_deg is nan"),
        ("rotation_sigma_deg = 0.01\nmounted = 3", "unknown"),
    ] {
        with_probe(&sandbox, section);
        let ended = sandbox.run(["check", SHORT]);
        assert_eq!(ended.code, Some(1), "{section}: {ended:?}");
        assert!(
            ended.stderr.contains(message) && ended.stderr.contains(SHORT),
            "{section}: {}",
            ended.stderr
        );
    }
    let ended = sandbox.run(["identifiability", "--model", ROBOT, "--sensors"]);
    assert_eq!(ended.code, Some(2), "{ended:?}");
}
