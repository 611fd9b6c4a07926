//! The truth stands beside what is identified, terms included; and nothing of it reaches what is identified.

use calibrig::files::Source;
use calibrig::identification::{IdentificationOptions, Mode, identify};
use calibrig::model::{Compliance, ParameterId, Unit};
use calibrig::pipeline::{KnownTruth, PlantKind, bounds_at_truth, calibrate, run, simulate};
use calibrig::plant::SettledPose;
use calibrig::plant::effects::{
    Backlash, Effects, Encoder, Friction, Harmonic, Harmonics, Rail, RailProfile, Ratio, Stiffening,
    StiffnessCurve,
};
use calibrig::scenario::{Scenario, parse_scenario};

use crate::a_user_reproduces_the_paper::{paper, rigid_paper};

/// The machine of the publication, elastic as predicted, without noise, and with these effects alone; what the extended mode makes of it with
/// terms of these families.
fn with(effects: Effects, families: &[&str]) -> Scenario {
    let mut scenario = Scenario { verification_poses: 0, ..paper() };
    let nominal = &scenario.robot.model;
    scenario.as_built.kinematics = rigid_paper().as_built.kinematics;
    scenario.as_built.statics = nominal.statics.clone().expect("the shipped robot's statics");
    scenario.as_built.actuators = nominal.actuators.clone();
    scenario.as_built.effects = effects;
    scenario.tracker = rigid_paper().tracker;
    scenario.tracker.instrument.noise = false;
    scenario.options.unmodelled_sigma = 0.0;
    scenario.options.mode = Mode::Extended;
    scenario.options.terms = Some(families.iter().map(|family| (*family).to_owned()).collect());
    scenario
}

/// What priors may pull an estimate off, m or rad: the effects are a hundred times as large.
const PULL: f64 = 2e-6;
/// The same of compliances, a hundredth of their prior's standard deviation.
const PULL_OF_COMPLIANCES: f64 = 1e-3;

/// Every parameter with its truth; the named ones are known in advance, and found within a thousandth.
#[track_caller]
fn assert_found(effects: Effects, families: &[&str], named: &[(&str, f64)]) {
    let scenario = with(effects, families);
    let simulation = simulate(&scenario, 1, 0, PlantKind::Analytic, |_, _| {}).expect("a session");
    let set = &simulation.sets[0].measurements;
    let model = &scenario.robot.model;
    let estimate = identify(model, set, &scenario.options).expect("an estimate");
    let known = KnownTruth {
        orientation: None,
        as_built: &simulation.truth.as_built,
        nominal: model,
        stations: &simulation.truth.stations,
        instrument: &simulation.truth.instrument,
        further_targets: &simulation.truth.further_targets,
        targets: &set.targets,
        settled: &simulation.truth.poses[0],
    };
    for p in &estimate.parameters {
        let truth = known.of(&estimate, p.id).unwrap_or_else(|| panic!("{}: no truth", p.id));
        let pull = if p.id.unit() == Unit::One { PULL_OF_COMPLIANCES } else { PULL };
        assert!((p.value - truth).abs() <= pull, "{}: {:e} is {:e}", p.id, truth, p.value);
    }
    for (name, expected) in named {
        let id = ParameterId::parse(name).expect(name);
        let truth = known.of(&estimate, id).expect(name);
        assert!((truth / expected - 1.0).abs() < 1e-9, "{name}: {truth:e} should be {expected:e}");
        let value = estimate.value(id).expect(name);
        assert!((value / expected - 1.0).abs() < 1e-3, "{name}: {value:e} should be {expected:e}");
    }
}

const ARCMIN: f64 = std::f64::consts::PI / 10_800.0;

fn of_joints(values: &[(usize, f64)]) -> Vec<f64> {
    (0..7).map(|joint| values.iter().find(|(at, _)| *at == joint).map_or(0.0, |(_, value)| *value)).collect()
}

#[test]
fn half_the_play_is_the_amplitude_of_hysteresis() {
    let gap = of_joints(&[(0, 4e-4), (2, ARCMIN), (3, 2.0 * ARCMIN)]);
    let effects = Effects { backlash: Some(Backlash { gap }), ..Effects::default() };
    let named =
        [("hysteresis_d1", -2e-4), ("hysteresis_theta3", -0.5 * ARCMIN), ("hysteresis_theta4", -ARCMIN)];
    assert_found(effects, &["hysteresis"], &named);
}

