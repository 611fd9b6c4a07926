//! Repeats of a pose: the same command, payload, station and target more than once.

use std::collections::HashMap;
use std::f64::consts::{PI, TAU};

use nalgebra::{Matrix3, Matrix6, Rotation3, Vector3};

use super::LoadedMeasurements;
use crate::input::InputError;
use calibrig_model::Payload;
use calibrig_model::geometry::rotation_vector;
use calibrig_model::measurement::{Face, Observation, PoseReading, Reading, SphericalReading};

/// Largest difference between commands of one pose, m or rad.
pub(super) const SAME_COMMAND: f64 = 1e-3;

/// Fewest degrees of freedom from which a scatter gives a standard deviation.
const ENOUGH: usize = 6;

/// Station, target, approach, the payload, and the face if readings of both are kept apart.
type Reached<'a> = (usize, usize, &'a [i8], Option<[u64; 7]>, Face);

/// Observations that are of one pose, station and target, in the order of their first ones; those of both faces in one group, or apart.
pub(super) fn groups(
    observations: &[Observation],
    numbers_poses: bool,
    with_both_faces: bool,
) -> Vec<Vec<usize>> {
    let mut groups: Vec<Vec<usize>> = Vec::new();
    // From another side a machine with play goes elsewhere: that is not scatter.
    let mut known: HashMap<(u32, Reached<'_>), usize> = HashMap::new();
    let mut by_command: HashMap<(Vec<u64>, Reached<'_>), usize> = HashMap::new();
    // If no column has the poses, or every row has its own number, equal commands show which rows are repeats.
    let face = |o: &Observation| if with_both_faces { Face::Front } else { o.reading.face() };
    let numbers: std::collections::HashSet<_> =
        observations.iter().map(|o| (o.pose, o.station, o.target, face(o))).collect();
    let are_rows = !numbers_poses || numbers.len() == observations.len();
    for (index, o) in observations.iter().enumerate() {
        let next = groups.len();
        let payload = o.payload.as_ref().map(Payload::bits);
        let reached: Reached<'_> = (o.station, o.target, &o.approach, payload, face(o));
        let group = if are_rows {
            let command = o.command.iter().map(|v| v.to_bits()).collect();
            *by_command.entry((command, reached)).or_insert(next)
        } else {
            *known.entry((o.pose, reached)).or_insert(next)
        };
        if group == next {
            groups.push(Vec::new());
        }
        groups[group].push(index);
    }
    groups
}

/// Replaces the repeats of a pose (the same number, station, target, approach and payload) by their mean, with their scatter if they state no
/// uncertainty: pooled over all poses and axes, over the square root of the number of repeats.
///
/// # Errors
/// Errors if commands of one pose differ.
pub(super) fn average(loaded: &mut LoadedMeasurements, numbers_poses: bool) -> Result<(), InputError> {
    let observations = &loaded.set.observations;
    let groups = groups(observations, numbers_poses, false);
    let repeated = groups.iter().filter(|group| group.len() > 1).count();
    if repeated == 0 {
        loaded.remarks.push(
            "no pose is measured more than once, so there is nothing to average: use repeats = \"keep\""
                .to_owned(),
        );
        return Ok(());
    }
    let (mut squares, mut free) = (0.0, 0);
    for group in &groups {
        let mean = mean_of(group.iter().map(|index| observations[*index].reading.position()));
        squares +=
            group.iter().map(|i| (observations[*i].reading.position() - mean).norm_squared()).sum::<f64>();
        free += group.len() - 1;
    }
    let variance = squares / (3 * free) as f64;
    let mut averaged = Vec::with_capacity(groups.len());
    let mut kept = vec![false; observations.len()];
    for group in &groups {
        let members: Vec<&Observation> = group.iter().map(|index| &observations[*index]).collect();
        check_commands(loaded, group)?;
        kept[group[0]] = true;
        averaged.push(mean_observation(&members, (3 * free >= ENOUGH).then_some(variance)));
    }
    let readings = observations.len();
    let scatter = 1e3 * (squares / free as f64).sqrt();
    let stated = averaged.iter().all(|o| o.reading.position_covariance().is_some());
    loaded.keep(&kept);
    let averaged_are_poses = averaged.iter().any(|o| matches!(o.reading, Reading::Pose(_)));
    loaded.set.observations = averaged;
    loaded.remarks.push(format!(
        "{readings} readings are averaged to {}: {repeated} poses are repeated, and their readings scatter by {scatter:.4} mm (RMS in 3-D, \
         {free} repeats){}",
        loaded.set.observations.len(),
        match averaged_are_poses {
            _ if stated => "",
            true => "; full poses without a stated uncertainty stay without one, because this says nothing about rotations",
            false => "; too few to estimate an uncertainty from",
        },
    ));
    Ok(())
}

fn mean_of(positions: impl Iterator<Item = Vector3<f64>>) -> Vector3<f64> {
    let (sum, count) = positions.fold((Vector3::zeros(), 0.0), |(sum, count), p| (sum + p, count + 1.0));
    sum / f64::max(count, 1.0)
}

pub(super) fn check_commands(loaded: &LoadedMeasurements, group: &[usize]) -> Result<(), InputError> {
    let first = &loaded.set.observations[group[0]];
    for index in group {
        let other = &loaded.set.observations[*index];
        let apart = first.command.iter().zip(&other.command).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        if apart > SAME_COMMAND {
            let at = |index: usize| loaded.places.of(index).unwrap_or_default();
            return Err(InputError::Place {
                place: at(*index),
                message: format!(
                    "pose {} has other commands than in {}, by up to {apart:.4} (m or rad): they are not repeats",
                    other.pose,
                    at(group[0])
                ),
                help: Some(
                    "expected the same commands in all rows of a pose; or repeats = \"keep\"".to_owned(),
                ),
            });
        }
    }
    Ok(())
}

/// The mean of repeats; `scatter` is the variance of one reading along each axis, if known.
fn mean_observation(members: &[&Observation], scatter: Option<f64>) -> Observation {
    let mut mean = members[0].clone();
    // Scatter is that of positions.
    if let Reading::Spherical(reading @ SphericalReading { covariance: None, .. }) = &mean.reading {
        mean.reading = Reading::Cartesian { position: reading.position(), covariance: None };
    }
    let count = members.len() as f64;
    for (joint, value) in mean.command.iter_mut().enumerate() {
        *value = members.iter().map(|o| o.command[joint]).sum::<f64>() / count;
    }
    if members.len() == 1 {
        if let Reading::Cartesian { covariance: covariance @ None, .. } = &mut mean.reading {
            *covariance = scatter.map(|variance| Matrix3::identity() * variance);
        }
        return mean;
    }
    if members.iter().any(|o| o.approach != mean.approach) {
        mean.approach.fill(0);
    }
    if members.iter().any(|o| o.since_reversal.len() != mean.since_reversal.len()) {
        mean.since_reversal.clear();
    }
    for (joint, way) in mean.since_reversal.iter_mut().enumerate() {
        *way = members.iter().map(|o| o.since_reversal[joint]).sum::<f64>() / count;
    }
    mean.time = members.iter().map(|o| o.time).sum::<f64>() / count;
    let temperatures: Option<Vec<f64>> = members.iter().map(|o| o.temperature).collect();
    mean.temperature = temperatures.map(|temperatures| temperatures.iter().sum::<f64>() / count);
    mean.reading = match (spherical(members), full_pose(members)) {
        (Some(reading), _) => Reading::Spherical(reading),
        (None, Some(pose)) => Reading::Pose(Box::new(pose)),
        (None, None) => {
            let position = mean_of(members.iter().map(|o| o.reading.position()));
            let stated: Option<Vec<_>> = members.iter().map(|o| o.reading.position_covariance()).collect();
            let stated = stated.map(|all| all.iter().sum::<Matrix3<f64>>() / (count * count));
            let covariance = stated.or(scatter.map(|variance| Matrix3::identity() * (variance / count)));
            Reading::Cartesian { position, covariance }
        }
    };
    mean
}

/// The mean of spherical readings, angle by angle; `None` if a reading is of another kind, or states no uncertainty.
fn spherical(members: &[&Observation]) -> Option<SphericalReading> {
    let readings: Vec<&SphericalReading> = members
        .iter()
        .map(|o| match &o.reading {
            Reading::Spherical(reading) => Some(reading),
            Reading::Cartesian { .. } | Reading::Pose(_) => None,
        })
        .collect::<Option<_>>()?;
    let (first, count) = (*readings.first()?, readings.len() as f64);
    let stated: Option<Vec<Matrix3<f64>>> = readings.iter().map(|r| r.covariance).collect();
    let covariance = stated?.iter().sum::<Matrix3<f64>>();
    let mean = |of: &dyn Fn(&SphericalReading) -> f64| readings.iter().map(|r| of(r)).sum::<f64>() / count;
    // Angles of one direction may be a turn apart.
    let near = |angle: f64| first.azimuth + (angle - first.azimuth + PI).rem_euclid(TAU) - PI;
    Some(SphericalReading {
        range: mean(&|r| r.range),
        azimuth: mean(&|r| near(r.azimuth)),
        elevation: mean(&|r| r.elevation),
        covariance: Some(covariance / (count * count)),
        face: first.face,
    })
}

/// The mean of full poses; `None` if a reading is of another kind. Its uncertainty is that of the readings over the root of their number,
/// if all state one: the scatter of positions says nothing about rotations.
fn full_pose(members: &[&Observation]) -> Option<PoseReading> {
    let poses: Vec<&PoseReading> = members
        .iter()
        .map(|o| match &o.reading {
            Reading::Pose(pose) => Some(&**pose),
            Reading::Cartesian { .. } | Reading::Spherical(_) => None,
        })
        .collect::<Option<_>>()?;
    let count = poses.len() as f64;
    let stated: Option<Vec<Matrix6<f64>>> = poses.iter().map(|pose| pose.covariance).collect();
    let first = poses.first()?.rotation;
    // Repeats differ so little that the mean of the rotation vectors between them is that of the rotations.
    let apart = poses.iter().map(|pose| rotation_vector(&(pose.rotation * first.inverse())));
    let mean = apart.sum::<Vector3<f64>>() / count;
    Some(PoseReading {
        position: mean_of(poses.iter().map(|pose| pose.position)),
        rotation: Rotation3::new(mean) * first,
        covariance: stated.map(|all| all.iter().sum::<Matrix6<f64>>() / (count * count)),
    })
}
