//! Every part and every pair of parts, tried on a session.

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

/// Observations that everything is tried on, and that what comes near is weighed on.
const TRIED: usize = 60;
const WEIGHED: usize = 300;
/// Where the stages of a search end, of [`Progress::WHOLE`]: about what they take.
const STAGES: [u64; 6] = [50, 120, 400, 520, 700, 1000];
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
    chain: KinematicChain,
    spread: f64,
    /// What a part of all rows costs: how many there are.
    cost: f64,
    /// Parts that were found before anything was placed.
    given: Vec<Part>,
    progress: Progress<'a>,
}

/// How far a search is: of each stage its share of what is done in all, and how much of it.
struct Progress<'a> {
    tell: &'a mut dyn FnMut(u64, u64),
    /// Shares of what is done, before this stage and behind it, of [`Progress::WHOLE`].
    stage: [u64; 2],
}

impl Progress<'_> {
    const WHOLE: u64 = 1000;

    /// The next stage begins, which goes up to this share.
    fn next(&mut self, to: u64) {
        self.stage = [self.stage[1], to];
        (self.tell)(self.stage[0], Self::WHOLE);
    }

    /// So much of so much of the stage is done.
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

    /// Pairs of parts, those first that no placement is known to be worse for.
    fn pairs(&mut self, parts: &[Part]) -> Vec<Near> {
        let parts: Vec<&Part> = parts.iter().filter(|part| part.is_usual()).collect();
        let mut bounds: Vec<(f64, [&Part; 2])> = Vec::new();
        for (i, a) in parts.iter().enumerate() {
            // Of all pairs; those that are placed take as long again.
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
        | (Part::AnglesExchanged { .. }, Part::AnglesExchanged { .. } | Part::ZenithElevation { .. })
        | (Part::ZenithElevation { .. }, Part::AnglesExchanged { .. } | Part::ZenithElevation { .. }) => {
            false
        }
        (Part::Sign { joint: i }, Part::Sign { joint: j })
        | (Part::Offset { joint: i, .. }, Part::Offset { joint: j, .. }) => i != j,
        (Part::AngleUnit { joints: i, .. }, Part::AngleUnit { joints: j, .. }) => {
            i.len() == 1 && j.len() == 1 && i != j
        }
        // Two that undo each other leave the columns as they were read.
        (Part::Order { from: i, .. }, Part::Order { from: j, .. }) => {
            j.iter().enumerate().any(|(joint, column)| i[*column] != joint)
        }
        // Also of one that is meant in both ways.
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
