//! Draws the screen: link, axes, details of the selected axis, frames.

mod axes;
mod frames;
mod theme;

use ratatui_core::buffer::Buffer;
use ratatui_core::layout::Rect;
use ratatui_core::text::{Line, Span};

use super::model::Monitor;
use super::source::{AxisRow, SourceStatus, StopState};
use super::view::View;
pub use theme::{TextRole, Theme};

/// Rows from which on the link has two lines.
const TALL_ROWS: u16 = 18;

const HELP: [(&str, &str); 12] = [
    ("Esc", "stop all axes of this view"),
    ("q", "exit; motors are not changed"),
    ("Ctrl-C", "exit with code 130; motors are not changed"),
    ("up, down", "select an axis and show its faults, causes and remedies"),
    ("space", "pause or continue the frames; axes are still updated"),
    ("t", "show every frame, or the last one of each kind"),
    ("/text", "show only frames with this text; /Enter shows all again"),
    ("PgUp, PgDn", "scroll; Home: first frame, End: last frame"),
    ("c", "clear the frames and counters"),
    ("?", "this help"),
    ("", ""),
    ("underlined", "bytes that changed since the last frame of that kind"),
];

/// Draws everything.
pub fn draw_monitor(monitor: &Monitor, view: &View, theme: Theme, buffer: &mut Buffer) {
    let (axes, status) = (monitor.axes(), monitor.status());
    let mut page = ScreenPage { area: buffer.area, used: 0, theme, buffer };
    let tall = page.area.height >= TALL_ROWS;
    page.draw_line(link_line(monitor, &status, page.area.width, theme));
    if let Some(line) = link_state_line(monitor, &status, tall, theme) {
        page.draw_line(line);
    }
    if let Some(lock) = &status.lock {
        page.draw_line(Line::from(theme.span(lock.clone(), TextRole::Bad)));
    }
    for trouble in status.links.iter().flat_map(|link| &link.troubles) {
        page.draw_line(Line::from(theme.span(trouble.clone(), TextRole::Bad)));
    }
    if let Some(line) = stop_line(&status, &axes, view, theme) {
        page.draw_line(line);
    }
    let capacity = page.rows_left().saturating_sub(1);
    for line in axes::axis_lines(&axes, monitor.chosen, page.area.width, capacity, theme) {
        page.draw_line(line);
    }
    page.draw_line(frames::title_line(monitor, view, page.area.width, theme));
    let capacity = page.rows_left().saturating_sub(1);
    for line in frames::frame_lines(monitor, view, page.area.width, capacity, theme) {
        page.draw_line(line);
    }
    page.used = page.area.height.saturating_sub(1);
    page.draw_line(footer_line(view, page.area.width, theme));
    if view.help {
        draw_help(&mut page);
    }
}

/// Contents of the screen from top to bottom.
struct ScreenPage<'a> {
    area: Rect,
    used: u16,
    theme: Theme,
    buffer: &'a mut Buffer,
}

impl ScreenPage<'_> {
    fn draw_line(&mut self, line: Line<'_>) {
        if self.used < self.area.height {
            self.buffer.set_line(self.area.x, self.area.y + self.used, &line, self.area.width);
            self.used += 1;
        }
    }

    fn rows_left(&self) -> u16 {
        self.area.height.saturating_sub(self.used)
    }
}

/// Line with the link, its time, its load, and the key that stops it.
fn link_line(monitor: &Monitor, status: &SourceStatus, width: u16, theme: Theme) -> Line<'static> {
    let seconds = monitor.age().as_secs();
    let mut facts = format!(
        "  {}:{:02}  {:.0} frames/s",
        seconds / 60,
        seconds % 60,
        monitor.traffic.per_second()
    );
    let wires = monitor.traffic.wires();
    let several = wires.len() > 1;
    for (name, load) in wires {
        if let Some(load) = load {
            let name = if several { format!("{name} ") } else { String::new() };
            facts.push_str(&format!("  {name}{:.0} % busy", load * 100.0));
        }
    }
    let stop = if status.is_listen_only { " listening " } else { " STOP ALL: Esc " };
    let rest = usize::from(width).saturating_sub(facts.chars().count() + stop.len() + 1);
    let name = truncate(&monitor.url, rest);
    let gap = rest - name.chars().count() + 1;
    let badge = if status.is_listen_only { TextRole::Dim } else { TextRole::Stop };
    Line::from(vec![
        theme.span(name, TextRole::Strong),
        theme.span(facts, TextRole::Plain),
        Span::raw(" ".repeat(gap)),
        theme.span(stop, badge),
    ])
}

