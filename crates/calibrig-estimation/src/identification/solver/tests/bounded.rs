use super::super::bounds::StepBox;
use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A random positive definite system with four unknowns, and a box about zero that holds some of them.
fn random_box(rng: &mut ChaCha8Rng) -> (DMatrix<f64>, DVector<f64>, Vec<f64>, Vec<f64>) {
    let root = DMatrix::from_fn(6, 4, |_, _| rng.random_range(-1.0..1.0));
    let gradient = DVector::from_fn(4, |_, _| rng.random_range(-1.0..1.0));
    let limits = |rng: &mut ChaCha8Rng| -> Vec<f64> {
        (0..4)
            .map(|_| match rng.random_range(0..4) {
                0 => 0.0,
                1 => f64::INFINITY,
                _ => rng.random_range(0.0..0.8),
            })
            .collect()
    };
    let lower = limits(rng).into_iter().map(|v| -v).collect();
    (root.transpose() * &root, gradient, lower, limits(rng))
}

/// The least value over all 81 choices of components that are free, at their lower or at their upper bound.
fn by_enumeration(h: &DMatrix<f64>, g: &DVector<f64>, lower: &[f64], upper: &[f64]) -> f64 {
    let value = |p: &DVector<f64>| 0.5 * p.dot(&(h * p)) + g.dot(p);
    let mut least = f64::INFINITY;
    for choice in 0..81 {
        let digit = |j: u32| choice / 3_i32.pow(j) % 3;
        let mut p = DVector::zeros(4);
        let mut matrix = h.clone();
        let mut right = -g;
        for j in 0..4 {
            if digit(j) > 0 {
                let j_index = j as usize;
                p[j_index] = if digit(j) == 1 { lower[j_index] } else { upper[j_index] };
                matrix.row_mut(j_index).fill(0.0);
                matrix[(j_index, j_index)] = 1.0;
                right[j_index] = p[j_index];
            }
        }
        if p.iter().any(|v| v.is_infinite()) {
            continue;
        }
        let Some(p) = matrix.lu().solve(&right) else { continue };
        if (0..4).all(|j| lower[j] - 1e-12 <= p[j] && p[j] <= upper[j] + 1e-12) {
            least = least.min(value(&p));
        }
    }
    least
}

#[test]
fn a_step_in_a_box_is_the_best_of_all_active_sets() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for _ in 0..500 {
        let (h, g, lower, upper) = random_box(&mut rng);
        let bounds = Bounds::new(lower.clone(), upper.clone()).unwrap();
        let inside: StepBox = bounds.of_step(&[0.0; 4], &DVector::from_element(4, 1.0));
        let p = inside.minimise(&h, &g).unwrap().step;
        let value = 0.5 * p.dot(&(&h * &p)) + g.dot(&p);
        let least = by_enumeration(&h, &g, &lower, &upper);
        assert!((value - least).abs() < 1e-10 * (1.0 + least.abs()), "{value} {least}");
        assert!((0..4).all(|j| lower[j] <= p[j] && p[j] <= upper[j]));
    }
}

