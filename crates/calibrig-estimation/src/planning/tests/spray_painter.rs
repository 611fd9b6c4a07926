//! The spray painter in the region of `scenarios/paper.toml`: thirty planned poses compared with sixty drawn ones.

use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use rand::RngExt;

use crate::identification::{
    CalibratedRobot, FrameChoice, IdentificationOptions, MachineNoiseChoice, Mode, ParameterChoice,
    Predictor, TargetChoice,
};
use crate::planning::{
    Choice, Criterion, DesignSpace, ParameterScale, PlannedSession, candidate_commands, choose,
};
use calibrig_files::load_robot;
use calibrig_model::geometry::{Transform, rotation_y};
use calibrig_model::measurement::{
    Face, MeasurementSet, NestObservation, Observation, Reading, SphericalReading, Station, Target,
};
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::{CalibrationModel, PoseQuery};

/// Middle and half-width of the region, m and rad.
const REGION: [[f64; 2]; 7] =
    [[2.0, 1.92], [0.35, 0.34], [-1.47, 0.20], [0.16, 0.14], [2.0, 0.30], [-0.19, 1.45], [-0.69, 0.45]];
/// Certified places of the nests, m.
const NESTS: [[f64; 3]; 7] = [
    [0.6, 0.05, -0.3],
    [0.6, 0.05, 2.0],
    [0.6, 0.05, 4.3],
    [2.0, 0.0, -0.3],
    [2.0, 0.0, 4.3],
    [0.6, 1.5, -0.3],
    [0.6, 1.5, 4.3],
];

/// A point as a tracker sees it: 2 um and 0.75 um/m along the beam and across, about an eighth of what data sheets allow.
fn seen(in_tracker: Vector3<f64>) -> Reading {
    let range = in_tracker.norm();
    let sigma = 2e-6 + 0.75e-6 * range;
    let variances = Vector3::new(sigma, sigma / range, sigma / range).map(|s| s * s);
    Reading::Spherical(SphericalReading {
        face: Face::Front,
        range,
        azimuth: in_tracker.y.atan2(in_tracker.x),
        elevation: in_tracker.z.atan2(in_tracker.x.hypot(in_tracker.y)),
        covariance: Some(Matrix3::from_diagonal(&variances)),
    })
}

/// The nominal robot at commands, seen by a tracker next to the middle of its rail.
fn set(model: &CalibrationModel, in_flange: Vector3<f64>, commands: &[Vec<f64>]) -> MeasurementSet {
    let robot = CalibratedRobot {
        mode: Mode::ElastoGeometric,
        nominal: model.clone(),
        model: model.clone(),
        terms: Vec::new(),
        stations: vec![Transform::identity()],
        targets: vec![in_flange],
        instruments: Vec::new(),
        orientations: vec![None],
    };
    let turn = rotation_y(std::f64::consts::PI);
    let place = Vector3::new(6.0, 1.5, 1.5);
    let in_tracker = |in_base: Vector3<f64>| turn.rotation * (in_base - place);
    let micrometres = Matrix3::identity() * 10e-6_f64.powi(2);
    let nest = |place: &[f64; 3]| NestObservation {
        time: None,
        name: format!("{place:?}"),
        in_base: Vector3::from(*place),
        in_base_covariance: micrometres,
        reading: seen(in_tracker(Vector3::from(*place))),
    };
    let mut predictor = Predictor::new(&robot).expect("a robot");
    let observe = |(index, command): (usize, &Vec<f64>)| Observation {
        pose: u32::try_from(index + 1).expect("few"),
        command: command.clone(),
        approach: Vec::new(),
        since_reversal: Vec::new(),
        temperature: None,
        time: 0.0,
        station: 0,
        target: 0,
        payload: None,
        reading: seen(in_tracker(predictor.in_base(command).expect("a pose"))),
    };
    let observations = commands.iter().enumerate().map(observe).collect();
    let target =
        Target { name: "SMR".to_owned(), in_flange, covariance: Some(micrometres), orientation: None };
    let station =
        Station { name: "T".to_owned(), nests: NESTS.iter().map(nest).collect(), ..Station::default() };
    MeasurementSet { stations: vec![station], targets: vec![target], observations }
}

