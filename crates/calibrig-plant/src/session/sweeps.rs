//! Readings while single joints move and all others rest at home, from which circle point analysis places the stations.

use super::controller::Controller;
use super::measure::{Setup, Taken, Visit};
use super::schedule::Schedule;
use super::{Machine, MeasuringSession, MissingReading, SessionError, StationShare};
use crate::effects::Warmth;
use calibrig_model::measurement::Station;
use calibrig_model::random::{self, StreamSource};

/// Place of the sweeps in the random streams of a session, behind those of sets, pose test and visits.
const PLACE: u64 = 1 << 46;

/// A joint that is moved alone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlannedSweep {
    /// Index of the joint.
    pub joint: usize,
    /// From one value of its variable to the other, m or rad.
    pub range: [f64; 2],
    /// Equidistant places at which the first target is read, by every station that sees it.
    pub places: u32,
}

impl PlannedSweep {
    /// Joint variables at its places, with the others `at`.
    pub(super) fn poses(&self, at: &[f64]) -> Vec<Vec<f64>> {
        let step = (self.range[1] - self.range[0]) / f64::from(self.places.saturating_sub(1).max(1));
        let place = |number: u32| {
            let mut joints = at.to_vec();
            if let Some(joint) = joints.get_mut(self.joint) {
                *joint = self.range[0] + step * f64::from(number);
            }
            joints
        };
        (0..self.places).map(place).collect()
    }
}

impl MeasuringSession<'_> {
    /// Adds the readings in the sweeps to the stations. Returns which readings are missing, and the drives' heat afterwards.
    pub(super) fn measure_sweeps<M: Machine>(
        &self,
        machine: &mut M,
        setup: &Setup,
        schedule: &Schedule,
        stations: &mut [Station],
    ) -> Result<(Vec<MissingReading>, Warmth), SessionError<M::Error>> {
        let (seed, trial) = (setup.seed, setup.trial);
        let mut noise = random::stream(seed, trial, StreamSource::SweepNoise);
        let mut controller = Controller::at_home(self, Warmth::default());
        let mut taken = Taken::default();
        machine.carry(None).map_err(|source| SessionError::Sweep { place: 0, source })?;
        for ((joints, time), number) in schedule.sweeps.iter().zip(0..) {
            let command = self.actuators.command_from_joints(joints);
            let place = PLACE | u64::from(number);
            let mut own = random::stream_at(seed, trial, StreamSource::Repeatability, place);
            let (settled, effects) = controller
                .go_to(machine, &command, *time, &mut own)
                .map_err(|source| SessionError::Sweep { place: number, source })?;
            let visit = Visit {
                command: &command,
                controller: &controller,
                pose: number,
                place,
                time: *time,
                payload: None,
                settled,
                effects,
                share: StationShare::All,
            };
            self.read(setup, &visit, &mut noise, &mut taken);
        }
        for reading in taken.observations.into_iter().filter(|reading| reading.target == 0) {
            if let Some(station) = stations.get_mut(reading.station) {
                station.sweeps.push(reading);
            }
        }
        taken.missing.retain(|missing| missing.target == 0);
        Ok((taken.missing, controller.warmth().clone()))
    }
}
