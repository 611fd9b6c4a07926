//! Goals, and the commands for them.

use nalgebra::Vector3;

use super::{CalibrateError, ClosedLoopError, PipelineError, Resolved};
use crate::pipeline::iso9283::within;
use crate::scenario::{CompensationPlan, GoalKind, Scenario};
use calibrig_estimation::compensation::{CompensatedPoint, CompensationError, Compensator, Travel};
use calibrig_estimation::elastostatics::{Deflection, ElasticChain, ElasticError};
use calibrig_estimation::identification::{CalibratedRobot, Estimate, Mode, Predictor};
use calibrig_estimation::inverse::{
    Circumstances, Criterion, Goal, InverseError, InverseKinematics, InverseOptions, Tool,
};
use calibrig_model::JointKind;
use calibrig_model::geometry::Transform;

/// A robot whose first target is the tool.
pub(super) struct Tooled<'a> {
    pub tool: Tool,
    robot: &'a CalibratedRobot,
    kind: GoalKind,
    axis: Vector3<f64>,
}

impl<'a> Tooled<'a> {
    pub fn new(robot: &'a CalibratedRobot, plan: &CompensationPlan) -> Result<Self, PipelineError> {
        let in_flange = robot.targets.first().copied().unwrap_or_default();
        let tool = Tool::at(in_flange)
            .and_then(|tool| tool.with_axis(plan.axis))
            .map_err(|source| ClosedLoopError::of(robot.mode, InverseError::from(source)))?;
        Ok(Self { tool, robot, kind: plan.goal, axis: plan.axis })
    }

    /// Where the tool is predicted to be at a command.
    pub fn goal(&self, command: &[f64]) -> Result<Goal, PipelineError> {
        let predicted = |source| CalibrateError::Predict { mode: self.robot.mode, source };
        let flange: Transform =
            Predictor::new(self.robot).and_then(|mut own| own.flange(command)).map_err(predicted)?;
        let place = flange * self.tool.flange_from_tool();
        Ok(match self.kind {
            GoalKind::Position => Goal::Position(place.translation.vector),
            GoalKind::Axis => {
                Goal::Axis { position: place.translation.vector, direction: place.rotation * self.axis }
            }
            GoalKind::Pose => Goal::Pose(place),
        })
    }
}

/// Commands that are to be driven.
pub(super) struct Corrected {
    /// One per goal; the nominal one if there is no other.
    pub commands: Vec<Vec<f64>>,
    /// Of the tool's place there, m.
    pub sigmas: Vec<Option<Vector3<f64>>>,
    /// Goals without a command, by their numbers, with the reason.
    pub uncorrected: Vec<(u32, String)>,
    /// Goals of which only the position is met, with the reason.
    pub position_alone: Vec<(u32, String)>,
}

impl Corrected {
    /// The nominal commands.
    pub fn as_planned(commands: &[Vec<f64>]) -> Self {
        Self {
            commands: commands.to_vec(),
            sigmas: vec![None; commands.len()],
            uncorrected: Vec::new(),
            position_alone: Vec::new(),
        }
    }

    /// Goals that do not count, in addition to its own.
    pub fn leave_out(&mut self, poses: &[(u32, String)]) {
        for (pose, why) in poses {
            if !self.uncorrected.iter().any(|(own, _)| own == pose) {
                self.uncorrected.push((*pose, why.clone()));
            }
        }
        self.uncorrected.sort_unstable_by_key(|(pose, _)| *pose);
    }
}

/// Corrects nominal commands in their order. If the machine goes from one to the next, starting `from` a command, every actuator's side of approach
/// is that of the corrected commands; else it is as stated.
pub(super) fn correct(
    estimate: &Estimate,
    plan: &CompensationPlan,
    goals: &[Goal],
    nominal: &[Vec<f64>],
    (circumstances, from): (&[Circumstances], Option<&[f64]>),
) -> Result<Corrected, PipelineError> {
    let mode = estimate.robot.mode;
    let tool = Tooled::new(&estimate.robot, plan)?.tool;
    let mut compensator =
        Compensator::of_estimate(estimate, tool).map_err(|source| ClosedLoopError::of(mode, source))?;
    let mut travel = from.map(Travel::from);
    let mut corrected = Corrected::as_planned(nominal);
    for (index, ((goal, nominal), known)) in goals.iter().zip(nominal).zip(circumstances).enumerate() {
        let pose = u32::try_from(index).unwrap_or(u32::MAX);
        let mut found = next(&mut compensator, goal, nominal, (known, travel.as_ref()))?;
        if goal.rows() > 3
            && let Ok((point, _)) = &found
            && let Some(why) = far(estimate, point)
        {
            // Close to a singular pose a small turn of the tool takes a large one of the arm.
            let position = Goal::Position(goal.position());
            found = next(&mut compensator, &position, nominal, (known, travel.as_ref()))?;
            if found.is_ok() {
                corrected.position_alone.push((pose, why));
            }
        }
        match found {
            Ok((found, after)) => {
                corrected.sigmas[index] = found.sigma();
                corrected.commands[index] = found.command;
                travel = after;
            }
            Err(why) => {
                corrected.uncorrected.push((pose, why));
                travel = travel.map(|_| Travel::from(nominal));
            }
        }
    }
    Ok(corrected)
}

