//! The sections of the file in SI.

use std::path::Path;

use super::*;
use crate::scenario::{Scenario, parse_scenario};
use calibrig_files::load_robot;
use calibrig_plant::effects::{EffectKind, GrowingPart};

const ALL: &str = r#"
[effects.harmonics]
[[effects.harmonics.joint]]
joint = "waist"
motor_turns_per_rev = 120
once_arcsec = 20
once_phase_deg = 90
twice_arcsec = 5

[[effects.harmonics.joint]]
joint = "rail"
motor_turns_per_m = 40
twice_um = 15
twice_phase_deg = 180

[effects.ratio]
[[effects.ratio.joint]]
joint = "rail"
relative_ppm = -35

[effects.rail]
joint = "rail"
wavelength_mm = 750
horizontal = { polynomial_um = [0, 0, 80], wave_um = 20, phase_deg = 45 }
yaw = { polynomial_arcsec = [0, 10], wave_arcsec = 4 }

[effects.transmission]
[[effects.transmission.joint]]
joint = "elbow"
wave = [
  { cycles_per_rev = 40.5, amplitude_arcsec = 4, growth_arcsec_per_knm = 2, phase_deg = 90 },
  { cycles_per_rev = 3, amplitude_arcsec = 7 },
]

[[effects.transmission.joint]]
joint = "telescope"
wave = [{ period_mm = 20, amplitude_um = 12, growth_um_per_kn = 3 }]

[effects.backlash]
[[effects.backlash.joint]]
joint = "shoulder"
gap_arcsec = 30

[effects.lost_motion]
[[effects.lost_motion.joint]]
joint = "elbow"
gap_arcsec = 60
friction_nm = 20
closes_at_nm = 60

[effects.stiffening]
[[effects.stiffening.joint]]
joint = "shoulder"
stiffness_percent = [70, 95, 120]
limits_nm = [300, 1500]

[effects.friction]
[[effects.friction.joint]]
joint = "telescope"
friction_n = 150
percent_of_load = 3
presliding_mm = 5

[effects.encoder]
[[effects.encoder.joint]]
joint = "roll"
step_arcsec = 1
offset_arcsec = -40

[effects.thermal]
reference_c = 20
start_c = 21
drift_c_per_h = 1.8
swing_c = 0.5
swing_period_s = 600

[[effects.thermal.link]]
joint = "telescope"
axis = "z"
length_mm = 100
with_travel = true
expansion_ppm_per_k = 12
lag_s = 1800
heat = { joint = "telescope", power_w = 30, motion_j_per_m = 400, resistance_k_per_w = 0.4 }

[effects.repeatability]
[[effects.repeatability.joint]]
joint = "wrist"
sigma_arcsec = 3

[effects.foundation]
x_mm = 2000
stiffness_y_n_per_m = 4e8
stiffness_rz_nm_per_rad = 9e8

[effects.foundation.rail]
joint = "rail"
span_mm = 1250
sag_y_um_per_kn = 2

[effects.hoses]
[[effects.hoses.hose]]
from = { joint = "shoulder", x_mm = 400, y_mm = 0, z_mm = 100 }
to = { joint = "telescope", x_mm = 0, y_mm = 50, z_mm = -600 }
stiffness_n_per_m = 400
free_length_mm = 700
"#;

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

fn robot() -> Robot {
    load_robot(&Path::new(ROOT).join("models/spray_painter/robot.toml")).expect("the shipped robot")
}

fn parse(sections: &str) -> Result<Scenario, InputError> {
    parse_with(sections, robot())
}

fn parse_with(sections: &str, robot: Robot) -> Result<Scenario, InputError> {
    let root = Path::new(ROOT);
    let shipped = std::fs::read_to_string(root.join("scenarios/paper.toml")).expect("the shipped scenario");
    let parsed: toml::Table = shipped.parse().expect("TOML");
    // The shipped sections would be keys given twice.
    let mut rest = parsed;
    rest.remove("effects");
    let text = toml::to_string(&rest).expect("TOML");
    parse_scenario(Source::new("scenario.toml", format!("{text}\n{sections}")), robot)
}

fn effects_of(sections: &str) -> Effects {
    parse(sections).expect("a sound scenario").as_built.effects
}

const ARCSEC: f64 = std::f64::consts::PI / 648_000.0;

