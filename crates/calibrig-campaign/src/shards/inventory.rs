//! Which shards are there, and what is wrong with others.

use std::collections::BTreeMap;
use std::path::PathBuf;

use thiserror::Error;

use super::pieces::{Piece, is_whole};
use super::{Folder, FolderError, about_of};
use crate::table::{Table, TableReader};

/// A file among the shards that must not be merged.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum Fault {
    /// Its name is not that of a shard of this campaign.
    #[error("{}: its name is not that of a shard of this campaign", file.display())]
    Name {
        /// Which.
        file: PathBuf,
    },
    /// Its bytes do not match the checksum in its name.
    #[error("{}: cut short or altered: its bytes do not match the checksum in its name", file.display())]
    Damaged {
        /// Which.
        file: PathBuf,
    },
    /// It cannot be read.
    #[error("{}: {reason}", file.display())]
    Unreadable {
        /// Which.
        file: PathBuf,
        /// Why.
        reason: String,
    },
    /// It is of another campaign.
    #[error("{}: of another campaign: {difference}", file.display())]
    Foreign {
        /// Which.
        file: PathBuf,
        /// The difference.
        difference: String,
    },
    /// Two sound files of one shard have different rows.
    #[error(
        "{} and {}: both are sound, but they differ: their processors round differently. Keep the shards of one kind of \
         machine and run the others again on it",
        file.display(),
        other.display()
    )]
    Contradiction {
        /// One.
        file: PathBuf,
        /// The other.
        other: PathBuf,
    },
    /// It is of this campaign, but divided differently: its trials are in other shards, too.
    #[error("{}: its trials {first}..{end} overlap the shards of this campaign, which has {shards}", file.display())]
    Overlap {
        /// Which.
        file: PathBuf,
        /// Its first trial.
        first: u64,
        /// One past its last trial.
        end: u64,
        /// Into how many shards the campaign is divided.
        shards: u32,
    },
}

impl Fault {
    /// Whether running the shard again repairs it.
    pub fn is_mended_by_computing(&self) -> bool {
        matches!(self, Self::Damaged { .. } | Self::Unreadable { .. })
    }
}

/// The shards of a folder.
#[derive(Debug, Clone, PartialEq)]
pub struct Inventory {
    pub(super) sound: BTreeMap<u32, Piece>,
    /// What is wrong, by name.
    pub faults: Vec<Fault>,
    /// Numbers of the shards that are missing or damaged.
    pub missing: Vec<u32>,
}

impl Inventory {
    /// Sound shards.
    pub fn sound(&self) -> usize {
        self.sound.len()
    }

    /// The missing ones, in the form that schedulers take as array numbers: `0-2,5`.
    pub fn array(&self) -> String {
        let mut runs: Vec<(u32, u32)> = Vec::new();
        for &shard in &self.missing {
            match runs.last_mut() {
                Some((_, last)) if last.checked_add(1) == Some(shard) => *last = shard,
                _ => runs.push((shard, shard)),
            }
        }
        let words = |(first, last): &(u32, u32)| {
            if first == last { first.to_string() } else { format!("{first}-{last}") }
        };
        runs.iter().map(words).collect::<Vec<_>>().join(",")
    }
}

impl Folder {
    /// Checks every file among the shards. `progress` receives their number.
    pub fn inventory(&self, progress: &mut dyn FnMut(u64)) -> Inventory {
        let mut sound = BTreeMap::new();
        let mut faults = Vec::new();
        let entries = std::fs::read_dir(self.shards()).into_iter().flatten().flatten();
        let mut files: Vec<PathBuf> =
            entries.map(|entry| entry.path()).filter(|path| is_shard(path)).collect();
        files.sort();
        for (count, file) in (1..).zip(files) {
            match self.look_at(&file) {
                Ok((shard, piece)) => {
                    if let Some(other) = sound.insert(shard, piece) {
                        // The same bytes have the same name.
                        faults.push(Fault::Contradiction { file, other: other.path });
                    }
                }
                Err(fault) => faults.push(fault),
            }
            progress(count);
        }
        let missing = (0..self.manifest.shards).filter(|shard| !sound.contains_key(shard)).collect();
        Inventory { sound, faults, missing }
    }

