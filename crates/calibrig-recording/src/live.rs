//! Tells a recorder about a session while it is measured.

use super::Story;
use super::clock::Clock;
use super::story::{Measured, Preamble, Recorder, TrueSetting};
use super::{RecordingError, record_evaluation};
use calibrig_plant::session::{MeasuredPose, SessionEvent};

/// Tells a recorder what happens in a session. The recording is the same as that of [`record`](super::record) after the run.
pub struct SessionRecorder<'a, R> {
    preamble: Preamble<'a>,
    recorder: R,
    clock: Clock,
}

impl<'a, R: Recorder> SessionRecorder<'a, R> {
    /// For a session that is about to begin. The truth comes from the session, not from the preamble.
    pub fn new(preamble: Preamble<'a>, recorder: R) -> Self {
        Self { preamble, recorder, clock: Clock::default() }
    }

    /// Passes on what happened.
    pub fn hear(&mut self, event: SessionEvent<'_>) -> Result<(), RecordingError> {
        let now = self.clock.now();
        match event {
            SessionEvent::Begin { as_built, stations, further_targets, payloads, .. } => {
                let truth = Some(TrueSetting { as_built, stations, further_targets, payloads });
                self.recorder.open(&Preamble { truth, ..self.preamble })
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
        let times: Vec<u64> =
            pose.observations.iter().map(|own| self.clock.time_of(pose.kind, own)).collect();
        self.recorder.measured(&Measured {
            kind: pose.kind,
            first: pose.first,
            observations: pose.observations,
            times: &times,
            truth: pose.settled,
            rigid: pose.rigid,
            effects: pose.effects,
        })
    }

    /// Tells the evaluation of the session, and gives the recorder back.
    pub fn evaluated(mut self, story: &Story<'_>) -> Result<R, RecordingError> {
        record_evaluation(story, &mut self.recorder)?;
        Ok(self.recorder)
    }
}
