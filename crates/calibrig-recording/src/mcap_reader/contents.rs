//! Collects the contents of a recording, record by record.

use std::collections::{BTreeMap, BTreeSet};

use mcap::records::Record;

use super::{MissingPart, ReadOptions, RecordedEstimate, RecordedParameter, Recording};
use crate::directory::Definitions;
use crate::estimate::freedom_of;
use crate::messages::{Own, invalid, lies_below};
use crate::provenance::{AttachedInput, METADATA, RECOVERED, source_of};
use crate::records::Unprotected;
use crate::schema::{self, v1};
use crate::{Provenance, RecordingError};
use calibrig_model::measurement::{SetKind, SetOutcome};

/// What has been read so far.
pub(super) struct Contents<'a> {
    options: &'a ReadOptions,
    metadata: Option<BTreeMap<String, String>>,
    recovered: bool,
    inputs: Vec<AttachedInput>,
    definitions: Definitions,
    sets: Vec<SetInProgress>,
    estimates: Vec<RecordedEstimate>,
    /// Sets whose session was lost from a damaged file: without stations and targets, their observations cannot be used.
    lost: BTreeSet<SetKind>,
}

struct SetInProgress {
    set: SetOutcome,
    /// Number of its observations, as the session states it once they are all made.
    expected: Option<usize>,
    planned: Option<usize>,
}

impl<'a> Contents<'a> {
    pub fn new(options: &'a ReadOptions) -> Self {
        Self {
            options,
            metadata: None,
            recovered: false,
            inputs: Vec::new(),
            definitions: Definitions::default(),
            sets: Vec::new(),
            estimates: Vec::new(),
            lost: BTreeSet::new(),
        }
    }

    pub fn record(&mut self, record: Record<'_>) -> Result<(), RecordingError> {
        match record {
            Record::Metadata(metadata) if metadata.name == METADATA => {
                self.metadata.get_or_insert(metadata.metadata);
            }
            Record::Metadata(metadata) => self.recovered |= metadata.name == RECOVERED,
            Record::Attachment { header, data, .. } => {
                // Input files are texts; any other attachment changes the hash.
                self.inputs.push((header.name, String::from_utf8_lossy(&data).into_owned()));
            }
            Record::Message { header, data } => {
                if let Err(reason) = self.message(header.channel_id, &data) {
                    let topic = self.definitions.names(header.channel_id).unwrap_or_default().0;
                    return Err(invalid(topic, header.sequence, reason));
                }
            }
            definition => self.definitions.learn(definition),
        }
        Ok(())
    }

    fn message(&mut self, channel: u16, data: &[u8]) -> Result<(), String> {
        // A message without a channel is skipped; if it was the session, its absence is told at the end.
        let Some((topic, schema)) = self.definitions.names(channel) else { return Ok(()) };
        if self.options.drop(topic) {
            return Ok(());
        }
        let Some(decoder) = Own::decoder(topic, schema)? else { return Ok(()) };
        let own = decoder(data).map_err(|error| error.to_string())?;
        if self.is_of_a_lost_set(&own) {
            return Ok(());
        }
        match own {
            Own::Session(message) => self.session(&message),
            Own::SessionEnd(message) => self.session_end(&message),
            Own::Nest(message) => self.nest(&message),
            Own::Dropped(message) => self.dropped(message),
            Own::Observation(message) => self.observation(&message),
            Own::Estimate(message) => self.estimate(message),
        }
    }

    /// Whether a message belongs to a set whose session is not in a recovered file.
    fn is_of_a_lost_set(&mut self, own: &Own) -> bool {
        let key = own.set().filter(|_| self.recovered);
        // An unknown key is refused below, where the message is read.
        let Some(kind) = key.and_then(|key| schema::set_kind(key).ok()) else { return false };
        let lost = !self.sets.iter().any(|known| known.set.kind == kind);
        if lost {
            self.lost.insert(kind);
        }
        lost
    }

    fn session(&mut self, message: &v1::Session) -> Result<(), String> {
        let set = SetOutcome::try_from(message)?;
        if self.sets.iter().any(|known| known.set.kind == set.kind) {
            return Err(format!("the {} set is described twice", set.kind.key()));
        }
        self.sets.push(SetInProgress {
            set,
            expected: message.observation_count.map(count).transpose()?,
            planned: message.planned_poses.map(count).transpose()?,
        });
        Ok(())
    }

    /// The set that a message belongs to.
    fn set(&mut self, key: &str) -> Result<&mut SetInProgress, String> {
        let kind = schema::set_kind(key)?;
        let known = self.sets.iter_mut().find(|known| known.set.kind == kind);
        known.ok_or_else(|| format!("no session before it describes the {key} set"))
    }

    fn session_end(&mut self, message: &v1::SessionEnd) -> Result<(), String> {
        let expected = Some(count(message.observation_count)?);
        let set = self.set(&message.set)?;
        if set.expected.is_some() {
            return Err(format!("the {} set ends twice", message.set));
        }
        set.expected = expected;
        Ok(())
    }

