//! Whether gravity, the linkage or hysteresis improve the model, by nested models, each fitted to all poses and to all but a held-out part.

use std::collections::{BTreeMap, BTreeSet};

use super::{CalibrateError, errors, without_gross_errors};
use crate::evaluation::{Fit, NoiseLevel, Split, Variant, VariantRow, compare_variants, k_fold};
use crate::identification::{
    IdentificationOptions, LINKAGE, Mode, NoiseScale, Outlier, ParameterChoice, Uncertainty, identify,
    linearise,
};
use crate::validation::{held_out_errors, in_order};
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::{CalibrationModel, FAMILIES, ParameterId, TermId};

/// Confidence of the intervals.
const LEVEL: f64 = 0.95;

/// Nested models on the same poses.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelChoice {
    /// Number of distinct poses.
    pub poses: usize,
    /// Number of parts that are held out in turn.
    pub folds: usize,
    /// One row per model, the simplest first.
    pub rows: Vec<ChosenRow>,
    /// Models that could not be fitted.
    pub failures: Vec<FailedVariant>,
    /// Families of terms that have no effect on these measurements, such as hysteresis without approaches.
    pub without_basis: Vec<String>,
    /// Gross errors against the simplest model. With a robust loss they are left out of the fits and of the held-out errors.
    pub gross_errors: Vec<Outlier>,
}

/// A model in the table.
#[derive(Debug, Clone, PartialEq)]
pub struct ChosenRow {
    /// `geometry`, `gravity`, `stiffness`, `linkage`, `complete_geometry`, the key of a family of terms, [`DEFAULT_TERMS`], or [`ALL_TERMS`].
    pub key: &'static str,
    /// Results of the model.
    pub row: VariantRow,
    /// Number of fits, of all poses and of the folds, that did not converge.
    pub not_converged: usize,
}

/// A model that could not be fitted.
#[derive(Debug, Clone, PartialEq)]
pub struct FailedVariant {
    /// What the model adds, in words.
    pub name: String,
    /// Why.
    pub why: String,
}

/// A model to fit.
#[derive(Debug, Clone)]
struct Candidate {
    key: &'static str,
    name: String,
    against: Option<usize>,
    options: IdentificationOptions,
}

/// Key of all that the mode `extended` fits where no terms are asked for, on a complete geometry.
pub const DEFAULT_TERMS: &str = "default_terms";
/// Key of all that the mode `extended` fits, including the terms that are fitted on request.
pub const ALL_TERMS: &str = "all_terms";

/// Outcome of a candidate.
enum Tried {
    Fitted(Fitted),
    /// No measurement contains what its terms act on: it would equal the model with which it is compared.
    WithoutBasis,
}

/// A model that was fitted.
struct Fitted {
    variant: Variant,
    /// Standard deviation of a coordinate, m, if the noise comes from the residuals.
    sigma: Option<f64>,
    /// Sum of squares of the errors, m².
    squares: f64,
    /// Whether it was weighed with the machine's noise beside this model.
    is_misfit: bool,
    not_converged: usize,
}

