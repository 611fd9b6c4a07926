//! Finished rows, in files of some of them, and the table that they form.

use std::ops::Range;
use std::path::{Path, PathBuf};

use super::{About, Folder, FolderError, about_of, short, sum_of};
use crate::table::{Cell, StagedTable, Table, TableError, TableReader, TableWriter};

/// A file that holds the rows of a range.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Piece {
    pub path: PathBuf,
    pub range: Range<u64>,
}

/// The finished part of a range.
#[derive(Debug, Clone, PartialEq)]
pub struct Covered {
    pub(super) pieces: Vec<Piece>,
    range: Range<u64>,
}

impl Covered {
    /// The unfinished ranges, in order.
    pub fn missing(&self) -> Vec<Range<u64>> {
        let mut missing = Vec::new();
        let mut next = self.range.start;
        for piece in &self.pieces {
            if piece.range.start > next {
                missing.push(next..piece.range.start.min(self.range.end));
            }
            next = next.max(piece.range.end);
        }
        if next < self.range.end {
            missing.push(next..self.range.end);
        }
        missing
    }

    /// How many trials are done.
    pub fn done(&self) -> u64 {
        let missing: u64 = self.missing().iter().map(|range| range.end - range.start).sum();
        self.range.end.saturating_sub(self.range.start).saturating_sub(missing)
    }
}

impl Folder {
    /// Rows that become a part with [`Self::put_part`]. They are pushed in the order of their trials, without gaps.
    pub fn begin_part(&self) -> Result<TableWriter, FolderError> {
        self.writer(&self.parts())
    }

    /// Puts a part of the trials of `range` in its place.
    pub fn put_part(&self, range: &Range<u64>, part: TableWriter) -> Result<(), FolderError> {
        let staged = self.finish(part, range.clone())?;
        let name =
            format!("{}-{:010}-{:010}-{}.parquet", self.campaign(), range.start, range.end, short(&staged));
        Ok(staged.name(&self.parts().join(name))?)
    }

    /// The parts by their names, in the order of their ranges.
    pub(super) fn part_files(&self) -> Vec<Piece> {
        let entries = std::fs::read_dir(self.parts()).into_iter().flatten().flatten();
        let named = |path: PathBuf| {
            let name = path.file_name()?.to_str()?.strip_suffix(".parquet")?;
            let [campaign, first, end, _] = name.split('-').collect::<Vec<_>>()[..] else { return None };
            let range = first.parse().ok()?..end.parse().ok()?;
            (campaign == self.campaign() && range.start < range.end).then_some(Piece { path, range })
        };
        let mut pieces: Vec<_> = entries.filter_map(|entry| named(entry.path())).collect();
        pieces.sort_by(|a, b| {
            (a.range.start, a.range.end, &a.path).cmp(&(b.range.start, b.range.end, &b.path))
        });
        pieces
    }

    /// The finished part of `range`, by its complete parts.
    pub fn covered(&self, range: &Range<u64>) -> Covered {
        let within = |piece: &Piece| piece.range.start < range.end && piece.range.end > range.start;
        let mut pieces: Vec<Piece> = Vec::new();
        for piece in self.part_files().into_iter().filter(within) {
            // Rows that earlier parts hold already add nothing.
            let told = pieces.last().is_some_and(|last| last.range.end >= piece.range.end);
            if !told && is_whole(&piece.path) && self.is_of(&piece) {
                pieces.push(piece);
            }
        }
        Covered { pieces, range: range.clone() }
    }

    fn is_of(&self, piece: &Piece) -> bool {
        let Ok(table) = TableReader::open(&piece.path) else { return false };
        let rows = piece.range.end - piece.range.start;
        let whole = table.rows() == rows && table.columns() == self.manifest.columns;
        whole && about_of(&table) == Some(self.about(piece.range.clone()))
    }