    fn nest(&mut self, message: &v1::BaseNest) -> Result<(), String> {
        let nest = schema::to_nest(message.nest.as_ref().ok_or("the nest is missing")?)?;
        let stations = &mut self.set(&message.set)?.set.measurements.stations;
        let known = stations.len();
        let station = usize::try_from(message.station).ok().and_then(|index| stations.get_mut(index));
        station
            .ok_or_else(|| format!("station {} does not exist: the session has {known}", message.station))?
            .nests
            .push(nest);
        Ok(())
    }

    fn dropped(&mut self, message: v1::DroppedPose) -> Result<(), String> {
        self.set(&message.set)?.set.dropped.push((message.pose, message.reason));
        Ok(())
    }

    fn observation(&mut self, message: &v1::Observation) -> Result<(), String> {
        // Where some were lost, or another program did not number them, the observations are taken in the order of the file.
        let counted = self.metadata.is_some() && !self.recovered;
        let set = &mut self.set(&message.set)?.set;
        let place = set.measurements.observations.len();
        if counted && usize::try_from(message.index) != Ok(place) {
            return Err(format!(
                "observation {} of the {} set where {place} was expected",
                message.index, message.set
            ));
        }
        let observation = schema::to_observation(message, set)?;
        set.measurements.observations.push(observation);
        Ok(())
    }

    fn estimate(&mut self, message: v1::Estimate) -> Result<(), String> {
        if self.estimates.iter().any(|known| known.mode == message.mode) {
            return Err(format!("mode {} has two estimates", message.mode));
        }
        let parameter = |p: v1::Parameter| {
            let value = p.value.ok_or_else(|| format!("parameter {} has no value", p.name))?;
            Ok::<_, String>(RecordedParameter { name: p.name, value, sigma: p.sigma })
        };
        let rms = |row: &v1::Accuracy| Ok::<_, String>((schema::set_kind(&row.set)?, row.rms_3d));
        self.estimates.push(RecordedEstimate {
            degrees_of_freedom: freedom_of(&message),
            mode: message.mode,
            parameters: message.parameters.into_iter().map(parameter).collect::<Result<_, _>>()?,
            chi2: message.chi2,
            termination: message.termination,
            iterations: message.iterations.len(),
            stations: message.stations.iter().map(schema::to_pose).collect::<Result<_, _>>()?,
            targets: message.targets.iter().map(schema::to_point).collect::<Result<_, _>>()?,
            rms_3d: message.accuracy.iter().map(rms).collect::<Result<_, _>>()?,
        });
        Ok(())
    }

    pub fn finish(mut self) -> Result<Recording, RecordingError> {
        let topics: BTreeSet<String> =
            self.definitions.channels.values().map(|channel| channel.topic.clone()).collect();
        for dropped in &self.options.dropped_topics {
            if !topics.iter().any(|topic| lies_below(topic, dropped)) {
                let known = topics.into_iter().collect();
                return Err(RecordingError::NoSuchTopic { topic: dropped.clone(), known });
            }
        }
        let provenance = match &self.metadata {
            Some(metadata) => Some(Provenance::check(metadata, &self.inputs)?),
            None if self.sets.is_empty() => return Err(RecordingError::Foreign),
            None => None,
        };
        let sets = self.sets.len();
        self.sets.sort_by_key(|known| known.set.kind);
        let fitted = self.sets.first().filter(|known| known.set.kind == SetKind::Identification);
        if fitted.is_none_or(|known| known.set.measurements.observations.is_empty()) {
            return Err(RecordingError::NoMeasurements { sets });
        }
        let options = self.options;
        self.sets.retain(|known| !options.drop(&format!("/measurement/{}", known.set.kind.key())));
        let mut missing = Vec::new();
        for SetInProgress { set, expected, planned } in &self.sets {
            let (kind, found) = (set.kind, set.measurements.observations.len());
            match *expected {
                Some(expected) if found == expected => {}
                Some(expected) if self.recovered => {
                    missing.push(MissingPart { kind, found, expected: Some(expected) });
                }
                Some(expected) => {
                    return Err(RecordingError::MissingMeasurements { set: kind.key(), expected, found });
                }
                // Other programs may leave out the end of a set.
                None if provenance.is_none() && !self.recovered => {}
                None => missing.push(MissingPart { kind, found, expected: *planned }),
            }
        }
        missing.extend(self.lost.iter().map(|&kind| MissingPart { kind, found: 0, expected: None }));
        Ok(Recording {
            provenance,
            sources: self.inputs.into_iter().map(source_of).collect(),
            sets: self.sets.into_iter().map(|known| known.set).collect(),
            missing,
            recovered: self.recovered,
            unprotected: Unprotected::default(),
            estimates: self.estimates,
        })
    }
}

fn count(value: u32) -> Result<usize, String> {
    usize::try_from(value).map_err(|e| e.to_string())
}
