//! From flags to what is planned: a scenario, a robot in front of a tracker, or a session to continue.

use std::path::{Path, PathBuf};

use clap::CommandFactory;
use clap::error::ErrorKind;

use super::super::identify::{Loaded, actuator_sigmas, failed, load, terms};
use super::super::{Cli, CliError, read_scenario, replay, say};
use super::Args;
use crate::handover::{AnotherModel, EstimateFile, model_sha256};
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
    /// Stations and targets, if no scenario states them.
    stated: MeasurementSet,
}

/// A target off every axis, where it can be mounted, m.
const MOUNTABLE_TARGET: Vector3<f64> = Vector3::new(0.1, 0.15, 0.2);
/// Part of the beam that is the reflector's own, and margin to the shapes of links, m.
const STANDOFF: f64 = 0.025;
const MARGIN: f64 = 0.01;
/// Number of poses that estimate a robot's reach; radius of links as a part of it, and at most, m.
const REACH_POSES: usize = 200;
const OF_REACH: f64 = 0.08;
const MOST_RADIUS: f64 = 0.08;
/// Of a reflector, deg.
const ACCEPTANCE: f64 = 30.0;

fn misused(message: &str) -> ! {
    Cli::command().error(ErrorKind::ValueValidation, message).exit()
}

pub(super) fn read(args: &Args) -> Result<Read, CliError> {
    refuse_unused(args);
    let mut read = match (&args.scenario, &args.after) {
        (Some(path), None) => of_scenario(path)?,
        (Some(path), Some(after)) => {
            let mut read = of_scenario(path)?;
            let (set, estimate, _) = recorded(after, args.mode.unwrap_or(read.options.mode))?;
            let [found, expected] = [&read.robot.model, &estimate.robot.nominal].map(model_sha256);
            if found != expected {
                let source = AnotherModel { found, expected };
                return Err(CliError::AnotherModel { file: path.clone(), source });
            }
            read.before = Some((set, estimate));
            read
        }
        (None, Some(after)) if args.model.is_none() && args.urdf.is_none() => of_recording(args, after)?,
        _ => of_robot(args)?,
    };
    adjust(args, &mut read.options, &read.robot.model);
    if let Some((_, estimate)) = &read.before {
        read.options.mode = estimate.robot.mode;
    }
    Ok(read)
}

/// Flags cannot change what a session has found already.
fn refuse_unused(args: &Args) {
    let is_estimated = args.after.is_some();
    if !is_estimated && args.measurements.is_empty() {
        return;
    }
    for (flag, is_given, what) in [
        ("--noise-um", args.noise_um.is_some(), "the noise of the readings is that found in the session"),
        ("--tracker-mm", args.tracker_mm.is_some(), "the tracker's place is that found in the session"),
        ("--terms", is_estimated && args.terms.is_some(), "the terms are those of the estimate"),
        (
            "--actuator-sigma",
            is_estimated && !args.actuator_sigma.is_empty(),
            "the machine's own random errors are those of the estimate",
        ),
    ] {
        if is_given {
            misused(&format!("{flag} cannot be used after a session: {what}"));
        }
    }
}

/// The same for a recording that holds its scenario.
fn refuse_beside_scenario(args: &Args) {
    for (flag, is_given) in [
        ("--tracker", args.tracker.is_some()),
        ("--region", !args.region.is_empty()),
        ("--opening", args.opening.is_some()),
        ("--acceptance-deg", args.acceptance_deg.is_some()),
        ("--floor-mm", args.floor_mm.is_some()),
        ("--capsule-radius-mm", args.capsule_radius_mm.is_some()),
    ] {
        if is_given {
            misused(&format!("{flag} cannot be used with this recording: its scenario states it"));
        }
    }
}

