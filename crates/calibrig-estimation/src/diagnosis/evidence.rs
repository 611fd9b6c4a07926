//! Marginal likelihood of a hypothesis: how well a robot with realistic errors of its links explains the points.
//!
//! Links are off by `tau` times a millimetre and a milliradian, readings by `sigma`; the tracker's place and unknown targets are free. Both
//! sizes are found with the fit, links and places are integrated out: an explanation by links that no manufacturer would deliver, or by a large
//! scatter, counts less than one with which the robot fits the points. D. J. C. `MacKay`, "Bayesian interpolation", Neural Computation 4 (1992) 415;
//! the flat priors of places as in restricted maximum likelihood (D. A. Harville, JASA 72 (1977) 320).

use std::f64::consts::TAU;

use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Vector3};

use super::place::Placed;
use super::session::View;
use crate::kinematics::KinematicChain;
use calibrig_model::LinkTerm;

/// Gauss-Newton iterations.
const ROUNDS: usize = 3;
/// Errors of links at `tau` = 1, m and rad.
const USUAL: f64 = 1e-3;
const TERMS: [LinkTerm; 5] = [LinkTerm::A, LinkTerm::Alpha, LinkTerm::Beta, LinkTerm::D, LinkTerm::Theta];
/// Smallest scatter, m, so that exact points have a finite likelihood.
const LEAST_SIGMA: f64 = 2e-6;
/// Range of `tau`: links that are off by more do not belong to this robot.
const TAUS: [f64; 2] = [0.02, 20.0];
/// Widths of the prior of `tau`, in ln, above 1 and below.
const WIDTHS: [f64; 2] = [1.2, 4.0];
/// Least standard deviation of an offset, m.
const LEAST_OFFSET: f64 = 1e-4;
/// Least standard deviations of a robot's base in the frame of the nests, m and rad.
const LEAST_PLACE: [f64; 2] = [2e-3, 3e-3];
/// A fit ends where a step would move an offset farther than this, m.
const FARTHEST_OFFSET: f64 = 100.0;
/// Undetermined places stay about where they are, as if they were known to a third of a metre or of a radian where a coordinate is known to a
/// tenth of a millimetre.
const OPEN: f64 = 1e-7;

/// The fit of a hypothesis, with results for every row.
pub(super) struct HypothesisFit {
    /// `tracker_from_base` of the stations, and offsets of the targets.
    pub placed: Placed,
    /// Twice the negative logarithm of the marginal likelihood of the rows that were fitted.
    pub score: f64,
    /// Standard deviation of a coordinate, m.
    pub sigma: f64,
    /// RMS residual with links fitted, m.
    pub rms: f64,
    /// Squared distance of every row from what the others predict, in standard deviations.
    pub far: Vec<f64>,
    /// Fitted position of every row's target in the base frame, m.
    pub in_base: Vec<Vector3<f64>>,
    /// Covariance of this position, m².
    covariance: Vec<Matrix3<f64>>,
}

/// Meaning of the Jacobian's columns: first free places, then parameters with a prior (links, stated offsets, and stations that nests place).
struct Layout {
    places: usize,
    /// First column of every station: three translations, three rotations.
    stations: Vec<usize>,
    /// First column of every target, and the standard deviation of its offset, m.
    targets: Vec<(usize, Option<f64>)>,
    columns: usize,
}

impl Layout {
    fn new(view: &View) -> Self {
        let mut places = 0;
        let mut stations = vec![0; view.stations];
        for (station, _) in stations.iter_mut().zip(&view.registered).filter(|(_, known)| known.is_none()) {
            *station = places;
            places += 6;
        }
        let mut targets = vec![(0, None); view.offsets.len()];
        for (target, sigma) in targets.iter_mut().zip(&view.offset_sigma) {
            if sigma.is_none() {
                *target = (places, None);
                places += 3;
            }
        }
        let mut columns = places + TERMS.len() * view.chain.links.len();
        for (target, sigma) in targets.iter_mut().zip(&view.offset_sigma) {
            if let Some(sigma) = sigma {
                *target = (columns, Some(sigma.max(LEAST_OFFSET)));
                columns += 3;
            }
        }
        for (station, _) in stations.iter_mut().zip(&view.registered).filter(|(_, known)| known.is_some()) {
            *station = columns;
            columns += 6;
        }
        Self { places, stations, targets, columns }
    }
}

