//! Cycles over the poses of ISO 9283 with the commands of every mode.

use nalgebra::Vector3;

use super::commands::{Corrected, Tooled, correct};
use super::{CalibrateError, ClosedLoopError, Loop, PipelineError};
use crate::pipeline::iso9283::{cube_of, cycles_failed};
use crate::pipeline::{Iso9283Failure, Iso9283Plan};
use calibrig_estimation::evaluation::closed_loop::{DrivenPoseTest, measured_in_base};
use calibrig_estimation::evaluation::iso9283::{
    CubePlane, PositionAccuracy, PositionRepeatability, position_accuracy, position_repeatability,
};
use calibrig_estimation::identification::{Estimate, Mode};
use calibrig_estimation::inverse::{Circumstances, Goal};
use calibrig_model::measurement::{SetKind, SetOutcome};

impl Loop<'_, '_> {
    pub(super) fn pose_test(&mut self, cycles: u32) -> Result<DrivenPoseTest, PipelineError> {
        let plan = Iso9283Plan { cycles, edge: None, centre: None, plane: CubePlane::C1C2C7C8 };
        let (cube, joints) = cube_of(self.scenario, &plan).map_err(ClosedLoopError::from)?;
        let planned: Vec<Vec<f64>> =
            joints.iter().map(|q| self.session.actuators.command_from_joints(q)).collect();
        let tooled = Tooled::new(self.nominal, self.plan)?;
        let goals: Vec<Goal> =
            planned.iter().map(|command| tooled.goal(command)).collect::<Result<_, _>>()?;
        let mut modes = Vec::new();
        for outcome in &self.outcome.modes {
            let corrected = match &outcome.estimate {
                None => Ok(Corrected::as_planned(&planned)),
                Some(estimate) => self.corrected_cycle(estimate, &goals, &planned),
            };
            let driven =
                corrected.and_then(|corrected| self.cycles(outcome.mode, &goals, &corrected, cycles));
            let driven = self.kept(&format!("the pose test, {}", outcome.mode.title()), driven);
            modes.extend(driven.map(|poses| (outcome.mode, poses)));
        }
        Ok(DrivenPoseTest { cube, cycles: cycles as usize, modes })
    }

    /// A cycle goes from the last pose to the first, and its last pose comes from there.
    fn corrected_cycle(
        &self,
        estimate: &Estimate,
        goals: &[Goal],
        planned: &[Vec<f64>],
    ) -> Result<Corrected, PipelineError> {
        let backward: Vec<Goal> = goals.iter().rev().copied().collect();
        let commands: Vec<Vec<f64>> = planned.iter().rev().cloned().collect();
        let circumstances = vec![self.behind_the_session(); planned.len()];
        let from = planned.first().map(Vec::as_slice);
        let mut own = correct(estimate, self.plan, &backward, &commands, (&circumstances, from))?;
        own.commands.reverse();
        let last = u32::try_from(planned.len()).unwrap_or(u32::MAX).saturating_sub(1);
        own.uncorrected.iter_mut().for_each(|(pose, _)| *pose = last.saturating_sub(*pose));
        Ok(own)
    }

    fn behind_the_session(&self) -> Circumstances {
        let last = self.outcome.sets.last().and_then(|set| set.measurements.observations.last());
        let temperature = last.and_then(|observation| observation.temperature);
        Circumstances { temperature, time: self.session.duration(), ..Circumstances::default() }
    }

    fn cycles(
        &mut self,
        mode: Mode,
        goals: &[Goal],
        corrected: &Corrected,
        cycles: u32,
    ) -> Result<Vec<(PositionAccuracy, PositionRepeatability)>, PipelineError> {
        let failed =
            |failure: Iso9283Failure| PipelineError::from(ClosedLoopError::PoseTest(Box::new(failure)));
        if let Some((pose, why)) = corrected.uncorrected.first() {
            return Err(failed(Iso9283Failure::Uncorrected { pose: pose + 1, mode, why: why.clone() }));
        }
        let joints: Vec<Vec<f64>> = corrected
            .commands
            .iter()
            .map(|command| {
                let mut joints = vec![0.0; command.len()];
                self.session.actuators.joints_from_command(command, &mut joints);
                joints
            })
            .collect();
        let (before, total) = (self.done, self.total);
        if self.interrupted {
            return Err(PipelineError::Interrupted { done: before, total });
        }
        let mut machine = super::Driven::new(self.scenario, self.at.1, self.plant)?;
        let progress = &mut *self.progress;
        let measured = self
            .session
            .measure_cycles(&mut machine, self.at, &joints, cycles, &mut |done, _| {
                progress(before.saturating_add(done), total)
            })
            .map_err(|error| match cycles_failed(error) {
                Iso9283Failure::Pipeline(PipelineError::Interrupted { done, .. }) => {
                    PipelineError::Interrupted { done: before.saturating_add(done), total }
                }
                other => failed(other),
            })?;
        self.done = before.saturating_add(cycles.saturating_mul(5));
        let set = SetOutcome {
            kind: SetKind::Verification,
            measurements: measured.measurements,
            dropped: Vec::new(),
        };
        let set = self.steady(set)?.measurements;
        let robot =
            self.outcome.modes.iter().find(|own| own.mode == mode).map_or(self.nominal, |own| &own.robot);
        let places =
            measured_in_base(robot, &set).map_err(|source| CalibrateError::Predict { mode, source })?;
        let of_pose = |(number, goal): (u32, &Goal)| {
            let read = set.observations.iter().zip(&places);
            let own = read.filter(|(observation, _)| observation.pose == number && observation.target == 0);
            let attained: Vec<Vector3<f64>> = own.map(|(_, place)| *place).collect();
            let errors: Vec<Vector3<f64>> = attained.iter().map(|place| place - goal.position()).collect();
            position_accuracy(&errors).zip(position_repeatability(&attained))
        };
        Ok((1..).zip(goals).filter_map(of_pose).collect())
    }
}
