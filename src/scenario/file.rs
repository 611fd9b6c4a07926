//! `scenarios/*.toml`: units in the keys, unknown keys refused, every refusal with its place.

use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use serde::Deserialize;

use super::Scenario;
use crate::experiment::WorkingRegion;
use crate::identification::{
    FrameChoice, IdentificationOptions, Mode, ParameterChoice, SolverOptions, TargetChoice,
};
use crate::input::{InputError, Source, Spanned};
use crate::model::{JointKind, KinematicModel, ParameterId, Robot, load_robot};
use crate::pipeline::SetKind;
use crate::plant::AsBuilt;
use crate::tracker::{ErrorLine, Instrument, LaserTracker};

const SCHEMA: &str = "calibrig.scenario/1";

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ScenarioFile {
    schema: Spanned<String>,
    name: String,
    seed: u64,
    robot: Spanned<String>,
    #[serde(default)]
    as_built: AsBuiltFile,
    poses: PosesFile,
    tracker: TrackerFile,
    #[serde(default)]
    identification: IdentificationFile,
    #[serde(default)]
    published: Vec<PublishedFile>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
struct AsBuiltFile {
    #[serde(default)]
    drives: Drives,
    #[serde(default)]
    joint: Vec<JointErrorsFile>,
}

#[derive(Deserialize, Default, Clone, Copy, PartialEq)]
#[serde(rename_all = "snake_case")]
enum Drives {
    #[default]
    Elastic,
    Rigid,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct JointErrorsFile {
    joint: Spanned<String>,
    delta_a_mm: Option<Spanned<f64>>,
    delta_alpha_rad: Option<Spanned<f64>>,
    delta_beta_rad: Option<Spanned<f64>>,
    delta_d_mm: Option<Spanned<f64>>,
    delta_theta_rad: Option<Spanned<f64>>,
    stiffness_factor: Option<Spanned<f64>>,
    mass_factor: Option<Spanned<f64>>,
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
struct TrackerFile {
    transverse_um: Spanned<f64>,
    transverse_um_per_m: Spanned<f64>,
    range_um: Spanned<f64>,
    range_um_per_m: Spanned<f64>,
    random_fraction: Spanned<f64>,
    #[serde(default = "yes")]
    noise: bool,
    x_mm: Spanned<f64>,
    y_mm: Spanned<f64>,
    z_mm: Spanned<f64>,
    yaw_deg: Spanned<f64>,
    nest_sigma_um: Spanned<f64>,
    target_sigma_um: Spanned<f64>,
    nest: Spanned<Vec<NestFile>>,
}

fn yes() -> bool {
    true
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NestFile {
    name: String,
    x_mm: Spanned<f64>,
    y_mm: Spanned<f64>,
    z_mm: Spanned<f64>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
struct IdentificationFile {
    modes: Option<Vec<ModeFile>>,
    parameters: Option<Spanned<toml::Value>>,
    frame: Option<FrameFile>,
    target: Option<TargetFile>,
    unmodelled_sigma_um: Option<Spanned<f64>>,
    max_iterations: Option<usize>,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "snake_case")]
enum ModeFile {
    WithoutCalibration,
    OnlyCalibration,
    WithGravity,
}

impl From<ModeFile> for Mode {
    fn from(mode: ModeFile) -> Self {
        match mode {
            ModeFile::WithoutCalibration => Self::WithoutCalibration,
            ModeFile::OnlyCalibration => Self::OnlyCalibration,
            ModeFile::WithGravity => Self::WithGravity,
        }
    }
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "snake_case")]
enum FrameFile {
    Nests,
    Free,
    Fixed,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "snake_case")]
enum TargetFile {
    Measured,
    Identified,
    Fixed,
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
    max_mm: [f64; 3],
    mean_mm: [f64; 3],
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
    let as_built = as_built(&source, &file, &robot)?;
    let region = region(&source, &file.poses, &robot.model.kinematics)?;
    if *file.poses.identification.get_ref() == 0 {
        return Err(source.error(
            file.poses.identification.span(),
            "poses.identification is 0",
            Some("expected at least one pose".to_owned()),
        ));
    }
    let tracker = tracker(&source, &file.tracker, &as_built)?;
    let nests = nests(&source, &file.tracker)?;
    let nest_sigma = 1e-6 * source.positive("tracker.nest_sigma_um", &file.tracker.nest_sigma_um)?;
    let target_sigma = 1e-6 * source.positive("tracker.target_sigma_um", &file.tracker.target_sigma_um)?;
    let options = options(&source, &file.identification, &robot)?;
    let modes = match &file.identification.modes {
        Some(modes) => Mode::ALL.into_iter().filter(|m| modes.iter().any(|f| Mode::from(*f) == *m)).collect(),
        None => Mode::ALL.to_vec(),
    };
    let published = file
        .published
        .iter()
        .map(|p| {
            let (max, mean) = (p.max_mm, p.mean_mm);
            let row = [max[0], mean[0], max[1], mean[1], max[2], mean[2]].map(|mm| mm * 1e-3);
            let set = match p.set {
                SetFile::Identification => SetKind::Identification,
                SetFile::Verification => SetKind::Verification,
            };
            (set, p.mode.into(), row)
        })
        .collect();
    let mut sources = vec![("scenario".to_owned(), source)];
    sources.extend(robot.sources.iter().cloned());
    Ok(Scenario {
        name: file.name,
        seed: file.seed,
        robot,
        as_built,
        region,
        identification_poses: *file.poses.identification.get_ref(),
        verification_poses: *file.poses.verification.get_ref(),
        tracker,
        nests,
        nest_sigma,
        target_covariance: Matrix3::identity() * target_sigma * target_sigma,
        options,
        modes,
        published,
        sources,
    })
}

fn joint_index(source: &Source, name: &Spanned<String>, model: &KinematicModel) -> Result<usize, InputError> {
    model.links.iter().position(|l| &l.name == name.get_ref()).ok_or_else(|| {
        let known: Vec<_> = model.links.iter().map(|l| l.name.as_str()).collect();
        source.error(
            name.span(),
            format!("the robot has no joint \"{}\"", name.get_ref()),
            Some(format!("expected one of: {}", known.join(", "))),
        )
    })
}

fn refuse_twice(
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

fn as_built(source: &Source, file: &ScenarioFile, robot: &Robot) -> Result<AsBuilt, InputError> {
    let missing = |what: &str, where_: &str| {
        source.error(
            file.robot.span(),
            format!("the robot's files give no {what}"),
            Some(format!("a simulation needs {where_}")),
        )
    };
    let mut statics = robot.model.statics.clone().ok_or_else(|| {
        missing(
            "masses, drive stiffnesses and gravity",
            "a URDF with inertials, stiffness_* of every joint and [gravity]",
        )
    })?;
    let target = robot.target.ok_or_else(|| missing("target offset", "[target] in the robot's file"))?;
    let mut kinematics = robot.model.kinematics.clone();
    let mut seen = vec![false; kinematics.joint_count()];
    for entry in &file.as_built.joint {
        let index = joint_index(source, &entry.joint, &kinematics)?;
        refuse_twice(source, &mut seen, index, &entry.joint)?;
        let link = &mut kinematics.links[index];
        for (key, delta, unit, value) in [
            ("delta_a_mm", &entry.delta_a_mm, 1e-3, &mut link.a),
            ("delta_alpha_rad", &entry.delta_alpha_rad, 1.0, &mut link.alpha),
            ("delta_beta_rad", &entry.delta_beta_rad, 1.0, &mut link.beta),
            ("delta_d_mm", &entry.delta_d_mm, 1e-3, &mut link.d),
            ("delta_theta_rad", &entry.delta_theta_rad, 1.0, &mut link.theta),
        ] {
            if let Some(delta) = delta {
                *value += unit * source.finite(key, delta)?;
            }
        }
        if let Some(factor) = &entry.stiffness_factor {
            statics.drive_stiffness[index] *= source.positive("stiffness_factor", factor)?;
        }
        if let Some(factor) = &entry.mass_factor {
            let factor = source.positive("mass_factor", factor)?;
            statics.bodies[index].mass *= factor;
            statics.bodies[index].inertia *= factor;
        }
    }
    if file.as_built.drives == Drives::Rigid {
        statics.drive_stiffness.fill(f64::INFINITY);
    }
    Ok(AsBuilt { kinematics, actuators: robot.model.actuators, statics, target })
}

fn region(source: &Source, poses: &PosesFile, model: &KinematicModel) -> Result<WorkingRegion, InputError> {
    let mut seen = vec![false; model.joint_count()];
    let mut region = WorkingRegion { centre: vec![0.0; seen.len()], half_width: vec![0.0; seen.len()] };
    for entry in poses.region.get_ref() {
        let file = entry.get_ref();
        let index = joint_index(source, &file.joint, model)?;
        refuse_twice(source, &mut seen, index, &file.joint)?;
        let link = &model.links[index];
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
                    "joint \"{}\" is asked to move from {} to {} {unit}",
                    link.name,
                    low / scale,
                    high / scale
                ),
                Some(format!(
                    "its limits are {} to {} {unit}",
                    link.limits[0] / scale,
                    link.limits[1] / scale
                )),
            ));
        }
    }
    if let Some(index) = seen.iter().position(|seen| !seen) {
        return Err(source.error(
            poses.region.span(),
            format!("[[poses.region]] for joint \"{}\" is missing", model.links[index].name),
            Some("expected one entry a joint".to_owned()),
        ));
    }
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