/// The linear system at one placement.
struct System {
    /// Residuals, measured minus predicted in the base frame, one per row of the view.
    left: Vec<Vector3<f64>>,
    /// Jacobian with the columns of the layout, in the base frame; three rows per row of the view.
    jacobian: DMatrix<f64>,
    places: usize,
}

/// The system, with its solution for the sizes that explain it best.
struct Solution {
    step: DVector<f64>,
    covariance: DMatrix<f64>,
    score: f64,
    sigma: f64,
    freedom: f64,
}

/// Fits the rows of `view` that are marked in `kept`, from `start`.
pub(super) fn fit(view: &View, start: &Placed, kept: &[bool]) -> Option<HypothesisFit> {
    let layout = Layout::new(view);
    // Parameters with a prior: deviations in units of the prior's standard deviation.
    let mut held = DVector::<f64>::zeros(layout.columns - layout.places);
    let mut now = start.clone();
    for (target, (column, sigma)) in layout.targets.iter().enumerate() {
        if let Some(sigma) = sigma {
            let by = (now.offsets[target] - view.offsets[target]) / *sigma;
            (0..3).for_each(|k| held[column - layout.places + k] = by[k]);
        }
    }
    for ((rotation, shift), (column, known)) in
        now.stations.iter().zip(layout.stations.iter().zip(&view.registered))
    {
        if let Some((from, at)) = known {
            let turn = Rotation3::from_matrix_unchecked(from.tr_mul(rotation)).scaled_axis() / LEAST_PLACE[1];
            let by = from.tr_mul(&(shift - at)) / LEAST_PLACE[0];
            (0..3).for_each(|k| held[column - layout.places + k] = by[k]);
            (0..3).for_each(|k| held[column - layout.places + 3 + k] = turn[k]);
        }
    }
    let mut chain = KinematicChain::new(&view.chain);
    for round in 0..=ROUNDS {
        let mut changed = view.chain.clone();
        for (index, value) in held.iter().take(TERMS.len() * changed.links.len()).enumerate() {
            *changed.links[index / TERMS.len()].term_mut(TERMS[index % TERMS.len()]) += USUAL * value;
        }
        chain.set_model(&changed);
        let (system, in_base) = system(view, &layout, &mut chain, &now);
        let solution = system.solve(kept, &held)?;
        // Where nothing fits, steps can lead anywhere: the placement so far is the result.
        let is_far = (0..view.offsets.len()).any(|t| {
            let column = layout.targets[t].0;
            (0..3).any(|k| solution.step[column + k].abs() > FARTHEST_OFFSET)
        });
        if round == ROUNDS || is_far {
            let mut fit = told(now, &system, in_base, &solution, kept);
            // The likelihood is that of a linear system: where the nonlinear solution is elsewhere, the actual residual is worse than it says.
            let freedom = solution.freedom;
            let rows = kept.iter().filter(|is_kept| **is_kept).count() as f64;
            let left = (rows * fit.rms * fit.rms / freedom).max(LEAST_SIGMA * LEAST_SIGMA);
            fit.score = fit.score.max(freedom * ((TAU * left).ln() + 1.0));
            return Some(fit);
        }
        let at = |column: usize| solution.step[column];
        for (s, (rotation, shift)) in now.stations.iter_mut().enumerate() {
            let turn = Vector3::from_fn(|k, _| at(layout.stations[s] + 3 + k));
            let by = Vector3::from_fn(|k, _| at(layout.stations[s] + k));
            let sizes = if let Some(known) = view.registered[s] {
                (*rotation, *shift) = known;
                LEAST_PLACE
            } else {
                [1.0, 1.0]
            };
            *shift += *rotation * by * sizes[0];
            *rotation *= Rotation3::new(turn * sizes[1]).into_inner();
        }
        held.iter_mut().enumerate().for_each(|(index, value)| *value = at(layout.places + index));
        for (t, (column, sigma)) in layout.targets.iter().enumerate() {
            let by = Vector3::from_fn(|k, _| at(column + k));
            match sigma {
                Some(sigma) => now.offsets[t] = view.offsets[t] + *sigma * by,
                None => now.offsets[t] += by,
            }
        }
    }
    None
}

