//! Which effects of the machine have a form that the estimator's model contains: what each displaces the target by over 1000 poses of the paper's region,
//! against all that the model's parameters and terms can do there.

use nalgebra::{DMatrix, DVector, Vector3};

use calibrig::elastostatics::{Deflection, ElasticChain};
use calibrig::measurement::{MeasurementSet, Observation};
use calibrig::model::{CalibrationModel, FAMILIES, ParameterId, PoseQuery, TermId};
use calibrig::pipeline::{PlantKind, simulate};
use calibrig::plant::effects::{
    Ambient, Anchor, DriveHeat, Effects, Encoder, Foundation, Friction, GrowingPart, Growth, Harmonic,
    Harmonics, Hose, Hoses, LostMotion, Rail, RailProfile, RailSpan, Ratio, Stiffening, StiffnessCurve,
    Thermal, Transmission, TransmissionWave,
};
use calibrig::plant::{AsBuilt, SettledPose};
use calibrig::scenario::Scenario;

use self::Form::{Contained, Smooth, Unmodelled};
use crate::a_user_reproduces_the_paper::{paper, with_poses};

const POSES: u32 = 1000;
/// Of the displacement's root mean square, what the model must be unable to follow in an effect that is called unmodelled.
const UNMODELLED: f64 = 0.2;

/// Whether the model can follow it at these poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    /// By links, springs, masses, four-bar and the terms that are formulas.
    Contained,
    /// By smooth terms, which are fitted on request, and where the poses span little.
    Smooth,
    /// By nothing.
    Unmodelled,
}

/// Families of terms without a formula.
const SMOOTH: [&str; 2] = ["spline", "presliding"];

/// What the poses displace the target by, and the poses.
struct Session {
    targets: Vec<Vector3<f64>>,
    observations: Vec<Observation>,
    settled: Vec<SettledPose>,
}

