use super::*;

/// Four minima: (x² - 1)² + (y² - 4)².
fn wells() -> Formula<impl FnMut(&[f64]) -> Rows> {
    let f = |x: &[f64]| {
        vec![(x[0] * x[0] - 1.0, vec![2.0 * x[0], 0.0]), (x[1] * x[1] - 4.0, vec![0.0, 2.0 * x[1]])]
    };
    Formula { n: 2, m: 2, blocks: 0, f }
}

/// A sine of unknown frequency, whose cost has a minimum near every number of periods that fits.
fn sine() -> Formula<impl FnMut(&[f64]) -> Rows> {
    let f = |x: &[f64]| {
        (0..60)
            .map(|i| {
                let t = 0.1 * f64::from(i);
                ((x[0] * t).sin() - (5.0 * t).sin(), vec![t * (x[0] * t).cos()])
            })
            .collect()
    };
    Formula { n: 1, m: 60, blocks: 0, f }
}

fn options(starts: u32) -> SolverOptions {
    SolverOptions { starts, seed: 3, ..SolverOptions::default() }
}

#[test]
fn distinct_minima_are_counted() {
    let find = |starts, bounds: &Bounds| {
        minimise_within(&mut wells(), vec![0.5, 0.5], &options(starts), bounds, &[3.0, 3.0]).unwrap().minima
    };
    assert_eq!(find(1, &Bounds::none(2)), 1);
    assert_eq!(find(50, &Bounds::none(2)), 4);
    let half = Bounds::new(vec![0.1, f64::NEG_INFINITY], vec![f64::INFINITY; 2]).unwrap();
    assert_eq!(find(50, &half), 2);
}

/// A parameter that nothing determines does not create new minima.
#[test]
fn a_flat_valley_is_one_minimum() {
    let mut sum = Formula {
        n: 2,
        m: 2,
        blocks: 0,
        f: |x: &[f64]| vec![(x[0] + x[1] - 3.0, vec![1.0, 1.0]), (1.0, vec![0.0, 0.0])],
    };
    let found =
        minimise_within(&mut sum, vec![0.0, 0.0], &options(20), &Bounds::none(2), &[5.0, 5.0]).unwrap();
    assert_eq!(found.minima, 1);
    assert!((found.cost - 1.0).abs() < 1e-12);
}

#[test]
fn several_starts_find_the_lowest_and_repeat_to_the_bit() {
    let alone = minimise(&mut sine(), vec![2.0], &options(1));
    assert!(alone.cost > 10.0, "{}", alone.cost);
    let many = || minimise_within(&mut sine(), vec![2.0], &options(30), &Bounds::none(1), &[6.0]).unwrap();
    let found = many();
    assert!((found.x[0].abs() - 5.0).abs() < 1e-6 && found.cost < 1e-10);
    assert!(found.minima > 3, "{}", found.minima);
    assert_eq!(found.x, many().x);
    let other = SolverOptions { seed: 4, ..options(30) };
    let other = minimise_within(&mut sine(), vec![2.0], &other, &Bounds::none(1), &[6.0]).unwrap();
    assert!((other.x[0].abs() - 5.0).abs() < 1e-6);
}

/// More starts never end at a higher cost: the first ones are the same.
#[test]
fn a_start_does_not_depend_on_how_many_there_are() {
    let mut last = f64::INFINITY;
    for starts in 1..20 {
        let found =
            minimise_within(&mut sine(), vec![2.0], &options(starts), &Bounds::none(1), &[6.0]).unwrap();
        assert!(found.cost <= last, "{starts}");
        last = found.cost;
    }
}

#[test]
fn where_no_start_converges_the_lowest_cost_is_returned_as_it_is() {
    let options = SolverOptions { max_iterations: 1, ..options(10) };
    let found = minimise_within(&mut sine(), vec![2.0], &options, &Bounds::none(1), &[6.0]).unwrap();
    assert_eq!((found.termination, found.minima), (TerminationReason::IterationLimit, 0));
    let alone = minimise(&mut sine(), vec![2.0], &options);
    assert!(found.cost < alone.cost);
}