fn tracker(source: &Source, file: &TrackerFile, as_built: &AsBuilt) -> Result<LaserTracker, InputError> {
    let instrument = Instrument {
        transverse: ErrorLine {
            offset: 1e-6 * source.positive("tracker.transverse_um", &file.transverse_um)?,
            per_metre: 1e-6
                * source.not_negative("tracker.transverse_um_per_m", &file.transverse_um_per_m)?,
        },
        range: ErrorLine {
            offset: 1e-6 * source.positive("tracker.range_um", &file.range_um)?,
            per_metre: 1e-6 * source.not_negative("tracker.range_um_per_m", &file.range_um_per_m)?,
        },
        random_fraction: source.positive("tracker.random_fraction", &file.random_fraction)?,
        noise: file.noise,
    };
    let position = point(source, "tracker.", [&file.x_mm, &file.y_mm, &file.z_mm])?;
    let yaw = source.finite("tracker.yaw_deg", &file.yaw_deg)?.to_radians();
    let up = -as_built.statics.gravity;
    Ok(LaserTracker::levelled(instrument, position, yaw, &up))
}

fn nests(source: &Source, file: &TrackerFile) -> Result<Vec<(String, Vector3<f64>)>, InputError> {
    let nests = file
        .nest
        .get_ref()
        .iter()
        .map(|nest| {
            Ok((nest.name.clone(), point(source, "tracker.nest.", [&nest.x_mm, &nest.y_mm, &nest.z_mm])?))
        })
        .collect::<Result<Vec<_>, InputError>>()?;
    if nests.len() < 3 {
        return Err(source.error(
            file.nest.span(),
            format!("{} base nests", nests.len()),
            Some("expected at least three [[tracker.nest]], not on one line".to_owned()),
        ));
    }
    Ok(nests)
}

