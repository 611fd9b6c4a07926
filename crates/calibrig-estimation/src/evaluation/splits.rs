//! Splits of poses into fitted and held-out ones.

use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

/// Indices of observations, in ascending order.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Split {
    /// Observations that are fitted.
    pub fitted: Vec<usize>,
    /// Observations that are held out.
    pub held_out: Vec<usize>,
}

impl Split {
    fn new(count: usize, mut held_out: Vec<usize>) -> Self {
        held_out.sort_unstable();
        let fitted = (0..count).filter(|i| held_out.binary_search(i).is_err()).collect();
        Self { fitted, held_out }
    }
}

/// `folds` splits of `count` observations: every observation is held out once, and the folds differ in size by one at most. At least two folds and
/// at most `count` are made; none for fewer than two observations.
pub fn k_fold(count: usize, folds: usize, rng: &mut impl Rng) -> Vec<Split> {
    if count < 2 {
        return Vec::new();
    }
    let folds = folds.clamp(2, count);
    let order = shuffled(count, rng);
    (0..folds)
        .map(|fold| Split::new(count, order.iter().copied().skip(fold).step_by(folds).collect()))
        .collect()
}

/// One split per observation: it alone is held out.
pub fn leave_one_out(count: usize) -> Vec<Split> {
    if count < 2 { Vec::new() } else { (0..count).map(|i| Split::new(count, vec![i])).collect() }
}

/// `repeats` independent splits with `fitted` observations each, the rest held out.
pub fn repeated_splits(count: usize, fitted: usize, repeats: usize, rng: &mut impl Rng) -> Vec<Split> {
    let held_out = count.saturating_sub(fitted);
    (0..repeats).map(|_| Split::new(count, shuffled(count, rng).split_off(count - held_out))).collect()
}

/// Shuffles by Fisher and Yates.
fn shuffled(count: usize, rng: &mut impl Rng) -> Vec<usize> {
    let mut order: Vec<_> = (0..count).collect();
    for last in (1..count).rev() {
        order.swap(last, rng.random_range(0..=last));
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn rng(seed: u64) -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(seed)
    }

    #[test]
    fn every_observation_is_held_out_once_and_never_fitted_then() {
        for (count, folds) in [(60, 5), (61, 10), (7, 7), (3, 50), (5, 0)] {
            let splits = k_fold(count, folds, &mut rng(1));
            assert_eq!(splits.len(), folds.clamp(2, count));
            let mut held_out: Vec<_> = splits.iter().flat_map(|s| s.held_out.clone()).collect();
            held_out.sort_unstable();
            assert_eq!(held_out, (0..count).collect::<Vec<_>>());
            for split in &splits {
                let mut all = [split.fitted.clone(), split.held_out.clone()].concat();
                all.sort_unstable();
                assert_eq!(all, (0..count).collect::<Vec<_>>());
                let size = count / splits.len();
                assert!((size..=size + 1).contains(&split.held_out.len()));
            }
        }
        assert!(k_fold(1, 5, &mut rng(1)).is_empty() && leave_one_out(1).is_empty());
        assert_eq!(leave_one_out(3)[1], Split { fitted: vec![0, 2], held_out: vec![1] });
    }

    #[test]
    fn a_seed_decides_the_split() {
        assert_eq!(k_fold(60, 5, &mut rng(1)), k_fold(60, 5, &mut rng(1)));
        assert_ne!(k_fold(60, 5, &mut rng(1)), k_fold(60, 5, &mut rng(2)));
        let splits = repeated_splits(1000, 200, 20, &mut rng(3));
        assert!(splits.iter().all(|s| (s.fitted.len(), s.held_out.len()) == (200, 800)));
        assert_ne!(splits[0], splits[1]);
        assert!(repeated_splits(5, 9, 1, &mut rng(3))[0].held_out.is_empty());
    }

    /// Each of the six orders of three is equally frequent: chi-square with five degrees of freedom, 99.9 % point 20.515.
    #[test]
    fn orders_are_equally_likely() {
        let mut rng = rng(4);
        let mut counts = std::collections::BTreeMap::new();
        for _ in 0..6000 {
            *counts.entry(shuffled(3, &mut rng)).or_insert(0) += 1;
        }
        let chi2: f64 = counts.values().map(|n| (f64::from(*n) - 1000.0).powi(2) / 1000.0).sum();
        assert!(counts.len() == 6 && chi2 < 20.515, "{chi2}");
    }
}
