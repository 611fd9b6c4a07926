//! Numbers and names as the page has them.

use maud::{Markup, PreEscaped, html};

use crate::montecarlo::{AccuracySet, GroupSummary, MeanWithInterval, Rate, decimals, with_interval};
use crate::report::files::ReportError;
use crate::report::words::{cut, number};
use calibrig_campaign::statistics::{Estimated, Interval};

/// Characters of a text from a file that are shown.
const LONGEST: usize = 400;
/// From metres to what the page has.
pub(super) const MM: f64 = 1e3;
/// Lengths below this are shown in micrometres, m.
const SMALL: f64 = 5e-5;
/// What is not known.
pub(super) const NONE: &str = "\u{2013}";

/// A text from a file, on one line.
pub(super) fn shown(text: &str) -> String {
    cut(text, LONGEST)
}

/// Characters of a level or of the name of a factor that are shown.
const NAME: usize = 60;

/// A level of a factor: TOML's quotes of texts are left out.
pub(super) fn level(text: &str) -> String {
    name(text.strip_prefix('"').and_then(|t| t.strip_suffix('"')).unwrap_or(text))
}

/// The name of a factor.
pub(super) fn name(text: &str) -> String {
    cut(text, NAME)
}

/// The levels of a combination.
pub(super) fn levels(group: &GroupSummary) -> String {
    group.levels.iter().map(|text| level(text)).collect::<Vec<_>>().join(", ")
}

/// What a set is called within a sentence.
pub(super) fn set_words(kind: AccuracySet) -> &'static str {
    kind.title()
}

/// What a set is called above a table.
pub(super) fn set_title(kind: AccuracySet) -> String {
    let title = kind.title();
    let mut letters = title.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// A count with thin spaces between thousands.
pub(super) fn count(value: u64) -> String {
    let digits = value.to_string();
    let mut text = String::new();
    for (place, digit) in digits.chars().enumerate() {
        if place > 0 && (digits.len() - place).is_multiple_of(3) {
            text.push('\u{202f}');
        }
        text.push(digit);
    }
    text
}

pub(super) fn mean(mean: &MeanWithInterval, factor: f64) -> String {
    with_interval(mean.mean, mean.interval(), factor, number)
}

pub(super) fn estimate(estimate: &Estimated, factor: f64) -> String {
    with_interval(estimate.value, estimate.interval, factor, number)
}

/// Figure, and its interval below it.
pub(super) fn stacked(value: f64, interval: Option<Interval>, factor: f64) -> Markup {
    let digits = interval.map_or(3, |interval| decimals(factor * interval.half_width()));
    html! {
        (number(factor * value, digits))
        @if let Some(interval) = interval { br; span.note { (bracket(&interval, factor, digits)) } }
    }
}

pub(super) fn bracket(interval: &Interval, factor: f64, digits: usize) -> String {
    format!("[{}, {}]", number(factor * interval.low, digits), number(factor * interval.high, digits))
}

/// "195 of 200", with the share and its interval below it.
pub(super) fn rate(rate: &Rate) -> Markup {
    html! {
        (share(&rate.share)) br;
        span.note { (count(rate.hits)) " of " (count(rate.trials)) }
    }
}

/// A share in percent with its interval.
pub(super) fn share(share: &Estimated) -> String {
    let Some(interval) = share.interval else { return format!("{} %", number(1e2 * share.value, 1)) };
    let digits = decimals(1e2 * interval.half_width()).clamp(1, 3);
    format!("{} % {}", number(1e2 * share.value, digits), bracket(&interval, 1e2, digits))
}

/// The unit in which lengths of up to so many metres have few digits, and what they are multiplied with.
pub(super) fn unit(metres: f64) -> (&'static str, f64) {
    if metres.abs() < SMALL { ("\u{b5}m", 1e6) } else { ("mm", MM) }
}

/// An index, which is of the order of 1.
pub(super) fn index(estimate: &Estimated) -> String {
    with_interval(estimate.value, estimate.interval, 1.0, |value, digits| number(value, digits.min(3)))
}

/// A length for people, such as a tolerance.
pub(super) fn millimetres(metres: f64) -> String {
    // What was stated in mm has few digits.
    let text = format!("{:.6}", MM * metres);
    let text = text.trim_end_matches('0').trim_end_matches('.');
    format!("{text} mm")
}

/// A figure, or why there is none: the page has the numbers all the same.
pub(super) fn drawn(figure: Result<String, ReportError>) -> Markup {
    match figure {
        Ok(svg) => html! { div.scroll { (PreEscaped(svg)) } },
        Err(error) => html! { p.note { (error) } },
    }
}
