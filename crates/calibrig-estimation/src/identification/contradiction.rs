//! Tests what was stated beforehand against the measurements: priors and nests that do not fit the rest of the system.
//!
//! A prior is a row (nests and target: a block of rows) of the least-squares problem. Its residual at the minimum has the covariance
//! `Q = 1 - H`, H its block of the hat matrix, so that `rᵀ Q⁻¹ r` is chi-square if everything stated is right; for a single row it is the
//! square of the normalised residual `w = r / sqrt(1 - h)`. The worst is removed from the system and the others are tested without it,
//! so that one wrong prior does not put the blame on those that it pulls.
//!
//! Source: W. Baarda, "A testing procedure for use in geodetic networks", Netherlands Geodetic Commission, New Series 2 (5), 1968 (the
//! test of one row); one row after the other at Bonferroni's level.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::ops::Range;

use nalgebra::{DMatrix, DVector, SymmetricEigen, Vector3};

use super::factor::triangular_factor_of_all;
use super::limits::shown;
use super::problem::CalibrationProblem;
use super::solver::Solution;
use super::{FrameChoice, NoiseScale};
use calibrig_model::measurement::{
    MeasurementSet, NestSystem, StatedInstrument, Station, WhitenedNest, nest_system,
};
use calibrig_model::statistics::{chi2_survival, f_ln_survival};
use calibrig_model::{ParameterId, Unit};

/// Probability of naming any prior or nest of an estimate although everything stated is right.
pub const CONTRADICTION_LEVEL: f64 = 1e-3;

/// A direction of a prior cannot be contradicted where the rest of the system determines less than this share of it.
const CHECKED: f64 = 1e-3;

/// Like [`CHECKED`], for a prior on one parameter. The parameter can be far larger than its prior, such as a stiffness that is stated a thousand
/// times too high, and is then determined although this share is small.
const CHECKED_ALONE: f64 = 1e-6;

/// Two priors cannot be separated if they share more than this of what contradicts them.
const SHARED: f64 = 0.9;

/// A statement made beforehand that does not fit the rest of the system.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Contradiction {
    /// What was stated.
    pub stated: Stated,
    /// Square of the discrepancy in its own standard deviations.
    pub chi2: f64,
    /// Number of its coordinates: the mean of `chi2` if nothing is wrong.
    pub freedom: usize,
    /// Names of what may be wrong instead, because the rest of the system cannot separate the two.
    pub or: Vec<String>,
}

/// What was stated, and where the rest of the system puts it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stated {
    /// The prior of a parameter, SI.
    Parameter {
        /// Parameter of the prior.
        id: ParameterId,
        /// Where the measurements and the other priors put it.
        found: f64,
        /// Standard deviation of `found`.
        sigma: f64,
        /// Standard deviation of its prior about zero.
        prior_sigma: f64,
    },
    /// The place of a station by its nests.
    Nests {
        /// Name of the station.
        station: String,
        /// Distance between this place and where the measurements of the robot put the station, m.
        length: f64,
        /// Angle between the two orientations, rad.
        angle: f64,
    },
    /// The place of a station by sweeps of two axes.
    Sweeps {
        /// Name of the station.
        station: String,
        /// Distance between this place and where the measurements of the robot put the station, m.
        length: f64,
        /// Angle between the two orientations, rad.
        angle: f64,
    },
    /// The measured offset of a target.
    Target {
        /// Name of the target.
        target: String,
        /// Distance between the offset and where the measurements of the robot put the target, m.
        length: f64,
    },
    /// The measured orientation of a target on the flange.
    Orientation {
        /// Name of the target.
        target: String,
        /// Angle between this orientation and that from the measurements of the robot, rad.
        angle: f64,
    },
    /// The certified place of a nest.
    Nest {
        /// Name of the nest.
        nest: String,
        /// Name of the station that measured it.
        station: String,
        /// Distance between this place and where the other nests put it, m.
        length: f64,
    },
}

