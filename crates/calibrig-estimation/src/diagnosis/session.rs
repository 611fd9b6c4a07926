//! A session, and how it looks if it is read with some parts.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Matrix3, Point3, Vector3};

use super::convention::other_convention;
use super::part::Part;
use calibrig_model::geometry::{Transform, best_fit_transform};
use calibrig_model::measurement::{MeasurementSet, NestObservation, Reading, Station};
use calibrig_model::{CalibrationModel, KinematicModel};

/// Nests that lie farther from where the others have them do not place a station, m.
const NEST_OFF: f64 = 0.01;

/// The contents of a session, independent of how it is read.
pub(super) struct Session<'a> {
    pub model: &'a CalibrationModel,
    pub commands: Vec<&'a [f64]>,
    pub seen: Vec<Vector3<f64>>,
    /// Range, azimuth and elevation. `raw` is true if they are as read, false if they are computed from coordinates.
    spherical: Vec<[f64; 3]>,
    raw: bool,
    pub station: Vec<usize>,
    pub target: Vec<usize>,
    pub stations: usize,
    /// The nests of every station; empty where there are too few to place it.
    pub nests: Vec<Vec<Nest>>,
    pub offsets: Vec<Vector3<f64>>,
    /// Standard deviation of a target's offset, where stated, m.
    pub offset_sigma: Vec<Option<f64>>,
    /// Positions of the observations in the file, with gaps for rows that were dropped.
    pub place: Vec<i64>,
    /// Observations that belong to the robot, in order.
    pub sound: Vec<usize>,
    /// The `sound` observations that are examined.
    pub kept: Vec<usize>,
}

/// A base nest: its place in the base, and its reading, as for an observation.
pub(super) struct Nest {
    in_base: Vector3<f64>,
    seen: Vector3<f64>,
    spherical: [f64; 3],
}

/// A session as it is read with some parts: the input of the robot's identification.
#[derive(Clone)]
pub(super) struct View {
    pub chain: KinematicModel,
    /// Joint variables, one row per entry of `rows`.
    pub joints: Vec<f64>,
    /// Index of the observation with the command, and of the one with the point.
    pub rows: Vec<(usize, usize)>,
    pub seen: Vec<Vector3<f64>>,
    pub station: Vec<usize>,
    pub target: Vec<usize>,
    pub stations: usize,
    /// `tracker_from_base` of every station from its nests, where they determine it.
    pub registered: Vec<Option<(Matrix3<f64>, Vector3<f64>)>>,
    pub offsets: Vec<Vector3<f64>>,
    pub offset_sigma: Vec<Option<f64>>,
}

impl View {
    /// Whether anything is stated of targets and stations.
    pub fn is_stated(&self) -> bool {
        self.offset_sigma.iter().any(Option::is_some) || self.registered.iter().any(Option::is_some)
    }
}

impl<'a> Session<'a> {
    pub fn new(model: &'a CalibrationModel, set: &'a MeasurementSet) -> Self {
        let observations = &set.observations;
        let spherical = Reading::spherical;
        let poses: Vec<i64> = observations.iter().map(|o| i64::from(o.pose)).collect();
        let count = |count: usize| i64::try_from(count).unwrap_or(i64::MAX);
        // Consecutive numbers with gaps show where rows were dropped.
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
            nests: set.stations.iter().map(|station| nests(station, spherical)).collect(),
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

    /// The session as it is read with `parts`, in that order where it matters; `None` where this is not possible.
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
            registered: vec![None; self.stations],
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
                    // The offset on that link is unknown.
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
        let ordered = Part::in_order(parts);
        let turned = self.turned(parts);
        let (mut command, mut before) = (vec![0.0; n], Vec::new());
        let mut joints = vec![0.0; n];
        let used = view.chain.links.len();
        for (from, to) in &mut view.rows {
            *to = given[*to];
            command.copy_from_slice(self.commands[*from]);
            for part in &ordered {
                part.command(&self.model.actuators, &mut command, &mut before);
            }
            self.model.actuators.joints_from_command(&command, &mut joints);
            view.joints.extend_from_slice(&joints[..used]);
            view.seen.push(self.reading(parts, self.seen[*to], self.spherical[*to], turned));
            view.station.push(self.station[*to]);
            view.target.push(targets[*to]);
        }
        for (registered, nests) in view.registered.iter_mut().zip(&self.nests) {
            *registered = self.registered(nests, parts, turned);
        }
        Some(view)
    }

