//! The robot's file: what is read, and every refusal.

use super::*;
use calibrig_model::geometry::{Transform, rotation_x, rotation_z, translation};
use calibrig_model::random::{StreamSource as Stream, stream};
use calibrig_model::{
    ActuatorMap, BeamRun, BearingSide, CrankAxis, FourBar, JointKind, KinematicModel, LinkageArm,
    SegmentLength,
};
use proptest::prelude::*;
use rand::RngExt;

const CENTRE: [f64; 7] = [2.0, 0.19, -1.71, 0.12, 2.0, -0.16, -0.77];
const HALF_WIDTH: [f64; 7] = [1.92, 0.39, 0.31, 0.20, 0.30, 1.18, 0.57];

/// `base_from_flange`: the product of the link transforms.
pub(crate) fn base_from_flange(chain: &KinematicModel, q: &[f64]) -> Transform {
    let links = chain.links.iter().zip(q);
    links.fold(Transform::identity(), |frame, (link, q)| frame * link.transform(*q)) * chain.last_from_flange
}

fn model_file(name: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models").join(name)
}

fn spray_painter() -> Robot {
    load_robot(&model_file("spray_painter/robot.toml")).expect("the model of the repository")
}

const TWO_JOINTS: &str = r#"
schema = "calibrig.robot/1"
name = "two"
convention = "craig"
[[joint]]
name = "slide"
type = "prismatic"
a_mm = 0
alpha_deg = 0
d_mm = 100
theta_deg = 0
min_mm = 0
max_mm = 500
[[joint]]
name = "swing"
type = "revolute"
a_mm = 250.5
alpha_deg = -90
d_mm = 0
theta_deg = 30
beta_deg = 1
min_deg = -180
max_deg = 90
[actuators]
kind = "direct"
"#;

fn parse(text: &str) -> Result<Robot, InputError> {
    parse_robot(Source::new("robot.toml", text), None, None)
}

/// Message, line and help of the refusal of `TWO_JOINTS` with `from` replaced by `to`.
fn refusal(from: &str, to: &str) -> (String, usize, String) {
    assert!(TWO_JOINTS.contains(from), "{from}");
    let text = TWO_JOINTS.replacen(from, to, 1);
    match parse(&text) {
        Err(InputError::Invalid { message, line, help, .. }) => (message, line, help.unwrap_or_default()),
        other => panic!("{from} -> {to}: {other:?}"),
    }
}

#[test]
fn numbers_are_converted_on_entry() {
    let robot = parse(TWO_JOINTS).expect("valid");
    let [slide, swing] = robot.model.kinematics.links.as_slice() else { panic!("two links") };
    assert_eq!((slide.kind, slide.d, slide.limits), (JointKind::Prismatic, 0.1, [0.0, 0.5]));
    assert_eq!((swing.a, swing.alpha), (0.2505, -std::f64::consts::FRAC_PI_2));
    assert!((swing.beta - 0.017_453_292_519_943_295).abs() < 1e-17);
    assert_eq!(swing.limits, [-std::f64::consts::PI, std::f64::consts::FRAC_PI_2]);
    assert_eq!(robot.model.kinematics.last_from_flange, Transform::identity());
    assert_eq!(
        (robot.model.actuators, robot.model.statics, robot.targets.len()),
        (ActuatorMap::Direct, None, 0)
    );
    assert!(robot.visuals.is_empty());
}

