//! A rigid random walk seen through fixed points at unknown places: likelihood, smoothing, interpolation.
//!
//! The state of the Kalman filter is the walk (displacement of the points' centroid, then the turn times the points' radius, all in m) and the errors
//! of the places, without their rigid part, which is the walk's. Filter and smoother: H. E. Rauch, F. Tung, C. T. Striebel, AIAA J. 3 (1965) 1445.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix3, Matrix6, OMatrix, SMatrix, U3, Vector3, Vector6};

use crate::statistics::{chi2_survival, f_ln_survival};

/// Variance of a state before any reading, m²: a centimetre, far beyond any drift.
pub(super) const BEFORE: f64 = 1e-4;
/// Range of the walk's total variance that is searched, m².
const SPANS: [f64; 2] = [1e-16, 1e-2];
/// Points of the first search along each variance, one per decade.
const DECADES: u32 = 14;
/// Halvings of the interval in the second search: the variance is found within 2 %.
const REFINEMENTS: usize = 10;

/// One reading of a point.
#[derive(Debug, Clone)]
pub(super) struct Sighting {
    /// Which point.
    pub seat: usize,
    /// s
    pub time: f64,
    /// Seen minus mean place of the point, m.
    pub off: Vector3<f64>,
    /// Its covariance, up to the common factor, m².
    pub noise: Matrix3<f64>,
}

/// Points and their readings.
#[derive(Debug, Clone)]
pub(super) struct RandomWalk {
    sightings: Vec<Sighting>,
    /// By the walk, one per seat.
    rigid: Vec<SMatrix<f64, 3, 6>>,
    /// By the errors of the places, three rows per seat.
    loose: DMatrix<f64>,
}

/// Variances of the walk per second, in units of the noise factor: of the centroid along each axis, of the turn times the radius about each axis.
pub(super) type Rates = [f64; 2];

/// The walk at a time of a reading.
#[derive(Debug, Clone)]
pub(super) struct Knot {
    pub time: f64,
    pub mean: Vector6<f64>,
    pub covariance: Matrix6<f64>,
    /// Covariance of the walk here with that at the next knot.
    with_next: Matrix6<f64>,
}

/// What the readings say about a walk.
#[derive(Debug, Clone)]
pub(super) struct Smoothed {
    pub knots: Vec<Knot>,
    /// m²/s, noise factor included.
    pub rates: Rates,
    /// Variance of the readings over the given one.
    pub noise_factor: f64,
    /// -2 ln of the likelihood, up to a constant.
    pub deviance: f64,
    /// For every sighting, ln of the probability of so large an error by chance, given the others' scatter.
    ln_p: Vec<f64>,
    dof: f64,
    /// The errors of the places, in the columns of `loose`, and their covariance.
    places: (DVector<f64>, DMatrix<f64>),
    /// Covariance of the walk at the chosen knots with each other, six rows per knot in the order of time; relative to its mean over all
    /// sightings, whose error is in the mean places.
    pub joint: DMatrix<f64>,
}

struct Filtered {
    deviance: f64,
    noise_factor: f64,
    steps: Vec<Step>,
}

struct Step {
    time: f64,
    /// Sightings behind the last one of this time.
    end: usize,
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
}

