mod constrained;
mod equilibrium;
mod random_robot;
mod refusals;
mod spray_robot;
mod whole;

use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::chain::Chain;
use super::effects::Effects;
use super::tree::Tree;
use super::{AsBuilt, ElasticPlace, Plant, PlantError, SettleOptions, SettledPose};
use calibrig_model::geometry::{Transform, rotation_x, rotation_y, rotation_z, translation};
use calibrig_model::{ActuatorMap, AxisMap, Body, CraigLink, JointKind, KinematicModel, StaticProperties};
use equilibrium::Equilibrium;
use spray_robot::{add_errors, full_robot, spray_robot, working_pose};

fn plant(robot: &AsBuilt) -> Plant {
    Plant::new(robot, SettleOptions::default()).expect("a sound robot")
}

fn spray_robot_with_errors(rng: &mut ChaCha8Rng) -> AsBuilt {
    let mut robot = spray_robot();
    add_errors(&mut robot, rng);
    robot
}

fn random_body(rng: &mut ChaCha8Rng) -> Body {
    // Half of the bodies have equal moments, for which the principal axes are not determined.
    let masses = if rng.random() { [1.0; 3] } else { [(); 3].map(|()| rng.random_range(0.1..2.0)) };
    let total: f64 = masses.iter().sum();
    let moments = Vector3::from(masses.map(|m| total - m));
    let axes = Rotation3::new(Vector3::from([(); 3].map(|()| rng.random_range(-3.0..3.0))));
    Body {
        mass: rng.random_range(1.0..500.0),
        centre_of_mass: Vector3::from([(); 3].map(|()| rng.random_range(-0.5..0.5))),
        inertia: axes * Matrix3::from_diagonal(&moments) * axes.inverse(),
    }
}

fn random_robot(rng: &mut ChaCha8Rng, stiffness: f64) -> AsBuilt {
    let joints = rng.random_range(1..=8);
    let links = (0..joints).map(|i| CraigLink {
        name: i.to_string(),
        kind: if rng.random_range(0..3) == 0 { JointKind::Prismatic } else { JointKind::Revolute },
        a: rng.random_range(-1.5..1.5),
        alpha: rng.random_range(-3.2..3.2),
        beta: rng.random_range(-1.0..1.0),
        d: rng.random_range(-1.5..1.5),
        theta: rng.random_range(-3.2..3.2),
        limits: [-4.0, 4.0],
    });
    let links = links.collect();
    let last_from_flange = translation(0.1, -0.2, 0.3)
        * rotation_x(rng.random_range(-3.0..3.0))
        * rotation_y(rng.random_range(-3.0..3.0))
        * rotation_z(rng.random_range(-3.0..3.0));
    let base_from_first = translation(-0.3, 0.2, 0.4) * rotation_y(0.8) * rotation_z(-0.5);
    AsBuilt {
        kinematics: KinematicModel { links, base_from_first, last_from_flange },
        actuators: ActuatorMap::Direct,
        statics: StaticProperties::of_drives(
            (0..joints).map(|_| random_body(rng)).collect(),
            vec![stiffness; joints],
            Vector3::new(3.0, -8.0, 5.0),
        ),
        target: Vector3::new(0.3, -0.1, 0.2),
        effects: Effects::default(),
    }
}

/// Every number of a pose, to the bit.
fn bits(pose: &SettledPose) -> Vec<u64> {
    let mut numbers: Vec<f64> = pose.target.iter().copied().collect();
    numbers.extend(pose.links.iter().flat_map(|link| link.to_homogeneous().as_slice().to_vec()));
    numbers.extend(&pose.deflection);
    numbers.extend(pose.elastic.iter().map(|spring| spring.value));
    numbers.extend(pose.linkage.iter().flatten().flatten());
    numbers.extend(pose.rod_force);
    numbers.extend([pose.residual, pose.closure]);
    numbers.iter().map(|x| x.to_bits()).chain([u64::from(pose.steps)]).collect()
}

