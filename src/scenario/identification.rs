//! `[identification]` of a scenario: what is fitted, and how.

use std::collections::BTreeMap;

use serde::Deserialize;

use calibrig_estimation::identification::{
    ComplianceChoice, FrameChoice, IdentificationOptions, InstrumentChoice, LINKAGE, Loss,
    MachineNoiseChoice, Mode, ParameterBound, ParameterBoundError, ParameterChoice, Redundancy, RefusedBound,
    SolverOptions, TargetChoice, TermPrior, Tolerance, check_bounds, check_named,
};
use calibrig_files::Robot;
use calibrig_files::{InputError, Source, Spanned};
use calibrig_model::measurement::{Station, Target};
use calibrig_model::{CalibrationModel, FAMILIES, JointKind, ParameterId, Unit};

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub(super) struct IdentificationFile {
    modes: Option<Spanned<Vec<ModeFile>>>,
    parameters: Option<Spanned<toml::Value>>,
    extended_parameters: Option<Spanned<toml::Value>>,
    #[serde(default)]
    fix: Vec<Spanned<String>>,
    #[serde(default)]
    free: Vec<Spanned<String>>,
    tolerance_mm: Option<Spanned<f64>>,
    tolerance_mrad: Option<Spanned<f64>>,
    compliances: Option<Spanned<toml::Value>>,
    compliance_sigma: Option<Spanned<f64>>,
    masses: Option<Spanned<Vec<Spanned<String>>>>,
    mass_sigma: Option<Spanned<f64>>,
    terms: Option<Spanned<Vec<Spanned<String>>>>,
    #[serde(default)]
    term_prior: Vec<TermPriorFile>,
    #[serde(default)]
    bound: Vec<BoundFile>,
    redundant: Option<RedundantFile>,
    frame: Option<FrameFile>,
    instrument: Option<InstrumentFile>,
    target: Option<TargetFile>,
    unmodelled_sigma_um: Option<Spanned<f64>>,
    machine_noise: Option<Spanned<MachineNoiseFile>>,
    actuator_sigma_um: Option<Spanned<BTreeMap<String, Spanned<f64>>>>,
    actuator_sigma_mrad: Option<Spanned<BTreeMap<String, Spanned<f64>>>>,
    max_iterations: Option<Spanned<usize>>,
    loss: Option<LossFile>,
    starts: Option<Spanned<u32>>,
}

#[derive(Deserialize, Clone, Copy, PartialEq)]
#[serde(rename_all = "snake_case")]
enum MachineNoiseFile {
    AsNeeded,
    Estimated,
    Stated,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "snake_case")]
enum LossFile {
    Squared,
    Huber,
    Cauchy,
    Tukey,
}

/// Most starts of one fit: a minute or so of searching.
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
    Sweeps,
    Free,
    Fixed,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "snake_case")]
enum InstrumentFile {
    AsStated,
    Ignored,
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

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct BoundFile {
    parameter: Spanned<String>,
    min_mm: Option<Spanned<f64>>,
    max_mm: Option<Spanned<f64>>,
    min_mrad: Option<Spanned<f64>>,
    max_mrad: Option<Spanned<f64>>,
    min: Option<Spanned<f64>>,
    max: Option<Spanned<f64>>,
}

/// The keys of a bound's limits with their unit, and its size in SI.
const BOUND_KEYS: [(Unit, [&str; 2], f64); 3] = [
    (Unit::Metre, ["min_mm", "max_mm"], 1e-3),
    (Unit::Radian, ["min_mrad", "max_mrad"], 1e-3),
    (Unit::One, ["min", "max"], 1.0),
];

impl BoundFile {
    fn limits(&self, unit: Unit) -> [&Option<Spanned<f64>>; 2] {
        match unit {
            Unit::Metre => [&self.min_mm, &self.max_mm],
            Unit::Radian => [&self.min_mrad, &self.max_mrad],
            Unit::One => [&self.min, &self.max],
        }
    }

    fn read(&self, source: &Source) -> Result<ParameterBound, InputError> {
        let name = self.parameter.get_ref();
        let id = ParameterId::parse(name).ok_or_else(|| {
            source.error(
                self.parameter.span(),
                format!("identification.bound.parameter is \"{name}\", which is not the name of a parameter"),
                Some(format!("expected {}", ParameterId::EXAMPLES)),
            )
        })?;
        let mut bound = ParameterBound { id, lower: f64::NEG_INFINITY, upper: f64::INFINITY };
        for (unit, keys, size) in BOUND_KEYS {
            for (limit, key) in self.limits(unit).into_iter().zip(keys) {
                let Some(value) = limit else { continue };
                if unit != id.unit() {
                    return Err(wrong_unit(source, id, key, value));
                }
                let number = size * source.finite(&format!("identification.bound.{key}"), value)?;
                if key.starts_with("min") { bound.lower = number } else { bound.upper = number }
            }
        }
        bound.check().map_err(|error| self.refused(source, &error))?;
        Ok(bound)
    }

