//! Every part and every pair of parts, tried on a session.

use nalgebra::Vector3;

use super::evidence::{Fit, fit};
use super::part::{Part, Session, View, structural};
use super::place::{Cloud, Placed, median};
use super::rows::{cost_of_row, is_code, named, without_few};
use super::{FarOff, Hypothesis};
use crate::kinematics::PlacedChain;
use crate::plausibility::unreachable;
use calibrig_model::CalibrationModel;
use calibrig_model::measurement::MeasurementSet;

/// Observations that everything is tried on, and that what comes near is weighed on.
const TRIED: usize = 60;
const WEIGHED: usize = 300;
/// All rows are looked at by the first hypothesis in files of at most so many.
const LOOKED_AT: usize = 50_000;
/// Single parts and pairs that are weighed.
const NEAREST: [usize; 2] = [40, 60];
/// Pairs that are placed, of those that could be.
const PLACED: usize = 1500;
/// Those that leave so many times what the nearest one leaves are not weighed, beyond the first few.
const NEAR: f64 = 8.0;
const FIRST: usize = 12;
/// A share of the spread that what is placed in a few rounds may be off.
const FLOOR: f64 = 1e-3;
/// Nor are those that leave more than this share of the spread.
const NOWHERE: f64 = 0.4;
/// Single parts beside which rows are looked for, and several targets.
const WITH_ROWS: usize = 8;
const WITH_TARGETS: usize = 8;
/// Rounds of the weights of a robust placement.
const ROUNDS: usize = 6;
/// A target needs as many observations before it is taken for several, and each of these as many.
const LEAST_OF_TARGET: usize = 8;
const LEAST_OF_GROUP: usize = 3;
/// What is otherwise than it was read must explain so much more than that nothing is, in twice the logarithm of the likelihood.
const MARGIN: f64 = 12.0;
/// And leave less than this share of what is left without.
const BETTER: f64 = 0.8;
const MUCH_BETTER: f64 = 0.5;
/// What only a stated offset tells must be clearer.
const STATED: f64 = 40.0;
/// A row that was not weighed is off where it is so much farther than one that would be left out.
const ROW_OFF: f64 = 1.5;
/// Hypotheses that are listed.
const LISTED: usize = 12;
/// Two are of one class where each fits the other's points within this share of their spread.
const SAME: f64 = 1e-6;

/// A hypothesis, weighed.
struct Weighed {
    parts: Vec<Part>,
    rms: f64,
    rms_links: f64,
    score: f64,
    placed: Placed,
}

/// A hypothesis, placed.
struct Near {
    parts: Vec<Part>,
    placed: Placed,
    share: f64,
}

struct Search<'a> {
    /// A part of the session, for everything that is tried.
    few: Session<'a>,
    /// All of it, or a larger part.
    all: Session<'a>,
    chain: PlacedChain,
    spread: f64,
    /// What a part of all rows costs: how many there are.
    cost: f64,
    /// Parts that were found before anything was placed.
    given: Vec<Part>,
}

pub(super) fn hypotheses(model: &CalibrationModel, set: &MeasurementSet) -> Vec<Hypothesis> {
    let Some(mut search) = Search::new(model, set) else {
        return vec![Hypothesis::certain(Vec::new(), 0.0, 0)];
    };
    let parts = structural(&search.few);
    search.cost = 2.0 * (parts.len() as f64).ln();
    let singles = search.singles(&parts);
    let mut weighed = search.weigh_nearest(&singles, NEAREST[0]);
    if search.most() > 1 {
        let pairs = search.pairs(&parts);
        weighed.extend(search.weigh_nearest(&pairs, NEAREST[1]));
    }
    if search.most() > 0 {
        weighed.extend(search.with_rows(&singles));
        weighed.extend(search.with_targets(&singles));
    }
    let mut listed = search.listed(weighed);
    if let Some(first) = listed.first_mut() {
        search.look_at_all(first, set.observations.len());
    }
    listed
}

