//! Checks whether measurements can belong to this robot at all, before anything is identified.
//!
//! The nominal robot is fitted to the points by the tracker's place and the target's offset alone. The residual is compared with the points'
//! spread about their mean: a robot that explains nothing leaves all of it, one that is off by a centimetre leaves a hundredth. Where it is
//! large, or a point stands out, [`diagnosis`](crate::diagnosis) looks for an explanation.

mod fit;
#[cfg(test)]
mod tests;

use nalgebra::Vector3;

use crate::diagnosis::{Diagnosis, Finding, Part, diagnose_with};
use crate::identification::IdentifyError;
use crate::kinematics::{flange, nominal_joints};
use calibrig_model::measurement::{MeasurementSet, Reading};
use calibrig_model::{CalibrationModel, JointKind};
use fit::Points;

/// Largest share of the points' spread that the nominal robot may leave. Robots that are off by several per cent of their size are badly drawn but
/// can be fitted; exchanged rows, wrong units, signs and offsets leave a third to all.
pub const LARGEST_SHARE: f64 = 0.25;
/// Share from which on an explanation is sought.
const SUSPICIOUS: f64 = 0.02;
/// Multiple of the median distance from which on a point is examined.
const STANDS_OUT: f64 = 6.0;
/// Share of the robot's length within which points count as a single one.
const NO_MOTION: f64 = 1e-5;
/// How far beyond its limits a command must be to be reported, as a share of the travel.
const BEYOND: f64 = 0.02;

/// How the nominal robot fits measured points.
#[derive(Debug, Clone, PartialEq)]
pub struct Plausibility {
    /// Number of observations that were examined.
    pub observations: usize,
    /// RMS distance of the points from the nominal robot, with the tracker's place and the targets' offsets fitted, m; `None` where these explain any
    /// measurement.
    pub rms: Option<f64>,
    /// This RMS as a share of the points' spread, corrected for the remaining degrees of freedom: one where the robot explains nothing.
    pub share: Option<f64>,
    /// RMS distance of the points from their mean, m.
    pub spread: f64,
    /// Points that no pose of the robot reaches; they are not included in the other figures.
    pub unreachable: Vec<FarOff>,
    /// Explanation of the residual, where it is large or a point stands out.
    pub diagnosis: Option<Diagnosis>,
    /// Commands beyond the joints' limits.
    pub beyond_limits: Vec<BeyondLimits>,
}

/// A point that is not where the others would have it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FarOff {
    /// Index of the observation in its set.
    pub observation: usize,
    /// Distance from where the robot is, or, for a point out of its reach, from the middle of the others, m.
    pub distance: f64,
}

/// Commands of a joint beyond its limits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BeyondLimits {
    /// Which joint, from zero.
    pub joint: usize,
    /// Smallest and largest command, m or rad.
    pub reached: [f64; 2],
    /// Limits of the joint, m or rad.
    pub limits: [f64; 2],
}

impl Plausibility {
    /// Whether it makes sense to fit. With a `robust` loss, a few bad rows do not matter.
    pub fn is_plausible(&self, robust: bool) -> bool {
        let explained = self.explanation().map_or(&[][..], |parts| parts);
        let is_few = |part: &Part| match part {
            Part::GrossErrors { .. } => true,
            Part::ExchangedRows { .. } => robust,
            _ => false,
        };
        let without = self.first_rms().filter(|_| robust && !explained.is_empty());
        let share = without.map(|rms| rms / self.spread.max(f64::MIN_POSITIVE)).or(self.share);
        // All readings are of one pose, whose scatter is the whole spread.
        let still = self.diagnosis.as_ref().is_some_and(Diagnosis::is_of_no_motion);
        self.unreachable.is_empty()
            && explained.iter().all(is_few)
            && (share.is_none_or(|share| share <= LARGEST_SHARE) || still)
    }

    /// What was read wrongly, if something explains the points.
    pub fn explanation(&self) -> Option<&[Part]> {
        let diagnosis = self.diagnosis.as_ref()?;
        let first = diagnosis.hypotheses.first()?;
        (diagnosis.finding() == Finding::Explained).then_some(&first.parts)
    }

    fn first_rms(&self) -> Option<f64> {
        Some(self.diagnosis.as_ref()?.hypotheses.first()?.rms)
    }
}

/// Fits the nominal robot to `set`, and looks for an explanation where it does not fit.
///
/// # Errors
///
/// [`IdentifyError`], where model and set do not belong together.
pub fn plausibility(model: &CalibrationModel, set: &MeasurementSet) -> Result<Plausibility, IdentifyError> {
    plausibility_with(model, set, |_, _| {})
}

