//! What the summary section at the end of an MCAP file tells of the rest, where it is there and sound.

use std::collections::{BTreeMap, HashMap};
use std::io::{Read, Seek, SeekFrom};

use mcap::MAGIC;
use mcap::records::{Channel, Record, SchemaHeader, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::mcap_writer::RECORD_LIMIT;

/// Length of a footer record.
const FOOTER: u64 = 9 + 20;
/// Length of the record that ends the data section.
const DATA_END: u64 = 9 + 4;

/// A schema: its name, encoding and text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Schema {
    pub header: SchemaHeader,
    pub data: Vec<u8>,
}

/// Schemas and channels by number.
#[derive(Debug, Clone, Default)]
pub(super) struct Definitions {
    pub schemas: HashMap<u16, Schema>,
    pub channels: HashMap<u16, Channel>,
}

impl Definitions {
    /// Takes note of a schema or a channel.
    pub(super) fn learn(&mut self, record: Record<'_>) {
        match record {
            Record::Schema { header, data } => {
                self.schemas.insert(header.id, Schema { header, data: data.into_owned() });
            }
            Record::Channel(channel) => {
                self.channels.insert(channel.id, channel);
            }
            _ => {}
        }
    }

    /// A channel with its schema, where it has one. `None` if either is not known.
    pub(super) fn channel(&self, id: u16) -> Option<(&Channel, Option<&Schema>)> {
        let channel = self.channels.get(&id)?;
        match channel.schema_id {
            0 => Some((channel, None)),
            schema => Some((channel, Some(self.schemas.get(&schema)?))),
        }
    }
}

/// What the summary section tells.
#[derive(Debug, Clone, Default)]
pub(super) struct Directory {
    /// Of the whole file: those of a lost chunk, too.
    pub definitions: Definitions,
    /// Where chunks, attachments, metadata and the end of the data begin, in ascending order.
    landmarks: Vec<u64>,
    /// Where the data end.
    pub data_end: Option<u64>,
    /// Number of messages by channel.
    pub counts: Option<BTreeMap<u16, u64>>,
}

impl Directory {
    /// Reads the summary section of `file`; nothing where it is not there, damaged, or without a checksum.
    pub(super) fn of(file: &mut (impl Read + Seek)) -> std::io::Result<Self> {
        let length = file.seek(SeekFrom::End(0))?;
        Ok(match start(file, length)? {
            Some(start) => read(file, start)?.unwrap_or_default(),
            None => Self::default(),
        })
    }
}

/// Where the summary section begins, if the file ends as it should.
fn start(file: &mut (impl Read + Seek), length: u64) -> std::io::Result<Option<u64>> {
    let tail = FOOTER + MAGIC.len() as u64;
    let Some(footer) = length.checked_sub(tail) else { return Ok(None) };
    file.seek(SeekFrom::Start(footer))?;
    let mut bytes = Vec::new();
    file.by_ref().take(tail).read_to_end(&mut bytes)?;
    let sound = bytes.first() == Some(&op::FOOTER)
        && bytes.get(1..9) == Some(&20_u64.to_le_bytes()[..])
        && bytes.ends_with(MAGIC);
    let number = bytes.get(9..17).and_then(|number| number.try_into().ok()).map(u64::from_le_bytes);
    let protected = bytes.get(25..29).is_some_and(|crc| crc != [0; 4]);
    let in_range = |start: &u64| (DATA_END..footer).contains(start);
    Ok(number.filter(in_range).filter(|_| sound && protected))
}

/// Reads the section that begins at `start`. `None` if its checksum does not fit.
fn read(file: &mut (impl Read + Seek), start: u64) -> std::io::Result<Option<Directory>> {
    // The checksum begins behind the end of the data.
    file.seek(SeekFrom::Start(start - DATA_END))?;
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_emit_chunks(true)
        .with_validate_summary_section_crc(true)
        .with_record_length_limit(RECORD_LIMIT);
    let mut reader = LinearReader::new_with_options(options);
    let data_end = start - DATA_END;
    let mut directory =
        Directory { landmarks: vec![data_end], data_end: Some(data_end), ..Directory::default() };
    let mut ends = (false, false);
    while let Some(event) = reader.next_event() {
        let (opcode, data) = match event {
            Ok(LinearReadEvent::ReadRequest(wanted)) => {
                let read = file.read(reader.insert(wanted))?;
                reader.notify_read(read);
                continue;
            }
            Ok(LinearReadEvent::Record { opcode, data }) => (opcode, data),
            Err(_) => return Ok(None),
        };
        match opcode {
            op::DATA_END => ends.0 = true,
            op::FOOTER => ends.1 = true,
            op::SCHEMA
            | op::CHANNEL
            | op::CHUNK_INDEX
            | op::ATTACHMENT_INDEX
            | op::METADATA_INDEX
            | op::STATISTICS => match mcap::parse_record(opcode, data) {
                Ok(record) => directory.learn(record),
                Err(_) => return Ok(None),
            },
            _ => {}
        }
    }
    directory.landmarks.retain(|&mark| mark <= data_end);
    directory.landmarks.sort_unstable();
    Ok((ends == (true, true)).then_some(directory))
}

impl Directory {
    /// Whether a chunk, an attachment or a metadata record begins at `at`.
    pub(super) fn is_landmark(&self, at: u64) -> bool {
        self.landmarks.binary_search(&at).is_ok()
    }

    /// The first of them behind `at`, or the end of the data.
    pub(super) fn landmark_behind(&self, at: u64) -> Option<u64> {
        self.landmarks.get(self.landmarks.partition_point(|&mark| mark <= at)).copied()
    }

    fn learn(&mut self, record: Record<'_>) {
        match record {
            Record::ChunkIndex(index) => self.landmarks.push(index.chunk_start_offset),
            Record::AttachmentIndex(index) => self.landmarks.push(index.offset),
            Record::MetadataIndex(index) => self.landmarks.push(index.offset),
            Record::Statistics(statistics) => self.counts = Some(statistics.channel_message_counts),
            definition => self.definitions.learn(definition),
        }
    }
}
