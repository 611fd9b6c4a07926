//! Gamma, chi-square and normal distribution.

use std::f64::consts::PI;

use super::{continued_fraction, invert, terms_for};

/// Coefficients of Lanczos' approximation with g = 7 and nine terms.
///
/// Source: C. Lanczos, "A precision approximation of the gamma function", SIAM J. Numer. Anal. B 1 (1964), 86-96; coefficients after P. Godfrey (2001).
const LANCZOS: [f64; 9] = [
    0.999_999_999_999_809_9,
    676.520_368_121_885_1,
    -1_259.139_216_722_402_8,
    771.323_428_777_653_1,
    -176.615_029_162_140_6,
    12.507_343_278_686_905,
    -0.138_571_095_265_720_12,
    9.984_369_578_019_572e-6,
    1.505_632_735_149_311_6e-7,
];

/// Logarithm of the gamma function, for x > 0.
pub fn ln_gamma(x: f64) -> f64 {
    if x >= LARGE {
        return (x - 0.5) * x.ln() - x + 0.5 * (2.0 * PI).ln() + stirling_error(x);
    }
    if x < SMALL {
        // Γ(x) = 1/x - γ + ...
        return -x.ln();
    }
    let x = x - 1.0;
    let series: f64 = LANCZOS.iter().enumerate().skip(1).map(|(i, c)| c / (x + i as f64)).sum();
    let t = x + 7.5;
    0.5 * (2.0 * PI).ln() + (x + 0.5) * t.ln() - t + (LANCZOS[0] + series).ln()
}

/// From here on Stirling's series is exact to rounding.
const LARGE: f64 = 16.0;
/// Below this, a number is lost next to one.
const SMALL: f64 = 1e-17;

/// What Stirling's formula leaves of ln Γ(x): `1/(12x) - 1/(360x³) + ...`.
pub(super) fn stirling_error(x: f64) -> f64 {
    if x < LARGE {
        return ln_gamma(x) - ((x - 0.5) * x.ln() - x + 0.5 * (2.0 * PI).ln());
    }
    let s = 1.0 / (x * x);
    (1.0 / 12.0 - s * (1.0 / 360.0 - s * (1.0 / 1260.0 - s * (1.0 / 1680.0 - s * (1.0 / 1188.0))))) / x
}

/// `x^a e^-x / Γ(a)`, without the cancellation that its three factors have for large `a`.
///
/// Source: C. Loader, "Fast and accurate computation of binomial probabilities" (2000), for the saddle-point form.
fn density_factor(a: f64, x: f64) -> f64 {
    (0.5 * (a / (2.0 * PI)).ln() - a * deviance(a, x) - stirling_error(a)).exp()
}

/// λ - 1 - ln λ at λ = x/a.
pub(super) fn deviance(a: f64, x: f64) -> f64 {
    let (relative, ratio) = ((x - a) / a, x / a);
    if relative.abs() < 0.1 {
        relative - relative.ln_1p()
    } else if ratio.is_normal() {
        relative - ratio.ln()
    } else {
        // The ratio overflows; its logarithm does not.
        relative - (x.ln() - a.ln())
    }
}

/// From here on the cube root of chi-square is normal to more digits than a series of any length gives.
///
/// Source: E. B. Wilson, M. M. Hilferty, "The distribution of chi-square", Proc. Natl. Acad. Sci. 17 (1931), 684-688.
const NORMAL: f64 = 1e9;
/// Below this, the part that is not at zero is smaller than any number in use.
const NOTHING: f64 = 1e-290;

/// The regularised incomplete gamma functions (P, Q) of a > 0 at x >= 0; the smaller one keeps its relative accuracy. NaN for other a.
fn gamma_regularised(a: f64, x: f64) -> (f64, f64) {
    if !(a > 0.0) {
        return (f64::NAN, f64::NAN);
    }
    if !(x > 0.0) {
        return if x.is_nan() { (x, x) } else { (0.0, 1.0) };
    }
    // With hardly any degrees of freedom all of it is at zero.
    if x.is_infinite() || a < NOTHING {
        return (1.0, 0.0);
    }
    if a > NORMAL {
        let z = 3.0 * a.sqrt() * ((x / a).cbrt() - 1.0 + 1.0 / (9.0 * a));
        return (normal_survival(-z), normal_survival(z));
    }
    let terms = terms_for(a.max(x));
    let factor = density_factor(a, x);
    if factor == 0.0 {
        // So far out that it underflows; there the fraction may not converge, because its terms are no longer exact.
        return if x < a { (0.0, 1.0) } else { (1.0, 0.0) };
    }
    if x < a + 1.0 {
        let (mut term, mut sum) = (1.0 / a, 1.0 / a);
        for i in 1..terms {
            term *= x / (a + i as f64);
            sum += term;
            if term < sum * 0.1 * f64::EPSILON {
                break;
            }
        }
        let p = (factor * sum).min(1.0);
        (p, 1.0 - p)
    } else {
        let fraction = continued_fraction(terms, |i| {
            let i = i as f64;
            (-i * (i - a), x + 2.0 * i + 1.0 - a)
        });
        let q = (factor * fraction).min(1.0);
        (1.0 - q, q)
    }
}

