//! Campaigns: many trials of one scenario, to see how an estimate is scattered and whether it is as certain as it says.
//!
//! A trial is a pure function of (scenario, seed, number): the same bits alone or in a campaign, whatever the number of threads, machines and parts. A
//! trial is a row of a table ([`TrialColumns`]), and what trials say together ([`summarise`]) is told from the table alone: of rows in memory, of
//! one machine, and of many machines' shards.

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
pub use trial::{AccuracySet, Fit, ModeResult, ParameterResult, Trial, TrialOutcome};

use std::borrow::Cow;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;

use calibrig_campaign::design::{Design, Sampling};
use rayon::iter::{ParallelBridge, ParallelIterator};
use thiserror::Error;

use crate::pipeline::PlantKind;
use crate::scenario::Scenario;
use calibrig_files::InputError;

/// What every trial has in common.
#[derive(Debug, Clone)]
pub struct Campaign<'a> {
    /// Where the truth is drawn from, how it is measured and identified.
    pub scenario: &'a Scenario,
    /// Key of all random streams.
    pub seed: u64,
    /// What stands for the machine.
    pub plant: PlantKind,
    /// Which point of the study a trial is.
    pub design: Design,
}

/// What a trial is before it is carried out.
#[derive(Debug, Clone)]
pub struct Case<'a> {
    /// The scenario with the values of its factors.
    pub scenario: Cow<'a, Scenario>,
    /// Number of the draw, which keys the random streams.
    pub draw: u32,
    /// Of the factors, as TOML has them.
    pub values: Vec<String>,
    /// How often factors or machine were drawn again, because what was drawn is impossible.
    pub redrawn: u32,
}

/// A trial that cannot be one.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum CaseError {
    /// The campaign has no trial of that number.
    #[error("the campaign has {trials} trials, and no trial {trial}")]
    NoTrial {
        /// Asked for.
        trial: u64,
        /// There are.
        trials: u64,
    },
    /// The values of its factors are refused.
    #[error("with {}: {source}", values.join(", "))]
    Refused {
        /// Name and value of every factor.
        values: Vec<String>,
        /// Why.
        source: Box<InputError>,
    },
    /// Factors were drawn again and again, and refused each time.
    #[error("of {draws} draws of the factors none is possible; the last one {source}")]
    Impossible {
        /// How many.
        draws: u32,
        /// Of the last one.
        source: Box<CaseError>,
    },
}

/// A campaign whose trials cannot be carried out.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum CampaignError {
    /// A trial of a design that has none to spare.
    #[error("trial {trial}: {source}")]
    Trial {
        /// Which.
        trial: u64,
        /// Why.
        source: CaseError,
    },
    /// Too many draws of the factors are impossible.
    #[error("{refused} of the first {drawn} draws of the factors are impossible, the first one {source}")]
    TooManyRefused {
        /// So many.
        refused: u64,
        /// Of so many.
        drawn: u64,
        /// Of the first one.
        source: CaseError,
    },
    /// Too many machines are impossible.
    #[error(
        "{refused} of the first {drawn} machines that are drawn are impossible: their loops do not close"
    )]
    TooManyMachines {
        /// So many.
        refused: u64,
        /// Of so many.
        drawn: u64,
    },
}

/// How often factors are drawn for one trial.
const MOST_DRAWS: u32 = 50;
/// Trials that are looked at before the first one is carried out.
const LOOKED_AT: u64 = 200;
/// More of them must not be impossible, in tenths.
const MOST_TENTHS: u64 = 1;

impl<'a> Campaign<'a> {
    /// A campaign as the scenario lays it out, with as many `trials` where that is asked for.
    ///
    /// # Errors
    ///
    /// What the number of trials can be, in words.
    pub fn new(
        scenario: &'a Scenario,
        seed: u64,
        plant: PlantKind,
        trials: Option<u64>,
    ) -> Result<Self, String> {
        let design = scenario.campaign.clone().unwrap_or_default().design(trials)?;
        Ok(Self { scenario, seed, plant, design })
    }

    /// The trials of a scenario in which nothing varies but what is drawn, without end.
    pub fn of_draws(scenario: &'a Scenario, seed: u64, plant: PlantKind) -> Self {
        let factors = scenario.campaign.as_ref().map_or(0, |plan| plan.factors.len());
        let design = Design::Plain { trials: u64::from(u32::MAX), factors, sampling: Sampling::Random };
        Self { scenario, seed, plant, design }
    }

