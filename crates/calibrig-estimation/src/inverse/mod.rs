//! Inverse kinematics: the command that brings the tool to its goal, for the rigid nominal robot or an identified one.
//!
//! A [`Goal`] is a position, a position with the direction of one axis of the tool, or a complete pose. Of all commands that meet it, the one that
//! minimises a stated [`Criterion`] is sought: a local minimum on the self-motion, within the joints' limits. Commands are those of the actuators,
//! so that they account for parallelograms, couplings and joints that follow others. A goal that cannot be met is an error that states
//! [how far it is missed, and why](Unreachable).
//!
//! ```
//! use calibrig_estimation::inverse::{Goal, InverseKinematics, InverseOptions, Tool};
//! use calibrig_estimation::kinematics::target_in_base;
//! use calibrig_model::nalgebra::Vector3;
//! use calibrig_model::{CalibrationModel, CraigLink};
//! use std::f64::consts::FRAC_PI_2;
//!
//! let robot = CalibrationModel::new(vec![
//!     CraigLink::prismatic("rail").row(0.0, 0.0, 0.0, 0.0).limits(0.0, 3.0),
//!     CraigLink::revolute("shoulder").row(0.2, FRAC_PI_2, 0.0, 0.0).limits(-1.5, 1.5),
//!     CraigLink::revolute("elbow").row(0.9, 0.0, 0.0, 0.0).limits(-2.0, 2.0),
//!     CraigLink::revolute("wrist").row(0.1, -FRAC_PI_2, 0.7, 0.0).limits(-3.0, 3.0),
//! ])?;
//! let tool = Tool::at(Vector3::new(0.10, 0.05, 0.20))?;
//! let mut inverse = InverseKinematics::new(&robot, tool)?;
//! let goal = Goal::Position(target_in_base(&robot.kinematics, &[1.2, 0.3, -0.8, 0.5], &Vector3::new(0.10, 0.05, 0.20))?);
//! let found = inverse.solve(&goal, &InverseOptions::default())?;
//! assert!((found.base_from_tool.translation.vector - goal.position()).norm() < 1e-9);
//!
//! let too_far = inverse.solve(&Goal::Position(Vector3::new(9.0, 0.0, 1.0)), &InverseOptions::default());
//! assert!(too_far.unwrap_err().to_string().contains("the nearest command found misses it by"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod arm;
mod criterion;
mod follow;
mod joint_space;
mod options;
mod reach;
mod self_motion;
mod solver;
mod starts;
mod task;

pub use arm::Circumstances;
pub use criterion::{Criterion, CriterionError};
pub use options::{InverseError, InverseOptions};
pub use reach::{JointAtLimit, LimitEnd, Unreachable};
pub use task::{Goal, GoalError, Tool};

use arm::{Arm, CalibratedArm, RigidArm};
use criterion::{Judge, Question};
use joint_space::JointSpace;
use reach::at_limits;
use solver::{Ended, Search};
use starts::Starts;
use task::Aim;

use crate::identification::{CalibratedRobot, Mode, PredictionError};
use calibrig_model::CalibrationModel;
use calibrig_model::geometry::Transform;

/// Most steps of a search, of one from the nearest pose found, and of one of an identified robot from where the rigid one meets the goal.
const STEPS: usize = 60;
const LAST_STEPS: usize = 300;
const ELASTIC_STEPS: usize = 30;
/// Tolerance of the rigid robot, m: far below the accuracy of its numbers, but at no cost, since steps converge quadratically.
const RIGID: f64 = 1e-11;
/// Deflections and errors move no robot farther than this, m: a goal that the rigid robot misses by less may be met by an identified one.
const FARTHEST_OFF: f64 = 0.1;

/// A command that meets a goal.
#[derive(Debug, Clone, PartialEq)]
pub struct InverseSolution {
    /// One number per actuator, m or rad.
    pub command: Vec<f64>,
    /// Joint variables of the rigid nominal robot at this command, m or rad.
    pub joints: Vec<f64>,
    /// Place of the tool at this command.
    pub base_from_tool: Transform,
    /// Value of the criterion; zero without a criterion.
    pub criterion: f64,
    /// Whether the criterion has a local minimum there among the poses that meet the goal; false if its search ended before.
    pub is_least: bool,
    /// Joints at their limits.
    pub limits: Vec<JointAtLimit>,
    /// Number of starts that the search needed.
    pub starts: usize,
}

