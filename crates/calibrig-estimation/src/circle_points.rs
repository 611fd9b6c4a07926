//! Where sweeps of single axes put the tracker: circle point analysis.
//!
//! While one joint moves alone, a target runs along a line or round a circle whose direction and centre are those of the joint's axis. Two axes of the robot, seen so,
//! place the tracker without any nest, as well as it is known where they are in the base. How far the angle between them and their distance are off the nominal
//! ones has no part in it. What they leave open is taken from the nominal target, and stated to be as uncertain as that: the height along the waist of a robot on a rail.
//!
//! The points of a sweep are fitted with the joint's variable q, which makes the fit linear: `c + a cos q + b sin q` of a turning joint, whose axis is `a x b` through c, and
//! `c + t q` of a sliding one.

use std::collections::BTreeSet;

use nalgebra::{
    Cholesky, DMatrix, DVector, Matrix3, Matrix3x6, Matrix6, Rotation3, UnitVector3, Vector3, Vector6,
};
use thiserror::Error;

use crate::kinematics::{nominal_joints, target};
use calibrig_model::geometry::{Transform, rotation_vector};
use calibrig_model::measurement::{MeasurementSet, Observation, Station, Target};
use calibrig_model::{CalibrationModel, JointKind, KinematicModel};

/// What a station saw of two axes.
#[derive(Debug, Clone, PartialEq)]
pub struct SweptStation {
    /// Name of the station.
    pub station: String,
    /// The axis that the base is turned after, and the one that is next.
    pub axes: [SweptAxis; 2],
    /// Angle between the two, its standard deviation, and that of the nominal robot, rad.
    pub angle: [f64; 3],
    /// Distance between the two where both turn, its standard deviation, and that of the nominal robot, m.
    pub distance: Option<[f64; 3]>,
    /// Where the tracker stands in the base if the axes are where the nominal robot has them, and its standard deviation by the scatter of the sweeps, m.
    pub stand: [Vector3<f64>; 2],
    /// Standard deviation of its turn about the axes of the base, by the same, rad.
    pub turn: Vector3<f64>,
    /// Whether a direction of the place, or all, rest on the nominal target.
    pub open: usize,
}

/// What the sweep of an axis shows.
#[derive(Debug, Clone, PartialEq)]
pub struct SweptAxis {
    /// Index of the joint.
    pub joint: usize,
    /// Its name.
    pub name: String,
    /// Whether it turns or slides.
    pub kind: JointKind,
    /// Readings that the axis was fitted to.
    pub readings: usize,
    /// Poses of readings that were left out as gross errors.
    pub gross: Vec<u32>,
    /// From the least to the greatest value of the joint, rad or m.
    pub span: f64,
    /// Radius of the circle, m; `None` of a line.
    pub radius: Option<f64>,
    /// Root mean square distance of the points from line or circle, per coordinate, m.
    pub rms: f64,
    /// Weighted sum of squares per degree of freedom, where the readings state their noise.
    pub chi2_per_dof: Option<f64>,
}

/// Sweeps that do not place a station.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum SweepError {
    /// Fewer than two axes were moved alone.
    #[error(
        "station {station}: only {found} axes of its sweeps moved alone through {MIN_READINGS} places or more, expected two: \
         add readings while one joint moves and all others rest, or place the tracker otherwise (by nests, or free)"
    )]
    TooFew {
        /// Name of the station.
        station: String,
        /// Names of the axes.
        found: String,
    },
    /// Two axes that tell no direction.
    #[error(
        "station {station}: the swept axes ({axes}) do not place it, because they are parallel: sweep one that is not, or add \
         a turning axis"
    )]
    Parallel {
        /// Name of the station.
        station: String,
        /// Names of the axes.
        axes: String,
    },
    /// Readings with more or fewer commands than the robot has joints.
    #[error(
        "station {station}: a reading of its sweeps does not have {joints} commands, one per joint: check that it is of this \
         robot"
    )]
    AnotherRobot {
        /// Name of the station.
        station: String,
        /// Joints of the robot.
        joints: usize,
    },
    /// A sweep that shows no axis.
    #[error(
        "station {station}: the sweep of {axis} does not determine the axis: {why}; sweep it farther, or with the target \
         farther from it"
    )]
    NoAxis {
        /// Name of the station.
        station: String,
        /// Name of the axis.
        axis: String,
        /// What is wrong.
        why: &'static str,
    },
}

