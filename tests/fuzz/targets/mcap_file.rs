//! MCAP files with whatever in them, whose framing and checksums are right, and then perhaps damaged.

use std::collections::BTreeMap;
use std::io::Cursor;

use mcap::records::{MessageHeader, Metadata, Record};
use mcap::{Attachment, Compression, WriteOptions};

use super::choices::Choices;

/// Schema, channel, message, attachment or metadata.
#[derive(Clone)]
pub enum Part {
    Message { topic: String, schema: (String, String, Vec<u8>), encoding: String, time: u64, data: Vec<u8> },
    Attachment(String, Vec<u8>),
    Metadata(Metadata),
}

/// What a sound file holds: of every topic the first `most` messages.
pub fn parts(file: &[u8], most: usize) -> Vec<Part> {
    let (mut schemas, mut channels, mut counts) = (BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
    let mut parts = Vec::new();
    for record in mcap::read::ChunkFlattener::new(file).expect("an MCAP file") {
        match record.expect("sound") {
            Record::Schema { header, data } => {
                schemas.insert(header.id, (header.name, header.encoding, data.into_owned()));
            }
            Record::Channel(channel) => {
                channels.insert(channel.id, channel);
            }
            Record::Message { header, data } => {
                let channel = &channels[&header.channel_id];
                let count: &mut usize = counts.entry(header.channel_id).or_default();
                *count += 1;
                if *count <= most {
                    parts.push(Part::Message {
                        topic: channel.topic.clone(),
                        schema: schemas.get(&channel.schema_id).cloned().unwrap_or_default(),
                        encoding: channel.message_encoding.clone(),
                        time: header.log_time,
                        data: data.into_owned(),
                    });
                }
            }
            Record::Attachment { header, data, .. } => {
                parts.push(Part::Attachment(header.name, data.into_owned()));
            }
            Record::Metadata(metadata) => parts.push(Part::Metadata(metadata)),
            _ => {}
        }
    }
    parts
}

/// A whole file of these parts.
pub fn file(parts: &[Part], profile: &str, choices: &mut Choices<'_>) -> Vec<u8> {
    let compression = [None, None, Some(Compression::Zstd)][choices.below(3)];
    let crc = choices.below(4) != 3;
    let options = WriteOptions::new()
        .profile(profile)
        .library("calibrig-fuzz")
        .compression(compression)
        .use_chunks(choices.below(8) != 7)
        .chunk_size(Some([1 << 16, 64, 1 << 10][choices.below(3)]))
        .calculate_chunk_crcs(crc)
        .calculate_data_section_crc(crc)
        .calculate_attachment_crcs(crc)
        .emit_summary_records(choices.below(8) != 7);
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = options.create(&mut bytes).expect("begun");
    for (sequence, part) in (0..).zip(parts) {
        match part {
            Part::Message {
                topic,
                schema: (name, encoding, definition),
                encoding: of_message,
                time,
                data,
            } => {
                let schema = if name.is_empty() {
                    0
                } else {
                    writer.add_schema(name, encoding, definition).expect("added")
                };
                let channel_id =
                    writer.add_channel(schema, topic, of_message, &BTreeMap::new()).expect("added");
                let header = MessageHeader { channel_id, sequence, log_time: *time, publish_time: *time };
                writer.write_to_known_channel(&header, data).expect("written");
            }
            Part::Attachment(name, data) => {
                let (name, data, media_type) =
                    (name.clone(), data.as_slice().into(), "text/plain".to_owned());
                writer
                    .attach(&Attachment { log_time: 0, create_time: 0, name, media_type, data })
                    .expect("attached");
            }
            Part::Metadata(metadata) => writer.write_metadata(metadata).expect("written"),
        }
    }
    writer.finish().expect("finished");
    drop(writer);
    bytes.into_inner()
}

/// Mostly nothing; else bytes are changed, left out or cut off.
pub fn damage(bytes: &mut Vec<u8>, choices: &mut Choices<'_>) {
    if choices.below(4) != 3 {
        return;
    }
    for _ in 0..=choices.below(4) {
        let at = choices.below(bytes.len().max(1)).min(bytes.len().saturating_sub(1));
        match choices.below(4) {
            0 => bytes.truncate(at),
            1 if !bytes.is_empty() => bytes[at] ^= 1 << choices.below(8),
            2 if !bytes.is_empty() => bytes[at] = *choices.pick(&[0, 1, 0x7f, 0x80, 0xff]),
            _ => {
                let end = (at + choices.below(64)).min(bytes.len());
                bytes.drain(at.min(end)..end);
            }
        }
    }
}
