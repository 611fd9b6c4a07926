//! How many poses the plant settles a second on one core.
//!
//! A pose is solved by Newton's method and then, unless the options say otherwise, confirmed by a step of rapier, which takes most of the time: for
//! the whole robot (58 coordinates on 34 bodies) it assembles two dense mass matrices body by body, whether a body has mass or not.

// The functions that criterion generates have no docs; a bench may stop at its first error.
#![allow(missing_docs, clippy::expect_used)]

#[path = "../src/tests/spray_robot.rs"]
mod spray_robot;

use std::hint::black_box;

use calibrig_model::nalgebra::Vector3;
use calibrig_plant::effects::{Anchor, Effects, Foundation, Hose, Hoses, RailSpan};
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

    let mut yielding = whole.clone();
    let rail = RailSpan { joint: 0, first_foot: 0.0, span: 1.25, compliance: [1e-9, 2e-9] };
    let at = Vector3::new(0.0, 0.0, 2.0);
    yielding.effects.foundation = Some(Foundation { at, stiffness: [4e8; 6], rail: Some(rail) });
    let ends = [Anchor { link: Some(1), at: Vector3::x() }, Anchor { link: Some(3), at: Vector3::y() }];
    let hose = Hose { ends, stiffness: 400.0, free_length: 0.3 };
    yielding.effects.hoses = Some(Hoses { hoses: vec![hose] });

    let quick = SettleOptions { confirm: false, ..SettleOptions::default() };
    let usual = SettleOptions::default();
    let mut group = criterion.benchmark_group("plant");
    group.throughput(Throughput::Elements(1));
    let robots = [
        ("settle, elastic drives", &robot, usual),
        ("settle, rigid drives", &rigid, usual),
        ("settle, whole robot", &whole, usual),
        ("settle, whole robot, floor and hose", &yielding, usual),
        ("settle, whole robot, unconfirmed", &whole, quick),
        ("settle, whole robot, floor and hose, unconfirmed", &yielding, quick),
    ];
    for (name, robot, options) in robots {
        let mut plant = Plant::new(robot, options).expect("a sound robot");
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
