//! Bounds on single parameters, as a user states them.

use serde::{Deserialize, Serialize};
use std::fmt;

use thiserror::Error;

use super::parameters::candidate_parameters;
use super::{FrameChoice, IdentificationOptions, Mode};
use calibrig_model::measurement::{Station, Target};
use calibrig_model::{CalibrationModel, ParameterId, Unit};

/// Limits of a parameter, SI: of its deviation from the nominal, stated or predicted value, as the parameter itself.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ParameterBound {
    /// Which.
    pub id: ParameterId,
    /// Lowest value; minus infinity where that end is open.
    #[serde(with = "calibrig_model::float::scalar")]
    pub lower: f64,
    /// Highest value; infinite where that end is open.
    #[serde(with = "calibrig_model::float::scalar")]
    pub upper: f64,
}

/// A bound that cannot be kept.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum ParameterBoundError {
    /// A limit that is NaN.
    #[error("a limit of {id} is not a number")]
    NotANumber {
        /// Whose.
        id: ParameterId,
    },
    /// Neither limit is stated.
    #[error("the bound of {id} has no limit")]
    Open {
        /// Whose.
        id: ParameterId,
    },
    /// No value, or a single one, lies between the limits.
    #[error("the bound of {id} ends at {}, which is not above its start at {}", shown(.id.unit(), *.upper), shown(.id.unit(), *.lower))]
    Empty {
        /// Whose.
        id: ParameterId,
        /// Lower limit, SI.
        lower: f64,
        /// Upper limit, SI.
        upper: f64,
    },
    /// A compliance or mass below none at all.
    #[error("the bound of {id} begins at {lower}")]
    BelowNone {
        /// Whose.
        id: ParameterId,
        /// Lower limit.
        lower: f64,
    },
    /// The search would begin outside.
    #[error("the bound of {bound} excludes 0, the {} value, from which the search starts", origin(.bound.id))]
    ExcludesStart {
        /// The bound.
        bound: ParameterBound,
    },
    /// There is one already.
    #[error("{id} has a second bound")]
    Twice {
        /// Whose.
        id: ParameterId,
    },
    /// The tracker's place counts from one that is found by the fit itself.
    #[error("{id} is relative to the best fit of the nominal robot to the measurements")]
    NoReference {
        /// Whose.
        id: ParameterId,
    },
    /// No mode has such a parameter.
    #[error("{id} is not fitted in any of the modes ({})", keys(.modes))]
    NotFitted {
        /// Whose.
        id: ParameterId,
        /// The modes that are run.
        modes: Vec<Mode>,
        /// Their parameters.
        known: Vec<ParameterId>,
    },
}

impl ParameterBoundError {
    /// What was expected, and what to do.
    pub fn help(&self) -> String {
        match self {
            Self::NotANumber { .. } => "expected finite numbers, or an open end".to_owned(),
            Self::Open { .. } => "expected a lower or an upper limit, or both".to_owned(),
            Self::Empty { .. } => {
                "expected an upper limit above the lower one; to keep a parameter at its nominal value, leave it out of the \
                 parameters"
                    .to_owned()
            }
            Self::BelowNone { .. } => {
                "expected -1 or more: -1 is no compliance or mass at all, 0 the predicted or stated value".to_owned()
            }
            Self::ExcludesStart { bound } => format!(
                "expected limits with 0 between them or on one of them: they limit the deviation from the {} value; if that \
                 value is known to be wrong, correct it in the file that states it, and bound the rest",
                origin(bound.id)
            ),
            Self::Twice { .. } => "expected one bound per parameter, with both limits in it".to_owned(),
            Self::NoReference { .. } => {
                "expected a bound of the robot's parameters: that place is not known beforehand, so no limits relative to it \
                 can be stated"
                    .to_owned()
            }
            Self::NotFitted { known, .. } => {
                let names: Vec<_> = known.iter().map(ToString::to_string).collect();
                format!("expected one of: {}", names.join(", "))
            }
        }
    }
}

fn keys(modes: &[Mode]) -> String {
    modes.iter().map(|mode| mode.key()).collect::<Vec<_>>().join(", ")
}

/// What a parameter is a deviation from.
fn origin(id: ParameterId) -> &'static str {
    match id {
        ParameterId::Link { .. } | ParameterId::Linkage(_) | ParameterId::Term(_) => "nominal",
        ParameterId::Frame { .. } => "registered",
        ParameterId::Instrument { .. } => "ideal",
        ParameterId::Drift { .. } => "standing",
        ParameterId::Target { .. }
        | ParameterId::Orientation { .. }
        | ParameterId::Mass { .. }
        | ParameterId::Centre { .. } => "stated",
        ParameterId::Compliance(_) => "predicted",
    }
}

