//! The figure of the parameters: estimates with their 95 % intervals, and their errors where the truth is known.

use std::ops::Range;

use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::ReportError;
use super::parameters::{ParameterCell, ParameterRow, printed_unit};
use super::plots::{
    Area, Drawn, GRID, Look, WIDTH, centred, drawable, finite_range, ink, look, marker, padded, px, svg,
    text_style, values_below,
};
use calibrig_estimation::identification::Mode;
use calibrig_model::Unit;

const ROW: i32 = 22;
const NAMES: i32 = 148;
const TITLE: i32 = 22;
const AXIS: i32 = 26;

/// What zero stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Zero {
    Nominal,
    Truth,
}

/// One panel: a row a parameter.
struct Panel<'r> {
    rows: &'r [&'r ParameterRow],
    /// The cells that are shown, and their modes.
    slots: Vec<(usize, Mode)>,
    zero: Zero,
    /// From SI to the printed unit.
    factor: f64,
}

/// The parameters of `unit` under `modes` (one a cell of every row); `None` without any.
///
/// Without truth, one panel of deviations from nominal. With it, a panel of errors a mode beside it, each on its own scale: errors of modes
/// may differ by orders of magnitude.
pub(super) fn parameters(
    rows: &[ParameterRow],
    modes: &[Mode],
    unit: Unit,
) -> Result<Option<String>, ReportError> {
    let rows: Vec<_> = rows.iter().filter(|row| row.id.unit() == unit).collect();
    if rows.is_empty() {
        return Ok(None);
    }
    let (unit_name, factor) = printed_unit(unit);
    let slots: Vec<_> = modes.iter().copied().enumerate().collect();
    let known: Vec<_> = slots
        .iter()
        .copied()
        .filter(|(slot, _)| rows.iter().any(|row| cell(row, *slot).and_then(ParameterCell::error).is_some()))
        .collect();
    let height = ROW * i32::try_from(rows.len()).unwrap_or(i32::MAX / (4 * ROW)) + 8;
    let size = (WIDTH, TITLE + height + AXIS + 2);
    let figure = svg("parameters", "Identified parameters with 95 % intervals", size, |area| {
        let (_, plots) = area.split_horizontally(px(NAMES));
        let share = if known.is_empty() { 100.0 } else { 100.0 / (0.8 + known.len() as f64) };
        let (left, right) = plots.split_horizontally(share.max(30.0).percent_width());
        let panel = |slots, zero| Panel { rows: &rows, slots, zero, factor };
        let body = titled(&left, &format!("deviation from nominal, {unit_name}"), height)?;
        panel(slots.clone(), Zero::Nominal).draw(&body, Some(area))?;
        if !known.is_empty() {
            for (slot, area) in known.iter().zip(right.split_evenly((1, known.len()))) {
                panel(vec![*slot], Zero::Truth)
                    .draw(&titled(&area, &format!("error, {unit_name}"), height)?, None)?;
            }
        }
        Ok(())
    })?;
    Ok(Some(figure))
}

/// Writes the title and gives the part of `area` below it.
fn titled<'a>(area: &Area<'a>, title: &str, height: i32) -> Drawn<Area<'a>> {
    let (head, rest) = area.split_vertically(px(TITLE));
    centred(&head, title)?;
    Ok(rest.split_vertically(px(height + AXIS)).0)
}

fn cell(row: &ParameterRow, slot: usize) -> Option<&ParameterCell> {
    row.cells.get(slot)?.as_ref()
}