    /// One table of the rows of a range in `folder`, from pieces in the order of their ranges.
    pub(super) fn assemble(
        &self,
        pieces: &[Piece],
        range: &Range<u64>,
        folder: &Path,
        progress: &mut dyn FnMut(u64),
    ) -> Result<StagedTable, FolderError> {
        let mut writer = self.writer(folder)?;
        let mut next = range.start;
        for piece in pieces {
            let table = TableReader::open(&piece.path)?;
            let mut place = piece.range.start;
            table.for_each_row::<FolderError>(|row| {
                if row.first() != Some(&Cell::count(place)) {
                    let reason =
                        format!("row {} does not belong to trial {place}", place - piece.range.start);
                    return Err(TableError::Parquet { path: piece.path.clone(), reason }.into());
                }
                if place == next && next < range.end {
                    writer.push(row)?;
                    next += 1;
                    progress(next - range.start);
                }
                place += 1;
                Ok(())
            })?;
        }
        if next < range.end {
            return Err(FolderError::Missing { path: self.path.clone(), range: next..range.end });
        }
        self.finish(writer, range.clone())
    }

    /// Makes a shard from its parts, and removes them.
    pub fn complete_shard(&self, shard: u32) -> Result<PathBuf, FolderError> {
        let range = self.manifest.range_of(shard);
        let covered = self.covered(&range);
        let staged = match self.assemble(&covered.pieces, &range, &self.shards(), &mut |_| {}) {
            Ok(staged) => staged,
            // Another process has completed it meanwhile, and removed its parts.
            Err(error) => {
                let found = self.sound_shard(shard).ok_or(error)?;
                self.clear_parts(&range);
                return Ok(found);
            }
        };
        let path = self.shards().join(self.shard_name(shard, short(&staged)));
        staged.name(&path)?;
        // Damaged files of this number are replaced; other files stay.
        for other in self.shard_files(shard).into_iter().filter(|other| *other != path) {
            if self.look_at(&other).is_err_and(|fault| fault.is_mended_by_computing()) {
                let _ = std::fs::remove_file(other);
            }
        }
        self.clear_parts(&range);
        Ok(path)
    }

    /// The file of a shard that is there and sound.
    pub(super) fn sound_shard(&self, shard: u32) -> Option<PathBuf> {
        self.shard_files(shard).into_iter().find(|path| self.look_at(path).is_ok())
    }

    pub(super) fn shard_name(&self, shard: u32, sum: &str) -> String {
        format!("{}-{shard:06}-of-{:06}-{sum}.parquet", self.campaign(), self.manifest.shards)
    }

    /// Files that have the name of that shard of this campaign.
    pub(super) fn shard_files(&self, shard: u32) -> Vec<PathBuf> {
        let begin = self.shard_name(shard, "");
        let begin = begin.trim_end_matches(".parquet").to_owned();
        let entries = std::fs::read_dir(self.shards()).into_iter().flatten().flatten();
        let ours = |path: &PathBuf| {
            path.file_name().and_then(|name| name.to_str()).is_some_and(|name| name.starts_with(&begin))
        };
        entries.map(|entry| entry.path()).filter(ours).collect()
    }

    /// Makes the whole table from the parts of one machine, and removes them.
    pub fn complete(&self, progress: &mut dyn FnMut(u64)) -> Result<(), FolderError> {
        let range = self.manifest.range();
        let covered = self.covered(&range);
        self.name_table(self.assemble(&covered.pieces, &range, &self.path, progress)?)
    }

    /// A table of the finished rows of the campaign up to the first gap, removed when it is dropped; `None` if nothing is finished.
    pub fn so_far(&self) -> Result<Option<StagedTable>, FolderError> {
        let range = self.manifest.range();
        let covered = self.covered(&range);
        let end = covered.missing().first().map_or(range.end, |missing| missing.start);
        if end == range.start {
            return Ok(None);
        }
        self.assemble(&covered.pieces, &(range.start..end), &self.path, &mut |_| {}).map(Some)
    }
}

/// Whether the file matches the checksum in its name.
pub(super) fn is_whole(path: &Path) -> bool {
    let told = path.file_stem().and_then(|name| name.to_str()).and_then(|name| name.rsplit('-').next());
    sum_of(path).is_ok_and(|sum| Some(sum.as_str()) == told)
}

impl About {
    pub(super) fn range(&self) -> Range<u64> {
        self.first..self.end
    }
}
