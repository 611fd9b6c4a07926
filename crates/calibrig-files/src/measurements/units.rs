//! Units of columns, by key and as headers write them.

use serde::Deserialize;

/// Unit of a length.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum LengthUnit {
    M,
    Cm,
    Mm,
    Um,
    Inch,
}

/// Unit of an angle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum AngleUnit {
    Rad,
    Mrad,
    Urad,
    Deg,
    Gon,
    Arcsec,
    Rev,
}

impl LengthUnit {
    /// m
    pub fn in_si(self, value: f64) -> f64 {
        match self {
            Self::M => value,
            Self::Cm => value / 1e2,
            Self::Mm => value / 1e3,
            Self::Um => value / 1e6,
            Self::Inch => value * 25.4 / 1e3,
        }
    }

    /// As column maps have it.
    pub fn key(self) -> &'static str {
        match self {
            Self::M => "m",
            Self::Cm => "cm",
            Self::Mm => "mm",
            Self::Um => "um",
            Self::Inch => "inch",
        }
    }
}

impl AngleUnit {
    /// rad
    pub fn in_si(self, value: f64) -> f64 {
        match self {
            Self::Rad => value,
            Self::Mrad => value / 1e3,
            Self::Urad => value / 1e6,
            Self::Deg => value.to_radians(),
            Self::Gon => (0.9 * value).to_radians(),
            Self::Arcsec => (value / 3600.0).to_radians(),
            Self::Rev => std::f64::consts::TAU * value,
        }
    }

    /// As column maps have it.
    pub fn key(self) -> &'static str {
        match self {
            Self::Rad => "rad",
            Self::Mrad => "mrad",
            Self::Urad => "urad",
            Self::Deg => "deg",
            Self::Gon => "gon",
            Self::Arcsec => "arcsec",
            Self::Rev => "rev",
        }
    }
}

/// Unit of a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum TimeUnit {
    #[default]
    S,
    Ms,
    Us,
    Ns,
}

impl TimeUnit {
    /// s
    pub fn in_si(self, value: f64) -> f64 {
        match self {
            Self::S => value,
            Self::Ms => value / 1e3,
            Self::Us => value / 1e6,
            Self::Ns => value / 1e9,
        }
    }

    /// As column maps have it.
    pub fn key(self) -> &'static str {
        match self {
            Self::S => "s",
            Self::Ms => "ms",
            Self::Us => "us",
            Self::Ns => "ns",
        }
    }

    /// The unit that the name of a column of times ends with, as those of ROS do: `header.stamp.nanosec`.
    pub fn at_the_end_of(name: &str) -> Option<Self> {
        let name = name.to_ascii_lowercase();
        let ends = |endings: &[&str]| endings.iter().any(|ending| name.ends_with(ending));
        if ends(&["nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds"]) {
            Some(Self::Ns)
        } else if ends(&["usec", "microseconds"]) {
            Some(Self::Us)
        } else if ends(&["msec", "millisec", "milliseconds", "millis"]) {
            Some(Self::Ms)
        } else if ends(&["sec", "secs", "seconds"]) {
            Some(Self::S)
        } else {
            None
        }
    }
}

/// Unit of a temperature.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum TemperatureUnit {
    #[default]
    C,
    K,
    F,
}

impl TemperatureUnit {
    /// °C
    pub fn in_celsius(self, value: f64) -> f64 {
        match self {
            Self::C => value,
            Self::K => value - 273.15,
            Self::F => (value - 32.0) / 1.8,
        }
    }

    /// As keys of column maps end with it.
    pub fn key(self) -> &'static str {
        match self {
            Self::C => "c",
            Self::K => "k",
            Self::F => "f",
        }
    }

    /// As people write it.
    pub fn sign(self) -> &'static str {
        match self {
            Self::C => "°C",
            Self::K => "K",
            Self::F => "°F",
        }
    }
}

/// Range of the air temperature at a robot, °C.
pub(super) const TEMPERATURES: [f64; 2] = [-60.0, 120.0];

/// The unit in which a number would be a possible temperature, if it is not in the stated one.
pub(super) fn likelier_temperature(value: f64, stated: TemperatureUnit) -> Option<TemperatureUnit> {
    let others = [TemperatureUnit::C, TemperatureUnit::K, TemperatureUnit::F];
    others.into_iter().filter(|unit| *unit != stated).find(|unit| {
        // The range where people work.
        (-10.0..=60.0).contains(&unit.in_celsius(value))
    })
}

