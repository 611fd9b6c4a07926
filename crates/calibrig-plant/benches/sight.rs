//! How many poses a second are looked at past the robot's own links, alone and with the reading of the tracker.

// The functions that criterion generates have no docs; a bench may stop at its first error.
#![allow(missing_docs, clippy::expect_used)]

// One of its robots is measured.
#[allow(dead_code)]
#[path = "../src/tests/spray_robot.rs"]
mod spray_robot;

use std::hint::black_box;

use calibrig_model::Visual;
use calibrig_model::VisualShape;
use calibrig_model::geometry::translation;
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::visibility::{Obstacles, Reflector, Stance, TrackerReach, stance_at};
use calibrig_plant::AsBuilt;
use calibrig_plant::effects::Effects;
use calibrig_plant::tracker::{ErrorLine, Instrument, LaserTracker, Shot};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::{UnitVector3, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use spray_robot::{spray_robot, working_command};

fn look(criterion: &mut Criterion) {
    let robot = spray_robot();
    let kinematics = &robot.kinematics;
    // Two shapes a link, as the shipped URDF has; small, so that most lines are free and all shapes are asked.
    let shape = |shape| Visual { link_from_shape: translation(0.1, 0.0, 0.2), shape };
    let pair = || {
        vec![shape(VisualShape::Box([0.1; 3])), shape(VisualShape::Cylinder { radius: 0.05, length: 0.2 })]
    };
    let visuals: Vec<_> = (0..=kinematics.joint_count()).map(|_| pair()).collect();
    let up = UnitVector3::new_normalize(Vector3::y());
    let obstacles =
        Obstacles::of_shapes(kinematics, &visuals, 0.01).with_floor(up, -0.5).with_standoff(0.025);
    let opening = Some(UnitVector3::new_normalize(Vector3::x()));
    let reflector = Reflector { in_flange: robot.target, opening, acceptance: std::f64::consts::PI };
    let line = |offset| ErrorLine { offset, per_metre: 6e-6 };
    let instrument = Instrument::of_noise(line(15e-6), line(10e-6), 0.125);
    let tracker = LaserTracker::levelled(instrument, Vector3::new(6.0, 1.5, 1.5), 3.0, &Vector3::y());
    let base_from_tracker = tracker.tracker_from_base.inverse();
    let reach = TrackerReach::all_round([0.1, 30.0]);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let poses: Vec<Vec<f64>> = (0..1000).map(|_| working_command(&robot, &mut rng)).collect();
    let stances: Vec<_> = poses.iter().map(|joints| stance_at(kinematics, joints)).collect();

    let mut group = criterion.benchmark_group("sight");
    group.throughput(Throughput::Elements(1));
    let mut joints = poses.iter().cycle();
    group.bench_function("pose of a planner", |bencher| {
        bencher.iter(|| {
            joints.next().map(|joints| {
                obstacles.look_at_joints(
                    &base_from_tracker,
                    &reach,
                    kinematics,
                    black_box(joints),
                    &reflector,
                )
            })
        });
    });
    let mut settled = stances.iter().cycle();
    let mut noise = stream(1, 0, StreamSource::IdentificationNoise);
    group.bench_function("settled pose with its reading", |bencher| {
        bencher.iter(|| {
            settled.next().map(|(links, flange)| {
                let stance = Stance { links, flange };
                let sight = obstacles.look(&base_from_tracker, &reach, black_box(stance), &reflector);
                let target = flange.rotation * reflector.in_flange + flange.translation.vector;
                sight.ok().and_then(|_| tracker.measure(&target, &Shot::default(), &mut noise).ok())
            })
        });
    });
    group.finish();
}

criterion_group!(benches, look);
criterion_main!(benches);
