//! The one walk through the records of an MCAP file. Of a sound file it passes on every record ([`read_records`]); of a damaged one, those
//! that are sound, and tells what is wrong with the rest ([`walk`]).

use std::collections::BTreeMap;
use std::io::{Read, Seek, SeekFrom};

use mcap::records::{Record, op};
use mcap::{MAGIC, McapError};

use super::RecordingError;
use super::directory::Directory;
use super::framing::{ReadError, check_whole};
use super::health::{Fault, FaultyPart, Health};
use super::mcap_writer::RECORD_LIMIT;
use calibrig_files::mcap_chunk::{self, HEAD};

/// What of a sound file no checksum covers: a bit that flips there goes unnoticed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Unprotected {
    /// Messages in chunks without a checksum, or outside of all chunks.
    pub messages: u64,
    /// Attachments without a checksum.
    pub attachments: u64,
    /// Whether one checksum covers the whole data section, with these messages and attachments.
    pub data_is_covered: bool,
    /// Whether a checksum covers the summary.
    pub summary_is_covered: bool,
}

impl Unprotected {
    /// Whether every byte is under some checksum.
    pub fn is_nothing(&self) -> bool {
        self.data_is_covered && self.summary_is_covered
    }

    /// Whether a flipped bit in a message or an attached file could go unnoticed.
    pub fn holds_data(&self) -> bool {
        !self.data_is_covered && self.messages + self.attachments > 0
    }
}

/// Passes every record of a sound file to `visit`, those in chunks too, and validates every checksum in the file. In MCAP a checksum of
/// zero says that there is none.
pub(super) fn read_records(
    file: &mut (impl Read + Seek),
    visit: &mut dyn FnMut(Record<'_>) -> Result<(), ReadError>,
) -> Result<Unprotected, ReadError> {
    let whole = check_whole(file)?;
    if let Some(trouble) = whole.trouble {
        return Err(trouble.into());
    }
    let (Some(data_is_covered), Some(summary_is_covered)) = (whole.data, whole.summary) else {
        // Without its end, nothing tells that this is all.
        return Err(RecordingError::Truncated.into());
    };
    let walked = walk(file, &Directory::default(), Trust::All, &mut |_, record| visit(record))?;
    // A record that does not frame the next one would hide all behind it.
    if walked.end != End::Data {
        return Err(RecordingError::Truncated.into());
    }
    let Walked { messages, attachments, .. } = walked;
    Ok(Unprotected { messages, attachments, data_is_covered, summary_is_covered })
}

/// How far a walk trusts what it reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Trust {
    /// The file is damaged: even the kind of a record may be wrong.
    Little,
    /// A checksum over the whole data section fits.
    Data,
    /// The file must be sound: the first fault ends the walk with an error.
    All,
}

/// How a file ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum End {
    /// Behind all data, where the summary follows.
    Data,
    /// Between two records.
    Record,
    /// Behind the head of a chunk that its writer did not come to fill.
    Begun,
    /// Within a record.
    Within,
    /// Where no record can be made out.
    Lost,
}

/// What a walk found.
#[derive(Debug)]
pub(super) struct Walked {
    /// Without its `state`, and without the checksums over the sections.
    pub health: Health,
    pub end: End,
    /// Messages that no checksum of a chunk covers.
    messages: u64,
    /// Attachments without a checksum.
    attachments: u64,
}

/// Is given every sound record of the data section: where it, or its chunk, begins, and the record.
type Visitor<'a> = dyn FnMut(u64, Record<'_>) -> Result<(), ReadError> + 'a;

/// Walks through the data section of a file. `directory` helps past a record whose length is damaged.
pub(super) fn walk(
    file: &mut (impl Read + Seek),
    directory: &Directory,
    trust: Trust,
    visit: &mut Visitor<'_>,
) -> Result<Walked, ReadError> {
    let length = file.seek(SeekFrom::End(0))?;
    let at = MAGIC.len() as u64;
    file.seek(SeekFrom::Start(at))?;
    let walked = Walked { health: Health::new(), end: End::Record, messages: 0, attachments: 0 };
    let mut walker = Walker { file, length, directory, trust, record: Vec::new(), at, walked };
    while walker.step(visit)? {}
    let Walked { health, messages, attachments, .. } = &mut walker.walked;
    health.without_checksum = *messages + *attachments;
    Ok(walker.walked)
}

struct Walker<'a, R> {
    file: &'a mut R,
    length: u64,
    directory: &'a Directory,
    trust: Trust,
    /// The record at hand, with its head.
    record: Vec<u8>,
    /// Where the walk is, bytes from the start of the file.
    at: u64,
    walked: Walked,
}

