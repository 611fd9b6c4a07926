//! The size of a family's terms, where it is not stated and machines differ too much for a single figure.
//!
//! With the amplitudes integrated out, the data determine their common size by its likelihood, once everything else is fitted. Let the amplitudes z
//! have the prior `N(0, s² D²)`, and let the data alone give `A⁻¹ b` with the information A; then the likelihood is the density of `A⁻¹ b` under
//! `N(0, s² D² + A⁻¹)`. The smoothness of a spline is chosen in the same way (G. Wahba, "A comparison of GCV and GML for choosing the smoothing
//! parameter in the generalized spline smoothing problem", Ann. Statist. 13 (1985) 1378: generalized maximum likelihood).

use nalgebra::{Cholesky, DMatrix, DVector, SymmetricEigen};

use super::IdentificationOptions;
use super::build::Built;
use super::solver::Solution;
use calibrig_model::{FAMILIES, ParameterId, TermFamily};

/// Sizes that change by less than this share have converged.
const SETTLED: f64 = 0.1;
/// Sizes are sought from a thousandth to a thousand times the typical one; at a thousandth the family adds nothing. The logarithm of a thousand.
const MOST: f64 = 6.907_755_278_982_137;
const STEPS: u32 = 140;
/// The chosen size is above the likeliest by about its own standard deviation, where twice the logarithm of the likelihood has fallen by this
/// much: too small a size makes all intervals too narrow, too large a one hardly makes any too wide.
const FALL: f64 = 1.0;

/// Sets the terms of every family without a stated size to the size that the fit shows. Returns whether that changes what was fitted.
pub(super) fn resize(built: &mut Built, solution: &Solution, options: &IdentificationOptions) -> bool {
    let of_unknown_size = FAMILIES.iter().filter(|family| {
        family.is_of_unknown_size() && options.term_priors.iter().all(|prior| prior.family != family.key())
    });
    let mut resized = false;
    for family in of_unknown_size {
        let Some((now, size)) = found_size(built, solution, *family) else { continue };
        if (size / now).ln().abs() < SETTLED {
            continue;
        }
        resized = true;
        for (column, unit) in own_columns(built, *family) {
            built.sigmas[column] = Some(size * unit);
            for (_, weight) in built.problem.own_priors.iter_mut().filter(|(own, _)| *own == column) {
                *weight = 1.0 / (size * unit);
            }
        }
    }
    resized
}

/// Columns of the family's amplitudes, and the typical size of each on such machines, m or rad.
fn own_columns(built: &Built, family: &dyn TermFamily) -> Vec<(usize, f64)> {
    let own = |(column, id): (usize, &ParameterId)| match id {
        ParameterId::Term(term) if term.family().key() == family.key() => Some((column, term.prior_sigma())),
        _ => None,
    };
    built.problem.parameters.iter().enumerate().filter_map(own).collect()
}

/// The size of the family's prior in the fit, and the one that the data show, relative to the typical size; `None` where none is fitted, or where
/// the other parameters are not determined.
fn found_size(built: &Built, solution: &Solution, family: &dyn TermFamily) -> Option<(f64, f64)> {
    let own = own_columns(built, family);
    let (first, unit) = own.first()?;
    let now = built.sigmas[*first]? / unit;
    let is_free = |column: &usize| {
        own.iter().all(|(own, _)| own != column) && solution.at_bound.iter().all(|at| at.parameter != *column)
    };
    let others: Vec<usize> = (0..solution.x.len()).filter(is_free).collect();
    let amplitudes: Vec<usize> = own.iter().map(|(column, _)| *column).collect();
    let units = DVector::from_iterator(own.len(), own.iter().map(|(_, unit)| *unit));
    // In units of the typical size, and for the other parameters in units of their standard deviation with all others known.
    let mut z = solution.jacobian.select_columns(&amplitudes);
    z.column_iter_mut().zip(&units).for_each(|(mut column, unit)| column *= *unit);
    let mut o = solution.jacobian.select_columns(&others);
    for mut column in o.column_iter_mut() {
        let norm = column.norm();
        column.scale_mut(if norm > 0.0 { norm.recip() } else { 1.0 });
    }
    let with_others = o.tr_mul(&z);
    let normal = Cholesky::new(o.tr_mul(&o))?;
    let precision = 1.0 / (now * now);
    let information = z.tr_mul(&z)
        - with_others.tr_mul(&normal.solve(&with_others))
        - DMatrix::identity(own.len(), own.len()) * precision;
    let value = DVector::from_iterator(own.len(), amplitudes.iter().map(|column| solution.x[*column]))
        .component_div(&units);
    // At the minimum the pulls of data and prior are equal and opposite.
    let score = &information * &value + precision * &value;
    let SymmetricEigen { eigenvalues, eigenvectors } = SymmetricEigen::new(information);
    let scores = eigenvectors.tr_mul(&score);
    // Twice the logarithm of the likelihood.
    let likelihood = |logarithm: f64| -> f64 {
        let variance = (2.0 * logarithm).exp();
        let of_one = |(told, score): (&f64, &f64)| {
            let total = 1.0 + variance * told.max(0.0);
            score * score * variance / total - total.ln()
        };
        eigenvalues.iter().zip(&scores).map(of_one).sum()
    };
    let places = (0..=STEPS).map(|step| MOST * (2.0 * f64::from(step) / f64::from(STEPS) - 1.0));
    let best = places.clone().map(&likelihood).max_by(f64::total_cmp)?;
    let cautious = places.rev().find(|place| likelihood(*place) >= best - FALL)?;
    best.is_finite().then_some((now, cautious.exp()))
}
