//! A gear ratio or a rail's pitch that differs from the drawing.

use super::error::{Range, check_all};
use super::{EffectError, EffectKind};

/// Relative errors of the transmissions.
#[derive(Debug, Clone, PartialEq)]
pub struct Ratio {
    /// One entry per actuator: the machine moves by (1 + this) times the encoder's reading, counted from position zero.
    pub relative: Vec<f64>,
}

impl Ratio {
    pub(super) fn check(&self, actuators: usize) -> Result<(), EffectError> {
        check_all(EffectKind::Ratio, "relative error", &self.relative, actuators, Range::Finite)
    }

    /// Error of the actuator at its position `motor`, m or rad.
    pub(super) fn error(&self, actuator: usize, motor: f64) -> f64 {
        self.relative[actuator] * motor
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pitch_error_of_50_ppm_is_a_tenth_of_a_millimetre_at_two_metres() {
        let ratio = Ratio { relative: vec![50e-6, 0.0] };
        assert!((ratio.error(0, 2.0) - 1e-4).abs() < 1e-19);
        assert!((ratio.error(0, -1.0) + 5e-5).abs() < 1e-19);
        assert_eq!(ratio.error(1, 2.0), 0.0);
    }
}
