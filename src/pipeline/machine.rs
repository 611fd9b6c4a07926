//! What stands for the machine in a simulation.

use nalgebra::Vector3;

use super::PipelineError;
use crate::elastostatics::{Deflection, ElasticChain};
use crate::model::{CalibrationModel, TermPlace};
use crate::plant::{AsBuilt, Plant, SettleOptions, SettledPose};

/// What stands for the machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PlantKind {
    /// The multibody simulation, which shares nothing with the identification.
    #[default]
    Rapier,
    /// The identification's own elastostatics with the real parameters: a matched model, for tests of the estimator alone.
    Analytic,
}

impl PlantKind {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Rapier, Self::Analytic];

    /// The key on the command line and in JSON.
    pub fn key(self) -> &'static str {
        match self {
            Self::Rapier => "rapier",
            Self::Analytic => "analytic",
        }
    }
}

/// A machine that can be brought to rest.
pub(super) enum Rest {
    Rapier(Box<Plant>),
    Analytic { chain: Box<ElasticChain>, target: Vector3<f64> },
}

impl Rest {
    pub(super) fn new(as_built: &AsBuilt, kind: PlantKind) -> Result<Self, PipelineError> {
        Ok(match kind {
            PlantKind::Rapier => Self::Rapier(Box::new(Plant::new(as_built, SettleOptions::default())?)),
            PlantKind::Analytic => {
                let model = CalibrationModel {
                    kinematics: as_built.kinematics.clone(),
                    actuators: as_built.actuators,
                    statics: Some(as_built.statics.clone()),
                    motor_turns: vec![None; as_built.kinematics.joint_count()],
                };
                Self::Analytic { chain: Box::new(ElasticChain::new(&model)), target: as_built.target }
            }
        })
    }

    /// The pose at rest at true actuator positions, with the frames of the links displaced.
    pub(super) fn settle(
        &mut self,
        command: &[f64],
        displacements: &[[f64; 6]],
    ) -> Result<SettledPose, PipelineError> {
        match self {
            Self::Rapier(plant) => Ok(plant.settle_displaced(command, displacements)?),
            Self::Analytic { chain, target } => {
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
                let settled = chain.settle(command, &corrections, Deflection::Equilibrium)?;
                Ok(SettledPose {
                    target: chain.target(target),
                    links: chain.link_frames().to_vec(),
                    deflection: (0..command.len()).map(|joint| chain.drive_deflection(joint)).collect(),
                    elastic: Vec::new(),
                    linkage: None,
                    rod_force: None,
                    residual: settled.residual,
                    closure: 0.0,
                    steps: u32::try_from(settled.iterations).unwrap_or(u32::MAX),
                })
            }
        }
    }
}