impl RandomWalk {
    /// `places` are those of the seats about their centroid, over their radius. `None` of points on one line.
    pub(super) fn new(places: &[Vector3<f64>], mut sightings: Vec<Sighting>) -> Option<Self> {
        sightings.sort_by(|a, b| a.time.total_cmp(&b.time));
        let rigid: Vec<_> = places
            .iter()
            .map(|place| {
                let mut jacobian = SMatrix::<f64, 3, 6>::zeros();
                jacobian.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
                jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&-place.cross_matrix());
                jacobian
            })
            .collect();
        let rows = 3 * places.len();
        let together = DMatrix::from_fn(rows, 6, |row, column| rigid[row / 3][(row % 3, column)]);
        let gram = together.transpose() * &together;
        let factor = Cholesky::new(gram.clone())?;
        let least = gram.symmetric_eigenvalues().min();
        if !(least > 1e-9 * rows as f64) {
            return None;
        }
        let across = DMatrix::identity(rows, rows) - &together * factor.inverse() * together.transpose();
        let eigen = across.symmetric_eigen();
        let columns: Vec<_> =
            (0..rows).filter(|&i| eigen.eigenvalues[i] > 0.5).map(|i| eigen.eigenvectors.column(i)).collect();
        let loose =
            if columns.is_empty() { DMatrix::zeros(rows, 0) } else { DMatrix::from_columns(&columns) };
        Some(Self { sightings, rigid, loose })
    }

    fn states(&self) -> usize {
        6 + self.loose.ncols()
    }

    /// Readings beyond the number that the states need.
    pub(super) fn dof(&self) -> usize {
        (3 * self.sightings.len()).saturating_sub(self.states())
    }

    pub(super) fn sightings(&self) -> &[Sighting] {
        &self.sightings
    }

    /// The same without one sighting.
    pub(super) fn without(&self, index: usize) -> Self {
        let mut rest = self.clone();
        rest.sightings.remove(index);
        rest
    }

    /// From the first to the last sighting, s.
    pub(super) fn span(&self) -> f64 {
        match (self.sightings.first(), self.sightings.last()) {
            (Some(first), Some(last)) => last.time - first.time,
            _ => 0.0,
        }
    }

    fn jacobian(&self, seat: usize) -> OMatrix<f64, U3, Dyn> {
        let mut jacobian = OMatrix::<f64, U3, Dyn>::zeros(self.states());
        jacobian.fixed_view_mut::<3, 6>(0, 0).copy_from(&self.rigid[seat]);
        let own = self.loose.rows(3 * seat, 3);
        jacobian.columns_mut(6, self.loose.ncols()).copy_from(&own);
        jacobian
    }

    /// The Kalman filter over all sightings; its steps are kept if asked for.
    fn filter(&self, rates: Rates, keep: bool) -> Option<Filtered> {
        let mut mean = DVector::zeros(self.states());
        let mut covariance = DMatrix::identity(self.states(), self.states()) * BEFORE;
        let (mut log_det, mut squares) = (0.0, 0.0);
        let mut steps: Vec<Step> = Vec::new();
        let mut time = self.sightings.first()?.time;
        let jacobians: Vec<_> = (0..self.rigid.len()).map(|seat| self.jacobian(seat)).collect();
        for (index, sighting) in self.sightings.iter().enumerate() {
            let passed = sighting.time - time;
            if passed > 0.0 {
                add_walk(&mut covariance, rates, passed);
                time = sighting.time;
            }
            let jacobian = &jacobians[sighting.seat];
            let crossed = &covariance * jacobian.transpose();
            let factor = Cholesky::new(jacobian * &crossed + sighting.noise)?;
            let innovation = sighting.off - jacobian * &mean;
            let weighted = factor.solve(&innovation);
            squares += innovation.dot(&weighted);
            log_det += 2.0 * factor.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>();
            let gain = &crossed * factor.inverse();
            mean += &gain * innovation;
            covariance -= &gain * crossed.transpose();
            if keep {
                let step = Step { time, end: index + 1, mean: mean.clone(), covariance: covariance.clone() };
                match steps.last_mut() {
                    Some(last) if last.time == time => *last = step,
                    _ => steps.push(step),
                }
            }
        }
        let dof = self.dof() as f64;
        let noise_factor = squares / dof;
        let deviance = dof * noise_factor.ln() + log_det;
        deviance.is_finite().then_some(Filtered { deviance, noise_factor, steps })
    }

    fn deviance(&self, rates: Rates) -> f64 {
        self.filter(rates, false).map_or(f64::INFINITY, |filtered| filtered.deviance)
    }

    /// The variances of greatest likelihood; zero if a walk makes the readings no likelier.
    fn most_likely(&self) -> Rates {
        let span = self.span();
        let mut rates = [0.0; 2];
        let mut best = self.deviance(rates);
        let ratio = (SPANS[1] / SPANS[0]).powf(1.0 / f64::from(DECADES));
        // One after the other, twice: the two are nearly independent about the centroid.
        for (pass, which) in [0, 1, 0, 1].into_iter().enumerate() {
            let at = |value: f64| {
                let mut tried = rates;
                tried[which] = value;
                tried
            };
            let mut found = (rates[which], best);
            let look = |value: f64, found: &mut (f64, f64)| {
                let deviance = self.deviance(at(value));
                if deviance < found.1 {
                    *found = (value, deviance);
                }
            };
            if pass < 2 {
                look(0.0, &mut found);
                (0..=DECADES).for_each(|k| look(SPANS[0] * ratio.powf(f64::from(k)) / span, &mut found));
            }
            let mut step = if pass < 2 { ratio.sqrt() } else { 1.5 };
            for _ in 0..REFINEMENTS {
                if found.0 == 0.0 {
                    look(SPANS[0] / span, &mut found);
                    break;
                }
                let middle = found.0;
                look(middle * step, &mut found);
                look(middle / step, &mut found);
                if found.0 == middle {
                    step = step.sqrt();
                }
            }
            (rates[which], best) = found;
        }
        rates
    }

    /// Times of the sightings next to the given `times`, before and behind, ascending.
    pub(super) fn around(&self, times: &[f64]) -> Vec<f64> {
        let mut chosen: Vec<f64> = Vec::new();
        for time in times {
            let behind = self.sightings.partition_point(|sighting| sighting.time <= *time);
            let next_to = [behind.checked_sub(1), Some(behind)].into_iter().flatten();
            chosen
                .extend(next_to.filter_map(|index| self.sightings.get(index)).map(|sighting| sighting.time));
        }
        chosen.sort_by(f64::total_cmp);
        chosen.dedup();
        chosen
    }

    /// The walk of greatest likelihood, or none if `still`, with its joint covariance at the times `chosen` of sightings, ascending. `None` if the
    /// readings do not determine it.
    pub(super) fn smooth(&self, still: bool, chosen: &[f64]) -> Option<Smoothed> {
        if self.dof() == 0 || !(self.span() > 0.0) {
            return None;
        }
        let relative = if still { [0.0; 2] } else { self.most_likely() };
        let filtered = self.filter(relative, true)?;
        let dof = self.dof() as f64;
        let Filtered { deviance, noise_factor, steps } = filtered;
        let mut smoothed = Smoothed {
            knots: Vec::with_capacity(steps.len()),
            rates: relative.map(|rate| rate * noise_factor),
            noise_factor,
            deviance,
            ln_p: vec![0.0; self.sightings.len()],
            dof,
            places: (DVector::zeros(0), DMatrix::zeros(0, 0)),
            joint: DMatrix::zeros(0, 0),
        };
        let mut joint = Joint::new(self.states(), chosen);
        if let Some(last) = steps.last() {
            let count = self.loose.ncols();
            let covariance = last.covariance.view((6, 6), (count, count)) * noise_factor;
            smoothed.places = (last.mean.rows(6, count).into_owned(), covariance);
        }
        let mut later: Option<(DVector<f64>, DMatrix<f64>, f64)> = None;
        for (index, step) in steps.iter().enumerate().rev() {
            let (mean, covariance, with_next) = match later.take() {
                None => (step.mean.clone(), step.covariance.clone(), Matrix6::zeros()),
                Some((next_mean, next_covariance, time)) => {
                    let mut predicted = step.covariance.clone();
                    add_walk(&mut predicted, relative, time - step.time);
                    let gain = Cholesky::new(predicted.clone())?.solve(&step.covariance).transpose();
                    let mean = &step.mean + &gain * (&next_mean - &step.mean);
                    let covariance =
                        &step.covariance + &gain * (&next_covariance - predicted) * gain.transpose();
                    joint.before(&gain);
                    let crossed = &gain * &next_covariance;
                    (mean, covariance, crossed.fixed_view::<6, 6>(0, 0) * noise_factor)
                }
            };
            let start = index.checked_sub(1).map_or(0, |before| steps[before].end);
            for sighting in start..step.end {
                smoothed.ln_p[sighting] = self.ln_p(sighting, &mean, &covariance, noise_factor);
            }
            smoothed.knots.push(Knot {
                time: step.time,
                mean: mean.fixed_rows::<6>(0).into_owned(),
                covariance: covariance.fixed_view::<6, 6>(0, 0) * noise_factor,
                with_next,
            });
            joint.at(step.time, &covariance, (step.end - start) as f64 / self.sightings.len() as f64);
            later = Some((mean, covariance, step.time));
        }
        smoothed.knots.reverse();
        let joint = joint.about_mean() * noise_factor;
        // The prior before the first sighting is wide, and its rounding is not symmetric.
        smoothed.joint = (&joint + joint.transpose()) * 0.5;
        Some(smoothed)
    }

    /// ln of the probability that a sighting is by chance as far off, by the scatter of all others.
    fn ln_p(&self, index: usize, mean: &DVector<f64>, covariance: &DMatrix<f64>, noise_factor: f64) -> f64 {
        let sighting = &self.sightings[index];
        let jacobian = self.jacobian(sighting.seat);
        let residual = sighting.off - &jacobian * mean;
        let spread = sighting.noise - &jacobian * covariance * jacobian.transpose();
        let Some(factor) = Cholesky::new(spread) else { return 0.0 };
        let squares = residual.dot(&factor.solve(&residual));
        let dof = self.dof() as f64;
        let others = (dof * noise_factor - squares) / (dof - 3.0);
        if others > 0.0 && dof > 3.0 { f_ln_survival(squares / (3.0 * others), 3.0, dof - 3.0) } else { 0.0 }
    }

    /// Error (m) of a sighting that was withheld from [`smooth`](Self::smooth), and ln of its probability.
    pub(super) fn off(&self, told: &Smoothed, sighting: &Sighting) -> Option<(f64, f64)> {
        let (mean, covariance) = told.at(sighting.time)?;
        let rigid = &self.rigid[sighting.seat];
        let loose = self.loose.fixed_rows::<3>(3 * sighting.seat);
        let residual = sighting.off - rigid * mean - loose * &told.places.0;
        let of_place = loose * &told.places.1 * loose.transpose();
        let spread = sighting.noise * told.noise_factor + rigid * covariance * rigid.transpose() + of_place;
        let squares = residual.dot(&Cholesky::new(spread)?.solve(&residual));
        Some((residual.norm(), f_ln_survival(squares / 3.0, 3.0, told.dof)))
    }
}

