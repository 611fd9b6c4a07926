//! User-defined bounds on single parameters.

use serde::{Deserialize, Serialize};
use std::fmt;

use thiserror::Error;

use super::parameters::candidate_parameters;
use super::{FrameChoice, IdentificationOptions, Mode};
use calibrig_model::measurement::{Station, Target};
use calibrig_model::{CalibrationModel, ParameterId, Unit};

/// Bounds of a parameter, SI: of its deviation from the nominal, stated or predicted value, like the parameter itself.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ParameterBound {
    /// Which parameter.
    pub id: ParameterId,
    /// Lowest value; minus infinity if there is no lower limit.
    #[serde(with = "calibrig_model::float::scalar")]
    pub lower: f64,
    /// Highest value; infinity if there is no upper limit.
    #[serde(with = "calibrig_model::float::scalar")]
    pub upper: f64,
}

/// Why a bound cannot be applied.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum ParameterBoundError {
    /// A limit is NaN.
    #[error("a limit of {id} is not a number")]
    NotANumber {
        /// Parameter of the bound.
        id: ParameterId,
    },
    /// Neither limit is stated.
    #[error("the bound of {id} has no limit")]
    Open {
        /// Parameter of the bound.
        id: ParameterId,
    },
    /// The interval between the limits is empty or a single value.
    #[error("the bound of {id} ends at {}, which is not above its start at {}", shown(.id.unit(), *.upper), shown(.id.unit(), *.lower))]
    Empty {
        /// Parameter of the bound.
        id: ParameterId,
        /// Lower limit, SI.
        lower: f64,
        /// Upper limit, SI.
        upper: f64,
    },
    /// The lower limit of a compliance or mass is below the value at which it vanishes.
    #[error("the bound of {id} begins at {lower}")]
    BelowNone {
        /// Parameter of the bound.
        id: ParameterId,
        /// Lower limit.
        lower: f64,
    },
    /// The start of the search is outside the bound.
    #[error("the bound of {bound} excludes 0, the {} value, from which the search starts", origin(.bound.id))]
    ExcludesStart {
        /// The bound.
        bound: ParameterBound,
    },
    /// The parameter already has a bound.
    #[error("{id} has a second bound")]
    Twice {
        /// Parameter of the bound.
        id: ParameterId,
    },
    /// The reference of the tracker's place is only found by the fit.
    #[error("{id} is relative to the best fit of the nominal robot to the measurements")]
    NoReference {
        /// Parameter of the bound.
        id: ParameterId,
    },
    /// None of the modes fits the parameter.
    #[error("{id} is not fitted in any of the modes ({})", keys(.modes))]
    NotFitted {
        /// Parameter of the bound.
        id: ParameterId,
        /// The modes that are run.
        modes: Vec<Mode>,
        /// Parameters that the modes fit.
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
    /// Checks the limits, and that the start lies between them.
    ///
    /// # Errors
    ///
    /// [`ParameterBoundError`], with the variants that concern a single bound.
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

/// The lowest physically possible value of a parameter: compliances and masses are not below zero.
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

/// A value with its unit for people: mm, mrad, or a bare number.
pub(super) fn shown(unit: Unit, value: f64) -> String {
    let number = in_unit(unit, value);
    match unit {
        Unit::Metre => format!("{number} mm"),
        Unit::Radian => format!("{number} mrad"),
        Unit::One => number.to_string(),
    }
}

/// In mm, mrad or 1, to six digits, which hides the rounding of the conversion.
fn in_unit(unit: Unit, value: f64) -> f64 {
    let scaled = match unit {
        Unit::Metre | Unit::Radian => 1e3 * value,
        Unit::One => value,
    };
    format!("{scaled:.5e}").parse().unwrap_or(scaled)
}

/// A bound that is refused, with its index in the list.
#[derive(Debug, Clone, PartialEq, Error)]
#[error("{error}")]
pub struct RefusedBound {
    /// Index in the list.
    pub index: usize,
    /// Why.
    pub error: ParameterBoundError,
}

/// Checks that every bound of `options` can be applied, and belongs to a parameter of one of the `modes`.
///
/// # Errors
///
/// [`RefusedBound`], the first bound that cannot.
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
        // A mode that this robot does not support is refused by the fit, with its reason.
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

/// Lowest and highest value of every parameter, from physics and from the stated bounds.
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
