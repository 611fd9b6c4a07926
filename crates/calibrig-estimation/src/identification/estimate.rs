//! What an identification returns.

use std::fmt;

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::limits::shown;
use super::{
    CONTRADICTION_LEVEL, CalibratedRobot, Contradiction, DependentGroup, MachineNoise, ParameterBound,
    Spectrum, Stated, Tolerance, UNKNOWN_STIFFNESS,
};
use calibrig_model::statistics::{normal_quantile, student_t_quantile};
use calibrig_model::{ParameterId, Unit};

/// One identified parameter.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ParameterEstimate {
    /// Which.
    pub id: ParameterId,
    /// Deviation from the nominal (links), prior (frame), stated (target) or predicted (compliances) value, SI.
    pub value: f64,
    /// Standard deviation, SI, from the noise that the fit was weighed with; `None` where the system is singular.
    pub sigma: Option<f64>,
    /// The one that the readings' stated noise leaves by itself, SI, where the fit was weighed with more.
    pub stated_sigma: Option<f64>,
    /// Standard deviation of its own zero-mean prior, SI; `None` where it has none, as a frame, which nests are measured for.
    pub prior_sigma: Option<f64>,
}

/// Why the solver stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum TerminationReason {
    /// The gradient vanished within its tolerance.
    SmallGradient,
    /// The step became negligible against the parameters' scale.
    SmallStep,
    /// The decrease of the cost became negligible.
    SmallDecrease,
    /// The iteration limit was reached first: not converged.
    IterationLimit,
    /// No damping led to a lower cost: not converged.
    NoDecrease,
    /// The cost or its derivatives stopped being finite numbers: not converged.
    NotFinite,
}

impl TerminationReason {
    /// Whether the minimum was reached.
    pub fn converged(self) -> bool {
        matches!(self, Self::SmallGradient | Self::SmallStep | Self::SmallDecrease)
    }

    /// What happened, for people.
    pub fn words(self) -> &'static str {
        match self {
            Self::SmallGradient => "the gradient vanished",
            Self::SmallStep => "the step became negligible",
            Self::SmallDecrease => "the decrease became negligible",
            Self::IterationLimit => "the iteration limit was reached",
            Self::NoDecrease => "no step led downhill",
            Self::NotFinite => "the cost stopped being finite",
        }
    }

    /// What to do where the minimum was not reached; nothing where it was.
    pub fn advice(self) -> &'static str {
        match self {
            Self::SmallGradient | Self::SmallStep | Self::SmallDecrease => "",
            Self::IterationLimit => {
                "Allow more iterations (--max-iterations; max_iterations in a scenario); if that does not help, look at the \
                 weak directions: state the tool's offset, fix the parameters that still move, or measure poses that show them"
            }
            Self::NoDecrease | Self::NotFinite => {
                "Look for gross errors and wrong units in the measurements and in the robot's table; then at the weak directions: state the \
                 tool's offset, or fix the parameters that still move"
            }
        }
    }

    /// The key in JSON and recordings.
    pub fn key(self) -> &'static str {
        match self {
            Self::SmallGradient => "small_gradient",
            Self::SmallStep => "small_step",
            Self::SmallDecrease => "small_decrease",
            Self::IterationLimit => "iteration_limit",
            Self::NoDecrease => "no_decrease",
            Self::NotFinite => "not_finite",
        }
    }
}

/// One iteration of the solver.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct IterationRecord {
    /// Weighted sum of squares after the iteration.
    #[serde(with = "calibrig_model::float::scalar")]
    pub cost: f64,
    /// Levenberg-Marquardt damping that was tried.
    #[serde(with = "calibrig_model::float::scalar")]
    pub damping: f64,
    /// Norm of the scaled step.
    #[serde(with = "calibrig_model::float::scalar")]
    pub step: f64,
    /// Actual over predicted decrease; 1 for a last, negligible step that was taken without another look at the cost.
    #[serde(with = "calibrig_model::float::scalar")]
    pub gain: f64,
    /// Whether the step was taken.
    pub accepted: bool,
    /// The parameters after the iteration, in the estimate's order, SI; those before it where the step was not taken.
    #[serde(with = "calibrig_model::float::list")]
    pub parameters: Vec<f64>,
}

/// Where the standard deviations get their scale from.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NoiseScale {
    /// From the covariances stated with the readings.
    Stated,
    /// From the residuals: the readings state none. Standard deviation of one coordinate, m.
    Residuals(#[serde(with = "calibrig_model::float::scalar")] f64),
}

