//! Poses listed by number, by runs of numbers, or by name.

use std::collections::BTreeSet;

/// A list of poses: numbers, runs of numbers such as `41..60`, and names.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct PoseList {
    runs: Vec<[u32; 2]>,
    names: Vec<String>,
}

impl PoseList {
    /// Adds `7`, `41..60`, `41-60` or a name.
    ///
    /// # Errors
    /// A run that ends before it begins, or an empty text; what was expected.
    pub fn add(&mut self, text: &str) -> Result<(), &'static str> {
        let text = text.trim();
        if text.is_empty() {
            return Err("the number of a pose, a range such as 41..60, or a name");
        }
        if let Ok(number) = text.parse() {
            self.runs.push([number, number]);
            return Ok(());
        }
        let run = text.split_once("..").or(text.split_once('-'));
        match run.map(|(first, last)| (first.trim().parse(), last.trim().parse())) {
            Some((Ok(first), Ok(last))) if first <= last => self.runs.push([first, last]),
            Some((Ok(_), Ok(_))) => return Err("a range from the smaller number to the larger one"),
            _ => self.names.push(text.to_owned()),
        }
        Ok(())
    }

    /// Reads a list with commas: `41..60,75`.
    ///
    /// # Errors
    /// As [`PoseList::add`].
    pub fn parse(text: &str) -> Result<Self, &'static str> {
        let mut list = Self::default();
        text.split(',').try_for_each(|part| list.add(part))?;
        Ok(list)
    }

    /// Whether it lists nothing.
    pub fn is_empty(&self) -> bool {
        self.runs.is_empty() && self.names.is_empty()
    }

    /// Whether it lists the pose of this number and, where poses have names, of this name.
    pub fn has(&self, number: u32, name: Option<&str>) -> bool {
        match name {
            Some(name) => self.names.iter().any(|known| known == name) || self.has_number_in(name),
            None => self.runs.iter().any(|[first, last]| (*first..=*last).contains(&number)),
        }
    }

    /// Listed entries that these poses lack: ranges of numbers, and names. If poses have `names`, those count, not their numbers.
    pub(super) fn absent(&self, numbers: impl Iterator<Item = u32>, names: &[String]) -> Vec<String> {
        let there: BTreeSet<u32> = if names.is_empty() {
            numbers.collect()
        } else {
            names.iter().filter_map(|name| name.parse().ok()).collect()
        };
        let gap = |first: u32, last: u32| {
            if first == last { first.to_string() } else { format!("{first}..{last}") }
        };
        let mut absent = Vec::new();
        for [first, last] in &self.runs {
            let mut next = Some(*first);
            for found in there.range(first..=last) {
                if let Some(from) = next.filter(|from| from < found) {
                    absent.push(gap(from, found - 1));
                }
                next = found.checked_add(1);
            }
            absent.extend(next.filter(|from| from <= last).map(|from| gap(from, *last)));
        }
        absent.extend(self.names.iter().filter(|name| !names.contains(name)).cloned());
        absent
    }

    /// Adds the entries of another list.
    pub(super) fn extend(&mut self, other: &Self) {
        self.runs
            .extend(other.runs.iter().filter(|run| !self.runs.contains(run)).copied().collect::<Vec<_>>());
        self.names.extend(
            other.names.iter().filter(|name| !self.names.contains(name)).cloned().collect::<Vec<_>>(),
        );
    }

    /// A name that is a number in the list, as `P7` is not.
    fn has_number_in(&self, name: &str) -> bool {
        name.parse().is_ok_and(|number| self.has(number, None))
    }
}
