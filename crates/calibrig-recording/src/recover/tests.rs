//! Whatever is damaged, what is saved of a file is of the original.

use super::*;
use std::cell::RefCell;
use std::io::{BufWriter, Cursor};
use std::rc::Rc;

use mcap::records::op;
use mcap::sans_io::linear_reader::LinearReaderOptions;
use mcap::{MessageStream, WriteOptions};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::framing::pull;
use crate::mcap_reader::read_from;
use crate::{McapRecorder, Measured, Preamble, ReadOptions, Recorder, Recording, TrueSetting, synthetic};
use calibrig_estimation::identification::Estimate;
use calibrig_model::measurement::SetKind;

fn inspected(bytes: &[u8]) -> Result<Inspection, ReadError> {
    inspect_file(&mut Cursor::new(bytes), "bad.mcap".to_owned())
}

/// What is saved of `bytes`; `None` where no message is.
fn saved(bytes: &[u8], inspection: &Inspection) -> Option<Vec<u8>> {
    let mut sink = Cursor::new(Vec::new());
    let copy = save(&mut Cursor::new(bytes), inspection, "hash".to_owned(), &mut sink);
    (inspection.recoverable.messages > 0).then(|| {
        copy.expect("saved");
        sink.into_inner()
    })
}

fn read(bytes: &[u8]) -> Result<Recording, ReadError> {
    read_from(&mut Cursor::new(bytes), &ReadOptions::default())
}

/// All that a message is, but the number of its channel.
type Said = (String, String, u32, u64, u64, Vec<u8>);

fn messages(sound: &[u8]) -> Vec<Said> {
    let all = MessageStream::new(sound).expect("a file").map(|message| message.expect("sound"));
    all.map(|m| {
        let schema = m.channel.schema.as_ref().map_or(String::new(), |schema| schema.name.clone());
        (m.channel.topic.clone(), schema, m.sequence, m.log_time, m.publish_time, m.data.into_owned())
    })
    .collect()
}

fn attachments(sound: &[u8]) -> Vec<(String, Vec<u8>)> {
    let mut found = Vec::new();
    pull(&mut Cursor::new(sound), LinearReaderOptions::default(), &mut |opcode, body| {
        if let Record::Attachment { header, data, .. } = mcap::parse_record(opcode, body)? {
            found.push((header.name, data.into_owned()));
        }
        Ok(())
    })
    .expect("sound");
    found
}

/// Every element of `part` is in `whole`, in the same order.
fn is_part<T: PartialEq>(part: &[T], whole: &[T]) -> bool {
    let mut rest = whole.iter();
    part.iter().all(|element| rest.any(|other| other == element))
}

/// Where the records of a sound file begin, with their opcodes.
fn records(sound: &[u8]) -> Vec<(usize, u8)> {
    let mut at = mcap::MAGIC.len();
    let mut found = Vec::new();
    pull(&mut Cursor::new(sound), LinearReaderOptions::default(), &mut |opcode, body| {
        found.push((at, opcode));
        at += 9 + body.len();
        Ok(())
    })
    .expect("sound");
    found
}

#[derive(Debug, Default)]
struct Counts {
    refused: usize,
    saved: usize,
    nothing: usize,
    complete: usize,
    replayable: usize,
}

/// A sound file, and what is in it.
struct Original {
    bytes: Vec<u8>,
    recording: Recording,
    messages: Vec<Said>,
    attachments: Vec<(String, Vec<u8>)>,
}

impl Original {
    fn new(bytes: Vec<u8>) -> Self {
        let recording = read(&bytes).expect("read");
        let (messages, attachments) = (messages(&bytes), attachments(&bytes));
        Self { bytes, recording, messages, attachments }
    }
}

