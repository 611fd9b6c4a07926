//! One convention that a session may break, and what the session is where it is read by another one.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::Vector3;

use super::FarOff;
use calibrig_model::geometry::{Transform, rotation_vector, rotation_x, translation};
use calibrig_model::measurement::{MeasurementSet, Reading};
use calibrig_model::{CalibrationModel, JointKind, KinematicModel};

/// A way in which a session can be meant other than it was read. Joints and observations are counted from zero.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Part {
    /// Commands of revolute joints are in another unit.
    AngleUnit {
        /// Which.
        joints: Vec<usize>,
        /// What they have to be multiplied by.
        factor: f64,
    },
    /// Commands of prismatic joints are in another unit.
    TravelUnit {
        /// Which.
        joints: Vec<usize>,
        /// What they have to be multiplied by.
        factor: f64,
    },
    /// The points are in another unit.
    PointUnit {
        /// What they have to be multiplied by.
        factor: f64,
    },
    /// The tracker's angles are in another unit.
    TrackerAngleUnit {
        /// What they have to be multiplied by.
        factor: f64,
    },
    /// A joint moves the other way.
    Sign {
        /// Which.
        joint: usize,
    },
    /// A joint's zero is elsewhere, by multiples of a quarter turn.
    Offset {
        /// Which.
        joint: usize,
        /// What its command has to be greater by, in quarters of a turn: -1, 1 or 2.
        quarters: i8,
    },
    /// The columns of the commands are in another order.
    Order {
        /// The column that each joint has to take.
        from: Vec<usize>,
        /// What the joint's column has to be multiplied by where it was read as one of another kind of joint; else 1.
        factors: Vec<f64>,
    },
    /// A joint is driven with another one.
    Coupling {
        /// Which.
        joint: usize,
        /// The other.
        with: usize,
        /// The share of the other's command that has to be added: 1 or -1.
        share: f64,
    },
    /// The table is of the other convention.
    Convention {
        /// Which one it is.
        standard: bool,
    },
    /// The target is on another link than the last.
    ToolLink {
        /// The joint that moves this link.
        joint: usize,
    },
    /// Points stand beside the commands of other rows.
    ShiftedRows {
        /// A command belongs to the point so many rows below.
        by: i64,
    },
    /// An angle from the zenith was read as an elevation, or the other way round.
    ZenithElevation,
    /// Azimuth and elevation are exchanged.
    AnglesExchanged {
        /// Whether what was read as an elevation is the complement of an angle from the zenith.
        zenith: bool,
    },
    /// The points are a mirror image: axes exchanged, or one of them, or the azimuth, counted the other way.
    Mirrored,
    /// Observations that have each other's points.
    ExchangedRows {
        /// Each has the point of the next one, the last that of the first.
        cycles: Vec<Vec<usize>>,
    },
    /// Points that are off.
    GrossErrors {
        /// Which, farthest first.
        rows: Vec<FarOff>,
    },
    /// Codes of missed shots in the place of points.
    MissedShots {
        /// Which, with the distance from the middle of the others.
        rows: Vec<FarOff>,
    },
    /// Targets at offsets of their own under one name.
    SeveralTargets {
        /// Index of the target.
        target: usize,
        /// The observations of each but the most frequent one.
        others: Vec<Vec<usize>>,
    },
}

