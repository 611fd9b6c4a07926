//! Criteria for a set of poses, each a number to be minimised.

use serde::{Deserialize, Serialize};

/// Criterion that a choice of poses minimises. M is the information of priors and poses about the scaled parameters, C = M⁻¹ their covariance, σ₁ to
/// `σ_p` the singular values of the whitened rows, largest first (the roots of the eigenvalues of M).
///
/// D, A, E, G and I: A. C. Atkinson, A. N. Donev, R. D. Tobias, Optimum Experimental Designs, with SAS (2007), chapter 10. The
/// observability indices are numbered as in Y. Sun, J. M. Hollerbach, "Observability index selection for robot calibration", ICRA 2008, 831.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Criterion {
    /// `-ln det(M) / p`: the volume of the parameters' confidence region. It does not depend on their scaling: `exp` of the difference between two
    /// designs is the D-efficiency of one relative to the other.
    D,
    /// `tr C`: the sum of the variances of the scaled parameters.
    A,
    /// `1 / λ_min(M)`: the largest variance of a combination of scaled parameters of length one.
    E,
    /// Largest predicted variance of the target's position over the region (summed over three axes), m².
    G,
    /// Mean of this variance over the region, m². It does not depend on the scaling.
    I,
    /// `1 / O1`, `O1 = (σ₁ … σ_p)^(1/p) / √n`, with n poses (J. H. Borm, C. H. Menq, Int. J. Robotics Research 10 (1991) 51). It chooses the same
    /// poses as D.
    O1,
    /// `1 / O2`, `O2 = σ_p / σ₁`: the condition number (M. R. Driels, U. S. Pathre, J. Robotic Systems 7 (1990) 197).
    O2,
    /// `1 / O3`, `O3 = σ_p` (A. Nahvi, J. M. Hollerbach, V. Hayward, ICRA 1994, 407). It chooses the same poses as E.
    O3,
    /// `1 / O4`, `O4 = σ_p² / σ₁`: the noise amplification index (A. Nahvi, J. M. Hollerbach, ICRA 1996, 647).
    O4,
    /// `1 / O5`, `O5 = 1 / (1/σ₁ + … + 1/σ_p)` (Sun and Hollerbach 2008).
    O5,
}

impl Criterion {
    /// All criteria.
    pub const ALL: [Self; 10] =
        [Self::D, Self::A, Self::E, Self::G, Self::I, Self::O1, Self::O2, Self::O3, Self::O4, Self::O5];

    /// The key in files and on the command line.
    pub fn key(self) -> &'static str {
        match self {
            Self::D => "D",
            Self::A => "A",
            Self::E => "E",
            Self::G => "G",
            Self::I => "I",
            Self::O1 => "O1",
            Self::O2 => "O2",
            Self::O3 => "O3",
            Self::O4 => "O4",
            Self::O5 => "O5",
        }
    }

    /// The criterion of a [`key`](Self::key), in upper or lower case.
    pub fn parse(key: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|criterion| criterion.key().eq_ignore_ascii_case(key))
    }

    /// Whether it depends on the poses where the robot will work.
    pub fn is_of_region(self) -> bool {
        matches!(self, Self::G | Self::I)
    }

    /// Whether its value, and the chosen poses, depend on the scaling of the parameters.
    pub fn depends_on_scale(self) -> bool {
        !matches!(self, Self::D | Self::G | Self::I | Self::O1)
    }

    /// Criteria with a closed form that choose similar poses; empty for those that have a closed form themselves.
    pub(super) fn like(self) -> &'static [Self] {
        match self {
            Self::D | Self::A | Self::I | Self::O1 => &[],
            Self::G => &[Self::D, Self::I],
            Self::E | Self::O2 | Self::O3 | Self::O4 | Self::O5 => &[Self::D, Self::A],
        }
    }

    /// Its value from the eigenvalues of M (in any order), for criteria that are functions of these; infinite for a singular M.
    pub(super) fn of_eigenvalues(self, eigenvalues: &[f64], poses: usize) -> f64 {
        let (least, most) =
            eigenvalues.iter().fold((f64::INFINITY, 0.0_f64), |(a, b), v| (a.min(*v), b.max(*v)));
        if !(least > 0.0) {
            return f64::INFINITY;
        }
        let p = eigenvalues.len() as f64;
        let mean_log = eigenvalues.iter().map(|v| v.ln()).sum::<f64>() / p;
        match self {
            Self::D => -mean_log,
            Self::A => eigenvalues.iter().map(|v| v.recip()).sum(),
            Self::E => least.recip(),
            Self::O1 => (poses as f64).sqrt() * (-0.5 * mean_log).exp(),
            Self::O2 => (most / least).sqrt(),
            Self::O3 => least.sqrt().recip(),
            Self::O4 => most.sqrt() / least,
            Self::O5 => eigenvalues.iter().map(|v| v.sqrt().recip()).sum(),
            Self::G | Self::I => f64::NAN,
        }
    }
}

/// The observability indices of some poses, each the larger the better, for the scaled rows including priors.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Observability {
    /// Borm and Menq 1991.
    pub o1: f64,
    /// Driels and Pathre 1990.
    pub o2: f64,
    /// Nahvi, Hollerbach and Hayward 1994.
    pub o3: f64,
    /// Nahvi and Hollerbach 1996.
    pub o4: f64,
    /// Sun and Hollerbach 2008.
    pub o5: f64,
}

impl Observability {
    /// The indices from the `singular_values` of the rows of this many `poses`; all zero if a singular value is.
    pub fn of(singular_values: &[f64], poses: usize) -> Self {
        let eigenvalues: Vec<f64> = singular_values.iter().map(|s| s * s).collect();
        let index = |criterion: Criterion| criterion.of_eigenvalues(&eigenvalues, poses).recip();
        Self {
            o1: index(Criterion::O1),
            o2: index(Criterion::O2),
            o3: index(Criterion::O3),
            o4: index(Criterion::O4),
            o5: index(Criterion::O5),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand, from the formulas of the publications.
    #[test]
    fn the_indices_of_three_singular_values() {
        let o = Observability::of(&[4.0, 2.0, 1.0], 9);
        for (found, expected) in
            [(o.o1, 2.0 / 3.0), (o.o2, 0.25), (o.o3, 1.0), (o.o4, 0.25), (o.o5, 1.0 / 1.75)]
        {
            assert!((found - expected).abs() < 1e-15, "{found} {expected}");
        }
        let singular = Observability::of(&[4.0, 0.0], 9);
        assert_eq!([singular.o1, singular.o2, singular.o3, singular.o4, singular.o5], [0.0; 5]);
    }

    #[test]
    fn keys_are_read_back() {
        for criterion in Criterion::ALL {
            assert_eq!(Criterion::parse(criterion.key()), Some(criterion));
            assert_eq!(Criterion::parse(&criterion.key().to_lowercase()), Some(criterion));
        }
        assert_eq!(Criterion::parse("O6"), None);
    }
}
