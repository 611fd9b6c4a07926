//! What a diagnosis can ask for that no column map says: rows that are paired otherwise, or left out.

use clap::CommandFactory;
use clap::error::ErrorKind;

use super::Cli;
use crate::pipeline::{SetKind, SetOutcome};
use calibrig_files::Places;
use calibrig_model::measurement::Observation;

/// How rows are taken otherwise than they stand in the file.
#[derive(Debug, Clone, Default, clap::Args)]
pub(super) struct RereadArgs {
    /// The joints of a row belong to the point so many rows below; above where it is negative
    #[arg(long, value_name = "ROWS", allow_negative_numbers = true, value_parser = clap::value_parser!(i32).range(-1_000_000..=1_000_000))]
    shift_points: Option<i32>,
    /// Poses of --measurements whose points are left out, by their numbers (rows where they are not numbered), such as 5,14
    #[arg(long, value_name = "POSE,..", value_delimiter = ',')]
    leave_out: Vec<u32>,
}

impl RereadArgs {
    /// Applies it to what was read; what is lost by it is dropped with the reason. A pose that was not measured is a wrong use of the command
    /// line.
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
            let by = self.shift_points.unwrap_or(0) as isize;
            if by != 0 || !left_out.is_empty() {
                *places = places.select(paired(set, by, left_out));
            }
        }
    }
}

/// Pairs commands with the points so many rows below, without points of the poses that are left out; the rows whose commands are kept.
fn paired(set: &mut SetOutcome, by: isize, left_out: &[u32]) -> Vec<usize> {
    let mut kept = Vec::new();
    let rows = std::mem::take(&mut set.measurements.observations);
    for (index, row) in rows.iter().enumerate() {
        let point = index.checked_add_signed(by).and_then(|at| rows.get(at));
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
