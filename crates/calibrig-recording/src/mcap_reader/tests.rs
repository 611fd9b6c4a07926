//! Recordings read back: whole, damaged, and of other writers.

use super::*;
use std::collections::{BTreeMap, HashMap};
use std::io::Cursor;

use mcap::records::{self, Record};
use mcap::{Attachment, MAGIC};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use calibrig_model::measurement::{PoseReading, Reading};
use nalgebra::{Matrix6, Rotation3, Vector3};
use prost::Message;

use crate::provenance::RECOVERED;
use crate::schema::v1;
use crate::synthetic::Outcome;
use crate::{synthetic, write_mcap};

fn bytes_of(outcome: &Outcome) -> Vec<u8> {
    synthetic::recorded(outcome)
}

fn read(bytes: &[u8]) -> Result<Recording, RecordingError> {
    read_without(bytes, &[])
}

fn read_without(bytes: &[u8], topics: &[&str]) -> Result<Recording, RecordingError> {
    let options = ReadOptions { dropped_topics: topics.iter().map(|&topic| topic.to_owned()).collect() };
    read_from(&mut Cursor::new(bytes), &options).map_err(|error| match error {
        ReadError::Recording(error) => error,
        ReadError::Io(error) => panic!("no I/O in memory: {error}"),
    })
}

/// A sound MCAP file with the given records of a recording, and `change` applied to every message, metadata text and attachment.
fn rewritten(bytes: &[u8], change: &mut dyn FnMut(&str, &mut Vec<u8>) -> bool) -> Vec<u8> {
    rewritten_with(mcap::WriteOptions::new(), None, bytes, change)
}

fn rewritten_with(
    options: mcap::WriteOptions,
    first: Option<&str>,
    bytes: &[u8],
    change: &mut dyn FnMut(&str, &mut Vec<u8>) -> bool,
) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    let mut writer = options.create(&mut file).expect("begun");
    if let Some(name) = first {
        let metadata = records::Metadata { name: name.to_owned(), metadata: BTreeMap::new() };
        writer.write_metadata(&metadata).expect("written");
    }
    let mut channels: HashMap<u16, (String, u16)> = HashMap::new();
    let mut schemas = HashMap::new();
    read_records(&mut Cursor::new(bytes), &mut |record| {
        match record {
            Record::Metadata(mut metadata) => {
                let mut kept = true;
                for (key, value) in &mut metadata.metadata {
                    let mut text = value.clone().into_bytes();
                    kept &= change(&format!("metadata {key}"), &mut text);
                    *value = String::from_utf8_lossy(&text).into_owned();
                }
                if kept {
                    writer.write_metadata(&metadata).expect("written");
                }
            }
            Record::Attachment { header, data, .. } => {
                let mut data = data.into_owned();
                if change("attachment", &mut data) {
                    let attachment = Attachment {
                        log_time: 0,
                        create_time: 0,
                        name: header.name,
                        media_type: header.media_type,
                        data: data.into(),
                    };
                    writer.attach(&attachment).expect("written");
                }
            }
            Record::Schema { header, data } => {
                let id = writer.add_schema(&header.name, &header.encoding, &data).expect("added");
                schemas.insert(header.id, id);
            }
            Record::Channel(c) => {
                let id = writer.add_channel(schemas[&c.schema_id], &c.topic, "protobuf", &c.metadata);
                channels.insert(c.id, (c.topic, id.expect("added")));
            }
            Record::Message { mut header, data } => {
                let (topic, id) = &channels[&header.channel_id];
                header.channel_id = *id;
                let mut data = data.into_owned();
                if change(topic, &mut data) {
                    writer.write_to_known_channel(&header, &data).expect("written");
                }
            }
            _ => {}
        }
        Ok(())
    })
    .expect("sound");
    writer.finish().expect("finished");
    drop(writer);
    file.into_inner()
}

