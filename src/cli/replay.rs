//! `calibrig replay`.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use super::identify::{LossArg, fitted_mode};
use super::{CliError, Verdict, output, print, say};
use crate::replay::{Change, Difference, ReplayError, ReplayOptions, Replayed, replay};
use calibrig_estimation::identification::Mode;
use calibrig_files::load_robot;
use calibrig_recording::{MissingPart, RecordingError};

/// Identify again from a recording alone, and compare with the recorded estimates bit for bit
///
/// With other options than the recorded ones the question is "what if": the errors are printed beside the recorded ones.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig replay runs/paper/recording.mcap                  the same bits?
  calibrig replay recording.mcap --robust tukey              what if outliers did not count?
  calibrig replay recording.mcap --drop-topic /nest          what if the base had not been measured?
  calibrig replay recording.mcap --mode extended --json      other rows, the report as JSON
  calibrig replay session.mcap --model ur5/robot.toml        recorded by another program

Exit code 3 if an estimate differs from the recorded one in any bit, or if the recording is cut short.")]
pub(super) struct Args {
    /// The recording
    recording: PathBuf,
    /// Which models are fitted, beside the robot without calibration; may be repeated [default: as recorded]
    #[arg(long, value_name = "MODE", value_parser = fitted_mode)]
    mode: Vec<Mode>,
    /// What a measurement far off the others costs: its square, or less [default: as recorded]
    #[arg(long, value_enum, value_name = "LOSS")]
    robust: Option<LossArg>,
    /// Leave out a topic and all below it, such as /nest or /measurement/verification; may be repeated
    #[arg(long, value_name = "TOPIC")]
    drop_topic: Vec<String>,
    /// The robot's file, instead of the recorded one
    #[arg(long, value_name = "ROBOT.toml")]
    model: Option<PathBuf>,
    /// Identify although the nominal robot does not lie on the points; ends with exit code 3
    #[arg(long)]
    fit_anyway: bool,
    /// Print the report as JSON (schema calibrig.report/1) instead of the tables
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    let options = ReplayOptions {
        modes: args.mode.clone(),
        loss: args.robust.map(Into::into),
        dropped_topics: args.drop_topic.clone(),
        robot: args.model.as_deref().map(load_robot).transpose()?,
        fit_anyway: args.fit_anyway,
    };
    let replayed = replay(&args.recording, &options).map_err(|error| failed(error, &args.recording))?;
    output::show(&replayed.outcome, args.json)?;
    for difference in &replayed.differences {
        say(&describe(difference));
    }
    if !args.json {
        print(&comparison(&replayed))?;
    }
    let mut verdict = output::verdict(&replayed.outcome);
    if let Some(why) = &replayed.implausible {
        verdict = output::doubtful(why);
    }
    for part in &replayed.missing {
        say(&cut_short(part));
        verdict = Verdict::Doubtful;
    }
    Ok(if replayed.differences.is_empty() { verdict } else { Verdict::Doubtful })
}

/// The failure of a replay of `file`.
pub(super) fn failed(error: ReplayError, file: &Path) -> CliError {
    match error {
        // It names the file already.
        ReplayError::Recording(error @ RecordingError::Unreadable { .. }) => CliError::Recording(error),
        source => CliError::Replay { file: file.to_path_buf(), source },
    }
}

/// That a set ends before its time.
pub(super) fn cut_short(part: &MissingPart) -> String {
    let kind = part.kind.key();
    match part.expected {
        Some(expected) => format!(
            "doubtful: the recording was cut short: {} of {expected} observations of the {kind} set are there",
            part.found
        ),
        None if part.found == 0 => {
            format!("doubtful: the description of the {kind} set is lost, and with it all its observations")
        }
        None => format!(
            "doubtful: the recording was cut short in the {kind} set, behind {} observations",
            part.found
        ),
    }
}

/// What the replay says of what was recorded.
fn comparison(replayed: &Replayed) -> String {
    if replayed.what_if {
        return what_if(&replayed.changes);
    }
    match replayed.compared {
        _ if !replayed.differences.is_empty() => String::new(),
        0 => "Replay: nothing to compare with: no estimate is recorded, or not all that it came from.\n"
            .to_owned(),
        1 => "Replay: 1 recorded estimate, identical bit for bit.\n".to_owned(),
        compared => format!("Replay: {compared} recorded estimates, all identical bit for bit.\n"),
    }
}

fn what_if(changes: &[Change]) -> String {
    let mut text = "What if: rms 3-D error, mm\n".to_owned();
    let rms = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |m| format!("{:.4}", 1e3 * m));
    // Writing to a String cannot fail.
    let _ =
        writeln!(text, "  {:<32} {:<15} {:>10} {:>10} {:>9}", "", "set", "recorded", "replayed", "change");
    for change in changes {
        let share = match (change.recorded, change.replayed) {
            (Some(before), Some(now)) if before > 0.0 => format!("{:+.1} %", 1e2 * (now / before - 1.0)),
            _ => "-".to_owned(),
        };
        let (title, set) = (change.mode.title(), change.kind.key());
        let (recorded, replayed) = (rms(change.recorded), rms(change.replayed));
        let _ = writeln!(text, "  {title:<32} {set:<15} {recorded:>10} {replayed:>10} {share:>9}");
    }
    text
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
