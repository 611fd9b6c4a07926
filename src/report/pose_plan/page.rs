//! `plan.html`: one file that opens anywhere, without scripts and without anything fetched.

use maud::{Markup, PreEscaped, html};

use super::figure::{curve, joints, places};
use super::{WEAKEST, candidate_words, compared, sentences, um};
use crate::pose_plan::PosePlan;
use crate::report::files::ReportError;
use crate::report::markup::{key, page};
use crate::report::plots::LOOKS;
use crate::report::words::{parameter_words, printed_unit};
use calibrig_estimation::planning::OrderCost;
use calibrig_model::JointKind;

/// Poses that are listed; more are in plan.csv.
const LISTED: usize = 500;

/// The page of a plan.
pub fn plan_html(plan: &PosePlan) -> Result<String, ReportError> {
    let (curve, places, joints) = (curve(plan)?, places(plan)?, joints(plan)?);
    let body = html! {
        (header(plan))
        main {
            section {
                h2 { "Summary" }
                ul { @for line in sentences(plan) { li { (line) } } }
                div.scroll { table {
                    thead { tr { th {} th { "poses" } th { "calibration, \u{b5}m" } th { "with the machine, \u{b5}m" } } }
                    tbody { @for own in compared(plan) {
                        tr { th scope="row" { (own.name) } td { (own.poses) } td { (um(own.of_parameters)) } td { (um(own.with_machine)) } }
                    } }
                } }
                p.note { "Standard deviations of the predicted place of the target, 3-D, " (plan.figure.words()) ". \u{201c}Calibration\u{201d} is what the parameters leave open; \u{201c}with the machine\u{201d} adds its scatter from approach to approach. For random poses: the median." }
                @if !plan.remarks.is_empty() { ul.warnings { @for line in &plan.remarks { li { (line) } } } }
            }
            section {
                h2 { "How many poses" }
                figure {
                    div.legend {
                        span { (key(&LOOKS[2])) "best plans with the machine's scatter, the knee in a circle" }
                        span { (key(&LOOKS[1])) "what their calibration leaves open" }
                        @if !plan.random.is_empty() { span { (key(&LOOKS[0])) "random poses of the region, median, of both" } }
                        span { (key(&LOOKS[4])) "all candidates, as often as one likes (dashed)" }
                        @if plan.accuracy.is_some() { span { (key(&LOOKS[3])) "asked for (dashed)" } }
                    }
                    div.scroll { (PreEscaped(curve)) }
                    figcaption { "Standard deviation of predicted places of the target, with what the machine does beside its model: " (plan.figure.words()) ", in " (plan.region) "." }
                }
                (growth_table(plan))
            }
            section {
                h2 { "Where" }
                figure {
                    div.legend {
                        span { (key(&LOOKS[2])) "planned" }
                        span { (key(&LOOKS[4])) "the working region" }
                        @if !plan.trackers.is_empty() { span { (key(&LOOKS[0])) "tracker" } }
                        span { "dots: candidates" }
                    }
                    div.scroll { (PreEscaped(places)) }
                    figcaption { "Places of the target in the base frame." }
                }
                figure {
                    div.legend { span { (key(&LOOKS[2])) "planned" } span { (key(&LOOKS[4])) "the working region" } }
                    div.scroll { (PreEscaped(joints)) }
                    figcaption { "Every joint from its lower to its upper limit." }
                }
                p { (candidate_words(plan)) }
                @if !plan.refused.is_empty() {
                    table { tbody { @for (why, count) in &plan.refused { tr { th scope="row" { (why) } td { (count) } } } } }
                }
            }
            (parameter_section(plan))
            (pose_section(plan))
        }
    };
    Ok(page(&format!("Plan: {}", plan.name), &body))
}

fn header(plan: &PosePlan) -> Markup {
    html! {
        header {
            p.eyebrow { "Planned poses" }
            h1 { (plan.name) }
            dl.facts {
                div { dt { "Poses" } dd { (plan.poses.len()) @if plan.measured > 0 { ", after " (plan.measured) " that are measured" } } }
                div { dt { "Criterion" } dd { (plan.criterion.key()) } }
                div { dt { "Model" } dd { (plan.mode.title()) } }
                div { dt { "Parameters" } dd { (plan.parameters.len()) } }
                div { dt { "Candidates" } dd { (plan.candidates) } }
                div { dt { "Seed" } dd { (plan.seed) } }
                div { dt { "Software" } dd { "calibrig " (env!("CARGO_PKG_VERSION")) } }
            }
        }
    }
}

