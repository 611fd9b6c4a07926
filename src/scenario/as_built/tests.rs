//! The machine as built, given and drawn.

use std::path::Path;

use super::*;
use crate::pipeline::{PlantKind, simulate};
use crate::scenario::{Scenario, parse_scenario};
use calibrig_files::load_robot;
use calibrig_model::{Beam, Compliance, CrankAxis};

/// What stands for the shipped scenario's `[as_built]`.
const SHOULDER: &str = "[[as_built.joint]]\njoint = \"shoulder\"\nmass_factor = 1.02\n";

/// The shipped scenario with these sections for its own `[as_built]` and `[effects]`.
fn scenario_of(as_built: &str) -> Result<Scenario, InputError> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let shipped = std::fs::read_to_string(root.join("scenarios/paper.toml")).expect("the shipped scenario");
    let mut rest: toml::Table = shipped.parse().expect("TOML");
    rest.remove("as_built");
    rest.remove("effects");
    let robot = load_robot(&root.join("models/spray_painter/robot.toml")).expect("the shipped robot");
    let text = format!("{}\n{as_built}\n", toml::to_string(&rest).expect("TOML"));
    parse_scenario(Source::new("paper.toml", text), robot)
}

fn paper_with(sections: &str) -> Result<Scenario, InputError> {
    scenario_of(&format!("{SHOULDER}{sections}"))
}

fn shoulder_with(keys: &str) -> Result<Scenario, InputError> {
    scenario_of(&format!("{SHOULDER}{keys}"))
}

fn machine(sections: &str) -> AsBuilt {
    paper_with(sections).expect("valid").as_built
}

fn first_beam(machine: &AsBuilt, link: usize) -> &Beam {
    machine.statics.beams[link].as_ref().expect("a flexible link")
}

#[test]
fn factors_multiply_what_they_name() {
    let stated = machine("");
    let changed = shoulder_with("bearing_factor = 0.5\nbeam_factor = 0.25").expect("valid").as_built;
    let (before, after) = (&stated.statics, &changed.statics);
    assert_eq!(after.bearings[2].stiffness, before.bearings[2].stiffness.map(|k| 0.5 * k));
    assert_eq!(after.bearings[3], before.bearings[3]);
    let (from, to) =
        (first_beam(&stated, 2).segments[0].section, first_beam(&changed, 2).segments[0].section);
    assert_eq!((to.axial, to.torsion), (0.25 * from.axial, 0.25 * from.torsion));
    assert_eq!((to.shear, to.bending), (from.shear.map(|k| 0.25 * k), from.bending.map(|k| 0.25 * k)));
    assert_eq!(to.mass_per_length, from.mass_per_length);

    // The shoulder weighs 2 % more, its beam as well.
    let nominal = paper_with("").expect("valid").robot.model.statics.expect("stated");
    let beam = nominal.beams[2].as_ref().expect("a beam");
    assert_eq!(before.bodies[2].mass, 1.02 * nominal.bodies[2].mass);
    assert_eq!(from.mass_per_length, 1.02 * beam.segments[0].section.mass_per_length);
}

#[test]
fn linkage_base_target_and_loads_deviate_in_their_units() {
    let stated = machine("");
    let changed = machine(
        "[as_built.linkage]\ndelta_crank_mm = 0.5\ndelta_lever_mm = -0.25\ndelta_rod_mm = 1\ndelta_crank_angle_mrad = 2\n\
         delta_lever_angle_mrad = -1\nrod_stiffness_factor = 0.5\n\
         delta_axis_x_mm = 0.1\ndelta_axis_y_mm = -0.2\ndelta_axis_tilt_x_mrad = 0.3\ndelta_axis_tilt_y_mrad = 0.4\n\
         [as_built.base]\ntilt_z_mrad = 2\n[as_built.target]\ndelta_x_mm = 1\ndelta_z_mm = -2\n\
         [[as_built.load]]\nname = \"hose\"\njoint = \"telescope\"\nx_mm = 0\ny_mm = 0\nz_mm = -300\nmass_kg = 3\nforce_x_n = 20",
    );
    let (_, _, _, from) = stated.actuators.four_bar().expect("a four-bar");
    let (_, _, _, to) = changed.actuators.four_bar().expect("a four-bar");
    let close = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-15, "{found} {expected}");
    close(to.crank.length, 0.3505);
    close(to.lever.length, 0.34975);
    close(to.rod, 1.351);
    close(to.crank.angle - from.crank.angle, 0.002);
    close(to.lever.angle - from.lever.angle, -0.001);
    assert_eq!(to.axis, CrankAxis { x: 1e-4, y: -2e-4, rx: 3e-4, ry: 4e-4 });
    assert_eq!(changed.statics.linkage.as_ref().map(|l| l.rod_stiffness), Some(4e7));
    // A base turned about z by 2 mrad raises its x axis, so that weights pull towards -x.
    let expected = 9.80665 * Vector3::new(-2e-3_f64.sin(), -2e-3_f64.cos(), 0.0);
    assert!((changed.statics.gravity - expected).norm() < 1e-12);
    assert!((changed.target - stated.target - Vector3::new(1e-3, 0.0, -2e-3)).norm() < 1e-15);
    assert_eq!((stated.statics.loads.len(), changed.statics.loads.len()), (0, 1));
    assert_eq!((changed.statics.loads[0].mass, changed.statics.loads[0].link), (3.0, 4));
}

