//! Readings of both faces: their angles, and their pairs.
//!
//! In the back face a tracker's head is turned by half a turn and its telescope is turned over, so that its encoders show azimuth + 180° and
//! 360° - zenith of the same point. Most of an instrument's errors turn over with it: half the difference of the two readings is their size,
//! and the mean is free of them.

use std::f64::consts::{PI, TAU};

use super::{LoadedMeasurements, repeats};
use crate::input::InputError;
use calibrig_model::measurement::{Face, Observation, Reading, SphericalReading};

/// Places that are named of several.
const MOST_PLACES: usize = 3;

/// What the rows of one file show about the faces.
#[derive(Debug, Default)]
pub(super) struct Faces {
    /// Whether angles of the back face are the encoders' own, and the first row that shows it.
    pub back: Option<(bool, String)>,
    /// Whether that was found from the values.
    is_found: bool,
    /// Readings beyond the zenith in a file that does not name faces, and the first of them.
    beyond: Option<(u64, String)>,
}

/// What one row shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum FaceSeen {
    Nothing,
    Front,
    /// A reading beyond the zenith, and no column with faces.
    Beyond,
    Back {
        is_raw: bool,
        is_found: bool,
    },
}

impl Faces {
    pub fn note(&mut self, seen: FaceSeen, place: impl Fn() -> String) {
        match seen {
            FaceSeen::Nothing | FaceSeen::Front => {}
            FaceSeen::Beyond => self.beyond.get_or_insert_with(|| (0, place())).0 += 1,
            FaceSeen::Back { is_raw, is_found } => {
                self.is_found |= is_found;
                self.back.get_or_insert_with(|| (is_raw, place()));
            }
        }
    }

    pub fn remarks(&self, file: &str) -> Vec<String> {
        let mut remarks = Vec::new();
        if let Some((is_raw, place)) = self.back.as_ref().filter(|_| self.is_found) {
            remarks.push(if *is_raw {
                format!(
                    "{file}: back-face angles are the encoders' own, as {place} shows (a zenith beyond 180°): they are \
                     converted to the direction of the point"
                )
            } else {
                format!("{file}: back-face angles are those of the point, as {place} shows (a zenith up to 180°)")
            });
        }
        if let Some((count, place)) = &self.beyond {
            remarks.push(format!(
                "{place}: an elevation beyond 90° (a zenith beyond 180°), as a tracker shows in its back face, in {count} \
                 rows: the points are right, but are treated as front-face readings; name the faces with [face] of a column \
                 map"
            ));
        }
        remarks
    }
}

/// Reports back-face readings without a front face; replaces each pair by its mean if asked for.
///
/// # Errors
/// Errors if the mean is asked for: a back-face reading without a front face; rows of one pose whose commands differ.
pub(super) fn pair(
    loaded: &mut LoadedMeasurements,
    numbers_poses: bool,
    is_averaged: bool,
) -> Result<(), InputError> {
    let observations = &loaded.set.observations;
    if !observations.iter().any(|o| o.reading.face() == Face::Back) {
        if is_averaged {
            loaded
                .remarks
                .push("no reading is of the back face, so there are no two faces to average: use faces = \"keep\" or \
                       measure both faces".to_owned());
        }
        return Ok(());
    }
    let (mut pairs, mut alone) = (Vec::new(), Vec::new());
    for group in repeats::groups(observations, numbers_poses, true) {
        let of = |face: Face| group.iter().copied().filter(move |i| observations[*i].reading.face() == face);
        let mut fronts = of(Face::Front);
        for back in of(Face::Back) {
            match fronts.next() {
                Some(front) => pairs.push([front, back]),
                None => alone.push(back),
            }
        }
    }
    if let Some(first) = alone.first().copied() {
        let place = |index: &usize| loaded.places.of(*index).unwrap_or_default();
        let pose = observations[first].pose;
        if is_averaged {
            return Err(InputError::Place {
                place: place(&first),
                message: format!("pose {pose} was read in the back face, but not in the front face"),
                help: Some(
                    "expected, for each back-face reading, a front-face reading of the same pose, station and target; or \
                     faces = \"keep\"".to_owned(),
                ),
            });
        }
        let places: Vec<_> = alone.iter().take(MOST_PLACES).map(place).collect();
        let more = match alone.len() - places.len() {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        loaded.remarks.push(format!(
            "{}{more}: read in the back face, but not in the front face: the instrument errors that both faces would average \
             out stay in",
            places.join(", ")
        ));
    }
    if is_averaged {
        average(loaded, &pairs)?;
    }
    Ok(())
}

fn average(loaded: &mut LoadedMeasurements, pairs: &[[usize; 2]]) -> Result<(), InputError> {
    let mut kept = vec![true; loaded.set.observations.len()];
    let mut squares = 0.0;
    for pair in pairs {
        repeats::check_commands(loaded, pair)?;
        let [front, back] = pair.map(|index| &loaded.set.observations[index]);
        squares += (front.reading.position() - back.reading.position()).norm_squared();
        let mean = mean(front, back);
        kept[pair[1]] = false;
        loaded.set.observations[pair[0]] = mean;
    }
    let fronts = kept.iter().filter(|kept| **kept).count();
    loaded.keep(&kept);
    let apart = 1e3 * (squares / pairs.len().max(1) as f64).sqrt();
    let alone = match fronts - pairs.len() {
        0 => String::new(),
        alone => format!("; {alone} readings are of the front face only"),
    };
    loaded.remarks.push(format!(
        "{} pairs of both faces are averaged: their readings differ by {apart:.4} mm (RMS in 3-D), twice the error of one \
         face{alone}",
        pairs.len()
    ));
    Ok(())
}

/// The mean of a reading of each face, angle by angle: errors that turn over with the face cancel in it.
fn mean(front: &Observation, back: &Observation) -> Observation {
    let mut mean = front.clone();
    mean.time = f64::midpoint(front.time, back.time);
    mean.temperature = front.temperature.zip(back.temperature).map(|(a, b)| f64::midpoint(a, b));
    if let (Reading::Spherical(a), Reading::Spherical(b)) = (&front.reading, &back.reading) {
        // Angles of one direction may be a turn apart.
        let near = a.azimuth + (b.azimuth - a.azimuth + PI).rem_euclid(TAU) - PI;
        mean.reading = Reading::Spherical(SphericalReading {
            range: f64::midpoint(a.range, b.range),
            azimuth: f64::midpoint(a.azimuth, near),
            elevation: f64::midpoint(a.elevation, b.elevation),
            covariance: a.covariance.zip(b.covariance).map(|(a, b)| (a + b) / 4.0),
            face: Face::Both,
        });
    }
    mean
}