fn close(found: f64, expected: f64) {
    assert!((found - expected).abs() <= 1e-14 * expected.abs().max(1e-12), "{found} against {expected}");
}

#[test]
fn sections_are_read_in_si_in_the_units_of_each_joint() {
    let effects = effects_of(ALL);
    assert_eq!(effects.active(), EffectKind::ALL);
    let harmonics = effects.harmonics.expect("harmonics").actuators;
    let (rail, waist) = (harmonics[0].expect("the rail's"), harmonics[1].expect("the waist's"));
    assert!(harmonics[2..].iter().all(Option::is_none));
    close(rail.turns, 40.0);
    close(rail.amplitude[1], 15e-6);
    close(rail.phase[1], std::f64::consts::PI);
    close(waist.turns, 120.0 / TAU);
    close(waist.amplitude[0], 20.0 * ARCSEC);
    close(waist.phase[0], std::f64::consts::FRAC_PI_2);
    close(waist.amplitude[1], 5.0 * ARCSEC);
    close(effects.ratio.expect("ratio").relative[0], -35e-6);
    let rail = effects.rail.expect("rail");
    // The base's y is up and the rail is its z.
    assert!((rail.vertical - nalgebra::Vector3::y()).norm() < 1e-15);
    assert_eq!(rail.range, [0.0, 4.0]);
    close(rail.wavelength, 0.75);
    close(rail.horizontal_error.polynomial[2], 80e-6);
    close(rail.horizontal_error.wave, 20e-6);
    close(rail.yaw.polynomial[1], 10.0 * ARCSEC);
    close(rail.yaw.wave, 4.0 * ARCSEC);
    assert_eq!(rail.vertical_error, RailProfile::default());
    let transmission = effects.transmission.expect("transmission").actuators;
    assert_eq!(transmission.iter().map(Vec::len).collect::<Vec<_>>(), [0, 0, 0, 2, 1, 0, 0]);
    let (pins, screw) = (transmission[3][0], transmission[4][0]);
    close(pins.cycles, 40.5 / TAU);
    close(pins.amplitude, 4.0 * ARCSEC);
    close(pins.per_load, 2e-3 * ARCSEC);
    close(pins.phase, std::f64::consts::FRAC_PI_2);
    close(screw.cycles, 50.0);
    close(screw.amplitude, 12e-6);
    close(screw.per_load, 3e-9);
    close(effects.backlash.expect("backlash").gap[2], 30.0 * ARCSEC);
    let lost = effects.lost_motion.expect("lost motion");
    close(lost.gap[3], 60.0 * ARCSEC);
    assert_eq!((lost.friction[3], lost.closes_at[3], lost.gap[2]), (20.0, 60.0, 0.0));
    let stiffening = effects.stiffening.expect("stiffening").actuators;
    let curve = stiffening[2].as_ref().expect("the shoulder's");
    assert_eq!(curve.limits, [300.0, 1500.0]);
    curve.factors.iter().zip([0.7, 0.95, 1.2]).for_each(|(found, expected)| close(*found, expected));
    let friction = effects.friction.expect("friction");
    assert_eq!((friction.constant[4], friction.constant[2]), (150.0, 0.0));
    close(friction.per_load[4], 0.03);
    close(friction.presliding[4], 5e-3);
    let encoder = effects.encoder.expect("encoder");
    close(encoder.step[5], ARCSEC);
    close(encoder.offset[5], -40.0 * ARCSEC);
    let thermal = effects.thermal.expect("thermal");
    close(thermal.ambient.drift, 1.8 / 3600.0);
    assert_eq!(thermal.growths[0].part, GrowingPart::Link { joint: 4, axis: 2 });
    assert!(thermal.growths[0].with_travel);
    close(thermal.growths[0].expansion, 12e-6);
    let heat = thermal.growths[0].heat.expect("its drive's");
    assert_eq!((heat.actuator, heat.power, heat.per_motion, heat.resistance), (4, 30.0, 400.0, 0.4));
    close(effects.repeatability.expect("repeatability").sigma[6], 3.0 * ARCSEC);
    let foundation = effects.foundation.expect("foundation");
    assert_eq!(foundation.stiffness, [f64::INFINITY, 4e8, f64::INFINITY, f64::INFINITY, f64::INFINITY, 9e8]);
    close(foundation.at.x, 2.0);
    let rail = foundation.rail.expect("a rail");
    assert_eq!((rail.joint, rail.first_foot), (0, 0.0));
    close(rail.span, 1.25);
    close(rail.compliance[1], 2e-9);
    let hose = &effects.hoses.expect("hoses").hoses[0];
    assert_eq!(hose.ends.map(|end| end.link), [Some(2), Some(4)]);
    close(hose.ends[1].at.z, -0.6);
    close(hose.free_length, 0.7);
}