/// Starts where the function has no value are skipped.
#[test]
fn starts_without_a_cost_do_no_harm() {
    let mut logarithm = Formula { n: 1, m: 1, blocks: 0, f: |x: &[f64]| vec![(x[0].ln(), vec![1.0 / x[0]])] };
    let found = minimise_within(&mut logarithm, vec![2.0], &options(20), &Bounds::none(1), &[10.0]).unwrap();
    assert!((found.x[0] - 1.0).abs() < 1e-6);
    assert_eq!(found.minima, 1);
}

/// Two minima; the one with the smaller rows has the larger part beside them.
struct Beside {
    now: f64,
}

impl LeastSquares for Beside {
    fn parameters(&self) -> usize {
        1
    }

    fn rows(&self) -> usize {
        2
    }

    fn beside(&self) -> f64 {
        if self.now > 0.0 { 1.0 } else { 0.0 }
    }

    fn evaluate(&mut self, x: &[f64], residuals: &mut DVector<f64>, jacobian: Option<&mut DMatrix<f64>>) {
        self.now = x[0];
        residuals.copy_from_slice(&[x[0] * x[0] - 1.0, 0.1 * (x[0] - 1.0)]);
        if let Some(jacobian) = jacobian {
            jacobian.copy_from_slice(&[2.0 * x[0], 0.1]);
        }
    }
}

/// The cost of two minima includes the part that is in no row.
#[test]
fn minima_are_compared_with_what_no_row_holds() {
    for start in [0.9, -0.9] {
        let mut problem = Beside { now: 0.0 };
        let found =
            minimise_within(&mut problem, vec![start], &options(20), &Bounds::none(1), &[2.0]).unwrap();
        assert_eq!(found.minima, 2);
        assert!(found.x[0] < -0.9 && found.cost < 0.05, "{} at {}", found.cost, found.x[0]);
        let other = minimise(&mut problem, vec![0.9], &options(1));
        assert!(other.cost > 0.99 && other.cost - other.beside < 1e-12, "{}", other.cost);
    }
}

#[test]
fn starts_need_a_width_for_every_parameter() {
    let spread = |spread: &[f64]| {
        minimise_within(&mut wells(), vec![0.5, 0.5], &options(2), &Bounds::none(2), spread).map(|_| ())
    };
    assert_eq!(spread(&[]), Err(BoundsError::Length { what: "widths of the starts", found: 0, expected: 2 }));
    assert_eq!(spread(&[1.0, -1.0]), Err(BoundsError::Spread { parameter: 1, spread: -1.0 }));
    assert_eq!(
        spread(&[f64::INFINITY, 1.0]),
        Err(BoundsError::Spread { parameter: 0, spread: f64::INFINITY })
    );
    assert_eq!(spread(&[0.0, 1.0]), Ok(()));
}

/// Start k is drawn from the counted stream of (seed, k), whatever else is drawn.
#[test]
fn starts_are_drawn_from_their_counted_streams() {
    use calibrig_model::random::{StreamSource, stream};
    use rand::RngExt;

    let tried = std::cell::RefCell::new(Vec::new());
    let mut flat = Formula {
        n: 2,
        m: 2,
        blocks: 0,
        f: |x: &[f64]| {
            tried.borrow_mut().push(x.to_vec());
            vec![(1.0, vec![0.0, 0.0]), (1.0, vec![0.0, 0.0])]
        },
    };
    minimise_within(&mut flat, vec![1.0, 2.0], &options(4), &Bounds::none(2), &[0.5, 0.25]).unwrap();
    let expected = (1..4).map(|k| {
        let mut random = stream(3, k, StreamSource::SolverStarts);
        [(1.0, 0.5), (2.0, 0.25)].map(|(x, spread)| x + spread * random.random_range(-1.0..=1.0)).to_vec()
    });
    let expected: Vec<_> = std::iter::once(vec![1.0, 2.0]).chain(expected).collect();
    assert_eq!(*tried.borrow(), expected);
}
