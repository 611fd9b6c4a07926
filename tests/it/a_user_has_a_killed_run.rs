//! A run that is killed at any moment leaves a file from which what was measured is saved.

use std::process::Stdio;
use std::time::{Duration, Instant};

use calibrig::measurement::Observation;
use calibrig::pipeline::SetKind;
use calibrig::recording::{Recording, RecordingError, read_recording};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::repeated;
use crate::sandbox::{Ended, SCENARIO, Sandbox};

/// What the fitted mode needs at least, with room.
const ENOUGH: usize = 40;

#[derive(Debug, Default)]
struct Counts {
    /// Before anything was measured.
    early: usize,
    /// In the session.
    session: usize,
    /// Behind it: all that was measured is there.
    evaluation: usize,
    /// The file had its name.
    over: usize,
    replayed: usize,
}

#[test]
fn what_was_measured_before_a_kill_is_saved() {
    let sandbox = Sandbox::new();
    sandbox.set("[poses]", "identification", "150");
    sandbox.set("[poses]", "verification", "50");
    sandbox.set("[identification]", "modes", "[\"without_calibration\", \"only_calibration\"]");
    // How long a run takes decides when it is killed, and nothing else.
    #[allow(clippy::disallowed_methods)]
    let begun = Instant::now();
    let ended = sandbox.run(["run", SCENARIO, "--out", "sound"]);
    let duration = begun.elapsed();
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let bytes = std::fs::read(sandbox.path("sound/recording.mcap")).expect("a recording");
    let sound = read_recording(&sandbox.path("sound/recording.mcap")).expect("read");

    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut counts = Counts::default();
    let kills = repeated(50, 12);
    for number in 0..kills {
        let out = format!("killed{number}");
        kill_a_run(&sandbox, &out, duration.mul_f64(rng.random_range(0.0..1.0)));
        check(&sandbox, &out, &bytes, &sound, &mut counts);
    }
    println!("{kills} kills within {duration:?}: {counts:?}");
    assert!(counts.session + counts.evaluation >= kills as usize / 5, "{counts:?}");
}

fn kill_a_run(sandbox: &Sandbox, out: &str, after: Duration) {
    let mut command = sandbox.command(["run", SCENARIO, "--out", out]);
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("started");
    std::thread::sleep(after);
    // It may be over.
    let _ = child.kill();
    child.wait().expect("ended");
}

fn check(sandbox: &Sandbox, out: &str, bytes: &[u8], sound: &Recording, counts: &mut Counts) {
    let (part, good) = (format!("{out}/recording.mcap.part"), format!("{out}.mcap"));
    if let Ok(finished) = std::fs::read(sandbox.path(&format!("{out}/recording.mcap"))) {
        assert!(finished == bytes, "{out}: what has its name is whole");
        counts.over += 1;
        return;
    }
    if !sandbox.path(&part).exists() {
        counts.early += 1;
        return;
    }
    let inspected = calm(sandbox.run(["inspect", &part]));
    let recovered = calm(sandbox.run(["recover", &part, &good]));
    let context = format!("{out}: {inspected:?} {recovered:?}");
    if recovered.code == Some(1) {
        assert!(recovered.stderr.contains("no message") || recovered.stderr.contains("not an MCAP"));
        assert!(!sandbox.path(&good).exists(), "{context}");
        counts.early += 1;
        return;
    }
    assert!(matches!(recovered.code, Some(0 | 3)), "{context}");
    assert!(recovered.stdout.contains("messages saved") || recovered.stdout.contains("whole"), "{context}");
    let replayed = calm(sandbox.run(["replay", &good]));
    let recording = match read_recording(&sandbox.path(&good)) {
        Ok(recording) => recording,
        Err(error) => {
            assert!(matches!(error, RecordingError::NoMeasurements { .. }), "{error}");
            assert_eq!(replayed.code, Some(1), "{replayed:?}");
            counts.early += 1;
            return;
        }
    };
    assert_eq!(recording.provenance, sound.provenance);
    for set in &recording.sets {
        let of = observations(sound, set.kind);
        let kept = &set.measurements.observations;
        assert!(kept.len() <= of.len() && kept[..] == of[..kept.len()], "{out}: not a prefix");
    }
    let complete =
        SetKind::ALL.into_iter().all(|kind| observations(&recording, kind) == observations(sound, kind));
    if complete && recording.missing.is_empty() {
        counts.evaluation += 1;
    } else {
        counts.session += 1;
        assert!(recording.recovered, "{context}");
    }
    if observations(&recording, SetKind::Identification).len() >= ENOUGH {
        assert!(matches!(replayed.code, Some(0 | 3)), "{replayed:?}");
        let told = replayed.stderr.contains("cut short");
        assert_eq!(told, !recording.missing.is_empty(), "{replayed:?}");
        counts.replayed += 1;
    } else {
        assert!(matches!(replayed.code, Some(0 | 1 | 3)), "{replayed:?}");
        assert!(replayed.code != Some(1) || replayed.stderr.starts_with("error: "), "{replayed:?}");
    }
}

fn observations(recording: &Recording, kind: SetKind) -> &[Observation] {
    let set = recording.sets.iter().find(|set| set.kind == kind);
    set.map_or(&[], |set| &set.measurements.observations)
}

fn calm(ended: Ended) -> Ended {
    assert!(ended.code.is_some() && !ended.stderr.contains("panicked"), "{ended:?}");
    ended
}
