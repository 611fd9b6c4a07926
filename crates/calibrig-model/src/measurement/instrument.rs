//! First-order effects of a laser tracker's own geometry on its readings, and their stated sizes.
//!
//! The signatures are those of B. Muralikrishnan et al., "ASME B89.4.19 performance evaluation tests and geometric misalignments in laser
//! trackers", J. Res. NIST 114 (2009) 21-35, and B. Hughes et al., "Laser tracker error determination using a network measurement", Meas.
//! Sci. Technol. 22 (2011) 045103, for a tracker whose laser sits in the turning head. Here they are written for azimuth and elevation in
//! the front face; [`InstrumentTerm::displacement`] includes the back face.

use std::fmt;

use nalgebra::Vector3;
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::Station;
use crate::Unit;

/// In which of its two positions a tracker took a reading. In the back face its head is turned by half a turn and its telescope is turned over, so
/// that the encoders show azimuth + 180° and 360° - zenith. Angles of both faces are kept as directions of the point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Default, Serialize, Deserialize)]
pub enum Face {
    /// The usual one.
    #[default]
    Front,
    /// Head and telescope turned over.
    Back,
    /// The mean of one reading in each: errors that turn over with the telescope cancel in it.
    Both,
}

impl Face {
    /// The key in files and JSON.
    pub fn key(self) -> &'static str {
        match self {
            Self::Front => "front",
            Self::Back => "back",
            Self::Both => "both",
        }
    }

    /// 1 of the front face, -1 of the back face, 0 of the mean of both.
    pub fn sign(self) -> f64 {
        match self {
            Self::Front => 1.0,
            Self::Back => -1.0,
            Self::Both => 0.0,
        }
    }
}

/// A systematic error of a tracker that is the same in all readings of the instrument. Each displaces the reading by its amplitude times
/// the signature below: R is the range, H the azimuth, E the elevation, s is 1 in the front face and -1 in the back face.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum InstrumentTerm {
    /// Offset of the range, m: dR = x.
    RangeOffset,
    /// Scale of the range, 1: dR = x R.
    RangeScale,
    /// Distance between standing and transit axis, m: dR = s x cos E, dE = -s x sin E / R.
    TransitOffset,
    /// Sideways offset of the beam from the standing axis, m: dH = s x / (R cos E).
    BeamOffsetTransverse,
    /// Offset of the beam from the transit axis, m: dE = s x / R.
    BeamOffsetNormal,
    /// Collimation, the angle between the beam and a right angle to the transit axis, rad: dH = s x / cos E.
    Collimation,
    /// Angle between the transit axis and a right angle to the standing axis, rad: dH = s x tan E.
    AxisTilt,
    /// Zero of the elevation, rad: dE = s x.
    VerticalIndex,
    /// Eccentricity of the azimuth encoder, rad: dH = s x sin H.
    AzimuthSin1,
    /// The same in quadrature, rad: dH = s x cos H.
    AzimuthCos1,
    /// Second order of the azimuth encoder, rad: dH = x sin 2H.
    AzimuthSin2,
    /// The same in quadrature, rad: dH = x cos 2H.
    AzimuthCos2,
    /// Eccentricity of the elevation encoder, rad: dE = s x sin E.
    ElevationSin1,
    /// The same in quadrature, rad: dE = x cos E.
    ElevationCos1,
    /// Second order of the elevation encoder, rad: dE = x sin 2E.
    ElevationSin2,
    /// The same in quadrature, rad: dE = s x cos 2E.
    ElevationCos2,
}

impl InstrumentTerm {
    /// All of them.
    pub const ALL: [Self; 16] = [
        Self::RangeOffset,
        Self::RangeScale,
        Self::TransitOffset,
        Self::BeamOffsetTransverse,
        Self::BeamOffsetNormal,
        Self::Collimation,
        Self::AxisTilt,
        Self::VerticalIndex,
        Self::AzimuthSin1,
        Self::AzimuthCos1,
        Self::AzimuthSin2,
        Self::AzimuthCos2,
        Self::ElevationSin1,
        Self::ElevationCos1,
        Self::ElevationSin2,
        Self::ElevationCos2,
    ];

