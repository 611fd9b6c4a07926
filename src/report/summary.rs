//! What a run comes down to, in sentences.

use nalgebra::Vector3;

use super::accuracy::row;
use super::accuracy::{judged_set, published};
use super::parameters::{fitted, parameter_rows, truth_of, unfitted_deviations};
use super::words::{
    capital, consistency_ratio, counted, factor_words, length_words, printed_unit, signed_percent,
    significant,
};
use crate::pipeline::{ModeOutcome, Outcome, SetKind};
use calibrig_estimation::identification::{Estimate, Mode, NoiseScale, ParameterEstimate};
use calibrig_model::statistics::NORMAL_95;

const AXES: [&str; 3] = ["x", "y", "z"];

/// Sentences for people.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Summary {
    pub improved: Vec<String>,
    pub remains: Vec<String>,
}

/// The sentences of a run.
pub(super) fn summarise(outcome: &Outcome) -> Summary {
    let mut summary = Summary::default();
    let Some(set) = judged_set(outcome) else {
        summary.remains.push("No pose was measured.".to_owned());
        return summary;
    };
    improvement(outcome, set, &mut summary.improved);
    against_published(outcome, set, &mut summary.improved);
    let last = outcome.modes.iter().rev().find(|m| m.estimate.is_some() && row(m, set).is_some());
    if let Some(mode) = last {
        remaining(outcome, mode, set, &mut summary.remains);
        consistency(mode, &mut summary.remains);
    }
    parameters_against_truth(outcome, &mut summary.remains);
    summary
}

fn improvement(outcome: &Outcome, set: usize, say: &mut Vec<String>) {
    let held_out = outcome.sets[set].kind == SetKind::Verification;
    let find = |mode| outcome.modes.iter().find(|m| m.mode == mode).and_then(|m| row(m, set));
    let before = find(Mode::WithoutCalibration);
    let poses = if held_out {
        "the verification poses, to which no parameter was fitted"
    } else {
        "the identification poses (there is no held-out set, so this is what the fit left, not what a new pose would show)"
    };
    if let Some(before) = before {
        say.push(format!(
            "Without calibration the tool is {} (RMS of the 3-D error) and at worst {} from where the nominal robot predicts it, over {poses}.",
            length_words(before.rms_3d),
            length_words(before.max_3d)
        ));
    }
    for mode in outcome.modes.iter().filter(|m| m.estimate.is_some()) {
        let Some(after) = row(mode, set) else { continue };
        let against = before.map_or_else(String::new, |b| {
            format!(", {}", factor_words(b.rms_3d, after.rms_3d, Mode::WithoutCalibration.title()))
        });
        say.push(format!(
            "{} leaves {} RMS and {} at worst{against}.",
            capital(mode.mode.title()),
            length_words(after.rms_3d),
            length_words(after.max_3d),
        ));
    }
    if let (Some(geometry), Some(gravity)) = (find(Mode::OnlyCalibration), find(Mode::WithGravity)) {
        let change = |axis: usize| signed_percent(gravity.mean[axis] / geometry.mean[axis] - 1.0);
        say.push(format!(
            "With gravity the mean error changes by {} in x, {} in y and {} in z, compared with only calibration.",
            change(0),
            change(1),
            change(2)
        ));
    }
}

fn against_published(outcome: &Outcome, set: usize, say: &mut Vec<String>) {
    let ranges: Vec<_> = outcome
        .modes
        .iter()
        .filter_map(|mode| {
            let row = row(mode, set)?;
            let figures = published(outcome, outcome.sets[set].kind, mode.mode)?;
            let ours = [row.max.x, row.mean.x, row.max.y, row.mean.y, row.max.z, row.mean.z];
            let ratios = ours.iter().zip(figures).map(|(a, b)| a / b).filter(|r| r.is_finite());
            let (low, high) = ratios.fold((f64::INFINITY, 0.0_f64), |(l, h), r| (l.min(r), h.max(r)));
            (low <= high)
                .then(|| format!("{low:.2} to {high:.2} times in \u{201c}{}\u{201d}", mode.mode.title()))
        })
        .collect();
    if !ranges.is_empty() {
        say.push(format!("Maxima and means per axis against the published ones: {}.", ranges.join(", ")));
    }
}

