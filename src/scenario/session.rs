//! `[session]`: stations, targets, visits, times, rounds of nests and lines of sight.

use std::f64::consts::PI;

use nalgebra::{UnitVector3, Vector3};
use serde::Deserialize;

use super::file::sees;
use super::sweep::{SweepFile, sweeps};
use calibrig_files::{InputError, Robot, Source, Spanned};
use calibrig_model::geometry::Transform;
use calibrig_model::visibility::{Obstacles, Stance, stance_at};
use calibrig_plant::AsBuilt;
use calibrig_plant::experiment::WorkingRegion;
use calibrig_plant::session::{
    Approach, FurtherStation, FurtherTarget, MOST_ORDERED_POSES, MOST_REPEATS, MOST_SECONDS, NestRounds,
    PoseOrder, SessionPlan, Sight, StationShare, Timing,
};
use calibrig_plant::tracker::LaserTracker;

const MM: f64 = 1e-3;
/// The usual angle up to which a hollow retroreflector returns light.
const ACCEPTANCE: f64 = PI / 6.0;
/// Beam radius, and margin for details that a primitive lacks.
const MARGIN: f64 = 0.01;
/// Radius of a ball of 1.5 inches, and its seat.
const STANDOFF: f64 = 0.025;
/// Default time from one nest to the next: the tracker drives there by itself.
const SECONDS_PER_NEST: f64 = 5.0;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SessionFile {
    order: Option<OrderFile>,
    repeats: Option<Spanned<u32>>,
    approach: Option<ApproachFile>,
    approach_mm: Option<Spanned<f64>>,
    approach_deg: Option<Spanned<f64>>,
    warm_up_s: Option<Spanned<f64>>,
    motion_s: Option<Spanned<f64>>,
    settling_s: Option<Spanned<f64>>,
    averaging_s: Option<Spanned<f64>>,
    poses_shared: Option<ShareFile>,
    opening: Option<Spanned<[f64; 3]>>,
    #[serde(default)]
    nests: NestsFile,
    #[serde(default)]
    station: Vec<Spanned<StationFile>>,
    #[serde(default)]
    target: Vec<Spanned<TargetFile>>,
    #[serde(default)]
    sweep: Vec<Spanned<SweepFile>>,
    line_of_sight: Option<Spanned<SightFile>>,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "snake_case")]
enum OrderFile {
    AsDrawn,
    ShortTravel,
}

#[derive(Deserialize, Clone, Copy, PartialEq)]
#[serde(rename_all = "snake_case")]
enum ApproachFile {
    AsTravelled,
    OneSide,
    BothSides,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "snake_case")]
