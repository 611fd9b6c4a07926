//! What a session has besides a sequence of poses: stations, targets, visits, times, rounds of nests, lines of sight.

use nalgebra::{UnitVector3, Vector3};
use thiserror::Error;

use super::payloads::PayloadPlan;
use super::sweeps::PlannedSweep;
use crate::tracker::STATED_AVERAGING;
use calibrig_model::PayloadError;
use calibrig_model::geometry::Transform;
use calibrig_model::visibility::Obstacles;

/// How a session is carried out. The default is the simplest: one station, one target, one reading per pose every 10 s, nests once before, and free
/// lines of sight.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionPlan {
    /// Trackers besides the first. All stand throughout the session and are of one make: they share the errors of instrument and air, but
    /// each has its own stand.
    pub stations: Vec<FurtherStation>,
    /// Which stations read a pose.
    pub share: StationShare,
    /// Direction of the first target's opening, in the flange frame; `None` if it is always turned to the tracker.
    pub opening: Option<UnitVector3<f64>>,
    /// Targets besides the first.
    pub targets: Vec<FurtherTarget>,
    /// Visits of each pose.
    pub repeats: u32,
    /// From where each visit comes.
    pub approach: Approach,
    /// The order of the poses.
    pub order: PoseOrder,
    /// How long things take.
    pub timing: Timing,
    /// When nests are measured.
    pub rounds: NestRounds,
    /// Joints that are moved one at a time, after the first round of nests.
    pub sweeps: Vec<PlannedSweep>,
    /// What the flange carries at which pose.
    pub payloads: PayloadPlan,
    /// What can hide a target; `None`: every line of sight is free and every target turned to the tracker.
    pub sight: Option<Sight>,
}

/// A tracker besides the first.
#[derive(Debug, Clone, PartialEq)]
pub struct FurtherStation {
    /// Name for people.
    pub name: String,
    /// Its real place when the session begins.
    pub tracker_from_base: Transform,
}

/// A target besides the first.
#[derive(Debug, Clone, PartialEq)]
pub struct FurtherTarget {
    /// Name for people.
    pub name: String,
    /// Its real place in the flange frame, m.
    pub in_flange: Vector3<f64>,
    /// Direction of its opening, in the flange frame.
    pub opening: Option<UnitVector3<f64>>,
}

/// Which stations read a pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum StationShare {
    /// The one that sees most targets, the nearest among equals.
    #[default]
    Best,
    /// All that see a target.
    All,
}

impl StationShare {
    /// The key in files.
    pub fn key(self) -> &'static str {
        match self {
            Self::Best => "best",
            Self::All => "all",
        }
    }
}

/// From where the machine comes to a pose.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Approach {
    /// From the pose before. A pose that is visited again is read again at rest.
    #[default]
    AsTravelled,
    /// From below for every joint variable, by this much (m of a rail, rad of a turning joint) or up to its limit.
    OneSide([f64; 2]),
    /// The same, from below and above in turn.
    BothSides([f64; 2]),
}

/// The order of the poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PoseOrder {
    /// In the order of drawing.
    #[default]
    AsDrawn,
    /// By short paths: the nearest pose next, then pieces of the path reversed as long as that shortens it. The length of a step is the
    /// largest motion of a joint, relative to its working range.
    ShortTravel,
}

impl PoseOrder {
    /// The key in files.
    pub fn key(self) -> &'static str {
        match self {
            Self::AsDrawn => "as_drawn",
            Self::ShortTravel => "short_travel",
        }
    }
}

/// How long things take, s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Timing {
    /// Before the first reading: machine and tracker are switched on and warm up.
    pub warm_up: f64,
    /// From one pose to the next.
    pub motion: f64,
    /// Until the machine stands still.
    pub settling: f64,
    /// Of every reading.
    pub averaging: f64,
    /// From one nest to the next.
    pub nest: f64,
}

impl Default for Timing {
    fn default() -> Self {
        Self { warm_up: 0.0, motion: 8.0, settling: 1.0, averaging: STATED_AVERAGING, nest: 0.0 }
    }
}

/// When the base nests are measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct NestRounds {
    /// Again after this many poses; zero for never.
    pub every: u32,
    /// Again after the last pose.
    pub after: bool,
    /// In both faces.
    pub two_faces: bool,
    /// Whether readings of nests have times.
    pub timed: bool,
}

/// What can hide a target.
#[derive(Debug, Clone, PartialEq)]
pub struct Sight {
    /// Links and floor.
    pub obstacles: Obstacles,
    /// Largest angle between a target's opening and the beam, rad.
    pub acceptance: f64,
}

impl Default for SessionPlan {
    fn default() -> Self {
        Self {
            stations: Vec::new(),
            share: StationShare::default(),
            opening: None,
            targets: Vec::new(),
            repeats: 1,
            approach: Approach::default(),
            order: PoseOrder::default(),
            timing: Timing::default(),
            rounds: NestRounds::default(),
            sweeps: Vec::new(),
            payloads: PayloadPlan::default(),
            sight: None,
        }
    }
}

