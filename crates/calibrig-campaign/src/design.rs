//! Which point of a study a trial is: a function of only the design, the seed and the trial's number.

use calibrig_model::random::{StreamSource, stream};
use rand::distr::Open01;
use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Most factors of a study: the dimensions of the Sobol sequence.
pub const MOST_FACTORS: usize = 256;
/// Most levels of a factor in a screening.
pub const MOST_LEVELS: usize = 1 << 16;
/// Draws are numbered with 32 bits.
const MOST_DRAWS: u64 = 1 << 32;
/// Points of one Sobol sequence, as a power of two.
const SOBOL_BITS: u32 = 16;

/// How points are spread over the unit cube.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Sampling {
    /// Independent points.
    #[default]
    Random,
    /// Points of a Sobol sequence with Owen's scrambling, which are spread more evenly: means over smoothly acting factors have a smaller error.
    ///
    /// From the crate `sobol_burley`, with 23 bits a coordinate, each in the middle of its cell. A sequence has 2^16 points; after that the next
    /// begins, scrambled afresh: blocks of 2^16 points are independent randomised replicates, so that from there on errors fall with the root of
    /// the number of blocks. Evenness is best at powers of two.
    ///
    /// Sources: A. B. Owen, "Randomly permuted (t,m,s)-nets and (t,s)-sequences", in Monte Carlo and Quasi-Monte Carlo Methods in Scientific
    /// Computing (1995), 299-317; B. Burley, "Practical hash-based Owen scrambling", J. Computer Graphics Techniques 9 (2020), no. 4.
    Sobol,
}

/// What a study consists of. A *draw* is everything random in a trial except the factors, such as machine, noise and poses: trials with the
/// same draw differ only by their factors.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "design", rename_all = "snake_case", deny_unknown_fields)]
pub enum Design {
    /// Trials with a separate draw and point each: trial n is draw n.
    Plain {
        /// How many.
        trials: u64,
        /// How many factors vary; without any, only the draws differ.
        factors: usize,
        /// How their points are spread.
        sampling: Sampling,
    },
    /// All combinations of the levels of one or two factors, with common random numbers: trial n is combination n / repeats with draw
    /// n % repeats. The last factor changes fastest.
    Sweep {
        /// Number of levels of each factor.
        levels: Vec<usize>,
        /// Number of trials of each combination.
        repeats: u64,
    },
    /// First-order and total sensitivity indices of k factors from base × (k + 2) trials: see [`SobolSums`](crate::sensitivity::SobolSums). For
    /// row j of the base there are, in order, the points A and B, and k points equal to A except for one factor, which is B's.
    ///
    /// If draws count as a factor, they are the last of k = factors + 1: A has draw 2j, B has draw 2j + 1. Otherwise k = factors and every trial has
    /// draw 0: for studies in which nothing else is random, or of one machine with one noise.
    ///
    /// Source: A. Saltelli et al., "Variance based sensitivity analysis of model output. Design and estimator for the total sensitivity index",
    /// Computer Physics Communications 181 (2010), 259-270.
    Indices {
        /// Rows of the base.
        base: u64,
        /// How many factors vary.
        factors: usize,
        /// Whether the draws count as a factor.
        draws: bool,
        /// How the base is spread. A and B are one point of twice as many dimensions.
        sampling: Sampling,
    },
    /// Elementary effects: trajectories of factors + 1 trials, each of which moves one factor by half of its range, in a random order from a random
    /// start: see [`MorrisSums`](crate::sensitivity::MorrisSums). All trials of a trajectory have its number as their draw.
    ///
    /// Level i of p is the middle (i + 1/2) / p of a share of the factor's distribution and a step is p / 2 levels. (Morris' own grid i / (p - 1) has the
    /// ends of the range on it, which a normal distribution does not have.)
    ///
    /// Source: M. D. Morris, "Factorial sampling plans for preliminary computational experiments", Technometrics 33 (1991), 161-174.
    Screening {
        /// How many.
        trajectories: u64,
        /// How many factors vary.
        factors: usize,
        /// Levels of each factor, an even number.
        levels: usize,
    },
}