impl Stated {
    /// Name of the parameter, or of the nests, target or nest.
    pub fn name(&self) -> String {
        match self {
            Self::Parameter { id, .. } => id.to_string(),
            Self::Nests { station, .. } => format!("the nests of station {station}"),
            Self::Sweeps { station, .. } => format!("the sweeps of station {station}"),
            Self::Target { target, .. } => format!("the offset of target {target}"),
            Self::Orientation { target, .. } => format!("the orientation of target {target}"),
            Self::Nest { nest, station, .. } => format!("nest \"{nest}\" of station {station}"),
        }
    }
}

impl Contradiction {
    /// Words for a lower bound, where the rest of the system determines only some of the `coordinates`.
    fn at_least(&self, coordinates: usize) -> &'static str {
        if self.freedom < coordinates { "at least " } else { "" }
    }
}

impl fmt::Display for Contradiction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.stated.name())?;
        let metres = |length: f64| shown(Unit::Metre, rounded(length));
        match &self.stated {
            Stated::Parameter { id, found, sigma, prior_sigma } => {
                let [found, sigma, prior] =
                    [*found, *sigma, *prior_sigma].map(|v| shown(id.unit(), rounded(v)));
                write!(f, " (they put it at {found} +- {sigma}, the prior at 0 +- {prior}")?;
            }
            Stated::Nests { length, angle, .. } | Stated::Sweeps { length, angle, .. } => {
                let (least, angle) = (self.at_least(6), shown(Unit::Radian, rounded(*angle)));
                write!(f, " (they put the base {least}{} and {angle} from there", metres(*length))?;
            }
            Stated::Target { length, .. } => {
                write!(f, " (they put it {}{} from there", self.at_least(3), metres(*length))?;
            }
            Stated::Orientation { angle, .. } => {
                let (least, angle) = (self.at_least(3), shown(Unit::Radian, rounded(*angle)));
                write!(f, " (they put it {least}{angle} from there")?;
            }
            Stated::Nest { length, .. } => {
                write!(f, " (the other nests put it {} from there", metres(*length))?;
            }
        }
        match self.freedom {
            1 => write!(f, ": {:.1} sigma", self.chi2.sqrt())?,
            n => write!(f, ": chi-square {:.0} of {n}", self.chi2)?,
        }
        match self.or.as_slice() {
            [] => f.write_str(")"),
            others => write!(f, "; or the value stated for {} is wrong instead)", others.join(" or ")),
        }
    }
}

/// Rounds to three digits.
fn rounded(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}

/// Rows that belong together, and their source.
#[derive(Clone)]
struct RowGroup {
    rows: Range<usize>,
    kind: Kind,
}

#[derive(Clone)]
enum Kind {
    /// Index of a prior of the problem.
    Block(usize),
    /// Column of a parameter and standard deviation of its own prior.
    Own(usize, f64),
    /// Indices of the station and of the nest in it.
    Nest(usize, usize),
}

/// Residuals with their covariance.
struct Family {
    residuals: DVector<f64>,
    covariance: DMatrix<f64>,
    groups: Vec<RowGroup>,
}

/// A group that does not fit the others.
struct Outcast {
    /// Index in the family.
    group: usize,
    chi2: f64,
    freedom: usize,
    /// Its residuals if it is left out of the fit.
    left_out: DVector<f64>,
    /// Covariance of these residuals.
    spread: DMatrix<f64>,
    /// Groups that cannot be separated from it.
    rivals: Vec<usize>,
}

/// A group that is too far off in the current system.
struct Suspect {
    group: usize,
    block: GroupBlock,
    left_out: DVector<f64>,
    chi2: f64,
}

/// A group's block of the family, inverted where the rest of the system determines it.
struct GroupBlock {
    inverse: DMatrix<f64>,
    freedom: usize,
}

