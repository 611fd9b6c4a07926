//! Which effects of the machine have a form that the estimator's model contains: what each displaces the target by over 1000 poses of the paper's region,
//! against all that the model's parameters and terms can do there.

use nalgebra::{DMatrix, DVector, Vector3};

use calibrig::elastostatics::{Deflection, ElasticChain};
use calibrig::measurement::Observation;
use calibrig::model::{CalibrationModel, FAMILIES, ParameterId, PoseQuery, TermId};
use calibrig::pipeline::{PlantKind, simulate};
use calibrig::plant::effects::{
    Ambient, DriveHeat, Effects, Encoder, Friction, GrowingPart, Growth, Harmonic, Harmonics, LostMotion,
    Rail, RailProfile, Ratio, Repeatability, Stiffening, StiffnessCurve, Thermal, Transmission,
    TransmissionWave,
};
use calibrig::plant::{AsBuilt, SettledPose};
use calibrig::scenario::Scenario;

use crate::a_user_reproduces_the_paper::paper;

const POSES: u32 = 1000;
/// Of the displacement's root mean square, what the model must be unable to follow in an effect that is called unmodelled.
const UNMODELLED: f64 = 0.2;

/// Whether the model can follow it at these poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    Contained,
    Unmodelled,
}

/// What the poses displace the target by, and the poses.
struct Session {
    targets: Vec<Vector3<f64>>,
    observations: Vec<Observation>,
    settled: Vec<SettledPose>,
}

/// The paper's machine, with these effects alone, in 1000 of its poses.
fn session(effects: Effects) -> (Scenario, Session) {
    let mut scenario = Scenario { identification_poses: POSES, verification_poses: 0, ..paper() };
    scenario.as_built.effects = effects;
    scenario.tracker.instrument.noise = false;
    let simulation = simulate(&scenario, 1, 0, PlantKind::Rapier, |_, _| {}).expect("a session");
    let settled = simulation.truth.poses.into_iter().next().expect("a set");
    let observations = simulation.sets.into_iter().next().expect("a set").measurements.observations;
    assert_eq!((settled.len(), observations.len()), (POSES as usize, POSES as usize), "all were seen");
    let targets = settled.iter().map(|pose| pose.target).collect();
    (scenario, Session { targets, observations, settled })
}

/// An orthonormal basis of all that the model can do to the target, linearised at the machine without effects: the placement of the base, the target's
/// offset, every parameter of links, springs, masses and four-bar, and every term of the registry. One column a dimension.
fn span(machine: &AsBuilt, nominal: &CalibrationModel, session: &Session) -> DMatrix<f64> {
    let model = CalibrationModel {
        kinematics: machine.kinematics.clone(),
        actuators: machine.actuators.clone(),
        statics: Some(machine.statics.clone()),
        motor_turns: nominal.motor_turns.clone(),
    };
    let joints = model.kinematics.joint_count();
    let mut parameters = ParameterId::all_of_links(joints);
    parameters.extend(model.compliances().into_iter().map(ParameterId::Compliance));
    parameters.extend(model.linkage_lengths().into_iter().map(ParameterId::Linkage));
    for link in 0..joints {
        parameters.push(ParameterId::Mass { link });
        parameters.extend((0..3).map(|axis| ParameterId::Centre { link, axis }));
    }
    let terms: Vec<TermId> =
        FAMILIES.iter().flat_map(|family| TermId::all_of(family.key(), &model).expect("a family")).collect();
    let mut chain = ElasticChain::new(&model).expect("a robot");
    let columns = 9 + parameters.len() + terms.len();
    let mut jacobian = DMatrix::zeros(3 * session.observations.len(), columns);
    for (pose, observation) in session.observations.iter().enumerate() {
        chain.settle(&observation.command, &[], Deflection::Equilibrium).expect("a stiff robot");
        let target = chain.target(&machine.target);
        chain.prepare(&machine.target).expect("a place");
        let query = PoseQuery {
            command: &observation.command,
            approach: &observation.approach,
            temperature: observation.temperature,
            time: observation.time,
            ..PoseQuery::at(&observation.command)
        };
        let mut all: Vec<Vector3<f64>> = Vec::with_capacity(columns);
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
        all.extend(axes);
        all.extend(axes.map(|axis| axis.cross(&target)));
        all.extend(axes.map(|axis| chain.base_from_flange().rotation * axis));
        all.extend(parameters.iter().map(|id| chain.column(*id).expect("a parameter of the robot")));
        all.extend(terms.iter().map(|term| {
            chain.column_of_place(term.place()).expect("a place of the robot") * term.basis(&model, &query)
        }));
        for (column, displacement) in all.iter().enumerate() {
            jacobian.fixed_view_mut::<3, 1>(3 * pose, column).copy_from(displacement);
        }
    }
    for mut column in jacobian.column_iter_mut() {
        let norm = column.norm();
        if norm > 0.0 {
            column /= norm;
        }
    }
    let decomposed = jacobian.col_piv_qr();
    let r = decomposed.r();
    let rank = (0..columns).filter(|i| r[(*i, *i)].abs() > 1e-9).count();
    println!("{columns} columns, {} of them terms, rank {rank}", terms.len());
    decomposed.q().columns(0, rank).into_owned()
}