#[test]
fn a_rigid_machine_yields_nowhere() {
    let rigid = scenario_of("[as_built]\ndrives = \"rigid\"").expect("valid");
    let statics = &rigid.as_built.statics;
    assert!(statics.drive_stiffness.iter().all(|stiffness| stiffness.is_infinite()));
    assert!(statics.bearings.iter().all(|bearing| bearing.stiffness == RIGID));
    assert_eq!(statics.linkage.as_ref().map(|linkage| linkage.rod_stiffness), Some(f64::INFINITY));
}

#[test]
fn every_mistake_is_named() {
    let load =
        |keys: &str| format!("[[as_built.load]]\nname = \"hose\"\nx_mm = 0\ny_mm = 0\nz_mm = 0\n{keys}");
    let drawn = |keys: &str| format!("[as_built.drawn]\ndistribution = \"normal\"\n{keys}");
    for (sections, message, help) in [
        (
            "[as_built.linkage]\ndelta_rod_mm = 500".to_owned(),
            "as_built.linkage: the four-bar does not close",
            "errors",
        ),
        (
            "[as_built.linkage]\ndelta_axis_x_mm = 500".to_owned(),
            "as_built.linkage.delta_axis_x_mm: the four-bar does not close with the elbow at",
            "errors",
        ),
        (
            "[as_built.linkage]\ndelta_axis_tilt_y_mrad = nan".to_owned(),
            "delta_axis_tilt_y_mrad is nan",
            "finite",
        ),
        (drawn("crank_axis_mm = 100"), "as_built.drawn: with linkage_mm", "elbow's limits"),
        (
            "[as_built.linkage]\ndelta_crank_angle_mrad = 430".to_owned(),
            "as_built.linkage: rod and lever",
            "errors",
        ),
        (
            "[as_built.linkage]\ndelta_crank_mm = -360".to_owned(),
            "delta_crank_mm leaves a length of -10.000 mm",
            "above",
        ),
        ("[as_built.linkage]\ndelta_crank = 1".to_owned(), "unknown key `delta_crank`", "`delta_crank_mm`"),
        (
            "[as_built.linkage]\nrod_stiffness_factor = 0".to_owned(),
            "rod_stiffness_factor is 0",
            "above zero",
        ),
        ("[as_built.base]\ntilt_x_mrad = nan".to_owned(), "tilt_x_mrad is nan", "finite"),
        ("[as_built.base]\ntilt_x = 1".to_owned(), "unknown key `tilt_x`", "`tilt_x_mrad`"),
        ("[as_built.target]\ndelta_x_mm = inf".to_owned(), "delta_x_mm is inf", "finite"),
        (load("joint = \"hand\"\nmass_kg = 1"), "no joint is named \"hand\"", "telescope"),
        (load("joint = \"wrist\""), "neither mass nor force", "mass_kg"),
        ("[as_built.drawn]\nlengths_mm = 1".to_owned(), "missing key `distribution`", "distribution"),
        ("[as_built.drawn]\ndistribution = \"flat\"".to_owned(), "distribution is \"flat\"", "`uniform`"),
        (drawn("lengths_mm = -1"), "lengths_mm is -1", "zero or more"),
        (drawn("compliance_fraction = 0.3"), "compliance_fraction is 0.3", "at most 0.2"),
        (drawn("mass_fraction = nan"), "mass_fraction is nan", "finite"),
        (drawn("parameters = \"some\""), "\"some\" is not a valid choice", "neighbour_axis_rules"),
        (drawn("parameters = [\"delta_a9\"]"), "\"delta_a9\" is not a link parameter", "from 1 to 7"),
        (drawn("compliances = \"some\""), "\"some\" is not a valid choice", "\"drives\", or a list"),
        (drawn("compliances = [\"mass3\"]"), "\"mass3\" is not a compliance", "\"compliance_rod\""),
        (drawn("linkage_mm = 120"), "could have length zero", "less"),
        (drawn("linkage_mm = 80"), "as_built.drawn: with linkage_mm", "elbow's limits"),
    ] {
        match paper_with(&sections) {
            Err(InputError::Invalid { message: found, help: expected, line, .. }) => {
                assert!(found.contains(message), "{sections}: {found}");
                assert!(expected.as_deref().is_some_and(|e| e.contains(help)), "{sections}: {expected:?}");
                assert!(line > 100, "{sections}: line {line}");
            }
            other => panic!("{sections}: {:?}", other.map(|scenario| scenario.name)),
        }
    }
    for (keys, message) in
        [("bearing_factor = 0", "bearing_factor is 0"), ("beam_factor = -1", "beam_factor is -1")]
    {
        let error = shoulder_with(keys).unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
    }
    let roll = "[[as_built.joint]]\njoint = \"roll\"\nbeam_factor = 0.9";
    let error = paper_with(roll).unwrap_err().to_string();
    assert!(error.contains("beam_factor: joint \"roll\" has no [joint.beam]"), "{error}");
}