/// Readings of a sweep at different values of its joint from which on it shows an axis.
pub const MIN_READINGS: usize = 5;
/// A joint that moves by less in a sweep rests, rad or m.
const RESTS: f64 = 2e-5;
/// Sine of the angle between axes below which they are parallel.
const PARALLEL: f64 = 1e-2;
/// Standard deviation of what is taken from the nominal target, m: more than robots are off by, and than they sag.
const NOMINAL: f64 = 0.1;
/// A reading that is farther from line or circle than so many root mean squares of the others is a gross error.
const GROSS: f64 = 6.0;

/// Where sweeps of two axes put a station.
#[derive(Debug, Clone, PartialEq)]
pub struct SweptPlace {
    /// `tracker_from_base`, if the axes are where the nominal robot has them.
    pub tracker_from_base: Transform,
    /// Covariance of the displacement `xi` in `tracker_from_base · exp(xi)`, from the scatter of the sweeps: m², m rad, rad².
    pub covariance: Matrix6<f64>,
    /// Index of the last joint that the place of the two axes in the base depends on.
    pub last_joint: usize,
    /// Readings of all sweeps but gross errors, as indices into [`Station::sweeps`], and the covariance of each: the stated one, or the scatter of its sweep where that is larger, m².
    pub readings: Vec<(usize, Matrix3<f64>)>,
}

/// An axis of the robot in its sweep.
#[derive(Debug, Clone, PartialEq)]
struct AxisOfRobot {
    joint: usize,
    /// Joint variables of the sweep, with the mean of its own.
    joints: Vec<f64>,
    /// Of the target, m.
    in_flange: Vector3<f64>,
}

impl AxisOfRobot {
    fn of(&self, kinematics: &KinematicModel) -> Option<Axis> {
        let up_to = kinematics.links.iter().zip(&self.joints).take(self.joint + 1);
        let frame = up_to.fold(kinematics.base_from_first, |frame, (link, q)| frame * link.transform(*q));
        let direction = UnitVector3::new_normalize(frame.rotation * Vector3::z());
        let seen = target(kinematics, &self.joints, &self.in_flange);
        let turns = kinematics.links.get(self.joint)?.kind == JointKind::Revolute;
        let beside = seen - frame.translation.vector;
        let along = direction.scale(beside.dot(&direction));
        let centre = if turns { frame.translation.vector + along } else { seen };
        Some(Axis { turns, direction, centre, radius: (beside - along).norm() })
    }
}

/// Places a station of a set by its [sweeps](Station::sweeps): by the first two axes of the robot that do.
///
/// # Errors
///
/// [`SweepError`].
pub fn place_by_sweeps(
    model: &CalibrationModel,
    set: &MeasurementSet,
    station: usize,
) -> Result<(SweptPlace, SweptStation), SweepError> {
    let Some(station) = set.stations.get(station) else {
        return Err(SweepError::TooFew {
            station: (station + 1).to_string(),
            found: "no axis was found".to_owned(),
        });
    };
    let mut joints = vec![0.0; model.kinematics.joint_count()];
    if station.sweeps.iter().any(|reading| reading.command.len() != joints.len()) {
        return Err(SweepError::AnotherRobot { station: station.name.clone(), joints: joints.len() });
    }
    let of_command = |reading: &Observation| {
        // A four-bar that does not close is told where the pose is fitted.
        let _ = nominal_joints(model, &reading.command, &mut joints);
        joints.clone()
    };
    let seen: Vec<Vec<f64>> = station.sweeps.iter().map(of_command).collect();
    let runs = runs_of(&station.sweeps, &seen);
    let names = || {
        let names: Vec<_> = runs.iter().map(|run| model.kinematics.links[run.joint].name.as_str()).collect();
        if names.is_empty() { "no axis was found".to_owned() } else { names.join(", ") }
    };
    if runs.len() < 2 {
        return Err(SweepError::TooFew { station: station.name.clone(), found: names() });
    }
    let view = View { model, targets: &set.targets, seen: &seen, station };
    let placed = pairs(runs.len()).find_map(|(a, b)| view.analyse(&runs[a], &runs[b]).transpose());
    let (mut place, swept) =
        placed.ok_or_else(|| SweepError::Parallel { station: station.name.clone(), axes: names() })??;
    place.readings = runs.iter().flat_map(|run| view.weighed(run)).collect();
    Ok((place, swept))
}

