//! Tables to read, in Markdown.

use std::collections::BTreeMap;
use std::fmt::Write;

use super::Story;
use super::figures::{Correlations, approaches, identified};
use super::{Measured, PoseStep, Provenance, scene};
use calibrig_estimation::evaluation::AccuracyRow;
use calibrig_estimation::evaluation::closed_loop::ClosedLoop;
use calibrig_estimation::identification::{Estimate, Mode};
use calibrig_model::measurement::SetKind;
use calibrig_model::{ParameterId, Unit};

// Writing to a String does not fail: its results are dropped below.

/// Accuracy of every mode on every set, with the published figures.
pub(super) fn accuracy(story: &Story<'_>) -> String {
    let mut text = String::new();
    for (index, set) in story.sets.iter().enumerate() {
        begin_errors(&mut text, &format!("{} set: error at the target", capitalised(set.kind.key())));
        for mode in story.modes {
            if let Some(Some(row)) = mode.rows.get(index) {
                add_errors(&mut text, mode.mode.title(), row);
            }
            if let Some(figures) = published(story, set.kind, mode.mode) {
                let cells: Vec<_> = figures.iter().map(|m| format!(" *{:.1}* ", 1e3 * m)).collect();
                let _ = writeln!(text, "| *published* |{}| | |", cells.join("|"));
            }
        }
        text.push('\n');
    }
    let registration = &story.registration;
    let _ = writeln!(
        text,
        "Registration of the first row: {}, {} poses, RMS {:.3} mm.",
        registration.how,
        registration.poses,
        1e3 * registration.rms
    );
    text
}

/// The effect of corrected commands on the machine.
pub(super) fn compensation(driven: &ClosedLoop) -> String {
    let mut text = String::new();
    let of_path = driven
        .path
        .iter()
        .map(|path| (format!("Path of {:.2} m at {:.0} mm/s", path.length, 1e3 * path.speed), &path.modes));
    let of_poses = [("Poses of the verification set, driven again".to_owned(), &driven.modes)];
    for (title, modes) in of_poses.into_iter().chain(of_path) {
        begin_errors(&mut text, &format!("{title}: measured minus wanted"));
        for mode in modes {
            let name = match mode.mode {
                Mode::WithoutCalibration => "nominal commands",
                mode => mode.title(),
            };
            if let Some(row) = mode.row() {
                add_errors(&mut text, name, &row);
            }
        }
        text.push('\n');
    }
    text
}

/// The head of a table of errors.
fn begin_errors(text: &mut String, title: &str) {
    let _ = writeln!(text, "## {title}, mm\n");
    let _ = writeln!(text, "| | max x | mean x | max y | mean y | max z | mean z | RMS 3-D | max 3-D |");
    let _ = writeln!(text, "|---|--:|--:|--:|--:|--:|--:|--:|--:|");
}

fn add_errors(text: &mut String, name: &str, row: &AccuracyRow) {
    let axes = (0..3).flat_map(|axis| [row.max[axis], row.mean[axis]]);
    let _ = writeln!(text, "| {name} |{}|", cells(axes.chain([row.rms_3d, row.max_3d])));
}

/// Lengths in m as cells in mm.
fn cells(lengths: impl Iterator<Item = f64>) -> String {
    lengths.map(|m| format!(" {:.3} ", 1e3 * m)).collect::<Vec<_>>().join("|")
}

fn capitalised(word: &str) -> String {
    let mut letters = word.chars();
    letters.next().map(|first| first.to_uppercase().chain(letters).collect()).unwrap_or_default()
}

fn published(story: &Story<'_>, kind: SetKind, mode: Mode) -> Option<[f64; 6]> {
    story.published.iter().find(|(k, m, _)| (*k, *m) == (kind, mode)).map(|(_, _, figures)| *figures)
}