fn every(kept: &[usize], most: usize) -> Vec<usize> {
    let step = kept.len().div_ceil(most).max(1);
    kept.iter().copied().step_by(step).collect()
}

impl<'a> Search<'a> {
    fn new(model: &'a CalibrationModel, set: &'a MeasurementSet) -> Option<Self> {
        let mut all = Session::new(model, set);
        let mut few = Session::new(model, set);
        let far = unreachable(model, set);
        let is_far = |i: usize| far.iter().any(|far| far.observation == i);
        let kept: Vec<usize> = (0..set.observations.len()).filter(|i| !is_far(*i)).collect();
        let among: Vec<usize> = far.iter().map(|far| far.observation).collect();
        let (codes, off): (Vec<FarOff>, Vec<FarOff>) =
            far.into_iter().partition(|far| is_code(&all.seen, far.observation, &among));
        let mut given = Vec::new();
        if !codes.is_empty() {
            given.push(Part::MissedShots { rows: codes });
        }
        if !off.is_empty() {
            given.push(Part::GrossErrors { rows: off });
        }
        all.kept = every(&kept, WEIGHED);
        few.kept = every(&kept, TRIED);
        (all.sound, few.sound) = (kept.clone(), kept.clone());
        let view = all.view(&[])?;
        let mut chain = PlacedChain::new(&model.kinematics);
        let spread = Cloud::new(&view, &mut chain).spread();
        (spread > 0.0 && kept.len() > 2).then_some(Self { few, all, chain, spread, cost: 0.0, given })
    }

    /// Parts that a hypothesis may have beside those that are given.
    fn most(&self) -> usize {
        2_usize.saturating_sub(self.given.len())
    }

    fn place(&mut self, parts: &[&Part]) -> Option<Near> {
        let view = self.few.view(parts)?;
        if view.rows.len() < 3 {
            return None;
        }
        let placed = Cloud::new(&view, &mut self.chain).best(None);
        let share = placed.share * excess(&view);
        share.is_finite().then(|| Near {
            parts: parts.iter().map(|part| (*part).clone()).collect(),
            placed,
            share,
        })
    }

    /// Nothing, every part alone, and mirrored or in another unit.
    fn singles(&mut self, parts: &[Part]) -> Vec<Near> {
        let mut found = Vec::new();
        let nothing: Option<&Part> = None;
        for part in std::iter::once(nothing).chain(parts.iter().map(Some)) {
            let alone: Vec<&Part> = part.into_iter().collect();
            if alone.len() > self.most() {
                continue;
            }
            found.extend(self.place(&alone));
            if alone.len() < self.most() {
                let mirrored = [alone.clone(), vec![&Part::Mirrored]].concat();
                found.extend(self.place(&mirrored));
                if let Some(unit) = self.unit(&alone) {
                    found.extend(self.place(&[alone.clone(), vec![&unit]].concat()));
                    if alone.len() + 1 < self.most() {
                        found.extend(self.place(&[vec![&unit], mirrored].concat()));
                    }
                }
            }
        }
        found
    }

    fn unit(&mut self, parts: &[&Part]) -> Option<Part> {
        let view = self.few.view(parts)?;
        let cloud = Cloud::new(&view, &mut self.chain);
        let relaxed = cloud.relaxed(None);
        let factor =
            relaxed.and_then(|offsets| cloud.unit(&offsets)).or_else(|| cloud.unit(&view.offsets))?;
        Some(Part::PointUnit { factor })
    }

