//! The result of an identification.

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
    /// Which parameter.
    pub id: ParameterId,
    /// Deviation from the nominal (links), prior (frame), stated (target) or predicted (compliances) value, SI.
    pub value: f64,
    /// Standard deviation, SI, for the noise with which the fit was weighed; `None` where the system is singular.
    pub sigma: Option<f64>,
    /// Standard deviation from the stated noise of the readings alone, SI, where the fit was weighed with more noise.
    pub stated_sigma: Option<f64>,
    /// Standard deviation of the parameter's own zero-mean prior, SI; `None` where it has no prior of its own, such as a frame that was measured
    /// by nests.
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

    /// What happened, as text for people.
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

    /// What to do where the minimum was not reached; empty where it was.
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
    /// Actual over predicted decrease; 1 for a last, negligible step that was taken without evaluating the cost again.
    #[serde(with = "calibrig_model::float::scalar")]
    pub gain: f64,
    /// Whether the step was taken.
    pub accepted: bool,
    /// The parameters after the iteration, in the estimate's order, SI; those before it if the step was not taken.
    #[serde(with = "calibrig_model::float::list")]
    pub parameters: Vec<f64>,
}

/// Where the scale of the standard deviations comes from.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NoiseScale {
    /// From the covariances stated with the readings.
    Stated,
    /// From the residuals, as the readings state no covariance: standard deviation of one coordinate, m.
    Residuals(#[serde(with = "calibrig_model::float::scalar")] f64),
}

/// An assumption of an identification, made because the options left it to the measurements or nothing else was stated.
#[derive(Debug, Clone, PartialEq, Error, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Assumption {
    /// Only the measurements of the robot place the tracker.
    #[error(
        "station {station}: not placed beforehand ({nests} base nests, three are needed); its place is identified"
    )]
    StationFree {
        /// Name of the station.
        station: String,
        /// Number of nests that were measured.
        nests: usize,
    },
    /// Sweeps of two axes place the tracker.
    #[error(
        "station {station}: placed by sweeps of {} and {}, which tie it to the links up to these axes; their uncertainty is in the fit",
        axes[0], axes[1]
    )]
    StationBySweeps {
        /// Name of the station.
        station: String,
        /// Names of the axes.
        axes: [String; 2],
    },
    /// Base nests place the tracker.
    #[error("station {station}: placed by {nests} base nests, whose uncertainty is a prior")]
    StationByNests {
        /// Name of the station.
        station: String,
        /// Number of nests that were measured.
        nests: usize,
    },
    /// Nothing is known of a target's offset; it is identified.
    #[error("target {target}: no uncertainty of its offset is stated, so it is identified")]
    TargetFree {
        /// Name of the target.
        target: String,
    },
    /// A target's offset was measured; it has a prior.
    #[error("target {target}: the stated offset is a prior, +- {:.3} mm", 1e3 * sigma)]
    TargetStated {
        /// Name of the target.
        target: String,
        /// Root mean square of its coordinates' standard deviations, m.
        sigma: f64,
    },
    /// Errors that an instrument's readings share were stated, and are identified.
    #[error(
        "tracker {name}: {errors} errors shared by its readings are identified, with the stated values as a prior"
    )]
    InstrumentStated {
        /// Name of the instrument.
        name: String,
        /// Number of these errors.
        errors: usize,
    },
    /// Stated errors that an instrument's readings share are ignored.
    #[error(
        "tracker {name}: the stated errors shared by its readings are ignored; the intervals do not include them"
    )]
    InstrumentIgnored {
        /// Name of the instrument.
        name: String,
    },
    /// The links are close to their nominal values, within a tolerance.
    #[error("links: within +- {:.1} mm and +- {:.1} mrad of their nominal values (standard deviations of a prior)", 1e3 * .0.length, 1e3 * .0.angle)]
    LinksWithin(Tolerance),
    /// The machine has errors of single poses beside its model.
    #[error("machine: random errors from pose to pose that the model does not hold, {}", noise_in_words(.0))]
    NoiseOfMachine(MachineNoise),
    /// Readings scatter by more than they state.
    #[error("noise: the readings' own noise is {scale:.2} times what they state, found with the fit")]
    NoiseOfReadings {
        /// Found over stated standard deviation of a reading.
        #[serde(with = "calibrig_model::float::scalar")]
        scale: f64,
    },
    /// Compliances are fitted, and no uncertainty of the masses that load them is stated.
    #[error(
        "masses and centres of gravity: taken as exact, because no uncertainty of them is stated; the standard deviations of \
         the compliances do not include theirs (mass_percent and centre_mm in the robot's file, or --mass-percent and \
         --centre-mm)"
    )]
    BodiesExact,
    /// Nothing is known of how a target is turned on the flange; it is identified.
    #[error("target {target}: no uncertainty of its orientation is stated, so it is identified")]
    OrientationFree {
        /// Name of the target.
        target: String,
    },
    /// How a target is turned on the flange was measured; it has a prior.
    #[error("target {target}: its stated orientation is a prior, +- {:.3} mrad", 1e3 * sigma)]
    OrientationStated {
        /// Name of the target.
        target: String,
        /// Root mean square of the standard deviations about the target's axes, rad.
        sigma: f64,
    },
    /// Orientations scatter by more than their readings state, or the readings state nothing.
    #[error("orientations: in addition to what readings state, {:.3} mrad about each axis, found with the fit", 1e3 * sigma)]
    NoiseOfOrientations {
        /// Additional standard deviation about each axis, rad.
        #[serde(with = "calibrig_model::float::scalar")]
        sigma: f64,
    },
    /// The uncertainty of masses and centres was stated, and is a prior.
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

