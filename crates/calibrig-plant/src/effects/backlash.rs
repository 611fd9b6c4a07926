//! Play of the transmissions.

use super::error::{Range, check_all};
use super::{EffectError, EffectKind};

/// Backlash of every actuator.
#[derive(Debug, Clone, PartialEq)]
pub struct Backlash {
    /// Whole gap between the flanks, one entry per actuator, m or rad.
    pub gap: Vec<f64>,
}

impl Backlash {
    pub(super) fn check(&self, actuators: usize) -> Result<(), EffectError> {
        check_all(EffectKind::Backlash, "gap", &self.gap, actuators, Range::NotNegative)
    }

    /// How far the driven side is ahead of the motor after a motion of the motor (m or rad), given how far it was before: the play
    /// operator of M. A. Krasnosel'skii, A. V. Pokrovskii, Systems with Hysteresis (1989), section 2.
    pub fn ahead_after(&self, actuator: usize, ahead: f64, motion: f64) -> f64 {
        let half = 0.5 * self.gap[actuator];
        (ahead - motion).clamp(-half, half)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_driven_side_lags_by_half_the_gap_after_a_motion_beyond_the_gap() {
        let backlash = Backlash { gap: vec![2e-4] };
        let up = backlash.ahead_after(0, 0.0, 0.3);
        assert_eq!(up, -1e-4);
        assert_eq!(backlash.ahead_after(0, up, -0.3), 1e-4);
        assert_eq!(backlash.ahead_after(0, up, 0.1), -1e-4);
    }

    #[test]
    fn within_the_gap_the_driven_side_stays() {
        let backlash = Backlash { gap: vec![2e-4] };
        // It stands at motor + ahead: moving the motor back by half the gap leaves that sum.
        assert!((backlash.ahead_after(0, -1e-4, -1e-4) - 0.0).abs() < 1e-19);
        assert!((backlash.ahead_after(0, -1e-4, -0.5e-4) + 0.5e-4).abs() < 1e-19);
        assert_eq!(backlash.ahead_after(0, -1e-4, 0.0), -1e-4);
    }
}
