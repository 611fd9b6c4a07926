//! Effects of the axes, the beam and the encoders of an instrument on a reading, from their geometry.
//!
//! A head turns about the standing axis z by θ and carries, at [`transit_offset`](Misalignment::transit_offset) along its own x, the transit axis, which
//! is its y lifted by [`axis_tilt`](Misalignment::axis_tilt). A telescope turns about that by φ and carries the beam, which leaves at an offset along the transit
//! axis and across it, turned by [`collimation`](Misalignment::collimation) out of a right angle to it. After a length ρ it is at
//!
//! ```text
//! P(θ, φ, ρ) = Rz(θ) · [ (t, 0, 0) + Rx(i) · Ry(-φ) · ( (0, b_y, b_z) + ρ (cos c, sin c, 0) ) ]
//! ```
//!
//! A reading consists of what the encoders and the range show at the (θ, φ, ρ) that reach the target. The instrument interprets them as those of
//! perfect axes.

use calibrig_model::measurement::{Face, InstrumentTerm};
use nalgebra::Vector3;

use super::TrackerError;
use super::encoder::Encoder;

/// The errors of an instrument's geometry. The default has none.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Misalignment {
    /// The transit axis in front of the standing axis, along the head's x, m.
    pub transit_offset: f64,
    /// Where the beam leaves, along the transit axis (`b_y`) and across it (`b_z`), m.
    pub beam_offset: [f64; 2],
    /// The beam from a right angle to the transit axis, towards its positive end, rad.
    pub collimation: f64,
    /// The transit axis from a right angle to the standing axis, its positive end up, rad.
    pub axis_tilt: f64,
    /// Errors of the displayed range over the length of the beam: m, and relative.
    pub range_offset: f64,
    /// The same, relative.
    pub range_scale: f64,
    /// Of the standing axis.
    pub azimuth: Encoder,
    /// Of the transit axis; its zero is the vertical index.
    pub elevation: Encoder,
}

/// Reading of a point: range (m), azimuth and elevation (rad) as of its direction, whatever the face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shown {
    /// m
    pub range: f64,
    /// rad, within half a turn of the point's azimuth.
    pub azimuth: f64,
    /// rad
    pub elevation: f64,
}

/// Most rounds of the solution. Each reduces the error by offset times angle over the distance: for an instrument two are enough.
const ROUNDS: usize = 6;

impl Misalignment {
    /// With errors named by their effect: an error of amplitude x (m, rad or 1) displaces small readings as
    /// [`InstrumentTerm`] states. The order of the amplitudes does not matter; those of one name add up.
    pub fn of(errors: impl IntoIterator<Item = (InstrumentTerm, f64)>) -> Self {
        let mut own = Self::default();
        for (term, x) in errors {
            match term {
                InstrumentTerm::RangeOffset => own.range_offset += x,
                InstrumentTerm::RangeScale => own.range_scale += x,
                // An offset in front of the standing axis shortens the path, and one to the side turns the head back.
                InstrumentTerm::TransitOffset => own.transit_offset -= x,
                InstrumentTerm::BeamOffsetTransverse => own.beam_offset[0] -= x,
                InstrumentTerm::BeamOffsetNormal => own.beam_offset[1] -= x,
                InstrumentTerm::Collimation => own.collimation -= x,
                InstrumentTerm::AxisTilt => own.axis_tilt += x,
                InstrumentTerm::VerticalIndex => own.elevation.zero += x,
                InstrumentTerm::AzimuthSin1 => own.azimuth.centre[0] += x,
                InstrumentTerm::AzimuthCos1 => own.azimuth.centre[1] -= x,
                InstrumentTerm::AzimuthSin2 => own.azimuth.oval -= x,
                InstrumentTerm::AzimuthCos2 => own.azimuth.oval_diagonal += x,
                InstrumentTerm::ElevationSin1 => own.elevation.centre[0] += x,
                InstrumentTerm::ElevationCos1 => own.elevation.centre[1] -= x,
                InstrumentTerm::ElevationSin2 => own.elevation.oval -= x,
                InstrumentTerm::ElevationCos2 => own.elevation.oval_diagonal += x,
            }
        }
        own
    }

