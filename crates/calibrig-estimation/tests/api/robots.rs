//! Robots of any kind, and what a tracker sees of them.

use std::f64::consts::FRAC_PI_2;

use calibrig_estimation::identification::{IdentificationOptions, Mode};
use calibrig_estimation::kinematics::target_in_base;
use calibrig_model::measurement::{
    MeasurementSet, NestObservation, Observation, Reading, SphericalReading, Station, Target,
};
use calibrig_model::nalgebra::{Matrix3, Vector3};
use calibrig_model::{
    ActuatorMap, Beam, BeamRun, BeamSegment, Bearing, Body, CalibrationModel, CraigLink, CrankAxis, FourBar,
    LinkageArm, LinkageStatics, PointLoad, Section, SegmentLength, StaticProperties,
};
use proptest::prelude::*;

/// A robot, what was measured of it, and how it is to be identified.
#[derive(Debug, Clone)]
pub struct Case {
    pub model: CalibrationModel,
    pub set: MeasurementSet,
    pub options: IdentificationOptions,
    /// A joint of the robot, to break something of.
    pub joint: usize,
    /// Something that is no finite number.
    pub bad: f64,
}

pub fn bad() -> impl Strategy<Value = f64> {
    prop::sample::select(vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY])
}

/// How the elbow is driven.
#[derive(Debug, Clone, Copy)]
enum Drive {
    Direct,
    Parallelogram,
    FourBar,
}

pub fn case() -> impl Strategy<Value = Case> {
    let mode = prop::sample::select(Mode::ALL.to_vec());
    (model(), 4..20_u32, any::<[bool; 4]>(), mode, any::<prop::sample::Index>(), bad()).prop_map(
        |(model, poses, known, mode, joint, bad)| {
            let mode =
                if mode.needs_statics() && model.statics.is_none() { Mode::OnlyCalibration } else { mode };
            Case {
                set: measured(&model, poses, known),
                options: IdentificationOptions { mode, ..IdentificationOptions::default() },
                joint: joint.index(model.kinematics.joint_count()),
                model,
                bad,
            }
        },
    )
}

pub fn model() -> impl Strategy<Value = CalibrationModel> {
    let drive = prop::sample::select(vec![Drive::Direct, Drive::Parallelogram, Drive::FourBar]);
    (prop::collection::vec(link(), 1..=7), any::<[bool; 4]>(), drive).prop_map(
        |(mut links, [statics, beam, load, turns], drive)| {
            for (index, link) in links.iter_mut().enumerate() {
                link.name = format!("j{}", index + 1);
            }
            let drive = if links.len() < 3 { Drive::Direct } else { drive };
            if !matches!(drive, Drive::Direct) {
                // An exact parallelogram over parallel axes.
                for link in &mut links[1..3] {
                    *link = CraigLink::revolute(link.name.as_str()).row(0.8, 0.0, 0.0, 0.0).limits(-1.0, 1.0);
                }
            }
            let count = links.len();
            let mut model = CalibrationModel::new(links).expect("a chain");
            if turns {
                let turns = (0..count).map(|joint| (joint % 2 == 0).then_some(10.0 + joint as f64)).collect();
                model = model.with_motor_turns(turns).expect("a number of turns");
            }
            let statics = statics.then(|| self::statics(&model, drive, beam, load));
            // The two belong together, and are stated together.
            model.actuators = actuators(drive);
            model.statics = statics;
            model.check().expect("a robot");
            model
        },
    )
}

fn link() -> impl Strategy<Value = CraigLink> {
    let angle = prop_oneof![Just(0.0), Just(FRAC_PI_2), Just(-FRAC_PI_2), -3.0..3.0_f64];
    let length = || prop_oneof![Just(0.0), -1.5..1.5_f64];
    let span = prop_oneof![Just(f64::INFINITY), 0.1..3.0_f64];
    (any::<bool>(), length(), angle.clone(), length(), angle, -1.5..0.0_f64, span).prop_map(
        |(turns, a, alpha, d, theta, low, span)| {
            let link = if turns { CraigLink::revolute("") } else { CraigLink::prismatic("") };
            let link = link.row(a, alpha, d, theta);
            if span.is_finite() { link.limits(low, low + span) } else { link }
        },
    )
}

fn actuators(drive: Drive) -> ActuatorMap {
    let arm = LinkageArm { length: 0.3, angle: 0.4, along: 0.0 };
    let linkage = FourBar { crank: arm, lever: arm, rod: 0.8, axis: CrankAxis::default() };
    let linkage = matches!(drive, Drive::FourBar).then_some(linkage);
    match drive {
        Drive::Direct => ActuatorMap::Direct,
        _ => ActuatorMap::Parallelogram { shoulder: 1, elbow: 2, offset: 1.2, linkage },
    }
}

pub fn body() -> Body {
    Body { mass: 4.0, centre_of_mass: Vector3::new(0.1, 0.0, 0.05), inertia: Matrix3::identity() * 0.1 }
}

pub fn beam() -> Beam {
    let section =
        Section { axial: 4e8, shear: [8e7, 9e7], torsion: 5e5, bending: [6e5, 7e5], mass_per_length: 2.0 };
    Beam {
        run: BeamRun::AlongX,
        segments: vec![BeamSegment { length: SegmentLength::Constant(0.5), section }],
    }
}

