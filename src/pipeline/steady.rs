//! Readings corrected for the motion of their trackers, and certificates that stations share, in one place before anything is fitted: the same for
//! simulated, replayed and real sets.

use super::{PipelineError, SetOutcome};
use calibrig_model::measurement::{MeasurementSet, StationDrift, Steady, remove_drift};

/// Sets as if no tracker moved.
#[derive(Debug, Clone, PartialEq)]
pub struct SteadySets {
    /// What is fitted and evaluated.
    pub sets: Vec<SetOutcome>,
    /// What was measured; empty if that is the same.
    pub as_measured: Vec<SetOutcome>,
    /// What the rounds of nests say, one entry per station whose nests were measured more than once.
    pub drift: Vec<StationDrift>,
}

/// Removes the drift of trackers, as far as their nests show it ([`remove_drift`]), and makes certified places that several stations have seen count
/// once ([`MeasurementSet::share_certificates`]). Sets with the same stations are of one session, with one drift.
///
/// # Errors
///
/// Errors for inconsistent rounds of nests.
pub fn without_drift(sets: Vec<SetOutcome>) -> Result<SteadySets, PipelineError> {
    let mut freed: Vec<SetOutcome> = Vec::with_capacity(sets.len());
    let mut drift = Vec::new();
    let mut shared = false;
    for session in sets.chunk_by(|a, b| a.measurements.stations == b.measurements.stations) {
        let Some(first) = session.first() else { continue };
        let whole = MeasurementSet {
            observations: session.iter().flat_map(|set| set.measurements.observations.clone()).collect(),
            ..first.measurements.clone()
        };
        let Steady { mut measurements, stations } = remove_drift(&whole)?;
        shared |= measurements.share_certificates();
        drift.extend(stations);
        let mut observations = measurements.observations.into_iter();
        for set in session {
            let count = set.measurements.observations.len();
            let own = MeasurementSet {
                stations: measurements.stations.clone(),
                targets: set.measurements.targets.clone(),
                observations: observations.by_ref().take(count).collect(),
            };
            freed.push(SetOutcome { measurements: own, ..set.clone() });
        }
    }
    let as_measured = if drift.is_empty() && !shared { Vec::new() } else { sets };
    Ok(SteadySets { sets: freed, as_measured, drift })
}
