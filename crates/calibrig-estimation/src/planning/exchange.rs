//! Which poses: a greedy start, random ones, and exchanges one by one until none helps.

use rand::RngExt;
use rand::seq::index::sample;
use serde::{Deserialize, Serialize};

use super::closed::Closed;
use super::screened::{Screened, first_of};
use super::space::DesignSpace;
use super::{Criterion, DesignFigures, PlanError};
use calibrig_model::random::{Source, stream};

/// An exchange counts from this change on: of the criterion's value, of the logarithm of a determinant.
const LEAST_GAIN: f64 = 1e-9;

/// Passes over all poses of a design; some five are needed.
const MOST_PASSES: usize = 100;

/// How the values of a criterion for several robots become one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Over {
    /// Their mean (by D of the logarithms; "Bayesian" or "ELD" optimality: K. Chaloner, I. Verdinelli, Statist. Sci. 10 (1995) 273).
    #[default]
    Mean,
    /// The worst of them.
    Worst,
}

/// How many poses, and by what.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Choice {
    /// Poses to choose.
    pub count: usize,
    /// What is minimised.
    pub criterion: Criterion,
    /// Whether a pose may be measured more than once.
    pub repeats: bool,
    /// Random starts beside the greedy one.
    pub starts: u32,
    /// Of these.
    pub seed: u64,
    /// Where there are several robots.
    pub over: Over,
}

impl Choice {
    /// So many poses by I, none twice, from the greedy start and two others.
    pub fn of(count: usize) -> Self {
        Self { count, criterion: Criterion::I, repeats: false, starts: 2, seed: 1, over: Over::Mean }
    }
}

/// Chosen poses.
#[derive(Debug, Clone, PartialEq)]
pub struct Design {
    /// Indices of the candidates, ascending; with repeats one may be there more than once.
    pub chosen: Vec<usize>,
    /// Value of the criterion.
    pub value: f64,
    /// What came of every start: the greedy one first, then designs by criteria that are alike and quicker, then those by chance.
    pub starts: Vec<f64>,
    /// Whether no exchange of one pose betters it by the search's measure.
    pub settled: bool,
    /// What the poses tell, at the first (nominal) space.
    pub figures: DesignFigures,
}

/// Chooses poses of candidates: an exact design, a local optimum under exchanges of single poses and the best of several starts. Of several `spaces`, each is of
/// another robot with the same candidates and parameters.
///
/// From every start the poses are taken in turn, and each is exchanged for the candidate that betters the criterion most, until a turn changes none
/// (V. V. Fedorov 1972; in this order R. D. Cook, C. J. Nachtsheim, Technometrics 22 (1980) 315). Criteria without a closed form of that (E, G, O2 to O5) begin with
/// designs by D and by A (G: I) as well, and look at the most promising candidates of each turn alone.
///
/// # Errors
///
/// [`PlanError`], where the candidates are too few, do not determine the parameters, or are too few coordinates to do so; and without a region for a
/// criterion of one.
pub fn choose(spaces: &[DesignSpace], choice: &Choice) -> Result<Design, PlanError> {
    let mut search = Search::new(spaces, choice)?;
    let mut begun = vec![search.grown(Vec::new(), choice.count)];
    for criterion in choice.criterion.like() {
        let mut other = Search::new(spaces, &Choice { criterion: *criterion, ..*choice })?;
        let grown = other.grown(Vec::new(), choice.count);
        begun.push(other.improved(grown).0);
    }
    begun.extend((1..=choice.starts).map(|start| search.random(choice, start)));
    let mut best: Option<(f64, Vec<usize>, bool)> = None;
    let mut starts = Vec::new();
    for from in begun {
        let (found, settled) = search.improved(from);
        let cost = search.value(&found)?;
        starts.push(cost);
        if best.as_ref().is_none_or(|(least, ..)| cost < *least) {
            best = Some((cost, found, settled));
        }
    }
    let (value, mut chosen, settled) = best.ok_or(PlanError::NoPoses)?;
    chosen.sort_unstable();
    let figures = search.nominal().figures(&chosen)?;
    Ok(Design { chosen, value, starts, settled, figures })
}

/// What a search goes by.
enum Engine<'s> {
    Closed(Vec<Closed<'s>>),
    Screened(Vec<Screened<'s>>),
}

/// A search over the designs of some spaces.
pub(super) struct Search<'s> {
    spaces: &'s [DesignSpace],
    engine: Engine<'s>,
    criterion: Criterion,
    over: Over,
    repeats: bool,
}

