//! What to fit, and how.

use super::{IdentifyError, Loss, LossScale, MachineNoiseChoice, Mode, ParameterBound, SolverOptions};
use calibrig_model::measurement::{MeasurementSet, Station, Target, TargetOrientation};
use calibrig_model::{BodyUncertainty, Compliance, FAMILIES, ParameterId, Unit};
use serde::{Deserialize, Serialize};

/// What is known of the tracker's place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FrameChoice {
    /// What the set says of each station: [`Nests`](Self::Nests) where at least three were measured, else [`Sweeps`](Self::Sweeps) where it
    /// has some, else [`Free`](Self::Free).
    #[default]
    AsStated,
    /// The base nests place the tracker: their readings tie it to the first links.
    Nests,
    /// [Sweeps](crate::circle_points) of two of the robot's axes place the tracker; their uncertainty is a prior in the fit.
    Sweeps,
    /// Nothing: six free parameters a station.
    Free,
    /// The nests' result is taken as exact.
    Fixed,
}

/// Whether a station has nests enough to be placed by them.
pub(super) fn is_placed(station: &Station) -> bool {
    station.distinct_nests().len() >= 3
}

/// What is known of the target's offset. How a target with axes is turned on the flange is a prior where an uncertainty of it is stated, else
/// identified; with [`Identified`](Self::Identified) and [`Fixed`](Self::Fixed) as they say.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum TargetChoice {
    /// What the set says of each target: [`Measured`](Self::Measured) where it states an uncertainty, else [`Identified`](Self::Identified).
    #[default]
    AsStated,
    /// It was measured; its uncertainty is a prior in the fit.
    Measured,
    /// Nothing: three free parameters a target.
    Identified,
    /// The stated value is taken as exact.
    Fixed,
}

impl FrameChoice {
    /// The choice for one station.
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
    /// The choice for one target.
    pub(super) fn of(self, target: &Target) -> Self {
        match self {
            Self::AsStated if target.covariance.is_some() => Self::Measured,
            Self::AsStated => Self::Identified,
            choice => choice,
        }
    }

    /// The choice for how one target is turned on the flange: an offset can have been measured without it.
    pub(super) fn of_orientation(self, orientation: &TargetOrientation) -> Self {
        match self {
            Self::AsStated | Self::Measured if orientation.covariance.is_some() => Self::Measured,
            Self::AsStated | Self::Measured => Self::Identified,
            choice => choice,
        }
    }
}

/// What of a set ties the robot's ends: without it, only what does not depend on them can be told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Freedom {
    /// No station is placed by anything but the measurements of the robot.
    pub frame: bool,
    /// No target's offset is known.
    pub target: bool,
    /// Of targets that are seen with their orientation, that of none is known how it is turned on the flange; `None` where all are points.
    pub orientation: Option<bool>,
}

/// What becomes of the errors that an instrument's readings share.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum InstrumentChoice {
    /// Those that the set states of a station's instrument are identified, with what is stated as a prior.
    #[default]
    AsStated,
    /// There are none: every reading errs by itself.
    Ignored,
}

/// Which link parameters are identified.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ParameterChoice {
    /// What the published rules on neighbouring axes leave (24 for the spray-painting robot).
    NeighbourAxisRules,
    /// A complete independent set of all five parameters a link, found by rank.
    Complete,
    /// These.
    Listed(Vec<ParameterId>),
}

/// Which compliances are identified in the coupled modes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ComplianceChoice {
    /// Of the drives and the four-bar's rod, as far as they yield and gravity loads them.
    Drives,
    /// Of drives, bearings, beams and rod, as far as they yield and gravity loads them.
    All,
    /// These, also where gravity does not load them.
    Listed(Vec<Compliance>),
}

/// What becomes of a parameter that the measurements cannot tell from others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Redundancy {
    /// It stays at its nominal value and is no parameter of the fit.
    Fix,
    /// Where it has a prior, that holds it; otherwise the system has no full rank, as with [`Keep`](Self::Keep).
    #[default]
    Prior,
    /// It stays, and the system is judged by what the measurements alone tell of it.
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

/// The key that adds the lengths of the four-bar to the extended mode; the other families are
/// [`FAMILIES`](calibrig_model::FAMILIES).
pub const LINKAGE: &str = "linkage";

/// Another prior than a family's own.
#[derive(Debug, Clone, PartialEq)]
pub struct TermPrior {
    /// Key of the family.
    pub family: String,
    /// Standard deviation of amplitudes that are lengths, m.
    pub length: Option<f64>,
    /// Standard deviation of amplitudes that are angles, rad.
    pub angle: Option<f64>,
}

/// Standard deviation of a zero-mean normal prior on the link parameters' deviations: how well the robot was made. It holds directions
/// that the measurements hardly show at values that a machine can have; rank and weak directions are those of the data without it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Tolerance {
    /// Of lengths, m.
    pub length: f64,
    /// Of angles, rad.
    pub angle: f64,
}

