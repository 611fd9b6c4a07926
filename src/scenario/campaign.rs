//! `[campaign]`: what varies from trial to trial, and how the trials are laid out.

use std::collections::BTreeSet;
use std::ops::Range;

use calibrig_campaign::design::{Coordinate, Design, Sampling};
use calibrig_campaign::distribution::Distribution;
use serde::{Deserialize, Serialize};

use super::Scenario;
use super::file::parse_varied;
use calibrig_files::{InputError, Source, Spanned};

/// How the trials of a campaign are laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Layout {
    /// Every trial has its own draw.
    #[default]
    Plain,
    /// All combinations of the levels of one or two factors, with common random numbers.
    Sweep,
    /// Sobol's sensitivity indices of every factor.
    Indices,
    /// Elementary effects of every factor, after Morris.
    Screening,
}

/// What varies in a campaign.
#[derive(Debug, Clone, PartialEq)]
pub struct CampaignPlan {
    /// How the trials are laid out.
    pub layout: Layout,
    /// How points are spread.
    pub sampling: Sampling,
    /// Trials of a plain campaign or of each combination of a sweep, rows of the base of indices, trajectories of a screening; `None` for the usual
    /// number.
    pub size: Option<u64>,
    /// Levels of a factor in a screening.
    pub levels: usize,
    /// Error up to which a calibrated robot counts as a success, m.
    pub tolerance: Option<f64>,
    /// What varies.
    pub factors: Vec<Factor>,
}

impl Default for CampaignPlan {
    fn default() -> Self {
        Self {
            layout: Layout::Plain,
            sampling: Sampling::Random,
            size: None,
            levels: USUAL_LEVELS,
            tolerance: None,
            factors: Vec::new(),
        }
    }
}

/// One or more values of the scenario's file that differ from trial to trial.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Factor {
    /// For people.
    pub name: String,
    /// Keys of the file; a table of an array is chosen in brackets.
    pub keys: Vec<String>,
    /// Whether the stated values are multiplied instead of replaced.
    pub scale: bool,
    /// Whether values are rounded to whole numbers.
    pub whole: bool,
    /// Its values.
    pub values: FactorValues,
}

/// The values of a factor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FactorValues {
    /// A number of this distribution, in the unit of the key.
    Drawn(Distribution),
    /// One of these values, as TOML has them.
    Levels(Vec<String>),
}

impl Factor {
    /// Its value at a point of the design, as TOML has it.
    pub fn at(&self, coordinate: Coordinate) -> String {
        let number = match (&self.values, coordinate) {
            (FactorValues::Drawn(distribution), Coordinate::Unit(unit)) => distribution.quantile(unit),
            // A sweep uses levels; without levels, the middle stands for all.
            (FactorValues::Drawn(distribution), Coordinate::Level(_)) => distribution.quantile(0.5),
            (FactorValues::Levels(levels), at) => {
                let last = levels.len().saturating_sub(1);
                let place = match at {
                    Coordinate::Level(level) => level,
                    // A share of a number of levels is not negative and small.
                    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
                    Coordinate::Unit(unit) => (unit * levels.len() as f64) as usize,
                };
                return levels.get(place.min(last)).cloned().unwrap_or_default();
            }
        };
        if self.whole { format!("{:.0}", number.round()) } else { format!("{number:?}") }
    }

    /// How many levels it has.
    pub fn levels(&self) -> usize {
        match &self.values {
            FactorValues::Drawn(_) => 1,
            FactorValues::Levels(levels) => levels.len(),
        }
    }

    /// Whether its values are numbers.
    pub fn is_numeric(&self) -> bool {
        match &self.values {
            FactorValues::Drawn(_) => true,
            FactorValues::Levels(levels) => levels.iter().all(|level| level.parse::<f64>().is_ok()),
        }
    }
}

/// Default number of trials.
const USUAL: u64 = 100;
/// Default number of trials per combination of a sweep.
const USUAL_REPEATS: u64 = 50;
/// Default number of rows of the base of indices: their intervals are then some hundredths to a tenth wide.
const USUAL_BASE: u64 = 256;
/// Default trajectories and levels of a screening.
const USUAL_TRAJECTORIES: u64 = 20;
const USUAL_LEVELS: usize = 4;

