//! How the accuracy of single trials is spread, mode by mode.

use std::ops::Range;

use maud::{Markup, html};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::words::{MM, NONE, count, drawn, mean, millimetres, rate, set_title, set_words, stacked, unit};
use crate::montecarlo::{
    AccuracySet, CampaignSummary, GroupSummary, MeanWithInterval, ModeSummary, Rate, SetSummary, decimals,
};
use crate::report::files::ReportError;
use crate::report::markup::key;
use crate::report::plots::{
    Area, Chart, Drawn, INK, Scale, WIDTH, dashed, drawable, finite_range, foot, ink, look, marker, padded,
    px, svg, text_style, tick, values_below, vertical_ticks, whisker,
};
use crate::report::words::number;
use calibrig_campaign::statistics::Histogram;

/// Values this far from each other are shown on a logarithmic axis.
const FAR: f64 = 6.0;
/// A tolerance this far from all trials is told instead of drawn.
const BEYOND: f64 = 5.0;

/// The modes with the set that they are told of.
pub(super) fn told(group: &GroupSummary) -> Vec<(&ModeSummary, &SetSummary)> {
    group.modes.iter().filter_map(|mode| Some((mode, mode.told()?))).collect()
}

/// The section of one group of trials.
pub(super) fn section(summary: &CampaignSummary, group: &GroupSummary) -> Markup {
    let rows = told(group);
    let Some((_, first)) = rows.first() else {
        return html! { section #distribution { h2 { "Accuracy" } p { "No trial has an accuracy." } } };
    };
    html! {
        section #distribution {
            h2 { "Accuracy" }
            (tiles(&rows))
            figure {
                div.legend { @for (mode, _) in &rows { span { (key(&look(mode.mode))) (mode.mode.title()) } } }
                (drawn(histograms(summary, &rows)))
                figcaption { (caption(summary, &rows)) }
            }
            (table(&rows))
            @if let Some(tolerance) = summary.tolerance { (rates(tolerance, &rows)) }
            (axes_table(group))
            p.note { "Where nothing else is said, of the " (set_words(first.kind)) ". " (intervals_words(summary)) }
        }
    }
}

fn intervals_words(summary: &CampaignSummary) -> &'static str {
    match summary.study.design {
        calibrig_campaign::design::Design::Plain { .. } => {
            "All intervals are of 95 % confidence: of a mean Student's t, of a quantile by the order of the trials (for any distribution), of a share exact (Clopper-Pearson)."
        }
        _ => {
            "Intervals are of 95 % confidence for independent trials. Trials of this design have factors and draws in common, so that these are a guide only; those of the sensitivities below hold."
        }
    }
}

fn tiles(rows: &[(&ModeSummary, &SetSummary)]) -> Markup {
    html! {
        div.tiles {
            @for (mode, set) in rows {
                @let own = &set.rms_3d;
                @let (unit, factor) = unit(own.mean);
                @let digits = own.half_width.map_or(3, |half| decimals(factor * half));
                div.tile {
                    div.name { (key(&look(mode.mode))) (mode.mode.title()) }
                    div.figure { (number(factor * own.mean, digits)) "\u{a0}" (unit) }
                    div.note {
                        @if let Some(half) = own.half_width { "\u{b1} " (number(factor * half, digits)) "\u{a0}" (unit) " (95 %): " }
                        "mean of the RMS 3-D error over " (count(own.trials)) " trials"
                    }
                }
            }
        }
    }
}

fn caption(summary: &CampaignSummary, rows: &[(&ModeSummary, &SetSummary)]) -> Markup {
    let x = span(rows);
    html! {
        "Distribution of the trials by the RMS of their 3-D errors, each mode on its own height: bins of equal width from its least to its largest trial. "
        @if !axis_of(rows, summary.tolerance).ticks.is_empty() { "The areas are the shares of the trials. " }
        "Below, from the 5 % to the 95 % quantile of single trials, with the mean as marker. "
        @if let Some(tolerance) = summary.tolerance {
            @if is_near(tolerance, &x) { "Dashed: the tolerance, " (millimetres(tolerance)) "." }
            @else if MM * tolerance > x.end { "The tolerance, " (millimetres(tolerance)) ", lies far to the right of all trials." }
            @else { "The tolerance, " (millimetres(tolerance)) ", lies far to the left of all trials." }
        }
    }
}

