//! The messages of ours in a recording, told apart by their topics.

use std::path::Path;

use mcap::records::Record;
use prost::{DecodeError, Message, Name};

use super::RecordingError;
use super::directory::Definitions;
use super::framing::with_file;
use super::records::read_records;
use super::schema::v1;

/// A message that tells of sets or estimates.
pub(super) enum Own {
    Session(v1::Session),
    SessionEnd(v1::SessionEnd),
    Nest(v1::BaseNest),
    Dropped(v1::DroppedPose),
    Observation(v1::Observation),
    Estimate(v1::Estimate),
}

/// Decodes the messages of a topic.
pub(super) type Decoder = fn(&[u8]) -> Result<Own, DecodeError>;

impl Own {
    /// The decoder for the messages of schema `schema` on `topic`; `None` where they are not of this kind.
    ///
    /// # Errors
    /// The topic is one of these, and its schema another.
    pub(super) fn decoder(topic: &str, schema: &str) -> Result<Option<Decoder>, String> {
        let (own, decoder): (_, Decoder) = match topic {
            "/session" => (has::<v1::Session>(schema), |data| decoded(data, Self::Session)),
            "/session/end" => (has::<v1::SessionEnd>(schema), |data| decoded(data, Self::SessionEnd)),
            "/nest" => (has::<v1::BaseNest>(schema), |data| decoded(data, Self::Nest)),
            "/dropped" => (has::<v1::DroppedPose>(schema), |data| decoded(data, Self::Dropped)),
            _ if lies_below(topic, "/measurement") => {
                (has::<v1::Observation>(schema), |data| decoded(data, Self::Observation))
            }
            _ if topic.starts_with("/estimate/") => {
                (has::<v1::Estimate>(schema), |data| decoded(data, Self::Estimate))
            }
            _ => return Ok(None),
        };
        own.map(|()| Some(decoder))
    }

    /// Key of the set that the message belongs to, if it belongs to one that its session has to describe.
    pub(super) fn set(&self) -> Option<&str> {
        match self {
            Self::SessionEnd(message) => Some(&message.set),
            Self::Nest(message) => Some(&message.set),
            Self::Dropped(message) => Some(&message.set),
            Self::Observation(message) => Some(&message.set),
            Self::Session(_) | Self::Estimate(_) => None,
        }
    }
}

fn has<M: Name>(schema: &str) -> Result<(), String> {
    if schema == M::full_name() {
        Ok(())
    } else {
        Err(format!("its schema is {schema}, {} was expected", M::full_name()))
    }
}

fn decoded<M: Message + Default>(data: &[u8], own: fn(M) -> Own) -> Result<Own, DecodeError> {
    M::decode(data).map(own)
}

/// The message in `data`, whose schema must be that of `M`.
pub(super) fn decode<M: Message + Name + Default>(schema: &str, data: &[u8]) -> Result<M, String> {
    has::<M>(schema)?;
    M::decode(data).map_err(|error| error.to_string())
}

/// Is given a message: its topic, the name of its schema, and its bytes.
type Visitor<'a> = dyn FnMut(&str, &str, &[u8]) -> Result<(), String> + 'a;

/// Passes the messages of the recording at `path` to `visit`.
pub(super) fn read_messages(path: &Path, visit: &mut Visitor<'_>) -> Result<(), RecordingError> {
    let mut definitions = Definitions::default();
    let read = with_file(path, |file| {
        read_records(file, &mut |record| {
            let Record::Message { header, data } = record else {
                definitions.learn(record);
                return Ok(());
            };
            let Some((topic, schema)) = definitions.names(header.channel_id) else { return Ok(()) };
            visit(topic, schema, &data).map_err(|reason| invalid(topic, header.sequence, reason).into())
        })
    });
    read.map(|_| ())
}

pub(super) fn invalid(topic: &str, sequence: u32, reason: String) -> RecordingError {
    RecordingError::InvalidMessage { topic: topic.to_owned(), sequence, reason }
}

/// Whether `topic` is `root` or lies below it.
pub(super) fn lies_below(topic: &str, root: &str) -> bool {
    topic.strip_prefix(root).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
}
