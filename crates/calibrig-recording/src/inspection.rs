//! What a look through an MCAP file finds, as reports have it.

use std::collections::BTreeMap;

use serde::Serialize;

use super::carried::CarriedReport;
use super::health::{FaultyPart, Health};
use super::records::Trust;
use calibrig_model::measurement::SetKind;

/// Name and version of the JSON document.
pub const INSPECT_SCHEMA: &str = "calibrig.inspect/1";

/// What is in a file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Inspection {
    /// [`INSPECT_SCHEMA`].
    pub schema: &'static str,
    /// The file's name, without its folder.
    pub file: String,
    /// Its length, bytes.
    pub bytes: u64,
    /// Whether calibrig wrote it, or another program with calibrig's messages.
    pub calibrig: bool,
    /// Whether `recover` saved it from a damaged or unfinished one.
    pub recovered: bool,
    /// The program that wrote it, as it states itself.
    pub library: String,
    /// How sound it is.
    pub health: Health,
    /// What `recover` would save.
    pub recoverable: Recoverable,
    /// Its origin, if it states one.
    pub provenance: Option<ProvenanceReport>,
    /// What was measured.
    pub sets: Vec<SetReport>,
    /// The recorded estimates.
    pub estimates: Vec<EstimateReport>,
    /// Topics by name.
    pub topics: Vec<TopicReport>,
    /// Attached files, in their order.
    pub attachments: Vec<AttachmentReport>,
    /// Names of the metadata records, in their order.
    pub metadata: Vec<String>,
    #[serde(skip)]
    pub(super) profile: String,
    /// How far its records were trusted.
    #[serde(skip)]
    pub(super) trust: Trust,
}

impl Inspection {
    /// Why [`read_recording`](crate::read_recording) would refuse the file itself (`copied`), or else what is saved from it; `None` if it can be
    /// replayed.
    pub fn not_replayed(&self, copied: bool) -> Option<NotReplayed> {
        let fitted = self.sets.iter().find(|set| set.set == SetKind::Identification.key());
        let opaque = self.health.faults.iter().find(|fault| fault.part == FaultyPart::OpaqueChunk);
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
    /// Some or all messages are in a compression that is not read: which, in words.
    OpaqueChunks(String),
    /// It is not a calibrig recording.
    Foreign,
    /// This later version wrote it.
    Newer(String),
    /// It holds no observation to fit.
    NothingMeasured,
    /// The description of the set to fit is lost.
    SessionLost,
}

/// What can be saved.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Recoverable {
    /// Messages.
    pub messages: u64,
    /// Lost messages, if the file states how many there were.
    pub messages_lost: Option<u64>,
    /// Whether anything is lost, messages or not.
    pub anything_lost: bool,
}

/// The origin of a recording, as it states itself.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ProvenanceReport {
    /// Whether it fits the recording's own hash.
    pub state: ProvenanceState,
    /// Why it does not.
    pub problem: Option<String>,
    /// Version of the recording's layout.
    pub schema: String,
    /// The program.
    pub software: String,
    /// Number of the method that made its estimates: 1 if the recording does not state one, `None` if it states something else than a number.
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

/// Whether the stated origin of a recording can be trusted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ProvenanceState {
    /// The hash fits.
    Fits,
    /// A later version wrote it, and this one cannot check it.
    Newer,
    /// The hash does not fit, or something is missing.
    Altered,
}

/// A measured set.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct SetReport {
    /// Key of the set.
    pub set: &'static str,
    /// Whether its session, with stations and targets, is in the file: without it no observation can be used.
    pub described: bool,
    /// Whether all of its observations are there.
    pub complete: bool,
    /// Poses that were planned, if known.
    pub planned: Option<u32>,
    /// Poses measured.
    pub poses: u64,
    /// Observations.
    pub observations: u64,
    /// Observations that were made, if known.
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
    /// What the flange carried, in order of first use; empty if it never carried anything.
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
    /// Messages that cannot be read, if the file states how many there were.
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
