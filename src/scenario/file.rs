//! `scenarios/*.toml`: units in the keys, unknown keys refused, every error with its place.

use std::collections::BTreeSet;
use std::ops::Range;
use std::path::Path;

use nalgebra::{Matrix3, Rotation3, Vector3};
use serde::Deserialize;

use super::Scenario;
use super::as_built::{AsBuiltFile, as_built};
use super::campaign::{CampaignFile, campaign};
use super::compensation::{CompensationFile, compensation};
use super::effects::{EffectsFile, check_air, check_loads, effects};
use super::identification::{IdentificationFile, ModeFile};
use super::instrument::{DriftFile, EnvironmentFile, SmrFile, conditions, instrument};
use super::payloads::{CarriedFile, payloads};
use super::poses::{Named, Poses, PosesFile, poses};
use super::session::{Around, SessionFile, session};
use calibrig_estimation::identification::{FrameChoice, IdentificationOptions};
use calibrig_files::{InputError, PayloadTable, Source, Spanned};
use calibrig_files::{Robot, StatedTarget, load_robot};
use calibrig_model::measurement::SetKind;
use calibrig_model::{KinematicModel, STANDARD_GRAVITY};
use calibrig_plant::AsBuilt;
use calibrig_plant::session::SessionPlan;
use calibrig_plant::tracker::{Conditions, LaserTracker, Outliers, Probe, TrackerError};