#[test]
fn every_mistake_is_named_with_its_line_and_what_was_expected() {
    for (from, to, message, line, help) in [
        ("\"calibrig.robot/1\"", "\"calibrig.robot/2\"", "calibrig.robot/2", 2, "calibrig.robot/1"),
        ("\"two\"", "\" \"", "name is empty", 3, "name"),
        ("\"craig\"", "\"mdh\"", "convention is \"mdh\"", 4, "`craig`"),
        ("a_mm = 0\n", "a = 0\n", "unknown key `a`", 8, "`a_mm`"),
        ("a_mm = 0\n", "", "missing key `a_mm` in [joint]", 5, "unit"),
        ("a_mm = 0\n", "a_mm = \"0\"\n", "joint.a_mm is \"0\"", 8, "a number"),
        ("a_mm = 0\n", "a_mm = nan\n", "a_mm is nan", 8, "finite"),
        ("d_mm = 100\n", "d_mm = -inf\n", "d_mm is -inf", 10, "finite"),
        ("\"prismatic\"", "\"linear\"", "joint.type is \"linear\"", 7, "`prismatic`"),
        ("min_mm", "min_deg", "min_deg of joint \"slide\", which is prismatic", 12, "min_mm"),
        ("max_deg", "max_mm", "max_mm of joint \"swing\", which is revolute", 23, "max_deg"),
        ("max_mm = 500\n", "", "joint \"slide\" has no max_mm", 5, "max_mm"),
        ("max_mm = 500", "max_mm = -1", "max_mm of joint \"slide\" is not above min_mm", 13, "below"),
        ("\"swing\"", "\"slide\"", "a second joint \"slide\"", 15, "a different name"),
        ("\"swing\"", "\"\"", "name is empty", 15, "name"),
        ("max_mm = 500", "max_mm = 500\nstiffness_n_per_m = 0", "stiffness_n_per_m is 0", 14, "above zero"),
        (
            "max_mm = 500",
            "max_mm = 500\nstiffness_nm_per_rad = 1",
            "which is prismatic",
            14,
            "stiffness_n_per_m",
        ),
        (
            "max_mm = 500",
            "max_mm = 500\nstiffness_n_per_m = 1e6",
            "\"swing\" has no stiffness_nm_per_rad",
            15,
            "every",
        ),
        ("\"direct\"", "\"belt\"", "actuators.kind is \"belt\"", 25, "`direct`"),
        ("\"direct\"", "\"direct\"\noffset_deg = 0", "no linkage", 26, "parallelogram"),
        ("\"direct\"", "\"parallelogram\"", "no shoulder", 24, "revolute"),
        (
            "\"direct\"",
            "\"parallelogram\"\nshoulder = \"hip\"",
            "no joint is named \"hip\"",
            26,
            "slide, swing",
        ),
        ("\"direct\"", "\"parallelogram\"\nshoulder = \"slide\"", "\"slide\" is prismatic", 26, "revolute"),
        (
            "\"direct\"",
            "\"parallelogram\"\nshoulder = \"swing\"\nelbow = \"swing\"\noffset_deg = 0",
            "the same joint",
            27,
            "two different",
        ),
        (
            "[actuators]",
            "[target]\nx_mm = 1\ny_mm = 2\n[actuators]",
            "missing key `z_mm` in [target]",
            24,
            "unit",
        ),
        (
            "[actuators]",
            "[gravity]\nx_m_per_s2 = 0\ny_m_per_s2 = 0\nz_m_per_s2 = -9.8\n[actuators]",
            "no drive has a stiffness",
            24,
            "every joint",
        ),
        ("[actuators]\nkind = \"direct\"\n", "", "missing key `actuators`", 1, ""),
        (
            "name = \"two\"",
            "name = \"two\"\nurdf = \"a.urdf\"",
            "the file \"a.urdf\" of urdf was not given",
            4,
            "text",
        ),
        ("convention", "convention = = ", "", 4, ""),
    ] {
        let (found, at, expected) = refusal(from, to);
        assert!(found.contains(message), "{to}: {found}");
        assert!(expected.contains(help), "{to}: {expected}");
        assert_eq!(at, line, "{to}: {found}");
    }
    let (found, ..) =
        refusal(&TWO_JOINTS[TWO_JOINTS.find("[[joint]]").unwrap()..TWO_JOINTS.find("[act").unwrap()], "");
    assert!(found.contains("the robot has no joint"), "{found}");
}

#[test]
fn absent_files_and_folders_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let absent = folder.path().join("robot.toml");
    assert!(load_robot(&absent).unwrap_err().to_string().contains("robot.toml"));
    assert!(load_robot(folder.path()).unwrap_err().to_string().contains("folder"));
    std::fs::write(&absent, TWO_JOINTS.replace("\"craig\"", "\"craig\"\nurdf = \"none.urdf\"")).unwrap();
    let error = load_robot(&absent).unwrap_err().to_string();
    assert!(error.contains("robot.toml:5: urdf: cannot read") && error.contains("none.urdf"), "{error}");
    std::fs::write(&absent, [0x66, 0xff, 0xfe]).unwrap();
    assert!(load_robot(&absent).unwrap_err().to_string().contains("not UTF-8"));
}

/// Against the product of the standard link transforms `Rz(theta + q) Tz(d) Tx(a) Rx(alpha)`.
#[test]
fn a_standard_table_moves_the_same_flange_as_its_own_product() {
    let table = [
        (89.159, 0.0, 90.0),
        (0.0, -425.0, 0.0),
        (0.0, -392.25, 0.0),
        (109.15, 0.0, 90.0),
        (94.65, 0.0, -90.0),
        (82.3, 0.0, 0.0),
    ];
    let ur5 = load_robot(&model_file("ur5/robot.toml")).expect("the model of the repository");
    assert_eq!(ur5.compliance_sigma, Some(1.0));
    let mut rng = stream(3, 0, Stream::AsBuilt);
    for _ in 0..50 {
        let q: Vec<f64> = (0..6).map(|_| rng.random_range(-3.0..3.0)).collect();
        let product = table.iter().zip(&q).fold(Transform::identity(), |product, ((d, a, alpha), q)| {
            let alpha: f64 = *alpha;
            product * rotation_z(*q) * translation(a / 1e3, 0.0, d / 1e3) * rotation_x(alpha.to_radians())
        });
        let found = base_from_flange(&ur5.model.kinematics, &q);
        assert!((found.to_homogeneous() - product.to_homogeneous()).norm() < 1e-14);
    }
    // A table that ends with a link of its own: 45 mm and a quarter turn behind the last joint.
    let text = TWO_JOINTS.replace("\"craig\"", "\"standard\"").replace("beta_deg = 1\n", "");
    let two = parse(&text).expect("valid").model.kinematics;
    assert_eq!(
        (two.links[0].a, two.links[0].alpha, two.links[1].a, two.links[1].alpha),
        (0.0, 0.0, 0.0, 0.0)
    );
    let expected = translation(0.2505, 0.0, 0.0) * rotation_x(-std::f64::consts::FRAC_PI_2);
    assert_eq!(two.last_from_flange, expected);
    let with_beta = TWO_JOINTS.replace("\"craig\"", "\"standard\"");
    assert!(parse(&with_beta).unwrap_err().to_string().contains("beta_deg"));
}

