//! Campaigns: many trials of one scenario, to see how estimates scatter and whether their stated uncertainty is right.
//!
//! A trial is a pure function of (scenario, seed, number): the same bits alone or in a campaign, whatever the number of threads, machines and parts.
//! A trial is a row of a table ([`TrialColumns`]), and the summary ([`summarise`]) uses only the table: rows in memory, of one machine, or of many
//! machines' shards.

mod columns;
mod study;
mod summary;
mod trial;

pub use columns::TrialColumns;
pub use study::{Study, StudyMode};
pub use summary::{
    BAND, CampaignSummary, FactorEffect, GroupSummary, MeanWithInterval, ModeSummary, NeesSummary,
    ParameterSummary, PredictionCoverage, Rate, Reason, Sensitivity, SetSummary, Subject, SummaryError,
    Worst, summarise, summarise_trials, summary_json, summary_text,
};
pub(crate) use summary::{decimals, with_interval};
pub use trial::{AccuracySet, FitResult, ModeResult, ParameterResult, Trial, TrialOutcome};

use std::borrow::Cow;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, PoisonError, mpsc};

use calibrig_campaign::design::Design;
use miette::Diagnostic;
use rayon::iter::{ParallelBridge, ParallelIterator};
use thiserror::Error;

use crate::pipeline::PlantKind;
use crate::scenario::Scenario;

/// What all trials have in common.
#[derive(Debug, Clone)]
pub struct Campaign<'a> {
    /// The truth, how it is measured and how it is identified.
    pub scenario: &'a Scenario,
    /// Key of all random streams.
    pub seed: u64,
    /// Model of the machine.
    pub plant: PlantKind,
    /// Which point of the study a trial is.
    pub design: Design,
}

/// A trial before it is carried out.
#[derive(Debug, Clone)]
pub struct Case<'a> {
    /// The scenario with the values of its factors.
    pub scenario: Cow<'a, Scenario>,
    /// Number of the draw, which keys the random streams.
    pub draw: u32,
    /// Of the factors, as TOML has them.
    pub values: Vec<String>,
    /// How often factors or machine were drawn again because the draw was impossible.
    pub redrawn: u32,
}

/// Why a trial is impossible.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum CaseError {
    /// The campaign has no trial of that number.
    #[error("the campaign has only {trials} trials, so there is no trial {trial}")]
    NoTrial {
        /// The number asked for.
        trial: u64,
        /// The number of trials.
        trials: u64,
    },
    /// The values of its factors are refused.
    #[error("with {}: {reason}", values.join(", "))]
    Refused {
        /// Name and value of every factor.
        values: Vec<String>,
        /// Why, with the line of the scenario.
        reason: String,
    },
    /// Factors were drawn repeatedly, and refused each time.
    #[error("its factors were drawn {draws} times, and are impossible each time; the last time {source}")]
    Impossible {
        /// How many.
        draws: u32,
        /// Of the last one.
        source: Box<CaseError>,
    },
}

/// Why a campaign's trials cannot be carried out.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum CampaignError {
    /// An impossible trial in a design that cannot draw it again.
    #[error("trial {trial}: {source}")]
    Trial {
        /// Which.
        trial: u64,
        /// Why.
        source: CaseError,
    },
    /// Too many draws of the factors are impossible.
    #[error("{refused} of the first {drawn} draws of the factors are impossible, the first of them {source}")]
    TooManyRefused {
        /// So many.
        refused: u64,
        /// Of so many.
        drawn: u64,
        /// Of the first one.
        source: CaseError,
    },
    /// Too many machines are impossible.
    #[error("{refused} of the first {drawn} drawn machines are impossible: their loops do not close")]
    TooManyMachines {
        /// So many.
        refused: u64,
        /// Of so many.
        drawn: u64,
    },
}

/// How often factors are drawn for one trial.
const MOST_DRAWS: u32 = 50;
/// Trials that are checked before the first one is carried out.
const LOOKED_AT: u64 = 200;
/// The same for a design that draws no trial again.
const LOOKED_AT_UNDRAWN: u64 = 2000;
/// Largest share of impossible ones, in tenths.
const MOST_TENTHS: u64 = 1;

impl<'a> Campaign<'a> {
    /// The scenario's campaign, with another number of `trials` if one is given.
    ///
    /// # Errors
    ///
    /// The possible numbers of trials, in words.
    pub fn new(
        scenario: &'a Scenario,
        seed: u64,
        plant: PlantKind,
        trials: Option<u64>,
    ) -> Result<Self, String> {
        let design = scenario.campaign.clone().unwrap_or_default().design(trials)?;
        Ok(Self { scenario, seed, plant, design })
    }