/// A parameter that could have been fitted but was not.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LeftOut {
    /// Which parameter.
    pub id: ParameterId,
    /// Why.
    pub reason: LeftOutReason,
}

/// Why a parameter is left out.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum LeftOutReason {
    /// Gravity hardly loads a compliance, or loads it the same in every pose.
    Unloaded {
        /// How far the prior's standard deviation of the compliance moves all measurements together, in standard deviations of their noise, apart
        /// from what geometric parameters can do as well.
        #[serde(with = "calibrig_model::float::scalar")]
        effect: f64,
    },
    /// No measurement contains what the parameter acts on, such as an approach.
    NoBasis,
    /// It cannot be separated from other parameters.
    Redundant,
    /// The options fix it by name.
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

    /// The reason in words, without figures.
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

/// The reason without the name of the parameter.
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

/// Something that a user must know of an estimate before trusting it.
#[derive(Debug, Clone, PartialEq, Error, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Warning {
    /// The solver stopped before the minimum.
    #[error("not converged: {} ({}). {}", .0.key(), .0.words(), .0.advice())]
    NotConverged(TerminationReason),
    /// Not all parameters can be determined.
    #[error("rank {rank} of {parameters} parameters: {} cannot be distinguished", .groups.join("; "))]
    RankDeficient {
        /// Numerical rank.
        rank: usize,
        /// Number of parameters.
        parameters: usize,
        /// Groups of parameters that depend on each other, by name.
        groups: Vec<String>,
    },
    /// A combination of parameters is hardly excited by the data.
    #[error("weak direction ({singular_value:.1e} of the largest): {direction}")]
    Weak {
        /// Scaled singular value over the largest one.
        singular_value: f64,
        /// The combination in words.
        direction: String,
    },
    /// Parameters rest on their priors.
    #[error(
        "the measurements alone cannot distinguish {} from others: the values printed are those of their priors", .groups.join("; ")
    )]
    HeldByPrior {
        /// Groups of parameters that depend on each other, by name.
        groups: Vec<String>,
    },
    /// Parameters are left out of the fit.
    #[error("left at the nominal value, because the measurements cannot distinguish them from others: {}", .groups.join("; "))]
    Fixed {
        /// Groups of parameters that depend on each other, by name.
        groups: Vec<String>,
    },
    /// A compliance that was asked for is hardly loaded.
    #[error(
        "gravity hardly loads {name} in these poses, or always loads it alike: its value is that of its prior. Leave it out, \
         or measure poses, or payloads at the flange (payload_mass_kg or [[payload]] of a column map, [[payload]] of a \
         scenario), that load it differently"
    )]
    Unexcited {
        /// Name of the parameter.
        name: String,
    },
    /// The flange carries loads, but the robot's model does not yield.
    #[error(
        "poses carry payloads ({}), but the model has nothing that deflects, so they are not used. If the robot's stiffnesses \
         are known, or are to be identified, state them in its file", .payloads.join(", ")
    )]
    IdlePayloads {
        /// Names of the payloads.
        payloads: Vec<String>,
    },
    /// A parameter ended at its bound.
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
    /// A bound was stated for a parameter that is not fitted.
    #[error(
        "the bound of {bound} has no effect: the measurements do not determine that parameter, so it was left out of the fit"
    )]
    UnusedBound {
        /// The bound without effect.
        bound: ParameterBound,
    },
    /// Priors do not fit the measurements, or nests do not fit each other.
    #[error(
        "the measurements contradict what was stated about {}. Check these values and their standard deviations; if they are \
         certain, the model lacks something (tested at a level of {} % for all stated values){}",
        in_words(.0), 1e2 * CONTRADICTION_LEVEL, softer(.0)
    )]
    Contradicted(Vec<Contradiction>),
    /// The measurements of the robot put a station elsewhere than its nests do.
    #[error(
        "the measurements contradict {0}: the tracker moved against the base after they were measured, or the model lacks \
         something that a shift of the base makes up for"
    )]
    Moved(Contradiction),
    /// A compliance ended at zero.
    #[error(
        "{name} ended at its bound -1: a rigid one fits best, so no compliance is visible there, or an error of the model \
         hides it"
    )]
    Rigid {
        /// Name of the parameter.
        name: String,
    },
    /// Some observations are far off the others.
    #[error("far from what the others say: {}{}", in_poses(.0), if Outlier::are_a_reason(.0) { COUNTED } else { "" })]
    Outliers(Vec<Outlier>),
    /// The identified robot does not fit the points.
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
    /// The identified orientations are far off the measured ones.
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
    /// The readings of several targets have the same name.
    #[error(
        "the readings of {} are of {targets} targets {:.3} mm apart, or the last joint has that much play: with a separate \
         offset for each, the residuals fall from {:.3} to {:.3} mm RMS. Name the target of every row (in a column of the \
         file, or with one file per target)",
        called("target", .target), 1e3 * apart, 1e3 * rms[0], 1e3 * rms[1]
    )]
    SeveralTargets {
        /// Name of the target.
        target: String,
        /// Number of targets.
        targets: usize,
        /// Largest distance between two of them, m.
        apart: f64,
        /// RMS of the 3-D residual with one offset and with one per target, m.
        rms: [f64; 2],
    },
    /// A station was moved between its readings.
    #[error(
        "{}, the robot's base or the zero of its first joint was moved between poses {} and {}, which moved the points by \
         {:.3} mm: with two places of the station the residuals fall from {:.3} to {:.3} mm RMS. Give the measurements after \
         the move a separate station",
        called("station", .station), poses[0], poses[1], 1e3 * by, 1e3 * rms[0], 1e3 * rms[1]
    )]
    StationMoved {
        /// Name of the station.
        station: String,
        /// The last pose before the move and the first one after it.
        poses: [u32; 2],
        /// Mean displacement of the points after the move, m.
        by: f64,
        /// RMS of the 3-D residual with one place and with two, m.
        rms: [f64; 2],
    },
    /// Too few readings to test their stated noise.
    #[error(
        "less than one degree of freedom remains ({freedom:.2}): the parameters absorb all measurements, so the stated noise \
         cannot be checked. Measure more poses"
    )]
    Untested {
        /// Effective degrees of freedom of the residuals.
        freedom: f64,
    },
    /// Different starts led to different minima.
    #[error("{minima} minima were found, and the lowest is given: another start could find a lower one")]
    SeveralMinima {
        /// Number of minima.
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
        /// Whether the fit was weighed with an estimate of what the model lacks.
        accounted: bool,
    },
    /// Readings of the same pose scatter by more than they state.
    #[error(
        "the readings of one pose scatter among themselves {ratio:.1} times as much as they state: state their real noise; \
         the standard deviations include it"
    )]
    Understated {
        /// Found over stated standard deviation, gross errors aside.
        ratio: f64,
    },
    /// Too few readings to estimate their noise.
    #[error(
        "no degrees of freedom remain: the parameters absorb all measurements, so the residuals say nothing about the noise. \
         It is assumed to be {:.3} mm per coordinate, all that the nominal robot leaves and the most that it can be: measure \
         more poses, or state the noise of the readings", 1e3 * sigma
    )]
    NoFreedom {
        /// Standard deviation of one coordinate, m.
        sigma: f64,
    },
    /// The residuals are smaller than the stated noise predicts.
    #[error(
        "the residuals are {ratio:.2} times what the stated noise leaves: the noise is stated too large, and the standard \
         deviations are wider than necessary"
    )]
    Overstated {
        /// Square root of chi-square per degree of freedom.
        ratio: f64,
    },
}