/// Least and largest RMS, mm.
fn span(rows: &[(&ModeSummary, &SetSummary)]) -> Range<f64> {
    let ends = rows.iter().flat_map(|(_, set)| {
        let bins = set.histogram.iter().flat_map(|h| {
            let last = h.counts().len().saturating_sub(1);
            [h.edges(0).0, h.edges(last).1]
        });
        bins.chain([set.rms_3d.mean]).map(|metres| MM * metres)
    });
    let (low, high) =
        ends.filter(|v| drawable(*v)).fold((f64::INFINITY, 0.0_f64), |(l, h), v| (l.min(v), h.max(v)));
    low.min(high)..high
}

fn is_near(tolerance: f64, x: &Range<f64>) -> bool {
    (x.start / BEYOND..=x.end * BEYOND).contains(&(MM * tolerance))
}

/// The axis that all modes have in common, mm.
fn axis_of(rows: &[(&ModeSummary, &SetSummary)], tolerance: Option<f64>) -> Scale {
    let mut x = span(rows);
    if let Some(tolerance) = tolerance.filter(|t| is_near(*t, &x)) {
        x = x.start.min(MM * tolerance)..x.end.max(MM * tolerance);
    }
    let linear = || Scale::linear(padded(&finite_range([x.start, x.end].into_iter())));
    Scale::logarithmic(x.start, x.end, FAR, usize::MAX).unwrap_or_else(linear)
}

/// Heights of bins: their shares, on a logarithmic axis over their width there, so that areas are shares.
fn heights<'b>(axis: &'b Scale, bins: &'b [Bin]) -> impl Iterator<Item = f64> + 'b {
    let width = |bin: &Bin| (axis.at(MM * bin.ends.1) - axis.at(MM * bin.ends.0)).max(1e-6);
    bins.iter().map(move |bin| if axis.ticks.is_empty() { bin.share } else { bin.share / width(bin) })
}

/// A row a mode, on one axis.
fn histograms(
    summary: &CampaignSummary,
    rows: &[(&ModeSummary, &SetSummary)],
) -> Result<String, ReportError> {
    const PANEL: i32 = 104;
    const FOOT: i32 = 46;
    let axis = axis_of(rows, summary.tolerance);
    let count = i32::try_from(rows.len()).unwrap_or(1).max(1);
    svg(
        "distributions",
        "Distribution of the RMS error over the trials",
        (WIDTH, PANEL * count + FOOT),
        |area| {
            for (place, (mode, set)) in rows.iter().enumerate() {
                let is_last = place + 1 == rows.len();
                let top = px(PANEL * i32::try_from(place).unwrap_or(0));
                let height = px(PANEL + if is_last { 26 } else { 0 });
                let panel = area.clone().shrink((0, top), (px(WIDTH), height));
                let bins = shares(set.histogram.as_ref(), set.rms_3d.trials);
                let most = heights(&axis, &bins).fold(0.0, f64::max).max(1e-6);
                let y = -0.28 * most..1.05 * most;
                let mut chart = ChartBuilder::on(&panel)
                    .margin_top(px(6))
                    .margin_left(px(10))
                    .margin_right(px(14))
                    .x_label_area_size(px(if is_last { 26 } else { 0 }))
                    .y_label_area_size(px(52))
                    .build_cartesian_2d(axis.range.clone(), y.clone())?;
                below(&panel, &mut chart, &axis, (&y, is_last))?;
                let drawing = Bars { axis: &axis, look: &look(mode.mode), set, most };
                drawing.draw(&panel, &chart, &bins)?;
                if let Some(tolerance) = summary.tolerance.filter(|t| is_near(*t, &span(rows))) {
                    let at = axis.at(MM * tolerance);
                    dashed(&chart, [(at, y.start), (at, y.end)], ink(3))?;
                }
            }
            foot(
                area,
                if axis.ticks.is_empty() { "RMS 3-D error, mm" } else { "RMS 3-D error, mm (logarithmic)" },
            )
        },
    )
}