fn remaining(outcome: &Outcome, mode: &ModeOutcome, set: usize, say: &mut Vec<String>) {
    let Some(rest) = row(mode, set) else { return };
    let axis = rest.mean.imax();
    say.push(format!(
        "With {}, the largest mean error is along {}: {}; the signed mean there is {}.",
        mode.mode.title(),
        AXES[axis],
        length_words(rest.mean[axis]),
        length_words(rest.bias[axis])
    ));
    if let Some((pose, error)) = worst_pose(outcome, mode, set) {
        say.push(format!(
            "The largest 3-D error, {}, is at pose {pose} of the {} set.",
            length_words(error.norm()),
            outcome.sets[set].kind.key()
        ));
    }
    let fitted_row = outcome
        .sets
        .iter()
        .position(|s| s.kind == SetKind::Identification)
        .filter(|i| *i != set)
        .and_then(|i| row(mode, i));
    if let Some(fitted_row) = fitted_row {
        let change = rest.rms_3d / fitted_row.rms_3d - 1.0;
        let comment = if change > 0.5 {
            "the fit does not carry over well, and more or better spread poses would help"
        } else if change > 0.15 {
            "part of the fit is to the poses themselves"
        } else {
            "the fit carries over to poses it has not seen"
        };
        say.push(format!(
            "The RMS over held-out poses differs by {} from that over the fitted ones: {comment}.",
            signed_percent(change)
        ));
    }
}

fn worst_pose(outcome: &Outcome, mode: &ModeOutcome, set: usize) -> Option<(u32, Vector3<f64>)> {
    let observations = &outcome.sets.get(set)?.measurements.observations;
    observations
        .iter()
        .zip(mode.errors.get(set)?)
        .map(|(observation, error)| (observation.pose, *error))
        .max_by(|a, b| a.1.norm().total_cmp(&b.1.norm()))
}

fn consistency(mode: &ModeOutcome, say: &mut Vec<String>) {
    let Some(estimate) = &mode.estimate else { return };
    if let NoiseScale::Residuals(sigma) = estimate.noise {
        say.push(format!(
            "The readings state no uncertainty: standard deviations are scaled to the residuals ({} in each coordinate), which cannot tell noise from what the model lacks. State the noise of the tracker.",
            length_words(sigma)
        ));
    }
    let Some(ratio) = consistency_ratio(estimate) else { return };
    // Three standard deviations of sqrt(chi2 / dof) for normal errors.
    let tolerance = 3.0 / (2.0 * estimate.degrees_of_freedom).sqrt();
    say.push(if ratio > 1.0 + tolerance {
        format!(
            "The residuals are {} times what the stated noise explains: the rest is what the model lacks. Where that was estimated, the standard deviations include it. The section on the residual names what it depends on.",
            significant(ratio)
        )
    } else if ratio < 1.0 - tolerance {
        format!(
            "The residuals are only {} times what the fit allowed for: the stated noise, or the allowance for what the model lacks, is too large, and so are the standard deviations. State less.",
            significant(ratio)
        )
    } else {
        format!(
            "The residuals are what the stated noise explains (ratio {}): nothing is left for a better model to gain.",
            significant(ratio)
        )
    });
}

/// The errors beside what is possible at all.
fn errors_over_bound(outcome: &Outcome, estimate: &Estimate, is_first: bool) -> Option<String> {
    let bounds = outcome.bounds.iter().find(|bounds| bounds.mode == estimate.robot.mode)?;
    let (name, least) = match (&bounds.bayesian, &bounds.cramer_rao) {
        (Some(sigmas), _) => ("the Bayesian Cramér-Rao bound", sigmas),
        (None, Some(sigmas)) => ("the Cramér-Rao bound", sigmas),
        (None, None) => return None,
    };
    let ratio =
        |(p, least): (&ParameterEstimate, &f64)| Some((p.value - truth_of(outcome, estimate, p.id)?) / least);
    let ratios: Option<Vec<f64>> = estimate.parameters.iter().zip(least).map(ratio).collect();
    let ratios = ratios.filter(|ratios| !ratios.is_empty())?;
    let rms = (ratios.iter().map(|r| r * r).sum::<f64>() / ratios.len() as f64).sqrt();
    Some(format!(
        "Its errors are {} times {name} at the truth (RMS).{}",
        significant(rms),
        if is_first {
            " The bound is what the noise of the readings leaves even to the best estimator, if the model is complete."
        } else {
            ""
        }
    ))
}

