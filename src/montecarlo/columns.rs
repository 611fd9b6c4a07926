//! A campaign as a table: one row per trial, with the same columns in every row.

use calibrig_campaign::design::{Coordinate, Design};
use calibrig_campaign::table::{Cell, Column, Kind};

use super::trial::FitResult;
use super::{AccuracySet, Campaign, ModeResult, ParameterResult, Trial, TrialOutcome};
use crate::pipeline::planned;
use crate::scenario::{Factor, Scenario};
use calibrig_estimation::evaluation::AccuracyRow;
use calibrig_estimation::identification::{IdentificationOptions, Mode, prospect};
use calibrig_model::{ParameterId, Unit};

/// The columns of a campaign.
#[derive(Debug, Clone, PartialEq)]
pub struct TrialColumns {
    /// The modes, and the parameters for which each has columns.
    pub modes: Vec<(Mode, Vec<ParameterId>)>,
    factors: Vec<Factor>,
}

/// Figures of a set, m.
const ACCURACY: [&str; 8] =
    ["max_x_m", "max_y_m", "max_z_m", "mean_x_m", "mean_y_m", "mean_z_m", "rms_3d_m", "max_3d_m"];

/// For every trial.
const TRIAL: [(&str, Kind); 6] = [
    ("trial", Kind::Integer),
    ("draw", Kind::Integer),
    ("status", Kind::Text),
    ("reason", Kind::Text),
    ("redrawn", Kind::Integer),
    ("dropped", Kind::Integer),
];

/// For every fit.
const FIT: [(&str, Kind); 9] = [
    ("termination", Kind::Text),
    ("sound", Kind::Integer),
    ("iterations", Kind::Integer),
    ("chi2_per_dof", Kind::Number),
    ("nees", Kind::Number),
    ("parameter_count", Kind::Integer),
    ("squared_over_bound", Kind::Number),
    ("predictions_inside", Kind::Integer),
    ("predictions", Kind::Integer),
];

/// For every parameter, with the suffix of its unit; the last three are standard deviations.
const PARAMETER: [&str; 5] = ["estimate", "truth", "sigma", "cramer_rao", "bayesian"];

/// Name of a parameter's column: `with_gravity.delta_a2.estimate_m`.
pub(super) fn parameter_column(mode: Mode, id: ParameterId, figure: &str) -> String {
    let unit = match id.unit() {
        Unit::Metre => "_m",
        Unit::Radian => "_rad",
        Unit::One => "",
    };
    format!("{}.{id}.{figure}{unit}", mode.key())
}

/// Name of a figure of a set: `with_gravity.verification.rms_3d_m`.
pub(super) fn set_column(mode: Mode, kind: AccuracySet, figure: &str) -> String {
    format!("{}.{}.{figure}", mode.key(), kind.key())
}

/// Name of a figure of a mode: `with_gravity.nees`.
pub(super) fn mode_column(mode: Mode, figure: &str) -> String {
    format!("{}.{figure}", mode.key())
}

/// Name of a factor's column.
pub(super) fn factor_column(factor: &Factor) -> String {
    format!("factor.{}", factor.name)
}

impl TrialColumns {
    /// The columns of a campaign: with the parameters that its planned sessions would identify, at any combination of a sweep and otherwise at the
    /// values stated in the scenario's file. Further parameters of a trial are in `other_parameters`.
    pub fn of(campaign: &Campaign<'_>) -> Self {
        let scenario = campaign.scenario;
        let factors = scenario.campaign.as_ref().map_or_else(Vec::new, |plan| plan.factors.clone());
        let mut modes: Vec<_> = scenario.modes.iter().map(|mode| (*mode, Vec::new())).collect();
        match &campaign.design {
            Design::Sweep { repeats, .. } => {
                let combinations = campaign.design.trials() / repeats.max(&1);
                for combination in 0..combinations {
                    if let Ok(case) = campaign.case(combination * repeats) {
                        add_planned(&mut modes, &case.scenario);
                    }
                }
            }
            _ => {
                add_planned(&mut modes, scenario);
                for factor in 0..factors.len() {
                    add_of_levels(&mut modes, scenario, &factors, factor);
                }
            }
        }
        Self { modes, factors }
    }

    /// Names and kinds.
    pub fn columns(&self) -> Vec<Column> {
        let mut columns: Vec<Column> = TRIAL.map(|(name, kind)| Column::new(name, kind)).to_vec();
        for factor in &self.factors {
            let kind = if factor.is_numeric() { Kind::Number } else { Kind::Text };
            columns.push(Column::new(factor_column(factor), kind));
        }
        for (mode, parameters) in &self.modes {
            for kind in AccuracySet::ALL {
                columns.extend(
                    ACCURACY.map(|figure| Column::new(set_column(*mode, kind, figure), Kind::Number)),
                );
            }
            if *mode == Mode::WithoutCalibration {
                continue;
            }
            columns.extend(FIT.map(|(name, kind)| Column::new(mode_column(*mode, name), kind)));
            for id in parameters {
                columns.extend(
                    PARAMETER.map(|figure| Column::new(parameter_column(*mode, *id, figure), Kind::Number)),
                );
            }
            columns.push(Column::new(mode_column(*mode, "other_parameters"), Kind::Text));
        }
        columns
    }

