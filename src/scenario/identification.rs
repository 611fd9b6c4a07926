//! `[identification]` of a scenario: what is fitted, and how.

use serde::Deserialize;

use crate::identification::{
    ComplianceChoice, FrameChoice, IdentificationOptions, LINKAGE, Loss, Mode, ParameterChoice, Redundancy,
    SolverOptions, TargetChoice, TermPrior, Tolerance,
};
use crate::input::{InputError, Source, Spanned};
use crate::model::{CalibrationModel, FAMILIES, ParameterId, Robot};

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub(super) struct IdentificationFile {
    modes: Option<Spanned<Vec<ModeFile>>>,
    parameters: Option<Spanned<toml::Value>>,
    extended_parameters: Option<Spanned<toml::Value>>,
    tolerance_mm: Option<Spanned<f64>>,
    tolerance_mrad: Option<Spanned<f64>>,
    compliances: Option<Spanned<toml::Value>>,
    compliance_sigma: Option<Spanned<f64>>,
    masses: Option<Spanned<Vec<Spanned<String>>>>,
    mass_sigma: Option<Spanned<f64>>,
    terms: Option<Spanned<Vec<Spanned<String>>>>,
    #[serde(default)]
    term_prior: Vec<TermPriorFile>,
    redundant: Option<RedundantFile>,
    frame: Option<FrameFile>,
    target: Option<TargetFile>,
    unmodelled_sigma_um: Option<Spanned<f64>>,
    max_iterations: Option<Spanned<usize>>,
    loss: Option<LossFile>,
    starts: Option<Spanned<u32>>,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "snake_case")]
enum LossFile {
    Squared,
    Huber,
    Cauchy,
    Tukey,
}

/// Starts of one fit: a minute or so of searching.
const MOST_STARTS: u32 = 1000;

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "snake_case")]
pub(super) enum ModeFile {
    WithoutCalibration,
    OnlyCalibration,
    WithGravity,
    ElastoGeometric,
    Extended,
}

impl From<ModeFile> for Mode {
    fn from(mode: ModeFile) -> Self {
        match mode {
            ModeFile::WithoutCalibration => Self::WithoutCalibration,
            ModeFile::OnlyCalibration => Self::OnlyCalibration,
            ModeFile::WithGravity => Self::WithGravity,
            ModeFile::ElastoGeometric => Self::ElastoGeometric,
            ModeFile::Extended => Self::Extended,
        }
    }
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "snake_case")]
enum RedundantFile {
    Fix,
    Prior,
    Keep,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "snake_case")]
enum FrameFile {
    Nests,
    Free,
    Fixed,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "snake_case")]
enum TargetFile {
    Measured,
    Identified,
    Fixed,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TermPriorFile {
    family: Spanned<String>,
    sigma_um: Option<Spanned<f64>>,
    sigma_rad: Option<Spanned<f64>>,
}

impl IdentificationFile {
    /// The rows of the tables.
    pub(super) fn modes(&self, source: &Source) -> Result<Vec<Mode>, InputError> {
        let Some(modes) = &self.modes else { return Ok(Mode::ALL.to_vec()) };
        if modes.get_ref().is_empty() {
            let help = Some("expected at least one mode, or no key modes for all of them".to_owned());
            return Err(source.error(modes.span(), "identification.modes is empty", help));
        }
        let wanted = |mode: &Mode| modes.get_ref().iter().any(|f| Mode::from(*f) == *mode);
        Ok(Mode::ALL.into_iter().filter(wanted).collect())
    }