impl Part {
    /// The key in JSON.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::AngleUnit { .. } | Self::TrackerAngleUnit { .. } => "angle_unit",
            Self::TravelUnit { .. } | Self::PointUnit { .. } => "length_unit",
            Self::Sign { .. } => "joint_sign",
            Self::Offset { .. } => "joint_offset",
            Self::Order { .. } => "joint_order",
            Self::Coupling { .. } => "coupling",
            Self::Convention { .. } => "convention",
            Self::ToolLink { .. } => "tool_link",
            Self::ShiftedRows { .. } => "rows_shifted",
            Self::ZenithElevation => "zenith_elevation",
            Self::AnglesExchanged { .. } => "axes_exchanged",
            Self::Mirrored => "mirrored_frame",
            Self::ExchangedRows { .. } => "rows_exchanged",
            Self::GrossErrors { .. } => "gross_error",
            Self::MissedShots { .. } => "missed_shot_code",
            Self::SeveralTargets { .. } => "mixed_targets",
        }
    }

    /// Joints that it is about.
    pub fn joints(&self) -> Vec<usize> {
        match self {
            Self::AngleUnit { joints, .. } | Self::TravelUnit { joints, .. } => joints.clone(),
            Self::Sign { joint } | Self::Offset { joint, .. } | Self::ToolLink { joint } => vec![*joint],
            Self::Coupling { joint, with, .. } => vec![*joint, *with],
            Self::Order { from, .. } => (0..from.len()).filter(|joint| from[*joint] != *joint).collect(),
            _ => Vec::new(),
        }
    }

    /// Observations that it is about.
    pub fn rows(&self) -> Vec<usize> {
        match self {
            Self::ExchangedRows { cycles } => cycles.iter().flatten().copied().collect(),
            Self::GrossErrors { rows } | Self::MissedShots { rows } => {
                rows.iter().map(|far| far.observation).collect()
            }
            Self::SeveralTargets { others, .. } => others.iter().flatten().copied().collect(),
            _ => Vec::new(),
        }
    }

    /// Whether it is about single rows.
    pub fn is_of_rows(&self) -> bool {
        matches!(
            self,
            Self::ExchangedRows { .. }
                | Self::GrossErrors { .. }
                | Self::MissedShots { .. }
                | Self::SeveralTargets { .. }
        )
    }

    /// Of two that explain the same, the one of the lower rank is the more usual mistake.
    pub(super) fn rank(&self) -> u8 {
        match self {
            Self::AngleUnit { joints, .. } if joints.len() > 1 => 0,
            Self::PointUnit { .. } | Self::TravelUnit { .. } => 1,
            Self::Mirrored | Self::MissedShots { .. } => 2,
            Self::Sign { .. } => 3,
            Self::Offset { .. } | Self::ZenithElevation | Self::AnglesExchanged { .. } => 4,
            Self::Order { from, .. } if moved(from) == 2 => 5,
            Self::ShiftedRows { .. } | Self::Convention { .. } | Self::TrackerAngleUnit { .. } => 5,
            Self::Coupling { .. }
            | Self::ExchangedRows { .. }
            | Self::GrossErrors { .. }
            | Self::SeveralTargets { .. } => 6,
            Self::ToolLink { .. } | Self::AngleUnit { .. } => 7,
            Self::Order { .. } => 8,
        }
    }

    /// Whether it is usual enough to be looked for beside another one.
    pub(super) fn is_usual(&self) -> bool {
        match self {
            Self::Order { from, .. } => moved(from) == 2,
            Self::Coupling { joint, with, .. } => joint.abs_diff(*with) <= 2,
            Self::TravelUnit { factor, .. } => [1e3, 1e-3].contains(factor),
            _ => true,
        }
    }

    /// Two orders, one after the other, are one.
    pub(super) fn merged(parts: Vec<Self>) -> Vec<Self> {
        let [Self::Order { from: a, factors: f }, Self::Order { from: b, factors: g }] = parts.as_slice()
        else {
            return parts;
        };
        let from = b.iter().map(|column| a[*column]).collect();
        let factors = b.iter().zip(g).map(|(column, g)| f[*column] * g).collect();
        vec![Self::Order { from, factors }]
    }

    /// Where in the reading of a session it comes.
    fn layer(&self) -> u8 {
        match self {
            Self::Order { .. } => 0,
            Self::AngleUnit { .. } | Self::TravelUnit { .. } => 1,
            Self::Sign { .. } => 2,
            Self::Offset { .. } => 3,
            _ => 4,
        }
    }

    /// Whether it matters which of the two comes first, beyond what the usual order says.
    pub(super) fn is_twofold_with(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Coupling { joint, with, .. }, Self::Coupling { joint: j, with: w, .. }) => {
                joint == w || with == j
            }
            (Self::Coupling { with, .. }, Self::Offset { joint, .. })
            | (Self::Offset { joint, .. }, Self::Coupling { with, .. }) => joint == with,
            (Self::Order { from: a, .. }, Self::Order { from: b, .. }) => {
                (0..a.len()).any(|i| a[i] != i && b[i] != i)
            }
            _ => false,
        }
    }

    /// Changes the commands of one observation.
    fn command(&self, command: &mut [f64], before: &mut Vec<f64>) {
        match self {
            Self::AngleUnit { joints, factor } | Self::TravelUnit { joints, factor } => {
                for joint in joints {
                    command[*joint] *= factor;
                }
            }
            Self::Sign { joint } => command[*joint] = -command[*joint],
            Self::Offset { joint, quarters } => command[*joint] += FRAC_PI_2 * f64::from(*quarters),
            Self::Coupling { joint, with, share } => command[*joint] += share * command[*with],
            Self::Order { from, factors } => {
                before.clear();
                before.extend_from_slice(command);
                for (joint, (column, factor)) in from.iter().zip(factors).enumerate() {
                    command[joint] = factor * before[*column];
                }
            }
            _ => {}
        }
    }
}