#[test]
fn a_session_of_full_poses_is_read_back_bit_for_bit_and_its_axes_are_drawn() {
    let mut outcome = synthetic::outcome(5, 2, false);
    let drawn = |outcome: &Outcome| {
        let mut lines = 0;
        rewritten(&bytes_of(outcome), &mut |topic, data| {
            if topic == "/scene" {
                let update = foxglove::messages::SceneUpdate::decode(data.as_slice()).expect("a scene");
                lines += update.entities.iter().map(|entity| entity.lines.len()).sum::<usize>();
            }
            true
        });
        lines
    };
    let of_points = drawn(&outcome);
    let mut poses = 0;
    for set in &mut outcome.sets {
        for (observation, turn) in set.measurements.observations.iter_mut().zip(1..) {
            observation.reading = Reading::Pose(Box::new(PoseReading {
                position: observation.reading.position(),
                rotation: Rotation3::new(Vector3::new(0.1, -0.2, 0.3) * f64::from(turn)),
                covariance: Some(Matrix6::identity() * 1e-10),
            }));
            poses += 1;
        }
    }
    let recording = read(&bytes_of(&outcome)).expect("read");
    assert_eq!(format!("{:?}", recording.sets), format!("{:?}", outcome.sets));
    assert_eq!(drawn(&outcome), of_points + 3 * poses, "x, y and z of each");
}

#[test]
fn what_was_recorded_is_read_back_bit_for_bit() {
    for truth in [true, false] {
        let outcome = synthetic::outcome(12, 5, truth);
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("recording.mcap");
        write_mcap(&outcome.story(), &path).expect("written");
        let recording = read_recording(&path).expect("read");
        // `{:?}` tells -0.0 from 0.0 and prints enough digits for every bit.
        assert_eq!(format!("{:?}", recording.sets), format!("{:?}", outcome.sets));
        let provenance = recording.provenance.as_ref().expect("ours");
        assert_eq!((provenance.seed, provenance.trial), (outcome.input.seed, outcome.input.trial));
        assert_eq!(provenance.input_sha256, outcome.input.sha256);
        assert!(recording.missing.is_empty() && !recording.recovered);
        assert_eq!(recording.sources.len(), outcome.sources.len());
        for ((role, source), (recorded_role, recorded)) in outcome.sources.iter().zip(&recording.sources) {
            assert_eq!((role, &source.text), (recorded_role, &recorded.text));
            assert!(source.name.ends_with(&recorded.name), "{}", recorded.name);
        }
        assert_eq!(recording.estimates.len(), outcome.modes.len());
        for (recorded, mode) in recording.estimates.iter().zip(&outcome.modes) {
            assert_eq!(recorded.mode, mode.mode.key());
            assert_eq!(recorded.stations, mode.robot.stations);
            assert_eq!(recorded.targets, mode.robot.targets);
            let Some(estimate) = &mode.estimate else {
                assert!(recorded.parameters.is_empty() && recorded.termination.is_empty());
                assert_eq!((recorded.chi2, recorded.degrees_of_freedom), (None, None));
                continue;
            };
            assert_eq!(recorded.chi2.map(f64::to_bits), Some(estimate.chi2.to_bits()));
            assert_eq!(recorded.termination, estimate.termination.key());
            assert_eq!(recorded.parameters.len(), estimate.parameters.len());
            for (r, p) in recorded.parameters.iter().zip(&estimate.parameters) {
                assert_eq!(calibrig_model::ParameterId::parse(&r.name), Some(p.id));
                assert_eq!((r.value.to_bits(), r.sigma), (p.value.to_bits(), p.sigma));
            }
        }
    }
}

#[test]
fn the_same_outcome_gives_the_same_bytes_whatever_folder_its_inputs_lie_in() {
    let outcome = synthetic::outcome(25, 8, true);
    let once = bytes_of(&outcome);
    assert_eq!(once, bytes_of(&outcome));
    let mut elsewhere = outcome.clone();
    for (_, source) in &mut elsewhere.sources {
        source.name = format!("/another/place/{}", source.name);
    }
    assert_eq!(once, bytes_of(&elsewhere));
    let mut other = outcome;
    other.sets[0].measurements.observations[3].command[0] += 1e-15;
    assert_ne!(once, bytes_of(&other));
}