/// What is wrong with a part of a file.
enum Trouble {
    /// No record of this kind can be here; a file that is sound otherwise may hold such records.
    Unexpected(&'static str),
    Mcap(McapError),
}

/// Why the next record cannot be read: its kind, where that can be told, and how the file would end with it.
type Broken = (Option<u8>, End);

impl<R: Read + Seek> Walker<'_, R> {
    /// Goes past one record, or past what is not readable. False at the end.
    fn step(&mut self, visit: &mut Visitor<'_>) -> Result<bool, ReadError> {
        let at = self.at;
        let at_data_end = self.directory.data_end == Some(at);
        if at_data_end || at >= self.length {
            self.walked.end = if at_data_end { End::Data } else { End::Record };
            return Ok(false);
        }
        let ahead = self.directory.landmark_behind(at);
        match self.next(ahead.unwrap_or(self.length))? {
            Ok(opcode) => {
                self.at += self.record.len() as u64;
                self.pass(at, opcode, visit)
            }
            Err(broken) => {
                self.pass_over(at, broken, ahead)?;
                Ok(ahead.is_some())
            }
        }
    }

    /// Goes past what is not readable: to the next place where a record is known to begin, else to the end.
    fn pass_over(&mut self, at: u64, (opcode, end): Broken, ahead: Option<u64>) -> Result<(), ReadError> {
        self.at = ahead.unwrap_or(self.length);
        let bytes = self.at - at;
        self.walked.health.bytes_unread += bytes;
        let cut = ahead.is_none() && end != End::Lost;
        // What a message index or the end of the data holds is known without it.
        if !(cut && matches!(opcode, Some(op::MESSAGE_INDEX | op::DATA_END))) {
            let part = match opcode {
                Some(op::CHUNK) => FaultyPart::Chunk,
                Some(op::ATTACHMENT) => FaultyPart::Attachment,
                Some(op::METADATA) => FaultyPart::Metadata,
                _ => FaultyPart::Framing,
            };
            let reason = if cut { "the file breaks off in it" } else { "its length makes no sense" };
            self.fault(at, bytes, part, Trouble::Unexpected(reason))?;
        }
        if ahead.is_some() {
            self.file.seek(SeekFrom::Start(self.at))?;
        } else {
            self.walked.end = end;
        }
        Ok(())
    }

    /// Reads the record that begins here and ends by `end`: its opcode.
    fn next(&mut self, end: u64) -> std::io::Result<Result<u8, Broken>> {
        let room = end - self.at;
        self.record.clear();
        self.file.by_ref().take(room.min(HEAD as u64)).read_to_end(&mut self.record)?;
        let first = self.record.first().copied();
        let length = self.record.get(1..HEAD).and_then(|length| length.try_into().ok());
        let (Some(opcode), Some(length)) = (first, length.map(u64::from_le_bytes)) else {
            return Ok(Err((first, End::Within)));
        };
        if opcode == op::CHUNK && length == u64::MAX {
            return Ok(Err((first, End::Begun)));
        }
        if opcode == 0 || length > RECORD_LIMIT as u64 {
            return Ok(Err((first, End::Lost)));
        }
        if length > room - HEAD as u64 {
            return Ok(Err((first, End::Within)));
        }
        let read = self.file.by_ref().take(length).read_to_end(&mut self.record)?;
        // Else the file became shorter meanwhile.
        Ok(if read as u64 == length { Ok(opcode) } else { Err((first, End::Within)) })
    }

