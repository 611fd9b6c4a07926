use super::*;

/// One parameter.
fn scalar(f: impl Fn(f64) -> Vec<(f64, f64)>, m: usize) -> Formula<impl FnMut(&[f64]) -> Rows> {
    Formula {
        n: 1,
        m,
        blocks: 0,
        f: move |x: &[f64]| f(x[0]).into_iter().map(|(r, d)| (r, vec![d])).collect(),
    }
}

#[test]
fn rosenbrock_is_solved_and_the_cost_never_rises() {
    let solution = minimise(&mut rosenbrock(), vec![-1.2, 1.0], &SolverOptions::default());
    assert_eq!(solution.termination, TerminationReason::SmallDecrease);
    assert!((solution.x[0] - 1.0).abs() < 1e-7 && (solution.x[1] - 1.0).abs() < 1e-7);
    assert!(solution.iterations.windows(2).all(|w| w[1].cost <= w[0].cost));
    assert_eq!((solution.minima, solution.scale, solution.variance_factor), (1, 1.0, 1.0));
}

/// Whether or not a step was taken, the cost of a record belongs to its parameters, and the last ones are the solution.
#[test]
fn the_record_of_an_iteration_holds_where_it_left_the_parameters() {
    let cost = |x: &[f64]| 100.0 * (x[1] - x[0] * x[0]).powi(2) + (1.0 - x[0]).powi(2);
    let wide = Bounds::new(vec![-10.0; 2], vec![10.0; 2]).expect("bounds");
    let start = vec![-1.2, 1.0];
    let options = SolverOptions::default();
    let free = minimise(&mut rosenbrock(), start.clone(), &options);
    let bounded = minimise_within(&mut rosenbrock(), start.clone(), &options, &wide, &[]).expect("inside");
    for solution in [free, bounded] {
        let records = &solution.iterations;
        assert!(records.iter().any(|r| !r.accepted));
        let mut before = &start;
        for record in records {
            assert!((cost(&record.parameters) - record.cost).abs() <= 1e-12 * (1.0 + record.cost));
            assert_eq!(record.accepted, record.parameters != *before);
            before = &record.parameters;
        }
        assert_eq!(*before, solution.x);
    }
}

/// A negligible step is taken without an evaluation after a step that confirmed the model, and with one otherwise.
#[test]
fn the_last_step_is_looked_at_only_where_the_model_did_not_hold() {
    for (slope, looked_at) in [(1.0, false), (1.3, true)] {
        let evaluations = std::cell::Cell::new(0);
        let residuals = |x: f64| vec![(x - 2.0, slope), (1.0, 0.0)];
        let mut problem = scalar(
            |x| {
                evaluations.set(evaluations.get() + 1);
                residuals(x)
            },
            2,
        );
        let solution = minimise(&mut problem, vec![-1.0], &SolverOptions::default());
        assert_eq!(solution.termination, TerminationReason::SmallDecrease);
        let all_looked_at = evaluations.get() == 1 + solution.iterations.len();
        assert_eq!(all_looked_at, looked_at);
        let rows = residuals(solution.x[0]);
        let cost: f64 = rows.iter().map(|(r, _)| r * r).sum();
        assert!((solution.cost - cost).abs() <= 1e-12 && (solution.x[0] - 2.0).abs() < 1e-4);
    }
}

#[test]
fn a_useless_parameter_does_not_stop_the_others() {
    let mut decay = Formula {
        n: 3,
        m: 20,
        blocks: 0,
        f: |x: &[f64]| {
            (0..20)
                .map(|i| {
                    let t = f64::from(i) * 0.1;
                    let e = (-x[1] * t).exp();
                    (x[0] * e - 3.0 * (-1.7 * t).exp(), vec![e, -t * x[0] * e, 0.0])
                })
                .collect()
        },
    };
    let solution = minimise(&mut decay, vec![1.0, 0.1, 5.0], &SolverOptions::default());
    assert!(solution.termination.converged());
    assert!((solution.x[0] - 3.0).abs() < 1e-9 && (solution.x[1] - 1.7).abs() < 1e-9);
    assert!((solution.x[2] - 5.0).abs() < 1e-12);
}

#[test]
fn a_start_at_the_minimum_ends_with_its_gradient() {
    let mut line = scalar(|x| vec![(x - 1.0, 1.0), (x + 1.0, 1.0)], 2);
    let solution = minimise(&mut line, vec![0.0], &SolverOptions::default());
    assert_eq!(solution.termination, TerminationReason::SmallGradient);
    assert!(solution.iterations.is_empty());
    assert_eq!(solution.cost, 2.0);
}