    /// What is fitted.
    pub(super) fn options(
        &self,
        source: &Source,
        robot: &Robot,
    ) -> Result<IdentificationOptions, InputError> {
        let model = &robot.model;
        let defaults = IdentificationOptions::default();
        let mut options = IdentificationOptions {
            compliance_sigma: robot.compliance_sigma.unwrap_or(defaults.compliance_sigma),
            ..defaults
        };
        let links = model.kinematics.joint_count();
        if let Some(parameters) = &self.parameters {
            options.parameters = parameter_choice(source, "parameters", parameters, links)?;
        }
        if let Some(parameters) = &self.extended_parameters {
            options.extended_parameters = parameter_choice(source, "extended_parameters", parameters, links)?;
        }
        options.tolerance = self.tolerance(source)?;
        if let Some(compliances) = &self.compliances {
            options.compliances = compliance_choice(source, compliances, model)?;
        }
        if let Some(sigma) = &self.compliance_sigma {
            options.compliance_sigma = source.positive("identification.compliance_sigma", sigma)?;
        }
        if let Some(masses) = &self.masses {
            options.masses = self::masses(source, masses, links)?;
        }
        if let Some(sigma) = &self.mass_sigma {
            options.mass_sigma = source.positive("identification.mass_sigma", sigma)?;
        }
        if let Some(terms) = &self.terms {
            let keys = terms.get_ref().iter();
            options.terms = Some(keys.map(|key| family(source, "terms", key)).collect::<Result<_, _>>()?);
        }
        for prior in &self.term_prior {
            options.term_priors.push(term_prior(source, prior)?);
        }
        if let Some(redundant) = self.redundant {
            options.redundant = match redundant {
                RedundantFile::Fix => Redundancy::Fix,
                RedundantFile::Prior => Redundancy::Prior,
                RedundantFile::Keep => Redundancy::Keep,
            };
        }
        if let Some(frame) = self.frame {
            options.frame = match frame {
                FrameFile::Nests => FrameChoice::Nests,
                FrameFile::Free => FrameChoice::Free,
                FrameFile::Fixed => FrameChoice::Fixed,
            };
        }
        if let Some(target) = self.target {
            options.target = match target {
                TargetFile::Measured => TargetChoice::Measured,
                TargetFile::Identified => TargetChoice::Identified,
                TargetFile::Fixed => TargetChoice::Fixed,
            };
        }
        if let Some(sigma) = &self.unmodelled_sigma_um {
            options.unmodelled_sigma =
                1e-6 * source.not_negative("identification.unmodelled_sigma_um", sigma)?;
        }
        if let Some(limit) = &self.max_iterations {
            let max_iterations = *limit.get_ref();
            if max_iterations == 0 {
                let help = Some("expected at least one iteration".to_owned());
                return Err(source.error(limit.span(), "identification.max_iterations is 0", help));
            }
            options.solver = SolverOptions { max_iterations, ..options.solver };
        }
        if let Some(loss) = self.loss {
            options.solver.loss = match loss {
                LossFile::Squared => Loss::Squared,
                LossFile::Huber => Loss::huber(),
                LossFile::Cauchy => Loss::cauchy(),
                LossFile::Tukey => Loss::tukey(),
            };
        }
        if let Some(starts) = &self.starts {
            if !(1..=MOST_STARTS).contains(starts.get_ref()) {
                let help = Some(format!("expected 1 to {MOST_STARTS} starts"));
                let what = format!("identification.starts is {}", starts.get_ref());
                return Err(source.error(starts.span(), what, help));
            }
            options.solver.starts = *starts.get_ref();
        }
        Ok(options)
    }