/// What an identification took to be so, because the options left it to the measurements, or nobody said otherwise.
#[derive(Debug, Clone, PartialEq, Error, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Assumption {
    /// The measurements of the robot alone place the tracker.
    #[error(
        "station {station}: not placed beforehand ({nests} base nests, three are needed); its place is identified"
    )]
    StationFree {
        /// Its name.
        station: String,
        /// Nests measured.
        nests: usize,
    },
    /// Sweeps of two axes place the tracker.
    #[error(
        "station {station}: placed by sweeps of {} and {}, which tie it to the links up to these axes; their uncertainty is in the fit",
        axes[0], axes[1]
    )]
    StationBySweeps {
        /// Its name.
        station: String,
        /// Names of the axes.
        axes: [String; 2],
    },
    /// Its nests place the tracker.
    #[error("station {station}: placed by {nests} base nests, whose uncertainty is a prior")]
    StationByNests {
        /// Its name.
        station: String,
        /// Nests measured.
        nests: usize,
    },
    /// Nothing is known of a target's offset.
    #[error("target {target}: no uncertainty of its offset is stated, so it is identified")]
    TargetFree {
        /// Its name.
        target: String,
    },
    /// A target's offset was measured.
    #[error("target {target}: the stated offset is a prior, +- {:.3} mm", 1e3 * sigma)]
    TargetStated {
        /// Its name.
        target: String,
        /// Root mean square of its coordinates' standard deviations, m.
        sigma: f64,
    },
    /// An instrument's readings share errors that were stated.
    #[error(
        "tracker {name}: {errors} errors shared by its readings are identified, with the stated values as a prior"
    )]
    InstrumentStated {
        /// Its name.
        name: String,
        /// Their number.
        errors: usize,
    },
    /// They are taken to share none, although some were stated.
    #[error(
        "tracker {name}: the stated errors shared by its readings are ignored; the intervals do not include them"
    )]
    InstrumentIgnored {
        /// Its name.
        name: String,
    },
    /// Links are about as drawn.
    #[error("links: within +- {:.1} mm and +- {:.1} mrad of their nominal values (standard deviations of a prior)", 1e3 * .0.length, 1e3 * .0.angle)]
    LinksWithin(Tolerance),
    /// The machine does more than its model.
    #[error("machine: random errors from pose to pose that the model does not hold, {}", noise_in_words(.0))]
    NoiseOfMachine(MachineNoise),
    /// Readings scatter by themselves by more than they state.
    #[error("noise: the readings' own noise is {scale:.2} times what they state, found with the fit")]
    NoiseOfReadings {
        /// Found over stated standard deviation.
        #[serde(with = "calibrig_model::float::scalar")]
        scale: f64,
    },
    /// Compliances are fitted, and nobody said how well the masses that load them are known.
    #[error(
        "masses and centres of gravity: taken as exact, because no uncertainty of them is stated; the standard deviations of \
         the compliances do not include theirs (mass_percent and centre_mm in the robot's file, or --mass-percent and \
         --centre-mm)"
    )]
    BodiesExact,
    /// Nothing is known of how a target is turned on the flange.
    #[error("target {target}: no uncertainty of its orientation is stated, so it is identified")]
    OrientationFree {
        /// Its name.
        target: String,
    },
    /// It was measured how a target is turned on the flange.
    #[error("target {target}: its stated orientation is a prior, +- {:.3} mrad", 1e3 * sigma)]
    OrientationStated {
        /// Its name.
        target: String,
        /// Root mean square of the standard deviations about its axes, rad.
        sigma: f64,
    },
    /// Orientations scatter by more than their readings state, or these state nothing.
    #[error("orientations: in addition to what readings state, {:.3} mrad about each axis, found with the fit", 1e3 * sigma)]
    NoiseOfOrientations {
        /// Standard deviation, rad.
        #[serde(with = "calibrig_model::float::scalar")]
        sigma: f64,
    },
    /// How well masses and centres are known was stated.
    #[error(
        "masses and centres of gravity: their stated uncertainty is a prior, and is included in the standard deviations of \
         the compliances"
    )]
    BodiesStated,
    /// Nothing is known of the stiffnesses.
    #[error(
        "stiffnesses: unknown; each is assumed within a factor of {:.0} of the stated one (standard deviation of a prior)",
        UNKNOWN_STIFFNESS.exp()
    )]
    StiffnessUnknown,
    /// The readings state no covariance.
    #[error("noise: the readings state none; it is taken from the residuals, {:.3} mm per coordinate", 1e3 * sigma)]
    NoiseOfResiduals {
        /// Standard deviation of one coordinate, m.
        #[serde(with = "calibrig_model::float::scalar")]
        sigma: f64,
    },
}

