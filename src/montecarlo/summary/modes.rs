//! The trials of a group in a mode.

use std::ops::Range;

use calibrig_campaign::statistics::{
    Convergence, Estimated, Histogram, Interval, Moments, Proportion, RatioOfMeans, quantiles,
    trials_for_mean,
};
use calibrig_campaign::table::{Cell, Table};

use super::{BAND, ENOUGH, LEVEL, SummaryError, moments, place};
use crate::montecarlo::AccuracySet;
use crate::montecarlo::columns::{mode_column, parameter_column, set_column};
use calibrig_estimation::evaluation::{Coverage, chi2_band};
use calibrig_estimation::identification::Mode;
use calibrig_model::ParameterId;
use calibrig_model::statistics::{NORMAL_95, student_t_quantile};

/// Shares for which quantiles are given.
const SHARES: [f64; 3] = [0.05, 0.5, 0.95];
/// Bins of the pictures.
const BINS: usize = 40;

/// A mean over trials with its 95 % confidence interval, and the scatter of single trials.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeanWithInterval {
    /// Trials in which it is known.
    pub trials: u64,
    /// Over the trials.
    pub mean: f64,
    /// Half the width of the mean's interval (Student's t); `None` for one trial.
    pub half_width: Option<f64>,
    /// Standard deviation of single trials with its interval; `None` for one trial.
    pub deviation: Option<Estimated>,
    /// The 5 %, 50 % and 95 % quantiles of single trials.
    pub quantiles: [f64; 3],
    /// Their 95 % intervals, which hold for any distribution; `None` for too few trials.
    pub quantile_intervals: [Option<Interval>; 3],
}

/// How often something happened, of all trials.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rate {
    /// Number of times.
    pub hits: u64,
    /// Number of trials.
    pub trials: u64,
    /// The share with its exact 95 % interval.
    pub share: Estimated,
}

impl Rate {
    fn of(proportion: &Proportion) -> Option<Self> {
        let share = proportion.interval(LEVEL)?;
        Some(Self { hits: proportion.hits(), trials: proportion.trials(), share })
    }
}

/// Accuracy of a mode on a set over the trials, m.
#[derive(Debug, Clone, PartialEq)]
pub struct SetSummary {
    /// Which set.
    pub kind: AccuracySet,
    /// Largest absolute error per axis.
    pub max: [MeanWithInterval; 3],
    /// Mean absolute error per axis.
    pub mean: [MeanWithInterval; 3],
    /// RMS of the 3-D error.
    pub rms_3d: MeanWithInterval,
    /// Largest 3-D error.
    pub max_3d: MeanWithInterval,
    /// How often the RMS was within the tolerance; a failed trial counts as outside.
    pub rms_within: Option<Rate>,
    /// How often every pose was.
    pub max_within: Option<Rate>,
    /// Whether the trials are enough for the mean of the RMS, to 1 %.
    pub convergence: Option<Convergence>,
    /// The distribution of the RMS of single trials.
    pub histogram: Option<Histogram>,
    /// In a sweep: the difference of the mean RMS from that of the first combination with the same draws.
    pub against_first: Option<Estimated>,
}

/// A parameter over the trials in which its truth and standard deviation are known, SI.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterSummary {
    /// Which.
    pub id: ParameterId,
    /// Mean of estimate minus truth.
    pub bias: Estimated,
    /// Root mean square of estimate minus truth.
    pub rmse: Estimated,
    /// Root of the mean stated variance.
    pub stated: f64,
    /// RMSE over the stated standard deviation: about 1 if the stated uncertainty is right.
    pub consistency: Estimated,
    /// Root of the mean Cramér-Rao bound at the truth of every trial: no unbiased estimator that uses only the measurements has a smaller RMSE.
    /// One with priors may. `None` if the truth of a parameter is unknown, or the measurements alone do not determine all.
    pub cramer_rao: Option<f64>,
    /// The Bayesian Cramér-Rao bound, root of its mean over the trials, whose poses every estimator knows: none has a smaller RMSE over machines
    /// drawn from the priors. `None` if no machines are drawn, no parameter has a prior, or the truth of one is unknown.
    pub bayesian: Option<f64>,
    /// RMSE over the bound that holds for this estimator.
    pub over_bound: Option<Estimated>,
    /// How often the stated 95 % interval contained the truth.
    pub coverage: Coverage,
}

impl ParameterSummary {
    /// The bound that holds for this estimator: the Bayesian one or, without priors, that of the measurements alone.
    pub fn least(&self) -> Option<f64> {
        self.bayesian.or(self.cramer_rao)
    }
}

