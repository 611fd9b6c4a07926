//! Flexible links as groups of springs for the chain.
//!
//! A uniform Timoshenko segment is exactly one group of springs at its middle and two lumped masses (docs/notation.md, "Where the springs
//! sit"). Segments of different sections have no such common group: the middles in which force and moment decouple differ between
//! the two planes of bending, and the weight asks for other masses in every direction. So the chain has one group a segment. The tests hold
//! what the groups of a link do at its tip to a frame of finite elements.

use calibrig_model::{BeamSegment, SixStiffness};

/// A mass at a point of a beam.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LumpedMass {
    /// kg
    pub mass: f64,
    /// Along the undeflected beam, from its root, m.
    pub from_root: f64,
}

/// A uniform segment as springs and lumped masses: exact, to first order, in the displacement of its tip and the reaction at its root, for any load
/// at the tip and its own uniform weight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SegmentGroup {
    /// Where the springs sit along the undeflected beam, from its root, m.
    pub centre: f64,
    /// Along and about the axes of the link's frame.
    pub stiffness: SixStiffness,
    /// In front of the springs, and behind them.
    pub lumps: [LumpedMass; 2],
}

impl SegmentGroup {
    /// Of the segment, m.
    pub fn length(&self) -> f64 {
        1.5 * (self.lumps[1].from_root - self.lumps[0].from_root)
    }
}

/// The group of a segment whose root is at `root`, by the [axes](calibrig_model::BeamRun::axes) of the beam's run.
///
/// Source: the compliance of a Timoshenko cantilever (Przemieniecki, Theory of Matrix Structural Analysis, section 5.6), taken to the middle.
pub(super) fn segment_group(segment: &BeamSegment, length: f64, root: f64, axes: [usize; 3]) -> SegmentGroup {
    let section = &segment.section;
    // Shear along one of the section's axes goes with bending about the other.
    let transverse = |shear: f64, bending: f64| 1.0 / (length / shear + length.powi(3) / (12.0 * bending));
    let along = [
        section.axial / length,
        transverse(section.shear[0], section.bending[1]),
        transverse(section.shear[1], section.bending[0]),
    ];
    let about = [section.torsion, section.bending[0], section.bending[1]].map(|s| s / length);
    let mut stiffness = [0.0; 6];
    for (axis, (along, about)) in axes.into_iter().zip(along.into_iter().zip(about)) {
        (stiffness[axis], stiffness[axis + 3]) = (along, about);
    }
    let lump =
        |at: f64| LumpedMass { mass: 0.5 * section.mass_per_length * length, from_root: root + at * length };
    SegmentGroup { centre: root + 0.5 * length, stiffness, lumps: [lump(1.0 / 6.0), lump(5.0 / 6.0)] }
}

#[cfg(test)]
mod tests;