/// A parameter that could have been fitted and was not.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LeftOut {
    /// Which.
    pub id: ParameterId,
    /// Why.
    pub reason: LeftOutReason,
}

/// Why a parameter is left out.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum LeftOutReason {
    /// Gravity hardly loads a compliance, or always alike.
    Unloaded {
        /// By how many standard deviations of their noise its prior's standard deviation moves all measurements together, beside what the
        /// geometry can do as well.
        #[serde(with = "calibrig_model::float::scalar")]
        effect: f64,
    },
    /// No measurement has what it acts on, such as an approach.
    NoBasis,
    /// It cannot be told from others.
    Redundant,
    /// It was to stay where it is.
    ByName,
}

impl LeftOutReason {
    /// The key in JSON.
    pub fn key(self) -> &'static str {
        match self {
            Self::Unloaded { .. } => "unloaded",
            Self::NoBasis => "no_basis",
            Self::Redundant => "redundant",
            Self::ByName => "fixed",
        }
    }

    /// In words, without figures.
    pub fn words(self) -> &'static str {
        match self {
            Self::Unloaded { .. } => "gravity hardly loads it in these poses, or always loads it alike",
            Self::NoBasis => {
                "it has no effect on any measurement, which would need, for example, an approach, a time or a motion of its \
                 joint"
            }
            Self::Redundant => "the measurements cannot distinguish it from others",
            Self::ByName => "fixed by name, at the nominal, stated or predicted value",
        }
    }
}

/// Without the name of the parameter.
impl fmt::Display for LeftOutReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.words())?;
        match self {
            Self::Unloaded { effect } => {
                write!(
                    f,
                    ": the uncertainty that its prior leaves moves all measurements together by {effect:.2} of their noise"
                )
            }
            Self::NoBasis | Self::Redundant | Self::ByName => Ok(()),
        }
    }
}

