//! Reads a recording back: whole and as written, or not at all. What is recorded of the truth is never looked at.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use mcap::records::{self, Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{MAGIC, McapError};
use nalgebra::Vector3;
use prost::{Message, Name};

use super::mcap_writer::RECORD_LIMIT;
use super::provenance::{AttachedInput, METADATA, source_of};
use super::schema::{self, v1};
use super::{Provenance, RecordingError};
use crate::geometry::Transform;
use crate::input::Source;
use crate::pipeline::SetOutcome;

/// A recording, as far as a replay needs it.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// Where it comes from.
    pub provenance: Provenance,
    /// The input files by role, named without their folder.
    pub sources: Vec<(String, Source)>,
    /// What was measured, in the order recorded.
    pub sets: Vec<SetOutcome>,
    /// What was made of it then, by mode.
    pub estimates: Vec<RecordedEstimate>,
}

/// The recorded result of a mode.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedEstimate {
    /// Key of the mode.
    pub mode: String,
    /// What was identified.
    pub parameters: Vec<RecordedParameter>,
    /// Weighted sum of squares at the minimum; `None` where nothing was identified.
    pub chi2: Option<f64>,
    /// Rows minus parameters.
    pub degrees_of_freedom: Option<u64>,
    /// Key of the termination reason; empty where nothing was identified.
    pub termination: String,
    /// Number of iterations.
    pub iterations: usize,
    /// `tracker_from_base`, one a station.
    pub stations: Vec<Transform>,
    /// Offsets in the flange frame, m, one a target.
    pub targets: Vec<Vector3<f64>>,
}

/// A recorded parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedParameter {
    /// Name, as [`ParameterId`](crate::model::ParameterId) prints it.
    pub name: String,
    /// Deviation from the nominal value, m or rad.
    pub value: f64,
    /// Standard deviation, m or rad; `None` from a singular system.
    pub sigma: Option<f64>,
}

/// Reads the recording at `path`. Every byte is covered by a checksum: what is returned is what was written.
///
/// # Errors
/// The file is not an MCAP file, breaks off, is damaged, was written by another program or a later version, or lacks input files or
/// measurements: each error says what is missing and what was expected.
pub fn read_recording(path: &Path) -> Result<Recording, RecordingError> {
    let unreadable = |source| RecordingError::Unreadable { path: path.to_path_buf(), source };
    let mut file = BufReader::new(File::open(path).map_err(unreadable)?);
    read_from(&mut file).map_err(|error| match error {
        ReadError::Io(source) => unreadable(source),
        ReadError::Recording(error) => error,
    })
}

/// An error that does not yet know the file's name.
#[derive(Debug)]
pub(super) enum ReadError {
    Io(std::io::Error),
    Recording(RecordingError),
}

impl From<std::io::Error> for ReadError {
    fn from(error: std::io::Error) -> Self {
        Self::Io(error)
    }
}

impl From<RecordingError> for ReadError {
    fn from(error: RecordingError) -> Self {
        Self::Recording(error)
    }
}

impl From<McapError> for ReadError {
    fn from(error: McapError) -> Self {
        Self::Recording(match error {
            McapError::UnexpectedEof => RecordingError::Truncated,
            source => RecordingError::Corrupt { source },
        })
    }
}

pub(super) fn read_from(file: &mut (impl Read + Seek)) -> Result<Recording, ReadError> {
    check_magic(file)?;
    check_integrity(file)?;
    let mut contents = Contents::default();
    scan(file, false, &mut |opcode, body| contents.record(opcode, body))?;
    Ok(contents.finish()?)
}

fn check_magic(file: &mut (impl Read + Seek)) -> Result<(), ReadError> {
    let mut start = Vec::new();
    file.by_ref().take(MAGIC.len() as u64).read_to_end(&mut start)?;
    if start == MAGIC { Ok(()) } else { Err(RecordingError::NotMcap.into()) }
}