    /// Whether a shard is there and sound.
    pub fn has_shard(&self, shard: u32) -> Result<bool, FolderError> {
        let shards = self.manifest.shards;
        if shard >= shards {
            return Err(FolderError::NoShard { shard, shards });
        }
        Ok(self.sound_shard(shard).is_some())
    }

    pub(super) fn look_at(&self, file: &std::path::Path) -> Result<(u32, Piece), Fault> {
        let file = file.to_path_buf();
        if !file.is_file() || file.extension().is_none_or(|extension| extension != "parquet") {
            return Err(Fault::Name { file });
        }
        let name = file.file_stem().and_then(|name| name.to_str()).unwrap_or_default();
        let [campaign, shard, "of", shards, _] = name.split('-').collect::<Vec<_>>()[..] else {
            return Err(Fault::Name { file });
        };
        let (Ok(shard), Ok(shards)) = (shard.parse::<u32>(), shards.parse::<u32>()) else {
            return Err(Fault::Name { file });
        };
        // A shard of another campaign or division cannot be repaired by running it, whether damaged or not.
        let is_ours = campaign == self.campaign() && shards == self.manifest.shards && shard < shards;
        if !is_whole(&file) {
            return Err(if is_ours { Fault::Damaged { file } } else { Fault::Name { file } });
        }
        let table = match TableReader::open(&file) {
            Ok(table) => table,
            Err(error) => return Err(Fault::Unreadable { file, reason: error.to_string() }),
        };
        let Some(about) = about_of(&table) else {
            return Err(Fault::Unreadable {
                file,
                reason: "it does not say which campaign it belongs to".to_owned(),
            });
        };
        let own = self.about(about.range());
        if about != own {
            let difference = match () {
                () if about.name != own.name => format!("{:?} instead of {:?}", about.name, own.name),
                () if about.version != own.version => {
                    format!("version {} instead of {}", about.version, own.version)
                }
                () if about.seed != own.seed => format!("seed {} instead of {}", about.seed, own.seed),
                () => "its scenario, its trials or the program that wrote it differ".to_owned(),
            };
            return Err(Fault::Foreign { file, difference });
        }
        let whole =
            table.rows() == about.end.saturating_sub(about.first) && table.columns() == self.manifest.columns;
        if !whole {
            return Err(Fault::Unreadable {
                file,
                reason: "it does not hold the rows that its header states".to_owned(),
            });
        }
        if shards != self.manifest.shards || about.range() != self.manifest.range_of(shard) {
            let (first, end, shards) = (about.first, about.end, self.manifest.shards);
            return Err(Fault::Overlap { file, first, end, shards });
        }
        Ok((shard, Piece { path: file, range: about.range() }))
    }

    /// Makes the whole table from sound shards, which must be complete: the same bytes as from one machine. `progress` receives the number of rows.
    pub fn merge(&self, inventory: &Inventory, progress: &mut dyn FnMut(u64)) -> Result<(), FolderError> {
        if let Some(shard) = inventory.missing.first() {
            let range = self.manifest.range_of(*shard);
            return Err(FolderError::Missing { path: self.path.clone(), range });
        }
        let pieces: Vec<Piece> = inventory.sound.values().cloned().collect();
        let staged = self.assemble(&pieces, &self.manifest.range(), &self.path, progress)?;
        self.name_table(staged)
    }
}

/// Not a file that is still being written, nor one next to the shards.
fn is_shard(path: &std::path::Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let is_table = path.extension().is_some_and(|extension| extension == "parquet");
    !name.starts_with(crate::table::TEMPORARY) && (is_table || !name.ends_with(".timings.csv"))
}