/// What a user must know of an estimate before trusting it.
#[derive(Debug, Clone, PartialEq, Error, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Warning {
    /// The solver stopped before the minimum.
    #[error("not converged: {} ({}). {}", .0.key(), .0.words(), .0.advice())]
    NotConverged(TerminationReason),
    /// The parameters cannot all be determined.
    #[error("rank {rank} of {parameters} parameters: {} cannot be distinguished", .groups.join("; "))]
    RankDeficient {
        /// Numerical rank.
        rank: usize,
        /// Number of parameters.
        parameters: usize,
        /// Dependent groups by name.
        groups: Vec<String>,
    },
    /// A combination that the data hardly excite.
    #[error("weak direction ({singular_value:.1e} of the largest): {direction}")]
    Weak {
        /// Scaled singular value over the largest.
        singular_value: f64,
        /// The combination in words.
        direction: String,
    },
    /// Parameters that are left to their priors.
    #[error(
        "the measurements alone cannot distinguish {} from others: the values printed are those of their priors", .groups.join("; ")
    )]
    HeldByPrior {
        /// Dependent groups by name.
        groups: Vec<String>,
    },
    /// Parameters that are left out.
    #[error("left at the nominal value, because the measurements cannot distinguish them from others: {}", .groups.join("; "))]
    Fixed {
        /// Dependent groups by name.
        groups: Vec<String>,
    },
    /// A compliance that was asked for.
    #[error(
        "gravity hardly loads {name} in these poses, or always loads it alike: its value is that of its prior. Leave it out, \
         or measure poses, or payloads at the flange (payload_mass_kg or [[payload]] of a column map, [[payload]] of a \
         scenario), that load it differently"
    )]
    Unexcited {
        /// Name of the parameter.
        name: String,
    },
    /// Loads at the flange of a robot that does not yield.
    #[error(
        "poses carry payloads ({}), but the model has nothing that deflects, so they are not used. If the robot's stiffnesses \
         are known, or are to be identified, state them in its file", .payloads.join(", ")
    )]
    IdlePayloads {
        /// Their names.
        payloads: Vec<String>,
    },
    /// A parameter that is as far as it may go.
    #[error(
        "{name} ended at its bound {}: the measurements ask for a value beyond it, so the bound or the nominal value is \
         wrong, or the model lacks something", shown(*.unit, *.bound)
    )]
    AtBound {
        /// Name of the parameter.
        name: String,
        /// Its limit, SI.
        bound: f64,
        /// The unit.
        unit: Unit,
    },
    /// A bound of a parameter that is not fitted.
    #[error(
        "the bound of {bound} has no effect: the measurements do not determine that parameter, so it was left out of the fit"
    )]
    UnusedBound {
        /// The bound.
        bound: ParameterBound,
    },
    /// Priors that do not fit the measurements, and nests that do not fit each other.
    #[error(
        "the measurements contradict what was stated about {}. Check these values and their standard deviations; if they are \
         certain, the model lacks something (tested at a level of {} % for all stated values){}",
        in_words(.0), 1e2 * CONTRADICTION_LEVEL, softer(.0)
    )]
    Contradicted(Vec<Contradiction>),
    /// A station that the measurements of the robot put elsewhere than its nests.
    #[error(
        "the measurements contradict {0}: the tracker moved against the base after they were measured, or the model lacks \
         something that a shift of the base makes up for"
    )]
    Moved(Contradiction),
    /// A compliance that ended at none at all.
    #[error(
        "{name} ended at its bound -1: a rigid one fits best, so no compliance is visible there, or an error of the model \
         hides it"
    )]
    Rigid {
        /// Name of the parameter.
        name: String,
    },
    /// Observations far off the others.
    #[error("far from what the others say: {}{}", in_poses(.0), if Outlier::are_a_reason(.0) { COUNTED } else { "" })]
    Outliers(Vec<Outlier>),
    /// The identified robot does not lie on the points.
    #[error(
        "the identified robot leaves an RMS of {:.3} mm, {:.0} % of the spread of the points ({:.0} mm): it does not fit \
         them, and the standard deviations mean nothing. Check the joints' columns, the targets' names and the order of the \
         rows",
        1e3 * rms, 1e2 * rms / spread, 1e3 * spread
    )]
    OffThePoints {
        /// RMS of the 3-D residual, m.
        #[serde(with = "calibrig_model::float::scalar")]
        rms: f64,
        /// RMS distance of the points from their mean, m.
        #[serde(with = "calibrig_model::float::scalar")]
        spread: f64,
    },
    /// The identified robot is not turned as its full poses say.
    #[error(
        "orientations are off by {:.0} mrad about each axis, more than those of any robot: the stated convention of the \
         rotations is probably wrong. Check the form, the order or sequence, and the direction of the transform ([rotation] \
         of the column map)",
        1e3 * sigma
    )]
    OrientationsOff {
        /// Standard deviation about each axis, rad.
        #[serde(with = "calibrig_model::float::scalar")]
        sigma: f64,
    },
    /// Readings of several targets under one name.
    #[error(
        "the readings of {} are of {targets} targets {:.3} mm apart, or the last joint has that much play: with a separate \
         offset for each, the residuals fall from {:.3} to {:.3} mm RMS. Name the target of every row (in a column of the \
         file, or with one file per target)",
        called("target", .target), 1e3 * apart, 1e3 * rms[0], 1e3 * rms[1]
    )]
    SeveralTargets {
        /// Name of the target.
        target: String,
        /// How many there are.
        targets: usize,
        /// How far they are apart at most, m.
        apart: f64,
        /// RMS of the 3-D residual with one offset and with several, m.
        rms: [f64; 2],
    },
    /// A station that was moved between its readings.
    #[error(
        "{}, the robot's base or the zero of its first joint was moved between poses {} and {}, which moved the points by \
         {:.3} mm: with two places of the station the residuals fall from {:.3} to {:.3} mm RMS. Give the measurements after \
         the move a separate station",
        called("station", .station), poses[0], poses[1], 1e3 * by, 1e3 * rms[0], 1e3 * rms[1]
    )]
    StationMoved {
        /// Name of the station.
        station: String,
        /// The last pose before and the first behind.
        poses: [u32; 2],
        /// Mean displacement of the points behind, m.
        by: f64,
        /// RMS of the 3-D residual with one place and with two, m.
        rms: [f64; 2],
    },
    /// Too few readings to test the noise that they state.
    #[error(
        "less than one degree of freedom remains ({freedom:.2}): the parameters absorb all measurements, so the stated noise \
         cannot be checked. Measure more poses"
    )]
    Untested {
        /// Effective degrees of freedom.
        freedom: f64,
    },
    /// The starts led to several minima.
    #[error("{minima} minima were found, and the lowest is given: another start could find a lower one")]
    SeveralMinima {
        /// Their number.
        minima: u32,
    },
    /// The residuals are larger than the stated noise explains.
    #[error(
        "the residuals are {ratio:.1} times what the stated noise explains: the model lacks something{}",
        if *.accounted {
            "; the standard deviations include it, as random errors from pose to pose"
        } else {
            ", and the standard deviations do not include it"
        }
    )]
    Inconsistent {
        /// Square root of chi-square per degree of freedom.
        ratio: f64,
        /// Whether the fit was weighed with an estimate of it.
        accounted: bool,
    },
    /// Readings scatter among themselves by more than they state.
    #[error(
        "the readings of one pose scatter among themselves {ratio:.1} times as much as they state: state their real noise; \
         the standard deviations include it"
    )]
    Understated {
        /// Found over stated standard deviation, gross errors aside.
        ratio: f64,
    },
    /// Too few readings to tell their noise.
    #[error(
        "no degrees of freedom remain: the parameters absorb all measurements, so the residuals say nothing about the noise. \
         It is assumed to be {:.3} mm per coordinate, all that the nominal robot leaves and the most that it can be: measure \
         more poses, or state the noise of the readings", 1e3 * sigma
    )]
    NoFreedom {
        /// Standard deviation of one coordinate, m.
        sigma: f64,
    },
    /// The residuals are smaller than the stated noise leaves.
    #[error(
        "the residuals are {ratio:.2} times what the stated noise leaves: the noise is stated too large, and the standard \
         deviations are wider than necessary"
    )]
    Overstated {
        /// Square root of chi-square per degree of freedom.
        ratio: f64,
    },
}

