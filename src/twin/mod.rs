//! The simulated twin of a robot: a scenario made only from its nominal model, with a reason for every number that the model does not state.

mod class;
mod text;

pub use class::SizeClass;

use nalgebra::{Rotation3, UnitVector3, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use thiserror::Error;

use crate::scenario::{Scenario, parse_scenario};
use calibrig_estimation::identification::identifiability_of;
use calibrig_files::{InputError, Robot, Source};
use calibrig_model::random::{self, stream};
use calibrig_model::visibility::{Built, Obstacles, Room, TrackerReach, stance_at};
use calibrig_model::{JointKind, ModelError, STANDARD_GRAVITY, StaticProperties};
use calibrig_plant::experiment::{self, Place, Stand, WorkingRegion, usable_ranges};
pub use calibrig_plant::tracker::Preset;

/// How the base is mounted, if not as the robot's file states.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mounting {
    /// Its z axis upwards.
    Floor,
    /// Its z axis level, its x axis upwards.
    Wall,
    /// Its z axis downwards.
    Ceiling,
}

/// Settings of a twin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TwinOptions {
    /// The size class; if absent, by reach and mass.
    pub class: Option<SizeClass>,
    /// If absent, as the robot's file states.
    pub mounting: Option<Mounting>,
    /// The tracker.
    pub preset: Preset,
    /// Height of the floor above the base's origin, m; if absent, by the robot's own heights.
    pub floor: Option<f64>,
    /// Of the scenario.
    pub seed: u64,
}

impl Default for TwinOptions {
    fn default() -> Self {
        Self { class: None, mounting: None, preset: Preset::At500, floor: None, seed: 1 }
    }
}

/// A scenario, and the choices made for it.
#[derive(Debug, Clone)]
pub struct Twin {
    /// The text of the scenario file.
    pub text: String,
    /// The same as read.
    pub scenario: Scenario,
    /// The size class.
    pub class: SizeClass,
    /// Largest distance of the flange from the first joint in the middle of its travel, m.
    pub reach: f64,
    /// Of all that moves, kg; `None` if the robot's files do not state it.
    pub mass: Option<f64>,
    /// Where poses are drawn.
    pub region: WorkingRegion,
    /// The box of the target's places there: least and largest x, y and z in the base frame, m.
    pub extent: [Vector3<f64>; 2],
    /// The tracker's place, and what it sees.
    pub place: Place,
    /// Identification and verification poses.
    pub poses: [u32; 2],
    /// Link parameters of a complete set, and how many of them these poses determine.
    pub parameters: [usize; 2],
    /// Remarks on the choices.
    pub told: Vec<String>,
}

/// Why no twin can be made.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum TwinError {
    /// The robot's parameters cannot be analysed.
    #[error("the robot's parameters: {0}")]
    Model(#[from] ModelError),
    /// No place within the tracker's range sees any pose.
    #[error("no place between {} and {} m from the robot sees the target at any of {poses} poses", range[0], range[1])]
    NoPlace {
        /// Of the tracker, m.
        range: [f64; 2],
        /// Poses that were tried.
        poses: usize,
    },
    /// Too few places for base nests.
    #[error(
        "{found} places about the base can be seen from the tracker at every pose: a station needs three nests"
    )]
    NoNests {
        /// Places.
        found: usize,
    },
    /// The text is not a valid scenario.
    #[error("the scenario that was made is refused: {0}")]
    Refused(#[from] InputError),
}

impl TwinError {
    /// A suggestion.
    pub fn help(&self) -> &'static str {
        match self {
            Self::Model(_) => {
                "expected a robot for which `calibrig identifiability --model` ends with a rank"
            }
            Self::NoPlace { .. } => {
                "expected a robot that can be seen: try another --tracker, --floor-mm with the real height of the floor, or \
                 other limits in its file"
            }
            Self::NoNests { .. } => {
                "expected room around the base: try --floor-mm, or other shapes in its URDF"
            }
            Self::Refused(_) => "expected a robot for which a scenario can be made: see the reason",
        }
    }
}

