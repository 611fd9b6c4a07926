//! Compared with `SciPy` (MINPACK, TRF, BFGS) and NIST's certified values: tests/fixtures/solver.

use serde::Deserialize;

use super::*;

#[derive(Deserialize)]
struct Reference {
    plain: Vec<Plain>,
    bounded: Vec<Bounded>,
    robust: Vec<RobustCase>,
}

#[derive(Deserialize)]
struct Plain {
    name: String,
    model: String,
    start: Vec<f64>,
    t: Vec<f64>,
    y: Vec<f64>,
    x: Vec<f64>,
    cost: f64,
    certified: Option<Certified>,
}

#[derive(Deserialize)]
struct Certified {
    x: Vec<f64>,
    cost: f64,
}

#[derive(Deserialize)]
struct Bounded {
    name: String,
    model: String,
    start: Vec<f64>,
    t: Vec<f64>,
    y: Vec<f64>,
    lower: Vec<Option<f64>>,
    upper: Vec<Option<f64>>,
    x: Vec<f64>,
    cost: f64,
    at_lower: Vec<usize>,
    at_upper: Vec<usize>,
}

#[derive(Deserialize)]
struct RobustCase {
    curve: String,
    start: Vec<f64>,
    t: Vec<f64>,
    y: Vec<[f64; 3]>,
    sigma: f64,
    priors: Vec<PriorCase>,
    outliers: Vec<usize>,
    fits: Vec<ReferenceFit>,
}

#[derive(Deserialize)]
struct PriorCase {
    parameter: usize,
    mean: f64,
    sigma: f64,
}

#[derive(Deserialize)]
struct ReferenceFit {
    loss: String,
    k: f64,
    x: Vec<f64>,
    cost: f64,
    weights: Vec<f64>,
    estimated: Estimated,
}

#[derive(Deserialize)]
struct Estimated {
    x: Vec<f64>,
    scale: f64,
    cost: f64,
}

fn reference() -> Reference {
    let text = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/solver/reference.json"));
    serde_json::from_str(text).unwrap()
}

/// Residuals and derivatives of a model at one datum.
fn datum(model: &str, x: &[f64], t: f64, y: f64) -> (f64, Vec<f64>) {
    match model {
        "bard" => {
            let w = t.min(16.0 - t);
            let d = x[1] * (16.0 - t) + x[2] * w;
            (x[0] + t / d - y, vec![1.0, -t * (16.0 - t) / (d * d), -t * w / (d * d)])
        }
        "kowalik_osborne" => {
            let (a, b) = (t * t + t * x[1], t * t + t * x[2] + x[3]);
            (x[0] * a / b - y, vec![a / b, x[0] * t / b, -x[0] * a * t / (b * b), -x[0] * a / (b * b)])
        }
        "meyer" => {
            let e = (x[1] / (t + x[2])).exp();
            (x[0] * e - y, vec![e, x[0] * e / (t + x[2]), -x[0] * e * x[1] / (t + x[2]).powi(2)])
        }
        "osborne_1" => {
            let (e, f) = ((-t * x[3]).exp(), (-t * x[4]).exp());
            (x[0] + x[1] * e + x[2] * f - y, vec![1.0, e, f, -t * x[1] * e, -t * x[2] * f])
        }
        "misra1a" => {
            let e = (-x[1] * t).exp();
            (x[0] * (1.0 - e) - y, vec![1.0 - e, x[0] * t * e])
        }
        "danwood" => {
            let p = t.powf(x[1]);
            (x[0] * p - y, vec![p, x[0] * p * t.ln()])
        }
        _ => panic!("{model}"),
    }
}

fn residuals(model: &str, x: &[f64], t: &[f64], y: &[f64]) -> Vec<(f64, Vec<f64>)> {
    let (five, ten) = (5_f64.sqrt(), 10_f64.sqrt());
    match model {
        "rosenbrock" => (rosenbrock().f)(x),
        "powell_singular" => {
            let (a, b) = (x[1] - 2.0 * x[2], x[0] - x[3]);
            vec![
                (x[0] + 10.0 * x[1], vec![1.0, 10.0, 0.0, 0.0]),
                (five * (x[2] - x[3]), vec![0.0, 0.0, five, -five]),
                (a * a, vec![0.0, 2.0 * a, -4.0 * a, 0.0]),
                (ten * b * b, vec![2.0 * ten * b, 0.0, 0.0, -2.0 * ten * b]),
            ]
        }
        "freudenstein_roth" => {
            let (a, b) = (x[0], x[1]);
            vec![
                (-13.0 + a + ((5.0 - b) * b - 2.0) * b, vec![1.0, 10.0 * b - 3.0 * b * b - 2.0]),
                (-29.0 + a + ((b + 1.0) * b - 14.0) * b, vec![1.0, 3.0 * b * b + 2.0 * b - 14.0]),
            ]
        }
        _ => t.iter().zip(y).map(|(t, y)| datum(model, x, *t, *y)).collect(),
    }
}

