//! `calibrig export`.

mod calibrated;

use std::fs;
use std::path::{Path, PathBuf};

use super::identify::{FileArgs, Loaded};
use super::measured::texts;
use super::output::{Destination, Files, or_removed};
use super::{CliError, Verdict, say};
use crate::pipeline::InputSummary;
use calibrig_files::load_robot;
use calibrig_recording::{ExportError, Preamble, RecordingError, export_csv, write_sets};

/// Turn a recording into files of text, files of text into a recording, or an estimate into files of the calibrated robot
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig export calibrated runs/paper/recording.mcap --out calibrated
  calibrig export csv runs/paper/recording.mcap --out tables
  calibrig export mcap --model robot.toml --measurements grid.csv --out grid.mcap")]
pub(super) struct Args {
    #[command(subcommand)]
    direction: Direction,
}

#[derive(Debug, clap::Subcommand)]
enum Direction {
    Csv(CsvArgs),
    Mcap(Box<McapArgs>),
    Calibrated(calibrated::Args),
}

/// Turn a recording into measurement files, tables and the input files that it holds
///
/// identification.csv and verification.csv are in calibrig's own columns; session.toml holds what these have no columns for: nests, targets,
/// dropped poses. No bit of a measurement is lost. residuals.csv and parameters.csv hold the recorded estimates.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig export csv runs/paper/recording.mcap --out tables
  calibrig export csv by_hand.mcap --model robot.toml --out tables    if it holds no robot
  calibrig identify --model tables/robot.toml --measurements tables/identification.csv")]
struct CsvArgs {
    /// The recording
    recording: PathBuf,
    /// Folder for the files
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The robot's file, if the recording holds none
    #[arg(long, value_name = "ROBOT.toml")]
    model: Option<PathBuf>,
    /// Overwrite existing files
    #[arg(long)]
    force: bool,
}

/// Turn a robot and measurement files into a recording, without estimates
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig export mcap --model models/ur5/robot.toml --measurements grid.csv --out grid.mcap
  calibrig export mcap --model r.toml --measurements m.csv --session s.toml --out m.mcap
  calibrig replay grid.mcap

The columns of the files are described as for `calibrig identify`.")]
struct McapArgs {
    #[command(flatten)]
    files: FileArgs,
    /// The recording
    #[arg(long, value_name = "RECORDING.mcap")]
    out: PathBuf,
    /// Overwrite an existing file
    #[arg(long)]
    force: bool,
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    match &args.direction {
        Direction::Csv(args) => to_csv(args),
        Direction::Mcap(args) => to_mcap(args),
        Direction::Calibrated(args) => calibrated::execute(args),
    }
}

fn to_csv(args: &CsvArgs) -> Result<Verdict, CliError> {
    let destination = Destination::Asked(&args.out);
    destination.check(Files::Export)?;
    let model = args.model.as_deref().map(load_robot).transpose()?;
    let export = export_csv(&args.recording, model).map_err(|error| match error {
        // It names the file already.
        ExportError::Recording(error @ RecordingError::Unreadable { .. }) => CliError::Recording(error),
        source => CliError::Export { file: args.recording.clone(), source },
    })?;
    let files: Vec<_> = export.files.iter().map(|file| (file.name.as_str(), file.text.as_str())).collect();
    let stale = check_free(&args.out, Files::Export, &files, args.force)?;
    let (folder, new) = destination.make()?;
    or_removed(write(&folder, &files), &folder, new)?;
    for remark in &export.remarks {
        say(remark);
    }
    for name in stale {
        say(&format!("{name} in {} is an older file, not of this run", folder.display()));
    }
    Ok(Verdict::Done)
}

/// Files by their names, with their texts.
type Texts<'a> = [(&'a str, &'a str)];