    /// Passes on the record at hand if it is sound. False at the end of the data.
    fn pass(&mut self, at: u64, opcode: u8, visit: &mut Visitor<'_>) -> Result<bool, ReadError> {
        let bytes = self.record.len() as u64;
        if self.directory.is_landmark(at) && !matches!(opcode, op::CHUNK | op::ATTACHMENT | op::METADATA) {
            let reason = Trouble::Unexpected("it is not what the file's summary says");
            self.fault(at, bytes, FaultyPart::Framing, reason)?;
            return Ok(true);
        }
        let body = &self.record[HEAD..];
        // A later version of the format may add fields to a record: only where records may be damaged must they be as long as known.
        let trusted = self.trust != Trust::Little;
        let plain = || match mcap::parse_record(opcode, body) {
            Ok(record) if trusted || fills(&record, body.len()) => Ok(record),
            Ok(_) => Err(McapError::UnexpectedEoc),
            Err(error) => Err(error),
        };
        let (part, parsed) = match opcode {
            op::HEADER if at == MAGIC.len() as u64 => (FaultyPart::Record, plain()),
            op::METADATA => (FaultyPart::Metadata, plain()),
            // Where there are chunks, nearly all writers put all messages into them: this would be another record, whose kind is damaged.
            op::SCHEMA | op::CHANNEL | op::MESSAGE if self.walked.health.chunks == 0 || trusted => {
                self.walked.messages += u64::from(opcode == op::MESSAGE);
                (FaultyPart::Record, plain())
            }
            op::ATTACHMENT => {
                let parsed = parse_attachment(body);
                match &parsed {
                    Ok(Record::Attachment { crc: 0, .. }) => self.walked.attachments += 1,
                    parsed => self.walked.health.checksums += u64::from(parsed.is_ok()),
                }
                (FaultyPart::Attachment, parsed)
            }
            op::CHUNK => {
                self.walked.health.chunks += 1;
                if let Err(error) = self.chunk(at, visit)? {
                    let opaque = matches!(error, McapError::UnsupportedCompression(_));
                    let part = if opaque { FaultyPart::OpaqueChunk } else { FaultyPart::Chunk };
                    self.fault(at, bytes, part, Trouble::Mcap(error))?;
                }
                return Ok(true);
            }
            op::MESSAGE_INDEX if trusted || is_message_index(body) => return Ok(true),
            op::DATA_END if trusted || body.len() == 4 => {
                self.walked.end = End::Data;
                return Ok(false);
            }
            _ => {
                let reason = Trouble::Unexpected("no such record belongs here");
                self.fault(at, bytes, FaultyPart::Record, reason)?;
                return Ok(true);
            }
        };
        match parsed {
            Ok(record) => visit(at, record)?,
            Err(error) => self.fault(at, bytes, part, Trouble::Mcap(error))?,
        }
        Ok(true)
    }

    /// Passes on the records of the chunk at hand, if its lengths fit, and its checksum if it has one.
    fn chunk(&mut self, at: u64, visit: &mut Visitor<'_>) -> Result<Result<(), McapError>, ReadError> {
        let chunk = match mcap_chunk::open(&self.record[HEAD..], RECORD_LIMIT) {
            Ok(chunk) => chunk,
            Err(error) => return Ok(Err(error)),
        };
        self.walked.health.checksums += u64::from(chunk.protected);
        let mut result = Ok(());
        for (opcode, body) in chunk.records() {
            match mcap::parse_record(opcode, body) {
                Ok(record) => visit(at, record)?,
                Err(error) => result = Err(error),
            }
            self.walked.messages += u64::from(opcode == op::MESSAGE && !chunk.protected);
        }
        Ok(result)
    }

    /// Takes note of a part that cannot be used, or ends the walk where the file is to be sound.
    fn fault(
        &mut self,
        offset: u64,
        bytes: u64,
        part: FaultyPart,
        trouble: Trouble,
    ) -> Result<(), ReadError> {
        let reason = match trouble {
            Trouble::Mcap(error) if self.trust == Trust::All => return Err(error.into()),
            Trouble::Unexpected(reason) => reason.to_owned(),
            Trouble::Mcap(McapError::UnsupportedCompression(name)) => {
                format!("its compression {name:?} is not read")
            }
            Trouble::Mcap(McapError::UnexpectedEoc) => "the lengths in it do not fit".to_owned(),
            Trouble::Mcap(error) => error.to_string(),
        };
        self.walked.health.add(Fault { offset, bytes, part, reason });
        Ok(())
    }
}

/// The parser trusts the lengths in an attachment: they must lie in its record.
fn parse_attachment(body: &[u8]) -> Result<Record<'_>, McapError> {
    if attachment_length(body) != Some(body.len()) {
        return Err(McapError::UnexpectedEoc);
    }
    mcap::parse_record(op::ATTACHMENT, body)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unsound_lengths_in_an_attachment_do_not_panic() {
        let mut body = vec![0; 16];
        body.extend(u32::to_le_bytes(1));
        body.push(b'a');
        body.extend(u32::to_le_bytes(0));
        body.extend(u64::to_le_bytes(2));
        body.extend(*b"hi");
        assert!(parse_attachment(&body).is_err(), "the checksum is missing");
        body.extend([0; 4]);
        assert!(parse_attachment(&body).is_ok());
        for length in 0..body.len() {
            assert!(parse_attachment(&body[..length]).is_err());
        }
        body[16..20].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(parse_attachment(&body).is_err());
    }
}