/// One pose: its command, and the residuals of each mode.
pub(super) fn pose(step: &PoseStep<'_>) -> String {
    let mut text = String::new();
    for (i, observation) in step.measured.observations.iter().enumerate() {
        let _ = writeln!(
            text,
            "## {} set, pose {}\n\nstation {}, target {}, {:.1} s\n",
            capitalised(step.set.kind.key()),
            observation.pose,
            observation.station + 1,
            observation.target + 1,
            observation.time
        );
        text.push_str("| residual, mm | x | y | z | 3-D |\n|---|--:|--:|--:|--:|\n");
        for residuals in &step.residuals {
            let Some(error) = residuals.errors.get(i) else { continue };
            let cells = cells(error.iter().copied().chain([error.norm()]));
            let _ = writeln!(text, "| {} |{cells}|", residuals.mode.title());
        }
        let command: Vec<_> = observation.command.iter().map(|c| format!("{c:.4}")).collect();
        let _ = writeln!(text, "\nCommand (m, rad): {}\n", command.join(", "));
        if let Some(payload) = &observation.payload {
            let _ = writeln!(text, "Payload: {}, {:.2} kg\n", payload.name, payload.mass);
        }
    }
    text
}

/// The simulated machine at one pose: its deflections, its effects, and how well it settled. Lengths in mm or µm, angles in µrad.
pub(super) fn machine(measured: &Measured<'_>) -> String {
    let mut text = String::new();
    for (i, (settled, observation)) in measured.truth.iter().zip(measured.observations).enumerate() {
        let set = capitalised(measured.kind.key());
        let _ = writeln!(text, "## {set} set, pose {}, as simulated\n", observation.pose);
        if let Some(d) = measured.deflection(i) {
            let [x, y, z, norm] = [d.x, d.y, d.z, d.norm()].map(|m| 1e3 * m);
            let _ = writeln!(text, "Deflection at the target, mm: {x:.3}, {y:.3}, {z:.3}; 3-D {norm:.3}\n");
        }
        if let Some(force) = settled.rod_force {
            let _ = writeln!(text, "Tension of the rod: {force:.0} N\n");
        }
        let effects = measured.effects.get(i);
        if let Some(temperature) = effects.and_then(|effects| effects.temperature) {
            let _ = writeln!(text, "Temperature of the air: {temperature:.2} °C\n");
        }
        let _ = writeln!(
            text,
            "Steps to settle: {}; left over {:.1e} rad or m, closure {:.1e} m\n",
            settled.steps, settled.residual, settled.closure
        );
        text.push_str("| µm, µrad | drive yields | actuator off | frame x | y | z | rx | ry | rz |\n");
        text.push_str("|---|--:|--:|--:|--:|--:|--:|--:|--:|\n");
        for (joint, yields) in settled.deflection.iter().enumerate() {
            let off = effects.and_then(|e| Some(e.command.get(joint)? - observation.command.get(joint)?));
            let moved = effects.and_then(|e| e.displacements.get(joint)).copied().unwrap_or_default();
            let values = [*yields, off.unwrap_or(0.0)].into_iter().chain(moved);
            let cells: Vec<_> = values.map(|value| format!(" {:.1} ", 1e6 * value)).collect();
            let _ = writeln!(text, "| joint {} |{}|", joint + 1, cells.join("|"));
        }
        text.push('\n');
    }
    text
}

/// How every identification went.
pub(super) fn estimates(story: &Story<'_>) -> String {
    let mut text = String::from("## Identification\n\n");
    text.push_str(
        "| mode | ended with | iterations | rank | condition | chi² / dof |\n|---|---|--:|--:|--:|--:|\n",
    );
    for (mode, estimate) in identified(story) {
        let ratio = estimate.chi2_per_dof().map_or_else(|| "–".to_owned(), |r| format!("{r:.3}"));
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} of {} | {:.1} | {ratio} |",
            mode.title(),
            estimate.termination.key().replace('_', " "),
            estimate.iterations.len(),
            estimate.spectrum.rank,
            estimate.parameters.len(),
            estimate.spectrum.condition,
        );
    }
    let warnings: Vec<_> = identified(story)
        .flat_map(|(mode, e)| e.warnings.iter().map(move |w| format!("- {}: {w}", mode.title())))
        .collect();
    if !warnings.is_empty() {
        let _ = writeln!(text, "\n**Warnings**\n\n{}", warnings.join("\n"));
    }
    text
}

