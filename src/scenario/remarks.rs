//! Scenarios that can be simulated but differ from any real session.

use nalgebra::Vector3;

use super::Scenario;
use calibrig_model::geometry::Transform;
use calibrig_model::visibility::stance_at;
use calibrig_plant::tracker::acceptance::draw_and_test;

/// Number of instruments that are tested.
const TESTED: u32 = 50;
/// Trackers closer than this are at the same place, m.
const APART: f64 = 1e-3;

/// How many instruments of this kind pass their acceptance test.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Passing {
    /// So many pass ...
    pub passed: u32,
    /// ... of so many.
    pub tested: u32,
}

impl Scenario {
    /// For an instrument without systematic errors, which no session draws again, how many pass; `None` for others, and if the test's places are out
    /// of its reach.
    pub fn passing(&self) -> Option<Passing> {
        let instrument = &self.tracker.instrument;
        if !instrument.noise || instrument.systematic_fraction > 0.0 {
            return None;
        }
        let mut passed = 0;
        for trial in 0..TESTED {
            passed += u32::from(draw_and_test(instrument, self.seed, trial, 0).ok()?.1.passes());
        }
        Some(Passing { passed, tested: TESTED })
    }

    /// Remarks before the session is simulated, in sentences.
    pub fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        if let Some(Passing { passed, tested }) = self.passing()
            && 10 * passed < 9 * tested
        {
            remarks.push(format!(
                "the instrument of [tracker] has only random errors, and of {tested} such instruments {passed} pass their own \
                 acceptance test: it is simulated nevertheless; real ones scatter by about an eighth of the permissible error \
                 (random_fraction = 0.125), and their readings share the rest (systematic_fraction = 0.2); `calibrig \
                 tracker-acceptance` shows the test"
            ));
        }
        if self.probe.is_some() && !self.plan.targets.is_empty() {
            remarks.push(
                "[tracker.pose] together with [[session.target]]: the first target gives full poses and the others give \
                 points; they are identified together, but `calibrig export csv` writes readings of one kind, and refuses a \
                 recording of both"
                    .to_owned(),
            );
        }
        remarks.extend(self.stations_in_one_place());
        remarks.extend(self.stations_without_the_target());
        remarks
    }

    /// Names of the stations, with their places.
    fn stations(&self) -> Vec<(&str, &Transform)> {
        let further = self.plan.stations.iter().map(|s| (s.name.as_str(), &s.tracker_from_base));
        std::iter::once(("1", &self.tracker.tracker_from_base)).chain(further).collect()
    }

    fn stations_in_one_place(&self) -> Vec<String> {
        let stations = self.stations();
        let place = |tracker_from_base: &Transform| tracker_from_base.inverse().translation.vector;
        let mut remarks = Vec::new();
        for (k, (name, own)) in stations.iter().enumerate() {
            for (before, other) in &stations[..k] {
                let apart = (place(own) - place(other)).norm();
                if apart < APART {
                    remarks.push(format!(
                        "stations \"{before}\" and \"{name}\" are at the same place, {:.3} mm apart: two trackers cannot \
                         stand there, and both would see the same",
                        1e3 * apart
                    ));
                }
            }
        }
        remarks
    }

    fn stations_without_the_target(&self) -> Vec<String> {
        let (_, flange) = stance_at(&self.as_built.kinematics, &self.region.centre);
        let target: Vector3<f64> = flange.rotation * self.as_built.target + flange.translation.vector;
        let limits = &self.tracker.instrument.limits;
        let remark = |(name, tracker_from_base): (&str, &Transform)| {
            let seen = tracker_from_base.rotation * target + tracker_from_base.translation.vector;
            let why = limits.reaches(&seen).err()?;
            Some(format!(
                "station \"{name}\" does not see the target with the robot in the middle of its working region: {why}"
            ))
        };
        self.stations().into_iter().filter_map(remark).collect()
    }
}