/// Refuses to overwrite files unless `force`d. Older tables that this export does not write could be mistaken for its own:
/// returns their names.
fn check_free(
    folder: &Path,
    kind: Files,
    files: &Texts<'_>,
    force: bool,
) -> Result<Vec<&'static str>, CliError> {
    let there = |name: &str| Some(folder.join(name)).filter(|path| path.exists());
    let has = |name: &str| files.iter().any(|(known, _)| *known == name);
    let stale: Vec<_> =
        kind.names().iter().copied().filter(|name| !has(name) && there(name).is_some()).collect();
    let known = files.iter().map(|(name, _)| *name).chain(stale.iter().copied());
    let paths: Vec<PathBuf> = known.filter_map(there).collect();
    if let Some(at) = paths.iter().find(|path| path.is_dir()) {
        return Err(CliError::InTheWay {
            folder: folder.to_path_buf(),
            at: at.clone(),
            what: "a folder",
            expected: "the name of a folder; in this one, a folder has the name of a file to be written",
        });
    }
    if paths.is_empty() || force { Ok(stale) } else { Err(CliError::AlreadyThere { paths }) }
}

/// All files are complete before the first one takes its name.
fn write(folder: &Path, files: &Texts<'_>) -> Result<(), CliError> {
    let failed = |path: &Path| {
        let what = path.display().to_string();
        move |source| CliError::Output { what, source }
    };
    let staging = tempfile::Builder::new().prefix(".calibrig-").tempdir_in(folder).map_err(failed(folder))?;
    for (name, text) in files {
        fs::write(staging.path().join(name), text).map_err(failed(&folder.join(name)))?;
    }
    for (name, _) in files {
        let path = folder.join(name);
        fs::rename(staging.path().join(name), &path).map_err(failed(&path))?;
    }
    let names: Vec<_> = files.iter().map(|(name, _)| *name).collect();
    say(&format!("wrote {} to {}", names.join(", "), folder.display()));
    Ok(())
}

fn to_mcap(args: &McapArgs) -> Result<Verdict, CliError> {
    check_name(&args.out, args.force)?;
    let Loaded { robot, mut sources, sha256, sets, read, asked, statements, .. } = args.files.read()?;
    for line in &read {
        say(line);
    }
    // The files themselves, instead of their names.
    let (texts, left_out) = texts(&asked);
    let session = sources.iter().position(|(role, _)| role == "session").map(|at| sources.remove(at));
    sources.retain(|(_, source)| !source.text.is_empty());
    sources.extend(texts);
    sources.extend(session);
    for line in &left_out {
        say(line);
    }
    let input = InputSummary { kind: "files", name: robot.name, sha256, seed: None, trial: None };
    let preamble = Preamble {
        input: &input,
        sources: &sources,
        model: &robot.model,
        visuals: &robot.visuals,
        truth: None,
    };
    write_sets(&args.out, &preamble, &sets)?;
    statements.remarks.iter().for_each(|remark| say(remark));
    let counts: Vec<String> = sets
        .iter()
        .map(|set| {
            let dropped = match set.dropped.len() {
                0 => String::new(),
                count => format!(" ({count} dropped)"),
            };
            format!("{} of the {} set{dropped}", set.measurements.observations.len(), set.kind.key())
        })
        .collect();
    say(&format!("wrote {}: observations: {}", args.out.display(), counts.join(", ")));
    Ok(Verdict::Done)
}

/// Refuses a name that a recording cannot have.
fn check_name(path: &Path, force: bool) -> Result<(), CliError> {
    let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let refused = |at: &Path, what, expected| {
        Err(CliError::InTheWay { folder: parent.to_path_buf(), at: at.to_path_buf(), what, expected })
    };
    if !parent.is_dir() {
        return refused(parent, "no folder", "an existing folder");
    }
    if path.is_dir() {
        return refused(path, "a folder", "the name of a file");
    }
    if path.exists() && !force {
        return Err(CliError::AlreadyThere { paths: vec![path.to_path_buf()] });
    }
    Ok(())
}
