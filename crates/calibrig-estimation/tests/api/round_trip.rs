//! Robots, measurements and estimates through JSON and back: equal to the bit, and an estimate read back predicts the same bits.

use calibrig_estimation::identification::{
    Estimate, IdentificationOptions, Loss, Mode, ParameterBound, SolverOptions, identify,
};
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::{CalibrationModel, LinkTerm, ParameterId, PoseQuery};
use proptest::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::robots::{arm, case};

fn back<T: Serialize + DeserializeOwned>(value: &T) -> T {
    let text = serde_json::to_string(value).expect("text");
    serde_json::from_str(&text).unwrap_or_else(|error| panic!("{error}: {text}"))
}

fn bits(estimate: &Estimate, command: &[f64]) -> Option<Vec<u64>> {
    let there = estimate.predict(PoseQuery::at(command)).ok()?;
    let covariance = there.covariance.iter().flat_map(|c| c.iter());
    Some(there.position.iter().chain(covariance).chain(there.jacobian.iter()).map(|v| v.to_bits()).collect())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    #[test]
    fn robots_and_measurements_read_back_as_they_were(case in case()) {
        prop_assert_eq!(&back(&case.model), &case.model);
        prop_assert_eq!(&back(&case.set), &case.set);
    }

    /// Any number, subnormal ones and those with seventeen digits among them.
    #[test]
    fn numbers_keep_their_bits(numbers in prop::array::uniform5(prop::num::f64::NORMAL | prop::num::f64::SUBNORMAL | prop::num::f64::ZERO)) {
        let (mut model, mut set) = arm();
        let link = &mut model.kinematics.links[1];
        for (term, value) in LinkTerm::ALL.into_iter().zip(numbers) {
            *link.term_mut(term) = value;
        }
        set.observations[0].command = numbers.to_vec();
        let (model_back, set_back): (CalibrationModel, MeasurementSet) = (back(&model), back(&set));
        for (term, value) in LinkTerm::ALL.into_iter().zip(numbers) {
            prop_assert_eq!(model_back.kinematics.links[1].term(term).to_bits(), value.to_bits());
        }
        prop_assert_eq!(&set_back, &set);
    }
}

#[test]
fn estimates_read_back_as_they_were_and_predict_the_same_bits() {
    let (model, set) = arm();
    assert!(model.kinematics.links.iter().any(|link| link.limits[1].is_infinite()));
    assert!(model.statics.as_ref().is_some_and(|s| s.drive_stiffness.iter().any(|k| k.is_infinite())));
    for mode in Mode::ALL {
        for loss in [Loss::Squared, Loss::tukey()] {
            if mode == Mode::Extended && loss != Loss::Squared {
                continue;
            }
            let options = IdentificationOptions {
                mode,
                solver: SolverOptions { loss, ..SolverOptions::default() },
                // One end is open.
                bounds: vec![ParameterBound {
                    id: ParameterId::link(2, LinkTerm::A),
                    lower: -5e-3,
                    upper: f64::INFINITY,
                }],
                ..IdentificationOptions::default()
            };
            let estimate = identify(&model, &set, &options).expect("an estimate");
            let read: Estimate = back(&estimate);
            assert_eq!(read, estimate, "{}", mode.key());
            for observation in &set.observations {
                let expected = bits(&estimate, &observation.command);
                assert!(expected.is_some());
                assert_eq!(bits(&read, &observation.command), expected, "{}", mode.key());
            }
        }
    }
}

/// Too few poses for the parameters: a condition that is infinite, and no covariance.
#[test]
fn a_singular_estimate_reads_back_as_it_was() {
    let (model, mut set) = arm();
    for observation in &mut set.observations {
        observation.command[3] = 0.0;
        observation.command[2] = 0.1;
    }
    let options = IdentificationOptions { tolerance: None, ..IdentificationOptions::default() };
    let estimate = identify(&model, &set, &options).expect("an estimate");
    assert!(estimate.spectrum.condition.is_infinite() && estimate.covariance.is_none());
    assert_eq!(back(&estimate), estimate);
}
