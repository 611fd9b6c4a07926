//! What a plant refuses: robots that make no machine, commands that it cannot reach, poses that do not hold.

use nalgebra::{Matrix3, Vector3};

use super::random_robot::four_bar;
use super::spray_robot::{full_robot, spray_robot};
use super::{AsBuilt, Plant, PlantError, SettleOptions, plant, soft_pendulum};
use calibrig_model::{ActuatorMap, LinkageStatics, PointLoad, Section, SegmentLength};

/// The section of the upper arm.
fn section(robot: &mut AsBuilt) -> &mut Section {
    &mut robot.statics.beams[2].as_mut().expect("a flexible upper arm").segments[0].section
}

fn linkage(robot: &mut AsBuilt) -> &mut LinkageStatics {
    robot.statics.linkage.as_mut().expect("a four-bar")
}

fn is_not_positive(error: &PlantError, expected: usize, of: &str) -> bool {
    matches!(error, PlantError::NotPositive { joint, field, value }
        if *joint == expected && *field == of && !(*value > 0.0))
}

#[test]
fn a_robot_that_makes_no_machine_is_refused() {
    are_refused(&[
        (|r| r.kinematics.links.clear(), |e| *e == PlantError::NoJoints),
        (
            |r| r.statics.bodies.truncate(6),
            |e| *e == PlantError::Length { quantity: "bodies", expected: 7, found: 6 },
        ),
        (
            |r| r.statics.drive_stiffness.push(1.0),
            |e| *e == PlantError::Length { quantity: "drive stiffnesses", expected: 7, found: 8 },
        ),
        (|r| r.kinematics.links[3].a = f64::NAN, |e| is_not_finite(e, "a", Some(3))),
        (|r| r.kinematics.links[0].alpha = f64::INFINITY, |e| is_not_finite(e, "alpha", Some(0))),
        (|r| r.kinematics.links[6].beta = f64::NAN, |e| is_not_finite(e, "beta", Some(6))),
        (|r| r.kinematics.links[1].d = f64::NEG_INFINITY, |e| is_not_finite(e, "d", Some(1))),
        (|r| r.kinematics.links[2].theta = f64::NAN, |e| is_not_finite(e, "theta", Some(2))),
        (
            |r| r.kinematics.last_from_flange.translation.x = f64::NAN,
            |e| is_not_finite(e, "last_from_flange", None),
        ),
        (|r| r.statics.bodies[4].mass = f64::NAN, |e| is_not_finite(e, "mass", Some(4))),
        (|r| r.statics.bodies[4].mass = -2.0, |e| *e == PlantError::Mass { joint: 4, mass: -2.0 }),
        (
            |r| r.statics.bodies[5].centre_of_mass.y = f64::NAN,
            |e| is_not_finite(e, "centre of mass", Some(5)),
        ),
        (|r| r.statics.bodies[5].inertia[(0, 2)] = f64::NAN, |e| is_not_finite(e, "inertia", Some(5))),
        (
            |r| r.statics.bodies[5].inertia[(0, 2)] = 0.01,
            |e| *e == PlantError::AsymmetricInertia { joint: 5, asymmetry: 0.01 },
        ),
        (
            |r| r.statics.bodies[5].inertia = Matrix3::from_diagonal(&Vector3::new(1.0, -0.5, 1.2)),
            |e| *e == PlantError::Inertia { joint: 5, principal: [-0.5, 1.0, 1.2] },
        ),
        (
            |r| r.statics.bodies[5].inertia = Matrix3::from_diagonal(&Vector3::new(1.0, 2.5, 1.2)),
            |e| *e == PlantError::Inertia { joint: 5, principal: [1.0, 1.2, 2.5] },
        ),
        (
            |r| r.statics.drive_stiffness[1] = 0.0,
            |e| *e == PlantError::Stiffness { joint: 1, stiffness: 0.0 },
        ),
        (
            |r| r.statics.drive_stiffness[1] = f64::NEG_INFINITY,
            |e| *e == PlantError::Stiffness { joint: 1, stiffness: f64::NEG_INFINITY },
        ),
        (
            |r| r.statics.drive_stiffness[1] = f64::NAN,
            |e| matches!(e, PlantError::Stiffness { joint: 1, stiffness } if stiffness.is_nan()),
        ),
        (|r| r.statics.gravity.z = f64::NAN, |e| is_not_finite(e, "gravity", None)),
        (|r| r.target.x = f64::INFINITY, |e| is_not_finite(e, "target", None)),
        (
            |r| {
                r.actuators = ActuatorMap::Parallelogram { shoulder: 2, elbow: 7, offset: 0.0, linkage: None }
            },
            |e| *e == PlantError::Transmission { shoulder: 2, elbow: 7, joints: 7 },
        ),
        (
            |r| {
                r.actuators =
                    ActuatorMap::Parallelogram { shoulder: 2, elbow: 3, offset: f64::NAN, linkage: None }
            },
            |e| is_not_finite(e, "parallelogram offset", None),
        ),
    ]);
}

