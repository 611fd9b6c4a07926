//! Which poses to measure with a robot in front of its trackers: reachable and visible candidates, the most informative of them, in an order to drive
//! them, and the predicted accuracy in the working region. Uses the nominal robot, or the one that an earlier session found.

mod candidates;
mod error;
mod filter;
mod outcome;
mod readings;

pub use candidates::{CandidateSource, Region, whole_space};
pub use error::PosePlanError;
pub use filter::{Candidate, Filter, Refused, Stand, Surroundings};
pub use outcome::{AsDrawn, ChosenPose, Figure, OrderChange, PosePlan, plan_csv};
pub use readings::{Noise, Readings};

use std::collections::BTreeSet;

use crate::scenario::Scenario;
use calibrig_estimation::identification::{
    CalibratedRobot, DEFAULT_TOLERANCE, Estimate, IdentificationOptions,
};
use calibrig_estimation::planning::{
    Accuracy, Choice, Criterion, Design, DesignSpace, Growth, Needed, OrderWeights, Over, ParameterScale,
    PlanError, PlannedSession, Spread, Way, choose, grow, order_cost, ordered,
};
use calibrig_model::geometry::Transform;
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::nalgebra::Vector3;
use calibrig_model::visibility::{Obstacles, Reflector, TrackerReach};
use calibrig_model::{CalibrationModel, JointKind, PoseQuery};
use calibrig_plant::session::StationShare;
use calibrig_plant::tracker::{Instrument, LaserTracker, Limits, Preset};
use candidates::drawn_in;

/// A robot, its surroundings and its readings.
#[derive(Debug, Clone)]
pub struct Cell<'a> {
    /// Its name for people.
    pub name: String,
    /// The nominal robot.
    pub model: &'a CalibrationModel,
    /// How the measurements will be identified.
    pub options: IdentificationOptions,
    /// Its surroundings.
    pub around: Surroundings,
    /// The planned readings.
    pub readings: Readings<'a>,
    /// Its working region.
    pub region: Region,
    /// Earlier measurements, and their results.
    pub before: Option<(MeasurementSet, Estimate)>,
}

/// Settings of a plan.
#[derive(Debug, Clone, PartialEq)]
pub struct Request {
    /// Number of poses to choose; without, as many as the accuracy needs.
    pub poses: Option<usize>,
    /// Accuracy to reach, m.
    pub accuracy: Option<f64>,
    /// Which figure of the standard deviations over the region.
    pub figure: Figure,
    /// The criterion.
    pub criterion: Criterion,
    /// Number of measurable candidates.
    pub candidates: usize,
    /// Their source.
    pub source: CandidateSource,
    /// Random starts, in addition to the greedy one.
    pub starts: u32,
    /// Seed of these, of drawn robots and of random poses.
    pub seed: u64,
    /// Robots drawn within their tolerances, in addition to the nominal one.
    pub robots: u32,
    /// How these count.
    pub over: Over,
    /// Whether a pose may be measured more than once.
    pub repeats: bool,
    /// Most poses of the curve if an accuracy is asked for.
    pub most: usize,
    /// Speeds of the joints, m/s and rad/s; empty for [`usual_speeds`].
    pub speeds: Vec<f64>,
    /// Further criteria of the order, besides the driving time.
    pub weights: OrderWeights,
}

/// Default number of candidates: more of them improve a plan by a few per cent.
pub const CANDIDATES: usize = 2000;
/// Its least value.
const LEAST_CANDIDATES: usize = 500;
/// Default number of poses of the curve.
pub const MOST_POSES: usize = 200;
/// Number of poses that represent the region.
const OF_REGION: usize = 200;
/// Draws of random poses with which a plan is compared.
const DRAWS: u32 = 20;
/// Most poses tried per measurable candidate.
const MOST_LOOKED: usize = 50;
/// Poses that show which contacts are due to the robot's description.
const SURVEYED: usize = 500;
/// m/s and rad/s: the speed of a robot driven from pose to pose with people near its reach.
const SPEEDS: [f64; 2] = [0.25, 0.25];

