use super::*;
use crate::table::{Cell, Column, Kind};

fn manifest(seed: u64, trials: u64, shards: u32) -> Manifest {
    Manifest {
        schema: Manifest::schema(),
        name: "study".to_owned(),
        scenario: "scenarios/study.toml".to_owned(),
        software: Software {
            version: "0.1.0".to_owned(),
            binary_sha256: "00".to_owned(),
            target: "x86_64-linux".to_owned(),
        },
        inputs: vec![Input { role: "scenario".to_owned(), sha256: "11".to_owned() }],
        seed,
        first: 5,
        trials,
        shards,
        study: serde_json::json!({"plant": "analytic"}),
        columns: vec![Column::new("trial", Kind::Integer), Column::new("rms_m", Kind::Number)],
    }
}

fn row(seed: u64, trial: u64) -> Vec<Cell> {
    vec![Cell::count(trial), Cell::number((!trial.is_multiple_of(4)).then_some((trial * seed) as f64 * 0.1))]
}

fn compute(folder: &Folder, range: Range<u64>) {
    let mut part = folder.begin_part().expect("a part");
    range.clone().for_each(|trial| part.push(&row(folder.manifest().seed, trial)).expect("a row"));
    folder.put_part(&range, part).expect("room");
}

fn whole(path: &Path, seed: u64, trials: u64) -> Vec<u8> {
    let folder = Folder::begin(path, &manifest(seed, trials, 1)).expect("a folder");
    compute(&folder, folder.manifest().range());
    folder.complete(&mut |_| {}).expect("all rows");
    assert!(folder.is_complete() && !path.join("parts").exists());
    fs::read(folder.table()).expect("a table")
}

fn sharded(path: &Path, seed: u64, trials: u64, shards: u32) -> Folder {
    let folder = Folder::begin(path, &manifest(seed, trials, shards)).expect("a folder");
    for shard in 0..shards {
        let range = folder.manifest().range_of(shard);
        if range.is_empty() {
            compute_nothing(&folder, shard);
            continue;
        }
        let middle = range.start + (range.end - range.start) / 2;
        if middle > range.start {
            compute(&folder, range.start..middle);
        }
        compute(&folder, middle..range.end);
        folder.complete_shard(shard).expect("a shard");
    }
    folder
}

/// A shard without trials: fewer trials than shards.
fn compute_nothing(folder: &Folder, shard: u32) {
    folder.complete_shard(shard).expect("an empty shard");
}

#[test]
fn shards_make_the_same_bytes_as_one_machine() {
    let root = tempfile::tempdir().expect("a folder");
    for trials in [1, 11, 100] {
        let one = whole(&root.path().join(format!("one-{trials}")), 3, trials);
        for shards in [1, 7, 40] {
            let path = root.path().join(format!("{trials}-in-{shards}"));
            let folder = sharded(&path, 3, trials, shards);
            let inventory = folder.inventory(&mut |_| {});
            assert_eq!((inventory.sound(), inventory.array().as_str()), (shards as usize, ""));
            assert!(inventory.faults.is_empty(), "{:?}", inventory.faults);
            folder.merge(&inventory, &mut |_| {}).expect("all shards");
            assert!(fs::read(folder.table()).expect("a table") == one, "{trials} trials in {shards} shards");
        }
    }
}

#[test]
fn ranges_of_shards_cover_every_trial_once() {
    for (trials, shards) in [(1_u64, 1_u32), (10, 3), (3, 10), (1_000_000, 997), (u64::from(u32::MAX), 1000)]
    {
        let manifest = manifest(1, trials, shards);
        let mut next = manifest.first;
        for shard in 0..shards {
            let range = manifest.range_of(shard);
            assert_eq!(range.start, next);
            assert!(range.end - range.start <= trials.div_ceil(u64::from(shards)));
            next = range.end;
        }
        assert_eq!(next, manifest.range().end);
    }
}

#[test]
fn parts_tell_what_is_done_and_overlapping_ones_count_once() {
    let root = tempfile::tempdir().expect("a folder");
    let one = whole(&root.path().join("one"), 2, 20);
    let folder = Folder::begin(&root.path().join("parts"), &manifest(2, 20, 1)).expect("a folder");
    let all = folder.manifest().range();
    assert_eq!((folder.covered(&all).done(), folder.covered(&all).missing()), (0, vec![all.clone()]));
    assert!(folder.so_far().expect("no fault").is_none());
    compute(&folder, 5..10);
    compute(&folder, 8..12);
    compute(&folder, 15..20);
    // One that was cut short counts for nothing.
    compute(&folder, 20..25);
    let cut = folder.part_files().pop().expect("the last part").path;
    let bytes = fs::read(&cut).expect("a part");
    fs::write(&cut, &bytes[..bytes.len() - 7]).expect("room");
    let covered = folder.covered(&all);
    assert_eq!((covered.done(), covered.missing()), (12, vec![12..15, 20..25]));
    assert_eq!(folder.so_far().expect("rows").expect("some").rows(), 7);
    assert!(
        matches!(folder.complete(&mut |_| {}), Err(FolderError::Missing { range, .. }) if range == (12..25))
    );
    compute(&folder, 12..15);
    compute(&folder, 20..25);
    folder.complete(&mut |_| {}).expect("all rows");
    assert!(fs::read(folder.table()).expect("a table") == one);
}