/// Number of poses that characterise the robot.
const SURVEY: usize = 800;
/// From how many of them a box is grown.
const STARTS: usize = 16;
/// Largest turn about the middle of a joint's limits that cables and hoses allow, rad.
const MOST_TURN: f64 = 170.0 / 180.0 * std::f64::consts::PI;
/// Travel either way of a slide without limits, m.
const MOST_TRAVEL: f64 = 10.0;
/// Share of the poses that the tracker should see.
const SEEN: f64 = 0.95;
/// Margin about links, m, as in a scenario.
const MARGIN: f64 = 0.01;
/// End of the beam that is the reflector's own, m, as in a scenario.
const STANDOFF: f64 = 0.025;
/// A person's distance from the reach of a robot, m.
const KEEP_OFF: f64 = 0.3;
/// Largest deflection of a drive under its own robot, rad; for a slide, the same number of m.
const MOST_SAG: f64 = 5e-3;

/// Makes the twin of `robot`, whose file the scenario will name `named`.
///
/// # Errors
///
/// [`TwinError`], with the reason.
pub fn twin(robot: &Robot, named: &str, options: &TwinOptions) -> Result<Twin, TwinError> {
    let surveyed = survey(robot, options);
    let figures = surveyed.class.figures();
    let target = robot.targets.first().filter(|_| robot.targets.len() == 1).map(|target| target.in_flange);
    let in_flange = target.unwrap_or(1e-3 * Vector3::from(figures.target));
    let kinematics = &robot.model.kinematics;
    let mut told = surveyed.told.clone();

    let bare = match surveyed.radius {
        None => Obstacles::of_shapes(kinematics, &robot.visuals, MARGIN),
        Some(radius) => Obstacles::of_chain(kinematics, radius + MARGIN),
    };
    let obstacles = bare.with_standoff(STANDOFF).with_floor(surveyed.up, surveyed.floor);
    let room = Room {
        kinematics,
        actuators: &robot.model.actuators,
        obstacles: &obstacles,
        target: in_flange,
        planes: &surveyed.planes,
    };
    let mut rng = stream(0, 0, random::StreamSource::Twin);
    let clear = clear_region(&room, &surveyed, &mut rng, &mut told);

    let limits = options.preset.instrument().limits;
    let stand = Stand {
        room,
        reach: TrackerReach { range: limits.range, elevation: limits.elevation, azimuth: limits.azimuth },
        up: surveyed.up,
        floor: surveyed.floor,
        keep_off: surveyed.reach + KEEP_OFF,
        robot: surveyed.robot,
    };
    let drawn = |region: &WorkingRegion, count: usize, rng: &mut ChaCha8Rng| -> Vec<Vec<f64>> {
        (0..count).map(|_| room.completed(region.draw(rng))).collect()
    };
    let nowhere = |poses| TwinError::NoPlace { range: limits.range, poses };
    let first = drawn(&clear, 200, &mut rng);
    let place = stand.best(&first).ok_or_else(|| nowhere(first.len()))?;
    let (mut region, mut place) = stand.trimmed(&clear, &place, SEEN, &mut rng);
    // A better place for the rest of the region, and what is visible from there.
    if let Some(other) = stand.best(&drawn(&region, 200, &mut rng)).filter(|_| region != clear) {
        let (smaller, at) = stand.trimmed(&region, &other, SEEN, &mut rng);
        if at.seen >= place.seen.min(SEEN) {
            (region, place) = (smaller, at);
        }
    }
    if place.seen < SEEN {
        told.push(format!(
            "the tracker sees {:.0} % of the poses: the session leaves the others out, with the reason",
            100.0 * place.seen
        ));
    }
    let nests = nests(&stand, &surveyed, &place, &region)?;

    let poses = drawn(&region, 300, &mut rng);
    let report = identifiability_of(&robot.model, &poses, &in_flange, false, false)?;
    let parameters = [report.selected.len(), report.spectrum.rank];
    if parameters[1] < parameters[0] {
        told.push(format!(
            "these poses determine {} of {} link parameters: `calibrig identifiability` says which are missing, and what \
             would help",
            parameters[1], parameters[0]
        ));
    }
    let drives = robot.model.statics.as_ref().map(|statics| drives(robot, statics, &surveyed, &poses));
    let unknown = parameters[0] + drives.iter().flatten().filter(|drive| drive.torque > 0.0).count();
    // Multiples of ten, of which this many are seen.
    let tens = |wanted: usize| {
        let enough = |poses: &u32| f64::from(*poses) * place.seen.max(0.2) >= wanted as f64;
        (1..1000).map(|tens| 10 * tens).find(enough).unwrap_or(10_000)
    };
    let counts = [tens((2 * unknown).max(40)), tens(unknown.max(20))];
    let places: Vec<_> = poses.iter().map(|joints| room.target_at(joints)).collect();
    let extent = [f64::min, f64::max].map(|most: fn(f64, f64) -> f64| {
        places.iter().copied().reduce(|a, b| a.zip_map(&b, most)).unwrap_or_default()
    });
    let written = text::Written {
        robot,
        named,
        options,
        surveyed: &surveyed,
        figures: &figures,
        target: target.is_none().then_some(in_flange),
        region: &region,
        extent,
        place: &place,
        nests: &nests,
        drives: drives.as_deref(),
        parameters,
        unknown,
        poses: counts,
        told: &told,
    };
    let text = written.text();
    let scenario = parse_scenario(Source::new("the scenario that was made", text.clone()), robot.clone())?;
    let Surveyed { class, reach, mass, .. } = surveyed;
    Ok(Twin { text, scenario, class, reach, mass, region, extent, place, poses: counts, parameters, told })
}

