//! Orders poses: little driving, both directions of approach for every joint, and no parameter correlated with time.

use nalgebra::DMatrix;
use rand::seq::SliceRandom;
use serde::{Deserialize, Serialize};

use super::{DesignSpace, PlanError};
use calibrig_model::random::{StreamSource, stream};

/// Longest piece that is moved as a whole (I. Or, 1976).
const LONGEST_PIECE: usize = 3;
/// Numbers of poses from which nearest-neighbour orders are begun, and of shuffled orders.
const NEAREST_STARTS: usize = 8;
const SHUFFLED_STARTS: u32 = 4;
const MOST_PASSES: usize = 200;
/// Least improvement, as a share of the cost.
const LEAST_GAIN: f64 = 1e-12;

/// Weights of an order's criteria beside the time of driving, s.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct OrderWeights {
    /// Cost of the [imbalance](OrderCost::imbalance) of one joint that is always approached from the same side, s.
    pub balance: f64,
    /// Cost of a drift that the parameters would absorb [completely](OrderCost::drift), s.
    pub drift: f64,
}

/// Poses to put in order, and how the robot moves between them: all joints at once, each at its speed.
#[derive(Debug, Clone, Copy)]
pub struct Way<'a> {
    /// Commands of the poses, m or rad.
    pub commands: &'a [Vec<f64>],
    /// Command from which the robot comes; if `None`, it begins at the first pose.
    pub home: Option<&'a [f64]>,
    /// Speed of every joint, m/s or rad/s: the slower a joint, such as a rail, the more it counts.
    pub speeds: &'a [f64],
    /// Coupling of the poses, in their order here, with drift.
    pub drift: Option<&'a DriftCoupling>,
    /// Weights of the criteria beside driving.
    pub weights: OrderWeights,
}

/// Cost of an order.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct OrderCost {
    /// Time of driving, s: the sum over all moves of the time that the slowest joint needs.
    pub travel: f64,
    /// Sum over the joints of ((n₊ - n₋) / (n₊ + n₋))², with the numbers of poses that each joint approaches from either side. A joint that does not
    /// move keeps its last side.
    pub imbalance: f64,
    /// Share of a drift (a displacement of the base along each axis that grows with time, measured at equal intervals) that the parameters of a fit
    /// would absorb, 0 to 1: how strongly time is correlated with them. Zero where no coupling is given.
    pub drift: f64,
    /// `travel + balance · imbalance + drift weight · drift`, s.
    pub total: f64,
}

/// Poses in an order.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Ordered {
    /// Indices of the given poses, in their order.
    pub order: Vec<usize>,
    /// Cost of the order.
    pub cost: OrderCost,
    /// Signs of the last motion of every joint at the poses in this order; 0 where it has not moved.
    pub approaches: Vec<Vec<i8>>,
}

/// Coupling between drift in time and the parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct DriftCoupling {
    /// `Σ_c a_icᵀ H_ik a_kc`, with the block of the hat matrix for two poses and the effect of a shift along axis c on their rows.
    taken_up: DMatrix<f64>,
    /// `Σ_c a_icᵀ a_ic`.
    own: Vec<f64>,
}

impl DriftCoupling {
    /// The coupling of chosen poses; `shifts` is the effect of a shift on the rows of each, r x 3.
    pub(super) fn new(space: &DesignSpace, chosen: &[usize], shifts: &[&DMatrix<f64>]) -> Self {
        let factor = space.factor(chosen.iter().copied(), false);
        // R⁻ᵀ of the rows times the shifts; the inner products of these are the coupling.
        let spread = |(candidate, shift): (&usize, &&DMatrix<f64>)| {
            let rows = space.block(*candidate) * *shift;
            let solved = factor.tr_solve_upper_triangular(&rows).unwrap_or(rows);
            DMatrix::from_column_slice(solved.len(), 1, solved.as_slice())
        };
        let columns: Vec<_> = chosen.iter().zip(shifts).map(spread).collect();
        let taken_up = DMatrix::from_fn(columns.len(), columns.len(), |i, k| columns[i].dot(&columns[k]));
        Self { taken_up, own: shifts.iter().map(|shift| shift.norm_squared()).collect() }
    }

    /// Share of the drift for poses in an order.
    fn share(&self, order: &[usize]) -> f64 {
        let n = order.len();
        let time = |place: usize| 2.0 * place as f64 - (n as f64 - 1.0);
        let (mut above, mut below) = (0.0, 0.0);
        for (i, pose) in order.iter().enumerate() {
            let column = self.taken_up.column(*pose);
            let sum: f64 = order.iter().enumerate().map(|(k, other)| time(k) * column[*other]).sum();
            above += time(i) * sum;
            below += time(i).powi(2) * self.own[*pose];
        }
        if below > 0.0 { above / below } else { 0.0 }
    }
}

