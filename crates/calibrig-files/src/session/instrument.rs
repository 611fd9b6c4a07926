//! `[station.instrument]`: what is known about the errors that all readings of an instrument share.

use serde::Deserialize;

use crate::input::{InputError, Source, Spanned};
use calibrig_model::measurement::{InstrumentTerm, StatedDrift, StatedInstrument};

/// Standard deviations about zero. Other units of the same quantity are accepted: `collimation_urad`, `range_offset_um`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct InstrumentTable {
    pub name: Spanned<String>,
    range_offset_m: Option<Spanned<f64>>,
    range_scale_m_per_m: Option<Spanned<f64>>,
    range_scale_um_per_m: Option<Spanned<f64>>,
    transit_offset_m: Option<Spanned<f64>>,
    beam_offset_transverse_m: Option<Spanned<f64>>,
    beam_offset_normal_m: Option<Spanned<f64>>,
    collimation_rad: Option<Spanned<f64>>,
    axis_tilt_rad: Option<Spanned<f64>>,
    vertical_index_rad: Option<Spanned<f64>>,
    azimuth_sin1_rad: Option<Spanned<f64>>,
    azimuth_cos1_rad: Option<Spanned<f64>>,
    azimuth_sin2_rad: Option<Spanned<f64>>,
    azimuth_cos2_rad: Option<Spanned<f64>>,
    elevation_sin1_rad: Option<Spanned<f64>>,
    elevation_cos1_rad: Option<Spanned<f64>>,
    elevation_sin2_rad: Option<Spanned<f64>>,
    elevation_cos2_rad: Option<Spanned<f64>>,
    drift_m_per_h: Option<Spanned<f64>>,
    drift_rad_per_h: Option<Spanned<f64>>,
}

/// The keys of a station's drift, along and about every axis of the base.
pub(super) const DRIFT_KEYS: [&str; 2] = ["drift_m_per_h", "drift_rad_per_h"];

/// The key that a term is written under, in SI.
pub(super) fn key_of(term: InstrumentTerm) -> &'static str {
    match term {
        InstrumentTerm::RangeOffset => "range_offset_m",
        InstrumentTerm::RangeScale => "range_scale_m_per_m",
        InstrumentTerm::TransitOffset => "transit_offset_m",
        InstrumentTerm::BeamOffsetTransverse => "beam_offset_transverse_m",
        InstrumentTerm::BeamOffsetNormal => "beam_offset_normal_m",
        InstrumentTerm::Collimation => "collimation_rad",
        InstrumentTerm::AxisTilt => "axis_tilt_rad",
        InstrumentTerm::VerticalIndex => "vertical_index_rad",
        InstrumentTerm::AzimuthSin1 => "azimuth_sin1_rad",
        InstrumentTerm::AzimuthCos1 => "azimuth_cos1_rad",
        InstrumentTerm::AzimuthSin2 => "azimuth_sin2_rad",
        InstrumentTerm::AzimuthCos2 => "azimuth_cos2_rad",
        InstrumentTerm::ElevationSin1 => "elevation_sin1_rad",
        InstrumentTerm::ElevationCos1 => "elevation_cos1_rad",
        InstrumentTerm::ElevationSin2 => "elevation_sin2_rad",
        InstrumentTerm::ElevationCos2 => "elevation_cos2_rad",
    }
}