    /// The trials of a scenario in which only the draws vary, without end.
    pub fn of_draws(scenario: &'a Scenario, seed: u64, plant: PlantKind) -> Self {
        let plan = scenario.campaign.clone().unwrap_or_default();
        let (factors, sampling) = (plan.factors.len(), plan.sampling);
        let design = Design::Plain { trials: u64::from(u32::MAX), factors, sampling };
        Self { scenario, seed, plant, design }
    }

    /// The trial of that number.
    pub fn case(&self, trial: u64) -> Result<Case<'a>, CaseError> {
        let no_trial = || CaseError::NoTrial { trial, trials: self.design.trials() };
        let varies = self.scenario.campaign.as_ref().is_some_and(|plan| !plan.factors.is_empty());
        let redraws = match self.design {
            Design::Plain { .. } if varies => MOST_DRAWS,
            _ => 1,
        };
        let mut refused = None;
        for redrawn in 0..redraws {
            // A different key each time: a repeated draw depends only on the trial.
            let seed = self.seed.wrapping_add(u64::from(redrawn).wrapping_mul(0x9E37_79B9_7F4A_7C15));
            let (draw, values) = self.values(seed, trial).ok_or_else(no_trial)?;
            match self.varied(&values) {
                Ok(scenario) => {
                    let machine = scenario.redraws(self.seed, draw);
                    return Ok(Case { scenario, draw, values, redrawn: redrawn + machine });
                }
                Err(error) => refused = Some(error),
            }
        }
        match refused {
            Some(source) if redraws > 1 => {
                Err(CaseError::Impossible { draws: redraws, source: Box::new(source) })
            }
            Some(refused) => Err(refused),
            None => Err(no_trial()),
        }
    }

    fn varied(&self, values: &[String]) -> Result<Cow<'a, Scenario>, CaseError> {
        if values.is_empty() {
            return Ok(Cow::Borrowed(self.scenario));
        }
        let factors = self.scenario.campaign.as_ref().map_or(&[][..], |plan| &plan.factors);
        self.scenario.with_factors(values).map(Cow::Owned).map_err(|error| {
            let text = error.to_string();
            // The place of the file differs between machines, and reasons are part of the table.
            let name = self.scenario.sources.first().map_or("", |(_, source)| source.name.as_str());
            let text = text.strip_prefix(name).map_or(text.clone(), |rest| format!("the scenario{rest}"));
            let reason = error.help().map_or(text.clone(), |help| format!("{text}; {help}"));
            let values =
                factors.iter().zip(values).map(|(f, value)| format!("{} = {value}", f.name)).collect();
            CaseError::Refused { values, reason }
        })
    }

    /// Checks the first trials, and for a sweep every combination, before any is carried out.
    ///
    /// # Errors
    ///
    /// Errors if a design that is not drawn has a refused trial, or a drawn one has more than a tenth.
    pub fn check(&self) -> Result<(), CampaignError> {
        let trials = self.design.trials();
        let (drawn, step) = match self.design {
            Design::Sweep { repeats, .. } => (trials / repeats.max(1), repeats),
            Design::Plain { .. } => (trials.min(LOOKED_AT), 1),
            // None is drawn again: as many are checked as take some seconds.
            _ => (trials.min(LOOKED_AT_UNDRAWN), 1),
        };
        let (mut refused, mut machines, mut first) = (0, 0, None);
        for trial in (0..drawn).map(|number| number.saturating_mul(step)) {
            match self.case(trial) {
                Ok(case) => {
                    let again = case.scenario.redraws(self.seed, case.draw);
                    refused += u64::from(case.redrawn > again);
                    machines += u64::from(again > 0);
                }
                Err(source @ CaseError::Impossible { .. }) => {
                    refused += 1;
                    first.get_or_insert(source);
                }
                Err(source) => return Err(CampaignError::Trial { trial, source }),
            }
        }
        if 10 * refused > MOST_TENTHS * drawn {
            return match first.or_else(|| self.first_refused(drawn)) {
                Some(source) => Err(CampaignError::TooManyRefused { refused, drawn, source }),
                None => Ok(()),
            };
        }
        if 10 * machines > MOST_TENTHS * drawn {
            return Err(CampaignError::TooManyMachines { refused: machines, drawn });
        }
        Ok(())
    }

    /// Why the first refused draw of the factors is refused.
    fn first_refused(&self, drawn: u64) -> Option<CaseError> {
        (0..drawn).find_map(|trial| self.varied(&self.values(self.seed, trial)?.1).err())
    }

    /// Draw and values of the factors of a trial; `None` if there is no such trial.
    fn values(&self, seed: u64, trial: u64) -> Option<(u32, Vec<String>)> {
        let factors = self.scenario.campaign.as_ref().map_or(&[][..], |plan| &plan.factors);
        let point = self.design.point(seed, trial)?;
        Some((point.draw, factors.iter().zip(&point.at).map(|(factor, at)| factor.at(*at)).collect()))
    }

    /// The trial of that number. A failure is an outcome with its reason.
    pub fn trial(&self, index: u64) -> Trial {
        match self.case(index) {
            Ok(case) => {
                let outcome = trial::carry_out(self, &case).map_err(|error| error.to_string());
                Trial { index, draw: case.draw, values: case.values, redrawn: case.redrawn, outcome }
            }
            Err(error) => {
                let redrawn = if let CaseError::Impossible { draws, .. } = error { draws - 1 } else { 0 };
                self.failed(index, redrawn, error.to_string())
            }
        }
    }

    fn failed(&self, index: u64, redrawn: u32, reason: String) -> Trial {
        let (draw, values) = self.values(self.seed, index).unwrap_or_default();
        Trial { index, draw, values, redrawn, outcome: Err(reason) }
    }

    /// The same, with even a fault of the program as an outcome: one trial must not end a campaign.
    fn trial_or_fault(&self, index: u64) -> Trial {
        std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| self.trial(index))).unwrap_or_else(|fault| {
            let text = fault.downcast_ref::<String>().map(String::as_str);
            let text = text.or_else(|| fault.downcast_ref::<&str>().copied()).unwrap_or("no reason is given");
            self.failed(index, 0, format!("a fault of this program, please report it: {text}"))
        })
    }

    /// Carries out trials on `threads` threads (0: one per core) until `stop` is set or `observe` says no.
    ///
    /// `observe` receives every trial, in order and soon after it is done, with the seconds that `clock` counted for it. Trials after
    /// one that is unfinished when the campaign is stopped are not reported.
    pub fn run(
        &self,
        trials: impl Iterator<Item = u64> + Send,
        threads: usize,
        stop: &AtomicBool,
        clock: &(dyn Fn() -> f64 + Sync),
        observe: impl FnMut(Trial, f64) -> bool + Send,
    ) -> Result<(), rayon::ThreadPoolBuildError> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        let (done, results) = mpsc::channel();
        let refused = AtomicBool::new(false);
        let told = Told::default();
        let numbered = (0_u64..).zip(trials);
        std::thread::scope(|scope| {
            let (refused, told) = (&refused, &told);
            scope.spawn(move || in_order(&results, refused, told, observe));
            pool.install(|| {
                // A bridge hands out the numbers one by one, so that finished trials form a range without gaps.
                let go_on = || !stop.load(Ordering::Relaxed) && !refused.load(Ordering::Relaxed);
                numbered.take_while(|_| go_on()).par_bridge().for_each_with(done, |done, (place, index)| {
                    told.wait_for(place);
                    let begun = clock();
                    let trial = self.trial_or_fault(index);
                    // The collector outlives every worker.
                    let _ = done.send((place, trial, clock() - begun));
                });
            });
        });
        Ok(())
    }

    /// The trials of a range in memory.
    pub fn trials(&self, range: Range<u32>) -> Result<Vec<Trial>, rayon::ThreadPoolBuildError> {
        let mut trials = Vec::new();
        self.run(range.map(u64::from), 0, &AtomicBool::new(false), &|| 0.0, |trial, _| {
            trials.push(trial);
            true
        })?;
        Ok(trials)
    }
}

