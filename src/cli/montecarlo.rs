//! `calibrig montecarlo`.

use std::fs::{File, OpenOptions};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use calibrig_campaign::plan::{JobPlan, LOGS, Scheduler};
use calibrig_campaign::shards::{Folder, FolderError, MOST_SHARDS, Manifest};
use calibrig_campaign::table::{TableReader, TableWriter};
use indicatif::{ProgressBar, ProgressStyle};

use super::campaign::{self, Answers};
use super::interrupt::stop_on_interrupt;
use super::output::{Destination, Files};
use super::{CliError, Verdict, not_identified, read_scenario, say, write_whole};
use crate::montecarlo::{Campaign, CampaignError, CaseError, Trial, TrialColumns};
use crate::pipeline::{PlantKind, check_analytic};
use crate::report::quoted;
use crate::scenario::{Layout, Scenario};

/// Repeat a scenario with other random draws, and see how accuracy and parameters scatter
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig montecarlo scenarios/paper.toml --trials 100             tables here; table, summary and report in a new folder under runs/
  calibrig montecarlo scenarios/matched.toml --trials 10000 --plant analytic --tolerance 0.2mm
  calibrig montecarlo scenarios/paper.toml --trials 10000 --out out --resume       continues an interrupted campaign
  calibrig montecarlo scenarios/paper.toml --trials 10000 --out out --shard 3/40   one part of forty; `calibrig merge out` joins them
  calibrig montecarlo scenarios/paper.toml --trials 10000 --out out --shards 40 --plan slurm   job files for a cluster

