//! Which wrong convention explains points that the nominal robot does not lie on: each is tried, and told with what it leaves.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::Vector3;

use super::fit::Points;
use super::{Convention, Explanation, points_of};
use calibrig_model::measurement::MeasurementSet;
use calibrig_model::{CalibrationModel, JointKind};

/// Observations that a convention is tried on.
const TRIED: usize = 100;
/// A convention that explains something leaves less than this share of what the points left without it.
const EXPLAINS: f64 = 0.2;
/// And less than this share of the points' spread.
const FITS: f64 = 0.1;
/// So many times what the best convention leaves, another one does as well.
const ALIKE: f64 = 1.5;
/// A whole turn read in the other unit: commands in rad read as degrees span less, commands in degrees read as rad span more.
const TURN: f64 = 2.0 * PI;
/// Units of a length, seen from another one.
const LENGTHS: [f64; 4] = [1e3, 1e-3, 25.4, 1.0 / 25.4];
/// Offsets under one target's name that are told apart.
const MOST_TARGETS: usize = 3;
/// A target needs as many observations before it is taken for several.
const LEAST_OF_TARGET: usize = 10;

/// The conventions that explain the points, best first; `share` of their spread is what they leave without any.
pub(super) fn explanations(model: &CalibrationModel, set: &MeasurementSet, share: f64) -> Vec<Explanation> {
    let step = set.observations.len().div_ceil(TRIED).max(1);
    let part = MeasurementSet {
        observations: set.observations.iter().step_by(step).cloned().collect(),
        ..set.clone()
    };
    let limit = FITS.min(EXPLAINS * share);
    let mut found: Vec<(f64, Explanation)> = candidates(model, &part)
        .into_iter()
        .filter_map(|convention| {
            // What shifts rows against each other needs all of them in their order.
            let whole = matches!(convention, Convention::ShiftedRows { .. });
            let changed = convention.applied(model, if whole { set } else { &part })?;
            let points = points_of(model, &changed);
            let rms = points.rms(&points.best(false))?;
            let left = points.share(rms);
            (left < limit).then_some((left, Explanation { convention, rms }))
        })
        .chain(several_targets(&points_of(model, &part), limit))
        .collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    // Others that do nearly as well could be meant as well; a worse one only resembles it.
    let least = found.first().map_or(0.0, |best| best.0);
    found.into_iter().filter(|(left, _)| *left <= ALIKE * least).map(|(_, explanation)| explanation).collect()
}

fn candidates(model: &CalibrationModel, set: &MeasurementSet) -> Vec<Convention> {
    let links = &model.kinematics.links;
    let joints = || 0..links.len();
    let revolute = |joint: &usize| links[*joint].kind == JointKind::Revolute;
    let span = |joint: usize| {
        let commands = set.observations.iter().filter_map(|o| o.command.get(joint).copied());
        let (low, high) = commands.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (v.min(l), v.max(h)));
        high - low
    };
    let mut candidates = Vec::new();
    if joints().filter(revolute).all(|joint| span(joint) < TURN.to_radians()) {
        candidates.push(Convention::RadiansAsDegrees);
    }
    if joints().filter(revolute).any(|joint| span(joint) > TURN) {
        candidates.push(Convention::DegreesAsRadians);
    }
    candidates.extend(LENGTHS.map(|factor| Convention::PointsScaled { factor }));
    if joints().any(|joint| links[joint].kind == JointKind::Prismatic) {
        candidates.extend(LENGTHS.map(|factor| Convention::TravelScaled { factor }));
    }
    candidates.push(Convention::Mirrored);
    candidates.extend([-1, 1].map(|by| Convention::ShiftedRows { by }));
    for joint in joints() {
        if revolute(&joint) {
            candidates
                .extend([FRAC_PI_2, -FRAC_PI_2, PI].map(|angle| Convention::HomeOffset { joint, angle }));
        }
        candidates.push(Convention::Sign { joint });
        candidates.extend((joint + 1..links.len()).map(|other| Convention::Columns { joint, other }));
    }
    candidates
}

