//! Links that grow with their temperature, which follows that of the air.

use std::f64::consts::TAU;

use super::error::{Range, check};
use super::{EffectError, EffectKind};

/// Temperatures of the air at which a robot is measured, °C.
pub const AMBIENT_RANGE: [f64; 2] = [-20.0, 60.0];

/// Temperature of the air against time: a start, a ramp and a wave.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ambient {
    /// Without the wave at time zero, °C.
    pub start: f64,
    /// K/s
    pub drift: f64,
    /// Amplitude of the wave, K.
    pub swing: f64,
    /// Period of the wave, s.
    pub period: f64,
    /// Phase of the wave at time zero, rad.
    pub phase: f64,
}

impl Ambient {
    /// °C, at `time` s.
    pub fn at(&self, time: f64) -> f64 {
        self.start + self.drift * time + self.swing * (TAU * time / self.period + self.phase).sin()
    }

    /// Temperature at `time` s of a body that follows the air with a time constant of `lag` s, and at time zero is as warm as the air, °C:
    /// the solution of `lag dT/dt = T_air - T`.
    pub fn followed(&self, lag: f64, time: f64) -> f64 {
        if lag == 0.0 {
            return self.at(time);
        }
        let pulsation = TAU / self.period;
        let (turned, delayed) = (pulsation * lag, 1.0 + (pulsation * lag).powi(2));
        let wave = |time: f64| {
            let (sin, cos) = (pulsation * time + self.phase).sin_cos();
            self.swing * (sin - turned * cos) / delayed
        };
        let settled = |time: f64| self.start + self.drift * (time - lag) + wave(time);
        settled(time) + (self.at(0.0) - settled(0.0)) * (-time / lag).exp()
    }
}

/// What of the structure grows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GrowingPart {
    /// A link: everything behind its frame is carried along x, y or z (0..3) of it.
    Link {
        /// Index of the joint.
        joint: usize,
        /// 0..3
        axis: usize,
    },
    /// The coupler rod of the elbow's four-bar, whose length is the robot's.
    Rod,
}

/// The growth of one part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Growth {
    /// Which.
    pub part: GrowingPart,
    /// Its length, m, below zero where it runs against the axis; of no meaning for the rod.
    pub length: f64,
    /// Whether its joint's position adds to the length, as a telescope's.
    pub with_travel: bool,
    /// Relative growth per kelvin.
    pub expansion: f64,
    /// Time constant with which it follows the air, s.
    pub lag: f64,
}

/// Thermal growth against the time of the session.
#[derive(Debug, Clone, PartialEq)]
pub struct Thermal {
    /// The air, as its sensor tells.
    pub ambient: Ambient,
    /// At which the links have their as-built lengths, °C.
    pub reference: f64,
    /// What grows.
    pub growths: Vec<Growth>,
}

impl Thermal {
    pub(super) fn check(&self, actuators: usize, has_rod: bool) -> Result<(), EffectError> {
        let kind = EffectKind::Thermal;
        for (quantity, value, range) in [
            ("start", self.ambient.start, Range::Finite),
            ("drift", self.ambient.drift, Range::Finite),
            ("swing", self.ambient.swing, Range::NotNegative),
            ("period", self.ambient.period, Range::Positive),
            ("phase", self.ambient.phase, Range::Finite),
            ("reference", self.reference, Range::Finite),
        ] {
            check(kind, (quantity, 0), value, range)?;
        }
        for (index, growth) in self.growths.iter().enumerate() {
            check(kind, ("length", index), growth.length, Range::Finite)?;
            check(kind, ("expansion", index), growth.expansion, Range::NotNegative)?;
            check(kind, ("lag", index), growth.lag, Range::NotNegative)?;
            match growth.part {
                GrowingPart::Link { joint, axis } if joint >= actuators || axis >= 3 => {
                    return Err(EffectError::NoSuchPart { effect: kind, part: "such axis of a link" });
                }
                GrowingPart::Rod if !has_rod => {
                    return Err(EffectError::NoSuchPart { effect: kind, part: "coupler rod" });
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Refuses a session of `duration` s in which the air leaves [`AMBIENT_RANGE`].
    pub fn check_session(&self, duration: f64) -> Result<(), EffectError> {
        let air = self.ambient;
        for middle in [air.start, air.start + air.drift * duration] {
            for value in [middle - air.swing, middle + air.swing] {
                if !(AMBIENT_RANGE[0]..=AMBIENT_RANGE[1]).contains(&value) {
                    return Err(EffectError::Temperature { duration, value });
                }
            }
        }
        Ok(())
    }

    /// Growth of a part per its length at `time` s.
    pub fn strain(&self, growth: &Growth, time: f64) -> f64 {
        growth.expansion * (self.ambient.followed(growth.lag, time) - self.reference)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AIR: Ambient = Ambient { start: 21.0, drift: 3e-4, swing: 1.5, period: 1200.0, phase: 0.4 };

    #[test]
    fn the_air_drifts_and_swings() {
        assert!((AIR.at(0.0) - (21.0 + 1.5 * 0.4_f64.sin())).abs() < 1e-14);
        // After a period the ramp alone is left.
        assert!((AIR.at(1200.0) - AIR.at(0.0) - 0.36).abs() < 1e-12);
    }

    #[test]
    fn bodies_follow_the_air_by_newtons_law_of_cooling() {
        for lag in [200.0, 5000.0] {
            // Heun's method.
            let (step, mut body) = (0.1, AIR.at(0.0));
            for i in 0..20_000 {
                let time = step * f64::from(i);
                let slope = (AIR.at(time) - body) / lag;
                let ahead = (AIR.at(time + step) - body - step * slope) / lag;
                body += 0.5 * step * (slope + ahead);
            }
            assert!((AIR.followed(lag, 2000.0) - body).abs() < 1e-6, "{lag}");
        }
        assert_eq!(AIR.followed(0.0, 777.0), AIR.at(777.0));
        // Memory: at equal temperature of the air, a slow body is not equally warm.
        assert!((AIR.followed(1000.0, 0.0) - AIR.followed(1000.0, 1200.0)).abs() > 0.1);
    }

    #[test]
    fn a_metre_of_steel_grows_by_60_micrometres_in_5_kelvin() {
        let ambient = Ambient { start: 25.0, drift: 0.0, swing: 0.0, period: 1.0, phase: 0.0 };
        let part = GrowingPart::Link { joint: 0, axis: 0 };
        let growth = Growth { part, length: 1.0, with_travel: false, expansion: 12e-6, lag: 3600.0 };
        let thermal = Thermal { ambient, reference: 20.0, growths: vec![growth] };
        assert!((thermal.strain(&growth, 1e4) - 60e-6).abs() < 1e-18);
    }

    #[test]
    fn a_session_must_not_get_too_warm() {
        let thermal = Thermal { ambient: AIR, reference: 20.0, growths: Vec::new() };
        assert_eq!(thermal.check_session(1e5), Ok(()));
        // 21 + 3e-4 * 1.3e5 + 1.5 = 61.5
        match thermal.check_session(1.3e5) {
            Err(EffectError::Temperature { value, .. }) => assert!((value - 61.5).abs() < 1e-9),
            other => panic!("{other:?}"),
        }
    }
}