/// Properties of the robot.
struct Surveyed {
    class: SizeClass,
    reach: f64,
    mass: Option<f64>,
    /// m/s² in the base frame, and whether it was asked for instead of that of the robot's file.
    gravity: Vector3<f64>,
    turned: bool,
    up: UnitVector3<f64>,
    /// Away from what the base is mounted on.
    away: UnitVector3<f64>,
    /// Height of the floor along up, m.
    floor: f64,
    /// Where the first joint is in the middle of its travel, m.
    robot: Vector3<f64>,
    planes: Vec<(UnitVector3<f64>, f64)>,
    /// Radius of the links, m, if the robot has no shapes.
    radius: Option<f64>,
    ranges: Vec<[f64; 2]>,
    poses: Vec<Vec<f64>>,
    told: Vec<String>,
}

impl Surveyed {
    /// Whether the base is on something other than the floor.
    fn is_off_the_floor(&self) -> bool {
        self.planes.len() > 1
    }
}

fn survey(robot: &Robot, options: &TwinOptions) -> Surveyed {
    let model = &robot.model;
    let kinematics = &model.kinematics;
    let mut told = Vec::new();
    let stated = model.statics.as_ref().map(|statics| statics.gravity);
    let gravity = match options.mounting {
        None => stated.unwrap_or(Vector3::new(0.0, 0.0, -STANDARD_GRAVITY)),
        Some(Mounting::Floor) => Vector3::new(0.0, 0.0, -STANDARD_GRAVITY),
        Some(Mounting::Wall) => Vector3::new(-STANDARD_GRAVITY, 0.0, 0.0),
        Some(Mounting::Ceiling) => Vector3::new(0.0, 0.0, STANDARD_GRAVITY),
    };
    let up = UnitVector3::try_new(-gravity, 1e-9).unwrap_or(Vector3::z_axis());
    let hangs = up.z < -0.7;
    let away = if hangs || options.mounting == Some(Mounting::Wall) { Vector3::z_axis() } else { up };

    let ranges = usable_ranges(kinematics, MOST_TURN, MOST_TRAVEL);
    let middle: Vec<f64> = ranges.iter().map(|[low, high]| 0.5 * (low + high)).collect();
    let (links, _) = stance_at(kinematics, &middle);
    let first = links.first().map_or(Vector3::zeros(), |link| link.translation.vector);
    let none = Obstacles::none(kinematics);
    let chain = Room {
        kinematics,
        actuators: &model.actuators,
        obstacles: &none,
        target: Vector3::zeros(),
        planes: &[],
    };
    let mut rng = stream(0, 1, random::StreamSource::Twin);
    let poses: Vec<Vec<f64>> = (0..SURVEY)
        .map(|_| {
            let draw = |[low, high]: &[f64; 2]| low + (high - low) * rng.random::<f64>();
            chain.completed(ranges.iter().map(draw).collect())
        })
        .collect();
    let reach = poses.iter().map(|joints| (chain.target_at(joints) - first).norm()).fold(0.0, f64::max);
    let mass = model.statics.as_ref().map(|statics| statics.bodies.iter().map(|body| body.mass).sum());
    let by_size = SizeClass::of(reach, mass);
    let class = options.class.unwrap_or(by_size);
    let has_shapes = robot.visuals.iter().any(|shapes| !shapes.is_empty());
    // A short chain would touch itself everywhere.
    let usual = (1e-3 * class.figures().radius).min(0.08 * reach);
    let radius = (!has_shapes).then_some((1e3 * usual).round().max(1.0) / 1e3);

    let off_the_floor = away != up;
    let below = lowest(robot, &up, &links, reach);
    let usual_floor = if off_the_floor { -(reach + 1.0) } else { below };
    let floor = (1e2 * options.floor.unwrap_or(usual_floor)).floor() / 1e2;
    if options.floor.is_none() {
        told.push(if off_the_floor {
            format!(
                "the floor is assumed {:.2} m below the base, out of its reach; --floor-mm states another height",
                -floor
            )
        } else {
            format!(
                "the floor is assumed at {:.0} mm above the base's origin; --floor-mm states another height",
                1e3 * floor + 0.0
            )
        });
    }
    let mut planes = vec![(up, floor)];
    if off_the_floor {
        planes.push((away, 0.0));
    }
    Surveyed {
        turned: stated.is_none_or(|stated| stated != gravity),
        class,
        reach,
        mass,
        gravity,
        up,
        away,
        floor,
        robot: first,
        planes,
        radius,
        ranges,
        poses,
        told,
    }
}