    /// At the limit that is wrong, else at the parameter.
    fn refused(&self, source: &Source, error: &ParameterBoundError) -> InputError {
        let limit = |upper: bool| {
            BOUND_KEYS.iter().find_map(|(unit, ..)| {
                let [low, high] = self.limits(*unit);
                (if upper { high } else { low }).as_ref().map(Spanned::span)
            })
        };
        let place = match error {
            ParameterBoundError::Empty { .. } => limit(true),
            ParameterBoundError::BelowNone { .. } => limit(false),
            ParameterBoundError::ExcludesStart { bound } => limit(bound.upper < 0.0),
            _ => None,
        };
        let help = match error {
            ParameterBoundError::Open { id } => format!("expected {}", keys_of(id.unit())),
            error => error.help(),
        };
        let place = place.unwrap_or_else(|| self.parameter.span());
        source.error(place, format!("identification.bound: {error}"), Some(help))
    }
}

fn keys_of(unit: Unit) -> String {
    let keys = BOUND_KEYS.iter().find(|(of, ..)| *of == unit).map_or(["min", "max"], |(_, keys, _)| *keys);
    format!("{}, {} or both: the unit is part of the key", keys[0], keys[1])
}

fn wrong_unit(source: &Source, id: ParameterId, key: &str, value: &Spanned<f64>) -> InputError {
    let what = match id.unit() {
        Unit::Metre => "a length",
        Unit::Radian => "an angle",
        Unit::One => "a relative deviation",
    };
    source.error(
        value.span(),
        format!("identification.bound.{key}: {id} is {what}"),
        Some(format!("expected {}", keys_of(id.unit()))),
    )
}

/// `options` with what the robot's files state about its compliances, masses and centres.
pub fn with_stated_of(robot: &Robot, options: IdentificationOptions) -> IdentificationOptions {
    IdentificationOptions {
        compliance_sigma: robot.compliance_sigma.unwrap_or(options.compliance_sigma),
        stiffness_unknown: robot.stiffness_unknown,
        bodies: robot.bodies.clone(),
        ..options
    }
}

impl IdentificationFile {
    /// What is known about the machine's random errors.
    fn machine_noise(
        &self,
        source: &Source,
        model: &CalibrationModel,
    ) -> Result<MachineNoiseChoice, InputError> {
        let links = &model.kinematics.links;
        let mut sigmas = vec![0.0; links.len()];
        let groups = [
            (&self.actuator_sigma_um, "actuator_sigma_um", JointKind::Prismatic, 1e-6),
            (&self.actuator_sigma_mrad, "actuator_sigma_mrad", JointKind::Revolute, 1e-3),
        ];
        let mut any = false;
        for (table, key, kind, size) in groups {
            for (name, sigma) in table.iter().flat_map(Spanned::get_ref) {
                let of_kind = links.iter().position(|link| link.name == *name && link.kind == kind);
                let Some(place) = of_kind else {
                    let known = links.iter().filter(|link| link.kind == kind).map(|link| link.name.as_str());
                    let known = known.collect::<Vec<_>>().join(", ");
                    let help = Some(format!("expected some of: {known}"));
                    let text =
                        format!("identification.{key}: no actuator with this unit is named \"{name}\"");
                    return Err(source.error(sigma.span(), text, help));
                };
                sigmas[place] = size * source.not_negative(&format!("identification.{key}.{name}"), sigma)?;
                any = true;
            }
        }
        let Some(choice) = &self.machine_noise else {
            return Ok(if any { MachineNoiseChoice::Stated(sigmas) } else { MachineNoiseChoice::AsNeeded });
        };
        match choice.get_ref() {
            MachineNoiseFile::Stated => Ok(MachineNoiseChoice::Stated(sigmas)),
            _ if any => Err(source.error(
                choice.span(),
                "identification.machine_noise leaves to the fit what actuator_sigma_* states",
                Some("expected machine_noise = \"stated\" with standard deviations of actuators".to_owned()),
            )),
            MachineNoiseFile::AsNeeded => Ok(MachineNoiseChoice::AsNeeded),
            MachineNoiseFile::Estimated => Ok(MachineNoiseChoice::Estimated),
        }
    }