/// How many joints take another column.
fn moved(from: &[usize]) -> usize {
    from.iter().enumerate().filter(|(joint, column)| joint != *column).count()
}

/// What a session holds, apart from how it is read.
pub(super) struct Session<'a> {
    pub model: &'a CalibrationModel,
    pub commands: Vec<&'a [f64]>,
    pub seen: Vec<Vector3<f64>>,
    /// Range, azimuth and elevation; whether as they were read, or made of coordinates.
    spherical: Vec<[f64; 3]>,
    raw: bool,
    pub station: Vec<usize>,
    pub target: Vec<usize>,
    pub stations: usize,
    pub offsets: Vec<Vector3<f64>>,
    /// Standard deviation of a target's offset, where stated, m.
    pub offset_sigma: Vec<Option<f64>>,
    /// Places of the observations in the file, which rows that were left out leave free.
    pub place: Vec<i64>,
    /// Observations that are of the robot, in order.
    pub sound: Vec<usize>,
    /// Those of them that are looked at.
    pub kept: Vec<usize>,
}

/// A session as it is read by some parts: what the identification of a robot starts from.
#[derive(Clone)]
pub(super) struct View {
    pub chain: KinematicModel,
    /// Joint variables, one row an entry of `rows`.
    pub joints: Vec<f64>,
    /// Observation whose command, and observation whose point.
    pub rows: Vec<(usize, usize)>,
    pub seen: Vec<Vector3<f64>>,
    pub station: Vec<usize>,
    pub target: Vec<usize>,
    pub stations: usize,
    pub offsets: Vec<Vector3<f64>>,
    pub offset_sigma: Vec<Option<f64>>,
}

impl<'a> Session<'a> {
    pub fn new(model: &'a CalibrationModel, set: &'a MeasurementSet) -> Self {
        let observations = &set.observations;
        let spherical = |reading: &Reading| match reading {
            Reading::Spherical(s) => [s.range, s.azimuth, s.elevation],
            Reading::Cartesian { position: p, .. } => [p.norm(), p.y.atan2(p.x), p.z.atan2(p.x.hypot(p.y))],
        };
        let poses: Vec<i64> = observations.iter().map(|o| i64::from(o.pose)).collect();
        let count = |count: usize| i64::try_from(count).unwrap_or(i64::MAX);
        // Numbers that run through, but for rows that were dropped, tell where these were.
        let runs = poses.windows(2).all(|pair| pair[0] < pair[1])
            && poses
                .last()
                .zip(poses.first())
                .is_some_and(|(last, first)| (last - first) < count(poses.len() + poses.len() / 4 + 2));
        let sigma = |target: &calibrig_model::measurement::Target| {
            target.covariance.map(|c| (c.trace() / 3.0).max(0.0).sqrt())
        };
        Self {
            model,
            commands: observations.iter().map(|o| o.command.as_slice()).collect(),
            seen: observations.iter().map(|o| o.reading.position()).collect(),
            spherical: observations.iter().map(|o| spherical(&o.reading)).collect(),
            raw: observations.iter().all(|o| matches!(o.reading, Reading::Spherical(_))),
            station: observations.iter().map(|o| o.station).collect(),
            target: observations.iter().map(|o| o.target).collect(),
            stations: set.stations.len(),
            offsets: set.targets.iter().map(|target| target.in_flange).collect(),
            offset_sigma: set.targets.iter().map(sigma).collect(),
            place: if runs { poses } else { (0..count(observations.len())).collect() },
            sound: (0..observations.len()).collect(),
            kept: (0..observations.len()).collect(),
        }
    }

    /// Whether the tracker's angles are known as they were read.
    pub fn has_angles(&self) -> bool {
        self.raw
    }

