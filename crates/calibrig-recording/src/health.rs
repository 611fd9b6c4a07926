//! How sound an MCAP file is, and what of it cannot be used.

use std::collections::BTreeMap;

use serde::Serialize;

/// Faults beyond this number are counted, not described.
const FAULTS_TOLD: usize = 100;

/// How sound a file is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Health {
    /// In a word.
    pub state: State,
    /// The first damaged place, bytes from the start; `None` where no place is damaged, or where only a checksum over everything shows damage.
    pub damaged_at: Option<u64>,
    /// The first hundred parts that cannot be used.
    pub faults: Vec<Fault>,
    /// Number of all of them, by kind.
    pub lost: BTreeMap<FaultyPart, u64>,
    /// Bytes that belong to no whole record.
    pub bytes_unread: u64,
    /// Chunks, sound or not.
    pub chunks: u64,
    /// Whether one checksum covers the whole data section; `None` where the file ends before the place of that checksum.
    pub checksum_of_data: Option<bool>,
    /// The same for the summary.
    pub checksum_of_summary: Option<bool>,
    /// Messages and attachments without a checksum of their own.
    pub without_checksum: u64,
    /// Chunks and attachments with a checksum of their own that fits.
    pub checksums: u64,
}

/// Health in a word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Every part is there, and every checksum in the file fits.
    Whole,
    /// The program that wrote the file stopped before it had finished.
    Unfinished,
    /// The file breaks off.
    Truncated,
    /// Something in the file has changed since it was written.
    Damaged,
}

/// A part of a file that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Fault {
    /// Where it begins, bytes from the start of the file.
    pub offset: u64,
    /// Its length in the file, bytes.
    pub bytes: u64,
    /// What it is, or should be.
    pub part: FaultyPart,
    /// What is wrong with it.
    pub reason: String,
}

/// What a part of a file that cannot be used is, or should be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum FaultyPart {
    /// A chunk of messages.
    Chunk,
    /// A chunk of messages in a compression that is not read: neither zstd nor lz4.
    OpaqueChunk,
    /// An attached file.
    Attachment,
    /// A metadata record.
    Metadata,
    /// A record that does not belong where it is.
    Record,
    /// Bytes in which no record can be made out.
    Framing,
}

impl FaultyPart {
    /// Name for people.
    pub fn title(self) -> &'static str {
        match self {
            Self::Chunk => "a chunk of messages",
            Self::OpaqueChunk => "a chunk of messages in a compression that is not read",
            Self::Attachment => "an attachment",
            Self::Metadata => "a metadata record",
            Self::Record => "a record",
            Self::Framing => "a part of unknown kind",
        }
    }
}

impl Health {
    /// Of a file in which nothing has been found yet.
    pub(super) fn new() -> Self {
        Self {
            state: State::Whole,
            damaged_at: None,
            faults: Vec::new(),
            lost: BTreeMap::new(),
            bytes_unread: 0,
            chunks: 0,
            checksum_of_data: None,
            checksum_of_summary: None,
            without_checksum: 0,
            checksums: 0,
        }
    }

    /// Whether a flipped bit in a message or an attached file could go unnoticed.
    pub fn holds_unprotected(&self) -> bool {
        self.without_checksum > 0 && self.checksum_of_data != Some(true)
    }

    pub(super) fn add(&mut self, fault: Fault) {
        *self.lost.entry(fault.part).or_default() += 1;
        if self.faults.len() < FAULTS_TOLD {
            self.faults.push(fault);
        }
    }
}
