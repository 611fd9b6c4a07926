//! A small outcome, made up but consistent, for the tests of the recorders.

use std::io::Cursor;

use nalgebra::{DMatrix, Matrix3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::{InputSummary, McapRecorder, Story, record};
use calibrig_estimation::evaluation::accuracy;
use calibrig_estimation::evaluation::closed_loop::ClosedLoop;
use calibrig_estimation::evaluation::{ModeOutcome, RegistrationSummary};
use calibrig_estimation::identification::{
    CalibratedRobot, Estimate, IterationRecord, Mode, NoiseScale, ParameterEstimate, Predictor, Spectrum,
    TerminationReason, Warning,
};
use calibrig_estimation::kinematics::{forward_kinematics, link_frames};
use calibrig_files::Source;
use calibrig_model::geometry::{Transform, rotation_x, rotation_y, rotation_z, translation};
use calibrig_model::measurement::{
    Face, MeasurementSet, NestObservation, Observation, Reading, SphericalReading, Station, Target,
};
use calibrig_model::measurement::{SetKind, SetOutcome};
use calibrig_model::{
    ActuatorMap, Body, CalibrationModel, CraigLink, JointKind, KinematicModel, LinkTerm, ParameterId,
    Payload, StaticProperties, Visual, VisualShape,
};
use calibrig_plant::effects::{Effects, PoseEffects};
use calibrig_plant::session::Truth;
use calibrig_plant::{AsBuilt, ElasticDeflection, ElasticPlace, SettledPose};

/// What a [`Story`] is told from.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Outcome {
    pub(crate) input: InputSummary,
    pub(crate) sources: Vec<(String, Source)>,
    pub(crate) model: CalibrationModel,
    pub(crate) visuals: Vec<Vec<Visual>>,
    pub(crate) registration: RegistrationSummary,
    pub(crate) sets: Vec<SetOutcome>,
    pub(crate) modes: Vec<ModeOutcome>,
    pub(crate) truth: Option<Truth>,
    pub(crate) published: Vec<(SetKind, Mode, [f64; 6])>,
    pub(crate) closed_loop: Option<ClosedLoop>,
}

impl Outcome {
    pub(crate) fn story(&self) -> Story<'_> {
        Story {
            input: &self.input,
            sources: &self.sources,
            model: &self.model,
            visuals: &self.visuals,
            registration: &self.registration,
            sets: &self.sets,
            modes: &self.modes,
            truth: self.truth.as_ref(),
            published: &self.published,
            closed_loop: self.closed_loop.as_ref(),
        }
    }
}

/// The MCAP recording of `outcome`.
pub(crate) fn recorded(outcome: &Outcome) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let mut recorder = McapRecorder::new(&mut bytes).expect("begun");
    record(&outcome.story(), &mut recorder).expect("recorded");
    recorder.finish().expect("finished");
    bytes.into_inner()
}

const IN_FLANGE: [f64; 3] = [0.10, 0.15, 0.20];

