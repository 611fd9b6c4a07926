//! The parts of a robot as capsules, whose distances are easily computed: whether it touches itself, or goes below a
//! plane.

use nalgebra::{UnitVector3, Vector3};

use super::shape::distance_of_segments;
use super::{Obstacles, Stance};
use crate::geometry::Transform;

/// A part of a robot, slightly enlarged: all that is within `radius` of the line between its ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hull {
    /// 0 of the base, then the number of the link's joint from 1.
    pub link: usize,
    /// In the base frame, m.
    pub ends: [Vector3<f64>; 2],
    /// m
    pub radius: f64,
}

impl Hull {
    /// Distance of two parts, m; below zero where they touch.
    pub fn distance(&self, other: &Self) -> f64 {
        let [a, b] = &self.ends;
        let [c, d] = &other.ends;
        distance_of_segments([a, b], [c, d]) - self.radius - other.radius
    }

    /// Height of its lowest point along `up` from the base's origin, m.
    pub fn lowest(&self, up: &UnitVector3<f64>) -> f64 {
        up.dot(&self.ends[0]).min(up.dot(&self.ends[1])) - self.radius
    }
}

impl Obstacles {
    /// The parts of the robot at a pose, links in order: its shapes, each within a capsule about its longest axis; for a robot without shapes
    /// the capsules along its chain, and one from the base's origin to the first joint. Empty for frames of another robot.
    pub fn hulls(&self, stance: Stance<'_>) -> Vec<Hull> {
        if self.names.len() != stance.links.len() + 1 {
            return Vec::new();
        }
        let identity = Transform::identity();
        let frames = std::iter::once(&identity).chain(stance.links);
        let of_shapes = self.shapes.iter().zip(frames).enumerate().flat_map(|(link, (own, frame))| {
            own.iter().map(move |shape| {
                let (ends, radius) = shape.capsule(frame);
                Hull { link, ends, radius }
            })
        });
        let mut hulls: Vec<Hull> = of_shapes.collect();
        if let (Some(radius), Some(first)) = (self.chain, stance.links.first()) {
            hulls.push(Hull { link: 0, ends: [Vector3::zeros(), first.translation.vector], radius });
            let of_link = |link| Hull { link: link + 1, ends: super::capsule(stance, link), radius };
            hulls.extend((0..stance.links.len()).map(of_link));
        }
        hulls
    }
}
