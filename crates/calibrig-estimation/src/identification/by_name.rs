//! Parameters that a user fixes or frees by name.

use thiserror::Error;

use super::parameters::candidate_parameters;
use super::{IdentificationOptions, Mode};
use calibrig_model::measurement::{Station, Target};
use calibrig_model::{CalibrationModel, FAMILIES, ParameterId, TermId};

/// A parameter that cannot be fixed or freed by its name.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum ByNameError {
    /// A station's place is one thing.
    #[error("{id} is a part of the tracker's place, which is fixed or free as a whole")]
    Frame {
        /// Which.
        id: ParameterId,
    },
    /// It is in both lists.
    #[error("{id} is to be fixed, and to be free")]
    Both {
        /// Which.
        id: ParameterId,
    },
    /// The robot, or the measurements, have no such parameter.
    #[error("{id} is not a parameter of this robot and its targets")]
    Unknown {
        /// Which.
        id: ParameterId,
    },
    /// No mode can have it.
    #[error("{id} can be fitted in none of the modes ({})", .modes.iter().map(|mode| mode.key()).collect::<Vec<_>>().join(", "))]
    NotFitted {
        /// Which.
        id: ParameterId,
        /// The modes that are run.
        modes: Vec<Mode>,
    },
}

impl ByNameError {
    /// What was expected, and what to do.
    pub fn help(&self) -> String {
        match self {
            Self::Frame { .. } => {
                "expected names of links, targets, compliances, masses, centres, the linkage or terms; for the tracker's place the choice \
                 is nests, free or fixed (--frame; frame in a scenario)"
                    .to_owned()
            }
            Self::Both { .. } => "expected every parameter in one of the two lists".to_owned(),
            Self::Unknown { .. } => format!("expected {}", ParameterId::EXAMPLES),
            Self::NotFitted { .. } => {
                "expected a mode that has it: compliances, masses and centres are in elasto_geometric and extended, the linkage and terms \
                 in extended; a centre needs its uncertainty as a prior"
                    .to_owned()
            }
        }
    }
}

/// Whether every parameter that `options` fix or free by name can be.
///
/// # Errors
///
/// The first that cannot.
pub fn check_named(
    model: &CalibrationModel,
    modes: &[Mode],
    options: &IdentificationOptions,
    stations: &[Station],
    targets: &[Target],
) -> Result<(), ByNameError> {
    for &id in options.fix.iter().chain(&options.free) {
        if matches!(id, ParameterId::Frame { .. }) {
            return Err(ByNameError::Frame { id });
        }
        if !is_of(model, targets.len(), id) {
            return Err(ByNameError::Unknown { id });
        }
        if options.fix.contains(&id) && options.free.contains(&id) {
            return Err(ByNameError::Both { id });
        }
    }
    for &id in &options.free {
        let has = |mode: &Mode| {
            let of_mode = IdentificationOptions { mode: *mode, ..options.clone() };
            // A mode that this robot cannot have is refused by the fit, with its reason.
            let known = candidate_parameters(model, &of_mode, stations, targets).unwrap_or_default();
            known.contains(&id)
        };
        let fitted: Vec<_> = modes.iter().copied().filter(|mode| *mode != Mode::WithoutCalibration).collect();
        if !fitted.iter().any(has) {
            return Err(ByNameError::NotFitted { id, modes: fitted });
        }
    }
    Ok(())
}

/// Whether the robot, or one of its targets, has such a parameter in some mode.
fn is_of(model: &CalibrationModel, targets: usize, id: ParameterId) -> bool {
    let bodies = model.statics.as_ref().map_or(0, |statics| statics.bodies.len());
    match id {
        ParameterId::Link { link, .. } => link < model.kinematics.joint_count(),
        ParameterId::Frame { .. } => false,
        ParameterId::Target { target, axis } => target < targets && axis < 3,
        ParameterId::Compliance(compliance) => model.compliances().contains(&compliance),
        ParameterId::Mass { link } | ParameterId::Centre { link, .. } => link < bodies,
        ParameterId::Linkage(length) => model.linkage_lengths().contains(&length),
        ParameterId::Term(term) => FAMILIES
            .iter()
            .any(|family| TermId::all_of(family.key(), model).is_some_and(|terms| terms.contains(&term))),
    }
}