fn parameters_against_truth(outcome: &Outcome, say: &mut Vec<String>) {
    let rows = parameter_rows(outcome);
    for (index, (mode, estimate)) in fitted(outcome).iter().enumerate() {
        let ratios: Vec<f64> = rows
            .iter()
            .filter_map(|row| row.cells.get(index).copied().flatten()?.error_over_sigma())
            .collect();
        if ratios.is_empty() {
            continue;
        }
        let within = ratios.iter().filter(|r| r.abs() <= NORMAL_95).count();
        let rms = (ratios.iter().map(|r| r * r).sum::<f64>() / ratios.len() as f64).sqrt();
        say.push(format!(
            "With {}, the 95 % intervals of single parameters hold the true value for {within} of {}; {:.0} would be expected of a complete model (RMS of error over sigma {}).",
            mode.title(),
            counted(ratios.len(), "parameter"),
            0.95 * ratios.len() as f64,
            significant(rms)
        ));
        say.extend(errors_over_bound(outcome, estimate, index == 0));
    }
    let unfitted = unfitted_deviations(outcome);
    if !unfitted.is_empty() {
        let named: Vec<_> = unfitted
            .iter()
            .map(|(id, deviation)| {
                let (unit, factor) = printed_unit(id.unit());
                format!("{id}\u{a0}=\u{a0}{}\u{a0}{unit}", significant(deviation * factor))
            })
            .collect();
        say.push(format!("Real deviations that no mode identifies: {}.", named.join(", ")));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::tests::sample;

    #[test]
    fn lengths_and_factors_read_well() {
        assert_eq!(length_words(0.018_24), "18.2\u{a0}mm");
        assert_eq!(length_words(0.001_926), "1.93\u{a0}mm");
        assert_eq!(length_words(-0.000_412_3), "\u{2212}0.412\u{a0}mm");
        assert_eq!(length_words(4.21e-6), "4.21\u{a0}µm");
        assert_eq!(factor_words(18.0, 2.0, "x"), "9.00 times less than x");
        assert_eq!(factor_words(2.0, 3.0, "x"), "1.50 times more than x");
        assert_eq!(factor_words(2.0, 2.0, "x"), "as much as x");
        assert_eq!(factor_words(2.0, f64::NAN, "x"), "not comparable with x");
    }

    #[test]
    fn a_simulated_run_is_judged_by_the_held_out_set_and_the_truth() {
        let outcome = sample::simulated();
        assert_eq!(judged_set(&outcome), Some(1));
        let summary = summarise(&outcome);
        let before = row(&outcome.modes[0], 1).expect("a row");
        assert!(summary.improved[0].contains(&length_words(before.rms_3d)), "{}", summary.improved[0]);
        let remains = summary.remains.join("\n");
        for part in
            ["9.40 times what the stated noise", "of 33 parameters", "delta_beta6\u{a0}=\u{a0}5.00\u{a0}mrad"]
        {
            assert!(remains.contains(part), "{part} in {remains}");
        }
    }

    #[test]
    fn a_real_run_says_that_nothing_was_held_out_and_claims_no_truth() {
        let summary = summarise(&sample::measured());
        assert!(summary.improved[0].contains("no held-out set"));
        let remains = summary.remains.join("\n");
        assert!(remains.contains("state no uncertainty") && !remains.contains("true value"), "{remains}");
    }

    #[test]
    fn a_run_without_a_measurement_does_not_fail() {
        let mut outcome = sample::measured();
        outcome.sets.clear();
        assert_eq!(summarise(&outcome).remains, ["No pose was measured."]);
    }
}