fn growth_table(plan: &PosePlan) -> Markup {
    let line = |name: &str, spread: &calibrig_estimation::planning::Spread| {
        html! {
            tr {
                th scope="row" { (name) }
                @for value in [spread.rms, spread.mean, spread.quantile_95, spread.largest] { td { (um(value)) } }
            }
        }
    };
    html! {
        div.scroll { table {
            thead { tr { th { "poses" } th { "RMS, \u{b5}m" } th { "mean" } th { "95 % stay below" } th { "largest" } } }
            tbody {
                @for point in &plan.growth.points { (line(&point.count.to_string(), &point.accuracy.with_machine)) }
                (line("all candidates", &plan.growth.floor.with_machine))
            }
        } }
    }
}

fn parameter_section(plan: &PosePlan) -> Markup {
    html! {
        section {
            h2 { "Parameters" }
            p { "The parameters that these poses determine least, ordered by how far one standard deviation moves the readings:" }
            div.scroll { table {
                thead { tr { th { "parameter" } th { "standard deviation" } th { "unit" } th {} } }
                tbody {
                    @for (id, sigma) in plan.weakest(2 * WEAKEST) {
                        @let (unit, scale) = printed_unit(id.unit());
                        tr { th scope="row" { (id) } td { (format!("{:.4}", scale * sigma)) } td { (unit) } td.words { (parameter_words(id)) } }
                    }
                }
            } }
        }
    }
}

fn order_row(name: &str, cost: &OrderCost) -> Markup {
    html! {
        tr {
            th scope="row" { (name) }
            td { (format!("{:.0}", cost.travel)) }
            td { (format!("{:.3}", cost.imbalance)) }
            td { (format!("{:.1}", 1e2 * cost.drift)) }
            td { (format!("{:.0}", cost.total)) }
        }
    }
}

fn pose_section(plan: &PosePlan) -> Markup {
    let joints: Vec<usize> = (0..plan.links.len()).filter(|joint| plan.commanded[*joint]).collect();
    let cell = |value: f64, kind: JointKind| {
        let text = match kind {
            JointKind::Prismatic => format!("{:.2}", 1e3 * value),
            JointKind::Revolute => format!("{:.3}", value.to_degrees()),
        };
        text.replace('-', "\u{2212}")
    };
    let side = |sign: i8| match sign {
        1 => "\u{2191}",
        -1 => "\u{2193}",
        _ => "",
    };
    html! {
        section {
            h2 { "Poses in their order" }
            div.scroll { table {
                thead { tr { th {} th { "driving, s" } th { "imbalance" } th { "drift taken, %" } th { "cost, s" } } }
                tbody { (order_row("as the candidates come", &plan.order.before)) (order_row("as planned", &plan.order.after)) }
            } }
            p.note {
                "Driving: the sum over all moves of the time of the slowest joint. Imbalance: how unequally the joints approach from their two sides (sum of squared differences). "
                "Drift taken: the part of a steady drift that a fit would mistake for parameters. An arrow shows from which side a joint comes to the pose."
            }
            div.scroll { table {
                thead { tr {
                    th { "pose" }
                    @for joint in &joints {
                        @let (name, kind, _) = &plan.links[*joint];
                        th { (name) ", " @if *kind == JointKind::Prismatic { "mm" } @else { "\u{b0}" } }
                    }
                    th { "x, m" } th { "y" } th { "z" }
                } }
                tbody {
                    @for own in plan.poses.iter().take(LISTED) {
                        tr {
                            th scope="row" { (own.pose) }
                            @for joint in &joints {
                                td { (cell(own.joints[*joint], plan.links[*joint].1)) " " (side(own.approach.get(*joint).copied().unwrap_or(0))) }
                            }
                            @for axis in 0..3 { td { (format!("{:.3}", own.target[axis]).replace('-', "\u{2212}")) } }
                        }
                    }
                }
            } }
            @if plan.poses.len() > LISTED { p.note { "And " (plan.poses.len() - LISTED) " more: plan.csv." } }
        }
    }
}
