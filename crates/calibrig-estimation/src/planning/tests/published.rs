//! Compares with known designs, and with the approximate optimum.

use nalgebra::{DMatrix, DVector};

use super::{names, random_rows};
use crate::planning::{Choice, Criterion, Design, DesignRows, DesignSpace, ParameterScale, choose};

/// A space of single rows in their own units, with nothing fixed.
fn of_rows(rows: &[Vec<f64>]) -> DesignSpace {
    let p = rows[0].len();
    let candidates: Vec<_> = rows.iter().map(|row| DMatrix::from_row_slice(1, p, row)).collect();
    let rows = DesignRows {
        region: candidates.clone(),
        candidates,
        fixed: DMatrix::zeros(0, p),
        beside: Vec::new(),
    };
    DesignSpace::new(names(p), &rows, &ParameterScale::Given(vec![1.0; p])).expect("a space")
}

fn chosen(space: &DesignSpace, criterion: Criterion, count: usize) -> Design {
    let choice = Choice { criterion, repeats: true, starts: 10, ..Choice::of(count) };
    choose(std::slice::from_ref(space), &choice).expect("a design")
}

fn grid(steps: i32) -> Vec<f64> {
    (-steps..=steps).map(|i| f64::from(i) / f64::from(steps)).collect()
}

/// D-optimal weights of a polynomial are equal at the roots of (1 - x²) P'(x) (P. G. Hoel, Ann. Math. Statist. 29 (1958) 1134; P. G. Guest, ibid.
/// 294).
#[test]
fn polynomials_are_measured_at_the_roots_of_legendres_derivative() {
    let points = grid(20);
    let quadratic = of_rows(&points.iter().map(|x| vec![1.0, *x, x * x]).collect::<Vec<_>>());
    let design = chosen(&quadratic, Criterion::D, 6);
    let at: Vec<f64> = design.chosen.iter().map(|i| points[*i]).collect();
    assert_eq!(at, [-1.0, -1.0, 0.0, 0.0, 1.0, 1.0]);
    // det = 4 n1 n2 n3: 32 for six, and 8 for four.
    assert!((design.figures.log_determinant - 32.0_f64.ln()).abs() < 1e-10);
    assert!((chosen(&quadratic, Criterion::D, 4).figures.log_determinant - 8.0_f64.ln()).abs() < 1e-10);
    // G over the candidates gives the design of D (J. Kiefer, J. Wolfowitz, Canad. J. Math. 12 (1960) 363): the largest variance is p / n.
    let design = chosen(&quadratic, Criterion::G, 6);
    assert!((design.value - 0.5).abs() < 1e-10, "{}", design.value);

    let points = grid(500);
    let cubic = of_rows(&points.iter().map(|x| vec![1.0, *x, x * x, x * x * x]).collect::<Vec<_>>());
    let design = chosen(&cubic, Criterion::D, 4);
    let at: Vec<f64> = design.chosen.iter().map(|i| points[*i]).collect();
    for (found, expected) in at.iter().zip([-1.0, -0.2_f64.sqrt(), 0.2_f64.sqrt(), 1.0]) {
        assert!((found - expected).abs() <= 0.001, "{at:?}");
    }
}

/// First-order designs: the full factorial 2³ and its half.
#[test]
fn factors_are_measured_at_the_corners_of_their_cube() {
    let levels = [-1.0, 0.0, 1.0];
    let points: Vec<[f64; 3]> =
        levels.iter().flat_map(|a| levels.iter().flat_map(move |b| levels.map(|c| [*a, *b, c]))).collect();
    let space = of_rows(&points.iter().map(|x| vec![1.0, x[0], x[1], x[2]]).collect::<Vec<_>>());
    for (count, all_corners) in [(8, true), (4, false)] {
        let design = chosen(&space, Criterion::D, count);
        // Orthogonal: M = n 1.
        let expected = 4.0 * (count as f64).ln();
        assert!((design.figures.log_determinant - expected).abs() < 1e-10);
        assert!(design.chosen.iter().all(|i| points[*i].iter().all(|x| x.abs() == 1.0)));
        let mut apart = design.chosen.clone();
        apart.dedup();
        assert!(!all_corners || apart.len() == 8 || design.figures.observability.o2 > 1.0 - 1e-12);
    }
}