const DRAWN: &str = "[as_built.drawn]\ndistribution = \"normal\"\nlengths_mm = 0.5\nangles_mrad = 0.3\ncompliance_fraction = 0.1\n\
                     mass_fraction = 0.02\nlinkage_mm = 0.2\nlinkage_angles_mrad = 0.1\nbase_tilt_mrad = 0.5\ntarget_mm = 1";

#[test]
fn every_trial_has_its_own_machine_and_always_the_same() {
    let scenario = paper_with(DRAWN).expect("valid");
    let drawn = |seed, trial| scenario.as_built_for(seed, trial);
    assert_eq!(drawn(1, 4), drawn(1, 4));
    assert_ne!(drawn(1, 4), drawn(1, 5));
    assert_ne!(drawn(1, 4), drawn(2, 4));
    assert_eq!(scenario.of_trial(1, 4).as_built, drawn(1, 4));
    let given = paper_with("").expect("valid");
    assert_eq!(given.as_built_for(1, 4), given.as_built);
    // With nothing to spread, the given machine remains.
    let still = paper_with("[as_built.drawn]\ndistribution = \"uniform\"").expect("valid");
    assert_eq!(still.as_built_for(1, 4), given.as_built);
}

#[test]
fn the_session_of_a_trial_is_that_of_its_machine() {
    let shortened = |text: &str| {
        let scenario = paper_with(text).expect("valid");
        Scenario { identification_poses: 2, verification_poses: 0, ..scenario }
    };
    let scenario = shortened(DRAWN);
    let found = simulate(&scenario, 3, 7, PlantKind::Analytic, |_, _| {}).expect("a session");
    assert_eq!(found.truth.as_built, scenario.as_built_for(3, 7));
    let given = Scenario { as_built: scenario.as_built_for(3, 7), ..shortened("") };
    assert_eq!(simulate(&given, 3, 7, PlantKind::Analytic, |_, _| {}).expect("a session").sets, found.sets);
}

#[test]
fn another_size_of_one_kind_changes_no_deviation_of_another() {
    let one = paper_with(DRAWN).expect("valid").as_built_for(1, 0);
    let text = DRAWN
        .replace("lengths_mm = 0.5", "lengths_mm = 2")
        .replace("mass_fraction = 0.02", "mass_fraction = 0");
    let other = paper_with(&text).expect("valid").as_built_for(1, 0);
    assert_ne!(one.kinematics, other.kinematics);
    for (a, b) in one.kinematics.links.iter().zip(&other.kinematics.links) {
        assert_eq!((a.alpha, a.theta, a.beta), (b.alpha, b.theta, b.beta));
    }
    assert_eq!(one.statics.drive_stiffness, other.statics.drive_stiffness);
    assert_eq!(one.statics.gravity, other.statics.gravity);
    assert_eq!((one.actuators, one.target), (other.actuators, other.target));
}