/// The place of a factor in a trial.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Coordinate {
    /// The share of the factor's distribution below it, above 0 and below 1.
    Unit(f64),
    /// The number of the factor's level, from zero.
    Level(usize),
}

/// What a trial is.
#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    /// Number of the draw.
    pub draw: u32,
    /// Factor by factor.
    pub at: Vec<Coordinate>,
}

/// What a trial of a screening changed since the trial before.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// Which factor, from zero.
    pub factor: usize,
    /// By which share of its range: a half, up or down.
    pub change: f64,
}

/// What is wrong with a design.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum DesignError {
    /// An empty study.
    #[error("the number of {what} is 0; there must be at least one")]
    None {
        /// Of what.
        what: &'static str,
    },
    /// More draws than numbers of draws.
    #[error("the study has {draws} draws; at most {MOST_DRAWS} are possible")]
    TooManyDraws {
        /// How many.
        draws: u64,
    },
    /// More trials than can be counted.
    #[error("the study has more trials than can be counted; use fewer draws or fewer factors")]
    TooManyTrials,
    /// More factors than dimensions.
    #[error("{factors} factors vary; this design takes at most {most}")]
    TooManyFactors {
        /// How many.
        factors: usize,
        /// The most.
        most: usize,
    },
    /// A sweep of too many factors.
    #[error("the sweep is over {factors} factors; it can be over one or two")]
    SweptFactors {
        /// How many.
        factors: usize,
    },
    /// A grid without a middle, or one that is too fine.
    #[error("a screening has {levels} levels; it needs an even number of at most {MOST_LEVELS}, such as 4")]
    OddLevels {
        /// How many.
        levels: usize,
    },
}

fn some(what: &'static str, number: u64) -> Result<(), DesignError> {
    if number == 0 { Err(DesignError::None { what }) } else { Ok(()) }
}

fn at_most(factors: usize, most: usize) -> Result<(), DesignError> {
    if factors > most { Err(DesignError::TooManyFactors { factors, most }) } else { Ok(()) }
}

fn numbered(draws: u64) -> Result<(), DesignError> {
    if draws > MOST_DRAWS { Err(DesignError::TooManyDraws { draws }) } else { Ok(()) }
}

impl Design {
    /// Whether the design is valid.
    pub fn check(&self) -> Result<(), DesignError> {
        match self {
            Self::Plain { trials, factors, .. } => {
                some("trials", *trials)?;
                at_most(*factors, MOST_FACTORS)?;
                numbered(*trials)
            }
            Self::Sweep { levels, repeats } => check_sweep(levels, *repeats),
            Self::Indices { base, factors, draws, .. } => {
                some("rows of the base design", *base)?;
                some("factors", *factors as u64)?;
                at_most(*factors, MOST_FACTORS / 2)?;
                // Also if the draws are not a factor: points are numbered as draws are.
                numbered(if *draws { base.saturating_mul(2) } else { *base })
            }
            Self::Screening { trajectories, factors, levels } => {
                some("trajectories", *trajectories)?;
                some("factors", *factors as u64)?;
                at_most(*factors, MOST_FACTORS)?;
                some("levels", *levels as u64)?;
                if levels % 2 == 1 || *levels > MOST_LEVELS {
                    return Err(DesignError::OddLevels { levels: *levels });
                }
                numbered(*trajectories)
            }
        }
    }

    /// Number of trials. If [`check`](Self::check) refuses the design, it may be too small.
    pub fn trials(&self) -> u64 {
        match self {
            Self::Plain { trials, .. } => *trials,
            Self::Sweep { levels, repeats } => combinations(levels).saturating_mul(*repeats),
            Self::Indices { base, .. } => base.saturating_mul(self.group()),
            Self::Screening { trajectories, .. } => trajectories.saturating_mul(self.group()),
        }
    }

