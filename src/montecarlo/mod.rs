//! Campaigns: many trials of one scenario, to see how an estimate is scattered and whether it is as certain as it says.
//!
//! A trial is a pure function of (scenario, seed, index): the same bits alone or in a campaign, whatever the number of threads.

mod columns;
mod summary;
mod trial;

pub use columns::{header, row};
pub use summary::{
    CampaignSummary, MeanWithInterval, ModeSummary, ParameterSummary, PredictionCoverage, SetSummary,
    summarise, summary_json, summary_text,
};
pub use trial::{ModeResult, ParameterResult, Trial, TrialOutcome};

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;

use rayon::iter::{ParallelBridge, ParallelIterator};

use crate::pipeline::PlantKind;
use crate::scenario::Scenario;

/// What every trial has in common.
#[derive(Debug, Clone, Copy)]
pub struct Campaign<'a> {
    /// Where the truth is drawn from, how it is measured and identified.
    pub scenario: &'a Scenario,
    /// Key of all random streams.
    pub seed: u64,
    /// What stands for the machine.
    pub plant: PlantKind,
}

impl Campaign<'_> {
    /// The trial of that index. A failure is an outcome with its reason.
    pub fn trial(&self, index: u32) -> Trial {
        Trial { index, outcome: trial::carry_out(self, index).map_err(|error| error.to_string()) }
    }

    /// Carries out the trials of `range` on `threads` threads (0: one a core) until `stop` is set, and returns those that are done, by index.
    ///
    /// `observe` is told of every trial, in the order of the indices and soon after it is done.
    pub fn run(
        &self,
        range: Range<u32>,
        threads: usize,
        stop: &AtomicBool,
        observe: impl FnMut(&Trial) + Send,
    ) -> Result<Vec<Trial>, rayon::ThreadPoolBuildError> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        let (done, results) = mpsc::channel();
        let first = range.start;
        Ok(std::thread::scope(|scope| {
            let collector = scope.spawn(move || in_order(first, results, observe));
            pool.install(|| {
                // A bridge hands the indices out one by one, so that what is done early is a range without holes.
                range.take_while(|_| !stop.load(Ordering::Relaxed)).par_bridge().for_each_with(
                    done,
                    |done, index| {
                        // The collector outlives every worker.
                        let _ = done.send(self.trial(index));
                    },
                );
            });
            collector.join().unwrap_or_default()
        }))
    }
}

/// Receives trials in any order; tells of them, and returns them, by index.
fn in_order(first: u32, results: mpsc::Receiver<Trial>, mut observe: impl FnMut(&Trial)) -> Vec<Trial> {
    let mut waiting = std::collections::BTreeMap::new();
    let mut trials = Vec::new();
    let mut next = first;
    for trial in results {
        waiting.insert(trial.index, trial);
        while let Some(trial) = waiting.remove(&next) {
            observe(&trial);
            trials.push(trial);
            next += 1;
        }
    }
    // After a stop, what was done beyond a hole.
    for trial in waiting.into_values() {
        observe(&trial);
        trials.push(trial);
    }
    trials
}
