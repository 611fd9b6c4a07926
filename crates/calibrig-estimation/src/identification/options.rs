//! Options of an identification: what to fit, and how.

use super::{IdentifyError, Loss, LossScale, MachineNoiseChoice, Mode, ParameterBound, SolverOptions};
use calibrig_model::measurement::{MeasurementSet, Station, Target, TargetOrientation};
use calibrig_model::{BodyUncertainty, Compliance, FAMILIES, ParameterId, Unit};
use serde::{Deserialize, Serialize};

/// How the tracker's place is determined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FrameChoice {
    /// As the set has it for each station: [`Nests`](Self::Nests) where at least three were measured, else [`Sweeps`](Self::Sweeps) where
    /// there are some, else [`Free`](Self::Free).
    #[default]
    AsStated,
    /// The base nests place the tracker: their readings tie it to the first links.
    Nests,
    /// [Sweeps](crate::circle_points) of two of the robot's axes place the tracker; their uncertainty is a prior in the fit.
    Sweeps,
    /// Nothing is known beforehand: six free parameters per station.
    Free,
    /// The place that the nests give is taken as exact.
    Fixed,
}

/// Whether a station has enough nests to be placed by them.
pub(super) fn is_placed(station: &Station) -> bool {
    station.distinct_nests().len() >= 3
}

/// What is known of the target's offset. How a target with axes is turned on the flange has a prior where its uncertainty is stated, and is
/// identified otherwise; [`Identified`](Self::Identified) and [`Fixed`](Self::Fixed) apply to it as to the offset.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum TargetChoice {
    /// As the set has it for each target: [`Measured`](Self::Measured) where an uncertainty is stated, else [`Identified`](Self::Identified).
    #[default]
    AsStated,
    /// The offset was measured; its uncertainty is a prior in the fit.
    Measured,
    /// Nothing is known: three free parameters per target.
    Identified,
    /// The stated value is taken as exact.
    Fixed,
}

impl FrameChoice {
    /// The choice that applies to one station.
    pub(super) fn of(self, station: &Station) -> Self {
        match self {
            Self::AsStated if is_placed(station) => Self::Nests,
            Self::AsStated if !station.sweeps.is_empty() => Self::Sweeps,
            Self::AsStated => Self::Free,
            choice => choice,
        }
    }
}

impl TargetChoice {
    /// The choice that applies to one target.
    pub(super) fn of(self, target: &Target) -> Self {
        match self {
            Self::AsStated if target.covariance.is_some() => Self::Measured,
            Self::AsStated => Self::Identified,
            choice => choice,
        }
    }

    /// The choice that applies to how one target is turned on the flange, which can be unknown where the offset was measured.
    pub(super) fn of_orientation(self, orientation: &TargetOrientation) -> Self {
        match self {
            Self::AsStated | Self::Measured if orientation.covariance.is_some() => Self::Measured,
            Self::AsStated | Self::Measured => Self::Identified,
            choice => choice,
        }
    }
}

/// Whether anything in a set ties the ends of the robot's chain. If not, only what does not depend on them can be determined.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Freedom {
    /// No station is placed by anything other than the measurements of the robot.
    pub frame: bool,
    /// No target's offset is known.
    pub target: bool,
    /// Whether it is unknown of every target that is seen with its orientation how it is turned on the flange; `None` where all targets are points.
    pub orientation: Option<bool>,
}

/// How errors that an instrument's readings share are handled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum InstrumentChoice {
    /// The errors that the set states for a station's instrument are identified, with the stated values as a prior.
    #[default]
    AsStated,
    /// There are no shared errors: the errors of all readings are independent.
    Ignored,
}

/// Which link parameters are identified.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ParameterChoice {
    /// Those that the published rules on neighbouring axes keep (24 for the spray-painting robot).
    NeighbourAxisRules,
    /// A complete independent set out of all five parameters per link, found by rank.
    Complete,
    /// Exactly these.
    Listed(Vec<ParameterId>),
}

/// Which compliances are identified in the coupled modes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ComplianceChoice {
    /// Those of the drives and the four-bar's rod, where they yield and gravity loads them.
    Drives,
    /// Those of drives, bearings, beams and rod, where they yield and gravity loads them.
    All,
    /// Exactly these, also where gravity does not load them.
    Listed(Vec<Compliance>),
}

/// What is done with a parameter that the measurements cannot separate from others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Redundancy {
    /// It stays at its nominal value and is no parameter of the fit.
    Fix,
    /// It is fitted and held by its prior, if it has one; otherwise the system is rank-deficient, as with [`Keep`](Self::Keep).
    #[default]
    Prior,
    /// It is fitted, and the system is judged by what the measurements alone determine.
    Keep,
}

impl Redundancy {
    /// All choices.
    pub const ALL: [Self; 3] = [Self::Fix, Self::Prior, Self::Keep];

    /// The key in files.
    pub fn key(self) -> &'static str {
        match self {
            Self::Fix => "fix",
            Self::Prior => "prior",
            Self::Keep => "keep",
        }
    }
}