fn problem<'a>(
    model: &'a str,
    t: &'a [f64],
    y: &'a [f64],
    n: usize,
) -> Formula<impl FnMut(&[f64]) -> Rows + 'a> {
    let m = residuals(model, &vec![1.0; n], t, y).len();
    Formula { n, m, blocks: 0, f: move |x: &[f64]| residuals(model, x, t, y) }
}

/// Largest relative difference.
fn apart(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs() / b.abs().max(1e-9)).fold(0.0, f64::max)
}

#[test]
fn minima_are_those_of_minpack_and_nist() {
    let cases = reference().plain;
    assert!(cases.len() >= 9);
    for case in &cases {
        let mut problem = problem(&case.model, &case.t, &case.y, case.start.len());
        let solution = minimise(&mut problem, case.start.clone(), &tight());
        let name = &case.name;
        println!(
            "{name}: {:?}, {} iterations, x {:.1e}, cost {:.1e}",
            solution.termination,
            solution.iterations.len(),
            apart(&solution.x, &case.x),
            solution.cost / case.cost - 1.0
        );
        assert!(solution.termination.converged(), "{name}: {:?}", solution.termination);
        if case.model == "powell_singular" {
            // Its Jacobian is singular at the minimum, zero: the last digits of x are lost.
            assert!(solution.cost < 1e-12, "{name}: {}", solution.cost);
            assert!(solution.x.iter().all(|x| x.abs() < 1e-3), "{name}: {:?}", solution.x);
            continue;
        }
        assert!(apart(&solution.x, &case.x) < 1e-6, "{name}: {:?}, {:?}", solution.x, case.x);
        assert!((solution.cost - case.cost).abs() < 1e-9 * case.cost + 1e-20, "{name}: {}", solution.cost);
        if let Some(certified) = &case.certified {
            assert!(apart(&solution.x, &certified.x) < 1e-6, "{name}: {:?}", solution.x);
            assert!((solution.cost / certified.cost - 1.0).abs() < 1e-9, "{name}: {}", solution.cost);
        }
    }
}

/// With the default options: a minimum to four digits of the residuals.
#[test]
fn the_default_options_end_at_the_same_minima() {
    for case in &reference().plain {
        let mut problem = problem(&case.model, &case.t, &case.y, case.start.len());
        let options = SolverOptions { max_iterations: 1000, ..SolverOptions::default() };
        let solution = minimise(&mut problem, case.start.clone(), &options);
        assert!(solution.termination.converged(), "{}: {:?}", case.name, solution.termination);
        assert!(solution.cost < case.cost * 1.001 + 1e-10, "{}: {}", case.name, solution.cost);
    }
}

#[test]
fn bounded_minima_are_those_of_trf() {
    let cases = reference().bounded;
    assert!(cases.len() >= 5);
    for case in &cases {
        let fill = |limits: &[Option<f64>], none: f64| limits.iter().map(|v| v.unwrap_or(none)).collect();
        let bounds =
            Bounds::new(fill(&case.lower, f64::NEG_INFINITY), fill(&case.upper, f64::INFINITY)).unwrap();
        let mut problem = problem(&case.model, &case.t, &case.y, case.start.len());
        let solution = minimise_within(&mut problem, case.start.clone(), &tight(), &bounds, &[]).unwrap();
        let name = &case.name;
        println!("{name}: {:?}, {} iterations", solution.termination, solution.iterations.len());
        assert!(solution.termination.converged(), "{name}: {:?}", solution.termination);
        assert!(apart(&solution.x, &case.x) < 1e-6, "{name}: {:?}, {:?}", solution.x, case.x);
        assert!((solution.cost - case.cost).abs() < 1e-9 * case.cost, "{name}: {}", solution.cost);
        let at = |side| -> Vec<usize> {
            solution.at_bound.iter().filter(|b| b.side == side).map(|b| b.parameter).collect()
        };
        assert_eq!(
            (at(Side::Lower), at(Side::Upper)),
            (case.at_lower.clone(), case.at_upper.clone()),
            "{name}"
        );
    }
}