/// The air, apart from its temperature, in a unit of its key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum AirQuantity {
    Pressure(PressureUnit),
    /// Relative humidity, %.
    HumidityPercent,
}

/// Unit of a pressure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PressureUnit {
    Hpa,
    Pa,
    Kpa,
    Mmhg,
    Inhg,
}

impl PressureUnit {
    pub const ALL: [Self; 5] = [Self::Hpa, Self::Pa, Self::Kpa, Self::Mmhg, Self::Inhg];

    /// hPa
    fn in_hpa(self, value: f64) -> f64 {
        match self {
            Self::Hpa => value,
            Self::Pa => value / 100.0,
            Self::Kpa => value * 10.0,
            // The conventional millimetre and inch of mercury.
            Self::Mmhg => value * 1.333_223_874_15,
            Self::Inhg => value * 33.863_886_403_41,
        }
    }

    /// As keys of column maps end with it.
    pub fn key(self) -> &'static str {
        match self {
            Self::Hpa => "hpa",
            Self::Pa => "pa",
            Self::Kpa => "kpa",
            Self::Mmhg => "mmhg",
            Self::Inhg => "inhg",
        }
    }
}

/// Air pressures where people work, from the highest towns to the Dead Sea, hPa.
const PRESSURES: [f64; 2] = [500.0, 1100.0];

impl AirQuantity {
    /// Key of a column map.
    pub fn key(self) -> String {
        match self {
            Self::Pressure(unit) => format!("pressure_{}", unit.key()),
            Self::HumidityPercent => "humidity_percent".to_owned(),
        }
    }

    /// What is expected instead of an impossible number; `None` for a possible one.
    pub fn refused(self, value: f64) -> Option<String> {
        match self {
            Self::Pressure(unit) => {
                let can_be = |unit: PressureUnit| {
                    let hpa = unit.in_hpa(value);
                    (PRESSURES[0]..=PRESSURES[1]).contains(&hpa)
                };
                if can_be(unit) {
                    return None;
                }
                let other = PressureUnit::ALL.into_iter().find(|other| can_be(*other));
                let hint = other.map_or_else(String::new, |other| {
                    format!(": as {} it is possible; then the key is pressure_{0}", other.key())
                });
                let [least, most] = PRESSURES;
                Some(format!("an air pressure from {least} to {most} hPa{hint}"))
            }
            Self::HumidityPercent if (0.0..=100.0).contains(&value) => None,
            Self::HumidityPercent => Some("a relative humidity from 0 to 100 %".to_owned()),
        }
    }
}

/// A unit as a header states it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum HeaderUnit {
    Length(LengthUnit),
    Angle(AngleUnit),
    Time(TimeUnit),
    /// °C and so on: recognised as units, but not converted.
    Other,
}

impl HeaderUnit {
    /// As messages have it.
    pub fn key(self) -> &'static str {
        match self {
            Self::Length(unit) => unit.key(),
            Self::Angle(unit) => unit.key(),
            Self::Time(unit) => unit.key(),
            Self::Other => "another unit",
        }
    }

    /// The unit that a text is the name of.
    pub fn parse(text: &str) -> Option<Self> {
        // The micro sign and the Greek letter; the degree sign and its look-alikes.
        let text: String = text
            .trim()
            .chars()
            .map(|c| match c {
                '\u{b5}' | '\u{3bc}' => 'u',
                '\u{ba}' | '\u{2da}' => '\u{b0}',
                c => c.to_ascii_lowercase(),
            })
            .collect();
        Some(match text.as_str() {
            "m" | "meter" | "meters" | "metre" | "metres" => Self::Length(LengthUnit::M),
            "cm" | "centimeters" | "centimetres" => Self::Length(LengthUnit::Cm),
            "mm" | "millimeter" | "millimeters" | "millimetre" | "millimetres" => {
                Self::Length(LengthUnit::Mm)
            }
            "um" | "micron" | "microns" | "micrometers" | "micrometres" => Self::Length(LengthUnit::Um),
            "in" | "inch" | "inches" | "\"" => Self::Length(LengthUnit::Inch),
            "rad" | "radian" | "radians" => Self::Angle(AngleUnit::Rad),
            "mrad" | "milliradian" | "milliradians" => Self::Angle(AngleUnit::Mrad),
            "urad" | "microradian" | "microradians" => Self::Angle(AngleUnit::Urad),
            "deg" | "\u{b0}" | "degree" | "degrees" => Self::Angle(AngleUnit::Deg),
            "gon" | "gons" => Self::Angle(AngleUnit::Gon),
            "arcsec" | "arcsecond" | "arcseconds" | "''" => Self::Angle(AngleUnit::Arcsec),
            "rev" | "revolutions" | "turns" => Self::Angle(AngleUnit::Rev),
            "s" | "sec" | "seconds" => Self::Time(TimeUnit::S),
            "ms" | "msec" | "milliseconds" => Self::Time(TimeUnit::Ms),
            "us" | "microseconds" => Self::Time(TimeUnit::Us),
            "ns" | "nanoseconds" => Self::Time(TimeUnit::Ns),
            "\u{b0}c" | "%" | "%rh" | "hpa" | "mbar" | "mmhg" | "-" => Self::Other,
            _ => return None,
        })
    }
}

