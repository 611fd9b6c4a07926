//! `calibrig replay`.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use super::identify::{LossArg, fitted_mode};
use super::{CliError, Verdict, output, print, say};
use crate::replay::{
    Change, Difference, MadeBy, ParameterChange, ReplayError, ReplayOptions, Replayed, replay,
};
use calibrig_estimation::identification::Mode;
use calibrig_files::load_robot;
use calibrig_recording::{MissingPart, RecordingError, Unprotected};

/// Identify again from only a recording, and compare with the recorded estimates, bit for bit if the same version made them
///
/// With options other than the recorded ones the question is "what if": the errors are printed next to the recorded
/// ones.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig replay runs/paper/recording.mcap                  the same bits?
  calibrig replay recording.mcap --loss tukey                what if outliers did not count?
  calibrig replay recording.mcap --drop-topic /nest          what if the base had not been measured?
  calibrig replay recording.mcap --mode extended --json      other rows, the report as JSON
  calibrig replay session.mcap --model ur5/robot.toml        recorded by another program

Exit code 3 if an estimate differs in any bit from the recorded one that this version of calibrig made, or if the recording is cut short. If
another version made the estimates, differences are listed (parameters in standard deviations, errors in mm), and are no reason for doubt.")]
pub(super) struct Args {
    /// The recording
    recording: PathBuf,
    /// Models to fit, besides the robot without calibration; may be repeated [default: as recorded]
    #[arg(long, value_name = "MODE", value_parser = fitted_mode)]
    mode: Vec<Mode>,
    /// Loss of a measurement far from the others: its square, or less [default: as recorded]
    #[arg(long, value_enum, value_name = "LOSS")]
    loss: Option<LossArg>,
    /// Former name of --loss
    #[arg(long, value_enum, value_name = "LOSS", hide = true, conflicts_with = "loss")]
    robust: Option<LossArg>,
    /// Leave out a topic and all below it, such as /nest or /measurement/verification; may be repeated
    #[arg(long, value_name = "TOPIC")]
    drop_topic: Vec<String>,
    /// The robot's file, instead of the recorded one
    #[arg(long, value_name = "ROBOT.toml")]
    model: Option<PathBuf>,
    /// Identify even if the nominal robot does not fit the points; ends with exit code 3
    #[arg(long)]
    fit_anyway: bool,
    /// Print the report as JSON (schema calibrig.report/1) instead of the tables
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    let options = ReplayOptions {
        modes: args.mode.clone(),
        loss: args.loss.or(args.robust).map(Into::into),
        dropped_topics: args.drop_topic.clone(),
        robot: args.model.as_deref().map(load_robot).transpose()?,
        fit_anyway: args.fit_anyway,
    };
    if args.robust.is_some() {
        say("--robust is now called --loss, as in identify and in scenarios");
    }
    let replayed = replay(&args.recording, &options).map_err(|error| failed(error, &args.recording))?;
    output::show(&replayed.outcome, args.json)?;
    let another = replayed.made_by_another.as_ref().filter(|_| !replayed.differences.is_empty());
    match another {
        Some(made_by) => {
            let Replayed { parameters, differences, changes, .. } = &replayed;
            let told = of_another_version(made_by, parameters, differences, changes);
            if args.json { say(told.trim_end()) } else { print(&told)? }
        }
        None => replayed.differences.iter().for_each(|difference| say(&describe(difference))),
    }
    if !args.json {
        print(&comparison(&replayed))?;
    }
    let mut verdict = output::verdict(&replayed.outcome);
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
    let as_expected = replayed.differences.is_empty() || another.is_some();
    Ok(if as_expected { verdict } else { Verdict::Doubtful })
}

/// The failure of a replay of `file`.
pub(super) fn failed(error: ReplayError, file: &Path) -> CliError {
    match error {
        // It names the file already.
        ReplayError::Recording(error @ RecordingError::Unreadable { .. }) => CliError::Recording(error),
        source => CliError::Replay { file: file.to_path_buf(), source },
    }
}

/// What no checksum protects.
pub(super) fn unnoticed(unprotected: &Unprotected) -> Option<String> {
    let messages = unprotected.messages;
    (unprotected.holds_data() && messages > 0).then(|| {
        format!("{messages} messages of the recording have no checksum: changes in them would go unnoticed")
    })
}

/// Warns that a set ends too early.
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
            "doubtful: the recording was cut short in the {kind} set, after {} observations",
            part.found
        ),
    }
}

/// What the replay says about the recorded estimates.
fn comparison(replayed: &Replayed) -> String {
    if replayed.what_if {
        return what_if(&replayed.changes);
    }
    match replayed.compared {
        _ if !replayed.differences.is_empty() => String::new(),
        0 => "Replay: nothing to compare with: the recording holds no estimate, or only part of what it was made from.\n"
            .to_owned(),
        1 => "Replay: 1 recorded estimate, identical bit for bit.\n".to_owned(),
        compared => format!("Replay: {compared} recorded estimates, all identical bit for bit.\n"),
    }
}

/// Smaller changes of a parameter, in standard deviations, are counted but not listed.
const LISTED: f64 = 0.0005;

