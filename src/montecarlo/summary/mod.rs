//! Statistics of many trials, from their table alone. Every sum runs in the order of the trials, so that the same table gives the same bits; columns
//! are read repeatedly and never held, so that a table of any length takes the same memory.

mod digits;
mod json;
mod modes;
mod text;

pub(crate) use digits::{decimals, with_interval};
pub use json::summary_json;
pub use modes::{
    MeanWithInterval, ModeSummary, NeesSummary, ParameterSummary, PredictionCoverage, Rate, SetSummary,
};
pub use text::summary_text;

use std::collections::BTreeMap;
use std::ops::Range;

use calibrig_campaign::design::Design;
use calibrig_campaign::plan::quoted;
use calibrig_campaign::sensitivity::{ElementaryEffects, MorrisSums, SobolIndices, SobolSums};
use calibrig_campaign::statistics::{Moments, PairedDifference, QuantileError};
use calibrig_campaign::table::{MemoryTable, Table, TableError};
use thiserror::Error;

use super::columns::set_column;
use super::{AccuracySet, Campaign, Study, Trial, TrialColumns};
use calibrig_estimation::identification::Mode;

/// Level of the intervals of figures, and of the intervals whose coverage is counted.
pub(super) const LEVEL: f64 = 0.95;
/// Level of the bands for NEES and coverage: one in a thousand sound campaigns is outside.
pub const BAND: f64 = 0.999;
/// Relative precision at which a mean counts as well known.
pub(super) const ENOUGH: f64 = 0.01;
/// Most kinds of reasons, and most trials, that are listed.
const MOST_REASONS: usize = 20;
const WORST: usize = 5;

/// A table that cannot be summarised.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum SummaryError {
    /// It cannot be read.
    #[error(transparent)]
    Table(#[from] TableError),
    /// Its values cannot be ranked.
    #[error("quantiles: {0}")]
    Quantiles(#[from] QuantileError<TableError>),
    /// It lacks a column.
    #[error("the table has no column {name}")]
    NoColumn {
        /// Which.
        name: String,
    },
}

/// Trials that failed for reasons that differ only in their numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reason {
    /// That of the first one.
    pub text: String,
    /// The first one.
    pub trial: u64,
    /// How many.
    pub count: u64,
}

/// One of the trials with the largest errors.
#[derive(Debug, Clone, PartialEq)]
pub struct Worst {
    /// Of which mode.
    pub mode: Mode,
    /// Which trial.
    pub trial: u64,
    /// RMS of its 3-D error, m.
    pub rms_3d: f64,
}

/// Trials that belong together: all, or those of a combination of a sweep.
#[derive(Debug, Clone, PartialEq)]
pub struct GroupSummary {
    /// The levels of the combination; empty if there is only one group.
    pub levels: Vec<String>,
    /// Trials in it.
    pub trials: u64,
    /// Number of failed ones.
    pub failed: u64,
    /// One per mode of the scenario.
    pub modes: Vec<ModeSummary>,
}

/// The effect of a factor on the accuracy of a mode.
#[derive(Debug, Clone, PartialEq)]
pub enum FactorEffect {
    /// Sobol's indices.
    Indices(SobolIndices),
    /// Elementary effects, m.
    Screening(ElementaryEffects),
}

/// The effect of each factor on the RMS of the 3-D error of a mode.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensitivity {
    /// Which.
    pub mode: Mode,
    /// Reference of the errors.
    pub kind: AccuracySet,
    /// Factor by factor, by name; the draws are the last one of indices.
    pub effects: Vec<(String, FactorEffect)>,
    /// Rows of the base, or trajectories, that were left out, at least in part, because of failed trials.
    pub left_out: u64,
}

/// Summary of a campaign.
#[derive(Debug, Clone, PartialEq)]
pub struct CampaignSummary {
    /// Name for people.
    pub name: String,
    /// The scenario's file, as it was named.
    pub scenario: String,
    /// Key of the random streams.
    pub seed: u64,
    /// SHA-256 of the scenario and all that it names.
    pub sha256: String,
    /// What was studied.
    pub study: Study,
    /// The first trial.
    pub first: u64,
    /// Trials carried out.
    pub trials: u64,
    /// Number of failed ones.
    pub failed: u64,
    /// Of these, identified but not sound in every mode.
    pub doubtful: u64,
    /// How often factors or machines were drawn again because the draw was impossible.
    pub redrawn: u64,
    /// Why trials failed, the most frequent first.
    pub reasons: Vec<Reason>,
    /// One, or one per combination of a sweep.
    pub groups: Vec<GroupSummary>,
    /// If the design determines it, mode by mode.
    pub sensitivity: Vec<Sensitivity>,
    /// The trials with the largest errors of the last mode, the worst first.
    pub worst: Vec<Worst>,
    /// Error up to which a calibrated robot counts as a success, m.
    pub tolerance: Option<f64>,
}