impl GroupBlock {
    fn of(covariance: &DMatrix<f64>, rows: &Range<usize>) -> Self {
        let n = rows.len();
        let own = covariance.view((rows.start, rows.start), (n, n)).into_owned();
        let mut block = Self { inverse: DMatrix::zeros(n, n), freedom: 0 };
        // The iteration for eigenvalues may not end for numbers that are not finite.
        if own.iter().any(|v| !v.is_finite()) {
            return block;
        }
        let eigen = SymmetricEigen::new(own);
        for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
            if *value > if n == 1 { CHECKED_ALONE } else { CHECKED } {
                block.inverse += vector * vector.transpose() / *value;
                block.freedom += 1;
            }
        }
        block
    }
}

impl Family {
    /// Number of groups that the rest of the system can contradict.
    fn tests(&self) -> usize {
        self.groups.iter().filter(|group| GroupBlock::of(&self.covariance, &group.rows).freedom > 0).count()
    }

    /// The groups whose residuals are too large at `level` each, the worst first, each tested without those before it.
    fn outcasts(&self, level: f64) -> Vec<Outcast> {
        let (mut residuals, mut covariance) = (self.residuals.clone(), self.covariance.clone());
        let mut left: Vec<usize> = (0..self.groups.len()).collect();
        let mut outcasts: Vec<Outcast> = Vec::new();
        loop {
            let unlikely = self.unlikely(&left, &residuals, &covariance, level);
            let Some(worst) = unlikely.iter().min_by(|a, b| {
                let p = |suspect: &Suspect| chi2_survival(suspect.chi2, suspect.block.freedom as f64);
                p(a).total_cmp(&p(b)).then(b.chi2.total_cmp(&a.chi2))
            }) else {
                return outcasts;
            };
            let alike = |suspect: &Suspect| {
                unlikely
                    .iter()
                    .filter(|other| {
                        other.group != suspect.group && self.is_shared(&covariance, suspect, other.group)
                    })
                    .collect::<Vec<_>>()
            };
            // Of groups that cannot be separated, the one that needs the least change.
            let change = |suspect: &Suspect| suspect.left_out.norm_squared() / suspect.block.freedom as f64;
            let mut suspects = alike(worst);
            suspects.insert(0, worst);
            let Some(chosen) = suspects.into_iter().min_by(|a, b| change(a).total_cmp(&change(b))) else {
                return outcasts;
            };
            let rows = &self.groups[chosen.group].rows;
            let across = covariance.columns_range(rows.clone()).into_owned();
            let reduced = &covariance - &across * &chosen.block.inverse * across.transpose();
            outcasts.push(Outcast {
                group: chosen.group,
                chi2: chosen.chi2,
                freedom: chosen.block.freedom,
                spread: chosen.block.inverse.clone(),
                rivals: alike(chosen).into_iter().map(|rival| rival.group).collect(),
                left_out: chosen.left_out.clone(),
            });
            residuals -= &across * &chosen.left_out;
            left.retain(|group| *group != chosen.group);
            covariance = reduced;
        }
    }

    /// Whether nearly everything that contradicts a group also contradicts the `other`.
    fn is_shared(&self, covariance: &DMatrix<f64>, suspect: &Suspect, other: usize) -> bool {
        let rows = self.groups[other].rows.clone();
        let across = covariance.view(
            (rows.start, self.groups[suspect.group].rows.start),
            (rows.len(), self.groups[suspect.group].rows.len()),
        );
        let shared = across * &suspect.block.inverse * across.transpose();
        shared.trace() > SHARED * rows.map(|row| covariance[(row, row)]).sum::<f64>()
    }

    /// The groups in `left` that are too far off.
    fn unlikely(
        &self,
        left: &[usize],
        residuals: &DVector<f64>,
        covariance: &DMatrix<f64>,
        level: f64,
    ) -> Vec<Suspect> {
        let test = |group: &usize| {
            let rows = &self.groups[*group].rows;
            let block = GroupBlock::of(covariance, rows);
            let own = residuals.rows_range(rows.clone());
            let left_out = &block.inverse * own;
            let chi2 = own.dot(&left_out);
            let p = if block.freedom > 0 { chi2_survival(chi2, block.freedom as f64) } else { 1.0 };
            (p < level).then_some(Suspect { group: *group, block, left_out, chi2 })
        };
        left.iter().filter_map(test).collect()
    }
}