#[test]
fn the_truth_is_not_read() {
    let simulated = synthetic::outcome(6, 2, true);
    let measured = Outcome { truth: None, ..simulated.clone() };
    assert_eq!(read(&bytes_of(&simulated)).expect("read"), read(&bytes_of(&measured)).expect("read"));
}

#[test]
fn a_flipped_bit_gives_an_error_or_the_same_data() {
    let bytes = bytes_of(&synthetic::outcome(3, 1, true));
    let whole = read(&bytes).expect("read");
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut refused = 0;
    for _ in 0..200 {
        let mut damaged = bytes.clone();
        let bit = rng.random_range(0..8 * bytes.len());
        damaged[bit / 8] ^= 1 << (bit % 8);
        match read(&damaged) {
            Ok(recording) => assert_eq!(recording, whole, "bit {bit}"),
            Err(_) => refused += 1,
        }
    }
    // Every byte is under a checksum.
    assert_eq!(refused, 200);
}

#[test]
fn a_truncated_file_gives_an_error() {
    let bytes = bytes_of(&synthetic::outcome(3, 1, true));
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let lengths = (0..90).map(|_| rng.random_range(0..bytes.len()));
    for length in lengths.chain(bytes.len() - 10..bytes.len()) {
        let error = read(&bytes[..length]).expect_err("cut off");
        let expected = if length < MAGIC.len() {
            matches!(error, RecordingError::NotMcap)
        } else {
            matches!(error, RecordingError::Truncated)
        };
        assert!(expected, "{length} bytes: {error}");
    }
    let mut longer = bytes;
    longer.push(0);
    assert!(matches!(read(&longer), Err(RecordingError::Corrupt { .. })));
}

/// Damage under sound checksums can only come from another program; it may be believed, but it must not panic.
#[test]
fn nonsense_under_sound_checksums_does_not_panic() {
    let bytes = bytes_of(&synthetic::outcome(2, 1, true));
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut refused = 0;
    for _ in 0..60 {
        let damaged = rewritten(&bytes, &mut |_, data| {
            for _ in 0..3 {
                if !data.is_empty() {
                    let at = rng.random_range(0..data.len());
                    data[at] = rng.random();
                }
            }
            true
        });
        refused += usize::from(read(&damaged).is_err());
    }
    assert_eq!(refused, 60, "the provenance hash notices at least the attachments");
    for _ in 0..60 {
        let damaged = rewritten(&bytes, &mut |topic, data| {
            if topic.starts_with('/') && !data.is_empty() {
                let at = rng.random_range(0..data.len());
                data[at] = rng.random();
            }
            true
        });
        let _ = read(&damaged);
    }
}

#[test]
fn every_refusal_is_its_own() {
    let outcome = synthetic::outcome(3, 1, false);
    let bytes = bytes_of(&outcome);
    assert!(read(&rewritten(&bytes, &mut |_, _| true)).is_ok());
    type Kept = fn(&str, &mut Vec<u8>) -> bool;
    type Fits = fn(&RecordingError) -> bool;
    let cases: [(Kept, Fits); 7] = [
        (
            |place, _| place.starts_with("/tf") || place == "attachment",
            |e| matches!(e, RecordingError::Foreign),
        ),
        (|place, _| place != "attachment", |e| matches!(e, RecordingError::MissingAttachments { .. })),
        (
            |place, _| !place.starts_with("/measurement"),
            |e| matches!(e, RecordingError::NoMeasurements { sets: 2 }),
        ),
        (|place, _| place != "/session", |e| matches!(e, RecordingError::InvalidMessage { .. })),
        (
            |place, data| {
                if place == "metadata schema" {
                    *data = b"calibrig.recording/3".to_vec();
                }
                true
            },
            |e| matches!(e, RecordingError::NewerSchema { .. }),
        ),
        (
            |place, data| {
                if place == "metadata seed" {
                    *data = b"8".to_vec();
                }
                true
            },
            |e| matches!(e, RecordingError::AlteredProvenance { .. }),
        ),
        (
            |place, data| {
                if place.starts_with("/measurement") {
                    data.push(0xff);
                }
                true
            },
            |e| matches!(e, RecordingError::InvalidMessage { .. }),
        ),
    ];
    for (i, (change, fits)) in cases.into_iter().enumerate() {
        let error = read(&rewritten(&bytes, &mut |place, data| change(place, data))).expect_err("refused");
        assert!(fits(&error), "case {i}: {error:?}");
    }

    let mut last = 0;
    let shortened = rewritten(&bytes, &mut |place, _| {
        last += usize::from(place.starts_with("/measurement"));
        !place.starts_with("/measurement") || last != 3
    });
    let error = read(&shortened).expect_err("one observation is missing");
    assert!(
        matches!(error, RecordingError::MissingMeasurements { set: "identification", expected: 3, found: 2 }),
        "{error:?}"
    );

    assert!(matches!(read(b""), Err(RecordingError::NotMcap)));
    assert!(matches!(read(b"PK\x03\x04 a zip file"), Err(RecordingError::NotMcap)));
    let missing = read_recording(Path::new("no/such/recording.mcap")).expect_err("not there");
    assert!(missing.to_string().contains("no/such/recording.mcap"));
    let folder = tempfile::tempdir().expect("a folder");
    assert!(matches!(read_recording(folder.path()), Err(RecordingError::Unreadable { .. })));
}