    /// What the trial of that number is.
    pub fn case(&self, trial: u64) -> Result<Case<'a>, CaseError> {
        let no_trial = || CaseError::NoTrial { trial, trials: self.design.trials() };
        let factors = self.scenario.campaign.as_ref().map_or(&[][..], |plan| &plan.factors);
        let redraws = match self.design {
            Design::Plain { .. } if !factors.is_empty() => MOST_DRAWS,
            _ => 1,
        };
        let mut refused = None;
        for redrawn in 0..redraws {
            // Another key each time: what is drawn again depends on the trial alone.
            let seed = self.seed.wrapping_add(u64::from(redrawn).wrapping_mul(0x9E37_79B9_7F4A_7C15));
            let point = self.design.point(seed, trial).ok_or_else(no_trial)?;
            let values: Vec<String> =
                factors.iter().zip(&point.at).map(|(factor, at)| factor.at(*at)).collect();
            match self.varied(&values) {
                Ok(scenario) => {
                    let machine = scenario.redraws(self.seed, point.draw);
                    return Ok(Case { scenario, draw: point.draw, values, redrawn: redrawn + machine });
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
        self.scenario.with_factors(values).map(Cow::Owned).map_err(|source| CaseError::Refused {
            values: factors.iter().zip(values).map(|(f, value)| format!("{} = {value}", f.name)).collect(),
            source: Box::new(source),
        })
    }

    /// Looks at what the first trials of `range` are, and of a sweep at every combination, before any is carried out.
    ///
    /// # Errors
    ///
    /// A design that is not drawn has a trial that is refused, or of one that is drawn more than a tenth are.
    pub fn check(&self, range: Range<u64>) -> Result<(), CampaignError> {
        if let Design::Sweep { repeats, .. } = self.design {
            let firsts = range.clone().filter(|trial| trial % repeats.max(1) == 0);
            for trial in firsts {
                self.case(trial).map_err(|source| CampaignError::Trial { trial, source })?;
            }
            return Ok(());
        }
        let drawn = (range.end - range.start).min(LOOKED_AT);
        let (mut refused, mut machines, mut first) = (0, 0, None);
        for trial in range.start..range.start + drawn {
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
            let source = first
                .or_else(|| self.first_refused(range))
                .unwrap_or(CaseError::NoTrial { trial: 0, trials: 0 });
            return Err(CampaignError::TooManyRefused { refused, drawn, source });
        }
        if 10 * machines > MOST_TENTHS * drawn {
            return Err(CampaignError::TooManyMachines { refused: machines, drawn });
        }
        Ok(())
    }

    /// Why the first draw of the factors that is refused is.
    fn first_refused(&self, mut range: Range<u64>) -> Option<CaseError> {
        let factors = self.scenario.campaign.as_ref().map_or(&[][..], |plan| &plan.factors);
        range.find_map(|trial| {
            let point = self.design.point(self.seed, trial)?;
            let values: Vec<String> =
                factors.iter().zip(&point.at).map(|(factor, at)| factor.at(*at)).collect();
            self.varied(&values).err()
        })
    }

    /// The trial of that number. A failure is an outcome with its reason.
    pub fn trial(&self, index: u64) -> Trial {
        match self.case(index) {
            Ok(case) => {
                let outcome = trial::carry_out(self, &case).map_err(|error| error.to_string());
                Trial { index, draw: case.draw, values: case.values, redrawn: case.redrawn, outcome }
            }
            Err(error) => {
                let point = self.design.point(self.seed, index);
                let draw = point.map_or(0, |point| point.draw);
                Trial { index, draw, values: Vec::new(), redrawn: 0, outcome: Err(error.to_string()) }
            }
        }
    }

    /// Carries out trials on `threads` threads (0: one a core) until `stop` is set or `observe` says no.
    ///
    /// `observe` is told of every trial in their order and soon after it is done, with the seconds that `clock` counted for it. Trials
    /// behind one that is not done when the campaign is stopped are not told of.
    pub fn run(
        &self,
        trials: impl Iterator<Item = u64> + Send,
        threads: usize,
        stop: &AtomicBool,
        clock: &(dyn Fn() -> f64 + Sync),
        observe: impl FnMut(Trial, f64) -> bool + Send,
    ) -> Result<(), rayon::ThreadPoolBuildError> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        let (done, results) = mpsc::sync_channel(WAITING);
        let refused = AtomicBool::new(false);
        let numbered = (0_u64..).zip(trials);
        std::thread::scope(|scope| {
            let refused = &refused;
            scope.spawn(move || in_order(&results, refused, observe));
            pool.install(|| {
                // A bridge hands the numbers out one by one, so that what is done early is a range without holes.
                let go_on = || !stop.load(Ordering::Relaxed) && !refused.load(Ordering::Relaxed);
                numbered.take_while(|_| go_on()).par_bridge().for_each_with(done, |done, (place, index)| {
                    let begun = clock();
                    let trial = self.trial(index);
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

/// Trials that wait to be told of: enough for threads that are ahead of a slow one.
const WAITING: usize = 256;

/// Receives trials in any order, and tells of them by their place.
fn in_order(
    results: &mpsc::Receiver<(u64, Trial, f64)>,
    refused: &AtomicBool,
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
    }
}