impl ParameterBound {
    /// Whether the limits, and the start between them, can be kept.
    ///
    /// # Errors
    ///
    /// [`ParameterBoundError`], of those that one bound alone can have.
    pub fn check(&self) -> Result<(), ParameterBoundError> {
        let &Self { id, lower, upper } = self;
        if lower.is_nan() || upper.is_nan() {
            return Err(ParameterBoundError::NotANumber { id });
        }
        if lower == f64::NEG_INFINITY && upper == f64::INFINITY {
            return Err(ParameterBoundError::Open { id });
        }
        if lower >= upper {
            return Err(ParameterBoundError::Empty { id, lower, upper });
        }
        if lower.is_finite() && lower < lowest(id) {
            return Err(ParameterBoundError::BelowNone { id, lower });
        }
        if lower > 0.0 || upper < 0.0 {
            return Err(ParameterBoundError::ExcludesStart { bound: *self });
        }
        Ok(())
    }
}

/// The lowest value that a parameter can have by its nature: no compliance and no mass is below zero.
pub(super) fn lowest(id: ParameterId) -> f64 {
    match id {
        ParameterId::Compliance(_) | ParameterId::Mass { .. } => -1.0,
        _ => f64::NEG_INFINITY,
    }
}

/// As in `delta_a4 -5 to 5 mm` or `compliance_drive2 at least 0`.
impl fmt::Display for ParameterBound {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let unit = self.id.unit();
        write!(f, "{} ", self.id)?;
        match (self.lower.is_finite(), self.upper.is_finite()) {
            (true, true) => write!(f, "{} to {}", in_unit(unit, self.lower), shown(unit, self.upper)),
            (true, false) => write!(f, "at least {}", shown(unit, self.lower)),
            (false, true) => write!(f, "at most {}", shown(unit, self.upper)),
            (false, false) => f.write_str("free"),
        }
    }
}

/// A value with its unit, as people read it: mm, mrad, or a bare number.
pub(super) fn shown(unit: Unit, value: f64) -> String {
    let number = in_unit(unit, value);
    match unit {
        Unit::Metre => format!("{number} mm"),
        Unit::Radian => format!("{number} mrad"),
        Unit::One => number.to_string(),
    }
}

/// In mm, mrad or 1, to six digits: what conversion adds to a stated number is not shown.
fn in_unit(unit: Unit, value: f64) -> f64 {
    let scaled = match unit {
        Unit::Metre | Unit::Radian => 1e3 * value,
        Unit::One => value,
    };
    format!("{scaled:.5e}").parse().unwrap_or(scaled)
}

/// A bound of a list that is refused.
#[derive(Debug, Clone, PartialEq, Error)]
#[error("{error}")]
pub struct RefusedBound {
    /// Its place in the list.
    pub index: usize,
    /// Why.
    pub error: ParameterBoundError,
}

/// Whether every bound of `options` can be kept and is on a parameter of one of the `modes`.
///
/// # Errors
///
/// The first bound that is not.
pub fn check_bounds(
    model: &CalibrationModel,
    modes: &[Mode],
    options: &IdentificationOptions,
    stations: &[Station],
    targets: &[Target],
) -> Result<(), RefusedBound> {
    let bounds = &options.bounds;
    if bounds.is_empty() {
        return Ok(());
    }
    let modes: Vec<_> = modes.iter().copied().filter(|mode| *mode != Mode::WithoutCalibration).collect();
    let mut known = Vec::new();
    for &mode in &modes {
        let of_mode = IdentificationOptions { mode, ..options.clone() };
        // A mode that this robot cannot have is refused by the fit, with its reason.
        for id in candidate_parameters(model, &of_mode, stations, targets).unwrap_or_default() {
            if !known.contains(&id) {
                known.push(id);
            }
        }
    }
    for (index, bound) in bounds.iter().enumerate() {
        let id = bound.id;
        let refused = |error| Err(RefusedBound { index, error });
        if let Err(error) = bound.check() {
            return refused(error);
        }
        if bounds[..index].iter().any(|other| other.id == id) {
            return refused(ParameterBoundError::Twice { id });
        }
        if let ParameterId::Frame { station, .. } = id
            && let Some(station) = stations.get(station)
            && options.frame.of(station) == FrameChoice::Free
        {
            return refused(ParameterBoundError::NoReference { id });
        }
        if !known.contains(&id) {
            return refused(ParameterBoundError::NotFitted { id, modes, known });
        }
    }
    Ok(())
}

/// Lowest and highest value of every parameter: by its nature, and as stated.
pub(super) fn limits(parameters: &[ParameterId], stated: &[ParameterBound]) -> (Vec<f64>, Vec<f64>) {
    let of = |id: &ParameterId| {
        let bounds = stated.iter().filter(|bound| bound.id == *id);
        bounds.fold((lowest(*id), f64::INFINITY), |(lower, upper), bound| {
            (bound.lower.max(lower), bound.upper.min(upper))
        })
    };
    parameters.iter().map(of).unzip()
}

#[cfg(test)]
mod tests;
