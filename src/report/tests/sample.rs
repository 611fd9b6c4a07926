//! Outcomes made up for the tests of the report: plausible numbers, no solver behind them.

use nalgebra::{DMatrix, Matrix3, Vector3, Vector6};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::pipeline::{
    AblatedPart, Ablation, AblationRows, InputSummary, ModeOutcome, Outcome, Part, PlantKind,
    RegistrationSummary, SetKind, SetOutcome, Truth,
};
use calibrig_estimation::evaluation::accuracy;
use calibrig_estimation::evaluation::closed_loop::{
    ClosedLoop, DriveFailure, DrivenCriterion, DrivenMode, DrivenPath, DrivenPoint,
};
use calibrig_estimation::identification::{
    CalibratedRobot, DependentGroup, Estimate, IterationRecord, Mode, NoiseScale, ParameterEstimate,
    Predictor, Spectrum, TerminationReason, Warning, WeakDirection,
};
use calibrig_estimation::inverse::Criterion;
use calibrig_estimation::kinematics::target_in_base;
use calibrig_files::Source as InputText;
use calibrig_model::geometry::{
    Transform, best_fit_transform, rotation_x, rotation_z, small_displacement, translation,
};
use calibrig_model::measurement::{MeasurementSet, Observation, Reading, Station, Target};
use calibrig_model::random::{Source, stream};
use calibrig_model::{
    ActuatorMap, Body, CalibrationModel, CraigLink, JointKind, KinematicModel, LinkTerm, ParameterId,
    StaticProperties, Unit,
};
use calibrig_plant::AsBuilt;
use calibrig_plant::effects::{EffectKind, Effects};

/// Displacement of the base from where the nests place it, m and rad.
pub(in crate::report) const TRUE_FRAME: [f64; 6] = [4e-5, -6e-5, 2e-5, 1.5e-5, -0.8e-5, 2.2e-5];
/// As-built minus stated offset of the target, m.
pub(in crate::report) const TARGET_ERROR: [f64; 3] = [2e-5, -1e-5, 3e-5];
/// A name that must never reach a page as it is.
pub(in crate::report) const HOSTILE: &str = "<script>alert(\"1\")</script> & 'co'";

const STATED_TARGET: [f64; 3] = [0.10, 0.15, 0.20];
/// Wang et al., Machines 2023, 11, 20, section on identified errors: a, alpha, d, theta, beta per link, m and rad.
const DEVIATIONS: [[f64; 5]; 7] = [
    [0.0, -0.0002, -0.0151, 0.0056, 0.0],
    [-0.0138, -0.0009, 0.0128, 0.0012, 0.0],
    [-0.0011, 0.0015, 0.0, 0.0002, 0.0],
    [0.0009, 0.0020, 0.0076, -0.0171, 0.0148],
    [-0.0116, -0.0106, 0.0, 0.0148, 0.0],
    [0.0, -0.0019, 0.0182, 0.0, 0.0],
    [-0.0107, 0.0035, -0.0208, -0.0001, 0.0],
];
const PUBLISHED: [(SetKind, Mode, [f64; 6]); 6] = [
    (SetKind::Identification, Mode::WithoutCalibration, [0.0147, 0.0057, 0.0262, 0.0144, 0.0195, 0.0063]),
    (SetKind::Identification, Mode::OnlyCalibration, [0.0024, 0.0009, 0.0020, 0.0006, 0.0024, 0.0008]),
    (SetKind::Identification, Mode::WithGravity, [0.0017, 0.0007, 0.0015, 0.0004, 0.0023, 0.0007]),
    (SetKind::Verification, Mode::WithoutCalibration, [0.0158, 0.0059, 0.0271, 0.0139, 0.0182, 0.0067]),
    (SetKind::Verification, Mode::OnlyCalibration, [0.0027, 0.0010, 0.0019, 0.0006, 0.0030, 0.0011]),
    (SetKind::Verification, Mode::WithGravity, [0.0021, 0.0008, 0.0015, 0.0005, 0.0029, 0.0011]),
];

