//! Is a compliance or term worth identifying? Nested fits with and without it, evaluated on poses that neither has
//! seen.

use std::fmt;

use nalgebra::Vector3;

use super::choice::pose_folds;
use super::{CalibrateError, errors};
use crate::evaluation::{Interval, NestedFits, Split, accuracy, paired_by_pose};
use crate::identification::{
    ComplianceChoice, Estimate, IdentificationOptions, LINKAGE, Linearisation, identify,
};
use crate::validation::{held_out_errors, in_order};
use calibrig_model::measurement::{MeasurementSet, SetOutcome};
use calibrig_model::{CalibrationModel, ParameterId};

/// Joint confidence of all intervals of an estimate.
const LEVEL: f64 = 0.95;
/// Number of parts of the poses that are held out in turn, and the seed of their draw.
const FOLDS: usize = 10;
const SEED: u64 = 1;
/// A loss below this share of the RMS, or of the measurements' assumed noise, is negligible: nested fits differ by as much through
/// their own noise.
const SMALL: f64 = 0.01;

/// Parameters whose identification makes predictions of poses that were not fitted worse than leaving them at their
/// prior means.
#[derive(Debug, Clone, PartialEq)]
pub struct Worse {
    /// Which parameters.
    pub parameters: Vec<ParameterId>,
    /// Decrease of the RMS of held-out poses when they are identified, m: the whole interval is below zero.
    pub gain: Interval,
    /// Whether the whole interval is of consequence, so that the estimate must not be used without a second look.
    pub is_doubtful: bool,
}

impl fmt::Display for Worse {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<_> = self.parameters.iter().map(ToString::to_string).collect();
        let mm = |metres: f64| -1e3 * metres;
        write!(
            f,
            "identifying {} makes predictions of poses that were not fitted worse, by {:.4} mm RMS (interval {:.4} to {:.4} \
             mm), than leaving it at its predicted value: leave it out, or state a tighter prior",
            names.join(", "),
            mm(self.gain.value),
            mm(self.gain.high),
            mm(self.gain.low)
        )
    }
}

/// Which compliances and terms of an estimate, linearised in `system`, are worse identified than left alone.
///
/// The compliances are tested all together, and so are the terms; single ones only if their identification is not clearly better.
/// Linearised fits come first: their findings are fitted again before they are named.
pub(super) fn worse(
    model: &CalibrationModel,
    set: &SetOutcome,
    options: &IdentificationOptions,
    estimate: &Estimate,
    system: &Linearisation,
) -> Vec<Worse> {
    let set = &set.measurements;
    let groups = groups(estimate);
    if groups.is_empty() {
        return Vec::new();
    }
    let splits = pose_folds(set, FOLDS, SEED);
    let poses: Vec<u32> = set.observations.iter().map(|observation| observation.pose).collect();
    let values: Vec<f64> = estimate.parameters.iter().map(|parameter| parameter.value).collect();
    let bounded: Vec<usize> =
        (0..values.len()).filter(|i| estimate.at_bound.contains(&estimate.parameters[*i].id)).collect();
    let nested = NestedFits::new(system, &values, &bounded, &estimate.weights, &poses, &splits);
    let Some(nested) = nested else { return Vec::new() };
    let tests: usize = groups.iter().map(|group| 1 + group.members.len()).sum();
    let level = 1.0 - (1.0 - LEVEL) / tests as f64;
    let confirmed = |columns: &[usize]| {
        nested.gain(columns, level).filter(|gain| gain.high < 0.0)?;
        let parameters: Vec<_> = columns.iter().map(|column| estimate.parameters[*column].id).collect();
        let (gain, rms) = fitted_gain(model, set, options, estimate, &parameters, &splits, level)?;
        let small = SMALL * rms.max(system.whitening.noise());
        let is_worse = gain.high < 0.0 && -gain.value >= small;
        is_worse.then(|| Worse { parameters, gain, is_doubtful: -gain.high >= small })
    };
    let mut found = Vec::new();
    for group in groups {
        if nested.gain(&group.all(), level).is_some_and(|gain| gain.low > 0.0) {
            continue;
        }
        let members: Vec<_> = group.members.iter().filter_map(|member| confirmed(member)).collect();
        if members.is_empty() && group.members.len() > 1 {
            found.extend(confirmed(&group.all()));
        }
        found.extend(members);
    }
    found
}