The scenario's section [campaign] states what varies and how trials are laid out (docs/formats.md); without it, only the random draws differ.
A trial is a pure function of scenario, seed and its number: the same bits alone, on any number of threads and in any shards. Ctrl-C ends the
campaign when the running trials are done, and keeps them. A failed trial is a row with its reason. Exit code 3: interrupted, or a trial failed
(a shard with failed trials ends with 0).")]
pub(super) struct Args {
    /// The scenario file
    scenario: PathBuf,
    /// Number of trials [default: as the section campaign states; 100 without it]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=4_000_000_000))]
    trials: Option<u64>,
    /// Number of the first trial; only without [campaign], or with its design "plain"
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u64).range(0..=4_000_000_000))]
    first: u64,
    /// Model of the machine: the multibody simulation, or the identification's own elastostatics (a matched model, for tests of the estimator)
    #[arg(long, value_enum, default_value_t = Plant::Rapier)]
    plant: Plant,
    /// Seed of the random draws, instead of the scenario's
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Number of threads; the result does not depend on it [default: one per core]
    #[arg(long, value_name = "N", default_value_t = 0, hide_default_value = true)]
    threads: u16,
    /// Folder for trials.parquet, summary.json, report.html and timings.csv [default: a new folder under runs/]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Continue the campaign in --out
    #[arg(long, requires = "out", conflicts_with_all = ["shard", "plan"])]
    resume: bool,
    /// Carry out only shard I of N (I from 0), such as 3/40; its saved trials are kept
    #[arg(long, value_name = "I/N", requires = "out", value_parser = shard)]
    shard: Option<(u32, u32)>,
    /// Write the job file of a scheduler for --shards parts into --out, and print the next commands; no trial is run
    #[arg(long, value_name = "SCHEDULER", requires = "out", requires = "shards", conflicts_with = "shard")]
    plan: Option<PlanFor>,
    /// Number of parts, such as 40, for which --plan writes jobs
    #[arg(long, value_name = "N", requires = "plan", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    shards: Option<u32>,
    #[command(flatten)]
    answers: Answers,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum Plant {
    Rapier,
    Analytic,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum PlanFor {
    Slurm,
    Hyperqueue,
    Kubernetes,
}

impl From<PlanFor> for Scheduler {
    fn from(plan: PlanFor) -> Self {
        match plan {
            PlanFor::Slurm => Self::Slurm,
            PlanFor::Hyperqueue => Self::HyperQueue,
            PlanFor::Kubernetes => Self::Kubernetes,
        }
    }
}

impl Plant {
    /// Refuses a machine that this plant cannot simulate, before anything is written.
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

/// `3/40`.
fn shard(text: &str) -> Result<(u32, u32), String> {
    let expected = "expected I/N with I from 0 and below N, such as 0/40";
    let (number, shards) = text.split_once('/').ok_or(expected)?;
    match (number.parse(), shards.parse()) {
        (Ok(number), Ok(shards)) if number < shards && shards <= MOST_SHARDS => Ok((number, shards)),
        (Ok(number), Ok(shards)) if number < shards => {
            Err(format!("{shards} shards are too many: at most {MOST_SHARDS}"))
        }
        (Ok(number), Ok(shards)) if shards > 0 => {
            Err(format!("there is no shard {number} of {shards}: the last one is {}", shards - 1_u32))
        }
        _ => Err(expected.to_owned()),
    }
}

/// A campaign of the scenario, as laid out there, with another number of trials if one is given.
pub(super) fn campaign_of(
    scenario: &Scenario,
    seed: u64,
    plant: PlantKind,
    trials: Option<u64>,
) -> Result<Campaign<'_>, CliError> {
    Campaign::new(scenario, seed, plant, trials).map_err(|expected| CliError::Flag {
        flag: "trials",
        message: format!("{} does not fit the [campaign] of the scenario", trials.unwrap_or(0)),
        expected,
    })
}

/// What is wrong with a trial's factors, at its place in the scenario's text if it has one.
pub(super) fn refused(error: &CampaignError, scenario: &Scenario) -> CliError {
    let help = match error {
        CampaignError::TooManyMachines { .. } => {
            "expected [as_built.drawn] such that nine of ten drawn machines are possible: reduce linkage_mm, \
             linkage_angles_mrad, crank_axis_mm or crank_tilts_mrad"
        }
        CampaignError::Trial { source: CaseError::Refused { .. }, .. } => {
            "expected [[campaign.factor]] with values that are all possible: this design cannot draw them again"
        }
        CampaignError::Trial { source: CaseError::Impossible { .. }, .. }
        | CampaignError::TooManyRefused { .. } => {
            "expected [[campaign.factor]] with values that are possible in nine of ten trials; impossible ones are drawn again"
        }
        CampaignError::Trial { .. } => "expected a trial number below the number of trials of the [campaign]",
    };
    let source = &scenario.sources[0].1;
    let place = source.places_of("campaign").into_iter().next().unwrap_or(0..0);
    source.error(place, format!("campaign: {error}"), Some(help.to_owned())).into()
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    let scenario = read_scenario(&args.scenario)?;
    let name = format!("{}-montecarlo", scenario.name);
    let destination = args.out.as_deref().map_or(Destination::New(&name), Destination::Asked);
    destination.check(Files::Campaign)?;
    args.plant.check(&scenario, &args.scenario)?;
    scenario.remarks().iter().for_each(|remark| say(remark));
    let seed = args.seed.unwrap_or(scenario.seed);
    let (campaign, range) = args.campaign(&scenario, seed)?;
    campaign.check().map_err(|error| refused(&error, &scenario))?;
    let columns = TrialColumns::of(&campaign);
    let shards = args.shards.or(args.shard.map(|(_, shards)| shards)).unwrap_or(1);
    let scenario_name = args.scenario.display().to_string();
    let manifest = campaign::manifest(&campaign, &columns, &scenario_name, (range, shards))?;
    let work = Work { args, campaign: &campaign, columns: &columns };
    match (args.plan, args.shard) {
        (Some(plan), _) => work.plan(plan.into(), &manifest),
        (None, Some((shard, _))) => work.shard(&manifest, shard),
        (None, None) => work.whole(&manifest, destination),
    }
}

impl Args {
    /// The campaign, and which of its trials are carried out.
    fn campaign<'a>(
        &self,
        scenario: &'a Scenario,
        seed: u64,
    ) -> Result<(Campaign<'a>, Range<u64>), CliError> {
        let campaign = campaign_of(scenario, seed, self.plant.into(), self.trials)?;
        let trials = campaign.design.trials();
        if self.first == 0 {
            return Ok((campaign, 0..trials));
        }
        let end = self.first.saturating_add(trials);
        let flag = |message: &str, expected: &str| CliError::Flag {
            flag: "first",
            message: message.to_owned(),
            expected: expected.to_owned(),
        };
        if scenario.campaign.as_ref().is_some_and(|plan| plan.layout != Layout::Plain) {
            return Err(flag(
                "applies to a plain campaign, but the scenario's [campaign] has another design",
                "to leave --first out; `calibrig run SCENARIO --trial N` carries out a single trial",
            ));
        }
        let whole = campaign_of(scenario, seed, self.plant.into(), Some(end))
            .map_err(|_| flag("and --trials go beyond the last possible draw", "trials below 2^32"))?;
        Ok((whole, self.first..end))
    }

    /// What determines the campaign besides scenario and trials.
    fn further(&self) -> Vec<String> {
        let mut words = vec!["--plant".to_owned(), PlantKind::from(self.plant).key().to_owned()];
        if let Some(seed) = self.seed {
            words.extend(["--seed".to_owned(), seed.to_string()]);
        }
        if self.first > 0 {
            words.extend(["--first".to_owned(), self.first.to_string()]);
        }
        words
    }
}

