//! Masses, stiffnesses and shapes: what statics and pictures need beyond kinematics.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use crate::geometry::Transform;

/// Standard acceleration of gravity, m/s² (3rd CGPM, 1901).
pub const STANDARD_GRAVITY: f64 = 9.80665;

/// The inertial properties of one link, in that link's frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Body {
    /// kg
    pub mass: f64,
    /// m
    pub centre_of_mass: Vector3<f64>,
    /// About the centre of mass, kg m².
    pub inertia: Matrix3<f64>,
}

/// Uncertainty of a body's mass and centre: standard deviations about the stated values, zero if those are exact.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct BodyUncertainty {
    /// Of the mass, relative to it.
    pub mass: f64,
    /// Of the centre of mass along each axis of the link's frame, m.
    pub centre: f64,
}

/// Six stiffnesses along and about the axes of a frame: N/m along x, y, z, then N m/rad about x, y, z. Infinite where rigid.
pub type SixStiffness = [f64; 6];

/// A rigid connection.
pub const RIGID: SixStiffness = [f64::INFINITY; 6];

/// What elastostatics and plant need to know about a robot, one entry per joint.
///
/// Where springs sit in the chain, joint after joint, is part of this definition (docs/notation.md, "Where the springs sit"):
/// the joint's fixed part, the bearing if it is on the fixed side, the joint's motion with the drive's deflection, the bearing if it is
/// on the moving side, the beam.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StaticProperties {
    /// The bodies that the joints carry.
    pub bodies: Vec<Body>,
    /// Stiffness of the drive along or about the joint axis, N/m or N m/rad. With a [four-bar](LinkageStatics) the elbow's drive turns
    /// the crank.
    #[serde(with = "crate::float::list")]
    pub drive_stiffness: Vec<f64>,
    /// Compliance of the joints besides their drives.
    pub bearings: Vec<Bearing>,
    /// The flexible links.
    pub beams: Vec<Option<Beam>>,
    /// Masses and stiffness of the elbow's four-bar, if there is one.
    pub linkage: Option<LinkageStatics>,
    /// Payload, hoses, tool forces.
    pub loads: Vec<PointLoad>,
    /// Acceleration of gravity in the base frame, m/s².
    pub gravity: Vector3<f64>,
}

impl StaticProperties {
    /// A robot in which only the drives are elastic.
    pub fn of_drives(bodies: Vec<Body>, drive_stiffness: Vec<f64>, gravity: Vector3<f64>) -> Self {
        Self {
            bearings: vec![Bearing::default(); bodies.len()],
            beams: vec![None; bodies.len()],
            linkage: None,
            loads: Vec::new(),
            bodies,
            drive_stiffness,
            gravity,
        }
    }

    /// Makes every drive, bearing, beam and rod rigid.
    pub fn make_rigid(&mut self) {
        self.drive_stiffness.fill(f64::INFINITY);
        self.bearings.fill(Bearing::default());
        for beam in self.beams.iter_mut().flatten() {
            for segment in &mut beam.segments {
                segment.section = Section::RIGID;
            }
        }
        if let Some(linkage) = &mut self.linkage {
            linkage.rod_stiffness = f64::INFINITY;
        }
    }
}

/// On which side of a joint's motion its bearing deflects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum BearingSide {
    /// It moves along: the springs act in the link's own frame, behind the joint's motion.
    #[default]
    Moving,
    /// It stays: the springs act in the frame in front of the joint's motion, such as a telescope's housing.
    Fixed,
}

/// The compliance of a joint besides its drive: bearing tilt, radial and axial play, a rail's roll, pitch and yaw.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Bearing {
    /// In the frame of its side. The entry of the joint's own axis is ignored: that spring is the drive's.
    #[serde(with = "crate::float::array")]
    pub stiffness: SixStiffness,
    /// On which side of the motion.
    pub side: BearingSide,
    /// Where on the joint's z axis the springs sit, in the frame of their side, m.
    pub at: f64,
}