/// Lines of the grid, and their values below the last panel.
fn below(panel: &Area, chart: &mut Chart, axis: &Scale, (y, is_last): (&Range<f64>, bool)) -> Drawn {
    if axis.ticks.is_empty() {
        if is_last {
            return values_below(chart, panel.dim_in_pixel().0, 4..=10);
        }
        return chart
            .configure_mesh()
            .disable_y_mesh()
            .disable_axes()
            .x_labels(10)
            .bold_line_style(crate::report::plots::GRID.stroke_width(2))
            .light_line_style(TRANSPARENT)
            .draw();
    }
    if is_last {
        return vertical_ticks(panel, chart, &axis.ticks, y);
    }
    let plot = chart.plotting_area();
    for value in &axis.ticks {
        let line = vec![(value.log10(), y.start), (value.log10(), y.end)];
        plot.draw(&PathElement::new(line, crate::report::plots::GRID.stroke_width(2)))?;
    }
    Ok(())
}

/// How many bins of the summary are drawn as one: twice the third root of the number of trials (Rice's rule) is as many as they fill.
fn merged(bins: usize, trials: u64) -> usize {
    let wanted = 2.0 * (trials as f64).cbrt();
    (1..=bins).find(|by| bins.is_multiple_of(*by) && (bins / by) as f64 <= wanted.max(1.0)).unwrap_or(1)
}

/// A bin that is drawn.
struct Bin {
    /// m.
    ends: (f64, f64),
    /// Share of the trials, %.
    share: f64,
}

fn shares(histogram: Option<&Histogram>, trials: u64) -> Vec<Bin> {
    let Some(histogram) = histogram else { return Vec::new() };
    let counts = histogram.counts();
    let by = merged(counts.len(), trials);
    let share =
        |place: usize| 1e2 * counts[place..place + by].iter().sum::<u64>() as f64 / trials.max(1) as f64;
    let ends = |place: usize| (histogram.edges(place).0, histogram.edges(place + by - 1).1);
    let bins = (0..counts.len()).step_by(by).map(|place| Bin { ends: ends(place), share: share(place) });
    bins.filter(|bin| bin.share > 0.0 && drawable(MM * bin.ends.0) && drawable(MM * bin.ends.1)).collect()
}

struct Bars<'a> {
    axis: &'a Scale,
    look: &'a crate::report::plots::Look,
    set: &'a SetSummary,
    most: f64,
}

impl Bars<'_> {
    fn draw(&self, panel: &Area, chart: &Chart, bins: &[Bin]) -> Drawn {
        let plot = chart.plotting_area();
        let at = |metres: f64| self.axis.at(MM * metres);
        for (bin, height) in bins.iter().zip(heights(self.axis, bins)) {
            let (low, high) = (at(bin.ends.0), at(bin.ends.1));
            plot.draw(&Rectangle::new([(low, 0.0), (high, height)], self.look.light.mix(0.4).filled()))?;
            let outline = vec![(low, 0.0), (low, height), (high, height), (high, 0.0)];
            plot.draw(&PathElement::new(outline, self.look.light.stroke_width(2)))?;
        }
        let range = &self.axis.range;
        plot.draw(&PathElement::new(
            vec![(range.start, 0.0), (range.end, 0.0)],
            INK.mix(0.6).stroke_width(2),
        ))?;
        self.spread(chart)?;
        // On a logarithmic axis heights are no shares.
        if !self.axis.ticks.is_empty() || bins.is_empty() {
            return Ok(());
        }
        let (left, top) = panel.get_base_pixel();
        let style = text_style().pos(Pos::new(HPos::Right, VPos::Center));
        for share in [0.0, self.most] {
            let (column, row) = plot.map_coordinate(&(range.start, share));
            let text = format!("{} %", tick((10.0 * share).round() / 10.0));
            panel.draw(&Text::new(text, (column - left - px(6), row - top), style.clone()))?;
        }
        Ok(())
    }

    /// From the 5 % to the 95 % quantile, and the mean.
    fn spread(&self, chart: &Chart) -> Drawn {
        let MeanWithInterval { mean, quantiles: [low, _, high], .. } = &self.set.rms_3d;
        if ![low, mean, high].iter().all(|metres| drawable(MM * **metres)) {
            return Ok(());
        }
        let plot = chart.plotting_area();
        let y = -0.14 * self.most;
        let style = self.look.light.stroke_width(4);
        whisker(chart, style, [*low, *high].map(|metres| self.axis.at(MM * metres)), y)?;
        plot.draw(&marker(self.look, (self.axis.at(MM * mean), y), 8))
    }
}

