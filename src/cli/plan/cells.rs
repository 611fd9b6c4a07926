//! From flags to what is planned for: a scenario, a robot before a tracker, or what comes after a session.

use std::path::{Path, PathBuf};

use clap::CommandFactory;
use clap::error::ErrorKind;

use super::super::identify::{Loaded, actuator_sigmas, failed, load, terms};
use super::super::{Cli, CliError, read_scenario, replay, say};
use super::Args;
use crate::handover::EstimateFile;
use crate::pipeline::{calibrate, default_options, without_drift};
use crate::pose_plan::{
    Cell, Noise, Readings, Region, Surroundings, cell_of, levelled, nominal_robot, surroundings_of,
    whole_space,
};
use crate::replay::{ReplayOptions, replay as identify_again};
use crate::scenario::{Scenario, parse_scenario};
use crate::twin::Preset;
use calibrig_estimation::identification::{
    Estimate, IdentificationOptions, MachineNoiseChoice, Mode, NoiseScale, Tolerance, reachable_poses,
};
use calibrig_files::{InputError, LoadedMeasurements, MeasuredFile, Robot, load_session, parse_robot, state};
use calibrig_model::geometry::Transform;
use calibrig_model::measurement::{MeasurementSet, Observation, Reading, SetKind, Station, Target, register};
use calibrig_model::nalgebra::{Matrix3, UnitVector3, Vector3};
use calibrig_model::visibility::{Obstacles, Reflector, stance_at};
use calibrig_model::{CalibrationModel, JointKind};

/// What files say.
pub(super) struct Read {
    /// For messages.
    pub file: PathBuf,
    pub robot: Robot,
    pub seed: Option<u64>,
    scenario: Option<Box<Scenario>>,
    options: IdentificationOptions,
    before: Option<(MeasurementSet, Estimate)>,
    /// Stations and targets, where no scenario says so.
    stated: MeasurementSet,
}

/// A target off every axis, where it can be mounted, m.
const MOUNTABLE_TARGET: Vector3<f64> = Vector3::new(0.1, 0.15, 0.2);
/// End of the beam that is the reflector's own, and what shapes leave out of links, m.
const STANDOFF: f64 = 0.025;
const MARGIN: f64 = 0.01;
/// Poses at which a robot's reach is looked at; radius of links as a part of it, and at most, m.
const REACH_POSES: usize = 200;
const OF_REACH: f64 = 0.08;
const MOST_RADIUS: f64 = 0.08;

fn misused(message: &str) -> ! {
    Cli::command().error(ErrorKind::ValueValidation, message).exit()
}

pub(super) fn read(args: &Args) -> Result<Read, CliError> {
    let mut read = match (&args.scenario, &args.after) {
        (Some(path), None) => of_scenario(path)?,
        (Some(path), Some(after)) => {
            let mut read = of_scenario(path)?;
            let (set, estimate, _) = recorded(args, after, &read.robot)?;
            read.before = Some((set, estimate));
            read
        }
        (None, Some(after)) if args.model.is_none() && args.urdf.is_none() => of_recording(args, after)?,
        _ => of_robot(args)?,
    };
    adjust(args, &mut read);
    Ok(read)
}

/// Options as flags change them.
fn adjust(args: &Args, read: &mut Read) {
    let options = &mut read.options;
    if let Some(mode) = args.mode {
        options.mode = mode;
    }
    if let Some(families) = &args.terms {
        if options.mode != Mode::Extended {
            misused("--terms: expected --mode extended beside it");
        }
        options.terms = Some(terms(families));
    }
    if let (Some(length), Some(angle)) = (args.tolerance_mm, args.tolerance_mrad) {
        options.tolerance = Some(Tolerance { length: 1e-3 * length, angle: 1e-3 * angle });
    }
    if !args.actuator_sigma.is_empty() {
        options.machine_noise =
            MachineNoiseChoice::Stated(actuator_sigmas(&args.actuator_sigma, &read.robot.model));
    }
}

/// Geometry and stiffness, where anything is known of the latter.
fn usual_mode(model: &CalibrationModel) -> Mode {
    if model.compliances().is_empty() { Mode::OnlyCalibration } else { Mode::ElastoGeometric }
}