impl<'s> Search<'s> {
    pub fn new(spaces: &'s [DesignSpace], choice: &Choice) -> Result<Self, PlanError> {
        let first = spaces.first().ok_or(PlanError::NoCandidates)?;
        for space in spaces {
            for (what, found, expected) in [
                ("the candidates of another robot", space.candidates(), first.candidates()),
                ("the parameters of another robot", space.parameters().len(), first.parameters().len()),
            ] {
                if found != expected {
                    return Err(PlanError::Length { what: what.to_owned(), found, expected });
                }
            }
            if choice.criterion.is_of_region() && space.region() == 0 {
                return Err(PlanError::NoRegion { criterion: choice.criterion });
            }
        }
        if choice.count == 0 {
            return Err(PlanError::NoPoses);
        }
        if !choice.repeats && choice.count > first.candidates() {
            return Err(PlanError::TooFewCandidates { candidates: first.candidates(), wanted: choice.count });
        }
        for space in spaces {
            space.check_count(choice.count)?;
            space.check()?;
        }
        let linear = |space: &DesignSpace| space.linear(choice.criterion);
        let engine = match choice.criterion {
            Criterion::D | Criterion::O1 | Criterion::A | Criterion::I => {
                Engine::Closed(spaces.iter().map(|space| Closed::new(space, linear(space))).collect())
            }
            criterion => Engine::Screened(
                spaces.iter().map(|space| Screened::new(space, criterion, choice.count)).collect(),
            ),
        };
        Ok(Self { spaces, engine, criterion: choice.criterion, over: choice.over, repeats: choice.repeats })
    }