impl Default for Bearing {
    fn default() -> Self {
        Self { stiffness: RIGID, side: BearingSide::Moving, at: 0.0 }
    }
}

/// Along which axis of its link's frame a flexible link runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum BeamRun {
    /// From the frame's origin along +x, towards the next joint.
    AlongX,
    /// Along +z up to the frame's origin: the exposed part of a telescope.
    EndsAtOrigin,
}

/// A flexible link: a chain of uniform Timoshenko beams with their own distributed weight.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Beam {
    /// Its place in the link's frame.
    pub run: BeamRun,
    /// From root to tip.
    pub segments: Vec<BeamSegment>,
}

/// One uniform piece of a beam.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BeamSegment {
    /// Its length.
    pub length: SegmentLength,
    /// Its stiffness and weight.
    pub section: Section,
}

/// The length of a beam segment.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum SegmentLength {
    /// m
    Constant(f64),
    /// The joint variable of the link (without deflection) minus this, m: the part of a telescope outside its housing.
    Extension(f64),
}

impl SegmentLength {
    /// m, at the joint variable `q`.
    pub fn at(self, q: f64) -> f64 {
        match self {
            Self::Constant(length) => length,
            Self::Extension(housed) => q - housed,
        }
    }
}

/// A beam's cross section, with axes as in the link's frame but the first along the beam: (x, y, z) for a beam along x,
/// (z, x, y) for one along z.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Section {
    /// E A, N.
    #[serde(with = "crate::float::scalar")]
    pub axial: f64,
    /// kappa G A along the second and third axis, N.
    #[serde(with = "crate::float::array")]
    pub shear: [f64; 2],
    /// G J, N m².
    #[serde(with = "crate::float::scalar")]
    pub torsion: f64,
    /// E I about the second and third axis, N m².
    #[serde(with = "crate::float::array")]
    pub bending: [f64; 2],
    /// kg/m; part of the link's [`Body`], whose mass and centre stay those of the whole link.
    pub mass_per_length: f64,
}

impl Section {
    /// The same section with all its stiffnesses scaled by one factor.
    #[must_use]
    pub fn map_stiffness(self, change: impl Fn(f64) -> f64) -> Self {
        Self {
            axial: change(self.axial),
            shear: self.shear.map(&change),
            torsion: change(self.torsion),
            bending: self.bending.map(&change),
            ..self
        }
    }

    /// A rigid section.
    pub const RIGID: Self = Self {
        axial: f64::INFINITY,
        shear: [f64::INFINITY; 2],
        torsion: f64::INFINITY,
        bending: [f64::INFINITY; 2],
        mass_per_length: 0.0,
    };

    /// Whether it is rigid in every direction.
    pub fn is_rigid(&self) -> bool {
        let all = [self.axial, self.torsion].into_iter().chain(self.shear).chain(self.bending);
        all.into_iter().all(f64::is_infinite)
    }
}

/// Statics of the elbow's four-bar. The crank's drive is the elbow's entry of [`StaticProperties::drive_stiffness`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LinkageStatics {
    /// Axial stiffness of the coupler rod, N/m.
    #[serde(with = "crate::float::scalar")]
    pub rod_stiffness: f64,
    /// kg, half of it at either end.
    pub rod_mass: f64,
    /// The crank, in its own frame (x and y turn with it, z along the shoulder's axis).
    pub crank: Body,
}

/// A mass or a constant force at a point of a link.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PointLoad {
    /// Name for people.
    pub name: String,
    /// Index of the link that carries it.
    pub link: usize,
    /// In the link's frame, m.
    pub at: Vector3<f64>,
    /// kg
    pub mass: f64,
    /// In the base frame, independent of the pose, N.
    pub force: Vector3<f64>,
}

/// A shape to draw, with its place in the link's frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Visual {
    /// Where the shape's own frame lies.
    pub link_from_shape: Transform,
    /// Box, cylinder or sphere.
    pub shape: VisualShape,
}

/// The primitive shapes that a URDF can hold and both viewers can draw, m.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
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
