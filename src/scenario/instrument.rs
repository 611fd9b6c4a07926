//! The instrument of `[tracker]`, and `[tracker.environment]`, `[tracker.drift]` and `[tracker.smr]`.

use std::ops::Range;

use serde::Deserialize;

use super::file::{TrackerFile, yes};
use calibrig_files::{InputError, Source, Spanned};
use calibrig_plant::tracker::{
    Air, Conditions, DriftLaw, EnvironmentLaw, ErrorLine, Instrument, Limits, Motion, Preset, RealErrors,
    SmrLaw, TrackerError,
};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct EnvironmentFile {
    #[serde(default = "yes")]
    enabled: bool,
    temperature_c: Spanned<f64>,
    pressure_hpa: Spanned<f64>,
    humidity_percent: Spanned<f64>,
    temperature_sigma_k: Spanned<f64>,
    pressure_sigma_hpa: Spanned<f64>,
    humidity_sigma_percent: Spanned<f64>,
    gradient_k_per_m: Option<Spanned<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DriftFile {
    #[serde(default = "yes")]
    enabled: bool,
    ramp_um_per_h: Option<Spanned<f64>>,
    ramp_urad_per_h: Option<Spanned<f64>>,
    warm_up_um: Option<Spanned<[Spanned<f64>; 2]>>,
    warm_up_urad: Option<Spanned<[Spanned<f64>; 2]>>,
    warm_up_time_s: Option<Spanned<f64>>,
    walk_um_per_root_h: Option<Spanned<f64>>,
    walk_urad_per_root_h: Option<Spanned<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SmrFile {
    #[serde(default = "yes")]
    enabled: bool,
    centring_um: Spanned<f64>,
    seat_um: Spanned<f64>,
    acceptance_deg: Option<Spanned<f64>>,
}

const UM: f64 = 1e-6;

/// Default time after which a share 1/e of a warm-up is left, s: one twentieth is left after the first hour.
const WARM_UP_TIME: f64 = 1200.0;

/// As for 1.5 inch reflectors.
const ACCEPTANCE_DEG: f64 = 30.0;

/// The instrument of the section, which is at `section` of the text.
pub(super) fn instrument(
    source: &Source,
    file: &TrackerFile,
    section: Range<usize>,
) -> Result<Instrument, InputError> {
    let preset = file.preset.as_ref().map(|name| preset(source, name)).transpose()?;
    let base = preset.map(Preset::instrument);
    let missing = |key: &str| {
        let names: Vec<_> = Preset::ALL.iter().map(|preset| format!("\"{}\"", preset.key())).collect();
        source.error(
            section.clone(),
            format!("missing key `{key}` in [tracker]"),
            Some(format!(
                "expected `{key}` with a value; the unit is part of the key; or preset = {}",
                names.join(", ")
            )),
        )
    };
    let line = |keys: [&str; 2], values: [&Option<Spanned<f64>>; 2], base: Option<ErrorLine>| {
        let offset = match values[0] {
            Some(value) => Some(UM * source.positive(&format!("tracker.{}", keys[0]), value)?),
            None => base.map(|line| line.offset),
        };
        let per_metre = match values[1] {
            Some(value) => Some(UM * source.not_negative(&format!("tracker.{}", keys[1]), value)?),
            None => base.map(|line| line.per_metre),
        };
        Ok::<_, InputError>(ErrorLine {
            offset: offset.ok_or_else(|| missing(keys[0]))?,
            per_metre: per_metre.ok_or_else(|| missing(keys[1]))?,
        })
    };
    let transverse = line(
        ["transverse_um", "transverse_um_per_m"],
        [&file.transverse_um, &file.transverse_um_per_m],
        base.map(|base| base.transverse),
    )?;
    let range = line(
        ["range_um", "range_um_per_m"],
        [&file.range_um, &file.range_um_per_m],
        base.map(|base| base.range),
    )?;
    let random_fraction = match &file.random_fraction {
        Some(value) => source.positive("tracker.random_fraction", value)?,
        None => base.map(|base| base.random_fraction).ok_or_else(|| missing("random_fraction"))?,
    };
    let plain = Instrument { preset, ..Instrument::of_noise(transverse, range, random_fraction) };
    let base = base.unwrap_or(plain);
    let or = |key: &str, value: &Option<Spanned<f64>>, unit: f64, other: f64| match value {
        Some(value) => Ok::<_, InputError>(unit * source.not_negative(&format!("tracker.{key}"), value)?),
        None => Ok(other),
    };
    let range_zero = match &file.range_zero_um {
        Some(value) => Some(UM * source.not_negative("tracker.range_zero_um", value)?),
        None => base.range_zero,
    };
    Ok(Instrument {
        range_zero,
        limits: limits(source, file, base.limits)?,
        air: or("air_um_per_m", &file.air_um_per_m, UM, base.air)?,
        systematic_fraction: or(
            "systematic_fraction",
            &file.systematic_fraction,
            1.0,
            base.systematic_fraction,
        )?,
        real: RealErrors {
            random: or("real_random_factor", &file.real_random_factor, 1.0, 1.0)?,
            systematic: or("real_systematic_factor", &file.real_systematic_factor, 1.0, 1.0)?,
        },
        noise: file.noise,
        ..plain
    })
}

/// The instrument of that name; the error lists the existing ones.
fn preset(source: &Source, name: &Spanned<String>) -> Result<Preset, InputError> {
    Preset::parse(name.get_ref()).ok_or_else(|| {
        let known: Vec<_> = Preset::ALL.iter().map(|preset| preset.key()).collect();
        source.error(
            name.span(),
            format!("tracker.preset is \"{}\"", name.get_ref()),
            Some(format!("expected one of: {}; or no preset, and your own figures", known.join(", "))),
        )
    })
}

/// Two numbers of a key, the first at most the second.
fn bounds(
    source: &Source,
    key: &str,
    value: Option<&Spanned<[Spanned<f64>; 2]>>,
    unit: f64,
    other: [f64; 2],
) -> Result<[f64; 2], InputError> {
    let Some(value) = value else { return Ok(other) };
    let [low, high] = value.get_ref();
    let both = [source.finite(key, low)?, source.finite(key, high)?];
    if both[0] > both[1] {
        let help = Some("expected the lower of the two first".to_owned());
        return Err(source.error(value.span(), format!("{key} is [{}, {}]", both[0], both[1]), help));
    }
    Ok(both.map(|number| unit * number))
}

fn limits(source: &Source, file: &TrackerFile, base: Limits) -> Result<Limits, InputError> {
    let degree = 1.0_f64.to_radians();
    let limits = Limits {
        range: bounds(source, "tracker.range_limits_m", file.range_limits_m.as_ref(), 1.0, base.range)?,
        azimuth: bounds(
            source,
            "tracker.azimuth_limits_deg",
            file.azimuth_limits_deg.as_ref(),
            degree,
            base.azimuth,
        )?,
        elevation: bounds(
            source,
            "tracker.elevation_limits_deg",
            file.elevation_limits_deg.as_ref(),
            degree,
            base.elevation,
        )?,
        temperature: bounds(
            source,
            "tracker.temperature_limits_c",
            file.temperature_limits_c.as_ref(),
            1.0,
            base.temperature,
        )?,
    };
    if let (Some(value), true) = (&file.range_limits_m, limits.range[0] <= 0.0) {
        let help = Some("expected a least range above zero".to_owned());
        let message = format!("tracker.range_limits_m begins at {}", limits.range[0]);
        return Err(source.error(value.span(), message, help));
    }
    Ok(limits)
}

/// Conditions of the session besides its instrument.
pub(super) fn conditions(
    source: &Source,
    file: &TrackerFile,
    limits: &Limits,
) -> Result<Conditions, InputError> {
    let misses = match &file.miss_fraction {
        Some(value) => {
            let share = source.finite("tracker.miss_fraction", value)?;
            if !(0.0..1.0).contains(&share) {
                let help = "expected the share of readings that are missing: zero or more and below 1, such as 0.005 for one \
                            in 200";
                let help = Some(help.to_owned());
                return Err(source.error(value.span(), format!("tracker.miss_fraction is {share}"), help));
            }
            share
        }
        None => 0.0,
    };
    let environment =
        file.environment.as_ref().map(|section| environment(source, section, limits)).transpose()?;
    let drift = file.drift.as_ref().map(|section| drift(source, section)).transpose()?;
    let smr = file.smr.as_ref().map(|section| smr(source, section)).transpose()?;
    Ok(Conditions { environment: environment.flatten(), drift: drift.flatten(), smr: smr.flatten(), misses })
}

/// A law, if its section is enabled; errors of its own check are reported at the section, even if it is off.
fn checked<L>(
    source: &Source,
    section: Range<usize>,
    enabled: bool,
    law: L,
    check: impl Fn(&L) -> Result<(), TrackerError>,
) -> Result<Option<L>, InputError> {
    match check(&law) {
        Ok(()) => Ok(enabled.then_some(law)),
        Err(TrackerError::Figure { quantity, value, expected }) => Err(source.error(
            section,
            format!("the {quantity} is {value}"),
            Some(format!("expected {expected}")),
        )),
        Err(error) => Err(source.error(section, error, Some("expected other figures".to_owned()))),
    }
}

fn environment(
    source: &Source,
    section: &Spanned<EnvironmentFile>,
    limits: &Limits,
) -> Result<Option<EnvironmentLaw>, InputError> {
    let file = section.get_ref();
    let key = |name: &str| format!("tracker.environment.{name}");
    let finite = |name: &str, value: &Spanned<f64>| source.finite(&key(name), value);
    let sigma = |name: &str, value: &Spanned<f64>| source.not_negative(&key(name), value);
    let within = |name: &str, value: &Spanned<f64>, low: f64, high: f64| {
        let number = finite(name, value)?;
        if (low..=high).contains(&number) {
            return Ok(number);
        }
        let help = Some(format!("expected {low} to {high}, the range of air in which a tracker works"));
        Err(source.error(value.span(), format!("{} is {number}", key(name)), help))
    };
    let air = Air {
        temperature: within("temperature_c", &file.temperature_c, -40.0, 60.0)?,
        pressure: 100.0 * within("pressure_hpa", &file.pressure_hpa, 500.0, 1200.0)?,
        humidity: 0.01 * within("humidity_percent", &file.humidity_percent, 0.0, 100.0)?,
    };
    let [low, high] = limits.temperature;
    if !(low..=high).contains(&air.temperature) {
        let help = Some(format!("expected {low} to {high}, the temperatures at which the instrument works"));
        let message = format!("{} is {}", key("temperature_c"), air.temperature);
        return Err(source.error(file.temperature_c.span(), message, help));
    }
    let sensor_sigma = Air {
        temperature: sigma("temperature_sigma_k", &file.temperature_sigma_k)?,
        pressure: 100.0 * sigma("pressure_sigma_hpa", &file.pressure_sigma_hpa)?,
        humidity: 0.01 * sigma("humidity_sigma_percent", &file.humidity_sigma_percent)?,
    };
    let gradient = match &file.gradient_k_per_m {
        Some(value) => finite("gradient_k_per_m", value)?,
        None => 0.0,
    };
    let law = EnvironmentLaw { air, sensor_sigma, gradient };
    checked(source, section.span(), file.enabled, law, EnvironmentLaw::check)
}

fn drift(source: &Source, section: &Spanned<DriftFile>) -> Result<Option<DriftLaw>, InputError> {
    let file = section.get_ref();
    let size = |name: &str, value: &Option<Spanned<f64>>| match value {
        Some(value) => Ok(UM * source.not_negative(&format!("tracker.drift.{name}"), value)?),
        None => Ok::<_, InputError>(0.0),
    };
    let pair = |name: &str, value: &Option<Spanned<[Spanned<f64>; 2]>>| {
        bounds(source, &format!("tracker.drift.{name}"), value.as_ref(), UM, [0.0; 2])
    };
    let (shift, turn) = (pair("warm_up_um", &file.warm_up_um)?, pair("warm_up_urad", &file.warm_up_urad)?);
    let warm_up_time = match &file.warm_up_time_s {
        Some(value) => source.positive("tracker.drift.warm_up_time_s", value)?,
        None => WARM_UP_TIME,
    };
    let law = DriftLaw {
        ramp: Motion {
            shift: size("ramp_um_per_h", &file.ramp_um_per_h)?,
            turn: size("ramp_urad_per_h", &file.ramp_urad_per_h)?,
        },
        warm_up: [0, 1].map(|end| Motion { shift: shift[end], turn: turn[end] }),
        warm_up_time,
        walk: Motion {
            shift: size("walk_um_per_root_h", &file.walk_um_per_root_h)?,
            turn: size("walk_urad_per_root_h", &file.walk_urad_per_root_h)?,
        },
    };
    checked(source, section.span(), file.enabled, law, DriftLaw::check)
}

fn smr(source: &Source, section: &Spanned<SmrFile>) -> Result<Option<SmrLaw>, InputError> {
    let file = section.get_ref();
    let acceptance = match &file.acceptance_deg {
        Some(value) => source.positive("tracker.smr.acceptance_deg", value)?,
        None => ACCEPTANCE_DEG,
    };
    let law = SmrLaw {
        centring_sigma: UM * source.not_negative("tracker.smr.centring_um", &file.centring_um)?,
        seat_sigma: UM * source.not_negative("tracker.smr.seat_um", &file.seat_um)?,
        acceptance: acceptance.to_radians(),
    };
    checked(source, section.span(), file.enabled, law, SmrLaw::check)
}
