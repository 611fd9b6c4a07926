//! Copies of the shipped recording as other programs write MCAP: compressed otherwise or not at all, without checksums, without chunks.

use std::io::Write;
use std::path::Path;

use mcap::records::op;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader};

use crate::sandbox::Sandbox;

/// How a copy is written.
#[derive(Debug, Clone, Copy)]
struct Style {
    /// `None` without chunks.
    compression: Option<&'static str>,
    checksums: bool,
    summary: bool,
}

const LZ4: Style = Style { compression: Some("lz4"), checksums: true, summary: true };

/// A writer of bytes, which shares nothing with the one of the library.
struct Copy {
    style: Style,
    bytes: Vec<u8>,
    chunk: Vec<u8>,
    /// Schemas and channels, which the summary repeats.
    definitions: Vec<u8>,
}

fn record(opcode: u8, body: &[u8]) -> Vec<u8> {
    [&[opcode][..], &(body.len() as u64).to_le_bytes(), body].concat()
}

fn text(text: &str) -> Vec<u8> {
    [&u32::try_from(text.len()).expect("short").to_le_bytes()[..], text.as_bytes()].concat()
}

/// CRC-32 of ISO 3309, bit by bit.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| (crc >> 1) ^ (0xedb8_8320 & (crc & 1).wrapping_neg()))
    })
}

impl Copy {
    fn of(original: &[u8], style: Style) -> Vec<u8> {
        let mut copy =
            Self { style, bytes: mcap::MAGIC.to_vec(), chunk: Vec::new(), definitions: Vec::new() };
        let header = [text(""), text("another writer")].concat();
        copy.bytes.extend(record(op::HEADER, &header));
        let mut reader = LinearReader::new();
        let mut rest = original;
        while let Some(event) = reader.next_event() {
            match event.expect("the shipped recording is sound") {
                LinearReadEvent::ReadRequest(wanted) => {
                    let (now, later) = rest.split_at(wanted.min(rest.len()));
                    reader.insert(now.len()).copy_from_slice(now);
                    reader.notify_read(now.len());
                    rest = later;
                }
                LinearReadEvent::Record { opcode: op::DATA_END, .. } => break,
                LinearReadEvent::Record { opcode, data } => copy.record(opcode, data),
            }
        }
        copy.finish()
    }

    fn record(&mut self, opcode: u8, body: &[u8]) {
        let whole = record(opcode, body);
        match opcode {
            op::SCHEMA | op::CHANNEL | op::MESSAGE => {
                if opcode != op::MESSAGE {
                    self.definitions.extend(&whole);
                }
                match self.style.compression {
                    Some(_) => self.chunk.extend(whole),
                    None => self.bytes.extend(whole),
                }
                if self.chunk.len() > 100_000 {
                    self.close_chunk();
                }
            }
            op::METADATA => self.bytes.extend(whole),
            op::ATTACHMENT => {
                let mut body = body.to_vec();
                if !self.style.checksums {
                    let end = body.len() - 4;
                    body[end..].fill(0);
                }
                self.bytes.extend(record(op::ATTACHMENT, &body));
            }
            _ => {}
        }
    }

    fn close_chunk(&mut self) {
        let records = std::mem::take(&mut self.chunk);
        let Some(compression) = self.style.compression.filter(|_| !records.is_empty()) else { return };
        let data = match compression {
            "lz4" => {
                let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
                encoder.write_all(&records).expect("in memory");
                encoder.finish().expect("in memory")
            }
            _ => records.clone(),
        };
        let crc = if self.style.checksums { crc32(&records) } else { 0 };
        let mut body = vec![0; 16];
        body.extend((records.len() as u64).to_le_bytes());
        body.extend(crc.to_le_bytes());
        body.extend(text(compression));
        body.extend((data.len() as u64).to_le_bytes());
        body.extend(data);
        self.bytes.extend(record(op::CHUNK, &body));
    }

    fn finish(mut self) -> Vec<u8> {
        self.close_chunk();
        let crc = if self.style.checksums { crc32(&self.bytes) } else { 0 };
        self.bytes.extend(record(op::DATA_END, &crc.to_le_bytes()));
        let mut summary = if self.style.summary { self.definitions.clone() } else { Vec::new() };
        let start = if summary.is_empty() { 0 } else { self.bytes.len() as u64 };
        let footer = [start.to_le_bytes(), [0; 8]].concat();
        summary.push(op::FOOTER);
        summary.extend(20_u64.to_le_bytes());
        summary.extend(footer);
        let crc = if self.style.checksums { crc32(&summary) } else { 0 };
        self.bytes.extend(summary);
        self.bytes.extend(crc.to_le_bytes());
        self.bytes.extend(mcap::MAGIC);
        self.bytes
    }
}

fn shipped() -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/paper.mcap");
    std::fs::read(path).expect("the shipped recording")
}