impl CampaignPlan {
    /// The design, with this total number of `trials` if given, which must be possible.
    ///
    /// # Errors
    ///
    /// The possible numbers instead, in words.
    pub fn design(&self, trials: Option<u64>) -> Result<Design, String> {
        let mut design = self.of_size(self.size.unwrap_or(match self.layout {
            Layout::Plain => USUAL,
            Layout::Sweep => USUAL_REPEATS,
            Layout::Indices => USUAL_BASE,
            Layout::Screening => USUAL_TRAJECTORIES,
        }));
        if let Some(trials) = trials {
            let unit = self.of_size(1).trials().max(1);
            let size = trials / unit;
            if trials % unit != 0 || size == 0 {
                let nearest = size.max(1) * unit;
                let what = self.unit_in_words();
                return Err(format!(
                    "a multiple of {unit} trials, {what}, such as {nearest} or {}",
                    nearest + unit
                ));
            }
            design = self.of_size(size);
        }
        design.check().map_err(|error| error.to_string())?;
        Ok(design)
    }

    fn of_size(&self, size: u64) -> Design {
        let factors = self.factors.len();
        match self.layout {
            Layout::Plain => Design::Plain { trials: size, factors, sampling: self.sampling },
            Layout::Sweep => {
                Design::Sweep { levels: self.factors.iter().map(Factor::levels).collect(), repeats: size }
            }
            Layout::Indices => Design::Indices { base: size, factors, draws: true, sampling: self.sampling },
            Layout::Screening => Design::Screening { trajectories: size, factors, levels: self.levels },
        }
    }

    fn unit_in_words(&self) -> &'static str {
        match self.layout {
            Layout::Plain => "one per draw",
            Layout::Sweep => "one for every combination of levels",
            Layout::Indices => "one per factor and two more, with the draws counted as one",
            Layout::Screening => "one per factor and one more",
        }
    }
}

impl Scenario {
    /// The scenario with these values of its campaign's factors, one per factor, as TOML has them; itself if nothing varies.
    ///
    /// # Errors
    ///
    /// Refused as the file would be with these values.
    ///
    /// It is read again from its text: changes made only in memory are lost.
    pub fn with_factors(&self, values: &[String]) -> Result<Self, InputError> {
        let Some((_, source)) = self.sources.first() else { return Ok(self.clone()) };
        let factors = self.campaign.as_ref().map_or(&[][..], |plan| &plan.factors);
        let mut changes: Vec<(Range<usize>, String)> = Vec::new();
        for (factor, value) in factors.iter().zip(values) {
            for place in factor.keys.iter().flat_map(|key| source.places_of(key)) {
                let stated = source.text.get(place.clone()).unwrap_or_default();
                changes.push((place, factor.literal(stated, value)));
            }
        }
        changes.sort_by_key(|(place, _)| std::cmp::Reverse(place.start));
        let mut text = source.text.clone();
        for (place, literal) in changes {
            text.replace_range(place, &literal);
        }
        parse_varied(Source::new(source.name.clone(), text), self.robot.clone(), &self.sources)
    }
}

