//! Beams against the theory of Timoshenko.

use nalgebra::{Matrix3, Vector3};

use crate::elastostatics::{Deflection, ElasticChain};
use calibrig_model::geometry::Transform;
use calibrig_model::{
    ActuatorMap, Beam, BeamRun, BeamSegment, Body, CalibrationModel, CraigLink, JointKind, KinematicModel,
    PointLoad, Section, SegmentLength, StaticProperties,
};

const LENGTHS: [f64; 3] = [0.4, 0.7, 0.2];
const SECTION: Section =
    Section { axial: 4e8, shear: [6e7, 9e7], torsion: 2e6, bending: [3e6, 5e6], mass_per_length: 2e-2 };

fn cantilever(run: BeamRun, gravity: Vector3<f64>, force: Vector3<f64>) -> CalibrationModel {
    let length: f64 = LENGTHS.iter().sum();
    let (middle, tip) = match run {
        BeamRun::AlongX => (Vector3::new(0.5 * length, 0.0, 0.0), Vector3::new(length, 0.0, 0.0)),
        BeamRun::EndsAtOrigin => (Vector3::new(0.0, 0.0, -0.5 * length), Vector3::zeros()),
    };
    let body =
        Body { mass: SECTION.mass_per_length * length, centre_of_mass: middle, inertia: Matrix3::zeros() };
    let mut statics = StaticProperties::of_drives(vec![body], vec![f64::INFINITY], gravity);
    let segment = |l| BeamSegment { length: SegmentLength::Constant(l), section: SECTION };
    statics.beams[0] = Some(Beam { run, segments: LENGTHS.map(segment).to_vec() });
    statics.loads.push(PointLoad { name: "end".to_owned(), link: 0, at: tip, mass: 0.0, force });
    let link = CraigLink {
        name: "root".to_owned(),
        kind: JointKind::Revolute,
        a: 0.0,
        alpha: 0.0,
        beta: 0.0,
        d: 0.0,
        theta: 0.0,
        limits: [-3.0, 3.0],
    };
    CalibrationModel {
        kinematics: KinematicModel {
            links: vec![link],
            base_from_first: Transform::identity(),
            last_from_flange: Transform::identity(),
        },
        actuators: ActuatorMap::Direct,
        statics: Some(statics),
        motor_turns: vec![None],
        spans: Vec::new(),
    }
}

/// First the axis of the beam. Across it, loads are so small that the theory of second order says nothing.
#[test]
fn a_cantilever_bends_as_in_the_book() {
    let l: f64 = LENGTHS.iter().sum();
    for (run, first) in [(BeamRun::AlongX, 0), (BeamRun::EndsAtOrigin, 2)] {
        for load in 0..3 {
            let axis = (first + load) % 3;
            let (weight, force) = if load == 0 { (2e4, 3e4) } else { (20.0, 30.0) };
            let mut unit = Vector3::zeros();
            unit[axis] = 1.0;
            let model = cantilever(run, unit * (weight / SECTION.mass_per_length), unit * force);
            let expected = if load == 0 {
                (force * l + 0.5 * weight * l * l) / SECTION.axial
            } else {
                // A force along the second axis bends about the third.
                let (ga, ei) = (SECTION.shear[load - 1], SECTION.bending[2 - load]);
                force * (l.powi(3) / (3.0 * ei) + l / ga)
                    + weight * (l.powi(4) / (8.0 * ei) + l * l / (2.0 * ga))
            };
            let tip = if first == 0 { Vector3::new(l, 0.0, 0.0) } else { Vector3::zeros() };
            for deflection in [Deflection::FirstOrder, Deflection::Equilibrium] {
                let mut chain = ElasticChain::of(&model);
                chain.settle(&[0.0], &[], deflection).expect("rest");
                let moved = (chain.target(&tip) - tip)[axis];
                assert!((moved / expected - 1.0).abs() <= 1e-10, "{run:?} {load}: {moved} {expected}");
            }
        }
    }
}

/// Alike about a tilted joint: the root turns by the moment over the drive's stiffness.
#[test]
fn a_drive_turns_under_the_moment_at_the_root() {
    let mut model = cantilever(BeamRun::AlongX, Vector3::zeros(), Vector3::new(0.0, -30.0, 0.0));
    let statics = model.statics.as_mut().expect("statics");
    statics.beams[0] = None;
    statics.drive_stiffness[0] = 2e3;
    let l: f64 = LENGTHS.iter().sum();
    let mut chain = ElasticChain::of(&model);
    chain.settle(&[0.0], &[], Deflection::Equilibrium).expect("rest");
    let angle = chain.deflections()[0];
    // k u = -F l cos(u)
    assert!((2e3 * angle + 30.0 * l * angle.cos()).abs() <= 1e-9, "{angle}");
    assert!(angle < -0.015);
}
