//! Tries every part and every pair of parts on a session.

mod blame;
mod listed;
mod weigh;

use super::part::Part;
use super::place::{Cloud, Placed};
use super::rows::is_code;
use super::session::{Session, View};
use super::tried::structural;
use super::{FarOff, Hypothesis};
use crate::kinematics::KinematicChain;
use crate::plausibility::unreachable;
use calibrig_model::CalibrationModel;
use calibrig_model::measurement::MeasurementSet;

/// Numbers of observations on which everything is tried, and on which approximate fits are weighed.
const TRIED: usize = 60;
const WEIGHED: usize = 300;
/// Ends of the search's stages out of [`Progress::WHOLE`], about in proportion to their time.
const STAGES: [u64; 6] = [50, 120, 400, 520, 700, 1000];
/// Numbers of single parts and of pairs that are weighed.
const NEAREST: [usize; 2] = [40, 60];
/// Number of pairs that are placed, out of all possible ones.
const PLACED: usize = 1500;
/// Beyond the first few, hypotheses that leave more than this multiple of the best one's residual are not weighed.
const NEAR: f64 = 8.0;
const FIRST: usize = 12;
/// Error of a placement after a few iterations, as a share of the spread.
const FLOOR: f64 = 1e-3;
/// Hypotheses that leave more than this share of the spread are not weighed either.
const NOWHERE: f64 = 0.4;

/// A hypothesis with its placement.
struct Near {
    parts: Vec<Part>,
    placed: Placed,
    share: f64,
}

struct Search<'a> {
    /// The part of the session on which everything is tried.
    few: Session<'a>,
    /// The complete session, or a larger part of it.
    all: Session<'a>,
    chain: KinematicChain,
    spread: f64,
    /// Cost of a part that concerns all rows: it depends on the number of such parts.
    cost: f64,
    /// Parts that were found before any placement.
    given: Vec<Part>,
    progress: Progress<'a>,
}

/// Progress of a search: the share of each stage in the whole, and how much of it is done.
struct Progress<'a> {
    tell: &'a mut dyn FnMut(u64, u64),
    /// Shares of the whole, out of [`Progress::WHOLE`], before and after this stage.
    stage: [u64; 2],
}

impl Progress<'_> {
    const WHOLE: u64 = 1000;

    /// Begins the next stage, which ends at this share.
    fn next(&mut self, to: u64) {
        self.stage = [self.stage[1], to];
        (self.tell)(self.stage[0], Self::WHOLE);
    }

    /// Reports the steps of the stage that are done.
    fn tell(&mut self, done: usize, of: usize) {
        let [from, to] = self.stage;
        let within = (to - from) * done as u64 / of.max(1) as u64;
        (self.tell)(from + within, Self::WHOLE);
    }
}

pub(super) fn hypotheses(
    model: &CalibrationModel,
    set: &MeasurementSet,
    progress: &mut dyn FnMut(u64, u64),
) -> Vec<Hypothesis> {
    let Some(mut search) = Search::new(model, set, progress) else {
        return vec![Hypothesis::certain(Vec::new(), 0.0, 0)];
    };
    let parts = structural(&search.few);
    search.cost = 2.0 * (parts.len() as f64).ln();
    let [placed, weighed_singles, pairs, weighed_pairs, rows, targets] = STAGES;
    search.progress.next(placed);
    let singles = search.singles(&parts);
    search.progress.next(weighed_singles);
    let mut weighed = search.weigh_nearest(&singles, NEAREST[0]);
    if search.most() > 1 {
        search.progress.next(pairs);
        let pairs = search.pairs(&parts);
        search.progress.next(weighed_pairs);
        weighed.extend(search.weigh_nearest(&pairs, NEAREST[1]));
    }
    if search.most() > 0 {
        search.progress.next(rows);
        weighed.extend(search.with_rows(&singles));
        search.progress.next(targets);
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
    fn new(
        model: &'a CalibrationModel,
        set: &'a MeasurementSet,
        tell: &'a mut dyn FnMut(u64, u64),
    ) -> Option<Self> {
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
        let mut chain = KinematicChain::new(&model.kinematics);
        let spread = Cloud::new(&view, &mut chain).spread();
        let progress = Progress { tell, stage: [0, 0] };
        (spread > 0.0 && kept.len() > 2).then_some(Self {
            few,
            all,
            chain,
            spread,
            cost: 0.0,
            given,
            progress,
        })
    }

    /// Most parts of a hypothesis beside the given ones.
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

    /// No part, every part alone, and each of these mirrored or in another unit.
    fn singles(&mut self, parts: &[Part]) -> Vec<Near> {
        let mut found = Vec::new();
        let nothing: Option<&Part> = None;
        for (done, part) in std::iter::once(nothing).chain(parts.iter().map(Some)).enumerate() {
            self.progress.tell(done, parts.len());
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

    /// Pairs of parts, beginning with those whose placements have the smallest known lower bound.
    fn pairs(&mut self, parts: &[Part]) -> Vec<Near> {
        let parts: Vec<&Part> = parts.iter().filter(|part| part.is_usual()).collect();
        let mut bounds: Vec<(f64, [&Part; 2])> = Vec::new();
        for (i, a) in parts.iter().enumerate() {
            // Progress over all pairs; placing them takes as long again.
            self.progress.tell(i * (2 * parts.len() - i), 2 * parts.len() * parts.len());
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
        for (done, (bound, pair)) in bounds.into_iter().take(PLACED).enumerate() {
            self.progress.tell(PLACED + done, 2 * PLACED);
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
}

/// Expected increase of the residual because places are fitted to few rows.
fn excess(view: &View) -> f64 {
    let rows = 3.0 * view.rows.len() as f64;
    let places = 6.0 * view.stations as f64 + 3.0 * view.offsets.len() as f64;
    (rows / (rows - places).max(1.0)).sqrt()
}

/// Whether two parts can apply together.
fn go_together(a: &Part, b: &Part) -> bool {
    match (a, b) {
        (Part::ShiftedRows { .. }, Part::ShiftedRows { .. })
        | (Part::Convention { .. }, Part::Convention { .. })
        | (Part::ToolLink { .. }, Part::ToolLink { .. })
        | (Part::TravelUnit { .. }, Part::TravelUnit { .. })
        | (Part::TrackerAngleUnit { .. }, Part::TrackerAngleUnit { .. })
        | (Part::AnglesExchanged { .. }, Part::AnglesExchanged { .. } | Part::ZenithElevation { .. })
        | (Part::ZenithElevation { .. }, Part::AnglesExchanged { .. } | Part::ZenithElevation { .. }) => {
            false
        }
        (Part::Sign { joint: i }, Part::Sign { joint: j })
        | (Part::Offset { joint: i, .. }, Part::Offset { joint: j, .. }) => i != j,
        (Part::AngleUnit { joints: i, .. }, Part::AngleUnit { joints: j, .. }) => {
            i.len() == 1 && j.len() == 1 && i != j
        }
        // Two orders that undo each other leave the columns as they were read.
        (Part::Order { from: i, .. }, Part::Order { from: j, .. }) => {
            j.iter().enumerate().any(|(joint, column)| i[*column] != joint)
        }
        // Also for a coupling that applies in both ways.
        (Part::Coupling { joint: i, with: k, .. }, Part::Coupling { joint: j, with: l, .. }) => {
            (i, k) != (j, l)
        }
        // Joints behind the link with the target do not move it.
        (Part::ToolLink { joint }, other) | (other, Part::ToolLink { joint }) => {
            let joints = other.joints();
            joints.is_empty() || joints.iter().any(|j| j <= joint)
        }
        _ => true,
    }
}
