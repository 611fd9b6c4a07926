//! A measuring session while it goes on, for recording or progress.

use std::ops::ControlFlow;

use nalgebra::Vector3;

use crate::effects::PoseEffects;
use crate::{AsBuilt, SettledPose};
use calibrig_model::Payload;
use calibrig_model::geometry::Transform;
use calibrig_model::measurement::{Observation, SetKind, SetOutcome};

/// The events of a simulated session, in this order: `Begin`, then for one set at a time `Set`, its poses, `SetEnd`.
#[derive(Debug, Clone, Copy)]
pub enum SessionEvent<'a> {
    /// The machine and the tracker are set up.
    Begin {
        /// The machine.
        as_built: &'a AsBuilt,
        /// `tracker_from_base` of every station.
        stations: &'a [Transform],
        /// Real offsets of the targets besides the machine's own, in the flange frame, m.
        further_targets: &'a [Vector3<f64>],
        /// The loads that the flange carries at some poses, as they really are.
        payloads: &'a [Payload],
        /// Poses planned over all sets.
        poses: u32,
    },
    /// A set begins.
    Set {
        /// Its stations and targets; no observation yet.
        set: &'a SetOutcome,
        /// Poses planned for it.
        planned: u32,
    },
    /// A pose was measured.
    Measured(MeasuredPose<'a>),
    /// A pose was planned but not measured.
    Dropped {
        /// The set.
        kind: SetKind,
        /// Number of the pose in its set.
        pose: u32,
        /// Why.
        reason: &'a str,
        /// Since the session began, s.
        time: f64,
    },
    /// A set is complete.
    SetEnd {
        /// The whole of it.
        set: &'a SetOutcome,
    },
}

/// All readings of a measured pose with their truth, one entry per reading in each list.
#[derive(Debug, Clone, Copy)]
pub struct MeasuredPose<'a> {
    /// The set.
    pub kind: SetKind,
    /// Place of the first observation in its set.
    pub first: usize,
    /// What was measured.
    pub observations: &'a [Observation],
    /// The machine at rest, with the target that was observed.
    pub settled: &'a [SettledPose],
    /// The same for a rigid machine; empty if not asked for.
    pub rigid: &'a [SettledPose],
    /// The result of the machine's effects at the pose.
    pub effects: &'a [PoseEffects],
}

/// Receives the events; `Break` ends the session.
pub type SessionListener<'a> = dyn FnMut(SessionEvent<'_>) -> ControlFlow<()> + 'a;

/// A listener that counts: `progress` receives the number of poses done and of all poses.
pub fn counting(mut progress: impl FnMut(u32, u32)) -> impl FnMut(SessionEvent<'_>) -> ControlFlow<()> {
    let (mut done, mut total) = (0, 0);
    move |event| {
        match event {
            SessionEvent::Begin { poses, .. } => total = poses,
            SessionEvent::Measured(_) | SessionEvent::Dropped { .. } => {
                done += 1;
                progress(done, total);
            }
            SessionEvent::Set { .. } | SessionEvent::SetEnd { .. } => {}
        }
        ControlFlow::Continue(())
    }
}
