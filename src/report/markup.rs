//! What every page is made of: its head with the style sheet, figures with legends, the markers of modes.

use std::fmt::Write;

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::plots::{GRID, INK, LOOKS, Look, Marker, hex, look};
use calibrig_estimation::identification::Mode;

pub(super) const CSS: &str = include_str!("report.css");

/// A page.
pub(super) fn page(title: &str, body: &Markup) -> String {
    html! { (DOCTYPE) html lang="en" { (head(title)) body { (body) } } }.into_string()
}

/// The head of every page, which needs no file beside it.
fn head(title: &str) -> Markup {
    html! {
        head {
            meta charset="utf-8";
            meta name="viewport" content="width=device-width, initial-scale=1";
            meta name="color-scheme" content="light dark";
            meta name="generator" content={ "calibrig " (env!("CARGO_PKG_VERSION")) };
            title { (title) }
            style { (PreEscaped(CSS)) (PreEscaped(figure_css())) }
        }
    }
}

/// The figures' colours on a dark page; on a light one their own attributes hold.
pub(super) fn figure_css() -> String {
    let (ink, grid) = (hex(INK), hex(GRID));
    let mut css = format!(
        "figure svg [fill=\"{ink}\"]{{fill:currentColor}}figure svg [stroke=\"{ink}\"]{{stroke:currentColor}}\
         figure svg [stroke=\"{grid}\"]{{stroke:var(--grid)}}\n@media screen and (prefers-color-scheme:dark){{"
    );
    for look in LOOKS {
        let (light, dark) = (hex(look.light), hex(look.dark));
        let _ = write!(css, "svg [fill=\"{light}\"]{{fill:{dark}}}svg [stroke=\"{light}\"]{{stroke:{dark}}}");
    }
    css.push('}');
    css
}

pub(super) fn figure(modes: &[Mode], plot: &str, caption: &Markup, lines: bool) -> Markup {
    html! {
        figure {
            div.legend {
                @for mode in modes {
                    span {
                        @if lines { (line_key(&look(*mode))) } @else { (key(&look(*mode))) }
                        (mode.title())
                    }
                }
            }
            div.scroll { (PreEscaped(plot)) }
            figcaption { (caption) }
        }
    }
}

/// The marker of a mode, to stand beside its title.
pub(super) fn key(look: &Look) -> Markup {
    let colour = hex(look.light);
    html! {
        svg.key width="14" height="14" viewBox="-7 -7 14 14" aria-hidden="true" {
            @match look.marker {
                Marker::Circle => circle r="4" fill="none" stroke=(colour) stroke-width="2" {},
                Marker::Triangle => polygon points="0,-5 5,4 -5,4" fill=(colour) {},
                Marker::Square => rect x="-4" y="-4" width="8" height="8" fill=(colour) {},
                Marker::Cross => path d="M-4-4 4 4M-4 4 4-4" stroke=(colour) stroke-width="2" {},
                Marker::Diamond => polygon points="0,-5 5,0 0,5 -5,0" fill=(colour) {},
            }
        }
    }
}

/// The line of a mode.
pub(super) fn line_key(look: &Look) -> Markup {
    let dashes = look.dash.map(|(dash, gap)| format!("{dash} {gap}"));
    html! {
        svg.key width="34" height="14" viewBox="0 -7 34 14" aria-hidden="true" {
            line x1="0" y1="0" x2="34" y2="0" stroke=(hex(look.light)) stroke-width="2" stroke-dasharray=[dashes] {}
        }
    }
}