#[test]
fn the_wam_reaches_its_published_height() {
    let wam = load_robot(&model_file("wam/robot.toml")).expect("the model of the repository");
    // Stretched upwards: 550 + 300 + 60 mm, the two 45 mm offsets cancel.
    let stretched = base_from_flange(&wam.model.kinematics, &[0.0; 7]).translation.vector;
    assert!((stretched - Vector3::new(0.0, 0.0, 0.91)).norm() < 1e-14, "{stretched}");
}

#[test]
fn the_spray_painter_has_the_published_table_and_contains_the_working_region() {
    let robot = spray_painter();
    let expected = [
        (JointKind::Prismatic, 0.0, 0.0, 0.0),
        (JointKind::Revolute, 0.0, -90.0, 0.626),
        (JointKind::Revolute, 0.25, -90.0, 0.0),
        (JointKind::Revolute, 1.35, 0.0, 0.0),
        (JointKind::Prismatic, 0.246, -90.0, 0.0),
        (JointKind::Revolute, 0.0, 0.0, 0.0),
        (JointKind::Revolute, 0.0, 90.0, 0.0),
    ];
    for (index, (link, (kind, a, alpha, d))) in robot.model.kinematics.links.iter().zip(expected).enumerate()
    {
        assert_eq!((link.kind, link.a, link.alpha.to_degrees(), link.d), (kind, a, alpha, d), "{index}");
        assert_eq!((link.theta, link.beta), (0.0, 0.0));
        assert!(link.limits[0] <= CENTRE[index] - HALF_WIDTH[index] + 1e-12, "{index}");
        assert!(link.limits[1] >= CENTRE[index] + HALF_WIDTH[index] - 1e-12, "{index}");
    }
    let (shoulder, elbow, offset, _) = robot.model.actuators.four_bar().expect("a four-bar");
    assert_eq!((shoulder, elbow, offset), (2, 3, 0.0));
    assert_eq!(robot.target(), Some(Vector3::new(0.10, 0.15, 0.20)));
    let statics = robot.model.statics.expect("masses, stiffnesses and gravity");
    let masses: Vec<f64> = statics.bodies.iter().map(|body| body.mass).collect();
    assert_eq!(masses, [800.0, 400.0, 250.0, 150.0, 80.0, 25.0, 15.0]);
    assert_eq!(statics.gravity, Vector3::new(0.0, -9.80665, 0.0));
    assert_eq!(robot.visuals.len(), 8);
    assert!(robot.visuals.iter().all(|shapes| !shapes.is_empty()));
}

#[test]
fn what_yields_is_read_with_its_units() {
    let robot = spray_painter();
    let statics = robot.model.statics.as_ref().expect("stated");
    let telescope = &statics.bearings[4];
    assert_eq!((telescope.side, telescope.at), (BearingSide::Fixed, 1.25));
    assert_eq!(telescope.stiffness, [1e8, 1e8, f64::INFINITY, 5e6, 5e6, 1e6]);
    assert_eq!(statics.bearings[1].stiffness, [1e9, 1e9, 1.5e9, 6e7, 6e7, f64::INFINITY]);
    let tube = statics.beams[4].as_ref().expect("a beam");
    assert_eq!(tube.run, BeamRun::EndsAtOrigin);
    assert_eq!(tube.segments[0].length, SegmentLength::Extension(1.25));
    // 4.32e-3 m² of steel.
    assert!((tube.segments[0].section.mass_per_length - 33.93).abs() < 0.01);
    let arm = statics.beams[2].as_ref().expect("a beam");
    assert_eq!((arm.run, arm.segments[0].length), (BeamRun::AlongX, SegmentLength::Constant(1.35)));
    assert!((arm.mass(0.0) - 0.01 * 1.35 * 7850.0).abs() < 1e-9);
    // 0.28 m along y: stiffer about z.
    let [about_y, about_z] = arm.segments[0].section.bending;
    assert!(about_z > 1.2 * about_y);
    assert!(statics.beams.iter().enumerate().all(|(joint, beam)| beam.is_some() == [2, 4].contains(&joint)));

    let (.., linkage) = robot.model.actuators.four_bar().expect("a four-bar");
    let arm = LinkageArm { length: 0.35, angle: std::f64::consts::FRAC_PI_2, along: 0.25 };
    assert_eq!(*linkage, FourBar { crank: arm, lever: arm, rod: 1.35, axis: CrankAxis::default() });
    let linkage = statics.linkage.as_ref().expect("its statics");
    assert_eq!((linkage.rod_stiffness, linkage.rod_mass, linkage.crank.mass), (8e7, 12.0, 15.0));
    assert!((linkage.crank.centre_of_mass - Vector3::new(0.0, 0.15, 0.25)).norm() < 1e-15);
    let per_radian = 180.0 / std::f64::consts::TAU;
    assert_eq!(robot.model.motor_turns[2..5], [Some(per_radian), Some(per_radian), Some(200.0)]);
}