    /// The inverse of [`of`](Self::of): the amplitude (m, rad or 1) of every error, to first order and in the order of [`InstrumentTerm::ALL`]. The
    /// zero of the azimuth is not among them: it belongs to the instrument's orientation.
    pub fn amplitudes(&self) -> Vec<(InstrumentTerm, f64)> {
        let Self { transit_offset, beam_offset, collimation, axis_tilt, range_offset, range_scale, .. } =
            *self;
        let [azimuth, elevation] = [&self.azimuth, &self.elevation];
        let amplitude = |term| match term {
            InstrumentTerm::RangeOffset => range_offset,
            InstrumentTerm::RangeScale => range_scale,
            InstrumentTerm::TransitOffset => 0.0 - transit_offset,
            InstrumentTerm::BeamOffsetTransverse => 0.0 - beam_offset[0],
            InstrumentTerm::BeamOffsetNormal => 0.0 - beam_offset[1],
            InstrumentTerm::Collimation => 0.0 - collimation,
            InstrumentTerm::AxisTilt => axis_tilt,
            InstrumentTerm::VerticalIndex => elevation.zero,
            InstrumentTerm::AzimuthSin1 => azimuth.centre[0],
            InstrumentTerm::AzimuthCos1 => 0.0 - azimuth.centre[1],
            InstrumentTerm::AzimuthSin2 => 0.0 - azimuth.oval,
            InstrumentTerm::AzimuthCos2 => azimuth.oval_diagonal,
            InstrumentTerm::ElevationSin1 => elevation.centre[0],
            InstrumentTerm::ElevationCos1 => 0.0 - elevation.centre[1],
            InstrumentTerm::ElevationSin2 => 0.0 - elevation.oval,
            InstrumentTerm::ElevationCos2 => elevation.oval_diagonal,
        };
        InstrumentTerm::ALL.map(|term| (term, amplitude(term))).to_vec()
    }

    /// The reading of a point in the tracker's frame (m).
    pub fn read(&self, point: &Vector3<f64>, face: Face) -> Result<Shown, TrackerError> {
        if face == Face::Both {
            let (front, back) = (self.read(point, Face::Front)?, self.read(point, Face::Back)?);
            // Both show the direction of the point, but may differ by a turn.
            let turns = ((back.azimuth - front.azimuth) / std::f64::consts::TAU).round();
            return Ok(Shown {
                range: f64::midpoint(front.range, back.range),
                azimuth: f64::midpoint(front.azimuth, back.azimuth - turns * std::f64::consts::TAU),
                elevation: f64::midpoint(front.elevation, back.elevation),
            });
        }
        let flat = point.x.hypot(point.y);
        let direction = point.y.atan2(point.x);
        if *self == Self::default() {
            // An arcsine would lose half of the digits near the zenith.
            let elevation = point.z.atan2(flat);
            return Ok(Shown { range: point.norm(), azimuth: direction, elevation });
        }
        let t = self.transit_offset;
        let [beam_y, beam_z] = self.beam_offset;
        let (sin_c, cos_c) = self.collimation.sin_cos();
        let (sin_i, cos_i) = self.axis_tilt.sin_cos();
        let side = face.sign();
        let refused = TrackerError::BesideTheAxis { distance: flat };
        // δ is the point's azimuth in the head. The beam's share along the transit axis gives sin δ, the distance from where it leaves gives ρ.
        let (mut sin_d, mut cos_d, mut way) = (0.0, side, 0.0);
        for _ in 0..ROUNDS {
            let square = flat * flat + point.z * point.z + t * (t - 2.0 * flat * cos_d);
            let root = (beam_y * sin_c).powi(2) + square - beam_y * beam_y - beam_z * beam_z;
            if !(root >= 0.0) {
                return Err(refused);
            }
            let before = std::mem::replace(&mut way, root.sqrt() - beam_y * sin_c);
            if (way - before).abs() <= f64::EPSILON * way {
                break;
            }
            let along = beam_y + way * sin_c - point.z * sin_i;
            sin_d = if along == 0.0 { 0.0 } else { along / (flat * cos_i) };
            let rest = 1.0 - sin_d * sin_d;
            if !(rest >= 0.0) {
                return Err(refused);
            }
            cos_d = side * rest.sqrt();
        }
        let turn = sin_d.asin();
        let (ahead, up) = (flat * cos_d - t, cos_i * point.z - sin_i * flat * sin_d);
        let lead = beam_z.atan2(way * cos_c);
        let (azimuth, elevation) = match face {
            Face::Front | Face::Both => {
                let theta = direction - turn;
                let phi = up.atan2(ahead) - lead;
                (theta + self.azimuth.error(theta), phi + self.elevation.error(phi))
            }
            // The head shows half a turn more than the direction, the telescope half a turn minus it.
            Face::Back => {
                let theta = direction + turn;
                let phi = up.atan2(-ahead) + lead;
                let half = std::f64::consts::PI;
                (theta + self.azimuth.error(theta - half), phi - self.elevation.error(half - phi))
            }
        };
        Ok(Shown { range: (1.0 + self.range_scale) * way + self.range_offset, azimuth, elevation })
    }
}
