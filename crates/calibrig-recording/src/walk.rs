//! What is sound of an MCAP file, part by part: damage is passed over where the file's framing holds, and told.

use std::collections::BTreeMap;
use std::io::{Read, Seek, SeekFrom};

use mcap::McapError;
use mcap::records::{Record, op};
use serde::Serialize;

use super::directory::Directory;
use super::mcap_writer::RECORD_LIMIT;
use super::scan::{ReadError, check_attachment, check_magic};
use calibrig_files::mcap_chunk::{self, HEAD};

/// Length of MCAP's magic bytes.
pub(super) const MAGIC_LENGTH: u64 = 8;
/// More of them are counted, not described.
const FAULTS_TOLD: usize = 100;

/// A part of a file that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Fault {
    /// Where it begins, bytes from the start of the file.
    pub offset: u64,
    /// Its length in the file, bytes.
    pub bytes: u64,
    /// What it is, or should be.
    pub part: Part,
    /// What is wrong with it.
    pub reason: String,
}

/// A kind of part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Part {
    /// Messages.
    Chunk,
    /// Messages that this program does not look into: of another compression than those of the specification.
    OpaqueChunk,
    /// An attached file.
    Attachment,
    /// A metadata record.
    Metadata,
    /// A record that does not belong where it is.
    Record,
    /// What cannot be told.
    Framing,
}

impl Part {
    /// Name for people.
    pub fn title(self) -> &'static str {
        match self {
            Self::Chunk => "a chunk of messages",
            Self::OpaqueChunk => "a chunk of messages that is not looked into",
            Self::Attachment => "an attachment",
            Self::Metadata => "a metadata record",
            Self::Record => "a record",
            Self::Framing => "what cannot be told",
        }
    }
}

/// How a file ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum End {
    /// Behind all data, where the summary follows.
    Data,
    /// Between two records.
    Record,
    /// Behind the head of a chunk, as a writer leaves it that did not come to fill it.
    Begun,
    /// Within a record.
    Within,
    /// It does not: the rest cannot be read.
    Lost,
}

/// What a walk came upon.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Walk {
    /// Chunks, sound or not.
    pub chunks: u64,
    /// Number of faults by kind.
    pub lost: BTreeMap<Part, u64>,
    /// The first of them.
    pub faults: Vec<Fault>,
    /// Bytes that belong to no whole record.
    pub unread: u64,
    /// Messages and attachments that are under no checksum of their own.
    pub unprotected: u64,
    /// Chunks and attachments that have one, which fits.
    pub checksums: u64,
    /// Where it ended.
    pub at: u64,
    /// How.
    pub end: End,
}

/// Is given every sound record of the data section: where it, or its chunk, begins, and the record.
pub(super) type Visitor<'a> = dyn FnMut(u64, Record<'_>) -> Result<(), ReadError> + 'a;

/// Walks through the data section of a file. `directory` helps past a record whose length is damaged. In a file that is `sound`, where a checksum
/// over all of the data fits, every record is what it seems to be.
pub(super) fn walk(
    file: &mut (impl Read + Seek),
    directory: &Directory,
    sound: bool,
    visit: &mut Visitor<'_>,
) -> Result<Walk, ReadError> {
    let length = file.seek(SeekFrom::End(0))?;
    file.seek(SeekFrom::Start(0))?;
    check_magic(file)?;
    let walk = Walk {
        chunks: 0,
        lost: BTreeMap::new(),
        faults: Vec::new(),
        unread: 0,
        unprotected: 0,
        checksums: 0,
        at: MAGIC_LENGTH,
        end: End::Record,
    };
    let mut walker = Walker { file, length, directory, sound, record: Vec::new(), walk };
    while walker.step(visit)? {}
    Ok(walker.walk)
}

struct Walker<'a, R> {
    file: &'a mut R,
    length: u64,
    directory: &'a Directory,
    sound: bool,
    /// The record at hand, with its head.
    record: Vec<u8>,
    walk: Walk,
}

/// The next record, as far as its head tells.
enum Next {
    Whole(u8),
    /// Its kind, where that can be told, and how the file would end with it.
    Broken(Option<u8>, End),
}

