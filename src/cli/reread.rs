//! Changes that a diagnosis can suggest but no column map can state: rows paired differently, or left out.

use clap::CommandFactory;
use clap::error::ErrorKind;

use super::Cli;
use crate::pipeline::{SetKind, SetOutcome};
use calibrig_files::Places;
use calibrig_model::measurement::Observation;

/// How rows are read differently from their order in the file.
#[derive(Debug, Clone, Default, clap::Args)]
pub(super) struct RereadArgs {
    /// Pair the joints of a row with the point this many rows below; above if negative, such as -1
    #[arg(long, value_name = "ROWS", allow_negative_numbers = true, value_parser = clap::value_parser!(i32).range(-1_000_000..=1_000_000))]
    shift_points: Option<i32>,
    /// Poses of --measurements whose points are left out, by number (by row if they have none), such as 5,14
    #[arg(long, value_name = "POSE,..", value_delimiter = ',')]
    leave_out: Vec<u32>,
}

impl RereadArgs {
    /// Applies it to what was read; lost points are dropped with the reason. A pose that was not measured is an error of usage.
    pub fn apply(&self, sets: &mut [SetOutcome], places: &mut [Places]) {
        for (set, places) in sets.iter_mut().zip(places) {
            let is_fitted = set.kind == SetKind::Identification;
            let left_out = if is_fitted { self.leave_out.as_slice() } else { &[] };
            if let Some(unknown) =
                left_out.iter().find(|pose| !set.measurements.observations.iter().any(|o| o.pose == **pose))
            {
                let message = format!("--leave-out {unknown}: no point of this pose was read");
                Cli::command().error(ErrorKind::ValueValidation, message).exit();
            }
            let by: i64 = self.shift_points.unwrap_or(0).into();
            if by != 0 || !left_out.is_empty() {
                *places = places.select(paired(set, by, left_out));
            }
        }
    }
}

/// Pairs commands with the points this many rows below, without the points that are left out; returns the rows whose commands are
/// kept.
fn paired(set: &mut SetOutcome, by: i64, left_out: &[u32]) -> Vec<usize> {
    let mut kept = Vec::new();
    let rows = std::mem::take(&mut set.measurements.observations);
    let places = places(&rows);
    for (index, (row, place)) in rows.iter().zip(&places).enumerate() {
        let point = places.binary_search(&(place + by)).ok().map(|at| &rows[at]);
        match point {
            Some(point) if left_out.contains(&point.pose) => {
                set.dropped.push((row.pose, format!("its point, of pose {}, is left out", point.pose)));
            }
            Some(point) => {
                kept.push(index);
                set.measurements.observations.push(Observation {
                    pose: row.pose,
                    command: row.command.clone(),
                    approach: row.approach.clone(),
                    payload: row.payload.clone(),
                    since_reversal: row.since_reversal.clone(),
                    ..point.clone()
                });
            }
            None => {
                let side = if by > 0 { "below" } else { "above" };
                set.dropped.push((row.pose, format!("there is no point {} rows {side} it", by.abs())));
            }
        }
    }
    kept
}

/// Positions of rows: by their numbers if these are consecutive except for dropped rows, else by their order.
fn places(rows: &[Observation]) -> Vec<i64> {
    let numbers: Vec<i64> = rows.iter().map(|row| i64::from(row.pose)).collect();
    let span = numbers.last().zip(numbers.first()).map_or(0, |(last, first)| last - first);
    let count = |count: usize| i64::try_from(count).unwrap_or(i64::MAX);
    let runs = numbers.windows(2).all(|pair| pair[0] < pair[1])
        && span < count(numbers.len() + numbers.len() / 4 + 2);
    if runs { numbers } else { (0..count(rows.len())).collect() }
}
