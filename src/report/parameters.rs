//! Estimates beside the truth, where it is known.

use nalgebra::{Rotation3, Vector3, Vector6};

use crate::geometry::small_displacement;
use crate::identification::{Estimate, Mode};
use crate::model::{ActuatorMap, CalibrationModel, ParameterId, StaticProperties, Unit};
use crate::pipeline::{Outcome, SetKind, Truth};

/// Half-width of a 95 % interval in standard deviations of a normal distribution.
pub(super) const NORMAL_95: f64 = 1.959_963_984_540_054;

/// What a mode says of a parameter, m or rad.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ParameterCell {
    pub truth: Option<f64>,
    pub value: f64,
    pub sigma: Option<f64>,
}

impl ParameterCell {
    /// Estimate minus truth.
    pub fn error(&self) -> Option<f64> {
        self.truth.map(|truth| self.value - truth)
    }

    /// Error in standard deviations.
    pub fn error_over_sigma(&self) -> Option<f64> {
        let sigma = self.sigma.filter(|s| *s > 0.0)?;
        self.error().map(|error| error / sigma)
    }

    /// Half-width of the 95 % interval.
    pub fn half_width(&self) -> Option<f64> {
        self.sigma.map(|s| NORMAL_95 * s)
    }
}

/// A parameter across the modes that were fitted.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ParameterRow {
    pub id: ParameterId,
    /// One a fitted mode; `None` where the mode does not have the parameter.
    pub cells: Vec<Option<ParameterCell>>,
}

impl ParameterRow {
    pub fn truth(&self) -> Option<f64> {
        self.cells.iter().flatten().find_map(|cell| cell.truth)
    }
}

/// The modes with an estimate, in table order.
pub(super) fn fitted(outcome: &Outcome) -> Vec<(Mode, &Estimate)> {
    outcome.modes.iter().filter_map(|m| m.estimate.as_ref().map(|e| (m.mode, e))).collect()
}

/// Every identified parameter, in the order of the first estimate that has it.
pub(super) fn parameter_rows(outcome: &Outcome) -> Vec<ParameterRow> {
    let fitted = fitted(outcome);
    let mut ids: Vec<ParameterId> = Vec::new();
    for parameter in fitted.iter().flat_map(|(_, estimate)| &estimate.parameters) {
        if !ids.contains(&parameter.id) {
            ids.push(parameter.id);
        }
    }
    let cell = |estimate: &Estimate, id| {
        estimate.parameters.iter().find(|p| p.id == id).map(|p| ParameterCell {
            truth: truth_of(outcome, estimate, id),
            value: p.value,
            sigma: p.sigma.filter(|s| s.is_finite()),
        })
    };
    ids.into_iter()
        .map(|id| ParameterRow { id, cells: fitted.iter().map(|(_, e)| cell(e, id)).collect() })
        .collect()
}

/// Real link deviations that no mode has among its parameters: (parameter, m or rad).
pub(super) fn unfitted_deviations(outcome: &Outcome) -> Vec<(ParameterId, f64)> {
    let fitted = fitted(outcome);
    let Some(truth) = outcome.truth.as_ref().filter(|_| !fitted.is_empty()) else { return Vec::new() };
    ParameterId::all_of_links(outcome.model.kinematics.joint_count())
        .into_iter()
        .filter(|id| fitted.iter().all(|(_, estimate)| estimate.value(*id).is_none()))
        .filter_map(|id| link_truth(outcome, truth, id).map(|deviation| (id, deviation)))
        // Below a nanometre or nanoradian it is the rounding of as-built minus nominal.
        .filter(|(_, deviation)| deviation.abs() > 1e-9)
        .collect()
}

