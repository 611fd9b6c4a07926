//! The figures, as SVG text without a background. Colours are presentation attributes, so that the page's style sheet can replace
//! them in the dark; modes differ by marker and dash too.

use std::ops::{Range, RangeInclusive};

use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::element::{DashedPathElement, DynElement};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::files::ReportError;
use calibrig_estimation::identification::Mode;

pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
pub(super) type Chart<'a, 'b> = ChartContext<'b, SVGBackend<'a>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;
pub(super) type Drawn<T = ()> = Result<T, DrawingAreaErrorKind<std::io::Error>>;

/// Text and axes; the page replaces it by the colour of its text.
pub(super) const INK: RGBColor = RGBColor(0x5A, 0x5A, 0x5A);
/// Grid lines.
pub(super) const GRID: RGBColor = RGBColor(0xD5, 0xD5, 0xD5);

/// plotters draws on whole pixels: figures are drawn twice as large as they are shown.
pub(super) const SCALE: i32 = 2;
pub(super) const WIDTH: i32 = 960;

/// The shape that stands for a mode.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Marker {
    Circle,
    Triangle,
    Square,
    Cross,
    Diamond,
}

/// How a mode is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Look {
    /// On white: Okabe and Ito's colours and neighbours of theirs, told apart with any colour vision.
    pub light: RGBColor,
    /// On a dark page.
    pub dark: RGBColor,
    pub marker: Marker,
    /// Lengths of dash and gap; `None` for a full line.
    pub dash: Option<(u32, u32)>,
}

pub(super) const LOOKS: [Look; 5] = [
    Look {
        light: RGBColor(0xC9, 0x55, 0x00),
        dark: RGBColor(0xFF, 0x9A, 0x57),
        marker: Marker::Circle,
        dash: Some((2, 4)),
    },
    Look {
        light: RGBColor(0x00, 0x72, 0xB2),
        dark: RGBColor(0x5C, 0xB8, 0xF2),
        marker: Marker::Triangle,
        dash: Some((8, 4)),
    },
    Look {
        light: RGBColor(0x00, 0x8A, 0x65),
        dark: RGBColor(0x3F, 0xD6, 0xA5),
        marker: Marker::Square,
        dash: None,
    },
    Look {
        light: RGBColor(0xAA, 0x44, 0x99),
        dark: RGBColor(0xE5, 0x9A, 0xCB),
        marker: Marker::Cross,
        dash: Some((12, 6)),
    },
    Look {
        light: RGBColor(0x7A, 0x6A, 0x00),
        dark: RGBColor(0xD9, 0xC7, 0x4A),
        marker: Marker::Diamond,
        dash: Some((4, 8)),
    },
];

pub(super) fn look(mode: Mode) -> Look {
    let index = Mode::ALL.iter().position(|m| *m == mode).unwrap_or(0);
    LOOKS[index % LOOKS.len()]
}

/// `#RRGGBB`, as plotters writes it.
pub(super) fn hex(RGBColor(r, g, b): RGBColor) -> String {
    format!("#{r:02X}{g:02X}{b:02X}")
}

/// What a curve of magnitudes shows.
pub(super) struct Curve {
    pub look: Look,
    /// mm over whatever it is drawn against.
    pub points: Vec<(f64, f64)>,
    /// As a line; else as markers.
    pub joined: bool,
}