fn of_scenario(path: &Path) -> Result<Read, CliError> {
    let scenario = read_scenario(path)?;
    Ok(Read { file: path.to_path_buf(), ..of_parsed(scenario) })
}

fn of_parsed(scenario: Scenario) -> Read {
    let fitted = |mode: &&Mode| **mode != Mode::WithoutCalibration;
    let has = |mode| scenario.modes.contains(&mode);
    let last = scenario.modes.iter().rfind(fitted).copied();
    let mode = if has(Mode::ElastoGeometric) {
        Mode::ElastoGeometric
    } else {
        last.unwrap_or_else(|| usual_mode(&scenario.robot.model))
    };
    Read {
        file: PathBuf::new(),
        robot: scenario.robot.clone(),
        seed: Some(scenario.seed),
        options: IdentificationOptions { mode, ..scenario.options.clone() },
        scenario: Some(Box::new(scenario)),
        before: None,
        stated: MeasurementSet::default(),
    }
}

/// The mode that further poses are planned for.
fn wanted(args: &Args, model: &CalibrationModel) -> Mode {
    args.mode.unwrap_or_else(|| usual_mode(model))
}

/// What a recording holds, identified again.
fn recorded(
    args: &Args,
    path: &Path,
    robot: &Robot,
) -> Result<(MeasurementSet, Estimate, IdentificationOptions), CliError> {
    let mode = wanted(args, &robot.model);
    let options = ReplayOptions { modes: vec![mode], ..ReplayOptions::default() };
    let replayed = identify_again(path, &options).map_err(|error| replay::failed(error, path))?;
    let found = replayed.outcome.modes.into_iter().find(|own| own.mode == mode).and_then(|own| own.estimate);
    let set = replayed.outcome.sets.into_iter().next().map(|set| set.measurements).unwrap_or_default();
    match found {
        Some(estimate) => Ok((set, estimate, IdentificationOptions { mode, ..replayed.options })),
        None => Err(CliError::NoEstimate { file: path.to_path_buf(), mode: Some(mode) }),
    }
}

fn of_recording(args: &Args, path: &Path) -> Result<Read, CliError> {
    let recording = calibrig_recording::read_recording(path)
        .map_err(|source| CliError::Mcap { file: path.to_path_buf(), source })?;
    let source = |role: &str| recording.source(role).cloned();
    let Some(of_robot) = source("robot") else {
        let message = "the recording does not hold the robot's file".to_owned();
        let help =
            "expected a recording of calibrig run, or --model ROBOT.toml with --measurements".to_owned();
        return Err(InputError::Place { place: path.display().to_string(), message, help: Some(help) }.into());
    };
    let robot = parse_robot(of_robot, source("urdf"), source("columns"))?;
    let (set, estimate, options) = recorded(args, path, &robot)?;
    let mut read = match source("scenario") {
        Some(text) => of_parsed(parse_scenario(text, robot)?),
        None => Read {
            file: PathBuf::new(),
            robot,
            seed: None,
            scenario: None,
            options: options.clone(),
            before: None,
            stated: MeasurementSet::default(),
        },
    };
    read.options = options;
    read.before = Some((set, estimate));
    Ok(Read { file: path.to_path_buf(), ..read })
}

fn of_robot(args: &Args) -> Result<Read, CliError> {
    let robot = args.chain.robot(args.model.as_deref(), args.urdf.as_deref())?;
    let file = args.model.clone().or(args.urdf.clone()).unwrap_or_default();
    if !args.measurements.is_empty() {
        return of_files(args, robot);
    }
    if args.after.is_some() {
        misused("--after beside --model: expected --measurements with what the estimate was made from");
    }
    robot.remarks.iter().for_each(|remark| say(remark));
    let in_flange = robot.target().unwrap_or_else(|| {
        say("the robot's file states no target: it is taken to be mounted 100, 150, 200 mm off the flange");
        MOUNTABLE_TARGET
    });
    let stated = with_statements(args, &robot, in_flange)?;
    let options = IdentificationOptions { mode: usual_mode(&robot.model), ..default_options(&robot) };
    Ok(Read { file, robot, seed: None, scenario: None, options, before: None, stated })
}

