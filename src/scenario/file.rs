//! `scenarios/*.toml`: units in the keys, unknown keys refused, every refusal with its place.

use std::path::Path;

use nalgebra::{Matrix3, Rotation3, Vector3};
use serde::Deserialize;

use super::Scenario;
use super::as_built::{AsBuiltFile, as_built};
use super::effects::{EffectsFile, effects};
use super::identification::{IdentificationFile, ModeFile};
use super::instrument::{DriftFile, EnvironmentFile, SmrFile, conditions, instrument};
use super::session::{Around, SessionFile, session};
use calibrig_files::{InputError, Source, Spanned};
use calibrig_files::{Robot, load_robot};
use calibrig_model::measurement::SetKind;
use calibrig_model::{CalibrationModel, JointKind, KinematicModel};
use calibrig_plant::AsBuilt;
use calibrig_plant::experiment::WorkingRegion;
use calibrig_plant::tracker::{Conditions, LaserTracker, Outliers, Probe};

const SCHEMA: &str = "calibrig.scenario/1";

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ScenarioFile {
    schema: Spanned<String>,
    name: Spanned<String>,
    seed: u64,
    robot: Spanned<String>,
    #[serde(default)]
    as_built: AsBuiltFile,
    #[serde(default)]
    effects: EffectsFile,
    poses: PosesFile,
    tracker: Spanned<TrackerFile>,
    session: Option<Spanned<SessionFile>>,
    #[serde(default)]
    identification: IdentificationFile,
    #[serde(default)]
    published: Vec<PublishedFile>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PosesFile {
    identification: Spanned<u32>,
    verification: Spanned<u32>,
    region: Spanned<Vec<Spanned<RegionFile>>>,
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

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TrackerFile {
    pub(super) preset: Option<Spanned<String>>,
    pub(super) transverse_um: Option<Spanned<f64>>,
    pub(super) transverse_um_per_m: Option<Spanned<f64>>,
    pub(super) range_um: Option<Spanned<f64>>,
    pub(super) range_um_per_m: Option<Spanned<f64>>,
    pub(super) range_zero_um: Option<Spanned<f64>>,
    pub(super) random_fraction: Option<Spanned<f64>>,
    pub(super) systematic_fraction: Option<Spanned<f64>>,
    pub(super) air_um_per_m: Option<Spanned<f64>>,
    pub(super) miss_fraction: Option<Spanned<f64>>,
    pub(super) range_limits_m: Option<Spanned<[Spanned<f64>; 2]>>,
    pub(super) azimuth_limits_deg: Option<Spanned<[Spanned<f64>; 2]>>,
    pub(super) elevation_limits_deg: Option<Spanned<[Spanned<f64>; 2]>>,
    pub(super) temperature_limits_c: Option<Spanned<[Spanned<f64>; 2]>>,
    #[serde(default = "yes")]
    pub(super) noise: bool,
    pub(super) environment: Option<Spanned<EnvironmentFile>>,
    pub(super) drift: Option<Spanned<DriftFile>>,
    pub(super) smr: Option<Spanned<SmrFile>>,
    x_mm: Spanned<f64>,
    y_mm: Spanned<f64>,
    z_mm: Spanned<f64>,
    yaw_deg: Spanned<f64>,
    nest_sigma_um: Spanned<f64>,
    target_sigma_um: Spanned<f64>,
    nest: Spanned<Vec<Spanned<NestFile>>>,
    outliers: Option<OutliersFile>,
    pose: Option<PoseFile>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PoseFile {
    rotation_sigma_deg: Spanned<f64>,
    mounted_rx_deg: Option<Spanned<f64>>,
    mounted_ry_deg: Option<Spanned<f64>>,
    mounted_rz_deg: Option<Spanned<f64>>,
    mounting_sigma_deg: Option<Spanned<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct OutliersFile {
    fraction: Spanned<f64>,
    least_mm: Spanned<f64>,
    most_mm: Spanned<f64>,
}

pub(super) fn yes() -> bool {
    true
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NestFile {
    name: Spanned<String>,
    x_mm: Spanned<f64>,
    y_mm: Spanned<f64>,
    z_mm: Spanned<f64>,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "snake_case")]
enum SetFile {
    Identification,
    Verification,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PublishedFile {
    set: SetFile,
    mode: ModeFile,
    max_mm: [Spanned<f64>; 3],
    mean_mm: [Spanned<f64>; 3],
}

/// Reads a scenario and the robot that it names, whose path is relative to the scenario's folder.
pub fn load_scenario(path: &Path) -> Result<Scenario, InputError> {
    let source = Source::read(path)?;
    let file: ScenarioFile = source.toml()?;
    check_schema(&source, &file)?;
    let robot_path = path.parent().unwrap_or(Path::new("")).join(file.robot.get_ref());
    let robot = load_robot(&robot_path).map_err(|error| match error {
        // The file that names it is where the reader will mend it.
        InputError::Unreadable { reason, .. } => source.error(
            file.robot.span(),
            format!("robot: cannot read {}: {reason}", robot_path.display()),
            Some("expected the path of a robot file, relative to this file".to_owned()),
        ),
        other => other,
    })?;
    validate(source, file, robot)
}

/// The same from texts in memory, such as a recording's attachments.
pub fn parse_scenario(source: Source, robot: Robot) -> Result<Scenario, InputError> {
    let file: ScenarioFile = source.toml()?;
    check_schema(&source, &file)?;
    validate(source, file, robot)
}

fn check_schema(source: &Source, file: &ScenarioFile) -> Result<(), InputError> {
    if file.schema.get_ref() == SCHEMA {
        return Ok(());
    }
    Err(source.error(
        file.schema.span(),
        format!("schema is \"{}\"", file.schema.get_ref()),
        Some(format!("expected \"{SCHEMA}\"")),
    ))
}

fn validate(source: Source, file: ScenarioFile, robot: Robot) -> Result<Scenario, InputError> {
    if file.name.get_ref().trim().is_empty() {
        let help = Some("expected a name for people".to_owned());
        return Err(source.error(file.name.span(), "name is empty", help));
    }
    let effects = effects(&source, &file.effects, &robot)?;
    let (as_built, drawn) = as_built(&source, &file.as_built, &file.robot, &robot, effects)?;
    let region = region(&source, &file.poses, &robot.model)?;
    let identification_poses = pose_count(&source, "poses.identification", &file.poses.identification, 1)?;
    let verification_poses = pose_count(&source, "poses.verification", &file.poses.verification, 0)?;
    let tracker = tracker(&source, &file.tracker, &as_built, file.seed)?;
    let section = file.tracker.get_ref();
    let outliers = section.outliers.as_ref().map(|file| outliers(&source, file)).transpose()?;
    let noise = tracker.instrument.noise;
    let probe = section.pose.as_ref().map(|pose| probe(&source, pose, noise)).transpose()?;
    let nest_sigma = 1e-6 * source.positive("tracker.nest_sigma_um", &section.nest_sigma_um)?;
    let nests = nests(&source, section, &tracker, nest_sigma)?;
    let target_sigma = 1e-6 * source.positive("tracker.target_sigma_um", &section.target_sigma_um)?;
    let around = Around {
        robot: &robot,
        as_built: &as_built,
        region: &region,
        tracker: (&tracker, file.tracker.span()),
        nests: &nests,
        most_poses: identification_poses.max(verification_poses),
    };
    let plan = session(&source, file.session.as_ref(), &around)?;
    let options = file.identification.options(&source, &robot)?;
    let modes = file.identification.modes(&source)?;
    let published = file
        .published
        .iter()
        .map(|p| {
            let mut row = [0.0; 6];
            for (axis, (max, mean)) in p.max_mm.iter().zip(&p.mean_mm).enumerate() {
                row[2 * axis] = 1e-3 * source.not_negative("published.max_mm", max)?;
                row[2 * axis + 1] = 1e-3 * source.not_negative("published.mean_mm", mean)?;
            }
            let set = match p.set {
                SetFile::Identification => SetKind::Identification,
                SetFile::Verification => SetKind::Verification,
            };
            Ok((set, p.mode.into(), row))
        })
        .collect::<Result<_, InputError>>()?;
    let mut sources = vec![("scenario".to_owned(), source)];
    sources.extend(robot.sources.iter().cloned());
    Ok(Scenario {
        name: file.name.into_inner(),
        seed: file.seed,
        robot,
        as_built,
        drawn,
        region,
        identification_poses,
        verification_poses,
        tracker,
        outliers,
        probe,
        nests,
        nest_sigma,
        target_covariance: Matrix3::identity() * target_sigma * target_sigma,
        plan,
        options,
        modes,
        published,
        sources,
    })
}

/// Poses a set, at 10 s a pose eleven days of measuring.
const MOST_POSES: u32 = 100_000;

fn pose_count(source: &Source, key: &str, count: &Spanned<u32>, least: u32) -> Result<u32, InputError> {
    let number = *count.get_ref();
    if (least..=MOST_POSES).contains(&number) {
        return Ok(number);
    }
    let help = Some(format!("expected {least} to {MOST_POSES} poses"));
    Err(source.error(count.span(), format!("{key} is {number}"), help))
}

pub(super) fn joint_index(
    source: &Source,
    name: &Spanned<String>,
    model: &KinematicModel,
) -> Result<usize, InputError> {
    model.links.iter().position(|l| &l.name == name.get_ref()).ok_or_else(|| {
        let known: Vec<_> = model.links.iter().map(|l| l.name.as_str()).collect();
        source.error(
            name.span(),
            format!("the robot has no joint \"{}\"", name.get_ref()),
            Some(format!("expected one of: {}", known.join(", "))),
        )
    })
}

pub(super) fn refuse_twice(
    source: &Source,
    seen: &mut [bool],
    index: usize,
    name: &Spanned<String>,
) -> Result<(), InputError> {
    if std::mem::replace(&mut seen[index], true) {
        return Err(source.error(
            name.span(),
            format!("joint \"{}\" is given twice", name.get_ref()),
            Some("expected one entry a joint".to_owned()),
        ));
    }
    Ok(())
}

/// The box of joint variables; a joint that follows others has no entry and no width of its own.
fn region(source: &Source, poses: &PosesFile, robot: &CalibrationModel) -> Result<WorkingRegion, InputError> {
    let model = &robot.kinematics;
    let mut seen = vec![false; model.joint_count()];
    let mut region = WorkingRegion { centre: vec![0.0; seen.len()], half_width: vec![0.0; seen.len()] };
    for entry in poses.region.get_ref() {
        let file = entry.get_ref();
        let index = joint_index(source, &file.joint, model)?;
        refuse_twice(source, &mut seen, index, &file.joint)?;
        let link = &model.links[index];
        if !robot.actuators.is_commanded(index) {
            let message = format!("joint \"{}\" follows another one and takes no command", link.name);
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
            poses.region.span(),
            format!("[[poses.region]] for joint \"{}\" is missing", model.links[index].name),
            Some("expected one entry a joint that is commanded".to_owned()),
        ));
    }
    robot.actuators.follow(&mut region.centre);
    Ok(region)
}

fn point(source: &Source, key: &str, [x, y, z]: [&Spanned<f64>; 3]) -> Result<Vector3<f64>, InputError> {
    Ok(1e-3
        * Vector3::new(
            source.finite(&format!("{key}x_mm"), x)?,
            source.finite(&format!("{key}y_mm"), y)?,
            source.finite(&format!("{key}z_mm"), z)?,
        ))
}

fn tracker(
    source: &Source,
    section: &Spanned<TrackerFile>,
    as_built: &AsBuilt,
    seed: u64,
) -> Result<LaserTracker, InputError> {
    let file = section.get_ref();
    let instrument = instrument(source, file, section.span())?;
    let stated = conditions(source, file, &instrument.limits)?;
    // Exact readings and nests have neither weather nor reflectors of their own.
    let conditions = if instrument.noise { stated } else { Conditions::default() };
    let position = point(source, "tracker.", [&file.x_mm, &file.y_mm, &file.z_mm])?;
    let yaw = source.finite("tracker.yaw_deg", &file.yaw_deg)?.to_radians();
    let up = -as_built.statics.gravity;
    let tracker = LaserTracker { conditions, ..LaserTracker::levelled(instrument, position, yaw, &up) };
    // One is drawn to see that there is one.
    if let Err(error) = tracker.drawn(seed, 0, 0, 0.0) {
        let key = file.systematic_fraction.as_ref().or(file.random_fraction.as_ref());
        let place = key.map_or(section.span(), Spanned::span);
        let help = "expected figures of an instrument that is within what it is permitted: random_fraction 0.125 and systematic_fraction 0.2 are usual";
        return Err(source.error(place, format!("tracker: {error}"), Some(help.to_owned())));
    }
    Ok(tracker)
}

/// The target as a probe whose orientation is measured, too.
fn probe(source: &Source, file: &PoseFile, noise: bool) -> Result<Probe, InputError> {
    let about = |key: &str, value: Option<&Spanned<f64>>| {
        value.map_or(Ok(0.0), |value| Ok(source.finite(&format!("tracker.pose.{key}"), value)?.to_radians()))
    };
    let mounted = Vector3::new(
        about("mounted_rx_deg", file.mounted_rx_deg.as_ref())?,
        about("mounted_ry_deg", file.mounted_ry_deg.as_ref())?,
        about("mounted_rz_deg", file.mounted_rz_deg.as_ref())?,
    );
    let sigma = |key: &str, value: &Spanned<f64>| {
        Ok::<_, InputError>(source.positive(&format!("tracker.pose.{key}"), value)?.to_radians())
    };
    Ok(Probe {
        flange_from_target: Rotation3::new(mounted),
        turn_sigma: sigma("rotation_sigma_deg", &file.rotation_sigma_deg)?,
        mounting_sigma: file
            .mounting_sigma_deg
            .as_ref()
            .map(|value| sigma("mounting_sigma_deg", value))
            .transpose()?,
        noise,
    })
}

/// Half of all readings: with more, no method can tell which half is in error.
const MOST_OUTLIERS: f64 = 0.5;

fn outliers(source: &Source, file: &OutliersFile) -> Result<Outliers, InputError> {
    let fraction = source.not_negative("tracker.outliers.fraction", &file.fraction)?;
    if fraction > MOST_OUTLIERS {
        let help = Some(format!("expected a share of all readings, at most {MOST_OUTLIERS}"));
        return Err(source.error(
            file.fraction.span(),
            format!("tracker.outliers.fraction is {fraction}"),
            help,
        ));
    }
    let least = source.not_negative("tracker.outliers.least_mm", &file.least_mm)?;
    let most = source.not_negative("tracker.outliers.most_mm", &file.most_mm)?;
    if most < least {
        let help = Some(format!("expected least_mm ({least}) or more"));
        return Err(source.error(file.most_mm.span(), format!("tracker.outliers.most_mm is {most}"), help));
    }
    Ok(Outliers { fraction, least: 1e-3 * least, most: 1e-3 * most })
}

fn nests(
    source: &Source,
    file: &TrackerFile,
    tracker: &LaserTracker,
    sigma: f64,
) -> Result<Vec<(String, Vector3<f64>)>, InputError> {
    let mut nests: Vec<(String, Vector3<f64>)> = Vec::new();
    for entry in file.nest.get_ref() {
        let nest = entry.get_ref();
        let name = nest.name.get_ref();
        let place = point(source, "tracker.nest.", [&nest.x_mm, &nest.y_mm, &nest.z_mm])?;
        if nests.iter().any(|(other, _)| other == name) {
            let help = Some("expected a name of its own".to_owned());
            return Err(source.error(nest.name.span(), format!("a second nest \"{name}\""), help));
        }
        let range = (tracker.tracker_from_base * nalgebra::Point3::from(place)).coords.norm();
        let [least, most] = tracker.instrument.limits.range;
        if !(least..=most).contains(&range) {
            return Err(source.error(
                entry.span(),
                format!("nest \"{name}\" is {range:.3} m from the tracker (x_mm, y_mm, z_mm of both)"),
                Some(format!("expected {least} to {most} m, the tracker's range")),
            ));
        }
        nests.push((name.clone(), place));
    }
    if nests.len() < 3 {
        return Err(source.error(
            file.nest.span(),
            format!("{} base nests", nests.len()),
            Some("expected at least three [[tracker.nest]], not on one line".to_owned()),
        ));
    }
    let off_line = distance_off_line(&nests);
    // Nearer, the turn about the line is uncertain by 0.1 rad and more.
    if off_line < 10.0 * sigma {
        return Err(source.error(
            file.nest.span(),
            format!("the base nests lie on one line, within {:.3} mm", 1e3 * off_line),
            Some(format!(
                "expected a [[tracker.nest]] at least {:.3} mm off the line of the others, ten times nest_sigma_um",
                1e4 * sigma
            )),
        ));
    }
    Ok(nests)
}

/// Largest distance of a nest from the line through the two that are farthest apart, m.
fn distance_off_line(nests: &[(String, Vector3<f64>)]) -> f64 {
    let pairs = nests.iter().flat_map(|(_, a)| nests.iter().map(move |(_, b)| (*a, b - a)));
    let Some((start, along)) = pairs.max_by(|(_, a), (_, b)| a.norm().total_cmp(&b.norm())) else {
        return 0.0;
    };
    let Some(direction) = along.try_normalize(0.0) else { return 0.0 };
    nests.iter().map(|(_, place)| (place - start).cross(&direction).norm()).fold(0.0, f64::max)
}