    /// The session as it is read by `parts`, in that order where it matters; `None` where they cannot be.
    pub fn view(&self, parts: &[&Part]) -> Option<View> {
        let n = self.model.kinematics.joint_count();
        let mut view = View {
            chain: self.model.kinematics.clone(),
            joints: Vec::with_capacity(n * self.kept.len()),
            rows: self.kept.iter().map(|i| (*i, *i)).collect(),
            seen: Vec::with_capacity(self.kept.len()),
            station: Vec::with_capacity(self.kept.len()),
            target: Vec::with_capacity(self.kept.len()),
            stations: self.stations,
            offsets: self.offsets.clone(),
            offset_sigma: self.offset_sigma.clone(),
        };
        let mut targets = self.target.clone();
        let mut given: Vec<usize> = (0..self.seen.len()).collect();
        for part in parts {
            match part {
                Part::ShiftedRows { by } => view.rows = self.shifted(*by),
                Part::Convention { standard } => view.chain = other_convention(&view.chain, *standard)?,
                Part::ToolLink { joint } => {
                    view.chain.links.truncate(joint + 1);
                    view.chain.last_from_flange = Transform::identity();
                    // Nothing is known of where it is on that link.
                    view.offset_sigma.fill(None);
                }
                Part::ExchangedRows { cycles } => {
                    for cycle in cycles {
                        let next = cycle.iter().cycle().skip(1);
                        cycle.iter().zip(next).for_each(|(i, j)| given[*i] = *j);
                    }
                }
                Part::GrossErrors { rows } | Part::MissedShots { rows } => {
                    let is_out = |i: usize| rows.iter().any(|far| far.observation == i);
                    view.rows.retain(|(_, point)| !is_out(*point));
                }
                Part::SeveralTargets { target, others } => {
                    for group in others {
                        for i in group {
                            targets[*i] = view.offsets.len();
                        }
                        view.offsets.push(self.offsets[*target]);
                        view.offset_sigma.push(None);
                    }
                }
                _ => {}
            }
        }
        let mut ordered: Vec<&Part> = parts.to_vec();
        if !(parts.len() == 2 && parts[0].is_twofold_with(parts[1])) {
            ordered.sort_by_key(|part| part.layer());
        }
        let turned = self.turned(parts);
        let (mut command, mut before) = (vec![0.0; n], Vec::new());
        let mut joints = vec![0.0; n];
        let used = view.chain.links.len();
        for (from, to) in &mut view.rows {
            *to = given[*to];
            command.copy_from_slice(self.commands[*from]);
            for part in &ordered {
                part.command(&mut command, &mut before);
            }
            self.model.actuators.joints_from_command(&command, &mut joints);
            view.joints.extend_from_slice(&joints[..used]);
            view.seen.push(self.reading(parts, *to, turned));
            view.station.push(self.station[*to]);
            view.target.push(targets[*to]);
        }
        Some(view)
    }

    /// Commands with the points so many rows below.
    fn shifted(&self, by: i64) -> Vec<(usize, usize)> {
        let partner = |i: &usize| {
            let wanted = self.place[*i] + by;
            let j = self.sound.binary_search_by_key(&wanted, |j| self.place[*j]).ok()?;
            Some((*i, self.sound[j]))
        };
        self.kept.iter().filter_map(partner).collect()
    }

    /// The point of observation `i` as it is read by `parts`; the second of two readings where `turned` says so.
    fn reading(&self, parts: &[&Part], i: usize, turned: Option<Vector3<f64>>) -> Vector3<f64> {
        let mut point = self.seen[i];
        let mut angles = self.spherical[i];
        for part in parts {
            match part {
                Part::TrackerAngleUnit { factor } => {
                    angles[1] *= factor;
                    angles[2] *= factor;
                    point = position(angles);
                }
                Part::ZenithElevation => {
                    angles[2] = FRAC_PI_2 - angles[2];
                    point = position(angles);
                    // Of a point of coordinates the angle is known but for the side that it is on.
                    if turned.is_some_and(|axis| axis.dot(&point) < 0.0) {
                        point = -point;
                    }
                }
                Part::AnglesExchanged { zenith } => {
                    let [range, azimuth, elevation] = angles;
                    // An elevation is within a quarter turn, an angle from the zenith above zero.
                    let over = if *zenith { azimuth < 0.0 } else { azimuth.abs() > FRAC_PI_2 };
                    let (azimuth, elevation) =
                        if !self.raw && over { (azimuth - PI, PI - elevation) } else { (azimuth, elevation) };
                    angles = if *zenith {
                        [range, FRAC_PI_2 - elevation, FRAC_PI_2 - azimuth]
                    } else {
                        [range, elevation, azimuth]
                    };
                    point = position(angles);
                }
                _ => {}
            }
        }
        for part in parts {
            match part {
                Part::PointUnit { factor } => point *= *factor,
                Part::Mirrored => point.z = -point.z,
                _ => {}
            }
        }
        point
    }

