//! Robots with beams that cannot be.

use calibrig_estimation::elastostatics::{Deflection, ElasticChain};
use calibrig_model::{Beam, BeamRun, CalibrationModel, JointKind, SegmentLength};
use proptest::prelude::*;

use crate::names;
use crate::robots::{bad, beam, command, model};

type BeamFault = (fn(&mut Beam, f64), &'static str);

const BEAM_FAULTS: [BeamFault; 5] = [
    (|beam, _| beam.segments.clear(), "no segments"),
    (|beam, _| beam.segments[0].section.axial = f64::NAN, "axial stiffness"),
    (|beam, _| beam.segments[0].section.bending[1] = -1.0, "bending stiffness"),
    (|beam, _| beam.segments[0].section.shear[0] = 0.0, "shear stiffness"),
    (|beam, bad| beam.segments[0].section.mass_per_length = bad, "kg/m"),
];

/// A robot with a beam as its first link.
fn with_beam() -> impl Strategy<Value = CalibrationModel> {
    model().prop_filter("a robot with a beam", |model| {
        model.statics.as_ref().is_some_and(|statics| statics.beams[0].is_some())
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

    #[test]
    fn beams_that_cannot_be_make_no_chain(sound in with_beam(), fault in 0..BEAM_FAULTS.len(), bad in bad()) {
        let (change, field) = BEAM_FAULTS[fault];
        let mut model = sound.clone();
        let broken = model.statics.as_mut().and_then(|statics| statics.beams[0].as_mut()).expect("a beam");
        change(broken, bad);
        names(ElasticChain::new(&model), field, "ElasticChain::new");
        let mut chain = ElasticChain::new(&sound).expect("a robot");
        names(chain.set_model(&model), field, "ElasticChain::set_model");
    }

    #[test]
    fn a_beam_without_length_does_not_settle(mut model in with_beam(), bad in bad(), pose in 0..9_u32) {
        let command = command(&model, pose);
        for length in [-bad.abs(), 0.0, -0.5] {
            let beam = model.statics.as_mut().and_then(|statics| statics.beams[0].as_mut()).expect("a beam");
            beam.segments[0].length = SegmentLength::Constant(length);
            let settled = ElasticChain::new(&model).map(|mut chain| chain.settle(&command, &[], Deflection::Equilibrium));
            names(settled.expect("a robot"), "length", "settle");
        }
    }

    /// A telescope that is drawn in farther than its beam begins.
    #[test]
    fn a_joint_variable_without_length_is_refused(mut model in with_beam(), bad in bad()) {
        prop_assume!(model.kinematics.links[0].kind == JointKind::Prismatic);
        let mut telescope = beam();
        telescope.run = BeamRun::EndsAtOrigin;
        telescope.segments[0].length = SegmentLength::Extension(1.0);
        model.statics.as_mut().expect("masses").beams[0] = Some(telescope);
        model.kinematics.links[0].limits = [1.5, 2.0];
        let mut chain = ElasticChain::new(&model).expect("a robot");
        let mut command = command(&model, 0);
        for (q, field) in [(1.0, "length"), (0.5, "length"), (f64::NAN, "command"), (bad, "command")] {
            command[0] = q;
            names(chain.settle(&command, &[], Deflection::Equilibrium), field, "settle");
        }
    }
}
