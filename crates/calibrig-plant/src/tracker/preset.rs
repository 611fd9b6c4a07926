//! Instruments by name, with figures from data sheets only.

use super::instrument::{ErrorLine, Instrument, Limits, RANDOM_FRACTION, SYSTEMATIC_FRACTION};

/// An instrument after a data sheet. How its errors are distributed within the permissible ones is assumed, the same for all.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Preset {
    /// Like a Leica Absolute Tracker AT500.
    At500,
    /// Like a Leica Absolute Tracker AT960.
    At960,
    /// Like a FARO Vantage S or E.
    Vantage,
    /// Like a Chotest GTS3800.
    Gts3800,
}

const UM: f64 = 1e-6;

impl Preset {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::At500, Self::At960, Self::Vantage, Self::Gts3800];

    /// The name in files and on the command line.
    pub fn key(self) -> &'static str {
        match self {
            Self::At500 => "at500",
            Self::At960 => "at960",
            Self::Vantage => "vantage",
            Self::Gts3800 => "gts3800",
        }
    }

    /// Reads [`key`](Self::key).
    pub fn parse(key: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|preset| preset.key() == key)
    }

    /// Source of its figures.
    pub fn source(self) -> &'static str {
        match self {
            Self::At500 => {
                "Leica AT500 user manual, 2.8.2: ADM 10 um + 0.3 um/m, R0 5 um, transverse 15 um + 6 um/m"
            }
            Self::At960 => "transverse 15 um + 6 um/m as quoted for the Leica AT960 in secondary sources",
            Self::Vantage => {
                "FARO Vantage S/E data sheet: transverse 20 um + 5 um/m, ADM 16 um + 0.8 um/m; its calibration certificate: 0.1 to 35 m, -15 to 50 C"
            }
            Self::Gts3800 => "Chotest GTS3800 data sheet: 15 um + 6 um/m of a point in space",
        }
    }

    /// What no source gives, and the assumption in its place.
    pub fn left_out(self) -> &'static str {
        match self {
            Self::At500 => {
                "its limits of range, angles and temperature: 0.1 to 30 m, any angle and temperature"
            }
            Self::At960 => {
                "its range error, taken as large as the transverse one; its limits: 0.1 to 30 m, any angle and temperature"
            }
            Self::Vantage => {
                "the zero of its range; its limits of angles, of which only a span of 130 deg in elevation is known: any angle"
            }
            Self::Gts3800 => {
                "its range error alone, which the error of a point bounds: taken as large; its limits: 0.1 to 30 m, any angle \
                 and temperature"
            }
        }
    }

    /// The instrument, with the systematic and random shares of the permissible errors that real ones show.
    pub fn instrument(self) -> Instrument {
        let line = |offset: f64, per_metre: f64| ErrorLine { offset: offset * UM, per_metre: per_metre * UM };
        let plain = |transverse, range| Instrument {
            preset: Some(self),
            systematic_fraction: SYSTEMATIC_FRACTION,
            ..Instrument::of_noise(transverse, range, RANDOM_FRACTION)
        };
        match self {
            Self::At500 => {
                Instrument { range_zero: Some(5.0 * UM), ..plain(line(15.0, 6.0), line(10.0, 0.3)) }
            }
            Self::At960 | Self::Gts3800 => plain(line(15.0, 6.0), line(15.0, 6.0)),
            Self::Vantage => Instrument {
                limits: Limits { range: [0.1, 35.0], temperature: [-15.0, 50.0], ..Limits::WIDE },
                ..plain(line(20.0, 5.0), line(16.0, 0.8))
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_back_and_every_instrument_can_be() {
        for preset in Preset::ALL {
            assert_eq!(Preset::parse(preset.key()), Some(preset));
            let instrument = preset.instrument();
            assert_eq!(instrument.check(), Ok(()));
            assert_eq!(instrument.preset, Some(preset));
            assert!(!preset.source().is_empty() && !preset.left_out().is_empty());
        }
        assert_eq!(Preset::parse("AT500"), None);
    }
}
