//! Whether a model that explains more predicts better: nested models side by side.

use serde::{Deserialize, Serialize};
use std::fmt;

use nalgebra::Vector3;

use super::{Criteria, Fit, Interval, NoiseLevel, accuracy, paired_rms_difference};

/// A model that was fitted to all observations, and to parts of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Variant {
    /// What the model adds, in words.
    pub name: String,
    /// Index of the model with which it is compared; `None` for the first.
    pub against: Option<usize>,
    /// Number of parameters.
    pub parameters: usize,
    /// The fit to all observations.
    pub fit: Fit,
    /// Error of every observation (measured minus predicted, m) from a fit without it, in the same order for all variants.
    pub held_out: Vec<Vector3<f64>>,
}

/// Value of a step from one model to the next.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// There is nothing to compare with.
    Reference,
    /// It predicts held-out poses better, beyond chance.
    Pays,
    /// It fits better than chance explains (`AICc`), but held-out poses do not show it yet; more poses may.
    Undecided,
    /// Neither held-out poses nor `AICc` favour it.
    DoesNotPay,
    /// It predicts held-out poses worse, beyond chance.
    Hurts,
}

/// One row of the table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct VariantRow {
    /// What the model adds, in words.
    pub name: String,
    /// Name of the row with which it is compared.
    pub against: Option<String>,
    /// Number of parameters.
    pub parameters: usize,
    /// Number of parameters that the data determine.
    pub effective_parameters: f64,
    /// Chi-square of the data over rows minus effective parameters; `None` without a degree of freedom.
    pub chi2_per_dof: Option<f64>,
    /// Information criteria, less those of the best row: zero for the best.
    pub above_best: Criteria,
    /// RMS of the 3-D held-out errors, m.
    pub held_out_rms: Option<f64>,
    /// How much smaller the held-out RMS is than in the row with which it is compared, m.
    pub gain: Option<Interval>,
    /// Value of the step.
    pub verdict: Verdict,
}

/// The table of `variants` of the same data; intervals have confidence `level`.
pub fn compare_variants(variants: &[Variant], noise: NoiseLevel, level: f64) -> Vec<VariantRow> {
    let criteria: Vec<_> = variants.iter().map(|v| v.fit.criteria(noise)).collect();
    let least = |of: fn(&Criteria) -> f64| criteria.iter().map(of).fold(f64::INFINITY, f64::min);
    let best = Criteria { aic: least(|c| c.aic), aicc: least(|c| c.aicc), bic: least(|c| c.bic) };
    variants
        .iter()
        .enumerate()
        .map(|(i, variant)| {
            let Fit { chi2, rows, parameters } = variant.fit;
            let dof = rows as f64 - parameters;
            let other = variant.against.filter(|other| *other < variants.len());
            let gain = other
                .and_then(|other| paired_rms_difference(&variants[other].held_out, &variant.held_out, level));
            let verdict = other
                .map_or(Verdict::Reference, |other| verdict(gain, criteria[i].aicc < criteria[other].aicc));
            VariantRow {
                name: variant.name.clone(),
                against: other.map(|other| variants[other].name.clone()),
                parameters: variant.parameters,
                effective_parameters: parameters,
                chi2_per_dof: (dof > 0.0).then(|| chi2 / dof),
                above_best: Criteria {
                    aic: criteria[i].aic - best.aic,
                    aicc: criteria[i].aicc - best.aicc,
                    bic: criteria[i].bic - best.bic,
                },
                held_out_rms: accuracy(&variant.held_out).map(|row| row.rms_3d),
                gain,
                verdict,
            }
        })
        .collect()
}

fn verdict(gain: Option<Interval>, criterion_agrees: bool) -> Verdict {
    match gain {
        Some(gain) if gain.low > 0.0 => Verdict::Pays,
        Some(gain) if gain.high < 0.0 => Verdict::Hurts,
        _ if criterion_agrees => Verdict::Undecided,
        _ => Verdict::DoesNotPay,
    }
}