    /// Number of consecutive trials that belong together: those of a combination, of a row of the base, of a trajectory.
    pub fn group(&self) -> u64 {
        match self {
            Self::Plain { .. } => 1,
            Self::Sweep { repeats, .. } => *repeats,
            Self::Indices { .. } => (self.factors() as u64).saturating_add(2),
            Self::Screening { factors, .. } => (*factors as u64).saturating_add(1),
        }
    }

    /// Number of factors, including the draws if they count as one.
    pub fn factors(&self) -> usize {
        match self {
            Self::Plain { factors, .. } | Self::Screening { factors, .. } => *factors,
            Self::Sweep { levels, .. } => levels.len(),
            Self::Indices { factors, draws, .. } => factors.saturating_add(usize::from(*draws)),
        }
    }

    /// What trial `n` is; `None` for a number that is not below [`trials`](Self::trials) and for a design that [`check`](Self::check) refuses.
    pub fn point(&self, seed: u64, n: u64) -> Option<Point> {
        let (group, within) = self.place(n)?;
        match self {
            Self::Plain { factors, sampling, .. } => {
                Some(Point { draw: group, at: units(sampling.point(seed, group, *factors)) })
            }
            Self::Sweep { levels, .. } => {
                Some(Point { draw: u32::try_from(within).ok()?, at: combination(levels, group.into()) })
            }
            Self::Indices { factors, draws, sampling, .. } => {
                let [a, b] = sampling.pair(seed, group, *factors);
                Some(row(a, &b, within, draws.then_some(group)))
            }
            Self::Screening { factors, levels, .. } => {
                let trajectory = Trajectory::new(seed, group, *factors, *levels);
                Some(Point { draw: group, at: trajectory.at(within, *levels) })
            }
        }
    }

    /// What trial `n` of a screening changed since trial `n - 1`; `None` for the first of a trajectory, where only [`point`](Self::point) applies,
    /// and for other designs.
    pub fn step(&self, seed: u64, n: u64) -> Option<Step> {
        let (group, within) = self.place(n)?;
        let Self::Screening { factors, levels, .. } = self else { return None };
        let trajectory = Trajectory::new(seed, group, *factors, *levels);
        let factor = *trajectory.order.get(usize::try_from(within).ok()?.checked_sub(1)?)?;
        Some(Step { factor, change: if trajectory.rises[factor] { 0.5 } else { -0.5 } })
    }

    /// Group of trial `n` and its place there, if the trial exists. The combinations of a sweep fit as well: its check guarantees it.
    fn place(&self, n: u64) -> Option<(u32, u64)> {
        self.check().ok()?;
        let group = self.group();
        (n < self.trials()).then_some(())?;
        Some((u32::try_from(n / group).ok()?, n % group))
    }
}

fn check_sweep(levels: &[usize], repeats: u64) -> Result<(), DesignError> {
    some("repeats", repeats)?;
    if !(1..=2).contains(&levels.len()) {
        return Err(DesignError::SweptFactors { factors: levels.len() });
    }
    levels.iter().try_for_each(|l| some("levels of a factor", *l as u64))?;
    numbered(repeats)?;
    let combinations = combinations(levels);
    let countable = u32::try_from(combinations).is_ok() && combinations.checked_mul(repeats).is_some();
    if countable { Ok(()) } else { Err(DesignError::TooManyTrials) }
}

fn combinations(levels: &[usize]) -> u64 {
    levels.iter().fold(1, |product: u64, l| product.saturating_mul(*l as u64))
}

/// The levels of a combination; the last one changes fastest.
fn combination(levels: &[usize], mut index: u64) -> Vec<Coordinate> {
    let mut at = vec![Coordinate::Level(0); levels.len()];
    for (coordinate, count) in at.iter_mut().zip(levels).rev() {
        let count = *count as u64;
        // Below a number of levels, which is a `usize`.
        *coordinate = Coordinate::Level(usize::try_from(index % count).unwrap_or(0));
        index /= count;
    }
    at
}

fn units(point: Vec<f64>) -> Vec<Coordinate> {
    point.into_iter().map(Coordinate::Unit).collect()
}