#[test]
fn without_compliance_rapier_gives_the_craig_product_for_any_chain() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut largest: f64 = 0.0;
    for case in 0..300 {
        // At 1e20 the deflection is below the last bit of the coordinates.
        let robot = random_robot(&mut rng, if case % 2 == 0 { f64::INFINITY } else { 1e20 });
        let mut plant = plant(&robot);
        for _ in 0..3 {
            let q: Vec<f64> = robot.kinematics.links.iter().map(|_| rng.random_range(-4.0..4.0)).collect();
            let pose = plant.settle(&q).expect("it cannot move");
            let product = Equilibrium { robot: &robot, rest: &q };
            let q = DVector::from_column_slice(&q);
            for (link, expected) in pose.links.iter().zip(product.frames(&q)) {
                largest = largest.max((link.to_homogeneous() - expected).amax());
            }
            largest = largest.max((pose.target - product.target(&q)).amax());
            assert_eq!(pose.links.len(), q.len());
        }
    }
    eprintln!("largest difference of a link or target: {largest:e} m");
    assert!(largest < 1e-12, "{largest}");
}

#[test]
fn a_rigid_drive_stays_exactly_at_its_command_while_the_others_give() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for _ in 0..40 {
        let mut robot = spray_robot_with_errors(&mut rng);
        let rigid: Vec<bool> = (0..7).map(|_| rng.random()).collect();
        for (stiffness, rigid) in robot.statics.drive_stiffness.iter_mut().zip(&rigid) {
            if *rigid {
                *stiffness = f64::INFINITY;
            }
        }
        let command = working_pose(&mut rng);
        let pose = plant(&robot).settle(&command).expect("a stiff robot");
        let reference = Equilibrium { robot: &robot, rest: &command };
        let q = reference.solve();
        assert!((pose.target - reference.target(&q)).norm() < 1e-11);
        for joint in 0..7 {
            assert_eq!(rigid[joint], pose.deflection[joint] == 0.0, "{rigid:?} {:?}", pose.deflection);
        }
    }
}

#[test]
fn the_derivatives_of_the_reference_are_those_of_its_energy() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let robot = spray_robot_with_errors(&mut rng);
    let rest = working_pose(&mut rng);
    let reference = Equilibrium { robot: &robot, rest: &rest };
    let q = DVector::from_iterator(7, rest.iter().map(|rest| rest + rng.random_range(-0.1..0.1)));
    let (gradient, hessian) = reference.derivatives(&q);
    for joint in 0..7 {
        let h = 1e-5;
        let (mut up, mut down) = (q.clone(), q.clone());
        up[joint] += h;
        down[joint] -= h;
        let slope = (reference.energy(&up) - reference.energy(&down)) / (2.0 * h);
        assert!((slope - gradient[joint]).abs() < 1e-6 * gradient.amax(), "{joint}");
        let column = (reference.derivatives(&up).0 - reference.derivatives(&down).0) / (2.0 * h);
        assert!((column - hessian.column(joint)).amax() < 1e-6 * hessian.amax(), "{joint}");
    }
}

#[test]
fn the_pose_at_rest_is_the_minimum_of_the_potential_energy() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let (mut largest, mut steps, mut residual) = (0.0_f64, 0, 0.0_f64);
    let mut droops = Vec::new();
    for _ in 0..50 {
        let robot = spray_robot_with_errors(&mut rng);
        let mut plant = plant(&robot);
        for _ in 0..4 {
            let command = working_pose(&mut rng);
            let pose = plant.settle(&command).expect("a stiff robot");
            let reference = Equilibrium { robot: &robot, rest: &command };
            let q = reference.solve();
            largest = largest.max((pose.target - reference.target(&q)).norm());
            for joint in 0..7 {
                let deflection = q[joint] - command[joint];
                assert!((pose.deflection[joint] - deflection).abs() < 1e-10, "joint {joint}");
            }
            let unloaded = reference.target(&DVector::from_column_slice(&command));
            droops.push((pose.target - unloaded).norm());
            steps = steps.max(pose.steps);
            residual = residual.max(pose.residual);
        }
    }
    let mean = droops.iter().sum::<f64>() / droops.len() as f64;
    eprintln!(
        "tip: at most {largest:e} m off; droop {mean:.4} m in the mean; residual {residual:e}; {steps} steps"
    );
    assert!(largest < 1e-10, "{largest}");
    assert!((0.010..0.015).contains(&mean), "{mean}");
}