/// What is to be done.
struct Work<'a> {
    args: &'a Args,
    campaign: &'a Campaign<'a>,
    columns: &'a TrialColumns,
}

impl Work<'_> {
    /// All trials on this machine.
    fn whole(&self, manifest: &Manifest, destination: Destination<'_>) -> Result<Verdict, CliError> {
        if let Destination::Asked(path) = destination {
            match (Folder::is_begun(path), self.args.resume) {
                (true, false) => return Err(CliError::CampaignThere { path: path.to_path_buf() }),
                (false, true) => return Err(FolderError::NoCampaign { path: path.to_path_buf() }.into()),
                _ => {}
            }
            let table = path.join("trials.parquet");
            if table.exists() && !Folder::is_begun(path) {
                return Err(CliError::NamedAlready { path: table });
            }
        }
        let path = destination.make()?.0;
        let folder = Folder::begin(&path, manifest)?;
        if folder.is_complete() {
            say(&format!("all {} trials are there already", folder.manifest().trials));
        } else {
            campaign::tell_unsound(&folder);
            let all = folder.manifest().range();
            let missing = self.carry_out(&folder, &all, path.join("timings.csv"))?;
            if missing > 0 && !folder.is_complete() {
                return self.interrupted(&folder, missing);
            }
            if !folder.is_complete() {
                campaign::with_rows("building the table", &folder, |progress| folder.complete(progress))?;
            }
        }
        campaign::conclude(&folder, &self.args.answers, "trials.parquet")
    }

    /// One shard.
    fn shard(&self, manifest: &Manifest, shard: u32) -> Result<Verdict, CliError> {
        let path = self.args.out.as_deref().unwrap_or(Path::new("."));
        let folder = Folder::begin(path, manifest)?;
        let (range, shards) = (folder.manifest().range_of(shard), folder.manifest().shards);
        if folder.has_shard(shard)? {
            say(&format!("shard {shard} of {shards} is complete and sound: nothing to do"));
            return Ok(Verdict::Done);
        }
        let timings = path.join("shards").join(format!("{shard:06}-of-{shards:06}.timings.csv"));
        let missing = self.carry_out(&folder, &range, timings);
        if folder.has_shard(shard)? {
            say(&format!("another process has completed shard {shard} of {shards} in the meantime"));
            return Ok(Verdict::Done);
        }
        let missing = missing?;
        if missing > 0 {
            say(&format!(
                "interrupted: {missing} trials of shard {shard} of {shards} are missing; repeat the command to continue"
            ));
            return Ok(Verdict::Doubtful);
        }
        let file = folder.complete_shard(shard)?;
        let trials = match range.end.checked_sub(1).filter(|last| *last >= range.start) {
            Some(last) => format!("trials {} to {last}", range.start),
            None => "which holds no trial: there are more shards than trials".to_owned(),
        };
        say(&format!("wrote shard {shard} of {shards}, {trials}, to {}", file.display()));
        Ok(Verdict::Done)
    }

    /// Job files.
    fn plan(&self, scheduler: Scheduler, manifest: &Manifest) -> Result<Verdict, CliError> {
        let failed = |what: &Path| {
            let what = what.display().to_string();
            move |source| CliError::Output { what, source }
        };
        let out = self.args.out.as_deref().unwrap_or(Path::new("."));
        let program = std::env::current_exe().map_err(failed(Path::new("the path of this program")))?;
        let here = std::env::current_dir().map_err(failed(Path::new("this folder")))?;
        let trials = manifest.trials;
        Folder::begin(out, manifest)?;
        let out = out.canonicalize().map_err(failed(out))?;
        let plan = JobPlan {
            program,
            folder: here,
            scenario: self.args.scenario.clone(),
            trials,
            arguments: self.args.further(),
            threads: self.args.threads.max(1),
            shards: manifest.shards,
            out: out.clone(),
        };
        let text = plan.job_file(scheduler)?;
        let commands = plan.commands(scheduler)?;
        let logs = out.join(LOGS);
        std::fs::create_dir_all(&logs).map_err(failed(&logs))?;
        let file = out.join(scheduler.file_name());
        write_whole(&out, &file, &text).map_err(failed(&file))?;
        say(&format!("wrote manifest.json and {} to {}", scheduler.file_name(), out.display()));
        super::print(&format!(
            "run the shards:      {}\nwhat is missing:     {}\nrun it again:        {}\njoin the shards:     {}\n",
            commands.submit, commands.missing, commands.again, commands.merge
        ))?;
        Ok(Verdict::Done)
    }

    /// Carries out the missing trials of `range`, and says how many are still missing.
    fn carry_out(&self, folder: &Folder, range: &Range<u64>, timings: PathBuf) -> Result<u64, CliError> {
        let covered = folder.covered(range);
        let bar = ProgressBar::new(range.end - range.start);
        let style = "trial {pos}/{len} {bar:40} {per_sec}, {elapsed}, {eta} to go";
        if let Ok(style) = ProgressStyle::with_template(style) {
            bar.set_style(style);
        }
        if covered.done() > 0 {
            say(&format!("{} of {} trials are done already", covered.done(), range.end - range.start));
            bar.set_position(covered.done());
            bar.reset_eta();
        }
        let stop = stop_on_interrupt("the campaign; --resume continues it");
        let mut parts = Parts::new(folder, self.columns, timings)?;
        // Only for the side file.
        #[allow(clippy::disallowed_methods)]
        let begun = Instant::now();
        let clock = move || begun.elapsed().as_secs_f64();
        let threads = usize::from(self.args.threads);
        self.campaign
            .run(covered.missing().into_iter().flatten(), threads, &stop, &clock, |trial, seconds| {
                bar.inc(1);
                parts.take(&trial, seconds)
            })
            .map_err(|error| CliError::Threads { reason: error.to_string() })?;
        bar.finish_and_clear();
        parts.finish()?;
        let missing = folder.covered(range).missing();
        Ok(missing.iter().map(|range| range.end - range.start).sum())
    }

    /// What is done so far, and how to continue.
    fn interrupted(&self, folder: &Folder, missing: u64) -> Result<Verdict, CliError> {
        if let Some(table) = folder.so_far()? {
            let reader = TableReader::open(table.path()).map_err(FolderError::from)?;
            campaign::show(folder, &reader, &self.args.answers)?;
        }
        let trials = folder.manifest().trials;
        say(&format!(
            "doubtful: interrupted, {missing} of {trials} trials are missing; those that are done are kept in {}. To \
             continue:\n  calibrig montecarlo {} --trials {trials} {} --out {} --resume",
            folder.path().join("parts").display(),
            quoted(&self.args.scenario.display().to_string()),
            self.args.further().join(" "),
            quoted(&folder.path().display().to_string()),
        ));
        Ok(Verdict::Doubtful)
    }
}

