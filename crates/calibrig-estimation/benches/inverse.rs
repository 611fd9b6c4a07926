//! Commands for places of the spray painter: rigid, with deflection, and along a raster.
//!
//! `cargo bench --bench inverse`

#![allow(clippy::expect_used, missing_docs)]

use std::hint::black_box;
use std::path::Path;
use std::time::Duration;

use calibrig_estimation::compensation::{Compensator, PathOptions, Raster, ToolPath};
use calibrig_estimation::identification::{CalibratedRobot, Mode};
use calibrig_estimation::inverse::{Criterion, Goal, InverseKinematics, InverseOptions, Tool};
use calibrig_estimation::kinematics::{forward_kinematics, joints_from_command};
use calibrig_files::load_robot;
use calibrig_model::geometry::{Transform, rotation_x, translation};
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::{CalibrationModel, ParameterId};
use criterion::{Criterion as Bench, criterion_group, criterion_main};
use nalgebra::Vector3;
use rand::RngExt;

const MIDDLE: [f64; 7] = [2.0, 0.19, -1.71, 0.12, 2.0, -0.16, -0.77];

fn place(model: &CalibrationModel, command: &[f64], tool: &Tool) -> Transform {
    let mut joints = vec![0.0; command.len()];
    joints_from_command(&model.kinematics, &model.actuators, command, &mut joints).expect("a command");
    forward_kinematics(&model.kinematics, &joints).expect("a pose") * tool.flange_from_tool()
}

/// Places of random joint variables within the limits, with the direction of the gun.
fn goals(model: &CalibrationModel, tool: &Tool) -> Vec<Goal> {
    let mut rng = stream(16, 2, StreamSource::SolverStarts);
    let mut draw = || {
        let joints: Vec<f64> = model
            .kinematics
            .links
            .iter()
            .map(|l| l.limits[0] + rng.random::<f64>() * (l.limits[1] - l.limits[0]))
            .collect();
        let there = place(model, &model.actuators.command_from_joints(&joints), tool);
        Goal::Axis { position: there.translation.vector, direction: there.rotation * Vector3::z() }
    };
    (0..1000).map(|_| draw()).collect()
}

fn calibrated(nominal: &CalibrationModel) -> CalibratedRobot {
    let mut identified = nominal.clone();
    for (k, id) in ParameterId::all_of_links(nominal.kinematics.joint_count()).into_iter().enumerate() {
        identified.kinematics.add(id, 2e-3 * (1.7 * (k as f64 + 0.3)).sin());
    }
    CalibratedRobot {
        mode: Mode::ElastoGeometric,
        nominal: nominal.clone(),
        model: identified,
        terms: Vec::new(),
        stations: Vec::new(),
        targets: vec![Vector3::new(0.1, 0.15, 0.2)],
        instruments: Vec::new(),
        orientations: vec![None],
    }
}

/// Ten metres of a panel in front of the gun, in ten thousand points.
fn raster(model: &CalibrationModel, tool: &Tool) -> ToolPath {
    let there = place(model, &model.actuators.command_from_joints(&MIDDLE), tool);
    let gun = there.rotation * Vector3::z();
    let along = (Vector3::z() - gun * gun.z).normalize();
    let up = gun.cross(&along);
    let centre = there.translation.vector + 0.2 * gun;
    let corner = |x: f64, y: f64| centre + x * along - y * up;
    let corners = [corner(-0.6, -0.35), corner(0.6, -0.35), corner(0.6, 0.35), corner(-0.6, 0.35)];
    let raster = Raster { corners, pitch: 0.1, spacing: 1e-3, standoff: 0.2 };
    let mut goals = raster.goals().expect("a panel");
    goals.truncate(10_001);
    ToolPath::at_speed(&goals, 0.5).expect("a path")
}

fn benches(c: &mut Bench) {
    let model = load_robot(Path::new("../../models/spray_painter/robot.toml")).expect("a robot").model;
    let tool = Tool::new(translation(0.1, 0.05, 0.2) * rotation_x(0.7)).expect("a tool");
    let goals = goals(&model, &tool);
    let robot = calibrated(&model);
    let criteria = [
        ("none", Criterion::NONE),
        ("limits", Criterion::FAR_FROM_LIMITS),
        ("manipulability", Criterion::MANIPULABILITY),
        ("deflection", Criterion::LEAST_DEFLECTION),
    ];

    let mut group = c.benchmark_group("a place of the spray gun");
    let mut time = |name: &str, mut inverse: InverseKinematics<'_>| {
        for (by, criterion) in criteria {
            let options = InverseOptions { criterion, ..InverseOptions::default() };
            let mut next = goals.iter().cycle();
            group.bench_function(format!("{name}, criterion {by}"), |b| {
                b.iter(|| inverse.solve(black_box(next.next().expect("endless")), &options).is_ok());
            });
        }
    };
    time("rigid", InverseKinematics::new(&model, tool).expect("a robot"));
    time("with deflection", InverseKinematics::of_robot(&robot, tool).expect("a robot"));
    group.finish();

    let path = raster(&model, &tool);
    let mut compensator = Compensator::new(&robot, tool).expect("a robot");
    let reference = Some(model.actuators.command_from_joints(&MIDDLE));
    let inverse = InverseOptions { reference, ..InverseOptions::default() };
    let options = PathOptions { inverse, ..PathOptions::default() };
    let mut group = c.benchmark_group("a raster of 10 m");
    group.sample_size(10).measurement_time(Duration::from_secs(20));
    group.bench_function(format!("{} points with deflection", path.points().len()), |b| {
        b.iter(|| compensator.path(&path, &options).expect("a path").is_whole());
    });
    group.finish();
}

criterion_group!(all, benches);
criterion_main!(all);
