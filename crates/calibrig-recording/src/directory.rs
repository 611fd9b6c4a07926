//! What the summary section at the end of an MCAP file says about the rest of the file, if that section is complete and sound.

use std::collections::{BTreeMap, HashMap};
use std::io::{Read, Seek, SeekFrom};

use mcap::MAGIC;
use mcap::records::{Channel, Record, SchemaHeader, op};
use mcap::sans_io::linear_reader::LinearReaderOptions;

use super::framing::{ReadError, pull};

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
    /// Remembers a schema or a channel.
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

    /// A channel's topic and the name of its schema; `None` of a channel that is not known.
    pub(super) fn names(&self, id: u16) -> Option<(&str, &str)> {
        let channel = self.channels.get(&id)?;
        let schema = self.schemas.get(&channel.schema_id).map_or("none", |schema| &schema.header.name);
        Some((&channel.topic, schema))
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

/// The contents of the summary section.
#[derive(Debug, Clone, Default)]
pub(super) struct Directory {
    /// Of the whole file, lost chunks included.
    pub definitions: Definitions,
    /// Where chunks, attachments, metadata and the end of the data begin, in ascending order.
    landmarks: Vec<u64>,
    /// Where the data end.
    pub data_end: Option<u64>,
    /// Number of messages by channel.
    pub counts: Option<BTreeMap<u16, u64>>,
}

impl Directory {
    /// Reads the summary section of `file`; empty if it is missing, damaged, or without a checksum.
    pub(super) fn of(file: &mut (impl Read + Seek)) -> std::io::Result<Self> {
        let Some(data_end) = data_end(file)? else { return Ok(Self::default()) };
        // The checksum covers what follows the end of the data.
        file.seek(SeekFrom::Start(data_end))?;
        let mut directory = Self { landmarks: vec![data_end], data_end: Some(data_end), ..Self::default() };
        let mut ends = (false, false);
        let options = LinearReaderOptions::default().with_skip_start_magic(true);
        let read = pull(file, options, &mut |opcode, body| {
            match mcap::parse_record(opcode, body)? {
                Record::DataEnd(_) => ends.0 = true,
                Record::Footer(_) => ends.1 = true,
                Record::ChunkIndex(index) => directory.landmarks.push(index.chunk_start_offset),
                Record::AttachmentIndex(index) => directory.landmarks.push(index.offset),
                Record::MetadataIndex(index) => directory.landmarks.push(index.offset),
                Record::Statistics(found) => directory.counts = Some(found.channel_message_counts),
                definition => directory.definitions.learn(definition),
            }
            Ok(())
        });
        if let Err(ReadError::Io(error)) = read {
            return Err(error);
        }
        if read.is_err() || ends != (true, true) {
            return Ok(Self::default());
        }
        directory.landmarks.retain(|&mark| mark <= data_end);
        directory.landmarks.sort_unstable();
        Ok(directory)
    }

    /// Whether a chunk, an attachment or a metadata record begins at `at`.
    pub(super) fn is_landmark(&self, at: u64) -> bool {
        self.landmarks.binary_search(&at).is_ok()
    }

    /// The first of them behind `at`, or the end of the data.
    pub(super) fn landmark_behind(&self, at: u64) -> Option<u64> {
        self.landmarks.get(self.landmarks.partition_point(|&mark| mark <= at)).copied()
    }
}

/// Where the data end, if the file ends as it should, with a summary section that has a checksum.
fn data_end(file: &mut (impl Read + Seek)) -> std::io::Result<Option<u64>> {
    let tail = FOOTER + MAGIC.len() as u64;
    let Some(footer) = file.seek(SeekFrom::End(0))?.checked_sub(tail) else { return Ok(None) };
    file.seek(SeekFrom::Start(footer))?;
    let mut bytes = Vec::new();
    file.by_ref().take(tail).read_to_end(&mut bytes)?;
    let head = [&[op::FOOTER][..], &20_u64.to_le_bytes()].concat();
    let body = bytes.strip_prefix(&head[..]).and_then(|rest| rest.strip_suffix(MAGIC));
    let Some(Ok(Record::Footer(found))) = body.map(|body| mcap::parse_record(op::FOOTER, body)) else {
        return Ok(None);
    };
    let start = found.summary_start.checked_sub(DATA_END);
    Ok(start.filter(|_| found.summary_start < footer && found.summary_crc != 0))
}