#[test]
fn bearings_beams_loads_and_loops_that_make_no_machine_are_refused() {
    are_refused(&[
        (
            |r| r.statics.bearings.truncate(2),
            |e| *e == PlantError::Length { quantity: "bearings", expected: 7, found: 2 },
        ),
        (
            |r| r.statics.beams.clear(),
            |e| *e == PlantError::Length { quantity: "beams", expected: 7, found: 0 },
        ),
        (|r| r.statics.bearings[1].stiffness[3] = 0.0, |e| is_not_positive(e, 1, "a bearing stiffness")),
        (|r| r.statics.bearings[6].stiffness[0] = f64::NAN, |e| is_not_positive(e, 6, "a bearing stiffness")),
        (|r| r.statics.bearings[4].at = f64::NAN, |e| is_not_finite(e, "place of the bearing", Some(4))),
        (|r| section(r).axial = -1.0, |e| is_not_positive(e, 2, "the axial rigidity of a beam segment")),
        (|r| section(r).shear[1] = 0.0, |e| is_not_positive(e, 2, "a shear rigidity of a beam segment")),
        (|r| section(r).torsion = 0.0, |e| is_not_positive(e, 2, "the torsional rigidity of a beam segment")),
        (
            |r| section(r).bending[0] = f64::NAN,
            |e| is_not_positive(e, 2, "a bending rigidity of a beam segment"),
        ),
        (
            |r| section(r).mass_per_length = -1.0,
            |e| is_not_positive(e, 2, "the mass per length of a beam segment"),
        ),
        (|r| four_bar(r).crank.length = 0.0, |e| is_not_positive(e, 3, "the crank's length")),
        (|r| four_bar(r).rod = f64::INFINITY, |e| is_not_finite(e, "the rod's length", Some(3))),
        (|r| four_bar(r).lever.along = f64::NAN, |e| is_not_finite(e, "place of a four-bar's end", Some(3))),
        (|r| linkage(r).rod_stiffness = 0.0, |e| is_not_positive(e, 3, "the rod's stiffness")),
        (|r| linkage(r).rod_mass = -1.0, |e| *e == PlantError::Mass { joint: 3, mass: -1.0 }),
        (|r| r.statics.loads[1].link = 7, |e| *e == PlantError::Load { load: 1, link: 7, joints: 7 }),
        (|r| r.statics.loads[1].force.y = f64::INFINITY, |e| is_not_finite(e, "force of a load", Some(6))),
    ]);
}

/// What is done to a sound robot, and the refusal that is expected.
type Case = (fn(&mut AsBuilt), fn(&PlantError) -> bool);

fn are_refused(cases: &[Case]) {
    for (number, (spoil, is_expected)) in cases.iter().enumerate() {
        let mut robot = full_robot();
        spoil(&mut robot);
        let error = Plant::new(&robot, SettleOptions::default()).err().expect("a refusal");
        assert!(is_expected(&error), "case {number}: {error}");
    }
}

fn is_not_finite(error: &PlantError, expected: &str, of: Option<usize>) -> bool {
    matches!(error, PlantError::NotFinite { quantity, joint, value }
        if *quantity == expected && *joint == of && !value.is_finite())
}

#[test]
fn a_command_and_options_of_the_wrong_form_are_refused() {
    let robot = spray_robot();
    let mut arm = plant(&robot);
    assert_eq!(arm.settle(&[0.0; 6]), Err(PlantError::Length { quantity: "command", expected: 7, found: 6 }));
    let error = arm.settle(&[0.0, 0.0, f64::NAN, 0.0, 0.0, 0.0, 0.0]).expect_err("not a number");
    assert!(is_not_finite(&error, "command", Some(2)), "{error}");

    let sound = SettleOptions::default();
    for (option, options) in [
        ("dt", SettleOptions { dt: 0.0, ..sound }),
        ("dt", SettleOptions { dt: f64::INFINITY, ..sound }),
        ("max_steps", SettleOptions { max_steps: 0, ..sound }),
        ("tip_tolerance", SettleOptions { tip_tolerance: f64::NAN, ..sound }),
        ("residual_tolerance", SettleOptions { residual_tolerance: -1e-9, ..sound }),
    ] {
        let error = Plant::new(&robot, options).err().expect("a refusal");
        assert!(matches!(error, PlantError::Option { option: found, .. } if found == option), "{error}");
    }
}

