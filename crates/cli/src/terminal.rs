//! The terminal: notes on stderr, tables, colours only without `NO_COLOR`.

use std::io::{self, IsTerminal as _, Write as _};
use std::sync::atomic::{AtomicBool, Ordering};

use polepair_core::escape::{EscapedText, are_lines_plain, is_plain};

/// Returns whether stdout takes colours.
pub fn colour_out() -> bool {
    io::stdout().is_terminal() && colours_wanted()
}

/// Returns whether stdout is a terminal that a screen can be drawn on.
pub fn is_screen() -> bool {
    io::stdout().is_terminal() && std::env::var_os("TERM").is_none_or(|term| term != "dumb")
}

/// Columns of the terminal; what a page has where there is none.
pub fn width() -> usize {
    const PAGE: usize = 100;
    let stated = std::env::var("COLUMNS").ok().and_then(|columns| columns.parse().ok());
    stated.or_else(|| detected_width().filter(|_| io::stdout().is_terminal())).unwrap_or(PAGE)
}

fn detected_width() -> Option<usize> {
    ratatui_crossterm::crossterm::terminal::size().ok().map(|size| size.0.into())
}

/// Returns whether stderr takes colours.
pub fn colour_err() -> bool {
    io::stderr().is_terminal() && colours_wanted()
}

fn colours_wanted() -> bool {
    !is_env_set("NO_COLOR")
        && std::env::var_os("TERM").is_none_or(|term| term != "dumb")
        && understands_escapes()
}

fn is_env_set(name: &str) -> bool {
    std::env::var_os(name).is_some_and(|value| !value.is_empty())
}

#[cfg(unix)]
const fn understands_escapes() -> bool {
    true
}

/// Has a console of Windows understand escape sequences; those before Windows 10 do not.
#[cfg(windows)]
fn understands_escapes() -> bool {
    ratatui_crossterm::crossterm::ansi_support::supports_ansi()
}

/// Colours and styles that this program prints itself.
const OWN_STYLES: [&str; 12] =
    ["0", "1", "2", "4", "1;31", "31", "32", "33", "34", "35", "36", "37"];

/// Escapes the control characters of text, but for the ends of its lines, tabs, and with `colours` the styles of this
/// program.
pub fn escape_controls(text: &mut Vec<u8>, colours: bool) {
    if are_lines_plain(text) {
        return;
    }
    let (mut escaped, text_before) = (String::new(), std::mem::take(text));
    let mut rest = &*String::from_utf8_lossy(&text_before);
    while !rest.is_empty() {
        let own = OWN_STYLES.iter().find_map(|style| {
            let end = rest.strip_prefix("\x1b[")?.strip_prefix(style)?.strip_prefix('m')?;
            Some(rest.len() - end.len())
        });
        let first = rest.chars().next().map_or(rest.len(), char::len_utf8);
        let taken = own.filter(|_| colours).unwrap_or(first);
        let (piece, others) = rest.split_at(taken);
        if taken > first || piece.bytes().all(|byte| is_kept_byte(&byte)) {
            escaped.push_str(piece)
        } else {
            escaped.push_str(&EscapedText(piece).to_string())
        }
        rest = others;
    }
    *text = escaped.into_bytes();
}

fn is_kept_byte(byte: &u8) -> bool {
    matches!(byte, b'\n' | b'\t')
}

static QUIET: AtomicBool = AtomicBool::new(false);

/// Leaves notes and progress out from now on.
pub fn be_quiet() {
    QUIET.store(true, Ordering::Relaxed);
}

/// Returns whether notes and progress are left out.
pub fn is_quiet() -> bool {
    QUIET.load(Ordering::Relaxed)
}

/// A note on stderr: a line that a script can do without. `--quiet` leaves it out.
pub fn print_note(text: &str) {
    if !is_quiet() {
        print_warning(text);
    }
}

/// A line on stderr that is printed in any case: a motor may turn, or something is missing.
pub fn print_warning(text: &str) {
    let mut line = format!("{text}\n").into_bytes();
    escape_controls(&mut line, colour_err());
    draw(&String::from_utf8_lossy(&line));
}

/// Escapes the control characters of text, but for the ends of its lines.
pub fn escape_lines(text: &str) -> String {
    let lines: Vec<String> = text.split('\n').map(|line| EscapedText(line).to_string()).collect();
    lines.join("\n")
}

/// Output of prose, which tests read.
fn stderr() -> Box<dyn io::Write> {
    if cfg!(test) { Box::new(io::sink()) } else { Box::new(io::stderr()) }
}

/// Output of a thread that tries a verb.
#[cfg(test)]
pub mod tried {
    use std::cell::RefCell;

    thread_local! {
        static SAID: RefCell<String> = const { RefCell::new(String::new()) };
    }

    pub fn record(text: &str) {
        SAID.with_borrow_mut(|output| output.push_str(text));
    }

    /// Takes it.
    pub fn take_recorded() -> String {
        SAID.take()
    }
}

/// Draws over the last text on stderr. A terminal that went away ends nothing: a motor may be turning, and this program
/// has to stop it.
pub fn draw(text: &str) {
    #[cfg(test)]
    tried::record(text);
    let mut err = stderr();
    let _ = err.write_all(text.as_bytes()).and_then(|()| err.flush());
}

/// A table with aligned columns; the last one may be as wide as it likes.
#[derive(Default)]
pub struct TextTable {
    rows: Vec<Vec<String>>,
    heads: usize,
}

impl TextTable {
    /// A table with column heads.
    pub fn with_heads(heads: &[&str]) -> Self {
        Self { rows: vec![heads.iter().map(|head| (*head).to_owned()).collect()], heads: 1 }
    }

    /// Adds a row.
    pub fn add_row(&mut self, cells: impl IntoIterator<Item = String>) {
        self.rows.push(
            cells
                .into_iter()
                .map(
                    |cell| {
                        if is_plain(cell.as_bytes()) {
                            cell
                        } else {
                            EscapedText(&cell).to_string()
                        }
                    },
                )
                .collect(),
        );
    }

    /// True without rows below the heads.
    pub fn is_empty(&self) -> bool {
        self.rows.len() <= self.heads
    }

    /// The lines.
    pub fn render(&self, colour: bool) -> String {
        let columns = self.rows.iter().map(Vec::len).fold(0, usize::max);
        let mut widths = vec![0; columns];
        for row in &self.rows {
            for (width, cell) in widths.iter_mut().zip(row) {
                *width = cell.chars().count().max(*width);
            }
        }
        let mut text = String::new();
        for (at, row) in self.rows.iter().enumerate() {
            let mut line = String::new();
            for (cell, width) in row.iter().zip(&widths) {
                line.push_str(cell);
                line.extend(std::iter::repeat_n(' ', width - cell.chars().count() + 2));
            }
            let line = line.trim_end();
            if colour && at < self.heads {
                text.push_str(&format!("\x1b[2m{line}\x1b[0m\n"));
            } else {
                text.push_str(line);
                text.push('\n');
            }
        }
        text
    }
}

/// A line of comma-separated values.
pub fn csv_line<'a>(fields: impl IntoIterator<Item = &'a str>) -> String {
    fields
        .into_iter()
        .map(|field| {
            if field.contains([',', '"', '\n', '\r']) {
                format!("\"{}\"", field.replace('"', "\"\""))
            } else {
                field.to_owned()
            }
        })
        .collect::<Vec<_>>()
        .join(",")
}
