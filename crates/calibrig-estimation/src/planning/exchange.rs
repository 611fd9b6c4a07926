//! Chooses poses: a greedy start, random starts, and exchanges of single poses until none helps.

use rand::RngExt;
use rand::seq::index::sample;
use serde::{Deserialize, Serialize};

use super::closed::Closed;
use super::screened::{Screened, first_of};
use super::space::DesignSpace;
use super::{Criterion, DesignFigures, PlanError};
use calibrig_model::random::{StreamSource, stream};

/// Least change that counts as an improvement: of the criterion's value, or of the logarithm of a determinant.
const LEAST_GAIN: f64 = 1e-9;

/// Most passes over all poses of a design; about five are needed.
const MOST_PASSES: usize = 100;

/// How the values of a criterion for several robots are combined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Over {
    /// Their mean (for D, the mean of the logarithms; "Bayesian" or "ELD" optimality: K. Chaloner, I. Verdinelli, Statist. Sci. 10 (1995) 273).
    #[default]
    Mean,
    /// The worst value.
    Worst,
}

/// Number of poses to choose, and the criterion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Choice {
    /// Number of poses to choose.
    pub count: usize,
    /// Criterion that is minimised.
    pub criterion: Criterion,
    /// Whether a pose may be measured more than once.
    pub repeats: bool,
    /// Number of random starts beside the greedy one.
    pub starts: u32,
    /// Seed of the random starts.
    pub seed: u64,
    /// How the values for several robots are combined.
    pub over: Over,
}

impl Choice {
    /// A choice of this many poses by I, none twice, from the greedy start and two others.
    pub fn of(count: usize) -> Self {
        Self { count, criterion: Criterion::I, repeats: false, starts: 2, seed: 1, over: Over::Mean }
    }
}

/// Chosen poses.
#[derive(Debug, Clone, PartialEq)]
pub struct Design {
    /// Indices of the candidates, ascending; with repeats, an index may occur more than once.
    pub chosen: Vec<usize>,
    /// Value of the criterion.
    pub value: f64,
    /// Value reached from every start: the greedy one first, then designs by similar but faster criteria, then the random ones.
    pub starts: Vec<f64>,
    /// Whether no exchange of one pose improves it by the measure of the search.
    pub settled: bool,
    /// Figures of the chosen poses, for the first (nominal) space.
    pub figures: DesignFigures,
}

/// Chooses poses among candidates: an exact design that is a local optimum under exchanges of single poses, and the best of several starts. Each of
/// several `spaces` belongs to another robot with the same candidates and parameters.
///
/// From every start the poses are considered in turn, and each is exchanged for the candidate that improves the criterion most, until a pass changes
/// none (V. V. Fedorov 1972; in this order R. D. Cook, C. J. Nachtsheim, Technometrics 22 (1980) 315). Criteria without a closed form for this (E, G,
/// O2 to O5) also start from designs by D and by A (G: I), and consider only the most promising candidates for each exchange.
///
/// # Errors
///
/// [`PlanError`], where there are too few candidates, or they do not determine the parameters, or too few poses are chosen to do so; and for a
/// criterion of a region without a region.
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

/// Implementation of the criterion in a search.
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

    /// The space for which figures are stated.
    pub fn nominal(&self) -> &'s DesignSpace {
        &self.spaces[0]
    }

    /// Value of the criterion over all spaces, without the ridge of the search.
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

    /// The least cost with one of the `allowed` candidates in place of `leaving`, or added if there is none; the first of equal ones. An exchange
    /// with a cost above `limit` need not be found.
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

    /// The best exchange below a limit; costs are computed only where their `bounds` are below the best so far.
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
        // The most promising candidate comes first: it makes most others unnecessary.
        let first = (0..bounds.len()).min_by(|a, b| bounds[*a].total_cmp(&bounds[*b]))?;
        look(first, &mut limit);
        (0..bounds.len()).for_each(|candidate| look(candidate, &mut limit));
        best
    }

    /// A design extended, one by one, by the candidates that improve the criterion most.
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
        let mut rng = stream(choice.seed, start, StreamSource::PlannedStarts);
        let candidates = self.spaces[0].candidates();
        if choice.repeats {
            return (0..choice.count).map(|_| rng.random_range(0..candidates)).collect();
        }
        sample(&mut rng, candidates, choice.count).into_vec()
    }

    /// The design after exchanges, and whether no improving exchange is left.
    pub fn improved(&mut self, mut design: Vec<usize>) -> (Vec<usize>, bool) {
        for _ in 0..MOST_PASSES {
            // Recomputes what was updated step by step, so that rounding does not accumulate.
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

    /// Exchanges a pose of the design for the best candidate, if that is better.
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

/// Combines the values of all searches for every candidate.
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