/// How long rows are held before they are written: briefly at first, so that a short campaign loses little, and longer the more there
/// are.
const FIRST_PART: Duration = Duration::from_millis(500);
const LONGEST_PART: Duration = Duration::from_secs(32);
/// Most rows that are held.
const LARGEST_PART: u64 = 8192;

/// Writes what is done, part by part, so that little is lost if the process is killed.
struct Parts<'a> {
    folder: &'a Folder,
    columns: &'a TrialColumns,
    open: Option<(Range<u64>, TableWriter)>,
    since: Instant,
    hold: Duration,
    timings: csv::Writer<File>,
    timings_path: PathBuf,
    failed: Option<CliError>,
}

impl<'a> Parts<'a> {
    fn new(folder: &'a Folder, columns: &'a TrialColumns, timings_path: PathBuf) -> Result<Self, CliError> {
        let failed = |source| CliError::Output { what: timings_path.display().to_string(), source };
        if let Some(folder) = timings_path.parent() {
            std::fs::create_dir_all(folder).map_err(failed)?;
        }
        let is_new = !timings_path.exists();
        let file = OpenOptions::new().create(true).append(true).open(&timings_path).map_err(failed)?;
        let mut timings = csv::Writer::from_writer(file);
        if is_new {
            timings.write_record(["trial", "seconds"]).map_err(std::io::Error::from).map_err(failed)?;
        }
        // By the wall clock: no row depends on it.
        #[allow(clippy::disallowed_methods)]
        let since = Instant::now();
        Ok(Self { folder, columns, open: None, since, hold: FIRST_PART, timings, timings_path, failed: None })
    }