/// Differences from another version: parameters in standard deviations, errors in mm.
fn of_another_version(
    made_by: &MadeBy,
    parameters: &[ParameterChange],
    differences: &[Difference],
    changes: &[Change],
) -> String {
    let this = MadeBy::this();
    let mut lines = vec![
        format!("Replay: the recorded estimates were made by another version ({made_by}; this is {this})."),
        "Differences, replayed minus recorded, parameters in standard deviations:".to_owned(),
    ];
    for mode in Mode::ALL {
        let changes: Vec<_> = parameters.iter().filter(|change| change.mode == mode).collect();
        if !changes.is_empty() {
            lines.extend(changes_of(mode, &changes));
        }
    }
    lines.extend(differences.iter().filter_map(|difference| match difference {
        Difference::Missing { mode } => Some(format!("  the recording holds no estimate of mode {mode}")),
        _ => None,
    }));
    lines.push(errors_beside("rms 3-D error, mm", changes));
    lines.join("\n")
}

fn changes_of(mode: Mode, changes: &[&ParameterChange]) -> Vec<String> {
    let lines: Vec<_> = changes.iter().filter_map(|change| line_of(change)).collect();
    let (count, small) = (changes.len(), changes.len() - lines.len());
    let s = if count == 1 { "" } else { "s" };
    let small = match small {
        0 => String::new(),
        _ => format!(", {small} of them by less than {LISTED} and with the same standard deviation"),
    };
    std::iter::once(format!("  {}: {count} parameter{s}{small}", mode.title())).chain(lines).collect()
}

/// `None` if the change is too small to be listed.
fn line_of(change: &ParameterChange) -> Option<String> {
    let name = &change.name;
    match (change.values, change.in_sigmas()) {
        ([Some(_), None], _) => Some(format!("    {name:<24} is no longer identified")),
        ([None, _], _) => Some(format!("    {name:<24} was not identified")),
        (_, Some(share)) if share.abs() < LISTED && !sigma_changed(change) => None,
        (_, Some(share)) => Some(format!("    {name:<24} {share:>+9.3}{}", sigmas(change))),
        (_, None) => Some(format!("    {name:<24} {:>9}{}", "-", sigmas(change))),
    }
}

/// Whether the standard deviation differs by more than a thousandth.
fn sigma_changed(change: &ParameterChange) -> bool {
    match change.sigmas {
        [Some(before), Some(now)] => !((now - before).abs() <= 1e-3 * before),
        [before, now] => before.is_some() != now.is_some(),
    }
}

fn sigmas(change: &ParameterChange) -> String {
    match change.sigmas {
        [Some(before), Some(now)] if sigma_changed(change) => {
            format!("   standard deviation {:+.1} %", 1e2 * (now / before - 1.0))
        }
        [Some(_), None] => "   no standard deviation any more".to_owned(),
        [None, Some(_)] => "   had no standard deviation".to_owned(),
        _ => String::new(),
    }
}

fn what_if(changes: &[Change]) -> String {
    errors_beside("What if: rms 3-D error, mm", changes)
}

fn errors_beside(title: &str, changes: &[Change]) -> String {
    let mut text = format!("{title}\n");
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_another_version_made_is_told_in_standard_deviations() {
        let change = |name: &str, values, sigmas| ParameterChange {
            mode: Mode::OnlyCalibration,
            name: name.to_owned(),
            values,
            sigmas,
        };
        let alike = [Some(1e-5); 2];
        let parameters = [
            change("delta_a2", [Some(1e-3), Some(1.02e-3)], alike),
            change("delta_a3", [Some(1e-3), Some(1e-3 + 1e-9)], alike),
            change("delta_a4", [Some(1e-3), Some(1e-3)], [Some(1e-5), Some(1.5e-5)]),
            change("delta_d5", [Some(1e-3), None], [Some(1e-5), None]),
            change("delta_d6", [None, Some(1e-3)], [None, Some(1e-5)]),
            change("delta_d7", [Some(1e-3), Some(2e-3)], [None, None]),
        ];
        let made_by = MadeBy { software: "calibrig 0.0.9".to_owned(), method: 1 };
        let differences = [Difference::Missing { mode: "extended" }];
        let changes = [Change {
            mode: Mode::OnlyCalibration,
            kind: crate::pipeline::SetKind::Verification,
            recorded: Some(1e-3),
            replayed: Some(1.1e-3),
        }];
        let text = of_another_version(&made_by, &parameters, &differences, &changes);
        for line in [
            "(calibrig 0.0.9, method 1; this is calibrig",
            "only calibration: 6 parameters, 1 of them by less than 0.0005",
            "delta_a2                    +2.000\n",
            "delta_a4                    +0.000   standard deviation +50.0 %\n",
            "delta_d5                 is no longer identified",
            "delta_d6                 was not identified",
            "delta_d7                         -\n",
            "the recording holds no estimate of mode extended",
            "1.0000     1.1000   +10.0 %",
        ] {
            assert!(text.contains(line), "{line:?} is not in\n{text}");
        }
        assert!(!text.contains("delta_a3"), "{text}");
    }
}
