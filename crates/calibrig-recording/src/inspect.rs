//! What is in an MCAP file, of ours or not, sound or damaged.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use mcap::records::{Record, op};
use serde::Serialize;

use super::carried::CarriedReport;
use super::directory::Directory;
use super::provenance::{AttachedInput, RECOVERED};
use super::scan::{ReadError, scan_whole};
use super::survey::Survey;
use super::walk::{End, Fault, Part, Walk, walk};
use super::{Provenance, RecordingError};
use calibrig_model::measurement::SetKind;

/// Name and version of the JSON document.
pub const INSPECT_SCHEMA: &str = "calibrig.inspect/1";

/// Is told how many bytes of how many are behind.
pub type Progress<'a> = dyn FnMut(u64, u64) + 'a;

/// What is in a file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Inspection {
    /// [`INSPECT_SCHEMA`].
    pub schema: &'static str,
    /// The file's name, without its folder.
    pub file: String,
    /// Its length, bytes.
    pub bytes: u64,
    /// Whether the program or one of its messages made it.
    pub calibrig: bool,
    /// Whether `recover` made it of a damaged or unfinished one.
    pub recovered: bool,
    /// What it says of the program that wrote it.
    pub library: String,
    /// How sound it is.
    pub health: Health,
    /// What `recover` would save.
    pub recoverable: Recoverable,
    /// Where it comes from, if it says so.
    pub provenance: Option<ProvenanceReport>,
    /// What was measured.
    pub sets: Vec<SetReport>,
    /// What was made of it.
    pub estimates: Vec<EstimateReport>,
    /// Topics by name.
    pub topics: Vec<TopicReport>,
    /// Attached files, in their order.
    pub attachments: Vec<AttachmentReport>,
    /// Names of the metadata records, in their order.
    pub metadata: Vec<String>,
    #[serde(skip)]
    pub(super) profile: String,
    /// Whether a checksum over all of the data fits.
    #[serde(skip)]
    pub(super) sound: bool,
}

impl Inspection {
    /// Why [`read_recording`](crate::read_recording) would find nothing to replay in the file, if it was `copied` as it is, or else in what
    /// is saved of it; `None` where it reads it.
    pub fn not_replayed(&self, copied: bool) -> Option<NotReplayed> {
        let fitted = self.sets.iter().find(|set| set.set == SetKind::Identification.key());
        let opaque = self.health.faults.iter().find(|fault| fault.part == Part::OpaqueChunk);
        match (opaque, &self.provenance) {
            (Some(fault), _) if copied => Some(NotReplayed::OpaqueChunks(fault.reason.clone())),
            _ if !self.calibrig => Some(NotReplayed::Foreign),
            (_, Some(provenance)) if provenance.state == ProvenanceState::Newer => {
                Some(NotReplayed::Newer(provenance.software.clone()))
            }
            _ if fitted.is_none_or(|set| set.observations == 0) => Some(NotReplayed::NothingMeasured),
            _ if fitted.is_some_and(|set| !set.described) => Some(NotReplayed::SessionLost),
            _ => None,
        }
    }
}

/// Why a file cannot be replayed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NotReplayed {
    /// Its messages, or some, are compressed in a way that is not read: how, in words.
    OpaqueChunks(String),
    /// It is not calibrig's.
    Foreign,
    /// A later version wrote it: which.
    Newer(String),
    /// It holds no observation to fit.
    NothingMeasured,
    /// The description of the set to fit is lost.
    SessionLost,
}

/// How sound a file is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Health {
    /// In a word.
    pub state: State,
    /// The first place that is damaged, bytes from the start; `None` where nothing is, or where only a checksum over all tells.
    pub damaged_at: Option<u64>,
    /// The first hundred parts that cannot be used.
    pub faults: Vec<Fault>,
    /// Number of all of them, by kind.
    pub lost: BTreeMap<Part, u64>,
    /// Bytes that belong to no whole record.
    pub bytes_unread: u64,
    /// Chunks, sound or not.
    pub chunks: u64,
    /// Whether the data, and the summary, are under a checksum as a whole; `None` where the file does not come so far.
    pub checksum_of_data: Option<bool>,
    /// See above.
    pub checksum_of_summary: Option<bool>,
    /// Messages and attachments without a checksum of their own.
    pub without_checksum: u64,
    /// Chunks and attachments that have one, which fits.
    pub checksums: u64,
}

