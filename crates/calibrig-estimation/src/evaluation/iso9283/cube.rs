//! The cube in the working space, and the five poses in one of its planes.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// One of the four inclined planes of the cube. Corners 1 to 4 run around its upper face, 5 to 8 around the lower one, 5 below 1. With `u` upward
/// and `v`, `w` the two horizontal axes (`v` x `w` = `u`), corner 1 has the least v and w, corner 2 the greatest v and the least w.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum CubePlane {
    /// Corners 1, 2, 7, 8: falls with w.
    C1C2C7C8,
    /// Corners 2, 3, 8, 5: rises with v.
    C2C3C8C5,
    /// Corners 3, 4, 5, 6: rises with w.
    C3C4C5C6,
    /// Corners 4, 1, 6, 7: falls with v.
    C4C1C6C7,
}

impl CubePlane {
    /// All planes.
    pub const ALL: [Self; 4] = [Self::C1C2C7C8, Self::C2C3C8C5, Self::C3C4C5C6, Self::C4C1C6C7];

    /// The key on the command line and in JSON.
    pub fn key(self) -> &'static str {
        match self {
            Self::C1C2C7C8 => "c1-c2-c7-c8",
            Self::C2C3C8C5 => "c2-c3-c8-c5",
            Self::C3C4C5C6 => "c3-c4-c5-c6",
            Self::C4C1C6C7 => "c4-c1-c6-c7",
        }
    }

    /// Signs of the plane's corners along v, w and u, in the order of its name.
    fn corners(self) -> [[f64; 3]; 4] {
        let corner = |number: usize| -> [f64; 3] {
            let u = if number <= 4 { 1.0 } else { -1.0 };
            match (number - 1) % 4 {
                0 => [-1.0, -1.0, u],
                1 => [1.0, -1.0, u],
                2 => [1.0, 1.0, u],
                _ => [-1.0, 1.0, u],
            }
        };
        match self {
            Self::C1C2C7C8 => [1, 2, 7, 8],
            Self::C2C3C8C5 => [2, 3, 8, 5],
            Self::C3C4C5C6 => [3, 4, 5, 6],
            Self::C4C1C6C7 => [4, 1, 6, 7],
        }
        .map(corner)
    }
}

/// A cube with edges along the axes of the base frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TestCube {
    /// Centre in the base frame, m.
    pub centre: Vector3<f64>,
    /// Length of an edge, m.
    pub edge: f64,
    /// Index of the base axis that stands upright, and its sign.
    pub up: (usize, f64),
    /// The plane of the poses.
    pub plane: CubePlane,
}

/// Distance of the poses P2 to P5 from the ends of the plane's diagonals, as a share of the diagonal: the standard allows 10 % +- 2 %.
const INSET: f64 = 0.10;

impl TestCube {
    /// The base axis closest to upright, opposite to this direction of gravity; z without gravity.
    pub fn upright(gravity: &Vector3<f64>) -> (usize, f64) {
        if !(gravity.norm() > 0.0) {
            return (2, 1.0);
        }
        let axis = gravity.iamax();
        (axis, if gravity[axis] > 0.0 { -1.0 } else { 1.0 })
    }

    /// P1 to P5 in the base frame, m: the centre, then a tenth of the diagonal inside each corner of the plane.
    pub fn poses(&self) -> [Vector3<f64>; 5] {
        let (up, sign) = self.up;
        let up = up.min(2);
        let u = Vector3::ith(up, sign);
        let v = Vector3::ith((up + 1) % 3, 1.0);
        let w = u.cross(&v);
        let inside = |[a, b, c]: [f64; 3]| {
            self.centre + 0.5 * self.edge * (1.0 - 2.0 * INSET) * (a * v + b * w + c * u)
        };
        let [p2, p3, p4, p5] = self.plane.corners().map(inside);
        [self.centre, p2, p3, p4, p5]
    }
}