/// What the parameter really is, m or rad; `None` where the truth is not known or has no counterpart.
///
/// - link: as-built minus nominal;
/// - frame: the estimate holds `station = prior · exp(value)` for the station's six components (absent ones are zero), so the prior
///   is recovered exactly and the truth is the `xi` of `prior · exp(xi) = tracker_from_base`. Known for a single station only;
/// - target: as-built minus stated offset. Known for a single target only.
pub(super) fn truth_of(outcome: &Outcome, estimate: &Estimate, id: ParameterId) -> Option<f64> {
    let truth = outcome.truth.as_ref()?;
    let value = match id {
        ParameterId::Link { .. } => link_truth(outcome, truth, id),
        ParameterId::Frame { station: 0, component } => frame_truth(truth, estimate)?.get(component).copied(),
        ParameterId::Target { target: 0, axis } => {
            let set = outcome.sets.iter().find(|s| s.kind == SetKind::Identification)?;
            let [stated] = set.measurements.targets.as_slice() else { return None };
            Some(truth.as_built.target.get(axis)? - stated.in_flange.get(axis)?)
        }
        ParameterId::Compliance(_) | ParameterId::Mass { .. } | ParameterId::Linkage(_) => {
            let stated = &outcome.model;
            deviation(&truth.as_built.actuators, &truth.as_built.statics, stated, id)
        }
        // A term's amplitude has no single counterpart: what a machine really does is of no such shape.
        ParameterId::Term(_) | ParameterId::Frame { .. } | ParameterId::Target { .. } => None,
    };
    value.filter(|v| v.is_finite())
}

/// What really differs from the stated robot beside its links: relative for compliances and masses, m for lengths.
fn deviation(
    actuators: &ActuatorMap,
    statics: &StaticProperties,
    stated: &CalibrationModel,
    id: ParameterId,
) -> Option<f64> {
    match id {
        ParameterId::Linkage(length) => Some(actuators.length(length)? - stated.actuators.length(length)?),
        ParameterId::Mass { link } => {
            Some(statics.bodies.get(link)?.mass / stated.statics.as_ref()?.bodies.get(link)?.mass - 1.0)
        }
        ParameterId::Compliance(compliance) => {
            let stated = stated.statics.as_ref()?.stiffness(compliance)?;
            Some(stated / statics.stiffness(compliance)? - 1.0)
        }
        _ => None,
    }
}

fn link_truth(outcome: &Outcome, truth: &Truth, id: ParameterId) -> Option<f64> {
    let ParameterId::Link { link, term } = id else { return None };
    let as_built = truth.as_built.kinematics.links.get(link)?;
    let nominal = outcome.model.kinematics.links.get(link)?;
    Some(as_built.term(term) - nominal.term(term))
}

fn frame_truth(truth: &Truth, estimate: &Estimate) -> Option<Vector6<f64>> {
    let [station] = estimate.robot.stations.as_slice() else { return None };
    let xi = Vector6::from_iterator(
        (0..6).map(|component| estimate.value(ParameterId::Frame { station: 0, component }).unwrap_or(0.0)),
    );
    let prior = station * small_displacement(&xi).inverse();
    let displacement = prior.inverse() * truth.tracker_from_base;
    let (along, about) = (displacement.translation.vector, rotation_vector(&displacement.rotation));
    Some(Vector6::new(along.x, along.y, along.z, about.x, about.y, about.z))
}

/// The logarithm of a rotation of less than half a turn. nalgebra's goes by the arc cosine, which keeps half the digits near zero.
fn rotation_vector(rotation: &Rotation3<f64>) -> Vector3<f64> {
    let r = rotation.matrix();
    let sine_axis = 0.5 * Vector3::new(r.m32 - r.m23, r.m13 - r.m31, r.m21 - r.m12);
    let sine = sine_axis.norm();
    let angle = sine.atan2(0.5 * (r.trace() - 1.0));
    if sine > 0.0 { sine_axis * (angle / sine) } else { sine_axis }
}

/// The unit that a parameter is printed in, and what an SI value is multiplied with.
pub(super) fn printed_unit(unit: Unit) -> (&'static str, f64) {
    match unit {
        Unit::Metre => ("mm", 1e3),
        Unit::Radian => ("mrad", 1e3),
        Unit::One => ("%", 1e2),
    }
}

