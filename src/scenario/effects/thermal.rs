//! `[effects.thermal]`.

use std::f64::consts::TAU;

use serde::Deserialize;

use super::entries::yes;
use super::{EffectsFile, Key, Numbers, Reader};
use crate::scenario::Scenario;
use calibrig_files::{InputError, Source, Spanned};
use calibrig_model::JointKind;
use calibrig_plant::effects::{AMBIENT_RANGE, Ambient, DriveHeat, GrowingPart, Growth, MOST_RISE, Thermal};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::scenario) struct ThermalFile {
    #[serde(default = "yes")]
    enabled: bool,
    reference_c: Spanned<f64>,
    start_c: Spanned<f64>,
    drift_c_per_h: Option<Spanned<f64>>,
    swing_c: Option<Spanned<f64>>,
    swing_period_s: Option<Spanned<f64>>,
    swing_phase_deg: Option<Spanned<f64>>,
    #[serde(default)]
    link: Vec<Spanned<GrowthFile>>,
    rod: Option<RodFile>,
}

impl ThermalFile {
    /// The place in the file that states the air's range.
    fn air(&self) -> &Spanned<f64> {
        self.drift_c_per_h.as_ref().or(self.swing_c.as_ref()).unwrap_or(&self.start_c)
    }
}

/// Refuses air that gets too warm or cold during the session.
pub(in crate::scenario) fn check_air(
    source: &Source,
    file: &EffectsFile,
    scenario: &Scenario,
) -> Result<(), InputError> {
    let effects = &scenario.as_built.effects;
    let (Some(thermal), Some(table)) = (&effects.thermal, &file.thermal) else { return Ok(()) };
    thermal.check_session(scenario.session().duration()).map_err(|error| {
        let [least, most] = AMBIENT_RANGE;
        let help =
            format!("expected air of {least} to {most} degC throughout the session, or a shorter session");
        source.error(table.get_ref().air().span(), format!("effects.{error}"), Some(help))
    })
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct GrowthFile {
    joint: Spanned<String>,
    axis: Axis,
    length_mm: Spanned<f64>,
    #[serde(default)]
    with_travel: Option<Spanned<bool>>,
    expansion_ppm_per_k: Spanned<f64>,
    lag_s: Spanned<f64>,
    heat: Option<Spanned<HeatFile>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct HeatFile {
    joint: Spanned<String>,
    power_w: Option<Spanned<f64>>,
    motion_j_per_m: Option<Spanned<f64>>,
    motion_j_per_rev: Option<Spanned<f64>>,
    resistance_k_per_w: Spanned<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RodFile {
    expansion_ppm_per_k: Spanned<f64>,
    lag_s: Spanned<f64>,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "snake_case")]
enum Axis {
    X,
    Y,
    Z,
}

pub(super) fn thermal(
    reader: &Reader<'_>,
    section: Option<&Spanned<ThermalFile>>,
) -> Result<Option<Thermal>, InputError> {
    let Some(section) = section else { return Ok(None) };
    let file = section.get_ref();
    let ambient = ambient(reader, file)?;
    let mut growths = file.link.iter().map(|entry| growth(reader, entry)).collect::<Result<Vec<_>, _>>()?;
    if let Some(rod) = &file.rod {
        growths.push(rod_growth(reader, rod)?);
    }
    if growths.is_empty() {
        let message = "[effects.thermal] has nothing that grows".to_owned();
        return Err(reader.refuse(
            section.span(),
            message,
            "[[effects.thermal.link]] or [effects.thermal.rod]",
        ));
    }
    let reference = temperature(reader, "reference_c", &file.reference_c)?;
    Ok(file.enabled.then_some(Thermal { ambient, reference, growths }))
}

/// A temperature of a place where robots are measured, °C.
fn temperature(reader: &Reader<'_>, key: &str, value: &Spanned<f64>) -> Result<f64, InputError> {
    let number = reader.source.finite(&format!("effects.thermal.{key}"), value)?;
    let [low, high] = AMBIENT_RANGE;
    if (low..=high).contains(&number) {
        return Ok(number);
    }
    let message = format!("effects.thermal.{key} is {number}");
    Err(reader.refuse(value.span(), message, &format!("{low} to {high} degrees Celsius")))
}

fn ambient(reader: &Reader<'_>, file: &ThermalFile) -> Result<Ambient, InputError> {
    let source = reader.source;
    let swing = match &file.swing_c {
        Some(swing) => source.not_negative("effects.thermal.swing_c", swing)?,
        None => 0.0,
    };
    let period = match (&file.swing_period_s, &file.swing_c) {
        (Some(period), _) => source.positive("effects.thermal.swing_period_s", period)?,
        (None, None) => 1.0,
        (None, Some(swing)) => {
            let message = "effects.thermal.swing_c without its period".to_owned();
            return Err(reader.refuse(swing.span(), message, "swing_period_s with it"));
        }
    };
    let drift = match &file.drift_c_per_h {
        Some(drift) => source.finite("effects.thermal.drift_c_per_h", drift)? / 3600.0,
        None => 0.0,
    };
    let start = temperature(reader, "start_c", &file.start_c)?;
    let phase = reader.phase("effects.thermal.swing_phase_deg", file.swing_phase_deg.as_ref())?;
    let [low, high] = AMBIENT_RANGE;
    if start - swing < low || start + swing > high {
        let message = format!("start_c {start} and swing_c {swing} leave {low} to {high} degrees Celsius");
        return Err(reader.refuse(file.start_c.span(), message, "a smaller swing_c"));
    }
    Ok(Ambient { start, drift, swing, period, phase })
}

/// Above the greatest coefficient of a metal, that of zinc.
const MOST_EXPANSION: f64 = 50.0;

/// (expansion per kelvin, time constant in s)
fn expansion(reader: &Reader<'_>, ppm: &Spanned<f64>, lag: &Spanned<f64>) -> Result<(f64, f64), InputError> {
    let number = reader.source.not_negative("expansion_ppm_per_k", ppm)?;
    if number > MOST_EXPANSION {
        let message = format!("expansion_ppm_per_k is {number}");
        return Err(reader.refuse(
            ppm.span(),
            message,
            &format!("0 to {MOST_EXPANSION}, steel has about 12"),
        ));
    }
    Ok((1e-6 * number, reader.source.not_negative("lag_s", lag)?))
}

fn growth(reader: &Reader<'_>, entry: &Spanned<GrowthFile>) -> Result<Growth, InputError> {
    let file = entry.get_ref();
    let joint = super::joint_index(reader.source, &file.joint, reader.chain())?;
    let axis = match file.axis {
        Axis::X => 0,
        Axis::Y => 1,
        Axis::Z => 2,
    };
    let with_travel = file.with_travel.as_ref().is_some_and(|travels| *travels.get_ref());
    if let (true, JointKind::Revolute, Some(travels)) =
        (with_travel, reader.chain().links[joint].kind, &file.with_travel)
    {
        let message = format!("with_travel of joint \"{}\", which is revolute", file.joint.get_ref());
        return Err(reader.refuse(travels.span(), message, "with_travel only for a prismatic joint"));
    }
    let length = 1e-3 * reader.source.finite("length_mm", &file.length_mm)?;
    let (expansion, lag) = expansion(reader, &file.expansion_ppm_per_k, &file.lag_s)?;
    let heat = file.heat.as_ref().map(|table| heat(reader, table)).transpose()?;
    if heat.is_some() && lag == 0.0 {
        let message = format!("lag_s of joint \"{}\" is 0, but its part is heated", file.joint.get_ref());
        return Err(reader.refuse(
            file.lag_s.span(),
            message,
            "the time constant of the warm-up, above zero",
        ));
    }
    Ok(Growth { part: GrowingPart::Link { joint, axis }, length, with_travel, expansion, lag, heat })
}

/// A drive's heat in a part.
fn heat(reader: &Reader<'_>, table: &Spanned<HeatFile>) -> Result<DriveHeat, InputError> {
    let file = table.get_ref();
    let actuator = super::joint_index(reader.source, &file.joint, reader.chain())?;
    let power = match &file.power_w {
        Some(power) => reader.source.not_negative("heat.power_w", power)?,
        None => 0.0,
    };
    let motion = Key {
        name: "motion_j_per",
        linear: ("m", &file.motion_j_per_m),
        angular: ("rev", &file.motion_j_per_rev),
    };
    let per_unit = match reader.chain().links[actuator].kind {
        JointKind::Prismatic => 1.0,
        JointKind::Revolute => 1.0 / TAU,
    };
    let per_motion = per_unit * reader.optional(actuator, &motion, Numbers::NotNegative)?.unwrap_or(0.0);
    let resistance = reader.source.positive("heat.resistance_k_per_w", &file.resistance_k_per_w)?;
    if power == 0.0 && per_motion == 0.0 {
        let message = format!("the drive of joint \"{}\" produces no heat", file.joint.get_ref());
        return Err(reader.refuse(table.span(), message, "power_w, motion_j_per_m or motion_j_per_rev"));
    }
    let rise = power * resistance;
    if rise > MOST_RISE {
        let message = format!("power_w {power} at resistance_k_per_w {resistance} warm the part by {rise} K");
        return Err(reader.refuse(table.span(), message, &format!("at most {MOST_RISE} K")));
    }
    Ok(DriveHeat { actuator, power, per_motion, resistance })
}

fn rod_growth(reader: &Reader<'_>, file: &RodFile) -> Result<Growth, InputError> {
    if reader.robot.model.actuators.four_bar().is_none() {
        let message = "[effects.thermal.rod], but the robot's file gives no lengths of a four-bar".to_owned();
        let span = file.expansion_ppm_per_k.span();
        return Err(reader.refuse(span, message, "a robot whose elbow is driven through a coupler rod"));
    }
    let (expansion, lag) = expansion(reader, &file.expansion_ppm_per_k, &file.lag_s)?;
    Ok(Growth { part: GrowingPart::Rod, length: 0.0, with_travel: false, expansion, lag, heat: None })
}
