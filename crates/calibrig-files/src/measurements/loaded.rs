//! What measurement files hold.

use std::collections::HashMap;

use super::places::Places;
use calibrig_model::measurement::MeasurementSet;

/// What a measurement file holds, or several that are one set.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LoadedMeasurements {
    /// The observations. Stations have no nests; targets are at the flange's origin without a stated uncertainty: the file does
    /// not state these, the caller must.
    pub set: MeasurementSet,
    /// Rows that were left out: number of the pose, and why.
    pub dropped: Vec<(u32, String)>,
    /// Whether the file names the station of every row; without, there is one with a default name.
    pub names_stations: bool,
    /// The same of targets.
    pub names_targets: bool,
    /// File and row of every observation.
    pub places: Places,
    /// Names of the poses 1, 2 and so on, if the file has names instead of numbers.
    pub pose_names: Vec<String>,
    /// Remarks on the files, in words.
    pub remarks: Vec<String>,
    /// Which observations are held out; empty if none is.
    pub held_out: Vec<bool>,
    /// The same of what was dropped.
    pub held_out_dropped: Vec<bool>,
}

impl LoadedMeasurements {
    /// Whether some rows are of the verification set.
    pub fn has_held_out(&self) -> bool {
        self.held_out.contains(&true)
    }

    /// The identification set and the verification set, which the file or the map separates.
    #[must_use]
    pub fn split(mut self) -> (Self, Self) {
        let held_out = std::mem::take(&mut self.held_out);
        let held_out_dropped = std::mem::take(&mut self.held_out_dropped);
        let is_held = |held: &[bool], index: usize| held.get(index).copied().unwrap_or(false);
        let mut other = Self {
            names_stations: self.names_stations,
            names_targets: self.names_targets,
            pose_names: self.pose_names.clone(),
            ..Self::default()
        };
        other.set.stations.clone_from(&self.set.stations);
        other.set.targets.clone_from(&self.set.targets);
        let count = self.set.observations.len();
        other.places = self.places.select((0..count).filter(|index| is_held(&held_out, *index)));
        self.places = self.places.select((0..count).filter(|index| !is_held(&held_out, *index)));
        let observations = std::mem::take(&mut self.set.observations).into_iter().enumerate();
        for (index, observation) in observations {
            let set = if is_held(&held_out, index) { &mut other.set } else { &mut self.set };
            set.observations.push(observation);
        }
        for (index, dropped) in std::mem::take(&mut self.dropped).into_iter().enumerate() {
            let set = if is_held(&held_out_dropped, index) { &mut other } else { &mut self };
            set.dropped.push(dropped);
        }
        self.keep_measured();
        other.keep_measured();
        (self, other)
    }

    /// Leaves out stations and targets that no observation has.
    fn keep_measured(&mut self) {
        let set = &mut self.set;
        let (mut stations, mut targets) = (HashMap::new(), HashMap::new());
        for observation in &mut set.observations {
            let next = stations.len();
            observation.station = *stations.entry(observation.station).or_insert(next);
            let next = targets.len();
            observation.target = *targets.entry(observation.target).or_insert(next);
        }
        set.stations = in_order(&stations, &set.stations);
        set.targets = in_order(&targets, &set.targets);
    }

    pub(super) fn drop_row(&mut self, pose: u32, why: String, held_out: bool) {
        self.dropped.push((pose, why));
        mark(&mut self.held_out_dropped, self.dropped.len(), held_out);
    }

    /// Says of the last observation whether it is held out.
    pub(super) fn hold_out_last(&mut self, held_out: bool) {
        mark(&mut self.held_out, self.set.observations.len(), held_out);
    }

    /// Keeps the observations of these indices, in their order.
    pub(crate) fn keep(&mut self, kept: &[bool]) {
        let is_kept = |index: usize| kept.get(index).copied().unwrap_or(true);
        self.places = self.places.select((0..self.set.observations.len()).filter(|index| is_kept(*index)));
        retain(&mut self.set.observations, is_kept);
        retain(&mut self.held_out, is_kept);
    }

    /// File and row of the first observation that is of this kind.
    pub(crate) fn place_where(
        &self,
        is_it: impl Fn(&calibrig_model::measurement::Observation) -> bool,
    ) -> Option<String> {
        self.set.observations.iter().position(is_it).and_then(|index| self.places.of(index))
    }
}

fn retain<T>(items: &mut Vec<T>, is_kept: impl Fn(usize) -> bool) {
    let mut index = 0;
    items.retain(|_| {
        index += 1;
        is_kept(index - 1)
    });
}

/// Notes `held_out` of the last of `count` rows; nothing as long as none is.
fn mark(marks: &mut Vec<bool>, count: usize, held_out: bool) {
    if held_out || !marks.is_empty() {
        marks.resize(count.saturating_sub(1), false);
        marks.push(held_out);
    }
}

/// The items at old places, by their new ones.
fn in_order<T: Clone>(new_places: &HashMap<usize, usize>, items: &[T]) -> Vec<T> {
    let mut places: Vec<_> = new_places.iter().map(|(old, new)| (*new, *old)).collect();
    places.sort_unstable();
    places.into_iter().filter_map(|(_, old)| items.get(old).cloned()).collect()
}