    /// The direction in which all points lie, where a reading of coordinates leaves their side open.
    fn turned(&self, parts: &[&Part]) -> Option<Vector3<f64>> {
        if self.raw || !parts.iter().any(|part| matches!(part, Part::ZenithElevation)) {
            return None;
        }
        let directions = self.kept.iter().map(|i| {
            let [_, azimuth, elevation] = self.spherical[*i];
            position([1.0, azimuth, FRAC_PI_2 - elevation])
        });
        let directions: Vec<_> = directions.collect();
        let inertia: nalgebra::Matrix3<f64> = directions.iter().map(|d| d * d.transpose()).sum();
        let eigen = inertia.symmetric_eigen();
        let axis = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
        // The side of most; whether that is right is left to the mirror image.
        let most = directions.iter().map(|d| d.dot(&axis).signum()).sum::<f64>();
        Some(if most < 0.0 { -axis } else { axis })
    }
}

fn position([range, azimuth, elevation]: [f64; 3]) -> Vector3<f64> {
    let ((sin_az, cos_az), (sin_el, cos_el)) = (azimuth.sin_cos(), elevation.sin_cos());
    range * Vector3::new(cos_el * cos_az, cos_el * sin_az, sin_el)
}

/// The chain of the same table in the standard convention, or of one that was read as standard in Craig's.
pub(super) fn other_convention(chain: &KinematicModel, standard: bool) -> Option<KinematicModel> {
    let links = &chain.links;
    if links.iter().any(|link| link.beta != 0.0) {
        return None;
    }
    let last = &chain.last_from_flange;
    let mut other = chain.clone();
    if standard {
        if *last != Transform::identity() {
            return None;
        }
        let mut behind = (0.0, 0.0);
        for link in &mut other.links {
            let own = (link.a, link.alpha);
            (link.a, link.alpha) = std::mem::replace(&mut behind, own);
        }
        other.last_from_flange = translation(behind.0, 0.0, 0.0) * rotation_x(behind.1);
    } else {
        let turn = rotation_vector(&last.rotation);
        let shift = last.translation.vector;
        let is_row = turn.yz().norm() < 1e-9 && shift.yz().norm() < 1e-12;
        if !is_row || links[0].a != 0.0 || links[0].alpha != 0.0 {
            return None;
        }
        let mut own = (shift.x, turn.x);
        for link in other.links.iter_mut().rev() {
            let behind = (link.a, link.alpha);
            (link.a, link.alpha) = std::mem::replace(&mut own, behind);
        }
        other.last_from_flange = Transform::identity();
    }
    (other != *chain).then_some(other)
}

/// Units of a length, seen from another one.
pub(super) const LENGTHS: [f64; 10] = [1e3, 1e-3, 1e6, 1e-6, 10.0, 0.1, 100.0, 0.01, 25.4, 1.0 / 25.4];
/// Rows that a shift is looked for over.
const SHIFTS: i64 = 5;