/// All pairs of `n`, the first ones first.
fn pairs(n: usize) -> impl Iterator<Item = (usize, usize)> {
    (1..n).flat_map(|b| (0..b).map(move |a| (a, b)))
}

/// Readings of one station and target behind each other between which one joint moves.
#[derive(Debug, Clone)]
struct Run {
    joint: usize,
    /// Indices of its readings.
    readings: Vec<usize>,
}

/// The longest sweep of every joint, in their order.
fn runs_of(sweeps: &[Observation], seen: &[Vec<f64>]) -> Vec<Run> {
    let mut longest: Vec<Run> = Vec::new();
    let targets: BTreeSet<usize> = sweeps.iter().map(|reading| reading.target).collect();
    for target in targets {
        let own: Vec<usize> = (0..seen.len()).filter(|row| sweeps[*row].target == target).collect();
        let mut first = 0;
        while first < own.len() {
            let (mut last, mut moves) = (first + 1, None);
            while let Some(row) = own.get(last) {
                let differs = |joint: &usize| (seen[own[first]][*joint] - seen[*row][*joint]).abs() > RESTS;
                let mut moved = (0..seen[*row].len()).filter(differs);
                match (moved.next(), moved.next(), moves) {
                    (None, ..) => {}
                    (Some(joint), None, None) => moves = Some(joint),
                    (Some(joint), None, Some(own)) if joint == own => {}
                    _ => break,
                }
                last += 1;
            }
            let Some(joint) = moves.filter(|_| last > first + 2) else {
                first += 1;
                continue;
            };
            let run = Run { joint, readings: own[first..last].to_vec() };
            // The last pose of a sweep can be the first of the next.
            first = last - 1;
            let places = run.places(seen);
            if places < MIN_READINGS {
                continue;
            }
            match longest.iter_mut().find(|other| other.joint == joint) {
                Some(other) if other.places(seen) < places => *other = run,
                Some(_) => {}
                None => longest.push(run),
            }
        }
    }
    longest.sort_by_key(|run| run.joint);
    longest
}

impl Run {
    /// Number of values that its joint had.
    fn places(&self, seen: &[Vec<f64>]) -> usize {
        let mut values: Vec<f64> = self.readings.iter().map(|row| seen[*row][self.joint]).collect();
        values.sort_by(f64::total_cmp);
        1 + values.windows(2).filter(|pair| pair[1] - pair[0] > RESTS).count()
    }
}

/// A point of a sweep: the joint's variable, where the target was seen (m), and what is stated of its noise.
type Point = (f64, Vector3<f64>, Option<Matrix3<f64>>);

/// A line or circle in the order of [`Fitted::values`]: c, then a and b, or t.
#[derive(Debug, Clone)]
struct Fitted {
    kind: JointKind,
    values: DVector<f64>,
    covariance: DMatrix<f64>,
    /// Of every point, in standard deviations, and in m.
    whitened: Vec<f64>,
    rms: f64,
    chi2_per_dof: Option<f64>,
    /// What the stated covariance, or one of 1 m² a coordinate, is to be multiplied with.
    scale: f64,
}