/// A file of ours is read whoever wrote it again: the same sets, the same estimates to the bit; what has no checksum is told.
#[test]
fn it_is_read_as_the_original_and_what_has_no_checksum_is_told() {
    let sandbox = Sandbox::new();
    let original = shipped();
    sandbox.write("original.mcap", &original);
    let reference = sandbox.run(["inspect", "original.mcap", "--json"]).json();
    let bare = Style { checksums: false, ..LZ4 };
    for (index, (style, health)) in [
        (LZ4, "whole: every part is there, and every checksum matches"),
        (bare, "without a checksum changes would go unnoticed"),
        (Style { compression: Some(""), ..LZ4 }, "whole: every part is there, and every checksum matches"),
        (
            Style { compression: Some(""), summary: false, ..bare },
            "without a checksum changes would go unnoticed",
        ),
        (Style { compression: None, ..LZ4 }, "whole: every part is there, and every checksum matches"),
        (Style { compression: None, ..bare }, "without a checksum changes would go unnoticed"),
        (Style { summary: false, ..LZ4 }, "whole: every part is there, and every checksum matches"),
    ]
    .into_iter()
    .enumerate()
    {
        let copy = Copy::of(&original, style);
        sandbox.write("copy.mcap", &copy);
        let inspected = sandbox.run(["inspect", "copy.mcap", "--json"]);
        assert_eq!(inspected.code, Some(0), "{style:?}: {inspected:?}");
        let json = inspected.json();
        for key in ["calibrig", "sets", "estimates", "provenance", "recoverable", "attachments"] {
            if key == "attachments" && !style.checksums {
                continue;
            }
            if key == "recoverable" && !style.summary {
                continue;
            }
            assert_eq!(json[key]["messages"], reference[key]["messages"], "{style:?} {key}");
            assert!(key == "recoverable" || json[key] == reference[key], "{style:?} {key}");
        }
        let inspected = sandbox.run(["inspect", "copy.mcap"]);
        assert!(inspected.stdout.contains(health), "{style:?}: {}", inspected.stdout);
        assert_eq!(inspected.stdout.contains("every checksum matches"), style.checksums, "{style:?}");

        let recovered = sandbox.run(["recover", "copy.mcap", "good.mcap", "--force"]);
        assert_eq!(recovered.code, Some(0), "{style:?}: {recovered:?}");
        for told in [health, "next: calibrig replay good.mcap"] {
            assert!(recovered.stdout.contains(told), "{style:?}: {told}: {}", recovered.stdout);
        }
        assert_eq!(std::fs::read(sandbox.path("good.mcap")).expect("copied"), copy);
        // Once with and once without checksums: it takes a second.
        if index < 2 || std::env::var_os("CALIBRIG_FULL").is_some() {
            let whole = sandbox.run(["replay", "original.mcap"]);
            let replayed = sandbox.run(["replay", "good.mcap"]);
            assert_eq!((replayed.code, &replayed.stdout), (whole.code, &whole.stdout), "{style:?}");
            let told = replayed.stderr.contains("have no checksum");
            assert_eq!(told, !style.checksums, "{style:?}: {}", replayed.stderr);
        }
    }
}

/// What breaks off is saved, too, chunk by chunk or message by message.
#[test]
fn it_breaks_off_and_is_saved() {
    let sandbox = Sandbox::new();
    let original = shipped();
    for style in [LZ4, Style { checksums: false, ..LZ4 }, Style { compression: None, ..LZ4 }] {
        let copy = Copy::of(&original, style);
        sandbox.write("copy.mcap", &copy[..copy.len() * 8 / 10]);
        let recovered = sandbox.run(["recover", "copy.mcap", "good.mcap", "--force"]);
        assert_eq!(recovered.code, Some(3), "{style:?}: {recovered:?}");
        for told in ["messages saved to good.mcap", "next: calibrig replay good.mcap"] {
            assert!(recovered.stdout.contains(told), "{style:?}: {told}: {}", recovered.stdout);
        }
        let told = recovered.stdout.contains("have no checksum");
        assert_eq!(told, !style.checksums || style.compression.is_none(), "{style:?}: {}", recovered.stdout);
        let inspected = sandbox.run(["inspect", "good.mcap", "--json"]).json();
        assert_eq!(inspected["health"]["state"], "whole");
        assert!(inspected["sets"][0]["observations"].as_u64().is_some_and(|n| n > 10), "{inspected}");
    }
}

/// A compression that the specification does not name is told with what to do, and nothing is advised that cannot work.
#[test]
fn its_compression_is_not_known() {
    let sandbox = Sandbox::new();
    let unknown = Copy::of(&shipped(), Style { compression: Some("snappy"), ..LZ4 });
    sandbox.write("copy.mcap", &unknown);
    let inspected = sandbox.run(["inspect", "copy.mcap"]);
    for told in ["its compression \"snappy\" is not read", "chunks of another compression were not"] {
        assert!(inspected.stdout.contains(told), "{told}: {}", inspected.stdout);
    }
    let recovered = sandbox.run(["recover", "copy.mcap", "good.mcap"]);
    for told in ["copied to good.mcap", "write it again with zstd, lz4"] {
        assert!(recovered.stdout.contains(told), "{told}: {}", recovered.stdout);
    }
    assert!(!recovered.stdout.contains("next: "), "{}", recovered.stdout);
    let replayed = sandbox.run(["replay", "copy.mcap"]);
    assert_eq!((replayed.code, replayed.stdout.as_str()), (Some(1), ""));
    for told in ["compressed with \"snappy\", which is not read", "write the file again with one of them"] {
        assert!(replayed.stderr.contains(told), "{told}: {}", replayed.stderr);
    }
    sandbox.write("copy.mcap", &unknown[..unknown.len() - 20]);
    let recovered = sandbox.run(["recover", "copy.mcap", "other.mcap"]);
    assert_eq!(recovered.code, Some(1), "{recovered:?}");
    assert!(recovered.stderr.contains("\"snappy\" is not read"), "{}", recovered.stderr);
}
