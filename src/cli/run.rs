//! `calibrig run`.

use std::path::PathBuf;

use indicatif::{ProgressBar, ProgressStyle};

use super::output::{self, Files};
use super::{CliError, Verdict};
use crate::pipeline;
use crate::scenario::load_scenario;

/// Simulate a measuring session, identify in every mode, evaluate, record and report
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig run scenarios/paper.toml                 tables on the screen, files in a new folder under runs/
  calibrig run scenarios/paper.toml --out out       the same, files in out/ (written over if they exist)
  calibrig run scenarios/paper.toml --seed 7 --json  another draw of poses and noise, the report as JSON")]
pub(super) struct Args {
    /// The scenario file
    scenario: PathBuf,
    /// Folder for report.html, report.json, recording.mcap and recording.rrd; its files are written over [default: a new folder under runs/]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Seed of the random draws, instead of the scenario's
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Print the report as JSON (schema calibrig.report/1) instead of the tables
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    let scenario = load_scenario(&args.scenario)?;
    let seed = args.seed.unwrap_or(scenario.seed);
    let bar = ProgressBar::new(0);
    if let Ok(style) = ProgressStyle::with_template("simulating pose {pos}/{len} {bar:40} {elapsed}") {
        bar.set_style(style);
    }
    let outcome = pipeline::run(&scenario, seed, |done, total| {
        bar.set_length(total.into());
        bar.set_position(done.into());
    });
    bar.finish_and_clear();
    let outcome = outcome?;
    output::show(&outcome, args.json)?;
    let folder = output::folder(args.out.as_deref(), &scenario.name)?;
    output::write(&outcome, &folder, Files::ReportsAndRecordings)?;
    Ok(output::verdict(&outcome))
}
