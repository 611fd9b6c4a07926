//! Stiffness and weight of a beam from the shape of its cross section.

use std::f64::consts::PI;

use calibrig_model::Section;

/// An isotropic material.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Material {
    /// Pa
    pub youngs_modulus: f64,
    /// Pa
    pub shear_modulus: f64,
}

/// A hollow shape of uniform wall, outer sizes, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Shape {
    Tube {
        diameter: f64,
        wall: f64,
    },
    Box {
        /// Along the section's second axis.
        width: f64,
        /// Along its third.
        height: f64,
        wall: f64,
    },
}

/// Section properties.
struct Areas {
    /// m²
    area: f64,
    /// About the second and third axis, m⁴.
    second_moment: [f64; 2],
    /// m⁴
    torsion: f64,
    /// Of the area, against shear along the second and third axis.
    shear_coefficient: [f64; 2],
}

impl Material {
    fn poisson(self) -> f64 {
        self.youngs_modulus / (2.0 * self.shear_modulus) - 1.0
    }
}

impl Shape {
    /// The beam's section; `mass_per_length` must be filled in if `density` (kg/m³) is not given.
    pub fn section(self, material: Material, density: f64) -> Section {
        let areas = self.areas(material.poisson());
        let (e, g) = (material.youngs_modulus, material.shear_modulus);
        Section {
            axial: e * areas.area,
            shear: areas.shear_coefficient.map(|kappa| kappa * g * areas.area),
            torsion: g * areas.torsion,
            bending: areas.second_moment.map(|moment| e * moment),
            mass_per_length: density * areas.area,
        }
    }

    fn areas(self, poisson: f64) -> Areas {
        match self {
            Self::Tube { diameter, wall } => tube(diameter, wall, poisson),
            Self::Box { width, height, wall } => hollow_box(width, height, wall, poisson),
        }
    }
}

fn tube(diameter: f64, wall: f64, poisson: f64) -> Areas {
    let inner = diameter - 2.0 * wall;
    let second_moment = PI / 64.0 * (diameter.powi(4) - inner.powi(4));
    // Cowper, J. Appl. Mech. 33 (1966) 335, hollow circle.
    let ratio = (inner / diameter).powi(2);
    let squared = (1.0 + ratio).powi(2);
    let kappa =
        6.0 * (1.0 + poisson) * squared / ((7.0 + 6.0 * poisson) * squared + (20.0 + 12.0 * poisson) * ratio);
    Areas {
        area: PI / 4.0 * (diameter.powi(2) - inner.powi(2)),
        second_moment: [second_moment; 2],
        torsion: 2.0 * second_moment,
        shear_coefficient: [kappa; 2],
    }
}

fn hollow_box(width: f64, height: f64, wall: f64, poisson: f64) -> Areas {
    let [inner_width, inner_height] = [width, height].map(|outer| outer - 2.0 * wall);
    // Between the middles of the walls.
    let [w, h] = [width, height].map(|outer| outer - wall);
    Areas {
        area: width * height - inner_width * inner_height,
        second_moment: [
            (width * height.powi(3) - inner_width * inner_height.powi(3)) / 12.0,
            (height * width.powi(3) - inner_height * inner_width.powi(3)) / 12.0,
        ],
        // Bredt's second formula, 4 A² / (perimeter / wall).
        torsion: 2.0 * wall * (w * h).powi(2) / (w + h),
        shear_coefficient: [box_coefficient(h / w, poisson), box_coefficient(w / h, poisson)],
    }
}

