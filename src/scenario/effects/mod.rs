//! `[effects.*]`: errors of a real machine besides geometry and elasticity. A section is off if it is missing or has `enabled =
//! false`.

mod drive_train;
mod entries;
mod statics;
mod thermal;

#[cfg(test)]
mod tests;

use std::f64::consts::TAU;
use std::ops::Range;

use serde::Deserialize;

pub(super) use self::drive_train::check_loads;
use self::entries::{
    BacklashEntry, EncoderEntry, FrictionEntry, HarmonicEntry, Joint, LostMotionEntry, ProfileFile, RailFile,
    RatioEntry, RepeatabilityEntry, Section, StiffeningEntry, TransmissionEntry,
};
use self::statics::{FoundationFile, HosesFile};
use self::thermal::ThermalFile;
pub(super) use self::thermal::check_air;
use super::file::{joint_index, refuse_twice};
use calibrig_files::Robot;
use calibrig_files::{InputError, Source, Spanned};
use calibrig_model::{JointKind, KinematicModel};
use calibrig_plant::effects::{
    Backlash, Effects, Encoder, Friction, Harmonic, Harmonics, Rail, RailProfile, Ratio, Repeatability,
};

/// The sections of the file.
#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub(super) struct EffectsFile {
    harmonics: Option<Spanned<Section<HarmonicEntry>>>,
    ratio: Option<Spanned<Section<RatioEntry>>>,
    rail: Option<Spanned<RailFile>>,
    transmission: Option<Spanned<Section<TransmissionEntry>>>,
    backlash: Option<Spanned<Section<BacklashEntry>>>,
    lost_motion: Option<Spanned<Section<LostMotionEntry>>>,
    friction: Option<Spanned<Section<FrictionEntry>>>,
    stiffening: Option<Spanned<Section<StiffeningEntry>>>,
    encoder: Option<Spanned<Section<EncoderEntry>>>,
    thermal: Option<Spanned<ThermalFile>>,
    repeatability: Option<Spanned<Section<RepeatabilityEntry>>>,
    foundation: Option<Spanned<FoundationFile>>,
    hoses: Option<Spanned<HosesFile>>,
}

/// The effects of the machine, SI. Sections that are switched off are checked as well.
pub(super) fn effects(source: &Source, file: &EffectsFile, robot: &Robot) -> Result<Effects, InputError> {
    let reader = Reader { source, robot };
    Ok(Effects {
        harmonics: reader.harmonics(file.harmonics.as_ref())?,
        ratio: reader.ratio(file.ratio.as_ref())?,
        rail: reader.rail(file.rail.as_ref())?,
        transmission: reader.transmission(file.transmission.as_ref())?,
        backlash: reader.backlash(file.backlash.as_ref())?,
        lost_motion: reader.lost_motion(file.lost_motion.as_ref())?,
        friction: reader.friction(file.friction.as_ref())?,
        stiffening: reader.stiffening(file.stiffening.as_ref())?,
        encoder: reader.encoder(file.encoder.as_ref())?,
        thermal: thermal::thermal(&reader, file.thermal.as_ref())?,
        repeatability: reader.repeatability(file.repeatability.as_ref())?,
        foundation: statics::foundation(&reader, file.foundation.as_ref())?,
        hoses: statics::hoses(&reader, file.hoses.as_ref())?,
    })
}

/// A key in the units of prismatic and of revolute joints.
struct Key<'a> {
    name: &'a str,
    /// Unit of a prismatic joint, with its value of the key.
    linear: (&'a str, &'a Option<Spanned<f64>>),
    /// Unit of a revolute joint, with its value of the key.
    angular: (&'a str, &'a Option<Spanned<f64>>),
}

/// Which numbers are valid.
#[derive(Clone, Copy)]
enum Numbers {
    NotNegative,
    Finite,
}

/// The SI value of a unit of a key.
fn unit(name: &str) -> f64 {
    match name {
        "mm" => 1e-3,
        "um" => 1e-6,
        "deg" => TAU / 360.0,
        "arcsec" => TAU / 360.0 / 3600.0,
        "um_per_kn" => 1e-9,
        "arcsec_per_knm" => 1e-3 * TAU / 360.0 / 3600.0,
        _ => 1.0,
    }
}

struct Reader<'a> {
    source: &'a Source,
    robot: &'a Robot,
}

/// One value per actuator from each entry of a section.
type Values<T> = Option<Vec<T>>;