#[test]
fn motor_turns_are_those_of_the_robots_file_unless_the_machines_differ() {
    let own = effects_of(&ALL.replace("motor_turns_per_m = 40\n", ""));
    let nominal = robot().model.motor_turns[0].expect("the shipped robot's");
    close(own.harmonics.expect("harmonics").actuators[0].expect("the rail's").turns, nominal);
}

/// Half of a period apart over the travel, and it is no longer the motor's wave.
#[test]
fn a_wave_with_the_motors_turns_belongs_to_the_harmonics_unless_it_grows_with_the_load() {
    let model = robot().model;
    let turns = TAU * model.motor_turns[3].expect("the elbow's");
    let limits = model.kinematics.links[3].limits;
    let apart = TAU / (limits[1] - limits[0]);
    let with = |cycles: f64, growth: &str| {
        parse(&ALL.replace("cycles_per_rev = 3,", &format!("cycles_per_rev = {cycles}, {growth}")))
    };
    for cycles in [turns, 2.0 * turns, turns + 0.49 * apart] {
        let error = with(cycles, "").expect_err("the motor's wave").to_string();
        assert!(error.contains("repeats with the turns of its motor"), "{error}");
        assert!(with(cycles, "growth_arcsec_per_knm = 1,").is_ok());
    }
    assert!(with(turns + 0.51 * apart, "").is_ok() && with(1.5 * turns, "").is_ok());
}

#[test]
fn a_rod_grows_where_there_is_one() {
    let rod = "\n[effects.thermal.rod]\nexpansion_ppm_per_k = 12\nlag_s = 60\n";
    let text = ALL.replace("\n[effects.repeatability]\n", &format!("{rod}\n[effects.repeatability]\n"));
    let thermal = effects_of(&text).thermal.expect("thermal");
    assert_eq!(thermal.growths[1].part, GrowingPart::Rod);
    let mut direct = robot();
    direct.model.actuators = calibrig_model::ActuatorMap::Direct;
    direct.model.statics.as_mut().expect("statics").linkage = None;
    let error = parse_with(&text, direct).expect_err("no rod").to_string();
    assert!(error.contains("[effects.thermal.rod]"), "{error}");
}

#[test]
fn a_section_is_off_where_it_is_not_there_or_says_so() {
    assert_eq!(effects_of(""), Effects::default());
    for kind in EffectKind::ALL {
        let header = format!("[effects.{}]\n", kind.key());
        let off = ALL.replacen(&header, &format!("{header}enabled = false\n"), 1);
        assert_eq!(effects_of(&off), effects_of(ALL).without(kind), "{}", kind.key());
    }
}

#[test]
fn what_is_wrong_in_a_section_that_is_off_is_told_too() {
    let off = ALL.replacen("[effects.backlash]\n", "[effects.backlash]\nenabled = false\n", 1);
    let error = parse(&off.replace("gap_arcsec = 30", "gap_arcsec = -30")).expect_err("a negative gap");
    assert!(error.to_string().contains("gap_arcsec is -30"), "{error}");
}

