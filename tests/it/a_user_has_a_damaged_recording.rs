//! Recordings that cannot be replayed, given to the process.

use crate::sandbox::{SCENARIO, Sandbox, assert_refused};

fn recorded() -> (Sandbox, Vec<u8>) {
    let sandbox = Sandbox::new();
    let ended = sandbox.run(["run", SCENARIO, "--out", "out"]);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let bytes = std::fs::read(sandbox.path("out/recording.mcap")).expect("the recording");
    (sandbox, bytes)
}

const REPLAY: [&str; 2] = ["replay", "r.mcap"];

#[test]
fn it_breaks_off() {
    let (sandbox, bytes) = recorded();
    for length in [8, 9, bytes.len() / 3, bytes.len() / 2, bytes.len() - 1] {
        sandbox.write("r.mcap", &bytes[..length]);
        assert_refused(
            &sandbox,
            &REPLAY,
            "r.mcap: ",
            "breaks off before its end",
            "the footer of a finished recording",
        );
    }
}

#[test]
fn one_bit_is_flipped() {
    let (sandbox, bytes) = recorded();
    for part in 1..20 {
        let mut damaged = bytes.clone();
        let at = bytes.len() * part / 20;
        damaged[at] ^= 1 << (part % 8);
        sandbox.write("r.mcap", damaged);
        assert_refused(&sandbox, &REPLAY, "r.mcap: ", "the recording is damaged: ", "checksums that fit");
    }
}

#[test]
fn it_is_none() {
    let sandbox = Sandbox::new();
    sandbox.write("empty.mcap", "");
    sandbox.write("text.mcap", "hello".repeat(100));
    for file in ["empty.mcap", "text.mcap", SCENARIO] {
        let place = format!("{file}: ");
        assert_refused(&sandbox, &["replay", file], &place, "not an MCAP file", "written by `calibrig run`");
    }
}

#[test]
fn it_is_absent_or_a_folder() {
    let sandbox = Sandbox::new();
    let expected = "written by `calibrig run`";
    assert_refused(&sandbox, &REPLAY, "cannot read r.mcap: ", "No such file", expected);
    sandbox.make_folder("r.mcap");
    assert_refused(&sandbox, &REPLAY, "cannot read r.mcap: ", "directory", expected);
    let below = "scenarios/paper.toml/r.mcap";
    assert_refused(
        &sandbox,
        &["replay", below],
        &format!("cannot read {below}: "),
        "Not a directory",
        expected,
    );
}

/// The inputs travel inside: the folder that they came from is not needed.
#[test]
fn it_is_sound_and_alone() {
    let (sandbox, bytes) = recorded();
    for folder in ["models", "scenarios", "out"] {
        std::fs::remove_dir_all(sandbox.path(folder)).expect("removed");
    }
    sandbox.write("r.mcap", bytes);
    let ended = sandbox.run(REPLAY);
    assert_eq!((ended.code, ended.stderr.as_str()), (Some(0), ""), "{}", ended.stdout);
    assert!(ended.stdout.contains("identical bit for bit"), "{}", ended.stdout);
}