fn statics(model: &CalibrationModel, drive: Drive, with_beam: bool, with_load: bool) -> StaticProperties {
    let joints = model.kinematics.joint_count();
    let stiffness = (0..joints).map(|joint| if joint == 3 { f64::INFINITY } else { 2e6 }).collect();
    let gravity = Vector3::new(0.0, -9.80665, 0.5);
    let mut statics = StaticProperties::of_drives(vec![body(); joints], stiffness, gravity);
    if with_beam {
        statics.beams[0] = Some(beam());
        statics.bearings[joints - 1] = Bearing { stiffness: [1e8; 6], ..Bearing::default() };
    }
    if with_load {
        let load = PointLoad {
            name: "tool".to_owned(),
            link: joints - 1,
            at: Vector3::new(0.0, 0.1, 0.1),
            mass: 2.0,
            force: Vector3::new(0.0, 1.0, 0.0),
        };
        statics.loads.push(load);
    }
    if matches!(drive, Drive::FourBar) {
        statics.linkage = Some(LinkageStatics { rod_stiffness: 1e7, rod_mass: 1.0, crank: body() });
    }
    statics
}

fn wave(k: u32, pace: f64) -> f64 {
    (pace * (f64::from(k) + 0.3)).sin()
}

/// Commands in the middle of the limits, where every robot of these can go.
pub fn command(model: &CalibrationModel, pose: u32) -> Vec<f64> {
    let paces = [1.1, 0.7, 1.9, 2.3, 2.9, 3.7, 4.1];
    let joint = |(link, pace): (&CraigLink, &f64)| match link.limits {
        [low, high] if high.is_finite() => 0.5 * (low + high) + 0.4 * (high - low) * wave(pose, *pace),
        _ => wave(pose, *pace),
    };
    let joints: Vec<_> = model.kinematics.links.iter().zip(&paces).map(joint).collect();
    model.actuators.command_from_joints(&joints)
}

/// `known`: whether nests and the target's uncertainty are stated, readings are spherical, and Cartesian ones state their covariance.
fn measured(model: &CalibrationModel, poses: u32, known: [bool; 4]) -> MeasurementSet {
    let [nests, target, spherical, stated] = known;
    let covariance = Matrix3::identity() * 1e-10;
    let in_flange = Vector3::new(0.1, 0.05, 0.2);
    let away = Vector3::new(4.0, 1.0, 1.5);
    let nest = |in_base: Vector3<f64>| NestObservation {
        time: None,
        name: format!("{in_base:?}"),
        in_base,
        in_base_covariance: covariance,
        reading: Reading::Cartesian { position: in_base + away, covariance: Some(covariance) },
    };
    let places = [Vector3::zeros(), Vector3::x(), Vector3::y(), Vector3::z()];
    let nests = if nests { places.map(nest).to_vec() } else { Vec::new() };
    let observe = |pose: u32| {
        let command = command(model, pose);
        let mut joints = vec![0.0; command.len()];
        model.actuators.joints_from_command(&command, &mut joints);
        let in_base = target_in_base(&model.kinematics, &joints, &in_flange).expect("a pose");
        let error = Vector3::new(wave(pose, 5.3), wave(pose, 6.1), wave(pose, 7.7)) * 1e-5;
        let position = in_base + away + error;
        let reading = if spherical {
            let range = position.norm();
            Reading::Spherical(SphericalReading {
                face: calibrig_model::measurement::Face::Front,
                range,
                azimuth: position.y.atan2(position.x),
                elevation: position.z.atan2(position.x.hypot(position.y)),
                covariance: Some(covariance),
            })
        } else {
            Reading::Cartesian { position, covariance: stated.then_some(covariance) }
        };
        Observation {
            pose,
            approach: if pose.is_multiple_of(3) { Vec::new() } else { vec![1; command.len()] },
            since_reversal: Vec::new(),
            command,
            temperature: (pose.is_multiple_of(2)).then_some(20.0),
            time: f64::from(pose),
            station: 0,
            target: 0,
            payload: None,
            reading,
        }
    };
    MeasurementSet {
        stations: vec![Station { name: "T1".to_owned(), nests, ..Station::default() }],
        targets: vec![Target {
            orientation: None,
            name: "S1".to_owned(),
            in_flange,
            covariance: target.then_some(covariance),
        }],
        observations: (1..=poses).map(observe).collect(),
    }
}

/// The robot that the front page of the crate has, with a set that determines it.
pub fn arm() -> (CalibrationModel, MeasurementSet) {
    let model = CalibrationModel::new(vec![
        CraigLink::prismatic("rail").row(0.0, 0.0, 0.0, 0.0).limits(0.0, 3.0),
        CraigLink::revolute("shoulder").row(0.2, FRAC_PI_2, 0.0, 0.0).limits(-1.5, 1.5),
        CraigLink::revolute("elbow").row(0.9, 0.0, 0.0, 0.0).limits(-1.5, 1.5),
        CraigLink::revolute("wrist").row(0.1, -FRAC_PI_2, 0.7, 0.0),
    ])
    .expect("a chain");
    let model = CalibrationModel { statics: Some(statics(&model, Drive::Direct, true, true)), ..model };
    let set = measured(&model, 40, [true; 4]);
    (model, set)
}
