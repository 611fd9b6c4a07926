//! Sources of candidates, and the robot's working region.

use super::{Candidate, Cell, Filter, MOST_LOOKED, PosePlanError, Request, SURVEYED};
use calibrig_estimation::identification::{CalibratedRobot, reachable_poses};
use calibrig_estimation::planning::{PlanError, candidate_commands};
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::{CalibrationModel, JointKind};
use calibrig_plant::experiment::WorkingRegion;
use rand::RngExt;

/// Source of candidates.
#[derive(Debug, Clone, PartialEq)]
pub enum CandidateSource {
    /// Between the limits of all joints.
    WholeSpace,
    /// The robot's working region.
    Region,
    /// These joint variables.
    Listed(Vec<Vec<f64>>),
}

impl CandidateSource {
    /// In words.
    pub fn words(&self) -> &'static str {
        match self {
            Self::WholeSpace => "the whole joint space",
            Self::Region => "the working region",
            Self::Listed(_) => "the listed candidates",
        }
    }

    /// Whether there could be more of them.
    pub fn is_drawn(&self) -> bool {
        !matches!(self, Self::Listed(_))
    }
}

/// A working region: a box of joint variables.
#[derive(Debug, Clone, PartialEq)]
pub struct Region {
    /// Lowest and highest of every joint, rad or m; `None` for all that the robot can reach.
    sides: Option<Vec<[f64; 2]>>,
    name: String,
}

impl Region {
    /// All that the robot can reach.
    pub fn whole() -> Self {
        Self { sides: None, name: "the whole joint space".to_owned() }
    }

    /// Whether it is only a part of what the robot can reach.
    pub fn is_part(&self) -> bool {
        self.sides.is_some()
    }

    /// Between these sides (rad or m, one per joint), with this name.
    pub fn between(sides: Vec<[f64; 2]>, name: &str) -> Self {
        Self { sides: Some(sides), name: name.to_owned() }
    }

    /// A box.
    pub fn of_box(region: &WorkingRegion, name: &str) -> Self {
        let sides = region.centre.iter().zip(&region.half_width);
        Self::between(sides.map(|(centre, half)| [centre - half, centre + half]).collect(), name)
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Lowest and highest of every joint, rad or m.
    pub fn ranges(&self, model: &CalibrationModel) -> Vec<[f64; 2]> {
        self.sides.clone().unwrap_or_else(|| whole_space(model))
    }
}

/// The limits of every joint; a turn or a metre either way without limits.
pub fn whole_space(model: &CalibrationModel) -> Vec<[f64; 2]> {
    let of = |link: &calibrig_model::CraigLink| {
        let half = if link.kind == JointKind::Revolute { std::f64::consts::PI } else { 1.0 };
        if link.limits.iter().all(|limit| limit.is_finite()) { link.limits } else { [-half, half] }
    };
    model.kinematics.links.iter().map(of).collect()
}

/// Candidates that can be measured.
pub(super) struct Found {
    pub kept: Vec<Candidate>,
    pub looked: usize,
    refused: Vec<(String, usize)>,
}

impl Found {
    pub fn refused_words(&self) -> Vec<(String, usize)> {
        self.refused.clone()
    }
}

pub(super) fn find(
    cell: &Cell<'_>,
    robot: &CalibratedRobot,
    request: &Request,
) -> Result<Found, PosePlanError> {
    let sides = match &request.source {
        CandidateSource::Region => cell.region.ranges(cell.model),
        _ => whole_space(cell.model),
    };
    let surveyed = spread_in(cell.model, &sides, SURVEYED);
    let mut filter = Filter::new(robot, &cell.around, &surveyed)?;
    let (mut kept, mut looked) = (Vec::new(), 0);
    if let CandidateSource::Listed(listed) = &request.source {
        looked = listed.len();
        kept.extend(listed.iter().filter_map(|joints| filter.take(joints.clone())));
    } else if request.candidates == 0 {
        return Err(PlanError::NoCandidates.into());
    } else {
        let most = request.candidates.saturating_mul(MOST_LOOKED);
        let mut wanted = request.candidates;
        while kept.len() < request.candidates && looked < most {
            // The sequence continues: poses that were tried stay where they are.
            let commands = candidate_commands(cell.model, &sides, wanted)?;
            for command in &commands[looked..] {
                let mut joints = vec![0.0; command.len()];
                cell.model.actuators.joints_from_command(command, &mut joints);
                looked += 1;
                kept.extend(filter.take(joints));
                if kept.len() == request.candidates {
                    break;
                }
            }
            wanted = wanted.saturating_mul(2).min(most);
        }
    }
    Ok(Found { kept, looked, refused: filter.refused_words() })
}

/// Poses that fill the region evenly, where the robot can be.
pub(super) fn region(
    cell: &Cell<'_>,
    robot: &CalibratedRobot,
    count: usize,
) -> Result<Vec<Candidate>, PosePlanError> {
    let sides = cell.region.ranges(cell.model);
    let surveyed = spread_in(cell.model, &sides, SURVEYED);
    let mut filter = Filter::new(robot, &cell.around, &surveyed)?;
    // In a stated region, only poses that the robot cannot reach are left out.
    let poses = spread_in(cell.model, &sides, 20 * count);
    let looked = poses.len();
    let kept: Vec<Candidate> =
        poses.into_iter().filter_map(|joints| filter.works_at(joints)).take(count).collect();
    if kept.is_empty() {
        return Err(PosePlanError::NoRegion { looked, refused: filter.refused_words() });
    }
    Ok(kept)
}

/// Joint variables that fill a box evenly.
pub(super) fn spread_in(model: &CalibrationModel, sides: &[[f64; 2]], count: usize) -> Vec<Vec<f64>> {
    let mut boxed = model.clone();
    for (link, own) in boxed.kinematics.links.iter_mut().zip(sides) {
        link.limits = *own;
    }
    reachable_poses(&boxed, count)
}

/// Random measurable poses in the region; `None` if there are hardly any.
pub(super) fn drawn_in(
    cell: &Cell<'_>,
    robot: &CalibratedRobot,
    count: usize,
    seed: u64,
    trial: u32,
) -> Result<Option<Vec<Candidate>>, PosePlanError> {
    let sides = cell.region.ranges(cell.model);
    let mut filter = Filter::new(robot, &cell.around, &spread_in(cell.model, &sides, SURVEYED))?;
    let mut rng = stream(seed, trial, StreamSource::IdentificationPoses);
    let mut poses = Vec::new();
    for _ in 0..count.saturating_mul(MOST_LOOKED) {
        let mut joints: Vec<f64> =
            sides.iter().map(|[low, high]| low + (high - low) * rng.random::<f64>()).collect();
        cell.model.actuators.follow(&mut joints);
        poses.extend(filter.take(joints));
        if poses.len() == count {
            return Ok(Some(poses));
        }
    }
    Ok(None)
}
