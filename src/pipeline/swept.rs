//! What the sweeps of an outcome's stations show, whether they placed them or not.

use super::Outcome;
use calibrig_estimation::circle_points::{SweepError, SweptStation, place_by_sweeps};

/// For every station that read sweeps: its index, and what they show, or why they do not place it.
pub fn swept_stations(outcome: &Outcome) -> Vec<(usize, Result<SweptStation, SweepError>)> {
    let Some(set) = outcome.sets.first().map(|set| &set.measurements) else { return Vec::new() };
    let swept = set.stations.iter().enumerate().filter(|(_, station)| !station.sweeps.is_empty());
    swept
        .map(|(index, _)| (index, place_by_sweeps(&outcome.model, set, index).map(|(_, swept)| swept)))
        .collect()
}