/// Is given every record: its opcode and its body.
type Visitor<'a> = dyn FnMut(u8, &[u8]) -> Result<(), ReadError> + 'a;

/// Passes every record of the file to `visit`, with all checksums validated; chunks whole or by their records.
fn scan(file: &mut (impl Read + Seek), whole_chunks: bool, visit: &mut Visitor<'_>) -> Result<(), ReadError> {
    file.seek(SeekFrom::Start(0))?;
    let options = LinearReaderOptions::default()
        .with_check_finishes_after_end_magic(true)
        .with_emit_chunks(whole_chunks)
        .with_validate_chunk_crcs(true)
        // Without this, records are handed out before their checksum is known.
        .with_prevalidate_chunk_crcs(true)
        .with_validate_data_section_crc(true)
        .with_validate_summary_section_crc(true)
        // Without this, a damaged length asks for more memory than there is.
        .with_record_length_limit(RECORD_LIMIT);
    let mut reader = LinearReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event? {
            LinearReadEvent::ReadRequest(wanted) => {
                let read = file.read(reader.insert(wanted))?;
                reader.notify_read(read);
            }
            LinearReadEvent::Record { data, opcode } => visit(opcode, data)?,
        }
    }
    Ok(())
}

/// Reads the whole file once for its checksums. A checksum of zero means "none" in MCAP: that every part has one is checked as well.
fn check_integrity(file: &mut (impl Read + Seek)) -> Result<(), ReadError> {
    let mut data_end = false;
    let mut footer = false;
    scan(file, true, &mut |opcode, body| {
        match opcode {
            op::CHUNK => check_chunk(body)?,
            op::ATTACHMENT => check_attachment(body)?,
            op::DATA_END => {
                let Record::DataEnd(end) = mcap::parse_record(opcode, body)? else { return Ok(()) };
                data_end = end.data_section_crc != 0;
            }
            op::FOOTER => {
                let Record::Footer(end) = mcap::parse_record(opcode, body)? else { return Ok(()) };
                footer = end.summary_crc != 0;
            }
            _ => {}
        }
        Ok(())
    })?;
    if data_end && footer {
        return Ok(());
    }
    let found = "a part of it has no checksum".to_owned();
    Err(RecordingError::Unprotected { found, expected: "checksums of the data and the summary section" }
        .into())
}

/// Chunks of another kind are not decoded: the decoder's arithmetic relies on sound lengths.
fn check_chunk(body: &[u8]) -> Result<(), ReadError> {
    let Record::Chunk { header, .. } = mcap::parse_record(op::CHUNK, body)? else { return Ok(()) };
    if header.compression == "zstd" && header.uncompressed_crc != 0 {
        return Ok(());
    }
    let found = format!(
        "a chunk with compression {:?} and checksum {:08x}",
        header.compression, header.uncompressed_crc
    );
    Err(RecordingError::Unprotected {
        found,
        expected: "chunks compressed with zstd, each with its checksum",
    }
    .into())
}

/// An attachment's lengths must lie in its record: the parser trusts them.
fn check_attachment(body: &[u8]) -> Result<(), ReadError> {
    if attachment_length(body) == Some(body.len()) {
        return Ok(());
    }
    Err(McapError::BadAttachmentLength { header: body.len() as u64, available: body.len() as u64 }.into())
}

/// Length of an attachment record from the lengths in it: two times, name, media type, data, checksum.
fn attachment_length(body: &[u8]) -> Option<usize> {
    let mut at = 16_usize;
    for _ in 0..2 {
        let length = u32::from_le_bytes(body.get(at..at.checked_add(4)?)?.try_into().ok()?);
        at = at.checked_add(4)?.checked_add(usize::try_from(length).ok()?)?;
    }
    let length = u64::from_le_bytes(body.get(at..at.checked_add(8)?)?.try_into().ok()?);
    at.checked_add(8)?.checked_add(usize::try_from(length).ok()?)?.checked_add(4)
}

