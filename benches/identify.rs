//! `identify` on 100 poses with 24 + 6 parameters; and with stiffness, at the robot's own equilibrium.
//!
//! `cargo bench --bench identify`

#![allow(clippy::expect_used, missing_docs)]

use std::hint::black_box;
use std::path::Path;

use calibrig::identification::{ComplianceChoice, FrameChoice, Mode, TargetChoice, identify};
use calibrig::pipeline::{PlantKind, simulate};
use calibrig::scenario::load_scenario;
use criterion::{Criterion, criterion_group, criterion_main};

fn benches(c: &mut Criterion) {
    let mut scenario = load_scenario(Path::new("scenarios/paper.toml")).expect("the shipped scenario");
    scenario.identification_poses = 100;
    scenario.verification_poses = 0;
    let simulation =
        simulate(&scenario, scenario.seed, 0, PlantKind::Rapier, |_, _| {}).expect("a simulation");
    let set = &simulation.sets[0].measurements;
    let mut options = scenario.options.clone();
    options.frame = FrameChoice::Nests;
    options.target = TargetChoice::Fixed;

    let mut group = c.benchmark_group("100 poses, 24 + 6 parameters");
    for mode in [Mode::OnlyCalibration, Mode::WithGravity] {
        options.mode = mode;
        group.bench_function(mode.key(), |b| {
            b.iter(|| {
                identify(black_box(&scenario.robot.model), black_box(set), &options).expect("an estimate")
            });
        });
    }
    group.finish();

    options.mode = Mode::ElastoGeometric;
    options.target = TargetChoice::Measured;
    for compliances in [ComplianceChoice::Drives, ComplianceChoice::All] {
        options.compliances = compliances;
        let estimate = identify(&scenario.robot.model, set, &options).expect("an estimate");
        let name = format!("100 poses, {} parameters with stiffness", estimate.parameters.len());
        c.bench_function(&name, |b| {
            b.iter(|| {
                identify(black_box(&scenario.robot.model), black_box(set), &options).expect("an estimate")
            });
        });
    }
}

criterion_group!(all, benches);
criterion_main!(all);