    /// Pairs of parts, those first that no placement is known to be worse for.
    fn pairs(&mut self, parts: &[Part]) -> Vec<Near> {
        let parts: Vec<&Part> = parts.iter().filter(|part| part.is_usual()).collect();
        let mut bounds: Vec<(f64, [&Part; 2])> = Vec::new();
        for (i, a) in parts.iter().enumerate() {
            for b in &parts[i + 1..] {
                if !go_together(a, b) {
                    continue;
                }
                bounds.extend(self.bound([a, b]));
                if a.is_twofold_with(b) {
                    bounds.extend(self.bound([b, a]));
                }
            }
        }
        bounds.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut found: Vec<Near> = Vec::new();
        let mut least = f64::INFINITY;
        for (bound, pair) in bounds.into_iter().take(PLACED) {
            if bound > NEAR * least.max(FLOOR * self.spread) || bound > NOWHERE * self.spread {
                break;
            }
            if let Some(near) = self.place(&pair) {
                least = least.min(near.placed.rms);
                found.push(near);
            }
        }
        found
    }

    fn bound<'p>(&mut self, pair: [&'p Part; 2]) -> Option<(f64, [&'p Part; 2])> {
        let view = self.few.view(&pair)?;
        if view.rows.len() < 3 {
            return None;
        }
        Some((Cloud::new(&view, &mut self.chain).bound()?, pair))
    }

    fn weigh_nearest(&mut self, found: &[Near], most: usize) -> Vec<Weighed> {
        let mut order: Vec<&Near> = found.iter().collect();
        order.sort_by(|a, b| a.share.total_cmp(&b.share));
        let least = order.first().map_or(0.0, |near| near.share).max(FLOOR);
        let is_near = |(place, near): &(usize, &Near)| {
            near.parts.is_empty() || near.share < NOWHERE && (*place < FIRST || near.share < NEAR * least)
        };
        let (nothing, some): (Vec<&Near>, Vec<&Near>) =
            order.into_iter().partition(|near| near.parts.is_empty());
        let some = some.into_iter().enumerate().filter(is_near).map(|(_, near)| near).take(most);
        let chosen: Vec<&Near> = nothing.into_iter().chain(some).collect();
        chosen.into_iter().filter_map(|near| self.weigh(&near.parts, &near.placed)).collect()
    }

    /// The weight of a hypothesis on all rows that it keeps.
    fn weigh(&mut self, parts: &[Part], start: &Placed) -> Option<Weighed> {
        let view = self.all.view(&parts.iter().collect::<Vec<_>>())?;
        let cloud = Cloud::new(&view, &mut self.chain);
        let offsets = if start.offsets.len() == view.offsets.len() {
            start.offsets.clone()
        } else {
            view.offsets.clone()
        };
        let placed = cloud.refined(cloud.placed(offsets, None));
        let fit = fit(&view, &placed, &vec![true; view.rows.len()])?;
        Some(self.weighed(parts, &view, placed, &fit))
    }

    fn weighed(&self, parts: &[Part], view: &View, placed: Placed, fit: &Fit) -> Weighed {
        let n = self.all.kept.len();
        let lost = (n - view.rows.len().min(n)) as f64;
        let score = fit.score
            + lost * cost_of_row(self.spread, 1)
            + parts.iter().map(|part| self.price(part)).sum::<f64>();
        Weighed { parts: parts.to_vec(), rms: placed.rms, rms_links: fit.rms, score, placed }
    }

    /// What a part costs by itself: how many of its kind could have been found.
    fn price(&self, part: &Part) -> f64 {
        let n = self.all.kept.len() as f64;
        let usual = 0.3 * f64::from(part.rank());
        match part {
            Part::ExchangedRows { cycles } => {
                usual + cycles.iter().map(|cycle| 2.0 * cycle.len() as f64 * n.ln()).sum::<f64>()
            }
            // Which of the rows: the others are counted as rows that were lost.
            Part::GrossErrors { rows } | Part::MissedShots { rows } => {
                usual + 2.0 * rows.len() as f64 * n.ln()
            }
            // Each row can be of either target.
            Part::SeveralTargets { others, .. } => {
                usual + 2.0 * n * (1.0 + others.len() as f64).ln() + self.cost
            }
            // What is likely are the points as they stand in the file.
            Part::PointUnit { factor } => usual + self.cost - 6.0 * n * factor.ln(),
            _ => usual + self.cost,
        }
    }

    /// The best single parts by a placement that few rows do not move, with the rows that are off beside them.
    fn with_rows(&mut self, singles: &[Near]) -> Vec<Weighed> {
        let most = self.most();
        let mut found: Vec<(f64, &Near, Placed, Vec<f64>)> = Vec::new();
        for near in singles.iter().filter(|near| near.parts.len() < most || near.parts.is_empty()) {
            let Some(view) = self.all.view(&near.parts.iter().collect::<Vec<_>>()) else { continue };
            if view.rows.len() < 6 {
                continue;
            }
            let cloud = Cloud::new(&view, &mut self.chain);
            let (placed, _) = cloud.robust(ROUNDS);
            let lengths = cloud.lengths(&placed);
            let middle = median(lengths.clone()) / cloud.spread() * excess(&view);
            found.push((middle, near, placed, lengths));
        }
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        let at = found.iter().position(|(_, near, ..)| near.parts.is_empty());
        if let Some(at) = at.filter(|at| *at >= WITH_ROWS) {
            found.swap(at, WITH_ROWS - 1);
        }
        found.truncate(WITH_ROWS);
        let mut weighed = Vec::new();
        for (middle, near, placed, lengths) in found {
            if middle < NOWHERE {
                weighed.extend(self.rows_beside(&near.parts, &placed, &lengths));
            }
        }
        weighed
    }

    fn rows_beside(&mut self, parts: &[Part], robust: &Placed, lengths: &[f64]) -> Option<Weighed> {
        let view = self.all.view(&parts.iter().collect::<Vec<_>>())?;
        let left_out = without_few(&view, robust, lengths, self.spread)?;
        if left_out.kept.iter().all(|is_kept| *is_kept) {
            return None;
        }
        let rows = named(&view, &left_out, &self.all.seen);
        let parts = [parts.to_vec(), rows].concat();
        if parts.len() > self.most() {
            return None;
        }
        let view = self.all.view(&parts.iter().collect::<Vec<_>>())?;
        let cloud = Cloud::new(&view, &mut self.chain);
        let placed = cloud.refined(cloud.placed(left_out.fit.placed.offsets.clone(), None));
        let fit = fit(&view, &left_out.fit.placed, &vec![true; view.rows.len()])?;
        Some(self.weighed(&parts, &view, placed, &fit))
    }

    /// The best single parts with the observations of one target told apart as those of several.
    fn with_targets(&mut self, singles: &[Near]) -> Vec<Weighed> {
        let most = self.most();
        let mut found: Vec<(f64, Vec<Part>, Placed)> = Vec::new();
        for near in singles.iter().filter(|near| near.parts.len() < most) {
            found.extend(self.split(&near.parts, true));
        }
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        found.truncate(WITH_TARGETS);
        // Of the best ones a third target.
        let again: Vec<_> = found.iter().take(3).flat_map(|(_, parts, _)| self.split(parts, false)).collect();
        found.extend(again);
        found.retain(|(share, ..)| *share < NOWHERE);
        let mut weighed = Vec::new();
        for (_, parts, placed) in found {
            weighed.extend(self.weigh(&parts, &placed));
            if parts.len() == 1 && most > 1 {
                weighed.extend(self.rows_beside_targets(&parts));
            }
        }
        weighed
    }

    fn rows_beside_targets(&mut self, parts: &[Part]) -> Option<Weighed> {
        let view = self.all.view(&parts.iter().collect::<Vec<_>>())?;
        let cloud = Cloud::new(&view, &mut self.chain);
        let (placed, _) = cloud.robust(ROUNDS);
        let lengths = cloud.lengths(&placed);
        self.rows_beside(parts, &placed, &lengths)
    }

    /// A target's observations told apart; where `parts` already tell them apart, those of one of its groups.
    fn split(&mut self, parts: &[Part], is_first: bool) -> Vec<(f64, Vec<Part>, Placed)> {
        let Some(view) = self.all.view(&parts.iter().collect::<Vec<_>>()) else { return Vec::new() };
        let cloud = Cloud::new(&view, &mut self.chain);
        let mut starts = vec![cloud.best(None)];
        if is_first {
            starts.push(cloud.robust(ROUNDS).0);
        }
        let known = self.all.offsets.len();
        let mut found = Vec::new();
        for target in 0..view.offsets.len() {
            if view.target.iter().filter(|t| **t == target).count() < LEAST_OF_TARGET {
                continue;
            }
            for start in &starts {
                let Some((placed, second)) = cloud.split(target, start) else { continue };
                let of = |is_second: bool| -> Vec<usize> {
                    let own = (0..view.rows.len()).filter(|row| view.target[*row] == target);
                    own.filter(|row| second[*row] == is_second).map(|row| view.rows[row].1).collect()
                };
                let [rest, group] = [false, true].map(of);
                // The fewer ones are the other target's.
                let (rest, group, placed) = if group.len() > rest.len() {
                    (group, rest, placed.with_exchanged(target, view.offsets.len()))
                } else {
                    (rest, group, placed)
                };
                if group.len() < LEAST_OF_GROUP {
                    continue;
                }
                let mut parts = parts.to_vec();
                match parts.iter_mut().find(|part| matches!(part, Part::SeveralTargets { .. })) {
                    Some(Part::SeveralTargets { others, .. }) => {
                        if target >= known {
                            others[target - known] = rest;
                        }
                        others.push(group);
                    }
                    _ => parts.push(Part::SeveralTargets { target, others: vec![group] }),
                }
                found.push((placed.share * excess(&view), parts, placed));
            }
        }
        found
    }

    /// The hypotheses in their order, with what they are worth.
    fn listed(&mut self, mut weighed: Vec<Weighed>) -> Vec<Hypothesis> {
        let given = self.given.clone();
        weighed.sort_by(|a, b| a.score.total_cmp(&b.score));
        weighed.dedup_by(|a, b| a.parts == b.parts);
        let Some(sound) = weighed.iter().position(|w| w.parts.is_empty()) else {
            // Places alone explain whatever was measured: all that is told is what is out of reach.
            let rms = self.rms_of_all();
            let first = Hypothesis::certain(given.clone(), if given.is_empty() { rms } else { 0.0 }, 0);
            let sound = (!given.is_empty())
                .then(|| Hypothesis { probability: 0.0, ..Hypothesis::certain(Vec::new(), rms, 1) });
            return std::iter::once(first).chain(sound).collect();
        };
        // Nothing is told that the session does not show clearly.
        if sound > 0 && given.is_empty() {
            let (first, without) = (&weighed[0], &weighed[sound]);
            // Links can be off far enough to explain much: what remains with them, or without, must be less.
            let is_less =
                first.rms_links < BETTER * without.rms_links || first.rms < MUCH_BETTER * without.rms;
            // An offset that is stated tells what points alone do not.
            let is_told =
                self.all.offset_sigma.iter().any(Option::is_some) && first.score + STATED < without.score;
            let is_clear = first.score + MARGIN < without.score && (is_less || is_told);
            if !is_clear {
                let sound = weighed.remove(sound);
                let least = weighed[0].score.min(sound.score);
                weighed.insert(0, Weighed { score: least, ..sound });
            }
        }
        let sound = weighed.iter().position(|w| w.parts.is_empty()).unwrap_or(0);
        if sound >= LISTED {
            weighed.swap(sound, LISTED - 1);
        }
        let least = weighed[0].score;
        let total: f64 = weighed.iter().map(|w| (-0.5 * (w.score - least)).exp()).sum();
        weighed.truncate(LISTED);
        let classes = self.classes(&weighed);
        let mut order: Vec<usize> = (0..weighed.len()).collect();
        // Of one class, the simplest comes first.
        let simple = |i: usize| {
            (weighed[i].parts.len(), weighed[i].parts.iter().map(|p| u32::from(p.rank())).sum::<u32>())
        };
        order.sort_by_key(|i| (classes[*i], simple(*i)));
        let of = |i: usize| {
            let w = &weighed[i];
            Hypothesis {
                parts: [given.clone(), Part::merged(w.parts.clone())].concat(),
                rms: w.rms,
                rms_links: w.rms_links,
                above_first: w.score - least,
                probability: (-0.5 * (w.score - least)).exp() / total,
                class: classes[i],
            }
        };
        let mut listed: Vec<Hypothesis> = order.into_iter().map(of).collect();
        if !given.is_empty() {
            listed.truncate(LISTED - 1);
            let least = weighed.iter().find(|w| w.parts.is_empty()).map_or(0.0, |w| w.rms);
            listed.push(Hypothesis {
                parts: Vec::new(),
                rms: self.rms_of_all().max(least),
                rms_links: self.rms_of_all(),
                above_first: f64::MAX,
                probability: 0.0,
                class: classes.iter().max().map_or(1, |class| class + 1),
            });
        }
        listed
    }

    /// Rows that were not among those that were weighed, and are off by the first hypothesis: added to it.
    fn look_at_all(&mut self, first: &mut Hypothesis, observations: usize) {
        let sample = self.all.kept.clone();
        if sample.len() == self.all.sound.len() || observations > LOOKED_AT {
            return;
        }
        let at = first.parts.iter().position(|part| matches!(part, Part::GrossErrors { .. }));
        if at.is_none() && first.parts.len() > 1 {
            return;
        }
        self.all.kept.clone_from(&self.all.sound);
        let view = self.all.view(&first.parts.iter().collect::<Vec<_>>());
        self.all.kept.clone_from(&sample);
        let Some(view) = view else { return };
        let kept: Vec<bool> = view.rows.iter().map(|(row, _)| sample.binary_search(row).is_ok()).collect();
        let weights: Vec<f64> = kept.iter().map(|is_kept| f64::from(u8::from(*is_kept))).collect();
        let placed = Cloud::new(&view, &mut self.chain).best(Some(&weights));
        let Some(fit) = fit(&view, &placed, &kept) else { return };
        let cost = ROW_OFF * cost_of_row(self.spread, view.rows.len());
        // Twice what a row costs in the likelihood, where that is in units of the scatter.
        let limit = cost - 6.0 * fit.sigma.ln() * ROW_OFF;
        let far = (0..view.rows.len()).filter(|row| !kept[*row] && fit.far[*row] > limit);
        let mut far: Vec<FarOff> = far
            .map(|row| FarOff {
                observation: view.rows[row].1,
                distance: fit.distance(&view, row, &view.seen[row]).1,
            })
            .collect();
        if far.is_empty() {
            return;
        }
        far.sort_by(|a, b| b.distance.total_cmp(&a.distance));
        match at.map(|at| &mut first.parts[at]) {
            Some(Part::GrossErrors { rows }) => rows.extend(far),
            _ => first.parts.push(Part::GrossErrors { rows: far }),
        }
    }

    /// What the robot leaves of all rows, also those out of its reach, m.
    fn rms_of_all(&mut self) -> f64 {
        let n = self.all.seen.len();
        let kept = std::mem::replace(&mut self.all.kept, (0..n).collect());
        let view = self.all.view(&[]);
        self.all.kept = kept;
        view.map_or(0.0, |view| Cloud::new(&view, &mut self.chain).best(None).rms)
    }

    /// Numbers of classes, in the order of their best.
    fn classes(&mut self, weighed: &[Weighed]) -> Vec<usize> {
        let mut classes: Vec<usize> = Vec::new();
        let mut firsts: Vec<usize> = Vec::new();
        for i in 0..weighed.len() {
            let is_same = |first: &usize| {
                let (one, other) = (&weighed[*first], &weighed[i]);
                self.explains(one, other) && self.explains(other, one)
            };
            let same = firsts.iter().position(is_same);
            classes.push(same.unwrap_or(firsts.len()));
            if same.is_none() {
                firsts.push(i);
            }
        }
        classes
    }

    /// Whether the robot as `other` reads the session lies on all points of the nominal robot as `one` reads it.
    fn explains(&mut self, one: &Weighed, other: &Weighed) -> bool {
        let is_reading = |part: &&Part| {
            matches!(
                part,
                Part::ZenithElevation
                    | Part::AnglesExchanged { .. }
                    | Part::TrackerAngleUnit { .. }
                    | Part::ShiftedRows { .. }
            ) || part.is_of_rows()
        };
        let beside = |w: &Weighed| w.parts.iter().filter(is_reading).cloned().collect::<Vec<_>>();
        if beside(one) != beside(other) {
            return false;
        }
        let read = |w: &Weighed| {
            let factor = w.parts.iter().find_map(|part| match part {
                Part::PointUnit { factor } => Some(*factor),
                _ => None,
            });
            (factor.unwrap_or(1.0), if w.parts.contains(&Part::Mirrored) { -1.0 } else { 1.0 })
        };
        let views = [one, other].map(|w| self.few.view(&w.parts.iter().collect::<Vec<_>>()));
        let [Some(view), Some(mut again)] = views else { return false };
        if view.rows != again.rows || view.target != again.target {
            return false;
        }
        let cloud = Cloud::new(&view, &mut self.chain);
        let placed = cloud.refined(cloud.placed(one.placed.offsets.clone(), None));
        let ((factor, hand), (other_factor, other_hand)) = (read(one), read(other));
        again.seen = (0..view.rows.len())
            .map(|i| {
                let predicted = (view.seen[i] - cloud.residual(&placed, i)) * (other_factor / factor);
                Vector3::new(predicted.x, predicted.y, predicted.z * hand * other_hand)
            })
            .collect();
        let cloud = Cloud::new(&again, &mut self.chain);
        cloud.refined(cloud.best(None)).share < SAME
    }
}

