//! The framing of an MCAP file: its records from end to end, under the checksums over its two sections.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

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
            McapError::UnsupportedCompression(compression) => {
                RecordingError::UnknownCompression { compression }
            }
            source => RecordingError::Corrupt { source },
        })
    }
}

impl ReadError {
    /// The error of the file at `path`.
    pub(super) fn of(self, path: &Path) -> RecordingError {
        match self {
            Self::Io(source) => RecordingError::Unreadable { path: path.to_path_buf(), source },
            Self::Recording(error) => error,
        }
    }
}

/// Opens the file at `path` and reads it by `read`.
pub(super) fn with_file<T>(
    path: &Path,
    read: impl FnOnce(&mut BufReader<File>) -> Result<T, ReadError>,
) -> Result<T, RecordingError> {
    let opened = File::open(path).map_err(ReadError::Io);
    opened.and_then(|file| read(&mut BufReader::new(file))).map_err(|error| error.of(path))
}

/// What a file's framing and the checksums over its two sections say.
pub(super) struct Whole {
    /// What is wrong; `None` if the file is a sequence of records up to its end, and both checksums fit.
    pub trouble: Option<RecordingError>,
    /// Whether the data section has a checksum; `None` if the file ends before it.
    pub data: Option<bool>,
    /// The same for the summary.
    pub summary: Option<bool>,
}

impl Whole {
    /// Whether a checksum over the whole data section fits.
    pub(super) fn is_sound(&self) -> bool {
        self.trouble.is_none() && self.data == Some(true)
    }
}

/// Reads a file from start to end, without opening its chunks.
pub(super) fn check_whole(file: &mut (impl Read + Seek)) -> Result<Whole, ReadError> {
    file.seek(SeekFrom::Start(0))?;
    let mut start = Vec::new();
    file.by_ref().take(MAGIC.len() as u64).read_to_end(&mut start)?;
    if start != MAGIC {
        return Err(RecordingError::NotMcap.into());
    }
    file.seek(SeekFrom::Start(0))?;
    let options = LinearReaderOptions::default()
        .with_check_finishes_after_end_magic(true)
        .with_validate_data_section_crc(true);
    let mut whole = Whole { trouble: None, data: None, summary: None };
    let read = pull(file, options, &mut |opcode, body| {
        match (opcode == op::DATA_END || opcode == op::FOOTER).then(|| mcap::parse_record(opcode, body)) {
            Some(Ok(Record::DataEnd(end))) => whole.data = Some(end.data_section_crc != 0),
            Some(Ok(Record::Footer(end))) => whole.summary = Some(end.summary_crc != 0),
            Some(Err(error)) => return Err(error.into()),
            _ => {}
        }
        Ok(())
    });
    match read {
        Ok(()) => {}
        Err(ReadError::Recording(error)) => whole.trouble = Some(error),
        Err(error) => return Err(error),
    }
    Ok(whole)
}

/// Is given the opcode and the body of a record.
type RawVisitor<'a> = dyn FnMut(u8, &[u8]) -> Result<(), ReadError> + 'a;

/// Passes the records of `file` from where it stands to `visit`. Chunks are passed on as they are.
pub(super) fn pull(
    file: &mut impl Read,
    options: LinearReaderOptions,
    visit: &mut RawVisitor<'_>,
) -> Result<(), ReadError> {
    let options = options
        .with_emit_chunks(true)
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
