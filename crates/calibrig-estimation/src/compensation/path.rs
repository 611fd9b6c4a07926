//! Corrected commands along a path.

use std::ops::ControlFlow;

use thiserror::Error;

use super::point::CompensatedPoint;
use super::speed::{SpeedExcess, exceeded};
use super::{CompensationError, Compensator, Travel};
use crate::inverse::{Goal, GoalError, InverseError, InverseOptions, Unreachable};
use calibrig_model::ModelError;

/// One point of a path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathPoint {
    /// Where the tool should be.
    pub goal: Goal,
    /// Time, s.
    pub time: f64,
}

/// Goals in their order, with their times; no two consecutive ones are at the same place.
#[derive(Debug, Clone, PartialEq)]
pub struct ToolPath {
    points: Vec<PathPoint>,
}

/// Why a path is refused. Points count from zero here and from one in messages.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum PathError {
    /// The path is empty.
    #[error("the path has no points")]
    NoPoints,
    /// A goal is refused.
    #[error("point {} of the path: {source}", point + 1)]
    Goal {
        /// Index of the point.
        point: usize,
        /// Why.
        source: GoalError,
    },
    /// Two consecutive points are at the same place.
    #[error("point {} of the path is at the same place as point {}: leave one of them out", point + 1, point)]
    Duplicate {
        /// Index of the second point.
        point: usize,
    },
    /// A point is of another kind than the first, such as a pose among positions.
    #[error("point {} of the path has {found} constrained coordinates: expected {expected}, as the first point", point + 1)]
    Kind {
        /// Index of the point.
        point: usize,
        /// Number of coordinates of its goal.
        found: usize,
        /// Number of coordinates of the first point's goal.
        expected: usize,
    },
    /// A time is not finite, or not after the one before.
    #[error("point {} of the path is at {time} s: expected a finite time after that of the point before", point + 1)]
    Time {
        /// Index of the point.
        point: usize,
        /// Time of the point, s.
        time: f64,
    },
    /// The speed is not a finite number above zero.
    #[error("the speed of the path is {speed} m/s: expected a finite number above zero")]
    Speed {
        /// Speed as stated, m/s.
        speed: f64,
    },
    /// A speed limit of an actuator is not above zero.
    #[error("the speed limit of actuator {} is {limit}: expected a number above zero, infinite for no limit", actuator + 1)]
    Limit {
        /// Index of the actuator.
        actuator: usize,
        /// Limit as stated, m/s or rad/s.
        limit: f64,
    },
}

/// Points closer than this count as the same, m or rad.
const SAME: f64 = 1e-9;

impl ToolPath {
    /// A path of goals with their times, s.
    ///
    /// # Errors
    ///
    /// [`PathError`].
    pub fn timed(points: Vec<PathPoint>) -> Result<Self, PathError> {
        let Some(first) = points.first() else { return Err(PathError::NoPoints) };
        let expected = first.goal.rows();
        for (point, PathPoint { goal, time }) in points.iter().enumerate() {
            goal.check().map_err(|source| PathError::Goal { point, source })?;
            let found = goal.rows();
            if found != expected {
                return Err(PathError::Kind { point, found, expected });
            }
            if point > 0 && goal.is_at(&points[point - 1].goal, SAME) {
                return Err(PathError::Duplicate { point });
            }
            if !time.is_finite() || (point > 0 && *time <= points[point - 1].time) {
                return Err(PathError::Time { point, time: *time });
            }
        }
        Ok(Self { points })
    }

    /// A path of goals that the tool's point passes at constant speed, m/s, from time zero on.
    ///
    /// # Errors
    ///
    /// [`PathError`]; goals that only rotate the tool take no time at constant speed and are refused as duplicates.
    pub fn at_speed(goals: &[Goal], speed: f64) -> Result<Self, PathError> {
        if !(speed > 0.0 && speed.is_finite()) {
            return Err(PathError::Speed { speed });
        }
        let mut points: Vec<PathPoint> = Vec::with_capacity(goals.len());
        let mut time = 0.0;
        for (point, goal) in goals.iter().enumerate() {
            goal.check().map_err(|source| PathError::Goal { point, source })?;
            if let Some(last) = points.last() {
                let way = (goal.position() - last.goal.position()).norm();
                if way <= SAME {
                    return Err(PathError::Duplicate { point });
                }
                time += way / speed;
            }
            points.push(PathPoint { goal: *goal, time });
        }
        Self::timed(points)
    }