    /// The space that figures are stated of.
    pub fn nominal(&self) -> &'s DesignSpace {
        &self.spaces[0]
    }

    /// Value of the criterion over all spaces, without what holds a search.
    pub fn value(&self, design: &[usize]) -> Result<f64, PlanError> {
        let no_region = || PlanError::NoRegion { criterion: self.criterion };
        let of = |space: &DesignSpace| space.figures(design)?.value(self.criterion).ok_or_else(no_region);
        let values: Vec<f64> = self.spaces.iter().map(of).collect::<Result<_, _>>()?;
        Ok(over(self.over, values.into_iter()))
    }

    fn cost(&self) -> f64 {
        match &self.engine {
            Engine::Closed(all) => over(self.over, all.iter().map(|own| own.cost)),
            Engine::Screened(all) => over(self.over, all.iter().map(|own| own.cost)),
        }
    }

    fn refresh(&mut self, design: &[usize]) {
        match &mut self.engine {
            Engine::Closed(all) => all.iter_mut().for_each(|own| _ = own.refresh(design)),
            Engine::Screened(all) => all.iter_mut().for_each(|own| _ = own.refresh(design)),
        }
    }

    /// The least cost with one of the `allowed` candidates in the place of `leaving`, or on top; the first of those that are alike. An exchange that does not
    /// come below `limit` need not be found.
    fn best(
        &mut self,
        leaving: Option<usize>,
        limit: f64,
        allowed: impl Fn(usize) -> bool,
    ) -> Option<(usize, f64)> {
        let candidates = self.spaces[0].candidates();
        let mut total = vec![f64::INFINITY; candidates];
        match (&mut self.engine, leaving) {
            (Engine::Closed(all), None) => {
                joined(&mut total, self.over, all, Closed::costs_of_entering);
            }
            (Engine::Closed(all), Some(leaving)) => {
                joined(&mut total, self.over, all, |own, costs| own.bounds_of_exchange(leaving, costs));
                return self.best_within(leaving, limit, &total, allowed);
            }
            (Engine::Screened(all), _) => {
                let mut orders = [vec![0.0; candidates], vec![0.0; candidates]];
                for own in all.iter() {
                    for (sums, scores) in orders.iter_mut().zip(own.orders(leaving)) {
                        sums.iter_mut().zip(scores).for_each(|(sum, score)| *sum += score);
                    }
                }
                for candidate in first_of(&orders, &allowed) {
                    let costs = all.iter().map(|own| own.cost_with(leaving, candidate));
                    total[candidate] = over(self.over, costs);
                }
            }
        }
        let allowed =
            total.into_iter().enumerate().filter(|(candidate, cost)| allowed(*candidate) && !cost.is_nan());
        allowed.min_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)))
    }

    /// The best exchange below a limit; costs are computed where their `bounds` are below the best so far.
    fn best_within(
        &mut self,
        leaving: usize,
        mut limit: f64,
        bounds: &[f64],
        allowed: impl Fn(usize) -> bool,
    ) -> Option<(usize, f64)> {
        let Engine::Closed(all) = &mut self.engine else { return None };
        let leavers: Vec<_> = all.iter().map(|own| own.leaver(leaving)).collect();
        let mut best = None;
        let mut look = |candidate: usize, limit: &mut f64| {
            if !(bounds[candidate] < *limit) || !allowed(candidate) {
                return;
            }
            let own = all.iter_mut().zip(&leavers);
            let cost = over(self.over, own.map(|(own, left)| own.cost_of_exchange(leaving, candidate, left)));
            if cost < *limit {
                *limit = cost;
                best = Some((candidate, cost));
            }
        };
        // The most promising one first: it spares most of the others.
        let first = (0..bounds.len()).min_by(|a, b| bounds[*a].total_cmp(&bounds[*b]))?;
        look(first, &mut limit);
        (0..bounds.len()).for_each(|candidate| look(candidate, &mut limit));
        best
    }

    /// A design with the candidates on top, one by one, that better the criterion most.
    pub fn grown(&mut self, mut design: Vec<usize>, count: usize) -> Vec<usize> {
        self.refresh(&design);
        while design.len() < count {
            let repeats = self.repeats;
            let Some((entering, _)) =
                self.best(None, f64::INFINITY, |candidate| repeats || !design.contains(&candidate))
            else {
                break;
            };
            design.push(entering);
            let entered = match &mut self.engine {
                Engine::Closed(all) => all.iter_mut().all(|own| own.enter(entering)),
                Engine::Screened(_) => false,
            };
            if !entered {
                self.refresh(&design);
            }
        }
        design
    }

    fn random(&self, choice: &Choice, start: u32) -> Vec<usize> {
        let mut rng = stream(choice.seed, start, Source::PlannedStarts);
        let candidates = self.spaces[0].candidates();
        if choice.repeats {
            return (0..choice.count).map(|_| rng.random_range(0..candidates)).collect();
        }
        sample(&mut rng, candidates, choice.count).into_vec()
    }

    /// The design after exchanges, and whether none is left that betters it.
    pub fn improved(&mut self, mut design: Vec<usize>) -> (Vec<usize>, bool) {
        for _ in 0..MOST_PASSES {
            // What was updated step by step is computed anew, so that rounding does not add up.
            self.refresh(&design);
            let mut changed = false;
            for place in 0..design.len() {
                changed |= self.exchange(&mut design, place);
            }
            if !changed {
                return (design, true);
            }
        }
        (design, false)
    }

    /// Exchanges a pose of the design for the best candidate, where that is better.
    fn exchange(&mut self, design: &mut [usize], place: usize) -> bool {
        let (leaving, repeats, cost) = (design[place], self.repeats, self.cost());
        let tolerance = match self.criterion {
            Criterion::D | Criterion::O1 => LEAST_GAIN,
            _ => LEAST_GAIN * cost.abs(),
        };
        let limit = if cost.is_finite() { cost - tolerance } else { f64::INFINITY };
        let allowed = |candidate: usize| candidate != leaving && (repeats || !design.contains(&candidate));
        let Some((entering, least)) = self.best(Some(leaving), limit, allowed) else { return false };
        if !(least < limit) {
            return false;
        }
        design[place] = entering;
        let updated = match &mut self.engine {
            Engine::Closed(all) => all.iter_mut().all(|own| own.exchange(entering, leaving)),
            Engine::Screened(_) => false,
        };
        if !updated {
            self.refresh(design);
        }
        true
    }
}

fn over(over: Over, values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    match over {
        Over::Mean => values.sum::<f64>() / count,
        Over::Worst => values.fold(f64::NEG_INFINITY, f64::max),
    }
}

/// What every search says of all candidates, as one.
fn joined<T>(total: &mut [f64], by: Over, all: &[T], of: impl Fn(&T, &mut [f64])) {
    let mut costs = vec![0.0; total.len()];
    let share = 1.0 / all.len() as f64;
    total.fill(if by == Over::Mean { 0.0 } else { f64::NEG_INFINITY });
    for own in all {
        of(own, &mut costs);
        for (total, cost) in total.iter_mut().zip(&costs) {
            *total = if by == Over::Mean { *total + share * cost } else { total.max(*cost) };
        }
    }
}