impl Default for Request {
    fn default() -> Self {
        Self {
            poses: None,
            accuracy: None,
            figure: Figure::Rms,
            criterion: Criterion::I,
            candidates: CANDIDATES,
            source: CandidateSource::WholeSpace,
            starts: 1,
            seed: 1,
            robots: 0,
            over: Over::Mean,
            repeats: false,
            most: MOST_POSES,
            speeds: Vec::new(),
            // A joint that is always approached from one side costs a minute of driving, a drift that the parameters take up as a whole ten minutes.
            weights: OrderWeights { balance: 60.0, drift: 600.0 },
        }
    }
}

/// Default number of candidates: fewer if a pose has many readings, because the search time grows with their square.
pub fn usual_candidates(cell: &Cell<'_>) -> usize {
    let stations = match &cell.readings {
        Readings::Stated { set, .. } => set.stations.len(),
        Readings::Scenario(scenario) if scenario.plan.share == StationShare::All => {
            1 + scenario.plan.stations.len()
        }
        Readings::Scenario(_) => 1,
    };
    let readings = (stations * cell.around.reflectors.len()).max(1);
    (CANDIDATES / readings).max(LEAST_CANDIDATES)
}

/// Speeds of the joints of a robot that is driven from pose to pose, m/s and rad/s.
pub fn usual_speeds(model: &CalibrationModel) -> Vec<f64> {
    let speed = |kind| SPEEDS[usize::from(kind == JointKind::Revolute)];
    model.kinematics.links.iter().map(|link| speed(link.kind)).collect()
}

/// A step of planning, for progress.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Step {
    /// What is done, in words.
    pub name: &'static str,
    /// Which one, from 1.
    pub number: usize,
}

/// Steps of a plan.
pub const STEPS: usize = 6;

/// Plans poses.
///
/// # Errors
///
/// [`PosePlanError`].
pub fn plan(
    cell: &Cell<'_>,
    request: &Request,
    progress: &mut dyn FnMut(Step),
) -> Result<PosePlan, PosePlanError> {
    let mut number = 0;
    let mut tell = |name| {
        number += 1;
        progress(Step { name, number });
    };
    let (sides, joints) = (cell.region.ranges(cell.model).len(), cell.model.kinematics.joint_count());
    if sides != joints {
        return Err(PosePlanError::Region { sides, joints });
    }
    tell("looking for candidates");
    let robot = cell.robot();
    let found = candidates::find(cell, &robot, request)?;
    let region = candidates::region(cell, &robot, OF_REGION)?;
    let wanted = request.poses.unwrap_or(1);
    if wanted == 0 {
        return Err(PlanError::NoPoses.into());
    }
    if found.kept.len() < wanted && (!request.repeats || found.kept.is_empty()) {
        let refused = found.refused_words();
        return Err(PosePlanError::TooFew { kept: found.kept.len(), drawn: found.looked, wanted, refused });
    }
    tell("predicting their information");
    let count = request.poses.unwrap_or(request.most.min(60));
    let commands: Vec<Vec<f64>> =
        region.iter().map(|own| cell.model.actuators.command_from_joints(&own.joints)).collect();
    let queries: Vec<PoseQuery<'_>> = commands.iter().map(PoseQuery::from).collect();
    let (set, measured) = cell.set_of(&found.kept, count)?;
    let first = cell.first_pose();
    let estimate = cell.before.as_ref().map(|(_, estimate)| estimate);
    let mut session = PlannedSession::new(cell.model, &set, &cell.options, estimate, &measured, &queries)?;
    let tolerance = cell.options.tolerance.unwrap_or(DEFAULT_TOLERANCE);
    let spaces =
        session.spaces_of_robots(request.robots, tolerance, request.seed, &ParameterScale::Effect)?;
    let choice = Choice {
        count,
        criterion: request.criterion,
        repeats: request.repeats,
        starts: request.starts,
        seed: request.seed,
        over: request.over,
    };
    let chosen = request.poses.map(|_| {
        tell("choosing");
        choose(&spaces, &choice)
    });
    let chosen = chosen.transpose()?;
    tell("trying other numbers of poses");
    let growth = growth(&spaces, &choice, request)?;
    let needed = match request.accuracy {
        Some(accuracy) => Some(growth.needed(accuracy, |spread| request.figure.of(spread))?),
        None => None,
    };
    let design: Design = match chosen {
        Some(design) => design,
        None => {
            tell("choosing");
            choose(&spaces, &Choice { count: enough(request, needed)?, ..choice })?
        }
    };
    tell("comparing with random poses");
    let random = as_drawn(cell, &robot, request, &queries, design.chosen.len());
    let (random, not_compared) = match random {
        Ok(random) => (random, None),
        Err(why) => (Vec::new(), Some(format!("the plan is not compared with random poses: {why}"))),
    };
    tell("ordering the poses");
    let (order, approaches, change) =
        in_order(cell, request, &session, &spaces[0], &design, (&found.kept, first))?;
    let place = |candidate: &usize| session.candidates()[*candidate].saturating_sub(first) as usize;
    let numbers = readings::numbers(cell.next_number(), order.len())?;
    let numbered = order.iter().zip(approaches).zip(numbers);
    let poses = numbered
        .map(|((index, approach), pose)| {
            let own = &found.kept[place(&design.chosen[*index])];
            let command = cell.model.actuators.command_from_joints(&own.joints);
            ChosenPose { pose, joints: own.joints.clone(), command, approach, target: own.target }
        })
        .collect();
    let measured = measured.len();
    let found = Planned { found, region, design, growth, needed, random, poses, order: change, measured };
    let mut plan = told(cell, request, &spaces[0], found);
    plan.remarks.extend(not_compared);
    Ok(plan)
}

