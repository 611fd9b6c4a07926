//! Saves the sound parts of a damaged or unfinished file into a new, complete one.

use std::collections::HashMap;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::Path;

use mcap::records::{MessageHeader, Metadata, Record};
use mcap::{Attachment, Writer};
use sha2::{Digest, Sha256};

use super::directory::{Definitions, Directory};
use super::file::write_whole;
use super::framing::ReadError;
use super::health::{FaultyPart, State};
use super::inspect::{PASSES, Progress, Watched, inspect_file};
use super::inspection::{Inspection, ProvenanceState};
use super::mcap_writer::writer;
use super::provenance::{ALTERED, METADATA, RECOVERED, hex};
use super::records::walk;
use super::{Provenance, RecordingError};

/// The outcome of saving a file.
#[derive(Debug, Clone, PartialEq)]
pub struct Recovered {
    /// What was found in it.
    pub inspection: Inspection,
    /// Whether nothing was wrong with it and the new file is a copy.
    pub copied: bool,
}

/// Saves the sound parts of `bad` into the new file `good`, which is either complete or not written. `progress` is told how far it has come.
///
/// # Errors
/// `bad` cannot be read, is not an MCAP file, or holds no readable message; `good` is the same file as `bad`, exists (without `force`), or
/// cannot be written.
pub fn recover(
    bad: &Path,
    good: &Path,
    force: bool,
    progress: &mut Progress<'_>,
) -> Result<Recovered, RecordingError> {
    let unreadable = |error: std::io::Error| ReadError::Io(error).of(bad);
    // Reading, then hashing and copying.
    let mut file = Watched::open(bad, PASSES + 2, progress).map_err(unreadable)?;
    check_target(bad, good, force)?;
    let name = bad.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let inspection = inspect_file(&mut file, name).map_err(|error| error.of(bad))?;
    let copied = inspection.health.state == State::Whole;
    if copied {
        write_whole(good, |mut sink| {
            file.seek(SeekFrom::Start(0)).map_err(unreadable)?;
            std::io::copy(&mut file, &mut sink)?;
            Ok(sink.flush()?)
        })?;
    } else if inspection.recoverable.messages == 0 {
        let (bytes, unread) = (inspection.bytes, inspection.health.bytes_unread);
        let opaque = inspection.health.faults.iter().find(|fault| fault.part == FaultyPart::OpaqueChunk);
        let why = opaque.map(|fault| fault.reason.clone());
        return Err(RecordingError::NothingToRecover { path: bad.to_path_buf(), bytes, unread, why });
    } else {
        let sha256 = sha256(&mut file).map_err(unreadable)?;
        write_whole(good, |sink| save(&mut file, &inspection, sha256, sink).map_err(|e| e.of(bad)))?;
    }
    Ok(Recovered { inspection, copied })
}

fn check_target(bad: &Path, good: &Path, force: bool) -> Result<(), RecordingError> {
    let path = good.to_path_buf();
    let same = |real: &Path| std::fs::canonicalize(bad).is_ok_and(|bad| bad == real);
    if std::fs::canonicalize(good).is_ok_and(|real| same(&real)) {
        return Err(RecordingError::SameFile { path });
    }
    if good.is_dir() {
        return Err(RecordingError::IsFolder { path });
    }
    // A broken symbolic link counts as existing, too.
    if !force && good.symlink_metadata().is_ok() {
        return Err(RecordingError::Exists { path });
    }
    Ok(())
}

fn sha256(file: &mut (impl Read + Seek)) -> std::io::Result<String> {
    file.seek(SeekFrom::Start(0))?;
    let mut digest = Sha256::new();
    let mut buffer = vec![0; 1 << 16];
    loop {
        match file.read(&mut buffer)? {
            0 => break,
            read => digest.update(&buffer[..read]),
        }
    }
    Ok(hex(&digest.finalize()))
}