fn system(
    view: &View,
    layout: &Layout,
    chain: &mut KinematicChain,
    now: &Placed,
) -> (System, Vec<Vector3<f64>>) {
    let n = view.chain.links.len();
    let places = layout.places;
    let mut jacobian = DMatrix::zeros(3 * view.rows.len(), layout.columns);
    let (mut left, mut in_base) = (Vec::with_capacity(view.rows.len()), Vec::with_capacity(view.rows.len()));
    for (row, joints) in view.joints.chunks_exact(n).enumerate() {
        chain.place(joints);
        let (station, target) = (view.station[row], view.target[row]);
        let at = chain.target(&now.offsets[target]);
        let (rotation, shift) = &now.stations[station];
        left.push(rotation.tr_mul(&(view.seen[row] - shift)) - at);
        in_base.push(at);
        let mut put = |column: usize, value: Vector3<f64>| {
            (0..3).for_each(|k| jacobian[(3 * row + k, column)] = value[k]);
        };
        let (of_target, sigma) = layout.targets[target];
        let of_station = layout.stations[station];
        let sizes = if view.registered[station].is_some() { LEAST_PLACE } else { [1.0, 1.0] };
        for k in 0..3 {
            let mut axis = Vector3::zeros();
            axis[k] = 1.0;
            put(of_station + k, axis * sizes[0]);
            put(of_station + 3 + k, axis.cross(&at) * sizes[1]);
            let axes = chain.base_from_flange().rotation.matrix().column(k).into_owned();
            put(of_target + k, sigma.unwrap_or(1.0) * axes);
        }
        for link in 0..n {
            for (index, term) in TERMS.into_iter().enumerate() {
                put(places + TERMS.len() * link + index, USUAL * chain.link_column(link, term, &at));
            }
        }
    }
    (System { left, jacobian, places }, in_base)
}

impl System {
    fn solve(&self, kept: &[bool], held: &DVector<f64>) -> Option<Solution> {
        let rows: Vec<usize> = (0..self.left.len()).filter(|row| kept[*row]).collect();
        let columns = self.jacobian.ncols();
        let (places, of_links) = (self.places, columns - self.places);
        let mut all = DMatrix::<f64>::zeros(3 * rows.len(), columns + 1);
        for (to, row) in rows.iter().enumerate() {
            let block = self.jacobian.rows(3 * row, 3);
            all.view_mut((3 * to, 0), (3, columns)).copy_from(&block);
            // The prior applies to the complete deviations, including those so far.
            let y = self.left[*row] + block.columns(places, of_links) * held;
            (0..3).for_each(|k| all[(3 * to + k, columns)] = y[k]);
        }
        let gram = all.tr_mul(&all);
        let xx = gram.view((0, 0), (places, places)).into_owned();
        let (inverse, log_places, told) = inverse_of_places(xx);
        let x_rest = gram.view((0, places), (places, of_links + 1)).into_owned();
        let taken = &inverse * &x_rest;
        let rest = gram.view((places, places), (of_links + 1, of_links + 1)) - x_rest.tr_mul(&taken);
        let m = rest.view((0, 0), (of_links, of_links)).into_owned();
        let b = rest.view((0, of_links), (of_links, 1)).column(0).into_owned();
        let squares = rest[(of_links, of_links)].max(0.0);
        let spectrum = m.symmetric_eigen();
        let along = spectrum.eigenvectors.tr_mul(&b);
        let freedom = (3 * rows.len()).checked_sub(told)?;
        let sizes = Sizes::new(&spectrum.eigenvalues, &along, squares, freedom)?;
        let (sigma, tau, best) = sizes.best();
        let damping = (sigma / tau).powi(2);
        let shrunk = spectrum.eigenvalues.map(|value| 1.0 / (value.max(0.0) + damping));
        let links = &spectrum.eigenvectors * along.component_mul(&shrunk);
        let link_covariance = &spectrum.eigenvectors
            * DMatrix::from_diagonal(&(sigma * sigma * shrunk))
            * spectrum.eigenvectors.transpose();
        let by_links = taken.columns(0, of_links).into_owned();
        let mut step = DVector::zeros(columns);
        step.rows_mut(0, places).copy_from(&(taken.column(of_links) - &by_links * &links));
        step.rows_mut(places, of_links).copy_from(&links);
        let cross = -&by_links * &link_covariance;
        let mut covariance = DMatrix::zeros(columns, columns);
        let of_places = sigma * sigma * inverse - &cross * by_links.transpose();
        covariance.view_mut((0, 0), (places, places)).copy_from(&of_places);
        covariance.view_mut((0, places), (places, of_links)).copy_from(&cross);
        covariance.view_mut((places, 0), (of_links, places)).copy_from(&cross.transpose());
        covariance.view_mut((places, places), (of_links, of_links)).copy_from(&link_covariance);
        let score = best + log_places;
        (score.is_finite() && step.iter().all(|v| v.is_finite())).then_some(Solution {
            step,
            covariance,
            score,
            sigma,
            freedom: freedom as f64,
        })
    }
}

