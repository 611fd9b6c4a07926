//! How one machine differs from another of its kind. Links that do not exist are ignored.

use nalgebra::{Rotation3, Vector3};

use super::AsBuilt;
use calibrig_model::{BeamSegment, FourBar};

impl AsBuilt {
    /// Multiplies the mass of a link, its beam's included, with its inertia.
    pub fn scale_mass(&mut self, link: usize, factor: f64) {
        if let Some(body) = self.statics.bodies.get_mut(link) {
            body.mass *= factor;
            body.inertia *= factor;
        }
        for segment in self.segments_mut(link) {
            segment.section.mass_per_length *= factor;
        }
    }

    /// Multiplies all stiffnesses of a joint's bearing.
    pub fn scale_bearing(&mut self, joint: usize, factor: f64) {
        let bearing = self.statics.bearings.get_mut(joint);
        bearing.into_iter().flat_map(|b| &mut b.stiffness).for_each(|stiffness| *stiffness *= factor);
    }

    /// Multiplies all stiffnesses of a flexible link.
    pub fn scale_beam(&mut self, link: usize, factor: f64) {
        for segment in self.segments_mut(link) {
            segment.section = segment.section.map_stiffness(|stiffness| stiffness * factor);
        }
    }

    fn segments_mut(&mut self, link: usize) -> impl Iterator<Item = &mut BeamSegment> {
        let beam = self.statics.beams.get_mut(link).into_iter().flatten();
        beam.flat_map(|beam| &mut beam.segments)
    }

    /// Turns the base by a rotation vector in its own axes, rad: gravity, seen from it, turns the other way.
    pub fn tilt(&mut self, turn: &Vector3<f64>) {
        self.statics.gravity = Rotation3::new(-turn) * self.statics.gravity;
    }

    /// The elbow's four-bar, if the machine has one.
    pub fn linkage_mut(&mut self) -> Option<&mut FourBar> {
        self.actuators.linkage_mut()
    }
}
