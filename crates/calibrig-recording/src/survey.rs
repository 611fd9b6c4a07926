//! What the records of a file hold, counted as they come.

use std::collections::{BTreeMap, HashMap};

use mcap::records::{MessageHeader, Record};
use prost::{Message, Name};

use super::carried::CarriedReport;
use super::directory::{Definitions, Directory};
use super::estimate::freedom_of;
use super::inspect::{
    AttachmentReport, EstimateReport, ProvenanceReport, ProvenanceState, SetReport, TopicReport,
};
use super::mcap_writer::RECORD_LIMIT;
use super::provenance::{AttachedInput, METADATA};
use super::schema::{set_kind, to_payload, v1};
use calibrig_model::Payload;
use calibrig_model::measurement::SetKind;

/// What has been seen of a file.
pub(super) struct Survey {
    pub profile: String,
    pub library: String,
    definitions: Definitions,
    tallies: HashMap<u16, Tally>,
    /// Messages whose channel nobody describes.
    pub nameless: u64,
    /// The first metadata record of ours, and where it is.
    metadata: Option<(u64, BTreeMap<String, String>)>,
    pub metadata_names: Vec<String>,
    inputs: Vec<AttachedInput>,
    input_bytes: usize,
    pub attachments: Vec<AttachmentReport>,
    sets: BTreeMap<SetKind, SetTally>,
    pub estimates: Vec<EstimateReport>,
}

#[derive(Debug, Clone, Copy)]
struct Tally {
    messages: u64,
    bytes: u64,
    first: u64,
    last: u64,
    /// What of ours is on it.
    holds: Holds,
}

/// A message of ours that tells of sets or estimates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Holds {
    Session,
    SessionEnd,
    Nest,
    Dropped,
    Observation,
    Estimate,
    Other,
}

#[derive(Debug, Clone, Default)]
struct SetTally {
    described: bool,
    planned: Option<u32>,
    expected: Option<u32>,
    poses: u64,
    last_pose: Option<u32>,
    observations: u64,
    dropped: u64,
    stations: u64,
    targets: u64,
    nests: u64,
    full_poses: u64,
    back_face: u64,
    carried: Vec<(Option<Payload>, usize)>,
    /// Places in it, by name and bits.
    known: HashMap<Option<(String, [u64; 7])>, usize>,
}

impl SetTally {
    /// Counts a pose that carries it.
    fn carry(&mut self, payload: Option<Payload>) {
        let key = payload.as_ref().map(|payload| (payload.name.clone(), payload.bits()));
        let next = self.carried.len();
        let place = *self.known.entry(key).or_insert(next);
        match self.carried.get_mut(place) {
            Some((_, poses)) => *poses += 1,
            None => self.carried.push((payload, 1)),
        }
    }

    /// As a report has it: empty where no pose carries anything.
    fn carried(&self) -> Vec<CarriedReport> {
        if self.carried.iter().all(|(payload, _)| payload.is_none()) {
            return Vec::new();
        }
        let report =
            |(payload, poses): &(Option<Payload>, usize)| CarriedReport::of(payload.as_ref(), *poses);
        self.carried.iter().map(report).collect()
    }
}

impl Survey {
    pub(super) fn new(directory: &Directory) -> Self {
        Self {
            profile: String::new(),
            library: String::new(),
            definitions: directory.definitions.clone(),
            tallies: HashMap::new(),
            nameless: 0,
            metadata: None,
            metadata_names: Vec::new(),
            inputs: Vec::new(),
            input_bytes: 0,
            attachments: Vec::new(),
            sets: BTreeMap::new(),
            estimates: Vec::new(),
        }
    }

