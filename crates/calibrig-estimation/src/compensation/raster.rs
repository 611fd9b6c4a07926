//! A spray gun's way over a panel: to and fro, row after row.

use nalgebra::Vector3;
use thiserror::Error;

use crate::inverse::Goal;

/// A panel with four corners, and how it is to be covered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Raster {
    /// In order around the panel, m in the base frame. Rows run from the first to the second; the last row is the edge from the fourth to the third. The
    /// panel's front is where the corners run counterclockwise.
    pub corners: [Vector3<f64>; 4],
    /// Between rows, m; at most, so that the last row is the edge.
    pub pitch: f64,
    /// Between the points of a row, m; at most.
    pub spacing: f64,
    /// Of the tool's point in front of the panel, m.
    pub standoff: f64,
}

/// A panel that cannot be covered.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[non_exhaustive]
pub enum RasterError {
    /// A distance that is not a finite number above zero.
    #[error("{field} is {value} m: expected {expected}")]
    Length {
        /// Which.
        field: &'static str,
        /// As stated, m.
        value: f64,
        /// What it has to be.
        expected: &'static str,
    },
    /// A corner at no finite place.
    #[error("corner {} is at ({}, {}, {}): expected finite numbers", corner + 1, at[0], at[1], at[2])]
    Corner {
        /// Its index.
        corner: usize,
        /// As stated, m.
        at: [f64; 3],
    },
    /// Corners that coincide, lie on one line, or cross.
    #[error(
        "the corners do not form a panel at corner {}: expected four of them in order around it, no three on one line",
        corner + 1
    )]
    NoPanel {
        /// Index of the corner where the panel has no front, or another one than elsewhere.
        corner: usize,
    },
    /// More points than anybody wants.
    #[error("the raster has {points:.0} points: expected at most {most}; choose a wider pitch or spacing")]
    TooMany {
        /// Their number.
        points: f64,
        /// What is allowed.
        most: usize,
    },
}

/// A million points of a path are a gigabyte of results.
const MOST_POINTS: usize = 1_000_000;

impl Raster {
    /// Where the tool goes: its axis against the panel's front, at every point.
    ///
    /// # Errors
    ///
    /// [`RasterError`].
    pub fn goals(&self) -> Result<Vec<Goal>, RasterError> {
        self.check()?;
        let [a, b, c, d] = self.corners;
        let length = (b - a).norm().max((c - d).norm());
        let height = (d - a).norm().max((c - b).norm());
        let (steps, rows) = ((length / self.spacing).ceil().max(1.0), (height / self.pitch).ceil().max(1.0));
        let between = (height / rows / self.spacing).ceil().max(1.0);
        let points = (rows + 1.0) * (steps + 1.0) + rows * (between - 1.0);
        if points > MOST_POINTS as f64 {
            return Err(RasterError::TooMany { points, most: MOST_POINTS });
        }
        let mut goals = Vec::new();
        let counts = |n: f64| (0..).map(f64::from).take_while(move |k| *k <= n);
        for row in counts(rows) {
            let forth = row % 2.0 == 0.0;
            for step in counts(steps) {
                let along = step / steps;
                goals.push(self.goal(if forth { along } else { 1.0 - along }, row / rows));
            }
            if row < rows {
                let side = if forth { 1.0 } else { 0.0 };
                let up =
                    counts(between - 1.0).skip(1).map(|step| self.goal(side, (row + step / between) / rows));
                goals.extend(up);
            }
        }
        Ok(goals)
    }

