//! Estimates beside the truth, where it is known.

use crate::pipeline::{KnownTruth, Outcome, SetKind, Truth};
use calibrig_estimation::identification::{Estimate, Mode};
use calibrig_model::ParameterId;
use calibrig_model::measurement::Target;
use calibrig_model::statistics::NORMAL_95;

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
    /// What the mode with this place says.
    pub fn cell(&self, slot: usize) -> Option<&ParameterCell> {
        self.cells.get(slot)?.as_ref()
    }

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
        .filter_map(|id| known_truth(outcome, truth, &[]).link(id).map(|deviation| (id, deviation)))
        // Below a nanometre or nanoradian it is the rounding of as-built minus nominal.
        .filter(|(_, deviation)| deviation.abs() > 1e-9)
        .collect()
}

/// What the parameter really is, SI; `None` where the truth is not known or has no counterpart.
pub(super) fn truth_of(outcome: &Outcome, estimate: &Estimate, id: ParameterId) -> Option<f64> {
    let set = outcome.sets.iter().find(|s| s.kind == SetKind::Identification)?;
    known_truth(outcome, outcome.truth.as_ref()?, &set.measurements.targets).of(estimate, id)
}

fn known_truth<'a>(outcome: &'a Outcome, truth: &'a Truth, targets: &'a [Target]) -> KnownTruth<'a> {
    KnownTruth {
        as_built: &truth.as_built,
        nominal: &outcome.model,
        stations: &truth.stations,
        instrument: &truth.instrument,
        further_targets: &truth.further_targets,
        orientation: truth.orientation,
        targets,
        settled: truth.poses.first().map_or(&[], Vec::as_slice),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::tests::sample;
    use calibrig_model::LinkTerm;

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
