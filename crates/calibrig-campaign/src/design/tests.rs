use super::*;
use proptest::prelude::*;

const SAMPLINGS: [Sampling; 2] = [Sampling::Random, Sampling::Sobol];

fn values(point: &Point) -> Vec<f64> {
    let unit = |c: &Coordinate| match c {
        Coordinate::Unit(u) => *u,
        Coordinate::Level(level) => panic!("level {level} instead of a share"),
    };
    point.at.iter().map(unit).collect()
}

fn all(design: &Design, seed: u64) -> Vec<Point> {
    (0..design.trials()).map(|n| design.point(seed, n).expect("a trial")).collect()
}

fn plain(trials: u64, factors: usize, sampling: Sampling) -> Design {
    Design::Plain { trials, factors, sampling }
}

#[test]
fn a_plain_trial_is_its_draw_and_depends_on_seed_and_number_alone() {
    for sampling in SAMPLINGS {
        let (short, long) = (plain(10, 3, sampling), plain(1000, 5, sampling));
        for n in 0..10 {
            let point = short.point(7, n).expect("a trial");
            assert_eq!(u64::from(point.draw), n);
            // More trials and more factors leave what there was.
            assert_eq!(values(&point), values(&long.point(7, n).expect("a trial"))[..3]);
            assert_ne!(values(&point), values(&short.point(8, n).expect("a trial")));
        }
        assert_eq!(short.point(7, 10), None);
    }
    assert_eq!(plain(4, 0, Sampling::Random).point(1, 3), Some(Point { draw: 3, at: Vec::new() }));
}

/// Published results depend on these: to the bit.
#[test]
fn points_are_frozen() {
    let of = |design: &Design, n| values(&design.point(1, n).expect("a trial"));
    assert_eq!(of(&plain(9, 2, Sampling::Random), 4), [0.725_103_144_815_220_6, 0.046_948_266_217_576_97]);
    assert_eq!(
        of(&plain(70_000, 2, Sampling::Sobol), 66_000),
        [0.868_104_875_087_738, 0.801_245_629_787_445_1]
    );
    let screening = Design::Screening { trajectories: 3, factors: 4, levels: 6 };
    assert_eq!(of(&screening, 11), [7.0 / 12.0, 11.0 / 12.0, 1.0 / 12.0, 0.75]);
    assert_eq!(screening.step(1, 11), Some(Step { factor: 3, change: 0.5 }));
}

/// Every power of two of a Sobol sequence has one point in each of as many equal parts of every axis; so has the next block.
#[test]
fn sobol_points_are_stratified() {
    let design = plain(1 << 17, 4, Sampling::Sobol);
    for first in [0, 1 << 16] {
        for count in [16_u64, 256, 1024] {
            for dimension in 0..4 {
                let mut seen = vec![false; count as usize];
                for n in first..first + count {
                    let u = values(&design.point(3, n).expect("a trial"))[dimension];
                    assert!(u > 0.0 && u < 1.0);
                    let cell = &mut seen[(u * count as f64) as usize];
                    assert!(!std::mem::replace(cell, true), "two points of {count} in one part");
                }
            }
        }
    }
    let of = |n| design.point(3, n).expect("a trial").at;
    assert_ne!(of(0), of(1 << 16));
}

/// The mean of a smooth function over 2^10 points: of independent ones, off by its deviation over 32; of Sobol's, a hundred times nearer (measured:
/// some 1e-5).
#[test]
fn sobol_points_integrate_better_than_random_ones() {
    let error = |sampling| {
        let points = all(&plain(1 << 10, 4, sampling), 5);
        let value = |p: &Point| values(p).iter().map(|u| u * u).product::<f64>() * 81.0;
        points.iter().map(value).sum::<f64>() / 1024.0 - 1.0
    };
    let deviation = (1.8_f64.powi(4) - 1.0).sqrt() / 32.0;
    assert!(error(Sampling::Random).abs() < 4.0 * deviation);
    assert!(error(Sampling::Sobol).abs() < 0.04 * deviation, "{:e}", error(Sampling::Sobol));
}