    /// The rows of the tables: without the key all that the robot can have; `bends` says if it deflects.
    pub(super) fn modes(&self, source: &Source, bends: bool) -> Result<Vec<Mode>, InputError> {
        let possible =
            |mode: &Mode| bends || matches!(mode, Mode::WithoutCalibration | Mode::OnlyCalibration);
        let Some(modes) = &self.modes else { return Ok(Mode::ALL.into_iter().filter(possible).collect()) };
        if modes.get_ref().is_empty() {
            let help = Some("expected at least one mode; leave the key modes out for all of them".to_owned());
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
        let mut options = with_stated_of(robot, IdentificationOptions::published());
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
            options.stiffness_unknown = false;
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
            let prior = term_prior(source, prior, &options.term_priors)?;
            options.term_priors.push(prior);
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
                FrameFile::Sweeps => FrameChoice::Sweeps,
                FrameFile::Free => FrameChoice::Free,
                FrameFile::Fixed => FrameChoice::Fixed,
            };
        }
        if let Some(instrument) = self.instrument {
            options.instrument = match instrument {
                InstrumentFile::AsStated => InstrumentChoice::AsStated,
                InstrumentFile::Ignored => InstrumentChoice::Ignored,
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
        options.machine_noise = self.machine_noise(source, model)?;
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
        self.by_name(source, model, &mut options)?;
        self.bounds(source, model, &mut options)?;
        Ok(options)
    }

    /// Takes over what is fixed and freed by name.
    fn by_name(
        &self,
        source: &Source,
        model: &CalibrationModel,
        options: &mut IdentificationOptions,
    ) -> Result<(), InputError> {
        let id = |key: &str, name: &Spanned<String>| {
            ParameterId::parse(name.get_ref()).ok_or_else(|| {
                source.error(
                    name.span(),
                    format!("identification.{key}: \"{}\" is not the name of a parameter", name.get_ref()),
                    Some(format!("expected {}", ParameterId::EXAMPLES)),
                )
            })
        };
        options.fix = self.fix.iter().map(|name| id("fix", name)).collect::<Result<_, _>>()?;
        options.free = self.free.iter().map(|name| id("free", name)).collect::<Result<_, _>>()?;
        // A simulated session has one station and one target.
        let (stations, targets) = ([Station::default()], [Target::default()]);
        check_named(model, &self.modes(source, model.statics.is_some())?, options, &stations, &targets)
            .map_err(|error| {
                let of = |name: &&Spanned<String>| ParameterId::parse(name.get_ref()) == Some(error.id());
                let place = self.free.iter().chain(&self.fix).find(of).map_or(0..0, Spanned::span);
                source.error(place, format!("identification: {error}"), Some(error.help()))
            })
    }

    /// Adds the bounds, on parameters that these options fit.
    fn bounds(
        &self,
        source: &Source,
        model: &CalibrationModel,
        options: &mut IdentificationOptions,
    ) -> Result<(), InputError> {
        for file in &self.bound {
            options.bounds.push(file.read(source)?);
        }
        // A simulated session has one station and one target.
        check_bounds(
            model,
            &self.modes(source, model.statics.is_some())?,
            options,
            &[Station::default()],
            &[Target::default()],
        )
        .map_err(|RefusedBound { index, error }| self.bound[index].refused(source, &error))
    }

    /// The prior on the link parameters, for both lengths and angles or for neither.
    fn tolerance(&self, source: &Source) -> Result<Option<Tolerance>, InputError> {
        let alone = |given: &Spanned<f64>, key: &str, other: &str| {
            let help = Some(format!("expected {other} as well, or neither of them"));
            Err(source.error(
                given.span(),
                format!("identification.{key} is given without its counterpart"),
                help,
            ))
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
        other => Err(refused(format!("{other} is not a valid choice"))),
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
        other => Err(refused(format!("{other} is not a valid choice"))),
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

/// The key of an existing family.
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

fn term_prior(source: &Source, file: &TermPriorFile, before: &[TermPrior]) -> Result<TermPrior, InputError> {
    let family = family(source, "term_prior.family", &file.family)?;
    if before.iter().any(|other| other.family == family) {
        return Err(source.error(
            file.family.span(),
            format!("identification.term_prior: a second prior of \"{family}\""),
            Some("expected one prior per family, with sigma_um and sigma_rad in it".to_owned()),
        ));
    }
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
