//! The report on the terminal: the published tables, with what ours says and what the publication says one below the other.

use super::ablation::ablation_lines;
use super::acceptance_bounds::acceptance_lines;
use super::accuracy::table;
use super::closed_loop::closed_loop_lines;
use super::drift::{drift_words, missing_words};
use super::judgement::judgement_lines;
use super::parameter_section::parameter_lines;
use super::sensors::sensor_lines;
use super::splits::split_lines;
use super::sweeps::sweep_words;
use super::terminal::{Ink, Style, millimetres, wrap};
use super::words::{condition_words, consistency_ratio, counted, left_out_words, printable};
use crate::pipeline::Outcome;
use calibrig_estimation::identification::{Assumption, Estimate, NoiseScale, Warning};

/// The tables of a run in mm, the published figures below each row, and how every estimate ended. At most 100 columns wide.
pub fn render_tables(outcome: &Outcome, style: Style) -> String {
    let mut lines = Vec::new();
    for (index, set) in outcome.sets.iter().enumerate() {
        lines.extend(table(outcome, index, set, style));
        lines.extend(acceptance_lines(outcome, index, style));
        lines.push(String::new());
    }
    lines.extend(outcome.closed_loop.iter().flat_map(|driven| closed_loop_lines(outcome, driven, style)));
    let drift = outcome.drift.iter().flat_map(drift_words);
    let drift = sweep_words(outcome).into_iter().chain(drift).chain(missing_words(outcome));
    lines.extend(drift.flat_map(|words| wrap(&words, "    ")));
    lines.extend(parameter_lines(outcome, style));
    for mode in &outcome.modes {
        lines.push(style.paint(Ink::Heading, mode.mode.title()));
        lines.extend(match &mode.estimate {
            Some(estimate) => state(estimate, style),
            None => wrap(&registration_words(outcome), "    "),
        });
        lines.extend(judgement_lines(outcome, mode.mode, style));
    }
    lines.extend(outcome.ablation.iter().flat_map(|ablation| ablation_lines(ablation, style)));
    lines.extend(outcome.splits.iter().flat_map(|study| split_lines(study, style)));
    lines.extend(outcome.sensors.iter().flat_map(|study| sensor_lines(study, style)));
    lines.push(String::new());
    lines.join("\n")
}

fn registration_words(outcome: &Outcome) -> String {
    let registration = &outcome.registration;
    format!(
        "  tracker registered by {}, {}, RMS {} mm",
        printable(&registration.how),
        counted(registration.poses, "pose"),
        millimetres(registration.rms)
    )
}

