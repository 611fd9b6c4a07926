//! Remarks on corrected commands.

use super::{CLOSED, Compensation, CompensationPlan, Corrected, End};
use crate::handover::EstimateFile;
use calibrig_estimation::compensation::{CompensatedPoint, GridError};
use calibrig_estimation::identification::Estimate;

/// "point 7 (panel.csv:8)".
pub(crate) fn called(index: usize, point: &Corrected) -> String {
    let name = if point.name.name.is_empty() { String::new() } else { format!(" {}", point.name.name) };
    let place = if point.name.place.is_empty() { String::new() } else { format!(" ({})", point.name.place) };
    format!("point {}{name}{place}", index + 1)
}

fn is_far(point: &Corrected) -> bool {
    point.point.as_ref().is_some_and(|found| found.far_correction().is_some())
}

/// "1 point", "7 points".
fn points(count: usize) -> String {
    if count == 1 { "1 point".to_owned() } else { format!("{count} points") }
}

/// "1 point is", "7 points are".
fn points_are(count: usize) -> String {
    format!("{} {}", points(count), if count == 1 { "is" } else { "are" })
}

/// What a person must look at.
pub(super) fn doubts(made: &Compensation, estimate: &Estimate, unfinished: Option<GridError>) -> Vec<String> {
    let mut doubts: Vec<String> =
        estimate.reasons().map(|reason| format!("the estimate is not sound: {reason}")).collect();
    if made.points.len() < made.asked {
        doubts.push(format!(
            "interrupted after {} of {}: the rest is not corrected",
            made.points.len(),
            points(made.asked)
        ));
    }
    doubts.extend(unfinished.map(|error| format!("there is no grid: {error}")));
    let offsets = made.grid.as_ref().map_or(&[][..], |grid| &grid.offsets);
    let missing = offsets.iter().filter(|offset| offset.is_none()).count();
    if missing > 0 {
        doubts.push(format!("{} of the grid, of {}, out of reach", points_are(missing), offsets.len()));
    }
    let mut of = |which: &dyn Fn(&Corrected) -> bool, words: &dyn Fn(usize, usize, &Corrected) -> String| {
        let mut found = made.points.iter().enumerate().filter(|(_, point)| which(point));
        if let Some((index, first)) = found.next() {
            doubts.push(words(1 + found.count(), index, first));
        }
    };
    of(&|point| matches!(point.end, End::Unreachable(_) | End::Failed(_)), &|count, index, first| {
        let why = match &first.end {
            End::Unreachable(told) => told.to_string(),
            End::Failed(why) => why.clone(),
            End::Met | End::Jumped => String::new(),
        };
        format!("{} out of reach; of {}: {why}", points_are(count), called(index, first))
    });
    of(&|point| point.end == End::Jumped, &|count, index, first| {
        format!(
            "{} reached only with a jump, the first time at {}: another branch of the redundancy, or points too far apart for \
             the longest step",
            points_are(count),
            called(index, first)
        )
    });
    let is_open = |point: &Corrected| point.point.as_ref().is_some_and(|found| found.missed() > CLOSED);
    of(&is_open, &|count, index, first| {
        let left = first.point.as_ref().map_or(0.0, |found| 1e6 * found.missed());
        format!(
            "{} more than 1 um off on the model, {} by {left:.3} um (--tolerance-um)",
            points_are(count),
            called(index, first)
        )
    });
    of(&is_far, &|count, index, first| {
        format!(
            "{} corrected by more than {} m or rad of an actuator, the first is {}: near a singular pose, where the \
             correction is hardly determined",
            points_are(count),
            CompensatedPoint::FARTHEST,
            called(index, first)
        )
    });
    of(&|point| point.is_untrusted, &|count, index, first| {
        let most = made.trust.map_or(0.0, |most| 1e3 * most);
        let sigma =
            first.sigma().map_or_else(|| "unknown".to_owned(), |sigma| format!("{:.3} mm", 1e3 * sigma));
        format!(
            "{} less certain than {most} mm (--trust-mm), the first is {} with {sigma}",
            points_are(count),
            called(index, first)
        )
    });
    if let Some(worst) =
        made.exceeded.iter().max_by(|a, b| (a.speed / a.limit).total_cmp(&(b.speed / b.limit)))
    {
        let steps = if made.exceeded.len() == 1 {
            "1 step is".to_owned()
        } else {
            format!("{} steps are", made.exceeded.len())
        };
        doubts.push(format!("{steps} too fast; worst {worst}"));
    }
    doubts
}

