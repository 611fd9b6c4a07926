//! The whole robot: six-axis bearings, beams, loads and the closed loop.

use nalgebra::{DVector, Matrix4, Point3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::constrained::Constrained;
use super::random_robot::{random_full_robot, random_shifts};
use super::spray_robot::{full_robot, working_command};
use super::{AsBuilt, ElasticPlace, PlantError, bits, plant};
use crate::confirmation::AtRest;
use crate::effects::{Anchor, Foundation, Hose, Hoses, RailSpan, Stiffening, StiffnessCurve};
use crate::statics::Statics;
use crate::{Plant, SettleOptions};
use calibrig_model::{Payload, PointLoad};

/// A robot with all that the statics of a machine can have: on a floor and a rail that yield, with hoses that pull.
fn random_machine(rng: &mut ChaCha8Rng) -> AsBuilt {
    let mut robot = random_full_robot(rng);
    let mut within = |low: f64, high: f64| rng.random_range(low..high);
    let mut stiffness = [2e8, 2e8, 3e8, 3e8, 4e8, 2e8].map(|k| k * within(0.5, 2.0));
    if within(0.0, 1.0) < 0.3 {
        stiffness[3] = f64::INFINITY;
    }
    let mut vector = |by: f64| Vector3::from([(); 3].map(|()| within(-by, by)));
    let at = vector(1.0);
    let anchor = |link: Option<usize>, at: Vector3<f64>| Anchor { link, at };
    let ends = [
        [anchor(Some(1), vector(0.4)), anchor(Some(3), vector(0.4))],
        [anchor(None, vector(2.0)), anchor(Some(6), vector(0.2))],
        [anchor(Some(6), vector(0.1)), anchor(Some(4), vector(0.3))],
    ];
    let hoses =
        ends.map(|ends| Hose { ends, stiffness: within(200.0, 2000.0), free_length: within(0.05, 1.0) });
    robot.effects.hoses = Some(Hoses { hoses: hoses.to_vec() });
    let rail = RailSpan {
        joint: 0,
        first_foot: within(-1.0, 0.0),
        span: within(0.8, 1.6),
        compliance: [within(1e-9, 1e-8), within(1e-9, 1e-8)],
    };
    robot.effects.foundation = Some(Foundation { at, stiffness, rail: Some(rail) });
    robot
}

#[test]
fn the_derivatives_of_the_constrained_reference_are_those_of_its_energy() {
    let mut rng = ChaCha8Rng::seed_from_u64(30);
    let robot = random_machine(&mut rng);
    let command = working_command(&robot, &mut rng);
    let reference = Constrained::new(&robot, &command, &[]);
    let mut q = reference.unloaded();
    q.iter_mut().for_each(|q| *q += rng.random_range(-0.01..0.01));
    let ((_, gradient, hessian), gap) = reference.energy_and_gap(&q);
    let (_, slope, curvature) = gap.expect("a loop");
    let h = 1e-6;
    for i in 0..reference.unknowns() {
        let mut side = [q.clone(), q.clone()];
        side[0][i] += h;
        side[1][i] -= h;
        let [(up, up_gap), (down, down_gap)] = side.map(|q| reference.energy_and_gap(&q));
        let (up_gap, down_gap) = (up_gap.expect("a loop"), down_gap.expect("a loop"));
        let near = |a: f64, b: f64, scale: f64| assert!((a - b).abs() <= 1e-6 * scale, "{i}: {a} {b}");
        near((up.0 - down.0) / (2.0 * h), gradient[i], gradient.amax());
        near((up_gap.0 - down_gap.0) / (2.0 * h), slope[i], 1.0);
        let columns =
            [((up.1 - down.1) / (2.0 * h), &hessian), ((up_gap.1 - down_gap.1) / (2.0 * h), &curvature)];
        for (difference, exact) in columns {
            let exact: DVector<f64> = exact.column(i).into_owned();
            assert!((&difference - &exact).amax() <= 1e-6 * exact.amax().max(1.0), "column {i}");
        }
    }
}

#[test]
fn the_whole_robot_rests_where_an_independent_solution_does() {
    let mut rng = ChaCha8Rng::seed_from_u64(31);
    let (mut tip, mut frame, mut closure, mut force, mut steps) = (0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64, 0);
    let mut droop = 0.0;
    for case in 0..200 {
        // One in four has no floor and no hoses.
        let robot = if case % 4 == 3 { random_full_robot(&mut rng) } else { random_machine(&mut rng) };
        let command = working_command(&robot, &mut rng);
        let shifts = if case % 2 == 0 { Vec::new() } else { random_shifts(&mut rng) };
        let pose = plant(&robot).settle_displaced(&command, &shifts).expect("a stiff robot");
        let reference = Constrained::new(&robot, &command, &shifts);
        let (q, rod_force) = reference.solve();
        tip = tip.max((pose.target - reference.target(&q)).norm());
        for (link, expected) in pose.links.iter().zip(reference.link_frames(&q)) {
            frame = frame.max((link.to_homogeneous() - expected).amax());
        }
        closure = closure.max(pose.closure);
        let (found, expected) = (pose.rod_force.expect("a rod"), rod_force.expect("a rod"));
        force = force.max((found - expected).abs() / expected.abs().max(100.0));
        steps = steps.max(pose.steps);
        droop += (reference.target(&q) - reference.target(&reference.unloaded())).norm() / 200.0;
    }
    eprintln!(
        "tip: at most {tip:e} m off, frames {frame:e}, rod force {force:e}, closure {closure:e} m, {steps} steps; droop {droop:.4} m"
    );
    assert!(
        tip <= 1e-9 && frame <= 1e-9 && closure <= 1e-9 && force <= 1e-7,
        "{tip:e} {frame:e} {closure:e} {force:e}"
    );
    assert!(droop > 0.003, "{droop}");
}

/// Ranges about the loads that the drives really have, so that every range is met.
fn stiffened(robot: &AsBuilt, rng: &mut ChaCha8Rng) -> AsBuilt {
    let command = working_command(robot, rng);
    let settled = plant(robot).settle(&command).expect("a stiff robot");
    let loads = robot.drive_loads(&settled);
    let mut curve = |load: f64| StiffnessCurve {
        factors: vec![rng.random_range(0.3..0.8), rng.random_range(0.8..1.2), rng.random_range(1.2..2.5)],
        limits: vec![
            load.abs() * rng.random_range(0.1..0.9) + 0.1,
            load.abs() * rng.random_range(0.9..1.5) + 0.2,
        ],
    };
    let mut robot = robot.clone();
    let actuators = loads.iter().map(|load| Some(curve(*load))).collect();
    robot.effects.stiffening = Some(Stiffening { actuators });
    robot
}

#[test]
fn drives_that_stiffen_rest_where_an_independent_solution_does() {
    let mut rng = ChaCha8Rng::seed_from_u64(35);
    let (mut tip, mut steps, mut moved) = (0.0_f64, 0, 0.0_f64);
    let mut ranges = [0_u32; 3];
    for case in 0..100 {
        let linear = random_full_robot(&mut rng);
        let robot = stiffened(&linear, &mut rng);
        let shifts = if case % 2 == 0 { Vec::new() } else { random_shifts(&mut rng) };
        let mut own = plant(&robot);
        for _ in 0..2 {
            let command = working_command(&robot, &mut rng);
            let pose = own.settle_displaced(&command, &shifts).expect("a stiff robot");
            let reference = Constrained::new(&robot, &command, &shifts);
            let (q, _) = reference.solve();
            tip = tip.max((pose.target - reference.target(&q)).norm());
            steps = steps.max(pose.steps);
            assert_eq!(bits(&plant(&robot).settle_displaced(&command, &shifts).expect("again")), bits(&pose));
            let straight = plant(&linear).settle_displaced(&command, &shifts).expect("a stiff robot");
            moved = moved.max((straight.target - pose.target).norm());
            let curves = &robot.effects.stiffening.as_ref().expect("it stiffens").actuators;
            for (load, curve) in robot.drive_loads(&pose).iter().zip(curves.iter().flatten()) {
                ranges[curve.limits.iter().filter(|limit| load.abs() > **limit).count()] += 1;
            }
        }
    }
    eprintln!("tip: at most {tip:e} m off, {steps} steps; up to {moved:e} m from linear; ranges {ranges:?}");
    assert!(tip <= 1e-9, "{tip:e}");
    assert!(moved > 1e-3 && ranges.iter().all(|count| *count > 50), "{moved} {ranges:?}");
}

/// A linear drive of the secant at a pose's own load holds that pose.
#[test]
fn the_secant_stiffness_holds_the_pose_that_it_is_of() {
    let mut rng = ChaCha8Rng::seed_from_u64(36);
    let robot = stiffened(&random_full_robot(&mut rng), &mut rng);
    let command = working_command(&robot, &mut rng);
    let pose = plant(&robot).settle(&command).expect("a stiff robot");
    let mut linear = robot.clone();
    linear.effects.stiffening = None;
    for (joint, stiffness) in linear.statics.drive_stiffness.iter_mut().enumerate() {
        *stiffness = robot.secant_stiffness(joint, std::slice::from_ref(&pose)).expect("a load");
    }
    let same = plant(&linear).settle(&command).expect("a stiff robot");
    assert!((same.target - pose.target).norm() < 1e-10, "{:e}", (same.target - pose.target).norm());
    assert_eq!(robot.secant_stiffness(2, &[]), None, "no pose tells the load");
    assert_eq!(linear.secant_stiffness(2, &[]), Some(linear.statics.drive_stiffness[2]));
}

#[test]
fn without_compliance_the_whole_robot_is_the_craig_product_with_the_closed_form_of_the_loop() {
    let mut rng = ChaCha8Rng::seed_from_u64(32);
    let mut largest: f64 = 0.0;
    for _ in 0..100 {
        let mut robot = random_full_robot(&mut rng);
        robot.statics.make_rigid();
        let command = working_command(&robot, &mut rng);
        let pose = plant(&robot).settle(&command).expect("it cannot move");
        let reference = Constrained::new(&robot, &command, &[]);
        assert_eq!(reference.unknowns(), 1);
        for (link, expected) in pose.links.iter().zip(reference.link_frames(&reference.unloaded())) {
            let difference: Matrix4<f64> = link.to_homogeneous() - expected;
            largest = largest.max(difference.amax());
        }
        assert!(pose.closure <= 1e-9);
        assert!(pose.deflection.iter().all(|deflection| *deflection == 0.0) && pose.elastic.is_empty());
    }
    eprintln!("largest difference of a frame: {largest:e}");
    assert!(largest <= 1e-9, "{largest:e}");
}

#[test]
fn rapier_alone_finds_the_same_rest() {
    let mut rng = ChaCha8Rng::seed_from_u64(33);
    let (mut largest, mut steps) = (0.0_f64, 0);
    for _ in 0..20 {
        let robot = random_machine(&mut rng);
        let command = working_command(&robot, &mut rng);
        let mut unaided = plant(&robot);
        unaided.newton_steps = 0;
        let pose = unaided.settle(&command).expect("a stiff robot");
        let expected = plant(&robot).settle(&command).expect("a stiff robot");
        largest = largest.max((pose.target - expected.target).norm());
        steps = steps.max(pose.steps);
        assert!(pose.steps > 2, "the droop takes more than one step");
    }
    eprintln!("at most {largest:e} m apart, {steps} steps");
    assert!(largest < 1e-9, "{largest:e}");
}

#[test]
fn a_step_that_confirms_a_pose_changes_no_bit_of_it() {
    let mut rng = ChaCha8Rng::seed_from_u64(37);
    for _ in 0..20 {
        let robot = random_machine(&mut rng);
        let command = working_command(&robot, &mut rng);
        let confirmed = plant(&robot).settle(&command).expect("a stiff robot");
        let options = SettleOptions { confirm: false, ..SettleOptions::default() };
        let mut quick = Plant::new(&robot, options).expect("a sound robot");
        let mut pose = quick.settle(&command).expect("a stiff robot");
        assert_eq!((confirmed.steps, pose.steps), (1, 0));
        pose.steps = 1;
        assert_eq!(bits(&pose), bits(&confirmed));
    }
}

#[test]
fn the_parts_step_where_the_whole_robot_does() {
    let mut rng = ChaCha8Rng::seed_from_u64(40);
    let (mut apart, mut of_bound) = (0.0_f64, 0.0_f64);
    for _ in 0..5 {
        let robot = stiffened(&random_machine(&mut rng), &mut rng);
        let command = working_command(&robot, &mut rng);
        let mut machine = plant(&robot);
        machine.settle_displaced(&command, &random_shifts(&mut rng)).expect("a stiff robot");
        let at_rest = machine.coordinates.clone();
        for off in 0..at_rest.len() {
            let mut coordinates = at_rest.clone();
            coordinates[off] += 1e-5;
            machine.chain.place(&coordinates);
            machine.evaluate();
            let springs = machine.springs();
            let closure = machine.statics.closure().expect("a loop");
            // Where the loop is open, the rod pulls at two places, which in the whole robot is a moment on what carries the loop.
            let moment = closure.reaction.norm() * closure.gap().norm();
            let Plant { tree, chain, statics, confirmation: Some(confirmation), .. } = &mut machine else {
                panic!("it confirms its poses in parts")
            };
            let pose = AtRest { tree, chain, statics, coordinates: &coordinates, springs: &springs };
            let parts = confirmation.step(&pose);
            let (_, own) = tree.coordinates().nth(off).expect("a coordinate");
            machine.step();
            for (coordinate, part) in parts.iter().enumerate() {
                let stiffness = springs[coordinate].0;
                let bound = 1e-9 + if stiffness > 0.0 { 1.1 * moment / stiffness } else { 0.0 };
                let difference = (part - machine.chain.coordinate(coordinate)).abs();
                apart = apart.max(difference);
                of_bound = of_bound.max(difference / bound);
            }
            // One that is off its rest is seen.
            let back = (coordinates[off] - parts[off]) / 1e-5;
            assert!(own.stiffness.is_infinite() || back > 0.5, "coordinate {off} comes back by {back}");
        }
    }
    eprintln!("parts and whole at most {apart:e} apart, {of_bound} of the bound");
    assert!(of_bound < 1.0, "{apart:e}, {of_bound}");
}

#[test]
fn a_pose_that_rapier_does_not_hold_is_refused() {
    let mut rng = ChaCha8Rng::seed_from_u64(41);
    let robot = random_machine(&mut rng);
    let command = working_command(&robot, &mut rng);
    let mut machine = plant(&robot);
    let sound = machine.settle(&command).expect("a stiff robot");
    // Newton's method believes in a gravity that is not that of rapier.
    let mut mistaken = robot.clone();
    mistaken.statics.gravity *= 1.0 + 1e-6;
    machine.statics = Statics::new(&machine.tree, &mistaken);
    match machine.settle(&command) {
        Err(PlantError::NotSettled { .. }) => {}
        other => panic!("{other:?}"),
    }
    machine.statics = Statics::new(&machine.tree, &robot);
    assert_eq!(bits(&machine.settle(&command).expect("a stiff robot")), bits(&sound));
}

#[test]
fn floor_rail_and_hoses_move_the_target() {
    let mut rng = ChaCha8Rng::seed_from_u64(38);
    let mut robot = random_machine(&mut rng);
    let command = working_command(&robot, &mut rng);
    let place = |robot: &AsBuilt| plant(robot).settle(&command).expect("a stiff robot").target;
    let whole = place(&robot);
    let without = |change: fn(&mut AsBuilt)| {
        let mut other = robot.clone();
        change(&mut other);
        (place(&other) - whole).norm()
    };
    let moved = [
        without(|robot| robot.effects.foundation = None),
        without(|robot| {
            if let Some(foundation) = &mut robot.effects.foundation {
                foundation.rail = None;
            }
        }),
        without(|robot| robot.effects.hoses = None),
    ];
    assert!(moved.iter().all(|by| *by > 1e-6), "{moved:?}");
    // A hose that hangs slack pulls nothing.
    let slack = |robot: &mut AsBuilt| {
        robot.effects.hoses.iter_mut().flat_map(|h| &mut h.hoses).for_each(|h| h.free_length = 50.0);
    };
    slack(&mut robot);
    let hanging = place(&robot);
    robot.effects.hoses = None;
    assert_eq!(hanging, place(&robot));
}

#[test]
fn a_pose_of_the_whole_robot_depends_on_no_bit_of_the_poses_before() {
    let mut rng = ChaCha8Rng::seed_from_u64(34);
    let robot = random_machine(&mut rng);
    let cases: Vec<_> = (0..40)
        .map(|case| {
            let command = working_command(&robot, &mut rng);
            (command, if case % 3 == 0 { random_shifts(&mut rng) } else { Vec::new() })
        })
        .collect();
    let mut in_order = plant(&robot);
    let mut settle = |(command, shifts): &(Vec<f64>, Vec<[f64; 6]>)| {
        bits(&in_order.settle_displaced(command, shifts).expect("a stiff robot"))
    };
    let poses: Vec<_> = cases.iter().map(&mut settle).collect();
    let mut again = plant(&robot);
    for (count, (command, shifts)) in cases.iter().enumerate().rev() {
        if count % 7 == 0 {
            again.settle(&[1e308; 7]).expect_err("no such place");
        }
        let pose = again.settle_displaced(command, shifts).expect("a stiff robot");
        assert_eq!(bits(&pose), poses[count], "pose {count}");
        let fresh = plant(&robot).settle_displaced(command, shifts).expect("a stiff robot");
        assert_eq!(bits(&fresh), poses[count], "pose {count}");
    }
}

#[test]
fn no_displacement_changes_no_bit_and_one_along_the_drive_is_like_its_command() {
    let mut rng = ChaCha8Rng::seed_from_u64(35);
    let robot = random_full_robot(&mut rng);
    let command = working_command(&robot, &mut rng);
    let mut plant = plant(&robot);
    let expected = plant.settle(&command).expect("a stiff robot");
    let zero = plant.settle_displaced(&command, &[[0.0; 6]; 7]).expect("a stiff robot");
    assert_eq!(bits(&zero), bits(&expected));

    // The waist turns by its command or behind it: all that follows is the same.
    let mut shifts = [[0.0; 6]; 7];
    shifts[1][5] = 2e-3;
    let shifted = plant.settle_displaced(&command, &shifts).expect("a stiff robot");
    let mut turned = command.clone();
    turned[1] += 2e-3;
    let turned = plant.settle(&turned).expect("a stiff robot");
    assert!((shifted.target - turned.target).norm() < 1e-12);
    assert!((shifted.target - expected.target).norm() > 1e-3);
}

#[test]
fn the_pose_tells_what_yields_and_where_the_loop_is() {
    let robot = full_robot();
    let mut rng = ChaCha8Rng::seed_from_u64(36);
    let pose = plant(&robot).settle(&working_command(&robot, &mut rng)).expect("a stiff robot");
    let count = |found: fn(&ElasticPlace) -> bool| pose.elastic.iter().filter(|e| found(&e.place)).count();
    assert_eq!(count(|place| matches!(place, ElasticPlace::Bearing { .. })), 35);
    assert_eq!(count(|place| matches!(place, ElasticPlace::Beam { link: 2 | 4, segment: 0 })), 12);
    assert_eq!(count(|place| *place == ElasticPlace::Rod), 1);
    let rod = pose.elastic.last().expect("the rod");
    let [shoulder, crank, lever, elbow] = pose.linkage.expect("a loop");
    let force = pose.rod_force.expect("a rod");
    assert!(force < -1e3, "the forearm pushes the rod");
    assert!((6e7 * rod.value - force).abs() < 1e-6 * force.abs());
    assert!(((lever - crank).norm() - 1.35 - rod.value).abs() < 1e-12);
    assert!(((crank - shoulder).norm() - 0.35).abs() < 1e-12);
    assert!(((lever - elbow).norm() - 0.35).abs() < 1e-12);
    assert!((pose.links[3].translation.vector - elbow).norm() < 1e-15);
}

/// With a payload the machine rests where the independent solution of one with a further load does; without it again where it did.
#[test]
fn a_payload_hangs_on_the_flange_until_it_is_taken_off() {
    let mut rng = ChaCha8Rng::seed_from_u64(39);
    let (mut largest, mut least) = (0.0_f64, f64::INFINITY);
    for _ in 0..20 {
        let robot = random_full_robot(&mut rng);
        let command = working_command(&robot, &mut rng);
        let payload = Payload {
            name: "plates".to_owned(),
            mass: rng.random_range(5.0..50.0),
            centre: Vector3::from_fn(|_, _| rng.random_range(-0.2..0.2)),
            force: Vector3::new(0.0, 40.0, -20.0),
        };
        let mut machine = plant(&robot);
        let bare = machine.settle(&command).expect("a stiff robot");
        machine.carry(Some(&payload)).expect("sound");
        let loaded = machine.settle(&command).expect("a stiff robot");
        let mut with_load = robot.clone();
        with_load.statics.loads.push(PointLoad {
            name: payload.name.clone(),
            link: 6,
            at: (robot.kinematics.last_from_flange * Point3::from(payload.centre)).coords,
            mass: payload.mass,
            force: payload.force,
        });
        let reference = Constrained::new(&with_load, &command, &[]);
        largest = largest.max((loaded.target - reference.target(&reference.solve().0)).norm());
        least = least.min((loaded.target - bare.target).norm());
        let negative = Payload { mass: -1.0, ..payload.clone() };
        assert!(matches!(machine.carry(Some(&negative)), Err(PlantError::Mass { .. })));
        assert_eq!(bits(&machine.settle(&command).expect("still there")), bits(&loaded));
        machine.carry(None).expect("nothing");
        assert_eq!(bits(&machine.settle(&command).expect("a stiff robot")), bits(&bare));
    }
    eprintln!("at most {largest:e} m off; the payload moves the target by {least:.4} m or more");
    assert!(largest <= 1e-9 && least > 1e-4, "{largest:e} {least:e}");
}
