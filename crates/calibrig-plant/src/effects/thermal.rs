//! Links that grow with their temperature, which follows that of the air.

use std::f64::consts::TAU;

use super::error::{Range, check};
use super::{EffectError, EffectKind};

/// Temperatures of the air at which a robot is measured, °C.
pub const AMBIENT_RANGE: [f64; 2] = [-20.0, 60.0];

/// Temperature of the air against time: a start, a ramp and a wave.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ambient {
    /// At time zero, without the wave, °C.
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

    /// Temperature at `time` s of a body that follows the air with a time constant of `lag` s, and that starts at the air's temperature at
    /// time zero, °C: the solution of `lag dT/dt = T_air - T`.
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

/// Largest rise of a part above the air by the heat of its drive, K: no drive in service exceeds it.
pub const MOST_RISE: f64 = 60.0;

/// The heat of a drive in a part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriveHeat {
    /// Index of the actuator.
    pub actuator: usize,
    /// Power dissipated from the beginning of the session on, whether it moves or not, W.
    pub power: f64,
    /// Energy dissipated by its motion, J per m or rad of the actuator.
    pub per_motion: f64,
    /// Temperature rise of the part per steady watt, K/W.
    pub resistance: f64,
}

/// Temperature rise of the parts that drives heat: what a pose remembers of the session so far.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Warmth {
    /// Time that it belongs to, s since the session began.
    pub time: f64,
    /// Rise of every growing part above its temperature without drives, K; empty at the beginning.
    pub rise: Vec<f64>,
}

/// Which part of the structure grows.
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
    /// Its length, m, negative if it runs against the axis; not used for the rod.
    pub length: f64,
    /// Whether its joint's position adds to the length, as for a telescope.
    pub with_travel: bool,
    /// Relative growth per kelvin.
    pub expansion: f64,
    /// Time constant with which it follows the air and its drive's heat, s; above zero if it is heated.
    pub lag: f64,
    /// Its source of heat besides the air.
    pub heat: Option<DriveHeat>,
}

/// Thermal growth against the time of the session.
#[derive(Debug, Clone, PartialEq)]
pub struct Thermal {
    /// The air, as its sensor reads it.
    pub ambient: Ambient,
    /// Temperature at which the links have their as-built lengths, °C.
    pub reference: f64,
    /// The growing parts.
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
            if let Some(heat) = &growth.heat {
                heat.check(index, actuators, growth.lag)?;
            }
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

    /// Growth of a part, warmed by its drive by `rise` K, per unit of its length at `time` s.
    pub fn strain(&self, growth: &Growth, time: f64, rise: f64) -> f64 {
        growth.expansion * (self.ambient.followed(growth.lag, time) + rise - self.reference)
    }

    /// Whether a drive heats anything.
    pub fn is_heated(&self) -> bool {
        self.growths.iter().any(|growth| growth.heat.is_some())
    }

    /// Temperature rise of the parts at `time` s, after `motions` (m or rad, one per actuator) since `before`.
    pub fn warmth_after(&self, before: &Warmth, time: f64, motions: &[f64]) -> Warmth {
        let rise = self.growths.iter().enumerate().map(|(part, growth)| {
            let Some(heat) = &growth.heat else { return 0.0 };
            let earlier = before.rise.get(part).copied().unwrap_or(0.0);
            let motion = motions.get(heat.actuator).copied().unwrap_or(0.0);
            heat.rise_after(growth.lag, earlier, time - before.time, motion)
        });
        Warmth { time, rise: rise.collect() }
    }

    /// Refuses parts that have become warmer than [`MOST_RISE`].
    pub(crate) fn check_warmth(&self, warmth: &Warmth) -> Result<(), EffectError> {
        let mut parts = self.growths.iter().zip(&warmth.rise);
        match parts.find(|(_, rise)| !(**rise <= MOST_RISE)) {
            Some((Growth { heat: Some(heat), .. }, &value)) => {
                Err(EffectError::Overheated { actuator: heat.actuator, time: warmth.time, value })
            }
            _ => Ok(()),
        }
    }
}

impl DriveHeat {
    fn check(&self, index: usize, actuators: usize, lag: f64) -> Result<(), EffectError> {
        let kind = EffectKind::Thermal;
        if self.actuator >= actuators {
            return Err(EffectError::NoSuchPart { effect: kind, part: "such drive" });
        }
        for (quantity, value, range) in [
            ("power", self.power, Range::NotNegative),
            ("heat of a motion", self.per_motion, Range::NotNegative),
            ("thermal resistance", self.resistance, Range::Positive),
            ("lag", lag, Range::Positive),
        ] {
            check(kind, (quantity, index), value, range)?;
        }
        let value = self.power * self.resistance;
        if value > MOST_RISE {
            let (actuator, time) = (self.actuator, f64::INFINITY);
            return Err(EffectError::Overheated { actuator, time, value });
        }
        Ok(())
    }