/// A run of a seven-axis robot on a rail: `identification` + `verification` poses, with or without truth.
pub(crate) fn outcome(identification: u32, verification: u32, with_truth: bool) -> Outcome {
    let nominal = robot();
    let real = with_errors(&nominal, 1.0);
    let statics = StaticProperties::of_drives(
        (0..7)
            .map(|i| Body {
                mass: 400.0 / f64::from(i + 1),
                centre_of_mass: Vector3::new(0.1, 0.0, 0.05),
                inertia: Matrix3::identity(),
            })
            .collect(),
        vec![5e7, 5e7, 2e7, 2e7, 5e7, 1e7, 1e7],
        Vector3::new(0.0, -9.81, 0.0),
    );
    let tracker_from_base = (translation(2.0, 0.5, 5.5) * rotation_y(-0.4) * rotation_x(-1.57)).inverse();
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let (mut settled, mut rigid, mut effects) = (Vec::new(), Vec::new(), Vec::new());
    let sets = [(SetKind::Identification, identification), (SetKind::Verification, verification)]
        .map(|(kind, poses)| {
            let drawn: Vec<_> = (0..poses).map(|_| draw(&mut rng)).collect();
            let rest: Vec<_> = drawn.iter().map(|q| settle(&real, q, 1e-4)).collect();
            let measurements = measure(&drawn, &rest, &tracker_from_base, &mut rng);
            settled.push(rest);
            rigid.push(drawn.iter().map(|q| settle(&real, q, 0.0)).collect());
            effects.push(drawn.iter().map(|q| effects_at(q)).collect());
            SetOutcome { kind, measurements, dropped: vec![(poses, "no line of sight".to_owned())] }
        })
        .to_vec();
    let model = CalibrationModel {
        kinematics: nominal.clone(),
        actuators: ActuatorMap::Direct,
        statics: Some(statics.clone()),
        motor_turns: vec![None; 7],
        spans: Vec::new(),
    };
    let modes = Mode::ALL
        .into_iter()
        .zip(0..)
        .map(|(mode, place)| {
            mode_outcome(&model, mode, 1.0 - 0.05_f64.powi(place), &tracker_from_base, &sets)
        })
        .collect();
    let truth = Truth {
        as_built: AsBuilt {
            kinematics: real,
            actuators: ActuatorMap::Direct,
            statics,
            target: IN_FLANGE.into(),
            effects: Effects::default(),
        },
        stations: vec![tracker_from_base],
        instrument: Vec::new(),
        further_targets: Vec::new(),
        payloads: Vec::new(),
        orientation: None,
        poses: settled,
        outliers: Vec::new(),
        effects,
        rigid,
    };
    Outcome {
        input: InputSummary {
            kind: "scenario",
            name: "synthetic".to_owned(),
            sha256: "0123456789abcdef".repeat(4),
            seed: Some(7),
            trial: None,
        },
        sources: vec![
            ("scenario".to_owned(), Source::new("scenarios/synthetic.toml", "seed = 7\n")),
            ("robot".to_owned(), Source::new("models/robot.toml", "name = \"made up\" # µm\n")),
            ("urdf".to_owned(), Source::new("models/robot.urdf", "<robot name=\"made_up\"/>\n")),
        ],
        model,
        visuals: visuals(),
        registration: RegistrationSummary {
            how: "best fit of all poses".to_owned(),
            poses: identification as usize,
            rms: 0.0123,
        },
        sets,
        modes,
        truth: with_truth.then_some(truth),
        closed_loop: None,
        published: vec![
            (
                SetKind::Identification,
                Mode::OnlyCalibration,
                [0.0024, 0.0009, 0.0020, 0.0006, 0.0024, 0.0008],
            ),
            (SetKind::Identification, Mode::WithGravity, [0.0017, 0.0007, 0.0015, 0.0004, 0.0023, 0.0007]),
        ],
    }
}

fn robot() -> KinematicModel {
    use std::f64::consts::FRAC_PI_2;
    let rows = [
        ("rail", JointKind::Prismatic, 0.0, 0.0, 0.0, [0.0, 4.0]),
        ("waist", JointKind::Revolute, 0.0, -FRAC_PI_2, 0.626, [-3.0, 3.0]),
        ("shoulder", JointKind::Revolute, 0.25, -FRAC_PI_2, 0.0, [-3.0, 0.0]),
        ("elbow", JointKind::Revolute, 1.35, 0.0, 0.0, [-1.0, 1.5]),
        ("telescope", JointKind::Prismatic, 0.246, -FRAC_PI_2, 0.0, [1.7, 2.3]),
        ("roll", JointKind::Revolute, 0.0, 0.0, 0.0, [-3.0, 3.0]),
        ("wrist", JointKind::Revolute, 0.0, FRAC_PI_2, 0.0, [-2.0, 2.0]),
    ];
    let link = |(name, kind, a, alpha, d, limits): (&str, _, _, _, _, _)| CraigLink {
        name: name.to_owned(),
        kind,
        a,
        alpha,
        beta: 0.0,
        d,
        theta: 0.0,
        limits,
    };
    KinematicModel {
        links: rows.into_iter().map(link).collect(),
        base_from_first: Transform::identity(),
        last_from_flange: Transform::identity(),
    }
}

/// `share` of the made-up errors.
fn errors(share: f64) -> Vec<(ParameterId, f64)> {
    [
        (1, LinkTerm::A, -0.0138),
        (1, LinkTerm::D, 0.0128),
        (2, LinkTerm::Alpha, 0.0015),
        (3, LinkTerm::Theta, -0.0171),
        (3, LinkTerm::Beta, 0.0148),
        (5, LinkTerm::D, 0.0182),
        (6, LinkTerm::A, -0.0107),
    ]
    .map(|(link, term, value)| (ParameterId::link(link, term), share * value))
    .to_vec()
}