/// Tests of everything that was stated beforehand for an estimate.
pub(super) struct Checks<'a> {
    problem: &'a CalibrationProblem,
    set: &'a MeasurementSet,
    solution: &'a Solution,
    bounded: &'a [usize],
    priors: Family,
    /// Variance of the measurements' noise relative to the one with which they were weighted: less than one where the latter was taken from
    /// residuals that a prior on compliances enlarged.
    noise: f64,
    /// One family per station.
    nests: Vec<(NestSystem, Family)>,
    level: f64,
}

/// Priors that do not fit, and their contribution to chi-square.
#[derive(Default)]
pub(super) struct Found {
    pub contradictions: Vec<Contradiction>,
    pub chi2: f64,
    pub freedom: usize,
}

impl<'a> Checks<'a> {
    /// Tests of `solution` with the `covariance` of its parameters, with the parameters in `bounded` held; `frame` is how stations are placed.
    pub fn new(
        problem: &'a CalibrationProblem,
        set: &'a MeasurementSet,
        solution: &'a Solution,
        covariance: &DMatrix<f64>,
        bounded: &'a [usize],
        frame: FrameChoice,
        noise: NoiseScale,
    ) -> Self {
        let priors = priors(problem, &solution.residuals, &solution.jacobian, covariance, bounded);
        let noise = match noise {
            NoiseScale::Residuals(_) => noise_without_priors(problem, solution, bounded).unwrap_or(1.0),
            NoiseScale::Stated => 1.0,
        };
        // If the nests do not place a station, the fit has failed before.
        let nests: Vec<_> = set
            .stations
            .iter()
            .zip(&problem.stations)
            .enumerate()
            .filter(|(_, (station, _))| !matches!(frame.of(station), FrameChoice::Free | FrameChoice::Sweeps))
            .filter_map(|(index, (station, place))| {
                let system = nest_system(station, place).ok()?;
                let family = of_nests(&system, station, index)?;
                Some((system, family))
            })
            .collect();
        let tests = priors.tests() + nests.iter().map(|(_, family)| family.tests()).sum::<usize>();
        let level = CONTRADICTION_LEVEL / tests.max(1) as f64;
        Self { problem, set, solution, bounded, priors, noise, nests, level }
    }

    /// Tests the priors of parameters, nests and target as stated against the measurements, whose noise has `variance` times the stated variance.
    pub fn of_priors(&self, variance: f64) -> Found {
        let variance = variance * self.noise;
        let again = (variance != 1.0).then(|| self.with_noise(variance)).flatten();
        let priors = again.as_ref().unwrap_or(&self.priors);
        let outcasts = priors.outcasts(self.level);
        Found {
            chi2: outcasts.iter().map(|outcast| outcast.chi2).sum(),
            freedom: outcasts.iter().map(|outcast| outcast.freedom).sum(),
            contradictions: outcasts.iter().map(|outcast| self.describe(priors, outcast)).collect(),
        }
    }

    /// The priors if the measurements have `variance` times the noise with which they were weighted while the noise of what was stated is as
    /// stated: the minimum moves. To first order; `None` without full rank.
    fn with_noise(&self, variance: f64) -> Option<Family> {
        if !self.solution.weights.is_empty() {
            // With a loss there is no least squares minimum to move: the whole system is scaled to this noise.
            let Family { residuals, covariance, groups } = &self.priors;
            let (residuals, groups) = (residuals / variance.sqrt(), groups.clone());
            return Some(Family { residuals, covariance: covariance.clone(), groups });
        }
        let data = self.problem.data_rows();
        let (mut residuals, mut jacobian) = (self.solution.residuals.clone(), self.solution.jacobian.clone());
        residuals.rows_mut(0, data).scale_mut(1.0 / variance.sqrt());
        jacobian.rows_mut(0, data).scale_mut(1.0 / variance.sqrt());
        let free = free_columns(&jacobian, self.bounded);
        let minimum = Minimum::of(&residuals, &jacobian, &free)?;
        let spread = minimum.spread(jacobian.ncols(), &free)?;
        let covariance = &spread * spread.transpose();
        Some(priors(self.problem, &minimum.residuals, &jacobian, &covariance, self.bounded))
    }

