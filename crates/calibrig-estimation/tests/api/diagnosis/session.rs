//! Sessions with what is broken in them. Nothing of the diagnosis is used: a file is what a person would have written.

use std::f64::consts::{FRAC_PI_2, PI};

use calibrig_estimation::kinematics::target_in_base;
use calibrig_model::geometry::Transform;
use calibrig_model::measurement::{MeasurementSet, Reading, SphericalReading};
use calibrig_model::nalgebra::{Matrix3, Point3, Rotation3, Translation3, Unit, Vector3};
use calibrig_model::{CalibrationModel, CraigLink, JointKind, KinematicModel};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::robots::{Table, random_table};

/// What was broken.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    pub kind: &'static str,
    pub joints: Vec<usize>,
    pub rows: Vec<usize>,
}

/// A session as the robot's file and the tracker's file tell it.
pub struct Told {
    pub table: Table,
    pub model: CalibrationModel,
    pub set: MeasurementSet,
    /// The same of the robot as drawn, without noise.
    pub exact: MeasurementSet,
    pub truths: Vec<Truth>,
}

/// Commands and what the tracker read, SI: coordinates, or range, azimuth and elevation.
#[derive(Clone)]
struct File {
    commands: Vec<Vec<f64>>,
    readings: Vec<[f64; 3]>,
}

fn normal(rng: &mut ChaCha8Rng, size: f64) -> f64 {
    let value: f64 = StandardNormal.sample(rng);
    size * value
}

fn direction(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| normal(rng, 1.0)).normalize()
}

/// The robot as it is made: links off by half a millimetre and a milliradian, times `worse`.
fn as_built(model: &CalibrationModel, worse: f64, rng: &mut ChaCha8Rng) -> KinematicModel {
    let mut machine = model.kinematics.clone();
    for link in &mut machine.links {
        let CraigLink { a, alpha, beta, d, theta, .. } = link;
        for v in [a, d] {
            *v += normal(rng, 0.5e-3 * worse);
        }
        for v in [alpha, beta, theta] {
            *v += normal(rng, 1e-3 * worse);
        }
    }
    machine
}

struct Drawn {
    table: Table,
    model: CalibrationModel,
    machine: KinematicModel,
    joints: Vec<Vec<f64>>,
    place: Transform,
    tool: Vector3<f64>,
    other_tool: Vector3<f64>,
    noise: Vec<Vector3<f64>>,
    spherical: bool,
}

impl Drawn {
    fn new(rng: &mut ChaCha8Rng) -> Self {
        let table = random_table(rng);
        let model = table.read(table.standard);
        let worse = [1.0, 1.0, 2.0, 4.0][rng.random_range(0..4)];
        let machine = as_built(&model, worse, rng);
        let poses = rng.random_range(15..=60);
        let share = rng.random_range(0.5..1.0);
        let joints = (0..poses)
            .map(|_| {
                table
                    .rows
                    .iter()
                    .map(|row| {
                        let [low, high] = row.limits;
                        let (middle, half) = (0.5 * (low + high), 0.5 * (high - low) * share);
                        middle + half * rng.random_range(-1.0..1.0)
                    })
                    .collect()
            })
            .collect();
        let turn = Rotation3::from_axis_angle(
            &Unit::new_normalize(direction(rng)),
            if rng.random_bool(0.5) { rng.random_range(-0.05..0.05) } else { rng.random_range(-PI..PI) },
        ) * Rotation3::from_axis_angle(&Vector3::z_axis(), rng.random_range(-PI..PI));
        let away = Vector3::new(rng.random_range(3.0..5.0), 0.0, rng.random_range(-1.0..0.5));
        let place = Transform::from_parts(Translation3::from(away), turn);
        let tool = |rng: &mut ChaCha8Rng| {
            let (around, out) = (rng.random_range(-PI..PI), rng.random_range(0.03..0.2));
            Vector3::new(out * f64::cos(around), out * f64::sin(around), rng.random_range(0.0..0.3))
        };
        let first = tool(rng);
        let other_tool = first + rng.random_range(0.05..0.3) * direction(rng);
        let size = [10e-6, 30e-6, 100e-6][rng.random_range(0..3)];
        let noise = (0..poses).map(|_| Vector3::from_fn(|_, _| normal(rng, size))).collect();
        let spherical = rng.random_bool(0.3);
        Self { table, model, machine, joints, place, tool: first, other_tool, noise, spherical }
    }