/// Writes what `inspection` found sound in `file`.
pub(super) fn save<W: Write + Seek>(
    file: &mut (impl Read + Seek),
    inspection: &Inspection,
    sha256: String,
    sink: W,
) -> Result<(), ReadError> {
    let directory = Directory::of(file)?;
    let altered = inspection.provenance.as_ref().is_some_and(|p| p.state == ProvenanceState::Altered);
    let mut copy = Copy {
        writer: writer(sink, &inspection.profile)?,
        definitions: directory.definitions.clone(),
        channels: HashMap::new(),
        altered,
        messages: 0,
    };
    copy.metadata(&note(inspection, sha256))?;
    walk(file, &directory, inspection.trust, &mut |_, record| Ok(copy.record(record)?))?;
    if copy.messages != inspection.recoverable.messages {
        return Err(std::io::Error::other("it changed while it was read").into());
    }
    copy.writer.finish().map_err(RecordingError::unwritten)?;
    copy.writer.into_inner().flush()?;
    Ok(())
}

/// The metadata record that marks a saved file.
fn note(inspection: &Inspection, sha256: String) -> Metadata {
    let count = |part| inspection.health.lost.get(&part).copied().unwrap_or(0);
    let entries = [
        ("software", Provenance::software().to_owned()),
        ("file", inspection.file.clone()),
        ("sha256", sha256),
        ("messages", inspection.recoverable.messages.to_string()),
        ("chunks_lost", (count(FaultyPart::Chunk) + count(FaultyPart::OpaqueChunk)).to_string()),
        ("bytes_unread", inspection.health.bytes_unread.to_string()),
    ];
    let metadata = entries.map(|(key, value)| (key.to_owned(), value)).into();
    Metadata { name: RECOVERED.to_owned(), metadata }
}

/// A new file in the making.
struct Copy<W: Write + Seek> {
    writer: Writer<W>,
    definitions: Definitions,
    /// Channels of the new file by those of the old one.
    channels: HashMap<u16, u16>,
    /// Whether calibrig's metadata record does not fit its hash.
    altered: bool,
    messages: u64,
}

impl<W: Write + Seek> Copy<W> {
    fn record(&mut self, record: Record<'_>) -> Result<(), RecordingError> {
        match record {
            Record::Metadata(mut metadata) => {
                // Under the original name the reader would refuse the file.
                if self.altered && metadata.name == METADATA {
                    ALTERED.clone_into(&mut metadata.name);
                }
                self.metadata(&metadata)
            }
            Record::Attachment { header, data, .. } => {
                let attachment = Attachment {
                    log_time: header.log_time,
                    create_time: header.create_time,
                    name: header.name,
                    media_type: header.media_type,
                    data,
                };
                self.writer.attach(&attachment).map_err(RecordingError::unwritten)
            }
            Record::Message { header, data } => self.message(header, &data),
            Record::Channel(channel) => {
                let id = channel.id;
                self.definitions.learn(Record::Channel(channel));
                self.channels.remove(&id);
                // Channels without messages are kept.
                self.channel(id).map(|_| ())
            }
            definition => {
                self.definitions.learn(definition);
                Ok(())
            }
        }
    }

    fn metadata(&mut self, metadata: &Metadata) -> Result<(), RecordingError> {
        self.writer.write_metadata(metadata).map_err(RecordingError::unwritten)
    }

    fn message(&mut self, header: MessageHeader, data: &[u8]) -> Result<(), RecordingError> {
        let Some(channel_id) = self.channel(header.channel_id)? else { return Ok(()) };
        self.messages += 1;
        self.writer
            .write_to_known_channel(&MessageHeader { channel_id, ..header }, data)
            .map_err(RecordingError::unwritten)
    }

    /// The new number of a channel; `None` if the file does not describe the channel.
    fn channel(&mut self, id: u16) -> Result<Option<u16>, RecordingError> {
        if let Some(&known) = self.channels.get(&id) {
            return Ok(Some(known));
        }
        let Some((channel, schema)) = self.definitions.channel(id) else { return Ok(None) };
        let writer = &mut self.writer;
        let schema = match schema {
            Some(schema) => writer.add_schema(&schema.header.name, &schema.header.encoding, &schema.data),
            None => Ok(0),
        };
        let added = schema.and_then(|schema| {
            writer.add_channel(schema, &channel.topic, &channel.message_encoding, &channel.metadata)
        });
        let added = added.map_err(RecordingError::unwritten)?;
        self.channels.insert(id, added);
        Ok(Some(added))
    }
}

#[cfg(test)]
mod tests;