#[test]
fn copies_of_other_writers_are_read_whole_and_what_no_checksum_covers_is_told() {
    let bytes = bytes_of(&synthetic::outcome(2, 1, false));
    let whole = read(&bytes).expect("read");
    assert!(whole.unprotected.is_nothing());
    let options = mcap::WriteOptions::new;
    // Without a checksum of the chunks mcap writes that of the data wrong.
    let bare = || options().calculate_chunk_crcs(false).calculate_data_section_crc(false);
    for (written, holds_data, nothing) in [
        (options().compression(None), false, true),
        (bare(), true, false),
        (bare().compression(None).calculate_summary_section_crc(false), true, false),
        (options().calculate_data_section_crc(false), false, false),
        (options().calculate_summary_section_crc(false), false, false),
        (options().use_chunks(false), false, true),
        (options().use_chunks(false).calculate_data_section_crc(false), true, false),
    ] {
        let copy = rewritten_with(written, None, &bytes, &mut |_, _| true);
        let recording = read(&copy).expect("read");
        let unprotected = recording.unprotected;
        assert_eq!((unprotected.holds_data(), unprotected.is_nothing()), (holds_data, nothing));
        assert_eq!(Recording { unprotected: whole.unprotected, ..recording }, whole);
    }
}

/// Where no checksum covers the data, a record without a kind must not hide all that comes after it.
#[test]
fn a_record_whose_opcode_is_lost_is_an_error_without_checksums_too() {
    let options = mcap::WriteOptions::new().use_chunks(false).calculate_data_section_crc(false);
    let bytes = rewritten_with(options, None, &bytes_of(&synthetic::outcome(2, 1, false)), &mut |_, _| true);
    assert!(read(&bytes).is_ok());
    let (mut at, mut count) = (mcap::MAGIC.len(), 0);
    while bytes[at] != records::op::DATA_END {
        let mut damaged = bytes.clone();
        damaged[at] = 0;
        assert!(read(&damaged).is_err(), "the record at byte {at} and all behind it are missing");
        let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().expect("eight bytes"));
        (at, count) = (at + 9 + usize::try_from(length).expect("a length"), count + 1);
    }
    assert!(count > 20, "{count}");
}

#[test]
fn topics_can_be_left_out() {
    let outcome = synthetic::outcome(4, 2, true);
    let bytes = bytes_of(&outcome);
    let without_nests = read_without(&bytes, &["/nest"]).expect("read");
    let stations = without_nests.sets.iter().flat_map(|set| &set.measurements.stations);
    assert!(stations.clone().count() > 0 && stations.clone().all(|station| station.nests.is_empty()));
    let fitted = read_without(&bytes, &["/measurement/verification", "/estimate"]).expect("read");
    assert_eq!(fitted.sets.iter().map(|set| set.kind).collect::<Vec<_>>(), [SetKind::Identification]);
    assert!(fitted.estimates.is_empty() && fitted.missing.is_empty());
    assert!(read_without(&bytes, &["/truth"]).expect("read") == read(&bytes).expect("read"));
    let error = read_without(&bytes, &["/nests"]).expect_err("no such topic");
    assert!(
        matches!(&error, RecordingError::NoSuchTopic { known, .. } if known.contains(&"/nest".to_owned()))
    );
    let error = read_without(&bytes, &["/measurement"]).expect_err("nothing is left");
    assert!(matches!(error, RecordingError::NoMeasurements { .. }), "{error:?}");
}

