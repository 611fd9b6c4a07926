//! Values of flags.

use crate::twin::Preset;
use calibrig_model::nalgebra::Vector3;

/// m
#[derive(Debug, Clone, Copy)]
pub(super) struct Length3(pub Vector3<f64>);

/// The range of a joint in its own unit.
#[derive(Debug, Clone)]
pub(super) struct SideOfRegion {
    pub joint: String,
    /// Number and unit, as written.
    pub ends: [(f64, String); 2],
}

const UNITS: [(&str, f64); 3] = [("mm", 1e-3), ("um", 1e-6), ("m", 1.0)];

pub(super) fn length(text: &str) -> Result<f64, String> {
    let of_unit = |(unit, scale): &(&str, f64)| {
        let number = text.trim().strip_suffix(unit)?.trim().parse::<f64>().ok()?;
        Some(number * scale)
    };
    match UNITS.iter().find_map(of_unit) {
        Some(metres) if (1e-9..=1.0).contains(&metres) => Ok(metres),
        _ => Err("expected a length above zero with its unit, such as 0.1mm or 80um".to_owned()),
    }
}

pub(super) fn mm(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if (1e-6..=1e6).contains(&number) => Ok(number),
        _ => Err("expected a number from 0.000001 to 1000000".to_owned()),
    }
}

pub(super) fn not_negative(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if (0.0..=1e6).contains(&number) => Ok(number),
        _ => Err("expected a number from 0 to 1000000".to_owned()),
    }
}

pub(super) fn angle(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if number > 0.0 && number <= 90.0 => Ok(number),
        _ => Err("expected a number of deg above zero, at most 90".to_owned()),
    }
}

pub(super) fn length3(text: &str) -> Result<Length3, String> {
    let numbers: Vec<f64> = text.split(',').filter_map(|part| part.trim().parse().ok()).collect();
    match numbers.as_slice() {
        [x, y, z] if text.split(',').count() == 3 && numbers.iter().all(|v: &f64| v.abs() <= 1e6) => {
            Ok(Length3(1e-3 * Vector3::new(*x, *y, *z)))
        }
        _ => Err("expected three numbers, such as 2500,0,800".to_owned()),
    }
}

pub(super) fn preset(text: &str) -> Result<Preset, String> {
    Preset::parse(text).ok_or_else(|| {
        let keys: Vec<_> = Preset::ALL.iter().map(|own| own.key()).collect();
        format!("expected one of: {}", keys.join(", "))
    })
}

pub(super) fn side(text: &str) -> Result<SideOfRegion, String> {
    let expected =
        "expected a joint and its range with units, such as rail=100mm..3900mm or waist=-20deg..40deg";
    let (joint, range) = text.split_once('=').ok_or(expected)?;
    let (low, high) = range.split_once("..").ok_or(expected)?;
    let end = |text: &str| {
        let at = text.find(|c: char| c.is_alphabetic() && c != 'e' && c != 'E').ok_or(expected)?;
        let number = text[..at].trim().parse::<f64>().map_err(|_| expected)?;
        if number.is_finite() { Ok((number, text[at..].trim().to_owned())) } else { Err(expected) }
    };
    Ok(SideOfRegion { joint: joint.to_owned(), ends: [end(low)?, end(high)?] })
}
