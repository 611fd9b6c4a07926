//! How many poses the plant settles a second on one core.
//!
//! What limits it is rapier's step, of which a pose takes three: nearly half of the time goes into the two dense mass matrices
//! that a step assembles, a quarter into forward kinematics and body Jacobians.

// The functions that criterion generates have no docs; a bench may stop at its first error.
#![allow(missing_docs, clippy::expect_used)]

#[path = "../src/plant/tests/spray_robot.rs"]
mod spray_robot;

use std::hint::black_box;

use calibrig::geometry::Transform;
use calibrig::model::{ActuatorMap, Body, CraigLink, JointKind, KinematicModel, LinkTerm, StaticProperties};
use calibrig::plant::effects::Effects;
use calibrig::plant::{AsBuilt, Plant, SettleOptions};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use spray_robot::{add_errors, spray_robot, working_pose};

fn settle(criterion: &mut Criterion) {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut robot = spray_robot();
    add_errors(&mut robot, &mut rng);
    let commands: Vec<_> = (0..1000).map(|_| working_pose(&mut rng)).collect();
    let mut rigid = robot.clone();
    rigid.statics.drive_stiffness.fill(f64::INFINITY);

    let mut group = criterion.benchmark_group("plant");
    group.throughput(Throughput::Elements(1));
    // With rigid drives a pose is the warm start and a single step: the difference is the further steps.
    for (name, robot) in [("settle, elastic drives", &robot), ("settle, rigid drives", &rigid)] {
        let mut plant = Plant::new(robot, SettleOptions::default()).expect("a sound robot");
        let mut commands = commands.iter().cycle();
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                commands.next().map(|command| plant.settle(black_box(command)).expect("a stiff robot"))
            });
        });
    }
    group.bench_function("build", |bencher| {
        bencher.iter(|| Plant::new(black_box(&robot), SettleOptions::default()).expect("a sound robot"));
    });
    group.finish();
}

criterion_group!(benches, settle);
criterion_main!(benches);