impl InstrumentTable {
    fn of(&self, term: InstrumentTerm) -> Option<&Spanned<f64>> {
        match term {
            InstrumentTerm::RangeOffset => self.range_offset_m.as_ref(),
            InstrumentTerm::RangeScale => self.range_scale_m_per_m.as_ref(),
            InstrumentTerm::TransitOffset => self.transit_offset_m.as_ref(),
            InstrumentTerm::BeamOffsetTransverse => self.beam_offset_transverse_m.as_ref(),
            InstrumentTerm::BeamOffsetNormal => self.beam_offset_normal_m.as_ref(),
            InstrumentTerm::Collimation => self.collimation_rad.as_ref(),
            InstrumentTerm::AxisTilt => self.axis_tilt_rad.as_ref(),
            InstrumentTerm::VerticalIndex => self.vertical_index_rad.as_ref(),
            InstrumentTerm::AzimuthSin1 => self.azimuth_sin1_rad.as_ref(),
            InstrumentTerm::AzimuthCos1 => self.azimuth_cos1_rad.as_ref(),
            InstrumentTerm::AzimuthSin2 => self.azimuth_sin2_rad.as_ref(),
            InstrumentTerm::AzimuthCos2 => self.azimuth_cos2_rad.as_ref(),
            InstrumentTerm::ElevationSin1 => self.elevation_sin1_rad.as_ref(),
            InstrumentTerm::ElevationCos1 => self.elevation_cos1_rad.as_ref(),
            InstrumentTerm::ElevationSin2 => self.elevation_sin2_rad.as_ref(),
            InstrumentTerm::ElevationCos2 => self.elevation_cos2_rad.as_ref(),
        }
    }

    /// The station's motion on its stand; if one of the two is missing, it is zero.
    fn drift(&self, source: &Source) -> Result<Option<StatedDrift>, InputError> {
        let (motion, turn) = (&self.drift_m_per_h, &self.drift_rad_per_h);
        if motion.is_none() && turn.is_none() {
            return Ok(None);
        }
        let of = |key: &str, value: &Option<Spanned<f64>>| {
            value.as_ref().map_or(Ok(0.0), |value| source.not_negative(key, value))
        };
        Ok(Some(StatedDrift {
            motion_per_hour: of(DRIFT_KEYS[0], motion)?,
            turn_per_hour: of(DRIFT_KEYS[1], turn)?,
        }))
    }

    /// The terms in the order of the text.
    pub fn read(&self, source: &Source) -> Result<StatedInstrument, InputError> {
        // An instrument without one of the errors leaves its key out.
        let sigma = |key: &str, value: &Spanned<f64>| source.positive(key, value);
        let mut terms: Vec<(usize, InstrumentTerm, f64)> = Vec::new();
        for term in InstrumentTerm::ALL {
            let Some(value) = self.of(term) else { continue };
            terms.push((value.span().start, term, sigma(key_of(term), value)?));
        }
        if let Some(value) = &self.range_scale_um_per_m {
            if self.range_scale_m_per_m.is_some() {
                let message = "range_scale_um_per_m and range_scale_m_per_m state the same quantity";
                return Err(source.error(
                    value.span(),
                    message,
                    Some("expected only one of them".to_owned()),
                ));
            }
            let scale = sigma("range_scale_um_per_m", value)? * 1e-6;
            terms.push((value.span().start, InstrumentTerm::RangeScale, scale));
        }
        terms.sort_by_key(|(place, ..)| *place);
        let sigmas = terms.into_iter().map(|(_, term, sigma)| (term, sigma)).collect();
        Ok(StatedInstrument { name: self.name.get_ref().clone(), sigmas, drift: self.drift(source)? })
    }
}

/// The difference between two statements of one instrument, in words.
pub(super) fn difference(one: &StatedInstrument, other: &StatedInstrument) -> Option<String> {
    let of = |instrument: &StatedInstrument, term: InstrumentTerm| {
        instrument.sigmas.iter().find(|(known, _)| *known == term).map(|(_, sigma)| *sigma)
    };
    InstrumentTerm::ALL.into_iter().find_map(|term| {
        let (a, b) = (of(one, term), of(other, term));
        let said =
            |sigma: Option<f64>| sigma.map_or_else(|| "not stated".to_owned(), |sigma| format!("{sigma:e}"));
        (a != b).then(|| format!("{} is {} here but {} there", key_of(term), said(a), said(b)))
    })
}
