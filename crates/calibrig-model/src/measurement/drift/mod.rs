//! Motion of a tracker while it measures, from base nests that it measured more than once.
//!
//! A nest that is measured again stays where it is, so changes of its readings are the tracker's own motion. The certified places play no part: their
//! errors are the same in every round and no drift. The motion is a random walk of all six degrees of freedom, whose two variances maximise the
//! restricted likelihood; it is smoothed over all rounds and interpolated to the time of each reading ([`remove_drift`]).

mod merge;
mod open;
mod random_walk;
#[cfg(test)]
mod tests;

pub use open::OpenMotion;

use std::collections::{HashMap, HashSet};

use nalgebra::{Matrix3, Matrix6, Rotation3, Vector3, Vector6};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::registration::RegistrationError;
use super::{Face, MeasurementSet, NestObservation, Reading, Station};
use crate::geometry::Transform;
use random_walk::{RandomWalk, Sighting, Smoothed};

/// Rate of false alarms of "it drifts" among stations that stand still.
pub const DRIFT_FALSE_ALARM: f64 = 0.01;
/// The same for "a nest was not where it is in the other rounds", over all readings of a station.
pub const NEST_FALSE_ALARM: f64 = 0.001;
/// Standard deviation assumed for readings without a covariance until their scatter is known, m.
const ASSUMED_SIGMA: f64 = 1e-5;
/// Motion beyond which a tracker has not drifted but was moved: the walk is linear in its turn, and loses a micrometre at 4 m from here on.
const MOST_TURN: f64 = 0.7e-3;
const MOST_MOTION: f64 = 3e-3;

/// Measurements as if every tracker stood still, and the corrections.
#[derive(Debug, Clone, PartialEq)]
pub struct Steady {
    /// Every nest once, at its mean over the rounds; readings as seen from the corresponding mean place of the tracker.
    pub measurements: MeasurementSet,
    /// One entry per station whose nests were measured more than once.
    pub stations: Vec<StationDrift>,
}

/// What the rounds of nests say about a station.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StationDrift {
    /// Its name.
    pub station: String,
    /// Different nests.
    pub nests: usize,
    /// Most readings of one nest in one face.
    pub rounds: usize,
    /// From the first to the last reading of a nest, s; zero if times are unknown.
    pub duration: f64,
    /// What was done about it.
    pub verdict: DriftVerdict,
    /// Standard deviation of the nests' readings over the stated one (over 10 µm if none is stated), between rounds and without the motion;
    /// `None` if too few were measured again.
    pub noise_ratio: Option<f64>,
    /// Readings of nests that contradict the other rounds, and were left out.
    pub contradictions: Vec<NestContradiction>,
}

/// Whether a tracker moves, by its nests.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DriftVerdict {
    /// It moved, and readings were corrected.
    Removed(DriftSize),
    /// It does not move by more than the nests scatter; nothing was corrected.
    None {
        /// Probability that a stationary tracker shows as much.
        p_value: f64,
    },
    /// Unknown from these rounds: times or enough readings are missing. Nothing was corrected.
    Unknown {
        /// What is missing.
        missing: MissingForDrift,
    },
}

/// Why rounds of nests do not determine a drift.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MissingForDrift {
    /// Some readings of the nests have no time, or all have the same time.
    Times,
    /// Too few nests were measured again.
    Readings,
}

/// How a tracker moved.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DriftSize {
    /// Largest motion of the nests' centroid between two times, m.
    pub motion: f64,
    /// Largest turn between two times, rad.
    pub turn: f64,
    /// Standard deviation of the motion along one axis after an hour, m: of the random walk.
    pub motion_per_hour: f64,
    /// The same of the turn about one axis, rad.
    pub turn_per_hour: f64,
    /// Probability that a stationary tracker shows as much.
    pub p_value: f64,
    /// RMS over the readings of the target of their correction, m.
    pub correction_rms: f64,
    /// RMS over them of the correction's own standard deviation in 3-D, m: what the rounds leave undetermined.
    pub left_rms: f64,
    /// Readings of the target before the first or after the last round, where only the walk's variance bounds the drift.
    pub outside: usize,
}