    /// The points of the path.
    pub fn points(&self) -> &[PathPoint] {
        &self.points
    }

    /// Length of the path of the tool's point, m.
    pub fn length(&self) -> f64 {
        let way = |pair: &[PathPoint]| (pair[1].goal.position() - pair[0].goal.position()).norm();
        self.points.windows(2).map(way).sum()
    }
}

/// Options for following a path.
#[derive(Debug, Clone, PartialEq)]
pub struct PathOptions {
    /// Criterion, circumstances and tolerance. The robot comes from the reference command: the first point is sought from there. Motion counts
    /// from the point before. The time of the circumstances is that of the path's time zero.
    pub inverse: InverseOptions,
    /// Speed limit of every actuator, m/s or rad/s, infinite for one without a limit; empty if no limits are known.
    pub speed_limits: Vec<f64>,
    /// The farthest that a joint may move from one point to the next, m or rad: keeps the nominal robot on its branch where the criterion would
    /// make it jump.
    pub longest_step: f64,
}

impl Default for PathOptions {
    fn default() -> Self {
        Self { inverse: InverseOptions::default(), speed_limits: Vec::new(), longest_step: 0.1 }
    }
}

/// Result at a point.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum PointStatus {
    /// Reached from the point before.
    Met(Box<CompensatedPoint>),
    /// Reached, but only with a joint moving farther than the longest step: on another branch, or because the points are too far apart.
    Jumped(Box<CompensatedPoint>),
    /// Not reached.
    Unreachable(Box<Unreachable>),
    /// The identified robot cannot be predicted there, with the reason, such as that it has no stable equilibrium.
    Failed(String),
}

/// One point of a followed path.
#[derive(Debug, Clone, PartialEq)]
pub struct PathReport {
    /// The point as it was given.
    pub asked: PathPoint,
    /// Result at the point.
    pub status: PointStatus,
    /// Whether an actuator comes from another side with the corrected commands than the correction assumes.
    pub wavers: bool,
}

impl PathReport {
    /// The corrected command, if there is one.
    pub fn point(&self) -> Option<&CompensatedPoint> {
        match &self.status {
            PointStatus::Met(point) | PointStatus::Jumped(point) => Some(point),
            PointStatus::Unreachable(_) | PointStatus::Failed(_) => None,
        }
    }
}

/// A followed path. Points that could not be followed are marked; the others are complete.
#[derive(Debug, Clone, PartialEq)]
pub struct CompensatedPath {
    /// Results at the points, in their order.
    pub points: Vec<PathReport>,
    /// Steps between met points that exceed an actuator's speed limit.
    pub exceeded: Vec<SpeedExcess>,
}

impl CompensatedPath {
    /// Whether every point was reached from the one before, and no actuator is too slow.
    pub fn is_whole(&self) -> bool {
        let met = |report: &PathReport| matches!(report.status, PointStatus::Met(_));
        self.points.iter().all(met) && self.exceeded.is_empty()
    }
}

/// The result for a goal, or the nearest one that was found.
type OrNearest<T> = Result<T, Box<Unreachable>>;

