//! Frames and beams whose parts are not there, or cannot be.

use calibrig_estimation::elastostatics::{Frame, end_compliance, end_stiffness, segment_groups};
use calibrig_model::nalgebra::{Vector3, Vector6};
use calibrig_model::{Beam, BeamRun, SegmentLength};
use proptest::prelude::*;

use crate::robots::{bad, beam};
use crate::{names, refused};

type BeamFault = (fn(&mut Beam, f64), &'static str);

const BEAM_FAULTS: [BeamFault; 6] = [
    (|beam, _| beam.segments.clear(), "no segments"),
    (|beam, bad| beam.segments[0].length = SegmentLength::Constant(-bad.abs()), "length must be positive"),
    (|beam, _| beam.segments[0].section.axial = f64::NAN, "axial stiffness"),
    (|beam, _| beam.segments[0].section.bending[1] = -1.0, "bending stiffness"),
    (|beam, _| beam.segments[0].section.shear[0] = 0.0, "shear stiffness"),
    (|beam, bad| beam.segments[0].section.mass_per_length = bad, "kg/m"),
];

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

    #[test]
    fn beams_that_cannot_be_have_no_compliance(fault in 0..BEAM_FAULTS.len(), bad in bad(), q in -1.0..1.0_f64, pieces in 0..4_usize) {
        let (change, field) = BEAM_FAULTS[fault];
        let mut beam = beam();
        change(&mut beam, bad);
        names(segment_groups(&beam, q), field, "segment_groups");
        names(end_compliance(&beam, q), field, "end_compliance");
        names(end_stiffness(&beam, q, pieces), field, "end_stiffness");
        let _ = Frame::of_beam(&beam, q, pieces, &Vector3::z());
    }

    #[test]
    fn a_joint_variable_without_length_is_refused(bad in bad()) {
        let mut beam = beam();
        beam.run = BeamRun::EndsAtOrigin;
        beam.segments[0].length = SegmentLength::Extension(1.0);
        for q in [1.0, 0.5, f64::NAN, bad] {
            names(segment_groups(&beam, q), "length", "segment_groups");
            names(end_compliance(&beam, q), "length", "end_compliance");
            names(end_stiffness(&beam, q, 2), "length", "end_stiffness");
        }
    }

    #[test]
    fn frames_refuse_nodes_and_elements_that_are_not_there(
        nodes in 0..4_usize, asked in 0..9_usize, other in 0..9_usize, bad in bad(), rigid in any::<bool>()
    ) {
        let mut frame = Frame::default();
        for node in 0..nodes {
            frame.add_node(Vector3::new(node as f64, 0.0, 0.0));
        }
        let mut section = beam().segments[0].section;
        let there = |index: usize| index < nodes;
        let joined = frame.add_element(asked, other, &section, &Vector3::y());
        prop_assert_eq!(joined.is_ok(), there(asked) && there(other) && asked != other, "{:?}", joined);
        prop_assert_eq!(frame.clamp(asked).is_ok(), there(asked));
        prop_assert_eq!(frame.fix(other, [true; 6]).is_ok(), there(other));
        prop_assert_eq!(frame.add_load(asked, &Vector6::x()).is_ok(), there(asked));
        names(frame.add_uniform_load(asked + 1, &Vector3::x()), "element", "add_uniform_load");
        if nodes > 1 {
            names(frame.add_load(0, &(bad * Vector6::x())), "load", "add_load");
            let along = frame.add_element(0, 1, &section, &Vector3::x());
            names(along, "no direction", "add_element, along itself");
            names(frame.add_element(0, 1, &section, &(bad * Vector3::y())), "no direction", "add_element");
            section.torsion = if rigid { f64::INFINITY } else { f64::NAN };
            names(frame.add_element(0, 1, &section, &Vector3::y()), "not elastic", "add_element");
            let far = frame.add_node(Vector3::new(bad, 0.0, 0.0));
            refused(frame.add_element(0, far, &beam().segments[0].section, &Vector3::y()), "add_element");
        }
        let _ = frame.solve();
        let _ = frame.condense(&[]);
        let _ = frame.condense(&[0, 0]);
        let condensed = frame.condense(&[asked, other]);
        prop_assert!(condensed.is_err() || (there(asked) || asked == nodes) && (there(other) || other == nodes));
        names(frame.condense(&[99]), "node 99", "condense");
        prop_assert_eq!(frame.stiffness().nrows() % 6, 0);
    }
}
