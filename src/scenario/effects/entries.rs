//! The entries of the sections, as in the file.

use std::ops::Range;

use serde::Deserialize;

use calibrig_files::Spanned;

pub(super) fn yes() -> bool {
    true
}

/// A section with one entry per joint.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::scenario) struct Section<E> {
    #[serde(default = "yes")]
    pub enabled: bool,
    #[serde(default = "Vec::new")]
    pub joint: Vec<Spanned<E>>,
}

/// An entry that names its joint.
pub(super) trait Joint {
    fn joint(&self) -> &Spanned<String>;
}

macro_rules! entry {
    ($(#[$about:meta])* $name:ident { $($key:ident: $kind:ty),* $(,)? }) => {
        $(#[$about])*
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        pub(in crate::scenario) struct $name {
            pub joint: Spanned<String>,
            $(pub $key: $kind,)*
        }

        impl Joint for $name {
            fn joint(&self) -> &Spanned<String> {
                &self.joint
            }
        }
    };
}

entry!(HarmonicEntry {
    motor_turns_per_rev: Option<Spanned<f64>>,
    motor_turns_per_m: Option<Spanned<f64>>,
    once_um: Option<Spanned<f64>>,
    once_arcsec: Option<Spanned<f64>>,
    once_phase_deg: Option<Spanned<f64>>,
    twice_um: Option<Spanned<f64>>,
    twice_arcsec: Option<Spanned<f64>>,
    twice_phase_deg: Option<Spanned<f64>>,
});
entry!(TransmissionEntry { wave: Vec<WaveFile> });

/// One wave of a transmission error.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::scenario) struct WaveFile {
    pub cycles_per_rev: Option<Spanned<f64>>,
    pub period_mm: Option<Spanned<f64>>,
    pub amplitude_um: Option<Spanned<f64>>,
    pub amplitude_arcsec: Option<Spanned<f64>>,
    pub growth_um_per_kn: Option<Spanned<f64>>,
    pub growth_arcsec_per_knm: Option<Spanned<f64>>,
    pub phase_deg: Option<Spanned<f64>>,
}

entry!(LostMotionEntry {
    gap_um: Option<Spanned<f64>>,
    gap_arcsec: Option<Spanned<f64>>,
    friction_n: Option<Spanned<f64>>,
    friction_nm: Option<Spanned<f64>>,
    closes_at_n: Option<Spanned<f64>>,
    closes_at_nm: Option<Spanned<f64>>,
});
entry!(StiffeningEntry {
    stiffness_percent: Vec<Spanned<f64>>,
    limits_n: Option<Spanned<Vec<Spanned<f64>>>>,
    limits_nm: Option<Spanned<Vec<Spanned<f64>>>>,
});
entry!(RatioEntry { relative_ppm: Spanned<f64> });
entry!(BacklashEntry { gap_um: Option<Spanned<f64>>, gap_arcsec: Option<Spanned<f64>> });
entry!(FrictionEntry {
    friction_n: Option<Spanned<f64>>,
    friction_nm: Option<Spanned<f64>>,
    percent_of_load: Option<Spanned<f64>>,
    presliding_mm: Option<Spanned<f64>>,
    presliding_deg: Option<Spanned<f64>>,
});
entry!(EncoderEntry {
    step_um: Option<Spanned<f64>>,
    step_arcsec: Option<Spanned<f64>>,
    offset_um: Option<Spanned<f64>>,
    offset_arcsec: Option<Spanned<f64>>,
});
entry!(RepeatabilityEntry { sigma_um: Option<Spanned<f64>>, sigma_arcsec: Option<Spanned<f64>> });

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::scenario) struct RailFile {
    #[serde(default = "yes")]
    pub enabled: bool,
    pub joint: Spanned<String>,
    pub wavelength_mm: Spanned<f64>,
    pub horizontal: Option<ProfileFile>,
    pub vertical: Option<ProfileFile>,
    pub roll: Option<ProfileFile>,
    pub pitch: Option<ProfileFile>,
    pub yaw: Option<ProfileFile>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::scenario) struct ProfileFile {
    pub polynomial_um: Option<Spanned<Vec<Spanned<f64>>>>,
    pub polynomial_arcsec: Option<Spanned<Vec<Spanned<f64>>>>,
    pub wave_um: Option<Spanned<f64>>,
    pub wave_arcsec: Option<Spanned<f64>>,
    pub phase_deg: Option<Spanned<f64>>,
}

impl ProfileFile {
    /// Where the first key with the unit of lengths stands.
    pub(super) fn first_in_um(&self) -> Option<Range<usize>> {
        let wave = self.wave_um.as_ref().map(Spanned::span);
        self.polynomial_um.as_ref().map(Spanned::span).or(wave)
    }

    /// Where the first key with the unit of angles stands.
    pub(super) fn first_in_arcsec(&self) -> Option<Range<usize>> {
        let wave = self.wave_arcsec.as_ref().map(Spanned::span);
        self.polynomial_arcsec.as_ref().map(Spanned::span).or(wave)
    }
}
