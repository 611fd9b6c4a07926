//! Where in their files observations stand.

use super::rows::Place;

/// The place of every observation of a set. Observations of neighbouring rows take no room of their own.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Places {
    files: Vec<String>,
    runs: Vec<Run>,
    count: usize,
}

/// Observations whose rows follow each other.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Run {
    /// Index of the first.
    first: usize,
    file: usize,
    place: Place,
}

impl Places {
    /// Adds the place of the next observation.
    pub(super) fn push(&mut self, file: &str, place: &Place) {
        let is_same_file = self.files.last().is_some_and(|known| known == file);
        if !is_same_file {
            self.files.push(file.to_owned());
        }
        let follows = is_same_file
            && self
                .runs
                .last()
                .is_some_and(|run| run.place.further((self.count - run.first) as u64) == *place);
        if !follows {
            self.runs.push(Run { first: self.count, file: self.files.len() - 1, place: place.clone() });
        }
        self.count += 1;
    }

    fn find(&self, observation: usize) -> Option<(&str, Place)> {
        let run = &self.runs[self.runs.partition_point(|run| run.first <= observation).checked_sub(1)?];
        (observation < self.count)
            .then(|| (self.files[run.file].as_str(), run.place.further((observation - run.first) as u64)))
    }

    /// File and row of an observation: `m.csv:17`; `None` if it comes from no file.
    pub fn of(&self, observation: usize) -> Option<String> {
        self.find(observation).map(|(file, place)| place.of(file))
    }

    /// Those of the observations with these indices, in this order.
    #[must_use]
    pub fn select(&self, observations: impl IntoIterator<Item = usize>) -> Self {
        let mut selected = Self::default();
        for (file, place) in observations.into_iter().filter_map(|observation| self.find(observation)) {
            selected.push(file, &place);
        }
        selected
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_those_that_were_pushed() {
        let mut places = Places::default();
        let lines = [("a.csv", 2), ("a.csv", 3), ("a.csv", 5), ("b.csv", 6), ("b.csv", 7)];
        for (file, line) in lines {
            places.push(file, &Place::Line(line));
        }
        let of = |places: &Places| (0..6).filter_map(|index| places.of(index)).collect::<Vec<_>>();
        assert_eq!(of(&places), ["a.csv:2", "a.csv:3", "a.csv:5", "b.csv:6", "b.csv:7"]);
        assert_eq!(places.runs.len(), 3);
        assert_eq!(of(&places.select([0, 2, 4])), ["a.csv:2", "a.csv:5", "b.csv:7"]);
    }
}
