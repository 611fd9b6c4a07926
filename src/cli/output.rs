//! Where the files of a run go.

use std::path::{Path, PathBuf};

use super::{CliError, Verdict, colours, print, say};
use crate::pipeline::Outcome;
use crate::{recording, report};

/// The folder to write to: the one asked for, or a new one under `runs/`, so that nothing is written over unasked.
pub(super) fn folder(asked: Option<&Path>, name: &str) -> Result<PathBuf, CliError> {
    let failed = |path: &Path| {
        let what = path.display().to_string();
        move |source| CliError::Output { what, source }
    };
    if let Some(path) = asked {
        std::fs::create_dir_all(path).map_err(failed(path))?;
        return Ok(path.to_path_buf());
    }
    let runs = Path::new("runs");
    std::fs::create_dir_all(runs).map_err(failed(runs))?;
    let safe: String = name
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() || c == '-' || c == '_' { c } else { '_' })
        .collect();
    for number in 1_u32.. {
        let path = runs.join(if number == 1 { safe.clone() } else { format!("{safe}-{number}") });
        match std::fs::create_dir(&path) {
            Ok(()) => return Ok(path),
            Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(failed(&path)(error)),
        }
    }
    Ok(runs.to_path_buf())
}

/// Which files a command leaves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Files {
    /// Reports alone.
    Reports,
    /// Reports and recordings.
    ReportsAndRecordings,
}

/// Writes the files and says where they are.
pub(super) fn write(outcome: &Outcome, folder: &Path, files: Files) -> Result<(), CliError> {
    report::write_reports(outcome, folder)?;
    let mut names = vec!["report.html", "report.json"];
    if files == Files::ReportsAndRecordings {
        recording::write_mcap(outcome, &folder.join("recording.mcap"))?;
        names.push("recording.mcap");
        #[cfg(feature = "rerun")]
        {
            recording::write_rrd(outcome, &folder.join("recording.rrd"))?;
            names.push("recording.rrd");
        }
        #[cfg(not(feature = "rerun"))]
        say(
            "recording.rrd is not written: this build has no Rerun (build with `--features rerun`); recording.mcap opens in Rerun and Foxglove",
        );
    }
    say(&format!("wrote {} to {}", names.join(", "), folder.display()));
    Ok(())
}

/// Prints the tables, or the JSON document.
pub(super) fn show(outcome: &Outcome, json: bool) -> Result<(), CliError> {
    let text = if json {
        report::json_text(outcome)?
    } else {
        report::render_tables(outcome, if colours(&std::io::stdout()) { report::Style::Colour } else { report::Style::Plain })
    };
    print(&text)
}

/// Doubtful as soon as one estimate is.
pub(super) fn verdict(outcome: &Outcome) -> Verdict {
    let sound = outcome.modes.iter().filter_map(|m| m.estimate.as_ref()).all(|e| e.is_sound());
    if sound { Verdict::Done } else { Verdict::Doubtful }
}
