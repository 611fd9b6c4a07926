//! How many poses the plant settles a second on one core.
//!
//! What limits it is rapier's step, of which a pose takes one behind its prediction. For the whole robot (58 coordinates on 34 bodies) two
//! thirds of the time go into the two dense mass matrices that a step assembles body by body, whether a body has mass or not; a tenth into
//! forward kinematics with body Jacobians, another into Newton's method.

// The functions that criterion generates have no docs; a bench may stop at its first error.
#![allow(missing_docs, clippy::expect_used)]

#[path = "../src/tests/spray_robot.rs"]
mod spray_robot;

use std::hint::black_box;

use calibrig_plant::effects::Effects;
use calibrig_plant::{AsBuilt, Plant, SettleOptions};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use spray_robot::{add_errors, full_robot, spray_robot, working_command};

fn settle(criterion: &mut Criterion) {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut robot = spray_robot();
    add_errors(&mut robot, &mut rng);
    let mut whole = full_robot();
    add_errors(&mut whole, &mut rng);
    let mut rigid = robot.clone();
    rigid.statics.drive_stiffness.fill(f64::INFINITY);

    let mut group = criterion.benchmark_group("plant");
    group.throughput(Throughput::Elements(1));
    // With rigid drives nothing is predicted.
    let robots = [
        ("settle, elastic drives", &robot),
        ("settle, rigid drives", &rigid),
        ("settle, whole robot", &whole),
    ];
    for (name, robot) in robots {
        let mut plant = Plant::new(robot, SettleOptions::default()).expect("a sound robot");
        let commands: Vec<_> = (0..1000).map(|_| working_command(robot, &mut rng)).collect();
        let mut commands = commands.iter().cycle();
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                commands.next().map(|command| plant.settle(black_box(command)).expect("a stiff robot"))
            });
        });
    }
    for (name, robot) in [("build", &robot), ("build, whole robot", &whole)] {
        group.bench_function(name, |bencher| {
            bencher.iter(|| Plant::new(black_box(robot), SettleOptions::default()).expect("a sound robot"));
        });
    }
    group.finish();
}

criterion_group!(benches, settle);
criterion_main!(benches);