impl Reader<'_> {
    fn chain(&self) -> &KinematicModel {
        &self.robot.model.kinematics
    }

    fn refuse(&self, span: Range<usize>, message: String, expected: &str) -> InputError {
        self.source.error(span, message, Some(format!("expected {expected}")))
    }

    /// One value per actuator, `none` without an entry; `None` if the section is off.
    fn section<E: Joint, T: Clone>(
        &self,
        key: &str,
        section: Option<&Spanned<Section<E>>>,
        none: T,
        read: impl Fn(usize, &Spanned<E>) -> Result<T, InputError>,
    ) -> Result<Values<T>, InputError> {
        let Some(section) = section else { return Ok(None) };
        let Section { enabled, joint: entries } = section.get_ref();
        if entries.is_empty() {
            let message = format!("[effects.{key}] has no entry");
            let expected = format!("[[effects.{key}.joint]] for at least one joint");
            return Err(self.refuse(section.span(), message, &expected));
        }
        let mut seen = vec![false; self.chain().joint_count()];
        let mut values = vec![none; seen.len()];
        for entry in entries {
            let name = entry.get_ref().joint();
            let index = joint_index(self.source, name, self.chain())?;
            refuse_twice(self.source, &mut seen, index, name)?;
            values[index] = read(index, entry)?;
        }
        Ok(enabled.then_some(values))
    }

    /// The value of a key in the unit of the joint's kind, SI; `None` if it is not given.
    fn optional(&self, joint: usize, key: &Key<'_>, numbers: Numbers) -> Result<Option<f64>, InputError> {
        let link = &self.chain().links[joint];
        let ((own, value), (foreign, wrong), kind) = match link.kind {
            JointKind::Prismatic => (key.linear, key.angular, "prismatic"),
            JointKind::Revolute => (key.angular, key.linear, "revolute"),
        };
        let name = format!("{}_{own}", key.name);
        if let Some(wrong) = wrong {
            let message = format!("{}_{foreign} of joint \"{}\", which is {kind}", key.name, link.name);
            return Err(self.refuse(wrong.span(), message, &name));
        }
        let Some(value) = value else { return Ok(None) };
        let number = match numbers {
            Numbers::NotNegative => self.source.not_negative(&name, value)?,
            Numbers::Finite => self.source.finite(&name, value)?,
        };
        Ok(Some(unit(own) * number))
    }

    /// The same for a required key.
    fn required(
        &self,
        joint: usize,
        entry: Range<usize>,
        key: &Key<'_>,
        numbers: Numbers,
    ) -> Result<f64, InputError> {
        let value = self.optional(joint, key, numbers)?;
        value.ok_or_else(|| {
            let link = &self.chain().links[joint];
            let own = match link.kind {
                JointKind::Prismatic => key.linear.0,
                JointKind::Revolute => key.angular.0,
            };
            let message = format!("joint \"{}\" has no {}_{own}", link.name, key.name);
            self.refuse(
                entry,
                message,
                &format!("{}_{own} with a value; the unit is part of the key", key.name),
            )
        })
    }

    fn phase(&self, key: &str, degrees: Option<&Spanned<f64>>) -> Result<f64, InputError> {
        degrees.map_or(Ok(0.0), |value| Ok(self.source.finite(key, value)?.to_radians()))
    }

    fn harmonics(
        &self,
        section: Option<&Spanned<Section<HarmonicEntry>>>,
    ) -> Result<Option<Harmonics>, InputError> {
        let read = |joint: usize, entry: &Spanned<HarmonicEntry>| {
            let file = entry.get_ref();
            let once =
                Key { name: "once", linear: ("um", &file.once_um), angular: ("arcsec", &file.once_arcsec) };
            let twice = Key {
                name: "twice",
                linear: ("um", &file.twice_um),
                angular: ("arcsec", &file.twice_arcsec),
            };
            let amplitude = |key| Ok(self.optional(joint, key, Numbers::NotNegative)?.unwrap_or(0.0));
            Ok(Some(Harmonic {
                turns: self.motor_turns(joint, entry)?,
                amplitude: [amplitude(&once)?, amplitude(&twice)?],
                phase: [
                    self.phase("once_phase_deg", file.once_phase_deg.as_ref())?,
                    self.phase("twice_phase_deg", file.twice_phase_deg.as_ref())?,
                ],
            }))
        };
        let actuators = self.section("harmonics", section, None, read)?;
        Ok(actuators.map(|actuators| Harmonics { actuators }))
    }

    /// Motor turns per m or rad: those of the entry, or of the robot's file.
    fn motor_turns(&self, joint: usize, entry: &Spanned<HarmonicEntry>) -> Result<f64, InputError> {
        let file = entry.get_ref();
        let key = Key {
            name: "motor_turns_per",
            linear: ("m", &file.motor_turns_per_m),
            angular: ("rev", &file.motor_turns_per_rev),
        };
        let per_unit = match self.chain().links[joint].kind {
            JointKind::Prismatic => 1.0,
            JointKind::Revolute => 1.0 / TAU,
        };
        let name = file.joint.get_ref();
        let expected =
            "motor_turns_per_rev of a revolute or motor_turns_per_m of a prismatic joint, above zero";
        match self.optional(joint, &key, Numbers::NotNegative)? {
            Some(turns) if turns > 0.0 => return Ok(per_unit * turns),
            Some(_) => {
                let given = file.motor_turns_per_rev.as_ref().or(file.motor_turns_per_m.as_ref());
                let place = given.map_or(entry.span(), Spanned::span);
                let message = format!("the motor of \"{name}\" is stated to turn zero times");
                return Err(self.refuse(place, message, expected));
            }
            None => {}
        }
        let nominal = self.robot.model.motor_turns.get(joint).copied().flatten();
        nominal.filter(|turns| *turns > 0.0).ok_or_else(|| {
            let message = format!(
                "neither this entry nor the robot's file states how often the motor of \"{name}\" turns"
            );
            self.refuse(entry.span(), message, expected)
        })
    }

    fn ratio(&self, section: Option<&Spanned<Section<RatioEntry>>>) -> Result<Option<Ratio>, InputError> {
        let read = |_: usize, entry: &Spanned<RatioEntry>| {
            let value = &entry.get_ref().relative_ppm;
            let ppm = self.source.finite("relative_ppm", value)?;
            if ppm.abs() > MOST_PPM {
                let message = format!("relative_ppm is {ppm}");
                return Err(self.refuse(value.span(), message, &format!("at most {MOST_PPM} ppm, 1 %")));
            }
            Ok(1e-6 * ppm)
        };
        Ok(self.section("ratio", section, 0.0, read)?.map(|relative| Ratio { relative }))
    }

    fn backlash(
        &self,
        section: Option<&Spanned<Section<BacklashEntry>>>,
    ) -> Result<Option<Backlash>, InputError> {
        let read = |joint: usize, entry: &Spanned<BacklashEntry>| {
            let file = entry.get_ref();
            let gap =
                Key { name: "gap", linear: ("um", &file.gap_um), angular: ("arcsec", &file.gap_arcsec) };
            self.required(joint, entry.span(), &gap, Numbers::NotNegative)
        };
        Ok(self.section("backlash", section, 0.0, read)?.map(|gap| Backlash { gap }))
    }

    fn friction(
        &self,
        section: Option<&Spanned<Section<FrictionEntry>>>,
    ) -> Result<Option<Friction>, InputError> {
        let read = |joint: usize, entry: &Spanned<FrictionEntry>| {
            let file = entry.get_ref();
            let force =
                Key { name: "friction", linear: ("n", &file.friction_n), angular: ("nm", &file.friction_nm) };
            let length = Key {
                name: "presliding",
                linear: ("mm", &file.presliding_mm),
                angular: ("deg", &file.presliding_deg),
            };
            let per_load = match &file.percent_of_load {
                Some(percent) => 0.01 * self.source.not_negative("percent_of_load", percent)?,
                None => 0.0,
            };
            let constant = self.optional(joint, &force, Numbers::NotNegative)?.unwrap_or(0.0);
            Ok([constant, per_load, self.required(joint, entry.span(), &length, Numbers::NotNegative)?])
        };
        let values = self.section("friction", section, [0.0; 3], read)?;
        let column = |values: &[[f64; 3]], i: usize| values.iter().map(|v| v[i]).collect();
        Ok(values.map(|values| Friction {
            constant: column(&values, 0),
            per_load: column(&values, 1),
            presliding: column(&values, 2),
        }))
    }

    fn encoder(
        &self,
        section: Option<&Spanned<Section<EncoderEntry>>>,
    ) -> Result<Option<Encoder>, InputError> {
        let read = |joint: usize, entry: &Spanned<EncoderEntry>| {
            let file = entry.get_ref();
            let step =
                Key { name: "step", linear: ("um", &file.step_um), angular: ("arcsec", &file.step_arcsec) };
            let offset = Key {
                name: "offset",
                linear: ("um", &file.offset_um),
                angular: ("arcsec", &file.offset_arcsec),
            };
            let step = self.optional(joint, &step, Numbers::NotNegative)?.unwrap_or(0.0);
            Ok((step, self.optional(joint, &offset, Numbers::Finite)?.unwrap_or(0.0)))
        };
        let values = self.section("encoder", section, (0.0, 0.0), read)?;
        Ok(values.map(|values| {
            let (step, offset) = values.into_iter().unzip();
            Encoder { step, offset }
        }))
    }

    fn repeatability(
        &self,
        section: Option<&Spanned<Section<RepeatabilityEntry>>>,
    ) -> Result<Option<Repeatability>, InputError> {
        let read = |joint: usize, entry: &Spanned<RepeatabilityEntry>| {
            let file = entry.get_ref();
            let sigma = Key {
                name: "sigma",
                linear: ("um", &file.sigma_um),
                angular: ("arcsec", &file.sigma_arcsec),
            };
            self.required(joint, entry.span(), &sigma, Numbers::NotNegative)
        };
        Ok(self.section("repeatability", section, 0.0, read)?.map(|sigma| Repeatability { sigma }))
    }

    fn rail(&self, section: Option<&Spanned<RailFile>>) -> Result<Option<Rail>, InputError> {
        let Some(section) = section else { return Ok(None) };
        let file = section.get_ref();
        let joint = joint_index(self.source, &file.joint, self.chain())?;
        let link = &self.chain().links[joint];
        if joint != 0 || link.kind != JointKind::Prismatic {
            let message =
                format!("effects.rail.joint \"{}\" is not a rail that carries the robot", link.name);
            return Err(self.refuse(file.joint.span(), message, "the first joint, a prismatic one"));
        }
        let gravity = self.robot.model.statics.as_ref().map(|statics| statics.gravity).unwrap_or_default();
        let mut up = link.fixed_part().rotation.inverse() * -gravity;
        up.z = 0.0;
        let Some(vertical) = up.try_normalize(1e-6) else {
            let message = "effects.rail.joint runs along gravity, so that nothing across it is vertical";
            return Err(self.refuse(file.joint.span(), message.to_owned(), "a rail across gravity"));
        };
        let straightness = |name: &str, file: &Option<ProfileFile>| self.profile(name, "um", file.as_ref());
        let angle = |name: &str, file: &Option<ProfileFile>| self.profile(name, "arcsec", file.as_ref());
        let rail = Rail {
            joint,
            range: link.limits,
            wavelength: 1e-3 * self.source.positive("effects.rail.wavelength_mm", &file.wavelength_mm)?,
            vertical,
            horizontal_error: straightness("horizontal", &file.horizontal)?,
            vertical_error: straightness("vertical", &file.vertical)?,
            roll: angle("roll", &file.roll)?,
            pitch: angle("pitch", &file.pitch)?,
            yaw: angle("yaw", &file.yaw)?,
        };
        Ok(file.enabled.then_some(rail))
    }

    fn profile(&self, name: &str, own: &str, file: Option<&ProfileFile>) -> Result<RailProfile, InputError> {
        let Some(file) = file else { return Ok(RailProfile::default()) };
        let (polynomial, wave, foreign) = if own == "um" {
            (&file.polynomial_um, &file.wave_um, ("arcsec", file.first_in_arcsec()))
        } else {
            (&file.polynomial_arcsec, &file.wave_arcsec, ("um", file.first_in_um()))
        };
        if let (foreign, Some(span)) = foreign {
            let message = format!("effects.rail.{name} is given in {foreign}");
            return Err(self.refuse(span, message, &format!("polynomial_{own} and wave_{own}")));
        }
        let coefficient = |value: &Spanned<f64>| {
            Ok(unit(own) * self.source.finite(&format!("effects.rail.{name}.polynomial_{own}"), value)?)
        };
        let polynomial = polynomial.as_ref().map(Spanned::get_ref).map_or(&[][..], Vec::as_slice);
        Ok(RailProfile {
            polynomial: polynomial.iter().map(coefficient).collect::<Result<_, InputError>>()?,
            wave: match wave {
                Some(wave) => {
                    unit(own) * self.source.not_negative(&format!("effects.rail.{name}.wave_{own}"), wave)?
                }
                None => 0.0,
            },
            phase: self.phase(&format!("effects.rail.{name}.phase_deg"), file.phase_deg.as_ref())?,
        })
    }
}

/// No working transmission has a larger error.
const MOST_PPM: f64 = 10_000.0;
