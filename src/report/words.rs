//! Numbers, counts and names as people read them, the same on the terminal and on every page.

use std::collections::BTreeSet;

use crate::pipeline::{CarriedReport, SetKind, SetOutcome};
use calibrig_estimation::identification::Estimate;
use calibrig_estimation::identification::LeftOutReason;
use calibrig_model::{ParameterId, Payload, Unit};

/// Number of distinct poses of a set.
pub(super) fn pose_count(set: &SetOutcome) -> usize {
    set.measurements.observations.iter().map(|o| o.pose).collect::<BTreeSet<_>>().len()
}

/// "60 poses", or "60 poses (120 observations)" where several targets or stations are seen at a pose.
pub(super) fn pose_words(set: &SetOutcome) -> String {
    let (poses, observations) = (pose_count(set), set.measurements.observations.len());
    if poses == observations {
        counted(poses, "pose")
    } else {
        format!("{} ({})", counted(poses, "pose"), counted(observations, "observation"))
    }
}

/// What the flange carried: "nothing at 20 poses, 25 kg (25.0 kg) at 20 poses"; `None` where it never carried anything.
pub(super) fn payload_words(set: &SetOutcome) -> Option<String> {
    let carried = set.measurements.payloads();
    let words =
        |(payload, poses): &(Option<&Payload>, usize)| CarriedReport::of(*payload, *poses).to_string();
    (!carried.is_empty()).then(|| carried.iter().map(words).collect::<Vec<_>>().join(", "))
}

/// "1 pose", "2 poses".
pub(super) fn counted(n: usize, noun: &str) -> String {
    if n == 1 { format!("1 {noun}") } else { format!("{n} {noun}s") }
}

/// What was left out of a fit, reason by reason. What cannot be told from others is a warning of its own.
pub(super) fn left_out_words(estimate: &Estimate) -> Vec<String> {
    let mut reasons: Vec<(&str, Vec<String>)> = Vec::new();
    for left in estimate.left_out.iter().filter(|left| left.reason != LeftOutReason::Redundant) {
        let (name, words) = (left.id.to_string(), left.reason.words());
        match reasons.iter_mut().find(|(known, _)| *known == words) {
            Some((_, names)) => names.push(name),
            None => reasons.push((words, vec![name])),
        }
    }
    reasons.into_iter().map(|(reason, names)| format!("{}: {reason}", names.join(", "))).collect()
}

pub(super) fn set_title(kind: SetKind) -> &'static str {
    match kind {
        SetKind::Identification => "Identification set",
        SetKind::Verification => "Verification set",
    }
}

/// A condition number for people.
pub(super) fn condition_words(condition: f64) -> String {
    if !condition.is_finite() {
        "infinite".to_owned()
    } else if condition < 1e5 {
        format!("{condition:.0}")
    } else {
        format!("{condition:.1e}")
    }
}

/// `sqrt(chi2 / dof)` where the readings state their noise; from residual-scaled noise it would say nothing.
pub(super) fn consistency_ratio(estimate: &Estimate) -> Option<f64> {
    match estimate.noise {
        calibrig_estimation::identification::NoiseScale::Stated => estimate.chi2_per_dof().map(f64::sqrt),
        calibrig_estimation::identification::NoiseScale::Residuals(_) => None,
    }
}

/// A length with three significant digits in mm, at most three decimals; in µm below 0.01 mm.
pub(super) fn length_words(metres: f64) -> String {
    if !metres.is_finite() {
        return "unknown".to_owned();
    }
    let (value, unit) = if metres.abs() < 1e-5 { (1e6 * metres, "µm") } else { (1e3 * metres, "mm") };
    // The unit stays on the line of its number.
    format!("{}\u{a0}{unit}", significant(value))
}

/// Three significant digits, at most three decimals.
pub(super) fn significant(value: f64) -> String {
    if !value.is_finite() {
        return "unknown".to_owned();
    }
    if value.abs() >= 1e6 {
        return format!("{value:.2e}");
    }
    let decimals = if value.abs() >= 99.95 {
        0
    } else if value.abs() >= 9.995 {
        1
    } else if value.abs() >= 0.9995 {
        2
    } else {
        3
    };
    format!("{value:.decimals$}").replace('-', "\u{2212}")
}

