//! From an estimate to an accurate robot, with the proof: the commands of the verification set, of a pose test and of a path, corrected by every
//! identified robot, are driven on the machine and measured again.

mod commands;
mod path;
mod pose_test;

use std::ops::ControlFlow;

use self::commands::{Corrected, Tooled, droop, nominal_by};
use super::machine::AnalyticMachine;
use super::simulate::settle_options;
use super::{CalibrateError, Iso9283Failure, Outcome, PipelineError, PlantKind, ReachError, without_drift};
use crate::scenario::{CompensationPlan, Scenario};
use calibrig_estimation::compensation::CompensationError;
use calibrig_estimation::evaluation::closed_loop::{
    ClosedLoop, DriveFailure, DrivenCriterion, DrivenMode, DrivenPoint, measured_in_base, row,
};
use calibrig_estimation::identification::{CalibratedRobot, Mode};
use calibrig_estimation::inverse::{Circumstances, Criterion, Goal};
use calibrig_model::measurement::{MeasurementSet, SetKind, SetOutcome};
use calibrig_plant::Plant;
use calibrig_plant::session::{Approach, DriveError, DriveProgress, DrivenSet, Machine, MeasuringSession};
use thiserror::Error;

/// Why commands of a run cannot be corrected and driven.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ClosedLoopError {
    /// Nothing can be compensated.
    #[error("{}: {source}", mode.title())]
    Compensation {
        /// Whose commands.
        mode: Mode,
        /// Why.
        source: Box<CompensationError>,
    },
    /// The machine cannot reach a command.
    #[error("{source}")]
    Drive {
        /// Why.
        source: Box<DriveError<PipelineError>>,
    },
    /// The pose test is impossible.
    #[error("the pose test: {0}")]
    PoseTest(Box<Iso9283Failure>),
    /// The path is impossible.
    #[error("the path: {0}")]
    Path(Box<CompensationError>),
}

impl ClosedLoopError {
    fn of(mode: Mode, source: impl Into<CompensationError>) -> PipelineError {
        Self::Compensation { mode, source: Box::new(source.into()) }.into()
    }
}

impl From<ReachError> for ClosedLoopError {
    fn from(error: ReachError) -> Self {
        Self::PoseTest(Box::new(error.into()))
    }
}

/// Corrects the commands of a run's poses by every robot that it identified, drives them on the same machine, and measures the result: `None` if the
/// scenario has no `[compensation]`. The truth is not used; only the plant and the tracker know the scenario's machine. `progress` receives poses
/// done and of all, and may end it. Goals that a robot cannot meet, commands that cannot be driven, and an interruption are part of the result, so
/// that the run before is not lost.
pub fn close_loop(
    scenario: &Scenario,
    at: (u64, u32, PlantKind),
    outcome: &Outcome,
    progress: &mut DriveProgress<'_>,
) -> Option<ClosedLoop> {
    let plan = scenario.compensation.as_ref()?;
    let (seed, trial, plant) = at;
    let scenario = &*scenario.of_trial(seed, trial);
    let robots: Vec<_> = outcome.modes.iter().map(|mode| (mode, &mode.robot)).collect();
    let (_, nominal) = robots.iter().find(|(mode, _)| mode.mode == Mode::WithoutCalibration)?;
    let mut loop_ = Loop {
        scenario,
        session: scenario.session(),
        plan,
        at: (seed, trial),
        plant,
        outcome,
        nominal,
        done: 0,
        total: total(scenario, plan, outcome),
        failures: Vec::new(),
        interrupted: false,
        progress,
    };
    let closed = loop_.close();
    let driven = loop_.kept("corrected commands", closed);
    Some(driven.unwrap_or_else(|| ClosedLoop {
        rows_of_goal: 3,
        redundancy: plan.redundancy,
        modes: Vec::new(),
        criteria: Vec::new(),
        pose_test: None,
        path: None,
        failures: loop_.failures,
    }))
}

/// Number of poses that are driven in all.
fn total(scenario: &Scenario, plan: &CompensationPlan, outcome: &Outcome) -> u32 {
    let modes = u32::try_from(outcome.modes.len()).unwrap_or(u32::MAX);
    let criteria = u32::try_from(plan.compare.len()).unwrap_or(u32::MAX);
    let of_sets =
        modes.saturating_add(criteria.saturating_mul(2)).saturating_mul(scenario.verification_poses);
    let of_test = plan.cycles.unwrap_or(0).saturating_mul(5).saturating_mul(modes);
    let of_path = plan.path.as_ref().map_or(0, |path| u32::try_from(path.goals.len()).unwrap_or(u32::MAX));
    of_sets.saturating_add(of_test).saturating_add(of_path.saturating_mul(modes))
}