impl Compensator<'_> {
    /// Computes corrected commands along a path: each point from the one before, so that joints do not jump between branches, and corrected for the
    /// side from which every actuator comes.
    ///
    /// # Errors
    ///
    /// [`CompensationError`], for invalid input. Points that cannot be met, and steps that are too fast, are part of the result.
    pub fn path(
        &mut self,
        path: &ToolPath,
        options: &PathOptions,
    ) -> Result<CompensatedPath, CompensationError> {
        self.path_told(path, options, &mut |_| ControlFlow::Continue(()))
    }

    /// Like [`path`](Self::path), with a callback for the number of points done; if it returns a break, the points done so far are the result.
    ///
    /// # Errors
    ///
    /// As [`path`](Self::path).
    pub fn path_told(
        &mut self,
        path: &ToolPath,
        options: &PathOptions,
        tell: &mut dyn FnMut(usize) -> ControlFlow<()>,
    ) -> Result<CompensatedPath, CompensationError> {
        let kinematics = self.inverse.space().kinematics.clone();
        check_limits(&options.speed_limits, kinematics.joint_count())?;
        let start = options.inverse.circumstances.clone();
        let mut asked = options.inverse.clone();
        let (mut nominal_before, mut travel) = (None::<Vec<f64>>, Travel::default());
        let mut followed =
            CompensatedPath { points: Vec::with_capacity(path.points.len()), exceeded: Vec::new() };
        for (index, point) in path.points.iter().enumerate() {
            if tell(index).is_break() {
                break;
            }
            asked.circumstances.time = start.time + point.time;
            let seconds = index.checked_sub(1).map(|before| point.time - path.points[before].time);
            let before = nominal_before.take();
            let unreachable =
                |told| PathReport { asked: *point, status: PointStatus::Unreachable(told), wavers: false };
            let found = self.next_nominal(before.as_deref(), &point.goal, seconds, &asked, options)?;
            let (nominal, jumped) = match found {
                Ok(found) => found,
                Err(told) => {
                    followed.points.push(unreachable(told));
                    travel.interrupt();
                    continue;
                }
            };
            let command_before = travel.command().map(<[f64]>::to_vec);
            match self.next(&mut travel, &point.goal, &nominal, &asked) {
                Ok((point, wavers)) => {
                    if let (Some(before), Some(seconds)) = (&command_before, seconds) {
                        let steps = [before.as_slice(), &point.command];
                        let limits = &options.speed_limits;
                        followed.exceeded.extend(exceeded(&kinematics, limits, index, steps, seconds));
                    }
                    nominal_before = Some(nominal);
                    let point = Box::new(point);
                    let status = if jumped { PointStatus::Jumped(point) } else { PointStatus::Met(point) };
                    followed.points.push(PathReport { asked: path.points[index], status, wavers });
                }
                Err(
                    CompensationError::OutOfCorrection(told)
                    | CompensationError::Inverse(InverseError::Unreachable(told)),
                ) => {
                    followed.points.push(unreachable(told));
                    travel.interrupt();
                }
                Err(
                    failed @ (CompensationError::Prediction(_)
                    | CompensationError::Inverse(InverseError::Prediction(_))),
                ) => {
                    let status = PointStatus::Failed(failed.to_string());
                    followed.points.push(PathReport { asked: path.points[index], status, wavers: false });
                    travel.interrupt();
                }
                Err(other) => return Err(other),
            }
        }
        Ok(followed)
    }

    /// The nominal command for the next point, and whether it is a jump.
    fn next_nominal(
        &mut self,
        before: Option<&[f64]>,
        goal: &Goal,
        seconds: Option<f64>,
        asked: &InverseOptions,
        options: &PathOptions,
    ) -> Result<OrNearest<(Vec<f64>, bool)>, CompensationError> {
        let mut from = asked.clone();
        if let (Some(nominal), Some(seconds)) = (before, seconds) {
            let space = self.inverse.space();
            let last = space.of_command(nominal).map_err(InverseError::of_model)?;
            let way = |unknown: usize| {
                let limit = options.speed_limits.get(space.free[unknown]).copied().unwrap_or(f64::INFINITY);
                options.longest_step.min(space.way_of_actuator(unknown, limit * seconds))
            };
            let longest: Vec<f64> = (0..space.len()).map(way).collect();
            let wide = vec![options.longest_step; space.len()];
            for longest in [longest, wide] {
                if let Some(y) = self.inverse.follow(goal, &last, &longest, &last, asked)? {
                    return Ok(Ok((self.inverse.space().command(&y), false)));
                }
            }
            from.reference = Some(nominal.to_vec());
        }
        match self.inverse.solve_nominal(goal, &from) {
            Ok(found) => Ok(Ok((found.command, before.is_some()))),
            Err(InverseError::Unreachable(told)) => Ok(Err(told)),
            Err(other) => Err(other.into()),
        }
    }
}

fn check_limits(limits: &[f64], expected: usize) -> Result<(), CompensationError> {
    let found = limits.len();
    if found != 0 && found != expected {
        let error = ModelError::Length { field: "speed limits", found, expected };
        return Err(InverseError::of_model(error).into());
    }
    match limits.iter().enumerate().find(|(_, limit)| !(**limit > 0.0)) {
        Some((actuator, limit)) => Err(PathError::Limit { actuator, limit: *limit }.into()),
        None => Ok(()),
    }
}
