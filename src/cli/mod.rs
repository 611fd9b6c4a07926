//! The command line: argument types, one file per command. Results go to stdout, diagnostics and progress to stderr.

mod by_name;
mod campaign;
mod check;
mod choose;
mod columns;
mod compensate;
mod diagnose;
mod estimate;
mod export;
mod identifiability;
mod identify;
mod inspect;
mod interrupt;
mod iso9283;
mod live;
mod measured;
mod model;
mod montecarlo;
mod output;
mod plan;
mod record;
mod recover;
mod replay;
mod report;
mod reread;
mod run;
mod scenario;
mod tracker_acceptance;

use std::error::Error as _;
use std::fmt;
use std::io::{self, IsTerminal, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use calibrig_campaign::plan::PlanError;
use calibrig_campaign::shards::FolderError;
use calibrig_campaign::table::TableError;
use clap::{Parser, Subcommand};
use miette::{Diagnostic, GraphicalReportHandler, GraphicalTheme, LabeledSpan, SourceCode};
use thiserror::Error;

use crate::handover::{AnotherModel, HandoverError};
use crate::montecarlo::SummaryError;
use crate::pipeline::{Iso9283Failure, PipelineError};
use crate::pose_plan::PosePlanError;
use crate::replay::ReplayError;
use crate::report::ReportError;
use crate::scenario::{Scenario, load_scenario};
use crate::twin::TwinError;
use calibrig_estimation::compensation::CompensationError;
use calibrig_estimation::identification::{IdentifyError, Mode};
use calibrig_files::{InputError, Source};
use calibrig_model::measurement::MeasurementError;
use calibrig_recording::{ExportError, RecordingError};

/// Calibrate large robots with a laser tracker: on a simulated machine whose truth is known, and on real measurements.
#[derive(Debug, Parser)]
#[command(version, propagate_version = true, max_term_width = 110, after_help = EXIT_CODES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

const EXIT_CODES: &str = "Exit codes:
  0  done: the stated intervals hold as far as the data can tell; warnings may stand, also of a misfit that the intervals
     account for, and of drives without visible compliance
  1  no result: input refused, or the nominal robot does not fit the points (RMS after best fit at a large share of the
     robot's size; the fit does not start; --fit-anyway goes on and then ends with 3)
  2  wrong usage
  3  a result that a person must look at: not converged; rank-deficient in what was asked for; a stated prior, nest or
     target contradicted; a bound of the user reached; a parameter whose identification makes held-out poses worse than
     leaving it; gross errors that carry weight in the fit; replay differs; acceptance missed; shards missing
Set NO_COLOR=1 for plain text.";

#[derive(Debug, Subcommand)]
enum Command {
    Run(run::Args),
    Check(check::Args),
    Identify(Box<identify::Args>),
    Identifiability(identifiability::Args),
    Choose(Box<choose::Args>),
    Plan(Box<plan::Args>),
    Iso9283(Box<iso9283::Args>),
    Columns(columns::Args),
    Compensate(Box<compensate::Args>),
    Model(model::Args),
    Diagnose(Box<diagnose::Args>),
    Montecarlo(Box<montecarlo::Args>),
    Missing(campaign::MissingArgs),
    Merge(campaign::MergeArgs),
    Scenario(scenario::Args),
    TrackerAcceptance(tracker_acceptance::Args),
    Replay(replay::Args),
    Inspect(inspect::Args),
    Recover(recover::Args),
    Report(report::Args),
    Export(export::Args),
}

/// How a command with a result ended (ADR 0015).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Verdict {
    /// Done.
    Done,
    /// A result that a person must look at.
    Doubtful,
}

impl Verdict {
    /// Done only if both are.
    fn and(self, other: Self) -> Self {
        if self == Self::Done { other } else { self }
    }
}

/// Why a command failed.
#[derive(Debug, Error, Diagnostic)]
enum CliError {
    #[error(transparent)]
    #[diagnostic(transparent)]
    Input(#[from] InputError),
    #[error("{}: {source}", file.display())]
    Pipeline { file: PathBuf, source: PipelineError },
    #[error(transparent)]
    #[diagnostic(transparent)]
    Recording(#[from] RecordingError),
    #[error("{}: {source}", file.display())]
    Mcap { file: PathBuf, source: RecordingError },
    #[error("{}: {source}", file.display())]
    Replay { file: PathBuf, source: ReplayError },
    #[error("{}: {source}", file.display())]
    Export { file: PathBuf, source: ExportError },
    #[error("{}: {source}", file.display())]
    Handover { file: PathBuf, source: Box<HandoverError> },
    #[error("{}: {source}", file.display())]
    #[diagnostic(help("expected the robot file that the estimate was made with"))]
    AnotherModel { file: PathBuf, source: AnotherModel },
    #[error("{}: there is no estimate{}", file.display(), mode.map_or_else(String::new, |mode| format!(" of mode {}", mode.key())))]
    #[diagnostic(help(
        "expected a recording whose measurements identify the robot; for an estimate.json, its own mode"
    ))]
    NoEstimate { file: PathBuf, mode: Option<Mode> },
    #[error("{} there already", already(paths))]
    #[diagnostic(help("expected other names, or --force to overwrite them"))]
    AlreadyThere { paths: Vec<PathBuf> },
    #[error("{} exists already", path.display())]
    #[diagnostic(help("expected another name"))]
    NamedAlready { path: PathBuf },
    #[error("{}: {source}", file.display())]
    #[diagnostic(help("{}", iso9283::help(source)))]
    Iso9283 { file: PathBuf, source: Box<Iso9283Failure> },
    #[error("{}: {source}", file.display())]
    #[diagnostic(help("{}", source.help()))]
    Twin { file: PathBuf, source: Box<TwinError> },
    #[error("{}: {source}", file.display())]
    #[diagnostic(help("{help}"))]
    Compensation { file: PathBuf, source: Box<CompensationError>, help: &'static str },
    #[error("--{flag} {message}")]
    #[diagnostic(help("expected {expected}"))]
    Flag { flag: &'static str, message: String, expected: String },
    #[error("{}: {source}", file.display())]
    #[diagnostic(help("{}", source.help()))]
    PosePlan { file: PathBuf, source: Box<PosePlanError> },
    #[error(transparent)]
    Report(#[from] ReportError),
    #[error("interrupted after {done} of {total} poses; what was measured is in {}", part.display())]
    #[diagnostic(help("`calibrig recover {} RECORDING.mcap` makes a recording of it, which `calibrig replay` reads", part.display()))]
    Interrupted { done: u32, total: u32, part: PathBuf },
    #[error("some files could not be written to {}: {}", folder.display(), failures.join("; "))]
    #[diagnostic(help("{}", unwritten_help(written)))]
    NotWritten { folder: PathBuf, failures: Vec<String>, written: Vec<&'static str> },
    #[error("cannot write {what}: {source}")]
    Output { what: String, source: io::Error },
    #[error(transparent)]
    #[diagnostic(help("{}", campaign::help(_0)))]
    Folder(#[from] FolderError),
    #[error("{}: this folder holds a campaign already", path.display())]
    #[diagnostic(help(
        "expected another folder (--out) for a new campaign; or --resume, which continues this one, or summarises it if it is \
         complete"
    ))]
    CampaignThere { path: PathBuf },
    #[error("{}: {count} {} among the shards must not be merged", path.display(), if *count == 1 { "file" } else { "files" })]
    #[diagnostic(help("move them to another folder, then merge again: nothing was written"))]
    NotMerged { path: PathBuf, count: usize },
    #[error("{}: {source}", path.display())]
    #[diagnostic(help("expected a table as this version of calibrig writes it"))]
    Summary { path: PathBuf, source: Box<SummaryError> },
    #[error(transparent)]
    Plan(#[from] PlanError),
    #[error("cannot start the threads: {reason}")]
    Threads { reason: String },
    #[error("cannot write to the folder {}: {} is {what}", folder.display(), at.display())]
    #[diagnostic(help("expected {expected}"))]
    InTheWay { folder: PathBuf, at: PathBuf, what: &'static str, expected: &'static str },
}

fn already(paths: &[PathBuf]) -> String {
    let names: Vec<_> = paths.iter().map(|path| path.display().to_string()).collect();
    format!("{} {}", names.join(", "), if names.len() == 1 { "is" } else { "are" })
}

fn unwritten_help(written: &[&str]) -> String {
    let kept = match written {
        [] => String::new(),
        files => format!(", and in {}", files.join(" and ")),
    };
    format!("expected free space and permission to write; the result is on standard output{kept}")
}

/// What an identification that failed for lack of poses needs, in words.
fn what_is_needed(error: &PipelineError) -> Option<String> {
    let PipelineError::Calibrate(error) = error else { return None };
    match *error.cause()? {
        IdentifyError::TooFewRows { rows, parameters } => {
            let more = (parameters - rows.min(parameters)).div_ceil(3);
            Some(format!("expected at least {more} more poses: each gives three coordinates"))
        }
        IdentifyError::BestFit | IdentifyError::Measurements(MeasurementError::Empty) => {
            Some("expected at least three poses whose measured points are not on one line".to_owned())
        }
        _ => None,
    }
}

/// The failure of an identification from `source`; at `place` in it if more or other poses are needed.
fn not_identified(error: PipelineError, file: &Path, source: &Source, place: Range<usize>) -> CliError {
    if let PipelineError::Implausible(why) = &error {
        let help = why.help();
        return source.error(0..0, error, Some(help)).into();
    }
    if let PipelineError::BeyondAnalytic { effect } = &error {
        let section = format!("effects.{}", effect.key());
        let help = format!("use the simulated plant (--plant rapier), or switch [{section}] off");
        return source.error(source.place_of(&section), error, Some(help)).into();
    }
    match what_is_needed(&error) {
        Some(help) => source.error(place, error, Some(help)).into(),
        None => CliError::Pipeline { file: file.to_path_buf(), source: error },
    }
}

/// The same, for rows of measurement files.
fn not_identified_at(error: PipelineError, file: &Path, place: String) -> CliError {
    match what_is_needed(&error) {
        Some(help) => InputError::Place { place, message: error.to_string(), help: Some(help) }.into(),
        None => CliError::Pipeline { file: file.to_path_buf(), source: error },
    }
}

/// Parses the arguments, runs the command and turns its result into an exit code.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let result = match &cli.command {
        Command::Run(args) => run::execute(args),
        Command::Check(args) => check::execute(args),
        Command::Identify(args) => identify::execute(args),
        Command::Choose(args) => choose::execute(args),
        Command::Plan(args) => plan::execute(args),
        Command::Iso9283(args) => iso9283::execute(args),
        Command::Columns(args) => columns::execute(args),
        Command::Compensate(args) => compensate::execute(args),
        Command::Model(args) => model::execute(args),
        Command::Diagnose(args) => diagnose::execute(args),
        Command::Montecarlo(args) => montecarlo::execute(args),
        Command::Missing(args) => campaign::missing(args),
        Command::Merge(args) => campaign::merge(args),
        Command::Scenario(args) => scenario::execute(args),
        Command::TrackerAcceptance(args) => tracker_acceptance::execute(args),
        Command::Identifiability(args) => identifiability::execute(args),
        Command::Replay(args) => replay::execute(args),
        Command::Inspect(args) => inspect::execute(args),
        Command::Recover(args) => recover::execute(args),
        Command::Report(args) => report::execute(args),
        Command::Export(args) => export::execute(args),
    };
    match result {
        Ok(Verdict::Done) => ExitCode::SUCCESS,
        Ok(Verdict::Doubtful) => ExitCode::from(3),
        Err(error) => {
            complain(&error);
            ExitCode::FAILURE
        }
    }
}

/// Prints an error to stderr, with its place in a file if it has one.
fn complain(error: &CliError) {
    let mut theme =
        if colours(&io::stderr()) { GraphicalTheme::unicode() } else { GraphicalTheme::unicode_nocolor() };
    "error:".clone_into(&mut theme.characters.error);
    let mut text = String::new();
    // Not wrapped, so that a file's name can be copied whole; terminals wrap by themselves.
    let handler = GraphicalReportHandler::new_themed(theme).with_context_lines(2).with_wrap_lines(false);
    let told = Told { text: with_causes(error), error };
    if handler.render_report(&mut text, &told).is_err() {
        text = format!("error: {told}\n");
    }
    // stderr is the last resort: there is nowhere to report its failure.
    let _ = io::stderr().write_all(text.trim_start().as_bytes());
}

/// The error's message, and those of its causes that it does not contain already.
fn with_causes(error: &CliError) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(inner) = cause {
        let more = inner.to_string();
        if !text.contains(&more) {
            text = format!("{text}: {more}");
        }
        cause = inner.source();
    }
    text
}