const SCHEMA: &str = "calibrig.scenario/1";

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ScenarioFile {
    schema: Spanned<String>,
    name: Spanned<String>,
    seed: u64,
    robot: Spanned<String>,
    gravity: Option<Spanned<GravityFile>>,
    target: Option<TargetFile>,
    #[serde(default)]
    as_built: AsBuiltFile,
    #[serde(default)]
    effects: EffectsFile,
    poses: Spanned<PosesFile>,
    tracker: Spanned<TrackerFile>,
    session: Option<Spanned<SessionFile>>,
    #[serde(default)]
    payload: Vec<Spanned<PayloadTable>>,
    carried: Option<Spanned<CarriedFile>>,
    #[serde(default)]
    identification: IdentificationFile,
    compensation: Option<Spanned<CompensationFile>>,
    campaign: Option<Spanned<CampaignFile>>,
    #[serde(default)]
    published: Vec<PublishedFile>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct GravityFile {
    x_m_per_s2: Spanned<f64>,
    y_m_per_s2: Spanned<f64>,
    z_m_per_s2: Spanned<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TargetFile {
    x_mm: Spanned<f64>,
    y_mm: Spanned<f64>,
    z_mm: Spanned<f64>,
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
    pub(super) real_random_factor: Option<Spanned<f64>>,
    pub(super) real_systematic_factor: Option<Spanned<f64>>,
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
    nest: Option<Spanned<Vec<Spanned<NestFile>>>>,
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
    let folder = path.parent().unwrap_or(Path::new(""));
    let robot_path = folder.join(file.robot.get_ref());
    let robot = load_robot(&robot_path).map_err(|error| match error {
        // The reader will correct the file that names it.
        InputError::Unreadable { reason, .. } => source.error(
            file.robot.span(),
            format!("robot: cannot read {}: {reason}", robot_path.display()),
            Some("expected the path of a robot file, relative to this file".to_owned()),
        ),
        other => other,
    })?;
    let in_file = source.clone();
    let named = |_: &str, name: &Spanned<String>| {
        let read = Source::read_foreign(&folder.join(name.get_ref()));
        read.map(|(text, _)| text).map_err(|error| {
            let help = "expected the path of a measurement file, relative to this file".to_owned();
            in_file.error(name.span(), format!("poses: {error}"), Some(help))
        })
    };
    whole(source, file, robot, &named)
}

/// The same from texts in memory.
pub fn parse_scenario(source: Source, robot: Robot) -> Result<Scenario, InputError> {
    parse_scenario_with(source, robot, &[])
}

/// The same if it names measurement files whose poses are used: `files` by role, such as a recording's attachments.
pub fn parse_scenario_with(
    source: Source,
    robot: Robot,
    files: &[(String, Source)],
) -> Result<Scenario, InputError> {
    let file: ScenarioFile = source.toml()?;
    check_schema(&source, &file)?;
    let in_file = source.clone();
    let named = |role: &str, name: &Spanned<String>| given(&in_file, files, role, name);
    whole(source, file, robot, &named)
}

/// A file that a scenario in memory names.
fn given(
    scenario: &Source,
    files: &[(String, Source)],
    role: &str,
    name: &Spanned<String>,
) -> Result<Source, InputError> {
    let found = files.iter().find(|(known, _)| known == role).map(|(_, text)| text.clone());
    found.ok_or_else(|| {
        let message = format!("the file {:?} was not given", name.get_ref());
        let help = "expected the text of the file that it names".to_owned();
        scenario.error(name.span(), message, Some(help))
    })
}

/// The scenario with other values in its text; its campaign is the one that they come from.
pub(super) fn parse_varied(
    source: Source,
    robot: Robot,
    files: &[(String, Source)],
) -> Result<Scenario, InputError> {
    let file: ScenarioFile = source.toml()?;
    let in_file = source.clone();
    let named = |role: &str, name: &Spanned<String>| given(&in_file, files, role, name);
    validate(source, file, robot, &named)
}

fn whole(
    source: Source,
    mut file: ScenarioFile,
    robot: Robot,
    named: Named<'_>,
) -> Result<Scenario, InputError> {
    let section = file.campaign.take();
    let plan = section.map(|section| campaign(&source, &section)).transpose()?;
    Ok(Scenario { campaign: plan, ..validate(source, file, robot, named)? })
}

/// Default if neither the robot's file nor the scenario states gravity, m/s².
const USUAL_GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -STANDARD_GRAVITY);

fn gravity(source: &Source, table: &Spanned<GravityFile>) -> Result<Vector3<f64>, InputError> {
    let file = table.get_ref();
    let gravity = Vector3::new(
        source.finite("gravity.x_m_per_s2", &file.x_m_per_s2)?,
        source.finite("gravity.y_m_per_s2", &file.y_m_per_s2)?,
        source.finite("gravity.z_m_per_s2", &file.z_m_per_s2)?,
    );
    if (0.1..=100.0).contains(&gravity.norm()) {
        return Ok(gravity);
    }
    let help = "expected 0.1 to 100 m/s² in all, such as 0, 0 and -9.80665 for a base that stands upright";
    Err(source.error(table.span(), format!("gravity is {} m/s²", gravity.norm()), Some(help.to_owned())))
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

fn validate(
    source: Source,
    file: ScenarioFile,
    mut robot: Robot,
    named: Named<'_>,
) -> Result<Scenario, InputError> {
    if file.name.get_ref().trim().is_empty() {
        let help = Some("expected a name that is not empty".to_owned());
        return Err(source.error(file.name.span(), "name is empty", help));
    }
    let gravity = file.gravity.as_ref().map(|table| gravity(&source, table)).transpose()?;
    if let (Some(statics), Some(gravity)) = (&mut robot.model.statics, gravity) {
        statics.gravity = gravity;
    }
    if let Some(target) = &file.target {
        let in_flange = point(&source, "target.", [&target.x_mm, &target.y_mm, &target.z_mm])?;
        robot.targets =
            vec![StatedTarget { name: None, in_flange, sigma: None, orientation: None, place: 0..0 }];
    }
    let effects = effects(&source, &file.effects, &robot)?;
    let (as_built, drawn) =
        as_built(&source, &file.as_built, &file.robot, &robot, (effects, gravity.unwrap_or(USUAL_GRAVITY)))?;
    check_loads(&source, &file.effects, &as_built)?;
    let Poses { region, listed, sources: pose_files, counts: [identification_poses, verification_poses] } =
        poses(&source, &file.poses, &robot, named)?;
    let tracker = tracker(&source, &file.tracker, &as_built, file.seed)?;
    let section = file.tracker.get_ref();
    let outliers = section.outliers.as_ref().map(|file| outliers(&source, file)).transpose()?;
    let noise = tracker.instrument.noise;
    let probe = section.pose.as_ref().map(|pose| probe(&source, pose, noise)).transpose()?;
    let nest_sigma = 1e-6 * source.positive("tracker.nest_sigma_um", &section.nest_sigma_um)?;
    let options = file.identification.options(&source, &robot)?;
    let nests = nests(&source, (section, &file.tracker), &tracker, nest_sigma, options.frame)?;
    let target_sigma = 1e-6 * source.positive("tracker.target_sigma_um", &section.target_sigma_um)?;
    let around = Around {
        robot: &robot,
        as_built: &as_built,
        region: &region,
        tracker: (&tracker, file.tracker.span()),
        nests: &nests,
        most_poses: identification_poses.max(verification_poses),
    };
    let sizes = [identification_poses, verification_poses];
    let plan = SessionPlan {
        payloads: payloads(&source, &file.payload, file.carried.as_ref(), sizes)?,
        ..session(&source, file.session.as_ref(), &around)?
    };
    swept(&source, &options, &plan)?;
    let modes = file.identification.modes(&source, robot.model.statics.is_some())?;
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
    let compensation = file
        .compensation
        .as_ref()
        .map(|section| compensation(&source, section, &robot, (verification_poses, &modes)))
        .transpose()?;
    let in_file = source.clone();
    let mut sources = vec![("scenario".to_owned(), source)];
    sources.extend(robot.sources.iter().cloned());
    sources.extend(pose_files);
    let scenario = Scenario {
        name: file.name.into_inner(),
        seed: file.seed,
        robot,
        as_built,
        drawn,
        region,
        identification_poses,
        verification_poses,
        listed,
        tracker,
        outliers,
        probe,
        nests,
        nest_sigma,
        target_covariance: Matrix3::identity() * target_sigma * target_sigma,
        plan,
        options,
        modes,
        compensation,
        campaign: None,
        published,
        sources,
    };
    check_air(&in_file, &file.effects, &scenario)?;
    Ok(scenario)
}

/// Stations that sweeps are to place need sweeps of two axes.
fn swept(source: &Source, options: &IdentificationOptions, plan: &SessionPlan) -> Result<(), InputError> {
    let joints: BTreeSet<usize> = plan.sweeps.iter().map(|sweep| sweep.joint).collect();
    if options.frame != FrameChoice::Sweeps || joints.len() >= 2 {
        return Ok(());
    }
    let message = format!("frame is \"sweeps\", but {} joints are swept", joints.len());
    let help = "expected a [[session.sweep]] for each of two joints whose axes are not parallel, such as rail and waist";
    Err(source.error(source.place_of("identification.frame"), message, Some(help.to_owned())))
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
            Some("expected one entry per joint".to_owned()),
        ));
    }
    Ok(())
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
    // Exact readings and nests have neither air nor reflector errors.
    let conditions = if instrument.noise { stated } else { Conditions::default() };
    let position = point(source, "tracker.", [&file.x_mm, &file.y_mm, &file.z_mm])?;
    let yaw = source.finite("tracker.yaw_deg", &file.yaw_deg)?.to_radians();
    let up = -as_built.statics.gravity;
    let tracker = LaserTracker { conditions, ..LaserTracker::levelled(instrument, position, yaw, &up) };
    // One is drawn to check that there is one.
    if let Err(error) = tracker.drawn(seed, 0, 0, 0.0) {
        let key = file.systematic_fraction.as_ref().or(file.random_fraction.as_ref());
        let place = key.map_or(section.span(), Spanned::span);
        let help = "expected figures of an instrument within its permissible errors: random_fraction 0.125 and \
                    systematic_fraction 0.2 are usual";
        return Err(source.error(place, format!("tracker: {error}"), Some(help.to_owned())));
    }
    Ok(tracker)
}