/// Options as in the scenario: the published parameters and the drives' compliances, nests and target measured, and the scatter of the machine as
/// stated.
fn options() -> IdentificationOptions {
    let second = std::f64::consts::PI / 180.0 / 3600.0;
    let repeatability =
        vec![50e-6, 6.0 * second, 6.0 * second, 6.0 * second, 50e-6, 10.0 * second, 10.0 * second];
    IdentificationOptions {
        mode: Mode::ElastoGeometric,
        parameters: ParameterChoice::NeighbourAxisRules,
        frame: FrameChoice::Nests,
        target: TargetChoice::Measured,
        machine_noise: MachineNoiseChoice::Stated(repeatability),
        ..IdentificationOptions::published()
    }
}

fn of_region(rms: f64) -> String {
    format!("{:.1} um", rms * 1e6)
}

#[test]
fn thirty_planned_poses_tell_more_than_sixty_drawn_ones() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/spray_painter/robot.toml");
    let robot = load_robot(&path).expect("the shipped robot");
    let (model, in_flange) = (&robot.model, robot.target().expect("stated"));
    let region = REGION.map(|[middle, half]| [middle - half, middle + half]);
    let mut rng = stream(1, 0, StreamSource::VerificationPoses);
    let mut commands_at_random = |count: usize, region: &[[f64; 2]]| -> Vec<Vec<f64>> {
        let joints = |_| region.iter().map(|[low, high]| rng.random_range(*low..*high)).collect::<Vec<f64>>();
        (0..count).map(joints).map(|joints| model.actuators.command_from_joints(&joints)).collect()
    };
    let predicted = commands_at_random(200, &region);
    let queries: Vec<PoseQuery<'_>> = predicted.iter().map(PoseQuery::from).collect();
    let rms = |space: &DesignSpace, design: &[usize]| {
        space.figures(design).expect("told").accuracy.expect("a region").of_parameters.rms
    };
    let space = |commands: &[Vec<f64>]| {
        let set = set(model, in_flange, commands);
        let mut session =
            PlannedSession::new(model, &set, &options(), None, &[], &queries).expect("a session");
        session.space(&ParameterScale::Effect).expect("a space")
    };
    // Sixty random poses of the region, twenty times.
    let of_chance = space(&commands_at_random(1200, &region));
    let mut drawn: Vec<f64> =
        (0..20).map(|k| rms(&of_chance, &(60 * k..60 * (k + 1)).collect::<Vec<_>>())).collect();
    drawn.sort_by(f64::total_cmp);
    eprintln!("{} parameters", of_chance.parameters().len());
    let middle = 0.5 * (drawn[9] + drawn[10]);
    eprintln!("60 drawn: {} to {}, median {}", of_region(drawn[0]), of_region(drawn[19]), of_region(middle));
    let limits: Vec<[f64; 2]> = model.kinematics.links.iter().map(|link| link.limits).collect();
    for (name, region) in [("region", region.as_slice()), ("limits", &limits)] {
        let space = space(&candidate_commands(model, region, 2000).expect("candidates"));
        for count in [30, 60] {
            let choice = Choice { criterion: Criterion::I, starts: 1, ..Choice::of(count) };
            let design = choose(std::slice::from_ref(&space), &choice).expect("a design");
            let planned = rms(&space, &design.chosen);
            eprintln!("{count} planned in the {name}: {}, {:?}", of_region(planned), design.starts);
            assert!((planned.powi(2) / design.value - 1.0).abs() < 1e-9 && design.settled);
            // Within the region itself, thirty planned poses are about as good as sixty.
            let least = if (name, count) == ("region", 30) { middle } else { drawn[0] };
            assert!(planned < least, "{count} in the {name}: {planned} for {drawn:?}");
        }
    }
}