    /// The name in files, and after `tracker_` in parameters.
    pub fn key(self) -> &'static str {
        match self {
            Self::RangeOffset => "range_offset",
            Self::RangeScale => "range_scale",
            Self::TransitOffset => "transit_offset",
            Self::BeamOffsetTransverse => "beam_offset_transverse",
            Self::BeamOffsetNormal => "beam_offset_normal",
            Self::Collimation => "collimation",
            Self::AxisTilt => "axis_tilt",
            Self::VerticalIndex => "vertical_index",
            Self::AzimuthSin1 => "azimuth_sin1",
            Self::AzimuthCos1 => "azimuth_cos1",
            Self::AzimuthSin2 => "azimuth_sin2",
            Self::AzimuthCos2 => "azimuth_cos2",
            Self::ElevationSin1 => "elevation_sin1",
            Self::ElevationCos1 => "elevation_cos1",
            Self::ElevationSin2 => "elevation_sin2",
            Self::ElevationCos2 => "elevation_cos2",
        }
    }

    /// What it is, for people.
    pub fn about(self) -> &'static str {
        match self {
            Self::RangeOffset => "offset of the range",
            Self::RangeScale => "scale of the range",
            Self::TransitOffset => "distance between standing and transit axis",
            Self::BeamOffsetTransverse => "sideways offset of the beam",
            Self::BeamOffsetNormal => "offset of the beam from the transit axis",
            Self::Collimation => "collimation",
            Self::AxisTilt => "tilt of the transit axis",
            Self::VerticalIndex => "zero of the elevation",
            Self::AzimuthSin1 | Self::AzimuthCos1 => "eccentricity of the azimuth encoder",
            Self::AzimuthSin2 | Self::AzimuthCos2 => "second order of the azimuth encoder",
            Self::ElevationSin1 | Self::ElevationCos1 => "eccentricity of the elevation encoder",
            Self::ElevationSin2 | Self::ElevationCos2 => "second order of the elevation encoder",
        }
    }

    /// Reads [`key`](Self::key).
    pub fn parse(key: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|term| term.key() == key)
    }

    /// The SI unit of its amplitude.
    pub fn unit(self) -> Unit {
        match self {
            Self::RangeScale => Unit::One,
            Self::RangeOffset | Self::TransitOffset | Self::BeamOffsetTransverse | Self::BeamOffsetNormal => {
                Unit::Metre
            }
            _ => Unit::Radian,
        }
    }

    /// Displacement of a point's reading per unit of the amplitude, as a length at the point, m: along the beam, along growing azimuth and
    /// along growing elevation. A length, because an angle's error grows without limit near the zenith while its effect there stays small.
    pub fn displacement(self, range: f64, azimuth: f64, elevation: f64, face: Face) -> Vector3<f64> {
        let s = face.sign();
        let (sin_az, cos_az) = azimuth.sin_cos();
        let (sin_el, cos_el) = elevation.sin_cos();
        let along = |size: f64| Vector3::new(size, 0.0, 0.0);
        // An error of the azimuth by 1 / cos E is a length of R, one by 1 a length of R cos E.
        let across = |size: f64| Vector3::new(0.0, size, 0.0);
        let up = |size: f64| Vector3::new(0.0, 0.0, size);
        let flat = range * cos_el;
        match self {
            Self::RangeOffset => along(1.0),
            Self::RangeScale => along(range),
            Self::TransitOffset => Vector3::new(s * cos_el, 0.0, -s * sin_el),
            Self::BeamOffsetTransverse => across(s),
            Self::BeamOffsetNormal => up(s),
            Self::Collimation => across(s * range),
            Self::AxisTilt => across(s * range * sin_el),
            Self::VerticalIndex => up(s * range),
            Self::AzimuthSin1 => across(s * flat * sin_az),
            Self::AzimuthCos1 => across(s * flat * cos_az),
            Self::AzimuthSin2 => across(flat * (2.0 * azimuth).sin()),
            Self::AzimuthCos2 => across(flat * (2.0 * azimuth).cos()),
            Self::ElevationSin1 => up(s * range * sin_el),
            Self::ElevationCos1 => up(range * cos_el),
            Self::ElevationSin2 => up(range * (2.0 * elevation).sin()),
            Self::ElevationCos2 => up(s * range * (2.0 * elevation).cos()),
        }
    }
}