impl Health {
    /// Whether a flipped bit of a message or an attached file may have gone unnoticed.
    pub fn holds_unprotected(&self) -> bool {
        self.without_checksum > 0 && self.checksum_of_data != Some(true)
    }
}

/// Health in a word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Every part is there, and every checksum fits that it has.
    Whole,
    /// The program that wrote it did not come to its end.
    Unfinished,
    /// It breaks off.
    Truncated,
    /// Something in it is not as it was written.
    Damaged,
}

/// What can be saved.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Recoverable {
    /// Messages.
    pub messages: u64,
    /// Messages that are lost, where the file says how many there were.
    pub messages_lost: Option<u64>,
    /// Whether anything is lost, messages or not.
    pub anything_lost: bool,
}

/// Where a recording comes from, as it says.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ProvenanceReport {
    /// Whether that fits the recording's own hash.
    pub state: ProvenanceState,
    /// Why it does not.
    pub problem: Option<String>,
    /// Version of the recording's layout.
    pub schema: String,
    /// The program.
    pub software: String,
    /// Number of the method that made its estimates; 1 where it is not stated, `None` where it is no number.
    pub method: Option<u32>,
    /// `scenario`, `files` or `recording`.
    pub input_kind: String,
    /// Name of the input.
    pub input_name: String,
    /// Hash over every input file, hexadecimal.
    pub input_sha256: String,
    /// The seed of a simulation.
    pub seed: Option<u64>,
    /// Number of the trial.
    pub trial: Option<u32>,
    /// What stood for the machine.
    pub plant: Option<String>,
    /// Hash over metadata and attachments, hexadecimal.
    pub provenance_sha256: String,
}

/// Whether what a recording says of itself can be believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ProvenanceState {
    /// The hash fits.
    Fits,
    /// A later version of calibrig knows.
    Newer,
    /// The hash does not fit, or something is missing.
    Altered,
}

/// A measured set.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SetReport {
    /// Key of the set.
    pub set: &'static str,
    /// Whether its session, with stations and targets, is there: no observation can be used without.
    pub described: bool,
    /// Whether all of its observations are there.
    pub complete: bool,
    /// Poses that were to be measured, where known.
    pub planned: Option<u32>,
    /// Poses measured.
    pub poses: u64,
    /// Observations.
    pub observations: u64,
    /// Observations that there were, where known.
    pub expected: Option<u32>,
    /// Poses dropped.
    pub dropped: u64,
    /// Places of the tracker.
    pub stations: u64,
    /// Targets on the flange.
    pub targets: u64,
    /// Nests measured, over all stations.
    pub nests: u64,
    /// Of the observations, those that are full poses.
    pub full_poses: u64,
    /// Of the observations, those of the back face.
    pub back_face: u64,
    /// What the flange carried, in the order of the first poses; empty where it never carried anything.
    pub payloads: Vec<CarriedReport>,
}

/// A recorded estimate.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EstimateReport {
    /// Key of the mode.
    pub mode: String,
    /// Parameters.
    pub parameters: u64,
    /// Chi-square per degree of freedom; `None` where nothing was identified.
    pub chi2_per_dof: Option<f64>,
    /// Why the solver stopped; empty where nothing was identified.
    pub termination: String,
    /// Its iterations.
    pub iterations: u64,
    /// Root mean square of the 3-D errors by set, m.
    pub rms_3d_m: BTreeMap<String, f64>,
}

/// A topic.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TopicReport {
    /// Name.
    pub topic: String,
    /// Name of its schema; empty without one.
    pub schema: String,
    /// Encoding of its messages.
    pub encoding: String,
    /// Messages that can be read.
    pub messages: u64,
    /// Messages that cannot, where the file says how many there were.
    pub lost: Option<u64>,
    /// Length of the messages, bytes.
    pub bytes: u64,
    /// Time of the earliest, ns.
    pub first_ns: Option<u64>,
    /// Time of the latest, ns.
    pub last_ns: Option<u64>,
    /// Messages a second between them.
    pub rate_hz: Option<f64>,
}