impl Factor {
    /// The text that replaces a stated value.
    fn literal(&self, stated: &str, value: &str) -> String {
        let scaled = || Some(stated.replace('_', "").parse::<f64>().ok()? * value.parse::<f64>().ok()?);
        match self.scale.then(scaled).flatten() {
            Some(number) if self.whole => format!("{:.0}", number.round()),
            Some(number) => format!("{number:?}"),
            None => value.to_owned(),
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CampaignFile {
    #[serde(default)]
    design: Layout,
    #[serde(default)]
    sampling: Sampling,
    trials: Option<Spanned<u64>>,
    repeats: Option<Spanned<u64>>,
    base: Option<Spanned<u64>>,
    trajectories: Option<Spanned<u64>>,
    levels: Option<Spanned<usize>>,
    tolerance_mm: Option<Spanned<f64>>,
    #[serde(default)]
    factor: Vec<Spanned<FactorFile>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FactorFile {
    name: Option<Spanned<String>>,
    key: Option<Spanned<String>>,
    keys: Option<Spanned<Vec<Spanned<String>>>>,
    #[serde(default)]
    scale: bool,
    #[serde(default)]
    whole: bool,
    levels: Option<Spanned<Vec<Spanned<toml::Value>>>>,
    distribution: Option<Spanned<String>>,
    low: Option<Spanned<f64>>,
    mode: Option<Spanned<f64>>,
    high: Option<Spanned<f64>>,
    mean: Option<Spanned<f64>>,
    sigma: Option<Spanned<f64>>,
    median: Option<Spanned<f64>>,
    sigma_ln: Option<Spanned<f64>>,
}

/// The plan of the section.
pub(super) fn campaign(source: &Source, section: &Spanned<CampaignFile>) -> Result<CampaignPlan, InputError> {
    let file = section.get_ref();
    let tolerance = file.tolerance_mm.as_ref();
    let plan = CampaignPlan {
        layout: file.design,
        sampling: file.sampling,
        size: size(source, file)?,
        levels: file.levels.as_ref().map_or(USUAL_LEVELS, |levels| *levels.get_ref()),
        tolerance: tolerance
            .map(|value| Ok::<_, InputError>(1e-3 * source.positive("campaign.tolerance_mm", value)?))
            .transpose()?,
        factors: file
            .factor
            .iter()
            .map(|entry| factor(source, file.design, entry))
            .collect::<Result<_, _>>()?,
    };
    refuse_shared(source, &file.factor, &plan.factors)?;
    if plan.layout != Layout::Plain && plan.factors.is_empty() {
        let help =
            "expected a [[campaign.factor]] with a key of this file and its values, or design = \"plain\"";
        return Err(source.error(section.span(), "campaign: nothing varies", Some(help.to_owned())));
    }
    if let Err(expected) = plan.design(None) {
        let place = source.places_of("campaign.design").into_iter().next().unwrap_or(section.span());
        return Err(source.error(
            place,
            format!("campaign: {expected}"),
            Some("expected another design".to_owned()),
        ));
    }
    Ok(plan)
}

/// The size that belongs to the design; one of another design is refused.
fn size(source: &Source, file: &CampaignFile) -> Result<Option<u64>, InputError> {
    let mut size = None;
    for (key, value, layout, design) in [
        ("trials", &file.trials, Layout::Plain, "plain"),
        ("repeats", &file.repeats, Layout::Sweep, "sweep"),
        ("base", &file.base, Layout::Indices, "indices"),
        ("trajectories", &file.trajectories, Layout::Screening, "screening"),
    ] {
        let Some(value) = value else { continue };
        let refused = |message: String, help: String| Err(source.error(value.span(), message, Some(help)));
        if layout != file.design {
            let help = format!("expected design = \"{design}\", or no {key}");
            return refused(format!("campaign.{key} belongs to another design"), help);
        }
        if *value.get_ref() == 0 {
            return refused(format!("campaign.{key} is 0"), "expected 1 or more".to_owned());
        }
        size = Some(*value.get_ref());
    }
    match &file.levels {
        Some(levels) if file.design != Layout::Screening => {
            let help = "expected design = \"screening\", or levels in a [[campaign.factor]]";
            Err(source.error(
                levels.span(),
                "campaign.levels belongs to another design",
                Some(help.to_owned()),
            ))
        }
        _ => Ok(size),
    }
}

fn factor(source: &Source, layout: Layout, entry: &Spanned<FactorFile>) -> Result<Factor, InputError> {
    let file = entry.get_ref();
    let refused = |place: Range<usize>, message: String, help: &str| {
        Err(source.error(place, message, Some(help.to_owned())))
    };
    let keys: Vec<&Spanned<String>> = match (&file.key, &file.keys) {
        (Some(key), None) => vec![key],
        (None, Some(keys)) if !keys.get_ref().is_empty() => keys.get_ref().iter().collect(),
        _ => {
            let help = "expected key = \"...\", or keys = [\"...\", \"...\"] of values that change together, such as \"tracker.random_fraction\"";
            return refused(
                entry.span(),
                "campaign.factor: it does not state which value varies".to_owned(),
                help,
            );
        }
    };
    for key in &keys {
        check_key(source, key, file)?;
    }
    let values = match (&file.levels, &file.distribution) {
        (Some(levels), None) => FactorValues::Levels(literals(source, levels, file)?),
        (None, Some(name)) if layout != Layout::Sweep => {
            FactorValues::Drawn(distribution(source, name, file)?)
        }
        (None, Some(name)) => {
            let help = "expected levels = [...] in a sweep";
            return refused(
                name.span(),
                "campaign.factor has a distribution, but a sweep needs levels".to_owned(),
                help,
            );
        }
        _ => {
            let help = "expected levels = [...], or distribution = \"uniform\" with low and high; \"log_uniform\", \"normal\" with mean and sigma, \
                        \"lognormal\" with median and sigma_ln, \"triangular\" with low, mode and high";
            return refused(entry.span(), "campaign.factor: it states no values".to_owned(), help);
        }
    };
    let keys: Vec<String> = keys.into_iter().map(|key| key.get_ref().clone()).collect();
    let name = file.name.as_ref().map(|name| name.get_ref().clone());
    let name = name.unwrap_or_else(|| keys.first().cloned().unwrap_or_default());
    Ok(Factor { name, keys, scale: file.scale, whole: file.whole, values })
}

/// Refuses a key for which the file has no value, or several, or one that cannot be multiplied.
fn check_key(source: &Source, key: &Spanned<String>, file: &FactorFile) -> Result<(), InputError> {
    let refused = |message: String, help: String| Err(source.error(key.span(), message, Some(help)));
    let name = key.get_ref();
    const FIXED: [&str; 5] = ["schema", "name", "seed", "robot", "identification.modes"];
    if name.starts_with("campaign") || FIXED.contains(&name.as_str()) {
        return refused(
            format!("campaign.factor: {name} cannot vary"),
            "expected the key of a value that a session depends on".to_owned(),
        );
    }
    let places = source.places_of(name);
    let is_value = |place: &Range<usize>| {
        let text = source.text.get(place.clone()).unwrap_or_default();
        let read = format!("value = {text}").parse::<toml::Table>();
        read.is_ok_and(|table| table.get("value").is_some_and(|value| !value.is_table()))
    };
    if !places.iter().all(is_value) {
        return refused(
            format!("campaign.factor: {name} is a table, not a value"),
            "expected one of its keys; a table of an array is chosen by its number from 1, or by its joint, name or mode, such as tracker.nest[1].x_mm"
                .to_owned(),
        );
    }
    match places.len() {
        0 => refused(
            format!("campaign.factor: this file has no value of {name}"),
            "expected a key that is in this file, whose value is then replaced: write it with its usual value first; choose \
             one table of an array in brackets, such as as_built.joint[rail].delta_d_mm"
                .to_owned(),
        ),
        1 => Ok(()),
        _ if file.scale => Ok(()),
        count => refused(
            format!("campaign.factor: this file has {count} values of {name}"),
            "expected one of them chosen in brackets, by its number or its name, such as poses.region[rail].half_width_mm; or \
             scale = true, which multiplies all"
                .to_owned(),
        ),
    }?;
    let text = |place: &Range<usize>| source.text.get(place.clone()).unwrap_or_default().replace('_', "");
    match places.iter().find(|place| text(place).parse::<f64>().is_err()) {
        Some(place) if file.scale => {
            let message = format!("campaign.factor: {name} is {}, which cannot be multiplied", text(place));
            refused(message, "expected the key of a number, or no scale".to_owned())
        }
        _ => Ok(()),
    }
}

/// The levels as TOML has them.
fn literals(
    source: &Source,
    levels: &Spanned<Vec<Spanned<toml::Value>>>,
    file: &FactorFile,
) -> Result<Vec<String>, InputError> {
    if levels.get_ref().is_empty() {
        let help = Some("expected at least one value".to_owned());
        return Err(source.error(levels.span(), "campaign.factor.levels is empty", help));
    }
    let mut literals = Vec::new();
    for level in levels.get_ref() {
        let written = source.text.get(level.span()).unwrap_or_default();
        // As Rust also reads numbers: 1_000 and 0x10 are numbers only in TOML.
        let literal = match level.get_ref() {
            toml::Value::Integer(value) => value.to_string(),
            toml::Value::Float(_) => written.replace('_', ""),
            _ => written.to_owned(),
        };
        let is_number = matches!(level.get_ref(), toml::Value::Integer(_) | toml::Value::Float(_));
        let is_finite = !matches!(level.get_ref(), toml::Value::Float(value) if !value.is_finite());
        if (file.scale && !is_number) || !is_finite {
            let message = format!("campaign.factor.levels: {literal}");
            let help = Some("expected finite numbers".to_owned());
            return Err(source.error(level.span(), message, help));
        }
        if literals.contains(&literal) {
            let help = Some("expected every level only once".to_owned());
            return Err(source.error(level.span(), format!("campaign.factor.levels: {literal} twice"), help));
        }
        literals.push(literal);
    }
    Ok(literals)
}

fn distribution(
    source: &Source,
    name: &Spanned<String>,
    file: &FactorFile,
) -> Result<Distribution, InputError> {
    let mut used = BTreeSet::new();
    let mut of = |key: &'static str, value: &Option<Spanned<f64>>| match value {
        Some(value) => {
            used.insert(key);
            source.finite(&format!("campaign.factor.{key}"), value)
        }
        None => {
            let message = format!("campaign.factor: distribution \"{}\" without {key}", name.get_ref());
            Err(source.error(
                name.span(),
                message,
                Some(format!("expected {key} = a number, in the unit of the key")),
            ))
        }
    };
    let distribution = match name.get_ref().as_str() {
        "uniform" => Distribution::Uniform { low: of("low", &file.low)?, high: of("high", &file.high)? },
        "log_uniform" => {
            Distribution::LogUniform { low: of("low", &file.low)?, high: of("high", &file.high)? }
        }
        "normal" => Distribution::Normal { mean: of("mean", &file.mean)?, sigma: of("sigma", &file.sigma)? },
        "lognormal" => Distribution::LogNormal {
            median: of("median", &file.median)?,
            sigma_ln: of("sigma_ln", &file.sigma_ln)?,
        },
        "triangular" => Distribution::Triangular {
            low: of("low", &file.low)?,
            mode: of("mode", &file.mode)?,
            high: of("high", &file.high)?,
        },
        other => {
            let help = "expected one of: uniform, log_uniform, normal, lognormal, triangular";
            let message = format!("campaign.factor.distribution is \"{other}\"");
            return Err(source.error(name.span(), message, Some(help.to_owned())));
        }
    };
    for (key, value) in [
        ("low", &file.low),
        ("mode", &file.mode),
        ("high", &file.high),
        ("mean", &file.mean),
        ("sigma", &file.sigma),
        ("median", &file.median),
        ("sigma_ln", &file.sigma_ln),
    ] {
        if let (Some(value), false) = (value, used.contains(key)) {
            let message = format!("campaign.factor.{key}: \"{}\" has no {key}", name.get_ref());
            let help = format!("expected {}", used.into_iter().collect::<Vec<_>>().join(" and "));
            return Err(source.error(value.span(), message, Some(help)));
        }
    }
    distribution.check().map_err(|error| {
        let help = Some("expected parameters of the distribution that is stated".to_owned());
        source.error(name.span(), format!("campaign.factor: {error}"), help)
    })?;
    Ok(distribution)
}

/// Refuses two factors that change one value, or have one name.
fn refuse_shared(
    source: &Source,
    entries: &[Spanned<FactorFile>],
    factors: &[Factor],
) -> Result<(), InputError> {
    let mut seen: Vec<(Range<usize>, &str)> = Vec::new();
    let mut names = BTreeSet::new();
    for (entry, factor) in entries.iter().zip(factors) {
        let refused =
            |message: String, help: &str| Err(source.error(entry.span(), message, Some(help.to_owned())));
        if !names.insert(&factor.name) {
            let message = format!("campaign: two factors are called \"{}\"", factor.name);
            return refused(message, "expected different names");
        }
        for place in factor.keys.iter().flat_map(|key| source.places_of(key)) {
            if let Some((_, other)) =
                seen.iter().find(|(taken, _)| taken.start < place.end && place.start < taken.end)
            {
                let message = format!("campaign: \"{other}\" and \"{}\" change the same value", factor.name);
                return refused(message, "expected only one factor per value");
            }
            seen.push((place, &factor.name));
        }
    }
    Ok(())
}
