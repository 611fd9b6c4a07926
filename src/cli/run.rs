//! `calibrig run`.

use std::path::PathBuf;

use indicatif::{ProgressBar, ProgressStyle};

use super::montecarlo::{Plant, trial_number};
use super::output::{self, Destination, Files};
use super::{CliError, Verdict, not_identified};
use crate::pipeline::{self, Ablation, Outcome};
use crate::scenario::{Scenario, load_scenario};

/// Simulate a measuring session, identify in every mode, evaluate, record and report
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig run scenarios/paper.toml                   tables here, files in a new folder under runs/
  calibrig run scenarios/paper.toml --out out         the same, files in out/, written over
  calibrig run scenarios/paper.toml --seed 7 --json   other poses and noise, the report as JSON
  calibrig run scenarios/paper.toml --trial 42        trial 42 of `calibrig montecarlo` with the same scenario and seed
  calibrig run scenarios/paper.toml --ablate          and what each part of the machine contributes")]
pub(super) struct Args {
    /// The scenario file
    scenario: PathBuf,
    /// Folder for report.html, report.json, recording.mcap and recording.rrd; its files are written over [default: a new folder under runs/]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Seed of the random draws, instead of the scenario's
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = whole_number)]
    seed: Option<u64>,
    /// Number of the trial of a campaign
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = trial_number(), conflicts_with = "ablate")]
    trial: u32,
    /// What stands for the machine: the multibody simulation, or the identification's own elastostatics (a matched model: for tests of the estimator)
    #[arg(long, value_enum, default_value_t = Plant::Rapier, conflicts_with = "ablate")]
    plant: Plant,
    /// Repeat the run without one part of the machine at a time, and tell what each contributes
    #[arg(long)]
    ablate: bool,
    /// Print the report as JSON (schema calibrig.report/1) instead of the tables
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    let scenario = load_scenario(&args.scenario)?;
    let destination = args.out.as_deref().map_or(Destination::New(&scenario.name), Destination::Asked);
    destination.check(Files::ReportsAndRecordings)?;
    let seed = args.seed.unwrap_or(scenario.seed);
    let bar = ProgressBar::new(0);
    if let Ok(style) = ProgressStyle::with_template("simulating pose {pos}/{len} {bar:40} {elapsed}") {
        bar.set_style(style);
    }
    let outcome = pipeline::run_trial(&scenario, seed, args.trial, args.plant.into(), |done, total| {
        bar.set_length(total.into());
        bar.set_position(done.into());
    });
    bar.finish_and_clear();
    let mut outcome = outcome.map_err(|error| {
        let source = &scenario.sources[0].1;
        not_identified(error, &args.scenario, source, source.place_of("poses.identification"))
    })?;
    if args.ablate {
        outcome.ablation = Some(ablate(&scenario, seed, &outcome));
    }
    // Before the tables: whoever reads only their first lines gets the files.
    output::write(&outcome, destination, Files::ReportsAndRecordings)?;
    output::show(&outcome, args.json)?;
    Ok(output::verdict(&outcome))
}

fn ablate(scenario: &Scenario, seed: u64, outcome: &Outcome) -> Ablation {
    let bar = ProgressBar::new(0);
    if let Ok(style) = ProgressStyle::with_template("run {pos}/{len} without {msg} {bar:40} {elapsed}") {
        bar.set_style(style);
    }
    let ablation = pipeline::ablate(scenario, seed, outcome, |done, runs, part| {
        bar.set_length(runs as u64);
        bar.set_position(done as u64);
        bar.set_message(part.title());
    });
    bar.finish_and_clear();
    ablation
}

fn whole_number(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_| format!("expected a whole number from 0 to {}", u64::MAX))
}