fn with_errors(nominal: &KinematicModel, share: f64) -> KinematicModel {
    let mut real = nominal.clone();
    for (id, delta) in errors(share) {
        real.add(id, delta);
    }
    real
}

fn draw(rng: &mut ChaCha8Rng) -> Vec<f64> {
    let centre = [2.0, 0.19, -1.71, 0.12, 2.0, -0.16, -0.77];
    let half_width = [1.92, 0.39, 0.31, 0.20, 0.30, 1.18, 0.57];
    centre.iter().zip(half_width).map(|(c, w)| c + w * rng.random_range(-1.0..1.0)).collect()
}

fn effects_at(q: &[f64]) -> PoseEffects {
    PoseEffects {
        command: q.iter().map(|q| q + 1e-5).collect(),
        displacements: (0..7).map(|i| [1e-5 * f64::from(i); 6]).collect(),
        temperature: Some(21.5),
    }
}

/// Every drive gives way by `softness` more than the one before it, and the four-bar moves with it.
fn settle(real: &KinematicModel, q: &[f64], softness: f64) -> SettledPose {
    let deflection: Vec<f64> = (0..7).map(|i| softness * f64::from(i)).collect();
    let joints: Vec<f64> = q.iter().zip(&deflection).map(|(q, dq)| q + dq).collect();
    let flange = forward_kinematics(real, &joints).expect("seven joints");
    let target = flange.rotation * Vector3::from(IN_FLANGE) + flange.translation.vector;
    SettledPose {
        target,
        links: link_frames(real, &joints).expect("seven joints"),
        deflection,
        elastic: [
            (ElasticPlace::Bearing { joint: 2 }, 3),
            (ElasticPlace::Beam { link: 4, segment: 1 }, 1),
            (ElasticPlace::Rod, 0),
        ]
        .map(|(place, axis)| ElasticDeflection { place, axis, value: softness })
        .to_vec(),
        linkage: Some([0.0, 1.0, 2.0, 3.0].map(|x| Vector3::new(x, softness, 0.0))),
        rod_force: Some(1e6 * softness),
        residual: 1e-10,
        closure: 0.0,
        steps: 321,
    }
}

fn measure(
    commands: &[Vec<f64>],
    settled: &[SettledPose],
    tracker_from_base: &Transform,
    rng: &mut ChaCha8Rng,
) -> MeasurementSet {
    let covariance = Matrix3::from_diagonal(&Vector3::new(1e-11, 2.5e-12, 2.5e-12));
    let mut see = |in_base: &Vector3<f64>| {
        let p = tracker_from_base.rotation * in_base + tracker_from_base.translation.vector;
        let range = p.norm();
        Reading::Spherical(SphericalReading {
            range: range + 3e-6 * rng.random_range(-1.0..1.0),
            azimuth: p.y.atan2(p.x),
            elevation: p.z.atan2(p.x.hypot(p.y)),
            covariance: Some(covariance),
            face: Face::Front,
        })
    };
    let nests = [[0.5, 0.2, -0.6], [0.5, 0.2, 4.6], [-0.5, 0.1, 2.0], [0.4, 0.9, 2.0]];
    let nests = (1..).zip(nests).map(|(number, place)| NestObservation {
        name: format!("N{number}"),
        in_base: place.into(),
        in_base_covariance: Matrix3::identity() * 1e-10,
        reading: see(&place.into()),
        time: None,
    });
    let stations = vec![Station { name: "front".to_owned(), nests: nests.collect(), ..Station::default() }];
    let observations =
        (0_u32..).zip(commands.iter().zip(settled)).map(|(pose, (command, settled))| Observation {
            pose,
            command: command.clone(),
            approach: vec![1, -1, 0, 1, 1, -1, 0],
            since_reversal: vec![0.4, 0.1, 0.0, 0.02, 1.5, 0.3, 0.0],
            temperature: (pose % 2 == 0).then_some(20.5),
            time: 12.5 * f64::from(pose),
            station: 0,
            target: 0,
            payload: (pose % 3 == 2)
                .then(|| Payload::of_mass("plates, 25 kg", 25.0, Vector3::new(0.0, -0.0, 0.12))),
            reading: see(&settled.target),
        });
    MeasurementSet {
        observations: observations.collect(),
        stations,
        targets: vec![Target {
            orientation: None,
            name: "SMR".to_owned(),
            in_flange: IN_FLANGE.into(),
            covariance: Some(Matrix3::identity() * 1e-10),
        }],
    }
}

