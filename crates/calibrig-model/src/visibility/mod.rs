//! Whether a tracker sees a reflector past the robot's own links: used by the simulated session for the machine as it stands, and by a planner
//! for the nominal robot.
//!
//! Nothing here is fitted or random. The links are the boxes, cylinders and spheres of the robot's URDF, or capsules along its chain.

mod hull;
mod room;
mod shape;
#[cfg(test)]
mod tests;

use nalgebra::{UnitVector3, Vector3};
use thiserror::Error;

use crate::geometry::Transform;
use crate::{KinematicModel, Visual};
pub use hull::Hull;
pub use room::{Built, Contact, Room};
use shape::{Placed, distance_of_segments, distance_to_segment};

/// A reflector on the flange, and the directions from which it returns light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reflector {
    /// Its centre in the flange frame, m.
    pub in_flange: Vector3<f64>,
    /// Direction of its opening, in the flange frame; `None` if it is turned to the tracker by hand or has no opening.
    pub opening: Option<UnitVector3<f64>>,
    /// Largest angle between the opening and the beam, rad.
    pub acceptance: f64,
}

/// What a tracker can point at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackerReach {
    /// m
    pub range: [f64; 2],
    /// Above its x-y plane, rad.
    pub elevation: [f64; 2],
    /// About its z from x, rad.
    pub azimuth: [f64; 2],
}

/// What stands between a tracker and a reflector.
#[derive(Debug, Clone, PartialEq)]
pub struct Obstacles {
    names: Vec<String>,
    /// Of the base, then of every link.
    shapes: Vec<Vec<Placed>>,
    /// Radius of capsules from each link's origin to the next, m, if there are no shapes.
    chain: Option<f64>,
    /// Up, in the base frame, and the floor's height along it, m.
    floor: Option<(UnitVector3<f64>, f64)>,
    standoff: f64,
}

/// A machine at a pose, as obstacles need it.
#[derive(Debug, Clone, Copy)]
pub struct Stance<'a> {
    /// `base_from_link` of every link.
    pub links: &'a [Transform],
    /// `base_from_flange`
    pub flange: &'a Transform,
}

/// A free line of sight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FreeSight {
    /// m
    pub range: f64,
    /// Above the tracker's x-y plane, rad.
    pub elevation: f64,
    /// Between the beam and the reflector's opening, rad; zero without an opening.
    pub incidence: f64,
}

/// Why a tracker does not see a reflector.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum Hidden {
    /// A link is in between.
    #[error("{link} hides the target from the tracker")]
    ByLink {
        /// Name of the link's joint, or `base`.
        link: String,
    },
    /// Tracker or target are below the floor.
    #[error("the floor hides the target from the tracker: it is {:.1} mm below", 1e3 * depth)]
    ByFloor {
        /// m
        depth: f64,
    },
    /// The reflector faces elsewhere.
    #[error(
        "the beam meets the target at {:.1} deg from the axis of its opening, more than the {:.1} deg up to which it is \
         returned",
        incidence.to_degrees(),
        acceptance.to_degrees()
    )]
    Turned {
        /// rad
        incidence: f64,
        /// rad
        acceptance: f64,
    },
    /// Too close or too far.
    #[error("range {range:.3} m is outside the tracker's {} to {} m", reach[0], reach[1])]
    Range {
        /// m
        range: f64,
        /// m
        reach: [f64; 2],
    },
    /// Too high or too low for the tracker's head.
    #[error(
        "elevation {:.1} deg is outside the tracker's {:.1} to {:.1} deg",
        elevation.to_degrees(),
        reach[0].to_degrees(),
        reach[1].to_degrees()
    )]
    Elevation {
        /// rad
        elevation: f64,
        /// rad
        reach: [f64; 2],
    },
    /// Behind the tracker's head.
    #[error(
        "azimuth {:.1} deg is outside the tracker's {:.1} to {:.1} deg",
        azimuth.to_degrees(),
        reach[0].to_degrees(),
        reach[1].to_degrees()
    )]
    Azimuth {
        /// rad
        azimuth: f64,
        /// rad
        reach: [f64; 2],
    },
    /// A place that is not finite, or frames of another robot.
    #[error("the pose has {found} link frames instead of {expected}, or a place that is not a finite number")]
    NoPose {
        /// Frames given.
        found: usize,
        /// Frames of this robot.
        expected: usize,
    },
}

impl Obstacles {
    /// Only the floor, if there is one.
    pub fn none(kinematics: &KinematicModel) -> Self {
        let links = kinematics.links.iter().map(|link| link.name.clone());
        let names: Vec<String> = std::iter::once("base".to_owned()).chain(links).collect();
        Self { shapes: vec![Vec::new(); names.len()], names, chain: None, floor: None, standoff: 0.0 }
    }

