//! The distributions that tests and intervals are read from, to about 1e-12 relative.

mod beta;
mod gamma;

pub use beta::{beta_regularised, binomial_cdf, clopper_pearson, f_ln_survival, student_t_quantile};
pub use gamma::{chi2_cdf, chi2_quantile, chi2_survival, ln_gamma, normal_quantile, normal_survival};

/// The root of an increasing function in `[low, high]`, both not negative, to the last bit: where it passes `level`.
fn invert(level: f64, mut low: f64, mut high: f64, function: impl Fn(f64) -> f64) -> f64 {
    loop {
        // First the exponent: bisection alone takes a thousand steps to a root next to zero.
        let middle = if high > 2.0 * low {
            f64::from_bits(low.to_bits().midpoint(high.to_bits()))
        } else {
            0.5 * (low + high)
        };
        if !(middle > low && middle < high) {
            return middle;
        }
        if function(middle) < level {
            low = middle;
        } else {
            high = middle;
        }
    }
}

/// Half-width of a 95 % interval in standard deviations of a normal distribution.
pub const NORMAL_95: f64 = 1.959_963_984_540_054;

/// Sum of a continued fraction `1 / (b0 + a1 / (b1 + a2 / (b2 + ...)))` by Lentz's method. `term(i)` gives `(a_i, b_i)`; `a_0` is not used.
///
/// Source: I. J. Thompson, A. R. Barnett, "Coulomb and Bessel functions of complex arguments and order", J. Comput. Phys. 64 (1986), 490-509.
fn continued_fraction(terms: usize, term: impl Fn(usize) -> (f64, f64)) -> f64 {
    const TINY: f64 = 1e-300;
    let floor = |v: f64| if v.abs() < TINY { TINY } else { v };
    let mut c = 1.0 / TINY;
    let mut d = 1.0 / floor(term(0).1);
    let mut value = d;
    for i in 1..terms {
        let (a, b) = term(i);
        d = 1.0 / floor(b + a * d);
        c = floor(b + a / c);
        let factor = c * d;
        value *= factor;
        if (factor - 1.0).abs() < f64::EPSILON {
            break;
        }
    }
    value
}

/// Terms that a series or fraction with parameters of size `a` needs: it converges over some √a terms.
fn terms_for(a: f64) -> usize {
    // Truncation is intended; a negative or infinite `a` saturates.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let wide = (30.0 * a.abs().sqrt()).min(1e7) as usize;
    500 + wide
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    #[test]
    fn a_root_of_any_size_is_found_to_the_last_bit_in_few_steps() {
        for root in [5e-324, 1e-310, 1e-200, 3.7e-5, 0.1, 1.0, 7e4, 1e300] {
            let steps = Cell::new(0);
            let found = invert(0.0, 0.0, f64::MAX, |x| {
                steps.set(steps.get() + 1);
                if x < root { -1.0 } else { 1.0 }
            });
            assert!(found == root || found == root.next_down(), "{found:e} instead of {root:e}");
            assert!(steps.get() <= 70, "{} steps to {root:e}", steps.get());
        }
    }
}