impl CampaignSummary {
    /// How often the calibrated robot of the last mode is within the tolerance, in a sentence; `None` without a tolerance, and of sweeps.
    pub fn answer(&self) -> Option<String> {
        let [group] = &self.groups[..] else { return None };
        let mode = group.modes.last()?;
        let set = mode.told()?;
        let rate = |rate: &Option<Rate>| {
            let rate = rate.as_ref()?;
            let interval = rate.share.interval?;
            let (low, high) = (1e2 * interval.low, 1e2 * interval.high);
            Some(format!("{} of {} trials (95 % interval {low:.1} to {high:.1} %)", rate.hits, rate.trials))
        };
        // No more digits than nanometres.
        let tolerance = (1e9 * self.tolerance?).round() / 1e6;
        Some(format!(
            "Within {tolerance} mm, {}, {}: the RMS in {}, every pose in {}.",
            mode.mode.title(),
            set.kind.title(),
            rate(&set.rms_within)?,
            rate(&set.max_within)?
        ))
    }

    /// The modes over all trials; for a sweep, those of its first combination.
    pub fn modes(&self) -> &[ModeSummary] {
        self.groups.first().map_or(&[], |group| &group.modes)
    }

    /// The command that carries out one trial with all files of a run, for a POSIX shell.
    pub fn rerun_command(&self, trial: u64) -> String {
        let study = &self.study;
        // If its layout depends on their number.
        let trials = match study.design {
            Design::Plain { .. } => String::new(),
            _ => format!(" --trials {}", study.design.trials()),
        };
        let (scenario, seed, plant) = (quoted(&self.scenario), self.seed, &study.plant);
        format!("calibrig run {scenario} --seed {seed} --plant {plant} --trial {trial}{trials}")
    }
}

/// What a table belongs to.
#[derive(Debug, Clone, PartialEq)]
pub struct Subject {
    /// Name for people.
    pub name: String,
    /// The scenario's file, as it was named.
    pub scenario: String,
    /// Key of the random streams.
    pub seed: u64,
    /// SHA-256 of the scenario and all that it names.
    pub sha256: String,
    /// The trial of the first row.
    pub first: u64,
}

/// Summarises the table of a study.
pub fn summarise(
    subject: Subject,
    study: &Study,
    table: &dyn Table,
    tolerance: Option<f64>,
) -> Result<CampaignSummary, SummaryError> {
    let counts = Counts::of(table)?;
    let modes = study.known_modes();
    let mut groups = Vec::new();
    for (levels, rows) in groups_of(study, subject.first, table.rows()) {
        let mut summaries = Vec::new();
        for (mode, parameters) in &modes {
            let source = modes::Rows { table, rows: rows.clone(), tolerance };
            summaries.push(source.mode(*mode, parameters, study.machines_are_drawn)?);
        }
        let failed = failed_in(table, &rows)?;
        groups.push(GroupSummary { levels, trials: rows.end - rows.start, failed, modes: summaries });
    }
    if let Design::Sweep { repeats, .. } = study.design {
        compare_with_first(table, &modes, &mut groups, repeats)?;
    }
    Ok(CampaignSummary {
        sensitivity: sensitivity(&subject, study, table, &modes)?,
        worst: worst(&subject, table, &modes)?,
        name: subject.name,
        scenario: subject.scenario,
        seed: subject.seed,
        sha256: subject.sha256,
        study: study.clone(),
        first: subject.first,
        trials: table.rows(),
        failed: counts.failed,
        doubtful: counts.doubtful,
        redrawn: counts.redrawn,
        reasons: counts.reasons,
        groups,
        tolerance,
    })
}

/// Summarises trials in memory, in the order of their numbers.
pub fn summarise_trials(campaign: &Campaign<'_>, trials: &[Trial]) -> Result<CampaignSummary, SummaryError> {
    let columns = TrialColumns::of(campaign);
    let rows = trials.iter().map(|trial| columns.row(trial)).collect();
    let subject = Subject {
        name: campaign.scenario.name.clone(),
        scenario: campaign
            .scenario
            .sources
            .first()
            .map_or_else(String::new, |(_, source)| source.name.clone()),
        seed: campaign.seed,
        sha256: crate::pipeline::hash_sources(&campaign.scenario.sources),
        first: trials.first().map_or(0, |trial| trial.index),
    };
    let study = Study::of(campaign, &columns);
    let tolerance = campaign.scenario.campaign.as_ref().and_then(|plan| plan.tolerance);
    summarise(subject, &study, &MemoryTable::new(columns.columns(), rows), tolerance)
}