/// A target or station in a sentence; one that nobody named has no name.
fn called(what: &str, name: &str) -> String {
    match name {
        "" => format!("the {what}"),
        name if name.starts_with(what) => name.to_owned(),
        name => format!("{what} {name}"),
    }
}

fn noise_in_words(noise: &MachineNoise) -> String {
    let shown = |sigma: f64| format!("{sigma:.1e}");
    let actuators = noise.actuators.iter().enumerate().filter(|(_, sigma)| **sigma > 0.0);
    let actuators: Vec<_> = actuators.map(|(j, sigma)| format!("J{} {}", j + 1, shown(*sigma))).collect();
    let place = match noise.position {
        0.0 => "no displacement of the flange".to_owned(),
        sigma => format!("{:.3} mm per axis at the flange", 1e3 * sigma),
    };
    match actuators.as_slice() {
        [] => format!("{place}; the data show none of the actuators"),
        some => format!("{place}; of the actuators, in m or rad: {}", some.join(", ")),
    }
}

fn in_words(contradictions: &[Contradiction]) -> String {
    contradictions.iter().map(ToString::to_string).collect::<Vec<_>>().join(", and of ")
}

/// What to do where it is the stiffness of drives that is off by far.
fn softer(contradictions: &[Contradiction]) -> String {
    let softer = |contradiction: &Contradiction| match contradiction.stated {
        Stated::Parameter { id: id @ ParameterId::Compliance(_), found, prior_sigma, .. } if found > 0.0 => {
            let about = |ratio: f64| format!("{ratio:.1e}").parse().unwrap_or(ratio);
            let (asked, allowed) = (about(1.0 + found), about(1.0 + prior_sigma));
            Some(format!("{id} about {asked} times the stated one, but the prior allows {allowed} times"))
        }
        _ => None,
    };
    let softer: Vec<_> = contradictions.iter().filter_map(softer).collect();
    if softer.is_empty() {
        return String::new();
    }
    format!(
        ". The data ask for much softer drives than the prior allows: {}. If the stiffness is not known, say so: \
         compliance_percent = \"unknown\" in the robot's file, or --compliance-percent unknown",
        softer.join("; ")
    )
}

/// What is to be done where they count in the fit.
const COUNTED: &str = ". They have full weight in the fit: check these readings and leave out what is wrong, or use a robust \
                       loss (`--loss tukey`)";