/// An error in one message.
#[derive(Debug)]
struct Told<'a> {
    text: String,
    error: &'a CliError,
}

impl fmt::Display for Told<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl std::error::Error for Told<'_> {}

impl Told<'_> {
    /// Where help and place are found.
    fn place(&self) -> &dyn Diagnostic {
        match self.error {
            CliError::Replay { source, .. } => source,
            CliError::Mcap { source, .. } => source,
            CliError::Export { source, .. } => source,
            error => error,
        }
    }
}

impl Diagnostic for Told<'_> {
    fn help<'a>(&'a self) -> Option<Box<dyn fmt::Display + 'a>> {
        self.place().help()
    }

    fn source_code(&self) -> Option<&dyn SourceCode> {
        self.place().source_code()
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        self.place().labels()
    }
}

/// Whether to write colours: to a terminal, unless `NO_COLOR` is set to something.
fn colours(stream: &impl IsTerminal) -> bool {
    stream.is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty())
}

/// Writes a result to stdout.
fn print(text: &str) -> Result<(), CliError> {
    let mut stdout = io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        // The reader of the pipe has what it wanted and is gone.
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        Err(source) => Err(CliError::Output { what: "standard output".to_owned(), source }),
        Ok(()) => Ok(()),
    }
}

/// Writes a file that takes its name when it is complete.
fn write_whole(folder: &Path, path: &Path, text: &str) -> io::Result<()> {
    let mut staged = tempfile::Builder::new().prefix(".calibrig-").tempfile_in(folder)?;
    staged.write_all(text.as_bytes())?;
    make_readable(staged.as_file())?;
    staged.persist(path).map_err(|error| error.error)?;
    Ok(())
}

/// A temporary file is private; the files that a command leaves are not.
fn make_readable(file: &std::fs::File) -> io::Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        file.set_permissions(std::fs::Permissions::from_mode(0o644))?;
    }
    Ok(())
}

impl From<TableError> for CliError {
    fn from(error: TableError) -> Self {
        Self::Folder(error.into())
    }
}

/// A scenario; changes to its robot's table are reported.
fn read_scenario(path: &Path) -> Result<Scenario, InputError> {
    let scenario = load_scenario(path)?;
    scenario.robot.remarks.iter().for_each(|remark| say(remark));
    Ok(scenario)
}

/// Prints a message for the person at the terminal, separate from the result.
fn say(text: &str) {
    // A lost remark must not lose the result.
    let _ = writeln!(io::stderr(), "{text}");
}
