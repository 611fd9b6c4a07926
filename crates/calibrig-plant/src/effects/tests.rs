//! All effects of a machine together, by hand.

use nalgebra::{Point3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::AsBuilt;
use calibrig_model::geometry::{Transform, rotation_z};
use calibrig_model::{
    ActuatorMap, Body, CraigLink, CrankAxis, FourBar, JointKind, KinematicModel, LinkageArm, StaticProperties,
};

const STIFFNESS: [f64; 3] = [2e7, 1e6, 5e5];

/// A rail, a shoulder and an elbow at 1.35 m, driven through a nearly exact parallelogram with a crank of 0.3 m.
fn machine() -> AsBuilt {
    let link = |name: &str, kind, a| CraigLink {
        name: name.to_owned(),
        kind,
        a,
        alpha: 0.01,
        beta: 0.0,
        d: 0.0,
        theta: 0.0,
        limits: [0.0, 4.0],
    };
    let arm = |length| LinkageArm { length, angle: 1.4, along: 0.1 };
    let body = Body { mass: 1.0, centre_of_mass: Vector3::zeros(), inertia: nalgebra::Matrix3::identity() };
    AsBuilt {
        kinematics: KinematicModel {
            links: vec![
                link("rail", JointKind::Prismatic, 0.0),
                link("shoulder", JointKind::Revolute, 0.25),
                link("elbow", JointKind::Revolute, 1.35),
            ],
            base_from_first: Transform::identity(),
            last_from_flange: Transform::identity(),
        },
        actuators: ActuatorMap::Parallelogram {
            shoulder: 1,
            elbow: 2,
            offset: 0.2,
            linkage: Some(FourBar {
                crank: arm(0.300),
                lever: arm(0.302),
                rod: 1.351,
                axis: CrankAxis::default(),
            }),
        },
        statics: StaticProperties::of_drives(vec![body; 3], STIFFNESS.to_vec(), Vector3::zeros()),
        target: Vector3::zeros(),
        effects: Effects::default(),
    }
}

fn all_effects() -> Effects {
    let harmonic = Harmonic { turns: 10.0, amplitude: [1e-4, 2e-5], phase: [0.3, 1.0] };
    let profile = RailProfile { polynomial: vec![0.0, 0.0, 1e-4], wave: 2e-5, phase: 0.5 };
    let part = GrowingPart::Link { joint: 0, axis: 2 };
    Effects {
        harmonics: Some(Harmonics { actuators: vec![None, Some(harmonic), None] }),
        ratio: Some(Ratio { relative: vec![40e-6, -20e-6, 0.0] }),
        rail: Some(Rail {
            joint: 0,
            range: [0.0, 4.0],
            wavelength: 0.7,
            vertical: Vector3::y(),
            horizontal_error: profile.clone(),
            vertical_error: profile.clone(),
            roll: profile.clone(),
            pitch: profile.clone(),
            yaw: profile,
        }),
        backlash: Some(Backlash { gap: vec![0.0, 2e-4, 1e-4] }),
        transmission: Some(Transmission { actuators: vec![Vec::new(), vec![WAVE], Vec::new()] }),
        lost_motion: Some(LostMotion {
            gap: vec![0.0, 6e-5, 0.0],
            friction: vec![0.0, 5.0, 0.0],
            closes_at: vec![0.0, 10.0, 0.0],
        }),
        stiffening: Some(Stiffening { actuators: vec![None, Some(curve()), None] }),
        friction: Some(Friction {
            constant: vec![0.0, 100.0, 50.0],
            per_load: vec![0.0, 0.02, 0.0],
            presliding: vec![0.0, 0.05, 0.05],
        }),
        encoder: Some(Encoder { step: vec![1e-6, 2e-6, 0.0], offset: vec![1e-5, 0.0, 0.0] }),
        thermal: Some(Thermal {
            ambient: Ambient { start: 25.0, drift: 1e-4, swing: 0.0, period: 1.0, phase: 0.0 },
            reference: 20.0,
            growths: vec![Growth {
                part,
                length: 1.0,
                with_travel: true,
                expansion: 12e-6,
                lag: 0.0,
                heat: None,
            }],
        }),
        repeatability: Some(Repeatability { sigma: vec![1e-5, 1e-5, 1e-5] }),
        foundation: Some(Foundation {
            at: Vector3::zeros(),
            stiffness: [1e8; 6],
            rail: Some(RailSpan { joint: 0, first_foot: 0.0, span: 1.0, compliance: [0.0, 1e-9] }),
        }),
        hoses: Some(Hoses {
            hoses: vec![Hose {
                ends: [
                    Anchor { link: None, at: Vector3::zeros() },
                    Anchor { link: Some(2), at: Vector3::x() },
                ],
                stiffness: 100.0,
                free_length: 0.5,
            }],
        }),
    }
}

const WAVE: TransmissionWave = TransmissionWave { cycles: 6.5, amplitude: 3e-5, per_load: 1e-8, phase: 0.2 };

/// Twice as soft as the drive up to 1000 N m.
fn curve() -> StiffnessCurve {
    StiffnessCurve { factors: vec![0.5, 1.0], limits: vec![1000.0] }
}

fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

fn approached(robot: &AsBuilt, from: &[f64], command: &[f64], load: &[f64]) -> PoseEffects {
    let pose = Commanded { command, time: 100.0, load };
    robot.pose_effects(&robot.referenced_at(from), &pose, &mut rng(1)).0
}

#[test]
fn a_machine_without_effects_does_as_it_is_told_to_the_bit() {
    let command = [1.234_567, -0.7, 0.3];
    let effects = approached(&machine(), &[0.0; 3], &command, &[]);
    assert_eq!(effects.command, command);
    assert_eq!(effects.displacements, [[0.0; 6]; 3]);
    assert_eq!(effects.temperature, None);
}

#[test]
fn the_effects_add_up_in_the_order_of_the_drive_train() {
    let mut robot = machine();
    robot.effects = all_effects().without(EffectKind::Repeatability);
    let effects = approached(&robot, &[2.0, 0.5, 0.0], &[1.0, -0.700_001_4, 0.3], &[0.0, -3000.0, 0.0]);
    // The motor stands on the encoder's step of 2 urad, the joint at ratio, waves, half a gap, the flank that the load of -3000 N m bears on, and
    // 160 N m / 1e6 N m/rad behind; it came from above and is off upwards.
    let motor: f64 = -0.700_002;
    let turned = std::f64::consts::TAU * 10.0 * motor;
    let harmonics = 1e-4 * (turned + 0.3).sin() + 2e-5 * (2.0 * turned + 1.0).sin();
    let share = 1.0 - (-1.200_002_f64 / 0.05).exp();
    let meshing = (3e-5 + 1e-8 * 3000.0) * (std::f64::consts::TAU * 6.5 * motor + 0.2).sin();
    let expected = motor * (1.0 - 20e-6) + harmonics + meshing + 1e-4 - 3e-5 + share * 160e-6;
    assert!((effects.command[1] - expected).abs() < 1e-14, "{} against {expected}", effects.command[1]);
    // The rail has no friction: 1 m on a step of 1 um, offset 10 um, 40 ppm.
    let rail = (1.0 + 1e-5) * (1.0 + 40e-6);
    assert!((effects.command[0] - rail).abs() < 1e-14);
    // It bends there by 1e-4 x² and waves; along it, (1 m + 1 m) grow by 12 ppm/K in 5.01 K.
    let x = rail / 2.0 - 1.0;
    let error = 1e-4 * x * x + 2e-5 * (std::f64::consts::TAU * rail / 0.7 + 0.5).sin();
    let grown = 12e-6 * 5.01 * (1.0 + rail);
    for (found, expected) in
        effects.displacements[0].into_iter().zip([error, error, grown, error, error, error])
    {
        assert!((found - expected).abs() < 1e-16, "{found} against {expected}");
    }
    assert_eq!(effects.displacements[1..], [[0.0; 6]; 2]);
    assert!((effects.temperature.expect("a sensor") - 25.01).abs() < 1e-13);
}

#[test]
fn a_pose_depends_on_its_inputs_alone() {
    let mut robot = machine();
    robot.effects = all_effects();
    let mut poses = rng(5);
    let commands: Vec<[f64; 3]> = (0..20)
        .map(|_| [poses.random_range(0.0..4.0), poses.random_range(-1.0..1.0), poses.random_range(-1.0..1.0)])
        .collect();
    let visit = |robot: &AsBuilt, order: &mut dyn Iterator<Item = usize>| {
        let mut state = robot.referenced_at(&[2.0, 0.0, 0.0]);
        let mut found = vec![None; commands.len()];
        for index in order {
            let pose = Commanded { command: &commands[index], time: index as f64, load: &[0.0, 1e3, 0.0] };
            let (effects, next) = robot.pose_effects(&state, &pose, &mut rng(index as u64));
            found[index] = Some(effects);
            state = next;
        }
        found
    };
    assert_eq!(visit(&robot, &mut (0..20)), visit(&robot, &mut (0..20)));
    // The way there counts for backlash and friction, and for nothing else.
    assert_ne!(visit(&robot, &mut (0..20)), visit(&robot, &mut (0..20).rev()));
    robot.effects = robot.effects.without(EffectKind::Backlash).without(EffectKind::Friction);
    // The load of 1000 N m decides the flank, whichever the way.
    assert!(robot.effects.lost_motion.is_some());
    assert_eq!(visit(&robot, &mut (0..20)), visit(&robot, &mut (0..20).rev()));
}

#[test]
fn hysteresis_is_no_multiple_of_the_approachs_sign() {
    // Friction alone: offsets after motions of one direction differ by the size of the motion and by the load.
    let mut robot = machine();
    robot.effects.friction = all_effects().friction;
    let behind = |from: f64, load: f64| {
        let command = [0.0, 0.5, 0.0];
        command[1] - approached(&robot, &[0.0, from, 0.0], &command, &[0.0, load, 0.0]).command[1]
    };
    let (short, long, loaded) = (behind(0.47, 0.0), behind(-0.5, 0.0), behind(-0.5, 5000.0));
    assert!((short - (1.0 - (-0.6_f64).exp()) * 1e-4).abs() < 1e-15);
    assert!((long - 1e-4).abs() < 1e-12 && (loaded - 2e-4).abs() < 1e-12);
}

/// 100 N m of friction, by the stiffness that the drive has under its load.
#[test]
fn friction_bends_a_drive_that_stiffens_by_its_range() {
    let mut robot = machine();
    let friction =
        Friction { per_load: vec![0.0; 3], presliding: vec![0.0; 3], ..all_effects().friction.unwrap() };
    robot.effects.friction = Some(friction);
    robot.effects.stiffening = all_effects().stiffening;
    let command = [0.0, 0.5, 0.0];
    for (load, behind) in
        [(0.0, 2e-4), (500.0, 2e-4), (5000.0, 1e-4), (1050.0, 5e-5 + 1e-4), (-950.0, 1e-4 + 5e-5)]
    {
        let found = command[1] - approached(&robot, &[0.0; 3], &command, &[0.0, load, 0.0]).command[1];
        assert!((found - behind).abs() < 1e-15, "{load}: {found}");
    }
}

#[test]
fn a_pose_remembers_the_heat_of_the_motions_before() {
    let mut robot = machine();
    let part = GrowingPart::Link { joint: 1, axis: 0 };
    let ambient = Ambient { start: 20.0, drift: 0.0, swing: 0.0, period: 1.0, phase: 0.0 };
    let heat = Some(DriveHeat { actuator: 0, power: 0.0, per_motion: 600.0, resistance: 0.5 });
    let growth = Growth { part, length: 2.0, with_travel: false, expansion: 10e-6, lag: 100.0, heat };
    robot.effects.thermal = Some(Thermal { ambient, reference: 20.0, growths: vec![growth] });
    let grown = |order: [f64; 3]| {
        let mut state = robot.referenced_at(&[0.0; 3]);
        let mut last = 0.0;
        for (rail, time) in order.into_iter().zip([100.0, 200.0, 300.0]) {
            let pose = Commanded { command: &[rail, 0.0, 0.0], time, load: &[] };
            let (effects, next) = robot.pose_effects(&state, &pose, &mut rng(1));
            (state, last) = (next, effects.displacements[1][0]);
        }
        last
    };
    // A metre warms by 3 K, spread over 100 s, and 1/e of it is there 100 s later: (1 - 1/e) exp(-k).
    let e = (-1.0_f64).exp();
    let expected =
        |metres: [f64; 3]| 20e-6 * 3.0 * (1.0 - e) * (metres[0] * e * e + metres[1] * e + metres[2]);
    assert!((grown([1.0, 1.0, 4.0]) - expected([1.0, 0.0, 3.0])).abs() < 1e-17);
    assert!((grown([4.0, 1.0, 1.0]) - expected([4.0, 3.0, 0.0])).abs() < 1e-17);
}

/// A bound on the load of a drive: by hand for the rail, the shoulder and the elbow of three bodies of a kilogram.
#[test]
fn no_drive_is_loaded_more_than_all_that_it_carries_can() {
    let mut robot = machine();
    robot.actuators = ActuatorMap::Direct;
    robot.statics.gravity = Vector3::new(0.0, -10.0, 0.0);
    let gap = |actuator: usize, closes_at: f64| {
        let mut values = [vec![0.0; 3], vec![0.0; 3]];
        (values[0][actuator], values[1][actuator]) = (1e-4, closes_at);
        let [gap, closes_at] = values;
        Effects {
            lost_motion: Some(LostMotion { gap, friction: vec![0.0; 3], closes_at }),
            ..Effects::default()
        }
    };
    // The rail leans by alpha = 0.01; the shoulder's axis by twice that, whose bodies are 0 and 1.35 m away; the elbow's own body is on its axis.
    let greatest = [30.0 * 0.01_f64.sin(), 20.0 * 0.02_f64.cos() * 0.0 + 10.0 * 0.02_f64.cos() * 1.35, 0.0];
    for (actuator, greatest) in greatest.into_iter().enumerate() {
        robot.effects = gap(actuator, greatest + 1e-9);
        let error = robot.check_effects(1.0).expect_err("no such load");
        assert!(matches!(error, EffectError::NeverCloses { actuator: a, .. } if a == actuator), "{error}");
        if greatest > 0.0 {
            robot.effects = gap(actuator, greatest - 1e-9);
            assert_eq!(robot.check_effects(1.0), Ok(()));
        }
    }
}

#[test]
fn a_rod_that_grows_turns_the_crank_by_what_the_closure_needs() {
    let mut robot = machine();
    let Some((_, _, offset, linkage)) = robot.actuators.four_bar() else { panic!("a four-bar") };
    let linkage = *linkage;
    let ambient = Ambient { start: 30.0, drift: 0.0, swing: 0.0, period: 1.0, phase: 0.0 };
    let part = GrowingPart::Rod;
    let rod = Growth { part, length: 0.0, with_travel: false, expansion: 12e-6, lag: 0.0, heat: None };
    robot.effects.thermal = Some(Thermal { ambient, reference: 20.0, growths: vec![rod] });
    for command in [[0.0, -1.5, -1.4], [0.0, -1.2, -1.5], [0.0, -1.7, -1.2]] {
        let turned = approached(&robot, &command, &command, &[]).command[2];
        // Distance between crank and lever at the elbow of the exact parallelogram.
        let q_elbow = command[2] + offset - command[1];
        let lever = rotation_z(command[1])
            * robot.kinematics.links[2].fixed_part()
            * rotation_z(q_elbow)
            * Point3::from(linkage.lever.end());
        let zero = offset + robot.kinematics.links[2].theta;
        let span = |psi: f64| (rotation_z(psi + zero) * Point3::from(linkage.crank.end()) - lever).norm();
        let growth = 12e-6 * 10.0 * 1.351;
        let nearer = span(command[2]) - span(turned);
        assert!((nearer / growth - 1.0).abs() < 1e-3, "{nearer} against {growth}");
    }
}

#[test]
fn effects_are_taken_away_one_at_a_time() {
    let all = all_effects();
    assert_eq!(all.active(), EffectKind::ALL);
    assert!(Effects::default().active().is_empty());
    for kind in EffectKind::ALL {
        let rest = all.without(kind);
        let kept: Vec<_> = EffectKind::ALL.into_iter().filter(|k| *k != kind).collect();
        assert_eq!(rest.active(), kept);
        assert_eq!(rest.without(kind), rest);
    }
}

#[test]
fn effects_that_no_machine_has_are_refused() {
    type Break = fn(&mut Effects);
    let breaks: [(Break, EffectKind); 16] = [
        (|e| e.backlash.as_mut().unwrap().gap[1] = -1e-6, EffectKind::Backlash),
        (|e| e.backlash.as_mut().unwrap().gap.truncate(2), EffectKind::Backlash),
        (|e| e.ratio.as_mut().unwrap().relative[0] = f64::NAN, EffectKind::Ratio),
        (|e| e.transmission.as_mut().unwrap().actuators[1][0].cycles = 0.0, EffectKind::Transmission),
        (|e| e.lost_motion.as_mut().unwrap().closes_at[1] = 4.0, EffectKind::LostMotion),
        (
            |e| e.stiffening.as_mut().unwrap().actuators[1].as_mut().unwrap().limits[0] = -1.0,
            EffectKind::Stiffening,
        ),
        (|e| e.harmonics.as_mut().unwrap().actuators[1].as_mut().unwrap().turns = 0.0, EffectKind::Harmonics),
        (|e| e.friction.as_mut().unwrap().presliding[1] = f64::INFINITY, EffectKind::Friction),
        (|e| e.encoder.as_mut().unwrap().step[0] = -1.0, EffectKind::Encoder),
        (|e| e.rail.as_mut().unwrap().wavelength = 0.0, EffectKind::Rail),
        (|e| e.rail.as_mut().unwrap().vertical.z = 0.1, EffectKind::Rail),
        (
            |e| e.thermal.as_mut().unwrap().growths[0].part = GrowingPart::Link { joint: 3, axis: 0 },
            EffectKind::Thermal,
        ),
        (|e| e.repeatability.as_mut().unwrap().sigma[2] = -1e-9, EffectKind::Repeatability),
        (|e| e.foundation.as_mut().unwrap().stiffness[1] = 0.0, EffectKind::Foundation),
        (|e| e.foundation.as_mut().unwrap().rail.as_mut().unwrap().span = f64::NAN, EffectKind::Foundation),
        (|e| e.hoses.as_mut().unwrap().hoses[0].free_length = 0.0, EffectKind::Hoses),
    ];
    let mut robot = machine();
    robot.statics.gravity = Vector3::new(0.0, -10.0, 0.0);
    robot.effects = all_effects();
    assert_eq!(robot.check_effects(1000.0), Ok(()));
    for (number, (spoil, kind)) in breaks.into_iter().enumerate() {
        robot.effects = all_effects();
        spoil(&mut robot.effects);
        match robot.check_effects(1000.0) {
            Err(
                EffectError::Length { effect, .. }
                | EffectError::Value { effect, .. }
                | EffectError::NoSuchPart { effect, .. },
            ) => assert_eq!(effect, kind, "{number}"),
            other => panic!("{number}: {other:?}"),
        }
    }
    robot.effects = all_effects();
    assert!(matches!(robot.check_effects(1e6), Err(EffectError::Temperature { .. })));
    robot.actuators = ActuatorMap::Direct;
    robot.effects.thermal.as_mut().unwrap().growths[0].part = GrowingPart::Rod;
    assert!(matches!(robot.check_effects(1.0), Err(EffectError::NoSuchPart { .. })));
}
