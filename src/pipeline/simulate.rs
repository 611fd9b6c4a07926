//! The session of a scenario, with a choice of the machine's model.

use super::machine::AnalyticMachine;
use super::{PipelineError, PlantKind, SessionListener, Simulation, counting};
use crate::scenario::Scenario;
use calibrig_estimation::identification::FrameChoice;
use calibrig_plant::session::{LEAST_PLACES, PlannedSweep, SessionPlan};
use calibrig_plant::{Plant, SettleOptions};

/// How the poses of a trial settle: those of the first are confirmed by rapier, which changes no bit of them.
pub(super) fn settle_options(trial: u32) -> SettleOptions {
    SettleOptions { confirm: trial == 0, ..SettleOptions::default() }
}

/// Simulates the session of `scenario`: a pure function of (scenario, seed, trial, plant).
///
/// `progress` receives the number of poses done and of all poses.
pub fn simulate(
    scenario: &Scenario,
    seed: u64,
    trial: u32,
    plant: PlantKind,
    progress: impl FnMut(u32, u32),
) -> Result<Simulation, PipelineError> {
    measure_session(scenario, seed, trial, plant, &mut counting(progress))
}

/// The same, reported to `listener` while it goes on.
pub fn measure_session(
    scenario: &Scenario,
    seed: u64,
    trial: u32,
    plant: PlantKind,
    listener: &mut SessionListener<'_>,
) -> Result<Simulation, PipelineError> {
    let scenario = &*scenario.of_trial(seed, trial);
    let session = scenario.session();
    let simulation = match plant {
        PlantKind::Rapier => {
            let mut machine = Plant::new(&scenario.as_built, settle_options(trial))?;
            session.measure(&mut machine, seed, trial, listener)?
        }
        PlantKind::Analytic => {
            session.measure(&mut AnalyticMachine::new(&scenario.as_built)?, seed, trial, listener)?
        }
    };
    if scenario.options.frame == FrameChoice::Sweeps {
        check_sweeps(&scenario.plan, &simulation)?;
    }
    Ok(simulation)
}

/// Refuses stations that see too little of the sweeps that are to place them, with the reason.
fn check_sweeps(plan: &SessionPlan, simulation: &Simulation) -> Result<(), PipelineError> {
    let Some(set) = simulation.sets.first() else { return Ok(()) };
    for (index, station) in set.measurements.stations.iter().enumerate() {
        let mut places = 0;
        let read = |sweep: &PlannedSweep| {
            let own = places..places + sweep.places;
            places = own.end;
            station.sweeps.iter().filter(|reading| own.contains(&reading.pose)).count()
        };
        let read: Vec<usize> = plan.sweeps.iter().map(read).collect();
        let enough = read.iter().filter(|count| **count >= LEAST_PLACES as usize).count();
        let missing = simulation.sweeps_missing.iter().find(|missing| missing.station == index);
        if let (true, Some(missing)) = (enough < 2, missing) {
            return Err(PipelineError::UnseenSweeps {
                station: format!("station {}", station.name),
                counts: [read.iter().sum(), places as usize, missing.pose as usize + 1],
                why: missing.why.clone(),
            });
        }
    }
    Ok(())
}
