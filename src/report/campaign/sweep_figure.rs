//! Curves of the accuracy over the levels of a factor, a panel a level of the other one.

use std::ops::Range;

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::sweep::{distinct, modes, set_of};
use super::words::{MM, level};
use crate::montecarlo::{CampaignSummary, GroupSummary, MeanWithInterval};
use crate::report::files::ReportError;
use crate::report::plots::{
    Area, Axes, Chart, Drawn, Look, SCALE, Scale, WIDTH, centred, curve, dashed, drawable, foot, ink, look,
    marker, padded, px, svg, text_style,
};
use crate::report::words::cut;
use calibrig_estimation::identification::Mode;

/// Values this far from each other are shown on a logarithmic axis.
const FAR: f64 = 10.0;
/// Panels and levels of one that are drawn; all are in the tables.
const MOST_PANELS: usize = 12;
const MOST_LEVELS: usize = 40;
const COLUMNS: usize = 4;
/// Lines of a logarithmic axis; of more only the decades.
const MOST_TICKS: usize = 10;

/// Where levels are.
struct Levels<'a> {
    texts: Vec<&'a str>,
    at: Vec<f64>,
}

impl<'a> Levels<'a> {
    /// Numbers by their values, their logarithms where these are spread wider and positive; texts one after another.
    fn of(mut texts: Vec<&'a str>) -> Self {
        let step = texts.len().div_ceil(MOST_LEVELS).max(1);
        texts = texts.into_iter().step_by(step).collect();
        let numbers: Option<Vec<f64>> =
            texts.iter().map(|t| t.parse().ok().filter(|v: &f64| drawable(*v))).collect();
        let Some(numbers) = numbers else {
            let at = (0..texts.len()).map(|place| place as f64).collect();
            return Self { texts, at };
        };
        let (low, high) =
            numbers.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
        let is_log = low > 0.0 && high / low > FAR;
        let mut pairs: Vec<_> =
            numbers.iter().map(|v| if is_log { v.log10() } else { *v }).zip(texts).collect();
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (at, texts) = pairs.into_iter().unzip();
        Self { texts, at }
    }

    fn range(&self) -> Range<f64> {
        padded(&crate::report::plots::finite_range(self.at.iter().copied()))
    }
}

/// The upright axis that all panels have in common, mm.
fn height_of(all: &[&MeanWithInterval]) -> Scale {
    let ends = |m: &&MeanWithInterval| [m.quantiles[0], m.quantiles[2], m.mean].map(|metres| MM * metres);
    let values = || all.iter().flat_map(ends).filter(|v| drawable(*v));
    let (low, high) = (values().fold(f64::INFINITY, f64::min), values().fold(1e-6, f64::max));
    Scale::logarithmic(low, high, FAR, MOST_TICKS).unwrap_or_else(|| Scale::linear(0.0..1.08 * high))
}

/// A panel: the groups whose first level is this.
struct Panel<'a> {
    title: Option<String>,
    groups: Vec<&'a GroupSummary>,
}

fn panels(summary: &CampaignSummary) -> Vec<Panel<'_>> {
    let [first, _] = &summary.study.factors[..] else {
        return vec![Panel { title: None, groups: summary.groups.iter().collect() }];
    };
    let levels = distinct(summary.groups.iter().filter_map(|group| group.levels.first()));
    let step = levels.len().div_ceil(MOST_PANELS).max(1);
    let panel = |text: &str| Panel {
        title: Some(cut(&format!("{} = {}", cut(&first.name, 20), level(text)), 34)),
        groups: summary
            .groups
            .iter()
            .filter(|group| group.levels.first().is_some_and(|l| l == text))
            .collect(),
    };
    levels.into_iter().step_by(step).map(panel).collect()
}

pub(super) fn curves(summary: &CampaignSummary) -> Result<String, ReportError> {
    const TITLE: i32 = 24;
    const FOOT: i32 = 20;
    let panels = panels(summary);
    let levels = Levels::of(distinct(summary.groups.iter().filter_map(|group| group.levels.last())));
    let modes = modes(summary);
    let all: Vec<_> = summary
        .groups
        .iter()
        .flat_map(|group| (0..modes.len()).filter_map(|place| Some(&set_of(group, place)?.rms_3d)))
        .collect();
    let height = height_of(&all);
    let columns = panels.len().clamp(1, COLUMNS);
    let rows = panels.len().div_ceil(columns).max(1);
    let (panel, title) = if panels.len() == 1 { (300, 0) } else { (200, TITLE) };
    let body = (panel + title) * i32::try_from(rows).unwrap_or(1);
    let name = summary.study.factors.last().map_or_else(String::new, |factor| cut(&factor.name, 80));
    svg("sweep", "Accuracy over the levels", (WIDTH, body + FOOT), |area| {
        let (cells, _) = area.split_vertically(px(body));
        for (place, (panel, cell)) in panels.iter().zip(cells.split_evenly((rows, columns))).enumerate() {
            let (head, rest) = cell.split_vertically(px(title));
            if let Some(text) = &panel.title {
                centred(&head, text)?;
            }
            let mut drawing = Drawing { summary, levels: &levels, height: &height, modes: &modes };
            drawing.panel(&rest, panel, place % columns == 0)?;
        }
        foot(area, &name)
    })
}

struct Drawing<'a> {
    summary: &'a CampaignSummary,
    levels: &'a Levels<'a>,
    height: &'a Scale,
    modes: &'a [Mode],
}

