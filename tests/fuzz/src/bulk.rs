//! Feeds one fuzz target, named by `CALIBRIG_FUZZ`, with inputs that are known ones changed at random, many times as many a second as an engine that
//! watches what they reach: `calibrig-fuzz-bulk SECONDS SEED FOUND CORPUS...`, where `FOUND` is the folder for what goes wrong.

// What reads keys at extremes is called by the tests of the root alone.
#[allow(dead_code)]
#[path = "../targets/mod.rs"]
mod targets;

use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Longer is a hang.
const LONGEST: Duration = Duration::from_secs(10);
/// Bytes of the longest input.
const MOST: usize = 4096;
/// Inputs that go wrong before it ends: more of them are of the same kind.
const ENOUGH: usize = 10;

/// The input at work, and since when.
type Current = Arc<Mutex<(Vec<u8>, Instant)>>;

fn main() -> ExitCode {
    match run() {
        Ok(0) => ExitCode::SUCCESS,
        Ok(_) => ExitCode::FAILURE,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::from(2)
        }
    }
}

fn run() -> Result<usize, String> {
    let usage = || "calibrig-fuzz-bulk SECONDS SEED FOUND CORPUS..., with CALIBRIG_FUZZ=TARGET".to_owned();
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [seconds, seed, found, folders @ ..] = arguments.as_slice() else { return Err(usage()) };
    let (Ok(seconds), Ok(seed)) = (seconds.parse(), seed.parse()) else { return Err(usage()) };
    let name = std::env::var("CALIBRIG_FUZZ").map_err(|_| usage())?;
    let known = targets::TARGETS.iter().find(|(known, _)| *known == name);
    let (_, target) = known.ok_or_else(|| format!("CALIBRIG_FUZZ is {name:?}: it names no target"))?;
    let inputs = read_all(folders)?;
    let found = PathBuf::from(found);
    let current: Current = Arc::new(Mutex::new((Vec::new(), Instant::now())));
    watch(Arc::clone(&current), found.clone());
    let end = Instant::now() + Duration::from_secs(seconds);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut executions, mut wrong) = (0_u64, 0);
    while Instant::now() < end && wrong < ENOUGH {
        let input = changed(&inputs, &mut rng);
        *current.lock().unwrap_or_else(PoisonError::into_inner) = (input.clone(), Instant::now());
        executions += 1;
        if catch_unwind(AssertUnwindSafe(|| target(&input))).is_err() {
            wrong += 1;
            keep(&found, "crash", &input);
        }
    }
    println!("{executions} executions, {wrong} found");
    Ok(wrong)
}

fn read_all(folders: &[String]) -> Result<Vec<Vec<u8>>, String> {
    let mut inputs = vec![Vec::new()];
    for folder in folders {
        let named = |error| format!("{folder}: {error}");
        let mut paths: Vec<PathBuf> = fs::read_dir(folder)
            .and_then(|entries| entries.map(|entry| Ok(entry?.path())).collect())
            .map_err(named)?;
        // So that a seed means the same each time.
        paths.sort();
        for path in paths {
            inputs.push(fs::read(path).map_err(named)?);
        }
    }
    Ok(inputs)
}

/// Ends the process where an input takes too long.
fn watch(current: Current, found: PathBuf) {
    std::thread::spawn(move || {
        loop {
            std::thread::sleep(Duration::from_secs(1));
            let (input, since) = &*current.lock().unwrap_or_else(PoisonError::into_inner);
            if since.elapsed() > LONGEST {
                keep(&found, "timeout", input);
                std::process::exit(1);
            }
        }
    });
}

/// Keeps an input under a name of its own.
fn keep(found: &Path, what: &str, input: &[u8]) {
    let name = input.iter().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
        (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3)
    });
    let path = found.join(format!("{what}-{name:016x}"));
    match fs::write(&path, input) {
        Ok(()) => eprintln!("{}", path.display()),
        Err(error) => eprintln!("{}: {error}; the input is {input:?}", path.display()),
    }
}

/// One of the inputs with a few changes, or nothing but bytes drawn.
fn changed(inputs: &[Vec<u8>], rng: &mut ChaCha8Rng) -> Vec<u8> {
    let one = |rng: &mut ChaCha8Rng| &inputs[rng.random_range(0..inputs.len())];
    let mut input = one(rng).clone();
    if input.is_empty() || rng.random_range(0..8) == 0 {
        input.resize(rng.random_range(1..=256), 0);
        rng.fill_bytes(&mut input);
        return input;
    }
    for _ in 0..1 << rng.random_range(0..5) {
        if input.is_empty() {
            break;
        }
        let at = rng.random_range(0..input.len());
        let end = input.len().min(at + rng.random_range(1..=16));
        match rng.random_range(0..7) {
            0 => input[at] ^= 1 << rng.random_range(0..8),
            1 => input[at] = rng.random(),
            2 => rng.fill_bytes(&mut input[at..end]),
            3 => drop(input.drain(at..end)),
            4 => input.insert(at, rng.random()),
            5 => {
                let own = input[at..end].to_vec();
                let to = rng.random_range(0..=input.len());
                input.splice(to..to, own);
            }
            // The rest of another one: what it chose last, or first.
            _ => {
                let other = one(rng);
                input.truncate(at);
                input.extend(&other[at.min(other.len())..]);
            }
        }
    }
    input.truncate(MOST);
    input
}