    /// Takes note of a record; `at` is where it, or its chunk, begins.
    pub(super) fn record(&mut self, at: u64, record: Record<'_>) {
        match record {
            Record::Header(header) => {
                self.profile = header.profile;
                self.library = header.library;
            }
            Record::Metadata(metadata) => {
                if metadata.name == METADATA && self.metadata.is_none() {
                    self.metadata = Some((at, metadata.metadata));
                }
                self.metadata_names.push(metadata.name);
            }
            Record::Attachment { header, data, crc } => {
                let bytes = data.len();
                self.attachments.push(AttachmentReport {
                    name: header.name.clone(),
                    media_type: header.media_type,
                    bytes: bytes as u64,
                    checksum: crc != 0,
                });
                // Input files are short: others are not kept in memory for a hash that they do not belong to.
                self.input_bytes = self.input_bytes.saturating_add(bytes);
                if self.input_bytes <= RECORD_LIMIT {
                    self.inputs.push((header.name, String::from_utf8_lossy(&data).into_owned()));
                }
            }
            Record::Message { header, data } => self.message(&header, &data),
            definition => self.definitions.learn(definition),
        }
    }

    fn message(&mut self, header: &MessageHeader, data: &[u8]) {
        if !self.tallies.contains_key(&header.channel_id) {
            let Some((channel, schema)) = self.definitions.channel(header.channel_id) else {
                self.nameless += 1;
                return;
            };
            let holds = holds(&channel.topic, schema.map_or("", |schema| &schema.header.name));
            let tally = Tally { messages: 0, bytes: 0, first: u64::MAX, last: 0, holds };
            self.tallies.insert(header.channel_id, tally);
        }
        let Some(tally) = self.tallies.get_mut(&header.channel_id) else { return };
        tally.messages += 1;
        tally.bytes += data.len() as u64;
        tally.first = tally.first.min(header.log_time);
        tally.last = tally.last.max(header.log_time);
        let holds = tally.holds;
        // What cannot be decoded is for the reader to refuse.
        let _ = self.own(holds, data);
    }

    fn own(&mut self, holds: Holds, data: &[u8]) -> Option<()> {
        match holds {
            Holds::Session => {
                let session = v1::Session::decode(data).ok()?;
                let set = self.set(&session.set)?;
                set.described = true;
                set.planned = session.planned_poses;
                set.expected = session.observation_count;
                set.stations = session.stations.len() as u64;
                set.targets = session.targets.len() as u64;
                set.dropped += session.dropped.len() as u64;
                set.nests += session.stations.iter().map(|s| s.nests.len() as u64).sum::<u64>();
            }
            Holds::SessionEnd => {
                let end = v1::SessionEnd::decode(data).ok()?;
                self.set(&end.set)?.expected = Some(end.observation_count);
            }
            Holds::Nest => {
                let nest = v1::BaseNest::decode(data).ok()?;
                self.set(&nest.set)?.nests += 1;
            }
            Holds::Dropped => {
                let dropped = v1::DroppedPose::decode(data).ok()?;
                self.set(&dropped.set)?.dropped += 1;
            }
            Holds::Observation => {
                let observation = v1::Observation::decode(data).ok()?;
                let set = self.set(&observation.set)?;
                set.observations += 1;
                match observation.reading.and_then(|reading| reading.kind) {
                    Some(v1::reading::Kind::Pose(_)) => set.full_poses += 1,
                    Some(v1::reading::Kind::Spherical(reading)) if reading.back_face => set.back_face += 1,
                    _ => {}
                }
                if set.last_pose.replace(observation.pose) != Some(observation.pose) {
                    set.poses += 1;
                    if let Ok(payload) = observation.payload.as_ref().map(to_payload).transpose() {
                        set.carry(payload);
                    }
                }
            }
            Holds::Estimate => self.estimates.push(estimate_of(v1::Estimate::decode(data).ok()?)),
            Holds::Other => {}
        }
        Some(())
    }

    fn set(&mut self, key: &str) -> Option<&mut SetTally> {
        Some(self.sets.entry(set_kind(key).ok()?).or_default())
    }

    /// Messages that can be read.
    pub(super) fn messages(&self) -> u64 {
        self.tallies.values().map(|tally| tally.messages).sum()
    }

    /// Whether calibrig wrote the file, or another program with calibrig's messages.
    pub(super) fn is_ours(&self) -> bool {
        let own = format!("{}.", v1::Session::PACKAGE);
        self.metadata.is_some()
            || self.library.starts_with("calibrig ")
            || self.definitions.schemas.values().any(|schema| schema.header.name.starts_with(&own))
    }

