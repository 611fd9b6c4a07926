//! Which candidates can be measured, by the nominal robot (or the one that an earlier session found).

use std::collections::BTreeMap;
use std::fmt;

use calibrig_estimation::identification::{CalibratedRobot, PredictionError, Predictor};
use calibrig_model::geometry::Transform;
use calibrig_model::nalgebra::{UnitVector3, Vector3};
use calibrig_model::visibility::{
    Built, Contact, Hidden, Obstacles, Reflector, Room, Stance, TrackerReach, stance_at,
};
use calibrig_model::{ActuatorMap, KinematicModel, PoseQuery};

/// A tracker at its place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stand {
    /// Its place.
    pub base_from_tracker: Transform,
    /// Its range and angles.
    pub reach: TrackerReach,
}

/// The robot's surroundings.
#[derive(Debug, Clone, PartialEq)]
pub struct Surroundings {
    /// Its links, for contacts with itself and the floor.
    pub obstacles: Obstacles,
    /// The trackers, one per station in their order; empty if their places are unknown, and then every target is taken as visible.
    pub trackers: Vec<Stand>,
    /// One per target in their order, with its opening.
    pub reflectors: Vec<Reflector>,
    /// What can be between a tracker and a target; `None` if lines of sight are taken as free.
    pub hides: Option<Obstacles>,
    /// Clearance of poses from links and floor, m: the real robot is not the nominal one.
    pub clearance: f64,
    /// Margin to the angles that a tracker or a reflector allows, rad.
    pub angle: f64,
}

/// Why a candidate is left out.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum Refused {
    /// A joint beyond its limits, by its name.
    Limits(String),
    /// The linkage does not close, or the robot does not come to rest.
    NoRest,
    /// Two parts of the robot touch.
    Touches(String, String),
    /// A part of the robot is below the floor.
    Floor(String),
    /// Too close to the tracker, or too far.
    Range,
    /// Outside the tracker's angles.
    Angles,
    /// The reflector faces elsewhere.
    Turned,
    /// A link is in between.
    HiddenBy(String),
    /// The floor is in between.
    HiddenByFloor,
}

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Limits(joint) => write!(f, "{joint} is beyond its limits"),
            Self::NoRest => f.write_str("the linkage does not close, or the robot does not come to rest"),
            Self::Touches(one, other) => write!(f, "{one} touches {other}"),
            Self::Floor(part) => write!(f, "{part} is below the floor, or near it"),
            Self::Range => f.write_str("the target is too close to the tracker, or too far from it"),
            Self::Angles => f.write_str("the target is outside the tracker's angles"),
            Self::Turned => f.write_str("the reflector faces away from the tracker"),
            Self::HiddenBy(link) => write!(f, "{link} hides the target"),
            Self::HiddenByFloor => f.write_str("the floor hides the target"),
        }
    }
}

/// A pose that can be measured.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// Joint variables, rad or m.
    pub joints: Vec<f64>,
    /// The first target's place, in the base frame, m.
    pub target: Vector3<f64>,
    /// Station and target of every free line of sight; `None` if not checked, and all are taken as free.
    pub seen: Option<Vec<[usize; 2]>>,
}

impl Candidate {
    /// Whether a station sees a target.
    pub fn is_seen(&self, station: usize, target: usize) -> bool {
        self.seen.as_ref().is_none_or(|seen| seen.contains(&[station, target]))
    }
}

/// What is after the last link.
const TARGET: &str = "the target";

/// The filters of a robot in its surroundings, with counts of refusals.
pub struct Filter<'a> {
    around: &'a Surroundings,
    kinematics: &'a KinematicModel,
    actuators: &'a ActuatorMap,
    predictor: Predictor<'a>,
    planes: Vec<(UnitVector3<f64>, f64)>,
    built: Built,
    /// The links, slightly enlarged.
    larger: Option<Obstacles>,
    /// The trackers' ranges, slightly reduced.
    reaches: Vec<TrackerReach>,
    /// How many were refused, and why.
    pub refused: BTreeMap<Refused, usize>,
}

impl<'a> Filter<'a> {
    /// The filters of a robot. Contacts in nearly all of the `surveyed` poses (joint variables) are due to the robot's description.
    ///
    /// # Errors
    ///
    /// [`PredictionError`] for an invalid robot.
    pub fn new(
        robot: &'a CalibratedRobot,
        around: &'a Surroundings,
        surveyed: &[Vec<f64>],
    ) -> Result<Self, PredictionError> {
        let floor = around.obstacles.floor().map(|(up, height)| (up, height + around.clearance));
        let mut filter = Self {
            around,
            kinematics: &robot.model.kinematics,
            actuators: &robot.model.actuators,
            predictor: Predictor::new(robot)?,
            planes: floor.into_iter().collect(),
            built: Built::default(),
            larger: around.hides.as_ref().map(|hides| hides.grown(around.clearance)),
            reaches: around.trackers.iter().map(|stand| within(&stand.reach, around)).collect(),
            refused: BTreeMap::new(),
        };
        filter.built = filter.room().survey(surveyed);
        Ok(filter)
    }

