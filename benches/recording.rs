//! What recording costs a run of `scenarios/paper.toml`.
//!
//! `cargo bench --bench recording`

// A bench may stop at its first error.
#![allow(clippy::expect_used, clippy::cast_possible_truncation, clippy::disallowed_methods, missing_docs)]

use std::fs::File;
use std::io::BufWriter;
use std::ops::ControlFlow;
use std::path::Path;
use std::time::{Duration, Instant};

use calibrig::pipeline::{MeasuredPose, Outcome, PlantKind, SessionEvent, input_of, run_trial};
use calibrig::recording::{McapRecorder, Preamble, SessionRecorder};
use calibrig::report::write_reports;
use calibrig::scenario::load_scenario;

fn main() {
    let folder = tempfile::tempdir().expect("a folder");
    overhead(folder.path());
}

/// The least of several times of the parts of a run, one after another, so that all meet the same machine.
fn overhead(folder: &Path) {
    const ROUNDS: usize = 15;
    let scenario = load_scenario(Path::new("scenarios/paper.toml")).expect("the shipped scenario");
    let (seed, plant) = (scenario.seed, PlantKind::Rapier);
    let input = input_of(&scenario, seed, 0, plant);
    let preamble = Preamble {
        input: &input,
        sources: &scenario.sources,
        model: &scenario.robot.model,
        visuals: &scenario.robot.visuals,
        truth: None,
    };
    let mut least = [Duration::MAX; 4];
    for _ in 0..ROUNDS {
        let mut clock = Instant::now();
        let mut lap = |part: usize| {
            least[part] = least[part].min(clock.elapsed());
            clock = Instant::now();
        };
        let outcome =
            run_trial(&scenario, seed, 0, plant, &mut |_| ControlFlow::Continue(())).expect("a run");
        lap(0);
        write_reports(&outcome, folder).expect("reports");
        lap(1);
        // Without the simulation between its events: what recording itself takes.
        let file = BufWriter::new(File::create(folder.join("run.mcap")).expect("a file"));
        let mut recorder = SessionRecorder::new(preamble, McapRecorder::new(file).expect("begun"));
        tell_session(&outcome, &mut |event| recorder.hear(event).expect("told"));
        recorder.evaluated(&outcome.story()).and_then(McapRecorder::finish).expect("finished");
        lap(2);
        #[cfg(feature = "rerun")]
        calibrig::recording::write_rrd(&outcome.story(), &folder.join("run.rrd")).expect("written");
        lap(3);
    }
    let [run, reports, mcap, rrd] = least.map(|time| time.as_secs_f64());
    println!("a run without files {:.0} ms, its reports {:.0} ms", 1e3 * run, 1e3 * reports);
    println!(
        "recording.mcap {:.1} ms, {:.1} % of both; recording.rrd {:.0} ms, {:.0} %\n",
        1e3 * mcap,
        1e2 * mcap / (run + reports),
        1e3 * rrd,
        1e2 * rrd / (run + reports)
    );
}

/// The events of the session behind `outcome`, once more.
fn tell_session(outcome: &Outcome, tell: &mut dyn FnMut(SessionEvent<'_>)) {
    let truth = outcome.truth.as_ref().expect("simulated");
    let poses = outcome.sets.iter().map(|set| set.measurements.observations.len() as u32).sum();
    let (as_built, stations) = (&truth.as_built, &truth.stations[..]);
    let (further_targets, payloads) = (&truth.further_targets[..], &truth.payloads[..]);
    tell(SessionEvent::Begin { as_built, stations, further_targets, payloads, poses });
    for (place, set) in outcome.sets.iter().enumerate() {
        let observations = &set.measurements.observations;
        tell(SessionEvent::Set { set, planned: observations.len() as u32 });
        for (index, observation) in observations.iter().enumerate() {
            tell(SessionEvent::Measured(MeasuredPose {
                kind: set.kind,
                first: index,
                observations: std::slice::from_ref(observation),
                settled: &truth.poses[place][index..=index],
                rigid: &truth.rigid[place][index..=index],
                effects: &truth.effects[place][index..=index],
            }));
        }
        tell(SessionEvent::SetEnd { set });
    }
}