/// The nominal robot with the deviations of the machine.
fn built(nominal: &KinematicModel) -> KinematicModel {
    let mut as_built = nominal.clone();
    for (link, row) in DEVIATIONS.iter().enumerate() {
        for (term, value) in LinkTerm::ALL.into_iter().zip(row) {
            as_built.add(ParameterId::link(link, term), *value);
        }
    }
    // One real deviation that no mode fits.
    as_built.add(ParameterId::link(5, LinkTerm::Beta), 0.005);
    as_built
}

/// The same with corrected commands that were driven: every error is what its mode predicted, and a pose of the last mode was not corrected.
pub(in crate::report) fn driven() -> Outcome {
    let mut outcome = simulated();
    let of_mode = |mode: &ModeOutcome| {
        let set = outcome.sets[1].clone();
        let point = |(observation, error): (&Observation, &Vector3<f64>)| DrivenPoint {
            pose: observation.pose,
            goal: Vector3::new(1.0, 0.1 * f64::from(observation.pose), 0.5),
            measured: Vector3::new(1.0, 0.1 * f64::from(observation.pose), 0.5) + error,
            command: observation.command.clone(),
            sigma: mode.estimate.as_ref().map(|_| Vector3::repeat(1e-4)),
        };
        let points: Vec<_> = set.measurements.observations.iter().zip(&mode.errors[1]).map(point).collect();
        let uncorrected =
            mode.estimate.iter().map(|_| (3, format!("the goal of {HOSTILE} is out of reach"))).collect();
        DrivenMode {
            mode: mode.mode,
            set,
            points,
            uncorrected,
            position_alone: vec![(4, "singular".to_owned())],
        }
    };
    let modes: Vec<DrivenMode> = outcome.modes.iter().map(of_mode).collect();
    let row = modes[1].row();
    let criterion = |criterion| DrivenCriterion {
        criterion,
        mode: Mode::WithGravity,
        droop: criterion.map(|_| [0.015, 0.02]),
        nominal: row,
        corrected: row,
        missed: 1,
        position_alone: 0,
    };
    let path = DrivenPath {
        length: 3.8,
        speed: 0.3,
        unreachable: vec![(7, "far".to_owned())],
        modes: modes.clone(),
    };
    outcome.closed_loop = Some(ClosedLoop {
        rows_of_goal: 5,
        redundancy: None,
        modes,
        criteria: vec![criterion(None), criterion(Some(Criterion::LEAST_DEFLECTION))],
        pose_test: None,
        path: Some(path),
        failures: vec![DriveFailure { what: "the pose test".to_owned(), why: "no cube".to_owned() }],
    });
    outcome
}