/// A nest that in one round was not where it is in the others.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NestContradiction {
    /// Its name.
    pub nest: String,
    /// When, s.
    pub time: f64,
    /// Its distance from the place in the other rounds, m.
    pub distance: f64,
    /// Probability of that by chance, times the number of readings.
    pub p_value: f64,
}

/// Rounds of nests that are inconsistent.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum DriftError {
    /// Two certified places of one nest.
    #[error(
        "station {station}: nest {nest} is certified at two places, {:.4} mm apart: give a nest that is measured again the \
         same certified place, and a different nest a different name",
        1e3 * distance
    )]
    TwoPlaces {
        /// Name of the station.
        station: String,
        /// Name of the nest.
        nest: String,
        /// m
        distance: f64,
    },
    /// A motion too large for a drift.
    #[error(
        "station {station}: by its base nests the tracker moved by {:.3} mm and {:.3} mrad between {from:.0} s and {to:.0} s, \
         too much for drift: make the readings after the move a separate station",
        1e3 * motion,
        1e3 * turn
    )]
    Moved {
        /// Name of the station.
        station: String,
        /// m
        motion: f64,
        /// rad
        turn: f64,
        /// The round before, s.
        from: f64,
        /// The round after, s.
        to: f64,
    },
    /// Nests that do not determine all six degrees of freedom.
    #[error("station {station}: {source}")]
    Nests {
        /// Name of the station.
        station: String,
        /// Why.
        source: RegistrationError,
    },
}

/// A nest in one face, with all its readings by their index in the station.
struct Seat {
    readings: Vec<usize>,
    mean: Vector3<f64>,
}

/// Finds the drift of every station whose nests were measured more than once, and removes it: readings and nests are moved to the tracker's mean
/// place over its rounds, and the remaining uncertainty is added to the covariance of each reading as if it were independent. The part that readings
/// share is [`Station::motion`].
///
/// A station whose nests were each measured once is unchanged, to the bit; so are readings of a tracker that moves by no more than its nests scatter
/// (at [`DRIFT_FALSE_ALARM`]). Deterministic, and without any knowledge of the truth.
///
/// # Errors
///
/// [`DriftError`], for nests that contradict their own certificate, lie on one line, or are seen from a tracker that was
/// moved.
pub fn remove_drift(set: &MeasurementSet) -> Result<Steady, DriftError> {
    let mut steady = Steady { measurements: set.clone(), stations: Vec::new() };
    for (index, station) in set.stations.iter().enumerate() {
        if !is_repeated(station) {
            continue;
        }
        check_places(station)?;
        let own = set.observations.iter().filter(|o| o.station == index && o.time.is_finite());
        let times: Vec<f64> = own.map(|o| o.time).collect();
        let (mut drift, motion, left_out) = drift_of(station, &times)?;
        let correction = motion.as_ref().map(|(smoothed, open)| Correction { smoothed, open });
        // The walk was judged with the noise that was found: once it is removed, the nests have that noise as well.
        let excess = drift.noise_ratio.filter(|_| motion.is_some() || scatters_more(&drift)).unwrap_or(1.0);
        let Steady { measurements, stations } = &mut steady;
        measurements.stations[index].nests = merge::merged(station, correction.as_ref(), &left_out, excess);
        if let (Some(correction), DriftVerdict::Removed(size)) = (&correction, &mut drift.verdict) {
            correct(measurements, index, correction, size);
            measurements.stations[index].motion = Some(correction.open.clone());
        }
        let tells = !matches!(drift.verdict, DriftVerdict::Unknown { .. });
        if let Some(stated) = measurements.stations[index].instrument.as_mut().filter(|_| tells) {
            // The noise found in the rounds replaces the stated one.
            stated.drift = None;
        }
        stations.push(drift);
    }
    Ok(steady)
}

/// Moves the readings of a station, and returns by how much.
fn correct(set: &mut MeasurementSet, station: usize, correction: &Correction<'_>, size: &mut DriftSize) {
    let (mut moved, mut left, mut count) = (0.0, 0.0, 0.0_f64);
    let sweeps = set.stations[station].sweeps.iter_mut();
    for observation in set.observations.iter_mut().filter(|o| o.station == station).chain(sweeps) {
        if let Some((by, variance)) = correction.apply(&mut observation.reading, observation.time) {
            moved += by.norm_squared();
            left += variance;
            count += 1.0;
            size.outside += usize::from(correction.is_outside(observation.time));
        }
    }
    size.correction_rms = (moved / count.max(1.0)).sqrt();
    size.left_rms = (left / count.max(1.0)).sqrt();
}

