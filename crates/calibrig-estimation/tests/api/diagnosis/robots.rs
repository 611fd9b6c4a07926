//! Random robots as D-H tables of either convention: industrial arms with and without a spherical wrist, arms with a lateral offset, seven
//! axes, SCARA, palletizers, gantries, on a rail or not, and chains of no type at all.

use std::f64::consts::{FRAC_PI_2, PI};

use calibrig_model::geometry::{Transform, rotation_x, translation};
use calibrig_model::{CalibrationModel, CraigLink, JointKind};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// One row of a table: a (m), alpha (rad), d (m), theta (rad).
#[derive(Debug, Clone, Copy)]
pub struct Row {
    pub kind: JointKind,
    pub values: [f64; 4],
    pub limits: [f64; 2],
}

/// A table, and whose convention it is of.
#[derive(Debug, Clone)]
pub struct Table {
    pub style: &'static str,
    pub rows: Vec<Row>,
    pub standard: bool,
}

impl Table {
    /// The robot of this table, read in one convention or the other.
    pub fn read(&self, standard: bool) -> CalibrationModel {
        let name = |i: usize| format!("J{}", i + 1);
        let mut behind = (0.0, 0.0);
        let links = self.rows.iter().enumerate().map(|(i, row)| {
            let [mut a, mut alpha, d, theta] = row.values;
            if standard {
                let own = (a, alpha);
                (a, alpha) = behind;
                behind = own;
            }
            let link = match row.kind {
                JointKind::Revolute => CraigLink::revolute(name(i)),
                JointKind::Prismatic => CraigLink::prismatic(name(i)),
            };
            link.row(a, alpha, d, theta).limits(row.limits[0], row.limits[1])
        });
        let mut model = CalibrationModel::new(links.collect()).expect("a robot");
        let last: Transform = translation(behind.0, 0.0, 0.0) * rotation_x(behind.1);
        model.kinematics.last_from_flange = last;
        model
    }

    pub fn kind(&self, joint: usize) -> JointKind {
        self.rows[joint].kind
    }

    pub fn revolute(&self) -> Vec<usize> {
        (0..self.rows.len()).filter(|joint| self.kind(*joint) == JointKind::Revolute).collect()
    }
}

/// a, alpha in quarter turns, d, theta in quarter turns; negative travel for a revolute joint's limits in degrees.
fn revolute(a: f64, quarters: f64, d: f64, theta: f64, low: f64, high: f64) -> Row {
    Row {
        kind: JointKind::Revolute,
        values: [a, quarters * FRAC_PI_2, d, theta * FRAC_PI_2],
        limits: [low.to_radians(), high.to_radians()],
    }
}

fn prismatic(a: f64, quarters: f64, d: f64, theta: f64, low: f64, high: f64) -> Row {
    Row {
        kind: JointKind::Prismatic,
        values: [a, quarters * FRAC_PI_2, d, theta * FRAC_PI_2],
        limits: [low, high],
    }
}

