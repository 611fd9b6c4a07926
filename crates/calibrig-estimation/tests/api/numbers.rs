//! Evaluation, validation and uncertainty on numbers and sizes that do not belong together: they return, and say `None` where they know
//! nothing.

use calibrig_estimation::evaluation::{
    ChiSquareTest, Coverage, Fit, NoiseLevel, PoseConditions, ResidualSet, Split, Variant, accuracy,
    check_consistency, chi2_band, compare_variants, find_patterns, k_fold, leave_one_out, mean_nees_band,
    nees, paired_rms_difference, repeated_splits, resampled_difference,
};
use calibrig_estimation::identification::{
    PositionJacobian, Uncertainty, Whitening, bayesian_cramer_rao_bound, cramer_rao_bound,
};
use calibrig_estimation::validation::{held_out_errors, in_order, subset};
use calibrig_model::ParameterId;
use calibrig_model::nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use calibrig_model::random::{StreamSource, stream};
use proptest::prelude::*;

use crate::robots::arm;

/// Any number, most of them ordinary.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        8 => -2.0..2.0_f64,
        1 => prop::sample::select(vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, -0.0]),
        1 => prop::sample::select(vec![1e308, -1e308, 1e-308, 1e160, 5e-324, 1e16]),
    ]
}

/// A matrix of that many columns, ordinary or not.
fn matrix(columns: usize) -> impl Strategy<Value = DMatrix<f64>> {
    let ordinary = || -2.0..2.0_f64;
    (0..12_usize, any::<bool>()).prop_flat_map(move |(rows, odd)| {
        let entries = if odd { number().boxed() } else { ordinary().boxed() };
        prop::collection::vec(entries, rows * columns)
            .prop_map(move |entries| DMatrix::from_vec(rows, columns, entries))
    })
}

fn points(most: usize) -> impl Strategy<Value = Vec<Vector3<f64>>> {
    prop::collection::vec(prop::array::uniform3(number()).prop_map(Vector3::from), 0..most)
}