/// Friction that depends on nothing but the sign of the motion; one that grows with the load has no counterpart.
#[test]
fn friction_is_hysteresis_where_it_depends_on_the_direction_alone() {
    let friction =
        Friction { constant: of_joints(&[(2, 60.0)]), per_load: of_joints(&[]), presliding: of_joints(&[]) };
    let scenario = with(Effects::default(), &[]);
    let expected = -60.0 / scenario.as_built.statics.drive_stiffness[2];
    let effects = Effects { friction: Some(friction.clone()), ..Effects::default() };
    assert_found(effects, &["hysteresis"], &[("hysteresis_theta3", expected)]);

    let loaded = Friction { per_load: of_joints(&[(2, 0.01)]), ..friction };
    let scenario = with(Effects { friction: Some(loaded), ..Effects::default() }, &["hysteresis"]);
    let outcome =
        run(&Scenario { modes: vec![Mode::Extended], ..scenario.clone() }, 1, |_, _| {}).expect("a run");
    let estimate = outcome.modes[0].estimate.as_ref().expect("an estimate");
    let known = KnownTruth {
        orientation: None,
        as_built: &scenario.as_built,
        nominal: &scenario.robot.model,
        stations: &[scenario.tracker.tracker_from_base],
        instrument: &[],
        further_targets: &[],
        targets: &outcome.sets[0].measurements.targets,
        settled: &[],
    };
    let of = |name: &str| known.of(estimate, ParameterId::parse(name).expect(name));
    assert_eq!((of("hysteresis_theta3"), of("hysteresis_theta4")), (None, Some(0.0)));
    assert!(known.values(estimate).is_none() && outcome.bounds.is_empty(), "no bound without a truth");
}

/// By the data sheet's formula at the mean load of the machine with linear drives, which differs by the little that their other deflections change.
#[test]
fn the_compliance_of_a_drive_that_stiffens_is_its_secant_at_the_mean_load() {
    let linear = with(Effects::default(), &[]);
    let stiffness = linear.as_built.statics.drive_stiffness[3];
    let session = |scenario: &Scenario| {
        simulate(scenario, 1, 0, PlantKind::Rapier, |_, _| {}).expect("a session").truth.poses.remove(0)
    };
    let poses = session(&linear);
    let mean =
        poses.iter().map(|pose| (stiffness * pose.deflection[3]).abs()).sum::<f64>() / poses.len() as f64;
    let limits = [0.2 * mean, 0.7 * mean];
    let deflection = limits[0] / (0.7 * stiffness)
        + (limits[1] - limits[0]) / (0.9 * stiffness)
        + (mean - limits[1]) / (1.4 * stiffness);
    let expected = stiffness / (mean / deflection) - 1.0;
    assert!(expected.abs() > 0.02, "{expected}");

    let curve = StiffnessCurve { factors: vec![0.7, 0.9, 1.4], limits: limits.to_vec() };
    let mut actuators = vec![None; 7];
    actuators[3] = Some(curve);
    let scenario = with(Effects { stiffening: Some(Stiffening { actuators }), ..Effects::default() }, &[]);
    let settled = session(&scenario);
    let error = simulate(&scenario, 1, 0, PlantKind::Analytic, |_, _| {}).expect_err("no such drives");
    assert!(error.to_string().contains("[effects.stiffening]"), "{error}");
    let outcome = run(&Scenario { modes: vec![Mode::ElastoGeometric], ..scenario.clone() }, 1, |_, _| {})
        .expect("a run");
    let estimate = outcome.modes[0].estimate.as_ref().expect("an estimate");
    let known = |settled: &[SettledPose]| {
        let known = KnownTruth {
            orientation: None,
            as_built: &scenario.as_built,
            nominal: &scenario.robot.model,
            stations: &[scenario.tracker.tracker_from_base],
            instrument: &[],
            further_targets: &[],
            targets: &outcome.sets[0].measurements.targets,
            settled,
        };
        known.of(estimate, ParameterId::Compliance(Compliance::Drive { joint: 3 }))
    };
    let truth = known(&settled).expect("known");
    assert!((truth - expected).abs() < 0.002, "{truth} against {expected}");
    assert_eq!(known(&[]), None, "no pose tells the load");
}

#[test]
fn a_ratio_error_is_its_displacement_at_the_end_and_a_shift_of_the_zero() {
    let scenario = with(Effects::default(), &[]);
    let limits = |joint: usize| scenario.robot.model.kinematics.links[joint].limits;
    // The telescope's own d is not identified: that of the roll behind it does the same.
    let relative = of_joints(&[(0, 2.5e-4), (1, -4e-4)]);
    let half = |joint: usize| 0.5 * (limits(joint)[1] - limits(joint)[0]);
    let middle = |joint: usize| 0.5 * (limits(joint)[1] + limits(joint)[0]);
    let (as_built, nominal) = (&scenario.as_built.kinematics.links, &scenario.robot.model.kinematics.links);
    assert!(middle(0) > 1.0, "a rail that begins at zero");
    let effects = Effects { ratio: Some(Ratio { relative }), ..Effects::default() };
    let named = [
        ("ratio_d1", 2.5e-4 * half(0)),
        ("ratio_theta2", -4e-4 * half(1)),
        ("delta_d1", as_built[0].d - nominal[0].d + 2.5e-4 * middle(0)),
    ];
    assert_found(effects, &["ratio"], &named);
}

