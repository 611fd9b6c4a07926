//! Follows from one pose to the next, and from a nominal pose to that of the identified robot.

use super::arm::{Arm, no_pose};
use super::criterion::Question;
use super::options::InverseError;
use super::reach::{self, Unreachable, at_limits};
use super::solver::{Ended, Search};
use super::task::{Aim, Goal};
use super::{
    Circumstances, ELASTIC_STEPS, InverseKinematics, InverseOptions, InverseSolution, RIGID, STEPS,
    self_motion,
};
use crate::identification::PredictionError;
use calibrig_model::geometry::Transform;

impl InverseKinematics<'_> {
    pub(crate) fn aim(&self, goal: &Goal, options: &InverseOptions) -> Result<Aim, InverseError> {
        let lever = options.lever.unwrap_or(0.25 * self.space.kinematics.characteristic_length());
        Ok(Aim::new(goal, &self.tool, lever)?)
    }

    /// [`solve`](Self::solve) for the rigid nominal robot; the deflection in the criterion is that of the identified robot.
    pub(crate) fn solve_nominal(
        &mut self,
        goal: &Goal,
        options: &InverseOptions,
    ) -> Result<InverseSolution, InverseError> {
        let calibrated = self.calibrated.take();
        let solved = self.solve(goal, options);
        self.calibrated = calibrated;
        solved
    }

    /// The nominal robot's unknowns for the next goal of a path: those nearest to the last ones by least squares, and from there to the minimum of
    /// the criterion, with no unknown farther than `longest` from the last ones. `None` where the goal cannot be met within that.
    pub(crate) fn follow(
        &mut self,
        goal: &Goal,
        last: &[f64],
        longest: &[f64],
        reference: &[f64],
        options: &InverseOptions,
    ) -> Result<Option<Vec<f64>>, InverseError> {
        let aim = self.aim(goal, options)?;
        let Self { space, rigid, judge, .. } = self;
        let bound = |sign: f64| {
            let ends = last.iter().zip(longest).zip(space.low.iter().zip(&space.high));
            ends.map(|((last, way), (low, high))| (last + sign * way).clamp(*low, *high)).collect::<Vec<_>>()
        };
        let (low, high) = (bound(-1.0), bound(1.0));
        let mut search = Search::new(rigid, space, aim, RIGID);
        (search.low, search.high) = (&low, &high);
        let mut y = last.to_vec();
        let Some((Ended::Reached, _)) = search.descend(&mut y, STEPS, false) else { return Ok(None) };
        let asked = Question { criterion: options.criterion, aim: &aim, reference };
        if asked.decides(space) {
            self_motion::minimise(&mut search, judge, &asked, &mut y)?;
        }
        Ok(Some(y))
    }

    /// The command nearest to a nominal one, by least squares, at which the identified robot meets the goal; otherwise what prevents it.
    pub(crate) fn correct(
        &mut self,
        goal: &Goal,
        nominal: &[f64],
        options: &InverseOptions,
    ) -> Result<Result<InverseSolution, Box<Unreachable>>, InverseError> {
        let aim = self.aim(goal, options)?;
        let mut y = self.space.of_command(nominal).map_err(PredictionError::from)?;
        let Self { space, rigid, calibrated, .. } = self;
        match calibrated {
            Some(arm) => {
                arm.circumstances.clone_from(&options.circumstances);
                arm.turned = aim.rows() > 3;
                nearest(&mut Search::new(arm, space, aim, options.tolerance), &mut y)
            }
            None => nearest(&mut Search::new(rigid, space, aim, RIGID), &mut y),
        }
    }

    /// Predicted place of the identified robot's tool at a command.
    pub(crate) fn predicted(
        &mut self,
        command: &[f64],
        circumstances: &Circumstances,
    ) -> Result<Transform, PredictionError> {
        let Some(arm) = &mut self.calibrated else {
            let y = self.space.of_command(command)?;
            self.rigid.place(&self.space, &y)?;
            return Ok(self.rigid.base_from_tool());
        };
        arm.circumstances.clone_from(circumstances);
        arm.tool_at(command)
    }
}

/// Moves from `y` to where the aim is met, by least squares.
fn nearest<A: Arm>(
    search: &mut Search<'_, A>,
    y: &mut [f64],
) -> Result<Result<InverseSolution, Box<Unreachable>>, InverseError> {
    let ended = search.descend(y, ELASTIC_STEPS, false);
    if !matches!(ended, Some((Ended::Reached, _))) {
        return Ok(Err(Box::new(reach::told(search, y, None))));
    }
    let space = search.space;
    let mut joints = vec![0.0; space.kinematics.joint_count()];
    space.joints(y, &mut joints).map_err(no_pose)?;
    Ok(Ok(InverseSolution {
        command: space.command(y),
        limits: at_limits(&space.kinematics, &joints),
        joints,
        base_from_tool: search.arm.base_from_tool(),
        criterion: 0.0,
        is_least: true,
        starts: 1,
    }))
}