/// One machine, its session and its estimates.
struct Loop<'a, 'p> {
    scenario: &'a Scenario,
    session: MeasuringSession<'a>,
    plan: &'a CompensationPlan,
    at: (u64, u32),
    plant: PlantKind,
    outcome: &'a Outcome,
    /// The nominal robot at its best fit to the measurements.
    nominal: &'a CalibratedRobot,
    done: u32,
    total: u32,
    failures: Vec<DriveFailure>,
    interrupted: bool,
    progress: &'a mut DriveProgress<'p>,
}

impl Loop<'_, '_> {
    fn close(&mut self) -> Result<ClosedLoop, PipelineError> {
        let (planned, times): (Vec<Vec<f64>>, Vec<f64>) =
            self.session.verification_commands(self.at.0, self.at.1).into_iter().unzip();
        let circumstances = self.circumstances(&times);
        let goals = self.goals(&planned)?;
        let (nominal, missed) = self.resolved(&planned, &goals, self.plan.redundancy)?;
        let mut modes = Vec::new();
        for mode in &self.outcome.modes {
            let driven =
                self.corrected(mode.mode, &goals, &nominal, &circumstances).and_then(|mut corrected| {
                    corrected.leave_out(&missed);
                    self.drive_again(mode.mode, &goals, corrected)
                });
            modes.extend(self.kept(mode.mode.title(), driven));
        }
        let criteria = self.compared(&planned, &goals, &circumstances);
        let criteria = self.kept("the redundancy resolved otherwise", criteria).unwrap_or_default();
        let mut pose_test = None;
        if let Some(cycles) = self.plan.cycles {
            let driven = self.pose_test(cycles);
            pose_test = self.kept("the pose test", driven);
        }
        let mut path = None;
        if let Some(plan) = &self.plan.path {
            let driven = self.path(plan);
            path = self.kept("the path", driven);
        }
        Ok(ClosedLoop {
            rows_of_goal: goals.first().map_or(3, Goal::rows),
            redundancy: self.plan.redundancy,
            modes,
            criteria,
            pose_test,
            path,
            failures: std::mem::take(&mut self.failures),
        })
    }

    /// What was driven; or `None`, with the reason among the failures. After an interruption nothing more is driven, which is reported
    /// once.
    fn kept<T>(&mut self, what: &str, driven: Result<T, PipelineError>) -> Option<T> {
        let error = match driven {
            Ok(driven) => return Some(driven),
            Err(PipelineError::Interrupted { .. }) if self.interrupted => return None,
            Err(error) => error,
        };
        self.interrupted |= matches!(error, PipelineError::Interrupted { .. });
        self.failures.push(DriveFailure { what: what.to_owned(), why: error.to_string() });
        None
    }

    /// What a controller knows about each pose of the verification set before it is driven; its first readings are at these times,
    /// s.
    fn circumstances(&self, times: &[f64]) -> Vec<Circumstances> {
        let payloads = &self.scenario.plan.payloads;
        let planned = |(pose, time): (usize, &f64)| Circumstances {
            payload: payloads.at(SetKind::Verification, pose, times.len()).map(|own| own.stated.clone()),
            time: *time,
            ..Circumstances::default()
        };
        let mut all: Vec<Circumstances> = times.iter().enumerate().map(planned).collect();
        let mut read = vec![false; all.len()];
        let sets = self.outcome.sets.iter().filter(|set| set.kind == SetKind::Verification);
        for observation in sets.flat_map(|set| &set.measurements.observations) {
            let pose = observation.pose as usize;
            let (Some(own), Some(read)) = (all.get_mut(pose), read.get_mut(pose)) else { continue };
            if !std::mem::replace(read, true) {
                own.temperature = observation.temperature;
                own.time = observation.time;
                own.approach.clone_from(&observation.approach);
                own.since_reversal.clone_from(&observation.since_reversal);
            }
            // Visits from both sides have one command.
            for (sign, other) in own.approach.iter_mut().zip(&observation.approach) {
                if sign != other {
                    *sign = 0;
                }
            }
        }
        all
    }