/// Result of a search.
struct Planned {
    found: candidates::Found,
    region: Vec<Candidate>,
    design: Design,
    growth: Growth,
    needed: Option<Needed>,
    random: Vec<AsDrawn>,
    poses: Vec<ChosenPose>,
    order: OrderChange,
    measured: usize,
}

fn told(cell: &Cell<'_>, request: &Request, space: &DesignSpace, planned: Planned) -> PosePlan {
    let Planned { found, region, design, growth, needed, random, poses, order, measured } = planned;
    let links = &cell.model.kinematics.links;
    PosePlan {
        name: cell.name.clone(),
        mode: cell.options.mode,
        criterion: request.criterion,
        figure: request.figure,
        seed: request.seed,
        robots: request.robots,
        source: request.source.words().to_owned(),
        looked: found.looked,
        candidates: space.candidates(),
        refused: found.refused_words(),
        places: found.kept.iter().map(|own| own.target).collect(),
        parameters: space.parameters().to_vec(),
        scale: space.scale().to_vec(),
        remarks: remarks(cell, request, &found, space, design.chosen.len()),
        poses,
        figures: design.figures,
        value: design.value,
        settled: design.settled,
        random,
        growth,
        accuracy: request.accuracy,
        needed,
        order,
        measured,
        region: cell.region.name().to_owned(),
        region_places: region.iter().map(|own| own.target).collect(),
        region_ranges: cell.region.ranges(cell.model),
        trackers: cell
            .around
            .trackers
            .iter()
            .map(|stand| stand.base_from_tracker.translation.vector)
            .collect(),
        links: links.iter().map(|link| (link.name.clone(), link.kind, link.limits)).collect(),
        commanded: (0..links.len()).map(|joint| cell.model.actuators.is_commanded(joint)).collect(),
    }
}

