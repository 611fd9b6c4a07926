//! Orders hypotheses, groups them into classes that no measurement separates, and examines the rows that were not weighed.

use nalgebra::Vector3;

use super::super::evidence::fit;
use super::super::part::Part;
use super::super::place::Cloud;
use super::super::rows::{LeftOut, cost_of_row, named};
use super::super::session::View;
use super::super::{FarOff, Hypothesis};
use super::Search;
use super::weigh::Weighed;

/// Largest number of rows of a file for which all rows are examined with the first hypothesis.
const LOOKED_AT: usize = 50_000;
/// Least gain of an explanation over a sound session, in twice the logarithm of the likelihood.
const MARGIN: f64 = 12.0;
/// An explanation must also leave less than this share of the residual without it.
const BETTER: f64 = 0.8;
const MUCH_BETTER: f64 = 0.5;
/// Least gain of what only a stated offset or nests show.
const STATED: f64 = 40.0;
/// Multiple of the limit for leaving out rows from which on a row that was not weighed counts as off.
const ROW_OFF: f64 = 1.5;
/// Most bad rows among which partners of an exchange are looked for.
const NAMED: usize = 500;
/// Most hypotheses that are listed.
const LISTED: usize = 12;
/// Two hypotheses are in one class if each fits the other's points within this share of their spread.
const SAME: f64 = 1e-6;