/// Damage must show in reading; what is saved of it must be of the original, bit for bit.
fn check(damaged: &[u8], original: &Original, what: &str, counts: &mut Counts) {
    let Original { recording: whole, messages: sound, .. } = original;
    match read(damaged) {
        Ok(recording) => assert_eq!(&recording, whole, "{what}"),
        Err(_) => counts.refused += 1,
    }
    let Ok(inspection) = inspected(damaged) else {
        counts.nothing += 1;
        return;
    };
    assert_ne!(inspection.health.state, State::Whole, "{what}");
    let Some(copy) = saved(damaged, &inspection) else {
        counts.nothing += 1;
        return;
    };
    counts.saved += 1;
    let kept = messages(&copy);
    assert_eq!(kept.len() as u64, inspection.recoverable.messages, "{what}");
    assert!(is_part(&kept, sound), "{what}");
    assert!(is_part(&attachments(&copy), &original.attachments), "{what}");
    counts.complete += usize::from(kept.len() == sound.len());
    // What came behind the end of a file that breaks off is not known.
    if inspection.health.state == State::Damaged && !inspection.recoverable.anything_lost {
        assert_eq!(kept.len(), sound.len(), "{what}");
    }
    if let Some(lost) = inspection.recoverable.messages_lost {
        assert_eq!(kept.len() as u64 + lost, sound.len() as u64, "{what}");
    }
    let again = inspected(&copy).expect("an MCAP file");
    assert_eq!(again.health.state, State::Whole, "{what}: {again:?}");
    let Ok(recording) = read(&copy) else { return };
    counts.replayable += 1;
    assert!(recording.recovered, "{what}");
    if let Some(provenance) = &recording.provenance {
        assert_eq!(Some(provenance), whole.provenance.as_ref(), "{what}");
    }
    for set in &recording.sets {
        let of = whole.sets.iter().find(|other| other.kind == set.kind).expect("a set of the original");
        assert!(is_part(&set.measurements.observations, &of.measurements.observations), "{what}");
    }
}

#[test]
fn of_flipped_bits_and_truncations_everything_sound_is_saved_and_nothing_else() {
    let original = Original::new(synthetic::recorded(&synthetic::outcome(4, 2, true)));
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut flips = Counts::default();
    for _ in 0..2000 {
        let mut damaged = original.bytes.clone();
        let bit = rng.random_range(0..8 * damaged.len());
        damaged[bit / 8] ^= 1 << (bit % 8);
        check(&damaged, &original, &format!("bit {bit}"), &mut flips);
    }
    let mut cuts = Counts::default();
    for _ in 0..500 {
        let length = rng.random_range(0..original.bytes.len());
        check(&original.bytes[..length], &original, &format!("{length} bytes"), &mut cuts);
    }
    println!("{} bytes; flips {flips:?}; truncations {cuts:?}", original.bytes.len());
    assert_eq!((flips.refused, cuts.refused), (2000, 500));
    // Only the magic bytes are needed; a chunk that is lost leaves the others.
    assert!(flips.saved >= 1990, "{flips:?}");
    assert!(cuts.saved >= 300, "{cuts:?}");
}

#[test]
fn bytes_out_of_place_do_not_panic() {
    let original = synthetic::recorded(&synthetic::outcome(2, 1, true));
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let sound = messages(&original);
    for _ in 0..300 {
        let mut damaged = original.clone();
        let at = rng.random_range(8..original.len());
        let length = rng.random_range(1..200.min(original.len() - at + 1));
        match rng.random_range(0..3) {
            0 => damaged[at..at + length].fill(0),
            1 => damaged[at..at + length].fill_with(|| rng.random()),
            _ => drop(damaged.drain(at..at + length)),
        }
        let inspection = inspected(&damaged).expect("an MCAP file");
        if let Some(copy) = saved(&damaged, &inspection) {
            assert!(is_part(&messages(&copy), &sound), "{length} bytes at {at}");
        }
    }
}