/// A simulated run with truth, 60 and 38 poses, two of the verification set dropped.
pub(in crate::report) fn simulated() -> Outcome {
    let nominal = nominal();
    let as_built = built(&nominal);
    let prior = translation(3.0, -6.0, 1.2) * rotation_z(0.4) * rotation_x(-1.5);
    let tracker_from_base = prior * small_displacement(&Vector6::from(TRUE_FRAME));
    let target = Vector3::from(STATED_TARGET) + Vector3::from(TARGET_ERROR);

    let mut rng = stream(7, 0, Source::AsBuilt);
    let mut sets = Vec::new();
    let mut unmodelled: Vec<Vec<Vector3<f64>>> = Vec::new();
    for (kind, first, count) in [(SetKind::Identification, 0, 60), (SetKind::Verification, 60, 38)] {
        let mut observations = Vec::new();
        let mut effects = Vec::new();
        for pose in first..first + count {
            let command = draw_command(&mut rng);
            let effect = sag(&command) + 0.25e-3 * normal3(&mut rng);
            let in_base = target_in_base(&as_built, &command, &target).expect("seven joints") + effect;
            effects.push(effect);
            observations.push(observation(pose, command, transformed(&tracker_from_base, &in_base)));
        }
        unmodelled.push(effects);
        let dropped = match kind {
            SetKind::Identification => Vec::new(),
            SetKind::Verification => {
                vec![(98, "the target faces away from the tracker".to_owned()), (99, "no reach".to_owned())]
            }
        };
        sets.push(SetOutcome { kind, measurements: measurements(observations, "SMR 1"), dropped });
    }

    let model = model_of(nominal);
    let (uncalibrated, rms) = registered(&model, &sets[0].measurements);
    let before = sets
        .iter()
        .map(|set| {
            Predictor::new(&uncalibrated)
                .and_then(|mut p| p.errors(&set.measurements))
                .expect("a rigid robot")
        })
        .collect();
    let mut modes = vec![mode_outcome(Mode::WithoutCalibration, uncalibrated, None, before)];
    for (mode, share, ratio) in [(Mode::OnlyCalibration, 1.0, 13.1), (Mode::WithGravity, 0.62, 9.4)] {
        let estimate = simulated_estimate(&mut rng, mode, &prior, ratio);
        let errors = unmodelled
            .iter()
            .map(|set| set.iter().map(|e| share * e + 0.15e-3 * normal3(&mut rng)).collect())
            .collect();
        modes.push(mode_outcome(mode, estimate.robot.clone(), Some(estimate), errors));
    }
    Outcome {
        input: InputSummary {
            kind: "scenario",
            name: "spray painting robot".to_owned(),
            sha256: "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08".to_owned(),
            seed: Some(42),
            trial: Some((0, PlantKind::Rapier)),
        },
        sources: vec![("scenario".to_owned(), InputText::new("scenarios/spray painting.toml", ""))],
        model,
        visuals: Vec::new(),
        registration: RegistrationSummary {
            how: "best fit of the nominal robot to the identification poses".to_owned(),
            poses: 60,
            rms,
        },
        sets,
        as_measured: Vec::new(),
        drift: Vec::new(),
        missing: Vec::new(),
        places: Vec::new(),
        modes,
        truth: Some(Truth {
            as_built: AsBuilt {
                kinematics: as_built,
                actuators: ActuatorMap::Direct,
                statics: statics(),
                target,
                effects: Effects::default(),
            },
            stations: vec![tracker_from_base],
            instrument: Vec::new(),
            further_targets: Vec::new(),
            payloads: Vec::new(),
            orientation: None,
            poses: Vec::new(),
            effects: Vec::new(),
            outliers: Vec::new(),
            rigid: Vec::new(),
        }),
        bounds: Vec::new(),
        published: PUBLISHED.to_vec(),
        judgements: Vec::new(),
        sensors: None,
        ablation: None,
        splits: None,
        closed_loop: None,
        command: None,
    }
}

/// A simulated robot with the contributions of three parts: one without which every error is half as large, one that changes nothing, one
/// without which the run fails.
pub(in crate::report) fn ablated() -> Outcome {
    let mut outcome = simulated();
    let complete: AblationRows = outcome.modes.iter().map(|mode| mode.rows.clone()).collect();
    let mut halved = complete.clone();
    for row in halved.iter_mut().flatten().flatten() {
        row.mean *= 0.5;
        row.rms_3d *= 0.5;
    }
    outcome.ablation = Some(Ablation {
        modes: outcome.modes.iter().map(|mode| mode.mode).collect(),
        sets: outcome.sets.iter().map(|set| set.kind).collect(),
        parts: vec![
            AblatedPart {
                part: Part::Bearings,
                rows: Ok(complete.clone()),
                doubtful: vec![Mode::WithGravity],
            },
            AblatedPart { part: Part::Effect(EffectKind::Rail), rows: Ok(halved), doubtful: Vec::new() },
            AblatedPart {
                part: Part::Effect(EffectKind::Backlash),
                rows: Err("not at rest\x07".to_owned()),
                doubtful: Vec::new(),
            },
        ],
        complete,
    });
    outcome
}

