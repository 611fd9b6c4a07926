//! What can go wrong with a recording.

use std::path::PathBuf;

use mcap::McapError;
use miette::Diagnostic;
use thiserror::Error;

use super::provenance::SCHEMA;

const WRITTEN_BY: &str = "expected a recording.mcap written by `calibrig run`";

/// A recording that cannot be written or read.
#[derive(Debug, Error, Diagnostic)]
#[non_exhaustive]
pub enum RecordingError {
    /// The file cannot be written.
    #[error("cannot write {}", path.display())]
    #[diagnostic(help("expected a folder that is there, with room and permission to write"))]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A sink refused a message.
    #[error("cannot write the recording: {reason}")]
    Unrecordable {
        /// The sink's words.
        reason: String,
    },
    /// The address of a viewer makes no sense.
    #[error("`{url}` is not the address of a Rerun viewer: {reason}")]
    #[diagnostic(help("expected an address such as rerun+http://127.0.0.1:9876/proxy"))]
    BadViewerUrl {
        /// As given.
        url: String,
        /// What is wrong.
        reason: String,
    },
    /// No viewer listens.
    #[error("no Rerun viewer can be reached at {url}: {reason}")]
    #[diagnostic(help(
        "expected an open viewer: `pip install rerun-sdk=={version}` or `cargo install rerun-cli@{version}`, then `rerun` in another terminal"
    ))]
    NoViewer {
        /// Where it was looked for.
        url: String,
        /// Why it was not found.
        reason: String,
        /// The version that fits.
        version: String,
    },
    /// The viewer went away, or does not read, before it was told everything.
    #[error("the Rerun viewer at {url} was not told everything: {reason}")]
    ViewerLost {
        /// Where it was.
        url: String,
        /// What is known.
        reason: String,
    },
    /// An input file is too long to be attached.
    #[error("the input {name} is {bytes} bytes long: a recording holds at most {limit} bytes of one input")]
    AttachmentTooLong {
        /// Role and name.
        name: String,
        /// Its length.
        bytes: usize,
        /// The longest that is read back.
        limit: usize,
    },
    /// The file cannot be opened or read.
    #[error("cannot read {}", path.display())]
    #[diagnostic(help("{WRITTEN_BY}"))]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The first bytes are not those of an MCAP file.
    #[error("not an MCAP file: it does not begin with MCAP's magic bytes")]
    #[diagnostic(help("{WRITTEN_BY}"))]
    NotMcap,
    /// The file ends too early.
    #[error("the recording breaks off before its end: it was not finished, or is damaged")]
    #[diagnostic(help("expected the footer of a finished recording; copy it again or record the run again"))]
    Truncated,
    /// A checksum or a length is wrong.
    #[error("the recording is damaged")]
    #[diagnostic(help("expected checksums that fit the contents; copy it again or record the run again"))]
    Corrupt {
        /// What does not fit.
        source: McapError,
    },
    /// Chunks whose compression is none of MCAP's specification.
    #[error("the messages are compressed with {compression:?}, which is not read")]
    #[diagnostic(help("expected zstd, lz4 or no compression: write the file again with one of these"))]
    UnknownCompression {
        /// As the chunk says.
        compression: String,
    },
    /// An MCAP file of another program.
    #[error(
        "the MCAP file is not a calibrig recording: it has neither metadata `calibrig` nor a message on /session"
    )]
    #[diagnostic(help(
        "{WRITTEN_BY}, or recorded by another program on the topics that docs/formats.md names"
    ))]
    Foreign,
    /// Nothing can be saved of a file.
    #[error("{} holds no message that can be read: {bytes} bytes, of which {unread} are not readable{}", path.display(), why.as_ref().map(|why| format!(", and a chunk: {why}")).unwrap_or_default())]
    #[diagnostic(help(
        "expected a file in which something was recorded before it ended; nothing is written"
    ))]
    NothingToRecover {
        /// The file.
        path: PathBuf,
        /// Its length.
        bytes: u64,
        /// Bytes that belong to no whole record.
        unread: u64,
        /// Why a chunk is not looked into.
        why: Option<String>,
    },
    /// A file is to be saved over itself.
    #[error("{} is the damaged file itself", path.display())]
    #[diagnostic(help("expected the name of another file: the damaged one is not touched"))]
    SameFile {
        /// The file.
        path: PathBuf,
    },
    /// A file is in the way.
    #[error("{} is already there", path.display())]
    #[diagnostic(help("expected the name of a new file, or --force to write over it"))]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// A folder has the name that a file should get.
    #[error("{} is a folder", path.display())]
    #[diagnostic(help("expected the name of a file to write"))]
    IsFolder {
        /// The folder.
        path: PathBuf,
    },
    /// A topic that is to be left out is not there.
    #[error("the recording has no topic {topic}")]
    #[diagnostic(help("expected one of {}", known.join(", ")))]
    NoSuchTopic {
        /// As asked for.
        topic: String,
        /// What there is.
        known: Vec<String>,
    },
    /// The recording was written by a later version.
    #[error("the recording has schema {found}, this version reads up to {SCHEMA}")]
    #[diagnostic(help("use the version of calibrig that wrote it: {software}"))]
    NewerSchema {
        /// The recording's schema.
        found: String,
        /// The software that wrote it.
        software: String,
    },
    /// A metadata key is missing or makes no sense.
    #[error("the recording's metadata lack a valid `{key}`: found {found}")]
    #[diagnostic(help("expected {expected}"))]
    BadProvenance {
        /// The key.
        key: String,
        /// Its value, or `nothing`.
        found: String,
        /// What was expected.
        expected: &'static str,
    },
    /// Input files are missing.
    #[error("the recording lacks the input files {}", missing.join(", "))]
    #[diagnostic(help("expected the attachments {}", expected.join(", ")))]
    MissingAttachments {
        /// Names of the attachments that are not there.
        missing: Vec<String>,
        /// All that should be.
        expected: Vec<String>,
    },
    /// Metadata or input files were changed after the run.
    #[error("the recording's provenance was altered: its hash is {found}")]
    #[diagnostic(help(
        "expected {expected}, the hash that the recording states of its metadata and input files"
    ))]
    AlteredProvenance {
        /// Hash that the recording states, hexadecimal.
        expected: String,
        /// Hash of what is there, hexadecimal.
        found: String,
    },
    /// Nothing was measured.
    #[error(
        "the recording holds no measurements to fit: {sets} sets on /session, but no observation of the identification set"
    )]
    #[diagnostic(help(
        "expected at least one calibrig.v1.Observation on /measurement/identification, behind its session"
    ))]
    NoMeasurements {
        /// Number of sets that are described.
        sets: usize,
    },
    /// Some measurements are missing.
    #[error("the recording holds {found} observations of the {set} set")]
    #[diagnostic(help("expected {expected}, as its session states"))]
    MissingMeasurements {
        /// Key of the set.
        set: &'static str,
        /// As stated.
        expected: usize,
        /// As found.
        found: usize,
    },
    /// A message of ours that makes no sense.
    #[error("message {sequence} on {topic}: {reason}")]
    #[diagnostic(help("expected a message as described in calibrig.proto, package calibrig.v1"))]
    InvalidMessage {
        /// The topic.
        topic: String,
        /// Number of the message on its topic, from 0.
        sequence: u32,
        /// What is wrong.
        reason: String,
    },
}

impl RecordingError {
    // By value, to be named in `map_err`.
    #[allow(clippy::needless_pass_by_value)]
    pub(super) fn unrecordable(reason: impl ToString) -> Self {
        Self::Unrecordable { reason: reason.to_string() }
    }

    /// What the library says, with the cause that it does not say.
    // By value, to be named in `map_err`.
    #[allow(clippy::needless_pass_by_value)]
    pub(super) fn unwritten(error: McapError) -> Self {
        match std::error::Error::source(&error) {
            Some(cause) => Self::unrecordable(cause),
            None => Self::unrecordable(error),
        }
    }
}

impl From<std::io::Error> for RecordingError {
    fn from(error: std::io::Error) -> Self {
        Self::unrecordable(error)
    }
}
