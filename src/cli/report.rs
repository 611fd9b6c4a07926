//! `calibrig report`.

use std::path::PathBuf;

use super::output::{self, Destination, Files};
use super::replay::{cut_short, failed, unnoticed};
use super::{CliError, Verdict, say};
use crate::pipeline::{Outcome, bounds_at_truth};
use crate::replay::{NoTruth, ReplayOptions, recorded_truth, replay};

/// Make report.html, report.json and residuals.csv again from a recording
///
/// The parameters are identified again from the recorded measurements; then the truth of a simulated run is added for comparison.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig report runs/paper/recording.mcap              in a new folder under runs/
  calibrig report recording.mcap --out report            in report/, which is overwritten
  calibrig report recording.mcap --out report --json     and the report as JSON on standard output")]
pub(super) struct Args {
    /// The recording
    recording: PathBuf,
    /// Folder for report.html, report.json and residuals.csv, which are overwritten [default: a new folder under runs/]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print the report as JSON (schema calibrig.report/1) instead of the tables
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    if let Some(out) = &args.out {
        Destination::Asked(out).check(Files::Reports)?;
    }
    let refused = |error| failed(error, &args.recording);
    let mut replayed =
        replay(&args.recording, &ReplayOptions { fit_anyway: true, ..ReplayOptions::default() })
            .map_err(refused)?;
    match recorded_truth(&args.recording).map_err(refused)? {
        Ok(truth) => {
            let Outcome { model, sets, modes, .. } = &replayed.outcome;
            replayed.outcome.bounds = bounds_at_truth(model, sets, modes, &replayed.options, &truth);
            replayed.outcome.truth = Some(truth);
        }
        Err(NoTruth::Real) => {}
        Err(NoTruth::OtherMachine) => say(
            "the truth is left out: this version of calibrig draws a different machine from the recorded scenario",
        ),
    }
    replayed.outcome.command = Some(output::command_line());
    let outcome = &replayed.outcome;
    let destination = args.out.as_deref().map_or(Destination::New(&outcome.input.name), Destination::Asked);
    destination.check(Files::Reports)?;
    let (folder, new) = destination.make()?;
    let written = output::or_removed(output::write(outcome, &folder, None), &folder, new);
    output::show(outcome, args.json)?;
    written?;
    let mut verdict = output::verdict(outcome);
    if let Some(why) = &replayed.implausible {
        verdict = output::doubtful(why);
    }
    if let Some(line) = unnoticed(&replayed.unprotected) {
        say(&line);
    }
    for part in &replayed.missing {
        say(&cut_short(part));
        verdict = Verdict::Doubtful;
    }
    Ok(verdict)
}