    /// The shapes of a robot, those of the base first, as [`Visual`]s. Everything is enlarged by `margin` (m) on every side, for the beam's own
    /// radius and for details that a shape lacks.
    pub fn of_shapes(kinematics: &KinematicModel, visuals: &[Vec<Visual>], margin: f64) -> Self {
        let mut obstacles = Self::none(kinematics);
        for (own, visuals) in obstacles.shapes.iter_mut().zip(visuals) {
            own.extend(visuals.iter().map(|visual| Placed::new(visual, margin)));
        }
        obstacles
    }

    /// Capsules of one radius (m) from the origin of each link to that of the next and to the flange: for a robot without shapes.
    pub fn of_chain(kinematics: &KinematicModel, radius: f64) -> Self {
        Self { chain: Some(radius), ..Self::none(kinematics) }
    }

    /// With a floor whose height (m) is along `up` from the base's origin.
    #[must_use]
    pub fn with_floor(self, up: UnitVector3<f64>, height: f64) -> Self {
        Self { floor: Some((up, height)), ..self }
    }

    /// The same with every part, and the floor, enlarged by `clearance` (m) on every side.
    #[must_use]
    pub fn grown(&self, clearance: f64) -> Self {
        Self {
            names: self.names.clone(),
            shapes: self.shapes.iter().map(|own| own.iter().map(|s| s.grown(clearance)).collect()).collect(),
            chain: self.chain.map(|radius| radius + clearance),
            floor: self.floor.map(|(up, height)| (up, height + clearance)),
            standoff: self.standoff,
        }
    }

    /// Up, in the base frame, and the floor's height along it, m.
    pub fn floor(&self) -> Option<(UnitVector3<f64>, f64)> {
        self.floor
    }

    /// Names of the base and of every link by its joint, as [`Hull::link`] counts them.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Length at the reflector's end of the beam that need not be free, m: where the ball and its seat are.
    #[must_use]
    pub fn with_standoff(self, standoff: f64) -> Self {
        Self { standoff, ..self }
    }

    /// Whether anything of the robot can hide a target.
    pub fn has_links(&self) -> bool {
        self.chain.is_some() || self.shapes.iter().any(|own| !own.is_empty())
    }

    /// Whether the links are capsules along the chain.
    pub fn is_chain(&self) -> bool {
        self.chain.is_some()
    }

    /// Links without any shape, by name: they hide nothing.
    pub fn without_shape(&self) -> impl Iterator<Item = &str> {
        let bare = |(name, own): (_, &Vec<Placed>)| own.is_empty().then_some(name);
        self.names.iter().map(String::as_str).zip(&self.shapes).filter_map(bare)
    }

    /// The link that holds a point of the base frame (m) at a pose.
    pub fn holding(&self, stance: Stance<'_>, point: &Vector3<f64>) -> Option<&str> {
        if self.names.len() != stance.links.len() + 1 {
            return None;
        }
        let identity = Transform::identity();
        let frames = std::iter::once(&identity).chain(stance.links);
        let inside = |(own, frame): (&Vec<Placed>, &Transform)| own.iter().any(|s| s.holds(frame, point));
        let link = self.shapes.iter().zip(frames).position(inside).or_else(|| {
            let radius = self.chain?;
            (0..stance.links.len()).map(|link| (link, capsule(stance, link))).find_map(|(link, ends)| {
                (distance_to_segment(point, &ends[0], &ends[1]) <= radius).then_some(link + 1)
            })
        })?;
        self.names.get(link).map(String::as_str)
    }

    /// How deep a point of the base frame is below the floor, m; `None` above it.
    pub fn below_floor(&self, point: &Vector3<f64>) -> Option<f64> {
        let (up, height) = self.floor.as_ref()?;
        let depth = height - up.dot(point);
        (depth > 0.0).then_some(depth)
    }

    /// Whether a tracker that stands at `base_from_tracker` sees a reflector of a machine at a pose.
    ///
    /// The tracker's angles and range are checked first, then the reflector's opening, then floor and links. A shape that contains the reflector's
    /// centre is its seat and hides nothing.
    ///
    /// # Errors
    ///
    /// [`Hidden`], with what hides it.
    pub fn look(
        &self,
        base_from_tracker: &Transform,
        reach: &TrackerReach,
        stance: Stance<'_>,
        reflector: &Reflector,
    ) -> Result<FreeSight, Hidden> {
        let target = stance.flange.rotation * reflector.in_flange + stance.flange.translation.vector;
        let tracker = base_from_tracker.translation.vector;
        let (found, expected) = (stance.links.len(), self.names.len() - 1);
        if found != expected || !target.iter().chain(tracker.iter()).all(|v| v.is_finite()) {
            return Err(Hidden::NoPose { found, expected });
        }
        let sight = reach.point_at(base_from_tracker, &target)?;
        let mut incidence = 0.0;
        if let Some(opening) = &reflector.opening {
            let to_tracker = (tracker - target) / sight.range;
            let opening = stance.flange.rotation * opening.into_inner();
            // The arc cosine of the product alone loses half of the digits near zero.
            incidence = opening.cross(&to_tracker).norm().atan2(opening.dot(&to_tracker));
            if !(incidence <= reflector.acceptance) {
                return Err(Hidden::Turned { incidence, acceptance: reflector.acceptance });
            }
        }
        self.free(stance, &tracker, &target)?;
        Ok(FreeSight { incidence, ..sight })
    }

