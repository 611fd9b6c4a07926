//! A campaign as a table: a row a trial, the same columns in every row.

use super::{Campaign, Trial};
use calibrig_estimation::identification::Mode;
use calibrig_model::measurement::SetKind;

/// Names of the columns; the unit is part of the name.
pub fn header(campaign: &Campaign<'_>) -> Vec<String> {
    let mut names: Vec<String> = ["trial", "status", "reason", "dropped"].map(str::to_owned).to_vec();
    for mode in &campaign.scenario.modes {
        let key = mode.key();
        if *mode != Mode::WithoutCalibration {
            names.extend(
                [
                    "termination",
                    "iterations",
                    "chi2_per_dof",
                    "nees",
                    "nees_parameters",
                    "squared_over_bound",
                ]
                .map(|name| format!("{key}.{name}")),
            );
        }
        for kind in SetKind::ALL {
            let set = kind.key();
            names.extend(
                ["max_x_m", "max_y_m", "max_z_m", "mean_x_m", "mean_y_m", "mean_z_m", "rms_3d_m", "max_3d_m"]
                    .map(|name| format!("{key}.{set}.{name}")),
            );
        }
    }
    names
}

/// The cells of a trial under [`header`]. Numbers are written so that they are read back to the bit; absent ones are empty.
pub fn row(campaign: &Campaign<'_>, trial: &Trial) -> Vec<String> {
    let mut cells = vec![trial.index.to_string()];
    let number = |value: Option<f64>| value.map_or_else(String::new, |v| v.to_string());
    let outcome = match &trial.outcome {
        Ok(outcome) => {
            let sound = outcome.modes.iter().filter_map(|m| m.fit.as_ref()).all(|fit| fit.sound);
            cells.extend([if sound { "ok" } else { "doubtful" }.to_owned(), String::new()]);
            cells.push(outcome.dropped.to_string());
            outcome
        }
        Err(reason) => {
            cells.extend(["failed".to_owned(), reason.clone()]);
            cells.resize(header(campaign).len(), String::new());
            return cells;
        }
    };
    for mode in &campaign.scenario.modes {
        let found = outcome.modes.iter().find(|m| m.mode == *mode);
        if *mode != Mode::WithoutCalibration {
            let fit = found.and_then(|m| m.fit.as_ref());
            cells.push(fit.map_or_else(String::new, |f| f.termination.key().to_owned()));
            cells.push(fit.map_or_else(String::new, |f| f.iterations.to_string()));
            cells.push(number(fit.and_then(|f| f.chi2_per_dof)));
            cells.push(number(fit.and_then(|f| f.nees)));
            cells.push(fit.map_or_else(String::new, |f| f.parameters.len().to_string()));
            cells.push(number(fit.and_then(|f| f.squared_over_bound)));
        }
        for kind in SetKind::ALL {
            let row = found.and_then(|m| m.rows.iter().find(|(k, _)| *k == kind)).map(|(_, row)| row);
            for axis in 0..3 {
                cells.push(number(row.map(|r| r.max[axis])));
            }
            for axis in 0..3 {
                cells.push(number(row.map(|r| r.mean[axis])));
            }
            cells.push(number(row.map(|r| r.rms_3d)));
            cells.push(number(row.map(|r| r.max_3d)));
        }
    }
    cells
}
