//! Counts what the records of a file hold.

use std::collections::{BTreeMap, HashMap};

use mcap::records::{MessageHeader, Record};
use prost::Name;

use super::carried::CarriedReport;
use super::directory::{Definitions, Directory};
use super::estimate::freedom_of;
use super::inspection::{
    AttachmentReport, EstimateReport, ProvenanceReport, ProvenanceState, SetReport, TopicReport,
};
use super::mcap_writer::RECORD_LIMIT;
use super::messages::{Decoder, Own};
use super::provenance::{AttachedInput, METADATA};
use super::schema::{set_kind, to_payload, v1};
use super::{Provenance, RecordingError};
use calibrig_model::measurement::SetKind;

/// What has been counted so far.
pub(super) struct Survey {
    pub profile: String,
    pub library: String,
    definitions: Definitions,
    tallies: HashMap<u16, Tally>,
    /// Messages on channels that the file does not describe.
    pub nameless: u64,
    /// Calibrig's first metadata record, and its place in the file.
    metadata: Option<(u64, BTreeMap<String, String>)>,
    pub metadata_names: Vec<String>,
    inputs: Vec<AttachedInput>,
    input_bytes: usize,
    pub attachments: Vec<AttachmentReport>,
    sets: BTreeMap<SetKind, SetTally>,
    pub estimates: Vec<EstimateReport>,
}

#[derive(Clone, Copy)]
struct Tally {
    messages: u64,
    bytes: u64,
    first: u64,
    last: u64,
    /// For messages about sets or estimates.
    decoder: Option<Decoder>,
}

/// A set while it is counted.
#[derive(Debug, Default)]
struct SetTally {
    report: SetReport,
    last_pose: Option<u32>,
    /// Places of the payloads in the report, by name and bits.
    known: HashMap<Option<(String, [u64; 7])>, usize>,
}

impl SetTally {
    fn observation(&mut self, message: v1::Observation) {
        let report = &mut self.report;
        report.observations += 1;
        match message.reading.and_then(|reading| reading.kind) {
            Some(v1::reading::Kind::Pose(_)) => report.full_poses += 1,
            Some(v1::reading::Kind::Spherical(reading)) if reading.back_face => report.back_face += 1,
            _ => {}
        }
        if self.last_pose.replace(message.pose) == Some(message.pose) {
            return;
        }
        report.poses += 1;
        let Ok(payload) = message.payload.as_ref().map(to_payload).transpose() else { return };
        let key = payload.as_ref().map(|payload| (payload.name.clone(), payload.bits()));
        let next = report.payloads.len();
        let place = *self.known.entry(key).or_insert(next);
        if place == next {
            report.payloads.push(CarriedReport::of(payload.as_ref(), 0));
        }
        report.payloads[place].poses += 1;
    }

    fn report(&self) -> SetReport {
        let mut report = self.report.clone();
        report.complete =
            report.described && report.expected.is_some_and(|n| u64::from(n) == report.observations);
        if report.payloads.iter().all(|carried| carried.name.is_none()) {
            report.payloads.clear();
        }
        report
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
                // Input files are short: long attachments do not belong to the hash and are not kept in memory.
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
            let schema = schema.map_or("", |schema| &schema.header.name);
            let decoder = Own::decoder(&channel.topic, schema).ok().flatten();
            let tally = Tally { messages: 0, bytes: 0, first: u64::MAX, last: 0, decoder };
            self.tallies.insert(header.channel_id, tally);
        }
        let Some(tally) = self.tallies.get_mut(&header.channel_id) else { return };
        tally.messages += 1;
        tally.bytes += data.len() as u64;
        tally.first = tally.first.min(header.log_time);
        tally.last = tally.last.max(header.log_time);
        // A message that cannot be decoded is counted; the reader refuses it.
        if let Some(Ok(own)) = tally.decoder.map(|decode| decode(data)) {
            let _ = self.own(own);
        }
    }

    fn own(&mut self, own: Own) -> Option<()> {
        match own {
            Own::Session(session) => {
                let set = &mut self.set(&session.set)?.report;
                set.described = true;
                set.planned = session.planned_poses;
                set.expected = session.observation_count;
                set.stations = session.stations.len() as u64;
                set.targets = session.targets.len() as u64;
                set.dropped += session.dropped.len() as u64;
                set.nests += session.stations.iter().map(|s| s.nests.len() as u64).sum::<u64>();
            }
            Own::SessionEnd(end) => self.set(&end.set)?.report.expected = Some(end.observation_count),
            Own::Nest(nest) => self.set(&nest.set)?.report.nests += 1,
            Own::Dropped(dropped) => self.set(&dropped.set)?.report.dropped += 1,
            Own::Observation(observation) => {
                let set = self.set(&observation.set)?;
                set.observation(observation);
            }
            Own::Estimate(estimate) => self.estimates.push(estimate_of(estimate)),
        }
        Some(())
    }

    fn set(&mut self, key: &str) -> Option<&mut SetTally> {
        let kind = set_kind(key).ok()?;
        let report = || SetReport { set: kind.key(), ..SetReport::default() };
        Some(self.sets.entry(kind).or_insert_with(|| SetTally { report: report(), ..SetTally::default() }))
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

    /// What the file says about its origin; and where in the file that stands, if it was altered.
    pub(super) fn provenance(&self) -> (Option<ProvenanceReport>, Option<u64>) {
        let Some((at, metadata)) = &self.metadata else { return (None, None) };
        let report = ProvenanceReport::of(metadata, &self.inputs);
        let altered = report.state == ProvenanceState::Altered;
        (Some(report), altered.then_some(*at))
    }

    pub(super) fn sets(&self) -> Vec<SetReport> {
        self.sets.values().map(SetTally::report).collect()
    }

    /// Topics by name, with those that only the summary knows.
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