impl Convention {
    /// The measurements as they would be read by it.
    fn applied(&self, model: &CalibrationModel, set: &MeasurementSet) -> Option<MeasurementSet> {
        let mut set = set.clone();
        let kinds: Vec<_> = model.kinematics.links.iter().map(|link| link.kind).collect();
        let scale = |set: &mut MeasurementSet, kind: JointKind, factor: f64| {
            for observation in &mut set.observations {
                let own = observation.command.iter_mut().zip(&kinds).filter(|(_, own)| **own == kind);
                own.for_each(|(command, _)| *command *= factor);
            }
        };
        let commands = |set: &mut MeasurementSet, change: &dyn Fn(&mut Vec<f64>)| {
            set.observations.iter_mut().for_each(|observation| change(&mut observation.command));
        };
        match *self {
            Self::RadiansAsDegrees => scale(&mut set, JointKind::Revolute, 1.0_f64.to_degrees()),
            Self::DegreesAsRadians => scale(&mut set, JointKind::Revolute, 1.0_f64.to_radians()),
            Self::TravelScaled { factor } => scale(&mut set, JointKind::Prismatic, factor),
            Self::HomeOffset { joint, angle } => commands(&mut set, &|command| command[joint] += angle),
            Self::Sign { joint } => commands(&mut set, &|command| command[joint] = -command[joint]),
            Self::Columns { joint, other } => commands(&mut set, &|command| command.swap(joint, other)),
            Self::PointsScaled { factor } => set.move_points(|seen| factor * seen),
            Self::Mirrored => set.move_points(|seen| Vector3::new(seen.y, seen.x, seen.z)),
            Self::ShiftedRows { by } => {
                let n = set.observations.len();
                let shifted: Vec<_> = (0..n)
                    .filter_map(|i| {
                        let other = set.observations.get(i.checked_add_signed(by)?)?;
                        let mut observation = set.observations[i].clone();
                        (observation.reading, observation.target) = (other.reading.clone(), other.target);
                        Some(observation)
                    })
                    .collect();
                set.observations = shifted;
            }
            Self::SeveralTargets { .. } => return None,
        }
        Some(set)
    }
}

trait MovePoints {
    /// Writes Cartesian readings in the place of all, moved.
    fn move_points(&mut self, change: impl Fn(Vector3<f64>) -> Vector3<f64>);
}

impl MovePoints for MeasurementSet {
    fn move_points(&mut self, change: impl Fn(Vector3<f64>) -> Vector3<f64>) {
        for observation in &mut self.observations {
            let position = change(observation.reading.position());
            observation.reading =
                calibrig_model::measurement::Reading::Cartesian { position, covariance: None };
        }
    }
}

/// Whether the observations of one target are of several, at offsets of their own: clusters of what the residuals are in the flange's
/// frame, fitted and assigned in turn (k-means). The fewest that leave less than the share `limit` of the points' spread.
fn several_targets(points: &Points, limit: f64) -> Vec<(f64, Explanation)> {
    let one = points.best(false);
    let mut found = Vec::new();
    for target in 0..points.offsets.len() {
        let own: Vec<usize> = (0..points.len()).filter(|i| points.target[*i] == target).collect();
        if own.len() < LEAST_OF_TARGET {
            continue;
        }
        for count in 2..=MOST_TARGETS {
            let (mut split, mut placed) = (points.clone(), one.clone());
            let seeds = seeds(&own.iter().map(|i| one.in_flange(points, *i)).collect::<Vec<_>>(), count);
            let mut places = vec![target];
            for seed in &seeds[1..] {
                places.push(split.offsets.len());
                split.offsets.push(points.offsets[target] + seed);
                placed = placed.with_another_target(target);
                *placed.offset_mut(*places.last().unwrap_or(&target)) += seed;
            }
            *placed.offset_mut(target) += seeds[0];
            for _ in 0..15 {
                for &i in &own {
                    let length = |place: &usize| {
                        let mut other = split.part(&[i]);
                        other.target[0] = *place;
                        other.residual(&placed, 0).norm()
                    };
                    let nearest = places.iter().min_by(|a, b| length(a).total_cmp(&length(b)));
                    split.target[i] = nearest.copied().unwrap_or(target);
                }
                placed = split.fit(placed, &vec![1.0; split.len()]);
            }
            let mut sizes: Vec<_> =
                places.iter().map(|place| split.target.iter().filter(|t| *t == place).count()).collect();
            sizes.sort_unstable();
            let rms = split.rms(&placed).filter(|rms| sizes[0] > 2 && split.share(*rms) < limit);
            if let Some(rms) = rms {
                let convention = Convention::SeveralTargets { target, count };
                found.push((split.share(rms), Explanation { convention, rms }));
                break;
            }
        }
    }
    found
}

/// As many of the points, far from each other: the one farthest from the mean, then in turn the one farthest from those before.
fn seeds(points: &[Vector3<f64>], count: usize) -> Vec<Vector3<f64>> {
    let mean = points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
    let mut seeds: Vec<Vector3<f64>> = Vec::new();
    for _ in 0..count {
        let distance = |point: &Vector3<f64>| {
            let from_seeds = seeds.iter().map(|seed| (point - seed).norm());
            if seeds.is_empty() { (point - mean).norm() } else { from_seeds.fold(f64::INFINITY, f64::min) }
        };
        let farthest = points.iter().max_by(|a, b| distance(a).total_cmp(&distance(b)));
        seeds.push(farthest.copied().unwrap_or(mean));
    }
    seeds
}