/// Stations and targets as session file and robot's file state them.
fn with_statements(args: &Args, robot: &Robot, in_flange: Vector3<f64>) -> Result<MeasurementSet, CliError> {
    let position = Vector3::new(1.0, 0.0, 0.0);
    let observation = Observation {
        pose: 1,
        command: vec![0.0; robot.model.kinematics.joint_count()],
        approach: Vec::new(),
        since_reversal: Vec::new(),
        temperature: None,
        time: 0.0,
        station: 0,
        target: 0,
        payload: None,
        reading: Reading::Cartesian { position, covariance: None },
    };
    let set = MeasurementSet {
        stations: vec![Station { name: "1".to_owned(), ..Station::default() }],
        targets: vec![Target { name: "SMR".to_owned(), in_flange, covariance: None, orientation: None }],
        observations: vec![observation],
    };
    let Some(path) = &args.session else {
        let mut set = set;
        if let Some(target) = robot.targets.first() {
            set.targets[0].covariance = target.covariance();
        }
        return Ok(set);
    };
    let (session, source) = load_session(path)?;
    session.check_usable(&source)?;
    let loaded = LoadedMeasurements { set, ..LoadedMeasurements::default() };
    let mut files =
        [MeasuredFile { kind: SetKind::Identification, name: path.display().to_string(), loaded }];
    let statements = state(robot, Some((&session, &source)), &mut files)?;
    statements.remarks.iter().for_each(|line| say(line));
    let [file] = files;
    Ok(file.loaded.set)
}

/// Further poses after those of files.
fn of_files(args: &Args, robot: Robot) -> Result<Read, CliError> {
    let asked = args.rows.sets(&args.measurements, &[], None);
    let first = asked.first().and_then(|set| set.files.points.first());
    let file = first.map(|file| file.path.clone()).unwrap_or_default();
    let loaded = load(robot, args.columns.as_deref(), args.session.as_deref(), &args.rows, asked)?;
    loaded.check_session()?;
    let Loaded { robot, sets, places, read, statements, .. } = loaded;
    for line in &read {
        say(line);
    }
    let mode = wanted(args, &robot.model);
    let options = IdentificationOptions { mode, ..default_options(&robot) };
    let sets = without_drift(sets).map_err(|error| failed(error, &file, &[], &places))?.sets;
    let estimate = match &args.after {
        Some(path) => {
            let estimate = EstimateFile::read(path)?;
            let checked = estimate.check_model(&robot.model);
            checked.map_err(|source| CliError::AnotherModel { file: path.clone(), source })?;
            estimate.estimate
        }
        None => {
            let fitted = calibrate(&robot.model, &sets, &[mode], &options);
            let (_, modes) = fitted.map_err(|error| failed(error, &file, &sets, &places))?;
            let found = modes.into_iter().find_map(|own| own.estimate);
            found.ok_or_else(|| CliError::NoEstimate { file: file.clone(), mode: Some(mode) })?
        }
    };
    statements.remarks.iter().for_each(|line| say(line));
    let options = IdentificationOptions { mode: estimate.robot.mode, ..options };
    let set = sets.into_iter().next().map(|set| set.measurements).unwrap_or_default();
    Ok(Read {
        file,
        robot,
        seed: None,
        scenario: None,
        options,
        before: Some((set, estimate)),
        stated: MeasurementSet::default(),
    })
}

