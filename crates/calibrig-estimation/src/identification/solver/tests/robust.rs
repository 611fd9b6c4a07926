use super::super::loss::scale_of;
use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

const LOSSES: [Loss; 3] = [Loss::huber(), Loss::cauchy(), Loss::tukey()];

#[test]
fn weights_and_slopes_are_the_derivatives_of_the_loss() {
    for loss in [Loss::Squared, LOSSES[0], LOSSES[1], LOSSES[2]] {
        for u in [0.0, 0.3, 1.0, 1.6, 1.7, 3.0, 5.4, 5.6, 20.0_f64] {
            let (z, h) = (u * u + 2e-5, 1e-5);
            let weight = (loss.rho(z + h) - loss.rho(z - h)) / (2.0 * h);
            assert!((loss.weight(z) - weight).abs() < 1e-8, "{loss:?} at {u}");
            let slope = (loss.weight(z + h) - loss.weight(z - h)) / (2.0 * h);
            let mean = loss.weight(z) + 2.0 / 3.0 * z * slope;
            assert!((loss.mean_slope(z) - mean).abs() < 1e-7, "{loss:?} at {u}");
        }
        assert_eq!((loss.rho(0.0), loss.weight(0.0)), (0.0, 1.0));
    }
}

/// `E[f(u)]` for u distributed as chi with three degrees of freedom, by Simpson's rule in two pieces.
fn mean_over_chi(f: impl Fn(f64) -> f64, kink: f64) -> f64 {
    let density = |u: f64| (2.0 / std::f64::consts::PI).sqrt() * u * u * (-0.5 * u * u).exp();
    let simpson = |from: f64, to: f64| {
        let n = 4000;
        let h = (to - from) / f64::from(n);
        let at = |i: i32| {
            // The end points are moved into this piece.
            let u = (from + h * f64::from(i)).clamp(from + 1e-12, to - 1e-12);
            density(u) * f(u)
        };
        (0..=n).map(|i| at(i) * if i == 0 || i == n { 1.0 } else { f64::from(2 + 2 * (i % 2)) }).sum::<f64>()
            * h
            / 3.0
    };
    simpson(0.0, kink) + simpson(kink, 40.0)
}

#[test]
fn the_tuning_constants_leave_95_percent() {
    for loss in LOSSES {
        let (Loss::Huber { k } | Loss::Cauchy { k } | Loss::Tukey { k }) = loss else { continue };
        let a = mean_over_chi(|u| loss.mean_slope(u * u), k);
        let b = mean_over_chi(|u| loss.weight(u * u).powi(2) * u * u, k) / 3.0;
        assert!((a * a / b - 0.95).abs() < 1e-8, "{loss:?}: {}", a * a / b);
    }
}

/// 20,000 blocks: the standard error of the median norm is 0.86 / √n, of the scale 0.56 / √n = 0.4 %.
#[test]
fn the_scale_is_the_standard_deviation_and_outlives_outliers() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut norm = |sigma: f64| -> f64 {
        (0..3).map(|_| (sigma * rng.sample::<f64, _>(StandardNormal)).powi(2)).sum::<f64>().sqrt()
    };
    let mut norms: Vec<f64> = (0..20_000).map(|_| norm(2.5)).collect();
    assert!((scale_of(&mut norms, 0.0) / 2.5 - 1.0).abs() < 0.016);
    let fitted = scale_of(&mut norms, 45_000.0) / scale_of(&mut norms, 0.0);
    assert!((fitted - 2.0).abs() < 1e-12);
    norms[..1000].fill(1e9);
    let moved = scale_of(&mut norms, 0.0) / 2.5;
    assert!(moved > 1.0 && moved < 1.06, "{moved}");
    assert_eq!(scale_of(&mut [3.0, 1.0, 2.0, 4.0], 0.0), 2.5 / scale_unit());
    assert_eq!(scale_of(&mut [3.0, 1.0, 2.0], 0.0), 2.0 / scale_unit());
}

/// The norm at the median for a scale of one: where chi's distribution function is one half.
fn scale_unit() -> f64 {
    let unit = 1.0 / scale_of(&mut [1.0], 0.0);
    let below = mean_over_chi(|u| if u < unit { 1.0 } else { 0.0 }, unit);
    assert!((below - 0.5).abs() < 1e-9, "{below}");
    unit
}

/// Blocks along three lines in t, with noise, gross errors and a prior on the last slope, whose error is drawn about zero.
struct Session {
    t: Vec<f64>,
    y: Vec<[f64; 3]>,
    bad: Vec<usize>,
    prior: f64,
}

const PRIOR_SIGMA: f64 = 0.1;

