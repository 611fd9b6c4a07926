//! What can go wrong with a recording.

use std::path::PathBuf;

use mcap::McapError;
use miette::Diagnostic;
use thiserror::Error;

use super::provenance::SCHEMA;

const WRITTEN_BY: &str =
    "expected an MCAP file, such as the recording.mcap that `calibrig run` writes: check the path";

/// A recording that cannot be written or read.
#[derive(Debug, Error, Diagnostic)]
#[non_exhaustive]
pub enum RecordingError {
    /// The file cannot be written.
    #[error("cannot write {}", path.display())]
    #[diagnostic(help(
        "expected an existing folder with free space and permission to write: choose another folder, or make room"
    ))]
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
    /// What was given is not the address of a viewer.
    #[error("`{url}` is not the address of a Rerun viewer: {reason}")]
    #[diagnostic(help("expected an address such as rerun+http://127.0.0.1:9876/proxy"))]
    BadViewerUrl {
        /// As given.
        url: String,
        /// What is wrong.
        reason: String,
    },
    /// No viewer answers.
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
    /// The viewer was closed, or stopped reading, before it had everything.
    #[error("the Rerun viewer at {url} did not get everything: {reason}")]
    #[diagnostic(help(
        "expected a viewer that stays open until the end; what it has not got is in the files that the run writes"
    ))]
    ViewerLost {
        /// Where it was.
        url: String,
        /// What is known.
        reason: String,
    },
    /// An input file is too long to be attached.
    #[error("the input {name} is {bytes} bytes long: a recording holds at most {limit} bytes of one input")]
    #[diagnostic(help("expected a shorter file: leave out of it what the run does not need, or split it"))]
    AttachmentTooLong {
        /// Role and name.
        name: String,
        /// Its length.
        bytes: usize,
        /// The greatest length that can be read back.
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
    #[error("the recording ends before its footer: it was not finished, or a part is missing")]
    #[diagnostic(help(
        "expected a complete file: copy it again, or save what is there with `calibrig recover FILE NEW`"
    ))]
    Truncated,
    /// A checksum or a length is wrong.
    #[error("the recording is damaged")]
    #[diagnostic(help(
        "expected checksums and lengths that fit the contents: copy it again, or save what is sound with `calibrig recover FILE NEW`"
    ))]
    Corrupt {
        /// What does not fit.
        source: McapError,
    },
    /// Chunks in a compression that the MCAP specification does not know.
    #[error("the messages are compressed with {compression:?}, which is not read")]
    #[diagnostic(help(
        "expected zstd, lz4 or no compression: write the file again with one of them, in the program that made it"
    ))]
    UnknownCompression {
        /// As the chunk says.
        compression: String,
    },
    /// An MCAP file of another program.
    #[error(
        "the MCAP file is not a calibrig recording: it has neither metadata `calibrig` nor a message on /session"
    )]
    #[diagnostic(help(
        "expected a recording of `calibrig run`, or of another program on the topics that docs/formats.md names"
    ))]
    Foreign,
    /// A file holds nothing that could be saved.
    #[error("{} holds no message that can be read: {bytes} bytes, of which {unread} are not readable{}", path.display(), why.as_ref().map(|why| format!(", and a chunk: {why}")).unwrap_or_default())]
    #[diagnostic(help(
        "expected a file with at least one message in a sound chunk; no new file is written: look for another copy"
    ))]
    NothingToRecover {
        /// The file.
        path: PathBuf,
        /// Its length.
        bytes: u64,
        /// Bytes that belong to no whole record.
        unread: u64,
        /// Why a chunk cannot be read.
        why: Option<String>,
    },
    /// The damaged file was named as the new one, too.
    #[error("{} is the damaged file itself", path.display())]
    #[diagnostic(help("expected another name for the new file: the damaged one stays as it is"))]
    SameFile {
        /// The file.
        path: PathBuf,
    },
    /// A file of that name exists.
    #[error("{} is already there", path.display())]
    #[diagnostic(help("expected the name of a new file, or --force to write over it"))]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// A folder of that name exists.
    #[error("{} is a folder", path.display())]
    #[diagnostic(help("expected the name of a file: add one to the folder, such as {}/recovered.mcap", path.display()))]
    IsFolder {
        /// The folder.
        path: PathBuf,
    },
    /// A topic to leave out does not exist.
    #[error("the recording has no topic {topic}")]
    #[diagnostic(help("expected one of {}", known.join(", ")))]
    NoSuchTopic {
        /// As asked for.
        topic: String,
        /// The topics of the recording.
        known: Vec<String>,
    },
    /// The recording was written by a later version.
    #[error("the recording has schema {found}, this version reads up to {SCHEMA}")]
    #[diagnostic(help(
        "expected schema {SCHEMA} or an older one: use the version of calibrig that wrote it: {software}"
    ))]
    NewerSchema {
        /// The recording's schema.
        found: String,
        /// The software that wrote it.
        software: String,
    },
    /// A metadata key is missing or has an impossible value.
    #[error("the recording's metadata lack a valid `{key}`: found {found}")]
    #[diagnostic(help(
        "expected {expected}: the metadata were changed after the run, so take the original file"
    ))]
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
    #[diagnostic(help("expected the attachments {}: take the original file, from which none were removed", expected.join(", ")))]
    MissingAttachments {
        /// Names of the missing attachments.
        missing: Vec<String>,
        /// Names of all attachments that should be there.
        expected: Vec<String>,
    },
    /// Metadata or input files were changed after the run.
    #[error("the recording's provenance was altered: its hash is {found}")]
    #[diagnostic(help(
        "expected {expected}, as the recording itself states: its metadata or input files were changed after the run, so take the original file"
    ))]
    AlteredProvenance {
        /// Hash that the recording states, hexadecimal.
        expected: String,
        /// Hash of its present contents, hexadecimal.
        found: String,
    },
    /// Nothing was measured that could be fitted.
    #[error(
        "the recording holds no measurements to fit: {sets} sets on /session, but no observation of the identification set"
    )]
    #[diagnostic(help(
        "expected at least one calibrig.v1.Observation on /measurement/identification, after the session that describes its set"
    ))]
    NoMeasurements {
        /// Number of described sets.
        sets: usize,
    },
    /// Some measurements are missing.
    #[error("the recording holds {found} observations of the {set} set")]
    #[diagnostic(help(
        "expected {expected}, as its session states: take the original file, or write it again with the program that made it"
    ))]
    MissingMeasurements {
        /// Key of the set.
        set: &'static str,
        /// As stated.
        expected: usize,
        /// As found.
        found: usize,
    },
    /// One of calibrig's own messages that cannot be used.
    #[error("message {sequence} on {topic}: {reason}")]
    #[diagnostic(help(
        "expected a message as calibrig.proto describes it (package calibrig.v1): mend the program that wrote it"
    ))]
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

    /// The library's error, or its cause where that says more.
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