/// Standard deviations from which on it is no tail of what a machine does.
const CERTAIN: f64 = 10.0;
/// So many smaller ones are no reason.
const NOW_AND_THEN: usize = 5;
/// More are counted, not listed.
const LISTED: usize = 12;

fn in_poses(outliers: &[Outlier]) -> String {
    let mut words: Vec<_> = outliers.iter().take(LISTED).map(ToString::to_string).collect();
    if outliers.len() > LISTED {
        words.push(format!("and {} more", outliers.len() - LISTED));
    }
    words.join(", ")
}

/// A gross error: an observation far off what the others say of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Outlier {
    /// Number of its pose.
    pub pose: u32,
    /// Index of the observation in its set.
    pub observation: usize,
    /// Name of its target, where there are several.
    pub target: Option<String>,
    /// Name of its station, where there are several.
    pub station: Option<String>,
    /// How far it is from where a fit without it predicts it, m; zero where its orientation alone is off.
    #[serde(with = "calibrig_model::float::scalar")]
    pub distance: f64,
    /// How far it is turned from there, rad, where its orientation is one.
    #[serde(default)]
    pub turn: Option<f64>,
    /// The larger of the two in standard deviations of a coordinate, those of noise and prediction.
    #[serde(with = "calibrig_model::float::scalar")]
    pub size: f64,
    /// What it still counts for in the fit, from 1 down to 0.
    pub weight: f64,
    /// The pose whose point it has, where that one has its point.
    pub exchanged_with: Option<u32>,
}

impl Outlier {
    /// Whether it carries weight in the fit. A robust loss leaves one of this size less than half.
    pub fn carries_weight(&self) -> bool {
        self.weight > 0.5
    }

    /// Whether it carries weight and is a gross error for certain: up to ten standard deviations, what a machine does now and then (a
    /// backlash that was taken up or not) looks alike.
    pub fn counts(&self) -> bool {
        self.carries_weight() && self.size >= CERTAIN
    }

    /// Whether a person must look at them: one of them [counts](Self::counts), or more carry weight than a machine has now and then.
    pub fn are_a_reason(outliers: &[Self]) -> bool {
        outliers.iter().any(Self::counts)
            || outliers.iter().filter(|outlier| outlier.carries_weight()).count() > NOW_AND_THEN
    }
}

impl fmt::Display for Outlier {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "pose {}", self.pose)?;
        for (what, name) in [("target", &self.target), ("station", &self.station)] {
            if let Some(name) = name {
                let what = if name.starts_with(what) { "" } else { what };
                write!(f, ", {}", format!("{what} {name}").trim_start())?;
            }
        }
        f.write_str(" (")?;
        if self.turn.is_none() || self.distance > 0.0 {
            write!(f, "{:.3} mm, ", 1e3 * self.distance)?;
        }
        if let Some(turn) = self.turn {
            write!(f, "turned by {:.3} mrad, ", 1e3 * turn)?;
        }
        write!(f, "{:.0} sigma", self.size)?;
        if !self.carries_weight() {
            write!(f, ", weight {:.2}", self.weight)?;
        }
        if let Some(pose) = self.exchanged_with {
            write!(f, ", its point and that of pose {pose} are exchanged")?;
        }
        f.write_str(")")
    }
}