#[test]
fn the_waves_of_a_transmission_are_sines_and_cosines_of_its_motor_turns() {
    let turns = paper().robot.model.motor_turns;
    let (amplitude, phase) = ([2.0e-4, 0.5e-4], [0.7, -1.9]);
    let mut actuators = vec![None; 7];
    for joint in [2, 4] {
        let turns = turns[joint].expect("known");
        actuators[joint] = Some(Harmonic { turns, amplitude, phase });
    }
    // An encoder's offset moves the phase, and the zero.
    let offset = of_joints(&[(2, 3e-4)]);
    let moved = std::f64::consts::TAU * turns[2].expect("known") * 3e-4;
    let effects = Effects {
        harmonics: Some(Harmonics { actuators }),
        encoder: Some(Encoder { step: of_joints(&[]), offset }),
        ..Effects::default()
    };
    let named = [
        ("harmonic_theta3_sin1", 2.0e-4 * (0.7 + moved).cos()),
        ("harmonic_theta3_cos1", 2.0e-4 * (0.7 + moved).sin()),
        ("harmonic_d5_sin2", 0.5e-4 * (-1.9_f64).cos()),
        ("harmonic_d5_cos2", 0.5e-4 * (-1.9_f64).sin()),
    ];
    assert_found(effects, &["harmonic"], &named);
}

#[test]
fn an_encoder_offset_is_an_error_of_its_joints_zero() {
    let offset = of_joints(&[(1, 2e-4), (2, 3e-4), (3, -4e-4)]);
    let effects = Effects { encoder: Some(Encoder { step: of_joints(&[]), offset }), ..Effects::default() };
    let scenario = with(Effects::default(), &[]);
    let off = |joint: usize| {
        scenario.as_built.kinematics.links[joint].theta - scenario.robot.model.kinematics.links[joint].theta
    };
    // The shoulder's turns the elbow back.
    let named = [("delta_theta3", off(2) + 3e-4), ("delta_theta4", off(3) - 4e-4 - 3e-4)];
    assert_found(effects, &[], &named);
}

#[test]
fn a_bent_rail_is_its_legendre_polynomials() {
    let bent = |polynomial: &[f64]| RailProfile { polynomial: polynomial.to_vec(), ..RailProfile::default() };
    let range = paper().robot.model.kinematics.links[0].limits;
    let rail = Rail {
        joint: 0,
        range,
        wavelength: 0.8,
        vertical: nalgebra::Vector3::y(),
        // 3 P2 = 4.5 x² - 1.5, 5 P3 = 12.5 x³ - 7.5 x: without a constant or linear part.
        horizontal_error: bent(&[-0.5e-4, 0.0, 1.5e-4]),
        vertical_error: bent(&[0.0, -1.5e-4, 0.0, 2.5e-4]),
        roll: bent(&[0.0, 4e-5]),
        pitch: bent(&[1e-5, 0.0, -3e-5]),
        yaw: bent(&[0.0, -2e-5]),
    };
    let effects = Effects { rail: Some(rail), ..Effects::default() };
    let named = [
        ("rail_d1_x2", 1e-4),
        ("rail_d1_y3", 1e-4),
        ("rail_d1_rz1", 4e-5),
        ("rail_d1_rx2", -2e-5),
        ("rail_d1_ry1", -2e-5),
    ];
    assert_found(effects, &["rail"], &named);
}

/// The text of a scenario without what begins with one of these tables.
fn without(text: &str, tables: &[&str]) -> String {
    let mut kept = true;
    let mut lines = Vec::new();
    for line in text.lines() {
        if let Some(header) = line.strip_prefix('[') {
            let name = header.trim_start_matches('[');
            kept = !tables.iter().any(|table| name.starts_with(table));
        }
        if kept {
            lines.push(line);
        }
    }
    lines.join("\n") + "\n"
}