    /// What is written, of the machine or of the robot as drawn. `link`: where the target is; `second`: rows with the other one.
    fn file(&self, exact: bool, link: usize, second: &[usize]) -> File {
        let mut chain = if exact { self.model.kinematics.clone() } else { self.machine.clone() };
        if link + 1 < chain.links.len() {
            chain.links.truncate(link + 1);
            chain.last_from_flange = Transform::identity();
        }
        let reading = |(i, joints): (usize, &Vec<f64>)| {
            let tool = if second.contains(&i) { self.other_tool } else { self.tool };
            let point = target_in_base(&chain, &joints[..=link], &tool).expect("a pose");
            let mut seen = (self.place * Point3::from(point)).coords;
            if !exact {
                seen += self.noise[i];
            }
            if self.spherical {
                [seen.norm(), seen.y.atan2(seen.x), seen.z.atan2(seen.x.hypot(seen.y))]
            } else {
                seen.into()
            }
        };
        let readings = self.joints.iter().enumerate().map(reading).collect();
        File { commands: self.joints.clone(), readings }
    }
}

/// What can be broken. Joints from zero.
#[derive(Debug, Clone)]
enum Break {
    Radians,
    Degrees,
    Points(f64),
    Travel(f64),
    Sign(usize),
    Offset(usize, f64),
    Order(usize, usize),
    Coupling(usize, usize, f64),
    Convention,
    Mirror,
    Axes,
    AzimuthSense,
    Angles,
    Zenith,
    Shift(isize),
    Exchange(Vec<(usize, usize)>),
    Targets(Vec<usize>),
    Missed(Vec<usize>, f64),
    Gross(Vec<usize>, f64),
    Tool(usize),
}

impl Break {
    fn draw(drawn: &Drawn, rng: &mut ChaCha8Rng) -> Self {
        let table = &drawn.table;
        let n = table.rows.len();
        let poses = drawn.joints.len();
        let revolute = table.revolute();
        loop {
            let some = |most: usize, rng: &mut ChaCha8Rng| {
                let mut rows: Vec<usize> = Vec::new();
                let count = rng.random_range(1..=most);
                while rows.len() < count {
                    let row = rng.random_range(0..poses);
                    if !rows.contains(&row) {
                        rows.push(row);
                    }
                }
                rows
            };
            let broken = match rng.random_range(0..19) {
                0 => Self::Radians,
                1 => Self::Degrees,
                2 => Self::Points([1e3, 1e-3][rng.random_range(0..2)]),
                3 if revolute.len() < n => Self::Travel([1e3, 1e-3][rng.random_range(0..2)]),
                4 | 5 => Self::Sign(rng.random_range(0..n)),
                6 | 7 => {
                    // What the first axis turns is the tracker's place, what the last one turns the target's, which is not known.
                    let inner: Vec<usize> =
                        revolute.iter().copied().filter(|j| *j > 0 && j + 1 < n).collect();
                    let joint = inner[rng.random_range(0..inner.len())];
                    Self::Offset(joint, [FRAC_PI_2, -FRAC_PI_2, PI][rng.random_range(0..3)])
                }
                8 => {
                    let i = rng.random_range(0..n - 1);
                    let j = rng.random_range(i + 1..n);
                    if table.kind(i) != table.kind(j) {
                        continue;
                    }
                    Self::Order(i, j)
                }
                9 => {
                    let (i, j) = [(1, 2), (3, 4), (4, 5), (3, 5), (2, 3)][rng.random_range(0..5)];
                    if !(revolute.contains(&i) && revolute.contains(&j)) {
                        continue;
                    }
                    Self::Coupling(j, i, [1.0, -1.0][rng.random_range(0..2)])
                }
                10 => Self::Convention,
                11 => match (drawn.spherical, rng.random_bool(0.5)) {
                    (false, true) => Self::Mirror,
                    (false, false) => Self::Axes,
                    (true, true) => Self::AzimuthSense,
                    (true, false) => Self::Angles,
                },
                12 if drawn.spherical => Self::Zenith,
                13 => Self::Shift([1, -1, 2, -2, 3][rng.random_range(0..5)]),
                14 => {
                    let rows = some(4, rng);
                    if rows.len() % 2 == 1 {
                        continue;
                    }
                    Self::Exchange(rows.chunks(2).map(|pair| (pair[0], pair[1])).collect())
                }
                15 => {
                    let share = rng.random_range(0.25..0.5);
                    let rows: Vec<usize> = (0..poses).filter(|_| rng.random_bool(share)).collect();
                    if rows.len() < 4 || 2 * rows.len() >= poses {
                        continue;
                    }
                    Self::Targets(rows)
                }
                16 => {
                    let rows = some(3, rng);
                    Self::Missed(rows, [-9.999, -9999.0, 9999.0, 0.0, 999.999][rng.random_range(0..5)])
                }
                17 => Self::Gross(some(2, rng), 10.0_f64.powf(rng.random_range(-2.3..-0.5))),
                18 => Self::Tool(rng.random_range(n - 3..n - 1)),
                _ => continue,
            };
            return broken;
        }
    }