    /// Tests the nests of each station against each other.
    pub fn of_nests(&self) -> Vec<Contradiction> {
        let of_station = |(_, family): &(NestSystem, Family)| {
            let outcasts = family.outcasts(self.level);
            outcasts.iter().map(|outcast| self.describe(family, outcast)).collect::<Vec<_>>()
        };
        self.nests.iter().flat_map(of_station).collect()
    }

    fn describe(&self, family: &Family, outcast: &Outcast) -> Contradiction {
        // A rival has its own size; only its name is reported.
        let name = |rival: &usize| {
            let RowGroup { rows, kind } = &family.groups[*rival];
            let n = rows.len();
            self.stated(kind, &DVector::zeros(n), &DMatrix::identity(n, n)).name()
        };
        Contradiction {
            stated: self.stated(&family.groups[outcast.group].kind, &outcast.left_out, &outcast.spread),
            chi2: outcast.chi2,
            freedom: outcast.freedom,
            or: outcast.rivals.iter().map(name).collect(),
        }
    }

    fn stated(&self, kind: &Kind, left_out: &DVector<f64>, spread: &DMatrix<f64>) -> Stated {
        match *kind {
            Kind::Own(column, prior_sigma) => Stated::Parameter {
                id: self.problem.parameters[column],
                found: prior_sigma * left_out[0],
                // The variance of the discrepancy less the prior's own, which is one.
                sigma: prior_sigma * (spread[(0, 0)] - 1.0).max(0.0).sqrt(),
                prior_sigma,
            },
            Kind::Block(index) => {
                let prior = &self.problem.priors[index];
                // For nests that determine the instrument's errors as well, the smallest change that explains the discrepancy.
                let shift = prior.whitening.clone().pseudo_inverse(f64::EPSILON);
                let shift = shift.map_or_else(|_| left_out.clone(), |inverse| inverse * left_out);
                let length = |rows: Range<usize>| {
                    shift.iter().skip(rows.start).take(rows.len()).map(|v| v * v).sum::<f64>().sqrt()
                };
                match self.problem.parameters[prior.columns[0]] {
                    ParameterId::Target { target, .. } => {
                        Stated::Target { target: self.set.targets[target].name.clone(), length: length(0..3) }
                    }
                    ParameterId::Orientation { target, .. } => Stated::Orientation {
                        target: self.set.targets[target].name.clone(),
                        angle: length(0..3),
                    },
                    ParameterId::Frame { station, .. }
                        if self.problem.swept.iter().any(|(swept, _)| *swept == index) =>
                    {
                        // The first six columns are the frame's; the others depend on them.
                        let of_frame = prior.whitening.columns(0, 6).into_owned().try_inverse();
                        let moved = of_frame.map_or_else(|| left_out.clone(), |inverse| inverse * left_out);
                        Stated::Sweeps {
                            station: self.set.stations[station].name.clone(),
                            length: moved.rows(0, 3).norm(),
                            angle: moved.rows(3, 3).norm(),
                        }
                    }
                    ParameterId::Frame { station, .. } => Stated::Nests {
                        station: self.set.stations[station].name.clone(),
                        length: length(0..3),
                        angle: length(3..6),
                    },
                    id => {
                        let prior_sigma = 1.0 / prior.whitening[(0, 0)];
                        let sigma = prior_sigma * (spread[(0, 0)] - 1.0).max(0.0).sqrt();
                        Stated::Parameter { id, found: shift[0], sigma, prior_sigma }
                    }
                }
            }
            Kind::Nest(station, nest) => {
                let system = self.nests.iter().find_map(|(system, family)| {
                    let is_own = |group: &RowGroup| matches!(group.kind, Kind::Nest(s, _) if s == station);
                    family.groups.iter().any(is_own).then_some(system)
                });
                let own = system.and_then(|system| system.nests.get(nest));
                let shift = own.and_then(|own| own.whitening.solve_lower_triangular(left_out));
                let shift = shift.unwrap_or_else(|| left_out.clone());
                // The mean of several readings.
                let readings = (shift.len() / 3).max(1) as f64;
                let mean = shift.as_slice().chunks_exact(3).map(Vector3::from_column_slice);
                let shift = mean.sum::<Vector3<f64>>() / readings;
                let reading = own.and_then(|own| own.readings.first().copied()).unwrap_or(nest);
                let station = &self.set.stations[station];
                Stated::Nest {
                    nest: station.nests[reading].name.clone(),
                    station: station.name.clone(),
                    length: shift.norm(),
                }
            }
        }
    }
}

