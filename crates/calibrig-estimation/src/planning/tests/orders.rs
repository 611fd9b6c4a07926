//! Compares orders of poses with all possible ones.

use nalgebra::DMatrix;
use rand::RngExt;

use super::{drawn, random_rows, space};
use crate::planning::order::DriftCoupling;
use crate::planning::{OrderWeights, PlanError, Way, order_cost, ordered};
use calibrig_model::random::{StreamSource, stream};

fn orders(count: usize) -> Vec<Vec<usize>> {
    if count == 0 {
        return vec![Vec::new()];
    }
    let mut all = Vec::new();
    for shorter in orders(count - 1) {
        for place in 0..count {
            let mut order = shorter.clone();
            order.insert(place, count - 1);
            all.push(order);
        }
    }
    all
}

/// Commands, their coupling with drift, all rows as one matrix, and the effect of a shift on the rows of every pose.
type Eight = (Vec<Vec<f64>>, DriftCoupling, DMatrix<f64>, Vec<DMatrix<f64>>);

/// Eight poses whose rows are about four parameters and a shift.
fn eight(seed: u64) -> Eight {
    let mut rng = stream(seed, 1, StreamSource::Splits);
    let commands = (0..8).map(|_| (0..3).map(|_| rng.random_range(-1.0..1.0)).collect()).collect();
    let mut rows = random_rows(seed, 8, 4, true);
    rows.candidates = (0..8).map(|_| drawn(&mut rng, 3, 4)).collect();
    let shifts: Vec<_> = (0..8).map(|_| drawn(&mut rng, 3, 3)).collect();
    let space = space(&rows);
    let chosen: Vec<usize> = (0..8).collect();
    let coupling = DriftCoupling::new(&space, &chosen, &shifts.iter().collect::<Vec<_>>());
    // The system as one matrix.
    let whole = rows.candidates.iter().flat_map(|m| m.row_iter()).chain(rows.fixed.row_iter());
    let whole: Vec<_> = whole.map(nalgebra::Matrix::into_owned).collect();
    (commands, coupling, DMatrix::from_rows(&whole), shifts)
}

/// The terms of the cost by their definitions.
#[test]
fn the_cost_of_an_order_is_what_it_is_said_to_be() {
    let (commands, coupling, whole, shifts) = eight(5);
    let (speeds, home) = ([0.5, 2.0, 0.1], [0.1, 0.0, -0.2]);
    let weights = OrderWeights { balance: 7.0, drift: 11.0 };
    let way =
        Way { commands: &commands, home: Some(&home), speeds: &speeds, drift: Some(&coupling), weights };
    let order = [3, 1, 0, 7, 5, 6, 2, 4];
    let cost = order_cost(&way, &order).expect("an order");
    let mut at = home.to_vec();
    let (mut travel, mut signs) = (0.0, [0.0; 3]);
    for pose in order {
        let steps: Vec<f64> = commands[pose].iter().zip(&at).map(|(to, from)| to - from).collect();
        travel += steps.iter().zip(&speeds).map(|(step, speed)| step.abs() / speed).fold(0.0, f64::max);
        steps.iter().zip(&mut signs).for_each(|(step, sum)| *sum += step.signum());
        at.clone_from(&commands[pose]);
    }
    assert!((cost.travel - travel).abs() < 1e-12);
    let imbalance: f64 = signs.iter().map(|sum| (sum / 8.0_f64).powi(2)).sum();
    assert!((cost.imbalance - imbalance).abs() < 1e-12);
    // A least-squares fit to drifting readings absorbs H d of them.
    let hat = &whole * whole.tr_mul(&whole).try_inverse().expect("regular") * whole.transpose();
    let (mut taken, mut own) = (0.0, 0.0);
    for axis in 0..3 {
        let mut drift = DMatrix::zeros(whole.nrows(), 1);
        for (time, pose) in order.into_iter().enumerate() {
            let centred = time as f64 - 3.5;
            drift.view_mut((3 * pose, 0), (3, 1)).copy_from(&(shifts[pose].column(axis) * centred));
        }
        taken += drift.dot(&(&hat * &drift));
        own += drift.norm_squared();
    }
    assert!((cost.drift - taken / own).abs() < 1e-12 && cost.drift > 0.05 && cost.drift < 1.0);
    assert!((cost.total - travel - 7.0 * imbalance - 11.0 * taken / own).abs() < 1e-10);
}