/// The result of an identification. Non-convergence and rank deficiency are in here as data, not errors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// The robot as identified.
    pub robot: CalibratedRobot,
    /// The parameters in the column order of the covariance.
    pub parameters: Vec<ParameterEstimate>,
    /// Covariance of the parameters (m², m rad, rad²), zero for those at a bound; `None` from a singular system.
    pub covariance: Option<DMatrix<f64>>,
    /// `S` with covariance `S Sᵀ`, n x (n less those at a bound): what the covariance of a prediction is made of. `None` as the covariance.
    pub factor: Option<DMatrix<f64>>,
    /// What every observation counts for, 1 down to 0; empty where no robust loss was asked for and all count alike.
    pub weights: Vec<f64>,
    /// What these are divided by in the covariance, for what the loss costs; 1 without a loss.
    #[serde(with = "calibrig_model::float::scalar")]
    pub weight_unit: f64,
    /// The noise of the readings.
    pub noise: NoiseScale,
    /// Noise of the readings by themselves over what they state, with which the fit is weighed: found where several of a pose tell it from what
    /// the machine does; gross errors are in it. `None` where it was not looked for.
    #[serde(default)]
    pub reading_scale: Option<f64>,
    /// What the machine does beside the model, in independent parts, as stated and (with its degrees of freedom) as estimated: it is in the
    /// weights of the fit, in the covariance, and in the covariance of what is predicted.
    pub machine_noise: Vec<MachineNoise>,
    /// Standard deviation that was found of every orientation about each axis beside what its reading states, rad; `None` where none was looked for.
    #[serde(default)]
    pub turn_noise: Option<f64>,
    /// Degrees of freedom of Student's distribution for intervals; `None` where nothing of the noise was estimated and intervals are normal.
    pub interval_freedom: Option<f64>,
    /// Sum of squares of the residuals of observations, nests and targets, in the noise that was stated (where none was: in that of the residuals).
    #[serde(with = "calibrig_model::float::scalar")]
    pub chi2: f64,
    /// Their effective degrees of freedom: rows less the trace of their part of the hat matrix.
    #[serde(with = "calibrig_model::float::scalar")]
    pub degrees_of_freedom: f64,
    /// Why the solver stopped.
    pub termination: TerminationReason,
    /// Its history.
    pub iterations: Vec<IterationRecord>,
    /// Rank, condition and weak directions of the scaled system, without the links' making tolerance.
    pub spectrum: Spectrum,
    /// Parameters that the measurements alone, with nests and target, cannot tell from others, and that rest on their priors.
    pub held: Vec<DependentGroup>,
    /// Parameters that were left out of the fit for the same reason.
    pub fixed: Vec<DependentGroup>,
    /// All parameters that could have been fitted and were left out, with the reason; those that are `fixed` among them.
    #[serde(default)]
    pub left_out: Vec<LeftOut>,
    /// Stated bounds of the parameters that were fitted.
    pub bounds: Vec<ParameterBound>,
    /// Parameters that ended at a bound.
    pub at_bound: Vec<ParameterId>,
    /// What was stated beforehand and does not fit the measurements, although these fit the model.
    pub contradicted: Vec<Contradiction>,
    /// Observations far off what the others say of them, in their order.
    pub outliers: Vec<Outlier>,
    /// What was taken to be so.
    pub assumptions: Vec<Assumption>,
    /// What a user must know.
    pub warnings: Vec<Warning>,
}

impl Estimate {
    /// Chi-square per degree of freedom, about 1 where model and stated noise are right.
    pub fn chi2_per_dof(&self) -> Option<f64> {
        (self.degrees_of_freedom > 0.0).then(|| self.chi2 / self.degrees_of_freedom)
    }

    /// Half the width of an interval that holds a value with probability `level`, in standard deviations: Student's where the noise was
    /// estimated. Not finite where no degree of freedom is left to estimate it.
    pub fn interval_factor(&self, level: f64) -> f64 {
        let tail = 0.5 + 0.5 * level;
        match self.interval_freedom {
            None => normal_quantile(tail),
            Some(freedom) if freedom.is_infinite() => normal_quantile(tail),
            Some(freedom) => student_t_quantile(tail, freedom),
        }
    }

    /// The parameters that the last step moved most, in their standard deviations, at most `most`; the farthest first. A parameter without a
    /// standard deviation counts in that of its prior, and is left out where it has none, either.
    pub fn last_moved(&self, most: usize) -> Vec<(ParameterId, f64)> {
        let mut before = self.iterations.iter().rev().skip_while(|record| !record.accepted);
        let Some(last) = before.next() else { return Vec::new() };
        let start = vec![0.0; last.parameters.len()];
        let from = before.next().map_or(&start, |record| &record.parameters);
        let moves = self.parameters.iter().zip(last.parameters.iter().zip(from));
        let in_sigmas = |(parameter, (to, from)): (&ParameterEstimate, (&f64, &f64))| {
            let sigma = parameter.sigma.or(parameter.prior_sigma)?;
            let moved = (to - from) / sigma;
            (moved.is_finite() && moved != 0.0).then_some((parameter.id, moved))
        };
        let mut moved: Vec<_> = moves.filter_map(in_sigmas).collect();
        moved.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
        moved.truncate(most);
        moved
    }

    /// The value of a parameter, if it was identified.
    pub fn value(&self, id: ParameterId) -> Option<f64> {
        self.parameters.iter().find(|p| p.id == id).map(|p| p.value)
    }
}
