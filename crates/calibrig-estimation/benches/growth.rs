//! How the time and the memory of `identify` grow with the number of poses. A machine with the model's own errors is measured at evenly
//! spread poses with 20 µm of noise, and another that no model has, whose noise is found with the fit; the last column is the largest memory held
//! at one time beyond what was there before.
//!
//! `cargo bench --bench growth`, or `cargo bench --bench growth -- 100 300` for other numbers of poses

#![allow(clippy::expect_used, clippy::disallowed_methods, missing_docs)]

use std::hint::black_box;
use std::path::Path;
use std::time::{Duration, Instant};

use calibrig_estimation::elastostatics::apply;
use calibrig_estimation::identification::{
    CalibratedRobot, ComplianceChoice, Estimate, FrameChoice, IdentificationOptions, Mode, Predictor,
    TargetChoice, identify, neighbour_axis_rules, structural_poses,
};
use calibrig_files::load_robot;
use calibrig_model::geometry::{rotation_x, translation};
use calibrig_model::measurement::{MeasurementSet, NestObservation, Observation, Reading, Station, Target};
use calibrig_model::{CalibrationModel, Compliance, ParameterId, PoseQuery};
use nalgebra::{DMatrix, Matrix3, Point3, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const POSES: [usize; 4] = [100, 1_000, 10_000, 100_000];
const SIGMA: f64 = 2e-5;
const MISFIT: f64 = 3e-4;
/// Time spent on repetitions of one fit, of which the shortest counts.
const REPEATED_FOR: Duration = Duration::from_secs(1);

/// Drives, rod, beams and the elbow's tilting bearing: with links, frame and target they make 45 parameters.
fn springs(nominal: &CalibrationModel) -> Vec<Compliance> {
    let identified = |c: &Compliance| match *c {
        Compliance::Drive { .. } | Compliance::Rod | Compliance::Beam { .. } => true,
        Compliance::Bearing { joint, axis } => joint == 3 && (axis == 3 || axis == 4),
    };
    nominal.compliances().into_iter().filter(identified).collect()
}

/// Some millimetres and milliradians in every link, and springs a few percent off.
fn machine(nominal: &CalibrationModel, mode: Mode) -> CalibratedRobot {
    let mut model = nominal.clone();
    let links = neighbour_axis_rules(&nominal.kinematics).0;
    for (id, place) in links.into_iter().zip(0_u32..) {
        apply(&mut model, nominal, id, 1e-2 * (2.3 * f64::from(place) + 0.4).sin()).expect("a link");
    }
    for (compliance, place) in springs(nominal).into_iter().zip(0_u32..) {
        let off: f64 = 0.1 * (1.7 * f64::from(place) + 0.9).sin();
        apply(&mut model, nominal, ParameterId::Compliance(compliance), off).expect("a spring");
    }
    CalibratedRobot {
        instruments: Vec::new(),
        mode,
        nominal: nominal.clone(),
        model,
        terms: Vec::new(),
        stations: vec![translation(5.0, 1.0, 1.5) * rotation_x(0.4)],
        targets: vec![Vector3::new(0.1, 0.15, 0.2)],
        orientations: Vec::new(),
    }
}

/// What no model has: a displacement that varies with the joints, in units of `MISFIT`.
fn beside(joints: &[f64]) -> Vector3<f64> {
    Vector3::new((3.0 * joints[1]).sin(), (2.0 * joints[2]).cos(), (2.0 * joints[4] + joints[5]).sin())
}

/// Poses in the middle of the joints' limits, as `robot` takes them, but for a `misfit`, m.
fn measure(nominal: &CalibrationModel, robot: &CalibratedRobot, poses: usize, misfit: f64) -> MeasurementSet {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let covariance = Some(Matrix3::identity() * SIGMA * SIGMA);
    let station = robot.stations[0];
    let nest = |in_base: Vector3<f64>| NestObservation {
        time: None,
        name: String::new(),
        in_base,
        in_base_covariance: Matrix3::identity() * 1e-10,
        reading: Reading::Cartesian { position: (station * Point3::from(in_base)).coords, covariance },
    };
    let corners = [Vector3::zeros(), Vector3::x(), Vector3::y(), 4.0 * Vector3::z()];
    let target = Target { orientation: None, name: String::new(), in_flange: robot.targets[0], covariance };
    let mut set = MeasurementSet {
        stations: vec![Station { nests: corners.map(nest).to_vec(), ..Station::default() }],
        targets: vec![target],
        observations: Vec::with_capacity(poses),
    };
    let links = &nominal.kinematics.links;
    let mut predictor = Predictor::new(robot).expect("a robot");
    for (pose, mut joints) in (0..).zip(structural_poses(&nominal.kinematics, poses)) {
        for (q, link) in joints.iter_mut().zip(links) {
            let middle = 0.5 * (link.limits[0] + link.limits[1]);
            *q = middle + 0.7 * (*q - middle);
        }
        let command = nominal.actuators.command_from_joints(&joints);
        let approach = vec![1; command.len()];
        let query = PoseQuery { time: f64::from(pose), ..PoseQuery::at(&command).approached(&approach) };
        let in_base =
            predictor.in_base(query).expect("a pose that the robot can take") + misfit * beside(&joints);
        let mut unit = || -> f64 { StandardNormal.sample(&mut rng) };
        let noise = SIGMA * Vector3::from_fn(|_, _| unit());
        let position = (station * Point3::from(in_base)).coords + noise;
        set.observations.push(Observation {
            pose,
            command,
            approach,
            since_reversal: Vec::new(),
            temperature: None,
            time: f64::from(pose),
            station: 0,
            target: 0,
            payload: None,
            reading: Reading::Cartesian { position, covariance },
        });
    }
    set
}

/// The shortest time of a fit, and the most memory that it held.
fn cost(
    nominal: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
) -> (Duration, u64, Estimate) {
    let fit = || identify(black_box(nominal), black_box(set), options).expect("an estimate");
    let mut kept = None;
    let memory = allocation_counter::measure(|| kept = Some(fit())).bytes_max;
    let started = Instant::now();
    let mut shortest = Duration::MAX;
    loop {
        let start = Instant::now();
        black_box(fit());
        shortest = shortest.min(start.elapsed());
        if started.elapsed() > REPEATED_FOR {
            return (shortest, memory, kept.expect("a fit was done"));
        }
    }
}

/// A yardstick: the shortest time of five factorisations of the size of 100 poses.
fn five_qrs() -> Duration {
    let system = DMatrix::from_fn(306, 30, |i, j| ((i * 31 + j * 17) as f64).sin());
    let once = || {
        let start = Instant::now();
        for _ in 0..5 {
            black_box(black_box(&system).clone().qr());
        }
        start.elapsed()
    };
    (0..100).map(|_| once()).min().unwrap_or_default()
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let mut counts: Vec<usize> = arguments.iter().filter_map(|a| a.parse().ok()).collect();
    if counts.is_empty() {
        // `cargo test --benches` only wants to see that it runs.
        let whole = arguments.iter().any(|a| a == "--bench");
        counts.extend(&POSES[..if whole { POSES.len() } else { 1 }]);
    }
    let nominal =
        load_robot(Path::new("../../models/spray_painter/robot.toml")).expect("the shipped robot").model;
    let geometric = IdentificationOptions {
        mode: Mode::OnlyCalibration,
        frame: FrameChoice::Nests,
        target: TargetChoice::Fixed,
        ..IdentificationOptions::published()
    };
    let gravity = IdentificationOptions { mode: Mode::WithGravity, ..geometric.clone() };
    let elastic = IdentificationOptions {
        mode: Mode::ElastoGeometric,
        compliances: ComplianceChoice::Listed(springs(&nominal)),
        target: TargetChoice::Measured,
        ..geometric.clone()
    };
    println!("five QRs of 306 x 30 (nalgebra): {:.2} ms", 1e3 * five_qrs().as_secs_f64());
    println!(
        "mode             noise   parameters   poses  iterations   time ms  us a pose   memory MB  kB a pose"
    );
    let modes = [geometric, gravity, elastic];
    for (options, misfit) in
        modes.iter().map(|mode| (mode, 0.0)).chain(modes.iter().map(|mode| (mode, MISFIT)))
    {
        let robot = machine(&nominal, options.mode);
        for &poses in &counts {
            let set = measure(&nominal, &robot, poses, misfit);
            let (time, memory, estimate) = cost(&nominal, &set, options);
            println!(
                "{:<16} {:<7} {:>10} {poses:>7} {:>11} {:>9.2} {:>10.2} {:>11.2} {:>10.2}",
                options.mode.key(),
                if estimate.found_machine().is_some() { "found" } else { "stated" },
                estimate.parameters.len(),
                estimate.iterations.len(),
                1e3 * time.as_secs_f64(),
                1e6 * time.as_secs_f64() / poses as f64,
                1e-6 * memory as f64,
                1e-3 * memory as f64 / poses as f64,
            );
        }
    }
}
