//! The loads that the motions of a chain move.

use nalgebra::{Matrix3, Vector3};

use crate::kinematics::Screw;

/// Constant forces at points: their sum, and the sum of `point · forceᵀ` about the base's origin.
#[derive(Debug, Clone, Copy)]
pub(super) struct Loads {
    /// N
    pub force: Vector3<f64>,
    /// N m
    pub moment: Matrix3<f64>,
}

impl Loads {
    pub fn none() -> Self {
        Self { force: Vector3::zeros(), moment: Matrix3::zeros() }
    }

    pub fn add(&mut self, load: &Load) {
        self.force += load.scale * load.direction;
        self.moment += load.arm * load.direction.transpose();
    }

    pub fn add_all(&mut self, other: &Self) {
        self.force += other.force;
        self.moment += other.moment;
    }

    /// How the moment of the loads turns when a screw inboard of them moves: `Σ (J c) × F`. Its product with the axis of another
    /// rotation inboard is the mixed second derivative of the loads' potential, with its sign changed.
    #[inline]
    pub fn turned_by(&self, screw: &Screw) -> Vector3<f64> {
        let a = &screw.axis;
        if screw.about {
            let shifted = self.moment.trace() - screw.origin.dot(&self.force);
            self.moment * a - screw.origin * self.force.dot(a) - a * shifted
        } else {
            a.cross(&self.force)
        }
    }

    /// The generalised force on a screw inboard of the loads, N or N m.
    #[inline]
    pub fn on(&self, screw: &Screw) -> f64 {
        if screw.about {
            let m = &self.moment;
            let moment = Vector3::new(m[(1, 2)] - m[(2, 1)], m[(2, 0)] - m[(0, 2)], m[(0, 1)] - m[(1, 0)]);
            screw.axis.dot(&(moment - screw.origin.cross(&self.force)))
        } else {
            screw.axis.dot(&self.force)
        }
    }
}

/// A load: `force = scale · direction` and `Σ point · forceᵀ = arm · directionᵀ`. A body has its mass as scale, its first moment as arm and
/// gravity as direction, so that bodies without mass need no division.
#[derive(Debug, Clone, Copy)]
pub(super) struct Load {
    /// How many slots of the chain move it.
    pub inboard: usize,
    pub scale: f64,
    pub arm: Vector3<f64>,
    pub direction: Vector3<f64>,
    /// Scale and arm of the reference model, per unit of the link's relative mass.
    pub reference: (f64, Vector3<f64>),
}

impl Load {
    pub fn new(inboard: usize) -> Self {
        Self {
            inboard,
            scale: 0.0,
            arm: Vector3::zeros(),
            direction: Vector3::zeros(),
            reference: (0.0, Vector3::zeros()),
        }
    }
}
