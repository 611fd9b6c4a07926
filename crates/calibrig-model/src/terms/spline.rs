//! A smooth error of an actuator without a known formula: a cubic spline over the commands, held by a prior on its curvature.
//!
//! On knots at equal distances, a natural cubic spline with the values f has ∫ f″² = fᵀ K f, K = Q R⁻¹ Qᵀ (P. J. Green, B. W. Silverman,
//! "Nonparametric Regression and Generalized Linear Models" (1994), section 2.1). The prior of a smoothing spline, exp(-fᵀ K f / (2 τ²)), is that of
//! an integrated Wiener process (G. Wahba, J. R. Statist. Soc. B 40 (1978) 364). It does not constrain the constant and linear parts: they are left
//! out, being the joint's offset and the term `ratio`. The rest is written in the eigenvectors of K over the roots of their eigenvalues, so that the
//! amplitudes are independent and equally large (T. Speed, Statist. Sci. 6 (1991) 42). The same holds on a closed ring of knots, where only the
//! constant is left out.

use std::f64::consts::TAU;
use std::sync::OnceLock;

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use super::{TermFamily, TermPlace, half_travel, is_linear, joint_variable, middle_command};
use crate::{CalibrationModel, JointKind, PoseQuery};

/// Seven amplitudes per actuator, the smoothest first.
pub(super) struct SplineTerms;

/// Knots from one end of the span to the other.
const KNOTS: usize = 9;
/// Knots of a full turn.
const RING: usize = 8;
/// Shapes of either.
const SHAPES: usize = 7;
/// A joint that can turn all the way round and is measured over this much of a turn has errors that repeat with the
/// turn.
const ROUND: f64 = 0.75 * TAU;

/// A cubic spline on knots at a distance of one: its values at them, and its second derivatives there.
#[derive(Debug, Clone)]
struct Shape {
    values: Vec<f64>,
    bends: Vec<f64>,
}

impl TermFamily for SplineTerms {
    fn key(&self) -> &'static str {
        "spline"
    }

    fn about(&self) -> &'static str {
        "a smooth error of every actuator over its commands"
    }

    fn terms(&self, model: &CalibrationModel) -> Vec<(usize, usize, bool)> {
        let joints = 0..model.kinematics.joint_count();
        joints
            .flat_map(|joint| (0..SHAPES).map(move |index| (joint, index, is_linear(model, joint))))
            .collect()
    }

    fn place(&self, joint: usize, _: usize) -> TermPlace {
        TermPlace::Actuator(joint)
    }

    fn basis(&self, model: &CalibrationModel, joint: usize, index: usize, input: &PoseQuery<'_>) -> f64 {
        let (Some(command), Some(link)) = (input.command.get(joint), model.kinematics.links.get(joint))
        else {
            return 0.0;
        };
        let half = half_travel(link);
        let limits = || {
            let middle = middle_command(model, joint);
            [middle - half, middle + half]
        };
        let [low, high] = model.spans.get(joint).copied().unwrap_or_else(limits);
        let span = high - low;
        let is_revolute = link.kind == JointKind::Revolute;
        if is_revolute && 2.0 * half >= TAU && span >= ROUND {
            return on_ring().get(index).map_or(0.0, |shape| shape.at_turn((command - low) / TAU));
        }
        let whole = if is_revolute { TAU } else { 1.0 };
        // An integrated Wiener process deviates by the span to the power of 3/2.
        let size = (span / whole).powf(1.5);
        if !(size > 0.0 && size.is_finite()) {
            return 0.0;
        }
        natural().get(index).map_or(0.0, |shape| size * shape.at((command - low) / span))
    }

    fn prior_sigma(&self, linear: bool) -> f64 {
        // 0.1 mm in a span of a metre, 0.5 mrad (1.7 arcmin) in a full turn; by the span to the power of 3/2: 0.18 mrad in half a turn.
        if linear { 1e-4 } else { 5e-4 }
    }

    fn suffix(&self, joint: usize, index: usize, linear: bool) -> String {
        format!("{}_{}", joint_variable(joint, linear), index + 1)
    }

    fn parse(&self, suffix: &str) -> Option<(usize, usize, bool)> {
        super::parse_counted(suffix, SHAPES)
    }

    fn is_on_request(&self) -> bool {
        true
    }

    fn is_of_spans(&self) -> bool {
        true
    }

    fn is_of_unknown_size(&self) -> bool {
        true
    }
}

impl Shape {
    /// At a place from 0 to 1 between the first and the last knot; beyond them it continues straight.
    fn at(&self, place: f64) -> f64 {
        let last = self.values.len() - 1;
        let x = place * last as f64;
        let (inside, beyond) = (x.clamp(0.0, last as f64), x - x.clamp(0.0, last as f64));
        let piece = piece_at(inside, last);
        let t = inside - piece as f64;
        let value = self.piece(piece, piece + 1, t);
        if beyond == 0.0 { value } else { value + beyond * self.slope(piece, piece + 1, t) }
    }

