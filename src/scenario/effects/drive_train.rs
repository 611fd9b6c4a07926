//! `[effects.transmission]`, `[effects.lost_motion]` and `[effects.stiffening]`: effects of the load on drives.

use std::f64::consts::TAU;

use super::entries::{LostMotionEntry, Section, StiffeningEntry, TransmissionEntry, WaveFile};
use super::{EffectsFile, Key, Numbers, Reader};
use calibrig_files::{InputError, Source, Spanned};
use calibrig_model::JointKind;
use calibrig_plant::AsBuilt;
use calibrig_plant::effects::{
    EffectError, LostMotion, Stiffening, StiffnessCurve, Transmission, TransmissionWave,
};

/// A wave whose phase differs from that of the motor's turns by less than this over the joint's travel, in periods,
/// counts as theirs.
const SAME_WAVE: f64 = 0.5;

impl Reader<'_> {
    pub(super) fn transmission(
        &self,
        section: Option<&Spanned<Section<TransmissionEntry>>>,
    ) -> Result<Option<Transmission>, InputError> {
        let read = |joint: usize, entry: &Spanned<TransmissionEntry>| {
            let waves = &entry.get_ref().wave;
            if waves.is_empty() {
                let message = format!("joint \"{}\" has no wave", entry.get_ref().joint.get_ref());
                return Err(self.refuse(entry.span(), message, "wave = [{ ... }] with at least one wave"));
            }
            waves.iter().map(|wave| self.wave(joint, entry, wave)).collect()
        };
        let actuators = self.section("transmission", section, Vec::new(), read)?;
        Ok(actuators.map(|actuators| Transmission { actuators }))
    }

    fn wave(
        &self,
        joint: usize,
        entry: &Spanned<TransmissionEntry>,
        file: &WaveFile,
    ) -> Result<TransmissionWave, InputError> {
        let link = &self.chain().links[joint];
        let (own, given, foreign) = match link.kind {
            JointKind::Prismatic => ("period_mm", &file.period_mm, &file.cycles_per_rev),
            JointKind::Revolute => ("cycles_per_rev", &file.cycles_per_rev, &file.period_mm),
        };
        let Some(given) = given.as_ref().filter(|_| foreign.is_none()) else {
            let place = foreign.as_ref().map_or(entry.span(), Spanned::span);
            let message = format!("a wave of joint \"{}\" is not given by its {own}", link.name);
            let expected = "period_mm of a prismatic or cycles_per_rev of a revolute joint, above zero";
            return Err(self.refuse(place, message, expected));
        };
        let number = self.source.positive(own, given)?;
        let cycles = match link.kind {
            JointKind::Prismatic => 1e3 / number,
            JointKind::Revolute => number / TAU,
        };
        let amplitude = Key {
            name: "amplitude",
            linear: ("um", &file.amplitude_um),
            angular: ("arcsec", &file.amplitude_arcsec),
        };
        let growth = Key {
            name: "growth",
            linear: ("um_per_kn", &file.growth_um_per_kn),
            angular: ("arcsec_per_knm", &file.growth_arcsec_per_knm),
        };
        let per_load = self.optional(joint, &growth, Numbers::NotNegative)?.unwrap_or(0.0);
        if per_load == 0.0 {
            self.refuse_motors_wave(joint, cycles, given)?;
        }
        Ok(TransmissionWave {
            cycles,
            amplitude: self.optional(joint, &amplitude, Numbers::NotNegative)?.unwrap_or(0.0),
            per_load,
            phase: self.phase("phase_deg", file.phase_deg.as_ref())?,
        })
    }

    /// A wave once or twice per motor turn that does not depend on the load is a harmonic.
    fn refuse_motors_wave(&self, joint: usize, cycles: f64, place: &Spanned<f64>) -> Result<(), InputError> {
        let link = &self.chain().links[joint];
        let travel = link.limits[1] - link.limits[0];
        let travel = if travel.is_finite() { travel } else { TAU };
        let Some(turns) = self.robot.model.motor_turns.get(joint).copied().flatten() else { return Ok(()) };
        if [1.0, 2.0].iter().all(|order| (cycles - order * turns).abs() * travel > SAME_WAVE) {
            return Ok(());
        }
        let message = format!("a wave of joint \"{}\" repeats with the turns of its motor", link.name);
        Err(self.refuse(
            place.span(),
            message,
            "[[effects.harmonics.joint]] for it, or a wave that grows with the load",
        ))
    }

    pub(super) fn lost_motion(
        &self,
        section: Option<&Spanned<Section<LostMotionEntry>>>,
    ) -> Result<Option<LostMotion>, InputError> {
        let read = |joint: usize, entry: &Spanned<LostMotionEntry>| {
            let file = entry.get_ref();
            let gap =
                Key { name: "gap", linear: ("um", &file.gap_um), angular: ("arcsec", &file.gap_arcsec) };
            let friction =
                Key { name: "friction", linear: ("n", &file.friction_n), angular: ("nm", &file.friction_nm) };
            let gap = self.required(joint, entry.span(), &gap, Numbers::NotNegative)?;
            let friction = self.optional(joint, &friction, Numbers::NotNegative)?.unwrap_or(0.0);
            let closes_at = self.required(joint, entry.span(), &closing(file), Numbers::NotNegative)?;
            if !(closes_at > 0.0 && closes_at >= friction) {
                let message = format!(
                    "the gap of joint \"{}\" closes under {closes_at}, but its friction is {friction}",
                    file.joint.get_ref()
                );
                let expected = "a load above zero and at least as large as the friction";
                return Err(self.refuse(closing_place(entry), message, expected));
            }
            Ok([gap, friction, closes_at])
        };
        let values = self.section("lost_motion", section, [0.0; 3], read)?;
        let column = |values: &[[f64; 3]], i: usize| values.iter().map(|v| v[i]).collect();
        Ok(values.map(|values| LostMotion {
            gap: column(&values, 0),
            friction: column(&values, 1),
            closes_at: column(&values, 2),
        }))
    }

    pub(super) fn stiffening(
        &self,
        section: Option<&Spanned<Section<StiffeningEntry>>>,
    ) -> Result<Option<Stiffening>, InputError> {
        let read = |joint: usize, entry: &Spanned<StiffeningEntry>| {
            let file = entry.get_ref();
            let link = &self.chain().links[joint];
            let (own, limits, foreign) = match link.kind {
                JointKind::Prismatic => ("limits_n", &file.limits_n, &file.limits_nm),
                JointKind::Revolute => ("limits_nm", &file.limits_nm, &file.limits_n),
            };
            let Some(limits) = limits.as_ref().filter(|_| foreign.is_none()) else {
                let place = foreign.as_ref().map_or(entry.span(), Spanned::span);
                let message = format!("the load ranges of joint \"{}\" are not given by {own}", link.name);
                let expected = "limits_n of a prismatic or limits_nm of a revolute joint";
                return Err(self.refuse(place, message, expected));
            };
            let (factors, ends) = (&file.stiffness_percent, limits.get_ref());
            if factors.len() < 2 || ends.len() + 1 != factors.len() {
                let (factors, ends) = (factors.len(), ends.len());
                let message = format!("{factors} values of stiffness_percent for {ends} of {own}");
                let expected = "at least two stiffnesses, and one range end fewer";
                return Err(self.refuse(limits.span(), message, expected));
            }
            Ok(Some(StiffnessCurve {
                factors: self.rising("stiffness_percent", factors, 0.01)?,
                limits: self.rising(own, ends, 1.0)?,
            }))
        };
        let actuators = self.section("stiffening", section, None, read)?;
        Ok(actuators.map(|actuators| Stiffening { actuators }))
    }

    /// Numbers above zero, each greater than the one before, SI.
    fn rising(&self, key: &str, values: &[Spanned<f64>], unit: f64) -> Result<Vec<f64>, InputError> {
        let mut before = 0.0;
        let mut rising = Vec::with_capacity(values.len());
        for value in values {
            let number = self.source.positive(key, value)?;
            if number <= before {
                let message = format!("{key}: {number} after {before}");
                return Err(self.refuse(value.span(), message, "each value greater than the one before"));
            }
            before = number;
            rising.push(unit * number);
        }
        Ok(rising)
    }
}