/// Cowper, J. Appl. Mech. 33 (1966) 335, thin-walled box of uniform wall; `ratio` is its size across the shear over that along it.
fn box_coefficient(ratio: f64, poisson: f64) -> f64 {
    let (m, n) = (ratio, ratio);
    let (m2, m3) = (m * m, m * m * m);
    10.0 * (1.0 + poisson) * (1.0 + 3.0 * m).powi(2)
        / ((12.0 + 72.0 * m + 150.0 * m2 + 90.0 * m3)
            + poisson * (11.0 + 66.0 * m + 135.0 * m2 + 90.0 * m3)
            + 10.0 * n * n * ((3.0 + poisson) * m + 3.0 * m2))
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEEL: Material = Material { youngs_modulus: 210e9, shear_modulus: 80.769_230_769_230_77e9 };

    fn close(found: f64, expected: f64, tolerance: f64) {
        assert!((found / expected - 1.0).abs() < tolerance, "{found} instead of {expected}");
    }

    #[test]
    fn a_tube_has_the_tabulated_properties() {
        // EN 10210-2, hollow section 168.3 x 10: A 49.7 cm², I 1564 cm⁴, It 3128 cm⁴, 39.0 kg/m.
        let section = Shape::Tube { diameter: 0.1683, wall: 0.01 }.section(STEEL, 7850.0);
        close(section.axial / 210e9, 49.7e-4, 1e-3);
        close(section.bending[0] / 210e9, 1564e-8, 1e-3);
        close(section.torsion / STEEL.shear_modulus, 3128e-8, 1e-3);
        close(section.mass_per_length, 39.0, 2e-3);
        // Thin and solid limits of Cowper's coefficient at Poisson's ratio 0.3.
        close(tube(1.0, 1e-6, 0.3).shear_coefficient[0], 2.6 / 4.9, 1e-9);
        close(tube(1.0, 0.5, 0.3).shear_coefficient[1], 6.0 * 1.3 / 8.8, 1e-12);
    }

    #[test]
    fn a_box_has_the_integrals_of_its_four_walls() {
        let (width, height, wall) = (0.3, 0.2, 0.01);
        let section = Shape::Box { width, height, wall }.section(STEEL, 7850.0);
        // Sums over a fine grid of the shape itself.
        let cells = 1200_u32;
        let (dy, dz) = (width / f64::from(cells), height / f64::from(cells));
        let (mut area, mut about_y, mut about_z) = (0.0, 0.0, 0.0);
        for i in 0..cells {
            for k in 0..cells {
                let y = (f64::from(i) + 0.5) * dy - width / 2.0;
                let z = (f64::from(k) + 0.5) * dz - height / 2.0;
                if y.abs() > width / 2.0 - wall || z.abs() > height / 2.0 - wall {
                    area += dy * dz;
                    about_y += z * z * dy * dz;
                    about_z += y * y * dy * dz;
                }
            }
        }
        close(section.axial / 210e9, area, 1e-9);
        close(section.bending[0] / 210e9, about_y, 1e-5);
        close(section.bending[1] / 210e9, about_z, 1e-5);
        close(section.mass_per_length, 7850.0 * area, 1e-9);
        assert!(section.bending[1] > section.bending[0], "wide boxes are stiffer about the third axis");
    }

    /// Bredt's formula against a circular tube, whose torsion is known: a square box whose middle line encloses the same area.
    #[test]
    fn torsion_follows_the_enclosed_area_and_the_middle_line() {
        let (size, wall) = (0.25, 1e-5);
        let square = hollow_box(size, size, wall, 0.3).torsion;
        let middle = size - wall;
        close(square, middle.powi(3) * wall, 1e-12);
        // Same enclosed area, shorter perimeter: stiffer by the ratio of the perimeters.
        let radius = middle / PI.sqrt();
        let round = tube(2.0 * radius + wall, wall, 0.3).torsion;
        close(round / square, 4.0 * middle / (2.0 * PI * radius), 1e-6);
    }

    /// For Poisson's ratio 0 Cowper's coefficient is that of the energy of the shear flow, which is integrated here wall by wall.
    #[test]
    fn the_box_coefficient_is_that_of_the_shear_flow() {
        for ratio in [0.2, 0.7, 1.0, 3.0] {
            // Height 1 along the shear, wall 1: webs at y in [-1/2, 1/2], flanges of width `ratio`.
            let steps = 4000;
            let at = |step: i32| (f64::from(step) + 0.5) / f64::from(steps);
            let flanges: f64 = (0..steps).map(|step| (at(step) * ratio / 2.0 * 0.5).powi(2)).sum::<f64>()
                / f64::from(steps)
                * (4.0 * ratio / 2.0);
            let webs: f64 = (0..steps)
                .map(|step| {
                    let y = at(step) / 2.0;
                    (ratio / 2.0 * 0.5 + (0.25 - y * y) / 2.0).powi(2)
                })
                .sum::<f64>()
                / f64::from(steps)
                * 2.0;
            let second_moment = 1.0 / 6.0 + ratio / 2.0;
            let area = 2.0 * (1.0 + ratio);
            close(box_coefficient(ratio, 0.0), second_moment.powi(2) / (area * (flanges + webs)), 1e-6);
        }
    }
}
