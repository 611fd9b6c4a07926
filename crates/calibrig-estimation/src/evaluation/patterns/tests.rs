use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::basis::regressors;
use super::regression::ProjectedResidual;
use super::*;
use crate::evaluation::{ChiSquareTest, check_consistency};
use crate::identification::Whitening;
use calibrig_model::statistics::binomial_cdf;

const JOINTS: usize = 4;
const SIGMA: f64 = 20e-6;

/// A pan, two arms and a rail: enough of a robot to have residuals.
fn position(rail: f64, pan: f64, shoulder: f64, elbow: f64) -> Vector3<f64> {
    let reach = 1.3 * shoulder.cos() + 0.9 * (shoulder + elbow).cos();
    Vector3::new(
        rail + reach * pan.cos(),
        reach * pan.sin(),
        1.3 * shoulder.sin() + 0.9 * (shoulder + elbow).sin(),
    )
}

struct Session {
    commands: Vec<[f64; JOINTS]>,
    approaches: Vec<[i8; JOINTS]>,
    sensitivities: Vec<[Vector3<f64>; JOINTS]>,
    whitening: Whitening,
    /// Three rows per pose, then one per parameter for its prior.
    jacobian: DMatrix<f64>,
    names: Vec<String>,
}

fn place(q: &[f64; JOINTS]) -> Vector3<f64> {
    position(q[0], q[1], q[2], q[3])
}

fn derivative(q: &[f64; JOINTS], joint: usize) -> Vector3<f64> {
    let at = |step: f64| {
        let mut moved = *q;
        moved[joint] += step;
        place(&moved)
    };
    (at(1e-6) - at(-1e-6)) / 2e-6
}

/// `poses` random poses; the fitted parameters are a constant and an offset of every joint, with priors.
fn session(poses: usize, rng: &mut ChaCha8Rng) -> Session {
    let commands: Vec<[f64; JOINTS]> = (0..poses)
        .map(|_| {
            [
                rng.random_range(0.0..4.0),
                rng.random_range(-2.0..2.0),
                rng.random_range(-1.0..1.0),
                rng.random_range(-1.5..0.5),
            ]
        })
        .collect();
    let approaches = (0..poses)
        .map(|i| {
            std::array::from_fn(|j| {
                if i == 0 {
                    0
                } else if commands[i][j] > commands[i - 1][j] {
                    1
                } else {
                    -1
                }
            })
        })
        .collect();
    let sensitivities: Vec<[Vector3<f64>; JOINTS]> =
        commands.iter().map(|q| std::array::from_fn(|j| derivative(q, j))).collect();
    let whitening: Vec<_> = (0..poses)
        .map(|i| Matrix3::new(1.0, 0.0, 0.0, 0.3, 0.8, 0.0, 0.0, -0.2, 0.5 + 0.01 * i as f64) / SIGMA)
        .collect();
    let parameters = 3 + JOINTS;
    let mut jacobian = DMatrix::zeros(3 * poses + parameters, parameters);
    for i in 0..poses {
        for k in 0..parameters {
            let column = if k < 3 { Vector3::ith(k, 1.0) } else { sensitivities[i][k - 3] };
            jacobian.fixed_view_mut::<3, 1>(3 * i, k).copy_from(&(whitening[i] * column));
        }
    }
    for k in 0..parameters {
        jacobian[(3 * poses + k, k)] = 1e4;
    }
    let names = ["rail", "pan", "shoulder", "elbow"].map(str::to_owned).to_vec();
    Session { commands, approaches, sensitivities, whitening: Whitening::apart(whitening), jacobian, names }
}