/// The key that adds the lengths of the four-bar to the extended mode; the other families are in [`FAMILIES`](calibrig_model::FAMILIES).
pub const LINKAGE: &str = "linkage";

/// A prior in place of a family's own.
#[derive(Debug, Clone, PartialEq)]
pub struct TermPrior {
    /// Key of the family.
    pub family: String,
    /// Standard deviation of amplitudes that are lengths, m.
    pub length: Option<f64>,
    /// Standard deviation of amplitudes that are angles, rad.
    pub angle: Option<f64>,
}

/// Standard deviation of a zero-mean normal prior on the link parameters' deviations: how well the robot was made. It keeps directions
/// that the measurements hardly show at values that a machine can have; rank and weak directions are those of the data without it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Tolerance {
    /// Standard deviation of lengths, m.
    pub length: f64,
    /// Standard deviation of angles, rad.
    pub angle: f64,
}

/// Options of an identification: what to fit, and how.
#[derive(Debug, Clone, PartialEq)]
pub struct IdentificationOptions {
    /// Which model is fitted.
    pub mode: Mode,
    /// Link parameters that are identified.
    pub parameters: ParameterChoice,
    /// Link parameters that are identified in the extended mode.
    pub extended_parameters: ParameterChoice,
    /// Parameters that stay at their nominal, stated or predicted values, whatever other options ask for. Those of the tracker's place cannot be
    /// listed.
    pub fix: Vec<ParameterId>,
    /// Parameters that are fitted even where other options leave them out: among link parameters that cannot be separated, these are chosen;
    /// a compliance is fitted also where gravity does not load it; a coordinate of a target is fitted without the prior of its measurement.
    pub free: Vec<ParameterId>,
    /// Compliances that are identified in the coupled modes.
    pub compliances: ComplianceChoice,
    /// Standard deviation of the prior on the relative deviation of a compliance from its predicted value.
    pub compliance_sigma: f64,
    /// Whether nothing is known of the stiffnesses. Then a prior on the logarithm of every compliance over its predicted value, with the
    /// standard deviation [`UNKNOWN_STIFFNESS`], takes the place of `compliance_sigma`.
    pub stiffness_unknown: bool,
    /// How well the bodies' masses and centres are known, one entry per link; empty where they are taken as exact. In the coupled modes, those
    /// to which the measurements are sensitive are fitted with these priors, so that the standard deviations of the compliances contain them.
    pub bodies: Vec<BodyUncertainty>,
    /// Links whose mass is identified in the coupled modes, by index.
    pub masses: Vec<usize>,
    /// Standard deviation of the prior on the relative deviation of a mass.
    pub mass_sigma: f64,
    /// Keys of the families of terms in the extended mode, which may include [`LINKAGE`]; `None` for all that the robot can have except those
    /// that are fitted [on request](calibrig_model::TermFamily::is_on_request).
    pub terms: Option<Vec<String>>,
    /// Priors that replace the families' own.
    pub term_priors: Vec<TermPrior>,
    /// What is done with redundant parameters.
    pub redundant: Redundancy,
    /// How the tracker's place is determined.
    pub frame: FrameChoice,
    /// What is known of the targets' offsets.
    pub target: TargetChoice,
    /// How errors that an instrument's readings share are handled.
    pub instrument: InstrumentChoice,
    /// Standard deviation of what the model leaves out, per axis, m; added to the readings' covariance. It is chosen by the user and applies to
    /// positions; the additional scatter of orientations is found where the residuals ask for it.
    pub unmodelled_sigma: f64,
    /// Treatment of the machine's errors of single poses, which the model does not contain.
    pub machine_noise: MachineNoiseChoice,
    /// Prior on every link parameter, if stated.
    pub tolerance: Option<Tolerance>,
    /// Bounds of single parameters; each applies in the modes that have the parameter.
    pub bounds: Vec<ParameterBound>,
    /// What the solver minimises, and when it stops.
    pub solver: SolverOptions,
}

/// Standard deviation of the logarithm of a compliance over its predicted value where nothing is known of it: a factor of 100.
pub const UNKNOWN_STIFFNESS: f64 = 4.605_170_185_988_092;

/// How well a robot's links are assumed to be made where nothing is stated: 10 mm and 20 mrad, far more than a workshop leaves.
pub const DEFAULT_TOLERANCE: Tolerance = Tolerance { length: 10e-3, angle: 20e-3 };

/// Defaults for any robot and any set: a complete independent set of link parameters with the manufacturing tolerance [`DEFAULT_TOLERANCE`] as a
/// prior; tracker and target as far as the set states them. [`Estimate::assumptions`](super::Estimate::assumptions) lists what was assumed as a
/// result.
impl Default for IdentificationOptions {
    fn default() -> Self {
        Self {
            parameters: ParameterChoice::Complete,
            frame: FrameChoice::AsStated,
            target: TargetChoice::AsStated,
            instrument: InstrumentChoice::AsStated,
            tolerance: Some(DEFAULT_TOLERANCE),
            ..Self::published()
        }
    }
}

