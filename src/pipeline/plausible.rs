//! Whether there is any use in fitting: whether the measurements can be of the nominal robot, and in words why not.

use std::fmt;

use super::{PipelineError, SetKind, SetOutcome};
use calibrig_estimation::identification::{IdentificationOptions, Loss, Mode};
use calibrig_estimation::plausibility::{
    BeyondLimits, Convention, Explanation, FarOff, FewRows, Plausibility, beyond_limits, plausibility,
};
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::{CalibrationModel, CraigLink, JointKind};

/// Rows that are listed by name; more are counted.
const LISTED: usize = 8;
const ANYWAY: &str = "--fit-anyway goes on, and ends with exit code 3";

/// A set that the nominal robot does not lie on.
#[derive(Debug, Clone, PartialEq)]
pub struct Implausible {
    /// Which.
    pub kind: SetKind,
    /// Why.
    pub found: Plausibility,
    links: Vec<CraigLink>,
    /// What observations are called: rows where they are numbered through, else poses.
    called: &'static str,
    /// Number of every observation's pose.
    poses: Vec<u32>,
    targets: Vec<String>,
    /// Largest span of a revolute joint's commands, rad.
    span: f64,
}

/// Refuses the first of the sets that the nominal robot does not lie on.
///
/// # Errors
///
/// [`PipelineError::Implausible`]; [`PipelineError::Identify`] where model and set do not belong together.
pub fn check_plausible(
    model: &CalibrationModel,
    sets: &[SetOutcome],
    options: &IdentificationOptions,
) -> Result<(), PipelineError> {
    let robust = options.solver.loss != Loss::Squared;
    for SetOutcome { kind, measurements: set, .. } in sets {
        if *kind != SetKind::Identification && set.observations.is_empty() {
            continue;
        }
        let found = plausibility(model, set)
            .map_err(|source| PipelineError::Identify { mode: Mode::WithoutCalibration, source })?;
        // What is held out moves no fit: of it, gross errors are told with the fit.
        let is_fitted = *kind == SetKind::Identification;
        if !found.is_plausible(robust || !is_fitted) {
            return Err(PipelineError::Implausible(Box::new(Implausible::new(*kind, found, model, set))));
        }
    }
    Ok(())
}

/// Commands beyond the limits that the robot's file states, in words.
pub fn commands_beyond_limits(model: &CalibrationModel, set: &MeasurementSet) -> Vec<String> {
    let links = &model.kinematics.links;
    beyond_limits(model, set).iter().map(|beyond| beyond_words(beyond, links)).collect()
}

fn beyond_words(beyond: &BeyondLimits, links: &[CraigLink]) -> String {
    let link = &links[beyond.joint];
    let (unit, factor) = match link.kind {
        JointKind::Revolute => ("deg", 1.0_f64.to_degrees()),
        JointKind::Prismatic => ("mm", 1e3),
    };
    let range = |[low, high]: [f64; 2]| format!("{:.0} to {:.0} {unit}", factor * low, factor * high);
    let (reached, limits) = (range(beyond.reached), range(beyond.limits));
    format!("joint {}: the commands take it to {reached}, its limits are {limits}", link.name)
}

