//! Tables of Denavit-Hartenberg rows made from a chain, as text that `robot_from_dh` reads.

use std::fmt::Write as _;

use nalgebra::{Unit, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::text::{line, roll_pitch_yaw};
use calibrig_model::geometry::{Transform, rotation_x, rotation_z, translation};
use calibrig_model::{CraigLink, JointKind, KinematicModel};

/// Axes that enclose less count as parallel, rad: their common normal would be too far away for the numbers.
const PARALLEL: f64 = 1e-9;

/// Poses at which a table is compared with the chain that it is made of.
const POSES: usize = 200;

/// A table of the standard convention, by the lines in space that the axes are.
#[derive(Debug, Clone, PartialEq)]
pub struct StandardTable {
    /// The text, with the frames at both ends in its comments.
    pub text: String,
    /// Its rows, `Rz(theta) Tz(d) Tx(a) Rx(alpha)`.
    pub rows: Vec<StandardRow>,
    /// From the base to the frame from which the first row starts.
    pub base_from_first: Transform,
    /// From the frame of the last row to the flange.
    pub last_from_flange: Transform,
    /// Largest distance from the chain at the flange and at a metre from it, m, over poses within the limits.
    pub difference: f64,
    /// Distance of the farthest common normal along an axis, m.
    pub farthest: f64,
}

/// A row of a standard table; the joint variable is added to theta or d.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StandardRow {
    /// rad
    pub theta: f64,
    /// m
    pub d: f64,
    /// m
    pub a: f64,
    /// rad
    pub alpha: f64,
}

impl StandardRow {
    /// `previous_from_this` at a joint variable, rad or m.
    pub fn transform(&self, kind: JointKind, q: f64) -> Transform {
        let (turn, slide) = match kind {
            JointKind::Revolute => (q, 0.0),
            JointKind::Prismatic => (0.0, q),
        };
        rotation_z(self.theta + turn)
            * translation(0.0, 0.0, self.d + slide)
            * translation(self.a, 0.0, 0.0)
            * rotation_x(self.alpha)
    }
}

/// The rows of a chain, Craig's with Hayati's beta, as a table; `remarks` stand at its head, and the frames at both ends in its comments.
pub fn craig_table(chain: &KinematicModel, remarks: &[String]) -> String {
    let mut text = String::new();
    head(&mut text, remarks, [&chain.base_from_first, &chain.last_from_flange]);
    line!(text, "name,type,a_m,alpha_rad,beta_rad,d_m,theta_rad");
    for link in &chain.links {
        let CraigLink { a, alpha, beta, d, theta, .. } = link;
        line!(text, "{},{},{a:?},{alpha:?},{beta:?},{d:?},{theta:?}", cell(&link.name), kind(link.kind));
    }
    text
}

/// The same motions in rows of the standard convention: each row goes along the common normal of two neighbouring axes. They equal those of the chain
/// to rounding, which grows with the distance of the common normals of nearly parallel axes: [`StandardTable::difference`].
pub fn standard_table(chain: &KinematicModel, remarks: &[String]) -> StandardTable {
    let mut axes = chain.links.iter().scan(chain.base_from_first, |at, link| {
        *at *= link.fixed_part();
        Some(*at)
    });
    let first = axes.next().unwrap_or_else(Transform::identity);
    let (mut frame, mut last_axis) = (first, first);
    let mut rows = Vec::new();
    for axis in axes {
        let row = between(&(frame.inverse() * axis));
        frame *= row.transform(JointKind::Revolute, 0.0);
        rows.push(row);
        last_axis = axis;
    }
    let last_from_flange = frame.inverse() * last_axis * chain.last_from_flange;
    rows.push(StandardRow { theta: 0.0, d: 0.0, a: 0.0, alpha: 0.0 });
    rows.truncate(chain.links.len());
    let mut table = StandardTable {
        text: String::new(),
        farthest: rows.iter().map(|row| row.d.abs()).fold(0.0, f64::max),
        rows,
        base_from_first: first,
        last_from_flange,
        difference: 0.0,
    };
    table.difference = difference(chain, &table);
    let mut said = remarks.to_vec();
    said.push(format!(
        "Its motions agree with the chain's within {:.1e} m at the flange and at a metre from it; the farthest common normal \
         is {:.3} m away.",
        table.difference, table.farthest
    ));
    let mut text = String::new();
    head(&mut text, &said, [&table.base_from_first, &table.last_from_flange]);
    line!(text, "name,type,theta_rad,d_m,a_m,alpha_rad");
    for (link, row) in chain.links.iter().zip(&table.rows) {
        let StandardRow { theta, d, a, alpha } = row;
        line!(text, "{},{},{theta:?},{d:?},{a:?},{alpha:?}", cell(&link.name), kind(link.kind));
    }
    table.text = text;
    table
}

/// The row that goes from the z axis to the line of another frame's z axis.
fn between(next: &Transform) -> StandardRow {
    let direction = Unit::new_normalize(next.rotation * Vector3::z());
    let (u, point) = (direction.into_inner(), next.translation.vector);
    let across = u.x.hypot(u.y);
    // Parallel: any common normal will do, the one at the other frame's origin needs no length beyond.
    let (theta, d) = if across < PARALLEL {
        (if point.x.hypot(point.y) > 0.0 { point.y.atan2(point.x) } else { 0.0 }, point.z)
    } else {
        // Along z × u, where the line is nearest to the z axis.
        let along = (u.z * point.z - point.dot(&u)) / (across * across);
        (u.x.atan2(-u.y), (point + u * along).z)
    };
    let in_row = rotation_z(-theta).rotation * u;
    let a = (rotation_z(-theta).rotation * point).x;
    let alpha = if across < PARALLEL { 0_f64.atan2(u.z) } else { (0.0 - in_row.y).atan2(in_row.z) };
    StandardRow { theta: theta + 0.0, d: d + 0.0, a: a + 0.0, alpha: alpha + 0.0 }
}