/// "9.4 times less than `reference`", "1.3 times more than ...", "as much as ...".
pub(super) fn factor_words(before: f64, after: f64, reference: &str) -> String {
    let factor = before / after;
    if !factor.is_finite() || factor <= 0.0 {
        format!("not comparable with {reference}")
    } else if factor >= 1.005 {
        format!("{} times less than {reference}", significant(factor))
    } else if factor <= 0.995 {
        format!("{} times more than {reference}", significant(1.0 / factor))
    } else {
        format!("as much as {reference}")
    }
}

pub(super) fn signed_percent(share: f64) -> String {
    if share.is_finite() {
        format!("{:+.0}\u{a0}%", 100.0 * share).replace('-', "\u{2212}")
    } else {
        "an unknown amount".to_owned()
    }
}

pub(super) fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// A part of a whole in per cent, with a decimal where it is small.
pub(super) fn percent(share: f64) -> String {
    let percent = 1e2 * share.clamp(0.0, 1.0);
    if percent >= 9.95 || percent == 0.0 {
        format!("{percent:.0} %")
    } else if percent >= 0.1 {
        format!("{percent:.1} %")
    } else {
        "less than 0.1 %".to_owned()
    }
}

/// A number for a table.
pub(super) fn number(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return "\u{2013}".to_owned();
    }
    if value.abs() >= 1e6 {
        return format!("{value:.1e}").replace('-', "\u{2212}");
    }
    let text = format!("{value:.decimals$}");
    // What rounds to zero has no sign.
    match text.strip_prefix('-') {
        Some(digits) if digits.contains(|c| ('1'..='9').contains(&c)) => format!("\u{2212}{digits}"),
        Some(digits) => digits.to_owned(),
        None => text,
    }
}

/// Control characters from names in files must not reach the terminal.
pub(super) fn printable(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { '\u{fffd}' } else { c }).collect()
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
    use calibrig_model::{Compliance, LinkTerm, LinkageTerm};
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
        ParameterId::Orientation { target, axis } => {
            format!("target {} turned on the flange, about its {}", target + 1, AXES[axis % 3])
        }
        ParameterId::Compliance(Compliance::Drive { joint }) => format!("compliance of drive {}", joint + 1),
        ParameterId::Compliance(Compliance::Bearing { joint, axis }) => {
            let how = if axis < 3 { "along" } else { "about" };
            format!("compliance of bearing {}, {how} {}", joint + 1, AXES[axis % 3])
        }
        ParameterId::Compliance(Compliance::Beam { link }) => format!("compliance of link {}", link + 1),
        ParameterId::Compliance(Compliance::Rod) => "compliance of the coupler rod".to_owned(),
        ParameterId::Mass { link } => format!("mass of link {}", link + 1),
        ParameterId::Centre { link, axis } => {
            format!("centre of mass of link {}, {}", link + 1, AXES[axis % 3])
        }
        ParameterId::Linkage(LinkageTerm::Crank) => "length of the crank".to_owned(),
        ParameterId::Linkage(LinkageTerm::Lever) => "length of the lever".to_owned(),
        ParameterId::Linkage(LinkageTerm::Rod) => "length of the coupler rod".to_owned(),
        ParameterId::Linkage(LinkageTerm::AxisX) => "crank's axis off the shoulder's, along x".to_owned(),
        ParameterId::Linkage(LinkageTerm::AxisY) => "crank's axis off the shoulder's, along y".to_owned(),
        ParameterId::Linkage(LinkageTerm::AxisRx) => "tilt of the crank's axis, about x".to_owned(),
        ParameterId::Linkage(LinkageTerm::AxisRy) => "tilt of the crank's axis, about y".to_owned(),
        ParameterId::Term(term) => format!("{}: {term}", term.family().about()),
        ParameterId::Instrument { instrument, term } => {
            format!("tracker {}: {}", instrument + 1, term.about())
        }
        ParameterId::Drift { station, component } => {
            let how = if component < 3 { "along" } else { "about" };
            format!("drift of station {} in an hour, {how} {}", station + 1, AXES[component % 3])
        }
    }
}

/// The first `most` characters, and that there are more.
pub(super) fn cut(text: &str, most: usize) -> String {
    let short: String = text.chars().take(most).collect();
    let more = if short.len() < text.len() { "\u{2026}" } else { "" };
    printable(&format!("{}{more}", short.trim()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_has_no_sign_and_what_is_no_number_is_a_dash() {
        assert_eq!(
            [-4e-5, -6e-5, 0.0, f64::NAN].map(|v| number(v, 4)),
            ["0.0000", "\u{2212}0.0001", "0.0000", "\u{2013}"]
        );
    }
}