/// Why the link is down, else what went wrong on it so far.
fn link_state_line(
    monitor: &Monitor,
    status: &SourceStatus,
    tall: bool,
    theme: Theme,
) -> Option<Line<'static>> {
    if let Some(text) = &status.trouble {
        return Some(Line::from(theme.span(text.clone(), TextRole::Bad)));
    }
    let (count, _) = monitor.traffic.counts();
    let mut spans = vec![theme.span(format!("{count} frames"), TextRole::Dim)];
    for (count, word) in monitor.flaws().into_iter().filter(|(count, _)| *count > 0) {
        spans.push(theme.span(format!("  {count} {word}"), TextRole::Warn));
    }
    let fine = spans.len() == 1;
    if fine {
        spans.push(theme.span("  no errors", TextRole::Dim));
    }
    (tall || !fine).then(|| Line::from(spans))
}

/// Progress of the requested stop.
fn stop_line(
    status: &SourceStatus,
    axes: &[AxisRow],
    view: &View,
    theme: Theme,
) -> Option<Line<'static>> {
    if let Some(text) = status.stop_problem.as_ref().filter(|_| view.stopped) {
        return Some(Line::from(theme.span(text.clone(), TextRole::Bad)));
    }
    let stops = || axes.iter().filter_map(|axis| Some((axis, axis.stop.as_ref()?)));
    let mut spans = vec![theme.span("STOP", TextRole::Strong)];
    let failed: Vec<(String, &str)> = stops()
        .filter_map(|(axis, stop)| match &stop.state {
            StopState::Failed(why) => Some((axis.short_name(), why.as_str())),
            _ => None,
        })
        .collect();
    if !failed.is_empty() {
        let names: Vec<&str> = failed.iter().map(|(name, _)| name.as_str()).collect();
        let text = format!("  {}: NOT CONFIRMED, cut its power", names.join(", "));
        spans.push(theme.span(text, TextRole::Bad));
    }
    let classes = [
        (StopState::Sent, "sent", TextRole::Warn),
        (StopState::Acknowledged, "acknowledged", TextRole::Plain),
        (StopState::Unobservable, "acknowledged, standstill not confirmed", TextRole::Warn),
        (StopState::Standstill, "standing still", TextRole::Good),
    ];
    for (class, word, role) in classes {
        let found: Vec<_> = stops().filter(|(_, stop)| stop.state == class).collect();
        let Some(last) = found.iter().map(|(_, stop)| stop.elapsed).max() else { continue };
        let names: Vec<String> = found.iter().map(|(axis, _)| axis.short_name()).collect();
        let text = format!("  {}: {word}, {:.2} s", names.join(", "), last.as_secs_f64());
        spans.push(theme.span(text, role));
    }
    if let Some((_, why)) = failed.first() {
        spans.push(theme.span(format!("  ({why})"), TextRole::Bad));
    }
    (spans.len() > 1).then(|| Line::from(spans))
}

fn footer_line(view: &View, width: u16, theme: Theme) -> Line<'static> {
    if view.typing {
        return Line::from(vec![
            theme.span(format!("/{}", view.filter), TextRole::Strong),
            theme.span("_", TextRole::Changed),
            theme.span("  Enter: done", TextRole::Dim),
        ]);
    }
    let all =
        " q exit  ? help  space pause    t kinds  / filter  arrows axis  PgUp PgDn scroll  c clear";
    let short = " q exit  ? help  space pause    t kinds  / filter";
    let text = if usize::from(width) > all.len() { all } else { short };
    Line::from(theme.span(text, TextRole::Dim))
}

fn draw_help(page: &mut ScreenPage<'_>) {
    page.used = 0;
    let blank = " ".repeat(usize::from(page.area.width));
    for _ in 0..page.area.height {
        page.draw_line(Line::from(blank.clone()));
    }
    page.used = 0;
    let theme = page.theme;
    page.draw_line(Line::from(
        theme.span("This view reads; only Esc sends a command", TextRole::Strong),
    ));
    for (key, what) in HELP {
        let key = theme.span(format!("  {key:<12}"), TextRole::Strong);
        page.draw_line(Line::from(vec![key, theme.span(what, TextRole::Plain)]));
    }
}

/// A text of at most `max` characters, with a mark where it was cut.
fn truncate(text: &str, max: usize) -> String {
    if text.chars().count() <= max {
        return text.to_owned();
    }
    let take = text.chars().take(max.saturating_sub(1));
    take.chain((max > 0).then_some('…')).collect()
}
