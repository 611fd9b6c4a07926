//! Who sees which target of the machine at rest.

use nalgebra::{Rotation3, Unit, Vector3};

use super::MeasuringSession;
use super::plan::StationShare;
use crate::SettledPose;
use crate::tracker::{LaserTracker, Limits, Smr, SmrLaw};
use calibrig_model::random::{StreamSource, stream_at};
use calibrig_model::visibility::{Hidden, Reflector, Stance, TrackerReach};

/// A target on the flange, with the reflector that it has in this session.
pub(super) struct Mounted {
    reflector: Reflector,
    smr: Option<Smr>,
}

/// A target's place in the base frame, m.
#[derive(Debug, Clone, Copy)]
pub(super) struct TargetPlace {
    /// Of the sphere's centre, which is what is calibrated.
    pub centre: Vector3<f64>,
    /// Of the optical centre, which is what is seen.
    pub optical: Vector3<f64>,
}

/// The trackers' views of a pose.
pub(super) struct Seen {
    /// One per target.
    pub places: Vec<TargetPlace>,
    /// The reasons, one list per station, one entry per target; `None` if visible.
    pub hidden: Vec<Vec<Option<Hidden>>>,
    /// From every station to the first target, m.
    ranges: Vec<f64>,
}

impl MeasuringSession<'_> {
    /// The reflectors' errors, if readings have errors at all.
    pub(super) fn smr(&self) -> Option<&SmrLaw> {
        self.tracker.conditions.smr.as_ref().filter(|_| self.tracker.instrument.noise)
    }

    /// The targets with the reflectors of (seed, trial).
    pub(super) fn mounted(&self, seed: u64, trial: u32) -> Vec<Mounted> {
        let first = std::iter::once((self.as_built.target, self.plan.opening));
        let further = self.plan.targets.iter().map(|target| (target.in_flange, target.opening));
        let acceptance = self.plan.sight.as_ref().map_or(std::f64::consts::PI, |sight| sight.acceptance);
        let smr = |place| {
            let law = self.smr()?;
            Some(law.draw(&mut stream_at(seed, trial, StreamSource::Smr, place)))
        };
        let mount = |((in_flange, opening), place)| Mounted {
            reflector: Reflector { in_flange, opening, acceptance },
            smr: smr(place),
        };
        first.chain(further).zip(0..).map(mount).collect()
    }

    /// What the trackers see of the machine at rest.
    pub(super) fn look(&self, trackers: &[LaserTracker], mounted: &[Mounted], settled: &SettledPose) -> Seen {
        let last = settled.links.last().copied().unwrap_or_default();
        let flange = last * self.as_built.kinematics.last_from_flange;
        let stance = Stance { links: &settled.links, flange: &flange };
        let places: Vec<_> = mounted
            .iter()
            .enumerate()
            .map(|(target, mount)| {
                let centre = match target {
                    0 => settled.target,
                    _ => flange.rotation * mount.reflector.in_flange + flange.translation.vector,
                };
                let offset = mount.smr.map_or_else(Vector3::zeros, |smr| {
                    let axis = mount.reflector.opening.unwrap_or(Unit::new_unchecked(Vector3::z()));
                    let turned = Rotation3::rotation_between(&Vector3::x(), &axis).unwrap_or_else(|| {
                        Rotation3::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI)
                    });
                    smr.offset(&(flange.rotation * turned))
                });
                TargetPlace { centre, optical: centre + offset }
            })
            .collect();
        let hidden = trackers
            .iter()
            .map(|tracker| {
                let Some(sight) = &self.plan.sight else { return vec![None; mounted.len()] };
                let Limits { range, azimuth, elevation, .. } = tracker.instrument.limits;
                let reach = TrackerReach { range, elevation, azimuth };
                let base_from_tracker = tracker.tracker_from_base.inverse();
                let look = |mount: &Mounted| {
                    sight.obstacles.look(&base_from_tracker, &reach, stance, &mount.reflector).err()
                };
                mounted.iter().map(look).collect()
            })
            .collect();
        let distance = |tracker: &LaserTracker| {
            (tracker.tracker_from_base.inverse().translation.vector - settled.target).norm()
        };
        Seen { places, hidden, ranges: trackers.iter().map(distance).collect() }
    }
}

impl Seen {
    /// The stations that read this pose.
    pub(super) fn chosen(&self, share: StationShare) -> Vec<usize> {
        let stations = 0..self.hidden.len();
        match share {
            StationShare::All => stations.collect(),
            StationShare::Best => {
                let hidden = |station: &usize| self.hidden[*station].iter().flatten().count();
                let best = stations.min_by(|a, b| {
                    hidden(a).cmp(&hidden(b)).then(self.ranges[*a].total_cmp(&self.ranges[*b]))
                });
                best.into_iter().collect()
            }
        }
    }
}
