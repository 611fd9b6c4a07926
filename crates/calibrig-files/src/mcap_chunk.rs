//! Chunks of messages of an MCAP file: decompressed within a limit, and checked against their checksum if they have one.

use std::borrow::Cow;
use std::io::Read;

use lz4_flex::frame::FrameDecoder;
use mcap::McapError;
use mcap::records::{ChunkHeader, Record, op};

/// Length of the opcode and the length in front of a record.
pub const HEAD: usize = 9;

/// The records in a chunk.
#[derive(Debug)]
pub struct Opened<'a> {
    data: Cow<'a, [u8]>,
    /// Whether it has a checksum, which then matches.
    pub protected: bool,
}

/// Opens a chunk record with the given body, whichever program wrote it, if it holds at most `limit` bytes.
///
/// # Errors
/// Errors if lengths, compression or checksum do not match, or the compression is not one of MCAP's specification.
pub fn open(body: &[u8], limit: usize) -> Result<Opened<'_>, McapError> {
    let (header, data) = parse(body)?;
    let size = usize::try_from(header.uncompressed_size).ok().filter(|size| *size <= limit);
    let size = size.ok_or(McapError::ChunkTooLarge(header.uncompressed_size))?;
    let data = match header.compression.as_str() {
        "" => data,
        "zstd" => Cow::Owned(unpacked(zstd::stream::read::Decoder::with_buffer(data.as_ref())?, size)?),
        "lz4" => Cow::Owned(unpacked(Frames::new(data.as_ref()), size)?),
        _ => return Err(McapError::UnsupportedCompression(header.compression)),
    };
    if data.len() != size || !is_tiled(&data) {
        return Err(McapError::UnexpectedEoc);
    }
    let (saved, calculated) = (header.uncompressed_crc, crc32fast::hash(&data));
    if saved != 0 && saved != calculated {
        return Err(McapError::BadChunkCrc { saved, calculated });
    }
    Ok(Opened { data, protected: saved != 0 })
}

/// Header and content of a chunk record.
fn parse(body: &[u8]) -> Result<(ChunkHeader, Cow<'_, [u8]>), McapError> {
    match mcap::parse_record(op::CHUNK, body)? {
        Record::Chunk { header, data } => Ok((header, data)),
        _ => Err(McapError::UnexpectedEoc),
    }
}

/// Up to one byte more than `size`, so that a surplus is noticed.
fn unpacked(decoder: impl Read, size: usize) -> Result<Vec<u8>, McapError> {
    let mut data = Vec::new();
    let read = decoder.take(size as u64 + 1).read_to_end(&mut data);
    read.map_err(|error| McapError::DecompressionError(error.to_string()))?;
    Ok(data)
}

/// LZ4 frames one after the other, as several of Zstandard are read.
struct Frames<'a> {
    decoder: FrameDecoder<&'a [u8]>,
}

impl<'a> Frames<'a> {
    fn new(data: &'a [u8]) -> Self {
        Self { decoder: FrameDecoder::new(data) }
    }
}

impl Read for Frames<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        loop {
            let before = self.decoder.get_ref().len();
            let read = self.decoder.read(buffer)?;
            // At the end of a frame the decoder reports the end; if there is more, it continues.
            if read > 0 || self.decoder.get_ref().len() == before || before == 0 {
                return Ok(read);
            }
        }
    }
}

impl Opened<'_> {
    /// Opcode and body of every record that may stand in a chunk.
    pub fn records(&self) -> impl Iterator<Item = (u8, &[u8])> {
        let wanted = |opcode: u8| matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE);
        Records(&self.data).filter(move |(opcode, _)| wanted(*opcode))
    }
}

/// Records from end to end.
struct Records<'a>(&'a [u8]);