/// Half of the degrees of freedom, above zero where they are.
pub(super) fn half(dof: f64) -> f64 {
    if dof > 0.0 { (0.5 * dof).max(f64::MIN_POSITIVE) } else { 0.5 * dof }
}

/// Probability that chi-square with `dof` degrees of freedom is below `x`.
pub fn chi2_cdf(x: f64, dof: f64) -> f64 {
    gamma_regularised(half(dof), 0.5 * x).0
}

/// Probability that chi-square with `dof` degrees of freedom is above `x`: the p-value of a chi-square test.
pub fn chi2_survival(x: f64, dof: f64) -> f64 {
    gamma_regularised(half(dof), 0.5 * x).1
}

/// The point below which chi-square with `dof` degrees of freedom lies with probability `p`; infinite for p >= 1. NaN if `dof` is not finite
/// and above zero.
pub fn chi2_quantile(p: f64, dof: f64) -> f64 {
    if !(dof > 0.0 && dof.is_finite()) {
        return f64::NAN;
    }
    if !(p > 0.0) {
        return if p.is_nan() { p } else { 0.0 };
    }
    if p >= 1.0 {
        return f64::INFINITY;
    }
    if dof > 2.0 * NORMAL {
        let spread = (2.0 / dof).sqrt() / 3.0;
        return dof * (1.0 - spread * spread + spread * normal_quantile(p)).powi(3);
    }
    let mut high = dof.max(1.0);
    while chi2_survival(high, dof) > 1.0 - p {
        high *= 2.0;
    }
    if p <= 0.5 {
        invert(p, 0.0, high, |x| chi2_cdf(x, dof))
    } else {
        invert(p - 1.0, 0.0, high, |x| -chi2_survival(x, dof))
    }
}

/// Probability that a standard normal variable is above `z`.
pub fn normal_survival(z: f64) -> f64 {
    let (below, above) = gamma_regularised(0.5, 0.5 * z * z);
    if z >= 0.0 { 0.5 * above } else { 0.5 + 0.5 * below }
}

