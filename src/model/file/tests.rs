//! The robot's file: what is read, and every refusal.

use super::*;
use crate::elastostatics::joint_deflections;
use crate::geometry::rotation_z;
use crate::geometry::{Transform, rotation_x, translation};
use crate::kinematics::{forward_kinematics, target_in_base};
use crate::model::{ActuatorMap, JointKind};
use crate::random::{Source as Stream, stream};
use proptest::prelude::*;
use rand::RngExt;

const CENTRE: [f64; 7] = [2.0, 0.19, -1.71, 0.12, 2.0, -0.16, -0.77];
const HALF_WIDTH: [f64; 7] = [1.92, 0.39, 0.31, 0.20, 0.30, 1.18, 0.57];

fn model_file(name: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("models").join(name)
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
    assert_eq!((robot.model.actuators, robot.model.statics, robot.target), (ActuatorMap::Direct, None, None));
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
        ("\"swing\"", "\"slide\"", "a second joint \"slide\"", 15, "own"),
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
        ("\"direct\"", "\"direct\"\noffset_deg = 0", "no loop", 26, "parallelogram"),
        ("\"direct\"", "\"parallelogram\"", "no shoulder", 24, "revolute"),
        ("\"direct\"", "\"parallelogram\"\nshoulder = \"hip\"", "no joint \"hip\"", 26, "slide, swing"),
        ("\"direct\"", "\"parallelogram\"\nshoulder = \"slide\"", "\"slide\" is prismatic", 26, "revolute"),
        (
            "\"direct\"",
            "\"parallelogram\"\nshoulder = \"swing\"\nelbow = \"swing\"\noffset_deg = 0",
            "one joint",
            27,
            "two",
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
        ("name = \"two\"", "name = \"two\"\nurdf = \"a.urdf\"", "\"a.urdf\" was not given", 4, "text"),
        ("convention", "convention = = ", "", 4, ""),
    ] {
        let (found, at, expected) = refusal(from, to);
        assert!(found.contains(message), "{to}: {found}");
        assert!(expected.contains(help), "{to}: {expected}");
        assert_eq!(at, line, "{to}: {found}");
    }
    let (found, ..) =
        refusal(&TWO_JOINTS[TWO_JOINTS.find("[[joint]]").unwrap()..TWO_JOINTS.find("[act").unwrap()], "");
    assert!(found.contains("there is no joint"), "{found}");
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
    let mut rng = stream(3, 0, Stream::AsBuilt);
    for _ in 0..50 {
        let q: Vec<f64> = (0..6).map(|_| rng.random_range(-3.0..3.0)).collect();
        let product = table.iter().zip(&q).fold(Transform::identity(), |product, ((d, a, alpha), q)| {
            let alpha: f64 = *alpha;
            product * rotation_z(*q) * translation(a / 1e3, 0.0, d / 1e3) * rotation_x(alpha.to_radians())
        });
        let found = forward_kinematics(&ur5.model.kinematics, &q);
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
    let stretched = forward_kinematics(&wam.model.kinematics, &[0.0; 7]).translation.vector;
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
    assert_eq!(
        robot.model.actuators,
        ActuatorMap::Parallelogram { shoulder: 2, elbow: 3, offset: 0.0, linkage: None }
    );
    assert_eq!(robot.target, Some(Vector3::new(0.10, 0.15, 0.20)));
    let statics = robot.model.statics.expect("masses, stiffnesses and gravity");
    let masses: Vec<f64> = statics.bodies.iter().map(|body| body.mass).collect();
    assert_eq!(masses, [800.0, 400.0, 250.0, 150.0, 80.0, 25.0, 15.0]);
    assert_eq!(statics.gravity, Vector3::new(0.0, -9.80665, 0.0));
    assert_eq!(robot.visuals.len(), 8);
    assert!(robot.visuals.iter().all(|shapes| !shapes.is_empty()));
}

#[test]
fn gravity_lowers_the_spray_painters_target_as_its_file_says() {
    let robot = spray_painter();
    let (chain, target) = (&robot.model.kinematics, robot.target.expect("stated"));
    let statics = robot.model.statics.as_ref().expect("stated");
    let deflection = joint_deflections(chain, statics, &CENTRE);
    let lowered_at = |q: &[f64], deflection: &[f64], joints: std::ops::Range<usize>| {
        let bent: Vec<f64> =
            (0..7).map(|i| q[i] + if joints.contains(&i) { deflection[i] } else { 0.0 }).collect();
        target_in_base(chain, q, &target).y - target_in_base(chain, &bent, &target).y
    };
    let lowered = |joints| lowered_at(&CENTRE, &deflection, joints);
    let (all, shoulder, elbow) = (lowered(0..7), lowered(2..3), lowered(3..4));
    eprintln!("droop {:.2} mm: shoulder {:.2} mm, elbow {:.2} mm", all * 1e3, shoulder * 1e3, elbow * 1e3);
    assert!((all - STATED_DROOP[0]).abs() < 5e-6, "{all}");
    assert!((shoulder - STATED_DROOP[1]).abs() < 5e-6, "{shoulder}");
    assert!((elbow - STATED_DROOP[2]).abs() < 5e-6, "{elbow}");
    let mut rng = stream(2, 0, Stream::AsBuilt);
    let poses = 500;
    let sum: f64 = (0..poses)
        .map(|_| {
            let q: Vec<f64> =
                (0..7).map(|i| CENTRE[i] + HALF_WIDTH[i] * rng.random_range(-1.0..1.0)).collect();
            lowered_at(&q, &joint_deflections(chain, statics, &q), 0..7)
        })
        .sum();
    let mean = sum / f64::from(poses);
    eprintln!("mean droop over the working region {:.2} mm", mean * 1e3);
    assert!((12e-3..18e-3).contains(&mean), "{mean}");
}

/// What robot.toml says of the droop, m: all drives, the shoulder's, the elbow's.
const STATED_DROOP: [f64; 3] = [14.95e-3, 4.58e-3, 10.33e-3];

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