impl<R: Read + Seek> Walker<'_, R> {
    /// Goes past one record, or past what is not readable. False at the end.
    fn step(&mut self, visit: &mut Visitor<'_>) -> Result<bool, ReadError> {
        let at = self.walk.at;
        if self.directory.data_end == Some(at) {
            self.walk.end = End::Data;
            return Ok(false);
        }
        if at >= self.length {
            self.walk.end = End::Record;
            return Ok(false);
        }
        let ahead = self.directory.landmark_behind(at);
        match self.next(ahead.unwrap_or(self.length))? {
            Next::Whole(opcode) => {
                self.walk.at += self.record.len() as u64;
                self.pass(at, opcode, visit)
            }
            Next::Broken(opcode, end) => {
                self.pass_over(at, opcode, end, ahead)?;
                Ok(ahead.is_some())
            }
        }
    }

    /// Goes past what is not readable: to the next place where a record is known to begin, else to the end.
    fn pass_over(
        &mut self,
        at: u64,
        opcode: Option<u8>,
        end: End,
        ahead: Option<u64>,
    ) -> Result<(), ReadError> {
        let next = ahead.unwrap_or(self.length);
        self.walk.unread += next - at;
        self.walk.at = next;
        let cut = ahead.is_none() && end != End::Lost;
        // What these hold is known without them.
        if !(cut && matches!(opcode, Some(op::MESSAGE_INDEX | op::DATA_END))) {
            let reason = if cut { "the file breaks off in it" } else { "its length makes no sense" };
            self.fault(at, next - at, part_of(opcode), reason.to_owned());
        }
        if ahead.is_some() {
            self.file.seek(SeekFrom::Start(next))?;
        } else {
            self.walk.end = end;
        }
        Ok(())
    }

    /// Reads the record that begins here and ends by `end`.
    fn next(&mut self, end: u64) -> Result<Next, ReadError> {
        let room = end - self.walk.at;
        self.record.clear();
        self.file.by_ref().take(room.min(HEAD as u64)).read_to_end(&mut self.record)?;
        let first = self.record.first().copied();
        let length = self.record.get(1..HEAD).and_then(|length| length.try_into().ok());
        let (Some(opcode), Some(length)) = (first, length.map(u64::from_le_bytes)) else {
            return Ok(Next::Broken(first, End::Within));
        };
        if opcode == op::CHUNK && length == u64::MAX {
            return Ok(Next::Broken(first, End::Begun));
        }
        if opcode == 0 || length > RECORD_LIMIT as u64 {
            return Ok(Next::Broken(first, End::Lost));
        }
        if length > room - HEAD as u64 {
            return Ok(Next::Broken(first, End::Within));
        }
        let read = self.file.by_ref().take(length).read_to_end(&mut self.record)?;
        // Else the file became shorter meanwhile.
        Ok(if read as u64 == length { Next::Whole(opcode) } else { Next::Broken(first, End::Within) })
    }

    /// Passes on the record at hand if it is sound. False at the end of the data.
    fn pass(&mut self, at: u64, opcode: u8, visit: &mut Visitor<'_>) -> Result<bool, ReadError> {
        if self.directory.is_landmark(at) && !matches!(opcode, op::CHUNK | op::ATTACHMENT | op::METADATA) {
            let reason = "it is not what the file's summary says".to_owned();
            self.fault(at, self.record.len() as u64, Part::Framing, reason);
            return Ok(true);
        }
        match opcode {
            op::HEADER if at == MAGIC_LENGTH => self.plain(at, opcode, Part::Record, visit)?,
            op::METADATA => self.plain(at, opcode, Part::Metadata, visit)?,
            op::CHUNK => {
                self.walk.chunks += 1;
                self.chunk(at, visit)?;
            }
            op::ATTACHMENT => self.attachment(at, visit)?,
            // Where there are chunks all messages are in them, but for few writers: this would be another record, whose kind is damaged.
            op::SCHEMA | op::CHANNEL | op::MESSAGE if self.walk.chunks == 0 || self.sound => {
                self.walk.unprotected += u64::from(opcode == op::MESSAGE);
                self.plain(at, opcode, Part::Record, visit)?;
            }
            op::MESSAGE_INDEX if is_message_index(&self.record[HEAD..]) => {}
            op::DATA_END if self.record.len() == HEAD + 4 => {
                self.walk.end = End::Data;
                return Ok(false);
            }
            _ => {
                let reason = "no such record belongs here".to_owned();
                self.fault(at, self.record.len() as u64, Part::Record, reason);
            }
        }
        Ok(true)
    }

    fn plain(&mut self, at: u64, opcode: u8, part: Part, visit: &mut Visitor<'_>) -> Result<(), ReadError> {
        match mcap::parse_record(opcode, &self.record[HEAD..]) {
            Ok(record) if fills(&record, self.record.len() - HEAD) => visit(at, record),
            Ok(_) => {
                self.fault(at, self.record.len() as u64, part, "its lengths do not fit".to_owned());
                Ok(())
            }
            Err(error) => {
                let reason = error.to_string();
                self.fault(at, self.record.len() as u64, part, reason);
                Ok(())
            }
        }
    }

    fn attachment(&mut self, at: u64, visit: &mut Visitor<'_>) -> Result<(), ReadError> {
        let body = &self.record[HEAD..];
        let parsed = match check_attachment(body) {
            Ok(()) => mcap::parse_record(op::ATTACHMENT, body).map_err(|error| error.to_string()),
            Err(_) => Err("its lengths do not fit".to_owned()),
        };
        match parsed {
            Ok(record) => {
                let unprotected = matches!(&record, Record::Attachment { crc: 0, .. });
                self.walk.unprotected += u64::from(unprotected);
                self.walk.checksums += u64::from(!unprotected);
                visit(at, record)
            }
            Err(reason) => {
                self.fault(at, self.record.len() as u64, Part::Attachment, reason);
                Ok(())
            }
        }
    }

    /// Passes on the records of the chunk at hand, if its lengths fit, and its checksum if it has one.
    fn chunk(&mut self, at: u64, visit: &mut Visitor<'_>) -> Result<(), ReadError> {
        let bytes = self.record.len() as u64;
        let trouble = match mcap_chunk::open(&self.record[HEAD..], RECORD_LIMIT) {
            Ok(chunk) => {
                self.walk.checksums += u64::from(chunk.protected);
                let mut trouble = None;
                for (opcode, body) in chunk.records() {
                    match mcap::parse_record(opcode, body) {
                        Ok(record) => visit(at, record)?,
                        Err(error) => trouble = Some((Part::Chunk, error.to_string())),
                    }
                    self.walk.unprotected += u64::from(opcode == op::MESSAGE && !chunk.protected);
                }
                trouble
            }
            Err(McapError::UnsupportedCompression(name)) => {
                Some((Part::OpaqueChunk, format!("its compression {name:?} is not read")))
            }
            Err(McapError::UnexpectedEoc) => Some((Part::Chunk, "the lengths in it do not fit".to_owned())),
            Err(error) => Some((Part::Chunk, error.to_string())),
        };
        if let Some((part, reason)) = trouble {
            self.fault(at, bytes, part, reason);
        }
        Ok(())
    }

    fn fault(&mut self, offset: u64, bytes: u64, part: Part, reason: String) {
        *self.walk.lost.entry(part).or_default() += 1;
        if self.walk.faults.len() < FAULTS_TOLD {
            self.walk.faults.push(Fault { offset, bytes, part, reason });
        }
    }
}

