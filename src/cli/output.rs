//! Where the files of a run go.

use std::path::{Path, PathBuf};

use super::{CliError, Verdict, colours, print, say};
use crate::identification::Warning;
use crate::pipeline::Outcome;
use crate::{recording, report};

/// Which files a command leaves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Files {
    /// Reports alone.
    Reports,
    /// Reports and recordings.
    ReportsAndRecordings,
    /// What a campaign leaves.
    Campaign,
}

impl Files {
    fn names(self) -> &'static [&'static str] {
        match self {
            Self::Reports => &["report.html", "report.json"],
            Self::Campaign => &["trials.csv", "summary.json"],
            #[cfg(feature = "rerun")]
            Self::ReportsAndRecordings => &["report.html", "report.json", "recording.mcap", "recording.rrd"],
            #[cfg(not(feature = "rerun"))]
            Self::ReportsAndRecordings => &["report.html", "report.json", "recording.mcap"],
        }
    }
}

/// Where files go.
#[derive(Debug, Clone, Copy)]
pub(super) enum Destination<'a> {
    /// The folder asked for, whose files are written over.
    Asked(&'a Path),
    /// A new folder under `runs/` with this name, so that nothing is written over unasked.
    New(&'a str),
}

impl Destination<'_> {
    /// Refuses a place that cannot be written to, before anything is computed for it. Makes nothing.
    pub(super) fn check(self, files: Files) -> Result<(), CliError> {
        let folder = match self {
            Self::Asked(path) => path,
            Self::New(_) => Path::new(RUNS),
        };
        let refused = |at: &Path, what, expected| {
            Err(CliError::InTheWay { folder: folder.to_path_buf(), at: at.to_path_buf(), what, expected })
        };
        if let Some(at) = folder.ancestors().find(|path| path.exists())
            && !at.is_dir()
        {
            return refused(at, "no folder", "a folder, or the name of a new one");
        }
        if let Self::Asked(folder) = self {
            let taken = files.names().iter().map(|name| folder.join(name)).find(|path| path.is_dir());
            if let Some(at) = taken {
                return refused(&at, "a folder", "no folder of that name: a file takes it");
            }
        }
        Ok(())
    }

    /// The folder, made if it is not there, and whether it was made.
    pub(super) fn make(self) -> Result<(PathBuf, bool), CliError> {
        let failed = |path: &Path| {
            let what = path.display().to_string();
            move |source| CliError::Output { what, source }
        };
        let name = match self {
            Self::Asked(path) => {
                let new = !path.exists();
                std::fs::create_dir_all(path).map_err(failed(path))?;
                return Ok((path.to_path_buf(), new));
            }
            Self::New(name) => name,
        };
        let runs = Path::new(RUNS);
        std::fs::create_dir_all(runs).map_err(failed(runs))?;
        let safe: String = name
            .chars()
            .map(|c| if c.is_ascii_alphanumeric() || c == '-' || c == '_' { c } else { '_' })
            .collect();
        let mut number = 1_u64;
        loop {
            let path = runs.join(if number == 1 { safe.clone() } else { format!("{safe}-{number}") });
            match std::fs::create_dir(&path) {
                Ok(()) => return Ok((path, true)),
                Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => number += 1,
                Err(error) => return Err(failed(&path)(error)),
            }
        }
    }
}

const RUNS: &str = "runs";

/// Writes the files and says where they are. They are all complete before the first one takes its name: a run that fails leaves the
/// folder's files as they were.
pub(super) fn write(outcome: &Outcome, destination: Destination<'_>, files: Files) -> Result<(), CliError> {
    let (folder, new) = destination.make()?;
    let written = write_to(outcome, &folder, files);
    if written.is_err() && new {
        // What stays behind is an empty folder at most.
        let _ = std::fs::remove_dir(&folder);
    }
    written?;
    #[cfg(not(feature = "rerun"))]
    if files == Files::ReportsAndRecordings {
        say(
            "recording.rrd is not written: this build has no Rerun (build with `--features rerun`); recording.mcap opens in Rerun and Foxglove",
        );
    }
    say(&format!("wrote {} to {}", files.names().join(", "), folder.display()));
    Ok(())
}

fn write_to(outcome: &Outcome, folder: &Path, files: Files) -> Result<(), CliError> {
    let failed = |what: &Path, source| CliError::Output { what: what.display().to_string(), source };
    let staging =
        tempfile::Builder::new().prefix(".calibrig-").tempdir_in(folder).map_err(|e| failed(folder, e))?;
    let staged = staging.path();
    report::write_reports(outcome, staged)?;
    if files == Files::ReportsAndRecordings {
        recording::write_mcap(outcome, &staged.join("recording.mcap"))?;
        #[cfg(feature = "rerun")]
        recording::write_rrd(outcome, &staged.join("recording.rrd"))?;
    }
    for name in files.names() {
        let path = folder.join(name);
        std::fs::rename(staged.join(name), &path).map_err(|e| failed(&path, e))?;
    }
    Ok(())
}

/// Prints the tables, or the JSON document.
pub(super) fn show(outcome: &Outcome, json: bool) -> Result<(), CliError> {
    let text = if json {
        report::json_text(outcome)?
    } else {
        report::render_tables(
            outcome,
            if colours(&std::io::stdout()) { report::Style::Colour } else { report::Style::Plain },
        )
    };
    print(&text)
}

/// Doubtful as soon as one estimate is; says why, and of which parameters.
pub(super) fn verdict(outcome: &Outcome) -> Verdict {
    let mut verdict = Verdict::Done;
    for mode in outcome.splits.iter().flat_map(|study| &study.modes).filter(|mode| mode.doubtful > 0) {
        verdict = Verdict::Doubtful;
        say(&format!("doubtful: {}: {} of {} splits", mode.mode.title(), mode.doubtful, mode.rms.len()));
    }
    for mode in &outcome.modes {
        let Some(estimate) = mode.estimate.as_ref().filter(|estimate| !estimate.is_sound()) else { continue };
        verdict = Verdict::Doubtful;
        let title = mode.mode.title();
        for warning in &estimate.warnings {
            match warning {
                Warning::NotConverged(_) => {
                    let names: Vec<_> = estimate.parameters.iter().map(|p| p.id.to_string()).collect();
                    say(&format!(
                        "doubtful: {title}: {warning}; not at their best values: {}",
                        names.join(", ")
                    ));
                }
                Warning::RankDeficient { .. }
                | Warning::AtBound { .. }
                | Warning::Rigid { .. }
                | Warning::Contradicted(_) => {
                    say(&format!("doubtful: {title}: {warning}"));
                }
                _ => {}
            }
        }
    }
    verdict
}
