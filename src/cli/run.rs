//! `calibrig run`.

use std::borrow::Cow;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use indicatif::{ProgressBar, ProgressStyle};

use super::interrupt::stop_on_interrupt;
use super::live::{self, Live};
use super::montecarlo::{Plant, campaign_of, refused};
use super::output::{self, Destination, Files};
use super::record::Recording;
use super::{CliError, Verdict, not_identified, read_scenario, say};
use crate::montecarlo::{Campaign, CampaignError};
use crate::pipeline::{self, Ablation, Outcome, PipelineError, SessionEvent};
use crate::scenario::{Layout, Scenario};
use calibrig_recording::Preamble;

/// Simulate a measuring session, identify in every mode, evaluate, record and report
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig run scenarios/paper.toml                   tables here, files in a new folder under runs/
  calibrig run scenarios/paper.toml --out out         the same, files in out/, which are overwritten
  calibrig run scenarios/paper.toml --seed 7 --json   other poses and noise, the report as JSON
  calibrig run scenarios/paper.toml --trial 42        trial 42 of `calibrig montecarlo` with the same scenario and seed
  calibrig run scenarios/paper.toml --ablate          also shows what each part of the machine contributes
  calibrig run scenarios/paper.toml --live            shown in an open Rerun viewer while it goes on")]
pub(super) struct Args {
    /// The scenario file
    scenario: PathBuf,
    /// Folder for report.html, report.json, residuals.csv, recording.mcap and recording.rrd, which are overwritten [default: a new folder under
    /// runs/]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Seed of the random draws, instead of the scenario's
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = whole_number)]
    seed: Option<u64>,
    /// Number of a campaign's trial, such as 42
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(0..=4_000_000_000), conflicts_with = "ablate")]
    trial: Option<u64>,
    /// Number of trials of that campaign, if its layout depends on it: the --trials of `calibrig montecarlo`
    #[arg(long, value_name = "N", requires = "trial", value_parser = clap::value_parser!(u64).range(1..=4_000_000_000))]
    trials: Option<u64>,
    /// Model of the machine: the multibody simulation, or the identification's own elastostatics (a matched model, for tests of the estimator)
    #[arg(long, value_enum, default_value_t = Plant::Rapier, conflicts_with = "ablate")]
    plant: Plant,
    /// Repeat the run without one part of the machine at a time, and report what each contributes
    #[arg(long)]
    ablate: bool,
    /// Show the run in an open Rerun viewer while it goes on [URL, if it is not on this machine: `rerun+http://HOST:9876/proxy`]
    #[arg(long, value_name = "URL", num_args = 0..=1, require_equals = true, default_missing_value = live::HERE, value_parser = live::address)]
    live: Option<String>,
    /// Print the report as JSON (schema calibrig.report/1) instead of the tables
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    let scenario = read_scenario(&args.scenario)?;
    let destination = args.out.as_deref().map_or(Destination::New(&scenario.name), Destination::Asked);
    destination.check(Files::ReportsAndRecordings)?;
    args.plant.check(&scenario, &args.scenario)?;
    scenario.remarks().iter().for_each(|remark| say(remark));
    let seed = args.seed.unwrap_or(scenario.seed);
    let (case, draw) = args.case(&scenario, seed)?;
    let (folder, new) = destination.make()?;
    output::or_removed(run_into(args, &case, (seed, draw), &folder), &folder, new)
}

impl Args {
    /// What is run: the scenario as it is, or a trial of its campaign; and the number of the draw.
    fn case<'a>(&self, scenario: &'a Scenario, seed: u64) -> Result<(Cow<'a, Scenario>, u32), CliError> {
        let Some(trial) = self.trial else { return Ok((Cow::Borrowed(scenario), 0)) };
        let plant = self.plant.into();
        let campaign = match (&scenario.campaign, self.trials) {
            (Some(plan), trials) if plan.layout != Layout::Plain => {
                campaign_of(scenario, seed, plant, trials)?
            }
            _ => Campaign::of_draws(scenario, seed, plant),
        };
        let case = campaign
            .case(trial)
            .map_err(|source| refused(&CampaignError::Trial { trial, source }, scenario))?;
        Ok((case.scenario, case.draw))
    }
}

