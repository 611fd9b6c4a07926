//! Compares with all possible designs.

use nalgebra::DMatrix;

use super::{random_rows, space, subsets};
use crate::planning::closed::Closed;
use crate::planning::{Choice, Criterion, DesignRows, DesignSpace, Over, PlanError, choose, grow};

/// Value of a criterion by its definition, from normal matrices alone.
fn value(criterion: Criterion, rows: &DesignRows, scale: &[f64], design: &[usize]) -> f64 {
    let p = scale.len();
    let scaled = |matrix: &DMatrix<f64>| matrix * DMatrix::from_diagonal(&scale.to_vec().into());
    let mut m = scaled(&rows.fixed).tr_mul(&scaled(&rows.fixed));
    for candidate in design {
        let own = scaled(&rows.candidates[*candidate]);
        m += own.tr_mul(&own);
    }
    let eigenvalues = m.clone().symmetric_eigenvalues();
    if eigenvalues.min() <= 1e-12 * eigenvalues.max() {
        return f64::INFINITY;
    }
    let mut sigma: Vec<f64> = eigenvalues.iter().map(|v| v.sqrt()).collect();
    sigma.sort_by(|a, b| b.total_cmp(a));
    let covariance = m.clone().try_inverse().expect("regular");
    let predicted = rows.region.iter().map(|g| (scaled(g) * &covariance * scaled(g).transpose()).trace());
    match criterion {
        Criterion::D => -m.determinant().ln() / p as f64,
        Criterion::A => covariance.trace(),
        Criterion::E => 1.0 / eigenvalues.min(),
        Criterion::G => predicted.fold(0.0, f64::max),
        Criterion::I => predicted.sum::<f64>() / rows.region.len() as f64,
        Criterion::O1 => (design.len() as f64).sqrt() / sigma.iter().product::<f64>().powf(1.0 / p as f64),
        Criterion::O2 => sigma[0] / sigma[p - 1],
        Criterion::O3 => 1.0 / sigma[p - 1],
        Criterion::O4 => sigma[0] / sigma[p - 1].powi(2),
        Criterion::O5 => sigma.iter().map(|s| 1.0 / s).sum(),
    }
}

fn least(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(f64::INFINITY, f64::min)
}

#[test]
fn every_criterion_finds_the_best_of_all_subsets() {
    let mut cases = 0;
    for (seed, prior, repeats) in [(1, true, false), (2, false, false), (3, true, true), (4, false, true)] {
        let rows = random_rows(seed, 9, 5, prior);
        let space = space(&rows);
        let all = subsets(0, 9, 4, repeats);
        assert_eq!(all.len(), if repeats { 495 } else { 126 });
        for criterion in Criterion::ALL {
            let choice = Choice { criterion, repeats, starts: 20, ..Choice::of(4) };
            let design = choose(std::slice::from_ref(&space), &choice).expect("a design");
            let best = least(all.iter().map(|design| value(criterion, &rows, space.scale(), design)));
            let own = value(criterion, &rows, space.scale(), &design.chosen);
            assert!(design.settled && design.starts.len() == 21 + criterion.like().len());
            for found in [own, design.value, design.figures.value(criterion).expect("a region")] {
                let off = (found - best) / best.abs();
                assert!(off.abs() < 1e-8, "{criterion:?} of {seed}: {found} for {best}");
            }
            cases += 1;
        }
    }
    assert_eq!(cases, 40);
}