/// A real robot: no truth, no verification set, no gravity mode, rank-deficient, readings without stated noise, hostile names, and
/// numbers that are not finite where they may occur.
pub(in crate::report) fn measured() -> Outcome {
    let mut outcome = simulated();
    outcome.truth = None;
    outcome.published.clear();
    outcome.input = InputSummary {
        kind: "files",
        name: HOSTILE.to_owned(),
        sha256: "00".repeat(32),
        seed: None,
        trial: None,
    };
    outcome.sources = vec![
        ("robot".to_owned(), InputText::new(format!("{HOSTILE}.toml"), "")),
        ("identification".to_owned(), InputText::new("grid.csv", "")),
    ];
    outcome.command = Some(format!(
        "calibrig identify --model {} --measurements grid.csv --out DIR",
        crate::report::quoted(&format!("{HOSTILE}.toml"))
    ));
    outcome.registration.how = format!("best fit {HOSTILE}");
    outcome.registration.rms = f64::NAN;
    outcome.sets.truncate(1);
    outcome.sets[0].dropped = vec![(7, HOSTILE.to_owned())];
    outcome.sets[0].measurements.targets[0].name = HOSTILE.to_owned();
    outcome.modes.truncate(2);
    for mode in &mut outcome.modes {
        mode.errors.truncate(1);
        mode.rows.truncate(1);
    }
    if let Some(estimate) = &mut outcome.modes[1].estimate {
        for parameter in &mut estimate.parameters {
            parameter.sigma = None;
        }
        let group = DependentGroup {
            redundant: ParameterId::link(5, LinkTerm::D),
            with: vec![(ParameterId::link(4, LinkTerm::D), 1.0)],
            singular_value: 0.0,
        };
        estimate.covariance = None;
        estimate.noise = NoiseScale::Residuals(0.31e-3);
        estimate.spectrum.rank -= 1;
        estimate.spectrum.condition = f64::INFINITY;
        estimate.spectrum.dependent = vec![group];
        estimate.warnings = vec![Warning::RankDeficient {
            rank: estimate.spectrum.rank,
            parameters: estimate.parameters.len(),
            groups: vec![format!("delta_d6 and delta_d5 {HOSTILE}")],
        }];
    }
    outcome
}

fn nominal() -> KinematicModel {
    use JointKind::{Prismatic, Revolute};
    let right = std::f64::consts::FRAC_PI_2;
    let link = |name: &str, kind, a, alpha, d| CraigLink {
        name: name.to_owned(),
        kind,
        a,
        alpha,
        beta: 0.0,
        d,
        theta: 0.0,
        limits: [-3.0, 4.0],
    };
    KinematicModel {
        links: vec![
            link("rail", Prismatic, 0.0, 0.0, 0.0),
            link("waist", Revolute, 0.0, -right, 0.626),
            link("shoulder", Revolute, 0.25, -right, 0.0),
            link("elbow", Revolute, 1.35, 0.0, 0.0),
            link("forearm", Prismatic, 0.246, -right, 0.0),
            link("roll", Revolute, 0.0, 0.0, 0.0),
            link("wrist", Revolute, 0.0, right, 0.0),
        ],
        base_from_first: Transform::identity(),
        last_from_flange: Transform::identity(),
    }
}

fn statics() -> StaticProperties {
    let body = Body { mass: 100.0, centre_of_mass: Vector3::zeros(), inertia: Matrix3::identity() };
    StaticProperties::of_drives(vec![body; 7], vec![1e6; 7], Vector3::new(0.0, -9.81, 0.0))
}

fn draw_command(rng: &mut ChaCha8Rng) -> Vec<f64> {
    const CENTRE: [f64; 7] = [2.0, 0.19, -1.71, 0.12, 2.0, -0.16, -0.77];
    const HALF_WIDTH: [f64; 7] = [1.92, 0.39, 0.31, 0.20, 0.30, 1.18, 0.57];
    CENTRE.iter().zip(HALF_WIDTH).map(|(c, w)| c + w * rng.random_range(-1.0..1.0)).collect()
}