/// The inverse kinematics of a robot with a tool. It is made once for many goals.
#[derive(Debug, Clone)]
pub struct InverseKinematics<'a> {
    space: JointSpace,
    tool: Tool,
    rigid: RigidArm,
    starts: Starts,
    judge: Judge,
    /// The identified robot, if there is one.
    calibrated: Option<CalibratedArm<'a>>,
}

impl InverseKinematics<'static> {
    /// The inverse kinematics of the rigid nominal robot.
    ///
    /// # Errors
    ///
    /// [`InverseError::Prediction`], where the robot is refused.
    pub fn new(model: &CalibrationModel, tool: Tool) -> Result<Self, InverseError> {
        Self::with(model, model, tool, None)
    }
}

impl<'a> InverseKinematics<'a> {
    /// The inverse kinematics of an identified robot as its mode predicts it, with its deflection and terms. Joints have the limits that the nominal
    /// robot's controller knows.
    ///
    /// # Errors
    ///
    /// [`InverseError::Prediction`], where the robot is refused.
    pub fn of_robot(robot: &'a CalibratedRobot, tool: Tool) -> Result<Self, InverseError> {
        let calibrated = CalibratedArm::new(robot, &tool)?;
        Self::with(&robot.nominal, &robot.model, tool, Some(calibrated))
    }

    fn with(
        nominal: &CalibrationModel,
        bends_as: &CalibrationModel,
        tool: Tool,
        calibrated: Option<CalibratedArm<'a>>,
    ) -> Result<Self, InverseError> {
        nominal.check().map_err(PredictionError::from)?;
        let space = JointSpace::new(nominal).map_err(arm::no_pose)?;
        let mut rigid = RigidArm::new(&space, &tool);
        let starts = Starts::new(&space, &mut rigid);
        let judge = Judge::new(&space, bends_as, &tool);
        Ok(Self { space, tool, rigid, starts, judge, calibrated })
    }

    /// The tool.
    pub fn tool(&self) -> &Tool {
        &self.tool
    }

    /// Mode of the robot; "without calibration" for a rigid nominal robot.
    pub fn mode(&self) -> Mode {
        self.calibrated.as_ref().map_or(Mode::WithoutCalibration, CalibratedArm::mode)
    }

    /// Place of the tool at a command, with unknown circumstances.
    ///
    /// # Errors
    ///
    /// [`InverseError::Prediction`], for a command that does not fit this robot, or a pose that it cannot take.
    pub fn tool_at(&mut self, command: &[f64]) -> Result<Transform, InverseError> {
        Ok(self.predicted(command, &Circumstances::default())?)
    }

    pub(crate) fn space(&self) -> &JointSpace {
        &self.space
    }

    /// The command that meets a goal and locally minimises the criterion.
    ///
    /// It is sought from the reference command, if one is stated, and from those of some thousand poses, spread over the range of the joints, that
    /// are nearest to the goal. These poses are the same for every call.
    ///
    /// # Errors
    ///
    /// [`InverseError::Unreachable`] for a goal that no search met; other variants for invalid input.
    pub fn solve(&mut self, goal: &Goal, options: &InverseOptions) -> Result<InverseSolution, InverseError> {
        options.check(self.judge.bends())?;
        options.circumstances.payload.as_ref().map_or(Ok(()), calibrig_model::Payload::check)?;
        let aim = self.aim(goal, options)?;
        let mut reference = match &options.reference {
            Some(command) => self.space.of_command(command).map_err(PredictionError::from)?,
            None => self.space.middle.clone(),
        };
        if let Some(calibrated) = &mut self.calibrated {
            calibrated.circumstances.clone_from(&options.circumstances);
            calibrated.turned = aim.rows() > 3;
        }
        self.judge.carry(options.circumstances.payload.as_ref());
        let asked = Question { criterion: options.criterion, aim: &aim, reference: &reference.clone() };

        let mut nearest: Option<(f64, Vec<f64>)> = None;
        let mut taken = 0;
        if options.reference.is_some() {
            self.space.clamp(&mut reference);
            taken += 1;
            if let Some(found) = self.search_from(&mut reference, &asked, options, &mut nearest)? {
                return Ok(InverseSolution { starts: taken, ..found });
            }
        }
        if let Some(first) = self.starts.nearest(&aim) {
            let mut y = first.to_vec();
            taken += 1;
            if let Some(found) = self.search_from(&mut y, &asked, options, &mut nearest)? {
                return Ok(InverseSolution { starts: taken, ..found });
            }
        }
        let others: Vec<Vec<f64>> =
            self.starts.by_distance(&aim).skip(1).take(options.starts).map(<[f64]>::to_vec).collect();
        for mut y in others {
            taken += 1;
            if let Some(found) = self.search_from(&mut y, &asked, options, &mut nearest)? {
                return Ok(InverseSolution { starts: taken, ..found });
            }
        }
        self.explain(aim, &asked, options, nearest)
    }