    fn truth(&self, revolute: &[usize], prismatic: &[usize]) -> Truth {
        let told = |kind, joints: &[usize], rows: &[usize]| Truth {
            kind,
            joints: joints.to_vec(),
            rows: rows.to_vec(),
        };
        match self {
            Self::Radians | Self::Degrees => told("angle_unit", revolute, &[]),
            Self::Points(_) => told("length_unit", &[], &[]),
            Self::Travel(_) => told("length_unit", prismatic, &[]),
            Self::Sign(j) => told("joint_sign", &[*j], &[]),
            Self::Offset(j, _) => told("joint_offset", &[*j], &[]),
            Self::Order(i, j) => told("joint_order", &[*i, *j], &[]),
            Self::Coupling(j, i, _) => told("coupling", &[*i, *j], &[]),
            Self::Convention => told("convention", &[], &[]),
            Self::Mirror => told("mirrored_frame", &[], &[]),
            Self::Axes | Self::Angles => told("axes_exchanged", &[], &[]),
            Self::AzimuthSense => told("azimuth_sense", &[], &[]),
            Self::Zenith => told("zenith_elevation", &[], &[]),
            Self::Shift(_) => told("rows_shifted", &[], &[]),
            Self::Exchange(pairs) => {
                told("rows_exchanged", &[], &pairs.iter().flat_map(|(a, b)| [*a, *b]).collect::<Vec<_>>())
            }
            Self::Targets(rows) => told("mixed_targets", &[], rows),
            Self::Missed(rows, _) => told("missed_shot_code", &[], rows),
            Self::Gross(rows, _) => told("gross_error", &[], rows),
            Self::Tool(j) => told("tool_link", &[*j], &[]),
        }
    }

    fn apply(&self, file: &mut File, table: &Table, spherical: bool, rng: &mut ChaCha8Rng) {
        let each =
            |file: &mut File, change: &dyn Fn(&mut Vec<f64>)| file.commands.iter_mut().for_each(change);
        let scale = |file: &mut File, kind: JointKind, factor: f64| {
            each(file, &|c| {
                (0..c.len()).filter(|j| table.kind(*j) == kind).for_each(|j| c[j] *= factor);
            });
        };
        match self {
            Self::Radians => scale(file, JointKind::Revolute, 1f64.to_radians()),
            Self::Degrees => scale(file, JointKind::Revolute, 1f64.to_degrees()),
            Self::Travel(factor) => scale(file, JointKind::Prismatic, *factor),
            Self::Points(factor) => file.readings.iter_mut().for_each(|r| {
                let last = if spherical { 1 } else { 3 };
                r[..last].iter_mut().for_each(|v| *v *= factor);
            }),
            Self::Sign(j) => each(file, &|c| c[*j] = -c[*j]),
            Self::Offset(j, by) => each(file, &|c| c[*j] += by),
            Self::Order(i, j) => each(file, &|c| c.swap(*i, *j)),
            Self::Coupling(j, i, share) => each(file, &|c| c[*j] += share * c[*i]),
            Self::Mirror => file.readings.iter_mut().for_each(|r| r[1] = -r[1]),
            Self::Axes => file.readings.iter_mut().for_each(|r| r.swap(0, 1)),
            Self::AzimuthSense => file.readings.iter_mut().for_each(|r| r[1] = -r[1]),
            Self::Angles => file.readings.iter_mut().for_each(|r| r.swap(1, 2)),
            Self::Zenith => file.readings.iter_mut().for_each(|r| r[2] = FRAC_PI_2 - r[2]),
            Self::Shift(by) => {
                let n = file.readings.len();
                let keep = n - by.unsigned_abs();
                let (first, second) = if *by > 0 { (0, by.unsigned_abs()) } else { (by.unsigned_abs(), 0) };
                file.commands = file.commands[first..first + keep].to_vec();
                file.readings = file.readings[second..second + keep].to_vec();
            }
            Self::Exchange(pairs) => pairs.iter().for_each(|(a, b)| file.readings.swap(*a, *b)),
            Self::Missed(rows, code) => rows.iter().for_each(|row| {
                file.readings[*row] = if spherical && *code == 0.0 { [0.0, 0.5, 0.1] } else { [*code; 3] };
            }),
            Self::Gross(rows, size) => rows.iter().for_each(|row| {
                let by = *size * direction(rng);
                let reading = &mut file.readings[*row];
                if spherical {
                    reading[0] += size;
                } else {
                    (0..3).for_each(|k| reading[k] += by[k]);
                }
            }),
            Self::Convention | Self::Targets(_) | Self::Tool(_) => {}
        }
    }

