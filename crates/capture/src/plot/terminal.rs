//! Draws a chart with characters: two by four dots a cell.

use std::fmt::Write as _;

use super::{PlotPanel, scale};

/// Cells that labels of values take.
const LABELS: usize = 11;
/// Rows of a panel, and of the only one.
const ROWS: usize = 9;
const ROWS_ALONE: usize = 16;
/// Columns that a picture has at least.
const COLUMNS_MIN: usize = 20;
/// Colours of lines.
const COLOURS: [&str; 6] = ["36", "33", "35", "32", "31", "34"];

/// Dots of a cell, by column and row.
const DOTS: [[u32; 4]; 2] = [[0x01, 0x02, 0x04, 0x40], [0x08, 0x10, 0x20, 0x80]];
const BLANK: u32 = 0x2800;

struct Canvas {
    columns: usize,
    rows: usize,
    /// Dots, and the number of the line that was drawn last.
    cells: Vec<(u32, usize)>,
}

pub(super) fn draw(
    panels: &[PlotPanel<'_>],
    span: (u64, u64),
    width: usize,
    colour: bool,
) -> String {
    let columns = width.saturating_sub(LABELS + 2).max(COLUMNS_MIN);
    let rows = if panels.len() == 1 { ROWS_ALONE } else { ROWS };
    let mut out = String::new();
    for panel in panels {
        draw_title(panel, colour, &mut out);
        let mut canvas = Canvas::new(columns, rows);
        for (number, (_, series)) in panel.lines.iter().enumerate() {
            // A stretch for each column of dots.
            for line in series.lines(columns * 2) {
                canvas.draw_line(&line, span, panel.range, number);
            }
        }
        canvas.render(panel.range, colour, &mut out);
    }
    draw_time_axis(span, columns, &mut out);
    out
}

fn draw_title(panel: &PlotPanel<'_>, colour: bool, out: &mut String) {
    let _ = write!(out, "{:LABELS$}  {}", "", panel.title);
    for (number, (name, _)) in panel.lines.iter().enumerate() {
        let (open, close) = colour_codes(number, colour);
        let _ = write!(out, "  {open}{name}{close}");
    }
    out.push('\n');
}

fn colour_codes(number: usize, colour: bool) -> (String, &'static str) {
    if colour {
        (format!("\x1b[{}m", COLOURS[number % COLOURS.len()]), "\x1b[0m")
    } else {
        (String::new(), "")
    }
}

/// The axis of time, in seconds since the capture began.
fn draw_time_axis(span: (u64, u64), columns: usize, out: &mut String) {
    let (begin, end) = span;

    let range = (begin as f64 / 1e9, end as f64 / 1e9);
    let (ticks, decimals) = scale::ticks(range, columns / 14);
    let (mut line, mut labels) = (vec!['─'; columns], vec![' '; columns + LABELS]);
    let mut free = 0;
    for tick in ticks {
        let at = (tick - range.0) / (range.1 - range.0) * (columns - 1) as f64;
        let at = (at.round() as usize).min(columns - 1);
        let label = scale::label(tick, decimals);
        line[at] = '┬';
        let from = at.saturating_sub(label.len() / 2).max(free);
        for (location, c) in labels.iter_mut().skip(from).zip(label.chars()) {
            *location = c;
        }
        free = from + label.len() + 1;
    }
    let line: String = line.into_iter().collect();
    let labels: String = labels.into_iter().collect();
    let _ = writeln!(out, "{:LABELS$} └{line}", "");
    let _ = writeln!(out, "{:>LABELS$}  {}", "time [s]", labels.trim_end());
}

impl Canvas {
    fn new(columns: usize, rows: usize) -> Self {
        Self { columns, rows, cells: vec![(0, 0); columns * rows] }
    }

    fn draw_line(
        &mut self,
        points: &[(u64, f64)],
        span: (u64, u64),
        range: (f64, f64),
        number: usize,
    ) {
        let (begin, end) = span;

        let (min, max) = range;

        let (wide, high) = (self.columns * 2 - 1, self.rows * 4 - 1);
        let dot = |(time, value): (u64, f64)| {
            let x = time.saturating_sub(begin) as f64 / (end - begin) as f64 * wide as f64;
            let y = (max - value) / (max - min) * high as f64;
            (x.round() as i64, y.round() as i64)
        };
        let mut before = None;
        for point in points {
            let here = dot(*point);
            self.draw_segment(before.unwrap_or(here), here, number);
            before = Some(here);
        }
    }

    fn draw_segment(&mut self, from: (i64, i64), to: (i64, i64), number: usize) {
        let (to_x, to_y) = to;

        let (x, y) = from;

        let steps = (to_x - x).abs().max((to_y - y).abs());
        for step in 0..=steps {
            self.set_dot(
                moved_by_steps(x, to_x, step, steps),
                moved_by_steps(y, to_y, step, steps),
                number,
            );
        }
    }

    fn set_dot(&mut self, x: i64, y: i64, number: usize) {
        let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y)) else { return };
        if let Some(cell) = self.cells.get_mut(y / 4 * self.columns + x / 2) {
            *cell = (cell.0 | DOTS[x % 2][y % 4], number);
        }
    }

    fn render(&self, range: (f64, f64), colour: bool, out: &mut String) {
        let (ticks, decimals) = scale::ticks(range, self.rows / 3);
        for (number, row) in self.cells.chunks(self.columns).enumerate() {
            let tick = ticks.iter().find(|tick| self.tick_row(**tick, range) == number);
            let label = tick.map_or_else(String::new, |tick| scale::label(*tick, decimals));
            let edge = if tick.is_some() { '┤' } else { '│' };
            let _ = write!(out, "{label:>LABELS$} {edge}");
            let end = row.iter().rposition(|(dots, _)| *dots > 0).map_or(0, |at| at + 1);
            let mut lit = None;
            for (dots, line) in &row[..end] {
                let wanted = Some(*line).filter(|_| colour && *dots > 0);
                if wanted != lit {
                    out.push_str(if lit.is_some() { "\x1b[0m" } else { "" });
                    out.push_str(
                        &wanted.map_or_else(String::new, |line| colour_codes(line, true).0),
                    );
                    lit = wanted;
                }
                out.push(match dots {
                    0 => ' ',
                    dots => char::from_u32(BLANK + dots).unwrap_or(' '),
                });
            }
            out.push_str(if lit.is_some() { "\x1b[0m\n" } else { "\n" });
        }
    }

    fn tick_row(&self, tick: f64, range: (f64, f64)) -> usize {
        let share = (range.1 - tick) / (range.1 - range.0);
        (share * (self.rows * 4 - 1) as f64).round() as usize / 4
    }
}

fn moved_by_steps(from: i64, to: i64, step: i64, steps: i64) -> i64 {
    let moved = (to - from) as f64 * step as f64 / steps.max(1) as f64;
    from + moved.round() as i64
}