    /// At a place counted in turns of the ring.
    fn at_turn(&self, turns: f64) -> f64 {
        let count = self.values.len();
        let x = turns.rem_euclid(1.0) * count as f64;
        let piece = piece_at(x, count);
        self.piece(piece, (piece + 1) % count, x - piece as f64)
    }

    /// Between two knots, at `t` from 0 to 1.
    fn piece(&self, from: usize, to: usize, t: f64) -> f64 {
        let s = 1.0 - t;
        let bend = (1.0 + s) * self.bends[from] + (1.0 + t) * self.bends[to];
        s * self.values[from] + t * self.values[to] - s * t * bend / 6.0
    }

    /// The derivative of [`piece`](Self::piece).
    fn slope(&self, from: usize, to: usize, t: f64) -> f64 {
        let s = 1.0 - t;
        let [from_bend, to_bend] = [self.bends[from], self.bends[to]];
        let straight = self.values[to] - self.values[from];
        straight - (3.0 * s * s - 1.0) / 6.0 * from_bend + (3.0 * t * t - 1.0) / 6.0 * to_bend
    }
}

/// The piece of so many on which a place from zero on is.
fn piece_at(place: f64, pieces: usize) -> usize {
    (1..pieces).rev().find(|knot| *knot as f64 <= place).unwrap_or(0)
}

/// Shapes on knots from end to end, with a prior of one for the root mean square over the knots.
fn natural() -> &'static [Shape] {
    static KNOWN: OnceLock<Vec<Shape>> = OnceLock::new();
    KNOWN.get_or_init(|| {
        let inner = KNOTS - 2;
        let q: DMatrix<f64> = DMatrix::from_fn(KNOTS, inner, |i, j| match i.abs_diff(j + 1) {
            0 => -2.0,
            1 => 1.0,
            _ => 0.0,
        });
        let r: DMatrix<f64> = DMatrix::from_fn(inner, inner, |i, j| match i.abs_diff(j) {
            0 => 2.0 / 3.0,
            1 => 1.0 / 6.0,
            _ => 0.0,
        });
        // Of a matrix with a strong diagonal: it has an inverse.
        let to_bends = r.try_inverse().unwrap_or_default() * q.transpose();
        let SymmetricEigen { eigenvalues, eigenvectors } = SymmetricEigen::new(&q * &to_bends);
        let mut order: Vec<usize> = (0..KNOTS).collect();
        order.sort_by(|a, b| eigenvalues[*a].total_cmp(&eigenvalues[*b]));
        // The first two are the constant and the line.
        let shape = |place: &usize| {
            let vector: DVector<f64> = eigenvectors.column(*place).into_owned();
            let values = &vector * (eigenvalues[*place].sqrt().recip() * vector[0].signum());
            let inner = &to_bends * &values;
            let bends = [&[0.0], inner.as_slice(), &[0.0]].concat();
            Shape { values: values.as_slice().to_vec(), bends }
        };
        scaled(order.iter().skip(2).map(shape).collect())
    })
}

/// The same on a ring: sines and cosines at the knots are its eigenvectors.
fn on_ring() -> &'static [Shape] {
    static KNOWN: OnceLock<Vec<Shape>> = OnceLock::new();
    KNOWN.get_or_init(|| {
        let waves = (1..=RING / 2).flat_map(|wave| [(wave, f64::sin as fn(f64) -> f64), (wave, f64::cos)]);
        // Twice per two knots, a sine is zero at each.
        let waves = waves.filter(|(wave, function)| 2 * wave < RING || function(0.0) > 0.5);
        let shape = |(wave, function): (usize, fn(f64) -> f64)| {
            let step = TAU * wave as f64 / RING as f64;
            let bend = -(2.0 - 2.0 * step.cos()) / ((2.0 + step.cos()) / 3.0);
            let vector: Vec<f64> = (0..RING).map(|knot| function(step * knot as f64)).collect();
            let norm = vector.iter().map(|v| v * v).sum::<f64>().sqrt();
            // Of K = Q R⁻¹ Qᵀ: that of R⁻¹ Qᵀ times that of Q.
            let eigenvalue = -bend * (2.0 - 2.0 * step.cos());
            let values: Vec<f64> = vector.iter().map(|v| v / (norm * eigenvalue.sqrt())).collect();
            let bends = values.iter().map(|v| bend * v).collect();
            Shape { values, bends }
        };
        scaled(waves.map(shape).collect())
    })
}