/// Columns that are tested together, and what can be left out separately.
struct Group {
    members: Vec<Vec<usize>>,
}

impl Group {
    fn all(&self) -> Vec<usize> {
        self.members.concat()
    }
}

/// The compliances, one by one; the linkage, which is geometry and would hide terms tested with it; the terms, family by
/// family.
fn groups(estimate: &Estimate) -> Vec<Group> {
    let ids = || estimate.parameters.iter().map(|parameter| parameter.id).enumerate();
    let compliances = ids().filter(|(_, id)| matches!(id, ParameterId::Compliance(_)));
    let compliances = compliances.map(|(column, _)| vec![column]).collect();
    let mut families: Vec<(&str, Vec<usize>)> = Vec::new();
    for (column, id) in ids() {
        let Some(family) = family(id) else { continue };
        match families.iter_mut().find(|(known, _)| *known == family) {
            Some((_, columns)) => columns.push(column),
            None => families.push((family, vec![column])),
        }
    }
    let (linkage, terms): (Vec<_>, Vec<_>) = families.into_iter().partition(|(family, _)| *family == LINKAGE);
    let [linkage, terms] =
        [linkage, terms].map(|families| families.into_iter().map(|(_, columns)| columns).collect());
    [compliances, linkage, terms]
        .into_iter()
        .map(|members| Group { members })
        .filter(|g| !g.members.is_empty())
        .collect()
}

/// In the extended mode.
fn family(id: ParameterId) -> Option<&'static str> {
    match id {
        ParameterId::Linkage(_) => Some(LINKAGE),
        ParameterId::Term(term) => Some(term.family().key()),
        _ => None,
    }
}

/// The gain of identifying `parameters` by actual fits, and the RMS with them; `None` if one of the fits fails.
fn fitted_gain(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
    estimate: &Estimate,
    parameters: &[ParameterId],
    splits: &[Split],
    level: f64,
) -> Option<(Interval, f64)> {
    let poses: Vec<u32> = set.observations.iter().map(|observation| observation.pose).collect();
    let errors_of = |without: &[ParameterId]| -> Option<Vec<Vector3<f64>>> {
        let options = fitting(options, estimate, without);
        let failed = |source| CalibrateError::Identify { mode: options.mode, source };
        let held_out = held_out_errors(set, splits, |fitted, held_out| {
            errors(&identify(model, fitted, &options).map_err(failed)?.robot, held_out)
        });
        in_order(splits, &held_out.ok()?, set.observations.len())
    };
    let mut without = errors_of(parameters)?;
    let mut with = errors_of(&[])?;
    for (i, weight) in estimate.weights.iter().enumerate() {
        without[i] *= weight.max(0.0).sqrt();
        with[i] *= weight.max(0.0).sqrt();
    }
    Some((paired_by_pose(&without, &with, &poses, level)?, accuracy(&with)?.rms_3d))
}

/// The options that fit what `estimate` has, except for some compliances and families of terms.
fn fitting(
    options: &IdentificationOptions,
    estimate: &Estimate,
    without: &[ParameterId],
) -> IdentificationOptions {
    let kept = || estimate.parameters.iter().map(|parameter| parameter.id).filter(|id| !without.contains(id));
    let compliances = kept().filter_map(|id| match id {
        ParameterId::Compliance(compliance) => Some(compliance),
        _ => None,
    });
    let mut terms: Vec<String> = kept().filter_map(family).map(str::to_owned).collect();
    terms.dedup();
    IdentificationOptions {
        compliances: ComplianceChoice::Listed(compliances.collect()),
        terms: Some(terms),
        ..options.clone()
    }
}