fn part_of(opcode: Option<u8>) -> Part {
    match opcode {
        Some(op::CHUNK) => Part::Chunk,
        Some(op::ATTACHMENT) => Part::Attachment,
        Some(op::METADATA) => Part::Metadata,
        _ => Part::Framing,
    }
}

fn is_message_index(body: &[u8]) -> bool {
    let entries = body.get(2..6).and_then(|length| length.try_into().ok()).map(u32::from_le_bytes);
    entries.is_some_and(|length| u64::from(length) + 6 == body.len() as u64)
}

/// Whether a record that was parsed from a body of `length` bytes needs all of them: a damaged one hardly does.
fn fills(record: &Record<'_>, length: usize) -> bool {
    let texts = |map: &BTreeMap<String, String>| {
        4 + map.iter().map(|(key, value)| 8 + key.len() + value.len()).sum::<usize>()
    };
    length
        == match record {
            Record::Header(header) => 8 + header.profile.len() + header.library.len(),
            Record::Metadata(metadata) => 4 + metadata.name.len() + texts(&metadata.metadata),
            Record::Schema { header, data } => 14 + header.name.len() + header.encoding.len() + data.len(),
            Record::Channel(c) => 12 + c.topic.len() + c.message_encoding.len() + texts(&c.metadata),
            _ => length,
        }
}