    fn room(&self) -> Room<'_> {
        Room {
            kinematics: self.kinematics,
            actuators: self.actuators,
            obstacles: &self.around.obstacles,
            target: self.around.reflectors.first().map_or_else(Vector3::zeros, |own| own.in_flange),
            planes: &self.planes,
        }
    }

    /// The candidate at joint variables; `None` if it is refused, which is counted.
    pub fn take(&mut self, joints: Vec<f64>) -> Option<Candidate> {
        let looked = self.reached(&joints).and_then(|target| Ok((target, self.seen(&joints)?)));
        self.counted(looked.map(|(target, seen)| Candidate { joints, target, seen }))
    }

    /// The same for a pose of the working region, which no tracker has to see.
    pub fn works_at(&mut self, joints: Vec<f64>) -> Option<Candidate> {
        let reached = self.reached(&joints);
        self.counted(reached.map(|target| Candidate { joints, target, seen: None }))
    }

    fn counted(&mut self, looked: Result<Candidate, Refused>) -> Option<Candidate> {
        looked.map_err(|why| *self.refused.entry(why).or_default() += 1).ok()
    }

    /// Reasons in words, the most frequent first.
    pub(super) fn refused_words(&self) -> Vec<(String, usize)> {
        let mut words: Vec<(String, usize)> =
            self.refused.iter().map(|(why, count)| (why.to_string(), *count)).collect();
        words.sort_by(|a, b| b.1.cmp(&a.1).then(a.0.cmp(&b.0)));
        words
    }

    /// The target's place, if the robot can be there.
    fn reached(&mut self, joints: &[f64]) -> Result<Vector3<f64>, Refused> {
        const ROUNDING: f64 = 1e-9;
        for (q, link) in joints.iter().zip(&self.kinematics.links) {
            if !(*q >= link.limits[0] - ROUNDING && *q <= link.limits[1] + ROUNDING) {
                return Err(Refused::Limits(link.name.clone()));
            }
        }
        let command = self.actuators.command_from_joints(joints);
        let target = self.predictor.in_base(PoseQuery::at(&command)).map_err(|_| Refused::NoRest)?;
        let names = self.around.obstacles.names();
        let part = |part: usize| names.get(part).map_or_else(|| TARGET.to_owned(), Clone::clone);
        match self.room().contact(joints, &self.built) {
            None => Ok(target),
            Some(Contact::Parts([one, other])) => Err(Refused::Touches(part(one), part(other))),
            Some(Contact::Below([own, _])) => Err(Refused::Floor(part(own))),
        }
    }

    /// Which tracker sees which target, with a margin; if none sees any, the reason.
    fn seen(&self, joints: &[f64]) -> Result<Option<Vec<[usize; 2]>>, Refused> {
        let (mut seen, mut first) = (Vec::new(), None);
        if self.around.trackers.is_empty() {
            return Ok(None);
        }
        let (links, flange) = stance_at(self.kinematics, joints);
        let stance = Stance { links: &links, flange: &flange };
        for (station, (stand, reach)) in self.around.trackers.iter().zip(&self.reaches).enumerate() {
            for (target, reflector) in self.around.reflectors.iter().enumerate() {
                match self.looks(stance, stand, reach, reflector) {
                    Ok(()) => seen.push([station, target]),
                    Err(why) => _ = first.get_or_insert(why),
                }
            }
        }
        if seen.is_empty() { Err(first.map_or(Refused::Range, |why| named(&why))) } else { Ok(Some(seen)) }
    }

    fn looks(
        &self,
        stance: Stance<'_>,
        stand: &Stand,
        reach: &TrackerReach,
        own: &Reflector,
    ) -> Result<(), Hidden> {
        let from = &stand.base_from_tracker;
        let (Some(hides), Some(larger)) = (&self.around.hides, &self.larger) else {
            let target = stance.flange.rotation * own.in_flange + stance.flange.translation.vector;
            return reach.point_at(from, &target).map(|_| ());
        };
        let strict = Reflector { acceptance: (own.acceptance - self.around.angle).max(0.0), ..*own };
        // An enlarged shape that contains the target hides nothing: both are checked.
        hides.look(from, reach, stance, &strict)?;
        larger.look(from, reach, stance, &strict).map(|_| ())
    }
}

/// The tracker's range, minus the difference of a real robot from the nominal one.
fn within(reach: &TrackerReach, around: &Surroundings) -> TrackerReach {
    let less = |[low, high]: [f64; 2], by: f64| {
        if high - low > 2.0 * by { [low + by, high - by] } else { [low, high] }
    };
    let turn = std::f64::consts::TAU - 1e-9;
    let all_round = reach.azimuth[1] - reach.azimuth[0] >= turn;
    TrackerReach {
        range: less(reach.range, around.clearance),
        elevation: less(reach.elevation, around.angle),
        azimuth: if all_round { reach.azimuth } else { less(reach.azimuth, around.angle) },
    }
}

fn named(why: &Hidden) -> Refused {
    match why {
        Hidden::ByLink { link } => Refused::HiddenBy(link.clone()),
        Hidden::ByFloor { .. } => Refused::HiddenByFloor,
        Hidden::Turned { .. } => Refused::Turned,
        Hidden::Elevation { .. } | Hidden::Azimuth { .. } => Refused::Angles,
        _ => Refused::Range,
    }
}
