//! Errors of a real machine besides geometry and elasticity, one file per effect. Each is off by default.
//!
//! All effects are pure functions. Those that depend on the way to a pose take the previous [`DriveState`] and return the new one;
//! random ones draw from the given stream.

mod apply;
mod backlash;
mod encoder;
mod error;
mod foundation;
mod friction;
mod harmonics;
mod hose;
mod lost_motion;
mod rail;
mod ratio;
mod repeatability;
mod stiffening;
mod thermal;
mod transmission;

#[cfg(test)]
mod tests;

pub use apply::{Commanded, DriveState, PoseEffects};
pub use backlash::Backlash;
pub use encoder::Encoder;
pub use error::EffectError;
pub use foundation::{Foundation, RailSpan};
pub use friction::Friction;
pub use harmonics::{Harmonic, Harmonics};
pub use hose::{Anchor, Hose, Hoses};
pub use lost_motion::LostMotion;
pub use rail::{Rail, RailProfile};
pub use ratio::Ratio;
pub use repeatability::Repeatability;
pub use stiffening::{Stiffening, StiffnessCurve};
pub use thermal::{AMBIENT_RANGE, Ambient, DriveHeat, GrowingPart, Growth, MOST_RISE, Thermal, Warmth};
pub use transmission::{Transmission, TransmissionWave};

/// The kinds of non-geometric errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum EffectKind {
    /// [`Harmonics`]
    Harmonics,
    /// [`Ratio`]
    Ratio,
    /// [`Rail`]
    Rail,
    /// [`Transmission`]
    Transmission,
    /// [`Backlash`]
    Backlash,
    /// [`LostMotion`]
    LostMotion,
    /// [`Friction`]
    Friction,
    /// [`Stiffening`]
    Stiffening,
    /// [`Encoder`]
    Encoder,
    /// [`Thermal`]
    Thermal,
    /// [`Repeatability`]
    Repeatability,
    /// [`Foundation`]
    Foundation,
    /// [`Hoses`]
    Hoses,
}

impl EffectKind {
    /// All, in the order in which they act.
    pub const ALL: [Self; 13] = [
        Self::Encoder,
        Self::Ratio,
        Self::Harmonics,
        Self::Transmission,
        Self::Backlash,
        Self::LostMotion,
        Self::Friction,
        Self::Repeatability,
        Self::Stiffening,
        Self::Rail,
        Self::Thermal,
        Self::Foundation,
        Self::Hoses,
    ];

    /// Its section of a scenario is `[effects.KEY]`.
    pub fn key(self) -> &'static str {
        match self {
            Self::Harmonics => "harmonics",
            Self::Ratio => "ratio",
            Self::Rail => "rail",
            Self::Backlash => "backlash",
            Self::Friction => "friction",
            Self::Encoder => "encoder",
            Self::Transmission => "transmission",
            Self::LostMotion => "lost_motion",
            Self::Stiffening => "stiffening",
            Self::Thermal => "thermal",
            Self::Repeatability => "repeatability",
            Self::Foundation => "foundation",
            Self::Hoses => "hoses",
        }
    }

    /// Name for people.
    pub fn title(self) -> &'static str {
        match self {
            Self::Harmonics => "transmission harmonics",
            Self::Ratio => "gear ratio and rail pitch",
            Self::Rail => "rail straightness",
            Self::Backlash => "backlash",
            Self::Friction => "friction",
            Self::Encoder => "encoders",
            Self::Transmission => "transmission error at the output",
            Self::LostMotion => "lost motion under load",
            Self::Stiffening => "stiffening drives",
            Self::Thermal => "thermal growth",
            Self::Repeatability => "repeatability",
            Self::Foundation => "yielding floor and rail",
            Self::Hoses => "hoses",
        }
    }

    /// A description in one line.
    pub fn about(self) -> &'static str {
        match self {
            Self::Harmonics => "errors of the transmissions once and twice per motor turn",
            Self::Ratio => "relative errors of gear ratios and of the rail's pitch",
            Self::Rail => "straightness and angular errors along the rail, with a wave",
            Self::Backlash => "play of the transmissions: half the gap, by the approach",
            Self::Transmission => {
                "waves of meshing gears, cycloid pins and screws along the output, which grow with the load"
            }
            Self::LostMotion => {
                "play of gears where the load decides the flank, once it exceeds the friction"
            }
            Self::Stiffening => "drives that get stiffer with their load, range by range",
            Self::Friction => {
                "hysteresis from friction that grows with the load and builds up over a presliding length"
            }
            Self::Encoder => "quantisation and offset of the encoders",
            Self::Thermal => {
                "growth of the links with the temperature of the air and the heat of their drives"
            }
            Self::Repeatability => "random errors, drawn anew at every approach",
            Self::Foundation => {
                "a floor that sinks and tilts under the loads, and a rail that bends between its feet"
            }
            Self::Hoses => "hoses that pull on the links, by the joints' positions",
        }
    }
}