/// Covariance of the walk at chosen knots, filled from the last on: a state depends on later ones only through the smoother's gain.
struct Joint<'a> {
    chosen: &'a [f64],
    covariance: DMatrix<f64>,
    /// Of the state here with the walk at later chosen knots.
    across: DMatrix<f64>,
    /// Of the state here with the mean of the later walk over all sightings.
    behind: DMatrix<f64>,
    /// Of that mean with the walk at the chosen knots, and with itself.
    mean: DMatrix<f64>,
    of_mean: Matrix6<f64>,
}

impl<'a> Joint<'a> {
    fn new(states: usize, chosen: &'a [f64]) -> Self {
        let walks = 6 * chosen.len();
        Self {
            chosen,
            covariance: DMatrix::zeros(walks, walks),
            across: DMatrix::zeros(states, walks),
            behind: DMatrix::zeros(states, 6),
            mean: DMatrix::zeros(6, walks),
            of_mean: Matrix6::zeros(),
        }
    }

    /// Goes to the knot before.
    fn before(&mut self, gain: &DMatrix<f64>) {
        self.across = gain * &self.across;
        self.behind = gain * &self.behind;
    }

    /// `covariance` is that of the state here, where there is this `share` of all sightings.
    fn at(&mut self, time: f64, covariance: &DMatrix<f64>, share: f64) {
        let own: Matrix6<f64> = covariance.fixed_view::<6, 6>(0, 0).into_owned();
        let behind: Matrix6<f64> = self.behind.fixed_view::<6, 6>(0, 0).into_owned();
        self.mean += self.across.rows(0, 6) * share;
        self.of_mean += own * (share * share) + (behind + behind.transpose()) * share;
        if let Some(place) = self.chosen.iter().position(|chosen| *chosen == time) {
            let first = 6 * place;
            self.across.columns_mut(first, 6).copy_from(&covariance.columns(0, 6));
            self.covariance.rows_mut(first, 6).copy_from(&self.across.rows(0, 6));
            self.covariance.columns_mut(first, 6).tr_copy_from(&self.across.rows(0, 6));
            self.mean.columns_mut(first, 6).copy_from(&(own * share + behind.transpose()));
        }
        self.behind += covariance.columns(0, 6) * share;
    }

