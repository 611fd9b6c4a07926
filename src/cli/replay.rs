//! `calibrig replay`.

use std::path::PathBuf;

use super::{CliError, Verdict, output, print, say};
use crate::recording::RecordingError;
use crate::replay::{Difference, ReplayError, replay};

/// Identify again from a recording alone, and compare with the recorded estimates bit for bit
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig replay runs/paper/recording.mcap
  calibrig replay runs/paper/recording.mcap --json

Exit code 3 if an estimate differs from the recorded one in any bit.")]
pub(super) struct Args {
    /// The recording
    recording: PathBuf,
    /// Print the report as JSON (schema calibrig.report/1) instead of the tables
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    let replayed = replay(&args.recording).map_err(|error| match error {
        // It names the file already.
        ReplayError::Recording(error @ RecordingError::Unreadable { .. }) => CliError::Recording(error),
        source => CliError::Replay { file: args.recording.clone(), source },
    })?;
    output::show(&replayed.outcome, args.json)?;
    for difference in &replayed.differences {
        say(&describe(difference));
    }
    if replayed.differences.is_empty() {
        if !args.json {
            print(&format!(
                "Replay: {} recorded estimates, all identical bit for bit.\n",
                replayed.compared
            ))?;
        }
        Ok(output::verdict(&replayed.outcome))
    } else {
        Ok(Verdict::Doubtful)
    }
}

fn describe(difference: &Difference) -> String {
    match difference {
        Difference::Missing { mode } => {
            format!("replay differs: the recording holds no estimate of mode {mode}")
        }
        Difference::Parameter { mode, name, recorded, replayed } => {
            format!("replay differs: {mode}, {name}: recorded {recorded:e}, replayed {replayed:e}")
        }
        Difference::Set { mode } => {
            format!("replay differs: {mode} has other parameters than the recorded estimate")
        }
        Difference::ChiSquare { mode, recorded, replayed } => {
            format!("replay differs: {mode}, chi-square: recorded {recorded:e}, replayed {replayed:e}")
        }
    }
}
