//! An angle encoder whose graduated circle is neither round nor centred.

/// Reading of a head that turns about an axis off the centre of an oval circle, in units of the circle's radius.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Encoder {
    /// The circle's centre from the axis.
    pub centre: [f64; 2],
    /// How much longer the circle's radius is along the zero direction, and shorter across it.
    pub oval: f64,
    /// The same along and across the direction half a right angle from zero.
    pub oval_diagonal: f64,
    /// Reading at an angle of zero on a perfect circle, rad.
    pub zero: f64,
}

impl Encoder {
    /// Its reading minus the true angle, rad.
    ///
    /// On a circle that is squeezed by S and shifted by e, a head in the direction u stands over the mark in the direction S u - e.
    pub fn error(&self, angle: f64) -> f64 {
        let (sin, cos) = angle.sin_cos();
        let x = (1.0 + self.oval) * cos + self.oval_diagonal * sin - self.centre[0];
        let y = self.oval_diagonal * cos + (1.0 - self.oval) * sin - self.centre[1];
        let (across, along) = (cos * y - sin * x, cos * x + sin * y);
        // An arctangent of the ratio takes half the time, and is the same if the head is over its own side of the circle.
        self.zero + if along > 0.5 { (across / along).atan() } else { across.atan2(along) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shifted_circle_shows_the_angle_from_its_own_centre() {
        let encoder = Encoder { centre: [0.1, -0.2], ..Encoder::default() };
        for angle in [0.0, 1.0, 3.0, -2.0, 9.0_f64] {
            let from_centre = (angle.sin() + 0.2).atan2(angle.cos() - 0.1);
            let shown = angle + encoder.error(angle);
            assert!(((shown - from_centre).sin()).abs() < 1e-15, "{angle}");
        }
        // Heads on both sides of the axis cancel the shift to first order, and the oval not at all.
        let oval = Encoder { oval: 1e-3, ..Encoder::default() };
        assert!((oval.error(0.7) - oval.error(0.7 + std::f64::consts::PI)).abs() < 1e-12);
    }
}