/// How a sentence calls a target or station: by its name, if it has one.
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

/// Advice where the stiffness of drives is far off.
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

/// Advice where they count in the fit.
const COUNTED: &str = ". They have full weight in the fit: check these readings and leave out what is wrong, or use a robust \
                       loss (`--loss tukey`)";
/// Number of standard deviations beyond which an observation is no longer a tail of what a machine does.
const CERTAIN: f64 = 10.0;
/// Up to this many smaller gross errors are not a reason.
const NOW_AND_THEN: usize = 5;
/// Gross errors beyond this number are counted, not listed.
const LISTED: usize = 12;

fn in_poses(outliers: &[Outlier]) -> String {
    let mut words: Vec<_> = outliers.iter().take(LISTED).map(ToString::to_string).collect();
    if outliers.len() > LISTED {
        words.push(format!("and {} more", outliers.len() - LISTED));
    }
    words.join(", ")
}

/// A gross error: an observation far off what the others predict for it.
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
    /// Distance from where a fit without this observation predicts it, m; zero where only its orientation is off.
    #[serde(with = "calibrig_model::float::scalar")]
    pub distance: f64,
    /// Angle between its orientation and the predicted one, rad, if its orientation is a gross error.
    #[serde(default)]
    pub turn: Option<f64>,
    /// The larger of distance and angle in standard deviations of a coordinate, with the noise and the prediction's uncertainty.
    #[serde(with = "calibrig_model::float::scalar")]
    pub size: f64,
    /// Weight of the observation in the fit, from 1 down to 0.
    pub weight: f64,
    /// The pose with which it was exchanged: each of the two has the other's point.
    pub exchanged_with: Option<u32>,
}