/// What has been read so far.
#[derive(Default)]
struct Contents {
    metadata: Option<BTreeMap<String, String>>,
    inputs: Vec<AttachedInput>,
    /// Name by number.
    schemas: HashMap<u16, String>,
    /// Topic and schema by number.
    channels: HashMap<u16, (String, u16)>,
    sets: Vec<SetInProgress>,
    estimates: Vec<RecordedEstimate>,
    /// Behind the data section the summary repeats schemas and channels.
    ended: bool,
}

struct SetInProgress {
    set: SetOutcome,
    expected: usize,
}

impl Contents {
    fn record(&mut self, opcode: u8, body: &[u8]) -> Result<(), ReadError> {
        if self.ended {
            return Ok(());
        }
        match mcap::parse_record(opcode, body)? {
            Record::Metadata(metadata) if metadata.name == METADATA => {
                self.metadata.get_or_insert(metadata.metadata);
            }
            Record::Attachment { header, data, .. } => {
                // Input files are texts; another attachment is not ours, and shows in the hash.
                self.inputs.push((header.name, String::from_utf8_lossy(&data).into_owned()));
            }
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, header.name);
            }
            Record::Channel(channel) => {
                self.channels.insert(channel.id, (channel.topic, channel.schema_id));
            }
            Record::Message { header, data } => self.message(&header, &data)?,
            Record::DataEnd(_) => self.ended = true,
            _ => {}
        }
        Ok(())
    }

    fn message(&mut self, header: &records::MessageHeader, data: &[u8]) -> Result<(), RecordingError> {
        // Another program's messages are found out by the missing metadata.
        let Some((topic, schema)) = self.channels.get(&header.channel_id).cloned() else { return Ok(()) };
        let schema = self.schemas.get(&schema).map_or("none", String::as_str).to_owned();
        let read = match topic.as_str() {
            "/session" => decode(&schema, data).and_then(|message| self.session(&message)),
            "/measurement" => decode(&schema, data).and_then(|message| self.observation(&message)),
            estimate if estimate.starts_with("/estimate/") => {
                decode(&schema, data).and_then(|message| self.estimate(message))
            }
            _ => Ok(()),
        };
        read.map_err(|reason| RecordingError::InvalidMessage { topic, sequence: header.sequence, reason })
    }

    fn session(&mut self, message: &v1::Session) -> Result<(), String> {
        let set = SetOutcome::try_from(message)?;
        if self.sets.iter().any(|known| known.set.kind == set.kind) {
            return Err(format!("the {} set is described twice", set.kind.key()));
        }
        let expected = usize::try_from(message.observation_count).map_err(|e| e.to_string())?;
        self.sets.push(SetInProgress { set, expected });
        Ok(())
    }

    fn observation(&mut self, message: &v1::Observation) -> Result<(), String> {
        let kind = schema::set_kind(&message.set)?;
        let known = self.sets.iter_mut().find(|known| known.set.kind == kind);
        let set = &mut known.ok_or_else(|| format!("no session describes the {} set", kind.key()))?.set;
        let place = set.measurements.observations.len();
        if usize::try_from(message.index) != Ok(place) {
            return Err(format!(
                "observation {} of the {} set where {place} was expected",
                message.index,
                kind.key()
            ));
        }
        let observation = schema::to_observation(message, set)?;
        set.measurements.observations.push(observation);
        Ok(())
    }

    fn estimate(&mut self, message: v1::Estimate) -> Result<(), String> {
        if self.estimates.iter().any(|known| known.mode == message.mode) {
            return Err(format!("mode {} has two estimates", message.mode));
        }
        let parameter = |p: v1::Parameter| {
            let value = p.value.ok_or_else(|| format!("parameter {} has no value", p.name))?;
            Ok::<_, String>(RecordedParameter { name: p.name, value, sigma: p.sigma })
        };
        self.estimates.push(RecordedEstimate {
            mode: message.mode,
            parameters: message.parameters.into_iter().map(parameter).collect::<Result<_, _>>()?,
            chi2: message.chi2,
            degrees_of_freedom: message.degrees_of_freedom,
            termination: message.termination,
            iterations: message.iterations.len(),
            stations: message.stations.iter().map(schema::to_pose).collect::<Result<_, _>>()?,
            targets: message.targets.iter().map(schema::to_point).collect::<Result<_, _>>()?,
        });
        Ok(())
    }

    fn finish(self) -> Result<Recording, RecordingError> {
        let metadata = self.metadata.ok_or(RecordingError::Foreign)?;
        let provenance = Provenance::check(&metadata, &self.inputs)?;
        if self.sets.iter().all(|known| known.set.measurements.observations.is_empty()) {
            return Err(RecordingError::NoMeasurements { sets: self.sets.len() });
        }
        for SetInProgress { set, expected } in &self.sets {
            let found = set.measurements.observations.len();
            if found != *expected {
                let set = set.kind.key();
                return Err(RecordingError::MissingMeasurements { set, expected: *expected, found });
            }
        }
        Ok(Recording {
            provenance,
            sources: self.inputs.into_iter().map(source_of).collect(),
            sets: self.sets.into_iter().map(|known| known.set).collect(),
            estimates: self.estimates,
        })
    }
}

