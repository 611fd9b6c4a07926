//! Which pose is taken when, and when the nests are measured.

use super::plan::{NestRounds, PoseOrder, SessionPlan};
use crate::experiment::WorkingRegion;
use calibrig_model::measurement::SetKind;
use calibrig_model::random::{self, StreamSource};

/// A set as it is planned.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PlannedSet {
    pub kind: SetKind,
    pub noise: StreamSource,
    /// Joint variables in the order of measuring, and when the first reading of each pose is taken, s.
    pub poses: Vec<(Vec<f64>, f64)>,
}

/// A round of nests.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Round {
    /// When its first nest is measured, s.
    pub time: f64,
    /// Joint variables of the pose at which the machine stands meanwhile.
    pub joints: Vec<f64>,
}

/// The whole session.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Schedule {
    pub sets: Vec<PlannedSet>,
    pub rounds: Vec<Round>,
    /// Joint variables of the places of all sweeps, and when each is taken, s.
    pub sweeps: Vec<(Vec<f64>, f64)>,
    /// From the beginning to the end, s.
    pub duration: f64,
}

/// Draws and orders the poses of a session, and gives each its time. If they are listed, the first ones are taken, as many as are wanted.
pub(super) fn schedule(
    plan: &SessionPlan,
    (region, listed): (&WorkingRegion, [Option<&[Vec<f64>]>; 2]),
    counts: [(SetKind, u32); 2],
    nests: usize,
    (seed, trial): (u64, u32),
) -> Schedule {
    let NestRounds { every, after, two_faces, .. } = plan.rounds;
    let of_round = plan.timing.nest * nests as f64 * if two_faces { 2.0 } else { 1.0 };
    let mut time = plan.timing.warm_up;
    let mut at = region.centre.clone();
    let mut rounds = vec![Round { time, joints: at.clone() }];
    time += of_round;
    let mut sweeps = Vec::new();
    for joints in plan.sweeps.iter().flat_map(|sweep| sweep.poses(&region.centre)) {
        sweeps.push((joints, time));
        time += plan.seconds_per_place();
    }
    let (mut sets, mut done) = (Vec::new(), 0_u32);
    for ((kind, count), listed) in counts.into_iter().zip(listed).filter(|((_, count), _)| *count > 0) {
        let (drawing, noise) = match kind {
            SetKind::Identification => (StreamSource::IdentificationPoses, StreamSource::IdentificationNoise),
            SetKind::Verification => (StreamSource::VerificationPoses, StreamSource::VerificationNoise),
        };
        let mut stream = random::stream(seed, trial, drawing);
        let drawn: Vec<_> = match listed {
            Some(listed) => listed.iter().take(count as usize).cloned().collect(),
            None => (0..count).map(|_| region.draw(&mut stream)).collect(),
        };
        let ordered = match plan.order {
            PoseOrder::AsDrawn => drawn,
            PoseOrder::ShortTravel => region.by_short_ways(drawn),
        };
        let mut poses = Vec::with_capacity(ordered.len());
        for joints in ordered {
            if every > 0 && done > 0 && done.is_multiple_of(every) {
                rounds.push(Round { time, joints: at.clone() });
                time += of_round;
            }
            at.clone_from(&joints);
            poses.push((joints, time));
            time += plan.seconds_per_pose();
            done = done.saturating_add(1);
        }
        sets.push(PlannedSet { kind, noise, poses });
    }
    if after && done > 0 {
        rounds.push(Round { time, joints: at });
        time += of_round;
    }
    Schedule { sets, rounds, sweeps, duration: time }
}