/// The strongest correlations of an estimate, and how to read the picture beside them.
pub(super) fn correlations(mode: Mode, estimate: &Estimate, most: usize) -> String {
    let mut text = format!("## Correlations of the parameters, {}\n\n", mode.title());
    let Some(correlations) = Correlations::of(estimate) else {
        text.push_str("There is no covariance: the system is singular.\n");
        return text;
    };
    text.push_str(
        "In the picture every pair of parameters has a place, in the order of the table of parameters, row and column one each. \
         A filled **disc** is a positive correlation, a hollow **square** a negative one; the area is its strength, weak ones vanish. \
         Point at one to read its names and value. Numbers are those of this table.\n\n\
         Near 1 or -1, the measurements see the two parameters together and can hardly tell one from the other.\n\n",
    );
    text.push_str("| | correlation | parameter | with |\n|--:|--:|---|---|\n");
    for (number, (row, column, r)) in (1..).zip(correlations.strongest(most)) {
        let [one, other] = [row, column].map(|index| estimate.parameters[index].id);
        let _ = writeln!(text, "| {number} | {r:+.3} | {one} | {other} |");
    }
    text
}

/// How every mode converged, one row an iteration.
pub(super) fn convergence(story: &Story<'_>) -> String {
    let mut text = String::from(
        "## The way to the minimum\n\n\
         The curves lie on the timeline **iteration**: choose it at the bottom of the window, where it says *pose*. \
         A parameter's curve is the logarithm (base 10) of its distance from its final value in standard deviations of the result: \
         below 0, less than one standard deviation is left. The slowest parameters are shown.\n",
    );
    for (mode, estimate) in identified(story) {
        let ways = approaches(estimate);
        let _ = writeln!(text, "\n### {}: {}\n", mode.title(), estimate.termination.key().replace('_', " "));
        text.push_str(
            "| | cost | damping | step | farthest from its end, σ | parameter |\n|--:|--:|--:|--:|--:|---|\n",
        );
        for (index, iteration) in estimate.iterations.iter().enumerate() {
            let left = ways.iter().map(|way| (way.distances[index], way.parameter));
            let farthest = left.max_by(|(a, _), (b, _)| a.total_cmp(b));
            let (distance, name) = farthest.map_or_else(Default::default, |(distance, parameter)| {
                (format!("{distance:.2e}"), estimate.parameters[parameter].id.to_string())
            });
            let taken = if iteration.accepted { "" } else { " (refused)" };
            let _ = writeln!(
                text,
                "| {}{taken} | {:.6e} | {:.1e} | {:.1e} | {distance} | {name} |",
                index + 1,
                iteration.cost,
                iteration.damping,
                iteration.step
            );
        }
    }
    text
}

/// Every parameter with its standard deviation for each mode, beside the truth if known. Lengths in mm, angles in mrad.
pub(super) fn parameters(story: &Story<'_>) -> String {
    let estimates: Vec<(Mode, &Estimate)> = identified(story).collect();
    let truth: Option<BTreeMap<ParameterId, f64>> = story.truth.map(|truth| {
        scene::deviations(&story.model.kinematics, &truth.as_built.kinematics).into_iter().collect()
    });
    let mut ids: Vec<ParameterId> =
        estimates.iter().flat_map(|(_, e)| e.parameters.iter().map(|p| p.id)).collect();
    ids.extend(truth.iter().flatten().map(|(id, _)| *id));
    ids.sort();
    ids.dedup();

    let titles =
        estimates.iter().map(|(mode, _)| format!(" {} |", mode.title())).collect::<Vec<_>>().concat();
    let mut text =
        format!("## Parameters: value ± standard deviation\n\n| | unit | truth |{titles}\n|---|---|--:|");
    text.push_str(&"--:|".repeat(estimates.len()));
    text.push('\n');
    for id in ids {
        let unit = match id.unit() {
            Unit::Metre => "mm",
            Unit::Radian => "mrad",
            Unit::One => "1e-3",
        };
        // The truth of stations and targets is not a deviation from a nominal value.
        let known = truth.as_ref().filter(|_| matches!(id, ParameterId::Link { .. }));
        let real =
            known.map_or_else(String::new, |t| format!("{:.4}", 1e3 * t.get(&id).copied().unwrap_or(0.0)));
        let _ = write!(text, "| {id} | {unit} | {real} |");
        for (_, estimate) in &estimates {
            let found = estimate.parameters.iter().find(|p| p.id == id);
            let cell = found.map_or_else(String::new, |p| match p.sigma {
                Some(sigma) => format!("{:.4} ± {:.4}", 1e3 * p.value, 1e3 * sigma),
                None => format!("{:.4}", 1e3 * p.value),
            });
            let _ = write!(text, " {cell} |");
        }
        text.push('\n');
    }
    text
}