/// A mode that has found `share` of the errors.
fn mode_outcome(
    model: &CalibrationModel,
    mode: Mode,
    share: f64,
    tracker_from_base: &Transform,
    sets: &[SetOutcome],
) -> ModeOutcome {
    let robot = CalibratedRobot {
        instruments: Vec::new(),
        mode,
        nominal: model.clone(),
        model: CalibrationModel { kinematics: with_errors(&model.kinematics, share), ..model.clone() },
        terms: Vec::new(),
        stations: vec![tracker_from_base * rotation_z(1e-5 * share)],
        targets: vec![IN_FLANGE.into()],
        orientations: vec![None],
    };
    let errors: Vec<Vec<_>> = sets
        .iter()
        .map(|set| {
            Predictor::new(&robot).and_then(|mut p| p.errors(&set.measurements)).expect("a robot that stands")
        })
        .collect();
    let rows = errors.iter().map(|e| accuracy(e)).collect();
    let estimate = (share > 0.0).then(|| estimate(robot.clone(), share));
    let turns = errors.iter().map(|errors| vec![None; errors.len()]).collect();
    ModeOutcome { mode, robot, estimate, errors, rows, turns }
}

fn estimate(robot: CalibratedRobot, share: f64) -> Estimate {
    let parameters: Vec<_> = errors(share)
        .into_iter()
        .map(|(id, value)| ParameterEstimate {
            id,
            value,
            sigma: Some(1e-3 * value.abs()),
            stated_sigma: None,
            prior_sigma: None,
        })
        .collect();
    let n = parameters.len();
    let iterations = (0..5)
        .map(|i| IterationRecord {
            cost: 1e6 * 0.01_f64.powi(i) + 150.0,
            damping: 0.1_f64.powi(i),
            step: 0.1_f64.powi(i),
            gain: 0.99,
            accepted: true,
            // The last one's are the estimate's.
            parameters: parameters.iter().map(|p| p.value - p.value * f64::from(4 - i) / 5.0).collect(),
        })
        .collect();
    Estimate {
        robot,
        parameters,
        covariance: Some(DMatrix::from_fn(n, n, |i, j| if i == j { 1e-9 } else { 1e-12 * i as f64 })),
        factor: None,
        weights: Vec::new(),
        weight_unit: 1.0,
        assumptions: Vec::new(),
        noise: NoiseScale::Stated,
        chi2: 151.25,
        degrees_of_freedom: 120.0,
        machine_noise: Vec::new(),
        reading_scale: None,
        turn_noise: None,
        interval_freedom: None,
        termination: TerminationReason::SmallStep,
        iterations,
        spectrum: Spectrum { rank: n, condition: 41.5, ..Spectrum::default() },
        held: Vec::new(),
        left_out: Vec::new(),
        fixed: Vec::new(),
        bounds: Vec::new(),
        at_bound: Vec::new(),
        contradicted: Vec::new(),
        outliers: Vec::new(),
        warnings: vec![Warning::Inconsistent { ratio: 1.12, accounted: false }],
    }
}

fn visuals() -> Vec<Vec<Visual>> {
    let shape = |link_from_shape, shape| vec![Visual { link_from_shape, shape }];
    vec![
        shape(translation(0.0, -0.15, 2.0), VisualShape::Box([0.7, 0.3, 5.2])),
        shape(translation(0.0, 0.2, 0.0), VisualShape::Box([0.9, 0.4, 0.9])),
        shape(translation(0.0, 0.0, -0.2), VisualShape::Cylinder { radius: 0.28, length: 0.45 }),
        shape(translation(0.675, 0.0, 0.0), VisualShape::Box([1.5, 0.22, 0.26])),
        shape(Transform::identity(), VisualShape::Sphere(0.2)),
        shape(translation(0.0, 0.0, -1.0), VisualShape::Box([0.16, 0.16, 1.9])),
        shape(translation(0.0, 0.0, -0.1), VisualShape::Cylinder { radius: 0.09, length: 0.25 }),
        shape(Transform::identity(), VisualShape::Sphere(0.09)),
    ]
}
