//! How many poses the plant settles a second on one core.
//!
//! Newton's method finds a pose, and a step of rapier confirms it unless the options say otherwise. The cases with every effect are poses as a
//! session takes them: settled at the command for the loads of the drives, then, confirmed or not, where the effects make of it.

// The functions that criterion generates have no docs; a bench may stop at its first error.
#![allow(missing_docs, clippy::expect_used)]

#[path = "../src/tests/spray_robot.rs"]
mod spray_robot;

use std::f64::consts::TAU;
use std::hint::black_box;

use calibrig_model::nalgebra::Vector3;
use calibrig_plant::effects::{
    Ambient, Anchor, Backlash, Commanded, DriveHeat, DriveState, EffectKind, Effects, Encoder, Foundation,
    Friction, GrowingPart, Growth, Harmonic, Harmonics, Hose, Hoses, LostMotion, Rail, RailProfile, RailSpan,
    Ratio, Repeatability, Stiffening, StiffnessCurve, Thermal, Transmission, TransmissionWave,
};
use calibrig_plant::session::Machine;
use calibrig_plant::{AsBuilt, Plant, SettleOptions, SettledPose};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use spray_robot::{add_errors, full_robot, spray_robot, working_command};

/// On a floor that yields, on a rail that bends, with a hose that pulls.
fn yielding(mut robot: AsBuilt) -> AsBuilt {
    let rail = RailSpan { joint: 0, first_foot: 0.0, span: 1.25, compliance: [1e-9, 2e-9] };
    let at = Vector3::new(0.0, 0.0, 2.0);
    robot.effects.foundation = Some(Foundation { at, stiffness: [4e8; 6], rail: Some(rail) });
    let ends = [Anchor { link: Some(1), at: Vector3::x() }, Anchor { link: Some(3), at: Vector3::y() }];
    let hose = Hose { ends, stiffness: 400.0, free_length: 0.3 };
    robot.effects.hoses = Some(Hoses { hoses: vec![hose] });
    robot
}

/// With all that a machine can do beside, sized like what data sheets state.
fn with_every_effect(robot: &AsBuilt) -> AsBuilt {
    let of_all = |value: f64| vec![value; 7];
    let wave = TransmissionWave { cycles: 12.7, amplitude: 2e-5, per_load: 1e-8, phase: 0.3 };
    let curve = StiffnessCurve { factors: vec![0.8, 1.0, 1.2], limits: vec![200.0, 800.0] };
    let profile = RailProfile { polynomial: vec![0.0, 1e-4, 2e-4], wave: 2e-5, phase: 0.2 };
    let heat = DriveHeat { actuator: 2, power: 30.0, per_motion: 100.0, resistance: 0.3 };
    let growth = |part, length| Growth {
        part,
        length,
        with_travel: false,
        expansion: 12e-6,
        lag: 3600.0,
        heat: Some(heat),
    };
    let mut machine = robot.clone();
    machine.effects = Effects {
        harmonics: Some(Harmonics {
            actuators: vec![
                Some(Harmonic { turns: 80.0 / TAU, amplitude: [3e-5, 1e-5], phase: [0.1, 1.0] });
                7
            ],
        }),
        transmission: Some(Transmission { actuators: vec![vec![wave; 2]; 7] }),
        ratio: Some(Ratio { relative: of_all(1e-5) }),
        rail: Some(Rail {
            joint: 0,
            range: [0.0, 4.0],
            wavelength: 0.5,
            vertical: Vector3::y(),
            horizontal_error: profile.clone(),
            vertical_error: profile.clone(),
            roll: profile.clone(),
            pitch: profile.clone(),
            yaw: profile,
        }),
        backlash: Some(Backlash { gap: of_all(5e-5) }),
        lost_motion: Some(LostMotion { gap: of_all(1e-4), friction: of_all(5.0), closes_at: of_all(20.0) }),
        friction: Some(Friction { constant: of_all(20.0), per_load: of_all(0.02), presliding: of_all(1e-2) }),
        stiffening: Some(Stiffening { actuators: vec![Some(curve); 7] }),
        encoder: Some(Encoder { step: of_all(1e-6), offset: of_all(1e-4) }),
        thermal: Some(Thermal {
            ambient: Ambient { start: 21.0, drift: 1e-4, swing: 1.0, period: 1800.0, phase: 0.0 },
            reference: 20.0,
            growths: vec![
                growth(GrowingPart::Link { joint: 2, axis: 0 }, 1.35),
                growth(GrowingPart::Rod, 0.0),
            ],
        }),
        repeatability: Some(Repeatability { sigma: of_all(1e-6) }),
        ..robot.effects.clone()
    };
    assert_eq!(machine.effects.active().len(), EffectKind::ALL.len(), "an effect is missing");
    machine.check_effects(1e4).expect("a machine");
    machine
}

/// A pose of a session: approached, and settled with what the effects make of the command under the loads of the drives.
fn approach(
    machine: &AsBuilt,
    plant: &mut Plant,
    drives: &mut DriveState,
    command: &[f64],
    rng: &mut ChaCha8Rng,
) -> SettledPose {
    let load = machine.drive_loads(&plant.pass(command).expect("a stiff robot"));
    let time = drives.warmth.time + 10.0;
    let (effects, state) = machine.pose_effects(drives, &Commanded { command, time, load: &load }, rng);
    *drives = state;
    plant.settle_displaced(&effects.command, &effects.displacements).expect("a stiff robot")
}

fn settle(criterion: &mut Criterion) {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut robot = spray_robot();
    add_errors(&mut robot, &mut rng);
    let mut whole = full_robot();
    add_errors(&mut whole, &mut rng);
    let mut rigid = robot.clone();
    rigid.statics.drive_stiffness.fill(f64::INFINITY);
    let yielding = yielding(whole.clone());
    let machine = with_every_effect(&yielding);

    let quick = SettleOptions { confirm: false, ..SettleOptions::default() };
    let usual = SettleOptions::default();
    let mut group = criterion.benchmark_group("plant");
    group.throughput(Throughput::Elements(1));
    let robots = [
        ("settle, elastic drives", &robot, usual),
        ("settle, rigid drives", &rigid, usual),
        ("settle, whole robot", &whole, usual),
        ("settle, whole robot, floor and hose", &yielding, usual),
        ("settle, whole robot, unconfirmed", &whole, quick),
        ("settle, whole robot, floor and hose, unconfirmed", &yielding, quick),
    ];
    for (name, robot, options) in robots {
        let mut plant = Plant::new(robot, options).expect("a sound robot");
        let commands: Vec<_> = (0..1000).map(|_| working_command(robot, &mut rng)).collect();
        let mut commands = commands.iter().cycle();
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                commands.next().map(|command| plant.settle(black_box(command)).expect("a stiff robot"))
            });
        });
    }
    for (name, options) in [("pose, every effect on", usual), ("pose, every effect on, unconfirmed", quick)] {
        let mut plant = Plant::new(&machine, options).expect("a sound robot");
        let commands: Vec<_> = (0..1000).map(|_| working_command(&machine, &mut rng)).collect();
        let mut drives = machine.referenced_at(&commands[0]);
        let mut commands = commands.iter().cycle();
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                let command = commands.next()?;
                Some(approach(&machine, &mut plant, &mut drives, black_box(command), &mut rng))
            });
        });
    }
    for (name, robot) in [("build", &robot), ("build, whole robot", &whole)] {
        group.bench_function(name, |bencher| {
            bencher.iter(|| Plant::new(black_box(robot), SettleOptions::default()).expect("a sound robot"));
        });
    }
    group.finish();
}

criterion_group!(benches, settle);
criterion_main!(benches);