impl Cell<'_> {
    /// The robot in use.
    fn robot(&self) -> CalibratedRobot {
        match &self.before {
            Some((_, estimate)) => estimate.robot.clone(),
            None => nominal_robot(self.model, &self.options, &self.around.reflectors),
        }
    }

    /// Candidates as they are measured, together with earlier measurements; and the numbers of the latter.
    fn set_of(&self, poses: &[Candidate], count: usize) -> Result<(MeasurementSet, Vec<u32>), PosePlanError> {
        let mut set = readings::read(&self.readings, poses, count, self.first_pose())?;
        let Some((before, _)) = &self.before else { return Ok((set, Vec::new())) };
        let numbers: BTreeSet<u32> = before.observations.iter().map(|own| own.pose).collect();
        let candidates = std::mem::take(&mut set.observations);
        let mut all = before.clone();
        all.observations.extend(candidates);
        Ok((all, numbers.into_iter().collect()))
    }

    /// Number of the first candidate among the poses.
    fn first_pose(&self) -> u32 {
        let measured = self.before.iter().flat_map(|(set, _)| &set.observations);
        measured.map(|own| own.pose.saturating_add(1)).max().unwrap_or(0)
    }

    /// Number of the first pose of the plan: poses count from 1, or continue.
    fn next_number(&self) -> u32 {
        self.first_pose().max(1)
    }
}

/// The nominal robot as a mode believes it to be, with its targets.
pub fn nominal_robot(
    model: &CalibrationModel,
    options: &IdentificationOptions,
    reflectors: &[Reflector],
) -> CalibratedRobot {
    CalibratedRobot {
        mode: options.mode,
        nominal: model.clone(),
        model: model.clone(),
        terms: Vec::new(),
        stations: vec![Transform::identity()],
        targets: reflectors.iter().map(|own| own.in_flange).collect(),
        instruments: Vec::new(),
        orientations: vec![None; reflectors.len()],
    }
}

/// How many poses an accuracy needs.
fn enough(request: &Request, needed: Option<Needed>) -> Result<usize, PosePlanError> {
    match needed {
        Some(Needed::Poses { count, .. }) => Ok(count),
        Some(other) => {
            let accuracy = request.accuracy.unwrap_or_default();
            Err(PosePlanError::OutOfReach { accuracy, why: outcome::needed_words(&other) })
        }
        None => Err(PlanError::NoPoses.into()),
    }
}

/// The curve of accuracy against number.
fn growth(spaces: &[DesignSpace], choice: &Choice, request: &Request) -> Result<Growth, PosePlanError> {
    let most = match request.poses {
        Some(poses) if request.accuracy.is_none() => 2 * poses,
        Some(poses) => request.most.max(2 * poses),
        None => request.most,
    };
    let most = if choice.repeats { most } else { most.min(spaces[0].candidates()) };
    // Fewer poses than one coordinate per parameter rely on priors, and would hide the knee.
    let least = spaces[0].parameters().len().div_ceil(spaces[0].most_rows().max(1));
    let least = least.min(request.poses.unwrap_or(most)).min(most);
    let ladder =
        [4, 6, 8, 10, 12, 15, 20, 25, 30, 35, 40, 50, 60, 80, 100, 120, 150, 200, 300, 400, 500, 1000];
    let own = request.poses.into_iter().chain([most]);
    let counts: BTreeSet<usize> =
        ladder.into_iter().chain(own).filter(|count| (least..=most).contains(count)).collect();
    let mut counts: Vec<usize> = counts.into_iter().collect();
    loop {
        let least = match grow(spaces, choice, &counts) {
            Err(PlanError::TooFewPoses { least, .. }) => least,
            // A few poses may have enough rows that are all alike.
            Err(PlanError::Singular { .. }) if counts.len() > 1 => counts[0] + 1,
            other => return Ok(other?),
        };
        let last = counts.len();
        counts.retain(|count| *count >= least);
        if counts.is_empty() || counts.len() == last {
            return Ok(grow(spaces, choice, &[least])?);
        }
    }
}

