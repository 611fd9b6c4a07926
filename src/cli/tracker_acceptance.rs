//! `calibrig tracker-acceptance`.

use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressStyle};

use super::output::{Destination, Files};
use super::{CliError, Verdict, print, read_scenario, say};
use crate::pipeline::{AcceptanceOutcome, TestedKind, test_instruments};
use crate::report::{acceptance_html, acceptance_json, acceptance_svg, acceptance_text};
use calibrig_files::InputError;

/// Test a virtual laser tracker as a manufacturer does: reference lengths, two faces, ranging, against its permissible
/// errors
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig tracker-acceptance at500                                 one instrument: the table of its largest errors
  calibrig tracker-acceptance scenarios/paper.toml --out acceptance  the same for the scenario's instrument, with a picture
  calibrig tracker-acceptance vantage --instruments 300 --json      how many of 300 pass

The test is in the style of ASME B89.4.19, but does not follow its text. An instrument is a function of the seed and its number. A scenario's
session draws again if an instrument fails; this command does not. Exit code 3: the single instrument fails; with several it is 0.")]
pub(super) struct Args {
    /// The scenario file, or a preset: at500, at960, vantage or gts3800
    #[arg(value_name = "SCENARIO|PRESET")]
    kind: PathBuf,
    /// Number of instruments
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    instruments: u32,
    /// Seed of the random draws [default: the scenario's, or 1 of a preset]
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    /// Print as JSON (schema calibrig.acceptance/1)
    #[arg(long)]
    json: bool,
    /// Folder for acceptance.html, acceptance.svg and acceptance.json, which are overwritten
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    if let Some(out) = &args.out {
        Destination::Asked(out).check(Files::Acceptance)?;
    }
    let (kind, seed) = kind_of(&args.kind)?;
    let bar = ProgressBar::new(args.instruments.into());
    if let Ok(style) = ProgressStyle::with_template("instrument {pos}/{len} {bar:40} {elapsed}, {eta} to go")
    {
        bar.set_style(style);
    }
    let outcome = test_instruments(kind, args.seed.unwrap_or(seed), args.instruments, || bar.inc(1));
    bar.finish_and_clear();
    let outcome = outcome.map_err(|source| CliError::Pipeline { file: args.kind.clone(), source })?;
    let json = format!("{:#}\n", acceptance_json(&outcome));
    if let Some(out) = &args.out {
        write(&outcome, &json, out)?;
    }
    print(&if args.json { json } else { acceptance_text(&outcome) })?;
    if outcome.instruments == 1 && outcome.passed == 0 {
        say("doubtful: the instrument does not pass its acceptance test");
        return Ok(Verdict::Doubtful);
    }
    Ok(Verdict::Done)
}

/// The instrument that an argument names, and the seed that goes with it.
fn kind_of(name: &Path) -> Result<(TestedKind, u64), CliError> {
    if let Some(kind) = name.to_str().and_then(TestedKind::of_preset) {
        return Ok((kind, 1));
    }
    if !name.exists() {
        let names = TestedKind::preset_names().join(", ");
        return Err(InputError::Place {
            place: name.display().to_string(),
            message: "there is no file and no preset of this name".to_owned(),
            help: Some(format!("expected a scenario file, or one of: {names}")),
        }
        .into());
    }
    let scenario = read_scenario(name)?;
    Ok((TestedKind::of_scenario(&scenario), scenario.seed))
}

fn write(outcome: &AcceptanceOutcome, json: &str, out: &Path) -> Result<(), CliError> {
    let folder = Destination::Asked(out).make()?.0;
    let texts = [acceptance_html(outcome)?, acceptance_svg(outcome)?, json.to_owned()];
    for (name, text) in Files::Acceptance.names().iter().zip(texts) {
        let path = folder.join(name);
        std::fs::write(&path, text)
            .map_err(|source| CliError::Output { what: path.display().to_string(), source })?;
    }
    say(&format!("wrote {} to {}", Files::Acceptance.names().join(", "), folder.display()));
    Ok(())
}
