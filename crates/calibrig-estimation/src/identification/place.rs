//! Places of stations and targets before the fit, and the parts of both that cannot be determined.

use nalgebra::Vector3;

use super::options::is_placed;
use super::{DependentGroup, FrameChoice, IdentificationOptions, IdentifyError, TargetChoice};
use crate::kinematics::{forward_kinematics, nominal_joints, target};
use calibrig_model::geometry::{Transform, best_fit_transform};
use calibrig_model::measurement::{MeasurementSet, Observation, Reading, TargetOrientation, register};
use calibrig_model::{CalibrationModel, ParameterId};

/// Which components of free stations and unknown targets are parameters of the fit.
#[derive(Debug, Clone)]
pub(super) struct Ends {
    /// Components of every free station's frame that are parameters.
    pub frame_components: [bool; 6],
    /// Coordinates of every target that are parameters.
    pub target_axes: Vec<[bool; 3]>,
    /// Axes of every target's orientation that are parameters.
    pub orientation_axes: Vec<[bool; 3]>,
    /// The components that are not parameters.
    pub fixed: Vec<DependentGroup>,
}

impl Ends {
    /// `redundant` is the structural redundancy of the chain, for station and target 0. A shift that the frame can do as well is left out of one
    /// target in each group that shares stations; the others are relative to it.
    pub fn new(set: &MeasurementSet, options: &IdentificationOptions, redundant: &[DependentGroup]) -> Self {
        let mut ends = Self {
            frame_components: [true; 6],
            target_axes: vec![[true; 3]; set.targets.len()],
            orientation_axes: vec![[true; 3]; set.targets.len()],
            fixed: Vec::new(),
        };
        for id in &options.fix {
            let told = match *id {
                ParameterId::Target { target, axis } => {
                    ends.target_axes.get_mut(target).and_then(|axes| axes.get_mut(axis))
                }
                ParameterId::Orientation { target, axis } => {
                    ends.orientation_axes.get_mut(target).and_then(|axes| axes.get_mut(axis))
                }
                _ => None,
            };
            if let Some(told) = told {
                *told = false;
            }
        }
        if redundant.is_empty() {
            return ends;
        }
        let firsts_of_poses = firsts(set, |o| matches!(o.reading, Reading::Pose(_)));
        let firsts = firsts(set, |_| true);
        for group in redundant {
            match group.redundant {
                ParameterId::Frame { component, .. } => {
                    ends.frame_components[component] = false;
                    let free =
                        |station: &usize| options.frame.of(&set.stations[*station]) == FrameChoice::Free;
                    let stations = (0..set.stations.len()).filter(free);
                    ends.fixed.extend(stations.map(|station| of(group, station, 0)));
                }
                ParameterId::Target { axis, .. } => {
                    for (target, station) in &firsts {
                        if options.target.of(&set.targets[*target]) == TargetChoice::Identified {
                            ends.target_axes[*target][axis] = false;
                            ends.fixed.push(of(group, *station, *target));
                        }
                    }
                }
                ParameterId::Orientation { axis, .. } => {
                    for (target, station) in &firsts_of_poses {
                        let orientation = set.targets[*target].orientation.as_ref();
                        let is_unknown = |o: &TargetOrientation| {
                            options.target.of_orientation(o) == TargetChoice::Identified
                        };
                        if orientation.is_some_and(is_unknown) {
                            ends.orientation_axes[*target][axis] = false;
                            ends.fixed.push(of(group, *station, *target));
                        }
                    }
                }
                _ => {}
            }
        }
        ends
    }
}

/// The same group for another station and target.
fn of(group: &DependentGroup, station: usize, target: usize) -> DependentGroup {
    let id = |id: ParameterId| match id {
        ParameterId::Frame { component, .. } => ParameterId::Frame { station, component },
        ParameterId::Target { axis, .. } => ParameterId::Target { target, axis },
        ParameterId::Orientation { axis, .. } => ParameterId::Orientation { target, axis },
        other => other,
    };
    DependentGroup {
        redundant: id(group.redundant),
        with: group.with.iter().map(|(with, factor)| (id(*with), *factor)).collect(),
        singular_value: group.singular_value,
    }
}