/// The target as a probe whose orientation is also measured.
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

/// Refuses a nest that a station cannot see, because of its range or its angles.
pub(super) fn sees(
    source: &Source,
    span: Range<usize>,
    tracker: &LaserTracker,
    (station, nest, place): (&str, &str, Vector3<f64>),
) -> Result<(), InputError> {
    let seen = (tracker.tracker_from_base * nalgebra::Point3::from(place)).coords;
    let refused = |message: String, help: String| Err(source.error(span.clone(), message, Some(help)));
    match tracker.instrument.limits.reaches(&seen) {
        Ok(()) => Ok(()),
        Err(TrackerError::Range { range, least, most }) => refused(
            format!("nest \"{nest}\" is {range:.3} m from {station} (x_mm, y_mm, z_mm of both)"),
            format!("expected {least} to {most} m, the tracker's range"),
        ),
        Err(error) => refused(
            format!("{station} cannot see nest \"{nest}\": {error}"),
            "expected a nest within the angles of the instrument (azimuth_limits_deg, elevation_limits_deg or its preset): move one of the two, or \
             turn the tracker (yaw_deg)"
                .to_owned(),
        ),
    }
}

fn nests(
    source: &Source,
    (file, whole): (&TrackerFile, &Spanned<TrackerFile>),
    tracker: &LaserTracker,
    sigma: f64,
    frame: FrameChoice,
) -> Result<Vec<(String, Vector3<f64>)>, InputError> {
    let mut nests: Vec<(String, Vector3<f64>)> = Vec::new();
    let entries = file.nest.as_ref();
    if entries.is_none() && matches!(frame, FrameChoice::Free | FrameChoice::Sweeps) {
        return Ok(nests);
    }
    let span = entries.map_or_else(|| whole.span(), Spanned::span);
    for entry in entries.iter().flat_map(|entries| entries.get_ref()) {
        let nest = entry.get_ref();
        let name = nest.name.get_ref();
        let place = point(source, "tracker.nest.", [&nest.x_mm, &nest.y_mm, &nest.z_mm])?;
        if nests.iter().any(|(other, _)| other == name) {
            let help = Some("expected a different name for each nest".to_owned());
            return Err(source.error(nest.name.span(), format!("a second nest \"{name}\""), help));
        }
        sees(source, entry.span(), tracker, ("the tracker", name, place))?;
        nests.push((name.clone(), place));
    }
    if nests.len() < 3 {
        return Err(source.error(
            span,
            format!("{} base nests", nests.len()),
            Some(
                "expected at least three [[tracker.nest]], not on one line; or none, and frame = \"sweeps\" or \"free\" in [identification]"
                    .to_owned(),
            ),
        ));
    }
    let off_line = distance_off_line(&nests);
    // Closer than this, the turn about the line is uncertain by 0.1 rad and more.
    if off_line < 10.0 * sigma {
        return Err(source.error(
            span,
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
