//! Looks through an MCAP file, calibrig's or another program's, sound or damaged.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use super::RecordingError;
use super::directory::Directory;
use super::framing::{ReadError, Whole, check_whole};
use super::health::{FaultyPart, Health, State};
use super::inspection::{INSPECT_SCHEMA, Inspection, Recoverable, SetReport};
use super::provenance::RECOVERED;
use super::records::{End, Trust, Walked, walk};
use super::survey::Survey;

/// Is told how many bytes are done, and of how many.
pub type Progress<'a> = dyn FnMut(u64, u64) + 'a;

/// Looks through the file at `path`. `progress` is told how far it has come.
///
/// # Errors
/// The file cannot be read, or is not an MCAP file.
pub fn inspect(path: &Path, progress: &mut Progress<'_>) -> Result<Inspection, RecordingError> {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned());
    let opened = Watched::open(path, PASSES, progress).map_err(ReadError::Io);
    let inspection = opened.and_then(|mut file| inspect_file(&mut file, name.unwrap_or_default()));
    inspection.map_err(|error| error.of(path))
}

/// How often [`inspect_file`] reads the file.
pub(super) const PASSES: u64 = 2;

pub(super) fn inspect_file(file: &mut (impl Read + Seek), name: String) -> Result<Inspection, ReadError> {
    let bytes = file.seek(SeekFrom::End(0))?;
    let whole = check_whole(file)?;
    let directory = Directory::of(file)?;
    let mut survey = Survey::new(&directory);
    let trust = if whole.is_sound() { Trust::Data } else { Trust::Little };
    let walked = walk(file, &directory, trust, &mut |at, record| {
        survey.record(at, record);
        Ok(())
    })?;
    let (provenance, altered_at) = survey.provenance();
    let health = judged(walked, &whole, altered_at);
    let messages = survey.messages();
    let total: Option<u64> = directory.counts.as_ref().map(|counts| counts.values().sum());
    let sets = survey.sets();
    let incomplete = |set: &SetReport| set.expected.is_some_and(|n| set.observations < u64::from(n));
    let recoverable = Recoverable {
        messages,
        messages_lost: total.map(|total| total.saturating_sub(messages)),
        anything_lost: health.state != State::Whole
            && (!health.lost.is_empty()
                || altered_at.is_some()
                || survey.nameless > 0
                || sets.iter().any(incomplete)),
    };
    Ok(Inspection {
        schema: INSPECT_SCHEMA,
        file: name,
        bytes,
        calibrig: survey.is_ours(),
        recovered: survey.metadata_names.iter().any(|name| name == RECOVERED),
        topics: survey.topics(&directory),
        library: survey.library,
        profile: survey.profile,
        trust,
        health,
        recoverable,
        provenance,
        sets,
        estimates: survey.estimates,
        attachments: survey.attachments,
        metadata: survey.metadata_names,
    })
}

/// The health of a file as a walk and the checksums over its sections say; metadata that do not fit their hash are at `altered_at`.
fn judged(walked: Walked, whole: &Whole, altered_at: Option<u64>) -> Health {
    let Walked { health: found, end, .. } = walked;
    // A file whose checksums fit may hold records of kinds that are unknown here.
    let harmless = |part: &FaultyPart| matches!(part, FaultyPart::Record | FaultyPart::OpaqueChunk);
    let tail = usize::from(matches!(end, End::Begun | End::Within));
    let faults: u64 = found.lost.values().sum();
    let state = if whole.trouble.is_none() && found.lost.keys().all(harmless) && altered_at.is_none() {
        State::Whole
    } else if altered_at.is_some() || faults > tail as u64 {
        State::Damaged
    } else {
        match end {
            End::Begun | End::Record => State::Unfinished,
            End::Within => State::Truncated,
            End::Data if matches!(whole.trouble, Some(RecordingError::Truncated)) => State::Truncated,
            End::Data | End::Lost => State::Damaged,
        }
    };
    let first = found.faults.first().map(|fault| fault.offset).into_iter().chain(altered_at).min();
    Health {
        state,
        damaged_at: first.filter(|_| state == State::Damaged),
        checksum_of_data: whole.data,
        checksum_of_summary: whole.summary,
        ..found
    }
}

/// A file that reports how much of it was read.
pub(super) struct Watched<'a> {
    file: File,
    done: u64,
    total: u64,
    progress: &'a mut Progress<'a>,
}

impl<'a> Watched<'a> {
    /// Opens a file that will be read `passes` times.
    pub(super) fn open(
        path: &Path,
        passes: u64,
        progress: &'a mut Progress<'a>,
    ) -> std::io::Result<BufReader<Self>> {
        let file = File::open(path)?;
        let metadata = file.metadata()?;
        if metadata.is_dir() {
            // A folder can be opened, but its length means nothing.
            return Err(std::io::ErrorKind::IsADirectory.into());
        }
        let total = metadata.len().saturating_mul(passes);
        Ok(BufReader::with_capacity(1 << 16, Self { file, done: 0, total, progress }))
    }
}

impl Read for Watched<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let read = self.file.read(buffer)?;
        self.done += read as u64;
        (self.progress)(self.done.min(self.total), self.total);
        Ok(read)
    }
}

impl Seek for Watched<'_> {
    fn seek(&mut self, position: SeekFrom) -> std::io::Result<u64> {
        self.file.seek(position)
    }
}
