//! The figure of the parameters: estimates with their 95 % intervals, and their errors where the truth is known.

use super::files::ReportError;
use super::parameters::{ParameterCell, ParameterRow};
use super::plots::{drawable, look};
use super::rows::{Dot, Panel, dots};
use super::words::printed_unit;
use calibrig_estimation::identification::Mode;
use calibrig_model::Unit;

/// The parameters of `unit` under `modes` (one a cell of every row); `None` without any.
///
/// Without truth, one panel of deviations from nominal. With it, a panel of errors a mode beside it, each on its own scale: errors of modes
/// may differ by orders of magnitude.
pub(super) fn parameters(
    rows: &[&ParameterRow],
    modes: &[Mode],
    unit: Unit,
) -> Result<Option<String>, ReportError> {
    let rows: Vec<_> = rows.iter().copied().filter(|row| row.id.unit() == unit).collect();
    if rows.is_empty() {
        return Ok(None);
    }
    let (unit, factor) = printed_unit(unit);
    let slots = || modes.iter().copied().enumerate();
    let dot = |mode: Mode, cell: &ParameterCell, value: f64| {
        let interval = cell.half_width().map(|half| (factor * (value - half), factor * (value + half)));
        // A parameter whose interval cannot be drawn still has its mark.
        let interval = interval.filter(|(low, high)| drawable(*low) && drawable(*high));
        Dot { interval, ..Dot::at(look(mode), factor * value) }
    };
    let estimated = |row: &ParameterRow| -> Vec<Dot> {
        slots().filter_map(|(slot, mode)| row.cell(slot).map(|cell| dot(mode, cell, cell.value))).collect()
    };
    let deviations = Panel {
        marks: rows.iter().map(|row| row.truth().map(|truth| factor * truth)).collect(),
        ..Panel::of(
            &format!("deviation from nominal, {unit}"),
            0.0,
            rows.iter().map(|row| estimated(row)).collect(),
        )
    };
    let errors = slots().filter_map(|(slot, mode)| {
        let error = |row: &&ParameterRow| -> Vec<Dot> {
            let cell = row.cell(slot);
            cell.and_then(|cell| Some(dot(mode, cell, cell.error()?))).into_iter().collect()
        };
        let errors: Vec<_> = rows.iter().map(error).collect();
        let is_known = errors.iter().any(|row| !row.is_empty());
        is_known.then(|| Panel::of(&format!("error, {unit}"), 0.0, errors))
    });
    let panels: Vec<_> = std::iter::once(deviations).chain(errors).collect();
    let names: Vec<_> = rows.iter().map(|row| row.id.to_string()).collect();
    dots("parameters", "Identified parameters with 95 % intervals", &names, &panels).map(Some)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::parameters::{fitted, parameter_rows};
    use crate::report::plots::{LOOKS, hex};
    use crate::report::tests::sample;

    #[test]
    fn every_parameter_of_the_unit_is_named_once_and_drawn_for_every_mode() {
        let outcome = sample::simulated();
        let rows = parameter_rows(&outcome);
        let modes: Vec<_> = fitted(&outcome).iter().map(|(mode, _)| *mode).collect();
        for unit in [Unit::Metre, Unit::Radian] {
            let figure = parameters(&rows.iter().collect::<Vec<_>>(), &modes, unit)
                .expect("a figure")
                .expect("parameters");
            for row in &rows {
                let named = figure.matches(&format!("\n{}\n", row.id)).count();
                assert_eq!(named, usize::from(row.id.unit() == unit), "{}", row.id);
            }
            let count = rows.iter().filter(|row| row.id.unit() == unit).count();
            let triangle = format!("<polygon opacity=\"1\" fill=\"{}\"", hex(LOOKS[1].light));
            assert_eq!(figure.matches(&triangle).count(), 2 * count, "deviation and error");
        }
        let rows = parameter_rows(&sample::measured());
        let figure = parameters(&rows.iter().collect::<Vec<_>>(), &modes[..1], Unit::Metre)
            .expect("a figure")
            .expect("parameters");
        assert!(figure.contains("deviation from nominal") && !figure.contains("error"));
        assert_eq!(parameters(&[], &modes, Unit::Metre).expect("no figure"), None);
    }

    #[test]
    fn no_value_of_an_estimate_stops_the_figure() {
        for bad in [0.0, 1e-300, 1e12, -1e300, f64::NAN, f64::INFINITY] {
            let mut outcome = sample::simulated();
            for estimate in outcome.modes.iter_mut().filter_map(|mode| mode.estimate.as_mut()) {
                for parameter in &mut estimate.parameters {
                    parameter.value = bad;
                    parameter.sigma = Some(bad);
                }
            }
            let rows = parameter_rows(&outcome);
            let figure = parameters(
                &rows.iter().collect::<Vec<_>>(),
                &[Mode::OnlyCalibration, Mode::WithGravity],
                Unit::Metre,
            );
            assert!(figure.expect("a figure").is_some_and(|text| text.ends_with("</svg>\n")), "{bad}");
        }
    }
}