/// Compares the models that `model` allows on `set`: geometry; with the predicted deflection under gravity; with identified stiffness; and on top
/// of that the linkage, a complete geometric set, and each family of terms alone (or beside the family that it
/// [extends](calibrig_model::TermFamily::extends)), all of these together without the terms that are fitted on request, and with them. Mode and
/// terms of `options` are ignored. Smooth terms are spread over the commands of all poses, held-out ones included.
///
/// Poses are held out in `folds` parts drawn with `seed`. The noise is taken as known up to one common scale: what no model explains does not
/// favour the larger model.
///
/// # Errors
///
/// [`CalibrateError`], where not even the simplest model can be fitted. A larger model that fails is among the failures.
pub fn choose(
    model: &CalibrationModel,
    set: &MeasurementSet,
    options: &IdentificationOptions,
    folds: usize,
    seed: u64,
    mut progress: impl FnMut(usize, usize, &str),
) -> Result<ModelChoice, CalibrateError> {
    let spans = if model.spans.is_empty() { set.spans() } else { model.spans.clone() };
    let model = &CalibrationModel { spans, ..model.clone() };
    let candidates = candidates(model, options);
    let simplest = identify(model, set, &candidates[0].options)
        .map_err(|source| CalibrateError::Identify { mode: candidates[0].options.mode, source })?;
    let set = &without_gross_errors(set, &simplest);
    let gross_errors = simplest.outliers;
    let splits = pose_folds(set, folds, seed);
    let (mut keys, mut fitted, mut failures) = (Vec::new(), Vec::<Fitted>::new(), Vec::new());
    let mut without_basis = Vec::new();
    // Row of each candidate; for one that failed, the row of the model with which it would have been compared.
    let mut places: Vec<Option<usize>> = Vec::new();
    for (index, candidate) in candidates.iter().enumerate() {
        progress(index, candidates.len(), &candidate.name);
        let against = candidate.against.and_then(|other| places[other]);
        match fit(model, set, candidate, against, &splits) {
            Ok(Tried::WithoutBasis) => {
                places.push(against);
                without_basis.push(candidate.name.clone());
            }
            Ok(Tried::Fitted(fit)) => {
                places.push(Some(fitted.len()));
                fitted.push(fit);
                keys.push(candidate.key);
            }
            Err(error) if fitted.is_empty() => return Err(error),
            Err(error) => {
                places.push(against);
                failures.push(FailedVariant { name: candidate.name.clone(), why: error.to_string() });
            }
        }
    }
    if fitted.iter().any(|fit| fit.is_misfit) {
        // Weighed with its own misfit, every model would look equally good; with lengths, all are weighed the same.
        for fit in &mut fitted {
            (fit.variant.fit.chi2, fit.sigma) = (fit.squares, None);
        }
    }
    let reference = fitted.first().and_then(|first| first.sigma);
    for fit in &mut fitted {
        // Whitened by its own residuals, every model would look equally good.
        if let (Some(sigma), Some(reference)) = (fit.sigma, reference) {
            fit.variant.fit.chi2 *= (sigma / reference).powi(2);
        }
    }
    let variants: Vec<_> = fitted.iter().map(|fit| fit.variant.clone()).collect();
    let rows = compare_variants(&variants, NoiseLevel::Estimated, LEVEL);
    let rows = keys.into_iter().zip(rows).zip(&fitted);
    Ok(ModelChoice {
        poses: distinct_poses(set).len(),
        folds: splits.len(),
        rows: rows
            .map(|((key, row), fit)| ChosenRow { key, row, not_converged: fit.not_converged })
            .collect(),
        failures,
        without_basis,
        gross_errors,
    })
}

/// The models in order; each names an earlier one for the comparison.
fn candidates(model: &CalibrationModel, options: &IdentificationOptions) -> Vec<Candidate> {
    let mut candidates = vec![Candidate {
        key: "geometry",
        name: "geometry".to_owned(),
        against: None,
        options: IdentificationOptions { mode: Mode::OnlyCalibration, ..options.clone() },
    }];
    if model.statics.is_some() {
        for (key, mode) in [("gravity", Mode::WithGravity), ("stiffness", Mode::ElastoGeometric)] {
            candidates.push(Candidate {
                key,
                name: format!("+ {key}"),
                against: Some(candidates.len() - 1),
                options: IdentificationOptions { mode, ..options.clone() },
            });
        }
    }
    let base = candidates.len() - 1;
    let extended = |geometry: &ParameterChoice, terms: &[&str]| IdentificationOptions {
        mode: Mode::Extended,
        extended_parameters: geometry.clone(),
        terms: Some(terms.iter().map(|key| (*key).to_owned()).collect()),
        ..options.clone()
    };
    let mut push = |key: &'static str, against: usize, options| {
        let name = format!("+ {}", key.replace('_', " "));
        candidates.push(Candidate { key, name, against: Some(against), options });
        candidates.len() - 1
    };
    if model.actuators.four_bar().is_some() {
        push(LINKAGE, base, extended(&options.parameters, &[LINKAGE]));
    }
    if options.parameters == ParameterChoice::NeighbourAxisRules {
        push("complete_geometry", base, extended(&ParameterChoice::Complete, &[]));
    }
    let mut places = BTreeMap::new();
    for family in FAMILIES {
        let key = family.key();
        if TermId::all_of(key, model).is_some_and(|terms| !terms.is_empty()) {
            let keys: Vec<_> = family.extends().into_iter().chain([key]).collect();
            let against = family.extends().and_then(|other| places.get(other)).copied().unwrap_or(base);
            places.insert(key, push(key, against, extended(&options.parameters, &keys)));
        }
    }
    // Small effects hide behind large ones until both are in the model.
    let by_default = IdentificationOptions { terms: None, ..extended(&ParameterChoice::Complete, &[]) };
    let place = push(DEFAULT_TERMS, base, by_default.clone());
    let all = std::iter::once(LINKAGE).chain(FAMILIES.iter().map(|family| family.key()));
    let all = Some(all.map(str::to_owned).collect());
    push(ALL_TERMS, place, IdentificationOptions { terms: all, ..by_default });
    candidates
}

