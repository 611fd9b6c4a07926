//! Moves readings, and merges readings of one nest.

use std::collections::HashMap;

use nalgebra::{Matrix3, Vector3};

use super::super::{Face, NestObservation, Reading, SphericalReading, Station};
use super::Correction;

/// Derivative of range, azimuth and elevation by the position; `None` on the standing axis, where the azimuth has none.
fn spherical_by_position(position: &Vector3<f64>) -> Option<Matrix3<f64>> {
    let range = position.norm();
    let level = position.x.hypot(position.y);
    if !(level > 0.0) {
        return None;
    }
    let (x, y, z) = (position.x, position.y, position.z);
    let row = |v: Vector3<f64>| v.transpose();
    Some(Matrix3::from_rows(&[
        row(position / range),
        row(Vector3::new(-y, x, 0.0) / level.powi(2)),
        row(Vector3::new(-x * z / level, -y * z / level, level) / range.powi(2)),
    ]))
}

/// `angle` of the turn that holds `near`.
fn unwrapped(angle: f64, near: f64) -> f64 {
    let turn = std::f64::consts::TAU;
    angle + turn * ((near - angle) / turn).round()
}

fn spherical(position: &Vector3<f64>, near_azimuth: f64) -> [f64; 3] {
    let azimuth = unwrapped(position.y.atan2(position.x), near_azimuth);
    [position.norm(), azimuth, position.z.atan2(position.x.hypot(position.y))]
}

/// Moves a reading to `position` (m) and adds `added` (m²) to its covariance.
pub(super) fn move_spherical(reading: &mut SphericalReading, position: &Vector3<f64>, added: &Matrix3<f64>) {
    [reading.range, reading.azimuth, reading.elevation] = spherical(position, reading.azimuth);
    if let (Some(stated), Some(jacobian)) = (&mut reading.covariance, spherical_by_position(position)) {
        *stated += jacobian * added * jacobian.transpose();
    }
}

/// One observation per nest (and per face, if something is known about the instrument, whose errors differ by face): the mean of its readings as
/// seen from the tracker's mean place. `excess` is the standard deviation over the stated one.
pub(super) fn merged(
    station: &Station,
    correction: Option<&Correction<'_>>,
    left_out: &[usize],
    excess: f64,
) -> Vec<NestObservation> {
    let by_face = station.instrument.is_some();
    let mut groups: Vec<Vec<&NestObservation>> = Vec::new();
    let mut places: HashMap<(&str, Option<Face>), usize> = HashMap::new();
    for (index, nest) in station.nests.iter().enumerate() {
        if left_out.contains(&index) {
            continue;
        }
        let key = (nest.name.as_str(), by_face.then(|| nest.reading.face()));
        let group = *places.entry(key).or_insert(groups.len());
        if group == groups.len() {
            groups.push(Vec::new());
        }
        groups[group].push(nest);
    }
    groups.iter().filter_map(|group| mean_of(group, correction, excess, by_face)).collect()
}

fn mean_of(
    group: &[&NestObservation],
    correction: Option<&Correction<'_>>,
    excess: f64,
    by_face: bool,
) -> Option<NestObservation> {
    let first = *group.first()?;
    if group.len() == 1 && correction.is_none() {
        return Some(NestObservation { time: None, ..first.clone() });
    }
    // Both faces have the same weight, however often each was measured: their errors are opposite.
    let faces: Vec<Vec<&NestObservation>> = [Face::Front, Face::Back, Face::Both]
        .into_iter()
        .map(|face| group.iter().copied().filter(|nest| nest.reading.face() == face).collect::<Vec<_>>())
        .filter(|own| !own.is_empty())
        .collect();
    let (mut position, mut covariance) = (Vector3::zeros(), Some(Matrix3::zeros()));
    for own in &faces {
        let weight = 1.0 / (own.len() * faces.len()) as f64;
        for nest in own {
            let seen = nest.reading.position();
            let still = correction.and_then(|c| c.at(nest.time?));
            position += weight * still.map_or(seen, |t| t.rotation * seen + t.translation.vector);
            let own = nest.reading.position_covariance();
            covariance = covariance.zip(own).map(|(sum, own)| sum + own * (weight * excess.max(1.0)).powi(2));
        }
    }
    let reading = match &first.reading {
        Reading::Spherical(read) => {
            let [range, azimuth, elevation] = spherical(&position, read.azimuth);
            let jacobian = spherical_by_position(&position);
            let covariance = covariance.zip(jacobian).map(|(c, j)| j * c * j.transpose());
            let face = if by_face || faces.len() == 1 { read.face } else { Face::Both };
            Reading::Spherical(SphericalReading { range, azimuth, elevation, covariance, face })
        }
        Reading::Cartesian { .. } | Reading::Pose(_) => Reading::Cartesian { position, covariance },
    };
    Some(NestObservation { reading, time: None, ..first.clone() })
}