pub fn random_table(rng: &mut ChaCha8Rng) -> Table {
    let size = rng.random_range(0.5..2.2);
    let mut length = |low: f64, high: f64| size * rng.random_range(low..high);
    let (a1, a2, a3, d1, d4, d6, side) = (
        length(0.0, 0.25),
        length(0.3, 0.6),
        length(0.02, 0.15),
        length(0.2, 0.5),
        length(0.3, 0.6),
        length(0.05, 0.15),
        length(0.05, 0.2),
    );
    let choice = rng.random_range(0..11);
    let mut table = match choice {
        // Industrial six axes, Craig: spherical wrist.
        0..=2 => Table {
            style: "six axes",
            standard: false,
            rows: vec![
                revolute(0.0, 0.0, d1, 0.0, -170.0, 170.0),
                revolute(a1, -1.0, 0.0, -1.0, -60.0, 120.0),
                revolute(a2, 0.0, 0.0, 0.0, -120.0, 70.0),
                revolute(a3, -1.0, d4, 0.0, -180.0, 180.0),
                revolute(0.0, 1.0, 0.0, 0.0, -120.0, 120.0),
                revolute(0.0, -1.0, d6, 0.0, -300.0, 300.0),
            ],
        },
        // Three parallel axes and a wrist that is offset, standard.
        3 => Table {
            style: "parallel axes",
            standard: true,
            rows: vec![
                revolute(0.0, 1.0, d1, 0.0, -180.0, 180.0),
                revolute(-a2, 0.0, 0.0, 0.0, -180.0, 0.0),
                revolute(-d4, 0.0, 0.0, 0.0, -150.0, 150.0),
                revolute(0.0, 1.0, side, 0.0, -180.0, 180.0),
                revolute(0.0, -1.0, side, 0.0, -180.0, 180.0),
                revolute(0.0, 0.0, d6, 0.0, -180.0, 180.0),
            ],
        },
        // Seven axes without offsets.
        4 => Table {
            style: "seven axes",
            standard: false,
            rows: vec![
                revolute(0.0, 0.0, d1, 0.0, -170.0, 170.0),
                revolute(0.0, -1.0, 0.0, 0.0, -120.0, 120.0),
                revolute(0.0, 1.0, a2, 0.0, -170.0, 170.0),
                revolute(0.0, 1.0, 0.0, 0.0, -120.0, 120.0),
                revolute(0.0, -1.0, d4, 0.0, -170.0, 170.0),
                revolute(0.0, -1.0, 0.0, 0.0, -120.0, 120.0),
                revolute(0.0, 1.0, d6, 0.0, -175.0, 175.0),
            ],
        },
        5 => Table {
            style: "scara",
            standard: true,
            rows: vec![
                revolute(a2, 0.0, d1, 0.0, -140.0, 140.0),
                revolute(d4, 2.0, 0.0, 0.0, -145.0, 145.0),
                prismatic(0.0, 0.0, 0.0, 0.0, 0.0, 0.3),
                revolute(0.0, 0.0, d6, 0.0, -180.0, 180.0),
            ],
        },
        // Five axes with the wrist about the arm's axis left out.
        6 => Table {
            style: "five axes",
            standard: false,
            rows: vec![
                revolute(0.0, 0.0, d1, 0.0, -170.0, 170.0),
                revolute(a1, -1.0, 0.0, 0.0, -100.0, 60.0),
                revolute(a2, 0.0, 0.0, 0.0, -60.0, 120.0),
                revolute(d4, 0.0, 0.0, 0.0, -110.0, 110.0),
                revolute(a3, -1.0, d6, 0.0, -180.0, 180.0),
            ],
        },
        // A beam on three slides with two turning axes.
        7 => Table {
            style: "gantry",
            standard: false,
            rows: vec![
                prismatic(0.0, 0.0, 0.0, 0.0, 0.0, 2.0),
                prismatic(0.0, 1.0, 0.0, 1.0, -0.7, 0.7),
                prismatic(0.0, 1.0, 0.0, 1.0, 0.0, 0.9),
                revolute(0.0, 0.0, d6, 0.0, -170.0, 170.0),
                revolute(0.0, 1.0, side, 0.0, -110.0, 110.0),
            ],
        },
        _ => any_chain(size, rng),
    };
    if table.rows.len() < 7 && choice != 7 && rng.random_bool(0.2) {
        put_on_a_rail(&mut table);
    }
    for row in &mut table.rows {
        row.values[3] = (row.values[3] + PI).rem_euclid(2.0 * PI) - PI;
    }
    table
}

/// No type: angles of the table are multiples of a quarter turn, and lengths are there or not.
fn any_chain(size: f64, rng: &mut ChaCha8Rng) -> Table {
    let count = rng.random_range(4..=6);
    let mut rows: Vec<Row> = Vec::new();
    let mut parallel = 0;
    for joint in 0..count {
        let mut quarters = f64::from([-1, 0, 1, 1, -1, 2][rng.random_range(0..6)]);
        parallel = if quarters.rem_euclid(2.0) == 0.0 { parallel + 1 } else { 0 };
        if joint == 0 || parallel > 2 {
            quarters = if joint == 0 { 0.0 } else { 1.0 };
            parallel = 0;
        }
        let mut maybe = |low: f64, high: f64, chance: f64| {
            let value = size * rng.random_range(low..high);
            if rng.random_bool(chance) { value } else { 0.0 }
        };
        let (mut a, d) = (maybe(0.1, 0.5, 0.7), maybe(0.05, 0.4, 0.5));
        if joint > 0 && quarters.rem_euclid(2.0) == 0.0 && a == 0.0 {
            a = 0.3 * size;
        }
        let theta = f64::from([0, 0, 1, -1][rng.random_range(0..4)]);
        let wide = rng.random_range(70.0..175.0);
        rows.push(revolute(a, quarters, d, theta, -wide, wide));
    }
    if rng.random_bool(0.3) {
        let at = rng.random_range(1..count);
        let row = rows[at];
        rows[at] = Row { kind: JointKind::Prismatic, limits: [0.1, 0.1 + 0.5 * size], ..row };
    }
    Table { style: "any", standard: false, rows }
}

/// Along x of the base, so that the first axis stays upright.
fn put_on_a_rail(table: &mut Table) {
    table.rows.insert(0, prismatic(0.0, -1.0, 0.0, 0.0, 0.0, 3.0));
    if !table.standard {
        table.rows[1].values[1] += FRAC_PI_2;
    }
    table.style = "on a rail";
}