/// The point below which a standard normal variable lies with probability `p`; infinite for p <= 0 and p >= 1.
pub fn normal_quantile(p: f64) -> f64 {
    let tail = p.min(1.0 - p);
    // Subtracting twice as much from one would lose the digits of a small tail.
    if tail > 0.0 && tail < 1e-7 {
        let far = invert(-tail, 0.0, 40.0, |z| -normal_survival(z));
        return if p < 0.5 { -far } else { far };
    }
    if p < 0.5 { -chi2_quantile(1.0 - 2.0 * p, 1.0).sqrt() } else { chi2_quantile(2.0 * p - 1.0, 1.0).sqrt() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(found: f64, expected: f64, tolerance: f64) {
        let error = ((found - expected) / expected).abs();
        assert!(error <= tolerance, "{found} instead of {expected}: {error:e}");
    }

    #[test]
    fn gamma_is_the_factorial_and_half_integers_are_closed_forms() {
        let mut factorial = 1.0_f64;
        for n in 1..=60_u32 {
            close(ln_gamma(f64::from(n) + 1.0).exp(), factorial * f64::from(n), 2e-13);
            factorial *= f64::from(n);
        }
        close(ln_gamma(0.5), PI.sqrt().ln(), 1e-14);
        close(ln_gamma(1e-3), 6.907_178_885_383_854, 1e-14);
    }

    /// With two degrees of freedom chi-square is exponential; with an even number, a Poisson sum; with one, the error function.
    #[test]
    fn chi_square_against_closed_forms() {
        for x in [1e-8, 0.1, 1.0, 5.0, 40.0, 300.0, 1400.0] {
            close(chi2_survival(x, 2.0), (-0.5 * x).exp(), 1e-12);
            for dof in [4_u32, 10, 60, 400] {
                let mut term = (-0.5 * x).exp();
                let mut sum = term;
                for i in 1..dof / 2 {
                    term *= 0.5 * x / f64::from(i);
                    sum += term;
                }
                close(chi2_survival(x, f64::from(dof)), sum, 1e-11);
            }
        }
        close(normal_survival(1.0), 0.158_655_253_931_457_05, 1e-13);
        close(normal_survival(6.0), 9.865_876_450_376_946e-10, 1e-12);
        close(normal_survival(-1.0), 0.841_344_746_068_543, 1e-13);
    }

    /// NIST/SEMATECH e-Handbook of Statistical Methods, table 1.3.6.7.4 (three decimals).
    #[test]
    fn chi_square_quantiles_are_the_published_ones() {
        for (dof, p, published) in [
            (1.0, 0.95, 3.841),
            (3.0, 0.99, 11.345),
            (10.0, 0.90, 15.987),
            (10.0, 0.999, 29.588),
            (30.0, 0.975, 46.979),
            (100.0, 0.999, 149.449),
            (10.0, 0.05, 3.940),
            (10.0, 0.001, 1.479),
            (100.0, 0.01, 70.065),
        ] {
            let found = chi2_quantile(p, dof);
            assert!((found - published).abs() <= 5.1e-4, "{dof} {p}: {found}");
        }
        close(normal_quantile(0.975), 1.959_963_984_540_054, 1e-13);
        close(normal_quantile(0.0005), -3.290_526_731_491_9, 1e-12);
    }

    #[test]
    fn quantiles_invert_the_distribution_for_few_and_for_very_many_degrees_of_freedom() {
        for dof in [0.5, 1.0, 7.0, 300.0, 4e5] {
            for p in [1e-9, 1e-3, 0.3, 0.5, 0.9, 1.0 - 1e-9] {
                close(chi2_cdf(chi2_quantile(p, dof), dof), p, 1e-9);
            }
        }
        assert_eq!(chi2_quantile(0.0, 3.0), 0.0);
        assert_eq!(chi2_quantile(1.0, 3.0), f64::INFINITY);
        // Of so many all but a part in 1e7 is normal.
        close(chi2_quantile(0.9995, 1e15), 1e15 + 3.290_526_731_491_9 * 2e15_f64.sqrt(), 1e-12);
        // Normal with mean n and variance 2n, plus skewness: Cornish-Fisher at the 99.95 % point.
        let (n, z) = (4e5_f64, 3.290_526_731_491_9_f64);
        let expected = n + z * (2.0 * n).sqrt() + 2.0 / 3.0 * (z * z - 1.0);
        close(chi2_quantile(0.9995, n), expected, 1e-7);
    }

    /// Tails by the asymptotic series of the error function; what is next to nothing by its first term.
    #[test]
    fn extremes_keep_their_digits() {
        close(normal_quantile(1e-20), -9.262_340_089_798_408, 1e-12);
        for z in [6.0_f64, 10.0, 30.0] {
            close(normal_quantile(normal_survival(z)), -z, 1e-12);
            let series =
                1.0 - 1.0 / (z * z) * (1.0 - 3.0 / (z * z) * (1.0 - 5.0 / (z * z) * (1.0 - 7.0 / (z * z))));
            close(normal_survival(z), (-0.5 * z * z).exp() / (z * (2.0 * PI).sqrt()) * series, 2e-5);
        }
        close(ln_gamma(1e-300), 300.0 * 10.0_f64.ln(), 1e-14);
        close(ln_gamma(5e-324), -(5e-324_f64.ln()), 1e-14);
        // x^a / Γ(a + 1), as x is small.
        close(chi2_cdf(2e-320, 1.0), (4.0 * 1e-320 / PI).sqrt(), 1e-3);
        for dof in [5e-324, 1e-300, 1e-20] {
            assert_eq!((chi2_cdf(1.0, dof), chi2_cdf(1e300, dof)), (1.0, 1.0), "{dof}");
            assert!(chi2_survival(1.0, dof) < 1e-15);
        }
        for dof in [1.0, 5e3, 1e9] {
            assert_eq!((chi2_cdf(f64::MAX, dof), chi2_survival(f64::MAX, dof)), (1.0, 0.0), "{dof}");
        }
    }
}