/// A mode over the trials.
#[derive(Debug, Clone, PartialEq)]
pub struct ModeSummary {
    /// Which.
    pub mode: Mode,
    /// Accuracy, set by set.
    pub sets: Vec<SetSummary>,
    /// Trials that were identified but are not sound: not converged, or rank-deficient.
    pub doubtful: u64,
    /// Of the solver.
    pub iterations: Option<MeanWithInterval>,
    /// About 1 if the model and the stated noise are right.
    pub chi2_per_dof: Option<MeanWithInterval>,
    /// NEES over its number of parameters, if every truth is known: about 1 for an honest covariance.
    pub nees: Option<NeesSummary>,
    /// Squared error over the bound, per parameter, if every truth is known: on average at least 1 for machines that are drawn from the priors
    /// and match the model, and 1 for the best estimator.
    pub squared_over_bound: Option<MeanWithInterval>,
    /// Parameter by parameter.
    pub parameters: Vec<ParameterSummary>,
    /// How often the stated 95 % interval of a predicted coordinate contained the true one.
    pub predictions: Option<PredictionCoverage>,
}

impl ModeSummary {
    /// Reference of the accuracy: the true places of held-out poses, if there are any.
    pub fn told(&self) -> Option<&SetSummary> {
        AccuracySet::ALL.iter().rev().find_map(|kind| self.sets.iter().find(|set| set.kind == *kind))
    }
}

/// How often stated intervals of predicted coordinates contained the true ones. Coordinates of one trial depend on the same estimate, so
/// trials are the unit: the uncertainty comes from the scatter between them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PredictionCoverage {
    /// Over all coordinates of all trials.
    pub coverage: Coverage,
    /// Half the width of the 99.9 % interval of its fraction (Student's t over the trials); `None` for one trial.
    pub half_width: Option<f64>,
}

impl PredictionCoverage {
    /// The share with its 99.9 % interval, which ends at none and at all.
    pub fn estimate(&self) -> Estimated {
        let value = self.coverage.fraction();
        let ends = |half: f64| Interval { low: (value - half).max(0.0), high: (value + half).min(1.0) };
        Estimated { value, interval: self.half_width.map(ends) }
    }
}

/// The mean normalised estimation error squared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NeesSummary {
    /// Over the trials.
    pub mean: f64,
    /// Its expectation: the mean number of parameters.
    pub parameters: f64,
    /// Trials in which it is known.
    pub trials: u64,
    /// The band that contains 99.9 % of sound campaigns.
    pub band: (f64, f64),
}

/// Rows of a table.
pub(super) struct Rows<'a> {
    pub table: &'a dyn Table,
    pub rows: Range<u64>,
    pub tolerance: Option<f64>,
}