fn table(rows: &[(&ModeSummary, &SetSummary)]) -> Markup {
    html! {
        div.scroll { table {
            caption { "RMS 3-D error over the trials, with 95 % intervals" }
            thead { tr {
                th {} th { "trials" } th { "unit" } th { "mean" } th { "standard" br; "deviation" } th { "5 %" } th { "median" } th { "95 %" }
            } }
            tbody { @for (mode, set) in rows {
                @let own = &set.rms_3d;
                @let (unit, factor) = unit(own.mean);
                tr {
                    th scope="row" { (key(&look(mode.mode))) (mode.mode.title()) }
                    td { (count(own.trials)) }
                    td { (unit) }
                    td { (mean(own, factor)) }
                    td { @match &own.deviation { Some(deviation) => (stacked(deviation.value, deviation.interval, factor)), None => (NONE) } }
                    @for (value, interval) in own.quantiles.iter().zip(own.quantile_intervals) { td { (stacked(*value, interval, factor)) } }
                }
            } }
        } }
    }
}

/// How often a trial was a success.
fn rates(tolerance: f64, rows: &[(&ModeSummary, &SetSummary)]) -> Markup {
    let cell = |share: &Option<Rate>| html! { @match share { Some(share) => (rate(share)), None => (NONE) } };
    html! {
        div.scroll { table {
            caption { "Trials within the tolerance, " (millimetres(tolerance)) ", with 95 % intervals" }
            thead { tr { th {} th { "RMS within it" } th { "every pose within it" } } }
            tbody { @for (mode, set) in rows {
                tr { th scope="row" { (key(&look(mode.mode))) (mode.mode.title()) } td { (cell(&set.rms_within)) } td { (cell(&set.max_within)) } }
            } }
        } }
        p.note { "Shares are of all trials: one that failed is no success." }
    }
}

/// Errors by axis, of both sets.
fn axes_table(group: &GroupSummary) -> Markup {
    html! {
        details {
            summary { "By axis and set" }
            @for kind in AccuracySet::ALL {
                @let rows: Vec<_> = group.modes.iter().filter_map(|m| Some((m, m.sets.iter().find(|s| s.kind == kind)?))).collect();
                @if !rows.is_empty() {
                    div.scroll { table {
                        caption { (set_title(kind)) ": absolute errors of a trial, mean over the trials with its 95 % interval" }
                        thead {
                            tr { th rowspan="2" {} th rowspan="2" { "unit" } @for axis in ["x", "y", "z", "3-D"] { th.group colspan="2" { (axis) } } }
                            tr { @for _ in 0..3 { th.first { "mean" } th { "max" } } th.first { "RMS" } th { "max" } }
                        }
                        tbody { @for (mode, set) in rows { @let (unit, factor) = unit(set.rms_3d.mean); tr {
                            th scope="row" { (key(&look(mode.mode))) (mode.mode.title()) } td { (unit) }
                            @for axis in 0..3 { td.first { (mean(&set.mean[axis], factor)) } td { (mean(&set.max[axis], factor)) } }
                            td.first { (mean(&set.rms_3d, factor)) } td { (mean(&set.max_3d, factor)) }
                        } } }
                    } }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_are_as_many_as_the_trials_fill() {
        assert_eq!(
            [1, 8, 100, 1000, 8000, 1_000_000].map(|trials| 40 / merged(40, trials)),
            [2, 4, 8, 20, 40, 40]
        );
    }

    #[test]
    fn merged_bins_hold_every_trial_once() {
        let mut histogram = Histogram::new(1e-3, 2e-3, 40).expect("a range");
        (0..100).for_each(|i| histogram.add(1e-3 + 1e-5 * f64::from(i)));
        let bins = shares(Some(&histogram), 100);
        assert_eq!(bins.len(), 8);
        assert!((bins.iter().map(|bin| bin.share).sum::<f64>() - 100.0).abs() < 1e-9);
        assert!((bins[0].ends.0 - 1e-3).abs() < 1e-12 && (bins[7].ends.1 - 2e-3).abs() < 1e-12);
        // On a logarithmic axis areas are the shares.
        let axis = Scale { ticks: vec![1.0, 2.0], range: 0.0..2.0_f64.log10() };
        let width = |bin: &Bin| axis.at(1e3 * bin.ends.1) - axis.at(1e3 * bin.ends.0);
        let areas: f64 =
            bins.iter().zip(heights(&axis, &bins)).map(|(bin, height)| height * width(bin)).sum();
        assert!((areas - 100.0).abs() < 1e-9, "{areas}");
    }
}
