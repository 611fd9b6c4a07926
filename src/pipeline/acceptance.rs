//! The virtual acceptance test of one instrument of a kind, or of many.

use rayon::prelude::*;

use super::PipelineError;
use crate::scenario::Scenario;
use calibrig_plant::tracker::acceptance::{Acceptance, draw_and_test};
pub use calibrig_plant::tracker::acceptance::{Finding, Test};
use calibrig_plant::tracker::{Instrument, Preset};

/// A kind of instrument that is tested.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TestedKind {
    /// Its figures.
    pub instrument: Instrument,
}

impl TestedKind {
    /// One by the name of its preset.
    pub fn of_preset(name: &str) -> Option<Self> {
        Preset::parse(name).map(|preset| Self { instrument: preset.instrument() })
    }

    /// That of a scenario.
    pub fn of_scenario(scenario: &Scenario) -> Self {
        Self { instrument: scenario.tracker.instrument }
    }

    /// The name of its preset, if it has one.
    pub fn preset_key(&self) -> Option<&'static str> {
        self.instrument.preset.map(Preset::key)
    }

    /// The names of presets.
    pub fn preset_names() -> Vec<&'static str> {
        Preset::ALL.iter().map(|preset| preset.key()).collect()
    }
}

/// The largest ratio of an error to the permitted one, for each instrument: their median and the largest of all.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ratios {
    /// 1
    pub median_of_max: f64,
    /// 1
    pub max: f64,
}

/// One test over all instruments.
#[derive(Debug, Clone, PartialEq)]
pub struct TestOutcome {
    /// Which.
    pub test: Test,
    /// Errors per instrument.
    pub findings: usize,
    /// Over instruments.
    pub ratios: Ratios,
    /// The largest ratio of each instrument, in their order.
    pub worst: Vec<f64>,
}

/// The tests of instruments of a kind, each drawn from (seed, its number).
#[derive(Debug, Clone, PartialEq)]
pub struct AcceptanceOutcome {
    /// What was tested.
    pub kind: TestedKind,
    /// Of the draws.
    pub seed: u64,
    /// How many were tested.
    pub instruments: u32,
    /// How many passed.
    pub passed: u32,
    /// Of all lengths.
    pub lengths: Ratios,
    /// Of all two-face points.
    pub two_faces: Ratios,
    /// Of all intervals of range.
    pub ranging: Ratios,
    /// In the order of the table.
    pub tests: Vec<TestOutcome>,
    /// All errors of the first instrument.
    pub first: Vec<Finding>,
}

impl AcceptanceOutcome {
    /// Share of the instruments that passed.
    pub fn pass_fraction(&self) -> f64 {
        f64::from(self.passed) / f64::from(self.instruments)
    }
}

/// Tests `instruments` of a kind, at least one, as they leave the workshop: none is drawn again.
///
/// The result does not depend on the number of threads, which all report each instrument to `done`.
pub fn test_instruments(
    kind: TestedKind,
    seed: u64,
    instruments: u32,
    done: impl Fn() + Sync,
) -> Result<AcceptanceOutcome, PipelineError> {
    let test = |trial| draw_and_test(&kind.instrument, seed, trial, 0).map(|(_, acceptance)| acceptance);
    let first = test(0)?;
    let all: Vec<LargestRatios> = (0..instruments.max(1))
        .into_par_iter()
        .map(|trial| {
            let row = test(trial).map(|a| LargestRatios::of(&a));
            done();
            row
        })
        .collect::<Result<_, _>>()?;
    let over = |of: fn(&LargestRatios) -> f64| ratios(all.iter().map(of).collect());
    let tests = Test::ALL.iter().enumerate().map(|(index, test)| {
        let worst: Vec<f64> = all.iter().map(|row| row.tests[index]).collect();
        TestOutcome {
            test: *test,
            findings: first.findings.iter().filter(|finding| finding.test == *test).count(),
            ratios: ratios(worst.clone()),
            worst,
        }
    });
    Ok(AcceptanceOutcome {
        kind,
        seed,
        instruments: instruments.max(1),
        // Far below 2^32: there are as many rows as instruments.
        passed: u32::try_from(all.iter().filter(|row| row.passes).count()).unwrap_or(u32::MAX),
        lengths: over(|row| row.lengths),
        two_faces: over(|row| row.two_faces),
        ranging: over(|row| row.ranging),
        tests: tests.collect(),
        first: first.findings,
    })
}

/// The largest ratios of one instrument.
struct LargestRatios {
    tests: [f64; Test::ALL.len()],
    lengths: f64,
    two_faces: f64,
    ranging: f64,
    passes: bool,
}

impl LargestRatios {
    fn of(acceptance: &Acceptance) -> Self {
        Self {
            tests: Test::ALL.map(|test| acceptance.worst(test).map_or(0.0, Finding::ratio)),
            lengths: acceptance.length_ratio(),
            two_faces: acceptance.two_face_ratio(),
            ranging: acceptance.ranging_ratio(),
            passes: acceptance.passes(),
        }
    }
}

fn ratios(mut values: Vec<f64>) -> Ratios {
    values.sort_by(f64::total_cmp);
    let count = values.len();
    let at = |index: usize| values.get(index).copied().unwrap_or(0.0);
    Ratios {
        median_of_max: 0.5 * (at(count.saturating_sub(1) / 2) + at(count / 2)),
        max: at(count.saturating_sub(1)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_said_of_many_instruments_is_what_each_of_them_showed() {
        let kind = TestedKind::of_preset("vantage").expect("a preset");
        let outcome = test_instruments(kind, 3, 40, || {}).expect("all in reach");
        let each: Vec<_> =
            (0..40).map(|trial| draw_and_test(&kind.instrument, 3, trial, 0).expect("in reach").1).collect();
        let passed = each.iter().filter(|a| a.passes()).count();
        assert_eq!(outcome.passed as usize, passed);
        assert!((outcome.pass_fraction() - passed as f64 / 40.0).abs() < 1e-15);
        let mut lengths: Vec<_> = each.iter().map(Acceptance::length_ratio).collect();
        lengths.sort_by(f64::total_cmp);
        assert_eq!(outcome.lengths.max, lengths[39]);
        assert_eq!(outcome.lengths.median_of_max, 0.5 * (lengths[19] + lengths[20]));
        assert_eq!(outcome.tests.iter().map(|test| test.findings).sum::<usize>(), outcome.first.len());
        assert_eq!(outcome.first, each[0].findings);
        let worst =
            outcome.tests.iter().filter(|t| t.test.is_length()).map(|t| t.ratios.max).fold(0.0, f64::max);
        assert_eq!(worst, outcome.lengths.max);
        assert_eq!(ratios(vec![3.0, 1.0, 2.0]), Ratios { median_of_max: 2.0, max: 3.0 });
    }
}
