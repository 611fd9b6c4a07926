//! What recording costs a run of `scenarios/paper.toml`; and a million observations: written as they are measured, looked through, saved
//! from a file that was cut off, and read back. Seconds and peak memory of each.
//!
//! `cargo bench --bench recording`, or the first part alone with `-- run`, the second with `-- million`.

// A bench may stop at its first error.
#![allow(clippy::expect_used, clippy::cast_possible_truncation, clippy::disallowed_methods, missing_docs)]

use std::fs::File;
use std::io::BufWriter;
use std::ops::ControlFlow;
use std::path::Path;
use std::time::{Duration, Instant};

use calibrig::measurement::{Observation, Reading};
use calibrig::pipeline::{MeasuredPose, Outcome, PlantKind, SessionEvent, input_of, run_trial, simulate};
use calibrig::recording::{
    McapRecorder, Measured, Preamble, Recorder, SessionRecorder, inspect, read_recording, recover,
};
use calibrig::report::write_reports;
use calibrig::scenario::load_scenario;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const OBSERVATIONS: u32 = 1_000_000;

fn main() {
    let folder = tempfile::tempdir().expect("a folder");
    let asked =
        |part: &str| std::env::args().skip(1).all(|argument| argument.starts_with('-') || argument == part);
    if asked("run") {
        overhead(folder.path());
    }
    if asked("million") {
        million(folder.path());
    }
}

fn million(folder: &Path) {
    let path = |name: &str| folder.join(name);
    println!("{:<40} {:>9} {:>16}", "", "seconds", "peak MiB so far");
    for observations in [OBSERVATIONS / 10, OBSERVATIONS] {
        let (time, bytes) = write(&path("whole.mcap"), observations);
        tell(&format!("write {observations}, {} MB", bytes / 1_000_000), time);
    }
    timed("inspect", || inspect(&path("whole.mcap"), &mut |_, _| {}).expect("inspected"));
    let whole = std::fs::copy(path("whole.mcap"), path("cut.mcap")).expect("copied");
    let cut = File::options().write(true).open(path("cut.mcap")).expect("opened");
    cut.set_len(whole / 100 * 99).expect("cut off");
    timed("recover 99 % of it", || {
        recover(&path("cut.mcap"), &path("good.mcap"), false, &mut |_, _| {}).expect("recovered")
    });
    timed("read_recording", || read_recording(&path("whole.mcap")).expect("read"));
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
        recorder.evaluated(&outcome).and_then(McapRecorder::finish).expect("finished");
        lap(2);
        #[cfg(feature = "rerun")]
        calibrig::recording::write_rrd(&outcome, &folder.join("run.rrd")).expect("written");
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
    let (as_built, tracker_from_base) = (&truth.as_built, &truth.tracker_from_base);
    tell(SessionEvent::Begin { as_built, tracker_from_base, poses });
    for (place, set) in outcome.sets.iter().enumerate() {
        let observations = &set.measurements.observations;
        tell(SessionEvent::Set { set, planned: observations.len() as u32 });
        for (index, observation) in observations.iter().enumerate() {
            tell(SessionEvent::Measured(MeasuredPose {
                kind: set.kind,
                index,
                observation,
                settled: &truth.poses[place][index],
                rigid: Some(&truth.rigid[place][index]),
                effects: &truth.effects[place][index],
            }));
        }
        tell(SessionEvent::SetEnd { set });
    }
}

fn timed<T>(what: &str, work: impl FnOnce() -> T) {
    let begun = Instant::now();
    drop(work());
    tell(what, begun.elapsed());
}

fn tell(what: &str, time: Duration) {
    println!("{what:<40} {:>9.3} {:>16}", time.as_secs_f64(), peak());
}

/// The most memory that the process ever had, MiB, where the system says.
fn peak() -> String {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kibibytes = line.and_then(|line| line.trim().trim_end_matches(" kB").parse::<f64>().ok());
    kibibytes.map_or_else(|| "?".to_owned(), |kib| format!("{:.0}", kib / 1024.0))
}

/// Records a session whose observations are drawn around simulated ones: their digits are as hard to compress as real ones. The time that
/// recording takes, and the file's length.
fn write(path: &Path, observations: u32) -> (Duration, u64) {
    let scenario = load_scenario(Path::new("scenarios/paper.toml")).expect("the shipped scenario");
    let simulation = simulate(&scenario, 1, 0, PlantKind::Analytic, |_, _| {}).expect("a simulation");
    let set = &simulation.sets[0];
    let drawn = &set.measurements.observations;
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let input = input_of(&scenario, 1, 0, PlantKind::Analytic);
    let begun = Instant::now();
    let file = BufWriter::new(File::create(path).expect("a file"));
    let mut recorder = McapRecorder::new(file).expect("begun");
    let preamble = Preamble {
        input: &input,
        sources: &scenario.sources,
        model: &scenario.robot.model,
        visuals: &scenario.robot.visuals,
        truth: None,
    };
    recorder.open(&preamble).expect("opened");
    recorder.set(0, set, Some(observations)).expect("told");
    for index in 0..observations {
        let seconds = f64::from(index) * 1.5 + rng.random::<f64>();
        let mut observation =
            Observation { pose: index, time: seconds, ..drawn[index as usize % drawn.len()].clone() };
        observation.command.iter_mut().for_each(|command| *command += 1e-3 * rng.random::<f64>());
        if let Reading::Spherical(reading) = &mut observation.reading {
            reading.range += 1e-3 * rng.random::<f64>();
            reading.azimuth += 1e-3 * rng.random::<f64>();
            reading.elevation += 1e-3 * rng.random::<f64>();
        }
        let measured = Measured {
            kind: set.kind,
            first: index as usize,
            observations: std::slice::from_ref(&observation),
            times: &[u64::from(index) * 1_500_000_000],
            truth: &[],
            rigid: &[],
            effects: &[],
        };
        recorder.measured(&measured).expect("told");
    }
    let end = u64::from(observations) * 1_500_000_000;
    recorder.set_end(end, set.kind, observations as usize).expect("told");
    recorder.finish().expect("finished");
    (begun.elapsed(), std::fs::metadata(path).expect("written").len())
}
