//! Compares the test with leaving out and refitting, and checks its level, and what an estimate reports.

use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;
use crate::identification::tests::{ELBOW, SHOULDER, geometric_errors, measure, options, painter, truth};
use crate::identification::{
    ComplianceChoice, Estimate, IdentificationOptions, Mode, Tolerance, Warning, identify,
};
use calibrig_model::statistics::{binomial_cdf, chi2_quantile};

const DATA: usize = 30;
const PARAMETERS: usize = 6;

fn normal(rows: usize, columns: usize, rng: &mut ChaCha8Rng) -> DMatrix<f64> {
    DMatrix::from_fn(rows, columns, |_, _| StandardNormal.sample(rng))
}

/// Whitened data above one prior per parameter; the data are weak, so that the priors count.
fn system(rng: &mut ChaCha8Rng) -> DMatrix<f64> {
    let mut jacobian = normal(DATA + PARAMETERS, PARAMETERS, rng);
    jacobian *= 0.3;
    jacobian.rows_mut(DATA, PARAMETERS).fill_with_identity();
    jacobian
}

/// The priors of a linear system whose right-hand side is `errors`: single ones, and the last three as one block.
fn family(jacobian: &DMatrix<f64>, errors: &DVector<f64>) -> Family {
    let covariance = jacobian.tr_mul(jacobian).try_inverse().expect("regular");
    let residuals = errors - jacobian * (&covariance * jacobian.tr_mul(errors));
    let priors = jacobian.rows(DATA, PARAMETERS);
    let hat = priors * covariance * priors.transpose();
    let own = |row: usize| RowGroup { rows: row..row + 1, kind: Kind::Own(row, 1.0) };
    let mut groups: Vec<_> = (0..3).map(own).collect();
    groups.push(RowGroup { rows: 3..6, kind: Kind::Block(0) });
    Family {
        residuals: residuals.rows(DATA, PARAMETERS).into_owned(),
        covariance: DMatrix::identity(PARAMETERS, PARAMETERS) - hat,
        groups,
    }
}

#[test]
fn a_wrong_prior_is_told_with_what_a_fit_without_it_finds() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let jacobian = system(&mut rng);
    for (wrong, group, rows) in [(1, 1, 1..2), (4, 3, 3..6)] {
        let mut errors = DVector::from_column_slice(normal(DATA + PARAMETERS, 1, &mut rng).as_slice());
        errors[DATA + wrong] += 12.0;
        let outcasts = family(&jacobian, &errors).outcasts(1e-3 / 4.0);
        let [outcast] = outcasts.as_slice() else { panic!("{} of one", outcasts.len()) };
        assert_eq!((outcast.group, outcast.freedom), (group, rows.len()));
        // The result from the system without these rows.
        let kept: Vec<_> =
            (0..DATA + PARAMETERS).filter(|row| !(*row >= DATA && rows.contains(&(row - DATA)))).collect();
        let (rest, right) = (jacobian.select_rows(&kept), errors.select_rows(&kept));
        let covariance = rest.tr_mul(&rest).try_inverse().expect("regular");
        let x = &covariance * rest.tr_mul(&right);
        let n = rows.len();
        let (start, mut spread) = (rows.start, DMatrix::identity(n, n));
        spread += covariance.view((start, start), (n, n));
        let left_out = errors.rows(DATA + start, n) - x.rows(start, n);
        assert!((&outcast.left_out - &left_out).norm() < 1e-9 * left_out.norm());
        assert!((&outcast.spread - &spread).norm() < 1e-9 * spread.norm());
        let chi2 = left_out.dot(
            &spread
                .try_inverse()
                .expect("regular")
                .column_iter()
                .enumerate()
                .fold(DVector::zeros(n), |sum, (i, column)| sum + left_out[i] * column),
        );
        assert!((outcast.chi2 / chi2 - 1.0).abs() < 1e-9, "{} {chi2}", outcast.chi2);
    }
}

