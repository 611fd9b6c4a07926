//! Weighs hypotheses that fit approximately, on more rows.

use super::super::evidence::{HypothesisFit, fit};
use super::super::part::Part;
use super::super::place::{Cloud, Placed};
use super::super::rows::cost_of_row;
use super::super::session::View;
use super::{FIRST, FLOOR, NEAR, NOWHERE, Near, Search};

/// Longest plausible offset of a target, as a multiple of the robot's length.
const LONGEST_OFFSET: f64 = 3.0;

/// A hypothesis with its weight.
pub(super) struct Weighed {
    pub parts: Vec<Part>,
    pub rms: f64,
    pub rms_links: f64,
    pub score: f64,
    pub placed: Placed,
}

impl Search<'_> {
    pub(super) fn weigh_nearest(&mut self, found: &[Near], most: usize) -> Vec<Weighed> {
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
        let of = chosen.len();
        let mut weighed = Vec::with_capacity(of);
        for (done, near) in chosen.into_iter().enumerate() {
            self.progress.tell(done, of);
            weighed.extend(self.weigh(&near.parts, &near.placed));
        }
        weighed
    }

    /// The weight of a hypothesis on all rows that it keeps.
    pub(super) fn weigh(&mut self, parts: &[Part], start: &Placed) -> Option<Weighed> {
        let view = self.all.view(&parts.iter().collect::<Vec<_>>())?;
        let cloud = Cloud::new(&view, &mut self.chain);
        let offsets = if start.offsets.len() == view.offsets.len() {
            start.offsets.clone()
        } else {
            view.offsets.clone()
        };
        let placed = cloud.refined(cloud.placed(offsets, None));
        if !parts.is_empty() && self.is_absurd(&placed) {
            return None;
        }
        let fit = fit(&view, &placed, &vec![true; view.rows.len()])?;
        Some(self.weighed(parts, &view, placed, &fit))
    }

    /// Whether a placement leaves more than the points' spread, or has a target implausibly far from the flange.
    pub(super) fn is_absurd(&self, placed: &Placed) -> bool {
        let longest = LONGEST_OFFSET * self.all.model.kinematics.characteristic_length();
        !(placed.share < 1.0) || placed.offsets.iter().any(|offset| offset.norm() > longest)
    }

    pub(super) fn weighed(
        &self,
        parts: &[Part],
        view: &View,
        placed: Placed,
        fit: &HypothesisFit,
    ) -> Weighed {
        let n = self.all.kept.len();
        let lost = (n - view.rows.len().min(n)) as f64;
        let score = fit.score
            + lost * cost_of_row(self.spread, 1)
            + parts.iter().map(|part| self.price(part)).sum::<f64>();
        Weighed { parts: parts.to_vec(), rms: placed.rms, rms_links: fit.rms, score, placed }
    }

    /// Cost of a part itself: how many of its kind could have been found.
    pub(super) fn price(&self, part: &Part) -> f64 {
        let n = self.all.kept.len() as f64;
        let usual = 0.3 * f64::from(part.rank());
        match part {
            Part::ExchangedRows { cycles } => {
                usual + cycles.iter().map(|cycle| 2.0 * cycle.len() as f64 * n.ln()).sum::<f64>()
            }
            // The choice of the rows; the rows themselves are counted as lost.
            Part::GrossErrors { rows } | Part::MissedShots { rows } => {
                usual + 2.0 * rows.len() as f64 * n.ln()
            }
            // Each row can belong to either target.
            Part::SeveralTargets { others, .. } => {
                usual + 2.0 * n * (1.0 + others.len() as f64).ln() + self.cost
            }
            // The likelihood is that of the points as they are in the file.
            Part::PointUnit { factor } => usual + self.cost - 6.0 * n * factor.ln(),
            _ => usual + self.cost,
        }
    }
}
