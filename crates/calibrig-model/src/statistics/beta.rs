//! Beta, F, Student's t and binomial distribution.

use std::f64::consts::TAU;

use super::gamma::{deviance, half, stirling_error};
use super::{continued_fraction, invert, ln_gamma, normal_quantile, terms_for};

/// Above this, the fraction takes too long; no count is as large.
const MOST: f64 = 1e9;
/// From here on the difference of the logarithms of gamma functions loses too many digits.
const LARGE: f64 = 1e5;

/// Logarithm of `x^a (1-x)^b / (a B(a, b))`.
///
/// Source of the form for large numbers: C. Loader, "Fast and accurate computation of binomial probabilities" (2000).
fn ln_factor(a: f64, b: f64, x: f64) -> f64 {
    let n = a + b;
    if n < LARGE || a < 1.0 || b < 1.0 {
        return ln_gamma(n) - ln_gamma(a) - ln_gamma(b) + a * x.ln() + b * (-x).ln_1p() - a.ln();
    }
    let away = a * deviance(a, n * x) + b * deviance(b, n * (1.0 - x));
    0.5 * (b / a / n / TAU).ln() + stirling_error(n) - stirling_error(a) - stirling_error(b) - away
}

/// Logarithm of the regularised incomplete beta function of `a`, `b` at `x`, for x on the side where its fraction converges fast.
///
/// Source: NIST Digital Library of Mathematical Functions, 8.17.22.
fn ln_beta_by_fraction(a: f64, b: f64, x: f64) -> f64 {
    let fraction = continued_fraction(terms_for(a.max(b)), |i| {
        let m = (i / 2) as f64;
        let numerator = if i % 2 == 0 {
            m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m))
        } else {
            -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0))
        };
        (numerator, 1.0)
    });
    (ln_factor(a, b, x) + fraction.ln()).min(0.0)
}

/// Logarithm of the regularised incomplete beta function `I_x(a, b)`; accurate where it is small.
fn ln_beta_regularised(a: f64, b: f64, x: f64) -> f64 {
    if !(a > 0.0 && b > 0.0 && a <= MOST && b <= MOST) {
        return f64::NAN;
    }
    if !(x > 0.0) {
        return if x.is_nan() { x } else { f64::NEG_INFINITY };
    }
    if x >= 1.0 {
        return 0.0;
    }
    if x < (a + 1.0) / (a + b + 2.0) {
        ln_beta_by_fraction(a, b, x)
    } else {
        (-ln_beta_by_fraction(b, a, 1.0 - x).exp()).ln_1p()
    }
}

/// The regularised incomplete beta function `I_x(a, b)`, for a, b above 0 and up to 1e9 and x in 0..1; NaN for other a and b.
pub fn beta_regularised(a: f64, b: f64, x: f64) -> f64 {
    ln_beta_regularised(a, b, x).exp()
}

/// Logarithm of the probability that F with (`d1`, `d2`) degrees of freedom is above `f`: finite even if the probability itself
/// underflows. NaN if one of them is not above zero, or above 2e9.
pub fn f_ln_survival(f: f64, d1: f64, d2: f64) -> f64 {
    if !(f > 0.0) {
        return if f.is_nan() { f } else { 0.0 };
    }
    if f.is_infinite() {
        return f64::NEG_INFINITY;
    }
    ln_beta_regularised(half(d2), half(d1), d2 / (d2 + d1 * f))
}

/// The point below which Student's t with `dof` degrees of freedom lies with probability `p`. NaN if `p` is outside 0..1 or `dof` is not
/// above zero.
pub fn student_t_quantile(p: f64, dof: f64) -> f64 {
    if p.is_nan() || !(dof > 0.0) {
        return f64::NAN;
    }
    // From here on it is the normal distribution, to more digits than the beta function keeps.
    if dof > 1e8 {
        return normal_quantile(p);
    }
    // Both tails hold I_x(dof/2, 1/2) with x = dof / (dof + t²).
    let tails = 2.0 * p.min(1.0 - p);
    let far = if tails > 0.0 {
        let x = invert(tails, 0.0, 1.0, |x| beta_regularised(half(dof), 0.5, x));
        (dof * (1.0 - x) / x).sqrt()
    } else {
        f64::INFINITY
    };
    if p < 0.5 { -far } else { far }
}

/// Probability of at most `hits` successes in `trials` of probability `p` each; NaN for more than 1e9 trials.
pub fn binomial_cdf(hits: u64, trials: u64, p: f64) -> f64 {
    if hits >= trials { 1.0 } else { beta_regularised((trials - hits) as f64, hits as f64 + 1.0, 1.0 - p) }
}