impl Fitted {
    /// `None` where the points do not determine it.
    fn new(kind: JointKind, points: &[Point]) -> Option<Self> {
        let n = points.len();
        let unknowns = if kind == JointKind::Revolute { 9 } else { 6 };
        let middle = points.iter().map(|(q, ..)| q).sum::<f64>() / n as f64;
        let mut design = DMatrix::zeros(3 * n, unknowns);
        let mut seen = DVector::zeros(3 * n);
        let stated = points.iter().all(|(_, _, covariance)| covariance.is_some());
        for (row, (q, place, covariance)) in (0..3 * n).step_by(3).zip(points) {
            let weight = match covariance.filter(|_| stated) {
                Some(covariance) => {
                    Cholesky::new(covariance)?.l().solve_lower_triangular(&Matrix3::identity())?
                }
                None => Matrix3::identity(),
            };
            for (block, factor) in (0..unknowns).step_by(3).zip(basis(kind, q - middle)) {
                design.fixed_view_mut::<3, 3>(row, block).copy_from(&(weight * factor));
            }
            seen.fixed_rows_mut::<3>(row).copy_from(&(weight * place));
        }
        let normal = Cholesky::new(design.tr_mul(&design))?;
        let values = normal.solve(&design.tr_mul(&seen));
        let left = &seen - &design * &values;
        let dof = (3 * n).checked_sub(unknowns).filter(|dof| *dof > 0)? as f64;
        let scatter = left.norm_squared() / dof;
        let scale = if stated { scatter.max(1.0) } else { scatter };
        let squares =
            points.iter().map(|(q, place, _)| (place - at(kind, &values, q - middle)).norm_squared());
        let rms = (squares.sum::<f64>() / dof).sqrt();
        let whitened = left.as_slice().chunks(3).map(|own| own.iter().map(|v| v * v).sum::<f64>().sqrt());
        let whitened = whitened.collect();
        let chi2_per_dof = stated.then_some(scatter);
        Some(Self { kind, covariance: normal.inverse() * scale, values, whitened, rms, chi2_per_dof, scale })
    }

    /// The point that is much farther off than the others.
    fn gross(&self) -> Option<usize> {
        let (worst, size) =
            self.whitened.iter().copied().enumerate().max_by(|(_, a), (_, b)| a.total_cmp(b))?;
        let others = self.whitened.iter().map(|v| v * v).sum::<f64>() - size * size;
        let typical = (others / (self.whitened.len() as f64 - 1.0)).sqrt();
        (size > GROSS * typical).then_some(worst)
    }

    fn axis(&self) -> Option<Axis> {
        Axis::new(self.kind, &self.values)
    }
}

fn basis(kind: JointKind, q: f64) -> Vec<f64> {
    match kind {
        JointKind::Revolute => vec![1.0, q.cos(), q.sin()],
        JointKind::Prismatic => vec![1.0, q],
    }
}

fn at(kind: JointKind, values: &DVector<f64>, q: f64) -> Vector3<f64> {
    let blocks = values.as_slice().chunks(3).map(Vector3::from_column_slice);
    blocks.zip(basis(kind, q)).map(|(block, factor)| block * factor).sum()
}

/// The axis of a joint.
#[derive(Debug, Clone)]
struct Axis {
    turns: bool,
    /// In which a positive motion goes, or about which it turns.
    direction: UnitVector3<f64>,
    /// Centre of the circle, on the axis; of a line a point on it, which is not where its joint is.
    centre: Vector3<f64>,
    radius: f64,
}

impl Axis {
    fn new(kind: JointKind, values: &DVector<f64>) -> Option<Self> {
        let block = |place: usize| Vector3::from_column_slice(&values.as_slice()[place..place + 3]);
        let turns = kind == JointKind::Revolute;
        let along = if turns { block(3).cross(&block(6)) } else { block(3) };
        let radius = if turns { along.norm().sqrt() } else { 0.0 };
        let direction = UnitVector3::try_new(along, 1e-9)?;
        Some(Self { turns, direction, centre: block(0), radius })
    }
}

