//! A million observations: written as they are measured, looked through, saved from a file that was cut off, and read back. Seconds and
//! peak memory of each.
//!
//! `cargo bench --bench million`

// A bench may stop at its first error.
#![allow(clippy::expect_used, clippy::cast_possible_truncation, clippy::disallowed_methods, missing_docs)]

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use calibrig_files::load_robot;
use calibrig_model::measurement::{Observation, Reading};
use calibrig_recording::{
    InputSummary, McapRecorder, Measured, Preamble, Recorder, inspect, read_recording, recover,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const OBSERVATIONS: u32 = 1_000_000;

fn main() {
    million(tempfile::tempdir().expect("a folder").path());
}

/// A file of the repository.
fn root(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(name)
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

/// Records a session whose observations are drawn around recorded ones: their digits are as hard to compress as real ones. The time that
/// recording takes, and the file's length.
fn write(path: &Path, observations: u32) -> (Duration, u64) {
    let recorded = read_recording(&root("recordings/paper.mcap")).expect("the shipped recording");
    let robot = load_robot(&root("models/spray_painter/robot.toml")).expect("the shipped robot");
    let set = &recorded.sets[0];
    let drawn = &set.measurements.observations;
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let input = InputSummary {
        kind: "recording",
        name: "paper".to_owned(),
        sha256: String::new(),
        seed: None,
        trial: None,
    };
    let begun = Instant::now();
    let file = BufWriter::new(File::create(path).expect("a file"));
    let mut recorder = McapRecorder::new(file).expect("begun");
    let preamble = Preamble {
        input: &input,
        sources: &recorded.sources,
        model: &robot.model,
        visuals: &robot.visuals,
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