/// Height of what a base stands on, m: its origin, or the lowest of its shapes; and no higher than a tenth of the reach below the second joint, which
/// tables that begin at the shoulder leave out.
fn lowest(
    robot: &Robot,
    up: &UnitVector3<f64>,
    links: &[calibrig_model::geometry::Transform],
    reach: f64,
) -> f64 {
    let of_base = robot.visuals.first().into_iter().flatten().map(|visual| {
        let at = up.dot(&visual.link_from_shape.translation.vector);
        let axes = visual.link_from_shape.rotation.inverse() * up.into_inner();
        at - match visual.shape {
            calibrig_model::VisualShape::Box(edges) => 0.5 * axes.abs().dot(&Vector3::from(edges)),
            calibrig_model::VisualShape::Cylinder { radius, length } => {
                radius * axes.x.hypot(axes.y) + 0.5 * length * axes.z.abs()
            }
            calibrig_model::VisualShape::Sphere(radius) => radius,
        }
    });
    let shoulder = links.get(1).or(links.first()).map_or(0.0, |link| up.dot(&link.translation.vector));
    of_base.fold(0.0, f64::min).min(shoulder - 0.1 * reach)
}

/// The box in which nothing touches; if none is found, with fewer conditions, which is reported.
fn clear_region(
    room: &Room<'_>,
    surveyed: &Surveyed,
    rng: &mut ChaCha8Rng,
    told: &mut Vec<String>,
) -> WorkingRegion {
    let attempt = |room: &Room<'_>, built: &Built, rng: &mut ChaCha8Rng| {
        let clear = surveyed.poses.iter().filter(|joints| room.is_clear(joints, built));
        let starts: Vec<_> = clear.take(STARTS).cloned().collect();
        experiment::clear_region(room, &surveyed.ranges, &starts, built, rng)
    };
    if let Some(region) = attempt(room, &room.survey(&surveyed.poses), rng) {
        return region;
    }
    let afloat = Room { planes: &[], ..*room };
    if let Some(region) = attempt(&afloat, &afloat.survey(&surveyed.poses), rng) {
        told.push("no pose was found with all links above the floor and clear of what the base is mounted on: poses may go \
                   below them (--floor-mm)".to_owned());
        return region;
    }
    told.push(
        "no pose was found in which the links do not touch each other: poses are drawn without checking this"
            .to_owned(),
    );
    let bare = Obstacles::none(room.kinematics);
    let free = Room { planes: &[], obstacles: &bare, ..*room };
    attempt(&free, &Built::default(), rng).unwrap_or_else(|| WorkingRegion {
        centre: surveyed.ranges.iter().map(|[low, high]| 0.5 * (low + high)).collect(),
        half_width: vec![0.0; surveyed.ranges.len()],
    })
}

