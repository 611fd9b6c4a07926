//! `calibrig montecarlo`.

use std::fs::File;
use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressStyle};

use super::interrupt::stop_on_interrupt;
use super::output::{Destination, Files};
use super::{CliError, Verdict, not_identified, print, read_scenario, say};
use crate::montecarlo::{self, Campaign, Trial};
use crate::pipeline::{PlantKind, check_analytic};
use crate::scenario::Scenario;

/// Repeat a scenario with other draws, and see how accuracy and parameters scatter
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig montecarlo scenarios/paper.toml --trials 100             tables here, trials.csv and summary.json in a new folder under runs/
  calibrig montecarlo scenarios/paper.toml --trials 1 --first 42    trial 42 alone: the same bits as in a campaign
  calibrig montecarlo scenarios/matched.toml --trials 10000 --plant analytic --json

A trial is a pure function of scenario, seed and its number. Ctrl-C ends the campaign early and keeps what is done; a trial that fails is a
row with its reason. Exit code 3: interrupted, or a trial failed.")]
pub(super) struct Args {
    /// The scenario file
    scenario: PathBuf,
    /// Number of trials
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    trials: u32,
    /// Number of the first trial
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = trial_number())]
    first: u32,
    /// What stands for the machine: the multibody simulation, or the identification's own elastostatics (a matched model: for tests of the estimator)
    #[arg(long, value_enum, default_value_t = Plant::Rapier)]
    plant: Plant,
    /// Seed of the random draws, instead of the scenario's
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Threads; the result does not depend on them [default: one a core]
    #[arg(long, value_name = "N", default_value_t = 0, hide_default_value = true)]
    threads: u16,
    /// Folder for trials.csv and summary.json, which are written over [default: a new folder under runs/]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print the summary as JSON (schema calibrig.campaign/1) instead of the tables
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum Plant {
    Rapier,
    Analytic,
}

impl Plant {
    /// Refuses a machine that this plant cannot be, before anything is written.
    pub(super) fn check(self, scenario: &Scenario, file: &Path) -> Result<(), CliError> {
        let checked = if self == Self::Analytic { check_analytic(&scenario.as_built) } else { Ok(()) };
        checked.map_err(|error| not_identified(error, file, &scenario.sources[0].1, 0..0))
    }
}

impl From<Plant> for PlantKind {
    fn from(plant: Plant) -> Self {
        match plant {
            Plant::Rapier => Self::Rapier,
            Plant::Analytic => Self::Analytic,
        }
    }
}

/// Leaves room for the trials behind the first one.
pub(super) fn trial_number() -> clap::builder::RangedI64ValueParser<u32> {
    clap::value_parser!(u32).range(0..=4_000_000_000)
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    let scenario = read_scenario(&args.scenario)?;
    let name = format!("{}-montecarlo", scenario.name);
    let destination = args.out.as_deref().map_or(Destination::New(&name), Destination::Asked);
    destination.check(Files::Campaign)?;
    args.plant.check(&scenario, &args.scenario)?;
    scenario.remarks().iter().for_each(|remark| say(remark));
    let seed = args.seed.unwrap_or(scenario.seed);
    let campaign = Campaign { scenario: &scenario, seed, plant: args.plant.into() };
    let folder = destination.make()?.0;
    let mut table = Table::create(folder.join("trials.csv"), &campaign)?;

    let bar = ProgressBar::new(args.trials.into());
    if let Ok(style) = ProgressStyle::with_template("trial {pos}/{len} {bar:40} {elapsed}, {eta} to go") {
        bar.set_style(style);
    }
    let stop = stop_on_interrupt("the campaign without a summary");
    let range = args.first..args.first + args.trials;
    let trials = campaign
        .run(range, usize::from(args.threads), &stop, |trial| {
            table.write(&campaign, trial);
            bar.inc(1);
        })
        .map_err(|error| CliError::Threads { reason: error.to_string() })?;
    bar.finish_and_clear();
    table.finish()?;

    let summary = montecarlo::summarise(&campaign, &trials);
    let json = format!("{:#}\n", montecarlo::summary_json(&campaign, &summary));
    let path = folder.join("summary.json");
    std::fs::write(&path, &json)
        .map_err(|source| CliError::Output { what: path.display().to_string(), source })?;
    print(&if args.json { json } else { montecarlo::summary_text(&campaign, &summary) })?;
    say(&format!("wrote trials.csv, summary.json to {}", folder.display()));
    let missing = args.trials as usize - trials.len();
    if missing > 0 {
        say(&format!("doubtful: interrupted, {missing} of {} trials are not done", args.trials));
    }
    if !summary.failures.is_empty() {
        say(&format!(
            "doubtful: {} of {} trials failed, see trials.csv",
            summary.failures.len(),
            trials.len()
        ));
    }
    let sound = missing == 0 && summary.failures.is_empty();
    Ok(if sound { Verdict::Done } else { Verdict::Doubtful })
}

/// `trials.csv`, written trial by trial so that nothing done is lost.
struct Table {
    path: PathBuf,
    writer: csv::Writer<File>,
    failed: Option<std::io::Error>,
}

impl Table {
    fn create(path: PathBuf, campaign: &Campaign<'_>) -> Result<Self, CliError> {
        let failed = |source| CliError::Output { what: path.display().to_string(), source };
        let file = File::create(&path).map_err(failed)?;
        let mut table = Self { writer: csv::Writer::from_writer(file), failed: None, path };
        table.put(&montecarlo::header(campaign));
        Ok(table)
    }

    fn write(&mut self, campaign: &Campaign<'_>, trial: &Trial) {
        self.put(&montecarlo::row(campaign, trial));
    }

    /// Keeps the first failure for [`Self::finish`].
    fn put(&mut self, cells: &[String]) {
        if self.failed.is_none() {
            let written = self.writer.write_record(cells).map_err(std::io::Error::from);
            self.failed = written.and_then(|()| self.writer.flush()).err();
        }
    }

    fn finish(mut self) -> Result<(), CliError> {
        let result = match self.failed.take() {
            Some(error) => Err(error),
            None => self.writer.flush().and_then(|()| self.writer.get_ref().sync_all()),
        };
        result.map_err(|source| CliError::Output { what: self.path.display().to_string(), source })
    }
}
