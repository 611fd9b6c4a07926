//! `compensation.html`: one file that opens anywhere, without scripts and without anything fetched.

use maud::{Markup, PreEscaped, html};

use super::figure::{BEFORE, MARKED, SURE, arrow_factor, command_figure, size_figure, way_figure};
use super::{bend_ratio, listed, marks, sentences, title, with_unit};
use crate::compensate::{Compensation, Lengths};
use crate::report::files::ReportError;
use crate::report::markup::{key, page};
use crate::report::words::{counted, number};
use calibrig_estimation::compensation::{CompensatedPoint, CorrectionGrid, GridSpread};

/// The page of corrected commands.
pub fn compensation_html(made: &Compensation) -> Result<String, ReportError> {
    let has_points = made.corrected().next().is_some();
    let figures =
        if has_points { Some([way_figure(made)?, size_figure(made)?, command_figure(made)?]) } else { None };
    let body = html! {
        (header(made))
        main {
            @if !made.doubts.is_empty() {
                aside.doubt role="note" {
                    p { strong { "To be looked at" } }
                    ul { @for doubt in &made.doubts { li { (doubt) } } }
                }
            }
            section #summary {
                h2 { "Summary" }
                ul { @for line in sentences(made) { li { (line) } } }
                @if !made.remarks.is_empty() {
                    ul.warnings { @for line in &made.remarks { li { (line) } } }
                }
                p.note {
                    "\u{201c}Left\u{201d} is what remains on the identified model. The machine differs from the model; the standard deviations hold as much of that as the fit has seen. "
                    "The tool is taken as exact."
                }
            }
            @if made.asked > 0 { (points_section(made, figures.as_ref())) }
            @if let Some(grid) = &made.grid { (grid_section(grid)) }
        }
    };
    Ok(page(&title(made), &body))
}

fn header(made: &Compensation) -> Markup {
    let place = made.tool.flange_from_tool().translation.vector;
    html! {
        header {
            p.eyebrow { "Corrected commands" }
            h1 { (made.robot) }
            dl.facts {
                div { dt { "Model" } dd { (made.mode.title()) } }
                @if !made.file.is_empty() { div { dt { "Targets" } dd { (made.file) } } }
                @if made.asked > 0 {
                    div { dt { "Taken as" } dd { @if made.is_path { "a path of " } (counted(made.asked, "point")) } }
                }
                div { dt { "Tool" } dd {
                    (made.tool_name) ", at " (format!("{:.3}, {:.3}, {:.3}", 1e3 * place.x, 1e3 * place.y, 1e3 * place.z)) " mm in the flange"
                } }
                div { dt { "Criterion" } dd { (made.criterion) } }
                div { dt { "Estimated by" } dd { (made.estimated_by) } }
                div { dt { "Software" } dd { "calibrig " (env!("CARGO_PKG_VERSION")) } }
                div.wide { dt { "SHA-256 of the nominal model" } dd.hash { (made.model_sha256) } }
            }
        }
    }
}

fn points_section(made: &Compensation, figures: Option<&[String; 3]>) -> Markup {
    html! {
        section #points {
            h2 { "Tool" }
            div.scroll { table {
                thead { tr { th {} th { "mean" } th { "RMS" } th { "max" } } }
                tbody {
                    (length_line("nominal command misses by, mm", made.before(), 1e3))
                    (length_line("left by the corrected one, \u{b5}m", made.left(), 1e6))
                    (length_line("standard deviation in space, mm", made.sigmas(), 1e3))
                }
            } }
            @if let Some([way, size, _]) = figures {
                figure {
                    div.legend {
                        span { (key(&BEFORE)) "where the nominal command is predicted to put the tool" }
                        span { (key(&MARKED)) "not met, too fast, or unsure" }
                    }
                    div.scroll { (PreEscaped(way)) }
                    figcaption {
                        "Goals in three views of the base frame. Arrows are drawn " (factor_words(arrow_factor(made)))
                        " times as long as they are, at some of the points where there are many."
                    }
                }
                figure {
                    div.legend {
                        span { (key(&BEFORE)) "the nominal command misses by" }
                        span { (key(&SURE)) "standard deviation of the corrected position" }
                        span { (key(&MARKED)) "outside the commands that were measured" }
                    }
                    div.scroll { (PreEscaped(size)) }
                    figcaption {
                        "Where the standard deviation is nearly as large as the correction, do not trust the correction: measure more poses there."
                        @if let Some(trust) = made.trust { " The line is at " (number(1e3 * trust, 3)) " mm, as asked for." }
                    }
                }
            }
            h2 { "Actuators" }
            (actuator_table(made))
            @if let Some([_, _, commands]) = figures {
                figure {
                    div.scroll { (PreEscaped(commands)) }
                    figcaption { "Corrected commands, and their difference from the commands of the nominal robot." }
                }
            }
            (point_table(made))
        }
    }
}

