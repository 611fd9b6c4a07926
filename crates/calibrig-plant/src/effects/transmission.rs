//! Transmission errors that repeat with the output side of a drive, not with its motor: meshing gears, the pins of a cycloid, the lead of a
//! ball screw.

use std::f64::consts::TAU;

use super::error::{Range, check, check_length};
use super::{EffectError, EffectKind};

/// One wave of the transmission error of one actuator. Its period need not divide a turn of motor or output.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TransmissionWave {
    /// Periods per m or rad of the actuator.
    pub cycles: f64,
    /// Amplitude of the unloaded drive, m or rad.
    pub amplitude: f64,
    /// Growth of the amplitude with the size of the drive's load: m/N or rad/(N m).
    pub per_load: f64,
    /// Phase at actuator position zero, rad.
    pub phase: f64,
}

impl TransmissionWave {
    /// Error of the actuator at its position `motor` (m or rad) under `load` (N or N m), m or rad.
    pub fn error(&self, motor: f64, load: f64) -> f64 {
        (self.amplitude + self.per_load * load.abs()) * (TAU * self.cycles * motor + self.phase).sin()
    }
}

/// The waves of every actuator.
#[derive(Debug, Clone, PartialEq)]
pub struct Transmission {
    /// One entry per actuator.
    pub actuators: Vec<Vec<TransmissionWave>>,
}

impl Transmission {
    pub(super) fn check(&self, actuators: usize) -> Result<(), EffectError> {
        let kind = EffectKind::Transmission;
        check_length(kind, self.actuators.len(), actuators)?;
        for (index, waves) in self.actuators.iter().enumerate() {
            for wave in waves {
                check(kind, ("cycles", index), wave.cycles, Range::Positive)?;
                check(kind, ("amplitude", index), wave.amplitude, Range::NotNegative)?;
                check(kind, ("amplitude per load", index), wave.per_load, Range::NotNegative)?;
                check(kind, ("phase", index), wave.phase, Range::Finite)?;
            }
        }
        Ok(())
    }

    /// Whether the loads of the drives matter.
    pub(super) fn needs_load(&self) -> bool {
        self.actuators.iter().flatten().any(|wave| wave.per_load > 0.0)
    }

    pub(super) fn error(&self, actuator: usize, motor: f64, load: f64) -> f64 {
        self.actuators[actuator].iter().map(|wave| wave.error(motor, load)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_screw_of_20_millimetres_lead_repeats_every_20_millimetres() {
        let wave = TransmissionWave { cycles: 50.0, amplitude: 3e-5, per_load: 0.0, phase: 0.0 };
        for (position, expected) in [(0.0, 0.0), (0.005, 3e-5), (0.015, -3e-5), (1.005, 3e-5)] {
            assert!((wave.error(position, 1e4) - expected).abs() < 1e-16, "{position}");
        }
    }

    #[test]
    fn the_amplitude_grows_with_the_load_whichever_its_sign() {
        // 13.5 periods a turn, the third quarter of the first is at a 18th of a turn: 2e-5 and 1e-8 · 3000.
        let cycles = 13.5 / TAU;
        let wave = TransmissionWave { cycles, amplitude: 2e-5, per_load: 1e-8, phase: 0.0 };
        for load in [3000.0, -3000.0] {
            assert!((wave.error(TAU / 18.0, load) + 5e-5).abs() < 1e-18, "{load}");
        }
        let all = Transmission { actuators: vec![vec![wave, wave], Vec::new()] };
        assert!((all.error(0, TAU / 18.0, 0.0) + 4e-5).abs() < 1e-18);
        assert_eq!(all.error(1, 0.3, 3000.0), 0.0);
        assert!(all.needs_load());
    }
}