impl Panel<'_> {
    /// Middle and, where there is one, half-width of the interval, in the printed unit.
    fn interval(&self, row: &ParameterRow, slot: usize) -> Option<(f64, Option<f64>)> {
        let cell = cell(row, slot)?;
        let middle = match self.zero {
            Zero::Nominal => cell.value,
            Zero::Truth => cell.error()?,
        };
        let half = cell.half_width().map(|h| self.factor * h).filter(|h| drawable(*h));
        Some((self.factor * middle, half)).filter(|(middle, _)| drawable(*middle))
    }

    fn truth(&self, row: &ParameterRow) -> Option<f64> {
        row.truth().filter(|_| self.zero == Zero::Nominal).map(|t| self.factor * t).filter(|t| drawable(*t))
    }

    /// Everything that is shown, and zero.
    fn range(&self) -> Range<f64> {
        let ends = self.rows.iter().flat_map(|row| {
            self.slots.iter().filter_map(|(slot, _)| self.interval(row, *slot)).flat_map(|(middle, half)| {
                let half = half.unwrap_or(0.0);
                [middle - half, middle + half]
            })
        });
        let truths = self.rows.iter().filter_map(|row| self.truth(row));
        padded(&finite_range(ends.chain(truths).chain([0.0])))
    }

    /// Draws the panel, and the names of the parameters left of it to `names` (the whole figure).
    fn draw(&self, body: &Area, names: Option<&Area>) -> Drawn {
        let x = self.range();
        let bottom = self.rows.len() as f64 - 0.5;
        let mut chart = ChartBuilder::on(body)
            .margin_left(px(8))
            .margin_right(px(14))
            .x_label_area_size(px(AXIS))
            .build_cartesian_2d(x.clone(), bottom..-0.5)?;
        values_below(&mut chart, body.dim_in_pixel().0, 2..=7)?;
        let plot = chart.plotting_area();
        for row in 1..self.rows.len() {
            let y = row as f64 - 0.5;
            plot.draw(&PathElement::new(vec![(x.start, y), (x.end, y)], GRID.mix(0.5).stroke_width(1)))?;
        }
        plot.draw(&PathElement::new(vec![(0.0, bottom), (0.0, -0.5)], ink(2)))?;
        for (index, row) in self.rows.iter().enumerate() {
            let y = index as f64;
            if let Some(names) = names {
                let (_, at) = plot.map_coordinate(&(x.start, y));
                let style = text_style().pos(Pos::new(HPos::Right, VPos::Center));
                names.draw(&Text::new(row.id.to_string(), (px(NAMES - 4), at), style))?;
            }
            if let Some(truth) = self.truth(row) {
                plot.draw(&PathElement::new(vec![(truth, y - 0.42), (truth, y + 0.42)], ink(5)))?;
            }
            for (place, (slot, mode)) in self.slots.iter().enumerate() {
                let Some((middle, half)) = self.interval(row, *slot) else { continue };
                let y = y + 0.34 * (place as f64 - 0.5 * (self.slots.len() as f64 - 1.0));
                let look = look(*mode);
                if let Some(half) = half {
                    bar(plot, &look, [middle - half, middle + half], y)?;
                }
                plot.draw(&marker(&look, (middle, y), 7))?;
            }
        }
        Ok(())
    }
}

type Plot<'a> = DrawingArea<SVGBackend<'a>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

fn bar(plot: &Plot, look: &Look, ends: [f64; 2], y: f64) -> Drawn {
    let style = look.light.stroke_width(3);
    plot.draw(&PathElement::new(ends.map(|x| (x, y)).to_vec(), style))?;
    for x in ends {
        plot.draw(&(EmptyElement::at((x, y)) + PathElement::new(vec![(0, -5), (0, 5)], style)))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::parameters::{fitted, parameter_rows};
    use crate::report::plots::{LOOKS, hex};
    use crate::report::sample;

    #[test]
    fn every_parameter_of_the_unit_is_named_once_and_drawn_for_every_mode() {
        let outcome = sample::simulated();
        let rows = parameter_rows(&outcome);
        let modes: Vec<_> = fitted(&outcome).iter().map(|(mode, _)| *mode).collect();
        for unit in [Unit::Metre, Unit::Radian] {
            let figure = parameters(&rows, &modes, unit).expect("a figure").expect("parameters");
            for row in &rows {
                let named = figure.matches(&format!("\n{}\n", row.id)).count();
                assert_eq!(named, usize::from(row.id.unit() == unit), "{}", row.id);
            }
            let count = rows.iter().filter(|row| row.id.unit() == unit).count();
            let triangle = format!("<polygon opacity=\"1\" fill=\"{}\"", hex(LOOKS[1].light));
            assert_eq!(figure.matches(&triangle).count(), 2 * count, "deviation and error");
        }
        let rows = parameter_rows(&sample::measured());
        let figure = parameters(&rows, &modes[..1], Unit::Metre).expect("a figure").expect("parameters");
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
            let figure = parameters(&rows, &[Mode::OnlyCalibration, Mode::WithGravity], Unit::Metre);
            assert!(figure.expect("a figure").is_some_and(|text| text.ends_with("</svg>\n")), "{bad}");
        }
    }
}