/// What stands for everything that the models leave out, m.
fn sag(command: &[f64]) -> Vector3<f64> {
    let (lean, reach) = (command[2] + 1.57, command[4] - 2.0);
    Vector3::new(
        1.4e-3 * (3.0 * lean).sin(),
        0.7e-3 * (lean + 2.0 * reach).cos() - 0.5e-3,
        0.9e-3 * (1.3 * command[5]).sin(),
    )
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    rng.sample(StandardNormal)
}

fn normal3(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| normal(rng))
}

fn transformed(a_from_b: &Transform, point: &Vector3<f64>) -> Vector3<f64> {
    a_from_b.rotation * point + a_from_b.translation.vector
}

fn observation(pose: u32, command: Vec<f64>, position: Vector3<f64>) -> Observation {
    Observation {
        pose,
        approach: vec![1; command.len()],
        since_reversal: Vec::new(),
        command,
        temperature: Some(20.0),
        time: f64::from(pose) * 12.0,
        station: 0,
        target: 0,
        payload: None,
        reading: Reading::Cartesian { position, covariance: Some(Matrix3::identity() * 9e-10) },
    }
}

fn measurements(observations: Vec<Observation>, target: &str) -> MeasurementSet {
    MeasurementSet {
        stations: vec![Station { name: "T1".to_owned(), ..Station::default() }],
        targets: vec![Target {
            orientation: None,
            name: target.to_owned(),
            in_flange: Vector3::from(STATED_TARGET),
            covariance: None,
        }],
        observations,
    }
}

fn model_of(kinematics: KinematicModel) -> CalibrationModel {
    CalibrationModel {
        kinematics,
        actuators: ActuatorMap::Direct,
        statics: Some(statics()),
        motor_turns: vec![None; 7],
        spans: Vec::new(),
    }
}

/// The nominal robot under the best-fit station, and the RMS of the fit.
fn registered(model: &CalibrationModel, set: &MeasurementSet) -> (CalibratedRobot, f64) {
    let target = Vector3::from(STATED_TARGET);
    let seen: Vec<_> = set.observations.iter().map(|o| o.reading.position()).collect();
    let predicted: Vec<_> = set
        .observations
        .iter()
        .map(|o| target_in_base(&model.kinematics, &o.command, &target).expect("seven joints"))
        .collect();
    let station = best_fit_transform(&seen, &predicted).expect("poses in general position");
    let squares: f64 =
        seen.iter().zip(&predicted).map(|(s, p)| (s - transformed(&station, p)).norm_squared()).sum();
    let robot = CalibratedRobot {
        instruments: Vec::new(),
        mode: Mode::WithoutCalibration,
        nominal: model.clone(),
        model: model.clone(),
        terms: Vec::new(),
        stations: vec![station],
        targets: vec![target],
        orientations: vec![None],
    };
    (robot, (squares / seen.len() as f64).sqrt())
}

fn mode_outcome(
    mode: Mode,
    robot: CalibratedRobot,
    estimate: Option<Estimate>,
    errors: Vec<Vec<Vector3<f64>>>,
) -> ModeOutcome {
    let rows = errors.iter().map(|e| accuracy(e)).collect();
    let turns = errors.iter().map(|errors| vec![None; errors.len()]).collect();
    ModeOutcome { mode, robot, estimate, errors, rows, turns }
}

/// What the parameters of the sample really are.
fn simulated_truths() -> Vec<(ParameterId, f64)> {
    let mut truths: Vec<(ParameterId, f64)> = Vec::new();
    for (link, row) in DEVIATIONS.iter().enumerate() {
        let terms = LinkTerm::ALL.into_iter().zip(row).filter(|(_, value)| **value != 0.0);
        truths.extend(terms.map(|(term, value)| (ParameterId::link(link, term), *value)));
    }
    truths.extend(ParameterId::all_of_frame(0).into_iter().zip(TRUE_FRAME));
    truths.extend(ParameterId::all_of_target(0).into_iter().zip(TARGET_ERROR));
    truths
}