/// What as many and twice as many random poses of the region would determine; else why that is unknown, in words.
fn as_drawn(
    cell: &Cell<'_>,
    robot: &CalibratedRobot,
    request: &Request,
    queries: &[PoseQuery<'_>],
    count: usize,
) -> Result<Vec<AsDrawn>, String> {
    let mut all: Vec<Candidate> = Vec::new();
    for trial in 0..DRAWS {
        let drawn = drawn_in(cell, robot, 2 * count, request.seed, trial).map_err(|why| why.to_string())?;
        all.extend(drawn.ok_or("hardly any pose drawn in the region can be measured")?);
    }
    let space = || -> Result<_, PosePlanError> {
        let (set, measured) = cell.set_of(&all, count)?;
        let estimate = cell.before.as_ref().map(|(_, estimate)| estimate);
        let mut session = PlannedSession::new(cell.model, &set, &cell.options, estimate, &measured, queries)?;
        Ok((session.space(&ParameterScale::Effect)?, session.candidates().to_vec()))
    };
    let (space, numbers) = space().map_err(|why| why.to_string())?;
    let first = cell.first_pose();
    let place: std::collections::BTreeMap<u32, usize> =
        numbers.iter().enumerate().map(|(place, number)| (number.saturating_sub(first), place)).collect();
    let of = |number: usize| {
        let one = |trial: u32| {
            let from = trial as usize * 2 * count;
            let own =
                (from..from + number).filter_map(|index| place.get(&u32::try_from(index).ok()?).copied());
            space.figures(&own.collect::<Vec<_>>()).ok()?.accuracy
        };
        let all: Vec<_> = (0..DRAWS).filter_map(one).collect();
        let sorted = |spread: fn(&Accuracy) -> &Spread| {
            let mut values: Vec<f64> = all.iter().map(|own| request.figure.of(spread(own))).collect();
            values.sort_by(f64::total_cmp);
            values
        };
        let values = sorted(|own| &own.with_machine);
        let of_parameters = sorted(|own| &own.of_parameters);
        AsDrawn { poses: number, draws: DRAWS, values, of_parameters }
    };
    let told: Vec<_> = [count, 2 * count].map(of).into_iter().filter(|own| !own.values.is_empty()).collect();
    if told.is_empty() { Err("none of the draws determines all parameters".to_owned()) } else { Ok(told) }
}

type InOrder = (Vec<usize>, Vec<Vec<i8>>, OrderChange);

fn in_order(
    cell: &Cell<'_>,
    request: &Request,
    session: &PlannedSession<'_>,
    space: &DesignSpace,
    design: &Design,
    (poses, first): (&[Candidate], u32),
) -> Result<InOrder, PosePlanError> {
    let own =
        |candidate: &usize| &poses[session.candidates()[*candidate].saturating_sub(first) as usize].joints;
    let commands: Vec<Vec<f64>> = design
        .chosen
        .iter()
        .map(|candidate| cell.model.actuators.command_from_joints(own(candidate)))
        .collect();
    let speeds = if request.speeds.is_empty() { usual_speeds(cell.model) } else { request.speeds.clone() };
    let drift = session.drift_coupling(space, &design.chosen).ok();
    let way = Way {
        commands: &commands,
        home: None,
        speeds: &speeds,
        drift: drift.as_ref(),
        weights: request.weights,
    };
    let before = order_cost(&way, &(0..commands.len()).collect::<Vec<_>>())?;
    let found = ordered(&way)?;
    Ok((found.order, found.approaches, OrderChange { before, after: found.cost }))
}

fn remarks(
    cell: &Cell<'_>,
    request: &Request,
    found: &candidates::Found,
    space: &DesignSpace,
    count: usize,
) -> Vec<String> {
    let mut remarks = Vec::new();
    if matches!(request.source, CandidateSource::WholeSpace) && cell.region.is_part() {
        remarks.push(
            "candidates come from the whole joint space, which is most informative if the model holds everywhere; errors of \
             the machine outside its model can make poses outside the region do more harm than good (--candidates-in-region)"
                .to_owned(),
        );
    }
    let (rows, parameters) = (count * space.most_rows(), space.parameters().len());
    if rows < parameters && cell.before.is_none() {
        remarks.push(format!(
            "{count} poses have {rows} coordinates for {parameters} parameters: priors have to determine the rest"
        ));
    }
    if found.kept.len() < request.candidates && request.source.is_drawn() {
        remarks.push(format!(
            "{} candidates can be measured of {} that were tried: fewer than the {} asked for",
            found.kept.len(),
            found.looked,
            request.candidates
        ));
    }
    if cell.around.trackers.is_empty() {
        remarks.push(
            "the tracker's place is unknown: every pose is taken as visible (--tracker-mm states the place)"
                .to_owned(),
        );
    } else if cell.around.hides.is_none() {
        remarks.push("lines of sight are taken as free, and reflectors as turned to the tracker".to_owned());
    }
    if !cell.around.obstacles.has_links() {
        remarks.push("the shapes of the links are unknown: they touch nothing and hide nothing".to_owned());
    } else if cell.around.obstacles.is_chain() {
        remarks.push(
            "the links are taken as capsules along the chain, because their shapes are unknown".to_owned(),
        );
    }
    if cell.around.obstacles.floor().is_none() {
        remarks.push("no floor is stated: poses may be below it; state it in the scenario, or by --floor-mm for a robot without one".to_owned());
    }
    if let Readings::Scenario(scenario) = &cell.readings
        && !scenario.plan.payloads.payloads.is_empty()
    {
        remarks.push(
            "candidates carry the scenario's payloads in turn; in the session they follow its own order of payloads".to_owned(),
        );
    }
    remarks
}

/// The surroundings stated in a scenario, for its nominal robot.
pub fn surroundings_of(scenario: &Scenario, clearance: f64, angle: f64) -> Surroundings {
    let robot = &scenario.robot;
    let kinematics = &robot.model.kinematics;
    let sight = scenario.plan.sight.as_ref();
    let own = || {
        let shapes = Obstacles::of_shapes(kinematics, &robot.visuals, 0.0);
        if shapes.has_links() { shapes } else { Obstacles::none(kinematics) }
    };
    let acceptance = sight.map_or(std::f64::consts::PI, |sight| sight.acceptance);
    let target = robot.target().unwrap_or(scenario.as_built.target);
    let targets = std::iter::once((target, scenario.plan.opening));
    let targets = targets.chain(scenario.plan.targets.iter().map(|own| (own.in_flange, own.opening)));
    let limits = scenario.tracker.instrument.limits;
    let reach = TrackerReach { range: limits.range, elevation: limits.elevation, azimuth: limits.azimuth };
    let stations = std::iter::once(scenario.tracker.tracker_from_base)
        .chain(scenario.plan.stations.iter().map(|station| station.tracker_from_base));
    Surroundings {
        obstacles: sight.map_or_else(own, |sight| sight.obstacles.clone()),
        trackers: stations.map(|own| Stand { base_from_tracker: own.inverse(), reach }).collect(),
        reflectors: targets
            .map(|(in_flange, opening)| Reflector { in_flange, opening, acceptance })
            .collect(),
        hides: sight.map(|sight| sight.obstacles.clone()),
        clearance,
        angle,
    }
}

/// A cell of a scenario.
pub fn cell_of(scenario: &Scenario, options: IdentificationOptions, clearance: f64, angle: f64) -> Cell<'_> {
    Cell {
        name: scenario.name.clone(),
        model: &scenario.robot.model,
        options,
        around: surroundings_of(scenario, clearance, angle),
        readings: Readings::Scenario(scenario),
        region: Region::of_box(&scenario.region, "the scenario's [poses.region]"),
        before: None,
    }
}

/// A levelled tracker at a place of the base frame (m), whose head turns all round.
pub fn levelled(instrument: Option<Instrument>, place: Vector3<f64>, up: &Vector3<f64>) -> Stand {
    let instrument = instrument.unwrap_or_else(|| Preset::At500.instrument());
    let tracker = LaserTracker::levelled(instrument, place, 0.0, up);
    let Limits { range, elevation, .. } = instrument.limits;
    let azimuth = TrackerReach::all_round(range).azimuth;
    Stand {
        base_from_tracker: tracker.tracker_from_base.inverse(),
        reach: TrackerReach { range, elevation, azimuth },
    }
}