/// An attached file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct AttachmentReport {
    /// Name.
    pub name: String,
    /// Media type.
    pub media_type: String,
    /// Its length, bytes.
    pub bytes: u64,
    /// Whether it has a checksum.
    pub checksum: bool,
}

/// Looks through the file at `path`. `progress` is told how far.
///
/// # Errors
/// The file cannot be read, or is no MCAP file.
pub fn inspect(path: &Path, progress: &mut Progress<'_>) -> Result<Inspection, RecordingError> {
    let unreadable = |source| RecordingError::Unreadable { path: path.to_path_buf(), source };
    let mut file = Watched::open(path, PASSES, progress).map_err(unreadable)?;
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned());
    inspect_file(&mut file, name.unwrap_or_default()).map_err(|error| match error {
        ReadError::Io(source) => unreadable(source),
        ReadError::Recording(error) => error,
    })
}

/// How often [`inspect_file`] reads the file.
pub(super) const PASSES: u64 = 2;

pub(super) fn inspect_file(file: &mut (impl Read + Seek), name: String) -> Result<Inspection, ReadError> {
    let bytes = file.seek(SeekFrom::End(0))?;
    let directory = Directory::of(file)?;
    let mut survey = Survey::new(&directory);
    let whole = check_whole(file)?;
    let walk = walk(file, &directory, whole.is_sound(), &mut |at, record| {
        survey.record(at, record);
        Ok(())
    })?;
    let (provenance, altered_at) = survey.provenance();
    Ok(assemble(name, bytes, &walk, &whole, survey, (provenance, altered_at), &directory))
}

/// What the checksums over all say.
struct Whole {
    /// `None` if the file is framed soundly to its end, and its checksums fit.
    trouble: Option<RecordingError>,
    data: Option<bool>,
    summary: Option<bool>,
}

impl Whole {
    /// Whether a checksum over all of the data fits.
    fn is_sound(&self) -> bool {
        self.trouble.is_none() && self.data == Some(true)
    }
}

fn check_whole(file: &mut (impl Read + Seek)) -> Result<Whole, ReadError> {
    let mut whole = Whole { trouble: None, data: None, summary: None };
    let scanned = scan_whole(file, &mut |opcode, body| {
        if matches!(opcode, op::DATA_END | op::FOOTER) {
            match mcap::parse_record(opcode, body)? {
                Record::DataEnd(end) => whole.data = Some(end.data_section_crc != 0),
                Record::Footer(end) => whole.summary = Some(end.summary_crc != 0),
                _ => {}
            }
        }
        Ok(())
    });
    match scanned {
        Ok(()) => {}
        Err(ReadError::Recording(error)) => whole.trouble = Some(error),
        Err(error) => return Err(error),
    }
    Ok(whole)
}

fn assemble(
    file: String,
    bytes: u64,
    walk: &Walk,
    whole: &Whole,
    survey: Survey,
    (provenance, altered_at): (Option<ProvenanceReport>, Option<u64>),
    directory: &Directory,
) -> Inspection {
    let health = health(walk, whole, altered_at);
    let messages = survey.messages();
    let total: Option<u64> = directory.counts.as_ref().map(|counts| counts.values().sum());
    let sets = survey.sets();
    let incomplete = |set: &SetReport| set.expected.is_some_and(|n| set.observations < u64::from(n));
    let recoverable = Recoverable {
        messages,
        messages_lost: total.map(|total| total.saturating_sub(messages)),
        anything_lost: health.state != State::Whole
            && (!health.lost.is_empty()
                || altered_at.is_some()
                || survey.nameless > 0
                || sets.iter().any(incomplete)),
    };
    Inspection {
        schema: INSPECT_SCHEMA,
        file,
        bytes,
        calibrig: survey.is_ours(),
        recovered: survey.metadata_names.iter().any(|name| name == RECOVERED),
        library: survey.library.clone(),
        profile: survey.profile.clone(),
        sound: whole.is_sound(),
        health,
        recoverable,
        provenance,
        sets,
        topics: survey.topics(directory),
        estimates: survey.estimates,
        attachments: survey.attachments,
        metadata: survey.metadata_names,
    }
}