#[test]
fn refusals_name_the_key_the_joint_and_what_was_expected() {
    for (from, to, message) in [
        ("gap_arcsec = 30", "gap_um = 30", "gap_um of joint \"shoulder\", which is revolute"),
        ("gap_arcsec = 30", "", "joint \"shoulder\" has no gap_arcsec"),
        ("relative_ppm = -35", "relative_ppm = 2e4", "relative_ppm is 20000"),
        (
            "motor_turns_per_m = 40\n",
            "motor_turns_per_m = 0\n",
            "the motor of \"rail\" is stated to turn zero times",
        ),
        ("start_c = 21", "start_c = 80", "effects.thermal.start_c is 80"),
        ("swing_c = 0.5", "swing_c = 45", "leave -20 to 60"),
        ("swing_period_s = 600\n", "", "swing_c without its period"),
        ("expansion_ppm_per_k = 12", "expansion_ppm_per_k = 12000", "expansion_ppm_per_k is 12000"),
        ("wavelength_mm = 750", "wavelength_mm = 0", "effects.rail.wavelength_mm is 0"),
        ("_y_n_per_m = 4e8", "_y_n_per_m = 0", "effects.foundation.stiffness_y_n_per_m is 0"),
        ("span_mm = 1250", "span_mm = 0", "effects.foundation.rail.span_mm is 0"),
        ("sag_y_um_per_kn = 2", "sag_y_um_per_kn = 0", "[effects.foundation.rail] does not sag"),
        ("joint = \"rail\"\nspan", "joint = \"telescope\"\nspan", "not a rail that carries the robot"),
        ("joint = \"telescope\", x_mm", "joint = \"shoulder\", x_mm", "between two points of one link"),
        ("free_length_mm = 700", "free_length_mm = -1", "free_length_mm is -1"),
        (
            "joint = \"rail\"\nwavelength",
            "joint = \"telescope\"\nwavelength",
            "not a rail that carries the robot",
        ),
        ("wave_arcsec = 4", "wave_um = 4", "effects.rail.yaw is given in um"),
        ("presliding_mm = 5", "presliding_mm = -5", "presliding_mm is -5"),
        (
            "motor_turns_per_rev = 120",
            "motor_turns_per_rev = 0",
            "the motor of \"waist\" is stated to turn zero times",
        ),
        ("cycles_per_rev = 3,", "", "a wave of joint \"elbow\" is not given by its cycles_per_rev"),
        ("cycles_per_rev = 3,", "cycles_per_rev = 0,", "cycles_per_rev is 0"),
        (
            "period_mm = 20",
            "cycles_per_rev = 20",
            "a wave of joint \"telescope\" is not given by its period_mm",
        ),
        ("growth_um_per_kn = 3", "growth_um_per_kn = -3", "growth_um_per_kn is -3"),
        (
            "amplitude_um = 12",
            "amplitude_arcsec = 12",
            "amplitude_arcsec of joint \"telescope\", which is prismatic",
        ),
        ("closes_at_nm = 60", "closes_at_nm = 10", "closes under 10, but its friction is 20"),
        ("friction_nm = 20\ncloses_at_nm = 60", "closes_at_nm = 0", "closes under 0"),
        (
            "closes_at_nm = 60",
            "closes_at_nm = 1e6",
            "the gap of joint \"elbow\" closes under 1000000 N m, but its drive carries at most",
        ),
        ("limits_nm = [300, 1500]", "limits_nm = [300, 200]", "limits_nm: 200 after 300"),
        ("limits_nm = [300, 1500]", "limits_nm = [300]", "3 values of stiffness_percent for 1 of limits_nm"),
        ("limits_nm = [300, 1500]", "limits_n = [300, 1500]", "\"shoulder\" are not given by limits_nm"),
        ("[70, 95, 120]", "[70, 95, 90]", "stiffness_percent: 90 after 95"),
        ("[70, 95, 120]", "[-70, 95, 120]", "stiffness_percent is -70"),
        ("power_w = 30", "power_w = -30", "heat.power_w is -30"),
        ("power_w = 30", "power_w = 300", "warm the part by 120 K"),
        ("resistance_k_per_w = 0.4", "resistance_k_per_w = 0", "heat.resistance_k_per_w is 0"),
        ("power_w = 30, motion_j_per_m = 400, ", "", "the drive of joint \"telescope\" produces no heat"),
        ("motion_j_per_m = 400", "motion_j_per_rev = 400", "motion_j_per_rev of joint \"telescope\""),
        ("lag_s = 1800", "lag_s = 0", "its part is heated"),
        ("joint = \"wrist\"\nsigma", "joint = \"hand\"\nsigma", "the robot has no joint \"hand\""),
    ] {
        let error = parse(&ALL.replacen(from, to, 1)).expect_err(to).to_string();
        assert!(error.contains(message), "{message:?} in {error}");
    }
    let none = "[effects.backlash]\n";
    assert!(parse(none).expect_err("no entry").to_string().contains("[effects.backlash] has no entry"));
    let twice = format!("{ALL}\n[[effects.repeatability.joint]]\njoint = \"wrist\"\nsigma_arcsec = 3\n");
    assert!(parse(&twice).expect_err("two entries").to_string().contains("\"wrist\" is given twice"));
}