impl Session {
    /// Residuals of the fit from unit noise and `effect`, a displacement of every pose, m.
    fn residuals(&self, rng: &mut ChaCha8Rng, effect: impl Fn(usize) -> Vector3<f64>) -> DVector<f64> {
        let mut errors =
            DVector::from_fn(self.jacobian.nrows(), |_, _| -> f64 { StandardNormal.sample(rng) });
        let mut rows = errors.rows_mut(0, 3 * self.commands.len());
        rows += self.whitening.rows((0..self.commands.len()).map(&effect));
        let normal = self.jacobian.tr_mul(&self.jacobian).cholesky().expect("full rank");
        let x = normal.solve(&self.jacobian.tr_mul(&errors));
        errors - &self.jacobian * x
    }

    /// No load, 25 kg and 50 kg in turn, N.
    fn load(i: usize) -> Vector3<f64> {
        Vector3::new(0.0, 0.0, -245.0) * [0.0, 1.0, 2.0][i % 3]
    }

    fn time(i: usize) -> f64 {
        10.0 * i as f64
    }

    fn poses(&self) -> Vec<PoseConditions<'_>> {
        (0..self.commands.len())
            .map(|i| PoseConditions {
                command: &self.commands[i],
                approach: &self.approaches[i],
                time: Self::time(i),
                temperature: None,
                position: place(&self.commands[i]),
                sensitivity: &self.sensitivities[i],
                load: Self::load(i),
                pose: u32::try_from(i).expect("few poses"),
                seen: (0, 0),
            })
            .collect()
    }

    fn find(&self, residuals: &DVector<f64>, level: f64) -> PatternReport {
        let poses = self.poses();
        find_patterns(&self.set(residuals, &poses), level).expect("degrees of freedom")
    }

    fn size(&self, residuals: &DVector<f64>) -> Option<ChiSquareTest> {
        ChiSquareTest::new(residuals.norm_squared(), (residuals.len() - self.jacobian.ncols()) as f64)
    }

    fn set<'a>(&'a self, residuals: &'a DVector<f64>, poses: &'a [PoseConditions<'a>]) -> ResidualSet<'a> {
        const TURNS: &[Option<f64>] = &[Some(50.0), None, Some(16.0), Some(16.0)];
        ResidualSet {
            residuals,
            jacobian: &self.jacobian,
            // The truth is drawn from the priors: every row counts, and every parameter costs one.
            measured_rows: residuals.len(),
            freedom: (residuals.len() - self.jacobian.ncols()) as f64,
            whitening: &self.whitening,
            poses,
            joint_names: &self.names,
            motor_turns: TURNS,
        }
    }
}

/// Against two complete least squares fits computed in another way (normal equations of the stacked system).
#[test]
fn the_test_is_the_f_test_of_two_fits() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let session = session(40, &mut rng);
    let residuals = session.residuals(&mut rng, |_| Vector3::zeros());
    let poses = session.poses();
    let set = session.set(&residuals, &poses);
    let columns = regressors(&set, Cause::Approach(1));
    assert_eq!(columns.len(), 4);
    let rest = |extra: &[DVector<f64>]| {
        let all: Vec<_> = session
            .jacobian
            .column_iter()
            .map(nalgebra::Matrix::into_owned)
            .chain(extra.iter().cloned())
            .collect();
        let a = DMatrix::from_columns(&all.iter().map(|c| c / c.norm()).collect::<Vec<_>>());
        let x = a.tr_mul(&a).cholesky().expect("full rank").solve(&a.tr_mul(&residuals));
        (&residuals - a * x).norm_squared()
    };
    let (without, with) = (rest(&[]), rest(&columns));
    let dof = (residuals.len() - 7 - 4) as f64;
    let f = (without - with) / 4.0 / (with / dof);
    let expected = calibrig_model::statistics::f_ln_survival(f, 4.0, dof);
    let found = ProjectedResidual::new(&set).and_then(|r| r.test(&columns)).expect("a test");
    assert!((found.ln_p - expected).abs() < 1e-8, "{} {expected}", found.ln_p);
    assert!((found.fitted.norm_squared() - (without - with)).abs() < 1e-8);
}

