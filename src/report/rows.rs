//! Rows of figures with their intervals, in panels beside each other that have the rows in common.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};

use super::files::ReportError;
use super::plots::{
    Area, Chart, Drawn, GRID, INK, Look, Scale, WIDTH, centred, drawable, finite_range, ink, marker, padded,
    px, svg, text_at, values_below, vertical_ticks, whisker,
};
use super::words::cut;

const ROW: i32 = 22;
const TITLE: i32 = 24;
const AXIS: i32 = 26;
/// Values this far from each other are shown on a logarithmic axis.
pub(super) const FAR: f64 = 20.0;
/// Values below a logarithmic axis.
const MOST_TICKS: usize = 5;
/// Characters of a name that have room.
const NAME: usize = 32;

/// A figure.
pub(super) struct Dot {
    pub look: Look,
    pub value: f64,
    /// The ends of its interval.
    pub interval: Option<(f64, f64)>,
    /// Where it should be.
    pub band: Option<(f64, f64)>,
}

impl Dot {
    fn ends(&self) -> impl Iterator<Item = f64> {
        let pair = |pair: Option<(f64, f64)>| pair.map(|(low, high)| [low, high]).into_iter().flatten();
        std::iter::once(self.value).chain(pair(self.interval)).chain(pair(self.band))
    }
}

impl Dot {
    /// A figure alone.
    pub fn at(look: Look, value: f64) -> Self {
        Self { look, value, interval: None, band: None }
    }
}

/// One figure of every row.
pub(super) struct Panel {
    pub title: String,
    /// What it is held against; bars begin there.
    pub zero: f64,
    pub bars: bool,
    /// How far values are from each other for a logarithmic axis.
    pub far: f64,
    /// A bar across the row, such as at the truth; empty without any.
    pub marks: Vec<Option<f64>>,
    /// A cell a row.
    pub rows: Vec<Vec<Dot>>,
}

impl Panel {
    /// Of figures beside zero, on an axis that is not logarithmic.
    pub fn of(title: &str, zero: f64, rows: Vec<Vec<Dot>>) -> Self {
        Self { title: title.to_owned(), zero, bars: false, far: f64::INFINITY, marks: Vec::new(), rows }
    }
}

/// Draws panels over rows of these names.
pub(super) fn dots(
    figure: &'static str,
    label: &str,
    names: &[String],
    panels: &[Panel],
) -> Result<String, ReportError> {
    let slots = panels.iter().flat_map(|p| &p.rows).map(Vec::len).max().unwrap_or(1);
    let row = ROW.max(9 * i32::try_from(slots).unwrap_or(1));
    let height = row * i32::try_from(names.len()).unwrap_or(1).clamp(1, 1000) + 8;
    let longest = names.iter().map(|name| name.chars().count().min(NAME)).max().unwrap_or(0);
    let room = 16 + 13 * i32::try_from(longest).unwrap_or(0) / 2;
    svg(figure, label, (WIDTH, TITLE + height + AXIS + 2), |area| {
        let (_, body) = area.split_horizontally(px(room));
        // The first of many panels, which tells all modes, has more room than the others.
        let cells = if panels.len() > 3 {
            let (first, rest) = body.split_horizontally(30.0.percent_width());
            std::iter::once(first).chain(rest.split_evenly((1, panels.len() - 1))).collect()
        } else {
            body.split_evenly((1, panels.len().max(1)))
        };
        for (place, (panel, cell)) in panels.iter().zip(cells).enumerate() {
            let (title, rest) = cell.split_vertically(px(TITLE));
            centred(&title, &panel.title)?;
            let (plot, _) = rest.split_vertically(px(height + AXIS));
            panel.draw(&plot, (place == 0).then_some((area, names, px(room - 4))))?;
        }
        Ok(())
    })
}

impl Panel {
    fn values(&self) -> impl Iterator<Item = f64> {
        self.rows
            .iter()
            .flatten()
            .flat_map(Dot::ends)
            .chain(self.marks.iter().copied().flatten())
            .chain([self.zero])
            .filter(|value| drawable(*value))
    }

