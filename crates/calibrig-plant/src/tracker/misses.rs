//! Missing readings: the beam or the operator's trigger is lost.

use rand::{Rng, RngExt};

/// Whether a reading is missing, with this probability (0 to 1). Takes one number from `rng`, whatever the probability is.
pub fn is_missed(fraction: f64, rng: &mut impl Rng) -> bool {
    rng.random::<f64>() < fraction
}

#[cfg(test)]
mod tests {
    use super::*;
    use calibrig_model::random::{StreamSource, stream};

    #[test]
    fn as_many_are_missed_as_stated() {
        let mut rng = stream(1, 0, StreamSource::Misses);
        let missed = (0..20_000).filter(|_| is_missed(0.005, &mut rng)).count();
        // Binomial(20000, 0.005): 100 +- 3.3 * 10.
        assert!((67..=133).contains(&missed), "{missed}");
        assert!(!is_missed(0.0, &mut rng) && is_missed(1.0, &mut rng));
    }
}