/// From noise alone, every cause has the stated p-values, and the family of tests finds something no more often than promised.
#[test]
fn noise_has_no_pattern() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let session = session(40, &mut rng);
    let trials = 600;
    let mut small = std::collections::BTreeMap::new();
    let mut found = 0;
    for _ in 0..trials {
        let residuals = session.residuals(&mut rng, |_| Vector3::zeros());
        let report = session.find(&residuals, 0.05);
        found += u64::from(!report.patterns.is_empty());
        if report.patterns.is_empty() {
            // Chi-square with all rows less the parameters: the fit is linear, and the model right.
            let poses = session.poses();
            let check = check_consistency(&session.set(&residuals, &poses), session.size(&residuals), 1e-6);
            assert!(check.is_consistent(), "{check}");
            assert!(check.to_string().ends_with("no pattern against joints, approach, time or sequence"));
            let unstated = check_consistency(&session.set(&residuals, &poses), None, 1e-6);
            assert_eq!(unstated.size, None);
            assert!(report.tested.iter().any(|(cause, _)| *cause == Cause::Sequence));
        }
        for (cause, ln_p) in report.tested.iter().filter(|(cause, _)| *cause != Cause::Sequence) {
            *small.entry(*cause).or_insert(0_u64) += u64::from(ln_p.exp() < 0.1);
        }
    }
    assert_eq!(small.len(), 1 + 4 + 3 + 4 + 1 + 1, "{small:?}");
    for (cause, count) in small {
        // Binomial(600, 0.1), two tails of 0.01 % per cause.
        let (few, many) = (binomial_cdf(count, trials, 0.1), binomial_cdf(count - 1, trials, 0.1));
        assert!(few > 1e-4 && many < 1.0 - 1e-4, "{cause:?}: {count} of {trials}");
    }
    assert!(binomial_cdf(found - 1, trials, 0.05) < 0.999, "{found} of {trials}");
}

/// One effect at a time, of three sigma at its peak or less: it is found, named, and sized.
#[test]
fn one_effect_is_named() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let session = session(80, &mut rng);
    let turn = |i: usize, joint: usize, turns: f64| {
        (std::f64::consts::TAU * turns * session.commands[i][joint] + 0.7).sin()
            * session.sensitivities[i][joint]
    };
    type Effect<'a> = (Cause, &'a str, Box<dyn Fn(usize) -> Vector3<f64> + 'a>);
    let effects: Vec<Effect<'_>> = vec![
        (
            Cause::Time,
            "varies with time",
            Box::new(|i| Vector3::new(0.0, 60e-6, 0.0) * (Session::time(i) / 800.0)),
        ),
        (
            Cause::Approach(2),
            "varies with the approach of shoulder",
            Box::new(|i| 30e-6 * f64::from(session.approaches[i][2]) * session.sensitivities[i][2]),
        ),
        (
            Cause::Payload,
            "varies with the payload",
            // A drive that yields and is not in the model.
            Box::new(|i| {
                let shoulder = session.sensitivities[i][2];
                15e-6 / 490.0 * shoulder.dot(&Session::load(i)) * shoulder
            }),
        ),
        (Cause::Payload, "varies with the payload", Box::new(|i| 60e-6 / 490.0 * Session::load(i))),
        (
            Cause::MotorTurn(3),
            "varies within the motor turn of elbow",
            Box::new(|i| 70e-6 * turn(i, 3, 16.0)),
        ),
        (
            Cause::MotorTurn(0),
            "varies within the motor turn of rail",
            Box::new(|i| 50e-6 * turn(i, 0, 100.0)),
        ),
        (
            Cause::Joint(0),
            "varies with the command of rail",
            Box::new(|i| Vector3::new(0.0, 0.0, 60e-6) * (1.5 * session.commands[i][0]).sin()),
        ),
        (
            Cause::Joint(1),
            "varies with the command of pan",
            Box::new(|i| 60e-6 * session.commands[i][1].cos() * session.sensitivities[i][1]),
        ),
    ];
    for (cause, words, effect) in effects {
        let residuals = session.residuals(&mut rng, &effect);
        let report = session.find(&residuals, 0.001);
        let first = report.patterns.first().unwrap_or_else(|| panic!("{cause:?} is not found"));
        assert_eq!(first.cause, cause, "{:#?}", report.patterns);
        assert_eq!(first.description, words);
        assert!(first.ln_p < 0.001_f64.ln());
        let largest = (0..80).map(|i| effect(i).norm()).fold(0.0, f64::max);
        assert!(first.peak > 0.3 * largest && first.peak < 2.0 * largest, "{} {largest}", first.peak);
        assert!(first.share > 0.05 && first.share < 1.0);
        assert_eq!(report.patterns.len(), 1, "{:#?}", report.patterns);
        let poses = session.poses();
        let check = check_consistency(&session.set(&residuals, &poses), session.size(&residuals), 0.001);
        // Also where the size of the residuals alone does not show it yet.
        assert!(!check.is_consistent(), "{check}");
        assert!(check.to_string().contains(&format!("\nthe residual {words} (p = ")), "{check}");
    }
}