impl Hypothesis {
    /// The only one that there is.
    fn certain(parts: Vec<Part>, rms: f64, class: usize) -> Self {
        Self { parts, rms, rms_links: rms, above_first: 0.0, probability: 1.0, class }
    }
}

/// By how much more is expected where places are fitted to few rows.
fn excess(view: &View) -> f64 {
    let rows = 3.0 * view.rows.len() as f64;
    let places = 6.0 * view.stations as f64 + 3.0 * view.offsets.len() as f64;
    (rows / (rows - places).max(1.0)).sqrt()
}

/// Whether two parts can both be meant.
fn go_together(a: &Part, b: &Part) -> bool {
    match (a, b) {
        (Part::ShiftedRows { .. }, Part::ShiftedRows { .. })
        | (Part::Convention { .. }, Part::Convention { .. })
        | (Part::ToolLink { .. }, Part::ToolLink { .. })
        | (Part::TravelUnit { .. }, Part::TravelUnit { .. })
        | (Part::TrackerAngleUnit { .. }, Part::TrackerAngleUnit { .. })
        | (Part::AnglesExchanged { .. }, Part::AnglesExchanged { .. } | Part::ZenithElevation)
        | (Part::ZenithElevation, Part::AnglesExchanged { .. }) => false,
        (Part::Sign { joint: i }, Part::Sign { joint: j })
        | (Part::Offset { joint: i, .. }, Part::Offset { joint: j, .. }) => i != j,
        (Part::AngleUnit { joints: i, .. }, Part::AngleUnit { joints: j, .. }) => {
            i.len() == 1 && j.len() == 1 && i != j
        }
        (Part::Coupling { joint: i, with: k, .. }, Part::Coupling { joint: j, with: l, .. }) => {
            (i, k) != (j, l)
        }
        // What is behind the link that the target is on moves nothing.
        (Part::ToolLink { joint }, other) | (other, Part::ToolLink { joint }) => {
            let joints = other.joints();
            joints.is_empty() || joints.iter().any(|j| j <= joint)
        }
        _ => true,
    }
}