    /// The cells of a trial in the order of [`Self::columns`].
    pub fn row(&self, trial: &Trial) -> Vec<Cell> {
        let (status, reason) = match &trial.outcome {
            Ok(outcome) if outcome.is_sound() => ("ok", Cell::Absent),
            Ok(_) => ("doubtful", Cell::Absent),
            Err(reason) => ("failed", Cell::text(reason)),
        };
        let outcome = trial.outcome.as_ref().ok();
        let mut cells = vec![
            Cell::count(trial.index),
            Cell::count(trial.draw),
            Cell::text(status),
            reason,
            Cell::count(trial.redrawn),
            outcome.map_or(Cell::Absent, |outcome| Cell::count(outcome.dropped)),
        ];
        for (place, factor) in self.factors.iter().enumerate() {
            let value = trial.values.get(place);
            cells.push(match value {
                Some(value) if factor.is_numeric() => Cell::number(value.parse().ok()),
                Some(value) => Cell::text(value.trim_matches('"')),
                None => Cell::Absent,
            });
        }
        for (mode, parameters) in &self.modes {
            let found = outcome.and_then(|outcome| outcome.modes.iter().find(|m| m.mode == *mode));
            add_sets(&mut cells, found);
            if *mode != Mode::WithoutCalibration {
                add_fit(&mut cells, found.and_then(|found| found.fit.as_ref()), parameters);
            }
        }
        cells
    }
}

impl TrialOutcome {
    /// Whether every identification converged and has full rank.
    pub fn is_sound(&self) -> bool {
        self.modes.iter().filter_map(|mode| mode.fit.as_ref()).all(|fit| fit.sound)
    }
}

/// Adds parameters that the scenario's planned session would identify. A session that cannot be planned adds none.
fn add_planned(modes: &mut [(Mode, Vec<ParameterId>)], scenario: &Scenario) {
    let Ok(set) = planned(scenario) else { return };
    for (mode, parameters) in modes.iter_mut().filter(|(mode, _)| *mode != Mode::WithoutCalibration) {
        let options = IdentificationOptions { mode: *mode, ..scenario.options.clone() };
        let Ok(prospect) = prospect(&scenario.robot.model, &set, &options) else { continue };
        for id in prospect.parameters {
            if !parameters.contains(&id) {
                parameters.push(id);
            }
        }
    }
}

/// The same at every level of a factor that has levels.
fn add_of_levels(
    modes: &mut [(Mode, Vec<ParameterId>)],
    scenario: &Scenario,
    factors: &[Factor],
    place: usize,
) {
    if factors[place].levels() < 2 {
        return;
    }
    for level in 0..factors[place].levels() {
        let at = |(other, factor): (usize, &Factor)| {
            if other == place {
                factor.at(Coordinate::Level(level))
            } else {
                factor.at(Coordinate::Unit(0.5))
            }
        };
        let values: Vec<String> = factors.iter().enumerate().map(at).collect();
        if let Ok(varied) = scenario.with_factors(&values) {
            add_planned(modes, &varied);
        }
    }
}

fn add_sets(cells: &mut Vec<Cell>, found: Option<&ModeResult>) {
    for kind in AccuracySet::ALL {
        let row = found.and_then(|m| m.rows.iter().find(|(k, _)| *k == kind)).map(|(_, row)| row);
        let figures: [fn(&AccuracyRow) -> f64; 8] = [
            |r| r.max[0],
            |r| r.max[1],
            |r| r.max[2],
            |r| r.mean[0],
            |r| r.mean[1],
            |r| r.mean[2],
            |r| r.rms_3d,
            |r| r.max_3d,
        ];
        cells.extend(figures.map(|figure| Cell::number(row.map(figure))));
    }
}

fn add_fit(cells: &mut Vec<Cell>, fit: Option<&FitResult>, parameters: &[ParameterId]) {
    let Some(fit) = fit else {
        cells.extend(std::iter::repeat_n(Cell::Absent, FIT.len() + PARAMETER.len() * parameters.len() + 1));
        return;
    };
    cells.extend([
        Cell::text(fit.termination.key()),
        Cell::count(u8::from(fit.sound)),
        Cell::count(fit.iterations),
        Cell::number(fit.chi2_per_dof),
        Cell::number(fit.nees),
        Cell::count(fit.parameters.len()),
        Cell::number(fit.squared_over_bound),
        Cell::count(fit.predictions.0),
        Cell::count(fit.predictions.1),
    ]);
    for id in parameters {
        let found = fit.parameters.iter().find(|p| p.id == *id);
        let figures: [fn(&ParameterResult) -> Option<f64>; 5] =
            [|p| Some(p.value), |p| p.truth, |p| p.sigma, |p| p.cramer_rao, |p| p.bayesian];
        cells.extend(figures.map(|figure| Cell::number(found.and_then(figure))));
    }
    let others: Vec<_> = fit.parameters.iter().filter(|p| !parameters.contains(&p.id)).collect();
    cells.push(if others.is_empty() { Cell::Absent } else { Cell::text(in_json(&others)) });
}

/// Parameters that have no columns of their own.
fn in_json(parameters: &[&ParameterResult]) -> String {
    let entry = |p: &&ParameterResult| {
        let figures = serde_json::json!({
            "estimate": p.value, "truth": p.truth, "sigma": p.sigma, "cramer_rao": p.cramer_rao, "bayesian": p.bayesian,
        });
        (p.id.to_string(), figures)
    };
    serde_json::Value::Object(parameters.iter().map(entry).collect()).to_string()
}