/// Weights of the approximate D-optimum by the multiplicative algorithm (S. D. Silvey, D. M. Titterington, B. Torsney, Comm. Statist. A 7 (1978)
/// 1379), and an upper bound of the missing determinant (Kiefer and Wolfowitz): an independent algorithm.
fn approximate(candidates: &[DMatrix<f64>], p: usize) -> (Vec<f64>, f64, f64) {
    let mut weights = vec![1.0 / candidates.len() as f64; candidates.len()];
    let mut gap = f64::INFINITY;
    let mut log_determinant = 0.0;
    for _ in 0..200_000 {
        let mut m = DMatrix::zeros(p, p);
        for (weight, rows) in weights.iter().zip(candidates) {
            m += rows.tr_mul(rows) * *weight;
        }
        log_determinant = m.determinant().ln();
        let covariance = m.try_inverse().expect("regular");
        let variances = DVector::from_iterator(
            candidates.len(),
            candidates.iter().map(|rows| (rows * &covariance * rows.transpose()).trace()),
        );
        gap = variances.max() - p as f64;
        if gap < 1e-6 {
            break;
        }
        for (weight, variance) in weights.iter_mut().zip(variances.iter()) {
            *weight *= variance / p as f64;
        }
    }
    (weights, log_determinant, gap)
}

/// The full quadratic model of two factors on the 3 x 3 grid: the best nine points are the grid itself, with a D-efficiency of 97.4 % (G. E. P. Box,
/// N. R. Draper, Technometrics 13 (1971) 731; Atkinson, Donev and Tobias 2007, section 12.2).
#[test]
fn the_second_order_design_of_nine_points_is_the_grid() {
    let levels = [-1.0, 0.0, 1.0];
    let points: Vec<[f64; 2]> = levels.iter().flat_map(|a| levels.map(|b| [*a, b])).collect();
    let rows: Vec<Vec<f64>> = points.iter().map(|[a, b]| vec![1.0, *a, *b, a * b, a * a, b * b]).collect();
    let candidates: Vec<_> = rows.iter().map(|row| DMatrix::from_row_slice(1, 6, row)).collect();
    let (weights, optimum, gap) = approximate(&candidates, 6);
    assert!(gap < 1e-6);
    // Corner, side, centre.
    for (place, expected) in [(0, 0.1458), (1, 0.0802), (4, 0.0962)] {
        assert!((weights[place] - expected).abs() < 1e-4, "{weights:?}");
    }
    let space = of_rows(&rows);
    let design = chosen(&space, Criterion::D, 9);
    assert_eq!(design.chosen, (0..9).collect::<Vec<_>>());
    let efficiency = ((design.figures.log_determinant - optimum) / 6.0).exp() / 9.0;
    assert!((efficiency - 0.974).abs() < 5e-4, "{efficiency}");
}

/// Blocks of several rows: no exact design is better than the approximate optimum, and one with many poses is nearly as good.
#[test]
fn blocks_reach_the_approximate_optimum() {
    let rows = random_rows(71, 60, 6, false);
    let (_, optimum, gap) = approximate(&rows.candidates, 6);
    let space = DesignSpace::new(names(6), &rows, &ParameterScale::Given(vec![1.0; 6])).expect("a space");
    let bound = gap / 6.0;
    for (count, least) in [(6, 0.85), (12, 0.95), (40, 0.995)] {
        let design = chosen(&space, Criterion::D, count);
        let efficiency = ((design.figures.log_determinant - optimum) / 6.0).exp() / count as f64;
        eprintln!("{count} poses: D-efficiency {efficiency:.4}");
        assert!(efficiency <= 1.0 + bound + 1e-9 && efficiency > least, "{count}: {efficiency}");
    }
}
