//! Losses that limit the influence of a gross error in one observation on the estimate.
//!
//! They apply to blocks of three whitened coordinates by the block's norm, so that the estimate does not depend on the axes of a position.
//! Source: R. A. Maronna, "Robust M-estimators of multivariate location and scatter" (1976), section 2, and R. A. Maronna,
//! R. D. Martin, V. J. Yohai, M. Salibián-Barrera, "Robust Statistics" (2nd ed. 2019), sections 2.3 and 4.4.

/// Cost of a block of norm v: `s² ρ(u²)` with u = v / s and s the scale. Every loss is `v²` for small u; rows below the blocks always cost
/// their square.
///
/// Tuning constants k are in units of the scale. The constants of [`huber`](Self::huber), [`cauchy`](Self::cauchy) and [`tukey`](Self::tukey) give
/// 95 % efficiency for normal noise: `a² / b = 0.95` with `a = E[w + (2/3) u² ρ''(u²)]`, `b = E[w² u²] / 3`, `w = ρ'(u²)` and u
/// distributed as chi with three degrees of freedom. (With one degree the same equation gives the usual 1.345, 2.385 and 4.685.)
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Loss {
    /// `u²`: least squares.
    #[default]
    Squared,
    /// `u²` up to k, linear beyond: convex, bounded influence.
    Huber {
        /// Value of u beyond which the loss is linear.
        k: f64,
    },
    /// `k² ln(1 + u²/k²)`: the influence decreases beyond k.
    Cauchy {
        /// Value of u at which the weight is one half.
        k: f64,
    },
    /// `k²/3 (1 - (1 - u²/k²)³)`, constant beyond k: a block there has no influence at all.
    Tukey {
        /// Value of u from which on the weight is zero.
        k: f64,
    },
}

impl Loss {
    /// Huber's loss with 95 % efficiency.
    pub const fn huber() -> Self {
        Self::Huber { k: 1.627_987_920_3 }
    }

    /// Cauchy's loss with 95 % efficiency.
    pub const fn cauchy() -> Self {
        Self::Cauchy { k: 2.665_568_344_6 }
    }

    /// Tukey's biweight with 95 % efficiency.
    pub const fn tukey() -> Self {
        Self::Tukey { k: 5.490_249_208_4 }
    }

    /// ρ(z) at z = u²; NaN where k is not positive.
    pub fn rho(self, z: f64) -> f64 {
        match self {
            Self::Squared => z,
            Self::Huber { k } | Self::Cauchy { k } | Self::Tukey { k } if !(k > 0.0) => f64::NAN,
            Self::Huber { k } if z <= k * k => z,
            Self::Huber { k } => 2.0 * k * z.sqrt() - k * k,
            Self::Cauchy { k } => k * k * (z / (k * k)).ln_1p(),
            Self::Tukey { k } => k * k / 3.0 * (1.0 - (1.0 - z / (k * k)).max(0.0).powi(3)),
        }
    }

    /// The weight ρ'(z), decreasing from one to zero.
    pub fn weight(self, z: f64) -> f64 {
        match self {
            Self::Huber { k } if z > k * k => k / z.sqrt(),
            Self::Squared | Self::Huber { .. } => 1.0,
            Self::Cauchy { k } => 1.0 / (1.0 + z / (k * k)),
            Self::Tukey { k } => (1.0 - z / (k * k)).max(0.0).powi(2),
        }
    }

    /// ρ''(z), which is never positive.
    fn weight_slope(self, z: f64) -> f64 {
        match self {
            Self::Huber { k } if z > k * k => -0.5 * k / (z * z.sqrt()),
            Self::Squared | Self::Huber { .. } => 0.0,
            Self::Cauchy { k } => -1.0 / (k * k * (1.0 + z / (k * k)).powi(2)),
            Self::Tukey { k } => -2.0 / (k * k) * (1.0 - z / (k * k)).max(0.0),
        }
    }

    /// Mean derivative of a block's weighted residual by the residual itself: `w + (2/3) u² ρ''(u²)`.
    pub(super) fn mean_slope(self, z: f64) -> f64 {
        self.weight(z) + 2.0 / 3.0 * z * self.weight_slope(z)
    }
}

/// The scale s with which a [`Loss`] measures residuals.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum LossScale {
    /// From the residuals: their median norm over that of a normal block, repeated until it agrees with the residuals at its own minimum.
    #[default]
    Estimated,
    /// This multiple of the stated standard deviations.
    Fixed(f64),
}

/// Median of chi with three degrees of freedom.
const MEDIAN_NORM: f64 = 1.538_172_254_455_052_2;

/// Standard deviation of one coordinate from the norms of blocks of three: consistent for normal noise, and finite as long as fewer than half of
/// the blocks are in error. It accounts for `fitted` parameters, which make the residuals smaller than the noise.
pub(crate) fn scale_of(norms: &mut [f64], fitted: f64) -> f64 {
    let count = norms.len();
    if count == 0 {
        return f64::NAN;
    }
    let (below, &mut upper, _) = norms.select_nth_unstable_by(count / 2, f64::total_cmp);
    let median = if count % 2 == 1 {
        upper
    } else {
        0.5 * (upper + below.iter().copied().fold(f64::NEG_INFINITY, f64::max))
    };
    median / MEDIAN_NORM * freedom_factor(count, fitted).sqrt()
}

/// Number of coordinates over degrees of freedom; 1 where none are left.
pub(super) fn freedom_factor(blocks: usize, fitted: f64) -> f64 {
    let coordinates = 3.0 * blocks as f64;
    if coordinates > fitted { coordinates / (coordinates - fitted) } else { 1.0 }
}
