//! A campaign in a folder: its manifest, the shards that machines made, and the one table that they form.
//!
//! ```text
//! manifest.json                                 what fixes the campaign
//! parts/<campaign>-<first>-<end>-<sum>.parquet  rows of a shard that is not complete
//! shards/<campaign>-<I>-of-<M>-<sum>.parquet    a complete shard
//! trials.parquet                                all rows
//! ```
//!
//! `<campaign>` is the beginning of the manifest's checksum, `<sum>` that of the file's own: a file that was cut short or altered no longer matches
//! its name. A file gets its name when it is complete and on the disk. Any machine computes the same row, so that nothing is lost or counted twice
//! when a machine that was given up finishes late.

mod inventory;
mod manifest;
mod pieces;

pub use inventory::{Fault, Inventory};
pub use manifest::{Input, Manifest, Software};
pub use pieces::Covered;

use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use thiserror::Error;

use crate::table::{
    StagedTable, TEMPORARY, TableError, TableReader, TableWriter, hexadecimal, sync_folder_of,
};

/// More parts than any scheduler takes.
pub const MOST_SHARDS: u32 = 1_000_000;
/// Digits of a checksum in a file's name.
const SUM_DIGITS: usize = 16;
const CAMPAIGN_DIGITS: usize = 12;
/// Key under which a table states its campaign.
const ABOUT: &str = "calibrig.campaign";

/// Errors of a campaign's folder.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum FolderError {
    /// Of the file system or of a table.
    #[error(transparent)]
    Table(#[from] TableError),
    /// There is no campaign.
    #[error("{}: no campaign here (no manifest.json)", path.display())]
    NoCampaign {
        /// The folder.
        path: PathBuf,
    },
    /// The manifest is invalid.
    #[error("{}: {reason}", path.display())]
    Manifest {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// There is another campaign.
    #[error("{}: this folder holds another campaign: it has {difference}", path.display())]
    AnotherCampaign {
        /// The folder.
        path: PathBuf,
        /// The difference of the existing one.
        difference: String,
    },
    /// A shard that the campaign does not have.
    #[error("shard {shard} of {shards}: the last shard is {}", shards.saturating_sub(1))]
    NoShard {
        /// The number asked for.
        shard: u32,
        /// The number of shards.
        shards: u32,
    },
    /// Missing rows.
    #[error("{}: trials {}..{} are missing", path.display(), range.start, range.end)]
    Missing {
        /// The folder.
        path: PathBuf,
        /// The first ones that are missing.
        range: Range<u64>,
    },
}

/// What a table states about its campaign.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct About {
    /// Sum of the manifest.
    campaign: String,
    name: String,
    version: String,
    seed: u64,
    first: u64,
    end: u64,
}

/// The folder of a campaign.
#[derive(Debug, Clone)]
pub struct Folder {
    path: PathBuf,
    manifest: Manifest,
    sum: String,
}

impl Folder {
    /// The folder with this campaign: created if missing, joined if another process or an earlier run created it.
    pub fn begin(path: &Path, manifest: &Manifest) -> Result<Self, FolderError> {
        fs::create_dir_all(path).map_err(TableError::io(path))?;
        let file = path.join("manifest.json");
        if !file.exists() {
            put_manifest(&file, manifest)?;
        }
        // If several processes created it at once, one succeeded.
        let there = read_manifest(path)?;
        match manifest.difference(&there) {
            None => Ok(Self::of(path, there)),
            Some(difference) => Err(FolderError::AnotherCampaign { path: path.to_path_buf(), difference }),
        }
    }

    /// The folder with the campaign that is in it.
    pub fn open(path: &Path) -> Result<Self, FolderError> {
        Ok(Self::of(path, read_manifest(path)?))
    }

    fn of(path: &Path, manifest: Manifest) -> Self {
        let sum = manifest.sum();
        Self { path: path.to_path_buf(), manifest, sum }
    }

    /// Where.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Whether a campaign is in the folder.
    pub fn is_begun(path: &Path) -> bool {
        path.join("manifest.json").exists()
    }

    /// The whole table.
    pub fn table(&self) -> PathBuf {
        self.path.join("trials.parquet")
    }

    /// File with the checksum of the whole table, as `sha256sum -c` reads it.
    fn table_sum(&self) -> PathBuf {
        self.path.join("trials.parquet.sha256")
    }

    /// Writes the checksum of the whole table, then gives the table its name: a table whose checksum differs does not
    /// count as complete.
    fn name_table(&self, staged: StagedTable) -> Result<(), FolderError> {
        let path = self.table_sum();
        let mut file = File::create(&path).map_err(TableError::io(&path))?;
        let written = writeln!(file, "{}  trials.parquet", staged.sum()).and_then(|()| file.sync_all());
        written.map_err(TableError::io(&path))?;
        staged.name(&self.table())?;
        self.clear_all();
        Ok(())
    }

    /// Whether the whole table is there, is of this campaign, and has the bytes that were written.
    pub fn is_complete(&self) -> bool {
        let told = fs::read_to_string(self.table_sum()).unwrap_or_default();
        let told = told.get(..SUM_DIGITS);
        if told.is_none() || sum_of(&self.table()).ok().as_deref() != told {
            return false;
        }
        let about = TableReader::open(&self.table()).ok().and_then(|table| about_of(&table));
        about == Some(self.about(self.manifest.range()))
    }

    /// Whether there is a whole table that was cut short, altered or put there by another program.
    pub fn has_unsound_table(&self) -> bool {
        self.table().exists() && !self.is_complete()
    }

