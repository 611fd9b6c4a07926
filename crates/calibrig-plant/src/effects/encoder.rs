//! Readings of the motors' encoders.

use super::error::{Range, check_all};
use super::{EffectError, EffectKind};

/// Encoders with a step and an offset. The servo brings the motor to where the reading is nearest to the command.
#[derive(Debug, Clone, PartialEq)]
pub struct Encoder {
    /// Step at the actuator, one entry per actuator, m or rad; zero for none.
    pub step: Vec<f64>,
    /// Position of the motor at reading zero, m or rad.
    pub offset: Vec<f64>,
}

impl Encoder {
    pub(super) fn check(&self, actuators: usize) -> Result<(), EffectError> {
        check_all(EffectKind::Encoder, "step", &self.step, actuators, Range::NotNegative)?;
        check_all(EffectKind::Encoder, "offset", &self.offset, actuators, Range::Finite)
    }

    /// Where the motor stands at a command, m or rad.
    pub fn motor(&self, actuator: usize, command: f64) -> f64 {
        let step = self.step[actuator];
        let read = if step > 0.0 { step * (command / step).round() } else { command };
        read + self.offset[actuator]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn the_motor_stands_on_a_step_at_most_half_a_step_away() {
        let encoder = Encoder { step: vec![5e-6], offset: vec![2e-4] };
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let (mut largest, mut sum) = (0.0_f64, 0.0);
        for _ in 0..10_000 {
            let command: f64 = rng.random_range(-2.0..2.0);
            let motor = encoder.motor(0, command);
            let error = motor - 2e-4 - command;
            let steps = (motor - 2e-4) / 5e-6;
            assert!((steps - steps.round()).abs() < 1e-9);
            largest = largest.max(error.abs());
            sum += error * error;
        }
        assert!(largest <= 2.5e-6 * (1.0 + 1e-9) && largest > 2.4e-6, "{largest}");
        // Uniform: variance step²/12 with a standard deviation of sqrt(4/(5 n)) of it, six of which are allowed.
        let variance = sum / 10_000.0;
        assert!((variance / (25e-12 / 12.0) - 1.0).abs() < 6.0 * (0.8_f64 / 10_000.0).sqrt(), "{variance}");
        let fine = Encoder { step: vec![0.0], offset: vec![0.0] };
        assert_eq!(fine.motor(0, 0.123_456), 0.123_456);
    }
}