/// A linearised system, solved again in some of its columns.
pub(super) struct Minimum {
    /// Triangular factor of the free columns.
    r: DMatrix<f64>,
    /// Change of the free columns' parameters.
    pub step: DVector<f64>,
    pub residuals: DVector<f64>,
}

impl Minimum {
    pub fn of(residuals: &DVector<f64>, jacobian: &DMatrix<f64>, free: &[usize]) -> Option<Self> {
        let n = free.len();
        let mut system = jacobian.select_columns(free).insert_column(n, 0.0);
        system.column_mut(n).copy_from(residuals);
        let r = triangular_factor_of_all(system.as_view());
        if r.nrows() < n {
            return None;
        }
        let right = r.view((0, n), (n, 1)).into_owned();
        let r = r.view((0, 0), (n, n)).into_owned();
        let step: DVector<f64> = -r.solve_upper_triangular(&right)?.column(0);
        let residuals = residuals + jacobian.select_columns(free) * &step;
        residuals.iter().all(|v| v.is_finite()).then_some(Self { r, step, residuals })
    }
}

impl Minimum {
    /// S with `S Sᵀ` the covariance of all `columns`; `free` are those in which the system was solved.
    pub fn spread(&self, columns: usize, free: &[usize]) -> Option<DMatrix<f64>> {
        let inverse = self.r.solve_upper_triangular(&DMatrix::identity(free.len(), free.len()))?;
        let mut spread = DMatrix::zeros(columns, free.len());
        for (row, column) in free.iter().enumerate() {
            spread.row_mut(*column).copy_from(&inverse.row(row));
        }
        Some(spread)
    }
}

pub(super) fn free_columns(jacobian: &DMatrix<f64>, bounded: &[usize]) -> Vec<usize> {
    (0..jacobian.ncols()).filter(|column| !bounded.contains(column)).collect()
}

/// Share of their weight that priors keep when the noise is determined without them.
const LOOSE: f64 = 1e-3;

/// Statements on targets and nests cause the residuals if these have less than this share of their variance without the statements. A shift
/// of the target also absorbs what a model lacks, but not as much.
const MADE_BY_STATEMENT: f64 = 0.25;

/// Variance of the residuals when the priors of compliances, and what was stated of targets and nests, do not hold them, relative to the
/// variance with which they were weighted. A prior that keeps a drive too stiff leaves its sag in the residuals; a wrong offset of the target
/// turns with the flange. `None` where neither is significant.
fn noise_without_priors(problem: &CalibrationProblem, solution: &Solution, bounded: &[usize]) -> Option<f64> {
    if !solution.weights.is_empty() {
        return None;
    }
    let first = problem.measured_rows();
    let of_compliances: Vec<usize> = (first..)
        .zip(&problem.own_priors)
        .filter(|(_, (column, _))| matches!(problem.parameters[*column], ParameterId::Compliance(_)))
        .map(|(row, _)| row)
        .collect();
    let of_places: Vec<usize> = (problem.data_rows()..first).collect();
    let without_compliances = noise_without(&of_compliances, solution, bounded);
    let all = [of_places, of_compliances].concat();
    let share = |variance: &f64| *variance < MADE_BY_STATEMENT * without_compliances.unwrap_or(1.0);
    noise_without(&all, solution, bounded).filter(share).or(without_compliances)
}

