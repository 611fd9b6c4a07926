//! Errors for effects with invalid numbers.

use thiserror::Error;

use super::EffectKind;

/// An invalid effect.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum EffectError {
    /// Not one entry per actuator.
    #[error("{}: {found} entries for {expected} actuators: expected one per actuator", effect.key())]
    Length {
        /// Which.
        effect: EffectKind,
        /// Actuators.
        expected: usize,
        /// Entries.
        found: usize,
    },
    /// A number out of its range.
    #[error("{}: {quantity} of index {index} is {value}: expected {expected}", effect.key())]
    Value {
        /// Which.
        effect: EffectKind,
        /// Which field.
        quantity: &'static str,
        /// Of which joint or entry.
        index: usize,
        /// What it is.
        value: f64,
        /// What it should be.
        expected: &'static str,
    },
    /// A part that the robot does not have.
    #[error("{}: the robot has no {part}", effect.key())]
    NoSuchPart {
        /// Which.
        effect: EffectKind,
        /// The missing part.
        part: &'static str,
    },
    /// Load ranges that are inconsistent.
    #[error(
        "stiffening: {factors} stiffnesses and {limits} ends of load ranges of index {actuator}: expected at least 2 \
         stiffnesses and one end less"
    )]
    Ranges {
        /// Of which actuator.
        actuator: usize,
        /// Number of stiffnesses.
        factors: usize,
        /// Number of ends.
        limits: usize,
    },
    /// A gap between flanks that no load of the drive closes.
    #[error(
        "lost_motion: the gap of index {actuator} closes at a load of {closes_at} (N or N m), but this drive carries at most \
         {greatest:.3}: expected a closing load below that"
    )]
    NeverCloses {
        /// Of which actuator.
        actuator: usize,
        /// m or rad
        gap: f64,
        /// Load at which the gap is closed, N or N m.
        closes_at: f64,
        /// Greatest load of the drive, N or N m.
        greatest: f64,
    },
    /// A part that its drive would overheat.
    #[error(
        "thermal: drive {actuator} warms its part by {value:.1} K within {time:.0} s: expected at most {} K",
        super::MOST_RISE
    )]
    Overheated {
        /// Index of the drive.
        actuator: usize,
        /// Since the session began, s.
        time: f64,
        /// K
        value: f64,
    },
    /// The air leaves its range during the session.
    #[error(
        "thermal: the air temperature leaves {} to {} degC within {duration} s ({value:.1} degC): expected it to stay within",
        super::AMBIENT_RANGE[0], super::AMBIENT_RANGE[1]
    )]
    Temperature {
        /// Length of the session, s.
        duration: f64,
        /// Its extreme temperature, °C.
        value: f64,
    },
}

/// A range that a number must be in.
#[derive(Debug, Clone, Copy)]
pub(super) enum Range {
    Finite,
    NotNegative,
    Positive,
}

impl Range {
    fn holds(self, value: f64) -> bool {
        value.is_finite()
            && match self {
                Self::Finite => true,
                Self::NotNegative => value >= 0.0,
                Self::Positive => value > 0.0,
            }
    }

    fn words(self) -> &'static str {
        match self {
            Self::Finite => "a finite number",
            Self::NotNegative => "a finite number of zero or more",
            Self::Positive => "a finite number above zero",
        }
    }
}

/// Refuses a value outside `range`.
pub(super) fn check(
    effect: EffectKind,
    (quantity, index): (&'static str, usize),
    value: f64,
    range: Range,
) -> Result<(), EffectError> {
    if range.holds(value) {
        return Ok(());
    }
    Err(EffectError::Value { effect, quantity, index, value, expected: range.words() })
}

/// Refuses a list unless it has one value in `range` per actuator.
pub(super) fn check_all(
    effect: EffectKind,
    quantity: &'static str,
    values: &[f64],
    actuators: usize,
    range: Range,
) -> Result<(), EffectError> {
    check_length(effect, values.len(), actuators)?;
    values.iter().enumerate().try_for_each(|(index, &value)| check(effect, (quantity, index), value, range))
}

/// Refuses a list unless it has one entry per actuator.
pub(super) fn check_length(effect: EffectKind, found: usize, expected: usize) -> Result<(), EffectError> {
    if found == expected { Ok(()) } else { Err(EffectError::Length { effect, expected, found }) }
}