impl IdentificationOptions {
    /// The options of the publication (Y. Wang et al., Machines 11 (2023) 20): the parameters that the rules on neighbouring axes keep, without a
    /// prior; the tracker placed by its nests, the target measured.
    pub fn published() -> Self {
        Self {
            mode: Mode::OnlyCalibration,
            parameters: ParameterChoice::NeighbourAxisRules,
            extended_parameters: ParameterChoice::Complete,
            fix: Vec::new(),
            free: Vec::new(),
            compliances: ComplianceChoice::Drives,
            // A stiffness from data sheets and finite elements is rarely right within 10 %.
            compliance_sigma: 0.1,
            stiffness_unknown: false,
            bodies: Vec::new(),
            masses: Vec::new(),
            // Masses are weighed or computed.
            mass_sigma: 0.02,
            terms: None,
            term_priors: Vec::new(),
            redundant: Redundancy::default(),
            frame: FrameChoice::Nests,
            target: TargetChoice::Measured,
            instrument: InstrumentChoice::AsStated,
            unmodelled_sigma: 0.0,
            machine_noise: MachineNoiseChoice::AsNeeded,
            tolerance: None,
            bounds: Vec::new(),
            solver: SolverOptions::default(),
        }
    }

    /// Checks the numbers that apply in every mode; those of priors are checked where a mode uses them.
    pub(super) fn check(&self) -> Result<(), IdentifyError> {
        let SolverOptions { loss, loss_scale, relative_decrease, absolute_decrease, gradient, .. } =
            self.solver;
        let not_negative = |value: f64| value >= 0.0 && value.is_finite();
        for (field, value) in [
            ("unmodelled_sigma", self.unmodelled_sigma),
            ("solver.relative_decrease", relative_decrease),
            ("solver.absolute_decrease", absolute_decrease),
            ("solver.gradient", gradient),
        ] {
            if !not_negative(value) {
                return Err(IdentifyError::Number {
                    field,
                    value,
                    expected: "a finite number of zero or more",
                });
            }
        }
        let constant = match loss {
            Loss::Squared => None,
            Loss::Huber { k } | Loss::Cauchy { k } | Loss::Tukey { k } => Some(("solver.loss", k)),
        };
        let scale = match loss_scale {
            LossScale::Estimated => None,
            LossScale::Fixed(scale) => Some(("solver.loss_scale", scale)),
        };
        for (field, value) in constant.into_iter().chain(scale) {
            if !(value > 0.0 && value.is_finite()) {
                return Err(IdentifyError::Number { field, value, expected: "a finite number above zero" });
            }
        }
        Ok(())
    }

    /// Which of the robot's ends these stations and targets leave free under these options.
    pub(super) fn freedom(&self, stations: &[Station], targets: &[Target]) -> Freedom {
        let free = |station: &Station| self.frame.of(station) == FrameChoice::Free;
        let identified = |target: &Target| self.target.of(target) == TargetChoice::Identified;
        let mut turned = targets.iter().filter_map(|target| target.orientation.as_ref()).peekable();
        let unknown = |o: &TargetOrientation| self.target.of_orientation(o) == TargetChoice::Identified;
        Freedom {
            frame: stations.iter().all(free),
            target: targets.iter().all(identified),
            orientation: turned.peek().is_some().then(|| turned.all(unknown)),
        }
    }

    /// Like [`freedom`](Self::freedom), for a set: only its readings show whether the orientation of a target is seen.
    pub(super) fn freedom_in(&self, set: &MeasurementSet) -> Freedom {
        let free = self.freedom(&set.stations, &set.targets);
        Freedom { orientation: free.orientation.filter(|_| set.has_poses()), ..free }
    }

    /// Coordinates that are fixed by name for target 0, and so for every target that is not named itself.
    pub(super) fn fixed_of_all_targets(&self) -> Vec<ParameterId> {
        let axes = ParameterId::all_of_target(0).into_iter().chain(ParameterId::all_of_orientation(0));
        axes.filter(|id| self.fix.contains(id)).collect()
    }

    /// Whether a coordinate of a target may be a parameter.
    pub(super) fn fits_target(&self, id: ParameterId) -> bool {
        !self.fix.contains(&id) && (self.target != TargetChoice::Fixed || self.free.contains(&id))
    }

    /// Whether a family of terms is fitted.
    pub(super) fn has_terms(&self, family: &str) -> bool {
        let is_on_request = || FAMILIES.iter().any(|known| known.key() == family && known.is_on_request());
        self.terms.as_ref().map_or_else(|| !is_on_request(), |keys| keys.iter().any(|key| key == family))
    }

    /// Standard deviation of a family's amplitudes, m or rad, where it replaces the family's own.
    pub(super) fn term_sigma(&self, family: &str, unit: Unit) -> Option<f64> {
        self.term_priors.iter().filter(|prior| prior.family == family).find_map(|prior| match unit {
            Unit::Metre => prior.length,
            Unit::Radian | Unit::One => prior.angle,
        })
    }
}