/// Like [`noise_without_priors`], without the priors in `rows`, where that is significant (F test).
fn noise_without(rows: &[usize], solution: &Solution, bounded: &[usize]) -> Option<f64> {
    let (mut residuals, mut jacobian) = (solution.residuals.clone(), solution.jacobian.clone());
    for row in rows {
        residuals[*row] *= LOOSE;
        jacobian.row_mut(*row).scale_mut(LOOSE);
    }
    let free = free_columns(&jacobian, bounded);
    let loose = Minimum::of(&residuals, &jacobian, &free)?.residuals.norm_squared();
    let freed = rows.len() as f64;
    let freedom = residuals.len() as f64 - free.len() as f64 - freed;
    if !(freedom > 0.0 && freed > 0.0 && loose > 0.0) {
        return None;
    }
    let statistic = (solution.residuals.norm_squared() - loose) / freed * freedom / loose;
    (f_ln_survival(statistic, freed, freedom) < CONTRADICTION_LEVEL.ln()).then_some(loose / freedom)
}

fn priors(
    problem: &CalibrationProblem,
    residuals: &DVector<f64>,
    jacobian: &DMatrix<f64>,
    covariance: &DMatrix<f64>,
    bounded: &[usize],
) -> Family {
    let mut rows = Vec::new();
    let mut groups = Vec::new();
    let mut first = problem.data_rows();
    // A parameter at a bound is reported by the bound, and its prior has no effect.
    let mut take = |first: usize, count: usize, columns: &[usize], kind: Kind| {
        if columns.iter().any(|column| bounded.contains(column)) {
            return;
        }
        groups.push(RowGroup { rows: rows.len()..rows.len() + count, kind });
        rows.extend(first..first + count);
    };
    for (index, prior) in problem.priors.iter().enumerate() {
        let n = prior.whitening.nrows();
        take(first, n, &prior.columns, Kind::Block(index));
        first += n;
    }
    for (row, (column, weight)) in (first..).zip(problem.own_priors.iter().chain(&problem.tolerances)) {
        take(row, 1, &[*column], Kind::Own(*column, 1.0 / weight));
    }
    let jacobian = jacobian.select_rows(&rows);
    let hat = &jacobian * covariance * jacobian.transpose();
    Family {
        residuals: residuals.select_rows(&rows),
        covariance: DMatrix::identity(rows.len(), rows.len()) - hat,
        groups,
    }
}

/// The nests of a station at the place, and with the instrument's errors, that fit them best.
fn of_nests(system: &NestSystem, station: &Station, index: usize) -> Option<Family> {
    let rows = system.residuals.len();
    let errors = system.instrument.ncols();
    let mut jacobian = system.jacobian.clone().insert_columns(6, errors, 0.0);
    jacobian.columns_mut(6, errors).copy_from(&system.instrument);
    let mut information = jacobian.tr_mul(&jacobian);
    let stated = station.instrument.iter().flat_map(StatedInstrument::errors);
    for (column, (_, sigma)) in (6..).zip(stated) {
        information[(column, column)] += 1.0 / (sigma * sigma);
    }
    let information = information.cholesky()?;
    let hat = &jacobian * information.solve(&jacobian.transpose());
    let step = information.solve(&jacobian.tr_mul(&system.residuals));
    let mut first = 0;
    let group = |(nest, own): (usize, &WhitenedNest)| {
        let rows = first..first + own.whitening.nrows();
        first = rows.end;
        RowGroup { rows, kind: Kind::Nest(index, nest) }
    };
    let groups = system.nests.iter().enumerate().map(group).collect();
    Some(Family {
        residuals: &system.residuals - jacobian * step,
        covariance: DMatrix::identity(rows, rows) - hat,
        groups,
    })
}

#[cfg(test)]
mod tests;
