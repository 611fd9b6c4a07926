//! Whether a fit makes sense: whether the measurements can be of the nominal robot, and in words why not.

use std::fmt;

use super::diagnosis::{Names, mm};
use super::{CalibrateError, PipelineError, SetKind, SetOutcome};
use calibrig_estimation::diagnosis::{Finding, Hypothesis, Part};
use calibrig_estimation::identification::{IdentificationOptions, Loss, Mode};
use calibrig_estimation::plausibility::{BeyondLimits, Plausibility, beyond_limits, plausibility_with};
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::{CalibrationModel, CraigLink, JointKind};

const ANYWAY: &str = "--fit-anyway goes on, and ends with exit code 3";
/// Rows that are named by their place.
const NAMED: usize = 8;
/// Other explanations that are given besides the first.
const OTHERS: usize = 2;

/// A set that the nominal robot does not fit.
#[derive(Debug, Clone, PartialEq)]
pub struct Implausible {
    /// Which.
    pub kind: SetKind,
    /// Why.
    pub found: Plausibility,
    links: Vec<CraigLink>,
    names: Names,
}

/// Refuses the first of the sets that the nominal robot does not fit. While reasons are searched, `progress` receives how much of how much is
/// done.
///
/// # Errors
///
/// [`PipelineError::Implausible`]; [`CalibrateError::Identify`] if model and set do not belong together.
pub fn check_plausible(
    model: &CalibrationModel,
    sets: &[SetOutcome],
    options: &IdentificationOptions,
    mut progress: impl FnMut(u64, u64),
) -> Result<(), PipelineError> {
    let robust = options.solver.loss != Loss::Squared;
    for SetOutcome { kind, measurements: set, .. } in sets {
        if *kind != SetKind::Identification && set.observations.is_empty() {
            continue;
        }
        let found = plausibility_with(model, set, &mut progress)
            .map_err(|source| CalibrateError::Identify { mode: Mode::WithoutCalibration, source })?;
        // Held-out readings move no fit: their gross errors are reported with the fit.
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
    format!("joint {}: the commands take it to {reached}, but its limits are {limits}", link.name)
}

impl Implausible {
    fn new(kind: SetKind, found: Plausibility, model: &CalibrationModel, set: &MeasurementSet) -> Self {
        Self { kind, found, links: model.kinematics.links.clone(), names: Names::new(model, set) }
    }

    /// Indices of the observations that it names, in the set.
    #[must_use]
    pub fn named(&self) -> Vec<usize> {
        if !self.found.unreachable.is_empty() {
            return self.found.unreachable.iter().take(NAMED).map(|far| far.observation).collect();
        }
        let mut named: Vec<usize> =
            self.found.explanation().unwrap_or_default().iter().flat_map(Part::rows).collect();
        named.sort_unstable();
        named.dedup();
        named.truncate(NAMED);
        named
    }

    /// What to look at, and how to go on nevertheless.
    pub fn help(&self) -> String {
        let found = &self.found;
        let mut help: Vec<String> = Vec::new();
        if !found.unreachable.is_empty() {
            help.push(
                "a code for missed shots? Name it (`--missed CODE`, or `missed` in [position] of the column map): no loss can \
                 handle such a point"
                    .to_owned()
                    + &found.rms.map_or_else(String::new, |rms| {
                        format!(" (without them the nominal robot leaves an RMS of {})", mm(rms))
                    }),
            );
        }
        let before = found.rms.map_or_else(String::new, |rms| format!(" instead of {}", mm(rms)));
        if let Some(diagnosis) = found.diagnosis.as_ref().filter(|d| d.finding() == Finding::Explained) {
            let told = |hypothesis: &Hypothesis| {
                let (says, rms) = (self.names.says(hypothesis), mm(hypothesis.rms));
                format!("{says}: RMS {rms}{before}. Remedy: {}", self.names.remedies(hypothesis))
            };
            let first = diagnosis.hypotheses.first();
            // Rows out of reach are reported already.
            let is_new =
                |hypothesis: &&Hypothesis| found.unreachable.is_empty() || hypothesis.parts.len() > 1;
            help.extend(first.filter(is_new).map(told));
            help.extend(Names::as_good(diagnosis).take(OTHERS).map(|other| format!("or {}", told(other))));
        } else if help.is_empty() {
            help.push(
                "check the order, units and signs of the joints' columns and their home offsets, the axes and the unit of the \
                 tracker, exchanged rows, and codes of missed shots; `calibrig diagnose` lists what was tried"
                    .to_owned(),
            );
        }
        help.extend(found.beyond_limits.iter().map(|beyond| beyond_words(beyond, &self.links)));
        help.push(ANYWAY.to_owned());
        help.join("; ")
    }
}

impl fmt::Display for Implausible {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let found = &self.found;
        if self.kind != SetKind::Identification {
            write!(f, "{} set: ", self.kind.key())?;
        }
        if !found.unreachable.is_empty() {
            let which = self.names.far(&found.unreachable);
            return write!(
                f,
                "no point that the robot could reach, by the distance from the middle of the others: {which}"
            );
        }
        let rms = found.rms.unwrap_or_default();
        write!(
            f,
            "the nominal robot does not fit the points: with tracker and target fitted, it leaves an RMS of {}, {:.0} % of \
             their spread ({})",
            mm(rms),
            1e2 * found.share.unwrap_or_default(),
            mm(found.spread)
        )
    }
}