#[test]
fn a_pose_depends_on_no_bit_of_the_poses_before() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut robot = spray_robot_with_errors(&mut rng);
    robot.statics.drive_stiffness[5] = f64::INFINITY;
    let commands: Vec<_> = (0..200).map(|_| working_pose(&mut rng)).collect();
    let mut in_order = plant(&robot);
    let poses: Vec<_> = commands.iter().map(|c| bits(&in_order.settle(c).expect("a stiff robot"))).collect();

    let mut shuffled: Vec<usize> = (0..commands.len()).collect();
    for i in (1..shuffled.len()).rev() {
        shuffled.swap(i, rng.random_range(0..=i));
    }
    let mut again = plant(&robot);
    for (count, &i) in shuffled.iter().enumerate() {
        if count % 10 == 0 {
            // A pose far from the others, and one that fails.
            again.settle(&[-40.0, 3.0, 3.0, -3.0, 9.0, 2.0, 1.0]).expect("a stiff robot");
            again.settle(&[1e308; 7]).expect_err("no such place");
        }
        assert_eq!(bits(&again.settle(&commands[i]).expect("a stiff robot")), poses[i], "pose {i}");
        assert_eq!(bits(&plant(&robot).settle(&commands[i]).expect("a stiff robot")), poses[i], "pose {i}");
    }
}

#[test]
fn a_chain_is_put_exactly_at_the_coordinates_wherever_it_was() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let robot = full_robot();
    let tree = Tree::new(&robot, &[2.0; 7]);
    let mut chain = Chain::new(&tree, &robot.statics.gravity, 1.0);
    for _ in 0..20 {
        let mut coordinates = vec![0.0; chain.coordinate_count()];
        coordinates.fill_with(|| rng.random_range(-1e3..1e3));
        chain.place(&coordinates);
        chain.step_from_rest();
        coordinates.fill_with(|| rng.random_range(-3.0..3.0));
        chain.place(&coordinates);
        for (i, q) in coordinates.iter().enumerate() {
            assert_eq!(chain.coordinate(i).to_bits(), q.to_bits());
        }
    }
}

#[test]
fn the_transmission_decides_where_the_drives_rest() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let direct = spray_robot_with_errors(&mut rng);
    let mut coupled = direct.clone();
    coupled.actuators = ActuatorMap::Parallelogram { shoulder: 2, elbow: 3, offset: 0.25, linkage: None };
    let command = working_pose(&mut rng);
    let mut joints = [0.0; 7];
    coupled.actuators.joints_from_command(&command, &mut joints);
    let expected = plant(&direct).settle(&joints).expect("a stiff robot");
    let pose = plant(&coupled).settle(&command).expect("a stiff robot");
    assert_eq!(bits(&pose), bits(&expected));
    assert!((joints[3] - command[3]).abs() > 1.0, "the map does something");

    // The third axis is shown the other way round, the fourth against it, in front of the same parallelogram.
    let shown = DMatrix::from_fn(7, 7, |axis, actuator| match (axis, actuator) {
        (2, 2) => -1.0,
        (3, 2) => 0.5,
        _ => f64::from(u8::from(axis == actuator)),
    });
    let axes = AxisMap::new(shown, DVector::from_element(7, 0.1)).expect("lower triangular");
    let mut shown = direct.clone();
    shown.actuators = ActuatorMap::Axes { axes, elbow: coupled.actuators.elbow() };
    let command = shown.actuators.command_from_joints(&joints);
    let pose = plant(&shown).settle(&command).expect("a stiff robot");
    assert!((pose.target - expected.target).norm() < 1e-12);
}

