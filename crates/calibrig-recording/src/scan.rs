//! The records of an MCAP file, each under a checksum.

use std::io::{Read, Seek, SeekFrom};

use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{MAGIC, McapError};

use super::RecordingError;
use super::mcap_writer::RECORD_LIMIT;
use calibrig_files::mcap_chunk;

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
            McapError::UnsupportedCompression(compression) => {
                RecordingError::UnknownCompression { compression }
            }
            source => RecordingError::Corrupt { source },
        })
    }
}

pub(super) fn check_magic(file: &mut (impl Read + Seek)) -> Result<(), ReadError> {
    let mut start = Vec::new();
    file.by_ref().take(MAGIC.len() as u64).read_to_end(&mut start)?;
    if start == MAGIC { Ok(()) } else { Err(RecordingError::NotMcap.into()) }
}

/// Is given every record: its opcode and its body.
pub(super) type Visitor<'a> = dyn FnMut(u8, &[u8]) -> Result<(), ReadError> + 'a;

/// Passes every record of the file to `visit`, those in chunks too, with all checksums validated that are there.
pub(super) fn scan(file: &mut (impl Read + Seek), visit: &mut Visitor<'_>) -> Result<(), ReadError> {
    scan_whole(file, &mut |opcode, body| {
        if opcode != op::CHUNK {
            return visit(opcode, body);
        }
        mcap_chunk::open(body, RECORD_LIMIT)?.records().try_for_each(|(opcode, body)| visit(opcode, body))
    })
}

/// The same without a look into the chunks, whose own checksums are not validated: those over the whole are.
pub(super) fn scan_whole(file: &mut (impl Read + Seek), visit: &mut Visitor<'_>) -> Result<(), ReadError> {
    file.seek(SeekFrom::Start(0))?;
    let options = LinearReaderOptions::default()
        .with_check_finishes_after_end_magic(true)
        .with_emit_chunks(true)
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

/// What of a sound file is under no checksum: what flips there is not noticed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Unprotected {
    /// Messages in chunks without a checksum, or outside of all chunks.
    pub messages: u64,
    /// Attachments without one.
    pub attachments: u64,
    /// Whether a checksum over the whole data section covers these as well, and what belongs to no message.
    pub data_is_covered: bool,
    /// Whether the summary is under one.
    pub summary_is_covered: bool,
}

impl Unprotected {
    /// Whether every byte is under some checksum.
    pub fn is_nothing(&self) -> bool {
        self.data_is_covered && self.summary_is_covered
    }

    /// Whether a flipped bit of a message or an attached file may go unnoticed.
    pub fn holds_data(&self) -> bool {
        !self.data_is_covered && self.messages + self.attachments > 0
    }
}

/// Reads the whole file once for its checksums, and tells what no checksum covers: in MCAP a checksum of zero says that none was written.
pub(super) fn check_integrity(file: &mut (impl Read + Seek)) -> Result<Unprotected, ReadError> {
    let mut found = Unprotected::default();
    let mut ends = (false, false);
    scan_whole(file, &mut |opcode, body| {
        match opcode {
            op::CHUNK => found.messages += mcap_chunk::unprotected_messages(body, RECORD_LIMIT)?,
            op::MESSAGE => found.messages += 1,
            op::ATTACHMENT => check_attachment(body)?,
            _ => {}
        }
        if !matches!(opcode, op::ATTACHMENT | op::DATA_END | op::FOOTER) {
            return Ok(());
        }
        match mcap::parse_record(opcode, body)? {
            Record::Attachment { crc, .. } => found.attachments += u64::from(crc == 0),
            Record::DataEnd(end) => (ends.0, found.data_is_covered) = (true, end.data_section_crc != 0),
            Record::Footer(end) => (ends.1, found.summary_is_covered) = (true, end.summary_crc != 0),
            _ => {}
        }
        Ok(())
    })?;
    // Without them nothing tells that it is all.
    if ends == (true, true) { Ok(found) } else { Err(RecordingError::Truncated.into()) }
}

/// An attachment's lengths must lie in its record: the parser trusts them.
pub(super) fn check_attachment(body: &[u8]) -> Result<(), ReadError> {
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
        assert!(check_attachment(&body).is_err(), "the checksum is missing");
        body.extend([0; 4]);
        assert!(check_attachment(&body).is_ok());
        for length in 0..body.len() {
            assert!(check_attachment(&body[..length]).is_err());
        }
        body[16..20].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(check_attachment(&body).is_err());
    }
}