fn run_into(
    args: &Args,
    scenario: &Scenario,
    (seed, draw): (u64, u32),
    folder: &Path,
) -> Result<Verdict, CliError> {
    let mut input = pipeline::input_of(scenario, seed, draw, args.plant.into());
    if let Some(trial) = args.trial.filter(|trial| *trial > 0) {
        // Its number in the campaign, which in some designs differs from that of its draw.
        input.name = format!("{}, trial {trial}", scenario.name);
    }
    let preamble = Preamble {
        input: &input,
        sources: &scenario.sources,
        model: &scenario.robot.model,
        visuals: &scenario.robot.visuals,
        truth: None,
    };
    let mut live = Live::begin(args.live.as_deref(), preamble)?;
    let mut recording = Recording::begin(folder, preamble)?;
    let outcome = measure(args, scenario, (seed, draw), &mut |event| {
        recording.hear(event);
        live.hear(event);
    });
    let mut outcome = match outcome {
        Ok(outcome) => outcome,
        Err(PipelineError::Interrupted { done, total }) => {
            return Err(CliError::Interrupted { done, total, part: recording.abandon() });
        }
        Err(error) => {
            recording.discard();
            let source = &scenario.sources[0].1;
            let place = source.place_of("poses.identification");
            return Err(not_identified(error, &args.scenario, source, place));
        }
    };
    outcome.command = Some(output::command_line());
    if args.trial.is_some() {
        outcome.input.name.clone_from(&input.name);
    }
    let complete: output::Complete<'_> = if args.ablate {
        // Before the runs without a part, so that an interrupt of those leaves a complete recording.
        let completed = recording.complete(&outcome);
        outcome.ablation = Some(ablate(scenario, seed, &outcome));
        Box::new(|| completed)
    } else {
        Box::new(|| recording.complete(&outcome))
    };
    // Before the tables, so that a reader of only their first lines gets the files. A file that cannot be written does not keep the
    // tables back.
    let written = output::write(&outcome, folder, Some(complete));
    let shown = output::show(&outcome, args.json);
    live.complete(&outcome);
    shown?;
    written?;
    Ok(output::verdict(&outcome))
}

/// The run, reported to `listener` while it is measured. The first interrupt ends the session; later ones end the
/// process.
fn measure(
    args: &Args,
    scenario: &Scenario,
    (seed, draw): (u64, u32),
    listener: &mut dyn FnMut(SessionEvent<'_>),
) -> Result<Outcome, PipelineError> {
    let stop = stop_on_interrupt("the run, and leave the measurements so far as a file to recover");
    let bar = ProgressBar::new(0);
    if let Ok(style) = ProgressStyle::with_template("simulating pose {pos}/{len} {bar:40} {elapsed}") {
        bar.set_style(style);
    }
    let at = (seed, draw, args.plant.into());
    let outcome = pipeline::run_trial(scenario, seed, draw, args.plant.into(), &mut |event| {
        listener(event);
        match event {
            SessionEvent::Begin { poses, .. } => bar.set_length(poses.into()),
            SessionEvent::Measured(_) | SessionEvent::Dropped { .. } => bar.inc(1),
            SessionEvent::Set { .. } | SessionEvent::SetEnd { .. } => {}
        }
        if stop.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    let outcome = outcome.map(|mut outcome| {
        if let Ok(style) =
            ProgressStyle::with_template("driving corrected pose {pos}/{len} {bar:40} {elapsed}")
        {
            bar.set_style(style);
        }
        outcome.closed_loop = pipeline::close_loop(scenario, at, &outcome, &mut |done, total| {
            bar.set_length(total.into());
            bar.set_position(done.into());
            if stop.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        outcome
    });
    // From here on there is nothing to close: the next Ctrl-C ends the process.
    stop.store(true, Ordering::Relaxed);
    bar.finish_and_clear();
    outcome
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
