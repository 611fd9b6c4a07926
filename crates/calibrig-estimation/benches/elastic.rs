//! One pose of an elastic spray painter with 61 springs and a four-bar: its equilibrium, and the columns of 45 parameters.
//!
//! `cargo bench --bench elastic`

#![allow(clippy::expect_used, missing_docs)]

use std::hint::black_box;

use calibrig_estimation::elastostatics::{Deflection, ElasticChain};
use calibrig_model::geometry::Transform;
use calibrig_model::{
    ActuatorMap, Beam, BeamRun, BeamSegment, Bearing, BearingSide, Body, CalibrationModel, Compliance,
    CraigLink, CrankAxis, FourBar, JointKind, KinematicModel, LinkageArm, LinkageStatics, LinkageTerm,
    ParameterId, Section, SegmentLength, StaticProperties,
};
use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::{Matrix3, Vector3};

use JointKind::{Prismatic, Revolute};

/// Kind, a, alpha in deg, d, mass, stiffness of the drive.
const ROWS: [(JointKind, f64, f64, f64, f64, f64); 7] = [
    (Prismatic, 0.0, 0.0, 0.0, 800.0, 2.0e7),
    (Revolute, 0.0, -90.0, 0.626, 400.0, 1.5e6),
    (Revolute, 0.25, -90.0, 0.0, 250.0, 6.5e5),
    (Revolute, 1.35, 0.0, 0.0, 150.0, 4.6e5),
    (Prismatic, 0.246, -90.0, 0.0, 80.0, 1.0e7),
    (Revolute, 0.0, 0.0, 0.0, 25.0, 1.0e5),
    (Revolute, 0.0, 90.0, 0.0, 15.0, 5.0e4),
];
const JOINTS: [f64; 7] = [2.0, 0.19, -1.71, 0.12, 2.0, -0.16, -0.77];

#[allow(clippy::unnecessary_wraps, reason = "as the model holds it")]
fn beam(run: BeamRun, lengths: &[SegmentLength]) -> Option<Beam> {
    let section = Section {
        axial: 5e8,
        shear: [1e8, 1.2e8],
        torsion: 5e6,
        bending: [1e7, 1.3e7],
        mass_per_length: 25.0,
    };
    let segments = lengths.iter().map(|length| BeamSegment { length: *length, section }).collect();
    Some(Beam { run, segments })
}

fn robot() -> CalibrationModel {
    let links = ROWS.iter().map(|&(kind, a, alpha, d, ..)| CraigLink {
        name: String::new(),
        kind,
        a,
        alpha: alpha.to_radians(),
        beta: 0.0,
        d,
        theta: 0.0,
        limits: [-5.0, 5.0],
    });
    let body = |mass| Body { mass, centre_of_mass: Vector3::new(0.2, 0.1, 0.0), inertia: Matrix3::zeros() };
    let bodies = ROWS.iter().map(|row| body(row.4)).collect();
    let drives = ROWS.iter().map(|row| row.5).collect();
    let mut statics = StaticProperties::of_drives(bodies, drives, Vector3::new(0.0, -9.80665, 0.0));
    statics.bearings.fill(Bearing {
        stiffness: [2e8, 3e8, 2.5e8, 8e6, 6e6, 7e6],
        side: BearingSide::Moving,
        at: 0.0,
    });
    statics.beams[2] = beam(BeamRun::AlongX, &[SegmentLength::Constant(0.65), SegmentLength::Constant(0.7)]);
    statics.beams[4] = beam(BeamRun::EndsAtOrigin, &[SegmentLength::Extension(1.2)]);
    statics.linkage = Some(LinkageStatics { rod_stiffness: 3e7, rod_mass: 20.0, crank: body(30.0) });
    let arm = LinkageArm { length: 0.35, angle: -1.5, along: 0.1 };
    let linkage = FourBar { crank: arm, lever: arm, rod: 1.352, axis: CrankAxis::default() };
    CalibrationModel {
        kinematics: KinematicModel {
            links: links.collect(),
            base_from_first: Transform::identity(),
            last_from_flange: Transform::identity(),
        },
        actuators: ActuatorMap::Parallelogram { shoulder: 2, elbow: 3, offset: 0.0, linkage: Some(linkage) },
        statics: Some(statics),
        motor_turns: vec![None; 7],
        spans: Vec::new(),
    }
}

/// 24 link parameters, 9 compliances, 7 masses, 3 lengths, 2 components of the target.
fn parameters() -> Vec<ParameterId> {
    let mut ids = ParameterId::all_of_links(7);
    ids.truncate(24);
    ids.extend((0..7).map(|joint| ParameterId::Compliance(Compliance::Drive { joint })));
    ids.extend([2, 4].map(|link| ParameterId::Compliance(Compliance::Beam { link })));
    ids.extend((0..7).map(|link| ParameterId::Mass { link }));
    ids.extend([LinkageTerm::Crank, LinkageTerm::Lever, LinkageTerm::Rod].map(ParameterId::Linkage));
    ids.extend((0..2).map(|axis| ParameterId::Target { target: 0, axis }));
    ids
}

fn benches(c: &mut Criterion) {
    let model = robot();
    let command = model.actuators.command_from_joints(&JOINTS);
    let parameters = parameters();
    assert_eq!(parameters.len(), 45);
    let in_flange = Vector3::new(0.10, 0.15, 0.20);
    let mut chain = ElasticChain::new(&model).expect("a robot");

    let mut group = c.benchmark_group("a pose with 61 springs");
    for deflection in [Deflection::None, Deflection::FirstOrder, Deflection::Equilibrium] {
        group.bench_function(format!("settle, {deflection:?}"), |b| {
            b.iter(|| {
                chain.settle(black_box(&command), &[], deflection).expect("rest");
                chain.target(&in_flange)
            });
        });
    }
    group.bench_function("settle and 45 columns", |b| {
        b.iter(|| {
            chain.settle(black_box(&command), &[], Deflection::Equilibrium).expect("rest");
            chain.prepare(&in_flange).expect("stable");
            parameters.iter().map(|id| chain.column(*id).expect("of the robot")).sum::<Vector3<f64>>()
        });
    });
    group.finish();
}

criterion_group!(all, benches);
criterion_main!(all);
