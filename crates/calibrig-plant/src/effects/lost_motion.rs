//! Lost motion of gears in which the load, if large enough, decides the flank, rather than the approach.

use super::error::{Range, check, check_all};
use super::{EffectError, EffectKind};

/// Play under load.
///
/// Below the friction of the driven side the gear stays on the flank on which it came, as with [`Backlash`](super::Backlash). A load beyond it
/// moves the driven side to the flank that bears the load, from whichever side the pose was approached. In between, where some teeth bear and
/// others do not, it moves over in proportion.
#[derive(Debug, Clone, PartialEq)]
pub struct LostMotion {
    /// Whole gap between the flanks, one entry per actuator, m or rad.
    pub gap: Vec<f64>,
    /// Load up to which the approach decides, N or N m.
    pub friction: Vec<f64>,
    /// Load from which the load decides, N or N m: at least the friction, and above zero if there is a gap. If equal to it, the transition is sharp.
    pub closes_at: Vec<f64>,
}

impl LostMotion {
    /// `greatest` is at least the load that each drive can have, N or N m.
    pub(super) fn check(&self, greatest: &[f64]) -> Result<(), EffectError> {
        let kind = EffectKind::LostMotion;
        for (quantity, values) in
            [("gap", &self.gap), ("friction", &self.friction), ("closing load", &self.closes_at)]
        {
            check_all(kind, quantity, values, greatest.len(), Range::NotNegative)?;
        }
        for (index, gap) in self.gap.iter().enumerate().filter(|(_, gap)| **gap > 0.0) {
            let (friction, closes_at) = (self.friction[index], self.closes_at[index]);
            check(kind, ("closing load", index), closes_at, Range::Positive)?;
            if closes_at < friction {
                let expected = "at least the friction";
                let quantity = "closing load";
                return Err(EffectError::Value { effect: kind, quantity, index, value: closes_at, expected });
            }
            if closes_at > greatest[index] {
                return Err(EffectError::NeverCloses {
                    actuator: index,
                    gap: *gap,
                    closes_at,
                    greatest: greatest[index],
                });
            }
        }
        Ok(())
    }

    /// How far the driven side is ahead of the motor after a motion of the motor (m or rad) that ends under `load` (N or N m, above zero if it pushes
    /// the driven side ahead), given how far it was before.
    pub fn ahead_after(&self, actuator: usize, ahead: f64, motion: f64, load: f64) -> f64 {
        let half = 0.5 * self.gap[actuator];
        let carried = (ahead - motion).clamp(-half, half);
        let share = self.closed(actuator, load);
        carried + share * (half.copysign(load) - carried)
    }

    /// Share of the way to the loaded flank that the load moves the driven side, 0 to 1.
    fn closed(&self, actuator: usize, load: f64) -> f64 {
        let beyond = load.abs() - self.friction[actuator];
        let width = self.closes_at[actuator] - self.friction[actuator];
        if beyond <= 0.0 {
            0.0
        } else if beyond >= width {
            1.0
        } else {
            beyond / width
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A gap of 200 urad; the approach decides up to 100 N m, the load from 300 N m on.
    fn gear() -> LostMotion {
        LostMotion { gap: vec![2e-4], friction: vec![100.0], closes_at: vec![300.0] }
    }

    #[test]
    fn the_load_decides_beyond_friction_and_the_approach_below() {
        let gear = gear();
        for (load, up, down) in [
            (0.0, -1e-4, 1e-4),
            (100.0, -1e-4, 1e-4),
            (-60.0, -1e-4, 1e-4),
            // Half-way, each side has come half of its way to the loaded flank.
            (200.0, 0.0, 1e-4),
            (-200.0, -1e-4, 0.0),
            (300.0, 1e-4, 1e-4),
            (2500.0, 1e-4, 1e-4),
            (-2500.0, -1e-4, -1e-4),
        ] {
            for start in [-1e-4, 0.0, 1e-4] {
                assert!((gear.ahead_after(0, start, 0.4, load) - up).abs() < 1e-18, "up under {load}");
                assert!((gear.ahead_after(0, start, -0.4, load) - down).abs() < 1e-18, "down under {load}");
            }
        }
    }

    /// Quasi-static motion with Coulomb friction on the driven side: the flank that pushes is the one that the force G = s F - T between the gears needs.
    #[test]
    fn a_sharp_transition_is_the_balance_of_flank_friction_and_load() {
        let gear = LostMotion { closes_at: vec![100.0], ..gear() };
        for step in -400_i32..=400 {
            let load = f64::from(step) + 0.5;
            for direction in [-1.0, 1.0] {
                let on_driven = direction * 100.0 - load;
                let expected = if on_driven > 0.0 { -1e-4 } else { 1e-4 };
                let found = gear.ahead_after(0, 0.0, 0.4 * direction, load);
                assert!((found - expected).abs() < 1e-18, "{load} N m, {direction}");
            }
        }
    }

    #[test]
    fn what_a_load_has_carried_over_stays_there_when_it_is_gone() {
        let gear = gear();
        let loaded = gear.ahead_after(0, -1e-4, 0.3, 900.0);
        assert_eq!(loaded, 1e-4);
        // A motion of a quarter of the gap leaves the driven side where it is; one beyond the gap takes it along.
        assert!((gear.ahead_after(0, loaded, 5e-5, 0.0) - 5e-5).abs() < 1e-18);
        assert_eq!(gear.ahead_after(0, loaded, 0.3, 0.0), -1e-4);
    }

    #[test]
    fn a_gap_that_no_load_closes_is_refused() {
        let refused = |gear: &LostMotion, greatest: f64| gear.check(&[greatest]).expect_err("no such gear");
        assert_eq!(gear().check(&[300.0]), Ok(()));
        match refused(&gear(), 299.0) {
            EffectError::NeverCloses { actuator: 0, closes_at, greatest, .. } => {
                assert_eq!((closes_at, greatest), (300.0, 299.0));
            }
            other => panic!("{other}"),
        }
        let inverted = LostMotion { closes_at: vec![50.0], ..gear() };
        assert!(refused(&inverted, 1e9).to_string().contains("at least the friction"));
        let nothing = LostMotion { friction: vec![0.0], closes_at: vec![0.0], ..gear() };
        assert!(refused(&nothing, 1e9).to_string().contains("above zero"));
        assert_eq!(LostMotion { gap: vec![0.0], ..nothing }.check(&[0.0]), Ok(()));
    }
}