#[test]
fn the_iteration_limit_is_kept() {
    let options = SolverOptions { max_iterations: 3, ..SolverOptions::default() };
    let solution = minimise(&mut rosenbrock(), vec![-1.2, 1.0], &options);
    assert_eq!(solution.termination, TerminationReason::IterationLimit);
    assert_eq!((solution.iterations.len(), solution.minima), (3, 0));
}

/// Derivatives with the wrong sign: every step increases the cost, however short. Near the minimum this is only the limit of the accuracy.
#[test]
fn wrong_derivatives_are_no_convergence_unless_the_whole_step_is_small() {
    let mut uphill = scalar(|x| vec![(1.0, 0.0), (x, -1.0)], 2);
    let far = minimise(&mut uphill, vec![1.0], &SolverOptions::default());
    assert_eq!(far.termination, TerminationReason::NoDecrease);
    assert_eq!(far.x[0], 1.0);
    let near = minimise(&mut uphill, vec![1e-5], &SolverOptions::default());
    assert_eq!(near.termination, TerminationReason::SmallStep);
    assert_eq!(near.x[0], 1e-5);
}

/// Derivatives that are a million times too large: every step decreases the cost, but by next to nothing of the prediction.
#[test]
fn a_step_that_hardly_keeps_its_promise_is_not_taken() {
    let mut creeping = scalar(|x| vec![(1.0 - 1e-6 * x, -1.0), (1.0, 0.0)], 2);
    let solution = minimise(&mut creeping, vec![0.0], &SolverOptions::default());
    assert_eq!(solution.termination, TerminationReason::NoDecrease);
    assert!(solution.iterations.iter().all(|r| !r.accepted && r.gain < 1e-4));
    assert_eq!(solution.x, [0.0]);
}

/// At the level of rounding, where both the decrease and its prediction are noise, a fit still ends converged.
#[test]
fn rounding_is_no_failure() {
    for offset in [1.0, 1e3] {
        let mut line = Formula {
            n: 2,
            m: 40,
            blocks: 0,
            f: move |x: &[f64]| {
                (0..40)
                    .map(|i| {
                        let t = 0.1 * f64::from(i);
                        (
                            offset * (7.0 * t).sin() + x[0] + x[1] * t + (x[1] * t).sin(),
                            vec![1.0, t + t * (x[1] * t).cos()],
                        )
                    })
                    .collect()
            },
        };
        let solution = minimise(&mut line, vec![0.3, 0.2], &tight());
        assert!(solution.termination.converged(), "{offset}: {:?}", solution.termination);
    }
}

#[test]
fn numbers_that_are_not_end_the_search_with_their_reason() {
    for bad in [f64::NAN, f64::INFINITY] {
        let mut residual = scalar(|_| vec![(bad, 1.0)], 1);
        let solution = minimise(&mut residual, vec![1.0], &SolverOptions::default());
        assert_eq!(solution.termination, TerminationReason::NotFinite);
        let mut derivative = scalar(|_| vec![(1.0, bad)], 1);
        let solution = minimise(&mut derivative, vec![1.0], &SolverOptions::default());
        assert_eq!(solution.termination, TerminationReason::NotFinite);
    }
}

/// The first full step of a logarithm from 10 leads to where it has no value; that of the second function to where it has no derivative.
#[test]
fn a_step_into_what_is_not_a_number_is_rejected() {
    let mut logarithm = scalar(|x| vec![(x.ln(), 1.0 / x)], 1);
    let mut derivative = scalar(|x| if x > 0.0 { vec![(x.ln(), 1.0 / x)] } else { vec![(0.5, f64::NAN)] }, 1);
    for solution in [
        minimise(&mut logarithm, vec![10.0], &SolverOptions::default()),
        minimise(&mut derivative, vec![10.0], &SolverOptions::default()),
    ] {
        assert!(!solution.iterations[0].accepted);
        assert!(solution.termination.converged());
        assert!((solution.x[0] - 1.0).abs() < 1e-7);
    }
}

#[test]
fn a_plain_fit_takes_no_memory_for_what_is_not_asked() {
    let solution = minimise(&mut rosenbrock(), vec![-1.2, 1.0], &SolverOptions::default());
    assert_eq!((solution.weights.capacity(), solution.at_bound.capacity()), (0, 0));
}