fn difference(chain: &KinematicModel, table: &StandardTable) -> f64 {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut worst: f64 = 0.0;
    for _ in 0..POSES {
        let (mut craig, mut standard) = (chain.base_from_first, table.base_from_first);
        for (link, row) in chain.links.iter().zip(&table.rows) {
            let [low, high] = link.limits.map(|limit| limit.clamp(-10.0, 10.0));
            let q = if low < high { random.random_range(low..high) } else { low };
            craig *= link.transform(q);
            standard *= row.transform(link.kind, q);
        }
        let apart = (craig * chain.last_from_flange).inverse() * standard * table.last_from_flange;
        for point in [Vector3::zeros(), Vector3::x(), Vector3::y(), Vector3::z()] {
            let off = (apart.rotation * point + apart.translation.vector - point).norm();
            worst = if off > worst || off.is_nan() { off } else { worst };
        }
    }
    worst
}

fn head(text: &mut String, remarks: &[String], ends: [&Transform; 2]) {
    for remark in remarks {
        line!(text, "# {}", remark.replace(['\n', '\r'], " "));
    }
    for (name, frame) in ["base to the first row", "last row to the flange"].iter().zip(ends) {
        let place = frame.translation.vector;
        let [roll, pitch, yaw] = roll_pitch_yaw(&frame.rotation);
        line!(
            text,
            "# {name}: x_m = {:?}, y_m = {:?}, z_m = {:?}, roll_rad = {:?}, pitch_rad = {:?}, yaw_rad = {:?}",
            place.x,
            place.y,
            place.z,
            roll,
            pitch,
            yaw
        );
    }
}

fn kind(kind: JointKind) -> &'static str {
    match kind {
        JointKind::Revolute => "revolute",
        JointKind::Prismatic => "prismatic",
    }
}

/// A name as the cell of a table.
fn cell(name: &str) -> String {
    let plain: String = name.chars().map(|c| if c.is_control() || c == '"' { ' ' } else { c }).collect();
    if plain.contains(',') { format!("\"{plain}\"") } else { plain }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::convert::{Convention, robot_from_dh};
    use crate::input::Source;
    use calibrig_model::random::{StreamSource as Stream, stream};

    /// Chains of any axes: crossing, nearly parallel as an identified robot has them, exactly parallel, turned round.
    #[test]
    fn a_standard_table_moves_as_the_chain() {
        let mut random = stream(11, 0, Stream::AsBuilt);
        for trial in 0..60 {
            let links = (0..6).map(|index| {
                let mut within = |size: f64| random.random_range(-size..size);
                let (alpha, beta) = match (trial + index) % 4 {
                    0 => (within(3.0), 0.0),
                    1 => (within(1e-3), within(1e-3)),
                    2 => (0.0, 0.0),
                    _ => (std::f64::consts::FRAC_PI_2, within(1e-4)),
                };
                let new = if index == 2 { CraigLink::prismatic } else { CraigLink::revolute };
                new(format!("j{index}"))
                    .row(within(1.0), alpha, within(1.0), within(3.0))
                    .with_beta(beta)
                    .limits(-1.0, 1.0)
            });
            let mut chain = KinematicModel::new(links.collect()).expect("a chain");
            chain.base_from_first = translation(0.1, -0.2, 0.3) * rotation_x(0.4);
            chain.last_from_flange = translation(0.3, 0.2, 0.1) * rotation_x(1.4);
            let table = standard_table(&chain, &[]);
            // A common normal a kilometre out costs three digits.
            assert!(table.difference < 1e-14 * (100.0 + 10.0 * table.farthest), "{table:?}");
        }
    }

    #[test]
    fn tables_are_read_back_to_the_same_rows() {
        let links = vec![
            CraigLink::revolute("waist").row(0.0, 0.1, 0.4, 0.3).limits(-2.0, 2.0),
            CraigLink::prismatic("slide, long").row(0.2, 1.5, 0.1, 0.2).with_beta(1e-3).limits(0.0, 1.0),
            CraigLink::revolute("wrist").row(0.3, -1.2, 0.0, 0.1).limits(-2.0, 2.0),
        ];
        let chain = KinematicModel::new(links).expect("a chain");
        let remarks = ["told first".to_owned()];
        let craig = Source::new("dh_craig.csv", craig_table(&chain, &remarks));
        let read = robot_from_dh(&craig, Convention::Craig, None).expect("a table");
        for (read, own) in read.robot.model.kinematics.links.iter().zip(&chain.links) {
            assert_eq!((&read.name, read.kind), (&own.name, own.kind));
            for (read, own) in
                [(read.a, own.a), (read.alpha, own.alpha), (read.beta, own.beta), (read.d, own.d)]
            {
                assert!((read - own).abs() < 1e-15, "{read} {own}");
            }
        }
        let table = standard_table(&chain, &remarks);
        let standard = Source::new("dh_standard.csv", table.text.clone());
        let read =
            robot_from_dh(&standard, Convention::Standard, None).expect("a table").robot.model.kinematics;
        let q = [0.3, 0.6, -0.7];
        let moved =
            read.links.iter().zip(q).fold(table.base_from_first, |at, (link, q)| at * link.transform(q));
        let read = moved * read.last_from_flange * table.last_from_flange;
        let own =
            chain.links.iter().zip(q).fold(chain.base_from_first, |at, (link, q)| at * link.transform(q));
        assert!((read.to_homogeneous() - (own * chain.last_from_flange).to_homogeneous()).norm() < 1e-13);
    }
}
