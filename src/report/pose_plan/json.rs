//! `plan.json`.

use serde_json::{Value, json};

use crate::pose_plan::PosePlan;
use crate::report::document::axes;
use crate::report::document::{finite, json_text};
use crate::report::files::ReportError;
use calibrig_estimation::planning::{Accuracy, Needed, OrderCost, Spread};
use calibrig_model::{JointKind, Unit};

/// The schema of `plan.json`.
pub const PLAN_SCHEMA: &str = "calibrig.plan/1";

/// The text of `plan.json`.
pub fn plan_json_text(plan: &PosePlan) -> Result<String, ReportError> {
    json_text(&json_plan(plan))
}

fn spread(spread: &Spread) -> Value {
    json!({
        "rms_m": finite(spread.rms),
        "mean_m": finite(spread.mean),
        "q95_m": finite(spread.quantile_95),
        "largest_m": finite(spread.largest),
    })
}

fn accuracy(accuracy: &Accuracy) -> Value {
    json!({
        "of_parameters": spread(&accuracy.of_parameters),
        "with_machine": spread(&accuracy.with_machine),
        "of_machine": spread(&accuracy.of_machine),
    })
}

fn order(cost: &OrderCost) -> Value {
    json!({
        "driving_s": finite(cost.travel),
        "imbalance": finite(cost.imbalance),
        "drift_taken": finite(cost.drift),
        "cost_s": finite(cost.total),
    })
}

fn needed(needed: &Needed) -> Value {
    match needed {
        Needed::Poses { count, reached } => json!({ "poses": count, "reached_m": finite(*reached) }),
        Needed::BelowMachine { floor } => {
            json!({ "poses": null, "why": "machine", "floor_m": finite(*floor) })
        }
        Needed::BelowCandidates { floor } => {
            json!({ "poses": null, "why": "candidates", "floor_m": finite(*floor) })
        }
        Needed::MoreThan { count, reached } => {
            json!({ "poses": null, "why": "most", "most": count, "reached_m": finite(*reached) })
        }
        _ => json!({ "poses": null, "why": "unknown" }),
    }
}

/// The document.
pub fn json_plan(plan: &PosePlan) -> Value {
    let figures = &plan.figures;
    let unit = |unit| match unit {
        Unit::Metre => "m",
        Unit::Radian => "rad",
        Unit::One => "1",
    };
    let parameters: Vec<Value> = plan
        .parameters
        .iter()
        .zip(&figures.sigmas)
        .map(
            |(id, sigma)| json!({ "name": id.to_string(), "unit": unit(id.unit()), "sigma": finite(*sigma) }),
        )
        .collect();
    let joints: Vec<Value> = plan
        .links
        .iter()
        .zip(&plan.region_ranges)
        .zip(&plan.commanded)
        .map(|(((name, kind, limits), region), commanded)| {
            json!({
                "name": name,
                "unit": if *kind == JointKind::Prismatic { "m" } else { "rad" },
                "commanded": commanded,
                "limits": limits.map(finite),
                "region": region.map(finite),
            })
        })
        .collect();
    let poses: Vec<Value> = plan
        .poses
        .iter()
        .map(|own| {
            json!({ "pose": own.pose, "joints": own.joints, "command": own.command, "approach": own.approach, "target_m": axes(own.target) })
        })
        .collect();
    let o = &figures.observability;
    json!({
        "schema": PLAN_SCHEMA,
        "software": { "name": "calibrig", "version": env!("CARGO_PKG_VERSION") },
        "name": plan.name,
        "mode": plan.mode.key(),
        "criterion": plan.criterion.key(),
        "value": finite(plan.value),
        "settled": plan.settled,
        "seed": plan.seed,
        "robots": plan.robots,
        "measured_before": plan.measured,
        "region": plan.region,
        "figure": plan.figure.key(),
        "joints": joints,
        "trackers_m": plan.trackers.iter().copied().map(axes).collect::<Vec<_>>(),
        "candidates": {
            "from": plan.source,
            "looked_at": plan.looked,
            "measurable": plan.candidates,
            "refused": plan.refused.iter().map(|(why, count)| json!({ "why": why, "count": count })).collect::<Vec<_>>(),
        },
        "poses": poses,
        "accuracy": figures.accuracy.as_ref().map(accuracy),
        "parameters": parameters,
        "observability": { "o1": finite(o.o1), "o2": finite(o.o2), "o3": finite(o.o3), "o4": finite(o.o4), "o5": finite(o.o5) },
        "random": plan.random.iter().map(|drawn| json!({
            "poses": drawn.poses,
            "draws": drawn.draws,
            "median_m": finite(drawn.medians()[0]),
            "of_parameters_median_m": finite(drawn.medians()[1]),
            "values_m": drawn.values.iter().copied().map(finite).collect::<Vec<_>>(),
        })).collect::<Vec<_>>(),
        "growth": {
            "points": plan.growth.points.iter().map(|point| json!({ "poses": point.count, "accuracy": accuracy(&point.accuracy) })).collect::<Vec<_>>(),
            "floor": accuracy(&plan.growth.floor),
            "knee": plan.growth.knee,
        },
        "asked_accuracy_m": plan.accuracy,
        "needed": plan.needed.as_ref().map(needed),
        "order": { "before": order(&plan.order.before), "after": order(&plan.order.after) },
        "remarks": plan.remarks,
    })
}
