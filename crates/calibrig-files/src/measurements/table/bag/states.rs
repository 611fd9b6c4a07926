//! States of joints near points, and whether the robot moved there.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::Measured;
use crate::measurements::table::counted;

/// A change of a joint within the tolerance, rad or m, above which the robot counts as moving.
const MOVES: f64 = 1e-4;

/// A state of a joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sample {
    /// ns
    pub stamp: i64,
    /// rad or m
    pub position: f64,
    /// rad/s or m/s
    pub velocity: Option<f64>,
}

/// States near points, by joint.
#[derive(Debug, Default)]
pub(super) struct States {
    samples: BTreeMap<String, Vec<Sample>>,
    /// Names in the order of their first appearance.
    pub order: Vec<String>,
    /// Stamps of the first and the last state, ns.
    pub span: Option<(i64, i64)>,
}

impl States {
    pub fn is_first(&self, stamp: i64) -> bool {
        self.order.is_empty() || self.span == Some((stamp, stamp))
    }

    /// Records the joint, and its state if that is near a point.
    pub fn push(&mut self, name: &str, sample: Sample, is_near: bool) {
        if !self.samples.contains_key(name) {
            self.order.push(name.to_owned());
            self.samples.insert(name.to_owned(), Vec::new());
        }
        if let Some(samples) = self.samples.get_mut(name).filter(|_| is_near && sample.position.is_finite()) {
            samples.push(sample);
        }
    }

    /// Puts the states in the order of their stamps, which the rest relies on.
    pub fn sort(&mut self) {
        self.samples.values_mut().for_each(|samples| samples.sort_by_key(|sample| sample.stamp));
    }

    pub fn nearest(&self, name: &str, stamp: i64) -> Option<Sample> {
        let samples = self.samples.get(name)?;
        let after = samples.partition_point(|sample| sample.stamp < stamp);
        let before = after.checked_sub(1).and_then(|index| samples.get(index));
        let candidates = before.into_iter().chain(samples.get(after));
        candidates.min_by_key(|sample| sample.stamp.abs_diff(stamp)).copied()
    }

    /// By how much a joint changes within the tolerance about a stamp, rad or m: by its states, and by their velocity.
    pub fn change(&self, name: &str, stamp: i64, tolerance: i64) -> f64 {
        let Some(samples) = self.samples.get(name) else { return 0.0 };
        let from = samples.partition_point(|sample| sample.stamp < stamp.saturating_sub(tolerance));
        let to = samples.partition_point(|sample| sample.stamp <= stamp.saturating_add(tolerance));
        let near = samples.get(from..to).unwrap_or_default();
        let span =
            |(low, high): (f64, f64), sample: &Sample| (low.min(sample.position), high.max(sample.position));
        let (low, high) = near.iter().fold((f64::INFINITY, f64::NEG_INFINITY), span);
        let seen = if high >= low { high - low } else { 0.0 };
        // From the nearest state to the stamp itself.
        let told = self.nearest(name, stamp).and_then(|sample| {
            Some((sample.velocity? * sample.stamp.abs_diff(stamp).max(1_000_000) as f64 * 1e-9).abs())
        });
        seen.max(told.unwrap_or(0.0))
    }
}

/// Points that were measured while the robot moved.
#[derive(Debug, Default)]
pub(super) struct Moving {
    count: usize,
    last: Option<(Arc<str>, u64)>,
    /// Change and place of the fastest.
    most: Option<(f64, String)>,
}

impl Moving {
    pub fn look(&mut self, point: &Measured, change: f64) {
        if change <= MOVES {
            return;
        }
        let place = (Arc::clone(&point.topic), point.number);
        if self.last.as_ref() != Some(&place) {
            self.count += 1;
            self.last = Some(place);
        }
        if self.most.as_ref().is_none_or(|(most, _)| change > *most) {
            self.most = Some((change, point.called()));
        }
    }

    pub fn words(&self, name: &str, tolerance: f64) -> Option<String> {
        let (most, place) = self.most.as_ref()?;
        Some(format!(
            "{name}: {} measured while the robot moved: a joint changes by up to {most:.2e} rad or m within {} ms of the \
             stamp ({place}), which displaces the point by that times its distance from the axis; let the robot rest at every \
             point, or make --bag-tolerance-ms smaller",
            counted(self.count, "point"),
            1e3 * tolerance
        ))
    }
}