#[test]
fn a_sound_file_is_found_whole() {
    let outcome = synthetic::outcome(4, 2, true);
    let inspection = inspected(&synthetic::recorded(&outcome)).expect("inspected");
    let health = &inspection.health;
    assert_eq!((health.state, health.damaged_at, health.bytes_unread), (State::Whole, None, 0));
    assert_eq!((health.checksum_of_data, health.checksum_of_summary), (Some(true), Some(true)));
    assert!(health.faults.is_empty() && health.without_checksum == 0);
    let provenance = inspection.provenance.as_ref().expect("ours");
    assert_eq!((provenance.state, provenance.seed), (ProvenanceState::Fits, Some(7)));
    let sound = messages(&synthetic::recorded(&outcome));
    assert_eq!(inspection.recoverable.messages, sound.len() as u64);
    for topic in &inspection.topics {
        let of: Vec<_> = sound.iter().filter(|message| message.0 == topic.topic).collect();
        assert_eq!(topic.messages, of.len() as u64, "{}", topic.topic);
        assert_eq!(topic.bytes, of.iter().map(|message| message.5.len() as u64).sum::<u64>());
        assert_eq!(topic.first_ns, of.iter().map(|message| message.3).min());
        assert_eq!((topic.last_ns, topic.lost), (of.iter().map(|message| message.3).max(), Some(0)));
    }
    for (report, set) in inspection.sets.iter().zip(&outcome.sets) {
        let measurements = &set.measurements;
        assert_eq!(report.observations, measurements.observations.len() as u64);
        let poses = measurements.observations.chunk_by(|a, b| a.pose == b.pose).count();
        assert_eq!((report.poses, report.dropped), (poses as u64, set.dropped.len() as u64));
        assert_eq!(report.planned, u32::try_from(poses + set.dropped.len()).ok());
        let nests: usize = measurements.stations.iter().map(|station| station.nests.len()).sum();
        assert_eq!((report.nests, report.stations), (nests as u64, measurements.stations.len() as u64));
        assert!(report.described && report.complete);
        let carried: Vec<_> = report.payloads.iter().map(|c| (c.name.as_deref(), c.poses)).collect();
        let plates = measurements.observations.iter().filter(|o| o.payload.is_some()).count();
        if plates == 0 {
            assert!(carried.is_empty(), "{carried:?}");
            continue;
        }
        assert_eq!(carried, [(None, poses - plates), (Some("plates, 25 kg"), plates)]);
        let words: Vec<_> = report.payloads.iter().map(ToString::to_string).collect();
        assert_eq!(words, ["nothing at 3 poses", "plates, 25 kg (25.0 kg) at 1 pose"]);
    }
    for (report, mode) in inspection.estimates.iter().zip(&outcome.modes) {
        assert_eq!(report.mode, mode.mode.key());
        let ratio = mode.estimate.as_ref().and_then(Estimate::chi2_per_dof);
        assert_eq!(report.chi2_per_dof, ratio);
    }
    assert_eq!(inspection.attachments.len(), outcome.sources.len());
}

#[test]
fn a_lost_chunk_costs_its_own_messages_alone() {
    let original = synthetic::recorded(&synthetic::outcome(6, 2, true));
    let sound = messages(&original);
    let records = records(&original);
    let chunks: Vec<usize> =
        records.iter().filter(|(_, opcode)| *opcode == op::CHUNK).map(|(at, _)| *at).collect();
    for (number, &at) in chunks.iter().enumerate() {
        // In its content, in its length, in its opcode.
        for (offset, flip) in [(60, 4), (8, 1), (0, 1)] {
            let mut damaged = original.clone();
            damaged[at + offset] ^= flip;
            let inspection = inspected(&damaged).expect("inspected");
            assert_eq!(inspection.health.damaged_at, Some(at as u64), "chunk {number}");
            let copy = saved(&damaged, &inspection).expect("saved");
            let kept = messages(&copy);
            assert!(is_part(&kept, &sound) && kept.len() < sound.len());
            assert_eq!(inspection.recoverable.messages_lost, Some((sound.len() - kept.len()) as u64));
            let lost: u64 = inspection.topics.iter().filter_map(|topic| topic.lost).sum();
            assert_eq!(Some(lost), inspection.recoverable.messages_lost);
            assert!(inspected(&copy).expect("inspected").recoverable.messages > 0);
        }
    }
    // The chunks of a session of eight poses are many: the damage of any is small.
    assert!(chunks.len() > 8, "{}", chunks.len());
}

#[test]
fn metadata_that_do_not_fit_are_kept_but_not_believed() {
    let outcome = synthetic::outcome(3, 1, false);
    let original = synthetic::recorded(&outcome);
    let at = original.windows(4).position(|bytes| bytes == b"seed").expect("in the metadata");
    let mut damaged = original.clone();
    damaged[at + 8] ^= 1;
    let inspection = inspected(&damaged).expect("inspected");
    let provenance = inspection.provenance.as_ref().expect("ours");
    assert_eq!((provenance.state, provenance.seed), (ProvenanceState::Altered, Some(6)));
    assert_eq!(inspection.recoverable.messages_lost, Some(0));
    let copy = saved(&damaged, &inspection).expect("saved");
    let again = inspected(&copy).expect("inspected");
    assert_eq!(again.metadata, [RECOVERED, ALTERED]);
    let recording = read(&copy).expect("read");
    assert_eq!(recording.provenance, None);
    assert_eq!(recording.sets, outcome.sets);
    assert_eq!(recording.sources.len(), outcome.sources.len());
    // Twice the same.
    assert_eq!(Some(copy), saved(&damaged, &inspection));
}

/// A sink that can be looked at while it is written.
#[derive(Clone, Default)]
struct Shared(Rc<RefCell<Cursor<Vec<u8>>>>);