#[test]
fn every_fault_is_named_and_mended_by_computing_again() {
    let root = tempfile::tempdir().expect("a folder");
    let one = whole(&root.path().join("one"), 1, 30);
    let folder = sharded(&root.path().join("it"), 1, 30, 6);
    let name_of = |folder: &Folder, shard| folder.inventory(&mut |_| {}).sound[&shard].path.clone();
    // Gone, cut short, altered; of another seed; of another split; and what is no shard.
    fs::remove_file(name_of(&folder, 0)).expect("a shard");
    let cut = name_of(&folder, 1);
    let bytes = fs::read(&cut).expect("a shard");
    fs::write(&cut, &bytes[..bytes.len() / 2]).expect("room");
    let altered = name_of(&folder, 2);
    let mut bytes = fs::read(&altered).expect("a shard");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&altered, bytes).expect("room");
    let put = |from: PathBuf| {
        let to = folder.path().join("shards").join(from.file_name().expect("a name"));
        fs::copy(from, &to).expect("room");
        to
    };
    let foreign = put(name_of(&sharded(&root.path().join("other"), 2, 30, 6), 3));
    let overlap = put(name_of(&sharded(&root.path().join("split"), 1, 30, 4), 2));
    fs::write(folder.path().join("shards/notes.txt"), "mine").expect("room");

    let inventory = folder.inventory(&mut |_| {});
    assert_eq!((inventory.array().as_str(), inventory.sound()), ("0-2", 3));
    let told: Vec<String> = inventory.faults.iter().map(ToString::to_string).collect();
    let tells = |path: &Path, words: &str| {
        told.iter().any(|fault| {
            fault.contains(path.file_name().and_then(|n| n.to_str()).expect("a name"))
                && fault.contains(words)
        })
    };
    assert!(tells(&cut, "cut short") && tells(&altered, "altered"), "{told:?}");
    assert!(tells(&foreign, "seed 2 instead of 1") && tells(&overlap, "overlap"), "{told:?}");
    assert!(tells(Path::new("notes.txt"), "not that of a shard of this campaign"), "{told:?}");
    assert_eq!(told.len(), 5);
    assert!(matches!(folder.merge(&inventory, &mut |_| {}), Err(FolderError::Missing { .. })));

    for shard in inventory.missing {
        assert!(!folder.has_shard(shard).expect("a shard of it"));
        compute(&folder, folder.manifest().range_of(shard));
        folder.complete_shard(shard).expect("a shard");
        assert!(folder.has_shard(shard).expect("a shard of it"));
    }
    for path in [foreign, overlap, folder.path().join("shards/notes.txt")] {
        fs::remove_file(path).expect("a file");
    }
    let inventory = folder.inventory(&mut |_| {});
    assert!(inventory.faults.is_empty(), "{:?}", inventory.faults);
    folder.merge(&inventory, &mut |_| {}).expect("all shards");
    assert!(fs::read(folder.table()).expect("a table") == one);
    assert!(matches!(folder.has_shard(6), Err(FolderError::NoShard { .. })));
}

#[test]
fn a_folder_holds_one_campaign() {
    let root = tempfile::tempdir().expect("a folder");
    assert!(matches!(Folder::open(root.path()), Err(FolderError::NoCampaign { .. })));
    Folder::begin(root.path(), &manifest(1, 30, 6)).expect("a folder");
    Folder::begin(root.path(), &manifest(1, 30, 6)).expect("the same");
    let elsewhere = Manifest { scenario: "/data/study.toml".to_owned(), ..manifest(1, 30, 6) };
    Folder::begin(root.path(), &elsewhere).expect("the same from another place");
    let changed = |change: &dyn Fn(&mut Manifest)| {
        let mut other = manifest(1, 30, 6);
        change(&mut other);
        Folder::begin(root.path(), &other).expect_err("another").to_string()
    };
    for (change, words) in [
        (&(|m: &mut Manifest| m.seed = 2) as &dyn Fn(&mut Manifest), "seed 1 instead of 2"),
        (&|m| m.trials = 31, "30 trials from 5 instead of 31 trials from 5"),
        (&|m| m.shards = 7, "shards: 6 instead of 7"),
        (&|m| m.software.version = "9".to_owned(), "software version 0.1.0 instead of 9"),
        (&|m| m.software.binary_sha256 = "9".to_owned(), "a different build of version 0.1.0"),
        (&|m| m.inputs[0].sha256 = "9".to_owned(), "a different text of the scenario"),
        (&|m| m.study = serde_json::json!({"plant": "rapier"}), "plant \"analytic\" instead of \"rapier\""),
        (&|m| m.study = serde_json::json!({}), "a different study"),
        (&|m| m.study = serde_json::json!({"plant": ["rapier"]}), "a different study (key plant)"),
        (&|m| m.columns.truncate(1), "different columns"),
    ] {
        let told = changed(change);
        assert!(told.contains(words), "{told}");
    }
    let file = root.path().join("manifest.json");
    for text in ["", "{", "{\"schema\": \"calibrig.manifest/1\"}"] {
        fs::write(&file, text).expect("room");
        let told = Folder::open(root.path()).expect_err("no manifest").to_string();
        assert!(told.contains("manifest.json"), "{told}");
    }
}