fn options(
    source: &Source,
    file: &IdentificationFile,
    robot: &Robot,
) -> Result<IdentificationOptions, InputError> {
    let mut options = IdentificationOptions::default();
    if let Some(parameters) = &file.parameters {
        options.parameters = parameter_choice(source, parameters, robot.model.kinematics.joint_count())?;
    }
    if let Some(frame) = file.frame {
        options.frame = match frame {
            FrameFile::Nests => FrameChoice::Nests,
            FrameFile::Free => FrameChoice::Free,
            FrameFile::Fixed => FrameChoice::Fixed,
        };
    }
    if let Some(target) = file.target {
        options.target = match target {
            TargetFile::Measured => TargetChoice::Measured,
            TargetFile::Identified => TargetChoice::Identified,
            TargetFile::Fixed => TargetChoice::Fixed,
        };
    }
    if let Some(sigma) = &file.unmodelled_sigma_um {
        options.unmodelled_sigma = 1e-6 * source.not_negative("identification.unmodelled_sigma_um", sigma)?;
    }
    if let Some(max_iterations) = file.max_iterations {
        options.solver = SolverOptions { max_iterations, ..options.solver };
    }
    Ok(options)
}

fn parameter_choice(
    source: &Source,
    value: &Spanned<toml::Value>,
    links: usize,
) -> Result<ParameterChoice, InputError> {
    let refused = |what: String| {
        source.error(
            value.span(),
            format!("identification.parameters: {what}"),
            Some(format!(
                "expected \"neighbour_axis_rules\", \"complete\", or a list of delta_a, delta_alpha, delta_beta, delta_d, \
                 delta_theta with a joint number from 1 to {links}, such as [\"delta_a2\", \"delta_theta4\"]"
            )),
        )
    };
    let listed = |name: &toml::Value| {
        let known = name.as_str().and_then(ParameterId::parse);
        match known {
            Some(id @ ParameterId::Link { link, .. }) if link < links => Ok(id),
            _ => Err(refused(format!("{name} is not a link parameter of this robot"))),
        }
    };
    match value.get_ref() {
        toml::Value::String(name) if name == "neighbour_axis_rules" => Ok(ParameterChoice::NeighbourAxisRules),
        toml::Value::String(name) if name == "complete" => Ok(ParameterChoice::Complete),
        toml::Value::Array(names) => Ok(ParameterChoice::Listed(names.iter().map(listed).collect::<Result<_, _>>()?)),
        other => Err(refused(format!("{other} is no choice"))),
    }
}
