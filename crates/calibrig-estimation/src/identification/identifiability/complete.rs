//! A complete set of independent parameters for any chain, by rank.

use nalgebra::{DMatrix, Rotation3, Vector3};

use super::rank::{RANK_TOLERANCE, analyse_columns, select_in_rounds, select_independent};
use super::{DependentGroup, IdentifiabilityReport, Spectrum, neighbour_axis_rules};
use crate::identification::options::Freedom;
use crate::kinematics::{stack, stack_poses, stacked_jacobian};
use calibrig_model::{
    CalibrationModel, CraigLink, JointKind, KinematicModel, LinkTerm, ModelError, ParameterId,
};

/// Parameters whose independent part is smaller than this are considered only after all others: axes that are parallel to within
/// some 10 mrad should be described by Hayati's beta, not by a pair of d that nearly replace each other.
const CLEARLY_INDEPENDENT: f64 = 1e-2;

/// Selects a complete independent set by the structure of the nominal chain: at [`structural_poses`], with a target in general
/// position.
///
/// Order of preference: the frame and the target where they are free; those of a, alpha, d and theta that [`neighbour_axis_rules`]
/// keeps, link by link, then the others; beta last, with those of parallel axes first. So beta is chosen only where the others are not enough.
///
/// # Errors
///
/// [`ModelError`], where the chain is not valid.
pub fn complete_set(
    model: &KinematicModel,
    frame_free: bool,
    target_free: bool,
) -> Result<IdentifiabilityReport, ModelError> {
    model.check()?;
    let free = Freedom::of_points(frame_free, target_free);
    let candidates = candidates(model, free);
    let poses = structural_poses(model, candidates.len());
    Ok(selected(model, candidates, &poses, free))
}

/// [`complete_set`] of a robot in which some joints follow others: these are considered only where they can go.
///
/// # Errors
///
/// [`ModelError`], where the robot is not valid.
pub fn complete_set_of(
    robot: &CalibrationModel,
    frame_free: bool,
    target_free: bool,
) -> Result<IdentifiabilityReport, ModelError> {
    complete_set_by_name(robot, Freedom::of_points(frame_free, target_free), &[], &[])
}

/// Like [`complete_set_of`], without the parameters to `fix`, and with the link parameters to `free` first. Target number 0 stands for all targets.
pub(in crate::identification) fn complete_set_by_name(
    robot: &CalibrationModel,
    freedom: Freedom,
    fix: &[ParameterId],
    free: &[ParameterId],
) -> Result<IdentifiabilityReport, ModelError> {
    robot.check()?;
    let mut candidates = candidates(&robot.kinematics, freedom);
    candidates.retain(|id| !fix.contains(id));
    let is_end = |id: &ParameterId| !matches!(id, ParameterId::Link { .. });
    // The sort is stable: among equals the order of preference is kept.
    candidates.sort_by_key(|id| (!is_end(id), !free.contains(id)));
    let poses = reachable_poses(robot, candidates.len());
    Ok(selected(&robot.kinematics, candidates, &poses, freedom))
}

fn selected(
    model: &KinematicModel,
    candidates: Vec<ParameterId>,
    poses: &[Vec<f64>],
    free: Freedom,
) -> IdentifiabilityReport {
    let jacobian = structural(model, poses, free, &candidates);
    let (kept, dependent) = select_in_rounds(&jacobian, &[CLEARLY_INDEPENDENT, RANK_TOLERANCE], &candidates);
    let kept: Vec<_> = kept.into_iter().map(|column| candidates[column]).collect();
    let selected = in_table_order(model, &kept);
    let spectrum = analyse_columns(&structural(model, poses, free, &selected), &selected);
    IdentifiabilityReport { candidates, selected, spectrum, dependent }
}

/// The parts of a free frame and an unknown target that cannot be determined beside each other, whichever link parameters are fitted: those
/// that [`complete_set`] leaves out.
pub(in crate::identification) fn dependent_ends(
    robot: &CalibrationModel,
    free: Freedom,
    fix: &[ParameterId],
) -> Result<Vec<DependentGroup>, ModelError> {
    robot.check()?;
    let model = &robot.kinematics;
    let mut ends = candidates(model, free);
    ends.retain(|id| !matches!(id, ParameterId::Link { .. }) && !fix.contains(id));
    if ends.is_empty() {
        return Ok(Vec::new());
    }
    let poses = reachable_poses(robot, ends.len());
    Ok(select_independent(&structural(model, &poses, free, &ends), &ends).1)
}

/// [`complete_set`] with its spectrum at `poses` (joint variables, one vector per pose) for a target at `target` (flange frame, m). The
/// `spectrum` contains what the structure allows but these measurements would miss.
pub fn identifiability(
    model: &KinematicModel,
    poses: &[Vec<f64>],
    target: &Vector3<f64>,
    frame_free: bool,
    target_free: bool,
) -> Result<IdentifiabilityReport, ModelError> {
    let mut report = complete_set(model, frame_free, target_free)?;
    report.spectrum = spectrum(model, poses, target, &report.selected)?;
    Ok(report)
}