impl Outlier {
    /// Whether it carries weight in the fit. A robust loss gives an observation of this size less than half.
    pub fn carries_weight(&self) -> bool {
        self.weight > 0.5
    }

    /// Whether it carries weight and is certainly a gross error. Up to ten standard deviations it can be what a machine does now and then, such
    /// as backlash that was taken up or not.
    pub fn counts(&self) -> bool {
        self.carries_weight() && self.size >= CERTAIN
    }

    /// Whether a person must look at these: one of them [counts](Self::counts), or more carry weight than a machine produces now and then.
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

/// The result of an identification. Non-convergence and rank deficiency are reported as data, not as errors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// The robot as identified.
    pub robot: CalibratedRobot,
    /// The parameters in the column order of the covariance.
    pub parameters: Vec<ParameterEstimate>,
    /// Covariance of the parameters (m², m rad, rad²), zero for those at a bound; `None` from a singular system.
    pub covariance: Option<DMatrix<f64>>,
    /// The matrix `S` with covariance `S Sᵀ`, n x (n less the number at a bound); the covariance of a prediction is made from it. `None` where
    /// the covariance is.
    pub factor: Option<DMatrix<f64>>,
    /// Weight of every observation in the fit, from 1 down to 0; empty without a robust loss, where all have the same weight.
    pub weights: Vec<f64>,
    /// Number by which the weights are divided in the covariance, to account for what the loss costs; 1 without a loss.
    #[serde(with = "calibrig_model::float::scalar")]
    pub weight_unit: f64,
    /// Where the noise of the readings comes from.
    pub noise: NoiseScale,
    /// Noise of the readings alone over what they state, with which the fit is weighed. It is found where several readings per pose separate it
    /// from the machine's errors, and includes gross errors. `None` where it was not looked for.
    #[serde(default)]
    pub reading_scale: Option<f64>,
    /// Noise of the machine beside its model, in independent parts, as stated and (with its degrees of freedom) as estimated. The weights of the
    /// fit, the covariance and the covariance of predictions contain it.
    pub machine_noise: Vec<MachineNoise>,
    /// Standard deviation of every orientation about each axis that was found beside what its reading states, rad; `None` where it was not looked
    /// for.
    #[serde(default)]
    pub turn_noise: Option<f64>,
    /// Degrees of freedom of Student's distribution for intervals; `None` where no part of the noise was estimated, so that intervals are normal.
    pub interval_freedom: Option<f64>,
    /// Sum of squares of the residuals of observations, nests and targets, in units of the stated noise (of the noise from the residuals where
    /// none was stated).
    #[serde(with = "calibrig_model::float::scalar")]
    pub chi2: f64,
    /// Effective degrees of freedom of these residuals: rows less the trace of their part of the hat matrix.
    #[serde(with = "calibrig_model::float::scalar")]
    pub degrees_of_freedom: f64,
    /// Why the solver stopped.
    pub termination: TerminationReason,
    /// History of the solver.
    pub iterations: Vec<IterationRecord>,
    /// Rank, condition and weak directions of the scaled system, without the links' manufacturing tolerance.
    pub spectrum: Spectrum,
    /// Parameters that the measurements alone, with nests and targets, cannot separate from others, and that rest on their priors.
    pub held: Vec<DependentGroup>,
    /// Parameters that were left out of the fit because the measurements cannot separate them from others.
    pub fixed: Vec<DependentGroup>,
    /// All parameters that could have been fitted and were left out, with the reason; includes those in `fixed`.
    #[serde(default)]
    pub left_out: Vec<LeftOut>,
    /// Stated bounds of the parameters that were fitted.
    pub bounds: Vec<ParameterBound>,
    /// Parameters that ended at a bound.
    pub at_bound: Vec<ParameterId>,
    /// Statements made beforehand that contradict the measurements although the measurements fit the model.
    pub contradicted: Vec<Contradiction>,
    /// Observations far off what the others predict for them, in their order.
    pub outliers: Vec<Outlier>,
    /// What was assumed.
    pub assumptions: Vec<Assumption>,
    /// What a user must know before trusting the estimate.
    pub warnings: Vec<Warning>,
}

impl Estimate {
    /// Chi-square per degree of freedom, about 1 where model and stated noise are right.
    pub fn chi2_per_dof(&self) -> Option<f64> {
        (self.degrees_of_freedom > 0.0).then(|| self.chi2 / self.degrees_of_freedom)
    }

    /// Half the width of an interval that holds a value with probability `level`, in standard deviations: Student's where the noise was
    /// estimated. Not finite without a degree of freedom to estimate it from.
    pub fn interval_factor(&self, level: f64) -> f64 {
        let tail = 0.5 + 0.5 * level;
        match self.interval_freedom {
            None => normal_quantile(tail),
            Some(freedom) if freedom.is_infinite() => normal_quantile(tail),
            Some(freedom) => student_t_quantile(tail, freedom),
        }
    }

    /// At most `most` parameters that the last step moved farthest, in standard deviations; the farthest first. A parameter without a standard
    /// deviation counts in that of its prior, and is left out if it has no prior either.
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
