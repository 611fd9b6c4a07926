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
        assert_refused(&sandbox, &REPLAY, "r.mcap: ", "ends before its footer", "a complete file");
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
        assert_refused(
            &sandbox,
            &REPLAY,
            "r.mcap: ",
            "the recording is damaged: ",
            "checksums and lengths that fit",
        );
    }
}

#[test]
fn it_is_none() {
    let sandbox = Sandbox::new();
    sandbox.write("empty.mcap", "");
    sandbox.write("text.mcap", "hello".repeat(100));
    for file in ["empty.mcap", "text.mcap", SCENARIO] {
        let place = format!("{file}: ");
        assert_refused(&sandbox, &["replay", file], &place, "not an MCAP file", "that `calibrig run` writes");
    }
}

#[test]
fn it_is_absent_or_a_folder() {
    let sandbox = Sandbox::new();
    let expected = "that `calibrig run` writes";
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

const RECOVER: [&str; 3] = ["recover", "r.mcap", "good.mcap"];

#[test]
fn what_is_sound_of_it_is_saved_and_replayed() {
    let (sandbox, bytes) = recorded();
    let mut damaged = bytes.clone();
    damaged[bytes.len() / 2] ^= 4;
    sandbox.write("r.mcap", &damaged);
    let before = std::fs::read(sandbox.path("r.mcap")).expect("there");
    let inspected = sandbox.run(["inspect", "r.mcap"]);
    assert_eq!((inspected.code, inspected.stderr.as_str()), (Some(3), ""), "{inspected:?}");
    for told in
        ["damaged at byte", "calibrig recover r.mcap NEW", "matches its hash", "/measurement/identification"]
    {
        assert!(inspected.stdout.contains(told), "{told}: {}", inspected.stdout);
    }
    let recovered = sandbox.run(RECOVER);
    assert_eq!((recovered.code, recovered.stderr.as_str()), (Some(3), ""), "{recovered:?}");
    for told in ["messages saved to good.mcap", "lost", "next: calibrig replay good.mcap"] {
        assert!(recovered.stdout.contains(told), "{told}: {}", recovered.stdout);
    }
    assert!(before == std::fs::read(sandbox.path("r.mcap")).expect("there"));
    let inspected = sandbox.run(["inspect", "good.mcap", "--json"]);
    assert_eq!(inspected.code, Some(0));
    let json = inspected.json();
    assert_eq!(json["schema"], "calibrig.inspect/1");
    assert_eq!(json["health"]["state"], "whole");
    assert_eq!(json["metadata"], serde_json::json!(["calibrig_recovered", "calibrig"]));
    let replayed = sandbox.run(["replay", "good.mcap"]);
    assert!(matches!(replayed.code, Some(0 | 3)), "{replayed:?}");
}

#[test]
fn nothing_is_wrong_with_it() {
    let (sandbox, bytes) = recorded();
    sandbox.write("r.mcap", &bytes);
    let inspected = sandbox.run(["inspect", "r.mcap", "--json"]);
    assert_eq!((inspected.code, inspected.stderr.as_str()), (Some(0), ""));
    let json = inspected.json();
    assert_eq!((&json["calibrig"], &json["provenance"]["state"]), (&true.into(), &"fits".into()));
    assert_eq!(json["sets"][0]["poses"], 60);
    assert_eq!(json["estimates"].as_array().map(Vec::len), Some(5));
    let recovered = sandbox.run(RECOVER);
    assert_eq!((recovered.code, recovered.stderr.as_str()), (Some(0), ""));
    assert!(recovered.stdout.contains("nothing is wrong with it"), "{}", recovered.stdout);
    assert!(std::fs::read(sandbox.path("good.mcap")).expect("copied") == bytes);
}

#[test]
fn nothing_can_be_saved_of_it() {
    let sandbox = Sandbox::new();
    let expected = "that `calibrig run` writes";
    sandbox.write("empty.mcap", "");
    sandbox.write("text.mcap", "hello".repeat(100));
    for file in ["empty.mcap", "text.mcap", SCENARIO] {
        for arguments in [&["inspect", file][..], &["recover", file, "good.mcap"]] {
            assert_refused(&sandbox, arguments, &format!("{file}: "), "not an MCAP file", expected);
        }
    }
    for arguments in [&["inspect", "r.mcap"][..], &RECOVER] {
        assert_refused(&sandbox, arguments, "cannot read r.mcap: ", "No such file", expected);
        assert_refused(
            &sandbox,
            &[arguments[0], "models", "new"][..arguments.len()],
            "cannot read models: ",
            "directory",
            expected,
        );
    }
    sandbox.write("r.mcap", b"\x89MCAP0\r\n\x01\x00");
    assert_refused(
        &sandbox,
        &RECOVER,
        "r.mcap holds no message",
        "2 are not readable",
        "no new file is written",
    );
}

#[test]
fn it_is_another_programs() {
    let sandbox = Sandbox::new();
    let mut file = std::io::Cursor::new(Vec::new());
    let mut writer = mcap::Writer::new(&mut file).expect("begun");
    let channel = writer.add_channel(0, "/imu", "json", &[].into()).expect("added");
    for sequence in 0..10 {
        let header =
            mcap::records::MessageHeader { channel_id: channel, sequence, log_time: 5, publish_time: 5 };
        writer.write_to_known_channel(&header, b"{}").expect("written");
    }
    writer.finish().expect("finished");
    drop(writer);
    let bytes = file.into_inner();
    sandbox.write("r.mcap", &bytes);
    let inspected = sandbox.run(["inspect", "r.mcap"]);
    assert_eq!(inspected.code, Some(0), "{inspected:?}");
    assert!(inspected.stdout.contains("not a calibrig recording") && inspected.stdout.contains("/imu"));
    sandbox.write("r.mcap", &bytes[..bytes.len() - 20]);
    let recovered = sandbox.run(RECOVER);
    assert_eq!(recovered.code, Some(0), "only the summary is cut off: {recovered:?}");
    for told in ["10 messages saved", "lost: nothing", "not a calibrig recording"] {
        assert!(recovered.stdout.contains(told), "{told}: {}", recovered.stdout);
    }
}

#[test]
fn the_target_cannot_be_written() {
    let (sandbox, bytes) = recorded();
    sandbox.write("r.mcap", &bytes[..bytes.len() / 2]);
    sandbox.write("there.mcap", "mine");
    let refused = |target: &str, place: &str, message: &str, expected: &str| {
        assert_refused(&sandbox, &["recover", "r.mcap", target], place, message, expected);
    };
    refused("there.mcap", "there.mcap ", "is already there", "--force");
    refused("r.mcap", "r.mcap ", "is the damaged file itself", "another name");
    refused("./models/../r.mcap", "./models/../r.mcap ", "is the damaged file itself", "another name");
    refused("models", "models ", "is a folder", "the name of a file");
    refused("none/good.mcap", "cannot write none/good.mcap: ", "No such file", "an existing folder");
    refused(
        "there.mcap/good.mcap",
        "cannot write there.mcap/good.mcap: ",
        "Not a directory",
        "an existing folder",
    );
    // Read-only for everyone.
    #[cfg(target_os = "linux")]
    refused("/proc/good.mcap", "cannot write /proc/good.mcap: ", "", "permission to write");
    let forced = sandbox.run(["recover", "r.mcap", "there.mcap", "--force"]);
    assert!(matches!(forced.code, Some(0 | 3)), "{forced:?}");
    assert_ne!(std::fs::read(sandbox.path("there.mcap")).expect("there"), b"mine");
}