    /// What is broken before something else can be: targets and tool with the points, single rows last.
    fn order(&self) -> u8 {
        match self {
            Self::Exchange(_) => 1,
            Self::Gross(..) => 0,
            Self::Shift(_) => 4,
            Self::Missed(..) => 5,
            _ => 3,
        }
    }

    fn is_alike(&self, other: &Self) -> bool {
        let group = |b: &Self| match b {
            Self::Radians | Self::Degrees => 1,
            Self::Mirror | Self::Axes | Self::AzimuthSense | Self::Angles | Self::Zenith => 2,
            Self::Points(_) => 3,
            Self::Travel(_) => 4,
            Self::Convention => 5,
            Self::Shift(_) => 6,
            Self::Targets(_) => 7,
            Self::Exchange(_) => 8,
            Self::Missed(..) => 9,
            Self::Gross(..) => 10,
            Self::Tool(_) => 11,
            Self::Sign(j) => 100 + j,
            Self::Offset(j, _) => 200 + j,
            Self::Order(..) => 300,
            Self::Coupling(..) => 400,
        };
        group(self) == group(other)
    }

    /// Rows that both are about are not told apart; what is behind the link that the target is on is not seen at all.
    fn clashes(&self, other: &Self) -> bool {
        let rows = |b: &Self| b.truth(&[], &[]).rows;
        if rows(self).iter().any(|row| rows(other).contains(row)) {
            return true;
        }
        let hides = |a: &Self, b: &Self| match a {
            Self::Tool(j) => b.truth(&[], &[]).joints.iter().any(|joint| joint > j),
            _ => false,
        };
        // A row that a shift loses is not seen either.
        let lost = |a: &Self, b: &Self| matches!(a, Self::Shift(_)) && !rows(b).is_empty();
        hides(self, other) || hides(other, self) || lost(self, other) || lost(other, self)
    }
}

fn set_of(file: &File, spherical: bool) -> MeasurementSet {
    let points = file.commands.iter().zip(&file.readings);
    let mut set = MeasurementSet::of_points(points.clone().map(|(c, r)| (c.clone(), Vector3::from(*r))));
    if spherical {
        for (observation, (_, [range, azimuth, elevation])) in set.observations.iter_mut().zip(points) {
            observation.reading = Reading::Spherical(SphericalReading {
                face: calibrig_model::measurement::Face::Front,
                range: *range,
                azimuth: *azimuth,
                elevation: *elevation,
                covariance: Some(Matrix3::identity() * 1e-10),
            });
        }
    }
    set
}

/// A random session with so many things broken.
pub fn session(count: usize, rng: &mut ChaCha8Rng) -> Told {
    let drawn = Drawn::new(rng);
    let mut breaks: Vec<Break> = Vec::new();
    while breaks.len() < count {
        let another = Break::draw(&drawn, rng);
        if !breaks.iter().any(|b| b.is_alike(&another) || b.clashes(&another)) {
            breaks.push(another);
        }
    }
    breaks.sort_by_key(Break::order);
    let n = drawn.table.rows.len();
    let of_kind = |kind| (0..n).filter(|j| drawn.table.kind(*j) == kind).collect::<Vec<_>>();
    let (revolute, prismatic) = (of_kind(JointKind::Revolute), of_kind(JointKind::Prismatic));
    let (mut link, mut second, mut standard) = (n - 1, Vec::new(), drawn.table.standard);
    for b in &breaks {
        match b {
            Break::Tool(joint) => link = *joint,
            Break::Targets(rows) => second.clone_from(rows),
            Break::Convention => standard = !standard,
            _ => {}
        }
    }
    let mut files = [false, true].map(|exact| drawn.file(exact, link, &second));
    for b in &breaks {
        // The same draws for both.
        let before = rng.clone();
        for file in &mut files {
            *rng = before.clone();
            b.apply(file, &drawn.table, drawn.spherical, rng);
        }
    }
    let model = drawn.table.read(standard);
    let [mut set, mut exact] = files.map(|file| set_of(&file, drawn.spherical));
    if rng.random_bool(0.3) && !breaks.iter().any(|b| matches!(b, Break::Tool(_))) {
        // The tool is stated, within some millimetres.
        let stated = drawn.tool + 3e-3 * direction(rng);
        for set in [&mut set, &mut exact] {
            set.targets[0].in_flange = stated;
        }
    }
    let truths = breaks.iter().map(|b| b.truth(&revolute, &prismatic)).collect();
    Told { table: drawn.table, model, set, exact, truths }
}
