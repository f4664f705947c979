//! Draws the table of axes, and the details of the selected one.

use std::time::Duration;

use ratatui_core::text::{Line, Span};

use super::super::source::{AxisActivity, AxisRow, SignalRow, StopState, format_age};
use super::{TextRole, Theme, truncate};
use polepair_core::profile::Signal;

/// A value that is older is shown as old.
const OLD_AGE: Duration = Duration::from_secs(1);
/// Columns, in the order in which they are left out when there is no room for all.
const DROPPED_COLUMNS: [&str; 4] = ["drive", "mode", "torque", "age"];
/// Divisor of the rows for the least number of rows of frames.
const FRAMES_PART: u16 = 2;

/// One column of the table.
struct AxisColumn {
    head: &'static str,
    right: bool,
    cells: Vec<(String, TextRole)>,
}

impl AxisColumn {
    fn width(&self) -> usize {
        let cells = self.cells.iter().map(|(text, _)| text.chars().count());
        cells.chain([self.head.len()]).fold(0, usize::max)
    }

    fn pad(&self, text: &str) -> String {
        let width = self.width();
        if self.right { format!("{text:>width$}") } else { format!("{text:<width$}") }
    }
}

/// Lines of axes that fit, with the share of frames kept.
pub fn axis_lines(
    axes: &[AxisRow],
    chosen: usize,
    width: u16,
    capacity: u16,
    theme: Theme,
) -> Vec<Line<'static>> {
    if axes.is_empty() {
        return Vec::new();
    }
    let space = usize::from(capacity - capacity / FRAMES_PART);
    let mut details = detail_lines(axes.get(chosen), usize::from(width), theme);
    let rows = axes.len().min(space.saturating_sub(1 + details.len()).max(space / 2)).max(1);
    details.truncate(space.saturating_sub(1 + rows));
    let first = (chosen + 1).saturating_sub(rows);
    let columns = fit_columns(axis_columns(&axes[first..], rows), usize::from(width));
    let mut lines = vec![head_line(&columns, theme)];
    for n in 0..rows.min(axes.len() - first) {
        let is_chosen = first + n == chosen && axes.len() > 1;
        lines.push(row_line(&columns, n, is_chosen, theme));
    }
    lines.extend(details);
    lines
}

fn head_line(columns: &[AxisColumn], theme: Theme) -> Line<'static> {
    let heads = columns.iter().map(|column| format!("{}  ", column.pad(column.head)));
    Line::from(theme.span(format!("  {}", heads.collect::<String>().trim_end()), TextRole::Dim))
}

fn row_line(columns: &[AxisColumn], n: usize, chosen: bool, theme: Theme) -> Line<'static> {
    let mut spans = vec![theme.span(if chosen { "> " } else { "  " }, TextRole::Strong)];
    for column in columns {
        let (text, role) = &column.cells[n];
        let role = if chosen && *role == TextRole::Plain { TextRole::Strong } else { *role };
        spans.push(theme.span(column.pad(text), role));
        spans.push(Span::raw("  "));
    }
    Line::from(spans)
}

fn axis_columns(axes: &[AxisRow], rows: usize) -> Vec<AxisColumn> {
    vec![
        axis_column("axis", false, &|axis| (axis.short_name(), TextRole::Plain), rows, axes),
        axis_column("drive", false, &|axis| (axis.profile.clone(), TextRole::Dim), rows, axes),
        axis_column("state", false, &state_cell, rows, axes),
        axis_column("mode", false, &|axis| value_cell(axis.signal(Signal::Mode)), rows, axes),
        axis_column(
            "position",
            true,
            &|axis| value_cell(axis.signal(Signal::Position)),
            rows,
            axes,
        ),
        axis_column(
            "velocity",
            true,
            &|axis| value_cell(axis.signal(Signal::Velocity)),
            rows,
            axes,
        ),
        axis_column("torque", true, &|axis| value_cell(axis.effort()), rows, axes),
        axis_column(
            "age",
            true,
            &|axis| match axis.age() {
                Some(old) if old > OLD_AGE => (format_age(old), TextRole::Warn),
                Some(fresh) => (format_age(fresh), TextRole::Dim),
                None => ("-".to_owned(), TextRole::Dim),
            },
            rows,
            axes,
        ),
    ]
}

