//! Flexible links: as groups of springs for the chain, and as finite elements.
//!
//! A uniform Timoshenko segment is exactly one group of springs at its middle and two lumps of mass (docs/notation.md, "Where the springs
//! sit"). Segments of different sections have no such common group: the middles in which force and moment decouple differ between
//! the two planes of bending, and the weight asks for other lumps in every direction. So the chain has one group a segment. The
//! condensed [end stiffness](end_stiffness) of the whole link, by finite elements, is for reports and as a check.

mod element;
mod frame;

use nalgebra::{Matrix3, Matrix6, Matrix6x3, Vector3};

pub use frame::{CondensedFrame, Frame, FrameError, FrameSolution};

use calibrig_model::{Beam, BeamError, BeamSegment, SixStiffness};

/// A mass on a beam.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lump {
    /// kg
    pub mass: f64,
    /// Along the undeflected beam, from its root, m.
    pub from_root: f64,
}

/// A uniform segment as springs and lumps: exact, to first order, in the displacement of its tip and the reaction at its root, for any load
/// at the tip and its own uniform weight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SegmentGroup {
    /// Where the springs sit along the undeflected beam, from its root, m.
    pub centre: f64,
    /// Along and about the axes of the link's frame.
    pub stiffness: SixStiffness,
    /// In front of the springs, and behind them.
    pub lumps: [Lump; 2],
}

impl SegmentGroup {
    /// Of the segment, m.
    pub(super) fn length(&self) -> f64 {
        1.5 * (self.lumps[1].from_root - self.lumps[0].from_root)
    }
}

/// The groups of a beam from root to tip at the joint variable `q`.
///
/// Source: the compliance of a Timoshenko cantilever (Przemieniecki, Theory of Matrix Structural Analysis, section 5.6), taken to the middle.
///
/// # Errors
///
/// [`BeamError`], where a segment has no length at `q`, or the beam cannot be one.
pub fn segment_groups(beam: &Beam, q: f64) -> Result<Vec<SegmentGroup>, BeamError> {
    beam.check_sections()?;
    let mut root = 0.0;
    let lengths = beam.lengths(q)?;
    let groups = beam.segments.iter().zip(lengths).map(|(segment, length)| {
        let group = segment_group(segment, length, root, beam.run.axes());
        root += length;
        group
    });
    Ok(groups.collect())
}

/// The group of one segment whose root is at `root`, by the [axes](calibrig_model::BeamRun::axes) of the beam's run.
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
    let lump = |at: f64| Lump { mass: 0.5 * section.mass_per_length * length, from_root: root + at * length };
    SegmentGroup { centre: root + 0.5 * length, stiffness, lumps: [lump(1.0 / 6.0), lump(5.0 / 6.0)] }
}

/// What the tip of a beam with a clamped root does, to first order, in the axes of the link's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EndCompliance {
    /// Displacement of the tip (m, then rad) per unit of a force and a moment there (N, then N m).
    pub compliance: Matrix6<f64>,
    /// Displacement of the tip per unit of gravity in the link's frame (m per m/s², then rad per m/s²), by the beam's own weight.
    pub sag: Matrix6x3<f64>,
}

/// The compliance of a beam at its tip at the joint variable `q`, by composition of its groups. It may be rigid in part.
///
/// # Errors
///
/// As [`segment_groups`].
pub fn end_compliance(beam: &Beam, q: f64) -> Result<EndCompliance, BeamError> {
    let groups = segment_groups(beam, q)?;
    let tip = beam.point(beam.length(q), q);
    let mut end = EndCompliance { compliance: Matrix6::zeros(), sag: Matrix6x3::zeros() };
    for (index, group) in groups.iter().enumerate() {
        let centre = beam.point(group.centre, q);
        let along = Matrix3::from_diagonal(&Vector3::from_fn(|i, _| 1.0 / group.stiffness[i]));
        let about = Matrix3::from_diagonal(&Vector3::from_fn(|i, _| 1.0 / group.stiffness[i + 3]));
        let arm = (tip - centre).cross_matrix();

        // A force at the tip shifts the group and turns it by its moment; what turns there moves the tip by its arm.
        let mut add = |block: (usize, usize), part: Matrix3<f64>| {
            let mut view = end.compliance.fixed_view_mut::<3, 3>(block.0, block.1);
            view += part;
        };
        add((0, 0), along - arm * about * arm);
        add((0, 3), -arm * about);
        add((3, 0), about * arm);
        add((3, 3), about);

        let behind = group.lumps[1..].iter().chain(groups[index + 1..].iter().flat_map(|g| &g.lumps));
        let (mut mass, mut moment) = (0.0, Vector3::zeros());
        for lump in behind {
            mass += lump.mass;
            moment += lump.mass * (beam.point(lump.from_root, q) - centre);
        }
        let turned = about * moment.cross_matrix();
        let mut shift = end.sag.fixed_view_mut::<3, 3>(0, 0);
        shift += mass * along - arm * turned;
        let mut turn = end.sag.fixed_view_mut::<3, 3>(3, 0);
        turn += turned;
    }
    Ok(end)
}

/// The stiffness and weight of a beam with a clamped root, condensed to its tip, in the axes of the link's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EndStiffness {
    /// Force and moment at the tip (N, N m) per unit of its displacement (m, rad).
    pub stiffness: Matrix6<f64>,
    /// The force and moment at the tip that displace it as the beam's own weight does, per unit of gravity in the link's frame (kg, kg m).
    pub weight: Matrix6x3<f64>,
}

/// The stiffness of a beam at its tip at the joint variable `q`, by static condensation of `pieces` finite elements a segment.
///
/// # Errors
///
/// [`FrameError`], also for a section that is rigid but for shear: its elements have no stiffness matrix.
pub fn end_stiffness(beam: &Beam, q: f64, pieces: usize) -> Result<EndStiffness, FrameError> {
    beam.check_sections()?;
    let mut weight = Matrix6x3::zeros();
    let mut stiffness = Matrix6::zeros();
    for axis in 0..3 {
        let mut gravity = Vector3::zeros();
        gravity[axis] = 1.0;
        let (mut frame, root, tip) = Frame::of_beam(beam, q, pieces, &gravity)?;
        frame.clamp(root)?;
        let condensed = frame.condense(&[tip])?;
        stiffness.copy_from(&condensed.stiffness);
        weight.set_column(axis, &condensed.load.fixed_rows::<6>(0));
    }
    Ok(EndStiffness { stiffness, weight })
}

#[cfg(test)]
mod tests;