/// Options as changed by flags.
fn adjust(args: &Args, options: &mut IdentificationOptions, model: &CalibrationModel) {
    if let Some(mode) = args.mode {
        options.mode = mode;
    }
    if let Some(families) = &args.terms {
        if options.mode != Mode::Extended {
            misused("--terms: expected --mode extended with it");
        }
        options.terms = Some(terms(families));
    }
    if let (Some(length), Some(angle)) = (args.tolerance_mm, args.tolerance_mrad) {
        options.tolerance = Some(Tolerance { length: 1e-3 * length, angle: 1e-3 * angle });
    }
    if !args.actuator_sigma.is_empty() {
        options.machine_noise = MachineNoiseChoice::Stated(actuator_sigmas(&args.actuator_sigma, model));
    }
}

/// Geometry and stiffness, if anything is known about the latter.
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

/// What a recording holds, identified again in a mode.
fn recorded(path: &Path, mode: Mode) -> Result<(MeasurementSet, Estimate, IdentificationOptions), CliError> {
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
    let read = match source("scenario") {
        Some(text) => {
            refuse_beside_scenario(args);
            of_parsed(parse_scenario(text, robot)?)
        }
        None => Read {
            file: PathBuf::new(),
            seed: None,
            scenario: None,
            options: IdentificationOptions { mode: usual_mode(&robot.model), ..default_options(&robot) },
            robot,
            before: None,
            stated: MeasurementSet::default(),
        },
    };
    let (set, estimate, options) = recorded(path, args.mode.unwrap_or(read.options.mode))?;
    Ok(Read { file: path.to_path_buf(), options, before: Some((set, estimate)), ..read })
}

fn of_robot(args: &Args) -> Result<Read, CliError> {
    let robot = args.chain.robot(args.model.as_deref(), args.urdf.as_deref())?;
    let file = args.model.clone().or(args.urdf.clone()).unwrap_or_default();
    if !args.measurements.is_empty() {
        return of_files(args, robot);
    }
    if args.after.is_some() {
        misused(
            "--after with --model: expected --measurements with the measurements that the estimate was made from",
        );
    }
    robot.remarks.iter().for_each(|remark| say(remark));
    let in_flange = robot.target().unwrap_or_else(|| {
        say("the robot's file states no target: it is assumed 100, 150, 200 mm from the flange");
        MOUNTABLE_TARGET
    });
    let stated = with_statements(args, &robot, in_flange)?;
    let options = IdentificationOptions { mode: usual_mode(&robot.model), ..default_options(&robot) };
    Ok(Read { file, robot, seed: None, scenario: None, options, before: None, stated })
}