#[test]
fn what_another_program_recorded_needs_sessions_and_measurements_alone() {
    let outcome = synthetic::outcome(4, 2, false);
    // As Python's writer leaves it: no metadata of ours, no checksum over the whole, nobody counted.
    let options = mcap::WriteOptions::new().calculate_data_section_crc(false);
    let bytes = rewritten_with(options, None, &bytes_of(&outcome), &mut |place, data| {
        if place.starts_with("/measurement") {
            let mut message = v1::Observation::decode(data.as_slice()).expect("ours");
            message.index = 0;
            *data = message.encode_to_vec();
        }
        ["/session", "/nest", "/measurement/identification", "/measurement/verification"].contains(&place)
    });
    let recording = read(&bytes).expect("read");
    assert_eq!(recording.provenance, None);
    assert!(recording.sources.is_empty() && recording.estimates.is_empty() && recording.missing.is_empty());
    for (read, set) in recording.sets.iter().zip(&outcome.sets) {
        assert_eq!(read.measurements, set.measurements);
    }
}

#[test]
fn a_session_that_does_not_end_is_told() {
    let outcome = synthetic::outcome(4, 2, false);
    let bytes = rewritten(&bytes_of(&outcome), &mut |place, _| place != "/session/end");
    let recording = read(&bytes).expect("read");
    let missing = |kind, found, expected| MissingPart { kind, found, expected: Some(expected) };
    // One planned pose of either set was dropped.
    assert_eq!(
        recording.missing,
        [missing(SetKind::Identification, 4, 5), missing(SetKind::Verification, 2, 3)]
    );
}

#[test]
fn a_set_whose_description_was_lost_is_left_out_and_told() {
    let outcome = synthetic::outcome(4, 2, false);
    let lost = |kind: SetKind| {
        move |place: &str, data: &mut Vec<u8>| {
            let session = || v1::Session::decode(&data[..]).expect("ours");
            place != "/session" || session().set != kind.key()
        }
    };
    let bytes = bytes_of(&outcome);
    let saved = |kind| rewritten_with(mcap::WriteOptions::new(), Some(RECOVERED), &bytes, &mut lost(kind));
    let recording = read(&saved(SetKind::Verification)).expect("read");
    assert_eq!(recording.sets, outcome.sets[..1]);
    let missing = MissingPart { kind: SetKind::Verification, found: 0, expected: None };
    assert_eq!(recording.missing, [missing]);
    let error = read(&saved(SetKind::Identification)).expect_err("nothing to fit");
    assert!(matches!(error, RecordingError::NoMeasurements { .. }), "{error:?}");
    // Nothing but damage loses a session: elsewhere it is a mistake of whoever wrote the file.
    let error = read(&rewritten(&bytes, &mut lost(SetKind::Verification))).expect_err("refused");
    assert!(matches!(error, RecordingError::InvalidMessage { .. }), "{error:?}");
}

#[test]
fn recordings_of_the_first_schema_are_still_read() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/recording/schema1.mcap");
    let recording = read_recording(&path).expect("read");
    let counts = recording.sets.iter().map(|set| (set.kind, set.measurements.observations.len()));
    assert_eq!(counts.collect::<Vec<_>>(), [(SetKind::Identification, 12), (SetKind::Verification, 4)]);
    let station = &recording.sets[0].measurements.stations[0];
    assert_eq!(station.nests.len(), 7);
    assert!(recording.missing.is_empty());
    assert_eq!(recording.provenance.expect("ours").seed, Some(1));
    assert_eq!(recording.estimates.len(), 1);
}