    /// One search: the rigid robot meets the goal, the criterion is minimised, and an identified robot is corrected from there.
    fn search_from(
        &mut self,
        y: &mut [f64],
        asked: &Question<'_>,
        options: &InverseOptions,
        nearest: &mut Option<(f64, Vec<f64>)>,
    ) -> Result<Option<InverseSolution>, InverseError> {
        let Self { space, rigid, judge, calibrated, .. } = self;
        let mut search = Search::new(rigid, space, *asked.aim, RIGID);
        let Some((ended, cost)) = search.descend(y, STEPS, true) else { return Ok(None) };
        let mut remember = |cost: f64, y: &[f64]| {
            if nearest.as_ref().is_none_or(|(least, _)| cost < *least) {
                *nearest = Some((cost, y.to_vec()));
            }
        };
        if ended != Ended::Reached && (calibrated.is_none() || cost.sqrt() > FARTHEST_OFF) {
            remember(cost, y);
            return Ok(None);
        }
        let decides = asked.decides(space);
        let mut least = None;
        if ended == Ended::Reached && decides {
            least = Some(self_motion::minimise(&mut search, judge, asked, y)?);
        }
        let Some(calibrated) = calibrated else {
            return Ok(Some(self.tell(y, self.rigid.base_from_tool(), least, asked)?));
        };
        let mut search = Search::new(calibrated, space, *asked.aim, options.tolerance);
        let Some((ended, cost)) = search.descend(y, ELASTIC_STEPS, false) else { return Ok(None) };
        if ended != Ended::Reached {
            remember(cost, y);
            return Ok(None);
        }
        if decides {
            least = Some(self_motion::minimise(&mut search, judge, asked, y)?);
        }
        let there = search.arm.base_from_tool();
        Ok(Some(self.tell(y, there, least, asked)?))
    }

    fn tell(
        &mut self,
        y: &[f64],
        base_from_tool: Transform,
        least: Option<self_motion::Least>,
        asked: &Question<'_>,
    ) -> Result<InverseSolution, InverseError> {
        let mut joints = vec![0.0; self.space.kinematics.joint_count()];
        self.space.joints(y, &mut joints).map_err(arm::no_pose)?;
        let criterion = match least {
            Some(least) => least.value,
            None => self.judge.value(&self.space, asked, y, None)?,
        };
        Ok(InverseSolution {
            command: self.space.command(y),
            limits: at_limits(&self.space.kinematics, &joints),
            joints,
            base_from_tool,
            criterion,
            is_least: least.is_none_or(|least| least.converged),
            starts: 0,
        })
    }

    /// The error for a goal that no search met; or a solution after all that is found without limits but lies within them.
    fn explain(
        &mut self,
        aim: Aim,
        asked: &Question<'_>,
        options: &InverseOptions,
        nearest: Option<(f64, Vec<f64>)>,
    ) -> Result<InverseSolution, InverseError> {
        let mut y = nearest.map_or_else(|| self.space.middle.clone(), |(_, y)| y);
        self.space.clamp(&mut y);
        let Self { space, rigid, starts, .. } = self;
        let beyond = reach::without_limits(space, rigid, starts, aim, &y, RIGID);
        if let Some((within, limits)) = &beyond
            && limits.is_empty()
        {
            let (mut within, mut nearest) = (within.clone(), None);
            self.space.clamp(&mut within);
            if let Some(found) = self.search_from(&mut within, asked, options, &mut nearest)? {
                return Ok(InverseSolution { starts: options.starts + 2, ..found });
            }
        }
        let without_limits = beyond.map(|(_, limits)| limits);
        let Self { space, rigid, calibrated, .. } = self;
        let told = match calibrated {
            Some(arm) => {
                let mut search = Search::new(arm, space, aim, options.tolerance);
                search.descend(&mut y, LAST_STEPS, false);
                reach::told(&mut search, &y, without_limits)
            }
            None => {
                let mut search = Search::new(rigid, space, aim, RIGID);
                search.descend(&mut y, LAST_STEPS, false);
                reach::told(&mut search, &y, without_limits)
            }
        };
        Err(InverseError::Unreachable(Box::new(told)))
    }
}
