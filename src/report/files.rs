//! Writing: files that are whole when they have their names, and what keeps a report from being made.

use std::io::Write;
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;
use thiserror::Error;

/// A report that could not be made or written.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ReportError {
    /// A file could not be written; nothing is left behind under its name.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A value has no JSON form.
    #[error("cannot express the report as JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// A table could not be made.
    #[error("cannot write residuals.csv: {0}")]
    Table(#[from] csv::Error),
    /// A figure could not be drawn.
    #[error("cannot draw the figure of {figure}: {reason}")]
    Plot {
        /// What it shows.
        figure: &'static str,
        /// Why.
        reason: String,
    },
}

/// Writes files of these names to `folder`, which exists. All are written in full beside their names before one takes its own, so that a
/// failure leaves no half of a report.
pub(super) fn write_all(folder: &Path, files: &[(&str, String)]) -> Result<(), ReportError> {
    let staged = files.iter().map(|(name, text)| stage(folder, name, text)).collect::<Result<Vec<_>, _>>()?;
    for (file, path) in staged {
        file.persist(&path).map_err(|e| ReportError::Write { path, source: e.error })?;
    }
    Ok(())
}

fn stage(folder: &Path, name: &str, text: &str) -> Result<(NamedTempFile, PathBuf), ReportError> {
    let path = folder.join(name);
    let mut builder = tempfile::Builder::new();
    builder.prefix(".report-");
    // A temporary file is private by default; a report is as readable as the user's umask allows.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let written = builder.tempfile_in(folder).and_then(|mut file| {
        file.write_all(text.as_bytes())?;
        file.as_file().sync_all()?;
        Ok(file)
    });
    match written {
        Ok(file) => Ok((file, path)),
        Err(source) => Err(ReportError::Write { path, source }),
    }
}