/// Puts poses in an order of low cost: from several beginnings, pieces are reversed (2-opt: G. A. Croes, Operations Research 6 (1958) 791) and moved
/// elsewhere (Or-opt) as long as that helps. The same poses always get the same order; a better one may exist.
///
/// # Errors
///
/// [`PlanError`], without poses, for lists that do not have one number per joint, and for numbers out of their range.
pub fn ordered(way: &Way<'_>) -> Result<Ordered, PlanError> {
    check(way)?;
    let search = OrderSearch::new(way);
    let mut best: Option<(f64, Vec<usize>)> = None;
    for mut order in search.beginnings() {
        let cost = search.improve(&mut order);
        if best.as_ref().is_none_or(|(least, _)| cost < *least) {
            best = Some((cost, order));
        }
    }
    let (_, order) = best.ok_or(PlanError::NoPoses)?;
    Ok(Ordered { cost: search.cost(&order), approaches: search.approaches(&order), order })
}

/// The cost of poses in a given `order` (indices, each once).
///
/// # Errors
///
/// As [`ordered`], and for a list that is not an order of the poses.
pub fn order_cost(way: &Way<'_>, order: &[usize]) -> Result<OrderCost, PlanError> {
    check(way)?;
    let mut sorted = order.to_vec();
    sorted.sort_unstable();
    if !sorted.iter().copied().eq(0..way.commands.len()) {
        let what = "the order, every pose once".to_owned();
        return Err(PlanError::Length { what, found: order.len(), expected: way.commands.len() });
    }
    Ok(OrderSearch::new(way).cost(order))
}

fn check(way: &Way<'_>) -> Result<(), PlanError> {
    let first = way.commands.first().ok_or(PlanError::NoPoses)?;
    let joints = first.len();
    let length = |what: &str, found: usize, expected: usize| {
        if found == expected {
            return Ok(());
        }
        Err(PlanError::Length { what: what.to_owned(), found, expected })
    };
    length("the speeds, one per joint", way.speeds.len(), joints)?;
    for command in way.commands.iter().map(Vec::as_slice).chain(way.home) {
        length("a command to put in order", command.len(), joints)?;
        if !command.iter().all(|v| v.is_finite()) {
            return Err(PlanError::NotFinite { what: "a command to put in order".to_owned() });
        }
    }
    if let Some(drift) = way.drift {
        length("the coupling with drift, one per pose", drift.own.len(), way.commands.len())?;
    }
    if let Some(value) = way.speeds.iter().copied().find(|speed| !(*speed > 0.0 && speed.is_finite())) {
        let field = "the speed of a joint";
        return Err(PlanError::Number { field, value, expected: "a finite number above zero" });
    }
    for (field, value) in
        [("the weight of balance", way.weights.balance), ("the weight of drift", way.weights.drift)]
    {
        if !(value >= 0.0 && value.is_finite()) {
            return Err(PlanError::Number { field, value, expected: "a finite number of zero or more" });
        }
    }
    Ok(())
}

/// Poses and the moves between them.
struct OrderSearch<'a> {
    way: &'a Way<'a>,
    poses: usize,
    joints: usize,
    /// Moves from any pose, or home (the last row), to any pose: seconds, and the sign of every joint's motion.
    times: DMatrix<f64>,
    signs: Vec<i8>,
}

impl<'a> OrderSearch<'a> {
    fn new(way: &'a Way<'a>) -> Self {
        let (poses, joints) = (way.commands.len(), way.speeds.len());
        let from = |place: usize| way.commands.get(place).map(Vec::as_slice).or(way.home);
        let mut times = DMatrix::zeros(poses + 1, poses);
        let mut signs = vec![0; (poses + 1) * poses * joints];
        for i in 0..=poses {
            let Some(from) = from(i) else { continue };
            for (k, to) in way.commands.iter().enumerate() {
                for (joint, (a, b)) in from.iter().zip(to).enumerate() {
                    let step = b - a;
                    times[(i, k)] = f64::max(times[(i, k)], step.abs() / way.speeds[joint]);
                    let sign = if step > 0.0 { 1 } else { -i8::from(step < 0.0) };
                    signs[(i * poses + k) * joints + joint] = sign;
                }
            }
        }
        Self { way, poses, joints, times, signs }
    }

