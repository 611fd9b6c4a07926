//! Planned poses: tables on the terminal, `plan.csv`, `plan.json` and `plan.html`.

mod figure;
mod json;
mod page;

pub use json::{PLAN_SCHEMA, json_plan, plan_json_text};
pub use page::plan_html;

use std::path::Path;

use crate::pose_plan::{PosePlan, plan_csv};
use crate::report::files::{ReportError, write_all};
use crate::report::terminal::{Ink, Style, wrap};
use crate::report::words::{counted, parameter_words, printable, printed_unit};
use calibrig_estimation::planning::OrderCost;

/// Parameters that are named because the poses tell least of them.
const WEAKEST: usize = 6;

/// Writes `plan.csv`, `plan.json` and `plan.html` to `folder`, which exists. All are complete before one takes its name.
pub fn write_plan(plan: &PosePlan, folder: &Path) -> Result<(), ReportError> {
    let (page, document) = (plan_html(plan)?, plan_json_text(plan)?);
    write_all(folder, &[("plan.html", page), ("plan.json", document), ("plan.csv", plan_csv(plan))])
}

/// Micrometres of a standard deviation, with the digits that it is worth.
fn um(metres: f64) -> String {
    let um = 1e6 * metres;
    match um {
        _ if !um.is_finite() => "-".to_owned(),
        _ if um < 99.95 => format!("{um:.1}"),
        _ => format!("{um:.0}"),
    }
}

/// "30 poses of 2000 candidates by I".
fn title(plan: &PosePlan) -> String {
    let further = if plan.measured > 0 { "further " } else { "" };
    format!(
        "Plan, {}: {} {further}{} of {} by {}, {}",
        plan.name,
        plan.poses.len(),
        if plan.poses.len() == 1 { "pose" } else { "poses" },
        counted(plan.candidates, "candidate"),
        plan.criterion.key(),
        plan.mode.title().to_lowercase()
    )
}

/// What the plan is worth, in sentences.
fn sentences(plan: &PosePlan) -> Vec<String> {
    let mut lines = Vec::new();
    let figure = plan.figure.words();
    let before = if plan.measured > 0 {
        format!(" with the {} that are measured", counted(plan.measured, "pose"))
    } else {
        String::new()
    };
    if let Some(predicted) = plan.predicted() {
        lines.push(format!(
            "{}{before} predict the target within {} um ({figure}: standard deviation of the 3-D error, in {}).",
            counted(plan.poses.len(), "planned pose"),
            um(predicted),
            plan.region
        ));
    }
    let of_machine = plan.figures.accuracy.map_or(0.0, |accuracy| plan.figure.of(&accuracy.of_machine));
    lines.push(if of_machine > 0.0 {
        format!("Of that, {} um are the machine's scatter from approach to approach, which no calibration removes.", um(of_machine))
    } else {
        "The scatter of the machine from approach to approach is not stated, and the real error is larger by it: state it with --actuator-sigma.".to_owned()
    });
    if let Some(knee) = plan.growth.knee {
        lines.push(format!("The curve bends at {}: further poses help less.", counted(knee, "pose")));
    }
    lines.extend(plan.needed_words().map(|words| format!("Accuracy: {words}.")));
    if !plan.settled {
        lines.push(
            "The search was stopped before it had settled: run it longer, and a better plan may be found."
                .to_owned(),
        );
    }
    lines
}

/// A line of the comparison: poses, what the parameters leave open, and that with the machine's noise, m.
struct Compared {
    name: String,
    poses: usize,
    of_parameters: f64,
    with_machine: f64,
}

/// The plan beside random poses.
fn compared(plan: &PosePlan) -> Vec<Compared> {
    let own = plan.figures.accuracy.map(|accuracy| Compared {
        name: "planned".to_owned(),
        poses: plan.poses.len(),
        of_parameters: plan.figure.of(&accuracy.of_parameters),
        with_machine: plan.figure.of(&accuracy.with_machine),
    });
    let drawn = plan.random.iter().map(|drawn| {
        let [with_machine, of_parameters] = drawn.medians();
        let name = format!("random, median of {} draws", drawn.values.len());
        Compared { name, poses: drawn.poses, of_parameters, with_machine }
    });
    own.into_iter().chain(drawn).collect()
}

