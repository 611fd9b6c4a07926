//! Elementary translations and rotations at a place, and the loads that they move.

use nalgebra::{Matrix3, Rotation3, Vector3};

use calibrig_model::geometry::Transform;

/// An elementary motion in the base frame: along an axis, or about one through a point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Screw {
    pub about: bool,
    /// Unit vector.
    pub axis: Vector3<f64>,
    /// A point on the axis, m.
    pub origin: Vector3<f64>,
}

impl Screw {
    pub const NONE: Self =
        Self { about: false, axis: Vector3::new(0.0, 0.0, 0.0), origin: Vector3::new(0.0, 0.0, 0.0) };

    /// What a unit of the motion does to a point that it carries.
    #[inline]
    pub fn moves(&self, point: &Vector3<f64>) -> Vector3<f64> {
        if self.about { self.axis.cross(&(point - self.origin)) } else { self.axis }
    }

    /// What a unit of the motion does to the point that lies at the base's origin.
    #[inline]
    pub fn moves_origin(&self) -> Vector3<f64> {
        if self.about { self.origin.cross(&self.axis) } else { self.axis }
    }
}

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

    pub fn add(&mut self, lump: &Lump) {
        self.force += lump.scale * lump.direction;
        self.moment += lump.arm * lump.direction.transpose();
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
pub(super) struct Lump {
    /// How many slots of the chain move it.
    pub inboard: usize,
    pub scale: f64,
    pub arm: Vector3<f64>,
    pub direction: Vector3<f64>,
    /// Scale and arm of the reference model, per unit of the link's relative mass.
    pub reference: (f64, Vector3<f64>),
}

impl Lump {
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

/// A frame that goes along the chain.
#[derive(Debug, Clone, Copy)]
pub(super) struct Walk {
    /// Its axes in the base frame.
    pub axes: [Vector3<f64>; 3],
    /// Its origin in the base frame, m.
    pub origin: Vector3<f64>,
}

impl Walk {
    pub fn from(frame: &Transform) -> Self {
        let axis = |j: usize| frame.rotation.matrix().column(j).into_owned();
        Self { axes: [axis(0), axis(1), axis(2)], origin: frame.translation.vector }
    }

    #[inline]
    pub fn turn(&mut self, axis: usize, (sin, cos): (f64, f64)) {
        let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
        let (y, z) = (self.axes[i], self.axes[j]);
        self.axes[i] = cos * y + sin * z;
        self.axes[j] = cos * z - sin * y;
    }

    pub fn turned(&self, v: &Vector3<f64>) -> Vector3<f64> {
        self.axes[0] * v.x + self.axes[1] * v.y + self.axes[2] * v.z
    }

    pub fn point(&self, v: &Vector3<f64>) -> Vector3<f64> {
        self.origin + self.turned(v)
    }

    /// The screw along (0..3) or about (3..6) an own axis.
    #[inline]
    pub fn screw(&self, component: usize) -> Screw {
        Screw { about: component >= 3, axis: self.axes[component % 3], origin: self.origin }
    }

    /// Moves along (0..3) or about (3..6) an own axis, and tells the screw.
    #[inline]
    pub fn step(&mut self, component: usize, by: f64) -> Screw {
        let screw = self.screw(component);
        if component < 3 {
            self.origin += by * screw.axis;
        } else if by != 0.0 {
            self.turn(component % 3, by.sin_cos());
        }
        screw
    }

    pub fn transform(&self) -> Transform {
        Transform::from_parts(
            self.origin.into(),
            Rotation3::from_matrix_unchecked(Matrix3::from_columns(&self.axes)),
        )
    }
}

/// A point of a frame as seen from in front of a step along (0..3) or about (3..6) an axis of that frame.
pub(super) fn stepped(component: usize, by: f64, point: &mut Vector3<f64>) {
    if component < 3 {
        point[component] += by;
        return;
    }
    if by == 0.0 {
        return;
    }
    let (sin, cos) = by.sin_cos();
    let (i, j) = ((component + 1) % 3, (component + 2) % 3);
    (point[i], point[j]) = (cos * point[i] - sin * point[j], sin * point[i] + cos * point[j]);
}
