//! What the identified parameters really are, where a simulation knows.

use nalgebra::Vector6;

use crate::geometry::{Transform, rotation_vector, small_displacement};
use crate::identification::Estimate;
use crate::measurement::Target;
use crate::model::{Beam, CalibrationModel, Compliance, LinkageLength, ParameterId, StaticProperties};
use crate::plant::AsBuilt;

/// The truth beside what was known beforehand.
#[derive(Debug, Clone, Copy)]
pub struct KnownTruth<'a> {
    /// The machine.
    pub as_built: &'a AsBuilt,
    /// What identification was told.
    pub nominal: &'a CalibrationModel,
    /// Of the only station.
    pub tracker_from_base: &'a Transform,
    /// As stated to identification.
    pub targets: &'a [Target],
}

impl KnownTruth<'_> {
    /// What the parameter really is, SI; `None` where the truth is not known or has no counterpart.
    ///
    /// - link, four-bar: as-built minus nominal; compliance, mass: as-built over nominal, minus one;
    /// - frame: the estimate holds `station = prior · exp(value)` for the station's six components (absent ones are zero), so the prior
    ///   is recovered exactly and the truth is the `xi` of `prior · exp(xi) = tracker_from_base`. Known for a single station only;
    /// - target: as-built minus stated offset. Known for a single target only.
    pub fn of(&self, estimate: &Estimate, id: ParameterId) -> Option<f64> {
        let value = match id {
            ParameterId::Link { .. } => self.link(id),
            ParameterId::Frame { station: 0, component } => self.frame(estimate)?.get(component).copied(),
            ParameterId::Target { target: 0, axis } => {
                let [stated] = self.targets else { return None };
                Some(self.as_built.target.get(axis)? - stated.in_flange.get(axis)?)
            }
            ParameterId::Compliance(compliance) => self.compliance(compliance),
            ParameterId::Mass { link } => {
                let mass = |statics: &StaticProperties| Some(statics.bodies.get(link)?.mass);
                Some(mass(&self.as_built.statics)? / mass(self.nominal.statics.as_ref()?)? - 1.0)
            }
            ParameterId::Linkage(length) => self.linkage(length),
            ParameterId::Frame { .. } | ParameterId::Target { .. } | ParameterId::Term(_) => None,
        };
        value.filter(|v| v.is_finite())
    }

    /// As-built minus nominal link parameter, m or rad.
    pub fn link(&self, id: ParameterId) -> Option<f64> {
        let ParameterId::Link { link, term } = id else { return None };
        let as_built = self.as_built.kinematics.links.get(link)?;
        let nominal = self.nominal.kinematics.links.get(link)?;
        Some(as_built.term(term) - nominal.term(term))
    }

    fn frame(&self, estimate: &Estimate) -> Option<Vector6<f64>> {
        let [station] = estimate.robot.stations.as_slice() else { return None };
        let xi =
            Vector6::from_iterator((0..6).map(|component| {
                estimate.value(ParameterId::Frame { station: 0, component }).unwrap_or(0.0)
            }));
        let prior = station * small_displacement(&xi).inverse();
        let displacement = prior.inverse() * self.tracker_from_base;
        let (along, about) = (displacement.translation.vector, rotation_vector(&displacement.rotation));
        Some(Vector6::new(along.x, along.y, along.z, about.x, about.y, about.z))
    }

    fn compliance(&self, compliance: Compliance) -> Option<f64> {
        let nominal = stiffness(self.nominal.statics.as_ref()?, compliance)?;
        Some(nominal / stiffness(&self.as_built.statics, compliance)? - 1.0)
    }

    fn linkage(&self, length: LinkageLength) -> Option<f64> {
        let (_, _, _, as_built) = self.as_built.actuators.four_bar()?;
        let (_, _, _, nominal) = self.nominal.actuators.four_bar()?;
        Some(match length {
            LinkageLength::Crank => as_built.crank.length - nominal.crank.length,
            LinkageLength::Lever => as_built.lever.length - nominal.lever.length,
            LinkageLength::Rod => as_built.rod - nominal.rod,
        })
    }
}

/// N/m, N m/rad, or for a beam N m²: only its ratio to another robot's counts.
fn stiffness(statics: &StaticProperties, compliance: Compliance) -> Option<f64> {
    match compliance {
        Compliance::Drive { joint } => statics.drive_stiffness.get(joint).copied(),
        Compliance::Bearing { joint, axis } => statics.bearings.get(joint)?.stiffness.get(axis).copied(),
        Compliance::Beam { link } => statics.beams.get(link)?.as_ref().and_then(bending),
        Compliance::Rod => statics.linkage.as_ref().map(|linkage| linkage.rod_stiffness),
    }
}

/// Of the first segment: a factor on a beam is one on all its segments.
fn bending(beam: &Beam) -> Option<f64> {
    beam.segments.first().map(|segment| segment.section.bending[0])
}