fn ids(count: usize) -> Vec<ParameterId> {
    ParameterId::all_of_links(count.div_ceil(5)).into_iter().take(count).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 150, ..ProptestConfig::default() })]

    #[test]
    fn uncertainties_are_of_their_own_parameters(
        (columns, jacobian) in (0..5_usize).prop_flat_map(|n| (Just(n), matrix(n))),
        other in (0..5_usize).prop_flat_map(matrix), asked in 0..6_usize, data_rows in 0..14_usize, residuals in prop::collection::vec(number(), 0..14)
    ) {
        let parameters = ids(asked);
        let uncertainty = Uncertainty::new(&jacobian, data_rows, &parameters);
        let bound = cramer_rao_bound(&jacobian, &parameters);
        let drawn = [jacobian.clone(), other.clone()];
        let bayesian = bayesian_cramer_rao_bound(drawn.iter(), &jacobian, &parameters);
        if asked != columns || asked == 0 {
            prop_assert!(uncertainty.is_none() && bound.is_none() && bayesian.is_none());
        }
        if other.ncols() != columns {
            prop_assert!(bayesian.is_none());
        }
        if bound.is_some() {
            prop_assert!(jacobian.iter().all(|v| v.is_finite()));
        }
        let none: [DMatrix<f64>; 0] = [];
        let _ = bayesian_cramer_rao_bound(none.iter(), &other, &parameters);
        let Some(uncertainty) = uncertainty else { return Ok(()) };
        prop_assert!(data_rows <= jacobian.nrows() && uncertainty.covariance().iter().all(|v| v.is_finite()));
        prop_assert_eq!(uncertainty.support().len(), asked);
        let wrong = PositionJacobian::zeros(asked + 1);
        prop_assert!(uncertainty.position_covariance(&wrong).is_none());
        prop_assert!(uncertainty.position_covariance(&PositionJacobian::zeros(asked)).is_some());
        let influences = uncertainty.influences(&jacobian, &residuals, data_rows + 7, &[]);
        prop_assert!(influences.len() <= jacobian.nrows().min(residuals.len()) / 3);
        if other.ncols() != asked {
            prop_assert!(uncertainty.influences(&other, &residuals, data_rows, &[]).is_empty());
        }
        let _ = uncertainty.strongest_correlations(0.5);
        let _ = (uncertainty.effective_parameters(), uncertainty.data_covariance(), uncertainty.prior_part());
    }

    #[test]
    fn errors_of_unlike_many_poses_are_not_compared(a in points(9), b in points(9), level in number(), share in number()) {
        prop_assert_eq!(accuracy(&a).is_none(), a.is_empty());
        let difference = paired_rms_difference(&a, &b, level);
        prop_assert!(difference.is_none() || (a.len() == b.len() && a.len() > 1));
        let flat: Vec<f64> = a.iter().map(|v| v.x).collect();
        prop_assert_eq!(resampled_difference(&flat, share, level).is_none(), flat.len() < 2);
        let variant = |name: &str, against, held_out: &[Vector3<f64>]| Variant {
            name: name.to_owned(),
            against,
            parameters: 3,
            fit: Fit { chi2: share, rows: held_out.len(), parameters: level },
            held_out: held_out.to_vec(),
        };
        let variants = [variant("a", None, &a), variant("b", Some(0), &b), variant("c", Some(9), &a), variant("d", Some(3), &b)];
        for noise in [NoiseLevel::Known, NoiseLevel::Estimated] {
            let rows = compare_variants(&variants, noise, level);
            prop_assert_eq!(rows.len(), 4);
            prop_assert!(rows[2].against.is_none());
        }
    }

    #[test]
    fn bands_and_tests_return(chi2 in number(), dof in number(), level in number(), hits in 0..50_u64, trials in 0..40_u64, sizes in (0..50_usize, 0..40_usize)) {
        prop_assert_eq!(ChiSquareTest::new(chi2, dof).is_none(), !(dof > 0.0));
        let _ = chi2_band(dof, level);
        let _ = mean_nees_band(usize::MAX, 3, 0.95);
        let _ = mean_nees_band(sizes.0, sizes.1, level);
        let coverage = Coverage { hits, trials };
        let _ = (coverage.fraction(), coverage.interval(level), coverage.p_value(level));
    }

    #[test]
    fn an_error_and_a_covariance_of_other_sizes_have_no_nees(error in prop::collection::vec(number(), 0..5), covariance in (0..5_usize).prop_flat_map(matrix)) {
        let error = DVector::from_vec(error);
        let found = nees(&error, &covariance);
        prop_assert!(found.is_none() || covariance.shape() == (error.len(), error.len()));
        prop_assert!(found.is_none_or(f64::is_finite));
    }

    #[test]
    fn splits_hold_what_is_there(count in 0..20_usize, folds in 0..25_usize, repeats in 0..4_usize, seed in any::<u64>()) {
        let mut rng = stream(seed, 0, StreamSource::AsBuilt);
        let mut all = k_fold(count, folds, &mut rng);
        all.extend(leave_one_out(count));
        all.extend(repeated_splits(count, folds, repeats, &mut rng));
        for split in &all {
            prop_assert_eq!(split.fitted.len() + split.held_out.len(), count);
        }
        // Splits of a longer set.
        let (_, set) = arm();
        let foreign = Split { fitted: vec![0, 10_000], held_out: vec![usize::MAX, 1] };
        prop_assert_eq!(subset(&set, &foreign.fitted).observations.len(), 1);
        all.push(foreign);
        let errors = held_out_errors(&set, &all, |_, held_out| {
            Ok::<_, String>(held_out.observations.iter().map(|o| o.reading.position()).collect())
        });
        let _ = in_order(&all, &errors.expect("no error"), count);
        prop_assert!(in_order(&all, &[], count).is_none());
    }

    #[test]
    fn residuals_that_do_not_belong_together_have_no_pattern(
        poses in 0..6_usize, residuals in prop::collection::vec(number(), 0..20), columns in 0..4_usize, level in number(),
        commands in prop::collection::vec(prop::collection::vec(number(), 0..3), 6), odd in number(), turns in 0..4_usize
    ) {
        let whitening = Whitening::apart(vec![Matrix3::identity() * odd; poses]);
        let approach = [1, -1, 0];
        let sensitivity = [Vector3::x(), Vector3::new(odd, 0.0, 1.0)];
        let conditions: Vec<_> = commands[..poses]
            .iter()
            .enumerate()
            .map(|(i, command)| PoseConditions {
                command,
                approach: &approach[..i % 4],
                time: i as f64 * odd,
                temperature: (i % 2 == 0).then_some(odd),
                position: Vector3::new(1.0, odd, i as f64),
                sensitivity: &sensitivity[..i % 3],
                load: Vector3::new(0.0, odd, (i % 2) as f64),
                pose: u32::try_from(7 * (i / 2)).unwrap_or_default(),
                seen: (i % 2, 0),
            })
            .collect();
        let rows = residuals.len();
        let jacobian = DMatrix::from_fn(rows.saturating_sub(rows % 2), columns, |i, j| ((i * 7 + j * 3) as f64).sin() * odd);
        let residuals = DVector::from_vec(residuals);
        let set = ResidualSet {
            residuals: &residuals,
            jacobian: &jacobian,
            measured_rows: rows,
            freedom: rows as f64 - odd,
            whitening: &whitening,
            poses: &conditions,
            joint_names: &[],
            motor_turns: &vec![Some(odd); turns],
        };
        let found = find_patterns(&set, level);
        prop_assert!(found.is_none() || (jacobian.nrows() == rows && poses > 0 && 3 * poses <= rows));
        for size in [None, ChiSquareTest::new(odd, rows as f64)] {
            let report = check_consistency(&set, size, level);
            prop_assert!(!report.to_string().is_empty());
            let _ = report.is_consistent();
        }
    }
}