impl Search<'_> {
    /// The hypotheses in their order, with their figures.
    pub(super) fn listed(&mut self, mut weighed: Vec<Weighed>) -> Vec<Hypothesis> {
        let given = self.given.clone();
        weighed.sort_by(|a, b| a.score.total_cmp(&b.score));
        weighed.dedup_by(|a, b| a.parts == b.parts);
        let Some(sound) = weighed.iter().position(|w| w.parts.is_empty()) else {
            // The places alone explain any measurement: only points out of reach are reported.
            let rms = self.rms_of_all();
            let first = Hypothesis::certain(given.clone(), if given.is_empty() { rms } else { 0.0 }, 0);
            let sound = (!given.is_empty())
                .then(|| Hypothesis { probability: 0.0, ..Hypothesis::certain(Vec::new(), rms, 1) });
            return std::iter::once(first).chain(sound).collect();
        };
        // Nothing is reported that the session does not show clearly.
        if sound > 0 && given.is_empty() {
            let (first, without) = (&weighed[0], &weighed[sound]);
            // Errors of the links can explain much: the residual must be smaller with links fitted, or without.
            let is_less =
                first.rms_links < BETTER * without.rms_links || first.rms < MUCH_BETTER * without.rms;
            // A stated offset and nests show what points alone do not.
            let is_stated = self.all.offset_sigma.iter().any(Option::is_some)
                || self.all.nests.iter().any(|nests| !nests.is_empty());
            let is_told = is_stated && first.score + STATED < without.score;
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
        // Within a class, the simplest hypothesis comes first.
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

    /// Examines the rows that were not weighed: to which of several targets they belong, and which are off with the first hypothesis.
    pub(super) fn look_at_all(&mut self, first: &mut Hypothesis, observations: usize) {
        let sample = self.all.kept.clone();
        if sample.len() == self.all.sound.len() || observations > LOOKED_AT {
            return;
        }
        self.all.kept.clone_from(&self.all.sound);
        self.told_targets(first, &sample);
        if let Some(parts) = self.rows_of_all(first, &sample) {
            first.parts = parts;
        }
        self.all.kept = sample;
    }

    /// Assigns every row to the nearest target.
    fn told_targets(&mut self, first: &mut Hypothesis, sample: &[usize]) {
        let known = self.all.offsets.len();
        let Some(view) = self.all.view(&first.parts.iter().collect::<Vec<_>>()) else { return };
        let weights = weights(&view, |row| sample.binary_search(&row).is_ok());
        let cloud = Cloud::new(&view, &mut self.chain);
        let is_split = |part: &&mut Part| matches!(part, Part::SeveralTargets { .. });
        let Some(Part::SeveralTargets { target, others }) = first.parts.iter_mut().find(is_split) else {
            return;
        };
        let placed = cloud.best(Some(&weights));
        let among: Vec<usize> = std::iter::once(*target).chain(known..known + others.len()).collect();
        for (i, (_, point)) in view.rows.iter().enumerate() {
            if self.all.target[*point] == *target && sample.binary_search(point).is_err() {
                let nearest = cloud.nearest(&placed, i, &among);
                if nearest >= known {
                    others[nearest - known].push(*point);
                }
            }
        }
        for rows in others {
            rows.sort_unstable();
        }
    }

    /// The parts of the first hypothesis, with bad rows taken from all rows; `None` where nothing changes.
    fn rows_of_all(&mut self, first: &Hypothesis, sample: &[usize]) -> Option<Vec<Part>> {
        let is_found = |part: &&Part| matches!(part, Part::GrossErrors { .. } | Part::ExchangedRows { .. });
        let before: Vec<usize> = first.parts.iter().filter(is_found).flat_map(Part::rows).collect();
        let mut parts: Vec<Part> = first.parts.iter().filter(|part| !is_found(part)).cloned().collect();
        let room = 2_usize.checked_sub(parts.len()).filter(|room| *room > 0)?;
        let view = self.all.view(&parts.iter().collect::<Vec<_>>())?;
        let weights = weights(&view, |row| sample.binary_search(&row).is_ok() && !before.contains(&row));
        let mut kept: Vec<bool> = weights.iter().map(|weight| *weight > 0.0).collect();
        let placed = Cloud::new(&view, &mut self.chain).best(Some(&weights));
        let fit = fit(&view, &placed, &kept)?;
        let cost = ROW_OFF * cost_of_row(self.spread, view.rows.len());
        // Twice the cost of a row in the likelihood, in units of the scatter.
        let limit = cost - 6.0 * fit.sigma.ln() * ROW_OFF;
        let mut is_more = false;
        for ((is_kept, far), (_, point)) in kept.iter_mut().zip(&fit.far).zip(&view.rows) {
            let is_known = before.contains(point);
            let is_off = !*is_kept && (is_known || *far > limit);
            is_more |= is_off && !is_known;
            *is_kept = !is_off;
        }
        if !is_more {
            return None;
        }
        let off: Vec<usize> = (0..kept.len()).filter(|row| !kept[*row]).collect();
        let left_out = LeftOut { kept, fit, score: 0.0 };
        let mut named = if off.len() > NAMED { Vec::new() } else { named(&view, &left_out, &self.all.seen) };
        if named.is_empty() || named.len() > room {
            let far = |row: &usize| FarOff {
                observation: view.rows[*row].1,
                distance: left_out.fit.distance(&view, *row, &view.seen[*row]).1,
            };
            let mut rows: Vec<FarOff> = off.iter().map(far).collect();
            rows.sort_by(|a, b| b.distance.total_cmp(&a.distance));
            named = vec![Part::GrossErrors { rows }];
        }
        parts.extend(named);
        Some(parts)
    }

    /// The robot's RMS residual over all rows, including those out of its reach, m.
    pub(super) fn rms_of_all(&mut self) -> f64 {
        let n = self.all.seen.len();
        let kept = std::mem::replace(&mut self.all.kept, (0..n).collect());
        let view = self.all.view(&[]);
        self.all.kept = kept;
        view.map_or(0.0, |view| Cloud::new(&view, &mut self.chain).best(None).rms)
    }

    /// Numbers of the classes, in the order of their best hypothesis.
    pub(super) fn classes(&mut self, weighed: &[Weighed]) -> Vec<usize> {
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

    /// Whether the robot, read as in `other`, fits all points that the nominal robot makes if read as in `one`.
    pub(super) fn explains(&mut self, one: &Weighed, other: &Weighed) -> bool {
        let is_reading = |part: &&Part| {
            matches!(
                part,
                Part::ZenithElevation { .. }
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
        // The stated targets and stations belong to the points.
        let placed = if view.is_stated() {
            cloud.held(&view)
        } else {
            cloud.refined(cloud.placed(one.placed.offsets.clone(), None))
        };
        let ((factor, hand), (other_factor, other_hand)) = (read(one), read(other));
        again.seen = (0..view.rows.len())
            .map(|i| {
                let predicted = (view.seen[i] - cloud.residual(&placed, i)) * (other_factor / factor);
                Vector3::new(predicted.x, predicted.y, predicted.z * hand * other_hand)
            })
            .collect();
        let cloud = Cloud::new(&again, &mut self.chain);
        let placed = if again.is_stated() { cloud.held(&again) } else { cloud.refined(cloud.best(None)) };
        placed.share < SAME
    }
}

impl Hypothesis {
    /// The only possible hypothesis.
    pub(super) fn certain(parts: Vec<Part>, rms: f64, class: usize) -> Self {
        Self { parts, rms, rms_links: rms, above_first: 0.0, probability: 1.0, class }
    }
}

/// Weight one for the rows of a view that are taken, zero for the others.
fn weights(view: &View, is_taken: impl Fn(usize) -> bool) -> Vec<f64> {
    view.rows.iter().map(|(_, point)| f64::from(u8::from(is_taken(*point)))).collect()
}