    fn check(&self) -> Result<(), RasterError> {
        let above = |field, value: f64| {
            let expected = "a finite length above zero";
            if value > 0.0 && value.is_finite() {
                Ok(())
            } else {
                Err(RasterError::Length { field, value, expected })
            }
        };
        above("the pitch", self.pitch)?;
        above("the spacing", self.spacing)?;
        let (field, value) = ("the standoff", self.standoff);
        if !(value >= 0.0 && value.is_finite()) {
            return Err(RasterError::Length { field, value, expected: "a finite length of zero or more" });
        }
        if let Some((corner, at)) =
            self.corners.iter().enumerate().find(|(_, at)| at.iter().any(|v| !v.is_finite()))
        {
            return Err(RasterError::Corner { corner, at: [at.x, at.y, at.z] });
        }
        // Of the whole panel; every corner has to turn the same way, and by more than rounding shows.
        let [a, b, c, d] = self.corners;
        let front = (c - a).cross(&(d - b));
        for corner in 0..4 {
            let [before, at, after] = [3, 0, 1].map(|k| self.corners[(corner + k) % 4]);
            let turn = (at - before).cross(&(after - at));
            let size = (at - before).norm() * (after - at).norm();
            if !(turn.dot(&front) > 1e-9 * size * front.norm()) {
                return Err(RasterError::NoPanel { corner });
            }
        }
        Ok(())
    }

    /// At shares of the way along the rows and across them, by the bilinear surface through the corners.
    fn goal(&self, along: f64, across: f64) -> Goal {
        let [a, b, c, d] = self.corners;
        let (first, last) = (a + (b - a) * along, d + (c - d) * along);
        let row = (b - a) * (1.0 - across) + (c - d) * across;
        let front = row.cross(&(last - first)).normalize();
        let position = first + (last - first) * across + self.standoff * front;
        Goal::Axis { position, direction: -front }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn panel() -> Raster {
        let corners = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]].map(|[x, z]| Vector3::new(x, 0.5, z));
        Raster { corners, pitch: 0.25, spacing: 0.1, standoff: 0.2 }
    }

    #[test]
    fn rows_run_to_and_fro_and_the_gun_looks_at_the_panel() {
        let goals = panel().goals().expect("a panel");
        // Five rows of 21 points, and two points between them.
        assert_eq!(goals.len(), 5 * 21 + 4 * 2);
        let position = |k: usize| goals[k].position();
        assert!((position(0) - Vector3::new(0.0, 0.3, 0.0)).norm() < 1e-12, "{:?}", position(0));
        assert!((position(20) - Vector3::new(2.0, 0.3, 0.0)).norm() < 1e-12);
        assert!((position(23) - Vector3::new(2.0, 0.3, 0.25)).norm() < 1e-12);
        assert!((position(24) - Vector3::new(1.9, 0.3, 0.25)).norm() < 1e-12);
        for pair in goals.windows(2) {
            let step = (pair[1].position() - pair[0].position()).norm();
            assert!(step > 0.05 && step < 0.1 + 1e-12, "{step}");
        }
        for goal in &goals {
            let Goal::Axis { direction, .. } = goal else { panic!("{goal:?}") };
            assert!((direction - Vector3::y()).norm() < 1e-12, "{direction}");
        }
    }

    #[test]
    fn what_makes_no_panel_is_named() {
        let told = |change: &dyn Fn(&mut Raster)| {
            let mut raster = panel();
            change(&mut raster);
            raster.goals().expect_err("no panel").to_string()
        };
        assert!(told(&|r| r.pitch = 0.0).starts_with("the pitch is 0 m"));
        assert!(told(&|r| r.spacing = f64::NAN).starts_with("the spacing is NaN m"));
        assert!(told(&|r| r.standoff = -0.1).starts_with("the standoff is -0.1 m"));
        assert!(told(&|r| r.corners[2].x = f64::NAN).starts_with("corner 3 is at (NaN, 0.5, 1)"));
        // Crossed, on one line, and the same twice.
        assert!(told(&|r| r.corners.swap(2, 3)).contains("do not form a panel"));
        assert!(
            told(&|r| r.corners[2] = Vector3::new(1.0, 0.5, 0.5)).contains("do not form a panel at corner 3")
        );
        assert!(told(&|r| r.corners[1] = r.corners[0]).contains("do not form a panel"));
        assert!(told(&|r| r.spacing = 1e-7).contains("choose a wider pitch"));
    }
}
