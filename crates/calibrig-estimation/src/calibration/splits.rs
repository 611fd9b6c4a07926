//! Whether a mode is better than the one before it on held-out poses, by repeated random splits of one measured set.

use std::collections::{BTreeMap, BTreeSet};

use super::{CalibrateError, calibrate};
use crate::evaluation::{Interval, repeated_splits, resampled_difference};
use crate::identification::{Estimate, IdentificationOptions, Mode, Warning};
use calibrig_model::CalibrationModel;
use calibrig_model::measurement::{MeasurementSet, SetKind, SetOutcome};
use calibrig_model::random::{StreamSource, stream};

/// Confidence of the intervals.
const LEVEL: f64 = 0.95;

/// The splits to make.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SplitPlan {
    /// Number of splits.
    pub splits: usize,
    /// Number of poses fitted in each; the others are held out.
    pub fitted: usize,
    /// Seed of the random draws.
    pub seed: u64,
}

/// All modes on the same splits.
#[derive(Debug, Clone, PartialEq)]
pub struct SplitStudy {
    /// The splits that were made.
    pub plan: SplitPlan,
    /// Number of poses held out in each.
    pub held_out: usize,
    /// Results in the order of the tables.
    pub modes: Vec<SplitMode>,
}

/// One mode on all splits.
#[derive(Debug, Clone, PartialEq)]
pub struct SplitMode {
    /// Which mode.
    pub mode: Mode,
    /// RMS of the 3-D error of the held-out poses, m, one per split.
    pub rms: Vec<f64>,
    /// Number of splits whose estimate is not sound.
    pub doubtful: usize,
    /// How often each reason occurs, by its key; a split can have several.
    pub reasons: BTreeMap<&'static str, usize>,
    /// How much smaller the RMS is than that of the mode before it on the same splits, m; 95 % interval.
    pub gain: Option<Interval>,
}

impl SplitMode {
    /// Mean RMS over the splits, m.
    pub fn mean_rms(&self) -> f64 {
        self.rms.iter().sum::<f64>() / self.rms.len() as f64
    }

    /// Smallest and largest RMS, m.
    pub fn range(&self) -> (f64, f64) {
        self.rms.iter().fold((f64::INFINITY, 0.0), |(low, high), rms| (rms.min(low), rms.max(high)))
    }
}

/// Number of different poses of a set; poses are what is split.
pub fn pose_count(set: &MeasurementSet) -> usize {
    poses(set).len()
}

fn poses(set: &MeasurementSet) -> Vec<u32> {
    let numbers: BTreeSet<u32> = set.observations.iter().map(|observation| observation.pose).collect();
    numbers.into_iter().collect()
}

/// The set without the gross errors that carry no weight in `estimate`, which was fitted to it: held out, they would count in full.
pub fn without_gross_errors(set: &MeasurementSet, estimate: &Estimate) -> MeasurementSet {
    let mut set = set.clone();
    let mut place = 0;
    set.observations.retain(|_| {
        let here = place;
        place += 1;
        !estimate.outliers.iter().any(|outlier| outlier.observation == here && !outlier.carries_weight())
    });
    set
}

/// Fits every mode to random parts of `set` and verifies it on the rest. All observations of a pose stay together, so that no part of a held-out
/// pose is fitted. `progress` is given the number of splits done.
pub fn repeat_splits(
    model: &CalibrationModel,
    set: &MeasurementSet,
    modes: &[Mode],
    options: &IdentificationOptions,
    plan: SplitPlan,
    mut progress: impl FnMut(usize),
) -> Result<SplitStudy, CalibrateError> {
    let poses = poses(set);
    let part = |kind: SetKind, indices: &[usize]| {
        let wanted: BTreeSet<u32> = indices.iter().map(|index| poses[*index]).collect();
        let mut part = set.clone();
        part.observations.retain(|observation| wanted.contains(&observation.pose));
        SetOutcome { kind, measurements: part, dropped: Vec::new() }
    };
    let mut study: Vec<_> = modes
        .iter()
        .map(|mode| SplitMode {
            mode: *mode,
            rms: Vec::with_capacity(plan.splits),
            doubtful: 0,
            reasons: BTreeMap::new(),
            gain: None,
        })
        .collect();
    let splits = repeated_splits(
        poses.len(),
        plan.fitted,
        plan.splits,
        &mut stream(plan.seed, 0, StreamSource::Splits),
    );
    for (done, split) in splits.iter().enumerate() {
        let sets =
            [part(SetKind::Identification, &split.fitted), part(SetKind::Verification, &split.held_out)];
        let (_, outcomes) = calibrate(model, &sets, modes, options)
            .map_err(|source| CalibrateError::Split { split: done + 1, source: Box::new(source) })?;
        for (mode, outcome) in study.iter_mut().zip(outcomes) {
            mode.rms.extend(outcome.rows[1].map(|row| row.rms_3d));
            let reasons: BTreeSet<_> =
                outcome.estimate.iter().flat_map(Estimate::reasons).filter_map(Warning::reason).collect();
            mode.doubtful += usize::from(!reasons.is_empty());
            for reason in reasons {
                *mode.reasons.entry(reason).or_insert(0) += 1;
            }
        }
        progress(done + 1);
    }
    let held_out = poses.len().saturating_sub(plan.fitted);
    let held_out_per_fitted = held_out as f64 / plan.fitted as f64;
    for place in 1..study.len() {
        let before = study[place - 1].rms.iter();
        let gains: Vec<f64> = before.zip(&study[place].rms).map(|(before, rms)| before - rms).collect();
        study[place].gain = resampled_difference(&gains, held_out_per_fitted, LEVEL);
    }
    Ok(SplitStudy { plan, held_out, modes: study })
}