impl<'a> Iterator for Records<'a> {
    type Item = (u8, &'a [u8]);

    fn next(&mut self) -> Option<Self::Item> {
        let opcode = *self.0.first()?;
        let length = u64::from_le_bytes(self.0.get(1..HEAD)?.try_into().ok()?);
        let end = usize::try_from(length).ok()?.checked_add(HEAD)?;
        let body = self.0.get(HEAD..end)?;
        self.0 = &self.0[end..];
        Some((opcode, body))
    }
}

/// Whether `data` is records from end to end.
fn is_tiled(data: &[u8]) -> bool {
    let mut records = Records(data);
    records.by_ref().for_each(drop);
    records.0.is_empty()
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_model::random::{StreamSource, stream};
    use lz4_flex::frame::{BlockMode, BlockSize, FrameEncoder, FrameInfo};
    use rand::RngExt;
    use std::io::Write;

    const LIMIT: usize = 1 << 26;

    fn message(length: usize) -> Vec<u8> {
        let body = [&7_u16.to_le_bytes()[..], &[0; 20], &vec![3; length]].concat();
        [&[op::MESSAGE][..], &(body.len() as u64).to_le_bytes(), &body].concat()
    }

    fn chunk(compression: &str, data: &[u8], size: usize, crc: u32) -> Vec<u8> {
        let mut body = vec![0; 16];
        body.extend((size as u64).to_le_bytes());
        body.extend(crc.to_le_bytes());
        body.extend(u32::try_from(compression.len()).expect("short").to_le_bytes());
        body.extend(compression.as_bytes());
        body.extend((data.len() as u64).to_le_bytes());
        body.extend(data);
        body
    }

    fn lz4(data: &[u8], mode: BlockMode) -> Vec<u8> {
        let info = FrameInfo::new().block_mode(mode).block_size(BlockSize::Max64KB).content_checksum(true);
        let mut encoder = FrameEncoder::with_frame_info(info, Vec::new());
        encoder.write_all(data).expect("written");
        encoder.finish().expect("finished")
    }

    fn bodies(chunk: &[u8]) -> Vec<usize> {
        open(chunk, LIMIT).expect("sound").records().map(|(_, body)| body.len()).collect()
    }

    #[test]
    fn every_compression_of_the_specification_is_opened_with_and_without_a_checksum() {
        let data = [message(10), message(0), message(70_000), message(120_000)].concat();
        let zstd = zstd::stream::encode_all(data.as_slice(), 3).expect("compressed");
        let (first, second) = data.split_at(50_000);
        let frames = [lz4(first, BlockMode::Linked), lz4(second, BlockMode::Independent)].concat();
        for (compression, content) in [
            ("", &data),
            ("zstd", &zstd),
            ("lz4", &lz4(&data, BlockMode::Linked)),
            ("lz4", &lz4(&data, BlockMode::Independent)),
            ("lz4", &frames),
        ] {
            for crc in [0, crc32fast::hash(&data)] {
                let chunk = chunk(compression, content, data.len(), crc);
                assert_eq!(bodies(&chunk), [32, 22, 70_022, 120_022], "{compression} {crc}");
                assert_eq!(open(&chunk, LIMIT).expect("sound").protected, crc != 0);
            }
            for (size, crc) in [(data.len(), 1), (data.len() - 1, 0), (data.len() + 1, 0), (1 << 40, 0)] {
                assert!(
                    open(&chunk(compression, content, size, crc), LIMIT).is_err(),
                    "{compression} {size} {crc}"
                );
            }
        }
        let other = chunk("brotli", &data, data.len(), 0);
        assert!(
            matches!(open(&other, LIMIT), Err(McapError::UnsupportedCompression(name)) if name == "brotli")
        );
    }

    #[test]
    fn no_damage_panics_or_asks_for_more_memory_than_there_is() {
        let data = [message(10), message(300), message(70_000)].concat();
        let zstd = zstd::stream::encode_all(data.as_slice(), 3).expect("compressed");
        let mut rng = stream(9, 0, StreamSource::Splits);
        let contents = [
            ("", data.clone()),
            ("zstd", zstd),
            ("lz4", lz4(&data, BlockMode::Linked)),
            ("lz4", lz4(&data, BlockMode::Independent)),
        ];
        for (compression, content) in contents {
            let sound = chunk(compression, &content, data.len(), 0);
            for _ in 0..2000 {
                let mut damaged = sound.clone();
                for _ in 0..rng.random_range(1..4) {
                    // Where the structure is, more often than in what it holds.
                    let end = if rng.random() { damaged.len() } else { damaged.len().min(200) };
                    let bit = rng.random_range(0..8 * end);
                    damaged[bit / 8] ^= 1 << (bit % 8);
                }
                damaged.truncate(rng.random_range(0..2 * damaged.len()));
                if let Ok(opened) = open(&damaged, LIMIT) {
                    assert!(opened.records().count() <= data.len());
                }
            }
        }
    }
}