    /// The tool's places at its commands, as the controller believes.
    fn goals(&self, commands: &[Vec<f64>]) -> Result<Vec<Goal>, PipelineError> {
        let tooled = Tooled::new(self.nominal, self.plan)?;
        commands.iter().map(|command| tooled.goal(command)).collect()
    }

    /// The nominal commands for goals, by a criterion within the working region or as planned; and the poses for which there are
    /// none.
    fn resolved(
        &self,
        planned: &[Vec<f64>],
        goals: &[Goal],
        criterion: Option<Criterion>,
    ) -> Result<Resolved, PipelineError> {
        let Some(criterion) = criterion else { return Ok((planned.to_vec(), Vec::new())) };
        nominal_by(self.scenario, Tooled::new(self.nominal, self.plan)?.tool, criterion, planned, goals)
    }

    /// The commands of a mode.
    fn corrected(
        &self,
        mode: Mode,
        goals: &[Goal],
        nominal: &[Vec<f64>],
        circumstances: &[Circumstances],
    ) -> Result<Corrected, PipelineError> {
        let Some(outcome) = self.outcome.modes.iter().find(|own| own.mode == mode) else {
            return Ok(Corrected::as_planned(nominal));
        };
        let Some(estimate) = &outcome.estimate else { return Ok(Corrected::as_planned(nominal)) };
        let home = self.session.actuators.command_from_joints(&self.scenario.region.centre);
        let travelled = matches!(self.scenario.plan.approach, Approach::AsTravelled);
        let from = travelled.then_some(home.as_slice());
        commands::correct(estimate, self.plan, goals, nominal, (circumstances, from))
    }

    fn drive_again(
        &mut self,
        mode: Mode,
        goals: &[Goal],
        corrected: Corrected,
    ) -> Result<DrivenMode, PipelineError> {
        let at = self.at;
        let driven = self.drive(|session, machine, progress| {
            session.measure_again(machine, at, &corrected.commands, progress)
        })?;
        self.driven_mode(mode, goals, corrected, driven)
    }

    /// Readings of the tool, in the base frame of the mode, against its goals.
    fn driven_mode(
        &self,
        mode: Mode,
        goals: &[Goal],
        corrected: Corrected,
        driven: DrivenSet,
    ) -> Result<DrivenMode, PipelineError> {
        let set = self.steady(driven.set)?;
        let robot =
            self.outcome.modes.iter().find(|own| own.mode == mode).map_or(self.nominal, |own| &own.robot);
        let measured = measured_in_base(robot, &set.measurements)
            .map_err(|source| CalibrateError::Predict { mode, source })?;
        let points =
            set.measurements.observations.iter().zip(measured).filter_map(|(observation, measured)| {
                let index = observation.pose as usize;
                let is_left_out = corrected.uncorrected.iter().any(|(pose, _)| *pose == observation.pose);
                if observation.target != 0 || is_left_out {
                    return None;
                }
                Some(DrivenPoint {
                    pose: observation.pose,
                    goal: goals.get(index)?.position(),
                    measured,
                    command: observation.command.clone(),
                    sigma: corrected.sigmas.get(index).copied().flatten(),
                })
            });
        let points = points.collect();
        let Corrected { uncorrected, position_alone, .. } = corrected;
        Ok(DrivenMode { mode, points, set, uncorrected, position_alone })
    }

    /// A set corrected for the motion of the trackers, from the session's rounds of nests.
    fn steady(&self, set: SetOutcome) -> Result<SetOutcome, PipelineError> {
        let whole =
            if self.outcome.as_measured.is_empty() { &self.outcome.sets } else { &self.outcome.as_measured };
        let mut sets: Vec<SetOutcome> = whole.iter().take(1).cloned().collect();
        sets.push(set);
        let empty = || SetOutcome {
            kind: SetKind::Verification,
            measurements: MeasurementSet::default(),
            dropped: Vec::new(),
        };
        Ok(without_drift(sets)?.sets.pop().unwrap_or_else(empty))
    }