/// Why a corrected command is too far from the nominal one; `None` if it is not.
fn far(estimate: &Estimate, point: &CompensatedPoint) -> Option<String> {
    let (joint, way) = point.far_correction()?;
    let link = estimate.robot.model.kinematics.links.get(joint)?;
    let way = match link.kind {
        JointKind::Prismatic => format!("{:.0} mm", 1e3 * way),
        JointKind::Revolute => format!("{:.1} deg", way.to_degrees()),
    };
    Some(format!("to meet the whole goal, {} would move by {way}: the pose is nearly singular", link.name))
}

/// A correction with where it leaves the travel, or why nothing meets the goal.
type OrWhy = Result<(CompensatedPoint, Option<Travel>), String>;

/// The command for a goal; the next one if the machine goes from goal to goal.
fn next(
    compensator: &mut Compensator<'_>,
    goal: &Goal,
    nominal: &[f64],
    (known, travel): (&Circumstances, Option<&Travel>),
) -> Result<OrWhy, PipelineError> {
    let options = InverseOptions {
        criterion: Criterion::NONE,
        circumstances: known.clone(),
        ..InverseOptions::default()
    };
    let mut travel = travel.cloned();
    let found = match &mut travel {
        Some(travel) => compensator.next(travel, goal, nominal, &options).map(|(point, _)| point),
        None => compensator.corrected(goal, nominal.to_vec(), &options),
    };
    match found {
        Ok(found) => Ok(Ok((found, travel))),
        Err(
            why @ (CompensationError::OutOfCorrection(_)
            | CompensationError::Prediction(_)
            | CompensationError::Inverse(InverseError::Unreachable(_) | InverseError::Prediction(_))),
        ) => Ok(Err(why.to_string())),
        Err(source) => Err(ClosedLoopError::of(compensator.mode(), source)),
    }
}

/// The nominal robot's commands for goals, by a criterion, each searched from the planned one within the working region; if none is found, the
/// planned one, with the reason.
pub(super) fn nominal_by(
    scenario: &Scenario,
    tool: Tool,
    criterion: Criterion,
    planned: &[Vec<f64>],
    goals: &[Goal],
) -> Result<Resolved, PipelineError> {
    let refused = |source: InverseError| ClosedLoopError::of(Mode::WithoutCalibration, source);
    let within = within(&scenario.robot.model, &scenario.region);
    let mut inverse = InverseKinematics::new(&within, tool).map_err(refused)?;
    let (mut commands, mut missed) = (Vec::with_capacity(goals.len()), Vec::new());
    for ((pose, goal), planned) in (0..).zip(goals).zip(planned) {
        let options =
            InverseOptions { criterion, reference: Some(planned.clone()), ..InverseOptions::default() };
        match inverse.solve(goal, &options) {
            Ok(found) => commands.push(found.command),
            Err(InverseError::Unreachable(why)) => {
                missed.push((pose, why.to_string()));
                commands.push(planned.clone());
            }
            Err(other) => return Err(refused(other)),
        }
    }
    Ok((commands, missed))
}

/// The tool's deflection at commands, from what a robot knows about itself: mean and largest, m.
pub(super) fn droop(
    robot: &CalibratedRobot,
    corrected: &Corrected,
    circumstances: &[Circumstances],
) -> Result<Option<[f64; 2]>, PipelineError> {
    if robot.model.statics.is_none() {
        return Ok(None);
    }
    let mut chain = ElasticChain::new(&robot.model).map_err(ElasticError::from)?;
    let in_flange = robot.targets.first().copied().unwrap_or_default();
    let (mut sum, mut most, mut count) = (0.0, 0.0_f64, 0_u32);
    for ((pose, command), known) in (0..).zip(&corrected.commands).zip(circumstances) {
        if corrected.uncorrected.iter().any(|(left_out, _)| *left_out == pose) {
            continue;
        }
        chain.set_payload(known.payload.as_ref()).map_err(ElasticError::from)?;
        let mut at = |deflection| {
            chain.settle(command, &[], deflection)?;
            Ok::<_, ElasticError>(chain.target(&in_flange))
        };
        let bent = (at(Deflection::Equilibrium)? - at(Deflection::None)?).norm();
        sum += bent;
        most = most.max(bent);
        count += 1;
    }
    Ok((count > 0).then(|| [sum / f64::from(count), most]))
}