const COMMAND: [f64; 7] = [2.0, 0.2, -1.6, -1.5, 2.0, -0.1, -0.7];

#[test]
fn displacements_of_the_wrong_form_are_refused() {
    let mut arm = plant(&spray_robot());
    let error = arm.settle_displaced(&COMMAND, &[[0.0; 6]; 3]).expect_err("three of seven");
    assert_eq!(error, PlantError::Length { quantity: "displacements", expected: 7, found: 3 });
    let mut shifts = [[0.0; 6]; 7];
    shifts[5][2] = f64::INFINITY;
    let error = arm.settle_displaced(&COMMAND, &shifts).expect_err("no such place");
    assert!(is_not_finite(&error, "displacement", Some(5)), "{error}");
}

#[test]
fn a_telescope_inside_its_housing_or_heavier_than_its_body_is_refused() {
    let mut robot = full_robot();
    let tube = &mut robot.statics.beams[4].as_mut().expect("a telescope").segments[0];
    tube.length = SegmentLength::Extension(1.9);
    let mut command = COMMAND;
    command[4] = 1.75;
    let error = plant(&robot).settle(&command).expect_err("inside");
    let PlantError::BeamLength { joint: 4, segment: 0, length } = error else { panic!("{error}") };
    assert!((length + 0.15).abs() < 1e-12);

    section(&mut robot).mass_per_length = 200.0;
    command[4] = 2.2;
    let error = plant(&robot).settle(&command).expect_err("too heavy");
    assert!(matches!(error, PlantError::HeavyBeam { joint: 2, body: 250.0, .. }), "{error}");
}

#[test]
fn a_four_bar_that_cannot_close_or_is_at_its_dead_point_is_refused_with_its_numbers() {
    let mut robot = full_robot();
    four_bar(&mut robot).rod = 2.3;
    let error = plant(&robot).settle(&COMMAND).expect_err("too long");
    let PlantError::OpenLoop { rod: 2.3, distances: [least, greatest] } = error else { panic!("{error}") };
    assert!(least < 1.35 && 1.35 < greatest && greatest < 2.3, "{error}");

    // The exact parallelogram: rod and lever at 90 degrees plus the elbow's joint variable.
    let robot = full_robot();
    let elbow_at = |degrees: f64| {
        let mut command = COMMAND;
        command[3] = command[2] + degrees.to_radians();
        plant(&robot).settle(&command)
    };
    let error = elbow_at(-82.0).expect_err("flat");
    let PlantError::Singular { angle } = error else { panic!("{error}") };
    assert!((angle.to_degrees() - 8.0).abs() < 1e-6, "{error}");
    elbow_at(-75.0).expect("15 degrees are enough");
}

#[test]
fn loads_that_overpower_the_springs_are_told_from_a_pose_that_does_not_settle() {
    // A strut of 1 m that is pushed towards its pivot: the tangent stiffness is that of the drive less the force.
    let mut robot = soft_pendulum();
    robot.statics.gravity = Vector3::zeros();
    robot.statics.loads = vec![PointLoad {
        name: "push".to_owned(),
        link: 0,
        at: Vector3::x(),
        mass: 0.0,
        force: Vector3::new(-40.0, 0.0, 0.0),
    }];
    let pose = plant(&robot).settle(&[0.0]).expect("the drive holds 40 N");
    assert!(pose.deflection[0].abs() < 1e-12);
    let bent = plant(&robot).settle(&[0.01]).expect("the drive holds 40 N");
    assert!(bent.deflection[0] > 0.03, "{:?}", bent.deflection);

    robot.statics.loads[0].force.x = -60.0;
    for command in [0.0, 1e-3] {
        let error = plant(&robot).settle(&[command]).expect_err("the drive gives way");
        let PlantError::Unstable { margin, .. } = error else { panic!("{error}") };
        assert!((margin + 0.2).abs() < 1e-3, "{error}");
    }
    let text = plant(&robot).settle(&[0.0]).expect_err("the drive gives way").to_string();
    assert!(text.starts_with("unstable equilibrium"), "{text}");

    // The same in a robot with a loop.
    let mut robot = full_robot();
    robot.statics.loads[1].force = Vector3::new(0.0, 0.0, 3e6);
    let error = [-1.0, 1.0].map(|sign| {
        let mut robot = robot.clone();
        robot.statics.loads[1].force *= sign;
        plant(&robot).settle(&COMMAND)
    });
    assert!(error.iter().any(|error| matches!(error, Err(PlantError::Unstable { .. }))), "{error:?}");
}