#[test]
fn loads_are_read_with_their_units() {
    let robot = painter_with(
        "[gravity]",
        "[[load]]\nname = \"hose\"\njoint = \"telescope\"\nx_mm = 1\ny_mm = 2\nz_mm = -300\nmass_kg = 4\nforce_y_n = -5\n[gravity]",
    );
    let statics = robot.expect("valid").model.statics.expect("stated");
    let [hose] = statics.loads.as_slice() else { panic!("one load") };
    assert_eq!((hose.name.as_str(), hose.link, hose.mass), ("hose", 4, 4.0));
    assert_eq!(hose.at, Vector3::new(0.001, 0.002, -0.3));
    assert_eq!(hose.force, Vector3::new(0.0, -5.0, 0.0));
}

/// The spray painter with `from` replaced by `to` in its file.
#[track_caller]
fn painter_with(from: &str, to: &str) -> Result<Robot, InputError> {
    let text = |name| Source::read(&model_file(name)).expect("the model of the repository");
    let robot = text("spray_painter/robot.toml").text;
    assert!(robot.contains(from), "{from}");
    let changed = Source::new("robot.toml", robot.replacen(from, to, 1));
    parse_robot(changed, Some(text("spray_painter/robot.urdf")), None)
}

#[test]
fn every_mistake_in_what_yields_is_named() {
    let rail = "stiffness_x_n_per_m = 1.0e9\nstiffness_y_n_per_m = 1.0e9\nstiffness_rx_nm_per_rad = 2.0e8\n\
                stiffness_ry_nm_per_rad = 2.0e8\nstiffness_rz_nm_per_rad = 1.2e8\n";
    let load = |keys: &str| {
        let table = |keys: &str| format!("[[load]]\nname = \"hose\"\nx_mm = 0\ny_mm = 0\nz_mm = 0\n{keys}\n");
        format!("{}[gravity]", keys.split(';').map(table).collect::<String>())
    };
    for (from, to, message, help) in [
        ("stiffness_x_n_per_m = 1.0e9", "stiffness_x_n_per_m = 0", "stiffness_x_n_per_m is 0", "above zero"),
        ("stiffness_ry_nm_per_rad = 2.0e8", "stiffness_z_n_per_m = 1", "axis of joint \"rail\"", "drive"),
        (
            "stiffness_rx_nm_per_rad = 6.0e7",
            "stiffness_rz_nm_per_rad = 1",
            "axis of joint \"waist\"",
            "drive",
        ),
        (rail, "", "[joint.bearing] of joint \"rail\" has no stiffness", "at least one"),
        ("side = \"fixed\"", "side = \"left\"", "joint.bearing.side is \"left\"", "`moving`"),
        ("at_mm = 1250", "at_mm = nan", "at_mm is nan", "finite"),
        ("run = \"along_x\"", "run = \"along_y\"", "joint.beam.run is \"along_y\"", "`along_x`"),
        ("length_mm = 1350", "length_mm = 0", "length_mm is 0", "above zero"),
        ("length_mm = 1350", "housed_mm = 1", "joint \"shoulder\", which is not a telescope", "length_mm"),
        ("length_mm = 1350", "", "a segment without a length", "housed_mm"),
        ("length_mm = 1350", "length_mm = 1\nhoused_mm = 1", "both length_mm and housed_mm", "one"),
        ("housed_mm = 1250", "housed_mm = 1700", "leaves no length of the segment at min_mm", "below min_mm"),
        ("wall_mm = 8", "wall_mm = 90", "leaves no hollow", "half"),
        ("box_height_mm = 240\n", "", "not exactly one tube or one box", "tube_diameter_mm"),
        (
            "tube_diameter_mm = 180\n",
            "tube_diameter_mm = 1\nbox_width_mm = 1\n",
            "not exactly one tube or one box",
            "box",
        ),
        (
            "youngs_modulus_gpa = 210\n",
            "",
            "missing key `youngs_modulus_gpa` in [joint.beam.segment]",
            "unit",
        ),
        ("shear_modulus_gpa = 81", "shear_modulus_gpa = 120", "Poisson's ratio of -0.12", "half"),
        ("density_kg_per_m3 = 7850", "", "a segment without a weight", "mass_per_length_kg_per_m"),
        (
            "density_kg_per_m3 = 7850",
            "density_kg_per_m3 = 1\nmass_per_length_kg_per_m = 1",
            "both density",
            "one",
        ),
        ("density_kg_per_m3 = 7850", "density_kg_per_m3 = -1", "density_kg_per_m3 is -1", "zero or more"),
        (
            "density_kg_per_m3 = 7850",
            "density_kg_per_m3 = 20000",
            "beam of joint \"shoulder\" weighs 270.000 kg, more than the 250 kg of its whole link",
            "lighter",
        ),
        (
            "motor_turns_per_m = 100",
            "motor_turns_per_rev = 1",
            "motor_turns_per_rev of joint \"rail\"",
            "per_m",
        ),
        ("motor_turns_per_m = 100", "motor_turns_per_m = 0", "motor_turns_per_m is 0", "above zero"),
        ("crank_mm = 350\n", "", "missing key `crank_mm` in [actuators.linkage]", "unit"),
        ("rod_mm = 1350", "rod_mm = -1", "rod_mm is -1", "above zero"),
        ("rod_mm = 1350", "rod_mm = 1800", "does not close with the elbow at -45.0 deg", "rod_mm"),
        ("\nangle_deg = 90", "\nangle_deg = 20", "of one line with the elbow at -20.", "at least 10 deg"),
        ("\nangle_deg = 90", "", "does not state the angle of crank and lever", "lever_angle_deg"),
        ("\nangle_deg = 90", "\nangle_deg = 90\nlever_angle_deg = 90", "or states it twice", "angle_deg, or"),
        ("along_mm = 250", "along_mm = inf", "along_mm is inf", "finite"),
        ("rod_stiffness_n_per_m = 8", "rod_stiffness_n_per_m = 0", "rod_stiffness_n_per_m is 0", "above"),
        ("rod_mass_kg = 12", "rod_mass_kg = -1", "rod_mass_kg is -1", "zero or more"),
        (
            "elbow = \"elbow\"",
            "elbow = \"roll\"",
            "spans more than shoulder and elbow",
            "right after the shoulder",
        ),
        ("[gravity]", &load("joint = \"wrist\""), "load \"hose\" has neither mass nor force", "mass_kg"),
        ("[gravity]", &load("joint = \"hand\"\nmass_kg = 1"), "no joint is named \"hand\"", "wrist"),
        ("[gravity]", &load("joint = \"wrist\"\nmass_kg = -1"), "mass_kg is -1", "zero or more"),
        ("[gravity]", &load("joint = \"wrist\"\nforce_x_n = nan"), "force_x_n is nan", "finite"),
        (
            "[gravity]",
            &load("joint = \"wrist\"\nmass_kg = 1;joint = \"wrist\"\nmass_kg = 1"),
            "a second load \"hose\"",
            "a different name",
        ),
    ] {
        match painter_with(from, to) {
            Err(InputError::Invalid { message: found, help: expected, line, .. }) => {
                assert!(found.contains(message), "{to}: {found}");
                assert!(expected.as_deref().is_some_and(|e| e.contains(help)), "{to}: {expected:?}");
                assert!(line > 1, "{to}: {found}");
            }
            other => panic!("{from} -> {to}: {other:?}"),
        }
    }
    let segments = "[[joint.beam.segment]]\nhoused_mm = 1250\ntube_diameter_mm = 180\nwall_mm = 8\nyoungs_modulus_gpa = 210\n\
                    shear_modulus_gpa = 81\ndensity_kg_per_m3 = 7850\n";
    let error = painter_with(segments, "").unwrap_err().to_string();
    assert!(error.contains("[joint.beam] of joint \"telescope\" has no segment"), "{error}");
}

