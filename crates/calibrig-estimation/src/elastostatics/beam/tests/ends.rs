//! What a whole link does at its tip: by composition of its groups, and by finite elements.

use nalgebra::{Matrix3, Matrix6, Matrix6x3, Vector3};

use super::super::{SegmentGroup, segment_group};
use super::frame::{Frame, FrameError};
use calibrig_model::{Beam, BeamError};

/// The groups of a beam from root to tip at the joint variable `q`.
pub(super) fn segment_groups(beam: &Beam, q: f64) -> Result<Vec<SegmentGroup>, BeamError> {
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

/// What the tip of a beam with a clamped root does, to first order, in the axes of the link's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct EndCompliance {
    /// Displacement of the tip (m, then rad) per unit of a force and a moment there (N, then N m).
    pub compliance: Matrix6<f64>,
    /// Displacement of the tip per unit of gravity in the link's frame (m per m/s², then rad per m/s²), by the beam's own weight.
    pub sag: Matrix6x3<f64>,
}

/// The compliance of a beam at its tip at the joint variable `q`, by composition of its groups. It may be rigid in part.
pub(super) fn end_compliance(beam: &Beam, q: f64) -> Result<EndCompliance, BeamError> {
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
pub(super) struct EndStiffness {
    /// Force and moment at the tip (N, N m) per unit of its displacement (m, rad).
    pub stiffness: Matrix6<f64>,
    /// The force and moment at the tip that displace it as the beam's own weight does, per unit of gravity in the link's frame (kg, kg m).
    pub weight: Matrix6x3<f64>,
}

/// The stiffness of a beam at its tip at the joint variable `q`, by static condensation of `pieces` finite elements a segment.
pub(super) fn end_stiffness(beam: &Beam, q: f64, pieces: usize) -> Result<EndStiffness, FrameError> {
    beam.check_sections()?;
    let mut weight = Matrix6x3::zeros();
    let mut stiffness = Matrix6::zeros();
    for axis in 0..3 {
        let mut gravity = Vector3::zeros();
        gravity[axis] = 1.0;
        let (mut frame, root, tip) = Frame::of_beam(beam, q, pieces, &gravity)?;
        frame.clamp(root);
        let condensed = frame.condense(&[tip])?;
        stiffness.copy_from(&condensed.stiffness);
        weight.set_column(axis, &condensed.load.fixed_rows::<6>(0));
    }
    Ok(EndStiffness { stiffness, weight })
}