#[test]
fn the_best_over_several_robots_is_that_of_all_subsets() {
    let rows: Vec<DesignRows> = (10..13).map(|seed| random_rows(seed, 9, 5, true)).collect();
    let spaces: Vec<DesignSpace> = rows.iter().map(space).collect();
    for over in [Over::Mean, Over::Worst] {
        for criterion in Criterion::ALL {
            let of_all = |design: &Vec<usize>| {
                let own = rows.iter().zip(&spaces);
                let values: Vec<f64> =
                    own.map(|(rows, space)| value(criterion, rows, space.scale(), design)).collect();
                match over {
                    Over::Mean => values.iter().sum::<f64>() / 3.0,
                    Over::Worst => values.into_iter().fold(f64::NEG_INFINITY, f64::max),
                }
            };
            // For O1 the mean is that of logarithms, as for D: the search is for the same poses.
            if criterion == Criterion::O1 && over == Over::Mean {
                continue;
            }
            let choice = Choice { criterion, over, starts: 20, ..Choice::of(4) };
            let design = choose(&spaces, &choice).expect("a design");
            let best = least(subsets(0, 9, 4, false).iter().map(of_all));
            let found = of_all(&design.chosen);
            assert!((found - best).abs() < 1e-8 * best.abs(), "{criterion:?} {over:?}: {found} for {best}");
            assert!((found - design.value).abs() < 1e-8 * best.abs());
        }
    }
}

/// Poses that are already measured count as if they had been chosen before.
#[test]
fn further_poses_are_the_best_beside_those_that_are_fixed() {
    let all = random_rows(21, 12, 5, false);
    let mut rows = all.clone();
    let measured = rows.candidates.split_off(9);
    rows.fixed = DMatrix::from_rows(
        &measured.iter().flat_map(|m| m.row_iter()).map(nalgebra::Matrix::into_owned).collect::<Vec<_>>(),
    );
    let space = space(&rows);
    for criterion in [Criterion::D, Criterion::A, Criterion::I, Criterion::E] {
        let choice = Choice { criterion, starts: 20, ..Choice::of(3) };
        let design = choose(std::slice::from_ref(&space), &choice).expect("a design");
        let with = |design: &[usize]| value(criterion, &all, space.scale(), &[design, &[9, 10, 11]].concat());
        let best = least(subsets(0, 9, 3, false).iter().map(|design| with(design)));
        assert!((with(&design.chosen) - best).abs() < 1e-8 * best.abs(), "{criterion:?}");
    }
}

/// Costs of all exchanges, and the results of many updates, compared with newly computed ones.
#[test]
fn exchanges_cost_what_they_cost_when_computed_anew() {
    for criterion in [Criterion::D, Criterion::A, Criterion::I] {
        let space = space(&random_rows(31, 14, 6, true));
        let mut closed = Closed::new(&space, space.linear(criterion));
        let mut anew = closed.clone();
        let mut design = vec![0, 3, 4, 8, 13];
        assert!(closed.refresh(&design));
        let mut costs = vec![0.0; 14];
        let mut bounds = costs.clone();
        let (mut compared, mut passed) = (0, 0);
        for step in 0..40 {
            let place = step % design.len();
            let leaving = design[place];
            closed.bounds_of_exchange(leaving, &mut bounds);
            let leaver = closed.leaver(leaving);
            for entering in (0..14).filter(|entering| *entering != leaving) {
                let cost = closed.cost_of_exchange(leaving, entering, &leaver);
                let mut other = design.clone();
                other[place] = entering;
                assert!(anew.refresh(&other));
                let off = (cost - anew.cost) / anew.cost.abs();
                assert!(off.abs() < 1e-9, "{criterion:?}: {cost} for {}", anew.cost);
                // A candidate that is skipped because of its bound is not better.
                let below = (cost - bounds[entering]) / anew.cost.abs();
                assert!(below > -1e-9, "{criterion:?}: {cost} is below {}", bounds[entering]);
                passed += usize::from(bounds[entering] > closed.cost);
                compared += 1;
            }
            closed.costs_of_entering(&mut costs);
            assert!(anew.refresh(&[design.as_slice(), &[step % 14]].concat()));
            assert!((costs[step % 14] - anew.cost).abs() < 1e-9 * anew.cost.abs());
            let entering = (leaving + 5 + step) % 14;
            assert!(closed.exchange(entering, leaving));
            design[place] = entering;
        }
        assert_eq!(compared, 40 * 13);
        assert!(passed > 50, "{criterion:?}: {passed} exchanges are passed over");
    }
}