    /// Rise of a part of time constant `lag` s, K, `seconds` after a rise of `before`, with a motion of `motion` (m or rad) at an even rate: the
    /// solution of `lag dT/dt = R P - T`.
    pub fn rise_after(&self, lag: f64, before: f64, seconds: f64, motion: f64) -> f64 {
        let ratio = (seconds / lag).max(0.0);
        let gone = -(-ratio).exp_m1();
        // The mean share that is still there of heat that arrives evenly.
        let kept = if ratio > 0.0 { gone / ratio } else { 1.0 };
        let moved = self.per_motion * motion.abs() / lag;
        before * (1.0 - gone) + self.resistance * (self.power * gone + moved * kept)
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
        let growth =
            Growth { part, length: 1.0, with_travel: false, expansion: 12e-6, lag: 3600.0, heat: None };
        let thermal = Thermal { ambient, reference: 20.0, growths: vec![growth] };
        assert!((thermal.strain(&growth, 1e4, 0.0) - 60e-6).abs() < 1e-18);
    }

    /// 40 W at 0.5 K/W, and 300 J a metre; 20 minutes.
    const HEAT: DriveHeat = DriveHeat { actuator: 0, power: 40.0, per_motion: 300.0, resistance: 0.5 };

    #[test]
    fn a_drive_warms_its_part_exponentially_and_by_its_motion() {
        // Without motion 20 K in the end, and 1 - 1/e of it after the time constant, whatever the steps.
        let still = |steps: u32| {
            let step = 1200.0 / f64::from(steps);
            (0..steps).fold(0.0, |rise, _| HEAT.rise_after(1200.0, rise, step, 0.0))
        };
        for steps in [1, 7, 500] {
            assert!((still(steps) - 20.0 * (1.0 - (-1.0_f64).exp())).abs() < 1e-10, "{steps}");
        }
        // With motion against Heun's method: there and back by 0.8 m, 10 s each.
        let slope = |rise: f64| (0.5 * (40.0 + 300.0 * 0.08) - rise) / 1200.0;
        let (mut rise, step) = (3.0, 1e-3);
        for _ in 0..20_000 {
            let first = slope(rise);
            rise += 0.5 * step * (first + slope(rise + step * first));
        }
        let there = HEAT.rise_after(1200.0, 3.0, 10.0, 0.8);
        assert!((HEAT.rise_after(1200.0, there, 10.0, -0.8) - rise).abs() < 1e-9);
        // A motion in no time leaves its heat: 240 J on a heat capacity of 1200 s / 0.5 K/W.
        assert!((HEAT.rise_after(1200.0, 3.0, 0.0, 0.8) - 3.1).abs() < 1e-12);
    }

    #[test]
    fn warmth_is_of_each_part_by_its_own_drive() {
        let part = GrowingPart::Link { joint: 0, axis: 0 };
        let cold =
            Growth { part, length: 1.0, with_travel: false, expansion: 12e-6, lag: 1200.0, heat: None };
        let warm = Growth { heat: Some(DriveHeat { actuator: 1, ..HEAT }), ..cold };
        let thermal = Thermal { ambient: AIR, reference: 20.0, growths: vec![cold, warm] };
        assert!(thermal.is_heated());
        let warmth = thermal.warmth_after(&Warmth::default(), 100.0, &[5.0, 0.3]);
        assert_eq!(warmth.rise, [0.0, HEAT.rise_after(1200.0, 0.0, 100.0, 0.3)]);
        let later = thermal.warmth_after(&warmth, 150.0, &[5.0, -0.2]);
        assert_eq!(later.rise[1], HEAT.rise_after(1200.0, warmth.rise[1], 50.0, 0.2));
        let more = thermal.strain(&warm, 150.0, 10.0) - thermal.strain(&warm, 150.0, 0.0);
        assert!((more - 12e-5).abs() < 1e-18);
        assert_eq!(thermal.check_warmth(&later), Ok(()));
        let hot = Warmth { time: 9.0, rise: vec![0.0, 61.0] };
        let error = EffectError::Overheated { actuator: 1, time: 9.0, value: 61.0 };
        assert_eq!(thermal.check_warmth(&hot), Err(error));
    }

    #[test]
    fn heat_that_no_drive_gives_is_refused() {
        let part = GrowingPart::Link { joint: 0, axis: 0 };
        let refused = |heat: DriveHeat, lag: f64| {
            let heat = Some(heat);
            let growth = Growth { part, length: 1.0, with_travel: false, expansion: 12e-6, lag, heat };
            let thermal = Thermal { ambient: AIR, reference: 20.0, growths: vec![growth] };
            thermal.check(1, false).map_err(|error| error.to_string())
        };
        assert_eq!(refused(HEAT, 1200.0), Ok(()));
        for (heat, lag, message) in [
            (DriveHeat { power: -1.0, ..HEAT }, 1200.0, "power of index 0 is -1"),
            (DriveHeat { per_motion: -1.0, ..HEAT }, 1200.0, "heat of a motion of index 0 is -1"),
            (DriveHeat { resistance: 0.0, ..HEAT }, 1200.0, "thermal resistance of index 0 is 0"),
            (DriveHeat { actuator: 1, ..HEAT }, 1200.0, "no such drive"),
            (DriveHeat { power: 130.0, ..HEAT }, 1200.0, "warms its part by 65.0 K"),
            (HEAT, 0.0, "lag of index 0 is 0"),
        ] {
            let error = refused(heat, lag).expect_err(message);
            assert!(error.contains(message), "{message:?} in {error}");
        }
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