/// The non-geometric errors of a machine; `None` for kinds that it does not have.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Effects {
    /// Once and twice per motor turn.
    pub harmonics: Option<Harmonics>,
    /// Along the output.
    pub transmission: Option<Transmission>,
    /// Gear ratios and pitch.
    pub ratio: Option<Ratio>,
    /// Straightness and angular errors of a rail.
    pub rail: Option<Rail>,
    /// Play.
    pub backlash: Option<Backlash>,
    /// Play under load.
    pub lost_motion: Option<LostMotion>,
    /// Hysteresis.
    pub friction: Option<Friction>,
    /// Stiffness that increases with the load.
    pub stiffening: Option<Stiffening>,
    /// Quantisation and offset.
    pub encoder: Option<Encoder>,
    /// Growth.
    pub thermal: Option<Thermal>,
    /// Random errors.
    pub repeatability: Option<Repeatability>,
    /// A yielding floor; part of the statics.
    pub foundation: Option<Foundation>,
    /// Hoses; part of the statics.
    pub hoses: Option<Hoses>,
}

impl Effects {
    /// Whether it has an effect.
    pub fn has(&self, kind: EffectKind) -> bool {
        match kind {
            EffectKind::Harmonics => self.harmonics.is_some(),
            EffectKind::Transmission => self.transmission.is_some(),
            EffectKind::LostMotion => self.lost_motion.is_some(),
            EffectKind::Stiffening => self.stiffening.is_some(),
            EffectKind::Ratio => self.ratio.is_some(),
            EffectKind::Rail => self.rail.is_some(),
            EffectKind::Backlash => self.backlash.is_some(),
            EffectKind::Friction => self.friction.is_some(),
            EffectKind::Encoder => self.encoder.is_some(),
            EffectKind::Thermal => self.thermal.is_some(),
            EffectKind::Repeatability => self.repeatability.is_some(),
            EffectKind::Foundation => self.foundation.is_some(),
            EffectKind::Hoses => self.hoses.is_some(),
        }
    }

    /// Its effects, in the order in which they act.
    pub fn active(&self) -> Vec<EffectKind> {
        EffectKind::ALL.into_iter().filter(|kind| self.has(*kind)).collect()
    }

    /// The same machine without one effect.
    #[must_use]
    pub fn without(&self, kind: EffectKind) -> Self {
        let mut rest = self.clone();
        match kind {
            EffectKind::Harmonics => rest.harmonics = None,
            EffectKind::Transmission => rest.transmission = None,
            EffectKind::LostMotion => rest.lost_motion = None,
            EffectKind::Stiffening => rest.stiffening = None,
            EffectKind::Ratio => rest.ratio = None,
            EffectKind::Rail => rest.rail = None,
            EffectKind::Backlash => rest.backlash = None,
            EffectKind::Friction => rest.friction = None,
            EffectKind::Encoder => rest.encoder = None,
            EffectKind::Thermal => rest.thermal = None,
            EffectKind::Repeatability => rest.repeatability = None,
            EffectKind::Foundation => rest.foundation = None,
            EffectKind::Hoses => rest.hoses = None,
        }
        rest
    }

    /// Whether some effect depends on the loads of the drives.
    pub fn need_load(&self) -> bool {
        self.lost_motion.is_some()
            || self.friction.as_ref().is_some_and(Friction::needs_load)
            || self.transmission.as_ref().is_some_and(Transmission::needs_load)
    }

    /// Refuses numbers that are invalid for `actuators` actuators. [`AsBuilt::check_effects`](crate::AsBuilt::check_effects) checks what depends on
    /// the robot.
    pub fn check(&self, actuators: usize, has_rod: bool) -> Result<(), EffectError> {
        if let Some(effect) = &self.harmonics {
            effect.check(actuators)?;
        }
        if let Some(effect) = &self.ratio {
            effect.check(actuators)?;
        }
        if let Some(effect) = &self.rail {
            effect.check(actuators)?;
        }
        if let Some(effect) = &self.transmission {
            effect.check(actuators)?;
        }
        if let Some(effect) = &self.backlash {
            effect.check(actuators)?;
        }
        if let Some(effect) = &self.lost_motion {
            effect.check(&vec![f64::INFINITY; actuators])?;
        }
        if let Some(effect) = &self.stiffening {
            effect.check(actuators)?;
        }
        if let Some(effect) = &self.friction {
            effect.check(actuators)?;
        }
        if let Some(effect) = &self.encoder {
            effect.check(actuators)?;
        }
        if let Some(effect) = &self.repeatability {
            effect.check(actuators)?;
        }
        if let Some(effect) = &self.thermal {
            effect.check(actuators, has_rod)?;
        }
        self.check_statics(actuators)
    }

    /// Refuses effects on the statics that are invalid for `actuators` links.
    pub(crate) fn check_statics(&self, actuators: usize) -> Result<(), EffectError> {
        if let Some(effect) = &self.foundation {
            effect.check(actuators)?;
        }
        self.hoses.as_ref().map_or(Ok(()), |effect| effect.check(actuators))
    }
}