/// Further remarks.
pub(super) fn remarks(made: &Compensation, file: &EstimateFile, plan: &CompensationPlan) -> Vec<String> {
    let mut remarks = Vec::new();
    let beyond = made.count(|point| !point.beyond.is_empty());
    if beyond > 0 {
        remarks.push(format!(
            "extrapolated: {} outside the measured commands{}",
            points_are(beyond),
            farthest(made)
        ));
    }
    let wavering = made.count(|point| point.wavers);
    if wavering > 0 {
        remarks.push(format!(
            "at {} the corrected commands make an actuator arrive from another side than assumed (marked wavers): there, the \
             terms that depend on that side are off by as much as they change with it",
            points(wavering)
        ));
    }
    let robot = &file.estimate.robot;
    let turns =
        robot.terms.iter().any(|(term, _)| ["hysteresis", "presliding"].contains(&term.family().key()));
    let sides = plan.options.inverse.circumstances.approach.iter().any(|side| *side != 0);
    if turns && !sides && !made.is_path && made.asked > 0 {
        remarks.push(
            "the estimate has terms that depend on the side of approach, which is not stated (--approach): the mean of both \
             sides is used"
                .to_owned(),
        );
    }
    if made.asked > 0 && made.points.iter().any(|point| point.point.is_some()) && made.sigmas().is_none() {
        remarks.push(
            "the estimate has no covariance: the uncertainty of corrected points is unknown".to_owned(),
        );
    }
    if made.is_path {
        let without: Vec<_> = made
            .actuators
            .iter()
            .enumerate()
            .filter(|(index, actuator)| {
                actuator.is_commanded && !made.speed_limits.get(*index).is_some_and(|limit| limit.is_finite())
            })
            .map(|(_, actuator)| actuator.name.as_str())
            .collect();
        if !without.is_empty() {
            remarks.push(format!("the speed limit of {} is unknown (--speed-limits)", without.join(", ")));
        }
    }
    let at_limit = made.corrected().filter(|(_, point)| !point.limits.is_empty()).count();
    if at_limit > 0 {
        remarks.push(format!("{} on a limit of a joint", points_are(at_limit)));
    }
    remarks
}

/// Largest excursion of an actuator beyond the measured range, as a share of that range.
fn farthest(made: &Compensation) -> String {
    let all = made
        .points
        .iter()
        .enumerate()
        .flat_map(|(index, point)| point.beyond.iter().map(move |beyond| (index, point, beyond)));
    let share = |beyond: &super::Beyond| {
        let low = made.region.command_min.get(beyond.actuator).copied().unwrap_or_default();
        let high = made.region.command_max.get(beyond.actuator).copied().unwrap_or_default();
        beyond.by.abs() / (high - low).max(1e-6)
    };
    let worst = all.max_by(|a, b| share(a.2).total_cmp(&share(b.2)));
    let Some((index, point, beyond)) = worst else { return String::new() };
    let Some(actuator) = made.actuators.get(beyond.actuator) else { return String::new() };
    let (side, by) = if beyond.by > 0.0 { ("above", beyond.by) } else { ("below", -beyond.by) };
    format!(
        "; farthest {} at {}, {:.3} {} {side} them",
        actuator.name,
        called(index, point),
        actuator.shown(by),
        actuator.unit()
    )
}