fn closing(file: &LostMotionEntry) -> Key<'_> {
    Key { name: "closes_at", linear: ("n", &file.closes_at_n), angular: ("nm", &file.closes_at_nm) }
}

/// Place of the load that closes the gap of an entry.
fn closing_place(entry: &Spanned<LostMotionEntry>) -> std::ops::Range<usize> {
    let file = entry.get_ref();
    file.closes_at_n.as_ref().or(file.closes_at_nm.as_ref()).map_or(entry.span(), Spanned::span)
}

/// Refuses a gap that no load of the machine closes.
pub(in crate::scenario) fn check_loads(
    source: &Source,
    file: &EffectsFile,
    machine: &AsBuilt,
) -> Result<(), InputError> {
    let Err(EffectError::NeverCloses { actuator, closes_at, greatest, .. }) = machine.check_effects(0.0)
    else {
        return Ok(());
    };
    let link = &machine.kinematics.links[actuator];
    let unit = match link.kind {
        JointKind::Prismatic => "N",
        JointKind::Revolute => "N m",
    };
    let entries = file.lost_motion.iter().flat_map(|section| &section.get_ref().joint);
    let entry = entries.into_iter().find(|entry| *entry.get_ref().joint.get_ref() == link.name);
    let message = format!(
        "the gap of joint \"{}\" closes under {closes_at} {unit}, but its drive carries at most {greatest:.1} {unit}",
        link.name
    );
    let help =
        "expected a load that the drive can have; for a gap that no load closes, [[effects.backlash.joint]]";
    Err(source.error(entry.map_or(0..0, closing_place), message, Some(help.to_owned())))
}