impl Read {
    /// What is planned for.
    pub fn cell(&self, args: &Args) -> Result<Cell<'_>, CliError> {
        let (clearance, angle) = (1e-3 * args.clearance_mm, args.clearance_deg.to_radians());
        let model = &self.robot.model;
        let mut cell = match &self.scenario {
            Some(scenario) => cell_of(scenario, self.options.clone(), clearance, angle),
            None => Cell {
                name: self.robot.name.clone(),
                model,
                options: self.options.clone(),
                around: self.around(args, clearance, angle),
                readings: self.stated_readings(args)?,
                region: self.region(args),
                before: None,
            },
        };
        if let Some((set, estimate)) = &self.before {
            cell.before = Some((set.clone(), estimate.clone()));
            cell.readings = Readings::Stated {
                robot: estimate.robot.clone(),
                set: MeasurementSet { observations: Vec::new(), ..set.clone() },
                noise: found_noise(set, estimate),
            };
            if let Some(scenario) = &self.scenario {
                cell.around = surroundings_of(scenario, clearance, angle);
            }
            for (stand, from_base) in cell.around.trackers.iter_mut().zip(&estimate.robot.stations) {
                stand.base_from_tracker = from_base.inverse();
            }
        }
        Ok(cell)
    }

    /// Where a robot is to work that no scenario tells of.
    fn region(&self, args: &Args) -> Region {
        let model = &self.robot.model;
        if args.region.is_empty() {
            return Region::whole();
        }
        let mut sides = whole_space(model);
        for own in &args.region {
            let place = model.kinematics.links.iter().position(|link| link.name == own.joint);
            let Some(place) = place.filter(|place| model.actuators.is_commanded(*place)) else {
                let links = model.kinematics.links.iter().enumerate();
                let names: Vec<_> = links
                    .filter(|(joint, _)| model.actuators.is_commanded(*joint))
                    .map(|(_, link)| link.name.as_str())
                    .collect();
                misused(&format!(
                    "--region {}: expected one of the robot's joints: {}",
                    own.joint,
                    names.join(", ")
                ))
            };
            let link = &model.kinematics.links[place];
            let value = |(number, unit): &(f64, String)| match (link.kind, unit.as_str()) {
                (JointKind::Prismatic, "mm") | (JointKind::Revolute, "mrad") => 1e-3 * number,
                (JointKind::Prismatic, "m") | (JointKind::Revolute, "rad") => *number,
                (JointKind::Revolute, "deg") => number.to_radians(),
                (kind, _) => {
                    let units = if kind == JointKind::Prismatic { "mm or m" } else { "deg, rad or mrad" };
                    misused(&format!("--region {}: expected its range in {units}", own.joint))
                }
            };
            let ends = [value(&own.ends[0]), value(&own.ends[1])];
            let [low, high] = link.limits;
            if !(ends[0] <= ends[1] && ends[0] >= low - 1e-9 && ends[1] <= high + 1e-9) {
                let (unit, scale) = match link.kind {
                    JointKind::Prismatic => ("mm", 1e3),
                    JointKind::Revolute => ("deg", 1_f64.to_degrees()),
                };
                misused(&format!(
                    "--region {}: {:.3} to {:.3} {unit}: expected a range within its limits, {:.3} to {:.3} {unit}, the lower end first",
                    own.joint,
                    scale * ends[0],
                    scale * ends[1],
                    scale * low,
                    scale * high
                ));
            }
            sides[place] = [ends[0].max(low), ends[1].min(high)];
        }
        Region::between(sides, "the region of --region")
    }

    fn target(&self) -> Vector3<f64> {
        let measured = self.before.as_ref().and_then(|(_, estimate)| estimate.robot.targets.first());
        measured
            .or(self.stated.targets.first().map(|own| &own.in_flange))
            .copied()
            .unwrap_or(MOUNTABLE_TARGET)
    }

    /// Of a robot that no scenario tells of.
    fn around(&self, args: &Args, clearance: f64, angle: f64) -> Surroundings {
        let model = &self.robot.model;
        let up = -model.statics.as_ref().map_or(Vector3::new(0.0, 0.0, -9.81), |statics| statics.gravity);
        let up = UnitVector3::try_new(up, 1e-9).unwrap_or(Vector3::z_axis());
        let shapes = Obstacles::of_shapes(&model.kinematics, &self.robot.visuals, MARGIN);
        let bare = match args.capsule_radius_mm {
            _ if shapes.has_links() => shapes,
            Some(0.0) => Obstacles::none(&model.kinematics),
            Some(radius) => Obstacles::of_chain(&model.kinematics, 1e-3 * radius + MARGIN),
            None => Obstacles::of_chain(&model.kinematics, usual_radius(model) + MARGIN),
        };
        let bare = bare.with_standoff(STANDOFF);
        let obstacles = match args.floor_mm {
            Some(height) => bare.with_floor(up, 1e-3 * height),
            None => bare,
        };
        let instrument = args.tracker.map(Preset::instrument);
        let places: Vec<Vector3<f64>> = match (&args.tracker_mm, &self.before) {
            (Some(place), _) => vec![place.0],
            (None, Some((_, estimate))) => {
                estimate.robot.stations.iter().map(|own| own.inverse().translation.vector).collect()
            }
            (None, None) => {
                self.stations().into_iter().flatten().map(|own| own.inverse().translation.vector).collect()
            }
        };
        let opening = args.opening.and_then(|own| UnitVector3::try_new(own.0, 1e-12));
        if args.opening.is_some() && opening.is_none() {
            misused("--opening: expected a direction that is not 0,0,0");
        }
        let acceptance = args.acceptance_deg.to_radians();
        Surroundings {
            hides: Some(obstacles.clone()),
            obstacles,
            trackers: places.into_iter().map(|place| levelled(instrument, place, &up)).collect(),
            reflectors: vec![Reflector { in_flange: self.target(), opening, acceptance }],
            clearance,
            angle,
        }
    }

    /// Where the session's nests place the stations; `None` of one without.
    fn stations(&self) -> Vec<Option<Transform>> {
        let placed = |station: &Station| register(station).ok().map(|found| found.tracker_from_base);
        self.stated.stations.iter().map(placed).collect()
    }

    /// Readings of a robot that no scenario tells of.
    fn stated_readings(&self, args: &Args) -> Result<Readings<'_>, CliError> {
        let noise = match (args.tracker, args.noise_um) {
            (Some(preset), _) => Noise::Instrument(preset.instrument()),
            (None, Some(um)) => Noise::Coordinate(1e-6 * um),
            (None, None) if self.before.is_some() => Noise::Found,
            (None, None) => {
                return Err(InputError::Place {
                    place: self.file.display().to_string(),
                    message: "nobody says how the readings will scatter, and so not what they would tell".to_owned(),
                    help: Some("expected --tracker NAME, or --noise-um with the standard deviation of a coordinate; or --measurements, whose noise is found".to_owned()),
                }
                .into());
            }
        };
        let mut robot = nominal_robot(&self.robot.model, &self.options, &[]);
        robot.targets = self.stated.targets.iter().map(|own| own.in_flange).collect();
        robot.orientations = vec![None; robot.targets.len()];
        let identity = Transform::identity();
        let stands = args.tracker_mm.map(|place| {
            let statics = self.robot.model.statics.as_ref();
            let up = -statics.map_or(Vector3::new(0.0, 0.0, -9.81), |statics| statics.gravity);
            levelled(None, place.0, &up).base_from_tracker.inverse()
        });
        robot.stations = self.stations().into_iter().map(|own| own.or(stands).unwrap_or(identity)).collect();
        let set = MeasurementSet { observations: Vec::new(), ..self.stated.clone() };
        Ok(Readings::Stated { robot, set, noise })
    }
}

/// Radius of the links of a robot whose shapes nobody knows, m: a short chain of thick ones would touch itself everywhere.
fn usual_radius(model: &CalibrationModel) -> f64 {
    let first = model.kinematics.base_from_first.translation.vector;
    let reach = reachable_poses(model, REACH_POSES)
        .iter()
        .map(|joints| (stance_at(&model.kinematics, joints).1.translation.vector - first).norm())
        .fold(0.0, f64::max);
    (OF_REACH * reach).min(MOST_RADIUS)
}

/// How the readings of a session scattered, a coordinate in the mean; as the estimate found it where they state nothing.
fn found_noise(set: &MeasurementSet, estimate: &Estimate) -> Noise {
    let stated: Vec<Matrix3<f64>> =
        set.observations.iter().filter_map(|own| own.reading.position_covariance()).collect();
    if stated.is_empty() || matches!(estimate.noise, NoiseScale::Residuals(_)) {
        return Noise::Found;
    }
    let mean = stated.iter().map(|own| own.trace() / 3.0).sum::<f64>() / stated.len() as f64;
    Noise::Coordinate(mean.sqrt())
}
