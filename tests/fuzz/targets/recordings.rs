//! Recordings: read, looked through, saved, exported.

use std::path::Path;
use std::sync::LazyLock;

use calibrig::recording::{State, export_csv, inspect, read_recorded_machine, read_recording, recover};

use super::choices::Choices;
use super::file;
use super::mcap_file::{self, Part};
use super::protobuf;

/// One by another program, and one of calibrig's, shortened.
static RECORDINGS: LazyLock<[Vec<Part>; 2]> = LazyLock::new(|| {
    [
        mcap_file::parts(include_bytes!("../../fixtures/recording/by_hand.mcap"), 4),
        mcap_file::parts(include_bytes!("../../fixtures/recording/schema1.mcap"), 2),
    ]
});

pub fn mcap(data: &[u8]) {
    let choices = &mut Choices::new(data);
    let bytes = match choices.below(8) {
        7 => std::mem::replace(choices, Choices::new(&[])).rest().to_vec(),
        kind => made(usize::from(kind == 6), choices),
    };
    file::with(&bytes, look);
}

/// A recording with a few parts changed.
fn made(which: usize, choices: &mut Choices<'_>) -> Vec<u8> {
    let mut parts = RECORDINGS[which].clone();
    for _ in 0..choices.below(5) {
        if parts.is_empty() {
            break;
        }
        let at = choices.below(parts.len());
        match choices.below(8) {
            0 => drop(parts.remove(at)),
            1 => {
                let part = parts[at].clone();
                parts.insert(choices.below(parts.len() + 1), part);
            }
            2 => {
                let other = choices.below(parts.len());
                parts.swap(at, other);
            }
            _ => edit(&mut parts[at], choices),
        }
    }
    let mut bytes = mcap_file::file(&parts, "", choices);
    mcap_file::damage(&mut bytes, choices);
    bytes
}

fn edit(part: &mut Part, choices: &mut Choices<'_>) {
    match part {
        Part::Message { data, topic, time, .. } => match choices.below(8) {
            7 => {
                (*choices.pick(&["", "/", "/nest", "/measurement/verification", "/truth/as_built"]))
                    .clone_into(topic);
            }
            6 => *time = *choices.pick(&[0, 1, u64::MAX, 1 << 63]),
            _ => *data = protobuf::edited(data, choices),
        },
        Part::Attachment(name, data) => {
            if choices.below(4) == 3 {
                (*choices.pick(&["robot/robot.toml", "urdf/robot.urdf", "scenario/", "/", "robot/../x"]))
                    .clone_into(name);
            } else if !data.is_empty() {
                let at = choices.below(data.len());
                data[at] = *choices.pick(b"0-9e.\"'\n#[]=\xff");
            }
        }
        Part::Metadata(metadata) => {
            let keys: Vec<String> = metadata.metadata.keys().cloned().collect();
            if keys.is_empty() {
                return;
            }
            let key = choices.pick(&keys);
            match choices.below(3) {
                0 => drop(metadata.metadata.remove(key)),
                _ => {
                    let value =
                        *choices.pick(&["", "0", "-1", "18446744073709551616", "calibrig.recording/99", "x"]);
                    metadata.metadata.insert(key.clone(), value.to_owned());
                }
            }
        }
    }
}

fn look(path: &Path, other: &Path) {
    let read = read_recording(path);
    let looked = inspect(path, &mut |_, _| {});
    if let Ok(recording) = &read {
        // What is read is sound, so that whoever looks through it says the same.
        let inspection = looked.as_ref().expect("a recording that is read is looked through");
        assert_eq!(inspection.health.state, State::Whole, "{:?}", inspection.health);
        for set in recording.sets.iter().map(|set| &set.measurements) {
            if let Some(first) = set.observations.first() {
                set.check(first.command.len()).expect("what is read is a set");
            }
        }
        drop(recording.robot());
        drop(export_csv(path, None));
    }
    drop(read_recorded_machine(path));
    if recover(path, other, true, &mut |_, _| {}).is_ok() {
        inspect(other, &mut |_, _| {}).expect("what is saved is whole");
    }
}