/// Inverse of the places' information, the logarithm of its determinant, and the number of directions that are determined.
fn inverse_of_places(information: DMatrix<f64>) -> (DMatrix<f64>, f64, usize) {
    // Nests and targets state all places.
    if information.is_empty() {
        return (information, 0.0, 0);
    }
    let eigen = information.symmetric_eigen();
    let eased = eigen.eigenvalues.map(|value| value.max(0.0) + OPEN);
    let inverse = &eigen.eigenvectors
        * DMatrix::from_diagonal(&eased.map(|value| 1.0 / value))
        * eigen.eigenvectors.transpose();
    let told = eigen.eigenvalues.iter().filter(|value| **value > OPEN).count();
    (inverse, eased.iter().map(|value| value.ln()).sum(), told)
}

/// The likelihood as a function of the two sizes, from the coordinates along the links' principal directions and the part that no link explains.
struct Sizes {
    /// Squared effect of one unit of a direction, and squared coordinate along it.
    directions: Vec<(f64, f64)>,
    /// Sum of squares that no link explains, m².
    squares: f64,
    freedom: f64,
}

impl Sizes {
    fn new(values: &DVector<f64>, along: &DVector<f64>, squares: f64, freedom: usize) -> Option<Self> {
        let least = 1e-12 * values.amax();
        let told = values.iter().zip(along.iter()).filter(|(value, _)| **value > least);
        let mut directions: Vec<(f64, f64)> = told.map(|(value, b)| (*value, b * b / value)).collect();
        directions.sort_by(|a, b| b.0.total_cmp(&a.0));
        directions.truncate(freedom);
        let explained: f64 = directions.iter().map(|(_, square)| square).sum();
        Some(Self { squares: (squares - explained).max(0.0), freedom: freedom as f64, directions })
            .filter(|sizes| sizes.freedom > 0.0)
    }

    fn at(&self, ln_sigma: f64, ln_tau: f64) -> f64 {
        let (noise, links) = ((2.0 * ln_sigma).exp(), (2.0 * ln_tau).exp());
        let mut product = 1.0_f64;
        let mut sum = 0.0;
        for (value, square) in &self.directions {
            let variance = noise + links * value;
            sum += square / variance;
            product *= variance / noise;
            if product > 1e200 {
                sum += product.ln();
                product = 1.0;
            }
        }
        let unusual = ln_tau / if ln_tau > 0.0 { WIDTHS[0] } else { WIDTHS[1] };
        sum + product.ln()
            + self.freedom * (2.0 * ln_sigma + TAU.ln())
            + self.squares / noise
            + unusual * unusual
    }

