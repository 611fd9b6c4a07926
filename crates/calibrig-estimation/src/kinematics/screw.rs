//! Elementary motions, and the frame that goes along a chain by them.

use nalgebra::{Matrix3, Rotation3, Vector3};

use calibrig_model::geometry::Transform;

/// An elementary motion in the base frame: along an axis, or about one through a point.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Screw {
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

    /// How a unit of the motion turns what it carries: a rotation vector.
    #[inline]
    pub fn turns(&self) -> Vector3<f64> {
        if self.about { self.axis } else { Vector3::zeros() }
    }
}

/// A frame that goes along the chain.
#[derive(Debug, Clone, Copy)]
pub(crate) struct MovingFrame {
    /// Its axes in the base frame.
    pub axes: [Vector3<f64>; 3],
    /// Its origin in the base frame, m.
    pub origin: Vector3<f64>,
}

impl MovingFrame {
    pub fn from(frame: &Transform) -> Self {
        let axis = |j: usize| frame.rotation.matrix().column(j).into_owned();
        Self { axes: [axis(0), axis(1), axis(2)], origin: frame.translation.vector }
    }

    /// Turns about an own axis.
    #[inline]
    pub fn turn(&mut self, axis: usize, (sin, cos): (f64, f64)) {
        let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
        let (y, z) = (self.axes[i], self.axes[j]);
        self.axes[i] = cos * y + sin * z;
        self.axes[j] = cos * z - sin * y;
    }

    /// A vector of the frame in the base's axes.
    pub fn turned(&self, v: &Vector3<f64>) -> Vector3<f64> {
        self.axes[0] * v.x + self.axes[1] * v.y + self.axes[2] * v.z
    }

    /// A point of the frame in the base frame.
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

    /// Goes through any motion.
    pub fn go(&mut self, motion: &Transform) {
        let columns = motion.rotation.matrix();
        let column = |j: usize| self.turned(&columns.column(j).into_owned());
        let axes = [column(0), column(1), column(2)];
        *self = Self { axes, origin: self.point(&motion.translation.vector) };
    }

    pub fn transform(&self) -> Transform {
        Transform::from_parts(
            self.origin.into(),
            Rotation3::from_matrix_unchecked(Matrix3::from_columns(&self.axes)),
        )
    }
}

/// A point of a frame as seen from in front of a step along (0..3) or about (3..6) an axis of that frame.
pub(crate) fn stepped(component: usize, by: f64, point: &mut Vector3<f64>) {
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