/// Exact two-sided interval for the probability behind `hits` of `trials`, with confidence `level`.
///
/// Source: C. J. Clopper, E. S. Pearson, "The use of confidence or fiducial limits illustrated in the case of the binomial", Biometrika 26
/// (1934), 404-413. NaN for more than 1e9 trials.
pub fn clopper_pearson(hits: u64, trials: u64, level: f64) -> (f64, f64) {
    let tail = 0.5 * (1.0 - level);
    if trials as f64 > MOST {
        return (f64::NAN, f64::NAN);
    }
    let (k, n) = (hits as f64, trials as f64);
    let low = if hits == 0 { 0.0 } else { invert(tail, 0.0, 1.0, |p| beta_regularised(k, n - k + 1.0, p)) };
    let high = if hits >= trials { 1.0 } else { invert(-tail, 0.0, 1.0, |p| -binomial_cdf(hits, trials, p)) };
    (low, high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::normal_survival;

    fn close(found: f64, expected: f64, tolerance: f64) {
        let error = ((found - expected) / expected).abs();
        assert!(error <= tolerance, "{found} instead of {expected}: {error:e}");
    }

    #[test]
    fn beta_against_closed_forms() {
        for x in [1e-6, 0.01, 0.3, 0.7, 0.999] {
            for n in [1.0, 3.5, 40.0] {
                close(beta_regularised(n, 1.0, x), x.powf(n), 1e-12);
                close(beta_regularised(1.0, n, x), -(n * (-x).ln_1p()).exp_m1(), 1e-11);
            }
            close(beta_regularised(0.5, 0.5, x), 2.0 / std::f64::consts::PI * x.sqrt().asin(), 1e-12);
        }
        assert_eq!((beta_regularised(2.0, 3.0, 0.0), beta_regularised(2.0, 3.0, 1.0)), (0.0, 1.0));
    }

    /// NIST/SEMATECH e-Handbook of Statistical Methods, tables 1.3.6.7.2 and 1.3.6.7.3 (three decimals).
    #[test]
    fn student_and_fisher_are_the_published_ones() {
        for (dof, p, published) in
            [(1.0, 0.975, 12.706), (10.0, 0.975, 2.228), (10.0, 0.999, 4.144), (60.0, 0.95, 1.671)]
        {
            let found = student_t_quantile(p, dof);
            assert!((found - published).abs() <= 5.1e-4, "{dof} {p}: {found}");
            close(student_t_quantile(1.0 - p, dof), -found, 1e-9);
        }
        for (d1, d2, p, published) in [
            (1.0, 10.0, 0.05, 4.965),
            (3.0, 20.0, 0.05, 3.098),
            (10.0, 50.0, 0.01, 2.698),
            (5.0, 5.0, 0.10, 3.453),
        ] {
            // The table's last decimal times the density of F there.
            close(f_ln_survival(published, d1, d2).exp(), p, 1e-3);
        }
        // With two degrees of freedom above, F has a closed form, far below what a number can hold.
        for f in [0.5, 3.0, 100.0, 1e6] {
            close(f_ln_survival(f, 2.0, 300.0), -150.0 * (2.0 * f / 300.0).ln_1p(), 1e-11);
        }
    }

    #[test]
    fn binomial_is_the_sum_of_its_terms() {
        let (n, p) = (40_u64, 0.95_f64);
        let (mut term, mut sum) = (0.05_f64.powi(40), 0.0);
        for k in 0..n {
            sum += term;
            close(binomial_cdf(k, n, p), sum, 1e-10);
            term *= (n - k) as f64 / (k + 1) as f64 * p / (1.0 - p);
        }
        assert_eq!(binomial_cdf(n, n, p), 1.0);
    }

    #[test]
    fn clopper_pearson_holds_half_of_the_rest_in_either_tail() {
        let (low, high) = clopper_pearson(7, 50, 0.95);
        close(1.0 - binomial_cdf(6, 50, low), 0.025, 1e-9);
        close(binomial_cdf(7, 50, high), 0.025, 1e-9);
        let (low, high) = clopper_pearson(0, 10, 0.95);
        assert_eq!(low, 0.0);
        close(high, 1.0 - 0.025_f64.powf(0.1), 1e-12);
        assert_eq!(clopper_pearson(10, 10, 0.95).1, 1.0);
        close(clopper_pearson(10, 10, 0.95).0, 0.025_f64.powf(0.1), 1e-12);
    }

    /// A symmetric one is a half in the middle; many trials are normal but for their skewness, few hits among many are Poisson's.
    #[test]
    fn large_counts_keep_their_digits() {
        for a in [1e4, 4e4, 6e4, 1e6, 1e8, 1e9] {
            close(beta_regularised(a, a, 0.5), 0.5, 1e-9);
        }
        let (n, p) = (900_000_000_u64, 0.3_f64);
        for z in [-4.0_f64, -1.0, 0.5, 3.0] {
            let deviation = (n as f64 * p * (1.0 - p)).sqrt();
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
            let hits = (n as f64 * p + z * deviation).round() as u64;
            // With the correction for continuity and Edgeworth's term of skewness.
            let u = (hits as f64 + 0.5 - n as f64 * p) / deviation;
            let density = (-0.5 * u * u).exp() / TAU.sqrt();
            let expected =
                normal_survival(-u) - (1.0 - 2.0 * p) / (6.0 * deviation) * (u * u - 1.0) * density;
            close(binomial_cdf(hits, n, p), expected, 1e-6);
        }
        let mean = 3.0_f64;
        let poisson = (-mean).exp() * (1.0 + mean + mean * mean / 2.0);
        // One less so small a probability keeps it to a part in 3e7.
        close(binomial_cdf(2, 1_000_000_000, mean * 1e-9), poisson, 4e-8);
        assert!(binomial_cdf(1, 1 << 62, 0.5).is_nan() && clopper_pearson(1, 1 << 62, 0.9).0.is_nan());
        assert_eq!(student_t_quantile(1e-20, 1e9), normal_quantile(1e-20));
        // Cauchy's distribution, with one degree of freedom.
        close(student_t_quantile(1e-20, 1.0), -1e20 / std::f64::consts::PI, 1e-9);
    }
}
