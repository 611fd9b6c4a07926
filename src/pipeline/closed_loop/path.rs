//! A path over a panel, driven with the commands of every mode.

use super::commands::{Corrected, Tooled, correct};
use super::{ClosedLoopError, Loop, PipelineError};
use crate::pipeline::iso9283::within;
use crate::scenario::PathPlan;
use calibrig_estimation::compensation::{CompensationError, Compensator, PathOptions, PointStatus, ToolPath};
use calibrig_estimation::evaluation::closed_loop::{DrivenMode, DrivenPath};
use calibrig_estimation::identification::{CalibratedRobot, Mode};
use calibrig_estimation::inverse::{Circumstances, Criterion, Goal, InverseOptions};

impl Loop<'_, '_> {
    pub(super) fn path(&mut self, plan: &PathPlan) -> Result<DrivenPath, PipelineError> {
        let refused = |error: CompensationError| PipelineError::from(ClosedLoopError::Path(Box::new(error)));
        let asked = ToolPath::at_speed(&plan.goals, plan.speed).map_err(|error| refused(error.into()))?;
        let home = self.session.actuators.command_from_joints(&self.scenario.region.centre);
        // As the controller of the rigid robot would have it.
        let tool = Tooled::new(self.nominal, self.plan)?.tool;
        let options = PathOptions {
            inverse: InverseOptions {
                criterion: self.plan.redundancy.unwrap_or(Criterion::FAR_FROM_LIMITS),
                reference: Some(home.clone()),
                ..InverseOptions::default()
            },
            ..PathOptions::default()
        };
        let within = CalibratedRobot {
            nominal: within(&self.nominal.nominal, &self.scenario.region),
            ..self.nominal.clone()
        };
        let mut controller = Compensator::new(&within, tool).map_err(refused)?;
        let followed = controller.path(&asked, &options).map_err(refused)?;
        let (mut goals, mut nominal, mut times) = (Vec::new(), Vec::new(), Vec::new());
        let (mut numbers, mut unreachable) = (Vec::new(), Vec::new());
        for (number, report) in (0..).zip(&followed.points) {
            match (&report.status, report.point()) {
                (PointStatus::Unreachable(why), _) => unreachable.push((number, why.to_string())),
                (PointStatus::Failed(why), _) => unreachable.push((number, why.clone())),
                (_, Some(point)) => {
                    numbers.push(number);
                    goals.push(point.goal);
                    nominal.push(point.command.clone());
                    times.push(report.asked.time);
                }
                _ => {}
            }
        }
        let circumstances = self.on_the_path(&times);
        let mut modes = Vec::new();
        for outcome in &self.outcome.modes {
            let corrected = match &outcome.estimate {
                None => Ok(Corrected::as_planned(&nominal)),
                Some(estimate) => {
                    correct(estimate, self.plan, &goals, &nominal, (&circumstances, Some(&home)))
                }
            };
            let driven = corrected
                .and_then(|corrected| self.drive_path(outcome.mode, (&goals, &times, &numbers), corrected));
            modes.extend(self.kept(&format!("the path, {}", outcome.mode.title()), driven));
        }
        Ok(DrivenPath { length: asked.length(), speed: plan.speed, unreachable, modes })
    }

    fn drive_path(
        &mut self,
        mode: Mode,
        (goals, times, numbers): (&[Goal], &[f64], &[u32]),
        corrected: Corrected,
    ) -> Result<DrivenMode, PipelineError> {
        let at = self.at;
        let points: Vec<_> = corrected.commands.iter().cloned().zip(times.iter().copied()).collect();
        let driven =
            self.drive(|session, machine, progress| session.measure_path(machine, at, &points, progress))?;
        let mut mode = self.driven_mode(mode, goals, corrected, driven)?;
        // From places among the points that are reached to those of the path.
        let number = |place: &mut u32| *place = numbers.get(*place as usize).copied().unwrap_or(*place);
        mode.points.iter_mut().for_each(|point| number(&mut point.pose));
        mode.set.measurements.observations.iter_mut().for_each(|own| number(&mut own.pose));
        let lists = [&mut mode.uncorrected, &mut mode.position_alone, &mut mode.set.dropped];
        lists.into_iter().flatten().for_each(|(pose, _)| number(pose));
        Ok(mode)
    }

    /// A path begins where the session ends, in the air of its last reading.
    fn on_the_path(&self, times: &[f64]) -> Vec<Circumstances> {
        let end = self.session.duration();
        let last = self.outcome.sets.last().and_then(|set| set.measurements.observations.last());
        let temperature = last.and_then(|observation| observation.temperature);
        times
            .iter()
            .map(|time| Circumstances { temperature, time: end + time, ..Circumstances::default() })
            .collect()
    }
}