/// Whether a nest of the station was measured more than once.
fn is_repeated(station: &Station) -> bool {
    let mut seen = HashSet::new();
    station.nests.iter().any(|nest| !seen.insert(nest.name.as_str()))
}

fn check_places(station: &Station) -> Result<(), DriftError> {
    let mut first: HashMap<&str, &NestObservation> = HashMap::new();
    for nest in &station.nests {
        let known = first.entry(&nest.name).or_insert(nest);
        if known.in_base != nest.in_base {
            return Err(DriftError::TwoPlaces {
                station: station.name.clone(),
                nest: nest.name.clone(),
                distance: (known.in_base - nest.in_base).norm(),
            });
        }
    }
    Ok(())
}

/// Every nest in each face, in the order of their first readings.
fn seats_of(station: &Station, left_out: &[usize]) -> Vec<Seat> {
    let mut places: HashMap<(&str, Face), usize> = HashMap::new();
    let mut seats: Vec<Seat> = Vec::new();
    for (index, nest) in station.nests.iter().enumerate() {
        if left_out.contains(&index) {
            continue;
        }
        let seat = *places.entry((&nest.name, nest.reading.face())).or_insert(seats.len());
        if seat == seats.len() {
            seats.push(Seat { readings: Vec::new(), mean: Vector3::zeros() });
        }
        seats[seat].readings.push(index);
    }
    for seat in &mut seats {
        let sum: Vector3<f64> = seat.readings.iter().map(|&i| station.nests[i].reading.position()).sum();
        seat.mean = sum / seat.readings.len() as f64;
    }
    seats
}

/// Where the walk's displacements act: about the nests' centroid, turns times their radius, m, in the tracker's frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct WalkFrame {
    centre: Vector3<f64>,
    radius: f64,
}

impl WalkFrame {
    /// From the walk to the displacement (m) and the turn (rad) of what is `seen`.
    fn jacobian(&self, seen: &Vector3<f64>) -> Matrix6<f64> {
        let mut jacobian = Matrix6::identity();
        jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&-(seen - self.centre).cross_matrix());
        jacobian.fixed_columns_mut::<3>(3).scale_mut(1.0 / self.radius);
        jacobian
    }
}

type Motion = (Smoothed, OpenMotion);

/// The rounds of a station as a walk sees them.
struct Rounds {
    walk: RandomWalk,
    /// Which reading of the station each sighting is.
    which: Vec<usize>,
    frame: WalkFrame,
    /// Most readings of one nest in one face.
    most: usize,
}

/// Without the readings `left_out`; all times are zero where one is missing.
fn rounds_of(station: &Station, left_out: &[usize]) -> Result<Rounds, RegistrationError> {
    let seats = seats_of(station, left_out);
    let count = seats.len() as f64;
    let centre = seats.iter().map(|seat| seat.mean).sum::<Vector3<f64>>() / count;
    let radius = (seats.iter().map(|s| (s.mean - centre).norm_squared()).sum::<f64>() / count).sqrt();
    let places: Vec<_> = seats.iter().map(|seat| (seat.mean - centre) / radius).collect();
    let is_timed = station.nests.iter().all(|nest| nest.time.is_some());
    let mut sightings = Vec::new();
    for (index, seat) in seats.iter().enumerate() {
        for &reading in &seat.readings {
            let nest = &station.nests[reading];
            let stated = nest.reading.position_covariance();
            let noise = stated.unwrap_or_else(|| Matrix3::identity() * ASSUMED_SIGMA.powi(2));
            let time = nest.time.filter(|_| is_timed).unwrap_or(0.0);
            let off = nest.reading.position() - seat.mean;
            sightings.push((Sighting { seat: index, time, off, noise }, reading));
        }
    }
    sightings.sort_by(|(a, _), (b, _)| a.time.total_cmp(&b.time));
    let (sightings, which) = sightings.into_iter().unzip();
    Ok(Rounds {
        walk: RandomWalk::new(&places, sightings).ok_or(RegistrationError::OnOneLine)?,
        which,
        frame: WalkFrame { centre, radius },
        most: seats.iter().map(|seat| seat.readings.len()).max().unwrap_or(0),
    })
}

