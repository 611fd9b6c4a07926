//! The fuzz targets on their corpus: inputs that once showed a mistake, and a few that reach far. `docs/fuzzing.md` says how to look for more.

#[path = "../fuzz/targets/mod.rs"]
mod targets;

use std::fs;
use std::path::Path;

use targets::TARGETS;

/// Bytes that a target may take at once for an input of 4096 bytes: the fuzzer's own limit is eight times this.
const MOST_BYTES: u64 = 1 << 28;

#[test]
fn every_input_of_the_corpus_is_survived_within_little_memory() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/corpus");
    for (name, target) in TARGETS {
        let folder =
            fs::read_dir(corpus.join(name)).unwrap_or_else(|error| panic!("the corpus of {name}: {error}"));
        let mut inputs: Vec<_> = folder.map(|entry| entry.unwrap().path()).collect();
        inputs.sort();
        assert!(!inputs.is_empty(), "the corpus of {name} is empty");
        for path in inputs {
            let data = fs::read(&path).unwrap();
            let used = allocation_counter::measure(|| target(&data));
            assert!(used.bytes_max < MOST_BYTES, "{} takes {} bytes", path.display(), used.bytes_max);
        }
    }
    let known: Vec<_> = TARGETS.iter().map(|(name, _)| (*name).to_owned()).collect();
    let folders =
        fs::read_dir(corpus).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    folders.for_each(|folder| assert!(known.contains(&folder), "{folder} is the corpus of no target"));
}

/// Some twenty thousand files; the twelve extremes are at every key in turn, as thirteen and twelve have no common divisor.
#[test]
fn every_key_of_a_file_at_its_extremes_is_refused_or_means_something() {
    targets::read_keys_at_extremes(super::repeated(1, 13) as usize);
}
