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
    /// How far its records were trusted.
    #[serde(skip)]
    pub(super) trust: Trust,
}

impl Inspection {
    /// Why [`read_recording`](crate::read_recording) would find nothing to replay in the file, if it was `copied` as it is, or else in what
    /// is saved of it; `None` where it reads it.
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
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
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
