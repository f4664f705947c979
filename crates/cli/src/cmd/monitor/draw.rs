//! The screen: link, axes, what is to be known of the chosen one, frames.

mod axes;
mod frames;
mod theme;

use ratatui_core::buffer::Buffer;
use ratatui_core::layout::Rect;
use ratatui_core::text::{Line, Span};

use super::keys::View;
use super::seen::{Came, Seen, Shows};
pub use theme::{Role, Theme};

/// Rows from which on the link has two lines.
const TALL: u16 = 18;

const HELP: [(&str, &str); 12] = [
    ("Esc", "stop every axis of this view, whatever is on the screen"),
    ("q", "leave; motors stay as they are"),
    ("Ctrl-C", "leave with exit code 130"),
    ("up, down", "choose an axis: its faults, causes and remedies are told"),
    ("space", "halt the frames, and let them go on; axes go on"),
    ("t", "every frame, or the last one of each kind"),
    ("/text", "only frames with that text; Enter ends it, /Enter shows all"),
    ("PgUp, PgDn", "scroll; Home the first, End the last"),
    ("c", "forget the frames and count anew"),
    ("?", "this help"),
    ("", ""),
    ("underlined", "bytes that changed since the last frame of that kind"),
];

/// Draws everything.
pub fn draw(monitor: &dyn Shows, view: &View, theme: Theme, buffer: &mut Buffer) {
    let axes: Vec<Seen> = (0..monitor.count()).map(|n| monitor.axis(n)).collect();
    let mut page = Page { area: buffer.area, used: 0, theme, buffer };
    let tall = page.area.height >= TALL;
    page.line(link(monitor, page.area.width, theme));
    if let Some(line) = state_of_link(monitor, tall, theme) {
        page.line(line);
    }
    if let Some(lock) = monitor.lock() {
        page.line(Line::from(theme.span(lock, Role::Bad)));
    }
    for wanting in monitor.wanting() {
        page.line(Line::from(theme.span(wanting, Role::Bad)));
    }
    if let Some(line) = stop(monitor, &axes, view, theme) {
        page.line(line);
    }
    let room = page.left().saturating_sub(1);
    for line in axes::lines(&axes, monitor.chosen(), page.area.width, room, theme) {
        page.line(line);
    }
    page.line(frames::title(monitor, view, page.area.width, theme));
    let room = page.left().saturating_sub(1);
    for line in frames::lines(monitor, view, page.area.width, room, theme) {
        page.line(line);
    }
    page.used = page.area.height.saturating_sub(1);
    page.line(footer(view, page.area.width, theme));
    if view.help {
        help(&mut page);
    }
}

/// What is drawn from top to bottom.
struct Page<'a> {
    area: Rect,
    used: u16,
    theme: Theme,
    buffer: &'a mut Buffer,
}

impl Page<'_> {
    fn line(&mut self, line: Line<'_>) {
        if self.used < self.area.height {
            self.buffer.set_line(self.area.x, self.area.y + self.used, &line, self.area.width);
            self.used += 1;
        }
    }

    fn left(&self) -> u16 {
        self.area.height.saturating_sub(self.used)
    }
}

/// What it is, how long, how much passes, and how to stop it.
fn link(monitor: &dyn Shows, width: u16, theme: Theme) -> Line<'static> {
    let seconds = monitor.age().as_secs();
    let mut facts = format!(
        "  {}:{:02}  {:.0} frames/s",
        seconds / 60,
        seconds % 60,
        monitor.traffic().per_second()
    );
    let wires = monitor.traffic().wires();
    let several = wires.len() > 1;
    for (name, load) in wires {
        if let Some(load) = load {
            let name = if several { format!("{name} ") } else { String::new() };
            facts.push_str(&format!("  {name}{:.0} % busy", load * 100.0));
        }
    }
    let stop = if monitor.is_mute() { " listening " } else { " STOP ALL: Esc " };
    let rest = usize::from(width).saturating_sub(facts.chars().count() + stop.len() + 1);
    let name = cut(monitor.url(), rest);
    let gap = rest - name.chars().count() + 1;
    let badge = if monitor.is_mute() { Role::Dim } else { Role::Stop };
    Line::from(vec![
        theme.span(name, Role::Strong),
        theme.span(facts, Role::Plain),
        Span::raw(" ".repeat(gap)),
        theme.span(stop, badge),
    ])
}

