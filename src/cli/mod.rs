//! The command line: argument types, one file a command. Results go to stdout, diagnostics and progress to stderr.

mod check;
mod identifiability;
mod identify;
mod output;
mod replay;
mod run;

use std::io::{self, IsTerminal, Write};
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use miette::{Diagnostic, GraphicalReportHandler, GraphicalTheme};
use thiserror::Error;

use crate::input::InputError;
use crate::measurement::CsvError;
use crate::pipeline::PipelineError;
use crate::recording::RecordingError;
use crate::replay::ReplayError;
use crate::report::ReportError;

/// Calibrate large robots with a laser tracker: on a simulated machine whose truth is known, and on real measurements.
#[derive(Debug, Parser)]
#[command(version, propagate_version = true, max_term_width = 110, after_help = EXIT_CODES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

const EXIT_CODES: &str = "Exit codes: 0 done; 1 failed; 2 wrong usage; 3 done but doubtful (rank-deficient, not converged, replay differs).
Set NO_COLOR=1 for plain text.";

#[derive(Debug, Subcommand)]
enum Command {
    Run(run::Args),
    Check(check::Args),
    Identify(identify::Args),
    Identifiability(identifiability::Args),
    Replay(replay::Args),
}

/// How a command ended that did end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Verdict {
    /// Done.
    Done,
    /// Done, but the result must not be used without a second look.
    Doubtful,
}

/// Why a command failed.
#[derive(Debug, Error, Diagnostic)]
enum CliError {
    #[error(transparent)]
    #[diagnostic(transparent)]
    Input(#[from] InputError),
    #[error(transparent)]
    #[diagnostic(transparent)]
    Csv(#[from] CsvError),
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    #[error(transparent)]
    Recording(#[from] RecordingError),
    #[error(transparent)]
    Replay(#[from] ReplayError),
    #[error(transparent)]
    Report(#[from] ReportError),
    #[error("{what}: {source}")]
    Output { what: String, source: io::Error },
}

/// Parses the arguments, runs the command and turns its end into an exit code.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let result = match &cli.command {
        Command::Run(args) => run::execute(args),
        Command::Check(args) => check::execute(args),
        Command::Identify(args) => identify::execute(args),
        Command::Identifiability(args) => identifiability::execute(args),
        Command::Replay(args) => replay::execute(args),
    };
    match result {
        Ok(Verdict::Done) => ExitCode::SUCCESS,
        Ok(Verdict::Doubtful) => ExitCode::from(3),
        // The reader of a pipe went away: nobody is left to tell.
        Err(CliError::Output { source, .. }) if source.kind() == io::ErrorKind::BrokenPipe => {
            ExitCode::SUCCESS
        }
        Err(error) => {
            complain(&error);
            ExitCode::FAILURE
        }
    }
}

/// Prints an error to stderr, with the place in the file where there is one.
fn complain(error: &CliError) {
    let theme =
        if colours(&io::stderr()) { GraphicalTheme::unicode() } else { GraphicalTheme::unicode_nocolor() };
    let mut text = String::new();
    let handler = GraphicalReportHandler::new_themed(theme).with_width(110).with_context_lines(2);
    if handler.render_report(&mut text, error).is_err() {
        text = format!("{error}\n");
    }
    // stderr is the last resort: there is nowhere to report its failure.
    let _ = write!(io::stderr(), "error: {}", text.trim_start());
}

/// Whether to write colours: to a terminal, unless `NO_COLOR` is set to something.
fn colours(stream: &impl IsTerminal) -> bool {
    stream.is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty())
}

/// Writes a result to stdout.
fn print(text: &str) -> Result<(), CliError> {
    let mut stdout = io::stdout().lock();
    stdout
        .write_all(text.as_bytes())
        .and_then(|()| stdout.flush())
        .map_err(|source| CliError::Output { what: "standard output".to_owned(), source })
}

/// Says something to the person at the terminal, beside the result.
fn say(text: &str) {
    // A lost remark must not lose the result.
    let _ = writeln!(io::stderr(), "{text}");
}
