//! Transmission errors that repeat with the turns of the motor.

use std::f64::consts::TAU;

use super::error::{Range, check, check_length};
use super::{EffectError, EffectKind};

/// The transmission error of one actuator, once and twice per motor turn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Harmonic {
    /// Motor turns per m or rad of the actuator.
    pub turns: f64,
    /// Amplitude once and twice per turn, m or rad.
    pub amplitude: [f64; 2],
    /// Phase once and twice per turn at actuator position zero, rad.
    pub phase: [f64; 2],
}

impl Harmonic {
    /// Error of the actuator at its position `motor` (m or rad), m or rad.
    pub fn error(&self, motor: f64) -> f64 {
        let turned = TAU * self.turns * motor;
        self.amplitude[0] * (turned + self.phase[0]).sin()
            + self.amplitude[1] * (2.0 * turned + self.phase[1]).sin()
    }
}

/// Transmission harmonics of every actuator; `None` for none.
#[derive(Debug, Clone, PartialEq)]
pub struct Harmonics {
    /// One entry per actuator.
    pub actuators: Vec<Option<Harmonic>>,
}

impl Harmonics {
    pub(super) fn check(&self, actuators: usize) -> Result<(), EffectError> {
        let kind = EffectKind::Harmonics;
        check_length(kind, self.actuators.len(), actuators)?;
        for (index, harmonic) in self.actuators.iter().enumerate() {
            let Some(harmonic) = harmonic else { continue };
            check(kind, ("motor turns", index), harmonic.turns, Range::Positive)?;
            for order in 0..2 {
                check(kind, ("amplitude", index), harmonic.amplitude[order], Range::NotNegative)?;
                check(kind, ("phase", index), harmonic.phase[order], Range::Finite)?;
            }
        }
        Ok(())
    }

    pub(super) fn error(&self, actuator: usize, motor: f64) -> f64 {
        self.actuators[actuator].map_or(0.0, |harmonic| harmonic.error(motor))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn the_error_repeats_once_and_twice_a_turn() {
        // A quarter turn is 1/400 rad.
        let once = Harmonic { turns: 100.0, amplitude: [2e-4, 0.0], phase: [0.0; 2] };
        for (quarter, expected) in [(0.0, 0.0), (1.0, 2e-4), (2.0, 0.0), (3.0, -2e-4), (5.0, 2e-4)] {
            assert!((once.error(quarter / 400.0) - expected).abs() < 1e-17 + 1e-13 * 2e-4 * 8.0, "{quarter}");
        }
        let twice = Harmonic { turns: 100.0, amplitude: [0.0, 3e-4], phase: [0.0, FRAC_PI_2] };
        for (quarter, expected) in [(0.0, 3e-4), (1.0, -3e-4), (2.0, 3e-4), (-1.0, -3e-4)] {
            assert!((twice.error(quarter / 400.0) - expected).abs() < 1e-15, "{quarter}");
        }
    }
}