/// Magnitudes in mm over something, logarithmic.
pub(super) fn magnitudes(
    (figure, label): (&'static str, &str),
    below: &str,
    curves: &[Curve],
) -> Result<String, ReportError> {
    const PANEL: i32 = 260;
    const FOOT: i32 = 20;
    let shown = |(x, y): &&(f64, f64)| drawable(*x) && drawable(*y) && *y > 0.0;
    let points = || curves.iter().flat_map(|curve| curve.points.iter().filter(shown));
    let low = points().map(|(_, y)| *y).fold(f64::INFINITY, f64::min).max(1e-4);
    let high = points().map(|(_, y)| *y).fold(0.0, f64::max);
    svg(figure, label, (WIDTH, PANEL + FOOT), |area| {
        let ticks = one_two_five(low, high);
        let Some(first) = ticks.first() else { return Ok(()) };
        let (panel, _) = area.split_vertically(px(PANEL));
        let x = padded(&finite_range(points().map(|(x, _)| *x)));
        let axes = Axes { top: 6, title: "3-D error, mm (logarithmic)", ..Axes::default() };
        let chart = axes.draw_log(&panel, x, log_range(&ticks), &ticks)?;
        for own in curves {
            let at = |(x, y): &(f64, f64)| (*x, y.log10().max(first.log10()));
            let points = thinned(own.points.iter().filter(shown).map(at).collect(), MOST);
            if own.joined { curve(&chart, &own.look, points)? } else { markers(&chart, &own.look, &points)? }
        }
        foot(area, below)
    })
}

/// Grid lines and labels at values of an upright logarithmic axis that plotters takes for a linear one.
fn horizontal_ticks(area: &Area, chart: &Chart, ticks: &[f64], x: &Range<f64>) -> Drawn {
    let plot = chart.plotting_area();
    let style = text_style().pos(Pos::new(HPos::Right, VPos::Center));
    let (left, top) = area.get_base_pixel();
    for value in ticks {
        let at = value.log10();
        plot.draw(&PathElement::new(vec![(x.start, at), (x.end, at)], GRID.stroke_width(2)))?;
        let (column, row) = plot.map_coordinate(&(x.start, at));
        area.draw(&Text::new(tick(*value), (column - left - px(6), row - top), style.clone()))?;
    }
    Ok(())
}

pub(super) fn svg(
    figure: &'static str,
    label: &str,
    (width, height): (i32, i32),
    draw: impl for<'a, 'b> FnOnce(&'b Area<'a>) -> Drawn,
) -> Result<String, ReportError> {
    let size = (px(width).unsigned_abs(), px(height).unsigned_abs());
    let mut text = String::new();
    {
        let area = SVGBackend::with_string(&mut text, size).into_drawing_area();
        draw(&area)
            .and_then(|()| area.present())
            .map_err(|e| ReportError::Plot { figure, reason: e.to_string() })?;
    }
    Ok(text.replacen("<svg ", &format!("<svg role=\"img\" aria-label=\"{label}\" "), 1))
}

/// Grid lines and labels at values of a logarithmic axis that plotters takes for a linear one.
pub(super) fn vertical_ticks(area: &Area, chart: &Chart, ticks: &[f64], y: &Range<f64>) -> Drawn {
    let plot = chart.plotting_area();
    let style = text_style().pos(Pos::new(HPos::Center, VPos::Top));
    let (left, top) = area.get_base_pixel();
    // Labels of 40 pixels stand beside each other, else only those of the decades.
    let room = area.dim_in_pixel().0 / (40 * SCALE.unsigned_abs());
    let all = ticks.len() <= usize::try_from(room).unwrap_or(usize::MAX);
    for value in ticks {
        let at = value.log10();
        plot.draw(&PathElement::new(vec![(at, y.start), (at, y.end)], GRID.stroke_width(2)))?;
        if !all && (at - at.round()).abs() > 1e-6 {
            continue;
        }
        let (column, row) = plot.map_coordinate(&(at, y.start));
        area.draw(&Text::new(tick(*value), (column - left, row - top + px(6)), style.clone()))?;
    }
    Ok(())
}

pub(super) fn curve(chart: &Chart, look: &Look, points: Vec<(f64, f64)>) -> Drawn {
    let style = look.light.stroke_width(4);
    match look.dash {
        _ if points.is_empty() => Ok(()),
        None => chart.plotting_area().draw(&PathElement::new(points, style)),
        Some((dash, gap)) => {
            let scale = SCALE.unsigned_abs();
            chart.plotting_area().draw(&DashedPathElement::new(points, dash * scale, gap * scale, style))
        }
    }
}

pub(super) fn marker<'a, DB: DrawingBackend + 'a>(
    look: &Look,
    at: (f64, f64),
    size: i32,
) -> DynElement<'a, DB, (f64, f64)> {
    let hollow = look.light.stroke_width(3);
    let full = look.light.filled();
    match look.marker {
        Marker::Circle => Circle::new(at, size, hollow).into_dyn(),
        Marker::Triangle => TriangleMarker::new(at, size + 2, full).into_dyn(),
        Marker::Square => {
            let half = size - 1;
            (EmptyElement::at(at) + Rectangle::new([(-half, -half), (half, half)], full)).into_dyn()
        }
        Marker::Cross => Cross::new(at, size, hollow).into_dyn(),
        Marker::Diamond => {
            let corners = vec![(0, -size), (size, 0), (0, size), (-size, 0)];
            (EmptyElement::at(at) + Polygon::new(corners, full)).into_dyn()
        }
    }
}

