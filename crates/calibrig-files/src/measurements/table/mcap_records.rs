//! The messages of an MCAP file, whichever program wrote it.

use std::collections::HashMap;
use std::io::{Read, Seek, SeekFrom};

use mcap::McapError;
use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};

use crate::mcap_chunk;

/// The longest record and chunk that is read: bags hold pictures, too.
const LIMIT: usize = 512 << 20;

/// A topic, as its channel describes it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Channel {
    pub topic: String,
    /// Name of its schema; empty without one.
    pub schema: String,
    /// Of its messages.
    pub encoding: String,
}

/// What can be wrong with the file.
#[derive(Debug)]
pub(super) enum Trouble {
    /// The container, in words.
    Container(String),
    /// Remark on a message; the reading stops.
    Stopped(String),
}

/// Receives the number of every channel with a message, the channel, the time of the message in its file (ns), and the message.
pub(super) type Visitor<'a> = dyn FnMut(u16, &Channel, u64, &[u8]) -> Result<(), String> + 'a;

/// Goes through all messages in the order of the file. Every checksum present is checked.
pub(super) fn messages(file: &mut (impl Read + Seek), visit: &mut Visitor<'_>) -> Result<(), Trouble> {
    file.seek(SeekFrom::Start(0)).map_err(|error| Trouble::Container(error.to_string()))?;
    let options = LinearReaderOptions::default()
        .with_emit_chunks(true)
        .with_validate_data_section_crc(true)
        .with_record_length_limit(LIMIT);
    let mut reader = LinearReader::new_with_options(options);
    let mut channels = Channels::default();
    while let Some(event) = reader.next_event() {
        match event.map_err(container)? {
            LinearReadEvent::ReadRequest(wanted) => {
                let read = file.read(reader.insert(wanted));
                reader.notify_read(read.map_err(|error| Trouble::Container(error.to_string()))?);
            }
            LinearReadEvent::Record { opcode: op::CHUNK, data } => {
                for (opcode, body) in mcap_chunk::open(data, LIMIT).map_err(container)?.records() {
                    channels.record(opcode, body, visit)?;
                }
            }
            // The summary repeats what is known.
            LinearReadEvent::Record { opcode: op::DATA_END, .. } => return Ok(()),
            LinearReadEvent::Record { opcode, data } => channels.record(opcode, data, visit)?,
        }
    }
    Err(Trouble::Container("it breaks off".to_owned()))
}

// By value, to be named in `map_err`.
#[allow(clippy::needless_pass_by_value)]
fn container(error: McapError) -> Trouble {
    Trouble::Container(match error {
        McapError::UnexpectedEof => "it breaks off".to_owned(),
        McapError::UnsupportedCompression(name) => {
            format!(
                "its messages are compressed with {name:?}, which is not supported: write it again with zstd, lz4 or no \
                 compression"
            )
        }
        error => format!("it is damaged: {error}"),
    })
}

#[derive(Default)]
struct Channels {
    schemas: HashMap<u16, String>,
    channels: HashMap<u16, (Channel, u16)>,
}

impl Channels {
    fn record(&mut self, opcode: u8, body: &[u8], visit: &mut Visitor<'_>) -> Result<(), Trouble> {
        if !matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE) {
            return Ok(());
        }
        match mcap::parse_record(opcode, body).map_err(container)? {
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, header.name);
            }
            Record::Channel(channel) => {
                let schema = self.schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                let known = Channel { topic: channel.topic, schema, encoding: channel.message_encoding };
                self.channels.insert(channel.id, (known, channel.schema_id));
            }
            Record::Message { header, data } => {
                if let Some((channel, _)) = self.channels.get(&header.channel_id) {
                    visit(header.channel_id, channel, header.log_time, &data).map_err(Trouble::Stopped)?;
                }
            }
            _ => {}
        }
        Ok(())
    }
}