#[test]
fn what_yields_needs_drives_and_gravity() {
    for (addition, what) in [
        ("[joint.bearing]\nstiffness_x_n_per_m = 1\n[actuators]", "[joint.bearing]"),
        (
            "[[load]]\nname = \"a\"\njoint = \"swing\"\nx_mm = 0\ny_mm = 0\nz_mm = 0\nmass_kg = 1\n[actuators]",
            "[[load]]",
        ),
    ] {
        let (found, line, help) = refusal("[actuators]", addition);
        assert!(found.contains(what) && found.contains("no drive has a stiffness"), "{found}");
        assert!(help.contains("[gravity]") && line >= 24, "{help} {line}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    #[test]
    fn no_mutation_of_a_robot_file_panics(at in 0usize..900, remove in 0usize..6, insert in "\\PC{0,3}|[\"\\[\\]=.\n-]{0,3}") {
        let mut text: Vec<char> = TWO_JOINTS.chars().collect();
        let at = at.min(text.len());
        let end = (at + remove).min(text.len());
        text.splice(at..end, insert.chars());
        let text: String = text.into_iter().collect();
        if let Err(error) = parse(&text) {
            let drawn = format!("{:?}", miette::Report::new(error));
            prop_assert!(!drawn.is_empty());
        }
    }
}

/// `TWO_JOINTS` with this in front of `[actuators]`, at line 24.
fn with_target(text: &str) -> Result<Robot, InputError> {
    parse(&TWO_JOINTS.replace("[actuators]", &format!("{text}\n[actuators]")))
}

#[test]
fn a_target_is_stated_alone_or_as_one_of_several() {
    let at = "x_mm = 10\ny_mm = -20\nz_mm = 30.5";
    let one = with_target(&format!("[target]\n{at}")).expect("valid");
    assert_eq!(one.target(), Some(Vector3::new(0.01, -0.02, 0.0305)));
    assert_eq!((&one.targets[0].name, one.targets[0].sigma, one.targets.len()), (&None, None, 1));
    let sure = with_target(&format!("[target]\nname = \"SMR1\"\n{at}\nsigma_mm = 0.02")).expect("valid");
    assert_eq!(sure.targets[0].name.as_deref(), Some("SMR1"));
    assert_eq!(sure.targets[0].sigma, Some(2e-5));
    let table = |name: &str, more: &str| format!("[[target]]\nname = \"{name}\"\n{at}\n{more}\n");
    let several = with_target(&(table("A", "sigma_mm = 0.02") + &table("B", ""))).expect("valid");
    let told: Vec<_> = several.targets.iter().map(|t| (t.name.as_deref(), t.sigma)).collect();
    assert_eq!(told, [(Some("A"), Some(2e-5)), (Some("B"), None)]);
    assert_eq!(sure.targets[0].orientation, None);
    let turned =
        with_target(&format!("[target]\n{at}\nrotation_vector_deg = [0, 0, 90]\nrotation_sigma_urad = 50"))
            .expect("valid");
    let turn = turned.targets[0].orientation.as_ref().expect("stated");
    assert!((turn.flange_from_target * Vector3::x() - Vector3::y()).amax() < 1e-15);
    assert!((turn.covariance.expect("stated").m33.sqrt() - 5e-5).abs() < 1e-18);
}

#[test]
fn a_target_that_cannot_be_is_refused_at_its_line() {
    let at = "x_mm = 1\ny_mm = 2\nz_mm = 3";
    for (text, message, line, help) in [
        (format!("[target]\n{at}\nsigma_mm = -0.02"), "target.sigma_mm is -0.02", 28, "above zero"),
        (format!("[target]\n{at}\nsigma_mm = nan"), "target.sigma_mm is nan", 28, "finite"),
        (format!("[target]\n{at}\nsigma_mm = 0"), "but no measurement is exact", 28, "no sigma_mm"),
        (format!("[target]\n{at}\nsigma_kg = 20"), "unknown key `sigma_kg`", 28, "`sigma_mm`"),
        (format!("[target]\n{at}\nsigma = 0.02"), "unknown key `sigma`", 28, "unit is part of the key"),
        (format!("[target]\n{at}\nsigma_mm = \"0.02\""), "target.sigma_mm is \"0.02\"", 28, "a number"),
        ("[target]\nx_s = 1\ny_mm = 2\nz_mm = 3".to_owned(), "unknown key `x_s`", 25, "`x_mm`"),
        ("[target]\nx_mm = inf\ny_mm = 2\nz_mm = 3".to_owned(), "target.x_mm is inf", 25, "finite"),
        (format!("[target]\nname = \" \"\n{at}"), "target.name is empty", 25, "measurement files"),
        (
            format!("[target]\n{at}\nrotation_quaternion_xyzw = [0, 0, 0, 0.9]"),
            "the quaternion has length 0.900000, which differs from 1 by 1.0e-1",
            28,
            "w among them",
        ),
        (
            format!("[target]\n{at}\nrotation_matrix = [[0, 1, 0], [1, 0, 0], [0, 0, 1]]"),
            "the matrix is left-handed: its determinant is -1.0000",
            28,
            "right-handed",
        ),
        (
            format!("[target]\n{at}\nrotation_euler_deg = [0, 1, 2]"),
            "the sequence of the angles is not stated",
            28,
            "rotation_sequence = \"zyx intrinsic\"",
        ),
        (
            format!("[[target]]\nname = \"A\"\n{at}\n[[target]]\n{at}"),
            "2 targets are stated, but this one has no name",
            29,
            "target column",
        ),
        (
            format!("[[target]]\nname = \"A\"\n{at}\n[[target]]\nname = \"A\"\n{at}"),
            "a second target \"A\"",
            30,
            "a different name",
        ),
        (
            format!("[[target]]\nname = \"A\"\n{at}\n[[target]]\nname = \"B\"\nx_mm = 1\ny_mm = 2"),
            "missing key `z_mm` in [target]",
            29,
            "unit",
        ),
        (
            format!("[[target]]\nname = \"A\"\n{at}\n[[target]]\nname = \"B\"\n{at}\nsigma_kg = 1"),
            "unknown key `sigma_kg`",
            34,
            "`sigma_mm`",
        ),
        (format!("[target]\n{at}\n[[target]]\n{at}"), "target", 28, ""),
    ] {
        match with_target(&text) {
            Err(InputError::Invalid { message: found, line: at, help: expected, .. }) => {
                assert!(found.contains(message), "{text}: {found}");
                assert_eq!(at, line, "{text}: {found}");
                assert!(expected.unwrap_or_default().contains(help), "{text}: {found}");
            }
            other => panic!("{text}: {other:?}"),
        }
    }
    let text = TWO_JOINTS.replace("convention", "target = 3\nconvention");
    let error = parse(&text).expect_err("no table").to_string();
    assert!(error.contains("robot.toml:4: target is 3"), "{error}");
}

#[test]
fn how_well_stiffnesses_masses_and_centres_are_known_is_read_for_all_and_for_one() {
    let silent = spray_painter();
    assert!(!silent.stiffness_unknown && silent.bodies.is_empty());
    let head = "schema = \"calibrig.robot/1\"";
    let unknown = painter_with(head, &format!("{head}\ncompliance_percent = \"unknown\"")).expect("valid");
    assert!(unknown.stiffness_unknown && unknown.compliance_sigma.is_none());

    let text = spray_painter().sources[0].1.text.clone();
    let name =
        text.lines().filter(|line| line.starts_with("name = ")).nth(2).expect("a second joint").to_owned();
    let both = text
        .replace(head, &format!("{head}\nmass_percent = 3\ncentre_mm = 5"))
        .replace(&name, &format!("{name}\nmass_percent = 0\ncentre_mm = 1.5"));
    let urdf = spray_painter().sources.into_iter().find(|(role, _)| role == "urdf").map(|(_, source)| source);
    let robot = parse_robot(Source::new("robot.toml", both), urdf, None).expect("valid");
    let stated: Vec<_> = robot.bodies.iter().map(|body| (body.mass, body.centre)).collect();
    let mut expected = vec![(0.03, 0.005); 7];
    expected[1] = (0.0, 0.0015);
    assert_eq!(stated, expected);

    for (line, message, help) in [
        ("compliance_percent = \"none\"", "compliance_percent is \"none\"", "\"unknown\""),
        ("compliance_percent = 0", "compliance_percent", "above zero"),
        ("mass_percent = -1", "mass_percent", "zero or more"),
        ("centre_mm = inf", "centre_mm", "finite"),
    ] {
        match painter_with(head, &format!("{head}\n{line}")) {
            Err(InputError::Invalid { message: found, help: expected, .. }) => {
                assert!(found.contains(message), "{line}: {found}");
                assert!(expected.is_some_and(|expected| expected.contains(help)), "{line}");
            }
            other => panic!("{line}: {other:?}"),
        }
    }
    let error =
        parse(&TWO_JOINTS.replace(head, &format!("{head}\nmass_percent = 3"))).expect_err("no masses");
    assert!(error.to_string().contains("no masses"), "{error}");
}

/// The text of `TWO_JOINTS` with tables behind its second joint and at its end.
fn with(joint: &str, end: &str) -> String {
    TWO_JOINTS.replacen("max_deg = 90\n", &format!("max_deg = 90\n{joint}\n"), 1) + end
}

#[test]
fn what_the_controller_shows_is_turned_into_joint_variables() {
    let text = with("[joint.shown]\nsign = -1\nratio = 2\noffset_deg = 10\ncoupling = { slide = 0.5 }", "");
    let map = parse(&text).expect("valid").model.actuators;
    // -2 (q + 0.5 deg per mm of the slide) + 10 deg
    let (slide, swing) = (0.02, 0.3_f64);
    let shown = map.command_from_joints(&[slide, swing]);
    let expected = -2.0 * (swing.to_degrees() + 0.5 * 20.0) + 10.0;
    assert!(
        (shown[0] - slide).abs() < 1e-15 && (shown[1].to_degrees() - expected).abs() < 1e-12,
        "{shown:?}"
    );
    let mut joints = [0.0; 2];
    map.joints_from_command(&shown, &mut joints);
    assert!((joints[0] - slide).abs() < 1e-15 && (joints[1] - swing).abs() < 1e-15);
    assert!([0, 1].iter().all(|axis| map.is_commanded(*axis)));
}

#[test]
fn a_joint_that_follows_has_no_command() {
    let text = with("[joint.follows]\njoint = \"slide\"\nratio = -0.1\noffset_deg = 5", "");
    let map = parse(&text).expect("valid").model.actuators;
    assert_eq!([0, 1].map(|axis| map.is_commanded(axis)), [true, false]);
    let mut joints = [0.0; 2];
    map.joints_from_command(&[0.3, 0.0], &mut joints);
    // -0.1 deg per mm of 300 mm, and 5 deg.
    assert!((joints[1].to_degrees() + 25.0).abs() < 1e-12, "{joints:?}");
}

#[test]
fn frames_at_both_ends_are_those_of_a_urdf() {
    let text =
        with("", "[base]\nz_mm = 400\nroll_deg = 90\n[flange]\nx_mm = 10\npitch_deg = 90\nyaw_deg = -90\n");
    let robot = parse(&text).expect("valid");
    let chain = &robot.model.kinematics;
    let base = translation(0.0, 0.0, 0.4) * rotation_x(std::f64::consts::FRAC_PI_2);
    assert!((chain.base_from_first.to_homogeneous() - base.to_homogeneous()).norm() < 1e-15);
    let quarter = std::f64::consts::FRAC_PI_2;
    let flange =
        translation(0.01, 0.0, 0.0) * rotation_z(-quarter) * calibrig_model::geometry::rotation_y(quarter);
    assert!((chain.last_from_flange.to_homogeneous() - flange.to_homogeneous()).norm() < 1e-15);
}

const MASSES: [&str; 2] = [
    "stiffness_n_per_m = 1e6\n[joint.body]\nmass_kg = 20\nx_mm = 100\ny_mm = 0\nz_mm = -5\n",
    "stiffness_nm_per_rad = 1e4\n[joint.body]\nmass_kg = 3\nx_mm = 0\ny_mm = 50\nz_mm = 0\nixx_kg_m2 = 0.02\niyy_kg_m2 = 0.01\nizz_kg_m2 = 0.025\n",
];
const GRAVITY: &str = "[gravity]\nx_m_per_s2 = 0\ny_m_per_s2 = 0\nz_m_per_s2 = -9.81\n";

#[test]
fn masses_may_stand_in_the_robots_file() {
    let text =
        with(MASSES[1], GRAVITY).replacen("max_mm = 500\n", &format!("max_mm = 500\n{}", MASSES[0]), 1);
    let robot = parse(&text).expect("no URDF is needed");
    let statics = robot.model.statics.as_ref().expect("statics");
    let [slide, swing] = statics.bodies.as_slice() else { panic!("two bodies") };
    assert_eq!((slide.mass, slide.centre_of_mass), (20.0, nalgebra::Vector3::new(0.1, 0.0, -0.005)));
    assert!(slide.inertia[(0, 0)] > 0.0 && swing.inertia[(2, 2)] == 0.025);
    // In a standard table a body is in the frame behind its row, as manufacturers print it.
    let standard = text.replacen("\"craig\"", "\"standard\"", 1).replacen("beta_deg = 1\n", "", 1);
    let turned = parse(&standard).expect("valid").model.statics.expect("statics");
    let behind = translation(0.2505, 0.0, 0.0) * rotation_x(-std::f64::consts::FRAC_PI_2);
    let expected = behind * nalgebra::Point3::new(0.0, 0.05, 0.0);
    assert!((turned.bodies[1].centre_of_mass - expected.coords).norm() < 1e-15);
    assert!((turned.bodies[1].inertia[(1, 1)] - 0.025).abs() < 1e-15);
    // Masses beside a percentage, and none of one joint.
    assert!(parse(&text.replacen("name = \"two\"", "name = \"two\"\nmass_percent = 3", 1)).is_ok());
    let one =
        with(MASSES[1], GRAVITY).replacen("max_mm = 500\n", "max_mm = 500\nstiffness_n_per_m = 1e6\n", 1);
    let error = parse(&one).unwrap_err().to_string();
    assert!(error.contains("joint \"slide\" has no [joint.body], but others have"), "{error}");
}

#[test]
fn axes_and_bodies_that_cannot_be_are_refused() {
    for (joint, message) in [
        ("[joint.shown]\nsign = 2", "shown.sign of joint \"swing\" is 2"),
        ("[joint.shown]\nratio = 0", "shown.ratio is 0"),
        ("[joint.shown]\noffset_mm = 3", "an offset in the other unit, that of joint \"swing\""),
        ("[joint.shown]\ncoupling = { slid = 1 }", "shown.coupling: no joint is named \"slid\""),
        ("[joint.shown]\ncoupling = { swing = 1 }", "couples joint \"swing\" with itself"),
        (
            "[joint.follows]\njoint = \"swing\"",
            "joint \"swing\" is in a circle of joints that follow each other",
        ),
        ("[joint.follows]\njoint = \"lift\"", "follows.joint: no joint is named \"lift\""),
        ("[joint.follows]\njoint = \"slide\"\n[joint.shown]\nsign = -1", "has both shown and follows"),
        ("[joint.body]\nmass_kg = 0\nx_mm = 0\ny_mm = 0\nz_mm = 0", "body.mass_kg is 0"),
        (
            "[joint.body]\nmass_kg = 1\nx_mm = 0\ny_mm = 0\nz_mm = 0\nixx_kg_m2 = 1",
            "joint \"swing\" has only part of an inertia",
        ),
        (
            "[joint.body]\nmass_kg = 1\nx_mm = 0\ny_mm = 0\nz_mm = 0\nixx_kg_m2 = 1\niyy_kg_m2 = 1\nizz_kg_m2 = 3",
            "the inertia of joint \"swing\" is not that of a real body",
        ),
    ] {
        let text = with(joint, "");
        let error = parse(&text).unwrap_err().to_string();
        assert!(error.contains(message), "{joint}: {error}");
    }
    let circle = with("[joint.shown]\ncoupling = { slide = 2 }", "").replacen(
        "max_mm = 500\n",
        "max_mm = 500\n[joint.shown]\ncoupling = { swing = 0.5 }\n",
        1,
    );
    let error = parse(&circle).unwrap_err().to_string();
    assert!(error.contains("the coupling of the axes cannot be inverted: the"), "{error}");
}