fn fit(
    model: &CalibrationModel,
    set: &MeasurementSet,
    candidate: &Candidate,
    against: Option<usize>,
    splits: &[Split],
) -> Result<Tried, CalibrateError> {
    let mode = candidate.options.mode;
    let failed = |source| CalibrateError::Identify { mode, source };
    let estimate = identify(model, set, &candidate.options).map_err(failed)?;
    let is_family = FAMILIES.iter().any(|family| family.key() == candidate.key);
    let is_own =
        |id: ParameterId| matches!(id, ParameterId::Term(term) if term.family().key() == candidate.key);
    if is_family && !estimate.parameters.iter().any(|p| is_own(p.id)) {
        return Ok(Tried::WithoutBasis);
    }
    let system = linearise(model, set, &candidate.options, &estimate).map_err(failed)?;
    let ids: Vec<_> = estimate.parameters.iter().map(|p| p.id).collect();
    let determined = Uncertainty::of(&system, &ids);
    let mut not_converged = usize::from(!estimate.termination.converged());
    let held_out = held_out_errors(set, splits, |fitted, held_out| {
        let estimate = identify(model, fitted, &candidate.options).map_err(failed)?;
        not_converged += usize::from(!estimate.termination.converged());
        errors(&estimate.robot, held_out)
    })?;
    let variant = Variant {
        name: candidate.name.clone(),
        against,
        parameters: ids.len(),
        fit: Fit {
            chi2: system.residuals.rows(0, system.data_rows).norm_squared(),
            rows: system.data_rows,
            parameters: determined.map_or(estimate.spectrum.rank as f64, |u| u.effective_parameters()),
        },
        held_out: in_order(splits, &held_out, set.observations.len()).unwrap_or_default(),
    };
    let sigma = match estimate.noise {
        NoiseScale::Stated => None,
        NoiseScale::Residuals(sigma) => Some(sigma),
    };
    let squares = errors(&estimate.robot, set)?.iter().map(nalgebra::Vector3::norm_squared).sum();
    let is_misfit = estimate.found_machine().is_some();
    Ok(Tried::Fitted(Fitted { variant, sigma, squares, is_misfit, not_converged }))
}

/// Splits of the observations that keep those of one pose together: they share its errors.
pub(super) fn pose_folds(set: &MeasurementSet, folds: usize, seed: u64) -> Vec<Split> {
    let poses = distinct_poses(set);
    let mut rng = stream(seed, 0, StreamSource::Folds);
    let observations = |part: &[usize]| {
        let chosen: BTreeSet<_> = part.iter().map(|place| poses[*place]).collect();
        let all = set.observations.iter().enumerate();
        all.filter(|(_, o)| chosen.contains(&o.pose)).map(|(i, _)| i).collect()
    };
    k_fold(poses.len(), folds, &mut rng)
        .into_iter()
        .map(|split| Split { fitted: observations(&split.fitted), held_out: observations(&split.held_out) })
        .collect()
}

/// Numbers of the poses, in the order in which they were taken.
fn distinct_poses(set: &MeasurementSet) -> Vec<u32> {
    let mut seen = BTreeSet::new();
    set.observations.iter().map(|observation| observation.pose).filter(|pose| seen.insert(*pose)).collect()
}