/// All by one factor, so that their squares at the knots have a mean sum of one.
fn scaled(mut shapes: Vec<Shape>) -> Vec<Shape> {
    let knots = shapes.first().map_or(1, |shape| shape.values.len());
    let sum: f64 = shapes.iter().flat_map(|shape| &shape.values).map(|v| v * v).sum();
    let factor = (knots as f64 / sum).sqrt();
    for number in shapes.iter_mut().flat_map(|shape| shape.values.iter_mut().chain(&mut shape.bends)) {
        *number *= factor;
    }
    shapes
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sum of shapes, from 0 to 1 over the knots or the turn.
    fn sum(shapes: &[Shape], amplitudes: &[f64], at: impl Fn(&Shape) -> f64) -> f64 {
        shapes.iter().zip(amplitudes).map(|(shape, amplitude)| amplitude * at(shape)).sum()
    }

    const AMPLITUDES: [f64; SHAPES] = [0.7, -1.2, 0.4, 2.0, -0.3, 1.1, -0.9];

    #[test]
    fn the_curvature_is_the_sum_of_squares_of_the_amplitudes() {
        for (shapes, pieces, turns) in [(natural(), KNOTS - 1, false), (on_ring(), RING, true)] {
            assert_eq!(shapes.len(), SHAPES);
            // Second differences against the penalty: pieces are cubic, f'' is linear, and the trapezia are refined until they tell.
            let value = |x: f64, amplitudes: &[f64]| {
                sum(shapes, amplitudes, |shape| if turns { shape.at_turn(x) } else { shape.at(x) })
            };
            let energy = |amplitudes: &[f64]| -> f64 {
                let steps = 200 * pieces;
                let h = 1.0 / steps as f64;
                let bend = |i: usize| {
                    let x = i as f64 * h;
                    (value(x - h, amplitudes) - 2.0 * value(x, amplitudes) + value(x + h, amplitudes))
                        / (h * h)
                };
                (1..steps).map(|i| bend(i).powi(2) * h).sum()
            };
            let mut unit = [0.0; SHAPES];
            unit[0] = 1.0;
            let one = energy(&unit);
            for k in 1..SHAPES {
                let mut other = [0.0; SHAPES];
                other[k] = 1.0;
                assert!((energy(&other) / one - 1.0).abs() < 0.02, "{k}: {} {one}", energy(&other));
            }
            let squares: f64 = AMPLITUDES.iter().map(|a| a * a).sum();
            assert!((energy(&AMPLITUDES) / (one * squares) - 1.0).abs() < 0.02);
        }
    }

    #[test]
    fn no_constant_and_no_line_are_left_and_the_prior_has_size_one() {
        for (shapes, knots) in [(natural(), KNOTS), (on_ring(), RING)] {
            let mut squares = 0.0;
            for shape in shapes {
                let mean: f64 = shape.values.iter().sum();
                let slope: f64 = shape.values.iter().enumerate().map(|(i, v)| i as f64 * v).sum();
                assert!(mean.abs() < 1e-12);
                assert!(knots == RING || slope.abs() < 1e-12);
                squares += shape.values.iter().map(|v| v * v).sum::<f64>() / knots as f64;
            }
            assert!((squares - 1.0).abs() < 1e-12);
            let size = |shape: &Shape| shape.values.iter().map(|v| v * v).sum::<f64>();
            assert!(shapes.windows(2).all(|pair| size(&pair[1]) <= size(&pair[0]) * (1.0 + 1e-9)));
        }
    }

    #[test]
    fn pieces_meet_with_slope_and_bend_and_go_straight_on() {
        let value = |x: f64| sum(natural(), &AMPLITUDES, |shape| shape.at(x));
        let turned = |x: f64| sum(on_ring(), &AMPLITUDES, |shape| shape.at_turn(x));
        let h = 1e-4;
        // Of bends of a hundred; what their slope makes over so short a way is below.
        let bend = |f: &dyn Fn(f64) -> f64, x: f64| (f(x - h) - 2.0 * f(x) + f(x + h)) / (h * h);
        for knot in 1..KNOTS - 1 {
            let x = knot as f64 / (KNOTS - 1) as f64;
            assert!((bend(&value, x - 2.0 * h) - bend(&value, x + 2.0 * h)).abs() < 3.0, "{knot}");
        }
        for knot in 0..RING {
            let x = knot as f64 / RING as f64;
            assert!((bend(&turned, x - 2.0 * h) - bend(&turned, x + 2.0 * h)).abs() < 3.0, "{knot}");
            assert!((turned(x + 0.01) - turned(x - 2.99)).abs() < 1e-12);
        }
        for (end, out) in [(0.0, -0.1), (1.0, 0.1)] {
            let slope = (value(end + out) - value(end)) / out;
            let inside = (value(end) - value(end - 1e-6 * out.signum())) / (1e-6 * out.signum());
            assert!((slope - inside).abs() < 1e-3 * slope.abs(), "{slope} {inside}");
            assert!((value(end + 2.0 * out) - value(end) - 2.0 * out * slope).abs() < 1e-12);
        }
    }
}