/// A body of 10 kg on a lever of 1 m, with a drive that gravity overpowers.
fn soft_pendulum() -> AsBuilt {
    AsBuilt {
        kinematics: KinematicModel {
            links: vec![CraigLink {
                name: "pendulum".to_owned(),
                kind: JointKind::Revolute,
                a: 0.0,
                alpha: 0.0,
                beta: 0.0,
                d: 0.0,
                theta: 0.0,
                limits: [-4.0, 4.0],
            }],
            base_from_first: Transform::identity(),
            last_from_flange: Transform::identity(),
        },
        actuators: ActuatorMap::Direct,
        statics: StaticProperties::of_drives(
            vec![Body {
                mass: 10.0,
                centre_of_mass: Vector3::x(),
                inertia: Matrix3::from_diagonal_element(0.1),
            }],
            vec![50.0],
            Vector3::new(9.80665, 0.0, 0.0),
        ),
        target: Vector3::x(),
        effects: Effects::default(),
    }
}

#[test]
fn a_drive_that_gravity_overpowers_still_finds_its_rest() {
    let robot = soft_pendulum();
    let short = SettleOptions { dt: 0.05, max_steps: 2000, ..SettleOptions::default() };
    for options in [SettleOptions::default(), short] {
        let pose = Plant::new(&robot, options).expect("a sound robot").settle(&[1.0]).expect("a stable pose");
        let reference = Equilibrium { robot: &robot, rest: &[1.0] };
        assert!((pose.target - reference.target(&reference.solve())).norm() < 1e-9);
    }
}

#[test]
fn a_pose_that_is_not_at_rest_in_time_is_an_error_with_its_numbers() {
    let robot = spray_robot();
    let command = working_pose(&mut ChaCha8Rng::seed_from_u64(7));
    let options = SettleOptions { max_steps: 3, residual_tolerance: 1e-25, ..SettleOptions::default() };
    let mut plant = Plant::new(&robot, options).expect("a sound robot");
    let error = plant.settle(&command).expect_err("numbers are not that good");
    let PlantError::NotSettled { steps, tip_motion, residual, closure } = error else { panic!("{error}") };
    assert_eq!(steps, 3);
    assert!(tip_motion < 1e-9 && residual > 0.0 && residual < 1e-12 && closure == 0.0, "{error}");
}

#[test]
fn a_target_on_the_last_axis_does_not_hide_a_joint_that_still_moves() {
    let mut robot = spray_robot();
    robot.target = Vector3::zeros();
    let command = working_pose(&mut ChaCha8Rng::seed_from_u64(8));
    let options = SettleOptions { tip_tolerance: 1.0, residual_tolerance: 1e-14, ..SettleOptions::default() };
    let pose = Plant::new(&robot, options).expect("a sound robot").settle(&command).expect("a stiff robot");
    let q = Equilibrium { robot: &robot, rest: &command }.solve();
    for joint in 0..7 {
        assert!((pose.deflection[joint] - (q[joint] - command[joint])).abs() < 1e-13);
    }
}

#[test]
fn places_beyond_the_numbers_are_refused() {
    let mut soft = spray_robot();
    soft.statics.drive_stiffness = vec![1e-300; 7];
    let mut stiff = spray_robot();
    stiff.statics.drive_stiffness = vec![f64::MAX; 7];
    for robot in [spray_robot(), soft, stiff] {
        let mut plant = plant(&robot);
        for command in [[1e308; 7], [f64::MAX; 7], [-1e200; 7]] {
            let error = plant.settle(&command).expect_err("no such place");
            assert!(matches!(error, PlantError::NotSettled { .. } | PlantError::Unstable { .. }), "{error}");
        }
    }
}