/// The drift of a station, its motion if it can be determined, and which readings of nests contradict the others.
/// `times` are those of the readings to correct, s.
fn drift_of(
    station: &Station,
    times: &[f64],
) -> Result<(StationDrift, Option<Motion>, Vec<usize>), DriftError> {
    let refused = |source| DriftError::Nests { station: station.name.clone(), source };
    let names: HashSet<_> = station.nests.iter().map(|nest| nest.name.as_str()).collect();
    if names.len() < 3 {
        return Err(refused(RegistrationError::TooFewNests { found: names.len() }));
    }
    let mut rounds = rounds_of(station, &[]).map_err(refused)?;
    let mut drift = StationDrift {
        station: station.name.clone(),
        nests: names.len(),
        rounds: rounds.most,
        duration: rounds.walk.span(),
        verdict: DriftVerdict::Unknown { missing: MissingForDrift::Times },
        noise_ratio: None,
        contradictions: Vec::new(),
    };
    if !(drift.duration > 0.0) {
        return Ok((drift, None, Vec::new()));
    }
    let left_out = contradicting(&rounds, station, &mut drift);
    if !left_out.is_empty() {
        // The error was in the mean places as well.
        rounds = rounds_of(station, &left_out).map_err(refused)?;
    }
    let Rounds { walk, frame, .. } = rounds;
    let around = walk.around(times);
    let (Some(still), Some(moving)) = (walk.smooth(true, &[]), walk.smooth(false, &around)) else {
        drift.verdict = DriftVerdict::Unknown { missing: MissingForDrift::Readings };
        return Ok((drift, None, left_out));
    };
    let p_value = random_walk::p_of_walk(still.deviance, moving.deviance);
    if p_value >= DRIFT_FALSE_ALARM {
        drift.noise_ratio = Some(still.noise_factor.sqrt());
        drift.verdict = DriftVerdict::None { p_value };
        return Ok((drift, None, left_out));
    }
    drift.noise_ratio = Some(moving.noise_factor.sqrt());
    drift.verdict = DriftVerdict::Removed(size_of(&moving, frame, p_value, &station.name)?);
    let open = OpenMotion::new(&moving, frame, around);
    Ok((drift, Some((moving, open)), left_out))
}

/// The readings of nests that contradict the other rounds, the worst first, until none is left or one in ten is out.
fn contradicting(rounds: &Rounds, station: &Station, drift: &mut StationDrift) -> Vec<usize> {
    let (mut walk, mut which) = (rounds.walk.clone(), rounds.which.clone());
    let mut left_out = Vec::new();
    let count = which.len() as f64;
    let limit = (NEST_FALSE_ALARM / count).ln();
    while left_out.len() < rounds.which.len() / 10 {
        let Some(told) = walk.smooth(false, &[]) else { break };
        // A wrong reading drags the walk with it: the worst candidates are compared with a walk that excludes them.
        let suspects = told.suspects().into_iter().take(3).filter(|(_, ln_p)| *ln_p < limit + 10.0_f64.ln());
        let held = suspects.filter_map(|(suspect, _)| {
            let rest = walk.without(suspect);
            let (distance, ln_p) = rest.off(&rest.smooth(false, &[])?, &walk.sightings()[suspect])?;
            (ln_p < limit).then_some((suspect, rest, distance, ln_p))
        });
        let Some((worst, rest, distance, ln_p)) = held.min_by(|a, b| a.3.total_cmp(&b.3)) else { break };
        let reading = which.remove(worst);
        let nest = &station.nests[reading];
        drift.contradictions.push(NestContradiction {
            nest: nest.name.clone(),
            time: nest.time.unwrap_or(0.0),
            distance,
            p_value: (ln_p.exp() * count).min(1.0),
        });
        left_out.push(reading);
        walk = rest;
    }
    left_out
}