impl Verdict {
    /// The key in JSON.
    pub fn key(self) -> &'static str {
        match self {
            Self::Reference => "reference",
            Self::Pays => "pays",
            Self::Undecided => "undecided",
            Self::DoesNotPay => "does_not_pay",
            Self::Hurts => "hurts",
        }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Reference => "reference",
            Self::Pays => "pays",
            Self::Undecided => "undecided: measure more poses",
            Self::DoesNotPay => "does not pay",
            Self::Hurts => "makes predictions worse",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// A linear model of `columns` basis functions, fitted to all poses and to all but one.
    fn variant(name: &str, columns: usize, basis: &DMatrix<f64>, y: &DVector<f64>, sigma: f64) -> Variant {
        let a = basis.columns(0, columns).into_owned();
        let fit = |a: &DMatrix<f64>, y: &DVector<f64>| {
            a.tr_mul(a).cholesky().expect("full rank").solve(&a.tr_mul(y))
        };
        let residuals = y - &a * fit(&a, y);
        let held_out = (0..y.len() / 3)
            .map(|i| {
                let x = fit(&a.clone().remove_rows(3 * i, 3), &y.clone().remove_rows(3 * i, 3));
                Vector3::from_iterator((y.rows(3 * i, 3) - a.rows(3 * i, 3) * x).iter().copied())
            })
            .collect();
        let chi2 = residuals.norm_squared() / (sigma * sigma);
        let fit = Fit { chi2, rows: y.len(), parameters: columns as f64 };
        Variant { name: name.to_owned(), against: None, parameters: columns, fit, held_out }
    }

    /// Three functions with an effect, a fourth with a small one, forty with none.
    #[test]
    fn what_acts_pays_and_what_does_not_act_does_not() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let (poses, sigma) = (80, 1e-4);
        let basis = DMatrix::from_fn(3 * poses, 44, |_, _| rng.random_range(-1.0..1.0));
        let mut y = DVector::from_fn(3 * poses, |_, _| -> f64 { StandardNormal.sample(&mut rng) }) * sigma;
        for (column, amplitude) in [2e-3, -1e-3, 1e-3, 4e-5].into_iter().enumerate() {
            y += basis.column(column) * amplitude;
        }
        let mut variants: Vec<_> = [("two", 2), ("third", 3), ("fourth", 4), ("all", 44)]
            .map(|(name, columns)| variant(name, columns, &basis, &y, sigma))
            .into();
        for (i, variant) in variants.iter_mut().enumerate() {
            variant.against = i.checked_sub(1);
        }
        for noise in [NoiseLevel::Known, NoiseLevel::Estimated] {
            let rows = compare_variants(&variants, noise, 0.95);
            assert_eq!(rows[0].verdict, Verdict::Reference);
            assert_eq!(rows[1].verdict, Verdict::Pays);
            assert_eq!(rows[1].against.as_deref(), Some("two"));
            assert!(rows[1].gain.is_some_and(|g| g.low > 2e-4 && g.high < 1.5e-3), "{:?}", rows[1]);
            assert!(rows[1].chi2_per_dof.is_some_and(|c| c > 0.7 && c < 1.4));
            assert!([Verdict::Pays, Verdict::Undecided].contains(&rows[2].verdict), "{:?}", rows[2]);
            // Forty useless parameters cost 40/240 of the variance.
            assert_eq!(rows[3].verdict, Verdict::Hurts, "{:?}", rows[3]);
            assert!(rows[3].above_best.bic > 50.0 && rows.iter().any(|r| r.above_best.bic == 0.0));
        }
    }

    #[test]
    fn verdicts_by_hand() {
        let gain = |low, high| Some(Interval { value: 0.5 * (low + high), low, high });
        assert_eq!(verdict(gain(1.0, 2.0), false), Verdict::Pays);
        assert_eq!(verdict(gain(-2.0, -1.0), true), Verdict::Hurts);
        assert_eq!(verdict(gain(-1.0, 1.0), true), Verdict::Undecided);
        assert_eq!(verdict(gain(-1.0, 1.0), false), Verdict::DoesNotPay);
        assert_eq!(verdict(None, false), Verdict::DoesNotPay);
        assert_eq!(format!("{}", Verdict::DoesNotPay), "does not pay");
        assert!(compare_variants(&[], NoiseLevel::Known, 0.95).is_empty());
    }
}