/// What an effect displaces the target by, and what of it no parameter follows: root mean squares of lengths, m.
fn displaced(span: &DMatrix<f64>, with: &Session, without: &Session) -> (f64, f64) {
    let shift = DVector::from_iterator(
        3 * with.targets.len(),
        with.targets.iter().zip(&without.targets).flat_map(|(with, without)| {
            let shift = with - without;
            [shift.x, shift.y, shift.z]
        }),
    );
    let outside = &shift - span * span.tr_mul(&shift);
    let mean = |v: &DVector<f64>| v.norm() / (with.targets.len() as f64).sqrt();
    (mean(&shift), mean(&outside))
}

const ARCSEC: f64 = std::f64::consts::PI / 648_000.0;
const REV: f64 = std::f64::consts::TAU;

fn of_joints(values: &[(usize, f64)]) -> Vec<f64> {
    (0..7).map(|joint| values.iter().find(|(at, _)| *at == joint).map_or(0.0, |(_, value)| *value)).collect()
}

/// Every form that a machine can have, alone.
fn forms(scenario: &Scenario, without: &Session) -> Vec<(&'static str, Form, Effects)> {
    let shipped = paper().as_built.effects;
    let none = Effects::default;
    let waves = |own: &[(usize, TransmissionWave)]| {
        let of = |joint| own.iter().filter(move |(at, _)| *at == joint).map(|(_, wave)| *wave);
        let actuators = (0..7).map(|joint| of(joint).collect()).collect();
        Effects { transmission: Some(Transmission { actuators }), ..none() }
    };
    let wave = |cycles, amplitude, per_load| TransmissionWave { cycles, amplitude, per_load, phase: 0.4 };
    let shipped_rail = shipped.rail.clone().expect("a rail");
    let profiles = |change: &dyn Fn(&RailProfile) -> RailProfile| {
        let rail = &shipped_rail;
        let rail = Rail {
            horizontal_error: change(&rail.horizontal_error),
            vertical_error: change(&rail.vertical_error),
            roll: change(&rail.roll),
            pitch: change(&rail.pitch),
            yaw: change(&rail.yaw),
            ..rail.clone()
        };
        Effects { rail: Some(rail), ..none() }
    };
    let turns = &scenario.robot.model.motor_turns;
    let harmonic = |joint: usize, factor: f64| {
        let turns = factor * turns[joint].expect("known");
        Some(Harmonic { turns, amplitude: [60.0 * ARCSEC, 20.0 * ARCSEC], phase: [0.3, 1.1] })
    };
    let harmonics = |factor: f64| {
        let actuators =
            (0..7).map(|joint| matches!(joint, 1..=3).then(|| harmonic(joint, factor))?).collect();
        Effects { harmonics: Some(Harmonics { actuators }), ..none() }
    };
    let loads: Vec<Vec<f64>> = without.settled.iter().map(|p| scenario.as_built.drive_loads(p)).collect();
    let mean_load = |joint: usize| loads.iter().map(|l| l[joint].abs()).sum::<f64>() / loads.len() as f64;
    for joint in 0..7 {
        let ends = loads.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], l| {
            [low.min(l[joint]), high.max(l[joint])]
        });
        println!("load of drive {}: {:.0} to {:.0} N or N m", joint + 1, ends[0], ends[1]);
    }
    let lost_motion = |joint: usize| {
        let [gap, friction, closes_at] = [60.0 * ARCSEC, 0.3 * mean_load(joint), mean_load(joint)]
            .map(|value| of_joints(&[(joint, value)]));
        Effects { lost_motion: Some(LostMotion { gap, friction, closes_at }), ..none() }
    };
    let stiffening = |joint: usize| {
        let mut actuators = vec![None; 7];
        let limits = vec![0.5 * mean_load(joint), mean_load(joint)];
        actuators[joint] = Some(StiffnessCurve { factors: vec![0.7, 1.0, 1.3], limits });
        Effects { stiffening: Some(Stiffening { actuators }), ..none() }
    };
    let thermal = |ambient: Ambient, heat: Option<DriveHeat>, lag: f64| {
        let part = GrowingPart::Link { joint: 2, axis: 0 };
        let growth = Growth { part, length: 1.35, with_travel: false, expansion: 11.5e-6, lag, heat };
        Effects { thermal: Some(Thermal { ambient, reference: 20.0, growths: vec![growth] }), ..none() }
    };
    let still = Ambient { start: 20.0, drift: 0.0, swing: 0.0, period: 1.0, phase: 0.0 };
    let warming = Ambient { drift: 4.0 / 3600.0, swing: 1.5, period: 1500.0, ..still };
    let powered = DriveHeat { actuator: 3, power: 60.0, per_motion: 0.0, resistance: 0.3 };
    let moved = DriveHeat { power: 0.0, per_motion: 900.0, ..powered };
    vec![
        (
            "ratio",
            Form::Contained,
            Effects { ratio: Some(Ratio { relative: of_joints(&[(0, 2.5e-4), (4, -3e-4)]) }), ..none() },
        ),
        ("harmonics, turns as stated", Form::Contained, harmonics(1.0)),
        ("backlash", Form::Contained, Effects { backlash: shipped.backlash.clone(), ..none() }),
        ("rail, its polynomials", Form::Contained, profiles(&|own| RailProfile { wave: 0.0, ..own.clone() })),
        (
            "encoder, its offsets",
            Form::Contained,
            Effects { encoder: Some(Encoder { step: vec![0.0; 7], offset: vec![1e-4; 7] }), ..none() },
        ),
        ("harmonics, 3 % more turns", Form::Unmodelled, harmonics(1.03)),
        (
            "transmission, cycloid pins",
            Form::Unmodelled,
            waves(&[(2, wave(40.0 / REV, 10.0 * ARCSEC, 0.0)), (3, wave(40.0 / REV, 10.0 * ARCSEC, 0.0))]),
        ),
        (
            "transmission, not of a turn",
            Form::Unmodelled,
            waves(&[(3, wave(27.5 / REV, 10.0 * ARCSEC, 0.0))]),
        ),
        ("transmission, screw's lead", Form::Unmodelled, waves(&[(4, wave(50.0, 3e-5, 0.0))])),
        (
            "transmission, by the load",
            Form::Unmodelled,
            waves(&[(2, wave(40.0 / REV, 0.0, 5.0 * ARCSEC / 1e3))]),
        ),
        ("lost motion of the shoulder", Form::Unmodelled, lost_motion(2)),
        // Its load is always beyond what closes the gap, and nearly always the same: one flank, one secant.
        ("lost motion of the elbow", Form::Contained, lost_motion(3)),
        ("friction", Form::Unmodelled, Effects { friction: shipped.friction.clone(), ..none() }),
        (
            "friction, short motions",
            Form::Unmodelled,
            Effects {
                friction: Some(Friction {
                    constant: of_joints(&[(2, 60.0), (3, 60.0)]),
                    per_load: vec![0.0; 7],
                    presliding: of_joints(&[(2, 0.2), (3, 0.2)]),
                }),
                ..none()
            },
        ),
        ("stiffening of the shoulder", Form::Unmodelled, stiffening(2)),
        ("stiffening of the elbow", Form::Contained, stiffening(3)),
        ("stiffening of the roll", Form::Unmodelled, stiffening(5)),
        (
            "rail, its waves",
            Form::Unmodelled,
            profiles(&|own| RailProfile { polynomial: Vec::new(), ..own.clone() }),
        ),
        ("thermal, the air", Form::Unmodelled, thermal(warming, None, 300.0)),
        ("thermal, a drive at power", Form::Unmodelled, thermal(still, Some(powered), 2400.0)),
        ("thermal, a drive by its motion", Form::Unmodelled, thermal(still, Some(moved), 1200.0)),
        (
            "encoder, its steps",
            Form::Unmodelled,
            Effects {
                encoder: Some(Encoder { step: of_joints(&[(0, 1e-5), (4, 1e-5)]), offset: vec![0.0; 7] }),
                ..none()
            },
        ),
        (
            "repeatability",
            Form::Unmodelled,
            Effects {
                repeatability: Some(Repeatability {
                    sigma: shipped.repeatability.clone().expect("some").sigma,
                }),
                ..none()
            },
        ),
    ]
}

#[test]
fn unmodelled_effects_share_no_form_with_the_model() {
    let (scenario, without) = session(Effects::default());
    let span = span(&scenario.as_built, &scenario.robot.model, &without);
    let mut wrong = Vec::new();
    println!("{:32} {:>10} {:>10} {:>8}", "effect", "um", "outside", "share");
    for (name, form, effects) in forms(&scenario, &without) {
        let (shift, outside) = displaced(&span, &session(effects).1, &without);
        let share = outside / shift;
        println!("{name:32} {:10.2} {:10.2} {:7.1} % {form:?}", 1e6 * shift, 1e6 * outside, 100.0 * share);
        if (share >= UNMODELLED) != (form == Form::Unmodelled) {
            wrong.push(format!("{name}: {share:.3} is no {form:?}"));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}
