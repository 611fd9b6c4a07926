//! Bad rows: exchanged, off, or codes of missed shots.

use nalgebra::Vector3;

use super::FarOff;
use super::evidence::{HypothesisFit, fit};
use super::part::Part;
use super::place::{Placed, median};
use super::session::View;

/// Multiple of the median distance in a robust placement beyond which a row is left out at first.
const FAR: f64 = 8.0;
/// Most bad rows out of ten.
const FEW_OF_TEN: usize = 3;
/// Number of further rows that are left out one at a time after this stops explaining anything.
const BEYOND: usize = 3;
/// In files of more rows than this, several are left out at once if their squared distance, in standard deviations, is beyond [`SURELY_FAR`].
const MANY: usize = 100;
const SURELY_FAR: f64 = 200.0;
/// Squared distance, in standard deviations, within which a point is where another row's joints put it.
const THERE: f64 = 50.0;
/// Or within this share of its distance from its own row's place.
const NEARER: f64 = 0.05;
/// Longest cycle of exchanged rows that is recognised.
const LARGEST_CYCLE: usize = 8;

/// A view without some of its rows.
pub(super) struct LeftOut {
    pub kept: Vec<bool>,
    pub fit: HypothesisFit,
    /// Score including the cost of the rows that are left out.
    pub score: f64,
}

/// Cost of a row that is left out of the fit: a point anywhere in the space around the robot, and the choice of the row.
pub(super) fn cost_of_row(spread: f64, rows: usize) -> f64 {
    6.0 * (2.0 * spread.max(1e-3)).ln() + 2.0 * (rows as f64).ln()
}

/// Leaves out the rows without which the others are explained best: those far off a robust placement, then one at a time.
pub(super) fn without_few(view: &View, robust: &Placed, lengths: &[f64], spread: f64) -> Option<LeftOut> {
    let n = view.rows.len();
    let most = FEW_OF_TEN * n / 10;
    let cost = cost_of_row(spread, n);
    let far = FAR * median(lengths.to_vec());
    let mut order: Vec<usize> = (0..n).filter(|i| lengths[*i] > far).collect();
    order.sort_by(|a, b| lengths[*b].total_cmp(&lengths[*a]));
    order.truncate(most);
    let mut kept = vec![true; n];
    for i in &order {
        kept[*i] = false;
    }
    let mut now = fit(view, robust, &kept)?;
    // Rows that the robust placement left out needlessly are taken back.
    for _ in 0..order.len() {
        let back = (0..n).filter(|i| !kept[*i]).min_by(|a, b| now.far[*a].total_cmp(&now.far[*b]));
        let Some(back) = back else { break };
        let before = now.score + cost;
        kept[back] = true;
        match fit(view, &now.placed, &kept) {
            Some(next) if next.score < before => now = next,
            _ => {
                kept[back] = false;
                break;
            }
        }
    }
    let score = |fit: &HypothesisFit, kept: &[bool]| {
        fit.score + cost * kept.iter().filter(|is_kept| !**is_kept).count() as f64
    };
    let mut best = LeftOut { score: score(&now, &kept), fit: now, kept: kept.clone() };
    let mut path = best.fit.placed.clone();
    let mut far = best.fit.far.clone();
    let mut without = 0;
    while kept.iter().filter(|is_kept| !**is_kept).count() < most && without < BEYOND {
        let worst = (0..n).filter(|i| kept[*i]).max_by(|a, b| far[*a].total_cmp(&far[*b]));
        let Some(worst) = worst else { break };
        // In long files, all rows that are about as bad are left out at once.
        let limit = if n > MANY { (0.3 * far[worst]).max(SURELY_FAR) } else { f64::INFINITY };
        let left = kept.iter().filter(|is_kept| **is_kept).count().saturating_sub(n - most);
        let alike: Vec<usize> = (0..n)
            .filter(|i| kept[*i] && *i != worst && far[*i] > limit)
            .take(left.saturating_sub(1))
            .collect();
        kept[worst] = false;
        for i in alike {
            kept[i] = false;
        }
        let Some(next) = fit(view, &path, &kept) else { break };
        (path, far) = (next.placed.clone(), next.far.clone());
        let reached = score(&next, &kept);
        if reached < best.score {
            best = LeftOut { score: reached, fit: next, kept: kept.clone() };
            without = 0;
        } else {
            without += 1;
        }
    }
    Some(best)
}