/// Number of poses up to which a short path is searched: beyond, the search takes too long.
pub const MOST_ORDERED_POSES: u32 = 5000;
/// Number of visits of a pose up to which places in the random streams do not overlap with those of others.
pub const MOST_REPEATS: u32 = 1000;

/// Least number of places of a sweep that determine its line or circle ...
pub const LEAST_PLACES: u32 = 5;
/// ... and the largest number worth its time.
pub const MOST_PLACES: u32 = 1000;

/// A plan that cannot be carried out.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum PlanError {
    /// No visit, or too many.
    #[error("{repeats} visits of each pose: expected 1 to {MOST_REPEATS}")]
    Repeats {
        /// Their number.
        repeats: u32,
    },
    /// An invalid time.
    #[error("{what} takes {seconds} s: expected zero to {MOST_SECONDS} s, and an averaging above zero")]
    Time {
        /// Which.
        what: &'static str,
        /// s
        seconds: f64,
    },
    /// More than [`MOST_ORDERED_POSES`].
    #[error(
        "{poses} poses of a set are too many for ordering by the shortest way: expected up to {MOST_ORDERED_POSES}, or the \
         order of drawing"
    )]
    Order {
        /// Their number.
        poses: u32,
    },
    /// A sweep that does not move its joint, or in too few or too many places.
    #[error(
        "a sweep of joint {} from {} to {} (m or rad) in {} places: expected two different finite values, and {} to \
         {MOST_PLACES} places",
        sweep.joint.saturating_add(1), sweep.range[0], sweep.range[1], sweep.places, LEAST_PLACES
    )]
    Sweep {
        /// As planned.
        sweep: PlannedSweep,
    },
    /// An invalid load.
    #[error(transparent)]
    Carried(#[from] PayloadError),
    /// A load that the plan does not have.
    #[error("a pose carries payload index {index}, but there are {payloads} payloads")]
    Payload {
        /// Index asked for.
        index: usize,
        /// Their number.
        payloads: usize,
    },
    /// An invalid approach distance.
    #[error("the approach distance is {distance} (m or rad): expected a finite number above zero")]
    Approach {
        /// m or rad
        distance: f64,
    },
}

/// Longest time of a part of a session, s: a day and a bit. A drift is drawn minute by minute.
pub const MOST_SECONDS: f64 = 1e5;

impl SessionPlan {
    /// Whether it can be carried out with sets of so many poses.
    ///
    /// # Errors
    ///
    /// [`PlanError`].
    pub fn check(&self, most_poses: u32) -> Result<(), PlanError> {
        if !(1..=MOST_REPEATS).contains(&self.repeats) {
            return Err(PlanError::Repeats { repeats: self.repeats });
        }
        let Timing { warm_up, motion, settling, averaging, nest } = self.timing;
        let times = [
            ("the warm-up", warm_up),
            ("the motion", motion),
            ("settling", settling),
            ("a reading", averaging),
            ("a nest", nest),
        ];
        for (what, seconds) in times {
            let is_sound = (0.0..=MOST_SECONDS).contains(&seconds) && (what != "a reading" || seconds > 0.0);
            if !is_sound {
                return Err(PlanError::Time { what, seconds });
            }
        }
        if self.order == PoseOrder::ShortTravel && most_poses > MOST_ORDERED_POSES {
            return Err(PlanError::Order { poses: most_poses });
        }
        self.payloads.check()?;
        let is_sound = |sweep: &&PlannedSweep| {
            let moves = sweep.range.iter().all(|end| end.is_finite()) && sweep.range[0] != sweep.range[1];
            moves && (LEAST_PLACES..=MOST_PLACES).contains(&sweep.places)
        };
        if let Some(sweep) = self.sweeps.iter().find(|sweep| !is_sound(sweep)) {
            return Err(PlanError::Sweep { sweep: *sweep });
        }
        if let Approach::OneSide(distances) | Approach::BothSides(distances) = self.approach
            && let Some(&distance) = distances.iter().find(|d| !(d.is_finite() && **d > 0.0))
        {
            return Err(PlanError::Approach { distance });
        }
        Ok(())
    }

    /// Time that a place of a sweep takes, s.
    pub(super) fn seconds_per_place(&self) -> f64 {
        let Timing { motion, settling, averaging, .. } = self.timing;
        let readings = (1 + self.stations.len()) * (1 + self.targets.len());
        motion + settling + averaging * readings as f64
    }

    /// Readings of a visit: of every target, by one station or by all.
    pub fn readings_per_visit(&self) -> u32 {
        let stations = match self.share {
            StationShare::Best => 1,
            StationShare::All => 1 + self.stations.len(),
        };
        u32::try_from(stations * (1 + self.targets.len())).unwrap_or(u32::MAX)
    }

    /// Time that a pose takes with all its visits, s.
    pub fn seconds_per_pose(&self) -> f64 {
        let Timing { motion, settling, averaging, .. } = self.timing;
        f64::from(self.repeats) * (motion + settling + averaging * f64::from(self.readings_per_visit()))
    }
}