/// The tests of the groups depend on each other, so that Bonferroni's level is kept but not reached; that of a single group is exact.
#[test]
fn sound_priors_are_named_as_seldom_as_the_level_says() {
    const LEVEL: f64 = 0.05;
    const DRAWS: u32 = 20_000;
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let jacobian = system(&mut rng);
    let (mut any, mut first) = (0, 0);
    for _ in 0..DRAWS {
        let errors = DVector::from_column_slice(normal(DATA + PARAMETERS, 1, &mut rng).as_slice());
        let family = family(&jacobian, &errors);
        any += u32::from(!family.outcasts(LEVEL / 4.0).is_empty());
        let block = GroupBlock::of(&family.covariance, &(0..1));
        first +=
            u32::from(family.residuals[0].powi(2) * block.inverse[(0, 0)] > chi2_quantile(1.0 - LEVEL, 1.0));
    }
    println!("{any} and {first} of {DRAWS} at {LEVEL}");
    let cdf = |hits: u32| binomial_cdf(u64::from(hits), u64::from(DRAWS), LEVEL);
    assert!(cdf(any) < 0.9995, "{any}");
    assert!((5e-4..1.0 - 5e-4).contains(&cdf(first)), "{first}");
    // Nor too rarely: four tests at a quarter of the level, positively correlated but not identical.
    assert!(f64::from(any) > 0.5 * LEVEL * f64::from(DRAWS), "{any}");
}

#[test]
fn what_the_rest_cannot_tell_apart_is_named_together_and_what_it_tells_nothing_of_is_not() {
    // The data determine the sum of the first two, and nothing of the third.
    let mut jacobian = DMatrix::zeros(DATA + PARAMETERS, PARAMETERS);
    for row in 0..DATA {
        jacobian[(row, 0)] = 10.0;
        jacobian[(row, 1)] = 10.0;
        jacobian[(row, 3 + row % 3)] = 1.0;
    }
    jacobian.rows_mut(DATA, PARAMETERS).fill_with_identity();
    let mut errors = DVector::zeros(DATA + PARAMETERS);
    for row in 0..DATA {
        errors[row] = 10.0 * 9.0;
    }
    let family = family(&jacobian, &errors);
    assert_eq!(family.tests(), 3);
    let outcasts = family.outcasts(1e-3);
    assert_eq!(outcasts.len(), 1);
    let mut both = [outcasts[0].group, outcasts[0].rivals[0]];
    both.sort_unstable();
    assert_eq!(both, [0, 1]);
}

fn elastic(compliance_sigma: f64) -> IdentificationOptions {
    IdentificationOptions {
        compliances: ComplianceChoice::Listed(vec![SHOULDER, ELBOW]),
        compliance_sigma,
        ..options(Mode::ElastoGeometric)
    }
}

fn names(estimate: &Estimate) -> Vec<String> {
    estimate.contradicted.iter().map(|contradiction| contradiction.stated.name()).collect()
}

fn has_inconsistent(estimate: &Estimate) -> bool {
    estimate.warnings.iter().any(|w| matches!(w, Warning::Inconsistent { .. }))
}

#[test]
fn an_estimate_names_the_compliance_that_was_stated_too_well() {
    let nominal = painter();
    let id = ParameterId::Compliance(SHOULDER);
    let set = measure(&truth(&nominal, &[(id, 0.2)], Vec::new()), 60, 1.0);
    let sound = identify(&nominal, &set, &elastic(0.1)).expect("an estimate");
    assert!(sound.is_sound() && sound.contradicted.is_empty(), "{:?}", sound.warnings);
    let wrong = identify(&nominal, &set, &elastic(0.005)).expect("an estimate");
    assert_eq!(names(&wrong), [id.to_string()]);
    assert!(!wrong.is_sound() && !has_inconsistent(&wrong), "{:?}", wrong.warnings);
    let Stated::Parameter { found, sigma, prior_sigma, .. } = wrong.contradicted[0].stated else {
        panic!("{:?}", wrong.contradicted)
    };
    assert_eq!(prior_sigma, 0.005);
    assert!((found - 0.2).abs() < 4.0 * sigma, "{found} +- {sigma}");
    let told = wrong.warnings.iter().map(ToString::to_string).collect::<Vec<_>>();
    assert_eq!(told.iter().filter(|w| w.contains("the measurements contradict")).count(), 1, "{told:?}");
}

#[test]
fn an_estimate_names_the_link_that_is_not_as_well_made_as_stated() {
    let nominal = painter();
    let mut deviations = geometric_errors(&nominal);
    for (_, value) in &mut deviations {
        *value *= 0.2;
    }
    let (id, _) = deviations[5];
    deviations[5].1 = 15e-3;
    let set = measure(&truth(&nominal, &deviations, Vec::new()), 60, 1.0);
    let options =
        IdentificationOptions { tolerance: Some(Tolerance { length: 1e-3, angle: 1e-3 }), ..elastic(0.1) };
    let estimate = identify(&nominal, &set, &options).expect("an estimate");
    assert_eq!(names(&estimate), [id.to_string()]);
    assert!(!has_inconsistent(&estimate), "{:?}", estimate.warnings);
}

