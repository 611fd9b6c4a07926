use super::*;
use calibrig_model::statistics::binomial_cdf;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// Residuals of `readings` (in standard deviations) after the least squares fit of `jacobian`.
fn fitted(jacobian: &DMatrix<f64>, readings: &DVector<f64>) -> DVector<f64> {
    let x = jacobian.clone().svd(true, true).solve(readings, 1e-14).expect("a solution");
    readings - jacobian * x
}

fn gross(jacobian: &DMatrix<f64>, residuals: &DVector<f64>, is_stated: bool) -> Vec<GrossError> {
    let blocks = residuals.len() / 3;
    let n = jacobian.ncols();
    let spread = jacobian.clone().qr().unpack_r().solve_upper_triangular(&DMatrix::identity(n, n));
    LinearFit { jacobian, residuals, blocks, weights: &[], joined: &[], is_stated }
        .gross_errors(spread.as_ref())
}

/// Sessions of any size, with columns in any unit, and a few poses of high leverage.
fn system(blocks: usize, n: usize, rng: &mut ChaCha8Rng) -> DMatrix<f64> {
    let units = [1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0, 1e3];
    let mut jacobian = DMatrix::from_fn(3 * blocks, n, |_, j| normal(rng) * units[j % 7]);
    jacobian.rows_mut(0, 3).scale_mut(3.0);
    jacobian
}

#[test]
fn normal_noise_raises_a_false_alarm_in_less_than_one_set_of_a_thousand() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let sizes = [(8, 11), (20, 11), (40, 27), (60, 30), (200, 27)];
    let (mut alarms, mut sets) = (0, 0);
    for (blocks, n) in sizes {
        for _ in 0..200 {
            let jacobian = system(blocks, n, &mut rng);
            let noise = DVector::from_fn(3 * blocks, |_, _| 0.02 * normal(&mut rng));
            alarms += u64::from(!gross(&jacobian, &fitted(&jacobian, &noise), false).is_empty());
            sets += 1;
        }
    }
    // The rate is not refuted at 99.9 %.
    assert!(binomial_cdf(alarms, sets, 1e-3) < 0.999, "{alarms} of {sets}");
}

/// Two readings of the same place with the same error hide each other: in the fit with both, neither looks like a gross error. If the complete
/// search finds them, the short test before it must not stop it.
#[test]
fn two_gross_errors_at_one_place_do_not_hide_each_other() {
    let mut rng = ChaCha8Rng::seed_from_u64(17);
    let (mut hidden, mut looked_over) = (0, 0);
    for set in 0..100 {
        let mut jacobian = system(60, 20, &mut rng);
        let place = jacobian.rows(3 * (set % 50), 3).into_owned();
        jacobian.rows_mut(177, 3).copy_from(&place);
        let mut readings = DVector::from_fn(180, |_, _| normal(&mut rng));
        let pair = [set % 50, 59];
        let along = jacobian.rows(177, 3).column(set % 20).normalize();
        for i in pair {
            readings.rows_mut(3 * i, 3).axpy(9.0, &along, 1.0);
        }
        let residuals = fitted(&jacobian, &readings);
        let (jacobian, residuals) = (&jacobian, &residuals);
        let found = gross(jacobian, residuals, true);
        let fit = LinearFit { jacobian, residuals, blocks: 60, weights: &[], joined: &[], is_stated: true };
        let has = |found: &[GrossError]| pair.iter().all(|i| found.iter().any(|e| e.observation == *i));
        hidden += usize::from(!has(&found));
        looked_over += usize::from(!has(&found) && has(&fit.gross_errors(None)));
    }
    assert!(hidden <= 10 && looked_over == 0, "{hidden} of 100 pairs hidden, {looked_over} looked over");
}

/// Gross errors hide behind their leverage and behind each other: three among forty readings, one of them in the pose of the highest leverage.
#[test]
fn gross_errors_are_named_with_their_size_and_nothing_else_is() {
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    let mut others = 0;
    for set in 0..200 {
        let jacobian = system(40, 11, &mut rng);
        let mut readings = DVector::from_fn(120, |_, _| normal(&mut rng));
        let wrong = [0, 1 + set % 20, 21 + set % 19];
        let size = if set % 2 == 0 { 25.0 } else { 1000.0 };
        for place in wrong {
            readings[3 * place + set % 3] += size;
        }
        let found = gross(&jacobian, &fitted(&jacobian, &readings), false);
        for place in wrong {
            let error = found.iter().find(|error| error.observation == place).expect("named");
            // The prediction of the pose with the highest leverage is uncertain by some standard deviations.
            let off = (error.left_out.norm() - size).abs();
            assert!(off < if place == 0 { 15.0 } else { 7.0 }, "set {set}, {place}: {error:?}");
        }
        others += found.len() - wrong.len();
    }
    assert!(others <= 2, "{others} others");
}

/// A model that lacks something leaves residuals that are not noise: largest where the robot reaches farthest, and similar in neighbouring poses.
#[test]
fn what_a_model_lacks_is_no_gross_error() {
    let mut rng = ChaCha8Rng::seed_from_u64(13);
    let mut alarms = 0;
    for _ in 0..300 {
        let jacobian = system(60, 24, &mut rng);
        let (pace, phase) = (1.0 + normal(&mut rng).abs(), normal(&mut rng));
        let misfit = |i: usize| {
            let at = i as f64 / 180.0;
            30.0 * at * at * (6.0 * pace * at + phase).sin()
        };
        let readings = DVector::from_fn(180, |i, _| misfit(i) + normal(&mut rng));
        alarms += usize::from(!gross(&jacobian, &fitted(&jacobian, &readings), true).is_empty());
    }
    assert!(alarms <= 3, "{alarms} of 300");
}

/// A stated noise that is larger than the readings' actual noise explains errors within it.
#[test]
fn what_the_stated_noise_explains_is_no_gross_error() {
    let mut rng = ChaCha8Rng::seed_from_u64(14);
    let jacobian = system(40, 11, &mut rng);
    let mut readings = DVector::from_fn(120, |_, _| 0.01 * normal(&mut rng));
    readings[30] += 2.0;
    let residuals = fitted(&jacobian, &readings);
    assert!(gross(&jacobian, &residuals, true).is_empty());
    assert_eq!(gross(&jacobian, &residuals, false)[0].observation, 10);
}

/// Held-out errors have no columns of a Jacobian.
#[test]
fn too_few_readings_or_none_name_nothing() {
    let none = DMatrix::zeros(9, 0);
    assert!(gross(&none, &DVector::from_element(9, 1.0), false).is_empty());
    assert!(gross(&DMatrix::zeros(0, 0), &DVector::zeros(0), false).is_empty());
    let not_finite = DVector::from_element(90, f64::NAN);
    assert!(gross(&DMatrix::zeros(90, 0), &not_finite, false).is_empty());
}
