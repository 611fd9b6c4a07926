//! Determines from which side the actuators come, from one corrected command to the next.

use super::{CompensatedPoint, CompensationError, Compensator};
use crate::inverse::{Goal, InverseOptions};
use calibrig_model::measurement::Motion;

/// Smallest motion of an actuator that counts, m or rad.
const LEAST_MOTION: f64 = 1e-7;

/// State after a sequence of corrected commands.
///
/// What depends on the side from which an actuator comes (play of its gears) can be larger than its step to the next point of a path. Commands that
/// are corrected for the side of the command before them would then go back and forth. So the side is taken from commands that are corrected for
/// everything else: these are as smooth as the nominal ones, and where they turn, the corrected command continues in the new direction by the play.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Travel {
    /// Motion of the commands corrected for everything but the side.
    smooth: Option<Motion>,
    /// Motion of the corrected commands.
    corrected: Option<Motion>,
    /// Whether the next command continues them.
    broken: bool,
}

impl Travel {
    /// A travel that begins at rest at a command, m or rad.
    pub fn from(command: &[f64]) -> Self {
        let motion = Some(Motion::at(command));
        Self { smooth: motion.clone(), corrected: motion, broken: false }
    }

    /// The last corrected command; `None` before the first one, and if no goal was met since an interruption.
    pub(super) fn command(&self) -> Option<&[f64]> {
        let motion = self.corrected.as_ref().filter(|_| !self.broken)?;
        Some(&motion.command)
    }

    /// Records that a goal was not met: the next one is not one step from the last command.
    pub(super) fn interrupt(&mut self) {
        self.broken = true;
    }
}

fn moved(motion: Option<&Motion>, command: &[f64]) -> Option<Motion> {
    let mut motion = motion?.clone();
    motion.go_to(command, LEAST_MOTION);
    Some(motion)
}

impl Compensator<'_> {
    /// The corrected command for the next goal of a sequence, which a nominal command meets, and whether an actuator then comes from another side
    /// than the correction assumes. For the first goal of a sequence without a previous command, the approach is that of the circumstances.
    ///
    /// # Errors
    ///
    /// As [`point`](Self::point); the travel is left unchanged.
    pub fn next(
        &mut self,
        travel: &mut Travel,
        goal: &Goal,
        nominal: &[f64],
        options: &InverseOptions,
    ) -> Result<(CompensatedPoint, bool), CompensationError> {
        let mut options = options.clone();
        let stated = std::mem::take(&mut options.circumstances.approach);
        let since = std::mem::take(&mut options.circumstances.since_reversal);
        let smooth = self.corrected(goal, nominal.to_vec(), &options)?;
        let along = moved(travel.smooth.as_ref(), &smooth.command);
        (options.circumstances.approach, options.circumstances.since_reversal) = match &along {
            Some(motion) => (motion.approach.clone(), motion.since_reversal.clone()),
            None => (stated, since),
        };
        let unsided = options.circumstances.approach.iter().all(|sign| *sign == 0);
        let point = if unsided { smooth.clone() } else { self.corrected(goal, nominal.to_vec(), &options)? };
        let came = moved(travel.corrected.as_ref(), &point.command);
        let wavers = came.as_ref().is_some_and(|motion| motion.approach != options.circumstances.approach);
        travel.smooth = Some(along.unwrap_or_else(|| Motion::at(&smooth.command)));
        travel.corrected = Some(came.unwrap_or_else(|| Motion::at(&point.command)));
        travel.broken = false;
        Ok((CompensatedPoint { approach: options.circumstances.approach, ..point }, wavers))
    }
}