/// The criteria that give the same designs.
#[test]
fn the_same_poses_by_d_and_o1_and_by_e_and_o3() {
    let space = space(&random_rows(41, 40, 6, true));
    let chosen = |criterion| {
        let choice = Choice { criterion, ..Choice::of(8) };
        choose(std::slice::from_ref(&space), &choice).expect("a design").chosen
    };
    assert_eq!(chosen(Criterion::D), chosen(Criterion::O1));
    assert_eq!(chosen(Criterion::E), chosen(Criterion::O3));
    assert_ne!(chosen(Criterion::D), chosen(Criterion::E));
}

#[test]
fn designs_grow_and_never_get_worse() {
    let mut rows = random_rows(51, 60, 6, false);
    rows.beside = vec![0.04; 4];
    let space = [space(&rows)];
    let choice = Choice::of(1);
    let counts: Vec<usize> = (4..=40).step_by(4).collect();
    let growth = grow(&space, &choice, &counts).expect("designs");
    assert_eq!(growth.points.iter().map(|point| point.count).collect::<Vec<_>>(), counts);
    for pair in growth.points.windows(2) {
        assert!(pair[1].value < pair[0].value);
    }
    for point in &growth.points {
        let figures = space[0].figures(&point.chosen).expect("regular");
        assert_eq!(figures.accuracy, Some(point.accuracy));
        let rms = point.accuracy.of_parameters.rms;
        assert!((rms * rms - point.value).abs() < 1e-12);
        let with = point.accuracy.with_machine.rms;
        assert!((with * with - rms * rms - 0.04).abs() < 1e-12);
        let alone = choose(&space, &Choice { starts: 5, ..Choice::of(point.count) }).expect("a design");
        assert!(point.value <= 1.05 * alone.value, "{}: {} for {}", point.count, point.value, alone.value);
    }
    assert!(growth.knee.is_some_and(|knee| knee > 4 && knee < 40));
    // For any number of poses only the machine's noise is left: the parameters are determined without a prior.
    assert!((growth.floor.with_machine.mean - 0.2).abs() < 1e-5);
    use crate::planning::Needed;
    let mean = |spread: &crate::planning::Spread| spread.mean;
    assert!(
        matches!(growth.needed(0.1, mean), Ok(Needed::BelowMachine { floor }) if (floor - 0.2).abs() < 1e-12)
    );
    assert!(matches!(growth.needed(0.2001, mean), Ok(Needed::MoreThan { count: 40, .. })));
    let at_20 = growth.points[4].accuracy.with_machine.mean;
    assert!(matches!(growth.needed(at_20, mean), Ok(Needed::Poses { count: 20, .. })));
    assert!(matches!(growth.needed(f64::NAN, mean), Err(PlanError::Number { .. })));
}

/// A direction that no candidate shows keeps the uncertainty of its prior.
#[test]
fn what_no_candidate_shows_is_a_floor() {
    let mut rows = random_rows(61, 20, 4, true);
    for candidate in &mut rows.candidates {
        candidate.column_mut(3).fill(0.0);
    }
    rows.fixed = DMatrix::identity(4, 4) * 2.0;
    rows.region = vec![DMatrix::from_row_slice(1, 4, &[0.0, 0.0, 0.0, 1.0])];
    let growth = grow(&[space(&rows)], &Choice::of(1), &[4, 6, 8]).expect("designs");
    assert!((growth.floor.of_parameters.mean - 0.5).abs() < 1e-9);
    let needed = growth.needed(0.4, |spread| spread.quantile_95);
    assert!(
        matches!(needed, Ok(crate::planning::Needed::BelowCandidates { floor }) if (floor - 0.5).abs() < 1e-9)
    );
    assert_eq!(growth.knee, None);
}