/// Stations and targets as stated in session file and robot's file.
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
    let mut options = IdentificationOptions { mode: usual_mode(&robot.model), ..default_options(&robot) };
    adjust(args, &mut options, &robot.model);
    let mode = options.mode;
    let sets = without_drift(sets).map_err(|error| failed(error, &file, &[], &places))?.sets;
    let estimate = match &args.after {
        Some(path) => {
            let estimate = EstimateFile::read(path)?;
            let checked = estimate.check_model(&robot.model);
            checked.map_err(|source| CliError::AnotherModel { file: path.clone(), source })?;
            if args.mode.is_some_and(|mode| mode != estimate.estimate.robot.mode) {
                return Err(CliError::NoEstimate { file: path.clone(), mode: args.mode });
            }
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

    /// Working region of a robot without a scenario.
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

    /// Targets in the flange frame, m.
    fn targets(&self) -> Vec<Vector3<f64>> {
        match &self.before {
            Some((_, estimate)) => estimate.robot.targets.clone(),
            None => self.stated.targets.iter().map(|own| own.in_flange).collect(),
        }
    }

    /// For a robot without a scenario.
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
        let stations = self.stations(args);
        let places: Vec<Vector3<f64>> =
            stations.iter().flatten().map(|own| own.inverse().translation.vector).collect();
        if !places.is_empty() && places.len() < stations.len() {
            misused(
                "the session places only some stations by nests: expected --tracker-mm with the place of the others",
            );
        }
        let opening = args.opening.and_then(|own| UnitVector3::try_new(own.0, 1e-12));
        if args.opening.is_some() && opening.is_none() {
            misused("--opening: expected a direction that is not 0,0,0");
        }
        let acceptance = args.acceptance_deg.unwrap_or(ACCEPTANCE).to_radians();
        let targets = self.targets().into_iter();
        Surroundings {
            hides: Some(obstacles.clone()),
            obstacles,
            trackers: places.into_iter().map(|place| levelled(instrument, place, &up)).collect(),
            reflectors: targets.map(|in_flange| Reflector { in_flange, opening, acceptance }).collect(),
            clearance,
            angle,
        }
    }

    /// Place of the stations: from a session, from nests, or else from the flag; `None` if unknown.
    fn stations(&self, args: &Args) -> Vec<Option<Transform>> {
        if let Some((_, estimate)) = &self.before {
            return estimate.robot.stations.iter().copied().map(Some).collect();
        }
        let stands = args.tracker_mm.map(|place| {
            let statics = self.robot.model.statics.as_ref();
            let up = -statics.map_or(Vector3::new(0.0, 0.0, -9.81), |statics| statics.gravity);
            levelled(None, place.0, &up).base_from_tracker.inverse()
        });
        let placed = |station: &Station| register(station).ok().map(|found| found.tracker_from_base);
        let by_nests: Vec<_> = self.stated.stations.iter().map(placed).collect();
        if stands.is_some() && by_nests.iter().all(Option::is_some) {
            misused(
                "--tracker-mm: the session's nests already determine the tracker's place; expected no --tracker-mm",
            );
        }
        by_nests.into_iter().map(|own| own.or(stands)).collect()
    }

    /// Readings of a robot without a scenario.
    fn stated_readings(&self, args: &Args) -> Result<Readings<'_>, CliError> {
        let noise = match (args.tracker, args.noise_um) {
            (Some(preset), _) => Noise::Instrument(preset.instrument()),
            (None, Some(um)) => Noise::Coordinate(1e-6 * um),
            (None, None) if self.before.is_some() => Noise::Found,
            (None, None) => {
                return Err(InputError::Place {
                    place: self.file.display().to_string(),
                    message: "the noise of the readings is not known: state it with --noise-um or --tracker".to_owned(),
                    help: Some("expected --tracker NAME, or --noise-um with the standard deviation of a coordinate; or --measurements, whose noise is found".to_owned()),
                }
                .into());
            }
        };
        let mut robot = nominal_robot(&self.robot.model, &self.options, &[]);
        robot.targets = self.stated.targets.iter().map(|own| own.in_flange).collect();
        robot.orientations = vec![None; robot.targets.len()];
        let identity = Transform::identity();
        robot.stations = self.stations(args).into_iter().map(|own| own.unwrap_or(identity)).collect();
        let set = MeasurementSet { observations: Vec::new(), ..self.stated.clone() };
        Ok(Readings::Stated { robot, set, noise })
    }
}

/// Radius of the links of a robot without known shapes, m: a short chain of thick links would touch itself everywhere.
fn usual_radius(model: &CalibrationModel) -> f64 {
    let first = model.kinematics.base_from_first.translation.vector;
    let reach = reachable_poses(model, REACH_POSES)
        .iter()
        .map(|joints| (stance_at(&model.kinematics, joints).1.translation.vector - first).norm())
        .fold(0.0, f64::max);
    (OF_REACH * reach).min(MOST_RADIUS)
}

/// Mean scatter of a session's readings per coordinate; as the estimate found it if they state none.
fn found_noise(set: &MeasurementSet, estimate: &Estimate) -> Noise {
    let stated: Vec<Matrix3<f64>> =
        set.observations.iter().filter_map(|own| own.reading.position_covariance()).collect();
    if stated.is_empty() || matches!(estimate.noise, NoiseScale::Residuals(_)) {
        return Noise::Found;
    }
    let mean = stated.iter().map(|own| own.trace() / 3.0).sum::<f64>() / stated.len() as f64;
    Noise::Coordinate(mean.sqrt())
}