/// What a parameter is, in words; numbers count from one.
pub(super) fn parameter_words(id: ParameterId) -> String {
    use crate::model::{Compliance, LinkTerm, LinkageLength};
    const AXES: [&str; 3] = ["x", "y", "z"];
    match id {
        ParameterId::Link { link, term } => {
            let term = match term {
                LinkTerm::A => "length a",
                LinkTerm::Alpha => "twist α",
                LinkTerm::Beta => "tilt β",
                LinkTerm::D => "offset d",
                LinkTerm::Theta => "angle θ",
            };
            format!("link {}, {term}", link + 1)
        }
        ParameterId::Frame { station, component } => {
            let how = if component < 3 { "along" } else { "about" };
            format!("base seen from station {}, {how} {}", station + 1, AXES[component % 3])
        }
        ParameterId::Target { target, axis } => {
            format!("target {} on the flange, {}", target + 1, AXES[axis % 3])
        }
        ParameterId::Compliance(Compliance::Drive { joint }) => format!("compliance of drive {}", joint + 1),
        ParameterId::Compliance(Compliance::Bearing { joint, axis }) => {
            let how = if axis < 3 { "along" } else { "about" };
            format!("compliance of bearing {}, {how} {}", joint + 1, AXES[axis % 3])
        }
        ParameterId::Compliance(Compliance::Beam { link }) => format!("compliance of link {}", link + 1),
        ParameterId::Compliance(Compliance::Rod) => "compliance of the coupler rod".to_owned(),
        ParameterId::Mass { link } => format!("mass of link {}", link + 1),
        ParameterId::Linkage(LinkageLength::Crank) => "length of the crank".to_owned(),
        ParameterId::Linkage(LinkageLength::Lever) => "length of the lever".to_owned(),
        ParameterId::Linkage(LinkageLength::Rod) => "length of the coupler rod".to_owned(),
        ParameterId::Term(term) => format!("{}: {term}", term.family().about()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::LinkTerm;
    use crate::report::sample;

    #[test]
    fn the_truth_of_links_frame_and_target_is_recovered() {
        let outcome = sample::simulated();
        let rows = parameter_rows(&outcome);
        let truth = |name: &str| {
            let id = ParameterId::parse(name).expect(name);
            rows.iter().find(|row| row.id == id).expect(name).truth().expect(name)
        };
        assert!((truth("delta_theta4") + 0.0171).abs() < 1e-12);
        assert!((truth("delta_d7") + 0.0208).abs() < 1e-12);
        // The sample places the tracker at prior · exp(TRUE_FRAME) and estimates a different displacement.
        for (component, expected) in sample::TRUE_FRAME.into_iter().enumerate() {
            let id = ParameterId::Frame { station: 0, component };
            let row = rows.iter().find(|row| row.id == id).expect("a frame parameter");
            for cell in row.cells.iter().flatten() {
                let found = cell.truth.expect("one station");
                assert!((found - expected).abs() < 1e-12, "{id}: {found} against {expected}");
                assert!((cell.value - expected).abs() > 1e-9, "{id}: the estimate is not the truth");
            }
        }
        for (axis, expected) in sample::TARGET_ERROR.into_iter().enumerate() {
            let id = ParameterId::Target { target: 0, axis };
            let row = rows.iter().find(|row| row.id == id).expect("a target parameter");
            assert!((row.truth().expect("one target") - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn the_rotation_vector_undoes_the_exponential_from_tiny_to_large_angles() {
        for angle in [0.0, 1e-12, 1e-6, 0.1, 3.0] {
            let expected = angle * Vector3::new(2.0, -1.0, 2.0) / 3.0;
            let found = rotation_vector(&Rotation3::new(expected));
            assert!(
                (found - expected).norm() <= 1e-14 * (1.0 + 1.0 / (std::f64::consts::PI - angle)),
                "{angle}"
            );
        }
    }

    #[test]
    fn a_deviation_that_no_mode_fits_is_named() {
        let outcome = sample::simulated();
        let unfitted = unfitted_deviations(&outcome);
        let [(id, deviation)] = unfitted.as_slice() else { panic!("{unfitted:?}") };
        assert_eq!(*id, ParameterId::link(5, LinkTerm::Beta));
        assert!((deviation - 0.005).abs() < 1e-12);
    }

    #[test]
    fn real_data_have_no_truth() {
        let outcome = sample::measured();
        assert!(parameter_rows(&outcome).iter().all(|row| row.truth().is_none()));
        assert!(unfitted_deviations(&outcome).is_empty());
    }
}
