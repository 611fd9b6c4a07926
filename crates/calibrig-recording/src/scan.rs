//! The records of an MCAP file, each under a checksum.

use std::io::{Read, Seek, SeekFrom};

use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{MAGIC, McapError};

use super::RecordingError;
use super::mcap_writer::RECORD_LIMIT;

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

pub(super) fn check_magic(file: &mut (impl Read + Seek)) -> Result<(), ReadError> {
    let mut start = Vec::new();
    file.by_ref().take(MAGIC.len() as u64).read_to_end(&mut start)?;
    if start == MAGIC { Ok(()) } else { Err(RecordingError::NotMcap.into()) }
}

/// Is given every record: its opcode and its body.
pub(super) type Visitor<'a> = dyn FnMut(u8, &[u8]) -> Result<(), ReadError> + 'a;

/// Passes every record of the file to `visit`, with all checksums validated; chunks whole or by their records.
pub(super) fn scan(
    file: &mut (impl Read + Seek),
    whole_chunks: bool,
    visit: &mut Visitor<'_>,
) -> Result<(), ReadError> {
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

/// Reads the whole file once for its checksums. A checksum of zero means "none" in MCAP: that every message and attachment lies under one is
/// checked as well. Whether the data and the summary section have one too, as every file of ours: other programs leave them out.
pub(super) fn check_integrity(file: &mut (impl Read + Seek)) -> Result<bool, ReadError> {
    let mut data_end = false;
    let mut footer = false;
    scan(file, true, &mut |opcode, body| {
        match opcode {
            op::CHUNK => check_chunk(body)?,
            op::ATTACHMENT => check_attachment(body)?,
            op::MESSAGE => {
                let found = "a message outside of all chunks".to_owned();
                return Err(unprotected(found));
            }
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
    Ok(data_end && footer)
}

fn unprotected(found: String) -> ReadError {
    let expected = "messages in chunks that are compressed with zstd, each with its checksum";
    RecordingError::Unprotected { found, expected }.into()
}

/// Chunks of another kind are not decoded: the decoder's arithmetic relies on sound lengths.
pub(super) fn check_chunk(body: &[u8]) -> Result<(), ReadError> {
    let Record::Chunk { header, .. } = mcap::parse_record(op::CHUNK, body)? else { return Ok(()) };
    if header.compression == "zstd" && header.uncompressed_crc != 0 {
        return Ok(());
    }
    Err(unprotected(format!(
        "a chunk with compression {:?} and checksum {:08x}",
        header.compression, header.uncompressed_crc
    )))
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