fn session(rng: &mut ChaCha8Rng, blocks: u32, bad: usize) -> Session {
    let mut normal = || rng.sample::<f64, _>(StandardNormal);
    let t: Vec<f64> = (0..blocks).map(|i| 2.0 * f64::from(i) / f64::from(blocks - 1) - 1.0).collect();
    let mut y: Vec<[f64; 3]> = t.iter().map(|_| [normal(), normal(), normal()]).collect();
    let prior = PRIOR_SIGMA * normal();
    let mut places: Vec<usize> = Vec::new();
    while places.len() < bad {
        let place = rng.random_range(0..t.len());
        if !places.contains(&place) {
            places.push(place);
            let size = rng.random_range(12.0..100.0) * if rng.random_bool(0.5) { 1.0 } else { -1.0 };
            y[place][rng.random_range(0..3)] += size;
        }
    }
    places.sort_unstable();
    Session { t, y, bad: places, prior }
}

fn lines(session: &Session) -> Formula<impl FnMut(&[f64]) -> Rows + '_> {
    let f = move |x: &[f64]| {
        let mut rows = Vec::new();
        for (t, y) in session.t.iter().zip(&session.y) {
            for axis in 0..3 {
                let mut slope = vec![0.0; 6];
                slope[2 * axis] = 1.0;
                slope[2 * axis + 1] = *t;
                rows.push((x[2 * axis] + x[2 * axis + 1] * t - y[axis], slope));
            }
        }
        rows.push(((x[5] - session.prior) / PRIOR_SIGMA, vec![0.0, 0.0, 0.0, 0.0, 0.0, 1.0 / PRIOR_SIGMA]));
        rows
    };
    Formula { n: 6, m: 3 * session.t.len() + 1, blocks: session.t.len(), f }
}

const TRIALS: usize = 400;

struct Figures {
    /// Mean of `xᵀ C⁻¹ x` for the stated covariance C; the truth is zero.
    nees: f64,
    /// Sum of squares of the parameters that the data alone determine.
    squares: f64,
}

fn figures(options: &SolverOptions, bad: usize) -> Figures {
    let (mut nees, mut squares) = (0.0, 0.0);
    for trial in 0..TRIALS {
        let mut rng = ChaCha8Rng::seed_from_u64(1000 + trial as u64);
        let session = session(&mut rng, 60, bad);
        let solution = minimise(&mut lines(&session), vec![3.0; 6], options);
        assert!(solution.termination.converged(), "{:?}", solution.termination);
        if options.loss != Loss::Squared && bad > 0 {
            let found = solution.outliers(5.0);
            assert!(session.bad.iter().all(|i| found.contains(i)), "{:?} of {:?}", found, session.bad);
            assert!(found.len() <= bad + 1);
        }
        nees += (&solution.jacobian * DVector::from_column_slice(&solution.x)).norm_squared();
        squares += solution.x[..5].iter().map(|x| x * x).sum::<f64>();
    }
    Figures { nees: nees / TRIALS as f64, squares }
}

/// With six parameters and 400 trials the mean NEES has a standard error of sqrt(12 / 400) = 0.173; 3.3 of them are 0.57.
#[test]
fn the_covariance_is_that_of_the_estimates() {
    let plain = figures(&SolverOptions::default(), 0);
    assert!((plain.nees - 6.0).abs() < 0.57, "{}", plain.nees);
    for loss in LOSSES {
        let options = SolverOptions { loss, ..SolverOptions::default() };
        let clean = figures(&options, 0);
        println!("{loss:?} clean: NEES {}, squares {}", clean.nees, clean.squares / plain.squares);
        assert!((clean.nees - 6.0).abs() < 0.57, "{loss:?}: {}", clean.nees);
        // 1 / 0.95 in the limit of many blocks. Both fits have the same noise, so that the ratio varies far less than each of them.
        let loss_of_efficiency = clean.squares / plain.squares;
        assert!((1.0..1.12).contains(&loss_of_efficiency), "{loss:?}: {loss_of_efficiency}");
        let dirty = figures(&options, 3);
        println!("{loss:?} dirty: NEES {}, squares {}", dirty.nees, dirty.squares / plain.squares);
        assert!((dirty.nees - 6.0).abs() < 0.57, "{loss:?}: {}", dirty.nees);
        // 5 % of gross errors cost at most 15 % of the accuracy.
        assert!((dirty.squares / plain.squares).sqrt() < 1.15, "{loss:?}");
    }
    let ruined = figures(&SolverOptions::default(), 3);
    assert!((ruined.squares / plain.squares).sqrt() > 2.0);
}

