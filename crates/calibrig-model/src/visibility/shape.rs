//! Whether a line meets a shape.

use nalgebra::{Point3, Vector3};

use crate::geometry::Transform;
use crate::{Visual, VisualShape};

/// A primitive with a margin around it, placed in a link's frame.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Placed {
    link_from_shape: Transform,
    shape: VisualShape,
    /// Radius of a sphere about the shape's origin that holds it, m.
    bound: f64,
}

impl Placed {
    /// The shape, larger by `margin` (m) on every side.
    pub(super) fn new(visual: &Visual, margin: f64) -> Self {
        let own = Self { link_from_shape: visual.link_from_shape, shape: visual.shape, bound: 0.0 };
        own.grown(margin)
    }

    /// The same, enlarged by so much (m) on every side.
    pub(super) fn grown(&self, margin: f64) -> Self {
        let shape = match self.shape {
            VisualShape::Box(edges) => VisualShape::Box(edges.map(|edge| edge + 2.0 * margin)),
            VisualShape::Cylinder { radius, length } => {
                VisualShape::Cylinder { radius: radius + margin, length: length + 2.0 * margin }
            }
            VisualShape::Sphere(radius) => VisualShape::Sphere(radius + margin),
        };
        let bound = match shape {
            VisualShape::Box([x, y, z]) => 0.5 * Vector3::new(x, y, z).norm(),
            VisualShape::Cylinder { radius, length } => radius.hypot(0.5 * length),
            VisualShape::Sphere(radius) => radius,
        };
        Self { link_from_shape: self.link_from_shape, shape, bound }
    }

    /// A capsule about the shape's longest axis that holds it: its ends in the base frame, and its radius, m.
    pub(super) fn capsule(&self, base_from_link: &Transform) -> ([Vector3<f64>; 2], f64) {
        let (half, radius) = match self.shape {
            VisualShape::Sphere(radius) => (Vector3::zeros(), radius),
            VisualShape::Cylinder { radius, length } => (Vector3::new(0.0, 0.0, 0.5 * length), radius),
            VisualShape::Box(edges) => {
                let half = 0.5 * Vector3::from(edges);
                let axis = half.imax();
                let mut across = half;
                across[axis] = 0.0;
                (half - across, across.norm())
            }
        };
        let base_from_shape = base_from_link * self.link_from_shape;
        ([-half, half].map(|end| (base_from_shape * Point3::from(end)).coords), radius)
    }

    /// Whether the shape of a link at `base_from_link` holds a point of the base frame.
    pub(super) fn holds(&self, base_from_link: &Transform, point: &Vector3<f64>) -> bool {
        let base_from_shape = base_from_link * self.link_from_shape;
        let p = base_from_shape.inverse_transform_point(&(*point).into()).coords;
        match self.shape {
            VisualShape::Box(edges) => p.iter().zip(edges).all(|(p, edge)| 2.0 * p.abs() <= edge),
            VisualShape::Cylinder { radius, length } => p.x.hypot(p.y) <= radius && 2.0 * p.z.abs() <= length,
            VisualShape::Sphere(radius) => p.norm() <= radius,
        }
    }

    /// Whether the shape of a link at `base_from_link` meets the line from `start` to `end`, of the base frame.
    pub(super) fn meets(&self, base_from_link: &Transform, start: &Vector3<f64>, end: &Vector3<f64>) -> bool {
        let place = self.link_from_shape.translation.vector;
        let centre = base_from_link.rotation * place + base_from_link.translation.vector;
        if distance_to_segment(&centre, start, end) > self.bound {
            return false;
        }
        let base_from_shape = base_from_link * self.link_from_shape;
        let a = base_from_shape.inverse_transform_point(&(*start).into()).coords;
        let b = base_from_shape.inverse_transform_point(&(*end).into()).coords;
        let along = b - a;
        match self.shape {
            VisualShape::Sphere(_) => true,
            VisualShape::Box(edges) => {
                let slabs = (0..3).try_fold([0.0, 1.0], |span, axis| {
                    within_slab(span, a[axis], along[axis], 0.5 * edges[axis])
                });
                slabs.is_some()
            }
            VisualShape::Cylinder { radius, length } => within_slab([0.0, 1.0], a.z, along.z, 0.5 * length)
                .is_some_and(|span| within_circle(span, &a, &along, radius)),
        }
    }
}

/// Distance of a point from a segment, m.
pub(super) fn distance_to_segment(point: &Vector3<f64>, start: &Vector3<f64>, end: &Vector3<f64>) -> f64 {
    let along = end - start;
    let squared = along.norm_squared();
    let part = if squared > 0.0 { ((point - start).dot(&along) / squared).clamp(0.0, 1.0) } else { 0.0 };
    (start + along * part - point).norm()
}

/// Distance between two segments, m. Source: C. Ericson, Real-Time Collision Detection (2005), 5.1.9.
pub(super) fn distance_of_segments(a: [&Vector3<f64>; 2], b: [&Vector3<f64>; 2]) -> f64 {
    let (along_a, along_b, between) = (a[1] - a[0], b[1] - b[0], a[0] - b[0]);
    let (aa, bb, ab) = (along_a.norm_squared(), along_b.norm_squared(), along_a.dot(&along_b));
    let (ca, cb) = (along_a.dot(&between), along_b.dot(&between));
    let parallel = aa * bb - ab * ab;
    let free = if parallel > 0.0 { ((ab * cb - ca * bb) / parallel).clamp(0.0, 1.0) } else { 0.0 };
    // If the nearest point of the other line is beyond its end, the nearest of this one is that to the end.
    let other = if bb > 0.0 { ((ab * free + cb) / bb).clamp(0.0, 1.0) } else { 0.0 };
    let own = if aa > 0.0 { ((ab * other - ca) / aa).clamp(0.0, 1.0) } else { 0.0 };
    (a[0] + along_a * own - b[0] - along_b * other).norm()
}

/// The part of a span of `start + t along` that lies within `half` of zero.
fn within_slab(span: [f64; 2], start: f64, along: f64, half: f64) -> Option<[f64; 2]> {
    if along == 0.0 {
        return (start.abs() <= half).then_some(span);
    }
    let ends = [(-half - start) / along, (half - start) / along];
    let cut = [span[0].max(ends[0].min(ends[1])), span[1].min(ends[0].max(ends[1]))];
    (cut[0] <= cut[1]).then_some(cut)
}

/// Whether some of a span of `start + t along` is within `radius` of the z axis.
fn within_circle(span: [f64; 2], start: &Vector3<f64>, along: &Vector3<f64>, radius: f64) -> bool {
    let across = along.x * along.x + along.y * along.y;
    let nearest = if across > 0.0 { -(start.x * along.x + start.y * along.y) / across } else { span[0] };
    let at = start + along * nearest.clamp(span[0], span[1]);
    at.x.hypot(at.y) <= radius
}
