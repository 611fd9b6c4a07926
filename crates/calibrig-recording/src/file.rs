//! Files that are either complete or not written at all.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use super::RecordingError;

/// Writes `path` through `fill`: into a temporary file in the same folder, which takes the name of `path` once it is complete and on disk.
pub(super) fn write_whole<T>(
    path: &Path,
    fill: impl FnOnce(BufWriter<&File>) -> Result<T, RecordingError>,
) -> Result<T, RecordingError> {
    let unwritable = |source| RecordingError::Unwritable { path: path.to_path_buf(), source };
    let folder =
        path.parent().filter(|p| !p.as_os_str().is_empty()).map_or(PathBuf::from("."), Path::to_path_buf);
    let mut builder = tempfile::Builder::new();
    builder.prefix(".calibrig-").suffix(".part");
    give_ordinary_permissions(&mut builder);
    let temporary = builder.tempfile_in(&folder).map_err(unwritable)?;
    let value = fill(BufWriter::new(temporary.as_file()))?;
    temporary.as_file().sync_all().map_err(unwritable)?;
    temporary.persist(path).map_err(|e| unwritable(e.error))?;
    Ok(value)
}

/// A file that is written during a run. Its name ends in `.part` until [`finish`](Self::finish), so that the file of a killed run can be found
/// and is not taken for a complete one.
#[derive(Debug)]
pub struct UnfinishedFile {
    path: PathBuf,
    file: File,
}

impl UnfinishedFile {
    /// Creates `NAME.part` in `folder`, or `NAME-2.part` and so on where such files exist.
    pub fn create(folder: &Path, name: &str) -> Result<Self, RecordingError> {
        let mut number = 1_u64;
        loop {
            let part = if number == 1 { format!("{name}.part") } else { format!("{name}-{number}.part") };
            let path = folder.join(part);
            match File::options().write(true).create_new(true).open(&path) {
                Ok(file) => return Ok(Self { path, file }),
                Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => number += 1,
                Err(source) => return Err(RecordingError::Unwritable { path, source }),
            }
        }
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// A second handle on it, to write to.
    pub fn handle(&self) -> Result<File, RecordingError> {
        self.file.try_clone().map_err(|source| self.unwritable(source))
    }

    /// Writes it to disk and renames it to `path`.
    pub fn finish(self, path: &Path) -> Result<(), RecordingError> {
        let written = self.file.sync_all().and_then(|()| std::fs::rename(&self.path, path));
        written.map_err(|source| self.unwritable(source))
    }

    /// Removes it.
    pub fn discard(self) {
        // A file that stays behind is named as unfinished.
        let _ = std::fs::remove_file(&self.path);
    }

    fn unwritable(&self, source: std::io::Error) -> RecordingError {
        RecordingError::Unwritable { path: self.path.clone(), source }
    }
}

/// Gives a temporary file the permissions of any new file, not only those of its owner; the process's umask still applies.
#[cfg(unix)]
fn give_ordinary_permissions(builder: &mut tempfile::Builder<'_, '_>) {
    use std::os::unix::fs::PermissionsExt;
    builder.permissions(std::fs::Permissions::from_mode(0o666));
}

#[cfg(not(unix))]
fn give_ordinary_permissions(_: &mut tempfile::Builder<'_, '_>) {}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn a_failed_write_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("recording.mcap");
        std::fs::write(&path, "old").expect("written");
        let failed: Result<(), _> = write_whole(&path, |mut file| {
            file.write_all(b"half").expect("written");
            Err(RecordingError::NotMcap)
        });
        assert!(matches!(failed, Err(RecordingError::NotMcap)));
        assert_eq!(std::fs::read_to_string(&path).expect("read"), "old");
        assert_eq!(std::fs::read_dir(folder.path()).expect("listed").count(), 1);

        write_whole(&path, |mut file| file.write_all(b"new").map_err(RecordingError::unrecordable))
            .expect("written");
        assert_eq!(std::fs::read_to_string(&path).expect("read"), "new");
        assert_eq!(std::fs::read_dir(folder.path()).expect("listed").count(), 1);
    }

    #[cfg(unix)]
    #[test]
    fn a_recording_has_the_permissions_of_any_new_file() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().expect("a folder");
        let (ordinary, whole) = (folder.path().join("ordinary"), folder.path().join("whole"));
        std::fs::write(&ordinary, "").expect("written");
        write_whole(&whole, |_| Ok(())).expect("written");
        let mode = |path: &Path| std::fs::metadata(path).expect("there").permissions().mode();
        assert_eq!(mode(&whole), mode(&ordinary));
    }

    #[test]
    fn a_folder_that_is_not_there_is_named() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("missing").join("recording.mcap");
        let error = write_whole(&path, |_| Ok(())).expect_err("no folder");
        assert!(error.to_string().contains("recording.mcap"), "{error}");
    }
}