/// Levels and rows of every group that has rows.
fn groups_of(study: &Study, first: u64, rows: u64) -> Vec<(Vec<String>, Range<u64>)> {
    let Design::Sweep { repeats, .. } = study.design else { return vec![(Vec::new(), 0..rows)] };
    let end = first + rows;
    let combinations = study.design.trials() / repeats.max(1);
    let group = |combination: u64| {
        let own = combination * repeats..(combination + 1) * repeats;
        let own = own.start.max(first)..own.end.min(end);
        let point = study.design.point(0, combination * repeats)?;
        let levels = study.factors.iter().zip(&point.at).map(|(factor, at)| factor.at(*at)).collect();
        (own.start < own.end).then(|| (levels, own.start - first..own.end - first))
    };
    (0..combinations).filter_map(group).collect()
}

fn place(table: &dyn Table, name: &str) -> Result<usize, SummaryError> {
    table.place_of(name).ok_or_else(|| SummaryError::NoColumn { name: name.to_owned() })
}

#[derive(Default)]
struct Counts {
    failed: u64,
    doubtful: u64,
    redrawn: u64,
    reasons: Vec<Reason>,
}

impl Counts {
    fn of(table: &dyn Table) -> Result<Self, SummaryError> {
        let wanted = [
            place(table, "trial")?,
            place(table, "status")?,
            place(table, "reason")?,
            place(table, "redrawn")?,
        ];
        let mut counts = Self::default();
        let mut reasons: BTreeMap<String, Reason> = BTreeMap::new();
        table.visit(&wanted, 0..table.rows(), &mut |row| {
            counts.redrawn += whole(row[3].as_number());
            match row[1].as_text() {
                Some("failed") => {
                    counts.failed += 1;
                    let text = row[2].as_text().unwrap_or_default();
                    let trial = whole(row[0].as_number());
                    let kind = without_numbers(text);
                    if let Some(reason) = reasons.get_mut(&kind) {
                        reason.count += 1;
                    } else if reasons.len() < MOST_REASONS {
                        reasons.insert(kind, Reason { text: text.to_owned(), trial, count: 1 });
                    }
                }
                Some("doubtful") => counts.doubtful += 1,
                _ => {}
            }
        })?;
        counts.reasons = reasons.into_values().collect();
        counts.reasons.sort_by_key(|reason| (std::cmp::Reverse(reason.count), reason.trial));
        Ok(counts)
    }
}

/// A count that a table holds as a number.
fn whole(value: Option<f64>) -> u64 {
    // Numbers of trials are far below 2^52, and not negative.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    value.map_or(0, |value| value as u64)
}

fn failed_in(table: &dyn Table, rows: &Range<u64>) -> Result<u64, SummaryError> {
    let mut failed = 0;
    table.visit(&[place(table, "status")?], rows.clone(), &mut |row| {
        failed += u64::from(row[0].as_text() == Some("failed"));
    })?;
    Ok(failed)
}

/// A reason without its numbers.
fn without_numbers(text: &str) -> String {
    let mut kind = String::new();
    let mut in_number = false;
    for c in text.chars() {
        let is_number = c.is_ascii_digit() || (in_number && (c == '.' || c == 'e' || c == '-'));
        if is_number && !in_number {
            kind.push('#');
        } else if !is_number {
            kind.push(c);
        }
        in_number = is_number;
    }
    kind
}

/// Reference of the accuracy: the true places of held-out poses, if there are any.
pub(super) fn told_set(table: &dyn Table, mode: Mode) -> Result<AccuracySet, SummaryError> {
    for kind in AccuracySet::ALL.into_iter().rev() {
        let column = place(table, &set_column(mode, kind, "rms_3d_m"))?;
        let mut any = false;
        table.visit(&[column], 0..table.rows(), &mut |row| any |= row[0].as_number().is_some())?;
        if any {
            return Ok(kind);
        }
    }
    Ok(AccuracySet::Identification)
}