/// The first target of each group that stations tie together, among the observations that are `looked` at, with a station that saw it.
fn firsts(set: &MeasurementSet, looked: impl Fn(&Observation) -> bool) -> Vec<(usize, usize)> {
    let observations: Vec<&Observation> = set.observations.iter().filter(|o| looked(o)).collect();
    let mut first: Vec<usize> = (0..set.targets.len()).collect();
    let mut seen_by: Vec<Option<usize>> = vec![None; set.targets.len()];
    for observation in &observations {
        seen_by[observation.target].get_or_insert(observation.station);
    }
    // As many rounds as the longest chain of targets has links.
    for _ in 0..set.targets.len() {
        for station in 0..set.stations.len() {
            let targets = || observations.iter().filter(|o| o.station == station).map(|o| o.target);
            let Some(least) = targets().map(|target| first[target]).min() else { continue };
            targets().for_each(|target| first[target] = least);
        }
    }
    let of_first = |(target, station): (usize, Option<usize>)| {
        Some((target, station?)).filter(|_| first[target] == target)
    };
    seen_by.into_iter().enumerate().filter_map(of_first).collect()
}

/// `tracker_from_base` of every station that fits the nominal robot, ideal and rigid, with its targets at `offsets`, to the measurements.
pub(super) fn best_fit_stations(
    model: &CalibrationModel,
    set: &MeasurementSet,
    offsets: &[Vector3<f64>],
) -> Result<Vec<Transform>, IdentifyError> {
    (0..set.stations.len()).map(|station| best_fit_station(model, set, offsets, station)).collect()
}

pub(super) fn best_fit_station(
    model: &CalibrationModel,
    set: &MeasurementSet,
    offsets: &[Vector3<f64>],
    station: usize,
) -> Result<Transform, IdentifyError> {
    let mut joints = vec![0.0; model.kinematics.joint_count()];
    let (mut seen, mut nominal) = (Vec::new(), Vec::new());
    for observation in set.observations.iter().filter(|o| o.station == station) {
        // A four-bar that does not close is reported where the pose is fitted.
        let _ = nominal_joints(model, &observation.command, &mut joints);
        seen.push(observation.reading.position());
        nominal.push(target(&model.kinematics, &joints, &offsets[observation.target]));
    }
    let station = &set.stations[station];
    if seen.is_empty() && is_placed(station) {
        // From this station only the nests were measured.
        return register(station)
            .map(|registration| registration.tracker_from_base)
            .map_err(|source| IdentifyError::Registration { station: station.name.clone(), source });
    }
    best_fit_transform(&seen, &nominal).ok_or(IdentifyError::BestFit)
}

/// A nominal target that moves by less than this share of the measured motion does not help to place the tracker: its offset is missing.
const HARDLY_MOVES: f64 = 0.3;
/// Rounds of placing stations and targets in turn.
const ROUNDS: usize = 30;

/// Initial offsets of the targets, m: as stated, unless unknown ones (with any of the axes `told`) leave the nominal target nearly at rest while
/// the measured one moves, as on a positioner with intersecting axes. Then several trial offsets are improved, stations and targets in turn, and
/// the one that fits best is taken.
pub(super) fn starting_offsets(
    model: &CalibrationModel,
    set: &MeasurementSet,
    choice: TargetChoice,
    told: &[[bool; 3]],
) -> Vec<Vector3<f64>> {
    let stated: Vec<Vector3<f64>> = set.targets.iter().map(|target| target.in_flange).collect();
    let unknown: Vec<bool> =
        set.targets.iter().map(|target| choice.of(target) == TargetChoice::Identified).collect();
    if !unknown.contains(&true) {
        return stated;
    }
    let axes = |(target, axes): (usize, &[bool; 3])| axes.map(|told| told && unknown[target]);
    let told: Vec<[bool; 3]> = told.iter().enumerate().map(axes).collect();
    let flanges = Flanges(flanges(model, set));
    let (seen, nominal) = flanges.spreads(set, &stated);
    if nominal > HARDLY_MOVES * seen {
        return stated;
    }
    let tries = (0..8).map(|corner: usize| {
        let sign = |bit: usize| if corner >> bit & 1 == 0 { 1.0 } else { -1.0 };
        let trial = seen * Vector3::new(0.7 * sign(0), 0.5 * sign(1), 0.6 * sign(2));
        let offset = |(target, at): (usize, &Vector3<f64>)| {
            Vector3::from_fn(|axis, _| if told[target][axis] { at[axis] + trial[axis] } else { at[axis] })
        };
        stated.iter().enumerate().map(offset).collect::<Vec<_>>()
    });
    let improved = tries.filter_map(|offsets| flanges.improved(set, offsets, &told));
    let best = improved.min_by(|a, b| a.1.total_cmp(&b.1));
    best.map_or(stated, |(offsets, _)| offsets)
}

