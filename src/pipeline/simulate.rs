//! The session of a scenario, with what stands for its machine.

use super::machine::AnalyticMachine;
use super::{PipelineError, PlantKind, SessionListener, Simulation, counting};
use crate::scenario::Scenario;
use calibrig_plant::{Plant, SettleOptions};

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
            let mut machine = Plant::new(&scenario.as_built, SettleOptions::default())?;
            session.measure(&mut machine, seed, trial, listener)?
        }
        PlantKind::Analytic => {
            if scenario.as_built.effects.stiffening.is_some() {
                return Err(PipelineError::LinearDrives);
            }
            session.measure(&mut AnalyticMachine::new(&scenario.as_built)?, seed, trial, listener)?
        }
    })
}