/// [`identifiability`] of a robot in which some joints follow others.
///
/// # Errors
///
/// [`ModelError`], where the robot is not valid, or a pose does not have one finite number per joint.
pub fn identifiability_of(
    robot: &CalibrationModel,
    poses: &[Vec<f64>],
    target: &Vector3<f64>,
    frame_free: bool,
    target_free: bool,
) -> Result<IdentifiabilityReport, ModelError> {
    let mut report = complete_set_of(robot, frame_free, target_free)?;
    report.spectrum = spectrum(&robot.kinematics, poses, target, &report.selected)?;
    Ok(report)
}

/// Spectrum of `parameters` at `poses` (joint variables, one vector per pose), for a target at `target` (flange frame, m).
///
/// # Errors
///
/// [`ModelError`], where a pose does not have one finite number per joint, or a parameter does not belong to the chain.
pub fn spectrum(
    model: &KinematicModel,
    poses: &[Vec<f64>],
    target: &Vector3<f64>,
    parameters: &[ParameterId],
) -> Result<Spectrum, ModelError> {
    Ok(analyse_columns(&stacked_jacobian(model, poses, target, parameters)?, parameters))
}

/// Poses that fill the joint limits evenly: the same for every call, and without special configurations.
///
/// Uses the additive recurrence of M. Roberts, "The unreasonable effectiveness of quasirandom sequences" (2018), with the generalised golden
/// ratio for as many dimensions as joints. A joint without finite limits gets a full turn or two metres about zero.
pub fn structural_poses(model: &KinematicModel, count: usize) -> Vec<Vec<f64>> {
    let ratio = generalised_golden_ratio(model.joint_count());
    (1..=count)
        .map(|pose| {
            let mut step = 1.0;
            let joint = |link: &CraigLink| {
                step /= ratio;
                let [lowest, highest] = finite_limits(link);
                lowest + (0.5 + pose as f64 * step).fract() * (highest - lowest)
            };
            model.links.iter().map(joint).collect()
        })
        .collect()
}

/// [`structural_poses`] of a robot; joints that follow others are where these take them.
pub fn reachable_poses(robot: &CalibrationModel, count: usize) -> Vec<Vec<f64>> {
    let mut poses = structural_poses(&robot.kinematics, count);
    for joints in &mut poses {
        robot.actuators.follow(joints);
    }
    poses
}

/// A target off every axis, at a distance at which rotations about the axes show well.
pub(super) fn generic_target(model: &KinematicModel) -> Vector3<f64> {
    0.2 * model.characteristic_length() * Vector3::new(0.53, -0.37, 0.61)
}

fn finite_limits(link: &CraigLink) -> [f64; 2] {
    let half = match link.kind {
        JointKind::Revolute => std::f64::consts::PI,
        JointKind::Prismatic => 1.0,
    };
    if link.limits.iter().all(|l| l.is_finite()) { link.limits } else { [-half, half] }
}

/// The root above one of `x^(d+1) = x + 1`, by fixed-point iteration.
fn generalised_golden_ratio(dimensions: usize) -> f64 {
    let exponent = 1.0 / (dimensions as f64 + 1.0);
    (0..64).fold(2.0, |x: f64, _| (1.0 + x).powf(exponent))
}

impl Freedom {
    /// The case in which only points are measured.
    fn of_points(frame: bool, target: bool) -> Self {
        Self { frame, target, orientation: None }
    }
}

/// System of `poses` for a target with a general offset, and with a general orientation where orientations are measured.
fn structural(
    model: &KinematicModel,
    poses: &[Vec<f64>],
    free: Freedom,
    parameters: &[ParameterId],
) -> DMatrix<f64> {
    let target = generic_target(model);
    if free.orientation.is_some() {
        let turned = Rotation3::new(Vector3::new(0.4, -0.7, 0.9));
        stack_poses(model, poses, &target, &turned, target.norm(), parameters)
    } else {
        stack(model, poses, &target, parameters)
    }
}

fn candidates(model: &KinematicModel, free: Freedom) -> Vec<ParameterId> {
    let mut order = Vec::new();
    if free.frame {
        order.extend(ParameterId::all_of_frame(0));
    }
    if free.target {
        order.extend(ParameterId::all_of_target(0));
    }
    if free.orientation == Some(true) {
        order.extend(ParameterId::all_of_orientation(0));
    }
    let (by_rules, _) = neighbour_axis_rules(model);
    let is_beta = |id: &ParameterId| matches!(id, ParameterId::Link { term: LinkTerm::Beta, .. });
    let (betas, others): (Vec<_>, Vec<_>) =
        ParameterId::all_of_links(model.joint_count()).into_iter().partition(is_beta);
    for group in [others, betas] {
        let (first, then): (Vec<_>, Vec<_>) = group.into_iter().partition(|id| by_rules.contains(id));
        order.extend(first);
        order.extend(then);
    }
    order
}

fn in_table_order(model: &KinematicModel, chosen: &[ParameterId]) -> Vec<ParameterId> {
    let mut all = ParameterId::all_of_links(model.joint_count());
    all.extend(ParameterId::all_of_frame(0));
    all.extend(ParameterId::all_of_target(0));
    all.extend(ParameterId::all_of_orientation(0));
    all.retain(|id| chosen.contains(id));
    all
}