    /// Of differences from the mean.
    fn about_mean(self) -> DMatrix<f64> {
        let Self { mut covariance, mean, of_mean, .. } = self;
        for first in (0..covariance.nrows()).step_by(6) {
            let own = mean.columns(first, 6).transpose();
            for other in (0..covariance.ncols()).step_by(6) {
                let mut block = covariance.fixed_view_mut::<6, 6>(first, other);
                block += of_mean - &own - mean.columns(other, 6);
            }
        }
        covariance
    }
}

/// What the walk adds in a time.
fn add_walk(covariance: &mut DMatrix<f64>, rates: Rates, passed: f64) {
    for state in 0..6 {
        covariance[(state, state)] += rates[state / 3] * passed;
    }
}

impl Smoothed {
    /// The sightings with the largest errors, the worst first, with ln of their probability.
    pub(super) fn suspects(&self) -> Vec<(usize, f64)> {
        let mut all: Vec<_> = self.ln_p.iter().copied().enumerate().collect();
        all.sort_by(|a, b| a.1.total_cmp(&b.1));
        all
    }

    /// The walk and its covariance at a time: a Brownian bridge between two readings of the walk, growing beyond the last. `None` without
    /// knots.
    pub(super) fn at(&self, time: f64) -> Option<(Vector6<f64>, Matrix6<f64>)> {
        let behind = self.knots.partition_point(|knot| knot.time <= time);
        let grown = |passed: f64| {
            Matrix6::from_diagonal(&Vector6::from_fn(|state, _| self.rates[state / 3] * passed.max(0.0)))
        };
        let (Some(before), Some(after)) =
            (behind.checked_sub(1).and_then(|k| self.knots.get(k)), self.knots.get(behind))
        else {
            let end = if behind == 0 { self.knots.first() } else { self.knots.last() }?;
            return Some((end.mean, end.covariance + grown((time - end.time).abs())));
        };
        let whole = after.time - before.time;
        let part = (time - before.time) / whole;
        let mean = before.mean * (1.0 - part) + after.mean * part;
        let mixed = (before.with_next + before.with_next.transpose()) * (part * (1.0 - part));
        let ends = before.covariance * (1.0 - part).powi(2) + after.covariance * part.powi(2);
        Some((mean, ends + mixed + grown(whole * part * (1.0 - part))))
    }
}

/// Probability that readings without any walk look as much likelier with one by chance. The variances cannot be negative: Self & Liang, J. Am.
/// Stat. Assoc. 82 (1987) 605.
pub(super) fn p_of_walk(still: f64, walking: f64) -> f64 {
    let gained = (still - walking).max(0.0);
    if gained == 0.0 { 1.0 } else { 0.5 * chi2_survival(gained, 1.0) + 0.25 * chi2_survival(gained, 2.0) }
}
