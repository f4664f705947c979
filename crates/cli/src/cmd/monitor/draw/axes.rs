//! The axes as a table, and the chosen one in words.

use std::time::Duration;

use ratatui_core::text::{Line, Span};

use super::super::axes::Doing;
use super::super::plain::age;
use super::super::seen::{Came, Seen, Value};
use super::{Role, Theme, cut};

/// A value that is older is shown as old.
const OLD: Duration = Duration::from_secs(1);
/// Columns, in the order in which they are left out when there is no room for all.
const LEFT_OUT: [&str; 4] = ["drive", "mode", "torque", "age"];
/// The least share of the rows that is kept for frames: one part of so many.
const FRAMES_PART: u16 = 2;

/// One column of the table.
struct Column {
    head: &'static str,
    right: bool,
    cells: Vec<(String, Role)>,
}

impl Column {
    fn width(&self) -> usize {
        let cells = self.cells.iter().map(|(text, _)| text.chars().count());
        cells.chain([self.head.len()]).max().unwrap_or(0)
    }

    fn pad(&self, text: &str) -> String {
        let width = self.width();
        if self.right { format!("{text:>width$}") } else { format!("{text:<width$}") }
    }
}

/// As many lines as there is room for, frames given their share.
pub fn lines(
    axes: &[Seen],
    chosen: usize,
    width: u16,
    room: u16,
    theme: Theme,
) -> Vec<Line<'static>> {
    if axes.is_empty() {
        return Vec::new();
    }
    let room = usize::from(room - room / FRAMES_PART);
    let mut details = details(axes.get(chosen), usize::from(width), theme);
    let rows = axes.len().min(room.saturating_sub(1 + details.len()).max(room / 2)).max(1);
    details.truncate(room.saturating_sub(1 + rows));
    let first = (chosen + 1).saturating_sub(rows);
    let columns = fitting(columns(&axes[first..], rows), usize::from(width));
    let mut lines = vec![heads(&columns, theme)];
    for n in 0..rows.min(axes.len() - first) {
        let is_chosen = first + n == chosen && axes.len() > 1;
        lines.push(row(&columns, n, is_chosen, theme));
    }
    lines.extend(details);
    lines
}

fn heads(columns: &[Column], theme: Theme) -> Line<'static> {
    let heads = columns.iter().map(|column| format!("{}  ", column.pad(column.head)));
    Line::from(theme.span(format!("  {}", heads.collect::<String>().trim_end()), Role::Dim))
}

fn row(columns: &[Column], n: usize, chosen: bool, theme: Theme) -> Line<'static> {
    let mut spans = vec![theme.span(if chosen { "> " } else { "  " }, Role::Strong)];
    for column in columns {
        let (text, role) = &column.cells[n];
        let role = if chosen && *role == Role::Plain { Role::Strong } else { *role };
        spans.push(theme.span(column.pad(text), role));
        spans.push(Span::raw("  "));
    }
    Line::from(spans)
}

fn columns(axes: &[Seen], rows: usize) -> Vec<Column> {
    let column = |head, right, cell: &dyn Fn(&Seen) -> (String, Role)| Column {
        head,
        right,
        cells: axes.iter().take(rows).map(cell).collect(),
    };
    vec![
        column("axis", false, &|axis| (axis.name.clone(), Role::Plain)),
        column("drive", false, &|axis| (axis.drive[0].clone(), Role::Dim)),
        column("state", false, &state),
        column("mode", false, &|axis| value(axis.mode.as_ref())),
        column("position", true, &|axis| value(axis.position.as_ref())),
        column("velocity", true, &|axis| value(axis.velocity.as_ref())),
        column("torque", true, &|axis| value(axis.effort.as_ref())),
        column("age", true, &|axis| match axis.age {
            Some(old) if old > OLD => (age(old), Role::Warn),
            Some(fresh) => (age(fresh), Role::Dim),
            None => ("-".to_owned(), Role::Dim),
        }),
    ]
}

/// Leaves columns out until the others fit.
fn fitting(mut columns: Vec<Column>, width: usize) -> Vec<Column> {
    for head in LEFT_OUT {
        let taken: usize = columns.iter().map(|column| column.width() + 2).sum();
        if taken <= width {
            break;
        }
        columns.retain(|column| column.head != head);
    }
    columns
}

fn state(axis: &Seen) -> (String, Role) {
    match axis.stop.as_ref().map(|stop| &stop.class) {
        Some(Came::Sent) => return ("stop sent".to_owned(), Role::Warn),
        Some(Came::Acknowledged) => return ("stop taken".to_owned(), Role::Warn),
        Some(Came::Failed(_)) => return ("STOP FAILED".to_owned(), Role::Bad),
        Some(Came::Unseen) => return ("stop taken, standing not known".to_owned(), Role::Warn),
        Some(Came::Still) | None => {}
    }
    let doing = axis.doing;
    let role = match doing {
        Doing::Fault | Doing::Silent => Role::Bad,
        Doing::Warning => Role::Warn,
        Doing::Turns => Role::Good,
        Doing::Holds => Role::Strong,
        Doing::Off | Doing::Stands | Doing::Unknown => Role::Dim,
    };
    (doing.word().to_owned(), role)
}

fn value(value: Option<&Value>) -> (String, Role) {
    match value {
        None => ("-".to_owned(), Role::Dim),
        Some(Value { text, age }) if *age > OLD => (text.clone(), Role::Dim),
        Some(Value { text, .. }) => (text.clone(), Role::Plain),
    }
}

/// The chosen axis: what is wrong with it and what helps, then what else it tells.
fn details(axis: Option<&Seen>, width: usize, theme: Theme) -> Vec<Line<'static>> {
    let Some(axis) = axis else { return Vec::new() };
    let mut lines = Vec::new();
    for (text, stops) in &axis.troubles {
        let role = match (*stops, text.starts_with(' ')) {
            (true, _) => Role::Bad,
            (false, true) => Role::Plain,
            (false, false) => Role::Warn,
        };
        for piece in wrapped(text, width.saturating_sub(2)) {
            lines.push(Line::from(theme.span(format!("  {piece}"), role)));
        }
    }
    let title = format!("  {}: {}", axis.label, axis.drive[1]);
    let mut facts = String::new();
    for (word, Value { text, age: old }) in &axis.facts {
        let gap = if word.is_empty() { "" } else { " " };
        facts.push_str(&format!("  {word}{gap}{text} ({})", age(*old)));
    }
    lines.push(Line::from(theme.span(cut(&title, width), Role::Plain)));
    if !facts.is_empty() {
        lines.push(Line::from(theme.span(cut(&facts, width), Role::Dim)));
    }
    lines
}

/// A text in lines of at most so many characters, broken between words.
fn wrapped(text: &str, width: usize) -> Vec<String> {
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