/// Largest number of trials ahead of the next one to report: enough for threads next to a slow one.
const AHEAD: u64 = 256;

/// Number of reported trials.
#[derive(Default)]
struct Told(Mutex<u64>, Condvar);

impl Told {
    /// Waits until the trial at `place` is not too far ahead, so that few wait in memory for a slow one.
    fn wait_for(&self, place: u64) {
        let told = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        // The reporter goes on until the last one, so that this ends.
        drop(self.1.wait_while(told, |told| place >= told.saturating_add(AHEAD)));
    }

    fn set(&self, told: u64) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = told;
        self.1.notify_all();
    }
}

/// Receives trials in any order, and reports them in order.
fn in_order(
    results: &mpsc::Receiver<(u64, Trial, f64)>,
    refused: &AtomicBool,
    told: &Told,
    mut observe: impl FnMut(Trial, f64) -> bool,
) {
    let mut waiting = std::collections::BTreeMap::new();
    let mut next = 0;
    for (place, trial, seconds) in results {
        waiting.insert(place, (trial, seconds));
        while let Some((trial, seconds)) = waiting.remove(&next) {
            next += 1;
            if !refused.load(Ordering::Relaxed) && !observe(trial, seconds) {
                refused.store(true, Ordering::Relaxed);
            }
        }
        told.set(next);
    }
}