/// The wall where it could leak: two texts of a scenario that differ in the machine alone, the same measurements, the same bits.
#[test]
fn a_scenario_with_another_machine_gives_the_same_bits_of_the_same_measurements() {
    const OTHER: &str = "
[as_built]
drives = \"rigid\"
[[as_built.joint]]
joint = \"elbow\"
delta_a_mm = 25
delta_theta_rad = -0.03
stiffness_factor = 0.5
mass_factor = 1.4
[as_built.linkage]
delta_rod_mm = 3
[as_built.base]
tilt_x_mrad = 4
[as_built.target]
delta_x_mm = 2
[[effects.backlash.joint]]
joint = \"telescope\"
gap_um = 5000
[[effects.encoder.joint]]
joint = \"rail\"
step_um = 900
offset_um = 700
[[effects.ratio.joint]]
joint = \"rail\"
relative_ppm = -900
";
    let shipped = paper();
    let text = std::fs::read_to_string("scenarios/paper.toml").expect("the shipped scenario");
    let parse = |text: String| {
        parse_scenario(Source::new("scenarios/paper.toml", text), shipped.robot.clone()).expect("a scenario")
    };
    let (one, other) = (parse(text.clone()), parse(without(&text, &["as_built", "effects"]) + OTHER));
    assert_eq!(one.as_built, shipped.as_built);
    assert!(
        one.as_built.kinematics != other.as_built.kinematics
            && one.as_built.statics != other.as_built.statics
    );
    assert!(
        one.as_built.target != other.as_built.target && one.as_built.actuators != other.as_built.actuators
    );
    assert!(other.as_built.effects.encoder.is_some() && other.as_built.effects.thermal.is_none());
    let told = simulate(&one, 5, 0, PlantKind::Rapier, |_, _| {}).expect("a session");
    let bits = |scenario: &Scenario| {
        let (model, options) = (&scenario.robot.model, &scenario.options);
        let calibrated = calibrate(model, &told.sets, &scenario.modes, options).expect("estimates");
        assert!(calibrated.1.len() >= 4);
        // `Debug` prints the shortest digits that tell numbers apart, and the sign of a zero.
        format!("{calibrated:?}")
    };
    assert!(bits(&one) == bits(&other), "the machine's description reached an estimate");
}

/// The bounds of a report: those of the measurements alone are what a fit without priors states, near enough to the truth.
#[test]
fn a_report_states_the_bounds_at_the_truth() {
    let mut scenario = rigid_paper();
    scenario.options.unmodelled_sigma = 0.0;
    scenario.modes = vec![Mode::WithoutCalibration, Mode::OnlyCalibration];
    let outcome = run(&scenario, 1, |_, _| {}).expect("a run");
    let [bounds] = outcome.bounds.as_slice() else { panic!("{:?}", outcome.bounds) };
    let estimate = outcome.modes[1].estimate.as_ref().expect("an estimate");
    let least = bounds.cramer_rao.as_ref().expect("determined");
    assert_eq!((bounds.mode, bounds.bayesian.as_ref()), (Mode::OnlyCalibration, None));
    for (p, least) in estimate.parameters.iter().zip(least) {
        let ratio = p.sigma.expect("regular") / least;
        assert!((ratio - 1.0).abs() < 0.01, "{}: {ratio}", p.id);
    }
    let json = calibrig::report::json_report(&outcome);
    assert_eq!(json.parameters[3].cramer_rao_bound, Some(least[3]));
    assert_eq!(json.parameters[3].bayesian_cramer_rao_bound, None);

    // Twice the noise of the instrument doubles the bound, whatever the fit was told to leave to the model.
    let mut coarse = outcome.sets.clone();
    for observation in &mut coarse[0].measurements.observations {
        if let calibrig::measurement::Reading::Spherical(reading) = &mut observation.reading {
            reading.covariance = reading.covariance.map(|c| 4.0 * c);
        }
    }
    for nest in coarse[0].measurements.stations.iter_mut().flat_map(|station| &mut station.nests) {
        nest.in_base_covariance *= 4.0;
        if let calibrig::measurement::Reading::Spherical(reading) = &mut nest.reading {
            reading.covariance = reading.covariance.map(|c| 4.0 * c);
        }
    }
    for target in &mut coarse[0].measurements.targets {
        target.covariance = target.covariance.map(|covariance| 4.0 * covariance);
    }
    let options = IdentificationOptions { unmodelled_sigma: 1e-3, ..scenario.options };
    let truth = outcome.truth.as_ref().expect("simulated");
    let doubled = bounds_at_truth(&outcome.model, &coarse, &outcome.modes, &options, truth);
    for (twice, once) in doubled[0].cramer_rao.as_ref().expect("determined").iter().zip(least) {
        assert!((twice / once - 2.0).abs() < 1e-6, "{twice} {once}");
    }
}
