//! Elementary effects.

use serde::Serialize;

use crate::design::Step;
use crate::statistics::{Estimated, Moments};

/// The effect of a factor on an output when it alone moves by half of its range, per range: the output's slope across the factor's distribution.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ElementaryEffects {
    /// How many were taken in.
    pub count: u64,
    /// How many were left out because a trial failed.
    pub left_out: u64,
    /// The mean, mu: effects of opposite sign cancel. `None` without effects.
    pub mean: Option<Estimated>,
    /// The mean of the absolute effects, mu*: how much the factor matters. `None` without effects.
    pub mean_absolute: Option<Estimated>,
    /// The standard deviation, sigma: large if the factor acts nonlinearly or together with others. `None` for one effect.
    pub deviation: Option<Estimated>,
}

/// Sums over the trajectories of a [`Screening`](crate::design::Design::Screening) design. Effects of different trajectories are independent: intervals of both
/// means are Student's, that of the deviation is [`Moments::deviation_interval`].
///
/// Sources: M. D. Morris, "Factorial sampling plans for preliminary computational experiments", Technometrics 33 (1991), 161-174; for mu* F. Campolongo et al.,
/// "An effective screening design for sensitivity analysis of large models", Environmental Modelling & Software 22 (2007), 1509-1518.
///
/// ```
/// use calibrig_campaign::design::{Coordinate, Design};
/// use calibrig_campaign::sensitivity::MorrisSums;
///
/// let design = Design::Screening { trajectories: 10, factors: 2, levels: 4 };
/// let mut sums = MorrisSums::new(2);
/// for n in 0..design.trials() {
///     let point = design.point(1, n).expect("a trial");
///     let &[Coordinate::Unit(x), Coordinate::Unit(y)] = &point.at[..] else { panic!("two shares") };
///     sums.add(design.step(1, n), 3.0 * x - y);
/// }
/// assert_eq!(sums.effects(0.95)[0].mean.map(|m| m.value), Some(3.0));
/// assert_eq!(sums.effects(0.95)[1].mean_absolute.map(|m| m.value), Some(1.0));
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct MorrisSums {
    /// The output of the trial before; NaN if it failed.
    before: f64,
    /// Of the effects and of the absolute effects.
    effects: Vec<[Moments; 2]>,
}

impl MorrisSums {
    /// Without trials, for so many factors.
    pub fn new(factors: usize) -> Self {
        Self { before: f64::NAN, effects: vec![[Moments::default(); 2]; factors] }
    }

    /// Takes in the output of the next trial of the design with [what it changed](crate::design::Design::step); an absent or non-finite one is that
    /// of a failed trial, and leaves out the effects before and after it.
    pub fn add(&mut self, step: Option<Step>, output: impl Into<Option<f64>>) {
        let output = output.into().unwrap_or(f64::NAN);
        if let Some((step, [effects, absolute])) =
            step.and_then(|s| Some((s, self.effects.get_mut(s.factor)?)))
        {
            let effect = (output - self.before) / step.change;
            effects.add(effect);
            absolute.add(effect.abs());
        }
        self.before = output;
    }

    /// Factor by factor, with intervals of confidence `level`.
    pub fn effects(&self, level: f64) -> Vec<ElementaryEffects> {
        let of = |[effects, absolute]: &[Moments; 2]| ElementaryEffects {
            count: effects.count(),
            left_out: effects.skipped(),
            mean: effects.mean_interval(level),
            mean_absolute: absolute.mean_interval(level),
            deviation: effects.deviation_interval(level),
        };
        self.effects.iter().map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::design::{Coordinate, Design};
    use crate::statistics::tests::assert_covers;

    fn screen(
        seed: u64,
        trajectories: u64,
        factors: usize,
        output: impl Fn(u64, &[f64]) -> f64,
    ) -> MorrisSums {
        let design = Design::Screening { trajectories, factors, levels: 4 };
        let mut sums = MorrisSums::new(factors);
        for n in 0..design.trials() {
            let unit = |c: &Coordinate| if let Coordinate::Unit(u) = c { *u } else { f64::NAN };
            let at: Vec<f64> = design.point(seed, n).expect("a trial").at.iter().map(unit).collect();
            sums.add(design.step(seed, n), output(n, &at));
        }
        sums
    }

    /// Coordinates are eighths and the coefficients short: exact in binary.
    #[test]
    fn slopes_of_a_linear_function_are_exact() {
        let slopes = [4.0, -2.5, 0.0, 0.125];
        let sums = screen(7, 12, 4, |_, x| 3.0 + x.iter().zip(slopes).map(|(x, s)| x * s).sum::<f64>());
        for (found, slope) in sums.effects(0.95).iter().zip(slopes) {
            assert_eq!((found.count, found.left_out), (12, 0));
            let of = |e: Option<Estimated>| e.map(|e| (e.value, e.interval.map(|i| (i.low, i.high))));
            assert_eq!(of(found.mean), Some((slope, Some((slope, slope)))));
            assert_eq!(of(found.mean_absolute), Some((slope.abs(), Some((slope.abs(), slope.abs())))));
            assert_eq!(of(found.deviation), Some((0.0, None)));
        }
    }

    /// Of x y over the grid 1/8, 3/8, 5/8, 7/8 the effect of x is y, of mean 1/2 and variance 5/64; of (x - 1/2)² it is a start's level, 1/8 or 3/8, times two
    /// minus 1/2: 1/4 of either sign.
    #[test]
    fn effects_that_depend_on_the_place_have_their_closed_form() {
        let product = |_: u64, x: &[f64]| x[0] * x[1];
        assert_covers(1000, 0.95, |seed| {
            let found = screen(seed.into(), 40, 2, product).effects(0.95)[0];
            Some(found.mean?.interval?.contains(0.5))
        });
        // Measured: 93 %.
        assert_covers(1000, 0.93, |seed| {
            let found = screen(seed.into(), 40, 2, product).effects(0.95)[0];
            Some(found.deviation?.interval?.contains((5.0_f64 / 64.0).sqrt()))
        });
        let parabola = screen(5, 30, 1, |_, x| (x[0] - 0.5).powi(2)).effects(0.95)[0];
        let value = |e: Option<Estimated>| e.expect("effects").value;
        assert_eq!(value(parabola.mean_absolute), 0.25);
        assert!(value(parabola.mean).abs() < 0.25 && value(parabola.deviation) > 0.2);
    }

    #[test]
    fn a_failed_trial_leaves_out_the_effects_beside_it() {
        // The middle one of three trials of trajectory 1; the last of trajectory 3.
        let failed = |n: u64, x: &[f64]| if n == 4 || n == 11 { f64::NAN } else { x[0] - x[1] };
        let found = screen(3, 6, 2, failed).effects(0.95);
        assert_eq!(found.iter().map(|f| f.count).sum::<u64>(), 12 - 3);
        assert_eq!(found.iter().map(|f| f.left_out).sum::<u64>(), 3);
        assert!(found.iter().all(|f| f.mean_absolute.expect("effects").value == 1.0));
        assert_eq!(MorrisSums::new(1).effects(0.95)[0].mean, None);
    }
}
