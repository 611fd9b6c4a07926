//! Explains what a rank deficiency or a weak direction means to the person at the robot, and what helps.

use serde::{Deserialize, Serialize};
use std::fmt;

use nalgebra::{DMatrix, Vector3};

use super::complete::generic_target;
use super::rank::{WEAK_TOLERANCE, determination};
use super::{DependentGroup, IdentifiabilityReport, WeakDirection, structural_poses};
use crate::kinematics::{stack, stacked_jacobian};
use calibrig_model::{KinematicModel, ModelError, ParameterId};

/// Cause of a difficulty.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Finding {
    /// The parameters have the same effect in every pose and for every target: it is already decided which one is left out.
    Structure,
    /// The structure separates the parameters, but these poses and this target do not.
    Measurements,
    /// The parameters are determined, but poorly.
    Weak,
}

/// A measure that makes a group or direction identifiable.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Remedy {
    /// Measure the tracker's place.
    MeasureFrame,
    /// Measure the target's offset.
    MeasureTarget,
    /// Measure more poses, as there are fewer coordinates than parameters.
    MeasureMorePoses,
    /// Spread the poses, the same number or more, over the whole joint limits.
    SpreadPoses,
    /// Offset the target, which is where the last joints do not move it.
    OffsetTarget,
    /// Mount three targets on the flange instead of one.
    MeasureFullPose,
    /// Fix one parameter: nothing else helps, or nothing else is needed.
    FixOne,
}

/// A dependent group or weak direction in words.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Explanation {
    /// Cause of the difficulty.
    pub finding: Finding,
    /// Its members with their weights in the undetermined combination: in SI units for a dependent group, scaled for a weak direction.
    pub members: Vec<(ParameterId, f64)>,
    /// Names of the members, such as `delta_d3 with delta_d4`.
    pub names: String,
    /// Scaled singular value: that of the group itself, or, for a weak direction, relative to the largest.
    pub singular_value: f64,
    /// What helps; for causes in the measurements, the most effective first.
    pub remedies: Vec<Remedy>,
    /// The remedies in words.
    pub advice: String,
}

impl fmt::Display for Explanation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({:.1e}): {}", self.names, self.singular_value, self.advice)
    }
}

/// Explains every dependent group and weak direction of a report. The report was made by [`identifiability`](super::identifiability) with the same
/// `poses` (joint variables) and `target` (flange frame, m), or by [`complete_set`](super::complete_set) without poses: then `poses` is empty.
///
/// For causes in the measurements, a remedy is named only if the nominal model shows that it works: the direction is then
/// determined to better than [`WEAK_TOLERANCE`]. For structural causes, the remedies are those that make the left-out parameter
/// identifiable, or to fix it, which loses nothing.
pub fn explain(
    report: &IdentifiabilityReport,
    model: &KinematicModel,
    poses: &[Vec<f64>],
    target: &Vector3<f64>,
) -> Result<Vec<Explanation>, ModelError> {
    // Checks what the trials rely on, so that they need no checks of their own.
    stacked_jacobian(model, poses, target, &report.selected)?;
    let trials = Trials::new(report, model, poses, target);
    let structure = report.dependent.iter().map(explain_structure);
    let measurements = report.spectrum.dependent.iter().map(|group| trials.explain_dependent(group));
    let weak = report.spectrum.weak.iter().map(|direction| trials.explain_weak(direction));
    Ok(structure.chain(measurements).chain(weak).collect())
}

fn explain_structure(group: &DependentGroup) -> Explanation {
    let mut remedies = Vec::new();
    if group.with.iter().any(|(id, _)| matches!(id, ParameterId::Frame { .. })) {
        remedies.push(Remedy::MeasureFrame);
    }
    if group.with.iter().any(|(id, _)| matches!(id, ParameterId::Target { .. })) {
        remedies.push(Remedy::MeasureTarget);
    }
    remedies.push(Remedy::FixOne);
    of_group(Finding::Structure, group, remedies)
}

fn of_group(finding: Finding, group: &DependentGroup, remedies: Vec<Remedy>) -> Explanation {
    let mut members = vec![(group.redundant, 1.0)];
    members.extend(group.with.iter().map(|(id, coefficient)| (*id, -coefficient)));
    let advice = in_words(&remedies, finding, &members);
    Explanation {
        finding,
        members,
        names: group.to_string(),
        singular_value: group.singular_value,
        remedies,
        advice,
    }
}

fn in_words(remedies: &[Remedy], finding: Finding, undetermined: &[(ParameterId, f64)]) -> String {
    let texts: Vec<_> = remedies
        .iter()
        .map(|remedy| match remedy {
            Remedy::MeasureFrame => "measure the frame from base nests".to_owned(),
            Remedy::MeasureTarget => "measure the target's offset in the flange frame".to_owned(),
            Remedy::MeasureMorePoses => "measure more poses".to_owned(),
            Remedy::SpreadPoses => "spread the poses over the joints' limits".to_owned(),
            Remedy::OffsetTarget => "offset the target from the last axis and the wrist centre".to_owned(),
            Remedy::MeasureFullPose => {
                "measure the full pose (a second and a third target on the flange)".to_owned()
            }
            Remedy::FixOne if finding == Finding::Weak => "fix one of them, or give it a prior".to_owned(),
            Remedy::FixOne => fix_one(undetermined),
        })
        .collect();
    texts.join("; or ")
}