    fn parts(&self) -> PathBuf {
        self.path.join("parts")
    }

    fn shards(&self) -> PathBuf {
        self.path.join("shards")
    }

    /// How the files of this campaign begin.
    fn campaign(&self) -> &str {
        &self.sum[..CAMPAIGN_DIGITS.min(self.sum.len())]
    }

    fn about(&self, range: Range<u64>) -> About {
        About {
            campaign: self.sum.clone(),
            name: self.manifest.name.clone(),
            version: self.manifest.software.version.clone(),
            seed: self.manifest.seed,
            first: range.start,
            end: range.end,
        }
    }

    fn writer(&self, folder: &Path) -> Result<TableWriter, FolderError> {
        fs::create_dir_all(folder).map_err(TableError::io(folder))?;
        Ok(TableWriter::create(folder, &self.manifest.columns)?)
    }

    /// Completes a table of the rows of a range.
    fn finish(&self, mut table: TableWriter, range: Range<u64>) -> Result<StagedTable, FolderError> {
        // A manifest's own texts and numbers are always JSON.
        table.say(ABOUT, serde_json::to_string(&self.about(range)).unwrap_or_default());
        Ok(table.finish()?)
    }

    /// Removes the parts of a campaign whose table is complete, and the leftovers of killed processes.
    fn clear_all(&self) {
        for part in self.part_files() {
            // A file that cannot be removed does no harm.
            let _ = fs::remove_file(part.path);
        }
        for folder in [self.path.clone(), self.shards(), self.parts()] {
            let entries = fs::read_dir(folder).into_iter().flatten().flatten();
            let left = |path: &PathBuf| {
                path.file_name()
                    .and_then(|name| name.to_str())
                    .is_some_and(|name| name.starts_with(TEMPORARY))
            };
            for path in entries.map(|entry| entry.path()).filter(left) {
                let _ = fs::remove_file(path);
            }
        }
        // The folder stays if it contains anything else.
        let _ = fs::remove_dir(self.parts());
    }

    /// Removes the parts of rows that are complete elsewhere.
    fn clear_parts(&self, done: &Range<u64>) {
        for part in self.part_files() {
            if done.start <= part.range.start && part.range.end <= done.end {
                // A file that cannot be removed does no harm.
                let _ = fs::remove_file(part.path);
            }
        }
    }
}

fn put_manifest(file: &Path, manifest: &Manifest) -> Result<(), FolderError> {
    let folder = file.parent().unwrap_or(Path::new("."));
    let failed = || TableError::io(file);
    let mut staged =
        tempfile::Builder::new().prefix(TEMPORARY).tempfile_in(folder).map_err(TableError::io(folder))?;
    let text = serde_json::to_string_pretty(manifest)
        .map_err(|error| FolderError::Manifest { path: file.to_path_buf(), reason: error.to_string() })?;
    staged.write_all(text.as_bytes()).and_then(|()| staged.write_all(b"\n")).map_err(failed())?;
    staged.as_file().sync_all().map_err(failed())?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let readable = fs::Permissions::from_mode(0o644);
        staged.as_file().set_permissions(readable).map_err(failed())?;
    }
    match staged.persist_noclobber(file) {
        Ok(_) => Ok(sync_folder_of(file)?),
        Err(error) if error.error.kind() == io::ErrorKind::AlreadyExists => Ok(()),
        Err(error) => Err(failed()(error.error).into()),
    }
}

fn read_manifest(folder: &Path) -> Result<Manifest, FolderError> {
    let path = folder.join("manifest.json");
    let text = match fs::read_to_string(&path) {
        Ok(text) => text,
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            return Err(FolderError::NoCampaign { path: folder.to_path_buf() });
        }
        Err(error) => return Err(TableError::io(&path)(error).into()),
    };
    let refused = |reason: String| FolderError::Manifest { path: path.clone(), reason };
    let manifest: Manifest = serde_json::from_str(&text).map_err(|error| {
        let reason = if error.is_eof() { "it is empty or cut short".to_owned() } else { error.to_string() };
        refused(reason)
    })?;
    if manifest.schema != Manifest::schema() {
        return Err(refused(format!("schema is {:?}, not {:?}", manifest.schema, Manifest::schema())));
    }
    if manifest.trials == 0 || manifest.shards == 0 || manifest.columns.is_empty() {
        return Err(refused("it has no trials, no shards or no columns".to_owned()));
    }
    if manifest.shards > MOST_SHARDS || manifest.first.checked_add(manifest.trials).is_none() {
        return Err(refused(format!("it has more than {MOST_SHARDS} shards, or too many trials")));
    }
    Ok(manifest)
}

fn about_of(table: &TableReader) -> Option<About> {
    serde_json::from_str(table.about(ABOUT)?).ok()
}

/// The beginning of the SHA-256 of a file, as it stands in names.
fn sum_of(path: &Path) -> io::Result<String> {
    // A pipe with a file's name never ends.
    if !path.is_file() {
        return Err(io::ErrorKind::InvalidInput.into());
    }
    let mut sum = Sha256::new();
    let mut file = File::open(path)?;
    let mut piece = vec![0; 1 << 16];
    loop {
        match file.read(&mut piece)? {
            0 => break,
            count => sum.update(&piece[..count]),
        }
    }
    let mut text = hexadecimal(&sum.finalize());
    text.truncate(SUM_DIGITS);
    Ok(text)
}

fn short(staged: &StagedTable) -> &str {
    &staged.sum()[..SUM_DIGITS.min(staged.sum().len())]
}

#[cfg(test)]
mod tests;
