//! Friction behind elastic drives: the place at which the machine comes to rest depends on the way there.

use super::error::{Range, check_all};
use super::{EffectError, EffectKind};

/// Coulomb friction of every joint with a presliding range.
///
/// The friction force follows P. R. Dahl, A Solid Friction Model, Aerospace Corporation TOR-0158(3107-18)-1 (1968), with exponent 1.
/// It grows with the load, and has not reached its limit after a short motion, so that no multiple of the approach's sign contains
/// it.
#[derive(Debug, Clone, PartialEq)]
pub struct Friction {
    /// Part that does not depend on the load, one entry per actuator, N or N m.
    pub constant: Vec<f64>,
    /// Share of the drive's load.
    pub per_load: Vec<f64>,
    /// Motion in which 1 - 1/e of the force builds up, m or rad; zero for a force that acts at once.
    pub presliding: Vec<f64>,
}

impl Friction {
    pub(super) fn check(&self, actuators: usize) -> Result<(), EffectError> {
        for (quantity, values) in [
            ("friction", &self.constant),
            ("friction per load", &self.per_load),
            ("presliding length", &self.presliding),
        ] {
            check_all(EffectKind::Friction, quantity, values, actuators, Range::NotNegative)?;
        }
        Ok(())
    }

    /// Whether the loads of the drives matter.
    pub fn needs_load(&self) -> bool {
        self.per_load.iter().any(|share| *share > 0.0)
    }

    /// How far the drive of `stiffness` (N/m or N m/rad) stays behind after any motion, m or rad; `None` if that depends on load or motion.
    pub fn lag(&self, actuator: usize, stiffness: f64) -> Option<f64> {
        let (constant, per_load) = (*self.constant.get(actuator)?, *self.per_load.get(actuator)?);
        let is_constant = per_load == 0.0 && (*self.presliding.get(actuator)? == 0.0 || constant == 0.0);
        is_constant.then(|| constant / stiffness)
    }

    /// Friction force as a share of its limit, -1 to 1, after a motion (m or rad), from that before it.
    pub fn share_after(&self, actuator: usize, share: f64, motion: f64) -> f64 {
        if motion == 0.0 {
            return share;
        }
        let limit = motion.signum();
        let length = self.presliding[actuator];
        if length == 0.0 { limit } else { limit + (share - limit) * (-motion.abs() / length).exp() }
    }

    /// Force by which friction reduces the load of the drive under `load` (N or N m), N or N m: against the motion, so that the
    /// drive stays behind.
    pub fn force(&self, actuator: usize, share: f64, load: f64) -> f64 {
        let limit = self.constant[actuator] + self.per_load[actuator] * load.abs();
        -share * limit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shoulder() -> Friction {
        Friction { constant: vec![100.0], per_load: vec![0.02], presliding: vec![0.05] }
    }

    #[test]
    fn after_a_long_way_the_joint_stays_behind_by_friction_over_stiffness() {
        let friction = shoulder();
        let share = friction.share_after(0, 0.3, 5.0);
        assert!((share - 1.0).abs() < 1e-15);
        // (100 + 0.02 * 4000) N m on 6e5 N m/rad = 300 urad, whatever the sign of the load.
        for load in [4000.0, -4000.0] {
            assert!((friction.force(0, share, load) / 6e5 + 3e-4).abs() < 1e-18);
            assert!((friction.force(0, -share, load) / 6e5 - 3e-4).abs() < 1e-18);
        }
    }

    #[test]
    fn short_motions_build_the_force_up_by_dahls_law() {
        let friction = shoulder();
        // dF/dx = (1 - F)/length from rest, in steps.
        let mut force = 0.0;
        for _ in 0..100_000 {
            force += (0.03 / 100_000.0) * (1.0 - force) / 0.05;
        }
        let share = friction.share_after(0, 0.0, 0.03);
        assert!((share - force).abs() < 1e-5, "{share} against {force}");
        // Two motions one way are one motion; no motion changes nothing.
        let halves = friction.share_after(0, friction.share_after(0, 0.0, 0.015), 0.015);
        assert!((share - halves).abs() < 1e-15);
        assert_eq!(friction.share_after(0, share, 0.0), share);
        // The way back is odd.
        assert_eq!(friction.share_after(0, -0.4, -0.01), -friction.share_after(0, 0.4, 0.01));
        let rigid = Friction { presliding: vec![0.0], ..friction };
        assert_eq!(rigid.share_after(0, 0.7, -1e-9), -1.0);
    }
}