impl Write for Shared {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.borrow_mut().write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl Seek for Shared {
    fn seek(&mut self, position: SeekFrom) -> std::io::Result<u64> {
        self.0.borrow_mut().seek(position)
    }
}

#[test]
fn a_kill_costs_one_per_cent_of_the_poses_or_one() {
    let outcome = synthetic::outcome(260, 0, true);
    let set = &outcome.sets[0];
    let observations = &set.measurements.observations;
    let truth = outcome.truth.as_ref().expect("simulated");
    let sink = Shared::default();
    let mut recorder = McapRecorder::new(BufWriter::new(sink.clone())).expect("begun");
    let preamble = Preamble {
        input: &outcome.input,
        sources: &outcome.sources,
        model: &outcome.model,
        visuals: &outcome.visuals,
        truth: Some(TrueSetting::of(truth)),
    };
    recorder.open(&preamble).expect("opened");
    recorder.set(0, set, Some(261)).expect("told");
    for (index, observation) in observations.iter().enumerate() {
        let measured = Measured {
            kind: set.kind,
            first: index,
            observations: std::slice::from_ref(observation),
            times: &[index as u64],
            truth: &truth.poses[0][index..=index],
            rigid: &[],
            effects: &[],
        };
        recorder.measured(&measured).expect("told");
        let killed = sink.0.borrow().get_ref().clone();
        let inspection = inspected(&killed).expect("inspected");
        assert_eq!(inspection.health.state, State::Unfinished, "{index}");
        let told = usize::try_from(inspection.sets[0].observations).expect("few");
        let behind = index + 1 - told;
        assert!(behind <= ((index + 1) / 100).max(1), "{behind} behind at {index}");
        // The pose at hand is lost where it was not flushed, and nothing else.
        assert_eq!(inspection.recoverable.anything_lost, behind > 0, "{index}");
        if index % 20 == 0 {
            let copy = saved(&killed, &inspection).expect("saved");
            let recording = read(&copy).expect("read");
            let kept = &recording.sets[0].measurements.observations;
            assert_eq!(kept[..], observations[..kept.len()]);
            assert_eq!((kept.len(), recording.missing[0].expected), (index + 1 - behind, Some(261)));
        }
    }
}

/// A file as other programs write them.
fn foreign(options: WriteOptions) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    let mut writer = options.profile("ros2").library("another").create(&mut file).expect("begun");
    let schema = writer.add_schema("pkg/Odd", "ros2msg", b"float64 x").expect("added");
    let metadata = [("qos".to_owned(), "1".to_owned())].into();
    let odom = writer.add_channel(schema, "/odom", "cdr", &metadata).expect("added");
    let bare = writer.add_channel(0, "/bare", "json", &metadata).expect("added");
    for number in 0..300_u32 {
        let channel_id = if number % 3 == 0 { bare } else { odom };
        let time = u64::from(number) * 10_000_000;
        let header = MessageHeader { channel_id, sequence: number, log_time: time + 5, publish_time: time };
        writer.write_to_known_channel(&header, &[number.to_le_bytes()[0]; 40]).expect("written");
    }
    writer.finish().expect("finished");
    drop(writer);
    file.into_inner()
}

#[test]
fn any_mcap_file_is_saved() {
    let small = || WriteOptions::new().chunk_size(Some(1000));
    for (options, least) in [
        (small(), 200),
        (small().compression(None), 200),
        (small().calculate_data_section_crc(false).emit_summary_records(false), 200),
        (WriteOptions::new().use_chunks(false), 190),
    ] {
        let original = foreign(options);
        let whole = inspected(&original).expect("inspected");
        assert_eq!((whole.health.state, whole.calibrig), (State::Whole, false), "{:?}", whole.health);
        assert_eq!(whole.recoverable.messages, 300);
        assert!(whole.sets.is_empty() && whole.provenance.is_none());
        let odom = whole.topics.iter().find(|topic| topic.topic == "/odom").expect("a topic");
        assert_eq!((odom.schema.as_str(), odom.encoding.as_str(), odom.messages), ("pkg/Odd", "cdr", 200));
        let rate = odom.rate_hz.expect("a rate");
        // 200 messages within 298 intervals of 10 ms, the last one and the first one included.
        assert!((rate - 199.0 / 2.97).abs() < 1.0, "{rate}");

        let end = records(&original).iter().find(|(_, opcode)| *opcode == op::DATA_END).expect("ends").0;
        let damaged = &original[..end * 7 / 10];
        let inspection = inspected(damaged).expect("inspected");
        assert_ne!(inspection.health.state, State::Whole);
        let copy = saved(damaged, &inspection).expect("saved");
        let (kept, sound) = (messages(&copy), messages(&original));
        assert_eq!(kept, sound[..kept.len()]);
        assert!((least..220).contains(&kept.len()), "{}", kept.len());
        let again = inspected(&copy).expect("inspected");
        assert_eq!((again.profile.as_str(), again.metadata.len()), ("ros2", 1));
        assert!(matches!(read(&copy), Err(ReadError::Recording(RecordingError::Foreign))));
    }
}

