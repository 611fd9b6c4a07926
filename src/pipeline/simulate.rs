//! The session of a scenario, with what stands for its machine.

use super::machine::AnalyticMachine;
use super::{PipelineError, PlantKind, SessionListener, Simulation, counting};
use crate::scenario::Scenario;
use calibrig_plant::{Plant, SettleOptions};

/// How the poses of a trial settle: those of the first are confirmed by rapier, which changes no bit of them.
pub(super) fn settle_options(trial: u32) -> SettleOptions {
    SettleOptions { confirm: trial == 0, ..SettleOptions::default() }
}

/// Simulates the session of `scenario`: a pure function of (scenario, seed, trial, plant).
///
/// `progress` is told the number of poses done and of all poses.
pub fn simulate(
    scenario: &Scenario,
    seed: u64,
    trial: u32,
    plant: PlantKind,
    progress: impl FnMut(u32, u32),
) -> Result<Simulation, PipelineError> {
    measure_session(scenario, seed, trial, plant, &mut counting(progress))
}

/// The same, told to `listener` while it goes on.
pub fn measure_session(
    scenario: &Scenario,
    seed: u64,
    trial: u32,
    plant: PlantKind,
    listener: &mut SessionListener<'_>,
) -> Result<Simulation, PipelineError> {
    let scenario = &*scenario.of_trial(seed, trial);
    let session = scenario.session();
    Ok(match plant {
        PlantKind::Rapier => {
            let mut machine = Plant::new(&scenario.as_built, settle_options(trial))?;
            session.measure(&mut machine, seed, trial, listener)?
        }
        PlantKind::Analytic => {
            session.measure(&mut AnalyticMachine::new(&scenario.as_built)?, seed, trial, listener)?
        }
    })
}
