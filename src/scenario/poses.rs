//! `[poses]`: how many are measured and where they are drawn, or those of a measurement file.

use serde::Deserialize;

use super::file::{joint_index, refuse_twice};
use calibrig_files::{
    ColumnMap, InputError, Robot, Source, Spanned, commanded_joints, parse_column_map, parse_commands,
    with_followers,
};
use calibrig_model::measurement::SetKind;
use calibrig_model::{CalibrationModel, JointKind};
use calibrig_plant::experiment::WorkingRegion;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PosesFile {
    identification: Option<Spanned<u32>>,
    verification: Option<Spanned<u32>>,
    identification_from: Option<Spanned<String>>,
    verification_from: Option<Spanned<String>>,
    region: Option<Spanned<Vec<Spanned<RegionFile>>>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RegionFile {
    joint: Spanned<String>,
    centre_mm: Option<Spanned<f64>>,
    half_width_mm: Option<Spanned<f64>>,
    centre_rad: Option<Spanned<f64>>,
    half_width_rad: Option<Spanned<f64>>,
}

/// The poses of a session.
pub(super) struct Poses {
    pub region: WorkingRegion,
    /// Of the identification set, then of the verification set.
    pub counts: [u32; 2],
    /// Joint variables of sets whose poses are not drawn.
    pub listed: [Option<Vec<Vec<f64>>>; 2],
    /// The files that they are from, by role.
    pub sources: Vec<(String, Source)>,
}

/// Gives the text of a file by its role and the key that names it.
pub(super) type Named<'a> = &'a dyn Fn(&str, &Spanned<String>) -> Result<Source, InputError>;

pub(super) fn poses(
    source: &Source,
    table: &Spanned<PosesFile>,
    robot: &Robot,
    named: Named<'_>,
) -> Result<Poses, InputError> {
    let file = table.get_ref();
    let mut sources = Vec::new();
    let mut set = |kind: SetKind, count: Option<&Spanned<u32>>, from: Option<&Spanned<String>>, least| {
        let key = format!("poses.{}", kind.key());
        match (count, from) {
            (Some(count), None) => Ok((pose_count(source, &key, count, least)?, None)),
            (None, Some(from)) => {
                let role = format!("{}_poses", kind.key());
                let text = named(&role, from)?;
                let listed = listed(source, from, &text, robot)?;
                sources.push((role, text));
                Ok((u32::try_from(listed.len()).unwrap_or(u32::MAX), Some(listed)))
            }
            (Some(count), Some(_)) => Err(source.error(
                count.span(),
                format!("{key} and {key}_from are both given"),
                Some("expected only one of them: a number of poses to draw, or a file that lists them".to_owned()),
            )),
            (None, None) => Err(source.error(
                table.span(),
                format!("{key} is missing"),
                Some(format!("expected a number of poses to draw, or {key}_from with a measurement file whose poses are used")),
            )),
        }
    };
    let identification = file.identification_from.as_ref();
    let (first, fitted) = set(SetKind::Identification, file.identification.as_ref(), identification, 1)?;
    let verification = file.verification_from.as_ref();
    let (second, held_out) = set(SetKind::Verification, file.verification.as_ref(), verification, 0)?;
    let region = match &file.region {
        Some(entries) => region(source, entries, &robot.model)?,
        // Nothing is drawn: the listed poses define the region.
        None if (fitted.is_some() || first == 0) && (held_out.is_some() || second == 0) => {
            around(fitted.iter().chain(&held_out).flatten(), robot.model.kinematics.joint_count())
        }
        None => {
            let help = "expected [[poses.region]] for every joint: poses are drawn in it";
            return Err(source.error(table.span(), "poses.region is missing", Some(help.to_owned())));
        }
    };
    Ok(Poses { region, counts: [first, second], listed: [fitted, held_out], sources })
}

/// The smallest box that holds `poses`.
fn around<'a>(poses: impl Iterator<Item = &'a Vec<f64>>, joints: usize) -> WorkingRegion {
    let mut sides = vec![[f64::INFINITY, f64::NEG_INFINITY]; joints];
    for pose in poses {
        for (side, joint) in sides.iter_mut().zip(pose) {
            *side = [side[0].min(*joint), side[1].max(*joint)];
        }
    }
    WorkingRegion {
        centre: sides.iter().map(|[low, high]| 0.5 * (low + high)).collect(),
        half_width: sides.iter().map(|[low, high]| 0.5 * (high - low)).collect(),
    }
}