/// `base_from_flange` of the nominal robot at every observation.
struct Flanges(Vec<Transform>);

/// `base_from_flange` of the nominal robot at every observation.
pub(super) fn flanges(model: &CalibrationModel, set: &MeasurementSet) -> Vec<Transform> {
    let mut joints = vec![0.0; model.kinematics.joint_count()];
    let flange = |command: &[f64]| {
        let _ = nominal_joints(model, command, &mut joints);
        // Commands have been checked before.
        forward_kinematics(&model.kinematics, &joints).unwrap_or_else(|_| Transform::identity())
    };
    set.observations.iter().map(|o| o.command.as_slice()).map(flange).collect()
}

impl Flanges {
    /// Root mean square distances of measured and of nominal points from their mean, for the station where they are largest.
    fn spreads(&self, set: &MeasurementSet, offsets: &[Vector3<f64>]) -> (f64, f64) {
        let of = |station: usize| {
            let of_station =
                || set.observations.iter().zip(&self.0).filter(move |(o, _)| o.station == station);
            let seen: Vec<_> = of_station().map(|(o, _)| o.reading.position()).collect();
            let nominal: Vec<_> = of_station().map(|(o, flange)| at(flange, &offsets[o.target])).collect();
            (spread(&seen), spread(&nominal))
        };
        let spreads = (0..set.stations.len()).map(of);
        spreads.fold(
            (0.0, 0.0),
            |widest, (seen, nominal)| if seen > widest.0 { (seen, nominal) } else { widest },
        )
    }

    /// Offsets after stations and targets were placed in turn, and the remaining sum of squares, m².
    fn improved(
        &self,
        set: &MeasurementSet,
        mut offsets: Vec<Vector3<f64>>,
        told: &[[bool; 3]],
    ) -> Option<(Vec<Vector3<f64>>, f64)> {
        let mut left = f64::INFINITY;
        for _ in 0..ROUNDS {
            let stations: Vec<_> =
                (0..set.stations.len()).map(|station| self.station(set, &offsets, station)).collect();
            let mut sums = vec![(0.0_f64, Vector3::zeros()); offsets.len()];
            left = 0.0;
            for (observation, flange) in set.observations.iter().zip(&self.0) {
                let station = stations[observation.station]?;
                let target = observation.target;
                let seen = observation.reading.position();
                let missing = seen - station.transform_point(&at(flange, &offsets[target]).into()).coords;
                left += missing.norm_squared();
                let turn = (station.rotation * flange.rotation).inverse();
                sums[target].0 += 1.0;
                sums[target].1 += turn * missing;
            }
            for ((offset, (count, missing)), told) in offsets.iter_mut().zip(&sums).zip(told) {
                for axis in (0..3).filter(|axis| told[*axis] && *count > 0.0) {
                    offset[axis] += missing[axis] / count;
                }
            }
        }
        left.is_finite().then_some((offsets, left))
    }

    fn station(&self, set: &MeasurementSet, offsets: &[Vector3<f64>], station: usize) -> Option<Transform> {
        let of_station = || set.observations.iter().zip(&self.0).filter(|(o, _)| o.station == station);
        let seen: Vec<_> = of_station().map(|(o, _)| o.reading.position()).collect();
        let nominal: Vec<_> = of_station().map(|(o, flange)| at(flange, &offsets[o.target])).collect();
        best_fit_transform(&seen, &nominal)
    }
}

fn at(flange: &Transform, offset: &Vector3<f64>) -> Vector3<f64> {
    flange.rotation * offset + flange.translation.vector
}

fn spread(points: &[Vector3<f64>]) -> f64 {
    let n = points.len().max(1) as f64;
    let middle = points.iter().sum::<Vector3<f64>>() / n;
    (points.iter().map(|point| (point - middle).norm_squared()).sum::<f64>() / n).sqrt()
}
