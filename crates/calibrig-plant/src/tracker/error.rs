//! What a tracker refuses.

use thiserror::Error;

/// A point that the tracker cannot measure, or an invalid tracker.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[non_exhaustive]
pub enum TrackerError {
    /// Too close or too far.
    #[error("range {range:.3} m is outside the tracker's {least} to {most} m")]
    Range {
        /// m
        range: f64,
        /// m
        least: f64,
        /// m
        most: f64,
    },
    /// The head or the telescope does not turn as far.
    #[error(
        "{angle} {:.2} deg is outside the tracker's range of {:.2} to {:.2} deg",
        value.to_degrees(), least.to_degrees(), most.to_degrees()
    )]
    Angle {
        /// `azimuth` or `elevation`.
        angle: &'static str,
        /// rad
        value: f64,
        /// rad
        least: f64,
        /// rad
        most: f64,
    },
    /// So close to the standing axis that a beam with an offset cannot be turned there.
    #[error(
        "a point {distance:.6} m from the standing axis is out of reach: the beam misses it at any azimuth"
    )]
    BesideTheAxis {
        /// Of the point from the axis, m.
        distance: f64,
    },
    /// An instrument whose random errors have no standard deviation.
    #[error(
        "the instrument's standard deviation of the {quantity} is {value}: expected a finite number of zero or more"
    )]
    Instrument {
        /// `range` or `angles`.
        quantity: &'static str,
        /// m or rad
        value: f64,
    },
    /// An invalid figure of the instrument or of its session.
    #[error("the instrument's {quantity} is {value}: expected {expected}")]
    Figure {
        /// Which, with its unit.
        quantity: &'static str,
        /// In that unit.
        value: f64,
        /// What was expected.
        expected: &'static str,
    },
    /// An instrument whose errors exceed its own permissible ones.
    #[error(
        "none of {drawn} instruments drawn with these figures passes its own acceptance test: expected a smaller systematic \
         or random fraction"
    )]
    NeverAccepted {
        /// How many were drawn.
        drawn: u32,
    },
}
