//! Parameters that a user fixes or frees by name.

use thiserror::Error;

use super::build::build;
use super::identify::check;
use super::instrument::parameters_of;
use super::parameters::candidate_parameters;
use super::{IdentificationOptions, IdentifyError, LeftOutReason, Mode};
use calibrig_model::measurement::{MeasurementSet, Station, Target};
use calibrig_model::{CalibrationModel, FAMILIES, ParameterId, TermId};

/// Why a parameter cannot be fixed or freed by its name.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum ByNameError {
    /// It is part of a station's place, which is fixed or free as a whole.
    #[error("{id} is a part of the tracker's place, which is fixed or free as a whole")]
    Frame {
        /// Which parameter.
        id: ParameterId,
    },
    /// The parameter is in both lists.
    #[error("{id} is listed both as fixed and as free")]
    Both {
        /// Which parameter.
        id: ParameterId,
    },
    /// Neither the robot nor the measurements have this parameter.
    #[error("{id} is not a parameter of this robot and its targets")]
    Unknown {
        /// Which parameter.
        id: ParameterId,
    },
    /// None of the modes can fit the parameter.
    #[error("{id} cannot be fitted in any of the modes ({})", .modes.iter().map(|mode| mode.key()).collect::<Vec<_>>().join(", "))]
    NotFitted {
        /// Which parameter.
        id: ParameterId,
        /// The modes that are run.
        modes: Vec<Mode>,
    },
}

impl ByNameError {
    /// Which parameter.
    pub fn id(&self) -> ParameterId {
        match self {
            Self::Frame { id } | Self::Both { id } | Self::Unknown { id } | Self::NotFitted { id, .. } => *id,
        }
    }

    /// What was expected, and what to do.
    pub fn help(&self) -> String {
        match self {
            Self::Frame { .. } => {
                "expected names of links, targets, compliances, masses, centres, the linkage, terms or errors of the instrument; for the tracker's place the choice \
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

/// Checks that every parameter that `options` fix or free by name can be fixed or freed.
///
/// # Errors
///
/// [`ByNameError`] of the first parameter that cannot.
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
        if !is_of(model, stations, targets, id) {
            return Err(ByNameError::Unknown { id });
        }
        if options.fix.contains(&id) && options.free.contains(&id) {
            return Err(ByNameError::Both { id });
        }
    }
    for &id in &options.free {
        let has = |mode: &Mode| {
            let of_mode = IdentificationOptions { mode: *mode, ..options.clone() };
            // A mode that this robot does not support is refused by the fit, with its reason.
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

/// A parameter that a mode can have.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ListedParameter {
    /// Which parameter.
    pub id: ParameterId,
    /// How the parameter is treated.
    pub state: ParameterState,
}

/// How a parameter is treated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ParameterState {
    /// It is fitted.
    Fitted {
        /// Standard deviation of its own zero-mean prior, SI; `None` for a frame, whose prior comes from its nests.
        prior: Option<f64>,
        /// Whether it has any prior.
        has_prior: bool,
    },
    /// It could be fitted, but is not.
    LeftOut(LeftOutReason),
    /// The options do not choose it.
    NotChosen,
}

/// Every parameter of the robot that the mode of `options` can have, and how it is treated when the fit to `set` starts.
///
/// # Errors
///
/// As [`identify`](super::identify()).
pub fn list_parameters(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
) -> Result<Vec<ListedParameter>, IdentifyError> {
    check(model, set)?;
    options.check()?;
    if options.mode.needs_statics() && model.statics.is_none() {
        return Err(IdentifyError::NoStatics { mode: options.mode });
    }
    let built = build(model, set, options)?;
    let priors = &built.problem.priors;
    let in_block = |column: usize| priors.iter().any(|prior| prior.columns.contains(&column));
    let state = |id: ParameterId| {
        if let Some(column) = built.problem.parameters.iter().position(|own| *own == id) {
            let prior = built.sigmas[column].or_else(|| built.problem.stated_sigma(column));
            return ParameterState::Fitted { prior, has_prior: prior.is_some() || in_block(column) };
        }
        let left = built.left_out.iter().find(|left| left.id == id);
        left.map_or(ParameterState::NotChosen, |left| ParameterState::LeftOut(left.reason))
    };
    let ids = all_of(model, options.mode, &set.stations, &set.targets);
    Ok(ids.into_iter().map(|id| ListedParameter { id, state: state(id) }).collect())
}

/// Every parameter that a mode can have for a robot, its stations and targets.
fn all_of(
    model: &CalibrationModel,
    mode: Mode,
    stations: &[Station],
    targets: &[Target],
) -> Vec<ParameterId> {
    let bodies = model.statics.as_ref().map_or(0, |statics| statics.bodies.len());
    let mut ids = ParameterId::all_of_links(model.kinematics.joint_count());
    ids.extend((0..stations.len()).flat_map(ParameterId::all_of_frame));
    ids.extend((0..targets.len()).flat_map(ParameterId::all_of_target));
    let turned = targets.iter().enumerate().filter(|(_, target)| target.orientation.is_some());
    ids.extend(turned.flat_map(|(target, _)| ParameterId::all_of_orientation(target)));
    ids.extend(model.compliances().into_iter().map(ParameterId::Compliance));
    ids.extend((0..bodies).map(|link| ParameterId::Mass { link }));
    ids.extend((0..bodies).flat_map(|link| (0..3).map(move |axis| ParameterId::Centre { link, axis })));
    ids.extend(model.linkage_terms().into_iter().map(ParameterId::Linkage));
    let terms = FAMILIES.iter().filter_map(|family| TermId::all_of(family.key(), model));
    ids.extend(terms.flatten().map(ParameterId::Term));
    ids.extend(parameters_of(stations));
    ids.retain(|id| mode.can_fit(*id));
    ids
}

/// Whether the robot, one of its targets or an instrument has this parameter in some mode.
fn is_of(model: &CalibrationModel, stations: &[Station], targets: &[Target], id: ParameterId) -> bool {
    all_of(model, Mode::Extended, stations, targets).contains(&id)
}