fn size_of(told: &Smoothed, frame: WalkFrame, p_value: f64, station: &str) -> Result<DriftSize, DriftError> {
    let motion_of =
        |xi: Vector6<f64>| (xi.fixed_rows::<3>(0).norm(), xi.fixed_rows::<3>(3).norm() / frame.radius);
    for pair in told.knots.windows(2) {
        let (motion, turn) = motion_of(pair[1].mean - pair[0].mean);
        if motion > MOST_MOTION || turn > MOST_TURN {
            let (from, to) = (pair[0].time, pair[1].time);
            return Err(DriftError::Moved { station: station.to_owned(), motion, turn, from, to });
        }
    }
    // Over the ends of all chords through the first and the farthest point: the span, up to a small factor, in linear time.
    let farthest = |from: &Vector6<f64>, turns: bool| {
        let size = |knot: &random_walk::Knot| {
            let (motion, turn) = motion_of(knot.mean - from);
            if turns { turn } else { motion }
        };
        let far = told.knots.iter().max_by(|a, b| size(a).total_cmp(&size(b)));
        far.map_or((*from, 0.0), |knot| (knot.mean, size(knot)))
    };
    let span = |turns: bool| {
        let start = told.knots.first().map_or_else(Vector6::zeros, |knot| knot.mean);
        let (end, _) = farthest(&start, turns);
        farthest(&end, turns).1
    };
    let (motion, turn) = (span(false), span(true));
    if motion > MOST_MOTION || turn > MOST_TURN {
        let (from, to) =
            (told.knots.first().map_or(0.0, |k| k.time), told.knots.last().map_or(0.0, |k| k.time));
        return Err(DriftError::Moved { station: station.to_owned(), motion, turn, from, to });
    }
    let after_an_hour = told.rates.map(|rate| (3600.0 * rate).sqrt());
    Ok(DriftSize {
        motion,
        turn,
        motion_per_hour: after_an_hour[0],
        turn_per_hour: after_an_hour[1] / frame.radius,
        p_value,
        correction_rms: 0.0,
        left_rms: 0.0,
        outside: 0,
    })
}

/// Whether the nests scatter by more than their readings state, beyond what chance explains.
fn scatters_more(drift: &StationDrift) -> bool {
    // The scatter of a variance ratio with so many repeats, and three and a half times that.
    let again = (drift.rounds.saturating_sub(1) * drift.nests).max(1) as f64;
    drift.noise_ratio.is_some_and(|ratio| ratio.powi(2) > 1.0 + 3.5 * (2.0 / (3.0 * again)).sqrt())
}

/// Moves readings to the tracker's mean place over its rounds.
struct Correction<'a> {
    smoothed: &'a Smoothed,
    open: &'a OpenMotion,
}

impl Correction<'_> {
    fn is_outside(&self, time: f64) -> bool {
        let knots = &self.smoothed.knots;
        let (first, last) = (knots.first(), knots.last());
        first.is_none_or(|knot| time < knot.time) || last.is_none_or(|knot| time > knot.time)
    }

    /// The transform that takes a point as seen at a time to where it would have been seen.
    fn at(&self, time: f64) -> Option<Transform> {
        let (xi, _) = self.smoothed.at(time)?;
        let WalkFrame { centre, radius } = self.open.frame();
        let turn = Rotation3::new(xi.fixed_rows::<3>(3) / radius);
        let shift = xi.fixed_rows::<3>(0);
        // seen = centre + turn (still - centre) + shift
        Some(Transform::from_parts((centre + shift - turn * centre).into(), turn).inverse())
    }

    /// Moves a reading and adds the correction's remaining uncertainty to its covariance. Returns the displacement, m, and the trace of
    /// the added covariance, m²; `None` if the time is not a finite number.
    fn apply(&self, reading: &mut Reading, time: f64) -> Option<(Vector3<f64>, f64)> {
        let still_from_seen = self.at(time)?;
        let seen = reading.position();
        let position = still_from_seen.rotation * seen + still_from_seen.translation.vector;
        let open = self.open.covariance((time, &position), (time, &position));
        let added: Matrix3<f64> = open.fixed_view::<3, 3>(0, 0).into_owned();
        match reading {
            Reading::Spherical(reading) => merge::move_spherical(reading, &position, &added),
            Reading::Cartesian { position: at, covariance: stated } => {
                *at = position;
                *stated = stated.map(|stated| stated + added);
            }
            Reading::Pose(pose) => {
                pose.position = position;
                pose.rotation = still_from_seen.rotation * pose.rotation;
                pose.covariance = pose.covariance.map(|stated| stated + open);
            }
        }
        Some((position - seen, added.trace()))
    }
}