pub(super) fn centred(area: &Area, text: &str) -> Drawn {
    let (width, height) = area.dim_in_pixel();
    let at = (i32::try_from(width / 2).unwrap_or(0), i32::try_from(height / 2).unwrap_or(0));
    let font = ("sans-serif", font_size(), FontStyle::Bold).into_font();
    area.draw(&Text::new(text.to_owned(), at, font.color(&INK).pos(Pos::new(HPos::Center, VPos::Center))))
}

/// The planes of the base frame that three views show: title, the axis across, the axis up.
pub(super) const VIEWS: [(&str, usize, usize); 3] =
    [("x\u{2013}y", 0, 1), ("x\u{2013}z", 0, 2), ("y\u{2013}z", 1, 2)];

/// Which lines of the grid are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Grid {
    None,
    Rows,
    Both,
}

/// The axes of a chart: margins and room for numbers in pixels as they are shown, and how many numbers are wished for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Axes<'t> {
    pub top: i32,
    pub right: i32,
    /// Room for numbers below and to the left.
    pub room: (i32, i32),
    /// Numbers on the horizontal and on the upright axis.
    pub labels: (usize, usize),
    pub grid: Grid,
    /// Beside the upright axis.
    pub title: &'t str,
}

impl Default for Axes<'_> {
    fn default() -> Self {
        Self { top: 4, right: 10, room: (26, 62), labels: (10, 6), grid: Grid::Rows, title: "" }
    }
}

impl Axes<'_> {
    pub fn draw<'a, 'b>(&self, area: &'b Area<'a>, x: Range<f64>, y: Range<f64>) -> Drawn<Chart<'a, 'b>> {
        let mut chart = ChartBuilder::on(area)
            .margin_top(px(self.top))
            .margin_right(px(self.right))
            .x_label_area_size(px(self.room.0))
            .y_label_area_size(px(self.room.1))
            .build_cartesian_2d(x, y)?;
        let mut mesh = chart.configure_mesh();
        match self.grid {
            Grid::None => mesh.disable_mesh(),
            Grid::Rows => mesh.disable_x_mesh(),
            Grid::Both => &mut mesh,
        };
        mesh.x_labels(self.labels.0)
            .y_labels(self.labels.1)
            .bold_line_style(GRID.stroke_width(2))
            .light_line_style(TRANSPARENT)
            .axis_style(INK.mix(0.6).stroke_width(2))
            .label_style(text_style())
            .axis_desc_style(text_style())
            .y_desc(self.title)
            .x_label_formatter(&|v| tick(*v))
            .y_label_formatter(&|v| tick(*v))
            .draw()?;
        Ok(chart)
    }

    /// With an upright axis of logarithms, and lines at these values.
    pub fn draw_log<'a, 'b>(
        &self,
        area: &'b Area<'a>,
        x: Range<f64>,
        y: Range<f64>,
        ticks: &[f64],
    ) -> Drawn<Chart<'a, 'b>> {
        let axes = Self { grid: Grid::None, labels: (self.labels.0, 0), ..*self };
        let chart = axes.draw(area, x.clone(), y)?;
        horizontal_ticks(area, &chart, ticks, &x)?;
        Ok(chart)
    }
}

/// An axis, which is logarithmic where its values are far from each other.
pub(super) struct Scale {
    /// Where a logarithmic one has lines; else none.
    pub ticks: Vec<f64>,
    /// In logarithms, where it is one of them.
    pub range: Range<f64>,
}