#[test]
fn the_order_of_eight_poses_is_the_best_of_all() {
    let all = orders(8);
    assert_eq!(all.len(), 40320);
    for (seed, balance, drift) in
        [(1, 0.0, 0.0), (2, 10.0, 0.0), (3, 0.0, 20.0), (4, 5.0, 10.0), (5, 30.0, 30.0), (6, 1.0, 100.0)]
    {
        let (commands, coupling, ..) = eight(seed);
        let weights = OrderWeights { balance, drift };
        let home = [0.0; 3];
        let home = (seed % 2 == 0).then_some(home.as_slice());
        let way =
            Way { commands: &commands, home, speeds: &[0.2, 0.5, 0.5], drift: Some(&coupling), weights };
        let best = all.iter().map(|order| order_cost(&way, order).expect("an order").total);
        let best = best.fold(f64::INFINITY, f64::min);
        let found = ordered(&way).expect("an order");
        assert!(all.contains(&found.order));
        assert_eq!(found.cost, order_cost(&way, &found.order).expect("an order"));
        let off = found.cost.total / best - 1.0;
        eprintln!("seed {seed}: {:.3} s, best {best:.3} s", found.cost.total);
        assert!(off.abs() < 1e-9, "seed {seed}: {} for {best}", found.cost.total);
        assert_eq!(ordered(&way).expect("an order"), found);
    }
}

#[test]
fn approaches_are_signs_of_the_last_motion() {
    let commands = [vec![0.0, 1.0], vec![1.0, 1.0], vec![0.5, 0.0]];
    let weights = OrderWeights { balance: 0.0, drift: 0.0 };
    let way = Way { commands: &commands, home: Some(&[-1.0, 1.0]), speeds: &[1.0; 2], drift: None, weights };
    let ordered = ordered(&way).expect("an order");
    assert_eq!(ordered.order, [0, 1, 2]);
    assert_eq!(ordered.approaches, [[1, 0], [1, 0], [-1, -1]]);
    assert_eq!(ordered.cost.travel, 1.0 + 1.0 + 1.0);
    // (2 - 1)² / 9 for the first joint, one for the second, whose side is known once.
    assert!((ordered.cost.imbalance - 1.0 / 9.0 - 1.0).abs() < 1e-15);
}

/// Sixty poses: the order is better than the drawn one in every criterion.
#[test]
fn an_order_of_sixty_poses_is_shorter_and_balanced() {
    let mut rng = stream(9, 0, StreamSource::Splits);
    let commands: Vec<Vec<f64>> =
        (0..60).map(|_| (0..7).map(|_| rng.random_range(-1.0..1.0)).collect()).collect();
    let of = |balance| OrderWeights { balance, drift: 0.0 };
    let way = |balance| Way {
        commands: &commands,
        home: None,
        speeds: &[0.3; 7],
        drift: None,
        weights: of(balance),
    };
    let as_drawn = order_cost(&way(0.0), &(0..60).collect::<Vec<_>>()).expect("an order");
    let short = ordered(&way(0.0)).expect("an order");
    let both = ordered(&way(100.0)).expect("an order");
    eprintln!("{as_drawn:?}\n{:?}\n{:?}", short.cost, both.cost);
    assert!(short.cost.travel < 0.6 * as_drawn.travel);
    assert!(both.cost.total <= short.cost.travel + 100.0 * short.cost.imbalance);
    assert!(both.cost.imbalance < 0.05 && both.cost.travel < 0.7 * as_drawn.travel);
}

#[test]
fn what_cannot_be_put_in_order_is_refused() {
    let commands = [vec![0.0, 1.0], vec![1.0, 1.0]];
    let weights = OrderWeights { balance: 0.0, drift: 0.0 };
    let way = Way { commands: &commands, home: None, speeds: &[1.0; 2], drift: None, weights };
    let text = |way: &Way<'_>| ordered(way).expect_err("refused").to_string();
    assert_eq!(ordered(&Way { commands: &[], ..way }), Err(PlanError::NoPoses));
    assert!(text(&Way { speeds: &[1.0], ..way }).contains("speeds, one per joint: 1 entries, expected 2"));
    assert!(text(&Way { speeds: &[1.0, 0.0], ..way }).contains("speed of a joint is 0"));
    assert!(text(&Way { home: Some(&[0.0]), ..way }).contains("command"));
    assert!(text(&Way { home: Some(&[0.0, f64::NAN]), ..way }).contains("not a finite"));
    let weights = OrderWeights { balance: -1.0, drift: 0.0 };
    assert!(text(&Way { weights, ..way }).contains("balance"));
    let (_, coupling, ..) = eight(1);
    assert!(text(&Way { drift: Some(&coupling), ..way }).contains("drift"));
    assert!(order_cost(&way, &[0, 0]).is_err() && order_cost(&way, &[0]).is_err());
    assert!(order_cost(&way, &[0, 2]).is_err());
    assert_eq!(ordered(&Way { commands: &commands[..1], ..way }).expect("one").order, [0]);
}
