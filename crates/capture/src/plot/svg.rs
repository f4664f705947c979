//! Draws a chart as SVG.

use std::fmt::Write as _;

use polepair_core::escape::EscapedText;

use super::{PlotPanel, scale};
use crate::date;
use crate::timestamp::Timestamp;

const WIDTH: f64 = 960.0;
const LEFT: f64 = 84.0;
const RIGHT: f64 = 20.0;
const TOP: f64 = 30.0;
const HEIGHT: f64 = 180.0;
const BETWEEN: f64 = 40.0;
const FOOT: f64 = 46.0;
/// Stretches of time that a line is drawn with: two for each unit of width.
const BUCKETS: usize = 1800;
/// Colours that people with colour blindness can distinguish (Okabe and Ito, 2008).
const COLOURS: [&str; 7] =
    ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000"];

pub(super) fn draw(panels: &[PlotPanel<'_>], span: (u64, u64), first: Option<Timestamp>) -> String {
    let step = HEIGHT + BETWEEN;
    let height = TOP + step * panels.len() as f64 - BETWEEN + FOOT;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" \
         width=\"{WIDTH}\" height=\"{height}\" font-family=\"sans-serif\" font-size=\"12\">\n\
         <rect width=\"{WIDTH}\" height=\"{height}\" fill=\"#ffffff\"/>\n"
    );
    for (number, panel) in panels.iter().enumerate() {
        draw_panel(panel, span, TOP + step * number as f64, number + 1 == panels.len(), &mut out);
    }
    let since =
        first.map_or_else(String::new, |first| format!(" since {}", date::format_utc(first)));
    let (x, y) = (LEFT + (WIDTH - LEFT - RIGHT) / 2.0, height - 8.0);
    let _ = writeln!(
        out,
        "<text x=\"{x}\" y=\"{y}\" text-anchor=\"middle\" fill=\"#444444\">time [s]{since}</text>\n\
         </svg>"
    );
    out
}

fn draw_panel(panel: &PlotPanel<'_>, span: (u64, u64), top: f64, last: bool, out: &mut String) {
    let (begin, end) = span;

    let wide = WIDTH - LEFT - RIGHT;
    let (min, max) = panel.range;
    let (ticks, decimals) = scale::ticks(panel.range, 5);
    for tick in ticks {
        let (y, right, label) =
            (plot_y(tick, top, max, min), WIDTH - RIGHT, scale::label(tick, decimals));
        let (at, below) = (LEFT - 8.0, y + 4.0);
        let _ = writeln!(
            out,
            "<path d=\"M{LEFT} {y:.1}H{right}\" stroke=\"#dddddd\"/>\
             <text x=\"{at}\" y=\"{below:.1}\" text-anchor=\"end\" fill=\"#444444\">{label}</text>"
        );
    }
    let (ticks, decimals) = scale::ticks((begin as f64 / 1e9, end as f64 / 1e9), 10);
    let bottom = top + HEIGHT;
    for tick in ticks {
        let x = plot_x(tick * 1e9, begin, end, wide);
        let _ = writeln!(out, "<path d=\"M{x:.1} {top}V{bottom}\" stroke=\"#eeeeee\"/>");
        if last {
            let (y, label) = (bottom + 16.0, scale::label(tick, decimals));
            let _ = writeln!(
                out,
                "<text x=\"{x:.1}\" y=\"{y}\" text-anchor=\"middle\" fill=\"#444444\">{label}</text>"
            );
        }
    }
    let _ = writeln!(
        out,
        "<rect x=\"{LEFT}\" y=\"{top}\" width=\"{wide}\" height=\"{HEIGHT}\" fill=\"none\" \
         stroke=\"#888888\"/>"
    );
    draw_heading(panel, top, out);
    for (number, (_, series)) in panel.lines.iter().enumerate() {
        let colour = COLOURS[number % COLOURS.len()];
        let mut path = String::new();
        for line in series.lines(BUCKETS) {
            for (n, (time, value)) in line.iter().enumerate() {
                let (x, y) =
                    (plot_x(*time as f64, begin, end, wide), plot_y(*value, top, max, min));
                let _ = write!(path, "{}{x:.1} {y:.1}", if n == 0 { 'M' } else { 'L' });
            }
            // A single value is drawn as a short line, or it would be invisible.
            path.push_str(if line.len() == 1 { "m-1.5 0h3" } else { "" });
        }
        let _ = writeln!(
            out,
            "<path d=\"{path}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\" \
             stroke-linejoin=\"round\" stroke-linecap=\"round\"/>"
        );
    }
}

fn plot_y(value: f64, top: f64, max: f64, min: f64) -> f64 {
    top + (max - value) / (max - min) * HEIGHT
}

fn plot_x(ns: f64, begin: u64, end: u64, wide: f64) -> f64 {
    LEFT + (ns - begin as f64) / (end - begin) as f64 * wide
}

/// The signal's name, and at the right whose line has which colour.
fn draw_heading(panel: &PlotPanel<'_>, top: f64, out: &mut String) {
    const LETTER: f64 = 7.0;
    let (y, title) = (top - 8.0, escape_markup(&panel.title));
    let _ = writeln!(out, "<text x=\"{LEFT}\" y=\"{y}\" font-weight=\"bold\">{title}</text>");
    let mut x = WIDTH - RIGHT;
    for (number, (name, _)) in panel.lines.iter().enumerate().rev() {
        let colour = COLOURS[number % COLOURS.len()];
        let _ = writeln!(
            out,
            "<text x=\"{x:.1}\" y=\"{y}\" text-anchor=\"end\" fill=\"{colour}\">{}</text>",
            escape_markup(name)
        );
        x -= name.chars().count() as f64 * LETTER + 12.0;
    }
}

fn escape_markup(text: &str) -> String {
    // XML has no control characters, not even escaped.
    EscapedText(text).to_string().replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