impl Drawing<'_> {
    fn panel(&mut self, area: &Area, panel: &Panel, with_title: bool) -> Drawn {
        let (x, y) = (self.levels.range(), self.height.range.clone());
        let title = if with_title { "mean RMS 3-D error, mm" } else { "" };
        let axes = Axes { labels: (0, 6), title, ..Axes::default() };
        let chart = match &self.height.ticks[..] {
            [] => axes.draw(area, x.clone(), y.clone())?,
            ticks => axes.draw_log(area, x.clone(), y.clone(), ticks)?,
        };
        self.level_names(area, &chart)?;
        if let Some(at) = self
            .summary
            .tolerance
            .map(|tolerance| self.height.at(MM * tolerance))
            .filter(|at| *at > y.start && *at < y.end)
        {
            dashed(&chart, [(x.start, at), (x.end, at)], ink(3))?;
        }
        let curves: Vec<_> =
            (0..self.modes.len()).map(|place| (look(self.modes[place]), self.points(panel, place))).collect();
        for (look, points) in &curves {
            self.bands(&chart, look, points)?;
        }
        for (look, points) in &curves {
            self.curve(&chart, look, points)?;
        }
        Ok(())
    }

    /// The levels that have an accuracy, in the order of the axis.
    fn points<'b>(&self, panel: &Panel<'b>, place: usize) -> Vec<(f64, &'b MeanWithInterval)> {
        let find = |text: &str| {
            panel.groups.iter().find(|group| group.levels.last().is_some_and(|level| level == text))
        };
        let point = |(text, at): (&&str, &f64)| Some((*at, &set_of(find(text)?, place)?.rms_3d));
        let is_drawable = |(_, m): &(f64, &MeanWithInterval)| {
            [m.mean, m.quantiles[0], m.quantiles[2]].iter().all(|metres| drawable(MM * metres))
        };
        self.levels.texts.iter().zip(&self.levels.at).filter_map(point).filter(is_drawable).collect()
    }

    fn bands(&self, chart: &Chart, look: &Look, points: &[(f64, &MeanWithInterval)]) -> Drawn {
        let of = |ends: &dyn Fn(&MeanWithInterval) -> (f64, f64), strength: f64| -> Drawn {
            let (mut there, mut back) = (Vec::new(), Vec::new());
            for (x, m) in points {
                let (low, high) = ends(m);
                there.push((*x, self.height.at(MM * low)));
                back.push((*x, self.height.at(MM * high)));
            }
            let plot = chart.plotting_area();
            if let ([low], [high]) = (&there[..], &back[..]) {
                return plot.draw(&PathElement::new(
                    vec![*low, *high],
                    look.light.mix(2.0 * strength).stroke_width(8),
                ));
            }
            there.extend(back.into_iter().rev());
            plot.draw(&Polygon::new(there, look.light.mix(strength).filled()))
        };
        if points.is_empty() {
            return Ok(());
        }
        of(&|m| (m.quantiles[0], m.quantiles[2]), 0.14)?;
        of(&|m| (m.mean - m.half_width.unwrap_or(0.0), m.mean + m.half_width.unwrap_or(0.0)), 0.3)
    }

    fn curve(&self, chart: &Chart, look: &Look, points: &[(f64, &MeanWithInterval)]) -> Drawn {
        let line: Vec<_> = points.iter().map(|(x, m)| (*x, self.height.at(MM * m.mean))).collect();
        if line.len() > 1 {
            curve(chart, look, line.clone())?;
        }
        for at in line {
            chart.plotting_area().draw(&marker(look, at, 7))?;
        }
        Ok(())
    }

    /// The levels below the axis, as far as there is room.
    fn level_names(&self, area: &Area, chart: &Chart) -> Drawn {
        let plot = chart.plotting_area();
        let (left, top) = area.get_base_pixel();
        let style = text_style().pos(Pos::new(HPos::Center, VPos::Top));
        let width = f64::from(area.dim_in_pixel().0) / f64::from(SCALE);
        // Digits of 12 pixels are some 7 wide.
        let room = ((width - 72.0) / self.levels.texts.len().max(1) as f64 / 7.0).max(6.0);
        // Rounded down, at most some hundred.
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let most = room as usize;
        let mut free = i32::MIN;
        for (text, at) in self.levels.texts.iter().zip(&self.levels.at) {
            let (column, row) = plot.map_coordinate(&(*at, self.height.range.start));
            let name = cut(&level(text), most);
            let half = px(4) * i32::try_from(name.chars().count()).unwrap_or(0);
            plot.draw(
                &(EmptyElement::at((*at, self.height.range.start))
                    + PathElement::new(vec![(0, 0), (0, 6)], ink(2))),
            )?;
            if column - half < free {
                continue;
            }
            free = column + half + px(4);
            area.draw(&Text::new(name, (column - left, row - top + px(7)), style.clone()))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_are_where_their_values_are() {
        let of = |texts: &[&'static str]| Levels::of(texts.to_vec());
        let numbers = of(&["40", "20", "100"]);
        assert_eq!((numbers.texts, numbers.at), (vec!["20", "40", "100"], vec![20.0, 40.0, 100.0]));
        // More than a decade, and above zero.
        assert_eq!(of(&["0.01", "1", "10"]).at, [-2.0, 0.0, 1.0]);
        assert_eq!(of(&["0", "1", "100"]).at, [0.0, 1.0, 100.0]);
        assert_eq!(of(&["\"tight\"", "\"wide\"", "3"]).at, [0.0, 1.0, 2.0]);
        let many: Vec<String> = (0..1000).map(|i| i.to_string()).collect();
        let many = Levels::of(many.iter().map(String::as_str).collect());
        assert!(many.at.len() <= MOST_LEVELS && many.at.len() > MOST_LEVELS / 2);
    }
}