/// How an estimate ended, and what a user must know of it.
fn state(estimate: &Estimate, style: Style) -> Vec<String> {
    let mut lines = Vec::new();
    let mut say = |ink, words: &str, indent: &str| {
        lines.extend(style.told(ink, words, indent));
    };
    let words = format!(
        "  {} after {} ({})",
        if estimate.termination.converged() { "converged" } else { "NOT converged" },
        counted(estimate.iterations.len(), "iteration"),
        estimate.termination.words(),
    );
    say(if estimate.termination.converged() { Ink::Good } else { Ink::Warning }, &words, "    ");
    let spectrum = &estimate.spectrum;
    let noise = match (consistency_ratio(estimate), estimate.noise) {
        (_, NoiseScale::Residuals(sigma)) => format!("noise {} mm from the residuals", millimetres(sigma)),
        (Some(ratio), _) => format!("sqrt(chi2/dof) {ratio:.2}"),
        (None, _) => "no degree of freedom".to_owned(),
    };
    let words = format!(
        "  rank {} of {}, condition {}, {noise}",
        spectrum.rank,
        estimate.parameters.len(),
        condition_words(spectrum.condition)
    );
    say(if spectrum.rank < estimate.parameters.len() { Ink::Warning } else { Ink::Good }, &words, "    ");
    if !estimate.bounds.is_empty() {
        let bounds: Vec<_> = estimate.bounds.iter().map(ToString::to_string).collect();
        say(Ink::Good, &format!("  held within bounds: {}", bounds.join(", ")), "    ");
    }
    let is_found = |a: &&Assumption| {
        matches!(
            a,
            Assumption::NoiseOfReadings { .. }
                | Assumption::NoiseOfMachine(_)
                | Assumption::NoiseOfOrientations { .. }
        )
    };
    for found in estimate.assumptions.iter().filter(is_found) {
        say(Ink::Dim, &format!("  {}", printable(&found.to_string())), "    ");
    }
    if let Some(freedom) = estimate.interval_freedom.filter(|freedom| freedom.is_finite()) {
        let factor = estimate.interval_factor(0.95);
        let words = format!(
            "  95 % interval of a parameter: +- {factor:.2} sigma ({freedom:.1} degrees of freedom of the noise)"
        );
        say(Ink::Dim, &words, "    ");
    }
    for words in left_out_words(estimate) {
        say(Ink::Good, &format!("  left out: {words}"), "           ");
    }
    for warning in estimate.warnings.iter().map(Warning::to_string) {
        say(Ink::Warning, &format!("  warning: {}", printable(&warning)), "           ");
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::terminal::{LINE, NUMBER, TITLE};
    use crate::report::tests::sample;

    fn numbers(line: &str) -> Vec<f64> {
        line[TITLE..].split_whitespace().map(|n| n.parse().expect("a number")).collect()
    }

    #[test]
    fn the_numbers_are_those_of_the_outcome_in_mm_with_the_published_below() {
        let outcome = sample::simulated();
        let text = render_tables(&outcome, Style::Plain);
        let lines: Vec<_> = text.lines().collect();
        let start =
            lines.iter().position(|l| l.starts_with("Verification set, 38 poses")).expect("a heading");
        let at = start + lines[start..].iter().position(|l| l.starts_with("only cal")).expect("a row");
        let row = outcome.modes[1].rows[1].expect("a row");
        let expected =
            [row.max.x, row.mean.x, row.max.y, row.mean.y, row.max.z, row.mean.z, row.rms_3d, row.max_3d];
        for (found, metres) in numbers(lines[at]).iter().zip(expected) {
            assert!((found - 1e3 * metres).abs() <= 0.5e-3 + 1e-12, "{found} mm against {metres} m");
        }
        assert_eq!(numbers(lines[at]).len(), 8);
        assert!(lines[at + 1].starts_with("  published"));
        assert_eq!(numbers(lines[at + 1]), [2.7, 1.0, 1.9, 0.6, 3.0, 1.1]);
    }

    #[test]
    fn a_plain_report_has_no_escapes_and_no_report_is_wider_than_100_columns() {
        for outcome in [sample::simulated(), sample::measured(), sample::driven()] {
            let plain = render_tables(&outcome, Style::Plain);
            assert!(!plain.contains('\x1b'));
            for line in plain.lines() {
                assert!(line.chars().count() <= LINE, "{line}");
            }
            let coloured = render_tables(&outcome, Style::Colour);
            assert!(coloured.contains("\x1b["));
            let mut bare = coloured;
            for code in ["1", "2", "32", "33", "0"] {
                bare = bare.replace(&format!("\x1b[{code}m"), "");
            }
            assert_eq!(bare, plain);
        }
    }

    #[test]
    fn states_warnings_and_dropped_poses_are_told() {
        let text = render_tables(&sample::simulated(), Style::Plain);
        for part in
            ["rank 33 of 33", "condition 526", "sqrt(chi2/dof) 13.10", "warning: weak direction", "98 ("]
        {
            assert!(text.contains(part), "{part} in\n{text}");
        }
        let text = render_tables(&sample::measured(), Style::Plain);
        for part in ["rank 32 of 33", "condition infinite", "noise 0.310 mm", "warning: rank 32 of 33"] {
            assert!(text.contains(part), "{part} in\n{text}");
        }
        assert!(!text.contains("Verification") && !text.contains("published"));
    }

    #[test]
    fn escape_sequences_in_names_do_not_reach_the_terminal() {
        let mut outcome = sample::measured();
        outcome.registration.how = "\x1b]0;title\x07".to_owned();
        assert!(!render_tables(&outcome, Style::Plain).contains(['\x1b', '\x07']));
    }

    #[test]
    fn columns_stay_apart_whatever_the_numbers() {
        for metres in [0.0, 9.9e-7, 0.999_999_9, 12.3, 4.5e5, 1e300, f64::INFINITY, f64::NAN] {
            assert!(millimetres(metres).len() < NUMBER, "{}", millimetres(metres));
        }
    }
}