impl Rows<'_> {
    /// Shows cells of all rows.
    fn visit(&self, names: &[String], mut show: impl FnMut(&[Cell])) -> Result<(), SummaryError> {
        let places = names.iter().map(|name| place(self.table, name)).collect::<Result<Vec<_>, _>>()?;
        Ok(self.table.visit(&places, self.rows.clone(), &mut show)?)
    }

    pub fn mode(
        &self,
        mode: Mode,
        parameters: &[ParameterId],
        is_drawn: bool,
    ) -> Result<ModeSummary, SummaryError> {
        let mut sets = Vec::new();
        for kind in AccuracySet::ALL {
            sets.extend(self.set(mode, kind)?);
        }
        let mut summary = ModeSummary {
            mode,
            sets,
            doubtful: 0,
            iterations: None,
            chi2_per_dof: None,
            nees: None,
            squared_over_bound: None,
            parameters: Vec::new(),
            predictions: None,
        };
        if mode == Mode::WithoutCalibration {
            return Ok(summary);
        }
        self.visit(&[mode_column(mode, "sound")], |row| {
            summary.doubtful += u64::from(row[0].as_number() == Some(0.0));
        })?;
        summary.iterations = self.mean(&mode_column(mode, "iterations"))?;
        summary.chi2_per_dof = self.mean(&mode_column(mode, "chi2_per_dof"))?;
        summary.nees = self.nees(mode)?;
        let shared = ["squared_over_bound", "parameter_count"].map(|name| mode_column(mode, name));
        let share = |row: &[Cell]| Some(row[0].as_number()? / row[1].as_number()?);
        summary.squared_over_bound = self.mean_of(&shared, share)?;
        summary.predictions = self.predictions(mode)?;
        for id in parameters {
            summary.parameters.extend(self.parameter(mode, *id, is_drawn)?);
        }
        Ok(summary)
    }

    /// A column's mean and quantiles; `None` without values.
    pub fn mean(&self, name: &str) -> Result<Option<MeanWithInterval>, SummaryError> {
        self.mean_of(&[name.to_owned()], |row| row[0].as_number())
    }

    /// Mean and quantiles of a function of some columns.
    fn mean_of(
        &self,
        names: &[String],
        value: impl Fn(&[Cell]) -> Option<f64>,
    ) -> Result<Option<MeanWithInterval>, SummaryError> {
        let places = names.iter().map(|name| place(self.table, name)).collect::<Result<Vec<_>, _>>()?;
        let each = |take: &mut dyn FnMut(f64)| {
            let mut show = |row: &[Cell]| value(row).into_iter().for_each(&mut *take);
            self.table.visit(&places, self.rows.clone(), &mut show)
        };
        let mut moments = Moments::default();
        each(&mut |value| moments.add(value))?;
        let ranked = quantiles(each, &SHARES, LEVEL)?;
        let (Some(mean), [low, middle, high]) = (moments.mean_interval(LEVEL), &ranked.quantiles[..]) else {
            return Ok(None);
        };
        let ranked = [low, middle, high];
        Ok(Some(MeanWithInterval {
            trials: moments.count(),
            mean: mean.value,
            half_width: mean.interval.map(|interval| interval.half_width()),
            deviation: moments.deviation_interval(LEVEL),
            quantiles: ranked.map(|quantile| quantile.estimate.value),
            quantile_intervals: ranked.map(|quantile| quantile.estimate.interval),
        }))
    }

    fn set(&self, mode: Mode, kind: AccuracySet) -> Result<Option<SetSummary>, SummaryError> {
        let of = |figure: &str| self.mean(&set_column(mode, kind, figure));
        let (Some(rms_3d), Some(max_3d)) = (of("rms_3d_m")?, of("max_3d_m")?) else { return Ok(None) };
        let axes = |figure: &str| -> Result<Option<[MeanWithInterval; 3]>, SummaryError> {
            let axis = |axis: &str| of(&format!("{figure}_{axis}_m"));
            let (Some(x), Some(y), Some(z)) = (axis("x")?, axis("y")?, axis("z")?) else { return Ok(None) };
            Ok(Some([x, y, z]))
        };
        let (Some(max), Some(mean)) = (axes("max")?, axes("mean")?) else { return Ok(None) };
        let column = place(self.table, &set_column(mode, kind, "rms_3d_m"))?;
        let moments = moments(self.table, column, &self.rows)?;
        let [rms_within, max_within] = self.within(mode, kind)?;
        Ok(Some(SetSummary {
            kind,
            max,
            mean,
            rms_3d,
            max_3d,
            rms_within,
            max_within,
            convergence: trials_for_mean(&moments, LEVEL, ENOUGH),
            histogram: self.histogram(column, &moments)?,
            against_first: None,
        }))
    }

    fn histogram(&self, column: usize, moments: &Moments) -> Result<Option<Histogram>, SummaryError> {
        let (Some(low), Some(high)) = (moments.min(), moments.max()) else { return Ok(None) };
        // The largest value belongs to the last bin.
        let Ok(mut histogram) = Histogram::new(low, high.next_up(), BINS) else { return Ok(None) };
        self.table.visit(&[column], self.rows.clone(), &mut |row| {
            if let Some(value) = row[0].as_number() {
                histogram.add(value);
            }
        })?;
        Ok(Some(histogram))
    }

    /// How often RMS and largest error were within the tolerance, of all trials.
    fn within(&self, mode: Mode, kind: AccuracySet) -> Result<[Option<Rate>; 2], SummaryError> {
        let Some(tolerance) = self.tolerance else { return Ok([None; 2]) };
        let mut within = [Proportion::default(); 2];
        let names = [set_column(mode, kind, "rms_3d_m"), set_column(mode, kind, "max_3d_m")];
        self.visit(&names, |row| {
            for (proportion, cell) in within.iter_mut().zip(row) {
                // A failed trial has no figure, and is not a success.
                proportion.add(cell.as_number().is_some_and(|value| value <= tolerance));
            }
        })?;
        Ok(within.each_ref().map(Rate::of))
    }

    fn nees(&self, mode: Mode) -> Result<Option<NeesSummary>, SummaryError> {
        let (mut nees, mut parameters) = (Moments::default(), Moments::default());
        let names = [mode_column(mode, "nees"), mode_column(mode, "parameter_count")];
        self.visit(&names, |row| {
            if let (Some(own), Some(count)) = (row[0].as_number(), row[1].as_number()) {
                nees.add(own);
                parameters.add(count);
            }
        })?;
        let (Some(mean), Some(parameters)) = (nees.mean(), parameters.mean()) else { return Ok(None) };
        let trials = nees.count();
        // Their sum is chi-square with all degrees of freedom, even if trials differ in what they identify.
        let (low, high) = chi2_band(trials as f64 * parameters, BAND);
        let band = (low * parameters, high * parameters);
        Ok(Some(NeesSummary { mean, parameters, trials, band }))
    }

    pub fn predictions(&self, mode: Mode) -> Result<Option<PredictionCoverage>, SummaryError> {
        let names = [mode_column(mode, "predictions_inside"), mode_column(mode, "predictions")];
        let (mut coverage, mut trials) = (Coverage::default(), 0_u64);
        let pair = |row: &[Cell]| Some((row[0].as_number()?, row[1].as_number()?));
        self.visit(&names, |row| {
            if let Some((hits, all)) = pair(row) {
                coverage.hits += super::whole(Some(hits));
                coverage.trials += super::whole(Some(all));
                trials += 1;
            }
        })?;
        if coverage.trials == 0 {
            return Ok(None);
        }
        // The variance is that of a ratio of means.
        let (n, fraction, mut squares) = (trials as f64, coverage.fraction(), 0.0);
        self.visit(&names, |row| {
            if let Some((hits, all)) = pair(row) {
                squares += (hits - fraction * all).powi(2);
            }
        })?;
        let half_width = (trials > 1).then(|| {
            let variance = squares * n / (n - 1.0) / (coverage.trials as f64).powi(2);
            student_t_quantile(0.5 + 0.5 * BAND, n - 1.0) * variance.sqrt()
        });
        Ok(Some(PredictionCoverage { coverage, half_width }))
    }

    /// For one parameter, from the trials in which its truth and a standard deviation are known; `None` without any. With the Bayesian bound if
    /// the machines are drawn.
    fn parameter(
        &self,
        mode: Mode,
        id: ParameterId,
        is_drawn: bool,
    ) -> Result<Option<ParameterSummary>, SummaryError> {
        let names = ["estimate", "truth", "sigma", "cramer_rao", "bayesian"];
        let mut sums = ParameterSums::default();
        self.visit(&names.map(|figure| parameter_column(mode, id, figure)), |row| {
            let [value, truth, sigma, cramer_rao, bayesian] = [0, 1, 2, 3, 4].map(|at| row[at].as_number());
            if let (Some(value), Some(truth), Some(sigma)) = (value, truth, sigma) {
                sums.add(value - truth, sigma, [cramer_rao, bayesian.filter(|_| is_drawn)]);
            }
        })?;
        Ok(sums.summary(id))
    }
}