    /// Scatter, size of the links' deviations, and twice the negative logarithm of the likelihood there.
    fn best(&self) -> (f64, f64, f64) {
        let total = self.squares + self.directions.iter().map(|(_, square)| square).sum::<f64>();
        let highest = (total / self.freedom).sqrt().max(2.0 * LEAST_SIGMA).ln();
        let least = LEAST_SIGMA.ln();
        let ends = [TAUS[0].ln(), TAUS[1].ln()];
        let mut best = (highest, 0.0, f64::INFINITY);
        let look = |s: f64, t: f64, best: &mut (f64, f64, f64)| {
            let (s, t) = (s.max(least), t.clamp(ends[0], ends[1]));
            let value = self.at(s, t);
            if value < best.2 {
                *best = (s, t, value);
            }
        };
        let steps = 10;
        for i in 0..=steps {
            let s = least + (highest - least) * f64::from(i) / f64::from(steps);
            for t in [0.05_f64, 0.3, 1.0, 3.0, 10.0] {
                look(s, t.ln(), &mut best);
            }
        }
        let mut size = 0.7;
        while size > 5e-3 {
            let (s, t, before) = best;
            for (ds, dt) in [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)] {
                look(s + size * ds, t + size * dt, &mut best);
            }
            if best.2 >= before - 1e-3 {
                size *= 0.5;
            }
        }
        (best.0.exp(), best.1.exp(), best.2)
    }
}

fn told(
    placed: Placed,
    system: &System,
    in_base: Vec<Vector3<f64>>,
    solution: &Solution,
    kept: &[bool],
) -> HypothesisFit {
    let variance = solution.sigma * solution.sigma;
    let (mut far, mut covariance) = (Vec::with_capacity(kept.len()), Vec::with_capacity(kept.len()));
    let (mut squares, mut count) = (0.0, 0);
    for (row, is_kept) in kept.iter().enumerate() {
        let block = system.jacobian.rows(3 * row, 3);
        let spread: DMatrix<f64> = block * &solution.covariance * block.transpose();
        let spread = Matrix3::from_fn(|i, j| spread[(i, j)]);
        let left = system.left[row];
        let of_left = if *is_kept {
            // Distance from what the others predict, by leverage.
            squares += left.norm_squared();
            count += 1;
            Matrix3::identity() * variance - spread
        } else {
            Matrix3::identity() * variance + spread
        };
        let eigen = of_left.symmetric_eigen();
        let along = eigen.eigenvectors.tr_mul(&left);
        let terms = eigen.eigenvalues.iter().zip(along.iter()).filter(|(v, _)| **v > 1e-6 * variance);
        far.push(terms.map(|(v, a)| a * a / v).sum());
        covariance.push(spread);
    }
    HypothesisFit {
        placed,
        score: solution.score,
        sigma: solution.sigma,
        rms: (squares / f64::from(count.max(1))).sqrt(),
        far,
        in_base,
        covariance,
    }
}

impl HypothesisFit {
    /// Squared distance, in standard deviations, of a point (m, in the tracker's frame) from where `row`'s target is; and the distance, m.
    pub fn distance(&self, view: &View, row: usize, seen: &Vector3<f64>) -> (f64, f64) {
        let (rotation, shift) = &self.placed.stations[view.station[row]];
        let left = rotation.tr_mul(&(seen - shift)) - self.in_base[row];
        let variance = Matrix3::identity() * self.sigma * self.sigma + self.covariance[row];
        let squared = variance.cholesky().map_or(f64::INFINITY, |c| left.dot(&c.solve(&left)));
        (squared, left.norm())
    }
}

/// The system at a placement with nominal links: Jacobian, residuals, and the number of columns that are places.
#[cfg(test)]
pub(super) fn dense(view: &View, placed: &Placed) -> (DMatrix<f64>, DVector<f64>, usize) {
    let layout = Layout::new(view);
    let (system, _) = system(view, &layout, &mut KinematicChain::new(&view.chain), placed);
    let y = DVector::from_iterator(3 * system.left.len(), system.left.iter().flat_map(|v| v.iter().copied()));
    (system.jacobian, y, system.places)
}