/// The tables in micrometres; at most 100 columns wide.
pub fn render_plan(plan: &PosePlan, style: Style) -> String {
    let heading = |words: &str| style.paint(Ink::Heading, &printable(words));
    let wrapped = |words: &str| wrap(&printable(words), "    ");
    let mut lines = vec![heading(&title(plan)), String::new()];
    lines.extend(sentences(plan).iter().flat_map(|words| wrapped(words)));
    lines.push(String::new());
    lines.push(heading(&format!("Predicted standard deviation, um: {}", plan.figure.words())));
    lines.push(format!("{:<34}{:>7}{:>14}{:>18}", "", "poses", "calibration", "with the machine"));
    for own in compared(plan) {
        let (calibration, with) = (um(own.of_parameters), um(own.with_machine));
        lines.push(format!("{:<34}{:>7}{calibration:>14}{with:>18}", own.name, own.poses));
    }
    lines.push(String::new());
    lines.push(heading("Accuracy against number of poses, um, with the machine"));
    lines.push(format!("{:>7}{:>10}{:>10}{:>10}{:>10}  {}", "poses", "RMS", "mean", "95 %", "largest", ""));
    for point in &plan.growth.points {
        let spread = &point.accuracy.with_machine;
        let mark = match point.count {
            count if Some(count) == plan.growth.knee && count == plan.poses.len() => "<- the plan, the knee",
            count if Some(count) == plan.growth.knee => "<- the knee",
            count if count == plan.poses.len() => "<- as many as the plan",
            _ => "",
        };
        let line = format!(
            "{:>7}{:>10}{:>10}{:>10}{:>10}  {mark}",
            point.count,
            um(spread.rms),
            um(spread.mean),
            um(spread.quantile_95),
            um(spread.largest)
        );
        lines.push(line.trim_end().to_owned());
    }
    let floor = &plan.growth.floor.with_machine;
    let cells =
        [floor.rms, floor.mean, floor.quantile_95, floor.largest].map(|value| format!("{:>10}", um(value)));
    lines.push(format!("{:>7}{}  no number of these candidates betters that", "all", cells.concat()));
    lines.push(String::new());
    lines.push(heading(&format!("Parameters: {}, of which these are told least", plan.parameters.len())));
    for (id, sigma) in plan.weakest(WEAKEST) {
        let (unit, scale) = printed_unit(id.unit());
        lines.push(format!(
            "  {:<22}{:>12} {unit:<5} {}",
            id.to_string(),
            format!("+- {:.4}", scale * sigma),
            parameter_words(id)
        ));
    }
    lines.push(String::new());
    lines.push(heading("Order"));
    lines.push(format!(
        "{:<24}{:>12}{:>13}{:>13}{:>11}",
        "", "driving, s", "imbalance", "drift taken", "cost, s"
    ));
    for (name, cost) in [("as the candidates come", plan.order.before), ("as planned", plan.order.after)] {
        lines.push(order_line(name, &cost));
    }
    lines.push(String::new());
    lines.extend(wrapped(&candidate_words(plan)));
    for (why, count) in &plan.refused {
        lines.push(style.paint(Ink::Dim, &format!("{count:>9}  {}", printable(why))));
    }
    for remark in &plan.remarks {
        lines.extend(wrapped(remark).iter().map(|line| style.paint(Ink::Warning, line)));
    }
    lines.push(String::new());
    lines.join("\n")
}

fn order_line(name: &str, cost: &OrderCost) -> String {
    format!(
        "{name:<24}{:>12.0}{:>13.3}{:>12.1}%{:>11.0}",
        cost.travel,
        cost.imbalance,
        1e2 * cost.drift,
        cost.total
    )
}

fn candidate_words(plan: &PosePlan) -> String {
    let robots = if plan.robots > 0 {
        format!(
            " The plan is for the nominal robot and {} as they could have been made.",
            counted(plan.robots as usize, "robot")
        )
    } else {
        String::new()
    };
    let refused: usize = plan.refused.iter().map(|(_, count)| count).sum();
    let left_out = if refused > 0 { format!("; {refused} are left out:") } else { ".".to_owned() };
    format!(
        "{} can be measured of {} that were looked at, from {}{left_out}{robots}",
        counted(plan.candidates, "candidate"),
        plan.looked,
        plan.source
    )
}