/// The joint variables of the poses of a measurement file, which is read as by `identify`, or of a plan: measured values are ignored.
fn listed(
    source: &Source,
    key: &Spanned<String>,
    text: &Source,
    robot: &Robot,
) -> Result<Vec<Vec<f64>>, InputError> {
    let model = &robot.model;
    let stated = robot.sources.iter().find(|(role, _)| role == "columns");
    let map = stated.map(|(_, source)| parse_column_map(source)).transpose()?;
    let kinds = commanded_joints(model);
    let map = map.map_or_else(ColumnMap::default, ColumnMap::or_own);
    let mut poses: Vec<Vec<f64>> = Vec::new();
    let mut last = None;
    for (pose, commands) in parse_commands(text, &map, &kinds)? {
        // Several readings of a pose are one visit of it.
        if last.replace(pose) == Some(pose) {
            continue;
        }
        let command = with_followers(model, &commands);
        let mut joints = vec![0.0; command.len()];
        model.actuators.joints_from_command(&command, &mut joints);
        let beyond = joints.iter().zip(&model.kinematics.links).find(|(q, link)| {
            let slack = 1e-9;
            !(link.limits[0] - slack..=link.limits[1] + slack).contains(*q)
        });
        if let Some((q, link)) = beyond {
            let (value, unit, scale) = match link.kind {
                JointKind::Prismatic => (1e3 * q, "mm", 1e3),
                JointKind::Revolute => (q.to_degrees(), "deg", 1_f64.to_degrees()),
            };
            let message =
                format!("pose {pose} of {} has joint \"{}\" at {value:.3} {unit}", text.name, link.name);
            let [low, high] = link.limits.map(|limit| scale * limit);
            let help = format!(
                "expected poses within the limits of the robot's file, {low:.3} to {high:.3} {unit}: check the unit of the \
                 joints in its column map"
            );
            return Err(source.error(key.span(), message, Some(help)));
        }
        poses.push(joints);
    }
    if poses.is_empty() {
        let message = format!("{} holds no poses", text.name);
        let help = "expected a measurement file of this robot with one row per pose";
        return Err(source.error(key.span(), message, Some(help.to_owned())));
    }
    if poses.len() > MOST_POSES as usize {
        let message = format!("{} holds {} poses", text.name, poses.len());
        return Err(source.error(key.span(), message, Some(format!("expected at most {MOST_POSES}"))));
    }
    Ok(poses)
}

/// Most poses per set: at 10 s a pose, eleven days of measuring.
const MOST_POSES: u32 = 100_000;

fn pose_count(source: &Source, key: &str, count: &Spanned<u32>, least: u32) -> Result<u32, InputError> {
    let number = *count.get_ref();
    if (least..=MOST_POSES).contains(&number) {
        return Ok(number);
    }
    let help = Some(format!("expected {least} to {MOST_POSES} poses"));
    Err(source.error(count.span(), format!("{key} is {number}"), help))
}

/// The box of joint variables; a joint that follows others has no entry and no width of its own.
fn region(
    source: &Source,
    entries: &Spanned<Vec<Spanned<RegionFile>>>,
    robot: &CalibrationModel,
) -> Result<WorkingRegion, InputError> {
    let model = &robot.kinematics;
    let mut seen = vec![false; model.joint_count()];
    let mut region = WorkingRegion { centre: vec![0.0; seen.len()], half_width: vec![0.0; seen.len()] };
    for entry in entries.get_ref() {
        let file = entry.get_ref();
        let index = joint_index(source, &file.joint, model)?;
        refuse_twice(source, &mut seen, index, &file.joint)?;
        let link = &model.links[index];
        if !robot.actuators.is_commanded(index) {
            let message = format!("joint \"{}\" follows another joint and has no command", link.name);
            let help = "expected no [[poses.region]] for it".to_owned();
            return Err(source.error(file.joint.span(), message, Some(help)));
        }
        let (unit, scale, own, foreign) = match link.kind {
            JointKind::Prismatic => {
                ("mm", 1e-3, (&file.centre_mm, &file.half_width_mm), (&file.centre_rad, &file.half_width_rad))
            }
            JointKind::Revolute => {
                ("rad", 1.0, (&file.centre_rad, &file.half_width_rad), (&file.centre_mm, &file.half_width_mm))
            }
        };
        let (Some(centre), Some(half_width), None, None) = (own.0, own.1, foreign.0, foreign.1) else {
            return Err(source.error(
                entry.span(),
                format!(
                    "joint \"{}\" needs centre_{unit} and half_width_{unit}, and no other unit",
                    link.name
                ),
                Some(
                    format!("the unit is part of the key; a {:?} joint is given in {unit}", link.kind)
                        .to_lowercase(),
                ),
            ));
        };
        let (low, high) = {
            let centre = scale * source.finite(&format!("centre_{unit}"), centre)?;
            let half = scale * source.not_negative(&format!("half_width_{unit}"), half_width)?;
            region.centre[index] = centre;
            region.half_width[index] = half;
            (centre - half, centre + half)
        };
        if low < link.limits[0] || high > link.limits[1] {
            return Err(source.error(
                entry.span(),
                format!(
                    "centre_{unit} and half_width_{unit} let joint \"{}\" move from {:.4} to {:.4} {unit}",
                    link.name,
                    low / scale,
                    high / scale
                ),
                Some(format!(
                    "expected a region within its limits, {:.4} to {:.4} {unit}",
                    link.limits[0] / scale,
                    link.limits[1] / scale
                )),
            ));
        }
    }
    let missing = |index: &usize| !seen[*index] && robot.actuators.is_commanded(*index);
    if let Some(index) = (0..seen.len()).find(missing) {
        return Err(source.error(
            entries.span(),
            format!("[[poses.region]] for joint \"{}\" is missing", model.links[index].name),
            Some("expected one entry per commanded joint".to_owned()),
        ));
    }
    robot.actuators.follow(&mut region.centre);
    Ok(region)
}
