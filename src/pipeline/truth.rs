//! What the identified parameters really are, where a simulation knows.

use nalgebra::Vector6;

use calibrig_estimation::identification::Estimate;
use calibrig_model::geometry::{Transform, rotation_vector, small_displacement};
use calibrig_model::measurement::Target;
use calibrig_model::{CalibrationModel, ParameterId, StaticProperties};
use calibrig_plant::AsBuilt;

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
            ParameterId::Compliance(compliance) => {
                let stated = self.nominal.statics.as_ref()?.stiffness(compliance)?;
                Some(stated / self.as_built.statics.stiffness(compliance)? - 1.0)
            }
            ParameterId::Mass { link } => {
                let mass = |statics: &StaticProperties| Some(statics.bodies.get(link)?.mass);
                Some(mass(&self.as_built.statics)? / mass(self.nominal.statics.as_ref()?)? - 1.0)
            }
            ParameterId::Centre { link, axis } => {
                let centre =
                    |statics: &StaticProperties| statics.bodies.get(link)?.centre_of_mass.get(axis).copied();
                Some(centre(&self.as_built.statics)? - centre(self.nominal.statics.as_ref()?)?)
            }
            ParameterId::Linkage(length) => {
                Some(self.as_built.actuators.length(length)? - self.nominal.actuators.length(length)?)
            }
            // A term's amplitude has no single counterpart: what a machine really does is of no such shape.
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
}