impl Implausible {
    fn new(kind: SetKind, found: Plausibility, model: &CalibrationModel, set: &MeasurementSet) -> Self {
        let observations = &set.observations;
        let are_rows = observations.iter().zip(1..).all(|(observation, row)| observation.pose == row);
        let links = model.kinematics.links.clone();
        let span = |(joint, _): (usize, &CraigLink)| {
            let commands = observations.iter().filter_map(|o| o.command.get(joint));
            let ends = commands.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (v.min(l), v.max(h)));
            ends.1 - ends.0
        };
        let revolute = links.iter().enumerate().filter(|(_, link)| link.kind == JointKind::Revolute);
        Self {
            kind,
            span: revolute.map(span).fold(0.0, f64::max),
            called: if are_rows { "row" } else { "pose" },
            poses: observations.iter().map(|observation| observation.pose).collect(),
            targets: set.targets.iter().map(|target| target.name.clone()).collect(),
            found,
            links,
        }
    }

    /// Indices of the observations that it names, in the set.
    #[must_use]
    pub fn named(&self) -> Vec<usize> {
        let found = &self.found;
        if !found.unreachable.is_empty() {
            return found.unreachable.iter().take(LISTED).map(|far| far.observation).collect();
        }
        let Some(few) = &found.few_rows else { return Vec::new() };
        let pairs = few.exchanged.iter().flat_map(|(a, b)| [*a, *b]);
        let mut named: Vec<_> = pairs.chain(few.rows.iter().map(|far| far.observation)).collect();
        named.sort_unstable();
        named.dedup();
        named.truncate(LISTED);
        named
    }

    /// What to look at, and how to go on in spite of it.
    pub fn help(&self) -> String {
        let found = &self.found;
        let mut help: Vec<String> = Vec::new();
        let before = found.rms.map_or_else(String::new, |rms| format!(" instead of {}", mm(rms)));
        if !found.unreachable.is_empty() {
            help.push(
                "a code of shots that were missed? Name it (`--missed CODE`, or `missed` in [position] of the column map): no loss can weigh such a point"
                    .to_owned()
                    + &found.rms.map_or_else(String::new, |rms| {
                        format!(" (without them the nominal robot leaves an RMS of {})", mm(rms))
                    }),
            );
        }
        if let Some(few) = &found.few_rows {
            help.push(self.few_in_words(few, &before));
        }
        let mut explanations = found.explanations.iter().map(|e| self.explained(e, &before));
        help.extend(explanations.next());
        help.extend(explanations.map(|words| format!("or {words}")));
        if help.is_empty() {
            help.push(
                "check the order, units and signs of the joints' columns and their home offsets, the axes and the unit of the \
                 tracker, exchanged rows, and codes of missed shots"
                    .to_owned(),
            );
        }
        help.extend(found.beyond_limits.iter().map(|beyond| beyond_words(beyond, &self.links)));
        help.push(ANYWAY.to_owned());
        help.join("; ")
    }

    fn few_in_words(&self, few: &FewRows, before: &str) -> String {
        let mut words = Vec::new();
        let is_exchanged =
            |far: &&FarOff| few.exchanged.iter().any(|(a, b)| [a, b].contains(&&far.observation));
        for (a, b) in few.exchanged.iter().take(LISTED) {
            let (called, a, b) = (self.called, self.poses[*a], self.poses[*b]);
            words.push(format!("{called}s {a} and {b} have each other's points: they are exchanged"));
        }
        let others: Vec<FarOff> = few.rows.iter().filter(|far| !is_exchanged(far)).copied().collect();
        if !others.is_empty() {
            words.push(format!("{} off", self.listed(&others)));
        }
        format!("{}; without them the RMS is {}{before}", words.join("; "), mm(few.rms_without))
    }

    /// Rows with their distances.
    fn listed(&self, rows: &[FarOff]) -> String {
        let words =
            |far: &FarOff| format!("{} {} by {}", self.called, self.poses[far.observation], mm(far.distance));
        let mut list: Vec<_> = rows.iter().take(LISTED).map(words).collect();
        if rows.len() > LISTED {
            list.push(format!("{} more", rows.len() - LISTED));
        }
        list.join(", ")
    }

    fn explained(&self, explanation: &Explanation, before: &str) -> String {
        let joint = |joint: usize| &self.links[joint].name;
        let rms = mm(explanation.rms);
        match explanation.convention {
            Convention::RadiansAsDegrees => format!(
                "the joints' angles span {:.1} deg at most: read as radians, they leave an RMS of {rms}{before}. Say so in the column map \
                 (`revolute_unit = \"rad\"`) or in the columns' names (`_rad`)",
                self.span.to_degrees()
            ),
            Convention::DegreesAsRadians => format!(
                "the joints' angles span up to {:.1} rad: read as degrees, they leave an RMS of {rms}{before}. Say so in the column map \
                 (`revolute_unit = \"deg\"`) or in the columns' names (`_deg`)",
                self.span
            ),
            Convention::PointsScaled { factor } => format!(
                "the points times {factor:.4}: RMS {rms}{before}. The unit of the position is another one than the columns say"
            ),
            Convention::TravelScaled { factor } => format!(
                "the prismatic joints' columns times {factor:.4}: RMS {rms}{before}. Their unit is another one than the columns say"
            ),
            Convention::Mirrored => format!(
                "the points are a mirror image: x and y exchanged fits, RMS {rms}{before}. Exchange the two columns, or turn the sign of \
                 one axis"
            ),
            Convention::ShiftedRows { by } => format!(
                "the points stand {} than their joints: moved back, RMS {rms}{before}",
                if by > 0 { "one row lower" } else { "one row higher" }
            ),
            Convention::HomeOffset { joint: at, angle } => format!(
                "{name} {sign} {:.0} deg: RMS {rms}{before}. The zero of {name} is elsewhere: {change} `theta_deg` of {name} in the robot's \
                 file by it",
                angle.abs().to_degrees(),
                name = joint(at),
                sign = if angle < 0.0 { '-' } else { '+' },
                change = if angle < 0.0 { "lower" } else { "raise" },
            ),
            Convention::Sign { joint: at } => {
                format!("{} with the other sign: RMS {rms}{before}. It moves the other way", joint(at))
            }
            Convention::Columns { joint: at, other } => {
                format!("the columns of {} and {} exchanged: RMS {rms}{before}", joint(at), joint(other))
            }
            Convention::SeveralTargets { target, count } => format!(
                "the points of {} are those of {count} targets at different offsets: told apart they leave an RMS of {rms}{before}. \
                 Name them in a column (`target`)",
                named("target", &self.targets[target])
            ),
            _ => format!("read otherwise: RMS {rms}{before}"),
        }
    }
}

impl fmt::Display for Implausible {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let found = &self.found;
        if self.kind != SetKind::Identification {
            write!(f, "{} set: ", self.kind.key())?;
        }
        if !found.unreachable.is_empty() {
            let which = self.listed(&found.unreachable);
            return write!(
                f,
                "no point that the robot could reach, by the distance from the middle of the others: {which}"
            );
        }
        let rms = found.rms.unwrap_or_default();
        write!(
            f,
            "the nominal robot does not lie on the points: with tracker and target fitted, it leaves an RMS of {}, {:.0} % of their \
             spread ({})",
            mm(rms),
            1e2 * found.share.unwrap_or_default(),
            mm(found.spread)
        )
    }
}

/// A name that need not say what it is the name of.
fn named(what: &str, name: &str) -> String {
    if name.starts_with(what) { name.to_owned() } else { format!("{what} {name}") }
}

fn mm(metres: f64) -> String {
    let value = 1e3 * metres;
    let digits = if value < 10.0 { 3 } else { 0 };
    format!("{value:.digits$} mm")
}