    /// Takes a trial; says whether to continue. The first failure is kept for [`Self::finish`].
    fn take(&mut self, trial: &Trial, seconds: f64) -> bool {
        let taken = self.add(trial, seconds);
        self.failed = self.failed.take().or(taken.err());
        self.failed.is_none()
    }

    fn add(&mut self, trial: &Trial, seconds: f64) -> Result<(), CliError> {
        if self.open.as_ref().is_some_and(|(range, _)| range.end != trial.index) {
            self.put()?;
        }
        let (range, part) = match &mut self.open {
            Some(open) => open,
            None => self.open.insert((trial.index..trial.index, self.folder.begin_part()?)),
        };
        part.push(&self.columns.row(trial)).map_err(FolderError::from)?;
        range.end += 1;
        let full = range.end - range.start >= LARGEST_PART;
        let entry = [trial.index.to_string(), format!("{seconds:.6}")];
        self.timings.write_record(entry).map_err(|error| self.not_timed(error.into()))?;
        if full || self.since.elapsed() >= self.hold { self.put() } else { Ok(()) }
    }

    fn not_timed(&self, source: std::io::Error) -> CliError {
        CliError::Output { what: self.timings_path.display().to_string(), source }
    }

    fn put(&mut self) -> Result<(), CliError> {
        if let Some((range, part)) = self.open.take() {
            self.folder.put_part(&range, part)?;
            self.timings.flush().map_err(|error| self.not_timed(error))?;
        }
        #[allow(clippy::disallowed_methods)]
        {
            self.since = Instant::now();
        }
        self.hold = (2 * self.hold).min(LONGEST_PART);
        Ok(())
    }

    fn finish(mut self) -> Result<(), CliError> {
        if let Some(failed) = self.failed.take() {
            return Err(failed);
        }
        self.put()
    }
}