/// Difference of the trials of every other combination from the same draws of the first one.
fn compare_with_first(
    table: &dyn Table,
    modes: &[(Mode, Vec<calibrig_model::ParameterId>)],
    groups: &mut [GroupSummary],
    repeats: u64,
) -> Result<(), SummaryError> {
    for (place_of_mode, (mode, _)) in modes.iter().enumerate() {
        for kind in AccuracySet::ALL {
            let column = place(table, &set_column(*mode, kind, "rms_3d_m"))?;
            let mut first: Vec<Option<f64>> = Vec::new();
            for (number, group) in (0_u64..).zip(groups.iter_mut()) {
                let rows = number * repeats..((number + 1) * repeats).min(table.rows());
                let mut difference = PairedDifference::default();
                let mut draw = 0;
                table.visit(&[column], rows, &mut |row| {
                    let value = row[0].as_number();
                    if number == 0 {
                        first.push(value);
                    } else {
                        difference.add(first.get(draw).copied().flatten(), value);
                    }
                    draw += 1;
                })?;
                let set = group.modes.get_mut(place_of_mode);
                let set = set.and_then(|mode| mode.sets.iter_mut().find(|set| set.kind == kind));
                if let Some(set) = set.filter(|_| number > 0) {
                    set.against_first = difference.interval(LEVEL);
                }
            }
        }
    }
    Ok(())
}

fn sensitivity(
    subject: &Subject,
    study: &Study,
    table: &dyn Table,
    modes: &[(Mode, Vec<calibrig_model::ParameterId>)],
) -> Result<Vec<Sensitivity>, SummaryError> {
    let mut all = Vec::new();
    if !matches!(study.design, Design::Indices { .. } | Design::Screening { .. }) {
        return Ok(all);
    }
    let mut names: Vec<String> = study.factors.iter().map(|factor| factor.name.clone()).collect();
    if matches!(study.design, Design::Indices { draws: true, .. }) {
        names.push("draws".to_owned());
    }
    for (mode, _) in modes {
        let kind = told_set(table, *mode)?;
        let column = place(table, &set_column(*mode, kind, "rms_3d_m"))?;
        let (effects, left_out) = match &study.design {
            Design::Screening { factors, .. } => {
                let mut sums = MorrisSums::new(*factors);
                let mut trial = subject.first;
                table.visit(&[column], 0..table.rows(), &mut |row| {
                    sums.add(study.design.step(subject.seed, trial), row[0].as_number());
                    trial += 1;
                })?;
                let effects = sums.effects(LEVEL);
                let left_out = effects.iter().map(|effect| effect.left_out).max().unwrap_or(0);
                (effects.into_iter().map(FactorEffect::Screening).collect(), left_out)
            }
            design => {
                let mut sums = SobolSums::new(design.factors());
                table.visit(&[column], 0..table.rows(), &mut |row| sums.add(row[0].as_number()))?;
                let indices = sums.indices(LEVEL).unwrap_or_default();
                (indices.into_iter().map(FactorEffect::Indices).collect::<Vec<_>>(), sums.left_out())
            }
        };
        let effects = names.iter().cloned().zip(effects).collect();
        all.push(Sensitivity { mode: *mode, kind, effects, left_out });
    }
    Ok(all)
}

fn worst(
    subject: &Subject,
    table: &dyn Table,
    modes: &[(Mode, Vec<calibrig_model::ParameterId>)],
) -> Result<Vec<Worst>, SummaryError> {
    let Some((mode, _)) = modes.last() else { return Ok(Vec::new()) };
    let column = place(table, &set_column(*mode, told_set(table, *mode)?, "rms_3d_m"))?;
    let mut worst: Vec<Worst> = Vec::new();
    let mut trial = subject.first;
    table.visit(&[column], 0..table.rows(), &mut |row| {
        let least = worst.last().filter(|_| worst.len() == WORST).map_or(f64::NEG_INFINITY, |w| w.rms_3d);
        if let Some(rms_3d) = row[0].as_number().filter(|rms| *rms > least) {
            let at = worst.partition_point(|other| other.rms_3d >= rms_3d);
            worst.insert(at, Worst { mode: *mode, trial, rms_3d });
            worst.truncate(WORST);
        }
        trial += 1;
    })?;
    Ok(worst)
}

/// Moments of a column.
pub(super) fn moments(table: &dyn Table, column: usize, rows: &Range<u64>) -> Result<Moments, TableError> {
    let mut moments = Moments::default();
    table.visit(&[column], rows.clone(), &mut |row| {
        if let Some(value) = row[0].as_number() {
            moments.add(value);
        }
    })?;
    Ok(moments)
}

#[cfg(test)]
mod tests;