/// The frame that two axes span: its z is the first, its x at right angles to both. `None` where they do not determine it.
fn frame_of(first: &Axis, second: &Axis, parallel: bool) -> Option<Transform> {
    let z = first.direction;
    let beside = second.centre - first.centre;
    let x = if parallel {
        (first.turns && second.turns).then(|| beside - z.scale(beside.dot(&z)))?
    } else {
        z.cross(&second.direction)
    };
    let x = UnitVector3::try_new(x, 1e-6)?;
    let y = z.cross(&x);
    let origin = match (first.turns, second.turns) {
        // The foot of the common perpendicular.
        (true, true) if !parallel => {
            let cosine = z.dot(&second.direction);
            let along =
                beside.dot(&(z.into_inner() - second.direction.scale(cosine))) / (1.0 - cosine * cosine);
            first.centre + z.scale(along)
        }
        (false, true) => second.centre,
        _ => first.centre,
    };
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[*x, y, *z]));
    Some(Transform::from_parts(origin.into(), rotation))
}

/// Directions in which the origin of the frame is where the nominal target has it.
fn open_directions(first: &Axis, second: &Axis, parallel: bool) -> Vec<Vector3<f64>> {
    match (first.turns, second.turns) {
        (true, true) if !parallel => Vec::new(),
        (true, _) => vec![*first.direction],
        (false, true) => vec![*second.direction],
        (false, false) => vec![Vector3::x(), Vector3::y(), Vector3::z()],
    }
}

fn angle_between(first: &Axis, second: &Axis) -> f64 {
    first.direction.cross(&second.direction).norm().atan2(first.direction.dot(&second.direction))
}

fn distance_between(first: &Axis, second: &Axis, parallel: bool) -> f64 {
    let beside = second.centre - first.centre;
    let across = first.direction.cross(&second.direction);
    if parallel { first.direction.cross(&beside).norm() } else { (beside.dot(&across) / across.norm()).abs() }
}

/// Where the tracker stands in the base with its standard deviation, m, and that of its turn, rad. `covariance` is of the base as the tracker sees it.
fn stand_of(tracker_from_base: &Transform, covariance: &Matrix6<f64>) -> ([Vector3<f64>; 2], Vector3<f64>) {
    let stand = tracker_from_base.inverse().translation.vector;
    let mut change = Matrix3x6::identity();
    change.fixed_columns_mut::<3>(3).copy_from(&-stand.cross_matrix());
    let of_stand = change * covariance * change.transpose();
    let sigma = |variance: f64| variance.max(0.0).sqrt();
    let turn = covariance.diagonal().fixed_rows::<3>(3).map(sigma);
    ([stand, of_stand.diagonal().map(sigma)], turn)
}

/// A station with its readings.
struct View<'a> {
    model: &'a CalibrationModel,
    targets: &'a [Target],
    /// Joint variables of every reading of the sweeps.
    seen: &'a [Vec<f64>],
    station: &'a Station,
}

