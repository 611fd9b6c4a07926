//! Machines of one kind, as they leave the workshop.

use nalgebra::Vector3;
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

use super::AsBuilt;
use calibrig_model::{Compliance, FourBar, LinkTerm};

/// How a deviation is distributed about zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Spread {
    /// Sizes are standard deviations.
    Normal,
    /// Sizes are half-widths.
    Uniform,
}

impl Spread {
    /// A deviation of size one.
    fn draw(self, rng: &mut impl Rng) -> f64 {
        match self {
            Self::Normal => StandardNormal.sample(rng),
            Self::Uniform => rng.random_range(-1.0..1.0),
        }
    }
}

/// Sizes of the deviations from a given machine, all independent. Zero: as given.
#[derive(Debug, Clone, PartialEq)]
pub struct AsBuiltDistribution {
    /// Of all of them.
    pub spread: Spread,
    /// The link parameters that deviate.
    pub link_parameters: Vec<(usize, LinkTerm)>,
    /// Of a and d, m.
    pub length: f64,
    /// Of alpha, theta and beta, rad.
    pub angle: f64,
    /// The compliances that deviate.
    pub compliances: Vec<Compliance>,
    /// Relative size of those: a stiffness k becomes k / (1 + x), as for the compliance parameters of the
    /// identification.
    pub compliance: f64,
    /// Of every link's mass, relative.
    pub mass: f64,
    /// Of crank, lever and rod, m.
    pub linkage_length: f64,
    /// Of the angles of crank and lever, rad.
    pub linkage_angle: f64,
    /// Of the crank's axis along x and y of the shoulder's frame, m.
    pub crank_axis: f64,
    /// Of its tilts, rad.
    pub crank_tilt: f64,
    /// Of the base about each of its axes, rad.
    pub tilt: f64,
    /// Of the target's offset along each axis, m.
    pub target: f64,
}

/// Least share of a compliance or a mass that is left, so that it stays above zero however wide the distribution is.
const LEAST_FACTOR: f64 = 0.01;

impl AsBuiltDistribution {
    /// Whether machines differ in their four-bar's geometry, so that some loops may not close.
    pub fn varies_linkage(&self) -> bool {
        [self.linkage_length, self.linkage_angle, self.crank_axis, self.crank_tilt]
            .iter()
            .any(|size| *size > 0.0)
    }

    /// A machine that deviates from `base`.
    ///
    /// Every machine takes the same numbers from `rng` in the same order, whatever the sizes and the listed parameters are: another size
    /// of one kind changes no deviation of another. In an incomplete machine only the existing parts deviate.
    pub fn draw(&self, base: &AsBuilt, rng: &mut impl Rng) -> AsBuilt {
        let mut machine = base.clone();
        for (index, link) in machine.kinematics.links.iter_mut().enumerate() {
            for term in LinkTerm::ALL {
                let drawn = self.spread.draw(rng);
                if self.link_parameters.contains(&(index, term)) {
                    *link.term_mut(term) += self.size_of(term) * drawn;
                }
            }
        }
        let mut factor = |size: f64| (1.0 + size * self.spread.draw(rng)).max(LEAST_FACTOR);
        for joint in 0..machine.statics.bodies.len() {
            let drive = factor(self.size_of_compliance(Compliance::Drive { joint }));
            if let Some(stiffness) = machine.statics.drive_stiffness.get_mut(joint) {
                *stiffness /= drive;
            }
            let bearing: [f64; 6] = std::array::from_fn(|axis| {
                factor(self.size_of_compliance(Compliance::Bearing { joint, axis }))
            });
            let stiffness = machine.statics.bearings.get_mut(joint).map(|bearing| &mut bearing.stiffness);
            for (stiffness, factor) in stiffness.into_iter().flatten().zip(bearing) {
                *stiffness /= factor;
            }
            machine
                .scale_beam(joint, 1.0 / factor(self.size_of_compliance(Compliance::Beam { link: joint })));
            machine.scale_mass(joint, factor(self.mass));
        }
        let rod = factor(self.size_of_compliance(Compliance::Rod));
        if let Some(linkage) = &mut machine.statics.linkage {
            linkage.rod_stiffness /= rod;
        }
        self.draw_linkage(&mut machine, rng);
        let mut vector = |size: f64| size * Vector3::from_fn(|_, _| self.spread.draw(rng));
        let turn = vector(self.tilt);
        machine.tilt(&turn);
        machine.target += vector(self.target);
        // Drawn last, so that machines of older scenarios stay as they were.
        let axis: [f64; 4] = std::array::from_fn(|_| self.spread.draw(rng));
        if let Some(linkage) = machine.linkage_mut() {
            linkage.axis.x += self.crank_axis * axis[0];
            linkage.axis.y += self.crank_axis * axis[1];
            linkage.axis.rx += self.crank_tilt * axis[2];
            linkage.axis.ry += self.crank_tilt * axis[3];
        }
        machine
    }

    fn size_of(&self, term: LinkTerm) -> f64 {
        match term {
            LinkTerm::A | LinkTerm::D => self.length,
            LinkTerm::Alpha | LinkTerm::Beta | LinkTerm::Theta => self.angle,
        }
    }

    fn size_of_compliance(&self, compliance: Compliance) -> f64 {
        if self.compliances.contains(&compliance) { self.compliance } else { 0.0 }
    }

    fn draw_linkage(&self, machine: &mut AsBuilt, rng: &mut impl Rng) {
        let lengths: [f64; 3] = std::array::from_fn(|_| self.linkage_length * self.spread.draw(rng));
        let angles: [f64; 2] = std::array::from_fn(|_| self.linkage_angle * self.spread.draw(rng));
        let Some(linkage) = machine.linkage_mut() else { return };
        let FourBar { crank, lever, rod, .. } = linkage;
        for (value, deviation) in [&mut crank.length, &mut lever.length, rod].into_iter().zip(lengths) {
            *value += deviation;
        }
        crank.angle += angles[0];
        lever.angle += angles[1];
    }
}