    fn scale(&self) -> Scale {
        let least =
            self.rows.iter().flatten().map(|dot| dot.value).chain([self.zero]).fold(f64::INFINITY, f64::min);
        let most = self.values().fold(0.0, f64::max);
        let far = if self.bars { f64::INFINITY } else { self.far };
        Scale::logarithmic(least, most, far, MOST_TICKS)
            .unwrap_or_else(|| Scale::linear(padded(&finite_range(self.values()))))
    }

    fn draw(&self, body: &Area, names: Option<(&Area, &[String], i32)>) -> Drawn {
        let scale = self.scale();
        let x = scale.range.clone();
        let bottom = self.rows.len().max(1) as f64 - 0.5;
        let mut chart = ChartBuilder::on(body)
            .margin_left(px(16))
            .margin_right(px(20))
            .x_label_area_size(px(AXIS))
            .build_cartesian_2d(x.clone(), bottom..-0.5)?;
        let width = body.dim_in_pixel().0;
        if scale.ticks.is_empty() {
            values_below(&mut chart, width, 3..=7)?;
        } else {
            chart
                .configure_mesh()
                .disable_mesh()
                .disable_y_axis()
                .x_labels(0)
                .axis_style(INK.mix(0.6).stroke_width(2))
                .draw()?;
            vertical_ticks(body, &chart, &scale.ticks, &(bottom..-0.5))?;
        }
        let plot = chart.plotting_area();
        for row in 1..self.rows.len() {
            let y = row as f64 - 0.5;
            plot.draw(&PathElement::new(vec![(x.start, y), (x.end, y)], GRID.mix(0.5).stroke_width(1)))?;
        }
        let zero = scale.at(self.zero);
        plot.draw(&PathElement::new(vec![(zero, bottom), (zero, -0.5)], ink(2)))?;
        for (index, row) in self.rows.iter().enumerate() {
            let y = index as f64;
            if let Some((area, names, right)) = names {
                let (_, at) = plot.map_coordinate(&(x.start, y));
                let name = names.get(index).map_or_else(String::new, |name| cut(name, NAME));
                text_at(area, &name, (right, at - area.get_base_pixel().1), (HPos::Right, VPos::Center))?;
            }
            if let Some(mark) = self.marks.get(index).copied().flatten().filter(|mark| drawable(*mark)) {
                let at = scale.at(mark);
                plot.draw(&PathElement::new(vec![(at, y - 0.42), (at, y + 0.42)], ink(5)))?;
            }
            self.draw_row(&chart, &scale, (row, y))?;
        }
        Ok(())
    }

    fn draw_row(&self, chart: &Chart, scale: &Scale, (row, y): (&[Dot], f64)) -> Drawn {
        let plot = chart.plotting_area();
        let slots = row.len().max(1) as f64;
        for (slot, dot) in row.iter().enumerate().filter(|(_, dot)| dot.ends().all(drawable)) {
            let y = y + 0.76 / slots * (slot as f64 - 0.5 * (slots - 1.0));
            let at = scale.at(dot.value);
            if let Some((low, high)) = dot.band {
                let corners = [(scale.at(low), y - 0.3 / slots), (scale.at(high), y + 0.3 / slots)];
                plot.draw(&Rectangle::new(corners, INK.mix(0.3).filled()))?;
            }
            if self.bars {
                let corners = [(scale.at(self.zero), y - 0.28 / slots), (at, y + 0.28 / slots)];
                plot.draw(&Rectangle::new(corners, dot.look.light.mix(0.35).filled()))?;
            }
            if let Some((low, high)) = dot.interval {
                whisker(chart, dot.look.light.stroke_width(3), [scale.at(low), scale.at(high)], y)?;
            }
            plot.draw(&marker(&dot.look, (at, y), 7))?;
        }
        Ok(())
    }
}