enum ShareFile {
    Best,
    All,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
struct NestsFile {
    every_poses: Option<Spanned<u32>>,
    #[serde(default)]
    after: bool,
    #[serde(default)]
    two_faces: bool,
    seconds_each_s: Option<Spanned<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct StationFile {
    name: Spanned<String>,
    x_mm: Spanned<f64>,
    y_mm: Spanned<f64>,
    z_mm: Spanned<f64>,
    yaw_deg: Spanned<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TargetFile {
    name: Spanned<String>,
    x_mm: Spanned<f64>,
    y_mm: Spanned<f64>,
    z_mm: Spanned<f64>,
    opening: Option<Spanned<[f64; 3]>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SightFile {
    links: LinksFile,
    capsule_radius_mm: Option<Spanned<f64>>,
    margin_mm: Option<Spanned<f64>>,
    standoff_mm: Option<Spanned<f64>>,
    floor_mm: Option<Spanned<f64>>,
    acceptance_deg: Option<Spanned<f64>>,
}

#[derive(Deserialize, Clone, Copy, PartialEq)]
#[serde(rename_all = "snake_case")]
enum LinksFile {
    Shapes,
    Capsules,
    None,
}

/// The parts of the scenario that the session refers to.
pub(super) struct Around<'a> {
    pub(super) robot: &'a Robot,
    pub(super) as_built: &'a AsBuilt,
    pub(super) region: &'a WorkingRegion,
    /// The first station, and the place of `[tracker]` in the file.
    pub(super) tracker: (&'a LaserTracker, std::ops::Range<usize>),
    pub(super) nests: &'a [(String, Vector3<f64>)],
    pub(super) most_poses: u32,
}

/// Without `[session]` the plan is the simplest.
pub(super) fn session(
    source: &Source,
    file: Option<&Spanned<SessionFile>>,
    around: &Around<'_>,
) -> Result<SessionPlan, InputError> {
    let Some(section) = file else { return Ok(SessionPlan::default()) };
    let file = section.get_ref();
    let plan = SessionPlan {
        stations: stations(source, file, around)?,
        share: match file.poses_shared {
            None | Some(ShareFile::Best) => StationShare::Best,
            Some(ShareFile::All) => StationShare::All,
        },
        opening: opening(source, "session.opening", file.opening.as_ref())?,
        targets: targets(source, file)?,
        repeats: repeats(source, file)?,
        approach: approach(source, section)?,
        order: order(source, section, around)?,
        timing: timing(source, file)?,
        rounds: rounds(source, file)?,
        sweeps: sweeps(source, &file.sweep, around)?,
        sight: file.line_of_sight.as_ref().map(|sight| self::sight(source, sight, around)).transpose()?,
        ..SessionPlan::default()
    };
    stands(source, file, around, &plan)?;
    Ok(plan)
}

fn point(source: &Source, key: &str, [x, y, z]: [&Spanned<f64>; 3]) -> Result<Vector3<f64>, InputError> {
    let [x, y, z] = [("x_mm", x), ("y_mm", y), ("z_mm", z)]
        .map(|(axis, value)| source.finite(&format!("{key}.{axis}"), value));
    Ok(MM * Vector3::new(x?, y?, z?))
}

fn new_name<'a>(
    source: &Source,
    key: &str,
    name: &'a Spanned<String>,
    known: &mut Vec<&'a str>,
) -> Result<(), InputError> {
    let text = name.get_ref().as_str();
    if text.trim().is_empty() || known.contains(&text) {
        let found = if text.trim().is_empty() {
            format!("{key}.name is empty")
        } else {
            format!("{key}.name is \"{text}\", which is used already")
        };
        return Err(source.error(name.span(), found, Some("expected a different name".to_owned())));
    }
    known.push(text);
    Ok(())
}

fn stations(
    source: &Source,
    file: &SessionFile,
    around: &Around<'_>,
) -> Result<Vec<FurtherStation>, InputError> {
    let up = -around.as_built.statics.gravity;
    let mut names = vec!["1"];
    let station = |entry: &'_ Spanned<StationFile>| {
        let file = entry.get_ref();
        let position = point(source, "session.station", [&file.x_mm, &file.y_mm, &file.z_mm])?;
        let yaw = source.finite("session.station.yaw_deg", &file.yaw_deg)?.to_radians();
        let tracker = LaserTracker::levelled(around.tracker.0.instrument, position, yaw, &up);
        let name = file.name.get_ref().clone();
        for (nest, place) in around.nests {
            sees(source, entry.span(), &tracker, (&format!("station \"{name}\""), nest, *place))?;
        }
        Ok(FurtherStation { name, tracker_from_base: tracker.tracker_from_base })
    };
    for entry in &file.station {
        new_name(source, "session.station", &entry.get_ref().name, &mut names)?;
    }
    file.station.iter().map(station).collect()
}

fn targets(source: &Source, file: &SessionFile) -> Result<Vec<FurtherTarget>, InputError> {
    let mut names = vec!["SMR"];
    for entry in &file.target {
        new_name(source, "session.target", &entry.get_ref().name, &mut names)?;
    }
    let target = |entry: &Spanned<TargetFile>| {
        let file = entry.get_ref();
        Ok(FurtherTarget {
            name: file.name.get_ref().clone(),
            in_flange: point(source, "session.target", [&file.x_mm, &file.y_mm, &file.z_mm])?,
            opening: opening(source, "session.target.opening", file.opening.as_ref())?,
        })
    };
    file.target.iter().map(target).collect()
}

fn opening(
    source: &Source,
    key: &str,
    file: Option<&Spanned<[f64; 3]>>,
) -> Result<Option<UnitVector3<f64>>, InputError> {
    let Some(value) = file else { return Ok(None) };
    let direction = Vector3::from(*value.get_ref());
    let sound = direction.iter().all(|v| v.is_finite()).then(|| UnitVector3::try_new(direction, 1e-9));
    sound.flatten().map(Some).ok_or_else(|| {
        let help = "expected three numbers that are not all zero: the direction in which the reflector looks, in the flange frame";
        source.error(value.span(), format!("{key} is {:?}", value.get_ref()), Some(help.to_owned()))
    })
}

fn repeats(source: &Source, file: &SessionFile) -> Result<u32, InputError> {
    let Some(value) = &file.repeats else { return Ok(1) };
    let repeats = *value.get_ref();
    if (1..=MOST_REPEATS).contains(&repeats) {
        return Ok(repeats);
    }
    let help = Some(format!("expected 1 to {MOST_REPEATS} visits of each pose"));
    Err(source.error(value.span(), format!("session.repeats is {repeats}"), help))
}

fn approach(source: &Source, section: &Spanned<SessionFile>) -> Result<Approach, InputError> {
    let file = section.get_ref();
    let kind = file.approach.unwrap_or(ApproachFile::AsTravelled);
    let [along, about] = [("approach_mm", &file.approach_mm), ("approach_deg", &file.approach_deg)];
    if kind == ApproachFile::AsTravelled {
        for (key, value) in [along, about] {
            if let Some(value) = value {
                let help = "expected it only with approach = \"one_side\" or \"both_sides\"".to_owned();
                let message = format!("session.{key} is given, but poses are approached as travelled");
                return Err(source.error(value.span(), message, Some(help)));
            }
        }
        return Ok(Approach::AsTravelled);
    }
    let distance = |(key, value): (&str, &Option<Spanned<f64>>)| {
        match value {
        Some(value) => source.positive(&format!("session.{key}"), value),
        None => Err(source.error(
            section.span(),
            format!("session.{key} is missing"),
            Some("expected approach_mm for sliding and approach_deg for turning joints: the distance from which each pose is \
                  approached".to_owned()),
        )),
    }
    };
    let distances = [MM * distance(along)?, distance(about)?.to_radians()];
    Ok(match kind {
        ApproachFile::BothSides => Approach::BothSides(distances),
        ApproachFile::AsTravelled | ApproachFile::OneSide => Approach::OneSide(distances),
    })
}

fn order(
    source: &Source,
    section: &Spanned<SessionFile>,
    around: &Around<'_>,
) -> Result<PoseOrder, InputError> {
    match section.get_ref().order {
        None | Some(OrderFile::AsDrawn) => Ok(PoseOrder::AsDrawn),
        Some(OrderFile::ShortTravel) if around.most_poses > MOST_ORDERED_POSES => {
            let message = format!(
                "session.order is \"short_travel\" for {} poses of a set, too many to search a short path",
                around.most_poses
            );
            let help = format!("expected up to {MOST_ORDERED_POSES} poses, or order = \"as_drawn\"");
            Err(source.error(section.span(), message, Some(help)))
        }
        Some(OrderFile::ShortTravel) => Ok(PoseOrder::ShortTravel),
    }
}

fn timing(source: &Source, file: &SessionFile) -> Result<Timing, InputError> {
    let usual = Timing::default();
    let time = |key: &str, value: Option<&Spanned<f64>>, usual: f64| match value {
        Some(value) => source.not_negative(&format!("session.{key}"), value),
        None => Ok(usual),
    };
    let given =
        [&file.warm_up_s, &file.motion_s, &file.settling_s, &file.averaging_s, &file.nests.seconds_each_s];
    if let Some(long) = given.into_iter().flatten().find(|value| *value.get_ref() > MOST_SECONDS) {
        let message = format!("a part of the session takes {} s", long.get_ref());
        return Err(source.error(long.span(), message, Some(format!("expected up to {MOST_SECONDS} s"))));
    }
    Ok(Timing {
        warm_up: time("warm_up_s", file.warm_up_s.as_ref(), usual.warm_up)?,
        motion: time("motion_s", file.motion_s.as_ref(), usual.motion)?,
        settling: time("settling_s", file.settling_s.as_ref(), usual.settling)?,
        averaging: match &file.averaging_s {
            Some(value) => source.positive("session.averaging_s", value)?,
            None => usual.averaging,
        },
        nest: time("nests.seconds_each_s", file.nests.seconds_each_s.as_ref(), SECONDS_PER_NEST)?,
    })
}

fn rounds(source: &Source, file: &SessionFile) -> Result<NestRounds, InputError> {
    let every = match &file.nests.every_poses {
        None => 0,
        Some(value) if *value.get_ref() == 0 => {
            let help = "expected a number of poses above zero, or no such key: then nests are not measured in between";
            let message = "session.nests.every_poses is 0";
            return Err(source.error(value.span(), message, Some(help.to_owned())));
        }
        Some(value) => *value.get_ref(),
    };
    Ok(NestRounds { every, after: file.nests.after, two_faces: file.nests.two_faces, timed: true })
}

fn sight(source: &Source, section: &Spanned<SightFile>, around: &Around<'_>) -> Result<Sight, InputError> {
    let file = section.get_ref();
    let key = |name: &str| format!("session.line_of_sight.{name}");
    let length = |name: &str, value: Option<&Spanned<f64>>, usual: f64| match value {
        Some(value) => Ok(MM * source.not_negative(&key(name), value)?),
        None => Ok(usual),
    };
    let margin = length("margin_mm", file.margin_mm.as_ref(), MARGIN)?;
    let kinematics = &around.as_built.kinematics;
    if let (Some(radius), true) = (&file.capsule_radius_mm, file.links != LinksFile::Capsules) {
        let message = format!("{} is given, but links are not capsules", key("capsule_radius_mm"));
        return Err(source.error(
            radius.span(),
            message,
            Some("expected links = \"capsules\" with it".to_owned()),
        ));
    }
    let obstacles = match file.links {
        LinksFile::None => Obstacles::none(kinematics),
        LinksFile::Shapes => {
            let obstacles = Obstacles::of_shapes(kinematics, &around.robot.visuals, margin);
            if !obstacles.has_links() {
                let message = "session.line_of_sight.links is \"shapes\", but the robot's URDF has no box, cylinder or sphere";
                let help = "expected visuals in the URDF that the robot's file names, or links = \"capsules\" with capsule_radius_mm, or links = \"none\"";
                return Err(source.error(section.span(), message, Some(help.to_owned())));
            }
            obstacles
        }
        LinksFile::Capsules => {
            let Some(radius) = &file.capsule_radius_mm else {
                let message = format!("{} is missing", key("capsule_radius_mm"));
                let help = "expected the radius of the capsules that stand for the links, from one joint to the next";
                return Err(source.error(section.span(), message, Some(help.to_owned())));
            };
            Obstacles::of_chain(kinematics, MM * source.positive(&key("capsule_radius_mm"), radius)? + margin)
        }
    };
    let obstacles = obstacles.with_standoff(length("standoff_mm", file.standoff_mm.as_ref(), STANDOFF)?);
    let up = UnitVector3::try_new(-around.as_built.statics.gravity, 1e-9);
    let obstacles = match (&file.floor_mm, up) {
        (None, _) => obstacles,
        (Some(height), Some(up)) => obstacles.with_floor(up, MM * source.finite(&key("floor_mm"), height)?),
        (Some(height), None) => {
            let message =
                format!("{} is given, but the robot has no gravity, so down is unknown", key("floor_mm"));
            return Err(source.error(
                height.span(),
                message,
                Some("expected [gravity], or no floor".to_owned()),
            ));
        }
    };
    let of_smr = around.tracker.0.conditions.smr.map_or(ACCEPTANCE, |smr| smr.acceptance);
    let acceptance = match &file.acceptance_deg {
        None => of_smr,
        Some(value) => {
            let angle = source.positive(&key("acceptance_deg"), value)?;
            if angle > 90.0 {
                let message = format!("{} is {angle}", key("acceptance_deg"));
                let help = "expected at most 90 deg: no reflector returns light from behind";
                return Err(source.error(value.span(), message, Some(help.to_owned())));
            }
            angle.to_radians()
        }
    };
    Ok(Sight { obstacles, acceptance })
}

/// Refuses stations at impossible places: inside the robot at its home pose, or below the floor; and nests that no station can see.
fn stands(
    source: &Source,
    file: &SessionFile,
    around: &Around<'_>,
    plan: &SessionPlan,
) -> Result<(), InputError> {
    let Some(Sight { obstacles, .. }) = &plan.sight else { return Ok(()) };
    let (links, flange) = stance_at(&around.as_built.kinematics, &around.region.centre);
    let stance = Stance { links: &links, flange: &flange };
    let first = (around.tracker.0.tracker_from_base, "1".to_owned(), around.tracker.1.clone());
    let further = plan.stations.iter().zip(&file.station);
    let further = further.map(|(s, entry)| (s.tracker_from_base, s.name.clone(), entry.span()));
    for (tracker_from_base, name, span) in std::iter::once(first).chain(further) {
        let at = Transform::inverse(&tracker_from_base).translation.vector;
        if let Some(link) = obstacles.holding(stance, &at) {
            let message = format!(
                "station \"{name}\" stands inside the robot, in {link}, at the middle of the working region"
            );
            let help = "expected x_mm, y_mm and z_mm of a place outside every link";
            return Err(source.error(span, message, Some(help.to_owned())));
        }
        if let Some(depth) = obstacles.below_floor(&at) {
            let message = format!("station \"{name}\" stands {:.1} mm below the floor", 1e3 * depth);
            let help = "expected a place above session.line_of_sight.floor_mm, which is a height above the base's origin";
            return Err(source.error(span, message, Some(help.to_owned())));
        }
        let seen =
            around.nests.iter().filter(|(_, place)| obstacles.free(stance, &at, place).is_ok()).count();
        if seen < 3 {
            let hidden: Vec<_> = around
                .nests
                .iter()
                .filter_map(|(nest, place)| {
                    Some(format!("{nest}: {}", obstacles.free(stance, &at, place).err()?))
                })
                .collect();
            let message = format!(
                "station \"{name}\" sees {seen} base nests with the robot in the middle of its working region: {}",
                hidden.join("; ").replace("the target", "it")
            );
            let help = "expected three nests or more that it sees: move the station or the nests";
            return Err(source.error(span, message, Some(help.to_owned())));
        }
    }
    Ok(())
}