fn fix_one(undetermined: &[(ParameterId, f64)]) -> String {
    let same = |a: f64, b: f64| (a - b).abs() < 1e-6;
    match *undetermined {
        [(id, _)] => format!("fix {id}: it does not move the target"),
        [_, (_, b)] if same(b, -1.0) => "fix one of them: only their sum moves the target".to_owned(),
        [_, (_, b)] if same(b, 1.0) => "fix one of them: only their difference moves the target".to_owned(),
        _ => "fix one of them: only combinations of them move the target".to_owned(),
    }
}

/// The systems that result from the remedies, for the report's selected parameters.
struct Trials {
    selected: Vec<ParameterId>,
    /// Column norms of the system as measured.
    norms: Vec<f64>,
    remedied: Vec<(Remedy, DMatrix<f64>)>,
    /// Whether there are fewer coordinates than parameters.
    too_few: bool,
}

impl Trials {
    fn new(
        report: &IdentifiabilityReport,
        model: &KinematicModel,
        poses: &[Vec<f64>],
        target: &Vector3<f64>,
    ) -> Self {
        let selected = report.selected.clone();
        let all_is_well = report.spectrum.dependent.is_empty() && report.spectrum.weak.is_empty();
        if all_is_well || poses.is_empty() {
            return Self { selected, norms: Vec::new(), remedied: Vec::new(), too_few: false };
        }
        let jacobian = stack(model, poses, target, &selected);
        let norms = jacobian.column_iter().map(|c| c.norm()).collect();
        let spread = structural_poses(model, poses.len().max(2 * selected.len()));
        let remedied = vec![
            (Remedy::SpreadPoses, stack(model, &spread, target, &selected)),
            (Remedy::OffsetTarget, stack(model, poses, &generic_target(model), &selected)),
            (Remedy::MeasureFullPose, three_targets(model, poses, target, &selected)),
        ];
        let too_few = jacobian.nrows() < selected.len();
        Self { selected, norms, remedied, too_few }
    }

    fn explain_dependent(&self, group: &DependentGroup) -> Explanation {
        let mut direction = vec![0.0; self.selected.len()];
        self.set(&mut direction, group.redundant, 1.0);
        for (id, coefficient) in &group.with {
            self.set(&mut direction, *id, -coefficient);
        }
        of_group(Finding::Measurements, group, self.remedies(&direction))
    }

    fn explain_weak(&self, weak: &WeakDirection) -> Explanation {
        let mut direction = vec![0.0; self.selected.len()];
        for (id, weight) in &weak.members {
            self.set(&mut direction, *id, *weight);
        }
        for (entry, norm) in direction.iter_mut().zip(&self.norms) {
            *entry = if *norm > 0.0 { *entry / norm } else { 0.0 };
        }
        let remedies = self.remedies(&direction);
        let advice = in_words(&remedies, Finding::Weak, &weak.members);
        Explanation {
            finding: Finding::Weak,
            members: weak.members.clone(),
            names: weak.to_string(),
            singular_value: weak.singular_value,
            remedies,
            advice,
        }
    }

    fn set(&self, direction: &mut [f64], id: ParameterId, value: f64) {
        if let Some(place) = self.selected.iter().position(|s| *s == id) {
            direction[place] = value;
        }
    }

    fn remedies(&self, direction: &[f64]) -> Vec<Remedy> {
        if self.too_few {
            return vec![Remedy::MeasureMorePoses];
        }
        let mut padded = direction.to_vec();
        let mut effects: Vec<_> = self
            .remedied
            .iter()
            .map(|(remedy, jacobian)| {
                padded.resize(jacobian.ncols(), 0.0);
                (*remedy, determination(jacobian, &padded))
            })
            .filter(|(_, effect)| *effect >= WEAK_TOLERANCE)
            .collect();
        effects.sort_by(|a, b| b.1.total_cmp(&a.1));
        let mut remedies: Vec<_> = effects.into_iter().map(|(remedy, _)| remedy).collect();
        if remedies.is_empty() {
            remedies.push(Remedy::FixOne);
        }
        remedies
    }
}

/// The Jacobian of three targets on the flange. Where the target's offset is free, so are the offsets of the other two, in their own columns
/// at the end.
fn three_targets(
    model: &KinematicModel,
    poses: &[Vec<f64>],
    target: &Vector3<f64>,
    parameters: &[ParameterId],
) -> DMatrix<f64> {
    let arm = generic_target(model).norm();
    let targets = [*target, target + arm * Vector3::x(), target + arm * Vector3::y()];
    let n = parameters.len();
    let free: Vec<usize> = (0..n).filter(|i| matches!(parameters[*i], ParameterId::Target { .. })).collect();
    let rows = 3 * poses.len();
    let mut system = DMatrix::zeros(3 * rows, n + 2 * free.len());
    for (block, offset) in targets.iter().enumerate() {
        let jacobian = stack(model, poses, offset, parameters);
        system.view_mut((block * rows, 0), (rows, n)).copy_from(&jacobian);
        if block == 0 {
            continue;
        }
        for (place, column) in free.iter().enumerate() {
            let own = n + (block - 1) * free.len() + place;
            system.view_mut((block * rows, own), (rows, 1)).copy_from(&jacobian.column(*column));
            system.view_mut((block * rows, *column), (rows, 1)).fill(0.0);
        }
    }
    system
}
