//! Validation with poses that a fit has not seen: k-fold, leave-one-out and repeated splits of one measured set.

use nalgebra::Vector3;

use crate::evaluation::Split;
use calibrig_model::measurement::MeasurementSet;

/// The observations of `set` with these indices, with all of its stations and targets. Indices beyond the end are ignored.
pub fn subset(set: &MeasurementSet, indices: &[usize]) -> MeasurementSet {
    MeasurementSet {
        stations: set.stations.clone(),
        targets: set.targets.clone(),
        observations: indices.iter().filter_map(|i| set.observations.get(*i).cloned()).collect(),
    }
}

/// The errors of the held-out observations of every split, m: one list per split, in the order of [`Split::held_out`].
///
/// `errors` is given the fitted and the held-out part, identifies from the first, and returns measured minus predicted for the second. The first
/// failure ends the loop.
pub fn held_out_errors<E>(
    set: &MeasurementSet,
    splits: &[Split],
    mut errors: impl FnMut(&MeasurementSet, &MeasurementSet) -> Result<Vec<Vector3<f64>>, E>,
) -> Result<Vec<Vec<Vector3<f64>>>, E> {
    splits.iter().map(|split| errors(&subset(set, &split.fitted), &subset(set, &split.held_out))).collect()
}

/// The errors of splits that hold out every observation once, in the order of the `count` observations; `None` where the splits do not do so.
pub fn in_order(splits: &[Split], errors: &[Vec<Vector3<f64>>], count: usize) -> Option<Vec<Vector3<f64>>> {
    let mut ordered = vec![None; count];
    if splits.len() != errors.len() {
        return None;
    }
    for (split, errors) in splits.iter().zip(errors) {
        if split.held_out.len() != errors.len() {
            return None;
        }
        for (place, error) in split.held_out.iter().zip(errors) {
            let before = ordered.get_mut(*place)?.replace(*error);
            if before.is_some() {
                return None;
            }
        }
    }
    ordered.into_iter().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::{k_fold, leave_one_out};
    use calibrig_model::measurement::{Observation, Reading, Station, Target};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn set(count: u32) -> MeasurementSet {
        let observation = |pose: u32| Observation {
            pose,
            command: vec![0.0],
            approach: vec![0],
            since_reversal: Vec::new(),
            temperature: None,
            time: 0.0,
            station: 0,
            target: 0,
            payload: None,
            reading: Reading::Cartesian {
                position: Vector3::new(f64::from(pose * pose), 1.0, -f64::from(pose)),
                covariance: None,
            },
        };
        MeasurementSet {
            stations: vec![Station::default()],
            targets: vec![Target {
                name: String::new(),
                in_flange: Vector3::zeros(),
                covariance: None,
                orientation: None,
            }],
            observations: (0..count).map(observation).collect(),
        }
    }

    /// A robot that is always predicted at the mean of its observed positions.
    #[allow(clippy::unnecessary_wraps, reason = "stands for a fit that can fail")]
    fn errors_of_the_mean(
        fitted: &MeasurementSet,
        held_out: &MeasurementSet,
    ) -> Result<Vec<Vector3<f64>>, String> {
        let places: Vec<_> = fitted.observations.iter().map(|o| o.reading.position()).collect();
        let mean = places.iter().sum::<Vector3<f64>>() / places.len() as f64;
        Ok(held_out.observations.iter().map(|o| o.reading.position() - mean).collect())
    }

    /// Leaving out one of n points makes its distance from the mean n/(n-1) times as large.
    #[test]
    fn leaving_one_out_of_a_mean_has_a_closed_form() {
        let set = set(12);
        let splits = leave_one_out(12);
        let errors = held_out_errors(&set, &splits, errors_of_the_mean).expect("errors");
        let ordered = in_order(&splits, &errors, 12).expect("each once");
        let all = errors_of_the_mean(&set, &set).expect("errors");
        for (held_out, fitted) in ordered.iter().zip(all) {
            assert!((held_out - fitted * (12.0 / 11.0)).norm() < 1e-12);
        }
    }

    #[test]
    fn folds_are_put_in_order_and_never_fitted() {
        let set = set(11);
        let splits = k_fold(11, 4, &mut ChaCha8Rng::seed_from_u64(1));
        let errors = held_out_errors(&set, &splits, |fitted, held_out| {
            assert_eq!(fitted.observations.len() + held_out.observations.len(), 11);
            assert!(fitted.observations.iter().all(|o| !held_out.observations.contains(o)));
            assert_eq!((fitted.stations.len(), held_out.targets.len()), (1, 1));
            Ok::<_, String>(held_out.observations.iter().map(|o| o.reading.position()).collect())
        })
        .expect("errors");
        let ordered = in_order(&splits, &errors, 11).expect("each once");
        for (place, observation) in ordered.iter().zip(&set.observations) {
            assert_eq!(*place, observation.reading.position());
        }
        assert_eq!(in_order(&splits[1..], &errors[1..], 11), None);
        assert_eq!(in_order(&splits, &errors[1..], 11), None);
        assert_eq!(
            in_order(&[splits.clone(), splits].concat(), &[errors.clone(), errors].concat(), 11),
            None
        );
    }

    #[test]
    fn a_fold_that_cannot_be_fitted_is_an_error() {
        let result = held_out_errors(&set(3), &leave_one_out(3), |fitted, _| {
            Err::<Vec<_>, _>(format!("{} poses are too few", fitted.observations.len()))
        });
        assert_eq!(result, Err("2 poses are too few".to_owned()));
    }
}