/// Nests on rings around the base, low and raised, that the tracker sees with the robot anywhere in its region.
fn nests(
    stand: &Stand<'_>,
    surveyed: &Surveyed,
    place: &Place,
    region: &WorkingRegion,
) -> Result<Vec<Vector3<f64>>, TwinError> {
    let mut rng = stream(0, 2, random::StreamSource::Twin);
    let mut poses = vec![region.centre.clone()];
    poses.extend((0..6).map(|_| stand.room.completed(region.draw(&mut rng))));
    let away = &surveyed.away;
    let ground = if surveyed.is_off_the_floor() { 0.0 } else { surveyed.floor };
    let middle = surveyed.robot - away.into_inner() * (away.dot(&surveyed.robot) - ground);
    let level = Rotation3::rotation_between(&Vector3::z(), away).unwrap_or_else(Rotation3::identity);
    let ring = |radii: [f64; 2]| -> Vec<Vector3<f64>> {
        let raised = (0.25 * surveyed.reach).clamp(0.1, 1.0);
        let at = |k: u32, radius: f64, height: f64| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / 24.0).sin_cos();
            let place = middle + level * Vector3::new(radius * cos, radius * sin, height);
            (1e3 * place).map(f64::round) / 1e3
        };
        (0..24)
            .flat_map(|k| radii.map(|radius| [at(k, radius, 0.03), at(k, radius, raised)]))
            .flatten()
            .collect()
    };
    let near = [(0.45 * surveyed.reach).max(0.3), (0.9 * surveyed.reach).max(0.5)].map(|r| r.min(2.5));
    let mut most = Vec::new();
    for farther in [1.0, 1.5, 2.2, 3.0] {
        let found = stand.nests(place, &poses, &ring(near.map(|radius| farther * radius)), 6);
        if found.len() >= 4 {
            return Ok(found);
        }
        if found.len() > most.len() {
            most = found;
        }
    }
    if most.len() < 3 { Err(TwinError::NoNests { found: most.len() }) } else { Ok(most) }
}

/// A drive of the twin.
struct Drive {
    /// Largest load of gravity at the region's poses, N or N m.
    torque: f64,
    /// Stiffness as built over that of the robot's file, if that is a guess.
    factor: Option<f64>,
    /// As built, N/m or N m/rad.
    stiffness: f64,
}

/// Stiffnesses: those of the file if known, those of the class if guessed; stiff enough to carry the robot.
fn drives(robot: &Robot, statics: &StaticProperties, surveyed: &Surveyed, poses: &[Vec<f64>]) -> Vec<Drive> {
    let figures = surveyed.class.figures();
    let guessed = is_guess(robot);
    let links = &robot.model.kinematics.links;
    let load = |joint: usize, kind: JointKind| {
        let of_pose = |joints: &Vec<f64>| {
            let (frames, _) = stance_at(&robot.model.kinematics, joints);
            let axis = frames[joint].rotation * Vector3::z();
            let origin = frames[joint].translation.vector;
            let of_body = |(body, frame): (&calibrig_model::Body, &calibrig_model::geometry::Transform)| {
                let weight = body.mass * surveyed.gravity;
                let arm = (frame * nalgebra::Point3::from(body.centre_of_mass)).coords - origin;
                match kind {
                    JointKind::Revolute => axis.dot(&arm.cross(&weight)),
                    JointKind::Prismatic => axis.dot(&weight),
                }
            };
            statics.bodies.iter().zip(&frames).skip(joint).map(of_body).sum::<f64>().abs()
        };
        poses.iter().take(100).map(of_pose).fold(0.0, f64::max)
    };
    let outboard = |joint: usize| {
        let farthest = |joints: &Vec<f64>| {
            let (frames, flange) = stance_at(&robot.model.kinematics, joints);
            (flange.translation.vector - frames[joint].translation.vector).norm()
        };
        surveyed.poses.iter().take(100).map(farthest).fold(0.0, f64::max)
    };
    let drive = |(joint, link): (usize, &calibrig_model::CraigLink)| {
        let stated = statics.drive_stiffness[joint];
        let torque = load(joint, link.kind);
        // Rounding of an axis along gravity.
        let torque = if torque < 1e-6 { 0.0 } else { torque };
        let usual = match link.kind {
            JointKind::Prismatic => figures.slide,
            JointKind::Revolute if outboard(joint) > 0.35 * surveyed.reach => figures.main_drive,
            JointKind::Revolute => figures.wrist_drive,
        };
        let stiffness = usual.max(torque / MOST_SAG);
        let is_loaded = guessed && torque > 0.0 && stated.is_finite();
        let factor = is_loaded.then(|| two_digits(stiffness / stated));
        Drive { torque, factor, stiffness: factor.map_or(stated, |factor| factor * stated) }
    };
    links.iter().enumerate().map(drive).collect()
}

/// Whether the robot's file marks its stiffnesses as guesses.
fn is_guess(robot: &Robot) -> bool {
    robot.stiffness_unknown || robot.compliance_sigma.is_some_and(|sigma| sigma >= 1.0)
}

/// A guess has no more digits.
fn two_digits(value: f64) -> f64 {
    let unit = 10_f64.powf(value.log10().floor() - 1.0);
    // Divided by a power of ten, to avoid rounding digits.
    if unit < 1.0 { (value / unit).round() / (1.0 / unit).round() } else { (value / unit).round() * unit }
}