fn health(walk: &Walk, whole: &Whole, altered_at: Option<u64>) -> Health {
    // Other records may stand in a file whose checksums fit; what they are is not known here.
    let harmless = |part: &Part| matches!(part, Part::Record | Part::OpaqueChunk);
    let tail = usize::from(matches!(walk.end, End::Begun | End::Within));
    let faults: u64 = walk.lost.values().sum();
    let state = if whole.trouble.is_none() && walk.lost.keys().all(harmless) && altered_at.is_none() {
        State::Whole
    } else if altered_at.is_some() || faults > tail as u64 {
        State::Damaged
    } else {
        match walk.end {
            End::Begun | End::Record => State::Unfinished,
            End::Within => State::Truncated,
            End::Data if matches!(whole.trouble, Some(RecordingError::Truncated)) => State::Truncated,
            End::Data | End::Lost => State::Damaged,
        }
    };
    let damaged_at = match state {
        State::Damaged => walk.faults.first().map(|fault| fault.offset).into_iter().chain(altered_at).min(),
        _ => None,
    };
    Health {
        state,
        damaged_at,
        faults: walk.faults.clone(),
        lost: walk.lost.clone(),
        bytes_unread: walk.unread,
        chunks: walk.chunks,
        checksum_of_data: whole.data,
        checksum_of_summary: whole.summary,
        without_checksum: walk.unprotected,
        checksums: walk.checksums,
    }
}

impl ProvenanceReport {
    /// What `metadata` says of a recording with the attachments `inputs`.
    pub(super) fn of(metadata: &BTreeMap<String, String>, inputs: &[AttachedInput]) -> Self {
        let text = |key: &str| metadata.get(key).cloned().unwrap_or_default();
        let (state, problem) = match Provenance::check(metadata, inputs) {
            Ok(_) => (ProvenanceState::Fits, None),
            Err(error @ RecordingError::NewerSchema { .. }) => {
                (ProvenanceState::Newer, Some(error.to_string()))
            }
            Err(error) => (ProvenanceState::Altered, Some(error.to_string())),
        };
        Self {
            state,
            problem,
            schema: text("schema"),
            software: text("software"),
            method: metadata.get("method").map_or(Some(1), |method| method.parse().ok()),
            input_kind: text("input_kind"),
            input_name: text("input_name"),
            input_sha256: text("input_sha256"),
            seed: metadata.get("seed").and_then(|seed| seed.parse().ok()),
            trial: metadata.get("trial").and_then(|trial| trial.parse().ok()),
            plant: metadata.get("plant").cloned(),
            provenance_sha256: text("provenance_sha256"),
        }
    }
}

/// A file that tells how much of it was read.
pub(super) struct Watched<'a> {
    file: File,
    done: u64,
    total: u64,
    progress: &'a mut Progress<'a>,
}

impl<'a> Watched<'a> {
    /// Opens a file that will be read `passes` times.
    pub(super) fn open(
        path: &Path,
        passes: u64,
        progress: &'a mut Progress<'a>,
    ) -> std::io::Result<BufReader<Self>> {
        let file = File::open(path)?;
        let metadata = file.metadata()?;
        if metadata.is_dir() {
            // Its length makes no sense.
            return Err(std::io::ErrorKind::IsADirectory.into());
        }
        let total = metadata.len().saturating_mul(passes);
        Ok(BufReader::with_capacity(1 << 16, Self { file, done: 0, total, progress }))
    }
}

impl Read for Watched<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let read = self.file.read(buffer)?;
        self.done += read as u64;
        (self.progress)(self.done.min(self.total), self.total);
        Ok(read)
    }
}

impl Seek for Watched<'_> {
    fn seek(&mut self, position: SeekFrom) -> std::io::Result<u64> {
        self.file.seek(position)
    }
}