/// What to fit, and how.
#[derive(Debug, Clone, PartialEq)]
pub struct IdentificationOptions {
    /// Which model.
    pub mode: Mode,
    /// Link parameters.
    pub parameters: ParameterChoice,
    /// Link parameters of the extended mode.
    pub extended_parameters: ParameterChoice,
    /// Parameters that stay at their nominal, stated or predicted values, whatever else asks for them. None of the tracker's place.
    pub fix: Vec<ParameterId>,
    /// Parameters that are fitted whatever else leaves them out: of link parameters that cannot be told from each other these are taken, a
    /// compliance also where gravity does not load it, a coordinate of a target without the prior of what was measured of it.
    pub free: Vec<ParameterId>,
    /// Compliances of the coupled modes.
    pub compliances: ComplianceChoice,
    /// Standard deviation of the prior on the relative deviation of a compliance from its predicted value.
    pub compliance_sigma: f64,
    /// Whether nothing is known of the stiffnesses: in place of `compliance_sigma`, a prior on the logarithm of every compliance over its
    /// predicted one, with [`UNKNOWN_STIFFNESS`] as its standard deviation.
    pub stiffness_unknown: bool,
    /// How well the bodies' masses and centres are known, one entry a link; none where they are taken as exact. In the coupled modes those
    /// that the measurements feel are parameters of the fit, with these priors, so that what is told of the compliances contains them.
    pub bodies: Vec<BodyUncertainty>,
    /// Links whose mass is identified in the coupled modes, by index.
    pub masses: Vec<usize>,
    /// Standard deviation of the prior on the relative deviation of a mass.
    pub mass_sigma: f64,
    /// Families of terms of the extended mode by their keys, [`LINKAGE`] among them; `None` for all that the robot can have but those that
    /// are fitted [on request](calibrig_model::TermFamily::is_on_request).
    pub terms: Option<Vec<String>>,
    /// Where the families' own priors do not hold.
    pub term_priors: Vec<TermPrior>,
    /// What becomes of redundant parameters.
    pub redundant: Redundancy,
    /// The tracker's place.
    pub frame: FrameChoice,
    /// The target's offset.
    pub target: TargetChoice,
    /// Errors that the readings of an instrument share.
    pub instrument: InstrumentChoice,
    /// Standard deviation of what the model leaves out, per axis, m; added to the readings' covariance. A stated choice, of places: what
    /// orientations scatter by beside their readings is found where the residuals ask for it.
    pub unmodelled_sigma: f64,
    /// What the machine does beside its model, pose by pose.
    pub machine_noise: MachineNoiseChoice,
    /// A prior on every link parameter, where stated.
    pub tolerance: Option<Tolerance>,
    /// Limits of single parameters; each holds in the modes that have the parameter.
    pub bounds: Vec<ParameterBound>,
    /// What the solver minimises, and when it stops.
    pub solver: SolverOptions,
}

/// Standard deviation of the logarithm of a compliance over its predicted one where nothing is known of it: a factor of 100.
pub const UNKNOWN_STIFFNESS: f64 = 4.605_170_185_988_092;

/// How well a robot's links are taken to be made where nobody says: 10 mm and 20 mrad, far more than a workshop leaves.
pub const DEFAULT_TOLERANCE: Tolerance = Tolerance { length: 10e-3, angle: 20e-3 };

/// What holds for any robot and any set: a complete independent set of link parameters with a prior of the making's [tolerance](DEFAULT_TOLERANCE),
/// tracker and target as far as the set states them. [`Estimate::assumptions`](super::Estimate::assumptions) tells what came of it.
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
    /// As the publication identifies (Y. Wang et al., Machines 11 (2023) 20): what the rules on neighbouring axes keep, without a prior; the
    /// tracker placed by its nests, the target measured.
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
            // A weighed or computed mass.
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

    /// Whether the numbers that hold in every mode can be; those of priors are looked at where a mode has them.
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

    /// What of these stations and targets ties the robot's ends under these options.
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

    /// The same of a set, of whose targets only readings tell whether their orientation is seen.
    pub(super) fn freedom_in(&self, set: &MeasurementSet) -> Freedom {
        let free = self.freedom(&set.stations, &set.targets);
        Freedom { orientation: free.orientation.filter(|_| set.has_poses()), ..free }
    }

    /// Coordinates that are fixed by name in target 0, and so in all that have no target of their own by name.
    pub(super) fn fixed_of_all_targets(&self) -> Vec<ParameterId> {
        let axes = ParameterId::all_of_target(0).into_iter().chain(ParameterId::all_of_orientation(0));
        axes.filter(|id| self.fix.contains(id)).collect()
    }

    /// Whether a coordinate of a target may be a parameter.
    pub(super) fn fits_target(&self, id: ParameterId) -> bool {
        !self.fix.contains(&id) && (self.target != TargetChoice::Fixed || self.free.contains(&id))
    }

    /// Whether a family of terms is switched on.
    pub(super) fn has_terms(&self, family: &str) -> bool {
        let is_on_request = || FAMILIES.iter().any(|known| known.key() == family && known.is_on_request());
        self.terms.as_ref().map_or_else(|| !is_on_request(), |keys| keys.iter().any(|key| key == family))
    }

    /// Standard deviation of a family's amplitudes, m or rad, where it is not the family's own.
    pub(super) fn term_sigma(&self, family: &str, unit: Unit) -> Option<f64> {
        self.term_priors.iter().filter(|prior| prior.family == family).find_map(|prior| match unit {
            Unit::Metre => prior.length,
            Unit::Radian | Unit::One => prior.angle,
        })
    }
}