impl fmt::Display for InstrumentTerm {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.key())
    }
}

impl Serialize for InstrumentTerm {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.key())
    }
}

impl<'de> Deserialize<'de> for InstrumentTerm {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let key = String::deserialize(deserializer)?;
        Self::parse(&key).ok_or_else(|| D::Error::custom(format_args!("there is no instrument term {key:?}")))
    }
}

/// What an operator knows about the instrument at a station besides the noise of single readings, such as from its data sheet. Stations
/// whose instruments have the same name share its errors.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct StatedInstrument {
    /// Name for people, such as a serial number.
    pub name: String,
    /// Standard deviation about zero of each error that the instrument can have, m, rad or 1. Errors that are not listed are taken as zero.
    pub sigmas: Vec<(InstrumentTerm, f64)>,
    /// How far its stand may let it move while it measures, unless repeated nests remove that motion. Every station moves independently.
    pub drift: Option<StatedDrift>,
}

/// Standard deviations about zero of a steady motion of a tracker on its stand.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct StatedDrift {
    /// Along each axis of the base, m in an hour.
    pub motion_per_hour: f64,
    /// About each of them, rad in an hour.
    pub turn_per_hour: f64,
}

impl StatedDrift {
    /// Of a component of the motion: 0..3 along, 3..6 about.
    pub fn sigma(&self, component: usize) -> f64 {
        if component < 3 { self.motion_per_hour } else { self.turn_per_hour }
    }
}

/// Seconds of the unit of time that [`StatedDrift`] counts in.
pub const DRIFT_UNIT: f64 = 3600.0;

impl StatedInstrument {
    /// The errors that it can have, with their standard deviations above zero.
    pub fn errors(&self) -> impl Iterator<Item = (InstrumentTerm, f64)> + '_ {
        self.sigmas.iter().copied().filter(|(_, sigma)| *sigma > 0.0)
    }

    /// The instruments of the stations, each once, and the index among them for every station. If stations name the same instrument, the
    /// first states its errors.
    pub fn of_stations(stations: &[Station]) -> (Vec<&Self>, Vec<Option<usize>>) {
        let mut known: Vec<&Self> = Vec::new();
        let mut own = Vec::with_capacity(stations.len());
        for station in stations {
            own.push(station.instrument.as_ref().map(|stated| {
                known.iter().position(|other| other.name == stated.name).unwrap_or_else(|| {
                    known.push(stated);
                    known.len() - 1
                })
            }));
        }
        (known, own)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_back_and_units_are_of_the_signature() {
        for term in InstrumentTerm::ALL {
            assert_eq!(InstrumentTerm::parse(term.key()), Some(term));
            // A length does the same at any range; an angle or a scale grows with it.
            let size = |range: f64| term.displacement(range, 0.4, 0.3, Face::Front).norm();
            let growth = if term.unit() == Unit::Metre { 1.0 } else { 3.0 };
            assert!((size(6.0) / size(2.0) - growth).abs() < 1e-12, "{term}");
        }
        assert_eq!(InstrumentTerm::parse("range"), None);
    }

    #[test]
    fn two_faces_show_what_turns_over_and_average_it_out() {
        let turns_over = |term: InstrumentTerm| {
            let at = |face| term.displacement(4.0, 1.1, -0.4, face);
            let (front, back) = (at(Face::Front), at(Face::Back));
            assert!(front == back || front == -back, "{term}");
            front == -back
        };
        let over: Vec<_> =
            InstrumentTerm::ALL.into_iter().filter(|t| turns_over(*t)).map(InstrumentTerm::key).collect();
        let expected = "transit_offset beam_offset_transverse beam_offset_normal collimation axis_tilt vertical_index azimuth_sin1 azimuth_cos1 elevation_sin1 \
                        elevation_cos2";
        assert_eq!(over.join(" "), expected);
    }
}