#[test]
fn an_estimate_names_a_nest_and_a_target_that_are_not_where_they_were_stated() {
    let nominal = painter();
    let good = measure(&truth(&nominal, &[], Vec::new()), 60, 1.0);
    let mut set = good.clone();
    set.stations[0].nests[1].in_base += Vector3::new(0.0, 0.0, 1e-3);
    let estimate = identify(&nominal, &set, &elastic(0.1)).expect("an estimate");
    let Some(Stated::Nest { nest, length, .. }) = estimate.contradicted.last().map(|c| &c.stated) else {
        panic!("{:?}", estimate.warnings)
    };
    assert_eq!(*nest, set.stations[0].nests[1].name);
    assert!((length - 1e-3).abs() < 2e-4, "{length}");

    let mut set = good;
    set.targets[0].in_flange.x += 1e-3;
    let estimate = identify(&nominal, &set, &elastic(0.1)).expect("an estimate");
    let [told] = estimate.contradicted.as_slice() else { panic!("{:?}", estimate.warnings) };
    let Stated::Target { target, length } = &told.stated else { panic!("{told}") };
    assert_eq!(target, "S1");
    // Errors of the last links can replace it in some directions, so that only part of the millimetre is found.
    assert!((3e-4..1.2e-3).contains(length) && told.freedom < 3, "{told}");
    assert!(told.to_string().contains("at least"), "{told}");
}

/// The base as the nests give it is turned by 1 mrad about each axis.
#[test]
fn a_tracker_that_moved_after_its_nests_were_measured_is_told() {
    let nominal = painter();
    let mut set = measure(&truth(&nominal, &[], Vec::new()), 60, 1.0);
    for nest in &mut set.stations[0].nests {
        let turned = calibrig_model::geometry::small_displacement(&nalgebra::Vector6::new(
            0.0, 0.0, 0.0, 1e-3, 1e-3, 1e-3,
        ));
        nest.in_base = turned.transform_point(&nest.in_base.into()).coords;
    }
    // Few link parameters, so that they cannot replace it.
    let options = IdentificationOptions {
        parameters: crate::identification::ParameterChoice::Listed(Vec::new()),
        ..elastic(0.1)
    };
    let estimate = identify(&nominal, &set, &options).expect("an estimate");
    let told: Vec<_> = estimate.warnings.iter().map(ToString::to_string).collect();
    // Nothing else is wrong: apart from the nests, the readings' own noise explains the residuals.
    assert!(!estimate.is_sound() && estimate.contradicted.len() == 1, "{told:?}");
    let words = estimate.contradicted[0].to_string();
    assert!(
        words.contains("the nests of station T1 (they put the base ") && words.contains("1.73 mrad"),
        "{words}"
    );
    // A shift of the base also absorbs what the model lacks: then it is not held against the estimate.
    let lacking = IdentificationOptions { mode: Mode::OnlyCalibration, ..options };
    let estimate = identify(&nominal, &set, &lacking).expect("an estimate");
    let told: Vec<_> = estimate.warnings.iter().map(ToString::to_string).collect();
    assert!(estimate.contradicted.iter().all(|c| !matches!(c.stated, Stated::Nests { .. })), "{told:?}");
}

/// The data contain gravity, the model does not, and links are off by four times their stated tolerance: both are reported.
#[test]
fn where_the_model_itself_does_not_fit_priors_are_tested_in_the_noise_that_it_leaves() {
    let nominal = painter();
    let set = measure(&truth(&nominal, &geometric_errors(&nominal), Vec::new()), 60, 1.0);
    let tight = |length, angle| IdentificationOptions {
        tolerance: Some(Tolerance { length, angle }),
        ..options(Mode::OnlyCalibration)
    };
    let estimate = identify(&nominal, &set, &tight(1e-3, 1e-3)).expect("an estimate");
    assert!(has_inconsistent(&estimate) && !estimate.contradicted.is_empty() && !estimate.is_sound());
    assert_eq!(estimate.warnings.iter().filter(|w| matches!(w, Warning::Contradicted(_))).count(), 1);
    let loose = identify(&nominal, &set, &tight(10e-3, 20e-3)).expect("an estimate");
    assert!(has_inconsistent(&loose) && loose.contradicted.is_empty(), "{:?}", loose.warnings);
}