impl Scale {
    pub fn linear(range: Range<f64>) -> Self {
        Self { ticks: Vec::new(), range }
    }

    /// From `low` to `high`, with at most so many lines; `None` where these are not `far` times each other.
    pub fn logarithmic(low: f64, high: f64, far: f64, most: usize) -> Option<Self> {
        let ticks = if low > 0.0 && high / low > far { one_two_five(low, high) } else { Vec::new() };
        let [first, .., last] = ticks[..] else { return None };
        Some(Self { range: first.log10()..last.log10(), ticks: few(ticks, most) })
    }

    pub fn at(&self, value: f64) -> f64 {
        if self.ticks.is_empty() {
            value
        } else {
            value.max(1e-9).log10().clamp(self.range.start, self.range.end)
        }
    }
}

/// As many lines of a logarithmic axis as have room for their values: decades, of many each second one.
fn few(ticks: Vec<f64>, most: usize) -> Vec<f64> {
    if ticks.len() <= most {
        return ticks;
    }
    let is_decade = |tick: &f64| (tick.log10() - tick.log10().round()).abs() < 1e-6;
    let decades: Vec<f64> = ticks.into_iter().filter(is_decade).collect();
    let step = decades.len().div_ceil(most).max(1);
    decades.into_iter().step_by(step).collect()
}

/// From the first to the last of the values of a logarithmic axis; never empty.
pub(super) fn log_range(ticks: &[f64]) -> Range<f64> {
    let low = ticks.first().map_or(-1.0, |tick| tick.log10());
    low..ticks.last().map_or(0.0, |tick| tick.log10()).max(low + 0.1)
}

/// The axes of a view of places, m.
pub(super) fn place_axes<'a, 'b>(area: &'b Area<'a>, x: Range<f64>, y: Range<f64>) -> Drawn<Chart<'a, 'b>> {
    let axes = Axes { right: 12, room: (26, 44), labels: (5, 6), grid: Grid::None, ..Axes::default() };
    axes.draw(area, x, y)
}

/// Three views of places in the base frame beside each other, each with its title above it. `draw` is given the axes across and up.
pub(super) fn three_views(area: &Area, draw: impl Fn(&Area, (usize, usize)) -> Drawn) -> Drawn {
    for (cell, (title, across, up)) in area.split_evenly((1, 3)).iter().zip(VIEWS) {
        let (head, panel) = cell.split_vertically(px(22));
        centred(&head, &format!("{title}, m"))?;
        draw(&panel, (across, up))?;
    }
    Ok(())
}

/// 1, 2 or 5 times a power of ten, not above `wanted`: how many times as long as they are arrows are drawn.
pub(super) fn round_below(wanted: f64) -> Option<f64> {
    let decade = 10_f64.powf(wanted.log10().floor());
    let step = [5.0, 2.0, 1.0].into_iter().find(|step| step * decade <= wanted).unwrap_or(1.0);
    Some(step * decade).filter(|factor| factor.is_finite() && *factor > 0.0)
}

/// A line from end to end of an interval, with bars at its ends.
pub(super) fn whisker(chart: &Chart, style: ShapeStyle, ends: [f64; 2], y: f64) -> Drawn {
    let (plot, half) = (chart.plotting_area(), 5);
    plot.draw(&PathElement::new(ends.map(|x| (x, y)).to_vec(), style))?;
    for x in ends {
        plot.draw(&(EmptyElement::at((x, y)) + PathElement::new(vec![(0, -half), (0, half)], style)))?;
    }
    Ok(())
}

/// Markers of a series; smaller ones where there are many.
pub(super) fn markers(chart: &Chart, look: &Look, points: &[(f64, f64)]) -> Drawn {
    let size = if points.len() > 300 { 4 } else { 6 };
    points.iter().try_for_each(|at| chart.plotting_area().draw(&marker(look, *at, size)))
}

/// A dashed line that stands for a value.
pub(super) fn dashed(chart: &Chart, ends: [(f64, f64); 2], style: ShapeStyle) -> Drawn {
    let scale = SCALE.unsigned_abs();
    chart.plotting_area().draw(&DashedPathElement::new(ends.to_vec(), 6 * scale, 4 * scale, style))
}