impl View<'_> {
    /// `None` where the two axes do not place the station.
    fn analyse(&self, first: &Run, second: &Run) -> Result<Option<(SweptPlace, SweptStation)>, SweepError> {
        let fitted = [self.fitted(first)?, self.fitted(second)?];
        let of_robot = fitted.each_ref().map(|sweep| self.of_robot(sweep));
        let [Some(n1), Some(n2)] = of_robot.each_ref().map(|axis| axis.of(&self.model.kinematics)) else {
            return Ok(None);
        };
        let parallel = n1.direction.cross(&n2.direction).norm() < PARALLEL;
        let Some(from_base) = frame_of(&n1, &n2, parallel).map(|frame| frame.inverse()) else {
            return Ok(None);
        };
        // What values of both, one behind the other, make of place, angle and distance.
        let split = fitted[0].seen.values.len();
        let kinds = fitted.each_ref().map(|sweep| sweep.seen.kind);
        let axes = |values: &DVector<f64>| {
            let (a, b) =
                (values.rows(0, split).into_owned(), values.rows(split, values.len() - split).into_owned());
            Some((Axis::new(kinds[0], &a)?, Axis::new(kinds[1], &b)?))
        };
        let place = |values: &DVector<f64>| {
            let (a, b) = axes(values)?;
            Some(frame_of(&a, &b, parallel)? * from_base)
        };
        let values = joined(&fitted.each_ref().map(|sweep| &sweep.seen.values));
        let (Some(tracker_from_base), Some((a, b))) = (place(&values), axes(&values)) else {
            return Ok(None);
        };
        let off = |values: &DVector<f64>| {
            let (a, b) = axes(values)?;
            let displaced = xi(&(tracker_from_base.inverse() * place(values)?));
            let size = [angle_between(&a, &b), distance_between(&a, &b, parallel)];
            Some(DVector::from_iterator(8, displaced.iter().copied().chain(size)))
        };
        let Some(change) = derivative(&values, off) else { return Ok(None) };
        let covariance =
            &change * block_diagonal(&fitted.each_ref().map(|s| &s.seen.covariance)) * change.transpose();
        let mut of_place = Matrix6::from_fn(|i, j| covariance[(i, j)]);
        let open = open_directions(&a, &b, parallel);
        for direction in &open {
            let along = tracker_from_base.rotation.inverse() * direction;
            let along = Vector6::new(along.x, along.y, along.z, 0.0, 0.0, 0.0);
            of_place += along * along.transpose() * NOMINAL * NOMINAL;
        }
        let sigma = |at: usize| covariance[(at, at)].max(0.0).sqrt();
        let (stand, turn) = stand_of(&tracker_from_base, &of_place);
        let swept = SweptStation {
            station: self.station.name.clone(),
            axes: [self.told(first, &fitted[0], &a), self.told(second, &fitted[1], &b)],
            angle: [angle_between(&a, &b), sigma(6), angle_between(&n1, &n2)],
            distance: (a.turns && b.turns).then(|| {
                [distance_between(&a, &b, parallel), sigma(7), distance_between(&n1, &n2, parallel)]
            }),
            stand,
            turn,
            open: open.len(),
        };
        let last_joint = first.joint.max(second.joint);
        let place = SweptPlace { tracker_from_base, covariance: of_place, last_joint, readings: Vec::new() };
        Ok(Some((place, swept)))
    }

    fn told(&self, run: &Run, sweep: &Sweep, axis: &Axis) -> SweptAxis {
        let values = || run.readings.iter().map(|row| self.seen[*row][run.joint]);
        SweptAxis {
            joint: run.joint,
            name: self.model.kinematics.links[run.joint].name.clone(),
            kind: sweep.seen.kind,
            readings: sweep.rows.len(),
            gross: sweep.gross.iter().map(|row| self.station.sweeps[*row].pose).collect(),
            span: values().fold(f64::NEG_INFINITY, f64::max) - values().fold(f64::INFINITY, f64::min),
            radius: axis.turns.then_some(axis.radius),
            rms: sweep.seen.rms,
            chi2_per_dof: sweep.seen.chi2_per_dof,
        }
    }

    fn point(&self, run: &Run, row: usize) -> Point {
        let observation = &self.station.sweeps[row];
        let noise = observation.reading.position_covariance();
        (self.seen[row][run.joint], observation.reading.position(), noise)
    }

    /// The sweep as it was seen, without its gross errors, and as the nominal robot makes it.
    fn fitted(&self, run: &Run) -> Result<Sweep, SweepError> {
        let link = &self.model.kinematics.links[run.joint];
        let fails =
            |why| SweepError::NoAxis { station: self.station.name.clone(), axis: link.name.clone(), why };
        let (mut rows, mut gross) = (run.readings.clone(), Vec::new());
        let seen = loop {
            let points: Vec<_> = rows.iter().map(|row| self.point(run, *row)).collect();
            let fitted = Fitted::new(link.kind, &points).ok_or_else(|| fails("it is too short"))?;
            match fitted.gross() {
                Some(worst) if rows.len() > MIN_READINGS => gross.push(rows.remove(worst)),
                _ => break fitted,
            }
        };
        let axis = seen.axis().ok_or_else(|| fails("the target hardly moves"))?;
        if axis.turns && axis.radius < 100.0 * seen.rms {
            return Err(fails("the target hardly moves"));
        }
        Ok(Sweep { rows, gross, seen, run: run.clone() })
    }

    /// The swept axis of the robot, with its joint in the mean of its readings.
    fn of_robot(&self, sweep: &Sweep) -> AxisOfRobot {
        let joint = sweep.run.joint;
        let of_first = sweep.rows.first().map_or(&[][..], |row| &self.seen[*row]);
        let mut joints = of_first.to_vec();
        let mean = sweep.rows.iter().map(|row| self.seen[*row][joint]).sum::<f64>() / sweep.rows.len() as f64;
        if let Some(own) = joints.get_mut(joint) {
            *own = mean;
        }
        let target = sweep.rows.first().map(|row| self.station.sweeps[*row].target);
        let in_flange =
            target.and_then(|target| self.targets.get(target)).map_or_else(Vector3::zeros, |t| t.in_flange);
        AxisOfRobot { joint, joints, in_flange }
    }

    /// The readings of a sweep with their covariances.
    fn weighed(&self, run: &Run) -> Vec<(usize, Matrix3<f64>)> {
        let Ok(sweep) = self.fitted(run) else { return Vec::new() };
        let of = |row: &usize| {
            let stated = self.point(run, *row).2.filter(|_| sweep.seen.chi2_per_dof.is_some());
            (*row, stated.unwrap_or_else(Matrix3::identity) * sweep.seen.scale)
        };
        sweep.rows.iter().map(of).collect()
    }
}