/// A random nonlinear problem, with every parameter bounded below by zero. First-order conditions: derivatives vanish inside and push
/// outward at a bound.
#[test]
fn what_comes_out_satisfies_the_first_order_conditions() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let mut reached = 0;
    for _ in 0..100 {
        let a = DMatrix::from_fn(12, 6, |_, _| rng.random_range(-1.0..1.0));
        let wanted = DVector::from_fn(6, |_, _| rng.random_range(-1.0..1.0));
        let b = &a * wanted + DVector::from_fn(12, |_, _| rng.random_range(-0.1..0.1));
        let rows = |x: &[f64]| {
            (0..12)
                .map(|i| {
                    let linear: f64 = (0..6).map(|j| a[(i, j)] * x[j]).sum();
                    let slope = 1.0 + 0.3 * linear.cos();
                    (linear + 0.3 * linear.sin() - b[i], (0..6).map(|j| slope * a[(i, j)]).collect())
                })
                .collect()
        };
        let mut problem = Formula { n: 6, m: 12, blocks: 0, f: rows };
        let bounds = Bounds::new(vec![0.0; 6], vec![f64::INFINITY; 6]).unwrap();
        let solution = minimise_within(&mut problem, vec![0.5; 6], &tight(), &bounds, &[]).unwrap();
        assert!(solution.termination.converged(), "{:?}", solution.termination);
        let gradient = solution.jacobian.transpose() * &solution.residuals;
        for j in 0..6 {
            let at = solution.at_bound.iter().find(|b| b.parameter == j);
            assert_eq!(at.is_some(), solution.x[j] == 0.0);
            match at {
                Some(at) => {
                    reached += 1;
                    assert_eq!(at.side, Side::Lower);
                    assert!(at.gradient >= 0.0 && (at.gradient - gradient[j]).abs() < 1e-12);
                }
                None => assert!(solution.x[j] > 0.0 && gradient[j].abs() < 1e-7, "{}", gradient[j]),
            }
        }
    }
    assert!((150..450).contains(&reached), "{reached} of 600 parameters at their bound");
}

#[test]
fn equal_bounds_hold_a_parameter_and_wide_ones_change_nothing() {
    let bounds = Bounds::new(vec![-1.2, f64::NEG_INFINITY], vec![-1.2, f64::INFINITY]).unwrap();
    let options = SolverOptions::default();
    let held = minimise_within(&mut rosenbrock(), vec![-1.2, 1.0], &options, &bounds, &[]).unwrap();
    assert_eq!(held.x[0], -1.2);
    assert!((held.x[1] - 1.44).abs() < 1e-9);
    // The valley falls towards larger x1.
    let at = [AtBound { parameter: 0, side: Side::Upper, gradient: held.at_bound[0].gradient }];
    assert_eq!(held.at_bound, at);
    assert!((at[0].gradient + 2.2).abs() < 1e-6);
    let free = minimise(&mut rosenbrock(), vec![-1.2, 1.0], &options);
    let wide = minimise_within(&mut rosenbrock(), vec![-1.2, 1.0], &options, &Bounds::none(2), &[]).unwrap();
    assert_eq!((free.x, free.iterations), (wide.x, wide.iterations));
    assert!(wide.at_bound.is_empty());
}

#[test]
fn bounds_that_cannot_be_kept_are_refused() {
    let refused = |bounds: &Bounds| {
        minimise_within(&mut rosenbrock(), vec![-1.2, 1.0], &SolverOptions::default(), bounds, &[])
            .unwrap_err()
    };
    let bounds = Bounds::new(vec![0.0, 0.0], vec![1.0, 2.0]).unwrap();
    assert_eq!(
        refused(&bounds),
        BoundsError::ExcludesStart { parameter: 0, start: -1.2, lower: 0.0, upper: 1.0 }
    );
    assert_eq!(refused(&Bounds::none(3)), BoundsError::Length { what: "bounds", found: 3, expected: 2 });
    assert_eq!(
        Bounds::new(vec![0.0, 3.0], vec![1.0, 2.0]),
        Err(BoundsError::Empty { parameter: 1, lower: 3.0, upper: 2.0 })
    );
    assert!(matches!(Bounds::new(vec![f64::NAN], vec![1.0]), Err(BoundsError::Empty { parameter: 0, .. })));
    assert!(matches!(
        Bounds::new(vec![f64::INFINITY], vec![f64::INFINITY]),
        Err(BoundsError::Empty { parameter: 0, .. })
    ));
    assert!(matches!(Bounds::new(vec![0.0], vec![]), Err(BoundsError::Length { found: 0, expected: 1, .. })));
    let start = minimise_within(
        &mut rosenbrock(),
        vec![f64::NAN, 1.0],
        &SolverOptions::default(),
        &Bounds::none(2),
        &[],
    );
    assert!(matches!(start, Err(BoundsError::ExcludesStart { parameter: 0, .. })));
}
