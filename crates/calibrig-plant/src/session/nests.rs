//! The base nests, measured from every station in every round.

use nalgebra::{Matrix3, Vector3};
use rand::Rng;

use super::schedule::{Round, Schedule};
use super::{MeasuringSession, SessionError};
use crate::tracker::{LaserTracker, Shot, Smr};
use calibrig_model::measurement::{Face, NestObservation, Reading, SphericalReading, Station};
use calibrig_model::random::{StreamSource, stream, stream_at};
use calibrig_model::visibility::{Stance, stance_at};

/// Place in the stream of reflectors of the one used for the nests: after all that can be on a flange.
const OF_NESTS: u64 = 1 << 16;

impl MeasuringSession<'_> {
    /// Every station with all its readings of nests, in the order of time.
    pub(super) fn measure_nests<E>(
        &self,
        trackers: &[LaserTracker],
        schedule: &Schedule,
        (seed, trial): (u64, u32),
    ) -> Result<Vec<Station>, SessionError<E>> {
        let mut rng = stream(seed, trial, StreamSource::NestNoise);
        let smr = self.smr();
        let mut seating = stream_at(seed, trial, StreamSource::Smr, OF_NESTS);
        let smr = smr.map_or(Smr::PERFECT, |law| law.draw(&mut seating));
        let mut certified: Vec<NestObservation> = Vec::new();
        let names = std::iter::once("1").chain(self.plan.stations.iter().map(|s| s.name.as_str()));
        let mut stations = Vec::new();
        for (index, (name, tracker)) in names.zip(trackers).enumerate() {
            let mut nests = Vec::new();
            for (number, round) in schedule.rounds.iter().enumerate() {
                let (links, flange) = stance_at(&self.as_built.kinematics, &round.joints);
                let stance = Stance { links: &links, flange: &flange };
                for (place, (nest, in_base)) in self.nests.iter().enumerate() {
                    if index == 0 && number == 0 {
                        let own = self.certify(nest, in_base, &mut rng);
                        certified.push(own);
                    }
                    let turns = if self.plan.rounds.two_faces { 2 } else { 1 };
                    for (turn, face) in [Face::Front, Face::Back].into_iter().take(turns).enumerate() {
                        let shot = self.shot(round, turns * place + turn, face);
                        let seen = in_base + self.seated(&smr, tracker, in_base, &mut seating);
                        let reading = tracker
                            .measure(&seen, &shot, &mut rng)
                            .map_err(|source| SessionError::Nest { nest: nest.clone(), source })?;
                        let tracker_at = tracker.tracker_from_base.inverse().translation.vector;
                        let sight = self.plan.sight.as_ref();
                        if sight.is_none_or(|s| s.obstacles.free(stance, &tracker_at, in_base).is_ok()) {
                            let time = self.plan.rounds.timed.then_some(shot.time);
                            let reading = Reading::Spherical(self.with_seat(reading));
                            nests.push(NestObservation { reading, time, ..certified[place].clone() });
                        }
                    }
                }
            }
            let stated = tracker.stated();
            let states = !stated.sigmas.is_empty() || stated.drift.is_some();
            let instrument = states.then_some(stated);
            stations.push(Station {
                name: name.to_owned(),
                nests,
                instrument,
                motion: None,
                sweeps: Vec::new(),
            });
        }
        Ok(stations)
    }

    fn shot(&self, round: &Round, number: usize, face: Face) -> Shot {
        if !self.plan.rounds.timed {
            return Shot { face, averaging: self.plan.timing.averaging, ..Shot::default() };
        }
        let time = round.time + self.plan.timing.nest * number as f64;
        Shot { face, averaging: self.plan.timing.averaging, ..Shot::at(time) }
    }

    /// A nest with the error of its certificate; its reading follows.
    fn certify(&self, name: &str, place: &Vector3<f64>, rng: &mut impl Rng) -> NestObservation {
        let sigma = self.nest_sigma;
        // The optical centre of the nests' reflector has the same error in every round: more readings do not separate it from the certificate.
        let centring = self.tracker.conditions.smr.as_ref().map_or(0.0, |law| law.centring_sigma);
        NestObservation {
            name: name.to_owned(),
            in_base: place + self.error_vector(sigma, rng),
            in_base_covariance: Matrix3::identity() * (sigma.powi(2) + centring.powi(2)),
            reading: Reading::Cartesian { position: Vector3::zeros(), covariance: None },
            time: None,
        }
    }

    /// The same, with the stated uncertainty of seating a reflector in a nest, each time anew.
    fn with_seat(&self, mut reading: SphericalReading) -> SphericalReading {
        let variance = self.tracker.conditions.smr.as_ref().map_or(0.0, |law| law.seat_sigma.powi(2));
        let flat = reading.range * reading.elevation.cos();
        let seat = Vector3::new(1.0, flat.powi(-2), reading.range.powi(-2)) * variance;
        reading.covariance = reading.covariance.map(|own| own + Matrix3::from_diagonal(&seat));
        reading
    }

    /// Displacement of the reflector's optical centre from the nest's place, m.
    fn seated(
        &self,
        smr: &Smr,
        tracker: &LaserTracker,
        in_base: &Vector3<f64>,
        rng: &mut impl Rng,
    ) -> Vector3<f64> {
        if self.smr().is_none() {
            return Vector3::zeros();
        }
        let to_tracker = tracker.tracker_from_base.inverse().translation.vector - in_base;
        smr.seat(rng) + smr.offset_towards(&to_tracker)
    }

    /// Times at which nests are read, s.
    pub(super) fn nest_times(&self, schedule: &Schedule) -> Vec<f64> {
        let turns = if self.plan.rounds.two_faces { 2 } else { 1 };
        let of_round =
            |round| (0..turns * self.nests.len()).map(move |k| self.shot(round, k, Face::Front).time);
        schedule.rounds.iter().flat_map(of_round).collect()
    }
}