/// A curve in space and its derivatives.
fn curve(name: &str, x: &[f64], t: f64) -> [(f64, Vec<f64>); 3] {
    match name {
        "helix" => {
            let (s, c) = (x[1] * t + x[2]).sin_cos();
            [
                (x[0] * c, vec![c, -x[0] * t * s, -x[0] * s, 0.0]),
                (x[0] * s, vec![s, x[0] * t * c, x[0] * c, 0.0]),
                (x[3] * t, vec![0.0, 0.0, 0.0, t]),
            ]
        }
        "decays" => {
            let (e, f) = ((-x[3] * t).exp(), (-x[4] * t).exp());
            [
                (x[0] * e, vec![e, 0.0, 0.0, -t * x[0] * e, 0.0]),
                (x[1] * e, vec![0.0, e, 0.0, -t * x[1] * e, 0.0]),
                (x[2] * (1.0 - f), vec![0.0, 0.0, 1.0 - f, 0.0, t * x[2] * f]),
            ]
        }
        "line" => [
            (x[0] + x[1] * t, vec![1.0, t, 0.0, 0.0, 0.0, 0.0]),
            (x[2] + x[3] * t, vec![0.0, 0.0, 1.0, t, 0.0, 0.0]),
            (x[4] + x[5] * t, vec![0.0, 0.0, 0.0, 0.0, 1.0, t]),
        ],
        _ => panic!("{name}"),
    }
}

fn robust_problem(case: &RobustCase) -> Formula<impl FnMut(&[f64]) -> Rows + '_> {
    let n = case.start.len();
    let rows = move |x: &[f64]| {
        let mut rows = Vec::new();
        for (t, y) in case.t.iter().zip(&case.y) {
            for ((value, slope), y) in curve(&case.curve, x, *t).into_iter().zip(y) {
                rows.push(((value - y) / case.sigma, slope.iter().map(|s| s / case.sigma).collect()));
            }
        }
        for prior in &case.priors {
            let mut slope = vec![0.0; n];
            slope[prior.parameter] = 1.0 / prior.sigma;
            rows.push(((x[prior.parameter] - prior.mean) / prior.sigma, slope));
        }
        rows
    };
    Formula { n, m: 3 * case.t.len() + case.priors.len(), blocks: case.t.len(), f: rows }
}

fn loss(fit: &ReferenceFit) -> Loss {
    match fit.loss.as_str() {
        "huber" => Loss::Huber { k: fit.k },
        "cauchy" => Loss::Cauchy { k: fit.k },
        "tukey" => Loss::Tukey { k: fit.k },
        other => panic!("{other}"),
    }
}

#[test]
fn robust_minima_at_the_stated_scale_are_those_of_an_independent_cost() {
    let cases = reference().robust;
    assert!(cases.len() >= 3);
    for case in &cases {
        for fit in &case.fits {
            let options = SolverOptions { loss: loss(fit), loss_scale: LossScale::Fixed(1.0), ..tight() };
            let solution = minimise(&mut robust_problem(case), case.start.clone(), &options);
            let name = format!("{} {}", case.curve, fit.loss);
            println!("{name}: {:?}, {} iterations", solution.termination, solution.iterations.len());
            assert!(solution.termination.converged(), "{name}: {:?}", solution.termination);
            assert!(apart(&solution.x, &fit.x) < 1e-7, "{name}: {:?}, {:?}", solution.x, fit.x);
            assert!((solution.cost / fit.cost - 1.0).abs() < 1e-9, "{name}: {}", solution.cost);
            assert_eq!(solution.scale, 1.0);
            for (i, (found, expected)) in solution.weights.iter().zip(&fit.weights).enumerate() {
                assert!((found - expected).abs() < 1e-6, "{name}: weight {i} is {found}, {expected}");
            }
            assert_eq!(solution.outliers(6.0), case.outliers, "{name}");
        }
    }
}

#[test]
fn robust_minima_at_the_estimated_scale_are_those_of_an_independent_iteration() {
    for case in &reference().robust {
        for fit in &case.fits {
            let options = SolverOptions { loss: loss(fit), ..tight() };
            let solution = minimise(&mut robust_problem(case), case.start.clone(), &options);
            let name = format!("{} {}", case.curve, fit.loss);
            println!(
                "{name}: {:?}, {} iterations, scale {} {}",
                solution.termination,
                solution.iterations.len(),
                solution.scale,
                fit.estimated.scale
            );
            assert!(solution.termination.converged(), "{name}: {:?}", solution.termination);
            assert!((solution.scale / fit.estimated.scale - 1.0).abs() < 1e-7, "{name}: {}", solution.scale);
            assert!(apart(&solution.x, &fit.estimated.x) < 1e-7, "{name}: {:?}", solution.x);
            assert!((solution.cost / fit.estimated.cost - 1.0).abs() < 1e-7, "{name}: {}", solution.cost);
            assert_eq!(solution.outliers(6.0), case.outliers, "{name}");
        }
    }
}