/// The title, and the input of the run.
pub(super) fn about(story: &Story<'_>) -> String {
    let input = &story.input;
    let seed = input.seed.map_or_else(|| "–".to_owned(), |seed| seed.to_string());
    format!(
        "# {}\n\n{} · {} · seed {seed} · sha256 `{}`\n\n",
        input.name,
        Provenance::software(),
        input.kind,
        input.sha256.chars().take(12).collect::<String>()
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;

    #[test]
    fn figures_are_in_millimetres_beside_the_published_ones() {
        let outcome = synthetic::outcome(6, 2, true);
        let text = accuracy(&outcome.story());
        let row = outcome.modes[1].rows[0].expect("a row");
        assert!(text.contains(&format!("| only calibration | {:.3} |", 1e3 * row.max.x)), "{text}");
        assert!(
            text.contains("| *published* | *2.4* | *0.9* | *2.0* | *0.6* | *2.4* | *0.8* | | |"),
            "{text}"
        );
        // Two published rows, both of the identification set.
        assert_eq!(text.matches("published").count(), 2);
        assert_eq!(text.matches("RMS 3-D").count(), 2);
    }

    #[test]
    fn the_strongest_correlation_comes_first_with_both_names() {
        let outcome = synthetic::outcome(3, 1, true);
        let mut estimate = outcome.modes[1].estimate.clone().expect("identified");
        let n = estimate.parameters.len();
        let mut covariance = nalgebra::DMatrix::identity(n, n);
        covariance[(4, 3)] = -0.9;
        covariance[(1, 0)] = 0.5;
        estimate.covariance = Some(covariance);
        let text = correlations(Mode::OnlyCalibration, &estimate, 5);
        let row = format!("| 1 | -0.900 | {} | {} |", estimate.parameters[4].id, estimate.parameters[3].id);
        assert!(text.contains(&row), "{text}");
        assert!(text.contains("| 2 | +0.500 |") && !text.contains("| 3 |"), "{text}");
        estimate.covariance = None;
        assert!(correlations(Mode::OnlyCalibration, &estimate, 5).contains("singular"));
    }

    #[test]
    fn every_iteration_of_every_mode_has_its_row() {
        let mut outcome = synthetic::outcome(3, 1, true);
        let estimate = outcome.modes[1].estimate.as_mut().expect("identified");
        estimate.iterations[2].accepted = false;
        let text = convergence(&outcome.story());
        assert_eq!(text.matches("| 5 |").count(), 4, "{text}");
        assert_eq!(text.matches("| 3 (refused) |").count(), 1);
        // All of them end where the estimate is.
        assert_eq!(text.matches("| 0.00e0 |").count(), 4, "{text}");
    }

    #[test]
    fn parameters_stand_beside_their_truth_where_there_is_one() {
        let mut outcome = synthetic::outcome(3, 1, true);
        let text = parameters(&outcome.story());
        assert!(text.contains("| delta_theta4 | mrad | -17.1000 | -16.2450 ± 0.0162 |"), "{text}");
        outcome.truth = None;
        let text = parameters(&outcome.story());
        assert!(text.contains("| delta_theta4 | mrad |  | -16.2450 ± 0.0162 |"), "{text}");
    }
}