/// Why the link is down, else what went wrong on it so far.
fn state_of_link(monitor: &dyn Shows, tall: bool, theme: Theme) -> Option<Line<'static>> {
    if let Some(text) = monitor.trouble() {
        return Some(Line::from(theme.span(text, Role::Bad)));
    }
    let (count, _) = monitor.traffic().counts();
    let mut spans = vec![theme.span(format!("{count} frames"), Role::Dim)];
    for (count, word) in monitor.flaws().into_iter().filter(|(count, _)| *count > 0) {
        spans.push(theme.span(format!("  {count} {word}"), Role::Warn));
    }
    let fine = spans.len() == 1;
    if fine {
        let words = format!("  {}", monitor.fine());
        spans.push(theme.span(words, Role::Dim));
    }
    (tall || !fine).then(|| Line::from(spans))
}

/// How far the stop that was asked for has come.
fn stop(monitor: &dyn Shows, axes: &[Seen], view: &View, theme: Theme) -> Option<Line<'static>> {
    if let Some(text) = monitor.unsaid().filter(|_| view.stopped) {
        return Some(Line::from(theme.span(text, Role::Bad)));
    }
    let stops = || axes.iter().filter_map(|axis| Some((axis, axis.stop.as_ref()?)));
    let mut spans = vec![theme.span("STOP", Role::Strong)];
    let failed: Vec<(&str, &str)> = stops()
        .filter_map(|(axis, stop)| match &stop.class {
            Came::Failed(why) => Some((axis.name.as_str(), why.as_str())),
            _ => None,
        })
        .collect();
    if !failed.is_empty() {
        let names: Vec<&str> = failed.iter().map(|(name, _)| *name).collect();
        let text = format!("  {}: NOT CONFIRMED, cut its power", names.join(", "));
        spans.push(theme.span(text, Role::Bad));
    }
    let classes = [
        (Came::Sent, "sent", Role::Warn),
        (Came::Acknowledged, "acknowledged", Role::Plain),
        (Came::Unseen, "acknowledged, standing not known", Role::Warn),
        (Came::Still, "standing still", Role::Good),
    ];
    for (class, word, role) in classes {
        let found: Vec<_> = stops().filter(|(_, stop)| stop.class == class).collect();
        let Some(last) = found.iter().map(|(_, stop)| stop.took).max() else { continue };
        let names: Vec<&str> = found.iter().map(|(axis, _)| axis.name.as_str()).collect();
        let text = format!("  {}: {word}, {:.2} s", names.join(", "), last.as_secs_f64());
        spans.push(theme.span(text, role));
    }
    if let Some((_, why)) = failed.first() {
        spans.push(theme.span(format!("  ({why})"), Role::Bad));
    }
    (spans.len() > 1).then(|| Line::from(spans))
}

fn footer(view: &View, width: u16, theme: Theme) -> Line<'static> {
    if view.typing {
        return Line::from(vec![
            theme.span(format!("/{}", view.filter), Role::Strong),
            theme.span("_", Role::Changed),
            theme.span("  Enter: done", Role::Dim),
        ]);
    }
    let all =
        " q leave  ? help  space halt  t kinds  / filter  arrows axis  PgUp PgDn scroll  c clear";
    let short = " q leave  ? help  space halt  t kinds  / filter";
    let text = if usize::from(width) > all.len() { all } else { short };
    Line::from(theme.span(text, Role::Dim))
}

fn help(page: &mut Page<'_>) {
    page.used = 0;
    let blank = " ".repeat(usize::from(page.area.width));
    for _ in 0..page.area.height {
        page.line(Line::from(blank.clone()));
    }
    page.used = 0;
    let theme = page.theme;
    page.line(Line::from(
        theme.span("polepair monitor reads; only Esc sends a command", Role::Strong),
    ));
    for (key, what) in HELP {
        let key = theme.span(format!("  {key:<12}"), Role::Strong);
        page.line(Line::from(vec![key, theme.span(what, Role::Plain)]));
    }
}

/// A text that has at most so many characters; what is cut off is marked.
fn cut(text: &str, most: usize) -> String {
    if text.chars().count() <= most {
        return text.to_owned();
    }
    let kept = text.chars().take(most.saturating_sub(1));
    kept.chain((most > 0).then_some('…')).collect()
}