fn decode<M: Message + Name + Default>(schema: &str, data: &[u8]) -> Result<M, String> {
    if schema != M::full_name() {
        return Err(format!("its schema is {schema}, {} was expected", M::full_name()));
    }
    M::decode(data).map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    use mcap::{Attachment, Writer};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use crate::pipeline::Outcome;
    use crate::recording::{McapRecorder, record, synthetic, write_mcap};

    fn bytes_of(outcome: &Outcome) -> Vec<u8> {
        let mut file = Cursor::new(Vec::new());
        let mut recorder = McapRecorder::new(&mut file).expect("begun");
        record(outcome, &mut recorder).expect("recorded");
        recorder.finish().expect("finished");
        file.into_inner()
    }

    fn read(bytes: &[u8]) -> Result<Recording, RecordingError> {
        read_from(&mut Cursor::new(bytes)).map_err(|error| match error {
            ReadError::Recording(error) => error,
            ReadError::Io(error) => panic!("no I/O in memory: {error}"),
        })
    }

    /// A sound MCAP file with the given records of a recording, and `change` applied to every message, metadata text and attachment.
    fn rewritten(bytes: &[u8], change: &mut dyn FnMut(&str, &mut Vec<u8>) -> bool) -> Vec<u8> {
        let mut file = Cursor::new(Vec::new());
        let mut writer = Writer::new(&mut file).expect("begun");
        let mut channels: HashMap<u16, (String, u16)> = HashMap::new();
        let mut schemas = HashMap::new();
        scan(&mut Cursor::new(bytes), false, &mut |opcode, body| {
            match mcap::parse_record(opcode, body).expect("sound") {
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
                Record::DataEnd(_) => return Err(RecordingError::NotMcap.into()),
                _ => {}
            }
            Ok(())
        })
        .expect_err("stopped at the end of the data");
        writer.finish().expect("finished");
        drop(writer);
        file.into_inner()
    }

    #[test]
    fn what_was_recorded_is_read_back_bit_for_bit() {
        for truth in [true, false] {
            let outcome = synthetic::outcome(12, 5, truth);
            let folder = tempfile::tempdir().expect("a folder");
            let path = folder.path().join("recording.mcap");
            write_mcap(&outcome, &path).expect("written");
            let recording = read_recording(&path).expect("read");
            // `{:?}` tells -0.0 from 0.0 and prints enough digits for every bit.
            assert_eq!(format!("{:?}", recording.sets), format!("{:?}", outcome.sets));
            assert_eq!(recording.provenance.seed, outcome.input.seed);
            assert_eq!(recording.provenance.input_sha256, outcome.input.sha256);
            assert_eq!(recording.sources.len(), outcome.sources.len());
            for ((role, source), (recorded_role, recorded)) in outcome.sources.iter().zip(&recording.sources)
            {
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
                    assert_eq!(crate::model::ParameterId::parse(&r.name), Some(p.id));
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
    fn unsound_lengths_in_an_attachment_do_not_panic() {
        let mut body = vec![0; 16];
        body.extend(u32::to_le_bytes(1));
        body.push(b'a');
        body.extend(u32::to_le_bytes(0));
        body.extend(u64::to_le_bytes(2));
        body.extend(*b"hi");
        assert!(check_attachment(&body).is_err(), "the checksum is missing");
        body.extend([0; 4]);
        assert!(check_attachment(&body).is_ok());
        for length in 0..body.len() {
            assert!(check_attachment(&body[..length]).is_err());
        }
        body[16..20].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(check_attachment(&body).is_err());
    }

    #[test]
    fn every_refusal_is_its_own() {
        let outcome = synthetic::outcome(3, 1, false);
        let bytes = bytes_of(&outcome);
        assert!(read(&rewritten(&bytes, &mut |_, _| true)).is_ok());
        type Kept = fn(&str, &mut Vec<u8>) -> bool;
        type Fits = fn(&RecordingError) -> bool;
        let cases: [(Kept, Fits); 7] = [
            (|place, _| !place.starts_with("metadata"), |e| matches!(e, RecordingError::Foreign)),
            (|place, _| place != "attachment", |e| matches!(e, RecordingError::MissingAttachments { .. })),
            (|place, _| place != "/measurement", |e| matches!(e, RecordingError::NoMeasurements { sets: 2 })),
            (|place, _| place != "/session", |e| matches!(e, RecordingError::InvalidMessage { .. })),
            (
                |place, data| {
                    if place == "metadata schema" {
                        *data = b"calibrig.recording/2".to_vec();
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
                    if place == "/measurement" {
                        data.push(0xff);
                    }
                    true
                },
                |e| matches!(e, RecordingError::InvalidMessage { .. }),
            ),
        ];
        for (i, (change, fits)) in cases.into_iter().enumerate() {
            let error =
                read(&rewritten(&bytes, &mut |place, data| change(place, data))).expect_err("refused");
            assert!(fits(&error), "case {i}: {error:?}");
        }

        let mut last = 0;
        let shortened = rewritten(&bytes, &mut |place, _| {
            last += usize::from(place == "/measurement");
            place != "/measurement" || last != 3
        });
        let error = read(&shortened).expect_err("one observation is missing");
        assert!(
            matches!(
                error,
                RecordingError::MissingMeasurements { set: "identification", expected: 3, found: 2 }
            ),
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
    fn chunks_without_a_checksum_are_refused() {
        let bytes = bytes_of(&synthetic::outcome(2, 1, false));
        for unprotected in [
            mcap::WriteOptions::new().calculate_chunk_crcs(false),
            mcap::WriteOptions::new().compression(None),
            mcap::WriteOptions::new().calculate_data_section_crc(false),
            mcap::WriteOptions::new().calculate_summary_section_crc(false),
        ] {
            let mut file = Cursor::new(Vec::new());
            let mut writer = unprotected.create(&mut file).expect("begun");
            let mut schema = 0;
            scan(&mut Cursor::new(&bytes), false, &mut |opcode, body| {
                if let Record::Schema { header, data } = mcap::parse_record(opcode, body)? {
                    schema = writer.add_schema(&header.name, &header.encoding, &data)?;
                }
                Ok(())
            })
            .expect("read");
            let channel =
                writer.add_channel(schema, "/measurement", "protobuf", &BTreeMap::new()).expect("added");
            let header =
                records::MessageHeader { channel_id: channel, sequence: 0, log_time: 0, publish_time: 0 };
            writer.write_to_known_channel(&header, &[]).expect("written");
            writer.finish().expect("finished");
            drop(writer);
            let error = read(&file.into_inner()).expect_err("unprotected");
            assert!(matches!(error, RecordingError::Unprotected { .. }), "{error:?}");
        }
    }
}