    /// The verification set by other criteria, with the commands of the fullest mode.
    fn compared(
        &mut self,
        planned: &[Vec<f64>],
        goals: &[Goal],
        circumstances: &[Circumstances],
    ) -> Result<Vec<DrivenCriterion>, PipelineError> {
        let fullest = self.outcome.modes.iter().rev().find(|mode| mode.estimate.is_some());
        let Some((mode, robot)) = fullest.map(|mode| (mode.mode, &mode.robot)) else { return Ok(Vec::new()) };
        let mut rows = Vec::new();
        for criterion in &self.plan.compare {
            let (nominal, missed) = self.resolved(planned, goals, *criterion)?;
            let mut corrected = self.corrected(mode, goals, &nominal, circumstances)?;
            corrected.leave_out(&missed);
            let droop = droop(robot, &corrected, circumstances)?;
            let (missed, left_out) = (corrected.uncorrected.len(), corrected.uncorrected.clone());
            let corrected = self.drive_again(mode, goals, corrected)?;
            let mut plain = Corrected::as_planned(&nominal);
            plain.leave_out(&left_out);
            let nominal = self.drive_again(Mode::WithoutCalibration, goals, plain)?;
            rows.push(DrivenCriterion {
                criterion: *criterion,
                mode,
                position_alone: corrected.position_alone.len(),
                droop,
                nominal: row(&nominal.points),
                corrected: row(&corrected.points),
                missed,
            });
        }
        Ok(rows)
    }

    /// Drives the machine of the run, and counts.
    fn drive<T>(
        &mut self,
        drive: impl FnOnce(
            &MeasuringSession<'_>,
            &mut Driven,
            &mut DriveProgress<'_>,
        ) -> Result<T, DriveError<PipelineError>>,
    ) -> Result<T, PipelineError> {
        let (before, total) = (self.done, self.total);
        if self.interrupted {
            return Err(PipelineError::Interrupted { done: before, total });
        }
        let mut machine = Driven::new(self.scenario, self.at.1, self.plant)?;
        let mut most = 0;
        let progress = &mut *self.progress;
        let driven = drive(&self.session, &mut machine, &mut |done, _| {
            most = most.max(done);
            match progress(before.saturating_add(done), total) {
                ControlFlow::Break(()) if before.saturating_add(done) < total => ControlFlow::Break(()),
                _ => ControlFlow::Continue(()),
            }
        });
        self.done = before.saturating_add(most);
        driven.map_err(|source| match source {
            DriveError::Session(error) => match PipelineError::from(error) {
                PipelineError::Interrupted { done, .. } => {
                    PipelineError::Interrupted { done: before.saturating_add(done), total }
                }
                other => other,
            },
            source => ClosedLoopError::Drive { source: Box::new(source) }.into(),
        })
    }
}

/// Nominal commands, and the poses without one.
type Resolved = (Vec<Vec<f64>>, Vec<(u32, String)>);

/// The model of the machine.
enum Driven {
    Rapier(Box<Plant>),
    Analytic(Box<AnalyticMachine>),
}

impl Driven {
    fn new(scenario: &Scenario, trial: u32, plant: PlantKind) -> Result<Self, PipelineError> {
        Ok(match plant {
            PlantKind::Rapier => {
                Self::Rapier(Box::new(Plant::new(&scenario.as_built, settle_options(trial))?))
            }
            PlantKind::Analytic => Self::Analytic(Box::new(AnalyticMachine::new(&scenario.as_built)?)),
        })
    }
}

/// So that a drive needs no separate code for either.
impl Machine for Driven {
    type Error = PipelineError;

    fn settle(
        &mut self,
        motors: &[f64],
        displacements: &[[f64; 6]],
    ) -> Result<calibrig_plant::SettledPose, PipelineError> {
        match self {
            Self::Rapier(plant) => Ok(Machine::settle(&mut **plant, motors, displacements)?),
            Self::Analytic(machine) => Ok(machine.settle(motors, displacements)?),
        }
    }

    fn pass(&mut self, motors: &[f64]) -> Result<calibrig_plant::SettledPose, PipelineError> {
        match self {
            Self::Rapier(plant) => Ok(Machine::pass(&mut **plant, motors)?),
            Self::Analytic(machine) => Ok(machine.pass(motors)?),
        }
    }

    fn carry(&mut self, payload: Option<&calibrig_model::Payload>) -> Result<(), PipelineError> {
        match self {
            Self::Rapier(plant) => Ok(Machine::carry(&mut **plant, payload)?),
            Self::Analytic(machine) => Ok(machine.carry(payload)?),
        }
    }
}