/// 1, 2 or 5 times a power of ten.
fn factor_words(factor: f64) -> String {
    if factor >= 1.0 { number(factor, 0) } else { number(factor, 4) }
}

fn length_line(title: &str, lengths: Option<Lengths>, unit: f64) -> Markup {
    html! {
        tr {
            th scope="row" { (title) }
            @match lengths {
                Some(of) => { td { (number(unit * of.mean, 4)) } td { (number(unit * of.rms, 4)) } td { (number(unit * of.max, 4)) } }
                None => { td { "\u{2013}" } td { "\u{2013}" } td { "\u{2013}" } }
            }
        }
    }
}

fn cell(value: Option<f64>, decimals: usize) -> Markup {
    html! { td { @match value { Some(value) => (number(value, decimals)), None => "\u{2013}" } } }
}

fn actuator_table(made: &Compensation) -> Markup {
    html! {
        div.scroll { table {
            thead { tr {
                th {} th { "largest" br; "correction" }
                @if made.is_path { th { "largest" br; "speed, 1/s" } th { "limit" br; "1/s" } th { "bend over" br; "nominal" } }
                th { "measured" br; "from" } th { "to" }
            } }
            tbody {
                @for (index, actuator) in made.actuators.iter().enumerate().filter(|(_, actuator)| actuator.is_commanded) {
                    tr {
                        th scope="row" { (with_unit(actuator)) }
                        (cell(made.largest_change(index).map(|v| actuator.shown(v)), 4))
                        @if made.is_path {
                            (cell(made.largest_speed(index).map(|v| actuator.shown(v)), 2))
                            (cell(made.speed_limits.get(index).copied().filter(|v| v.is_finite()).map(|v| actuator.shown(v)), 2))
                            (cell(made.bends(index).map(bend_ratio), 3))
                        }
                        (cell(made.region.command_min.get(index).map(|v| actuator.shown(*v)), 2))
                        (cell(made.region.command_max.get(index).map(|v| actuator.shown(*v)), 2))
                    }
                }
            }
        } }
        @if made.is_path {
            p.note { "Bend: the largest second difference of the corrected commands over that of the nominal ones; at 1 they are equally smooth." }
        }
    }
}

fn point_table(made: &Compensation) -> Markup {
    let (shown, rest) = listed(made);
    if shown.is_empty() {
        return html! {};
    }
    let all = shown.len() == made.points.len();
    html! {
        h2 { @if all { "Points" } @else { "Points to be looked at" } }
        div.scroll { table {
            thead { tr { th { "point" } th.words { "name" } th { "before, mm" } th { "left, \u{b5}m" } th { "\u{3c3}, mm" } th.words { "marks" } } }
            tbody {
                @for index in shown {
                    @let point = &made.points[index];
                    @let found = point.point.as_ref();
                    tr {
                        td { (index + 1) }
                        td.words { (point.name.name) " " (point.name.place) }
                        (cell(found.map(|found| 1e3 * found.uncompensated.norm()), 4))
                        (cell(found.map(|found| 1e6 * CompensatedPoint::missed(found)), 4))
                        (cell(point.sigma().map(|sigma| 1e3 * sigma), 4))
                        td.words { (marks(made, point).join(", ")) }
                    }
                }
            }
        } }
        @if rest > 0 { p.note { "And " (rest) " more: compensated.csv." } }
    }
}

fn grid_section(grid: &CorrectionGrid) -> Markup {
    let [nx, ny, nz] = grid.plan.counts;
    let place = |v: nalgebra::Vector3<f64>| format!("({:.3}, {:.3}, {:.3}) m", v.x, v.y, v.z);
    let line = |title: &str, of: &GridSpread| {
        html! {
            tr { th scope="row" { (title) } td { (number(1e3 * of.mean, 4)) } td { (number(1e3 * of.rms, 4)) } td { (number(1e3 * of.max, 4)) } }
        }
    };
    html! {
        section #grid {
            h2 { "Grid of offsets" }
            p { (nx) " \u{d7} " (ny) " \u{d7} " (nz) " points from " (place(grid.plan.low)) " to " (place(grid.plan.high)) ": grid.csv." }
            div.scroll { table {
                thead { tr { th { "At the middles of " (counted(grid.interpolated.points, "cell")) ", mm" } th { "mean" } th { "RMS" } th { "max" } } }
                tbody {
                    (line("without offsets", &grid.uncorrected))
                    (line("with offsets laid between the points", &grid.interpolated))
                }
            } }
            p.note {
                "Command a place plus its offset, and the tool comes to the place itself, on the model and with the redundancy resolved as here. At the points of the grid nothing is left. The table has the middles of the cells, where offsets are interpolated."
            }
        }
    }
}
