//! Finds bad rows, and observations of several targets, together with the best single parts.

use super::super::evidence::fit;
use super::super::part::Part;
use super::super::place::{Cloud, Placed, median};
use super::super::rows::{named, without_few};
use super::weigh::Weighed;
use super::{NOWHERE, Near, Search, excess};

/// Number of single parts with which bad rows and several targets are looked for.
const WITH_ROWS: usize = 8;
const WITH_TARGETS: usize = 8;
/// Iterations of the weights of a robust placement.
const ROUNDS: usize = 6;
/// Fewest observations of a target that is divided into several, and of each of these.
const LEAST_OF_TARGET: usize = 8;
const LEAST_OF_GROUP: usize = 3;

impl Search<'_> {
    /// The best single parts by a placement that few rows do not move, with the rows that are off.
    pub(super) fn with_rows(&mut self, singles: &[Near]) -> Vec<Weighed> {
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
        let of = found.len();
        for (done, (middle, near, placed, lengths)) in found.into_iter().enumerate() {
            self.progress.tell(done, of);
            if middle < NOWHERE {
                weighed.extend(self.rows_beside(&near.parts, &placed, &lengths));
            }
        }
        weighed
    }

    pub(super) fn rows_beside(
        &mut self,
        parts: &[Part],
        robust: &Placed,
        lengths: &[f64],
    ) -> Option<Weighed> {
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
        if self.is_absurd(&placed) {
            return None;
        }
        let fit = fit(&view, &left_out.fit.placed, &vec![true; view.rows.len()])?;
        Some(self.weighed(&parts, &view, placed, &fit))
    }

    /// The best single parts with the observations of one target divided into those of several.
    pub(super) fn with_targets(&mut self, singles: &[Near]) -> Vec<Weighed> {
        let most = self.most();
        let mut found: Vec<(f64, Vec<Part>, Placed)> = Vec::new();
        for (done, near) in singles.iter().filter(|near| near.parts.len() < most).enumerate() {
            self.progress.tell(done, 2 * singles.len());
            found.extend(self.split(&near.parts, true));
        }
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        // A hypothesis of several targets only is kept, whatever explains as much together with them.
        if let Some(at) = found.iter().position(|(_, parts, _)| parts.len() == 1)
            && at >= WITH_TARGETS
        {
            found.swap(at, WITH_TARGETS - 1);
        }
        found.truncate(WITH_TARGETS);
        // For the best ones, a third target is tried.
        let again: Vec<_> = found.iter().take(3).flat_map(|(_, parts, _)| self.split(parts, false)).collect();
        found.extend(again);
        found.retain(|(share, ..)| *share < NOWHERE);
        let mut weighed = Vec::new();
        let of = found.len();
        for (done, (_, parts, placed)) in found.into_iter().enumerate() {
            self.progress.tell(of + done, 2 * of);
            weighed.extend(self.weigh(&parts, &placed));
            if parts.len() == 1 && most > 1 {
                weighed.extend(self.rows_beside_targets(&parts));
            }
        }
        weighed
    }

    pub(super) fn rows_beside_targets(&mut self, parts: &[Part]) -> Option<Weighed> {
        let view = self.all.view(&parts.iter().collect::<Vec<_>>())?;
        let cloud = Cloud::new(&view, &mut self.chain);
        let (placed, _) = cloud.robust(ROUNDS);
        let lengths = cloud.lengths(&placed);
        self.rows_beside(parts, &placed, &lengths)
    }

    /// Divides a target's observations; where `parts` already divide them, those of one of its groups.
    pub(super) fn split(&mut self, parts: &[Part], is_first: bool) -> Vec<(f64, Vec<Part>, Placed)> {
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
                // The smaller group belongs to the other target.
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
}
