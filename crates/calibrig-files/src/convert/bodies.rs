//! Masses of a URDF: what every joint of the chain carries.

use std::collections::BTreeSet;

use nalgebra::{Matrix3, Point3, Vector3};

use super::chain::{Finder, Step, listed};
use super::element::{Element, inertial, origin};
use crate::input::InputError;
use crate::robot::frames::{inertia_fault, sphere};
use calibrig_model::Body;
use calibrig_model::geometry::Transform;

impl Finder<'_> {
    /// What every joint of the chain carries, in the base frame at zero, and what is wrong with the file's values. Joints outside the chain are
    /// taken at zero.
    pub fn bodies(&self, steps: &[Step]) -> Result<(Vec<Option<Body>>, Vec<String>), InputError> {
        let cut: BTreeSet<usize> =
            steps.iter().map(|(joint, _)| *joint).filter(|joint| self.is_moving(*joint)).collect();
        let (mut bodies, mut faults) = (Vec::new(), Vec::new());
        let mut massless = Vec::new();
        let mut base_from_link = Transform::identity();
        for (index, upwards) in steps {
            let joint = &self.tree.joints[*index];
            let parent_from_joint = origin(self.source, joint.origin.as_ref())?;
            base_from_link *= if *upwards { parent_from_joint.inverse() } else { parent_from_joint };
            if cut.contains(index) {
                let start = if *upwards { joint.parent } else { joint.child };
                let body = self.body(start, base_from_link, &cut, &mut faults)?;
                if body.is_none() {
                    massless.push(self.tree.links[start].name.as_str());
                }
                bodies.push(body);
            }
        }
        match massless.as_slice() {
            [] => {}
            [link] => faults.push(format!("no mass: link {link} and the links fixed to it")),
            links => faults.push(format!("no mass: links {} and the links fixed to them", listed(links))),
        }
        Ok((bodies, faults))
    }

    /// All that is attached to a link without a joint of the chain in between.
    fn body(
        &self,
        start: usize,
        base_from_start: Transform,
        cut: &BTreeSet<usize>,
        faults: &mut Vec<String>,
    ) -> Result<Option<Body>, InputError> {
        let mut group = vec![(start, base_from_start)];
        let mut seen = BTreeSet::from([start]);
        let mut at = 0;
        let mut bodies = Vec::new();
        while let Some(&(link, base_from_link)) = group.get(at) {
            at += 1;
            let entry = &self.tree.links[link];
            if let Some(element) = &entry.inertial {
                bodies.extend(self.stated(&entry.name, element, &base_from_link, faults)?);
            }
            for (index, joint) in self.tree.joints.iter().enumerate() {
                let next = match () {
                    () if cut.contains(&index) => continue,
                    () if joint.parent == link => joint.child,
                    () if joint.child == link => joint.parent,
                    () => continue,
                };
                if seen.insert(next) {
                    let step = origin(self.source, joint.origin.as_ref())?;
                    let step = if next == joint.child { step } else { step.inverse() };
                    group.push((next, base_from_link * step));
                }
            }
        }
        Ok(joined(&bodies))
    }

    /// The body of one link, if it has one.
    fn stated(
        &self,
        link: &str,
        element: &Element,
        base_from_link: &Transform,
        faults: &mut Vec<String>,
    ) -> Result<Option<Body>, InputError> {
        let (mass, centre, inertia) = inertial(self.source, element)?;
        if mass < 0.0 {
            let message = format!("the mass of link {link} is {mass} kg");
            return self.error(element.span.clone(), message, "zero or more");
        }
        if mass == 0.0 {
            return Ok(None);
        }
        let turn = base_from_link.rotation.matrix();
        let inertia = match inertia_fault(&inertia) {
            None => turn * inertia * turn.transpose(),
            Some(fault) => {
                faults.push(format!(
                    "the inertia of link {link} {fault}; that of a solid sphere is assumed, which changes nothing at rest"
                ));
                sphere(mass)
            }
        };
        let centre_of_mass = (base_from_link * Point3::from(centre)).coords;
        Ok(Some(Body { mass, centre_of_mass, inertia }))
    }
}

/// Bodies that move as one; `None` for none.
fn joined(bodies: &[Body]) -> Option<Body> {
    let mass: f64 = bodies.iter().map(|body| body.mass).sum();
    if mass <= 0.0 {
        return None;
    }
    let weighed: Vector3<f64> = bodies.iter().map(|body| body.mass * body.centre_of_mass).sum();
    let centre_of_mass = weighed / mass;
    let inertia = bodies.iter().map(|body| {
        // Steiner: to the common centre of mass.
        let r = body.centre_of_mass - centre_of_mass;
        body.inertia + body.mass * (Matrix3::identity() * r.norm_squared() - r * r.transpose())
    });
    Some(Body { mass, centre_of_mass, inertia: inertia.sum() })
}
