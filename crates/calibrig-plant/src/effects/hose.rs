//! Hoses and dress packs that pull on the robot, more or less as the joints turn.

use nalgebra::Vector3;

use super::error::{Range, check};
use super::{EffectError, EffectKind};

/// A hose between two anchors: stretched beyond its free length it pulls them together in proportion to the stretch; when shorter it hangs loose.
/// If the anchors are off the axes between them, it applies a moment about these that depends on the joints. It has no weight.
#[derive(Debug, Clone, PartialEq)]
pub struct Hose {
    /// Its anchors.
    pub ends: [Anchor; 2],
    /// N/m
    pub stiffness: f64,
    /// m
    pub free_length: f64,
}

/// A point of a link or of the ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Anchor {
    /// Index of the link; none for the ground.
    pub link: Option<usize>,
    /// In the link's frame, or in the base frame, m.
    pub at: Vector3<f64>,
}

/// The hoses of a machine.
#[derive(Debug, Clone, PartialEq)]
pub struct Hoses {
    /// At least one.
    pub hoses: Vec<Hose>,
}

impl Hose {
    /// Tension at a length, N, and its derivative, N/m.
    pub(crate) fn tension(&self, length: f64) -> (f64, f64) {
        let stretch = length - self.free_length;
        if stretch > 0.0 { (self.stiffness * stretch, self.stiffness) } else { (0.0, 0.0) }
    }
}

impl Hoses {
    pub(super) fn check(&self, links: usize) -> Result<(), EffectError> {
        let kind = EffectKind::Hoses;
        for (index, hose) in self.hoses.iter().enumerate() {
            check(kind, ("stiffness", index), hose.stiffness, Range::Positive)?;
            // A spring of length zero has no direction if it ends at its own start.
            check(kind, ("free length", index), hose.free_length, Range::Positive)?;
            for Anchor { link, at } in hose.ends {
                at.iter().try_for_each(|at| check(kind, ("anchor", index), *at, Range::Finite))?;
                if link.is_some_and(|link| link >= links) {
                    return Err(EffectError::NoSuchPart { effect: kind, part: "link of a hose's index" });
                }
            }
            if hose.ends[0].link == hose.ends[1].link {
                return Err(EffectError::NoSuchPart {
                    effect: kind,
                    part: "joint between the ends of a hose",
                });
            }
        }
        Ok(())
    }
}
