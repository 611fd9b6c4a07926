//! A session told to a recorder while it is measured.

use super::clock::Clock;
use super::story::{Measured, Preamble, Recorder};
use super::{RecordingError, record_evaluation};
use crate::input::Source;
use crate::model::{CalibrationModel, Visual};
use crate::pipeline::{InputSummary, MeasuredPose, Outcome, SessionEvent};

/// What a session does not say of itself.
#[derive(Debug, Clone, Copy)]
pub struct SessionContext<'a> {
    /// Where the measurements come from.
    pub input: &'a InputSummary,
    /// The input files by role.
    pub sources: &'a [(String, Source)],
    /// What identification is told beforehand.
    pub model: &'a CalibrationModel,
    /// What the links look like.
    pub visuals: &'a [Vec<Visual>],
}

/// Tells a recorder what happens in a session. It leaves the same recording as [`record`](super::record) of the finished run.
pub struct SessionRecorder<'a, R> {
    context: SessionContext<'a>,
    recorder: R,
    clock: Clock,
}

impl<'a, R: Recorder> SessionRecorder<'a, R> {
    /// Begins with a session that is about to begin.
    pub fn new(context: SessionContext<'a>, recorder: R) -> Self {
        Self { context, recorder, clock: Clock::default() }
    }

    /// Passes on what happened.
    pub fn hear(&mut self, event: SessionEvent<'_>) -> Result<(), RecordingError> {
        let now = self.clock.now();
        match event {
            SessionEvent::Begin { as_built, tracker_from_base, .. } => {
                let SessionContext { input, sources, model, visuals } = self.context;
                let truth = Some((as_built, tracker_from_base));
                self.recorder.open(&Preamble { input, sources, model, visuals, truth })
            }
            SessionEvent::Set { set, planned } => self.recorder.set(now, set, Some(planned)),
            SessionEvent::Measured(pose) => self.measured(&pose),
            SessionEvent::Dropped { kind, pose, reason, .. } => {
                self.recorder.dropped(now, kind, pose, reason)
            }
            SessionEvent::SetEnd { set } => {
                self.recorder.set_end(now, set.kind, set.measurements.observations.len())
            }
        }
    }

    fn measured(&mut self, pose: &MeasuredPose<'_>) -> Result<(), RecordingError> {
        let time = self.clock.time_of(pose.kind, pose.observation);
        self.recorder.measured(&Measured {
            kind: pose.kind,
            first: pose.index,
            observations: std::slice::from_ref(pose.observation),
            times: &[time],
            truth: std::slice::from_ref(pose.settled),
            rigid: pose.rigid.map_or(&[][..], std::slice::from_ref),
            effects: std::slice::from_ref(pose.effects),
        })
    }

    /// Tells what was made of the session, and gives the recorder back.
    pub fn evaluated(mut self, outcome: &Outcome) -> Result<R, RecordingError> {
        record_evaluation(outcome, &mut self.recorder)?;
        Ok(self.recorder)
    }
}
