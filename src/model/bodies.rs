//! Masses, stiffnesses and shapes: what statics and pictures need beyond kinematics.

use nalgebra::{Matrix3, Vector3};

use crate::geometry::Transform;

/// The inertial properties of one link, in that link's frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Body {
    /// kg
    pub mass: f64,
    /// m
    pub centre_of_mass: Vector3<f64>,
    /// About the centre of mass, kg m².
    pub inertia: Matrix3<f64>,
}

/// What the elastostatics needs to know of a robot, one entry a joint.
#[derive(Debug, Clone, PartialEq)]
pub struct StaticProperties {
    /// The bodies that the joints carry.
    pub bodies: Vec<Body>,
    /// Stiffness of the drive along or about the joint axis, N/m or N m/rad.
    pub drive_stiffness: Vec<f64>,
    /// Acceleration of gravity in the base frame, m/s².
    pub gravity: Vector3<f64>,
}

/// A shape to draw, with its place in the link's frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Visual {
    /// Where the shape's own frame lies.
    pub link_from_shape: Transform,
    /// Box, cylinder or sphere.
    pub shape: VisualShape,
}

/// The primitive shapes that a URDF can hold and both viewers can draw, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum VisualShape {
    /// Edge lengths.
    Box([f64; 3]),
    /// Along z.
    Cylinder {
        /// Radius.
        radius: f64,
        /// Length.
        length: f64,
    },
    /// Radius.
    Sphere(f64),
}
