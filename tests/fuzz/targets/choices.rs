//! What the bytes of an input choose. Where they end, the first choice is taken: a short input is a small case.

use arbitrary::Unstructured;

/// Numbers at which things break: the least and the largest that files may hold, what lies beyond them, and what is no number.
pub const EXTREMES: [f64; 22] = [
    0.0,
    -0.0,
    1.0,
    -1.0,
    1e-15,
    -1e-15,
    1e15,
    -1e15,
    9.9e-16,
    1.1e15,
    5e-324,
    2.3e-308,
    1e-300,
    1e300,
    f64::MAX,
    f64::MIN,
    f64::INFINITY,
    f64::NEG_INFINITY,
    f64::NAN,
    std::f64::consts::FRAC_PI_2,
    std::f64::consts::PI,
    4_294_967_296.0,
];

pub struct Choices<'a>(Unstructured<'a>);

impl<'a> Choices<'a> {
    pub fn new(data: &'a [u8]) -> Self {
        Self(Unstructured::new(data))
    }

    /// A number from 0 on, below `count`.
    pub fn below(&mut self, count: usize) -> usize {
        self.0.int_in_range(0..=count.saturating_sub(1)).unwrap_or(0)
    }

    pub fn one_in(&mut self, count: usize) -> bool {
        self.below(count) == 1
    }

    pub fn pick<'t, T>(&mut self, from: &'t [T]) -> &'t T {
        &from[self.below(from.len())]
    }

    /// One of the extremes, any bits, or mostly a number as files have them.
    pub fn number(&mut self) -> f64 {
        match self.below(8) {
            0 | 1 => *self.pick(&EXTREMES),
            2 => self.0.arbitrary().unwrap_or(0.0),
            _ => self.moderate(),
        }
    }

    /// A number of few digits between 1e-7 and 1e6.
    pub fn moderate(&mut self) -> f64 {
        let digits = f64::from(self.0.arbitrary::<i16>().unwrap_or(0)) / 100.0;
        digits * [1.0, 1e-1, 1e1, 1e-2, 1e-3, 1e3, 1e-5, 1e4][self.below(8)]
    }

    /// From 0 to 1.
    pub fn fraction(&mut self) -> f64 {
        f64::from(self.0.arbitrary::<u16>().unwrap_or(0)) / f64::from(u16::MAX)
    }

    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub fn rest(self) -> &'a [u8] {
        self.0.take_rest()
    }
}