    /// Commands combined with the points that are this many rows below.
    fn shifted(&self, by: i64) -> Vec<(usize, usize)> {
        let partner = |i: &usize| {
            let wanted = self.place[*i] + by;
            let j = self.sound.binary_search_by_key(&wanted, |j| self.place[*j]).ok()?;
            Some((*i, self.sound[j]))
        };
        self.kept.iter().filter_map(partner).collect()
    }

    /// Place of a station from its nests, which are read like the points or as they are in the file, whichever fits better.
    fn registered(
        &self,
        nests: &[Nest],
        parts: &[&Part],
        turned: Option<Vector3<f64>>,
    ) -> Option<(Matrix3<f64>, Vector3<f64>)> {
        if nests.is_empty() {
            return None;
        }
        let in_base: Vec<_> = nests.iter().map(|nest| nest.in_base).collect();
        let as_points = nests.iter().map(|nest| self.reading(parts, nest.seen, nest.spherical, turned));
        let placed =
            [as_points.collect::<Vec<_>>(), nests.iter().map(|nest| nest.seen).collect()].map(|seen| {
                let placed = best_fit_transform(&seen, &in_base)?;
                let off =
                    seen.iter().zip(&in_base).map(|(seen, at)| (placed * Point3::from(*at)).coords - seen);
                Some((off.map(|off| off.norm()).fold(0.0, f64::max), placed))
            });
        let nearest = placed.into_iter().flatten().min_by(|a, b| a.0.total_cmp(&b.0))?;
        (nearest.0 < NEST_OFF).then(|| (*nearest.1.rotation.matrix(), nearest.1.translation.vector))
    }

    /// A point and its angles, read with `parts`; `turned` selects the second of two possible points.
    fn reading(
        &self,
        parts: &[&Part],
        mut point: Vector3<f64>,
        mut angles: [f64; 3],
        turned: Option<Vector3<f64>>,
    ) -> Vector3<f64> {
        for part in parts {
            if let Part::TrackerAngleUnit { factor, zenith } = part {
                let from = if *zenith { FRAC_PI_2 } else { 0.0 };
                angles[1] *= factor;
                angles[2] = from + factor * (angles[2] - from);
                point = position(angles);
            }
        }
        for part in parts {
            match part {
                Part::ZenithElevation { .. } => {
                    angles[2] = FRAC_PI_2 - angles[2];
                    point = position(angles);
                    // For a point given by coordinates, the angle is known up to its side.
                    if turned.is_some_and(|axis| axis.dot(&point) < 0.0) {
                        point = -point;
                    }
                }
                Part::AnglesExchanged { zenith } => {
                    let [range, azimuth, elevation] = angles;
                    // An elevation is within a quarter turn, a zenith angle is above zero.
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

    /// The common direction of all points, where a reading of coordinates leaves their side open.
    fn turned(&self, parts: &[&Part]) -> Option<Vector3<f64>> {
        if self.raw {
            return None;
        }
        let other_side = parts.iter().find_map(|part| match part {
            Part::ZenithElevation { turned } => Some(*turned),
            _ => None,
        })?;
        let directions = self.kept.iter().map(|i| {
            let [_, azimuth, elevation] = self.spherical[*i];
            position([1.0, azimuth, FRAC_PI_2 - elevation])
        });
        let directions: Vec<_> = directions.collect();
        let inertia: nalgebra::Matrix3<f64> = directions.iter().map(|d| d * d.transpose()).sum();
        let eigen = inertia.symmetric_eigen();
        let axis = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
        let most = directions.iter().map(|d| d.dot(&axis).signum()).sum::<f64>();
        Some(if (most < 0.0) == other_side { axis } else { -axis })
    }
}

/// The nests of a station, if there are enough.
fn nests(station: &Station, spherical: impl Fn(&Reading) -> [f64; 3]) -> Vec<Nest> {
    if station.distinct_nests().len() < 3 {
        return Vec::new();
    }
    let nest = |nest: &NestObservation| Nest {
        in_base: nest.in_base,
        seen: nest.reading.position(),
        spherical: spherical(&nest.reading),
    };
    station.nests.iter().map(nest).collect()
}

fn position([range, azimuth, elevation]: [f64; 3]) -> Vector3<f64> {
    let ((sin_az, cos_az), (sin_el, cos_el)) = (azimuth.sin_cos(), elevation.sin_cos());
    range * Vector3::new(cos_el * cos_az, cos_el * sin_az, sin_el)
}