/// Text at the right of a place, as of a name of a row.
pub(super) fn text_at(area: &Area, text: &str, place: (i32, i32), anchor: (HPos, VPos)) -> Drawn {
    area.draw(&Text::new(text.to_owned(), place, text_style().pos(Pos::new(anchor.0, anchor.1))))
}

/// Points of a curve over a whole figure, at most; of more, those of `thinned` are drawn.
pub(super) const MOST: usize = 2 * MARKS;
/// Marks of a series in a panel, at most.
pub(super) const MARKS: usize = 180;

/// Every so many-th index, the last among them.
pub(super) fn sampled(count: usize, most: usize) -> impl Iterator<Item = usize> {
    let step = count.div_ceil(most.max(1)).max(1);
    (0..count).filter(move |index| index % step == 0 || index + 1 == count)
}

/// What is drawn of many points, in the order of x: in every class of equal width along x the lowest, the middle and the highest. The largest errors
/// are always among them.
pub(super) fn thinned(mut points: Vec<(f64, f64)>, most: usize) -> Vec<(f64, f64)> {
    points.retain(|point| drawable(point.0) && drawable(point.1));
    if points.len() <= most {
        return points;
    }
    let range = finite_range(points.iter().map(|point| point.0));
    let classes = (most / 3).max(1);
    let class = |x: f64| (classes as f64 * (x - range.start) / (range.end - range.start)).floor();
    let last = (classes - 1) as f64;
    points.sort_by(|a, b| class(a.0).min(last).total_cmp(&class(b.0).min(last)).then(a.1.total_cmp(&b.1)));
    let of_class = points.chunk_by(|a, b| class(a.0).min(last).total_cmp(&class(b.0).min(last)).is_eq());
    let mut kept: Vec<_> = of_class
        .flat_map(|own| {
            let mut places = vec![0, own.len() / 2, own.len() - 1];
            places.dedup();
            places.into_iter().map(|place| own[place])
        })
        .collect();
    kept.sort_by(|a, b| a.0.total_cmp(&b.0));
    kept
}

/// What the caption says of a figure whose points are thinned; nothing where all `count` are drawn.
pub(super) fn thinned_words(count: usize, most: usize) -> String {
    if count <= most {
        return String::new();
    }
    format!(
        " Of {count} points at most {most} are drawn in each colour and panel: in each of {} classes of equal width the lowest, the middle and the highest, so that the \
         worst are always shown.",
        most / 3
    )
}

/// The title of the horizontal axis, at the lower edge.
pub(super) fn foot(area: &Area, text: &str) -> Drawn {
    let (width, height) = area.dim_in_pixel();
    let at = (i32::try_from(width / 2).unwrap_or(0), i32::try_from(height).unwrap_or(0) - px(6));
    let style = text_style().pos(Pos::new(HPos::Center, VPos::Bottom));
    area.draw(&Text::new(text.to_owned(), at, style))
}

/// Values below a chart of rows, `labels` of them in its `width` (pixels); the rows have lines and names of their own.
pub(super) fn values_below(chart: &mut Chart<'_, '_>, width: u32, labels: RangeInclusive<usize>) -> Drawn {
    let room = usize::try_from(width / (55 * SCALE.unsigned_abs())).unwrap_or(*labels.start());
    chart
        .configure_mesh()
        .disable_y_mesh()
        .disable_y_axis()
        .x_labels(room.clamp(*labels.start(), *labels.end()))
        .bold_line_style(GRID.stroke_width(2))
        .light_line_style(TRANSPARENT)
        .axis_style(INK.mix(0.6).stroke_width(2))
        .label_style(text_style())
        .x_label_formatter(&|v| tick(*v))
        .draw()
}

pub(super) fn text_style() -> TextStyle<'static> {
    ("sans-serif", font_size()).into_font().color(&INK)
}

/// plotters divides by 1.24 on its way to SVG.
fn font_size() -> f64 {
    12.0 * 1.24 * f64::from(SCALE)
}

pub(super) fn ink(width: u32) -> ShapeStyle {
    INK.stroke_width(width)
}

