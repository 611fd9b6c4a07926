//! What to fit, and how.

use super::{Mode, ParameterBound, SolverOptions};
use calibrig_model::measurement::{MeasurementSet, Station};
use calibrig_model::{Compliance, ParameterId, Unit};

/// What is known of the tracker's place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrameChoice {
    /// The base nests place the tracker; their uncertainty is a prior in the fit. Where some stations have nests, those without any are free.
    Nests,
    /// Nothing: six free parameters a station.
    Free,
    /// The nests' result is taken as exact.
    Fixed,
}

/// Whether a station has nests enough to be placed by them.
pub(super) fn is_placed(station: &Station) -> bool {
    station.nests.len() >= 3
}

/// What is known of the target's offset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TargetChoice {
    /// It was measured; its uncertainty is a prior in the fit. Where some targets were, those without an uncertainty are free.
    Measured,
    /// Nothing: three free parameters a target.
    Identified,
    /// The stated value is taken as exact.
    Fixed,
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
#[derive(Debug, Clone, Copy, PartialEq)]
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
    /// Compliances of the coupled modes.
    pub compliances: ComplianceChoice,
    /// Standard deviation of the prior on the relative deviation of a compliance from its predicted value.
    pub compliance_sigma: f64,
    /// Links whose mass is identified in the coupled modes, by index.
    pub masses: Vec<usize>,
    /// Standard deviation of the prior on the relative deviation of a mass.
    pub mass_sigma: f64,
    /// Families of terms of the extended mode by their keys, [`LINKAGE`] among them; `None` for all that the robot can have.
    pub terms: Option<Vec<String>>,
    /// Where the families' own priors do not hold.
    pub term_priors: Vec<TermPrior>,
    /// What becomes of redundant parameters.
    pub redundant: Redundancy,
    /// The tracker's place.
    pub frame: FrameChoice,
    /// The target's offset.
    pub target: TargetChoice,
    /// Standard deviation of what the model leaves out, per axis, m; added to the readings' covariance. A stated choice.
    pub unmodelled_sigma: f64,
    /// A prior on every link parameter, where stated.
    pub tolerance: Option<Tolerance>,
    /// Limits of single parameters; each holds in the modes that have the parameter.
    pub bounds: Vec<ParameterBound>,
    /// What the solver minimises, and when it stops.
    pub solver: SolverOptions,
}

impl Default for IdentificationOptions {
    fn default() -> Self {
        Self {
            mode: Mode::OnlyCalibration,
            parameters: ParameterChoice::NeighbourAxisRules,
            extended_parameters: ParameterChoice::Complete,
            compliances: ComplianceChoice::Drives,
            // A stiffness from data sheets and finite elements is rarely right within 10 %.
            compliance_sigma: 0.1,
            masses: Vec::new(),
            // A weighed or computed mass.
            mass_sigma: 0.02,
            terms: None,
            term_priors: Vec::new(),
            redundant: Redundancy::default(),
            frame: FrameChoice::Nests,
            target: TargetChoice::Measured,
            unmodelled_sigma: 0.0,
            tolerance: None,
            bounds: Vec::new(),
            solver: SolverOptions::default(),
        }
    }
}

impl IdentificationOptions {
    /// Frees what `measured` says nothing of: the tracker's place where no station has three nests, the target's offset where none has a stated
    /// uncertainty. Where some have, the fit frees the others itself.
    pub fn fit_to(&mut self, measured: Option<&MeasurementSet>) {
        let Some(set) = measured else { return };
        if self.frame != FrameChoice::Free && !set.stations.iter().any(is_placed) {
            self.frame = FrameChoice::Free;
        }
        if self.target == TargetChoice::Measured && set.targets.iter().all(|t| t.covariance.is_none()) {
            self.target = TargetChoice::Identified;
        }
    }

    /// Whether a family of terms is switched on.
    pub(super) fn has_terms(&self, family: &str) -> bool {
        self.terms.as_ref().is_none_or(|keys| keys.iter().any(|key| key == family))
    }

    /// Standard deviation of a family's amplitudes, m or rad, where it is not the family's own.
    pub(super) fn term_sigma(&self, family: &str, unit: Unit) -> Option<f64> {
        self.term_priors.iter().filter(|prior| prior.family == family).find_map(|prior| match unit {
            Unit::Metre => prior.length,
            Unit::Radian | Unit::One => prior.angle,
        })
    }
}
