//! Draws the frames: bytes and meaning on one aligned line, with changed bytes marked.

use polepair_core::explain::Direction as Said;
use ratatui_core::text::{Line, Span};

use super::super::model::Monitor;
use super::super::traffic::{FrameGroup, FrameRow};
use super::super::view::View;
use super::{TextRole, Theme, truncate};

/// Bytes of a frame that are shown at most, where there is room and where there is not.
const BYTES_SHOWN: [usize; 2] = [9, 16];
/// Columns from which on bytes are set apart by spaces, from which on protocols are named, and from
/// which on more bytes are shown.
const WIDTH_STEPS: [u16; 3] = [80, 100, 120];
/// Time without a frame after which its kind is shown as old.
const OLD_NS: u64 = 2_000_000_000;

/// Title of the list.
pub fn title_line(monitor: &Monitor, view: &View, width: u16, theme: Theme) -> Line<'static> {
    let mut text = if view.by_kind {
        "── frames, the last of each kind: count, every, bytes ".to_owned()
    } else {
        "── frames ".to_owned()
    };
    let plain = text.chars().count();
    if !view.filter.is_empty() {
        text.push_str(&format!("── with \"{}\" ", view.filter));
    }
    if let Some((count, _)) = &view.halted {
        let newer = monitor.traffic.counts().0.saturating_sub(*count);
        text.push_str(&format!("── PAUSED, {newer} newer; space continues "));
    }
    let rest = usize::from(width).saturating_sub(text.chars().count());
    let (head, special) = text.split_at(text.char_indices().nth(plain).map_or(text.len(), |c| c.0));
    Line::from(vec![
        theme.span(head.to_owned(), TextRole::Dim),
        theme.span(special.to_owned(), TextRole::Warn),
        theme.span("─".repeat(rest), TextRole::Dim),
    ])
}

/// Frames that fit.
pub fn frame_lines(
    monitor: &Monitor,
    view: &View,
    width: u16,
    capacity: u16,
    theme: Theme,
) -> Vec<Line<'static>> {
    let grid = Grid::new(monitor, width, theme);
    let space = usize::from(capacity);
    if view.by_kind {
        let kinds = view.kinds(monitor, space);
        return kinds.into_iter().map(|kind| grid.kind_line(monitor, kind)).collect();
    }
    let began = monitor.started_ns();
    let frames = view.frames(monitor, space).into_iter();
    frames
        .map(|row| {
            grid.frame_line(grid.time_text(row.time.saturating_sub(began)), row, TextRole::Plain)
        })
        .collect()
}

/// Widths of the parts of a line.
struct Grid {
    theme: Theme,
    width: usize,
    /// Bytes are set apart by spaces.
    spaced: bool,
    id: usize,
    bytes: usize,
    wire: usize,
    protocol: usize,
    wires: Vec<String>,
}

impl Grid {
    fn new(monitor: &Monitor, width: u16, theme: Theme) -> Self {
        let wires: Vec<String> = monitor.traffic.wires().map(|(name, _)| name.to_owned()).collect();
        let longest = wires.iter().map(|name| name.chars().count()).fold(0, usize::max).min(8);
        let (mut id, mut bytes) = (0, 0);
        let mut protocols: Vec<&str> = Vec::new();
        for kind in monitor.traffic.kinds() {
            id = id.max(match kind.last.id {
                None => 0,
                Some((_, extended)) => {
                    if extended {
                        9
                    } else {
                        4
                    }
                }
            });
            bytes = bytes.max(kind.last.bytes.len());
            let protocol = kind.last.protocol.unwrap_or("?");
            if !protocols.contains(&protocol) {
                protocols.push(protocol);
            }
        }
        let max = BYTES_SHOWN[usize::from(width >= WIDTH_STEPS[2])];
        let named = protocols.len() > 1 && width >= WIDTH_STEPS[1];
        let protocol = protocols.iter().map(|name| name.len()).max().filter(|_| named);
        Self {
            theme,
            width: usize::from(width),
            spaced: width >= WIDTH_STEPS[0],
            id,
            bytes: bytes.min(max),
            wire: if wires.len() > 1 { longest } else { 0 },
            protocol: protocol.unwrap_or(0),
            wires,
        }
    }

    /// Seconds since it was begun.
    fn time_text(&self, since_ns: u64) -> String {
        let seconds = since_ns as f64 / 1e9;
        if self.spaced { format!("{seconds:>9.3} ") } else { format!("{seconds:>7.2} ") }
    }

    fn kind_line(&self, monitor: &Monitor, kind: &FrameGroup) -> Line<'static> {
        let every = kind.period.map_or_else(String::new, |ns| match ns {
            0..100_000_000 => format!("{:.1} ms", ns as f64 / 1e6),
            100_000_000..10_000_000_000 => format!("{} ms", ns / 1_000_000),
            _ => format!("{:.1} s", ns as f64 / 1e9),
        });
        let now = monitor.started_ns() + monitor.age().as_nanos() as u64;
        let old = now.saturating_sub(kind.last.time) > OLD_NS;
        let role = if old { TextRole::Dim } else { TextRole::Plain };
        self.frame_line(format!("{:>6} {every:>8} ", kind.count), &kind.last, role)
    }

    fn frame_line(&self, before: String, row: &FrameRow, role: TextRole) -> Line<'static> {
        let (arrow, arrow_role) = match row.direction {
            Some(Said::ToDrive) => ("> ", TextRole::ToDrive),
            Some(Said::ToHost) => ("< ", TextRole::Plain),
            None => ("  ", TextRole::Plain),
        };
        let mut spans =
            vec![self.theme.span(before, TextRole::Dim), self.theme.span(arrow, arrow_role)];
        for (text, width) in [
            (self.wires.get(row.wire).map_or("", String::as_str), self.wire),
            (row.protocol.unwrap_or("?"), self.protocol),
        ] {
            if width > 0 {
                spans.push(
                    self.theme.span(format!("{:<width$} ", truncate(text, width)), TextRole::Dim),
                );
            }
        }
        self.push_bytes(row, role, &mut spans);
        let used: usize = spans.iter().map(Span::width).sum();
        let capacity = self.width.saturating_sub(used);
        let text = truncate(&row.text, capacity);
        let capacity = capacity.saturating_sub(text.chars().count() + 2);
        spans.push(self.theme.span(text, role));
        if !row.wrong.is_empty() {
            let wrong = format!("  ! {}", row.wrong);
            spans.push(self.theme.span(truncate(&wrong, capacity + 2), TextRole::Bad));
        }
        Line::from(spans)
    }

    fn push_bytes(&self, row: &FrameRow, role: TextRole, spans: &mut Vec<Span<'static>>) {
        let (id, gap) = (self.id, if self.spaced { " " } else { "" });
        spans.push(self.theme.span(format!("{:>id$}", row.id_text()), TextRole::Strong));
        for (n, byte) in row.bytes.iter().enumerate().take(self.bytes) {
            let changed = row.changed >> n & 1 == 1;
            let role = if changed { TextRole::Changed } else { role };
            spans.push(self.theme.span(format!("{byte:02X}"), role));
            spans.push(Span::raw(gap));
        }
        let missing = self.bytes.saturating_sub(row.bytes.len());
        let more = if row.bytes.len() > self.bytes { "…" } else { " " };
        let fill = " ".repeat(missing * (2 + gap.len()));
        spans.push(Span::raw(format!("{fill}{more} ")));
    }
}
