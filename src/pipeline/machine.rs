//! The model of the machine in a simulation.

use nalgebra::Vector3;

use super::PipelineError;
use calibrig_estimation::elastostatics::{Deflection, ElasticChain, ElasticError};
use calibrig_model::{CalibrationModel, Payload, TermPlace};
use calibrig_plant::effects::EffectKind;
use calibrig_plant::session::Machine;
use calibrig_plant::{AsBuilt, SettledPose};

/// The machine by the identification's own elastostatics.
pub(super) struct AnalyticMachine {
    chain: ElasticChain,
    target: Vector3<f64>,
}

/// Refuses what the analytic machine does not support.
///
/// # Errors
///
/// [`PipelineError::BeyondAnalytic`].
pub fn check_analytic(as_built: &AsBuilt) -> Result<(), PipelineError> {
    let beyond = [EffectKind::Stiffening, EffectKind::Foundation, EffectKind::Hoses];
    let found = beyond.into_iter().find(|kind| as_built.effects.has(*kind));
    found.map_or(Ok(()), |effect| Err(PipelineError::BeyondAnalytic { effect }))
}

impl AnalyticMachine {
    pub(super) fn new(as_built: &AsBuilt) -> Result<Self, PipelineError> {
        check_analytic(as_built)?;
        let model = CalibrationModel {
            kinematics: as_built.kinematics.clone(),
            actuators: as_built.actuators.clone(),
            statics: Some(as_built.statics.clone()),
            motor_turns: vec![None; as_built.kinematics.joint_count()],
            spans: Vec::new(),
        };
        let chain = ElasticChain::new(&model).map_err(ElasticError::from)?;
        Ok(Self { chain, target: as_built.target })
    }
}

impl Machine for AnalyticMachine {
    type Error = ElasticError;

    fn settle(&mut self, motors: &[f64], displacements: &[[f64; 6]]) -> Result<SettledPose, ElasticError> {
        let corrections: Vec<(TermPlace, f64)> = displacements
            .iter()
            .enumerate()
            .flat_map(|(joint, shift)| {
                shift
                    .iter()
                    .enumerate()
                    .map(move |(component, value)| (TermPlace::Frame { joint, component }, *value))
            })
            .filter(|(_, value)| *value != 0.0)
            .collect();
        let settled = self.chain.settle(motors, &corrections, Deflection::Equilibrium)?;
        Ok(SettledPose {
            target: self.chain.target(&self.target),
            links: self.chain.link_frames().to_vec(),
            deflection: (0..motors.len()).filter_map(|joint| self.chain.drive_deflection(joint)).collect(),
            elastic: Vec::new(),
            linkage: None,
            rod_force: None,
            residual: settled.residual,
            closure: 0.0,
            steps: u32::try_from(settled.iterations).unwrap_or(u32::MAX),
        })
    }

    fn carry(&mut self, payload: Option<&Payload>) -> Result<(), ElasticError> {
        Ok(self.chain.set_payload(payload)?)
    }
}