pub(super) fn px(length: i32) -> i32 {
    length * SCALE
}

/// A number on an axis: no more digits than it has.
pub(super) fn tick(value: f64) -> String {
    if value != 0.0 && !(1e-3..1e5).contains(&value.abs()) {
        // plotters' ticks near zero carry rounding errors of the range.
        return if value.abs() < 1e-9 { "0".to_owned() } else { format!("{value:.0e}") };
    }
    let text = format!("{value:.4}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    text.replace('-', "\u{2212}")
}

/// Whether plotters can place it: its ticks do not end for numbers out of all proportion.
pub(super) fn drawable(value: f64) -> bool {
    value.abs() < 1e10
}

/// From the least to the largest of the drawable values; never empty.
pub(super) fn finite_range(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) = values
        .filter(|v| drawable(*v))
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    if low < high {
        low..high
    } else if low.is_finite() {
        low - 0.5..low + 0.5
    } else {
        -0.5..0.5
    }
}

pub(super) fn padded(range: &Range<f64>) -> Range<f64> {
    let pad = (0.04 * (range.end - range.start)).max(1e-6);
    range.start - pad..range.end + pad
}

/// Largest magnitude of the drawable values, at least a nanometre in mm.
pub(super) fn largest(values: impl Iterator<Item = f64>) -> f64 {
    values.map(f64::abs).filter(|v| drawable(*v)).fold(1e-6, f64::max)
}

/// The values 1, 2, 5 times powers of ten from just below `low` to just above `high`; decades alone over a long range.
pub(super) fn one_two_five(low: f64, high: f64) -> Vec<f64> {
    let low = low.max(1e-6);
    if low > high {
        return Vec::new();
    }
    let decades = (high / low).log10();
    let steps: &[f64] = if decades > 4.0 { &[1.0] } else { &[1.0, 2.0, 5.0] };
    // What can be drawn lies between these decades.
    let all: Vec<f64> = (-6..=9).flat_map(|e| steps.iter().map(move |s| s * 10.0_f64.powi(e))).collect();
    let below = all.iter().rposition(|t| *t <= low).unwrap_or(0);
    let above = all.iter().position(|t| *t >= high && *t > low).map_or(all.len(), |i| i + 1);
    all[below..above.max(below + 1)].to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logarithmic_ticks_enclose_the_data() {
        for (low, high) in [(0.013, 31.0), (0.9, 1.1), (1.0, 1.0), (1e-5, 1e3), (2.0, 5.0)] {
            let ticks = one_two_five(low, high);
            assert!(ticks.len() >= 2, "{low} {high}: {ticks:?}");
            assert!(ticks[0] <= low && ticks[ticks.len() - 1] >= high, "{low} {high}: {ticks:?}");
        }
        assert!(one_two_five(f64::INFINITY, 0.0).is_empty());
    }

    #[test]
    fn axis_numbers_have_no_idle_digits() {
        assert_eq!(
            [0.0, 1e-14, 20.0, -0.5, 0.125, 1e6].map(tick),
            ["0", "0", "20", "\u{2212}0.5", "0.125", "1e6"]
        );
    }

    #[test]
    fn thinned_points_keep_the_extremes_and_their_order() {
        let points: Vec<_> = (0..10_000).map(|i| (f64::from(i), f64::from(i * 7919 % 1000))).collect();
        let kept = thinned(points.clone(), MARKS);
        assert!(kept.len() <= MARKS && kept.len() > MARKS / 2, "{}", kept.len());
        let ends = |all: &[(f64, f64)]| {
            all.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), (_, y)| (l.min(*y), h.max(*y)))
        };
        assert_eq!(ends(&kept), ends(&points));
        assert!(kept.is_sorted_by(|a, b| a.0 <= b.0) && kept.iter().all(|point| points.contains(point)));
        assert_eq!(thinned(points[..100].to_vec(), MARKS), points[..100]);
        // All at one place, and one far from the others.
        assert!(thinned(vec![(1.0, 2.0); 1000], MARKS).len() <= MARKS);
        assert_eq!(thinned_words(MARKS, MARKS), "");
    }
}
