//! Which systematic errors an instrument of a kind has.
//!
//! Sizes follow from the permissible errors of the data sheet: a length (of axes, beam, range) has a standard deviation of a share of
//! the permissible error's offset, an angle and the range's scale one of its slope.

use calibrig_model::measurement::InstrumentTerm;
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use super::instrument::Instrument;
use super::misalignment::Misalignment;

impl Instrument {
    /// Standard deviation of a systematic error over instruments of the kind: m, rad or 1.
    pub fn systematic_sigma(&self, term: InstrumentTerm) -> f64 {
        let permitted = match term {
            InstrumentTerm::RangeOffset => self.range_zero.unwrap_or(self.range.offset),
            InstrumentTerm::RangeScale => self.range.per_metre,
            InstrumentTerm::TransitOffset
            | InstrumentTerm::BeamOffsetTransverse
            | InstrumentTerm::BeamOffsetNormal => self.transverse.offset,
            InstrumentTerm::Collimation
            | InstrumentTerm::AxisTilt
            | InstrumentTerm::VerticalIndex
            | InstrumentTerm::AzimuthSin1
            | InstrumentTerm::AzimuthCos1
            | InstrumentTerm::AzimuthSin2
            | InstrumentTerm::AzimuthCos2
            | InstrumentTerm::ElevationSin1
            | InstrumentTerm::ElevationCos1
            | InstrumentTerm::ElevationSin2
            | InstrumentTerm::ElevationCos2 => self.transverse.per_metre,
        };
        self.systematic_fraction * permitted
    }

    /// The real errors of one instrument of the kind, whether it passes its test or not. Takes one number from `rng` for each
    /// error, whatever the sizes are.
    pub fn draw_misalignment(&self, rng: &mut impl Rng) -> Misalignment {
        Misalignment::of(InstrumentTerm::ALL.map(|term| {
            let unit: f64 = StandardNormal.sample(rng);
            (term, self.real.systematic * (self.systematic_sigma(term) * unit))
        }))
    }
}