/// Of central differences, m or rad.
const STEP: f64 = 1e-6;

/// A sweep with its fits.
struct Sweep {
    run: Run,
    /// Indices of the observations that it was fitted to.
    rows: Vec<usize>,
    /// Of those that were left out.
    gross: Vec<usize>,
    seen: Fitted,
}

/// The xi of a displacement `exp(xi)`.
fn xi(displacement: &Transform) -> Vector6<f64> {
    let (along, about) = (displacement.translation.vector, rotation_vector(&displacement.rotation));
    Vector6::new(along.x, along.y, along.z, about.x, about.y, about.z)
}

fn joined(parts: &[&DVector<f64>; 2]) -> DVector<f64> {
    DVector::from_iterator(
        parts[0].len() + parts[1].len(),
        parts.iter().flat_map(|part| part.iter().copied()),
    )
}

fn block_diagonal(parts: &[&DMatrix<f64>; 2]) -> DMatrix<f64> {
    let first = parts[0].nrows();
    let n = first + parts[1].nrows();
    let mut whole = DMatrix::zeros(n, n);
    whole.view_mut((0, 0), parts[0].shape()).copy_from(parts[0]);
    whole.view_mut((first, first), parts[1].shape()).copy_from(parts[1]);
    whole
}

/// Central differences.
fn derivative(at: &DVector<f64>, of: impl Fn(&DVector<f64>) -> Option<DVector<f64>>) -> Option<DMatrix<f64>> {
    let mut change = DMatrix::zeros(of(at)?.len(), at.len());
    for column in 0..at.len() {
        let displaced = |step: f64| {
            let mut values = at.clone();
            values[column] += step;
            of(&values)
        };
        change.column_mut(column).copy_from(&((displaced(STEP)? - displaced(-STEP)?) / (2.0 * STEP)));
    }
    Some(change)
}