fn axis_column(
    head: &'static str,
    right: bool,
    cell: &dyn Fn(&AxisRow) -> (String, TextRole),
    rows: usize,
    axes: &[AxisRow],
) -> AxisColumn {
    AxisColumn { head, right, cells: axes.iter().take(rows).map(cell).collect() }
}

/// Leaves columns out until the others fit.
fn fit_columns(mut columns: Vec<AxisColumn>, width: usize) -> Vec<AxisColumn> {
    for head in DROPPED_COLUMNS {
        let consumed: usize = columns.iter().map(|column| column.width() + 2).sum();
        if consumed <= width {
            break;
        }
        columns.retain(|column| column.head != head);
    }
    columns
}

fn state_cell(axis: &AxisRow) -> (String, TextRole) {
    match axis.stop.as_ref().map(|stop| &stop.state) {
        Some(StopState::Sent) => return ("stop sent".to_owned(), TextRole::Warn),
        Some(StopState::Acknowledged) => return ("stop taken".to_owned(), TextRole::Warn),
        Some(StopState::Failed(_)) => return ("STOP FAILED".to_owned(), TextRole::Bad),
        Some(StopState::Unobservable) => {
            return ("stop acknowledged, standstill not confirmed".to_owned(), TextRole::Warn);
        }
        Some(StopState::Standstill) | None => {}
    }
    let doing = axis.activity;
    let role = match doing {
        AxisActivity::Fault | AxisActivity::Silent => TextRole::Bad,
        AxisActivity::Warning => TextRole::Warn,
        AxisActivity::Turning => TextRole::Good,
        AxisActivity::Holding => TextRole::Strong,
        AxisActivity::Off | AxisActivity::Standing | AxisActivity::Unknown => TextRole::Dim,
    };
    (doing.word().to_owned(), role)
}

fn value_cell(value: Option<&SignalRow>) -> (String, TextRole) {
    match value {
        None => ("-".to_owned(), TextRole::Dim),
        Some(value) if value.age > OLD_AGE => (value.steady_text(), TextRole::Dim),
        Some(value) => (value.steady_text(), TextRole::Plain),
    }
}

/// The selected axis: its troubles and remedies, then its further values.
fn detail_lines(axis: Option<&AxisRow>, width: usize, theme: Theme) -> Vec<Line<'static>> {
    let Some(axis) = axis else { return Vec::new() };
    let mut lines = Vec::new();
    for trouble in &axis.troubles {
        let text = &trouble.line;
        let role = match (trouble.stops, text.starts_with(' ')) {
            (true, _) => TextRole::Bad,
            (false, true) => TextRole::Plain,
            (false, false) => TextRole::Warn,
        };
        for piece in wrap_text(text, width.saturating_sub(2)) {
            lines.push(Line::from(theme.span(format!("  {piece}"), role)));
        }
    }
    let title = format!("  {}: {}", axis.label, axis.title);
    // First, because the line is cut at the width of the terminal.
    let owner = axis.owner.as_ref().map(|owner| format!("  controlled by {owner}"));
    let mut facts = owner.unwrap_or_default();
    for (word, value) in axis.details() {
        let gap = if word.is_empty() { "" } else { " " };
        let (text, age) = (value.steady_text(), format_age(value.age));
        facts.push_str(&format!("  {word}{gap}{text} ({age})"));
    }
    lines.push(Line::from(theme.span(truncate(&title, width), TextRole::Plain)));
    if !facts.is_empty() {
        lines.push(Line::from(theme.span(truncate(&facts, width), TextRole::Dim)));
    }
    lines
}

/// A text in lines of at most `width` characters, broken between words.
fn wrap_text(text: &str, width: usize) -> Vec<String> {
    let indent: String = text.chars().take_while(|letter| *letter == ' ').collect();
    let mut lines = vec![indent.clone()];
    for word in text.split_whitespace() {
        let last = lines.last_mut().expect("there is one");
        let used = last.chars().count();
        if used > indent.len() && used + 1 + word.chars().count() > width {
            lines.push(format!("{indent}    {word}"));
        } else {
            last.push_str(if used > indent.len() { " " } else { "" });
            last.push_str(word);
        }
    }
    lines
}