/// The paper's machine, with these effects alone, in 1000 of its poses.
fn session(effects: Effects) -> (Scenario, Session) {
    let mut scenario = Scenario { verification_poses: 0, ..with_poses(paper(), POSES) };
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
/// offset, every parameter of links, springs, masses and four-bar, and every term of the families. One column a dimension.
fn span(machine: &AsBuilt, nominal: &CalibrationModel, session: &Session, families: &[&str]) -> DMatrix<f64> {
    let model = CalibrationModel {
        kinematics: machine.kinematics.clone(),
        actuators: machine.actuators.clone(),
        statics: Some(machine.statics.clone()),
        motor_turns: nominal.motor_turns.clone(),
        spans: MeasurementSet { observations: session.observations.clone(), ..MeasurementSet::default() }
            .spans(),
    };
    let joints = model.kinematics.joint_count();
    let mut parameters = ParameterId::all_of_links(joints);
    parameters.extend(model.compliances().into_iter().map(ParameterId::Compliance));
    parameters.extend(model.linkage_terms().into_iter().map(ParameterId::Linkage));
    for link in 0..joints {
        parameters.push(ParameterId::Mass { link });
        parameters.extend((0..3).map(|axis| ParameterId::Centre { link, axis }));
    }
    let terms: Vec<TermId> =
        families.iter().flat_map(|key| TermId::all_of(key, &model).expect("a family")).collect();
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
            since_reversal: &observation.since_reversal,
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

type Named = (&'static str, Form, Effects);

fn none() -> Effects {
    Effects::default()
}

fn waves(own: &[(usize, TransmissionWave)]) -> Effects {
    let of = |joint| own.iter().filter(move |(at, _)| *at == joint).map(|(_, wave)| *wave);
    let actuators = (0..7).map(|joint| of(joint).collect()).collect();
    Effects { transmission: Some(Transmission { actuators }), ..none() }
}

fn wave(cycles: f64, amplitude: f64, per_load: f64) -> TransmissionWave {
    TransmissionWave { cycles, amplitude, per_load, phase: 0.4 }
}

fn rail(shipped: &Rail, change: impl Fn(&RailProfile) -> RailProfile) -> Effects {
    let rail = Rail {
        horizontal_error: change(&shipped.horizontal_error),
        vertical_error: change(&shipped.vertical_error),
        roll: change(&shipped.roll),
        pitch: change(&shipped.pitch),
        yaw: change(&shipped.yaw),
        ..shipped.clone()
    };
    Effects { rail: Some(rail), ..none() }
}

/// Of waist, shoulder and elbow, with so many times the motor turns that are stated.
fn harmonics(stated: &[Option<f64>], factor: f64) -> Effects {
    let harmonic = |turns: f64| Harmonic {
        turns: factor * turns,
        amplitude: [60.0 * ARCSEC, 20.0 * ARCSEC],
        phase: [0.3, 1.1],
    };
    let of = |joint: usize| matches!(joint, 1..=3).then(|| stated[joint].map(harmonic)).flatten();
    Effects { harmonics: Some(Harmonics { actuators: (0..7).map(of).collect() }), ..none() }
}

/// Between 0.3 and 1 of the drive's mean load.
fn lost_motion(joint: usize, mean: f64) -> Effects {
    let [gap, friction, closes_at] =
        [60.0 * ARCSEC, 0.3 * mean, mean].map(|value| of_joints(&[(joint, value)]));
    Effects { lost_motion: Some(LostMotion { gap, friction, closes_at }), ..none() }
}

/// Ranges that end at 0.5 and 1 of the drive's mean load.
fn stiffening(joint: usize, mean: f64) -> Effects {
    let mut actuators = vec![None; 7];
    actuators[joint] = Some(StiffnessCurve { factors: vec![0.7, 1.0, 1.3], limits: vec![0.5 * mean, mean] });
    Effects { stiffening: Some(Stiffening { actuators }), ..none() }
}

/// The upper arm.
fn thermal(ambient: Ambient, heat: Option<DriveHeat>, lag: f64) -> Effects {
    let part = GrowingPart::Link { joint: 2, axis: 0 };
    let growth = Growth { part, length: 1.35, with_travel: false, expansion: 11.5e-6, lag, heat };
    Effects { thermal: Some(Thermal { ambient, reference: 20.0, growths: vec![growth] }), ..none() }
}

/// What the shape of the command alone decides.
fn of_the_command(scenario: &Scenario) -> Vec<Named> {
    let shipped = &scenario_effects();
    let turns = &scenario.robot.model.motor_turns;
    let along = shipped.rail.as_ref().expect("a rail");
    let ratio = Ratio { relative: of_joints(&[(0, 2.5e-4), (4, -3e-4)]) };
    let offsets = Encoder { step: vec![0.0; 7], offset: vec![1e-4; 7] };
    let steps = Encoder { step: of_joints(&[(0, 1e-5), (4, 1e-5)]), offset: vec![0.0; 7] };
    let pins = wave(40.0 / REV, 10.0 * ARCSEC, 0.0);
    let smooth = |own: &RailProfile| RailProfile { wave: 0.0, ..own.clone() };
    let wavy = |own: &RailProfile| RailProfile { polynomial: Vec::new(), ..own.clone() };
    vec![
        ("ratio", Contained, Effects { ratio: Some(ratio), ..none() }),
        ("harmonics, turns as stated", Contained, harmonics(turns, 1.0)),
        ("rail, its polynomials", Contained, rail(along, smooth)),
        ("encoder, its offsets", Contained, Effects { encoder: Some(offsets), ..none() }),
        ("harmonics, 3 % more turns", Unmodelled, harmonics(turns, 1.03)),
        ("transmission, cycloid pins", Smooth, waves(&[(2, pins), (3, pins)])),
        ("transmission, not of a turn", Smooth, waves(&[(3, wave(27.5 / REV, 10.0 * ARCSEC, 0.0))])),
        ("transmission, screw's lead", Unmodelled, waves(&[(4, wave(50.0, 3e-5, 0.0))])),
        ("rail, its waves", Unmodelled, rail(along, wavy)),
        ("encoder, its steps", Unmodelled, Effects { encoder: Some(steps), ..none() }),
    ]
}

/// What depends on loads, on the way to a pose, or on time.
fn of_load_way_and_time(scenario: &Scenario, without: &Session) -> Vec<Named> {
    let shipped = &scenario_effects();
    let loads: Vec<Vec<f64>> = without.settled.iter().map(|p| scenario.as_built.drive_loads(p)).collect();
    let mean = |joint: usize| loads.iter().map(|l| l[joint].abs()).sum::<f64>() / loads.len() as f64;
    for joint in 0..7 {
        let of_joint = || loads.iter().map(|l| l[joint]);
        let (low, high) = (of_joint().fold(f64::INFINITY, f64::min), of_joint().fold(f64::MIN, f64::max));
        println!("load of drive {}: {low:.0} to {high:.0} N or N m", joint + 1);
    }
    let constant = of_joints(&[(2, 60.0), (3, 60.0)]);
    let short = Friction { constant, per_load: vec![0.0; 7], presliding: of_joints(&[(2, 0.2), (3, 0.2)]) };
    let still = Ambient { start: 20.0, drift: 0.0, swing: 0.0, period: 1.0, phase: 0.0 };
    let warming = Ambient { drift: 4.0 / 3600.0, swing: 1.5, period: 1500.0, ..still };
    let powered = DriveHeat { actuator: 3, power: 60.0, per_motion: 0.0, resistance: 0.3 };
    let moved = DriveHeat { power: 0.0, per_motion: 900.0, ..powered };
    let loaded = wave(40.0 / REV, 0.0, 5.0 * ARCSEC / 1e3);
    vec![
        ("backlash", Contained, Effects { backlash: shipped.backlash.clone(), ..none() }),
        ("transmission, by the load", Smooth, waves(&[(2, loaded)])),
        ("lost motion of the shoulder", Unmodelled, lost_motion(2, mean(2))),
        // Its load is always beyond what closes half of the gap, and nearly always the same: one flank, one secant.
        ("lost motion of the elbow", Contained, lost_motion(3, mean(3))),
        ("friction", Smooth, Effects { friction: shipped.friction.clone(), ..none() }),
        ("friction, short motions", Unmodelled, Effects { friction: Some(short), ..none() }),
        ("stiffening of the shoulder", Smooth, stiffening(2, mean(2))),
        ("stiffening of the elbow", Contained, stiffening(3, mean(3))),
        ("stiffening of the roll", Smooth, stiffening(5, mean(5))),
        ("thermal, the air", Unmodelled, thermal(warming, None, 300.0)),
        // After half an hour of warm-up most of it is the same at every pose.
        ("thermal, a drive at power", Contained, thermal(still, Some(powered), 2400.0)),
        ("thermal, a drive by its motion", Unmodelled, thermal(still, Some(moved), 1200.0)),
        ("floor and rail that yield", Unmodelled, Effects { foundation: Some(floor()), ..none() }),
        // Most of their pull is always the same, which masses and springs take up.
        ("hoses", Contained, Effects { hoses: Some(hose()), ..none() }),
        ("repeatability", Unmodelled, Effects { repeatability: shipped.repeatability.clone(), ..none() }),
    ]
}

/// Of concrete on soil, and a rail on feet a metre apart that bends by 20 um under half a tonne.
fn floor() -> Foundation {
    let rail = RailSpan { joint: 0, first_foot: 0.3, span: 1.0, compliance: [4e-9, 2e-9] };
    let stiffness = [2e9, 2e9, 2e9, 5e9, 5e9, 5e9];
    Foundation { at: Vector3::new(0.0, 0.0, 2.0), stiffness, rail: Some(rail) }
}

/// A dress pack from the upper arm to the roll, and a hose from the ceiling.
fn hose() -> Hoses {
    let anchor = |link, x, y, z| Anchor { link, at: Vector3::new(x, y, z) };
    let pack = Hose {
        ends: [anchor(Some(2), 0.6, 0.3, 0.0), anchor(Some(5), 0.0, 0.2, -0.2)],
        stiffness: 300.0,
        free_length: 0.8,
    };
    let ceiling = Hose {
        ends: [anchor(None, 4.0, 0.0, 2.0), anchor(Some(4), 0.0, 0.0, 0.0)],
        stiffness: 60.0,
        free_length: 1.0,
    };
    Hoses { hoses: vec![pack, ceiling] }
}

/// Those of the shipped scenario.
fn scenario_effects() -> Effects {
    paper().as_built.effects
}

#[test]
fn unmodelled_effects_share_no_form_with_the_model() {
    let (scenario, without) = session(Effects::default());
    let keys: Vec<&str> = FAMILIES.iter().map(|family| family.key()).collect();
    let formulas: Vec<&str> = keys.iter().copied().filter(|key| !SMOOTH.contains(key)).collect();
    let spans =
        [formulas, keys].map(|families| span(&scenario.as_built, &scenario.robot.model, &without, &families));
    let mut wrong = Vec::new();
    println!("{:32} {:>10} {:>10} {:>10}", "effect", "um", "formulas", "all");
    let all = of_the_command(&scenario).into_iter().chain(of_load_way_and_time(&scenario, &without));
    for (name, form, effects) in all {
        let with = session(effects).1;
        let [beyond_formulas, beyond_all] = spans.each_ref().map(|span| {
            let (shift, outside) = displaced(span, &with, &without);
            outside / shift
        });
        let shift = 1e6 * displaced(&spans[1], &with, &without).0;
        println!(
            "{name:32} {shift:10.2} {:8.1} % {:8.1} % {form:?}",
            100.0 * beyond_formulas,
            100.0 * beyond_all
        );
        let found = match [beyond_formulas, beyond_all].map(|share| share >= UNMODELLED) {
            [false, _] => Contained,
            [true, false] => Smooth,
            [true, true] => Unmodelled,
        };
        if found != form {
            wrong.push(format!("{name}: {beyond_formulas:.3} and {beyond_all:.3} are no {form:?}"));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}