    /// Whether the line from a tracker to a target, both of the base frame, m, is free of floor and links.
    ///
    /// # Errors
    ///
    /// [`Hidden::ByFloor`] and [`Hidden::ByLink`].
    pub fn free(
        &self,
        stance: Stance<'_>,
        tracker: &Vector3<f64>,
        target: &Vector3<f64>,
    ) -> Result<(), Hidden> {
        if let Some(depth) = [tracker, target].into_iter().find_map(|point| self.below_floor(point)) {
            return Err(Hidden::ByFloor { depth });
        }
        let range = (target - tracker).norm();
        let end = tracker + (target - tracker) * (1.0 - self.standoff / range).max(0.0);
        let identity = Transform::identity();
        let frames = std::iter::once(&identity).chain(stance.links);
        let hides = |(own, frame): (&Vec<Placed>, &Transform)| {
            own.iter().any(|s| s.meets(frame, tracker, &end) && !s.holds(frame, target))
        };
        let link = self.shapes.iter().zip(frames).position(hides).or_else(|| {
            let radius = self.chain?;
            (0..stance.links.len())
                .find(|&link| {
                    let ends = capsule(stance, link);
                    distance_of_segments([tracker, &end], [&ends[0], &ends[1]]) <= radius
                        && distance_to_segment(target, &ends[0], &ends[1]) > radius
                })
                .map(|link| link + 1)
        });
        match link.and_then(|link| self.names.get(link)) {
            Some(link) => Err(Hidden::ByLink { link: link.clone() }),
            None => Ok(()),
        }
    }

    /// The same for a rigid robot at joint variables (rad or m, one per joint), for planning.
    ///
    /// # Errors
    ///
    /// [`Hidden`], with what hides it.
    pub fn look_at_joints(
        &self,
        base_from_tracker: &Transform,
        reach: &TrackerReach,
        kinematics: &KinematicModel,
        joints: &[f64],
        reflector: &Reflector,
    ) -> Result<FreeSight, Hidden> {
        let expected = self.names.len() - 1;
        if joints.len() != expected {
            return Err(Hidden::NoPose { found: joints.len(), expected });
        }
        let (links, flange) = stance_at(kinematics, joints);
        self.look(base_from_tracker, reach, Stance { links: &links, flange: &flange }, reflector)
    }
}

/// `base_from_link` of every link at joint variables (rad or m), and `base_from_flange`; as many links as both have.
pub fn stance_at(kinematics: &KinematicModel, joints: &[f64]) -> (Vec<Transform>, Transform) {
    let mut at = kinematics.base_from_first;
    let frames: Vec<_> = kinematics
        .links
        .iter()
        .zip(joints)
        .map(|(link, joint)| {
            at *= link.transform(*joint);
            at
        })
        .collect();
    let flange = at * kinematics.last_from_flange;
    (frames, flange)
}

/// From the origin of a link to that of the next, or to the flange.
fn capsule(stance: Stance<'_>, link: usize) -> [Vector3<f64>; 2] {
    let next = stance.links.get(link + 1).unwrap_or(stance.flange);
    [stance.links[link].translation.vector, next.translation.vector]
}

impl TrackerReach {
    /// All round, from -90 to 90 deg, in a range (m).
    pub fn all_round(range: [f64; 2]) -> Self {
        let quarter = std::f64::consts::FRAC_PI_2;
        Self { range, elevation: [-quarter, quarter], azimuth: [-2.0 * quarter, 2.0 * quarter] }
    }

    /// Whether a tracker that stands at `base_from_tracker` can point at a place of the base frame (m).
    ///
    /// # Errors
    ///
    /// [`Hidden::Range`], [`Hidden::Elevation`], [`Hidden::Azimuth`].
    pub fn point_at(
        &self,
        base_from_tracker: &Transform,
        target: &Vector3<f64>,
    ) -> Result<FreeSight, Hidden> {
        let seen = base_from_tracker.inverse_transform_point(&(*target).into()).coords;
        let range = seen.norm();
        if !(self.range[0]..=self.range[1]).contains(&range) {
            return Err(Hidden::Range { range, reach: self.range });
        }
        let elevation = seen.z.atan2(seen.x.hypot(seen.y));
        if !(self.elevation[0]..=self.elevation[1]).contains(&elevation) {
            return Err(Hidden::Elevation { elevation, reach: self.elevation });
        }
        let azimuth = seen.y.atan2(seen.x);
        if !(self.azimuth[0]..=self.azimuth[1]).contains(&azimuth) {
            return Err(Hidden::Azimuth { azimuth, reach: self.azimuth });
        }
        Ok(FreeSight { range, elevation, incidence: 0.0 })
    }
}