    /// The moves of an order: from where, to where.
    fn steps<'o>(&self, order: &'o [usize]) -> impl Iterator<Item = (usize, usize)> + use<'o> {
        let home = self.poses;
        order
            .iter()
            .enumerate()
            .map(move |(place, pose)| (if place == 0 { home } else { order[place - 1] }, *pose))
    }

    fn travel(&self, order: &[usize]) -> f64 {
        self.steps(order).map(|step| self.times[step]).sum()
    }

    fn approaches(&self, order: &[usize]) -> Vec<Vec<i8>> {
        let mut last = vec![0; self.joints];
        let of = |(from, to): (usize, usize)| {
            let first = (from * self.poses + to) * self.joints;
            for (last, sign) in last.iter_mut().zip(&self.signs[first..first + self.joints]) {
                *last = if *sign == 0 { *last } else { *sign };
            }
            last.clone()
        };
        self.steps(order).map(of).collect()
    }

    fn imbalance(&self, order: &[usize]) -> f64 {
        let mut sum = 0.0;
        for joint in 0..self.joints {
            let (mut last, mut difference, mut known) = (0, 0_i32, 0_i32);
            for (from, to) in self.steps(order) {
                let sign = self.signs[(from * self.poses + to) * self.joints + joint];
                last = if sign == 0 { last } else { sign };
                difference += i32::from(last);
                known += i32::from(last != 0);
            }
            if known > 0 {
                sum += (f64::from(difference) / f64::from(known)).powi(2);
            }
        }
        sum
    }

    fn cost(&self, order: &[usize]) -> OrderCost {
        let OrderWeights { balance, drift: of_drift } = self.way.weights;
        let (travel, imbalance) = (self.travel(order), self.imbalance(order));
        let drift = self.way.drift.map_or(0.0, |coupling| coupling.share(order));
        OrderCost { travel, imbalance, drift, total: travel + balance * imbalance + of_drift * drift }
    }

    /// The cost if it is below a limit. The part of drift is computed last: it is not negative, and takes longest.
    fn total_below(&self, order: &[usize], limit: f64) -> Option<f64> {
        let OrderWeights { balance, drift: of_drift } = self.way.weights;
        let mut total = self.travel(order);
        if total >= limit {
            return None;
        }
        if balance > 0.0 {
            total += balance * self.imbalance(order);
        }
        if total < limit && of_drift > 0.0 {
            total += of_drift * self.way.drift.map_or(0.0, |coupling| coupling.share(order));
        }
        (total < limit).then_some(total)
    }

    fn beginnings(&self) -> Vec<Vec<usize>> {
        let mut beginnings = Vec::new();
        if self.way.home.is_some() {
            beginnings.push(self.nearest(self.poses, Vec::new()));
        }
        let apart = self.poses.div_ceil(NEAREST_STARTS);
        beginnings.extend((0..self.poses).step_by(apart).map(|first| self.nearest(first, vec![first])));
        for start in 0..SHUFFLED_STARTS {
            let mut order: Vec<usize> = (0..self.poses).collect();
            order.shuffle(&mut stream(0, start, StreamSource::PlannedOrder));
            beginnings.push(order);
        }
        beginnings
    }

    fn nearest(&self, mut at: usize, mut order: Vec<usize>) -> Vec<usize> {
        while order.len() < self.poses {
            let left = (0..self.poses).filter(|pose| !order.contains(pose));
            let Some(next) = left.min_by(|a, b| self.times[(at, *a)].total_cmp(&self.times[(at, *b)])) else {
                break;
            };
            order.push(next);
            at = next;
        }
        order
    }

    /// Improves an order as long as a reversed or moved piece does; returns its cost.
    fn improve(&self, order: &mut Vec<usize>) -> f64 {
        let n = order.len();
        let mut cost = self.cost(order).total;
        let mut tried = order.clone();
        for _ in 0..MOST_PASSES {
            let mut changed = false;
            let mut look = |tried: &mut Vec<usize>, order: &mut Vec<usize>| {
                let better = self.total_below(tried, cost - LEAST_GAIN * cost.abs());
                if let Some(total) = better {
                    cost = total;
                    order.copy_from_slice(tried);
                    changed = true;
                } else {
                    tried.copy_from_slice(order);
                }
            };
            for first in 0..n {
                for last in first + 1..n {
                    tried[first..=last].reverse();
                    look(&mut tried, order);
                }
            }
            for length in 1..=LONGEST_PIECE.min(n.saturating_sub(1)) {
                for from in 0..=n - length {
                    for to in (0..=n - length).filter(|to| *to != from) {
                        for turned in [false, true] {
                            if from < to {
                                tried[from..to + length].rotate_left(length);
                            } else {
                                tried[to..from + length].rotate_right(length);
                            }
                            if turned {
                                tried[to..to + length].reverse();
                            }
                            look(&mut tried, order);
                            if length == 1 {
                                break;
                            }
                        }
                    }
                }
            }
            if !changed {
                break;
            }
        }
        cost
    }
}