fn simulated_estimate(rng: &mut ChaCha8Rng, mode: Mode, prior: &Transform, ratio: f64) -> Estimate {
    let truths = simulated_truths();
    let parameters: Vec<_> = truths
        .iter()
        .map(|(id, truth)| {
            let scale = rng.random_range(0.3..2.0);
            let sigma = scale
                * match id.unit() {
                    Unit::Metre => 4e-5,
                    Unit::Radian => 2.5e-5,
                    Unit::One => 1e-2,
                };
            // Unmodelled effects pull the estimates further than the stated noise does.
            ParameterEstimate {
                id: *id,
                value: truth + 1.6 * sigma * normal(rng),
                sigma: Some(sigma),
                stated_sigma: None,
                prior_sigma: None,
            }
        })
        .collect();
    let value = |id| parameters.iter().find(|p| p.id == id).map_or(0.0, |p| p.value);
    let xi = Vector6::from_iterator(ParameterId::all_of_frame(0).into_iter().map(value));
    let mut kinematics = nominal();
    for parameter in &parameters {
        kinematics.add(parameter.id, parameter.value);
    }
    let n = parameters.len();
    let degrees_of_freedom = (3 * 60 + 9 - n) as f64;
    let weak = WeakDirection {
        singular_value: 1.9e-3,
        members: vec![
            (ParameterId::link(1, LinkTerm::D), 0.71),
            (ParameterId::link(2, LinkTerm::Alpha), -0.58),
            (ParameterId::link(3, LinkTerm::D), 0.31),
        ],
    };
    let warnings = vec![
        Warning::Weak {
            singular_value: weak.singular_value,
            direction: "0.71 delta_d2 - 0.58 delta_alpha3 + 0.31 delta_d4".to_owned(),
        },
        Warning::Inconsistent { ratio, accounted: false },
    ];
    let iteration = |parameters: &[ParameterEstimate]| IterationRecord {
        cost: 1.0,
        damping: 1e-3,
        step: 1e-6,
        gain: 1.0,
        accepted: true,
        parameters: parameters.iter().map(|p| p.value).collect(),
    };
    Estimate {
        robot: CalibratedRobot {
            instruments: Vec::new(),
            mode,
            nominal: model_of(nominal()),
            model: model_of(kinematics),
            terms: Vec::new(),
            stations: vec![prior * small_displacement(&xi)],
            orientations: Vec::new(),
            targets: vec![
                Vector3::from(STATED_TARGET)
                    + Vector3::from_iterator(ParameterId::all_of_target(0).into_iter().map(value)),
            ],
        },
        covariance: Some(DMatrix::identity(n, n)),
        factor: Some(DMatrix::identity(n, n)),
        weights: Vec::new(),
        weight_unit: 1.0,
        assumptions: Vec::new(),
        noise: NoiseScale::Stated,
        machine_noise: Vec::new(),
        reading_scale: None,
        turn_noise: None,
        interval_freedom: None,
        chi2: ratio * ratio * degrees_of_freedom,
        degrees_of_freedom,
        termination: TerminationReason::SmallStep,
        iterations: vec![iteration(&parameters); 5],
        spectrum: Spectrum {
            rank: n,
            condition: 526.3,
            singular_values: (0..n).map(|i| 526.3_f64.powf(-(i as f64) / (n - 1) as f64)).collect(),
            weak: vec![weak],
            dependent: Vec::new(),
        },
        held: Vec::new(),
        left_out: Vec::new(),
        fixed: Vec::new(),
        bounds: Vec::new(),
        at_bound: Vec::new(),
        contradicted: Vec::new(),
        outliers: Vec::new(),
        warnings,
        parameters,
    }
}