/// Every part that changes how all rows are read, but for those that a placement tells by itself (mirror image and unit of the points).
pub(super) fn structural(session: &Session<'_>) -> Vec<Part> {
    let links = &session.model.kinematics.links;
    let n = links.len();
    let kind = |joint: usize| links[joint].kind;
    let of_kind = |wanted| (0..n).filter(|joint| kind(*joint) == wanted).collect::<Vec<_>>();
    let (revolute, prismatic) = (of_kind(JointKind::Revolute), of_kind(JointKind::Prismatic));
    let largest =
        |joint: usize| session.kept.iter().map(|i| session.commands[*i][joint].abs()).fold(0.0, f64::max);
    let mut parts = Vec::new();
    angle_units(&revolute, largest, &mut parts);
    if !prismatic.is_empty() {
        let unit = |factor| Part::TravelUnit { joints: prismatic.clone(), factor };
        parts.extend(LENGTHS.map(unit));
    }
    parts.extend((0..n).map(|joint| Part::Sign { joint }));
    // What turns about the first axis is taken up by the tracker's place, about the last by a target that is not known.
    let known = session.offset_sigma.iter().all(Option::is_some);
    for &joint in revolute.iter().filter(|joint| **joint > 0 && (**joint + 1 < n || known)) {
        parts.extend([1, -1, 2].map(|quarters| Part::Offset { joint, quarters }));
    }
    orders(n, kind, &mut parts);
    for &joint in &revolute {
        for &with in revolute.iter().filter(|with| **with != joint) {
            parts.extend([-1.0, 1.0].map(|share| Part::Coupling { joint, with, share }));
        }
    }
    for standard in [true, false] {
        if other_convention(&session.model.kinematics, standard).is_some() {
            parts.push(Part::Convention { standard });
        }
    }
    parts.extend((0..n.saturating_sub(1)).map(|joint| Part::ToolLink { joint }));
    parts.extend((1..=SHIFTS).flat_map(|by| [Part::ShiftedRows { by }, Part::ShiftedRows { by: -by }]));
    parts.push(Part::ZenithElevation);
    parts.extend([false, true].map(|zenith| Part::AnglesExchanged { zenith }));
    parts.push(Part::TrackerAngleUnit { factor: 1.0_f64.to_degrees() });
    if session.has_angles() {
        parts.push(Part::TrackerAngleUnit { factor: 1.0_f64.to_radians() });
    }
    parts
}

fn angle_units(revolute: &[usize], largest: impl Fn(usize) -> f64, parts: &mut Vec<Part>) {
    let (degree, radian) = (1.0_f64.to_degrees(), 1.0_f64.to_radians());
    // Two whole turns of radians taken for degrees, or the smallest travel of degrees taken for radians.
    let is_small = |joint: usize| largest(joint) < (4.0 * PI).to_radians();
    let is_large = |joint: usize| largest(joint) > 2.0;
    let all = |factor| Part::AngleUnit { joints: revolute.to_vec(), factor };
    if !revolute.is_empty() && revolute.iter().all(|joint| is_small(*joint)) {
        parts.push(all(degree));
    }
    if revolute.iter().any(|joint| is_large(*joint)) {
        parts.push(all(radian));
    }
    if revolute.len() < 2 {
        return;
    }
    for &joint in revolute {
        let one = |factor| Part::AngleUnit { joints: vec![joint], factor };
        parts.extend(is_small(joint).then(|| one(degree)));
        parts.extend(is_large(joint).then(|| one(radian)));
    }
}

/// Two columns exchanged, one column at another place, and all the other way round.
fn orders(n: usize, kind: impl Fn(usize) -> JointKind, parts: &mut Vec<Part>) {
    let mut orders: Vec<Vec<usize>> = Vec::new();
    let mut add = |order: Vec<usize>| {
        if !orders.contains(&order) && moved(&order) > 0 {
            orders.push(order);
        }
    };
    for i in 0..n {
        for j in i + 1..n {
            let mut order: Vec<usize> = (0..n).collect();
            order.swap(i, j);
            add(order);
        }
    }
    for i in 0..n {
        for j in 0..n {
            let mut order: Vec<usize> = (0..n).collect();
            let column = order.remove(i);
            order.insert(j, column);
            add(order);
        }
    }
    add((0..n).rev().collect());
    for from in orders {
        let is_mixed = (0..n).any(|joint| kind(joint) != kind(from[joint]));
        // Columns in SI, or an angle in degrees that was read as millimetres and the other way round.
        let of_columns: &[f64] = if is_mixed { &[1.0, 1e3_f64.to_radians()] } else { &[1.0] };
        for &size in of_columns {
            let factor = |joint: usize| match (kind(joint), kind(from[joint])) {
                (JointKind::Revolute, JointKind::Prismatic) => size,
                (JointKind::Prismatic, JointKind::Revolute) => 1.0 / size,
                _ => 1.0,
            };
            let factors = (0..n).map(factor).collect();
            parts.push(Part::Order { from: from.clone(), factors });
        }
    }
}