#[test]
fn without_blocks_or_with_a_loss_that_never_acts_it_is_least_squares() {
    let session = session(&mut ChaCha8Rng::seed_from_u64(2), 30, 2);
    let plain = minimise(&mut lines(&session), vec![0.0; 6], &tight());
    let mut whole = lines(&session);
    whole.blocks = 0;
    let options = SolverOptions { loss: Loss::tukey(), ..tight() };
    let no_blocks = minimise(&mut whole, vec![0.0; 6], &options);
    assert_eq!((&plain.x, plain.cost), (&no_blocks.x, no_blocks.cost));
    let wide = SolverOptions { loss: Loss::Huber { k: 1e6 }, ..tight() };
    let wide = minimise(&mut lines(&session), vec![0.0; 6], &wide);
    assert!(wide.weights.iter().all(|w| *w == 1.0));
    assert!((wide.cost / plain.cost - 1.0).abs() < 1e-12);
    assert!(wide.x.iter().zip(&plain.x).all(|(a, b)| (a - b).abs() < 1e-10));
}

/// With three times the stated noise, the scale is three, and the covariance includes it.
#[test]
fn noise_above_the_stated_is_in_scale_and_variance() {
    let mut session = session(&mut ChaCha8Rng::seed_from_u64(3), 2000, 0);
    session.y.iter_mut().flatten().for_each(|y| *y *= 3.0);
    for loss in LOSSES {
        let options = SolverOptions { loss, ..SolverOptions::default() };
        let solution = minimise(&mut lines(&session), vec![0.0; 6], &options);
        // 2000 blocks: standard errors of 1.3 % and about 2 %.
        assert!((solution.scale / 3.0 - 1.0).abs() < 0.05, "{loss:?}: {}", solution.scale);
        let expected = 9.0 / 0.95;
        assert!((solution.variance_factor / expected - 1.0).abs() < 0.08, "{}", solution.variance_factor);
    }
}

#[test]
fn data_without_noise_are_fitted_and_their_outliers_named() {
    let mut session = session(&mut ChaCha8Rng::seed_from_u64(4), 30, 0);
    session.prior = 0.0;
    session.y.iter_mut().flatten().for_each(|y| *y = 0.0);
    session.y[7][1] = 40.0;
    for loss in LOSSES {
        let options = SolverOptions { loss, ..SolverOptions::default() };
        let solution = minimise(&mut lines(&session), vec![1.0; 6], &options);
        assert!(solution.termination.converged(), "{loss:?}: {:?}", solution.termination);
        assert!(solution.x.iter().all(|x| x.abs() < 1e-5), "{loss:?}: {:?}", solution.x);
        assert_eq!(solution.outliers(5.0), [7], "{loss:?}");
        assert!(solution.variance_factor >= 1.0);
    }
}

/// A scale that is far too small rejects every block: nothing is determined, and the Jacobian shows it.
#[test]
fn rejecting_everything_leaves_no_information() {
    let session = session(&mut ChaCha8Rng::seed_from_u64(5), 30, 0);
    let options = SolverOptions {
        loss: Loss::Tukey { k: 1e-6 },
        loss_scale: LossScale::Fixed(1e-3),
        ..SolverOptions::default()
    };
    let solution = minimise(&mut lines(&session), vec![0.0; 6], &options);
    assert!(solution.weights.iter().all(|w| *w == 0.0));
    assert_eq!(solution.variance_factor, f64::INFINITY);
    assert_eq!(solution.jacobian.rows(0, 90).amax(), 0.0);
}

#[test]
fn a_loss_without_a_positive_constant_is_no_fit() {
    let session = session(&mut ChaCha8Rng::seed_from_u64(6), 30, 0);
    for (loss, scale) in [
        (Loss::Huber { k: 0.0 }, LossScale::Estimated),
        (Loss::Cauchy { k: f64::NAN }, LossScale::Estimated),
        (Loss::Tukey { k: -1.0 }, LossScale::Fixed(1.0)),
        (Loss::huber(), LossScale::Fixed(0.0)),
    ] {
        let options = SolverOptions { loss, loss_scale: scale, ..SolverOptions::default() };
        let solution = minimise(&mut lines(&session), vec![0.0; 6], &options);
        assert_eq!(solution.termination, TerminationReason::NotFinite, "{loss:?} {scale:?}");
    }
}

/// Bounds, a loss and several starts together: the bound is kept, the outliers are found.
#[test]
fn everything_at_once() {
    let session = session(&mut ChaCha8Rng::seed_from_u64(7), 60, 3);
    let options = SolverOptions { loss: Loss::tukey(), starts: 5, ..SolverOptions::default() };
    let bounds = Bounds::new(vec![0.5; 6], vec![f64::INFINITY; 6]).unwrap();
    let solution = minimise_within(&mut lines(&session), vec![1.0; 6], &options, &bounds, &[1.0; 6]).unwrap();
    assert!(solution.termination.converged());
    assert_eq!(solution.at_bound.len(), 6);
    assert!(solution.at_bound.iter().all(|at| at.side == Side::Lower && at.gradient > 0.0));
    assert_eq!((solution.minima, solution.x), (1, vec![0.5; 6]));
    assert_eq!(solution.weights.iter().filter(|w| **w == 0.0).count(), 3);
}