#[test]
fn only_the_listed_link_parameters_deviate() {
    let scenario = paper_with(&format!("{DRAWN}\nparameters = \"neighbour_axis_rules\"")).expect("valid");
    let (base, drawn) = (&scenario.as_built, scenario.as_built_for(1, 0));
    let deviating: Vec<_> = ParameterId::all_of_links(7)
        .into_iter()
        .filter(|id| match *id {
            ParameterId::Link { link, term } => {
                base.kinematics.links[link].term(term) != drawn.kinematics.links[link].term(term)
            }
            _ => false,
        })
        .collect();
    assert_eq!(deviating, neighbour_axis_rules(&scenario.robot.model.kinematics).0);
    assert_eq!(deviating.len(), 24);
    let all = paper_with(DRAWN).expect("valid").drawn.expect("a distribution");
    assert_eq!(all.link_parameters.len(), 35);
    let complete = paper_with(&format!("{DRAWN}\nparameters = \"complete\"")).expect("valid");
    let set = complete_set_of(&complete.robot.model, false, false).expect("a chain").selected;
    assert_eq!(complete.drawn.expect("a distribution").link_parameters, of_links(&set));
    assert_eq!(set.len(), 26, "the published ones and two betas");
}

#[test]
fn only_the_listed_compliances_deviate() {
    let text = format!("{DRAWN}\ncompliances = [\"compliance_drive4\", \"compliance_rod\"]");
    let listed = paper_with(&text).expect("valid");
    let (base, drawn) = (&listed.as_built.statics, listed.as_built_for(1, 0).statics);
    let deviating: Vec<_> = (listed.robot.model.compliances().into_iter())
        .filter(|which| base.stiffness(*which) != drawn.stiffness(*which))
        .collect();
    assert_eq!(deviating, [Compliance::Drive { joint: 3 }, Compliance::Rod]);
    // And as they do where others do as well.
    let all = paper_with(DRAWN).expect("valid").as_built_for(1, 0).statics;
    for which in deviating {
        assert_eq!(all.stiffness(which), drawn.stiffness(which));
    }
    let drives = paper_with(&format!("{DRAWN}\ncompliances = \"drives\"")).expect("valid");
    assert_eq!(drives.drawn.expect("a distribution").compliances.len(), 8);
}

/// Over many machines: means within 5 standard errors, standard deviations within 5 of theirs (1/sqrt(2 n), relative).
#[test]
fn the_drawn_machines_have_the_stated_spread() {
    let trials = 600_u32;
    let n = f64::from(trials);
    for (distribution, sigma_of_size) in [("normal", 1.0), ("uniform", 1.0 / f64::sqrt(3.0))] {
        let text = DRAWN.replace("normal", distribution);
        let scenario = paper_with(&text).expect("valid");
        let base = &scenario.as_built;
        let machines: Vec<_> = (0..trials).map(|trial| scenario.as_built_for(5, trial)).collect();
        let rod = |machine: &AsBuilt| machine.actuators.four_bar().map_or(0.0, |(.., linkage)| linkage.rod);
        let axial = |machine: &AsBuilt| first_beam(machine, 4).segments[0].section.axial;
        type Deviation<'a> = &'a dyn Fn(&AsBuilt) -> f64;
        let kinds: [(&str, f64, Deviation); 8] = [
            ("a", 0.5e-3, &|m| m.kinematics.links[3].a - base.kinematics.links[3].a),
            ("beta", 0.3e-3, &|m| m.kinematics.links[0].beta - base.kinematics.links[0].beta),
            ("drive", 0.1, &|m| base.statics.drive_stiffness[2] / m.statics.drive_stiffness[2] - 1.0),
            ("beam", 0.1, &|m| axial(base) / axial(m) - 1.0),
            ("mass", 0.02, &|m| m.statics.bodies[4].mass / base.statics.bodies[4].mass - 1.0),
            ("rod", 0.2e-3, &|m| rod(m) - rod(base)),
            // Gravity is along -y, so that a turn about x shows in z.
            ("tilt", 0.5e-3, &|m| m.statics.gravity.z / 9.80665),
            ("target", 1e-3, &|m| m.target.y - base.target.y),
        ];
        for (kind, size, deviation) in kinds {
            let expected = size * sigma_of_size;
            let values: Vec<f64> = machines.iter().map(deviation).collect();
            let mean = values.iter().sum::<f64>() / n;
            let spread = (values.iter().map(|v| v * v).sum::<f64>() / n).sqrt();
            assert!(mean.abs() < 5.0 * expected / n.sqrt(), "{distribution} {kind}: mean {mean:e}");
            assert!(
                (spread / expected - 1.0).abs() < 5.0 / (2.0 * n).sqrt(),
                "{distribution} {kind}: {spread:e}"
            );
            if distribution == "uniform" {
                assert!(values.iter().all(|v| v.abs() <= size * (1.0 + 1e-6)), "{kind}");
            }
        }
        assert!(
            machines.iter().all(|m| m.statics.bearings[0].stiffness[2].is_infinite()),
            "rigid stays rigid"
        );
    }
}