/// Like [`plausibility`]; where an explanation is sought, `progress` is given the steps done and their total.
///
/// # Errors
///
/// As [`plausibility`].
pub fn plausibility_with(
    model: &CalibrationModel,
    set: &MeasurementSet,
    progress: impl FnMut(u64, u64),
) -> Result<Plausibility, IdentifyError> {
    model.check()?;
    set.check(model.kinematics.joint_count())?;
    let unreachable = unreachable(model, set);
    let kept: Vec<usize> =
        (0..set.observations.len()).filter(|i| unreachable.iter().all(|far| far.observation != *i)).collect();
    let points = points_of(model, set).part(&kept);
    let mut found = Plausibility {
        observations: set.observations.len(),
        rms: None,
        share: None,
        spread: points.spread(),
        unreachable,
        diagnosis: None,
        beyond_limits: beyond_limits(model, set),
    };
    // Points that coincide say nothing of the robot.
    if found.spread <= NO_MOTION * model.kinematics.characteristic_length() {
        return Ok(found);
    }
    let placed = match points.nearest() {
        Some(placed) if points.rms(&placed).is_none_or(|rms| points.share(rms) <= SUSPICIOUS) => placed,
        _ => points.best(true),
    };
    let Some(rms) = points.rms(&placed) else { return Ok(found) };
    let share = points.share(rms);
    (found.rms, found.share) = (Some(rms), Some(share));
    let looks_odd = share > SUSPICIOUS || stands_out(points.lengths(&placed), found.spread);
    if looks_odd || !found.unreachable.is_empty() {
        found.diagnosis = Some(diagnose_with(model, set, progress)?);
    }
    Ok(found)
}

/// Whether a length is far larger than most, and not small against the points' spread.
fn stands_out(mut lengths: Vec<f64>, spread: f64) -> bool {
    let largest = lengths.iter().copied().fold(0.0, f64::max);
    lengths.retain(|length| length.is_finite());
    largest > (STANDS_OUT * median(lengths)).max(0.5 * SUSPICIOUS * spread)
}

/// Flange of the nominal robot, and where the tracker saw its target.
fn points_of(model: &CalibrationModel, set: &MeasurementSet) -> Points {
    let mut joints = vec![0.0; model.kinematics.joint_count()];
    let mut points = Points {
        offsets: set.targets.iter().map(|target| target.in_flange).collect(),
        stations: set.stations.len(),
        ..Points::default()
    };
    for observation in &set.observations {
        // A four-bar that does not close is reported where the pose is fitted.
        let _ = nominal_joints(model, &observation.command, &mut joints);
        points.flange.push(flange(&model.kinematics, &joints));
        points.seen.push(observation.reading.position());
        points.station.push(observation.station);
        points.target.push(observation.target);
    }
    points
}

/// Points that are farther from the middle of the others than twice the robot's reach, and points at the tracker's own place: codes of missed
/// shots. As the offset of a target may be unknown, the span of the other points is added.
pub(crate) fn unreachable(model: &CalibrationModel, set: &MeasurementSet) -> Vec<FarOff> {
    let reach = reach(model) + set.targets.iter().map(|t| t.in_flange.norm()).fold(0.0, f64::max);
    let mut far = Vec::new();
    for station in 0..set.stations.len() {
        let own = set.observations.iter().enumerate().filter(|(_, o)| o.station == station);
        let own: Vec<(usize, Vector3<f64>)> = own.map(|(i, o)| (i, o.reading.position())).collect();
        if own.is_empty() {
            continue;
        }
        let middle =
            Vector3::from_fn(|axis, _| median(own.iter().map(|(_, seen)| seen[axis]).collect::<Vec<_>>()));
        let distance = |seen: &Vector3<f64>| (seen - middle).norm();
        let limit = 2.0 * reach + 6.0 * median(own.iter().map(|(_, seen)| distance(seen)).collect());
        let is_origin = |i: usize| matches!(set.observations[i].reading, Reading::Cartesian { position, .. } if position == Vector3::zeros());
        let out = own.iter().filter(|(i, seen)| distance(seen) > limit || is_origin(*i));
        far.extend(out.map(|(i, seen)| FarOff { observation: *i, distance: distance(seen) }));
    }
    far
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

/// Upper bound of the distance of the flange from the first moving axis, m.
fn reach(model: &CalibrationModel) -> f64 {
    let length = |(index, link): (usize, &calibrig_model::CraigLink)| match link.kind {
        JointKind::Prismatic => link.a.hypot(link.d.abs() + link.limits[0].abs().max(link.limits[1].abs())),
        // Lengths in front of the first axis are not moved.
        JointKind::Revolute if index == 0 => 0.0,
        JointKind::Revolute => link.a.hypot(link.d),
    };
    let links: f64 = model.kinematics.links.iter().enumerate().map(length).sum();
    links + model.kinematics.last_from_flange.translation.vector.norm()
}

/// Commands of a set, which must belong to the robot, that are clearly beyond the limits of its joints.
pub fn beyond_limits(model: &CalibrationModel, set: &MeasurementSet) -> Vec<BeyondLimits> {
    let mut joints = vec![0.0; model.kinematics.joint_count()];
    let mut reached = vec![[f64::INFINITY, f64::NEG_INFINITY]; joints.len()];
    for observation in &set.observations {
        model.actuators.joints_from_command(&observation.command, &mut joints);
        for ([low, high], value) in reached.iter_mut().zip(&joints) {
            (*low, *high) = (low.min(*value), high.max(*value));
        }
    }
    let beyond = reached.into_iter().zip(&model.kinematics.links).enumerate();
    beyond
        .filter_map(|(joint, (reached, link))| {
            let slack = BEYOND * (link.limits[1] - link.limits[0]).abs();
            let out = reached[0] < link.limits[0] - slack || reached[1] > link.limits[1] + slack;
            out.then_some(BeyondLimits { joint, reached, limits: link.limits })
        })
        .collect()
}