    /// The prior on the link parameters, for lengths and angles or for neither.
    fn tolerance(&self, source: &Source) -> Result<Option<Tolerance>, InputError> {
        let alone = |given: &Spanned<f64>, key: &str, other: &str| {
            let help = Some(format!("expected {other} as well, or neither"));
            Err(source.error(given.span(), format!("identification.{key} stands alone"), help))
        };
        match (&self.tolerance_mm, &self.tolerance_mrad) {
            (None, None) => Ok(None),
            (Some(given), None) => alone(given, "tolerance_mm", "tolerance_mrad"),
            (None, Some(given)) => alone(given, "tolerance_mrad", "tolerance_mm"),
            (Some(length), Some(angle)) => Ok(Some(Tolerance {
                length: 1e-3 * source.positive("identification.tolerance_mm", length)?,
                angle: 1e-3 * source.positive("identification.tolerance_mrad", angle)?,
            })),
        }
    }
}

fn parameter_choice(
    source: &Source,
    key: &str,
    value: &Spanned<toml::Value>,
    links: usize,
) -> Result<ParameterChoice, InputError> {
    let refused = |what: String| {
        source.error(
            value.span(),
            format!("identification.{key}: {what}"),
            Some(format!(
                "expected \"neighbour_axis_rules\", \"complete\", or a list of delta_a, delta_alpha, delta_beta, delta_d, \
                 delta_theta with a joint number from 1 to {links}, such as [\"delta_a2\", \"delta_theta4\"]"
            )),
        )
    };
    let listed = |name: &toml::Value| {
        let known = name.as_str().and_then(ParameterId::parse);
        match known {
            Some(id @ ParameterId::Link { link, .. }) if link < links => Ok(id),
            _ => Err(refused(format!("{name} is not a link parameter of this robot"))),
        }
    };
    match value.get_ref() {
        toml::Value::String(name) if name == "neighbour_axis_rules" => {
            Ok(ParameterChoice::NeighbourAxisRules)
        }
        toml::Value::String(name) if name == "complete" => Ok(ParameterChoice::Complete),
        toml::Value::Array(names) => {
            Ok(ParameterChoice::Listed(names.iter().map(listed).collect::<Result<_, _>>()?))
        }
        other => Err(refused(format!("{other} is no choice"))),
    }
}

fn compliance_choice(
    source: &Source,
    value: &Spanned<toml::Value>,
    model: &CalibrationModel,
) -> Result<ComplianceChoice, InputError> {
    let known = model.compliances();
    let refused = |what: String| {
        let names = known.iter().map(|compliance| format!("\"{}\"", ParameterId::Compliance(*compliance)));
        let names: Vec<_> = names.collect();
        source.error(
            value.span(),
            format!("identification.compliances: {what}"),
            Some(format!("expected \"drives\", \"all\", or a list of: {}", names.join(", "))),
        )
    };
    let listed = |name: &toml::Value| match name.as_str().and_then(ParameterId::parse) {
        Some(ParameterId::Compliance(compliance)) if known.contains(&compliance) => Ok(compliance),
        _ => Err(refused(format!("{name} is not a compliance of this robot"))),
    };
    match value.get_ref() {
        toml::Value::String(name) if name == "drives" => Ok(ComplianceChoice::Drives),
        toml::Value::String(name) if name == "all" => Ok(ComplianceChoice::All),
        toml::Value::Array(names) => {
            Ok(ComplianceChoice::Listed(names.iter().map(listed).collect::<Result<_, _>>()?))
        }
        other => Err(refused(format!("{other} is no choice"))),
    }
}

fn masses(
    source: &Source,
    names: &Spanned<Vec<Spanned<String>>>,
    links: usize,
) -> Result<Vec<usize>, InputError> {
    let index = |name: &Spanned<String>| match ParameterId::parse(name.get_ref()) {
        Some(ParameterId::Mass { link }) if link < links => Ok(link),
        _ => Err(source.error(
            name.span(),
            format!("identification.masses: \"{}\" is not a mass of this robot", name.get_ref()),
            Some(format!("expected names from \"mass1\" to \"mass{links}\"")),
        )),
    };
    names.get_ref().iter().map(index).collect()
}

/// The key of a family that there is.
fn family(source: &Source, key: &str, name: &Spanned<String>) -> Result<String, InputError> {
    let known: Vec<_> = std::iter::once(LINKAGE).chain(FAMILIES.iter().map(|family| family.key())).collect();
    if known.contains(&name.get_ref().as_str()) {
        return Ok(name.get_ref().clone());
    }
    Err(source.error(
        name.span(),
        format!("identification.{key}: there are no terms \"{}\"", name.get_ref()),
        Some(format!("expected one of: {}", known.join(", "))),
    ))
}

fn term_prior(source: &Source, file: &TermPriorFile) -> Result<TermPrior, InputError> {
    let family = family(source, "term_prior.family", &file.family)?;
    if file.sigma_um.is_none() && file.sigma_rad.is_none() {
        return Err(source.error(
            file.family.span(),
            format!("identification.term_prior of \"{family}\" has no sigma"),
            Some("expected sigma_um, sigma_rad or both".to_owned()),
        ));
    }
    let positive = |key: &str, sigma: &Option<Spanned<f64>>| {
        sigma.as_ref().map(|sigma| source.positive(key, sigma)).transpose()
    };
    Ok(TermPrior {
        family,
        length: positive("identification.term_prior.sigma_um", &file.sigma_um)?.map(|um| 1e-6 * um),
        angle: positive("identification.term_prior.sigma_rad", &file.sigma_rad)?,
    })
}