/// The rows that were left out, as parts: exchanged with each other, codes, and the rest, which is off. `raw` are the points as they are in the
/// file, `seen` as they are read in the view.
pub(super) fn named(view: &View, left_out: &LeftOut, raw: &[Vector3<f64>]) -> Vec<Part> {
    let out: Vec<usize> = (0..view.rows.len()).filter(|row| !left_out.kept[*row]).collect();
    let distance = |row: usize, point: usize| {
        let (squared, length) = left_out.fit.distance(view, row, &view.seen[point]);
        let own = left_out.fit.distance(view, row, &view.seen[row]).1;
        (squared < THERE || length < NEARER * own, length)
    };
    // The row whose point belongs to this row.
    let partner = |row: usize| {
        let others = out.iter().copied().filter(|other| *other != row);
        let nearest =
            others.map(|other| (other, distance(row, other))).min_by(|a, b| a.1.1.total_cmp(&b.1.1));
        nearest.filter(|(_, (is_there, _))| *is_there).map(|(other, _)| other)
    };
    let partners: Vec<Option<usize>> = out.iter().map(|row| partner(*row)).collect();
    let next = |row: usize| out.iter().position(|o| *o == row).and_then(|at| partners[at]);
    let mut cycles: Vec<Vec<usize>> = Vec::new();
    let mut in_cycle = Vec::new();
    for &row in &out {
        if in_cycle.contains(&row) {
            continue;
        }
        let mut cycle = vec![row];
        while let Some(other) = next(*cycle.last().unwrap_or(&row)) {
            if other == row || cycle.contains(&other) || cycle.len() >= LARGEST_CYCLE {
                break;
            }
            cycle.push(other);
        }
        let closes = cycle.len() > 1 && next(*cycle.last().unwrap_or(&row)) == Some(row);
        if closes && cycle.iter().all(|i| !in_cycle.contains(i)) {
            in_cycle.extend(&cycle);
            cycles.push(cycle);
        }
    }
    let point = |row: usize| view.rows[row].1;
    let points: Vec<usize> = out.iter().map(|row| point(*row)).collect();
    let far = |row: usize| FarOff {
        observation: point(row),
        distance: left_out.fit.distance(view, row, &view.seen[row]).1,
    };
    let mut rest: Vec<FarOff> =
        out.iter().filter(|row| !in_cycle.contains(row)).map(|row| far(*row)).collect();
    rest.sort_by(|a, b| b.distance.total_cmp(&a.distance));
    let (codes, rest): (Vec<FarOff>, Vec<FarOff>) =
        rest.into_iter().partition(|far| is_code(raw, far.observation, &points));
    let mut parts = Vec::new();
    if !cycles.is_empty() {
        let of_commands = |cycle: &Vec<usize>| cycle.iter().map(|row| point(*row)).collect();
        parts.push(Part::ExchangedRows { cycles: cycles.iter().map(of_commands).collect() });
    }
    if !codes.is_empty() {
        parts.push(Part::MissedShots { rows: codes });
    }
    if !rest.is_empty() {
        parts.push(Part::GrossErrors { rows: rest });
    }
    parts
}

/// Whether a point of `raw` is a code that programs write for a missing point: equal coordinates, a number of nines, or a point equal to
/// another one `among` those that are off.
pub(super) fn is_code(raw: &[Vector3<f64>], own: usize, among: &[usize]) -> bool {
    let point = &raw[own];
    let alike = |a: f64, b: f64| (a - b).abs() <= 1e-9 * a.abs().max(b.abs());
    let is_same = alike(point.x, point.y) && alike(point.y, point.z);
    let angles = [point.y.atan2(point.x), point.z.atan2(point.x.hypot(point.y))];
    let is_nines = [point.x, point.y, point.z, point.norm()].iter().any(|v| nines(*v))
        || angles.iter().any(|v| nines(v.to_degrees()));
    let is_at = |other: usize| other != own && (raw[other] - point).amax() <= 1e-12 * point.amax();
    is_same || is_nines || among.iter().any(|other| is_at(*other))
}

/// Whether the digits are three or more nines only.
fn nines(value: f64) -> bool {
    let size = value.abs();
    if !(size > 0.0 && size.is_finite()) {
        return false;
    }
    let mantissa = size / 10.0_f64.powf(size.log10().floor());
    (3..=9).any(|digits| (mantissa - (10.0 - 10.0_f64.powi(1 - digits))).abs() < 1e-9)
}