#[derive(Default)]
pub(super) struct ParameterSums {
    errors: Moments,
    squares: Moments,
    stated: RatioOfMeans,
    variance: Moments,
    /// Of the Cramér-Rao bound and of the Bayesian one, with the number of trials that lack it.
    bounds: [(Moments, RatioOfMeans, u64); 2],
    coverage: Coverage,
}

impl ParameterSums {
    pub fn add(&mut self, error: f64, sigma: f64, bounds: [Option<f64>; 2]) {
        let square = error * error;
        self.errors.add(error);
        self.squares.add(square);
        self.stated.add(square, sigma * sigma);
        self.variance.add(sigma * sigma);
        self.coverage.count(error.abs() <= NORMAL_95 * sigma);
        for ((mean, ratio, lacking), bound) in self.bounds.iter_mut().zip(bounds) {
            match bound {
                Some(bound) => {
                    mean.add(bound * bound);
                    ratio.add(square, bound * bound);
                }
                None => *lacking += 1,
            }
        }
    }

    pub fn summary(&self, id: ParameterId) -> Option<ParameterSummary> {
        let known = |(mean, _, lacking): &(Moments, RatioOfMeans, u64)| {
            mean.mean().filter(|_| *lacking == 0).map(f64::sqrt)
        };
        let [cramer_rao, bayesian] = self.bounds.each_ref().map(known);
        let ratio = |place: usize| self.bounds[place].1.root(LEVEL);
        Some(ParameterSummary {
            id,
            bias: self.errors.mean_interval(LEVEL)?,
            rmse: self.squares.root_mean(LEVEL)?,
            stated: self.variance.mean()?.sqrt(),
            consistency: self.stated.root(LEVEL)?,
            cramer_rao,
            bayesian,
            over_bound: match (bayesian, cramer_rao) {
                (Some(_), _) => ratio(1),
                (None, Some(_)) => ratio(0),
                (None, None) => None,
            },
            coverage: self.coverage,
        })
    }
}
