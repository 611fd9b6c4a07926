//! How one machine differs from another of its kind.

use nalgebra::{Rotation3, Vector3};

use super::AsBuilt;
use calibrig_model::{ActuatorMap, FourBar};

impl AsBuilt {
    /// Multiplies the mass of a link, its beam's included, with its inertia.
    pub fn scale_mass(&mut self, link: usize, factor: f64) {
        let body = &mut self.statics.bodies[link];
        body.mass *= factor;
        body.inertia *= factor;
        for segment in self.statics.beams[link].iter_mut().flat_map(|beam| &mut beam.segments) {
            segment.section.mass_per_length *= factor;
        }
    }

    /// Multiplies all stiffnesses of a joint's bearing.
    pub fn scale_bearing(&mut self, joint: usize, factor: f64) {
        self.statics.bearings[joint].stiffness.iter_mut().for_each(|stiffness| *stiffness *= factor);
    }

    /// Multiplies all stiffnesses of a flexible link.
    pub fn scale_beam(&mut self, link: usize, factor: f64) {
        for segment in self.statics.beams[link].iter_mut().flat_map(|beam| &mut beam.segments) {
            segment.section = segment.section.map_stiffness(|stiffness| stiffness * factor);
        }
    }

    /// Turns the base by a rotation vector in its own axes, rad: gravity, seen from it, turns the other way.
    pub fn tilt(&mut self, turn: &Vector3<f64>) {
        self.statics.gravity = Rotation3::new(-turn) * self.statics.gravity;
    }

    /// The elbow's four-bar, where the machine has one.
    pub fn linkage_mut(&mut self) -> Option<&mut FourBar> {
        match &mut self.actuators {
            ActuatorMap::Parallelogram { linkage, .. } => linkage.as_mut(),
            ActuatorMap::Direct => None,
        }
    }
}