#[test]
fn memory_of_the_pose_before_is_found_where_nothing_else_explains_it() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let session = session(80, &mut rng);
    let mut walk = Vec::new();
    let mut state = Vector3::zeros();
    for _ in 0..80 {
        state = 0.6 * state + 30e-6 * Vector3::from_fn(|_, _| -> f64 { StandardNormal.sample(&mut rng) });
        walk.push(state);
    }
    let residuals = session.residuals(&mut rng, |i| walk[i]);
    let report = session.find(&residuals, 0.001);
    let last = report.patterns.last().expect("a pattern");
    assert_eq!(last.cause, Cause::Sequence, "{:#?}", report.patterns);
    assert!(report.serial_correlation.is_some_and(|r| r > 0.2 && r < 0.7));
    assert!(last.to_string().starts_with("the residual resembles that of the pose before (p = "), "{last}");
}

/// The moments of the serial correlation from random draws: the exact mean and variance hold for the residuals of a fit.
#[test]
fn serial_correlation_of_noise_is_standard() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let session = session(12, &mut rng);
    let poses = session.poses();
    let trials = 4000;
    let mut small = 0;
    for _ in 0..trials {
        let residuals = session.residuals(&mut rng, |_| Vector3::zeros());
        let set = session.set(&residuals, &poses);
        let projected = ProjectedResidual::new(&set).expect("a residual");
        let serial = serial_correlation(&projected, &set).expect("enough poses");
        small += u64::from(serial.ln_p.exp() < 0.05);
    }
    // The tail is normal to within a tenth of its probability; binomial 0.05 % tails around that.
    let (few, many) = (binomial_cdf(small, trials, 0.045), binomial_cdf(small - 1, trials, 0.055));
    assert!(few > 5e-4 && many < 1.0 - 5e-4, "{small} of {trials}");
}

#[test]
fn what_does_not_vary_or_belong_together_is_not_tested() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let mut session = session(20, &mut rng);
    for command in &mut session.commands {
        command[1] = 0.5;
    }
    let residuals = session.residuals(&mut rng, |_| Vector3::zeros());
    let report = session.find(&residuals, 0.001);
    assert!(report.tested.iter().all(|(cause, _)| *cause != Cause::Joint(1)));
    let poses = session.poses();
    let short = residuals.rows(0, 12).into_owned();
    assert_eq!(find_patterns(&session.set(&short, &poses), 0.001), None);
    let zero = DVector::zeros(residuals.len());
    assert_eq!(find_patterns(&session.set(&zero, &poses), 0.001), None);
    assert_eq!(find_patterns(&session.set(&residuals, &[]), 0.001), None);
}
