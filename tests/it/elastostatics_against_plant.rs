//! The plant and what identification predicts: two implementations of one definition, which meet nowhere else but in measurements.

#[path = "../../crates/calibrig-plant/src/tests/random_robot.rs"]
mod random_robot;
#[path = "../../crates/calibrig-plant/src/tests/spray_robot.rs"]
mod spray_robot;

use calibrig::model::nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use calibrig::elastostatics::{Deflection, ElasticChain};
use calibrig::model::{CalibrationModel, Payload, TermPlace};
use calibrig::plant::effects::Effects;
use calibrig::plant::{AsBuilt, Plant, SettleOptions};
use random_robot::{random_full_robot, random_shifts};
use spray_robot::working_command;

#[test]
fn elastostatics_predicts_the_whole_robot() {
    let mut rng = ChaCha8Rng::seed_from_u64(40);
    let (mut largest, mut first_order) = (0.0_f64, 0.0_f64);
    for _ in 0..200 {
        let robot = random_full_robot(&mut rng);
        let command = working_command(&robot, &mut rng);
        let shifts = random_shifts(&mut rng);
        let corrections: Vec<_> = (0..42)
            .map(|i| (TermPlace::Frame { joint: i / 6, component: i % 6 }, shifts[i / 6][i % 6]))
            .collect();
        let mut chain = ElasticChain::new(&CalibrationModel {
            kinematics: robot.kinematics.clone(),
            actuators: robot.actuators.clone(),
            statics: Some(robot.statics.clone()),
            motor_turns: vec![None; 7],
            spans: Vec::new(),
        })
        .expect("a robot");
        let mut predict = |deflection| {
            chain.settle(&command, &corrections, deflection).expect("a stiff robot");
            chain.target(&robot.target)
        };
        let mut plant = Plant::new(&robot, SettleOptions::default()).expect("a sound robot");
        let settled = plant.settle_displaced(&command, &shifts).expect("a stiff robot").target;
        largest = largest.max((settled - predict(Deflection::Equilibrium)).norm());
        let droop = (settled - predict(Deflection::None)).norm();
        first_order = first_order.max((settled - predict(Deflection::FirstOrder)).norm() / droop);
    }
    eprintln!("equilibrium: at most {largest:e} m off; first order: {first_order:.4} of the droop");
    assert!(largest <= 1e-9, "{largest:e}");
    assert!(first_order <= 0.02, "{first_order}");
}

/// The same with a load on the flange, which both hang there by themselves.
#[test]
fn elastostatics_predicts_the_robot_with_a_payload() {
    let mut rng = ChaCha8Rng::seed_from_u64(41);
    let (mut largest, mut moved) = (0.0_f64, f64::INFINITY);
    for _ in 0..50 {
        let robot = random_full_robot(&mut rng);
        let command = working_command(&robot, &mut rng);
        let payload = Payload {
            name: "plates".to_owned(),
            mass: rng.random_range(5.0..50.0),
            centre: Vector3::from_fn(|_, _| rng.random_range(-0.2..0.2)),
            force: Vector3::from_fn(|_, _| rng.random_range(-50.0..50.0)),
        };
        let mut chain = ElasticChain::new(&CalibrationModel {
            kinematics: robot.kinematics.clone(),
            actuators: robot.actuators.clone(),
            statics: Some(robot.statics.clone()),
            motor_turns: vec![None; 7],
            spans: Vec::new(),
        })
        .expect("a robot");
        let mut plant = Plant::new(&robot, SettleOptions::default()).expect("a sound robot");
        let mut both = |payload: Option<&Payload>| {
            chain.set_payload(payload).expect("sound");
            chain.settle(&command, &[], Deflection::Equilibrium).expect("a stiff robot");
            plant.carry(payload).expect("sound");
            [plant.settle(&command).expect("a stiff robot").target, chain.target(&robot.target)]
        };
        let [bare, _] = both(None);
        let [loaded, predicted] = both(Some(&payload));
        largest = largest.max((loaded - predicted).norm());
        moved = moved.min((loaded - bare).norm());
    }
    eprintln!("at most {largest:e} m off; the payloads move the target by {moved:.5} m or more");
    assert!(largest <= 1e-9 && moved > 1e-5, "{largest:e} {moved:e}");
}