/// Trial `within` of row j of the base: A, B, then A with one factor of B's. The draws are j's where they count.
fn row(mut a: Vec<f64>, b: &[f64], within: u64, counted: Option<u32>) -> Point {
    let swapped = within.checked_sub(2).and_then(|factor| usize::try_from(factor).ok());
    if within == 1 {
        a.copy_from_slice(b);
    } else if let Some(factor) = swapped.filter(|factor| *factor < a.len()) {
        a[factor] = b[factor];
    }
    let of_b = within == 1 || swapped == Some(a.len());
    let draw = counted.map_or(0, |j| j.wrapping_mul(2).wrapping_add(u32::from(of_b)));
    Point { draw, at: units(a) }
}

impl Sampling {
    /// Point `index` of so many dimensions.
    fn point(self, seed: u64, index: u32, dimensions: usize) -> Vec<f64> {
        match self {
            Self::Random => {
                stream(seed, index, StreamSource::Factors).sample_iter(Open01).take(dimensions).collect()
            }
            Self::Sobol => {
                let block = scramble(seed).wrapping_add(index >> SOBOL_BITS);
                let within = index & ((1 << SOBOL_BITS) - 1);
                // The check guarantees this many dimensions.
                (0..sobol_burley::NUM_DIMENSIONS)
                    .take(dimensions)
                    .map(|d| centred(within, d, block))
                    .collect()
            }
        }
    }

    /// The points A and B of row `index`.
    fn pair(self, seed: u64, index: u32, dimensions: usize) -> [Vec<f64>; 2] {
        let mut a = self.point(seed, index, 2 * dimensions);
        let b = a.split_off(dimensions.min(a.len()));
        [a, b]
    }
}

/// Where the scramblings of a seed's blocks begin. They are counted from there, so that all blocks of a study differ.
fn scramble(seed: u64) -> u32 {
    stream(seed, 0, StreamSource::Factors).next_u32()
}

/// A coordinate of a Sobol point: the crate gives the lower end of one of 2^23 cells.
fn centred(index: u32, dimension: u32, block: u32) -> f64 {
    const HALF_A_CELL: f64 = 1.0 / (1 << 24) as f64;
    f64::from(sobol_burley::sample(index, dimension, block)) + HALF_A_CELL
}

/// The path of a screening through the grid.
struct Trajectory {
    /// The lower level of every factor.
    low: Vec<usize>,
    /// Whether a factor's step goes up.
    rises: Vec<bool>,
    /// Which factor moves at which step.
    order: Vec<usize>,
}

impl Trajectory {
    fn new(seed: u64, index: u32, factors: usize, levels: usize) -> Self {
        let mut rng = stream(seed, index, StreamSource::Factors);
        let low = (0..factors).map(|_| below(&mut rng, levels / 2)).collect();
        let rises = (0..factors).map(|_| below(&mut rng, 2) == 1).collect();
        let mut order: Vec<usize> = (0..factors).collect();
        for last in (1..factors).rev() {
            order.swap(last, below(&mut rng, last + 1));
        }
        Self { low, rises, order }
    }

    /// After so many steps.
    fn at(&self, steps: u64, levels: usize) -> Vec<Coordinate> {
        let mut moved = vec![false; self.low.len()];
        for (_, factor) in (0..steps).zip(&self.order) {
            moved[*factor] = true;
        }
        let level = |factor: usize| {
            let high = moved[factor] == self.rises[factor];
            self.low[factor] + if high { levels / 2 } else { 0 }
        };
        (0..self.low.len()).map(|f| Coordinate::Unit((level(f) as f64 + 0.5) / levels as f64)).collect()
    }
}

/// A number below `count`, which is far below 2^32: the upper half of a product of 32 by 32 bits, uneven by `count` parts in 2^32. Written here
/// because `rand` may change the numbers that it gives for a range.
fn below(rng: &mut impl Rng, count: usize) -> usize {
    let product = u64::from(rng.next_u32()).wrapping_mul(count as u64);
    usize::try_from(product >> 32).unwrap_or(0)
}

#[cfg(test)]
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
mod tests;