/// Means and correlations of independent uniform numbers, each within 4.5 standard deviations.
#[test]
fn random_points_are_uniform_and_independent() {
    let n = 20_000.0_f64;
    let points: Vec<_> = all(&plain(20_000, 3, Sampling::Random), 11).iter().map(values).collect();
    for i in 0..3 {
        let mean = points.iter().map(|p| p[i] - 0.5).sum::<f64>() / n;
        assert!(mean.abs() < 4.5 * (1.0 / 12.0 / n).sqrt());
        for j in 0..i {
            let product = points.iter().map(|p| (p[i] - 0.5) * (p[j] - 0.5)).sum::<f64>() / n;
            assert!(product.abs() < 4.5 / 12.0 / n.sqrt());
        }
    }
}

#[test]
fn a_sweep_is_every_combination_with_common_draws() {
    let design = Design::Sweep { levels: vec![2, 3], repeats: 4 };
    assert_eq!(design.trials(), 24);
    let mut expected = Vec::new();
    for first in 0..2 {
        for second in 0..3 {
            for draw in 0..4 {
                expected.push(Point { draw, at: vec![Coordinate::Level(first), Coordinate::Level(second)] });
            }
        }
    }
    assert_eq!(all(&design, 1), expected);
    assert_eq!(
        Design::Sweep { levels: vec![5], repeats: 2 }.point(1, 9).expect("the last").at,
        [Coordinate::Level(4)]
    );
}

#[test]
fn rows_of_the_base_swap_one_factor_at_a_time() {
    for (sampling, draws) in SAMPLINGS.into_iter().flat_map(|s| [(s, false), (s, true)]) {
        let design = Design::Indices { base: 5, factors: 3, draws, sampling };
        let k = 3 + usize::from(draws);
        assert_eq!((design.trials(), design.group()), (5 * (k as u64 + 2), k as u64 + 2));
        let points = all(&design, 9);
        for (j, rows) in points.chunks_exact(k + 2).enumerate() {
            let (a, b) = (values(&rows[0]), values(&rows[1]));
            assert!(a.iter().zip(&b).all(|(a, b)| a != b));
            let number = |of_b: bool| if draws { 2 * j as u32 + u32::from(of_b) } else { 0 };
            assert_eq!((rows[0].draw, rows[1].draw), (number(false), number(true)));
            for (i, point) in rows[2..].iter().enumerate() {
                let mut swapped = a.clone();
                if let Some(value) = swapped.get_mut(i) {
                    *value = b[i];
                }
                assert_eq!((values(point), point.draw), (swapped, number(i == 3)));
            }
        }
    }
}

#[test]
fn a_trajectory_moves_every_factor_once_by_half_a_range() {
    let (factors, levels) = (5, 6);
    let design = Design::Screening { trajectories: 200, factors, levels };
    assert_eq!(design.trials(), 1200);
    let mut starts = vec![[0_u32; 6]; factors];
    let mut first_moves = vec![0_u32; factors];
    for (trajectory, points) in all(&design, 2).chunks_exact(factors + 1).enumerate() {
        let mut moved = vec![false; factors];
        let number = trajectory as u64 * (factors as u64 + 1);
        assert_eq!(design.step(2, number), None);
        for (i, u) in values(&points[0]).into_iter().enumerate() {
            let level = u * levels as f64 - 0.5;
            assert!((level - level.round()).abs() < 1e-12);
            starts[i][level.round() as usize] += 1;
        }
        for (s, pair) in points.windows(2).enumerate() {
            let step = design.step(2, number + s as u64 + 1).expect("a step");
            if s == 0 {
                first_moves[step.factor] += 1;
            }
            assert!(!std::mem::replace(&mut moved[step.factor], true));
            for (i, (from, to)) in values(&pair[0]).iter().zip(values(&pair[1])).enumerate() {
                let change = if i == step.factor { step.change } else { 0.0 };
                assert!((to - from - change).abs() < 1e-15);
            }
            assert_eq!((pair[0].draw, pair[1].draw), (trajectory as u32, trajectory as u32));
        }
        assert_eq!(moved, vec![true; factors]);
    }
    // Of 200, a sixth or a fifth each: 33 and 40, within four deviations of 5.3 and 5.7.
    assert!(starts.iter().flatten().all(|count| (12..=55).contains(count)), "{starts:?}");
    assert!(first_moves.iter().all(|count| (17..=63).contains(count)), "{first_moves:?}");
    assert_eq!(plain(3, 1, Sampling::Random).step(1, 1), None);
}