/// The name of a column, and the unit that stands in brackets behind it: `X [mm]`, `J1 (deg)`, `Az {rad}`, `x / mm`.
pub(super) fn name_and_unit(header: &str) -> (&str, Option<HeaderUnit>) {
    for (open, close) in [('[', ']'), ('(', ')'), ('{', '}'), ('<', '>')] {
        if let Some(inner) = header.strip_suffix(close)
            && let Some((name, unit)) = inner.rsplit_once(open)
            && let Some(unit) = HeaderUnit::parse(unit)
        {
            return (name.trim_end(), Some(unit));
        }
    }
    if let Some((name, unit)) = header.rsplit_once('/')
        && let Some(unit @ (HeaderUnit::Length(_) | HeaderUnit::Angle(_))) = HeaderUnit::parse(unit)
        && !name.trim().is_empty()
    {
        return (name.trim_end(), Some(unit));
    }
    (header, None)
}

/// The unit at the end of a name: `x_mm`.
pub(super) fn unit_of_name(name: &str) -> Option<HeaderUnit> {
    name.rsplit_once('_').and_then(|(_, unit)| HeaderUnit::parse(unit))
}

/// The unit of a cell below a header that holds nothing else: `mm`, `[deg]`.
pub(super) fn unit_alone(cell: &str) -> Option<HeaderUnit> {
    match name_and_unit(cell) {
        ("", unit) => unit,
        _ => HeaderUnit::parse(cell),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_of_headers_are_understood() {
        let mm = Some(HeaderUnit::Length(LengthUnit::Mm));
        let um = Some(HeaderUnit::Length(LengthUnit::Um));
        let deg = Some(HeaderUnit::Angle(AngleUnit::Deg));
        for (header, expected) in [
            ("X [mm]", ("X", mm)),
            ("X[MM]", ("X", mm)),
            ("J1 (deg)", ("J1", deg)),
            ("J1 (\u{b0})", ("J1", deg)),
            ("Ux [\u{b5}m]", ("Ux", um)),
            ("Ux [\u{3bc}m]", ("Ux", um)),
            ("T [\u{b0}C]", ("T", Some(HeaderUnit::Other))),
            ("x / mm", ("x", mm)),
            ("X (base)", ("X (base)", None)),
            ("x/y", ("x/y", None)),
            ("X_mm", ("X_mm", None)),
            ("[mm]", ("", mm)),
            ("J1 [rev]", ("J1", Some(HeaderUnit::Angle(AngleUnit::Rev)))),
            ("t [ms]", ("t", Some(HeaderUnit::Time(TimeUnit::Ms)))),
        ] {
            assert_eq!(name_and_unit(header), expected, "{header}");
        }
        assert_eq!(unit_alone("[mm]"), mm);
        assert_eq!(unit_alone("mm"), mm);
        assert_eq!(unit_alone("12"), None);
        for (text, unit) in
            [("\u{b5}rad", AngleUnit::Urad), ("urad", AngleUnit::Urad), ("arcsec", AngleUnit::Arcsec)]
        {
            assert_eq!(HeaderUnit::parse(text), Some(HeaderUnit::Angle(unit)), "{text}");
        }
        assert_eq!(AngleUnit::Urad.in_si(250.0), 250.0 / 1e6);
        assert_eq!(AngleUnit::Gon.in_si(400.0), std::f64::consts::TAU);
        assert_eq!(LengthUnit::Inch.in_si(10.0), 0.254);
        assert_eq!(AngleUnit::Rev.in_si(0.5), std::f64::consts::PI);
    }
}