    /// What the file says of where it comes from; and where that stands, if it was altered.
    pub(super) fn provenance(&self) -> (Option<ProvenanceReport>, Option<u64>) {
        let Some((at, metadata)) = &self.metadata else { return (None, None) };
        let report = ProvenanceReport::of(metadata, &self.inputs);
        let altered = report.state == ProvenanceState::Altered;
        (Some(report), altered.then_some(*at))
    }

    pub(super) fn sets(&self) -> Vec<SetReport> {
        let report = |(kind, set): (&SetKind, &SetTally)| SetReport {
            set: kind.key(),
            described: set.described,
            complete: set.described && set.expected.is_some_and(|n| u64::from(n) == set.observations),
            planned: set.planned,
            poses: set.poses,
            observations: set.observations,
            expected: set.expected,
            dropped: set.dropped,
            stations: set.stations,
            targets: set.targets,
            nests: set.nests,
            full_poses: set.full_poses,
            back_face: set.back_face,
            payloads: set.carried(),
        };
        self.sets.iter().map(report).collect()
    }

    /// Topics by name: those that the summary alone knows, too.
    pub(super) fn topics(&self, directory: &Directory) -> Vec<TopicReport> {
        let mut topics: BTreeMap<(&str, &str), TopicReport> = BTreeMap::new();
        for (id, channel) in &self.definitions.channels {
            let schema = self.definitions.schemas.get(&channel.schema_id);
            let schema = schema.map_or("", |schema| schema.header.name.as_str());
            let topic = topics.entry((&channel.topic, schema)).or_insert_with(|| TopicReport {
                topic: channel.topic.clone(),
                schema: schema.to_owned(),
                encoding: channel.message_encoding.clone(),
                messages: 0,
                lost: directory.counts.is_some().then_some(0),
                bytes: 0,
                first_ns: None,
                last_ns: None,
                rate_hz: None,
            });
            let found = self.tallies.get(id).map_or(0, |tally| tally.messages);
            if let (Some(lost), Some(counts)) = (&mut topic.lost, &directory.counts) {
                *lost += counts.get(id).copied().unwrap_or(0).saturating_sub(found);
            }
            let Some(tally) = self.tallies.get(id) else { continue };
            topic.messages += tally.messages;
            topic.bytes += tally.bytes;
            topic.first_ns = Some(topic.first_ns.map_or(tally.first, |first| first.min(tally.first)));
            topic.last_ns = topic.last_ns.max(Some(tally.last));
        }
        let mut topics: Vec<TopicReport> = topics.into_values().collect();
        for topic in &mut topics {
            let span = topic.last_ns.zip(topic.first_ns).map(|(last, first)| last - first);
            let gaps = topic.messages.saturating_sub(1) as f64;
            topic.rate_hz = span.filter(|&span| span > 0).map(|span| gaps / (span as f64 * 1e-9));
        }
        topics
    }
}

fn holds(topic: &str, schema: &str) -> Holds {
    let known = [
        (v1::Session::full_name(), "/session", Holds::Session),
        (v1::SessionEnd::full_name(), "/session/end", Holds::SessionEnd),
        (v1::BaseNest::full_name(), "/nest", Holds::Nest),
        (v1::DroppedPose::full_name(), "/dropped", Holds::Dropped),
        (v1::Observation::full_name(), "/measurement", Holds::Observation),
        (v1::Estimate::full_name(), "/estimate", Holds::Estimate),
    ];
    let found = known.into_iter().find(|(name, root, _)| name == schema && topic.starts_with(root));
    found.map_or(Holds::Other, |(_, _, holds)| holds)
}

fn estimate_of(message: v1::Estimate) -> EstimateReport {
    let freedom = freedom_of(&message).filter(|&freedom| freedom > 0.0);
    EstimateReport {
        chi2_per_dof: message.chi2.zip(freedom).map(|(chi2, freedom)| chi2 / freedom),
        parameters: message.parameters.len() as u64,
        termination: message.termination,
        iterations: message.iterations.len() as u64,
        rms_3d_m: message.accuracy.into_iter().map(|row| (row.set, row.rms_3d)).collect(),
        mode: message.mode,
    }
}