#[test]
fn chunks_that_no_checksum_vouches_for_are_looked_into_and_told() {
    for options in [WriteOptions::new(), WriteOptions::new().compression(None)] {
        let options = options.chunk_size(Some(1000)).calculate_chunk_crcs(false);
        // Without the one mcap writes the other one wrong.
        let original = foreign(options.calculate_data_section_crc(false));
        let whole = inspected(&original).expect("inspected");
        assert_eq!((whole.health.state, whole.recoverable.messages), (State::Whole, 300));
        assert_eq!(whole.health.without_checksum, 300);
        let damaged = &original[..original.len() * 6 / 10];
        let inspection = inspected(damaged).expect("inspected");
        let kept = messages(&saved(damaged, &inspection).expect("saved"));
        assert!(is_part(&kept, &messages(&original)) && kept.len() > 30, "{}", kept.len());
        assert_eq!(inspection.health.without_checksum, kept.len() as u64);
    }
    // Lengths in a chunk that do not fit, under a checksum that does: as no program writes it.
    let mut nested = foreign(WriteOptions::new().compression(None));
    let at = records(&nested).iter().find(|(_, opcode)| *opcode == op::CHUNK).expect("a chunk").0;
    // The length of the first record in it.
    nested[at + 9 + 40 + 1] = 0xff;
    let inspection = inspected(&nested).expect("inspected");
    assert_eq!(inspection.health.lost.get(&FaultyPart::Chunk), Some(&1));
}

#[test]
fn chunks_of_an_unknown_compression_are_not_looked_into() {
    let mut other = foreign(WriteOptions::new().calculate_data_section_crc(false));
    while let Some(at) = other.windows(8).position(|bytes| bytes == b"\x04\0\0\0zstd") {
        other[at + 4..at + 8].copy_from_slice(b"zst9");
    }
    // The summary repeats the name under its checksum; here it has none.
    let end = other.len() - mcap::MAGIC.len();
    other[end - 4..end].fill(0);
    let whole = inspected(&other).expect("inspected");
    assert_eq!((whole.health.state, whole.recoverable.messages), (State::Whole, 0));
    assert_eq!(whole.health.lost.get(&FaultyPart::OpaqueChunk), Some(&whole.health.chunks));
    let refused = read(&other);
    assert!(
        matches!(&refused, Err(ReadError::Recording(RecordingError::UnknownCompression { compression })) if compression == "zst9"),
        "{refused:?}"
    );
}

#[test]
fn a_file_is_saved_beside_itself() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    let original = synthetic::recorded(&synthetic::outcome(3, 1, true));
    std::fs::write(path("good"), &original).expect("written");
    std::fs::write(path("bad"), &original[..original.len() / 2]).expect("written");
    let mut told = Vec::new();
    let recovered = recover(&path("bad"), &path("new"), false, &mut |done, total| told.push((done, total)))
        .expect("recovered");
    assert!(!recovered.copied);
    assert!(told.is_sorted() && told.iter().all(|(done, total)| done <= total), "{told:?}");
    assert_eq!(crate::read_recording(&path("new")).expect("read").sets[0].kind, SetKind::Identification);
    let recovered = recover(&path("good"), &path("copy"), false, &mut |_, _| {}).expect("copied");
    assert!(recovered.copied);
    assert_eq!(std::fs::read(path("copy")).expect("read"), original);
    type Fits = fn(&RecordingError) -> bool;
    let refused: [(&str, &str, Fits); 4] = [
        ("bad", "bad", |error| matches!(error, RecordingError::SameFile { .. })),
        ("bad", "new", |error| matches!(error, RecordingError::Exists { .. })),
        ("none", "other", |error| matches!(error, RecordingError::Unreadable { .. })),
        ("bad", ".", |error| matches!(error, RecordingError::IsFolder { .. })),
    ];
    for (bad, good, fits) in refused {
        let error = recover(&path(bad), &path(good), false, &mut |_, _| {}).expect_err("refused");
        assert!(fits(&error), "{error:?}");
    }
    assert!(recover(&path("bad"), &path("new"), true, &mut |_, _| {}).is_ok());
}