#[test]
fn impossible_designs_are_refused_and_have_no_points() {
    let refused = |design: Design, message: &str| {
        assert_eq!(design.check().expect_err("refused").to_string(), message);
        assert_eq!((design.point(1, 0), design.step(1, 1)), (None, None));
    };
    refused(plain(0, 1, Sampling::Random), "the number of trials is 0; there must be at least one");
    refused(
        plain(1 << 33, 1, Sampling::Random),
        "the study has 8589934592 draws; at most 4294967296 are possible",
    );
    refused(plain(1, 257, Sampling::Sobol), "257 factors vary; this design takes at most 256");
    let sweep = |levels: &[usize], repeats| Design::Sweep { levels: levels.to_vec(), repeats };
    refused(sweep(&[2, 0], 3), "the number of levels of a factor is 0; there must be at least one");
    refused(sweep(&[2], 0), "the number of repeats is 0; there must be at least one");
    refused(sweep(&[], 3), "the sweep is over 0 factors; it can be over one or two");
    refused(sweep(&[2, 2, 2], 3), "the sweep is over 3 factors; it can be over one or two");
    refused(
        sweep(&[usize::MAX, usize::MAX], 3),
        "the study has more trials than can be counted; use fewer draws or fewer factors",
    );
    let indices = |base, factors, draws| Design::Indices { base, factors, draws, sampling: Sampling::Sobol };
    refused(indices(0, 2, true), "the number of rows of the base design is 0; there must be at least one");
    refused(indices(9, 0, true), "the number of factors is 0; there must be at least one");
    refused(indices(9, 129, true), "129 factors vary; this design takes at most 128");
    refused(indices(1 << 32, 2, true), "the study has 8589934592 draws; at most 4294967296 are possible");
    assert_eq!(indices(1 << 31, 2, true).check(), Ok(()));
    let screening = |trajectories, factors, levels| Design::Screening { trajectories, factors, levels };
    refused(
        screening(3, 2, 1 << 17),
        "a screening has 131072 levels; it needs an even number of at most 65536, such as 4",
    );
    refused(
        screening(3, 2, 5),
        "a screening has 5 levels; it needs an even number of at most 65536, such as 4",
    );
    refused(screening(3, 2, 0), "the number of levels is 0; there must be at least one");
    refused(screening(0, 2, 4), "the number of trajectories is 0; there must be at least one");
    refused(screening(3, 0, 4), "the number of factors is 0; there must be at least one");
}

proptest! {
    /// Whatever a manifest holds, nothing panics, and a point is there exactly where the design is sound and the number below its trials.
    #[test]
    fn points_are_there_for_sound_designs(
        kind in 0..4, count in any::<u64>(), small in 0_u64..5, a in 0_usize..300, b in any::<usize>(), n in any::<u64>(), flag: bool
    ) {
        let count = if flag { small } else { count };
        let sampling = SAMPLINGS[usize::from(flag)];
        let design = match kind {
            0 => Design::Plain { trials: count, factors: a, sampling },
            1 => Design::Sweep { levels: if flag { vec![a, b % 7] } else { vec![b] }, repeats: count },
            2 => Design::Indices { base: count, factors: a, draws: n % 2 == 0, sampling },
            _ => Design::Screening { trajectories: count, factors: a, levels: b },
        };
        for n in [0, n % design.trials().max(1), n] {
            let point = design.point(n, n);
            prop_assert_eq!(point.is_some(), design.check().is_ok() && n < design.trials());
            if let Some(point) = point {
                let drawn = usize::from(matches!(design, Design::Indices { draws: true, .. }));
                prop_assert_eq!(point.at.len() + drawn, design.factors());
            }
        }
        let text = serde_json::to_string(&design).expect("plain numbers");
        prop_assert_eq!(serde_json::from_str::<Design>(&text).expect("as written"), design);
    }
}
